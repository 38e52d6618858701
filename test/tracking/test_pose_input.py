"""Poses of bodies in place of markers: what is made of them, how sure it is, what is refused."""

import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import decoded

from kinpole_ros.bags import BagError, BagWriter, replay, simulate
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import (
    INPUT_TYPES,
    DiagnosticsMaker,
    MarkerReader,
    MessageError,
    PoseReader,
    deserialize_message,
    poses_data,
    serialize_message,
    stamp_to_ns,
    to_message,
)
from kinpole_ros.settings import (
    POSE_TYPES,
    ParameterError,
    Settings,
    check_poses,
    settings_from,
)
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

START, RATE, COUNT = 10**9, 200, 900
TIMES = np.arange(COUNT) / RATE
# A body that swings about while its origin goes round, with their rates.
ANGLE = 0.8 * np.sin(5 * TIMES) + 0.2 * np.sin(10 * TIMES)
RATE_OF_ANGLE = 4 * np.cos(5 * TIMES) + 2 * np.cos(10 * TIMES)
PLACE = 0.3 * np.exp(4j * TIMES) + 0.05 * np.exp(-9j * TIMES)
VELOCITY = 1.2j * np.exp(4j * TIMES) - 0.45j * np.exp(-9j * TIMES)
LEARNED = 150
# Types that are read alone have tests in test_message_types.
WRITTEN = [kind for kind in POSE_TYPES if kind in INPUT_TYPES]
FOUR_BAR = load_scene('four_bar')


