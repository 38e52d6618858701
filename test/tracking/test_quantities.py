"""Compiled poles, ICR velocities and curvatures equal those of numpy, and so do their gates."""

from typing import NamedTuple

import numpy as np
import pytest

from kinpole_ros import planar
from kinpole_ros.planar._poles import pole, rotation
from kinpole_ros.planar._uncertainty import covariance, mean_square, variance
from kinpole_ros.tracking.quantities import (
    CIRCLE_CENTER,
    CIRCLE_DIAMETER,
    CURVATURE,
    DETERMINED,
    FREE,
    MOVES,
    VELOCITY,
    compute_quantity,
    motion_of,
    relative_centers,
)
from kinpole_ros.tracking.reasons import FARTHEST, KNOWN, REASONS

pytestmark = pytest.mark.filterwarnings('error')

QUANTITIES = {
    **{f'pole of order {n}': n for n in range(1, 5)},
    **{f'free pole of order {n}': FREE + n for n in range(1, 5)},
    'velocity': VELOCITY,
    'curvature': CURVATURE,
    'circle center': CIRCLE_CENTER,
    'circle diameter': CIRCLE_DIAMETER,
}
# The highest derivatives that each needs.
NEEDED = {VELOCITY: 2, CURVATURE: 3, CIRCLE_CENTER: 2, CIRCLE_DIAMETER: 2}


class Arrays(NamedTuple):
    """The arguments of `Motion`."""

    position: np.ndarray
    angle: np.ndarray
    position_covariance: np.ndarray
    angle_covariance: np.ndarray
    size: np.ndarray
    pin: np.ndarray
    pin_variance: np.ndarray


def motion(orders: int, shape: tuple[int, ...], noise: float = 0.01) -> Arrays:
    """Random motion up to some order, with every third body on a pin."""
    rng = np.random.default_rng(orders)
    position = rng.normal(size=(orders + 1, *shape, 2)).view(complex)[..., 0]
    angle = rng.normal(scale=3.0, size=(orders + 1, *shape))
    mixed = rng.normal(scale=noise, size=(2, *shape, orders + 1, orders + 1))
    covariances = np.moveaxis(mixed @ mixed.swapaxes(-1, -2), (-2, -1), (1, 2))
    pin = rng.normal(size=(*shape, 2)).view(complex)[..., 0]
    pin = np.where(rng.random(shape) < 1 / 3, pin, np.nan)
    pin_variance = np.where(np.isnan(pin), np.nan, noise**2)
    return Arrays(position, angle, *covariances, 10 ** rng.uniform(-4, 1, shape), pin, pin_variance)


class Expected(NamedTuple):
    """A quantity: value, covariance (..., 2, 2), where it is determined, where the ICR moves."""

    value: np.ndarray
    spread: np.ndarray
    determined: np.ndarray
    moves: np.ndarray


def pole_of_numpy(order: int, m: Arrays) -> Expected:
    turn = a, by_angle = rotation(order, m.angle)
    found = pole(order, m.position, m.angle, turn)
    spread = covariance(found, m.position_covariance, m.angle_covariance)
    noise = mean_square(by_angle, m.angle_covariance[1 : order + 1, 1 : order + 1])
    near = np.abs(found.value - m.position[0]) < 1e3 * m.size
    determined = (np.abs(a) / np.sqrt(noise) > 4) & near & np.isfinite(spread).all(axis=(-2, -1))
    return Expected(found.value, spread, determined, np.zeros_like(determined))


def on_pins(order: int, m: Arrays) -> Expected:
    """The pole of an order, on the pin where there is one."""
    free, pinned = pole_of_numpy(order, m), np.isfinite(m.pin)
    variances = np.einsum('kk...->k...', m.angle_covariance[: order + 1, : order + 1])
    turns = (np.abs(m.angle[1 : order + 1]) > 4 * np.sqrt(variances[1:])).any(axis=0)
    on_pin = m.pin_variance[..., None, None] * np.eye(2)
    return Expected(
        np.where(pinned, m.pin, free.value),
        np.where(pinned[..., None, None], on_pin, free.spread),
        free.determined | (pinned & turns),
        free.moves,
    )


def velocity_of_numpy(m: Arrays) -> Expected:
    found, pinned, icr = planar.icr_velocity(m.position, m.angle), np.isfinite(m.pin), on_pins(1, m)
    spread = covariance(found, m.position_covariance, m.angle_covariance)
    value = np.where(pinned, 0.0, found.value)
    spread = np.where(pinned[..., None, None], 0.0, spread)
    known = np.isfinite(value) & np.isfinite(spread).all(axis=(-2, -1))
    deviation = np.sqrt(np.einsum('...ii->...', spread))
    near = np.abs(icr.value - m.position[0]) < 1e3 * m.size
    least = np.maximum(1.7 * deviation, 1e-6 * np.abs(m.angle[1]) * m.size)
    return Expected(value, spread, icr.determined & known, near & (np.abs(value) > least))


