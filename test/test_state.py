"""The topic `state`: one message that says of the bodies what all the others say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import decoded, stamp_of
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from test_results import FRAME, PLANES, estimate, placed, stacked

from kinpole_ros import messages
from kinpole_ros.bags import read_messages, replay
from kinpole_ros.messages import STATE, Output, read_state, result_outputs, state_fields
from kinpole_ros.messages._state import read_state_blocks, reason_fields, state
from kinpole_ros.settings import load_settings
from kinpole_ros.tracking.plane import XY
from kinpole_ros.tracking.reasons import KNOWN, REASONS
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, Numbers, Vectors

ROOT = Path(__file__).parents[1]
BODIES = ('crank', 'coupler', 'rocker')
DTYPES = {
    PointField.FLOAT32: '<f4',
    PointField.FLOAT64: '<f8',
    PointField.UINT32: '<u4',
    PointField.UINT8: 'u1',
}


def points_of(cloud: Any) -> np.ndarray:
    """The points as any reader of PointCloud2 has them: an array with named fields."""
    kind = np.dtype(
        {
            'names': [field.name for field in cloud.fields],
            'formats': [DTYPES[field.datatype] for field in cloud.fields],
            'offsets': [field.offset for field in cloud.fields],
            'itemsize': cloud.point_step,
        }
    )
    return np.frombuffer(bytes(cloud.data), kind)


def output(plane: str = 'xy', order: int = 4) -> Output:
    (row,) = (
        row
        for row in result_outputs(('crank', 'coupler'), plane, highest=order)
        if row.topic == STATE
    )
    return row


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a four-bar whose bodies are not all determined all the time."""
    path = tmp_path_factory.mktemp('state') / 'results.mcap'
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml', changes={'topics': 'all'})
    replay(ROOT / 'bags' / 'four_bar.mcap', settings, path)
    return path


@pytest.fixture(scope='module')
def states(bag: Path) -> dict[int, np.ndarray]:
    """By stamp the points of each message in the bag."""
    clouds = decoded(bag, f'/kinpole/{STATE}')[f'/kinpole/{STATE}']
    return {stamp_of(cloud): points_of(cloud) for cloud in clouds}


def test_rclpy_and_rosbags_read_the_same_cloud(bag: Path) -> None:
    for message in list(read_messages(bag, [f'/kinpole/{STATE}']))[::50]:
        cloud = deserialize_message(message.data, PointCloud2)
        assert len(serialize_message(cloud)) == len(message.data)
        assert (cloud.height, cloud.width, cloud.is_dense) == (1, len(BODIES), True)
        assert cloud.row_step == len(cloud.data) == cloud.width * cloud.point_step
        assert [field.name for field in cloud.fields[:4]] == ['x', 'y', 'z', 'determined']
        assert {field.count for field in cloud.fields} == {1}
        kind = messages.message_class('sensor_msgs/msg/PointCloud2')
        other = messages.deserialize_message(message.data, kind)
        np.testing.assert_array_equal(points_of(cloud), points_of(other))
        # rclpy leaves padding to chance; ours is zero, as that of rosbags.
        assert messages.serialize_message(other) == message.data


def test_there_is_one_message_an_instant_and_none_of_its_numbers_is_nan(
    bag: Path, states: dict[int, np.ndarray]
) -> None:
    odometry = decoded(bag, *(f'/kinpole/{body}/odom' for body in BODIES))
    assert {stamp_of(each) for listed in odometry.values() for each in listed} <= states.keys()
    for points in states.values():
        for name in points.dtype.names or ():
            assert np.isfinite(points[name]).all()
        for bit, fields in enumerate(state_fields(4).values()):
            unknown = points['determined'] >> bit & 1 == 0
            assert not any(points[name][unknown].any() for name in fields)


