"""From markers to poses: the buffer of frames, and the noise and shape that are learned."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stretches import fit_frames

from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.rigid import Noise, Samples, Shapes

pytestmark = pytest.mark.filterwarnings('error')


# --- the buffer ---------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.lists(st.one_of(st.integers(1, 150), st.floats(0, 1)), max_size=25))
def test_the_buffer_is_a_queue(actions: list[int | float]) -> None:
    """Whole numbers put in so many rows, fractions take out that share."""
    buffer = Samples((2,), float)
    model: list[tuple[float, float]] = []
    put = 0
    for action in actions:
        if isinstance(action, int):
            rows = [(float(put + k), -float(put + k)) for k in range(1, action + 1)]
            put += action
            buffer.room(action)[...] = rows
            model += rows
        else:
            count = int(action * len(model))
            buffer.drop(count)
            del model[:count]
        assert len(buffer) == len(model)
        assert buffer.view().shape == (len(model), 2)
        assert np.array_equal(buffer.view(), np.array(model).reshape(-1, 2))


def test_the_buffer_does_not_grow_with_what_goes_through() -> None:
    buffer = Samples((), np.int64)
    for k in range(10_000):
        buffer.room(1)[0] = k
        if len(buffer) > 60:
            buffer.drop(1)
    assert buffer.view().tolist() == list(range(9940, 10_000))
    whole = buffer.view().base
    assert whole is not None
    assert len(whole) <= 256


# --- noise and shape ----------------------------------------------------------------------------

SHAPE = np.array([14 + 2j, -3 + 10j, 6 - 15j, 13 + 1j, -20 - 10j, 5 + 5j, -10 + 12j, 20 - 3j])
SHAPE = np.concatenate((SHAPE, [-17 + 4j, 2 - 20j])) / 100
SIGMA = 1e-4


def poses(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a body is and how it is turned, in a smooth motion at 200 Hz."""
    times = np.arange(frames) / 200
    return 0.3 * np.exp(3j * times), 6 * times


def tracked(markers: int, frames: int, seed: int) -> np.ndarray:
    """Noisy markers (frames, markers) of the first of SHAPE's points."""
    rng = np.random.default_rng(seed)
    position, angle = poses(frames)
    exact = position[:, None] + np.exp(1j * angle)[:, None] * SHAPE[:markers]
    return exact + SIGMA * (rng.normal(size=(frames, markers, 2)) @ (1, 1j))


def measured(points: np.ndarray) -> float:
    """The noise level found, over the true one."""
    noise, shapes = Noise(1), Shapes(1, points.shape[1])
    deque(fit_frames(points[:, None], shapes, noise), maxlen=0)
    return float(noise.level()[0]) / SIGMA


@pytest.mark.parametrize(('markers', 'seed'), [(2, 0), (2, 1), (3, 2), (4, 0), (10, 1)])
def test_the_noise_is_measured(markers: int, seed: int) -> None:
    points = tracked(markers, 400, seed)
    assert measured(points) == pytest.approx(1, abs=0.15)
    rng = np.random.default_rng(seed)
    # Markers that are not seen now and then.
    dropped = np.where(rng.random(points.shape) < 0.2, np.nan, points)
    assert measured(dropped) == pytest.approx(1, abs=0.35)
    # A lens, or a plane that is not quite the markers': ten times the noise, but slow.
    position, _ = poses(400)
    bent = points + 10 * SIGMA * position[:, None] * np.arange(markers)
    assert measured(bent) == pytest.approx(1, abs=0.2)
    # A marker that jumps by 500 times the noise, each time spoiling three comparisons.
    jumping = points.copy()
    jumping[20::40, 0] += 500 * SIGMA
    assert measured(jumping) == pytest.approx(1.15, abs=0.35)
    # Where it jumps in every tenth frame the noise is at least not taken for less.
    jumping[rng.random(400) < 0.1, 0] += 500 * SIGMA
    assert measured(jumping) > 0.85


@pytest.mark.parametrize('speed', [1.0, 0.1, 0.02, 0.008])
def test_a_tracker_that_rounds_is_not_taken_for_exact(speed: float) -> None:
    times = np.arange(400) / 200
    exact = speed * times[:, None] + np.exp(1j * speed * 5 * times)[:, None] * SHAPE[:4]
    points = (exact / 1e-3).round() * 1e-3  # NumPy rounds both parts
    uniform = 1e-3 / np.sqrt(12) / SIGMA
    assert 0.1 * uniform < measured(points) < 1.5 * uniform


def test_the_noise_is_unknown_without_residuals() -> None:
    noise, shapes = Noise(2), Shapes(2, 3)
    assert np.isnan(noise.level()).all()
    points = tracked(3, 20, 0)
    both = np.stack([np.stack((row, [row[0], np.nan, np.nan])) for row in points])
    deque(fit_frames(both, shapes, noise), maxlen=0)
    assert np.isfinite(noise.level()).tolist() == [True, False]


