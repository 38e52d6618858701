"""Pictures of result bags."""

from kinpole_ros.tools.plot._draw import plot
from kinpole_ros.tools.plot._linkage import draw_linkage
from kinpole_ros.tools.plot._messages import decode
from kinpole_ros.tools.plot._read import (
    Body,
    Centrodes,
    Results,
    Series,
    centrodes,
    read_results,
)

__all__ = [
    'Body',
    'Centrodes',
    'Results',
    'Series',
    'centrodes',
    'decode',
    'draw_linkage',
    'plot',
    'read_results',
]