def curvature_of_numpy(m: Arrays) -> Expected:
    found, u = planar.centrode_curvature(m.position, m.angle), velocity_of_numpy(m)
    noise = variance(found, m.position_covariance, m.angle_covariance)
    slowness = np.einsum('...ii->...', u.spread) / 2 / np.abs(u.value) ** 2
    # The curvature of a path with all of the acceleration across it.
    largest = np.abs(planar.icr_acceleration(m.position, m.angle).value / u.value**2)
    noise = noise + 18 * (largest * slowness) ** 2
    turns = m.angle[1] ** 2 > 1.5**2 * m.angle_covariance[1, 1]
    determined = u.moves & turns & np.isfinite(found.value) & np.isfinite(noise)
    return Expected(found.value, noise[..., None, None] * np.ones((2, 2)), determined, u.moves)


def circle_of_numpy(what: int, m: Arrays) -> Expected:
    """By differences over so little noise that they are partial derivatives."""
    little = 1e-6 / np.sqrt(np.nanmax(m.angle_covariance))

    def circle(position: np.ndarray, angle: np.ndarray) -> np.ndarray:
        icr, u = planar.pole(1, position, angle).value, planar.icr_velocity(position, angle).value
        vectors = planar.to_plane(icr), planar.to_plane(u)
        center, diameter = planar.inflection_circle(angle[1], *vectors)
        return diameter + 0j if what == CIRCLE_DIAMETER else planar.to_complex(center)

    spreads = m.position_covariance * little**2, m.angle_covariance * little**2
    value, spread = planar.propagate(circle, m.position, m.angle, *spreads)
    spread = spread / little**2
    if what == CIRCLE_DIAMETER:
        spread = spread[..., :1, :1] * np.ones((2, 2))
    u, center = velocity_of_numpy(m), value
    if what == CIRCLE_DIAMETER:
        center = of_numpy(CIRCLE_CENTER, m).value
    near = np.abs(center - m.position[0]) < 1e3 * m.size
    known = np.isfinite(value) & np.isfinite(spread).all(axis=(-2, -1))
    return Expected(value, spread, u.moves & u.determined & near & known, u.moves)


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def of_numpy(what: int, m: Arrays) -> Expected:
    if what in (CIRCLE_CENTER, CIRCLE_DIAMETER):
        return circle_of_numpy(what, m)
    if what == VELOCITY:
        return velocity_of_numpy(m)
    if what == CURVATURE:
        return curvature_of_numpy(m)
    return pole_of_numpy(what - FREE, m) if what > FREE else on_pins(what, m)


def assert_equal(found: np.ndarray, expected: np.ndarray) -> None:
    known = np.isfinite(expected)
    assert (np.isfinite(found) == known).all()
    np.testing.assert_allclose(found[known], expected[known], rtol=1e-9)


@pytest.mark.parametrize('quantity', QUANTITIES)
@pytest.mark.parametrize('noise', [1e-3, 0.3])
def test_compiled_as_numpy(quantity: str, noise: float) -> None:
    """Also of a body that does not turn, and of one of which nothing is known."""
    what = QUANTITIES[quantity]
    for orders in range(NEEDED.get(what, what % FREE), 5):
        for shape in ((), (1, 1), (200, 3)):
            m = motion(orders, shape, noise)
            if len(shape) > 1 and shape[1] > 1:
                m.angle[1:, :, 1] = 0.0
                for array in m:
                    array[..., 2] = np.nan
            value, spread, flags, reasons = compute_quantity(what, motion_of(*m))
            expected = of_numpy(what, m)
            assert np.array_equal(reasons == KNOWN, expected.determined)
            assert_equal(value, expected.value)
            if what in (CURVATURE, CIRCLE_DIAMETER):
                spread = spread[..., :1, :1] * np.ones((2, 2))
            if what in (CIRCLE_CENTER, CIRCLE_DIAMETER):
                # Differences have half the digits.
                size = np.einsum('...ii->...', expected.spread)[..., None, None]
                with np.errstate(invalid='ignore'):
                    spread, expected = (
                        spread / size,
                        expected._replace(spread=expected.spread / size),
                    )
                np.testing.assert_allclose(spread, expected.spread, atol=1e-6)
            else:
                assert_equal(spread, expected.spread)
            assert np.array_equal(flags & DETERMINED, expected.determined)
            assert np.array_equal((flags & MOVES) > 0, expected.moves)


