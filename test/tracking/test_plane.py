"""The plane of the motion: any plane, found or given, gives the same; a wrong one is named."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from recordings import START

from kinpole_ros.bags import BagWriter
from kinpole_ros.bags import replay as replay_bag
from kinpole_ros.findings import all_words
from kinpole_ros.mechanism import load_scene, marker_positions
from kinpole_ros.messages import DiagnosticsMaker, body_faults, result_outputs
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.settings import settings_from
from kinpole_ros.tools.record.result_bag import read_record
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.plane import AXES, Plane, plane_along, plane_of
from kinpole_ros.tracking.tracker import Tracker

KITE = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])
NAMES = ('0', '1', '2', '3')
NOISE = 2e-4


def rotation(axis: Any, degrees: float) -> np.ndarray:
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def body(
    seconds: float = 2.0, rate: int = 200, noise: float = NOISE, moves: float = 1.0
) -> np.ndarray:
    """Markers (T, 4, 3) of a body that swings about and goes round in the plane xy."""
    t = np.arange(round(seconds * rate)) / rate
    angle = moves * (0.8 * np.sin(5.0 * t) + 0.3 * np.sin(11.0 * t + 0.5))
    place = moves * (0.15 * np.sin(5.0 * t + 1.1) + 0.1j * np.sin(7.0 * t))
    flat = place[:, None] + (KITE @ (1, 1j)) * np.exp(1j * angle)[:, None]
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    return points + noise * np.random.default_rng(4).normal(size=points.shape)


def frames_of(points: np.ndarray, rate: int = 200) -> MarkerFrames:
    stamps = START + np.rint(np.arange(len(points)) * 1e9 / rate).astype(np.int64)
    return MarkerFrames(stamps, 'world', NAMES[: points.shape[1]], points)


def blocks(frames: MarkerFrames, size: int) -> Iterator[MarkerFrames]:
    for first in range(0, len(frames.stamps), size):
        yield part_of(frames, slice(first, first + size))


def tracked(
    points: np.ndarray, rate: int = 200, order: int | None = 1, block: int = 10**6, **values: Any
) -> tuple[Tracker, list[Estimate]]:
    tracker = Tracker(settings_from({'body.markers': list(NAMES), **values}))
    found = []
    for part in blocks(frames_of(points, rate), block):
        found += tracker.add(part, order)
    return tracker, found


def in_space(found: list[Estimate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, ICR and angular velocity as vectors of space, where the ICR is determined."""
    stamps, icr, rate = [], [], []
    for each in found:
        pole = each.pole(1)
        known = pole.determined[:, 0]
        assert each.plane is not None or not known.any()
        if each.plane is None:
            continue
        stamps.append(each.stamp[known])
        icr.append(each.plane.in_space(pole.value[known, 0], each.height[known, 0]))
        rate.append(each.plane.along_normal(each.rate(1).value[known, 0]))
    return np.concatenate(stamps), np.concatenate(icr), np.concatenate(rate)


# Planes


