"""From samples to derivatives: exact where exactness is due, and as good as its own variance."""

from collections import deque
from fractions import Fraction
from math import factorial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stretches import fit_frames

from kinpole_ros import window
from kinpole_ros.mechanism import load_scene
from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.window import (
    FEWEST_SAMPLES,
    Derivatives,
    Noise,
    Samples,
    Shapes,
    Spectrum,
    _models,
    derivative_weights,
    project,
    stencil,
    weigh_together,
)
from kinpole_ros.window._choice import weigh_apart
from kinpole_ros.window._projection import evaluate
from kinpole_ros.window._weighted import both_ways, squares_of

pytestmark = pytest.mark.filterwarnings('error')

ORDERS = np.arange(5)


# --- stencils and fits --------------------------------------------------------------------------


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


@settings(max_examples=40)
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


@settings(max_examples=40)
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


# --- the choice of window and degree ------------------------------------------------------------


def stamps(kind: str, step: int, count: int = 101, ahead: int = 30) -> np.ndarray:
    """Times in ns, `step` apart or about so, with 0 among them."""
    rng = np.random.default_rng(1)
    times = np.arange(count) * float(step)
    if kind == 'jittered':
        times += rng.uniform(-0.4, 0.4, count) * step
    if kind == 'gappy':
        times = np.delete(times, [20, 21, 22, 23, 50, 51, 80, 81, 82])
    times = times.round().astype(np.int64)
    return times - times[len(times) - 1 - ahead]


def differentiate(
    times: np.ndarray,
    signals: np.ndarray,
    weights: np.ndarray | None,
    noise: np.ndarray,
    dimensions: np.ndarray,
    order: int,
    spectrum: Spectrum | None = None,
) -> Derivatives:
    """As of the package, at the one instant about which the samples (N, G, 2) are."""
    signals = signals[:, None]
    found = window.differentiate(
        times[:, None], signals, weights, noise, dimensions, order, spectrum
    )
    values, covariance, span, degree = found
    return Derivatives(values[:, 0], covariance[:, :, 0], span[0], degree[0])


def scalars(columns: np.ndarray) -> np.ndarray:
    """Numbers (N, G) as differentiate wants them, (N, G, 2)."""
    return np.stack((columns, np.zeros_like(columns)), axis=-1)


def same(one: Derivatives, other: Derivatives, tolerance: float = 1e-9) -> None:
    """Equal to `tolerance` of each standard deviation, and the variances relatively."""
    deviation = np.sqrt(np.einsum('kkg->kg', other.covariance))
    assert (np.abs(one.values - other.values) <= tolerance * deviation[..., None]).all()
    between = np.abs(one.covariance - other.covariance)
    assert (between <= tolerance * deviation[:, None] * deviation).all()
    assert one.span == pytest.approx(other.span, rel=tolerance)
    assert one.degree == pytest.approx(other.degree, rel=tolerance)


@pytest.mark.parametrize('step', [1_000, 5_000_000, 10**12], ids=['1 us', '5 ms', '1000 s'])
@pytest.mark.parametrize('kind', ['even', 'jittered', 'gappy'])
def test_polynomials_are_recovered_whatever_the_stamps(kind: str, step: int) -> None:
    times = stamps(kind, step)
    unit = 50 * step * 1e-9
    rng = np.random.default_rng(2)
    coefficients = rng.normal(size=(6, 3, 2))
    powers = (times * 1e-9 / unit)[:, None] ** np.arange(6)
    signals = np.einsum('nd,dgc->ngc', powers, coefficients) + 1e3
    found = differentiate(times, signals, None, np.full(3, 1e-10), np.full(3, 2), 4)
    scale = np.array([factorial(k) / unit**k for k in range(5)])
    truth = coefficients[:5] * scale[:, None, None]
    truth[0] += 1e3
    # 1e3 is known to 1e-13, and a derivative multiplies that by its noise gain.
    allowed = 1e-12 * 30.0**ORDERS * scale
    assert (np.abs(found.values - truth) < allowed[:, None, None]).all()


