"""
What a live page shows of one instant, as one message: figures of all bodies, and their outlines.

Pages look 30 times a second. From the topics of the figures they would have the node compute and
send each of them for every frame, at its rate; so there is one topic for them, at their pace.

It is JSON in a std_msgs/String. No standard message has rates and poles with covariances of several
bodies, a message of our own would need to be built where nothing else does, and arrays of numbers
could not leave out what is undetermined. JSON names its figures, and is what a page reads. It is
for pages: programs take the topics of the figures, each of its own type.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._loci import Build, Built
from kinpole_ros.messages._results import Output, outputs_of
from kinpole_ros.messages._state import STATE
from kinpole_ros.messages._types import PointCloud2, String, type_name
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES, Estimate, Numbers, Vectors
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.plane import XY, Plane, as_parameter, plane_of

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

# The topic, and how often there is something on it (s).
VIEW, _EVERY = 'view', 1 / 30
# Types of the topics that pages can show. A node has both, a bag of results the second.
PAGE_TOPICS = {VIEW: type_name(String), STATE: type_name(PointCloud2)}
# Beyond, relative centers are of bodies that follow each other alone.
_MOST_PAIRS = 6


def live_outputs(settings: Settings, theory: 'Theory | None') -> list[Output]:
    """All topics of a live node with these settings: also the one for pages."""
    view = _view(plane_of(settings.plane) or XY)
    highest = settings.derivative_order or 4
    return [*outputs_of(settings, theory), Output(VIEW, String, highest, view, _EVERY)]


def _view(given: Plane) -> Build:
    """The last of the instants, in the plane that is `given` where the estimate has none."""

    def build(estimate: Estimate) -> Built:
        last = len(estimate) - 1
        writer = Writer()
        figures = view_of(estimate[last], given)
        writer.string(json.dumps(figures, separators=(',', ':'), allow_nan=False))
        return [last], [bytes(writer.data)]

    return build


def view_of(estimate: Estimate, given: Plane) -> dict[str, Any]:
    """
    The figures of one instant, of shape (B,), in SI units to seven digits.

    `stamp` is in ns; `along` names the axes of the plane. Of each body only what is determined is
    there: its pose and velocity, numbers with their deviation, and poles as `_points` has them.
    `reasons` says of each other figure why it is not, under 'all' for the whole body.
    """
    bodies: list[dict[str, Any]] = [{'name': name} for name in estimate.bodies]
    place, velocity = estimate.origin(0), estimate.origin(1)
    for b, body in enumerate(bodies):
        body['reasons'] = estimate.reasons(b)
        if estimate.missing[b]:
            continue
        shape = estimate.shape[b]
        body['outline'] = [_short(z.real, z.imag) for z in shape[np.isfinite(shape)].tolist()]
        parts = place[b].real, place[b].imag, estimate.angle[0, b], velocity[b].real
        # 0 where it is not known.
        rest = velocity[b].imag, estimate.size[b] if estimate.size[b] > 0 else 0.0
        named = ('x', 'y', 'angle', 'vx', 'vy', 'size')
        body |= zip(named, _short(*parts, *rest), strict=True)
    quantities: dict[str, Numbers | Vectors] = {}
    for order, (rate, pole) in enumerate(zip(RATE_NAMES, POLE_NAMES, strict=True), 1):
        if order <= estimate.order:
            quantities |= {rate: estimate.rate(order), pole: estimate.pole(order)}
    if estimate.order >= 2:
        quantities['icr_velocity'] = estimate.icr_velocity
    if estimate.order >= 3:
        quantities['centrode_curvature'] = estimate.centrode_curvature
    figures = figures_of(quantities)
    for name, found in figures.items():
        for body, one in zip(bodies, found, strict=True):
            if one is not None and 'x' in body:
                body[name] = one
    plane = estimate.plane or given
    along = list(plane.name[:2])
    if plane.axes is None:
        along = [f'along {as_parameter(edge)}' for edge in plane.basis[:2]]
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
    """Quantities (B,) by name as pages take them; None where they are undetermined."""
    found = {}
    for name, quantity in quantities.items():
        if isinstance(quantity, Numbers):
            found[name] = _numbers(quantity)
        else:
            found[name] = _points(quantity) if name in POLE_NAMES else _vectors(quantity)
    return found


def _pairs(estimate: Estimate) -> list[dict[str, Any]]:
    """Relative centers of pairs (j, i), None where they are undetermined."""
    centers = _points(estimate.relative_icr)
    every = list(zip(*(part.tolist() for part in estimate.pairs), strict=True))
    few = len(every) <= _MOST_PAIRS
    return [
        {'bodies': [estimate.bodies[j], estimate.bodies[i]], 'icr': centers[k]}
        for k, (j, i) in enumerate(every)
        if few or j == i + 1
    ]


def _numbers(found: Numbers) -> list[list[float] | None]:
    """Numbers (n,) with their deviations."""
    rows = zip(found.value.tolist(), found.variance.tolist(), strict=True)
    return _known(found, [(value, math.sqrt(max(variance, 0.0))) for value, variance in rows])


def _vectors(found: Vectors) -> list[list[float] | None]:
    """Components of vectors (n,), and their deviations along them."""
    rows = []
    for value, ((xx, xy), (_, yy)) in _plain(found):
        unit = value / (abs(value) or 1.0)
        variance = unit.real**2 * xx + 2 * unit.real * unit.imag * xy + unit.imag**2 * yy
        rows.append((value.real, value.imag, math.sqrt(max(variance, 0.0))))
    return _known(found, rows)


def _points(found: Vectors) -> list[list[float] | None]:
    """Coordinates of points (n,), half axes of the ellipse of one deviation, its direction."""
    rows = []
    for value, ((xx, xy), (_, yy)) in _plain(found):
        middle, radius = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        half = (math.sqrt(max(part, 0.0)) for part in (middle + radius, middle - radius))
        rows.append((value.real, value.imag, *half, math.atan2(2 * xy, xx - yy) / 2))
    return _known(found, rows)


def _plain(found: Vectors) -> Iterable[tuple[complex, Any]]:
    """Values and covariances as Python's numbers, which are faster one by one."""
    return zip(found.value.tolist(), found.covariance.tolist(), strict=True)


def _known(found: Numbers | Vectors, rows: Sequence[tuple[float, ...]]) -> list[list[float] | None]:
    both = zip(rows, found.determined.tolist(), strict=True)
    return [_short(*row) if known and math.isfinite(sum(row)) else None for row, known in both]


def _short(*values: float) -> list[float]:
    """To seven digits."""
    return [float(f'{value:.7g}') for value in values]
