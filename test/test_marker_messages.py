"""The four marker messages give the same frames, and no message can lead the reader astray."""

import math
import struct
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros.messages import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    MarkerReader,
    MessageError,
    marker_arrays,
    message_class,
    ns_to_stamp,
    read_markers,
    serialize_message,
    stamp_to_ns,
    to_message,
    type_name,
)
from kinpole_ros.messages._types import (
    Header,
    Marker,
    MarkerArray,
    Point,
    PointCloud2,
    PointField,
    Pose,
    PoseArray,
)

# One warning is not ours: rclpy's parser of interfaces imports a module of Python that is to go.
pytestmark = [
    pytest.mark.filterwarnings('error'),
    pytest.mark.filterwarnings('ignore:module .sre_:DeprecationWarning'),
]

STAMP = 1_700_000_000_123_456_789
NAMES = ['a', 'b', 'c', 'd', 'e']
POINTS = np.arange(15.0).reshape(5, 3) / 7 - 1
KINDS = list(MARKER_TYPES)
Quaternion = message_class('geometry_msgs/msg/Quaternion')
INDEX_KINDS = ['marker', 'pose_array', 'point_cloud2']
# struct codes and sizes of the datatypes of PointField, 1 to 8
CODES = dict(enumerate('bBhHiIfd', start=1))
SIZES = {datatype: struct.calcsize('<' + code) for datatype, code in CODES.items()}


class Frame(NamedTuple):
    """The one frame of a message."""

    stamp: int
    frame_id: str
    identities: tuple[str, ...]
    points: np.ndarray


def read_one(message, identity='auto'):
    """What read_markers reads, and a MarkerReader must read from the bytes, again and at once."""
    try:
        read = read_markers(message, identity)
    except MessageError as error:
        read = error
    for kind, cls in MARKER_TYPES.items():
        if isinstance(message, cls):
            reader, data = MarkerReader(kind, identity), serialize_message(message)
            again = one_by_one(reader.read([data]) + reader.read([data]) + reader.read([data] * 3))
            assert len(again) == 5
            for frames in again:
                assert_same(frames, read)
    if isinstance(read, MessageError):
        raise read
    assert read.stamps.shape == (1,) and read.stamps.dtype == np.int64
    assert read.points.ndim == 3 and len(read.points) == 1
    return Frame(int(read.stamps[0]), read.frame_id, read.identities, read.points[0])


def one_by_one(results):
    """Results of a MarkerReader, one for each message."""
    found = []
    for result in results:
        if isinstance(result, MessageError):
            found.append(result)
            continue
        for stamp, points in zip(result.stamps, result.points, strict=True):
            found.append(result._replace(stamps=stamp[None], points=points[None]))
    return found


def assert_same(found, expected):
    assert type(found) is type(expected)
    if isinstance(expected, MessageError):
        assert str(found) == str(expected)
        return
    assert found.stamps.dtype == np.int64
    assert found.stamps.tolist() == expected.stamps.tolist()
    assert (found.frame_id, found.identities) == (expected.frame_id, expected.identities)
    np.testing.assert_array_equal(found.points, expected.points, strict=True)


def make(kind, points=POINTS, names=NAMES):
    return to_message(kind, STAMP, 'lab', names[: len(points)], points)


def marker(ns='', number=0, x=0.0, action=Marker.ADD, sec=0, frame_id=''):
    place = Pose(position=Point(x=x))
    result = Marker(ns=ns, id=number, type=Marker.SPHERE, action=action, pose=place)
    result.header.stamp.sec = sec
    result.header.frame_id = frame_id
    return result


def cloud_with_ids(ids, datatype=PointField.UINT16, big=False):
    code = CODES[datatype]
    order = '>' if big else '<'
    step = struct.calcsize(order + 'ff' + code)
    cloud = PointCloud2(height=1, width=len(ids), point_step=step, row_step=step * len(ids))
    cloud.is_bigendian = big
    cloud.fields = [
        PointField(name='x', offset=0, datatype=PointField.FLOAT32, count=1),
        PointField(name='y', offset=4, datatype=PointField.FLOAT32, count=1),
        PointField(name='id', offset=8, datatype=datatype, count=1),
    ]
    data = b''.join(struct.pack(order + 'ff' + code, k, -k, i) for k, i in enumerate(ids))
    cloud.data = np.frombuffer(data, np.uint8)
    return cloud


