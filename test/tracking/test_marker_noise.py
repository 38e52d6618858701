"""A marker that errs more than the others of its body counts for less, and is named."""

import numpy as np
import pytest
from recordings import KITE
from test_wrong_frames import frames_of, motion, off_by, tracker_of

from kinpole_ros.messages import DiagnosticsMaker
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.tracking.frame import MarkerFrames, part_of

T = np.arange(700) / 200
NOISE = 2e-4


def erring(kind: str, marker: int = 1) -> MarkerFrames:
    """The frames with one marker that is noisier, slips with the motion, or is not there."""
    frames = frames_of(*motion(T)[:2])
    points = frames.points.copy()
    angle = motion(T)[1]
    if kind == 'noisier':
        more = np.random.default_rng(8).normal(size=(len(T), 2)) * 10 * NOISE
    else:
        slip = 2e-3 * np.sin(angle) * np.exp(1j * (angle + 0.7))
        more = np.stack((slip.real, slip.imag), axis=-1)
    points[:, marker, :2] += np.nan if kind == 'absent' else more
    return frames._replace(points=points)


def test_it_does_as_little_harm_as_if_it_were_not_there() -> None:
    errors = {}
    for kind in ('noisier', 'slipping', 'absent'):
        found = off_by(tracker_of(), erring(kind))
        off = found[1, found[0] > 1.7e9]
        assert (np.abs(off) < 1.96).mean() > 0.85
        errors[kind] = np.sqrt((off**2).mean())
    assert errors['noisier'] < 1.3 * errors['absent']
    assert errors['slipping'] < 1.3 * errors['absent']


@pytest.mark.parametrize(('kind', 'deviation'), [('noisier', 2e-3), ('slipping', 1e-3)])
def test_it_is_named_with_what_it_errs(kind: str, deviation: float) -> None:
    tracker, maker = tracker_of(), DiagnosticsMaker('kinpole')
    (estimate,) = tracker.add(erring(kind), 1)
    assert tracker.erring()['kite'] == {'b': pytest.approx(deviation, rel=0.25)}
    assert tracker.noise() == pytest.approx(NOISE, rel=0.1)
    status = maker.make(10**18, tracker, estimate, 1.0, {}).status[1]
    assert status.level == DiagnosticStatus.WARN
    assert "marker 'b' errs by " in status.message
    assert 'counts for less' in status.message


def test_it_is_named_while_others_are_hidden() -> None:
    frames = erring('noisier')
    frames.points[:, 0] = np.nan
    frames.points[170:, 3] = np.nan
    tracker = tracker_of()
    for part in (slice(0, 170), slice(170, 700)):
        tracker.add(part_of(frames, part), 1)
        assert 'b' in tracker.erring()['kite']


def test_live_it_counts_as_in_a_block() -> None:
    frames = erring('noisier')
    some = frames._replace(stamps=frames.stamps[:240], points=frames.points[:240])
    found = [off_by(tracker_of(), some, live) for live in (False, True)]
    np.testing.assert_allclose(*found, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize('hidden', [0.0, 0.3])
@pytest.mark.parametrize('noise', [0.0, NOISE])
def test_markers_that_are_alike_count_alike(noise: float, hidden: float) -> None:
    for count in (2, 3, 4):
        frames = frames_of(*motion(T)[:2], noise)
        points = frames.points.copy()
        points[np.random.default_rng(5).random(points.shape[:2]) < hidden] = np.nan
        points[:, count:] = np.nan
        tracker = tracker_of()
        tracker.add(frames._replace(points=points), None)
        assert tracker.erring() == {'kite': {}}


def test_of_three_markers_the_bad_one_is_found_and_of_two_nothing_is_said() -> None:
    for count, bad in ((3, {'b'}), (2, set())):
        frames = erring('noisier')
        frames.points[:, count:] = np.nan
        tracker = tracker_of()
        tracker.add(frames, None)
        assert tracker.erring()['kite'].keys() == bad


def test_markers_of_several_links_are_not_taken_for_bad_ones() -> None:
    frames = frames_of(*motion(T)[:2])
    other = 0.5 + np.exp(2j * T)[:, None] * KITE[:2]
    frames.points[:, :2, 0], frames.points[:, :2, 1] = other.real, other.imag
    tracker = tracker_of()
    tracker.add(frames, None)
    assert tracker.erring() == {'kite': {}}
    assert tracker.rigidity_residual() > 0.01
