"""
What the signals of late were made of: the memory by which windows and degrees are judged.

A pose that jumps is in a window for as long as that is, and in averages over three windows it would
be for ten times as long: squares a million times what they were are forgotten after 14 times the
length of the memory. So what stands far out of its average is taken into it only when it has lasted
for longer than a window may hold one instant.
"""

from typing import Protocol

import numpy as np

from kinpole_ros.planar._plane import Real

# Squares of more than so many times their average are not taken for what goes on, until they last;
# an average is one from so many windows on.
_OUT, _SETTLED = 50.0, 2.0


class Past(Protocol):
    """
    Takes squares of some instants (L, D + 1, M, G), of coefficients and of what fits leave.

    `known` (L, M, G) says where they mean anything; `length` (L, G) or (L, 1) is the number of
    instants in a window, and an average goes `back` so many windows. Returns their means as of each
    instant, and (L, M, G) how many instants are in these.
    """

    def __call__(
        self, squares: Real, known: np.ndarray, length: Real, back: float
    ) -> tuple[Real, Real]: ...


class Spectrum:
    """What the signals of late were made of: mean energies by window, coefficient and signal."""

    def __init__(self) -> None:
        self._mean = np.zeros((0, 0, 0))
        self._count = np.zeros((0, 0))
        # For how many windows, running, squares have stood out.
        self._lasted = np.zeros((0, 0, 0))

    def forget(self, which: np.ndarray) -> None:
        """Begin anew with the bodies `which` (B,), of each of whom there are as many signals."""
        signals = np.resize(which, self._count.shape[1])
        self._mean[..., signals] = self._lasted[..., signals] = 0.0
        self._count[:, signals] = 0.0

    def follow(
        self, squares: Real, known: np.ndarray, length: Real, back: float
    ) -> tuple[Real, Real]:
        """Take the squares of some instants, one after the other: see `Past`."""
        levels, degrees, instants, groups = squares.shape
        if self._mean.shape[1] != degrees:
            self._mean, self._lasted = np.zeros((2, 0, degrees, groups))
            self._count = np.zeros((0, groups))
        # Signals asked for from now on come last, and those before them go on.
        kept, more = min(self._mean.shape[2], groups), max(groups - self._mean.shape[2], 0)
        if kept < groups or self._mean.shape[2] > groups:
            wider = (0, 0), (0, 0), (0, more)
            self._mean = np.pad(self._mean[:, :, :kept], wider)
            self._lasted = np.pad(self._lasted[:, :, :kept], wider)
            self._count = np.pad(self._count[:, :kept], ((0, 0), (0, more)))
        new = levels - len(self._count)
        if new > 0:
            unknown = np.zeros((new, degrees, groups))
            self._mean = np.concatenate((self._mean, unknown))
            self._lasted = np.concatenate((self._lasted, unknown))
            self._count = np.concatenate((self._count, np.zeros((new, groups))))
        count = self._count[:levels, None] + np.cumsum(known, axis=1)
        self._count[:levels] = count[:, -1]
        among = np.minimum(np.maximum(count, 1.0), back * length[:, None])
        gain = (known / among)[:, None]
        means = np.empty_like(squares)
        mean, lasted = self._mean[:levels], self._lasted[:levels]
        share = (known / length[:, None])[:, None]
        settled = (count > _SETTLED * length[:, None])[:, None]
        # An instant is in a window for its length, and may be in one more of those looked at.
        long = (1 + 1.5 / length)[:, None]
        # Each mean goes on from the one before: the one thing here that is not done all at once.
        for m in range(instants):
            now = squares[:, :, m]
            out = settled[:, :, m] & (now > _OUT * mean)
            if np.count_nonzero(out) or np.count_nonzero(lasted):
                np.multiply(lasted + share[:, :, m], out | ~known[:, None, m], out=lasted)
                now = np.where(out & (lasted < long), mean, now)
            mean += gain[:, :, m] * (now - mean)
            means[:, :, m] = mean
        return means, among
