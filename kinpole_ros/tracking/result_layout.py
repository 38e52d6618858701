"""Where the arrays of results are in their buffer, which C fills."""

import math
from ctypes import c_longlong, sizeof
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import DerivativeArrays, Motion, Results

# The arrays that C fills, in the order of the fields of `Results`.
_SHAPES = {**DerivativeArrays.shapes, **Results.shapes}
# Which axis of each array is that of the instants.
INSTANT_AXIS = {name: shape.index('T') for name, shape in _SHAPES.items()}


class ArrayPart(NamedTuple):
    """Where an array is in the buffer of results."""

    shape: tuple[int, ...]
    dtype: Any
    offset: int


# Where `fields` has the number of results, and of those of deformed bodies.
FILLED, DEFORMED = (
    field.offset // sizeof(c_longlong) for field in (Results.filled, Results.deformed)
)


@lru_cache(maxsize=64)
def layout_of(
    instants: int, orders: int, bodies: int, markers: int
) -> tuple[dict[str, ArrayPart], np.ndarray, np.ndarray, int]:
    """Where the arrays of results, and the fields of C and of `Motion` are; the size of all."""
    sizes = {'T': instants, 'K': orders, 'B': bodies, 'n': markers}
    layout, offset = {}, 0
    for struct in (DerivativeArrays, Results):
        for name, shape in struct.shapes_for(**sizes).items():
            dtype = struct.elements[name]
            layout[name] = ArrayPart(shape, dtype, offset)
            offset += math.prod(shape) * dtype.itemsize
    of_fields, of_motion = (
        np.array([layout[name].offset for name in names]) for names in (_SHAPES, Motion.elements)
    )
    return layout, of_fields, of_motion, offset
