"""Discover a linkage from frames of markers."""

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations

import numpy as np

from kinpole_ros.findings import Finding
from kinpole_ros.linkage._bodies import FoundBodies, identify
from kinpole_ros.linkage._body_poses import GROUND, GROUND_NUMBER, BodyPoses, ground
from kinpole_ros.linkage._found_joints import (
    SKIN_STRAIN,
    FoundJoint,
    FoundRolling,
    fit_gear,
    fit_pin,
    fit_slide,
    fit_wheel,
    is_mirrored_pair,
)
from kinpole_ros.linkage._linkage import (
    Linkage,
    body_names,
    connected,
    marker_names,
    merged_pins,
    name_points,
)
from kinpole_ros.linkage._motion_plane import unit_scale
from kinpole_ros.linkage._record import MarkerRecord, Stamps, gather
from kinpole_ros.linkage._space import open_chains
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.statistics import medians
from kinpole_ros.tracking.values import MOST_PAIRED_BODIES

# Residual of a pin or slide over the noise, beyond which another explanation is preferred.
_DOUBTFUL_RATIO = 1.5
# Two hubs on an arm are one axle if they are closer than this many deviations, or than this share
# of the arm.
_SAME_SIGMAS, _SAME_SHARE = 10, 1e-5
# Share of the points that may be of no body without a note.
_MAX_UNASSIGNED = 0.03


def discover(
    parts: Sequence[MarkerFrames],
    progress: Callable[[float], None] | None = None,
    normal: np.ndarray | None = None,
) -> Linkage:
    """
    Discover the linkage that markers show. Their names need not be identities.

    Parameters
    ----------
    parts
        Frames of markers, in order.
    progress
        Called with the share of the work that is done.
    normal
        Normal of the plane (3,), by default that of the motion.

    Returns
    -------
    Linkage
        Its bodies, joints and lengths, and what could not be determined.

    Raises
    ------
    UndiscoveredError
        Where there are too few frames or markers, nothing moves, or nothing is rigid.

    """
    record, stamps = gather(parts)
    bodies = identify(record, normal, progress and (lambda share: progress(0.8 * share)))
    return _linkage_of(record, stamps, bodies)


def _linkage_of(record: MarkerRecord, stamps: Stamps, identified: FoundBodies) -> Linkage:
    scale = unit_scale(max(pose.size for pose in identified.poses))
    is_planar = identified.space is None
    if is_planar:
        identified = _ordered_bodies(identified)
    poses = [_scaled(pose, scale) for pose in identified.poses]
    bodies = {**dict(enumerate(poses)), GROUND_NUMBER: ground(len(record.stamps))}
    names = body_names([[identified.labels[k] for k in body] for body in identified.groups.bodies])
    joints: list[FoundJoint] = []
    rolling: list[FoundRolling] = []
    freedom = 3 * len(poses)
    notes: list[Finding] = []
    # Joints in the plane mean nothing for bodies that leave it.
    if is_planar:
        joints, freedom = _pins(bodies, names, notes, identified.is_soft)
    # Markers on skin seem to slide and roll a little everywhere.
    if not identified.is_soft:
        freedom = _add_slides(bodies, joints, rolling, names, notes, freedom)
        pins = [joint for joint in joints if joint.kind == 'pin']
        for gear in _gears(bodies, pins)[: max(freedom - 1, 0)]:
            rolling.append(gear)
            freedom -= 1
    if is_planar:
        notes += _connection_notes(joints, rolling, names)
    if any(wheel.is_steady for wheel in rolling):
        notes.append(Finding('steady_rates'))
    notes += _marker_notes(record, identified)
    return Linkage(
        names,
        poses,
        marker_names(identified.labels, identified.groups.bodies, names),
        columns=identified.groups.bodies,
        fixed=identified.groups.fixed,
        single=identified.groups.single,
        tracks=identified.tracks * scale,
        seconds=record.seconds,
        ordered=identified.ordered,
        labels=identified.labels,
        plane=identified.plane,
        scale=scale,
        stamps=stamps,
        frame_id=record.frame_id,
        joints=joints,
        rolling=rolling,
        places=name_points(bodies, joints, rolling),
        freedom=freedom,
        notes=notes,
        space=identified.space,
    )


