"""Markers are matched to bodies by their shape: names that lie, or mean nothing, do no harm."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinpole_ros.mechanism import load_scene, marker_positions
from kinpole_ros.messages import (
    DiagnosticsMaker,
    MarkerReader,
    MessageError,
    read_markers,
    serialize_message,
    to_message,
)
from kinpole_ros.settings import ParameterError, settings_from
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.grouping import group
from kinpole_ros.tracking.identity import Expected, Match, Prediction, match, unpredicted
from kinpole_ros.tracking.tracker import Tracker

SCENE = load_scene('four_bar')
RATE, COUNT, NOISE = 200, 300, 2e-4
T = np.arange(COUNT) / RATE
MOTION = SCENE.motion(T)
BODIES = tuple(SCENE.markers)
EXTRA = {'crank': (0.02, -0.02), 'coupler': None, 'rocker': (0.06, 0.05)}
MARKERS = {
    body: np.vstack((SCENE.markers[body], [EXTRA[body]])) if EXTRA[body] else SCENE.markers[body]
    for body in BODIES
}
NAMES = {body: tuple(f'{body}_{k}' for k in range(len(MARKERS[body]))) for body in BODIES}
ALL = tuple(name for names in NAMES.values() for name in names)
PLACES = {body: [str(ALL.index(name)) for name in NAMES[body]] for body in BODIES}


def recorded(noise: float = NOISE) -> np.ndarray:
    flat = [marker_positions(MOTION[body], MARKERS[body]) for body in BODIES]
    points = np.zeros((COUNT, len(ALL), 3))
    points[..., :2] = np.concatenate(flat, axis=1)
    points[..., :2] += noise * np.random.default_rng(0).normal(size=(COUNT, len(ALL), 2))
    return points


POINTS = recorded()


def stamps(first: int = 0, last: int = COUNT) -> np.ndarray:
    return 10**9 + np.arange(first, last) * (10**9 // RATE)


def named(points: np.ndarray) -> list[MarkerFrames]:
    return [MarkerFrames(stamps(), 'world', ALL, points)]


def cloud(frames: list[np.ndarray]) -> list[MarkerFrames]:
    return [
        MarkerFrames(stamps(k, k + 1), 'world', tuple(map(str, range(len(points)))), points[None])
        for k, points in enumerate(frames)
    ]


def shapes() -> dict[str, list[float]]:
    return {f'{body}.shape': np.ravel(MARKERS[body]).tolist() for body in BODIES}


def track(frames: list[MarkerFrames], **values: Any) -> tuple[Tracker, dict[int, np.ndarray]]:
    """Errors (B,) of the angular velocity over their deviation, and as they are, by stamp."""
    markers = {f'{body}.markers': NAMES[body] for body in BODIES}
    tracker = Tracker(settings_from({'bodies': list(BODIES), **markers, **values}))
    truth = np.stack([MOTION[body].angle[1] for body in BODIES], axis=-1)
    found = {}
    for estimate in tracker.add_parts(frames, 1):
        rate, variance, determined = estimate.rate(1)
        for k, stamp in enumerate(estimate.stamp.tolist()):
            off = rate[k] - truth[(stamp - 10**9) * RATE // 10**9]
            row = np.stack((off, off / np.sqrt(variance[k])))
            found[stamp] = np.where(determined[k], row, np.nan)
    return tracker, found


CLEAN: dict[int, np.ndarray] = track(named(POINTS))[1]
BY_PLACE = {f'{body}.markers': PLACES[body] for body in BODIES}
BY_SHAPE = {f'{body}.markers': [] for body in BODIES} | shapes() | {'marker_identity': 'shape'}


def said(tracker: Tracker) -> str:
    status = DiagnosticsMaker('kinpole').make(10**9, tracker, None, 1.0, {}).status[0]
    return str(status.message)


def held_up(
    found: dict[int, np.ndarray],
    ratio: float = 1.2,
    after: float = 0.4,
    right: dict[int, np.ndarray] = CLEAN,
) -> None:
    """As good as with the `right` names, and no surer than that."""
    late = [s for s in CLEAN if s in found and s > 10**9 * (1 + after)]
    assert len(late) > 0.8 * COUNT * (1 - after * RATE / COUNT) - 21
    off, clean = (np.array([some[s] for s in late]) for some in (found, right))
    assert np.isfinite(off).mean() > 0.98
    rms, usual = (np.sqrt(np.nanmean(some[:, 0] ** 2, axis=0)) for some in (off, clean))
    assert (rms <= ratio * usual).all()
    assert np.nanmean(np.abs(off[:, 1]) > 5) <= 0.01


def exchanged(first: int, last: int | None, i: int = 1, j: int = 5) -> np.ndarray:
    points = POINTS.copy()
    points[first:last, [i, j]] = points[first:last, [j, i]]
    return points


@pytest.mark.parametrize(('first', 'last'), [(3, None), (10, None), (150, None), (150, 155)])
def test_markers_of_two_links_that_are_exchanged_leave_no_trace(
    first: int, last: int | None
) -> None:
    tracker, found = track(named(exchanged(first, last)))
    assert tracker.update_counts()['markers_of_others'] == 2 * ((last or COUNT) - first)
    assert all(np.allclose(found[s], CLEAN[s], rtol=1e-9, equal_nan=True) for s in CLEAN)
    assert "'coupler_1' is 'crank_1' of crank" in said(tracker)


@pytest.mark.parametrize(('first', 'last'), [(0, None), (10, None), (60, 65)])
def test_frame_by_frame_names_are_corrected_as_in_blocks(first: int, last: int | None) -> None:
    points = exchanged(first, last)[:120]
    block = MarkerFrames(stamps(0, 120), 'world', ALL, points)
    singly = [MarkerFrames(stamps(k, k + 1), 'world', ALL, points[k : k + 1]) for k in range(120)]
    tracker, together = track([block])
    other, one_by_one = track(singly)
    assert tracker.update_counts() == other.update_counts()
    assert together.keys() == one_by_one.keys()
    for s, row in together.items():
        assert np.allclose(row, one_by_one[s], rtol=1e-6, equal_nan=True)


@pytest.mark.parametrize('count', [3, 4])
def test_markers_listed_for_another_link_are_found_by_their_motion(count: int) -> None:
    keep = [k for k, name in enumerate(ALL) if int(name[-1]) < count]
    names = [ALL[k] for k in keep]
    i, j = names.index('crank_1'), names.index('coupler_2')
    points = POINTS[:, keep]
    points[:, [i, j]] = points[:, [j, i]]
    lists = {f'{body}.markers': NAMES[body][:count] for body in BODIES}
    frames = [MarkerFrames(stamps(), 'world', tuple(names), points)]
    tracker, found = track(frames, **lists)
    held_up(found, 1.2 if count == 4 else 3.0)
    assert tracker.update_counts()['markers_regrouped'] == 2
    assert "'coupler_2' is listed for coupler but moves with crank" in said(tracker)


def test_two_markers_each_of_which_one_is_exchanged_are_withheld() -> None:
    keep = [0, 1, 4, 5]
    points = POINTS[:, keep][:, [0, 3, 2, 1]]
    frames = [MarkerFrames(stamps(), 'world', ('a', 'b', 'c', 'd'), points)]
    lists = {'bodies': ['one', 'two'], 'one.markers': ['a', 'b'], 'two.markers': ['c', 'd']}
    tracker = Tracker(settings_from(lists))
    found = tracker.add_parts(frames, 1)
    late = found[-1]
    assert not late.rate(1).determined[100:].any()
    assert 'nothing is published of one, two' in said(tracker)


@pytest.mark.parametrize(
    ('listed', 'found'),
    [
        ([(0, 1, 10), (4, 5, 2), (8, 9, 6)], [(0, 1, 2), (4, 5, 6), (8, 9, 10)]),
        ([(0, 1, 5), (4, 2, 10), (8, 9, 6)], None),
        ([(0, 4), (1, 5), (8, 9)], None),
    ],
    ids=['three go round', 'a body without two of its own', 'pairs of two'],
)
def test_markers_listed_for_other_links_are_put_right_or_withheld(
    listed: list[tuple[int, ...]], found: list[tuple[int, ...]] | None
) -> None:
    shape = np.array([0.1, 0.12j, -0.09 - 0.03j, 0.05 - 0.08j])
    t = np.arange(100)[:, None] / 50
    flat = np.concatenate(
        [b + np.exp(1j * (1 + b) * t) * shape * (1 + 0.2 * b) for b in range(3)], axis=1
    )
    order, confused = group(flat[:, np.array(listed)], np.ones(3, bool))
    if found is None:
        assert order is None
        assert confused
    else:
        assert order is not None
        assert [set(row) for row in np.ravel(listed)[order]] == [set(row) for row in found]
        assert not confused


def test_markers_that_come_back_under_new_names_are_taken_until_the_old_ones_return() -> None:
    gone = [0, 6]
    keep = [k for k in range(len(ALL)) if k not in gone]
    lost = tuple(ALL[k] for k in keep)
    back = lost + ('new_a', 'new_b')
    order = keep + gone
    frames = [
        MarkerFrames(stamps(0, 100), 'world', ALL, POINTS[:100]),
        MarkerFrames(stamps(100, 160), 'world', lost, POINTS[100:160, keep]),
        MarkerFrames(stamps(160, 240), 'world', back, POINTS[160:240][:, order]),
        MarkerFrames(stamps(240, COUNT), 'world', ALL, POINTS[240:]),
    ]
    tracker, found = track(frames)
    assert tracker.update_counts()['markers_renamed'] == 2 * 80
    assert tracker.update_counts()['markers_not_seen'] == 2 * 60
    assert "'new_a' is 'crank_0' of crank" in said(tracker)
    late = [s for s in CLEAN if s >= 10**9 + 270 * (10**9 // RATE)]
    assert all(np.allclose(found[s][0], CLEAN[s][0], atol=2e-3) for s in late)
    held_up(found, 1.3)


def absent(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    return points[rng.random(len(points)) > 0.05]


def ghost(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    if rng.random() < 0.5:
        return points
    return np.insert(points, rng.integers(len(points) + 1), rng.uniform(-0.2, 0.5, 3), axis=0)


def shuffled(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    return rng.permutation(points)


def names_of(frames: list[MarkerFrames]) -> np.ndarray:
    """The points of the bodies that are left in frames, NaN where one is not."""
    points = POINTS.copy()
    for row, frame in zip(points, frames, strict=True):
        row[~(row[:, None] == frame.points[0]).all(axis=-1).any(axis=1)] = np.nan
    return points


@pytest.mark.parametrize('spoil', [absent, ghost])
@pytest.mark.parametrize('given_shapes', [False, True])
def test_points_without_names_may_be_missing_or_added(
    spoil: Callable[[np.random.Generator, np.ndarray], np.ndarray], given_shapes: bool
) -> None:
    rng = np.random.default_rng(4)
    frames = cloud([spoil(rng, points) for points in POINTS])
    tracker, found = track(frames, **BY_PLACE, **(shapes() if given_shapes else {}))
    held_up(found, right=track(named(names_of(frames)))[1])
    counts = sum(frame.points.shape[1] != len(ALL) for frame in frames)
    assert tracker.update_counts()['frames_by_shape'] == pytest.approx(counts, abs=3)
    assert f'did not have {len(ALL)} points' in said(tracker)


def test_points_without_names_may_be_missing_while_the_plane_is_found() -> None:
    """By then nothing can be matched by shape: only frames with all points tell of the plane."""
    rng = np.random.default_rng(4)
    flat = [absent(rng, points) for points in POINTS]
    angle = np.deg2rad(30)
    turn = np.array(
        [(np.cos(angle), 0, np.sin(angle)), (0, 1, 0), (-np.sin(angle), 0, np.cos(angle))]
    )
    tracker, found = track(cloud([points @ turn.T for points in flat]), **BY_PLACE, plane='fit')
    assert tracker.plane is not None
    held_up(found, after=0.9, right=track(named(names_of(cloud(flat))))[1])


def test_shapes_learned_in_order_hold_when_points_come_in_any() -> None:
    rng = np.random.default_rng(4)
    frames = [points if k < 25 else shuffled(rng, points) for k, points in enumerate(POINTS)]
    tracker, found = track(cloud(frames), **BY_PLACE, marker_identity='shape')
    assert all(np.allclose(found[s], CLEAN[s], rtol=1e-6, equal_nan=True) for s in CLEAN)
    assert said(tracker) == 'receiving markers'


def test_any_order_without_shapes_is_withheld_and_named() -> None:
    rng = np.random.default_rng(4)
    frames = cloud([shuffled(rng, points) for points in POINTS[:120]])
    tracker, found = track(frames, **BY_PLACE, marker_identity='shape')
    assert not any(np.isfinite(row).any() for row in found.values())
    assert 'fix: give <body>.shape for each; kinpole discover finds it' in said(tracker)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_the_order_of_points_changes_nothing(seed: int, hidden: bool) -> None:
    rng = np.random.default_rng(1)
    frames = [absent(rng, points) if hidden else points for points in POINTS[:80]]
    rng = np.random.default_rng(seed)
    tracker, found = track(cloud(frames), **BY_SHAPE)
    other, again = track(cloud([shuffled(rng, points) for points in frames]), **BY_SHAPE)
    assert found.keys() == again.keys()
    assert all(np.allclose(found[s], again[s], rtol=1e-9, equal_nan=True) for s in found)
    assert tracker.update_counts() == other.update_counts()


def test_given_shapes_hold_from_the_first_frame_on_and_frame_by_frame_as_in_blocks() -> None:
    rng = np.random.default_rng(2)
    points = np.array([shuffled(rng, one) for one in POINTS])
    names = tuple(map(str, range(len(ALL))))
    _, together = track([MarkerFrames(stamps(), 'world', names, points)], **BY_SHAPE)
    tracker, one_by_one = track(cloud(list(points)), **BY_SHAPE)
    held_up(together, after=0.15)
    assert together.keys() == one_by_one.keys()
    for s, row in together.items():
        assert np.allclose(row, one_by_one[s], rtol=1e-6, atol=1e-12, equal_nan=True)
    # Poses are those of the frame in which the shape is given.
    motion = MOTION['coupler']
    (estimate,) = tracker.add(
        MarkerFrames(stamps(COUNT, COUNT + 1), 'world', names, points[-1:]), 1
    )
    at = (int(estimate.stamp[0]) - 10**9) * RATE // 10**9
    off = estimate.angle[0, 0, 1] - motion.angle[0][at]
    assert np.exp(1j * off) == pytest.approx(1, abs=5e-3)


def test_a_mirrored_shape_does_not_fit_and_is_named() -> None:
    mirrored = MARKERS['rocker'] * (1, -1)
    values = BY_SHAPE | {'rocker.shape': mirrored.ravel().tolist()}
    tracker, found = track(cloud(list(POINTS[:100])), **values)
    late = np.array([found[s][0] for s in found][40:])
    assert np.isnan(late[:, 2]).all()
    assert np.isfinite(late[:, :2]).all()
    assert 'the markers of rocker are the mirror image of rocker.shape' in said(tracker)


def test_a_shape_that_no_points_have_is_named() -> None:
    values = BY_SHAPE | {'rocker.shape': (2 * MARKERS['rocker']).ravel().tolist()}
    tracker, _ = track(cloud(list(POINTS[:60])), **values)
    assert 'no points have the shape rocker.shape' in said(tracker)


def test_by_shape_messages_are_read_by_place() -> None:
    points = POINTS[0]
    for kind in ('marker_array', 'point_cloud2', 'pose_array', 'marker'):
        message = to_message(kind, 10**9, 'world', ALL, points)
        by_shape, by_place = (read_markers(message, way) for way in ('shape', 'index'))
        assert by_shape.identities == by_place.identities == tuple(map(str, range(len(ALL))))
        (read,) = MarkerReader(kind, 'shape').read([serialize_message(message)])
        assert not isinstance(read, MessageError)
        assert read.identities == by_place.identities


# --- matching by itself --------------------------------------------------------------------------

KITE = np.array([0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j])
BRICK = np.array([0.1 + 0.05j, -0.1 + 0.05j, -0.1 - 0.05j, 0.1 - 0.05j])


def expected(count: int, width: int = 4, angle: float | None = None) -> Expected:
    """Nothing is known of so many bodies but the angle, and names mean nothing."""
    known = unpredicted(count)
    if angle is not None:
        one = np.full(count, 0.1)
        known = Prediction(np.full((count, 1), angle), one, np.zeros((count, 1), complex), one)
    return Expected(known, np.full((count, width), -1), np.zeros(count, bool))


def matched(points: np.ndarray, known: np.ndarray, angle: float | None = None) -> Match:
    count, width = known.shape
    return match(points, known, np.full(count, 1e-3), expected(count, width, angle))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_bodies_are_found_among_other_points_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = np.array([KITE, 1.3 * KITE.conj()])
    turn, place = np.exp(2j * np.pi * rng.random(2)), rng.normal(size=(2, 2)) @ (1, 1j)
    points = (place[:, None] + turn[:, None] * shape).ravel()
    points = np.append(points, rng.normal(size=(3, 2)) @ (5, 5j))
    order = rng.permutation(len(points))
    found = matched(points[order], shape)
    assert np.array_equal(order[found.indices.ravel()], np.arange(8))
    assert np.allclose(found.turn, turn)


def test_what_fits_in_several_ways_is_left_out_unless_the_last_pose_tells() -> None:
    points = 0.3 + np.exp(0.2j) * BRICK
    found = matched(points, BRICK[None])
    assert found.uncertain.all()
    assert (found.indices == -1).all()
    found = matched(points - 0.3, BRICK[None], 0.1)
    assert not found.uncertain.any()
    assert found.indices.tolist() == [[0, 1, 2, 3]]


def test_of_two_turns_that_fit_the_one_that_leaves_only_noise_is_taken() -> None:
    # Turned by half a turn, its markers are up to 10 mm off, less than the limit.
    shape = BRICK + np.array([0.01, 0, 0.01j, 0])
    limit, known = np.full(1, 0.02), expected(1)._replace(variance=(2e-4) ** 2)
    points = 0.3 + np.exp(0.2j) * shape
    found = match(points, shape[None], limit, expected(1))
    assert found.uncertain.all()
    assert found.variance[0] < 1e-30
    found = match(points, shape[None], limit, known)
    assert found.indices.tolist() == [[0, 1, 2, 3]]
    # Markers halfway between the two turns.
    halfway = (shape - shape[[2, 3, 0, 1]]) / 2
    assert match(halfway, shape[None], limit, known).uncertain.all()


def test_two_bodies_alike_are_not_guessed() -> None:
    points = np.concatenate((KITE, 1 + KITE * 1j))
    assert matched(points, np.array([KITE, KITE])).uncertain.all()


def test_pins_on_the_ground_tell_bodies_of_one_shape_apart() -> None:
    points = np.concatenate((KITE, 1 + KITE * 1j))
    pins = np.array([[0.2, 1 + 0.2j], [complex(np.nan, np.nan)] * 2])
    known = expected(2)._replace(pins=pins)
    found = match(points, np.array([KITE, KITE]), np.full(2, 1e-3), known)
    assert found.indices.tolist() == [[4, 5, 6, 7], [0, 1, 2, 3]]
    # A pin that no way keeps, as of cameras that were moved, tells nothing.
    moved = known._replace(pins=pins + 3)
    assert match(points, np.array([KITE, KITE]), np.full(2, 1e-3), moved).uncertain.all()


def test_a_mirrored_body_is_not_found() -> None:
    assert (matched(KITE.conj(), KITE[None]).indices == -1).all()


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        ({'marker_identity': 'shape'}, 'parameter body.shape is missing'),
        ({'body.shape': [0, 0, 1, 0]}, 'parameter body.markers is missing'),
        ({'body.shape': [0, 0, 1, 0], 'body.markers': ['a', 'b', 'c']}, 'x and y of 2 markers'),
        ({'bodies': ['a'], 'b.shape': [0, 0, 1, 0]}, 'b is not among the bodies a'),
        ({'body.pin': [0, 0, 1, 0]}, 'frame of body.shape, which is missing'),
        ({'body.shape': [0, 0, 1, 0], 'body.pin': [0, 0, 1]}, 'body.pin is .* four numbers'),
    ],
)
def test_shapes_are_checked_with_the_other_parameters(values: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        settings_from(values)


def test_bodies_of_one_shape_keep_their_names_where_a_marker_is_off() -> None:
    shape = np.array([0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j])
    points = np.concatenate((shape, 3 + 1j * shape))
    points[0] += 0.03
    known = expected(2)._replace(named=np.arange(8).reshape(2, 4))
    found = match(points, np.stack((shape, shape)), np.full(2, 0.01), known)
    assert found.indices.tolist() == [[-1, 1, 2, 3], [4, 5, 6, 7]]
