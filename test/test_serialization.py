"""Messages as bytes: what rclpy reads back as the same, with nothing but zeros in the padding."""

import random
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message as serialize_with_rclpy

from kinpole_ros.bags import BagWriter, read_messages
from kinpole_ros.messages import (
    _rosbags,
    fields,
    message_class,
    serialize_message,
    type_name,
    with_zero_padding,
)
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
CLASSES = [
    cls
    for package in PACKAGES
    for cls in vars(import_module(f'{package}.msg')).values()
    if isinstance(cls, type)
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
        return filled(message_class(kind), generator)
    drawn = number(kind, generator)
    return bytes((drawn,)) if kind == 'byte' else drawn


def filled(cls: Any, generator: random.Random) -> Any:
    return cls(**{name: value(kind, generator) for name, kind in fields(cls).items()})


@pytest.mark.parametrize('cls', CLASSES, ids=type_name)
def test_a_message_is_serialized_as_rclpy_reads_it_with_zeros_in_the_padding(cls: type) -> None:
    generator = random.Random(type_name(cls))
    for message in [cls(), *(filled(cls, generator) for _ in range(10))]:
        data = serialize_message(message)
        # rclpy leaves room behind some messages.
        assert len(data) <= len(serialize_with_rclpy(message))
        assert deserialize_message(data, cls) == message
        try:
            other: Any = _rosbags.message_class(type_name(cls))
        except LookupError:
            continue
        # That of rosbags has zeros there.
        assert _rosbags.serialize_message(_rosbags.deserialize_message(data, other)) == data


@pytest.mark.parametrize('cls', CLASSES, ids=type_name)
def test_padding_of_a_message_from_elsewhere_becomes_zero(cls: type) -> None:
    generator = random.Random(type_name(cls))
    for message in [cls(), *(filled(cls, generator) for _ in range(10))]:
        data = serialize_message(message)
        assert with_zero_padding(data, cls) == data
        sent = bytearray(serialize_with_rclpy(message))
        # Where a field differs from what it was made of, it is padding.
        places = [k for k in range(4, len(data)) if sent[k] != data[k]]
        for place in places:
            sent[place] = 0xA5
        assert with_zero_padding(bytes(sent) + b'\xa5' * 5, cls) == data
        try:
            other: Any = _rosbags.message_class(type_name(cls))
        except LookupError:
            continue
        read = _rosbags.deserialize_message(data, other)
        store = _rosbags._STORE  # the only writer of the other byte order here
        big = bytes(store.serialize_cdr(read, other.__msgtype__, little_endian=False))
        assert with_zero_padding(big, cls) == big


def test_what_is_no_message_is_written_as_it_is(tmp_path: Path) -> None:
    cls: Any = message_class('geometry_msgs/msg/PointStamped')
    message = cls()
    message.header.frame_id = 'abcdef'
    whole = serialize_message(message)
    place = whole.index(b'abcdef\0') + 7
    assert whole[place] == 0
    dirty = whole[:place] + b'\xa5' + whole[place + 1 :]
    kept = [whole[:-1], dirty[:-1], b'', b'\0\1', b'\0\x0b' + whole[2:], whole[:12] + b'\xff' * 30]
    with BagWriter(tmp_path / 'raw.mcap') as bag:
        for data in [dirty, dirty + b'more', *kept]:
            bag.write_raw('/point', cls, data, 0)
    written = [one.data for one in read_messages(tmp_path / 'raw.mcap')]
    assert written == [whole, whole, *kept]


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
    """Serialized again by rosbags, which leaves zeros there, each message is the same."""
    for one in read_messages(bag):
        cls = _rosbags.message_class(one.type_name)
        again = _rosbags.serialize_message(_rosbags.deserialize_message(one.data, cls))
        assert again == one.data, one.topic