def test_its_numbers_are_those_of_the_separate_topics(
    bag: Path, states: dict[int, np.ndarray]
) -> None:
    messages = decoded(bag)
    compared = 0
    for b, body in enumerate(BODIES):

        def by_stamp(topic: str, body: str = body) -> dict[int, Any]:
            return {stamp_of(m): m for m in messages.get(f'/kinpole/{body}/{topic}', [])}

        # The diameter has no topic of its own.
        for bit, quantity in enumerate(list(state_fields(4))[:-1]):
            topic = 'odom' if quantity == 'pose' else quantity
            found = by_stamp(topic)
            known = {t for t, points in states.items() if points['determined'][b] >> bit & 1}
            assert known == found.keys(), (body, quantity)
            deviations = by_stamp(f'{topic}/deviation')
            covariances = by_stamp(f'{topic}/with_covariance')
            for stamp, message in found.items():
                point, compared = states[stamp][b], compared + 1
                if quantity == 'pose':
                    assert_pose(point, message)
                    continue
                value = getattr(message, 'point', None) or message.vector
                if quantity in point.dtype.names:
                    assert point[quantity] == value.z
                    assert point[f'{quantity}_deviation'] == deviations[stamp].vector.z
                    continue
                assert [point[f'{quantity}_{end}'] for end in 'xy'] == [value.x, value.y]
                spread = [point[f'{quantity}_{end}'] for end in ('xx', 'xy', 'yy')]
                if quantity in POLE_NAMES:
                    covariance = covariances[stamp].pose.covariance
                    np.testing.assert_array_equal(covariance[[0, 1, 7]], spread)
                else:
                    sigma = deviations[stamp]
                    sigma = getattr(sigma, 'point', None) or sigma.vector
                    np.testing.assert_allclose([sigma.x**2, sigma.y**2], spread[::2], rtol=1e-9)
    assert compared > 4000


def assert_pose(point: Any, odometry: Any) -> None:
    """Of pose and twist, which odometry has along the axes of the body."""
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert [point['position_x'], point['position_y']] == [place.x, place.y]
    np.testing.assert_array_equal(
        [point[axis] for axis in 'xyz'], np.float32([place.x, place.y, place.z])
    )
    rotation = complex(turn.w, turn.z) ** 2
    assert np.exp(1j * point['angle']) == pytest.approx(rotation, abs=1e-12)
    twist = odometry.twist.twist
    velocity = complex(twist.linear.x, twist.linear.y) * rotation
    assert complex(point['velocity_x'], point['velocity_y']) == pytest.approx(velocity, abs=1e-12)
    spread = odometry.pose.covariance.reshape(6, 6)
    ours = [point[f'position_{end}'] for end in ('xx', 'xy', 'yy')]
    np.testing.assert_allclose(ours, spread[[0, 0, 1], [0, 1, 1]], rtol=1e-9, atol=1e-18)
    assert point['angle_deviation'] ** 2 == pytest.approx(spread[5, 5], rel=1e-12)


def test_covariances_of_place_and_velocity_are_those_of_the_origin() -> None:
    """They are the same as of many origins, computed from poses with random errors."""
    now = stacked([estimate()])
    now.reference = np.array([[0.3 - 0.1j, -0.2 + 0.4j]])
    now.angle_covariance[:2, :2] *= 1e-2
    _, (data,) = output().build(now)
    _, found = read_state(data)
    generator, count = np.random.default_rng(5), 200_000
    for b in range(2):
        spread = now.angle_covariance[:2, :2, 0, b]
        errors = generator.multivariate_normal([0, 0], spread, count).T
        angle, rate = now.angle[:2, 0, b, None] + errors
        arm = now.reference[0, b] * np.exp(1j * angle)
        for order, name, moved in ((0, 'position', arm), (1, 'velocity', 1j * rate * arm)):
            sigma = np.sqrt(now.position_covariance[order, order, 0, b])
            noise = sigma * generator.normal(size=(2, count))
            origin = now.position[order, 0, b] + noise[0] + 1j * noise[1] - moved
            expected = np.cov(origin.real, origin.imag)
            quantity = found[name]
            assert isinstance(quantity, Vectors)
            np.testing.assert_allclose(
                quantity.covariance[b], expected, rtol=0.03, atol=0.02 * expected.max()
            )


