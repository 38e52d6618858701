"""Derivatives of poses: judgments hold, until they are due anew or something refutes them."""

from typing import Any

import numpy as np
import pytest
from stretches import instants

from kinpole_ros.bench import _hindsight, _record
from kinpole_ros.estimate import Estimate
from kinpole_ros.frame import MarkerFrames, part_of
from kinpole_ros.parameters import settings_from
from kinpole_ros.tracker import Tracker
from kinpole_ros.window import _choice, _poses, _refuted, _wiener

pytestmark = pytest.mark.filterwarnings('error')

STEP = 5_000_000
NAMES = ('a', 'b', 'c', 'd')
VALUES = {'bodies': ['rod'], 'rod.markers': list(NAMES), 'window': 0.5, 'lag': 0.1}
ARMS = 0.1 * np.exp(2j * np.pi * np.array([0.0, 0.2, 0.45, 0.8]))
# A judgment holds for an eighth of the 99 samples that the longest window has.
HELD = 12


def frames(angle: np.ndarray, noise: float = 1e-5) -> MarkerFrames:
    """A body that turns about a point 0.2 m from its middle, which goes along at 1 m/s."""
    rng = np.random.default_rng(0)
    along = STEP * 1e-9 * np.arange(len(angle))[:, None]
    flat = along + (0.2 + ARMS) * np.exp(1j * angle)[:, None]
    flat = flat + noise * (rng.normal(size=(*flat.shape, 2)) @ (1, 1j))
    points = np.zeros((*flat.shape, 3))
    points[..., 0], points[..., 1] = flat.real, flat.imag
    return MarkerFrames(10**18 + STEP * np.arange(len(angle)), 'world', NAMES, points)


def one_by_one(seen: MarkerFrames, orders: list[int]) -> list[Estimate]:
    """Estimates of frames taken singly, each asked for up to its own order."""
    tracker = Tracker(settings_from(VALUES))
    found = []
    for k, order in enumerate(orders):
        found += instants(tracker.add(part_of(seen, slice(k, k + 1)), order))
    return found


