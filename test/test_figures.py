"""The compiled figures of the plane are the same as numpy's functions give."""

import numpy as np
import pytest

from kinpole_ros.planar import _uncertainty, centrode_curvature, icr_velocity
from kinpole_ros.planar._poles import pole, rotation
from kinpole_ros.planar._uncertainty import covariance, mean_square, variance

pytestmark = pytest.mark.filterwarnings('error')

FIGURES = {
    **{
        f'pole of order {n}': lambda *motion, n=n: _uncertainty.pole_figures(n, *motion)
        for n in range(1, 5)
    },
    'velocity': _uncertainty.velocity_figures,
    'curvature': _uncertainty.curvature_figures,
}
# The lowest derivatives that it takes.
LEAST = {'velocity': 2, 'curvature': 3} | {f'pole of order {n}': n for n in range(1, 5)}


def motion(orders: int, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Position and angle (orders + 1, ...) with covariances."""
    rng = np.random.default_rng(orders)
    position = rng.normal(size=(orders + 1, *shape, 2)).view(complex)[..., 0]
    angle = rng.normal(scale=3.0, size=(orders + 1, *shape))
    mixed = rng.normal(scale=0.01, size=(2, *shape, orders + 1, orders + 1))
    covariances = np.moveaxis(mixed @ mixed.swapaxes(-1, -2), (-2, -1), (1, 2))
    return position, angle, *covariances


def equal(found: np.ndarray, expected: np.ndarray) -> bool:
    known = np.isfinite(expected)
    close = np.isclose(found[known], expected[known], rtol=1e-9, atol=0.0)
    nothing = np.isnan(found) == np.isnan(expected)
    return bool((np.isfinite(found) == known).all() and nothing.all() and close.all())


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def of_numpy(figure: str, *motion: np.ndarray) -> tuple[np.ndarray, ...]:
    """The same of the functions that give a figure with its derivatives."""
    position, angle, of_position, of_angle = motion
    if figure == 'velocity':
        found = icr_velocity(position, angle)
        return found.value, covariance(found, of_position, of_angle)
    if figure == 'curvature':
        found = centrode_curvature(position, angle)
        return found.value.real, variance(found, of_position, of_angle)
    order = int(figure[-1])
    turn = a, by_angle = rotation(order, angle)
    found = pole(order, position, angle, turn)
    noise = mean_square(by_angle, of_angle[1 : order + 1, 1 : order + 1])
    return found.value, covariance(found, of_position, of_angle), np.abs(a) / np.sqrt(noise)


@pytest.mark.parametrize('figure', FIGURES)
def test_compiled_as_numpy(figure: str) -> None:
    """Also of a body that does not turn, and of one of which nothing is known."""
    for orders in range(LEAST[figure], 5):
        for shape in ((), (1, 1), (40, 3)):
            given = motion(orders, shape)
            if len(shape) > 1 and shape[1] > 1:
                given[1][1:, :, 1] = 0.0
                for array in given:
                    array[..., 2] = np.nan
            found = FIGURES[figure](*given)
            expected = of_numpy(figure, *given)
            for one, other in zip(found, expected, strict=True):
                assert np.shape(one) == np.shape(other)
                assert equal(np.asarray(one), np.asarray(other))


def test_each_instant_by_itself() -> None:
    """To the last digit: what is seen live is what a replay gives."""
    given = motion(4, (40, 3))
    for figure in FIGURES.values():
        whole = figure(*given)
        for t in range(40):
            alone = figure(*(np.ascontiguousarray(array[..., t, :]) for array in given))
            assert all((part[t] == one).all() for part, one in zip(whole, alone, strict=True))


def test_arrays_that_do_not_fit() -> None:
    """Are refused: the kernel never reads beyond what it is given."""
    position, angle, *covariances = motion(3, (5,))
    for given in (
        (position[:, 1:], angle, *covariances),
        (position[1:], angle, *covariances),
        (position, angle, covariances[0][1:], covariances[1]),
        (position, angle, covariances[0], covariances[1][..., 1:]),
    ):
        with pytest.raises(ValueError, match='of one shape, are needed'):
            _uncertainty.velocity_figures(*given)
    for order in (0, 4, 7):
        with pytest.raises(ValueError, match='of one shape, are needed'):
            _uncertainty.pole_figures(order, position, angle, *covariances)
    with pytest.raises(ValueError, match='of one shape, are needed'):
        _uncertainty.curvature_figures(*(array[:3] for array in motion(2, (5,))))