def _ordered_bodies(identified: FoundBodies) -> FoundBodies:
    """Bodies in order of their distance from the ground, as one numbers links from the input."""
    bodies = {**dict(enumerate(identified.poses)), GROUND_NUMBER: ground(len(identified.tracks))}
    neighbors: dict[int, set[int]] = {number: set() for number in bodies}
    for i, j in candidate_pairs(bodies):
        if fit_pin(bodies[i], bodies[j], (i, j))[0] is not None:
            neighbors[i].add(j)
            neighbors[j].add(i)
    turned = [float(np.ptp(pose.angle[pose.seen])) for pose in identified.poses]
    order = [GROUND_NUMBER]
    remaining = set(range(len(identified.poses)))
    for number in order:
        linked = sorted(neighbors[number] & remaining, key=lambda k: -turned[k])
        # From the ground only the body that turns most, to go one way round a loop.
        if number == GROUND_NUMBER:
            linked = linked[:1]
        order += linked
        remaining -= set(linked)
    order += sorted(remaining, key=lambda k: (k not in neighbors[GROUND_NUMBER], -turned[k]))
    order.remove(GROUND_NUMBER)
    groups = identified.groups._replace(bodies=[identified.groups.bodies[k] for k in order])
    return identified._replace(groups=groups, poses=[identified.poses[k] for k in order])


def candidate_pairs(bodies: dict[int, BodyPoses]) -> list[tuple[int, int]]:
    """
    Pairs of bodies that a joint may connect, by number, in the order of `bodies`.

    These are pairs with the ground and with the nearest bodies, by the median distance of their
    markers' means: the number of all pairs grows with the square.
    """
    pairs = list(combinations(bodies, 2))
    moving = [number for number in bodies if number != GROUND_NUMBER]
    if len(moving) <= MOST_PAIRED_BODIES + 1:
        return pairs
    positions = np.array([bodies[number].position for number in moving])
    near: set[tuple[int, int]] = set()
    for number, position in zip(moving, positions, strict=True):
        distances = medians(np.abs(positions - position))
        nearest = np.argsort(distances, kind='stable')[: MOST_PAIRED_BODIES + 1]
        near.update((number, moving[k]) for k in nearest.tolist())
    return [(i, j) for i, j in pairs if GROUND_NUMBER in (i, j) or (i, j) in near or (j, i) in near]


def _scaled(pose: BodyPoses, scale: float) -> BodyPoses:
    if scale == 1:
        return pose
    return pose._replace(
        position=pose.position * scale,
        shape=pose.shape * scale,
        noise=pose.noise * scale,
        position_variance=pose.position_variance * scale**2,
    )


def _pins(
    bodies: dict[int, BodyPoses], names: list[str], notes: list[Finding], is_soft: bool
) -> tuple[list[FoundJoint], int]:
    """Pins of bodies, those on the ground first, and the degrees of freedom that they leave."""
    pins: list[FoundJoint] = []
    moving = {k: bodies[k] for k in range(len(names))}
    for i, j in candidate_pairs(moving):
        pin, turns = fit_pin(bodies[i], bodies[j], (i, j), SKIN_STRAIN * is_soft)
        if pin is not None:
            pins.append(pin)
        elif not turns and not is_soft:
            about = {'one': names[i], 'other': names[j]}
            notes.append(Finding('no_relative_turn', values=about))
    if is_soft:
        pins = open_chains(pins, len(names))
    for k in moving:
        pin, turns = fit_pin(bodies[k], bodies[GROUND_NUMBER], (k, GROUND_NUMBER))
        if pin is not None:
            pins.append(pin)
        elif not turns and not is_soft:
            notes.append(Finding('no_turn', names[k]))
    pins.sort(key=lambda pin: pin.ratio)
    freedom = _freedom(len(names), pins)
    # If the pins leave no motion, those that fit worst are no pins but nearly so.
    while freedom < 1 and pins and pins[-1].ratio > _DOUBTFUL_RATIO:
        pins.pop()
        freedom = _freedom(len(names), pins)
    pins.sort(key=lambda pin: (pin.other != GROUND_NUMBER, min(pin.one, pin.other), pin.one))
    return pins, freedom


def _freedom(count: int, pins: Sequence[FoundJoint]) -> int:
    """Degrees of freedom of bodies on pins; three bodies on one axle have two independent pins."""
    return 3 * count - 2 * sum(len(on) - 1 for on, _ in merged_pins(pins))


def _add_slides(
    bodies: dict[int, BodyPoses],
    joints: list[FoundJoint],
    rolling: list[FoundRolling],
    names: list[str],
    notes: list[Finding],
    freedom: int,
) -> int:
    """Add slides, and wheels on their lines, to the joints; returns the degrees of freedom left."""
    pinned = {frozenset((pin.one, pin.other)) for pin in joints}
    pairs = [pair for pair in candidate_pairs(bodies) if frozenset(pair) not in pinned]
    for joint, is_only_one in _slides(bodies, pairs):
        if is_mirrored_pair(bodies[joint.one], joint):
            notes.append(Finding('trammel_or_pin', names[joint.one]))
            continue
        removed = 2 if joint.kind in ('trammel', 'slide') else 1
        # With a joint that holds more, nothing could move.
        if freedom - removed < 1:
            continue
        freedom -= removed
        if joint.kind == 'slot' and freedom > 1:
            wheel = fit_wheel(bodies[joint.one], bodies[joint.other], joint)
            if wheel is not None:
                rolling.append(wheel)
                freedom -= 1
                continue
        joints.append(joint)
        if not is_only_one:
            mover, base = (
                GROUND if k == GROUND_NUMBER else names[k] for k in (joint.one, joint.other)
            )
            notes.append(Finding('line_of_either', values={'one': mover, 'other': base}))
    return freedom


