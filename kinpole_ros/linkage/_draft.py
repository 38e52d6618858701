"""
A linkage as a scene: the text of a file that `kinpole solve` and `kinpole simulate` take.

Each body has its first point for origin and its x axis toward the second, so that the file shows
lengths as one would write them.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._drivers import Drive, fit_drive
from kinpole_ros.linkage._joints import Joint
from kinpole_ros.linkage._model import GROUND_NUMBER, LINE, Linkage
from kinpole_ros.linkage._places import connected, trammel_ends
from kinpole_ros.linkage._poses import ground
from kinpole_ros.linkage._rolling import Rolling

_DECIMALS = 7  # of a length, m


class Frame(NamedTuple):
    """Where a body's frame in the scene is among its markers: origin, and direction of x, rad."""

    origin: complex
    turn: float

    def local(self, place: complex) -> complex:
        """A place among the markers, in the scene's frame."""
        return complex((place - self.origin) * np.exp(-1j * self.turn))


class _Sketch(NamedTuple):
    """What the text is made of."""

    bodies: list[int]
    frames: dict[int, Frame]
    points: dict[int, dict[str, complex]]
    angles: dict[int, float]
    joints: list[str]
    first: int


def reached(linkage: Linkage) -> list[int]:
    """Bodies, by number, that joints connect with the ground."""
    found = connected(linkage.joints, linkage.rolling)
    return [k for k in range(len(linkage.names)) if k in found]


def first_frame(linkage: Linkage) -> int:
    """The first frame in which all bodies of the scene were seen, or the most of them."""
    seen = np.sum([linkage.poses[k].seen for k in reached(linkage)], axis=0)
    return int(np.argmax(seen))


def draft_scenes(linkage: Linkage, about: str = '') -> Iterator[str]:
    """
    Texts of the scene, which differ in what drives it, the likeliest first.

    No text where nothing is connected to the ground. Not every body can drive it all the way.
    """
    if not reached(linkage):
        return
    sketch = _sketch(linkage)
    lines = [f'# {line}' for line in about.splitlines()]
    lines.append('bodies:')
    names = {k: linkage.name(k) for k in (GROUND_NUMBER, *sketch.bodies)}
    width = max(map(len, names.values()))
    for k, name in names.items():
        points = ', '.join(f'{p}: {_xy(z)}' for p, z in sketch.points[k].items())
        lines.append(f'  {name + ":":<{width + 1}} {{{points}}}')
    if sketch.joints:
        lines += ['joints:', *(f'  - {joint}' for joint in sketch.joints)]
    start = ', '.join(f'{names[k]}: {np.degrees(a):.6f} deg' for k, a in sketch.angles.items())
    rest = [f'start: {{{start}}}', *_markers(linkage, sketch)]
    for drivers in combinations(_choices(linkage, sketch), max(1, linkage.freedom)):
        driven = ['drivers:', *(f'  - {drive}' for drive in drivers)]
        yield '\n'.join([*lines, *driven, *rest]) + '\n'


def _xy(z: complex) -> str:
    return f'[{_number(z.real)}, {_number(z.imag)}]'


def _number(value: float) -> str:
    rounded = round(value, _DECIMALS)
    return f'{rounded + 0.0:.{_DECIMALS}f}'.rstrip('0').rstrip('.')


def _fine(value: float) -> str:
    """To all digits: radii have to add up to the distance of their centers."""
    return f'{value:.12g}'


def _sketch(linkage: Linkage) -> _Sketch:
    bodies = reached(linkage)
    first = first_frame(linkage)
    frames = {GROUND_NUMBER: Frame(0j, 0.0)}
    points: dict[int, dict[str, complex]] = {GROUND_NUMBER: {}}
    angles = {}
    for k in bodies:
        there = [place.on[k] for place in linkage.places if k in place.on]
        pose = linkage.poses[k]
        between = there[1] - there[0] if len(there) > 1 else 0j
        # Points that are one but for noise give no direction.
        turn = float(np.angle(between)) if abs(between) > 1e-3 * pose.size else 0.0
        frames[k] = Frame(there[0] if there else 0j, turn)
        angles[k] = float(np.nan_to_num(pose.angle[first])) + turn
        points[k] = {}
    for place in linkage.places:
        for k, z in place.on.items():
            if k in points:
                local = frames[k].local(z)
                points[k][place.name] = complex(
                    round(local.real, _DECIMALS), round(local.imag, _DECIMALS)
                )
    for k, named in points.items():
        if not named:
            named['P' if k != GROUND_NUMBER else 'O'] = 0j
    sketch = _Sketch(bodies, frames, points, angles, [], first)
    for joint in linkage.joints:
        if joint.kind != 'pin':
            sketch.joints.extend(_slides(linkage, sketch, joint))
    # The ground first: its angle cannot be turned to where gears mesh.
    turned: set[int] = set()
    for wheel in sorted(linkage.rolling, key=lambda wheel: wheel.other != GROUND_NUMBER):
        sketch.joints.append(_rolling(linkage, sketch, wheel, turned))
    return sketch


