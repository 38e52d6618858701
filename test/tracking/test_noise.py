"""The noise level where frames go wild, and where a tracker rounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stretches import follow

from bench._record import make_recording, measure
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.noise import white_noise
from kinpole_ros.tracking.tracker import Tracker

SHAPE = np.array([14 + 2j, -3 + 10j, 6 - 15j, 13 + 1j, -20 - 10j, 5 + 5j, -10 + 12j, 20 - 3j])
SHAPE = np.concatenate((SHAPE, [-17 + 4j, 2 - 20j])) / 100
SIGMA = 1e-4


def markers(count: int, frames: int, seed: int, noise: float = SIGMA) -> np.ndarray:
    """Noisy markers (frames, count) of a body in smooth motion, 200 frames a second."""
    times = np.arange(frames)[:, None] / 200
    exact = 0.3 * np.exp(3j * times) + np.exp(6j * times) * SHAPE[:count]
    normal = np.random.default_rng(seed).normal(size=(frames, count, 2))
    return np.asarray(exact + noise * (normal @ (1, 1j)))


def gone_wild(points: np.ndarray, share: float, jump: float, seed: int) -> np.ndarray:
    """One marker of each of so many frames is farther off than its noise by `jump` times SIGMA."""
    rng = np.random.default_rng(seed + 100)
    wild = np.flatnonzero(rng.random(len(points)) < share)
    points = points.copy()
    way = np.exp(2j * np.pi * rng.random(len(wild)))
    points[wild, rng.integers(points.shape[1], size=len(wild))] += jump * SIGMA * way
    return points


def level(points: np.ndarray) -> tuple[float, Tracker]:
    """The noise level after all frames, over SIGMA, and the tracker."""
    tracker, _ = follow(points[:, None])
    tracker.learn_if_due()
    return float(tracker.noise()[0]) / SIGMA, tracker


# Where none goes wild it does not matter how far.
@pytest.mark.parametrize(
    ('share', 'most', 'jump'),
    [(0.0, 1.15, 0), (0.1, 1.2, 20), (0.1, 1.2, 500), (0.25, 2.0, 20), (0.25, 2.0, 100)],
)
@pytest.mark.parametrize('count', [2, 4, 10])
def test_wild_frames_from_the_first_on_hardly_raise_the_level(
    count: int, share: float, most: float, jump: float
) -> None:
    found = [level(gone_wild(markers(count, 400, s), share, jump, s))[0] for s in range(2)]
    assert min(found) > 0.85
    assert max(found) < most


@pytest.mark.parametrize('count', [2, 4])
def test_wild_frames_are_told_apart_by_the_level_alone(count: int) -> None:
    """With fits to the true shape, none of them mended."""
    for seed in range(3):
        wild = gone_wild(markers(count, 600, seed), 0.25, 500, seed)[:, None]
        fit = fit_pose(wild, SHAPE[None, :count], np.ones(wild.shape))
        noise, _ = white_noise(fit.residual, fit.freedom, np.ones(len(wild), bool))
        assert noise[0] / SIGMA == pytest.approx(1, abs=0.2)


def test_noise_that_grows_is_believed() -> None:
    loud = markers(4, 1200, 0, 10 * SIGMA)
    loud[:400] = markers(4, 400, 0)
    assert level(loud[:400])[0] == pytest.approx(1, abs=0.15)
    assert level(loud)[0] == pytest.approx(10, rel=0.15)


@pytest.mark.parametrize('rest', [0, 150, 500])
@pytest.mark.parametrize('speed', [1.0, 0.1, 0.008])
def test_a_tracker_that_rounds_is_neither_exact_nor_wild(speed: float, rest: int) -> None:
    times = np.maximum(np.arange(rest + 400) - rest, 0) / 200
    exact = speed * times[:, None] + np.exp(1j * speed * 5 * times)[:, None] * SHAPE[:4]
    found, tracker = level((exact / 1e-3).round() * 1e-3)
    uniform = 1e-3 / np.sqrt(12) / SIGMA
    assert 0.05 * uniform < found < 1.5 * uniform
    assert not tracker.update_counts()['markers_left_out']


@settings(max_examples=8)
@given(
    turn=st.floats(-3, 3),
    shift=st.complex_numbers(max_magnitude=10),
    scale=st.floats(-3, 3).map(lambda x: 10**x),
    order=st.permutations(range(4)),
)
def test_the_level_scales_with_the_markers_and_depends_on_nothing_else(
    turn: float, shift: complex, scale: float, order: list[int]
) -> None:
    points = gone_wild(markers(4, 80, 1), 0.15, 300, 1)
    there = (scale * np.exp(1j * turn) * points + scale * shift)[:, order]
    assert level(there)[0] == pytest.approx(scale * level(points)[0], rel=1e-6)


def test_noise_of_a_hundredth_of_the_size_is_no_doubt_of_names() -> None:
    """Before it is known what markers leave as a rule."""
    recording = make_recording(('dead point', 'four-bar coupler'), (1e-2,), 2, 2.0)
    found = measure(recording)
    square = found.squares['ω'][found.determined['ω']]
    assert len(square) > 200
    assert square.max() < 36
