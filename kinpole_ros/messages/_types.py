"""
Message classes and their bytes, with ROS or without: rclpy's where it is there, else rosbags'.

All outside of ros/ takes them from here, so nothing but the live node needs ROS.
"""

from typing import TYPE_CHECKING

try:
    from rclpy.serialization import deserialize_message

    WITH_ROS = True
# A ROS of another Python is none either.
except ImportError:
    from kinpole_ros.messages._rosbags import deserialize_message

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
    from kinpole_ros.messages._serialize import serialize_message
else:
    from kinpole_ros.messages._rosbags import (
        WITH_TF,
        ColorRGBA,
        DiagnosticArray,
        DiagnosticStatus,
        Header,
        JointState,
        KeyValue,
        Marker,
        MarkerArray,
        Odometry,
        Path,
        Point,
        PointCloud2,
        PointField,
        PointStamped,
        Pose,
        PoseArray,
        PoseStamped,
        PoseWithCovarianceStamped,
        String,
        TFMessage,
        Time,
        Vector3,
        Vector3Stamped,
        WrenchStamped,
        constants,
        fields,
        message_class,
        octets,
        serialize_message,
        type_name,
    )

__all__ = [
    'WITH_ROS',
    'WITH_TF',
    'ColorRGBA',
    'DiagnosticArray',
    'DiagnosticStatus',
    'Header',
    'JointState',
    'KeyValue',
    'Marker',
    'MarkerArray',
    'Odometry',
    'Path',
    'Point',
    'PointCloud2',
    'PointField',
    'PointStamped',
    'Pose',
    'PoseArray',
    'PoseStamped',
    'PoseWithCovarianceStamped',
    'String',
    'TFMessage',
    'Time',
    'Vector3',
    'Vector3Stamped',
    'WrenchStamped',
    'constants',
    'deserialize_message',
    'fields',
    'message_class',
    'octets',
    'serialize_message',
    'type_name',
]
