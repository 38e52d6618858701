"""The record of a replay, collected estimate by estimate, with the theory of a scene."""

from collections.abc import Iterator

import numpy as np

from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import LinkageError
from kinpole_ros.tools.record.lost import lost_count
from kinpole_ros.tools.record.record import Columns, MotionRecord
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import KNOWN, texts_of
from kinpole_ros.tracking.values import RATE_NAMES, known_arrays, measured_pairs


class Collector:
    """Collects estimates in a record of at most `most` instants, evenly spaced."""

    def __init__(self, most: int, theory: Theory | None = None) -> None:
        self._theory = theory
        self.total = 0
        self._most, self._step, self._count = most, 1, 0
        self._blocks: list[Columns] = []
        self._stamps: list[np.ndarray] = []  # of all instants
        self._bodies: tuple[str, ...] = ()
        self._events: dict[str, list[tuple[int, int]]] = {}

    def add(self, estimate: Estimate) -> None:
        """Append the instants of an estimate."""
        self._bodies = estimate.bodies
        sampled = slice(-self.total % self._step, None, self._step)
        self.total += len(estimate)
        for event in estimate.events:
            own = self._events.setdefault(estimate.bodies[event.body], [])
            own.append((event.stamp, event.order))
        self._stamps.append(estimate.stamp)
        columns = _estimate_columns(estimate)
        if self._theory is not None:
            for body, rates in theory_rates(self._theory, estimate).items():
                for name, values in zip(RATE_NAMES[: len(rates)], rates, strict=True):
                    columns[body, f'{name}_theory'] = values
        block = {key: values[sampled] for key, values in columns.items()}
        self._blocks.append(block)
        self._count += len(block['', 'stamp'])
        while self._count > self._most:
            self._blocks = [{key: v[::2] for key, v in _concatenate(self._blocks).items()}]
            self._count = len(self._blocks[0]['', 'stamp'])
            self._step *= 2

    def record(self, along: tuple[str, str]) -> MotionRecord:
        """Return the record; there must be an instant."""
        columns = _concatenate(self._blocks)
        stamp, run = columns.pop(('', 'stamp')), columns.pop(('', 'run'))
        sizes, outlines = {}, {}
        for body in self._bodies:
            size = columns.pop((body, 'size'))
            sizes[body] = float(np.nanmedian(size)) if np.isfinite(size).any() else float('nan')
            outlines[body] = list(_outlines(run, columns.pop((body, 'shape'))))
        about = self._bodies, columns, sizes, outlines, along, self._events
        return MotionRecord(stamp, self.total, *about, lost_count(np.concatenate(self._stamps)))


def _concatenate(blocks: list[Columns]) -> Columns:
    return {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}


def _estimate_columns(estimate: Estimate) -> Columns:
    """Return the columns of a record, and `shape`, `size`, `run` and `stamp`."""
    columns: Columns = {
        ('', 'stamp'): estimate.stamp,
        ('', 'run'): np.full(len(estimate), estimate.run),
    }
    reasons = estimate.withheld()
    quantities = estimate.quantities(estimate.order)
    if estimate.order >= 3:
        quantities['ball_point'] = estimate.ball_point
    arrays = known_arrays(quantities)
    with np.errstate(invalid='ignore'):
        for b, body in enumerate(estimate.bodies):
            columns[body, 'missing'] = estimate.missing[:, b]
            columns[body, 'position'] = estimate.origin(0)[:, b]
            columns[body, 'position_sigma'] = np.sqrt(estimate.position_covariance[0, 0, :, b])
            columns[body, 'velocity'] = estimate.origin(1)[:, b]
            columns[body, 'angle'] = estimate.angle[0, :, b]
            columns[body, 'angle_sigma'] = np.sqrt(estimate.angle_covariance[0, 0, :, b])
            columns[body, 'shape'] = estimate.shape[:, b]
            columns[body, 'size'] = estimate.size[:, b]
            for name, values in arrays.items():
                columns[body, name] = values[:, b]
            for name, reason in reasons.items():
                withheld = np.where(estimate.reason[:, b] == KNOWN, reason[:, b], KNOWN)
                columns[body, f'{name}_withheld'] = texts_of(withheld)
        for name, values in known_arrays({'icr': estimate.relative_icr}).items():
            for k, (i, j) in enumerate(measured_pairs(len(estimate.bodies))):
                columns[(estimate.bodies[j], estimate.bodies[i]), name] = values[:, k]
    return columns


def _outlines(run: np.ndarray, shape: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the start of each run, and the markers (n,) as estimated last in it."""
    starts = np.flatnonzero(np.diff(run, prepend=run[:1] - 1))
    for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(run)], strict=True):
        estimated = np.isfinite(shape[start:end]).any(axis=1).nonzero()[0]
        if len(estimated):
            last = shape[start + estimated[-1]]
            yield start, last[np.isfinite(last)]


def theory_rates(theory: Theory, estimate: Estimate) -> dict[str, np.ndarray]:
    """
    Return the rates of a scene's bodies that follow from the measured angle of its driver.

    Angular velocity (rad/s) and its derivatives, by body (order, T), without those of the driver
    itself. They are NaN where the scene has no such position; there are none if the driver is not
    the angle of a tracked body.
    """
    if not theory.driver:
        return {}
    driver = theory.matches[theory.driver]
    _, turn = driver.fit_frame(estimate.shape[:, driver.tracked])
    mechanism = theory.scene.mechanism
    start = float(mechanism.drivers[0].motion(np.zeros(1))[0, 0])
    inputs = np.zeros((5, len(estimate)))
    inputs[: estimate.order + 1] = estimate.angle[:, :, driver.tracked]
    inputs[0] = start + (inputs[0] + turn - start + np.pi) % (2 * np.pi) - np.pi
    measured = np.isfinite(inputs).all(axis=0)
    numbers = {body: row.in_scene for body, row in theory.matches.items() if body != theory.driver}
    rates = {body: np.full((estimate.order, len(estimate)), np.nan) for body in numbers}
    if not measured.any():
        return rates
    try:
        motion = mechanism.at_inputs(inputs[:, None, measured], None)
    except LinkageError:
        return rates
    correct = np.arange(1, estimate.order + 1)[:, None] < motion.sound
    for body, number in numbers.items():
        values = motion.angle[1 : estimate.order + 1, number]
        rates[body][:, measured] = np.where(correct & motion.regular, values, np.nan)
    return rates
