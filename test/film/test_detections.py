"""Tags that another detector finds, in pixels, become markers over DDS."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rendered import FOUR_BAR, Camera, Film
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kinpole_ros.bags import BagWriter
from kinpole_ros.film import FilmOptions, read_film
from kinpole_ros.messages import (
    CAMERA_INFO,
    DETECTIONS,
    MessageError,
    message_class,
    read_detections,
    serialize_message,
)

SIZE = FOUR_BAR[0].size
CAMERA = Camera((1152, 648), width=0.95, target=0.15 + 0.1j)
FILM = Film(0.1 + np.arange(60) / 30, camera=CAMERA)
SECOND = 10**9
# A marker keeps its name and number while others are hidden.
NAMES = {f'tag{k // 4}_{k % 4 + 1}': f'tag{k // 4}_{k % 4 + 1}/{k}' for k in range(28)}
# As the package defines them.
STORE: Any = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in {
    'apriltag_msgs/msg/Point': 'float64 x\nfloat64 y\n',
    'apriltag_msgs/msg/AprilTagDetection': 'string family\nint32 id\nint32 hamming\n'
    'float32 goodness\nfloat32 decision_margin\nPoint centre\nPoint[4] corners\n'
    'float64[9] homography\n',
    DETECTIONS: 'std_msgs/Header header\nAprilTagDetection[] detections\n',
}.items():
    STORE.register(get_types_from_msg(_text, _name))


def message(stamp: int, tags: dict[int, np.ndarray], twice: int | None = None) -> bytes:
    """Detections of tags with corners (4, 2), pixels, in the order of `Film.corners`."""
    kinds = STORE.types
    point = kinds['apriltag_msgs/msg/Point']
    found = []
    for number, corners in [*tags.items(), *([(twice, tags[twice])] if twice is not None else [])]:
        # The detector's first corner is the top right one of OpenCV, and then to the left; the
        # center of the first pixel is at 0.5, 0.5.
        places = [point(*(corners[k] + 0.5)) for k in (1, 0, 3, 2)]
        center = point(*(corners.mean(axis=0) + 0.5))
        one = kinds['apriltag_msgs/msg/AprilTagDetection'](
            'tag36h11', number, 0, 0.0, 80.0, center, places, np.eye(3).ravel()
        )
        found.append(one)
    time = kinds['builtin_interfaces/msg/Time'](*divmod(stamp, SECOND))
    header = kinds['std_msgs/msg/Header'](time, 'camera')
    return bytes(STORE.serialize_cdr(kinds[DETECTIONS](header, found), DETECTIONS))


def noisy(k: int) -> dict[int, np.ndarray]:
    """The corners of the tags in a picture, to a tenth of a pixel; tag 1 is hidden at times."""
    random = np.random.default_rng(k)
    return {
        number: corners[k] + 0.1 * random.standard_normal((4, 2))
        for number, corners in FILM.corners().items()
        if number != 1 or k % 3
    }


def test_detections_are_read_by_their_definition() -> None:
    tags = noisy(4)
    seen = read_detections(message(5_000_000_007, tags, twice=4))
    assert (seen.stamp, seen.family) == (5_000_000_007, 'tag36h11')
    assert seen.tags == [0, 1, 2, 3, 5, 6]
    np.testing.assert_allclose(seen.corners, [tags[k] for k in seen.tags])
    assert read_detections(message(7, {})).corners.shape == (0, 4, 2)
    data = message(5, tags)
    for end in range(0, len(data), 7):
        with pytest.raises(MessageError):
            read_detections(data[:end])


@pytest.mark.parametrize('has_info', [True, False])
def test_tags_in_a_bag_are_placed(has_info: bool, tmp_path: Path) -> None:
    stamps = 1_700_000_000 * SECOND + np.arange(20) * SECOND // 30
    data = [message(stamp, noisy(k)) for k, stamp in enumerate(stamps.tolist())]
    info = message_class(CAMERA_INFO)(width=1152, height=648)
    info.p = np.column_stack((CAMERA.matrix, np.zeros(3))).ravel()
    with BagWriter(tmp_path / 'tags.mcap') as bag:
        bag.write_many([('/detections', message_class(DETECTIONS), stamps.tolist(), data)])
        if has_info:
            row = [serialize_message(info)]
            bag.write_many([('/info', message_class(CAMERA_INFO), stamps[:1].tolist(), row)])
    filmed = read_film(tmp_path / 'tags.mcap', FilmOptions(size=SIZE))
    np.testing.assert_array_equal(filmed.stamps, stamps)
    assert filmed.tags == tuple(range(7))
    assert 'by the headers of /detections' in filmed.assumed[0]
    assert ('by its CameraInfo' in filmed.assumed[-1]) == has_info
    exact = {number: pose[0][0, :20] for number, pose in FILM.poses(FILM.times).items()}
    for number in range(7):
        off = filmed.corners[:, number].mean(axis=1) - (exact[number] - exact[0])
        assert np.nanmax(np.abs(off)) < 1.5e-3


@pytest.fixture
def stand_in_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The package apriltag_msgs, as a sourced workspace has it, with a stand-in."""
    pytest.importorskip('rclpy')
    from stand_in_types import stand_in

    package = tmp_path / 'apriltag_msgs' / 'msg'
    package.mkdir(parents=True)
    (package.parent / '__init__.py').touch()
    (package / '__init__.py').write_text(
        f'from stand_in_types import stand_in\nAprilTagDetectionArray = stand_in({DETECTIONS!r})\n'
    )
    paths = [str(tmp_path), str(Path(__file__).parents[1]), os.environ.get('PYTHONPATH', '')]
    monkeypatch.setenv('PYTHONPATH', ':'.join(paths))
    return stand_in(DETECTIONS)