# The same scene in four messages


@pytest.mark.parametrize('kind', KINDS)
def test_round_trip_is_exact(kind):
    frame = read_one(make(kind))
    assert frame.stamp == STAMP
    assert frame.frame_id == 'lab'
    assert frame.points.dtype == np.float64
    assert frame.points.tolist() == POINTS.tolist()
    expected = [f'{name}/{k}' for k, name in enumerate(NAMES)] if kind == 'marker_array' else None
    assert frame.identities == tuple(expected or '01234')


@pytest.mark.parametrize('kind', KINDS)
def test_message_has_the_class_its_names_promise(kind):
    cls = type(make(kind))
    assert cls is MARKER_TYPES[kind]
    assert type_name(cls) == ROS_TYPE_NAMES[kind]
    assert cls.__name__ == ROS_TYPE_NAMES[kind].rpartition('/')[2]


@pytest.mark.parametrize('kind', INDEX_KINDS)
def test_frame_without_markers_round_trips(kind):
    frame = read_one(make(kind, np.empty((0, 3))))
    assert frame.points.shape == (0, 3)
    assert (frame.stamp, frame.frame_id, frame.identities) == (STAMP, 'lab', ())


def test_missing_marker_is_the_same_in_all_types():
    points = POINTS.copy()
    points[2] = np.nan
    for kind in INDEX_KINDS:
        frame = read_one(make(kind, points))
        assert frame.identities == tuple('01234')
        np.testing.assert_array_equal(frame.points, points)
    frame = read_one(make('marker_array', points), 'ns')
    assert frame.identities == ('a', 'b', 'd', 'e')
    np.testing.assert_array_equal(frame.points, np.delete(points, 2, axis=0))


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize('value', [math.inf, -math.inf, math.nan])
def test_one_coordinate_not_finite_blanks_the_row_and_keeps_its_place(kind, axis, value):
    message = make(kind)
    if kind == 'point_cloud2':
        struct.pack_into('<d', message.data, 24 * 3 + 8 * axis, value)
        message.is_dense = True
    else:
        holders = {
            'marker_array': lambda: message.markers[3].pose.position,
            'marker': lambda: message.points[3],
            'pose_array': lambda: message.poses[3].position,
        }
        setattr(holders[kind](), 'xyz'[axis], value)
    frame = read_one(message)
    assert len(frame.identities) == 5
    assert np.isnan(frame.points[3]).all()
    assert np.delete(frame.points, 3, axis=0).tolist() == np.delete(POINTS, 3, axis=0).tolist()


@pytest.mark.parametrize('dense', [True, False])
def test_is_dense_is_not_believed(dense):
    points = POINTS.copy()
    points[1, 0] = np.inf
    for scene in (POINTS, points):
        message = make('point_cloud2', scene)
        expected = read_one(message).points
        message.is_dense = dense
        np.testing.assert_array_equal(read_one(message).points, expected)


def test_made_cloud_tells_truly_whether_it_is_dense():
    points = POINTS.copy()
    points[1, 0] = np.inf
    assert make('point_cloud2').is_dense is True
    assert make('point_cloud2', points).is_dense is False


@pytest.mark.parametrize('kind', INDEX_KINDS)
def test_making_blanks_a_row_that_is_not_finite_and_leaves_the_argument_alone(kind):
    points = POINTS.copy()
    points[1, 0] = np.inf
    frame = read_one(make(kind, points))
    assert np.isnan(frame.points[1]).all()
    assert points[1, 0] == np.inf and np.isfinite(points[1, 1:]).all()


def test_made_markers_can_be_seen_and_keep_their_id_when_one_is_missing():
    points = POINTS.copy()
    points[0, 2] = np.nan
    array = make('marker_array', points).markers
    assert [(m.ns, m.id) for m in array] == [('b', 1), ('c', 2), ('d', 3), ('e', 4)]
    single = make('marker')
    assert (single.ns, single.id, single.type) == ('markers', 0, Marker.SPHERE_LIST)
    assert {m.type for m in array} == {Marker.SPHERE}
    for m in [*array, single]:
        assert m.action == Marker.ADD
        assert m.pose.orientation == Quaternion(w=1.0)
        assert (m.scale.x, m.scale.y, m.scale.z, m.color.a) == (0.01, 0.01, 0.01, 1.0)
    assert {p.orientation.w for p in make('pose_array').poses} == {1.0}


