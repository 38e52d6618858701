"""The parameter file of a linkage, for the node and for replay."""

import re

from kinpole_ros.linkage._model import GROUND_NUMBER, Linkage
from kinpole_ros.tracking.plane import plane_of

_PLAIN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
# What YAML takes for something else than text.
_OTHER = {'y', 'n', 'yes', 'no', 'on', 'off', 'true', 'false', 'null'}


def parameter_file(linkage: Linkage, topic: str = '/markers', about: str = '') -> str:
    """Its text. What is as by default is left out."""
    lines = [f'# {line}' for line in about.splitlines()]
    lines += ['/**:', '  ros__parameters:']
    if topic.lstrip('/') != 'markers':
        lines.append(f'    marker_topic: {topic}')
    plane = linkage.plane
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
    pins = _pins(linkage)
    for name, markers, pose in zip(linkage.names, linkage.markers, linkage.poses, strict=True):
        lines.append(f'    {name}:')
        if linkage.ordered:
            lines.append(f'      markers: [{", ".join(map(_text, markers))}]')
        else:
            places = ', '.join(f'{z.real:.6f}, {z.imag:.6f}' for z in pose.shape)
            lines.append(f'      shape: [{places}]  # x, y of each marker, m')
            if name in pins:
                places = ', '.join(f'{z.real:.6f}, {z.imag:.6f}' for z in pins[name])
                lines.append(f'      pin: [{places}]  # x, y there and in the plane, m')
    return '\n'.join(lines) + '\n'


def _pins(linkage: Linkage) -> dict[str, tuple[complex, complex]]:
    """Where bodies are pinned to the ground: on the body, and in the axes that the node uses."""
    plane = plane_of(linkage.plane.name or tuple(linkage.plane.normal.round(6).tolist()))
    assert plane is not None
    pins = {}
    for joint in linkage.joints:
        if joint.kind == 'pin' and joint.other == GROUND_NUMBER:
            at = joint.on_other.real, joint.on_other.imag
            ground = complex(plane.project(at @ linkage.plane.axes)[0])
            pins[linkage.names[joint.one]] = joint.on_one, ground
    return pins


def _text(name: str) -> str:
    if _PLAIN.fullmatch(name) and name.lower() not in _OTHER:
        return name
    quoted = name.replace("'", "''")
    return f"'{quoted}'"
