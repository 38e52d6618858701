"""
A real double pendulum, filmed, against fixed local polynomials in hindsight.

The data are not part of the project: what is judged, and where, is as the README beside them has
it. The first link hangs on a pivot at its red marker and bears the second one at its green.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench._hindsight import apply_weights
from bench._polynomial import derivative_weights
from bench._record import START
from kinpole_ros import planar
from kinpole_ros.planar._poles import rotation_coefficient
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

TABLE = Path(__file__).parents[2] / 'shared' / 'data' / 'double_pendulum' / 'run16.csv'
# Samples and degree of the rivals, per marker and centered.
FIXED = ((11, 3), (21, 3), (31, 4), (41, 4), (41, 5))
LINKS = Settings(
    bodies={'link1': ('red', 'green'), 'link2': ('green', 'blue')}, window=0.2, lag=0.1
)
PLACES = (
    'ICR of link1 to pivot',
    'relative ICR to joint',
    'ICR of link2 to line',
    'IAP of link1 to pivot',
    'IJP of link1 to pivot',
)
_RATE = 500  # Hz
_SCALE = 1.546e-4  # m per unit of the table
# Frames left out at both ends.
_ENDS = 100
# Whose rates say which frames are judged, the same ones for all.
_JUDGE = (31, 4)
# What the joint is smoothed by: in one frame it is as noisy as what is judged.
_JOINT = (21, 3)


def general_pole(estimate: Estimate, order: int) -> np.ndarray:
    """Pole (B,) by the general formula, whatever is known of a pin; NaN where undetermined."""
    value = estimate.general_pole(order).value
    return np.where(estimate.pole(order).determined, value, np.nan)


def own_pole(estimate: Estimate, order: int) -> np.ndarray:
    """Pole (B,) as published, on the pin where one is recognized; NaN where undetermined."""
    pole = estimate.pole(order)
    return np.where(pole.determined, pole.value, np.nan)


# Each gets a row of its own: the poles (B,) of an order of all bodies.
OURS: dict[str, Callable[[Estimate, int], np.ndarray]] = {
    'ours, general poles': general_pole,
    'ours, pins recognized': own_pole,
}


def pendulum() -> list[dict[str, object]]:
    """
    One row by way and place: median and 90th percentile of the distance over link1's length.

    `frames` are judged, `told` is the share of them in which there is a figure. Raises OSError
    where the data are not there.
    """
    table = np.loadtxt(TABLE, delimiter=',', skiprows=1)[:, 1:] * _SCALE
    # Red, green and blue (frames, 3), y up.
    seen = table[:, 0::2] - 1j * table[:, 1::2]
    frames = np.arange(_ENDS, len(seen) - _ENDS)
    ways = {f'{n} frames, degree {d}': _fixed(seen, frames, n, d) for n, d in FIXED}
    estimates = _track(seen, frames)
    found = {name: _poles(*motion) for name, motion in ways.items()}
    found |= {name: _own_poles(estimates, pole) for name, pole in OURS.items()}
    judged = _judged(_fixed(seen, frames, *_JUDGE)[1])
    pivot = np.median(seen[:, 0].real) + 1j * np.median(seen[:, 0].imag)
    length = np.median(np.abs(seen[:, 1] - seen[:, 0]))
    (smooth,) = apply_weights(*_centered(*_JOINT), frames, seen)
    joint = smooth[0, :, 1]
    along = (pivot - joint) / np.abs(pivot - joint)
    rows: list[dict[str, object]] = []
    for name, poles in found.items():
        off = poles - np.stack((pivot + 0 * joint, joint, joint, *2 * (pivot + 0 * joint,)))
        # Of the distance to the joint only what is across the line counts.
        off[2] = (off[2] * along.conj()).imag
        for place, error, mask in zip(PLACES, np.abs(off) / length, judged, strict=True):
            told = error[mask & np.isfinite(error)]
            rows.append(
                {
                    'way': name,
                    'place': place,
                    'frames': int(mask.sum()),
                    'told': len(told) / mask.sum(),
                    'median': float(np.median(told)),
                    'ninetieth': float(np.percentile(told, 90)),
                }
            )
    return rows


def _centered(samples: int, degree: int) -> tuple[np.ndarray, int]:
    half = samples // 2
    return derivative_weights(np.arange(-half, half + 1) / _RATE, degree, 3), half


def _fixed(
    seen: np.ndarray, frames: np.ndarray, samples: int, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Position and angle (5, M, 2) of both links with their derivatives, by fixed windows."""
    (found,) = apply_weights(*_centered(samples, degree), frames, seen)
    motion = planar.landmark_kinematics(*planar.to_plane(found[..., [[0, 1], [1, 2]]]))
    return planar.to_complex(motion.position), motion.angle


def _poles(position: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Poles (5, M), one row by place, from position and angle (5, M, 2)."""
    icr, iap, ijp = (planar.pole(order, position, angle).value for order in (1, 2, 3))
    (z1, z2), (turn1, turn2) = (np.moveaxis(part, -1, 0) for part in (position, angle))
    relative, _ = planar.relative_pole(z2, turn2, z1, turn1)
    return np.stack((icr[:, 0], relative.value, icr[:, 1], iap[:, 0], ijp[:, 0]))


def _judged(angle: np.ndarray) -> np.ndarray:
    """Frames (5, M) judged at each place: where the links turn, per frame, as the README says."""
    w, a, j = (angle[k] / _RATE**k for k in (1, 2, 3))
    first, second = np.abs(w).T > 0.01
    coefficients = [np.abs(rotation_coefficient(k, (angle[0], w, a, j))) for k in (2, 3)]
    return np.stack(
        (
            first,
            np.abs(w[:, 1] - w[:, 0]) > 0.01,
            second,
            coefficients[0][:, 0] > 4e-4,
            coefficients[1][:, 0] > 1.6e-5,
        )
    )


def _track(seen: np.ndarray, frames: np.ndarray) -> list[Estimate]:
    """Estimates at the frames, from the tracker as it runs live."""
    points = np.zeros((*seen.shape, 3))
    points[..., 0], points[..., 1] = seen.real, seen.imag
    names = ('red', 'green', 'blue')
    step = 10**9 // _RATE
    tracker = Tracker(LINKS)
    stamps = START + step * np.arange(len(points))
    found = tracker.add(MarkerFrames(stamps, 'world', names, points), 3)
    by_stamp = {int(instant.stamp): instant for block in found for instant in block}
    return [by_stamp[START + step * int(frame)] for frame in frames]


def _own_poles(
    estimates: list[Estimate], pole: Callable[[Estimate, int], np.ndarray]
) -> np.ndarray:
    """Poles (5, M), one row by place, NaN where they are not determined."""
    orders = (np.array([pole(estimate, order) for estimate in estimates]) for order in (1, 2, 3))
    icr, iap, ijp = orders
    centers = (estimate.relative_icr for estimate in estimates)
    relative = [np.where(center.determined, center.value, np.nan)[0] for center in centers]
    return np.stack((icr[:, 0], relative, icr[:, 1], iap[:, 0], ijp[:, 0]))
