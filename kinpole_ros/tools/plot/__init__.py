"""Pictures of result bags."""

from kinpole_ros.tools.plot._draw import plot
from kinpole_ros.tools.plot._linkage import draw_linkage
from kinpole_ros.tools.plot._messages import decode, row_of
from kinpole_ros.tools.plot._read import (
    Body,
    Centrodes,
    Results,
    Series,
    bodies_of,
    centrodes,
    plane_of_motion,
    read_results,
)
from kinpole_ros.tools.plot._style import picture_format

__all__ = [
    'Body',
    'Centrodes',
    'Results',
    'Series',
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
