"""
The topic `state`: all quantities of all bodies at an instant in one message.

A sensor_msgs/PointCloud2 with one point for each body and one field for each number needs no
message type of its own. It costs far less to make, send and read than the separate topics, which
have the same numbers.

A body has a code of why its pose, and each quantity, is undetermined: see tracking/reasons.py.

Registered quantities of a body, as of the points that a scene names, are further fields, not rows:
a field has a name, by which programs find it, and the rows stay those of the bodies.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import Writer, field_offsets
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
_FIRST_FIELDS: dict[str, int] = {
    'x': PointField.FLOAT32,
    'y': PointField.FLOAT32,
    'z': PointField.FLOAT32,
    'determined': PointField.UINT32,
}
_FORMATS = {
    PointField.UINT8: 'u1',
    PointField.UINT32: '<u4',
    PointField.FLOAT32: '<f4',
    PointField.FLOAT64: '<f8',
}
# The last field of a registered quantity has this ending, and is 1 where it is determined: bits are
# few, and there may be many points.
_DETERMINED = '_determined'
_POSE = ('position', 'angle', 'velocity')
# The field of the code of a quantity, a byte, has this ending.
_REASON = '_reason'
# The bytes of the stamp in a message.
_STAMP = slice(4, 12)
Quantities: TypeAlias = dict[str, Numbers | Vectors]


class StateBlock(NamedTuple):
    """
    Messages of the topic in a row that have one layout: `stamps` (T,), ns, and the rest (T, B).

    `quantities` are as `read_state` returns those (B,) of one message. `reasons` are codes (T, B)
    of `pose` and of each of the quantities of `quantity_names`.
    """

    stamps: np.ndarray
    quantities: Quantities
    reasons: dict[str, np.ndarray]


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


def reason_fields(order: int) -> dict[str, str]:
    """
    Return the fields of the codes of why quantities are undetermined, a byte each.

    They follow the float64 fields of the quantities, and those of registered ones follow them.

    Parameters
    ----------
    order : int
        Highest derivative, 1 to 4.

    Returns
    -------
    dict
        The names of the fields by quantity, in the order of `state_fields`.
    """
    return {name: f'{name}{_REASON}' for name in state_fields(order)}


def quantity_fields(
    order: int, registered: Sequence[RegisteredQuantity] = ()
) -> dict[str, dict[str, Any]]:
    """
    Return how each quantity of the topic is read, by its name.

    Parameters
    ----------
    order, registered
        As of `state_fields`.

    Returns
    -------
    dict
        Of each quantity `fields`, a value and its deviation, or x, y and the covariance; `bit`,
        that of the field `determined`, or else `determined`, the field that is 1 where it is;
        `reason`, the field of its code, None for a registered quantity.
    """
    found: dict[str, dict[str, Any]] = {}
    reasons = reason_fields(order)
    for bit, (quantity, fields) in enumerate(state_fields(order, registered).items()):
        if quantity not in reasons:
            found[quantity] = {'fields': fields[:-1], 'determined': fields[-1], 'reason': None}
            continue
        verdict = {'bit': bit, 'reason': reasons[quantity]}
        if quantity != 'pose':
            found[quantity] = {'fields': fields, **verdict}
            continue
        for name, is_vector in zip(_POSE, (True, False, True), strict=True):
            found[name] = {'fields': _fields_of(name, is_vector), **verdict}
    return found


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
    first = sum(map(len, state_fields(order).values()))
    kinds = dict.fromkeys(names[:first], PointField.FLOAT64)
    kinds |= dict.fromkeys(reason_fields(order).values(), PointField.UINT8)
    kinds |= dict.fromkeys(names[first:], PointField.FLOAT64)
    row = Row(STATE_POINTS, 0, partial(_template, kinds), order)
    if added := _added(order, registered):
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


def _template(kinds: Mapping[str, int], frame_id: str, bodies: int) -> tuple[bytes, int]:
    """A message with zeros for stamp and points, and the bytes before the points."""
    writer = Writer()
    writer.header(0, frame_id)
    size = writer.cloud_fields({**_FIRST_FIELDS, **kinds}, bodies)
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
    (block,) = read_state_blocks([data])
    of_bodies = {
        name: type(quantity)(*(part[0] for part in quantity))
        for name, quantity in block.quantities.items()
    }
    return int(block.stamps[0]), of_bodies


def read_state_blocks(messages: Iterable[bytes]) -> Iterator[StateBlock]:
    """
    Read messages of the topic `state` at once, ten times as fast as one by one.

    Parameters
    ----------
    messages : iterable of bytes
        The serialized messages.

    Yields
    ------
    StateBlock
        Messages in a row that have one layout.

    Raises
    ------
    ValueError
        As `read_state`.
    """
    same_layout: list[bytes] = []
    layout: _Layout | None = None
    for data in messages:
        if layout is not None and len(data) == len(same_layout[0]):
            behind = slice(_STAMP.stop, layout.start)
            if data[:4] == same_layout[0][:4] and data[behind] == same_layout[0][behind]:
                same_layout.append(data)
                continue
        if layout is not None:
            yield _read_same_layout(same_layout, layout)
        layout, same_layout = _layout_of(deserialize_message(data, PointCloud2)), [data]
    if layout is not None:
        yield _read_same_layout(same_layout, layout)


class _Layout(NamedTuple):
    """
    Where the numbers of a message are.

    The points begin at byte `start`, and there are `width` of them. `quantities` are the names of
    the float64 fields of each quantity, and those before `added` have a bit and a reason.
    """

    start: int
    width: int
    point: np.dtype
    quantities: dict[str, list[str]]
    added: int


def _layout_of(cloud: Any) -> _Layout:
    """Return the layout of a message; ValueError for a cloud of another topic."""
    names = [field.name for field in cloud.fields]
    for order in range(1, 5):
        fields = state_fields(order)
        known = [*_FIRST_FIELDS, *chain(*fields.values()), *reason_fields(order).values()]
        if names[: len(known)] == known:
            break
    else:
        raise ValueError(
            'its fields are not those of a topic `state` of this version; fix: make the results '
            'again from the markers'
        )
    own_count = len(fields)
    for name, own in _added_in(names[len(known) :]):
        is_quantity = own in (_added_fields(name, False), _added_fields(name, True))
        if not is_quantity or name in (*_POSE, *fields):
            raise ValueError(f'its fields of {name} are not those of a topic `state`')
        fields[name] = own
    kinds = _FIRST_FIELDS | dict.fromkeys(chain(*fields.values()), PointField.FLOAT64)
    kinds = {name: kinds.get(name, PointField.UINT8) for name in names}
    offsets, size = field_offsets(kinds)
    if cloud.is_bigendian or len(cloud.data) != size * cloud.width:
        raise ValueError(f'it has {len(cloud.data)} bytes of data for {cloud.width} bodies')
    formats = [_FORMATS[kind] for kind in kinds.values()]
    point = np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': size})
    _, start = _template(kinds, cloud.header.frame_id, 0)
    return _Layout(start, cloud.width, point, fields, own_count)


def _added_in(names: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the registered quantities among the last fields of a message, with their fields."""
    first = 0
    for k, name in enumerate(names, 1):
        if name.endswith(_DETERMINED) or k == len(names):
            yield name.removesuffix(_DETERMINED), names[first:k]
            first = k


