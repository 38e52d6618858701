"""Replay: whatever form the markers come in, the figures are the same, finite and right."""

import csv
import math
from collections.abc import Callable, Iterable
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import assert_alike, bodies_of, decoded, figures, numbers, stamp_of
from mcap.writer import Writer
from sensor_msgs.msg import PointField
from visualization_msgs.msg import MarkerArray

from kinpole_ros.bags import (
    BagError,
    BagWriter,
    _replayed,
    definition,
    read_messages,
    replay,
    type_name,
)
from kinpole_ros.bags import topics as topics_of
from kinpole_ros.messages import (
    INPUT_TYPES,
    MARKER_TYPES,
    TF,
    marker_arrays,
    read_markers,
    result_outputs,
    serialize_message,
    to_message,
)
from kinpole_ros.settings import Settings, settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.plane import AXES
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES

Bag = Callable[..., Path]
Figures = dict[str, dict[int, np.ndarray]]
NOISY = {'rate': 100.0, 'duration': 1.2, 'noise': 2e-4, 'dropout': 0.1, 'jitter': 1e-3}
FOUR_BAR = Settings(bodies=bodies_of('four_bar'), topics='all')
CARDAN = Settings(bodies=bodies_of('cardan'), topics='all')
ONE_BODY = Settings(topics='all')
TURN = 2 * math.pi
CENTRODES = (
    'icr',
    'icr_velocity',
    'angular_velocity',
    'centrode_curvature',
    'centrode/fixed',
    'centrode/moving',
)


@pytest.fixture(scope='session')
def noisy(simulated: Bag, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """The results of a four-bar as bad as they come, by topic."""
    output = tmp_path_factory.mktemp('noisy') / 'out.mcap'
    replay(simulated('four_bar', **NOISY), FOUR_BAR, output)
    return decoded(output)


@pytest.fixture(scope='session')
def noisy_figures(noisy: dict[str, list[Any]]) -> Figures:
    return figures(noisy)


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Figures]:
    """Replay a bag and return the figures of its results, all or only some topics."""

    def run_(bag: Path, settings: Settings, *only: str) -> Figures:
        output = tmp_path / 'result.mcap'
        replay(bag, settings, output)
        return figures(decoded(output, *(f'/kinpole/{topic}' for topic in only)))

    return run_


def frames(bag: Path) -> list[tuple[int, tuple[str, ...], np.ndarray]]:
    """Stamp, names and points (n, 3) of every frame of a simulated bag."""
    read = [read_markers(message) for message in decoded(bag, '/markers')['/markers']]
    return [
        (int(f.stamps[0]), tuple(n.partition('/')[0] for n in f.identities), f.points[0])
        for f in read
    ]


def write(path: Path, messages: list[Any], topic: str = '/markers') -> Path:
    with BagWriter(path) as writer:
        for message in messages:
            writer.write(topic, message, stamp_of(message))
    return path


