"""
Result messages as bytes: what rclpy would send, made without its objects.

All results but drawings and diagnostics are a header and then doubles, so those of many instants
are rows of one array. The bytes are plain CDR, little endian, padding zero: equal results are
equal bytes.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from kinpole_ros.messages._cdr_writer import HEAD, SECOND, TIME, Writer
from kinpole_ros.messages._types import DiagnosticArray


def stamped_doubles(
    stamps: np.ndarray,
    frame_id: str,
    figures: np.ndarray,
    child: str | None = None,
    listed: bool = False,
) -> list[bytes]:
    """
    Messages of a header and doubles, one of each row of `figures` (T, n); `stamps` (T,) in ns.

    `child` is the second string of those that have one: Odometry's child_frame_id. If `listed`
    the message is a list, and that is all that is in it, as in TFMessage.
    """
    head = _head(frame_id, child, listed)
    first = HEAD + 4 * listed
    doubles = figures.astype('<f8', copy=False)
    rows = np.empty((len(doubles), len(head) + doubles.strides[0]), np.uint8)
    rows[:, : len(head)] = np.frombuffer(head, np.uint8)
    rows[:, first : first + TIME.size] = _times(stamps)
    rows[:, len(head) :] = doubles.view(np.uint8)
    return rows_of_bytes(rows)


def joint_data(
    stamps: np.ndarray, names: Sequence[str], positions: np.ndarray, velocities: np.ndarray
) -> list[bytes]:
    """A sensor_msgs/JointState of each of `stamps` (T,), of n joints; figures are (T, n)."""
    writer, zero, places = Writer(), np.zeros(len(names)), []
    writer.header(0, '')
    writer.pack('I', len(names))
    for name in names:
        writer.string(name)
    for _ in (positions, velocities):
        writer.pack('I', len(names))
        writer.doubles(zero)
        places.append(slice(len(writer.data) - zero.nbytes, len(writer.data)))
    # No efforts, but where they would begin.
    writer.pack('I', 0)
    writer.align(8)
    rows = np.tile(np.frombuffer(bytes(writer.data), np.uint8), (len(stamps), 1))
    rows[:, HEAD : HEAD + TIME.size] = _times(stamps)
    for place, figures in zip(places, (positions, velocities), strict=True):
        rows[:, place] = np.ascontiguousarray(figures, '<f8').view(np.uint8)
    return rows_of_bytes(rows)


def rows_of_bytes(rows: np.ndarray) -> list[bytes]:
    """Rows (T, n) of bytes or doubles one by one."""
    data, size = rows.tobytes(), rows.shape[1] * rows.itemsize
    return [data[first : first + size] for first in range(0, len(data), size)]


def path(stamp: int, frame_id: str, stamps: np.ndarray, positions: np.ndarray) -> bytes:
    """A nav_msgs/Path of poses at `stamps` (n,) and positions (n, 3), not turned."""
    writer = Writer()
    writer.header(stamp, frame_id)
    writer.pack('I', len(stamps))
    poses = np.zeros((len(stamps), 7))
    poses[:, :3] = positions
    poses[:, 6] = 1.0
    # The first pose may begin amid eight bytes, all others follow on doubles.
    writer.header(int(stamps[0]), frame_id)
    writer.doubles(poses[0])
    head = _head(frame_id, None)[HEAD:]
    rows = np.empty((len(stamps) - 1, len(head) + 56), np.uint8)
    rows[:, : len(head)] = np.frombuffer(head, np.uint8)
    rows[:, : TIME.size] = _times(stamps[1:])
    rows[:, len(head) :] = poses[1:].astype('<f8').view(np.uint8)
    return bytes(writer.data + rows.tobytes())


def diagnostics_data(array: DiagnosticArray) -> bytes:
    """What rclpy makes of diagnostics, which leaves the padding to chance."""
    writer = Writer()
    stamp = array.header.stamp
    writer.header(stamp.sec * SECOND + stamp.nanosec, array.header.frame_id)
    writer.pack('I', len(array.status))
    for status in array.status:
        level = status.level
        writer.data += bytes((level,)) if isinstance(level, int) else level
        for text in (status.name, status.message, status.hardware_id):
            writer.string(text)
        writer.pack('I', len(status.values))
        for pair in status.values:
            writer.string(pair.key)
            writer.string(pair.value)
    return bytes(writer.data)


def _times(stamps: np.ndarray) -> np.ndarray:
    """The bytes (T, 8) of stamps in ns."""
    times = np.empty((len(stamps), 2), '<u4')
    times[:, 0], times[:, 1] = np.divmod(stamps, SECOND)
    return times.view(np.uint8)


# As many as there are frames of bodies: most topics of an instant share one.
@lru_cache(maxsize=128)
def stamped_head(stamp: int, frame_id: str, child: str | None, listed: bool) -> bytes:
    """All before the doubles of a message, as in `stamped_doubles`; `stamp` in ns."""
    head, first = _head(frame_id, child, listed), HEAD + 4 * listed
    return head[:first] + TIME.pack(*divmod(stamp, SECOND)) + head[first + TIME.size :]


# As many as there are frames of bodies, and of what moves them.
@lru_cache(maxsize=256)
def _head(frame_id: str, child: str | None, listed: bool = False) -> bytes:
    """All before the doubles, with the stamp 0."""
    writer = Writer()
    if listed:
        writer.pack('I', 1)
    writer.header(0, frame_id)
    if child is not None:
        writer.string(child)
    writer.align(8)
    return bytes(writer.data)
