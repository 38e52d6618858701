"""Rates, poles and centrodes against the seeds' printed figures and motions known exactly."""

import doctest
import pkgutil
from collections.abc import Callable
from importlib import import_module
from math import factorial
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from kinpole_ros import planar
from kinpole_ros.mechanism import rotation_derivatives
from kinpole_ros.planar import LandmarkKinematics, landmark_kinematics
from kinpole_ros.planar._poles import point_motion

pytestmark = pytest.mark.filterwarnings('error')

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]  # z (5,), angle (5,), arms (n,)
RATES = ('angular_velocity', 'angular_acceleration', 'angular_jerk', 'angular_snap')
POLES = ('icr', 'iap', 'ijp', 'isp')
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])

# Seed 000, t_lm2kin2d: points B3 and C3 of a four-bar, position to jerk.
WEB_CUTTER = np.array(
    [
        [(3.7588, 1.3681), (3.9407, 29.3675)],
        [(-5.4874, 15.0764), (22.5296, 14.8943)],
        [(-60.4716, -22.0098), (-42.8075, -50.1604)],
        [(88.2815, -242.5514), (-673.2083, -291.1768)],
    ]
)


@st.composite
def motions(draw: st.DrawFn) -> Motion:
    """A body that turns, its pose's derivatives up to snap, and two or more points on it."""
    plane = st.complex_numbers(max_magnitude=3)
    position = np.array([draw(plane) for _ in range(5)])
    rate = draw(st.floats(0.3, 3)) * draw(st.sampled_from((-1, 1)))
    angle = np.array([draw(st.floats(-3, 3)), rate, *(draw(st.floats(-3, 3)) for _ in range(3))])
    assume(all(abs(rotation_derivatives(angle)[k]) > 0.1 for k in (3, 4)))
    arms = np.array([-0.5, 0.7j, *draw(st.lists(plane, max_size=4))])
    return position, angle, arms


def derivatives(motion: Motion) -> np.ndarray:
    """Exact derivatives (5, n) of the points of a body, complex."""
    position, angle, arms = motion
    return position[:, None] + rotation_derivatives(angle)[:, None] * arms


def kinematics(complex_derivatives: np.ndarray, weights: Any = None) -> LandmarkKinematics:
    """What landmark_kinematics makes of (K, n) complex derivatives."""
    return at_once(planar.to_plane(complex_derivatives), weights)


def at_once(vectors: Any, weights: Any = None) -> LandmarkKinematics:
    """What landmark_kinematics makes of derivatives (K, ..., n, 2) in one array."""
    return landmark_kinematics(*vectors, weights=weights)  # type: ignore[misc]


def flat(result: LandmarkKinematics) -> np.ndarray:
    """All published fields, in one row."""
    names = (*RATES, *POLES, 'icr_velocity', 'centrode_curvature')
    return np.concatenate([np.ravel(getattr(result, name)) for name in names])


