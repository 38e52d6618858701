"""Pictures of bags of results, and of the linkages that discover finds."""

from kinpole_ros.tools.plot._gaps import lost_count, lost_frames, usual_interval
from kinpole_ros.tools.plot._linkage import draw_linkage
from kinpole_ros.tools.plot._picture import plot
from kinpole_ros.tools.plot._results import (
    Body,
    Centrodes,
    bodies_of,
    centrodes,
    plane_of_motion,
    read_results,
    read_truth,
)
from kinpole_ros.tools.plot._style import picture_format
from kinpole_ros.tools.plot._topics import Series, decode, row_of

__all__ = [
    'Body',
    'Centrodes',
    'Series',
    'bodies_of',
    'centrodes',
    'decode',
    'draw_linkage',
    'lost_count',
    'lost_frames',
    'picture_format',
    'plane_of_motion',
    'plot',
    'read_results',
    'read_truth',
    'row_of',
    'usual_interval',
]