@pytest.mark.parametrize('name', AXES)
def test_a_normal_along_an_axis_is_that_plane_exactly(name: str) -> None:
    plane = plane_of(name)
    assert plane is not None
    np.testing.assert_array_equal(plane.basis, np.eye(3)[list(AXES[name])])
    given = plane_along(7 * plane.normal)
    assert (given.axes, given.name) == (AXES[name], name)
    np.testing.assert_array_equal(given.basis, plane.basis)


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-200, 200))
@example((0.0, 0.0, -1.0), 0.0)
@example((1e-9, -1e-9, 1.0), 0.0)
@settings(deadline=None)
def test_axes_of_a_plane_are_right_handed_and_follow_its_normal(
    normal: tuple[float, float, float], power: float
) -> None:
    if np.abs(normal).max() < 1e-3:
        return
    way = np.array(normal) / np.linalg.norm(normal)
    plane = plane_along(np.array(normal) * 10.0**power)
    np.testing.assert_allclose(plane.basis @ plane.basis.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.cross(plane.basis[0], plane.basis[1]), plane.normal, atol=1e-14)
    np.testing.assert_allclose(plane.normal, way, atol=1e-14)
    # No axis turns farther than the normal did.
    if way[2] >= 0.5:
        assert plane.basis[0, 0] >= way[2] - 1e-12
        assert plane.basis[1, 1] >= way[2] - 1e-12
    points = np.array([[1.0, -2.0, 3.0], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(plane.in_space(*plane.project(points)), points, atol=1e-14)


# What is found in them


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(1, 179), st.booleans())
@example((1.0, 0.0, 0.0), 90.0, True)
@example((0.3, -0.8, 0.1), 179.0, True)
@settings(max_examples=3, deadline=None)
def test_a_scene_turned_in_space_gives_the_answer_turned(
    axis: tuple[float, float, float], degrees: float, fit: bool
) -> None:
    if np.abs(axis).max() < 1e-2:
        return
    turn = rotation(axis, degrees)
    points = body(1.5, rate=100)
    level = 'fit' if fit else 'xy'
    turned = 'fit' if fit else (3 * turn[:, 2]).tolist()
    stamps, icr, rate = in_space(tracked(points, 100, plane=level)[1])
    assert len(stamps) > (20 if fit else 80)
    same, icr_turned, rate_turned = in_space(tracked(points @ turn.T, 100, plane=turned)[1])
    np.testing.assert_array_equal(same, stamps)
    np.testing.assert_allclose(icr_turned, icr @ turn.T, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(rate_turned, rate @ turn.T, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize('rate, degrees, axis', [(100, 3, (1, 0, 0)), (200, 30, (1, 2, 0))])
def test_a_fitted_plane_is_as_good_as_a_level_one(
    rate: int, degrees: float, axis: tuple[float, float, float]
) -> None:
    points, turn = body(2.5, rate), rotation(axis, degrees)
    tracker, found = tracked(points @ turn.T, rate, plane='fit')
    assert tracker.plane is not None
    off = np.degrees(np.arccos(min(1.0, abs(tracker.plane.normal @ turn[:, 2]))))
    assert off < 0.04
    stamps, icr, _ = in_space(found)
    known, level, _ = in_space(tracked(points, rate)[1])
    exact = body(2.5, rate, noise=1e-9)
    truth, right, _ = in_space(tracked(exact, rate)[1])
    late = stamps[stamps >= START + 10**9]
    errors = []
    for one, values, way in ((stamps, icr, turn), (known, level, np.eye(3))):
        common = np.intersect1d(np.intersect1d(late, one), np.intersect1d(truth, known))
        values = values[np.searchsorted(one, common)]
        errors.append(values - right[np.searchsorted(truth, common)] @ way.T)
    squares = [np.sqrt((error**2).sum(axis=1).mean()) for error in errors]
    assert len(errors[0]) > 0.5 * len(points)
    assert squares[0] < 1.05 * squares[1]


def test_live_and_at_once_a_fitted_plane_gives_the_same() -> None:
    points = body(1.6, 100) @ rotation((1, 1, 0), 25).T
    points[50:53, 1] = np.nan
    tracker, every = tracked(points, 100, 1, plane='fit')
    other, ones = tracked(points, 100, 1, plane='fit', block=1)
    assert tracker.plane is not None and other.plane is not None
    np.testing.assert_allclose(other.plane.basis, tracker.plane.basis, atol=1e-12)
    for one, more in zip(in_space(ones), in_space(every), strict=True):
        assert len(one) > 30
        np.testing.assert_allclose(one, more, rtol=1e-6, atol=1e-9)
    missing = [np.concatenate([each.missing[:, 0] for each in found]) for found in (ones, every)]
    assert missing[0].tolist() == missing[1].tolist()
    assert missing[0][0] == 'plane not known yet'
    assert missing[0][-1] == ''


@pytest.mark.parametrize('motion', ['rest', 'line', 'short'])
def test_a_plane_is_not_fitted_to_a_motion_that_does_not_show_it(motion: str) -> None:
    points = body(2.4, 100, moves={'rest': 0.0, 'line': 0.0, 'short': 2e-3}[motion])
    if motion == 'line':
        points += 0.2 * np.sin(np.arange(len(points)) / 30)[:, None, None] * [0.6, 0.0, 0.8]
    tracker, found = tracked(points, 100, 1, plane='fit')
    assert tracker.plane is None
    assert {str(reason) for each in found for reason in each.missing.ravel()} == {
        'plane not known yet'
    }
    status = diagnosed(tracker, found)[0]
    assert status.level == DiagnosticStatus.WARN
    assert 'set plane: [x, y, z]' in status.message


def test_a_jump_of_the_stamps_has_the_plane_fitted_anew() -> None:
    tracker, _ = tracked(body(1.0) @ rotation((1, 0, 0), 20).T, order=None, plane='fit')
    frames = frames_of(body(1.0) @ rotation((0, 1, 0), 50).T)
    tracker.add(frames._replace(stamps=frames.stamps + 10**12), None)
    assert tracker.plane is not None
    tilt = np.degrees(np.arccos(tracker.plane.normal @ rotation((0, 1, 0), 50)[:, 2]))
    assert tilt < 0.04


def test_odometry_in_an_oblique_plane_turns_about_its_normal() -> None:
    turn = rotation((1, -1, 0), 35)
    tracker, found = tracked(body() @ turn.T, plane=turn[:, 2].tolist())
    (row,) = [row for row in result_outputs(['body'], 'xy') if row.topic == 'body/odom']
    message = deserialize_message(row.build(found[-1])[1][-1], Odometry)
    assert isinstance(tracker.plane, Plane)
    basis = tracker.plane.basis
    q, pose = message.pose.pose.orientation, message.pose.covariance.reshape(6, 6)
    angle = found[-1].angle[0, -1, 0]
    half = np.sin(angle / 2) * basis[2]
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [*half, np.cos(angle / 2)], atol=1e-12)
    np.testing.assert_array_equal(pose, pose.T)
    flat = np.zeros((3, 6))
    flat[:2, :3], flat[2, 3:] = basis[:2], basis[2]
    level, _ = tracked(body() @ turn.T @ basis.T)[1], None
    one = deserialize_message(row.build(level[-1])[1][-1], Odometry).pose.covariance.reshape(6, 6)
    expected = one[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_allclose(flat @ pose @ flat.T, expected, rtol=1e-4, atol=1e-13)
    # What is not measured says so: along the normal, and turns about e1 and e2.
    assert basis[2] @ pose[:3, :3] @ basis[2] > 10
    assert basis[0] @ pose[3:, 3:] @ basis[0] > 10


# What is said of it


def diagnosed(tracker: Tracker, found: list[Estimate]) -> list[DiagnosticStatus]:
    maker = DiagnosticsMaker('kinpole')
    latest = found[-1] if found else None
    return list(maker.make(START, tracker, latest, 1.0, {}).status)


def said(points: np.ndarray, rate: int = 200, **values: Any) -> str:
    """All that diagnostics warn of, of what the parameters name as the body."""
    tracker, found = tracked(points, rate, **values)
    every = diagnosed(tracker, found)
    return '; '.join(each.message for each in every if each.level != DiagnosticStatus.OK)


@pytest.mark.parametrize('rate', [100, 200])
@pytest.mark.parametrize('degrees, axis', [(3, (1, 0, 0)), (10, (1, 2, 0)), (90, (0, 1, 0))])
def test_a_tilt_is_named_within_2_s_with_its_degrees_and_the_normal_to_set(
    degrees: int, axis: tuple[float, float, float], rate: int
) -> None:
    turn = rotation(axis, degrees)
    text = said(body(1.9, rate) @ turn.T, rate)
    assert f'the motion is tilted by {degrees} degrees against the plane xy' in text
    assert 'fix: set plane: fit, or plane: [' in text
    normal = np.array(eval(text.partition('or plane: ')[2].partition(']')[0] + ']'))
    assert np.linalg.norm(np.cross(normal, turn[:, 2])) < 1e-3
    assert 'one link only' not in text
    assert said(body(1.9, rate) @ turn.T, rate, plane=normal.tolist()) == ''


def test_a_line_out_of_the_plane_is_evidence_of_a_tilt_about_one_axis() -> None:
    points = body(1.9, moves=0.0)
    points += (
        0.2 * np.sin(np.arange(len(points)) / 30)[:, None, None] * [np.cos(0.2), 0, np.sin(0.2)]
    )
    assert 'tilted by at least 11 degrees' in said(points)


def ordinary() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    rest, moving = body(2.0, moves=0.0), body(2.0)
    line = rest + 0.2 * np.sin(np.arange(len(rest)) / 30)[:, None, None] * [1.0, 0.0, 0.0]
    ghost = moving.copy()
    ghost[rng.random(ghost.shape[:2]) < 0.01] += 0.5
    noise = rng.normal(size=rest.shape)
    shaken = 1e-3 * np.sin(np.arange(len(rest)) / 9)[:, None, None] * [0.0, 0.0, 1.0]
    return {
        'rest': rest,
        'rest, depth known worse': rest + noise * [0.0, 0.0, 2e-3],
        'level': moving,
        'no heights': moving * [1.0, 1.0, 0.0],
        'different heights': moving + np.array([0.0, 0.1, -0.2, 0.3])[:, None] * [0, 0, 1],
        'noise of 5 mm': moving + 5e-3 * noise,
        'a line in the plane': line,
        'the same, shaken across': line + shaken,
        'some far off': ghost,
        'tilted by 2 deg': moving @ rotation((1, 0, 0), 2).T,
    }


@pytest.mark.parametrize('name', ordinary())
def test_there_is_no_false_alarm(name: str) -> None:
    text = said(ordinary()[name])
    assert 'plane' not in text
    assert 'rigid' not in text


@pytest.mark.parametrize('way', ['wobbles', 'bounces'])
def test_a_body_that_leaves_the_plane_is_told_from_one_that_is_not_rigid(way: str) -> None:
    points = body()
    swing = np.sin(np.arange(len(points)) / 25)
    if way == 'bounces':
        points[..., 2] += 0.01 * swing[:, None]
    else:
        middle = points.mean(axis=1, keepdims=True)
        turns = np.stack([rotation((1, 0, 0), 20 * angle) for angle in swing.tolist()])
        points = middle + (points - middle) @ turns.swapaxes(1, 2)
    text = said(points)
    assert 'leaves the plane by' in text
    assert 'one link only' not in text
    bent = body()
    # Two of them, so that no one marker is to blame.
    bent[:, 1, 0] += 0.02 * swing
    bent[:, 2, 1] -= 0.02 * swing
    text = said(bent)
    assert 'off one rigid body' in text
    assert 'plane' not in text


def test_a_replay_says_the_same_and_plots_are_of_any_plane(tmp_path) -> None:
    from kinpole_ros.messages import MARKER_TYPES, to_message

    turn = rotation((1, 0.5, 0), 30)
    bag, output = tmp_path / 'markers.mcap', tmp_path / 'results.mcap'
    frames = frames_of(body() @ turn.T)
    with BagWriter(bag) as writer:
        for stamp, rows in zip(frames.stamps.tolist(), frames.points, strict=True):
            message = to_message('point_cloud2', stamp, 'world', NAMES, rows)
            assert isinstance(message, MARKER_TYPES['point_cloud2'])
            writer.write('/markers', message, stamp)
    level = settings_from({})
    lines = replay_bag(bag, level).warnings
    assert any('tilted by 30 degrees against the plane xy; fix: set plane' in x for x in lines)
    assert not any('one link only' in line for line in lines)
    fitted = settings_from({'plane': 'fit'})
    result = replay_bag(bag, fitted, output)
    assert not result.warnings
    assert result.space.plane is not None
    np.testing.assert_allclose(result.space.plane.normal, turn[:, 2], atol=7e-4)
    record = read_record(output)
    (link,) = record.bodies
    assert record.along[0].startswith('along [')
    _, found = tracked(frames.points, plane='fit', order=4)
    known = np.concatenate([each.missing[:, 0] == '' for each in found])
    rate = np.concatenate([each.rate(1).value[:, 0] for each in found])[known]
    measured = record.series(link, 'angular_velocity')
    assert measured is not None
    np.testing.assert_allclose(measured.value, rate, rtol=1e-4, atol=1e-6)
    assert record.sizes[link] == pytest.approx(0.227, rel=0.3)


# Units


def test_markers_in_mm_are_named_and_scaled_give_the_same() -> None:
    points = body()
    text = said(1000 * points)
    assert 'likely in mm' in text
    assert 'scale: 0.001' in text
    assert said(1000 * points, scale=0.001) == said(points) == ''
    _, found = tracked(points)
    _, scaled = tracked(1000 * points, scale=0.001)
    for one, other in zip(in_space(scaled), in_space(found), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    'size, scale, words',
    [
        (200.0, 1.0, 'in mm; fix: set scale: 0.001'),
        (25.0, 1.0, 'in mm or cm; fix: set scale: 0.001, or 0.01 for cm'),
        (2e-4, 1e-3, 'in m; fix: set scale: 1.0'),
        (1e9, 1.0, 'see what unit'),
        (0.3, 1.0, ''),
        (0.0, 1.0, ''),
        (float('nan'), 1.0, ''),
    ],
)
def test_a_body_of_an_odd_size_is_likely_in_another_unit(
    size: float, scale: float, words: str
) -> None:
    text = all_words(body_faults.unit_findings('rod', size, scale))
    assert words in text
    assert bool(words) == bool(text)


def test_a_scene_is_held_against_bodies_in_any_plane() -> None:
    from kinpole_ros.linkage.positions import Positions
    from kinpole_ros.linkage.theory import load_theory

    scene = load_scene('four_bar')
    t = np.arange(400) / 200
    motion = scene.motion(t)
    flat = [marker_positions(motion[b], scene.markers[b]) for b in scene.markers]
    points = np.concatenate(flat, axis=1)
    points = np.concatenate((points, 0 * points[..., :1]), axis=-1)
    points += NOISE * np.random.default_rng(0).normal(size=points.shape)
    names = tuple(name for b in scene.markers for name in scene.marker_names[b])
    values = {f'{b}.markers': list(scene.marker_names[b]) for b in scene.markers}
    given = settings_from(
        {'bodies': list(scene.markers), 'scene': 'four_bar', 'plane': 'fit', **values}
    )
    theory = load_theory(given)
    assert theory is not None
    positions = Positions(theory.scene, theory.matches)
    frames = frames_of(points @ rotation((1, 1, 0), 40).T)._replace(identities=names)
    for estimate in Tracker(given).add(frames, 2):
        positions.append(estimate)
    report = positions.report()
    assert report is not None
    assert len(report.joints) == 4
    assert report.findings == []