def quotient(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    """Coefficients of the quotient of two power series."""
    result: list[Any] = []
    for k, c in enumerate(numerator):
        known = sum(result[j] * denominator[k - j] for j in range(k))
        result.append((c - known) / denominator[0])
    return np.array(result)


def centrode_series(motion: Motion) -> tuple[complex, complex, float]:
    """Velocity, acceleration and curvature of the ICR z + i z'/angle', from its power series."""
    position, angle, _ = motion
    scale = np.array([factorial(k) for k in range(3)])
    icr = position[:3] / scale + 1j * quotient(position[1:4] / scale, angle[1:4] / scale)
    u, du = complex(icr[1]), complex(2 * icr[2])
    return u, du, (u.conjugate() * du).imag / abs(u) ** 3 if abs(u) > 1e-3 else 0.0


# --- the printed figures ------------------------------------------------------------------------


def test_web_cutter_gives_the_figures_printed_in_the_seed() -> None:
    found = at_once(WEB_CUTTER, [1, 1])
    printed = {
        'angular_velocity': -1.0006,
        'icr': (18.8257, 6.8520),
        'angular_acceleration': -0.6374,
        'iap': (-49.1784, 13.0846),
        'angular_jerk': 26.1823,
        'ijp': (12.8647, 3.9747),
        'icr_velocity': (-37.0807, 72.0169),
        'centrode_curvature': -0.0151,
    }
    for name, value in printed.items():
        # The inputs are printed rounded too, so the last digit may be off by one.
        assert getattr(found, name) == pytest.approx(value, abs=1e-4), name


def test_the_function_of_the_seed_has_its_eight_outputs() -> None:
    matrices = [part.T for part in WEB_CUTTER]
    w, icr, wd, iap, wdd, ijp, velocity, curvature = planar.im2kin2d([1, 1], *matrices)
    assert (w, wd, wdd) == pytest.approx((-1.0006, -0.6374, 26.1823), abs=1e-4)
    found = np.array([icr, iap, ijp, velocity])
    printed = [(18.8257, 6.8520), (-49.1784, 13.0846), (12.8647, 3.9747), (-37.0807, 72.0169)]
    assert found == pytest.approx(np.array(printed), abs=1e-4)
    assert curvature == pytest.approx(-0.0151, abs=1e-4)
    # A landmark that is not available may hold anything.
    more = [np.column_stack((part, [np.nan, 7.0])) for part in matrices]
    again = planar.im2kin2d([1, 1, 0], *more)
    # A row for each landmark, as other functions take them.
    with pytest.raises(ValueError, match=r'rd must have shape \(2, 3\), two rows .* not \(3, 2\)'):
        planar.im2kin2d([1, 1, 1], more[0], np.transpose(more[1]), *more[2:])
    assert np.concatenate(list(map(np.ravel, again))) == pytest.approx(
        np.concatenate([[w], icr, [wd], iap, [wdd], ijp, velocity, [curvature]]), rel=1e-12
    )


def test_rigid_link_gives_the_figures_printed_in_the_seed() -> None:
    r, v = [(43, 56), (90, 80)], [(83.38, -38.88), (53.56, 19.50)]
    still = np.zeros((2, 2))
    found = landmark_kinematics(r, v, still, still, weights=[1, 1])
    assert found.angular_velocity == pytest.approx(1.2422, abs=0.5e-4)
    assert found.icr == pytest.approx((74.3006, 123.1197), abs=0.5e-4)
    velocity = planar.point_derivatives(found, [27, 121])[0]
    assert velocity == pytest.approx((2.633, -58.757), abs=0.5e-3)
    assert np.hypot(*velocity) == pytest.approx(58.82, abs=0.005)
    assert np.degrees(np.arctan2(velocity[1], velocity[0])) == pytest.approx(-87.43, abs=0.005)


# --- exact motions ------------------------------------------------------------------------------


@given(motions())
def test_rates_and_poles_of_an_exact_motion_are_found(motion: Motion) -> None:
    position, angle, _ = motion
    found = kinematics(derivatives(motion))
    for k, name in enumerate(RATES, 1):
        assert getattr(found, name) == pytest.approx(angle[k], abs=1e-10), name
    rotation = rotation_derivatives(angle)
    for k, name in enumerate(POLES, 1):
        # The body's point whose k-th derivative z(k) + w (e^{i angle})(k) vanishes.
        truth = position[0] - rotation[0] * position[k] / rotation[k]
        assert getattr(found, name) == pytest.approx(planar.to_plane(truth), rel=1e-9, abs=1e-9)
    for k, moved in enumerate(planar.point_derivatives(found, found.icr), 1):
        arm = planar.to_complex(found.icr) - position[0]
        truth = position[k] + rotation[k] / rotation[0] * arm
        assert moved == pytest.approx(planar.to_plane(truth), rel=1e-9, abs=1e-7)
    u, _, curvature = centrode_series(motion)
    assert found.icr_velocity == pytest.approx(planar.to_plane(u), rel=1e-9, abs=1e-8)
    assume(abs(u) > 0.1)
    assert found.centrode_curvature == pytest.approx(curvature, rel=1e-7, abs=1e-7)


@given(motions(), st.complex_numbers(max_magnitude=3))
def test_points_move_as_the_seeds_matrices_say(motion: Motion, point: complex) -> None:
    found = kinematics(derivatives(motion))
    w, a, j, s = (getattr(found, name) for name in RATES)
    one = np.eye(2)
    matrices = (
        w * TURN,
        a * TURN - w**2 * one,
        (j - w**3) * TURN - 3 * w * a * one,
        (s - 6 * w**2 * a) * TURN + (w**4 - 4 * w * j - 3 * a**2) * one,
    )
    p = np.array([point.real, point.imag])
    for matrix, name, moved in zip(
        matrices, POLES, planar.point_derivatives(found, p), strict=True
    ):
        assert moved == pytest.approx(matrix @ (p - getattr(found, name)), rel=1e-8, abs=1e-8)


@given(motions())
def test_icr_derivatives_are_those_of_its_power_series(motion: Motion) -> None:
    position, angle, _ = motion
    u, du, _ = centrode_series(motion)
    assert planar.icr_velocity(position, angle).value == pytest.approx(u, rel=1e-9, abs=1e-9)
    assert planar.icr_acceleration(position, angle).value == pytest.approx(du, rel=1e-9, abs=1e-8)


@given(motions(), st.floats(-3, 3), st.complex_numbers(max_magnitude=5), st.floats(0.1, 10))
def test_turning_moving_and_scaling_the_scene_does_so_to_the_answer(
    motion: Motion, turn: float, shift: complex, scale: float
) -> None:
    assume(abs(centrode_series(motion)[0]) > 0.1)
    d = derivatives(motion)
    factor = scale * np.exp(1j * turn)
    moved = factor * d
    moved[0] += shift
    before, after = kinematics(d), kinematics(moved)
    for name in RATES:
        assert getattr(after, name) == pytest.approx(getattr(before, name), abs=1e-9)
    for name in POLES:
        expected = factor * planar.to_complex(getattr(before, name)) + shift
        assert planar.to_complex(getattr(after, name)) == pytest.approx(
            expected, rel=1e-8, abs=1e-7
        )
    expected = factor * planar.to_complex(before.icr_velocity)
    assert planar.to_complex(after.icr_velocity) == pytest.approx(expected, rel=1e-8, abs=1e-7)
    assert after.centrode_curvature * scale == pytest.approx(
        before.centrode_curvature, rel=1e-6, abs=1e-6
    )


@given(motions())
def test_a_mirrored_scene_turns_the_other_way(motion: Motion) -> None:
    assume(abs(centrode_series(motion)[0]) > 0.1)
    before, after = kinematics(derivatives(motion)), kinematics(derivatives(motion).conj())
    for name in (*RATES, 'centrode_curvature'):
        assert getattr(after, name) == pytest.approx(-getattr(before, name), rel=1e-8, abs=1e-8)
    for name in (*POLES, 'icr_velocity'):
        expected = getattr(before, name) * (1, -1)
        assert getattr(after, name) == pytest.approx(expected, rel=1e-8, abs=1e-8)


@given(motions(), st.sampled_from((-1.0, 0.25, 3.0, -2.0)))
def test_time_run_faster_or_backward_keeps_poles_and_scales_rates(
    motion: Motion, factor: float
) -> None:
    assume(abs(centrode_series(motion)[0]) > 0.1)
    d = derivatives(motion)
    before, after = kinematics(d), kinematics(d * factor ** np.arange(5)[:, None])
    for k, name in enumerate(RATES, 1):
        expected = factor**k * getattr(before, name)
        assert getattr(after, name) == pytest.approx(expected, rel=1e-8, abs=1e-8)
    for name in POLES:
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-8, abs=1e-7)
    assert after.icr_velocity == pytest.approx(factor * before.icr_velocity, rel=1e-8, abs=1e-7)
    # Signed along the way the ICR goes.
    assert after.centrode_curvature == pytest.approx(
        np.sign(factor) * before.centrode_curvature, rel=1e-6, abs=1e-6
    )


