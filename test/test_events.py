"""Events: instants at which the velocity, acceleration or jerk of a body steps."""

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import assert_alike, decoded, figures, write_config
from sensor_msgs.msg import PointCloud2

from bench._events import event_motions, smooth_motions
from kinpole_ros import track
from kinpole_ros.bags import BagWriter, replay
from kinpole_ros.derivatives import Event, Poses, Samples, Windows, derive_poses, find_event
from kinpole_ros.messages import read_event, serialize_message, to_message
from kinpole_ros.planar._plane import Real
from kinpole_ros.settings import Settings
from kinpole_ros.tools.demo import live_run
from kinpole_ros.tracking.events import BodyEvent
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

RATE, WINDOW = 200, 0.3
SHARE = WINDOW / 8
START, STEP = 10**18, 5_000_000
# m, about their mean, and twice their rms radius.
KITE = np.array((0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j))
KITE -= KITE.mean()
SIZE = 2 * float(np.sqrt(np.mean(np.abs(KITE) ** 2)))


def poses_of(name: str, noise: float, seconds: float, seed: int = 0) -> tuple[Real, Real]:
    """Exact angle and both coordinates (N, 3) of a motion, and their noise (N, 3)."""
    count = round(seconds * RATE)
    record = (smooth_motions() | event_motions())[name](np.arange(count) / RATE)
    exact = np.stack((record.angle[0], record.position[0].real, record.position[0].imag), axis=1)
    # Of four markers.
    sigmas = noise * np.array((1.0, SIZE / 2, SIZE / 2))
    return exact, sigmas * np.random.default_rng(seed).normal(size=exact.shape)


def events_in(values: Real, noise: float, seen: np.ndarray | None = None) -> list[Event]:
    """Find events in samples (N, 3) at even times, as the tracker does."""
    time = np.arange(len(values)) / RATE
    variance = np.tile(np.square((noise, noise * SIZE / 2)), (len(values), 1))
    if seen is not None:
        variance[~seen] = np.inf
    found: list[Event] = []
    for begin in np.arange(2.2 * WINDOW, time[-1] - WINDOW - SHARE, SHARE):
        rows = slice(*np.searchsorted(time, (begin - 2 * WINDOW, begin + WINDOW + SHARE)))
        samples = Samples(time[rows], values[rows], variance[rows], begin, begin + SHARE)
        event = find_event(samples, WINDOW)
        if event is not None and not (found and event.time - found[-1].time < SHARE / 2):
            found.append(event)
    return found


def rate_sigma(values: Real, noise: float) -> float:
    """The standard deviation of the angular velocity at the newest sample, without lag."""
    count, one = len(values), np.ones((len(values), 1))
    position = (values[:, 1] + 1j * values[:, 2])[:, None] / (SIZE / 2)
    stamps = STEP * np.arange(count)
    newest = np.arange(round(WINDOW * RATE), count, 20)
    windows = Windows(newest, newest - round(WINDOW * RATE), newest)
    poses = Poses(stamps, values[:, :1], 0 * one, position, one, one)
    none = np.zeros((len(newest), 1), int)
    found = derive_poses(poses, windows, none, np.full((len(newest), 1), noise), WINDOW, 1)
    return float(np.sqrt(np.median(found.angle_covariance[1, 1])))


def found_of_impacts(name: str, noise: float) -> np.ndarray:
    """
    What is found of 25 impacts that step the velocity by 20 of its standard deviations.

    For each that is found (K, 4): errors of its time, samples, and of its size, over the step, and
    their standard deviations. The first row counts impacts, what is found, and what is false.
    """
    exact, errors = poses_of(name, noise, 14.0, seed=1)
    step = 20 * rate_sigma(exact + errors, noise)
    rng = np.random.default_rng(2)
    hits = np.arange(1.0, 13.3, 0.5) + rng.uniform(0, 0.1, 25)
    signs = rng.choice((-1.0, 1.0), len(hits))
    ramp = step * (signs * np.maximum(np.arange(len(exact))[:, None] / RATE - hits, 0)).sum(axis=1)
    # The body turns about a point that is its radius of gyration away.
    events = events_in(exact + errors + ramp[:, None] * (1.0, SIZE / 2, 0.0), noise)
    rows = []
    for event in events:
        k = int(np.abs(event.time - hits).argmin())
        if event.order == 1 and abs(event.time - hits[k]) < 3 / RATE:
            off = RATE * (event.time - hits[k]), event.step[0] / (signs[k] * step) - 1
            rows.append((*off, RATE * event.time_sigma, event.step_sigma[0] / step))
    return np.array([(len(hits), len(rows), len(events) - len(rows), 0.0), *rows])


