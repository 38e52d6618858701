"""The compiled derivatives are those of the reference in numpy, whatever windows look like."""

import derivatives_reference as reference
import numpy as np
import pytest

from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses

STEP = 5_000_000


def record(rng: np.random.Generator, frames: int, bodies: int, noise: float, **how: float) -> Poses:
    """Poses on waves of any length with noise, and stamps, that are spoiled as `how` says."""
    places = np.arange(frames, dtype=float)
    places += rng.uniform(-how['jitter'], how['jitter'], frames) / 2
    kept = rng.uniform(size=frames) >= how['lost']
    if how['gap']:
        begin = int(rng.integers(frames // 2))
        kept[begin : begin + int(how['gap'])] = False
    places = np.sort(places[kept])
    time = np.unique(np.rint(places * STEP).astype(np.int64))
    count = len(time)
    seconds = (time * 1e-9)[:, None, None]
    hertz = 10 ** rng.uniform(-1, 1.3, (bodies, 3))
    size = noise * 10 ** rng.uniform(-1, 1.5, (bodies, 3))
    motion = size * np.sin(2 * np.pi * hertz * seconds + rng.uniform(0, 6, (bodies, 3)))
    if how['stops']:
        motion[time > rng.uniform(0.3, 0.9) * time[-1]] = 0.0
    if how['rebounds']:
        motion += 30 * noise * np.abs(np.sin(np.pi * seconds / (STEP * 1e-9 * how['rebounds'])))
    motion += noise * rng.normal(size=motion.shape)
    turns = np.rint(motion[..., 0] / (2 * np.pi))
    information = [np.ones((count, bodies)), np.ones((count, bodies))]
    for own in information:
        some = rng.uniform(size=own.shape) < how['poor']
        own[some] = 10 ** rng.uniform(-3, 0, np.count_nonzero(some))
    hidden = rng.uniform(size=(count, bodies)) < how['hidden']
    for own in information:
        own[hidden] = 0.0
    angle = motion[..., 0] - 2 * np.pi * turns
    angle[hidden] = np.nan
    position = np.where(hidden, np.nan, motion[..., 1] + 1j * motion[..., 2])
    return Poses(time, angle, turns, position, information[0], information[1])


PLAIN = {
    'jitter': 0.0, 'lost': 0.0, 'gap': 0, 'hidden': 0.0, 'poor': 0.0, 'stops': 0, 'left_out': 0,
    'rebounds': 0,
}  # fmt: skip
CASES = {
    'even': {},
    'motions that stop': {'stops': 1},
    'motions that rebound several times in a window': {'rebounds': 12},
    'jitter': {'jitter': 0.3},
    'wild jitter': {'jitter': 0.9},
    'lost frames': {'lost': 0.1},
    'many lost frames': {'lost': 0.6},
    'a gap': {'gap': 25},
    'hidden bodies': {'hidden': 0.1},
    'bodies hidden for long': {'hidden': 0.6},
    'poor poses': {'poor': 0.2},
    'frames left out': {'left_out': 6},
    'all of it': {
        'jitter': 0.2, 'lost': 0.1, 'hidden': 0.05, 'poor': 0.1, 'stops': 1, 'left_out': 3,
    },
}  # fmt: skip


def compare(found: Derivatives, expected: Derivatives, tolerance: float) -> None:
    """Each within so many of its standard deviations, and unknown where the other is."""
    for name, one, other in zip(found._fields, found, expected, strict=True):
        assert one.shape == other.shape, name
        assert (np.isnan(one) == np.isnan(other)).all(), name
    for k in range(2):
        one, other, more, covariance = found[k], expected[k], found[k + 2], expected[k + 2]
        deviation = np.sqrt(np.einsum('kk...->k...', covariance))
        off = np.nan_to_num(np.abs(one - other) / deviation)
        # The arm of a hub is a quotient of small differences.
        own = tolerance * np.where((k == 0) & (expected.reference != 0), 10.0, 1.0)
        # A sum is rounded.
        assert (off <= own + 1e-15 * np.nan_to_num(np.abs(other) / deviation)).all(), off.max()
        off = np.nan_to_num(np.abs(more - covariance) / (deviation * deviation[:, None]))
        assert (off <= own).all(), off.max()
    np.testing.assert_allclose(found.span, expected.span, rtol=1e-12)
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=1e-9)
    np.testing.assert_allclose(found.reference, expected.reference, rtol=1e-6)


def both(
    rng: np.random.Generator, poses: Poses, noise: float, length: float, left_out: int
) -> tuple[Derivatives, Derivatives]:
    """Derivatives at some instants, compiled and of the reference."""
    frames, bodies = poses.angle.shape
    newest = rng.integers(min(20, frames - 1), frames, 3)
    ahead = np.minimum(rng.integers(0, 7, 3), newest)
    oldest = np.searchsorted(poses.time, poses.time[newest] - round(length * 1e9))
    windows = Windows(newest - ahead, np.minimum(oldest, newest - ahead), newest)
    out = rng.integers(0, left_out + 1, (3, bodies))
    arguments = poses, windows, out, np.full((3, bodies), noise), length, 4
    with np.errstate(all='ignore'):
        expected = reference.derive_poses(*arguments)
    return derive_poses(*arguments), expected


@pytest.mark.parametrize('case', CASES)
def test_derivatives_are_those_of_the_reference(case: str) -> None:
    """Of windows from 7 samples to 500, the longest in blocks."""
    rng = np.random.default_rng(1)
    how = PLAIN | CASES[case]
    for samples in (7, 25, 61, 128, 500):
        bodies = int(rng.integers(1, 4))
        poses = record(rng, samples + 80, bodies, 1e-3, **how)
        length = (samples - 1) * STEP * 1e-9
        found, expected = both(rng, poses, 1e-3, length, how['left_out'])
        # Motion is more deviations in blocks, and what a model leaves the difference of squares.
        # Segments are weighted by evidence, a difference of large squares.
        is_less_exact = samples > 128 or 'rebound' in case
        compare(found, expected, 1e-7 if is_less_exact else 1e-9)


@pytest.mark.parametrize('case', ['even', 'lost frames', 'poor poses'])
def test_samples_that_are_all_but_exact(case: str) -> None:
    rng = np.random.default_rng(2)
    for samples in (12, 61):
        poses = record(rng, samples + 80, 2, 1e-3, **PLAIN | CASES[case])
        noise = 1e-10
        compare(*both(rng, poses, noise, (samples - 1) * STEP * 1e-9, 0), 1e-4)


def plain(bodies: int = 3, frames: int = 80) -> tuple[Poses, Windows]:
    """Poses without gaps, and an instant in the middle of them."""
    poses = record(np.random.default_rng(3), frames, bodies, 1e-3, **PLAIN)
    return poses, Windows(*(np.array([k]) for k in (60, 0, frames - 1)))


def derive(poses: Poses, windows: Windows) -> Derivatives:
    shape = 1, poses.angle.shape[1]
    return derive_poses(poses, windows, np.zeros(shape, int), np.full(shape, 1e-3), 0.4, 4)


def test_each_body_by_itself() -> None:
    """To the last digit."""
    poses, windows = plain()
    found = derive(poses, windows)
    for k in range(3):
        alone = derive(Poses(poses.time, *(a[:, k : k + 1] for a in poses[1:])), windows)
        for one, whole in zip(alone, found, strict=True):
            assert (one[..., 0] == whole[..., k]).all()


def test_what_is_not_a_number_stays_apart() -> None:
    poses, windows = plain()
    expected = derive(poses, windows)
    poses.angle[20, 1] = poses.position[20, 1] = np.nan
    for one, whole in zip(derive(poses, windows)[:4], expected[:4], strict=True):
        assert np.isnan(one[..., 1]).all()
        assert (one[..., ::2] == whole[..., ::2]).all()


def test_a_part_of_few_samples_leaves_the_window_whole() -> None:
    """Six samples after a gap are too few for a motion of their own, and no model has a figure."""
    time = np.delete(np.arange(101), np.s_[71:95])
    phase = np.pi / 50 * time[:, None]
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(3, len(time), 1))
    angle, x, y = 1e5 * np.sin(phase + np.arange(3)[:, None, None]) + noise
    one = np.ones(angle.shape)
    poses = Poses(time * STEP, angle, 0 * one, x + 1j * y, one, one)
    windows = Windows(*(np.array([k]) for k in (len(time) - 2, 0, len(time) - 1)))
    shape = 1, 1
    found = derive_poses(poses, windows, np.zeros(shape, int), np.ones(shape), 0.5, 1)
    rate = 1e5 * np.pi / 50 * np.cos(np.pi / 50 * 99) / STEP * 1e9
    deviation = np.sqrt(found.angle_covariance[1, 1, 0, 0])
    assert abs(found.angle[1, 0, 0] - rate) < 4 * deviation


