"""The types of messages of trackers: each is a row, read by replay and by the live node alike."""

import struct
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import write_config
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from stand_in_types import stand_in
from test_node import Peer, complaints, node_words, process, said

from kinpole_ros import replay
from kinpole_ros.bags import read_frames
from kinpole_ros.messages import (
    INPUT_TYPE_NAMES,
    INPUT_TYPES,
    MessageError,
    kind_of,
    marker_reader,
    reader_of,
    type_name,
)
from kinpole_ros.messages import _installed as installed_module
from kinpole_ros.ros.source import subscribed_class
from kinpole_ros.settings import ParameterError, Settings, settings_from
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

FIRST, STEP = 1_000_000_000_000, 10_000_000  # ns
HEAD = 'std_msgs/Header header\nuint32 frame_number\n'
TURN = 2 * np.pi  # rad/s
# As the packages of these types define them.
DEFINITIONS = {
    'mocap4r2_msgs/msg/Marker': 'int8 id_type\nint32 marker_index\nstring marker_name\n'
    'geometry_msgs/Point translation\n',
    'mocap4r2_msgs/msg/Markers': f'{HEAD}mocap4r2_msgs/Marker[] markers\n',
    'mocap4r2_msgs/msg/RigidBody': 'string rigid_body_name\nmocap4r2_msgs/Marker[] markers\n'
    'geometry_msgs/Pose pose\n',
    'mocap4r2_msgs/msg/RigidBodies': f'{HEAD}mocap4r2_msgs/RigidBody[] rigidbodies\n',
    'motion_capture_tracking_interfaces/msg/NamedPose': 'string name\ngeometry_msgs/Pose pose\n',
    'motion_capture_tracking_interfaces/msg/NamedPoseArray': 'std_msgs/Header header\n'
    'motion_capture_tracking_interfaces/NamedPose[] poses\n',
    'aruco_msgs/msg/Marker': 'std_msgs/Header header\nuint32 id\n'
    'geometry_msgs/PoseWithCovariance pose\nfloat64 confidence\n',
    'aruco_msgs/msg/MarkerArray': 'std_msgs/Header header\naruco_msgs/Marker[] markers\n',
    'aruco_markers_msgs/msg/Marker': 'std_msgs/Header header\nuint32 id\n'
    'geometry_msgs/PoseStamped pose\nfloat64 pixel_x\nfloat64 pixel_y\n',
    'aruco_markers_msgs/msg/MarkerArray': 'std_msgs/Header header\n'
    'aruco_markers_msgs/Marker[] markers\n',
    'aruco_opencv_msgs/msg/MarkerPose': 'uint16 marker_id\ngeometry_msgs/Pose pose\n',
    'aruco_opencv_msgs/msg/BoardPose': 'string board_name\ngeometry_msgs/Pose pose\n',
    'aruco_opencv_msgs/msg/ArucoDetection': 'std_msgs/Header header\n'
    'aruco_opencv_msgs/MarkerPose[] markers\naruco_opencv_msgs/BoardPose[] boards\n',
}
OF_TAGS = ('aruco', 'aruco_markers', 'aruco_detection')
KINDS = ('mocap_markers', 'rigid_bodies', 'named_poses', *OF_TAGS)
# The numbers of tags, by the names that the other types have.
TAGS = {'rod': 3, 'rodd': 4, 't': 65535, 'a': 0}
PACKAGES = {INPUT_TYPE_NAMES[kind].partition('/')[0] for kind in KINDS}
STORE: Any = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, _name))


def make(name: str, *values: Any) -> Any:
    package, short = name.split('/')
    return STORE.types[f'{package}/msg/{short}'](*values)


def marker(name: str, point: Any, id_type: int = 0, number: int = 0) -> Any:
    place = make('geometry_msgs/Point', *map(float, point))
    return make('mocap4r2_msgs/Marker', id_type, number, name, place)


def pose(point: Any, angle: float) -> Any:
    quaternion = 0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2))
    return make(
        'geometry_msgs/Pose',
        make('geometry_msgs/Point', *map(float, point)),
        make('geometry_msgs/Quaternion', *quaternion),
    )


def header(stamp: int) -> Any:
    return make('std_msgs/Header', make('builtin_interfaces/Time', *divmod(stamp, 10**9)), 'lab')


def packed(kind: str, message: Any, is_little: bool = True) -> bytes:
    return bytes(STORE.serialize_cdr(message, INPUT_TYPE_NAMES[kind], little_endian=is_little))


