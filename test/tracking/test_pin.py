"""Bodies on pins are recognized as such, others are not, and what is done with it is right."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from recordings import PINNED, START, STEP, follow, record
from stretches import instants, joined, one_frame

from bench._motions import motions, still_turning
from kinpole_ros.mechanism import BodyMotion, marker_positions
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.reasons import TABLE
from kinpole_ros.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings('error')

MARKERS = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])
# Residuals of bodies that are rigid, (T, 1, n).
RIGID = np.zeros((60, 1, 4), complex)
SIZE = 2 * np.sqrt((MARKERS**2).sum(axis=1).mean())


def seen(
    motion: Any, count: int, noise: float = 0.0, seed: int = 0, markers: np.ndarray = MARKERS
) -> list[MarkerFrames]:
    """A body that moves by `motion`, seen at 200 Hz with noise, m."""
    points = marker_positions(motion(np.arange(count) / 200), markers)
    points = points + noise * np.random.default_rng(seed).normal(size=points.shape)
    solid = np.concatenate((points, np.zeros((*points.shape[:2], 1))), axis=2)
    return [
        one_frame(START + k * STEP, 'world', tuple('abcdefgh'[: len(markers)]), rows)
        for k, rows in enumerate(solid)
    ]


def about(center: complex, arm: complex, angle: Any) -> Any:
    """A motion about a pin: only the pose is right, its derivatives are not needed."""

    def motion(t: np.ndarray) -> BodyMotion:
        turned = angle(t)
        place = center - arm * np.exp(1j * turned)
        return BodyMotion(np.stack([place] * 5), np.stack([turned] * 5))

    return motion


def tracked(frames: list[MarkerFrames], order: int = 1, **values: Any) -> list[Estimate]:
    """What a tracker finds of frames all at once, by instant."""
    return instants(Tracker(settings_from(values)).add(joined(frames), order))


def recognized(frames: list[MarkerFrames], **values: Any) -> np.ndarray:
    """Whether the body is called pinned, by estimate."""
    return np.array([estimate.pinned[0] for estimate in tracked(frames, **values)])


def ever_taken(frames: list[MarkerFrames]) -> bool:
    """Whether the body is ever thought to be pinned."""
    tracker, first = Tracker(settings_from({})), 0
    while first < len(frames):
        # Pins come and go at beats, of which there is one in so many frames.
        last = first + 64
        tracker.add(joined(frames[first:last]), None)
        if np.isfinite(tracker.state.bodies.pin[0]):
            return True
        first = last
    return False


@pytest.mark.parametrize('count', [20, 200])
def test_a_body_stays_on_its_pin_while_hidden_markers_hide_its_angle(count: int) -> None:
    """What is left of it is 5 mm long, so that the angle has 20 times the noise."""
    markers = np.array([(0.09, 0.02), (-0.08, -0.05), (0.05, 0.03), (0.055, 0.03)])
    swinging = about(0.3 + 0.1j, 0.1 + 0j, lambda t: 1.2 * np.sin(np.pi * t))
    frames = seen(swinging, 1000, 1e-4, markers=markers)
    for frame in frames[600 : 600 + count]:
        frame.points[:, :2] = np.nan
    assert recognized(frames)[500:].all()


@pytest.mark.parametrize('noise', [0.0, 1e-5, 1e-3])
def test_cranks_and_rockers_are_pinned_and_couplers_are_not(noise: float) -> None:
    scene = record('four_bar', count=700, noise=noise * 0.2)
    found = follow(scene.frames, scene.values, order=4, every=20)[1]
    last = found[-1]
    assert [last.motion(b) for b in range(3)] == [
        'pinned' if body in PINNED else 'general' for body in last.bodies
    ]
    truth = scene.truth([estimate.stamp for estimate in found])
    for b, body in enumerate(last.bodies):
        pinned = np.array([estimate.pinned[b] for estimate in found])
        if body not in PINNED:
            assert not pinned.any()
            continue
        position, angle = truth[body]
        pivot = (position[0] + 1j * position[1] / angle[1])[0]
        assert pinned[-10:].all()
        for order in range(1, 5):
            poles = [e.pole(order) for e, on in zip(found, pinned, strict=True) if on]
            values = np.array([p.value[b] for p in poles if p.determined[b]])
            assert len(values) > 0.75 * len(poles)
            assert np.abs(values - pivot).max() < (1e-9 + 2 * noise) * last.size[b]
        assert last.icr_velocity.value[b] == 0
        assert 'pinned' in last.reasons(b)['centrode_curvature']


def fixed_centers(motion: dict[str, BodyMotion]) -> set[str]:
    """Names of the bodies whose exact ICR stays within 1 nm."""
    fixed = set()
    for body, (position, angle) in motion.items():
        turning = np.abs(angle[1]) > 0.1 * np.abs(angle[1]).max()
        icr = (position[0] + 1j * position[1] / angle[1])[turning]
        if np.abs(icr - icr[0]).max() < 1e-9:
            fixed.add(body)
    return fixed


@pytest.mark.parametrize('noise', [1e-4, 5e-4])
@pytest.mark.parametrize('name', ['eight_bar', 'six_bar', 'loader_cylinder', 'trebuchet'])
def test_no_link_without_a_fixed_center_is_called_pinned(name: str, noise: float) -> None:
    """An ICR velocity that is lost in its noise at one instant is no evidence of a pin."""
    scene = record(name, count=600, noise=noise)
    estimates = follow(scene.frames, scene.values, order=3, every=20)[1]
    fixed = fixed_centers(scene.truth(range(START, START + 600 * STEP, STEP)))
    links = estimates[0].bodies
    assert not fixed.issuperset(links)
    for b, body in enumerate(links):
        reasons = [one.reasons(b).get('centrode_curvature', '') for one in estimates]
        assert body in fixed or TABLE['ON_PIN'].text not in reasons


@pytest.mark.parametrize('noise', [1e-5, 1e-3, 1e-2])
@pytest.mark.parametrize('name', motions())
def test_no_general_motion_is_taken_for_a_turn_about_a_pin(name: str, noise: float) -> None:
    motion = motions()[name]
    points = marker_positions(motion.motion(np.arange(1600) / 200), motion.markers)
    points += noise * motion.size * np.random.default_rng(1).normal(size=points.shape)
    solid = np.concatenate((points, np.zeros((*points.shape[:2], 1))), axis=2)
    names = tuple('abcd'[: points.shape[1]])
    frames = [one_frame(START + k * STEP, 'world', names, rows) for k, rows in enumerate(solid)]
    assert not ever_taken(frames)


@pytest.mark.parametrize('orbit', [0.1, 0.03, 0.01])
def test_an_icr_on_a_small_circle_is_no_pin(orbit: float) -> None:
    frames = seen(lambda t: still_turning(t, 3.0, orbit * SIZE), 1600, 1e-3 * SIZE)
    assert not ever_taken(frames)


def test_what_passes_for_a_pin_is_one_within_the_noise_it_states() -> None:
    frames = seen(lambda t: still_turning(t, 3.0, 0.005 * SIZE), 1600, 1e-2 * SIZE)
    found = [e for e in tracked(frames) if e.pinned[0]]
    assert found
    for estimate in found:
        true = still_turning((np.array([estimate.stamp]) - START) * 1e-9, 3.0, 0.005 * SIZE)
        icr = (true.position[0] + 1j * true.position[1] / true.angle[1])[0]
        # The circle of the ICR is below the noise of a single frame.
        assert abs(estimate.pole(1).value[0] - icr) < 0.01 * SIZE


def test_a_slow_hinge_is_recognized_as_surely_as_a_fast_one() -> None:
    for rate in (0.4, 4.0, 40.0):
        count = int(6.0 / rate * 200) + 200
        motion = about(0.3 + 0.2j, 0.1 - 0.05j, lambda t, w=rate: w * t)
        tracker = Tracker(settings_from({}))
        tracker.add(joined(seen(motion, count, 1e-4)), None)
        assert np.isfinite(tracker.state.bodies.pin[0]), rate


def test_a_hinge_at_rest_stays_one_and_has_no_poles() -> None:
    motion = about(0.3 + 0.2j, 0.1 + 0j, lambda t: 3.0 * np.minimum(t, 2.0))
    found = tracked(seen(motion, 700, 1e-4), order=2)
    assert found[-1].pinned[0]
    assert found[-1].motion(0) == 'still'
    assert not found[-1].pole(1).determined[0]
    assert found[-1].reasons(0)['icr'] == 'no rotation'


@pytest.mark.parametrize('seed', range(3))
def test_a_pin_is_found_and_kept_while_markers_come_and_go(seed: int) -> None:
    ring = np.exp(2j * np.pi * np.arange(8) / 8)
    markers = 0.1 * np.stack((ring.real, ring.imag), axis=1)
    frames = seen(about(0.3 + 0.2j, 0.3, lambda t: 2.0 * t), 1600, 1e-4, seed, markers)
    for k, frame in enumerate(frames):
        if k // 40 % 2:
            frame.points[:, 3:] = np.nan
    tracker = Tracker(settings_from({}))
    tracker.add(joined(frames[:800]), None)
    for frame in frames[800:]:
        assert np.isfinite(tracker.state.bodies.pin[0])
        tracker.add(frame, None)
    bodies = tracker.state.bodies
    assert np.abs(bodies.pin[0] - (0.3 + 0.2j)) < 4 * np.sqrt(bodies.pin_variance[0])


@pytest.mark.filterwarnings('error')
def test_a_body_whose_origin_does_not_move_at_all_is_on_a_pin() -> None:
    angle = np.linspace(0, 4, 60)
    *_, bodies = poses(angle, np.full(60, 0.25 + 0.5j), 1e-5, 0)
    assert bodies.pin[0] == pytest.approx(0.25 + 0.5j, abs=1e-4)


def test_a_body_that_leaves_its_pin_is_told_of_at_once() -> None:
    def motion(t: np.ndarray) -> BodyMotion:
        on = about(0.3 + 0.2j, 0.1 + 0j, lambda t: 3.0 * t)(t)
        gone = np.maximum(t - 3.0, 0.0)
        on.position[:] += 0.5 * gone
        return on

    frames = seen(motion, 900, 1e-4)
    found = tracked(frames, lag=0.1)
    pinned = {(e.stamp - START) // STEP: bool(e.pinned[0]) for e in found}
    # 0.5 m/s leaves the noise within a few frames, which lie ahead of the instant that is told.
    assert pinned[570]
    assert not any(on for frame, on in pinned.items() if frame >= 590)


@pytest.mark.parametrize('bad', [1, 2])
def test_a_frame_or_two_off_its_place_leaves_a_body_on_its_pin(bad: int) -> None:
    motion = about(0.3 + 0.2j, 0.1 + 0j, lambda t: 3.0 * t)
    frames = seen(motion, 900, 1e-4)
    for k in range(600, 600 + bad):
        frames[k] = frames[k]._replace(points=frames[k].points + 0.05)
    found = recognized(frames)
    assert found[-300:].all()


def poses(
    angle: np.ndarray, place: np.ndarray, noise: float, seed: int, beat: int = 1
) -> Iterator[Bodies]:
    """The pins after so many frames each of a body of size 0.2 at poses (N,), with that noise."""
    shape = 0.1 * np.exp(0.5j * np.pi * np.arange(4))
    flat = place[:, None] + np.exp(1j * angle)[:, None] * shape
    flat = flat + noise * (np.random.default_rng(seed).normal(size=(*flat.shape, 2)) @ (1, 1j))
    solid = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    frames = MarkerFrames(START + STEP * np.arange(len(angle)), 'world', tuple('abcd'), solid)
    tracker = Tracker(settings_from({'stamps': 'capture'}))
    for first in range(0, len(angle), beat):
        tracker.add(part_of(frames, slice(first, first + beat)), None)
        tracker.learn_if_due()
        yield tracker.state.bodies


@pytest.mark.parametrize('noise', [1e-3, 4e-3, 1.6e-2])
def test_an_icr_that_wanders_is_no_pin_while_the_noise_would_hide_it(noise: float) -> None:
    """By a tenth of the body's size per rad: an arc of 2 rad about a point is off it by little."""
    angle, wander = 0.07 * np.arange(60), 0.02
    place = wander * (angle - 1j) - 0.15 * np.exp(1j * angle)
    assert not any(np.isfinite(bodies.pin[0]) for bodies in poses(angle, place, noise, 0))


