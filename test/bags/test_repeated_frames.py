"""Frames that a converter repeated are found, left out, and the others get their stamps back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.bags import (
    BagError,
    import_points,
    leave_out_repeats,
    read_frames,
    replay,
    write_points,
)
from kinpole_ros.settings import Settings

ARMS = np.array([0.04, 0.09 + 0.01j, 0.3])


def turning(times: np.ndarray) -> np.ndarray:
    """Two markers on a crank and one on the ground (T, 3, 2), m."""
    angle = 3 * times + 0.4 * np.sin(2 * times)
    places = ARMS * np.exp(1j * angle[:, None] * (1, 1, 0))
    return np.stack((places.real, places.imag), axis=-1)


def swinging(times: np.ndarray) -> np.ndarray:
    """The same on a rocker that stands still twice a period."""
    return turning(0.5 * np.sin(2 * times))


def dwelling(times: np.ndarray) -> np.ndarray:
    """The same on a crank that stands still for a third of each second."""
    return turning(np.floor(times) + np.clip(1.5 * (times % 1) - 0.25, 0, 1))


def converted(
    taken: np.ndarray, rate: float, noise: float, motion: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stamps of frames at a rate that show the last picture, their points, and its time."""
    random = np.random.default_rng(0)
    times = np.arange(round(taken[-1] * rate)) / rate
    shown = taken.searchsorted(times + 1e-9, 'right') - 1
    points = motion(taken) + noise * random.standard_normal((len(taken), 3, 2))
    points = points[shown] + 1e-3 * noise * random.standard_normal((len(times), 3, 2))
    return np.rint(times * 1e9).astype(np.int64), points, taken[shown]


@pytest.mark.parametrize('motion', [turning, swinging, dwelling])
@pytest.mark.parametrize('noise', [0.0, 5e-5])
@pytest.mark.parametrize(
    ('before', 'after'),
    [(24, 30), (25, 30), (15, 30), (10, 30), (24, 60), (30, 60)],
)
def test_the_rate_before_a_conversion_is_found(
    before: float, after: float, noise: float, motion: Callable[[np.ndarray], np.ndarray]
) -> None:
    stamps, points, taken = converted(np.arange(5 * before) / before, after, noise, motion)
    kept = leave_out_repeats('f', 'pictures', stamps, points)
    off = kept.stamps * 1e-9 - taken[kept.is_kept]
    assert np.ptp(off) < 1e-5
    assert (np.diff(taken[kept.is_kept]) > 0).all()
    repeats = len(stamps) - len(kept.stamps)
    assert kept.finding is not None and kept.finding.words() == (
        f'{repeats} of {len(stamps)} pictures repeat the one before, as a converter makes them '
        f'from {before:.4g} to {after:.4g} Hz, and are left out'
    )


def test_the_rates_of_television_are_found() -> None:
    before = 24 / 1.001
    stamps, points, taken = converted(np.arange(1200) / before, 30, 0.0, turning)
    kept = leave_out_repeats('f', 'pictures', stamps, points)
    assert np.ptp(kept.stamps * 1e-9 - taken[kept.is_kept]) < 1e-5


def test_repeats_that_a_tracker_saw_with_noise_are_found() -> None:
    """A tenth of a step, anew in each frame, as of a film that was compressed again."""
    stamps, points, taken = converted(np.arange(120) / 24, 30, 0.0, turning)
    random = np.random.default_rng(0)
    points = points + 4e-4 * random.standard_normal(points.shape)
    kept = leave_out_repeats('f', 'pictures', stamps, points)
    assert np.ptp(kept.stamps * 1e-9 - taken[kept.is_kept]) < 1e-5
    assert kept.finding is not None and kept.finding.code == 'repeats_converted'
    assert kept.finding.values['before'] == pytest.approx(24)


def test_uneven_stamps_that_were_made_even_are_not_known() -> None:
    random = np.random.default_rng(2)
    taken = np.cumsum(random.uniform(0.026, 0.05, 120))
    stamps, points, _ = converted(taken - taken[0], 30, 5e-5, turning)
    with pytest.raises(BagError, match=r'f: \d+ of \d+ pictures repeat the one before in no even'):
        leave_out_repeats('f', 'pictures', stamps, points)


def test_where_the_last_picture_stands_for_a_lost_one_stamps_are_right() -> None:
    taken = np.delete(np.arange(150) / 30, [20, 50, 51, 90])
    stamps, points, shown = converted(taken, 30, 5e-5, turning)
    kept = leave_out_repeats('f', 'pictures', stamps, points)
    np.testing.assert_allclose(kept.stamps * 1e-9, shown[kept.is_kept], atol=1e-8)
    assert kept.finding is not None
    assert (kept.finding.code, kept.finding.values['repeats']) == ('repeats', 4)


