"""The messages of a result bag as rows of numbers, and what was drawn last."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bags import Truncated, message_class, read_messages
from kinpole_ros.messages import DRAWING, deserialize_message, stamp_to_ns

_DRAWN_AS = 'visualization_msgs/msg/MarkerArray'
# The last ones that are kept: a body may be missing in some.
_DRAWINGS = 20


def _xyz(part: Any) -> list[float]:
    return [part.x, part.y, part.z]


def _odometry_row(message: Any) -> list[float]:
    """Place, turn, rate, the covariances of the three, velocity: 3 + 4 + 3 + 3 * 9 + 3 numbers."""
    pose, twist = message.pose, message.twist
    turn = pose.pose.orientation
    return [
        *_xyz(pose.pose.position),
        *_xyz(turn),
        turn.w,
        *_xyz(twist.twist.angular),
        *(pose.covariance[6 * row + column] for row in range(3) for column in range(3)),
        *(pose.covariance[6 * row + column] for row in range(3, 6) for column in range(3, 6)),
        *(twist.covariance[6 * row + column] for row in range(3, 6) for column in range(3, 6)),
        *_xyz(twist.twist.linear),
    ]


_ROWS: dict[str, Callable[[Any], list[float]]] = {
    'nav_msgs/msg/Odometry': _odometry_row,
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    'geometry_msgs/msg/PoseWithCovarianceStamped': lambda message: [
        *_xyz(message.pose.pose.position),
        *message.pose.covariance,
    ],
}


def decode(type_name: str, data: bytes) -> Any:
    """A message of a bag as an object of its type."""
    return deserialize_message(data, message_class(type_name))


def row_of(type_name: str, data: bytes) -> list[float]:
    """The figures in a message of a result; see `plane_of_motion` for those of odometry."""
    return _ROWS[type_name](decode(type_name, data))


def read_rows(
    bag: str | Path, wanted: Collection[str], progress: Callable[[float], None] | None
) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], dict[str, deque[bytes]], str]:
    """Stamps (T,) and numbers (T, ...) by topic, the last drawings, and where the bag is cut."""
    found: dict[str, dict[int, list[float]]] = {}
    drawings: dict[str, deque[bytes]] = {}
    cut = ''
    try:
        for message in read_messages(bag, wanted, progress):
            row = _ROWS.get(message.type_name)
            if message.type_name == _DRAWN_AS:
                drawings.setdefault(message.topic, deque(maxlen=_DRAWINGS)).append(message.data)
            if row is None:
                continue
            decoded = decode(message.type_name, message.data)
            # A bag played in a loop says the same of an instant again: the last word counts.
            found.setdefault(message.topic, {})[stamp_to_ns(decoded.header.stamp)] = row(decoded)
    except Truncated as error:
        cut = str(error)
    arrays = {}
    for topic, rows in found.items():
        stamp = np.fromiter(rows, np.int64, len(rows))
        order = np.argsort(stamp)
        arrays[topic] = stamp[order], np.array(list(rows.values()), float)[order]
    return arrays, drawings, cut


def outlines_of(drawings: Mapping[str, Iterable[bytes]]) -> dict[str, tuple[int, np.ndarray]]:
    """By body, with its node: the stamp of its outline as drawn last, and its markers (n, 3)."""
    found = {}
    for topic, arrays in drawings.items():
        for data in arrays:
            for marker in decode(_DRAWN_AS, data).markers:
                body, _, part = marker.ns.rpartition('/')
                if part == 'outline' and marker.points:
                    places = np.array([_xyz(point) for point in marker.points[:-1]])
                    stamp = stamp_to_ns(marker.header.stamp)
                    found[f'{topic.removesuffix(DRAWING)}{body}'] = stamp, places
    return found