def vectors(found: Figures, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s from the first frame (stamp 1 s), and the vectors (N, 3), of one topic."""
    values = found[topic]
    # The last three numbers of the message: the header holds none.
    return np.array(list(values)) * 1e-9 - 1, np.array([v[-3:] for v in values.values()])


# The same again


def test_twice_is_the_same_to_the_last_bit(
    simulated: Bag, noisy: dict[str, list[Any]], tmp_path: Path
) -> None:
    again = tmp_path / 'again.mcap'
    replay(simulated('four_bar', **NOISY), FOUR_BAR, again)
    assert decoded(again) == noisy
    replay(simulated('four_bar', **NOISY), FOUR_BAR, tmp_path / 'more.mcap')
    bags = (again, tmp_path / 'more.mcap')
    assert bags[0].read_bytes() == bags[1].read_bytes()


def test_a_rosbag2_folder_is_as_good_as_its_files_in_one(
    simulated: Bag, noisy: dict[str, list[Any]], tmp_path: Path
) -> None:
    messages = list(read_messages(simulated('four_bar', **NOISY)))
    folder = tmp_path / 'bag'
    names = ['bag_0.mcap', 'bag_1.mcap']
    for name, part in zip(names, (messages[:2000], messages[2000:]), strict=True):
        with BagWriter(folder / name) as writer:
            for m in part:
                writer.write_raw(m.topic, m.type_name, m.data, m.log_time)
    about = {'storage_identifier': 'mcap', 'relative_file_paths': names, 'compression_format': ''}
    text = yaml.safe_dump({'rosbag2_bagfile_information': about})
    (folder / 'metadata.yaml').write_text(text)
    replay(folder, FOUR_BAR, tmp_path / 'out.mcap')
    assert decoded(tmp_path / 'out.mcap') == noisy


def test_the_figures_do_not_depend_on_how_a_bag_is_stored(simulated: Bag, tmp_path: Path) -> None:
    messages = list(read_messages(simulated('four_bar', rate=200, noise=2e-4), ['/markers']))
    for name, every in (('stored', 10**6), ('anew', 37)):
        with BagWriter(tmp_path / f'{name}.mcap') as writer:
            for number, m in enumerate(messages, start=1):
                writer.write_raw(m.topic, m.type_name, m.data, m.log_time)
                if number % every == 0:
                    writer.flush()
        replay(tmp_path / f'{name}.mcap', FOUR_BAR, csv=tmp_path / f'{name}.csv')
    assert (tmp_path / 'stored.csv').read_bytes() == (tmp_path / 'anew.csv').read_bytes()


# Four types of messages, and what drivers do to them


def lose_marker(points: np.ndarray, frame: int) -> list[int]:
    """The markers of a wheel that are not seen in a frame."""
    return [3] * (20 <= frame < 30 or frame % 7 == 5) + [1] * (40 <= frame < 45)


def spoil(kind: str, damage: str, stamp: int, names: tuple[str, ...], points: np.ndarray) -> Any:
    """A message of a frame in which rows of `points` are NaN, damaged in one of several ways."""
    lost = np.flatnonzero(np.isnan(points[:, 0]))
    if damage == 'left out' and kind != 'marker_array':
        # Here the place is the identity, so only the last can be left out.
        last = bool(lost.size) and lost[-1] == len(points) - 1
        kept = slice(len(points) - 1 if last else None)
        return to_message(kind, stamp, 'world', names[kept], points[kept])
    if damage == 'left out':
        return to_message(kind, stamp, 'world', names, points)
    points = points.copy()
    number = {'nan': np.nan, 'inf': np.inf, '-inf': -np.inf}.get(damage.split(' ')[0], np.nan)
    points[lost] = 0.123
    message = to_message(kind, stamp, 'world', names, points)
    if kind == 'point_cloud2':
        axis = slice(None) if 'all' in damage else 0
        points[lost, axis] = number
        message.data = np.frombuffer(np.asarray(points, '<f8').tobytes(), np.uint8)
        message.is_dense = 'dense' in damage
        return message
    placed = {
        'marker_array': lambda: [marker.pose.position for marker in message.markers],
        'marker': lambda: message.points,
        'pose_array': lambda: [pose.position for pose in message.poses],
    }[kind]()
    for k in lost:
        placed[k].x = number
        if 'all' in damage:
            placed[k].y = placed[k].z = number
    return message


@pytest.fixture(scope='session')
def wheel_frames(simulated: Bag) -> list[tuple[int, tuple[str, ...], np.ndarray]]:
    listed = frames(simulated('rolling_wheel', rate=100, duration=0.6, noise=1e-4))
    for k, (_, _, points) in enumerate(listed):
        points[lose_marker(points, k)] = np.nan
    return listed


@pytest.fixture(scope='session')
def remaining(
    wheel_frames: list[tuple[int, tuple[str, ...], np.ndarray]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Figures:
    """The figures of a clean input that only ever holds the markers that are seen."""
    folder = tmp_path_factory.mktemp('remaining')
    listed = [to_message('marker_array', t, 'world', n, p) for t, n, p in wheel_frames]
    assert {len(message.markers) for message in listed} == {2, 3, 4}
    replay(write(folder / 'in.mcap', listed), Settings(), folder / 'out.mcap')
    return figures(decoded(folder / 'out.mcap'))


@pytest.mark.parametrize(
    'kind, damage',
    [(k, d) for k in MARKER_TYPES for d in ('left out', 'nan', 'nan all', 'inf', '-inf all')]
    + [('point_cloud2', 'nan dense'), ('point_cloud2', 'inf all dense')],
)
def test_a_marker_not_seen_is_one_answer_in_every_type_and_way_of_saying_so(
    wheel_frames: Any, remaining: Figures, run: Any, tmp_path: Path, kind: str, damage: str
) -> None:
    listed = []
    for stamp, names, points in wheel_frames:
        way = damage
        if damage == 'left out' and kind != 'marker_array' and np.isnan(points[1, 0]):
            way = 'nan'
        listed.append(spoil(kind, way, stamp, names, points))
    found = run(write(tmp_path / 'in.mcap', listed), Settings())
    assert_alike(found, remaining)


@pytest.mark.parametrize('kind', MARKER_TYPES)
def test_markers_of_any_type_are_found_by_name(simulated: Bag, run: Any, kind: str) -> None:
    options = {'rate': 100, 'duration': 0.3, 'noise': 1e-4}
    bag = simulated('four_bar', message=kind, **options)
    names = [name for listed in FOUR_BAR.bodies.values() for name in listed]
    bodies = FOUR_BAR.bodies
    if kind != 'marker_array':
        bodies = {
            body: tuple(str(names.index(name)) for name in listed)
            for body, listed in bodies.items()
        }
    expected = run(simulated('four_bar', **options), FOUR_BAR)
    assert_alike(run(bag, replace(FOUR_BAR, bodies=bodies)), expected)


def test_coarse_clouds_give_answers_as_coarse_as_they_are(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    exact = simulated('rolling_wheel', rate=100, duration=1.0)
    listed = []
    for stamp, _, points in frames(exact):
        cloud = to_message('point_cloud2', stamp, 'world', ['a'] * len(points), points)
        cloud.point_step = 16
        cloud.row_step = 16 * len(points)
        for axis, field in enumerate(cloud.fields):
            field.datatype, field.offset = PointField.FLOAT32, 4 * axis
        padded = np.zeros((len(points), 4), '<f4')
        padded[:, :3] = points
        cloud.data = padded.view(np.uint8).ravel()
        listed.append(cloud)
    topics = ('body/angular_velocity', 'body/icr', 'body/iap')
    found = run(write(tmp_path / 'coarse.mcap', listed), ONE_BODY, *topics)
    expected = run(exact, ONE_BODY, *topics)
    # Coordinates up to 0.7 m in float32 are off by up to 3e-8 m.
    for topic, tolerance in (('angular_velocity', 1e-5), ('icr', 1e-6), ('iap', 1e-5)):
        times, values = vectors(found, f'/kinpole/body/{topic}')
        _, right = vectors(expected, f'/kinpole/body/{topic}')
        assert len(values) == len(right)
        # Not the same to the last bit, though, or the cloud was not coarse.
        assert 0 < np.abs(values - right).max() < tolerance, topic
        assert len(times) == 90


# Right, against closed forms, through the whole pipeline


def test_a_wheel_rolls_its_rim_on_a_line(simulated: Bag, run: Any) -> None:
    radius = 0.1
    bag = simulated('rolling_wheel', duration=1.5)
    found = run(bag, ONE_BODY, *(f'body/{name}' for name in CENTRODES))
    times, icr = vectors(found, '/kinpole/body/icr')
    assert len(times) == 280
    hub = TURN * radius * times
    np.testing.assert_allclose(icr, np.stack((hub, 0 * hub, 0 * hub), axis=-1), atol=1e-6 * radius)
    _, velocity = vectors(found, '/kinpole/body/icr_velocity')
    np.testing.assert_allclose(velocity, [[TURN * radius, 0, 0]] * len(velocity), atol=1e-6)
    _, omega = vectors(found, '/kinpole/body/angular_velocity')
    np.testing.assert_allclose(omega, [[0, 0, -TURN]] * len(omega), atol=1e-9)
    _, curvature = vectors(found, '/kinpole/body/centrode_curvature')
    assert np.abs(curvature).max() < 1e-3 / radius

    fixed, moving = loci(decoded_paths(found), 'body')
    np.testing.assert_allclose(fixed[:, 1], 0, atol=1e-6 * radius)
    assert np.ptp(fixed[:, 0]) == pytest.approx(TURN * radius * 1.3, rel=1e-6)
    # The body's frame starts at the mean of the markers, along the axes of the ground.
    hub_on_body = np.array([0, radius, 0]) - frames(bag)[0][2].mean(axis=0)
    distance = np.linalg.norm((moving - hub_on_body)[:, :2], axis=1)
    np.testing.assert_allclose(distance, radius, rtol=1e-6)


def decoded_paths(found: Figures) -> dict[str, np.ndarray]:
    """The last path on every topic of loci, positions (N, 3)."""
    return {
        topic: list(values.values())[-1].reshape(-1, 7)[:, :3]
        for topic, values in found.items()
        if '/centrode/' in topic
    }


def loci(paths: dict[str, np.ndarray], body: str) -> tuple[np.ndarray, np.ndarray]:
    return (
        paths[f'/kinpole/{body}/centrode/fixed'],
        paths[f'/kinpole/{body}/centrode/moving'],
    )


@pytest.mark.parametrize('turns', [1.0, -1.0])
def test_a_rod_on_two_guides_has_cardans_circles_for_centrodes(
    simulated: Bag, run: Any, tmp_path: Path, turns: float
) -> None:
    length = 0.3
    scene = tmp_path / 'rod.yaml'
    scene.write_text(
        f'bodies: {{ground: {{O: [0, 0]}}, rod: {{A: [{-length / 2}, 0], B: [{length / 2}, 0]}}}}\n'
        'joints: [{slot: rod.A, on: ground.O, along: 90 deg},'
        ' {slot: rod.B, on: ground.O, along: 0 deg}]\n'
        f'drivers: [{{drive: rod, rate: {turns} rev/s}}]\n'
        'markers: {rod: {a: [-0.14, 0.0], b: [-0.03, 0.02], c: [0.13, 0.01]}}\n'
    )
    bag = simulated(scene, duration=1.5)
    settings = Settings(bodies={'rod': ('a', 'b', 'c')}, topics='all')
    found = run(bag, settings, *(f'rod/{name}' for name in CENTRODES))
    times, icr = vectors(found, '/kinpole/rod/icr')
    assert len(times) == 280
    angle = -turns * TURN * times
    right = np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=-1)
    np.testing.assert_allclose(icr, length * right, atol=1e-5 * length)
    # The ICR runs against the rod's turning, once around for each turn.
    _, curvature = vectors(found, '/kinpole/rod/centrode_curvature')
    np.testing.assert_allclose(curvature[:, 2], -turns / length, rtol=1e-3)

    fixed, moving = loci(decoded_paths(found), 'rod')
    np.testing.assert_allclose(np.linalg.norm(fixed[:, :2], axis=1), length, rtol=1e-5)
    middle = np.array([length / 2, 0, 0]) - frames(bag)[0][2].mean(axis=0)
    distance = np.linalg.norm((moving - middle)[:, :2], axis=1)
    np.testing.assert_allclose(distance, length / 2, rtol=1e-5)


def test_a_four_bar_is_as_its_bag_says_it_is(simulated: Bag, run: Any) -> None:
    bag = simulated('four_bar', duration=1.15)
    topics = [f'{body}/{name}' for body in FOUR_BAR.bodies for name in (*CENTRODES, *POLE_NAMES)]
    topics += ['coupler/wrt/crank/icr', 'rocker/wrt/crank/icr', 'rocker/wrt/coupler/icr']
    found = run(bag, FOUR_BAR, *topics)
    truth = {
        topic.replace('/truth/', '/'): {stamp_of(m): np.array(list(numbers(m))) for m in listed}
        for topic, listed in decoded(bag, *(f'/kinpole/truth/{t}' for t in topics)).items()
    }
    first = frames(bag)[0][2]
    ends = np.cumsum([0, *(len(names) for names in FOUR_BAR.bodies.values())])
    for body, start, end in zip(FOUR_BAR.bodies, ends, ends[1:], strict=False):
        offsets = first[start:end] - first[start:end].mean(axis=0)
        size = 2 * math.sqrt((offsets**2).sum(axis=1).mean())
        pairs = [f'{body}/wrt/crank/icr'] if body != 'crank' else []
        for pole in (*(f'{body}/{name}' for name in POLE_NAMES), *pairs):
            errors = compared(found, truth, f'/kinpole/{pole}')
            # The window is full, on both sides of the instant, from 0.2 s on.
            limit = np.where(errors[0] < 0.2, 1e-4 if pole.endswith('isp') else 1e-5, 1e-5)
            assert (errors[1] < limit * size).all(), pole
        _, error, right = compared(found, truth, f'/kinpole/{body}/angular_velocity')
        assert error.max() < 1e-6
        assert np.abs(right).max() > 1
        if body != 'coupler':
            assert f'/kinpole/{body}/centrode_curvature' not in found, 'it is pinned'
            continue
        _, error, right = compared(found, truth, f'/kinpole/{body}/centrode_curvature')
        assert (error < 1e-3 * np.abs(right[:, 2])).all()


def compared(found: Figures, truth: Figures, topic: str) -> tuple[np.ndarray, ...]:
    """Times (N,), distances (N,) of the vectors from the true ones, and these (N, 3)."""
    right = truth[topic]
    last = max(max(values) for values in found.values())
    due = [stamp for stamp in right if stamp <= last]
    here = [stamp for stamp in due if stamp in found[topic]]
    assert len(here) > 0.98 * len(due), topic
    assert set(found[topic]) <= set(right), topic
    values = np.array([found[topic][s][-3:] for s in here])
    expected = np.array([right[s][-3:] for s in here])
    times = np.array(here) * 1e-9 - 1
    return times, np.linalg.norm(values - expected, axis=1), expected


@pytest.mark.parametrize('plane', ['yz', 'zx'])
def test_other_planes_are_the_same_but_for_the_axes(
    simulated: Bag, run: Any, tmp_path: Path, plane: str
) -> None:
    bag = simulated('cardan', rate=100, duration=0.6, noise=1e-4)
    listed = []
    for stamp, names, points in frames(bag):
        turned = np.empty_like(points)
        turned[:, AXES[plane]] = points + [0, 0, 0.5]
        listed.append(to_message('marker_array', stamp, 'world', names, turned))
    topics = ('icr', 'iap', 'icr_velocity', 'angular_velocity', 'centrode_curvature')
    only = [f'rod/{topic}' for topic in topics]
    found = run(write(tmp_path / 'in.mcap', listed), replace(CARDAN, plane=plane), *only)
    expected = run(bag, CARDAN, *only)
    for topic in topics:
        times, values = vectors(found, f'/kinpole/rod/{topic}')
        times_xy, right = vectors(expected, f'/kinpole/rod/{topic}')
        height = [0, 0, 0.5] if topic in ('icr', 'iap') else [0, 0, 0]
        assert list(times) == list(times_xy)
        np.testing.assert_allclose(values[:, AXES[plane]], right + height, rtol=1e-9, atol=1e-12)


# Every table and topic


def test_the_table_holds_the_figures_of_the_bag(simulated: Bag, tmp_path: Path) -> None:
    bag = simulated('four_bar', **NOISY)
    replay(bag, FOUR_BAR, tmp_path / 'out.mcap', tmp_path / 'out.csv')
    found = figures(decoded(tmp_path / 'out.mcap'))
    with open(tmp_path / 'out.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    stamps = [round(float(row['t']) * 1e9) for row in rows]
    assert len(set(stamps)) == len(rows) == 110
    topics = {'crank/centrode_curvature', 'crank/icr_velocity', 'coupler/wrt/crank/icr'}
    topics |= {f'{body}/{name}' for body in FOUR_BAR.bodies for name in (*RATE_NAMES, *POLE_NAMES)}
    for topic in sorted(topics):
        column = topic.replace('/', '_')
        values = found.get(f'/kinpole/{topic}', {})
        two = f'{column}_x' in rows[0]
        told = 0
        for stamp, row in zip(exact_stamps(rows), rows, strict=True):
            cells = [row[f'{column}_{axis}'] for axis in 'xy'] if two else ['', row[column]]
            if stamp not in values:
                assert not any(cells), (topic, stamp)
                continue
            told += 1
            expected = values[stamp][-3:]
            expected = expected[:2] if two else expected[2:]
            assert [float(cell) for cell in cells if cell] == expected.tolist(), topic
        assert told == len(values)
    spread = found['/kinpole/coupler/icr/with_covariance']
    for stamp, row in zip(exact_stamps(rows), rows, strict=True):
        if row['coupler_icr_x_sigma']:
            covariance = spread[stamp][-36:].reshape(6, 6)
            sigmas = [float(row[f'coupler_icr_{axis}_sigma']) for axis in 'xy']
            np.testing.assert_allclose(sigmas, np.sqrt(np.diag(covariance)[:2]), rtol=1e-12)
    poses = found['/kinpole/rocker/odom']
    for stamp, row in zip(exact_stamps(rows), rows, strict=True):
        if stamp in poses:
            position = [float(row['rocker_x']), float(row['rocker_y'])]
            assert position == poses[stamp][:2].tolist()


def exact_stamps(rows: list[dict[str, str]]) -> list[int]:
    return [int(row['t'].replace('.', '')) for row in rows]


def test_another_topic_may_be_named(simulated: Bag, tmp_path: Path) -> None:
    bag = simulated('cardan', rate=100, duration=0.5)
    messages = decoded(bag, '/markers')['/markers']
    other = write(tmp_path / 'other.mcap', messages, '/mocap/rod')
    replay(bag, CARDAN, tmp_path / 'a.mcap')
    for name, settings, topic in (
        ('b', CARDAN, '/mocap/rod'),
        ('c', CARDAN, 'mocap/rod'),
        ('d', replace(CARDAN, marker_topic='/mocap/rod'), None),
    ):
        replay(other, settings, tmp_path / f'{name}.mcap', topic=topic)
        found, same = (decoded(tmp_path / f'{n}.mcap') for n in (name, 'a'))
        for array, other_array in zip(
            found.pop('/diagnostics'), same.pop('/diagnostics'), strict=True
        ):
            for status, beside in zip(array.status, other_array.status, strict=True):
                assert status.hardware_id == '/mocap/rod'
                assert (status.level, status.values) == (beside.level, beside.values)
        assert found == same
    with pytest.raises(BagError, match=r'other\.mcap: no topic /markers; it holds /mocap/rod'):
        replay(other, CARDAN)


def test_markers_may_go_by_place_number_namespace_or_both(simulated: Bag, run: Any) -> None:
    bag = simulated('four_bar', rate=100, duration=0.2, noise=1e-4)
    expected = run(bag, FOUR_BAR)
    names = [name for listed in FOUR_BAR.bodies.values() for name in listed]
    ways: dict[str, Callable[[str], str]] = {
        'index': lambda name: str(names.index(name)),
        'id': lambda name: str(names.index(name)),
        'ns': lambda name: name,
        'ns_id': lambda name: f'{name}/{names.index(name)}',
        'auto': lambda name: f'{name}/{names.index(name)}',
    }
    for identity, way in ways.items():
        bodies = {body: tuple(map(way, listed)) for body, listed in FOUR_BAR.bodies.items()}
        assert_alike(run(bag, replace(FOUR_BAR, bodies=bodies, marker_identity=identity)), expected)


def test_frames_of_many_layouts_are_handed_over_together(
    simulated: Bag, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where markers drop out: each call costs what hundreds of frames do."""
    calls: list[int] = []
    add_parts = Tracker.add_parts

    def counted(
        self: Tracker, parts: Iterable[MarkerFrames], order: int | None, events: bool = False
    ) -> list[Estimate]:
        listed = list(parts)
        calls.append(len(listed))
        return add_parts(self, listed, order, events)

    monkeypatch.setattr(Tracker, 'add_parts', counted)
    replay(simulated('four_bar', **NOISY), FOUR_BAR)
    assert max(calls) > 20
    assert len(calls) < 5


@pytest.mark.parametrize('order', [1, 3])
def test_the_order_limits_the_topics_and_not_the_figures(
    simulated: Bag, noisy_figures: Figures, tmp_path: Path, order: int
) -> None:
    output, table = tmp_path / 'out.mcap', tmp_path / 'out.csv'
    replay(simulated('four_bar', **NOISY), replace(FOUR_BAR, derivative_order=order), output, table)
    messages = decoded(output)
    rows = result_outputs(tuple(FOUR_BAR.bodies), 'xy', highest=order)
    wanted = {row.under('/kinpole') for row in rows}
    full = noisy_figures
    assert set(messages) - {'/diagnostics', '/kinpole/rig'} == wanted & {*full, TF}
    # These have more poles, the more there are.
    for topic in ('/kinpole/visualization', '/kinpole/state'):
        wanted.remove(topic)
        messages.pop(topic)
    assert_alike(figures(messages), {topic: full[topic] for topic in wanted if topic in full})
    head = table.read_text().split('\n', 1)[0]
    assert ('coupler_isp_x' in head, 'coupler_ijp_x' in head) == (order == 4, order >= 3)
    assert ('coupler_centrode_curvature' in head) == (order >= 3)


# Nothing that is not a number, and nothing that is not known


def test_every_number_in_every_message_is_finite(noisy: dict[str, list[Any]]) -> None:
    assert len(noisy) > 50
    assert '/kinpole/visualization' in noisy
    for topic, listed in noisy.items():
        for message in listed:
            assert np.isfinite(list(numbers(message))).all(), topic
    for array in noisy['/diagnostics']:
        for status in array.status:
            assert not {pair.value for pair in status.values} & {'nan', 'inf', '-inf'}


def still(path: Path, motion: Callable[[float], complex]) -> Path:
    """A body that slides as told and does not turn, with noise."""
    generator = np.random.default_rng(4)
    shape = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.2], [0.1, 0.15]])
    listed = []
    for k in range(150):
        place = motion(k / 100)
        points = np.zeros((4, 3))
        points[:, :2] = shape + [place.real, place.imag] + 1e-4 * generator.normal(size=(4, 2))
        stamp = 1_000_000_000 + 10_000_000 * k
        listed.append(to_message('marker_array', stamp, 'world', 'abcd', points))
    return write(path, listed)


