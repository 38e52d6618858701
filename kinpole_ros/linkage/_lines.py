"""What was found, as lines to print."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.linkage._check import Checked
from kinpole_ros.linkage._model import GROUND_NUMBER, Linkage
from kinpole_ros.linkage._solid import main_axis, out_of_plane
from kinpole_ros.tracking.plane import NORMALS

# Intervals that stamps are uneven by that cost more than noise does.
_UNEVEN = 0.02
# Of bodies that are so many units large the unit may well be cm or inches.
_DOUBTFUL = 2.0, 100.0


def table(linkage: Linkage, checked: Checked | None) -> list[str]:
    """Lines for a terminal: input, bodies, joints, lengths, and what could not be determined."""
    lines = [*_input(linkage), '', *_columns(_bodies(linkage))]
    if linkage.fixed:
        lines.append(f'markers that stand still: {_marked(linkage, linkage.fixed)}')
    if linkage.single:
        lines.append(
            f'markers of no body: {_marked(linkage, linkage.single)} (alone on theirs, loose, or '
            'exchanged with others: then set marker_identity: shape)'
        )
    lines += ['', *(_joints(linkage) if linkage.space is None else _space_joints(linkage))]
    lengths = linkage.lengths()
    if lengths:
        rows = [('length', 'of', 'mm', 'deviation')]
        rows += [
            (
                f'{one.one}-{one.other}',
                one.body,
                f'{one.value * 1e3:.3f}',
                f'{one.deviation * 1e3:.2g}',
            )
            for one in lengths
        ]
        lines += ['', *_columns(rows)]
    if linkage.space is None:
        lines += ['', f'degrees of freedom, by these joints: {linkage.freedom}']
    lines += [f'note: {note}' for note in linkage.notes]
    if checked is not None:
        lines.append(_closing(checked))
    return lines


def _bodies(linkage: Linkage) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [('body', 'markers', 'noise', 'seen', 'turns')]
    for name, markers, pose in zip(linkage.names, linkage.markers, linkage.poses, strict=True):
        turned = float(np.ptp(pose.angle[pose.seen]))
        turns = f'{np.degrees(turned):.1f} deg'
        if turned > 2 * np.pi:
            turns = f'{turned / 2 / np.pi:.1f} rev'
        seen = f'{float(pose.seen.mean()):.0%}'
        rows.append((name, ' '.join(markers), f'{pose.noise * 1e3:.2g} mm', seen, turns))
    if linkage.space is None:
        return rows
    head = (*rows[0], 'axis', 'axis off the normal', 'turns out', 'leaves by')
    normal = linkage.plane.normal
    result = [head]
    for row, body, solid in zip(rows[1:], linkage.columns, linkage.space.solid, strict=True):
        if solid is None:
            spread = float(
                linkage.space.spread[np.ix_(body, body)][np.triu_indices(len(body), 1)].max()
            )
            noise = _mm(spread / 2**0.5, linkage)
            result.append((*row[:2], noise, row[3], '', '(on one line)', '', '', ''))
            continue
        axis = main_axis(solid)
        off, turned, about = out_of_plane(solid, normal)
        tilt = f'{_degrees_between(axis, normal):.1f} deg'
        turns = f'{np.degrees(np.hypot(turned, about)):.1f} deg rms'
        out = f'{np.degrees(turned):.1f} deg rms', f'{_mm(off, linkage)} rms'
        noise = _mm(solid.noise, linkage)
        result.append((*row[:2], noise, row[3], turns, _vector(axis), tilt, *out))
    return result


def _mm(value: float, linkage: Linkage) -> str:
    """A length in units of the source, in mm."""
    value *= linkage.scale * 1e3
    return f'{value:.0f} mm' if value >= 100 else f'{value:.2g} mm'


def _vector(axis: np.ndarray) -> str:
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    return '[' + ', '.join(f'{value + 0.0:.2f}' for value in axis.round(2)) + ']'


def _degrees_between(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(abs(float(one @ other)), 1.0))))


def _leaves(linkage: Linkage) -> str:
    """How far bodies leave the plane that is nearest to their motion."""
    assert linkage.space is not None
    solid = [pose for pose in linkage.space.solid if pose is not None]
    out = [out_of_plane(pose, linkage.plane.normal) for pose in solid]
    far = _mm(max(off for off, _, _ in out), linkage)
    turned = np.degrees(max(turned for _, turned, _ in out))
    return f'bodies leave any plane by up to {far} rms, and turn out of it by {turned:.2g} deg'


def _space_joints(linkage: Linkage) -> list[str]:
    """Joints in space: the center by the nearest marker of the first body, and a hinge's axis."""
    assert linkage.space is not None
    rows: list[tuple[str, ...]] = [('joint in space', 'of', 'center', 'axis', 'left over')]
    for joint in linkage.space.joints:
        pose = linkage.space.solid[joint.one]
        assert pose is not None
        off = np.linalg.norm(pose.shape - joint.on_one, axis=1)
        near = int(off.argmin())
        center = f'{_mm(off[near], linkage)} off {linkage.markers[joint.one][near]}'
        if joint.other == GROUND_NUMBER:
            x, y, z = joint.on_other * linkage.scale * 1e3
            center += f', at {x:.0f}, {y:.0f}, {z:.0f} mm'
        axis = '-'
        if joint.axis is not None:
            tilt = _degrees_between(joint.axis, linkage.plane.normal)
            axis = f'{_vector(joint.axis)}, {tilt:.1f} deg off the normal'
        rows.append(
            (
                'ball' if joint.axis is None else 'hinge',
                f'{linkage.name(joint.one)} {linkage.name(joint.other)}',
                center,
                axis,
                f'{_mm(joint.residual, linkage)} rms',
            )
        )
    return _columns(rows) if len(rows) > 1 else ['joints in space: none that the data show']


