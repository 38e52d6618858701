"""What is told of a frame at once is what the arrays say of it, and nothing else is told."""

import copy
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recordings import START, STEP, record
from stretches import one_frame

from kinpole_ros.bench._motions import motions
from kinpole_ros.bench._record import observe
from kinpole_ros.estimate import RATE_NAMES, Estimate, Poses
from kinpole_ros.frame import MarkerFrames
from kinpole_ros.messages import result_outputs
from kinpole_ros.parameters import settings_from
from kinpole_ros.prompt import Moving, Prompt, body_of
from kinpole_ros.tracker import Tracker
from kinpole_ros.window import STRIKES
from kinpole_ros.window._poses import room_of
from kinpole_ros.window._projection import Projection, project
from kinpole_ros.window._weighted import squares_of

pytestmark = pytest.mark.filterwarnings('error')

ORDER = 3
# Until noise is known and the first windows are full.
START_UP = 60


def figures(moving: Moving) -> list[complex | None]:
    rates = [moving.rate(order) for order in range(1, ORDER + 1)]
    return [*rates, moving.icr, moving.centrode_curvature]


def has_figures(found: Prompt) -> bool:
    try:
        return bool([figures(moving) for moving in found.bodies])
    except ArithmeticError:
        return False


def check(found: Prompt, estimate: Estimate) -> None:
    """All figures are those of the estimate, and determined where they are."""
    assert (found.stamp, found.frame_id) == (estimate.stamp[0], estimate.frame_id)
    for b, moving in enumerate(found.bodies):
        arrays = [
            *(estimate.rate(order) for order in range(1, ORDER + 1)),
            estimate.pole(1),
            estimate.centrode_curvature,
        ]
        sizes = [1.0, 1.0, 1.0, estimate.size[0, b], 1 / estimate.size[0, b]]
        for told, figure, size in zip(figures(moving), arrays, sizes, strict=True):
            assert (told is not None) == figure.determined[0, b]
            if told is not None:
                near = 1e-9 * max(size, abs(figure.value[0, b]))
                assert abs(told - figure.value[0, b]) <= near
        assert moving.height == pytest.approx(estimate.height[0, b], rel=1e-12)


def follow_both(
    frames: Sequence[MarkerFrames], values: dict[str, Any], tracker: Tracker | None = None
) -> tuple[list[int], list[Estimate]]:
    """
    Tell of frames at once and by arrays, compare both; which were told of, and the estimates.

    A `tracker` may have taken frames before.
    """
    tracker = tracker or Tracker(settings_from(values))
    told, estimates = [], []
    for k, frame in enumerate(frames):
        found = tracker.prompt(frame)
        added = tracker.add(frame, ORDER)
        if found is not None and has_figures(found):
            assert len(added) == 1
            check(found, added[0])
            told.append(k)
        estimates += added
        tracker.foresee(ORDER)
    return told, estimates


# Each scene with each lag, and each of these with each plane.
@pytest.mark.parametrize(
    ('scene', 'lag', 'plane'),
    [
        (scene, lag, ('xy', 'yz', 'zx')[(i + j) % 3])
        for i, scene in enumerate(('rolling_wheel', 'cardan', 'four_bar'))
        for j, lag in enumerate((0.0, 0.02, 0.1))
    ],
)
def test_prompt_figures_are_those_of_the_arrays(scene: str, lag: float, plane: str) -> None:
    seen = record(scene, 200, noise=2e-4, plane=plane)
    told, estimates = follow_both(seen.frames, {**seen.values, 'lag': lag})
    assert len(told) > 0.9 * (len(seen.frames) - START_UP)
    curved = [e.centrode_curvature.determined.any() for e in estimates]
    assert any(curved)


@pytest.mark.parametrize('name', list(motions()))
@pytest.mark.parametrize('noise', [1e-5, 1e-2])
def test_all_motions_are_told_of_at_once(name: str, noise: float) -> None:
    # Stop and go, among others: where a motion sets in, what was judged is refuted at once.
    frames, values = moving(name, noise, 260)
    told, _ = follow_both(frames, values)
    assert len(told) > 0.7 * (len(frames) - START_UP)