@pytest.mark.parametrize('speed', [0.0, 0.3])
def test_a_body_that_does_not_turn_has_no_icr_and_diagnostics_say_why(
    tmp_path: Path, speed: float
) -> None:
    bag = still(tmp_path / 'in.mcap', lambda t: speed * t + 0j)
    result = replay(bag, Settings(), tmp_path / 'out.mcap')
    messages = decoded(tmp_path / 'out.mcap')
    assert len(messages['/kinpole/body/odom']) == result.estimates == 140
    assert len(messages.get('/kinpole/body/icr', [])) <= 3
    assert len(messages.get('/kinpole/body/icr/with_covariance', [])) <= 3
    assert '/kinpole/body/centrode_curvature' not in messages
    assert result.determined['body']['icr'] < 0.03
    texts = [status.message for array in messages['/diagnostics'] for status in array.status]
    assert any('undetermined: icr' in text for text in texts)
    values = [
        (pair.key, pair.value)
        for array in messages['/diagnostics']
        for status in array.status
        for pair in status.values
    ]
    assert {'no rotation', 'pole at infinity'} & {v for k, v in values if k == 'icr undetermined'}


def test_a_pinned_body_has_a_pole_and_no_curvature_and_diagnostics_say_why(
    noisy: dict[str, list[Any]],
) -> None:
    assert len(noisy['/kinpole/crank/icr']) > 100
    assert len(noisy.get('/kinpole/crank/centrode_curvature', [])) <= 3
    cranks = [
        {pair.key: pair.value for pair in status.values}
        for array in noisy['/diagnostics'][1:]
        for status in array.status
        if status.name == 'kinpole: crank'
    ]
    assert cranks
    assert all('pinned' in crank['centrode_curvature undetermined'] for crank in cranks)


