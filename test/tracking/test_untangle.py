"""A marker that jumps, two that change places, a mirrored body: mended, counted, and harmless."""

import functools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stretches import follow, instants, one_frame

import kinpole_ros
from kinpole_ros.mechanism import load_scene, marker_positions
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.consensus import consensus_shape
from kinpole_ros.tracking.correction import correct_markers
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.identity import unpredicted
from kinpole_ros.tracking.tracker import Tracker

SCENE = load_scene('four_bar')
NAMES = tuple(name for body in SCENE.markers for name in SCENE.marker_names[body])
COUNT, RATE = 400, 200
BAD = 200  # the frame that is spoiled
COUPLER = slice(3, 7)


def track(
    spoil: Callable[[np.ndarray], object] | None, noise: float = 2e-4, /, **values: object
) -> tuple[Tracker, list]:
    motion = SCENE.motion(np.arange(COUNT) / RATE)
    flat = [marker_positions(motion[body], SCENE.markers[body]) for body in SCENE.markers]
    points = np.zeros((COUNT, len(NAMES), 3))
    points[..., :2] = np.concatenate(flat, axis=1)
    points[..., :2] += noise * np.random.default_rng(0).normal(size=(COUNT, len(NAMES), 2))
    if spoil is not None:
        spoil(points)
    markers = {f'{body}.markers': SCENE.marker_names[body] for body in SCENE.markers}
    tracker = Tracker(settings_from({'bodies': list(SCENE.markers), **markers, **values}))
    stamps = 10**9 + 10**9 // RATE * np.arange(COUNT, dtype=np.int64)
    return tracker, instants(tracker.add(MarkerFrames(stamps, 'world', NAMES, points), 3))


def errors(found: list[Estimate]) -> dict[int, np.ndarray]:
    """Errors (3, B) of angular velocity, acceleration and jerk, by frame."""
    frames = [round((estimate.stamp - 10**9) * RATE / 10**9) for estimate in found]
    motion = SCENE.motion(np.array(frames) / RATE)
    truth = np.stack([motion[body].angle[1:4] for body in SCENE.markers], axis=-1)
    return {
        f: e.angle[1:4] - truth[:, k] for k, (f, e) in enumerate(zip(frames, found, strict=True))
    }


@functools.cache
def straight_track(noise: float = 2e-4) -> list[Estimate]:
    """What is found where nothing is spoiled."""
    return track(None, noise)[1]


@pytest.fixture(scope='module')
def clean() -> dict[int, np.ndarray]:
    return errors(straight_track())


def jump(points: np.ndarray) -> None:
    points[BAD, 4, 0] += 0.05


def two_jump(points: np.ndarray) -> None:
    points[BAD, [3, 5], 0] += [0.05, -0.08]


def swap(points: np.ndarray) -> None:
    points[BAD : BAD + 5, [3, 5]] = points[BAD : BAD + 5, [5, 3]]


def mirror(points: np.ndarray) -> None:
    points[BAD : BAD + 3, COUPLER, 1] *= -1


def scatter(points: np.ndarray) -> None:
    points[BAD, COUPLER, :2] += np.random.default_rng(1).normal(size=(4, 2)) * 0.1


def lose(points: np.ndarray) -> None:
    points[BAD:, 4] = np.nan


@pytest.mark.parametrize(
    ('spoil', 'counted', 'times'),
    [
        (jump, 'markers_left_out', 1),
        (two_jump, 'markers_of_misfits', 4),
        (swap, 'markers_exchanged', 10),
        (mirror, 'markers_mirrored', 12),
        (scatter, 'markers_of_misfits', 4),
        (lose, 'markers_not_seen', COUNT - BAD),
    ],
)
def test_what_goes_wrong_is_named_and_costs_little(
    spoil: Callable[[np.ndarray], None], counted: str, times: int, clean: dict[int, np.ndarray]
) -> None:
    tracker, found = track(spoil)
    mended = {
        key: count for key, count in tracker.update_counts().items() if count and key != 'frames'
    }
    assert mended == {counted: times}
    spoiled = errors(found)
    before = [f for f in clean if f < BAD - 25]
    near = [f for f in clean if BAD - 25 <= f < BAD + 70 and f in spoiled]
    for frame in before:
        assert np.array_equal(spoiled[frame], clean[frame])
    with np.errstate(invalid='ignore'):
        rms, usual = (
            np.sqrt(np.nanmean([np.square(some[f]) for f in near], axis=0))
            for some in (spoiled, clean)
        )
    # The crank turns evenly: its acceleration has no error to compare with.
    assert (rms[:, 1:] <= 3 * usual[:, 1:]).all()


