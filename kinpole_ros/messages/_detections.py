"""Detections of AprilTags, in pixels, as `apriltag_ros` publishes them."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._types import deserialize_message, message_class, stamp_to_ns

DETECTIONS = 'apriltag_msgs/msg/AprilTagDetectionArray'
# The detector counts corners the other way round than OpenCV, whose tags are upside down besides.
_ORDER = [1, 0, 3, 2]


class Detections(NamedTuple):
    """
    The tags in a picture, each once: its stamp, ns, numbers, and corners (n, 4, 2), pixels.

    The corners are in the order of OpenCV, and centers of pixels at whole numbers.
    """

    stamp: int
    tags: list[int]
    corners: np.ndarray
    family: str


def read_detections(data: bytes) -> Detections:
    """
    Read an apriltag_msgs/msg/AprilTagDetectionArray.

    Parameters
    ----------
    data : bytes
        The message in CDR.

    Returns
    -------
    Detections
        Tags that are seen twice are left out, as it is not known which one is on a link.

    Raises
    ------
    MessageError
        For other data.
    """
    message = deserialize_message(data, message_class(DETECTIONS))
    numbers = [one.id for one in message.detections]
    once = [one for one in message.detections if numbers.count(one.id) == 1]
    corners = np.array([one.corners for one in once], float).reshape(-1, 4, 2)
    return Detections(
        stamp_to_ns(message.header.stamp),
        [one.id for one in once],
        corners[:, _ORDER] - 0.5,
        once[0].family if once else '',
    )