def test_impacts_of_20_standard_deviations_are_found_within_a_sample() -> None:
    names = 'four-bar coupler', 'stop and go', 'dead point', 'rod at 4 rev/s', 'random'
    each = [found_of_impacts(name, noise) for name in names for noise in (1e-4, 1e-3)]
    impacts, found, false, _ = np.sum([one[0] for one in each], axis=0)
    assert found >= 0.95 * impacts and false <= 0.01 * impacts
    time, size, time_sigma, size_sigma = np.concatenate([one[1:] for one in each]).T
    assert np.mean(np.abs(time) < 1) >= 0.95
    assert np.mean(np.abs(time) < 3 * time_sigma + 0.02) > 0.9
    assert np.mean(np.abs(size) < np.maximum(3 * size_sigma, 0.05)) > 0.85


def test_there_is_less_than_one_false_event_in_1000_s_of_smooth_motion() -> None:
    false = {}
    for number, name in enumerate(smooth_motions()):
        for noise in (1e-4, 1e-3):
            exact, errors = poses_of(name, noise, 35.0, seed=number)
            false[name, noise] = len(events_in(exact + errors, noise))
    assert sum(false.values()) <= 1, false


def test_accelerations_that_step_are_found_with_their_order() -> None:
    exact, errors = poses_of('reversing drive', 3e-4, 10.0)
    found = events_in(exact + errors, 3e-4)
    expected = np.arange(0.31, 9.65, 0.31)[2:]
    off = np.abs(np.array([event.time for event in found])[:, None] - expected)
    assert (off.min(axis=0) < 1 / RATE).mean() > 0.9 and (off.min(axis=1) < 1 / RATE).all()
    assert {event.order for event in found} == {2}
    # What is pushed by 25, -25, -10 and 10 rad/s^2 in turn.
    due = np.array([(-50.0, 15.0, 20.0, 15.0)[k % 4] for k in range(2, 2 + len(expected))])
    for k, event in zip(off.argmin(axis=1), found, strict=True):
        assert abs(event.step[0] - due[k]) < max(4 * event.step_sigma[0], 0.1 * abs(due[k]))


def test_what_jumps_or_is_off_for_a_sample_is_no_event() -> None:
    exact, errors = poses_of('two sines', 1e-3, 20.0)
    values = exact + errors
    values[300::400] += (0.05, 0.0, 0.0)
    values[1000:] += (0.02, 0.003, 0.0)
    values[2000:2003] -= (0.0, 0.01, 0.0)
    assert not events_in(values, 1e-3)


def test_samples_that_are_missing_make_no_events_and_hide_none() -> None:
    exact, errors = poses_of('impact on a slider', 1e-4, 10.0)
    seen = np.random.default_rng(3).random(len(exact)) > 0.1
    seen[1300:1330] = False
    found = events_in(np.where(seen[:, None], exact + errors, np.nan), 1e-4, seen)
    hits = 0.83 * np.arange(1, 12)
    off = np.abs(np.array([event.time for event in found])[:, None] - hits)
    assert (off.min(axis=0) < 1 / RATE).sum() >= 9
    assert (off.min(axis=1) < 0.02).all()


@pytest.mark.parametrize('scale', [1e-300, 1.0, 1e160, 1e300])
@pytest.mark.parametrize('variance', [1e-300, 1.0, 1e250])
def test_samples_of_any_size_make_finite_events_or_none(scale: float, variance: float) -> None:
    time, rng = np.arange(200) / RATE, np.random.default_rng(0)
    values = scale * (rng.normal(size=(200, 3)) + 50 * np.maximum(time - 0.47, 0)[:, None])
    with np.errstate(all='ignore'):
        event = find_event(Samples(time, values, np.full((200, 2), variance), 0.45, 0.49), WINDOW)
    if event is not None:
        assert np.isfinite((event.time, event.time_sigma, *event.step, *event.step_sigma)).all()


