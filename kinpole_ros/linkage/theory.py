"""
A scene on the tracked bodies: how both match, the balance of its loads, and its points.

The scene's markers show how its body frames lie in the measured bodies.
"""

import re
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.linkage._matches import BodyMatch, MismatchError, match_bodies
from kinpole_ros.linkage.positions import LivePositions
from kinpole_ros.mechanism import GROUND, Force, Load, Scene, SceneError, load_scene
from kinpole_ros.mechanism._equations import part_sum
from kinpole_ros.planar import Port, covariance, measured_balance, propagate
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.planar._poles import point_motion
from kinpole_ros.settings import POSE_TYPES, ParameterError, Settings, of_poses
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import FARTHEST, SIGNIFICANT
from kinpole_ros.tracking.values import Numbers, RegisteredQuantity, Vectors

# Ends of the topics of a point, and their units, by the order of the derivative.
_POINT_TOPICS = (('', 'm'), ('/velocity', 'm/s'), ('/acceleration', 'm/s²'), ('/jerk', 'm/s³'))
# Names that may be part of a topic's.
_TOKEN = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


class PointOfInterest(NamedTuple):
    """A point of the tracked body `body` (complex, m, in the scene's frame of it)."""

    body: str
    name: str
    point: complex


@dataclass(frozen=True, eq=False)
class Theory:
    """
    A scene, and how it matches the tracked bodies.

    `matches` are the bodies of both. `driver` is the body that the scene's one driver turns, ''
    where that is no tracked body's angle. `loads` are those of the scene, each on a tracked body.
    """

    scene: Scene
    matches: dict[str, BodyMatch]
    driver: str
    loads: tuple[Load, ...]

    @property
    def balances(self) -> bool:
        """Whether the scene has loads, and a tracked body that can balance them."""
        return bool(self.loads) and bool(self.driver or self.scene.held_by)

    def comparison(self) -> Callable[[Estimate], tuple[bool, str, dict[str, float]]]:
        """Return what compares estimates, one after the other, with the joints of the scene."""
        return LivePositions(self.scene, self.matches).diagnose

    def connected_bodies(self) -> list[tuple[str, str]]:
        """Return the pairs of bodies that have a joint in the scene."""
        return [(joint.one, joint.other) for joint in self.scene.mechanism.assembly.joints]

    def quantities(self, bodies: Sequence[str]) -> list[RegisteredQuantity]:
        """Return the motion of the points of interest, and the balance of the loads, as topics."""
        motion = [
            (end, 'vector' if order else 'point', max(order, 1), unit, (measured_point, order))
            for order, (end, unit) in enumerate(_POINT_TOPICS)
        ]
        path = [
            ('/path_radius', 'number', 2, 'm', (path_radius,)),
            ('/path_center', 'point', 2, 'm', (path_center,)),
        ]
        found = [
            RegisteredQuantity(
                *(f'{point.body}/points/{point.name}{end}', kind, order, unit),
                _once(measure, self, point, *arguments),
                bodies.index(point.body),
            )
            for rows in (motion, path)
            for point in points_of_interest(self)
            for end, kind, order, unit, (measure, *arguments) in rows
        ]
        if self.balances:
            holder = self.scene.held_by
            is_torque = holder is None or holder.point is None
            kind, unit = ('torque', 'N m') if is_torque else ('force', 'N')
            effort = balance if is_torque else balance_force
            found.append(RegisteredQuantity('balance', kind, 1, unit, _once(effort, self)))
        return found


def _once(measure: Callable[..., Any], *arguments: Any) -> Callable[[Estimate], Any]:
    """Return what measures a quantity of an estimate once, for all who read it."""
    return lambda estimate: estimate.once(measure, *arguments)


def load_theory(settings: Settings) -> Theory:
    """
    Load the scene that the parameter `scene` names, and match it with the tracked bodies.

    Raises ParameterError where the scene cannot be used, or does not match the bodies.
    """
    try:
        scene = load_scene(settings.scene)
    except SceneError as error:
        raise ParameterError(f'parameter scene: {error}') from None
    is_posed = settings.marker_type in POSE_TYPES
    shapes = of_poses(settings).shapes if is_posed else settings.shapes
    try:
        matches = match_bodies(scene, settings.bodies, shapes, is_posed)
        loads = tuple(on_tracked(scene, load, matches) for load in scene.loads)
        for load in loads:
            if load.body not in matches:
                raise MismatchError(f'it has a load on {load.body}, which is not tracked')
        if scene.held_by is not None:
            for body in (scene.held_by.body, scene.held_by.of):
                if body not in (*matches, GROUND):
                    raise MismatchError(f'its loads are held_by {body}, which is not tracked')
    except MismatchError as error:
        raise ParameterError(f'parameter scene is {settings.scene}: {error}') from None
    drivers, turns = scene.mechanism.drivers, scene.mechanism.assembly.turns
    driven = [
        body
        for body, match in matches.items()
        if len(drivers) == 1 and np.array_equal(turns[match.in_scene], drivers[0].row)
    ]
    return Theory(scene, matches, driven[0] if driven else '', loads)


