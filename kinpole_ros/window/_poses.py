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

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import Spectrum, squares_of
from kinpole_ros.window._judgment import (
    Judged,
    PoseDerivatives,
    Seen,
    applied,
    by_signal,
    dimensions_of,
    fits_at,
    joined,
    judge,
    known,
)
from kinpole_ros.window._projection import Projection, longest, project

# A judgment holds for this part of the samples of the longest window: 12 of 99 leave the errors as
# they are when each instant is judged.
_PART = 8
# Bodies are asked so many times while it holds.
_ASKED = 6
# Derivatives found together and apart are not the same where they differ by so many deviations.
_OFF = 3.0
# Squares beyond their limits by this factor are not of the motion that was judged.
_SURPRISING = 2.0
# The first axes of the fields of `PoseDerivatives`: orders K, arms A.
_AXES = ('K', 'K', 'KK', 'KK', '', '', 'KA', 'KA', 'KKA', 'KKA', 'KA', 'K')


class _Plan(NamedTuple):
    """
    What is judged at M instants, when a judgment of all bodies holds for `every` instants.

    All bodies where `due` (M,), for the instants after and where `at_once` (M,) for the instant
    itself too; elsewhere those that refute what holds `since` (M,) so many instants, if asked.
    """

    due: np.ndarray
    at_once: np.ndarray
    since: np.ndarray
    every: int

    def part(self, chosen: slice) -> '_Plan':
        """That for some of the instants."""
        return _Plan(self.due[chosen], self.at_once[chosen], self.since[chosen], self.every)

    def asked(self) -> np.ndarray:
        """At which instants (M,) bodies are asked."""
        return (self.since % _between(self.every) == 0) & ~self.due

    def ahead(self) -> np.ndarray:
        """For how many instants (M,) more what is judged anew is good, 0 where none is asked."""
        count = np.minimum(_between(self.every), self.every - self.since)
        # Up to those that are judged for themselves.
        index = np.arange(len(count))
        anew = np.append(self.at_once.nonzero()[0], len(count) + self.every)
        left = anew[anew.searchsorted(index, side='right')] - index - 1
        return np.where(self.asked(), np.minimum(count, left), 0)


