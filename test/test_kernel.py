"""The compiled kernel gives what numpy does."""

from typing import Any

import derivatives_reference as reference
import numpy as np
import pytest

from kinpole_ros.derivatives import _fast, _samples
from kinpole_ros.derivatives._fast import Found, Lacking
from kinpole_ros.derivatives._models import Modes, Stencils, modes_of, slopes_of, stencils_of
from kinpole_ros.derivatives._parts import derive_parts
from kinpole_ros.derivatives._samples import lacking_of

pytestmark = pytest.mark.filterwarnings('error')

COUNTS = (7, 8, 9, 20, 33, 64, 100, 127, 128)
# Numpy's own rounding: what a model leaves is the difference of squares that are as large.
LARGEST = 100.0


def models(
    count: int, block: int, orders: int, exact: bool, at: float = 0.3
) -> tuple[Modes, Stencils]:
    """Those of a window, and stencils at this part of half a window behind its middle."""
    stencils = stencils_of(count, at * (count - 1) / 2, block, orders, exact)
    return modes_of(count, block, exact), stencils


def signals(rng: np.random.Generator, count: int, bodies: int) -> np.ndarray:
    """Waves of any length, (n, 3, S), some much larger than their noise."""
    t = np.arange(count)[:, None, None]
    frequency = 10 ** rng.uniform(-2, 0, (3, bodies))
    wave = np.sin(t * frequency + rng.uniform(0, 6, (3, bodies)))
    large = 10 ** rng.uniform(-1, np.log10(LARGEST), (3, bodies))
    return np.asarray(large * wave + rng.normal(size=(count, 3, bodies)))


def missing(rng: np.random.Generator, count: int, bodies: int, most: int) -> np.ndarray:
    """Weights (n, 2, S) of which up to so many per signal are less than 1, as for angles or not."""
    weights = np.ones((count, 2, bodies))
    for k in range(bodies):
        cells = rng.choice(count, rng.integers(0, most + 1), replace=False)
        few = rng.uniform(0, 1, (len(cells), 2))
        weights[cells, :, k] = (np.zeros_like(few), few[:, :1], few)[rng.integers(3)]
    return weights


def same(found: Found, expected: Found, tolerance: float = 1e-9) -> None:
    deviation = np.sqrt(np.einsum('kkcs->kcs', expected.covariance))
    mean = np.abs(found.mean - expected.mean)
    covariance = np.abs(found.covariance - expected.covariance)
    freedom = np.abs(found.freedom - expected.freedom)
    assert (mean <= tolerance * deviation[:, [0, 1, 1]]).all()
    assert (covariance <= tolerance * deviation * deviation[:, None]).all()
    assert (freedom <= tolerance * expected.freedom).all()
    # Windows in two parts are compared by it.
    evidence = np.abs(found.evidence - expected.evidence)
    assert (evidence <= tolerance * (1 + np.abs(expected.evidence))).all()


@pytest.mark.parametrize('exact', [False, True])
@pytest.mark.parametrize('count', COUNTS)
def test_all_samples(count: int, exact: bool) -> None:
    rng = np.random.default_rng(count)
    for bodies, orders, block in ((1, 5, 1), (3, 4, 3), (16, 3, 1), (3, 2, 2)):
        window = models(count, block, orders, exact)
        samples = signals(rng, count, bodies)
        if exact:
            samples *= 1e5
        expected = reference.derive(*window, samples, float(count))
        same(_fast.derive(*window, samples, float(count)), expected)


