"""
Corners of tags to parts of a pixel: lines through the steps of brightness along their edges.

The brightness across an edge is sampled at several places. The centroid of its slope is the edge,
also under motion blur, which spreads the slope evenly about the middle of the exposure. The corners
are the intersections of the lines.
"""

from typing import NamedTuple

import numpy as np

_PLACES = np.linspace(0.14, 0.86, 14)  # along an edge; corners are rounded by blur
_ACROSS = np.linspace(-1.0, 1.0, 13)  # samples of a profile
_REACH = (2.0, 7.0)  # pixels that a profile reaches, on both sides
_OF_MODULE = 0.95  # of a module of the tag, so that a profile sees no other edge
_PASSES = 2
_FLOOR = 0.15  # of the steepest slope; less is noise
_N_SIGMA = 2.5  # of places that do not fit the line
_LEAST_STEP = 8.0  # gray levels from black to white


class Corners(NamedTuple):
    """Corners (n, 4, 2) in pixels, and their standard deviation (n,), NaN where no line fits."""

    places: np.ndarray
    sigma: np.ndarray


def refine_corners(gray: np.ndarray, quads: np.ndarray, modules: int) -> Corners:
    """Return the corners of tags near quads (n, 4, 2), clockwise; a tag has `modules` a side."""
    places = quads.astype(float)
    # The nodes of the slope, between the samples of the profile.
    nodes = (_ACROSS[1:] + _ACROSS[:-1]) / 2
    for _ in range(_PASSES):
        ends = np.roll(places, -1, axis=1)
        along = ends - places
        length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        # Clockwise in a picture whose y points down: outward is left of the edge.
        normal = np.stack((along[..., 1], -along[..., 0]), axis=-1) / length
        module = length.mean(axis=(1, 2)) / modules
        reach = np.clip(_OF_MODULE * module, *_REACH)[:, None, None]
        base = places[:, :, None] + along[:, :, None] * _PLACES[:, None]
        across = reach[..., None] * _ACROSS
        samples = base[..., None, :] + across[..., None] * normal[:, :, None, None]
        profile = bilinear(gray, samples)
        slope = np.diff(profile, axis=-1)
        steepest = slope.max(axis=-1, keepdims=True)
        weight = np.maximum(slope - _FLOOR * steepest, 0.0)
        total = weight.sum(axis=-1)
        offset = reach * (weight @ nodes) / np.maximum(total, 1e-9)
        is_step = profile[..., -1] - profile[..., 0] > _LEAST_STEP
        shift, sigma = _fit_lines(offset, is_step)
        places = _intersections(places, along, normal, shift)
    sigma[~np.isfinite(places).all(axis=(1, 2))] = np.nan
    return Corners(places, sigma)


def bilinear(gray: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the brightness at points (..., 2); the border is continued outward."""
    h, w = gray.shape
    at = np.nan_to_num(at, posinf=0.0, neginf=0.0)
    x, y = np.clip(at[..., 0], 0, w - 1.001), np.clip(at[..., 1], 0, h - 1.001)
    left, top = x.astype(np.intp), y.astype(np.intp)
    fx, fy = (x - left).astype(np.float32), (y - top).astype(np.float32)
    flat, first = gray.reshape(-1), top * w + left
    upper = flat[first] * (1 - fx) + flat[first + 1] * fx
    lower = flat[first + w] * (1 - fx) + flat[first + w + 1] * fx
    return upper * (1 - fy) + lower * fy


def _fit_lines(offset: np.ndarray, is_step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit a line to the offsets (n, 4, S) of each edge.

    Returns the offsets (n, 4, 2) at its ends, and the standard deviation (n,) of a corner, NaN for
    tags with an edge that is not seen over half of its length.
    """
    matrix = np.stack((1 - _PLACES, _PLACES), axis=-1)
    weight = is_step.astype(float)
    for _ in range(2):
        normal = np.einsum('nes,si,sj->neij', weight, matrix, matrix)
        normal += 1e-9 * np.eye(2)  # an edge that is not seen keeps its place
        covariance = np.linalg.inv(normal)
        shift = (covariance @ ((weight * offset) @ matrix)[..., None])[..., 0]
        residual = offset - shift @ matrix.T
        count = weight.sum(axis=-1)
        spread = np.sqrt((weight * residual**2).sum(axis=-1) / np.maximum(count - 2, 1))
        weight = weight * (np.abs(residual) < _N_SIGMA * np.maximum(spread, 0.02)[..., None])
    at_ends = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1).mean(axis=-1)) * spread
    sigma = np.sqrt((at_ends**2).mean(axis=-1))
    sigma[(weight.sum(axis=-1) < len(_PLACES) / 2).any(axis=-1)] = np.nan
    return shift, sigma


def _intersections(
    places: np.ndarray, along: np.ndarray, normal: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Return the corners (n, 4, 2) where the shifted edges meet."""
    start = places + shift[..., :1] * normal
    run = along + (shift[..., 1:] - shift[..., :1]) * normal
    before, run_before = np.roll(start, 1, axis=1), np.roll(run, 1, axis=1)
    cross = run_before[..., 0] * run[..., 1] - run_before[..., 1] * run[..., 0]
    gap = start - before
    with np.errstate(divide='ignore', invalid='ignore'):
        t = (gap[..., 0] * run[..., 1] - gap[..., 1] * run[..., 0]) / cross
    return np.asarray(before + t[..., None] * run_before)
