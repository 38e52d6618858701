"""
What connects two bodies, from their poses: pins, slides, pins in slots, elliptic trammels.

Each is a model of the relative motion, fitted by least squares; what it leaves over is held against
what the noise of the markers explains.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._poses import Pose
from kinpole_ros.planar._plane import Complex, Real

# Times the noise a model may leave over. Noise that is not white, lenses and play make it more than
# one; what is no joint leaves tens or hundreds.
_FITS = 3.0
# Share of the relative motion that play and lenses may make besides.
_PLAY = 0.002
# Deviations of the relative turn without which no point of it is determined.
_TURNS = 6.0
_FEWEST = 50
# Share of its distances from the markers that a joint of bodies under skin may give.
GIVES = 0.022
# Deviation of the place of a pin in its slot, over the sizes of the bodies, that says nothing.
_VAGUE = 0.05


class Joint(NamedTuple):
    """
    A joint of two bodies, by their numbers; the ground is -1 and is never `one` unless it slides.

    `kind` is pin, slot (the point of `one` moves along a line on `other`), slide (the same, and the
    two do not turn against each other) or trammel (each point of a circle on `one` moves along a
    line through one point of `other`). `on_one` and `on_other` are its places on them, complex,
    about the means of their markers, with the `deviation` of each per axis. A line has the
    direction `along` on `other`, rad. A trammel's circle has its center at `on_one` and the radius
    `radius`; its `along` is the angle of β, see fit_slide. `residual` is the rms of what the model
    leaves over per axis, `expected` what noise explains.
    """

    kind: str
    one: int
    other: int
    on_one: complex
    on_other: complex
    deviation: tuple[float, float]
    along: float
    radius: float
    residual: float
    expected: float

    @property
    def ratio(self) -> float:
        """What is left over, in terms of the noise."""
        return self.residual / self.expected if self.expected > 0 else np.inf


def fit_pin(
    one: Pose, other: Pose, numbers: tuple[int, int], gives: float = 0.0
) -> tuple[Joint | None, bool]:
    """
    The pin of two bodies, None where they have none; and whether they turn enough to tell.

    It may give by this share of its distances from their markers.

    A pin is z_i + e^{iθ_i} p_i = z_j + e^{iθ_j} p_j, linear in both its places. The noise of the
    angles shrinks the means of e^{iθ} by known factors, which are taken out.
    """
    both = one.seen & other.seen
    if both.sum() < _FEWEST:
        return None, False
    a, b = one.angle[both], other.angle[both]
    noise = one.angle_variance + other.angle_variance
    turned = float(np.var(a - b))
    if turned < _TURNS**2 * noise or turned < 1e-8:
        return None, False
    offset = one.position[both] - other.position[both]
    # Normal equations, per frame, of [e^{iθ_i}, -e^{iθ_j}] [p_i, p_j] = -(z_i - z_j).
    shrunk = np.exp(-one.angle_variance / 2), np.exp(-other.angle_variance / 2)
    cross = -np.mean(np.exp(1j * (b - a))) / (shrunk[0] * shrunk[1])
    right = np.array(
        [
            -np.mean(np.exp(-1j * a) * offset) / shrunk[0],
            np.mean(np.exp(-1j * b) * offset) / shrunk[1],
        ]
    )
    left = 1 - abs(cross) ** 2
    if left <= 0:
        return None, False
    inverse = np.array([[1, -cross], [-np.conj(cross), 1]]) / left
    on_one, on_other = inverse @ right
    rest = offset + np.exp(1j * a) * on_one - np.exp(1j * b) * on_other
    residual = float(np.sqrt(np.mean(np.abs(rest) ** 2) / 2))
    expected = _lever(one, other, on_one, on_other)
    deviation = max(residual, expected) * float(np.sqrt(1 / left / both.sum()))
    relative = np.exp(-1j * b) * offset
    moved = float(np.sqrt(np.var(relative))) + float(np.sqrt(turned)) * one.size
    given = gives * (abs(on_one) + abs(on_other))
    fits = residual < max(_FITS * expected + _PLAY * moved, given)
    # What is farther than the model can say is parallel motion.
    reach = 50 * (one.size + other.size + float(np.abs(relative).max()))
    if not fits or abs(on_one) > reach:
        return None, True
    joint = Joint(
        'pin',
        *numbers,
        complex(on_one),
        complex(on_other),
        (deviation, deviation),
        0.0,
        0.0,
        residual,
        expected,
    )
    return joint, True


def _lever(one: Pose, other: Pose, on_one: complex, on_other: complex) -> float:
    """What the noise of two poses makes of points on them, per axis."""
    variance = one.position_variance + abs(on_one) ** 2 * one.angle_variance / 2
    variance += other.position_variance + abs(on_other) ** 2 * other.angle_variance / 2
    return float(np.sqrt(variance))


def fit_slide(one: Pose, other: Pose, numbers: tuple[int, int]) -> Joint | None:
    """
    A slot, slide or trammel of `one` along lines on `other`, None where there is none.

    In the frame of `other` the pose of `one` is w, u = e^{iθ}. A point b of it moves on the line
    Re(n* (w + u b)) = d: Re(n* w) is linear in u and 1. So w is fitted by these, and the direction
    n in which the least is left over is the line's normal. If nothing is left in any direction, and
    it is no pin, w = d - α u - β u*: the points b with |b - α| = |β| move along lines through d
    (Cardan's circles).
    """
    both = one.seen & other.seen
    if both.sum() < _FEWEST:
        return None
    back = np.exp(-1j * other.angle[both])
    w = back * (one.position[both] - other.position[both])
    theta = one.angle[both] - other.angle[both]
    u = np.exp(1j * theta)
    turned = float(np.var(theta))
    noise = one.angle_variance + other.angle_variance
    if turned < _TURNS**2 * noise or turned < 1e-8:
        return _prismatic(one, other, w, numbers)
    rows = np.stack((u.real, u.imag, np.ones(len(u))), axis=1)
    right = np.stack((w.real, w.imag), axis=1)
    found, *_ = np.linalg.lstsq(rows, right, rcond=None)
    rest = right - rows @ found
    values, vectors = np.linalg.eigh(rest.T @ rest / len(w))
    normal = complex(vectors[0, 0], vectors[1, 0])
    moved = float(np.sqrt(np.var(w)))
    if np.sqrt(values[1]) < _FITS * _lever(one, other, 0, 0) + _PLAY * moved:
        return _trammel(one, other, rows, found, rest, moved, numbers)
    # Re(n* w) = -(c_x u_x - c_y u_y) + d with b = n c.
    x, y, d = found @ vectors[:, 0]
    place = normal * complex(-x, y)
    direction = 1j * normal
    at = w + u * place
    along = (direction.conjugate() * at).real
    expected = float(
        np.sqrt(
            one.position_variance
            + other.position_variance
            + abs(place) ** 2 * one.angle_variance / 2
            + np.mean(along**2) * other.angle_variance
        )
    )
    residual = float(np.sqrt(values[0]))
    if residual > _FITS * expected + _PLAY * moved or np.std(along) < 10 * expected:
        return None
    inverse = np.linalg.inv(rows.T @ rows)
    deviation = max(residual, expected) * float(np.sqrt(inverse[0, 0] + inverse[1, 1]))
    if deviation > _VAGUE * (one.size + other.size):
        return None
    middle = normal * d + direction * float(np.median(along))
    line = max(residual, expected) * float(np.sqrt(inverse[2, 2]))
    return Joint(
        'slot',
        *numbers,
        place,
        middle,
        (deviation, line),
        float(np.angle(direction)),
        0.0,
        residual,
        expected,
    )


def _prismatic(one: Pose, other: Pose, w: Complex, numbers: tuple[int, int]) -> Joint | None:
    """A slide of two bodies that do not turn against each other."""
    middle = complex(w.mean())
    off = np.stack((w.real - middle.real, w.imag - middle.imag), axis=1)
    values, vectors = np.linalg.eigh(off.T @ off / len(w))
    direction = complex(vectors[0, 1], vectors[1, 1])
    along = (direction.conjugate() * w).real
    variance = one.position_variance + other.position_variance
    expected = float(np.sqrt(variance + np.mean(along**2) * other.angle_variance))
    residual = float(np.sqrt(values[0]))
    long = float(np.sqrt(values[1]))
    if long < 10 * expected or residual > _FITS * expected + _PLAY * long:
        return None
    deviation = max(residual, expected) / float(np.sqrt(len(w)))
    return Joint(
        'slide',
        *numbers,
        0j,
        middle,
        (deviation, deviation),
        float(np.angle(direction)),
        0.0,
        residual,
        expected,
    )


def _trammel(
    one: Pose,
    other: Pose,
    rows: Real,
    found: Real,
    rest: Real,
    moved: float,
    numbers: tuple[int, int],
) -> Joint | None:
    """The trammel w = d - α u - β u*, by what w is in terms of u_x, u_y, 1, (3, 2)."""
    of_x, of_y, d = (complex(*row) for row in found)
    alpha, beta = -(of_x - 1j * of_y) / 2, -(of_x + 1j * of_y) / 2
    expected = _lever(one, other, alpha, 0)
    residual = float(np.sqrt(np.mean(rest**2)))
    if residual > _FITS * expected + _PLAY * moved or abs(beta) < 10 * expected:
        return None
    inverse = np.linalg.inv(rows.T @ rows)
    deviation = max(residual, expected) * float(np.sqrt(inverse[0, 0] + inverse[1, 1])) / 2
    return Joint(
        'trammel',
        *numbers,
        complex(alpha),
        complex(d),
        (deviation, deviation),
        float(np.angle(beta)),
        abs(beta),
        residual,
        expected,
    )
