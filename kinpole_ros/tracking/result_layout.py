"""Where the arrays of results are in their buffer, which C fills."""

import math
from ctypes import c_longlong, sizeof
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core import bindings

# Which axis of each array is that of the instants.
INSTANT_AXIS = {
    **dict.fromkeys(('position_covariance', 'angle_covariance'), 2),
    **dict.fromkeys(('position', 'angle'), 1),
}


class ArrayPart(NamedTuple):
    """Where an array is in the buffer of results."""

    shape: tuple[int, ...]
    dtype: Any
    offset: int


# Where `fields` has the number of results, and of those of deformed bodies.
COUNT, DEFORMED = (
    field.offset // sizeof(c_longlong)
    for field in (bindings.Results.count, bindings.Results.deformed)
)
# The arrays that C fills, of which the first of the derivatives stands for all of them.
_FIELDS = tuple('position' if name == 'derivatives' else name for name in bindings.Results.elements)


@lru_cache(maxsize=64)
def layout_of(
    instants: int, orders: int, bodies: int, markers: int
) -> tuple[dict[str, ArrayPart], np.ndarray, np.ndarray, int]:
    """Where the arrays of results, and the fields of C and of `Motion` are; the size of all."""
    each, square = (instants, bodies), (orders, orders, instants, bodies)
    arrays: dict[str, tuple[tuple[int, ...], Any]] = {
        'stamp': ((instants,), np.int64),
        'due': ((instants,), np.int64),
        'rows': ((instants, 3), np.int64),
        # From here to `freedom`: derivatives as `derive_poses` has them.
        'position': ((orders, *each), complex),
        'angle': ((orders, *each), float),
        'position_covariance': (square, float),
        'angle_covariance': (square, float),
        'span': (each, float),
        'freedom': (each, float),
        **dict.fromkeys(('size', 'height', 'pin_variance', 'frame_angle'), (each, float)),
        'information': ((instants, 2, bodies), float),
        'noise': (each, float),
        'pin': (each, complex),
        'shape': ((*each, markers), complex),
        **dict.fromkeys(('reference', 'frame_position', 'middle'), (each, complex)),
        'reason': (each, np.uint8),
    }
    layout, offset = {}, 0
    for name, (shape, dtype) in arrays.items():
        layout[name] = ArrayPart(shape, dtype, offset)
        offset += math.prod(shape) * np.dtype(dtype).itemsize
    of_fields, of_motion = (
        np.array([layout[name].offset for name in names])
        for names in (_FIELDS, bindings.Motion.elements)
    )
    return layout, of_fields, of_motion, offset
