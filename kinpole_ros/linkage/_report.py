"""A discovered linkage as lines for a terminal, and as a parameter file."""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from kinpole_ros.linkage._body_poses import GROUND_NUMBER
from kinpole_ros.linkage._draft import Checked
from kinpole_ros.linkage._linkage import Linkage
from kinpole_ros.linkage._solid import main_axis, out_of_plane
from kinpole_ros.tracking.plane import NORMALS

# Share of an interval by which stamps may be uneven before that costs more than noise does.
_MAX_UNEVEN = 0.02
# The unit of bodies of a size in this range may also be cm or inches.
_DOUBTFUL_SIZE = 2.0, 100.0
_PLAIN_TEXT = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
# Words that YAML does not read as text.
_YAML_WORDS = {'y', 'n', 'yes', 'no', 'on', 'off', 'true', 'false', 'null'}

_Row = tuple[str, ...]


def table(linkage: Linkage, checked: Checked | None) -> list[str]:
    """
    Describe a linkage in lines for a terminal.

    Parameters
    ----------
    linkage
        From `discover`.
    checked
        How well its draft scene explains the markers; None without one.

    Returns
    -------
    list of str
        Frames, plane, unit, bodies, joints, lengths, and what could not be determined.

    """
    lines = [f'{name + ":":<9}{text}' for name, text in input_texts(linkage).items()]
    lines += ['', *_aligned(_body_rows(linkage)), *marker_lines(linkage)]
    lines += ['', *joint_lines(linkage)]
    if checked is not None:
        lines.append(_draft_line(checked))
    return lines


def marker_lines(linkage: Linkage) -> list[str]:
    """Name the markers that are of no moving body."""
    lines = []
    if linkage.fixed:
        lines.append(f'markers that stand still: {_marker_list(linkage, linkage.fixed)}')
    if linkage.single:
        lines.append(
            f'markers of no body: {_marker_list(linkage, linkage.single)} (alone on theirs, loose, '
            'or exchanged with others: then set marker_identity: shape)'
        )
    return lines


def joint_lines(linkage: Linkage) -> list[str]:
    """Tables of joints and lengths, degrees of freedom, and what could not be determined."""
    is_planar = linkage.space is None
    lines = _planar_lines(linkage) if is_planar else _space_lines(linkage)
    lengths = linkage.lengths()
    if lengths:
        rows: list[_Row] = [('length', 'of', 'mm', 'deviation')]
        for length in lengths:
            name, value = f'{length.one}-{length.other}', f'{length.value * 1e3:.3f}'
            rows.append((name, length.body, value, f'{length.deviation * 1e3:.2g}'))
        lines += ['', *_aligned(rows)]
    if is_planar:
        lines += ['', f'degrees of freedom, by these joints: {linkage.freedom}']
    return lines + [f'note: {note.words()}' for note in linkage.notes]


def _aligned(rows: Sequence[_Row]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        '  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def input_texts(linkage: Linkage) -> dict[str, str]:
    """Describe frames, plane, unit and names."""
    stamps = linkage.stamps
    uneven = stamps.jitter / stamps.interval
    frames = f'{len(linkage.seconds)} frames, {linkage.seconds[-1]:.1f} s, '
    frames += f'{1 / stamps.interval:.4g} Hz; stamps uneven by {stamps.jitter * 1e3:.2g} ms rms'
    frames += f' ({uneven:.1%} of an interval)'
    if uneven > _MAX_UNEVEN:
        frames += '; the parameter stamps, auto by default, finds the clock behind them'
    if stamps.lost:
        frames += f'; {stamps.lost} frames lost'
    if stamps.dropped:
        frames += f'; {stamps.dropped} left out, as repeated'
    names = 'hold' if linkage.ordered else 'none, or they do not hold: identified by shape'
    return {
        'frames': frames,
        'plane': _plane(linkage),
        'unit': _unit(linkage),
        'names': names,
    }


def _plane(linkage: Linkage) -> str:
    plane = linkage.plane
    text = plane.name
    if not text:
        normal = ', '.join(f'{value:.4f}' for value in plane.normal)
        nearest = list(NORMALS)[int(np.abs(list(NORMALS.values()) @ plane.normal).argmax())]
        text = f'normal [{normal}], {plane.tilt:.1f} deg off {nearest}'
    if plane.source == 'given':
        text += ', as given'
    elif plane.source == 'layout':
        text += (
            ', in which the markers lie nearest: the motion, along one line, does not show it; '
            'fix: name it with --plane, or move the rig farther'
        )
    elif plane.name:
        text += f', to {plane.tilt:.2g} deg'
    if linkage.space is not None:
        solid = [pose for pose in linkage.space.solid if pose is not None]
        out = [out_of_plane(pose, plane.normal) for pose in solid]
        off = _mm(max(distance for distance, _, _ in out), linkage)
        turned = np.degrees(max(turn for _, turn, _ in out))
        text = (
            f'not one: bodies leave any plane by up to {off} rms, and turn out of it by '
            f'{turned:.2g} deg; nearest to all of it is {text}'
        )
    return f'{text}; markers leave it by {plane.spread * linkage.scale * 1e3:.2g} mm rms'


def _unit(linkage: Linkage) -> str:
    unit = 'm' if linkage.scale == 1 else f'mm, by the size of the bodies (scale {linkage.scale:g})'
    largest = max(pose.size for pose in linkage.poses)
    if _DOUBTFUL_SIZE[0] < largest / linkage.scale < _DOUBTFUL_SIZE[1]:
        unit += (
            f'; the largest measures {largest:.3g} m between markers: if it is in cm, set scale: '
            '0.01, in inches 0.0254'
        )
    return unit


def _marker_list(linkage: Linkage, columns: list[int]) -> str:
    labels = [linkage.labels[k] for k in columns]
    return ', '.join(labels) if all(labels) else str(len(columns))


def _mm(value: float, linkage: Linkage) -> str:
    """A length in units of the source, in mm."""
    value *= linkage.scale * 1e3
    return f'{value:.0f} mm' if value >= 100 else f'{value:.2g} mm'


def _vector(axis: np.ndarray) -> str:
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    return '[' + ', '.join(f'{value + 0.0:.2f}' for value in axis.round(2)) + ']'


def _degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(abs(float(a @ b)), 1.0))))


