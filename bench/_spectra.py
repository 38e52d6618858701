"""
What the spectrum of a body changes: errors and coverage with it and without, by rate and lag.

Poses with white noise go straight to the estimator. The spectrum of a window is that of the frames
before a block of windows, as the tracker learns it.
"""

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np

from bench._events import Record, event_motions, smooth_motions
from bench._record import START
from bench._rows import Rows
from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses, find_spectrum
from kinpole_ros.tracking.state import MIN_HISTORY_FRAMES
from kinpole_ros.tracking.update import MIN_HISTORY_WINDOWS

# Windows, s, by frames per s; lags, s; deviations of the angle, rad, of bodies 0.2 m wide.
_WINDOWS = {30: 0.5, 60: 0.3, 200: 0.3}
_LAGS, _NOISES, _ARM = (0.0, 0.1), (1e-4, 1e-3, 1e-2), 0.1
# Of so many windows one is measured.
_STRIDE = 3
_QUANTITIES = ('ω', 'α', 'jerk')
# An error below this share of that of the polynomial of lowest degree counts as that: it may be 0.
_LEAST = 0.3
_OF_POLYNOMIALS = np.sqrt([12.0, 720.0, 100800.0])

Motion = Callable[[np.ndarray], Record]


class _Cell(NamedTuple):
    """Of (3,) quantities: the ratio of errors, and (2, 3) covered and beyond, without and with."""

    ratio: np.ndarray
    covered: np.ndarray
    beyond: np.ndarray


def _sines(*parts: tuple[float, float], speed: float = 0.0) -> Motion:
    """Sines of (rad, Hz) beside a speed, rad/s, of a body that turns about a point."""

    def record(time: np.ndarray) -> Record:
        angle = np.stack((speed * time, speed + 0 * time, 0 * time, 0 * time))
        for size, hertz in parts:
            powers = (2 * np.pi * hertz) ** np.arange(4)[:, None]
            angle += (
                size * powers * np.sin(2 * np.pi * hertz * time + np.pi / 2 * np.arange(4)[:, None])
            )
        turned = 0.3 * np.exp(1j * angle[0])
        return Record(position=turned[None], angle=angle, events=np.empty(0))

    return record


def _rod(turns: float) -> Motion:
    """The rod of a slider-crank, 0.3 as long, at so many rev/s, by its odd harmonics."""
    crank = 2 * np.pi * np.arange(512) / 512
    sizes = np.fft.rfft(np.arcsin(0.3 * np.sin(crank))).imag / -256
    return _sines(*((sizes[k], k * turns) for k in range(1, 20, 2)))


_FAST: dict[str, Motion] = {
    'rod at 6 rev/s': _rod(6),
    'rod at 15 rev/s': _rod(15),
    'torsion of 1 degree': _sines((0.02, 7.0)),
    'torsion of 6 degrees': _sines((0.1, 7.0)),
    'ripple on turning': _sines((0.003, 6.0), speed=2.0),
    'slow sine': _sines((0.5, 0.8)),
    'steady turning': _sines(speed=2.0),
}


def spectra_rows(quick: bool, progress: Callable[[float], None]) -> Rows:
    """Rows by kind of motion, rate and lag."""
    kinds = {'smooth': smooth_motions(), 'fast': _FAST, 'events': event_motions()}
    places = [*product(kinds, (200,) if quick else _WINDOWS, _LAGS)]
    rows = []
    for done, (kind, rate, lag) in enumerate(places):
        motions = [*kinds[kind].values()][: 1 if quick else None]
        noises = _NOISES[:1] if quick else _NOISES
        cells = [_measure(one, noise, rate, lag) for one, noise in product(motions, noises)]
        ratio, covered, beyond = (np.array(part) for part in zip(*cells, strict=True))
        for k, quantity in enumerate(_QUANTITIES):
            row = {'kind': kind, 'rate': rate, 'lag': lag, 'quantity': quantity}
            row |= {'ratio': float(np.exp(np.log(ratio[:, k]).mean())), 'cells': len(cells)}
            for which, name in enumerate(('without', 'with')):
                row[f'low_{name}'] = int((covered[:, which, k] < 0.85).sum())
                row[f'beyond_{name}'] = float(beyond[:, which, k].mean())
            rows.append(row)
        progress((done + 1) / len(places))
    return rows


def _measure(motion: Motion, noise: float, rate: int, lag: float) -> _Cell:
    """Compare both on the windows after the frames that are remembered."""
    window = _WINDOWS[rate]
    length, ahead = round(window * rate), round(lag * rate)
    known = max(MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS * length)
    count = known + 1024
    time = np.arange(count) / rate
    record, rng = motion(time), np.random.default_rng(5)
    angle = record.angle[0] + noise * rng.normal(size=count)
    position = record.position[0] + _ARM * noise * (rng.normal(size=(count, 2)) @ (1, 1j))
    stamps = START + np.rint(time * 1e9).astype(np.int64)
    before = slice(0, known)
    about = stamps[before], angle[before], position[before], (noise, _ARM * noise), window
    ones = np.ones((count, 1))
    poses = Poses(stamps, angle[:, None], 0 * ones, position[:, None] / _ARM, ones, ones)
    newest = np.arange(known, count, _STRIDE)
    windows = Windows(newest - ahead, newest - length, newest)
    arguments = poses, windows, np.zeros((len(newest), 1), int), np.full((len(newest), 1), noise)
    found = [
        derive_poses(*arguments, window, 3, [spectrum])
        for spectrum in (None, find_spectrum(*about))
    ]
    errors = [one.angle[1:, :, 0] - record.angle[1:4, newest - ahead] for one in found]
    least = _LEAST * noise * _OF_POLYNOMIALS / np.sqrt(length) / window ** np.arange(1, 4)
    sizes = [np.hypot(np.sqrt((error**2).mean(axis=1)), least) for error in errors]
    shares = [_shares(error, one) for error, one in zip(errors, found, strict=True)]
    covered, beyond = (np.array(part) for part in zip(*shares, strict=True))
    return _Cell(sizes[1] / sizes[0], covered, beyond)


def _shares(error: np.ndarray, found: Derivatives) -> tuple[np.ndarray, np.ndarray]:
    """Shares (3,) of errors (3, M) within 2 and beyond 10 standard deviations."""
    variance = found.angle_covariance[range(1, 4), range(1, 4), :, 0]
    square = error**2 / np.maximum(variance, np.finfo(float).tiny)
    return (square < 4).mean(axis=1), (square > 100).mean(axis=1)
