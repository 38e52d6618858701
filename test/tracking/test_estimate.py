"""What is told of a body at an instant: figures, whether they are determined, and why not."""

from typing import Any

import numpy as np
import pytest

from kinpole_ros import planar
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import REASONS, TABLE

COUNT, ORDER = 7, 3


def estimate() -> Estimate:
    """Seven bodies at one instant, each of which turns."""
    rng = np.random.default_rng(2)
    shape = ORDER + 1, 1, COUNT
    roots = 0.02 * rng.normal(size=(2, *shape, ORDER + 1))
    covariances = np.einsum('pk...n,pm...n->pkm...', roots, roots)
    poses = rng.normal(size=(*shape, 2)) @ (1, 1j), rng.uniform(0.8, 1.2, shape)
    arrays = {
        'stamp': np.zeros(1, int),
        'position': poses[0],
        'angle': poses[1],
        'position_covariance': covariances[0],
        'angle_covariance': covariances[1],
        **dict.fromkeys(('size', 'height', 'span', 'degree'), np.ones((1, COUNT))),
    }
    return Estimate.of_arrays(arrays, 'map', tuple(f'body {b}' for b in range(COUNT)))


@pytest.mark.parametrize('order', [1, 2, 3])
def test_a_pole_is_that_of_the_derivatives(order: int) -> None:
    one = estimate()
    pole = planar.pole(order, one.position, one.angle)
    spread = planar.covariance(pole, one.position_covariance, one.angle_covariance)
    found = one.general_pole(order)
    np.testing.assert_allclose(found.value, pole.value, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, spread, rtol=1e-9)
    assert found.determined.any()


def test_balls_point_is_withheld_where_it_may_be_anywhere_on_the_circle() -> None:
    one, sure = estimate(), estimate()
    for covariance in (sure.position_covariance, sure.angle_covariance):
        covariance *= 1e-6
    # The jerk alone, which the circle does not need.
    one.position_covariance[3, 3] *= 1e4
    ball, known = one.ball_point, sure.ball_point
    assert known.determined.all() and one.inflection_circle.determined.all()
    assert 0 < ball.determined.sum() < COUNT
    sizes = one.inflection_diameter.value
    for told, wide in ((ball, sizes), (known, sizes)):
        deviation = np.sqrt(np.trace(told.covariance, axis1=-2, axis2=-1))
        assert (4 * deviation < wide)[told.determined].all()
    # It lies on the circle.
    from_center = np.abs(known.value - sure.inflection_circle.value)
    np.testing.assert_allclose(2 * from_center, sure.inflection_diameter.value, rtol=1e-9)


def test_a_pole_of_which_nothing_is_known_is_undetermined() -> None:
    one = estimate()
    one.angle_covariance[1, 1] *= 1e-6
    assert one.general_pole(1).determined.all()
    one.angle_covariance[1, 1, 0, 0] = np.nan
    one.position_covariance[1, 1, 0, 1] = np.inf
    one.angle[1, 0, 2] = np.nan
    assert one.general_pole(1).determined[0].tolist() == [False] * 3 + [True] * 4


