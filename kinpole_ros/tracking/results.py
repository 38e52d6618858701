"""What the window of frames says of some instants: arrays that the compiled part fills."""

import math
from collections.abc import Sequence
from ctypes import Structure, c_longlong, c_void_p
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.deformation import deformation_covariance, hold_hidden
from kinpole_ros.tracking.estimate import Estimate, FramePoses
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.plane import Plane

# Why a body has no result, by the numbers of _follow.c, of markers and of poses.
_COMMON = '', 'window not full'
_OF_MARKERS = np.array(
    [
        *_COMMON,
        'markers too close together for their noise',
        'noise not known yet',
        'too few markers seen, or all at one place',
    ],
    object,
)
_OF_POSES = np.array(
    [
        *_COMMON,
        'the noise of its angle is too large',
        'noise not known yet',
        'no pose of it came',
    ],
    object,
)
# The numbers of two of them.
TOO_NOISY, NOISE_UNKNOWN = 2, 3


class _Part(NamedTuple):
    """Where an array is in the buffer of results."""

    shape: tuple[int, ...]
    dtype: Any
    offset: int


@lru_cache(maxsize=64)
def _layout_of(instants: int, orders: int, bodies: int, markers: int) -> dict[str, _Part]:
    """Where the arrays of results are, in the order of the fields; `end` is behind them."""
    each = instants, bodies
    arrays: dict[str, tuple[tuple[int, ...], Any]] = {
        'stamp': ((instants,), np.int64),
        'due': ((instants,), np.int64),
        'derivatives': ((3 * orders + 2 * orders**2 + 2, *each), float),
        **dict.fromkeys(('size', 'height', 'pin_variance', 'angle'), (each, float)),
        'information': ((instants, 2, bodies), float),
        'noise': (each, float),
        'pin': (each, complex),
        'shape': ((*each, markers), complex),
        **dict.fromkeys(('reference', 'position', 'middle'), (each, complex)),
        'missing': (each, np.uint8),
        'end': ((0,), np.uint8),
    }
    layout, offset = {}, 0
    for name, (shape, dtype) in arrays.items():
        layout[name] = _Part(shape, dtype, offset)
        offset += math.prod(shape) * np.dtype(dtype).itemsize
    return layout


class Results(Structure):
    """
    `Results` of _follow.c: room for the results of some instants, of bodies with some markers.

    Its arrays are attributes, as `Estimate` and `FramePoses` have them.
    """

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('instants', 'count', 'fewest')),
        *((f'_{name}', c_void_p) for name in _layout_of(1, 1, 1, 1)),
    ]

    def __init__(self, instants: int, orders: int, bodies: int, markers: int) -> None:
        layout = _layout_of(instants, orders, bodies, markers)
        buffer = np.empty(layout['end'].offset, np.uint8)
        start = buffer.__array_interface__['data'][0]
        addresses = (start + part.offset for part in layout.values())
        super().__init__(instants, 0, FEWEST_SAMPLES, *addresses)
        self.orders, self._buffer, self._layout = orders, buffer, layout

    def array(self, name: str) -> np.ndarray:
        """Return the array of a field."""
        part = self._layout[name]
        return np.ndarray(part.shape, part.dtype, self._buffer, part.offset)

    def of_instants(self, name: str) -> np.ndarray:
        """Return the array of a field, of the instants of which there are results."""
        return self.array(name)[: self.count]

    def derivatives(self) -> tuple[np.ndarray, ...]:
        """Position, angle, their covariances, span and freedom at instants: see `Derivatives`."""
        found, orders = self.array('derivatives'), self.orders
        _, instants, bodies = found.shape
        square = orders, orders, instants, bodies
        first, second = 2 * orders, 3 * orders
        third = second + orders**2
        position = found[:first].reshape(orders, instants, bodies, 2).view(complex)[..., 0]
        parts = (
            position,
            found[first:second],
            found[second:third].reshape(square),
            found[third:-2].reshape(square),
            found[-2],
            found[-1],
        )
        if self.count == instants:
            return parts
        return tuple(part[..., : self.count, :] for part in parts)


def add_deformation(
    results: Results, bodies: Bodies, history: History, now: int, oldest: int, interval: float
) -> None:
    """
    Add to the covariances of the last result what the deformation of bodies adds.

    `now` and `oldest` are rows of the history, `interval` is in s.
    """
    last, order = results.count - 1, results.orders - 1
    _, _, of_position, of_angle, span, freedom = results.derivatives()
    first = max(0, oldest - (len(history) - oldest))
    usable = results.array('missing')[last] == 0
    for b in np.flatnonzero(usable & (bodies.freedom > 0)).tolist():
        residual = hold_hidden(history['residual'][first:, b : b + 1])[:, 0]
        slow = deformation_covariance(
            residual,
            now - first,
            oldest - first,
            interval,
            float(span[last, b]),
            float(freedom[last, b]) - 1,
            float(bodies.white[b] * np.sqrt(bodies.held[b])),
            float(bodies.freedom[b]),
            order,
        )
        turned, placed = results.array('information')[last, :, b]
        of_angle[:, :, last, b] += slow / turned
        of_position[:, :, last, b] += slow * _spread_at(
            results.array('reference')[last, b], bodies.middle[b], turned, placed
        )


def _spread_at(hub: complex, middle: complex, turned: float, placed: float) -> float:
    """Variance of a point `hub` of a body; `turned` and `placed` are information of its pose."""
    if hub == 0:
        return 1 / placed
    least = max(1 / placed - abs(middle) ** 2 / turned, 0.0)
    return least + abs(hub - middle) ** 2 / turned


def estimate_of(
    results: Sequence[Results],
    frame_id: str,
    bodies: tuple[str, ...],
    run: int,
    plane: Plane | None,
    posed: bool,
) -> Estimate:
    """Join results as one estimate."""

    def joined(name: str) -> np.ndarray:
        if single is not None:
            return single.of_instants(name)
        return np.concatenate([each.of_instants(name) for each in results])

    single = results[0] if len(results) == 1 else None
    derivatives = results[0].derivatives()
    if single is None:
        every = zip(*(each.derivatives() for each in results), strict=True)
        derivatives = tuple(np.concatenate(parts, axis=-2) for parts in every)
    position, angle, position_covariance, angle_covariance, span, freedom = derivatives
    missing = (_OF_POSES if posed else _OF_MARKERS)[joined('missing')]
    if plane is None:
        missing[...] = 'plane not known yet'

    def frame_poses() -> FramePoses:
        information = joined('information')
        return FramePoses(
            joined('angle'),
            joined('position'),
            information[:, 0],
            information[:, 1],
            joined('middle'),
            joined('noise'),
        )

    return Estimate(
        joined('stamp'),
        frame_id,
        bodies,
        position,
        angle,
        position_covariance,
        angle_covariance,
        joined('size'),
        joined('height'),
        span,
        freedom - 1,
        missing,
        run,
        joined('pin'),
        joined('pin_variance'),
        joined('shape'),
        joined('due'),
        joined('reference'),
        plane,
        frame_poses,
    )
