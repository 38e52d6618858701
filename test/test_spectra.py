"""The spectrum of a body: what many windows show of a motion helps each of them."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from kinpole_ros.derivatives import (
    SPECTRUM_WINDOWS,
    Derivatives,
    Poses,
    Spectrum,
    Windows,
    _models,
    derive_poses,
    find_spectrum,
)
from kinpole_ros.derivatives._spectra import Lines
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking import update
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker, learn_recording

pytestmark = pytest.mark.filterwarnings('error')

WINDOW, ARM = 0.3, 0.3  # s, m
Angle = Callable[[np.ndarray], np.ndarray]


def sines(*parts: tuple[float, float, float], speed: float = 0.0) -> Angle:
    """Return an angle by time, with derivatives (4, N): sines (rad, Hz, phase) beside a speed."""

    def angle(time: np.ndarray) -> np.ndarray:
        found = np.stack((speed * time, speed + 0 * time, 0 * time, 0 * time))
        for size, hertz, phase in parts:
            speeds = (2 * np.pi * hertz) ** np.arange(4)[:, None]
            turned = 2 * np.pi * hertz * time + phase + np.pi / 2 * np.arange(4)[:, None]
            found += size * speeds * np.sin(turned)
        return found

    return angle


def rod(turns: float, ratio: float = 0.3) -> Angle:
    """Return the angle of the rod of a slider-crank at so many rev/s, by its harmonics."""
    crank = 2 * np.pi * np.arange(512) / 512
    sizes = np.fft.rfft(np.arcsin(-ratio * np.sin(crank)))[1:30] / 256
    harmonics = range(1, 30)
    return sines(
        *(
            (abs(c), k * turns, np.angle(c) + np.pi / 2)
            for k, c in zip(harmonics, sizes, strict=True)
        )
    )


class Record:
    """Poses of one body on an arm, with noise, rad, and their derivatives (4, N)."""

    def __init__(self, angle: Angle, rate: float, noise: float, frames: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        seconds = np.arange(frames) / rate
        self.rate, self.noise, self.truth = rate, noise, angle(seconds)
        self.time = np.round(seconds * 1e9).astype(np.int64)
        self.angle = self.truth[0] + noise * rng.normal(size=frames)
        off = rng.normal(size=frames) + 1j * rng.normal(size=frames)
        self.position = ARM * np.exp(1j * self.truth[0]) + ARM * noise * off

    def spectrum(self) -> Spectrum | None:
        noise = self.noise, ARM * self.noise
        return find_spectrum(self.time, self.angle, self.position, noise, WINDOW)

    def derive(self, spectrum: Spectrum | None, newest: np.ndarray, ahead: int) -> Derivatives:
        one = np.ones((len(self.time), 1))
        poses = Poses(self.time, self.angle[:, None], 0 * one, self.position[:, None], one, one)
        poses = poses._replace(position_information=one / ARM**2)
        length = round(WINDOW * self.rate)
        windows = Windows(newest - ahead, newest - length, newest)
        none = np.zeros((len(newest), 1), int)
        noise = np.full((len(newest), 1), self.noise)
        return derive_poses(poses, windows, none, noise, WINDOW, 3, [spectrum])

    def deviations(self, spectrum: Spectrum | None, lag: float) -> np.ndarray:
        """Errors (3, M) of ω, α and jerk over their standard deviations, in each second window."""
        newest, ahead = (
            np.arange(round(WINDOW * self.rate), len(self.time), 2),
            round(lag * self.rate),
        )
        found = self.derive(spectrum, newest, ahead)
        variance = found.angle_covariance[range(1, 4), range(1, 4), :, 0]
        return (found.angle[1:, :, 0] - self.truth[1:, newest - ahead]) / np.sqrt(variance)


def test_the_lines_of_a_motion_are_found() -> None:
    spectrum = Record(sines((0.05, 3.0, 0.4), (0.002, 11.0, 1.0)), 100, 1e-3, 2000).spectrum()
    angle, position = spectrum.lines
    hertz = angle.frequency * 100 / (2 * np.pi)
    for frequency, size in ((3.0, 0.05), (11.0, 0.002)):
        near = np.abs(hertz - frequency) < 0.25
        variance = angle.variance[near].sum() * 1e-6
        assert variance == pytest.approx(size**2 / 2, rel=0.1)
        assert near.sum() <= 4
    assert np.abs(hertz[:, None] - (3.0, 11.0)).min(axis=1).max() < 0.25
    assert not angle.has_trend and not position.has_trend


def test_a_crank_has_a_trend_and_its_position_a_line() -> None:
    angle, position = Record(sines(speed=5.0), 100, 1e-3, 2000).spectrum().lines
    assert angle.has_trend and not len(angle.frequency)
    assert position.frequency[position.variance.argmax()] == pytest.approx(0.05, rel=0.05)


def test_noise_has_no_spectrum() -> None:
    for seed in range(100):
        assert Record(sines(), 60, 1e-3, 1000, seed).spectrum() is None


def test_few_windows_have_no_spectrum() -> None:
    motion = sines((0.05, 3.0, 0.4))
    enough = round(SPECTRUM_WINDOWS * WINDOW * 100)
    assert Record(motion, 100, 1e-3, enough).spectrum() is None
    assert Record(motion, 100, 1e-3, enough + 1).spectrum() is not None
    assert Record(motion, 100, 1e-3, 2).spectrum() is None


@pytest.mark.parametrize('noise', [0.0, np.nan, np.inf])
def test_without_a_noise_or_an_order_there_is_no_spectrum(noise: float) -> None:
    record = Record(sines((0.05, 3.0, 0.4)), 100, 1e-3, 2000)
    poses = record.time, record.angle, record.position
    assert find_spectrum(*poses, (noise, 1e-3), WINDOW) is None
    assert find_spectrum(*poses, (1e-3, noise), WINDOW) is None
    record.time[700] = record.time[699]
    assert record.spectrum() is None


def test_lost_frames_and_one_jump_leave_the_lines() -> None:
    record = Record(sines((0.05, 3.0, 0.4)), 100, 1e-3, 2000)
    whole = record.spectrum().lines[0]
    record.angle[np.random.default_rng(0).random(2000) < 0.2] = np.nan
    lost = record.spectrum().lines[0]
    assert lost.frequency[lost.variance.argmax()] == whole.frequency[whole.variance.argmax()]
    assert lost.variance.sum() == pytest.approx(whole.variance.sum(), rel=0.1)
    assert len(lost.frequency) <= len(whole.frequency) + 2
    # What happens once is in one half of the record.
    record.angle[1500:] += 1.0
    jumped = record.spectrum().lines[0]
    assert len(jumped.frequency) <= len(lost.frequency) + 2


def test_poses_that_are_off_are_noise() -> None:
    """As lines they would be a motion of all frequencies: then α had 3 times the error."""
    record = Record(sines((0.05, 3.0, 0.4)), 100, 1e-3, 2000)
    rng = np.random.default_rng(0)
    off = rng.random(2000) < 0.03
    record.angle[off] += 0.03 * rng.normal(size=off.sum())
    hertz = record.spectrum().lines[0].frequency * 100 / (2 * np.pi)
    assert np.abs(hertz - 3.0).max() < 0.25


def test_equal_poses_have_equal_numbers() -> None:
    one, other, another = (
        Record(sines((0.05, 3.0, 0.4)), 100, 1e-3, 1000, seed).spectrum() for seed in (0, 0, 1)
    )
    assert one.number == other.number != another.number > 0


def test_a_body_with_lines_alone_is_derived_as_the_process_of_these() -> None:
    """The mean is that of a Gaussian process of these waves, by its covariance matrix."""
    count, frequency, variance = 31, np.array([0.9, 1.3]), np.array([400.0, 90.0])
    rng = np.random.default_rng(1)
    steps = np.arange(count) - 20.0
    waves = np.exp(1j * np.outer(steps, frequency)) @ (
        np.sqrt(variance) * (rng.normal(size=2) + 1j * rng.normal(size=2))
    )
    record = Record(sines(), 100, 1.0, count)
    record.angle = waves.real + rng.normal(size=count)
    record.angle += 3.0
    lines = Lines(frequency, variance, False), Lines(frequency[:0], variance[:0], False)
    found = record.derive(Spectrum(lines, 1), np.array([count - 1]), 10).angle[:, 0, 0]
    between = steps[:, None] - steps
    covariance = np.cos(between[..., None] * frequency) @ variance + np.eye(count)
    inverse = np.linalg.inv(covariance)
    one = np.ones(count)
    mean = one @ inverse @ record.angle / (one @ inverse @ one)
    weights = inverse @ (record.angle - mean)
    for order in range(1, 4):
        of_steps = frequency**order * np.cos(-steps[:, None] * frequency + order * np.pi / 2)
        expected = (of_steps @ variance) @ weights * 100.0**order
        assert found[order] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ('angle', 'rate', 'noise'),
    [
        (sines((0.02, 7.0, 0.3)), 60, 1e-2),
        (rod(6), 200, 3e-3),
        (rod(8), 200, 3e-3),
        (rod(6), 60, 1e-3),
    ],
    ids=['torsion of 2σ', 'rod at 6', 'rod at 8', 'rod at 6, 60 Hz'],
)
def test_harmonics_below_the_noise_of_a_window_are_covered(
    angle: Angle, rate: int, noise: float
) -> None:
    records = [Record(angle, rate, noise, 2048, seed) for seed in range(3)]
    found = np.abs(np.hstack([one.deviations(one.spectrum(), 0.1) for one in records]))
    assert (found < 2).mean(axis=1).min() > 0.87
    assert (found > 10).mean() < 0.002
    without = np.abs(records[0].deviations(None, 0.1))
    assert (without < 2).mean(axis=1).min() < 0.85


def test_steady_motion_is_known_better_at_the_newest_frame() -> None:
    record = Record(sines((0.4, 1.5, 0.0), (0.02, 6.0, 1.0)), 100, 1e-3, 2048)
    newest = np.arange(100, 2048, 7)
    with_it, without = (record.derive(one, newest, 0).angle for one in (record.spectrum(), None))
    off = np.stack((with_it, without))[:, 1:, :, 0] - record.truth[1:, newest]
    error = np.sqrt((off**2).mean(axis=2))
    assert (error[0] < 0.5 * error[1]).all()


def test_a_window_with_an_event_is_derived_without_the_spectrum() -> None:
    """A stationary process with the spectrum of kicks is wrong where there is one."""
    rate, frames = 200, 2048
    seconds = np.arange(frames) / rate

    def kicked(time: np.ndarray) -> np.ndarray:
        speed = np.where(time % 1.0 < 0.5, 3.0, -3.0)
        angle = 3.0 * np.abs((time + 0.5) % 1.0 - 0.5)
        return np.stack((angle, speed, 0 * time, 0 * time))

    record = Record(kicked, rate, 1e-4, frames)
    spectrum = record.spectrum()
    assert len(spectrum.lines[0].frequency) > 10
    newest = np.flatnonzero(np.abs(seconds % 0.5 - 0.15) < 0.04)[20:]
    found, usual = (record.derive(one, newest, 20) for one in (spectrum, None))
    for one, other in zip(found, usual, strict=True):
        np.testing.assert_array_equal(one, other)


def frames_of(record: Record) -> MarkerFrames:
    shape = np.array([0.1, -0.1, 0.1j])
    turned = np.exp(1j * record.truth[0])[:, None]
    rng = np.random.default_rng(3)
    points = turned * (shape + ARM)
    points = points + 1e-4 * (rng.normal(size=points.shape) + 1j * rng.normal(size=points.shape))
    flat = np.stack((points.real, points.imag, 0 * points.real), axis=-1)
    return MarkerFrames(record.time + 1, 'world', ('a', 'b', 'c'), flat)


def test_the_tracker_learns_spectra_and_a_recording_has_them_from_the_start() -> None:
    record = Record(sines((0.4, 1.5, 0.0), (0.02, 6.0, 1.0)), 100, 0.0, 1500)
    frames = frames_of(record)
    settings = settings_from({'window': WINDOW, 'lag': 0.0})
    live = Tracker(settings)
    found = live.add(frames, 3)
    rates = np.concatenate([one.angle[1, :, 0] for one in found])
    stamps = np.concatenate([one.stamp for one in found])
    rows = record.time.searchsorted(stamps - 1)
    off = rates - record.truth[1, rows]
    early, late = rows < 400, rows > 700
    assert np.sqrt((off[late] ** 2).mean()) < 0.6 * np.sqrt((off[early] ** 2).mean())
    (spectrum,) = live.state.bodies.spectra
    assert len(spectrum.lines[0].frequency)
    tracker, recording = learn_recording(settings, [frames])
    assert all(one.bodies.spectra[0] is not None for one in recording.stretches)
    # Another body has no spectrum, and neither has one that starts again.
    assert tracker.state.bodies.restart(np.array([True])).spectra[0] is None


def test_each_body_of_a_rig_has_its_own_spectrum() -> None:
    names, angles = ('crank', 'rocker'), (sines(speed=6.0), sines((0.4, 1.5, 0.0)))
    records = [Record(angle, 100, 0.0, 1200) for angle in angles]
    parts = [frames_of(record) for record in records]
    points = np.concatenate([part.points + 2.0 * k for k, part in enumerate(parts)], axis=1)
    markers = {f'{name}.markers': [f'{name}_{k}' for k in 'abc'] for name in names}
    tracker = Tracker(settings_from({'window': WINDOW, 'bodies': list(names)} | markers))
    labels = tuple(label for own in markers.values() for label in own)
    tracker.add(MarkerFrames(parts[0].stamps, 'world', labels, points), 1)
    crank, rocker = tracker.state.bodies.spectra
    assert crank.lines[0].has_trend and not len(crank.lines[0].frequency)
    hertz = rocker.lines[0].frequency[rocker.lines[0].variance.argmax()] * 100 / (2 * np.pi)
    assert not rocker.lines[0].has_trend and hertz == pytest.approx(1.5, abs=0.1)


def test_spectra_that_pass_leave_no_memory() -> None:
    """Each spectrum has tables of its own, and a run of hours has thousands of spectra."""

    def make(number: int) -> None:
        frequency = np.sort(np.random.default_rng(number).random(200)) * 3
        lines = Lines(frequency, np.full(200, 4.0), False)
        _models.models_of(31, 1, False, Spectrum((lines, lines), number))

    tracemalloc.start()
    held = []
    for first in (1, 41):
        for number in range(first, first + 40):
            make(number)
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[1] - held[0] < 5e5


def test_spectra_of_spoiled_markers_are_no_worse_than_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Hidden, lost and misplaced markers had lines at all frequencies: α had 3 times the error."""
    record = Record(sines((0.4, 1.5, 0.0), (0.03, 5.0, 1.0)), 60, 0.0, 2600)
    frames, rng = frames_of(record), np.random.default_rng(5)
    points = frames.points.copy()
    points[rng.random(points.shape[:2]) < 0.06] = np.nan
    off = rng.random(points.shape[:2]) < 0.02
    points[off, :2] += 0.004 * rng.normal(size=(off.sum(), 2))
    late = np.round(2e6 * rng.exponential(size=len(points))).astype(np.int64)
    kept = rng.random(len(points)) > 0.08
    sent = MarkerFrames((frames.stamps + late)[kept], 'world', frames.identities, points[kept])
    seen, errors = record.time[kept], []
    for least in (SPECTRUM_WINDOWS, 10**6):
        monkeypatch.setattr(update, 'SPECTRUM_WINDOWS', least)
        tracker = Tracker(settings_from({'window': WINDOW, 'lag': 0.1}))
        found = tracker.add(sent, 3)
        rows = sent.stamps.searchsorted(np.concatenate([one.stamp for one in found]))
        off_rates = [
            np.concatenate([one.angle[order, :, 0] for one in found])
            - record.truth[order, record.time.searchsorted(seen[rows])]
            for order in (1, 2)
        ]
        late_rows = rows > 1200
        errors.append([np.sqrt(np.nanmean(one[late_rows] ** 2)) for one in off_rates])
    (spectrum,) = tracker.state.bodies.spectra
    assert spectrum is None
    assert errors[0][0] < errors[1][0] and errors[0][1] < errors[1][1]