def test_topics_without_a_message_are_there_to_be_asked_for(simulated: Bag, tmp_path: Path) -> None:

    bag = still(tmp_path / 'in.mcap', lambda t: 0j)
    replay(bag, ONE_BODY, tmp_path / 'out.mcap')
    results = {row.under('/kinpole') for row in result_outputs(('body',), 'xy')}
    assert set(topics_of(tmp_path / 'out.mcap')) == results | {'/diagnostics', '/kinpole/rig'}


def test_a_body_out_of_sight_is_left_out_beside_one_that_is_not(
    simulated: Bag, tmp_path: Path
) -> None:
    bag = simulated('four_bar', rate=100, duration=1.0)
    listed = []
    for stamp, names, points in frames(bag):
        if 40 <= (stamp // 10_000_000) % 100 < 70:
            points[3:7] = np.nan
        listed.append(to_message('marker_array', stamp, 'world', names, points))
    replay(write(tmp_path / 'in.mcap', listed), FOUR_BAR, tmp_path / 'out.mcap')
    found = figures(decoded(tmp_path / 'out.mcap'))
    crank, coupler = (list(found[f'/kinpole/{body}/odom']) for body in ('crank', 'coupler'))
    hidden = range(1_400_000_000, 1_700_000_000)
    assert [stamp for stamp in crank if stamp not in hidden] == coupler
    assert len(crank) == 90
    assert not [s for s in found['/kinpole/coupler/wrt/crank/icr'] if s in hidden]


# How the tracking went


def test_diagnostics_come_once_a_second_of_stamps(simulated: Bag, tmp_path: Path) -> None:
    replay(simulated('cardan', rate=50, duration=4.0), CARDAN, tmp_path / 'out.mcap')
    arrays = decoded(tmp_path / 'out.mcap', '/diagnostics')['/diagnostics']
    assert [stamp_of(array) for array in arrays] == [k * 1_000_000_000 for k in (1, 2, 3, 4)]
    for array in arrays:
        assert [status.name for status in array.status] == ['kinpole: markers', 'kinpole: rod']
    last = {pair.key: pair.value for pair in arrays[-1].status[0].values}
    assert float(last['rate (Hz)']) == 50
    assert float(last['mean interval (s)']) == pytest.approx(0.02)
    assert last['frames received'] == '151'
    of_rod = {pair.key: pair.value for pair in arrays[-1].status[1].values}
    assert 0 < float(of_rod['time used for the angular velocity (s)']) <= CARDAN.window
    assert 1 <= float(of_rod['degree used for the angular velocity']) <= 12


def test_diagnostics_tell_nothing_as_known_that_was_known_a_second_ago_only(
    simulated: Bag, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=50, duration=6.0)
    with BagWriter(tmp_path / 'seldom.mcap') as writer:
        for k, m in enumerate(read_messages(bag, ['/markers'])):
            # In the end so few that the window holds one.
            if k < 150 or k % 25 == 0:
                writer.write_raw(m.topic, m.type_name, m.data, m.log_time)
    replay(tmp_path / 'seldom.mcap', CARDAN, tmp_path / 'out.mcap')
    arrays = decoded(tmp_path / 'out.mcap', '/diagnostics')['/diagnostics']
    said = {stamp_of(array) // 1_000_000_000: array.status[1].message for array in arrays}
    assert said[4].startswith('tracking')
    assert said[5].startswith('nothing known') and said[6].startswith('nothing known')


def test_messages_that_cannot_be_read_are_counted_and_left_out(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=100, duration=0.6, noise=1e-4)
    expected = run(bag, CARDAN)
    garbage = [
        b'',
        b'\x00\x01\x00\x00',
        b'\x00\x01\x00\x00\xff\xff\xff\x7f' + bytes(40),
        b'\x07' * 99,
    ]
    with BagWriter(tmp_path / 'bad.mcap') as writer:
        for k, m in enumerate(read_messages(bag, ['/markers'])):
            writer.write_raw(m.topic, m.type_name, m.data, m.log_time)
            if k % 20 == 7:
                writer.write_raw('/markers', MarkerArray, garbage[k // 20], m.log_time + 1)
    assert_alike(run(tmp_path / 'bad.mcap', CARDAN), expected)
    result = replay(tmp_path / 'bad.mcap', CARDAN, tmp_path / 'out.mcap')
    assert (result.frames, result.unreadable) == (60, 3)
    assert 'visualization_msgs/msg/MarkerArray' in result.problem
    assert '\n' not in result.problem


def test_the_diagnostics_after_a_bad_message_name_it(simulated: Bag, tmp_path: Path) -> None:
    listed = decoded(simulated('cardan', rate=50, duration=2.2))['/markers']
    for marker in listed[70].markers:
        marker.ns, marker.id = 'twin', 1
    result = replay(write(tmp_path / 'in.mcap', listed), CARDAN, tmp_path / 'out.mcap')
    assert result.unreadable == 1
    _, second, third = decoded(tmp_path / 'out.mcap')['/diagnostics']
    assert 'twin/1' in third.status[0].message
    assert third.status[0].level == b'\x01'
    assert second.status[0].level == b'\x00'
    assert {p.key: p.value for p in third.status[0].values}[
        'messages that could not be read'
    ] == '1'


def test_messages_of_another_type_on_the_topic_are_counted_and_not_read(
    simulated: Bag, tmp_path: Path
) -> None:
    # The bytes of a PointCloud2 can be taken for a PoseArray of one pose.
    rows = [frames(simulated('cardan', rate=100, duration=0.6))[:50] for _ in range(2)]
    writer = Writer(str(tmp_path / 'both.mcap'))
    writer.start('ros2', 'test')
    for kind, part in zip(('point_cloud2', 'pose_array'), rows, strict=True):
        cls = MARKER_TYPES[kind]
        schema = writer.register_schema(type_name(cls), 'ros2msg', definition(cls).encode())
        channel = writer.register_channel('/markers', 'cdr', schema)
        for stamp, names, points in part:
            data = serialize_message(to_message(kind, stamp, 'world', names, points))
            writer.add_message(channel, stamp, data, stamp)
    writer.finish()
    alone = [to_message('pose_array', stamp, 'world', names, p) for stamp, names, p in rows[1]]
    expected = replay(write(tmp_path / 'alone.mcap', alone), Settings())
    found = replay(tmp_path / 'both.mcap', Settings())
    assert found.unreadable == 50
    assert found.problem.startswith('/markers has messages of sensor_msgs/msg/PointCloud2 among ')
    assert (found.frames, found.noise) == (expected.frames, expected.noise)


def test_diagnostics_of_a_frame_that_brings_no_estimate_tell_of_the_one_before(
    simulated: Bag, tmp_path: Path
) -> None:
    listed = list(read_messages(simulated('cardan', rate=50, duration=2.2), ['/markers']))
    with BagWriter(tmp_path / 'in.mcap') as writer:
        for k, m in enumerate(listed):
            # At 2 s nothing is due: what would be is missing. Nor is it read with other frames.
            if k in (50, 51):
                writer.write_raw(m.topic, m.type_name, b'', m.log_time - 1)
            if k != 45:
                writer.write_raw(*m[:2], m.data, m.log_time)
    replay(tmp_path / 'in.mcap', CARDAN, tmp_path / 'out.mcap')
    _, second, third = decoded(tmp_path / 'out.mcap')['/diagnostics']
    assert stamp_of(second) == 2_000_000_000
    for array in (second, third):
        assert array.status[1].message == 'tracking'


def test_a_bag_of_nothing_readable_is_refused_with_the_reason(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bad.mcap') as writer:
        for k in range(3):
            writer.write_raw('/markers', MarkerArray, b'\x00\x01\x00\x00\xff', k)
    with pytest.raises(BagError, match='no message on /markers can be read: ') as error:
        replay(tmp_path / 'bad.mcap', Settings())
    assert '\n' not in str(error.value)


def test_a_clock_that_steps_back_starts_anew_and_the_second_time_is_right_too(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=100, duration=0.6)
    listed = decoded(bag, '/markers')['/markers']
    with BagWriter(tmp_path / 'twice.mcap') as writer:
        for k, message in enumerate(listed * 2):
            writer.write('/markers', message, k)
    expected = run(bag, CARDAN)
    result = replay(tmp_path / 'twice.mcap', CARDAN, tmp_path / 'out.mcap')
    assert (result.frames, result.estimates, result.resets) == (120, 100, 1)
    both = decoded(tmp_path / 'out.mcap')
    odom = '/kinpole/rod/odom'
    second = {topic: m[len(m) // 2 :] for topic, m in both.items()}
    assert len(both[odom]) == 100
    again = figures(second)
    assert {'/kinpole/rod/centrode/moving', '/kinpole/visualization'} <= again.keys()
    assert_alike(again, expected)


def test_a_bag_that_ends_before_it_began_spans_all_its_stamps(
    simulated: Bag, tmp_path: Path
) -> None:
    listed = decoded(simulated('cardan', rate=100, duration=0.6), '/markers')['/markers']
    with BagWriter(tmp_path / 'back.mcap') as writer:
        for k, message in enumerate(listed[40:] + listed[:20] + listed[:10]):
            writer.write('/markers', message, k)
    result = replay(tmp_path / 'back.mcap', CARDAN)
    assert (result.first, result.last) == (stamp_of(listed[0]), stamp_of(listed[-1]))


def test_repeated_stamps_are_counted_and_change_nothing(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=100, duration=0.5)
    listed = [message for message in decoded(bag, '/markers')['/markers'] for _ in range(2)]
    assert_alike(run(write(tmp_path / 'in.mcap', listed), CARDAN), run(bag, CARDAN))
    assert replay(tmp_path / 'in.mcap', CARDAN).repeated == 50


def test_frames_that_come_late_are_counted_and_disturb_nothing(
    simulated: Bag, tmp_path: Path
) -> None:
    listed = decoded(simulated('cardan', rate=50, duration=3.0), '/markers')['/markers']
    held = [k for k in range(150) if k % 7 != 3]
    order = sorted(range(150), key=lambda k: k if k in held else k + 4.5)
    bag, sound = tmp_path / 'late.mcap', tmp_path / 'sound.mcap'
    for path, frames in ((bag, order), (sound, held)):
        with BagWriter(path) as writer:
            for place, k in enumerate(frames):
                writer.write('/markers', listed[k], place)
    result = replay(bag, CARDAN, tmp_path / 'out.mcap')
    replay(sound, CARDAN, tmp_path / 'expected.mcap')
    assert (result.frames, result.late, result.resets) == (150, 150 - len(held), 0)
    found, expected = (decoded(tmp_path / name) for name in ('out.mcap', 'expected.mcap'))
    told = [array.status[0] for array in found.pop('/diagnostics')]
    expected.pop('/diagnostics')
    assert found == expected
    assert len(told) == 3
    assert all('came late' in status.message for status in told[1:])


def test_another_frame_id_is_counted_and_both_parts_are_right(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=100, duration=1.0)
    expected = run(bag, CARDAN, 'rod/icr')['/kinpole/rod/icr']
    listed = decoded(bag, '/markers')['/markers']
    for message in listed[50:]:
        for marker in message.markers:
            marker.header.frame_id = 'camera'
            marker.pose.position.x += 7.0
    result = replay(write(tmp_path / 'in.mcap', listed), CARDAN, tmp_path / 'out.mcap')
    assert (result.frame_changes, result.resets) == (1, 0)
    found = decoded(tmp_path / 'out.mcap')
    poles = found['/kinpole/rod/icr']
    assert [m.header.frame_id for m in poles] == sorted([m.header.frame_id for m in poles])[::-1]
    for m in poles:
        moved = 7.0 * (m.header.frame_id == 'camera')
        at = [m.point.x - moved, m.point.y, m.point.z]
        assert at == pytest.approx(expected[stamp_of(m)].tolist(), abs=1e-6)
    # The locus of the one frame does not go on in the other.
    last = found['/kinpole/rod/centrode/fixed'][-1]
    assert last.header.frame_id == 'camera'
    assert min(pose.pose.position.x for pose in last.poses) > 5


def test_rows_of_a_table_in_which_nothing_was_seen_are_left_out(
    simulated: Bag, run: Any, tmp_path: Path
) -> None:
    """They are arrays without markers, and so without a stamp, which is no fault of a driver."""
    listed = decoded(simulated('cardan', rate=100, duration=0.6), '/markers')['/markers']
    with BagWriter(tmp_path / 'all.mcap') as writer:
        for k, message in enumerate(listed):
            writer.write('/markers', MarkerArray() if k in (20, 21, 40) else message, k)
    result = replay(tmp_path / 'all.mcap', CARDAN)
    assert (result.frames, result.empty, result.resets, result.lost) == (57, 3, 0, 0)
    assert not result.warnings
    with BagWriter(tmp_path / 'none.mcap') as writer:
        writer.write('/markers', MarkerArray(), 0)
    with pytest.raises(BagError, match='no message on /markers has markers; fix: '):
        replay(tmp_path / 'none.mcap', CARDAN)


def test_half_of_the_stamps_repeated_is_a_warning_with_its_fix(tmp_path):
    path, count = tmp_path / 'half.mcap', 60
    angles = 0.02 * np.arange(count)[:, None] + [0.0, 1.0]
    points = np.stack((np.cos(angles), np.sin(angles), 0.0 * angles), axis=-1)
    stamps = 10**9 + np.arange(count) // 2 * 20_000_000
    logs = (10**9 + np.arange(count) * 10_000_000).tolist()
    data = marker_arrays(stamps, 'lab', ['a', 'b'], points)
    with BagWriter(path) as bag:
        bag.write_many([('/markers', INPUT_TYPES['marker_array'], logs, data)])
    settings = settings_from({'window': 0.3, 'lag': 0.1})
    lines = replay(path, settings).warnings
    assert '30 of 60 messages have the stamp of the one before, and are left out' in lines[0]


def test_the_outcome_of_a_replay_is_made_once_and_has_shares() -> None:
    settings = settings_from({'window': 0.3, 'lag': 0.1})
    tracker = Tracker(settings)
    so_far = _replayed.begin(settings, tracker, is_whole=False)
    turn = np.exp(0.05j * np.arange(200))[:, None] * [0.1, 0.1j, -0.1]
    points = np.stack((turn.real, turn.imag, 0 * turn.real), axis=-1)
    frames = MarkerFrames(10**9 + 5_000_000 * np.arange(200), 'world', ('a', 'b', 'c'), points)
    _replayed.add_frames(so_far, frames)
    for estimate in tracker.add(frames, settings.highest_order):
        _replayed.add_estimate(so_far, estimate)
    found = so_far.determined['body']['icr']
    outcome = _replayed.finish(so_far, tracker)
    assert 0 < found == round(outcome.determined['body']['icr'] * outcome.estimates)
    assert (outcome.frames, outcome.first, outcome.unknown) == (200, 10**9, {})
    with pytest.raises(FrozenInstanceError):
        outcome.frames = 0  # type: ignore[misc]


def test_a_whole_bag_has_results_to_both_ends_and_says_how_much_is_read(tmp_path: Path) -> None:
    bag, settings = tmp_path / 'run.mcap', settings_from({'derivative_order': 1})
    stamps = 10**9 + 10_000_000 * np.arange(120)
    turn = np.exp(1j * 3e-9 * stamps)[:, None] * np.array([0.1, 0.1j, -0.05])
    noise = 1e-4 * np.random.default_rng(0).normal(size=(120, 3, 2)) @ (1, 1j)
    with BagWriter(bag) as writer:
        for stamp, row in zip(stamps.tolist(), turn + noise, strict=True):
            points = np.stack((row.real, row.imag, 0 * row.real), axis=-1)
            message = to_message('marker_array', stamp, 'world', ['0', '1', '2'], points)
            writer.write('/markers', message, stamp + 1)
    shares: list[float] = []
    outputs = [tmp_path / f'{name}.csv' for name in 'ab']
    for output in outputs:
        shares.clear()
        whole = replay(bag, settings, tmp_path / 'o.mcap', output, None, shares.append, whole=True)
    live = replay(bag, settings)
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert (whole.frames, whole.estimates) == (120, 120)
    assert live.estimates < 120 and not live.unknown and not whole.unknown
    assert shares == sorted(shares) and shares[0] < 0.2 and shares[-1] == 1.0
    logged = [
        message.log_time for message in read_messages(tmp_path / 'o.mcap', ['/kinpole/state'])
    ]
    assert len(logged) == 120 and logged == sorted(logged) and logged[-1] == stamps[-1] + 1
