"""
The stability atlas: what becomes of the figures as each thing goes to its limit.

Each cell is a record through the real tracker, and through the same with a fixed window. Nothing
may raise, and nothing that is not finite may be called determined; the cells say whether it did.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bench._motions import Motion, cusped, motions, still_turning, swinging
from bench._record import RATE, START, frames_of, quantities
from kinpole_ros import planar
from kinpole_ros.mechanism import BodyMotion, marker_positions
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import part_of
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import Numbers, Vectors

SHOWN = ('ω', 'α', 'ICR', 'IAP', 'κ')


class Cell(NamedTuple):
    """One record: whose motion, seen how. Lengths are in body sizes, times in s."""

    limit: str
    unit: str
    value: float
    motion: Motion
    noise: float = 1e-3
    # Hz. Where the noise is smoothed as motion capture does it, forth and back; 0 for white.
    cutoff: float = 0.0
    rate: float = RATE
    dropout: float = 0.0
    rounding: float = 0.0
    jitter: float = 0.0
    offset: float = 0.0
    # s. Judged within `_ABOUT` of it, otherwise in the second half.
    instant: float | None = None


_ABOUT = 0.05


def cells() -> Iterator[Cell]:
    """All cells, limit by limit."""
    bar = motions()['four-bar coupler']
    turner = motions()['fast rotation'].markers

    def turning(rate: float, orbit: float = 0.05) -> Motion:
        return Motion(lambda t: still_turning(t, rate, orbit), turner)

    def swing(amplitude: float) -> Motion:
        return Motion(lambda t: swinging(t, amplitude), turner)

    def cusp(least: float) -> Motion:
        return Motion(lambda t: cusped(t, least), turner)

    def shaped(markers: np.ndarray) -> Motion:
        return Motion(bar.motion, markers)

    def scaled(factor: float) -> Motion:
        def motion(t: np.ndarray) -> BodyMotion:
            position, angle = bar.motion(t)
            return BodyMotion(factor * position, angle)

        return Motion(motion, factor * bar.markers)

    for rate in (10.0, 1.0, 0.1, 1e-2, 1e-3, 1e-5, 0.0):
        yield Cell('angular velocity to 0', 'rad/s', rate, turning(rate))
    for angle in (1.0, 0.1, 1e-2, 1e-3, 1e-5, 0.0):
        yield Cell('swing to rest, ω and α to 0', 'rad to each side', angle, swing(angle))
    for orbit in (1e-2, 1e-3, 1e-4, 1e-6, 0.0):
        yield Cell('centrode velocity to 0 (pinned)', 'm, orbit', orbit, turning(6.0, orbit))
    for least in (1.0, 0.1, 1e-2, 1e-4, 0.0):
        yield Cell('centrode to a cusp', 'of its speed left', least, cusp(least), instant=2.0)
    line = bar.markers - bar.markers.mean(axis=0)
    for width in (1.0, 1e-1, 1e-2, 1e-4, 0.0):
        yield Cell('markers to a line', 'width kept', width, shaped(line * (1.0, width)))
    for spread in (1.0, 1e-1, 1e-2, 1e-4, 1e-8, 0.0):
        # The noise is as before, in sizes of the body that it was.
        noise = 1e-3 / spread if spread > 0 else 1e-3
        yield Cell('markers to a point', 'spread kept', spread, shaped(line * spread), noise=noise)
    for noise in (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1):
        yield Cell('noise', 'body sizes', noise, bar, noise=noise)
    for cutoff in (40.0, 20.0, 10.0, 6.0):
        yield Cell('smoothing of the markers', 'Hz, cutoff', cutoff, bar, cutoff=cutoff)
    for dropout in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9):
        yield Cell('dropouts', 'share of markers', dropout, bar, dropout=dropout)
    for rounding in (1e-6, 1e-4, 1e-3, 2e-3, 5e-3):
        yield Cell('rounding of stamps, 240 Hz', 's', rounding, bar, rate=240.0, rounding=rounding)
    for jitter in (1e-4, 1e-3, 2e-3):
        yield Cell('jitter of frames, stamps true', 's', jitter, bar, jitter=jitter)
    for rate in (30.0, 100.0, 200.0, 1000.0, 10_000.0):
        yield Cell('frame rate', 'Hz', rate, bar, rate=rate)
    for offset in (0.0, 1e3, 1e5, 1e7):
        yield Cell('offset of coordinates', 'body sizes', offset, bar, offset=offset)
    for factor in (1e-6, 1e-3, 1.0, 1e3, 1e6):
        yield Cell('body size', 'times 0.3 m', factor, scaled(factor))
    for turn in (0.05, 0.1, 0.2, 0.3, 0.4):
        yield Cell('turning', 'rev per frame', turn, turning(2 * np.pi * turn * RATE))


def smoothed(values: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Values (T, ...) through a Butterworth filter of fourth order, forth and back."""
    share = 1 / (1 + (np.fft.fftfreq(len(values), 1 / rate) / cutoff) ** 8)
    return np.asarray(np.fft.ifft(np.fft.fft(values, axis=0).T * share).T)


