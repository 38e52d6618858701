"""
What a report shows: figures of all bodies at the same instants, as plain arrays.

They come from the estimates of a replay or from the messages of a result bag. The page knows
neither of the two.
"""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.linkage.theory import Theory
from kinpole_ros.tools.report._theory import theory_rates
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES, Estimate, measured_pairs

# By subject, a body or (j, i), and by figure: arrays (T, ...), NaN where undetermined.
Columns: TypeAlias = dict[tuple[str | tuple[str, str], str], np.ndarray]
# Drawn as a pin: a relative center that strays by less than this part of both bodies' sizes.
_PIN = 0.05


class Joint(NamedTuple):
    """A pin of two bodies, `at` complex, m, in their frames; of one body, with the ground."""

    bodies: tuple[str, ...]
    at: tuple[complex, ...]


class Record(NamedTuple):
    """
    T instants, `stamp` (T,) ns, of a recording that had `total`.

    `columns` has of a body: `position` and `velocity` of its origin, complex, m; `angle`, rad;
    `missing`, why nothing is known ('' where something is); its rates, poles, `icr_velocity` and
    `centrode_curvature`, each with `_sigma`, or `_covariance` (T, 2, 2), and where known with
    `_withheld`, the reason why it is undetermined; rates with `_theory` where a scene says what
    they should be; of (j, i) `icr` with `icr_covariance`.
    `sizes` are diameters, m, and `outlines` markers (n,) in the frame of a body from an instant on.
    """

    stamp: np.ndarray
    total: int
    bodies: tuple[str, ...]
    columns: Columns
    sizes: dict[str, float]
    outlines: dict[str, list[tuple[int, np.ndarray]]]
    along: tuple[str, str]


class Collector:
    """
    Takes estimates as they come, and keeps `most` instants at most, evenly.

    With a `theory` also what that says of the rates.
    """

    def __init__(self, most: int, theory: Theory | None = None) -> None:
        self._theory = theory
        self.total = 0
        self._most, self._step, self._kept = most, 1, 0
        self._blocks: list[Columns] = []
        self._bodies: tuple[str, ...] = ()

    def add(self, estimate: Estimate) -> None:
        """Take T more instants."""
        self._bodies = estimate.bodies
        kept = slice(-self.total % self._step, None, self._step)
        self.total += len(estimate)
        columns = _columns(estimate)
        if self._theory is not None:
            for body, rates in theory_rates(self._theory, estimate).items():
                for name, values in zip(RATE_NAMES[: len(rates)], rates, strict=True):
                    columns[body, f'{name}_theory'] = values
        block = {key: values[kept] for key, values in columns.items()}
        self._blocks.append(block)
        self._kept += len(block['', 'stamp'])
        while self._kept > self._most:
            self._blocks = [{key: v[::2] for key, v in _concatenated(self._blocks).items()}]
            self._kept = len(self._blocks[0]['', 'stamp'])
            self._step *= 2

    def record(self, along: tuple[str, str]) -> Record:
        """What was kept; there must be an instant."""
        columns = _concatenated(self._blocks)
        stamp, run = columns.pop(('', 'stamp')), columns.pop(('', 'run'))
        sizes, outlines = {}, {}
        for body in self._bodies:
            size = columns.pop((body, 'size'))
            sizes[body] = float(np.nanmedian(size)) if np.isfinite(size).any() else float('nan')
            outlines[body] = list(_outlines(run, columns.pop((body, 'shape'))))
        return Record(stamp, self.total, self._bodies, columns, sizes, outlines, along)


def _concatenated(blocks: list[Columns]) -> Columns:
    return {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}


