"""Markers spoiled as trackers spoil them, and the error of the angular velocity."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import kinpole_ros

RATE, SECONDS, SINCE, NOISE = 200.0, 5.0, 2.0, 2e-4
SHAPES = {
    'kite': np.array([0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j]),
    'boat': np.array([0.11, 0.02 + 0.05j, -0.09 + 0.03j, -0.02 - 0.07j]),
}
Spoil = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def poses(motion: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, m, angles, rad, and angular velocities, rad/s, of a body."""
    w = 2 * np.pi
    if motion == 'crank':
        angle, rate = w * 1.5 * t, w * 1.5 * (1 + 0.1 * np.cos(w * 1.5 * t))
        return 0.08 * np.exp(1j * angle), angle + 0.1 * np.sin(angle), rate
    place = 0.05 * np.cos(w * 1.3 * t) + 0.03j * np.sin(w * 0.8 * t)
    angle = 0.8 * np.sin(w * 0.9 * t) + 0.2 * np.sin(w * 2.1 * t + 1)
    return place, angle, 0.72 * w * np.cos(w * 0.9 * t) + 0.42 * w * np.cos(w * 2.1 * t + 1)


def spikes(size: float, share: float) -> Spoil:
    """That share of the samples is off by so many m."""

    def spoil(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        hit = rng.random(points.shape) < share
        points[hit] += size * np.exp(2j * np.pi * rng.random(np.count_nonzero(hit)))
        return points

    return spoil


def exchanged(pairs: list[tuple[int, int]], until: float) -> Spoil:
    """Markers have each other's names from 2.5 s on."""

    def spoil(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        rows = np.flatnonzero((t >= 2.5) & (t < until))[:, None]
        for one, other in pairs:
            points[rows, [one, other]] = points[rows, [other, one]]
        return points

    return spoil


def wild_start(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    points[:5, 2] += 0.3 * np.exp(2j * np.pi * rng.random(5))
    return points


def turned(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The whole body is elsewhere in single frames."""
    for k in range(430, len(t), 61):
        middle = points[k].mean()
        points[k] = middle + (points[k] - middle) * np.exp(0.4j) + 0.05
    return points


def three_in_a_row(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    for k in range(430, len(t), 97):
        points[k : k + 3] += 0.06
    return points


def lost(t: np.ndarray, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Of 30% of the frames nothing comes."""
    points[rng.random(len(t)) < 0.3] = np.nan
    return points


def measured(motion: str, shape: str, spoil: Spoil | None) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the angular velocity (T,), NaN where there is none, and the same in deviations."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    place, angle, rate = poses(motion, t)
    rng = np.random.default_rng(7)
    points = place[:, None] + SHAPES[shape] * np.exp(1j * angle)[:, None]
    points += NOISE * (rng.normal(size=(*points.shape, 2)) @ (1, 1j))
    if spoil is not None:
        points = spoil(t, points, np.random.default_rng(3))
    frames = ~np.isnan(points).all(axis=1)
    stamps = np.rint(t * 1e9).astype(np.int64)
    flat = np.stack((points.real, points.imag), axis=-1)
    found = kinpole_ros.track(flat[frames], stamps[frames], {'body': range(4)}, window=0.4, lag=0.1)
    row = np.rint(found.t * RATE).astype(int)
    error, share = np.full((2, len(t)), np.nan)
    error[row] = found['body'].angular_velocity - rate[row]
    share[row] = error[row] / found['body'].angular_velocity_sigma
    return error[t > SINCE], share[t > SINCE]


@cache
def ideal(motion: str, shape: str) -> np.ndarray:
    return measured(motion, shape, None)[0]


@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('motion', ['sines', 'crank'])
@pytest.mark.parametrize(
    ('spoil', 'bar'),
    [
        (spikes(5e-3, 0.01), 1.5),
        (spikes(50e-3, 0.01), 1.5),
        (spikes(50e-3, 0.05), 2.0),
        (exchanged([(0, 1)], 2.8), 1.5),
        (exchanged([(0, 1)], np.inf), 1.5),
        (exchanged([(0, 1), (2, 3)], 2.8), 1.5),
        (exchanged([(0, 1), (2, 3)], np.inf), 1.5),
        (wild_start, 1.5),
        (turned, 1.5),
        (three_in_a_row, 1.5),
        (lost, 2.0),
    ],
    ids=[
        'spikes of 5 mm in 1%',
        'spikes of 50 mm in 1%',
        'spikes of 50 mm in 5%',
        'two exchanged for 0.3 s',
        'two exchanged for good',
        'two pairs exchanged for 0.3 s',
        'two pairs exchanged for good',
        'wild in the first five frames',
        'body turned in single frames',
        'body elsewhere in three frames in a row',
        '30% of the frames lost',
    ],
)
def test_spoiled_markers_hardly_spoil_the_angular_velocity(
    spoil: Spoil, bar: float, motion: str, shape: str
) -> None:
    error, share = measured(motion, shape, spoil)
    usual = ideal(motion, shape)
    both = np.isfinite(error) & np.isfinite(usual)
    # Instants of lost frames have no result.
    least = 0.65 if spoil is lost else 0.95
    assert both.sum() > least * np.isfinite(usual).sum()
    assert np.sqrt(np.mean(error[both] ** 2)) <= bar * np.sqrt(np.mean(usual[both] ** 2))
    assert np.mean(np.abs(share[both]) > 5) <= 0.002
