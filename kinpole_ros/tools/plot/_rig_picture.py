"""The picture of `kinpole discover`: bodies and joints over the tracks of the markers."""

from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.linkage import Linkage
from kinpole_ros.linkage._draft import first_frame
from kinpole_ros.tools.plot._style import draw_ground, hull, saved_figure

_SIZE, _DPI = (10.0, 6.2), 100  # inches
_COLORS = ('#0060a8', '#b34700', '#00785a', '#7a3d9a', '#8a6d00', '#a3234f', '#3a6f8f', '#555555')
_TRACK_POINTS = 800
_MM = 1e3
_LABEL_BOX: dict[str, Any] = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.8, 'pad': 1.2}
_GROUND = -1  # the number of the ground


def draw_linkage(linkage: Linkage, output: str | Path, title: str) -> None:
    """
    Draw a linkage to `output`, in the format of its ending.

    Raises BagError if `output` cannot be written or matplotlib is missing.
    """
    with saved_figure(output, _SIZE, _DPI) as figure:
        axis = figure.add_subplot()
        _draw(axis, linkage)
        axis.set_title(f'{title}: {_about(linkage)}', fontsize=10, parse_math=False)


def _about(linkage: Linkage) -> str:
    plane = linkage.plane
    bodies, joints = len(linkage.names), len(linkage.joints) + len(linkage.rolling)
    if linkage.space is not None:
        joints = len(linkage.space.joints)
    words = [f'{bodies} bod{"y" if bodies == 1 else "ies"}, {joints} joint{"s"[: joints != 1]}']
    name = f'plane {plane.name}' if plane.name else f'plane tilted by {plane.tilt:.1f} deg'
    words.append(name if linkage.space is None else f'not in one plane, projected on: {name}')
    words.append('markers in m' if linkage.scale == 1 else 'markers in mm')
    if not linkage.ordered:
        words.append('points without names')
    return ', '.join(words)


def _color(k: int) -> str:
    return _COLORS[k % len(_COLORS)]


def _draw(axis: Any, linkage: Linkage) -> None:
    """Draw bodies and joints in the first frame with all bodies, or the frame with most."""
    if linkage.joints or linkage.rolling:
        frame = first_frame(linkage)
    else:
        frame = int(np.sum([pose.seen for pose in linkage.poses], axis=0).argmax())
    step = max(1, len(linkage.seconds) // _TRACK_POINTS)
    extent = 0.0
    points: dict[str, complex] = {}  # positions of named points, mm
    for k, (name, pose) in enumerate(zip(linkage.names, linkage.poses, strict=True)):
        color = _color(k)
        tracks = linkage.tracks[::step][:, linkage.columns[k]] * _MM
        axis.plot(tracks.real, tracks.imag, '.', color=color, markersize=0.7, alpha=0.35, zorder=1)
        extent = max(extent, float(np.nanmax(np.abs(tracks - np.nanmean(tracks)))))
        position, turn = pose.position[frame], np.exp(1j * pose.angle[frame])
        markers = (position + turn * pose.shape) * _MM
        own = {p.name: (position + turn * p.on[k]) * _MM for p in linkage.places if k in p.on}
        points |= own
        corners = hull(np.concatenate((markers, np.array([*own.values()]))))
        axis.fill(corners.real, corners.imag, color=color, alpha=0.18, zorder=2)
        outline = np.append(corners, corners[0])
        axis.plot(outline.real, outline.imag, color=color, linewidth=1.4, zorder=3, label=name)
        axis.plot(markers.real, markers.imag, 'o', color=color, markersize=4, zorder=4)
    points |= {p.name: p.on[_GROUND] * _MM for p in linkage.places if _GROUND in p.on}
    axis.set_aspect('equal')
    axis.margins(0.06)
    _draw_lengths(axis, linkage, points)
    _draw_joints(axis, linkage, points, extent)
    axis.set(xlabel='mm (± one deviation of a pin)', ylabel='mm')
    axis.grid(True, color='#e8e8e8', linewidth=0.6, zorder=0)
    axis.set_axisbelow(True)
    axis.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)


def _draw_lengths(axis: Any, linkage: Linkage, points: dict[str, complex]) -> None:
    for length in linkage.lengths():
        if length.one not in points or length.other not in points:
            continue
        ends = np.array([points[length.one], points[length.other]])
        is_ground = length.body == 'ground'
        color = '#777777' if is_ground else _color(linkage.names.index(length.body))
        style = (0, (1, 2)) if is_ground else '-'
        axis.plot(ends.real, ends.imag, color=color, linestyle=style, linewidth=0.9, zorder=3)
        # Labels of the ground are off the middle, where lines to its other points cross.
        vector = ends[1] - ends[0]
        at = ends[0] + (0.64 if is_ground else 0.5) * vector
        axis.text(
            at.real,
            at.imag,
            f'{length.value * _MM:.2f}',
            color=color,
            fontsize=8,
            ha='center',
            va='center',
            rotation=(np.degrees(np.angle(vector)) + 90) % 180 - 90,
            rotation_mode='anchor',
            bbox=_LABEL_BOX,
            zorder=6,
        )


def _draw_joints(axis: Any, linkage: Linkage, points: dict[str, complex], extent: float) -> None:
    def draw_guide(z: complex, angle: float, **style: Any) -> None:
        ends = z * _MM + np.exp(1j * angle) * extent * np.array([-1, 1])
        axis.plot(ends.real, ends.imag, color='black', linewidth=1, zorder=3, **style)

    for joint in linkage.joints:
        if joint.kind in ('slot', 'slide', 'trammel') and joint.other == _GROUND:
            for angle in (0.0, np.pi / 2) if joint.kind == 'trammel' else (joint.along,):
                draw_guide(joint.on_other, angle, dashes=(6, 3))
    for wheel in linkage.rolling:
        if not wheel.circle and wheel.other == _GROUND:
            draw_guide(wheel.at, wheel.along)
    for point in linkage.places:
        z = points.get(point.name)
        if z is None or point.name.endswith('_line'):
            continue
        if _GROUND in point.on:
            draw_ground(axis, z, 0.03 * extent)
        circle = {'markersize': 9, 'markerfacecolor': 'white', 'markeredgecolor': 'black'}
        axis.plot([z.real], [z.imag], 'o', markeredgewidth=1.4, zorder=7, **circle)
        axis.annotate(
            f'{point.name} ±{point.deviation * _MM:.2g}',
            (z.real, z.imag),
            xytext=(8, 7),
            textcoords='offset points',
            fontsize=8.5,
            fontweight='bold',
            bbox=_LABEL_BOX,
            zorder=8,
        )