@pytest.mark.parametrize('orbit', np.geomspace(1e-4, 4e-3, 6))
def test_nothing_flaps(orbit: float) -> None:
    # An orbit about as small as a frame's noise: whether it is one is hardest to tell.
    t = np.arange(4000) / 200
    place = orbit * np.exp(2j * np.pi * 0.7 * t)
    held = [np.isfinite(bodies.pin[0]) for bodies in poses(3.0 * t, place, 4e-4, 0)]
    assert np.abs(np.diff(np.array(held, int))).sum() <= 5


@pytest.mark.parametrize(('speed', 'count'), [(3.0, 420), (40.0, 36)], ids=['all', 'some'])
def test_the_stated_deviation_of_a_pin_is_its_error(speed: float, count: int) -> None:
    """With as many poses as are kept, and with fewer."""
    angle = speed * np.arange(count) / 200
    squares = []
    for seed in range(30):
        *_, bodies = poses(angle, 0.4 - 0.15 * np.exp(1j * angle), 1e-3, seed, beat=12)
        squares.append(np.abs(bodies.pin[0] - 0.4) ** 2 / bodies.pin_variance[0] / 2)
    assert np.isfinite(squares).sum() > 25
    # Thirty draws of a chi-square of 2 over 2 have a mean within 0.18 of 1, two times in three.
    assert 0.6 < np.nanmean(squares) < 1.5