def on_tracked(scene: Scene, load: Load, tracked: Container[str]) -> Load:
    """The load moved to a tracked body that is one with its own, as vectors that turn with it."""
    if load.body in tracked:
        return load
    equations = scene.equations
    values = np.array([dimension.value for dimension in equations.dimensions])
    home, offset = equations.frames[load.body]
    for body, (home_of_body, offset_of_body) in equations.frames.items():
        if home_of_body == home and body in tracked:
            if isinstance(load, Force):
                moved = part_sum(offset, values)[0]
                moved -= part_sum(offset_of_body, values)[0]
                return load._replace(body=body, point=load.point + moved)
            return load._replace(body=body)
    return load


# Origin (complex, m) and angle of the scene's body frames in those of the tracked bodies, (T,).
Frames: TypeAlias = dict[str, tuple[Complex, Real]]


def body_frames(theory: Theory, estimate: Estimate) -> Frames:
    """How the scene's frames lie in the tracked bodies, of bodies whose shape is known."""
    frames = {}
    for body, match in theory.matches.items():
        frame = match.fit_frame(estimate.shape[..., match.tracked, :])
        if np.isfinite(frame[1]).any():
            frames[body] = frame
    return frames


def balance(theory: Theory, estimate: Estimate) -> Numbers:
    """
    The effort that balances the scene's loads at the measured velocities, (T,).

    A torque on the driven body, N m; or by the scene's `held_by` a torque on a body, or a force, N,
    along `balance_direction`. Determined where all the bodies are estimated, and the input moves by
    more than its noise.
    """
    frames = estimate.once(body_frames, theory)
    holder = theory.scene.held_by
    acting = {theory.driver} if holder is None else {holder.body, holder.of} - {GROUND}
    needed = acting | {load.body for load in theory.loads}
    if not needed <= frames.keys():
        nan = np.full(np.shape(estimate.stamp), np.nan)
        return Numbers(nan, nan, np.isfinite(nan))
    through = Port(theory.matches[theory.driver if holder is None else holder.body].tracked, 1.0)
    direction = estimate.once(balance_direction, theory)
    if holder is not None and holder.point is not None and direction is not None:
        through = _port(theory, Force(holder.body, holder.point, direction), frames, estimate)
    value, variance, determined = measured_balance(
        through,
        [_port(theory, load, frames, estimate) for load in theory.loads],
        np.moveaxis(estimate.position, -1, 1),
        np.moveaxis(estimate.angle, -1, 1),
        np.moveaxis(estimate.position_covariance, -1, 2),
        np.moveaxis(estimate.angle_covariance, -1, 2),
        SIGNIFICANT,
    )
    is_estimated = [estimate.missing[..., theory.matches[body].tracked] == '' for body in needed]
    determined = np.asarray(determined) & np.all(is_estimated, axis=0)
    return Numbers(np.asarray(value), np.asarray(variance), determined)


def balance_direction(theory: Theory, estimate: Estimate) -> np.ndarray | None:
    """Direction (T,), complex, of the force that `balance` computes; None for a torque."""
    holder = theory.scene.held_by
    if holder is None or holder.point is None:
        return None
    direction = np.full(np.shape(estimate.stamp), np.exp(1j * holder.along))
    frames = estimate.once(body_frames, theory)
    if holder.of in frames:
        angle = estimate.angle[0][..., theory.matches[holder.of].tracked] + frames[holder.of][1]
        # Where the angle is not known, the force is not determined either.
        direction = direction * np.exp(1j * np.where(np.isfinite(angle), angle, 0.0))
    return np.asarray(direction)


def balance_force(theory: Theory, estimate: Estimate) -> Vectors:
    """The force of `balance` along its direction, (T,)."""
    value, variance, determined = estimate.once(balance, theory)
    direction = estimate.once(balance_direction, theory)
    assert direction is not None
    along = np.stack((direction.real, direction.imag), axis=-1)
    matrix = variance[:, None, None] * along[:, :, None] * along[:, None, :]
    return Vectors(value * direction, matrix, determined)


