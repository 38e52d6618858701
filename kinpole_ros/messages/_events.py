"""
Events of a body: the topic `<body>/event`, a message for each of them.

A sensor_msgs/PointCloud2 has one point, where the origin of the body's frame was, and a field for
each number, as the topic `state` has. It is stamped with the time of the event.
"""

import numpy as np

from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.messages._types import (
    PointCloud2,
    PointField,
    deserialize_message,
    stamp_to_ns,
)
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.events import BodyEvent
from kinpole_ros.tracking.plane import Plane

# Viewers of clouds look for x, y and z as float32.
_KINDS = {
    **dict.fromkeys('xyz', PointField.FLOAT32),
    'order': PointField.UINT32,
    **dict.fromkeys(('time_deviation', 'angle_step', 'angle_step_deviation'), PointField.FLOAT64),
    **dict.fromkeys((f'step_{end}' for end in ('x', 'y', 'xx', 'xy', 'yy')), PointField.FLOAT64),
}
_CODES = {PointField.FLOAT32: '<f4', PointField.UINT32: '<u4', PointField.FLOAT64: '<f8'}
_POINT = np.dtype([(name, _CODES[kind]) for name, kind in _KINDS.items()])


def events(body: int, given: Plane) -> Build:
    """
    Build the messages of the events of a body.

    `given` is the plane of estimates that do not say where they lie.
    """

    def build(estimate: Estimate) -> Built:
        instants, messages = [], []
        for instant, event in zip(estimate.instants_of_events(), estimate.events, strict=True):
            if event.body == body:
                instants.append(instant)
                messages.append(_message(event, estimate.frame_id, estimate.plane or given))
        return instants, messages

    return build


def _message(event: BodyEvent, frame_id: str, plane: Plane) -> bytes:
    point = np.zeros(1, _POINT)
    origin = plane.in_space(np.array([event.position]), np.array([event.height]))[0]
    (xx, xy), (_, yy) = event.step_covariance
    point[0] = (
        *origin,
        event.order,
        event.time_sigma,
        event.angle_step,
        event.angle_step_sigma,
        event.step.real,
        event.step.imag,
        *(xx, xy, yy),
    )
    writer = Writer()
    writer.header(event.stamp, frame_id)
    writer.cloud_fields(_KINDS, 1)
    return bytes(writer.data + point.tobytes() + b'\1')


def read_event(data: bytes) -> tuple[int, dict[str, float]]:
    """
    Read a message of a topic `event`.

    Parameters
    ----------
    data : bytes
        The serialized PointCloud2.

    Returns
    -------
    stamp : int
        When the event was, ns.
    fields : dict
        Its numbers by the names of their fields.

    Raises
    ------
    ValueError
        For another cloud, and for other bytes.
    """
    cloud = deserialize_message(data, PointCloud2)
    content = bytes(cloud.data)
    if [field.name for field in cloud.fields] != list(_KINDS):
        raise ValueError('its fields are not those of a topic `event`')
    if cloud.is_bigendian or len(content) != _POINT.itemsize:
        raise ValueError(f'it has {len(content)} bytes of data for one event')
    point = np.frombuffer(content, _POINT)[0]
    return stamp_to_ns(cloud.header.stamp), {name: point[name].item() for name in _KINDS}