def posed(place: np.ndarray, angle: np.ndarray, mount: np.ndarray | None = None) -> MarkerFrames:
    """Poses (T,) in the plane xy, of a frame that sits on the body as `mount` (3, 3) says."""
    turn = np.zeros((len(angle), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(angle), -np.sin(angle)
    turn[:, 2, 2] = 1.0
    axes = (turn @ (np.eye(3) if mount is None else mount)).swapaxes(1, 2)
    points = np.stack((place.real, place.imag, np.full(len(angle), 0.4)), axis=-1)
    stamps = START + np.arange(len(angle)) * (10**9 // RATE)
    return MarkerFrames(stamps, 'world', ('0',), points[:, None], axes[:, None, :2])


def noisy(of_place: float, of_angle: float, middle: complex = 0j, seed: int = 3) -> MarkerFrames:
    """The body with noise of its angle and, independent of that, of a point of it."""
    rng = np.random.default_rng(seed)
    angle = ANGLE + of_angle * rng.normal(size=COUNT)
    place = PLACE + middle * (np.exp(1j * ANGLE) - np.exp(1j * angle))
    return posed(place + of_place * rng.normal(size=(COUNT, 2)) @ (1, 1j), angle)


def follow(frames: MarkerFrames, order: int = 1, **values: Any) -> tuple[Tracker, Estimate]:
    settings = settings_from({'marker_type': 'pose_stamped', 'lag': 0.15, **values})
    tracker = Tracker(settings)
    (estimate,) = tracker.add(frames, order)
    return tracker, estimate


@pytest.mark.parametrize(
    ('of_place', 'of_angle', 'middle'),
    [(2e-4, 2e-4, 0), (2e-4, 5e-3, 0), (2e-3, 5e-4, 0), (2e-4, 3e-3, 0.1 + 0.05j)],
)
def test_deviations_hold_whatever_the_noise_of_angle_is_over_that_of_place(
    of_place: float, of_angle: float, middle: complex
) -> None:
    tracker, found = follow(noisy(of_place, of_angle, middle))
    (noise,), of_turning = tracker.noise(), tracker.angle_noise()
    assert of_turning is not None
    assert noise == pytest.approx(of_place, rel=0.2)
    assert of_turning[0] == pytest.approx(of_angle, rel=0.2)
    row = np.rint((found.stamp - START) * 1e-9 * RATE).astype(int)
    good = (found.missing[:, 0] == '') & (row > LEARNED)
    assert good.sum() > 0.9 * (row > LEARNED).sum()
    rate, origin = found.rate(1), found.origin(1)
    off = (rate.value[:, 0] - RATE_OF_ANGLE[row]) / np.sqrt(rate.variance[:, 0])
    assert 0.4 < np.sqrt((off[good] ** 2).mean()) < 1.1
    # The velocity of the origin, by that of the point it is known by and the arm from there.
    arm = np.abs(found.reference[:, 0]) ** 2 if found.reference is not None else 0.0
    spread = found.position_covariance[1, 1, :, 0] + arm * rate.variance[:, 0]
    off = np.abs(origin[:, 0] - VELOCITY[row]) / np.sqrt(2 * spread)
    assert 0.3 < np.sqrt((off[good] ** 2).mean()) < 1.2
    pole = found.pole(1)
    good &= pole.determined[:, 0]
    true = PLACE + 1j * VELOCITY / RATE_OF_ANGLE
    error = pole.value[:, 0] - true[row]
    both = np.stack((error.real, error.imag), axis=-1)[good]
    inverse = np.linalg.inv(pole.covariance[good, 0])
    square = np.einsum('ti,tij,tj->t', both, inverse, both)
    assert good.sum() > 300
    assert np.mean(square < 5.99) > 0.9 and 0.2 < np.median(square) / 1.39 < 1.3


def test_poses_one_by_one_give_what_they_give_at_once() -> None:
    frames = noisy(2e-4, 1e-3)
    part = [part_of(frames, slice(0, 200)), part_of(frames, slice(200, 350))]
    values = {'marker_type': 'pose_stamped', 'lag': 0.15}
    whole, single = Tracker(settings_from(values)), Tracker(settings_from(values))
    (expected,) = whole.add_parts(part, 1)
    found = [single.add(part_of(frames, slice(k, k + 1)), 1) for k in range(350)]
    angle = np.concatenate([e.angle for each in found for e in each], axis=1)
    np.testing.assert_array_equal(angle, expected.angle)


def test_the_pose_published_is_that_of_the_frame_that_came() -> None:
    _, found = follow(noisy(1e-6, 1e-6, 0.2))
    row = np.rint((found.stamp - START) * 1e-9 * RATE).astype(int)
    assert np.abs(found.origin(0)[LEARNED:, 0] - PLACE[row][LEARNED:]).max() < 1e-5
    assert np.abs(found.angle[0][LEARNED:, 0] - ANGLE[row][LEARNED:]).max() < 1e-5
    assert found.height[-1, 0] == pytest.approx(0.4)


def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Products of quaternions (..., 4), x, y, z, w."""
    vector = first[..., 3:] * second[..., :3] + second[..., 3:] * first[..., :3]
    vector += np.cross(first[..., :3], second[..., :3])
    scalar = first[..., 3] * second[..., 3] - (first[..., :3] * second[..., :3]).sum(axis=-1)
    return np.concatenate((vector, scalar[..., None]), axis=-1)


def about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Quaternions (T, 4) of rotations by `angle` (T,), rad, about `axis` (3,) or (T, 3)."""
    turned = np.broadcast_to(axis, (len(angle), 3)) * np.sin(angle / 2)[:, None]
    return np.concatenate((turned, np.cos(angle / 2)[:, None]), axis=-1)


def rotation(kind: str, times: np.ndarray) -> np.ndarray:
    """Orientations (T, 4) of a body that turns about z and is tilted out of the plane xy."""
    heading = 0.5 * np.sin(2 * np.pi * times)
    tilt = np.radians(25.5 + 3.5 * np.sin(2 * np.pi * 0.7 * times + 0.4))
    direction = np.full(len(times), 0.6)
    if kind == 'cone':
        direction = 0.6 + 3 * times
    elif kind == 'steady':
        heading, tilt = 12 * times, np.full(len(times), np.radians(25))
    elif kind == 'flat':
        tilt = np.zeros(len(times))
    axis = np.stack((np.cos(direction), np.sin(direction), 0 * times), axis=-1)
    return product(about(axis, tilt), about(np.array((0.0, 0.0, 1.0)), heading))


def rate_in_space(kind: str, times: np.ndarray) -> np.ndarray:
    """The angular velocity (T,) along z, rad/s, by a central difference of the rotation."""
    step = 1e-4
    after, before = rotation(kind, times + step), rotation(kind, times - step)
    return product(after, before * (-1, -1, -1, 1))[:, 2] / step


def tilted(kind: str, of_angle: float, middle: complex = 0j) -> MarkerFrames:
    """Poses with noise of the orientation, rad per axis, and independent of it of a point."""
    rng = np.random.default_rng(5)
    errors = of_angle * rng.normal(size=(COUNT, 3))
    size = np.sqrt((errors**2).sum(axis=1)) + 1e-300
    true = rotation(kind, TIMES)
    turn = product(about(errors / size[:, None], size), true)
    arm = np.tile((middle.real, middle.imag, 0.0, 0.0), (COUNT, 1))
    arms = (product(product(q, arm), q * (-1, -1, -1, 1))[:, :3] for q in (true, turn))
    place = np.stack((PLACE.real, PLACE.imag, np.full(COUNT, 0.4)), axis=-1)
    place += next(arms) - next(arms) + 2e-4 * rng.normal(size=(COUNT, 3))
    rows = np.concatenate((place, turn), axis=1)
    stamps = START + np.arange(COUNT) * (10**9 // RATE)
    both = zip(stamps.tolist(), rows, strict=True)
    data = [poses_data('body_poses', stamp, 'world', [], row[None]) for stamp, row in both]
    (frames,) = PoseReader('body_poses', ('0',)).read(data)
    assert isinstance(frames, MarkerFrames)
    return frames


@pytest.mark.parametrize('kind', ['swing', 'cone', 'steady', 'flat'])
@pytest.mark.parametrize(('of_angle', 'middle'), [(2e-3, 0j), (5e-3, 0j), (3e-3, 0.1 + 0.05j)])
def test_rates_of_a_tilted_body_are_those_of_its_rotation_in_space_along_the_normal(
    kind: str, of_angle: float, middle: complex
) -> None:
    _, found = follow(tilted(kind, of_angle, middle), 2, marker_type='body_poses')
    row = np.rint((found.stamp - START) * 1e-9 * RATE).astype(int)
    good = (found.missing[:, 0] == '') & (row > 2 * LEARNED)
    assert good.sum() > 0.9 * (row > 2 * LEARNED).sum()
    row, step = row[good], 1e-3
    rate = rate_in_space(kind, TIMES[row])
    ends = (rate_in_space(kind, TIMES[row] + side) for side in (step, -step))
    acceleration = (next(ends) - next(ends)) / (2 * step)
    for order, true in ((1, rate), (2, acceleration)):
        value, variance = (each[good, 0] for each in found.rate(order)[:2])
        assert np.mean(np.abs(value - true) < 2 * np.sqrt(variance)) > 0.88
    # The velocity of the origin is that of its projection, whatever point is differentiated.
    speed_error = np.abs(found.origin(1)[good, 0] - VELOCITY[row])
    arm = np.abs(found.reference[good, 0]) ** 2
    variance = found.position_covariance[1, 1, good, 0] + arm * found.rate(1).variance[good, 0]
    assert np.mean(speed_error < 2 * np.sqrt(2 * variance)) > 0.88
    assert np.abs(found.origin(0)[good, 0] - PLACE[row]).max() < 1e-3
    # The angle is that of the pose: it does not run away from it.
    _, _, z, w = rotation(kind, TIMES[row]).T
    error = np.angle(np.exp(1j * (found.angle[0][good, 0] - 2 * np.arctan2(z, w))))
    assert np.sqrt(np.mean(error**2)) < 0.3 * of_angle


def test_poses_of_a_tilted_body_one_by_one_give_what_they_give_at_once() -> None:
    frames = part_of(tilted('cone', 3e-3, 0.1 + 0.05j), slice(0, 500))
    _, whole = follow(frames, 2, marker_type='body_poses')
    single = Tracker(settings_from({'marker_type': 'body_poses', 'lag': 0.15}))
    parts = [single.add(part_of(frames, slice(k, k + 1)), 2) for k in range(500)]
    for name in ('angle', 'position'):
        found = np.concatenate([getattr(e, name) for each in parts for e in each], axis=1)
        np.testing.assert_array_equal(found, getattr(whole, name))


def test_a_wrong_pose_of_a_tilted_body_leaves_nothing_in_the_rates_after_it() -> None:
    frames = tilted('swing', 2e-3)
    _, expected = follow(frames, marker_type='body_poses')
    assert frames.axes is not None
    frames.axes[500, 0] = frames.axes[500, 0, ::-1] * (1.0, -1.0, 1.0)
    frames.points[500, 0, 0] += 0.5
    _, found = follow(frames, marker_type='body_poses')
    later = slice(700, None)
    error = found.rate(1).value[later] - expected.rate(1).value[later]
    assert np.abs(error).max() < 0.2 * np.sqrt(found.rate(1).variance[later]).min()


@pytest.mark.parametrize(
    'mount',
    [
        np.diag((1.0, -1.0, -1.0)),
        np.diag((-1.0, 1.0, -1.0)),
        np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]),
        np.array([(0.6, 0.0, 0.8), (0.0, 1.0, 0.0), (-0.8, 0.0, 0.6)]),
    ],
    ids=['upside down', 'upside down, x back', 'axes permuted', 'slanted'],
)
def test_however_a_frame_sits_on_its_body_the_rates_are_the_same(mount: np.ndarray) -> None:
    part = slice(0, 300)
    _, straight = follow(posed(PLACE[part], ANGLE[part]))
    _, found = follow(posed(PLACE[part], ANGLE[part], mount))
    good = straight.missing[:, 0] == ''
    assert good.sum() > 200
    np.testing.assert_allclose(found.rate(1).value[good], straight.rate(1).value[good], atol=1e-6)
    np.testing.assert_allclose(found.pole(1).value[good], straight.pole(1).value[good], atol=1e-6)


def test_a_pose_that_is_missing_is_said_and_figures_go_on_after_it() -> None:
    frames = noisy(2e-4, 1e-3)
    frames.points[400:460] = np.nan
    frames.points[600:900:7] = np.nan
    tracker, found = follow(frames)
    row = np.rint((found.stamp - START) * 1e-9 * RATE).astype(int)
    reasons = found.missing[:, 0]
    assert set(reasons[(row >= 400) & (row < 460)]) == {'no pose of it came'}
    later = (row > 600) & (row % 7 != 600 % 7)
    assert np.mean(reasons[later] == '') > 0.95
    off = (found.rate(1).value[:, 0] - RATE_OF_ANGLE[row]) / np.sqrt(found.rate(1).variance[:, 0])
    assert np.sqrt((off[later & (reasons == '')] ** 2).mean()) < 1.1
    assert tracker.update_counts()['markers_not_seen'] == 60 + 43


def test_smoothed_poses_are_warned_of() -> None:
    rng = np.random.default_rng(1)
    errors = rng.normal(size=(3, COUNT))
    for k in range(1, COUNT):
        errors[:, k] = 0.6 * errors[:, k - 1] + 0.4 * errors[:, k]
    of_place, of_angle = 2e-4 * errors[:2].T @ (1, 1j), 2e-3 * errors[2]
    tracker, _ = follow(posed(PLACE + of_place, ANGLE + of_angle))
    assert tracker.noise_underestimated()[0]
    plain, _ = follow(noisy(2e-4, 2e-3))
    assert not plain.noise_underestimated()[0]


def test_the_noise_given_is_that_of_the_position() -> None:
    tracker, found = follow(noisy(2e-4, 1e-3), noise=5e-4)
    _, measured = follow(noisy(2e-4, 1e-3))
    angle = tracker.angle_noise()
    assert angle is not None and angle[0] == pytest.approx(1e-3, rel=0.2)
    last = -1, 0
    assert found.rate(1).variance[last] == pytest.approx(measured.rate(1).variance[last], rel=0.05)
    wide, narrow = (e.position_covariance[1, 1][last] for e in (found, measured))
    assert wide > 2 * narrow


def test_diagnostics_give_both_noises_of_poses() -> None:
    tracker, found = follow(noisy(2e-4, 1e-3))
    array = DiagnosticsMaker('kinpole', None, '/pose').make(START, tracker, found, 1.0, {}, [])
    (body,) = (each for each in array.status if each.name.endswith(': body'))
    values = {pair.key: float(pair.value) for pair in body.values[:2]}
    assert values['noise of its position per axis (m)'] == pytest.approx(2e-4, rel=0.2)
    assert values['noise of its angle (rad)'] == pytest.approx(1e-3, rel=0.2)


def values_of(kind: str) -> dict[str, Any]:
    """Parameters for what simulate makes of the four-bar."""
    bodies = list(FOUR_BAR.markers)
    values: dict[str, Any] = {'marker_type': kind, 'window': 0.4, 'lag': 0.2}
    if kind != 'pose_stamped':
        values['bodies'] = bodies
        names = bodies if kind == 'tf' else ['0', '1', '2']
        values.update({f'{b}.markers': [n] for b, n in zip(bodies, names, strict=True)})
    if kind == 'tf':
        values['marker_topic'] = '/tf'
    return values


@pytest.fixture(scope='module')
def results(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[..., tuple[Estimate, list[str], Path]]:
    """Of a simulated bag of a kind: what is estimated, said, and written."""
    folder = tmp_path_factory.mktemp('poses')

    @cache
    def make(kind: str, **options: Any) -> tuple[Estimate, list[str], Path]:
        bag, written = folder / f'{kind}.mcap', folder / f'{kind}_result.mcap'
        plane = 'fit' if 'tilt' in options else 'xy'
        duration = options.pop('duration', 3.0)
        simulate(FOUR_BAR, bag, noise=2e-4, duration=duration, message=kind, **options)
        scale = 1 / options.get('scale', 1.0)
        settings = settings_from({**values_of(kind), 'scale': scale, 'plane': plane})
        found: list[Estimate] = []
        result = replay(bag, settings, written, take=found.append)
        return found[-1], result.warnings, written

    return make


def test_the_same_poses_of_any_type_give_the_same_with_deviations_that_hold(
    results: Callable[..., tuple[Estimate, list[str], Path]],
) -> None:
    found = {kind: results(kind) for kind in WRITTEN}
    of_tf, said, written = found['tf']
    assert not said
    motion = FOUR_BAR.motion((of_tf.stamp - START) * 1e-9)
    for b, body in enumerate(of_tf.bodies):
        good = of_tf.missing[:, b] == ''
        assert good.mean() > 0.9
        rate = of_tf.rate(1)
        off = (rate.value[:, b] - motion[body].angle[1]) / np.sqrt(rate.variance[:, b])
        assert np.sqrt((off[good] ** 2).mean()) < 1.5
    np.testing.assert_array_equal(of_tf.angle, found['body_poses'][0].angle)
    np.testing.assert_array_equal(of_tf.position, found['body_poses'][0].position)
    alone = found['pose_stamped'][0]
    np.testing.assert_allclose(alone.angle[1, :, 0], of_tf.angle[1, :, 0], rtol=1e-9)
    frames = decoded(written, '/tf')['/tf']
    assert {t.child_frame_id for m in frames for t in m.transforms} == set(of_tf.bodies)
    assert {t.header.frame_id for m in frames for t in m.transforms} == {'world'}


def test_frames_of_a_scene_are_held_against_it(
    results: Callable[..., tuple[Estimate, list[str], Path]], tmp_path: Path
) -> None:
    bag = results('tf')[2].with_name('tf.mcap')
    values = {**values_of('tf'), 'scene': 'four_bar'}
    found = replay(bag, settings_from(values)).scene_positions
    assert found is not None and not found.findings
    assert found.ratio == pytest.approx(1.0, abs=0.2)


def test_poses_in_a_tilted_plane_and_other_units_tell_the_same(
    results: Callable[..., tuple[Estimate, list[str], Path]],
) -> None:
    found, said, _ = results('body_poses', tilt=30.0, scale=1000.0, duration=3.0)
    assert not said and found.plane is not None
    assert np.arccos(found.plane.normal @ (0, -0.5, np.sqrt(0.75))) < np.radians(0.2)
    motion = FOUR_BAR.motion((found.stamp - START) * 1e-9)
    known = found.missing[:, 0] == ''
    assert known.mean() > 0.5
    rate = found.rate(1)
    off = (rate.value[:, 0] - motion['crank'].angle[1]) / np.sqrt(rate.variance[:, 0])
    assert np.sqrt((off[known] ** 2).mean()) < 1.4


def test_simulate_leaves_out_poses_of_bodies_with_a_marker_hidden(tmp_path: Path) -> None:
    bag = tmp_path / 'poses.mcap'
    simulate(FOUR_BAR, bag, duration=1.0, message='tf', dropout=0.2)
    sizes = [len(message.transforms) for message in decoded(bag, '/tf')['/tf']]
    assert {0, 1, 2, 3} >= set(sizes) > {1, 2} and np.mean(sizes) < 2
    with pytest.raises(BagError, match='--unlabeled is of markers'):
        simulate(FOUR_BAR, bag, message='tf', unlabeled=True)


# --- messages ------------------------------------------------------------------------------------

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def tf(stamp: int, parent: str = 'world', **poses: tuple[float, ...]) -> bytes:
    """A TFMessage of one instant: a place on the x axis, and how it is turned."""
    rows = np.array([(x, 0.0, 0.0, *(turn or UPRIGHT)) for x, *turn in poses.values()])
    return poses_data('tf', stamp, parent, list(poses), rows.reshape(-1, 7))


def read(reader: PoseReader, *messages: bytes) -> tuple[list[MarkerFrames], list[str]]:
    found = reader.read(messages)
    errors = [str(part) for part in found if isinstance(part, MessageError)]
    return [part for part in found if isinstance(part, MarkerFrames)], errors


def test_messages_of_poses_are_what_ros_makes_of_them() -> None:
    rows = np.array([(1.0, 2.0, 3.0, *UPRIGHT), (4.0, 5.0, 6.0, 0.0, 0.0, 0.6, 0.8)])
    for kind in ('pose_stamped', 'body_poses'):
        data = poses_data(kind, 7 * 10**9 + 5, 'lab', ['a', 'b'], rows)
        message = deserialize_message(data, INPUT_TYPES[kind])
        assert len(serialize_message(message)) == len(data)
        last = message.pose if kind == 'pose_stamped' else message.poses[1]
        assert last.position.x == (1.0 if kind == 'pose_stamped' else 4.0)
        assert last.orientation.w == (1.0 if kind == 'pose_stamped' else 0.8)
        assert stamp_to_ns(message.header.stamp) == 7 * 10**9 + 5
        (frames,) = PoseReader(kind, ()).read([poses_data(kind, 5, 'lab', ['a'], rows[:1])])
        assert isinstance(frames, MarkerFrames) and frames.axes is not None
        np.testing.assert_array_equal(frames.points, [[(1.0, 2.0, 3.0)]])
    (frames,) = PoseReader('body_poses', ('1',)).read([data])
    assert isinstance(frames, MarkerFrames) and frames.axes is not None
    np.testing.assert_allclose(frames.axes[0, 1], [(0.28, 0.96, 0), (-0.96, 0.28, 0)])


def test_bodies_that_come_in_messages_of_their_own_are_one_frame() -> None:
    reader = PoseReader('tf', ('a', 'b'))
    messages = [
        tf(10, a=(1.0,)),
        tf(10, camera=(9.0,)),
        tf(10, b=(2.0,)),
        tf(20, b=(3.0,)),
        tf(30, a=(4.0,)),
        tf(30, b=(5.0,)),
    ]
    (frames,), errors = read(reader, *messages)
    assert not errors
    np.testing.assert_array_equal(frames.stamps, [10, 20, 30])
    np.testing.assert_array_equal(frames.points[..., 0], [(1, 2), (np.nan, 3), (4, 5)])
    numbered = list(PoseReader('tf', ('a', 'b')).read_numbered(messages))
    assert [list(numbers) for _, numbers in numbered] == [[2, 4, 5]]


def test_where_all_bodies_come_in_one_message_nothing_waits_for_those_unseen() -> None:
    reader = PoseReader('tf', ('a', 'b'))
    (frames,), _ = read(reader, tf(10, a=(1.0,), b=(2.0,)), tf(20, a=(3.0,)))
    np.testing.assert_array_equal(frames.stamps, [10, 20])


QUARTER = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # of a turn about z


@pytest.mark.parametrize('names', [('crank', 'coupler'), ('coupler', 'crank'), ('coupler',)])
@pytest.mark.parametrize('order', [1, -1])
def test_a_chain_of_frames_is_multiplied_out(names: tuple[str, ...], order: int) -> None:
    reader = PoseReader('tf', names)
    messages: list[bytes] = []
    for k in range(3):
        pair = [
            tf(10 * k, crank=(1.0, *QUARTER)),
            tf(10 * k, 'crank', coupler=(1.0 + k, *QUARTER)),
        ]
        messages += pair[::order]
    frames, errors = read(reader, *messages)
    assert not errors
    whole = frames[-1]
    assert whole.frame_id == 'world'
    coupler = names.index('coupler')
    # From (1, 0), a quarter turned: along y.
    np.testing.assert_allclose(whole.points[-1, coupler, :2], (1.0, 3.0), atol=1e-12)
    assert whole.axes is not None
    np.testing.assert_allclose(whole.axes[-1, coupler, 0], (-1.0, 0.0, 0.0), atol=1e-12)
    assert not reader.fault()


def test_a_chain_of_other_stamps_is_not_known_and_says_why() -> None:
    reader = PoseReader('tf', ('crank', 'coupler'))
    messages = [tf(10 * k, crank=(1.0,)) for k in range(3)]
    messages += [tf(10 * k + 5, 'crank', coupler=(1.0,)) for k in range(3, 6)]
    frames, errors = read(reader, *messages)
    assert not errors
    assert all(np.isnan(one.points[:, 1]).all() for one in frames)
    fault = reader.fault()
    assert fault is not None and fault.code == 'stamped_apart'
    assert fault.sentence().startswith("'coupler' is on 'crank', and came 2 times with another")


def test_frames_that_do_not_move_are_links_of_a_chain() -> None:
    reader = PoseReader('tf', ('crank', 'tool'))
    reader.add_static(tf(0, 'crank', tool=(0.5,)))
    reader.add_static(tf(0, 'map', world=(7.0,)))
    (frames,), errors = read(reader, *[tf(10 * k, crank=(1.0, *QUARTER)) for k in range(3)])
    assert not errors
    assert frames.frame_id == 'world'
    np.testing.assert_allclose(frames.points[2, :, :2], [(1.0, 0.0), (1.0, 0.5)], atol=1e-12)


def test_bodies_in_frames_that_do_not_meet_are_refused_and_say_why() -> None:
    reader = PoseReader('tf', ('crank', 'coupler'))
    _, errors = read(reader, tf(10, crank=(1.0,)), tf(10, 'camera', coupler=(1.0,)))
    assert "/tf has 'coupler' in 'camera', and others in 'world'" in errors[0]
    assert 'must lead to one fixed frame' in errors[0]


@pytest.mark.parametrize('turn', [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.9), (1e200, 0, 0, 1)])
def test_what_is_no_rotation_is_left_out_with_one_line(turn: tuple[float, ...]) -> None:
    reader = PoseReader('tf', ('a', 'b'))
    (frames,), (error,) = read(reader, tf(10, a=(1.0, *turn), b=(2.0,)))
    assert "the orientation of pose 'a' is [" in error and 'length 1' in error
    np.testing.assert_array_equal(frames.points[0, :, 0], [np.nan, 2.0])


def test_floats_of_32_bits_and_poses_not_seen_are_nothing_to_speak_of() -> None:
    short = np.array((0.0, 0.0, 0.6, 0.8), np.float32).astype(float)
    rows = np.array([(1.0, 0.0, 0.0, *short), (2.0, 0.0, 0.0, *[np.nan] * 4)])
    data = poses_data('body_poses', 10, 'lab', [], rows)
    (frames,), errors = read(PoseReader('body_poses', ('0', '1')), data)
    assert not errors
    np.testing.assert_array_equal(np.isnan(frames.points[0, :, 0]), [False, True])


def test_a_pose_array_of_nobody_is_a_frame_in_which_nobody_is_seen() -> None:
    rows = np.array([(1.0, 2.0, 3.0, *UPRIGHT)])
    data = [poses_data('body_poses', 10**9 + k, 'lab', [], rows[: k % 2]) for k in range(4)]
    frames, errors = read(PoseReader('body_poses', ('0',)), *data)
    assert not errors and [each.points.shape[1] for each in frames] == [0, 1, 0, 1]
    tracker = Tracker(Settings(bodies={'wand': ('0',)}, marker_type='body_poses'))
    tracker.add_parts(frames, 1)
    assert tracker.update_counts()['markers_not_seen'] == 2


def test_names_that_never_come_are_said_with_those_that_do(tmp_path: Path) -> None:
    reader = PoseReader('tf', ('crank',))
    assert not reader.fault()
    read(reader, tf(10, robot=(1.0,), lidar=(2.0,)))
    fault = reader.fault()
    assert fault is not None and fault.code == 'unseen_names'
    assert (fault.values['names'], fault.values['others']) == ("'crank'", "'robot', 'lidar'")
    bag = tmp_path / 'tf.mcap'
    simulate(FOUR_BAR, bag, duration=0.5, message='tf')
    with pytest.raises(BagError, match="no pose came of 'arm'; frames that came"):
        replay(bag, Settings(marker_type='tf', marker_topic='/tf', bodies={'arm': ('arm',)}))


def two_bodies(path: Path, shift: int) -> Path:
    """A bag of two bodies on /tf that come together, the stamps of one of them shifted, ns."""
    rng = np.random.default_rng(1)
    with BagWriter(path) as writer:
        for k in range(300):
            came = START + k * 5_000_000
            for body, stamp in (('arm', came), ('rod', came + shift)):
                half = came * 1e-9 + 1e-3 * rng.normal()
                place = 1e-4 * rng.normal(size=3)
                row = np.array([(*place, 0.0, 0.0, np.sin(half), np.cos(half))])
                data = poses_data('tf', stamp, 'world', [body], row)
                writer.write_raw('/tf', INPUT_TYPES['tf'], data, came)
    return path


@pytest.mark.parametrize(
    ('shift', 'words'),
    [
        (
            -30_000_000,
            "'rod' has stamps at least 0.03 s behind those that came before it, as of 'arm'",
        ),
        (30_000_000, "'arm' has stamps at least 0.025 s behind those that came before it, as of"),
        (-1_000_000, "'rod' has stamps at least 0.001 s behind"),
        (
            10**15,
            "'arm' has stamps at least 1e+06 s behind those of 'rod', which came with it: stam",
        ),
        (-900 * 10**6, "'rod' has stamps at least 0.9 s behind those that came before it"),
    ],
)
def test_a_body_stamped_behind_the_others_is_named_as_the_cause(
    tmp_path: Path, shift: int, words: str
) -> None:
    names = {'arm.markers': ['arm'], 'rod.markers': ['rod'], 'bodies': ['arm', 'rod']}
    settings = settings_from({'marker_type': 'tf', 'marker_topic': '/tf', **names})
    lines = replay(two_bodies(tmp_path / 'tf.mcap', shift), settings).warnings
    assert any(words in line for line in lines)
    assert not any('never estimated' in line or 'raise' in line for line in lines)
    assert any('two clocks' in line for line in lines) == (shift == 10**15)


def test_bodies_stamped_alike_are_not_said_to_be_late(tmp_path: Path) -> None:
    names = {'arm.markers': ['arm'], 'rod.markers': ['rod'], 'bodies': ['arm', 'rod']}
    settings = settings_from({'marker_type': 'tf', 'marker_topic': '/tf', **names})
    result = replay(two_bodies(tmp_path / 'tf.mcap', 0), settings)
    assert result.estimates > 200
    assert not result.findings


@pytest.mark.parametrize(
    ('seconds', 'nanoseconds', 'expected'),
    [
        (-1, 0, 'header.stamp is -1 s; see that the driver sets it'),
        (2**31 - 1, 10**9, 'header.stamp has 1000000000 ns after 2147483647 s'),
        (1, 1_500_000_000, 2_500_000_000),
    ],
)
def test_stamps_of_poses_are_those_of_markers(
    seconds: int, nanoseconds: int, expected: int | str
) -> None:
    """One rule for all types of messages says which stamps are none."""
    pose = poses_data('pose_stamped', 0, 'world', [], np.array([(1.0, 2.0, 3.0, *UPRIGHT)]))
    markers = serialize_message(to_message('pose_array', 0, 'world', ['a'], np.zeros((1, 3))))
    stamp = struct.pack('<iI', seconds, nanoseconds)
    for reader, data in (
        (PoseReader('pose_stamped', ()), pose),
        (MarkerReader('pose_array'), markers),
    ):
        (found,) = reader.read([data[:4] + stamp + data[12:]])
        if isinstance(found, MessageError):
            assert str(found).startswith(str(expected))
        else:
            assert found.stamps.tolist() == [expected]


@pytest.mark.parametrize('kind', WRITTEN)
def test_messages_that_are_cut_or_claim_too_much_are_errors_and_no_more(kind: str) -> None:
    rows = np.array([(1.0, 2.0, 3.0, *UPRIGHT)])
    data = poses_data(kind, 10**9, 'world', ['a'], rows)
    names = ('a',) if kind == 'tf' else ('0',)
    reader = PoseReader(kind, names)
    for size in range(len(data)):
        found = reader.read([data[:size]])
        assert all(isinstance(part, MessageError) for part in found)
    rng = np.random.default_rng(4)
    for _ in range(300):
        spoiled = bytearray(data)
        spoiled[rng.integers(len(data))] = rng.integers(256)
        for part in reader.read([bytes(spoiled)]):
            if isinstance(part, MarkerFrames):
                assert part.axes is not None and (part.stamps >= 0).all()
                assert part.axes.shape == (*part.points.shape[:2], 2, 3)
    if kind != 'pose_stamped':
        count = data.index(b'\1\0\0\0', 4)
        (error,) = reader.read([data[:count] + b'\xff' * 4 + data[count + 4 :]])
        assert isinstance(error, MessageError)


# --- parameters ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'marker_type': 'tf'}, 'body.markers names 0 poses'),
        ({'marker_type': 'tf', 'body.markers': ['a', 'b']}, 'body.markers names 2 poses'),
        ({'marker_type': 'pose_stamped', 'body.markers': ['a']}, 'has no names; leave it out'),
        ({'marker_type': 'pose_stamped', 'bodies': ['a', 'b']}, 'or run a node for each'),
        ({'marker_type': 'body_poses', 'bodies': ['a', 'b']}, 'a.markers names 0 poses'),
        ({'marker_type': 'body_poses', 'marker_identity': 'shape'}, 'marker_identity is shape'),
        (
            {'marker_type': 'body_poses', 'body.shape': [0.0, 0.0, 1.0, 0.0]},
            'body.shape is of markers',
        ),
        (
            {'marker_type': 'tf', 'body.markers': ['body'], 'publish_tf': True},
            'body is a frame that comes on /tf; set frame_prefix',
        ),
    ],
)
def test_what_does_not_go_with_poses_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        settings_from(values)


def test_one_type_is_recognized_by_itself_and_others_have_to_be_named(tmp_path: Path) -> None:
    bag = tmp_path / 'pose.mcap'
    simulate(FOUR_BAR, bag, duration=0.5, message='pose_stamped')
    assert replay(bag, Settings()).estimates > 50
    with pytest.raises(ParameterError, match='a PoseStamped has no names'):
        replay(bag, Settings(bodies={'body': ('0', '1')}))
    check_poses(Settings(), 'pose_stamped')
    simulate(FOUR_BAR, bag, duration=0.5, message='tf')
    with pytest.raises(BagError, match='set it to tf, and name the frame of each body'):
        replay(bag, Settings(), topic='/tf')
    with BagWriter(bag) as writer:
        writer.add_topic('/markers', INPUT_TYPES['body_poses'])
    with pytest.raises(BagError, match='set it to pose_array or body_poses or auto'):
        replay(bag, Settings(marker_type='pose_stamped'))
