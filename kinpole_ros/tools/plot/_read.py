"""
The results in a bag, as series over time: all that a picture is drawn of.

Read from the messages alone, so a recording of the live node is as good as a replay.
"""

import shlex
from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, topics
from kinpole_ros.messages import DRAWING
from kinpole_ros.tools.plot._messages import outlines_of, read_rows
from kinpole_ros.tracking.plane import AXES, Plane, as_parameter, plane_along, plane_of, upward

POLES = ('icr', 'iap', 'ijp', 'isp')


class Series(NamedTuple):
    """
    One topic: `stamp` (T,) in ns, rising, and `value` (T,), complex where it is of the plane.

    `covariance` (T, 2, 2), NaN where not published.
    """

    stamp: np.ndarray
    value: np.ndarray
    covariance: np.ndarray


class Body(NamedTuple):
    """
    What a bag tells of one body: from odom at `stamp` (T,) in ns, the rest by topic in `series`.

    `position` (T,) complex, m, with `sigma` (T,) of a coordinate, and its `velocity`, m/s; `angle`
    (T,), rad; `rate` and its standard deviation `rate_sigma` (T,), rad/s; `size`, m, is twice the
    root mean square distance of the markers from their mean, NaN when it cannot be determined;
    `outline` (n,), complex, are its markers in the body's frame, as they were drawn last.
    """

    name: str
    stamp: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    rate_sigma: np.ndarray
    size: float
    series: dict[str, Series]
    velocity: np.ndarray
    sigma: np.ndarray
    outline: np.ndarray


class Results(NamedTuple):
    """
    A result bag: its plane, the bodies, and relative instant centers by names (j, i).

    `cut` says what a bag that is not whole lacks, '' for one that is, and `along` what x and y of
    the plane are in the frame of the markers.
    """

    plane: str
    bodies: list[Body]
    relative: dict[tuple[str, str], Series]
    cut: str
    along: tuple[str, str]


class Centrodes(NamedTuple):
    """
    Loci of the ICR, both complex (K,) in m: `fixed` in the plane, `moving` in the body's frame.

    Taken at `stamp` (K,) in ns, where the body turned at `rate` (K,), rad/s; `sigma` (K,), m, is
    how well the ICR is known, NaN where not published.
    """

    stamp: np.ndarray
    fixed: np.ndarray
    moving: np.ndarray
    rate: np.ndarray
    sigma: np.ndarray


