"""
A scene compared with the measurement: what the linkage's theory says of the tracked bodies.

The scene's markers tell how its body frames lie in the measured bodies. Their positions are held
against its joints, whatever drives it (`positions`). Where its one driver is the angle of a tracked
body, it can also be put where the rig is, at its rates, and these be held against all else.
"""

from collections.abc import Container
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.linkage._places import match_places
from kinpole_ros.linkage._scene_poses import Lie
from kinpole_ros.linkage.positions import Positions, PositionsFound
from kinpole_ros.mechanism import (
    GROUND,
    Force,
    LinkageError,
    Load,
    Mechanism,
    Motion,
    Revolute,
    Scene,
    SceneError,
    load_scene,
    part_sum,
)
from kinpole_ros.planar import (
    Port,
    center_offset,
    fit_pose,
    measured_balance,
    to_complex,
)
from kinpole_ros.tracking.estimate import SIGNIFICANT, Estimate, Numbers
from kinpole_ros.tracking.parameters import POSE_TYPES, ParameterError, Settings, of_poses

# ns. A recording is looked at as often: never at one place of the turn, whatever the rate is like.
_EVERY = 618_033_989


class Difference(NamedTuple):
    """
    A measured figure less the theory's, or the distance of the two, and its deviation.

    `subject` is the body or joint, `what` the figure, both in `unit`.
    """

    subject: str
    what: str
    unit: str
    value: float
    deviation: float


class DeviationSummary(NamedTuple):
    """A difference over a recording: its rms, and that of it in deviations, of some instants."""

    subject: str
    what: str
    unit: str
    rms: float
    deviations: float
    instants: int


class Theory(NamedTuple):
    """
    A scene and how it goes with the tracked bodies.

    `places` gives each body of both its number among the tracked, its number in the scene, which
    of its tracked markers are the scene's (k,), and where those are in the scene's frame, complex,
    m. `driver` is the body that the scene's one driver turns, '' where it is no tracked body's
    angle. `loads` are those of the scene, each on a body that is tracked.
    """

    scene: Scene
    places: dict[str, tuple[int, int, np.ndarray, np.ndarray]]
    driver: str
    loads: tuple[Load, ...]

    @property
    def balances(self) -> bool:
        """Whether the scene has loads, and a tracked body that can balance them."""
        return bool(self.loads) and bool(self.driver or self.scene.held_by)

    @property
    def lies(self) -> dict[str, Lie]:
        """How the bodies of both lie in each other."""
        return {body: Lie(b, here, known) for body, (b, _, here, known) in self.places.items()}


def load_theory(settings: Settings) -> Theory:
    """
    Load the scene that the parameter `scene` names, and find the tracked bodies in it.

    Raises ParameterError where the scene cannot be used, or does not go with the bodies.
    """
    try:
        scene = load_scene(settings.scene)
    except SceneError as error:
        raise ParameterError(f'parameter scene: {error}') from None

    def refuse(why: str) -> ParameterError:
        return ParameterError(f'parameter scene is {settings.scene}: {why}')

    places = {}
    posed = settings.marker_type in POSE_TYPES
    # The frames of poses are those of the scene's bodies.
    shapes = of_poses(settings).shapes if posed else {}
    for b, (body, markers) in enumerate(settings.bodies.items()):
        if posed and body in scene.mechanism.bodies:
            shape = np.array(shapes[body])
            places[body] = (b, scene.mechanism.bodies.index(body), np.arange(len(shape)), shape)
            continue
        if body not in scene.marker_names:
            continue
        names = scene.marker_names[body]
        number = scene.mechanism.bodies.index(body)
        if not markers:
            # The rig gives only the shape: the scene's markers are found in it by their places.
            known = to_complex(scene.markers[body])
            pairs = match_places(known, np.array(settings.shapes[body]))
            if pairs is None:
                raise refuse(
                    f'the {len(known)} markers of its {body} are not where parameter {body}.shape '
                    'has them; give both the same distances between the markers'
                )
            places[body] = (b, number, pairs[1], known[pairs[0]])
            continue
        here = [k for k, marker in enumerate(markers) if marker in names]
        if len(here) < 2:
            raise refuse(
                f'its {body} has the markers {", ".join(names)}; parameter {body}.markers must '
                'name two of them at least'
            )
        known = to_complex(scene.markers[body])[[names.index(markers[k]) for k in here]]
        places[body] = (b, number, np.array(here), known)
    if not places:
        raise refuse(
            f'it has markers on {", ".join(scene.markers) or "no body"}, and the parameter bodies '
            f'names {", ".join(settings.bodies)}; give both the same names'
        )
    drivers, turns = scene.mechanism.drivers, scene.mechanism.assembly.turns
    driven = [
        body
        for body, place in places.items()
        if len(drivers) == 1 and np.array_equal(turns[place[1]], drivers[0].row)
    ]
    loads = tuple(on_tracked(scene, load, places) for load in scene.loads)
    for load in loads:
        if load.body not in places:
            raise refuse(f'it has a load on {load.body}, which is not tracked')
    if scene.held_by is not None:
        for body in (scene.held_by.body, scene.held_by.of):
            if body not in (*places, GROUND):
                raise refuse(f'its loads are held_by {body}, which is not tracked')
    return Theory(scene, places, driven[0] if driven else '', loads)


