"""
Joints of two bodies from their poses: pins, slides, pins in slots, trammels, wheels and gears.

Each kind is a model of the relative motion, fitted by least squares. Its residual is compared with
what the noise of the markers explains.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._body_poses import GROUND_NUMBER, BodyPoses
from kinpole_ros.linkage.limits import JOINT_FRAMES
from kinpole_ros.planar._plane import Complex, Real

# A residual over what noise explains. Lenses, play and noise that is not white make it more than 1;
# where there is no joint it is in the tens or hundreds.
_MAX_RATIO = 3.0
# Share of the relative motion that play and lenses may add to the residual.
_PLAY = 0.002
# Standard deviations of the relative turn, without which it does not determine a point.
_MIN_TURN = 6.0
# Share of its distances from the markers by which a joint of bodies under skin may vary.
SKIN_STRAIN = 0.022
# A pin in a slot is not determined if its deviation exceeds this share of the sizes of the bodies.
_MAX_DEVIATION = 0.05
# A slide moves by at least this many times what noise explains.
_MIN_MOTION = 10
# A pin this many times the extent of the relative motion away is a parallel motion.
_MAX_DISTANCE = 50
# A wheel larger than this many times the size of its marked part hardly turns.
_MAX_WHEEL = 10.0
_MAX_GEAR_RATIO = 50
# Deviations up to which the center of a trammel's circle may be the mean of the markers.
_CENTERED_SIGMAS = 6.0


class FoundJoint(NamedTuple):
    """
    A joint of two bodies, by number. The ground is GROUND_NUMBER.

    `kind` is pin; slot (the point of `one` moves along a line on `other`); slide (the same, and the
    two do not turn against each other); or trammel (each point of a circle on `one` moves along a
    line through one point of `other`). `on_one` and `on_other` are its positions on both, complex,
    from the means of their markers, with the `deviation` of each per axis. `residual` is the rms
    residual per axis, `expected` what noise explains of it. A line has the direction `along` on
    `other`, rad. A trammel's circle has its center at `on_one` and the radius `radius`; its `along`
    is the angle of β, see `fit_slide`.
    """

    kind: str
    one: int
    other: int
    on_one: complex
    on_other: complex
    deviation: tuple[float, float]
    residual: float
    expected: float
    along: float = 0.0
    radius: float = 0.0

    @property
    def ratio(self) -> float:
        """The residual over what noise explains."""
        return self.residual / self.expected if self.expected > 0 else np.inf


class FoundRolling(NamedTuple):
    """
    A wheel, the body `one`, that rolls without slip on a line or circle of `other`.

    `hub` is its center on `one`, `radius` its radius. The line has the direction `along` on
    `other`, rad, with the wheel to its left, and goes through the point `at`. The radius `circle`
    of a circle about `at` is negative where the wheel is inside, and 0 for a line. `arm` is the
    body that holds both centers, GROUND_NUMBER for a line. `deviation` is that of the radius,
    `residual` that of the length rolled or of the angle, `expected` what noise explains of it.
    `is_steady` says that all turn at constant rates, as gears do, but independent motors as well.
    """

    one: int
    other: int
    hub: complex
    radius: float
    along: float
    at: complex
    circle: float
    arm: int
    deviation: float
    residual: float
    expected: float
    is_steady: bool


def fit_pin(
    first: BodyPoses, second: BodyPoses, numbers: tuple[int, int], strain: float = 0.0
) -> tuple[FoundJoint | None, bool]:
    """
    Fit the pin of two bodies, None where they have none; and whether they turn enough for first.

    A pin is z_i + e^{iθ_i} p_i = z_j + e^{iθ_j} p_j, linear in the points p_i and p_j. Noise of the
    angles shrinks the means of e^{iθ} by known factors, which are corrected. The residual may be
    this `strain` of the distances from the markers.
    """
    common = first.seen & second.seen
    if common.sum() < JOINT_FRAMES:
        return None, False
    a, b = first.angle[common], second.angle[common]
    turned = float(np.var(a - b))
    if not _turns(turned, first, second):
        return None, False
    offset = first.position[common] - second.position[common]
    # Normal equations, per frame, of [e^{iθ_i}, -e^{iθ_j}] [p_i, p_j] = -(z_i - z_j).
    shrunk = np.exp(-first.angle_variance / 2), np.exp(-second.angle_variance / 2)
    cross = -np.mean(np.exp(1j * (b - a))) / (shrunk[0] * shrunk[1])
    right = np.array(
        [
            -np.mean(np.exp(-1j * a) * offset) / shrunk[0],
            np.mean(np.exp(-1j * b) * offset) / shrunk[1],
        ]
    )
    determinant = 1 - abs(cross) ** 2
    if determinant <= 0:
        return None, False
    on_one, on_other = np.array([[1, -cross], [-np.conj(cross), 1]]) / determinant @ right
    misfit = offset + np.exp(1j * a) * on_one - np.exp(1j * b) * on_other
    residual = float(np.sqrt(np.mean(np.abs(misfit) ** 2) / 2))
    expected = _point_noise(first, second, on_one, on_other)
    relative = np.exp(-1j * b) * offset
    moved = float(np.sqrt(np.var(relative))) + float(np.sqrt(turned)) * first.size
    soft = strain * (abs(on_one) + abs(on_other))
    fits = residual < max(_MAX_RATIO * expected + _PLAY * moved, soft)
    extent = first.size + second.size + float(np.abs(relative).max())
    if not fits or abs(on_one) > _MAX_DISTANCE * extent:
        return None, True
    deviation = max(residual, expected) * float(np.sqrt(1 / determinant / common.sum()))
    points = complex(on_one), complex(on_other)
    return FoundJoint('pin', *numbers, *points, (deviation, deviation), residual, expected), True


def _turns(variance: float, first: BodyPoses, second: BodyPoses) -> bool:
    """Whether two bodies turn against each other by more than noise."""
    noise = first.angle_variance + second.angle_variance
    return variance >= _MIN_TURN**2 * noise and variance >= 1e-8


def _point_noise(first: BodyPoses, second: BodyPoses, on_one: complex, on_other: complex) -> float:
    """Error per axis of the distance of two points, by the noise of the poses of their bodies."""
    variance = first.position_variance + abs(on_one) ** 2 * first.angle_variance / 2
    variance += second.position_variance + abs(on_other) ** 2 * second.angle_variance / 2
    return float(np.sqrt(variance))


def _relative_motion(first: BodyPoses, second: BodyPoses) -> tuple[Complex, Real]:
    """Position and angle of the first body in the frame of the second, where both are seen."""
    common = first.seen & second.seen
    offset = first.position[common] - second.position[common]
    return np.exp(-1j * second.angle[common]) * offset, first.angle[common] - second.angle[common]


def fit_slide(first: BodyPoses, second: BodyPoses, numbers: tuple[int, int]) -> FoundJoint | None:
    """
    Fit a slot, slide or trammel of the first body on the second, None where there is none.

    In the frame of the second body the pose of the first is w, u = e^{iθ}. A point b of it moves on
    the line Re(n* (w + u b)) = d, so Re(n* w) is linear in u and 1. w is fitted by these, and the
    direction n of the least residual is the normal of the line. If no direction has a residual, and
    the joint is no pin, then w = d - α u - β u*: the points b with |b - α| = |β| move along lines
    through d (Cardan's circles).
    """
    w, theta = _relative_motion(first, second)
    if len(w) < JOINT_FRAMES:
        return None
    if not _turns(float(np.var(theta)), first, second):
        return _fit_prismatic(first, second, w, numbers)
    u = np.exp(1j * theta)
    rows = np.stack((u.real, u.imag, np.ones(len(u))), axis=1)
    right = np.stack((w.real, w.imag), axis=1)
    solution, *_ = np.linalg.lstsq(rows, right, rcond=None)
    misfit = right - rows @ solution
    values, vectors = np.linalg.eigh(misfit.T @ misfit / len(w))
    play = _PLAY * float(np.sqrt(np.var(w)))
    if np.sqrt(values[1]) < _MAX_RATIO * _point_noise(first, second, 0, 0) + play:
        residual = float(np.sqrt(np.mean(misfit**2)))
        return _trammel((first, second), numbers, rows, solution, residual, play)
    # Re(n* w) = -(c_x u_x - c_y u_y) + d with b = n c.
    normal = complex(vectors[0, 0], vectors[1, 0])
    x, y, d = solution @ vectors[:, 0]
    point = normal * complex(-x, y)
    direction = 1j * normal
    along = (direction.conjugate() * (w + u * point)).real
    variance = first.position_variance + second.position_variance
    variance += abs(point) ** 2 * first.angle_variance / 2
    variance += np.mean(along**2) * second.angle_variance
    expected, residual = float(np.sqrt(variance)), float(np.sqrt(values[0]))
    if residual > _MAX_RATIO * expected + play or np.std(along) < _MIN_MOTION * expected:
        return None
    error, inverse = max(residual, expected), np.linalg.inv(rows.T @ rows)
    deviation = error * float(np.sqrt(inverse[0, 0] + inverse[1, 1]))
    if deviation > _MAX_DEVIATION * (first.size + second.size):
        return None
    middle = normal * d + direction * float(np.median(along))
    deviations = deviation, error * float(np.sqrt(inverse[2, 2]))
    angle = float(np.angle(direction))
    return FoundJoint('slot', *numbers, point, middle, deviations, residual, expected, angle)


def _fit_prismatic(
    first: BodyPoses, second: BodyPoses, w: Complex, numbers: tuple[int, int]
) -> FoundJoint | None:
    """Fit a slide of two bodies that do not turn against each other, by positions w (k,)."""
    middle = complex(w.mean())
    off = np.stack((w.real - middle.real, w.imag - middle.imag), axis=1)
    values, vectors = np.linalg.eigh(off.T @ off / len(w))
    direction = complex(vectors[0, 1], vectors[1, 1])
    along = (direction.conjugate() * w).real
    variance = first.position_variance + second.position_variance
    expected = float(np.sqrt(variance + np.mean(along**2) * second.angle_variance))
    residual, motion = (float(np.sqrt(value)) for value in values)
    if motion < _MIN_MOTION * expected or residual > _MAX_RATIO * expected + _PLAY * motion:
        return None
    deviation = max(residual, expected) / float(np.sqrt(len(w)))
    angle, deviations = float(np.angle(direction)), (deviation, deviation)
    return FoundJoint('slide', *numbers, 0j, middle, deviations, residual, expected, angle)


def _trammel(
    poses: tuple[BodyPoses, BodyPoses],
    numbers: tuple[int, int],
    rows: Real,
    solution: Real,
    residual: float,
    play: float,
) -> FoundJoint | None:
    """The trammel w = d - α u - β u*, by the `solution` (3, 2) for w of the `rows` u_x, u_y, 1."""
    of_x, of_y, d = (complex(*row) for row in solution)
    alpha, beta = -(of_x - 1j * of_y) / 2, -(of_x + 1j * of_y) / 2
    expected = _point_noise(*poses, alpha, 0)
    if residual > _MAX_RATIO * expected + play or abs(beta) < _MIN_MOTION * expected:
        return None
    inverse = np.linalg.inv(rows.T @ rows)
    deviation = max(residual, expected) * float(np.sqrt(inverse[0, 0] + inverse[1, 1])) / 2
    angle, deviations = float(np.angle(beta)), (deviation, deviation)
    points = complex(alpha), complex(d)
    return FoundJoint(
        'trammel', *numbers, *points, deviations, residual, expected, angle, abs(beta)
    )


def is_mirrored_pair(pose: BodyPoses, trammel: FoundJoint) -> bool:
    """
    Whether a trammel may be a pin of two markers with one coordinate exchanged.

    Exchanged, two markers turn the other way about their mean, which still moves on a circle about
    the pin: the motion of a trammel whose circle has its center there.
    """
    is_centered = abs(trammel.on_one) < _CENTERED_SIGMAS * trammel.deviation[0]
    return trammel.kind == 'trammel' and len(pose.shape) == 2 and is_centered


def fit_wheel(first: BodyPoses, second: BodyPoses, slot: FoundJoint) -> FoundRolling | None:
    """Fit a wheel whose hub is the point of the first body that moves along a slot."""
    w, theta = _relative_motion(first, second)
    direction = np.exp(1j * slot.along)
    along = (direction.conjugate() * (w + np.exp(1j * theta) * slot.on_one)).real
    rows = np.stack((theta, np.ones(len(theta))), axis=1)
    (rate, start), *_ = np.linalg.lstsq(rows, along, rcond=None)
    residual = float(np.std(along - rows @ (rate, start)))
    noise = first.angle_variance + second.angle_variance
    expected = float(np.sqrt(slot.expected**2 + rate**2 * noise))
    radius = abs(float(rate))
    allowed = _MAX_RATIO * expected + _PLAY * float(np.std(along))
    if residual > allowed or radius > _MAX_WHEEL * first.size:
        return None
    # A wheel to the left of its line turns clockwise as it rolls along it.
    if rate > 0:
        direction = -direction
    deviation = max(residual, expected) / float(np.std(theta) * np.sqrt(len(theta)))
    return FoundRolling(
        slot.one,
        slot.other,
        slot.on_one,
        radius,
        along=float(np.angle(direction)),
        at=complex(slot.on_other - 1j * direction * radius),
        circle=0.0,
        arm=GROUND_NUMBER,
        deviation=deviation,
        residual=residual,
        expected=expected,
        is_steady=False,
    )


def fit_gear(
    poses: tuple[BodyPoses, BodyPoses, BodyPoses],
    numbers: tuple[int, int, int],
    pins: tuple[complex, complex, complex, complex],
    pin_deviation: float,
) -> FoundRolling | None:
    """
    Fit a gear that rolls on another one, both pinned to an arm, by the ratio of their turns.

    `poses` and `numbers` are those of the gear i, the other gear j and the arm. `pins` are the hub
    on the gear and on the arm, the center on the other gear and on the arm. Willis:
    R (θ_j - θ_arm) = -r (θ_i - θ_arm), with R < 0 for a ring around the gear.
    """
    wheel, ring, arm = poses
    common = wheel.seen & ring.seen & arm.seen
    if common.sum() < JOINT_FRAMES:
        return None
    a, b, c = (pose.angle[common] for pose in poses)
    x, y = b - c, a - c
    spread = np.std(x), np.std(y)
    noise = wheel.angle_variance + arm.angle_variance, ring.angle_variance + arm.angle_variance
    if spread[0] ** 2 < 100 * noise[1] or spread[1] ** 2 < 100 * noise[0]:
        return None
    x, y = x - x.mean(), y - y.mean()
    ratio = float(x @ y / (x @ x))
    residual = float(np.std(y - ratio * x))
    variance = wheel.angle_variance + ratio**2 * ring.angle_variance
    variance += (1 - ratio) ** 2 * arm.angle_variance
    expected = float(np.sqrt(variance))
    if residual > _MAX_RATIO * expected or abs(ratio) > _MAX_GEAR_RATIO:
        return None
    # R = -ratio r; the centers are R + r apart, or |R| - r for a ring. A ratio between 0 and 1 is
    # that of a ring seen from its wheel: the same pair is found the other way round.
    if -0.02 < ratio < 1.02:
        return None
    distance = abs(pins[1] - pins[3])
    radius = distance / abs(1 - ratio)
    deviation = distance / (1 - ratio) ** 2 * max(residual, expected) / (spread[0] * len(x) ** 0.5)
    deviation = np.hypot(deviation, 2**0.5 * pin_deviation / abs(1 - ratio))
    frames = np.arange(len(y))
    unsteady = float(np.std(y - np.polyval(np.polyfit(frames, y, 1), frames)))
    return FoundRolling(
        numbers[0],
        numbers[1],
        pins[0],
        float(radius),
        along=0.0,
        at=pins[2],
        circle=float(-ratio * radius),
        arm=numbers[2],
        deviation=float(deviation),
        residual=residual,
        expected=expected,
        is_steady=bool(unsteady < 3 * expected),
    )
