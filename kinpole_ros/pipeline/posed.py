"""
Bodies whose poses come as such, in place of markers.

Each stands for three points fixed to it, which fit exactly: so planes, gaps, wrong frames, pins and
hubs are treated as those of markers. Noise is that of the poses, and so is what goes by it.
"""

from collections import Counter

import numpy as np

from kinpole_ros.pipeline.bodies import UNSTEADY, News, RigidBodies
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.roster import Roster
from kinpole_ros.planar import Fit
from kinpole_ros.rigid import PoseNoise, Verdict


class PosedBodies(RigidBodies):
    """
    B bodies as learned from their poses.

    All that goes by the noise of markers goes by that of the point whose error is independent of
    the angle's, and all that goes by their size by the arm that makes the one of the other.
    """

    def __init__(
        self, settings: Settings, window: int, roster: Roster, counts: Counter[str]
    ) -> None:
        super().__init__(settings, window, roster, counts)
        self._poses = PoseNoise(self._count)
        # The headings (1, B), rad, and tilts of the last frames that are sure.
        self._heading = np.full((1, self._count), np.nan)
        self._tilt = np.full((1, self._count), complex(np.nan, np.nan))
        # By how much (B,), rad, bodies turned about the normal beyond the turn of their headings
        # since they were first seen, up to the last of these frames and up to the last beat.
        self.extra_turn, self._extra_turn_learned = np.zeros((2, self._count))

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate, m, given or measured; NaN while not known."""
        if self._given > 0:
            return np.where(np.isnan(self._poses.angle), np.nan, self._given)
        return self._poses.position

    def angle_noise(self) -> np.ndarray:
        """Noise (B,) of the angles, rad; NaN while not known."""
        return self._poses.angle

    def noise_underestimated(self) -> np.ndarray:
        """Which bodies (B,) have more noise than can be measured: see `PoseNoise`."""
        return self._poses.underestimated & (self._given == 0)

    def _known_now(self) -> int:
        fresh = self._learned
        row = super()._known_now()
        if fresh:
            known, free = self._known.view()[-1], np.isnan(self._pins.center)
            known['orientation_observable'] = self._poses.angle < UNSTEADY
            # Errors there are independent, as they are taken to be.
            free &= self._references.point == 0
            known['reference'] = np.where(free, self._poses.middle, known['reference'])
            known['middle'] = self._poses.middle
            known['extra_turn'] = self._extra_turn_learned
        return row

    def _fit(
        self, rows: np.ndarray, points: np.ndarray, heights: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, Verdict]:
        found = super()._fit(rows, points, heights, gaps)
        self._add_extra_turn(rows)
        return found

    def _add_extra_turn(self, rows: np.ndarray) -> None:
        """
        Fill in by how much bodies turned about the normal beyond the turn of their headings.

        Each step is that of a constant angular velocity since the last sure frame.
        """
        seen = rows['information'][:, : self._count] > 0
        sure = seen & (rows['suspect'] == 0)
        # A frame that is not sure must not change the turn of those that follow.
        number = np.arange(1, len(rows) + 1)[:, None]
        last = np.maximum.accumulate(np.where(sure, number, 0), axis=0)
        before = np.concatenate((np.zeros_like(last[:1]), last[:-1]))
        heading = np.concatenate((self._heading, rows['poses'][:, : self._count, 0]))
        tilt = np.concatenate((self._tilt, rows['tilt']))
        step = _extra_turns(
            np.take_along_axis(tilt, before, axis=0),
            tilt[1:],
            heading[1:] - np.take_along_axis(heading, before, axis=0),
        )
        steps = np.concatenate((self.extra_turn[None], np.where(sure, step, 0.0)))
        total = steps.cumsum(axis=0)[1:]
        rows['extra_turn'] = np.where(seen & ~sure, total + step, total)
        self.extra_turn = total[-1]
        self._heading, self._tilt = (
            np.take_along_axis(each, last[-1:], axis=0) for each in (heading, tilt)
        )

    def _learn_noise(self, news: News) -> None:
        self._poses.add(news.stamps, news.position, news.angle)
        self._extra_turn_learned = self.extra_turn
        self._shapes.learn()

    def _misfit(self) -> np.ndarray:
        return np.asarray(self.noise() ** 2)

    def _size(self) -> np.ndarray:
        return np.asarray(2 * self._arm())

    def _arm(self) -> np.ndarray:
        """How far (B,), m, markers with such noise would be from their mean."""
        return np.asarray(self.noise() / self._poses.angle)

    def _least_spread(self) -> np.ndarray:
        # Points that stand for a pose are seen together.
        return np.zeros(self._count)

    def _information(self, fit: Fit) -> np.ndarray:
        return np.ones((len(fit.angle), 2 * self._count))

    def _scale(self) -> np.ndarray:
        square, nearer = self._arm() ** 2, np.abs(self._poses.middle) ** 2
        scale = np.concatenate((square, square / (square + nearer)))
        return np.where(np.isnan(scale), 1.0, scale)

    def _middle(self, fit: Fit | None = None) -> np.ndarray:
        return self._poses.middle


def _extra_turns(before: np.ndarray, after: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """
    Compute how far bodies turned about the normal beyond the turn of their headings.

    The heading is the twist about the normal in the swing-twist decomposition. While a body is
    tilted, its rate is not the angular velocity along the normal, and the integral of the
    difference depends on the path: it does not return to zero with the pose.

    Parameters
    ----------
    before, after : array, shape (T, B), complex
        The tilts at the begin and the end of a rotation with constant angular velocity, as
        `Roster.tilts` returns them; NaN where not known.
    heading : array, shape (T, B), rad
        The change of the heading.

    Returns
    -------
    array, shape (T, B), rad
        The rotation vector along the normal less the change of the heading; 0 where not known.
    """
    # The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`.
    cosines = [np.sqrt(np.maximum(1 - np.abs(tilt) ** 2, 0.0)) for tilt in (before, after)]
    ahead = cosines[0] * cosines[1] + after * before.conj()
    across = np.abs(cosines[0] * after - cosines[1] * before)
    turn = (heading + np.pi) % (2 * np.pi) - np.pi
    along = ahead * np.exp(0.5j * turn)
    sine = np.hypot(along.imag, across)
    with np.errstate(divide='ignore', invalid='ignore'):
        half = np.arctan2(sine, along.real) * (along.imag / sine)
        extra = 2 * np.angle(ahead) + 2 * (half - np.angle(along))
    return np.asarray(np.nan_to_num(extra))
