"""
Bodies that are not rigid: what markers that move against each other do to the figures.

Soft tissue wobbles, a lens bends what it sees, a loose marker or one off the plane moves with the
motion. All of that is slow, so no noise accounts for it, and part of it looks like a motion of the
body: of the 2n coordinates of n markers a rigid fit takes three and leaves 2n - 3 over. What it
leaves can be seen, and what it takes has as much error per degree of freedom, of the same spectrum.
So the residuals are differentiated by stencils of the span and degree by which the poses are, about
the same instant. Their mean squares, less what the noise makes of them, are the variances that the
poses' derivatives have in addition to those of the noise.
"""

from functools import lru_cache
from math import factorial
from statistics import NormalDist
from typing import TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._samples import Samples
from kinpole_ros.rigid.levels import KEPT, SURE

# Frames (T,) that are instants, and the oldest and newest in their windows.
Windows: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
# Stencils one after the other by this share of their length tell of different errors.
_INDEPENDENT = 1 / 2
# Stencils are looked at that start this share of their length after each other: closer ones tell
# no more.
_DISTANCE = 1 / 8
# And so many windows before this one: it has no room for two independent stencils of its length,
# and a variance of one degree of freedom is hardly known. Longer ago the motion may be another one.
_BEFORE = 1 / 2
# Nor do lengths in between the powers of this, to which those of stencils are rounded.
_LADDER = 1 + _DISTANCE
_DEGREES = 2, 8