def test_bodies_have_noise_of_their_own() -> None:
    quiet, loud = tracked(4, 400, 0), tracked(4, 400, 1)
    position, angle = poses(400)
    exact = position[:, None] + np.exp(1j * angle)[:, None] * SHAPE[:4]
    loud = exact + 100 * (loud - exact)
    noise, shapes = Noise(2), Shapes(2, 4)
    deque(fit_frames(np.stack((quiet, loud), axis=1), shapes, noise), maxlen=0)
    assert noise.level() / SIGMA == pytest.approx([1, 100], rel=0.15)


def test_residuals_across_a_gap_are_not_compared() -> None:
    def level(forget: bool) -> float:
        noise, k = Noise(1), np.arange(60)
        # Each third frame comes after a gap in which the distortion changed.
        bent = tracked(4, 60, 2) + (k // 3 % 2)[:, None] * 1e-2 * np.arange(4)
        fit = fit_pose(bent[:, None], SHAPE[None, :4], np.ones((60, 1, 4)))
        noise.add(fit.residual, fit.freedom, (k % 3 != 0) | (not forget))
        return float(noise.level()[0]) / SIGMA

    assert level(True) == pytest.approx(1, abs=0.35)
    assert level(False) > 10


def learned(points: np.ndarray) -> tuple[Shapes, list[Fit]]:
    shapes = Shapes(1, points.shape[1])
    return shapes, [fit for fit, _ in fit_frames(points[:, None], shapes)]


def shape_error(shapes: Shapes, markers: int) -> float:
    """RMS distance of the learned shape from the true one, laid on it, over the noise."""
    fit = fit_pose(shapes.points[0], SHAPE[:markers].astype(complex), np.ones(markers))
    return float(np.sqrt((np.abs(fit.residual) ** 2).mean())) / SIGMA


@pytest.mark.parametrize('markers', [2, 4, 10])
def test_the_shape_gets_better_with_every_frame(markers: int) -> None:
    points = tracked(markers, 1600, 3)
    for frames in (25, 100, 400, 1600):
        shapes, _ = learned(points[:frames])
        # A mean of N frames is off by sqrt(2 / N); its growing weights cost sqrt(4 / 3) more.
        assert shape_error(shapes, markers) < 2.2 * np.sqrt(2 / frames)


def test_a_marker_seen_late_joins_the_shape() -> None:
    points = tracked(5, 800, 4)
    points[:400, 3] = np.nan
    points[np.random.default_rng(5).random(points.shape) < 0.3] = np.nan
    shapes, fits = learned(points)
    assert shapes.known.tolist() == [5]
    assert shape_error(shapes, 5) < 0.3
    spread = np.sum(np.abs(SHAPE[:5] - SHAPE[:5].mean()) ** 2)
    assert shapes.spread == pytest.approx(spread, rel=0.01)
    enough = (~np.isnan(points)).sum(axis=1) >= 2
    assert np.array_equal([np.isfinite(fit.angle[0]) for fit in fits], enough)


def test_the_frame_of_a_body_does_not_creep() -> None:
    position, angle = poses(2000)
    for markers in (2, 4):
        _, fits = learned(tracked(markers, 2000, 6))
        turned = np.array([fit.angle[0] for fit in fits]) - angle
        turned = np.angle(np.exp(1j * (turned - turned[0])))
        arm = np.array([fit.position[0] for fit in fits]) - position
        arm = arm * np.exp(-1j * angle)
        arm = arm - arm[0]
        for values in (turned * np.abs(SHAPE).mean(), np.abs(arm - arm[:500].mean())):
            early, late = values[100:600], values[1500:]
            # Each mean is known to about the noise over sqrt(500).
            assert abs(early.mean() - late.mean()) < 0.25 * SIGMA


def test_a_body_starts_at_its_mean_along_the_axes_of_the_ground() -> None:
    points = tracked(4, 1, 7)
    points[0, 2] = np.nan
    shapes, fits = learned(points)
    seen = np.delete(points[0], 2)
    assert fits[0].angle[0] == pytest.approx(0, abs=1e-12)
    assert fits[0].position[0] == pytest.approx(seen.mean())
    assert np.delete(shapes.points[0], 2) == pytest.approx(seen - seen.mean())
    assert shapes.known.tolist() == [3]


@pytest.mark.parametrize('place', [0j, 0.1 + 0.7j, 1e6 + 0.1j])
def test_markers_at_one_place_at_first_do_not_spoil_the_shape(place: complex) -> None:
    points = tracked(4, 60, 8)
    points[:10] = place
    shapes, fits = learned(points)
    assert [np.isfinite(fit.angle[0]) for fit in fits] == 10 * [False] + 50 * [True]
    assert shape_error(shapes, 4) < 1


def test_room_for_more_markers_keeps_what_is_known() -> None:
    points = tracked(6, 200, 9)
    shapes, _ = learned(points[:100, :4])
    shapes.learn()
    before = shapes.points.copy()
    shapes.widen(6)
    assert np.array_equal(shapes.points[:, :4], before)
    assert shapes.known.tolist() == [4]
    deque(fit_frames(points[100:, None], shapes), maxlen=0)
    assert shapes.known.tolist() == [6]
    assert shape_error(shapes, 6) < 0.6
