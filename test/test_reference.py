"""Reference points: which point of a body is differentiated, and what that is good for."""

from dataclasses import replace

import numpy as np
import pytest
from stretches import instants

from bench import _record
from kinpole_ros.derivatives import Poses, Windows, derive_poses
from kinpole_ros.messages import result_outputs
from kinpole_ros.planar._poles import rotation_coefficient
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.bodies import new_bodies
from kinpole_ros.tracking.center import find_hubs
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings('error')

STEP = 5_000_000
NAMES = ('a', 'b', 'c', 'd')
VALUES = {'bodies': ['rod'], 'rod.markers': list(NAMES), 'window': 0.5, 'lag': 0.1}
ARMS = 0.1 * np.exp(2j * np.pi * np.array([0.0, 0.2, 0.45, 0.8]))
# Where the hub is from the middle of the markers.
HUB = 0.3 - 0.1j


def frames(angle: np.ndarray, hub: np.ndarray, noise: float = 1e-4) -> MarkerFrames:
    """A body at an angle whose hub goes along a path (N,)."""
    rng = np.random.default_rng(0)
    flat = hub[:, None] + (ARMS - ARMS.mean() - HUB) * np.exp(1j * angle)[:, None]
    flat = flat + noise * (rng.normal(size=(*flat.shape, 2)) @ (1, 1j))
    points = np.zeros((*flat.shape, 3))
    points[..., 0], points[..., 1] = flat.real, flat.imag
    return MarkerFrames(10**18 + STEP * np.arange(len(angle)), 'world', NAMES, points)


def rolling(count: int = 1000) -> MarkerFrames:
    """Eight times round in five seconds, the hub straight on."""
    time = STEP * 1e-9 * np.arange(count)
    return frames(10 * time, 0.7 * time + 0j)


def followed(seen: MarkerFrames) -> list[Estimate]:
    return instants(Tracker(settings_from(VALUES)).add(seen, 3))


def test_the_hub_of_a_wheel_stands_for_it() -> None:
    found = followed(rolling())
    # Its frame has the axes of the ground in the first frame, at its own angle then.
    assert found[0].reference[0] == 0
    assert found[-1].reference[0] == pytest.approx(HUB, abs=1e-4)


