"""
Message classes, their types by name, and stamps, with ROS or without.

Where rclpy is installed the classes are its own, else those of rosbags. All outside of `ros/` takes
them from here, so only the live node needs ROS.
"""

# ruff: noqa: F401, F403
from typing import TYPE_CHECKING

from kinpole_ros.settings import MESSAGE_TYPES

try:
    from rclpy.serialization import deserialize_message, serialize_message

    WITH_ROS = True
except ImportError:  # also for the rclpy of another Python version
    WITH_ROS = False

if WITH_ROS or TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from geometry_msgs.msg import (
        Point,
        PointStamped,
        Pose,
        PoseArray,
        PoseStamped,
        PoseWithCovarianceStamped,
        Vector3,
        Vector3Stamped,
        WrenchStamped,
    )
    from nav_msgs.msg import Odometry, Path
    from sensor_msgs.msg import JointState, PointCloud2, PointField
    from std_msgs.msg import ColorRGBA, Header, String
    from visualization_msgs.msg import Marker, MarkerArray

    from kinpole_ros.messages._rosidl import (
        WITH_TF,
        TFMessage,
        constants,
        fields,
        message_class,
        octets,
        type_name,
    )
else:
    from kinpole_ros.messages._rosbags import *

MARKER_TYPES: dict[str, type] = {
    'marker_array': MarkerArray,
    'marker': Marker,
    'pose_array': PoseArray,
    'point_cloud2': PointCloud2,
}
# The types that can be written too: messages of markers, and of poses of bodies.
INPUT_TYPES: dict[str, type] = {
    **MARKER_TYPES,
    'pose_stamped': PoseStamped,
    'body_poses': PoseArray,
    'tf': TFMessage,
}
INPUT_TYPE_NAMES = {kind: row.type_name for kind, row in MESSAGE_TYPES.items()}
ROS_TYPE_NAMES = {kind: row.type_name for kind, row in MESSAGE_TYPES.items() if not row.has_poses}
SECOND = 1_000_000_000  # ns
END_OF_TIME = 2**31 * SECOND  # ns: the first stamp that a ROS time cannot hold


class MessageError(ValueError):
    """A message that cannot be read; the text names the field and says how to fix it."""


def stamp_to_ns(stamp: 'Time') -> int:
    """
    Return a stamp as an exact number.

    Parameters
    ----------
    stamp : Time
        A builtin_interfaces Time.

    Returns
    -------
    int
        The stamp, ns.
    """
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def ns_to_stamp(ns: int) -> 'Time':
    """
    Make a stamp of a number.

    Parameters
    ----------
    ns : int
        The stamp, ns.

    Returns
    -------
    Time
        A builtin_interfaces Time.

    Raises
    ------
    ValueError
        Outside of what it holds, the years 1970 to 2038.
    """
    sec, nanosec = divmod(int(ns), SECOND)
    if not 0 <= ns < END_OF_TIME:
        raise ValueError(f'stamp {ns} ns is out of range: a ROS time holds 0 to 2^31 s')
    return Time(sec=sec, nanosec=nanosec)
