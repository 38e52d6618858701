"""The whole pipeline, frames in and motion out, on scenes whose motion is known exactly."""

import sys
import threading
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import SCENES, START, STEP, Record, check, follow, record, two_bodies
from stretches import instants, one_frame

from kinpole_ros import planar
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.rejection import MOST_MARKERS
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import POLE_NAMES

pytestmark = pytest.mark.filterwarnings('error')

# --- exact markers ------------------------------------------------------------------------------


@pytest.mark.parametrize('lag', [0.1, 0.02, 0.0])
@pytest.mark.parametrize('scene', SCENES)
def test_exact_markers_give_exact_poles(scene: str, lag: float) -> None:
    seen = record(scene)
    _, found = follow(seen.frames, {**seen.values, 'lag': lag})
    # With little lag the very first window is short, and the snap wants a longer one; without any
    # the end of a window decides.
    isp = {0.1: 1e-5, 0.02: 1e-4, 0.0: 3e-3}[lag]
    check(seen, found[1:], (1e-5, 1e-5, 2e-3 if lag == 0 else 1e-5, isp))


@pytest.mark.parametrize('scene', SCENES)
def test_markers_may_be_missing_now_and_then(scene: str) -> None:
    seen = record(scene, drop=0.1)
    tracker, found = follow(seen.frames, seen.values)
    # The very first windows hold too few samples of some markers.
    check(seen, found[2:])
    holes = sum(int(np.isnan(frame.points[0, :, 0]).sum()) for frame in seen.frames)
    assert tracker.update_counts()['markers_not_seen'] == holes


@pytest.mark.parametrize('scene', SCENES)
def test_markers_may_come_in_any_order(scene: str) -> None:
    straight, shuffled = record(scene), record(scene, shuffle=True)
    _, found = follow(straight.frames, straight.values)
    _, other = follow(shuffled.frames, shuffled.values)
    for one, two in zip(found, other, strict=True):
        assert np.array_equal(one.position, two.position, equal_nan=True)
        assert np.array_equal(one.angle, two.angle, equal_nan=True)


@pytest.mark.parametrize(
    ('turn', 'shift'),
    [
        (np.exp(2.1j), 3 - 7j),
        (1e-6 * np.exp(0.3j), 0),
        (1e6, 1e6j),
        (np.exp(-1j), 3e5),
        (1e-3, 3e2 - 1e2j),
    ],
    ids=['moved', 'tiny', 'huge', 'far away', 'small and far away'],
)
@pytest.mark.parametrize('scene', SCENES)
def test_size_and_place_do_not_matter(scene: str, turn: complex, shift: complex) -> None:
    seen = record(scene, turn=turn, shift=shift)
    _, found = follow(seen.frames, seen.values)
    far = abs(shift) > 1e3 * abs(turn)
    if not far:
        check(seen, found)
        return
    # Coordinates that are known to 1e-10 of the size tell so much.
    truth = seen.truth(estimate.stamp for estimate in found)
    for b, body in enumerate(found[0].bodies):
        position, angle = truth[body]
        for order, allowed in ((1, 1e-5), (2, 1e-4)):
            exact = planar.pole(order, position, angle).value
            errors = np.array([e.pole(order).value[b] for e in found]) - exact
            # Beyond its own size a pole is as uncertain as it is far, squared.
            reach = 1 + (np.abs(exact - position[0]) / found[0].size[b]) ** 2
            assert (np.abs(errors) < allowed * found[0].size[b] * reach).all(), (body, order)


@pytest.mark.parametrize('plane', ['yz', 'zx'])
def test_the_plane_may_be_another(plane: str) -> None:
    plain, turned = record('four_bar'), record('four_bar', plane=plane)
    _, found = follow(plain.frames, plain.values)
    _, other = follow(turned.frames, turned.values)
    for one, two in zip(found, other, strict=True):
        assert np.array_equal(one.position, two.position)
        assert two.height == pytest.approx(0.7)
        assert two.frame_id == 'world'


