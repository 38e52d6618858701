"""
What all benchmarks share: noisy recordings, our figures for them, and how errors are counted.

Many recordings are made at once and given to one real `Tracker` as so many bodies: it judges each
by itself, and a minute does what would take an hour one by one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bench._motions import Motion, motions, other_motions
from kinpole_ros import planar
from kinpole_ros.mechanism import BodyMotion, marker_positions
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.planar import fit_pose
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

RATE = 200
WINDOW = 0.5
LAG = 0.1
START, STEP = 10**18, 10**9 // RATE
# s. Averages need this long before a record counts.
WARM_UP = 1.5
NOISES = (1e-5, 1e-3, 1e-2)
RATES, POLES = ('ω', 'α', 'jerk'), ('ICR', 'IAP', 'IJP')
QUANTITIES = (*RATES, *POLES, 'κ')
UNITS = {'ω': 'rad/s', 'α': 'rad/s²', 'jerk': 'rad/s³', 'κ': '1/m'} | dict.fromkeys(POLES, 'm')
# A pole beyond this many body sizes, or a curvature above it per size, is left out of errors.
NEAR = 10.0


class Case(NamedTuple):
    """One recording: which motion, its noise in body sizes and its number among its like."""

    motion: str
    noise: float
    seed: int


@dataclass(frozen=True, eq=False)
class Recording:
    """
    N frames of C cases: `points` (N, C, n) complex, m; `truth` by quantity (N, C); `position`
    (4, N, C), the exact mean of the markers, and `angle` (4, N, C) with their derivatives; `shape`
    (C, n) the markers about their mean; `size` (C,) and `noise` (C,) per axis of a marker, m.
    """

    cases: tuple[Case, ...]
    points: np.ndarray
    truth: dict[str, np.ndarray]
    position: np.ndarray
    angle: np.ndarray
    shape: np.ndarray
    size: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Where (N, C) the mean of the exact markers is."""
        return np.asarray(self.position[0])

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation (C,) of one coordinate of a marker, m."""
        return np.array([case.noise for case in self.cases]) * self.size

    def near(self) -> dict[str, np.ndarray]:
        """Where (N, C) each true quantity is one to be measured: see `NEAR`."""
        far = {name: np.abs(self.truth[name] - self.middle) / self.size for name in POLES}
        near = {name: np.ones(self.middle.shape, bool) for name in RATES}
        with np.errstate(invalid='ignore'):
            near |= {name: far[name] <= NEAR for name in POLES}
            near['κ'] = near['ICR'] & (np.abs(self.truth['κ']) * self.size <= NEAR)
        return near


class Figures(NamedTuple):
    """
    Ours, by quantity: `values` (M, C), `deviations` (M, C) as stated, in units of the quantity,
    `squares` (M, C), the squared error over the covariance, and `determined` (M, C).

    M are the frames `frames` (M,) of the recording.
    """

    frames: np.ndarray
    values: dict[str, np.ndarray]
    deviations: dict[str, np.ndarray]
    squares: dict[str, np.ndarray]
    determined: dict[str, np.ndarray]


def make_recording(
    names: tuple[str, ...], noises: tuple[float, ...], seeds: int, seconds: float
) -> Recording:
    """Record each motion at each noise level so many times, each from another instant on."""
    first, others = motions(), other_motions()
    known, numbers = first | others, sorted(first) + sorted(others)
    cases = tuple(
        Case(name, noise, seed) for name in names for noise in noises for seed in range(seeds)
    )
    count = round(seconds * RATE)
    points = np.empty((count, len(cases), 4), complex)
    position = np.empty((4, count, len(cases)), complex)
    angle = np.empty((4, count, len(cases)))
    parts = []
    for k, case in enumerate(cases):
        # Seeds by name, so that a case is the same in whatever selection it is in.
        number = numbers.index(case.motion)
        rng = np.random.default_rng((number, round(1e9 * case.noise), case.seed))
        moved, exact = observe(known[case.motion], times(count) + 0.37 * case.seed)
        noise = case.noise * known[case.motion].size
        points[:, k] = exact + noise * (rng.normal(size=(count, 4, 2)) @ (1, 1j))
        mean = planar.to_complex(known[case.motion].markers).mean()
        position[..., k] = (moved.position + mean * rotation_derivatives(moved.angle))[:4]
        angle[..., k] = moved.angle[:4]
        parts.append(quantities(moved.position, moved.angle))
    truth = {name: np.stack([part[name] for part in parts], axis=1) for name in QUANTITIES}
    size = np.array([known[case.motion].size for case in cases])
    shape = np.stack([planar.to_complex(known[case.motion].markers) for case in cases])
    shape -= shape.mean(axis=1, keepdims=True)
    return Recording(cases, points, truth, position, angle, shape, size)


def times(count: int) -> np.ndarray:
    """Instants (count,) of the frames, s."""
    return np.arange(count) / RATE


def observe(motion: Motion, t: np.ndarray) -> tuple[BodyMotion, np.ndarray]:
    """The motion at instants (N,) and its exact markers there, (N, n) complex."""
    moved = motion.motion(t)
    return moved, planar.to_complex(marker_positions(moved, motion.markers))


def quantities(position: np.ndarray, angle: np.ndarray) -> dict[str, np.ndarray]:
    """All quantities from derivatives of order 0 to 3 or more, (K, ...)."""
    result = {name: angle[k + 1] for k, name in enumerate(RATES)}
    result |= {name: planar.pole(k + 1, position, angle).value for k, name in enumerate(POLES)}
    result['κ'] = planar.centrode_curvature(position, angle).value.real
    return result


def frames_of(points: np.ndarray, stamps: np.ndarray) -> tuple[MarkerFrames, Settings]:
    """Frames of bodies seen at `points` (N, C, n), and settings that tell the bodies apart."""
    count, bodies, markers = points.shape
    names = {f'b{b}': tuple(f'm{b}_{k}' for k in range(markers)) for b in range(bodies)}
    identities = tuple(name for body in names.values() for name in body)
    solid = np.zeros((count, bodies * markers, 3))
    flat = points.reshape(count, -1)
    solid[..., 0], solid[..., 1] = flat.real, flat.imag
    frames = MarkerFrames(np.asarray(stamps, np.int64), 'world', identities, solid)
    return frames, Settings(bodies=names, window=WINDOW, lag=LAG)


def stamps_of(count: int) -> np.ndarray:
    """Stamps (count,) of the frames, ns."""
    return START + STEP * np.arange(count, dtype=np.int64)


def fit_poses(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Positions and continuous angles (N, C) of the bodies, fitted to their true shapes."""
    with np.errstate(all='ignore'):
        fit = fit_pose(recording.points, recording.shape, np.ones(recording.points.shape))
    return fit.position, np.unwrap(fit.angle, axis=0)


