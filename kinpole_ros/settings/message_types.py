"""The types of messages with markers, or with poses of bodies: one row each."""

from typing import NamedTuple, TypeAlias

# Name of a field and its kind: int8, uint16, int32, uint32, float64, string, header, point, pose,
# covariance, or the fields of the items of a list.
Field: TypeAlias = 'tuple[str, str | tuple[Field, ...]]'


class MessageType(NamedTuple):
    """
    A type of messages.

    A type that is a header and a list of markers or bodies is read by this row alone: `before` are
    the fields between header and list, `item` are those of an item. An item has a `point` or a
    `pose`. It is called by its `name`, or by its `number` where it has no name or its `id_type` is
    1. If items have a `header`, its stamp counts. Other types have readers of their own.
    """

    type_name: str
    has_poses: bool = False
    # Whether `marker_type: auto` takes it.
    is_recognized: bool = True
    before: tuple[Field, ...] = ()
    item: tuple[Field, ...] = ()


_MOCAP4R2_MARKER: tuple[Field, ...] = (
    ('id_type', 'int8'),
    ('number', 'int32'),
    ('name', 'string'),
    ('point', 'point'),
)
MESSAGE_TYPES = {
    'marker_array': MessageType('visualization_msgs/msg/MarkerArray'),
    'marker': MessageType('visualization_msgs/msg/Marker'),
    'pose_array': MessageType('geometry_msgs/msg/PoseArray'),
    'point_cloud2': MessageType('sensor_msgs/msg/PointCloud2'),
    'mocap_markers': MessageType(
        'mocap4r2_msgs/msg/Markers', before=(('frame_number', 'uint32'),), item=_MOCAP4R2_MARKER
    ),
    'pose_stamped': MessageType('geometry_msgs/msg/PoseStamped', has_poses=True),
    'body_poses': MessageType('geometry_msgs/msg/PoseArray', has_poses=True, is_recognized=False),
    'tf': MessageType('tf2_msgs/msg/TFMessage', has_poses=True, is_recognized=False),
    'rigid_bodies': MessageType(
        'mocap4r2_msgs/msg/RigidBodies',
        has_poses=True,
        before=(('frame_number', 'uint32'),),
        item=(('name', 'string'), ('markers', _MOCAP4R2_MARKER), ('pose', 'pose')),
    ),
    'named_poses': MessageType(
        'motion_capture_tracking_interfaces/msg/NamedPoseArray',
        has_poses=True,
        item=(('name', 'string'), ('pose', 'pose')),
    ),
    'aruco': MessageType(
        'aruco_msgs/msg/MarkerArray',
        has_poses=True,
        item=(
            ('header', 'header'),
            ('number', 'uint32'),
            ('pose', 'pose'),
            ('covariance', 'covariance'),
            ('confidence', 'float64'),
        ),
    ),
    # Its driver stamps the list when it is sent, and the items with the time of the picture.
    'aruco_markers': MessageType(
        'aruco_markers_msgs/msg/MarkerArray',
        has_poses=True,
        item=(
            ('header', 'header'),
            ('number', 'uint32'),
            ('pose_header', 'header'),
            ('pose', 'pose'),
            ('pixel_x', 'float64'),
            ('pixel_y', 'float64'),
        ),
    ),
    'aruco_detection': MessageType(
        'aruco_opencv_msgs/msg/ArucoDetection',
        has_poses=True,
        item=(('number', 'uint16'), ('pose', 'pose')),
    ),
}
# Those that carry poses of bodies and not markers.
POSE_TYPES = tuple(kind for kind, row in MESSAGE_TYPES.items() if row.has_poses)