@pytest.mark.parametrize('plane', PLANES)
def test_viewers_find_bodies_in_the_frame_and_programs_in_the_plane(plane: str) -> None:
    now = estimate()
    _, (data,) = output(plane).build(stacked([now]))
    cloud = deserialize_message(data, PointCloud2)
    assert cloud.header.frame_id == FRAME
    points, origin = points_of(cloud), now.origin(0)
    for b in range(2):
        expected = placed(plane, origin[b], now.height[b])
        np.testing.assert_array_equal([points[axis][b] for axis in 'xyz'], np.float32(expected))
    np.testing.assert_array_equal(points['position_x'], origin.real)
    np.testing.assert_array_equal(points['position_y'], origin.imag)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_fields_go_up_to_the_order_of_the_derivatives(order: int) -> None:
    _, (data,) = output(order=order).build(stacked([estimate(order=order)]))
    stamp, found = read_state(data)
    assert stamp == 5_000_000_000
    expected = {'position', 'angle', 'velocity', *RATE_NAMES[:order], *POLE_NAMES[:order]}
    expected |= (
        {'icr_velocity', 'inflection_circle', 'inflection_diameter'} if order >= 2 else set()
    )
    expected |= {'centrode_curvature'} if order >= 3 else set()
    assert set(found) == expected
    for k, name in enumerate(RATE_NAMES[:order], 1):
        now = estimate(order=order).rate(k)
        quantity = found[name]
        assert isinstance(quantity, Numbers)
        np.testing.assert_array_equal(quantity.value, now.value)
        np.testing.assert_allclose(quantity.variance, now.variance, rtol=1e-12)


def test_a_body_that_is_not_seen_is_zero_and_undetermined_and_one_that_rests_has_no_pole() -> None:
    now = estimate(missing=(REASONS['NOT_SEEN'], 0), spin=0)
    at, (data,) = output().build(stacked([now]))
    assert at == [0]
    points = points_of(deserialize_message(data, PointCloud2))
    assert points['determined'].tolist() == [0, 0b11111]
    numbers = [name for name in points.dtype.names or () if not name.endswith('_reason')]
    assert not any(points[name][0] for name in numbers)
    assert points['position_x'][1] and not points['icr_x'][1]


def test_places_beyond_float32_stay_finite() -> None:
    now = stacked([estimate()])
    now.position = now.position * 1e60
    _, (data,) = output().build(now)
    points = points_of(deserialize_message(data, PointCloud2))
    assert np.isfinite(points['x']).all() and np.abs(points['position_x']).max() > 1e50


def test_instants_at_once_are_those_one_by_one() -> None:
    instants = [estimate(stamp) for stamp in (1_500_000_000, 5_000_000_000, 5_010_000_007)]
    at, together = output().build(stacked(instants))
    assert at == [0, 1, 2]
    alone = [output().build(stacked([now]))[1][0] for now in instants]
    assert together == alone


def test_states_of_before_the_reasons_are_refused_with_the_fix() -> None:
    _, (data,) = output().build(stacked([estimate()]))
    cloud = deserialize_message(data, PointCloud2)
    cloud.fields = [field for field in cloud.fields if not field.name.endswith('_reason')]
    with pytest.raises(ValueError, match='again from the markers'):
        read_state(serialize_message(cloud))


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_reasons_are_those_of_the_estimate(order: int) -> None:
    """A body that is not seen has one for all of it; one that rests has no rotation."""
    instants = [estimate(missing=(REASONS['NOT_SEEN'], 0), spin=0, order=order)]
    instants.append(estimate(5_010_000_000, order=order))
    now = stacked(instants)
    _, data = output(order=order).build(now)
    (block,) = read_state_blocks(data)
    assert block.stamps.tolist() == now.stamp.tolist()
    assert [*block.reasons] == [*reason_fields(order)] == [*state_fields(order)]
    np.testing.assert_array_equal(block.reasons['pose'], now.reason)
    for name, codes in now.withheld().items():
        np.testing.assert_array_equal(block.reasons[name], codes)
    for name, quantity in block.quantities.items():
        known = block.reasons.get(name, block.reasons['pose']) == KNOWN
        np.testing.assert_array_equal(quantity.determined, known)
    assert block.reasons['icr'][0].tolist() == [REASONS['NOT_SEEN'], REASONS['NO_ROTATION']]