@pytest.mark.parametrize('exact', [False, True])
@pytest.mark.parametrize('count', COUNTS)
def test_lacking_samples(count: int, exact: bool) -> None:
    rng = np.random.default_rng(count)
    for bodies, orders, block, most in ((1, 5, 1, 1), (3, 4, 2, 2), (16, 4, 1, 4), (3, 2, 1, 10)):
        window = models(count, block, orders, exact)
        weights = missing(rng, count, bodies, min(most, count // 3))
        lacking, samples = lacking_of(weights), signals(rng, count, bodies)
        seen = weights.sum(axis=0)
        expected = reference.derive(*window, samples, seen, lacking)
        same(_fast.derive(*window, samples, seen, lacking), expected, 1e-8)


@pytest.mark.parametrize('exact', [False, True])
@pytest.mark.parametrize('count', COUNTS)
def test_samples_that_are_moved(count: int, exact: bool) -> None:
    rng = np.random.default_rng(count)
    for bodies, block, most in ((1, 1, 0), (3, 2, 2), (16, 1, 4), (3, 1, 10)):
        modes, slopes = modes_of(count, block, exact), slopes_of(count, block, exact)
        given = signals(rng, count, bodies)
        samples = given + 0.1 * rng.normal(size=given.shape)
        weights = missing(rng, count, bodies, min(most, count // 3))
        off = rng.uniform(-0.5, 0.5, (count, bodies))
        arrays = given, samples, off, weights.sum(axis=0), lacking_of(weights)
        found, expected = (
            f(modes, slopes, *arrays, _samples._KNOWN) for f in (_fast.move, reference.move)
        )
        assert np.abs(found - expected).max() < 1e-9


def test_many_lacking_samples() -> None:
    rng = np.random.default_rng(0)
    window = models(60, 1, 3, False)
    for number in (32, 33):
        weights = np.ones((60, 2, 2))
        weights[rng.permutation(60)[:number]] = 0.0
        lacking, samples = lacking_of(weights), signals(rng, 60, 2)
        seen = weights.sum(axis=0)
        expected = reference.derive(*window, samples, seen, lacking)
        same(_fast.derive(*window, samples, seen, lacking), expected, 1e-8)
        off = rng.uniform(-0.5, 0.5, (60, 2))
        arrays = window[0], slopes_of(60), samples, samples, off, seen, lacking, _samples._KNOWN
        assert np.abs(_fast.move(*arrays) - reference.move(*arrays)).max() < 1e-8


def test_motion_as_large_as_there_is() -> None:
    """To what rounding of numpy leaves of it."""
    rng = np.random.default_rng(0)
    samples = signals(rng, 100, 3)
    for exact, large, tolerance in ((False, 1e4, 1e-2), (True, 1e10, 1e-6)):
        window = models(100, 1, 4, exact)
        wave = samples * large
        same(_fast.derive(*window, wave, 100.0), reference.derive(*window, wave, 100.0), tolerance)


def test_bodies_at_rest_and_signals_alone() -> None:
    rng = np.random.default_rng(0)
    window = models(50, 1, 4, False)
    samples = signals(rng, 50, 3)
    samples[..., 1] = 0.0
    found = _fast.derive(*window, samples, 50.0)
    same(found, reference.derive(*window, samples, 50.0))
    for k in range(3):
        alone = _fast.derive(*window, samples[..., k : k + 1], 50.0)
        for part, whole in zip(alone, found, strict=True):
            assert (part[..., 0] == whole[..., k]).all()


def test_a_part_of_few_samples_leaves_the_window_whole() -> None:
    """Six samples after a gap are too few for a motion of their own, and no model has a figure."""
    time = np.arange(101)[:, None, None]
    phase = np.array([0.0, 1.0, 2.0])[:, None]
    samples = 1e5 * np.sin(np.pi / 50 * time + phase)
    samples += np.random.default_rng(0).normal(size=samples.shape)
    weights = np.ones((101, 2, 1))
    weights[71:95] = 0.0
    window = _samples.Window(101, 49.0, 1, 2, exact=False, dense=False, parts=True)
    samples, _ = _samples.place(window, samples, weights, None)
    found = derive_parts(window, samples, weights)
    rate = 1e5 * np.pi / 50 * np.cos(np.pi / 50 * 99 + phase)
    assert np.isfinite(found.covariance).all()
    deviation = np.sqrt(found.covariance[1, 1])[[0, 1, 1]]
    assert (np.abs(found.mean[1] - rate) < 4 * deviation).all()


def test_what_is_not_a_number_stays_apart() -> None:
    window = models(50, 1, 4, False)
    samples = signals(np.random.default_rng(0), 50, 3)
    expected = _fast.derive(*window, samples, 50.0)
    samples[20, :, 1] = np.nan
    found = _fast.derive(*window, samples, 50.0)
    for part, whole in zip(found, expected, strict=True):
        assert np.isnan(part[..., 1]).all()
        assert (part[..., ::2] == whole[..., ::2]).all()


def test_arrays_that_do_not_fit() -> None:
    """Are refused: the kernel never reads beyond what it is given."""
    modes, stencils = models(50, 1, 4, False)
    samples = signals(np.random.default_rng(0), 50, 3)
    weight = np.zeros((1, 2, 3))
    cases: list[tuple[Any, ...]] = [
        (samples[1:], 50.0),
        (samples[:, :2], 50.0),
        (samples, np.full((2, 2), 50.0)),
        (samples, 50.0, Lacking(np.full((1, 3), 50), weight)),
        (samples, 50.0, Lacking(np.full((1, 3), -1), weight)),
        (samples, 50.0, Lacking(np.zeros((1, 3), int), weight[..., :2])),
    ]
    for case in cases:
        with pytest.raises(ValueError, match='do not fit'):
            _fast.derive(modes, stencils, *case)
    slopes, off = slopes_of(50), np.zeros((50, 3))
    with pytest.raises(ValueError, match='do not fit'):
        _fast.move(modes, slopes, samples, samples, off[1:], np.full((2, 3), 50.0), None, 1.0)
    other = stencils_of(60, 0.0, 1, 4)
    with pytest.raises(ValueError, match=r'do not fit|index|size'):
        _fast.derive(modes, other, samples, 50.0)