# From markers to results


def markers_of(name: str, seconds: float) -> MarkerFrames:
    """Frames of four markers of a body."""
    count, rng = round(seconds * RATE), np.random.default_rng(4)
    record = event_motions()[name](np.arange(count) / RATE)
    flat = record.position[0][:, None] + KITE * np.exp(1j * record.angle[0])[:, None]
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points[..., :2] += 1e-4 * rng.normal(size=flat.shape + (2,))
    return MarkerFrames(START + STEP * np.arange(count), 'world', ('0', '1', '2', '3'), points)


@pytest.fixture(scope='module')
def bounces() -> MarkerFrames:
    return markers_of('bounce', 3.0)


BOUNCES = np.cumsum(2 * np.tile((1.5, 1.1, 0.8, 1.7, 1.25), 3) / 9.81)
SETTINGS = Settings(bodies={'ball': ('0', '1', '2', '3')}, window=0.3, lag=0.1)


def found_by(frames: MarkerFrames, sizes: Sequence[int]) -> list[tuple[int, BodyEvent]]:
    """Events with the stamps of their instants, of a tracker that takes so many frames at once."""
    tracker, found, first, k = Tracker(SETTINGS), [], 0, 0
    while first < len(frames.stamps):
        size = sizes[k % len(sizes)]
        part = part_of(frames, slice(first, first + size))
        for estimate in tracker.add(part, 1, True):
            for instant, event in zip(estimate.instants_of_events(), estimate.events, strict=True):
                found.append((int(estimate.stamp[instant]), event))
        tracker.learn_if_due()
        first, k = first + size, k + 1
    return found


def test_one_by_one_gives_what_many_frames_give(bounces: MarkerFrames) -> None:
    expected = found_by(bounces, [10**6])
    assert len(expected) > 5
    for sizes in ([1], [7, 300, 1]):
        found = found_by(bounces, sizes)
        assert [stamp for stamp, _ in found] == [stamp for stamp, _ in expected]
        for (_, one), (_, other) in zip(found, expected, strict=True):
            assert (one.stamp, one.order) == (other.stamp, other.order)
            assert one.step == other.step and one.time_sigma == other.time_sigma