@given(motions(), st.tuples(st.floats(0.3, 2), *[st.floats(-3, 3)] * 3))
def test_curvature_and_icr_do_not_depend_on_how_a_mechanism_is_driven(
    motion: Motion, drive: tuple[float, ...]
) -> None:
    position, angle, arms = motion
    assume(abs(centrode_series(motion)[0]) > 0.1)
    scale = np.array([factorial(k) for k in range(5)])
    input_series = np.array([0.0, *drive]) / scale[:5]

    def driven(values: np.ndarray) -> np.ndarray:
        """Derivatives of values(s(t)) from those of values(s): composed power series."""
        total = np.zeros(5, values.dtype)
        power = np.eye(5)[0]
        for value in values / scale:
            total += value * power
            power = np.convolve(power, input_series)[:5]
        return total * scale

    before = kinematics(derivatives(motion))
    after = kinematics(derivatives((driven(position), driven(angle), arms)))
    assert after.icr == pytest.approx(before.icr, rel=1e-8, abs=1e-8)
    assert after.centrode_curvature == pytest.approx(before.centrode_curvature, rel=1e-6, abs=1e-6)


# --- many bodies, weights -----------------------------------------------------------------------


def batch(rng: np.random.Generator, shape: tuple[int, ...], landmarks: int = 4) -> np.ndarray:
    """Exact derivatives (5, *shape, n, 2) of random bodies."""
    position = rng.normal(size=(5, *shape, 2)) @ (1, 1j)
    angle = rng.normal(size=(5, *shape))
    arms = rng.normal(size=(*shape, landmarks, 2)) @ (1, 1j)
    moved = position[..., None] + rotation_derivatives(angle)[..., None] * arms
    return planar.to_plane(moved)


def test_bodies_in_a_batch_come_out_as_one_by_one() -> None:
    rng = np.random.default_rng(1)
    d = batch(rng, (3, 5))
    weights = rng.uniform(0.1, 2, (3, 5, 4))
    together = at_once(d, weights)
    assert together.icr.shape == (3, 5, 2)
    assert together.angular_snap.shape == together.centrode_curvature.shape == (3, 5)
    assert together.position.shape == (5, 3, 5, 2)
    assert together.angle.shape == (5, 3, 5)
    mean = (weights[..., None] * d[0]).sum(axis=-2) / weights.sum(axis=-1)[..., None]
    assert together.position[0] == pytest.approx(mean)
    for index in np.ndindex(3, 5):
        alone = at_once(d[:, index[0], index[1]], weights[index])
        for name in (*RATES, *POLES, 'icr_velocity', 'centrode_curvature'):
            one = getattr(together, name)[index]
            assert one == pytest.approx(getattr(alone, name), rel=1e-12), name


def test_one_row_of_weights_serves_a_whole_batch() -> None:
    d = batch(np.random.default_rng(2), (6,))
    weights = np.array([1.0, 0.0, 2.0, 1.0])
    shared = at_once(d, weights)
    each = at_once(d, np.tile(weights, (6, 1)))
    assert np.array_equal(flat(shared), flat(each))


def test_a_landmark_of_weight_0_may_hold_anything() -> None:
    # Noise makes every landmark count.
    rng = np.random.default_rng(3)
    d = batch(rng, (7,)) + 0.01 * rng.normal(size=(5, 7, 4, 2))
    without = at_once(np.delete(d, 2, axis=-2))
    for anything in (np.nan, np.inf, -1e300, 5.0):
        d[..., 2, :] = anything
        found = at_once(d, [1, 1, 0, 1])
        assert flat(found) == pytest.approx(flat(without), rel=1e-9)


def test_weight_2_is_a_landmark_seen_twice() -> None:
    rng = np.random.default_rng(4)
    d = batch(rng, (7,)) + 0.01 * rng.normal(size=(5, 7, 4, 2))
    twice = np.concatenate((d, d[..., 1:2, :]), axis=-2)
    weighted = at_once(d, [1, 2, 1, 1])
    assert flat(weighted) == pytest.approx(flat(at_once(twice)), rel=1e-9)
    # A common factor of the weights changes nothing.
    tripled = at_once(d, [3, 6, 3, 3])
    assert flat(tripled) == pytest.approx(flat(weighted), rel=1e-9)


