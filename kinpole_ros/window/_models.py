"""
What is fitted to the windows about instants: polynomials, orthonormal on the samples.

So every coefficient has the noise of one sample and knows nothing of the others.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._ladder import HIGHEST_DEGREE, even_windows, windows_about
from kinpole_ros.window._polynomial import orthonormal_members


class Scale(NamedTuple):
    """
    Windows of one scale, made of means of `each` samples together, for long ones need no more.

    The B means start at the sample `start`; `root` (1 or G, B) are the square roots of their
    weights; `basis` (S, l, D, B) are the members of the l windows, orthonormal on the weighted
    means, and zero for means that are not `inside` (l, B). S is as in `models_of`.
    """

    each: int
    start: int
    root: Real
    basis: Real
    inside: np.ndarray


class Shortcut(NamedTuple):
    """
    A scale whose models are shared and used again and again, as one matrix.

    `matrix` (l D + R, B) makes of sums of samples the coefficients of the l windows, `members` in
    all, and below what the fits leave of each mean inside, window after window from the rows
    `starts` (l,) on.
    """

    matrix: Real
    members: int
    starts: np.ndarray


class Models(NamedTuple):
    """
    All fits of one set of M instants of G signals.

    Axes m and g are 1 where all instants, or all signals, share what has them, else M and G.
    """

    scales: tuple[Scale, ...]  # to project on; none once that is done
    shortcuts: tuple[Shortcut, ...]  # of the scales, where they pay
    rows: Real  # (m, g, L, K, D), derivatives of order 0 to K - 1 of the members at time 0
    rim: Real  # (L, K, m, g), the larger square of the last two members in each row
    own: Real  # (L, K, m, g), the square of the first member that each row knows
    lengths: np.ndarray  # (L, 1, g) samples with weight in each window
    freedom: np.ndarray  # (L, 1, g) means beyond the members of the richest fit
    highest: np.ndarray  # (L, 1, g) degree of the richest fit
    spans: Real  # (L, m, 1) s

    def at(self, instants: np.ndarray) -> 'Models':
        """The models of these instants, to evaluate and to judge by, not to project on."""
        if len(self.rows) == 1:
            return self
        return self._replace(
            rows=self.rows[instants],
            rim=self.rim[:, :, instants],
            own=self.own[:, :, instants],
            spans=self.spans[:, instants],
        )

    def of(self, signals: np.ndarray) -> 'Models':
        """The same of some signals."""
        if self.rows.shape[1] == 1:
            return self
        return self._replace(
            rows=self.rows[:, signals],
            rim=self.rim[..., signals],
            own=self.own[..., signals],
            lengths=self.lengths[..., signals],
            freedom=self.freedom[..., signals],
            highest=self.highest[..., signals],
        )


def models_of(times: np.ndarray, now: int, weights: Real | None, orders: int) -> Models:
    """
    Fit bases for every window of the ladder.

    In S sets: of samples at `times` (S, N) with weight 1, or at the same (1, N) with weights
    (S, N).
    """
    count = times.shape[1]
    windows = even_windows(now, count) if weights is None else windows_about(now, weights)
    scales, parts = [], []
    for each, start, first, last, inside, root, given, lengths, means, highest in windows:
        seconds = times[:, start : start + given.shape[-1]] * 1e-9
        spans = seconds[:, (last + 1) * each - 1] - seconds[:, first * each]
        unit = np.where(spans > 0, spans / 2, 1.0)[..., None]
        basis, rows = orthonormal_members(
            seconds[:, None] / unit, given, highest, HIGHEST_DEGREE + 1, orders - 1, each
        )
        rows = rows / unit[..., None] ** np.arange(orders)[:, None]
        scales.append(Scale(each, start, root, basis, inside))
        parts.append((rows, spans, lengths, means - highest - 1, highest))
    rows, *fields = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    spans, lengths, freedom, highest = (field.T for field in fields)  # (L, m or g)
    highest = highest[:, None]
    squares = np.square(rows).transpose(1, 2, 3, 0)  # (L, K, D, S)
    member = np.arange(rows.shape[-1])[:, None]
    near_rim = (member <= highest) & (member >= highest - 1)
    rim = np.where(near_rim[:, None], squares, 0.0).max(axis=2)
    index = np.arange(orders)
    # Sets as instants and signals.
    sets = len(times), 1 if weights is None else len(weights)
    return Models(
        tuple(scales),
        (),
        rows.reshape(*sets, *rows.shape[1:]),
        rim.reshape(*rim.shape[:2], *sets),
        squares[:, index, index].reshape(*rim.shape[:2], *sets),
        lengths[:, None],
        freedom[:, None],
        highest,
        spans[..., None],
    )


@lru_cache(maxsize=32)
def shared_models(times: bytes, now: int, orders: int) -> Models:
    """The models of equally weighted samples: even sampling asks for the same ones every frame."""
    models = models_of(np.frombuffer(times, np.int64)[None], now, None, orders)
    return models._replace(shortcuts=tuple(map(_shortcut, models.scales)))


def _shortcut(scale: Scale) -> Shortcut:
    """One product instead of two for each window (of 61 samples, 10 us instead of 17)."""
    basis = scale.basis[0]
    left = np.eye(basis.shape[-1]) - np.swapaxes(basis, -1, -2) @ basis
    # What lies outside of a window is none of what its fit leaves.
    rest = np.where(scale.inside[:, None], left, 0.0)[scale.inside]
    rows = scale.inside.sum(axis=-1)
    project = basis.reshape(-1, basis.shape[-1])
    matrix = np.concatenate((project, rest)) * (scale.root[0] / scale.each)
    return Shortcut(matrix, len(project), np.cumsum(rows) - rows)
