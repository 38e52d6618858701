"""Bags of other storages, and messages of trackers, are read by the definitions in the bag."""

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zstandard
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_formats import peak_memory

from kinpole_ros.bags import (
    BagError,
    BagWriter,
    Truncated,
    import_points,
    read_messages,
    replay,
    topics,
)
from kinpole_ros.messages import (
    INPUT_TYPES,
    PoseReader,
    deserialize_message,
    marker_arrays,
    poses_data,
    to_message,
)
from kinpole_ros.messages._types import MarkerArray
from kinpole_ros.settings import load_settings
from kinpole_ros.tools.cli import main

ROOT = Path(__file__).parents[2]
FIRST = 1_700_000_000_123_456_789  # ns
STEP = 10_000_000  # ns
PLACES = np.random.default_rng(3).normal(size=(5, 2, 3)).round(3)
HEAD = 'std_msgs/Header header\nuint32 frame_number\n'
# As the packages of these types define them.
TYPES = {
    'mocap4r2_msgs/msg/Marker': 'int8 USE_NAME=0\nint8 USE_INDEX=1\nint8 USE_BOTH=2\nint8 id_type\n'
    'int32 marker_index\nstring marker_name\ngeometry_msgs/Point translation\n',
    'mocap4r2_msgs/msg/Markers': f'{HEAD}mocap4r2_msgs/Marker[] markers\n',
    'mocap4r2_msgs/msg/RigidBody': 'string rigid_body_name\nmocap4r2_msgs/Marker[] markers\n'
    'geometry_msgs/Pose pose\n',
    'mocap4r2_msgs/msg/RigidBodies': f'{HEAD}mocap4r2_msgs/RigidBody[] rigidbodies\n',
    'motion_capture_tracking_interfaces/msg/NamedPose': 'string name\ngeometry_msgs/Pose pose\n',
    'motion_capture_tracking_interfaces/msg/NamedPoseArray': 'std_msgs/Header header\n'
    'motion_capture_tracking_interfaces/NamedPose[] poses\n',
}


