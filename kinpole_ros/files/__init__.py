"""
Files from anywhere: opened, read and shown such that none can hang, fill or confuse a program.

All readers of bags, tables, scenes and parameters open their files here, and all results are
written here beside what they replace. `bounded_yaml` is for who needs PyYAML.
"""

from kinpole_ros.files._lock import lock
from kinpole_ros.files._open import open_regular, read_limited
from kinpole_ros.files._shown import cut, cut_line, printable
from kinpole_ros.files._whole import whole

__all__ = [
    'cut',
    'cut_line',
    'lock',
    'open_regular',
    'printable',
    'read_limited',
    'whole',
]
