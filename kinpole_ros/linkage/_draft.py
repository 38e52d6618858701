"""
The draft scene of a discovered linkage: text for `kinpole solve` and `kinpole simulate`.

Each body has its first point for origin and its x axis toward the second point, so that the file
shows lengths as one would write them.
"""

from collections.abc import Iterator
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._body_poses import GROUND_NUMBER, BodyPoses, ground
from kinpole_ros.linkage._drivers import fit_drive
from kinpole_ros.linkage._found_joints import FoundJoint, FoundRolling
from kinpole_ros.linkage._linkage import LINE, Linkage, connected, trammel_ends
from kinpole_ros.mechanism import LinkageError, SceneError, load_scene, marker_positions

_DECIMALS = 7  # of a length, m
# Points of a body this share of its size apart are one but for noise, and give no direction.
_MIN_DIRECTION = 1e-3
# Frames at which a draft is compared with the markers, and the time that they span, s.
_COMPARED_FRAMES, _COMPARED_SECONDS = 20, 2.0
# Drafts that are tried. The first whose markers are closer than this many times the noise is taken.
_MAX_DRAFTS, _CLOSE = 6, 5.0
# A draft explains the markers up to this many times the noise.
_EXPLAINED = 6.0
_MIN_NOISE = 1e-6  # m


class Checked(NamedTuple):
    """
    How well a draft scene explains the markers that it was drawn from.

    Attributes
    ----------
    problem
        Why it cannot be loaded or moved, '' if it can.
    first
        Rms distance of its markers from those measured at the first frame, m; NaN without markers.
    later
        The same over the first 2 s. The drivers are fits, too.
    noise
        Noise of the markers, m.

    """

    problem: str
    first: float
    later: float
    noise: float = 0.0

    @property
    def drives(self) -> bool:
        """Whether its drivers move it as measured for a while."""
        return not self.later > _EXPLAINED * self.noise

    @property
    def explains(self) -> bool:
        """Whether it can be moved, and explains the first frame to within the noise."""
        return not self.problem and not self.first > _EXPLAINED * self.noise


class _Frame(NamedTuple):
    """A body's frame in the scene, among its markers: origin, and angle of its x axis."""

    origin: complex
    angle: float

    def local(self, point: complex) -> complex:
        return complex((point - self.origin) * np.exp(-1j * self.angle))


class _Sketch(NamedTuple):
    """
    What the text is made of, by number of the body.

    `first` is the frame at which the scene starts, `angles` are those of the bodies there.
    """

    linkage: Linkage
    bodies: list[int]
    frames: dict[int, _Frame]
    points: dict[int, dict[str, complex]]
    angles: dict[int, float]
    first: int

    def name(self, number: int) -> str:
        return self.linkage.name(number)

    def pose(self, number: int) -> BodyPoses:
        if number == GROUND_NUMBER:
            return ground(len(self.linkage.seconds))
        return self.linkage.poses[number]

    def point(self, body: int, position: complex) -> str:
        """The name of the point of a body that is nearest to a position."""
        points = [p for p in self.linkage.places if body in p.on and not p.name.endswith(LINE)]
        return min(points, key=lambda p: abs(p.on[body] - position)).name


def draft(linkage: Linkage, about: str = '') -> tuple[str, Checked] | None:
    """
    Draft the scene of a linkage, driven as it moved.

    Parameters
    ----------
    linkage
        From `discover`.
    about
        Comment at the head of the file.

    Returns
    -------
    tuple or None
        The scene as text, and how well it explains the markers: the first draft that does, or the
        best one. None where nothing is connected to the ground, or bodies leave the plane.

    """
    if linkage.space is not None:
        return None
    best: tuple[str, Checked] | None = None
    for text in islice(_drafts(linkage, about), _MAX_DRAFTS):
        checked = check_draft(text, linkage)
        if best is None or _distance(checked) < _distance(best[1]):
            best = text, checked
        if not checked.problem and not checked.first > _CLOSE * checked.noise:
            break
    return best


def _distance(checked: Checked) -> float:
    return np.inf if checked.problem else float(np.nan_to_num(checked.first))


