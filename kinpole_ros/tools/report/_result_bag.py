"""The record of a bag of results, from a replay or from the live node."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bags import Truncated, read_messages, topics
from kinpole_ros.messages import RECEIVED, RESTARTS, stamp_to_ns
from kinpole_ros.tools.plot import Body, decode, lost_count, read_results
from kinpole_ros.tools.report._record import Columns, Record
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES

# Levels of diagnostic_msgs/DiagnosticStatus.
_WARN, _ERROR = 1, 2
_NO_REASON = 'not published'
_MOST_NOTES = 20
# Quantities that may be withheld while the pose is known.
_WITHHELD = (*POLE_NAMES, 'centrode_curvature')


def has_results(bag: str | Path) -> bool:
    """Return whether a bag has results of a node, not only the exact motion of simulate."""
    return any(
        topic.endswith('/odom') and kind == 'nav_msgs/msg/Odometry' and '/truth/' not in topic
        for topic, kind in topics(bag).items()
    )


def read_record(
    bag: str | Path, most: Callable[[int], int], progress: Callable[[float], None] | None = None
) -> tuple[Record, list[str]]:
    """
    Return the results of a bag, and the warnings in its diagnostics.

    `most` returns, for a number of bodies, the largest number of instants. Raises BagError if there
    are no results.
    """
    results = read_results(bag, progress, with_snap=True)
    stamp = np.unique(np.concatenate([body.frames for body in results.bodies]))
    total, lost, step = len(stamp), lost_count(stamp), 1
    while len(stamp[::step]) > most(len(results.bodies)):
        step *= 2
    stamp = stamp[::step]
    diagnostics = Diagnostics(bag)
    columns: Columns = {}
    for body in results.bodies:
        _add_body(columns, stamp, body, diagnostics)
    for pair, series in results.relative.items():
        columns[pair, 'icr'] = _at(stamp, series.stamp, series.value)
        columns[pair, 'icr_covariance'] = _at(stamp, series.stamp, series.covariance)
    names = tuple(body.name for body in results.bodies)
    sizes = {body.name: body.size for body in results.bodies}
    # A node that restarts defines new frames of its bodies; the last outlines are for the new ones.
    outlines = {
        body.name: [(0, body.outline)] if len(body.outline) and not diagnostics.restarted else []
        for body in results.bodies
    }
    notes = ['the bag is cut off; what follows is not shown'] if results.cut else []
    events = {
        body.name: list(zip(body.events.tolist(), body.event_orders.tolist(), strict=True))
        for body in results.bodies
    }
    record = Record(stamp, total, names, columns, sizes, outlines, results.along, events, lost)
    return record, notes + diagnostics.notes


def _add_body(columns: Columns, stamp: np.ndarray, body: Body, diagnostics: 'Diagnostics') -> None:
    """Add the columns of a body, at the stamps (T,) of the record."""
    name = body.name
    odometry = {
        'position': body.position,
        'position_sigma': body.sigma,
        'velocity': body.velocity,
        'angle': body.angle,
        # The ratio that defines `Body.size`.
        'angle_sigma': 2 * body.sigma / body.size,
        'angular_velocity': body.rate,
        'angular_velocity_sigma': body.rate_sigma,
    }
    for key, values in odometry.items():
        columns[name, key] = _at(stamp, body.stamp, values)
    for key in (*RATE_NAMES[1:], *_WITHHELD, 'icr_velocity'):
        series, deviation = body.series.get(key), body.series.get(f'{key}/deviation')
        if series is None:
            continue
        columns[name, key] = _at(stamp, series.stamp, series.value)
        sigma = np.full(len(stamp), np.nan)
        if deviation is not None:
            sigma = _at(stamp, deviation.stamp, deviation.value)
        if key in RATE_NAMES or key == 'centrode_curvature':
            columns[name, f'{key}_sigma'] = sigma.real
            continue
        covariance = _at(stamp, series.stamp, series.covariance)
        if not np.isfinite(covariance).any():
            covariance = np.zeros((len(stamp), 2, 2))
            covariance[:, 0, 0], covariance[:, 1, 1] = sigma.real**2, sigma.imag**2
        columns[name, f'{key}_covariance'] = covariance
    missing = ~np.isfinite(columns[name, 'position'])
    columns[name, 'missing'] = diagnostics.reasons(name, '', stamp, missing)
    for key in _WITHHELD:
        if (name, key) in columns:
            withheld = ~missing & ~np.isfinite(columns[name, key])
            columns[name, f'{key}_withheld'] = diagnostics.reasons(name, key, stamp, withheld)


def _at(stamp: np.ndarray, stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the values (K, ...) of `stamps` (K,) at `stamp` (T,), NaN where there is none."""
    result = np.full((len(stamp), *values.shape[1:]), np.nan, np.result_type(values, float))
    _, own, its = np.intersect1d(stamp, stamps, return_indices=True)
    result[own] = values[its]
    return result


class Diagnostics:
    """
    The diagnostics in a bag.

    `notes` are the warnings; `restarted` is whether the node restarted during the recording.
    """

    def __init__(self, bag: str | Path) -> None:
        stamps: list[int] = []
        self.restarted = False
        self._received = 0  # frames, as counted last by the node
        # By body and quantity ('' for all of them), the reason by index of the message.
        self._reasons: dict[tuple[str, str], dict[int, str]] = {}
        warnings: dict[str, None] = {}
        try:
            for message in read_messages(bag, ['/diagnostics']):
                array = decode(message.type_name, message.data)
                for status in array.status:
                    self._add_status(len(stamps), status, warnings)
                stamps.append(stamp_to_ns(array.header.stamp))
        except Truncated:
            pass
        self._stamps = np.array(stamps, np.int64)
        self.notes = list(warnings)[:_MOST_NOTES]

    def _add_status(self, index: int, status: Any, warnings: dict[str, None]) -> None:
        body, level, text, reasons = parse_status(status)
        for pair in status.values:
            if pair.key == RECEIVED and pair.value.isdecimal():
                self.restarted |= int(pair.value) < self._received
                self._received = int(pair.value)
            elif pair.key.startswith(RESTARTS):
                self.restarted |= pair.value != '0'
        if level in (_WARN, _ERROR):
            warnings.setdefault(f'{body}: {text}')
            reasons[''] = text
        for quantity, reason in reasons.items():
            self._reasons.setdefault((body, quantity), {})[index] = reason

    def reasons(self, body: str, quantity: str, stamp: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Return the reasons (T,) in the next diagnostics where `mask` is set, '' elsewhere."""
        texts = np.full(len(stamp), '', object)
        by_message = self._reasons.get((body.rpartition('/')[2], quantity), {})
        following = np.minimum(self._stamps.searchsorted(stamp), max(len(self._stamps) - 1, 0))
        for k in mask.nonzero()[0].tolist():
            texts[k] = by_message.get(int(following[k]), _NO_REASON)
        return texts


def parse_status(status: Any) -> tuple[str, int, str, dict[str, str]]:
    """Return the subject, level and text of a DiagnosticStatus, and reasons by quantity."""
    # A byte, which is bytes in rclpy and a number in rosbags.
    level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
    end = ' undetermined'
    reasons = {p.key.removesuffix(end): p.value for p in status.values if p.key.endswith(end)}
    text = status.message.partition('; undetermined: ')[0]
    return status.name.rpartition(': ')[2], level, text, reasons
