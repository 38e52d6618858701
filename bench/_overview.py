"""What the first screen is made of: points of the Pareto chart and rows of the strip, from rows."""

from typing import Any, NamedTuple

import numpy as np

from bench._peers import (
    DIFFERENCES,
    FIXED,
    KALMAN,
    LIKELY,
    OURS,
    POLYNOMIAL,
    SAVGOL,
    SAVGOL_BEST,
    SMOOTHER,
    SPACED,
)
from bench._rows import Rows

# An error over so many times that with ideal input counts as broken.
BOUND = 1.5
# Of figures that are there with ideal input, the share that may lack.
_MISSING = 0.5
_LABELS = {
    DIFFERENCES: 'finite differences',
    SAVGOL: 'Savitzky-Golay 41/4',
    POLYNOMIAL: 'poses, polynomial 41/4',
    LIKELY: 'Kalman smoother, self-tuned',
    FIXED: 'polynomial on poses',
    SPACED: 'finite differences',
    SAVGOL_BEST: 'Savitzky-Golay',
    KALMAN: 'Kalman filter, no lag',
    SMOOTHER: 'Kalman smoother',
}
_PEERS = (DIFFERENCES, SAVGOL, POLYNOMIAL, LIKELY)


class Point(NamedTuple):
    """
    A method: error over the best fixed in hindsight, median and 90th percentile of the `cells`.

    `live` and `replay` are s a frame, NaN where it cannot be run so.
    """

    group: str
    label: str
    live: float
    replay: float
    median: float
    ninetieth: float
    cells: int


class Level(NamedTuple):
    """
    So much of a trouble: the larger `ratio` of ω and ICR over ideal input, medians of all bodies.

    `withheld` where over half of the figures of either are missing; `reported` where diagnostics
    say anything that they do not with ideal input.
    """

    name: str
    ratio: float
    withheld: bool
    reported: bool

    @property
    def broken(self) -> bool:
        return not self.withheld and self.ratio > BOUND


class Trouble(NamedTuple):
    """What may be wrong with the input, in all the levels that were tried."""

    name: str
    levels: tuple[Level, ...]

    @property
    def first_broken(self) -> Level | None:
        return next((level for level in self.levels if level.broken), None)


def over_hindsight(rows: Rows) -> dict[str, np.ndarray]:
    """By method, its errors over those of the best fixed window in hindsight, of every cell."""
    cells: dict[str, dict[tuple[Any, ...], float]] = {}
    for row in rows:
        key = row['motion'], row['noise'], row['quantity']
        cells.setdefault(row['method'], {})[key] = row['error']
    best = cells.get(FIXED, {})
    found = {}
    for method, errors in cells.items():
        with np.errstate(all='ignore'):
            ratios = np.array([e / np.float64(best.get(key, np.nan)) for key, e in errors.items()])
        found[method] = ratios[np.isfinite(ratios)]
    return found


def pareto_points(peers: Rows, costs: Rows, offline: Rows) -> list[Point]:
    """Points of ours, of `peer`s that the truth has not tuned, and of those it has."""
    spent = {row['method']: row for row in costs}
    points = []
    for method, ratios in over_hindsight(peers).items():
        if method not in spent or not len(ratios):
            continue
        group, label = 'tuned', _LABELS.get(method, method)
        if method == OURS:
            group, label = 'ours', OURS
        elif method in _PEERS:
            group = 'peer'
        time = spent[method]['live'], spent[method]['replay']
        points.append(_point(group, label, *time, ratios))
    for method, ratios in over_hindsight(offline).items():
        cpu = next(row['cpu'] for row in offline if row['method'] == method)
        if np.isfinite(cpu) and len(ratios):
            label = f'{method}, rates'
            points.append(_point('tuned', label, np.nan, cpu, ratios))
    return points


def _point(group: str, label: str, live: float, replay: float, ratios: np.ndarray) -> Point:
    middle, high = np.percentile(ratios, (50, 90)).tolist()
    return Point(group, label, live, replay, middle, high, len(ratios))


def troubles(rows: Rows) -> list[Trouble]:
    """The rows of the strip, from those of `rig_rows`: the least broken first."""
    found: dict[str, list[Level]] = {}
    for what in dict.fromkeys(row['what'] for row in rows):
        case = {row['quantity']: row for row in rows if row['what'] == what}
        both = [case['ω'], case['ICR']]
        ratios = [row['ratio'] for row in both if np.isfinite(row['ratio'])]
        withheld = not ratios or max(row['withheld'] for row in both) > _MISSING
        level = Level(
            both[0]['level'], max(ratios, default=np.nan), withheld, bool(both[0]['said'])
        )
        found.setdefault(both[0]['trouble'], []).append(level)
    each = [Trouble(name, tuple(levels)) for name, levels in found.items()]
    return sorted(each, key=lambda one: float(np.mean([level.broken for level in one.levels])))