def test_arrays_that_do_not_fit_are_refused() -> None:
    """The library never reads beyond what it is given."""
    poses, windows = plain()
    for changed in (
        poses._replace(time=poses.time[1:]),
        poses._replace(angle=poses.angle[:, 1:]),
        poses._replace(position=poses.position[1:]),
    ):
        with pytest.raises(ValueError, match='shapes do not fit'):
            derive(changed, windows)
    with pytest.raises(ValueError, match='shapes do not fit'):
        derive(poses, windows._replace(newest=np.array([79, 79])))
    for beyond in (
        windows._replace(newest=np.array([80])),
        windows._replace(oldest=np.array([-1])),
        windows._replace(now=np.array([80])),
    ):
        with pytest.raises(IndexError, match='beyond the frames'):
            derive(poses, beyond)


@pytest.mark.parametrize('window', [0.0, -0.4, np.inf, np.nan])
def test_a_window_without_a_length_is_refused(window: float) -> None:
    """The library made an integer of the number of its samples, which has no value for infinity."""
    poses, windows = plain(1)
    still = np.zeros((1, 1), int), np.full((1, 1), 1e-3)
    with pytest.raises(ValueError, match=rf'window is {window} s, but a length is finite'):
        derive_poses(poses, windows, *still, window, 4)


