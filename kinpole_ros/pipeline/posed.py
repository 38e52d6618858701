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
from kinpole_ros.rigid import PoseNoise


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
        return row

    def _learn_noise(self, news: News) -> None:
        self._poses.add(news.stamps, news.position, news.angle)
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
