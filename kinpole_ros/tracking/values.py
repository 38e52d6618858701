"""Names of quantities, values with their uncertainty, and pairs of bodies of an estimate."""

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from kinpole_ros.tracking.estimate import Estimate

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


class RegisteredQuantity(NamedTuple):
    """
    A quantity that another package computes from estimates, for topics, tables and `state`.

    `kind` is point, vector, number, force or torque; numbers (T,) are along the normal of the
    plane. It needs derivatives up to `order`. One of a `body` has its topic below the name of that,
    and a field in `state`.
    """

    topic: str
    kind: str
    order: int
    unit: str
    values: Callable[['Estimate'], Numbers | Vectors]
    body: int | None = None

    @property
    def is_vector(self) -> bool:
        """Whether it has two components in the plane."""
        return self.kind not in ('number', 'torque')


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
