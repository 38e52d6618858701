"""The parameter file of a linkage, for the node and for replay."""

import re

from kinpole_ros.linkage._model import Linkage

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
    for name, markers, pose in zip(linkage.names, linkage.markers, linkage.poses, strict=True):
        lines.append(f'    {name}:')
        if linkage.ordered:
            lines.append(f'      markers: [{", ".join(map(_text, markers))}]')
        else:
            places = ', '.join(f'{z.real:.6f}, {z.imag:.6f}' for z in pose.shape)
            lines.append(f'      shape: [{places}]  # x, y of each marker, m')
    return '\n'.join(lines) + '\n'


def _text(name: str) -> str:
    if _PLAIN.fullmatch(name) and name.lower() not in _OTHER:
        return name
    quoted = name.replace("'", "''")
    return f"'{quoted}'"