def registered() -> list[RegisteredQuantity]:
    """Known at the first of two instants: of either body P, of the second one a number."""
    value, known = np.array([1 + 2j, np.nan + 0j]), np.array([True, True])
    spread = np.array([[3.0, 0.5], [0.5, 4.0]]) * np.ones((2, 1, 1))
    number = Numbers(np.array([5.0, 6.0]), np.array([0.25, 0.25]), np.array([True, False]))
    one, two = (Vectors(factor * value, spread, known) for factor in (1, 2))
    return [
        RegisteredQuantity('crank/points/P', 'point', 1, 'm', lambda _: one, 0),
        RegisteredQuantity('coupler/points/P', 'point', 1, 'm', lambda _: two, 1),
        RegisteredQuantity('coupler/slip', 'number', 2, 'm', lambda _: number, 1),
        RegisteredQuantity('balance', 'torque', 1, 'N m', lambda _: number),
    ]


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_quantities_registered_of_a_body_are_fields_of_that_body(order: int) -> None:
    """Bodies with a quantity of one name share its fields; what is of no body has none."""
    now = stacked([estimate(order=order), estimate(5_010_000_000, order=order)])
    at, pair = state(XY, order, registered())(now)
    assert at == [0, 1]
    _, plain = state(XY, order)(now)
    added = [f'points/P_{end}' for end in ('x', 'y', 'xx', 'xy', 'yy', 'determined')]
    added += ['slip', 'slip_deviation', 'slip_determined'] if order > 1 else []
    for data, before in zip(pair, plain, strict=True):
        cloud, alone = (deserialize_message(each, PointCloud2) for each in (data, before))
        points, others = points_of(cloud), points_of(alone)
        assert points.dtype.names == (*(others.dtype.names or ()), *added)
        for name in others.dtype.names or ():
            np.testing.assert_array_equal(points[name], others[name])
    first, second = (read_state(data)[1] for data in pair)
    found = first['points/P']
    assert isinstance(found, Vectors)
    assert found.determined.tolist() == [True, True]
    assert found.value.tolist() == [1 + 2j, 2 + 4j]
    assert found.covariance.tolist() == [[[3.0, 0.5], [0.5, 4.0]]] * 2
    # Of the second instant no value is finite.
    assert not second['points/P'].determined.any() and not second['points/P'].value.any()
    if order > 1:
        assert [part.tolist() for part in first['slip']] == [[0, 5], [0, 0.25], [False, True]]
        assert not second['slip'].determined.any() and not second['slip'].value.any()


@pytest.mark.parametrize(
    'names',
    [
        ['slip', 'slip_deviation'],
        ['slip', 'slip_deviation', 'slip'],
        ['slip', 'slip_xx', 'slip_determined'],
        ['icr', 'icr_deviation', 'icr_determined'],
        ['position', 'position_deviation', 'position_determined'],
        2 * ['slip', 'slip_deviation', 'slip_determined'],
    ],
)
def test_fields_that_are_of_no_quantity_are_refused(names: list[str]) -> None:
    _, (data,) = output().build(stacked([estimate()]))
    cloud = deserialize_message(data, PointCloud2)
    rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(cloud.width, -1)
    for name in names:
        field = PointField(name=name, offset=cloud.point_step, datatype=PointField.FLOAT64, count=1)
        cloud.fields.append(field)
        cloud.point_step += 8
    cloud.data = np.pad(rows, ((0, 0), (0, 8 * len(names)))).ravel()
    cloud.row_step = cloud.width * cloud.point_step
    with pytest.raises(ValueError, match=r'its fields of .* are not those of a topic `state`'):
        read_state(serialize_message(cloud))


def test_another_cloud_is_refused() -> None:
    _, (data,) = output().build(stacked([estimate()]))
    read_state(data)
    cloud = deserialize_message(data, PointCloud2)
    cloud.fields[5].name = 'position_z'
    with pytest.raises(ValueError, match='fields'):
        read_state(serialize_message(cloud))
    cloud = deserialize_message(data, PointCloud2)
    cloud.data = cloud.data[:-8]
    with pytest.raises(ValueError, match='bytes of data for 2 bodies'):
        read_state(serialize_message(cloud))
    cloud = deserialize_message(data, PointCloud2)
    cloud.data[16:24] = cloud.data[16:24].__class__('B', np.float64('nan').tobytes())
    with pytest.raises(ValueError, match='finite'):
        read_state(serialize_message(cloud))
    with pytest.raises(ValueError, match='100 bytes are no sensor_msgs/msg/PointCloud2'):
        read_state(data[:100])
