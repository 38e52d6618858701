"""Frames in which a body as a whole is wrong: left out, and nothing else is."""

import numpy as np
import pytest
from recordings import KITE

from kinpole_ros.messages import DiagnosticsMaker
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

START, STEP, RATE = 10**18, 5_000_000, 200
NAMES = tuple('abcd')


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, angle and rate of a body that swings while it goes round."""
    phase = 2 * np.pi * 1.1 * t
    angle = 1.4 * np.sin(phase) + 2 * np.pi * 0.8 * t
    rate = 1.4 * 2 * np.pi * 1.1 * np.cos(phase) + 2 * np.pi * 0.8
    return 0.2 * np.exp(2j * np.pi * 0.6 * t), angle, rate


def frames_of(position: np.ndarray, angle: np.ndarray, noise: float = 2e-4) -> MarkerFrames:
    rng = np.random.default_rng(3)
    flat = position[:, None] + np.exp(1j * angle)[:, None] * KITE
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += noise * rng.normal(size=points.shape)
    stamps = START + STEP * np.arange(len(points))
    return MarkerFrames(stamps, 'world', NAMES, points)


def spoilt(frames: MarkerFrames, at: list[int], turn: float, shift: float) -> MarkerFrames:
    points = frames.points.copy()
    for k in at:
        flat = points[k, :, 0] + 1j * points[k, :, 1]
        flat = flat.mean() + (flat - flat.mean()) * np.exp(1j * turn) + shift
        points[k, :, 0], points[k, :, 1] = flat.real, flat.imag
    return frames._replace(points=points)


def tracker_of(lag: float = 0.1) -> Tracker:
    return Tracker(settings_from({'lag': lag, 'bodies': ['kite'], 'kite.markers': list(NAMES)}))


def off_by(tracker: Tracker, frames: MarkerFrames, live: bool = False) -> np.ndarray:
    """Rows of stamp and error of the rate in deviations, of what is determined."""
    parts = [part_of(frames, slice(k, k + 1)) for k in range(len(frames.stamps))]
    rows = []
    for part in parts if live else [frames]:
        for estimate in tracker.add(part, 1):
            t = (estimate.stamp - START) * 1e-9
            value, variance, determined = (field[:, 0] for field in estimate.rate(1))
            off = (value - motion(t)[2]) / np.sqrt(variance)
            rows.append(np.stack((estimate.stamp - START, off))[:, determined])
    return np.concatenate(rows, axis=1)


T = np.arange(360) / RATE


@pytest.mark.parametrize('lag', [0.0, 0.1])
@pytest.mark.parametrize(('turn', 'shift'), [(0.3, 0), (-2.0, 0), (3.1, 0), (0, 0.02)])
def test_a_frame_in_which_a_body_is_wrong_is_left_out(
    lag: float, turn: float, shift: float
) -> None:
    frames = frames_of(*motion(T)[:2])
    for k in (180, 301):
        tracker = tracker_of(lag)
        found = off_by(tracker, spoilt(frames, [k], turn, shift))
        assert np.abs(found[1, found[0] > 0.5e9]).max() < 6
        assert tracker.wrong() == 1


@pytest.mark.parametrize('lag', [0.0, 0.1])
def test_the_reason_of_a_frame_left_out_is_its_pose(lag: float) -> None:
    frames = spoilt(frames_of(*motion(T)[:2]), [300], 2.0, 0.03)
    (estimate,) = tracker_of(lag).add(frames, 1)
    (reason,) = estimate.missing[estimate.stamp == frames.stamps[300], 0]
    assert reason == 'its pose is far off its path, and may be wrong'


def test_two_and_three_wrong_frames_running_are_left_out_live_as_in_a_block() -> None:
    frames = spoilt(frames_of(*motion(T)[:2]), [150, 200, 201, 300, 301, 302], 2.0, 0.03)
    found = []
    for live in (False, True):
        tracker = tracker_of(0.02)
        found.append(off_by(tracker, frames, live))
        assert tracker.wrong() == 6
    np.testing.assert_allclose(*found, rtol=1e-6, atol=1e-6)
    assert np.abs(found[0][1, found[0][0] > 0.5e9]).max() < 6


@pytest.mark.parametrize('seed', range(4))
def test_good_frames_are_left_as_they_are(seed: int) -> None:
    """Of fast and slow motions, and of one that begins and ends at once."""
    position, angle, _ = motion(T)
    run = np.clip(T - 0.6, 0.0, 0.5)
    ways = [(position, angle), (0.1 * position, 62.8 * T), (0 * position, 6 * run), (run, 0 * T)]
    tracker = tracker_of()
    tracker.add(frames_of(*ways[seed]), 1)
    assert tracker.wrong() == 0


def test_a_body_that_jumps_for_good_has_moved() -> None:
    position, angle, _ = motion(T)
    later = T > 1.2
    tracker = tracker_of()
    found = off_by(tracker, frames_of(position + 0.1 * later, angle + 0.8 * later))
    assert tracker.wrong() == 0
    assert np.abs(found[1, found[0] > 1.6e9]).max() < 6


def test_the_body_and_its_frames_are_named() -> None:
    tracker, maker = tracker_of(), DiagnosticsMaker('kinpole', topic='/markers')
    frames = spoilt(frames_of(*motion(T)[:2]), [200, 250], 1.0, 0.0)
    (estimate,) = tracker.add(frames, 1)
    status = maker.make(START, tracker, estimate, 1.0, {}).status[1]
    assert status.level == DiagnosticStatus.WARN
    assert 'left out of 2 frames in which its pose was far off and then back' in status.message
    assert status.hardware_id == '/markers'
    after = maker.make(START, tracker, estimate, 1.0, {}).status[1]
    assert 'left out' not in after.message


def test_a_body_that_was_not_seen_for_a_window_is_warned_of_when_it_is_back() -> None:
    tracker, maker = tracker_of(), DiagnosticsMaker('kinpole')
    frames = frames_of(*motion(T)[:2])
    frames.points[150:230] = np.nan
    (estimate,) = tracker.add(frames, 1)
    status = maker.make(START, tracker, estimate, 1.0, {}).status
    assert [each.level for each in status] == [DiagnosticStatus.OK, DiagnosticStatus.WARN]
    assert 'it was not seen for 0.405 s from 1000000000.745 s on' in status[1].message
    assert 'not seen' not in maker.make(START, tracker, estimate, 1.0, {}).status[1].message


def test_an_outage_of_all_frames_is_warned_of_when_they_are_back() -> None:
    tracker, maker = tracker_of(), DiagnosticsMaker('kinpole')
    frames = frames_of(*motion(T)[:2])
    late = frames.stamps + np.where(T > 1.0, 700_000_000, 0)
    tracker.add(frames._replace(stamps=late), 1)
    status = maker.make(START, tracker, None, 1.0, {}).status
    assert status[0].level == DiagnosticStatus.WARN
    assert 'no frames came for 0.705 s from 1000000001.000 s on' in status[0].message
    # Nobody asked for figures, and nothing is wrong with the body.
    assert status[1].level == DiagnosticStatus.OK
    assert 'nobody subscribes' in status[1].message


def test_deviations_hold_where_nine_tenths_of_the_markers_are_hidden() -> None:
    position, angle, _ = motion(np.arange(700) / RATE)
    rng = np.random.default_rng(0)
    shape = 0.1 * (rng.normal(size=8) + 1j * rng.normal(size=8))
    flat = position[:, None] + np.exp(1j * angle)[:, None] * shape
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += 2e-4 * rng.normal(size=points.shape)
    points[rng.random(flat.shape) < 0.9] = np.nan
    stamps = START + STEP * np.arange(len(points))
    tracker = Tracker(settings_from({'bodies': ['all']}))
    found = off_by(tracker, MarkerFrames(stamps, 'world', tuple('abcdefgh'), points))
    assert np.abs(found[1]).max(initial=0.0) < 10