def test_reasons_follow_from_what_is_determined() -> None:
    """They are looked up here by numpy, in the order in which they go before each other."""
    m = motion(4, (400, 3), 0.3)
    m.angle[1:, :50, 1] = 0.0
    reason = np.zeros(m.size.shape, np.uint8)
    reason[:, 2] = REASONS['NOT_SEEN']
    compiled = motion_of(*m)
    compiled.bind('reason', reason)
    icr = compute_quantity(1, compiled)
    assert {*np.unique(icr[3])} >= {KNOWN, REASONS['NO_ROTATION'], REASONS['NOT_SEEN']}
    has_icr, pinned = icr[2] > 0, np.isfinite(m.pin)
    moves = compute_quantity(VELOCITY, compiled)[2] & MOVES > 0
    for order in (1, 2, 3, 4):
        value, _, flags, codes = compute_quantity(order, compiled)
        with np.errstate(invalid='ignore'):
            far = np.abs(value - m.position[0]) > FARTHEST * m.size
        expected = np.where(has_icr, REASONS['IN_NOISE'], REASONS['NO_ROTATION'])
        expected = np.where(far & ~pinned, REASONS['AT_INFINITY'], expected)
        expected = np.where(flags > 0, KNOWN, expected)
        assert np.array_equal(codes, np.where(reason, reason, expected))
    _, _, flags, codes = compute_quantity(CURVATURE, compiled)
    expected = np.where(pinned, REASONS['ON_PIN'], REASONS['ICR_IN_NOISE'])
    expected = np.where(has_icr, expected, icr[3])
    expected = np.where(moves, REASONS['IN_NOISE'], expected)
    expected = np.where(flags & DETERMINED, KNOWN, expected)
    assert np.array_equal(codes, np.where(reason, reason, expected))


@pytest.mark.parametrize('quantity', QUANTITIES)
def test_gates_let_some_pass_and_withhold_others(quantity: str) -> None:
    """Else the comparison above would compare nothing."""
    flags = compute_quantity(QUANTITIES[quantity], motion_of(*motion(4, (500, 3), 0.3)))[2]
    assert 0.02 < np.mean(flags & DETERMINED) < 0.98


@pytest.mark.parametrize('noise', [1e-3, 0.3])
def test_compiled_relative_centers_as_numpy(noise: float) -> None:
    """Also of bodies that turn at one rate, and of one of which nothing is known."""
    m, pairs = motion(2, (200, 4), noise), np.array([[1, 2, 3, 2], [0, 0, 0, 1]])
    m.angle[1:, :50, 2] = m.angle[1:, :50, 1]
    for array in m:
        array[..., 3] = np.nan
    with np.errstate(divide='ignore', invalid='ignore'):
        (z_j, z_i), (a_j, a_i), (s_j, s_i) = (
            [array[..., own] for own in pairs] for array in (m.position, m.angle, m.size)
        )
        by_j, by_i = planar.relative_pole(z_j, a_j, z_i, a_i)
        spread = sum(
            covariance(by, m.position_covariance[..., own], m.angle_covariance[..., own])
            for by, own in zip((by_j, by_i), pairs, strict=True)
        )
        deviation = np.sqrt(m.angle_covariance[1, 1][:, pairs].sum(axis=1))
        turns = np.abs(a_j[1] - a_i[1]) > 4 * deviation
        near = np.abs(by_j.value - (z_j[0] + z_i[0]) / 2) < 1e3 * np.maximum(s_j, s_i)
    finite = np.isfinite(spread).all(axis=(-2, -1)) & np.isfinite(by_j.value)
    value, found, flags = relative_centers(motion_of(*m), pairs)
    assert np.array_equal(flags, turns & near & finite)
    assert 0.1 < flags.mean() < 0.9
    assert_equal(value[finite], by_j.value[finite])
    assert_equal(found[finite], spread[finite])


def test_each_instant_by_itself() -> None:
    """To the last digit: what is seen live is what a replay gives."""
    m = motion(4, (40, 3))
    for what in QUANTITIES.values():
        whole = compute_quantity(what, motion_of(*m))
        for t in range(40):
            one = compute_quantity(what, motion_of(*(array[..., t, :] for array in m)))
            for part, alone in zip(whole, one, strict=True):
                assert np.array_equal(part[t], alone, equal_nan=True)


def test_arrays_that_do_not_fit() -> None:
    """Are refused: the library never reads beyond what it is given."""
    m = motion(3, (5,))
    for bad in (
        {'position': m.position[:, 1:]},
        {'position': m.position[1:]},
        {'size': m.size[1:]},
        {'pin': m.pin[1:]},
    ):
        with pytest.raises(ValueError, match='expected arrays of one shape'):
            motion_of(*m._replace(**bad))
    for bad in (
        {'position_covariance': m.position_covariance[1:]},
        {'angle_covariance': m.angle_covariance[..., 1:]},
    ):
        with pytest.raises(ValueError, match='expected covariances of shape'):
            motion_of(*m._replace(**bad))
    for what in (0, 4, 9, FREE, FREE + 5):
        with pytest.raises(ValueError, match='expected derivatives up to order'):
            compute_quantity(what, motion_of(*m))
    with pytest.raises(ValueError, match='expected derivatives up to order'):
        compute_quantity(CURVATURE, motion_of(*motion(2, (5,))))
