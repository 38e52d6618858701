"""Markers of the objects that rclpy makes of messages: what reading them from bytes must equal."""

import struct
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from kinpole_ros.messages import ROS_TYPE_NAMES, MessageError, installed_class
from kinpole_ros.messages._cloud import cloud_layout
from kinpole_ros.messages._offsets import Cloud, CloudField, Items
from kinpole_ros.messages._types import Marker
from kinpole_ros.tracking.frame import MarkerFrames

END = 2**31 * 10**9  # ns
LISTS = Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS
SINGLE = Marker.CUBE, Marker.SPHERE, Marker.CYLINDER


def ordinary(kind: str, data: bytes, identity: str = 'auto') -> MarkerFrames | MessageError:
    """The markers of a message as rclpy makes it, or that it cannot be read."""
    try:
        message = deserialize_message(data, installed_class(ROS_TYPE_NAMES[kind]))
        if kind == 'marker_array':
            header, frame_id, names, points = read_array(message, identity)
        else:
            header, frame_id = message.header, message.header.frame_id
            points = {'marker': of_marker, 'pose_array': of_poses, 'point_cloud2': of_cloud}[kind](
                message
            )
            names = tuple(map(str, range(len(points))))
            if identity == 'id' and kind == 'point_cloud2':
                names = unique(ids_of_cloud(message))
            elif identity not in ('auto', 'index'):
                raise MessageError('no such identity')
        stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
        if header.stamp.sec < 0 or stamp >= END:
            raise MessageError('no stamp')
    except Exception as error:
        return MessageError(str(error))
    points = np.array(points, float).reshape(1, len(names), 3)
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    return MarkerFrames(np.array([stamp]), frame_id, names, points)


def unique(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise MessageError('a name comes twice')
    return names


def read_array(message: Any, identity: str) -> tuple[Any, str, tuple[str, ...], list[Any]]:
    markers = message.markers
    shown: list[int] = []
    for k, marker in enumerate(markers):
        if marker.action == Marker.DELETEALL:
            shown.clear()
        elif marker.action == Marker.DELETE:
            key = marker.ns, marker.id
            shown = [j for j in shown if (markers[j].ns, markers[j].id) != key]
        else:
            shown.append(k)
    drawn: list[tuple[int, int | None, Any]] = []
    for k in shown:
        if markers[k].type in SINGLE:
            drawn.append((k, None, xyz(markers[k].pose.position)))
        elif markers[k].type in LISTS:
            drawn += [(k, index, point) for index, point in enumerate(moved(markers[k]))]
    first = drawn[0][0] if drawn else shown[0] if shown else 0
    header = markers[first].header
    if not drawn and header == type(header)():
        raise MessageError('no stamp')
    frames = {markers[k].header.frame_id for k, *_ in drawn} - {''}
    if len(frames) > 1:
        raise MessageError('several frames')
    names = []
    for k, index, _ in drawn:
        one = markers[k]
        name = {'index': str(k), 'id': str(one.id), 'ns': one.ns}.get(identity)
        if name is None:
            name = f'{one.ns}/{one.id}' if one.ns else str(one.id)
        names.append(name if index is None else f'{name}/{index}')
    points = [point for *_, point in drawn]
    if identity == 'index':
        return header, ''.join(frames) or header.frame_id, tuple(names), points
    return header, ''.join(frames) or header.frame_id, unique(tuple(names)), points


def xyz(point: Any) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def of_marker(marker: Any) -> Any:
    if marker.action in (Marker.DELETE, Marker.DELETEALL):
        return []
    if not marker.points and marker.type in SINGLE:
        raise MessageError('no points')
    return moved(marker)


def moved(marker: Any) -> Any:
    q = marker.pose.orientation
    points = np.array([xyz(point) for point in marker.points]).reshape(-1, 3)
    with np.errstate(all='ignore'):
        if any((q.x, q.y, q.z)) or not np.isfinite(q.w):
            norm = np.hypot(np.hypot(q.x, q.y), np.hypot(q.z, q.w))
            x, y, z, w = (part / norm for part in (q.x, q.y, q.z, q.w))
            rows = (
                (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
                (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
                (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
            )
            points = (np.array(rows) * points[:, None, :]).sum(axis=-1)
        return points + xyz(marker.pose.position)


def of_poses(message: Any) -> Any:
    return [xyz(pose.position) for pose in message.poses]


def described(cloud: Any) -> Cloud:
    fields = [CloudField(f.name, f.offset, f.datatype, f.count) for f in cloud.fields]
    about = cloud.height, cloud.width, fields, bool(cloud.is_bigendian)
    return Cloud(*about, cloud.point_step, cloud.row_step, Items(0, len(cloud.data)))


def of_cloud(cloud: Any) -> Any:
    layout, data = cloud_layout(described(cloud)), bytes(cloud.data)
    order = '>' if cloud.is_bigendian else '<'
    codes = [{0: '', 4: 'f', 8: 'd'}[width] for width in layout.widths]
    return [
        [
            struct.unpack_from(order + code, data, start + axis)[0] if code else 0.0
            for axis, code in zip(layout.axes, codes, strict=True)
        ]
        for start in layout.offsets.tolist()
    ]


def ids_of_cloud(cloud: Any) -> tuple[str, ...]:
    (field,) = [f for f in cloud.fields if f.name == 'id']
    if field.count > 1 or field.datatype not in range(1, 7):
        raise MessageError('no integers')
    code = ((cloud.is_bigendian and '>') or '<') + ' bBhHiI'[field.datatype]
    if field.offset + struct.calcsize(code) > cloud.point_step:
        raise MessageError('beyond the point')
    starts = [
        row * cloud.row_step + column * cloud.point_step + field.offset
        for row in range(cloud.height)
        for column in range(cloud.width)
    ]
    data = bytes(cloud.data)
    return tuple(str(struct.unpack_from(code, data, start)[0]) for start in starts)
