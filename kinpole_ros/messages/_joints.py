"""What robot stacks read: states of joints between bodies."""

from collections.abc import Mapping, Sequence
from ctypes import byref
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import Joints, Motion, address_of, library
from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.settings import GROUND
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import KNOWN

_MAX_AHEAD = 0.25  # of its window: how far from an instant a state is extrapolated
# Bytes of a message without joints; of the name, the states and the memory for them of each.
_BYTES, _BYTES_OF_JOINT = 64, 48


class _Joints(Joints):
    """`Joints` of messages.h."""

    def __init__(
        self, joints: Mapping[str, tuple[str, str]], bodies: Sequence[str], is_deviation: bool
    ) -> None:
        number = {GROUND: -1} | {body: b for b, body in enumerate(bodies)}
        names = [name.encode() + b'\0' for name in joints]
        arrays = {
            'first_body': np.array([number[first] for first, _ in joints.values()]),
            'second_body': np.array([number[second] for _, second in joints.values()]),
            'ends': np.cumsum([0, *map(len, names)]),
            'names': np.frombuffer(b''.join(names), np.uint8),
        }
        size = _BYTES + _BYTES_OF_JOINT * len(joints) + len(arrays['names'])
        super().__init__(
            joints=len(joints), bodies=len(bodies), is_deviation=is_deviation, message_bytes=size
        )
        for name, array in arrays.items():
            self.bind(name, array)

    def write(self, motion: Motion, stamps: np.ndarray, nearest: np.ndarray) -> list[bytes]:
        """Return the messages of `stamps`, by `nearest` instants; b'' without known joints."""
        if motion.shape[1] != self.bodies or motion.orders < 2:
            raise ValueError(f'expected rates of {self.bodies} bodies, got {motion.shape}')
        count, size = len(stamps), self.message_bytes
        out, lengths = np.empty(count * size, np.uint8), np.empty(count, np.int64)
        given = address_of(stamps), address_of(nearest), count
        into = address_of(out), address_of(lengths)
        library.kinpole_write_joints(byref(motion), byref(self), *given, *into)
        data = out.tobytes()
        return [data[k * size : k * size + length] for k, length in enumerate(lengths.tolist())]


class _Last(NamedTuple):
    """The last instant of a motion: its stamp, and how far from it states go, ns."""

    run: int
    motion: Motion
    stamp: int
    reach: float


def joint_states(
    joints: Mapping[str, tuple[str, str]], bodies: Sequence[str], rate: float, deviation: bool
) -> Build:
    """
    Return a function that makes angles and rates of joints, or their standard deviations.

    A joint is that of its second body against its first. A message has the joints whose bodies are
    determined, at each instant; with a `rate`, Hz, at multiples of its period by the stamps, by the
    derivatives at the nearest instant. Angles, rad, are within half a turn. They are 0 where the
    axes of the bodies' frames are parallel; those of a body without a given shape are parallel to
    the axes of the ground where it is first seen.
    """
    compiled = _Joints(joints, bodies, deviation)
    last: _Last | None = None

    def build(estimate: Estimate) -> Built:
        nonlocal last
        motion = estimate.compiled_motion
        if not rate:
            instants = np.arange(len(estimate))
            return _without_empty(instants, compiled.write(motion, estimate.stamp, instants))
        stamps, reaches = estimate.stamp.tolist(), _reaches(estimate)
        before = last if last is not None and last.run == estimate.run else None
        last = _Last(estimate.run, motion, stamps[-1], reaches[-1])
        if before is not None:
            stamps, reaches = [before.stamp, *stamps], [before.reach, *reaches]
        rows, nearest, instants = _even_stamps(stamps, reaches, rate)
        data = []
        if before is not None:
            nearest, instants = nearest - 1, instants - 1
            early = np.count_nonzero(nearest < 0)
            at_end = np.full(early, before.motion.shape[0] - 1)
            data = compiled.write(before.motion, rows[:early], at_end)
        first = len(data)
        data += compiled.write(motion, rows[first:], nearest[first:])
        return _without_empty(instants, data)

    return build


def _without_empty(instants: np.ndarray, messages: list[bytes]) -> Built:
    found = [(k, data) for k, data in zip(instants.tolist(), messages, strict=True) if data]
    return [k for k, _ in found], [data for _, data in found]


def _reaches(estimate: Estimate) -> list[float]:
    """Return how far from each instant states are extrapolated, ns."""
    spans = np.where(estimate.reason == KNOWN, estimate.span, 0.0)
    reaches: list[float] = (np.nan_to_num(spans).max(axis=1) * 1e9 * _MAX_AHEAD).tolist()
    return reaches


def _even_stamps(
    stamps: list[int], reaches: list[float], rate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return stamps (G,), ns, at multiples of the period from the first instant to the last.

    Also the index of the nearest instant of each, and of the first one at it or after it. There is
    no stamp farther from an instant than its reach.
    """
    exact = Fraction(rate).limit_denominator(10**6)
    count, period = exact.numerator, exact.denominator * 10**9
    rows: list[tuple[int, int, int]] = []
    for k, (start, end) in enumerate(pairwise(stamps), 1):
        after_start = min(end, start + int(reaches[k - 1]))
        before_end = max(start, after_start, end - int(reaches[k]))
        for first, last in ((start, after_start), (before_end, end)):
            for n in range(first * count // period + 1, last * count // period + 1):
                stamp = (2 * n * period + count) // (2 * count)
                rows.append((stamp, k - (stamp - start <= end - stamp), k))
    found = np.array(rows, np.int64).reshape(-1, 3)
    return tuple(np.ascontiguousarray(found.T))