def read_results(
    bag: str | Path, progress: Callable[[float], None] | None = None, every: bool = False
) -> Results:
    """
    The results of a bag, whatever node published them; exact answers of simulate are left out.

    Of the figures of a body, those that `plot` draws, or `every` one there is, with its deviation.
    `progress` is called with the fraction of bytes read. Raises BagError when there are none.
    """
    kinds = topics(bag)
    prefixes = [
        topic.removesuffix('/odom')
        for topic, kind in kinds.items()
        if topic.endswith('/odom') and topic.count('/') > 2 and kind == 'nav_msgs/msg/Odometry'
    ]
    prefixes = [name for name in prefixes if not name.rpartition('/')[0].endswith('/truth')]
    # The order in which the node has them: each one is related to all before it.
    prefixes.sort(key=lambda prefix: sum(t.startswith(f'{prefix}/wrt/') for t in kinds))
    relative = {
        topic: (prefix, f'{prefix.rpartition("/")[0]}/{topic.split("/")[-2]}')
        for prefix in prefixes
        for topic in kinds
        if topic.startswith(f'{prefix}/wrt/') and topic.endswith('/icr')
    }
    if not prefixes:
        raise BagError(
            f'{bag} holds no results (no odometry of a body); make them first: '
            f'kinpole replay {shlex.quote(str(bag))} --output RESULT.mcap'
        )
    of_body = _PARTS + _MORE_PARTS if every else _PARTS
    wanted = {f'{prefix}/{part}' for prefix in prefixes for part in ('odom', *of_body)}
    # Of a pole that comes with its covariance the plain one says nothing more.
    wanted -= {
        t.removesuffix('/with_covariance')
        for t in wanted & set(kinds)
        if t.endswith('/with_covariance')
    }
    deviations = {topic: f'{topic}/deviation' for topic in relative}
    nodes = {prefix.rpartition('/')[0] for prefix in prefixes}
    wanted |= {*relative, *deviations.values(), *(f'{node}/{DRAWING}' for node in nodes)}
    rows, drawings, cut = read_rows(bag, wanted, progress)
    bodies_there = [prefix for prefix in prefixes if f'{prefix}/odom' in rows]
    if not bodies_there:
        raise BagError(
            f'{bag} holds no pose of {", ".join(prefixes)}; see in its /diagnostics why, and '
            'whether the parameters name the markers as they are published'
        )
    prefixes = bodies_there
    odometry = {prefix: rows[f'{prefix}/odom'] for prefix in prefixes}
    plane = plane_of_motion(np.concatenate([values for _, values in odometry.values()]))
    nodes = {prefix.rpartition('/')[0] for prefix in prefixes}
    outlines = outlines_of(drawings)
    names = {
        prefix: prefix.rpartition('/')[2] if len(nodes) == 1 else prefix for prefix in prefixes
    }
    bodies = []
    for prefix, (stamp, values) in odometry.items():
        parts = {part: rows[name] for part in of_body if (name := f'{prefix}/{part}') in rows}
        for pole in POLES:
            if f'{pole}/with_covariance' in parts:
                parts[pole] = parts.pop(f'{pole}/with_covariance')
        series = {
            part: _series(*found, plane, part.removesuffix('/deviation') in _NUMBERS)
            for part, found in parts.items()
        }
        if f'{prefix}/{_CURVATURE}' in kinds:
            # Never estimated: the ICR was not seen to move, which is more than not recorded.
            series.setdefault(_CURVATURE, _series(np.empty(0, int), np.empty((0, 3)), plane, True))
        drawn = outlines.get(prefix, (0, np.empty((0, 3))))
        bodies.append(_body(names[prefix], stamp, values, plane, series, drawn))
    between = {
        (names[j], names[i]): _with_deviation(
            _series(*rows[topic], plane, False), rows.get(deviations[topic]), plane
        )
        for topic, (j, i) in relative.items()
        if topic in rows and j in names and i in names
    }
    along = (plane.name[0], plane.name[1])
    if plane.axes is None:
        along = (f'along {as_parameter(plane.basis[0])}', f'along {as_parameter(plane.basis[1])}')
    return Results(plane.name, bodies, between, cut, along)


def read_truth(bag: str | Path, results: Results) -> dict[str, dict[str, Series]]:
    """
    The exact answers of simulate in a bag: rates, curvature and u by body and topic.

    None where the plane is oblique.
    """
    wanted = {
        f'/kinpole/truth/{body.name}/{part}': (body.name, part)
        for body in results.bodies
        for part in ('angular_velocity', *_DRAWN, 'icr_velocity')
    }
    rows, _, _ = read_rows(bag, wanted, None)
    plane = plane_of(results.plane) if results.plane in AXES else None
    if plane is None:
        return {}
    found: dict[str, dict[str, Series]] = {body.name: {} for body in results.bodies}
    for topic, (stamp, values) in rows.items():
        body, part = wanted[topic]
        found[body][part] = _series(stamp, values, plane, part != 'icr_velocity')
    return found


def centrodes(body: Body) -> Centrodes:
    """Both centrodes of a body, at the instants at which its pose and its ICR are known."""
    if 'icr' not in body.series:
        none = np.empty(0)
        return Centrodes(none.astype(np.int64), none + 0j, none + 0j, none, none)
    icr = body.series['icr']
    stamp, own, other = np.intersect1d(body.stamp, icr.stamp, return_indices=True)
    fixed = icr.value[other]
    moving = (fixed - body.position[own]) * np.exp(-1j * body.angle[own])
    sigma = np.sqrt(np.trace(icr.covariance[other], axis1=1, axis2=2))
    return Centrodes(stamp, fixed, moving, body.rate[own], sigma)


# A normal so near to an axis is along it; more than so much about other axes is of no one plane.
_ROUNDING, _ELSEWHERE = 1e-9, 1e-3
_CURVATURE = 'centrode_curvature'
_NUMBERS = ('angular_acceleration', 'angular_jerk', _CURVATURE, 'angular_snap')
_DRAWN, _DRAWN_POLES = _NUMBERS[:3], POLES[:3]
_PARTS: tuple[str, ...] = (
    *_DRAWN,
    *_DRAWN_POLES,
    *(f'{pole}/with_covariance' for pole in _DRAWN_POLES),
    'icr_velocity',
    *(f'{name}/deviation' for name in (*_DRAWN, 'icr_velocity')),
)
_MORE_PARTS: tuple[str, ...] = (
    'angular_snap',
    'isp',
    'isp/with_covariance',
    'angular_snap/deviation',
)


