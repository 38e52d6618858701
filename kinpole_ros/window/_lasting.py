"""
Noise that lasts: markers that were smoothed on their way err alike from frame to frame.

What residuals do between frames then says a quarter of their noise, or a hundredth, and figures are
fitted to the rest of it. So it is measured between the means of blocks of frames too, which is the
Hadamard variance of clocks: for white noise the same at any length, and for noise that lasts what
it counts for in a window. Blocks are much shorter than windows, lest what a lens does counts, which
changes with the motion.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._noise import KEPT, Noise

# So many blocks make a window; a block has no more frames than this.
_BLOCKS, _LONGEST = 12, 16
# It lasts where so many standard deviations below what was found is more than white noise.
_SURE = 4.0


class LastingNoise:
    """Noise of blocks of frames (m, per axis) of B bodies, as `Noise` is of single ones."""

    def __init__(self, bodies: int, window: int) -> None:
        self._bodies = bodies
        self._window = window
        self._start_anew(0)

    def _start_anew(self, length: int) -> None:
        self._length = length
        # Of the same frames as the noise it is held against, which may have been louder before.
        self._noise = Noise(self._bodies, KEPT // max(length, 1))
        # Frames that make no block yet, and whether it goes on from the one before.
        self._rest: tuple[Complex, Real] | None = None
        self._goes_on = False

    def add(self, stamps: np.ndarray, residual: Complex, freedom: Real, gaps: np.ndarray) -> None:
        """
        Take the fits of some frames, as `Noise` does, with their stamps (T,), ns.

        `gaps` (T,) is True for a frame that comes after a gap.
        """
        self._fit_length(stamps)
        if self._length < 2:
            return
        first = 0
        for end in (*gaps.nonzero()[0], len(gaps)):
            if end > first:
                self._add_run(residual[first:end], freedom[first:end])
            if end < len(gaps):
                self._rest, self._goes_on = None, False
            first = end

    def _fit_length(self, stamps: np.ndarray) -> None:
        """Blocks last as long as their share of the window; at another rate all begins anew."""
        if len(stamps) < 2:
            return
        frames = self._window / max(float(np.median(np.diff(stamps))), 1.0)
        length = min(max(1, round(frames / _BLOCKS)), _LONGEST)
        if not self._length / 1.5 <= length <= self._length * 1.5:
            self._start_anew(length)

    def _add_run(self, residual: Complex, freedom: Real) -> None:
        """Frames one after the other, without gaps."""
        run = residual, freedom
        if self._rest is not None and self._rest[0].shape[1:] == residual.shape[1:]:
            run = tuple(np.concatenate(pair) for pair in zip(self._rest, run, strict=True))
        count = len(run[0]) // self._length
        whole = count * self._length
        self._rest = run[0][whole:], run[1][whole:]
        if not count:
            return
        means, freedoms = (
            part[:whole].reshape(count, self._length, *part.shape[1:]).mean(axis=1) for part in run
        )
        goes_on = np.ones(count, bool)
        goes_on[0], self._goes_on = self._goes_on, True
        # As large as the residuals of single frames, if they are white.
        self._noise.add(np.sqrt(self._length) * means, freedoms, goes_on)

    def forget(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,), as `Noise` does."""
        self._noise.forget(which)

    def level(self, white: Real) -> Real:
        """Standard deviation (B,) of one coordinate: as it lasts, or `white` where it does not."""
        found = self._noise.level()
        # A standard deviation of n degrees of freedom has that of 1 / (2 n)^1/2 of it.
        sure = found * (1 - _SURE / np.sqrt(2 * np.maximum(self._noise.degrees(), 1.0)))
        return np.where(sure > white, found, white)