def test_two_that_change_places_leave_no_trace(clean: dict[int, np.ndarray]) -> None:
    spoiled = errors(track(swap)[1])
    assert all(np.array_equal(spoiled[frame], clean[frame]) for frame in clean)


def test_a_body_of_two_markers_is_left_out_for_the_frame() -> None:
    tracker, found = track(jump, **{'coupler.markers': ['coupler_1', 'coupler_2']})
    assert tracker.update_counts()['markers_of_misfits'] == 2
    stamps = {estimate.stamp: estimate for estimate in found}
    bad = stamps[10**9 + BAD * (10**9 // RATE)]
    assert [bool(text) for text in bad.missing] == [False, True, False]


def test_a_marker_that_was_moved_for_good_is_learned_anew() -> None:
    def knock(points: np.ndarray) -> None:
        points[BAD:, 4, :2] = points[BAD:, 3, :2] + 0.7 * (
            points[BAD:, 5, :2] - points[BAD:, 3, :2]
        )

    tracker, _ = track(knock)
    # Left out for a while, then taken at its new place.
    assert 100 <= tracker.update_counts()['markers_left_out'] < 100 + 64
    assert tracker.noise()[1] < 4e-4


def test_with_noise_an_exchange_of_five_frames_changes_no_figure() -> None:
    _, found = track(swap)
    straight = straight_track()
    for one, other in zip(found, straight, strict=True):
        assert np.allclose(one.angle, other.angle, rtol=1e-9, equal_nan=True)


def test_heights_go_with_the_markers_that_are_exchanged() -> None:
    """A height that was NaN beside a marker that was not ended diagnostics with an error."""
    heights = np.array([0.01, 0.02, 0.03, 0.04])

    def spoil(points: np.ndarray) -> None:
        points[:, COUPLER, 2] = heights
        points[BAD:, [4, 5]] = points[BAD:, [5, 4]]
        points[BAD + 50 :, 4] = np.nan

    tracker, _ = track(spoil)
    assert tracker.update_counts()['markers_exchanged'] > 0
    coupler = list(SCENE.markers).index('coupler')
    markers, known = (tracker.state.history[name][:, coupler] for name in ('markers', 'heights'))
    seen = ~np.isnan(markers)
    assert not seen[-1].all()
    assert (np.where(seen, known, heights) == heights).all()
    assert np.isfinite(tracker.space().size).all()


def test_figures_go_on_as_they_were_when_two_markers_are_exchanged_for_good() -> None:
    def swapped(points: np.ndarray) -> None:
        points[150:, [3, 5]] = points[150:, [5, 3]]

    tracker, found = track(swapped)
    assert 200 <= tracker.update_counts()['markers_exchanged'] < 300
    straight, truth = straight_track(), errors(found)
    usual = np.sqrt(np.nanmean(np.square(list(errors(straight).values())), axis=0))
    off = [abs(truth[frame] - error) for frame, error in errors(straight).items() if frame > 150]
    assert (np.max(off, axis=0)[:, 1] < 0.1 * usual[:, 1]).all()


# --- what is left of a fault later --------------------------------------------------------------


@pytest.mark.parametrize('spoil', [jump, swap, lose])
def test_without_noise_a_fault_changes_no_figure(spoil: Callable[[np.ndarray], None]) -> None:
    straight = straight_track(0.0)
    tracker, found = track(spoil, 0.0)
    assert sum(tracker.update_counts().values()) > COUNT  # something was seen to be wrong
    truth = SCENE.motion(np.arange(COUNT) / RATE)
    # Inside the window too: to 1e-9 of what the derivative comes to, or of what it would come to in
    # a motion as fast as the body turns, where it is always zero.
    most = np.stack([np.abs(truth[body].angle[:4]).max(axis=1) for body in SCENE.markers], axis=1)
    allowed = 1e-9 * np.maximum(most, most[1] ** np.arange(4)[:, None])
    for one, other in zip(straight, found, strict=True):
        assert (np.isnan(one.angle) == np.isnan(other.angle)).all()
        assert not (np.abs(one.angle - other.angle) > allowed).any()


@pytest.mark.parametrize('spoil', [jump, two_jump])
def test_in_noise_a_fault_hardly_changes_what_comes_after_the_window(
    spoil: Callable[[np.ndarray], None], clean: dict[int, np.ndarray]
) -> None:
    spoiled = errors(track(spoil)[1])
    after = [f for f in clean if f > BAD + 120]  # a window of 100, of which 20 lie ahead
    change = np.median([np.abs(spoiled[f] - clean[f]) for f in after], axis=0)
    usual = np.sqrt(np.mean([clean[f] ** 2 for f in after], axis=0))
    assert (change[:, 1:] < 1.5e-3 * usual[:, 1:]).all()


SETTLED = 1150  # frames from which on a shape is held, a beat or two after 1,000
RECTANGLE = np.array([0.1 + 0.06j, -0.1 + 0.06j, -0.1 - 0.06j, 0.1 - 0.06j])
SIX = np.array([0.13 + 0.02j, -0.03 + 0.1j, -0.12 - 0.05j, 0.05 - 0.11j, 0.02 + 0.03j, -0.07j])
KITE = np.array([0.13 + 0.02j, -0.03 + 0.1j, -0.12 - 0.05j, 0.05 - 0.11j])


def markers(shape: np.ndarray, frames: int, turn: float = 0.03, noise: float = 1e-4) -> np.ndarray:
    """Noisy markers (frames, n) of a body that goes round and turns by `turn` rad a frame."""
    k = np.arange(frames)
    pose = 0.3 * np.exp(0.01j * k)[:, None] + np.exp(1j * turn * k)[:, None] * shape
    normal = np.random.default_rng(2).normal(size=(frames, len(shape), 2))
    return np.asarray(pose + noise * (normal @ (1, 1j)))


def fitted(points: np.ndarray) -> tuple[Tracker, np.ndarray]:
    """The tracker after all frames of one body (T, n), and its turns (T,) as they were found."""
    tracker, found = follow(points[:, None])
    turns = np.full(len(points), complex(np.nan, np.nan))
    for estimate in found:
        assert estimate.frame_poses is not None
        angle = estimate.frame_poses.angle[:, 0]
        turns[np.rint((estimate.stamp - 10**9) / 5e6).astype(int)] = np.exp(1j * angle)
    return tracker, turns


@functools.cache
def straight_turns(shape: tuple[complex, ...], frames: int, turn: float = 0.03) -> np.ndarray:
    """Turns of a body of which no marker is spoiled."""
    return fitted(markers(np.array(shape), frames, turn))[1]


def corrected(tracker: Tracker) -> dict[str, int]:
    """How many markers were corrected, by kind."""
    kinds = 'markers_exchanged', 'markers_left_out', 'markers_mirrored', 'markers_of_misfits'
    return {
        kind: int(tracker.update_counts()[kind]) for kind in kinds if tracker.update_counts()[kind]
    }


@pytest.mark.parametrize('fault', ['jump', 'mirror', 'scatter', 'hide'])
def test_a_bad_frame_leaves_no_trace_in_the_poses_of_a_settled_body(fault: str) -> None:
    bad = SETTLED + 20
    points = markers(KITE, bad + 700)
    spoiled = points.copy()
    if fault == 'jump':
        spoiled[bad, 1] += 0.05
    elif fault == 'mirror':
        spoiled[bad] = spoiled[bad].conj()
    elif fault == 'scatter':
        spoiled[bad] += [0.1, 0.2j, -0.15, 0.1j]
    else:
        spoiled[bad, 2] = np.nan
    straight = straight_turns(tuple(KITE), len(points))
    tracker, found = fitted(spoiled)
    assert (not corrected(tracker)) == (fault == 'hide')
    same = (found == straight) | (np.isnan(found) & np.isnan(straight))
    assert np.flatnonzero(~same).tolist() == [bad]


def test_figures_forget_a_bad_frame_of_a_settled_body() -> None:
    """To 1e-9 once it has left the window, the 512 frames of the noise, and the choice's means."""
    bad = SETTLED + 20
    points = markers(KITE, bad + 760)
    spoiled = points.copy()
    spoiled[bad, 1] += 0.05
    rates = []
    for rows in (points, spoiled):
        tracker, found = Tracker(settings_from({'window': 0.1, 'lag': 0.05})), []
        solid = np.stack((rows.real, rows.imag, 0 * rows.real), axis=-1)
        frames = MarkerFrames(5_000_000 * np.arange(len(rows)), 'w', tuple('abcd'), solid)
        tracker.add(part_of(frames, slice(bad - 59)), None)
        for k in range(bad - 59, len(rows)):
            found += instants(tracker.add(part_of(frames, slice(k, k + 1)), 3))
        turning = 0.03 * RATE
        rates.append([estimate.angle[:, 0] / turning ** np.arange(4) for estimate in found])
    change = np.abs(np.subtract(*rates))
    assert (change[:35] == 0).all()
    assert change[40:80].max() > 1e-6
    assert change[-50:].max() < 1e-9


def test_a_settled_shape_is_held_until_a_marker_creeps() -> None:
    points = markers(KITE, SETTLED + 3000)
    held, _ = fitted(points[: SETTLED + 10])
    tracker, _ = fitted(points[: SETTLED + 1000])
    assert np.array_equal(tracker.state.bodies.shape, held.state.bodies.shape)
    # By 30 times the noise in all, so slowly that no frame is suspect.
    creep = 3e-3 * np.clip((np.arange(len(points)) - SETTLED) / 2000, 0, 1)
    points[:, 0] += creep * np.exp(0.03j * np.arange(len(points)))
    tracker, _ = fitted(points)
    assert not corrected(tracker)
    assert np.abs(tracker.state.history['residual'][-200:]).max() < 6e-4


# --- half a turn --------------------------------------------------------------------------------


def exchange(points: np.ndarray, first: int, count: int) -> np.ndarray:
    """The markers of opposite places exchanged in `count` frames."""
    spoiled, half = points.copy(), points.shape[1] // 2
    spoiled[first : first + count] = np.roll(points[first : first + count], half, axis=1)
    return spoiled


@pytest.mark.parametrize('turn', [0.0, 0.03, -0.6])
@pytest.mark.parametrize('count', [1, 5])
@pytest.mark.parametrize('shape', [KITE[:2], RECTANGLE], ids=['two', 'rectangle'])
def test_markers_exchanged_by_half_a_turn_leave_no_trace(
    shape: np.ndarray, count: int, turn: float
) -> None:
    points = markers(shape, 140, turn)
    straight = straight_turns(tuple(shape), 140, turn)
    tracker, found = fitted(exchange(points, 90, count))
    assert corrected(tracker) == {'markers_exchanged': len(shape) * count}
    np.testing.assert_array_equal(found, straight)


@pytest.mark.parametrize('turn', [0.0, 0.03, -0.6])
@pytest.mark.parametrize('count', [1, 5, 250])
def test_of_exchanges_that_fit_alike_the_one_counts_that_goes_on(count: int, turn: float) -> None:
    """Any two markers of an equilateral triangle may be exchanged, and a turn of it fits."""
    shape = 0.1 * np.exp(2j * np.pi * np.arange(3) / 3)
    points = markers(shape, 400, turn)
    spoiled = points.copy()
    spoiled[90 : 90 + count, :2] = points[90 : 90 + count, 1::-1]
    straight = straight_turns(tuple(shape), 400, turn)
    tracker, found = fitted(spoiled)
    assert corrected(tracker)['markers_exchanged'] >= 2 * min(count, 100)
    np.testing.assert_array_equal(found, straight)


def test_names_that_go_round_a_triangle_leave_no_trace() -> None:
    """The body fits turned by a third, and nothing but its last poses tells."""
    shape = 0.1 * np.exp(2j * np.pi * np.arange(3) / 3)
    points = markers(shape, 140)
    spoiled = points.copy()
    spoiled[90:95] = np.roll(points[90:95], 1, axis=1)
    tracker, found = fitted(spoiled)
    assert corrected(tracker) == {'markers_exchanged': 15}
    np.testing.assert_array_equal(found, straight_turns(tuple(shape), 140))


def test_half_a_turn_after_a_frame_without_the_body_leaves_no_trace() -> None:
    points = markers(KITE[:2], 140)
    points[89] = np.nan
    _, straight = fitted(points)
    tracker, found = fitted(exchange(points, 90, 5))
    assert corrected(tracker) == {'markers_exchanged': 10}
    np.testing.assert_array_equal(found, straight)


def test_a_mirrored_rectangle_is_not_taken_for_one_whose_names_are_exchanged() -> None:
    points = markers(RECTANGLE, 140)
    points[90:93] = 1 + points[90:93].conj()
    assert corrected(fitted(points)[0]) == {'markers_mirrored': 12}


@pytest.mark.parametrize('shape', [KITE[:2], RECTANGLE], ids=['two', 'rectangle'])
def test_markers_exchanged_for_good_are_taken_so_and_no_pose_jumps(shape: np.ndarray) -> None:
    points = markers(shape, 400)
    straight = straight_turns(tuple(shape), 400)
    tracker, found = fitted(exchange(points, 90, 310))
    # Put back, and counted for a while.
    assert corrected(tracker) == {'markers_exchanged': 100 * len(shape)}
    np.testing.assert_array_equal(found, straight)
    # And back again, later.
    tracker, found = fitted(exchange(points, 90, 200))
    assert corrected(tracker) == {'markers_exchanged': 100 * len(shape)}
    np.testing.assert_array_equal(found, straight)


@pytest.mark.parametrize('lost', [0.0, 0.1])
@pytest.mark.parametrize('count', [3, 4])
def test_two_of_several_that_are_exchanged_for_good_are_taken_so(count: int, lost: float) -> None:
    points = markers(KITE[:count], 1400)
    points[np.random.default_rng(4).random(points.shape) < lost] = np.nan
    _, straight = fitted(points)
    spoiled = points.copy()
    spoiled[200:, [0, 1]] = spoiled[200:, [1, 0]]
    spoiled[1200] = points[1200]  # as it was at first
    spoiled[1250, 0] += 0.02
    tracker, found = fitted(spoiled)
    assert 100 <= corrected(tracker)['markers_exchanged'] / 2 < 310
    assert corrected(tracker).get('markers_left_out', 0) <= 1
    assert tracker.noise()[0] < 1.1e-4
    off = np.abs(found - straight)
    assert np.nanmax(off[350:]) < 20e-4
    assert np.nanmedian(off[350:]) < 1e-4


def rates_of_permuted(
    order: tuple[int, ...] | None, count: int, speed: float, lost: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (M,) of the rate of one body, rad/s, over 4 s, and their standard deviations."""
    t = np.arange(800) / 200
    place = 0.3 * np.exp(0.7j * speed * t)
    angle = speed * (0.8 * t + 0.5 * np.sin(2.1 * t))
    shape = SIX[: len(order or SIX)]
    rng = np.random.default_rng(4)
    flat = place[:, None] + np.exp(1j * angle)[:, None] * shape
    flat += 2e-4 * (rng.normal(size=(*flat.shape, 2)) @ (1, 1j))
    flat[rng.random(flat.shape) < lost] = np.nan
    if order is not None:
        flat[300 : 300 + count] = flat[300 : 300 + count, order]
    points = np.stack((flat.real, flat.imag), axis=-1)
    stamps = (np.arange(800) * 5_000_000).astype(np.int64)
    found = kinpole_ros.track(points, stamps, {'body': range(len(shape))}, window=0.3, lag=0.1)
    truth = speed * (0.8 + 1.05 * np.cos(2.1 * found.t))
    return found['body'].angular_velocity - truth, found['body'].angular_velocity_sigma


@pytest.mark.parametrize('speed', [1.0, 15.0])
@pytest.mark.parametrize('count', [60, 500], ids=['short', 'permanent'])
@pytest.mark.parametrize(
    'order',
    [(1, 0, 3, 2), (2, 3, 0, 1), (1, 2, 3, 0), (1, 2, 0, 3), (1, 0, 3, 2, 4), (5, 3, 4, 1, 2, 0)],
    ids=str,
)
def test_any_permutation_of_the_markers_of_a_body_costs_nothing(
    order: tuple[int, ...], count: int, speed: float
) -> None:
    """Two pairs exchanged made the rate up to 40,000 times worse."""
    straight, _ = rates_of_permuted(tuple(range(len(order))), 0, speed)
    error, deviation = rates_of_permuted(order, count, speed)
    assert np.isfinite(error).sum() == np.isfinite(straight).sum()
    assert np.sqrt(np.nanmean(error**2)) <= 1.5 * np.sqrt(np.nanmean(straight**2))
    assert np.nanmean(np.abs(error) > 5 * deviation) <= 0.002


def test_permuted_markers_are_put_back_where_some_are_hidden() -> None:
    straight, _ = rates_of_permuted(tuple(range(5)), 0, 5.0, lost=0.05)
    error, deviation = rates_of_permuted((1, 0, 3, 2, 4), 90, 5.0, lost=0.05)
    assert np.sqrt(np.nanmean(error**2)) <= 1.5 * np.sqrt(np.nanmean(straight**2))
    assert np.nanmean(np.abs(error) > 5 * deviation) <= 0.002


def test_a_marker_far_noisier_than_the_others_is_permuted_with_them() -> None:
    shape, rng = SIX[:5], np.random.default_rng(8)
    noise = np.array([1.0, 1.0, 1.0, 1.0, 12.0]) * 1e-4
    weights = 1 / np.array([1.0, 1.0, 1.0, 1.0, 144.0])
    points = 1j * shape + noise * (rng.normal(size=(5, 2)) @ (1, 1j))
    points[4] = 1j * shape[4] + 2e-3
    order = np.array([1, 4, 0, 2, 3])
    found = correct_markers(points[order], shape, weights, 6 * noise, unpredicted(1))
    assert np.array_equal(found.points, points)
    assert found.counts == {'markers_exchanged': 5}


@pytest.mark.parametrize('revolutions', [0.15, 0.25, 0.4, 0.45, 0.49])
@pytest.mark.parametrize('lost', [0.0, 0.1, 0.5])
def test_a_body_that_turns_fast_is_not_turned_back(revolutions: float, lost: float) -> None:
    points = markers(KITE[:2], 400, 2 * np.pi * revolutions)
    rng = np.random.default_rng(3)
    points = np.where(rng.random((400, 1)) < lost, np.nan, points)
    assert not corrected(fitted(points)[0])
    # Nor where whole frames are lost and nobody says so.
    assert not corrected(fitted(points[rng.random(400) > 0.2])[0])


def test_a_body_lost_in_its_noise_is_not_turned_back() -> None:
    tracker, _ = fitted(markers(KITE[:2], 1300, 0.0, noise=0.06))
    assert 'markers_exchanged' not in corrected(tracker)


def test_the_figures_of_two_markers_survive_their_exchange() -> None:
    def exchanged(points: np.ndarray) -> None:
        points[BAD : BAD + 5, [3, 4]] = points[BAD : BAD + 5, [4, 3]]

    pair = {'coupler.markers': ['coupler_1', 'coupler_2']}
    straight, (tracker, found) = track(None, **pair)[1], track(exchanged, **pair)
    assert tracker.update_counts()['markers_exchanged'] == 10
    for one, other in zip(straight, found, strict=True):
        assert np.array_equal(one.angle, other.angle, equal_nan=True)


@pytest.mark.parametrize('stays', [False, True])
@pytest.mark.parametrize('turn', [0.3, 2.0])
def test_a_pose_that_jumps_is_forgotten_once_it_has_left_the_window(
    turn: float, stays: bool
) -> None:
    """Figures were 10 times as far off for 2 s, and 3 times for another 4."""
    points = markers(KITE, 700)
    jumped = points.copy()
    bad = slice(300, None if stays else 301)
    middle = points[bad].mean(axis=1, keepdims=True)
    jumped[bad] = middle + (points[bad] - middle) * np.exp(1j * turn) + 0.5
    _, straight = figures(points)
    _, found = figures(jumped)
    after = slice(300 + 105, None)
    for order in (1, 2, 3):
        usual = np.array([e.rate(order).value[0] for e in straight[after]])
        rates = np.array([e.rate(order).value[0] for e in found[after]])
        deviation = np.sqrt([e.rate(order).variance[0] for e in straight[after]])
        assert np.sqrt(np.mean(((rates - usual) / deviation) ** 2)) < 0.2


def test_two_markers_closer_than_their_noise_tell_no_angle() -> None:
    """Of three the one far from the others is hidden for half a second, then now and then."""
    points = markers(np.array([0.05, -0.05, -0.05 + 1e-5j]), 600)
    hidden = points.copy()
    hidden[200:300, 0] = hidden[400:600:7, 0] = np.nan
    _, straight = figures(points)
    _, found = figures(hidden)
    told = np.array([not e.missing[0] for e in found])
    frames = np.array([e.stamp // 5_000_000 for e in found])
    assert not told[(frames >= 200) & (frames < 300)].any()
    assert told[(frames >= 300) & (frames < 400)].all()
    off = [(e.rate(1).value[0], s.rate(1).value[0]) for e, s in zip(found, straight, strict=True)]
    errors = np.abs(np.array(off) - 0.03 * RATE)[told & (frames > 110)]
    # Told all the same, they turned the body by any angle.
    assert np.sqrt((errors[:, 0] ** 2).mean()) < 2 * np.sqrt((errors[:, 1] ** 2).mean())


# --- wild in the first frames -------------------------------------------------------------------


def figures(points: np.ndarray) -> tuple[Tracker, list[Estimate]]:
    """What a tracker finds of frames of one body (T, n), all at once."""
    solid = np.stack((points.real, points.imag, 0 * points.real), axis=-1)
    names = tuple(map(str, range(points.shape[1])))
    stamps = 5_000_000 * np.arange(len(points), dtype=np.int64)
    tracker = Tracker(settings_from({}))
    return tracker, instants(tracker.add(MarkerFrames(stamps, 'w', names, solid), 3))


@functools.cache
def straight_figures(count: int) -> list[Estimate]:
    return figures(markers(KITE[:count], 300))[1]


@pytest.mark.parametrize('far', [0.05, 3000.0])
@pytest.mark.parametrize(
    'when',
    [[0], [0, 1, 2, 3, 4], [2, 3], [5], [12], [19]],
    ids=lambda when: f'{len(when)}_{when[0]}',
)
@pytest.mark.parametrize('count', [3, 4])
def test_what_is_wild_in_the_first_frames_spoils_no_figure_after_them(
    count: int, when: list[int], far: float
) -> None:
    points = markers(KITE[:count], 300)
    spoiled = points.copy()
    spoiled[when, 1] += far * np.exp(1j * np.arange(len(when)))
    straight = straight_figures(count)
    tracker, found = figures(spoiled)
    assert tracker.update_counts()['markers_left_out'] == len(when)
    for one, other in zip(straight[20:], found[20:], strict=True):
        # The frames before are lost, which is told less and less.
        share = 1.0 if one.stamp < 5e8 else 0.1
        for order in (1, 2, 3):
            (value, variance, _), (rate, _, determined) = one.rate(order), other.rate(order)
            assert determined[0]
            if one.stamp > 1.5e8:
                assert abs(rate[0] - value[0]) < 3 * share * np.sqrt(variance[0])
    assert not any(e.missing[0] for e in found[20:])


def test_names_exchanged_in_the_first_frames_are_put_right() -> None:
    points = markers(KITE, 150)
    points[:5, [0, 1]] = points[:5, [1, 0]]
    tracker, found = figures(points)
    assert tracker.update_counts()['markers_exchanged'] == 10
    sizes = [np.abs(np.subtract.outer(e.shape[0], e.shape[0])) for e in found[20:]]
    exact = np.abs(np.subtract.outer(KITE, KITE))
    assert np.abs(sizes - exact).max() < 3e-4


@pytest.mark.parametrize('count', [2, 3, 8])
def test_no_body_begins_anew_for_noise(count: int) -> None:
    shape = 0.1 * np.exp(1j * np.arange(count))
    rng = np.random.default_rng(4)
    for _ in range(200):
        turn = np.exp(0.1j * np.arange(20))[:, None]
        noise = 1e-3 * rng.standard_normal((2, 20, count))
        assert consensus_shape(turn * shape + noise[0] + 1j * noise[1], 6.0, 1e-6) is None


@pytest.mark.parametrize('hidden', [0, 60])
def test_a_wild_start_comes_out_the_same_frame_by_frame(hidden: int) -> None:
    """Also of a body that is seen later than the other, and of which a marker is, later still."""
    points = np.zeros((220, 7, 3))
    for part, shape in ((slice(3), KITE[:3]), (slice(3, 7), KITE)):
        found = markers(shape, 220)
        points[:, part, 0], points[:, part, 1] = found.real, found.imag
    points[:hidden, 3:] = points[: hidden + 40, 6] = np.nan
    points[[hidden, hidden + 7], 4, 0] += 30.0
    values = {'bodies': ['a', 'b'], 'a.markers': list('012'), 'b.markers': list('3456')}
    frames = MarkerFrames(5_000_000 * np.arange(220), 'w', tuple('0123456'), points)
    whole, single = Tracker(settings_from(values)), Tracker(settings_from(values))
    together, one_by_one = instants(whole.add(frames, 3)), []
    for k, row in enumerate(points):
        frame = one_frame(5_000_000 * k, 'w', frames.identities, row)
        one_by_one += instants(single.add(frame, 3))
    assert whole.update_counts() == single.update_counts()
    assert whole.update_counts()['markers_left_out'] == 2
    for name in ('angle', 'angle_covariance', 'position'):
        one, other = (np.stack([getattr(e, name) for e in all_]) for all_ in (together, one_by_one))
        assert np.isfinite(one[hidden + 20 :]).all()
        most = np.maximum(np.nanmax(np.abs(one), axis=(0, -1), keepdims=True), 1e-300)
        np.testing.assert_allclose(one / most, other / most, rtol=0, atol=1e-9)


@settings(max_examples=8)
@given(
    turn=st.floats(-3, 3),
    shift=st.complex_numbers(max_magnitude=10),
    scale=st.floats(-3, 3).map(lambda x: 10**x),
    order=st.permutations(range(4)),
)
def test_mending_does_not_depend_on_names_place_turn_or_size(
    turn: float, shift: complex, scale: float, order: list[int]
) -> None:
    for shape in (KITE, RECTANGLE):
        points = exchange(markers(shape, 80), 60, 2) if shape is RECTANGLE else markers(shape, 80)
        points[50, 1] += 0.05
        points[70, [0, 1]] = points[70, [1, 0]]
        tracker, turns = fitted(points)
        assert {'markers_left_out', 'markers_exchanged'} == set(corrected(tracker))
        there = (scale * np.exp(1j * turn) * points + scale * shift)[:, order]
        other, found = fitted(there)
        assert corrected(other) == corrected(tracker)
        assert found / found[-1] == pytest.approx(turns / turns[-1], nan_ok=True)
        assert other.noise()[0] == pytest.approx(scale * tracker.noise()[0], rel=1e-6)
