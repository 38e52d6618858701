"""Bodies that are not rigid: their figures are within their deviations, and the cause is named."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros import planar
from kinpole_ros.messages import DiagnosticsMaker
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.deformation import TISSUE, ResultWindow, deformation_covariance
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

# Measured walks stay where they are: see the README beside them for what they are.
WALK = Path(__file__).parents[3] / 'shared' / 'data' / 'gait' / 'walk1.trc'
RATE = 200  # Hz
ORDERS = 4
KITE = np.array([0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j])
NOISE = 2e-4  # m
START = 10**18
# 95% of a chi-square of one and of two degrees of freedom are below.
ONE, TWO = 3.841, 5.991


def swung(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A general motion: position, complex, m, and angle, rad, with derivatives (ORDERS, T)."""

    def wave(rate: float, phase: float) -> np.ndarray:
        turns = 2j * np.pi * rate
        return np.stack([turns**k * np.exp(turns * t + 1j * phase) for k in range(ORDERS)])

    angle = wave(0.8, 0.0).imag + 0.3 * wave(1.9, 0.5).imag
    x = 0.15 * wave(0.8, 1.1).imag + 0.03 * wave(1.9, 2.0).imag
    return x + 1j * (0.1 * wave(0.8, -0.4).imag + 0.05 * wave(1.9, 0.9).imag), angle


def wobble(t: np.ndarray, shape: Sequence[int], tau: float, rng: np.random.Generator) -> np.ndarray:
    """Complex processes (T, *shape) of unit variance per axis, correlated over tau, s."""
    step = tau / np.sqrt(2) * RATE
    reach = np.arange(-int(5 * step) - 1, int(5 * step) + 2)
    weights = np.exp(-((reach / step) ** 2) / 2)
    weights /= np.sqrt((weights**2).sum())
    white = rng.normal(size=(2, *shape, len(t) + len(reach) - 1)) * np.array([1, 1j]).reshape(
        2, *(1 for _ in shape), 1
    )
    smooth = np.apply_along_axis(np.convolve, -1, white.sum(axis=0), weights, 'valid')
    return np.moveaxis(smooth, -1, 0)