@pytest.mark.parametrize('motion', [turning, swinging])
@pytest.mark.parametrize('noise', [0.0, 2e-4])
@pytest.mark.parametrize(('before', 'after'), [(30, 24), (30, 25), (50, 30), (60, 24), (60, 25)])
def test_pictures_that_a_converter_left_out_are_lost_frames(
    before: int, after: int, noise: float, motion: Callable[[np.ndarray], np.ndarray]
) -> None:
    frames = np.arange(5 * after)
    taken = (frames * before + 10) // after / before
    points = motion(taken) + noise * np.random.default_rng(0).standard_normal((len(taken), 3, 2))
    kept = leave_out_repeats('f', 'pictures', np.rint(frames * 1e9 / after).astype(int), points)
    assert kept.is_kept.all() and kept.finding is not None
    assert f'from {before} to {after} Hz left out pictures' in kept.finding.words()
    assert np.ptp(kept.stamps * 1e-9 - taken) < 1e-6


def test_pictures_left_out_in_a_pattern_that_changes_are_refused() -> None:
    frames = np.arange(125)
    taken = np.where(frames < 10, frames, frames * 30 // 24 - 2) / 30
    with pytest.raises(BagError, match='f: a program that changed the rate to 24 Hz left out pict'):
        leave_out_repeats('f', 'pictures', np.rint(frames * 1e9 / 24).astype(int), turning(taken))


def test_a_given_rate_is_that_of_pictures_that_repeat_no_other() -> None:
    stamps, points, _ = converted(np.arange(100) / 24, 30, 5e-5, turning)
    kept = leave_out_repeats('f', 'pictures', stamps, points, 240.0)
    np.testing.assert_allclose(np.diff(kept.stamps), 1e9 / 240, atol=1)


@pytest.mark.parametrize(
    'points',
    [
        np.zeros((200, 3, 2)),
        dwelling(np.arange(200) / 30),
        swinging(np.arange(200) / 30),
        turning(np.arange(200) / 6) + 0.02 * turning(np.arange(200) * 4),
        # A vibration of 8.4 Hz at 25 Hz, by which a drift stops at about each third frame.
        0.1 * turning(np.zeros(200))
        + (0.0165 * np.arange(200) + 0.01 * np.sin(2.11 * np.arange(200)))[:, None, None],
        np.round(turning(np.arange(200) / 3000), 4),
        turning(np.arange(200) / 30000)
        + 1e-4 * np.random.default_rng(1).standard_normal((200, 3, 2)),
    ],
    ids=['still', 'dwell', 'swing', 'shake', 'drift', 'rounded', 'noise'],
)
def test_slow_and_rounded_motion_is_no_repeat(points: np.ndarray) -> None:
    kept = leave_out_repeats('f', 'rows', np.arange(200) * 33_333_333, points)
    assert kept.is_kept.all() and kept.finding is None


def test_a_table_of_such_a_film_is_imported_at_the_rate_of_the_film(tmp_path: Path) -> None:
    stamps, points, taken = converted(np.arange(100) / 24, 30, 0.0, turning)
    rows = np.column_stack((stamps * 1e-9, points.reshape(len(stamps), -1))).tolist()
    table = tmp_path / 'points.csv'
    lines = [','.join(map(repr, row)) for row in rows]
    table.write_text('\n'.join(['t,a_x,a_y,b_x,b_y,c_x,c_y', *lines]))
    imported = import_points(table, tmp_path / 'out.mcap', scale=1.0)
    assert imported.rate == pytest.approx(24)
    assert 'frames repeat the one before, as a converter' in imported.notes[-1]
    frames, _ = read_frames(tmp_path / 'out.mcap', None, 60.0)
    read = np.concatenate([part.stamps for part in frames])
    assert len(read) == len(np.unique(taken))
    np.testing.assert_allclose(np.diff(read), 1e9 / 24, atol=2)


@pytest.mark.parametrize(('is_film', 'count'), [(True, 300), (True, 45), (False, 300)])
def test_replay_blames_a_tracker_for_no_repeats_of_a_film(
    is_film: bool, count: int, tmp_path: Path
) -> None:
    """Also of one of 1.5 s, in which the tracker has not learned yet that poses never repeat."""
    number = np.arange(count)
    shown = number * 4 // 5 if is_film else number - (number % 9 == 8)
    points = turning(number / (24 if is_film else 30))[:, :2]
    points = (points + 2e-5 * np.random.default_rng(2).standard_normal(points.shape))[shown]
    stamps = np.rint(number * 1e9 / 30).astype(np.int64)
    bag = tmp_path / 'markers.mcap'
    write_points(bag, ['a', 'b'], stamps, np.pad(points, ((0, 0), (0, 0), (0, 1))))
    codes = [finding.code for finding in replay(bag, Settings()).findings]
    assert ('repeats_converted' in codes) == is_film
    assert ('poses_held' in codes) != is_film
