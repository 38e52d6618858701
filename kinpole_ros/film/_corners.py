"""
Corners of tags to parts of a pixel: the known code of a tag, blurred, is laid over the picture.

The whole code tells where a tag is, and not its outline alone. Its blur is fitted, too: motion and
focus mix each edge with its neighbors, which moves the edges of a sharp code.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

# Steps are those of a grid over a tag. Half and twice as much of each number were measured.
_STEPS = 4  # a module; 2 err more, 3 make tags 0.05% too small, 6 take twice the time
_DRAWN = 2 * _STEPS  # around a tag: steps that are drawn; no effect
_MATCHED = _STEPS  # around a tag: steps that are matched; a third errs twice as much by blur
_MOST_ROUNDS = 6  # 3 lose fast tags
# Steps that a round moves the corners: the last round, and that of a bad fit.
_STILL, _UNSETTLED = 0.1, 0.3  # no effect on errors; 0.15 loses 2% of strongly blurred tags
_SOFT = 1.0  # pixels, the blur (standard deviation) of the first round; 0.5 loses as many
_LEAST_BLUR = 0.4  # steps: a sharper code rings; no effect
_MOST_BLUR = _STEPS  # steps; twice has no effect, half is too little for strong blur
_MOST_FINE = 8  # samples of a step each way, in pictures that are finer; no effect on tags of 180
_MOST_MOVED = 0.1  # of the side, in a round; no effect, but keeps a square a square
_LEAST_STEP = 8.0  # gray levels from black to white; no effect
# Of the variance of a tag that its code explains. A wrong code explains 0.67 at most, of the family
# 4x4_50 0.84. Of 34 tags in photographs three, bent or worn, are below 0.9, and one below 0.85.
_LEAST_MATCH = 0.85


class _Grid(NamedTuple):
    """
    The grid over tags of a number of modules.

    `corners` (4, 2) are those of a tag, in steps. `shade` (2, P) leads from -0.5 to 0.5 along its
    sides, and `shares` (4, P) are those of the corners in how a point moves. The transform of a
    code times `waves` (6, ...) is that of the code, its slopes, and its changes by blur. `rim` is
    the transform of what is farther away than a module, where the paper may end.
    """

    corners: np.ndarray
    shade: np.ndarray
    shares: np.ndarray
    waves: np.ndarray
    rim: np.ndarray


@lru_cache(maxsize=8)
def _grid(modules: int) -> _Grid:
    side = modules * _STEPS
    corners = side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + _MATCHED - 0.5
    steps = (np.arange(side + 2 * _MATCHED) + 0.5 - _MATCHED) / side
    x, y = (values.ravel() for values in np.meshgrid(steps, steps))
    shares = np.stack(((1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y))
    size = side + 2 * _DRAWN
    along, down = 2j * np.pi * np.fft.rfftfreq(size), 2j * np.pi * np.fft.fftfreq(size)[:, None]
    blurs = along**2 / 2, along * down, down**2 / 2
    waves = np.stack(np.broadcast_arrays(1 + 0j, along, down, *blurs))
    inner = np.zeros((side + 2 * _STEPS, side + 2 * _STEPS))
    rim = np.pad(inner, _DRAWN - _STEPS, constant_values=1)
    single = np.float32, np.float32, np.complex64, np.complex64  # half the time
    arrays = np.stack((x, y)) - 0.5, shares, waves, np.fft.rfft2(rim)
    return _Grid(corners, *(a.astype(kind) for a, kind in zip(arrays, single, strict=True)))


def refine_corners(gray: np.ndarray, quads: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """
    Return the corners (n, 4, 2) of tags near quads (n, 4, 2), clockwise; NaN where none matches.

    `codes` (n, M, M) are 1 where a module is white, and 0 where it is black.
    """
    modules = codes.shape[-1]
    grid, corners = _grid(modules), quads.astype(float)
    white = codes.repeat(_STEPS, axis=1).repeat(_STEPS, axis=2)
    white = np.pad(white, ((0, 0), (_DRAWN, _DRAWN), (_DRAWN, _DRAWN)), constant_values=1)
    code = np.fft.rfft2(white).astype(np.complex64)
    side = np.linalg.norm(np.diff(quads, axis=1), axis=-1).mean(axis=1)
    step = np.maximum(side, 1) / modules / _STEPS
    fine = int(np.clip(np.rint(step.max()), 1, _MOST_FINE))
    blur = (_SOFT / step[:, None, None]) ** 2 * np.eye(2)
    for _ in range(_MOST_ROUNDS):
        blur = _bounded(blur)
        columns = _columns(grid, code, blur)
        to_pixels = [_to_pixels(grid, quad, fine) for quad in corners]
        seen = np.stack([_steps(gray, matrix, fine, columns.shape[-1]) for matrix in to_pixels])
        values, fitted = _least_squares(columns, seen)
        change = values[:, :11] / np.where(values[:, 11:12] > _LEAST_STEP, values[:, 11:12], np.nan)
        blur = blur + change[:, (8, 9, 9, 10)].reshape(-1, 2, 2)
        # The code is laid over what is seen, so the corners move the other way.
        most = _MOST_MOVED * modules * _STEPS
        moves = np.clip(np.nan_to_num(change[:, :8]), -most, most).reshape(-1, 2, 4)
        places = (grid.corners - np.swapaxes(moves, 1, 2) + 0.5) * fine - 0.5
        pairs = zip(places, to_pixels, strict=True)
        corners = np.stack([cv2.perspectiveTransform(place[None], m)[0] for place, m in pairs])
        last = np.abs(change[:, :8]).max(axis=1)
        if last.max() < _STILL:
            break
    match = fitted.var(axis=-1) / np.maximum(seen.var(axis=-1), 1)
    corners[~((match > _LEAST_MATCH) & (last < _UNSETTLED))] = np.nan
    return corners


def _to_pixels(grid: _Grid, quad: np.ndarray, fine: int) -> np.ndarray:
    """Return the map (3, 3) from samples, `fine` in a step each way, to the pixels of a quad."""
    samples = (grid.corners + 0.5) * fine - 0.5
    return np.asarray(cv2.getPerspectiveTransform(np.float32(samples), np.float32(quad)))


def _steps(gray: np.ndarray, to_pixels: np.ndarray, fine: int, count: int) -> np.ndarray:
    """Return the brightness (count,) of the steps of a tag."""
    size = round(count**0.5)
    samples = cv2.warpPerspective(
        gray,
        to_pixels,
        (size * fine, size * fine),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return (
        cv2.resize(samples, (size, size), interpolation=cv2.INTER_AREA).ravel().astype(np.float32)
    )


def brightness_at(gray: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the brightness (n, P) at pixels (n, P, 2); the border is continued outward."""
    at = at.astype(np.float32)
    return cv2.remap(gray, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _bounded(blur: np.ndarray) -> np.ndarray:
    """Return the covariances (n, 2, 2) of blurs, not sharper or wider than can be matched."""
    sizes, axes = np.linalg.eigh(np.nan_to_num(blur))
    sizes = np.clip(sizes, _LEAST_BLUR**2, _MOST_BLUR**2)
    return np.asarray((axes * sizes[:, None]) @ np.swapaxes(axes, 1, 2))


def _columns(grid: _Grid, code: np.ndarray, blur: np.ndarray) -> np.ndarray:
    """
    Return what the brightness changes by (n, 16, P): corners, blur, contrast, shade, level, rim.

    The first four are x of the corners, then y, in steps; three are the covariance of the blur.
    """
    blur = blur.astype(np.float32)
    damping = (blur[:, (0, 0, 1), (0, 1, 1), None, None] * grid.waves[3:].real).sum(axis=1)
    damping = np.exp(damping)[:, None]
    spectrum = np.concatenate((code[:, None] * damping * grid.waves, damping * grid.rim), axis=1)
    drawn = np.fft.irfft2(spectrum, s=(code.shape[1], code.shape[1]))
    rows = slice(_DRAWN - _MATCHED, _MATCHED - _DRAWN)
    drawn = drawn[..., rows, rows].reshape(len(code), 7, -1)
    right, down = (grid.shares * drawn[:, k : k + 1] for k in (1, 2))
    contrast = drawn[:, :1]
    level = np.ones_like(contrast)
    shade = contrast * grid.shade
    return np.concatenate(
        (right, down, drawn[:, 3:6], contrast, shade, level, drawn[:, 6:]), axis=1
    )


def _least_squares(columns: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares (n, K) of columns (n, K, P) in what is seen (n, P), and their sum."""
    normal = (columns @ np.swapaxes(columns, 1, 2)).astype(float)
    normal += 1e-8 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(len(normal[0]))
    values = np.linalg.solve(normal, columns @ seen[..., None])[..., 0]
    return values, (values[:, None].astype(np.float32) @ columns)[:, 0]