def test_an_instant_of_an_estimate_has_what_was_computed_of_all() -> None:
    """Not computed again: the very figures, of each kind that is asked for."""
    both = estimate()
    asked = ('icr_velocity', 'centrode_curvature', 'relative_rate', 'relative_icr')
    figures = [both.pole(2), *(getattr(both, name) for name in asked)]
    one = both[0]
    found = [one.pole(2), *(getattr(one, name) for name in asked)]
    fresh = estimate()[0]
    again = [fresh.pole(2), *(getattr(fresh, name) for name in asked)]
    for whole, part, computed in zip(figures, found, again, strict=True):
        assert type(part) is type(whole)
        for array, row, alike in zip(whole, part, computed, strict=True):
            assert np.shares_memory(array, row)
            assert np.array_equal(array[0], row, equal_nan=True)
            assert row == pytest.approx(alike, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize('order', range(ORDER + 1))
def test_origins_and_rates_of_all_bodies_are_computed_once(order: int) -> None:
    """Each topic asks for those of its own body: computed anew, their cost grew with the square."""
    one = estimate()
    assert one.origin(order) is one.origin(order)
    assert one.rate(order) is one.rate(order)


def one_body(
    velocity: complex = 0,
    rate: float = 0,
    noise: float = 1e-3,
    sigmas: dict[int, float] | None = None,
    **rest: Any,
) -> Estimate:
    """
    One body of size 2 at (3, 4), with that velocity and rate, up to order 4, all to that noise.

    `sigmas` are those of derivatives of the angle by their order.
    """
    position, angle = np.zeros((5, 1, 1), complex), np.zeros((5, 1, 1))
    position[:2, 0, 0], angle[1] = (3 + 4j, velocity), rate
    deviations = np.full(5, noise)
    for order, sigma in (sigmas or {}).items():
        deviations[order] = sigma
    covariance = noise**2 * np.eye(5)[:, :, None, None]
    of_angle = np.diag(deviations**2)[:, :, None, None]
    arrays = {
        'stamp': np.zeros(1, int),
        'position': position,
        'angle': angle,
        'position_covariance': covariance,
        'angle_covariance': of_angle,
        **dict.fromkeys(('size', 'height', 'span', 'degree'), np.full((1, 1), 2.0)),
    }
    return Estimate.of_arrays(arrays | rest, 'map', ('link',))


@pytest.mark.parametrize(
    ('given', 'motion'),
    [
        ({'rate': 3.9e-3}, 'still'),
        ({'rate': 4.1e-3}, 'general'),
        ({'rate': 4.1e-3, 'pin': np.zeros((1, 1), complex)}, 'pinned'),
        ({'rate': 1.0, 'reason': np.full((1, 1), REASONS['NOT_SEEN'])}, ''),
        # Of two axes: the square root of two.
        ({'velocity': 3.9e-3 + 3.9e-3j}, 'still'),
        ({'velocity': 4.1e-3 + 4.1e-3j}, 'translating'),
    ],
)
def test_a_body_does_what_stands_out_of_its_noise(given: dict[str, Any], motion: str) -> None:
    assert one_body(**given)[0].motion(0) == motion


@pytest.mark.parametrize(
    ('given', 'figure', 'reason'),
    [
        ({'velocity': 1}, 'icr', 'no rotation'),
        # Beyond a thousand sizes.
        ({'velocity': 0.19, 'rate': 1e-4, 'noise': 1e-6}, 'icr', None),
        ({'velocity': 0.19, 'rate': 1e-4, 'noise': 1e-4}, 'icr', 'no rotation'),
        ({'velocity': 0.21, 'rate': 1e-4, 'noise': 1e-6}, 'icr', 'pole at infinity'),
        ({'velocity': 1, 'rate': 1, 'sigmas': {2: 1.0}}, 'icr', None),
        ({'velocity': 1, 'rate': 1, 'sigmas': {2: 1.0}}, 'iap', 'lost in its noise'),
        ({'velocity': 1, 'rate': 1}, 'centrode_curvature', None),
        ({'velocity': 1, 'rate': 1, 'sigmas': {3: 2.0}}, 'centrode_curvature', None),
        ({'rate': 1}, 'centrode_curvature', TABLE['ICR_IN_NOISE'].text),
        ({'rate': 1, 'pin': np.zeros((1, 1), complex)}, 'centrode_curvature', TABLE['ON_PIN'].text),
        ({'velocity': 1}, 'centrode_curvature', 'no rotation'),
    ],
)
def test_what_is_undetermined_has_its_reason(
    given: dict[str, Any], figure: str, reason: str | None
) -> None:
    assert one_body(**given)[0].reasons(0).get(figure) == reason


@pytest.mark.parametrize('off', [0.98, 1.02])
def test_a_pole_is_told_where_the_body_turns_by_more_than_its_noise(off: float) -> None:
    """At the factor that docs/architecture.md has."""
    assert one_body(0, 4e-3 * off, 1e-3).pole(1).determined[0, 0] == (off > 1)


def test_a_pinned_body_turns_about_its_pin_whatever_its_derivatives_say() -> None:
    pin, variance = np.full((1, 1), 1 + 2j), np.full((1, 1), 1e-8)
    pinned = {'pin': pin, 'pin_variance': variance}
    body = one_body(0.5, 1, sigmas={2: 1.0}, **pinned)
    for order in (1, 2, 3):
        pole = body.pole(order)
        assert pole.determined.all()
        assert pole.value[0, 0] == 1 + 2j
        assert pole.covariance[0, 0].tolist() == [[1e-8, 0], [0, 1e-8]]
    assert not body.general_pole(2).determined.any()
    speed = body.icr_velocity
    assert (speed.value[0, 0], speed.covariance.any(), speed.determined.all()) == (0, False, True)
    assert not body.centrode_curvature.determined.any()
    # Where it turns back it has no ICR, though it has an IAP.
    back = one_body(**pinned)
    back.angle[2] = 1
    assert [back.pole(order).determined.all() for order in (1, 2, 3)] == [False, True, True]


@pytest.mark.parametrize(('rate', 'told'), [(0.014, False), (0.016, True)])
def test_near_no_rotation_no_curvature_is_told(rate: float, told: bool) -> None:
    """It comes out straight there, and that for sure, however fast and well known the ICR is."""
    body = one_body(1, rate, 1e-12, sigmas={1: 0.01})
    assert body.icr_moves.all()
    assert body.centrode_curvature.determined.all() == told