def test_no_events_are_searched_for_unless_they_are_asked_for(
    bounces: MarkerFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError('searched')

    monkeypatch.setattr('kinpole_ros.tracking.events.find_event', refuse)
    assert not any(one.events for one in Tracker(SETTINGS).add(bounces, 1))


def test_track_returns_the_events_of_each_body(bounces: MarkerFrames) -> None:
    found = track(bounces.points, bounces.stamps, {'ball': [0, 1, 2, 3]}, window=0.3, lag=0.1)
    events = found.events['ball']
    times = events.t - START * 1e-9
    due = BOUNCES[(BOUNCES > 1.0) & (BOUNCES < 2.6)]
    assert np.abs(times[:, None] - due).min(axis=0).max() < 1 / RATE
    assert (np.abs(times[:, None] - BOUNCES).min(axis=1) < 1 / RATE).all()
    assert (events.order == 1).all() and (events.step[:, 1] > 1.5).all()
    assert events.step.shape == (len(events), 2)
    assert events.step_covariance.shape == (len(events), 2, 2)


def spoiled(frames: MarkerFrames, how: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and points as rigs have them."""
    rng, points, count = np.random.default_rng(9), frames.points.copy(), len(frames.stamps)
    stamps, seen = frames.stamps, np.ones(count, bool)
    if how == 'late stamps':
        late = np.rint(rng.exponential(1e6, count)).astype(np.int64)
        stamps = np.maximum.accumulate(stamps + late)
    elif how == 'hidden markers':
        points[rng.random(points.shape[:2]) < 0.1] = np.nan
    elif how == 'spikes':
        points[rng.random(points.shape[:2]) < 0.01] += 0.05
    elif how == 'exchanged markers':
        points[count // 2 :, [0, 1]] = points[count // 2 :, [1, 0]]
    elif how == 'correlated noise':
        noise = 1e-4 * rng.normal(size=(count, 4, 2))
        for k in range(1, count):
            noise[k] = 0.8 * noise[k - 1] + 0.6 * noise[k]
        points[..., :2] += noise
    elif how == 'tilted plane':
        points[..., 0], points[..., 2] = 0.996 * points[..., 0], 0.087 * points[..., 0]
    else:
        seen = rng.random(count) > 0.1
    return stamps[seen], points[seen]


@pytest.mark.parametrize(
    'how',
    [
        *('late stamps', 'hidden markers', 'spikes', 'exchanged markers', 'correlated noise'),
        *('tilted plane', 'lost frames'),
    ],
)
def test_impacts_are_found_in_what_rigs_send(how: str) -> None:
    stamps, points = spoiled(markers_of('impact on a slider', 9.5), how)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # of the troubles, which other tests hold
        found = track(points, stamps, {'slider': [0, 1, 2, 3]}, window=0.3, lag=0.1)
    times = found.events['slider'].t - START * 1e-9
    times = times[times > 2]
    off = np.abs(times[:, None] - 0.83 * np.arange(3, 12))
    # The last ones have no window after them.
    assert (off.min(axis=0)[:7] < 1 / RATE).sum() >= 6
    assert (off.min(axis=1) < 2 / RATE).all()


@pytest.fixture(scope='module')
def bag(bounces: MarkerFrames, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('events') / 'bounces.mcap'
    with BagWriter(path) as writer:
        for stamp, points in zip(bounces.stamps.tolist(), bounces.points, strict=True):
            message = to_message('point_cloud2', stamp, 'world', '0123', points)
            writer.write_raw('/markers', PointCloud2, serialize_message(message), stamp)
    return path


def test_live_events_are_those_of_replay(bag: Path, tmp_path: Path) -> None:
    config = write_config(tmp_path / 'config.yaml', SETTINGS)
    topic = '/kinpole/ball/event'
    assert live_run(bag, config, tmp_path / 'live.mcap').frames == 600
    replay(bag, SETTINGS, tmp_path / 'replay.mcap', tmp_path / 'table.csv')
    live = figures(decoded(tmp_path / 'live.mcap', topic))
    expected = figures(decoded(tmp_path / 'replay.mcap', topic))
    assert len(expected[topic]) > 5
    assert_alike(live, expected)
    with open(tmp_path / 'table.csv', newline='') as file:
        rows = [row for row in csv.DictReader(file) if row['ball_event_t']]
    times = np.array([float(row['ball_event_t']) for row in rows])
    assert np.abs(times - 1e-9 * np.array(list(expected[topic]))).max() < 1e-6
    assert all(float(row['t']) > float(row['ball_event_t']) for row in rows)
    assert {row['ball_event_order'] for row in rows} == {'1.0'}


def test_a_message_has_the_fields_that_the_docs_name(bag: Path, tmp_path: Path) -> None:
    from kinpole_ros.bags import read_messages

    replay(bag, SETTINGS, tmp_path / 'replay.mcap')
    messages = list(read_messages(tmp_path / 'replay.mcap', ['/kinpole/ball/event']))
    for message in messages:
        stamp, numbers = read_event(message.data)
        cloud = decoded(tmp_path / 'replay.mcap', message.topic)[message.topic][0]
        assert [field.name for field in cloud.fields] == list(numbers)
        assert message.log_time > stamp
        assert numbers['order'] == 1 and 0 < numbers['time_deviation'] < 1e-3
        # Where the ball hits the ground, and what it gets from it.
        assert abs(numbers['y']) < 0.01 and numbers['step_y'] > 1.5
        assert abs(numbers['step_x']) < 5 * np.sqrt(numbers['step_xx']) + 0.01
    with pytest.raises(ValueError, match='fields'):
        read_event(next(iter(read_messages(bag, ['/markers']))).data)
