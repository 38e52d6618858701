"""Each verdict has a name, a count, and a text that diagnostics print; none drops in silence."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from rig_streams import FRAMES, PARAMETERS, Stream, frames, markers, tilted_poses, usual

from kinpole_ros.messages._diagnostics import COUNT_KEYS
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking import correction, rejection
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.plane import plane_along
from kinpole_ros.tracking.tracker import Tracker


def track(given: MarkerFrames, size: int = 1, **parameters: object) -> Tracker:
    tracker = Tracker(settings_from(PARAMETERS | parameters))
    for k in range(0, len(given.stamps), size):
        part = slice(k, k + size)
        axes = None if given.axes is None else given.axes[part]
        block = given._replace(stamps=given.stamps[part], points=given.points[part], axes=axes)
        tracker.add(block, 4)
        tracker.learn_if_due()
    return tracker


def test_each_count_of_the_table_of_verdicts_is_printed_by_diagnostics() -> None:
    assert rejection.__doc__ is not None
    rows = re.findall(r'^\| a (\w+) .* \| ([\w -]+) \|$', rejection.__doc__, re.MULTILINE)
    counted = {count for _, count in rows} - {'-', 'a reason'}
    assert len(rows) > 20 and len(counted) >= 10
    assert counted <= COUNT_KEYS.keys()
    # What is left out of a frame, or moved in it, is counted.
    names = ('EXCHANGED', 'LEFT_OUT', 'MIRRORED', 'DROPPED', 'TOO_FAR')
    assert counted >= {getattr(rejection, name) for name in names}


def test_a_marker_beyond_all_possible_places_is_not_seen_and_is_counted() -> None:
    given = frames(markers(1))
    given.points[200, 2, 0], given.points[201, 5, 1] = 1e160, -1e15
    tracker = track(given)
    assert tracker.update_counts()['markers_too_far'] == 2
    assert tracker.update_counts()['markers_not_seen'] == 2


def test_a_body_dropped_for_its_misfit_is_counted() -> None:
    points = markers(2)
    # Two markers that are off together: without one of them the other still does not fit.
    points[300, 1] += 0.05
    points[300, 2] += 6.5e-4
    tracker = track(frames(points))
    assert tracker.update_counts()['markers_left_out'] == 1
    assert tracker.update_counts()['markers_of_misfits'] == 3
    assert type(tracker.update_counts()['markers_left_out']) is int


def test_markers_that_stay_exchanged_are_usual_frames_again(monkeypatch) -> None:
    corrected = []
    correct_frame = correction.correct_frame

    def noted(*given: object) -> object:
        corrected.append(given)
        return correct_frame(*given)

    monkeypatch.setattr(correction, 'correct_frame', noted)
    points = markers(3)
    points[200:, [0, 1]] = points[200:, [1, 0]]
    tracker = track(frames(points))
    assert len(corrected) == 1
    # Two markers in each of the first hundred frames; then their names were wrong before.
    assert tracker.update_counts()['markers_exchanged'] == 200
    assert tracker.state.step.tracks['seen_last'].tolist() == [frames(points).stamps[-1]] * 2


def test_an_outage_that_begins_before_the_plane_is_known_is_noted() -> None:
    points = markers(4)
    space = plane_along((0.3, 0.2, 0.9)).in_space(points, np.zeros(points.shape))
    given = frames(points)._replace(points=space)
    tracker = track(given, plane='fit')
    learned = int(np.flatnonzero(np.isfinite(tracker.state.history['angle'][:, 0]))[0])
    assert tracker.plane is not None and not tracker.outages()
    # The coupler goes while the plane is not known, and comes back long after.
    space[6:200, 4:] = np.nan
    tracker = track(given, plane='fit')
    assert tracker.plane is not None
    assert learned == 0 and tracker.outages()['coupler'].times == 1


def test_points_of_any_size_and_resolution_stop_nothing() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        points = 300 * markers(seed, 0.0)
        # At rest, with noise of exactly zero, then turning; whole pixels; a spike or two.
        points[: FRAMES // 3] = points[FRAMES // 3]
        given = frames(np.round(points.real) + 1j * np.round(points.imag))
        spikes = rng.choice(FRAMES, 5, replace=False), rng.integers(8, size=5)
        given.points[(*spikes, rng.integers(3, size=5))] = 10.0 ** rng.integers(15, 308, size=5)
        late = rng.exponential(3e6, FRAMES).astype(np.int64)
        kept = rng.random(FRAMES) > 0.02
        given = given._replace(stamps=(given.stamps + late)[kept], points=given.points[kept])
        tracker = track(given, stamps='arrival')
        assert tracker.state.frame_count > 300


@pytest.mark.parametrize('make', [usual, tilted_poses], ids=['markers', 'poses'])
@pytest.mark.parametrize('held_frames', [2, 12, 60])
def test_a_pose_that_is_held_is_not_seen(make: Callable[[], Stream], held_frames: int) -> None:
    stream = make()
    [given] = stream.parts
    part = slice(300, 300 + held_frames)
    given.points[part, :] = given.points[299]
    if given.axes is not None:
        given.axes[part] = given.axes[299]
    tracker = Tracker(settings_from(stream.parameters))
    [estimate] = tracker.add(given, 2)
    assert tracker.update_counts()['poses_held'] == 2 * held_frames
    seen = estimate.missing == ''
    inside = np.isin(estimate.stamp, given.stamps[part])
    assert inside.sum() == held_frames and not seen[inside].any()
    # Its rate is right before and after.
    t = (estimate.stamp - 1_000_000_000) * 1e-9
    truth = np.stack((np.full(len(t), 2 * np.pi), 1.5 * np.cos(3 * t)), axis=1)
    rate = estimate.rate(1)
    off = np.abs(rate.value - truth) / np.sqrt(rate.variance)
    assert np.mean(off[seen] > 4) < 0.005


def test_exact_poses_at_rest_are_seen_whatever_noise_the_parameters_give() -> None:
    [given] = tilted_poses().parts
    t = np.minimum(np.arange(FRAMES), 300) / 100
    place = np.stack((np.cos(t), np.sin(t), 0 * t), axis=-1)
    given.points[:] = place[:, None]
    given.axes[:, :, 0], given.axes[:, :, 1] = (
        place[:, None],
        place[:, None, [1, 0, 2]] * (-1, 1, 1),
    )
    for noise in (0.0, 1e-3):
        tracker = Tracker(settings_from(tilted_poses().parameters | {'noise': noise}))
        tracker.add(given, 1)
        assert not tracker.update_counts()['poses_held'], noise


def test_a_body_at_rest_is_seen_whatever_the_resolution() -> None:
    rng = np.random.default_rng(7)
    for resolution, noise in ((1e-3, 2e-4), (1e-3, 4e-4), (1e-4, 2e-4), (1e-12, 0.0)):
        points = markers(7, 0.0)
        # Moving, then at rest, then moving again.
        points[250:400] = points[250]
        points[400:] = points[250:350]
        points += noise * (rng.normal(size=(*points.shape, 2)) @ (1, 1j))
        points = resolution * (np.round(points / resolution))
        tracker = track(frames(points), 97)
        assert not tracker.update_counts()['poses_held'], (resolution, noise)
