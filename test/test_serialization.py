"""Messages as bytes: what rclpy reads back as the same, with nothing but zeros in the padding."""

import random
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import WITH_TF
from rclpy.serialization import deserialize_message as read_with_rclpy
from rclpy.serialization import serialize_message as serialize_with_rclpy
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kinpole_ros.bags import BagWriter, read_messages
from kinpole_ros.messages import (
    _types,
    definition,
    deserialize_message,
    fields,
    installed_class,
    message_class,
    serialize_message,
    type_name,
)
from kinpole_ros.messages._definitions import DEFINITIONS
from kinpole_ros.tools.cli import main

ROOT = Path(__file__).parents[1]
PACKAGES = (
    'builtin_interfaces',
    'diagnostic_msgs',
    'geometry_msgs',
    'lifecycle_msgs',
    'nav_msgs',
    'rcl_interfaces',
    'sensor_msgs',
    'shape_msgs',
    'std_msgs',
    'trajectory_msgs',
    'visualization_msgs',
)
TYPES = [
    f'{package}/msg/{name}'
    for package in PACKAGES
    for name, cls in vars(import_module(f'{package}.msg')).items()
    if isinstance(cls, type)
]
# Of tf2_msgs, rclpy may have no classes here.
IN_USE = [
    type_name(cls)
    for cls in vars(_types).values()
    if hasattr(cls, '__msgtype__') and (WITH_TF or cls is not _types.TFMessage)
]


def number(kind: str, generator: random.Random) -> Any:
    if kind == 'bool':
        return generator.random() < 0.5
    if kind.startswith('float'):
        return generator.randrange(-1000, 1000) / 8
    if kind in ('byte', 'char'):
        return generator.randrange(256)
    bits = int(re.sub(r'\D', '', kind))
    low = 0 if kind.startswith('u') else -(2 ** (bits - 1))
    return generator.randrange(low, low + 2**bits)


def value(kind: str, generator: random.Random) -> Any:
    """Something that a field of this type, as a .msg file names it, can have."""
    if array := re.fullmatch(r'(.+?)\[(<=)?(\d*)\]', kind):
        item, bound, size = array.groups()
        count = int(size) if size and not bound else generator.randrange(int(size or 3) + 1)
        items = [value(item, generator) for _ in range(count)]
        if size and not bound and item not in ('bool', 'byte') and not isinstance(items[0], str):
            return items if '/' in item else np.array(items, item.replace('char', 'uint8'))
        return items
    if kind.startswith('string'):
        return ''.join(generator.choice('aé漢') for _ in range(generator.randrange(6)))
    if '/' in kind:
        return filled(kind, generator)
    drawn = number(kind, generator)
    return bytes((drawn,)) if kind == 'byte' else drawn


def filled(name: str, generator: random.Random) -> Any:
    """A message of rclpy."""
    kinds = fields(message_class(name)).items()
    cls = installed_class(name)
    return cls(**{field: value(kind, generator) for field, kind in kinds})


@pytest.mark.parametrize('name', TYPES)
def test_messages_are_those_of_rclpy(name: str) -> None:
    generator = random.Random(name)
    cls = installed_class(name)
    for message in [cls(), *(filled(name, generator) for _ in range(10))]:
        ours = message_class(name)
        data = serialize_message(deserialize_message(serialize_with_rclpy(message), ours))
        assert read_with_rclpy(data, cls) == message
        # Unset fields are alike, and a sender may fill up what it sends.
        again = deserialize_message(data + bytes(8), ours)
        assert type(again) is ours
        assert serialize_message(again) == data


def test_definitions_are_those_of_rosbags() -> None:
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs
    for name, text in DEFINITIONS.items():
        constants, fields_here = get_types_from_msg(text.replace('; ', '\n'), name)[name]
        if not name.startswith('apriltag_msgs'):
            assert ([*constants], [*fields_here]) == ([*known[name][0]], [*known[name][1]])


def test_a_type_without_fields_is_read_and_written() -> None:
    empty = message_class('std_msgs/msg/Empty')
    assert serialize_message(empty()) == b'\0\1\0\0\0'
    assert deserialize_message(b'\0\1\0\0\0', empty) == empty()
    constants = message_class('rcl_interfaces/msg/ParameterType')
    assert constants.PARAMETER_DOUBLE == 3
    assert definition(constants).count('\n') == 10


def test_fields_are_given_in_order_or_by_name() -> None:
    vector = message_class('geometry_msgs/msg/Vector3')
    assert vector(1.0, z=2.0) == vector(1.0, 0.0, 2.0)
    assert vector(1.0) != message_class('geometry_msgs/msg/Point')(1.0)
    assert repr(vector(1.0)) == 'Vector3(x=1.0, y=0.0, z=0.0)'
    for wrong in (lambda: vector(w=1.0), lambda: vector(1.0, 2.0, 3.0, 4.0)):
        with pytest.raises(TypeError, match='the fields of geometry_msgs/msg/Vector3 are x, y, z'):
            wrong()


@pytest.mark.parametrize('name', IN_USE)
def test_fields_that_are_not_given_are_those_of_rclpy(name: str) -> None:
    cls = installed_class(name)
    assert read_with_rclpy(serialize_message(message_class(name)()), cls) == cls()


def test_a_type_has_one_class_by_either_name() -> None:
    assert message_class('std_msgs/Header') is message_class('std_msgs/msg/Header')


def test_bytes_are_recorded_as_they_came(tmp_path: Path) -> None:
    message = message_class('geometry_msgs/msg/PointStamped')()
    data = serialize_message(message)
    sent = [data, data + b'more', data[:-1], b'', b'\0\1']
    with BagWriter(tmp_path / 'raw.mcap') as bag:
        for one in sent:
            bag.write_raw('/point', type_name(type(message)), one, 0)
    assert [one.data for one in read_messages(tmp_path / 'raw.mcap')] == sent


@pytest.mark.parametrize('message', ['marker_array', 'marker', 'point_cloud2', 'pose_array'])
def test_equal_seeds_make_equal_bags(tmp_path: Path, message: str) -> None:
    words = ['simulate', 'four_bar', '--duration', '0.5', '--noise', '1e-4', '--message', message]
    bags = [tmp_path / name for name in ('one.mcap', 'other.mcap')]
    for number_, bag in enumerate(bags):
        # What the memory holds meanwhile is different.
        junk = [bytes([number_ + 1]) * size for size in range(100, 10_000, 7)]
        assert main([*words, '--output', str(bag)]) == 0
        del junk
    assert bags[0].read_bytes() == bags[1].read_bytes()
    assert_padding_is_zero(bags[0])


@pytest.mark.parametrize('bag', sorted((ROOT / 'bags').glob('*.mcap')), ids=lambda bag: bag.stem)
def test_sample_bags_hold_nothing_of_the_memory_of_who_made_them(bag: Path) -> None:
    assert_padding_is_zero(bag)


def assert_padding_is_zero(bag: Path) -> None:
    """Serialized again, with zeros there, each message is the same."""
    for one in read_messages(bag):
        cls = message_class(one.type_name)
        again = serialize_message(deserialize_message(one.data, cls))
        assert again == one.data, one.topic
