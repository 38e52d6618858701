"""The record of a result bag, from its messages alone: one of the live node is as good as any."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bags import Truncated, read_messages, topics
from kinpole_ros.messages import RECEIVED, RESTARTS, stamp_to_ns
from kinpole_ros.tools.plot import Body, Series, decode, read_results
from kinpole_ros.tools.report._record import Columns, Record
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES

# Levels of diagnostic_msgs/DiagnosticStatus.
_WARN, _ERROR = 1, 2
_UNSAID = 'not published'
_MOST_NOTES = 20
# Figures that may be withheld while the pose is known.
_WITHHELD = (*POLE_NAMES, 'centrode_curvature')


def has_results(bag: str | Path) -> bool:
    """Whether a bag holds poses that a node published; the exact ones of simulate do not count."""
    return any(
        topic.endswith('/odom') and kind == 'nav_msgs/msg/Odometry' and '/truth/' not in topic
        for topic, kind in topics(bag).items()
    )


def read_record(
    bag: str | Path, most: Callable[[int], int], progress: Callable[[float], None] | None = None
) -> tuple[Record, list[str]]:
    """
    The results of a bag, and what its diagnostics warned of.

    `most` says of a number of bodies how many instants are kept at most, evenly. Raises
    BagError where there are none.
    """
    results = read_results(bag, progress, every=True)
    stamp = np.unique(np.concatenate([body.stamp for body in results.bodies]))
    total = len(stamp)
    step = 1
    while len(stamp[::step]) > most(len(results.bodies)):
        step *= 2
    stamp = stamp[::step]
    said = _Diagnostics(bag)
    columns: Columns = {}
    for body in results.bodies:
        _add(columns, stamp, body, said)
    for pair, series in results.relative.items():
        columns[pair, 'icr'] = _at(stamp, series.stamp, series.value)
        columns[pair, 'icr_covariance'] = _at(stamp, series.stamp, series.covariance)
    names = tuple(body.name for body in results.bodies)
    sizes = {body.name: body.size for body in results.bodies}
    # Where a node starts anew, frames lie otherwise in their bodies: what was drawn last is of the
    # end alone.
    outlines = {
        body.name: [(0, body.outline)] if len(body.outline) and not said.restarted else []
        for body in results.bodies
    }
    record = Record(stamp, total, names, columns, sizes, outlines, results.along)
    notes = said.notes
    if results.cut:
        notes = ['the bag is cut off: what lies after the cut is not shown', *notes]
    return record, notes


def _add(columns: Columns, stamp: np.ndarray, body: Body, said: '_Diagnostics') -> None:
    def take(values: np.ndarray) -> np.ndarray:
        return _at(stamp, body.stamp, values)

    name, none = body.name, Series(*(np.empty((0, *shape)) for shape in ((), (), (2, 2))))
    columns[name, 'position'] = take(body.position)
    columns[name, 'position_sigma'] = take(body.sigma)
    columns[name, 'velocity'] = take(body.velocity)
    columns[name, 'angle'] = take(body.angle)
    # Of which the size was found (`Body.size`).
    columns[name, 'angle_sigma'] = take(2 * body.sigma / body.size)
    columns[name, 'angular_velocity'] = take(body.rate)
    columns[name, 'angular_velocity_sigma'] = take(body.rate_sigma)
    for part in (*RATE_NAMES[1:], 'centrode_curvature'):
        series, deviation = body.series.get(part), body.series.get(f'{part}/deviation', none)
        if series is not None:
            columns[name, part] = _at(stamp, series.stamp, series.value)
            columns[name, f'{part}_sigma'] = _at(stamp, deviation.stamp, deviation.value.real)
    for part in (*POLE_NAMES, 'icr_velocity'):
        series, deviation = body.series.get(part), body.series.get(f'{part}/deviation', none)
        if series is None:
            continue
        columns[name, part] = _at(stamp, series.stamp, series.value)
        covariance = _at(stamp, series.stamp, series.covariance)
        if len(deviation.stamp):
            both = _at(stamp, deviation.stamp, deviation.value.astype(complex))
            covariance = np.zeros((len(stamp), 2, 2))
            covariance[:, 0, 0], covariance[:, 1, 1] = both.real**2, both.imag**2
        columns[name, f'{part}_covariance'] = covariance
    unseen = ~np.isfinite(columns[name, 'position'])
    columns[name, 'missing'] = said.reasons(name, '', stamp, unseen)
    for part in _WITHHELD:
        if (name, part) in columns:
            lacking = ~unseen & ~np.isfinite(columns[name, part])
            columns[name, f'{part}_withheld'] = said.reasons(name, part, stamp, lacking)


def _at(stamp: np.ndarray, stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The values (K, ...) of `stamps` (K,) at `stamp` (T,); NaN where there is none."""
    found = np.full((len(stamp), *values.shape[1:]), np.nan, np.result_type(values, float))
    _, here, there = np.intersect1d(stamp, stamps, return_indices=True)
    found[here] = values[there]
    return found


class _Diagnostics:
    """What the diagnostics in a bag say of bodies: why figures are undetermined, and warnings."""

    def __init__(self, bag: str | Path) -> None:
        stamps: list[int] = []
        # Whether the node started anew amid the bag, and how many frames it last counted.
        self.restarted = False
        self._received = 0
        # By body and figure, '' for all of them, at which of the stamps for what reason.
        self._said: dict[tuple[str, str], dict[int, str]] = {}
        warned: dict[str, None] = {}
        try:
            for message in read_messages(bag, ['/diagnostics']):
                array = decode(message.type_name, message.data)
                stamps.append(stamp_to_ns(array.header.stamp))
                for status in array.status:
                    self._take(len(stamps) - 1, status, warned)
        except Truncated:
            pass
        self._stamps = np.array(stamps, np.int64)
        self.notes = list(warned)[:_MOST_NOTES]

    def _take(self, at: int, status: Any, warned: dict[str, None]) -> None:
        body, level, text, reasons = words_of(status)
        for key, count in ((pair.key, pair.value) for pair in status.values):
            if key == RECEIVED and count.isdecimal():
                self.restarted |= int(count) < self._received
                self._received = int(count)
            elif key.startswith(RESTARTS):
                self.restarted |= count != '0'
        if level in (_WARN, _ERROR):
            warned.setdefault(f'{body}: {text}')
            self._said.setdefault((body, ''), {})[at] = text
        for figure, why in reasons.items():
            self._said.setdefault((body, figure), {})[at] = why

    def reasons(self, body: str, figure: str, stamp: np.ndarray, lacking: np.ndarray) -> np.ndarray:
        """The reason (T,) where a figure is lacking, '' elsewhere, by the next diagnostics."""
        found = np.full(len(stamp), '', object)
        said = self._said.get((body.rpartition('/')[2], figure), {})
        following = np.minimum(self._stamps.searchsorted(stamp), max(len(self._stamps) - 1, 0))
        for k in lacking.nonzero()[0].tolist():
            found[k] = said.get(int(following[k]), _UNSAID)
        return found


def words_of(status: Any) -> tuple[str, int, str, dict[str, str]]:
    """
    What a DiagnosticStatus of a node says: of what, its level, in what words.

    Last is why each figure is undetermined, of those that are.
    """
    # A byte, of which rclpy makes bytes and rosbags a number.
    level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
    end = ' undetermined'
    reasons = {p.key.removesuffix(end): p.value for p in status.values if p.key.endswith(end)}
    text = status.message.partition('; undetermined: ')[0]
    return status.name.rpartition(': ')[2], level, text, reasons