def test_the_deviation_of_a_pin_holds_where_a_marker_slips_with_the_turn() -> None:
    """It comes again in every swing: no number of poses averages it out."""
    t = np.arange(1000) / 200
    swinging = about(0.4 + 0j, 0.2 + 0.1j, lambda t: 0.5 * np.sin(2 * np.pi * t))(t)
    off, pinned = [], []
    for seed, way in enumerate(np.linspace(0, np.pi, 12, endpoint=False)):
        points = marker_positions(swinging, MARKERS[:3])
        points += 2e-4 * np.random.default_rng(seed).normal(size=points.shape)
        by = 2e-3 * np.sin(2 * np.pi * t) * np.exp(1j * (way + swinging.angle[0]))
        points[:, 0] += np.stack((by.real, by.imag), axis=-1)
        solid = np.concatenate((points, np.zeros((*points.shape[:2], 1))), axis=2)
        stamps = START + STEP * np.arange(len(t))
        frames = MarkerFrames(stamps, 'world', tuple('abc'), solid)
        (found,) = Tracker(settings_from({})).add(frames, 1)
        pinned.append(found.pinned[-1, 0])
        pole = found.pole(1)
        off.append(abs(pole.value[-1, 0] - 0.4) ** 2 / pole.covariance[-1, 0, 0, 0])
    assert np.mean(pinned) > 0.6
    assert np.mean(np.array(off) < 5.99) >= 0.9
    assert max(off) < 25