# PointCloud2 layouts


@st.composite
def layouts(draw):
    """Clouds of any legal layout, and what a plain struct.unpack of them says."""
    order = draw(st.sampled_from('<>'))
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    names = ['x', 'y'] + draw(st.sampled_from([[], ['z']]))
    others = draw(st.lists(st.sampled_from(['rgb', 'intensity', '_', 'ring']), max_size=3))
    fields, end = [], 0
    for name in draw(st.permutations(names + others)):
        datatype = draw(st.sampled_from([7, 8] if name in 'xyz' else list(CODES)))
        count = draw(st.integers(0, 1) if name in 'xyz' else st.integers(0, 3))
        offset = end + draw(st.integers(0, 5))
        fields.append(PointField(name=name, offset=offset, datatype=datatype, count=count))
        end = offset + SIZES[datatype] * max(count, 1)
    step = end + draw(st.integers(0, 5))
    row_step = width * step + draw(st.integers(0, 7))
    size = height * row_step
    # Plain random bytes hold denormals, infinities and signaling NaNs too.
    seed = draw(st.integers(0, 2**32 - 1))
    data = bytearray(np.random.default_rng(seed).bytes(size + draw(st.integers(0, 3))))
    special = draw(
        st.sampled_from([None, b'\x7f\x80\x00\x01', b'\x7f\xf0\x00\x00\x00\x00\x00\x01'])
    )
    if special and size > len(special):
        at = draw(st.integers(0, size - len(special)))
        data[at : at + len(special)] = special if order == '>' else special[::-1]
    cloud = PointCloud2(height=height, width=width, point_step=step, row_step=row_step)
    cloud.fields = draw(st.permutations(fields))
    cloud.is_bigendian = order == '>'
    cloud.is_dense = draw(st.booleans())
    cloud.data = np.frombuffer(data, np.uint8)
    expected = []
    for row in range(height):
        for column in range(width):
            point = dict.fromkeys('xyz', 0.0)
            for field in fields:
                if field.name in point:
                    at = row * row_step + column * step + field.offset
                    (point[field.name],) = struct.unpack_from(
                        order + CODES[field.datatype], data, at
                    )
            seen = all(map(math.isfinite, point.values()))
            expected.append(list(point.values()) if seen else [math.nan] * 3)
    return cloud, np.array(expected).reshape(-1, 3)


@given(layouts())
def test_any_cloud_layout_reads_as_struct_reads_it(layout):
    cloud, expected = layout
    frame = read_one(cloud)
    np.testing.assert_array_equal(frame.points, expected)
    assert frame.identities == tuple(str(k) for k in range(len(expected)))


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize(('code', 'bits'), [('I', 0x7F800001), ('Q', 0x7FF0000000000001)])
def test_signaling_nan_blanks_the_row_without_a_warning(code, bits, big):
    order, size = '>' if big else '<', struct.calcsize('<' + code)
    cloud = PointCloud2(height=1, width=2, point_step=2 * size, row_step=4 * size)
    cloud.is_bigendian = big
    datatype = PointField.FLOAT32 if code == 'I' else PointField.FLOAT64
    cloud.fields = [
        PointField(name=name, offset=size * axis, datatype=datatype, count=1)
        for axis, name in enumerate('xy')
    ]
    cloud.data = np.frombuffer(struct.pack(order + 4 * code, 0, bits, 0, 0), np.uint8)
    np.testing.assert_array_equal(read_one(cloud).points, [[np.nan] * 3, [0, 0, 0]])


def test_frame_of_a_cloud_does_not_share_the_memory_of_the_message():
    cloud = make('point_cloud2')
    frame = read_one(cloud)
    cloud.data[:] = 0
    assert frame.points.tolist() == POINTS.tolist()


def change_field(cloud, name, /, **values):
    field = next(field for field in cloud.fields if field.name == name)
    for key, value in values.items():
        setattr(field, key, value)


def drop_field(cloud, name):
    cloud.fields = [field for field in cloud.fields if field.name != name]


def change(message, **values):
    for key, value in values.items():
        setattr(message, key, value)


