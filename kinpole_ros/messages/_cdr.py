"""
The bytes of messages: plain CDR, the encoding of ROS 2, with zeros in the padding.

Four bytes name the encoding and byte order. The fields follow, each aligned to its size, counted
from behind these four bytes. rclpy leaves in the padding, and behind the last field of some
messages, whatever was in the memory of the process; here it is set to zero, so equal messages are
equal bytes and a bag holds nothing of that memory.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.messages import _types
from kinpole_ros.messages._types import SECOND, WITH_ROS, fields, message_class

HEAD = 4  # bytes before the first field
LITTLE = b'\x00\x01'  # the first two bytes of a little endian message
TIME = struct.Struct('<iI')  # a stamp: s and ns
_FLOAT64 = 8  # PointField.FLOAT64
ALIGNMENT = 8  # bytes: no field is aligned to more
_LENGTHS = {b'\x00\x00': struct.Struct('>I'), LITTLE: struct.Struct('<I')}  # by byte order
_ARRAY = re.compile(r'(.+?)\[(<=)?(\d*)\]')
# Bytes of the number types of .msg files.
_SIZES = {'bool': 1, 'byte': 1, 'char': 1, 'float32': 4, 'float64': 8} | {
    f'{sign}int{8 * size}': size for sign in ('', 'u') for size in (1, 2, 4, 8)
}


class Writer:
    """Writes fields one after the other to `data`, each aligned to its size."""

    def __init__(self) -> None:
        self.data = bytearray(LITTLE.ljust(HEAD, b'\0'))

    def align(self, size: int) -> None:
        self.data += bytes((HEAD - len(self.data)) % size)

    def pack(self, form: str, *values: float) -> None:
        """Fields of 4 bytes or less, as `struct` names them."""
        self.align(4)
        self.data += struct.pack(f'<{form}', *values)

    def string(self, text: str) -> None:
        raw = text.encode() + b'\0'
        self.pack('I', len(raw))
        self.data += raw

    def header(self, stamp: int, frame_id: str) -> None:
        self.align(4)
        self.data += TIME.pack(*divmod(stamp, SECOND))
        self.string(frame_id)

    def cloud_fields(self, kinds: Mapping[str, int], points: int) -> int:
        """
        Write all between header and data of a PointCloud2 of one row of so many points.

        `kinds` are the data types of its fields, of 4 or 8 bytes, one after the other. Returns the
        size of the data in bytes.
        """
        self.pack('III', 1, points, len(kinds))
        offset = 0
        for name, kind in kinds.items():
            self.string(name)
            self.pack('I', offset)
            self.data += bytes((kind,))
            self.pack('I', 1)
            offset += 8 if kind == _FLOAT64 else 4
        self.data += b'\0'  # little endian
        self.pack('III', offset, offset * points, offset * points)
        return offset * points

    def doubles(self, values: np.ndarray) -> None:
        if values.size:
            self.align(8)
            self.data += values.astype('<f8').tobytes()


def stamp_bytes(stamps: np.ndarray) -> np.ndarray:
    """The bytes (T, 8) of stamps (T,) in ns."""
    times = np.empty((len(stamps), 2), '<u4')
    times[:, 0], times[:, 1] = np.divmod(stamps, SECOND)
    return times.view(np.uint8)


def serialize_message(message: Any) -> bytes:
    """
    Serialize a message to plain CDR, little endian, with zeros in the padding.

    Parameters
    ----------
    message : object
        A message of a class of `message_class`.

    Returns
    -------
    bytes
        The message. One with a field of type wstring has the padding that rclpy leaves.
    """
    data = _types.serialize_message(message)
    return with_zero_padding(data, type(message)) if WITH_ROS else data


def with_zero_padding(data: bytes, cls: Any) -> bytes:
    """
    Return a message with zeros in its padding and nothing behind its last field.

    Parameters
    ----------
    data : bytes
        The message, in plain CDR of either byte order.
    cls : type
        Its class.

    Returns
    -------
    bytes
        The same message; `data` unchanged where it is not a message of this class, or has a
        wstring.
    """
    try:
        walk = _Walk(bytearray(data), len(data), _LENGTHS[data[:2]].unpack_from)
        end = _pass_fields(walk, HEAD, _steps(cls))
    except (LookupError, struct.error):
        return data
    return bytes(walk.data[:end])


class _Walk(NamedTuple):
    """A message whose padding becomes zero, its size, and the reader of the lengths in it."""

    data: bytearray
    size: int
    length_at: Callable[[bytearray, int], tuple[int]]


# Passes one field, or several numbers in a row, from an offset on; returns the offset behind them.
_Step: TypeAlias = Callable[[_Walk, int], int]


def _pass_fields(walk: _Walk, at: int, steps: Sequence[_Step]) -> int:
    for step in steps:
        at = step(walk, at)
    if at > walk.size:
        raise struct.error('the message is cut off')
    return at


def _align(walk: _Walk, at: int, size: int) -> int:
    gap = (HEAD - at) % size
    if gap:
        walk.data[at : at + gap] = bytes(gap)
    return at + gap


def _pass_text(walk: _Walk, at: int) -> int:
    at = _align(walk, at, 4)
    return at + 4 + walk.length_at(walk.data, at)[0]


@cache
def _steps(cls: Any) -> list[_Step]:
    """Return what passes the fields of a message class in order, numbers in a row as one."""
    steps: list[_Step] = []
    sizes: list[int] = []
    for kind in [*_flat_kinds(cls), '']:
        if kind in _SIZES:
            sizes.append(_SIZES[kind])
            continue
        if sizes:
            steps.append(_numbers(sizes))
            sizes = []
        if array := _ARRAY.fullmatch(kind):
            item, bound, size = array.groups()
            steps.append(_array(item, None if bound or not size else int(size)))
        elif kind.startswith('string'):
            steps.append(_pass_text)
        elif kind:
            raise LookupError(kind)
    return steps


def _flat_kinds(cls: Any) -> list[str]:
    """Types of all fields; a single message is replaced by its fields."""
    kinds: list[str] = []
    for kind in fields(cls).values():
        if '/' in kind and not kind.endswith(']'):
            kinds += _flat_kinds(message_class(kind))
        else:
            kinds.append(kind)
    # A type without fields has one byte.
    return kinds or ['uint8']


def _numbers(sizes: Sequence[int]) -> _Step:
    """Pass numbers of these sizes, each aligned to its own."""
    # By the offset of the first one modulo 8: the size of all, and the gaps between them.
    layouts = []
    for start in range(ALIGNMENT):
        at, gaps = start, []
        for size in sizes:
            if gap := -at % size:
                gaps.append((at - start, at - start + gap))
            at += gap + size
        layouts.append((at - start, gaps))

    def step(walk: _Walk, at: int) -> int:
        size, gaps = layouts[(at - HEAD) % ALIGNMENT]
        for first, last in gaps:
            walk.data[at + first : at + last] = bytes(last - first)
        return at + size

    return step


def _array(item: str, length: int | None) -> _Step:
    """Pass an array of items of this type; a sequence without `length`."""
    kinds = _flat_kinds(message_class(item)) if '/' in item else [item]
    sizes = {_SIZES.get(kind, 0) for kind in kinds}
    # Numbers of one size have no padding between them.
    size, width = (sizes.pop() if len(sizes) == 1 else 0), len(kinds)
    steps: list[_Step] = []
    if not size and item.startswith('string'):
        steps = [_pass_text]
    elif not size and '/' in item:
        steps = _steps(message_class(item))
    elif not size:
        raise LookupError(item)

    def step(walk: _Walk, at: int) -> int:
        count = length
        if count is None:
            at = _align(walk, at, 4)
            count, at = walk.length_at(walk.data, at)[0], at + 4
        if size:
            return _align(walk, at, size) + count * width * size if count else at
        for _ in range(count):
            at = _pass_fields(walk, at, steps)
        return at

    return step
