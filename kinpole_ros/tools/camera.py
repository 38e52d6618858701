"""`kinpole camera`: the tags that a camera sees, as markers for a node, and its pictures."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kinpole_ros.bags import BagError
from kinpole_ros.messages import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    DETECTIONS,
    MessageError,
    installed_class,
    marker_arrays,
    message_class,
    ns_to_stamp,
    read_detections,
    serialize_message,
)

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions, LiveTags

_FRAME = 'world'
_MARKERS = 'visualization_msgs/msg/MarkerArray'
_PATIENCE = 10.0  # s, for a CameraInfo, which drivers send with each picture
_POLL_INTERVAL = 0.1  # s
_DEPTH = 10  # messages


class _Frame(NamedTuple):
    """Stamp, ns, and names and places (n,), complex, m, of markers; the picture, if there is."""

    stamp: int
    markers: tuple[list[str], np.ndarray]
    gray: np.ndarray | None = None


def publish(source: str, options: 'FilmOptions', topic: str) -> int:
    """
    Publish markers until the video ends or Ctrl-C; return the number of messages.

    `source` is that of `film.live_pictures`. The stamps are those of the pictures, from the time of
    the first one on.
    """
    from kinpole_ros.film import LiveTags, live_pictures

    tags = LiveTags(options)

    def frames() -> Iterator[_Frame]:
        begin = 0
        with closing(live_pictures(source)) as pictures:  # type: ignore[type-var]
            for stamp, gray in pictures:
                begin = begin or node.get_clock().now().nanoseconds - stamp
                yield _Frame(begin + stamp, tags.find(gray), gray)

    with _node() as (node, stop_requested):
        return _publish(node, topic, tags, frames(), stop_requested)


def publish_detections(detections: str, info: str, options: 'FilmOptions', topic: str) -> int:
    """
    Publish the tags of an apriltag_msgs/AprilTagDetectionArray as markers until Ctrl-C.

    `info` is the topic of the CameraInfo. The stamps are those of the detections. Returns the
    number of messages.
    """
    from rclpy.qos import qos_profile_sensor_data

    from kinpole_ros.film import LiveTags, rectified_lens
    from kinpole_ros.ros.source import MAX_MESSAGE_BYTES

    waiting: deque[bytes] = deque(maxlen=_DEPTH)
    with _node() as (node, stop_requested):
        # The class first: without its package there is nothing to wait for.
        kind = _class_of_detections()
        camera = _camera_info(node, info, stop_requested)
        if camera is None:
            return 0
        # Detectors look at rectified pictures, which have no lens any more.
        tags = LiveTags(options, rectified_lens(camera) if options.camera is None else None)
        picture = int(camera.width), int(camera.height)

        def receive(data: bytes) -> None:
            if len(data) <= MAX_MESSAGE_BYTES:
                waiting.append(data)

        node.create_subscription(kind, detections, receive, qos_profile_sensor_data, raw=True)

        def frames() -> Iterator[_Frame]:
            import rclpy

            while not stop_requested():
                rclpy.spin_once(node, timeout_sec=_POLL_INTERVAL)
                while waiting:
                    try:
                        seen = read_detections(waiting.popleft())
                    except MessageError as error:
                        node.get_logger().warning(str(error))
                        continue
                    markers = tags.place(seen.tags, seen.corners, picture, seen.family)
                    yield _Frame(seen.stamp, markers)

        return _publish(node, topic, tags, frames(), stop_requested)


def _publish(
    node: Any,
    topic: str,
    tags: 'LiveTags',
    frames: Iterator[_Frame],
    stop_requested: Callable[[], bool],
) -> int:
    """Publish the markers of frames, and their pictures; return the number of messages."""
    from rclpy.qos import qos_profile_sensor_data

    from kinpole_ros.film import jpeg

    markers = node.create_publisher(installed_class(_MARKERS), topic, _DEPTH)
    image = node.create_publisher(
        installed_class(COMPRESSED_IMAGE), '~/image', qos_profile_sensor_data
    )
    was_learned, count = False, 0
    print(f'learning the plane; then markers on {markers.topic_name}', flush=True)
    with closing(frames):  # type: ignore[type-var]
        for stamp, (names, places), gray in frames:
            if stop_requested():
                break
            if tags.learned is not None and not was_learned:
                was_learned = True
                for line in tags.learned.assumed:
                    node.get_logger().info(line)
            if was_learned:
                points = np.stack((places.real, places.imag, 0 * places.real), axis=-1)
                stamps = np.array([stamp], np.int64)
                markers.publish(marker_arrays(stamps, _FRAME, names, points[None])[0])
                count += 1
            if gray is not None and image.get_subscription_count():
                data = np.frombuffer(jpeg(gray), np.uint8)
                message = message_class(COMPRESSED_IMAGE)(format='jpeg', data=data)
                message.header.stamp, message.header.frame_id = ns_to_stamp(stamp), _FRAME
                image.publish(serialize_message(message))
    return count


@contextmanager
def _node() -> Iterator[tuple[Any, Callable[[], bool]]]:
    """Start ROS; give a node, and a function that says whether a request to stop has come."""
    import rclpy
    from rclpy.node import Node

    from kinpole_ros.ros.executor import start_ros
    from kinpole_ros.ros.player import bag_errors

    with bag_errors():
        stop_requested = start_ros([])
    node = Node('kinpole_camera')
    try:
        yield node, stop_requested
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _class_of_detections() -> Any:
    try:
        return installed_class(DETECTIONS)
    except LookupError as error:
        raise BagError(str(error)) from None


def _camera_info(node: Any, topic: str, stop_requested: Callable[[], bool]) -> Any:
    """Return the first CameraInfo of a topic; None if a request to stop comes before."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data

    came: list[Any] = []
    subscription = node.create_subscription(
        installed_class(CAMERA_INFO), topic, came.append, qos_profile_sensor_data
    )
    print(f'waiting for the CameraInfo on {subscription.topic_name}', flush=True)
    end = time.monotonic() + _PATIENCE
    while not came and not stop_requested():
        rclpy.spin_once(node, timeout_sec=_POLL_INTERVAL)
        if time.monotonic() > end:
            raise BagError(
                f'no CameraInfo came on {subscription.topic_name} in {_PATIENCE:g} s; fix: start '
                'its driver, or name the topic by --info'
            )
    node.destroy_subscription(subscription)
    if came and not min(came[0].width, came[0].height) > 0:
        raise BagError(f'the CameraInfo on {topic} has no size; fix: see to its driver')
    return came[0] if came else None