def _body_rows(linkage: Linkage) -> list[_Row]:
    rows: list[_Row] = [('body', 'markers', 'noise', 'seen', 'turns')]
    for name, markers, pose in zip(linkage.names, linkage.markers, linkage.poses, strict=True):
        turned = float(np.ptp(pose.angle[pose.seen]))
        turns = f'{np.degrees(turned):.1f} deg'
        if turned > 2 * np.pi:
            turns = f'{turned / 2 / np.pi:.1f} rev'
        seen = f'{float(pose.seen.mean()):.0%}'
        rows.append((name, ' '.join(markers), f'{pose.noise * 1e3:.2g} mm', seen, turns))
    if linkage.space is None:
        return rows
    result: list[_Row] = [(*rows[0], 'axis', 'axis off the normal', 'turns out', 'leaves by')]
    normal = linkage.plane.normal
    for row, body, solid in zip(rows[1:], linkage.columns, linkage.space.solid, strict=True):
        name, marker_names, _, seen, _ = row
        if solid is None:
            within = linkage.space.deviation[np.ix_(body, body)][np.triu_indices(len(body), 1)]
            noise = _mm(float(within.max()) / 2**0.5, linkage)
            result.append((name, marker_names, noise, seen, '', '(on one line)', '', '', ''))
            continue
        axis = main_axis(solid)
        off, turned, about = out_of_plane(solid, normal)
        turns = f'{np.degrees(np.hypot(turned, about)):.1f} deg rms'
        tilt = f'{_degrees_between(axis, normal):.1f} deg'
        out = f'{np.degrees(turned):.1f} deg rms', f'{_mm(off, linkage)} rms'
        noise = _mm(solid.noise, linkage)
        result.append((name, marker_names, noise, seen, turns, _vector(axis), tilt, *out))
    return result


def _space_lines(linkage: Linkage) -> list[str]:
    """Joints in space: the center by the nearest marker of the first body, and a hinge's axis."""
    assert linkage.space is not None
    rows: list[_Row] = [('joint in space', 'of', 'center', 'axis', 'left over')]
    for joint in linkage.space.joints:
        pose = linkage.space.solid[joint.one]
        assert pose is not None
        off = np.linalg.norm(pose.shape - joint.on_one, axis=1)
        nearest = int(off.argmin())
        center = f'{_mm(off[nearest], linkage)} off {linkage.markers[joint.one][nearest]}'
        if joint.other == GROUND_NUMBER:
            x, y, z = joint.on_other * linkage.scale * 1e3
            center += f', at {x:.0f}, {y:.0f}, {z:.0f} mm'
        kind, axis = 'ball', '-'
        if joint.axis is not None:
            tilt = _degrees_between(joint.axis, linkage.plane.normal)
            kind, axis = 'hinge', f'{_vector(joint.axis)}, {tilt:.1f} deg off the normal'
        names = f'{linkage.name(joint.one)} {linkage.name(joint.other)}'
        rows.append((kind, names, center, axis, f'{_mm(joint.residual, linkage)} rms'))
    return _aligned(rows) if len(rows) > 1 else ['joints in space: none that the data show']


def _planar_lines(linkage: Linkage) -> list[str]:
    head = ('joint', 'of', 'where it is on the ground, mm', 'deviation', 'left over')
    rows = [head, *_pin_rows(linkage), *_slide_rows(linkage), *_wheel_rows(linkage)]
    if len(rows) == 1:
        return ['joints: none that the data show']
    return _aligned(rows)


