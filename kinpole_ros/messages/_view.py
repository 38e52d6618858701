"""
The topic `view`: what a live page shows of one instant, as JSON in a std_msgs/String.

Pages need 30 instants a second. If they subscribed to the topics of results, the node would compute
and send each of them for every frame, so pages have one topic of their own. JSON, because no
standard message has rates and poles with covariances of several bodies, a message type of its own
would have to be built, and pages read JSON. Programs subscribe to the topics of results.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.messages._state import STATE
from kinpole_ros.messages._types import PointCloud2, String, serialize_message, type_name
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import Plane, plane_axes
from kinpole_ros.tracking.values import Numbers, Vectors, ellipse_axes, sigma_along

VIEW = 'view'
"""The topic."""
VIEW_INTERVAL = 1 / 30  # s between messages
# Types of the topics that pages can show: a live node publishes both, a bag of results has `state`.
PAGE_TOPICS = {VIEW: type_name(String), STATE: type_name(PointCloud2)}
_MAX_PAIRS = 6  # with more pairs than this, pages show only those of consecutive bodies
_SIGNIFICANT_DIGITS = 7
# Decimals that are kept of larger numbers too: in a map, coordinates of 5e6 m have to show motions
# of micrometers.
_LEAST_DECIMALS = 6


def view_builder(default_plane: Plane) -> Build:
    """Return the function that makes the message `view` of the last instant of an estimate."""

    def build(estimate: Estimate) -> Built:
        last = len(estimate) - 1
        view = view_of(estimate[last], default_plane)
        text = json.dumps(view, separators=(',', ':'), allow_nan=False)
        return [last], [serialize_message(String(data=text))]

    return build


def view_of(estimate: Estimate, default_plane: Plane) -> dict[str, Any]:
    """
    Return what pages show of one instant (B,), in SI units, rounded to seven digits or micrometers.

    `stamp`, ns; `along`, the names of the axes of the plane; `figures`, the names of the
    quantities; `bodies`, each with `name` and `reasons`; `pairs`. A body with a pose also has `x`,
    `y`, `angle`, `vx`, `vy` of its frame, `size` (0 if unknown), the markers `outline` in its
    frame, and the quantities that are determined, as in `quantity_lists`. `reasons` say why the
    others are undetermined, under 'all' for the whole body.
    """
    bodies: list[dict[str, Any]] = []
    determined = estimate.quantities(estimate.order)
    if estimate.order >= 3:
        determined['ball_point'] = estimate.ball_point
    quantities = quantity_lists(determined)
    for b, name in enumerate(estimate.bodies):
        body = {'name': name, 'reasons': estimate.reasons(b)} | _pose(estimate, b)
        if 'x' in body:
            of_body = {quantity: values[b] for quantity, values in quantities.items()}
            body |= {quantity: value for quantity, value in of_body.items() if value is not None}
        bodies.append(body)
    plane = estimate.plane or default_plane
    along = list(plane_axes(plane))
    return {
        'stamp': int(estimate.stamp),
        'along': along,
        'figures': list(quantities),
        'bodies': bodies,
        'pairs': _pairs(estimate),
    }


def _pose(estimate: Estimate, b: int) -> dict[str, Any]:
    """Return pose, velocity, size and outline of a body; nothing where they are not determined."""
    position, velocity = (complex(estimate.origin(order)[b]) for order in (0, 1))
    pose = position.real, position.imag, float(estimate.angle[0, b]), velocity.real, velocity.imag
    if estimate.reason[b] or not math.isfinite(sum(pose)):
        return {}
    size, shape = float(estimate.size[b]), estimate.shape[b]
    values = _rounded(*pose, size if 0 < size < math.inf else 0.0)
    return {
        'outline': [_rounded(z.real, z.imag) for z in shape[np.isfinite(shape)].tolist()],
        **dict(zip(('x', 'y', 'angle', 'vx', 'vy', 'size'), values, strict=True)),
    }


def quantity_lists(
    quantities: Mapping[str, Numbers | Vectors],
) -> dict[str, list[list[float] | None]]:
    """
    Return quantities (B,) as pages read them: by name a list for each body, None if undetermined.

    It is of a number [value, standard deviation]; of a velocity [x, y, standard deviation of its
    length]; of a point [x, y, major, minor, direction], with the semi-axes of its ellipse of one
    standard deviation and the direction of the major one, rad.
    """
    lists = {}
    for name, quantity in quantities.items():
        if isinstance(quantity, Numbers):
            lists[name] = _numbers(quantity)
        else:
            is_velocity = name == 'icr_velocity'
            lists[name] = _vectors(quantity) if is_velocity else _points(quantity)
    return lists


def _pairs(estimate: Estimate) -> list[dict[str, Any]]:
    """Relative centers of pairs (j, i), i before j, None where they are undetermined."""
    centers = _points(estimate.relative_icr)
    pairs = list(zip(*(bodies.tolist() for bodies in estimate.pairs), strict=True))
    are_few = len(pairs) <= _MAX_PAIRS
    return [
        {'bodies': [estimate.bodies[j], estimate.bodies[i]], 'icr': centers[k]}
        for k, (j, i) in enumerate(pairs)
        if are_few or j == i + 1
    ]


def _numbers(numbers: Numbers) -> list[list[float] | None]:
    rows = zip(numbers.value.tolist(), numbers.variance.tolist(), strict=True)
    values = [(value, math.sqrt(max(variance, 0.0))) for value, variance in rows]
    return _none_if_undetermined(numbers, values)


def _vectors(vectors: Vectors) -> list[list[float] | None]:
    # Of a vector without a direction, the largest of all directions.
    largest, _, _ = ellipse_axes(vectors.covariance)
    sigma = np.where(vectors.value, sigma_along(vectors.value, vectors.covariance), largest)
    return _with_columns(vectors, sigma)


def _points(points: Vectors) -> list[list[float] | None]:
    return _with_columns(points, *ellipse_axes(points.covariance))


def _with_columns(vectors: Vectors, *columns: np.ndarray) -> list[list[float] | None]:
    """Coordinates, followed by other columns (B,)."""
    rows = np.stack((vectors.value.real, vectors.value.imag, *columns), axis=-1)
    return _none_if_undetermined(vectors, rows.tolist())


def _none_if_undetermined(
    quantity: Numbers | Vectors, rows: Iterable[Sequence[float]]
) -> list[list[float] | None]:
    return [
        _rounded(*row) if determined and math.isfinite(sum(row)) else None
        for row, determined in zip(rows, quantity.determined.tolist(), strict=True)
    ]


def _rounded(*values: float) -> list[float]:
    least = 10.0 ** (_SIGNIFICANT_DIGITS - _LEAST_DECIMALS)
    return [
        float(f'{value:.{_SIGNIFICANT_DIGITS}g}')
        if abs(value) < least
        else round(value, _LEAST_DECIMALS)
        for value in values
    ]
