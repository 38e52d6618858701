"""
Derivatives of poses: how is judged now and then, and holds until the data refute it.

To judge windows and degrees takes ten times what the derivatives themselves take, and as a rule the
judgment is the same from one frame to the next. It is made anew at each eighth part of a window,
and for a body in whose coefficients or residuals something stands out that was not there, or of
which angle and position tell another story together than they do apart. What is judged is for the
instants to come, so that a frame that comes alone is answered before it is judged; only a body that
is far off all that was judged has its answer by the new judgment.
"""

from collections.abc import Callable
from functools import cache
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
# Derivatives found together and apart are not the same where they differ by so many deviations.
_OFF = 3.0
# Squares beyond their limits by this factor are not of the motion that was judged.
_SURPRISING = 10.0
# The first axes of the fields of `PoseDerivatives`: orders K, arms A.
_AXES = ('K', 'K', 'KK', 'KK', '', '', 'KA', 'KA', 'KKA', 'KKA', 'KA')


class _Fresh(NamedTuple):
    """
    Judgments of R bodies, each for one instant, since what holds was refuted at the one before.

    They are for the `bodies` (R,) at `instants` (R,); `refuted` (K, A, R) says which derivatives
    were off the truth, or may have been.
    """

    instants: np.ndarray
    bodies: np.ndarray
    judged: Judged
    refuted: np.ndarray

    def at(self, chosen: np.ndarray) -> '_Fresh':
        """Those of some."""
        judged = Judged(*(field[..., chosen] for field in self.judged))
        return _Fresh(self.instants[chosen], self.bodies[chosen], judged, self.refuted[..., chosen])


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
        # For the next instant alone.
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
        # Not by the times: stamps that are a little uneven are no reason to judge anew.
        every = max(1, most // _PART) if weights is None else 1
        before = np.concatenate(((self._number,), numbers[:-1]))
        # Where nothing is known that could hold, or what is hidden may be another thing each time.
        at_once = numbers != before + 1
        if weights is not None:
            at_once[:] = True
        elif self._held is None or self._longest != most:
            at_once[0] = True
        due = at_once | (numbers // every != before // every)
        self._longest, self._number = most, int(numbers[-1])

        def part(chosen: slice, order: int) -> PoseDerivatives:
            fits = project(times[:, chosen], samples[:, chosen], weights, order, reach.shape[1])
            those = noise[chosen], reach[chosen], due[chosen], at_once[chosen]
            return self._derived(fits, *those, order, every)

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
        self,
        fits: Projection,
        noise: Real,
        reach: Real,
        due: np.ndarray,
        at_once: np.ndarray,
        order: int,
        every: int,
    ) -> PoseDerivatives:
        """
        Derivatives of poses at instants that are judged where `due` (M,), or refute what holds.

        What is judged is for the instants after, and where `at_once` (M,) for itself too.
        """
        self.settle()
        count, bodies = reach.shape
        everybody = np.arange(bodies)
        seen = cache(lambda: Seen(fits, squares_of(fits, dimensions_of(bodies)), noise, reach))

        def begin(instants: np.ndarray) -> Judged:
            """Judge all bodies at some instants, to hold from then on."""
            all_bodies = np.broadcast_arrays(instants[:, None], everybody)
            pasts = self._spectrum.follow, self._spectrum_together.follow
            new = judge(seen().at(*all_bodies), *pasts, order, every)
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
        squares = by_signal(seen().squares, bodies)
        limits = judged.limits.take(which, -1)
        surprised = (squares > _SURPRISING * limits).any(axis=(0, 1, 2))
        changed = surprised & (due & ~at_once)[:, None]
        if np.count_nonzero(changed):
            if alone:
                judged = joined(judged, begin(np.zeros(1, int)))
            which = which + bodies * changed
        held = applied(judged, which, fits)

        fresh, self._fresh = self._fresh, None
        if at_once[0]:
            fresh = None
        # What is still to be looked at is not given away.
        found = PoseDerivatives(*map(np.copy, held)) if alone or fresh is not None else held
        if fresh is not None:
            _replace(found, fresh, fits)

        def go_on() -> None:
            """Ask what these instants say of those after them, or of themselves if surprised."""
            if alone and due[0]:
                if not (at_once[0] or changed.any()):
                    begin(np.zeros(1, int))
                return
            wrong = (squares > limits).any(axis=(0, 1, 2))
            fresh = _refuted(seen(), held, judged, which, wrong, due, surprised, order, every)
            if fresh is None:
                return
            here = fresh.instants < count
            here[here] = ~at_once[fresh.instants[here]]
            # Of two for one instant the later one counts, which is its own.
            _replace(found, fresh.at(here), fits)
            after = fresh.instants == count
            if after.any():
                waiting = fresh.at(after)
                self._fresh = waiting._replace(instants=waiting.instants - count)

        if alone and not surprised.any():
            self._later = go_on
        else:
            go_on()
        return found


def _refuted(
    seen: Seen,
    held: PoseDerivatives,
    judged: Judged,
    which: np.ndarray,
    wrong: np.ndarray,
    due: np.ndarray,
    surprised: np.ndarray,
    order: int,
    every: int,
) -> _Fresh | None:
    """
    Judge bodies anew that refute what is `held` of them by the items `which` (M, B) of the judged.

    That is where their squares are `wrong` (M, B), or together is off apart, but not at instants
    that are `due` (M,). It is for the instant itself where `surprised` (M, B), else for the next.
    """
    off = _off(held)
    refuted = (wrong | off[-1].any(axis=0)) & ~due[:, None]
    if not np.count_nonzero(refuted):
        return None
    rows = which[refuted]
    pasts = (
        known(judged.means[..., rows], judged.among[..., rows]),
        known(judged.means_together[..., rows], judged.among_together[..., rows]),
    )
    instants, bodies = refuted.nonzero()
    new = judge(seen.at(instants[:, None], bodies[:, None]), *pasts, order, every)
    instants += ~surprised[refuted]
    return _Fresh(instants, bodies, new, off[..., refuted] | wrong[refuted])


def _replace(found: PoseDerivatives, fresh: _Fresh, fits: Projection) -> None:
    """Put what is judged anew in place of what was found by what is refuted."""
    if not len(fresh.bodies):
        return
    at = fresh.instants, fresh.bodies
    anew = applied(
        fresh.judged,
        np.arange(len(fresh.bodies))[:, None],
        fits_at(fits, fresh.instants[:, None], fresh.bodies[:, None]),
    )
    # No order hangs on what those above it tell, lest it did on which are asked for.
    both = fresh.refuted
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
