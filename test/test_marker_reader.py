"""Read from their bytes, markers are what the ordinary way makes of them, whatever the bytes."""

import struct

import numpy as np
import pytest
from fuzz_messages import fuzz_messages
from read_objects import ordinary
from test_marker_messages import KINDS, assert_same, make, marker, one_by_one

from kinpole_ros.messages import (
    MarkerReader,
    MessageError,
    read_markers,
    serialize_message,
    to_message,
)
from kinpole_ros.messages import _reader as module
from kinpole_ros.messages._offsets import MessageOffsets
from kinpole_ros.messages._types import Header, Marker, MarkerArray, Point, Pose, PoseArray

IDENTITIES = ['auto', 'index', 'id', 'ns', 'ns_id']


def serialized(kind, count=20, markers=4, seed=0):
    """Messages of one layout whose markers move."""
    points = np.random.default_rng(seed).normal(size=(count, markers, 3))
    names = [f'm{k}' for k in range(markers)]
    return [
        serialize_message(to_message(kind, 10**9 + 7 * k, 'lab', names, rows))
        for k, rows in enumerate(points)
    ]


@pytest.fixture
def only_bytes(monkeypatch):
    """From when this is called on, no message may have a new layout."""

    def start():
        def refuse(kind, identity, data):
            MessageOffsets(kind, data)
            pytest.fail('the layout of a message was made')

        monkeypatch.setattr(module, '_make_layout', refuse)

    return start


@pytest.mark.parametrize('kind', KINDS)
def test_messages_of_one_layout_are_read_together_at_once(kind, only_bytes):
    messages = serialized(kind, 100)
    expected = [ordinary(kind, data) for data in messages]
    reader = MarkerReader(kind)
    reader.read(messages[:1])
    only_bytes()
    [frames] = reader.read(messages)
    assert frames.points.shape == (100, 4, 3)
    for found, one in zip(one_by_one([frames]), expected, strict=True):
        assert_same(found, one)


@pytest.mark.parametrize('kind', KINDS)
def test_frames_do_not_share_memory_with_messages_and_can_be_written(kind):
    reader = MarkerReader(kind)
    for frames in reader.read(serialized(kind, 3)) + reader.read(serialized(kind, 3)):
        assert frames.points.flags.writeable


@pytest.mark.parametrize('kind', KINDS)
def test_a_byte_that_may_differ_in_a_layout_decides_one_figure_at_most(kind, only_bytes):
    data = serialized(kind, 1)[0]
    reader = MarkerReader(kind)
    [expected] = reader.read([data])
    only_bytes()
    kept = 0
    for place in range(4, len(data)):
        other = bytearray(data)
        other[place] ^= 0x55
        try:
            [found] = reader.read([bytes(other)])
        except pytest.fail.Exception:
            continue
        if isinstance(found, MessageError):
            continue
        kept += 1
        names = zip(found.identities, expected.identities, strict=True)
        changed = int(found.stamps[0] != expected.stamps[0])
        changed += sum(name != other for name, other in names)
        changed += np.count_nonzero(~(found.points == expected.points).all(axis=-1))
        # The place of a Marker moves all its points.
        assert changed <= (4 if kind == 'marker' else 1)
    assert kept > 8 + 4 * 24


def test_padding_does_not_make_a_layout(only_bytes):
    data = serialized('pose_array', 1)[0]
    # After 20 bytes of header and the count, up to the first double.
    garbage = [data[:24] + bytes([k] * 4) + data[28:] for k in range(9)]
    reader = MarkerReader('pose_array')
    reader.read([data])
    only_bytes()
    [frames] = reader.read(garbage)
    assert_same(
        frames._replace(stamps=frames.stamps[:1], points=frames.points[:1]), *reader.read([data])
    )