def noisy(seed: int = 3, count: int = 101, groups: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.linspace(-1, 1, count)[:, None, None]
    phase = rng.uniform(0, 6, (groups, 2))
    return np.sin(3 * t + phase) + 1e-3 * rng.normal(size=(count, groups, 2))


LEVEL, TWO = np.full(4, 1e-3), np.full(4, 2)


def uneven(kind: str, instants: int = 40) -> np.ndarray:
    """Times (N, M) in ns about instants that differ in the place of their own sample, too."""
    rng = np.random.default_rng(3)
    count = 301 if kind == 'long' else 75
    places = np.arange(count + instants) + rng.normal(0, 0.1, count + instants)
    if kind == 'gappy':
        # Steps of 30 here and there: what the recurrence loses is made good.
        places += np.cumsum(np.where(rng.random(len(places)) < 0.1, 29, 0))
    stamps = (5e6 * places).round().astype(np.int64)
    rows = np.arange(count)[:, None] + np.arange(instants)
    now = rows[-1] - 20 - rng.integers(0, 2, instants)
    return stamps[rows] - stamps[now]


@pytest.mark.parametrize('kind', ['jittered', 'gappy', 'long', 'weighted'])
def test_each_window_is_fitted_exactly_whatever_the_stamps(kind: str) -> None:
    """Polynomials are orthonormal on the samples; their derivatives are those of the fit."""
    times = uneven(kind)
    weights = None
    if kind == 'weighted':
        rng = np.random.default_rng(4)
        weights = rng.uniform(0.1, 10, (len(times), 5)) * (rng.random((len(times), 5)) < 0.8)
        weights[np.flatnonzero(times[:, 0] == 0)[0]] = 1.0
        times = times[:, :1]
    for column in range(0, times.shape[1], 8):
        stamps = times[:, column : column + 1]
        now = int(np.flatnonzero(stamps == 0)[0])
        models = _models.models_of(stamps.T, now, None if weights is None else weights.T, 5)
        highest = np.moveaxis(models.highest[:, 0], -1, 0)  # (g, L)
        first = 0
        for scale in models.scales:
            windows = slice(first, first + len(scale.inside))
            first = windows.stop
            gram = scale.basis @ np.swapaxes(scale.basis, -1, -2)
            there = np.arange(13) <= highest[:, windows, None]
            np.testing.assert_allclose(gram, there[..., None] * np.eye(13), rtol=0, atol=1e-12)
            for g, k in np.ndindex(scale.basis.shape[:2]):
                means = np.repeat(scale.inside[k], scale.each)
                rows = models.rows[0, g, windows][k] @ scale.basis[g, k] * scale.root[g]
                # Weights of the means, then of the samples these are made of.
                taken = slice(scale.start, scale.start + len(means))
                given = np.ones(len(means)) if weights is None else weights[taken, g]
                total = given.reshape(-1, scale.each).sum(axis=1)
                share = given / np.repeat(np.where(total > 0, total, 1.0), scale.each)
                rows = np.repeat(rows, scale.each, axis=1) * share
                assert np.abs(rows[:, ~means]).max(initial=0) <= 1e-15 * np.abs(rows).max()
                seconds = stamps[taken, 0] * 1e-9
                unit = np.ptp(seconds[means]) / 2
                powers = np.arange(highest[g, windows][k] + 1)
                found = rows[:, means] @ (seconds[means, None] / unit) ** powers
                truth = np.array([[factorial(q) * (q == j) for q in powers] for j in ORDERS])
                truth = truth / unit ** ORDERS[:, None]
                # Of so large numbers the derivatives are differences.
                large = np.abs(rows).sum(axis=1, keepdims=True) * 2.0**powers
                np.testing.assert_array_less(np.abs(found - truth), 1e-13 * large)


def test_instants_are_projected_as_each_would_be_alone() -> None:
    """Even and uneven stamps, of whole ns and not, with the instant in one place and another."""
    even = 5_000_000 * np.arange(-54, 21)[:, None]
    turns = np.rint(1e9 / 240 * np.arange(80)).astype(np.int64)
    turns = np.stack([turns[k : k + 75] - turns[k + 54] for k in range(5)], axis=1)
    jittered = uneven('jittered')
    times = np.concatenate((even, turns[:, :2], jittered, even, turns[:, 2:]), axis=1)
    signals = np.random.default_rng(1).normal(size=(*times.shape, 4, 2))
    signals[:, 3, 1] = np.nan
    found = project(times, signals, None, 3, 2)
    members = evaluate(found.models.rows, found.coefficients)
    for m in range(times.shape[1]):
        one = slice(m, m + 1)
        alone = project(times[:, one], signals[:, one], None, 3, 2)
        values = evaluate(alone.models.rows, alone.coefficients)
        pairs = [(values, members), *zip(alone[1:4], found[1:4], strict=True)]
        models = alone.models, found.models.at(np.array([m]))
        pairs += [(getattr(models[0], name), getattr(models[1], name)) for name in MODEL]
        for expected, there in pairs:
            if there.shape != expected.shape:
                there = there[..., one, :]
            np.testing.assert_allclose(there, expected, rtol=1e-9, atol=1e-9 * expected.max())


MODEL = 'rim', 'own', 'spans', 'lengths', 'freedom', 'highest'


def test_a_sample_of_weight_0_is_as_good_as_left_out() -> None:
    times = stamps('jittered', 5_000_000)
    signals = noisy()
    rng = np.random.default_rng(4)
    keep = rng.random(101) < 0.8
    keep[70] = True  # where time is 0
    weights = np.repeat(keep[:, None], 4, axis=1).astype(float)
    spoiled = np.where(keep[:, None, None], signals, np.nan)
    found = differentiate(times, spoiled, weights, LEVEL, TWO, 4)
    ladder = differentiate(
        times, np.where(keep[:, None, None], signals, 7e5), weights, LEVEL, TWO, 4
    )
    same(found, ladder)
    # Windows reach over time, not samples, so those of the shortened list differ a little.
    without = differentiate(times[keep], signals[keep], None, LEVEL, TWO, 4)
    deviation = np.sqrt(np.einsum('kkg->kg', without.covariance))[..., None]
    assert (np.abs(found.values - without.values) < 3 * deviation).all()


def test_a_window_thinned_to_few_samples_is_not_believed_for_leaving_nothing_over() -> None:
    times = stamps('even', 5_000_000, ahead=50)
    t = times * 1e-9
    signals = scalars(np.sin(12 * t + np.array([[0.3], [1.0], [2.0]])).T)
    weights = np.ones((101, 3))
    weights[[48, 49, 51, 52], 0] = 0
    weights[[47, 49, 51, 53], 1] = 0
    weights[[49, 51], 2] = 0
    signals[weights == 0] = np.nan
    found = differentiate(times, signals, weights, np.full(3, 1e-15), np.full(3, 1), 4)
    truth = 12.0 ** ORDERS[:, None] * np.sin([0.3, 1.0, 2.0] + ORDERS[:, None] * np.pi / 2)
    assert (np.abs(found.values[..., 0] - truth) < 1e-8 * 12.0 ** ORDERS[:, None]).all()


def test_each_signal_has_missing_samples_of_its_own() -> None:
    times = stamps('even', 5_000_000)
    signals = noisy()
    weights = np.random.default_rng(5).integers(0, 2, (101, 4)).astype(float)
    weights[70] = 1
    signals[weights == 0] = np.nan
    together = differentiate(times, signals, weights, LEVEL, TWO, 4)
    for g in range(4):
        one = slice(g, g + 1)
        alone = differentiate(times, signals[:, one], weights[:, one], LEVEL[one], TWO[one], 4)
        same(
            Derivatives(
                *(field[..., one, :] for field in together[:1]),
                *(field[..., one] for field in together[1:]),
            ),
            alone,
        )


def test_equal_weights_are_no_weights() -> None:
    for kind in ('even', 'jittered', 'gappy'):
        times = stamps(kind, 5_000_000)
        signals = noisy()[: len(times)]
        shared = differentiate(times, signals, None, LEVEL, TWO, 4)
        same(differentiate(times, signals, np.ones(signals.shape[:2]), LEVEL, TWO, 4), shared)
        # Weight 4 at twice the noise is weight 1 at the noise.
        fours = np.full(signals.shape[:2], 4.0)
        same(differentiate(times, signals, fours, 2 * LEVEL, TWO, 4), shared)


@pytest.mark.parametrize('weights', [None, np.linspace(1, 2, 404).reshape(101, 4)])
def test_what_is_found_does_not_depend_on_the_orders_asked_for(weights: Any) -> None:
    times = stamps('jittered', 5_000_000)
    full = differentiate(times, noisy(), weights, LEVEL, TWO, 4)
    for order in (1, 2, 3):
        part = differentiate(times, noisy(), weights, LEVEL, TWO, order)
        assert len(part.values) == order + 1
        rows = slice(order + 1)
        same(part, full._replace(values=full.values[rows], covariance=full.covariance[rows, rows]))


def test_signals_move_and_scale_with_what_is_found() -> None:
    times = stamps('jittered', 5_000_000)
    plain = differentiate(times, noisy(), None, LEVEL, TWO, 4)
    moved = differentiate(times, 1e3 * noisy() + 1e6, None, 1e3 * LEVEL, TWO, 4)
    shift = np.where(ORDERS == 0, 1e6, 0.0)[:, None, None]
    back = Derivatives(
        (moved.values - shift) / 1e3, moved.covariance / 1e6, moved.span, moved.degree
    )
    same(back, plain, 1e-6)
    slower = differentiate(1000 * times, noisy(), None, LEVEL, TWO, 4)
    per = 1000.0**ORDERS
    same(
        Derivatives(
            slower.values * per[:, None, None],
            slower.covariance * (per[:, None] * per)[..., None],
            slower.span / 1000,
            slower.degree,
        ),
        plain,
        1e-6,
    )


@pytest.mark.parametrize('count', range(1, 9))
def test_too_few_samples_leave_the_higher_orders_open(count: int) -> None:
    times = (np.arange(count) - count // 2) * 5_000_000
    signals = noisy(count=count)
    found = differentiate(times, signals, None, LEVEL, TWO, 4)
    known = count > ORDERS
    assert np.array_equal(np.isfinite(found.values).all(axis=(1, 2)), known)
    assert np.array_equal(np.isnan(found.values).all(axis=(1, 2)), ~known)
    both = known[:, None] & known
    assert np.array_equal(np.isfinite(found.covariance).all(axis=-1), both)
    assert (np.einsum('kkg->kg', found.covariance)[known] > 0).all()


def test_signals_seen_too_seldom_are_open_beside_others_that_are_not() -> None:
    times = stamps('even', 5_000_000)
    weights = np.ones((101, 4))
    weights[:, 1] = 0
    weights[:, 2] = 0
    weights[70:72, 2] = 1
    signals = np.where(weights[..., None] > 0, noisy(), np.nan)
    found = differentiate(times, signals, weights, LEVEL, TWO, 4)
    known = np.asarray(np.isfinite(found.values).all(axis=-1))
    assert known[:, [0, 3]].all()
    assert not known[:, 1].any()
    assert known[:, 2].tolist() == [True, True, False, False, False]
    assert np.array_equal(np.isfinite(np.einsum('kkg->kg', found.covariance)), known)


@pytest.mark.parametrize(
    ('hertz', 'noise', 'lowest', 'highest'),
    [(1.0, 1e-4, 0.6, 1.5), (2.0, 1e-5, 0.6, 1.5), (0.5, 1e-3, 0.6, 2.0), (2.0, 1e-2, 0.6, 2.0)],
)
def test_errors_are_about_as_large_as_stated(
    hertz: float, noise: float, lowest: float, highest: float
) -> None:
    rng = np.random.default_rng(6)
    times = stamps('even', 5_000_000, ahead=20)
    phase = rng.uniform(0, 2 * np.pi, 400)
    rate = 2 * np.pi * hertz
    samples = np.sin(rate * times[:, None] * 1e-9 + phase) + noise * rng.normal(size=(101, 400))
    found = differentiate(times, scalars(samples), None, np.full(400, noise), np.full(400, 1), 3)
    truth = rate ** ORDERS[:4, None] * np.sin(phase + ORDERS[:4, None] * np.pi / 2)
    deviation = np.sqrt(np.einsum('kkg->kg', found.covariance))
    spread = ((found.values[..., 0] - truth) / deviation)[1:].std(axis=1)
    assert (spread > lowest).all()
    assert (spread < highest).all()


def motions(times: np.ndarray) -> dict[str, tuple[np.ndarray, int]]:
    """Signals with exact derivatives (5, N), complex, and whether number (1) or vector (2)."""
    turn = np.array([31.4 * times, 31.4 + 0 * times, *np.zeros((3, len(times)))])
    rates = (2 * np.pi * 1.0, 2 * np.pi * 4.0)
    sines = [
        np.array([0.3 * w**k * np.sin(w * times + k * np.pi / 2) for k in range(5)]) for w in rates
    ]
    # Stop and go: a logistic step s, whose derivatives are polynomials of s.
    s, polynomial, stop_and_go = (
        1 / (1 + np.exp(-25 * (times - 1))),
        np.polynomial.Polynomial([0, 1]),
        [],
    )
    for order in range(5):
        stop_and_go.append(25.0**order * polynomial(s))
        polynomial = polynomial.deriv() * np.polynomial.Polynomial([0, 1, -1])
    four_bar = load_scene('four_bar').motion(times)
    wheel = load_scene('rolling_wheel').motion(times)['wheel']
    return {
        'fast turn': (turn, 1),
        'sine 1 Hz': (sines[0], 1),
        'sine 4 Hz': (sines[1], 1),
        'stop and go': (np.array(stop_and_go), 1),
        'coupler angle': (four_bar['coupler'].angle, 1),
        'crank pin': (four_bar['coupler'].position, 2),
        'wheel hub': (wheel.position, 2),
    }


RATE, WINDOW, LAG = 200, 100, 20
TIMES = np.arange(700) / RATE
MOTIONS = motions(TIMES)
INSTANTS = range(WINDOW, 700 - LAG)
WARM = 100  # instants that the energies are first averaged over


def answers(noise: float) -> dict[str, np.ndarray]:
    """RMS errors (5,) of every motion, 0.1 s behind the newest of 0.5 s of samples."""
    rng = np.random.default_rng(7)
    truth = np.array([signal for signal, _ in MOTIONS.values()])
    dimensions = np.array([count for _, count in MOTIONS.values()])
    samples = np.stack((truth[:, 0].real.T, truth[:, 0].imag.T), axis=-1)
    samples = samples + noise * rng.normal(size=samples.shape)
    samples[:, dimensions == 1, 1] = 0
    level = np.full(len(dimensions), max(noise, 1e-14))
    errors = []
    spectrum = Spectrum()
    for now in INSTANTS:
        inside = slice(now + LAG - WINDOW, now + LAG + 1)
        times = (np.arange(inside.start, inside.stop) - now) * (10**9 // RATE)
        found = differentiate(times, samples[inside], None, level, dimensions, 4, spectrum).values
        errors.append(np.abs(found[..., 0] + 1j * found[..., 1] - truth[:, :, now].T) ** 2)
    return dict(zip(MOTIONS, np.sqrt(np.mean(errors[WARM:], axis=0)).T, strict=True))


@pytest.fixture(scope='module')
def clean() -> dict[str, np.ndarray]:
    return answers(0.0)


@pytest.fixture(scope='module')
def rough() -> dict[str, np.ndarray]:
    return answers(2e-4)


# RMS errors of first to fourth derivative: exact samples; noise 2e-4.
BOUNDS = {
    'fast turn': ((1e-12, 1e-12, 1e-12, 1e-12), (3e-04, 1e-09, 1e-09, 1e-09)),
    'sine 1 Hz': ((3e-12, 2e-11, 6e-08, 3e-07), (2e-03, 6e-02, 2e00, 5e01)),
    'sine 4 Hz': ((3e-12, 4e-09, 4e-07, 5e-04), (5e-03, 3e-01, 2e01, 9e02)),
    'stop and go': ((1e-09, 3e-06, 2e-04, 4e-01), (5e-03, 3e-01, 2e01, 2e03)),
    'coupler angle': ((2e-12, 6e-09, 3e-07, 8e-04), (4e-03, 2e-01, 8e00, 5e02)),
    'crank pin': ((2e-12, 8e-11, 2e-08, 2e-06), (3e-03, 6e-02, 2e00, 6e01)),
    'wheel hub': ((1e-12, 1e-12, 1e-12, 1e-12), (4e-04, 1e-09, 1e-09, 1e-09)),
}


@pytest.mark.parametrize('name', MOTIONS)
def test_the_error_table(
    name: str, clean: dict[str, np.ndarray], rough: dict[str, np.ndarray]
) -> None:
    for found, bounds in zip((clean, rough), BOUNDS[name], strict=True):
        for order, (error, bound) in enumerate(zip(found[name][1:], bounds, strict=True), 1):
            assert error < bound, f'order {order}'


@pytest.mark.parametrize('name', MOTIONS)
def test_the_choice_is_near_the_best_in_hindsight(name: str, rough: dict[str, np.ndarray]) -> None:
    """Against the best single window and degree, known only once the truth is."""
    signal = MOTIONS[name][0]
    rng = np.random.default_rng(7)
    noise = 2e-4 * (rng.normal(size=(700, len(MOTIONS), 2)) @ (1, 1j))[:, list(MOTIONS).index(name)]
    samples = signal[0] + (noise if MOTIONS[name][1] == 2 else noise.real)
    best = np.full(5, np.inf)
    now = np.array(INSTANTS[WARM:])
    for length in range(7, WINDOW + 2, 6):
        ahead = min(LAG, (length - 1) // 2)
        nodes = np.arange(ahead - length + 1, ahead + 1)
        seen = samples[now[:, None] + nodes]
        for degree in range(1, min(13, length - 2)):
            found = seen @ derivative_weights(nodes / RATE, degree, 4).T
            error = np.sqrt((np.abs(found - signal[:, now].T) ** 2).mean(axis=0))
            error[degree + 1 :] = np.inf
            best = np.minimum(best, error)
    assert (rough[name] < np.array([1.5, 2.0, 2.5, 2.0, 4.0]) * best).all()


def test_where_motion_sets_in_the_stated_errors_grow_with_the_true_ones() -> None:
    """Long rest fills the memory; what the windows disagree about tells of the start."""
    start, noise, count = 400, 1e-4, 60
    rng = np.random.default_rng(8)
    sample_times = np.arange(start + 60) / RATE
    moving = np.maximum(sample_times - start / RATE, 0.0)
    samples = 100 * moving[:, None] ** 3 + noise * rng.normal(size=(len(moving), count))
    level, one = np.full(count, noise), np.full(count, 1)
    spectrum = Spectrum()
    quiet, begun = [], []
    for now in range(WINDOW, start + 5):
        inside = slice(now + LAG - WINDOW, now + LAG + 1)
        times = (np.arange(inside.start, inside.stop) - now) * (10**9 // RATE)
        found = differentiate(times, scalars(samples[inside]), None, level, one, 1, spectrum)
        truth = 300 * moving[now] ** 2
        square = (found.values[1, :, 0] - truth) ** 2 / found.covariance[1, 1]
        if now >= start:
            begun.append(square)
        elif WINDOW + WARM <= now < start - LAG:
            quiet.append(square)
    assert np.mean(quiet) < 1
    # Were only the energies of late asked, it would be 50: the start itself is known badly.
    assert np.mean(begun) < 20


def test_each_window_forgets_at_its_own_pace() -> None:
    spectrum = Spectrum()
    length = np.array([[2.5], [25.0]])
    squares = np.broadcast_to((np.arange(60.0) < 30)[:, None], (2, 1, 60, 1)).astype(float)
    mean, instants = spectrum.follow(squares, np.ones((2, 60, 1), bool), length, 2.0)
    # Of 60 instants the first 30 held 1: means of the last 5 or so, or of all up to 50.
    assert mean[:, 0, -1, 0] == pytest.approx([0.8**30, 0.5], rel=0.2)
    assert instants[:, -1, 0].tolist() == [5, 50]


def lasting(count: int) -> np.ndarray:
    """Means (120,) of squares that are 1, and a million times that for so many instants."""
    squares = np.ones((1, 2, 120, 1))
    squares[:, :, 60 : 60 + count] = 1e6
    squares[:, 1, 90] = 40.0
    found = Spectrum().follow(squares, np.ones((1, 120, 1), bool), np.array([[8.25]]), 3.0)[0]
    assert found[0, 1, 90, 0] > 2
    return np.asarray(found[0, 0, :, 0])


def test_what_is_over_before_a_window_has_passed_leaves_no_trace_in_averages() -> None:
    """One frame is in the windows of 9 judgments, if they are 8.25 judgments long."""
    for count in (1, 8, 9):
        assert (lasting(count) == 1.0).all()
    assert lasting(13)[72] > 1e5
    # Before two windows nobody knows what is usual.
    squares = np.where(np.arange(40) == 10, 1e6, 1.0)[None, None, :, None]
    mean, _ = Spectrum().follow(squares, np.ones((1, 40, 1), bool), np.array([[8.25]]), 3.0)
    assert mean[0, 0, 10, 0] > 1e4


@pytest.mark.parametrize('every', [1, 12, 500])
def test_averages_take_in_as_many_squares_however_seldom_they_are_asked(every: int) -> None:
    # Between judgments 500 instants apart the shortest window, of 7 samples, comes and goes.
    stamps = 10**6 * np.arange(-2000, 2001)[:, None]
    signals = np.random.default_rng(0).normal(size=(4001, 1, 1, 2)) * (1, 0)
    fits = project(stamps, signals, None, 2)
    seen = []

    def past(squares: np.ndarray, known: np.ndarray, length: np.ndarray, back: float) -> Any:
        seen.append(back * length)
        return squares, np.broadcast_to(np.minimum(1000.0, seen[-1][:, None]), known.shape)

    ones = np.ones(1, int)
    found = weigh_apart(fits, squares_of(fits, ones), np.ones(1), ones, 2, past, every)
    lengths = fits.models.lengths[:, 0, 0]
    assert seen[0][:, 0] == pytest.approx(3 * np.maximum(lengths / every, 1))
    assert np.isfinite(found.covariance).all()


def test_averages_go_on_alike_over_many_instants_and_one_by_one() -> None:
    rng = np.random.default_rng(0)
    squares, known = rng.random((2, 3, 80, 2)), rng.random((2, 80, 2)) < 0.8
    squares[:, :, 50:56] *= 1e4
    squares[:, 1, 60:] *= 1e3
    length = np.array([[2.5], [10.0]])
    at_once = Spectrum().follow(squares, known, length, 2.0)
    assert at_once[0][1, 0].max() < 2
    assert at_once[0][0, 1, -1].min() > 100
    spectrum = Spectrum()
    for k in range(80):
        one = slice(k, k + 1)
        mean, instants = spectrum.follow(squares[:, :, one], known[:, one], length, 2.0)
        assert np.array_equal(mean, at_once[0][:, :, one])
        assert np.array_equal(instants, at_once[1][:, one])


def test_the_covariance_between_orders_is_one() -> None:
    """No combination of derivatives has a negative variance, though windows are mixed by order."""
    times = stamps('jittered', 5_000_000)
    covariance = np.moveaxis(differentiate(times, noisy(), None, LEVEL, TWO, 4).covariance, -1, 0)
    assert (covariance == np.swapaxes(covariance, 1, 2)).all()
    deviation = np.sqrt(np.einsum('gkk->gk', covariance))
    correlation = covariance / (deviation[:, :, None] * deviation[:, None])
    assert (np.linalg.eigvalsh(correlation) > -1e-12).all()


# --- the buffer ---------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.lists(st.one_of(st.integers(1, 150), st.floats(0, 1)), max_size=25))
def test_the_buffer_is_a_queue(actions: list[int | float]) -> None:
    """Whole numbers put in so many rows, fractions take out that share."""
    buffer = Samples((2,), float)
    model: list[tuple[float, float]] = []
    put = 0
    for action in actions:
        if isinstance(action, int):
            rows = [(float(put + k), -float(put + k)) for k in range(1, action + 1)]
            put += action
            buffer.room(action)[...] = rows
            model += rows
        else:
            count = int(action * len(model))
            buffer.drop(count)
            del model[:count]
        assert len(buffer) == len(model)
        assert buffer.view().shape == (len(model), 2)
        assert np.array_equal(buffer.view(), np.array(model).reshape(-1, 2))


def test_the_buffer_does_not_grow_with_what_goes_through() -> None:
    buffer = Samples((), np.int64)
    for k in range(10_000):
        buffer.room(1)[0] = k
        if len(buffer) > 60:
            buffer.drop(1)
    assert buffer.view().tolist() == list(range(9940, 10_000))
    whole = buffer.view().base
    assert whole is not None
    assert len(whole) <= 256


# --- noise and shape ----------------------------------------------------------------------------

SHAPE = np.array([14 + 2j, -3 + 10j, 6 - 15j, 13 + 1j, -20 - 10j, 5 + 5j, -10 + 12j, 20 - 3j])
SHAPE = np.concatenate((SHAPE, [-17 + 4j, 2 - 20j])) / 100
SIGMA = 1e-4


def poses(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a body is and how it is turned, in a smooth motion at 200 Hz."""
    times = np.arange(frames) / 200
    return 0.3 * np.exp(3j * times), 6 * times


def tracked(markers: int, frames: int, seed: int) -> np.ndarray:
    """Noisy markers (frames, markers) of the first of SHAPE's points."""
    rng = np.random.default_rng(seed)
    position, angle = poses(frames)
    exact = position[:, None] + np.exp(1j * angle)[:, None] * SHAPE[:markers]
    return exact + SIGMA * (rng.normal(size=(frames, markers, 2)) @ (1, 1j))


def measured(points: np.ndarray) -> float:
    """The noise level found, over the true one."""
    noise, shapes = Noise(1), Shapes(1, points.shape[1])
    deque(fit_frames(points[:, None], shapes, noise), maxlen=0)
    return float(noise.level()[0]) / SIGMA


@pytest.mark.parametrize('markers', [2, 3, 4, 10])
@pytest.mark.parametrize('seed', range(3))
def test_the_noise_is_measured(markers: int, seed: int) -> None:
    points = tracked(markers, 400, seed)
    assert measured(points) == pytest.approx(1, abs=0.15)
    rng = np.random.default_rng(seed)
    # Markers that are not seen now and then.
    dropped = np.where(rng.random(points.shape) < 0.2, np.nan, points)
    assert measured(dropped) == pytest.approx(1, abs=0.35)
    # A lens, or a plane that is not quite the markers': ten times the noise, but slow.
    position, _ = poses(400)
    bent = points + 10 * SIGMA * position[:, None] * np.arange(markers)
    assert measured(bent) == pytest.approx(1, abs=0.2)
    # A marker that jumps by 500 times the noise, each time spoiling three comparisons.
    jumping = points.copy()
    jumping[20::40, 0] += 500 * SIGMA
    assert measured(jumping) == pytest.approx(1.15, abs=0.35)
    # Where it jumps in every tenth frame the noise is at least not taken for less.
    jumping[rng.random(400) < 0.1, 0] += 500 * SIGMA
    assert measured(jumping) > 0.85


@pytest.mark.parametrize('speed', [1.0, 0.1, 0.02, 0.008])
def test_a_tracker_that_rounds_is_not_taken_for_exact(speed: float) -> None:
    times = np.arange(400) / 200
    exact = speed * times[:, None] + np.exp(1j * speed * 5 * times)[:, None] * SHAPE[:4]
    points = (exact / 1e-3).round() * 1e-3  # NumPy rounds both parts
    uniform = 1e-3 / np.sqrt(12) / SIGMA
    assert 0.1 * uniform < measured(points) < 1.5 * uniform


def test_the_noise_is_unknown_without_residuals() -> None:
    noise, shapes = Noise(2), Shapes(2, 3)
    assert np.isnan(noise.level()).all()
    points = tracked(3, 20, 0)
    both = np.stack([np.stack((row, [row[0], np.nan, np.nan])) for row in points])
    deque(fit_frames(both, shapes, noise), maxlen=0)
    assert np.isfinite(noise.level()).tolist() == [True, False]


def test_bodies_have_noise_of_their_own() -> None:
    quiet, loud = tracked(4, 400, 0), tracked(4, 400, 1)
    position, angle = poses(400)
    exact = position[:, None] + np.exp(1j * angle)[:, None] * SHAPE[:4]
    loud = exact + 100 * (loud - exact)
    noise, shapes = Noise(2), Shapes(2, 4)
    deque(fit_frames(np.stack((quiet, loud), axis=1), shapes, noise), maxlen=0)
    assert noise.level() / SIGMA == pytest.approx([1, 100], rel=0.15)


def test_residuals_across_a_gap_are_not_compared() -> None:
    def level(forget: bool) -> float:
        noise, k = Noise(1), np.arange(60)
        # Each third frame comes after a gap in which the distortion changed.
        bent = tracked(4, 60, 2) + (k // 3 % 2)[:, None] * 1e-2 * np.arange(4)
        fit = fit_pose(bent[:, None], SHAPE[None, :4], np.ones((60, 1, 4)))
        noise.add(fit.residual, fit.freedom, (k % 3 != 0) | (not forget))
        return float(noise.level()[0]) / SIGMA

    assert level(True) == pytest.approx(1, abs=0.35)
    assert level(False) > 10


def learned(points: np.ndarray) -> tuple[Shapes, list[Fit]]:
    shapes = Shapes(1, points.shape[1])
    return shapes, [fit for fit, _ in fit_frames(points[:, None], shapes)]


def shape_error(shapes: Shapes, markers: int) -> float:
    """RMS distance of the learned shape from the true one, laid on it, over the noise."""
    fit = fit_pose(shapes.points[0], SHAPE[:markers].astype(complex), np.ones(markers))
    return float(np.sqrt((np.abs(fit.residual) ** 2).mean())) / SIGMA


@pytest.mark.parametrize('markers', [2, 4, 10])
def test_the_shape_gets_better_with_every_frame(markers: int) -> None:
    points = tracked(markers, 1600, 3)
    for frames in (25, 100, 400, 1600):
        shapes, _ = learned(points[:frames])
        # A mean of N frames is off by sqrt(2 / N); its growing weights cost sqrt(4 / 3) more.
        assert shape_error(shapes, markers) < 2.2 * np.sqrt(2 / frames)


def test_a_marker_seen_late_joins_the_shape() -> None:
    points = tracked(5, 800, 4)
    points[:400, 3] = np.nan
    points[np.random.default_rng(5).random(points.shape) < 0.3] = np.nan
    shapes, fits = learned(points)
    assert shapes.known.tolist() == [5]
    assert shape_error(shapes, 5) < 0.3
    spread = np.sum(np.abs(SHAPE[:5] - SHAPE[:5].mean()) ** 2)
    assert shapes.spread == pytest.approx(spread, rel=0.01)
    enough = (~np.isnan(points)).sum(axis=1) >= 2
    assert np.array_equal([np.isfinite(fit.angle[0]) for fit in fits], enough)


def test_the_frame_of_a_body_does_not_creep() -> None:
    position, angle = poses(2000)
    for markers in (2, 4):
        _, fits = learned(tracked(markers, 2000, 6))
        turned = np.array([fit.angle[0] for fit in fits]) - angle
        turned = np.angle(np.exp(1j * (turned - turned[0])))
        arm = np.array([fit.position[0] for fit in fits]) - position
        arm = arm * np.exp(-1j * angle)
        arm = arm - arm[0]
        for values in (turned * np.abs(SHAPE).mean(), np.abs(arm - arm[:500].mean())):
            early, late = values[100:600], values[1500:]
            # Each mean is known to about the noise over sqrt(500).
            assert abs(early.mean() - late.mean()) < 0.25 * SIGMA


def test_a_body_starts_at_its_mean_along_the_axes_of_the_ground() -> None:
    points = tracked(4, 1, 7)
    points[0, 2] = np.nan
    shapes, fits = learned(points)
    seen = np.delete(points[0], 2)
    assert fits[0].angle[0] == pytest.approx(0, abs=1e-12)
    assert fits[0].position[0] == pytest.approx(seen.mean())
    assert np.delete(shapes.points[0], 2) == pytest.approx(seen - seen.mean())
    assert shapes.known.tolist() == [3]


@pytest.mark.parametrize('place', [0j, 0.1 + 0.7j, 1e6 + 0.1j])
def test_markers_at_one_place_at_first_do_not_spoil_the_shape(place: complex) -> None:
    points = tracked(4, 60, 8)
    points[:10] = place
    shapes, fits = learned(points)
    assert [np.isfinite(fit.angle[0]) for fit in fits] == 10 * [False] + 50 * [True]
    assert shape_error(shapes, 4) < 1


def test_room_for_more_markers_keeps_what_is_known() -> None:
    points = tracked(6, 200, 9)
    shapes, _ = learned(points[:100, :4])
    shapes.learn()
    before = shapes.points.copy()
    shapes.widen(6)
    assert np.array_equal(shapes.points[:, :4], before)
    assert shapes.known.tolist() == [4]
    deque(fit_frames(points[100:, None], shapes), maxlen=0)
    assert shapes.known.tolist() == [6]
    assert shape_error(shapes, 6) < 0.6


@pytest.mark.parametrize('kind', ['even', 'jittered'])
def test_figures_do_not_hang_on_what_was_asked_before(kind: str) -> None:
    times = stamps(kind, 5_000_000)
    _models.shared_models.cache_clear()
    first, second = (differentiate(times, noisy(), None, LEVEL, TWO, 4) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other)


def test_fewest_samples_hold_every_order() -> None:
    times = (np.arange(FEWEST_SAMPLES) - FEWEST_SAMPLES + 1) * 5_000_000
    found = differentiate(times, noisy(count=FEWEST_SAMPLES), None, LEVEL, TWO, 4)
    assert np.isfinite(found.values).all()


@pytest.mark.parametrize('steps', [(1, 5_000_000), (5_000_000, 1), (1, 1_000)])
def test_a_few_samples_far_from_even_are_fitted(steps: tuple[int, int]) -> None:
    times = np.cumsum([0, *steps, *steps, *steps])
    times -= times[-1]
    straight = scalars(1e-9 * times[:, None] + 2.0)
    found = differentiate(times, straight, None, np.full(1, 1e-12), np.ones(1), 4)
    assert np.isfinite(found.values).all()
    assert found.values[0, 0, 0] == pytest.approx(2.0, abs=1e-12)


def setting_in(instants: int, noise: float) -> np.ndarray:
    """Poses (101, M, 2, 2) of a body that starts to turn about the point ARM between samples."""
    times = 5_000_000 * np.arange(-80, 21)
    seconds = (times[:, None] + 5_000_000 * np.arange(instants)) * 1e-9
    turned = 40 * np.clip(seconds + 0.012, 0, None) ** 2
    rng = np.random.default_rng(5)
    signals = np.zeros((101, instants, 2, 2))
    signals[..., 0, 0] = turned
    signals[..., 1, :] = -turned[..., None] * np.array([-ARM.imag, ARM.real])
    signals[..., 0, 0] += rng.normal(0, noise, (101, instants))
    signals[..., 1, :] += rng.normal(0, noise, (101, instants, 2))
    return signals


ARM = 0.1 - 0.25j


def test_frames_are_weighted_where_that_gains_a_tenth_of_the_variance() -> None:
    """Of three frames in a hundred a third is missing, in other windows one tells nothing."""
    stamps = 5_000_000 * np.arange(200)
    information = np.full((200, 2), 3.0)
    information[[40, 50, 60]] = 2.0
    information[150] = 0.01
    now, oldest, newest = np.array([[80, 180], [0, 100], [99, 199]])
    windows = now, oldest, newest
    found = window.runs(stamps, windows, np.zeros((200, 2, 2)), information, np.full((2, 2), 0.6))
    (_, _, weights, noise), (_, _, other_weights, other_noise) = found
    assert weights is None
    # The variance of a frame that is as good as the others.
    assert noise == pytest.approx(0.6 * np.sqrt((97 / 3 + 3 / 2) / 100))
    assert sorted(set(other_weights.ravel())) == pytest.approx([0.01 / 3, 1.0])
    assert other_noise == pytest.approx(0.6 / np.sqrt(3))


@pytest.mark.parametrize('weighted', [False, True])
def test_together_what_is_off_by_one_factor_in_angle_and_position_cancels(weighted: bool) -> None:
    """A motion that sets in between two samples, about one point: all windows are off, alike."""
    weights = np.ones((101, 2))
    weights[30:33] = 0.0
    instants = 1 if weighted else 4
    times = np.repeat(5_000_000 * np.arange(-80, 21)[:, None], instants, axis=1)
    fits = project(times, setting_in(instants, 1e-9), weights if weighted else None, 3, 1)
    arms = np.full((3, instants, 1), ARM)
    found = weigh_together(fits, arms, np.full((instants, 2), 1e-9), 3, Spectrum().follow)
    # By weights of their own, which do not matter here, come the first angles and last positions.
    share, mix = (np.pad(part, ((0, 0), (0, 0), (1, 1), (0, 0), (0, 0))) for part in found[:2])
    values = both_ways(fits, share, mix)
    for order in (1, 2, 3):
        angle, (x, y) = values[order, 0, order], values[order, 1:, order - 1]
        position = x + 1j * y
        # The angle's derivative itself is off by percents.
        np.testing.assert_allclose(position, -1j * angle * ARM, atol=1e-5 * np.abs(angle).max())


def test_together_bodies_and_instants_do_not_mix() -> None:
    """Two bodies at four instants, and the second one of them alone, instant by instant."""
    times = np.repeat(5_000_000 * np.arange(-80, 21)[:, None], 4, axis=1)
    rng = np.random.default_rng(2)
    steady = np.cumsum(rng.normal(0, 1e-3, (101, 4, 2, 2)), axis=0)
    steady[..., 0, 1] = 0
    # Angles first, then positions.
    signals = np.stack((steady, setting_in(4, 1e-5)), axis=3).reshape(101, 4, 4, 2)
    arms = np.stack((np.full((3, 4), 0.5 + 0.1j), np.full((3, 4), ARM)), axis=-1)
    # Well above rounding: products of one column and of many are rounded differently.
    noise = np.full((4, 4), 1e-5)
    past = Spectrum().follow
    both = weigh_together(project(times, signals, None, 3, 2), arms, noise, 3, past)
    past = Spectrum().follow
    for m in range(4):
        now = slice(m, m + 1)
        fits = project(times[:, now], signals[:, now, 1::2], None, 3, 1)
        alone = weigh_together(fits, arms[:, now, 1:], noise[now, 1::2], 3, past)
        means = both.means.reshape(*both.means.shape[:3], 3, 2)[:, :, now, :, 1]
        here = [part[..., now, 1:] for part in (both.share, both.mix, both.covariance)]
        found = alone.share, alone.mix, alone.covariance, alone.means
        for one, there in zip(found, (*here, means), strict=True):
            np.testing.assert_allclose(one, there, rtol=1e-9, atol=1e-9 * np.abs(there).max())
