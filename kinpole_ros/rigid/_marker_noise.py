"""
Each marker's own noise: one that errs far more than the others of its body counts for less.

Residuals of a fit say little by themselves of which marker errs, for the fit shares the errors out.
So each marker is held against a fit of the others, which it does not touch, and both variances are
reckoned with the degrees of freedom they have (Rao 1970, of variance components). The markers that
agree least are taken out one by one, and those stay out that differ for sure from all that is left.

Noise from frame to frame and what lasts, as in a marker that slips, are looked at separately:
figures average the one over many frames, and not the other, so what lasts weighs more.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# Frames looked at, the fewest, and how many frames are averaged to see what lasts.
_KEPT, _FEWEST, _BLOCK = 512, 64, 8
# More markers than these are a body that no single one of them spoils.
_MOST = 32
# A marker counts for less whose variance is so many times that of the others, less so many standard
# deviations of the logarithm; and no more when it is below the lower one.
_MORE, _LASTS, _SURE, _NO_MORE = 2.0, 4.0, 4.0, 1.5
# One marker in so many may count for less: where more do not agree they are of several links.
_FEW = 4
# Variances below this share of the square of a body's size are rounding.
_TINY = 1e-12
# Weights stay as they are while variances change by no more than this factor.
_SAME = 1.5
# Nobody needs to look closer while no marker leaves so many times what the middle one leaves.
_SUSPICIOUS = 1.4
# Where another choice of markers leaves less than so many times as much, either may err.
_CLEAR = 2.0


class Share(NamedTuple):
    """What a marker errs over the others: variances over theirs, and how sure (as logarithms)."""

    ratio: float
    deviation: float


class MarkerNoise:
    """
    Variances of markers of B bodies of up to n, over that of those of their body that agree.

    `relative` (B, n) are these, 1 for nearly all, as fits are to weigh them; `deviation` (B, n), m,
    per axis, are those of the markers that count for less, 0 for the others.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.relative = np.ones((bodies, markers))
        self.deviation = np.zeros((bodies, markers))
        self._start_anew()

    def _start_anew(self) -> None:
        bodies, markers = self.relative.shape
        self._residual = np.full((0, bodies, markers), complex(np.nan, np.nan))
        self._goes_on = np.zeros(0, bool)
        self._freedom = np.zeros((0, bodies, markers))

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers."""
        more = ((0, 0), (0, markers - self.relative.shape[1]))
        self.relative = np.pad(self.relative, more, constant_values=1.0)
        self.deviation = np.pad(self.deviation, more)
        self._start_anew()

    def forget(self, which: np.ndarray) -> None:
        """Forget markers `which` (B, n), or (B, 1): they sit elsewhere, or are others now."""
        which = np.broadcast_to(which, self.relative.shape)
        self._residual[:, which] = complex(np.nan, np.nan)
        self.relative[which], self.deviation[which] = 1.0, 0.0

    def learn(
        self, residual: Complex, freedom: Real, goes_on: np.ndarray, shape: Complex
    ) -> np.ndarray:
        """
        Take the fits of some frames, at a beat, and look at the markers.

        `residual`, m, and `freedom` (T, B, n) are as of `Fit`, `shape` (B, n) is where the markers
        are, m; `goes_on` (T,) is False for a frame after a gap. Returns of which bodies (B,) other
        markers count for less from now on.
        """
        changed = np.zeros(len(self.relative), bool)
        if self.relative.shape[1] > _MOST:
            return changed
        some = slice(-_KEPT, None)
        self._residual = np.concatenate((self._residual, residual))[some]
        self._freedom = np.concatenate((self._freedom, freedom))[some]
        self._goes_on = np.concatenate((self._goes_on, goes_on))[some]
        if len(self._residual) < _FEWEST:
            return changed
        for b in np.flatnonzero(self._suspicious()).tolist():
            changed[b] = self._look(b, shape[b])
        return changed

    def refitted(self, b: int, shape: Complex) -> tuple[Complex, Real, np.ndarray]:
        """
        What `learn` was given (T, 1, n) of one body's late frames, as fitted with its weights now.

        Without the markers that count for less.
        """
        residual = self._residual[:, b]
        left, freedom = _refit(residual, shape, self.relative[b] == 1)
        return left[:, None], freedom[:, None], self._goes_on

    def _suspicious(self) -> np.ndarray:
        """Which bodies (B,) have markers that leave more than others, or count for less."""
        seen = ~np.isnan(self._residual)
        squares = np.where(seen, self._residual.real**2 + self._residual.imag**2, 0).sum(axis=0)
        freedom = np.where(seen, self._freedom, 0).sum(axis=0)
        some = freedom > 0.1 * _FEWEST
        left = np.where(some, squares / np.where(some, freedom, 1.0), np.nan)
        count = some.sum(axis=1)
        # Their median, for which nanmedian takes ten times as long: NaN come last.
        ranked, each, half = np.sort(left, axis=1), np.arange(len(left)), count // 2
        middle = (ranked[each, np.maximum(count - 1, 0) // 2] + ranked[each, half]) / 2
        with np.errstate(invalid='ignore'):
            odd = np.fmax.reduce(left, axis=1) > _SUSPICIOUS * middle
        three = count >= 3
        return np.asarray((odd & three) | (self.relative != 1).any(axis=1))

    def _look(self, b: int, shape: Complex) -> bool:
        """Weigh the markers of one body; whether they count otherwise from now on."""
        residual = self._residual[:, b]
        bend = residual[1:-1] - (residual[:-2] + residual[2:]) / 2
        bend[~(self._goes_on[1:-1] & self._goes_on[2:])] = complex(np.nan, np.nan)
        kinds = bend / np.sqrt(1.5), _blocks(residual)
        bad = _worst(kinds, shape)
        old = self.relative[b]
        new, deviation = np.ones(len(old)), np.zeros(len(old))
        good = np.array([k not in bad for k in range(len(old))])
        # Those that count for less do so until they surely need not.
        for k in {*bad, *np.flatnonzero(old > 1).tolist()}:
            rest = good.copy()
            rest[k] = False
            ratio = max(_share(kind, shape, rest, k)[0].ratio for kind in kinds)
            if k in bad or ratio > _NO_MORE:
                new[k] = max(ratio, 1.0)
                share, variance = _share(residual, shape, rest, k)
                deviation[k] = np.sqrt(max(share.ratio, 0.0) * variance)
        same = (old > 1) & (new > 1) & (np.abs(np.log(new / old)) < np.log(_SAME))
        self.relative[b] = np.where(same, old, new)
        self.deviation[b] = deviation
        return bool(((old > 1) != (new > 1)).any())


def _blocks(residual: Complex) -> Complex:
    """Means of blocks of frames (T, n), as large as single residuals if they are white."""
    count = len(residual) // _BLOCK
    parts = residual[len(residual) - count * _BLOCK :].reshape(count, _BLOCK, -1)
    seen = (~np.isnan(parts)).sum(axis=1)
    total = np.where(np.isnan(parts), 0, parts).sum(axis=1)
    enough = seen > _BLOCK // 2
    return np.where(enough, total / np.sqrt(np.maximum(seen, 1)), complex(np.nan, np.nan))


def _worst(kinds: tuple[Complex, ...], shape: Complex) -> list[int]:
    """The markers that err more than those left, by some kind of residuals (T, n)."""
    seen = np.logical_and.reduce([(~np.isnan(kind)).any(axis=0) for kind in kinds])
    found: list[int] = []
    if seen.sum() < 3:
        return found
    for kind, more in zip(kinds, (_MORE, _LASTS), strict=True):
        rest, out = seen.copy(), []
        best: list[int] = []
        for _ in range(max(1, int(seen.sum()) // _FEW)):
            each = []
            for k in np.flatnonzero(rest).tolist():
                some = rest.copy()
                some[k] = False
                each.append((_share(kind, shape, some, k)[1], k))
            left, k = min(each)
            if not np.isfinite(left):
                break
            rest[k] = False
            out.append(k)
            shares = [_share(kind, shape, rest, k)[0] for k in out]
            if all(s.ratio > more * np.exp(_SURE * s.deviation) for s in shares):
                best = out.copy()
        if best and _is_clear(kind, shape, seen, best):
            found += [k for k in best if k not in found]
    return found if len(found) <= max(1, int(seen.sum()) // _FEW) else []


def _is_clear(kind: Complex, shape: Complex, seen: np.ndarray, bad: list[int]) -> bool:
    """Whether no other marker might be meant in place of one of these."""
    good = seen.copy()
    good[bad] = False
    left = _pooled(kind, shape, good)[0]
    for k in bad:
        for other in np.flatnonzero(good):
            swapped = good.copy()
            swapped[k], swapped[other] = True, False
            if _pooled(kind, shape, swapped)[0] < _CLEAR * left:
                return False
    return True


def _share(kind: Complex, shape: Complex, rest: np.ndarray, k: int) -> tuple[Share, float]:
    """What marker `k` errs over the `rest` (n,), and the variance of these, per axis."""
    variance, degrees, off, lever = _pooled(kind, shape, rest, k)
    count = int((~np.isnan(off)).sum())
    if not (count and variance > 0):
        return Share(0.0, np.inf), variance
    square = np.nanmean(off.real**2 + off.imag**2) / 2
    own = square - variance * np.nanmean(np.where(np.isnan(off), np.nan, lever)) / 2
    # As if two thirds of the frames were told apart: neighbors are in each other's bends.
    spread = 1.5 * ((square / own) ** 2 / count + 2 / degrees) if own > 0 else np.inf
    return Share(float(own / variance), float(np.sqrt(spread))), variance


def _pooled(
    kind: Complex, shape: Complex, rest: np.ndarray, k: int = 0
) -> tuple[float, float, Complex, Real]:
    """
    Variance, per axis, of the markers `rest` (n,) about fits to them alone, and its degrees.

    Also what marker `k` is off these fits (T,), and the variance of where they have it over that of
    a coordinate, of both axes.
    """
    seen, mean, middle, arms, spread, turn, about = _fit(kind, shape, rest)
    left = np.where(seen, about - 1j * turn[:, None] * arms, 0)
    total = seen.sum(axis=1)
    enough = total >= 2
    degrees = float((2 * total[enough] - 3).sum())
    squares = float((left.real**2 + left.imag**2)[enough].sum())
    arm = shape[k] - middle
    off = kind[:, k] - mean - 1j * turn * arm
    lever = 2 / np.maximum(total, 1) + np.abs(arm) ** 2 / spread
    variance = squares / degrees if degrees > 0 else np.inf
    # Of several markers, wherever they are seen.
    variance += _TINY * float(spread[np.isfinite(spread)].max(initial=0.0))
    return variance, degrees, np.where(enough, off, np.nan), lever


def _refit(residual: Complex, shape: Complex, rest: np.ndarray) -> tuple[Complex, Real]:
    """Residuals (T, n) of the markers `rest` (n,) fitted by themselves, and their freedom."""
    seen, _, _, arms, spread, turn, about = _fit(residual, shape, rest)
    left = np.where(seen, about - 1j * turn[:, None] * arms, complex(np.nan, np.nan))
    total = np.maximum(seen.sum(axis=1, keepdims=True), 1)
    taken = 2 / total + (arms.real**2 + arms.imag**2) / spread[:, None]
    return left, np.where(seen, np.maximum(2 - taken, 0), 0)


def _fit(
    values: Complex, shape: Complex, rest: np.ndarray
) -> tuple[np.ndarray, Complex, Complex, Complex, Real, Real, Complex]:
    """
    Small shifts and turns (T,) of a body that fit what its markers `rest` are off (T, n) best.

    Returns where they are seen (T, n), the shifts, the means (T,) of their places, their arms from
    these (T, n), the sums of the squares of those, the turns, and what the shifts leave (T, n).
    """
    seen = ~np.isnan(values) & rest
    total = np.maximum(seen.sum(axis=1), 1)
    mean = np.where(seen, values, 0).sum(axis=1) / total
    middle = np.where(seen, shape, 0).sum(axis=1) / total
    arms = np.where(seen, shape - middle[:, None], 0)
    about = np.where(seen, values - mean[:, None], 0)
    spread = (arms.real**2 + arms.imag**2).sum(axis=1)
    spread = np.where(spread > 0, spread, np.inf)
    # They are small: a turn adds what is linear in it.
    turn = (arms.conj() * about).imag.sum(axis=1) / spread
    return seen, mean, middle, arms, spread, turn, about