class Deformation:
    """
    What the rigid fits of B bodies of up to `width` markers leave over, frame after frame.

    `freedom` (B,) is how many of a frame's residuals are free, 2n - 3, for bodies whose markers
    move against each other by more than their noise; 0 for those whose markers do not. `window`,
    ns, is as long as the estimates'. `since` (B,) is the first frame, counted from the first that
    was added, whose residuals are of the shapes of now.
    """

    def __init__(self, bodies: int, width: int, window: int) -> None:
        self._window = window
        self.freedom = np.zeros(bodies)
        # By how much noise gains where hidden markers are taken to stay where they were seen last.
        self.held = np.ones(bodies)
        self.since = np.zeros(bodies, np.int64)
        self._first = 0
        self._rows = Samples((bodies, width), complex)
        self._last = np.zeros((bodies, width), complex)
        # Frames in half a window, by which residuals are smoothed, and those of the last that make
        # no whole stencil yet.
        self._count = 4
        self._tail: tuple[np.ndarray, Complex] | None = None
        # Of how many frames, the squares of their rates of residuals times the interval, and which
        # shares of the markers are seen in them, in all.
        self._sums = np.zeros((3, bodies))
        self._free = np.zeros(bodies)

    def add(self, residual: Complex) -> None:
        """Take residuals (T, B, width), as of `Fit`."""
        rows = self._rows.room(len(residual))
        # What comes after must not change what was found before.
        rows[...] = _held(residual, self._last)
        self._last = rows[-1].copy()

    def drop(self, number: int) -> None:
        """Let go of the frames before `number`, counted from the first that was added."""
        count = number - self._first
        if count > 0:
            self._rows.drop(count)
            self._first += count

    def widen(self, width: int) -> None:
        """Let bodies have more markers, not seen up to now."""
        old, new = self._rows.view(), width - self._last.shape[1]
        wide = np.pad(old, ((0, 0), (0, 0), (0, new)))
        self._last = np.pad(self._last, ((0, 0), (0, new)))
        self._rows = Samples(wide.shape[1:], complex)
        self._rows.room(len(wide))[...] = wide
        self._tail = None

    def forget(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,): their residuals so far are of other shapes."""
        # Not zeroed: estimates of before may still be made.
        self.since[which] = self._first + len(self._rows.view())
        self._last[which] = 0.0
        self._sums[:, which] = self.freedom[which] = 0.0
        if self._tail is not None:
            self._tail[1][:, which] = 0.0

    def learn(
        self, stamps: np.ndarray, residual: Complex, freedom: Real, noise: Real, degrees: Real
    ) -> None:
        """
        See at a beat which bodies are deformed, by the fits of `stamps` (T,), ns, since the last.

        `residual` and `freedom` (T, B, n) are as of `Fit`; `noise` (B,), m, is that of one
        coordinate of a marker, NaN while not known, of so many `degrees` (B,) of freedom.
        """
        seen = ~np.isnan(residual)
        there = seen.any(axis=-1)
        free = freedom.sum(axis=-1).max(axis=0)
        # Of a body that is not seen now as before.
        self._free = free = np.where(free > 0, free, self._free)
        stamps, residual = self._with_tail(stamps, residual)
        count = self._count
        self._tail = stamps[1 - count :], residual[1 - count :]
        if len(residual) < count:
            return
        row = _stencils(count, (count - 1) // 2, 1, 1)[1]
        residual = residual[-(len(there) + count - 1) :]
        rates = sliding_window_view(residual, count, axis=0) @ row  # (F, B, n)
        there, seen = there[-len(rates) :], seen[-len(rates) :]
        squares = (rates.real**2 + rates.imag**2).sum(axis=-1)
        markers = np.maximum(seen.any(axis=0).sum(axis=-1), 1)
        new = there, np.where(there, squares, 0.0), seen.sum(axis=-1) / markers
        new = np.stack([part.sum(axis=0) for part in new])
        # Of as many frames as the noise.
        kept = np.clip(KEPT - new[0], 0, self._sums[0]) / np.maximum(self._sums[0], 1)
        self._sums = kept * self._sums + new
        frames, squares, markers_seen = self._sums
        with np.errstate(divide='ignore', invalid='ignore'):
            # Samples that hold for random times, by the mean of their squares over their mean.
            self.held = np.where(frames > 0, 2 * frames / markers_seen - 1, 1.0)
            sure = chi_square(free * frames / (_INDEPENDENT * count), SURE)
            sure = sure / chi_square(degrees, -SURE)
            most = frames * free * (row @ row) * self.held * noise**2 * sure
            self.freedom = np.where(squares > most, free, 0.0)

    def _with_tail(self, stamps: np.ndarray, residual: Complex) -> tuple[np.ndarray, Complex]:
        """
        Residuals with those before that make no whole stencil, and markers held that are hidden.

        At another rate all begins anew.
        """
        before = np.zeros_like(residual[0]) if self._tail is None else self._tail[1][-1]
        residual = _held(residual, before)
        if self._tail is not None:
            stamps = np.concatenate((self._tail[0], stamps))
            residual = np.concatenate((self._tail[1], residual))
        interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else self._window / 2
        count = max(4, round(self._window / 2 / max(interval, 1.0)))
        if not self._count / 1.5 <= count <= self._count * 1.5:
            self._count = count
            self._sums[...] = 0.0
        return stamps, residual

    def covariance(
        self,
        windows: Windows,
        interval: Real,
        span: Real,
        degree: Real,
        noise: Real,
        freedom: Real,
        since: np.ndarray,
        order: int,
    ) -> Real:
        """
        Covariances (order + 1, order + 1, T, B) of derivatives of the slow residuals, (m/s^k)^2.

        They are those of one coordinate, per degree of freedom, at the frames `windows[0]` (T,), by
        those from half a window before `windows[1]` to before `windows[2]`, which may be yet to
        come; all are counted from the first that was added. `interval` (T,) is that between frames,
        s; `span`, s, and `degree` (T, B) are those of the stencils; `noise` (T, B) is that of a
        coordinate; `freedom` and `since` (T, B) as above, at that time, freedom 0 for what is not
        asked for and comes out 0.
        """
        _, oldest, newest = windows
        held = newest - oldest
        begin = np.maximum(oldest - np.rint(_BEFORE * held).astype(int), 0)
        found = np.zeros((order + 1, order + 1, *span.shape))
        asked = (freedom > 0) & np.isfinite(span) & (held[:, None] > _DEGREES[0] + 1)
        if not np.count_nonzero(asked):
            return found
        keys = _keys(windows, interval, span, degree, asked)
        for key in np.unique(keys[asked], axis=0).tolist():
            count = key[0]
            rows = _stencils(*key, order)
            gained = rows @ rows.T
            instants, bodies = (asked & (keys == key).all(axis=-1)).nonzero()
            who, place = np.unique(bodies, return_inverse=True)
            # Stencils start at multiples of a step, up to before the last frame.
            step = max(1, round(_DISTANCE * count))
            end = newest[instants] - count + 1
            last = -(-end // step)
            own = since[instants, bodies]
            first = np.minimum(-(-np.maximum(begin[instants], own) // step), last - 1)
            products = self._products(first.min() * step, end.max(), step, who, rows)
            bounds = np.stack((first, last), axis=1).reshape(-1) - first.min()
            sums = np.add.reduceat(products, bounds, axis=0)[::2]
            sums = sums[np.arange(len(sums)), place.reshape(-1)]
            free, looked = freedom[instants, bodies], last - first
            # Of frames enough for a stencil, or nothing is known yet.
            mean = sums * (first * step >= own)[:, None, None] / (looked * free)[:, None, None]
            white = noise[instants, bodies] ** 2 * np.diag(gained)[:, None]
            squares = np.einsum('tkk->kt', mean)
            with np.errstate(divide='ignore', invalid='ignore'):
                share = np.sqrt(np.where(squares > white, 1 - white / squares, 0.0))
            independent = 1 + (looked - 1) * step / (_INDEPENDENT * count)
            share *= np.sqrt(student(free * independent))
            share /= interval[instants] ** np.arange(order + 1.0)[:, None]
            found[:, :, instants, bodies] = share * share[:, None] * mean.transpose(1, 2, 0)
        return found

    def _products(self, start: int, end: int, step: int, bodies: np.ndarray, rows: Real) -> Real:
        """
        Sums (F + 1, b, K, K) over markers of products of derivatives of some bodies' residuals.

        By stencils `rows` (K, n) that start at every `step` from `start` to before `end`; the last
        are zeros.
        """
        count = rows.shape[1]
        part = self._rows.view()[start - self._first : end - self._first + count - 1, bodies]
        flat = part.reshape(len(part), -1)
        derived = sliding_window_view(flat, count, axis=0)[::step] @ rows.T
        derived = derived.reshape(len(derived), len(bodies), -1, len(rows))
        products = np.zeros((len(derived) + 1, len(bodies), len(rows), len(rows)))
        products[:-1] = (derived.swapaxes(-1, -2) @ derived.conj()).real
        return products


def _keys(
    windows: Windows,
    interval: Real,
    span: Real,
    degree: Real,
    asked: np.ndarray,
) -> Real:
    """How many samples stencils have, how many of them ahead, and their degrees, (T, B, 3)."""
    now, oldest, newest = windows
    least, most = _DEGREES
    each = np.where(asked, span, 0.0) / interval[:, None] + 1
    degree = np.maximum(np.where(asked, degree, 0.0), least)
    degrees = np.minimum(np.rint(degree), most)
    # One of a lower degree that is shorter by as much follows as fast a motion.
    each *= (degrees + 1) / (degree + 1)
    each = _LADDER ** np.rint(np.log(each) / np.log(_LADDER))
    degrees = np.minimum(degrees, (newest - oldest - 2)[:, None])
    counts = np.clip(np.rint(each), degrees + 2, (newest - oldest)[:, None])
    ahead = np.minimum((counts - 1) // 2, (newest - now)[:, None])
    return np.stack((counts, ahead, degrees), axis=-1).astype(int)


def _held(values: Complex, before: Complex) -> Complex:
    """Values (T, B, n), as they were last where they are NaN; `before` (B, n) they were so."""
    hidden = np.isnan(values)
    if not np.count_nonzero(hidden):
        return values
    place = np.where(hidden, 0, np.arange(1, len(values) + 1)[:, None, None])
    place = np.maximum.accumulate(place, axis=0)
    return np.take_along_axis(np.concatenate((before[None], values)), place, axis=0)


@lru_cache(maxsize=512)
def _stencils(count: int, ahead: int, degree: int, order: int) -> Real:
    """
    Rows (order + 1, count) that differentiate samples at steps of 1, `ahead` before the last.

    By local polynomials of `degree`, or of the derivative's order where that is higher.
    """
    places = (np.arange(count) - (count - 1 - ahead)) / count
    rows = []
    for k in range(order + 1):
        basis = np.vander(places, min(max(degree, k), count - 1) + 1, increasing=True)
        row = np.linalg.pinv(basis)[k] if k < count else np.zeros(count)
        rows.append(row * factorial(k) / float(count) ** k)
    return np.array(rows)


def student(freedom: Real) -> Real:
    """
    Square of the 95% limit of Student's t of `freedom` (...) over that of a normal distribution.

    A variance that is measured has errors of its own: figures are to be within 1.96 deviations as
    often. By the expansion of Cornish and Fisher (Hill 1970, ACM algorithm 396), second order.
    """
    z = NormalDist().inv_cdf(0.975)
    first, second = (z**2 + 1) / 4, (5 * z**4 + 16 * z**2 + 3) / 96
    return np.asarray((1 + (first + second / freedom) / freedom) ** 2)


def chi_square(freedom: Real, deviations: float) -> Real:
    """
    What a chi-square of `freedom` (...) over that is at so many deviations (Wilson and Hilferty).

    For less than 1 degree as for 1.
    """
    part = 2 / (9 * np.maximum(freedom, 1.0))
    return np.asarray(np.maximum(1 - part + deviations * np.sqrt(part), 0.0) ** 3)