def check_draft(text: str, linkage: Linkage) -> Checked:
    """
    Compare a draft scene with the markers of its linkage.

    Parameters
    ----------
    text
        The scene.
    linkage
        The linkage that it was drawn from.

    Returns
    -------
    Checked
        How well it explains the markers.

    """
    noise = max(float(np.median([pose.noise for pose in linkage.poses])), _MIN_NOISE)
    try:
        scene = load_scene(text)
        seconds = linkage.seconds - linkage.seconds[first_frame(linkage)]
        frames = np.flatnonzero((seconds >= 0) & (seconds <= _COMPARED_SECONDS))
        frames = frames[:: max(1, len(frames) // _COMPARED_FRAMES)]
        motion = scene.motion(seconds[frames])
    except (LinkageError, SceneError) as error:
        return Checked(str(error).removeprefix('scene: '), np.nan, np.nan, noise)
    off = []
    for name, positions in scene.markers.items():
        number = linkage.names.index(name)
        drawn = marker_positions(motion[name], positions)
        column = dict(zip(linkage.markers[number], linkage.columns[number], strict=True))
        columns = [column[marker] for marker in scene.marker_names[name]]
        measured = linkage.tracks[frames][:, columns]
        off.append(np.abs(drawn[..., 0] + 1j * drawn[..., 1] - measured))
    if not off:
        return Checked('', np.nan, np.nan, noise)
    square = np.concatenate(off, axis=1) ** 2
    with np.errstate(invalid='ignore'):
        first = float(np.sqrt(np.nanmean(square[0])))
        return Checked('', first, float(np.sqrt(np.nanmean(square))), noise)


def _connected_bodies(linkage: Linkage) -> list[int]:
    return sorted(connected(linkage.joints, linkage.rolling) - {GROUND_NUMBER})


def first_frame(linkage: Linkage) -> int:
    """The first frame with the most bodies that joints connect with the ground."""
    seen = np.sum([linkage.poses[k].seen for k in _connected_bodies(linkage)], axis=0)
    return int(np.argmax(seen))


def _drafts(linkage: Linkage, about: str) -> Iterator[str]:
    """Texts of the scene with different drivers, the likeliest first; none without a ground."""
    if not _connected_bodies(linkage):
        return
    sketch = _sketch(linkage)
    joints = [line for joint in linkage.joints for line in _joint_lines(sketch, joint)]
    # On the ground first: its angle cannot be turned to where the teeth mesh.
    turned: set[int] = set()
    for wheel in sorted(linkage.rolling, key=lambda wheel: wheel.other != GROUND_NUMBER):
        joints.append(
            _gear_line(sketch, wheel, turned) if wheel.circle else _wheel_line(sketch, wheel)
        )
    lines = [f'# {line}' for line in about.splitlines()]
    lines.append('bodies:')
    names = {k: sketch.name(k) for k in (GROUND_NUMBER, *sketch.bodies)}
    width = max(map(len, names.values()))
    for k, name in names.items():
        points = ', '.join(f'{point}: {_xy(z)}' for point, z in sketch.points[k].items())
        lines.append(f'  {name + ":":<{width + 1}} {{{points}}}')
    if joints:
        lines += ['joints:', *(f'  - {joint}' for joint in joints)]
    start = ', '.join(f'{names[k]}: {np.degrees(a):.6f} deg' for k, a in sketch.angles.items())
    tail = [f'start: {{{start}}}', *_marker_lines(sketch)]
    for drivers in combinations(_driver_lines(sketch), max(1, linkage.freedom)):
        driven = ['drivers:', *(f'  - {driver}' for driver in drivers)]
        yield '\n'.join([*lines, *driven, *tail]) + '\n'


def _xy(z: complex) -> str:
    return f'[{_number(z.real)}, {_number(z.imag)}]'


def _number(value: float) -> str:
    return f'{round(value, _DECIMALS) + 0.0:.{_DECIMALS}f}'.rstrip('0').rstrip('.')


def _exact(value: float) -> str:
    """To all digits, since radii must add up to the distance of their centers."""
    return f'{value:.12g}'


def _degrees(angle: float) -> str:
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    return f'{np.degrees(wrapped) + 0.0:.6f} deg'


def _sketch(linkage: Linkage) -> _Sketch:
    bodies, first = _connected_bodies(linkage), first_frame(linkage)
    frames = {GROUND_NUMBER: _Frame(0j, 0.0)}
    points: dict[int, dict[str, complex]] = {GROUND_NUMBER: {}}
    angles = {}
    for k in bodies:
        own, pose = [point.on[k] for point in linkage.places if k in point.on], linkage.poses[k]
        x_axis = own[1] - own[0] if len(own) > 1 else 0j
        is_clear = abs(x_axis) > _MIN_DIRECTION * pose.size
        frames[k] = _Frame(own[0] if own else 0j, float(np.angle(x_axis)) if is_clear else 0.0)
        angles[k] = float(np.nan_to_num(pose.angle[first])) + frames[k].angle
        points[k] = {}
    for point in linkage.places:
        for k in point.on.keys() & points.keys():
            local = frames[k].local(point.on[k])
            points[k][point.name] = complex(
                round(local.real, _DECIMALS), round(local.imag, _DECIMALS)
            )
    for k, named in points.items():
        if not named:
            named['P' if k != GROUND_NUMBER else 'O'] = 0j
    return _Sketch(linkage, bodies, frames, points, angles, first)


def _joint_lines(sketch: _Sketch, joint: FoundJoint) -> list[str]:
    """The lines of a slot, slide or trammel. A pin has none: its points have one name."""
    if joint.kind == 'pin':
        return []
    mover, base = sketch.name(joint.one), sketch.name(joint.other)
    frame = sketch.frames[joint.other]
    if joint.kind == 'trammel':
        on = sketch.point(joint.other, joint.on_other)
        return [
            f'{{slot: {mover}.{end}, on: {base}.{on}, along: {_degrees(along - frame.angle)}, '
            f'name: slide_{end}}}'
            for end, along in _slide_ends(sketch, joint)
        ]
    end = sketch.point(joint.one, joint.on_one)
    on = f'{mover}.{end}, on: {base}.{end}{LINE}, along: {_degrees(joint.along - frame.angle)}'
    if joint.kind == 'slot':
        return [f'{{slot: {on}, name: slide_{end}}}']
    turned = sketch.angles.get(joint.one, 0.0) - sketch.angles.get(joint.other, 0.0)
    return [f'{{prismatic: {on}, turned: {_degrees(turned)}, name: slide_{end}}}']


def _slide_ends(sketch: _Sketch, joint: FoundJoint) -> list[tuple[str, float]]:
    """The points of a slide or trammel that move along lines, with the lines' directions."""
    if joint.kind != 'trammel':
        return [(sketch.point(joint.one, joint.on_one), joint.along)]
    ends = (sketch.point(joint.one, end) for end in trammel_ends(joint))
    return list(zip(ends, (0.0, np.pi / 2), strict=True))


def _wheel_line(sketch: _Sketch, wheel: FoundRolling) -> str:
    """The line of a wheel that rolls on a line."""
    mover, base = sketch.name(wheel.one), sketch.name(wheel.other)
    hub, first = sketch.point(wheel.one, wheel.hub), sketch.first
    pose, base_pose = sketch.pose(wheel.one), sketch.pose(wheel.other)
    at = pose.position[first] + wheel.hub * np.exp(1j * pose.angle[first])
    at = (at - base_pose.position[first]) * np.exp(-1j * base_pose.angle[first])
    slid = float((np.exp(-1j * wheel.along) * (at - wheel.at)).real)
    # How far the hub is along the line where all angles are zero.
    turned = sketch.angles.get(wheel.one, 0.0) - sketch.angles.get(wheel.other, 0.0)
    start = slid + wheel.radius * turned
    return (
        f'{{rolling: {mover}.{hub}, radius: {_exact(wheel.radius)}, on: {base}.{hub}{LINE}, '
        f'along: {_degrees(wheel.along - sketch.frames[wheel.other].angle)}, '
        f'start: {_exact(start)}, name: roll_{mover}}}'
    )


def _gear_line(sketch: _Sketch, wheel: FoundRolling, turned: set[int]) -> str:
    """
    The line of a gear. Turns a body that is not in `turned` by whole turns, and puts it in.

    `start` is the direction of the hub where all angles are zero. Whole turns of a body that no
    other gear fixes yet bring it next to the present direction.
    """
    gear, partner = sketch.name(wheel.one), sketch.name(wheel.other)
    center, hub = sketch.point(wheel.other, wheel.at), sketch.point(wheel.one, wheel.hub)
    arm = sketch.points[wheel.arm][hub] - sketch.points[wheel.arm][center]
    is_inside = wheel.circle < 0
    radius = float(_exact(wheel.radius))
    circle = -(abs(arm) + radius) if is_inside else abs(arm) - radius
    # From the point of contact to the hub, in the frame of the arm.
    direction = float(np.angle(-arm if is_inside else arm))
    if is_inside and direction < 0:
        direction += 2 * np.pi
    angles = {**sketch.angles, GROUND_NUMBER: 0.0}
    total = circle + radius
    start = angles[wheel.arm] + direction
    start -= (circle * angles[wheel.other] + radius * angles[wheel.one]) / total
    free = next((k for k in (wheel.one, wheel.other) if k not in turned), None)
    if free is not None and free != GROUND_NUMBER:
        share = (radius if free == wheel.one else circle) / total
        turns = round((start - direction) / (2 * np.pi * share))
        sketch.angles[free] += 2 * np.pi * turns
        start -= 2 * np.pi * share * turns
        turned.add(free)
    return (
        f'{{rolling: {gear}.{hub}, radius: {_exact(radius)}, on: {partner}.{center}, '
        f'circle: {_exact(circle)}, start: {np.degrees(start):.9f} deg, '
        f'name: teeth_{gear}_{partner}}}'
    )


def _driver_lines(sketch: _Sketch) -> list[str]:
    """Possible drivers, the simplest first: steady turns, then sines, then tables."""
    linkage, first = sketch.linkage, sketch.first
    seconds = linkage.seconds - linkage.seconds[first]
    grounded = {j.one for j in linkage.joints if j.other == GROUND_NUMBER and j.kind == 'pin'}
    ranked: list[tuple[tuple[float, ...], str]] = []

    def rank(name: str, values: np.ndarray, offset: float, unit: str, *last: int) -> None:
        drive = fit_drive(seconds, values, unit == 'deg')
        kind = ('rate', 'sine', 'table').index(drive.kind)
        # Sines that fit about equally well have one rank.
        fit = round(4 * np.log10(drive.residual + 1e-4)) if drive.kind == 'sine' else 0
        ranked.append(((kind, fit, *last), drive.text(name, offset, unit)))

    for number, k in enumerate(sketch.bodies):
        if any(j.kind == 'slide' and k in (j.one, j.other) for j in linkage.joints):
            continue
        pose = linkage.poses[k]
        # A driver is written in terms of the angles of the scene.
        offset = sketch.angles[k] - float(np.nan_to_num(pose.angle[first]))
        rank(sketch.name(k), pose.angle, offset, 'deg', k not in grounded, number)
        for j in linkage.joints:
            parent = j.one if k == j.other else j.other
            if j.kind == 'pin' and k in (j.one, j.other) and parent in sketch.bodies[:number]:
                relative = pose.angle - linkage.poses[parent].angle
                shift = sketch.angles[k] - sketch.angles[parent] - relative[first]
                name = f'{sketch.name(k)}, of: {sketch.name(parent)}'
                rank(name, relative, float(np.nan_to_num(shift)), 'deg', 2, number)
    for number, joint in enumerate(linkage.joints):
        if joint.kind in ('slot', 'slide', 'trammel'):
            mover, base = sketch.pose(joint.one), sketch.pose(joint.other)
            ends = trammel_ends(joint) if joint.kind == 'trammel' else (joint.on_one,)
            for end, (name, along) in zip(ends, _slide_ends(sketch, joint), strict=True):
                at = mover.position + end * np.exp(1j * mover.angle) - base.position
                at = at * np.exp(-1j * base.angle) - joint.on_other
                rank(f'slide_{name}', (np.exp(-1j * along) * at).real, 0.0, 'm', 1, number)
    return [text for _, text in sorted(ranked)]


def _marker_lines(sketch: _Sketch) -> list[str]:
    """Markers of bodies; one on the axis of a pin is on the first of its two bodies."""
    lines: list[str] = []
    taken: set[str] = set()
    for k in sketch.bodies:
        markers = zip(sketch.linkage.markers[k], sketch.linkage.poses[k].shape, strict=True)
        own = {name: sketch.frames[k].local(z) for name, z in markers if name not in taken}
        if len(own) > 1:
            taken |= own.keys()
            points = ', '.join(f"'{name}': {_xy(z)}" for name, z in own.items())
            lines.append(f'  {sketch.name(k)}: {{{points}}}')
    return ['markers:', *lines] if lines else []
