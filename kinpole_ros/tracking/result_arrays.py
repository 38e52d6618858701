"""The arrays of results, which C fills, and the estimate that they make."""

from collections.abc import Sequence
from ctypes import addressof
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import Motion, pass_new_array
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.events import BodyEvent
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.rejection import REASONS_OF_MARKERS, REASONS_OF_POSES
from kinpole_ros.tracking.result_layout import FILLED, INSTANT_AXIS, ArrayPart, layout_of
from kinpole_ros.tracking.values import FramePoses


class Results(NamedTuple):
    """
    The results of up to so many instants, of bodies with some markers, as follow.c fills them.

    Attributes
    ----------
    fields : (n,) int64
        Those of `Results` of frames.h: the number of instants that there is memory for, how many
        have results, the fewest samples of a window, how many results are of deformed bodies, and
        where the arrays begin.
    layout : dict of str to Part
        Where each array is in the buffer.
    buffer : ndarray
        All arrays, from `address` on.
    of_motion : (m,) int64
        Where the arrays of `Motion` are in the buffer.
    instants, orders, bodies : int
        Sizes of the arrays.

    """

    fields: np.ndarray
    layout: dict[str, ArrayPart]
    buffer: np.ndarray
    address: int
    of_motion: np.ndarray
    instants: int
    orders: int
    bodies: int

    @property
    def filled(self) -> int:
        """How many instants have results."""
        return int(self.fields[FILLED])

    def array(self, name: str) -> np.ndarray:
        """Return an array, of all instants that there is memory for."""
        shape, dtype, offset = self.layout[name]
        return np.ndarray(shape, dtype, self.buffer, offset)

    def column(self, name: str) -> np.ndarray:
        """Return an array, of the instants that have results."""
        array, count = self.array(name), self.filled
        if count == self.instants:
            return array
        return array[(slice(None),) * INSTANT_AXIS.get(name, 0) + (slice(count),)]

    def motion(self) -> Motion:
        """Return the motion of the instants that have results."""
        count = self.filled
        numbers = count * self.bodies, self.instants * self.bodies, self.orders
        fields = np.empty(len(numbers) + len(self.of_motion), np.int64)
        fields[: len(numbers)] = numbers
        np.add(self.of_motion, self.address, out=fields[len(numbers) :])
        motion = Motion.from_buffer(fields)
        motion.shape, motion.owners = (count, self.bodies), [self.buffer]
        return motion


def new_results(instants: int, orders: int, bodies: int, markers: int) -> Results:
    """Return memory for the results of so many instants, with derivatives of so many `orders`."""
    layout, offsets, of_motion, size = layout_of(instants, orders, bodies, markers)
    numbers = instants, 0, FEWEST_SAMPLES, 0
    fields = np.empty(len(numbers) + len(offsets), np.int64)
    fields[: len(numbers)] = numbers
    buffer = np.empty(size, np.uint8)
    address = addressof(pass_new_array(buffer))
    np.add(offsets, address, out=fields[len(numbers) :])
    return Results(fields, layout, buffer, address, of_motion, instants, orders, bodies)


def estimate_of(
    parts: Sequence[tuple[Results, np.ndarray]],
    frame_id: str,
    bodies: tuple[str, ...],
    run: int,
    plane: Plane | None,
    are_measured: bool,
    events: tuple[BodyEvent, ...] = (),
) -> Estimate:
    """
    Return results, of one instant after the other, as one estimate.

    Each of the `parts` is with the numbers of the frames of which `due` counts.
    """
    results = [part for part, _ in parts]
    for part, numbers in parts:
        due = part.column('due')
        due[:] = numbers[due]

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
        reasons = (REASONS_OF_POSES if are_measured else REASONS_OF_MARKERS)[stored('reason')]
        if plane is None:
            reasons[...] = 'plane not known yet'
        return reasons

    def frame_poses() -> FramePoses:
        turned, placed = stored('information').swapaxes(0, 1)
        return FramePoses(
            angle=stored('frame_angle'),
            position=stored('frame_position'),
            angle_information=turned,
            position_information=placed,
            middle=stored('middle'),
            noise=stored('noise'),
        )

    estimate = Estimate(column, frame_id, bodies, run, plane, frame_poses, events)
    if len(results) == 1:
        estimate.compiled_motion = results[0].motion()
    return estimate