def markers(t: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Markers (T, count) of a rigid body that is `swung`, complex, m, with white noise."""
    position, angle = swung(t)
    points = position[0][:, None] + np.exp(1j * angle[0])[:, None] * KITE[:count]
    noise = rng.normal(size=(2, *points.shape))
    return np.asarray(points + NOISE * (noise[0] + 1j * noise[1]))


def frames_of(points: np.ndarray, rate: float = RATE) -> MarkerFrames:
    flat = np.stack((points.real, points.imag, 0 * points.real), axis=-1)
    stamps = START + np.rint(np.arange(len(points)) / rate * 1e9).astype(np.int64)
    return MarkerFrames(stamps, 'world', tuple(str(k) for k in range(points.shape[1])), flat)


def tracked(
    frames: MarkerFrames, block: int | None = None, **values: object
) -> tuple[Tracker, list[Estimate]]:
    tracker = Tracker(settings_from({'window': 0.3, 'lag': 0.1} | values))
    found = []
    for k in range(0, len(frames.stamps), block or len(frames.stamps)):
        part = slice(k, k + (block or len(frames.stamps)))
        some = frames._replace(stamps=frames.stamps[part], points=frames.points[part])
        found += tracker.add(some, 3)
    return tracker, found


def squares(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Mahalanobis squares of complex errors (...) by covariances (..., 2, 2)."""
    xy = np.stack((off.real, off.imag), axis=-1)
    return np.asarray(np.einsum('...i,...ij,...j', xy, np.linalg.inv(covariance), xy))


def test_wobbling_markers_are_within_their_deviations() -> None:
    t = np.arange(4 * RATE) / RATE
    position, angle = swung(t)
    truth = planar.pole(1, position, angle).value
    rates, poles = [], []
    for seed, (count, rms, tau) in enumerate(
        [(4, 5e-3, 0.2), (4, 2e-3, 0.05), (3, 5e-3, 0.2), (2, 3e-3, 0.1), (4, 6e-3, 0.5)]
    ):
        rng = np.random.default_rng((seed, 7))
        points = markers(t, count, rng) + rms * wobble(t, (count,), tau, rng)
        tracker, (found,) = tracked(frames_of(points))
        assert tracker.causes() == [TISSUE]
        k = np.searchsorted(t, (found.stamp - START) * 1e-9 - 1e-6)
        later = k > RATE
        rate, pole = found.rate(1), found.pole(1)
        off = (rate.value[:, 0] - angle[1][k]) ** 2 / rate.variance[:, 0]
        rates.append((off < ONE)[later].mean())
        near = pole.determined[:, 0] & later
        assert near.mean() > 0.4
        off = squares((pole.value[:, 0] - truth[k])[near], pole.covariance[near, 0])
        poles.append((off < TWO).mean())
    assert np.mean(rates) > 0.9
    assert np.mean(poles) > 0.9
    assert min(rates + poles) > 0.75


@pytest.mark.parametrize('hidden', [0.0, 0.05, 0.5])
@pytest.mark.parametrize('count', [2, 4])
def test_white_noise_is_never_taken_for_a_deformation(count: int, hidden: float) -> None:
    rng = np.random.default_rng(count)
    t = np.arange(3 * RATE) / RATE
    points = markers(t, count, rng)
    points[rng.random(points.shape) < hidden] = complex(np.nan, np.nan)
    tracker = Tracker(settings_from({'window': 0.3, 'lag': 0.1}))
    for k in range(0, len(t), 40):
        part = frames_of(points)
        some = part._replace(stamps=part.stamps[k : k + 40], points=part.points[k : k + 40])
        tracker.add(some, None)
        assert tracker.causes() == ['']
        assert tracker.rigidity_residual() == 0.0


def test_wobbling_markers_come_out_the_same_frame_by_frame() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0.6 * RATE) / RATE
    points = markers(t, 4, rng) + 3e-3 * wobble(t, (4,), 0.1, rng)
    whole = frames_of(points)
    for hidden in (False, True):
        if hidden:
            whole.points[rng.random(points.shape) < 0.05] = np.nan
        _, (found,) = tracked(whole)
        tracker = Tracker(settings_from({'window': 0.3, 'lag': 0.1}))
        each = []
        for k in range(len(t)):
            one = whole._replace(stamps=whole.stamps[k : k + 1], points=whole.points[k : k + 1])
            each += tracker.add(one, 3)
        assert found.angle_covariance.shape[2] == len(each)
        for name in ('angle_covariance', 'position_covariance'):
            parts = np.concatenate([getattr(one, name) for one in each], axis=2)
            np.testing.assert_allclose(parts, getattr(found, name), rtol=1e-8)
        for order in (1, 3):
            covariance = np.concatenate([one.pole(order).covariance for one in each])
            np.testing.assert_allclose(covariance, found.pole(order).covariance, rtol=1e-6)


@given(
    st.floats(0.5, 2.0), st.floats(1e-4, 1e-2), st.integers(2, 5), st.floats(0.0, 0.05), st.data()
)
def test_slow_residuals_count_by_their_derivatives_less_the_noise(
    rate: float, size: float, degree: int, lag: float, data: st.DataObject
) -> None:
    count, step = 120, 5e-3
    t = np.arange(count) * step
    phase = data.draw(st.floats(0, 6))
    path = size * np.exp(1j * (2 * np.pi * rate * t + phase))
    # Of two markers one degree of freedom, and this residual has two.
    residual = np.stack((path, 0 * path), axis=-1)[:101]

    def found(noise: float) -> np.ndarray:
        now, oldest = 100 - round(lag / step), 40
        window = ResultWindow(now, oldest, step)
        return deformation_covariance(residual, window, 0.1, float(degree), noise, 1.0, 2)

    quiet = found(0.0)
    np.testing.assert_array_less(-1e-9 * np.trace(quiet), np.linalg.eigvalsh(quiet))
    expected = (2 * np.pi * rate * size) ** 2
    # What a variance of so few degrees of freedom is raised by is no more than that of one.
    assert 0.8 < quiet[1, 1] / expected < 12
    assert found(size)[1, 1] < quiet[1, 1]
    np.testing.assert_array_equal(found(1e3 * size), 0.0)


