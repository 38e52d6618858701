"""A picture of a linkage that was found: bodies over the tracks of markers, and joints."""

from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.linkage import Linkage
from kinpole_ros.linkage._draft import first_frame
from kinpole_ros.tools.plot._style import draw_ground, hull, saved_figure

_SIZE, _DPI = (10.0, 6.2), 100  # inches
_COLORS = ('#0060a8', '#b34700', '#00785a', '#7a3d9a', '#8a6d00', '#a3234f', '#3a6f8f', '#555555')
_MOST_POINTS = 800  # of a track
_HALO: dict[str, Any] = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.8, 'pad': 1.2}
_GROUND = -1  # of the ground, where bodies go by number


def draw_linkage(linkage: Linkage, output: str | Path, title: str) -> None:
    """
    Draw what was found to `output`, in the format of its suffix.

    Raises BagError when `output` cannot be written or matplotlib is missing.
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
    parts = [f'{bodies} bod{"y" if bodies == 1 else "ies"}, {joints} joint{"s"[: joints != 1]}']
    where = f'plane {plane.name}' if plane.name else f'plane tilted by {plane.tilt:.1f} deg'
    parts.append(where if linkage.space is None else f'not in one plane, projected on: {where}')
    parts.append('markers in m' if linkage.scale == 1 else 'markers in mm')
    if not linkage.ordered:
        parts.append('points without names')
    return ', '.join(parts)


def _draw(axis: Any, linkage: Linkage) -> None:
    frame = first_frame(linkage) if linkage.joints or linkage.rolling else _most_seen(linkage)
    unit = 1e3
    step = max(1, len(linkage.seconds) // _MOST_POINTS)
    extent = 0.0
    at: dict[str, complex] = {}
    for k, (name, pose) in enumerate(zip(linkage.names, linkage.poses, strict=True)):
        color = _COLORS[k % len(_COLORS)]
        turn = np.exp(1j * pose.angle[frame])
        tracks = linkage.tracks[::step][:, linkage.columns[k]] * unit
        axis.plot(tracks.real, tracks.imag, '.', color=color, markersize=0.7, alpha=0.35, zorder=1)
        extent = max(extent, float(np.nanmax(np.abs(tracks - np.nanmean(tracks)))))
        markers = (pose.position[frame] + turn * pose.shape) * unit
        own = {p.name: pose.position[frame] + turn * p.on[k] for p in linkage.places if k in p.on}
        at |= {p: z * unit for p, z in own.items()}
        corners = hull(np.concatenate((markers, np.array([z * unit for z in own.values()]))))
        axis.fill(corners.real, corners.imag, color=color, alpha=0.18, zorder=2)
        outline = np.append(corners, corners[0])
        axis.plot(outline.real, outline.imag, color=color, linewidth=1.4, zorder=3, label=name)
        axis.plot(markers.real, markers.imag, 'o', color=color, markersize=4, zorder=4)
    for place in linkage.places:
        if _GROUND in place.on:
            at[place.name] = place.on[_GROUND] * unit
    axis.set_aspect('equal')
    axis.margins(0.06)
    _draw_lengths(axis, linkage, at)
    _draw_joints(axis, linkage, at, extent)
    axis.set_xlabel('mm (± one deviation of a pin)')
    axis.set_ylabel('mm')
    axis.grid(True, color='#e8e8e8', linewidth=0.6, zorder=0)
    axis.set_axisbelow(True)
    axis.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)


def _most_seen(linkage: Linkage) -> int:
    return int(np.sum([pose.seen for pose in linkage.poses], axis=0).argmax())


def _draw_lengths(axis: Any, linkage: Linkage, at: dict[str, complex]) -> None:
    for length in linkage.lengths():
        if length.one not in at or length.other not in at:
            continue
        ends = np.array([at[length.one], at[length.other]])
        grounded = length.body == 'ground'
        color = '#777777' if grounded else _COLORS[linkage.names.index(length.body) % len(_COLORS)]
        style = (0, (1, 2)) if grounded else '-'
        axis.plot(ends.real, ends.imag, color=color, linestyle=style, linewidth=0.9, zorder=3)
        # Away from the middle, where lines to other points of the ground cross.
        middle = ends[0] + (0.64 if grounded else 0.5) * (ends[1] - ends[0])
        across = ends[1] - ends[0]
        angle = np.degrees(np.angle(across))
        axis.text(
            middle.real,
            middle.imag,
            f'{length.value * 1e3:.2f}',
            color=color,
            fontsize=8,
            ha='center',
            va='center',
            rotation=(angle + 90) % 180 - 90,
            rotation_mode='anchor',
            bbox=_HALO,
            zorder=6,
        )


def _draw_joints(axis: Any, linkage: Linkage, at: dict[str, complex], extent: float) -> None:
    size = 0.03 * extent
    for joint in linkage.joints:
        if joint.kind in ('slot', 'slide', 'trammel') and joint.other == _GROUND:
            directions = (0.0, np.pi / 2) if joint.kind == 'trammel' else (joint.along,)
            for along in directions:
                ends = joint.on_other * 1e3 + np.exp(1j * along) * extent * np.array([-1, 1])
                axis.plot(ends.real, ends.imag, color='black', linewidth=1, dashes=(6, 3), zorder=3)
    for wheel in linkage.rolling:
        if not wheel.circle and wheel.other == _GROUND:
            ends = wheel.at * 1e3 + np.exp(1j * wheel.along) * extent * np.array([-1, 1])
            axis.plot(ends.real, ends.imag, color='black', linewidth=1, zorder=3)
    for place in linkage.places:
        z = at.get(place.name)
        if z is None or place.name.endswith('_line'):
            continue
        if _GROUND in place.on:
            draw_ground(axis, z, size)
        axis.plot(
            [z.real],
            [z.imag],
            'o',
            markersize=9,
            markerfacecolor='white',
            markeredgecolor='black',
            markeredgewidth=1.4,
            zorder=7,
        )
        axis.annotate(
            f'{place.name} ±{place.deviation * 1e3:.2g}',
            (z.real, z.imag),
            xytext=(8, 7),
            textcoords='offset points',
            fontsize=8.5,
            fontweight='bold',
            bbox=_HALO,
            zorder=8,
        )