def test_the_order_of_the_landmarks_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    d = batch(rng, (7,), 6) + 0.01 * rng.normal(size=(5, 7, 6, 2))
    weights = rng.uniform(0, 1, 6)
    order = rng.permutation(6)
    shuffled = at_once(d[..., order, :], weights[order])
    straight = at_once(d, weights)
    assert flat(shuffled) == pytest.approx(flat(straight), rel=1e-8)


@pytest.mark.parametrize('offset', [1e3, 1e7])
def test_a_far_origin_costs_no_more_than_its_own_rounding(offset: float) -> None:
    d = batch(np.random.default_rng(6), (20,))
    near = at_once(d)
    d[0] += offset
    far = at_once(d)
    # Landmarks known to eps * offset, with the rates and arms of these bodies.
    allowed = 1e3 * np.finfo(float).eps * offset
    for k, name in enumerate(RATES):
        assert getattr(far, name) == pytest.approx(getattr(near, name), abs=allowed * 10**k)
    for k, name in enumerate(POLES):
        scale = np.linalg.norm(getattr(near, name), axis=-1).max()
        difference = np.abs(getattr(far, name) - offset - getattr(near, name))
        assert difference.max() < allowed * 10**k * (1 + scale) ** 2, name


# --- what is not determined ---------------------------------------------------------------------


def nan_fields(found: LandmarkKinematics) -> set[str]:
    """Names of the published fields that are NaN; a field must not be NaN in part."""
    result = set()
    for name in (*RATES, *POLES, 'icr_velocity', 'centrode_curvature'):
        bad = np.isnan(getattr(found, name))
        assert bad.all() or not bad.any(), name
        if bad.any():
            result.add(name)
    return result


GENERAL = (
    np.array([0.2 + 1j, 1 - 0.5j, -2 + 1j, 0.7 + 2j, -1 - 1j]),
    np.array([0.3, 1.1, -0.8, 0.5, 0.9]),
    np.array([0.4, -0.3 + 0.2j, 0.1 - 0.6j]),
)


@pytest.mark.parametrize(
    ('known', 'missing'),
    [
        (2, {*RATES[1:], *POLES[1:], 'icr_velocity', 'centrode_curvature'}),
        (3, {*RATES[2:], *POLES[2:], 'centrode_curvature'}),
        (4, {'angular_snap', 'isp'}),
        (5, set()),
    ],
)
def test_a_missing_order_leaves_out_only_what_needs_it(known: int, missing: set[str]) -> None:
    found = kinematics(derivatives(GENERAL)[:known])
    assert nan_fields(found) == missing
    full = flat(kinematics(derivatives(GENERAL)))
    some = flat(found)
    assert some[~np.isnan(some)] == pytest.approx(full[~np.isnan(some)], rel=1e-12)
    moved = planar.point_derivatives(found, [0.0, 0.0])
    assert [np.isfinite(m).all() for m in moved] == [k < known for k in range(1, 5)]


EVERYTHING = {*RATES, *POLES, 'icr_velocity', 'centrode_curvature'}


@pytest.mark.parametrize(
    'points',
    [[], [0.3 + 0.1j], [0.1 + 0.7j] * 2, [0.1 + 0.7j] * 3, [1e7 + 0.3j] * 5],
    ids=['none', 'one', 'two at one place', 'three at one place', 'five far away at one place'],
)
def test_landmarks_that_do_not_span_the_body_tell_nothing(points: list[complex]) -> None:
    d = np.array([points, *np.random.default_rng(7).normal(size=(4, len(points)))])
    assert nan_fields(kinematics(d)) == EVERYTHING


def test_weights_can_leave_too_few_landmarks() -> None:
    for weights in ([0, 0, 0], [0, 3, 0]):
        assert nan_fields(kinematics(derivatives(GENERAL), weights)) == EVERYTHING


def still(**given: float) -> np.ndarray:
    """Derivatives of GENERAL's points with only the named derivatives of its angle kept."""
    angle = np.zeros(5)
    for name, value in given.items():
        angle[RATES.index(name) + 1] = value
    return derivatives((GENERAL[0], angle, GENERAL[2]))


@pytest.mark.parametrize('offset', [0.0, 0.1, 1e6])
def test_a_body_that_does_not_turn_has_rates_0_and_no_poles(offset: float) -> None:
    translating = still()
    translating[0] += offset
    at_rest = np.zeros_like(translating)
    at_rest[0] = translating[0]
    for d in (translating, at_rest):
        found = kinematics(d)
        assert nan_fields(found) == EVERYTHING - set(RATES)
        for name in RATES:
            assert getattr(found, name) == pytest.approx(0, abs=1e-14 * (1 + offset))
        for moved, truth in zip(planar.point_derivatives(found, [9, 9]), d[1:, 0], strict=True):
            assert moved == pytest.approx(planar.to_plane(truth), abs=1e-12 * (1 + offset))


@pytest.mark.parametrize('unit', [2.0**-60, 2.0**60])
def test_what_is_rounding_goes_by_the_size_of_the_body_whatever_the_unit(unit: float) -> None:
    """Powers of two, which do not round: rates and what is determined are the same to the bit."""
    rng = np.random.default_rng(5)
    points, velocities = rng.normal(size=(2, 400, 3, 2))
    # Of bodies that translate, to within some roundings.
    velocities = velocities[:, :1] + 2.0 ** rng.uniform(-50, -38, (400, 1, 1)) * velocities
    plain = planar.landmark_kinematics(points, velocities)
    scaled = planar.landmark_kinematics(unit * points, unit * velocities)
    assert 50 < np.isnan(plain.icr[:, 0]).sum() < 350
    assert scaled.angular_velocity.tolist() == plain.angular_velocity.tolist()
    np.testing.assert_array_equal(scaled.icr, unit * plain.icr)