def moving(name: str, noise: float, count: int) -> tuple[list[MarkerFrames], dict[str, Any]]:
    motion = motions()[name]
    stamps = START + STEP * np.arange(count)
    _, markers = observe(motion, (stamps - START) * 1e-9)
    rng = np.random.default_rng(3)
    markers = markers + noise * motion.size * (rng.normal(size=(*markers.shape, 2)) @ (1, 1j))
    names = tuple(f'm{k}' for k in range(markers.shape[1]))
    solid = np.stack((markers.real, markers.imag, rng.normal(size=markers.shape)), axis=-1)
    rows = zip(stamps.tolist(), solid, strict=True)
    frames = [one_frame(stamp, 'world', names, points) for stamp, points in rows]
    return frames, {'bodies': ['body'], 'body.markers': list(names), 'lag': 0.1}


@settings(max_examples=5, deadline=None)
@given(
    st.floats(-np.pi, np.pi),
    st.floats(-3.0, 3.0),
    st.complex_numbers(max_magnitude=1e3),
)
@example(3.0, 3.0, 1e3)
def test_turned_moved_and_scaled_scenes_are_told_of_alike(
    angle: float, scale: float, shift: complex
) -> None:
    turn = 10**scale * np.exp(1j * angle)
    # Farther off rounding tells more than anything.
    shift *= abs(turn)
    seen = record('cardan', 160, turn=turn, shift=shift, noise=1e-4 * abs(turn))
    told, _ = follow_both(seen.frames, seen.values)
    assert len(told) > 0.8 * (len(seen.frames) - START_UP)


@pytest.mark.parametrize('rate', [60, 90, 120, 240, 300])
def test_rates_whose_interval_is_no_whole_number_of_ns_are_told_of(rate: int) -> None:
    seen = record('cardan', 200, noise=1e-4, step=1e9 / rate)
    told, _ = follow_both(seen.frames, seen.values)
    assert len(told) > (0.7 if rate == 90 else 0.9) * (len(seen.frames) - START_UP)


@pytest.mark.parametrize('drop', [0.02, 0.3])
def test_markers_that_are_hidden_now_and_then(drop: float) -> None:
    seen = record('four_bar', 260, noise=2e-4, drop=drop)
    told, _ = follow_both(seen.frames, seen.values)
    hidden = {k for k, frame in enumerate(seen.frames) if np.isnan(frame.points).any()}
    assert not hidden & set(told)
    if drop < 0.1:
        assert len(told) > 20


def test_uneven_stamps_are_left_to_the_arrays() -> None:
    seen = record('cardan', 160, noise=1e-4, jitter=0.1)
    told, estimates = follow_both(seen.frames, seen.values)
    assert not told
    assert len(estimates) > 50


def test_landmarks_and_many_bodies_are_left_to_the_arrays() -> None:
    seen = record('cardan', 120, noise=1e-4)
    assert not follow_both(seen.frames, {**seen.values, 'method': 'landmarks'})[0]
    markers = list(seen.frames[0].identities)
    many = {f'body{k}': markers for k in range(9)}
    values = {'bodies': list(many), **{f'{name}.markers': given for name, given in many.items()}}
    assert not follow_both(seen.frames, values)[0]


SIZE = motions()['two sines'].size
FAULTS = {
    'a marker hidden': lambda frame: with_marker(frame, np.nan),
    'a marker infinitely far': lambda frame: with_marker(frame, np.inf),
    'a marker too far to square': lambda frame: with_marker(frame, 1e200),
    'a marker without height': lambda frame: with_marker(frame, [*frame.points[0, 0, :2], np.nan]),
    'a marker wild': lambda frame: with_marker(frame, frame.points[0, 0] + 1.0),
    'a marker off by some deviations': lambda frame: with_marker(
        frame, frame.points[0, 0] + [12e-3 * SIZE, 0, 0]
    ),
    'all markers at one place': lambda frame: frame._replace(points=0 * frame.points),
    'turned by half a turn': lambda frame: frame._replace(points=frame.points[:, ::-1]),
    'all moved': lambda frame: frame._replace(points=frame.points + 0.3),
    'later by a ns': lambda frame: frame._replace(stamps=frame.stamps + 1),
    'later by a frame': lambda frame: frame._replace(stamps=frame.stamps + STEP),
    'earlier': lambda frame: frame._replace(stamps=frame.stamps - 3 * STEP),
    'in another frame': lambda frame: frame._replace(frame_id='other'),
    'with other names': lambda frame: frame._replace(identities=frame.identities[::-1]),
    'without a marker': lambda frame: frame._replace(
        identities=frame.identities[1:], points=frame.points[:, 1:]
    ),
    'twice': lambda frame: frame._replace(
        stamps=np.concatenate((frame.stamps, frame.stamps)),
        points=np.concatenate((frame.points, frame.points)),
    ),
}