def markers(stamp: int, *items: Any, is_little: bool = True) -> bytes:
    message = make('mocap4r2_msgs/Markers', header(stamp), 7, list(items))
    return packed('mocap_markers', message, is_little)


def tag(kind: str, stamp: int, number: int, one: Any) -> Any:
    """The pose of a tag, as a detector of this type sends it."""
    if kind == 'aruco_detection':
        return make('aruco_opencv_msgs/MarkerPose', number, one)
    if kind == 'aruco':
        with_covariance = make('geometry_msgs/PoseWithCovariance', one, np.zeros(36))
        return make('aruco_msgs/Marker', header(stamp), number, with_covariance, 1.0)
    stamped = make('geometry_msgs/PoseStamped', header(stamp), one)
    return make('aruco_markers_msgs/Marker', header(stamp), number, stamped, 5.0, 6.0)


def poses(kind: str, stamp: int, is_little: bool = True, **bodies: Any) -> bytes:
    if kind == 'rigid_bodies':
        own = [marker('inner', (9, 9, 9))]
        items = [make('mocap4r2_msgs/RigidBody', name, own, one) for name, one in bodies.items()]
        return packed(kind, make('mocap4r2_msgs/RigidBodies', header(stamp), 7, items), is_little)
    if kind in OF_TAGS:
        items = [tag(kind, stamp, TAGS[name], one) for name, one in bodies.items()]
        boards = [[]] if kind == 'aruco_detection' else []
        late = stamp + 7_000_000 if kind == 'aruco_markers' else stamp  # as its driver does
        message = make(INPUT_TYPE_NAMES[kind].replace('/msg', ''), header(late), items, *boards)
        return packed(kind, message, is_little)
    package = 'motion_capture_tracking_interfaces'
    items = [make(f'{package}/NamedPose', name, one) for name, one in bodies.items()]
    return packed(kind, make(f'{package}/NamedPoseArray', header(stamp), items), is_little)


def rod(kind: str) -> Iterator[bytes]:
    """A rod that turns, with noise, in messages of this type."""
    rng = np.random.default_rng(5)
    places = np.array([0.2, -0.2, 0.2j, 0.1 - 0.1j])
    k = 0
    while True:
        angle = TURN * k / 100
        stamp = FIRST + k * STEP
        if kind == 'mocap_markers':
            flat = places * np.exp(1j * angle) + 1e-4 * rng.normal(size=(4, 2)) @ (1, 1j)
            found = [
                marker(name, (z.real, z.imag, 0)) for name, z in zip('abcd', flat, strict=True)
            ]
            yield markers(stamp, *found)
        else:
            point = (*(1e-4 * rng.normal(size=2)), 0.0)
            yield poses(kind, stamp, rod=pose(point, angle + 1e-3 * rng.normal()))
        k += 1


SETTINGS = {
    'mocap_markers': {'bodies': ['rod'], 'rod.markers': ['a', 'b', 'c', 'd']},
    'rigid_bodies': {'bodies': ['rod'], 'rod.markers': ['rod'], 'marker_type': 'rigid_bodies'},
    'named_poses': {'bodies': ['rod'], 'rod.markers': ['rod'], 'marker_type': 'named_poses'},
    **{kind: {'bodies': ['rod'], 'rod.markers': ['3'], 'marker_type': kind} for kind in OF_TAGS},
}


def write_parameters(folder: Path, kind: str) -> Path:
    """Write a file of parameters for the rod."""
    path = folder / 'rod.yaml'
    lines = [f'    {name}: {value!r}\n' for name, value in SETTINGS[kind].items()]
    path.write_text(f'/**:\n  ros__parameters:\n{"".join(lines)}')
    return path


def test_the_rows_name_the_types_of_the_classes_that_are_written() -> None:
    assert {kind: type_name(cls) for kind, cls in INPUT_TYPES.items()} == {
        kind: name for kind, name in INPUT_TYPE_NAMES.items() if kind in INPUT_TYPES
    }


@pytest.mark.parametrize('is_little', [True, False])
def test_markers_have_their_name_or_their_number(is_little: bool) -> None:
    data = markers(
        FIRST,
        marker('tip', (1, 2, 3), id_type=0, number=4),
        marker('unused', (4, 5, 6), id_type=1, number=-7),
        marker('', (7, 8, np.nan), id_type=2, number=9),
        is_little=is_little,
    )
    (frames,) = marker_reader('mocap_markers', 'auto').read([data, data])
    assert frames.identities == ('tip', '-7', '9')
    assert frames.frame_id == 'lab'
    assert frames.stamps.tolist() == [FIRST, FIRST]
    expected = [[1, 2, 3], [4, 5, 6], [np.nan] * 3]
    np.testing.assert_array_equal(frames.points, [expected, expected])
    (by_place,) = marker_reader('mocap_markers', 'index').read([data])
    assert by_place.identities == ('0', '1', '2')
    with pytest.raises(ParameterError, match='marker_identity is ns, and a marker of mocap4r2'):
        marker_reader('mocap_markers', 'ns')


