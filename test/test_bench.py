"""The benchmarks themselves: exact motions, rivals that are what they are called, honest counts."""

import numpy as np
import pytest

from kinpole_ros.bench import hindsight_table, motions
from kinpole_ros.bench._hindsight import apply_weights, fixed_weights
from kinpole_ros.bench._peers import make_kalman, run_kalman
from kinpole_ros.bench._record import QUANTITIES, make_recording, rms

STEP = 1e-5


@pytest.mark.parametrize('name', motions())
def test_each_derivative_is_the_slope_of_the_one_before(name: str) -> None:
    t = np.arange(0.0071, 2.2, 0.0137)
    motion = motions()[name].motion
    here, before, after = motion(t), motion(t - STEP), motion(t + STEP)
    for exact, low, high in zip(here, before, after, strict=True):
        for order in range(1, 5):
            slope = (high[order - 1] - low[order - 1]) / (2 * STEP)
            allowed = 1e-4 * np.abs(exact[order]).max() + 1e-4
            assert np.abs(slope - exact[order]).max() < allowed


def test_table_of_one_motion_has_every_quantity_and_sane_ratios() -> None:
    rows, covered = hindsight_table(('four-bar coupler',), (1e-3,), 1, 3.0)
    assert [row['quantity'] for row in rows] == list(QUANTITIES)
    assert {row['quantity'] for row in covered} == set(QUANTITIES)
    for row in rows:
        # The rival is picked in hindsight, but it keeps one setting; ours is not far from it.
        assert 0.2 < row['ratio'] < 5
    assert all(0.5 < row['covered'] <= 1 for row in covered)


def test_a_case_is_the_same_in_whatever_selection_it_is_in() -> None:
    alone = make_recording(('two sines',), (1e-3,), 1, 0.5)
    among = make_recording(('dead point', 'two sines'), (1e-2, 1e-3), 2, 0.5)
    k = [(c.motion, c.noise, c.seed) for c in among.cases].index(('two sines', 1e-3, 0))
    assert np.array_equal(alone.points[:, 0], among.points[:, k])


def test_fixed_rival_is_exact_on_polynomials() -> None:
    t = np.arange(100) / 200
    frames = np.arange(45, 60)
    weights, ahead = fixed_weights(31, 4)
    (found,) = apply_weights(weights, ahead, frames, (1 + t**4)[:, None])
    expected = [1 + t**4, 4 * t**3, 12 * t**2, 24 * t]
    assert found[..., 0] == pytest.approx(np.array(expected)[:, frames], rel=1e-6, abs=1e-6)


def test_kalman_smoother_is_exact_on_what_it_models_and_better_than_the_filter() -> None:
    t = np.arange(600.0)
    frames = np.arange(400, 560)
    cubic = (2 + 0.1 * t + 1e-3 * t**2 + 1e-6 * t**3)[:, None]
    found = run_kalman(make_kalman(1e-6, 20), cubic, frames)
    assert found[1, :, 0] == pytest.approx((0.1 + 2e-3 * t + 3e-6 * t**2)[frames], rel=1e-6)
    noisy = cubic + np.random.default_rng(0).normal(size=(600, 40))
    errors = [
        np.sqrt(np.mean((run_kalman(make_kalman(1e-10, lag), noisy, frames) - found)[1] ** 2))
        for lag in (0, 20)
    ]
    assert errors[1] < errors[0] / 2


def test_rms_counts_only_the_frames_that_count() -> None:
    error = np.array([[3.0], [np.nan], [4.0], [1e9]])
    where = np.array([[True], [False], [True], [False]])
    assert rms(error, where) == pytest.approx([np.sqrt(12.5)])
