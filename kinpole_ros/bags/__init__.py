"""MCAP bags in rosbag2's conventions, in and out, and spreadsheets into them."""

from ._import import import_csv
from ._reader import BagError, BagMessage, Truncated, bag_files, read_messages, topics
from ._schema import definition, message_class, type_name
from ._writer import BagWriter

__all__ = [
    'BagError',
    'BagMessage',
    'BagWriter',
    'Truncated',
    'bag_files',
    'definition',
    'import_csv',
    'message_class',
    'read_messages',
    'topics',
    'type_name',
]
