"""
The figures of one instant as a node sends them to pages, and as a page takes them.

What comes from the network may be anything, so all that goes on is looked at.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from kinpole_ros.messages import String, deserialize_message, figures_of, read_state
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES

# How many numbers a figure of a body has: of a pole its place, and its ellipse.
_POSE = ('x', 'y', 'angle', 'vx', 'vy')
_POINT = 5
_LATEST = 1 << 63
# Bodies, and pairs of them, in a message: with so many a page is told of joints in 0.03 s.
_MOST_BODIES = 200
_MOST_BYTES = 1 << 20  # of a message: five times what so many bodies take
_SIZES = {
    **dict.fromkeys((*RATE_NAMES, 'centrode_curvature'), 2),
    **dict.fromkeys(POLE_NAMES, _POINT),
    'icr_velocity': 3,
}


class Rig(NamedTuple):
    """What a node measures: bodies in its order, figures of each, and pairs (j, i)."""

    bodies: tuple[str, ...]
    figures: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]


class Frame(NamedTuple):
    """
    One instant, `stamp` in ns, in a plane with axes of these names.

    `bodies` and `pairs` are as a page takes them, None where nothing is known. By body `sizes`, m,
    and `outlines`, markers (n, 2) in its frame, m.
    """

    stamp: int
    along: tuple[str, str]
    rig: Rig
    bodies: list[dict[str, Any] | None]
    pairs: list[list[float] | None]
    sizes: dict[str, float]
    outlines: dict[str, list[list[float]]]
    # Of each body why figures are not known, '' for all of them; None of a node that does not say.
    reasons: list[dict[str, str] | None]

    def as_json(self, seconds: float, published: int) -> str:
        """The figures as a page takes them; `published` in ns."""
        frame = {'t': round(seconds, 6), 'published': published / 1e6}
        figures = {'bodies': self.bodies, 'pairs': self.pairs, 'reasons': self.reasons}
        return json.dumps({**frame, **figures}, separators=(',', ':'), allow_nan=False)


def frame_of(data: bytes) -> Frame:
    """What is in a message to pages. Raises ValueError for anything else."""
    if len(data) > _MOST_BYTES:
        raise ValueError(f'it has {len(data)} bytes; a page takes {_MOST_BYTES} at most')
    try:
        said = json.loads(deserialize_message(data, String).data)
        names = tuple(str(body['name']) for body in said['bodies'])
        pairs = tuple((str(j), str(i)) for j, i in (pair['bodies'] for pair in said['pairs']))
        if max(len(names), len(pairs)) > _MOST_BODIES:
            raise ValueError(
                f'it has {len(names)} bodies and {len(pairs)} pairs of them; a page shows '
                f'{_MOST_BODIES} of each at most'
            )
        if not {name for pair in pairs for name in pair} <= {*names}:
            raise ValueError('a pair of unknown bodies')
        first, second = said['along']
        stamp = int(said['stamp'])
        if not 0 <= stamp < _LATEST:
            raise ValueError(f'{stamp} is no stamp')
        seen = [body for body in said['bodies'] if 'x' in body]
        return Frame(
            stamp,
            (str(first), str(second)),
            Rig(names, tuple(name for name in _SIZES if name in said['figures']), pairs),
            [_body(body) if 'x' in body else None for body in said['bodies']],
            [_figure(pair['icr'], _POINT) for pair in said['pairs']],
            {str(body['name']): _numbers([body['size']], 1)[0] for body in seen},
            {str(body['name']): [_numbers(z, 2) for z in body['outline']] for body in seen},
            [_reasons(body.get('reasons')) for body in said['bodies']],
        )
    except (KeyError, TypeError, RecursionError, OverflowError) as error:
        raise ValueError(f'no figures for a page ({error!r})') from None


def frame_of_state(data: bytes, names: Sequence[str]) -> Frame:
    """
    Return what is in a message of the topic `state`, whose bodies have the first of these names.

    It has no outlines, no pairs and no reasons. Raises ValueError for anything else.
    """
    if len(data) > _MOST_BYTES:
        raise ValueError(f'it has {len(data)} bytes; a page takes {_MOST_BYTES} at most')
    stamp, quantities = read_state(data)
    place, angle, velocity = (quantities.pop(name) for name in ('position', 'angle', 'velocity'))
    bodies = tuple(names[: len(place.value)])
    if len(bodies) < len(place.value):
        raise ValueError('no diagnostics have named its bodies yet')
    if len(bodies) > _MOST_BODIES:
        raise ValueError(f'it has {len(bodies)} bodies; a page shows {_MOST_BODIES} at most')
    poses = (
        place.value.real,
        place.value.imag,
        angle.value,
        velocity.value.real,
        velocity.value.imag,
    )
    figures = figures_of(quantities)
    found: list[dict[str, Any] | None] = []
    for b, known in enumerate(place.determined):
        pose = dict(zip(_POSE, (float(part[b]) for part in poses), strict=True))
        found.append({**pose, **{name: figures[name][b] for name in figures}} if known else None)
    rig = Rig(bodies, tuple(name for name in _SIZES if name in figures), ())
    return Frame(stamp, ('x', 'y'), rig, found, [], {}, {}, [None] * len(bodies))


def _reasons(said: Any) -> dict[str, str] | None:
    if said is None:
        return None
    if not isinstance(said, dict):
        raise ValueError(f'{said} in place of reasons')
    return {'' if name == 'all' else str(name): str(why) for name, why in said.items()}


def _body(said: Mapping[str, Any]) -> dict[str, Any]:
    pose = dict(zip(_POSE, _numbers([said[name] for name in _POSE], 5), strict=True))
    return {**pose, **{name: _figure(said.get(name), size) for name, size in _SIZES.items()}}


def _figure(said: Sequence[Any] | None, size: int) -> list[float] | None:
    return None if said is None else _numbers(said, size)


def _numbers(said: Sequence[Any], size: int) -> list[float]:
    found = [float(value) for value in said]
    if len(found) != size or not all(map(math.isfinite, found)):
        raise ValueError(f'{said} in place of {size} finite numbers')
    return found
