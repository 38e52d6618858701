"""Fields of a message, written one after the other as plain CDR."""

import re
import struct

import numpy as np

# Bytes before the fields, of which the first two tell the byte order.
HEAD = 4
LITTLE = b'\x00\x01'
SECOND = 1_000_000_000  # ns
# Formats, as `struct` and numpy name them, of the types that .msg files call so.
FORMATS = {
    'bool': '?',
    'char': 'B',
    'int8': 'b',
    'uint8': 'B',
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'float32': 'f',
    'float64': 'd',
}
ALIGNMENT = 8  # bytes: no field is aligned to more
ARRAY = re.compile(r'(.+?)\[(<=)?(\d*)\]')  # its items, and how many, if not any number
TIME = struct.Struct('<iI')  # a stamp: s and ns


class Writer:
    """Fields one after the other, each aligned to its size, in `data`."""

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

    def doubles(self, values: np.ndarray) -> None:
        if values.size:
            self.align(8)
            self.data += values.astype('<f8').tobytes()
