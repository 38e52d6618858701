"""Frames of markers in, a linkage out: the steps one after the other."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from kinpole_ros.linkage._columns import medians
from kinpole_ros.linkage._identify import Bodies, identify
from kinpole_ros.linkage._joints import GIVES, Joint, fit_pin, fit_slide
from kinpole_ros.linkage._model import GROUND_NUMBER, Linkage
from kinpole_ros.linkage._names import body_names, marker_names
from kinpole_ros.linkage._places import connected, make_places
from kinpole_ros.linkage._plane import scale_of
from kinpole_ros.linkage._poses import GROUND, Pose, ground
from kinpole_ros.linkage._record import Record, Stamps, gather
from kinpole_ros.linkage._rolling import Rolling, fit_gear, fit_wheel
from kinpole_ros.linkage._space import tree_of
from kinpole_ros.tracking.estimate import MOST_PAIRED_BODIES
from kinpole_ros.tracking.frame import MarkerFrames

# Times the noise a pin may leave over without doubt.
_DOUBTFUL = 1.5
# Two places nearer than this share of a body's size are one, even without noise.
_SAME_PLACE = 1e-5
# Share of the points that may be of no body: passing others, they cannot always be identified.
_LEFT_OVER = 0.03


def discover(
    parts: Sequence[MarkerFrames],
    progress: Callable[[float], None] | None = None,
    normal: np.ndarray | None = None,
) -> Linkage:
    """
    The linkage whose markers `parts` hold, in order; identities need not be right.

    The plane has this `normal` (3,), or is found from the motion.

    Raises UndiscoveredError, with the fix, where there is too little to find anything.
    """
    record, stamps = gather(parts)
    most = None if progress is None else (lambda share: progress(0.8 * share))
    found = identify(record, normal, most)
    return _linkage_from(record, stamps, found)


def _linkage_from(record: Record, stamps: Stamps, found: Bodies) -> Linkage:
    scale = scale_of(max(pose.size for pose in found.poses))
    if found.space is None:
        found = _in_order(found)
    poses = [_scaled(pose, scale) for pose in found.poses]
    standing = ground(len(record.stamps))
    bodies = {**dict(enumerate(poses)), GROUND_NUMBER: standing}
    notes: list[str] = []
    names = body_names([[found.labels[k] for k in body] for body in found.groups.bodies])
    # Joints of a plane say nothing of bodies that leave it.
    is_planar = found.space is None
    pins = _pins(bodies, names, notes, found.is_soft) if is_planar else []
    freedom = 3 * len(poses) - 2 * _independent(pins)
    # Where more is held than lets it move, what fits worst is no pin but nearly one.
    while freedom < 1 and pins and pins[-1].ratio > _DOUBTFUL:
        pins.pop()
        freedom = 3 * len(poses) - 2 * _independent(pins)
    pins.sort(key=lambda pin: (pin.other != GROUND_NUMBER, min(pin.one, pin.other), pin.one))
    joints: list[Joint] = list(pins)
    rolling: list[Rolling] = []
    pinned = {frozenset((joint.one, joint.other)) for joint in pins}
    # On skin anything seems to slide a little.
    slides = [] if found.is_soft else _slides(bodies, pinned)
    for joint, is_only_one in slides:
        held = 2 if joint.kind in ('trammel', 'slide') else 1
        # With one that holds more, nothing could move.
        if freedom - held < 1:
            continue
        joints.append(joint)
        freedom -= held
        if joint.kind == 'slot' and freedom > 1:
            wheel = fit_wheel(bodies[joint.one], bodies[joint.other], joint)
            if wheel is not None:
                joints.remove(joint)
                rolling.append(wheel)
                freedom -= 1
        if joint in joints and not is_only_one:
            one, other = (
                GROUND if k == GROUND_NUMBER else names[k] for k in (joint.one, joint.other)
            )
            notes.append(
                f'{one} on {other}: a line on either of them fits, and which it is cannot be told '
                'from so little motion; fix: move them farther, or correct the draft'
            )
    for gear in [] if found.is_soft else _gears(bodies, pins):
        if freedom > 1:
            rolling.append(gear)
            freedom -= 1
    if is_planar and len(poses) > MOST_PAIRED_BODIES + 1:
        notes.append(
            f'joints of each of the {len(poses)} bodies are sought with the ground and the '
            f'{MOST_PAIRED_BODIES} nearest bodies only'
        )
    if is_planar:
        _note_loose(joints, rolling, names, notes)
    _note_exchanged(record, notes)
    if found.ordered and record.doubted:
        notes.append(
            'names of markers that pass each other seem to be exchanged; the bodies are rigid by '
            'them, so they are taken as they are'
        )
    _note_left_over(record, found, notes)
    return Linkage(
        names,
        poses,
        marker_names(found, names),
        found.groups.bodies,
        found.groups.fixed,
        found.groups.single,
        found.tracks * scale,
        record.seconds,
        found.ordered,
        found.labels,
        found.plane,
        scale,
        stamps,
        record.frame_id,
        joints,
        rolling,
        make_places(bodies, joints, rolling),
        freedom,
        notes,
        found.space,
    )


def _in_order(found: Bodies) -> Bodies:
    """From the ground on, first what turns farthest there: as one names links from the input."""
    count = len(found.poses)
    bodies = {**dict(enumerate(found.poses)), GROUND_NUMBER: ground(len(found.tracks))}
    near: dict[int, set[int]] = {number: set() for number in bodies}
    for pair in _candidates(bodies):
        if fit_pin(bodies[pair[0]], bodies[pair[1]], pair)[0] is not None:
            near[pair[0]].add(pair[1])
            near[pair[1]].add(pair[0])
    turned = [float(np.ptp(pose.angle[pose.seen])) for pose in found.poses]
    order = [GROUND_NUMBER]
    rest = set(range(count))
    for number in order:
        # One way round a loop, before the other way.
        more = sorted(near[number] & rest, key=lambda k: -turned[k])
        if number == GROUND_NUMBER:
            more = more[:1]
        order += more
        rest -= set(more)
    order += sorted(rest, key=lambda k: (k not in near[GROUND_NUMBER], -turned[k]))
    order.remove(GROUND_NUMBER)
    groups = found.groups._replace(bodies=[found.groups.bodies[k] for k in order])
    return found._replace(groups=groups, poses=[found.poses[k] for k in order])


def _candidates(bodies: dict[int, Pose]) -> list[tuple[int, int]]:
    """
    List the pairs of bodies that a joint may connect, by their numbers, in the order of `bodies`.

    All pairs of a body with the ground and with its nearest bodies, by the median distance of their
    markers' means: with all others the number of pairs would grow with the square.
    """
    pairs = list(combinations(bodies, 2))
    moving = [number for number in bodies if number != GROUND_NUMBER]
    if len(moving) <= MOST_PAIRED_BODIES + 1:
        return pairs
    places = np.array([bodies[number].position for number in moving])
    near: set[tuple[int, int]] = set()
    for number, place in zip(moving, places, strict=True):
        distances, _ = medians(np.abs(places - place))
        nearest = np.argsort(distances, kind='stable')[: MOST_PAIRED_BODIES + 1]
        near.update((number, moving[k]) for k in nearest.tolist())
    return [
        (one, other)
        for one, other in pairs
        if GROUND_NUMBER in (one, other) or (one, other) in near or (other, one) in near
    ]


def _scaled(pose: Pose, scale: float) -> Pose:
    if scale == 1:
        return pose
    return pose._replace(
        position=pose.position * scale,
        shape=pose.shape * scale,
        noise=pose.noise * scale,
        position_variance=pose.position_variance * scale**2,
    )


def _pins(
    bodies: dict[int, Pose], names: list[str], notes: list[str], is_soft: bool
) -> list[Joint]:
    pins: list[Joint] = []
    for one, other in _candidates({k: bodies[k] for k in range(len(names))}):
        joint, turns = fit_pin(bodies[one], bodies[other], (one, other), GIVES * is_soft)
        if joint is not None:
            pins.append(joint)
        elif not turns and not is_soft:
            notes.append(
                f'{names[one]} and {names[other]} do not turn against each other: whether a pin '
                'joins them, and where, cannot be determined'
            )
    if is_soft:
        pins = tree_of(pins, len(names))
    for one in range(len(names)):
        joint, turns = fit_pin(bodies[one], bodies[GROUND_NUMBER], (one, GROUND_NUMBER))
        if joint is not None:
            pins.append(joint)
        elif not turns and not is_soft:
            notes.append(
                f'{names[one]} does not turn: it has no pin to the ground that can be seen'
            )
    return sorted(pins, key=lambda joint: joint.ratio)


def _independent(pins: Sequence[Joint]) -> int:
    """How many of the pins hold something: of three bodies on one axle two pins do."""
    groups = make_places({}, list(pins), [])
    return sum(len(place.on) - 1 for place in groups)


def _slides(bodies: dict[int, Pose], pinned: set[frozenset[int]]) -> list[tuple[Joint, bool]]:
    """
    Find slides of all pairs that no pin joins, those that fit best first, one for each pair.

    With each comes whether it is the only one of its pair that fits.
    """
    found = []
    for pair in _candidates(bodies):
        if frozenset(pair) in pinned:
            continue
        tried = [
            joint
            for one, other in (pair, pair[::-1])
            if (joint := fit_slide(bodies[one], bodies[other], (one, other))) is not None
        ]
        # One that fits much worse is only near to it, by chance.
        least = max(1.0, min((joint.ratio for joint in tried), default=1.0))
        tried = [joint for joint in tried if joint.ratio <= _DOUBTFUL * least]
        # A trammel holds the most, and looks like a slot from the other side.
        tried.sort(key=lambda joint: (joint.kind != 'trammel', joint.kind != 'slide', joint.ratio))
        found += [(joint, len(tried) == 1) for joint in tried[:1]]
    # Slides on the ground are more usual than between bodies.
    return sorted(
        found, key=lambda row: (GROUND_NUMBER not in (row[0].one, row[0].other), row[0].ratio)
    )


def _gears(bodies: dict[int, Pose], pins: Sequence[Joint]) -> list[Rolling]:
    """Pairs of gears on one arm, those that fit best first."""
    sides = [
        (joint.one, joint.on_one, joint.other, joint.on_other, joint.deviation[0]) for joint in pins
    ]
    sides += [(other, b, one, a, deviation) for one, a, other, b, deviation in sides]
    found: list[Rolling] = []
    # Of two gears the wheel is the one that is not pinned to the ground.
    grounded = {joint.one for joint in pins if joint.other == GROUND_NUMBER}
    sides.sort(key=lambda side: side[0] in grounded)
    for one, hub, arm, at, _ in sides:
        for other, center, same, there, deviation in sides:
            if one in (GROUND_NUMBER, other) or same != arm:
                continue
            # Two wheels on one axle.
            if abs(at - there) < max(10 * deviation, _SAME_PLACE * bodies[arm].size):
                continue
            if any({g.one, g.other} == {one, other} for g in found):
                continue
            gear = fit_gear(
                bodies[one],
                bodies[other],
                bodies[arm],
                (one, other, arm),
                (hub, at, center, there),
                deviation,
            )
            if gear is not None:
                found.append(gear)
    return sorted(found, key=lambda gear: gear.residual / gear.expected)


def _note_loose(
    joints: Sequence[Joint], rolling: Sequence[Rolling], names: list[str], notes: list[str]
) -> None:
    reached = connected(joints, rolling)
    loose = [name for k, name in enumerate(names) if k not in reached]
    if loose:
        notes.append(
            f'no joint connects {", ".join(loose)} with the ground: mark the bodies between, or '
            'move the rig further'
        )


def _note_exchanged(record: Record, notes: list[str]) -> None:
    times: dict[tuple[str, str], list[int]] = {}
    for frame, one, other in record.exchanged:
        times.setdefault((one, other), []).append(frame)
    for (one, other), frames in times.items():
        often = f', {len(frames)} times in all' if len(frames) > 1 else ''
        notes.append(
            f'{one!r} and {other!r} exchange names at {record.seconds[frames[0]]:.2f} s{often}: '
            'they are taken as they move; fix: correct the labels in the tracker'
        )


def _note_left_over(record: Record, found: Bodies, notes: list[str]) -> None:
    """Of points with names the table says which are of no body."""
    seen, taken = (int(np.isfinite(of.real).sum()) for of in (record.points[..., 0], found.tracks))
    share = 1 - taken / seen
    if not found.ordered and share > _LEFT_OVER:
        notes.append(
            f'{share:.0%} of the points are of no body that was found: markers may be missing from '
            'some; fix: give the markers names, or take more frames a second'
        )
