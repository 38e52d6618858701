"""
The topic `rig`: what a subscriber has to know to read the topic `state`, as JSON in a String.

It is for programs, as `robot_description` is: which row is which body, the plane, sizes, outlines,
markers, parameters, and the names of quantities and reasons. It is latched, so that a subscriber
that comes late has it, and sent anew when what it says changes.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from kinpole_ros.messages._results import OF_BODY
from kinpole_ros.messages._state import quantity_fields
from kinpole_ros.messages._types import (
    MessageError,
    String,
    deserialize_message,
    serialize_message,
)
from kinpole_ros.tracking.plane import AXES, XY, Plane
from kinpole_ros.tracking.reasons import REASONS, TABLE
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import measured_pairs

RIG = 'rig'
"""The topic."""
SCHEMA = 1
"""The version of what the message has; it changes where a reader has to."""
# Places are rounded to this share of the size of their body, and noise to two digits: what is
# learned changes less than that, and no message is sent for it.
_OF_SIZE = 1e-5
_UNITS = {row.name: row.unit for row in OF_BODY} | {
    'position': 'm',
    'angle': 'rad',
    'velocity': 'm/s',
    'inflection_diameter': 'm',
}


def rig_of(
    tracker: Tracker, run: int, registered: Sequence[RegisteredQuantity] = ()
) -> dict[str, Any]:
    """
    Return what the topic `rig` says: its schema is in docs/interfaces.md.

    Parameters
    ----------
    tracker : Tracker
        Its parameters, and what it knows now.
    run : int
        Another number for each start, with other frames of the bodies.
    registered : sequence of RegisteredQuantity
        Quantities of another package, of which those of bodies have fields in `state`.

    Returns
    -------
    dict
        Values of JSON, in SI units; None is what is not known yet.

    """
    settings = tracker.settings
    bodies = tracker.bodies
    return {
        'schema': SCHEMA,
        'run': run,
        'frame_id': tracker.frame_id,
        'plane': None if tracker.plane is None else _plane(tracker.plane),
        'bodies': list(_bodies(tracker)),
        'pairs': [[bodies[j], bodies[i]] for i, j in measured_pairs(len(bodies))],
        'joints': {name: list(joint) for name, joint in settings.joints.items()},
        'window': settings.window,
        'lag': settings.lag,
        'order': settings.highest_order,
        'noise': settings.noise,
        'quantities': [
            {'name': name, 'unit': _UNITS.get(name) or _unit(name, registered), **fields}
            for name, fields in quantity_fields(settings.highest_order, registered).items()
        ],
        'reasons': [{'name': name, **TABLE[name]._asdict()} for name in REASONS],
    }


def _unit(name: str, registered: Sequence[RegisteredQuantity]) -> str:
    return next(one.unit for one in registered if one.topic.partition('/')[2] == name)


def _plane(plane: Plane) -> dict[str, Any]:
    axes = zip(('x', 'y', 'normal'), plane.basis.tolist(), strict=True)
    return {'name': plane.name, **dict(axes)}


def _bodies(tracker: Tracker) -> Iterator[dict[str, Any]]:
    """Yield what is known of each body, in the order of the rows of `state`."""
    prefix, names, places = tracker.settings.frame_prefix, tracker.markers, tracker.places()
    known = tracker.sizes(), tracker.noise(), tracker.pins()
    sizes, noise, pins = (part.tolist() for part in known)
    for b, body in enumerate(tracker.bodies):
        step = 10.0 ** math.floor(math.log10(_OF_SIZE * sizes[b])) if sizes[b] > 0 else 0.0
        own = [_point(place, step) for place in places[b].tolist()]
        yield {
            'name': body,
            'frame': f'{prefix}{body}',
            'size': float(f'{sizes[b]:.5g}') if step else None,
            'noise': float(f'{noise[b]:.2g}') if math.isfinite(noise[b]) else None,
            'pin': _point(pins[b], step),
            # A pose has no places of markers.
            'markers': {
                name: own[k] if tracker.has_markers else None for k, name in enumerate(names[b])
            },
            'outline': [place for place in own if place is not None],
        }


def _point(value: complex, step: float) -> list[float] | None:
    """Return a point rounded to a step, m; None for one that is not known."""
    if not step or not np.isfinite(value):
        return None
    decimals = -round(math.log10(step))
    return [round(value.real, decimals), round(value.imag, decimals)]


class RigChanges:
    """
    The messages of the topic `rig` of trackers, one where it says something new.

    Runs are counted from the number after `before` on.
    """

    def __init__(self, before: int = 0) -> None:
        self._run = before
        self._last: dict[str, Any] = {}
        # That of the tracker in the last message.
        self._run_of_tracker = 0

    def is_of(self, run: int) -> bool:
        """Whether the last message was of this run of a tracker."""
        return run == self._run_of_tracker

    def message(
        self, tracker: Tracker, registered: Sequence[RegisteredQuantity] = ()
    ) -> bytes | None:
        """Return the message, None where it would be that before; otherwise as `rig_of`."""
        self._run += not self.is_of(tracker.run)
        self._run_of_tracker = tracker.run
        now = rig_of(tracker, self._run, registered)
        if now == self._last:
            return None
        self._last = now
        return serialize_message(String(data=json.dumps(now, allow_nan=False)))


def read_rig(data: bytes) -> dict[str, Any]:
    """
    Read a message of the topic `rig`.

    Parameters
    ----------
    data : bytes
        The serialized message.

    Returns
    -------
    dict
        As `rig_of` returns it.

    Raises
    ------
    ValueError
        For a message of another topic, or of a schema that this version does not read.

    """
    try:
        rig = json.loads(deserialize_message(data, String).data)
        schema = rig['schema']
        names = [str(body['name']) for body in rig['bodies']]
    except (MessageError, ValueError, TypeError, KeyError, RecursionError):
        raise ValueError('it is not a message of a topic `rig`') from None
    if schema != SCHEMA or len({*names}) < len(names):
        raise ValueError(
            f'its schema is {schema}, and {SCHEMA} is read here; fix: use one version of kinpole '
            'for the node and its readers'
        )
    return dict(rig)


def plane_of_rig(rig: Mapping[str, Any]) -> Plane:
    """Return the plane of a rig, xy while it is not known."""
    plane = rig['plane']
    if plane is None:
        return XY
    return Plane(np.array([plane[key] for key in ('x', 'y', 'normal')]), AXES.get(plane['name']))