def told(recording: _record.Recording, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a quantity in the frames that are told of it, and its deviations there."""
    found = _record.measure(recording)
    where = _hindsight.counted(recording, found)[quantity]
    errors = _hindsight.own_errors(recording, found)[quantity]
    return errors[where], found.deviations[quantity][where]


@pytest.mark.parametrize('begun', range(400, 400 + HELD, 2))
def test_a_motion_that_sets_in_amid_a_judgment_is_followed_at_once(
    begun: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    time = np.maximum(np.arange(460) - begun, 0) * STEP * 1e-9
    seen = frames(100 * time**2)

    def error() -> float:
        found = instants(Tracker(settings_from(VALUES)).add(seen, 2))
        rate = np.array([estimate.angle[1, 0] for estimate in found])
        late = np.array([(estimate.stamp - 10**18) // STEP for estimate in found])
        some = slice(int(np.searchsorted(late, begun - 6)), None)
        return float(np.sqrt(np.mean((rate[some] - 200 * time[late[some]]) ** 2)))

    held = error()
    monkeypatch.setattr(_poses, '_PART', 10**9)
    assert held < 1.3 * error()


def test_who_asks_for_more_amid_a_judgment_waits_for_the_next_and_disturbs_nobody() -> None:
    seen = frames(2 * np.sin(np.arange(330) / 30))
    for more in range(300, 300 + HELD, 5):
        straight = one_by_one(seen, [2] * 330)
        mixed = one_by_one(seen, [2] * more + [4] * (330 - more))
        waited = 0
        for alone, beside in zip(straight, mixed, strict=True):
            for name in ('angle', 'position'):
                here, there = getattr(beside, name)[:3], getattr(alone, name)
                np.testing.assert_allclose(here, there, rtol=1e-12)
            for order in (1, 2):
                pole, other = beside.pole(order), alone.pole(order)
                np.testing.assert_allclose(pole.value, other.value, rtol=1e-10)
                np.testing.assert_array_equal(pole.determined, other.determined)
            if beside.order == 4 and np.isnan(beside.angle[3, 0]):
                assert not beside.pole(3).determined[0]
                assert not beside.centrode_curvature.determined[0]
                waited += 1
        assert waited < HELD
        assert np.isfinite(mixed[-1].angle[4, 0])


@pytest.mark.parametrize('orders', [(2, 4), (4, 2)])
def test_who_asks_otherwise_of_many_frames_at_once_gets_what_comes_one_by_one(
    orders: tuple[int, int],
) -> None:
    count, change = 325, 300 + HELD // 2
    seen = frames(2 * np.sin(np.arange(count) / 30))
    tracker = Tracker(settings_from(VALUES))
    found: list[Estimate] = []
    for part, order in zip((slice(change), slice(change, None)), orders, strict=True):
        found += instants(tracker.add(part_of(seen, part), order))
    singly = one_by_one(seen, [orders[0]] * change + [orders[1]] * (count - change))
    for one, other in zip(found, singly, strict=True):
        for name in ('angle', 'position', 'angle_covariance'):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6)


def test_who_asks_for_less_gets_what_was_found_before() -> None:
    seen = frames(2 * np.sin(np.arange(310) / 30))
    straight = one_by_one(seen, [4] * 310)
    mixed = one_by_one(seen, [4] * 303 + [1] * 7)
    for all_, few in zip(straight, mixed, strict=True):
        np.testing.assert_allclose(few.angle, all_.angle[: few.order + 1], rtol=1e-12)


def test_poles_together_are_judged_anew_where_they_part_from_those_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = _record.make_recording(('stop and go',), (1e-5,), 6, 6.0)

    def worst() -> float:
        """Error of the IJP in stated deviations."""
        errors, deviations = told(recording, 'IJP')
        return float((errors / deviations).max())

    assert worst() < 3
    monkeypatch.setattr(_refuted, '_OFF', np.inf)
    assert worst() > 5


def test_rates_about_which_windows_contradict_each_other_are_not_told_as_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = _record.make_recording(('stop and go',), (1e-5,), 6, 6.0)

    def far_off() -> int:
        errors, deviations = told(recording, 'jerk')
        return int((errors > 10 * deviations).sum())

    few = far_off()
    monkeypatch.setattr(_choice, '_CONTRADICTS', np.inf)
    assert few < far_off() / 3


def test_a_body_at_rest_is_quiet_at_once_and_followed_when_it_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stop, go, last = 400, 640, 700
    time = np.arange(last + 20) * STEP * 1e-9
    begun = np.maximum(time - time[go], 0)
    stopped = np.minimum(time, time[stop])
    rate = np.where(time < time[stop], 6 * np.cos(6 * time), 60 * begun)
    seen = frames(np.sin(6 * stopped) + 30 * begun**2, 1e-4)

    def errors(first: int, end: int) -> float:
        found = instants(Tracker(settings_from(VALUES)).add(seen, 3))
        numbers = np.array([(estimate.stamp - 10**18) // STEP for estimate in found])
        off = np.array([estimate.angle[1, 0] for estimate in found]) - rate[numbers]
        return float(np.sqrt(np.mean(off[(numbers >= first) & (numbers < end)] ** 2)))

    rest, motion = errors(stop + 25, go - 20), errors(go - 10, last)
    monkeypatch.setattr(_wiener, '_CALM', 1e9)
    # Twice as much while averages remembered the stop itself, which is a jump of the rate.
    assert rest < 0.004
    assert rest < 0.7 * errors(stop + 25, go - 20)
    assert motion < 1.05 * errors(go - 10, last)


def test_the_slow_part_of_a_turn_is_not_taken_to_be_as_rich_as_the_fast_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = _record.make_recording(('four-bar coupler',), (1e-5,), 3, 4.0)

    def error() -> float:
        return float(np.sqrt(np.mean(told(recording, 'IJP')[0] ** 2)))

    calm = error()
    monkeypatch.setattr(_wiener, '_LAST', 10**9)
    assert calm < 0.96 * error()


def test_a_frame_is_answered_before_it_is_judged_and_settling_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judged: list[str] = []
    when = 'start'
    judge = _poses.judge

    def noted(*given: Any) -> Any:
        judged.append(when)
        return judge(*given)

    for module in (_poses, _refuted):
        monkeypatch.setattr(module, 'judge', noted)
    seen = frames(2 * np.sin(np.arange(400) / 30), 1e-3)
    idle, asked = (Tracker(settings_from(VALUES)) for _ in range(2))
    for k in range(400):
        one = part_of(seen, slice(k, k + 1))
        when = 'asked' if k >= 200 else 'start'
        (now,) = instants(asked.add(one, 3)) or (None,)
        when = 'settled'
        asked.settle()
        when = 'other'
        (then,) = instants(idle.add(one, 3)) or (None,)
        if now is not None and then is not None:
            np.testing.assert_array_equal(now.angle, then.angle)
            np.testing.assert_array_equal(now.pole(3).value, then.pole(3).value)
    # An eighth of the frames are due, and a few more stand out by chance, but not far.
    assert judged.count('settled') > 200 / HELD
    assert judged.count('asked') < 200 / 20


def of_some_instants(at_once: int, first_order: int = 3) -> np.ndarray:
    """
    Angles (4, M, 1) of which three or four instants follow on each other, then one is missing.

    So many are asked for at once; the first 78 up to another order.
    """
    count, ahead, rng = 61, 20, np.random.default_rng(8)
    time = np.arange(400 + count) * STEP * 1e-9
    noise = np.array([1e-3, 1e-4])
    signals = np.zeros((len(time), 2, 2))
    signals[:, 0, 0] = np.sin(9 * time) + np.maximum(time - 1, 0) ** 3
    signals[:, 1] = 0.1 * signals[:, :1, 0]
    signals += noise[:, None] * rng.normal(size=signals.shape)
    signals[:, 0, 1] = 0.0
    numbers = np.arange(400)[np.isin(np.arange(400) % 9, (3, 8), invert=True)]
    times = np.broadcast_to((np.arange(count) - count + 1 + ahead) * STEP, (len(numbers), count)).T
    samples = signals[numbers + np.arange(count)[:, None]]
    found, poses = [], _poses.PoseFilter()
    for order, begin, end in ((first_order, 0, 78), (3, 78, len(numbers))):
        for first in range(begin, end, at_once):
            some = slice(first, min(first + at_once, end))
            shape = len(numbers[some])
            given = numbers[some], times[:, some], samples[:, some], None
            limits = np.broadcast_to(noise, (shape, 2)), np.full((shape, 1), 100.0)
            angle = poses.derivatives(*given, *limits, order).angle
            found.append(np.resize(angle, (4, shape, 1)))
            found[-1][order + 1 :] = np.nan
    return np.concatenate(found, axis=1)


def test_what_is_judged_anew_ends_where_instants_are_missing() -> None:
    alone = of_some_instants(1)
    for at_once in (2, 3, 5, 7, 64):
        np.testing.assert_allclose(of_some_instants(at_once), alone, rtol=1e-9, atol=1e-9)


def test_an_instant_that_is_judged_for_itself_is_of_the_order_asked_for() -> None:
    alone = of_some_instants(1, first_order=1)
    # Only what goes on from an instant before waits for the next judgment.
    assert np.isnan(alone[3]).sum() == 78 + 2
    for at_once in (2, 3, 5, 7, 64):
        found = of_some_instants(at_once, first_order=1)
        np.testing.assert_allclose(found, alone, rtol=1e-9, atol=1e-9)


def test_bodies_are_asked_six_times_while_a_judgment_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    refuted = _poses.judge_refuted

    def noted(*given: Any) -> Any:
        asked.append(len(given[0].reach))
        return refuted(*given)

    monkeypatch.setattr(_poses, 'judge_refuted', noted)
    count = 50 * HELD
    found = one_by_one(frames(2 * np.sin(np.arange(count) / 30), 1e-3), [3] * count)
    # Not at the sixth, when all are judged; and a few are asked since they are far off.
    assert 5 / HELD - 0.02 < len(asked) / len(found) < 5 / HELD + 0.06


def test_a_coefficient_that_is_small_by_chance_does_not_make_a_body_rest() -> None:
    # In one frame of these the slope of the shortest window is zero but for a thousandth.
    recording = _record.make_recording(('two sines',), (1e-2,), 4, 6.0)
    found = _record.measure(recording)
    errors = _hindsight.own_errors(recording, found)['ω'] / found.deviations['ω']
    assert np.nanmax(errors) < 5


def test_no_curvature_is_told_of_a_body_that_may_not_turn() -> None:
    # In one frame of these the angular velocity is a fortieth of its deviation.
    recording = _record.make_recording(('stop and go',), (1e-5,), 24, 6.0)
    found = _record.measure(recording)
    told = found.determined['κ'] & np.isfinite(recording.truth['κ'][found.frames])
    errors = _hindsight.own_errors(recording, found)['κ'] / found.deviations['κ']
    assert np.max(errors[told]) < 10


def test_what_is_done_to_an_answer_changes_none_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    points = _record.make_recording(('four-bar coupler',), (1e-3,), 1, 2.5).points
    seen, settings = _record.frames_of(points, _record.stamps_of(len(points)))

    def estimates() -> list[Estimate]:
        tracker = Tracker(settings)
        each = (part_of(seen, slice(k, k + 1)) for k in range(len(points)))
        return [one for frame in each for one in instants(tracker.add(frame, 3))]

    straight = estimates()
    derivatives = _poses.PoseFilter.derivatives

    def spoiled(*given: Any) -> Any:
        found = derivatives(*given)
        kept = type(found)(*map(np.copy, found))
        for array in found:
            array[...] = np.nan
        return kept

    monkeypatch.setattr(_poses.PoseFilter, 'derivatives', spoiled)
    for one, other in zip(straight, estimates(), strict=True):
        np.testing.assert_array_equal(one.angle, other.angle)
        np.testing.assert_array_equal(one.pole(3).value, other.pole(3).value)


def test_no_combination_of_derivatives_has_a_variance_below_zero() -> None:
    recording = _record.make_recording(('stop and go', 'dead point'), (1e-5, 1e-3), 2, 6.0)
    seen, settings = _record.frames_of(recording.points, _record.stamps_of(1200))
    (found,) = Tracker(settings).add(seen, 4)
    assert found.together is not None
    for each in (found, found.together):
        for matrix in (each.position_covariance, each.angle_covariance):
            ordered = np.moveaxis(matrix, (0, 1), (-2, -1))
            deviations = np.sqrt(np.einsum('...kk->...k', ordered))
            deviations[deviations == 0] = 1.0
            correlation = ordered / deviations[..., None] / deviations[..., None, :]
            assert np.linalg.eigvalsh(correlation).min() > -1e-12
