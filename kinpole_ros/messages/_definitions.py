"""The definitions of the message types in use, as their .msg files have them."""

DEFINITIONS = {
    'apriltag_msgs/msg/AprilTagDetection': (
        'string family; int32 id; int32 hamming; float32 goodness; float32 decision_margin; '
        # In the package these are points; here each is a pair of numbers.
        'float64[2] centre; float64[8] corners; float64[9] homography'
    ),
    'apriltag_msgs/msg/AprilTagDetectionArray': (
        'std_msgs/Header header; apriltag_msgs/AprilTagDetection[] detections'
    ),
    'builtin_interfaces/msg/Duration': 'int32 sec; uint32 nanosec',
    'builtin_interfaces/msg/Time': 'int32 sec; uint32 nanosec',
    'diagnostic_msgs/msg/DiagnosticArray': (
        'std_msgs/Header header; diagnostic_msgs/DiagnosticStatus[] status'
    ),
    'diagnostic_msgs/msg/DiagnosticStatus': (
        'byte OK=0; byte WARN=1; byte ERROR=2; byte STALE=3; byte level; string name; '
        'string message; string hardware_id; diagnostic_msgs/KeyValue[] values'
    ),
    'diagnostic_msgs/msg/KeyValue': 'string key; string value',
    'geometry_msgs/msg/Point': 'float64 x; float64 y; float64 z',
    'geometry_msgs/msg/PointStamped': 'std_msgs/Header header; geometry_msgs/Point point',
    'geometry_msgs/msg/Pose': 'geometry_msgs/Point position; geometry_msgs/Quaternion orientation',
    'geometry_msgs/msg/PoseArray': 'std_msgs/Header header; geometry_msgs/Pose[] poses',
    'geometry_msgs/msg/PoseStamped': 'std_msgs/Header header; geometry_msgs/Pose pose',
    'geometry_msgs/msg/PoseWithCovariance': 'geometry_msgs/Pose pose; float64[36] covariance',
    'geometry_msgs/msg/PoseWithCovarianceStamped': (
        'std_msgs/Header header; geometry_msgs/PoseWithCovariance pose'
    ),
    'geometry_msgs/msg/Quaternion': 'float64 x; float64 y; float64 z; float64 w',
    'geometry_msgs/msg/Transform': (
        'geometry_msgs/Vector3 translation; geometry_msgs/Quaternion rotation'
    ),
    'geometry_msgs/msg/TransformStamped': (
        'std_msgs/Header header; string child_frame_id; geometry_msgs/Transform transform'
    ),
    'geometry_msgs/msg/Twist': 'geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular',
    'geometry_msgs/msg/TwistWithCovariance': 'geometry_msgs/Twist twist; float64[36] covariance',
    'geometry_msgs/msg/Vector3': 'float64 x; float64 y; float64 z',
    'geometry_msgs/msg/Vector3Stamped': 'std_msgs/Header header; geometry_msgs/Vector3 vector',
    'geometry_msgs/msg/Wrench': 'geometry_msgs/Vector3 force; geometry_msgs/Vector3 torque',
    'geometry_msgs/msg/WrenchStamped': 'std_msgs/Header header; geometry_msgs/Wrench wrench',
    'nav_msgs/msg/Odometry': (
        'std_msgs/Header header; string child_frame_id; geometry_msgs/PoseWithCovariance pose; '
        'geometry_msgs/TwistWithCovariance twist'
    ),
    'nav_msgs/msg/Path': 'std_msgs/Header header; geometry_msgs/PoseStamped[] poses',
    'sensor_msgs/msg/CompressedImage': 'std_msgs/Header header; string format; uint8[] data',
    'sensor_msgs/msg/JointState': (
        'std_msgs/Header header; string[] name; float64[] position; float64[] velocity; '
        'float64[] effort'
    ),
    'sensor_msgs/msg/PointCloud2': (
        'std_msgs/Header header; uint32 height; uint32 width; sensor_msgs/PointField[] fields; '
        'bool is_bigendian; uint32 point_step; uint32 row_step; uint8[] data; bool is_dense'
    ),
    'sensor_msgs/msg/PointField': (
        'uint8 INT8=1; uint8 UINT8=2; uint8 INT16=3; uint8 UINT16=4; uint8 INT32=5; '
        'uint8 UINT32=6; uint8 FLOAT32=7; uint8 FLOAT64=8; string name; uint32 offset; '
        'uint8 datatype; uint32 count'
    ),
    'std_msgs/msg/ColorRGBA': 'float32 r; float32 g; float32 b; float32 a',
    'std_msgs/msg/Header': 'builtin_interfaces/Time stamp; string frame_id',
    'std_msgs/msg/String': 'string data',
    'tf2_msgs/msg/TFMessage': 'geometry_msgs/TransformStamped[] transforms',
    'visualization_msgs/msg/Marker': (
        'int32 ARROW=0; int32 CUBE=1; int32 SPHERE=2; int32 CYLINDER=3; int32 LINE_STRIP=4; '
        'int32 LINE_LIST=5; int32 CUBE_LIST=6; int32 SPHERE_LIST=7; int32 POINTS=8; '
        'int32 TEXT_VIEW_FACING=9; int32 MESH_RESOURCE=10; int32 TRIANGLE_LIST=11; '
        'int32 ARROW_STRIP=12; int32 ADD=0; int32 MODIFY=0; int32 DELETE=2; int32 DELETEALL=3; '
        'std_msgs/Header header; string ns; int32 id; int32 type; int32 action; '
        'geometry_msgs/Pose pose; geometry_msgs/Vector3 scale; std_msgs/ColorRGBA color; '
        'builtin_interfaces/Duration lifetime; bool frame_locked; geometry_msgs/Point[] points; '
        'std_msgs/ColorRGBA[] colors; string texture_resource; '
        'sensor_msgs/CompressedImage texture; visualization_msgs/UVCoordinate[] uv_coordinates; '
        'string text; string mesh_resource; visualization_msgs/MeshFile mesh_file; '
        'bool mesh_use_embedded_materials'
    ),
    'visualization_msgs/msg/MarkerArray': 'visualization_msgs/Marker[] markers',
    'visualization_msgs/msg/MeshFile': 'string filename; uint8[] data',
    'visualization_msgs/msg/UVCoordinate': 'float32 u; float32 v',
}
