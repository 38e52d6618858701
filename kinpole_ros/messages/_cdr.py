"""
The bytes of messages: plain CDR, the encoding of ROS 2, with zeros in the padding.

Four bytes name the encoding and byte order. The fields follow, each aligned to its size, counted
from behind these four bytes.
"""

import struct
from collections.abc import Mapping

import numpy as np

from kinpole_ros.messages._types import SECOND

HEAD = 4  # bytes before the first field
LITTLE = b'\x00\x01'  # the first two bytes of a little endian message
TIME = struct.Struct('<iI')  # a stamp: s and ns
_SIZES = {1: 1, 2: 1, 8: 8}  # bytes: INT8, UINT8 and FLOAT64 of PointField; others in use have 4
ALIGNMENT = 8  # bytes: no field is aligned to more


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

        `kinds` are the data types of its fields. Returns the size of the data in bytes.
        """
        self.pack('III', 1, points, len(kinds))
        offsets, size = field_offsets(kinds)
        for (name, kind), offset in zip(kinds.items(), offsets, strict=True):
            self.string(name)
            self.pack('I', offset)
            self.data += bytes((kind,))
            self.pack('I', 1)
        self.data += b'\0'  # little endian
        self.pack('III', size, size * points, size * points)
        return size * points

    def doubles(self, values: np.ndarray) -> None:
        if values.size:
            self.align(8)
            self.data += values.astype('<f8').tobytes()


def stamp_bytes(stamps: np.ndarray) -> np.ndarray:
    """The bytes (T, 8) of stamps (T,) in ns."""
    times = np.empty((len(stamps), 2), '<u4')
    times[:, 0], times[:, 1] = np.divmod(stamps, SECOND)
    return times.view(np.uint8)


def field_offsets(kinds: Mapping[str, int]) -> tuple[list[int], int]:
    """
    Return where the fields of a point begin, and the size of a point, a multiple of 8, in bytes.

    `kinds` are their data types; each begins at the next multiple of its size.
    """
    offsets, end = [], 0
    for kind in kinds.values():
        size = _SIZES.get(kind, 4)
        offsets.append(end + -end % size)
        end = offsets[-1] + size
    return offsets, end + -end % 8
