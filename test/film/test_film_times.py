"""When the pictures of a film were taken: by tags, headers, rates, and the rows of the sensor."""

import threading
from collections.abc import Generator, Sequence
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from rendered import FOUR_BAR, Camera, Film

from kinpole_ros.bags import BagWriter, read_frames
from kinpole_ros.film import FilmError, read_film
from kinpole_ros.film._decoder import brightness
from kinpole_ros.film._filmed import Seen
from kinpole_ros.film._placing import _at_one_instant
from kinpole_ros.film._recorded_pictures import _ENCODINGS, _frame
from kinpole_ros.film._video import Video, ahead
from kinpole_ros.messages import (
    COMPRESSED_IMAGE,
    IMAGE,
    message_class,
    ns_to_stamp,
    serialize_message,
)
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.commands._command import TIME
from kinpole_ros.tools.filmed import is_bag_of_pictures

SIZE = FOUR_BAR[0].size
CAMERA = Camera((640, 360), width=0.95, target=0.15 + 0.1j)
BEGIN = 1_700_000_000_000_000_000  # ns


def write(
    path: Path,
    times: Sequence[float],
    tags: dict[str, str] | None = None,
    codec: dict[str, str] | None = None,
    **options: Any,
) -> Path:
    """Write a video of small pictures, each brighter than the one before."""
    with av.open(str(path), 'w', options={'movflags': 'use_metadata_tags'}, **options) as container:
        container.metadata.update(tags or {})
        stream: Any = container.add_stream('libx264', rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 64, 'yuv420p'
        stream.codec_context.time_base = Fraction(1, 90_000)
        stream.options = codec or {}
        for k, time in enumerate(times):
            picture = np.full((96, 64), 20 + 5 * k, np.uint8)
            frame = av.VideoFrame.from_ndarray(picture, 'yuv420p')
            frame.pts, frame.time_base = round(time * 90_000), Fraction(1, 90_000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def stamps_of(video: Video) -> np.ndarray:
    return np.array([picture.stamp for picture in video.pictures()])


@pytest.mark.parametrize('name', ['film.mp4', 'film.mkv', 'film.avi', 'film.ts', 'film.mpg'])
@pytest.mark.parametrize('rate', [None, 50.0])
def test_a_film_is_read_again_from_any_picture(
    name: str, rate: float | None, tmp_path: Path
) -> None:
    codec = {'g': '5', 'bf': '2', 'sc_threshold': '0'}
    film = write(tmp_path / name, np.arange(24) / 30, codec=codec)
    video = Video(film, rate)
    grays = [picture.gray for picture in video.pictures()]
    for first in range(len(grays)):
        again = list(video.read_again(first))
        assert len(again) == len(grays) - first
        np.testing.assert_array_equal(again, grays[first:])


@pytest.mark.parametrize(
    ('tag', 'played', 'taken', 'clock'),
    [
        ('240.000000', 30, 240, 'by its tag com.android.capture.fps, while it is played at 30 Hz'),
        ('120', 25, 120, 'by its tag com.android.capture.fps, while it is played at 25 Hz'),
        # Time lapse.
        ('2.0', 30, 2, 'by its tag com.android.capture.fps, while it is played at 30 Hz'),
        ('30.0', 30, 30, 'by the stamps of the file'),
        # In the dark a camera takes fewer pictures.
        ('30.0', 24, 24, 'by the stamps of the file'),
        ('no number', 30, 30, 'by the stamps of the file'),
    ],
)
def test_slow_motion_has_the_rate_of_its_tag(
    tag: str, played: float, taken: float, clock: str, tmp_path: Path
) -> None:
    times = np.delete(np.arange(20), [7, 8]) / played
    video = Video(write(tmp_path / 'slow.mp4', times, {'com.android.capture.fps': tag}))
    assert video.clock == clock
    np.testing.assert_allclose(stamps_of(video), times * played / taken * 1e9, atol=2e4)


@pytest.mark.parametrize('kind', ['h264', 'mjpeg'])
def test_raw_streams_have_no_times_but_by_rate(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f'raw.{kind}'
    if kind == 'h264':
        write(path, np.arange(12) / 30, format='h264')
    else:
        picture = cv2.imencode('.jpg', np.full((64, 64), 90, np.uint8))[1].tobytes()
        path.write_bytes(12 * picture)
    with pytest.raises(FilmError, match=r'is raw .*; fix: give --rate HZ') as caught:
        Video(path)
    assert '\n' not in str(caught.value)
    stamps = stamps_of(Video(path, 120.0))
    np.testing.assert_allclose(stamps, np.arange(12) * 1e9 / 120, atol=1)


def test_a_rate_replaces_the_stamps_of_a_film(tmp_path: Path) -> None:
    video = Video(write(tmp_path / 'fast.mp4', np.arange(12) / 30), 1000.0)
    assert video.clock == 'by --rate'
    np.testing.assert_array_equal(stamps_of(video), np.arange(12) * 1_000_000)


@pytest.mark.parametrize(
    ('names', 'numbers'),
    [
        (['p8', 'p9', 'p11', 'p12'], [0, 1, 3, 4]),
        (['p10', 'p20', 'p30', 'p50'], [0, 1, 2, 4]),
        (['a_7', 'b_7', 'c_7', 'd_7'], [0, 1, 2, 3]),
        (['p3', 'p10', 'p14', 'p15'], [0, 1, 2, 3]),
        (['1700000.010', '1700000.043', '1700000.077', '1700000.110'], [0, 1, 2, 3]),
    ],
)
def test_a_folder_of_pictures_is_a_film_by_the_numbers_in_its_names(
    names: list[str], numbers: list[int], tmp_path: Path
) -> None:
    for k, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f'{name}.png'), np.full((64, 64), 20 + k, np.uint8))
    (tmp_path / 'notes.txt').touch()
    with pytest.raises(FilmError, match='is a folder of pictures, which does not say when'):
        Video(tmp_path)
    pictures = list(Video(tmp_path, 100.0).pictures())
    assert [picture.stamp for picture in pictures] == [10_000_000 * number for number in numbers]
    assert [picture.gray[0, 0] for picture in pictures] == [20, 21, 22, 23]


def message(kind: str, gray: np.ndarray, stamp: int) -> bytes:
    """A picture in a message; its rows have padding, and colors."""
    own = message_class(kind)()
    own.header.stamp = ns_to_stamp(stamp)
    if kind == COMPRESSED_IMAGE:
        own.format, own.data = 'jpeg', cv2.imencode('.jpg', gray)[1].ravel()
    else:
        own.height, own.width = gray.shape
        own.encoding, own.step = 'bgr8', 3 * gray.shape[1] + 5
        rows = np.repeat(gray[..., None], 3, axis=2).reshape(len(gray), -1)
        own.data = np.pad(rows, ((0, 0), (0, 5))).ravel()
    return serialize_message(own)


def write_bag(path: Path, kind: str, film: Film, topic: str = '/camera/image') -> np.ndarray:
    """Write the pictures of a film to a bag, and return their stamps, ns."""
    stamps = BEGIN + np.rint(film.times * 1e9).astype(int)
    pairs = zip(stamps.tolist(), film.pictures(), strict=True)
    data = [message(kind, gray, stamp) for stamp, gray in pairs]
    # Messages are late, by more or less.
    late = stamps + np.arange(len(stamps)) % 3 * 5_000_000 + 20_000_000
    with BagWriter(path) as bag:
        bag.write_many([(topic, message_class(kind), late.tolist(), data)])
    return stamps


@pytest.mark.parametrize('kind', [COMPRESSED_IMAGE, IMAGE])
def test_a_bag_of_pictures_is_a_film_with_the_stamps_of_its_headers(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film = Film(0.1 + np.arange(7) / 20, FOUR_BAR[:3], CAMERA)
    stamps = write_bag(tmp_path / 'camera.mcap', kind, film)
    words = ['film', str(tmp_path / 'camera.mcap'), '--output', str(tmp_path / 'out.mcap')]
    assert main([*words, '--size', '24mm']) == 0
    assert 'at 20 Hz by the headers of /camera/image;' in capsys.readouterr().out
    frames, _ = read_frames(tmp_path / 'out.mcap', None, 60.0)
    np.testing.assert_array_equal(np.concatenate([part.stamps for part in frames]), stamps)
    assert main([*words, '--topic', 'x']) == 2
    assert 'no pictures on /x, which is not in it; fix: name' in capsys.readouterr().err


@pytest.mark.parametrize('encoding', _ENCODINGS)
def test_images_of_all_encodings_have_their_brightness(encoding: str) -> None:
    """Rows may have padding; YUV has black at 16, and a Bayer pattern half the resolution."""
    gray = np.add.outer(np.arange(66), np.arange(70)).astype(np.uint8) + 30
    channels = _ENCODINGS[encoding][1]
    if encoding == 'mono16':
        rows = (257 * gray.astype('<u2')).view(np.uint8)
    elif channels == 2:
        rows = np.full((66, 140), 128, np.uint8)
        rows[:, encoding in ('yuv422', 'uyvy') :: 2] = gray
    else:
        rows = np.repeat(gray, channels, axis=1)
    own = message_class(IMAGE)(width=70, height=66, encoding=encoding, step=rows.shape[1] + 3)
    own.data = np.pad(rows, ((0, 0), (0, 3))).ravel()
    shown = brightness(_frame('x', own)).astype(float)
    is_yuv = channels == 2 and encoding != 'mono16'
    exact = (gray - 16.0) * 255 / 219 if is_yuv else gray
    assert np.abs(shown - exact)[2:-2, 2:-2].max() < 4
    own.data = own.data[:-4]
    with pytest.raises(FilmError, match=r'x has \d+ bytes, too few'):
        _frame('x', own)


def test_what_a_bag_lacks_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'two.mcap'
    data = [message(IMAGE, np.zeros((64, 64), np.uint8), 0)]
    with BagWriter(path) as bag:
        for topic in ('/left', '/right'):
            bag.write_many([(topic, message_class(IMAGE), [7], data)])
    with pytest.raises(FilmError, match='several topics of pictures, /left, /right; fix: name one'):
        read_film(path)
    for command, output in (('import', 'a.mcap'), ('replay', 'a.mcap'), ('discover', 'a.yaml')):
        assert main([command, str(path), '--output', str(tmp_path / output)]) == 2
        assert f'fix: `kinpole film {path} --output' in capsys.readouterr().err
    video = Video(path, None, '/left')
    assert stamps_of(video).tolist() == [7]
    assert video.clock == 'by the log times of /left, whose headers have no stamps'


def test_markers_in_a_bag_come_before_its_pictures() -> None:
    types = {'/image': IMAGE, '/tf': 'tf2_msgs/msg/TFMessage'}
    assert is_bag_of_pictures(types, None)
    types['/markers'] = 'visualization_msgs/msg/MarkerArray'
    assert not is_bag_of_pictures(types, None)
    assert is_bag_of_pictures(types, 'image') and not is_bag_of_pictures(types, '/markers')


def test_a_film_is_closed_by_the_thread_that_opened_it() -> None:
    """Bags of SQLite cannot be closed by another one."""
    threads = []

    def items() -> Generator[int, None, None]:
        try:
            threads.append(threading.get_ident())
            while True:
                yield 0
        finally:
            threads.append(threading.get_ident())

    with closing(ahead(items(), 1)) as taken:
        assert next(taken) == 0
    assert threads[0] == threads[1] != threading.get_ident()


@pytest.mark.parametrize('turns', range(4))
def test_rows_of_the_sensor_follow_each_other_however_a_film_is_turned(turns: int) -> None:
    """A phone that is held upright films columns, from its left or its right side on."""
    line_time, (width, height) = 40e-6, (640, 360)
    times = np.arange(9) / 30
    velocity = np.array([300.0, -200.0])  # pixels/s
    still = np.array([[100, 100], [400, 300]]) + times[:, None, None] * velocity
    # A point is seen when its row is exposed, and the row is where it is then.
    delay = line_time * (still[..., 1] - (height - 1) / 2) / (1 - line_time * velocity[1])
    seen = still + delay[..., None] * velocity
    for k in range(turns):  # to the left
        side = (width, height)[k % 2]
        still, seen = (np.stack((p[..., 1], side - 1 - p[..., 0]), axis=-1) for p in (still, seen))
    picture = (width, height) if turns % 2 == 0 else (height, width)
    stamps = BEGIN + np.rint(times * 1e9).astype(int)
    film = Seen([], stamps, np.empty((9, 0, 4, 2)), seen, picture, '', turns)
    np.testing.assert_allclose(_at_one_instant(film, seen, line_time), still, atol=1e-6)


def test_the_time_of_a_line_may_be_in_microseconds() -> None:
    assert TIME('20us') == TIME('20 µs') == TIME('20 \u03bcs') == pytest.approx(20e-6)
