"""Result messages: each says what the estimate holds, in every plane, and nothing that is not."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import diagnostic_msgs.msg
import numpy as np
import pytest
from conftest import WITH_TF, numbers, read_back, ros_class, stamp_of
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

import kinpole_ros
from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.messages import (
    TF,
    DiagnosticsMaker,
    Output,
    deletion_of_all,
    joint_build,
    live_outputs,
    outputs_of,
    result_outputs,
    type_name,
)
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.plane import plane_along
from kinpole_ros.tracking.reasons import REASONS
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, Vectors

# Along the two axes of each plane, and its normal.
PLANES = {plane: np.roll(np.eye(3), shift, axis=0) for plane, shift in (('xy', 0), ('yz', -1))}
PLANES['zx'] = np.roll(np.eye(3), -2, axis=0)
BODIES = ('crank', 'coupler')
# What a message about the ground frame of the markers says of it.
FRAME = 'rig'
STEP = 10_000_000
NOT_SEEN = REASONS['NOT_SEEN']


def estimate(
    stamp: int = 5_000_000_000, order: int = 4, missing: tuple[int, ...] = (0, 0), spin: float = 1
) -> Estimate:
    """Two bodies in general motion; `spin` 0 stops their turning."""
    generator = np.random.default_rng(3)
    parts = generator.normal(size=(2, 5, 2))
    position = parts[0] + 1j * parts[1]
    position[0] += 0.05 * stamp * 1e-9
    angle = generator.normal(size=(5, 2)) + [[0], [2], [0], [0], [0]]
    angle[1:] *= spin
    angle[0] += 0.3 * stamp * 1e-9
    mix = generator.normal(size=(2, 2, 5, 5)) * 1e-4
    covariance = np.einsum('sbik,sbjk->sijb', mix, mix)
    gone = np.array([bool(reason) for reason in missing])
    position[:, gone] = angle[:, gone] = np.nan
    covariance[..., gone] = np.nan
    arrays = {
        'stamp': np.int64(stamp),
        'position': position[: order + 1],
        'angle': angle[: order + 1],
        'position_covariance': covariance[0, : order + 1, : order + 1],
        'angle_covariance': covariance[1, : order + 1, : order + 1],
        'size': np.array([0.5, 0.8]),
        'height': np.where(gone, np.nan, [0.25, -0.125]),
        'span': np.array([0.2, 0.2]),
        'degree': np.array([4.0, 4.0]),
        'reason': np.array(missing, np.uint8),
    }
    return Estimate.of_arrays(arrays, FRAME, BODIES)


def stacked(instants: Sequence[Estimate]) -> Estimate:
    """The instants of one estimate, from each as an estimate of its own."""
    axes = {
        **dict.fromkeys(('stamp', 'size', 'height', 'span', 'degree', 'reason'), 0),
        **dict.fromkeys(('position', 'angle'), 1),
        **dict.fromkeys(('position_covariance', 'angle_covariance'), 2),
    }
    arrays = {
        name: np.stack([getattr(now, name) for now in instants], axis)
        for name, axis in axes.items()
    }
    first = instants[0]
    return Estimate.of_arrays(arrays, first.frame_id, first.bodies, first.run)


def decoded(row: Output) -> Callable[[Estimate], Any]:
    """What a row makes of one instant, as a message; None for nothing."""

    def build(now: Estimate) -> Any:
        at, made = row.build(stacked([now]))
        assert at == [0] * len(made)
        if not made:
            return None
        [data] = made
        return read_back(data, type_name(row.message_type))

    return build


def rows(plane: str = 'xy') -> dict[str, Output]:
    """The table, of which each row makes a message of an instant; /tf has one of each body."""
    table = result_outputs(BODIES, plane)
    return {row.topic: row._replace(build=decoded(row)) for row in table if row.topic != TF}


def placed(plane: str, value: complex, height: float = 0.0) -> np.ndarray:
    first, second, normal = PLANES[plane]
    return np.asarray(value.real * first + value.imag * second + height * normal)


def xyz(message: Any) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def turned(q: Any, vector: np.ndarray) -> np.ndarray:
    """A vector turned by a quaternion."""
    axis = np.array([q.x, q.y, q.z])
    return np.asarray(vector + 2 * np.cross(axis, q.w * vector + np.cross(axis, vector)))


def test_the_topics_are_those_of_the_interface() -> None:
    one = ['odom', *RATE_NAMES, *POLE_NAMES, *(f'{pole}/with_covariance' for pole in POLE_NAMES)]
    alone = [*RATE_NAMES, 'icr_velocity', 'centrode_curvature', 'inflection_circle']
    one += ['icr_velocity', 'centrode_curvature', 'inflection_circle']
    one += ['centrode/fixed', 'centrode/moving', 'event']
    one += [f'{topic}/deviation' for topic in alone]
    pair = ['coupler/wrt/crank/icr', 'coupler/wrt/crank/angular_velocity']
    pair += [f'{topic}/deviation' for topic in pair]
    expected = [f'{body}/{topic}' for body in BODIES for topic in one] + pair
    expected += ['state', 'visualization', '/tf']
    assert sorted(row.topic for row in result_outputs(BODIES, 'xy')) == sorted(expected)


def test_standard_topics_are_those_that_people_read() -> None:
    """Of two bodies 26 topics, of eight 92: 56 and 308 were more than anybody looked through."""
    one = ['odom', *RATE_NAMES[:3], 'icr', 'icr/with_covariance', 'iap/with_covariance']
    one += ['icr_velocity', 'centrode_curvature', 'inflection_circle', 'event']
    expected = [f'{body}/{topic}' for body in BODIES for topic in one]
    expected += ['state', 'visualization', '/tf', 'view']
    settings = Settings(bodies=dict.fromkeys(BODIES, ('0', '1')))
    assert sorted(row.topic for row in live_outputs(settings, None)) == sorted(expected)
    eight = Settings(bodies={f'b{k}': (str(k), '9') for k in range(8)})
    assert len(live_outputs(eight, None)) == 92


def test_standard_topics_have_the_pairs_that_a_joint_joins() -> None:
    bodies = dict.fromkeys(('a', 'b', 'c'), ('0', '1'))
    joints = {'knee': ('c', 'b'), 'base': ('ground', 'a')}
    topics = {row.topic for row in outputs_of(Settings(bodies=bodies, joints=joints), None)}
    found = {topic for topic in topics if '/wrt/' in topic}
    assert found == {'c/wrt/b/icr', 'c/wrt/b/angular_velocity'}
    assert 'joint_states' in topics and 'joint_states/deviation' not in topics


def test_what_another_package_registers_is_a_topic_with_its_deviation() -> None:
    def slip(estimate: Estimate) -> Vectors:
        return estimate.icr_velocity

    class Registered:
        def quantities(self, bodies: Sequence[str]) -> list[RegisteredQuantity]:
            assert tuple(bodies) == BODIES
            return [RegisteredQuantity('crank/slip', 'vector', 2, 'm/s', slip)]

        def connected_bodies(self) -> list[tuple[str, str]]:
            return [('crank', 'coupler')]

    settings = Settings(bodies=dict.fromkeys(BODIES, ('0', '1')))
    plain, full = (
        {row.topic: row for row in outputs_of(replace(settings, topics=topics), Registered())}
        for topics in ('standard', 'all')
    )
    assert {'crank/slip', 'coupler/wrt/crank/icr'} <= plain.keys()
    assert 'crank/slip/deviation' in full.keys() - plain.keys()
    row = plain['crank/slip']
    assert (row.order, row.unit) == (2, 'm/s')
    assert ros_class(row.message_type) is Vector3Stamped


def test_topics_grow_with_the_number_of_bodies_beyond_those_whose_pairs_are_measured() -> None:
    """300 bodies made 180,000 topics of their 44,850 pairs."""
    topics = {
        count: [output.topic for output in result_outputs([f'b{k}' for k in range(count)], 'xy')]
        for count in (20, 100, 200, 300)
    }
    assert len(topics[300]) - len(topics[200]) == len(topics[200]) - len(topics[100])
    assert not any('/wrt/' in topic for topic in topics[300])
    assert sum(topic.endswith('/icr') and '/wrt/' in topic for topic in topics[20]) == 190


@pytest.mark.parametrize(('count', 'pairs'), [(20, 190), (21, 0)])
def test_track_measures_all_pairs_of_up_to_20_bodies(count: int, pairs: int) -> None:
    time = np.arange(40) / 100
    shape = np.array([[0.1, 0.0], [-0.1, 0.05], [0.0, -0.1]])
    points = np.tile(shape, (40, count, 1))
    points[..., 0] += np.sin(3 * time)[:, None]
    points += 1e-4 * np.random.default_rng(1).normal(size=points.shape)
    bodies = {f'b{k}': range(3 * k, 3 * k + 3) for k in range(count)}
    stamps = 10**9 + (np.arange(40) * STEP)
    found = kinpole_ros.track(points, stamps, bodies, window=0.1, lag=0.05, derivative_order=1)
    assert len(found.pairs) == pairs


def test_pairs_name_the_later_body_first() -> None:
    topics = {row.topic for row in result_outputs(('a', 'b', 'c'), 'xy')}
    found = {topic for topic in topics if '/wrt/' in topic and topic.endswith('/icr')}
    assert found == {'b/wrt/a/icr', 'c/wrt/a/icr', 'c/wrt/b/icr'}


@pytest.mark.parametrize('plane', PLANES)
def test_points_are_in_the_plane_at_the_height_of_the_markers(plane: str) -> None:
    now = estimate()
    for b, body in enumerate(BODIES):
        for order, name in enumerate(POLE_NAMES, 1):
            message = rows(plane)[f'{body}/{name}'].build(now)
            assert isinstance(message, PointStamped)
            expected = placed(plane, now.pole(order).value[b], now.height[b])
            np.testing.assert_array_equal(xyz(message.point), expected)
        message = rows(plane)[f'{body}/inflection_circle'].build(now)
        expected = placed(plane, now.inflection_circle.value[b], now.height[b])
        np.testing.assert_array_equal(xyz(message.point), expected)
    message = rows(plane)['coupler/wrt/crank/icr'].build(now)
    expected = placed(plane, now.relative_icr.value[0], now.height[0])
    np.testing.assert_array_equal(xyz(message.point), expected)


@pytest.mark.parametrize('plane', PLANES)
def test_rates_and_curvature_are_along_the_normal(plane: str) -> None:
    now = estimate()
    for b, body in enumerate(BODIES):
        values = {name: now.rate(k).value[b] for k, name in enumerate(RATE_NAMES, 1)}
        values['centrode_curvature'] = now.centrode_curvature.value[b]
        for name, value in values.items():
            message = rows(plane)[f'{body}/{name}'].build(now)
            assert isinstance(message, Vector3Stamped)
            np.testing.assert_array_equal(xyz(message.vector), placed(plane, 0j, value))
    message = rows(plane)['coupler/wrt/crank/angular_velocity'].build(now)
    expected = placed(plane, 0j, now.relative_rate.value[0])
    np.testing.assert_array_equal(xyz(message.vector), expected)


@pytest.mark.parametrize('plane', PLANES)
def test_icr_velocity_is_a_free_vector_of_the_plane(plane: str) -> None:
    now = estimate()
    message = rows(plane)['coupler/icr_velocity'].build(now)
    expected = placed(plane, now.icr_velocity.value[1])
    np.testing.assert_array_equal(xyz(message.vector), expected)


@pytest.mark.parametrize('plane', PLANES)
def test_covariance_of_a_pole_fills_its_place_in_the_matrix_and_no_other(plane: str) -> None:
    now = estimate()
    first, second, _ = PLANES[plane]
    basis = np.zeros((2, 6))
    basis[0, :3], basis[1, :3] = first, second
    for order, name in enumerate(POLE_NAMES, 1):
        message = rows(plane)[f'coupler/{name}/with_covariance'].build(now)
        assert isinstance(message, PoseWithCovarianceStamped)
        covariance = now.pole(order).covariance[1]
        expected = basis.T @ covariance @ basis
        assert covariance[0, 0] != covariance[1, 1]
        assert covariance[0, 1] != 0
        found = message.pose.covariance.reshape(6, 6)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)
        point = rows(plane)[f'coupler/{name}'].build(now).point
        np.testing.assert_array_equal(xyz(message.pose.pose.position), xyz(point))
        assert message.pose.pose.orientation.w == 1.0


@pytest.mark.parametrize('plane', PLANES)
def test_odometry_turns_the_body_about_the_normal_and_has_its_twist_in_the_body(
    plane: str,
) -> None:
    now = estimate()
    first, second, normal = PLANES[plane]
    for b, body in enumerate(BODIES):
        message = rows(plane)[f'{body}/odom'].build(now)
        assert isinstance(message, Odometry)
        assert message.child_frame_id == body
        pose, twist = message.pose.pose, message.twist.twist
        expected = placed(plane, now.position[0, b], now.height[b])
        np.testing.assert_array_equal(xyz(pose.position), expected)
        angle = now.angle[0, b]
        axis = np.cos(angle) * first + np.sin(angle) * second
        np.testing.assert_allclose(turned(pose.orientation, first), axis, atol=1e-15)
        np.testing.assert_allclose(turned(pose.orientation, normal), normal, atol=1e-15)
        velocity = turned(pose.orientation, xyz(twist.linear))
        expected = placed(plane, now.position[1, b])
        np.testing.assert_allclose(velocity, expected, rtol=1e-12, atol=1e-15)
        expected = placed(plane, 0j, now.angle[1, b])
        np.testing.assert_array_equal(xyz(twist.angular), expected)


@pytest.mark.parametrize('plane', PLANES)
def test_odometry_says_how_well_the_plane_is_known_and_that_the_rest_is_not(plane: str) -> None:
    """Its covariance is that of the angle too: in the body, a velocity turns with it."""
    now = estimate()
    now.reference = np.array([0.4 - 0.3j, -0.2 + 0.9j])
    first, second, normal = (int(axis.argmax()) for axis in PLANES[plane])
    known, unknown = [first, second, 3 + normal], [normal, 3 + first, 3 + second]
    build = rows(plane)['coupler/odom'].build

    def told(array: np.ndarray, order: int, step: complex) -> tuple[np.ndarray, np.ndarray]:
        """Pose and twist in the plane where one of the derivatives is off by a step."""
        array[order, 1] += step
        message = build(now)
        array[order, 1] -= step
        pose, twist = message.pose.pose, message.twist.twist
        turn = 2 * np.arctan2(xyz(pose.orientation)[normal], pose.orientation.w)
        return (
            np.array([xyz(pose.position)[first], xyz(pose.position)[second], turn]),
            np.array([xyz(twist.linear)[first], xyz(twist.linear)[second],
                      xyz(twist.angular)[normal]]),
        )  # fmt: skip

    message = build(now)
    for order, part in enumerate((message.pose, message.twist)):
        slopes = [
            (told(array, k, step * 1e-6)[order] - told(array, k, -step * 1e-6)[order]) / 2e-6
            for array, k, step in (
                (now.position, order, 1),
                (now.position, order, 1j),
                (now.angle, 0, 1),
                (now.angle, 1, 1),
            )
        ]
        spread = np.zeros((4, 4))
        spread[0, 0] = spread[1, 1] = now.position_covariance[order, order, 1]
        spread[2:, 2:] = now.angle_covariance[:2, :2, 1]
        expected = np.array(slopes).T @ spread @ np.array(slopes)
        matrix = part.covariance.reshape(6, 6)
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0
        block = matrix[np.ix_(known, known)]
        np.testing.assert_allclose(block, expected, rtol=1e-6, atol=1e-12)
        assert (np.diag(matrix)[unknown] >= 1e6).all()
        assert np.count_nonzero(matrix) == np.count_nonzero(block) + 3


def test_every_message_has_the_stamp_and_frame_of_its_estimate() -> None:
    now = estimate(stamp=1_700_000_000_123_456_789)
    for topic, row in rows().items():
        if row.of_events:
            continue
        message: Any = row.build(now)
        assert type(message).__name__ == row.message_type.__name__, topic
        assert stamp_of(message) == now.stamp, topic
        array = isinstance(message, MarkerArray)
        headers = [marker.header for marker in message.markers] if array else [message.header]
        # The moving centrode is drawn on the body.
        frame = 'crank' if topic == 'crank/centrode/moving' else FRAME
        frame = 'coupler' if topic == 'coupler/centrode/moving' else frame
        assert {header.frame_id for header in headers} == {frame}, topic


def test_no_row_needs_a_higher_derivative_than_it_says() -> None:
    for topic, row in rows().items():
        lean = row.build(estimate(order=row.order))
        assert lean == rows()[topic].build(estimate()), topic


def test_rows_say_the_least_order_they_need() -> None:
    orders = {row.topic.removeprefix('crank/'): row.order for row in rows().values()}
    assert orders['odom'] == orders['angular_velocity'] == orders['icr'] == 1
    assert orders['iap'] == orders['angular_acceleration'] == orders['icr_velocity'] == 2
    assert orders['centrode_curvature'] == orders['ijp/with_covariance'] == 3
    assert orders['isp'] == orders['angular_snap'] == 4
    assert orders['coupler/wrt/crank/icr'] == orders['centrode/moving'] == 1


def test_nothing_is_said_of_a_body_that_is_not_known() -> None:
    now = estimate(missing=(0, NOT_SEEN))
    for topic, row in rows().items():
        message = row.build(now)
        if topic.startswith('coupler'):
            assert message is None, topic
        else:
            assert np.isfinite(list(numbers(message))).all(), topic


def test_a_body_that_does_not_turn_has_rates_and_pose_but_no_poles() -> None:
    now = estimate(spin=0)
    for topic, row in rows().items():
        has = topic.endswith(('odom', 'state', 'visualization')) or 'angular' in topic
        assert (row.build(now) is not None) == has, topic


# What is drawn


def test_markers_keep_their_names_and_are_deleted_when_gone() -> None:
    build = rows()['visualization'].build
    start = 5_000_000_000
    ways: list[dict[str, Any]] = [{}, {}, {'missing': (0, NOT_SEEN)}, {'spin': 0}, {}]
    arrays = [build(estimate(start + 10 * STEP * k, **way)) for k, way in enumerate(ways)]
    names = [[(marker.ns, marker.id) for marker in array.markers] for array in arrays]
    assert len(set(names[0])) == len(names[0])
    assert all(listed == names[0] for listed in names)
    for array, way in zip(arrays, ways, strict=True):
        assert np.isfinite(list(numbers(array))).all()
        for marker in array.markers:
            drawn = marker.action == Marker.ADD
            assert drawn or marker.action == Marker.DELETE
            if marker.ns == 'coupler/icr':
                assert drawn == (not way)
            if marker.ns.startswith('coupler') and 'missing' in way:
                assert not drawn
            if drawn:
                # RViz shows nothing of what has no size, no color or a quaternion of zeros.
                assert marker.scale.x > 0
                assert marker.color.a > 0
                q = marker.pose.orientation
                assert np.linalg.norm([q.x, q.y, q.z, q.w]) == pytest.approx(1)
                # Goes by itself when the node does.
                assert marker.lifetime.sec > 0


def test_all_that_was_drawn_is_taken_away_by_one_marker() -> None:
    array = deserialize_message(deletion_of_all(5_000_000_006, FRAME), MarkerArray)
    assert [marker.action for marker in array.markers] == [Marker.DELETEALL]
    assert stamp_of(array) == 5_000_000_006
    assert array.markers[0].header.frame_id == FRAME


def test_the_drawn_poles_are_the_published_ones_and_the_centrodes_touch_there() -> None:
    table = rows('zx')
    arrays = []
    for k in range(21):
        now = estimate(5_000_000_000 + STEP * k)
        arrays += [built for built in [table['visualization'].build(now)] if built]
    array = arrays[-1]
    drawn = {marker.ns: marker for marker in array.markers}
    assert stamp_of(array) == now.stamp
    icr = xyz(table['crank/icr'].build(now).point)
    np.testing.assert_array_equal(xyz(drawn['crank/icr'].pose.position), icr)
    iap = xyz(table['crank/iap'].build(now).point)
    np.testing.assert_array_equal(xyz(drawn['crank/iap'].pose.position), iap)
    for name in ('crank/centrode_fixed', 'crank/centrode_moving'):
        np.testing.assert_allclose(xyz(drawn[name].points[-1]), icr, rtol=1e-12)
    tail, head = (xyz(point) for point in drawn['crank/icr_velocity'].points)
    velocity = xyz(table['crank/icr_velocity'].build(now).vector)
    np.testing.assert_array_equal(tail, icr)
    np.testing.assert_allclose(np.cross(head - tail, velocity), 0, atol=1e-12)
    assert (head - tail) @ velocity > 0


@pytest.mark.parametrize('plane', [*PLANES, (0.0, -0.5, 0.8)])
def test_the_ball_about_a_pole_is_of_two_deviations(plane: Any) -> None:
    table = {row.topic: row for row in result_outputs(BODIES, plane)}
    now = estimate()
    array = decoded(table['visualization'])(now)
    drawn = {marker.ns: marker for marker in array.markers}
    for name in POLE_NAMES:
        marker = drawn[f'crank/{name}/deviation']
        pose = decoded(table[f'crank/{name}/with_covariance'])(now).pose
        q, scale = marker.pose.orientation, xyz(marker.scale)
        axes = np.stack([turned(q, axis) for axis in np.eye(3)])
        ball = axes.T @ np.diag((scale * [1, 1, 0] / 4) ** 2) @ axes
        expected = pose.covariance.reshape(6, 6)[:3, :3]
        np.testing.assert_allclose(ball, expected, atol=1e-6 * expected.max())
        np.testing.assert_array_equal(xyz(marker.pose.position), xyz(pose.pose.position))


def test_bodies_are_drawn_as_outlines_of_their_markers_with_their_names() -> None:
    now = estimate()
    square = np.array([1 + 1j, -1 - 1j, 1 - 1j, -1 + 1j])
    block = stacked([now])
    block.shape = np.stack((square, np.array([0, 1, 2j, np.nan])))[None]
    (row,) = [row for row in result_outputs(BODIES, 'xy') if row.topic == 'visualization']
    array = read_back(row.build(block)[1][0], 'visualization_msgs/msg/MarkerArray')
    drawn = {marker.ns: marker for marker in array.markers}
    assert [drawn[f'{body}/name'].text for body in BODIES] == list(BODIES)
    points = np.array([xyz(point) for point in drawn['crank/outline'].points])
    turn = np.exp(1j * now.angle[0, 0])
    corners = (points[:, 0] + 1j * points[:, 1] - now.origin(0)[0]) / turn
    assert corners[0] == corners[-1]
    # Around, not across.
    np.testing.assert_allclose(np.abs(np.diff(corners)), 2)
    assert set(np.round(corners, 6)) == set(square)
    assert len(drawn['coupler/outline'].points) == 4


def test_relative_centers_are_drawn_where_they_are_published() -> None:
    now = estimate()
    drawn = {marker.ns: marker for marker in rows()['visualization'].build(now).markers}
    center = rows()['coupler/wrt/crank/icr'].build(now).point
    assert xyz(drawn['coupler/wrt/crank/icr'].pose.position) == pytest.approx(xyz(center))


def follow(build: Callable[[Estimate], Any], count: int, step: int = STEP // 2) -> list[Any]:
    found = [build(estimate(5_000_000_000 + step * k)) for k in range(count)]
    return [message for message in found if message is not None]


@pytest.mark.parametrize('locus', ['fixed', 'moving'])
def test_loci_are_of_late_in_order_and_told_ten_times_a_second(locus: str) -> None:
    paths = follow(rows()[f'crank/centrode/{locus}'].build, 801)
    assert all(isinstance(path, Path) for path in paths)
    assert len(paths) == 41
    stamps = [stamp_of(pose) for pose in paths[-1].poses]
    assert len(stamps) == 200
    assert np.diff(stamps).min() >= STEP
    assert stamps[-1] == stamp_of(paths[-1])
    assert {pose.header.frame_id for pose in paths[-1].poses} == {paths[-1].header.frame_id}


def test_the_moving_locus_is_the_fixed_one_seen_from_the_body() -> None:
    stamps = [5_000_000_000 + STEP * k for k in range(11)]
    fixed = follow(rows()['crank/centrode/fixed'].build, 11, STEP)[-1]
    moving = follow(rows()['crank/centrode/moving'].build, 11, STEP)[-1]
    assert len(fixed.poses) == len(moving.poses) == len(stamps)
    for stamp, here, there in zip(stamps, fixed.poses, moving.poses, strict=True):
        then = estimate(stamp)
        icr = then.pole(1).value[0]
        expected = placed('xy', icr, then.height[0])
        np.testing.assert_array_equal(xyz(here.pose.position), expected)
        seen = (icr - then.position[0, 0]) * np.exp(-1j * then.angle[0, 0])
        np.testing.assert_allclose(xyz(there.pose.position), placed('xy', seen), rtol=1e-12)


def test_what_one_topic_says_does_not_depend_on_who_reads_the_others() -> None:
    alone = follow(rows()['crank/centrode/fixed'].build, 100)
    table = rows()

    def among_all(now: Estimate) -> Any:
        messages = {topic: row.build(now) for topic, row in table.items()}
        return messages['crank/centrode/fixed']

    assert follow(among_all, 100) == alone


@pytest.mark.parametrize('locus', ['fixed', 'moving'])
@pytest.mark.parametrize('stamp', [5_000_000_000, 15_000_000_000], ids=['back', 'far on'])
def test_loci_start_anew_when_the_tracker_does(locus: str, stamp: int) -> None:
    """Its body frames are others then, so what was drawn in them before means nothing."""
    build = rows()[f'crank/centrode/{locus}'].build
    assert len(follow(build, 400)[-1].poses) > 100
    anew = estimate(stamp)
    anew.run = 1
    assert [stamp_of(pose) for pose in build(anew).poses] == [stamp]


# Deviations, frames and joints


@pytest.mark.parametrize('plane', PLANES)
def test_beside_each_figure_without_covariance_is_its_deviation(plane: str) -> None:
    now = estimate()
    table = rows(plane)
    numbers_of = {name: now.rate(k) for k, name in enumerate(RATE_NAMES, 1)}
    numbers_of['centrode_curvature'] = now.centrode_curvature
    for name, found in numbers_of.items():
        for b, body in enumerate(BODIES):
            message = table[f'{body}/{name}/deviation'].build(now)
            expected = np.sqrt(found.variance[b]) * placed(plane, 0, 1.0)
            np.testing.assert_allclose(xyz(message.vector), expected, 1e-15)
    first, second, _ = PLANES[plane]
    for name, found, b in (
        ('crank/icr_velocity', now.icr_velocity, 0),
        ('coupler/wrt/crank/icr', now.relative_icr, 0),
    ):
        message = table[f'{name}/deviation'].build(now)
        along = np.sqrt(np.diag(found.covariance[b]))
        there = xyz(message.vector if hasattr(message, 'vector') else message.point)
        np.testing.assert_allclose(there, along[0] * first + along[1] * second, 1e-12)


def test_an_undetermined_figure_has_no_deviation_either() -> None:
    now = estimate(spin=0)
    for topic, row in rows().items():
        if topic.endswith('/deviation'):
            value = rows()[topic.removesuffix('/deviation')].build(now)
            assert (row.build(now) is None) == (value is None), topic


@pytest.mark.parametrize('plane', [*PLANES, (0.0, -0.5, 0.8)])
def test_frames_of_bodies_on_tf_are_where_odometry_has_them(plane: Any) -> None:
    instants = [estimate(5_000_000_000), estimate(5_000_000_000 + STEP, missing=(0, NOT_SEEN))]
    table = {row.topic: row for row in result_outputs(BODIES, plane, frame_prefix='rig/')}
    when, data = table[TF].build(stacked(instants))
    assert when == [0, 0, 1]
    found = [read_back(one, 'tf2_msgs/msg/TFMessage').transforms for one in data]
    assert [len(transforms) for transforms in found] == [1, 1, 1]
    names = [transforms[0].child_frame_id for transforms in found]
    assert names == ['rig/crank', 'rig/coupler', 'rig/crank']
    for at, (transform,) in zip(when, found, strict=True):
        body = transform.child_frame_id.removeprefix('rig/')
        odometry = decoded(table[f'{body}/odom'])(instants[at])
        assert transform.header.frame_id == odometry.header.frame_id == FRAME
        assert odometry.child_frame_id == transform.child_frame_id
        assert transform.header.stamp.nanosec == odometry.header.stamp.nanosec
        pose = odometry.pose.pose
        np.testing.assert_array_equal(xyz(transform.transform.translation), xyz(pose.position))
        turn, expected = transform.transform.rotation, pose.orientation
        np.testing.assert_array_equal(xyz(turn), xyz(expected))
        assert turn.w == expected.w


def test_all_frames_that_are_named_are_on_tf() -> None:
    now = stacked([estimate(5_000_000_000 + STEP * k) for k in range(20)])
    joints = {'pin': BODIES}
    known, named = {FRAME, ''}, set()
    for row in result_outputs(BODIES, 'xy', None, joints, 'rig/'):
        for data in row.build(now)[1]:
            message = read_back(data, type_name(row.message_type))
            for part in getattr(message, 'markers', getattr(message, 'transforms', [message])):
                named.add(part.header.frame_id)
                if row.topic == TF:
                    known.add(part.child_frame_id)
                elif hasattr(part, 'child_frame_id'):
                    named.add(part.child_frame_id)
    assert {'rig/crank', 'rig/coupler'} <= named <= known


def test_joints_have_the_angle_and_rate_of_one_body_against_the_other() -> None:
    joints = {'pin': ('crank', 'coupler'), 'shaft': ('ground', 'crank')}
    table = {row.topic: row for row in result_outputs(BODIES, 'xy', None, joints)}
    now = estimate()
    state, deviation = (
        decoded(table[topic])(now) for topic in ('joint_states', 'joint_states/deviation')
    )
    assert list(state.name) == list(deviation.name) == ['pin', 'shaft']
    angle, rate = now.angle[:2]
    between = [angle[1] - angle[0], angle[0]]
    assert np.exp(1j * np.array(state.position)) == pytest.approx(np.exp(1j * np.array(between)))
    assert np.abs(state.position).max() <= np.pi
    assert list(state.velocity) == pytest.approx([rate[1] - rate[0], rate[0]])
    of_angle, of_rate = now.angle_covariance[0, 0], now.rate(1).variance
    assert list(deviation.position) == pytest.approx(np.sqrt([of_angle.sum(), of_angle[0]]))
    assert list(deviation.velocity) == pytest.approx(np.sqrt([of_rate.sum(), of_rate[0]]))


def test_a_joint_with_a_body_that_is_gone_is_left_out() -> None:
    joints = {'pin': ('crank', 'coupler'), 'shaft': ('ground', 'crank')}
    table = {row.topic: row for row in result_outputs(BODIES, 'xy', None, joints)}
    gone = [(0, 0), (0, NOT_SEEN), (NOT_SEEN, NOT_SEEN), (0, 0)]
    instants = [estimate(10**9 + STEP * k, missing=one) for k, one in enumerate(gone)]
    when, data = table['joint_states'].build(stacked(instants))
    assert when == [0, 1, 3]
    names = [list(read_back(one, 'sensor_msgs/msg/JointState').name) for one in data]
    assert names == [['pin', 'shaft'], ['shaft'], ['pin', 'shaft']]


# Bytes, and many instants at once


@pytest.mark.parametrize('length', range(9))
def test_bytes_are_those_of_rclpy_with_padding_zero(length: int) -> None:
    # The lengths of names decide where padding is.
    frame_id, bodies = 'e' * length, ('é' * (length // 2) or 'a', 'b' * (8 - length) or 'c')
    instants = [estimate(5_000_000_000 + STEP * k) for k in range(3)]
    for now in instants:
        now.frame_id, now.bodies = frame_id, bodies
    block = stacked(instants)
    for row in result_outputs(bodies, 'xy', None, {'j': bodies, frame_id or 'k': bodies}):
        if row.topic == TF and not WITH_TF:
            # rclpy has no such message here; it is read back elsewhere.
            continue
        for data in row.build(block)[1][-1:]:
            cls = ros_class(row.message_type)
            message = deserialize_message(data, cls)
            again = serialize_message(message)
            assert len(data) == len(again), row.topic
            assert deserialize_message(again, cls) == message
            for place in np.flatnonzero(np.frombuffer(data, 'u1') != np.frombuffer(again, 'u1')):
                # What differs must be padding, which nobody reads.
                assert data[place] == 0
                other = data[:place] + b'\x55' + data[place + 1 :]
                assert deserialize_message(other, cls) == message, row.topic


@pytest.mark.parametrize('length', range(4))
def test_diagnostics_are_those_of_rclpy_with_padding_zero(length: int) -> None:
    # The lengths of texts decide where padding is.
    a, e = 'a' * length, 'é' * (3 - length)

    def array(types: Any) -> Any:
        pairs = [types.KeyValue(key=a + e, value=e), types.KeyValue(key=e, value=a)]
        status = types.DiagnosticStatus
        made = types.DiagnosticArray()
        made.header.stamp.sec, made.header.stamp.nanosec, made.header.frame_id = 5, 6, a
        made.status = [
            status(level=status.STALE, name=a, message=e, values=pairs),
            status(level=status.WARN, name=e, hardware_id=a),
            status(name=a, values=pairs[1:]),
        ]
        return made

    data = kinpole_ros.messages.serialize_message(array(kinpole_ros.messages._types))
    expected = array(diagnostic_msgs.msg)
    again = serialize_message(expected)
    assert len(data) == len(again)
    for place in np.flatnonzero(np.frombuffer(data, 'u1') != np.frombuffer(again, 'u1')):
        assert data[place] == 0
    assert deserialize_message(data, diagnostic_msgs.msg.DiagnosticArray) == expected


def told(instants: Sequence[Estimate], cuts: Sequence[int]) -> dict[str, list[tuple[int, Any]]]:
    """All messages by topic, with the place of their instant, from the parts between cuts."""
    table = result_outputs(BODIES, 'xy')
    found: dict[str, list[tuple[int, Any]]] = {row.topic: [] for row in table}
    for first, last in itertools.pairwise(cuts):
        block = stacked(instants[first:last])
        for row in table:
            for k, data in zip(*row.build(block), strict=True):
                message = read_back(data, type_name(row.message_type))
                found[row.topic].append((first + k, message))
    return found


def test_all_topics_at_once_say_what_each_says_by_itself() -> None:
    """Also after a change of the frame and the plane, and with some bodies gone."""
    table = [row for row in result_outputs(BODIES, 'xy') if '/centrode/' not in row.topic]
    table = [row for row in table if row.topic != 'visualization']
    build = joint_build(table)
    tilted = plane_along((0.0, -0.5, 0.8))
    for frame_id, plane in (('rig', None), ('rig', tilted), ('a longer name', None)):
        for ways in ([{}], [{}, {'spin': 0}, {'missing': (0, NOT_SEEN)}, {}]):
            block = stacked([estimate(10**9 + STEP * k, **way) for k, way in enumerate(ways)])
            block.frame_id, block.plane = frame_id, plane
            expected = [(k, data) for k, row in enumerate(table) for data in row.build(block)[1]]
            assert sorted(build(block)) == sorted(expected)
            assert len(expected) > 40
    assert joint_build(())(block) == []


def test_an_estimate_that_lacks_derivatives_or_bodies_is_refused() -> None:
    """The library never reads beyond what it is given."""
    table = {row.topic: row for row in result_outputs((*BODIES, 'rocker'), 'xy')}
    with pytest.raises(ValueError, match='derivatives up to order 4'):
        table['crank/isp'].build(stacked([estimate(order=3)]))
    for topic in ('rocker/icr', 'rocker/wrt/crank/icr'):
        with pytest.raises(ValueError, match='all bodies, got 2'):
            table[topic].build(stacked([estimate()]))


def test_many_instants_at_once_say_what_they_say_one_by_one() -> None:
    ways: list[dict[str, Any]] = [{}, {}, {}, {'missing': (0, NOT_SEEN)}, {'spin': 0}]
    stamps = np.random.default_rng(1).choice([STEP // 4, STEP, 3 * STEP], 200).cumsum()
    instants = [
        estimate(5_000_000_000 + int(stamp), **ways[k // 7 % len(ways)])
        for k, stamp in enumerate(stamps)
    ]
    alone = told(instants, range(201))
    blocks = told(instants, [0, 1, 2, 70, 155, 156, 200])
    for topic, expected in alone.items():
        if topic.endswith('/event'):
            continue
        found = blocks[topic]
        assert len(found) > 20, topic
        assert [k for k, _ in found] == [k for k, _ in expected], topic
        for (_, one), (_, other) in zip(found, expected, strict=True):
            np.testing.assert_allclose(list(numbers(one)), list(numbers(other)), 1e-12, 1e-15)


# What is told of the tracking


def test_a_body_without_results_says_whether_markers_or_readers_are_missing() -> None:
    tracker = Tracker(Settings())
    maker = DiagnosticsMaker('kinpole')

    def told() -> list[tuple[bytes, str]]:
        array = maker.make(1_000_000_000, tracker, None, 1.0, {})
        return [(status.level, status.message) for status in array.status]

    assert told() == [(DiagnosticStatus.STALE, 'no markers received')] * 2
    # Where something keeps them from coming, that is what is to be mended.
    damaged = Finding('unreadable_message', '', {'problem': 'damaged'}, ERROR)
    markers = maker.make(1_000_000_000, tracker, None, 1.0, [damaged]).status[0]
    assert (markers.level, markers.message) == (DiagnosticStatus.ERROR, 'damaged')
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for k in range(20):
        tracker.add(MarkerFrames(np.array([STEP * k]), FRAME, ('0', '1'), points[None]), None)
    markers, body = told()
    assert markers == (DiagnosticStatus.OK, 'receiving markers')
    # Nothing is wrong with it.
    assert body[0] == DiagnosticStatus.OK
    assert 'nobody subscribes' in body[1]


def test_a_body_whose_markers_are_of_several_links_is_warned_of() -> None:
    tracker = Tracker(Settings())
    maker = DiagnosticsMaker('kinpole')
    angle = np.arange(100) / 30
    arms = np.exp(1j * angle), np.exp(-2j * angle)
    flat = np.stack((0 * arms[0], arms[0], 3 + 0 * arms[0], 3 + arms[1]), axis=1)
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    stamps = 10**18 + STEP * np.arange(100)
    (estimate,) = tracker.add(MarkerFrames(stamps, FRAME, ('0', '1', '2', '3'), points), 1)
    status = maker.make(10**18, tracker, estimate, 1.0, {}).status[1]
    assert status.level == DiagnosticStatus.WARN
    assert 'm off one rigid body' in status.message
    assert 'one link only' in status.message


def test_a_body_of_all_markers_lacks_some_only_where_less_than_two_are_left() -> None:
    tracker = Tracker(Settings())
    maker = DiagnosticsMaker('kinpole')

    def told(*names: str) -> str:
        stamps = np.array([10**18 + STEP * (tracker.update_counts()['frames'] + 1)])
        points = np.random.default_rng(0).normal(size=(1, len(names), 3))
        tracker.add(MarkerFrames(stamps, FRAME, names, points), None)
        return str(maker.make(10**18, tracker, None, 1.0, {}).status[1].message)

    assert 'lack' not in told('a', 'b', 'c', 'd')
    assert 'lack' not in told('a', 'b', 'd')
    assert "messages lack 'b', 'c', 'd' of body; the last one has 'a'; " in told('a')
    # As by a driver that counts its ids up, from frame to frame.
    for k in range(30):
        words = told(*(f'{40 * k + j}\n' for j in range(40)))
    assert "messages lack 'a', 'b', 'c', 'd', '0\\n'" in words
    assert words.isprintable()
    assert len(words) < 500


def test_markers_that_no_message_has_are_named_until_they_come() -> None:
    tracker = Tracker(Settings(bodies={'rod': ('tip', 'heel', 'toe'), 'all': ('a', 'b')}))
    maker = DiagnosticsMaker('kinpole')

    def told(*names: str) -> tuple[bytes, str]:
        for _ in range(3):
            stamps = np.array([10**18 + STEP * (tracker.update_counts()['frames'] + 1)])
            points = np.random.default_rng(0).normal(size=(1, len(names), 3))
            tracker.add(MarkerFrames(stamps, FRAME, names, points), None)
        status = maker.make(10**18, tracker, None, 1.0, {}).status[1]
        return status.level, status.message

    level, words = told('a', 'b', 'Tip', 'heel')
    assert level == DiagnosticStatus.WARN
    assert words.startswith("messages lack 'tip', 'toe' of rod; the last one has 'a', 'b', 'Tip', ")
    assert words.endswith('correct the parameter rod.markers, or marker_identity')
    assert 'lack' not in told('a', 'b', 'tip', 'heel')[1]
    # One under another name is found by the shape, one that is not there is not.
    assert 'lack' not in told('a', 'b', 'Tip', 'heel')[1]
    assert 'lack' in told('a', 'b', 'heel')[1]
    nothing_since = maker.make(10**18, tracker, None, 1.0, {}).status[1]
    assert nothing_since.level == DiagnosticStatus.STALE
    assert 'lack' not in told('a', 'b', 'tip', 'heel')[1]