def survey(
    quick: bool = False, progress: Callable[[float], None] | None = None
) -> list[dict[str, object]]:
    """
    One row by cell: median error, share determined, and what must not be.

    Errors are medians over determined frames of |error| over the larger of the truth's own size
    and the rms of ω to the power of the order; of poles over the body's size, of κ over the larger
    of the truth and the inverse of the size. `progress` is called with the share of cells done.
    """
    chosen = list(cells())[:: 9 if quick else 1]
    rows = []
    for count, cell in enumerate(chosen):
        if progress is not None:
            progress(count / len(chosen))
        rows.append(_row(cell))
    return rows


def _row(cell: Cell) -> dict[str, object]:
    seconds = 1.2 if cell.rate > 500 else 2.5
    rng = np.random.default_rng(7)
    count = round(seconds * cell.rate)
    t = np.arange(count) / cell.rate
    t = t + cell.jitter * (rng.random(count) - 0.5)
    stamps = START + np.round(t * 1e9).astype(np.int64)
    if cell.rounding:
        step = round(cell.rounding * 1e9)
        stamps = (stamps + step // 2) // step * step
    moved = cell.motion.motion(t)
    markers = planar.to_complex(marker_positions(moved, cell.motion.markers))
    size = cell.motion.size
    noise = cell.noise * size
    shake = rng.normal(size=(*markers.shape, 2)) @ (1, 1j)
    markers = markers + noise * (smoothed(shake, cell.rate, cell.cutoff) if cell.cutoff else shake)
    markers[rng.random(markers.shape) < cell.dropout] = np.nan
    markers = markers + cell.offset * size
    row: dict[str, object] = {'limit': cell.limit, 'value': cell.value, 'unit': cell.unit}
    row |= {'raised': '', 'not_finite': 0}
    frames, settings = frames_of(markers[:, None], stamps)
    tracker = Tracker(settings)
    # As many instants for every rate; the averages of what came before are fed alike.
    every = max(1, count // 240)
    found = []
    try:
        with np.errstate(all='ignore'):
            for k in range(count):
                asked = 3 if k % every == 0 and k > count // 2 - 100 * every else None
                blocks = tracker.add(part_of(frames, slice(k, k + 1)), asked)
                found += [instant for block in blocks for instant in block]
            first, last = int(stamps[count // 2]), int(stamps[-1])
            if cell.instant is not None:
                first, last = (
                    START + round((cell.instant + side * _ABOUT) * 1e9) for side in (-1, 1)
                )
            found = [e for e in found if first <= e.stamp <= last]
            _fill(row, found, cell)
    # Whatever it is, it belongs in the table.
    except Exception as error:
        row['raised'] = type(error).__name__
    return row


def _fill(row: dict[str, object], found: list[Estimate], cell: Cell) -> None:
    instants = np.array([(e.stamp - START) * 1e-9 for e in found])
    true = cell.motion.motion(instants)
    truth = quantities(true.position, true.angle)
    size, turning = cell.motion.size, np.sqrt(np.mean(truth['ω'] ** 2)) if len(found) else 0.0
    not_finite = 0
    for name in SHOWN:
        figures: Sequence[Numbers | Vectors]
        if name in ('ω', 'α'):
            order = 1 if name == 'ω' else 2
            figures = [e.rate(order) for e in found]
            scale = np.maximum(np.abs(truth[name]), turning**order)
            shift = 0.0
        elif name == 'κ':
            figures, shift = [e.centrode_curvature for e in found], 0.0
            scale = np.maximum(np.abs(truth[name]), 1 / size if size else np.inf)
        else:
            figures = [e.pole(1 if name == 'ICR' else 2) for e in found]
            scale, shift = np.full(len(found), size), cell.offset * size
        values = np.array([figure.value[0] for figure in figures])
        told = np.array([bool(figure.determined[0]) for figure in figures])
        not_finite += int((told & ~np.isfinite(values)).sum())
        error = np.abs(values - shift * (1 + 0j) - truth[name]) / scale if len(found) else values
        error = error[told & np.isfinite(error)]
        row[f'{name}_error'] = float(np.median(error)) if len(error) else np.nan
        row[f'{name}_determined'] = float(told.mean()) if len(told) else 0.0
    row['not_finite'] = not_finite
