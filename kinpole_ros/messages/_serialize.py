"""
Messages of rclpy's classes as bytes, with padding zero.

rclpy's own serializer leaves in the padding, and in some messages behind the last field, whatever
was in the memory of the process. So equal messages give different bytes, and whoever gets a bag
gets some of that memory.
"""

import struct
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np

from kinpole_ros.messages._cdr_writer import ALIGNMENT, ARRAY, FORMATS, HEAD, Writer
from kinpole_ros.messages._rosidl import fields, message_class

# What appends one field, or several in a row, of a message to the bytes so far.
_Step: TypeAlias = Callable[[Writer, Any], None]


def serialize_message(message: Any) -> bytes:
    """
    Serialize a message to plain CDR, little endian, as rclpy does but with padding zero.

    Raises TypeError for a class with a field of type wstring.
    """
    writer = Writer()
    cls: Any = type(message)
    for step in _steps(cls):
        step(writer, message)
    return bytes(writer.data)


@cache
def _steps(cls: Any) -> tuple[_Step, ...]:
    """What serializes a message of this class, in order."""
    steps: list[_Step] = []
    row: list[tuple[str, str]] = []  # numbers that follow each other: path and format

    def end_row() -> None:
        if row:
            steps.append(_numbers(*zip(*row, strict=True)))
            row.clear()

    for path, kind in _flat_fields(cls, ''):
        if kind in FORMATS:
            row.append((path, FORMATS[kind]))
        else:
            end_row()
            steps.append(_field(attrgetter(path), kind))
    end_row()
    # A type without fields has one byte all the same.
    return tuple(steps) or (lambda writer, _: writer.data.append(0),)


def _flat_fields(cls: Any, prefix: str) -> list[tuple[str, str]]:
    """Paths and types of all fields, those of single messages in it in their place."""
    found: list[tuple[str, str]] = []
    for name, kind in fields(cls).items():
        if '/' in kind and not kind.endswith(']') and fields(inner := message_class(kind)):
            found += _flat_fields(inner, f'{prefix}{name}.')
        else:
            found.append((prefix + name, kind))
    return found


def _numbers(paths: tuple[str, ...], formats: tuple[str, ...]) -> _Step:
    """Append the numbers at these paths of a message, each aligned to its size."""
    values = attrgetter(*paths)
    # Where padding is depends on the place, modulo 8 bytes, at which the row begins.
    layouts = []
    for start in range(ALIGNMENT):
        place, layout = start, '<'
        for one in formats:
            size = struct.calcsize(f'<{one}')
            layout += f'{-place % size}x{one}'
            place += -place % size + size
        layouts.append(struct.Struct(layout).pack)

    def append(writer: Writer, message: Any) -> None:
        found = values(message) if len(paths) > 1 else (values(message),)
        writer.data += layouts[(len(writer.data) - HEAD) % ALIGNMENT](*found)

    return append


def _field(value: Callable[[Any], Any], kind: str) -> _Step:
    """Append one field that is no number."""
    if array := ARRAY.fullmatch(kind):
        item, bound, size = array.groups()
        return _array(value, item, is_counted=bool(bound or not size))
    if kind.startswith('string'):
        return lambda writer, message: writer.string(value(message))
    if kind == 'byte':
        return lambda writer, message: writer.data.extend(value(message))
    if '/' in kind:
        inner = _steps(message_class(kind))

        def append(writer: Writer, message: Any) -> None:
            for step in inner:
                step(writer, value(message))

        return append
    raise TypeError(f'a field of type {kind} cannot be written to a bag; use another type')


def _array(value: Callable[[Any], Any], item: str, is_counted: bool) -> _Step:
    """Append an array or sequence of items of this type; of a sequence first how many."""
    if item in FORMATS:
        kind = np.dtype(f'<{FORMATS[item]}')

        def append(writer: Writer, message: Any) -> None:
            found = np.asarray(value(message), kind)
            if is_counted:
                writer.pack('I', len(found))
            if len(found):
                writer.align(kind.itemsize)
                writer.data += found.tobytes()

        return append
    one = _field(lambda found: found, item)

    def append_each(writer: Writer, message: Any) -> None:
        found = value(message)
        if is_counted:
            writer.pack('I', len(found))
        for each in found:
            one(writer, each)

    return append_each
