"""A pole found twice, apart and together: how the two become one."""

import numpy as np
import pytest

from kinpole_ros import planar
from kinpole_ros.estimate import Estimate, Poses, Vectors

COUNT, ORDER = 7, 3


def two_sets() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Poses (4, 1, 7) apart, and (4, 3, 1, 7) together for poles of order 1 to 3."""
    rng = np.random.default_rng(2)

    def some(*sets: int) -> list[np.ndarray]:
        shape = (ORDER + 1, *sets, 1, COUNT)
        roots = 0.02 * rng.normal(size=(2, *shape, ORDER + 1))
        covariances = np.einsum('pk...n,pm...n->pkm...', roots, roots)
        angle = rng.uniform(0.8, 1.2, shape)
        return [rng.normal(size=(*shape, 2)) @ (1, 1j), angle, *covariances]

    apart, together = some(), some(ORDER)
    for k in range(2):
        together[k][1:] = apart[k][1:, None] + 0.02 * together[k][1:]
        together[k][0] = apart[k][0]
    return apart, [*together, np.zeros(together[1].shape), np.zeros(apart[1].shape)]


def estimate(apart: list[np.ndarray], together: list[np.ndarray] | None) -> Estimate:
    shape = (1, COUNT)
    rest = [np.full(shape, 1.0) for _ in range(4)]
    names = tuple(f'body {b}' for b in range(COUNT))
    missing = np.full(shape, '', object)
    both = None if together is None else Poses(*together)
    return Estimate(np.zeros(1, int), 'map', names, *apart, *rest, missing, together=both)


def alone(order: int, poses: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Pole (7,) of one set of poses with its covariance (7, 2, 2)."""
    pole = planar.pole(order, *poses[:2])
    return pole.value[0], planar.covariance(pole, *poses[2:4])[0]


def alike(pole: Vectors, value: np.ndarray, covariance: np.ndarray) -> None:
    assert pole.value[0] == pytest.approx(value, rel=1e-12)
    assert pole.covariance[0] == pytest.approx(covariance, rel=1e-9)


@pytest.mark.parametrize('order', [1, 2, 3])
def test_two_poles_count_by_the_inverse_squares_of_their_variances(order: int) -> None:
    apart, together = two_sets()
    sets = apart, [part[..., order - 1, :, :] for part in together]
    values, covariances = zip(*(alone(order, poses) for poses in sets), strict=True)
    weights = np.array([np.trace(c, axis1=1, axis2=2) ** -2 for c in covariances])
    weights /= weights.sum(axis=0)
    mean = sum(w * v for w, v in zip(weights, values, strict=True))
    spread = np.zeros((COUNT, 2, 2))
    for weight, value, covariance in zip(weights, values, covariances, strict=True):
        off = planar.to_plane(value - mean)
        own = covariance + off[:, :, None] * off[:, None]
        spread += weight[:, None, None] * own
    alike(estimate(apart, together).general_pole(order), mean, spread)


@pytest.mark.parametrize('order', [1, 2, 3])
@pytest.mark.parametrize('nothing', [np.nan, np.inf])
def test_a_pole_of_which_nothing_is_known_gives_way_to_the_other(
    order: int, nothing: float
) -> None:
    apart, together = two_sets()
    # Of bodies 0 and 2 one covariance, of 1 and 3 the other, of 4 both; of 5 one of the poses.
    for covariance in apart[2:]:
        covariance[1:, 1:, 0, [0, 2, 4]] = nothing
    for covariance in together[2:4]:
        covariance[1:, 1:, :, 0, [1, 3, 4]] = nothing
    apart[1][1:, 0, 5] = np.nan
    with np.errstate(invalid='ignore'):
        first = alone(order, apart)
        second = alone(order, [part[..., order - 1, :, :] for part in together])
    pole = estimate(apart, together).general_pole(order)
    assert np.isfinite(pole.covariance[0]).all(axis=(-2, -1)).tolist() == [True] * 4 + [
        False,
        True,
        True,
    ]
    for bodies, (value, covariance) in (([0, 2, 5], second), ([1, 3], first)):
        found = Vectors(*(part[:, bodies] for part in pole))
        alike(found, value[bodies], covariance[bodies])
    # Where neither is known, where it would be is still told.
    assert pole.value[0, 4] == first[0][4]
    assert not pole.determined[0, 4]


def test_what_windows_contradict_adds_to_the_variance_of_rates() -> None:
    apart, together = two_sets()
    parted = together[-1]
    parted[1:] = np.arange(1.0, COUNT + 1)
    both = estimate(apart, together)
    for order in range(1, ORDER + 1):
        expected = apart[3][order, order] + parted[order]
        assert both.rate(order).variance.tolist() == expected.tolist()
    first, second = both.rate(1).variance[0, :2]
    assert both.relative_rate.variance[0, 0] == first + second


def test_without_poses_together_the_pole_is_that_of_the_poses() -> None:
    apart, _ = two_sets()
    alike(estimate(apart, None).pole(2), *alone(2, apart))


def test_an_instant_of_an_estimate_has_what_was_computed_of_all() -> None:
    """Not computed again: the very figures, of each kind that is asked for."""
    both = estimate(*two_sets())
    asked = ('icr_velocity', 'centrode_curvature', 'relative_rate', 'relative_icr')
    figures = [both.pole(2), *(getattr(both, name) for name in asked)]
    one = both[0]
    found = [one.pole(2), *(getattr(one, name) for name in asked)]
    fresh = estimate(*two_sets())[0]
    again = [fresh.pole(2), *(getattr(fresh, name) for name in asked)]
    for whole, part, computed in zip(figures, found, again, strict=True):
        assert type(part) is type(whole)
        for array, row, alike in zip(whole, part, computed, strict=True):
            assert np.shares_memory(array, row)
            assert np.array_equal(array[0], row, equal_nan=True)
            assert row == pytest.approx(alike, rel=1e-12, nan_ok=True)