def test_markers_that_come_and_go_are_frames_of_other_names() -> None:
    one, two = marker('a', (1, 0, 0)), marker('b', (2, 0, 0))
    data = [markers(FIRST, one), markers(FIRST + 1, one, two), markers(FIRST + 2)]
    found = marker_reader('mocap_markers', 'auto').read(data)
    assert [frames.identities for frames in found] == [('a',), ('a', 'b'), ()]


@pytest.mark.parametrize('is_little', [True, False])
@pytest.mark.parametrize('kind', KINDS[1:])
def test_poses_have_the_names_of_their_bodies(kind: str, is_little: bool) -> None:
    names = ('65535', '0') if kind in OF_TAGS else ('t', 'a')
    own = {'tip.markers': names[:1], 'arm.markers': names[1:]}
    settings = settings_from(
        {'bodies': ['arm', 'tip'], 'marker_type': kind, **{k: list(v) for k, v in own.items()}}
    )
    data = poses(kind, FIRST, is_little, t=pose((1, 2, 3), 0.5), a=pose((4, 5, 6), 0.0))
    (frames,) = reader_of(kind, settings).read([data])
    assert frames.identities == names
    assert frames.stamps.tolist() == [FIRST]
    np.testing.assert_array_equal(frames.points, [[[1, 2, 3], [4, 5, 6]]])
    angles = np.arctan2(frames.axes[0, :, 0, 1], frames.axes[0, :, 0, 0])
    np.testing.assert_allclose(angles, [0.5, 0], atol=1e-12)


def test_names_of_no_body_are_listed_where_a_body_never_came() -> None:
    reader = reader_of('named_poses', settings_from(SETTINGS['named_poses']))
    reader.read([poses('named_poses', FIRST, rodd=pose((0, 0, 0), 0.0))])
    fault = reader.fault()
    assert fault is not None and fault.sentence() == (
        "no pose came of 'rod'; names that came, and no body has: 'rodd'"
    )


def test_several_poses_without_a_name_in_the_parameters_are_refused() -> None:
    data = poses('rigid_bodies', FIRST, a=pose((0, 0, 0), 0.0), b=pose((0, 0, 0), 0.0))
    (error,) = reader_of('rigid_bodies', Settings()).read([data])
    assert 'RigidBodies has 2 poses, and it is not known which is that of the body' in str(error)
    assert "<body>.markers: ['a']" in str(error)


def test_a_name_that_comes_twice_is_refused() -> None:
    data = markers(FIRST, marker('a', (1, 0, 0)), marker('a', (2, 0, 0)))
    (error,) = marker_reader('mocap_markers', 'auto').read([data])
    assert "mocap4r2_msgs/msg/Markers has 'a' several times" in str(error)


@pytest.mark.parametrize('kind', KINDS)
def test_a_message_cut_anywhere_or_with_wrong_sizes_is_an_error_or_frames(kind: str) -> None:
    data = next(rod(kind))
    read = reader_of(kind, settings_from(SETTINGS[kind])).read
    behind = 4 if kind == 'aruco_detection' else 0  # bytes of its boards, which are not read
    for end in range(len(data) - behind):
        (result,) = read([data[:end]])
        assert isinstance(result, MessageError)
    for at in range(len(data) - 3):
        damaged = bytearray(data)
        struct.pack_into('<I', damaged, at, 0xFFFFFFF0)
        read([bytes(damaged)])


