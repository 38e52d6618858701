"""
The topic `state`: all quantities of all bodies at an instant in one message.

A sensor_msgs/PointCloud2 with one point for each body and one field for each number needs no
message type of its own. It costs far less to make, send and read than the separate topics, which
have the same numbers.

Registered quantities of a body, as of the points that a scene names, are further fields, not rows:
a field has a name, by which programs find it, and the rows stay those of the bodies.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from typing import Any, TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._rows import STATE_POINTS, Row, Rows
from kinpole_ros.messages._types import (
    PointCloud2,
    PointField,
    deserialize_message,
)
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.values import Numbers, Vectors, quantity_names

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
# The last field of a registered quantity has this ending, and is 1 where it is determined: bits are
# few, and there may be many points.
_DETERMINED = '_determined'
_POSE = ('position', 'angle', 'velocity')
# The bytes of the stamp in a message.
_STAMP = slice(4, 12)
Quantities: TypeAlias = dict[str, Numbers | Vectors]


def state_fields(order: int, registered: Sequence[RegisteredQuantity] = ()) -> dict[str, list[str]]:
    """
    Return the float64 fields of the topic `state`.

    Parameters
    ----------
    order : int
        Highest derivative, 1 to 4.
    registered : sequence of RegisteredQuantity
        Quantities of another package, of which those of bodies have fields.

    Returns
    -------
    dict
        The names of the fields by quantity. Bit k of the field `determined` is that of the k-th
        quantity. `pose` is the position, angle and velocity of the frame of the body. A number
        is followed by its standard deviation, a vector by its covariance, and a registered
        quantity by whether it is determined, in place of a bit.
    """
    pose = [*_fields_of('position', True), *_fields_of('angle'), *_fields_of('velocity', True)]
    fields = {'pose': pose}
    names = quantity_names(order)
    fields |= {name: _fields_of(name, is_vector) for name, is_vector in names.items()}
    added = _added(order, registered)
    return fields | {name: _added_fields(name, one.is_vector) for one, name in added}


def _added(
    order: int, registered: Sequence[RegisteredQuantity]
) -> list[tuple[RegisteredQuantity, str]]:
    """Return the registered quantities that have fields, with their names."""
    own = [one for one in registered if one.body is not None and one.order <= order]
    # Those of two bodies with the same name share its fields.
    return [(one, one.topic.partition('/')[2]) for one in own]


def _added_fields(name: str, is_vector: bool) -> list[str]:
    return [*_fields_of(name, is_vector), f'{name}{_DETERMINED}']


def _fields_of(name: str, is_vector: bool = False) -> list[str]:
    if is_vector:
        return [f'{name}_{end}' for end in ('x', 'y', 'xx', 'xy', 'yy')]
    return [name, f'{name}_deviation']


def state(given: Plane, order: int, registered: Sequence[RegisteredQuantity] = ()) -> Rows:
    """
    Return what makes the messages, with derivatives up to `order`.

    `given` is the plane of estimates that have none.
    """
    names = [*chain(*state_fields(order, registered).values())]
    row = Row(STATE_POINTS, 0, partial(_template, names), order)
    if added := _added(order, registered):
        first = sum(map(len, state_fields(order).values()))
        fields = [_added_fields(name, one.is_vector)[0] for one, name in added]
        columns = [names.index(field) - first for field in fields]
        quantities = [(one, k) for (one, _), k in zip(added, columns, strict=True)]
        starts = np.array([*sorted({*columns}), len(names) - first])
        row = row._replace(
            added=partial(_added_values, quantities, starts), added_count=len(names) - first
        )
    return Rows([row], given)


def _added_values(
    quantities: Sequence[tuple[RegisteredQuantity, int]], starts: np.ndarray, estimate: Estimate
) -> np.ndarray:
    """Return the fields (T, B, n) of registered quantities, each from its column in `starts` on."""
    added = np.zeros((len(estimate), len(estimate.bodies), starts[-1]))
    for quantity, first in quantities:
        value, spread, determined = quantity.values(estimate)
        if quantity.is_vector:
            spreads = (spread[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
            parts = [value.real, value.imag, *spreads, determined]
        else:
            parts = [value.real, np.sqrt(np.maximum(spread, 0.0)), determined]
        for k, part in enumerate(parts, first):
            added[:, quantity.body, k] = part
    is_known = np.logical_and.reduceat(np.isfinite(added), starts[:-1], axis=-1)
    is_known &= added[..., starts[1:] - 1] != 0
    return np.where(np.repeat(is_known, np.diff(starts), axis=-1), added, 0.0)


def _template(names: Sequence[str], frame_id: str, bodies: int) -> tuple[bytes, int]:
    """A message with zeros for stamp and points, and the bytes before the points."""
    writer = Writer()
    writer.header(0, frame_id)
    size = writer.cloud_fields(_FIRST_FIELDS | dict.fromkeys(names, PointField.FLOAT64), bodies)
    is_dense = b'\1'  # no number is NaN
    return bytes(writer.data) + bytes(size) + is_dense, len(writer.data)


def read_state(data: bytes) -> tuple[int, Quantities]:
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
        `velocity` in place of `pose`. Those of a point that a scene names, as `points/P/velocity`,
        are undetermined for other bodies.

    Raises
    ------
    ValueError
        For a cloud of another topic, and for other bytes.
    """
    ((stamp, quantities),) = read_states([data])
    of_bodies = {
        name: type(quantity)(*(part[0] for part in quantity))
        for name, quantity in quantities.items()
    }
    return int(stamp[0]), of_bodies