HUGE = 2**32 - 1
BAD_CLOUDS = {
    "no field 'x'": lambda c: drop_field(c, 'x'),
    "no field 'y'": lambda c: drop_field(c, 'y'),
    "2 fields 'x'": lambda c: change_field(c, 'y', name='x'),
    "'y' has datatype 5": lambda c: change_field(c, 'y', datatype=PointField.INT32),
    "'z' has datatype 0": lambda c: change_field(c, 'z', datatype=0),
    "'x' has datatype 99": lambda c: change_field(c, 'x', datatype=99),
    "'x' has count 2": lambda c: change_field(c, 'x', count=2),
    "'z' at offset 17 ends beyond point_step 24": lambda c: change_field(c, 'z', offset=17),
    f"'x' at offset {HUGE} ends beyond": lambda c: change_field(c, 'x', offset=HUGE),
    "fields 'x' at offset 0 and 'y' at 0 overlap": lambda c: change_field(c, 'y', offset=0),
    "fields 'x' at offset 0 and 'z' at 4 overlap": lambda c: change_field(c, 'z', offset=4),
    'ends beyond point_step 0': lambda c: change(c, point_step=0),
    'row_step 119 is less than width 5 x point_step 24': lambda c: change(c, row_step=119),
    'row_step 0 is less': lambda c: change(c, row_step=0),
    f'less than width {HUGE}': lambda c: change(c, width=HUGE, height=HUGE),
    'data has 119 bytes': lambda c: change(c, data=np.zeros(119, np.uint8)),
    'data has 0 bytes': lambda c: change(c, data=np.zeros(0, np.uint8)),
    'height 2 x row_step 120': lambda c: change(c, height=2),
    f'height {HUGE} x row_step 120': lambda c: change(c, height=HUGE),
    f'height 1 x row_step {HUGE}': lambda c: change(c, row_step=HUGE),
    f'height {HUGE} x row_step {HUGE}': lambda c: change(c, height=HUGE, row_step=HUGE),
}


@pytest.mark.parametrize('text', BAD_CLOUDS)
def test_bad_cloud_is_refused_in_one_line_before_memory_is_taken(text):
    cloud = make('point_cloud2')
    BAD_CLOUDS[text](cloud)
    with pytest.raises(MessageError) as error:
        read_one(cloud)
    assert text in str(error.value)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(('height', 'width'), [(0, 5), (1, 0), (HUGE, 0), (0, HUGE), (0, 0)])
def test_cloud_without_rows_or_columns_is_empty(height, width):
    cloud = make('point_cloud2')
    change(cloud, height=height, width=width, row_step=0, data=np.zeros(0, np.uint8))
    assert read_one(cloud).points.shape == (0, 3)


# Marker: pose and actions


@st.composite
def quaternions(draw):
    q = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 4)))
    return q if np.linalg.norm(q) > 1e-3 else np.array([0.0, 0.0, 0.0, 1.0])


@given(quaternions(), st.floats(0.01, 100))
def test_marker_pose_moves_its_points_as_the_sandwich_product_does(q, scale):
    message = make('marker')
    x, y, z, w = (q * scale).tolist()
    message.pose = Pose(
        position=Point(x=1.0, y=-2.0, z=3.0), orientation=Quaternion(x=x, y=y, z=z, w=w)
    )
    # v + 2w (u x v) + 2u x (u x v), with u the vector part of the unit quaternion
    unit = q / np.linalg.norm(q)
    turned = 2 * np.cross(unit[:3], POINTS)
    expected = POINTS + unit[3] * turned + np.cross(unit[:3], turned) + [1, -2, 3]
    np.testing.assert_allclose(read_one(message).points, expected, atol=1e-12)