def _input(linkage: Linkage) -> list[str]:
    stamps, plane = linkage.stamps, linkage.plane
    uneven = stamps.jitter / stamps.interval
    frames = f'{len(linkage.seconds)} frames, {linkage.seconds[-1]:.1f} s, '
    frames += f'{1 / stamps.interval:.4g} Hz; stamps uneven by {stamps.jitter * 1e3:.2g} ms rms'
    frames += f' ({uneven:.1%} of an interval)'
    if uneven > _UNEVEN:
        frames += '; the parameter stamps, auto by default, finds the clock behind them'
    if stamps.lost:
        frames += f'; {stamps.lost} frames lost'
    if stamps.dropped:
        frames += f'; {stamps.dropped} left out, as repeated'
    where = plane.name
    if not where:
        normal = ', '.join(f'{value:.4f}' for value in plane.normal)
        nearest = list(NORMALS)[int(np.abs(list(NORMALS.values()) @ plane.normal).argmax())]
        where = f'normal [{normal}], {plane.tilt:.1f} deg off {nearest}'
    if plane.source == 'given':
        where += ', as given'
    elif plane.source == 'layout':
        where += (
            ', in which the markers lie nearest: the motion, along one line, does not show it; '
            'fix: name it with --plane, or move the rig farther'
        )
    elif plane.name:
        where += f', to {plane.tilt:.2g} deg'
    if linkage.space is not None:
        where = f'not one: {_leaves(linkage)}; nearest to all of it is {where}'
    out = f'; markers leave it by {plane.spread * linkage.scale * 1e3:.2g} mm rms'
    names = 'hold' if linkage.ordered else 'none, or they do not hold: identified by shape'
    return [
        f'frames:  {frames}',
        f'plane:   {where}{out}',
        f'unit:    {_unit(linkage)}',
        f'names:   {names}',
    ]


def _unit(linkage: Linkage) -> str:
    unit = 'm' if linkage.scale == 1 else f'mm, by the size of the bodies (scale {linkage.scale:g})'
    largest = max(pose.size for pose in linkage.poses)
    if _DOUBTFUL[0] < largest / linkage.scale < _DOUBTFUL[1]:
        unit += (
            f'; the largest measures {largest:.3g} m between markers: if it is in cm, set scale: '
            '0.01, in inches 0.0254'
        )
    return unit


def _marked(linkage: Linkage, columns: list[int]) -> str:
    labels = [linkage.labels[k] for k in columns]
    return ', '.join(labels) if all(labels) else str(len(columns))


def _joints(linkage: Linkage) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ('joint', 'of', 'where it is on the ground, mm', 'deviation', 'left over')
    ]
    for place in linkage.places:
        if place.kind == 'pin':
            of = ' '.join(linkage.name(k) for k in sorted(place.on, key=lambda k: (k < 0, k)))
            where = _where(place.on[-1]) if -1 in place.on else 'moves'
            ratios = [
                j.ratio
                for j in linkage.joints
                if j.kind == 'pin' and {j.one, j.other} <= set(place.on)
            ]
            rows.append(
                (
                    f'pin {place.name}',
                    of,
                    where,
                    f'{place.deviation * 1e3:.2g} mm',
                    _times(max(ratios)),
                )
            )
    for joint in linkage.joints:
        one, other = linkage.name(joint.one), linkage.name(joint.other)
        if joint.kind in ('slot', 'slide'):
            what = 'pin in slot' if joint.kind == 'slot' else 'slide'
            of = f'{one} on {other}'
            along = f'along {np.degrees(joint.along):.2f} deg'
        elif joint.kind == 'trammel':
            what, of = 'trammel', f'{one} on {other}'
            along = f'{_where(joint.on_other)}, circle of {joint.radius * 2e3:.3f} mm'
        else:
            continue
        rows.append((what, of, along, f'{joint.deviation[0] * 1e3:.2g} mm', _times(joint.ratio)))
    for wheel in linkage.rolling:
        of = f'{linkage.name(wheel.one)} on {linkage.name(wheel.other)}'
        what = 'rolls' if not wheel.circle else 'gears'
        along = f'radius {wheel.radius * 1e3:.3f} mm'
        if wheel.circle:
            side = 'inside ' if wheel.circle < 0 else ''
            along += f' {side}on {abs(wheel.circle) * 1e3:.3f} mm'
        left = wheel.residual / wheel.expected
        rows.append((what, of, along, f'{wheel.deviation * 1e3:.2g} mm', _times(left)))
    if len(rows) == 1:
        return ['joints: none that the data show']
    steady = [wheel for wheel in linkage.rolling if wheel.steady]
    note = [
        'note: these turn at steady rates all the time, as gears do, and as two motors may: vary '
        'the speed to tell'
    ]
    return _columns(rows) + (note if steady else [])


def _where(z: complex) -> str:
    return f'{z.real * 1e3:.3f}, {z.imag * 1e3:.3f}'


def _times(ratio: float) -> str:
    return f'{ratio:.1f} x noise'


def _closing(checked: Checked) -> str:
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


def _columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        '  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
