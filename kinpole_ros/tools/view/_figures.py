"""The figures of one instant, from the messages of a node, as a page takes them."""

import json
import math
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.messages import DRAWING
from kinpole_ros.pipeline.estimate import POLE_NAMES, RATE_NAMES
from kinpole_ros.rigid.plane import Plane
from kinpole_ros.tools.plot import bodies_of, row_of

# By subject, a body or (j, i), and by figure, as columns of a record.
Figures: TypeAlias = dict[tuple[str | tuple[str, str], str], Any]
# Topics of each figure of a body under its name; its pose and angular velocity are always there.
_OF_BODY = {
    **{name: (name, f'{name}/deviation') for name in (*RATE_NAMES[1:], 'centrode_curvature')},
    **{name: (f'{name}/with_covariance',) for name in POLE_NAMES},
    'icr_velocity': ('icr_velocity', 'icr_velocity/deviation'),
}
_OF_PAIR = ('icr', 'icr/deviation')
_ODOM = 'odom'
# Beyond, relative centers are of bodies that follow each other alone.
_MOST_PAIRS = 6


class Rig(NamedTuple):
    """A node that publishes: full name, bodies in its order, pairs (j, i), types by whole topic."""

    node: str
    bodies: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    kinds: Mapping[str, str]

    def topics(self, shown: frozenset[str]) -> dict[str, str]:
        """Topics, with types, that these figures need."""
        names = []
        parts = [part for figure in _OF_BODY if figure in shown for part in _OF_BODY[figure]]
        names += [f'{body}/{part}' for body in self.bodies for part in parts]
        if 'relative' in shown:
            names += [f'{j}/wrt/{i}/{part}' for j, i in self.pairs for part in _OF_PAIR]
        whole = self.poses + [f'{self.node}/{name}' for name in names]
        return {name: self.kinds[name] for name in whole if name in self.kinds}

    @property
    def drawing(self) -> str:
        """The topic of what is drawn."""
        return f'{self.node}/{DRAWING}'

    @property
    def poses(self) -> list[str]:
        """Topics of the poses of bodies."""
        return [f'{self.node}/{body}/{_ODOM}' for body in self.bodies]

    @property
    def figures(self) -> list[str]:
        """Figures that are published of any body."""
        return [
            figure
            for figure, parts in _OF_BODY.items()
            if any(f'{self.node}/{body}/{parts[0]}' in self.kinds for body in self.bodies)
        ]


def rig_of(node: str, kinds: Mapping[str, str]) -> Rig:
    """What a node of this name publishes, by its topics."""
    bodies = bodies_of(node, kinds)
    pairs = [(j, i) for n, j in enumerate(bodies) for i in bodies[:n]]
    if len(pairs) > _MOST_PAIRS:
        pairs = list(zip(bodies[1:], bodies, strict=False))
    pairs = [(j, i) for j, i in pairs if f'{node}/{j}/wrt/{i}/icr' in kinds]
    rig = Rig(node, tuple(bodies), tuple(pairs), kinds)
    ours = rig.topics(frozenset([*_OF_BODY, 'relative']))
    if rig.drawing in kinds:
        ours[rig.drawing] = kinds[rig.drawing]
    return rig._replace(kinds=ours)


def stamp_of(data: bytes, at: int = 4) -> int:
    """The stamp, ns, of a message, whose header is first in it, or at that place; struct.error."""
    order = '<iI' if data[1:2] == b'\x01' else '>iI'
    seconds, rest = struct.unpack_from(order, data, at)
    return int(seconds) * 1_000_000_000 + int(rest)


def common_instant(
    stamps: Mapping[str, Sequence[int]], poses: Sequence[str], last: int | None
) -> int | None:
    """
    The instant that most topics tell of, the newest of these; of those of the `poses`.

    `stamps` are the last few of each topic as they came: those of one instant come one after the
    other, so some topics may not have told of the newest yet. None where that is the `last` one, or
    one that came before it.
    """
    counts = Counter(stamp for one in stamps.values() for stamp in set(one))
    # By how they came and not by their size, as a clock may step back.
    came = {stamp: n for pose in poses for n, stamp in enumerate(stamps.get(pose, ()))}
    if not came:
        return None
    found = max(came, key=lambda stamp: (counts[stamp], came[stamp], stamp))
    return None if last in came and came[found] <= came[last] else found


