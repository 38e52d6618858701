"""From poses to derivatives: what Gaussian processes say, and as good as their own covariance."""

import sys
import tracemalloc
from collections.abc import Iterator
from math import factorial
from typing import Any

import derivatives_reference
import numpy as np
import pytest
from derivatives_reference import _evidence, _sizes, _steps
from derivatives_reference import _models as stacked
from derivatives_reference._samples import Window, seen_of
from hypothesis import given
from hypothesis import strategies as st

from bench._polynomial import derivative_weights
from kinpole_ros.derivatives import (
    FEWEST_SAMPLES,
    Derivatives,
    Poses,
    Windows,
    _models,
    _pose_derivatives,
    derive_poses,
)
from kinpole_ros.mechanism import load_scene

pytestmark = pytest.mark.filterwarnings('error')

ORDERS = np.arange(5)
STEP = 5_000_000
COUNT, AHEAD = 100, 20


def derive(
    time: np.ndarray,
    angle: np.ndarray,
    position: np.ndarray,
    noise: float | np.ndarray,
    now: Any = None,
    order: int = 4,
    count: int = COUNT,
    information: np.ndarray | None = None,
    left_out: int | np.ndarray = 0,
    window: float | None = None,
    ahead: int = AHEAD,
) -> Derivatives:
    """
    Derivatives of poses (N, B) at instants `now`, the last there is unless given.

    Of windows of `count` frames, `ahead` of which are newer, or fewer where there are no more.
    """
    now = np.array([len(time) - 1 - ahead] if now is None else now)
    good = np.ones(angle.shape) if information is None else information
    frames = Windows(now, np.maximum(now + ahead - count + 1, 0), now + ahead)
    shape = len(now), angle.shape[1]
    length = (count - 1) * float(np.median(np.diff(time))) * 1e-9 if window is None else window
    return derive_poses(
        Poses(time, angle, np.zeros_like(angle), position, good, good),
        frames,
        np.broadcast_to(left_out, shape).astype(int),
        np.broadcast_to(noise, shape).astype(float),
        length,
        order,
    )


def stamps(count: int, step: float = STEP, kind: str = 'even') -> np.ndarray:
    """Times, ns, a `step` apart or about so."""
    rng = np.random.default_rng(1)
    places = np.arange(count, dtype=float)
    if kind == 'jittered':
        places += rng.uniform(-0.3, 0.3, count)
    if kind == 'gappy':
        places = np.delete(places, [20, 21, 22, 23, 50, 51, 78])
    return np.rint(places * step).astype(np.int64)


