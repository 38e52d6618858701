"""What was found, as lines to print."""

import numpy as np

from kinpole_ros.linkage._check import Checked
from kinpole_ros.linkage._model import Linkage

# Intervals that stamps are uneven by that cost more than noise does.
_UNEVEN = 0.02
# Of bodies that are so many units large the unit may well be cm or inches.
_DOUBTFUL = 2.0, 100.0


def table(linkage: Linkage, checked: Checked | None) -> list[str]:
    """Lines for a terminal: input, bodies, joints, lengths, and what could not be determined."""
    lines = [*_input(linkage), '']
    rows: list[tuple[str, ...]] = [('body', 'markers', 'noise', 'seen', 'turns')]
    for name, markers, pose in zip(linkage.names, linkage.markers, linkage.poses, strict=True):
        turned = float(np.ptp(pose.angle[pose.seen]))
        rows.append(
            (
                name,
                ' '.join(markers),
                f'{pose.noise * 1e3:.2g} mm',
                f'{float(pose.seen.mean()):.0%}',
                f'{turned / 2 / np.pi:.1f} rev'
                if turned > 2 * np.pi
                else f'{np.degrees(turned):.1f} deg',
            )
        )
    lines += _columns(rows)
    if linkage.fixed:
        lines.append(f'markers that stand still: {_marked(linkage, linkage.fixed)}')
    if linkage.single:
        lines.append(
            f'markers of no body: {_marked(linkage, linkage.single)} (alone on theirs, loose, or '
            'exchanged with others: then set marker_identity: shape)'
        )
    lines += ['', *_joints(linkage)]
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
    lines += ['', f'degrees of freedom, by these joints: {linkage.freedom}']
    lines += [f'note: {note}' for note in linkage.notes]
    if checked is not None:
        lines.append(_closing(checked))
    return lines


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
    if not plane.determined:
        where = 'cannot be determined, since all moves along one line: xy is taken'
    elif plane.name:
        where = f'{plane.name}, to {plane.tilt:.2g} deg'
    else:
        normal = ', '.join(f'{value:.4f}' for value in plane.normal)
        where = f'normal [{normal}], {plane.tilt:.1f} deg off the nearest axis'
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
    return (
        f'the draft scene closes: its markers are {checked.first * 1e3:.2g} mm rms off those '
        f'measured at the first frame, {checked.later * 1e3:.2g} mm over 2 s'
    )


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        '  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
