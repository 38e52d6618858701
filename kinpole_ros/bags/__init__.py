"""MCAP bags in rosbag2's conventions, in and out, and files of tracked points into them."""

from typing import TYPE_CHECKING, Any

from kinpole_ros.bags._bag_reader import read_blocks, read_messages, topics
from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags._channels import BagMessage, message_class
from kinpole_ros.bags._files import (
    RECORDER,
    BagError,
    Truncated,
    bag_files,
    in_place_of,
    recorder_of,
)
from kinpole_ros.bags._marker_frames import NODE_NAME, read_frames
from kinpole_ros.bags._repeated_frames import leave_out_repeats
from kinpole_ros.bags._replay import replay
from kinpole_ros.bags._replayed import Replayed, assumed_body
from kinpole_ros.messages import definition, type_name

if TYPE_CHECKING:
    from kinpole_ros.bags._import import Imported, import_points, write_points
    from kinpole_ros.bags._simulate import simulate

__all__ = [
    'NODE_NAME',
    'RECORDER',
    'BagError',
    'BagMessage',
    'BagWriter',
    'Imported',
    'Replayed',
    'Truncated',
    'assumed_body',
    'bag_files',
    'definition',
    'import_points',
    'in_place_of',
    'leave_out_repeats',
    'message_class',
    'read_blocks',
    'read_frames',
    'read_messages',
    'recorder_of',
    'replay',
    'simulate',
    'topics',
    'type_name',
    'write_points',
]


def __getattr__(name: str) -> Any:
    # Imported when asked for: replay needs neither.
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from kinpole_ros.bags import _import, _simulate

    return _simulate.simulate if name == 'simulate' else getattr(_import, name)
