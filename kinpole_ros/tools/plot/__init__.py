"""Pictures of bags of results, and of the linkages that discover finds."""

from kinpole_ros.tools.plot._linkage import draw_linkage
from kinpole_ros.tools.plot._picture import plot
from kinpole_ros.tools.plot._results import (
    Body,
    Centrodes,
    bodies_of,
    centrodes,
    decode,
    plane_of_motion,
    read_results,
    row_of,
)
from kinpole_ros.tools.plot._style import picture_format

__all__ = [
    'Body',
    'Centrodes',
    'bodies_of',
    'centrodes',
    'decode',
    'draw_linkage',
    'picture_format',
    'plane_of_motion',
    'plot',
    'read_results',
    'row_of',
]