def bodies_of(node: str, topics: Collection[str]) -> list[str]:
    """Bodies that a node publishes, by its topics, in its order: each is related to all before."""
    split = (topic.rsplit('/', 2) for topic in topics)
    bodies = [parts[1] for parts in split if parts[::2] == [node, 'odom']]
    return sorted(bodies, key=lambda b: sum(t.startswith(f'{node}/{b}/wrt/') for t in topics))


def _with_deviation(
    series: Series, deviation: tuple[np.ndarray, np.ndarray] | None, plane: Plane
) -> Series:
    """A series of points with the variances along the axes that are published beside it."""
    if deviation is None:
        return series
    stamp, values = deviation
    _, here, there = np.intersect1d(series.stamp, stamp, return_indices=True)
    both = plane.project(values[there])[0]
    covariance = series.covariance.copy()
    covariance[here] = 0.0
    covariance[here, 0, 0], covariance[here, 1, 1] = both.real**2, both.imag**2
    return series._replace(covariance=covariance)


def plane_of_motion(odometry: np.ndarray) -> Plane:
    """
    The plane whose normal the bodies turn about; where none turns, the one that was measured.

    Rows of `odometry` (T, 40): place, turn (a quaternion), rate, the covariances (3, 3) of the
    three, and velocity.
    """
    turns = np.concatenate((odometry[:, 3:6], odometry[:, 7:10]))
    squares = turns.T @ turns
    if not turns.any():
        # What is measured of turns is that about the normal.
        squares = np.linalg.pinv(odometry[:, 19:28].reshape(-1, 3, 3).sum(axis=0), hermitian=True)
    values, vectors = np.linalg.eigh(squares)
    normal = upward(vectors[:, -1])
    oblique = np.abs(normal).max() < 1 - _ROUNDING
    if oblique and values[1] < _ELSEWHERE * values[2]:
        return plane_along(normal)
    # From z on, so that a tie is the plane xy.
    z_first = [2, 0, 1]
    measure = np.abs(turns).sum(axis=0) if turns.any() else squares.diagonal()
    column = max(z_first, key=lambda axis: measure[axis])
    plane = plane_of(next(name for name, axes in AXES.items() if axes[2] == column))
    assert plane is not None
    return plane


def _series(stamp: np.ndarray, values: np.ndarray, plane: Plane, number: bool) -> Series:
    covariance = np.full((len(stamp), 2, 2), np.nan)
    across = plane.basis[:2]
    if values.shape[1] > 3:
        matrix = values[:, 3:].reshape(-1, 6, 6)[:, :3, :3]
        covariance = across @ matrix @ across.T
    flat, along = plane.project(values[:, :3])
    return Series(stamp, along if number else flat, covariance)


def _body(
    name: str,
    stamp: np.ndarray,
    values: np.ndarray,
    plane: Plane,
    series: dict[str, Series],
    drawn: tuple[int, np.ndarray],
) -> Body:
    first, normal = plane.basis[0], plane.normal
    place, turn, rate = np.moveaxis(values[:, 10:37].reshape(-1, 3, 3, 3), 1, 0)
    spread, turn_spread = first @ place @ first, normal @ turn @ normal
    with np.errstate(divide='ignore', invalid='ignore'):
        # The noise of the markers moves their mean and turns them about it: that ratio is a length.
        size = 2 * np.sqrt(np.median(spread) / np.median(turn_spread))
    angle = 2 * np.arctan2(values[:, 3:6] @ normal, values[:, 6])
    position = plane.project(values[:, :3])[0]
    # A recording may end between a drawing and its poses.
    here = np.flatnonzero(stamp == drawn[0])[:1]
    corners = plane.project(drawn[1])[0] if len(here) else np.empty(0, complex)
    outline = (corners - position[here]) * np.exp(-1j * angle[here])
    return Body(
        name,
        stamp,
        position,
        angle,
        values[:, 7:10] @ normal,
        np.sqrt(np.maximum(normal @ rate @ normal, 0)),
        float(size) if np.isfinite(size) else float('nan'),
        series,
        # The twist is in the frame of the body.
        plane.project(values[:, 37:40])[0] * np.exp(1j * angle),
        np.sqrt(np.maximum(spread, 0)),
        outline,
    )
