"""Names of quantities, values with their uncertainty, and pairs of bodies of an estimate."""

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

# Most bodies with relative motions of all pairs: 20 have 190 pairs, 300 would have 44,850.
MOST_PAIRED_BODIES = 20
POLE_NAMES = ('icr', 'iap', 'ijp', 'isp')
RATE_NAMES = ('angular_velocity', 'angular_acceleration', 'angular_jerk', 'angular_snap')


def quantity_names(order: int) -> dict[str, bool]:
    """
    Return the quantities of a body, and whether each is a vector.

    They are those up to the derivative of `order`, in the order of the topic `state`.
    """
    names = dict.fromkeys(RATE_NAMES[:order], False) | dict.fromkeys(POLE_NAMES[:order], True)
    if order >= 2:
        names['icr_velocity'] = True
    if order >= 3:
        names['centrode_curvature'] = False
    if order >= 2:
        names |= {'inflection_circle': True, 'inflection_diameter': False}
    return names


class Vectors(NamedTuple):
    """Vectors of the plane (complex) with covariance (..., 2, 2) and where they are determined."""

    value: np.ndarray
    covariance: np.ndarray
    determined: np.ndarray


class Numbers(NamedTuple):
    """Numbers with variance and where they are determined."""

    value: np.ndarray
    variance: np.ndarray
    determined: np.ndarray


def known_arrays(quantities: Mapping[str, Numbers | Vectors]) -> dict[str, np.ndarray]:
    """
    Return quantities (...) as arrays, NaN where undetermined, by their names.

    A number also has NAME_sigma, a vector, complex, NAME_covariance (..., 2, 2).
    """
    arrays = {}
    for name, (value, covariance, determined) in quantities.items():
        if covariance.ndim == value.ndim:
            arrays[name] = np.where(determined, value, np.nan)
            with np.errstate(invalid='ignore'):
                arrays[f'{name}_sigma'] = np.where(determined, np.sqrt(covariance), np.nan)
        else:
            arrays[name] = np.where(determined, value, complex(np.nan, np.nan))
            is_known = determined[..., None, None]
            arrays[f'{name}_covariance'] = np.where(is_known, covariance, np.nan)
    return arrays


def ellipse_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return half axes and direction (...) of the ellipse of one standard deviation.

    `covariance` (..., 2, 2); the major half axis comes first, and the direction, rad, is its own.
    """
    xx, yy, xy = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    mean, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major, minor = (np.sqrt(np.maximum(part, 0)) for part in (mean + radius, mean - radius))
    return major, minor, np.arctan2(2 * xy, xx - yy) / 2


def sigma_along(vectors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the standard deviations (T,) of the lengths of complex vectors (T,)."""
    with np.errstate(invalid='ignore', divide='ignore'):
        unit = np.stack((vectors.real, vectors.imag), axis=-1) / np.abs(vectors)[:, None]
    return np.sqrt(np.maximum(np.einsum('ti,tij,tj->t', unit, covariance, unit), 0))


class FramePoses(NamedTuple):
    """
    Poses (T, B) fitted to the markers of single frames, with independent errors.

    `angle`, rad, includes whole turns. `position`, complex, m, is that of the origin of the body's
    frame. `angle_information` and `position_information` are inverse variances over that of a
    coordinate of a marker, 0 for a hidden body; `noise`, m, is the standard deviation of such a
    coordinate. The errors of angle and position are independent at `middle`, complex, m, the mean
    of the visible markers in the body's frame.
    """

    angle: np.ndarray
    position: np.ndarray
    angle_information: np.ndarray
    position_information: np.ndarray
    middle: np.ndarray
    noise: np.ndarray


@lru_cache(maxsize=8)
def pair_indices(bodies: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices j and i of the measured pairs, i before j."""
    i, j = np.triu_indices(bodies if bodies <= MOST_PAIRED_BODIES else 0, 1)
    return j, i


def measured_pairs(bodies: int) -> list[tuple[int, int]]:
    """
    Return the pairs (i, j), i before j, whose relative motion is measured.

    These are all pairs of up to 20 bodies, and none of more bodies.
    """
    j, i = pair_indices(bodies)
    return list(zip(i.tolist(), j.tolist(), strict=True))
