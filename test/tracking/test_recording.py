"""A recording known as a whole: what is learned up to its end is known from its first frame on."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from rig_streams import (
    FRAMES,
    PARAMETERS,
    RATE,
    Stream,
    clock_jumps,
    frames,
    late,
    listed_for_another_body,
    markers,
    new_markers,
    noisy_marker,
    usual,
)

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import KNOWN
from kinpole_ros.tracking.tracker import Tracker, learn_recording

pytestmark = pytest.mark.filterwarnings('error')

WINDOW, LAG, FIRST = 30, 15, 100  # frames; the last is the first second
RATES = np.stack((np.full(FRAMES, 2 * np.pi), 1.5 * np.cos(3 * np.arange(FRAMES) / RATE)), axis=1)


def known(stream: Stream, size: int = 1000, whole: bool = True) -> list[Estimate]:
    """Return the estimates of a stream, with the lag of half a window."""
    settings = settings_from(stream.parameters).of_recording()
    blocks = stream.blocks(size)
    recording = learn_recording(settings, blocks)[1] if whole else None
    tracker = Tracker(settings, recording)
    estimates = [one for block in blocks for one in tracker.add(block, 1, True)]
    return estimates + tracker.finish(1)


def column(estimates: list[Estimate], name: str) -> np.ndarray:
    axis = {'angle': 1, 'angle_covariance': 2}.get(name, 0)
    return np.concatenate([getattr(one, name) for one in estimates], axis)


def errors(points: np.ndarray, whole: bool = True) -> np.ndarray:
    """Errors of the angular velocity (T, B) of markers (T, 8); NaN where there is none."""
    stream = Stream(PARAMETERS, [frames(points)])
    estimates = known(stream, whole=whole)
    found = np.full(RATES.shape, np.nan)
    rows = stream.parts[0].stamps.searchsorted(column(estimates, 'stamp'))
    found[rows] = column(estimates, 'angle')[1]
    return found - RATES


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


def test_the_first_second_is_almost_as_good_as_the_rest() -> None:
    off = errors(markers(0))
    assert (rms(off[:FIRST]) < 1.3 * rms(off[FIRST:])).all()


def test_each_frame_has_a_result_that_its_deviation_covers() -> None:
    stream = Stream(PARAMETERS, [frames(markers(1))])
    estimates, live = known(stream), known(stream, whole=False)
    assert column(estimates, 'stamp').tolist() == stream.parts[0].stamps.tolist()
    sigma = np.sqrt(column(estimates, 'angle_covariance')[1, 1])
    for ends in (slice(LAG), slice(-LAG, None)):
        off = column(estimates, 'angle')[1] - RATES
        assert (np.abs(off[ends]) < 2 * sigma[ends]).mean() > 0.93
    # The crank's pin is known before it is found.
    assert np.isnan(column(live, 'pin')[0, 0])
    assert abs(column(estimates, 'pin')[0, 0]) < 1e-4


def _slipped(points: np.ndarray) -> None:
    turn = np.exp(2j * np.pi * np.arange(FRAMES) / RATE)
    points[250:, 1] += 0.005 * turn[250:]


def _exchanged(points: np.ndarray) -> None:
    points[250:, [0, 1]] = points[250:, [1, 0]]


def _lost(points: np.ndarray) -> None:
    points[250:, [0, 5]] = np.nan


def _on_tissue(points: np.ndarray) -> None:
    points[250:, 1] += 0.004 * np.sin(9 * np.arange(250) / RATE)


@pytest.mark.parametrize('spoil', [_slipped, _exchanged, _lost, _on_tissue])
def test_what_begins_in_the_middle_is_no_error_of_the_first_half(
    spoil: Callable[[np.ndarray], None],
) -> None:
    points = markers(2)
    spoil(points)
    off, live = errors(points), errors(points, whole=False)
    assert (rms(off[: 250 - WINDOW]) < 1.02 * rms(live[: 250 - WINDOW])).all()
    if spoil is not _on_tissue:
        assert (rms(off[250:-LAG]) < 1.05 * rms(live[250:-LAG])).all()


def test_wrong_names_noise_and_clock_are_known_at_the_start() -> None:
    for make in (noisy_marker, listed_for_another_body):
        off = column(known(make()), 'angle')[1] - RATES
        assert (rms(off[:FIRST]) < 1.5 * rms(off[FIRST:])).all()
    # Of the crank, at a constant rate.
    of_crank = column(known(late()), 'angle')[1, :FIRST, 0] - 2 * np.pi
    assert rms(of_crank) < 0.02


@pytest.mark.parametrize('make', [clock_jumps, new_markers])
def test_frames_one_by_one_are_known_as_blocks_are(make: Callable[[], Stream]) -> None:
    one_by_one, in_blocks = known(make(), 1), known(make(), 97)
    for name in ('stamp', 'angle', 'angle_covariance', 'reason', 'pin'):
        expected, found = column(one_by_one, name), column(in_blocks, name)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=name)


def test_frames_before_a_jump_of_the_stamps_have_results_to_the_last() -> None:
    # Of the 500 frames one repeats a stamp, and one is late.
    estimates = known(clock_jumps())
    assert len(column(estimates, 'stamp')) == FRAMES - 2
    assert (column(estimates, 'reason') == KNOWN).all()


@pytest.mark.parametrize('step', [10_000_000, 13_333_333])
def test_frames_beside_a_gap_have_results(step: int) -> None:
    """The window that comes after a gap leaves frames behind, and so may the first one."""
    kept = np.r_[:60, 78:120]
    stream = Stream(PARAMETERS, [frames(markers(4)[kept], 10**9 + step * kept)])
    settings = settings_from(stream.parameters)
    shorter = replace(settings, window=0.02 + 18e-9 * step, lag=0.01)
    tracker = Tracker(shorter, learn_recording(shorter, stream.parts)[1])
    estimates = tracker.add(stream.parts[0], 1) + tracker.finish(1)
    assert column(estimates, 'stamp').tolist() == stream.parts[0].stamps.tolist()


def test_few_stretches_are_kept_of_many_frames() -> None:
    stream = usual()
    points = np.tile(stream.parts[0].points, (4, 1, 1))
    many = stream.parts[0]._replace(points=points, stamps=10**7 * np.arange(len(points)))
    recording = learn_recording(settings_from(stream.parameters), [many])[1]
    assert len(recording.stretches) < 8