@pytest.mark.parametrize('kind', KINDS)
def test_replay_reads_a_bag_of_them_directly(kind: str, tmp_path: Path) -> None:
    path, messages = tmp_path / 'bag', rod(kind)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection('/markers', INPUT_TYPE_NAMES[kind], typestore=STORE)
        for k in range(100):
            writer.write(topic, FIRST + k * STEP, next(messages))
    result = replay(path, write_parameters(tmp_path, kind))
    omega = result['rod'].angular_velocity
    known = omega[np.isfinite(omega)]
    assert len(known) > 60
    np.testing.assert_allclose(known, TURN, rtol=0.02)
    if kind == 'mocap_markers':
        (frames,), topic = read_frames(path)
        assert (frames.identities, topic) == (tuple('abcd'), '/markers')


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Packages of the three types, as a sourced workspace has them, with stand-ins."""
    for kind in KINDS:
        package, folder, short = INPUT_TYPE_NAMES[kind].split('/')
        module = tmp_path / 'site' / package / folder / '__init__.py'
        module.parent.mkdir(parents=True, exist_ok=True)
        (module.parent.parent / '__init__.py').touch()
        with open(module, 'a') as file:
            file.write(
                'from stand_in_types import stand_in\n'
                f'{short} = stand_in({INPUT_TYPE_NAMES[kind]!r})\n'
            )
    paths = [str(tmp_path / 'site'), str(Path(__file__).parent)]
    monkeypatch.setenv('PYTHONPATH', ':'.join(paths))
    monkeypatch.syspath_prepend(paths[0])
    installed_module._has_messages.cache_clear()
    yield tmp_path
    installed_module._has_messages.cache_clear()
    for name in [name for name in sys.modules if name.partition('.')[0] in PACKAGES]:
        del sys.modules[name]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seed', range(4))
def test_poses_of_which_many_are_lost_from_the_start_are_tracked(seed: int) -> None:
    """In blocks too: a pin was fitted to poses whose noise was not known yet, by weights of 1/0."""
    settings, rng = settings_from(SETTINGS['rigid_bodies']), np.random.default_rng(seed)
    came = [data for data in islice(rod('rigid_bodies'), 600) if rng.random() > 0.4]
    reader, tracker = reader_of('rigid_bodies', settings), Tracker(settings)
    estimates = []
    while came:
        block = int(rng.choice([1, 5, 20, 60]))
        for frames in reader.read(came[:block]):
            assert isinstance(frames, MarkerFrames)
            estimates += tracker.add(frames, 2)
        del came[:block]
    rate, variance, _ = (
        np.concatenate(parts)[:, 0]
        for parts in zip(*(one.rate(1) for one in estimates), strict=True)
    )
    known = np.isfinite(rate)
    assert known.sum() > 100
    assert (np.abs(rate - TURN)[known] < 6 * np.sqrt(variance[known])).all()


@pytest.mark.parametrize('kind', KINDS)
def test_the_live_node_reads_them_where_their_package_is_installed(
    kind: str, installed: Path
) -> None:
    config = write_parameters(installed, kind)
    peer, log = Peer(), installed / 'stderr'
    try:
        with process(*node_words(config), log=log):
            odom = peer.hear('/kinpole/rod/odom', Odometry)
            with peer.publisher(subscribed_class(kind)) as publisher:
                peer.feed(publisher, rod(kind), lambda: len(odom) >= 20, f'results from {kind}')
        omega = [message.twist.twist.angular.z for message in odom[5:]]
        assert omega == pytest.approx([TURN] * len(omega), rel=0.1)
    finally:
        peer.close()
    assert complaints(log) == []


@pytest.mark.parametrize('kind', KINDS)
def test_a_package_that_is_missing_is_named_with_the_fix(kind: str) -> None:
    package = INPUT_TYPE_NAMES[kind].partition('/')[0]
    with pytest.raises(ParameterError) as error:
        subscribed_class(kind)
    assert str(error.value) == (
        f'the package {package} is not installed, or its workspace is not sourced; fix: install '
        f'{package} for this ROS, source it, and start the node again'
    )


def test_the_live_node_says_which_package_is_missing(tmp_path: Path) -> None:
    config = write_config(tmp_path / 'rod.yaml', Settings())
    peer = Peer()
    try:
        with process(*node_words(config), log=tmp_path / 'stderr'):
            arrays = peer.hear('/diagnostics', DiagnosticArray)
            made = peer.node.create_publisher(stand_in('mocap4r2_msgs/msg/Markers'), '/markers', 1)
            expected = 'mocap4r2_msgs/msg/Markers on /markers cannot be read: the package mocap4r2_'
            peer.until(lambda: arrays and expected in said(arrays)['message'], 'diagnostics')
            peer.node.destroy_publisher(made)
    finally:
        peer.close()


def test_a_package_without_its_compiled_part_is_named(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(subscribed_class('named_poses')), '_TYPE_SUPPORT', None)
    with pytest.raises(ParameterError, match='is installed has no motion_capture_tracking_inter'):
        subscribed_class('named_poses')


def test_auto_takes_each_by_its_type() -> None:
    assert [kind_of(INPUT_TYPE_NAMES[kind]) for kind in KINDS] == list(KINDS)
