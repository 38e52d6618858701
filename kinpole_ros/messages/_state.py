"""
The topic `state`: all quantities of all bodies at an instant in one message.

A sensor_msgs/PointCloud2 with one point for each body and one field for each number needs no
message type of its own. It costs far less to make, send and read than the separate topics, which
have the same numbers.
"""

from functools import lru_cache
from itertools import chain

import numpy as np

from kinpole_ros.messages._cdr import HEAD, TIME, Writer
from kinpole_ros.messages._quantities import Build, Built
from kinpole_ros.messages._types import (
    SECOND,
    PointCloud2,
    PointField,
    deserialize_message,
    stamp_to_ns,
)
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES, Estimate, Numbers, Vectors
from kinpole_ros.tracking.plane import Plane

STATE = 'state'
"""The topic."""
# The first fields, of 4 bytes; all others are float64. Viewers of clouds expect x, y and z, RViz as
# float32.
_FIRST_FIELDS = {
    'x': PointField.FLOAT32,
    'y': PointField.FLOAT32,
    'z': PointField.FLOAT32,
    'determined': PointField.UINT32,
}
_FIRST_DOUBLES = len(_FIRST_FIELDS) // 2
_POSE_FIELDS = 12
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def state_fields(order: int) -> dict[str, list[str]]:
    """
    Return the float64 fields of the topic `state`.

    Parameters
    ----------
    order : int
        Highest derivative, 1 to 4.

    Returns
    -------
    dict
        The names of the fields by quantity. Bit k of the field `determined` is that of the k-th
        quantity. `pose` is the position, angle and velocity of the frame of the body. A number
        is followed by its standard deviation, a vector by its covariance.
    """
    pose = [*_fields_of('position', True), *_fields_of('angle'), *_fields_of('velocity', True)]
    fields = {'pose': pose}
    fields |= {name: _fields_of(name) for name in RATE_NAMES[:order]}
    fields |= {name: _fields_of(name, True) for name in POLE_NAMES[:order]}
    if order >= 2:
        fields['icr_velocity'] = _fields_of('icr_velocity', True)
    if order >= 3:
        fields['centrode_curvature'] = _fields_of('centrode_curvature')
    return fields


def _fields_of(name: str, is_vector: bool = False) -> list[str]:
    if is_vector:
        return [f'{name}_{end}' for end in ('x', 'y', 'xx', 'xy', 'yy')]
    return [name, f'{name}_deviation']


def state(given: Plane, order: int) -> Build:
    """
    Return a function that makes the messages of all instants, with derivatives up to `order`.

    `given` is the plane of estimates that have none.
    """
    sizes = [len(names) for names in state_fields(order).values()]
    quantity_of_field = np.repeat(np.arange(len(sizes)), sizes)
    bits = 1 << np.arange(len(sizes), dtype=np.uint32)

    def build(estimate: Estimate) -> Built:
        count, bodies = estimate.missing.shape
        numbers = np.empty((count, bodies, len(quantity_of_field)))
        determined = np.empty((count, bodies, len(sizes)), bool)
        _fill(numbers, determined, estimate, order)
        points = np.zeros((count, bodies, _FIRST_DOUBLES + numbers.shape[-1]), '<f8')
        np.copyto(points[..., _FIRST_DOUBLES:], numbers, where=determined[..., quantity_of_field])
        origin = (estimate.plane or given).in_space(estimate.origin(0), estimate.height)
        origin = np.where(determined[..., :1], origin, 0.0)
        points.view('<f4')[..., :3] = origin.clip(-_LARGEST_FLOAT32, _LARGEST_FLOAT32)
        points.view('<u4')[..., 3] = determined @ bits
        start, head, tail = _constant_parts(estimate.frame_id, bodies, order)
        times = [TIME.pack(*divmod(stamp, SECOND)) for stamp in estimate.stamp.tolist()]
        return list(range(count)), [
            b''.join((start, time, head, of_bodies.tobytes(), tail))
            for time, of_bodies in zip(times, points, strict=True)
        ]

    return build


def _fill(numbers: np.ndarray, determined: np.ndarray, estimate: Estimate, order: int) -> None:
    """Write all numbers (T, B, fields), and where each quantity (T, B, bits) is determined."""
    determined[..., 0] = estimate.missing == ''
    _fill_pose(numbers, estimate)
    k = _POSE_FIELDS
    for bit, quantity in enumerate(quantities_of(estimate, order).values(), 1):
        determined[..., bit] = quantity.determined
        if isinstance(quantity, Numbers):
            numbers[..., k] = quantity.value
            np.sqrt(quantity.variance, out=numbers[..., k + 1], where=quantity.determined)
            k += 2
        else:
            numbers[..., k], numbers[..., k + 1] = quantity.value.real, quantity.value.imag
            numbers[..., k + 2] = quantity.covariance[..., 0, 0]
            numbers[..., k + 3] = quantity.covariance[..., 0, 1]
            numbers[..., k + 4] = quantity.covariance[..., 1, 1]
            k += 5


