"""Derivatives of poses as a tracker has them: where a motion sets in, at rest, and asked anyhow."""

from collections.abc import Sequence

import numpy as np
import pytest
from stretches import instants

from bench import _hindsight, _record
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings('error')

STEP = 5_000_000
NAMES = ('a', 'b', 'c', 'd')
VALUES = {'bodies': ['rod'], 'rod.markers': list(NAMES), 'window': 0.5, 'lag': 0.1}
ARMS = 0.1 * np.exp(2j * np.pi * np.array([0.0, 0.2, 0.45, 0.8]))


def frames(angle: np.ndarray, noise: float = 1e-5) -> MarkerFrames:
    """A body that turns about a point 0.2 m from its middle, which goes along at 1 m/s."""
    rng = np.random.default_rng(0)
    along = STEP * 1e-9 * np.arange(len(angle))[:, None]
    flat = along + (0.2 + ARMS) * np.exp(1j * angle)[:, None]
    flat = flat + noise * (rng.normal(size=(*flat.shape, 2)) @ (1, 1j))
    points = np.zeros((*flat.shape, 3))
    points[..., 0], points[..., 1] = flat.real, flat.imag
    return MarkerFrames(10**18 + STEP * np.arange(len(angle)), 'world', NAMES, points)


def one_by_one(seen: MarkerFrames, orders: Sequence[int | None]) -> list[Estimate]:
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


