"""From markers to poses: the buffer of frames, and the noise and shape that are learned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stretches import follow

from kinpole_ros.planar import fit_pose
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking import update
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.noise import white_noise
from kinpole_ros.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings('error')


# --- the buffer ---------------------------------------------------------------------------------


@given(st.lists(st.one_of(st.integers(1, 150), st.floats(0, 1)), max_size=25))
def test_the_history_is_a_queue(actions: list[int | float]) -> None:
    """Whole numbers append so many rows, fractions drop that share."""
    history = History(2, 1)
    model: list[int] = []
    appended = 0
    for action in actions:
        if isinstance(action, int):
            for _ in range(action):
                appended += 1
                history.reserve(1)
                history.end += 1
                history['stamp'][-1], history['angle'][-1] = appended, (appended, -appended)
                model.append(appended)
        else:
            count = int(action * len(model))
            history.drop(count)
            del model[:count]
        assert len(history) == len(model) == appended - history.dropped
        assert history['stamp'].tolist() == model
        assert np.array_equal(history['angle'], np.outer(model, (1, -1)).reshape(-1, 2))


def test_the_history_does_not_grow_with_what_goes_through() -> None:
    history = History(1, 2)
    for k in range(10_000):
        history.reserve(1)
        history.end += 1
        history['stamp'][-1] = k
        if len(history) > 60:
            history.drop(1)
    assert history['stamp'].tolist() == list(range(9940, 10_000))
    assert len(history.columns['stamp']) <= 256


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
    return float(learned(points)[0].noise()[0]) / SIGMA


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
    points = tracked(3, 20, 0)
    both = np.stack([np.stack((row, [row[0], np.nan, np.nan])) for row in points])
    tracker, _ = follow(both[:1])
    assert np.isnan(tracker.noise()).all()
    tracker, _ = follow(both)
    tracker.learn_if_due()
    assert np.isfinite(tracker.noise()).tolist() == [True, False]


def test_bodies_have_noise_of_their_own() -> None:
    quiet, loud = tracked(4, 400, 0), tracked(4, 400, 1)
    position, angle = poses(400)
    exact = position[:, None] + np.exp(1j * angle)[:, None] * SHAPE[:4]
    loud = exact + 100 * (loud - exact)
    tracker, _ = follow(np.stack((quiet, loud), axis=1))
    assert tracker.noise() / SIGMA == pytest.approx([1, 100], rel=0.15)


def test_residuals_across_a_gap_are_not_compared() -> None:
    def level(forget: bool) -> float:
        k = np.arange(60)
        # Each third frame comes after a gap in which the distortion changed.
        bent = tracked(4, 60, 2) + (k // 3 % 2)[:, None] * 1e-2 * np.arange(4)
        fit = fit_pose(bent[:, None], SHAPE[None, :4], np.ones((60, 1, 4)))
        goes_on = (k % 3 != 0) | (not forget)
        return float(white_noise(fit.residual, fit.freedom, goes_on)[0][0]) / SIGMA

    assert level(True) == pytest.approx(1, abs=0.35)
    assert level(False) > 10


def learned(points: np.ndarray) -> tuple[Tracker, np.ndarray, np.ndarray]:
    """The tracker after all frames, and the positions and angles of the frames it knows."""
    tracker, _ = follow(points[:, None])
    tracker.learn_if_due()
    history = tracker.state.history
    return tracker, history['position'][:, 0], history['angle'][:, 0]


def shape_error(tracker: Tracker, markers: int) -> float:
    """RMS distance of the learned shape from the true one, laid on it, over the noise."""
    shape = tracker.state.bodies.shape[0]
    fit = fit_pose(shape, SHAPE[:markers].astype(complex), np.ones(markers))
    return float(np.sqrt((np.abs(fit.residual) ** 2).mean())) / SIGMA


@pytest.mark.parametrize('markers', [2, 4, 10])
def test_the_shape_gets_better_with_every_frame(markers: int) -> None:
    points = tracked(markers, 1600, 3)
    for frames in (25, 100, 400, 1600):
        tracker, *_ = learned(points[:frames])
        # A mean of N frames is off by sqrt(2 / N); it is held from 1,000 frames on.
        assert shape_error(tracker, markers) < 2.2 * np.sqrt(2 / min(frames, 1000))


def test_a_marker_seen_late_joins_the_shape() -> None:
    points = tracked(5, 800, 4)
    points[:400, 3] = np.nan
    points[np.random.default_rng(5).random(points.shape) < 0.3] = np.nan
    tracker, _, angle = learned(points)
    assert tracker.state.bodies.placement.learned_count.tolist() == [5]
    assert shape_error(tracker, 5) < 0.3
    spread = np.sum(np.abs(SHAPE[:5] - SHAPE[:5].mean()) ** 2)
    assert tracker.state.bodies.placement.spread == pytest.approx(spread, rel=0.01)
    enough = (~np.isnan(points)).sum(axis=1) >= 2
    assert np.array_equal(np.isfinite(angle), enough)


def test_the_frame_of_a_body_does_not_creep() -> None:
    position, angle = poses(2000)
    for markers in (2, 4):
        _, (found,) = follow(tracked(markers, 2000, 6)[:, None])
        seen = found.frame_poses
        assert seen is not None
        rows = slice(2000 - len(found), None)
        turned = np.angle(np.exp(1j * (seen.angle[:, 0] - angle[rows])))
        arm = (seen.position[:, 0] - position[rows]) * np.exp(-1j * angle[rows])
        for values in ((turned - turned[0]) * np.abs(SHAPE).mean(), np.abs(arm - arm[:500].mean())):
            early, late = values[100:600], values[1400:]
            # Each mean is known to about the noise over sqrt(500).
            assert abs(early.mean() - late.mean()) < 0.25 * SIGMA


def test_a_body_starts_at_its_mean_along_the_axes_of_the_ground() -> None:
    points = tracked(4, 1, 7)
    points[0, 2] = np.nan
    tracker, position, angle = learned(points)
    seen = np.delete(points[0], 2)
    assert angle[0] == pytest.approx(0, abs=1e-12)
    assert position[0] == pytest.approx(seen.mean())
    assert np.delete(tracker.state.bodies.shape[0], 2) == pytest.approx(seen - seen.mean())
    assert tracker.state.bodies.placement.learned_count.tolist() == [3]


@pytest.mark.parametrize('place', [0j, 0.1 + 0.7j, 1e6 + 0.1j])
def test_markers_at_one_place_at_first_do_not_spoil_the_shape(place: complex) -> None:
    points = tracked(4, 60, 8)
    points[:10] = place
    tracker, _, angle = learned(points)
    assert np.isfinite(angle).tolist() == 10 * [False] + 50 * [True]
    assert shape_error(tracker, 4) < 1


def test_the_history_is_bounded_in_bytes_however_many_frames_a_window_has(monkeypatch) -> None:
    monkeypatch.setattr(update, 'MAX_HISTORY_BYTES', 2**20)
    settings = settings_from({'body.markers': ['0', '1'], 'window': 1.0, 'lag': 0.0})
    tracker, found = Tracker(settings), []
    t = np.arange(20_000) * 1e-6
    points = np.exp(1j * t[:, None]) * np.array([0.1, -0.1])
    space = np.stack((points.real, points.imag, 0 * points.real), axis=-1)
    stamps = 1_000_000_000 + np.arange(len(t)) * 1_000
    for k in range(0, len(t), 2000):
        part = slice(k, k + 2000)
        frames = MarkerFrames(stamps[part], 'map', ('0', '1'), space[part])
        found += tracker.add(frames, 1 if k + 2000 == len(t) else None)
        tracker.learn_if_due()
    columns = tracker.state.history.columns.values()
    assert sum(column.nbytes for column in columns) < 3 * 2**20
    # Results go on, from what is kept of the window.
    assert len(found) and len(found[-1]) > 1000
