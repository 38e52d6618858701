"""Fixed polynomials, which the benchmarks compare with: the textbooks' stencils, and exact."""

from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench._polynomial import derivative_weights, stencil

pytestmark = pytest.mark.filterwarnings('error')


def exact_stencil(nodes: list[Fraction], order: int) -> list[Fraction]:
    """Weights of the derivative at 0 from the Vandermonde system, solved in fractions."""
    size = len(nodes)
    rows = [[node**power for node in nodes] for power in range(size)]
    for power, row in enumerate(rows):
        row.append(Fraction(factorial(order) if power == order else 0))
    for column in range(size):
        pivot = next(k for k in range(column, size) if rows[k][column])
        rows[column], rows[pivot] = rows[pivot], rows[column]
        rows[column] = [value / rows[column][column] for value in rows[column]]
        for k in range(size):
            if k != column and rows[k][column]:
                factor = rows[k][column]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[column], strict=True)]
    return [row[-1] for row in rows]


@pytest.mark.parametrize(
    ('nodes', 'order', 'weights'),
    [
        ([-1, 0, 1], 1, np.array([-1, 0, 1]) / 2),
        ([-1, 0, 1], 2, [1, -2, 1]),
        ([-2, -1, 0, 1, 2], 1, np.array([1, -8, 0, 8, -1]) / 12),
        ([-2, -1, 0, 1, 2], 2, np.array([-1, 16, -30, 16, -1]) / 12),
        ([-2, -1, 0, 1, 2], 3, np.array([-1, 2, 0, -2, 1]) / 2),
        ([-2, -1, 0, 1, 2], 4, [1, -4, 6, -4, 1]),
        ([-3, -2, -1, 0, 1, 2, 3], 1, np.array([-1, 9, -45, 0, 45, -9, 1]) / 60),
        ([-2, -1, 0], 1, [0.5, -2, 1.5]),
        ([-4, -3, -2, -1, 0], 1, np.array([3, -16, 36, -48, 25]) / 12),
    ],
)
def test_stencil_on_even_nodes_is_the_one_in_the_textbooks(
    nodes: list[float], order: int, weights: Any
) -> None:
    for step in (1e-6, 0.005, 1.0, 1e3):
        found = stencil(step * np.array(nodes, float), order)[order]
        assert found * step**order == pytest.approx(np.array(weights, float), abs=1e-11)


@given(
    st.lists(st.integers(-20, 20), min_size=1, max_size=8, unique=True),
    st.sampled_from((Fraction(1, 10**6), Fraction(1, 200), Fraction(1), Fraction(1000))),
)
def test_stencil_on_any_nodes_is_the_exact_solution(places: list[int], step: Fraction) -> None:
    nodes = [step * place for place in sorted(places)]
    found = stencil([float(node) for node in nodes], 4)
    for order in range(5):
        if order >= len(nodes):
            assert (found[order] == 0).all()
            continue
        truth = np.array([float(w) for w in exact_stencil(nodes, order)])
        assert found[order] == pytest.approx(truth, rel=1e-8, abs=1e-8 * np.abs(truth).max())


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.sampled_from((1e-6, 1e-3, 1.0, 1e3)))
def test_derivative_weights_are_those_of_weighted_least_squares(
    seed: int, degree: int, step: float
) -> None:
    rng = np.random.default_rng(seed)
    # Not around 0: a derivative is asked for outside the samples as well.
    places = rng.uniform(-10, 10, 15) + rng.uniform(-5, 5)
    weights = rng.uniform(0.1, 10, 15) * (rng.random(15) < 0.8)
    weights[: degree + 1] = 1.0
    samples = rng.normal(size=15)
    found = derivative_weights(places * step, degree, 4, weights) @ samples
    # Powers about the middle of the samples, then carried to 0.
    center = places.mean()
    root = np.sqrt(weights)
    powers = (places - center)[:, None] ** np.arange(degree + 1)
    fitted = np.linalg.lstsq(powers * root[:, None], samples * root, rcond=None)[0]
    polynomial = np.polynomial.Polynomial(fitted)
    for order in range(5):
        if order > degree:
            assert found[order] == 0
            continue
        truth = polynomial.deriv(order)(-center) if order else polynomial(-center)
        size = np.abs(fitted).max() * 20.0**degree
        assert found[order] * step**order == pytest.approx(truth, rel=1e-6, abs=1e-9 * size)


def test_polynomials_of_the_degree_are_differentiated_exactly() -> None:
    rng = np.random.default_rng(0)
    times = np.sort(rng.uniform(-1, 1, 30))
    weights = rng.uniform(0, 1, 30)
    for degree in range(13):
        polynomial = np.polynomial.Polynomial(rng.normal(size=degree + 1))
        found = derivative_weights(times, degree, 4, weights) @ polynomial(times)
        truth = np.zeros(5)
        truth[: degree + 1] = (polynomial.coef * [factorial(k) for k in range(degree + 1)])[:5]
        assert found == pytest.approx(truth, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize(
    ('times', 'degree', 'weights', 'words'),
    [
        ([0.0, 1.0], 2, None, 'degree must be'),
        ([0.0, 1.0, 1.0], 2, None, 'degree must be'),
        ([0.0, 1.0, 2.0], 2, [1, 0, 1], 'degree must be'),
        ([0.0, 1.0], -1, None, 'degree must be'),
        ([[0.0, 1.0]], 1, None, 'one shape'),
        ([0.0, 1.0], 1, [1.0], 'one shape'),
    ],
)
def test_samples_too_few_for_the_degree_are_refused(
    times: Any, degree: int, weights: Any, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        derivative_weights(times, degree, 2, weights)


def test_a_stencil_on_equal_times_is_refused() -> None:
    with pytest.raises(ValueError, match='distinct times'):
        stencil([0.0, 0.1, 0.1], 1)