def on_tracked(scene: Scene, load: Load, tracked: Container[str]) -> Load:
    """The load on a tracked body that is one with its own, as vectors are that turn together."""
    if load.body in tracked:
        return load
    equations = scene.equations
    values = [one.value for one in equations.dimensions]
    home, offset = equations.frames[load.body]
    for body, (other, of_other) in equations.frames.items():
        if other == home and body in tracked:
            moved = part_sum(offset, values)[0] - part_sum(of_other, values)[0]
            if isinstance(load, Force):
                return load._replace(body=body, point=load.point + moved)
            return load._replace(body=body)
    return load


# Origin (complex, m) and angle of the scene's body frames in those of the tracked bodies, (T,).
Frames: TypeAlias = dict[str, tuple[np.ndarray, np.ndarray]]


def rate_differences(theory: Theory, estimate: Estimate) -> list[Difference]:
    """
    Of bodies, their angular velocity (rad/s) less what the scene says, the driver being as seen.

    Only for bodies of which enough is known; empty where the scene cannot be put where the rig is.
    """
    if not theory.driver:
        return []
    b, _, _, _ = theory.places[theory.driver]
    frames = body_frames(theory, estimate)
    if theory.driver not in frames or estimate.missing[b]:
        return []
    mechanism = theory.scene.mechanism
    start = float(mechanism.drivers[0].motion(np.zeros(1))[0, 0])
    turned = estimate.angle[0, b] + frames[theory.driver][1] - start
    swept = _swept(mechanism, start, (turned + np.pi) % (2 * np.pi) - np.pi)
    if swept is None:
        return []
    # Per rad of the driver: the ratio of the rates, and how it changes.
    ratio, bend = swept.angle[1, :, 0], swept.angle[2, :, 0]
    rate, noise = estimate.angle[1, b], estimate.angle_covariance[:2, :2, b]
    found = []
    for body, (own, number, _, _) in theory.places.items():
        if body == theory.driver or estimate.missing[own] or not np.isfinite(ratio[number]):
            continue
        by = np.array([bend[number] * rate, ratio[number]])
        variance = estimate.angle_covariance[1, 1, own] + by @ noise @ by
        value = estimate.angle[1, own] - ratio[number] * rate
        what = 'angular velocity less theory'
        found.append(Difference(body, what, 'rad/s', float(value), float(np.sqrt(variance))))
    return found


def _swept(mechanism: Mechanism, start: float, ahead: float) -> Motion | None:
    """With the driver `ahead` of its start, or the other way round if it cannot go there so."""
    for way in (ahead, ahead - np.copysign(2 * np.pi, ahead)):
        try:
            return mechanism.sweep(np.array([start + way]))
        except LinkageError:
            continue
    return None


def joint_offsets(theory: Theory, estimate: Estimate) -> list[Difference]:
    """
    Of pins between two tracked bodies, how far off them the relative instant centers are (m).

    The pin is where the scene has it on the bodies, as they are seen; `deviation` is the distance
    that is one of Mahalanobis'. Only where the center is determined.
    """
    frames = body_frames(theory, estimate)
    pairs = {(int(j), int(i)): k for k, (j, i) in enumerate(zip(*estimate.pairs, strict=True))}
    found = []
    for joint in theory.scene.mechanism.assembly.joints:
        if not isinstance(joint, Revolute) or not {joint.one, joint.other} <= set(frames):
            continue
        one, other = theory.places[joint.one][0], theory.places[joint.other][0]
        k = pairs.get((max(one, other), min(one, other)))
        center = estimate.relative_icr
        if k is None or not center.determined[k]:
            continue
        place, turn = frames[joint.one]
        point = place + joint.a * np.exp(1j * turn)
        at = estimate.origin(0)[one] + point * np.exp(1j * estimate.angle[0, one])
        distance, deviations = center_offset(center.value[k], at, center.covariance[k])
        if deviations > 0:
            off = float(distance), float(distance / deviations)
            found.append(Difference(joint.name, 'relative center off the pin', 'm', *off))
    return found