def quantities_of(estimate: Estimate, order: int) -> dict[str, Numbers | Vectors]:
    """Return rates, poles and their motion by name, up to the derivative of `order`."""
    quantities: dict[str, Numbers | Vectors] = {
        name: estimate.rate(k) for k, name in enumerate(RATE_NAMES[:order], 1)
    }
    quantities |= {name: estimate.pole(k) for k, name in enumerate(POLE_NAMES[:order], 1)}
    if order >= 2:
        quantities['icr_velocity'] = estimate.icr_velocity
    if order >= 3:
        quantities['centrode_curvature'] = estimate.centrode_curvature
    return quantities


def _fill_pose(numbers: np.ndarray, estimate: Estimate) -> None:
    """
    Write position, angle and velocity of the bodies' frames, with their covariances.

    The origin lies at -r from the reference point, whose errors are independent of those of the
    angle. So an error d of the angle moves the origin by -i d r, and changes its velocity by d w r;
    an error e of the rate w changes the velocity by -i e r.
    """
    position, velocity = estimate.origin(0), estimate.origin(1)
    angle, rate = estimate.angle[:2]
    variance, of_velocity = estimate.position_covariance[0, 0], estimate.position_covariance[1, 1]
    r = estimate.reference * np.exp(1j * angle)
    xx, xy, yy = r.real * r.real, r.real * r.imag, r.imag * r.imag
    of_angle, of_rate = estimate.angle_covariance[0, 0], estimate.angle_covariance[1, 1]
    by_angle = of_angle * rate * rate
    by_both = estimate.angle_covariance[0, 1] * rate
    columns = (
        position.real,
        position.imag,
        variance + of_angle * yy,
        -of_angle * xy,
        variance + of_angle * xx,
        angle,
        np.sqrt(of_angle),
        velocity.real,
        velocity.imag,
        of_velocity + by_angle * xx + 2 * by_both * xy + of_rate * yy,
        (by_angle - of_rate) * xy + by_both * (yy - xx),
        of_velocity + by_angle * yy - 2 * by_both * xy + of_rate * xx,
    )
    for k, column in enumerate(columns):
        numbers[..., k] = column


@lru_cache(maxsize=8)
def _constant_parts(frame_id: str, bodies: int, order: int) -> tuple[bytes, bytes, bytes]:
    """Return the bytes before the stamp, between the stamp and the data, and behind the data."""
    names = chain(*state_fields(order).values())
    kinds = [*_FIRST_FIELDS.items(), *((name, PointField.FLOAT64) for name in names)]
    writer = Writer()
    writer.header(0, frame_id)
    writer.pack('II', 1, bodies)
    writer.pack('I', len(kinds))
    offset = 0
    for name, kind in kinds:
        writer.string(name)
        writer.pack('I', offset)
        writer.data += bytes((kind,))
        writer.pack('I', 1)
        offset += 8 if kind == PointField.FLOAT64 else 4
    writer.data += b'\0'  # little endian
    writer.pack('II', offset, offset * bodies)
    writer.pack('I', offset * bodies)
    data = bytes(writer.data)
    is_dense = b'\1'  # no number is NaN
    return data[:HEAD], data[HEAD + TIME.size :], is_dense


def read_state(data: bytes) -> tuple[int, dict[str, Numbers | Vectors]]:
    """
    Read a message of the topic `state`.

    Parameters
    ----------
    data : bytes
        The serialized message.

    Returns
    -------
    stamp : int
        Its stamp, ns.
    quantities : dict
        The quantities of `state_fields` by name, of all bodies (B,), with `position`, `angle` and
        `velocity` in place of `pose`.

    Raises
    ------
    ValueError
        For a cloud of another topic.
    RuntimeError
        Where rclpy cannot read the message.
    """
    cloud = deserialize_message(data, PointCloud2)
    names = [field.name for field in cloud.fields]
    for order in range(1, 5):
        fields = state_fields(order)
        expected = [*_FIRST_FIELDS, *chain(*fields.values())]
        if names == expected:
            break
    else:
        raise ValueError('its fields are not those of a topic `state`')
    doubles = _FIRST_DOUBLES + len(expected) - len(_FIRST_FIELDS)
    content = bytes(cloud.data)
    if cloud.is_bigendian or len(content) != 8 * doubles * cloud.width:
        raise ValueError(f'it has {len(content)} bytes of data for {cloud.width} bodies')
    points = np.frombuffer(content, '<f8').reshape(cloud.width, doubles)
    if not np.isfinite(points[:, _FIRST_DOUBLES:]).all():
        raise ValueError('not all of its numbers are finite')
    bits = points.view('<u4')[:, len(_FIRST_FIELDS) - 1]
    column = dict(zip(expected[len(_FIRST_FIELDS) :], points[:, _FIRST_DOUBLES:].T, strict=True))
    quantities: dict[str, Numbers | Vectors] = {}
    for bit, quantity in enumerate(fields):
        determined = bits >> bit & 1 == 1
        for name in ('position', 'angle', 'velocity') if quantity == 'pose' else (quantity,):
            if name in column:
                variance = column[f'{name}_deviation'] ** 2
                quantities[name] = Numbers(column[name], variance, determined)
                continue
            x, y, xx, xy, yy = (column[field] for field in _fields_of(name, True))
            covariance = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
            quantities[name] = Vectors(x + 1j * y, covariance, determined)
    return stamp_to_ns(cloud.header.stamp), quantities