@pytest.mark.parametrize('late', [5e-4, 1e-3, 3e-3])
@pytest.mark.parametrize('seed', [0, 1])
def test_the_hub_is_found_as_soon_by_stamps_that_are_late(late: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Three windows, one before the clock is known, and until what was learned is made use of.
    seen = rolling(500)
    kept = rng.random(500) > 0.02
    stamps = seen.stamps[kept] + np.rint(1e9 * rng.exponential(late, kept.sum())).astype(np.int64)
    stamps = np.maximum.accumulate(stamps) + np.arange(len(stamps))
    found = followed(seen._replace(stamps=stamps, points=seen.points[kept]))
    assert found[-1].reference[0] == pytest.approx(HUB, abs=5e-4)


def test_the_hub_is_found_where_the_body_is_often_not_seen() -> None:
    seen = rolling(460)
    seen.points[np.random.default_rng(1).random(460) < 0.2] = np.nan
    assert followed(seen)[-1].reference[0] == pytest.approx(HUB, abs=2e-4)


@pytest.mark.parametrize('count', [1, 3, None])
def test_a_wheel_that_is_elsewhere_for_a_frame_or_from_now_on_keeps_its_hub(
    count: int | None,
) -> None:
    seen = rolling(1400)
    seen.points[1040 : None if count is None else 1040 + count, :, 1] += 3.0
    found = followed(seen)
    assert found[1000].reference[0] == pytest.approx(HUB, abs=1e-4)
    # Not even in a window that holds the jump.
    assert all(e.reference[0] == pytest.approx(HUB, abs=1e-4) for e in found[1000:])


@pytest.mark.parametrize(
    ('motion', 'noise', 'without', 'gains'),
    [
        ('fast rotation', 1e-5, (0.0897, 0.130, 0.342), (1.7, 2.5, 3)),
        ('fast rotation', 1e-3, (0.0615, 0.0560, 0.130), (1.7, 2.5, 3)),
        ('rolling wheel', 1e-5, (0.0855, 0.445, 1.65), (1.4, 2.5, 4)),
        ('rolling wheel', 1e-3, (0.0617, 0.142, 0.932), (1.4, 2.5, 4)),
    ],
)
def test_poles_of_what_turns_about_a_point_are_better_known(
    motion: str, noise: float, without: tuple[float, ...], gains: tuple[float, ...]
) -> None:
    """A rotor on an orbit and a wheel; `without` are the errors over the noise without a hub."""
    recording = _record.make_recording((motion,), (noise,), 3, 9.0)
    late = slice(700, None)
    found = _record.measure(recording)
    for name, other, gain in zip(_record.POLES, without, gains, strict=True):
        assert found.determined[name][late].all()
        # Of chi-square with 2 degrees of freedom 95% are below 6.
        assert (found.squares[name][late] < 5.991).mean() > 0.9, name
        errors = np.abs(found.values[name] - recording.truth[name][found.frames])[late]
        assert np.sqrt(np.mean(errors**2)) < noise * other / gain


@pytest.mark.parametrize('noise', [1e-4, 1e-3])
def test_a_window_that_turns_about_a_point_has_its_hub_whatever_the_angle_does(
    noise: float,
) -> None:
    """The rate jumps between 4 and 9 rad/s about a point that moves on a line, at 60 Hz."""
    rng, time = np.random.default_rng(4), np.arange(300) / 60
    turned, rest = np.divmod(time, 1.0)
    angle = 6.5 * turned + np.where(rest < 0.5, 4 * rest, 2 + 9 * (rest - 0.5))
    arm, velocity, one = 0.15 - 0.05j, 0.2 + 0.1j, np.ones((300, 1))
    position = velocity * time - arm * np.exp(1j * angle)
    position = position + 0.1 * noise * (rng.normal(size=(300, 2)) @ (1, 1j))
    measured = angle + noise * rng.normal(size=300)
    poses = Poses(
        np.arange(300) * 10**9 // 60, measured[:, None], 0 * one, position[:, None], one, 100 * one
    )
    newest = np.arange(60, 300)
    windows = Windows(newest - 6, newest - 30, newest)
    none = np.zeros((240, 1), int)
    found = derive_poses(poses, windows, none, np.full((240, 1), noise), 0.5, 2)
    assert (found.reference != 0).mean() > 0.9
    assert np.median(np.abs(found.reference - arm)) < noise
    truth = np.where(time[windows.now] % 1.0 < 0.5, 4.0, 9.0)
    inside = np.abs(time[windows.now] % 0.5 - 0.25) < 0.2
    icr = found.position[0, :, 0] + 1j * found.position[1, :, 0] / found.angle[1, :, 0]
    off = icr - velocity * (time[windows.now] + 1j / truth)
    assert np.sqrt(np.mean(np.abs(off[inside]) ** 2)) < 0.3 * noise


@pytest.mark.parametrize('motion', ['four-bar coupler', 'two sines', 'stop and go', 'dead point'])
def test_what_turns_about_no_point_of_its_own_gets_no_hub(motion: str) -> None:
    """A window of it may turn about a point."""
    recording = _record.make_recording((motion,), _record.NOISES, 2, 6.0)
    shown, settings = _record.frames_of(recording.points, _record.stamps_of(len(recording.points)))
    tracker = Tracker(settings)
    found = tracker.add(shown, 3)
    assert not tracker.state.bodies.hub.any()
    assert np.mean([one.reference != 0 for one in found]) < 0.02


@pytest.mark.parametrize('noise', [0.0, 1e-4])
def test_a_body_at_rest_or_carried_along_keeps_its_origin(noise: float) -> None:
    time = STEP * 1e-9 * np.arange(600)
    for path in (0 * time + 1j, np.sin(9 * time) + 1j * np.cos(5 * time)):
        assert not followed(frames(0 * time, path, noise))[-1].reference.any()


def test_the_origin_stays_where_it_is_whatever_point_is_differentiated() -> None:
    found = followed(rolling())
    stamps = np.array([estimate.stamp for estimate in found])
    at = (stamps - 10**18) * 1e-9
    turn = np.exp(10j * at)
    place, speed = 0.7 * at - HUB * turn, 0.7 - 10j * HUB * turn
    jerk = 1000j * HUB * turn
    assert len(found) > 900
    # The body's frame begins at the mean of the markers as they are seen.
    start = found[0].origin(0)[0] - place[0]
    late = slice(600, None)
    for order, exact, allowed in ((0, place, 3e-4), (1, speed, 4e-3), (3, jerk, 5.0)):
        seen = np.array([estimate.origin(order)[0] for estimate in found])
        if order == 0:
            seen = seen - start
        assert np.abs(seen - exact)[late].max() < allowed


def test_whatever_point_stands_for_a_body_the_figures_are_the_same() -> None:
    rng = np.random.default_rng(4)
    shape = 4, 3, 2
    position, angle = rng.normal(size=(*shape, 2)) @ (1, 1j), rng.normal(size=shape)
    reference = rng.normal(size=(*shape[1:], 2)) @ (1, 1j)
    arm = reference * np.exp(1j * angle[0])
    moved = [position[0] + arm]
    moved += [position[k] + rotation_coefficient(k, angle) * arm for k in (1, 2, 3)]
    arrays = {
        'stamp': np.arange(3),
        'position': position,
        'angle': angle,
        **dict.fromkeys(('position_covariance', 'angle_covariance'), np.zeros((4, *shape))),
        **dict.fromkeys(('size', 'height', 'span', 'degree'), np.ones(shape[1:])),
    }
    names = ('rod', 'other')
    one = Estimate.of_arrays(arrays, 'world', names)
    shifted = arrays | {'position': np.array(moved), 'reference': reference}
    other = Estimate.of_arrays(shifted, 'world', names)
    for order in range(4):
        np.testing.assert_allclose(other.origin(order), one.origin(order), rtol=1e-9)
        np.testing.assert_array_equal(one.origin(order), position[order])
    for order in (1, 2, 3):
        np.testing.assert_allclose(other.pole(order).value, one.pole(order).value, rtol=1e-9)
    curvatures = other.centrode_curvature.value, one.centrode_curvature.value
    np.testing.assert_allclose(*curvatures, rtol=1e-6)
    np.testing.assert_allclose(other.relative_icr.value, one.relative_icr.value, rtol=1e-9)
    (odometry,) = [row for row in result_outputs(names, 'xy') if row.topic == 'rod/odom']
    pairs = list(zip(odometry.build(other)[1], odometry.build(one)[1], strict=True))
    assert len(pairs) == 3
    # A message ends in 7 numbers of the pose, 6 of the twist, and 36 of the covariance of each.
    numbers = [[np.frombuffer(data[-680:]) for data in messages] for messages in pairs]
    for found, expected in numbers:
        for part in (slice(7), slice(43, 49)):
            np.testing.assert_allclose(found[part], expected[part], atol=1e-9)


def test_a_body_that_turns_about_another_point_from_now_on_is_seen_to() -> None:
    time = STEP * 1e-9 * np.arange(2000)
    angle, other = 10 * time, 0.2j
    # From five seconds on it is the other point that goes straight on.
    turned = np.exp(1j * np.maximum(angle, 50)) - np.exp(50j)
    found = followed(frames(angle, 0.7 * time + (HUB - other) * turned))
    points = np.array([estimate.reference[0] for estimate in found])
    stamps = np.array([estimate.stamp for estimate in found])
    seconds = (stamps - 10**18) * 1e-9
    assert points[seconds < 4.8][-1] == pytest.approx(HUB, abs=1e-3)
    # The origin stands for the body in between, after two windows at most.
    assert points[seconds < 6.1][-1] == 0
    assert points[-1] == pytest.approx(other, abs=1e-3)


def test_reference_points_are_the_same_however_frames_are_handed_over() -> None:
    seen = rolling(500)
    rng = np.random.default_rng(3)
    hidden = rng.random((500, 4)) < 0.03
    seen.points[hidden] = np.nan
    whole = followed(seen)
    tracker, found = Tracker(settings_from(VALUES)), []
    first = 0
    while first < 500:
        count = int(rng.integers(1, 9))
        found += instants(tracker.add(part_of(seen, slice(first, first + count)), 3))
        first += count
    assert abs(found[-1].reference[0]) > 0.2
    for one, other in zip(found, whole, strict=True):
        np.testing.assert_allclose(one.reference, other.reference, rtol=1e-9)
        np.testing.assert_allclose(one.angle, other.angle, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(one.position, other.position, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(one.position_covariance, other.position_covariance, rtol=1e-7)


def hubs_of(angle: np.ndarray, position: np.ndarray, of_angle: float = 1e-6) -> np.ndarray:
    """The hubs (B,) found from poses (N, B), with that standard deviation of the angles."""
    count = angle.shape[1]
    bodies = replace(new_bodies(count, 2), misfit=np.full(count, of_angle**2))
    history = History(count, 2)
    for _ in range(len(angle)):
        history.reserve(1)
        history.end += 1
    history['time'][...] = STEP * np.arange(len(history))
    for name, values in (('angle', angle), ('position', position)):
        history[name][...] = np.nan
        history[name][: len(angle)] = values
    history['information'][...] = 0.0
    history['information'][: len(angle), 0] = history['information'][: len(angle), 1] = np.where(
        np.isnan(angle), 0.0, 1.0
    )
    history['information'][:, 1] *= 1e6
    return find_hubs(bodies, history, 500_000_000, np.zeros(angle.shape[1], complex))


def test_a_body_not_seen_leaves_the_others_as_they_are() -> None:
    turned = 10e-9 * STEP * np.arange(600)
    angle = np.stack((turned, np.full(600, np.nan)), axis=1)
    assert hubs_of(angle, 1 - HUB * np.exp(1j * angle)) == pytest.approx([HUB, 0], abs=1e-9)


def test_noise_of_the_angle_draws_a_reference_point_no_nearer() -> None:
    """A fit without regard to it does, by the noise over what turns: 2% here."""
    rng = np.random.default_rng(1)
    count, bodies, sigma = 1000, 300, 0.03
    angle = 0.3 * np.sin(20 * STEP * 1e-9 * np.arange(count))[:, None] * np.ones(bodies)
    position = -HUB * np.exp(1j * angle)
    found = hubs_of(angle + sigma * rng.normal(size=angle.shape), position, sigma)
    assert np.count_nonzero(found) == bodies
    assert abs(found.mean() - HUB) < 0.2 * 0.02 * abs(HUB)