def test_where_the_turning_starts_or_reverses_only_the_icr_is_missing() -> None:
    found = kinematics(still(angular_acceleration=2.0))
    assert nan_fields(found) == {'icr', 'ijp', 'icr_velocity', 'centrode_curvature'}
    # B = i alpha: z - z'' / (2 i).
    truth = GENERAL[0][0] - GENERAL[0][2] / 2j
    assert found.iap == pytest.approx(planar.to_plane(truth))
    found = kinematics(still(angular_acceleration=2.0, angular_jerk=-1.0))
    assert nan_fields(found) == {'icr', 'icr_velocity', 'centrode_curvature'}
    assert found.ijp == pytest.approx(planar.to_plane(GENERAL[0][0] + GENERAL[0][3] / 1j))


def test_a_body_that_turns_evenly_has_all_poles() -> None:
    assert nan_fields(kinematics(still(angular_velocity=2.0))) == set()


@pytest.mark.parametrize('pivot', [0.0, 0.3 - 0.2j, 1e5 + 1j])
def test_a_pinned_body_has_poles_at_the_pin_and_a_centrode_without_curvature(
    pivot: complex,
) -> None:
    position = np.array([pivot, 0, 0, 0, 0], complex)
    found = kinematics(derivatives((position, GENERAL[1], GENERAL[2])))
    assert nan_fields(found) == {'centrode_curvature'}
    for name in POLES:
        expected = planar.to_plane(pivot)
        assert getattr(found, name) == pytest.approx(expected, abs=1e-13 * (10 + abs(pivot)))
    assert found.icr_velocity == pytest.approx((0, 0), abs=1e-12 * (1 + abs(pivot)))


