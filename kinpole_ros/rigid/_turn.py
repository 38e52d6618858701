"""
How bodies have turned of late, to see when one seems to jump by half a turn.

That is what the markers of a symmetric body look like when they are exchanged: no residual tells.
"""

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.rigid.levels import FEW, RECENT

# So many frames are worked in at once.
_TOGETHER = 20
# rad. A body has jumped if it is turned this far from where it was to be; known while it turns by
# less than the other per frame, and did so for a few.
_HALF_TURN, _SLOW = 0.75 * np.pi, 0.25 * np.pi


class Turns:
    """The last angles of B bodies, how fast they turned, and for how long slowly."""

    def __init__(self, bodies: int) -> None:
        # The last angle found, the turn per frame that led to it, and how many frames ago that was.
        self._angle = np.full(bodies, np.nan)
        self._turning = np.full(bodies, np.nan)
        self._ago = np.ones(bodies, int)
        self._calm = np.zeros(bodies, int)
        # What is not worked in yet: only a jump, or a lost body, needs more than the last angles.
        self._news: list[Real] = []
        self._last = self._angle

    def forget(self) -> None:
        """Do not expect the next angles to go on from those before a gap."""
        self._work()
        self._angle = self._last = np.full_like(self._angle, np.nan)

    def ahead(self) -> Real:
        """The angles (B,) that are to be expected in the next frame, NaN where nothing tells."""
        self._work()
        turned = np.where(np.isfinite(self._turning), self._turning * self._ago, 0.0)
        return np.asarray(np.where(self._ago <= RECENT, self._angle + turned, np.nan))

    def jumped(self, angle: Real) -> np.ndarray:
        """Which bodies (B,) have jumped by half a turn in the next frame, NaN for none seen."""
        self._work()
        ahead = self._turning * self._ago
        far = np.abs(_wrapped(angle - self._angle - ahead)) > _HALF_TURN
        calm = (np.abs(ahead) < _SLOW) & (self._ago <= RECENT) & (self._calm >= FEW)
        return np.asarray(far & calm)

    def may_jump(self, angle: Real) -> np.ndarray:
        """In which of the next frames (T,) a body may have jumped, by its angles (T, B)."""
        before = self._last[None] if len(angle) == 1 else self._before(angle)[0]
        return np.logical_or.reduce(np.cos(angle - before) < np.cos(_HALF_TURN - _SLOW), -1)

    def follow(self, angle: Real) -> None:
        """Take the angles (T, B) of the next frames, NaN for a body not seen."""
        self._news.append(angle)
        self._last = angle[-1]
        if len(self._news) == _TOGETHER or np.count_nonzero(np.isnan(self._last)):
            self._work()

    def _work(self) -> None:
        """Bring everything up to the last angles."""
        if not self._news:
            return
        angle, self._news = np.concatenate(self._news), []
        fitted = np.isfinite(angle)
        before, ago = self._before(angle)
        turning = _wrapped(angle - before) / ago
        slow = (np.abs(turning) < _SLOW) & (ago <= RECENT)
        # What is not seen in between may have turned by any number of revolutions.
        number = np.arange(1, len(angle) + 1)[:, None]
        broken = (number * (fitted & ~slow)).max(axis=0)
        calm = (fitted & (ago == 1) & (number > broken)).sum(axis=0)
        self._calm = calm + np.where(broken > 0, 0, self._calm)
        last = (number * fitted).max(axis=0)
        seen, row = last > 0, np.maximum(last - 1, 0)
        body = np.arange(angle.shape[1])
        self._turning = np.where(seen, turning[row, body], self._turning)
        self._angle = np.where(seen, angle[row, body], self._angle)
        self._ago = np.where(seen, len(angle) - row, self._ago + len(angle))
        self._last = self._angle

    def _before(self, angle: Real) -> tuple[Real, np.ndarray]:
        """The last angles (T, B) found before each frame, and how many frames ago that was."""
        self._work()
        all_angles = np.concatenate((self._angle[None], angle[:-1]))
        number = np.arange(len(angle))[:, None]
        found = np.where(np.isfinite(all_angles), number, 0)
        row = np.maximum.accumulate(found, axis=0)
        ago = number + 1 - row + np.where(row == 0, self._ago - 1, 0)
        return np.take_along_axis(all_angles, row, axis=0), ago


def _wrapped(angle: Real) -> Real:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