def test_what_is_only_drawn_may_change_at_will(only_bytes):
    array = make('marker_array')
    reader = MarkerReader('marker_array')
    reader.read([serialize_message(array)])
    for k, one in enumerate(array.markers):
        one.color.r, one.scale.z = 0.1 * k, 3.0
        one.lifetime.sec = k
        one.pose.orientation.x = 0.5
        one.frame_locked = True
        if k:
            one.header = Header(frame_id=array.markers[0].header.frame_id)
    expected = read_markers(array)
    only_bytes()
    [frames] = reader.read([serialize_message(array)])
    assert_same(frames, expected)


def test_markers_that_become_lists_of_points_are_read_as_such():
    array = make('marker_array')
    for one in array.markers:
        one.points = [Point(), Point(x=1.0)]
    reader = MarkerReader('marker_array')
    [frames] = reader.read([serialize_message(array)])
    assert_same(frames, read_markers(array))
    for one in array.markers:
        one.type = Marker.POINTS
    [lists] = reader.read([serialize_message(array)])
    assert_same(lists, read_markers(array))
    assert len(lists.identities) == 2 * len(frames.identities)


def test_an_empty_list_that_becomes_a_sphere_is_refused():
    reader = MarkerReader('marker')
    [frames] = reader.read([serialize_message(Marker(type=Marker.POINTS))])
    assert frames.identities == ()
    [error] = reader.read([serialize_message(Marker(type=Marker.SPHERE))])
    assert 'Marker has no points' in str(error)


@pytest.mark.parametrize('change', ['ns', 'id', 'action', 'frame_id'])
@pytest.mark.parametrize('identity', IDENTITIES)
def test_what_decides_the_names_is_looked_at(change, identity):
    arrays = [make('marker_array') for _ in range(3)]
    for array, value in zip(arrays, (1, 2, 2), strict=True):
        first = array.markers[0]
        first.ns = f'n{value}' if change == 'ns' else 'n0'
        first.id = 10 * value if change == 'id' else 5
        first.action = value if change == 'action' else 0
        first.header.frame_id = f'lab{value}' if change == 'frame_id' else 'lab0'
    data = [serialize_message(array) for array in arrays]
    found = one_by_one(MarkerReader('marker_array', identity).read(data * 2))
    for one, array in zip(found, arrays * 2, strict=True):
        assert_same(one, read_markers(array, identity))


@pytest.mark.parametrize('identity', IDENTITIES)
def test_a_marker_that_goes_into_another_frame_is_noticed(identity):
    array = make('marker_array')
    good = serialize_message(array)
    array.markers[-1].header = Header(frame_id=array.markers[0].header.frame_id[::-1])
    bad = serialize_message(array)
    assert len(bad) == len(good) and bad != good
    found = one_by_one(MarkerReader('marker_array', identity).read([good, bad, good]))
    assert isinstance(found[1], MessageError)
    assert_same(found[0], found[2])


def test_names_that_are_not_asked_for_may_count_up(only_bytes):
    reader = MarkerReader('marker_array', 'ns')
    arrays = [make('marker_array') for _ in range(3)]
    for k, array in enumerate(arrays):
        for one in array.markers:
            one.id += 100 * k
    data = [serialize_message(array) for array in arrays]
    reader.read(data[:1])
    only_bytes()
    [frames] = reader.read(data)
    assert frames.identities == tuple('abcde')


@pytest.mark.parametrize('identity', IDENTITIES)
def test_deletions_in_an_array_are_read_as_the_ordinary_way_does(identity):
    array = MarkerArray(
        markers=[
            marker('a', 0, 1.0, sec=1),
            marker(action=Marker.DELETEALL, sec=3),
            marker('c', 5, 3.0, sec=4, frame_id='lab'),
            marker('b', 6, action=Marker.DELETE, sec=6),
            marker('d', 7, 4.0, sec=5),
        ]
    )
    reader = MarkerReader('marker_array', identity)
    for number in (6, 5, 7, 6, 5, 7):
        array.markers[3].id = number
        array.markers[3].ns = 'c' if number == 5 else 'd'
        for _ in range(2):
            [found] = reader.read([serialize_message(array)])
            assert_same(found, read_markers(array, identity))


