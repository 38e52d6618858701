"""Markers that their tracker has smoothed: the noise that windows see, not what is left of it."""

import functools
from typing import Any

import numpy as np
import pytest

from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import FINDING, DiagnosticsMaker
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.planar import fit_pose
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.noise import correlated_noise, white_noise
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES
from kinpole_ros.tracking.tracker import Tracker

RATE = 200
SIGMA = 1e-4
WINDOW = 500_000_000
SHAPE = np.array([0.05 + 0.03j, -0.05 + 0.025j, -0.04 - 0.03j, 0.045 - 0.025j])


def white(seed: int, *shape: int) -> np.ndarray:
    return np.asarray(np.random.default_rng(seed).normal(size=(*shape, 2)) @ (1, 1j))


def low_passed(values: np.ndarray, cutoff: float) -> np.ndarray:
    """As motion capture does it: Butterworth, fourth order, forth and back."""
    share = 1 / (1 + (np.fft.fftfreq(len(values), 1 / RATE) / cutoff) ** 8)
    return np.asarray(np.fft.ifft(np.fft.fft(values, axis=0).T * share).T)


def averaged(values: np.ndarray, samples: int) -> np.ndarray:
    """A running mean, as a driver does it that smooths live."""
    total = np.cumsum(np.concatenate((np.zeros_like(values[:1]), values)), axis=0)
    mean = (total[samples:] - total[:-samples]) / samples
    return np.concatenate((values[: samples - 1], mean))


# How it is smoothed, and the share of errors that 95% intervals cover at least.
FILTERS = {
    'at 40 Hz': (lambda values: low_passed(values, 40), 0.85),
    'at 20 Hz': (lambda values: low_passed(values, 20), 0.85),
    'at 10 Hz': (lambda values: low_passed(values, 10), 0.65),
    'over 5 frames': (lambda values: averaged(values, 5), 0.85),
}


def tracked(noise: np.ndarray, given: float = 0.0) -> tuple[Tracker, Estimate, Any]:
    """The coupler seen with noise, at 200 Hz: what follows it, what it says, and the truth."""
    times = np.arange(len(noise)) / RATE
    position, angle = load_scene('four_bar').motion(times)['coupler']
    flat = position[0][:, None] + np.exp(1j * angle[0])[:, None] * SHAPE + SIGMA * noise
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    stamps = 10**18 + np.round(times * 1e9).astype(np.int64)
    tracker = Tracker(Settings(bodies={'coupler': tuple('abcd')}, window=0.5, lag=0.1, noise=given))
    (estimate,) = tracker.add(MarkerFrames(stamps, 'world', tuple('abcd'), points), 3)
    return tracker, estimate, angle[:, np.searchsorted(stamps, estimate.stamp)]


def errors(noise: np.ndarray) -> np.ndarray:
    """Errors of ω, α and jerk (3, T) over 30 s, and in deviations (3, T)."""
    _, estimate, angle = tracked(noise)
    off = estimate.angle[1:, :, 0] - angle[1:4]
    spread = np.sqrt(estimate.angle_covariance[[1, 2, 3], [1, 2, 3], :, 0])
    settled = estimate.stamp > estimate.stamp[0] + 4_000_000_000
    return np.stack((off, off / spread))[:, :, settled]


@functools.cache
def raw_errors() -> np.ndarray:
    """Root mean squares (3,) of the errors of ω, α and jerk where nothing is smoothed."""
    return np.asarray(np.sqrt(np.mean(errors(white(3, 6000, 4))[0] ** 2, axis=-1)))


@pytest.mark.parametrize('how', FILTERS)
def test_smoothing_spoils_no_figures_and_they_are_hardly_stated_too_sure(how: str) -> None:
    smoothed, covered = FILTERS[how]
    noise = white(3, 6000, 4)
    raw = raw_errors()
    off, deviations = errors(smoothed(noise))
    # Judged by what is new from frame to frame they would be many times as large.
    assert np.all(np.sqrt(np.mean(off**2, axis=-1)) < 1.1 * raw)
    assert np.all((np.abs(deviations) < 1.96).mean(axis=-1) > covered)