def with_marker(frame: MarkerFrames, place: Any) -> MarkerFrames:
    points = frame.points.copy()
    points[0, 0] = place
    return frame._replace(points=points)


@functools.cache
def before_the_fault(
    name: str,
) -> tuple[list[MarkerFrames], dict[str, Any], Tracker, Tracker]:
    """Frames, settings, and trackers after 149 of them: one that looked ahead, one that did not."""
    if name == 'two sines':
        frames, values = moving(name, 1e-3, 180)
    else:
        seen = record(name, 180, noise=1e-4)
        frames, values = seen.frames, seen.values
    tracker, plain = (Tracker(settings_from(values)) for _ in range(2))
    told, _ = follow_both(frames[:149], values, tracker)
    assert 148 in told
    for frame in frames[:149]:
        plain.add(frame, ORDER)
    return frames, values, tracker, plain


@pytest.mark.parametrize('fault', FAULTS)
def test_a_frame_that_is_not_as_expected_is_left_to_the_arrays(fault: str) -> None:
    # A rectangle, which fits as well when it is turned.
    name = 'rolling_wheel' if 'half a turn' in fault else 'two sines'
    all_frames, values, tracker, plain = copy.deepcopy(before_the_fault(name))
    frames = all_frames[149:]
    frames[1] = FAULTS[fault](frames[1])
    told, estimates = follow_both(frames, values, tracker)
    assert 0 in told
    assert 1 not in told
    # As by one that was never looked ahead with.
    others = [estimate for frame in frames for estimate in plain.add(frame, ORDER)]
    for one, other in zip(estimates, others, strict=True):
        np.testing.assert_array_equal(one.stamp, other.stamp)
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.angle_covariance, other.angle_covariance)


def test_a_marker_seen_for_the_first_time_is_left_to_the_arrays() -> None:
    frames, values = moving('two sines', 1e-3, 180)
    late = 150
    for k in range(late):
        frames[k] = with_marker(frames[k], np.nan)
    told, _ = follow_both(frames, values)
    assert not [k for k in told if k <= late]
    assert [k for k in told if k > late + 5]


def random_bodies(count: int, seed: int) -> Estimate:
    """One instant two times, of bodies whose figures are now lost in their noise, now beyond it."""
    rng = np.random.default_rng(seed)
    shape, arms = (ORDER + 1, 1, count), (ORDER + 1, ORDER, 1, count)
    noise = 10 ** rng.uniform(-4, 1, size=count)
    off = 10 ** rng.uniform(-2, 1, size=count) * noise

    def vectors(*shape: int) -> np.ndarray:
        return rng.normal(size=(*shape, 2)) @ (1, 1j)

    def covariance(*shape: int) -> np.ndarray:
        parts = rng.normal(size=(ORDER + 1, *shape))
        return noise**2 * np.einsum('ij...,ik...->jk...', parts, parts)

    position, angle = vectors(*shape), rng.normal(size=shape)
    angle[1] *= 10 ** rng.uniform(-3, 1, size=count)
    together = Poses(
        position[:, None] + off * vectors(*arms),
        angle[:, None] + off * rng.normal(size=arms),
        covariance(*arms),
        covariance(*arms),
        rng.choice([0.0, 1.0], size=arms) * (off * rng.uniform(size=arms)) ** 2,
        np.zeros(shape),
    )
    apart = position, angle, covariance(*shape), covariance(*shape)
    pin = np.where(rng.random((1, count)) < 0.2, vectors(1, count), np.nan)
    size = 10 ** rng.uniform(-4, 2, size=(1, count))

    def twice(array: np.ndarray) -> np.ndarray:
        return np.repeat(array, 2, axis=-2)

    one = np.ones((2, count))
    names = tuple(f'body{b}' for b in range(count))
    return Estimate(
        np.array([START, START]),
        'world',
        names,
        *map(twice, apart),
        *(twice(size), one, one, one),
        np.full((2, count), '', object),
        pin=twice(pin),
        pin_variance=0.1 * one,
        together=Poses(*map(twice, together)),
    )


