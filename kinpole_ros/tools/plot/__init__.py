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

__all__ = [
    'Body',
    'Centrodes',
    'Results',
    'Series',
    'bodies_of',
    'centrodes',
    'decode',
    'draw_linkage',
    'plane_of_motion',
    'plot',
    'read_results',
    'row_of',
]