def read_states(messages: Iterable[bytes]) -> Iterator[tuple[np.ndarray, Quantities]]:
    """
    Read messages of the topic `state` at once, ten times as fast as one by one.

    Parameters
    ----------
    messages : iterable of bytes
        The serialized messages.

    Yields
    ------
    stamps : ndarray
        Stamps (T,), ns, of messages in a row that have one layout.
    quantities : dict
        Their quantities (T, B), as `read_state` returns those (B,) of one message.

    Raises
    ------
    ValueError
        As `read_state`.
    """
    alike: list[bytes] = []
    fields: dict[str, list[str]] = {}
    start = width = 0

    def block() -> tuple[np.ndarray, Quantities]:
        table = np.frombuffer(b''.join(alike), np.uint8).reshape(len(alike), -1)
        order = '<' if alike[0][1] & 1 else '>'
        seconds = table[:, _STAMP].copy().view(f'{order}i4')[:, 0].astype(np.int64)
        fraction = table[:, _STAMP].copy().view(f'{order}u4')[:, 1].astype(np.int64)
        doubles = _FIRST_DOUBLES + sum(map(len, fields.values()))
        points = table[:, start : start + 8 * width * doubles].copy().view('<f8')
        points = points.reshape(len(alike), width, doubles)
        return seconds * 10**9 + fraction, _quantities_in(points, fields)

    for data in messages:
        if alike and len(data) == len(alike[0]):
            is_alike = data[:4] == alike[0][:4]
            if is_alike and data[_STAMP.stop : start] == alike[0][_STAMP.stop : start]:
                alike.append(data)
                continue
        if alike:
            yield block()
        cloud = deserialize_message(data, PointCloud2)
        fields, width = _fields_in(cloud), cloud.width
        # After its length, which tells zeros in it from those before.
        length = len(cloud.data).to_bytes(4, 'little' if data[1] & 1 else 'big')
        start = data.index(length + bytes(cloud.data)) + len(length)
        alike = [data]
    if alike:
        yield block()


def _fields_in(cloud: Any) -> dict[str, list[str]]:
    """Return the fields of a message by quantity; ValueError for a cloud of another topic."""
    names = [field.name for field in cloud.fields]
    possible = [state_fields(order) for order in range(1, 5)]
    # Of bags of versions without the inflection circle, which is last.
    possible += [dict(list(fields.items())[:-2]) for fields in possible[1:]]
    for fields in possible:
        known = [*_FIRST_FIELDS, *chain(*fields.values())]
        if names[: len(known)] == known:
            break
    else:
        raise ValueError('its fields are not those of a topic `state`')
    for name, own in _added_in(names[len(known) :]):
        is_quantity = own in (_added_fields(name, False), _added_fields(name, True))
        if not is_quantity or name in (*_POSE, *fields):
            raise ValueError(f'its fields of {name} are not those of a topic `state`')
        fields[name] = own
    doubles = _FIRST_DOUBLES + len(names) - len(_FIRST_FIELDS)
    if cloud.is_bigendian or len(cloud.data) != 8 * doubles * cloud.width:
        raise ValueError(f'it has {len(cloud.data)} bytes of data for {cloud.width} bodies')
    return fields


def _added_in(names: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the registered quantities among the last fields of a message, with their fields."""
    first = 0
    for k, name in enumerate(names, 1):
        if name.endswith(_DETERMINED) or k == len(names):
            yield name.removesuffix(_DETERMINED), names[first:k]
            first = k


def _quantities_in(points: np.ndarray, fields: dict[str, list[str]]) -> Quantities:
    """Return the quantities (...) in the numbers (..., doubles) of points."""
    if not np.isfinite(points[..., _FIRST_DOUBLES:]).all():
        raise ValueError('not all of its numbers are finite')
    bits = points.view('<u4')[..., len(_FIRST_FIELDS) - 1]
    names = chain(*fields.values())
    column = dict(zip(names, np.moveaxis(points, -1, 0)[_FIRST_DOUBLES:], strict=True))
    quantities: Quantities = {}
    for bit, quantity in enumerate(fields):
        own = column.get(f'{quantity}{_DETERMINED}')
        determined = bits >> bit & 1 == 1 if own is None else own != 0
        for name in _POSE if quantity == 'pose' else (quantity,):
            if name in column:
                variance = column[f'{name}_deviation'] ** 2
                quantities[name] = Numbers(column[name], variance, determined)
                continue
            x, y, xx, xy, yy = (column[field] for field in _fields_of(name, True))
            covariance = np.stack([xx, xy, xy, yy], axis=-1).reshape(*xx.shape, 2, 2)
            quantities[name] = Vectors(x + 1j * y, covariance, determined)
    return quantities
