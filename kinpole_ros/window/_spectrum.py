"""What the signals of late were made of: the memory by which windows and degrees are judged."""

from typing import Protocol

import numpy as np

from kinpole_ros.planar._plane import Real


class Past(Protocol):
    """
    Takes squares of some instants (L, D + 1, M, G), of coefficients and of what fits leave.

    `known` (L, M, G) says where they mean anything; `memory` (L, G) or (L, 1) is the number of
    instants that an average goes back. Returns their means as of each instant, and (L, M, G) how
    many instants are in these.
    """

    def __call__(self, squares: Real, known: np.ndarray, memory: Real) -> tuple[Real, Real]: ...


class Spectrum:
    """What the signals of late were made of: mean energies by window, coefficient and signal."""

    def __init__(self) -> None:
        self._mean = np.zeros((0, 0, 0))
        self._count = np.zeros((0, 0))

    def forget(self, which: np.ndarray) -> None:
        """Begin anew with the bodies `which` (B,), of each of whom there are as many signals."""
        signals = np.resize(which, self._count.shape[1])
        self._mean[..., signals] = 0.0
        self._count[:, signals] = 0.0

    def follow(self, squares: Real, known: np.ndarray, memory: Real) -> tuple[Real, Real]:
        """Take the squares of some instants, one after the other: see `Past`."""
        levels, degrees, instants, groups = squares.shape
        if self._mean.shape[1] != degrees:
            self._mean = np.zeros((0, degrees, groups))
            self._count = np.zeros((0, groups))
        # Signals asked for from now on come last, and those before them go on.
        kept, more = min(self._mean.shape[2], groups), max(groups - self._mean.shape[2], 0)
        if kept < groups or self._mean.shape[2] > groups:
            self._mean = np.pad(self._mean[:, :, :kept], ((0, 0), (0, 0), (0, more)))
            self._count = np.pad(self._count[:, :kept], ((0, 0), (0, more)))
        new = levels - len(self._count)
        if new > 0:
            self._mean = np.concatenate((self._mean, np.zeros((new, degrees, groups))))
            self._count = np.concatenate((self._count, np.zeros((new, groups))))
        count = self._count[:levels, None] + np.cumsum(known, axis=1)
        self._count[:levels] = count[:, -1]
        among = np.minimum(np.maximum(count, 1.0), memory[:, None])
        gain = (known / among)[:, None]
        means = np.empty_like(squares)
        mean = self._mean[:levels]
        # Each mean goes on from the one before: the one thing here that is not done all at once.
        for m in range(instants):
            mean += gain[:, :, m] * (squares[:, :, m] - mean)
            means[:, :, m] = mean
        return means, among