def test_tags_of_apriltag_ros_are_placed_by_the_ground_over_dds(stand_in_class: Any) -> None:
    import rclpy
    from sensor_msgs.msg import CameraInfo

    from kinpole_ros.ros.listener import listen
    from kinpole_ros.ros.player import own_context

    context = own_context()
    node = rclpy.create_node('detector', context=context)
    tags = node.create_publisher(stand_in_class, '/detections', 10)
    camera = node.create_publisher(CameraInfo, '/camera/info', 10)
    info = CameraInfo(width=1152, height=648)
    info.p = np.column_stack((CAMERA.matrix, np.zeros(3))).ravel().tolist()
    stamped = [(k * SECOND // 30, noisy(k)) for k in range(60)]
    data = [message(SECOND + stamp, seen) for stamp, seen in stamped]
    is_over = threading.Event()

    def detect() -> None:
        number = 0
        while not is_over.wait(0.01):
            camera.publish(info)
            tags.publish(data[number % len(data)])
            number += 1

    thread = threading.Thread(target=detect)
    words = ['-m', 'kinpole_ros.tools.cli', 'camera', '--size', '24mm', '--topic', '/tags/markers']
    words += ['--detections', '/detections', '--info', '/camera/info']
    with subprocess.Popen(
        ['timeout', '-k', '2', '60', sys.executable, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as process:
        try:
            thread.start()
            frames, _ = listen('/tags/markers', 0.5)
            process.terminate()
            out, _ = process.communicate(timeout=20)
        finally:
            is_over.set()
            thread.join()
            process.kill()
            node.destroy_node()
            context.try_shutdown()
    assert b'messages published' in out and b'lens by its CameraInfo' in out
    exact = {number: pose[0][0] for number, pose in FILM.poses(FILM.times).items()}
    seen = 0
    for part in frames:
        for stamp, points in zip(part.stamps, part.points, strict=True):
            k = round((stamp - SECOND) * 30 / SECOND)
            named = zip(part.identities, points @ (1, 1j, 0), strict=True)
            corners = {name.partition('/')[0]: place for name, place in named}
            assert {
                name.partition('/')[0]: name for name in part.identities
            }.items() <= NAMES.items()
            for number in range(7):
                if np.isnan(corners.get(f'tag{number}_1', np.nan)):
                    continue
                own = [corners[f'tag{number}_{c}'] for c in range(1, 5)]
                assert abs(np.mean(own) - exact[number][k] + exact[0][k]) < 1.5e-3
                seen += 1
    assert seen > 50


def test_what_detections_need_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('rclpy')
    from kinpole_ros.tools import camera
    from kinpole_ros.tools.cli import main

    assert main(['camera']) == 2
    assert 'camera needs a SOURCE, or --detections TOPIC' in capsys.readouterr().err
    assert main(['camera', '0', '--info', '/x']) == 2
    assert '--info is for --detections' in capsys.readouterr().err
    assert main(['camera', '--detections', '/detections']) == 2
    assert 'AprilTagDetectionArray' in capsys.readouterr().err
    monkeypatch.setattr(camera, '_class_of_detections', lambda: None)
    monkeypatch.setattr(camera, '_PATIENCE', 0.2)
    assert main(['camera', '--detections', '/detections', '--info', '/none']) == 2
    assert 'no CameraInfo came on /none in 0.2 s' in capsys.readouterr().err
