"""A pole found twice, apart and together: how the two become one."""

from typing import Any

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


def one_body(
    velocity: complex = 0,
    rate: float = 0,
    noise: float = 1e-3,
    sigmas: dict[int, float] | None = None,
    common: float | None = None,
    turning: float = 0,
    apart: complex = 0,
    **rest: Any,
) -> Estimate:
    """
    One body of size 2 at (3, 4), with that velocity and rate, up to order 4, all to that noise.

    `sigmas` are those of derivatives of the angle by their order. Poses together, if their noise is
    given as `common`, are the same but for `apart` in the velocity.
    """
    position, angle = np.zeros((5, 1, 1), complex), np.zeros((5, 1, 1))
    position[:2, 0, 0], angle[1] = (3 + 4j, velocity), rate
    deviations = np.full(5, noise)
    for order, sigma in (sigmas or {}).items():
        deviations[order] = sigma
    covariance = noise**2 * np.eye(5)[:, :, None, None]
    of_angle = np.diag(deviations**2)[:, :, None, None]
    together = None
    if common is not None:
        moved = position.copy()
        moved[1] += apart
        poses = [np.repeat(part[:, None], 4, 1) for part in (moved, angle)]
        variances = np.repeat(common**2 * np.eye(5)[:, :, None, None, None], 4, 2)
        differ = np.full((5, 4, 1, 1), turning**2)
        together = Poses(*poses, variances, variances, differ, np.zeros((5, 1, 1)))
    each = [np.full((1, 1), 2.0) for _ in range(4)]
    known = {'missing': np.full((1, 1), '', object)} | rest
    return Estimate(
        *(np.zeros(1, int), 'map', ('link',), position, angle, covariance, of_angle, *each),
        together=together,
        **known,
    )


@pytest.mark.parametrize(
    ('given', 'motion'),
    [
        ({'rate': 3.9e-3}, 'still'),
        ({'rate': 4.1e-3}, 'general'),
        ({'rate': 4.1e-3, 'pin': np.zeros((1, 1), complex)}, 'pinned'),
        ({'rate': 1.0, 'missing': np.full((1, 1), 'markers unseen', object)}, ''),
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
        ({'velocity': 1, 'rate': 1, 'sigmas': {3: 2.0}}, 'centrode_curvature', 'lost in its noise'),
        ({'rate': 1}, 'centrode_curvature', 'pinned: the ICR stands still'),
        ({'velocity': 1}, 'centrode_curvature', None),
    ],
)
def test_what_is_undetermined_has_its_reason(
    given: dict[str, Any], figure: str, reason: str | None
) -> None:
    assert one_body(**given)[0].reasons(0).get(figure) == reason


@pytest.mark.parametrize('off', [0.98, 1.02])
@pytest.mark.parametrize('asked', ['common', 'turning', 'noise', 'apart'])
def test_a_pole_is_told_where_the_body_turns_by_all_accounts_and_these_agree(
    asked: str, off: float
) -> None:
    """Each by itself withholds it, at the factors that docs/architecture.md has."""
    given = {'common': 1e-3, 'noise': 1e-3, 'turning': 1e-3, 'apart': 0.0}
    given[asked] = {'common': 1 / 2.5, 'turning': 1 / 13, 'noise': 1 / 2}.get(asked, 0.0) * off
    if asked == 'apart':
        # The ICR is as far off as the velocity, and has the variance of that and of the place.
        given[asked] = 3 * np.sqrt(2 * (2e-6 + 2e-6)) * off
    assert one_body(0, 1, **given).pole(1).determined[0, 0] == (off < 1)


def test_a_pinned_body_turns_about_its_pin_whatever_its_derivatives_say() -> None:
    pin, variance = np.full((1, 1), 1 + 2j), np.full((1, 1), 1e-8)
    pinned = {'pin': pin, 'pin_variance': variance}
    body = one_body(0.5, 1, sigmas={2: 1.0}, common=1e-3, apart=5.0, **pinned)
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
