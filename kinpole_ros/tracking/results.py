"""What the window of frames says of some instants: arrays that the compiled part fills."""

import math
from collections.abc import Sequence
from ctypes import addressof
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.compiled import pass_new_array
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.deformation import deformation_covariance, hold_hidden
from kinpole_ros.tracking.estimate import INSTANT_AXIS, Estimate, FramePoses
from kinpole_ros.tracking.events import BodyEvent
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.quantities import ARRAYS, Motion
from kinpole_ros.tracking.rejection import REASONS, REASONS_OF_MARKERS, REASONS_OF_POSES

class _Part(NamedTuple):
    """Where an array is in the buffer of results."""

    shape: tuple[int, ...]
    dtype: Any
    offset: int


# Where `fields` has the number of results, and of those of deformed bodies.
COUNT, DEFORMED = 1, 3
# Where the arrays that C fills begin, in the order of the fields of `Results` of _follow.c.
_FIELDS = (
    *('stamp', 'due', 'rows', 'position', 'size', 'height', 'pin_variance', 'frame_angle', 'information'),
    *('noise', 'pin', 'shape', 'reference', 'frame_position', 'middle', 'reason'),
)


@lru_cache(maxsize=64)
def _layout_of(
    instants: int, orders: int, bodies: int, markers: int
) -> tuple[dict[str, _Part], np.ndarray, np.ndarray, int]:
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
        layout[name] = _Part(shape, dtype, offset)
        offset += math.prod(shape) * np.dtype(dtype).itemsize
    of_fields, of_motion = (
        np.array([layout[name].offset for name in names]) for names in (_FIELDS, ARRAYS)
    )
    return layout, of_fields, of_motion, offset


class Results:
    """
    The results of up to so many instants, of bodies with some markers, as _follow.c fills them.

    `fields` are those of `Results` there: the number of instants that there is memory for, how many
    have results, the fewest samples of a window, how many results are of deformed bodies, and where
    the arrays begin.
    """

    def __init__(self, instants: int, orders: int, bodies: int, markers: int) -> None:
        self.instants, self.orders, self._bodies = instants, orders, bodies
        self._layout, offsets, self._of_motion, size = _layout_of(instants, orders, bodies, markers)
        self._buffer = np.empty(size, np.uint8)
        self.fields = np.empty(4 + len(offsets), np.int64)
        self.fields[:4] = instants, 0, FEWEST_SAMPLES, 0
        self._address = addressof(pass_new_array(self._buffer))
        np.add(offsets, self._address, out=self.fields[4:])

    @property
    def count(self) -> int:
        """How many instants have results."""
        return int(self.fields[COUNT])

    def array(self, name: str) -> np.ndarray:
        """Return an array, of all instants that there is memory for."""
        shape, dtype, offset = self._layout[name]
        return np.ndarray(shape, dtype, self._buffer, offset)

    def column(self, name: str) -> np.ndarray:
        """Return an array, of the instants that have results."""
        array, count = self.array(name), self.count
        if count == self.instants:
            return array
        return array[(slice(None),) * INSTANT_AXIS.get(name, 0) + (slice(count),)]

    def motion(self) -> Motion:
        """Return the motion of the instants that have results."""
        count = self.count
        fields = np.empty(3 + len(self._of_motion), np.int64)
        fields[:3] = count * self._bodies, self.instants * self._bodies, self.orders
        np.add(self._of_motion, self._address, out=fields[3:])
        return Motion.of_fields(fields, (count, self._bodies), self._buffer)


def add_deformation(results: Results, first: int, bodies: Bodies, history: History) -> None:
    """Add to the covariances of the results from `first` on what the deformation of bodies adds."""
    for t in range(first, results.count):
        usable = results.array('reason')[t] == REASONS['KNOWN']
        for b in np.flatnonzero(usable & (bodies.freedom > 0)).tolist():
            _add_deformation_of(results, t, bodies, b, history)


def _add_deformation_of(
    results: Results, t: int, bodies: Bodies, b: int, history: History
) -> None:
    """Add to the covariances of a body at an instant what its deformation adds."""
    now, oldest, newest = results.array('rows')[t].tolist()
    time = history['time']
    interval = int(time[newest] - time[oldest]) / max(newest - oldest, 1) * 1e-9
    first = max(0, oldest - (newest + 1 - oldest))
    residual = hold_hidden(history['residual'][first : newest + 1, b : b + 1])[:, 0]
    slow = deformation_covariance(
        residual,
        now - first,
        oldest - first,
        interval,
        float(results.array('span')[t, b]),
        float(results.array('freedom')[t, b]) - 1,
        float(bodies.white[b] * np.sqrt(bodies.hidden_factor[b])),
        float(bodies.freedom[b]),
        results.orders - 1,
    )
    turned, placed = results.array('information')[t, :, b]
    results.array('angle_covariance')[:, :, t, b] += slow / turned
    hub = results.array('reference')[t, b]
    spread = _spread_at(hub, bodies.fitting.middle[b], turned, placed)
    results.array('position_covariance')[:, :, t, b] += slow * spread


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
    events: tuple[BodyEvent, ...] = (),
) -> Estimate:
    """Return results, of one instant after the other, as one estimate."""

    def stored(name: str) -> np.ndarray:
        axis = INSTANT_AXIS.get(name, 0)
        return np.concatenate([part.column(name) for part in results], axis)

    if len(results) == 1:
        stored = results[0].column

    def column(name: str) -> np.ndarray:
        if name == 'degree':
            return stored('freedom') - 1
        if name != 'missing':
            return stored(name)
        reasons = (REASONS_OF_POSES if posed else REASONS_OF_MARKERS)[stored('reason')]
        if plane is None:
            reasons[...] = 'plane not known yet'
        return reasons

    def frame_poses() -> FramePoses:
        turned, placed = stored('information').swapaxes(0, 1)
        names = ('frame_angle', 'frame_position', 'middle', 'noise')
        angle, position, middle, noise = map(stored, names)
        return FramePoses(angle, position, turned, placed, middle, noise)

    estimate = Estimate(column, frame_id, bodies, run, plane, frame_poses, events)
    if len(results) == 1:
        estimate.compiled_motion = results[0].motion()
    return estimate
