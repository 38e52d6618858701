"""
Messages as they came from anywhere, with padding zero.

Other serializers leave in the padding, and in some messages behind the last field, whatever was in
the memory of their process. The fields are walked through by the type of the message, and nothing
is made of them, so this takes less time than reading a message and writing it again.
"""

import struct
from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

from kinpole_ros.messages._cdr_writer import ALIGNMENT, ARRAY, FORMATS, HEAD, LITTLE
from kinpole_ros.messages._types import fields, message_class

# Passes one field, or several in a row, of a message: the place behind it.
_Step: TypeAlias = Callable[['_Walk', int], int]

# Bytes of the types that .msg files call so.
_SIZES = {'byte': 1} | {kind: struct.calcsize(f'<{form}') for kind, form in FORMATS.items()}
_LENGTHS = {b'\0\0': struct.Struct('>I'), LITTLE: struct.Struct('<I')}  # by byte order


class _Walk:
    """Bytes of one message, in which the padding becomes zero as it is passed."""

    def __init__(self, data: bytes) -> None:
        self.data, self.end = bytearray(data), len(data)
        self.length_of = _LENGTHS[data[:2]].unpack_from

    def clear(self, first: int, last: int) -> None:
        self.data[first:last] = bytes(last - first)

    def align(self, at: int, size: int) -> int:
        if rest := (HEAD - at) % size:
            self.clear(at, at + rest)
        return at + rest

    def length(self, at: int) -> tuple[int, int]:
        """The length of a sequence or text that is told at a place, and the place behind it."""
        at = self.align(at, 4)
        return self.length_of(self.data, at)[0], at + 4

    def check(self, at: int) -> int:
        if at > self.end:
            raise struct.error('a message that is cut off')
        return at


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
        The same message; `data` as it is where it is not such a message, or has a wstring.
    """
    try:
        walk = _Walk(data)
        at = HEAD
        for step in _steps(cls):
            at = walk.check(step(walk, at))
    except (LookupError, struct.error, TypeError):
        return data
    return bytes(walk.data[:at])


@cache
def _steps(cls: Any) -> tuple[_Step, ...]:
    """What passes the fields of a message of this class, in order."""
    steps: list[_Step] = []
    row: list[int] = []  # sizes of numbers that follow each other
    for kind in _flat_kinds(cls):
        if kind in _SIZES:
            row.append(_SIZES[kind])
            continue
        if row:
            steps.append(_numbers(tuple(row)))
            row = []
        steps.append(_field(kind))
    if row:
        steps.append(_numbers(tuple(row)))
    return tuple(steps)


def _flat_kinds(cls: Any) -> list[str]:
    """Types of all fields, those of single messages in it in their place."""
    found: list[str] = []
    for kind in fields(cls).values():
        if '/' in kind and not kind.endswith(']'):
            found += _flat_kinds(message_class(kind))
        else:
            found.append(kind)
    # A type without fields has one byte all the same.
    return found or ['uint8']


def _numbers(sizes: tuple[int, ...]) -> _Step:
    """Pass numbers of these sizes, each aligned to its own."""
    # Where padding is depends on the place, modulo 8 bytes, at which the row begins.
    layouts = []
    for start in range(ALIGNMENT):
        place, gaps = start, []
        for size in sizes:
            if rest := -place % size:
                gaps.append((place - start, place - start + rest))
            place += rest + size
        layouts.append((place - start, gaps))

    def step(walk: _Walk, at: int) -> int:
        size, gaps = layouts[(at - HEAD) % ALIGNMENT]
        for first, last in gaps:
            walk.clear(at + first, at + last)
        return at + size

    return step


def _field(kind: str) -> _Step:
    """Pass one field that is no number."""
    if array := ARRAY.fullmatch(kind):
        item, bound, size = array.groups()
        return _array(item, None if bound or not size else int(size))
    if kind.startswith('string'):

        def step(walk: _Walk, at: int) -> int:
            count, at = walk.length(at)
            return at + count

        return step
    raise TypeError(f'a field of type {kind}')


def _array(item: str, count: int | None) -> _Step:
    """Pass an array of so many items, or a sequence, which tells how many it has."""
    kinds = _flat_kinds(message_class(item)) if '/' in item else [item]
    sizes = {_SIZES.get(kind, 0) for kind in kinds}
    if len(sizes) == 1 and 0 not in sizes:
        # Numbers of one size have no padding between them.
        size, width = sizes.pop(), len(kinds)

        def pass_all(walk: _Walk, at: int) -> int:
            number, at = walk.length(at) if count is None else (count, at)
            return walk.align(at, size) + number * width * size if number else at

        return pass_all
    steps = _steps(message_class(item)) if '/' in item else (_field(item),)

    def pass_each(walk: _Walk, at: int) -> int:
        number, at = walk.length(at) if count is None else (count, at)
        for _ in range(number):
            for step in steps:
                at = step(walk, at)
            walk.check(at)
        return at

    return pass_each
