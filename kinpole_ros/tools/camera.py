"""`kinpole camera`: the tags that a camera sees, as markers for a node, and its pictures."""

from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np

from kinpole_ros.messages import (
    installed_class,
    marker_arrays,
    message_class,
    ns_to_stamp,
    serialize_message,
)

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions

_FRAME = 'world'
_MARKERS, _IMAGE = 'visualization_msgs/msg/MarkerArray', 'sensor_msgs/msg/CompressedImage'


def publish(source: str, options: 'FilmOptions', topic: str) -> int:
    """
    Publish markers until the video ends or Ctrl-C; return the number of messages.

    `source` is that of `film.live_pictures`. The stamps are those of the pictures, from the time of
    the first one on.
    """
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data

    from kinpole_ros.film import LiveTags, jpeg, live_pictures
    from kinpole_ros.ros.executor import start_ros
    from kinpole_ros.ros.player import bag_errors

    tags = LiveTags(options)
    with bag_errors():
        stop_requested = start_ros([])
    node = Node('kinpole_camera')
    count = 0
    try:
        markers = node.create_publisher(installed_class(_MARKERS), topic, 10)
        image_class = installed_class(_IMAGE)
        image = node.create_publisher(image_class, '~/image', qos_profile_sensor_data)
        was_learned, begin = False, 0
        print(f'learning the plane; then markers on {markers.topic_name}', flush=True)
        with closing(live_pictures(source)) as pictures:  # type: ignore[type-var]
            for picture in pictures:
                if stop_requested():
                    break
                begin = begin or node.get_clock().now().nanoseconds - picture.stamp
                stamp = begin + picture.stamp
                names, places = tags.find(picture.gray)
                if tags.learned is not None and not was_learned:
                    was_learned = True
                    for line in tags.learned.assumed:
                        node.get_logger().info(line)
                if was_learned:
                    points = np.stack((places.real, places.imag, 0 * places.real), axis=-1)
                    stamps = np.array([stamp], np.int64)
                    markers.publish(marker_arrays(stamps, _FRAME, names, points[None])[0])
                    count += 1
                if image.get_subscription_count():
                    data = np.frombuffer(jpeg(picture.gray), np.uint8)
                    message = message_class(_IMAGE)(format='jpeg', data=data)
                    message.header.stamp, message.header.frame_id = ns_to_stamp(stamp), _FRAME
                    image.publish(serialize_message(message))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return count
