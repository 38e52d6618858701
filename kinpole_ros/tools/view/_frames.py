"""
The results of one instant, from a node's message for pages or its message `state`.

Messages from the network may hold anything, so all values are checked.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.messages import (
    String,
    deserialize_message,
    plane_of_rig,
    quantity_lists,
    read_state_blocks,
)
from kinpole_ros.tracking.plane import plane_axes
from kinpole_ros.tracking.quantities import withheld_quantities
from kinpole_ros.tracking.reasons import texts_of
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, Numbers, Vectors

_POSE = ('x', 'y', 'angle', 'vx', 'vy')
# The number of values of a quantity; a point has its coordinates and its ellipse.
_POINT = 5
_SIZES = {
    **dict.fromkeys((*RATE_NAMES, 'centrode_curvature', 'inflection_diameter'), 2),
    **dict.fromkeys((*POLE_NAMES, 'ball_point'), _POINT),
    'icr_velocity': 3,
}
_END_OF_TIME = 1 << 63  # ns
# Bodies, and pairs of bodies; finding joints among so many takes 0.03 s.
_MOST_BODIES = 200
_MOST_BYTES = 1 << 20  # five times a message of so many bodies


class Rig(NamedTuple):
    """The bodies of a node in its order, the quantities of each, and pairs (j, i)."""

    bodies: tuple[str, ...]
    figures: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]


class Frame(NamedTuple):
    """
    One instant, `stamp` in ns, in a plane with axes of the names `along`.

    `bodies` and `pairs` are as a page takes them, None where nothing is determined. By body,
    `sizes` are in m, and `outlines` are markers (n, 2) in its frame, m. `reasons` say for each body
    why quantities are not determined, '' for all of them.
    """

    stamp: int
    along: tuple[str, str]
    rig: Rig
    bodies: list[dict[str, Any] | None]
    pairs: list[list[float] | None]
    sizes: dict[str, float]
    outlines: dict[str, list[list[float]]]
    reasons: list[dict[str, str]]

    def as_json(self, seconds: float, published: int) -> str:
        """Return the frame as a page takes it; `published` is in ns."""
        data = {
            't': round(seconds, 6),
            'published': published / 1e6,
            'bodies': self.bodies,
            'pairs': self.pairs,
            'reasons': self.reasons,
        }
        return json.dumps(data, separators=(',', ':'), allow_nan=False)


def frame_of_view(data: bytes) -> Frame:
    """Return the frame in a node's message for pages; raise ValueError for anything else."""
    _check_bytes(data)
    try:
        message = json.loads(deserialize_message(data, String).data)
        bodies = message['bodies']
        names = tuple(str(body['name']) for body in bodies)
        pairs = tuple((str(j), str(i)) for j, i in (pair['bodies'] for pair in message['pairs']))
        if max(len(names), len(pairs)) > _MOST_BODIES:
            raise ValueError(
                f'it has {len(names)} bodies and {len(pairs)} pairs of them; a page shows '
                f'{_MOST_BODIES} of each at most'
            )
        if not {name for pair in pairs for name in pair} <= {*names}:
            raise ValueError('a pair of unknown bodies')
        first, second = message['along']
        stamp = int(message['stamp'])
        if not 0 <= stamp < _END_OF_TIME:
            raise ValueError(f'{stamp} is no stamp')
        visible = [body for body in bodies if 'x' in body]
        return Frame(
            stamp,
            (str(first), str(second)),
            Rig(names, tuple(name for name in _SIZES if name in message['figures']), pairs),
            [_body(body) if 'x' in body else None for body in bodies],
            [_quantity(pair['icr'], _POINT) for pair in message['pairs']],
            {str(body['name']): _numbers([body['size']], 1)[0] for body in visible},
            {str(body['name']): [_numbers(z, 2) for z in body['outline']] for body in visible},
            [_reasons(body['reasons']) for body in bodies],
        )
    except (KeyError, TypeError, RecursionError, OverflowError) as error:
        raise ValueError(f'no figures for a page ({error!r})') from None


def frame_of_state(data: bytes, rig: Mapping[str, Any] | None) -> Frame:
    """
    Return the frame in a message `state`, of a node that says on the topic `rig` what it is.

    It has no pairs. Raises ValueError for anything else.
    """
    _check_bytes(data)
    if rig is None:
        raise ValueError('no message `rig` has named its bodies yet')
    ((_, all_quantities, codes),) = blocks = list(read_state_blocks([data]))
    stamp = int(blocks[0].stamps[0])
    quantities = {name: _first(one) for name, one in all_quantities.items()}
    position, angle, velocity = (quantities.pop(name) for name in ('position', 'angle', 'velocity'))
    known = rig['bodies']
    bodies = tuple(body['name'] for body in known)
    if len(bodies) != len(position.value):
        raise ValueError(f'it has {len(position.value)} bodies, and `rig` names {len(bodies)}')
    if len(bodies) > _MOST_BODIES:
        raise ValueError(f'it has {len(bodies)} bodies; a page shows {_MOST_BODIES} at most')
    z, u = position.value, velocity.value
    columns = [part.tolist() for part in (z.real, z.imag, angle.value, u.real, u.imag)]
    lists = quantity_lists(quantities)
    nothing = [None] * len(bodies)
    frames: list[dict[str, Any] | None] = []
    for b, determined in enumerate(position.determined):
        pose = {name: float(column[b]) for name, column in zip(_POSE, columns, strict=True)}
        frames.append(
            pose | {name: lists.get(name, nothing)[b] for name in _SIZES} if determined else None
        )
    shown = 'pose', *withheld_quantities(4).values()
    texts = {name: texts_of(codes[name][0]) for name in shown if name in codes}
    along, seen = plane_axes(plane_of_rig(rig)), [body for body in known if body['size']]
    return Frame(
        stamp,
        along,
        Rig(bodies, tuple(name for name in _SIZES if name in lists), ()),
        frames,
        [],
        {body['name']: body['size'] for body in seen},
        {body['name']: body['outline'] for body in seen},
        [_reasons_of(texts, b) for b in range(len(bodies))],
    )


def _first(quantity: Numbers | Vectors) -> Any:
    return type(quantity)(*(part[0] for part in quantity))


def _reasons_of(texts: Mapping[str, np.ndarray], b: int) -> dict[str, str]:
    """Return the reasons of a body, '' for that of its pose, which is one for all."""
    if texts['pose'][b]:
        return {'': str(texts['pose'][b])}
    return {name: str(own[b]) for name, own in texts.items() if own[b]}


def _check_bytes(data: bytes) -> None:
    if len(data) > _MOST_BYTES:
        raise ValueError(f'it has {len(data)} bytes; a page takes {_MOST_BYTES} at most')


def _reasons(value: Any) -> dict[str, str]:
    if not isinstance(value, dict):
        raise ValueError(f'{value} in place of reasons')
    return {'' if name == 'all' else str(name): str(reason) for name, reason in value.items()}


def _body(body: Mapping[str, Any]) -> dict[str, Any]:
    pose = dict(zip(_POSE, _numbers([body[name] for name in _POSE], 5), strict=True))
    return pose | {name: _quantity(body.get(name), size) for name, size in _SIZES.items()}


def _quantity(values: Sequence[Any] | None, size: int) -> list[float] | None:
    return None if values is None else _numbers(values, size)


def _numbers(values: Sequence[Any], size: int) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != size or not all(map(math.isfinite, numbers)):
        raise ValueError(f'{values} in place of {size} finite numbers')
    return numbers