@pytest.mark.parametrize('begun', range(400, 412, 2))
def test_a_motion_that_sets_in_is_followed_at_once(begun: int) -> None:
    time = np.maximum(np.arange(460) - begun, 0) * STEP * 1e-9
    found = instants(Tracker(settings_from(VALUES)).add(frames(100 * time**2), 2))
    rate = np.array([estimate.angle[1, 0] for estimate in found])
    late = np.array([(estimate.stamp - 10**18) // STEP for estimate in found])
    some = slice(int(np.searchsorted(late, begun - 6)), None)
    # The step of the acceleration is 200 rad/s^2: 1 rad/s in a frame.
    assert float(np.sqrt(np.mean((rate[some] - 200 * time[late[some]]) ** 2))) < 0.04


@pytest.mark.parametrize(
    ('orders', 'more'), [((2, 4), 300), ((4, 2), 307), ((None, 3), 300), ((1, 4), 307)]
)
def test_what_was_asked_before_changes_nothing(orders: tuple[int | None, int], more: int) -> None:
    seen = frames(2 * np.sin(np.arange(330) / 30))
    straight = one_by_one(seen, [orders[1]] * 330)
    mixed = one_by_one(seen, [orders[0]] * more + [orders[1]] * (330 - more))
    for alone, beside in zip(straight[more - 330 :], mixed[more - 330 :], strict=True):
        for name in ('angle', 'position', 'angle_covariance', 'position_covariance'):
            np.testing.assert_array_equal(getattr(beside, name), getattr(alone, name))


@pytest.mark.parametrize('orders', [(2, 4), (4, 2)])
def test_who_asks_otherwise_of_many_frames_at_once_gets_what_comes_one_by_one(
    orders: tuple[int, int],
) -> None:
    count, change = 325, 306
    seen = frames(2 * np.sin(np.arange(count) / 30))
    tracker = Tracker(settings_from(VALUES))
    found: list[Estimate] = []
    for part, order in zip((slice(change), slice(change, None)), orders, strict=True):
        found += instants(tracker.add(part_of(seen, part), order))
    singly = one_by_one(seen, [orders[0]] * change + [orders[1]] * (count - change))
    for one, other in zip(found, singly, strict=True):
        for name in ('angle', 'position', 'angle_covariance'):
            here, there = getattr(one, name), getattr(other, name)
            # Covariances between orders that hardly go together come out at rounding.
            least = 1e-9 * np.abs(there).max(axis=-1, keepdims=True)
            np.testing.assert_allclose(here, there, rtol=1e-6, atol=least.max())


def test_who_asks_for_less_gets_what_was_found_before() -> None:
    seen = frames(2 * np.sin(np.arange(310) / 30))
    straight = one_by_one(seen, [4] * 310)
    mixed = one_by_one(seen, [4] * 303 + [1] * 7)
    for all_, few in zip(straight, mixed, strict=True):
        np.testing.assert_allclose(few.angle, all_.angle[: few.order + 1], rtol=1e-9)


@pytest.mark.parametrize(('quantity', 'most'), [('IJP', 3.0), ('jerk', 10.0)])
def test_where_a_motion_sets_in_nothing_is_told_as_surer_than_it_is(
    quantity: str, most: float
) -> None:
    recording = _record.make_recording(('stop and go',), (1e-5,), 6, 6.0)
    errors, deviations = told(recording, quantity)
    assert np.mean(errors > most * deviations) < 0.002
    assert len(errors) > 2000


def test_a_body_at_rest_is_quiet_at_once_and_followed_when_it_goes_on() -> None:
    stop, go, last = 400, 640, 700
    time = np.arange(last + 20) * STEP * 1e-9
    begun = np.maximum(time - time[go], 0)
    stopped = np.minimum(time, time[stop])
    rate = np.where(time < time[stop], 6 * np.cos(6 * time), 60 * begun)
    seen = frames(np.sin(6 * stopped) + 30 * begun**2, 1e-4)
    found = instants(Tracker(settings_from(VALUES)).add(seen, 3))
    numbers = np.array([(estimate.stamp - 10**18) // STEP for estimate in found])
    off = np.array([estimate.angle[1, 0] for estimate in found]) - rate[numbers]

    def errors(first: int, end: int) -> float:
        return float(np.sqrt(np.mean(off[(numbers >= first) & (numbers < end)] ** 2)))

    # The stop itself is a jump of the rate.
    assert errors(stop + 25, go - 20) < 0.004
    assert errors(go - 10, last) < 0.033


def test_a_coupler_has_an_ijp_that_is_off_by_a_part_of_its_size() -> None:
    recording = _record.make_recording(('four-bar coupler',), (1e-5,), 3, 4.0)
    assert float(np.sqrt(np.mean(told(recording, 'IJP')[0] ** 2))) < 0.021


def test_settling_changes_nothing() -> None:
    seen = frames(2 * np.sin(np.arange(400) / 30), 1e-3)
    idle, asked = (Tracker(settings_from(VALUES)) for _ in range(2))
    for k in range(400):
        one = part_of(seen, slice(k, k + 1))
        (now,) = instants(asked.add(one, 3)) or (None,)
        asked.learn_if_due()
        (then,) = instants(idle.add(one, 3)) or (None,)
        if now is not None and then is not None:
            np.testing.assert_array_equal(now.angle, then.angle)
            np.testing.assert_array_equal(now.pole(3).value, then.pole(3).value)


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


def test_what_is_done_to_an_answer_changes_none_after_it() -> None:
    points = _record.make_recording(('four-bar coupler',), (1e-3,), 1, 2.5).points
    seen, settings = _record.frames_of(points, _record.stamps_of(len(points)))

    def figures(spoil: bool) -> list[np.ndarray]:
        tracker, found = Tracker(settings), []
        for k in range(len(points)):
            for one in instants(tracker.add(part_of(seen, slice(k, k + 1)), 3)):
                found += [one.angle.copy(), one.pole(3).value.copy()]
                if spoil:
                    for array in (one.angle, one.position, one.angle_covariance, one.size):
                        array[...] = np.nan
        return found

    for one, other in zip(figures(False), figures(True), strict=True):
        np.testing.assert_array_equal(one, other)


def test_no_combination_of_derivatives_has_a_variance_below_zero() -> None:
    recording = _record.make_recording(('stop and go', 'dead point'), (1e-5, 1e-3), 2, 6.0)
    seen, settings = _record.frames_of(recording.points, _record.stamps_of(1200))
    (found,) = Tracker(settings).add(seen, 4)
    for matrix in (found.position_covariance, found.angle_covariance):
        ordered = np.moveaxis(matrix, (0, 1), (-2, -1))
        deviations = np.sqrt(np.einsum('...kk->...k', ordered))
        deviations[deviations == 0] = 1.0
        correlation = ordered / deviations[..., None] / deviations[..., None, :]
        assert np.linalg.eigvalsh(correlation).min() > -1e-12