def test_quarter_turn_about_z_takes_x_to_y():
    message = make('marker', np.array([[1.0, 0.0, 0.0]]))
    message.pose.orientation = Quaternion(z=math.sqrt(0.5), w=math.sqrt(0.5))
    np.testing.assert_allclose(read_one(message).points, [[0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize('w', [0.0, 1.0, -1.0, 0.3])
def test_orientation_without_a_turn_leaves_the_points_exactly(w):
    message = make('marker')
    message.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=w)
    assert read_one(message).points.tolist() == POINTS.tolist()


@pytest.mark.parametrize('value', [math.inf, math.nan])
@pytest.mark.parametrize('field', ['position.y', 'orientation.x', 'orientation.w'])
def test_marker_pose_that_is_not_finite_blanks_all_rows(field, value):
    message = make('marker')
    part, name = field.split('.')
    setattr(getattr(message.pose, part), name, value)
    frame = read_one(message)
    assert frame.points.shape == (5, 3)
    assert np.isnan(frame.points).all()


def test_point_not_finite_in_a_turned_marker_blanks_only_its_row():
    message = make('marker')
    message.points[1].z = math.inf
    message.pose.orientation = Quaternion(z=1.0, w=0.0)
    points = read_one(message).points
    assert np.isnan(points).all(axis=1).tolist() == [False, True, False, False, False]


@pytest.mark.parametrize('action', [Marker.DELETE, Marker.DELETEALL])
def test_deleted_marker_has_no_points(action):
    message = make('marker')
    message.action = action
    frame = read_one(message)
    assert (frame.stamp, frame.frame_id, frame.identities) == (STAMP, 'lab', ())
    assert frame.points.shape == (0, 3)


def test_a_marker_that_is_one_thing_is_refused_with_the_way_to_send_all():
    with pytest.raises(MessageError, match='send all markers of a frame in one message'):
        read_one(Marker(type=Marker.SPHERE))
    # A list may be empty: nothing is seen.
    assert read_one(Marker(type=Marker.SPHERE_LIST)).identities == ()


# MarkerArray: actions and header


def test_deletions_in_an_array_leave_what_a_viewer_would_show():
    array = MarkerArray(
        markers=[
            marker('a', 0, 1.0, sec=1),
            marker('b', 0, 2.0, sec=2),
            marker(action=Marker.DELETEALL, sec=3),
            marker('c', 0, 3.0, sec=4, frame_id='lab'),
            marker('d', 0, 4.0, sec=5),
            marker('b', 0, action=Marker.DELETE, sec=6),
            marker('b', 0, 5.0, sec=7, frame_id='lab'),
            marker('d', 0, action=Marker.DELETE, sec=8),
        ]
    )
    frame = read_one(array)
    assert frame.identities == ('c/0', 'b/0')
    assert frame.points[:, 0].tolist() == [3.0, 5.0]
    assert (frame.stamp, frame.frame_id) == (4_000_000_000, 'lab')
    # The index is the place in the array, so a deletion renames nobody.
    assert read_one(array, 'index').identities == ('3', '6')


def test_an_array_with_markers_in_several_frames_is_refused():
    frames = ['crank', 'coupler', 'rocker']
    array = MarkerArray(markers=[marker(number=k, frame_id=f) for k, f in enumerate(frames)])
    with pytest.raises(MessageError, match="in 3 frames, as 'coupler', 'crank': publish all"):
        read_markers(array)
    # What is deleted may be in any, and what names none is taken to be where the others are.
    array.markers[0].action = Marker.DELETE
    array.markers[2].header.frame_id = ''
    assert read_one(array).frame_id == 'coupler'
    array.markers.reverse()
    assert read_one(array).frame_id == 'coupler'


QUARTER = Quaternion(z=np.sqrt(0.5), w=np.sqrt(0.5))  # of a turn about z


@pytest.mark.parametrize('kind', [Marker.SPHERE_LIST, Marker.CUBE_LIST, Marker.POINTS])
@pytest.mark.parametrize(
    ('identity', 'names'),
    [('auto', ('tip/3', 'l/7/0', 'l/7/1', 'end/9')), ('id', ('3', '7/0', '7/1', '9')),
     ('ns', ('tip', 'l/0', 'l/1', 'end')), ('index', ('0', '1/0', '1/1', '2'))],
)  # fmt: skip
def test_points_of_a_list_in_an_array_are_markers(kind, identity, names):
    points = [Point(x=1.0), Point(x=2.0)]
    pose = Pose(position=Point(x=5.0), orientation=QUARTER)
    of_list = Marker(ns='l', id=7, type=kind, points=points, pose=pose)
    frame = read_one(
        MarkerArray(markers=[marker('tip', 3, 0.5), of_list, marker('end', 9, 0.7)]), identity
    )
    assert frame.identities == names
    expected = [(0.5, 0, 0), (5, 1, 0), (5, 2, 0), (0.7, 0, 0)]
    np.testing.assert_allclose(frame.points, expected, atol=1e-12)


def test_drawings_in_an_array_are_no_markers_and_are_counted():
    """A label is in another frame, and a deletion of all is before them, as drivers send them."""
    drawings = [
        Marker(ns='t', id=k, type=Marker.TEXT_VIEW_FACING, text='tip', pose=Pose()) for k in (0, 1)
    ]
    drawings += [
        Marker(id=5, type=Marker.LINE_STRIP, points=[Point(), Point(x=1.0)]),
        Marker(id=6, type=Marker.ARROW), Marker(id=8, type=Marker.MESH_RESOURCE),
    ]  # fmt: skip
    drawings[0].header.frame_id, drawings[0].header.stamp.sec = 'base', 9
    spheres = [marker('a', 0, 1.0, sec=2, frame_id='lab'), marker('b', 0, 2.0, frame_id='lab')]
    markers = [marker(action=Marker.DELETEALL, sec=9), *drawings[:2], *spheres, *drawings[2:]]
    frame = read_one(MarkerArray(markers=markers))
    assert (frame.identities, frame.stamp, frame.frame_id) == (('a/0', 'b/0'), 2 * 10**9, 'lab')
    assert frame.points[:, 0].tolist() == [1.0, 2.0]
    reader = MarkerReader('marker_array')
    assert reader.fault() is None
    reader.read([serialize_message(MarkerArray(markers=markers))] * 3)
    fault = reader.fault()
    assert fault is not None
    assert fault.values == {'drawings': '2 texts, 1 line strips, 1 arrows, 1 meshes'}
    # Hidden markers leave a frame without any.
    markers = [markers[0], *drawings]
    frame = read_one(MarkerArray(markers=markers))
    assert (frame.identities, frame.stamp) == ((), 9 * 10**9)


def test_array_of_deletions_keeps_the_first_header():
    array = MarkerArray(
        markers=[marker(action=Marker.DELETEALL, sec=3, frame_id='lab'), marker(action=2, sec=4)]
    )
    frame = read_one(array)
    assert (frame.stamp, frame.frame_id, frame.identities) == (3_000_000_000, 'lab', ())
    assert frame.points.shape == (0, 3)


@pytest.mark.parametrize('name', ['a\nb', '\x1b[2J', 'a' * 100_000])
def test_a_name_in_an_error_neither_breaks_the_line_nor_fills_the_screen(name):
    with pytest.raises(MessageError, match='2 times') as error:
        read_one(MarkerArray(markers=[marker(name), marker(name)]), 'ns')
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 250


@pytest.mark.parametrize('markers', [[], [Marker(action=Marker.DELETEALL)]])
def test_an_array_without_markers_and_so_without_time_is_refused(markers):
    """As a stamp of 0 it would be a jump of the clock, and all learned would be forgotten."""
    with pytest.raises(MessageError, match='MarkerArray without markers has no stamp'):
        read_one(MarkerArray(markers=markers))


def test_markers_that_disagree_in_stamp_take_the_first():
    array = MarkerArray(markers=[marker('a', sec=9), marker('b', sec=5)])
    assert read_one(array).stamp == 9_000_000_000


# Identities


@pytest.mark.parametrize(
    ('identity', 'expected'),
    [
        ('auto', ('left/7', '8', 'right/-1')),
        ('ns_id', ('left/7', '8', 'right/-1')),
        ('id', ('7', '8', '-1')),
        ('ns', ('left', '', 'right')),
        ('index', ('0', '1', '2')),
    ],
)
def test_identities_of_an_array(identity, expected):
    array = MarkerArray(markers=[marker('left', 7), marker('', 8), marker('right', -1)])
    assert read_one(array, identity).identities == expected


@pytest.mark.parametrize(
    ('identity', 'markers', 'name'),
    [
        ('auto', [('a', 1), ('b', 1), ('a', 1)], "'a/1' 2 times"),
        ('ns_id', [('', 1), ('b', 1), ('', 1)], "'1' 2 times"),
        ('id', [('a', 1), ('b', 1), ('c', 2)], "'1' 2 times"),
        ('ns', [('b', 1), ('b', 2), ('b', 3)], "'b' 3 times"),
    ],
)
def test_duplicate_identity_in_an_array_is_refused_by_name(identity, markers, name):
    array = MarkerArray(markers=[marker(ns, number) for ns, number in markers])
    with pytest.raises(MessageError, match=name) as error:
        read_one(array, identity)
    assert 'another marker_identity' in str(error.value)
    assert read_one(array, 'index').identities == ('0', '1', '2')


@pytest.mark.parametrize('kind', INDEX_KINDS)
@pytest.mark.parametrize('identity', ['id', 'ns', 'ns_id'])
def test_types_without_identities_say_so(kind, identity):
    with pytest.raises(MessageError, match='set marker_identity to auto or index'):
        read_one(make(kind), identity)


@pytest.mark.parametrize('datatype', range(1, 7))
@pytest.mark.parametrize('big', [False, True])
def test_integer_field_id_of_a_cloud_is_read_only_when_asked(datatype, big):
    bits = 8 * SIZES[datatype]
    signed = CODES[datatype].islower()
    ids = [-(2 ** (bits - 1)), 2 ** (bits - 1) - 1, 5] if signed else [2**bits - 1, 0, 5]
    cloud = cloud_with_ids(ids, datatype, big)
    assert read_one(cloud, 'id').identities == tuple(map(str, ids))
    assert read_one(cloud).identities == ('0', '1', '2')
    assert read_one(cloud, 'index').identities == ('0', '1', '2')
    for identity in ('ns', 'ns_id'):
        with pytest.raises(MessageError, match='no identities but the index'):
            read_one(cloud, identity)


def test_bad_field_id_of_a_cloud_is_refused_when_asked():
    with pytest.raises(MessageError, match="'4' 2 times"):
        read_one(cloud_with_ids([4, 3, 4]), 'id')
    with pytest.raises(MessageError, match="'id' has datatype 7: publish it as an integer"):
        read_one(cloud_with_ids([1.0, 2.0], PointField.FLOAT32), 'id')
    cloud = cloud_with_ids([1, 2])
    change_field(cloud, 'id', offset=9)
    with pytest.raises(MessageError, match="'id' at offset 9 ends beyond"):
        read_one(cloud, 'id')
    assert len(read_one(cloud).points) == 2


def test_unknown_identity_is_refused():
    with pytest.raises(ValueError, match="identity 'name' is unknown: use one of auto, index"):
        read_one(PoseArray(), 'name')


def test_message_of_another_type_is_refused():
    with pytest.raises(MessageError, match=r'Header is not .*sensor_msgs/msg/PointCloud2'):
        read_one(Header())


# to_message and stamps


def test_to_message_refuses_what_it_cannot_hold():
    with pytest.raises(ValueError, match="kind 'pose' is unknown: use one of marker_array"):
        make('pose')
    with pytest.raises(ValueError, match=r'shape \(5, 2\), expected \(5, 3\)'):
        make('marker', POINTS[:, :2])
    with pytest.raises(ValueError, match=r'shape \(5, 3\), expected \(4, 3\)'):
        make('marker', names=NAMES[:4])


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamp_round_trips_exactly(ns):
    stamp = ns_to_stamp(ns)
    assert stamp_to_ns(stamp) == ns
    assert 0 <= stamp.nanosec < 10**9


@pytest.mark.parametrize('ns', [-1, 2**31 * 10**9])
def test_stamp_out_of_range_is_refused(ns):
    with pytest.raises(ValueError, match='out of range'):
        ns_to_stamp(ns)


@pytest.mark.parametrize('kind', MARKER_TYPES)
def test_a_stamp_before_the_beginning_of_time_is_refused(kind: str) -> None:
    message = to_message(kind, 0, 'world', ['a', 'b'], np.zeros((2, 3)))
    for header in [m.header for m in getattr(message, 'markers', [message])]:
        header.stamp.sec = -1
    with pytest.raises(MessageError, match=r'header\.stamp is -1 s'):
        read_one(message)


@given(
    names=st.lists(st.text('aé_ 1中', max_size=9), max_size=6),
    frame_id=st.sampled_from(['', 'world', 'läb', 'lab_1']),
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.0, 0.3, 1.0]),
)
def test_arrays_of_markers_are_the_bytes_of_the_messages(names, frame_id, seed, share) -> None:
    generator = np.random.default_rng(seed)
    stamps = np.sort(generator.integers(0, 2**31 * 10**9, 5))
    points = generator.normal(size=(5, len(names), 3)) * 10.0 ** generator.integers(-9, 9)
    points[generator.random(points.shape) < share / 3] = np.nan
    points[generator.random(points.shape) < share / 9] = np.inf
    expected = [
        serialize_message(to_message('marker_array', stamp, frame_id, names, frame))
        for stamp, frame in zip(stamps.tolist(), points, strict=True)
    ]
    assert marker_arrays(stamps, frame_id, names, points) == expected