def _slides(linkage: Linkage, sketch: _Sketch, joint: Joint) -> list[str]:
    one, other = linkage.name(joint.one), linkage.name(joint.other)
    frame = sketch.frames[joint.other]
    if joint.kind == 'trammel':
        on = _point(linkage, joint.other, joint.on_other)
        ends = [_point(linkage, joint.one, end) for end in trammel_ends(joint)]
        return [
            f'{{slot: {one}.{end}, on: {other}.{on}, along: {_degrees(along - frame.turn)}, '
            f'name: slide_{end}}}'
            for end, along in zip(ends, (0.0, np.pi / 2), strict=True)
        ]
    end = _point(linkage, joint.one, joint.on_one)
    where = f'{one}.{end}, on: {other}.{end}{LINE}, along: {_degrees(joint.along - frame.turn)}'
    if joint.kind == 'slot':
        return [f'{{slot: {where}, name: slide_{end}}}']
    turned = sketch.angles.get(joint.one, 0.0) - sketch.angles.get(joint.other, 0.0)
    return [f'{{prismatic: {where}, turned: {_degrees(turned)}, name: slide_{end}}}']


def _degrees(angle: float) -> str:
    turned = (angle + np.pi) % (2 * np.pi) - np.pi
    return f'{np.degrees(turned) + 0.0:.6f} deg'


def _point(linkage: Linkage, body: int, place: complex) -> str:
    """The name of the point of a body that is at a place."""
    there = [p for p in linkage.places if body in p.on and not p.name.endswith(LINE)]
    return min(there, key=lambda p: abs(p.on[body] - place)).name


def _rolling(linkage: Linkage, sketch: _Sketch, wheel: Rolling, turned: set[int]) -> str:
    one, other = linkage.name(wheel.one), linkage.name(wheel.other)
    hub = _point(linkage, wheel.one, wheel.hub)
    angle = {**sketch.angles, GROUND_NUMBER: 0.0}
    frame = sketch.frames[wheel.other]
    pose = linkage.poses[wheel.one]
    if not wheel.circle:
        # How far the hub is along the line where all angles are zero.
        at = pose.position[sketch.first] + wheel.hub * np.exp(1j * pose.angle[sketch.first])
        if wheel.other != GROUND_NUMBER:
            base = linkage.poses[wheel.other]
            at = (at - base.position[sketch.first]) * np.exp(-1j * base.angle[sketch.first])
        slid = float((np.exp(-1j * wheel.along) * (at - wheel.at)).real)
        start = slid + wheel.radius * (angle[wheel.one] - angle[wheel.other])
        return (
            f'{{rolling: {one}.{hub}, radius: {_fine(wheel.radius)}, on: {other}.{hub}{LINE}, '
            f'along: {_degrees(wheel.along - frame.turn)}, start: {_fine(start)}, '
            f'name: roll_{one}}}'
        )
    center = _point(linkage, wheel.other, wheel.at)
    ends = [sketch.points[wheel.arm][name] for name in (center, hub)]
    distance = abs(ends[1] - ends[0])
    inside = wheel.circle < 0
    radius = float(_fine(wheel.radius))
    circle = -(distance + radius) if inside else distance - radius
    # From the point of contact to the hub, as the arm has it: inside, to the center.
    value = float(np.angle((ends[1] - ends[0]) * (-1 if inside else 1)))
    if inside and value < 0:
        value += 2 * np.pi
    total = circle + radius
    now = angle[wheel.arm] + value
    start = now - (circle * angle[wheel.other] + radius * angle[wheel.one]) / total
    # Whole turns of what is free to count them: the direction begins next to the arm's.
    free = next((k for k in (wheel.one, wheel.other) if k not in turned), None)
    if free is not None and free != GROUND_NUMBER:
        by = (radius if free == wheel.one else circle) / total
        turns = round((start - value) / (2 * np.pi * by))
        sketch.angles[free] += 2 * np.pi * turns
        start -= 2 * np.pi * by * turns
        turned.add(free)
    return (
        f'{{rolling: {one}.{hub}, radius: {_fine(radius)}, on: {other}.{center}, '
        f'circle: {_fine(circle)}, start: {np.degrees(start):.9f} deg, '
        f'name: teeth_{one}_{other}}}'
    )


