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

from kinpole_ros.messages._cdr import serialize_message
from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.messages._state import STATE, quantities_of
from kinpole_ros.messages._types import PointCloud2, String, type_name
from kinpole_ros.tracking.estimate import POLE_NAMES, Estimate, Numbers, Vectors
from kinpole_ros.tracking.plane import Plane, as_parameter

VIEW = 'view'
"""The topic."""
VIEW_INTERVAL = 1 / 30  # s between messages
# Types of the topics that pages can show. A node has both, a bag of results the second.
PAGE_TOPICS = {VIEW: type_name(String), STATE: type_name(PointCloud2)}
_MAX_PAIRS = 6  # of more pairs, pages show those of consecutive bodies alone


def view(given: Plane) -> Build:
    """Return a function that writes the last instant; `given` is the plane of estimates without."""

    def build(estimate: Estimate) -> Built:
        last = len(estimate) - 1
        text = json.dumps(view_of(estimate[last], given), separators=(',', ':'), allow_nan=False)
        return [last], [serialize_message(String(data=text))]

    return build


def view_of(estimate: Estimate, given: Plane) -> dict[str, Any]:
    """
    Return what pages show of one instant, in SI units to seven digits.

    Parameters
    ----------
    estimate : Estimate
        One instant, of shape (B,).
    given : Plane
        The plane of an estimate that has none.

    Returns
    -------
    dict
        `stamp`, ns; `along`, the names of the axes of the plane; `figures`, the names of the
        quantities; `bodies`; `pairs`. A body has `name`, its pose, velocity and `outline` where it
        is determined, the quantities that are determined, as `figures_of` has them, and `reasons`:
        why each other quantity is undetermined, under 'all' for the whole body.
    """
    bodies: list[dict[str, Any]] = [{'name': name} for name in estimate.bodies]
    position, velocity = estimate.origin(0), estimate.origin(1)
    for b, body in enumerate(bodies):
        body['reasons'] = estimate.reasons(b)
        if estimate.missing[b]:
            continue
        shape = estimate.shape[b]
        body['outline'] = [_rounded(z.real, z.imag) for z in shape[np.isfinite(shape)].tolist()]
        size = estimate.size[b] if estimate.size[b] > 0 else 0.0  # 0: not known
        (x, y), (vx, vy) = ((value[b].real, value[b].imag) for value in (position, velocity))
        values = _rounded(x, y, estimate.angle[0, b], vx, vy, size)
        body |= zip(('x', 'y', 'angle', 'vx', 'vy', 'size'), values, strict=True)
    figures = figures_of(quantities_of(estimate, estimate.order))
    for name, values_of_bodies in figures.items():
        for body, value in zip(bodies, values_of_bodies, strict=True):
            if value is not None and 'x' in body:
                body[name] = value
    plane = estimate.plane or given
    along = list(plane.name[:2])
    if plane.axes is None:
        along = [f'along {as_parameter(axis)}' for axis in plane.basis[:2]]
    return {
        'stamp': int(estimate.stamp),
        'along': along,
        'figures': list(figures),
        'bodies': bodies,
        'pairs': _pairs(estimate),
    }


def figures_of(
    quantities: Mapping[str, Numbers | Vectors],
) -> dict[str, list[list[float] | None]]:
    """
    Return quantities as pages read them.

    Parameters
    ----------
    quantities : mapping of str to Numbers or Vectors
        Quantities (B,) by name.

    Returns
    -------
    dict
        By name, a list for each body, None where the quantity is undetermined. A number is
        followed by its standard deviation, a vector by its standard deviation along it, and a
        pole by the half axes of its ellipse of one standard deviation and the direction of the
        first, rad.
    """
    figures = {}
    for name, quantity in quantities.items():
        if isinstance(quantity, Numbers):
            figures[name] = _numbers(quantity)
        else:
            figures[name] = _points(quantity) if name in POLE_NAMES else _vectors(quantity)
    return figures


def _pairs(estimate: Estimate) -> list[dict[str, Any]]:
    """Relative centers of pairs (j, i), None where they are undetermined."""
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
    return _determined(numbers, values)


def _vectors(vectors: Vectors) -> list[list[float] | None]:
    rows = []
    for value, ((xx, xy), (_, yy)) in _plain(vectors):
        unit = value / (abs(value) or 1.0)
        variance = unit.real**2 * xx + 2 * unit.real * unit.imag * xy + unit.imag**2 * yy
        rows.append((value.real, value.imag, math.sqrt(max(variance, 0.0))))
    return _determined(vectors, rows)


def _points(points: Vectors) -> list[list[float] | None]:
    rows = []
    for value, ((xx, xy), (_, yy)) in _plain(points):
        middle, radius = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        half_axes = (math.sqrt(max(v, 0.0)) for v in (middle + radius, middle - radius))
        rows.append((value.real, value.imag, *half_axes, math.atan2(2 * xy, xx - yy) / 2))
    return _determined(points, rows)


def _plain(vectors: Vectors) -> Iterable[tuple[complex, Any]]:
    """Values and covariances as numbers of Python, which are faster one by one."""
    return zip(vectors.value.tolist(), vectors.covariance.tolist(), strict=True)


def _determined(
    quantity: Numbers | Vectors, rows: Sequence[tuple[float, ...]]
) -> list[list[float] | None]:
    """The rows of the quantity that are determined and finite, None for the others."""
    return [
        _rounded(*row) if determined and math.isfinite(sum(row)) else None
        for row, determined in zip(rows, quantity.determined.tolist(), strict=True)
    ]


def _rounded(*values: float) -> list[float]:
    """To seven digits."""
    return [float(f'{value:.7g}') for value in values]