def _pin_rows(linkage: Linkage) -> Iterator[_Row]:
    for point in linkage.places:
        if point.kind != 'pin':
            continue
        bodies = ' '.join(linkage.name(k) for k in sorted(point.on, key=lambda k: (k < 0, k)))
        at = _mm_point(point.on[GROUND_NUMBER]) if GROUND_NUMBER in point.on else 'moves'
        ratio = max(
            joint.ratio
            for joint in linkage.joints
            if joint.kind == 'pin' and {joint.one, joint.other} <= point.on.keys()
        )
        deviation = f'{point.deviation * 1e3:.2g} mm'
        yield f'pin {point.name}', bodies, at, deviation, _ratio(ratio)


def _slide_rows(linkage: Linkage) -> Iterator[_Row]:
    kinds = {'slot': 'pin in slot', 'slide': 'slide', 'trammel': 'trammel'}
    for joint in linkage.joints:
        if joint.kind not in kinds:
            continue
        bodies = f'{linkage.name(joint.one)} on {linkage.name(joint.other)}'
        at = f'along {np.degrees(joint.along):.2f} deg'
        if joint.kind == 'trammel':
            at = f'{_mm_point(joint.on_other)}, circle of {joint.radius * 2e3:.3f} mm'
        deviation = f'{joint.deviation[0] * 1e3:.2g} mm'
        yield kinds[joint.kind], bodies, at, deviation, _ratio(joint.ratio)


def _wheel_rows(linkage: Linkage) -> Iterator[_Row]:
    for wheel in linkage.rolling:
        bodies = f'{linkage.name(wheel.one)} on {linkage.name(wheel.other)}'
        at = f'radius {wheel.radius * 1e3:.3f} mm'
        if wheel.circle:
            side = 'inside ' if wheel.circle < 0 else ''
            at += f' {side}on {abs(wheel.circle) * 1e3:.3f} mm'
        kind = 'gears' if wheel.circle else 'rolls'
        deviation = f'{wheel.deviation * 1e3:.2g} mm'
        yield kind, bodies, at, deviation, _ratio(wheel.residual / wheel.expected)


def _mm_point(z: complex) -> str:
    return f'{z.real * 1e3:.3f}, {z.imag * 1e3:.3f}'


def _ratio(value: float) -> str:
    return f'{value:.1f} x noise'


def _draft_line(checked: Checked) -> str:
    if checked.problem:
        return f'the draft scene does not close: {checked.problem}'
    if not np.isfinite(checked.first):
        return 'the draft scene closes'
    off = (
        f'its markers are {checked.first * 1e3:.2g} mm rms off those measured at the first frame '
        f'({checked.first / max(checked.noise, 1e-9):.1f} x noise), {checked.later * 1e3:.2g} mm '
        'over 2 s'
    )
    if not checked.explains:
        return f'the draft scene closes, but does not explain the markers: {off}'
    drives = '' if checked.drives else ': lengths fit, but its drivers are a first guess'
    return f'the draft scene closes: {off}{drives}'


def parameter_file(linkage: Linkage, topic: str = '/markers', about: str = '') -> str:
    """
    Write a linkage as a parameter file for the node and for replay.

    Parameters
    ----------
    linkage
        From `discover`.
    topic
        Topic of the markers.
    about
        Comment at the head of the file.

    Returns
    -------
    str
        The text, without parameters that have their default.

    """
    plane = linkage.plane
    lines = [*(f'# {line}' for line in about.splitlines()), '/**:', '  ros__parameters:']
    if topic.lstrip('/') != 'markers':
        lines.append(f'    marker_topic: {topic}')
    if plane.name:
        lines.append(f'    plane: {plane.name}')
    else:
        normal = ', '.join(f'{value:.6f}' for value in plane.normal)
        lines.append(f'    plane: [{normal}]  # its normal: {plane.tilt:.1f} deg off the axes')
    if linkage.scale != 1:
        lines.append(f'    scale: {linkage.scale:g}  # m per unit of the markers')
    if not linkage.ordered:
        lines.append('    marker_identity: shape  # the points have no names that hold')
    lines.append(f'    bodies: [{", ".join(linkage.names)}]')
    pins = {
        joint.one: (joint.on_one, joint.on_other)
        for joint in linkage.joints
        if joint.kind == 'pin' and joint.other == GROUND_NUMBER
    }
    for k, (name, pose) in enumerate(zip(linkage.names, linkage.poses, strict=True)):
        lines.append(f'    {name}:')
        if linkage.ordered:
            lines.append(f'      markers: [{", ".join(map(_yaml_text, linkage.markers[k]))}]')
            continue
        lines.append(f'      shape: [{_yaml_points(pose.shape)}]  # x, y of each marker, m')
        if k in pins:
            points = _yaml_points(pins[k])
            lines.append(f'      pin: [{points}]  # x, y there and in the plane, m')
    return '\n'.join(lines) + '\n'


def _yaml_points(points: Sequence[complex] | np.ndarray) -> str:
    return ', '.join(f'{z.real:.6f}, {z.imag:.6f}' for z in points)


def _yaml_text(name: str) -> str:
    if _PLAIN_TEXT.fullmatch(name) and name.lower() not in _YAML_WORDS:
        return name
    quoted = name.replace("'", "''")
    return f"'{quoted}'"