def centrodes(seen: Record, found: list[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Fixed and moving centrode of the only body, complex; the latter from its true center."""
    icr = np.array([estimate.pole(1).value[0] for estimate in found])
    (motion,) = seen.truth(estimate.stamp for estimate in found).values()
    own = planar.moving_centrode(
        planar.to_plane(icr), planar.to_plane(motion.position[0]), motion.angle[0]
    )
    return icr, planar.to_complex(own)


def test_a_wheel_rolls_its_rim_on_a_line() -> None:
    seen = record('rolling_wheel')
    _, found = follow(seen.frames, seen.values)
    fixed, moving = centrodes(seen, found)
    assert fixed.imag == pytest.approx(0, abs=1e-9)
    assert np.abs(moving) == pytest.approx(0.1, abs=1e-9)
    kappa = np.array([estimate.centrode_curvature.value[0] for estimate in found])
    assert kappa == pytest.approx(0, abs=1e-6)
    for estimate in found:
        assert estimate.angle[1, 0] == pytest.approx(-2 * np.pi)
        speed = np.abs(estimate.icr_velocity.value[0])
        rim = planar.moving_centrode_curvature(kappa[0], estimate.angle[1, 0], speed)
        assert 1 / rim == pytest.approx(0.1)


def test_a_rod_on_two_guides_rolls_one_of_cardans_circles_in_the_other() -> None:
    seen = record('cardan')
    _, found = follow(seen.frames, seen.values)
    fixed, moving = centrodes(seen, found)
    assert np.abs(fixed) == pytest.approx(0.3, abs=1e-9)
    assert np.abs(moving) == pytest.approx(0.15, abs=1e-9)
    # The ICR goes clockwise.
    kappa = np.array([estimate.centrode_curvature.value[0] for estimate in found])
    assert kappa == pytest.approx(-1 / 0.3, rel=1e-6)


def test_links_turn_about_their_joints() -> None:
    seen = record('four_bar')
    _, found = follow(seen.frames, seen.values)
    scene = seen.truth(estimate.stamp for estimate in found)
    crank_pin = scene['coupler'].position[0]
    coupler_end = crank_pin + 0.36 * np.exp(1j * scene['coupler'].angle[0])
    joints = {('coupler', 'crank'): crank_pin, ('rocker', 'coupler'): coupler_end}
    for k, estimate in enumerate(found):
        for p, (j, i) in enumerate(zip(*estimate.pairs, strict=True)):
            pair = (estimate.bodies[j], estimate.bodies[i])
            between = scene[pair[0]].angle[1, k] - scene[pair[1]].angle[1, k]
            assert estimate.relative_rate.value[p] == pytest.approx(between, abs=1e-6)
            if pair in joints:
                assert estimate.relative_icr.determined[p]
                error = np.abs(estimate.relative_icr.value[p] - joints[pair][k])
                assert error < 1e-6
        # Kennedy: the rocker's center relative to the crank is on the line of the pivots.
        if estimate.relative_icr.determined[1]:
            assert estimate.relative_icr.value[1].imag == pytest.approx(0, abs=1e-5)


# --- noise --------------------------------------------------------------------------------------


def test_noisy_markers_give_what_the_variance_says() -> None:
    seen = record('four_bar', count=400, noise=2e-4)
    tracker, found = follow(seen.frames, seen.values, every=5)
    found = found[10:]
    assert tracker.noise() == pytest.approx(2e-4, rel=0.2)
    truth = seen.truth(estimate.stamp for estimate in found)
    for b, body in enumerate(found[0].bodies):
        position, angle = truth[body]
        for order, highest in ((1, 2.0), (2, 2.5), (3, 3.0)):
            rates = [estimate.rate(order) for estimate in found]
            spread = np.sqrt([rate.variance[b] for rate in rates])
            errors = np.array([rate.value[b] for rate in rates]) - angle[order]
            # What is stated is neither much too small nor, where there is an error, too large.
            ratio = np.sqrt(np.mean((errors / spread) ** 2))
            assert ratio < highest, (body, order)
            assert ratio > 0.3 or body == 'crank', (body, order)
        exact = planar.pole(1, position, angle).value
        poles = [estimate.pole(1) for estimate in found]
        sure = np.array([pole.determined[b] for pole in poles])
        assert sure.mean() > 0.9
        errors = np.array([pole.value[b] for pole in poles]) - exact
        spread = np.sqrt([np.trace(pole.covariance[b]) for pole in poles])
        assert np.sqrt(np.mean(np.abs(errors[sure] / spread[sure]) ** 2)) < 2.0, body
    relative = np.abs([e.angle[1, 1] for e in found] / truth['coupler'].angle[1] - 1)
    assert np.median(relative) < 0.005


def test_a_given_noise_is_believed() -> None:
    seen = record('four_bar', count=120, noise=2e-4)
    values = {**seen.values, 'noise': 1e-3}
    tracker, found = follow(seen.frames, values)
    assert tracker.noise() == pytest.approx([1e-3] * 3)
    _, measured = follow(seen.frames, seen.values)
    assert (found[-1].rate(1).variance > 2 * measured[-1].rate(1).variance).all()


@pytest.mark.parametrize('noise', [1e-20, 1e-200])
def test_no_given_noise_is_below_rounding(noise: float) -> None:
    body = np.array([[0.09, 0.02, 0], [-0.03, 0.1, 0], [-0.08, -0.05, 0], [0.05, -0.06, 0]])
    turn = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    points = np.repeat(body[None], 400, axis=0)
    points[..., :2] = points[..., :2] @ turn + [0.3, 0.2]
    frames = MarkerFrames(START + STEP * np.arange(400), 'world', ('a', 'b', 'c', 'd'), points)
    (found,) = Tracker(settings_from({'noise': noise})).add(frames, 4)
    for order in range(1, 5):
        assert not found.pole(order).determined.any()
        assert (found.rate(order).variance > 0).all()


def test_a_still_body_does_not_turn_and_has_no_poles() -> None:
    rng = np.random.default_rng(1)
    exact = np.array([[0.1, 0, 0], [0, 0.2, 0], [-0.1, -0.1, 0]])
    for noise in (0.0, 1e-4):
        frames = [
            one_frame(
                START + k * STEP, 'world', ('a', 'b', 'c'), exact + noise * rng.normal(size=(3, 3))
            )
            for k in range(200)
        ]
        _, found = follow(frames, {}, every=3)
        found = found[5:]
        wrong = 0
        for estimate in found:
            assert not estimate.missing[0]
            for order in range(1, 5):
                wrong += int(estimate.pole(order).determined[0])
            reasons = estimate.reasons(0)
            assert all(reasons[n] for n, p in enumerate_poles(estimate) if not p)
            assert not estimate.centrode_curvature.determined[0]
        # Three standard deviations are exceeded now and then.
        assert wrong <= 0.1 * 4 * len(found)
        assert 'no rotation' in found[-1].reasons(0).values()


def test_a_still_body_has_no_poles_where_no_second_window_says_so() -> None:
    # Windows of 10 samples hold two of the ladder, for the snap as a rule but one.
    count, shape = 3000, np.array([0.1, 0.2j, -0.1 - 0.1j])
    rng = np.random.default_rng(1)
    flat = shape + 1e-4 * (rng.normal(size=(count, 3, 2)) @ (1, 1j))
    points = np.stack((flat.real, flat.imag, np.zeros(flat.shape)), axis=-1)
    frames = MarkerFrames(START + STEP * np.arange(count), 'world', ('a', 'b', 'c'), points)
    short = settings_from({'window': 9.5 * STEP * 1e-9, 'lag': 0.0})
    (found,) = Tracker(short).add(frames, 4)
    assert len(found) > count - 10
    for order in range(1, 5):
        assert not found.pole(order).determined.any()


def enumerate_poles(estimate: Estimate) -> list[tuple[str, bool]]:
    return [
        (name, bool(estimate.pole(order).determined[0])) for order, name in enumerate(POLE_NAMES, 1)
    ]


def test_a_body_that_slides_has_no_icr() -> None:
    shape = np.array([[0.1, 0, 0], [0, 0.2, 0], [-0.1, -0.1, 0]])
    frames = [
        one_frame(START + k * STEP, 'world', ('a', 'b', 'c'), shape + [0.01 * k, 0, 0])
        for k in range(200)
    ]
    _, found = follow(frames, {})
    for estimate in found:
        assert estimate.position[1, 0] == pytest.approx(2.0, abs=1e-6)
        assert not estimate.pole(1).determined[0]
        assert estimate.reasons(0)['icr'] in ('no rotation', 'pole at infinity')


@pytest.mark.parametrize('noise', [0.0, 1e-4])
def test_a_pinned_body_has_poles_and_no_curvature(noise: float) -> None:
    seen = record('four_bar', noise=noise)
    _, found = follow(seen.frames, seen.values)
    found = found[4:]
    assert all(estimate.pole(1).determined[0] for estimate in found)
    assert not any(estimate.centrode_curvature.determined[0] for estimate in found)
    # The crank is known to be on a pin once it has turned by 2 rad, after 0.32 s.
    later = [estimate for estimate in found if estimate.stamp > START + 500_000_000]
    assert len(later) >= 5
    for estimate in later:
        assert estimate.reasons(0)['centrode_curvature'].startswith('pinned')


def test_too_few_markers_are_told_apart_from_too_few_frames() -> None:
    seen = record('four_bar', count=40)
    names = seen.frames[0].identities
    for frame in seen.frames:
        frame.points[0, [names.index('crank_1'), names.index('crank_2')]] = np.nan
        if frame.stamps[0] < seen.frames[30].stamps[0]:
            frame.points[0, [names.index(f'rocker_{k}') for k in (1, 2, 3)]] = np.nan
    tracker, found = follow(seen.frames, {**seen.values, 'lag': 0.0}, every=1)
    last = found[-1]
    assert last.reasons(0) == {'all': 'too few markers seen, or all at one place'}
    assert last.reasons(1) == {}
    assert not last.missing[2]
    just_back = next(e for e in found if e.stamp == seen.frames[31].stamps[0])
    assert just_back.missing[2] in ('window not full', 'noise not known yet')
    for order in range(1, 5):
        assert not last.pole(order).determined[0]
        assert last.pole(order).determined[1]
    assert tracker.update_counts()['markers_not_seen'] == 40 * 2 + 30 * 3


def test_there_are_no_figures_before_the_window_holds_seven_frames() -> None:
    seen = record('cardan', count=8)
    tracker = Tracker(settings_from({**seen.values, 'lag': 0.0}))
    told = [len(instants(tracker.add(frame, 1))) for frame in seen.frames]
    assert told == [0, 0, 0, 0, 0, 0, 1, 1]


def test_markers_at_one_place_are_no_body() -> None:
    frames = [one_frame(START + k * STEP, 'w', ('a', 'b'), np.ones((2, 3))) for k in range(30)]
    _, found = follow(frames, {}, every=1)
    assert {estimate.missing[0] for estimate in found} == {
        'too few markers seen, or all at one place'
    }


def test_a_tracker_that_finds_its_markers_late_is_followed_from_then_on() -> None:
    """Some drivers send (0, 0, 0) for what they have not found yet."""
    seen = record('cardan')
    for frame in seen.frames[:60]:
        frame.points[:] = 0
    _, found = follow(seen.frames, {**seen.values, 'window': 0.3})
    late = [
        estimate for estimate in found if estimate.stamp > seen.frames[60].stamps[0] + 10 * STEP
    ]
    check(seen, late)


# --- a body of all markers ----------------------------------------------------------------------


def test_a_body_of_all_markers_takes_in_what_it_meets() -> None:
    seen = record('cardan', count=300)
    frames = []
    for k, frame in enumerate(seen.frames):
        met = 2 if k < 60 else 3 if k < 120 else 4
        frames.append(
            frame._replace(identities=frame.identities[:met], points=frame.points[:, :met])
        )
    tracker, found = follow(frames, {'window': 0.5})
    assert tracker.bodies == ('body',)
    assert tracker.update_counts()['markers_unknown'] == 0
    truth = seen.truth(estimate.stamp for estimate in found)['rod']
    for k, estimate in enumerate(found):
        assert not estimate.missing[0]
        for order in range(1, 5):
            exact = planar.pole(order, truth.position[:, k], truth.angle[:, k]).value
            allowed = 1e-5 if order < 4 else 1e-4
            assert np.abs(estimate.pole(order).value[0] - exact) < allowed * estimate.size[0]
    assert found[-1].size[0] == pytest.approx(found[0].size[0], rel=1)


def test_a_marker_named_twice_counts_once() -> None:
    seen = record('cardan', count=120, noise=1e-4)
    doubled = [
        f._replace(
            identities=(*f.identities, f.identities[0]),
            points=np.concatenate((f.points, f.points[:, :1]), axis=1),
        )
        for f in seen.frames
    ]
    _, plain = follow(seen.frames, {})
    _, found = follow(doubled, {})
    for one, two in zip(plain, found, strict=True):
        assert two.angle == pytest.approx(one.angle, rel=1e-9, nan_ok=True)


def test_markers_that_are_named_anew_in_every_frame_do_not_fill_the_memory() -> None:
    seen = record('cardan', count=10)
    tracker = Tracker(settings_from({}))
    for k, frame in enumerate(seen.frames):
        names = tuple(f'{k}_{n}' for n in range(300))
        tracker.add(frame._replace(identities=names, points=np.ones((1, 300, 3))), None)
    assert tracker.update_counts()['markers_unknown'] == 300
    assert tracker.state.bodies.width <= MOST_MARKERS
    # Nor do those that no body names, each time in a layout of its own.
    tracker = Tracker(settings_from({'bodies': ['rod'], 'rod.markers': ['a', 'b']}))
    for k in range(200):
        frame = MarkerFrames(seen.frames[0].stamps + k * STEP, 'w', (f'{k}',), np.ones((1, 1, 3)))
        tracker.add(frame, None)
    assert len(tracker.state.assignment._layouts) < 100


def test_reset_forgets_what_was_learned() -> None:
    seen, other = record('cardan'), record('rolling_wheel')
    tracker, _ = follow(seen.frames, {}, order=None)
    tracker.reset()
    assert tracker.samples == 0
    assert np.isnan(tracker.noise()).all()
    found = []
    for k, frame in enumerate(other.frames):
        found += instants(tracker.add(frame, 4 if k % 9 == 0 else None))
    truth = other.truth(estimate.stamp for estimate in found)['wheel']
    for k, estimate in enumerate(found):
        exact = planar.pole(1, truth.position[:, k], truth.angle[:, k]).value
        assert np.abs(estimate.pole(1).value[0] - exact) < 1e-6


# --- whatever comes -----------------------------------------------------------------------------

coordinates = st.one_of(
    st.floats(-1, 1),
    st.sampled_from((0.0, 1.0, 1e-300, -1e150, 1e200, 1e300, -1.7e308, np.inf, -np.inf, np.nan)),
)
messages = st.lists(
    st.tuples(
        st.sampled_from(('a', 'b', 'c', 'd', 'a/1', 'e/2')),
        st.tuples(coordinates, coordinates, coordinates),
    ),
    max_size=6,
)
steps = st.sampled_from((STEP, STEP, STEP, STEP, 0, 1, -1, 10 * STEP, 600_000_000, 10**17))


def sound(estimate: Estimate) -> None:
    """Whatever is called determined is finite, and so is its uncertainty."""
    assert len(estimate.missing) == len(estimate.bodies)
    vectors = [estimate.pole(order) for order in range(1, estimate.order + 1)]
    numbers = [estimate.rate(order) for order in range(1, estimate.order + 1)]
    numbers.append(estimate.relative_rate)
    vectors.append(estimate.relative_icr)
    if estimate.order >= 2:
        vectors.append(estimate.icr_velocity)
    if estimate.order >= 3:
        numbers.append(estimate.centrode_curvature)
    for found in vectors:
        assert np.isfinite(found.value[found.determined]).all()
        assert np.isfinite(found.covariance[found.determined]).all()
    for number in numbers:
        assert np.isfinite(number.value[number.determined]).all()
        assert np.isfinite(number.variance[number.determined]).all()
        assert (number.variance[number.determined] >= 0).all()
    for b in range(len(estimate.bodies)):
        reasons = estimate.reasons(b)
        assert all(isinstance(text, str) and text for text in reasons.values())
        for order in range(1, estimate.order + 1):
            assert (
                vectors[order - 1].determined[b]
                or 'all' in reasons
                or (POLE_NAMES[order - 1] in reasons)
            )
        told = estimate.order < 3 or estimate.centrode_curvature.determined[b]
        assert told or {'all', 'icr', 'centrode_curvature'} & set(reasons)


@given(
    st.lists(st.tuples(steps, messages, st.sampled_from((None, 1, 2, 3, 4))), max_size=20),
    st.booleans(),
    st.sampled_from((0.0, 0.01)),
    st.sampled_from((0.0, 1e-3, 1e6)),
)
def test_whatever_comes_nothing_raises_and_nothing_unknown_is_called_known(
    stream: list[Any], several: bool, lag: float, noise: float
) -> None:
    values: dict[str, Any] = {'lag': lag, 'noise': noise}
    if several:
        values |= {'bodies': ['p', 'q'], 'p.markers': ['a', 'b'], 'q.markers': ['b', 'c', 'e']}
    tracker = Tracker(settings_from(values))
    stamp = START
    for step, message, order in stream:
        stamp += step
        names = tuple(name for name, _ in message)
        points = np.array([row for _, row in message], float).reshape(-1, 3)
        for estimate in instants(tracker.add(one_frame(stamp, 'world', names, points), order)):
            sound(estimate)


@pytest.mark.parametrize('bad', [np.nan, np.inf, 1e300, 1e200, 1e155, 1e100, 1e20, 0.0])
def test_frames_gone_wild_amid_good_ones_do_no_harm(bad: float) -> None:
    seen = record('four_bar', count=80, noise=1e-4)
    for frame in seen.frames[30:36]:
        frame.points[:, ::2] = bad
    for k in (40, 43):
        seen.frames[k].points[:] = bad
    tracker, found = follow(seen.frames, {**seen.values, 'lag': 0.02}, every=2)
    for estimate in found:
        sound(estimate)
    assert np.isfinite(tracker.noise()).all()


def test_a_marker_gone_wild_before_that_can_be_told_leaves_the_other_bodies_as_they_are() -> None:
    frames = two_bodies(160, 3.0, 0.0, 1e-4)
    values = {'bodies': ['kite', 'rectangle'], 'kite.markers': list('abcd')}
    values |= {'rectangle.markers': list('efgh'), 'lag': 0.05}
    found = []
    for wild in (0.0, 1e14):
        points = frames.points.copy()
        points[5, 0] += wild
        tracker = Tracker(settings_from(values))
        (estimate,) = tracker.add(frames._replace(points=points), 3)
        assert tracker.noise()[1] < 2e-4
        found.append(estimate)
    clean, spoilt = found
    np.testing.assert_array_equal(spoilt.missing[:, 1], clean.missing[:, 1])
    assert not clean.missing[-1, 1]
    rates = [estimate.rate(1) for estimate in found]
    off = np.abs(rates[1].value - rates[0].value)[-50:, 1]
    assert (off < np.sqrt(rates[0].variance[-50:, 1])).all()
    np.testing.assert_allclose(*(rate.variance[-50:, 1] for rate in rates), rtol=0.5)


@pytest.mark.parametrize('count', [2, 3, 4])
def test_markers_lost_in_their_noise_make_no_body(count: int) -> None:
    """Their angle is anything, so whatever followed from it would be, too."""
    rng = np.random.default_rng(5)
    shape = 1e-4 * rng.normal(size=(count, 3))
    tracker = Tracker(settings_from({}))
    names = tuple(str(k) for k in range(count))
    stamps = 10**9 + 5_000_000 * np.arange(300)
    points = shape + 0.01 * rng.normal(size=(300, count, 3))
    found = instants(tracker.add(MarkerFrames(stamps, 'world', names, points), 4))
    told = [estimate.missing[0] for estimate in found[50:]]
    assert told.count('markers too close for their noise') > 0.95 * len(told)


@pytest.mark.parametrize('noise', [0.0, 1e-5, 1e-3, 1e-2])
def test_markers_of_several_links_are_told_from_those_of_one_that_are_noisy(noise: float) -> None:
    seen = record('four_bar', 300, noise=noise)
    each, _ = follow(seen.frames, seen.values, None)
    np.testing.assert_array_equal(each.rigidity_residual(), 0.0)
    one, _ = follow(seen.frames, {'bodies': ['all']}, None)
    # Of 0.37 m, and the links turn by half a turn against each other.
    assert (one.rigidity_residual() > 0.02) == (noise < 0.01)


def test_a_marker_that_jumps_or_is_exchanged_makes_no_body_look_like_several_links() -> None:
    seen = record('four_bar', 300, noise=1e-4)
    for k in range(50, 300, 20):
        points = seen.frames[k].points
        points[0, [0, 1]] = points[0, [1, 0]]
        points[0, 4] += 0.2
    tracker, _ = follow(seen.frames, seen.values, None)
    assert tracker.update_counts()['markers_left_out']
    np.testing.assert_array_equal(tracker.rigidity_residual(), 0.0)


def test_trackers_in_threads_of_their_own_give_what_one_gives_alone(
    request: pytest.FixtureRequest,
) -> None:
    request.addfinalizer(partial(sys.setswitchinterval, sys.getswitchinterval()))
    sys.setswitchinterval(1e-5)
    seen = record('four_bar')
    results: list[bytes] = []

    def run() -> None:
        _, found = follow(seen.frames, seen.values)
        results.append(b''.join(one.position.tobytes() for one in found))

    run()
    threads = [threading.Thread(target=run) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    assert len(set(results)) == 1