@pytest.mark.parametrize(
    ('cutoff', 'given', 'warned'),
    [(None, 0, False), (20, 0, False), (10, 0, True), (6, 0, True), (6, 3 * SIGMA, False)],
)
def test_diagnostics_tell_where_noise_lasts_too_long_to_be_measured(
    cutoff: float | None, given: float, warned: bool
) -> None:
    noise = white(9, 2000, 4)
    noise = noise if cutoff is None else low_passed(noise, cutoff)
    tracker, estimate, _ = tracked(noise, given)
    status = DiagnosticsMaker('kinpole').make(10**18, tracker, estimate, 1.0, {}).status[1]
    codes = [pair.key for pair in status.values if pair.key.startswith(FINDING)]
    assert codes == [f'{FINDING}smoothed'] * warned
    assert (status.level == DiagnosticStatus.WARN) == warned


def residuals(noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What rigid fits of one body leave of noise (T, n), and how free that is."""
    count = noise.shape[1]
    seen = SHAPE[:count] + SIGMA * noise[:, None]
    fit = fit_pose(seen, SHAPE[None, :count], np.ones(seen.shape))
    return fit.residual, fit.freedom


def stamped(frames: int, rate: float = RATE) -> np.ndarray:
    return np.asarray(np.round(np.arange(frames) * 1e9 / rate)).astype(np.int64)


def levels(
    noise: np.ndarray,
    gaps: np.ndarray | None = None,
    rate: float = RATE,
    window: int = WINDOW,
) -> tuple[float, float, bool]:
    """Noise of single frames over SIGMA, as it lasts, which may be the same, and if for longer."""
    gaps = np.zeros(len(noise), bool) if gaps is None else gaps
    rows = slice(-MEMORY_FRAMES - 2, None)
    fits = *(part[rows] for part in residuals(noise)), ~gaps[rows]
    level, _ = white_noise(*fits)
    lasting, longer = correlated_noise(*fits, window * 1e-9 * rate, level)
    return float(level[0]) / SIGMA, float(lasting[0]) / SIGMA, bool(longer[0])


@pytest.mark.parametrize('frames', [20, 26, 32, 50, 200, 6000])
@pytest.mark.parametrize('markers', [2, 4])
@pytest.mark.parametrize('hidden', [0.0, 0.05, 0.3])
def test_white_noise_never_lasts(frames: int, markers: int, hidden: float) -> None:
    for seed in range(200 if frames < 50 else 30):
        noise = white(seed, frames, markers)
        noise[np.random.default_rng(seed).random(noise.shape) < hidden] = np.nan
        one, lasting, longer = levels(noise)
        assert lasting == one or np.isnan(one)
        assert not longer


def test_white_noise_that_falls_does_not_last() -> None:
    for frames in range(1010, 2000, 30):
        noise = white(frames, frames, 4)
        noise[:1000] *= 10
        one, lasting, _ = levels(noise)
        assert lasting == one


@pytest.mark.parametrize(('rate', 'turns'), [(200, 2.0), (2000, 5.0)])
def test_what_a_lens_does_is_no_noise_that_lasts(rate: float, turns: float) -> None:
    """Three deviations, to and fro so often a second."""
    phase = 2 * np.pi * turns * np.arange(6000)[:, None] / rate + np.arange(4)
    one, lasting, _ = levels(white(0, 6000, 4) + 3 * np.sin(phase), rate=rate)
    assert lasting == one == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(('markers', 'window'), [(4, WINDOW), (2, 2 * WINDOW)])
def test_noise_that_lasts_counts_for_as_much_as_it_does_in_a_window(
    markers: int, window: int
) -> None:
    """As the error of means of many frames: for a running mean of 4 the same as without."""
    one, lasting, _ = levels(averaged(white(1, 20_000, markers), 4), window=window)
    assert one == pytest.approx(24**-0.5, abs=0.03)
    assert lasting == pytest.approx(1, abs=0.2)


def test_blocks_hold_no_frames_from_before_and_after_a_gap() -> None:
    """The body looks another one after each, as if marked anew."""
    parts = np.arange(6000) // 28
    steps = 20 * white(4, 215, 4)[parts]
    gaps = np.concatenate(([False], np.diff(parts) > 0))
    noise = white(5, 6000, 4) + steps
    one, lasting, _ = levels(noise, gaps)
    assert lasting == one == pytest.approx(1, abs=0.05)
    assert levels(noise)[1] > 3