class Maker:
    """Makes messages of ROS 1 or 2 with the classes of rosbags."""

    def __init__(self, stores: Stores) -> None:
        self.store: Any = get_typestore(stores)
        self.is_ros1 = stores == Stores.ROS1_NOETIC
        for name, text in TYPES.items():
            self.store.register(get_types_from_msg(text, name))

    def make(self, name: str, *values: Any) -> Any:
        package, short = name.split('/')
        return self.store.types[f'{package}/msg/{short}'](*values)

    def header(self, stamp: int) -> Any:
        time = self.make('builtin_interfaces/Time', stamp // 10**9, stamp % 10**9)
        return self.make('std_msgs/Header', *[7][: self.is_ros1], time, 'world')

    def point(self, place: Any) -> Any:
        return self.make('geometry_msgs/Point', *map(float, place))

    def pose(self, place: Any, turn: Any = (0, 0, 0.6, 0.8)) -> Any:
        quaternion = self.make('geometry_msgs/Quaternion', *map(float, turn))
        return self.make('geometry_msgs/Pose', self.point(place), quaternion)


def mocap_markers(m: Maker, k: int, topic: str) -> Any:
    first, second = PLACES[k]
    markers = [
        m.make('mocap4r2_msgs/Marker', 2, 0, 'tip', m.point(first)),
        m.make('mocap4r2_msgs/Marker', 1, 7, '', m.point(second)),
    ]
    return m.make('mocap4r2_msgs/Markers', m.header(FIRST + k * STEP), k, markers)


def rigid_bodies(m: Maker, k: int, topic: str) -> Any:
    bodies = [
        m.make('mocap4r2_msgs/RigidBody', name, [], m.pose(place))
        for name, place in zip(('arm', 'rod'), PLACES[k], strict=True)
    ]
    return m.make('mocap4r2_msgs/RigidBodies', m.header(FIRST + k * STEP), k, bodies)


def named_poses(m: Maker, k: int, topic: str) -> Any:
    package = 'motion_capture_tracking_interfaces'
    poses = [
        m.make(f'{package}/NamedPose', name, m.pose(place))
        for name, place in zip(('arm', 'rod'), PLACES[k], strict=True)
    ]
    return m.make(f'{package}/NamedPoseArray', m.header(FIRST + k * STEP), poses)


def stamped_pose(m: Maker, k: int, topic: str) -> Any:
    """The second body is stamped a little later."""
    body = int('rod' in topic)
    header = m.header(FIRST + k * STEP + body * 2000)
    return m.make('geometry_msgs/PoseStamped', header, m.pose(PLACES[k, body]))


def pose_array(m: Maker, k: int, topic: str) -> Any:
    poses = [m.pose(place) for place in PLACES[k]]
    return m.make('geometry_msgs/PoseArray', m.header(FIRST + k * STEP), poses)


def marker_array(m: Maker, k: int, topic: str) -> Any:
    """In the layout of ROS 1, which has no textures."""
    ones = m.make('geometry_msgs/Vector3', 1.0, 1.0, 1.0)
    color = m.make('std_msgs/ColorRGBA', 1.0, 1.0, 1.0, 1.0)
    life = m.make('builtin_interfaces/Duration', 0, 0)
    markers = [
        m.make('visualization_msgs/Marker', m.header(FIRST + k * STEP), 'rig', number, 2, 0,
               m.pose(place), ones, color, life, False, [], [], 'text', '', False)
        for number, place in enumerate(PLACES[k])
    ]  # fmt: skip
    label = m.make(
        'visualization_msgs/Marker',
        m.header(FIRST + k * STEP),
        'label',
        0,
        9,
        0,
        m.pose((9, 9, 9)),
        ones,
        color,
        life,
        False,
        [],
        [],
        'tip',
        '',
        False,
    )
    return m.make('visualization_msgs/MarkerArray', [label, *markers])


def cloud(m: Maker, k: int, topic: str) -> Any:
    fields = [m.make('sensor_msgs/PointField', axis, 8 * n, 8, 1) for n, axis in enumerate('xyz')]
    data = np.frombuffer(PLACES[k].astype('<f8').tobytes(), np.uint8)
    header = m.header(FIRST + k * STEP)
    return m.make('sensor_msgs/PointCloud2', header, 1, 2, fields, False, 24, 48, data, True)


Kind = tuple[dict[str, str], Callable[[Maker, int, str], Any], tuple[str, ...]]
KINDS: dict[str, Kind] = {
    'mocap4r2 markers': ({'/m': 'mocap4r2_msgs/msg/Markers'}, mocap_markers, ('tip', '7')),
    'mocap4r2 bodies': ({'/b': 'mocap4r2_msgs/msg/RigidBodies'}, rigid_bodies, ('arm', 'rod')),
    'named poses': (
        {'/poses': 'motion_capture_tracking_interfaces/msg/NamedPoseArray'},
        named_poses,
        ('arm', 'rod'),
    ),
    'a topic each': (
        {f'/vrpn/{name}/pose': 'geometry_msgs/msg/PoseStamped' for name in ('arm', 'rod')},
        stamped_pose,
        ('arm', 'rod'),
    ),
    'pose array': ({'/markers': 'geometry_msgs/msg/PoseArray'}, pose_array, ('0', '1')),
    'point cloud': ({'/points': 'sensor_msgs/msg/PointCloud2'}, cloud, ('0', '1')),
    'marker array': (
        {'/markers': 'visualization_msgs/msg/MarkerArray'},
        marker_array,
        ('rig/0', 'rig/1'),
    ),
}
POSED = ('mocap4r2 bodies', 'named poses', 'a topic each')
STORAGES: dict[str, Any] = {
    'mcap': StoragePlugin.MCAP,
    'db3': StoragePlugin.SQLITE3,
    'bag': None,
    'bz2': Ros1Writer.CompressionFormat.BZ2,
    'lz4': Ros1Writer.CompressionFormat.LZ4,
}
# Messages of ROS 1 have a MarkerArray of their own.
CASES = [
    (kind, storage)
    for kind in KINDS
    for storage in STORAGES
    if kind != 'marker array' or storage in ('bag', 'bz2', 'lz4')
]


@cache
def makers() -> SimpleNamespace:
    return SimpleNamespace(ros1=Maker(Stores.ROS1_NOETIC), ros2=Maker(Stores.ROS2_JAZZY))


def write_bag(folder: Path, kind: str, storage: str) -> Path:
    """A bag of five frames."""
    types, make, _ = KINDS[kind]
    if storage in ('mcap', 'db3'):
        maker, path = makers().ros2, folder / 'bag'
        writer: Any = Ros2Writer(path, version=9, storage_plugin=STORAGES[storage])
        serialize = maker.store.serialize_cdr
    else:
        maker, path = makers().ros1, folder / 'run.bag'
        writer = Ros1Writer(path)
        if STORAGES[storage]:
            writer.set_compression(STORAGES[storage])
        serialize = maker.store.serialize_ros1
    with writer:
        links = {
            topic: writer.add_connection(topic, name, typestore=maker.store)
            for topic, name in types.items()
        }
        for k in range(len(PLACES)):
            for topic, name in types.items():
                message = serialize(make(maker, k, topic), name)
                writer.write(links[topic], FIRST + k * STEP + 500, message)
    return path


def markers_in(bag: Path) -> tuple[list[int], dict[str, np.ndarray]]:
    stamps, found = [], {}
    for message in read_messages(bag, ['/markers']):
        stamps.append(message.log_time)
        for marker in deserialize_message(message.data, MarkerArray).markers:
            place = marker.pose.position
            found.setdefault(marker.ns, []).append([place.x, place.y, place.z])
    return stamps, {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.parametrize(('kind', 'storage'), CASES)
def test_markers_and_poses_are_exact(tmp_path, kind, storage):
    names = KINDS[kind][2]
    done = import_points(write_bag(tmp_path, kind, storage), tmp_path / 'out.mcap')
    assert (done.format, done.markers, done.unit) == ('bag', names, 'm')
    stamps, found = markers_in(tmp_path / 'out.mcap')
    assert stamps == [FIRST + k * STEP for k in range(len(PLACES))]
    for column, name in enumerate(names):
        np.testing.assert_array_equal(found[name], PLACES[:, column])
    assert ('/tf' in topics(tmp_path / 'out.mcap')) == (kind in POSED)
    if kind in POSED:
        reader = PoseReader('tf', names)
        (frames,) = reader.read([m.data for m in read_messages(tmp_path / 'out.mcap', ['/tf'])])
        np.testing.assert_array_equal(frames.points, PLACES)
        # The quaternion (0, 0, 0.6, 0.8).
        np.testing.assert_allclose(frames.axes[..., 0, :], [[[0.28, 0.96, 0]] * 2] * 5)


def test_markers_of_one_name_in_a_message_are_numbered(tmp_path, monkeypatch):
    make = Maker.make

    def renamed(self: Maker, name: str, *values: Any) -> Any:
        is_body = name.endswith('NamedPose')
        return make(self, name, *(('arm', *values[1:]) if is_body else values))

    monkeypatch.setattr(Maker, 'make', renamed)
    done = import_points(write_bag(tmp_path, 'named poses', 'mcap'), tmp_path / 'out.mcap')
    assert done.markers == ('arm', 'arm_2')
    assert "they are numbered: 'arm_2'" in done.notes[0]


def test_an_old_db3_has_no_definitions(tmp_path):
    path = write_bag(tmp_path, 'mocap4r2 bodies', 'db3') / 'bag.db3'
    with sqlite3.connect(path) as file:
        file.execute('DROP TABLE message_definitions')
    file.close()
    assert import_points(path, tmp_path / 'out.mcap').markers == ('arm', 'rod')


def test_a_db3_is_replayed_as_an_mcap_is(tmp_path):
    source, store = ROOT / 'bags' / 'four_bar.mcap', makers().ros2.store
    with Ros2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        link = writer.add_connection(
            '/markers', 'visualization_msgs/msg/MarkerArray', typestore=store
        )
        for message in read_messages(source, ['/markers']):
            writer.write(link, message.log_time, message.data)
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml')
    for name, bag in (
        ('mcap', source), ('db3', tmp_path / 'run' / 'run.db3'), ('folder', tmp_path / 'run'),
    ):  # fmt: skip
        replay(bag, settings, csv=tmp_path / f'{name}.csv')
    tables = {(tmp_path / f'{name}.csv').read_bytes() for name in ('mcap', 'db3', 'folder')}
    assert len(tables) == 1


def test_stamps_of_zero_are_those_of_the_log(tmp_path, monkeypatch):
    header = Maker.header
    monkeypatch.setattr(Maker, 'header', lambda self, stamp: header(self, 0))
    done = import_points(write_bag(tmp_path, 'named poses', 'mcap'), tmp_path / 'out.mcap')
    assert any('log times are taken' in note for note in done.notes)
    assert markers_in(tmp_path / 'out.mcap')[0][0] == FIRST + 500


def test_a_ros1_bag_that_is_not_whole_is_refused_with_a_fix(tmp_path):
    path = write_bag(tmp_path, 'pose array', 'bag')
    content = path.read_bytes()
    for size in (len(content) // 3, content.index(b'op=\x04') - 8, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(BagError, match=r'is not a whole ROS 1 bag.*; fix: ') as e:
            import_points(path, tmp_path / 'out.mcap')
        assert '\n' not in str(e.value)


def test_a_db3_message_of_more_than_32_mib_is_named(tmp_path):
    path = write_bag(tmp_path, 'pose array', 'db3') / 'bag.db3'
    with sqlite3.connect(path) as file:
        file.execute('UPDATE messages SET data = zeroblob(33554433) WHERE id = 2')
    file.close()
    with pytest.raises(
        Truncated, match=r'bag\.db3: messages of more than 32 MiB, 1 of them, are left out; fix: '
    ):
        list(read_messages(path))
    done = import_points(path, tmp_path / 'out.mcap')
    assert done.frames == len(PLACES) - 1
    assert any('more than 32 MiB, 1 of them, are left out' in note for note in done.notes)


@pytest.mark.parametrize('command', ['replay', 'discover'])
def test_messages_of_trackers_in_place_of_markers_are_sent_to_import(tmp_path, capsys, command):
    path = tmp_path / 'bag'
    with Ros2Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        name = 'geometry_msgs/msg/TransformStamped'
        link = writer.add_connection('/m', name, typestore=makers().ros2.store)
        writer.write(link, FIRST, bytes(100))
    assert main([command, str(path), '--topic', '/m']) == 2
    assert f'`kinpole import {path} --output ' in capsys.readouterr().err


@pytest.mark.parametrize('command', ['replay', 'discover'])
def test_a_ros1_bag_in_place_of_a_bag_is_sent_to_import(tmp_path, capsys, command):
    path = write_bag(tmp_path, 'pose array', 'bag')
    assert main([command, str(path)]) == 2
    assert f'`kinpole import {path} --output ' in capsys.readouterr().err


def test_a_bag_without_markers_says_what_it_has(tmp_path):
    store = makers().ros2.store
    with Ros2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        link = writer.add_connection('/said', 'std_msgs/msg/String', typestore=store)
        message = store.types['std_msgs/msg/String']('a')
        writer.write(link, 1, store.serialize_cdr(message, 'std_msgs/msg/String'))
    with pytest.raises(BagError, match=r'only /said \(std_msgs/msg/String\); fix: record one'):
        import_points(tmp_path / 'run', tmp_path / 'out.mcap')


def test_a_bomb_in_a_bag_takes_little_memory(tmp_path):
    """A chunk of ROS 1, and messages of rosbag2, that unpack to far more than they are."""
    records = bytearray(b'#ROSBAG V2.0\n')
    packed = bz2.compress(bytes(300 << 20))
    for part in (b'\x04\0\0\0op=\x05\x0f\0\0\0compression=bz2', packed):
        records += struct.pack('<I', len(part)) + part
    (tmp_path / 'run.bag').write_bytes(records)
    path = write_bag(tmp_path, 'pose array', 'db3') / 'bag.db3'
    with sqlite3.connect(path) as file:
        bomb = zstandard.ZstdCompressor().compress(bytes(31 << 20))
        file.execute('UPDATE messages SET data = ?', [bomb])
        for _ in range(5):
            file.execute('INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, '
                         'timestamp, data FROM messages')  # fmt: skip
    file.close()
    for bag in (tmp_path / 'run.bag', path):
        peak, complaint = peak_memory(bag)
        assert peak < 400
        assert 'fix: ' in complaint


def test_messages_of_a_db3_before_the_damage_are_read(tmp_path):
    path = write_bag(tmp_path, 'named poses', 'db3') / 'bag.db3'
    with sqlite3.connect(path) as file:
        times = [time for (time,) in file.execute('SELECT timestamp FROM messages ORDER BY 1')]
        file.execute("UPDATE messages SET data = 'text' WHERE timestamp = ?", times[-1:])
    read = []
    with pytest.raises(Truncated, match=f'is damaged at time {times[-1]}'):
        for message in read_messages(path):
            read.append(message.log_time)
    assert read == times[:-1] and len(read) > 2


@pytest.mark.parametrize('kind', ['marker_array', 'point_cloud2', 'tf', 'pose_stamped'])
@pytest.mark.parametrize('swapped', [0, 3])
def test_a_recording_of_a_bag_played_in_a_loop_is_read_up_to_the_jump(tmp_path, kind, swapped):
    """With messages that overtake each other, which are no jump."""
    stamps = 10**9 + 10**7 * np.r_[0:100, 0:60]
    stamps[[20, 20 + swapped]] = stamps[[20 + swapped, 20]]
    turns = 0.05 * np.arange(160)
    with BagWriter(tmp_path / 'loop.mcap') as writer:
        for k, stamp in enumerate(stamps.tolist()):
            topic, when = '/tf' if kind == 'tf' else '/markers', 10**15 + k * 10**7
            if kind in ('tf', 'pose_stamped'):
                turn = [0, 0, np.sin(turns[k]), np.cos(turns[k])]
                data = poses_data(kind, stamp, 'world', ['rod'], np.array([[k, 1.0, 0, *turn]]))
                writer.write_raw(topic, INPUT_TYPES[kind], data, when)
            else:
                points = np.array([[k, 1.0, 0.0], [k, 2.0, 0.0]])
                writer.write(topic, to_message(kind, stamp, 'world', ['a', 'b'], points), when)
    done = import_points(tmp_path / 'loop.mcap', tmp_path / 'out.mcap')
    assert done.frames == 100
    (note,) = (note for note in done.notes if 'jump back' in note)
    assert re.search(r'stamps jump back by 0\.99 s after message 100\b.*played in a loop', note)


def two_trackers(path: Path, kind: str, rates: tuple[float, float], apart: float) -> None:
    """Bodies arm and rod of two trackers, which come together and are stamped `apart`, s."""
    events = [(k / rate, body) for body, rate in enumerate(rates) for k in range(int(rate))]
    with BagWriter(path) as writer:
        for time, body in sorted(events):
            name, topic = ('arm', 'rod')[body], '/tf'
            if kind == 'pose_stamped':
                topic = f'/vrpn/{name}/pose'
            stamp = round(1e9 * (1000 + time + body * apart))
            pose = np.array([[time, 1.0, 0, 0, 0, np.sin(time), np.cos(time)]])
            data = poses_data(kind, stamp, 'world', [name], pose)
            writer.write_raw(topic, INPUT_TYPES[kind], data, round(1e9 * (5000 + time)))


@pytest.mark.parametrize('kind', ['pose_stamped', 'tf'])
def test_bodies_stamped_by_two_clocks_are_refused_and_two_rates_are_named(tmp_path, kind):
    bag, output = tmp_path / 'two.mcap', tmp_path / 'out.mcap'
    two_trackers(bag, kind, (100.0, 100.0), 1.7e9)
    with pytest.raises(BagError, match=r'arm and rod came together, .* 1\.7e\+09 s apart, by two'):
        import_points(bag, output)
    two_trackers(bag, kind, (100.0, 120.0), 0.0)
    (note,) = import_points(bag, output).notes[:1]
    assert re.search(r'rod at 120 Hz and arm at 100 Hz: .*; fix: record each in a bag', note)
    two_trackers(bag, kind, (100.0, 100.0), 0.0)
    assert not any('Hz' in note or 'clock' in note for note in import_points(bag, output).notes)


def killed(path: Path, folder: Path) -> Path:
    """A bag as its recorder leaves it when it is killed: all but two messages are in the -wal."""
    file = sqlite3.connect(path)
    rows = file.execute('SELECT * FROM messages ORDER BY timestamp').fetchall()
    file.execute('DELETE FROM messages')
    file.executemany(f'INSERT INTO messages VALUES ({",".join("?" * len(rows[0]))})', rows[:2])
    file.commit()
    file.execute('PRAGMA journal_mode=WAL')
    file.executemany(f'INSERT INTO messages VALUES ({",".join("?" * len(rows[0]))})', rows[2:])
    file.commit()
    folder.mkdir()
    for part in path.parent.glob(f'{path.name}*'):
        (folder / part.name).write_bytes(part.read_bytes())
    file.close()
    return folder / path.name


@pytest.mark.parametrize(
    'how', ['killed', 'killed in a folder', 'compressed', 'folder, compressed']
)
def test_a_db3_is_read_with_all_that_was_recorded_and_stays_as_it_is(tmp_path, how):
    path = write_bag(tmp_path, 'named poses', 'db3') / 'bag.db3'
    whole = [(m.log_time, m.data) for m in read_messages(path)]
    folder = tmp_path / 'bag_of_others'
    if 'killed' in how:
        file = killed(path, folder)
        assert file.with_name('bag.db3-wal').stat().st_size
    else:
        folder.mkdir()
        file = folder / 'bag.db3.zstd'
        file.write_bytes(zstandard.compress(path.read_bytes()))
    before = {part.name: part.read_bytes() for part in folder.iterdir()}
    given = folder if 'folder' in how else file
    assert [(m.log_time, m.data) for m in read_messages(given)] == whole
    assert import_points(given, tmp_path / 'out.mcap').frames == len(PLACES)
    assert {part.name: part.read_bytes() for part in folder.iterdir()} == before


def test_a_compressed_db3_that_the_disk_cannot_hold_is_refused(tmp_path, monkeypatch):
    path = tmp_path / 'bag.db3.zstd'
    path.write_bytes(zstandard.compress(b'SQLite format 3\0' + bytes(1 << 22)))
    monkeypatch.setattr('shutil.disk_usage', lambda _: SimpleNamespace(free=1 << 22))
    with pytest.raises(BagError, match=r'half of the free space of .*; fix: free some, or set'):
        list(read_messages(path))


@pytest.mark.parametrize('apart', [False, True])
def test_a_chain_of_frames_on_tf_is_multiplied_out(tmp_path, apart):
    path = tmp_path / 'run.mcap'
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    with BagWriter(path) as bag:
        for k in range(6):
            stamp = FIRST + k * STEP
            parts = [('map', 'lab', 9.0), ('lab', 'crank', 1.0), ('crank', 'rod', 2.0 + k)]
            for parent, child, x in parts[k > 0 :]:
                topic = '/tf_static' if child == 'lab' else '/tf'
                late = STEP // 2 if apart and child == 'rod' else 0
                row = np.array([[x, 0.0, 0.0, *quarter]])
                data = poses_data('tf', stamp + late, parent, [child], row)
                bag.write_many([(topic, INPUT_TYPES['tf'], [stamp + late], [data])])
    if apart:
        with pytest.raises(BagError, match='rod is on crank, and these never have one stamp'):
            import_points(path, tmp_path / 'out.mcap')
        return
    done = import_points(path, tmp_path / 'out.mcap')
    assert 'multiplied out into lab: rod on crank' in ' '.join(done.notes)
    stamps, found = markers_in(tmp_path / 'out.mcap')
    assert sorted(found) == ['crank', 'rod']
    assert stamps == [FIRST + k * STEP for k in range(6)]
    np.testing.assert_allclose(found['rod'], [(1.0, 2.0 + k, 0.0) for k in range(6)], atol=1e-12)


@pytest.mark.parametrize('kind', ['marker_array', 'tf'])
def test_messages_that_repeat_a_stamp_are_left_out_and_counted(tmp_path, kind):
    """The first of them is the one that was stamped when it came."""
    path, logs = tmp_path / 'half.mcap', [FIRST + k * STEP for k in range(40)]
    stamps = np.array([FIRST + k // 2 * 2 * STEP for k in range(40)])
    places = np.stack((np.arange(40.0), np.zeros(40), np.zeros(40)), axis=-1)[:, None]
    if kind == 'tf':
        rows = np.pad(places, ((0, 0), (0, 0), (0, 4)), constant_values=0.5)
        pairs = zip(stamps.tolist(), rows, strict=True)
        data = [poses_data('tf', stamp, 'lab', ['a'], row) for stamp, row in pairs]
    else:
        data = marker_arrays(stamps, 'lab', ['a'], places)
    topic = '/tf' if kind == 'tf' else '/markers'
    with BagWriter(path) as bag:
        bag.write_many([(topic, INPUT_TYPES[kind], logs, data)])
    done = import_points(path, tmp_path / 'out.mcap')
    (note,) = [one for one in done.notes if 'stamp of one before' in one]
    assert '20 of 40 messages' in note and '; fix: have the driver' in note
    _, found = markers_in(tmp_path / 'out.mcap')
    assert next(iter(found.values()))[:, 0].tolist() == list(range(0, 40, 2))
