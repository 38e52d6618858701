"""
Places of a linkage: bodies by number, the ground first, where they are, and lines and points.

Points and lines are unit vectors of homogeneous coordinates, from a point in the midst of the
linkage and in units of its size. So a center at infinity is a point like others, with w = 0; the
line through two points and the point on two lines are both the cross product, and its length tells
how sharply they determine it.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND, Rolling
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, body_motion
from kinpole_ros.planar._plane import Complex, Real

# Farther off than so many sizes of the linkage, a center is at infinity but for rounding.
_INFINITY = 1e9

Pair = tuple[int, int]


def bodies_of(mechanism: Mechanism) -> tuple[str, ...]:
    return (GROUND, *mechanism.bodies)


def number_of(bodies: Sequence[str], name: str) -> int:
    if name not in bodies:
        raise LinkageError(f'there is no body {name}: name one of {", ".join(bodies)}')
    return bodies.index(name)


def pairs_of(mechanism: Mechanism) -> tuple[Pair, ...]:
    return tuple(combinations(range(len(mechanism.bodies) + 1), 2))


def ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def poses_of(mechanism: Mechanism, values: Real) -> tuple[Complex, Complex]:
    """Origins (n, T), complex, m, and turns e^{iθ} (n, T) of all bodies, the ground first."""
    values = np.asarray(values, float)
    position, angle = body_motion(mechanism.assembly, values[None])
    still = np.zeros((1, values.shape[1]))
    return (
        np.concatenate((still + 0j, position[0])),
        np.exp(1j * np.concatenate((still, angle[0]))),
    )


def extent(mechanism: Mechanism, values: Real) -> tuple[Complex, float]:
    """The middle (T,) of the joints, complex, m, at variables (n, T), and the linkage's size, m."""
    position, turn = poses_of(mechanism, values)
    bodies = bodies_of(mechanism)
    points = [
        position[k] + turn[k] * point
        for joint in mechanism.assembly.joints
        for k, point in (
            (number_of(bodies, joint.one), joint.a),
            (number_of(bodies, joint.other), joint.b),
        )
    ]
    places = np.stack(points) if points else position
    middle = places.mean(axis=0)
    size = float(np.abs(places - middle).max(initial=0.0))
    wheels = [joint.radius for joint in mechanism.assembly.joints if isinstance(joint, Rolling)]
    return middle, max(size, *wheels, 0.0) or 1.0


def homogeneous(place: Complex, w: float) -> Real:
    return unit(np.stack((place.real, place.imag, np.full(place.shape, w))))[0]


def cross(one: tuple[Real, Real], other: tuple[Real, Real]) -> tuple[Real, Real]:
    """The line through two points, or the point on two lines, and how sharp it is."""
    vectors, length = unit(np.cross(one[0], other[0], axis=0))
    return vectors, length * np.minimum(one[1], other[1])


def unit(vectors: Real) -> tuple[Real, Real]:
    """Vectors (3, ...) of length 1, and the lengths (...) they had; NaN for those of length 0."""
    length = np.sqrt((vectors**2).sum(axis=0))
    with np.errstate(invalid='ignore', divide='ignore'):
        return vectors / length, length


def outward(vectors: Real, middle: Complex, size: float) -> Real:
    """Centers (3, c, T) as in Centers, from homogeneous coordinates of the linkage's own."""
    x, y, w = vectors
    with np.errstate(invalid='ignore', divide='ignore'):
        far = np.hypot(x, y) > _INFINITY * np.abs(w)
        place = middle + size * (x + 1j * y) / w
        # A direction and its opposite are one: upward, and to the right if level.
        way = np.where(np.abs(y) > np.abs(x) / _INFINITY, np.sign(y), np.sign(x)) / np.hypot(x, y)
        near = np.stack((place.real, place.imag, np.ones(x.shape)))
        level = np.where(np.abs(y) > np.abs(x) / _INFINITY, y * way, 0.0)
        found = np.where(far, np.stack((x * way, level, np.zeros(x.shape))), near)
    return np.where(np.isnan(vectors).any(axis=0), np.nan, found)