def test_a_window_of_more_samples_than_an_integer_holds_has_no_result() -> None:
    poses, windows = plain(1)
    found = derive_poses(poses, windows, np.zeros((1, 1), int), np.full((1, 1), 1e-3), 1e300, 4)
    assert all(np.isnan(array).all() for array in found)


@pytest.mark.parametrize('order', [-1, 5])
def test_an_order_that_has_no_derivatives_is_refused(order: int) -> None:
    poses, windows = plain(1)
    still = np.zeros((1, 1), int), np.full((1, 1), 1e-3)
    with pytest.raises(ValueError, match=f'order is {order}, but derivatives have order 0 to 4'):
        derive_poses(poses, windows, *still, 0.4, order)


def test_stamps_that_do_not_increase_are_refused() -> None:
    """They made cells without number: memory of gigabytes, or seconds."""
    poses, windows = plain(1)
    between = poses.time[1:-1][::-1] * 100
    decreasing = np.concatenate((poses.time[:1], between, poses.time[:1] + 5))
    for time, frame in ((decreasing, 2), (np.zeros_like(poses.time), 1), (poses.time[::-1], 1)):
        with pytest.raises(ValueError, match=f'stamp .* of frame {frame} is not after the one be'):
            derive(poses._replace(time=time), windows)


def test_other_layouts_and_types_of_arrays_are_taken() -> None:
    poses, windows = plain()
    expected = derive(poses, windows)
    other = Poses(poses.time.astype(np.int32), *(np.asfortranarray(a) for a in poses[1:]))
    for array in other:
        array.flags.writeable = False
    for one, whole in zip(derive(other, windows), expected, strict=True):
        np.testing.assert_array_equal(one, whole)
