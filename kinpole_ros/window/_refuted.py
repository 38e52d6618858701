"""
Bodies that no longer move as they were judged to: which they are, and what is judged of them anew.

A body refutes its judgment when in its coefficients or residuals something stands out that was not
there, or when angle and position tell another story together than they do apart.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._judgment import (
    AXES,
    Judged,
    PoseDerivatives,
    Seen,
    applied,
    fits_at,
    judge,
    known,
)
from kinpole_ros.window._plan import Plan
from kinpole_ros.window._projection import Projection

# Derivatives found together and apart are not the same where they differ by so many deviations.
_OFF = 3.0


class Fresh(NamedTuple):
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

    def after(self, count: int) -> 'Fresh | None':
        """Those for instants after so many, counted from there on; None if there are none."""
        left = self.end > count
        if not np.count_nonzero(left):
            return None
        judged = Judged(*(field.compress(left, axis=-1) for field in self.judged))
        first = np.maximum(self.first[left] - count, 0)
        return Fresh(
            first, self.end[left] - count, self.bodies[left], judged, self.refuted[..., left]
        )


def judge_refuted(
    seen: Seen,
    held: PoseDerivatives,
    judged: Judged,
    which: np.ndarray,
    wrong: np.ndarray,
    surprised: np.ndarray,
    plan: Plan,
    order: int,
) -> Fresh | None:
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
        known(judged.means.take(rows, -1), judged.among.take(rows, -1)),
        known(judged.means_together.take(rows, -1), judged.among_together.take(rows, -1)),
    )
    instants, bodies = refuted.nonzero()
    new = judge(seen.at(instants[:, None], bodies[:, None]), *pasts, order, plan.every)
    first, end = instants + ~surprised[refuted], instants + 1 + plan.ahead()[instants]
    return Fresh(first, end, bodies, new, off[..., refuted] | wrong[refuted])


def put(found: PoseDerivatives, fresh: Fresh, fits: Projection) -> None:
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
    # Between an order by what held and one by what is new no covariance is stated: that of either
    # judgment, beside the other's variances, would give some combinations variances below zero.
    of_one = {'KK': own[:, None] == own, 'KKA': both[:, None] == both}
    for array, part, axes in zip(found, anew, AXES, strict=True):
        there = (..., *at)
        new = part[..., 0] * of_one[axes] if axes in of_one else part[..., 0]
        array[there] = np.where(replaced[axes], new, array[there])


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
