"""
The plane of the motion, and where it lies in the frame of the markers.

All that moves is computed in the plane, with complex numbers; markers come and results go as points
of space. This is the one place that turns the one into the other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.settings import AXES, FIT, PlaneSetting

NORMALS = {'xy': (0.0, 0.0, 1.0), 'yz': (1.0, 0.0, 0.0), 'zx': (0.0, 1.0, 0.0)}
# A component of a fitted normal below this may be noise, and does not decide about its sign.
_LEVEL = 0.1
# A normal is turned from the z axis down to this component, from another axis below it.
_STEEP = 0.5


class Plane(NamedTuple):
    """
    A plane through the origin: `basis` (3, 3), right-handed, rows e1, e2 and the normal n.

    `axes` are the columns of a marker along e1, e2 and n where those are axes of the frame, else
    None. Such a plane only picks columns: then figures are exact, and the path is a short one.
    """

    basis: np.ndarray
    axes: tuple[int, int, int] | None

    @property
    def normal(self) -> np.ndarray:
        """The unit normal (3,)."""
        return np.asarray(self.basis[2])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (..., 3) as complex numbers of the plane (...) and heights over it (...), m."""
        flat = np.empty(points.shape[:-1], complex)
        if self.axes is not None:
            flat.real, flat.imag = points[..., self.axes[0]], points[..., self.axes[1]]
            return flat, points[..., self.axes[2]]
        # Term by term, since the rounding of a matrix product depends on the number of points.
        flat.real, flat.imag, heights = (
            points[..., 0] * x + points[..., 1] * y + points[..., 2] * z for x, y, z in self.basis
        )
        return flat, heights

    def in_space(self, values: np.ndarray, heights: np.ndarray | float) -> np.ndarray:
        """x, y and z (..., 3) of points of the plane (...) at heights along its normal."""
        xyz = np.empty((*values.shape, 3))
        first, second, normal = self.axes or (0, 1, 2)
        xyz[..., first], xyz[..., second], xyz[..., normal] = values.real, values.imag, heights
        return xyz if self.axes is not None else xyz @ self.basis

    def along_normal(self, values: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) of that length along the normal."""
        if self.axes is None:
            return np.asarray(values[..., None] * self.basis[2])
        xyz = np.zeros((*values.shape, 3))
        xyz[..., self.axes[2]] = values
        return xyz

    def point(self, value: complex, height: float) -> list[float]:
        """x, y and z of one point, in plain numbers."""
        if self.axes is not None:
            xyz = [0.0, 0.0, 0.0]
            first, second, normal = self.axes
            xyz[first], xyz[second], xyz[normal] = value.real, value.imag, height
            return xyz
        found: list[float] = ((value.real, value.imag, height) @ self.basis).tolist()
        return found

    @property
    def name(self) -> str:
        """xy, yz or zx, else its normal as the parameter `plane` takes it."""
        names = {axes: name for name, axes in AXES.items()}
        return names[self.axes] if self.axes in names else as_parameter(self.normal)


def plane_of(setting: PlaneSetting) -> Plane | None:
    """The plane that the parameter `plane` names; None for one that is to be fitted."""
    if setting == FIT:
        return None
    if isinstance(setting, str):
        return plane_along(NORMALS[setting])
    return plane_along(np.array(setting))


def plane_along(normal: Sequence[float] | np.ndarray) -> Plane:
    """
    The plane with this normal (3,), of any length over 0.

    Its axes are those of the plane xy turned the shortest way to the normal, so that they change
    smoothly with it; of yz or zx where the normal is nearer to x or y than to z, by 60 deg or more
    from z. A normal along an axis of the frame gives that plane exactly.
    """
    normal = np.asarray(normal, float)
    # First by the largest, whose square may overflow.
    normal = normal / np.abs(normal).max()
    normal = normal / np.sqrt(normal @ normal)
    column = 2 if abs(normal[2]) >= _STEEP else int(np.abs(normal[:2]).argmax())
    axes = next(axes for axes in AXES.values() if axes[2] == column)
    basis = np.eye(3)[list(axes)]
    if normal[column] < 0:
        # From the back: half a turn about e1.
        basis[1:] *= -1.0
    # Rodrigues' rotation from the one normal to the other, at most 60 deg.
    axis = np.cross(basis[2], normal)
    if not axis.any():
        basis[2] = normal
        return Plane(basis + 0.0, axes if normal[column] > 0 else None)
    cosine = float(basis[2] @ normal)
    across = np.cross(axis, basis)
    basis = basis + across + np.cross(axis, across) / (1.0 + cosine)
    # To the last bit, whatever the rounding.
    basis[2] = normal
    basis[0] -= (basis[0] @ normal) * normal
    basis[0] /= np.sqrt(basis[0] @ basis[0])
    basis[1] = np.cross(normal, basis[0])
    return Plane(basis, None)


def plane_axes(plane: Plane) -> tuple[str, str]:
    """Return the names of the first two axes of a plane, for the axes of drawings."""
    if plane.axes is not None:
        return plane.name[:1], plane.name[1:2]
    return f'along {as_parameter(plane.basis[0])}', f'along {as_parameter(plane.basis[1])}'


def upward(normal: np.ndarray) -> np.ndarray:
    """That of the two normals (3,) of a plane that is nearer to +z; to +y, then +x, for a tie."""
    for column in (2, 1, 0):
        if abs(normal[column]) > _LEVEL:
            return np.asarray(normal * np.sign(normal[column]))
    return normal


def as_parameter(normal: np.ndarray) -> str:
    """A normal as the parameter `plane` takes it."""
    return '[' + ', '.join(f'{value + 0.0:.4f}' for value in np.round(normal, 4)) + ']'


XY = plane_along((0.0, 0.0, 1.0))
