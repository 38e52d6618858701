"""
Noise that lasts: markers that were smoothed on their way have the same error from frame to frame.

What residuals do between frames then says a quarter of their noise, or a hundredth, and figures are
fitted to the rest of it. So it is measured between the means of blocks of frames too, which is the
Hadamard variance of clocks (Baugh 1971): for white noise the same at any length, and for noise that
lasts what it counts for in a window. Blocks are much shorter than windows, lest what a lens does
counts, which changes with the motion.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._noise import Noise
from kinpole_ros.rigid.levels import KEPT, SURE

# So many blocks make a window; half a block has no more frames than this.
_BLOCKS, _LONGEST = 12, 8
# Where blocks have so many times the noise of their halves, longer ones had more still.
_RISES = 3.0


class LastingNoise:
    """
    Noise of blocks of frames (m, per axis) of B bodies, as `Noise` is of single ones.

    `window`, ns, is as long as the estimates'.
    """

    def __init__(self, bodies: int, window: int) -> None:
        self._bodies = bodies
        self._window = window
        self._start_anew(0)

    def _start_anew(self, half: int) -> None:
        self._half = half
        # Of the same frames as the noise they are held against, which may have been louder before.
        kept = KEPT // max(2 * half, 1)
        self._blocks, self._halves = Noise(self._bodies, kept), Noise(self._bodies, 2 * kept)
        # Frames that make no block yet, and whether the next block goes on from one before.
        self._rest: tuple[Complex, Real] | None = None
        self._goes_on = False

    def add(self, stamps: np.ndarray, residual: Complex, freedom: Real, gaps: np.ndarray) -> None:
        """
        Take the fits of some frames, with their stamps (T,), ns.

        `residual`, m, and `freedom` (T, B, n) are as of `Fit`; `gaps` (T,) is True for a frame that
        comes after a gap.
        """
        self._fit_length(stamps)
        if not self._half:
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
        half = min(round(frames / _BLOCKS / 2), _LONGEST)
        if not self._half / 1.5 <= half <= self._half * 1.5:
            self._start_anew(half)

    def _add_run(self, residual: Complex, freedom: Real) -> None:
        """Frames one after the other, without gaps."""
        run = residual, freedom
        if self._rest is not None and self._rest[0].shape[1:] == residual.shape[1:]:
            run = tuple(np.concatenate(pair) for pair in zip(self._rest, run, strict=True))
        count = len(run[0]) // (2 * self._half)
        whole = count * 2 * self._half
        self._rest = run[0][whole:], run[1][whole:]
        if not count:
            return
        goes_on = np.ones(2 * count, bool)
        goes_on[0], self._goes_on = self._goes_on, True
        means, freedoms = (part[:whole] for part in run)
        for noise, length in ((self._halves, self._half), (self._blocks, 2)):
            means, freedoms = (
                part.reshape(-1, length, *part.shape[1:]).mean(axis=1) for part in (means, freedoms)
            )
            # As large as the residuals of single frames, if they are white.
            means = np.sqrt(length) * means
            noise.add(means, freedoms, goes_on[: len(means)])

    def forget(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,), as `Noise` does."""
        for noise in (self._halves, self._blocks):
            noise.forget(which)

    def level(self, white: Real) -> Real:
        """
        Standard deviation (B,) of one coordinate of a marker, m.

        As it lasts, or `white` (B,), that of single frames, where it does not.
        """
        return np.where(self._lasts(white), self._blocks.level(), white)

    def longer(self, white: Real) -> np.ndarray:
        """Whether (B,) noise lasts so long that no more can be said of it than that it is more."""
        return self._lasts(white) & (self._blocks.level() > _RISES * self._halves.level())

    def _lasts(self, white: Real) -> np.ndarray:
        # A standard deviation of n degrees of freedom has that of 1 / (2 n)^1/2 of it.
        share = 1 - SURE / np.sqrt(2 * np.maximum(self._blocks.degrees(), 1.0))
        return np.asarray(self._blocks.level() * share > white)