def _between(every: int) -> int:
    """Instants from one at which bodies are asked to the next, where judgments hold for `every`."""
    return -(-every // _ASKED)


class _Fresh(NamedTuple):
    """
    Judgments of R bodies, each for a few instants, since what holds was refuted just before.

    They are for the `bodies` (R,) from the instants `first` on to those before `end` (R,);
    `refuted` (K, A, R) says which derivatives were off the truth, or may have been.
    """

    first: np.ndarray
    end: np.ndarray
    bodies: np.ndarray
    judged: Judged
    refuted: np.ndarray

    def after(self, count: int) -> '_Fresh | None':
        """Those for instants after so many, counted from there on; None if there are none."""
        left = self.end > count
        if not np.count_nonzero(left):
            return None
        judged = Judged(*(field[..., left] for field in self.judged))
        first = np.maximum(self.first[left] - count, 0)
        return _Fresh(
            first, self.end[left] - count, self.bodies[left], judged, self.refuted[..., left]
        )


class PoseFilter:
    """Finds the derivatives of the poses of B bodies, instant after instant."""

    def __init__(self) -> None:
        self._spectrum = Spectrum()
        self._spectrum_together = Spectrum()
        # What holds up to an order, for windows up to so many samples, after an instant.
        self._held: Judged | None = None
        self._order = 0
        self._longest = 0
        self._number = -1
        # For the next few instants.
        self._fresh: _Fresh | None = None
        # What the last instant is still to be asked for.
        self._later: Callable[[], None] | None = None

    def settle(self) -> None:
        """Judge what is due, while nobody waits for it; else the next `derivatives` do."""
        if self._later is not None:
            self._later()
            self._later = None

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
        plan = _planned(numbers, self._number if held else None, every)
        self._longest, self._number = most, int(numbers[-1])

        def part(chosen: slice, order: int) -> PoseDerivatives:
            fits = project(times[:, chosen], samples[:, chosen], weights, order, reach.shape[1])
            return self._derived(fits, noise[chosen], reach[chosen], plan.part(chosen), order)

        due, at_once = plan.due, plan.at_once
        if at_once[0] or order == self._order:
            return part(slice(None), order)
        # Up to the next judgment, which is of the other order.
        end = int(due.argmax()) if due.any() else len(due)
        due[end : end + 1] = False
        parts = [_of_order(part(slice(end + 1), self._order), order)]
        if end < len(due):
            due[end] = at_once[end] = True
            part(slice(end, end + 1), order)
        if end + 1 < len(due):
            parts.append(part(slice(end + 1, None), order))
        return PoseDerivatives(*(np.concatenate(each, -2) for each in zip(*parts, strict=True)))

    def _derived(
        self, fits: Projection, noise: Real, reach: Real, plan: _Plan, order: int
    ) -> PoseDerivatives:
        """Derivatives of poses at instants of which some are judged."""
        self.settle()
        due, at_once, _, every = plan
        count, bodies = reach.shape
        everybody = np.arange(bodies)
        seen = Seen(fits, squares_of(fits, dimensions_of(bodies)), noise, reach)

        def begin(instants: np.ndarray) -> Judged:
            """Judge all bodies at some instants, to hold from then on."""
            all_bodies = np.broadcast_arrays(instants[:, None], everybody)
            pasts = self._spectrum.follow, self._spectrum_together.follow
            new = judge(seen.at(*all_bodies), *pasts, order, every)
            self._held = Judged(*(field[..., -bodies:] for field in new))
            self._order = order
            return new

        # Who comes alone is not kept waiting for what is of use to the next.
        alone = count == 1
        judged = self._held if not at_once[0] else None
        begun = due & (at_once | (not alone))
        if np.count_nonzero(begun):
            judged = joined(judged, begin(begun.nonzero()[0]))
        assert judged is not None
        row = begun.cumsum() - (begun & ~at_once) - at_once[0]
        which = row[:, None] * bodies + everybody
        # Unless it moves in another way than was judged.
        squares = by_signal(seen.squares, bodies)
        limits = judged.limits.take(which, -1)
        surprised = (squares > _SURPRISING * limits).any(axis=(0, 1, 2))
        changed = surprised & (due & ~at_once)[:, None]
        if np.count_nonzero(changed):
            if alone:
                judged = joined(judged, begin(np.zeros(1, int)))
            which = which + bodies * changed
        held = applied(judged, which, fits)

        fresh, self._fresh = self._fresh, None
        if fresh is not None and np.count_nonzero(at_once):
            fresh = fresh._replace(end=np.minimum(fresh.end, at_once.argmax()))
        # What is still to be looked at is not given away.
        found = PoseDerivatives(*map(np.copy, held)) if alone or fresh is not None else held
        if fresh is not None:
            _replace(found, fresh, fits)
            self._fresh = fresh.after(count)

        def go_on() -> None:
            """Ask what these instants say of those after them, or of themselves if surprised."""
            if alone and due[0]:
                if not (at_once[0] or changed.any()):
                    begin(np.zeros(1, int))
                return
            wrong = (squares > limits).any(axis=(0, 1, 2))
            fresh = _refuted(seen, held, judged, which, wrong, surprised, plan, order)
            if fresh is not None:
                # Of two for one instant the later one counts, which is its own.
                _replace(found, fresh, fits)
                self._fresh = fresh.after(count) or self._fresh

        if not alone or np.count_nonzero(surprised):
            go_on()
        elif due[0] or plan.asked()[0]:
            self._later = go_on
        return found


def _planned(numbers: np.ndarray, before: int | None, every: int) -> _Plan:
    """
    The plan for samples of `numbers` (M,), rising, when a judgment holds for `every` instants.

    There is one for the sample after that `before`; None if there is none.
    """
    last = np.concatenate(((-2 if before is None else before,), numbers[:-1]))
    at_once = numbers != last + 1
    since = numbers % every
    return _Plan(at_once | (since == 0), at_once, since, every)


def _refuted(
    seen: Seen,
    held: PoseDerivatives,
    judged: Judged,
    which: np.ndarray,
    wrong: np.ndarray,
    surprised: np.ndarray,
    plan: _Plan,
    order: int,
) -> _Fresh | None:
    """
    Judge bodies anew that refute what is `held` of them by the items `which` (M, B) of the judged.

    That is where their squares are `wrong` (M, B), or together is off apart. It is for the instant
    itself where `surprised` (M, B), and for those ahead.
    """
    asked = plan.asked()[:, None] | (surprised & ~plan.due[:, None])
    off = _off(held)
    refuted = (wrong | off[-1].any(axis=0)) & asked
    if not np.count_nonzero(refuted):
        return None
    rows = which[refuted]
    pasts = (
        known(judged.means[..., rows], judged.among[..., rows]),
        known(judged.means_together[..., rows], judged.among_together[..., rows]),
    )
    instants, bodies = refuted.nonzero()
    new = judge(seen.at(instants[:, None], bodies[:, None]), *pasts, order, plan.every)
    first, end = instants + ~surprised[refuted], instants + 1 + plan.ahead()[instants]
    return _Fresh(first, end, bodies, new, off[..., refuted] | wrong[refuted])


def _replace(found: PoseDerivatives, fresh: _Fresh, fits: Projection) -> None:
    """Put what is judged anew in place of what was found by what is refuted."""
    instants = np.minimum(fresh.end, len(found.span)) - fresh.first
    which = np.repeat(np.arange(len(instants)), np.maximum(instants, 0))
    if not len(which):
        return
    # How many of these for one body were before.
    within = np.arange(len(which)) - which.searchsorted(which)
    at = fresh.first[which] + within, fresh.bodies[which]
    anew = applied(fresh.judged, which[:, None], fits_at(fits, at[0][:, None], at[1][:, None]))
    # No order hangs on what those above it tell, lest it did on which are asked for.
    both = fresh.refuted[..., which]
    orders = np.arange(len(both))
    own = both[:, 0].copy()
    own[1:] = np.logical_or.accumulate(both[orders[1:], orders[:-1]], axis=0)
    replaced = {
        'K': own,
        'KK': own[:, None] | own,
        '': own[min(1, len(own) - 1)],
        'KA': both,
        'KKA': both[:, None] | both,
    }
    for array, part, axes in zip(found, anew, _AXES, strict=True):
        there = (..., *at)
        array[there] = np.where(replaced[axes], part[..., 0], array[there])


def _off(found: PoseDerivatives) -> np.ndarray:
    """Which derivatives (K, A, M, B) together, or some of lower order, are off those apart."""

    def off(apart: Complex, both: Complex, covariance: Real, covariance_both: Real) -> np.ndarray:
        of_itself = np.einsum('kk...->k...', covariance), np.einsum('kk...->k...', covariance_both)
        variance = of_itself[0][:, None] + of_itself[1]
        away = both - apart[:, None]
        return np.asarray(away.real**2 + away.imag**2 > _OFF**2 * variance)

    f = found
    either = off(
        f.position, f.position_together, f.position_covariance, f.position_covariance_together
    ) | off(f.angle, f.angle_together, f.angle_covariance, f.angle_covariance_together)
    # The instant itself is the same for both, but for rounding.
    either[0] = False
    return np.asarray(np.logical_or.accumulate(either, axis=0))


def _of_order(found: PoseDerivatives, order: int) -> PoseDerivatives:
    """The same up to another order, NaN where that is higher."""
    sizes = {'K': order + 1, 'A': order}
    return PoseDerivatives(
        *(
            _resized(array, [sizes[axis] for axis in axes])
            for array, axes in zip(found, _AXES, strict=True)
        )
    )


def _resized(array: np.ndarray, sizes: list[int]) -> np.ndarray:
    """The array with these sizes of its first axes, cut or with NaN."""
    result = np.full((*sizes, *array.shape[len(sizes) :]), np.nan, array.dtype)
    common = tuple(slice(min(pair)) for pair in zip(sizes, array.shape, strict=False))
    result[common] = array[common]
    return result