def _choices(linkage: Linkage, sketch: _Sketch) -> list[str]:
    """Drivers, the simplest first: what turns steadily, what swings as a sine, then tables."""
    seconds = linkage.seconds - linkage.seconds[sketch.first]
    grounded = {j.one for j in linkage.joints if j.other == GROUND_NUMBER and j.kind == 'pin'}
    found: list[tuple[tuple[float, ...], str]] = []

    def add(name: str, values: np.ndarray, offset: float, unit: str, last: tuple[int, ...]) -> None:
        drive = fit_drive(seconds, values, unit == 'deg')
        rank = ('rate', 'sine', 'table').index(drive.kind)
        # Sines that fit equally well rank the same.
        fit = round(4 * np.log10(drive.off + 1e-4)) if drive.kind == 'sine' else 0
        found.append(((rank, fit, *last), _drive(name, drive, offset, unit)))

    for place, k in enumerate(sketch.bodies):
        if any(j.kind == 'slide' and k in (j.one, j.other) for j in linkage.joints):
            continue
        pose = linkage.poses[k]
        # What is written is by the angle that the start is.
        offset = sketch.angles[k] - float(np.nan_to_num(pose.angle[sketch.first]))
        add(linkage.name(k), pose.angle, offset, 'deg', (k not in grounded, place))
        for j in linkage.joints:
            parent = j.one if k == j.other else j.other
            if j.kind == 'pin' and k in (j.one, j.other) and parent in sketch.bodies[:place]:
                relative = pose.angle - linkage.poses[parent].angle
                shift = sketch.angles[k] - sketch.angles[parent] - relative[sketch.first]
                name = f'{linkage.name(k)}, of: {linkage.name(parent)}'
                add(name, relative, float(np.nan_to_num(shift)), 'deg', (2, place))
    for place, joint in enumerate(linkage.joints):
        if joint.kind in ('slot', 'slide', 'trammel'):
            for name, along in _along(linkage, joint):
                add(name, along, 0.0, 'm', (1, place))
    return [text for _, text in sorted(found)]


def _along(linkage: Linkage, joint: Joint) -> Iterator[tuple[str, np.ndarray]]:
    """The variables of a slide: how far its points are along their lines."""
    ends = trammel_ends(joint) if joint.kind == 'trammel' else (joint.on_one,)
    directions = (0.0, np.pi / 2) if joint.kind == 'trammel' else (joint.along,)
    ground_pose = ground(len(linkage.seconds))
    one, other = (
        ground_pose if k == GROUND_NUMBER else linkage.poses[k] for k in (joint.one, joint.other)
    )
    for end, along in zip(ends, directions, strict=True):
        at = one.position + end * np.exp(1j * one.angle) - other.position
        at = at * np.exp(-1j * other.angle) - joint.on_other
        yield f'slide_{_point(linkage, joint.one, end)}', (np.exp(-1j * along) * at).real


def _drive(name: str, drive: Drive, offset: float, unit: str) -> str:
    size = 180 / np.pi if unit == 'deg' else 1.0

    def say(value: float) -> str:
        return f'{value * size:.6f} {unit}'

    values = drive.values
    if drive.kind == 'rate':
        return f'{{drive: {name}, rate: {values[0]:.9g} rad/s, start: {say(values[1] + offset)}}}'
    if drive.kind == 'sine':
        mean, amplitude, frequency, phase = values
        return (
            f'{{drive: {name}, mean: {say(mean + offset)}, amplitude: {say(amplitude)}, '
            f'frequency: {frequency:.9g}, phase: {np.degrees(phase):.6f} deg}}'
        )
    half = len(values) // 2
    times = ', '.join(f'{t:.4g}' for t in values[:half])
    table = ', '.join(f'{(v + offset):.6f}' for v in values[half:])
    return f'{{drive: {name}, times: [{times}], values: [{table}]}}'


def _markers(linkage: Linkage, sketch: _Sketch) -> list[str]:
    """Each marker on one body: on the first, where it is on the axis of a pin."""
    lines, taken = [], set()
    for k in sketch.bodies:
        pose, frame = linkage.poses[k], sketch.frames[k]
        both = zip(linkage.markers[k], pose.shape, strict=True)
        own = {name: frame.local(z) for name, z in both if name not in taken}
        if len(own) > 1:
            taken |= set(own)
            places = ', '.join(f"'{name}': {_xy(z)}" for name, z in own.items())
            lines.append(f'  {linkage.name(k)}: {{{places}}}')
    return ['markers:', *lines] if lines else []
