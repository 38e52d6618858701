"""
A scene on the tracked bodies: how both match, the balance of its loads, and its points.

The scene's markers show how its body frames lie in the measured bodies.
"""

import re
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.findings import Finding
from kinpole_ros.linkage._matches import BodyMatch, MismatchError, match_bodies
from kinpole_ros.linkage.positions import LivePositions
from kinpole_ros.mechanism import GROUND, Force, Load, Scene, SceneError, load_scene
from kinpole_ros.mechanism._equations import part_sum
from kinpole_ros.planar import Port, covariance, measured_balance, propagate
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.planar._poles import point_motion
from kinpole_ros.settings import POSE_TYPES, ParameterError, Settings, of_poses
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import FARTHEST, KNOWN, SIGNIFICANT
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.values import Numbers, Vectors

# Of the topics of a point: end, kind, order and unit. Those of its motion are by their derivative.
_MOTION_TOPICS = (
    ('', 'point', 1, 'm'),
    ('/velocity', 'vector', 1, 'm/s'),
    ('/acceleration', 'vector', 2, 'm/s²'),
    ('/jerk', 'vector', 3, 'm/s³'),
)
_PATH_TOPICS = (('/path_radius', 'number', 2, 'm'), ('/path_center', 'point', 2, 'm'))
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

    @cached_property
    def points(self) -> list[PointOfInterest]:
        """Points of tracked bodies that the scene names and no joint uses, for topics."""
        return list(_points_of_interest(self))

    @cached_property
    def bodies_of_points(self) -> list[int]:
        """The tracked body of each of the points."""
        return [self.matches[point.body].tracked for point in self.points]

    @property
    def balances(self) -> bool:
        """Whether the scene has loads, and a tracked body that can balance them."""
        return bool(self.loads) and bool(self.driver or self.scene.held_by)

    def comparison(self) -> Callable[[Estimate], tuple[list[Finding], dict[str, float]]]:
        """Return what compares estimates, one after the other, with the joints of the scene."""
        return LivePositions(self.scene, self.matches).diagnose

    def connected_bodies(self) -> list[tuple[str, str]]:
        """Return the pairs of bodies that have a joint in the scene."""
        return [(joint.one, joint.other) for joint in self.scene.mechanism.assembly.joints]

    def quantities(self, bodies: Sequence[str]) -> list[RegisteredQuantity]:
        """Return the motion of the points of interest, and the balance of the loads, as topics."""
        motion = [(measured_points, self, order) for order in range(len(_MOTION_TOPICS))]
        path = [(path_radii, self), (path_centers, self)]
        found = [
            RegisteredQuantity(
                *(f'{point.body}/points/{point.name}{end}', kind, order, unit),
                partial(_of_point, k, measure),
                bodies.index(point.body),
            )
            for topics, measures in ((_MOTION_TOPICS, motion), (_PATH_TOPICS, path))
            for k, point in enumerate(self.points)
            for (end, kind, order, unit), measure in zip(topics, measures, strict=True)
        ]
        if self.balances:
            holder = self.scene.held_by
            is_torque = holder is None or holder.point is None
            kind, unit = ('torque', 'N m') if is_torque else ('force', 'N')
            effort: Callable[..., Numbers | Vectors] = balance if is_torque else balance_force
            found.append(
                RegisteredQuantity('balance', kind, 1, unit, lambda now: now.once(effort, self))
            )
        return found


def _of_point(k: int, measure: tuple[Any, ...], estimate: Estimate) -> Numbers | Vectors:
    """Return a quantity (T,) of the k-th of the points, which are measured once for all readers."""
    quantity: Numbers | Vectors = estimate.once(*measure)
    value, spread, determined = (part[:, k] for part in quantity)
    return type(quantity)(value, spread, determined)


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
    frames = {body: estimate.once(body_frame, theory, body) for body in theory.matches}
    return {body: frame for body, frame in frames.items() if np.isfinite(frame[1]).any()}