def _slides(
    bodies: dict[int, BodyPoses], pairs: Iterable[tuple[int, int]]
) -> list[tuple[FoundJoint, bool]]:
    """
    The slide that fits best of each pair that has one, those that fit best first.

    With each comes whether it is the only one of its pair that fits.
    """
    slides = []
    for pair in pairs:
        fitted = [fit_slide(bodies[i], bodies[j], (i, j)) for i, j in (pair, pair[::-1])]
        fits = [joint for joint in fitted if joint is not None]
        # A slide that fits much worse than the other is only near to one, by chance.
        least = max(1.0, min((joint.ratio for joint in fits), default=1.0))
        fits = [joint for joint in fits if joint.ratio <= _DOUBTFUL_RATIO * least]
        # A trammel holds the most, and looks like a slot from the other side.
        fits.sort(key=lambda joint: (joint.kind != 'trammel', joint.kind != 'slide', joint.ratio))
        slides += [(joint, len(fits) == 1) for joint in fits[:1]]
    # Slides on the ground are more common than between bodies.
    return sorted(
        slides, key=lambda row: (GROUND_NUMBER not in (row[0].one, row[0].other), row[0].ratio)
    )


def _gears(bodies: dict[int, BodyPoses], pins: Sequence[FoundJoint]) -> list[FoundRolling]:
    """Pairs of gears on one arm, those that fit best first."""
    sides = [(pin.one, pin.on_one, pin.other, pin.on_other, pin.deviation[0]) for pin in pins]
    sides += [(j, on_j, i, on_i, deviation) for i, on_i, j, on_j, deviation in sides]
    # The wheel of two gears is the one that is not pinned to the ground.
    grounded = {pin.one for pin in pins if pin.other == GROUND_NUMBER}
    sides.sort(key=lambda side: side[0] in grounded)
    gears: list[FoundRolling] = []
    for i, hub, arm, hub_on_arm, _ in sides:
        for j, center, arm_of_j, center_on_arm, deviation in sides:
            if i in (GROUND_NUMBER, j) or arm_of_j != arm:
                continue
            axle = max(_SAME_SIGMAS * deviation, _SAME_SHARE * bodies[arm].size)
            is_one_axle = abs(hub_on_arm - center_on_arm) < axle
            if is_one_axle or any({gear.one, gear.other} == {i, j} for gear in gears):
                continue
            gear = fit_gear(
                (bodies[i], bodies[j], bodies[arm]),
                (i, j, arm),
                (hub, hub_on_arm, center, center_on_arm),
                deviation,
            )
            if gear is not None:
                gears.append(gear)
    return sorted(gears, key=lambda gear: gear.residual / gear.expected)


def _connection_notes(
    joints: Sequence[FoundJoint], rolling: Sequence[FoundRolling], names: list[str]
) -> list[Finding]:
    """Notes on pairs of bodies that were not examined, and on bodies that nothing connects."""
    notes: list[Finding] = []
    if len(names) > MOST_PAIRED_BODIES + 1:
        about = {'count': len(names), 'most': MOST_PAIRED_BODIES}
        notes.append(Finding('nearest_joints', values=about))
    loose = [name for k, name in enumerate(names) if k not in connected(joints, rolling)]
    if loose:
        notes.append(Finding('not_connected', values={'names': ', '.join(loose)}))
    return notes


def _marker_notes(record: MarkerRecord, identified: FoundBodies) -> list[Finding]:
    """Notes on exchanged names, and on points that are of no body."""
    notes: list[Finding] = []
    times: dict[tuple[str, str], list[int]] = {}
    for frame, *pair in record.exchanged:
        times.setdefault((pair[0], pair[1]), []).append(frame)
    for (first, second), frames in times.items():
        often = f', {len(frames)} times in all' if len(frames) > 1 else ''
        seconds = float(record.seconds[frames[0]])
        exchanged = {'one': first, 'other': second, 'seconds': seconds, 'often': often}
        notes.append(Finding('names_exchanged', values=exchanged))
    if identified.ordered and record.unreliable_names:
        notes.append(Finding('names_doubtful'))
    seen, assigned = (
        int(np.isfinite(points.real).sum()) for points in (record.points[..., 0], identified.tracks)
    )
    share = 1 - assigned / seen
    if not identified.ordered and share > _MAX_UNASSIGNED:
        notes.append(Finding('unassigned', values={'share': share}))
    return notes