def _port(theory: Theory, load: Load, frames: Frames, estimate: Estimate) -> Port:
    b = theory.matches[load.body].tracked
    if isinstance(load, Force):
        origin, angle = frames[load.body]
        # From the reference point, whose velocity is estimated.
        arm = origin + load.point * np.exp(1j * angle) - estimate.reference[..., b]
        return Port(b, np.asarray(load.force, complex)[()], arm)
    return Port(b, complex(load.torque))  # type: ignore[arg-type]


def points_of_interest(theory: Theory) -> list[PointOfInterest]:
    """Points of tracked bodies that the scene names and no joint uses, for topics."""
    used = {
        end
        for joint in theory.scene.mechanism.assembly.joints
        for end in ((joint.one, joint.a), (joint.other, joint.b))
    }
    points = []
    for name, (body, position) in theory.scene.points.items():
        if body == GROUND or (body, position) in used:
            continue
        moved = on_tracked(theory.scene, Force(body, position, 0.0), theory.matches)
        last = name.rpartition('.')[2]
        if moved.body in theory.matches and _TOKEN.fullmatch(last):
            assert isinstance(moved, Force)
            points.append(PointOfInterest(moved.body, last, complex(moved.point)))
    return points


def measured_point(
    theory: Theory, point: PointOfInterest, order: int, estimate: Estimate
) -> Vectors:
    """Position of a point (T,), m, or its derivative of `order` 1 to 4, as measured."""
    arm, motion = estimate.once(_motion_of, theory, point)
    found = point_motion(order, arm, *motion[:2])
    return _known(theory, point, estimate, found.value, covariance(found, *motion[2:]))


def path_center(theory: Theory, point: PointOfInterest, estimate: Estimate) -> Vectors:
    """
    Center of curvature (T,), m, of the path of a point, as measured.

    Undetermined near an inflection, where its distance does not stand out of its noise.
    """
    return estimate.once(_path_of, theory, point)[0]


def path_radius(theory: Theory, point: PointOfInterest, estimate: Estimate) -> Numbers:
    """Radius (T,), m, of `path_center`, positive where the path turns left along its velocity."""
    return estimate.once(_path_of, theory, point)[1]


def _path_of(theory: Theory, point: PointOfInterest, estimate: Estimate) -> tuple[Vectors, Numbers]:
    """
    Return center and radius of curvature of the path of a point.

    By velocity and acceleration: Euler and Savary need a body that turns.
    """
    arm, motion = estimate.once(_motion_of, theory, point)

    def center_and_radius(position: Complex, angle: Real) -> Complex:
        place, v, acc = (point_motion(k, arm, position, angle).value for k in range(3))
        across = (v.conj() * acc).imag
        square = np.abs(v) ** 2
        return np.stack((place + 1j * v * square / across, np.abs(v) * square / across), axis=1)

    low = [array[:3] for array in motion[:2]] + [array[:3, :3] for array in motion[2:]]
    (center, radius), (of_center, of_radius) = propagate(center_and_radius, *low)
    variance, size = of_radius[..., 0, 0], estimate.size[..., theory.matches[point.body].tracked]
    found = _known(theory, point, estimate, center, of_center)
    with np.errstate(invalid='ignore'):
        is_near = np.abs(radius) < FARTHEST * size
        is_known = found.determined & is_near & (radius.real**2 > SIGNIFICANT**2 * variance)
    return found._replace(determined=is_known), Numbers(radius.real, variance, is_known)


def _motion_of(
    theory: Theory, point: PointOfInterest, estimate: Estimate
) -> tuple[Complex, tuple[Complex, Real, Real, Real]]:
    """
    Return a point in the frame of its body's reference (T,), and the motion of that.

    The motion is position and angle with their derivatives and covariances. The point is NaN where
    the shape of the body is unknown.
    """
    b = theory.matches[point.body].tracked
    position, angle = estimate.position[..., b], estimate.angle[..., b]
    spreads = estimate.position_covariance[..., b], estimate.angle_covariance[..., b]
    nothing = np.full(np.shape(estimate.stamp), np.nan)
    origin, turn = estimate.once(body_frames, theory).get(point.body, (nothing + 0j, nothing))
    arm = origin + point.point * np.exp(1j * turn) - estimate.reference[..., b]
    return arm, (position, angle, *spreads)


def _known(
    theory: Theory, point: PointOfInterest, estimate: Estimate, value: Complex, matrix: Real
) -> Vectors:
    is_finite = np.isfinite(value) & np.isfinite(matrix).all(axis=(-2, -1))
    is_seen = estimate.missing[..., theory.matches[point.body].tracked] == ''
    return Vectors(value, matrix, is_finite & is_seen)