def body_frame(theory: Theory, body: str, estimate: Estimate) -> tuple[Complex, Real]:
    """How the scene's frame of a body lies in the tracked one, NaN where its shape is unknown."""
    match = theory.matches[body]
    return match.fit_frame(estimate.shape[..., match.tracked, :])


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
    is_estimated = [estimate.reason[..., theory.matches[body].tracked] == KNOWN for body in needed]
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


def _points_of_interest(theory: Theory) -> Iterator[PointOfInterest]:
    used = {
        end
        for joint in theory.scene.mechanism.assembly.joints
        for end in ((joint.one, joint.a), (joint.other, joint.b))
    }
    for name, (body, position) in theory.scene.points.items():
        if body == GROUND or (body, position) in used:
            continue
        moved = on_tracked(theory.scene, Force(body, position, 0.0), theory.matches)
        last = name.rpartition('.')[2]
        if moved.body in theory.matches and _TOKEN.fullmatch(last):
            assert isinstance(moved, Force)
            yield PointOfInterest(moved.body, last, complex(moved.point))


def measured_points(theory: Theory, order: int, estimate: Estimate) -> Vectors:
    """Positions of the points (T, P), m, or their derivatives of `order` 1 to 4, as measured."""
    arm, motion = estimate.once(_motion_of_points, theory)
    found = point_motion(order, arm, *motion[:2])
    return _known(theory, estimate, found.value, covariance(found, *motion[2:]))


def path_centers(theory: Theory, estimate: Estimate) -> Vectors:
    """
    Centers of curvature (T, P), m, of the paths of the points, as measured.

    Undetermined near an inflection, where the distance does not stand out of its noise.
    """
    return estimate.once(_paths, theory)[0]


def path_radii(theory: Theory, estimate: Estimate) -> Numbers:
    """Radii (T, P), m, of `path_centers`, positive where the path turns left along its velocity."""
    return estimate.once(_paths, theory)[1]


def _paths(theory: Theory, estimate: Estimate) -> tuple[Vectors, Numbers]:
    """By velocity and acceleration: Euler and Savary need a body that turns."""
    arm, motion = estimate.once(_motion_of_points, theory)

    def center_and_radius(position: Complex, angle: Real) -> Complex:
        place, v, acc = (point_motion(k, arm, position, angle).value for k in range(3))
        across = (v.conj() * acc).imag
        square = np.abs(v) ** 2
        return np.stack((place + 1j * v * square / across, np.abs(v) * square / across), axis=1)

    low = [array[:3] for array in motion[:2]] + [array[:3, :3] for array in motion[2:]]
    (center, radius), (of_center, of_radius) = propagate(center_and_radius, *low)
    found, variance = _known(theory, estimate, center, of_center), of_radius[..., 0, 0]
    with np.errstate(invalid='ignore'):
        is_near = np.abs(radius) < FARTHEST * estimate.size[:, theory.bodies_of_points]
        is_known = found.determined & is_near & (radius.real**2 > SIGNIFICANT**2 * variance)
    return found._replace(determined=is_known), Numbers(radius.real, variance, is_known)


def _motion_of_points(
    theory: Theory, estimate: Estimate
) -> tuple[Complex, tuple[Complex, Real, Real, Real]]:
    """
    Return the points (T, P) in frames at the references of their bodies, and the motion of these.

    The motion is position and angle with their derivatives and covariances. A point is NaN where
    the shape of the body is unknown.
    """
    bodies = theory.bodies_of_points
    frames = [estimate.once(body_frame, theory, point.body) for point in theory.points]
    arms = [
        origin + point.point * np.exp(1j * turn)
        for point, (origin, turn) in zip(theory.points, frames, strict=True)
    ]
    names = 'position', 'angle', 'position_covariance', 'angle_covariance'
    position, angle, *spreads = (getattr(estimate, name)[..., bodies] for name in names)
    return np.stack(arms, axis=1) - estimate.reference[:, bodies], (position, angle, *spreads)


def _known(theory: Theory, estimate: Estimate, value: Complex, matrix: Real) -> Vectors:
    is_finite = np.isfinite(value) & np.isfinite(matrix).all(axis=(-2, -1))
    return Vectors(
        value, matrix, is_finite & (estimate.reason[:, theory.bodies_of_points] == KNOWN)
    )