def _read_same_layout(messages: Sequence[bytes], layout: _Layout) -> StateBlock:
    """Read messages of one layout."""
    table = np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), -1)
    order = '<' if messages[0][1] & 1 else '>'
    seconds = table[:, _STAMP].copy().view(f'{order}i4')[:, 0].astype(np.int64)
    fraction = table[:, _STAMP].copy().view(f'{order}u4')[:, 1].astype(np.int64)
    size = layout.width * layout.point.itemsize
    points = table[:, layout.start : layout.start + size].copy().view(layout.point)
    points = points.reshape(len(messages), layout.width)
    fields = layout.quantities
    if not all(np.isfinite(points[name]).all() for name in chain(*fields.values())):
        raise ValueError('not all of its numbers are finite')
    quantities: Quantities = {}
    for bit, quantity in enumerate(fields):
        if bit < layout.added:
            determined = points['determined'] >> bit & 1 == 1
        else:
            determined = points[f'{quantity}{_DETERMINED}'] != 0
        for name in _POSE if quantity == 'pose' else (quantity,):
            quantities[name] = _quantity_in(points, name, determined)
    reasons = {name: points[f'{name}{_REASON}'] for name in list(fields)[: layout.added]}
    return StateBlock(seconds * 10**9 + fraction, quantities, reasons)


def _quantity_in(points: np.ndarray, name: str, determined: np.ndarray) -> Numbers | Vectors:
    """Return a quantity (...) in points (...)."""
    if name in (points.dtype.names or ()):
        return Numbers(points[name], points[f'{name}_deviation'] ** 2, determined)
    x, y, xx, xy, yy = (points[field] for field in _fields_of(name, True))
    covariance = np.stack([xx, xy, xy, yy], axis=-1).reshape(*xx.shape, 2, 2)
    return Vectors(x + 1j * y, covariance, determined)