def smooth(
    time: np.ndarray, bodies: int, hertz: float = 2.0, seed: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and positions (5, N, B) with all their derivatives, of size 1 to begin with."""
    rng = np.random.default_rng(seed)
    rate = 2 * np.pi * hertz * rng.uniform(0.7, 1, (3, bodies))
    phase = rng.uniform(0, 6, (3, bodies)) + rate * (time[:, None, None] * 1e-9)
    orders = ORDERS[:, None, None, None]
    angle, x, y = np.moveaxis(rate**orders * np.sin(phase + orders * np.pi / 2), 2, 0)
    return angle, x + 1j * y


def noisy(
    exact: tuple[np.ndarray, np.ndarray], sigma: float, seed: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and positions (N, B) as they are measured."""
    rng = np.random.default_rng(seed)
    angle, position = exact[0][0], exact[1][0]
    x, y, turned = sigma * rng.normal(size=(3, *angle.shape))
    return angle + turned, position + x + 1j * y


def below(found: Any, most: Any) -> None:
    """Each number is below its bound; NaN is not."""
    share = np.max(np.asarray(found) / np.asarray(most))
    assert share < 1, f'{share:.3g} times the bound'


def same(one: Derivatives, other: Derivatives, tolerance: float = 1e-9) -> None:
    """Equal to `tolerance` of each standard deviation, and the variances relatively."""
    for name in ('angle', 'position'):
        covariance = getattr(other, f'{name}_covariance')
        deviation = np.sqrt(np.einsum('kk...->k...', covariance))
        off = np.abs(getattr(one, name) - getattr(other, name))
        below(off / deviation, tolerance)
        off = np.abs(getattr(one, f'{name}_covariance') - covariance)
        below(off / (deviation[:, None] * deviation), tolerance)
    np.testing.assert_allclose(one.span, other.span, rtol=tolerance)
    np.testing.assert_allclose(one.parameters, other.parameters, rtol=1e3 * tolerance)


def of_all(found: Derivatives, exact: tuple[np.ndarray, np.ndarray], now: Any) -> np.ndarray:
    """Errors (K, 3, T, B) of angles and both coordinates, in stated deviations."""
    orders = slice(len(found.angle))
    angle = found.angle - exact[0][orders, now]
    off = found.position - exact[1][orders, now]
    deviation = np.sqrt(
        [np.einsum('kk...->k...', c) for c in (found.angle_covariance, found.position_covariance)]
    )
    return np.stack((angle / deviation[0], off.real / deviation[1], off.imag / deviation[1]), 1)


# --- the process, and nothing else --------------------------------------------------------------


def waves(
    process: tuple[float, float] | int, count: int, time: np.ndarray, order: int
) -> np.ndarray:
    """
    Derivatives (n, J) of what a process is a sum of, each with a normal factor, at n times.

    In samples from the middle. A process is a power and a length, or the degree of a polynomial.
    """
    if isinstance(process, int):
        powers = [
            np.polynomial.Polynomial([0] * degree + [(2 / count) ** degree])
            for degree in range(2, process + 1)
        ]
        return np.reshape([power.deriv(order)(time) for power in powers], (-1, len(time))).T
    power, length = process
    step = 2 * np.pi / (count + 10 * length)
    frequency = step * np.arange(int(np.pi / step) + 1)
    density = np.exp(-((frequency * length) ** power))
    density[0] /= 2
    phase = frequency * time[:, None] + order * np.pi / 2
    size = np.sqrt(density / density.sum()) * frequency**order
    return np.concatenate((size * np.cos(phase), size * np.sin(phase)), axis=1)


def regression(
    process: tuple[float, float] | int,
    amplitude: float,
    count: int,
    at: float,
    place: np.ndarray,
    variance: np.ndarray,
    orders: int,
    block: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Weights (K, n) of samples in derivatives at an instant, and the covariance (K, K) of these.

    Of samples at `place` with their `variance`, of the process on a line of which nothing is known;
    each is the mean of so many in a `block`.
    """
    offsets = (np.arange(block) - (block - 1) / 2) / block
    there = amplitude * np.mean([waves(process, count, place + o, 0) for o in offsets], axis=0)
    instant = np.array([at])
    here = amplitude * np.concatenate([waves(process, count, instant, k) for k in range(orders)])
    line = np.stack((np.ones(len(place)), place), axis=1)
    of_line = np.zeros((orders, 2))
    of_line[0], of_line[1, 1] = (1, at), 1
    own = there @ there.T + np.diag(variance)
    lifted = np.linalg.solve(own, line)
    slopes = np.linalg.solve(line.T @ lifted, lifted.T)
    weights = np.linalg.solve(own, there @ here.T).T
    weights = weights + (of_line - weights @ line) @ slopes
    # What of the process they miss, and the noise that they let through.
    missed = here - weights @ there
    return weights, missed @ missed.T + (weights * variance) @ weights.T


@pytest.mark.parametrize(
    ('count', 'at', 'block'),
    [(40, 0.0, 1), (40, 19.5, 1), (41, 0.0, 1), (41, -9.5, 1), (30, 4.625, 4), (31, 4.0, 3)],
)
def test_stencils_are_those_of_the_regression_on_each_process(
    count: int, at: float, block: int
) -> None:
    modes, stencils = stacked.modes_of(count, block), stacked.stencils_of(count, at, block, 5)
    place = np.arange(count) - (count - 1) / 2
    amplitudes = _models._amplitudes(False)
    layout = stacked._layout(count, block, False)
    processes = [each.process for _, members in layout for each in members]
    rows = np.pad(stencils.modes, ((0, 0), (0, 1)))
    compared = set()
    for p, process in enumerate(processes):
        if process.spectrum >= 0:
            what: Any = _models.SPECTRA[process.spectrum][0], process.length
        else:
            what = int(process.length)
        for a in (0, 1, 2):
            weights, covariance = regression(
                what, amplitudes[a], count, at, place, np.ones(count), 5, block
            )
            model = len(amplitudes) * p + a
            own = rows[:, modes.place[model]]
            found = (own * modes.share[model]) @ modes.vectors[modes.place[model]]
            size = np.linalg.norm(weights, axis=1, keepdims=True)
            below(np.abs(found - weights), 2e-5 * size + 1e-12)
            there = (own * modes.share[model]) @ own.T
            there += stencils.unseen[:, model].reshape(5, 5)
            size = np.sqrt(np.diag(covariance))
            off = np.abs(there - covariance) / (size[:, None] * size + 1e-12)
            # The variance of snap at an end of the window has modes that are not seen.
            below(off, 2e-3)
            compared.add(what if isinstance(what, int) else what[0])
    assert compared == {1, 2, 1.4}


def test_the_process_of_the_steepest_spectrum_has_a_gaussian_covariance() -> None:
    time = np.arange(-30.0, 31.0)
    functions = waves((2.0, 6.0), 61, time, 0)
    apart = time[:, None] - time
    np.testing.assert_allclose(functions @ functions.T, np.exp(-((apart / 12) ** 2)), atol=1e-9)


ONE = (2.0, 12.0)
ONE_AMPLITUDE = 300.0


@pytest.fixture
def one_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """There is one process on a line, or a line, or rest: the first is by far the likeliest."""
    monkeypatch.setenv('KINPOLE_CACHE', '')
    caches = [one for one in vars(_models).values() if hasattr(one, 'cache_clear')]
    monkeypatch.setattr(_pose_derivatives, '_tables', {})
    monkeypatch.setattr(_models, 'SPECTRA', (ONE,))
    monkeypatch.setattr(_models, '_DEGREES', (1,))
    monkeypatch.setattr(_models, '_MAX_LENGTH', ONE[1] / 50)
    monkeypatch.setattr(_models, '_amplitudes', lambda exact: np.array([ONE_AMPLITUDE]))
    # What there is of modes below the noise would be left out otherwise.
    monkeypatch.setattr(_models, '_MIN_MODE_SIGMA', 1e-5)
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


def drawn(count: int, bodies: int, sigma: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Angles and positions (N, B) of the one process, with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(count, dtype=float)
    functions = waves(ONE, 50, time, 0)
    signals = ONE_AMPLITUDE * sigma * functions @ rng.normal(size=(functions.shape[1], 3 * bodies))
    signals += sigma * rng.normal(size=signals.shape)
    angle, x, y = np.moveaxis(signals.reshape(count, bodies, 3), 2, 0)
    return angle, x + 1j * y


def regressed(
    angle: np.ndarray, position: np.ndarray, place: np.ndarray, variance: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, position (K, B), and what follows from the covariance (K, K), of 50 samples."""
    weights, covariance = regression(ONE, ONE_AMPLITUDE, 50, 24.5 - AHEAD, place, variance, 4)
    scale = (STEP * 1e-9) ** -ORDERS[:4].astype(float)
    covariance = covariance * scale[:, None] * scale * sigma**2
    return scale * (weights @ angle), scale * (weights @ position), covariance


def check_regressed(found: Derivatives, b: int, expected: tuple[np.ndarray, ...]) -> None:
    """Of a body: derivatives to 1e-5 of their deviations, correlations to a hundredth."""
    angle, position, covariance = expected
    deviation = np.sqrt(np.diag(covariance))
    below(np.abs(found.angle[:, 0, b] - angle) / deviation, 1e-5)
    below(np.abs(found.position[:, 0, b] - position) / deviation, 1e-5)
    for one in (found.angle_covariance, found.position_covariance):
        there = one[:, :, 0, b]
        # How large the noise is, is a matter of the samples too.
        variance = there[0, 0] / covariance[0, 0]
        assert 0.7 < variance < 1.4
        size = variance * deviation[:, None] * deviation
        np.testing.assert_allclose(there / size, covariance / deviation[:, None] / deviation,
                                   atol=1e-2)  # fmt: skip


def test_what_is_found_is_the_regression_on_a_process(one_process: None) -> None:
    angle, position = drawn(50, 3, 1e-3)
    found = derive(stamps(50), angle, position, 1e-3, count=50, order=3)
    place = np.arange(50) - 24.5
    for b in range(3):
        expected = regressed(angle[:, b], position[:, b], place, np.ones(50), 1e-3)
        check_regressed(found, b, expected)


@pytest.mark.parametrize('share', [0.0, 0.1, 0.4])
@pytest.mark.parametrize(
    'which', [[10], [1, 2, 3], [48], [20, 21, 22, 23], [28, 30], list(range(1, 49, 3)), [5, 30, 44]]
)
def test_samples_that_are_missing_or_count_for_less_are_as_in_the_regression(
    one_process: None, which: list[int], share: float
) -> None:
    angle, position = drawn(50, 2, 1e-3)
    information = np.ones((50, 2))
    information[which, 1] = share
    if not share:
        angle[which, 1] = position[which, 1] = np.nan
    found = derive(stamps(50), angle, position, 1e-3, count=50, order=3, information=information)
    place = np.arange(50) - 24.5
    for b in range(2):
        kept = information[:, b] > 0
        expected = regressed(
            angle[kept, b], position[kept, b], place[kept], 1 / information[kept, b], 1e-3
        )
        check_regressed(found, b, expected)


# --- exactness ----------------------------------------------------------------------------------


@pytest.mark.parametrize('noise', [1e-4, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize('step', [1_000, 5_000_000, 10**12], ids=['1 us', '5 ms', '1000 s'])
@pytest.mark.parametrize('kind', ['even', 'jittered', 'gappy'])
def test_polynomials_are_recovered_whatever_the_stamps(kind: str, step: int, noise: float) -> None:
    """Up to degree 2, from exact samples, to a part of what is stated or of rounding."""
    time = stamps(COUNT, step, kind)
    unit = 50 * step * 1e-9
    now = len(time) - 1 - AHEAD
    t = (time - time[now]) * 1e-9 / unit
    rng = np.random.default_rng(2)
    # Body by body of one degree more.
    coefficients = np.tril(rng.uniform(0.5, 1, (3, 5, 5)) * rng.choice((-1, 1), (3, 5, 5)))
    coefficients[:, :, 3:] = 0
    angle, x, y = np.einsum('nd,cbd->cnb', t[:, None] ** np.arange(5), coefficients)
    found = derive(time, angle, x + 1j * y, noise)
    scale = np.array([factorial(k) / unit**k for k in range(5)])
    truth = coefficients.transpose(0, 2, 1) * scale[:, None]
    # Rounding of samples that are as large as 10 times a derivative's gain.
    rounding = 1e-15 * 30.0**ORDERS * scale
    # Samples of 1e13 deviations are moved to their places to a part in 1e8 only.
    part, noise = (3.0, 1e-8) if kind == 'jittered' and noise == 1e-12 else (0.1, noise)
    for there, expected, covariance in (
        (found.angle[:, 0], truth[0], found.angle_covariance),
        (found.position[:, 0], truth[1] + 1j * truth[2], found.position_covariance),
    ):
        deviation = np.sqrt(np.einsum('kk...->k...', covariance))[:, 0]
        allowed = part * deviation + rounding[:, None]
        below(np.abs(there - expected), allowed)
        # What is stated is no more than the noise of a polynomial of degree 6.
        gain = derivative_weights((time - time[now]) * 1e-9, 6, 4)
        most = 3 * noise * np.linalg.norm(gain, axis=1)
        below(deviation, (most + rounding)[:, None])


@pytest.mark.parametrize('noise', [1e-4, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize('hertz', [0.5, 1.0, 2.0, 4.0])
def test_sines_are_recovered_to_a_part_of_what_is_stated(hertz: float, noise: float) -> None:
    time = stamps(COUNT)
    exact = smooth(time, 40, hertz)
    now = [COUNT - 1 - AHEAD]
    found = derive(time, exact[0][0], exact[1][0], noise)
    off = of_all(found, exact, now)[:, :, 0]
    rate = (2 * np.pi * hertz) ** ORDERS
    stated = np.sqrt(np.einsum('kk...->k...', found.angle_covariance))[:, 0]
    assert np.sqrt((off[:4] ** 2).mean(axis=(1, 2))).max() < 1.0
    # And that is little where samples are good: of the derivatives themselves.
    least = {1e-4: 1e-2, 1e-6: 1e-3, 1e-9: 1e-5, 1e-12: 1e-6}[noise]
    assert (np.median(stated, axis=1)[:3] < least * rate[:3] * (1 + 1 / hertz**2)).all()


# --- motions of all kinds -----------------------------------------------------------------------


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


RATE, LAG = 200, 20
TIMES = np.arange(700) / RATE
MOTIONS = motions(TIMES)
INSTANTS = np.arange(200, 700 - LAG)


def answers(noise: float) -> dict[str, np.ndarray]:
    """RMS errors (5,) of every motion, 0.1 s behind the newest of 0.5 s of samples."""
    rng = np.random.default_rng(7)
    truth = np.array([signal for signal, _ in MOTIONS.values()])  # (motions, 5, N)
    samples = np.stack((truth[:, 0].real.T, truth[:, 0].imag.T), axis=-1)
    samples = samples + noise * rng.normal(size=samples.shape)
    found = derive(
        stamps(700), samples[..., 0], samples @ (1, 1j), max(noise, 1e-14), INSTANTS, count=101
    )
    errors = {}
    for b, (name, (signal, dimensions)) in enumerate(MOTIONS.items()):
        values = (found.angle if dimensions == 1 else found.position)[:, :, b]
        off = np.abs(values - signal[:, INSTANTS]) ** 2
        errors[name] = np.sqrt(off.mean(axis=1))
    return errors


@pytest.fixture(scope='module')
def clean() -> dict[str, np.ndarray]:
    return answers(0.0)


@pytest.fixture(scope='module')
def rough() -> dict[str, np.ndarray]:
    return answers(2e-4)


# RMS errors of first to fourth derivative: exact samples; noise 2e-4.
BOUNDS = {
    'fast turn': ((1e-12, 1e-12, 1e-12, 1e-12), (3e-04, 1e-03, 5e-03, 6e-02)),
    'sine 1 Hz': ((3e-12, 2e-11, 6e-08, 3e-07), (2e-03, 6e-02, 2e00, 5e01)),
    'sine 4 Hz': ((3e-12, 4e-09, 4e-07, 5e-04), (5e-03, 3e-01, 2e01, 9e02)),
    'stop and go': ((1e-09, 3e-06, 2e-04, 4e-01), (5e-03, 3e-01, 2e01, 2e03)),
    'coupler angle': ((2e-12, 6e-09, 3e-07, 8e-04), (4e-03, 2e-01, 8e00, 5e02)),
    'crank pin': ((2e-12, 8e-11, 2e-08, 2e-06), (3e-03, 6e-02, 2e00, 6e01)),
    'wheel hub': ((1e-12, 1e-12, 1e-12, 1e-12), (4e-04, 1e-03, 5e-03, 6e-02)),
}


@pytest.mark.parametrize('name', MOTIONS)
@pytest.mark.parametrize('kind', ['clean', 'rough'])
def test_the_error_table(
    name: str, kind: str, clean: dict[str, np.ndarray], rough: dict[str, np.ndarray]
) -> None:
    found, bounds = (clean, BOUNDS[name][0]) if kind == 'clean' else (rough, BOUNDS[name][1])
    below(found[name][1:], bounds)


@pytest.mark.parametrize('name', MOTIONS)
def test_errors_are_near_the_best_in_hindsight(name: str, rough: dict[str, np.ndarray]) -> None:
    """Against the best single window and degree, known only once the truth is."""
    signal = MOTIONS[name][0]
    rng = np.random.default_rng(7)
    noise = 2e-4 * (rng.normal(size=(700, len(MOTIONS), 2)) @ (1, 1j))[:, list(MOTIONS).index(name)]
    samples = signal[0] + (noise if MOTIONS[name][1] == 2 else noise.real)
    best = np.full(5, np.inf)
    for length in range(7, 102, 6):
        ahead = min(LAG, (length - 1) // 2)
        nodes = np.arange(ahead - length + 1, ahead + 1)
        seen = samples[INSTANTS[:, None] + nodes]
        for degree in range(1, min(13, length - 2)):
            found = seen @ derivative_weights(nodes / RATE, degree, 4).T
            error = np.sqrt((np.abs(found - signal[:, INSTANTS].T) ** 2).mean(axis=0))
            error[degree + 1 :] = np.inf
            best = np.minimum(best, error)
    # What does not move at all has no error in hindsight: a straight line has no more derivatives.
    below(rough[name], np.array([1.5, 2.0, 2.5, 2.0, 4.0]) * best)


@pytest.mark.parametrize(
    ('hertz', 'noise', 'lowest', 'highest'),
    # No less than a quarter: what is stated allows for harmonics that these sines do not have.
    [(1.0, 1e-4, 0.25, 1.5), (2.0, 1e-5, 0.25, 1.5), (0.5, 1e-3, 0.25, 2), (2.0, 1e-2, 0.25, 2)],
)
def test_errors_are_about_as_large_as_stated(
    hertz: float, noise: float, lowest: float, highest: float
) -> None:
    rng = np.random.default_rng(6)
    time = stamps(COUNT)
    rate = 2 * np.pi * hertz
    phase = rng.uniform(0, 2 * np.pi, (3, 1, 400)) + rate * (time * 1e-9)[:, None]
    orders = ORDERS[:, None, None, None]
    angle, x, y = np.moveaxis(rate**orders * np.sin(phase + orders * np.pi / 2), 1, 0)
    exact = angle, x + 1j * y
    found = derive(time, *noisy(exact, noise), noise, order=3)
    spread = of_all(found, exact, [COUNT - 1 - AHEAD])[1:].std(axis=(2, 3))
    assert lowest < spread.min()
    assert spread.max() < highest


@pytest.mark.parametrize('ahead', [20, 0])
@pytest.mark.parametrize('noise', [1e-4, 1e-2])
@pytest.mark.parametrize(('power', 'length'), [(2.0, 15.0), (2.0, 40.0), (1.2, 12.0)])
def test_stated_intervals_hold_the_truth_as_often_as_they_say(
    power: float, length: float, noise: float, ahead: int
) -> None:
    """Of 95% for motions drawn at random, each with waves of its own."""
    rng = np.random.default_rng(5)
    time = stamps(COUNT)
    frequency = np.linspace(0, 6 / length, 300)
    weight = np.exp(-((frequency * length) ** power) / 2)
    weight /= np.linalg.norm(weight)
    now = [COUNT - 1 - ahead]
    phase = frequency * np.arange(COUNT)[:, None]
    turned = [phase + k * np.pi / 2 for k in range(4)]
    per = weight * (frequency / (STEP * 1e-9)) ** np.arange(4)[:, None, None]
    waves = per[..., None] * np.stack((np.cos(turned), -np.sin(turned)), axis=-1)
    random = rng.normal(size=(300, 2, 3, 300))
    angle, x, y = np.einsum('knfw,fwcb->cknb', waves, random)
    exact = angle, x + 1j * y
    found = derive(time, *noisy(exact, noise), noise, order=3, ahead=ahead)
    inside = (np.abs(of_all(found, exact, now)[1:]) < 1.96).mean(axis=(1, 2, 3))
    assert (inside > 0.90).all(), inside
    # More at lag 0 and for rough motion: models that are all possible disagree much there.
    assert (inside < 0.9995).all(), inside


def test_where_motion_sets_in_the_stated_errors_grow_with_the_true_ones() -> None:
    """What the models disagree about tells of the start."""
    start, noise, count = 400, 1e-4, 60
    rng = np.random.default_rng(8)
    moving = np.maximum(np.arange(start + 60) / RATE - start / RATE, 0.0)
    angle = 100 * moving[:, None] ** 3 + noise * rng.normal(size=(len(moving), count))
    now = np.arange(200, start + 5)
    position = noise * (rng.normal(size=(*angle.shape, 2)) @ (1, 1j))
    found = derive(stamps(len(angle)), angle, position, noise, now, order=1)
    truth = 300 * moving[now] ** 2
    square = (found.angle[1] - truth[:, None]) ** 2 / found.angle_covariance[1, 1]
    assert np.mean(square[now < start - LAG]) < 1
    # The start itself is known badly.
    assert np.mean(square[now >= start]) < 20


def test_a_body_at_rest_is_quiet_and_known_to_be() -> None:
    rng = np.random.default_rng(9)
    noise = 1e-3
    angle, x, y = noise * rng.normal(size=(3, COUNT, 200))
    found = derive(stamps(COUNT), angle, x + 1j * y, noise, order=3)
    # The slope of a line through all samples.
    line = noise * np.linalg.norm(derivative_weights(np.arange(COUNT) * STEP * 1e-9, 1, 1)[1])
    assert np.sqrt((found.angle[1] ** 2).mean()) < line
    assert np.sqrt(np.median(found.angle_covariance[1, 1])) < 2 * line
    assert np.median(found.parameters) < 2


@pytest.mark.parametrize('hidden', [(0.0, 0.0, 0.0), (2.4, -2.8, -1.0)])
def test_what_a_parabola_hides_is_covered(hidden: tuple[float, ...]) -> None:
    """Motion that is a parabola but for a few deviations, at a fourth of the window."""
    rng = np.random.default_rng(3)
    noise, count, ahead = 1e-3, 41, 10
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, count), 5)
    parts, signs = np.linalg.qr(powers)
    parts *= np.sign(np.diag(signs))
    exact = noise * parts @ np.array([0.0, -500.0, 350.0, *hidden])
    samples = exact[:, None] + noise * rng.normal(size=(3, count, 200))
    position = samples[1] + 1j * samples[2]
    found = derive(stamps(count), samples[0], position, noise, order=2, count=count, ahead=ahead)
    weights = derivative_weights((np.arange(count) - (count - 1 - ahead)) * STEP * 1e-9, 5, 2)
    off = found.angle[:, 0] - (weights @ exact)[:, None]
    deviations = off / np.sqrt(np.einsum('kk...->k...', found.angle_covariance))[:, 0]
    assert np.sqrt((deviations**2).mean(axis=1)).max() < 1.75


def test_between_rebounds_a_body_in_free_flight_is_as_a_parabola() -> None:
    """Two or three rebounds in a window; without them, ω has an error of 0.023, and α of 9."""
    rng = np.random.default_rng(0)
    noise, time = 1e-4, stamps(800)
    since = (time * 1e-9 + 0.0013) % 0.23
    gravity = -6.0 / 0.23
    exact = 3.0 * since + gravity / 2 * since**2
    angle, x, y = noise * rng.normal(size=(3, len(time), 1))
    angle += exact[:, None]
    now = np.flatnonzero((since > 0.015) & (since < 0.215))
    now = now[(now > 120) & (now < 760)]
    found = derive(time, angle, x + 1j * y, noise, now, order=3, count=101, ahead=20)
    deviation = np.sqrt(np.einsum('kktb->ktb', found.angle_covariance))[:, :, 0]
    due = np.array((3.0 + gravity * since[now], np.full(len(now), gravity), np.zeros(len(now))))
    off = found.angle[1:, :, 0] - due
    below(np.sqrt((off[:2] ** 2).mean(axis=1)), (0.01, 4.0))
    assert (np.abs(off) < 4 * deviation[1:]).all()


def test_flights_of_four_samples_between_rebounds_are_parabolas() -> None:
    """As a hammer at 60 Hz; without short segments α is off by 74, and 46% are within 2 sigma."""
    noise, time, speed, begin = 1e-4, stamps(900, 16_666_667), 3.2, -0.1
    since, lifted = np.zeros(900), np.zeros(900)
    while begin < 15.0:
        since, lifted = (
            np.where(time * 1e-9 >= begin, one, old)
            for one, old in ((time * 1e-9 - begin, since), (speed, lifted))
        )
        begin, speed = begin + speed / 15, speed * 0.72 if speed > 1.1 else 3.2
    due = np.array((lifted - 30 * since, np.full(900, -30.0)))
    rng = np.random.default_rng(5)
    turned, x, y = noise * rng.normal(size=(3, 900, 1))
    angle = turned + (lifted * since - 15 * since**2)[:, None]
    now = np.arange(40, 880)
    found = derive(time, angle, x + 1j * y, noise, now, order=3, count=31, ahead=6)
    off = np.abs(found.angle[1:3, :, 0] - due[:, now])
    deviation = np.sqrt(np.einsum('kktb->ktb', found.angle_covariance))[1:3, :, 0]
    below(np.sqrt((off**2).mean(axis=1)), (0.3, 2.0))
    assert (off < 2 * deviation).mean(axis=1).min() > 0.93


def test_four_rebounds_in_a_window_leave_parabolas() -> None:
    """As a hammer at 200 Hz: a short process explains them, so that no single step stands out."""
    noise, time = 5e-5, stamps(800)
    seconds, begin = time * 1e-9, 0.0
    angle, rate = np.zeros((2, 800))
    for speed in np.tile((4.0, 2.2, 1.2, 0.66), 8):
        since = seconds - begin
        inside = (since >= 0) & (since < speed / 15)
        angle[inside] = (speed * since - 15 * since**2)[inside]
        rate[inside] = (speed - 30 * since)[inside]
        begin += speed / 15
    turned, x, y = noise * np.random.default_rng(6).normal(size=(3, 800, 1))
    now = np.arange(120, 760, 4)
    found = derive(
        time, turned + angle[:, None], x + 1j * y, noise, now, order=3, count=101, ahead=20
    )
    below(np.median(np.abs(found.angle[1, :, 0] - rate[now])), 0.002)
    below(np.sqrt(np.mean((found.angle[1, :, 0] - rate[now]) ** 2)), 0.15)


def test_two_samples_after_its_rate_jumps_a_body_turns_steadily() -> None:
    """At the newest sample; as a step of acceleration ω has an error of 0.5, α of 41."""
    noise, count = 5e-5, 900
    rng = np.random.default_rng(3)
    cycle, since = np.divmod(np.arange(count) - 0.47, 30)
    rate = np.where(cycle % 2, 9.0, 4.0)
    turned = (6.5 * 30 * cycle + np.where(cycle % 2, -75, 0) + rate * since) / 60
    angle, x, y = noise * rng.normal(size=(3, count, 1))
    z = x + 1j * y + 1.5 * np.exp(1j * turned)[:, None]
    now = np.arange(62, count, 30)
    time = stamps(count, 16_666_667)
    found = derive(time, angle + turned[:, None], z, noise, now, order=3, count=31, ahead=0)
    off = found.angle[1:, :, 0] - np.array((rate[now], 0 * now, 0 * now))
    below(np.sqrt((off**2).mean(axis=1)), (0.02, 1.0, 1.0))


# --- stamps, gaps, and what is missing ----------------------------------------------------------


@pytest.mark.parametrize('jitter', [1e-3, 0.02, 0.3])
@pytest.mark.parametrize('noise', [1e-5, 1e-3])
def test_uneven_samples_tell_as_much_as_even_ones(noise: float, jitter: float) -> None:
    rng = np.random.default_rng(10)
    even = stamps(COUNT)
    square = np.zeros((2, 4))
    for _ in range(4):
        late = np.rint(even + jitter * STEP * rng.uniform(-1, 1, COUNT)).astype(np.int64)
        late[-1 - AHEAD] = even[-1 - AHEAD]
        for k, time in enumerate((even, late)):
            exact = smooth(time, 200)
            found = derive(time, *noisy(exact, noise), noise, order=3)
            off = found.angle[:, 0] - exact[0][:4, -1 - AHEAD]
            square[k] += (off**2).mean(axis=1)
    below(np.sqrt(square[1]), np.array([1.05, 1.05, 1.05, 1.08]) * np.sqrt(square[0]))


@pytest.mark.parametrize('noise', [1e-5, 1e-3])
@pytest.mark.parametrize('gap', [slice(50, 60), slice(20, 22), slice(84, 90)])
def test_a_gap_costs_no_more_than_its_samples(gap: slice, noise: float) -> None:
    """Of what a polynomial loses by it that is as good as ours without."""
    time = stamps(COUNT)
    exact = smooth(time, 400)
    angle, position = noisy(exact, noise)
    kept = np.delete(np.arange(COUNT), np.arange(COUNT)[gap])
    now = int(np.flatnonzero(kept == COUNT - 1 - AHEAD)[0])
    frames = Windows(np.array([now]), np.array([0]), np.array([len(kept) - 1]))
    ones = np.ones((len(kept), 400))
    found = derive_poses(
        Poses(time[kept], angle[kept], 0 * ones, position[kept], ones, ones),
        frames,
        np.zeros((1, 400), int),
        np.full((1, 400), noise),
        0.5,
        3,
    )
    whole = derive(time, angle, position, noise, order=3)
    off, before = (
        np.sqrt(((one.angle[:, 0] - exact[0][:4, -1 - AHEAD]) ** 2).mean(axis=1))
        for one in (found, whole)
    )
    t = (time - time[-1 - AHEAD]) * 1e-9
    gain = [
        np.array([np.linalg.norm(derivative_weights(times, degree, 3), axis=1)
                  for degree in range(5, 9)])
        for times in (t[kept], t)
    ]  # fmt: skip
    below(off, 1.2 * before * (gain[0] / gain[1]).max(axis=0))


@pytest.mark.parametrize('seen', [20, 30, 50, 70, 90])
@pytest.mark.parametrize('ahead', [0, 10])
@pytest.mark.parametrize('noise', [1e-6, 1e-3])
def test_a_window_that_is_not_full_yet_is_as_good_as_its_samples(
    noise: float, ahead: int, seen: int
) -> None:
    """The same as if it were to be no longer, or but little worse."""
    time = stamps(seen)
    exact = smooth(time, 400)
    measured = noisy(exact, noise)
    error = []
    for count in (seen, COUNT):
        found = derive(time, *measured, noise, order=3, count=count, ahead=ahead)
        off = found.angle[:, 0] - exact[0][:4, -1 - ahead]
        error.append(np.sqrt((off**2).mean(axis=1)))
    below(error[1][1:], 1.6 * error[0][1:])


def test_frames_a_nanosecond_apart_take_no_more_room_than_others() -> None:
    """Of a driver that hands over what it kept, at once, and stamps it then."""
    places = np.arange(COUNT // 4) * 4 * STEP
    time = (places[:, None] + np.arange(4)).ravel()
    exact = smooth(time, 4)
    tracemalloc.start()
    found = derive(time, *noisy(exact, 1e-3), 1e-3, ahead=0, window=(COUNT - 1) * STEP * 1e-9)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6
    deviation = np.sqrt(found.angle_covariance[1, 1, 0])
    assert (np.abs(found.angle[1, 0] - exact[0][1, -1]) < 5 * deviation).all()


def test_a_body_unseen_is_as_good_as_left_out_of_the_frames() -> None:
    time = stamps(COUNT, kind='jittered')
    exact = smooth(time, 4)
    angle, position = noisy(exact, 1e-3)
    rng = np.random.default_rng(4)
    keep = rng.random(COUNT) < 0.85
    keep[[0, -1, -1 - AHEAD]] = True
    information = np.repeat(keep[:, None], 4, axis=1).astype(float)
    angle[~keep] = position[~keep] = np.nan
    found = derive(time, angle, position, 1e-3, information=information)
    junk = np.where(keep[:, None], angle, 7e5), np.where(keep[:, None], position, 7e5j)
    same(derive(time, *junk, 1e-3, information=information), found)
    now = int(keep[: -1 - AHEAD].sum())
    ones = np.ones((int(keep.sum()), 4))
    without = derive_poses(
        Poses(time[keep], angle[keep], 0 * ones, position[keep], ones, ones),
        Windows(np.array([now]), np.array([0]), np.array([len(ones) - 1])),
        np.zeros((1, 4), int),
        np.full((1, 4), 1e-3),
        0.5,
        4,
    )
    deviation = np.sqrt(np.einsum('kk...->k...', without.angle_covariance))
    assert (np.abs(found.angle - without.angle) < 0.3 * deviation).all()


@pytest.mark.parametrize('kind', ['even', 'jittered'])
def test_frames_left_out_are_as_if_they_were_missing(kind: str) -> None:
    time = stamps(COUNT, kind=kind)
    angle, position = noisy(smooth(time, 4), 1e-3)
    information = np.ones(angle.shape)
    information[-5:, 1] = information[-2:, 2] = 0
    missing = derive(time, angle, position, 1e-3, information=information)
    same(derive(time, angle, position, 1e-3, left_out=np.array([[0, 5, 2, 0]])), missing)


def test_each_body_has_missing_samples_of_its_own() -> None:
    time = stamps(COUNT)
    angle, position = noisy(smooth(time, 4), 1e-3)
    information = np.random.default_rng(5).choice((0.0, 0.3, 1.0), (COUNT, 4), p=(0.1, 0.2, 0.7))
    information[-1 - AHEAD] = 1
    angle[information == 0] = np.nan
    together = derive(time, angle, position, 1e-3, information=information)
    for b in range(4):
        one = slice(b, b + 1)
        alone = derive(time, angle[:, one], position[:, one], 1e-3, information=information[:, one])
        same(Derivatives(*(field[..., one] for field in together)), alone, 1e-8)


@pytest.mark.parametrize('kind', ['even', 'jittered', 'gappy'])
def test_information_is_in_units_of_the_noise(kind: str) -> None:
    time = stamps(COUNT, kind=kind)
    measured = noisy(smooth(time, 4), 1e-3)
    fours = np.full(measured[0].shape, 4.0)
    same(derive(time, *measured, 2e-3, information=fours), derive(time, *measured, 1e-3), 1e-8)


def test_a_better_sample_never_makes_what_is_stated_worse() -> None:
    time = stamps(COUNT)
    measured = noisy(smooth(time, 20), 1e-3)
    before = np.full(20, np.inf)
    for share in (0.0, 0.25, 0.5, 0.75):
        information = np.ones((COUNT, 20))
        information[-1 - AHEAD - 2 : -1 - AHEAD + 3] = share
        information[-1 - AHEAD] = 0.75
        found = derive(time, *measured, 1e-3, information=information)
        variance = found.angle_covariance[0, 0, 0]
        assert np.median(variance / before) < 1
        before = variance


@pytest.mark.parametrize('count', range(1, 9))
def test_too_few_samples_tell_nothing(count: int) -> None:
    time = stamps(COUNT)
    angle, position = noisy(smooth(time, 2), 1e-3)
    information = np.ones((COUNT, 2))
    information[: COUNT - 1 - AHEAD - count // 2, 1] = 0
    information[COUNT - 1 - AHEAD - count // 2 + count :, 1] = 0
    found = derive(time, angle, position, 1e-3, information=information)
    assert np.isfinite(found.angle[:, 0, 0]).all()
    for array in (found.angle[:, 0, 1], found.position[:, 0, 1], found.span[0, 1]):
        assert np.isfinite(array).all() == (count >= FEWEST_SAMPLES)
        assert np.isnan(array).any() == (count < FEWEST_SAMPLES)


def test_fewest_samples_hold_every_order() -> None:
    time = stamps(FEWEST_SAMPLES)
    found = derive(time, *noisy(smooth(time, 4), 1e-3), 1e-3, ahead=0)
    for array in found:
        assert np.isfinite(array).all()


@pytest.mark.parametrize('steps', [(1, 5_000_000), (5_000_000, 1), (1, 1_000)])
def test_a_few_samples_far_from_even_do_no_harm(steps: tuple[int, int]) -> None:
    time = 10**9 + np.cumsum([0, *steps * 4])
    straight = (1e-9 * (time - time[-1]))[:, None] + 2.0
    found = derive(time, straight, straight + 0j, 1e-12, ahead=0, count=9, window=0.5)
    known = np.isfinite(found.angle)
    assert known.all() or not known.any()
    if known.all():
        assert found.angle[0, 0, 0] == pytest.approx(2.0, abs=1e-6)


# --- what must not matter -----------------------------------------------------------------------


@pytest.mark.parametrize('kind', ['even', 'jittered'])
def test_what_is_found_does_not_depend_on_the_orders_asked_for(kind: str) -> None:
    time = stamps(COUNT, kind=kind)
    measured = noisy(smooth(time, 4), 1e-3)
    full = derive(time, *measured, 1e-3)
    for order in (1, 2, 3):
        rows = slice(order + 1)
        part = Derivatives(
            full.position[rows],
            full.angle[rows],
            full.position_covariance[rows, rows],
            full.angle_covariance[rows, rows],
            *full[4:],
        )
        same(derive(time, *measured, 1e-3, order=order), part)


@pytest.mark.parametrize(
    ('kind', 'bodies'), [('even', 1), ('jittered', 1), ('gappy', 3), ('jittered', 70)]
)
def test_an_instant_alone_is_what_it_is_among_others(kind: str, bodies: int) -> None:
    time = stamps(220, kind=kind)
    measured = noisy(smooth(time, bodies), 1e-3)
    now = np.arange(20, len(time) - AHEAD)
    together = derive(time, *measured, 1e-3, now)
    for k in (0, 1, 30, 90, 91, len(now) - 1):
        alone = derive(time, *measured, 1e-3, now[k : k + 1])
        at = [field[..., k : k + 1, :] for field in together]
        same(alone, Derivatives(*at), 1e-8)


@pytest.mark.parametrize('other', ['a body hidden', 'a gap', 'a start'])
def test_an_instant_is_the_same_beside_others_that_have_gaps(other: str) -> None:
    """Also where samples are not quite as good as each other."""
    time = stamps(260)
    angle, position = noisy(smooth(time, 2), 1e-3)
    information = 1 + 0.1 * np.sin(np.arange(260.0))[:, None] * np.ones(2)
    now = np.arange(110, 240)
    if other == 'a body hidden':
        information[-10:, 0] = 0
    elif other == 'a gap':
        kept = np.delete(np.arange(260), range(245, 249))
        time, angle, position = time[kept], angle[kept], position[kept]
        information, now = information[kept], now[now < 256 - AHEAD]
    else:
        now = np.arange(30, 240)
    together = derive(time, angle, position, 1e-3, now, information=information, window=0.5)
    for k in (0, 10, 60, 90):
        k += len(now) - 130 if other == 'a start' else 0
        alone = derive(
            time, angle, position, 1e-3, now[k : k + 1], information=information, window=0.5
        )
        same(alone, Derivatives(*(field[..., k : k + 1, :] for field in together)), 1e-8)


@given(
    turn=st.floats(-4, 4),
    scale=st.floats(-3, 3),
    shift=st.complex_numbers(max_magnitude=1e3),
    turned=st.floats(-100, 100),
    slower=st.sampled_from((1, 10, 1000)),
    kind=st.sampled_from(('even', 'jittered', 'gappy')),
)
def test_what_is_turned_moved_scaled_and_slowed_has_derivatives_that_are(
    turn: float, scale: float, shift: complex, turned: float, slower: int, kind: str
) -> None:
    time = stamps(COUNT, kind=kind)
    angle, position = noisy(smooth(time, 3), 1e-3)
    plain = derive(time, angle, position, 1e-3)
    factor = 10**scale * np.exp(1j * turn)
    # Together: where the one steps the other does.
    found = derive(
        slower * time, 10**scale * angle + turned, factor * position + shift, 1e-3 * 10**scale
    )
    per = (float(slower) ** ORDERS)[:, None, None]
    both = per[:, None] * per
    back = Derivatives(
        (found.position - shift * (ORDERS == 0)[:, None, None]) / factor * per,
        (found.angle - turned * (ORDERS == 0)[:, None, None]) / 10**scale * per,
        found.position_covariance / 100**scale * both,
        found.angle_covariance / 100**scale * both,
        found.span / slower,
        found.parameters,
        found.reference / factor * np.exp(1j * turned),
    )
    same(back, plain, 1e-6)


def test_a_body_that_turns_there_and_back_between_two_frames_has_no_hub() -> None:
    """As a rod at half the frame rate: some point is at one place in any two poses."""
    side = (-1.0) ** np.arange(COUNT)[:, None]
    errors = 1e-4 * np.random.default_rng(6).normal(size=(3, COUNT, 20))
    position = (0.3 + 0.2j) * side + errors[1] + 1j * errors[2]
    assert not derive(stamps(COUNT), 0.2 * side + errors[0], position, 1e-4).reference.any()


def derived_without_events(
    window: Window, samples: np.ndarray, weight: np.ndarray
) -> _evidence.Found:
    """The derivatives of a signal (n, 3) by the reference, as processes alone have them."""
    seen = seen_of(weight[..., None], samples[..., None])
    modes, stencils = stacked.modes_of(*window.models), stacked.stencils_of(*window)
    found = _evidence.derive(modes, stencils, samples[..., None], *seen)
    return _evidence.Found(*(one[..., 0] for one in found))


def test_more_samples_than_a_window_holds_tell_as_much_in_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A second at 500 Hz, and the same where none are averaged."""
    count, ahead, noise = 500, 100, 1e-3
    time = stamps(count, 2_000_000)
    exact = smooth(time, 100)
    measured = noisy(exact, noise)

    def found() -> tuple[np.ndarray, np.ndarray]:
        one = derive(time, *measured, noise, order=3, count=count, ahead=ahead)
        off = one.angle[:, 0] - exact[0][:4, -1 - ahead]
        deviation = np.sqrt(np.einsum('kk...->k...', one.angle_covariance))[:, 0]
        return off, deviation

    blocks, stated = found()
    monkeypatch.setattr(_sizes, 'MOST', 1000)
    # The motion is smooth, and the reference takes long to look for steps.
    monkeypatch.setattr(_steps, '_derive_signal', derived_without_events)
    monkeypatch.setattr(sys.modules[__name__], 'derive_poses', derivatives_reference.derive_poses)
    single, expected = found()
    assert np.sqrt(((blocks - single) ** 2 / expected**2).mean(axis=1)).max() < 0.4
    below(np.sqrt((blocks**2).mean(axis=1)), 1.05 * np.sqrt((single**2).mean(axis=1)))
    np.testing.assert_allclose(np.median(stated / expected, axis=1), 1, atol=0.1)


@pytest.mark.parametrize('kind', ['even', 'missing'])
def test_blocks_are_those_samples_in_them_that_there_are(kind: str) -> None:
    count, ahead, noise = 500, 100, 1e-3
    time = stamps(count, 2_000_000)
    exact = smooth(time, 200)
    angle, position = noisy(exact, noise)
    information = np.ones(angle.shape)
    if kind == 'missing':
        information[np.random.default_rng(3).random(count) < 0.3] = 0
        information[-1 - ahead] = 1
    angle[information == 0] = np.nan
    one = derive(time, angle, position, noise, order=3, count=count, ahead=ahead,
                 information=information)  # fmt: skip
    off = of_all(one, exact, [count - 1 - ahead])
    spread = np.sqrt((off**2).mean(axis=(2, 3)))
    assert (spread[1:] < 1.2).all()
    assert (spread[1:] > 0.6).all()


@pytest.mark.parametrize('kind', ['even', 'jittered', 'gappy'])
@pytest.mark.parametrize('noise', [1e-5, 1e-3, 0.1])
def test_no_combination_of_derivatives_has_a_variance_below_zero(kind: str, noise: float) -> None:
    time = stamps(COUNT, kind=kind)
    information = np.ones((len(time), 8))
    information[30:33, :4] = 0.0
    information[60, 2:6] = 0.2
    found = derive(time, *noisy(smooth(time, 8), noise), noise, information=information)
    for matrix in (found.angle_covariance, found.position_covariance):
        one = np.moveaxis(matrix, (0, 1), (-2, -1))
        np.testing.assert_allclose(one, one.swapaxes(-1, -2), rtol=1e-9)
        deviation = np.sqrt(np.einsum('...kk->...k', one))
        assert (deviation > 0).all()
        correlation = one / deviation[..., None] / deviation[..., None, :]
        assert np.linalg.eigvalsh(correlation).min() > 0


def test_poses_are_not_changed() -> None:
    time = stamps(COUNT, kind='jittered')
    angle, position = noisy(smooth(time, 3), 1e-3)
    given = angle.copy(), position.copy()
    first = derive(time, angle, position, 1e-3)
    kept = Derivatives(*(field.copy() for field in first))
    for field in first:
        field[...] = 7.0
    second = derive(time, angle, position, 1e-3)
    for one, other in zip(kept, second, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(angle, given[0])
    np.testing.assert_array_equal(position, given[1])


def test_tables_are_dropped_and_made_again_with_the_same_results(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = stamps(COUNT)
    angle, position = np.zeros((2, COUNT, 2)) + np.linspace(0, 1, COUNT)[:, None]
    expected = derive(time, angle, position, 1e-3)
    monkeypatch.setattr(_pose_derivatives, '_tables', {})
    monkeypatch.setattr(_pose_derivatives, '_MAX_TABLE_BYTES', 1)
    for _ in range(2):
        same(derive(time, angle, position, 1e-3), expected)
        assert len(_pose_derivatives._tables) == 1


def test_a_failure_to_make_a_table_is_raised_and_the_next_call_makes_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = stamps(COUNT)
    angle, position = np.zeros((2, COUNT, 2)) + np.linspace(0, 1, COUNT)[:, None]
    monkeypatch.setattr(_pose_derivatives, '_tables', {})
    with monkeypatch.context() as broken, pytest.raises(KeyboardInterrupt):
        broken.setattr(_pose_derivatives, 'cached_table', _interrupted)
        derive(time, angle, position, 1e-3)
    assert np.isfinite(derive(time, angle, position, 1e-3).angle).all()


def _interrupted(*_: object) -> None:
    raise KeyboardInterrupt
