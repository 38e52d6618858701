"""
Derivatives of poses: how is judged now and then, and holds until the data refute it.

To judge windows and degrees takes ten times what the derivatives themselves take, and as a rule the
judgment is the same from one frame to the next. It is made anew at each eighth part of a window.
In between each body is asked now and then whether it still moves as was judged: not if in its
coefficients or residuals something stands out that was not there, or if angle and position tell
another story together than they do apart. What is judged is for the instants to come, so that a
frame that comes alone is answered before it is judged; only a body that is far off all that was
judged has its answer by a judgment of its own.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real, complex_of
from kinpole_ros.window._judgment import (
    Judged,
    PoseDerivatives,
    Seen,
    applied,
    by_signal,
    dimensions_of,
    joined,
    judge,
    of_order,
)
from kinpole_ros.window._ladder import longest
from kinpole_ros.window._plan import Plan, planned
from kinpole_ros.window._projection import Projection, project
from kinpole_ros.window._refuted import Fresh, judge_refuted, put
from kinpole_ros.window._spectrum import Spectrum
from kinpole_ros.window._weighted import squares_of

# A judgment holds for this part of the samples of the longest window: 12 of 99 leave the errors as
# they are when each instant is judged.
_PART = 8
# Squares beyond their limits by this factor are not of the motion that was judged.
_SURPRISING = 2.0


class Unforeseen(Exception):
    """What the next frame makes of the figures cannot be found before it comes."""


class Room(NamedTuple):
    """
    How far G signals may be off a guess of their newest sample before they refute a judgment.

    By roots of mean squares: coefficients (L D, G) are `start` by the guess and change by `change`;
    what the fits leave (L, G) has the square `left` by the guess, which changes by twice its
    product with `left_along` and by `left_change` times its square. Signals off by less than `sure`
    (G,) refute nothing.
    """

    start: Complex
    change: Real
    most: Real
    left: Real
    left_along: Complex
    left_change: Real
    most_left: Real
    sure: list[float]

    def holds(self, signal: int, off: complex) -> bool:
        """Whether a signal may be that far off."""
        if abs(off) <= self.sure[signal]:
            return True
        *fields, _ = self
        start, change, most, left, along, left_change, most_left = (f[:, signal] for f in fields)
        rest = left + 2 * (off * along.conj()).real + left_change * abs(off) ** 2
        return bool((np.abs(start + change * off) <= most).all() and (rest <= most_left).all())


def room_of(fits: Projection, dimensions: np.ndarray, limits: Real) -> Room:
    """
    By fits at an instant as guessed, and with newest samples that are off by 1 and -1.

    Of signals with two components both are.
    """
    groups = len(dimensions)
    x, y = fits.coefficients[:, :, 0], fits.coefficients[:, :, 1, 0]
    squares = fits.squares / (np.maximum(fits.models.freedom[:, None], 1) * dimensions)
    guess, more, less = squares.transpose(2, 0, 1, 3)  # (L, 2, G) each
    left_change = np.maximum(((more + less) / 2 - guess)[:, 0], 0.0)
    along = (more - less) / 4
    left = guess[:, 0] + guess[:, 1]
    most = np.sqrt(limits[:, :-1]).reshape(-1, groups)
    most_left = limits[:, -1].reshape(-1, groups)
    parts = complex_of(x[:, :, 0], y), x[:, :, 1] - x[:, :, 0]
    start, change = (part.reshape(-1, groups) / np.sqrt(dimensions) for part in parts)
    # The length of a sum is no more than that of its parts.
    rests = np.concatenate((most - np.abs(start), np.sqrt(most_left) - np.sqrt(left)))
    with np.errstate(divide='ignore', invalid='ignore'):
        sure = rests / np.concatenate((np.abs(change), np.sqrt(left_change)))
    of_left = left, complex_of(along[:, 0], along[:, 1]), left_change, most_left
    return Room(start, change, most, *of_left, sure.min(axis=0).tolist())


class PoseFilter:
    """
    Finds the derivatives of the poses of B bodies, instant after instant.

    `room` is how far the samples may be off what was guessed of them by the last look `ahead`.
    """

    room: Room

    def __init__(self) -> None:
        self._spectrum = Spectrum()
        self._spectrum_together = Spectrum()
        # What holds up to an order, for windows up to so many samples, after an instant.
        self._held: Judged | None = None
        self._order = 0
        self._longest = 0
        self._number = -1
        # For the next few instants.
        self._fresh: Fresh | None = None
        # What the last instant is still to be asked for.
        self._later: Callable[[], None] | None = None

    def settle(self) -> None:
        """Judge what is due, while nobody waits for it; else the next `derivatives` do."""
        if self._later is not None:
            self._later()
            self._later = None

    def forget(self, which: np.ndarray) -> None:
        """Forget how the bodies `which` (B,) moved: they are others from the next instant on."""
        self.settle()
        self._spectrum.forget(which)
        self._spectrum_together.forget(which)

    def derivatives(
        self,
        numbers: np.ndarray,
        times: np.ndarray,
        samples: Real,
        weights: Real | None,
        noise: Real,
        reach: Real,
        order: int,
    ) -> PoseDerivatives:
        """
        Derivatives up to `order` at M instants, the samples of `numbers` (M,), rising, of all.

        `times`, `samples` (N, M, 2 B, 2), angles first, and `weights` as in `project`; `noise`
        (M, 2 B) as in `weigh_apart`; poles farther away than `reach` (M, B), m, are not aimed at.
        Orders that were not asked for when the instants before were judged are NaN until the next.
        """
        self.settle()
        most = longest(len(times))
        # What is hidden may be another thing each time, and what is known be of other windows.
        held = weights is None and self._held is not None and self._longest == most
        # Not by the times: stamps that are a little uneven are no reason to judge anew.
        every = max(1, most // _PART) if weights is None else 1
        plan = planned(numbers, self._number if held else None, every)
        self._longest, self._number = most, int(numbers[-1])

        def part(chosen: slice, plan: Plan, order: int) -> PoseDerivatives:
            fits = project(times[:, chosen], samples[:, chosen], weights, order, reach.shape[1])
            return self._derived(fits, noise[chosen], reach[chosen], plan.part(chosen), order)

        if plan.at_once[0] or order == self._order:
            return part(slice(None), plan, order)
        # Up to the next judgment, which is of the other order: it is for the instants after, unless
        # one is judged for itself.
        count = len(numbers)
        end = int(plan.due.argmax()) if plan.due.any() else count
        after = end + int(end < count and not plan.at_once[end])
        there = np.arange(count) == end
        unjudged = plan._replace(due=plan.due & ~there)
        parts = [of_order(part(slice(after), unjudged, self._order), order)]
        if after > end:
            part(slice(end, after), plan._replace(at_once=plan.at_once | there), order)
        if after < count:
            parts.append(part(slice(after, None), plan, order))
        return PoseDerivatives(*(np.concatenate(each, -2) for each in zip(*parts, strict=True)))

    def ahead(
        self,
        numbers: np.ndarray,
        times: np.ndarray,
        samples: Real,
        weights: Real | None,
        noise: Real,
        reach: Real,
        order: int,
    ) -> PoseDerivatives:
        """
        Derivatives at the next instant, as far as they are known before its newest sample is.

        The arguments are those of `derivatives`, of that instant three times, with a guess of the
        sample. Derivatives are affine in it: the first are by the guess, the others by samples that
        are off it by 1 and by -1, positions in x and in y. How far off it may be is the `room`
        then. Raises Unforeseen where what holds is not all that it takes.
        """
        self.settle()
        most, held, fresh = longest(len(times)), self._held, self._fresh
        if (
            weights is not None
            or held is None
            or (self._order, self._longest, self._number + 1) != (order, most, numbers[0])
        ):
            raise Unforeseen
        bodies = reach.shape[1]
        off = np.array((1.0, -1.0))[:, None]
        samples[-1, 1:, :, 0] += off
        samples[-1, 1:, bodies:, 1] += off
        fits = project(times, samples, None, order, bodies)
        which = np.tile(np.arange(bodies), (3, 1))
        found = applied(held, which, fits)
        if fresh is not None:
            found = PoseDerivatives(*map(np.copy, found))
            # For the one instant, which is here three times.
            put(found, fresh._replace(end=3 * fresh.end), fits)
        self.room = room_of(fits, dimensions_of(bodies), _SURPRISING * held.limits)
        return found

    def passed(self, number: int) -> bool:
        """
        Go by the sample that was looked `ahead` to, if nobody is to be judged or asked then.

        Returns False where the derivatives are to be found as always.
        """
        plan = planned(np.array([number]), self._number, max(1, self._longest // _PART))
        if plan.due[0] or plan.asked()[0]:
            return False
        self._number = number
        if self._fresh is not None:
            self._fresh = self._fresh.after(1)
        return True

    def _derived(
        self, fits: Projection, noise: Real, reach: Real, plan: Plan, order: int
    ) -> PoseDerivatives:
        """Derivatives of poses at instants of which some are judged."""
        self.settle()
        count, bodies = reach.shape
        seen = Seen(fits, squares_of(fits, dimensions_of(bodies)), noise, reach)
        squares = by_signal(seen.squares, bodies)
        # Who comes alone is not kept waiting for what is of use to the next.
        alone = count == 1
        begun = plan.due & (plan.at_once | (not alone))
        judged = self._held if not plan.at_once[0] else None
        if np.count_nonzero(begun):
            judged = joined(judged, self._begin(seen, begun.nonzero()[0], plan.every, order))
        assert judged is not None
        row = begun.cumsum() - (begun & ~plan.at_once) - plan.at_once[0]
        which = row[:, None] * bodies + np.arange(bodies)
        limits = judged.limits.take(which, -1)
        surprised = (squares > _SURPRISING * limits).any(axis=(0, 1, 2))
        # Who moves in another way than was judged is judged for the instant itself.
        changed = surprised & (plan.due & ~plan.at_once)[:, None]
        if np.count_nonzero(changed):
            if alone:
                judged = joined(judged, self._begin(seen, np.zeros(1, int), plan.every, order))
                begun = plan.due
            which = which + bodies * changed
        held = applied(judged, which, fits)
        found = self._renewed(held, fits, plan)

        def go_on() -> None:
            """Ask what these instants say of those after them, or of themselves if surprised."""
            if alone and plan.due[0]:
                if not begun[0]:
                    self._begin(seen, np.zeros(1, int), plan.every, order)
                return
            wrong = (squares > limits).any(axis=(0, 1, 2))
            fresh = judge_refuted(seen, held, judged, which, wrong, surprised, plan, order)
            if fresh is not None:
                # Of two for one instant the later one counts, which is its own.
                put(found, fresh, fits)
                self._fresh = fresh.after(count) or self._fresh

        if not alone or np.count_nonzero(surprised):
            go_on()
        elif plan.due[0] or plan.asked()[0]:
            self._later = go_on
        return found

    def _begin(self, seen: Seen, instants: np.ndarray, every: int, order: int) -> Judged:
        """Judge all bodies at some instants; what is judged at the last of these holds on."""
        bodies = seen.reach.shape[1]
        all_bodies = np.broadcast_arrays(instants[:, None], np.arange(bodies))
        pasts = self._spectrum.follow, self._spectrum_together.follow
        new = judge(seen.at(*all_bodies), *pasts, order, every)
        self._held = Judged(*(field[..., -bodies:] for field in new))
        self._order = order
        return new

    def _renewed(self, held: PoseDerivatives, fits: Projection, plan: Plan) -> PoseDerivatives:
        """What is `held`, but for bodies that were judged anew just before."""
        count = len(plan.due)
        fresh, self._fresh = self._fresh, None
        if fresh is None:
            # What is still to be looked at is not given away.
            return PoseDerivatives(*map(np.copy, held)) if count == 1 else held
        if np.count_nonzero(plan.at_once):
            fresh = fresh._replace(end=np.minimum(fresh.end, plan.at_once.argmax()))
        found = PoseDerivatives(*map(np.copy, held))
        put(found, fresh, fits)
        self._fresh = fresh.after(count)
        return found
