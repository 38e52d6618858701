"""
Linkages from measured markers.

`discover` finds bodies and joints from markers alone; `draft`, `table` and `parameter_file` write
them. The modules `theory`, `positions` and `fit` compare a given scene with the tracked
bodies.
"""

from kinpole_ros.linkage._discover import discover
from kinpole_ros.linkage._draft import Checked, check_draft, draft
from kinpole_ros.linkage._linkage import Length, Linkage, Place
from kinpole_ros.linkage._record import UndiscoveredError
from kinpole_ros.linkage._report import (
    input_texts,
    joint_lines,
    marker_lines,
    parameter_file,
    table,
)

__all__ = [
    'Checked',
    'Length',
    'Linkage',
    'Place',
    'UndiscoveredError',
    'check_draft',
    'discover',
    'draft',
    'input_texts',
    'joint_lines',
    'marker_lines',
    'parameter_file',
    'table',
]