@pytest.mark.parametrize('kind', KINDS)
def test_results_are_in_order_with_good_messages_around_bad_ones(kind):
    a, b = serialized(kind, 40), serialized(kind, 40, markers=3, seed=1)
    early = bytearray(a[0])
    stamp = 8 if kind == 'marker_array' else 4
    early[stamp : stamp + 4] = struct.pack('<i', -1)
    messages = [*a[:9], b'', *a[9:12], bytes(early), a[12], *b[:5], a[13], b[5], a[14], b[6]]
    messages += [a[15][:-9], *b[7:], b'\x00\x01', *a[16:]]
    found = MarkerReader(kind).read(messages)
    # Some are together, and still there is one for each message.
    assert len(found) < len(messages) - 40
    for one, data in zip(one_by_one(found), messages, strict=True):
        expected = ordinary(kind, data)
        if isinstance(expected, MessageError):
            assert isinstance(one, MessageError)
            assert '\n' not in str(one)
        else:
            assert_same(one, expected)
    assert sum(isinstance(one, MessageError) for one in found) == 4


@pytest.mark.parametrize('kind', KINDS)
def test_markers_that_come_and_go_are_read_right_however_many_layouts_they_make(kind):
    generator = np.random.default_rng(2)
    messages = []
    for k in range(150):
        points = generator.normal(size=(12, 3))
        points[generator.random(12) < 0.3] = np.nan
        message = to_message(kind, k, 'lab', [f'm{j}' for j in range(12)], points)
        messages.append(serialize_message(message))
    reader = MarkerReader(kind)
    for _ in range(2):
        found = one_by_one(reader.read(messages))
        for one, data in zip(found, messages, strict=True):
            assert_same(one, ordinary(kind, data))


@pytest.mark.parametrize('identity', IDENTITIES[1:])
def test_names_that_come_and_go_need_no_new_layout(identity, only_bytes):
    generator = np.random.default_rng(4)
    messages, expected = [], []
    for k in range(200):
        points = generator.normal(size=(12, 3))
        points[generator.choice(12, 4, replace=False)] = np.nan
        array = to_message('marker_array', k, 'lab', [f'm{j:02}' for j in range(12)], points)
        messages.append(serialize_message(array))
        expected.append(read_markers(array, identity))
    reader = MarkerReader('marker_array', identity)
    reader.read(messages[:1])
    only_bytes()
    for found, one in zip(one_by_one(reader.read(messages)), expected, strict=True):
        assert_same(found, one)


@pytest.mark.parametrize('name', ['caf\u00e9'.encode(), b'a\0cde', b'abcde', b'\xff\xfe\xfd\xfc\0'])
def test_names_that_are_not_plain_are_read_as_rclpy_does(name):
    data = serialize_message(make('marker_array', names=['abcd', 'b', 'c', 'd', 'e']))
    reader = MarkerReader('marker_array', 'ns')
    reader.read([data])
    other = data.replace(b'abcd\0', name[:5].ljust(5, b'\0'))
    assert other != data
    for found in one_by_one(reader.read([other, other])):
        assert_same(found, ordinary('marker_array', other, 'ns'))


def test_a_name_that_comes_twice_is_refused_among_others():
    data = serialize_message(make('marker_array'))
    reader = MarkerReader('marker_array', 'ns')
    reader.read([data])
    [good, error, last] = reader.read([data, data.replace(b'b\0', b'a\0'), data])
    assert "'a' 2 times" in str(error)
    assert_same(good, last)


def test_a_turned_marker_that_moves_is_read_as_data(only_bytes):
    message = make('marker')
    generator = np.random.default_rng(5)
    messages, expected = [], []
    for turn in generator.normal(size=(30, 4)) * (np.arange(30) % 3 > 0)[:, None]:
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = turn.tolist()
        message.pose.position.y = float(turn[0])
        messages.append(serialize_message(message))
        expected.append(read_markers(message))
    reader = MarkerReader('marker')
    reader.read(messages[:1])
    only_bytes()
    for found, one in zip(one_by_one(reader.read(messages)), expected, strict=True):
        assert_same(found, one)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('claim', [2**31, 2**32 - 1, 10_000])