def figures_of(rig: Rig, messages: Mapping[str, bytes], plane: Plane) -> Figures:
    """All figures in messages of one instant, by whole topic."""

    def row(topic: str) -> np.ndarray | None:
        name = f'{rig.node}/{topic}'
        data = messages.get(name)
        return None if data is None else np.array(row_of(rig.kinds[name], data))

    found: Figures = {}
    for body in rig.bodies:
        pose = row(f'{body}/{_ODOM}')
        if pose is None:
            continue
        _add_pose(found, body, pose, plane)
        for name in (*RATE_NAMES[1:], 'centrode_curvature'):
            value, sigma = row(f'{body}/{name}'), row(f'{body}/{name}/deviation')
            if value is not None:
                found[body, name] = plane.normal @ value
                found[body, f'{name}_sigma'] = None if sigma is None else plane.normal @ sigma
        for name in POLE_NAMES:
            pole = row(f'{body}/{name}/with_covariance')
            if pole is not None:
                across = plane.basis[:2]
                covariance = across @ pole[3:].reshape(6, 6)[:3, :3] @ across.T
                found[body, name] = complex(*(across @ pole[:3]))
                found[body, f'{name}_covariance'] = covariance
        _add_vector(found, body, 'icr_velocity', plane, row, body)
    for j, i in rig.pairs:
        _add_vector(found, (j, i), 'icr', plane, row, f'{j}/wrt/{i}')
    return found


def _add_pose(found: Figures, body: str, pose: np.ndarray, plane: Plane) -> None:
    first, second, normal = plane.basis
    angle = 2 * math.atan2(normal @ pose[3:6], pose[6])
    found[body, 'position'] = complex(first @ pose[:3], second @ pose[:3])
    found[body, 'angle'] = angle
    found[body, 'angular_velocity'] = normal @ pose[7:10]
    rate = normal @ pose[28:37].reshape(3, 3) @ normal
    found[body, 'angular_velocity_sigma'] = math.sqrt(max(rate, 0.0))
    own = complex(first @ pose[37:40], second @ pose[37:40])
    # The twist is in the frame of the body.
    found[body, 'velocity'] = own * complex(math.cos(angle), math.sin(angle))


def _add_vector(
    found: Figures, subject: Any, name: str, plane: Plane, row: Any, prefix: str
) -> None:
    """A vector of the plane whose deviations along the axes are on a topic beside it."""
    value, deviation = row(f'{prefix}/{name}'), row(f'{prefix}/{name}/deviation')
    if value is None:
        return
    across = plane.basis[:2]
    found[subject, name] = complex(*(across @ value))
    spread = np.full(2, np.nan) if deviation is None else across @ deviation
    found[subject, f'{name}_covariance'] = np.diag(spread**2)


def as_json(rig: Rig, figures: Figures, seconds: float, published: int) -> str:
    """The figures of an instant as a page takes them; `published` in ns."""
    bodies = [_body(figures, body) for body in rig.bodies]
    pairs = [_point(figures, pair, 'icr') for pair in rig.pairs]
    frame = {'t': round(seconds, 6), 'published': published / 1e6, 'bodies': bodies, 'pairs': pairs}
    return json.dumps(frame, separators=(',', ':'), allow_nan=False)


def _body(figures: Figures, body: str) -> dict[str, Any] | None:
    if (body, 'position') not in figures:
        return None
    place, velocity = figures[body, 'position'], figures[body, 'velocity']
    found: dict[str, Any] = {
        'x': _short(place.real),
        'y': _short(place.imag),
        'angle': _short(figures[body, 'angle']),
        'vx': _short(velocity.real),
        'vy': _short(velocity.imag),
    }
    for name in (*RATE_NAMES, 'centrode_curvature'):
        if (body, name) in figures:
            found[name] = [_short(figures[body, name]), _short(figures[body, f'{name}_sigma'])]
    for name in POLE_NAMES:
        found[name] = _point(figures, body, name)
    if (body, 'icr_velocity') in figures:
        u, covariance = (figures[body, f'icr_velocity{end}'] for end in ('', '_covariance'))
        along = np.array([u.real, u.imag]) / (abs(u) or 1.0)
        sigma = math.sqrt(max(along @ covariance @ along, 0.0))
        found['icr_velocity'] = [_short(u.real), _short(u.imag), _short(sigma)]
    return found


def _point(figures: Figures, subject: Any, name: str) -> list[float | None] | None:
    """Coordinates, half axes of the ellipse of one deviation, and its direction."""
    if (subject, name) not in figures:
        return None
    value, ((xx, xy), (_, yy)) = figures[subject, name], figures[subject, f'{name}_covariance']
    middle, radius = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    half = [math.sqrt(max(part, 0.0)) for part in (middle + radius, middle - radius)]
    direction = math.atan2(2 * xy, xx - yy) / 2
    return [_short(each) for each in (value.real, value.imag, *half, direction)]


def _short(value: float | None) -> float | None:
    """To seven digits; None where there is no number."""
    return None if value is None or not math.isfinite(value) else float(f'{value:.7g}')
