"""
Pins: the fixed points of the ground about which bodies have turned as far as can be seen.

A body on a pin at p with the arm c in its own axes has its origin at z = p - c exp(i angle). Poses
are kept spaced by the angle turned, not by time, so a slow body is known as surely as a fast one,
and a body at rest stays what it was. It counts as pinned when a pin explains its poses as well as
its shape explains its markers: bearing play and lenses bend both, and by white noise
alone no real pin would pass.

What makes a body not rigid is no noise: it comes again with the angle, so that no number of poses
averages it out, and a pin may well explain it. How much of it the pin takes is seen in what the
rigid fits leave over: the center is a weighted sum of poses, and the same sum of the residuals has
as much error per degree of freedom (see `_soft.py`).
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._soft import chi_square, student
from kinpole_ros.rigid.levels import FEW, KEPT, RUNNING, SURE

# Poses kept per body, and the angle between them, rad: 4 rad of one-way turning.
_KEPT = 64
_STEP = 4 / _KEPT
# Mean square misfit, over what the rigid fit lets expect, below which a pin is taken and above
# which it is dropped.
_MISFIT = 2.0
# What is not noise makes a pin less sure from so many deviations on: the sum of residuals, or
# products of neighbors, where the misfit is similar from pose to pose.
_DOUBTED = 2.0
# An arc bent by such a misfit has its center off by this many times its square over the spread of
# the angles (a centrode of constant speed, seen over a small arc).
_BEND = 15.0
# An ICR that wandered by this much, body sizes per rad, would have been seen.
_WANDER = 0.05


class Pins:
    """
    The pins of B bodies of up to `width` markers.

    `center` (B,) is complex, m, in the ground frame, NaN for a body without one; `arm` (B,) leads
    from the body's origin to it in the body's axes; `variance` (B,), m^2, is that of one coordinate
    of the center; `since` (B,), ns, from when on the body has been seen to turn about it.
    """

    def __init__(self, bodies: int, width: int) -> None:
        self.center = np.full(bodies, complex(np.nan, np.nan))
        self.arm = np.zeros(bodies, complex)
        self.variance = np.full(bodies, np.nan)
        self.since = np.zeros(bodies, np.int64)
        self._positions = np.zeros((_KEPT, bodies), complex)
        self._turns = np.zeros((_KEPT, bodies), complex)
        # Of each pose its own: it is known less well while markers are hidden.
        self._variances = np.zeros((2, _KEPT, bodies))
        self._residuals = np.zeros((_KEPT, bodies, width), complex)
        self._count = np.zeros(bodies, int)
        # Poses wanted before a body is called pinned.
        self._wanted = np.full(bodies, _KEPT // 2)
        self._last = np.full(bodies, np.nan)
        self._strikes = np.zeros(bodies, int)

    def off_pin(self, position: Complex, angle: Real, variance: Real) -> np.ndarray:
        """Where (T, B) a body is off its pin by more than it can be; poses as in `add`."""
        with np.errstate(invalid='ignore'):
            off = np.abs(position + np.exp(1j * angle) * self.arm - self.center) ** 2
            spread = variance[:, 0] + np.abs(self.arm) ** 2 * variance[:, 1]
            return np.asarray(off > SURE**2 * spread)

    def widen(self, width: int) -> None:
        """Let bodies have more markers."""
        more = ((0, 0), (0, 0), (0, width - self._residuals.shape[2]))
        self._residuals = np.pad(self._residuals, more)

    def add(
        self,
        stamps: np.ndarray,
        position: Complex,
        angle: Real,
        variance: Real,
        size: Real,
        residual: Complex,
    ) -> None:
        """
        Take the poses (T, B) of some frames of `stamps` (T,), NaN where not known.

        `variance` (T, 2, B) is that of one coordinate of the position, m^2, and of the angle,
        rad^2, as the misfit of the rigid bodies has it; `size` (B,), m, is theirs. `residual`
        (T, B, width) is what the fits leave over in the bodies' axes, over the deviation by that
        misfit, NaN for none.
        """
        known = np.isfinite(angle) & np.isfinite(variance).all(axis=1)
        off_pin = known & self.off_pin(position, angle, variance)
        frame = np.arange(len(stamps))[:, None]
        # How many frames running, at each, a body has been off.
        back = np.maximum.accumulate(np.where(off_pin, -1, frame), axis=0)
        running = np.where(back < 0, frame + 1 + self._strikes, frame - back)
        self._strikes = running[-1]
        gone = (running >= RUNNING).any(axis=0)
        self._leave(gone)
        fresh = np.zeros(len(gone), bool)
        usable = known & ~off_pin & ~gone
        with np.errstate(invalid='ignore'):
            turned = np.abs((angle - self._last + np.pi) % (2 * np.pi) - np.pi) > _STEP
        new = usable & (turned | (self._count == 0))
        for b in np.flatnonzero(new.any(axis=0)).tolist():
            left = usable[:, b]
            left[: new[:, b].argmax()] = False
            at = left.nonzero()[0]
            at = at[_spaced(angle[at, b].tolist())]
            if self._count[b] == 0:
                self.since[b] = stamps[at[0]]
            row = (self._count[b] + np.arange(len(at))) % _KEPT
            self._positions[row, b] = position[at, b]
            self._turns[row, b] = np.exp(1j * angle[at, b])
            self._variances[:, row, b] = variance[at, :, b].T
            # Not nan_to_num, which keeps the other part of a number of which one part is NaN.
            self._residuals[row, b] = np.where(np.isnan(residual[at, b]), 0, residual[at, b])
            self._last[b] = angle[at[-1], b]
            self._count[b] += len(at)
            fresh[b] = True
        ready = np.flatnonzero(fresh & (self._count >= FEW))
        if len(ready):
            self._update(ready, size[ready])

    def _update(self, which: np.ndarray, size: Real) -> None:
        """Fit a pin to the poses of the bodies `which` (b,) and see whether it may stand."""
        count = np.minimum(self._count[which], _KEPT)
        held = np.arange(_KEPT)[:, None] < count
        z = self._positions[:, which]
        e = self._turns[:, which]
        even, of_angle = self._variances[:, :, which]
        # Poses known far less than others, while markers are hidden, would be all that counts.
        arm = _arm(z, e, held / count)[0]
        weights = np.where(held, 1 / np.where(held, even + np.abs(arm) ** 2 * of_angle, 1), 0)
        weights /= weights.sum(axis=0)
        arm, z_mean, e_mean, spread = _arm(z, e, weights)
        around = np.where(held, e - e_mean, 0)
        misfit = (np.where(held, z - z_mean, 0) + arm * around) * e.conj()
        along = np.where(arm == 0, 1, arm / np.maximum(np.abs(arm), np.finfo(float).tiny))
        misfit = misfit * along.conj()
        across = even + np.abs(arm) ** 2 * of_angle
        squares = misfit.real**2 / np.where(held, even, 1)
        squares += misfit.imag**2 / np.where(held, across, 1)
        square = squares.sum(axis=0) / (2 * count - 4)
        # Of the sum over poses that the center is, by the mean of the noise along and across, and
        # more for a misfit that is similar from pose to pose: no noise, it bends the arc.
        shares = weights * (1 - e_mean * around.conj() / spread)
        each = np.maximum(square, 1) * np.where(held, even + across, 0) / 2
        misfit *= np.sqrt(weights)
        similar = (misfit * np.roll(misfit, 1, axis=0).conj()).real.sum(axis=0)
        total = (np.abs(misfit) ** 2).sum(axis=0)
        bent = np.maximum(similar - _DOUBTED * total / np.sqrt(count), 0) / 2
        found = (np.abs(shares) ** 2 * each).sum(axis=0) + _BEND * bent / spread
        # The same sum of what the rigid fits leave over, per degree of freedom.
        left = self._residuals[:, which]
        slow = np.einsum('kb,kbn->bn', shares * e * np.sqrt((even + across) / 2), left)
        freedom = np.maximum(2 * left.any(axis=0).sum(axis=-1) - 3, 1)
        slow = (np.abs(slow) ** 2).sum(axis=-1) / freedom
        surely = slow > chi_square(freedom, _DOUBTED) * found
        found = np.where(surely, slow * student(freedom), found)
        contradicted = square > _MISFIT
        # What wandering would leave: 0.45 of it times the spread of the angles (to third order).
        noise = (weights * even).sum(axis=0)
        seen = np.sqrt(noise) < _WANDER * 0.45 * size * spread
        seen &= found < (_WANDER * size) ** 2
        taken = (self._count[which] >= self._wanted[which]) & seen
        taken |= np.isfinite(self.center[which])
        taken &= ~contradicted
        pinned = which[taken]
        self.center[pinned] = (z_mean + arm * e_mean)[taken]
        self.arm[pinned] = arm[taken]
        self.variance[pinned] = found[taken]
        gone = np.zeros(len(self.center), bool)
        gone[which[contradicted]] = True
        self._leave(gone)

    def _leave(self, which: np.ndarray) -> None:
        """Take the bodies `which` (B,) off their pins; twice as much is wanted the next time."""
        left = which & np.isfinite(self.center)
        self._wanted[left] = np.minimum(2 * self._wanted[left], KEPT)
        self.forget(which)

    def forget(self, which: np.ndarray) -> None:
        """Look at the bodies `which` (B,) afresh: their poses up to now are of other shapes."""
        if which.any():
            self.center[which] = complex(np.nan, np.nan)
            self.arm[which] = 0.0
            self.variance[which] = np.nan
            self._count[which] = 0
            self._strikes[which] = 0


def _arm(z: Complex, e: Complex, weights: Real) -> tuple[Complex, Complex, Complex, Real]:
    """
    The arms (b,) to the pins of bodies at poses `z`, turned by `e` (T, b).

    Also the means of both, and the spread of the turns; the `weights` (T, b) add up to 1.
    """
    z_mean, e_mean = (weights * z).sum(axis=0), (weights * e).sum(axis=0)
    around = e - e_mean
    spread = (weights * np.abs(around) ** 2).sum(axis=0)
    return -(weights * (z - z_mean) * around.conj()).sum(axis=0) / spread, z_mean, e_mean, spread


def _spaced(angles: list[float]) -> list[int]:
    """Places of the first angle, and of each that is a step off the last one kept."""
    kept, last = [0], angles[0]
    for k, angle in enumerate(angles):
        if abs((angle - last + np.pi) % (2 * np.pi) - np.pi) > _STEP:
            kept.append(k)
            last = angle
    return kept