def test_a_size_that_is_not_there_is_refused_before_memory_is_taken(kind, claim, only_bytes):
    data = serialized(kind, 1)[0]
    places = MessageOffsets(kind, data).sizes
    only_bytes()
    for place in places:
        claimed = data[:place] + struct.pack('<I', claim) + data[place + 4 :]
        [error] = MarkerReader(kind).read([claimed])
        assert isinstance(error, MessageError)
        assert 'the sizes in them claim more' in str(error)


@pytest.mark.parametrize(
    'message, kind',
    [
        (MarkerArray(markers=[Marker(id=7)] * 17_000), 'marker_array'),
        (Marker(points=[Point()] * 270_000), 'marker'),
        (PoseArray(poses=[Pose()] * 270_000), 'pose_array'),
    ],
)
def test_more_than_anyone_tracks_is_refused_before_memory_is_taken(message, kind, only_bytes):
    """As objects of rclpy's, 22 MB of markers take 360 MB and 12 s."""
    data = serialize_message(message)
    only_bytes()
    [error] = MarkerReader(kind, 'index').read([data])
    assert 'are too much: more than 16384 markers, or 262144 poses' in str(error)


def test_a_cloud_may_have_more_points_than_other_messages():
    [cloud] = serialized('point_cloud2', 1, markers=270_000)
    [frames] = MarkerReader('point_cloud2').read([cloud])
    assert frames.points.shape == (1, 270_000, 3)


@pytest.mark.parametrize('kind', KINDS)
def test_a_stamp_that_ros_cannot_hold_is_refused_among_others(kind):
    messages = serialized(kind, 9)
    place = 8 if kind == 'marker_array' else 4
    late = struct.pack('<iI', 2**31 - 1, 2**32 - 1)
    messages[5] = messages[5][:place] + late + messages[5][place + 8 :]
    for _ in range(2):
        found = one_by_one(MarkerReader(kind).read(messages))
        assert [k for k, one in enumerate(found) if isinstance(one, MessageError)] == [5]
        assert 'more than a ROS time holds' in str(found[5])
        assert_same(found[8], ordinary(kind, messages[8]))


def test_a_big_endian_message_is_read():
    header = struct.pack('>iI', 3, 4) + struct.pack('>I4s', 4, b'lab\0')
    poses = np.arange(14.0)
    data = b'\0\0\0\0' + header + struct.pack('>I', 2) + bytes(4) + poses.astype('>f8').tobytes()
    for found in one_by_one(MarkerReader('pose_array').read([data] * 3)):
        assert (found.stamps[0], found.frame_id) == (3_000_000_004, 'lab')
        assert found.points[0].tolist() == [[0, 1, 2], [7, 8, 9]]
    [error] = MarkerReader('pose_array').read([data[:20] + b'\xff' + data[21:]])
    assert isinstance(error, MessageError)


def test_another_encoding_is_refused():
    data = serialized('pose_array', 1)[0]
    for head in (b'\x00\x03', b'\x01\x01', b'\x00\x07'):
        [error] = MarkerReader('pose_array').read([head + data[2:]])
        assert 'plain CDR' in str(error)


def test_corrupted_messages_are_read_as_the_ordinary_way_does_or_refused(tmp_path):
    outcomes = fuzz_messages(4000, seed=3, folder=tmp_path)
    assert sum(outcomes.values()) == 4000
    assert len(outcomes) == 3 * len(KINDS)
    assert min(outcomes.values()) > 40


@pytest.mark.parametrize('kind', KINDS)
def test_a_stamp_beyond_the_end_of_time_is_refused_in_a_known_layout(kind):
    message = make(kind)
    good = serialize_message(message)
    for header in [m.header for m in getattr(message, 'markers', [message])]:
        header.stamp.sec, header.stamp.nanosec = 2**31 - 1, 10**9
    reader = MarkerReader(kind)
    reader.read([good])
    first, error, last = reader.read([good, serialize_message(message), good])
    assert 'more than a ROS time holds' in str(error)
    assert_same(first, last)