def test_a_straight_centrode_has_curvature_0() -> None:
    wheel = np.array([1j, 2.0, 3.0, -1.0, 0.5])  # radius 1 on the line y = 0, at a changing rate
    angle = np.array([0.4, *-wheel[1:].real])
    found = kinematics(derivatives((wheel, angle, GENERAL[2])))
    assert found.icr == pytest.approx((0, 0), abs=1e-14)
    assert found.icr_velocity == pytest.approx((2, 0), abs=1e-13)
    assert found.centrode_curvature == pytest.approx(0, abs=1e-13)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (([0.0, 1.0], [0.0, 1.0]), 'points must have shape'),
        ((np.zeros((2, 3)), np.zeros((2, 3))), 'points must have shape'),
        ((np.zeros((2, 2)), 3.0), 'velocities must have shape'),
        ((np.zeros((2, 2)), np.zeros((3, 2))), 'velocities must have the shape of points'),
        ((*np.zeros((2, 2, 2)), None, np.zeros((2, 2))), 'jerks need accelerations'),
        ((*np.zeros((2, 2, 2)), None, None, np.zeros((2, 2))), 'snaps need accelerations'),
    ],
)
def test_shapes_that_do_not_fit_are_refused_by_name(arguments: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        landmark_kinematics(*arguments)


@pytest.mark.parametrize(
    ('weights', 'words'),
    [
        ([1, -1], 'not negative'),
        ([1, np.nan], 'finite'),
        ([1, np.inf], 'finite'),
        ([1, 1, 1], 'weights must have shape'),
        (np.ones((4, 2)), 'weights must have shape'),
    ],
)
def test_bad_weights_are_refused(weights: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        landmark_kinematics(np.eye(2), np.eye(2), weights=weights)


def test_there_is_no_pole_of_another_order() -> None:
    for order in (0, 5):
        with pytest.raises(ValueError, match='order must be 1 to 4'):
            planar.pole(order, GENERAL[0], GENERAL[1])


# --- centrodes ----------------------------------------------------------------------------------


def polynomial_motion(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """GENERAL's pose carried on as polynomials of time: (5, N) each."""
    rows = []
    for values in GENERAL[:2]:
        polynomial = np.polynomial.Polynomial(values / [factorial(k) for k in range(5)])
        rows.append(np.array([(polynomial.deriv(k) if k else polynomial)(times) for k in range(5)]))
    return rows[0], rows[1]


def test_the_moving_centrode_rolls_on_the_fixed_one() -> None:
    times = np.linspace(-0.3, 0.3, 6001)
    position, angle = polynomial_motion(times)
    fixed = planar.pole(1, position, angle).value
    u = planar.icr_velocity(position, angle).value
    seen = planar.moving_centrode(planar.to_plane(fixed), planar.to_plane(position[0]), angle[0])
    moving = planar.to_complex(seen)
    step = times[1] - times[0]

    def rate(values: np.ndarray) -> np.ndarray:
        return (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * step)

    inner = slice(2, -2)
    # Both contact points go equally far, in the same direction (seed 001, eq. 15).
    assert rate(fixed) == pytest.approx(u[inner], rel=1e-8)
    assert rate(moving) * np.exp(1j * angle[0, inner]) == pytest.approx(u[inner], rel=1e-8)
    # The curvature of the moving one, as the turning of its tangent.
    curvature = planar.moving_centrode_curvature(
        planar.centrode_curvature(position, angle).value.real, angle[1], np.abs(u)
    )
    heading = np.unwrap(np.angle(rate(moving)))
    turned = rate(heading) / np.abs(u[4:-4])
    assert curvature[4:-4] == pytest.approx(turned, rel=1e-5, abs=1e-5)


# --- uncertainty --------------------------------------------------------------------------------

OTHER = polynomial_motion(np.linspace(-0.5, 0.5, 12))
ARM = np.linspace(0.1, 0.5, 12) - 0.3j
LINEARS: dict[str, Callable[[np.ndarray, np.ndarray], planar.Linear]] = {
    **{f'pole {k}': lambda z, a, k=k: planar.pole(k, z, a) for k in range(1, 5)},  # type: ignore[misc]
    **{f'point {k}': lambda z, a, k=k: point_motion(k, ARM, z, a) for k in range(4)},  # type: ignore[misc]
    'icr_velocity': planar.icr_velocity,
    'icr_acceleration': planar.icr_acceleration,
    'centrode_curvature': planar.centrode_curvature,
    'relative_pole by j': lambda z, a: planar.relative_pole(z, a, *OTHER)[0],
    'relative_pole by i': lambda z, a: planar.relative_pole(*OTHER, z, a)[1],
}


def some_poses() -> tuple[np.ndarray, np.ndarray]:
    """Twelve poses (5, 12) whose denominators are not small."""
    rng = np.random.default_rng(8)
    position = rng.normal(size=(5, 12, 2)) @ (1, 1j)
    angle = rng.uniform(0.5, 1.5, (5, 12)) * rng.choice((-1, 1), (5, 12))
    angle[1] = -np.abs(angle[1])  # OTHER turns the other way
    return position, angle


def differences(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of a quantity per change of x(k), y(k) and angle(k): complex, (5, 12) each."""
    position, angle = some_poses()
    step = 1e-5

    def change(order: int, dz: complex, da: float) -> np.ndarray:
        ends = []
        for sign in (1, -1):
            z, a = position.copy(), angle.copy()
            z[order] += sign * dz
            a[order] += sign * da
            ends.append(LINEARS[name](z, a).value)
        return (ends[0] - ends[1]) / (2 * step)

    return tuple(  # type: ignore[return-value]
        np.array([change(k, dz, da) for k in range(5)])
        for dz, da in ((step, 0), (step * 1j, 0), (0, step))
    )


@pytest.mark.parametrize('name', LINEARS)
def test_partial_derivatives_are_what_small_changes_make(name: str) -> None:
    linear = LINEARS[name](*some_poses())
    part = np.real if name == 'centrode_curvature' else np.asarray
    by_x, by_y, by_angle = differences(name)
    by_position, by_turn = np.zeros((2, 5, 12), complex)
    by_position[linear.position_orders] = linear.by_position
    by_turn[linear.angle_orders] = linear.by_angle
    for k in range(5):
        g = by_position[k]
        allowed = {'rel': 1e-6, 'abs': 1e-6 * max(1.0, np.abs(by_angle).max())}
        assert part(g) == pytest.approx(by_x[k], **allowed), f'x, order {k}'
        assert part(g * 1j) == pytest.approx(by_y[k], **allowed), f'y, order {k}'
        assert part(by_turn[k]) == pytest.approx(by_angle[k], **allowed), f'angle, order {k}'


@pytest.mark.parametrize('name', LINEARS)
def test_covariance_is_that_of_linear_propagation(name: str) -> None:
    rng = np.random.default_rng(9)
    roots = rng.normal(size=(2, 12, 5, 5))
    of_position, of_angle = np.moveaxis(roots @ np.swapaxes(roots, -1, -2), 1, -1)
    columns = np.concatenate(differences(name))  # (15, 12): x(0..4), y(0..4), angle(0..4)
    linear = LINEARS[name](*some_poses())
    for body in range(12):
        full = np.zeros((15, 15))
        for start, block in ((0, of_position), (5, of_position), (10, of_angle)):
            full[start : start + 5, start : start + 5] = block[..., body]
        jacobian = np.array([columns[:, body].real, columns[:, body].imag])
        truth = jacobian @ full @ jacobian.T
        if name == 'centrode_curvature':
            found = planar.variance(linear, of_position, of_angle)[body]
            assert found == pytest.approx(truth[0, 0], rel=1e-5)
        else:
            matrix = planar.covariance(linear, of_position, of_angle)[body]
            assert matrix == pytest.approx(truth, rel=1e-5, abs=1e-5 * np.abs(truth).max())


# --- relative motion ----------------------------------------------------------------------------


def three_bodies(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(2, 3, 2)) @ (1, 1j), np.array([[0.1, 0.2, 0.3], rng.normal(size=3)])


@pytest.mark.parametrize('seed', range(5))
def test_the_relative_center_has_one_velocity_on_both_bodies(seed: int) -> None:
    position, angle = three_bodies(seed)
    centers = {}
    for j, i in ((1, 0), (2, 0), (2, 1)):
        icr = planar.to_plane(planar.pole(1, position, angle).value)
        found = planar.relative_center(angle[1, j], icr[j], angle[1, i], icr[i])
        velocities = [
            planar.body_point_derivative(1, planar.to_complex(found), position[:, k], angle[:, k])
            for k in (j, i)
        ]
        assert velocities[0] == pytest.approx(velocities[1], rel=1e-9, abs=1e-9)
        # The seed's own form, and the other order of the bodies.
        seeds = (angle[1, j] * icr[j] - angle[1, i] * icr[i]) / (angle[1, j] - angle[1, i])
        assert found == pytest.approx(seeds, rel=1e-9, abs=1e-9)
        swapped = planar.relative_center(angle[1, i], icr[i], angle[1, j], icr[j])
        assert swapped == pytest.approx(found, rel=1e-9, abs=1e-9)
        by_j, by_i = planar.relative_pole(position[:, j], angle[:, j], position[:, i], angle[:, i])
        assert by_j.value == by_i.value
        assert planar.to_plane(by_j.value) == pytest.approx(found, rel=1e-9, abs=1e-9)
        centers[j, i] = planar.to_complex(found)
    # Kennedy: the three relative centers are on one line.
    a, b = centers[2, 0] - centers[1, 0], centers[2, 1] - centers[1, 0]
    assert (a * b.conjugate()).imag == pytest.approx(0, abs=1e-9 * float(abs(a) * abs(b)))


def test_relative_to_a_body_at_rest_the_center_is_the_icr() -> None:
    assert planar.relative_center(2.0, [3, 4], 0.0, [7, 7]) == pytest.approx((3, 4))
    assert planar.relative_center(0.0, [7, 7], -2.0, [3, 4]) == pytest.approx((3, 4))
    position, angle = np.array([1 + 1j, 2 - 1j]), np.array([0.5, 2.0])
    at_rest = np.array([5 + 5j, 0])
    center = planar.relative_pole(position, angle, at_rest, np.zeros(2))[0].value
    assert center == pytest.approx(planar.pole(1, position, angle).value)


def test_relative_to_a_body_that_only_translates_there_is_a_center() -> None:
    sliding = np.array([0.3 + 0.1j, 1.0])
    position, angle = np.array([0j, 0j]), np.array([0.0, 2.0])  # turns about the origin
    center = planar.relative_pole(position, angle, sliding, np.zeros(2))[0].value
    assert 2j * center == pytest.approx(1.0)  # there it moves as the slider does


def test_bodies_that_turn_alike_have_no_relative_center() -> None:
    rate = 0.1 + 0.2
    for other in (0.3, rate):  # alike within rounding
        assert np.isnan(planar.relative_center(rate, [0, 0], other, [1, 0])).all()
    assert np.isnan(planar.relative_center(0.0, [0, 0], 0.0, [1, 0])).all()
    assert np.isnan(planar.relative_center(1.0, [np.nan, np.nan], 2.0, [1, 0])).all()
    position = np.array([[0j, 1j], [1 + 0j, 2 + 0j]])
    angle = np.array([0, 1.0])
    alike = planar.relative_pole(position[:, 0], angle, position[:, 1], angle)
    assert not np.isfinite(alike[0].value)


def test_relative_centers_in_a_batch_and_far_away() -> None:
    rng = np.random.default_rng(11)
    rates, centers = rng.normal(size=(2, 4, 3)), rng.normal(size=(2, 4, 3, 2))
    near = planar.relative_center(rates[0], centers[0], rates[1], centers[1])
    far = planar.relative_center(rates[0], centers[0] + 1e7, rates[1], centers[1] + 1e7)
    assert near.shape == (4, 3, 2)
    # Rounding of the far centers, and what the difference of the rates makes of it.
    gain = 1 + np.abs(rates[0] / (rates[0] - rates[1]))
    assert (np.abs(far - 1e7 - near).max(axis=-1) < 1e-8 * gain).all()
    with pytest.raises(ValueError, match='icr_i must have shape'):
        planar.relative_center(1.0, [0, 0], 2.0, [0, 0, 0])


# --- fitting a pose -----------------------------------------------------------------------------

SHAPE = np.array([0.14 + 0.02j, -0.03 + 0.1j, 0.06 - 0.15j, 0.13 + 0.01j, -0.2 - 0.1j])


def placed(position: Any, angle: Any, shape: Any = SHAPE) -> Any:
    return np.asarray(position)[..., None] + np.exp(1j * np.asarray(angle))[..., None] * shape


def test_an_exact_pose_is_found_exactly() -> None:
    rng = np.random.default_rng(12)
    position, angle = rng.normal(size=(30, 2)) @ (1, 1j), rng.uniform(-np.pi, np.pi, 30)
    fit = planar.fit_pose(placed(position, angle), SHAPE, np.ones(5))
    assert fit.position == pytest.approx(position, abs=1e-14)
    assert fit.angle == pytest.approx(angle, abs=1e-14)
    assert np.abs(fit.residual).max() < 1e-14


def test_two_markers_are_enough_and_fewer_are_not() -> None:
    points = placed(1 + 2j, 0.7)
    points[3:] = complex(np.nan, np.inf)
    weights = np.array([[1, 1, 1, 0, 0], [1, 0, 1, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 0, 0]], float)
    fit = planar.fit_pose(np.tile(points, (4, 1)), np.tile(SHAPE, (4, 1)), weights)
    assert fit.angle[:2] == pytest.approx(0.7)
    assert fit.position[:2] == pytest.approx(1 + 2j)
    assert np.isnan(fit.angle[2:]).all()
    assert np.isnan(fit.position[2:]).all()
    assert np.array_equal(np.isnan(fit.residual[:2]), weights[:2] == 0)
    assert (fit.freedom[weights == 0] == 0).all()


@pytest.mark.parametrize('place', [0j, 0.1 + 0.1j, 0.3 - 0.7j, 1e6 + 0.1j])
def test_markers_at_one_place_have_no_pose(place: complex) -> None:
    at_one_place = np.full(5, place, complex)
    seen_at_one_place = planar.fit_pose(at_one_place, SHAPE, np.ones(5))
    known_at_one_place = planar.fit_pose(placed(1, 0.3), at_one_place, np.ones(5))
    for fit in (seen_at_one_place, known_at_one_place):
        assert np.isnan(fit.angle)
        assert np.isnan(fit.position)
    # The shape and the weights have a precision also where the points have no pose.
    assert seen_at_one_place.freedom.sum() == pytest.approx(7)
    assert np.isfinite([seen_at_one_place.spread, seen_at_one_place.weight]).all()


@pytest.mark.parametrize('scale', [1e-9, 1e-6, 1.0, 1e6])
def test_a_small_body_and_a_far_one_have_a_pose(scale: float) -> None:
    shape = np.asarray(scale * SHAPE, complex)
    for offset in (0.0, 1e6 * scale):
        fit = planar.fit_pose(placed(offset, 0.3, shape), shape, np.ones(5))
        assert fit.angle == pytest.approx(0.3, abs=1e-8)


@pytest.mark.parametrize('count', [3, 4, 6])
def test_a_regular_polygon_and_its_mirror_have_no_pose(count: int) -> None:
    """Every rotation fits alike, so what is left of the sum is rounding."""
    shape = 0.1 * np.exp(2j * np.pi * np.arange(count) / count)
    fit = planar.fit_pose(3.0 + 1j + shape.conj(), shape, np.ones(count))
    assert np.isnan(fit.angle)
    assert np.isnan(fit.position)


def test_the_fit_is_the_least_sum_of_squares() -> None:
    rng = np.random.default_rng(13)
    weights = rng.uniform(0.2, 2, 5)
    points = placed(0.5 - 0.2j, 2.8) + 0.05 * (rng.normal(size=(5, 2)) @ (1, 1j))
    fit = planar.fit_pose(points, SHAPE, weights)

    def cost(position: Any, angle: Any) -> np.ndarray:
        return (weights * np.abs(points - placed(position, angle)) ** 2).sum(axis=-1)

    best = cost(fit.position, fit.angle)
    assert best == pytest.approx((weights * np.abs(fit.residual) ** 2).sum())
    around = np.linspace(-np.pi, np.pi, 721)
    # For each angle the best position is the one that joins the means.
    joined = (weights * (points - placed(0.0, around))).sum(axis=-1) / weights.sum()
    assert (cost(joined, around) >= best).all()
    for step in (1e-3, -1e-3, 1e-3j, -1e-3j):
        assert cost(fit.position + step, fit.angle) > best
        assert cost(fit.position, fit.angle + (step.real or step.imag)) > best
    arm = SHAPE - (weights * SHAPE).sum() / weights.sum()
    assert (weights * fit.residual).sum() == pytest.approx(0, abs=1e-14)
    assert (weights * (arm.conj() * fit.residual).imag).sum() == pytest.approx(0, abs=1e-14)
    assert fit.spread == pytest.approx((weights * np.abs(arm) ** 2).sum())
    off_center = np.abs(SHAPE[0] - arm[0]) ** 2 / fit.spread
    assert fit.weight == pytest.approx(1 / (1 / weights.sum() + off_center))


@pytest.mark.parametrize('count', [2, 3, 4, 5])
def test_residuals_have_the_freedom_they_are_said_to_have(count: int) -> None:
    rng = np.random.default_rng(14)
    shape = SHAPE[:count]
    noise = 1e-4 * (rng.normal(size=(20_000, count, 2)) @ (1, 1j))
    fit = planar.fit_pose(placed(np.zeros(20_000), 0.4, shape) + noise, shape, np.ones(count))
    assert fit.freedom.sum(axis=-1) == pytest.approx(2 * count - 3)
    measured = (np.abs(fit.residual) ** 2).mean(axis=0) / 1e-8
    assert measured == pytest.approx(fit.freedom[0], rel=0.05, abs=0.01)
    # What the tracker weighs the poses with.
    assert fit.angle.var() == pytest.approx(1e-8 / fit.spread[0], rel=0.05)
    variance = (np.abs(fit.position - fit.position.mean()) ** 2).mean() / 2
    # Only across the arm of the mean does turning move the origin.
    across, along = 1e-8 / fit.weight[0], 1e-8 / count
    assert variance == pytest.approx((across + along) / 2, rel=0.05)


def test_one_covariance_serves_many_instants() -> None:
    """Whatever axes poses and covariances have of their own, they go together as arrays do."""
    rng = np.random.default_rng(7)
    position = rng.normal(size=(3, 6, 2)) + 1j * rng.normal(size=(3, 6, 2))
    angle = rng.normal(size=(3, 6, 2))
    half = rng.normal(size=(3, 3, 2))
    spread = np.einsum('kab,mab->kmb', half, half)
    pole = planar.pole(2, position, angle)
    wide = np.repeat(spread[:, :, None], 6, axis=2)
    expected = planar.covariance(pole, wide, wide)
    assert np.array_equal(planar.covariance(pole, spread, spread), expected)
    one = planar.pole(2, position[:, 0, 0], angle[:, 0, 0])
    assert np.allclose(planar.covariance(one, wide, wide)[0, 0], expected[0, 0])


def test_examples_in_docstrings() -> None:
    names = [module.name for module in pkgutil.iter_modules(planar.__path__, 'kinpole_ros.planar.')]
    results = [doctest.testmod(import_module(name)) for name in names]
    assert sum(result.attempted for result in results) >= 3
    assert not any(result.failed for result in results)
