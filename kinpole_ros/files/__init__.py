"""
Files of strangers, opened, read and shown safely; results that replace others when complete.

All readers of bags, tables, scenes and parameters open their files by these functions.
`bounded_yaml` is a module of its own, as only readers of YAML need PyYAML.
"""

from kinpole_ros.files._reading import (
    cut,
    cut_line,
    did_you_mean,
    open_regular,
    printable,
    read_limited,
)
from kinpole_ros.files._writing import as_cell, lock, whole_file

__all__ = [
    'as_cell',
    'cut',
    'cut_line',
    'did_you_mean',
    'lock',
    'open_regular',
    'printable',
    'read_limited',
    'whole_file',
]