class Comparison:
    """How far bodies are from a scene over a recording."""

    def __init__(self, theory: Theory) -> None:
        self._theory = theory
        self._positions = Positions(theory.scene, theory.lies)
        self._latest: Estimate | None = None
        # By subject, figure and unit: instants, and sums of squares of values and of deviations.
        self._sums: dict[tuple[str, str, str], np.ndarray] = {}

    def add(self, estimate: Estimate) -> None:
        """Take estimates (T, B): all of their positions, and the rates of some instants."""
        self._positions.add(estimate)
        part = estimate.stamp // _EVERY
        # The very first is known worst.
        last = part[0] if self._latest is None else self._latest.stamp[-1] // _EVERY
        for k in (part != np.append(last, part[:-1])).nonzero()[0]:
            self._look(estimate[int(k)])
        self._latest = estimate

    def _look(self, now: Estimate) -> None:
        for off in (*rate_differences(self._theory, now), *joint_offsets(self._theory, now)):
            if off.deviation > 0:
                sums = self._sums.setdefault(off[:3], np.zeros(3))
                sums += 1, off.value**2, (off.value / off.deviation) ** 2

    def positions(self) -> PositionsFound | None:
        """What the positions say, None where they say nothing of the scene's joints."""
        return self._positions.found()

    def found(self) -> list[DeviationSummary]:
        """All differences of rates; empty where the scene could not be put where the rig is."""
        if not self._sums and self._latest is not None:
            self._look(self._latest[-1])
        result = []
        for names, (instants, *squares) in self._sums.items():
            rms, deviations = np.sqrt(squares / instants).tolist()
            result.append(DeviationSummary(*names, rms, deviations, int(instants)))
        return result


def balance(theory: Theory, estimate: Estimate) -> Numbers:
    """
    What balances the scene's loads at the velocities seen, (T,).

    A torque on the driven body, N m; or what the scene's `held_by` says: a torque on a body, or a
    force, N, along `balance_direction`. Determined where all the bodies are known and what it acts
    on moves by more than its noise.
    """
    frames = body_frames(theory, estimate)
    held = theory.scene.held_by
    acting = {theory.driver} if held is None else {held.body, held.of} - {GROUND}
    needed = acting | {load.body for load in theory.loads}
    if not needed <= set(frames):
        unknown = np.full(np.shape(estimate.stamp), np.nan)
        return Numbers(unknown, unknown, np.isfinite(unknown))
    through = Port(theory.places[theory.driver if held is None else held.body][0], 1.0)
    way = balance_direction(theory, estimate)
    if held is not None and held.point is not None and way is not None:
        through = _port(theory, Force(held.body, held.point, way), frames, estimate)
    ports = [_port(theory, load, frames, estimate) for load in theory.loads]
    value, variance, determined = measured_balance(
        through,
        ports,
        np.moveaxis(estimate.position, -1, 1),
        np.moveaxis(estimate.angle, -1, 1),
        np.moveaxis(estimate.position_covariance, -1, 2),
        np.moveaxis(estimate.angle_covariance, -1, 2),
        SIGNIFICANT,
    )
    known = [estimate.missing[..., theory.places[body][0]] == '' for body in needed]
    return Numbers(
        np.asarray(value), np.asarray(variance), np.asarray(determined) & np.all(known, axis=0)
    )


def balance_direction(theory: Theory, estimate: Estimate) -> np.ndarray | None:
    """The direction (T,), complex, of the force that `balance` is, None where it is a torque."""
    held = theory.scene.held_by
    if held is None or held.point is None:
        return None
    way = np.full(np.shape(estimate.stamp), np.exp(1j * held.along))
    frames = body_frames(theory, estimate)
    if held.of in frames:
        turn = estimate.angle[0][..., theory.places[held.of][0]] + frames[held.of][1]
        # Where it is not known, neither is the force.
        way = way * np.exp(1j * np.where(np.isfinite(turn), turn, 0.0))
    return np.asarray(way)


def _port(theory: Theory, load: Load, frames: Frames, estimate: Estimate) -> Port:
    b = theory.places[load.body][0]
    if isinstance(load, Force):
        place, turn = frames[load.body]
        # From the point whose velocity is known.
        arm = place + load.point * np.exp(1j * turn) - estimate.reference[..., b]
        return Port(b, np.asarray(load.force, complex)[()], arm)
    return Port(b, complex(load.torque))  # type: ignore[arg-type]


def body_frames(theory: Theory, estimate: Estimate) -> Frames:
    """How the scene's frames lie in the tracked bodies, of those that are known."""
    found = {}
    for body, (b, _, markers, known) in theory.places.items():
        shape = estimate.shape[..., b, markers]
        fit = fit_pose(shape, known, np.isfinite(shape).astype(float))
        if np.isfinite(fit.angle).any():
            found[body] = (fit.position, fit.angle)
    return found