def _columns(estimate: Estimate) -> Columns:
    """All that a record holds, and `shape`, `size`, `run`, `stamp`, which it holds otherwise."""
    found: Columns = {
        ('', 'stamp'): estimate.stamp,
        ('', 'run'): np.full(len(estimate), estimate.run),
    }
    reasons = estimate.withheld()
    numbers = {name: estimate.rate(k + 1) for k, name in enumerate(RATE_NAMES[: estimate.order])}
    if estimate.order >= 3:
        numbers['centrode_curvature'] = estimate.centrode_curvature
    vectors = {name: estimate.pole(k + 1) for k, name in enumerate(POLE_NAMES[: estimate.order])}
    if estimate.order >= 2:
        vectors['icr_velocity'] = estimate.icr_velocity
    with np.errstate(invalid='ignore'):
        for b, body in enumerate(estimate.bodies):
            found[body, 'missing'] = estimate.missing[:, b].astype(object)
            found[body, 'position'] = estimate.origin(0)[:, b]
            found[body, 'position_sigma'] = np.sqrt(estimate.position_covariance[0, 0, :, b])
            found[body, 'velocity'] = estimate.origin(1)[:, b]
            found[body, 'angle'] = estimate.angle[0, :, b]
            found[body, 'angle_sigma'] = np.sqrt(estimate.angle_covariance[0, 0, :, b])
            found[body, 'shape'] = estimate.shape[:, b]
            found[body, 'size'] = estimate.size[:, b]
            for name, number in numbers.items():
                known = number.determined[:, b]
                found[body, name] = np.where(known, number.value[:, b], np.nan)
                sigma = np.sqrt(number.variance[:, b])
                found[body, f'{name}_sigma'] = np.where(known, sigma, np.nan)
            for name, vector in vectors.items():
                known = vector.determined[:, b]
                found[body, name] = np.where(known, vector.value[:, b], np.nan)
                covariance = np.where(known[:, None, None], vector.covariance[:, b], np.nan)
                found[body, f'{name}_covariance'] = covariance
            for name, why in reasons.items():
                own = np.where(estimate.missing[:, b] == '', why[:, b], '')
                found[body, f'{name}_withheld'] = own.astype(object)
        center = estimate.relative_icr
        for k, (i, j) in enumerate(measured_pairs(len(estimate.bodies))):
            known = center.determined[:, k]
            pair = estimate.bodies[j], estimate.bodies[i]
            found[pair, 'icr'] = np.where(known, center.value[:, k], np.nan)
            covariance = np.where(known[:, None, None], center.covariance[:, k], np.nan)
            found[pair, 'icr_covariance'] = covariance
    return found


def _outlines(run: np.ndarray, shape: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The markers (n,) as last learned, from the first instant of each run on."""
    starts = np.flatnonzero(np.diff(run, prepend=run[:1] - 1))
    for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(run)], strict=True):
        known = np.isfinite(shape[start:end]).any(axis=1).nonzero()[0]
        if len(known):
            last = shape[start + known[-1]]
            yield start, last[np.isfinite(last)]


def joints_of(record: Record) -> list[Joint]:
    """Pins: poles that rest on the ground, and relative centers that rest in both bodies."""
    found = []
    for body in record.bodies:
        icr, u = (record.columns.get((body, name)) for name in ('icr', 'icr_velocity'))
        if icr is None or u is None:
            continue
        rests = (u == 0) & np.isfinite(icr)
        if 2 * np.count_nonzero(rests) > np.count_nonzero(np.isfinite(icr)):
            pin = complex(np.median(icr[rests].real), np.median(icr[rests].imag))
            found.append(Joint((body,), (pin,)))
    for m, k in measured_pairs(len(record.bodies)):
        i, j = record.bodies[m], record.bodies[k]
        center = record.columns.get(((j, i), 'icr'))
        covariance = record.columns.get(((j, i), 'icr_covariance'))
        if center is None or covariance is None or not np.isfinite(center).any():
            continue
        spread = np.trace(covariance, axis1=1, axis2=2)
        # Without covariances all count alike.
        spread = np.where(np.isfinite(center) & np.isnan(spread), 0.0, spread)
        best = spread <= np.nanmedian(spread)
        places = []
        for body in (j, i):
            position, angle = record.columns[body, 'position'], record.columns[body, 'angle']
            seen = ((center - position) * np.exp(-1j * angle))[best]
            seen = seen[np.isfinite(seen)]
            if not len(seen) or np.sqrt(np.var(seen)) > _PIN * record.sizes[body]:
                break
            places.append(complex(seen.mean()))
        else:
            found.append(Joint((j, i), tuple(places)))
    return found