@pytest.mark.parametrize('seed', range(3))
def test_figures_are_determined_where_the_arrays_have_them(seed: int) -> None:
    count = 2000
    estimate = random_bodies(count, seed)
    found = [Moving(body_of(estimate, b), 0.0, 0.0) for b in range(count)]
    for figures, arrays in (
        ([moving.rate(1) for moving in found], estimate.rate(1)),
        ([moving.icr for moving in found], estimate.pole(1)),
        ([moving.centrode_curvature for moving in found], estimate.centrode_curvature),
    ):
        known = np.array([figure is not None for figure in figures])
        np.testing.assert_array_equal(known, arrays.determined[0])
        assert known.mean() > 0.1
        told = np.array([figure for figure in figures if figure is not None])
        np.testing.assert_allclose(told, arrays.value[0, known], rtol=1e-9)


@pytest.mark.parametrize(('decides', 'far'), [('coefficients', 3), ('rest', 30)])
@pytest.mark.parametrize('scale', [1e-6, 1.0, 1e3])
def test_room_is_where_no_square_exceeds_its_limit(scale: float, decides: str, far: float) -> None:
    rng = np.random.default_rng(1)
    times = STEP * np.arange(-70, 21)[:, None]
    # An angle and a position, of which the guess of the newest is far off.
    samples = scale * rng.normal(size=(91, 1, 2, 2))
    samples[:, :, 0, 1] = 0.0
    samples[-1] += 5 * scale * np.array([[1, 0], [1, -1]])
    dimensions = np.array((1, 2))

    def squares(*newest: np.ndarray) -> tuple[Projection, np.ndarray]:
        some = np.repeat(samples, len(newest), axis=1)
        some[-1] += newest
        fits = project(np.repeat(times, len(newest), axis=1), some, None, ORDER)
        return fits, squares_of(fits, dimensions)

    unit = np.array([[1.0, 0.0], [1.0, 1.0]])
    fits, _ = squares(0 * unit, unit, -unit)
    # As they would be by another sample, and a little more.
    true = 5 * scale * np.array([[-1, 0], [-1, 1]])
    limits = 1.3 * squares(true)[1]
    limits[:, -1 if decides == 'coefficients' else slice(-1)] *= 1e6
    room = room_of(fits, dimensions, limits.swapaxes(-2, -1))
    held = []
    for _ in range(1500):
        off = scale * rng.uniform(0, far) * (rng.normal(size=2) @ (1, 1j))
        off += true[1] @ (1, 1j)
        newest = np.array([[off.real, 0.0], [off.real, off.imag]])
        _, there = squares(newest)
        within = (there[:, :, 0] <= limits[:, :, 0]).all(axis=(0, 1))
        holds = [room.holds(0, off.real), room.holds(1, off)]
        assert holds == within.tolist()
        held.append(holds)
    assert (np.mean(held, axis=0) > 0.02).all()
    assert (np.mean(held, axis=0) < 0.98).all()


def test_a_rate_that_does_not_come_out_is_not_told() -> None:
    body = body_of(random_bodies(1, 0), 0)
    assert Moving(body, 0.0, 0.0).rate(1) is not None
    assert Moving(body, float('nan'), 0.0).rate(1) is None


def test_a_frame_is_foreseen_once() -> None:
    frames, values = moving('two sines', 1e-3, 160)
    tracker = Tracker(settings_from(values))
    for frame in frames[:-1]:
        tracker.add(frame, ORDER)
    tracker.foresee(ORDER)
    assert tracker.prompt(frames[-1]) is not None
    assert tracker.prompt(frames[-1]) is None
    tracker.foresee(ORDER)
    tracker.add(frames[-1], ORDER)
    assert tracker.prompt(frames[-1]) is None


