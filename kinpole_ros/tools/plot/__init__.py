"""Pictures of bags of results, and of the linkages that discover finds."""

from kinpole_ros.tools.plot._result_picture import plot
from kinpole_ros.tools.plot._rig_picture import draw_linkage
from kinpole_ros.tools.plot._style import picture_format

__all__ = ['draw_linkage', 'picture_format', 'plot']