def spoiled(points: np.ndarray, cause: str, rng: np.random.Generator) -> np.ndarray:
    if cause == 'lens':
        return np.asarray(points * (1 - 0.07 * np.abs(points - 0.05) ** 2 / 0.3**2))
    if cause == 'slant':
        return np.asarray(points.real + 0.94j * points.imag)
    t = np.arange(len(points)) / RATE
    return np.asarray(points + 5e-3 * wobble(t, points.shape[1:], 0.2, rng))


@pytest.mark.parametrize('cause', ['lens', 'slant', 'tissue'])
def test_what_moves_markers_against_each_other_is_named(cause: str) -> None:
    rng = np.random.default_rng(2)
    t = np.arange(4 * RATE) / RATE
    frames = frames_of(spoiled(markers(t, 4, rng), cause, rng))
    tracker, (found,) = tracked(frames)
    assert tracker.causes() == [TISSUE]
    status = DiagnosticsMaker('kinpole').make(START, tracker, found, 1.0, {}).status[1]
    assert status.level == DiagnosticStatus.WARN
    assert 'soft tissue' in status.message
    assert 'fix: ' in status.message


def read_trc(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (T,), s, and markers (T, 3), m, by name, of a table in mm; NaN for empty cells."""
    lines = path.read_text().splitlines()
    names = [name for name in lines[3].split('\t')[2:] if name]
    width = 2 + 3 * len(names)
    cells = [(line.split('\t') + width * [''])[:width] for line in lines[5:] if line.strip()]
    table = np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in cells])
    points = 1e-3 * table[:, 2:].reshape(len(table), -1, 3)
    return table[:, 1], dict(zip(names, np.moveaxis(points, 1, 0), strict=True))


@pytest.mark.skipif(not WALK.exists(), reason=f'{WALK} is not there')
@pytest.mark.parametrize('side', ['R', 'L'])
def test_two_pairs_of_markers_of_one_shank_agree_on_how_the_knee_moves(side: str) -> None:
    """Skin moves on the bone, and a leg leaves the plane: both tell in what rigid fits leave."""
    t, seen = read_trc(WALK)
    bodies: Mapping[str, Sequence[str]] = {
        'thigh': ('GTR', 'Knee', 'Knee.Medial'),
        'one': ('TT', 'Ankle'),
        'other': ('HF', 'Ankle.Medial'),
    }
    values: dict[str, object] = {'bodies': list(bodies), 'lag': 0.15}
    values |= {f'{body}.markers': [f'{side}.{m}' for m in names] for body, names in bodies.items()}
    # The table rounds its times to ms.
    stamps = START + np.rint(np.arange(len(t)) * 1e9 / 150).astype(np.int64)
    frames = MarkerFrames(stamps, 'lab', tuple(seen), np.stack(list(seen.values()), axis=1))
    _, (found,) = tracked(frames, **values)
    # Pairs are thigh and one, thigh and other, one and other.
    rate, center = found.relative_rate, found.relative_icr
    swing = np.abs(rate.value[:, :2].mean(axis=1)) > 2.0
    assert swing.sum() > 100
    off, variance = np.diff(rate.value[swing, :2])[:, 0], rate.variance[swing, :2].sum(axis=1)
    agree = off**2 < ONE * variance
    both = swing & center.determined[:, :2].all(axis=1)
    apart = np.diff(center.value[both, :2])[:, 0]
    near = squares(apart, center.covariance[both, :2].sum(axis=1)) < TWO
    print(f'{side}: rate {agree.mean():.0%}, center {near.mean():.0%} of {both.sum()}')
    assert agree.mean() > 0.8
    assert near.mean() > 0.85
    assert both.sum() > 0.75 * swing.sum()
    # Not by deviations beyond all measure.
    assert np.median(np.sqrt(variance)) < 1.0
    assert np.median(np.sqrt(np.trace(center.covariance[both, 0], axis1=1, axis2=2))) < 0.05