@pytest.mark.parametrize('name', ['four-bar coupler', 'stop and go'])
def test_frames_told_of_leave_what_is_to_come_as_it_was(name: str) -> None:
    frames, values = moving(name, 1e-3, 500)
    prompt, plain = (Tracker(settings_from(values)) for _ in range(2))
    left_out = 0
    for frame in frames:
        found = prompt.prompt(frame)
        some = prompt.add(frame, ORDER, told=found is not None)
        every = plain.add(frame, ORDER)
        if len(some) < len(every):
            assert found is not None
            left_out += 1
        for one, other in zip(some, every, strict=False):
            np.testing.assert_array_equal(one.position, other.position)
            np.testing.assert_array_equal(one.angle, other.angle)
            np.testing.assert_array_equal(one.position_covariance, other.position_covariance)
            for part, same in zip(one.together or (), other.together or (), strict=True):
                np.testing.assert_array_equal(part, same)
        prompt.settle()
        prompt.foresee(ORDER)
    # Fewer at each start of a motion, which is off what was to be expected.
    assert left_out > 120


@pytest.mark.parametrize('plane', ['xy', 'yz', 'zx'])
def test_prompt_messages_are_those_of_the_table(plane: str) -> None:
    seen = record('four_bar', 200, noise=2e-4, plane=plane)
    tracker = Tracker(settings_from(seen.values))
    outputs = [o for o in result_outputs(seen.values['bodies'], plane) if o.order <= ORDER]
    compared = dict.fromkeys((o.topic for o in outputs if o.prompt), 0)
    for frame in seen.frames:
        found = tracker.prompt(frame)
        for estimate in tracker.add(frame, ORDER):
            for output in outputs:
                if output.prompt is None or found is None:
                    continue
                data = output.prompt(found)
                built = output.build(estimate)[1]
                assert [data] == built or (data is None) == (not built)
                if data is not None:
                    # A header of stamp and frame, then doubles.
                    assert data[:-24] == built[0][:-24]
                    numbers = (np.frombuffer(each[-24:]) for each in (data, built[0]))
                    np.testing.assert_allclose(*numbers, rtol=1e-8, atol=1e-12)
                    compared[output.topic] += 1
        tracker.settle()
        tracker.foresee(ORDER)
    bodies = seen.values['bodies']
    quantities = [*RATE_NAMES[:ORDER], 'icr', 'centrode_curvature']
    assert set(compared) == {f'{body}/{name}' for body in bodies for name in quantities}
    # On pins the ICR has no curve.
    assert [topic for topic, count in compared.items() if not count] == [
        'crank/centrode_curvature',
        'rocker/centrode_curvature',
    ]


# Off its pin for ever, in so many frames that it may be by the next, and in none.
@pytest.mark.parametrize('off', [120, STRIKES - 1, 0])
def test_a_pin_is_told_of_as_by_the_arrays(off: int) -> None:
    seen = record('four_bar', 420, noise=2e-4)
    values = {'bodies': ['crank'], 'crank.markers': seen.values['crank.markers']}
    frames = []
    for k, frame in enumerate(seen.frames):
        drift = 1e-4 * (k - 290) if 300 <= k < 300 + off else 0.0
        frames.append(frame._replace(points=frame.points + [drift, 0.0, 0.0]))
    told, estimates = follow_both(frames, values)
    pinned = [bool(estimate.pinned.any()) for estimate in estimates]
    assert pinned[250]
    assert all(pinned[250:]) == (off < STRIKES)
    if off > STRIKES:
        # It goes while frames are told of at once.
        before = len(frames) - len(estimates) + pinned.index(False, 250)
        assert {before - 1, before, before + 1} & set(told)


def test_a_marker_that_is_sent_no_more_is_left_to_the_arrays() -> None:
    frames, values = moving('two sines', 1e-3, 180)
    frames[150:] = [FAULTS['without a marker'](frame) for frame in frames[150:]]
    told, estimates = follow_both(frames, values)
    assert max(told) == 149
    assert estimates[-1].rate(1).determined.all()


@pytest.mark.parametrize('rate', [50, 1000])
def test_another_rate_is_told_of_again(rate: int) -> None:
    # The motion goes by the stamps: no clock may be found behind them.
    frames, values = moving('two sines', 1e-3, 400)
    values = {**values, 'stamps': 'capture'}
    later = frames[200].stamps[0] + 10**9 // rate * np.arange(200)
    new = [frame._replace(stamps=later[k : k + 1]) for k, frame in enumerate(frames[200:])]
    told, _ = follow_both(frames[:200] + new, values)
    assert 380 in told