def measure(recording: Recording, tracker_type: type[Tracker] = Tracker, **changes: Any) -> Figures:
    """Run the tracker over a recording; `changes` are settings other than those above."""
    frames, settings = frames_of(recording.points, stamps_of(len(recording.points)))
    tracker = tracker_type(Settings(**{**vars(settings), **changes}))
    found = tracker.add(frames, 3)
    index = np.concatenate([(estimate.stamp - START) // STEP for estimate in found])
    kept = index >= WARM_UP * RATE
    index = index[kept]

    def joined(figures: list[Any]) -> Iterator[np.ndarray]:
        """Values, their variances or covariances, and where determined, of all blocks as one."""
        return (np.concatenate(part)[kept] for part in zip(*figures, strict=True))

    truth = {name: values[index] for name, values in recording.truth.items()}
    values: dict[str, np.ndarray] = {}
    deviations: dict[str, np.ndarray] = {}
    squares: dict[str, np.ndarray] = {}
    determined: dict[str, np.ndarray] = {}
    numbers = {name: [e.rate(k + 1) for e in found] for k, name in enumerate(RATES)}
    numbers['κ'] = [e.centrode_curvature for e in found]
    for name, figures in numbers.items():
        values[name], variance, determined[name] = joined(figures)
        with np.errstate(all='ignore'):
            deviations[name] = np.sqrt(variance)
            squares[name] = (values[name] - truth[name]) ** 2 / variance
    for k, name in enumerate(POLES):
        values[name], spread, determined[name] = joined([e.pole(k + 1) for e in found])
        deviations[name] = np.sqrt(spread[..., 0, 0] + spread[..., 1, 1])
        squares[name] = squared_error(values[name] - truth[name], spread)
    return Figures(index, values, deviations, squares, determined)


def squared_error(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Squared errors (...), of complex ones, over their covariance (..., 2, 2)."""
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    x, y = error.real, error.imag
    with np.errstate(all='ignore'):
        return np.asarray((d * x**2 - 2 * b * x * y + a * y**2) / (a * d - b**2))


def rms(error: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Root mean square (C,) of errors (M, C) over the frames in `where`; NaN where none are."""
    with np.errstate(all='ignore'):
        square = np.where(where, np.abs(error) ** 2, 0.0)
        return np.asarray(np.sqrt(square.sum(axis=0) / where.sum(axis=0)))
