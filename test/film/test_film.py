"""A film of printed tags becomes markers in the plane, by the exact motion that it shows."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rendered import FOUR_BAR, Camera, Film, Tag

from kinpole_ros import replay
from kinpole_ros.bags import read_frames
from kinpole_ros.film import FilmError, FilmOptions, Lens, LiveTags, film_to_bag, read_film
from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._families import codes
from kinpole_ros.film._filmed import Seen
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._tags import TagFinder
from kinpole_ros.film._video import Picture, Video, ahead
from kinpole_ros.mechanism import load_scene
from kinpole_ros.tools.cli import main

SIZE = FOUR_BAR[0].size
GROUND = FOUR_BAR[0].center
OPTIONS = FilmOptions(size=SIZE)
BODIES = {'crank': (1, 2), 'coupler': (3, 4), 'rocker': (5, 6)}
PARAMETERS = {
    'bodies': list(BODIES),
    **{
        f'{body}.markers': [f'tag{tag}_{k}' for tag in tags for k in range(1, 5)]
        for body, tags in BODIES.items()
    },
}
LIMITED = 'timeout', '-k', '2', '60', sys.executable  # s, if it does not end
SMALL = Camera((1152, 648), width=0.95, target=0.15 + 0.1j)


def times(count: int, rate: float = 30.0) -> np.ndarray:
    return 0.1 + np.arange(count) / rate


def exact(film: Film) -> np.ndarray:
    """The corners (T, n, 4) of the tags, complex, m, in the axes of the tag on the ground."""
    square = np.array([-1 + 1j, 1 + 1j, 1 - 1j, -1 - 1j]) / 2
    poses = film.poses(film.times).values()
    corners = [
        place[0][:, None] + tag.size * square * np.exp(1j * turn[0])[:, None]
        for tag, (place, turn) in zip(film.tags, poses, strict=True)
    ]
    return np.stack(corners, axis=1) - GROUND


def rms(off: np.ndarray) -> float:
    """Per axis, m."""
    return float(np.sqrt(np.nanmean(np.abs(off) ** 2) / 2))


@pytest.fixture(scope='module')
def four_bar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Film, Path]:
    """Two seconds of the four-bar, 24 mm tags of 29 pixels, and its video."""
    film = Film(times(60), camera=SMALL)
    return film, film.write(tmp_path_factory.mktemp('film') / 'four_bar.mp4')


def test_corners_are_where_the_tags_are(four_bar: tuple[Film, Path]) -> None:
    film, path = four_bar
    filmed = read_film(path, OPTIONS)
    assert filmed.tags == tuple(range(7))
    assert np.isfinite(filmed.corners).mean() > 0.99
    # One tag of the ground tells the direction of x less well: 0.1 pixels are 0.08 mm.
    turn = np.nanmean(filmed.corners * np.conj(exact(film)))
    turn /= abs(turn)
    assert abs(np.angle(turn)) < 1.5e-3
    assert rms(filmed.corners * np.conj(turn) - exact(film)) < 0.08e-3
    assert np.abs(np.diff(filmed.stamps) - 1e9 / 30).max() < 1e5
    pixels = np.stack(list(film.corners().values()), axis=1)
    shown = np.stack([filmed.to_pixels(row, k) for k, row in enumerate(filmed.corners)])
    assert np.nanmax(np.abs(shown - pixels)) < 1.5
    assert len(filmed.assumed) == 3


def test_blur_moves_no_corner_and_hides_no_tag() -> None:
    """Edges that are blurred mix with their neighbors, and no code is read any more."""
    film = Film(0.5 + times(16), FOUR_BAR[2:4], exposure=8e-3)
    finder = TagFinder('36h11')
    found = [finder.find(gray) for gray in film.pictures()]
    assert [sorted(tags) for tags, _ in found] == [[2, 3]] * 16
    exact = film.corners()
    off = [
        corners[tags.index(tag)] - exact[tag][k]
        for k, (tags, corners) in enumerate(found)
        for tag in (2, 3)
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.1
    assert np.abs(off).max() < 0.5


@pytest.mark.parametrize('share', [0.05, 0.15])
def test_a_tag_that_is_partly_outside_of_the_picture_is_left_out(share: float) -> None:
    """Its code would match, and its corners be several percent of its side off."""
    film = Film(times(1), FOUR_BAR[:3])
    (gray,) = film.pictures()
    last = film.corners()[2][0, :, 0]
    cut = round(last.max() - share * np.ptp(last))
    finder = TagFinder('36h11')
    assert sorted(finder.find(gray)[0]) == [0, 1, 2]
    assert sorted(finder.find(np.ascontiguousarray(gray[:, :cut]))[0]) == [0, 1]


@pytest.mark.filterwarnings('error')
def test_pictures_without_tags_have_no_corners() -> None:
    random = np.random.default_rng(0)
    ramp = np.tile(np.arange(90, dtype=np.uint8) * 2, (60, 1))
    noise = random.integers(0, 256, (60, 90)).astype(np.uint8)
    quads = random.uniform(-40, 130, (20, 4, 2))
    quads[:3] = quads[:3, :1]
    quads[3:5] *= 1e4
    for gray in (noise, ramp, 0 * ramp):
        assert np.isnan(refine_corners(gray, quads, codes('36h11', range(20)))).all()


def test_rates_and_poles_of_the_bag_are_those_of_the_motion(
    four_bar: tuple[Film, Path], tmp_path: Path
) -> None:
    film, path = four_bar
    bag = tmp_path / 'four_bar.mcap'
    film_to_bag(path, bag, OPTIONS)
    result = replay(bag, **PARAMETERS)
    motion = load_scene('four_bar').motion(result.t + film.times[0])['coupler']
    coupler = result['coupler']
    error = coupler.angular_velocity - motion.angle[1]
    assert np.median(np.abs(error / motion.angle[1])) < 0.02
    assert np.mean(np.abs(error) < 2 * coupler.angular_velocity_sigma) >= 0.9
    center = motion.position[0] + 1j * motion.position[1] / motion.angle[1] - GROUND
    off = np.abs(coupler.icr @ (1, 1j) - center)
    assert np.nanmedian(off) < 0.01 * film.camera.width


def test_a_lens_and_uneven_stamps_and_a_rolling_shutter_are_corrected(tmp_path: Path) -> None:
    camera = replace(SMALL, lens=(-0.12, 0.02, 0.001, 0.0))
    random = np.random.default_rng(1)
    uneven = times(20) + random.uniform(-0.008, 0.008, 20)
    line_time = 40e-6
    film = Film(uneven, camera=camera, line_time=line_time)
    path = film.write(tmp_path / 'phone.mp4')
    camera.write(tmp_path / 'camera.yaml')
    given = FilmOptions(size=SIZE, camera=str(tmp_path / 'camera.yaml'), line_time=line_time)
    filmed = read_film(path, given)
    assert np.abs(np.diff(filmed.stamps) * 1e-9 - np.diff(uneven)).max() < 1e-4
    assert rms(filmed.corners - exact(film)) < 0.3e-3
    # Without each of them it is worse.
    others = [FilmOptions(size=SIZE, camera=given.camera), FilmOptions(SIZE, line_time=line_time)]
    assert rms(read_film(path, others[0]).corners - exact(film)) > 0.5e-3


def test_a_known_camera_places_tags_at_different_heights() -> None:
    """Links lie on each other: a tag that is nearer looks larger, and is seen farther outside."""
    heights = {'ground': 0.0, 'crank': 0.008, 'coupler': 0.016, 'rocker': 0.008}
    tags = tuple(replace(tag, height=heights[tag.body]) for tag in FOUR_BAR)
    film = Film(times(60), tags, SMALL)
    noise = 0.07 * np.random.default_rng(0).standard_normal((60, 7, 4, 2))
    pixels = np.stack(list(film.corners().values()), axis=1) + noise
    stamps = np.rint(1e9 * (film.times - film.times[0])).astype(int)
    seen = Seen(list(range(7)), stamps, pixels, np.empty((60, 0, 2)), SMALL.size, '36h11')
    # A focal length that is 1% wrong, as of a calibration.
    lens = Lens(SMALL.matrix * [[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]], np.zeros(5))
    filmed = place_seen(seen, OPTIONS, lens)
    assert rms(filmed.corners - exact(film)) < 0.3e-3
    assert rms(place_seen(seen, OPTIONS).corners - exact(film)) > 1.5e-3
    assert np.ptp(list(filmed.heights.values())) == pytest.approx(0.016, abs=2e-3)
    assert 'the heights of tags differ by 1' in filmed.assumed[-1]
    # What is drawn over a tag is as high as that.
    high = np.array(list(filmed.heights.values()))[:, None]
    assert np.abs(filmed.to_pixels(filmed.corners[9], 9, high) - pixels[9]).max() < 0.5
    assert np.abs(filmed.to_pixels(filmed.corners[9], 9) - pixels[9]).max() > 3
    live = LiveTags(OPTIONS, lens)
    for row in pixels:
        _, places = live.place(list(range(7)), row, SMALL.size, '36h11')
    assert rms(places - exact(film)[-1].ravel()) < 0.3e-3
    # One that is never whole has no height.
    broken = np.where(np.arange(7)[:, None, None] == 6, np.nan, pixels)
    assert place_seen(replace(seen, pixels=broken), OPTIONS, lens).heights[6] == 0
    # Tags at one height have no heights of their own.
    flat = np.stack(list(replace(film, tags=FOUR_BAR).corners().values()), axis=1) + noise
    assert not any(place_seen(replace(seen, pixels=flat), OPTIONS, lens).heights.values())


def test_a_film_of_few_places_is_taken_for_one_from_the_front(tmp_path: Path) -> None:
    tags = (Tag(3, 'ground', -0.05 + 0.1j), Tag(4, 'ground', 0.3 + 0.1j))
    front = replace(SMALL, tilt=0.0)
    film = Film(times(10), tags, front)
    filmed = read_film(film.write(tmp_path / 'two.mp4'), OPTIONS)
    assert 'tag 0 is not seen, so the origin is the middle of the picture' in filmed.assumed[1 + 1]
    place = filmed.corners.mean(axis=(0, 2))
    assert abs(place[1] - place[0]) == pytest.approx(0.35, rel=0.01)
    # Far from the tags, too.
    corner = filmed.maps[0].to_plane(np.array([0.0, 0.0]))
    assert abs(corner - (-0.475 + 0.267j)) < 0.05


def test_a_tag_behind_a_finger_is_left_out_and_found_again(tmp_path: Path) -> None:
    film = Film(times(18), camera=SMALL, hidden={4: range(6, 11)})
    filmed = read_film(film.write(tmp_path / 'finger.mp4'), OPTIONS)
    is_seen = np.isfinite(filmed.corners).all(axis=-1)
    assert not is_seen[6:11, 4].any()
    assert is_seen[12:, 4].all()
    assert is_seen[:, [0, 1, 2, 3, 5, 6]].mean() > 0.98
    assert rms(filmed.corners - exact(film)) < 0.3e-3


def test_a_hand_that_holds_the_camera_is_corrected_by_the_ground(tmp_path: Path) -> None:
    t = times(14)
    shake = np.stack((8 * np.sin(5 * t), 6 * np.cos(4 * t), 0.01 * np.sin(3 * t)), axis=-1)
    tags = (*FOUR_BAR, Tag(7, 'ground', 0.42 - 0.13j, 0.5))
    film = Film(t, tags, SMALL, shake=shake)
    path = film.write(tmp_path / 'hand.mp4')
    two = read_film(path, FilmOptions(SIZE, ground=(0, 7)))
    assert 'x toward tag 7' in two.assumed[2] and 'the camera moves by' in two.assumed[2]
    assert rms(two.corners - exact(film)) < 0.4e-3
    pixels = [two.to_pixels(row, k) for k, row in enumerate(two.corners)]
    middle = np.array(SMALL.size) / 2
    for k, (right, down, turn) in enumerate(shake):
        c, s = np.cos(turn), np.sin(turn)
        still = np.stack(list(film.corners(t[k : k + 1]).values()), axis=1)[0]
        seen = (still - middle) @ np.array([[c, -s], [s, c]]) + middle + (right, down)
        assert np.nanmedian(np.abs(pixels[k] - seen)) < 0.5
    # One tag of 29 pixels tells less about how the camera turns.
    one = read_film(path, FilmOptions(SIZE))
    assert rms(one.corners - exact(film)) < 3e-3


def test_markers_have_the_names_of_their_tags(four_bar: tuple[Film, Path], tmp_path: Path) -> None:
    bag = tmp_path / 'named.mcap'
    assert main(['film', str(four_bar[1]), '--size', '24mm', '--output', str(bag)]) == 0
    frames, topic = read_frames(bag, None, 60.0)
    assert topic == '/markers'
    assert frames[0].identities[8:12] == tuple(f'tag2_{k}/{k + 7}' for k in range(1, 5))


def test_one_command_makes_a_report_and_says_in_five_lines_what_it_assumed(
    four_bar: tuple[Film, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / 'four_bar.html'
    assert main(['report', str(four_bar[1]), '--size', '24mm', '--output', str(page)]) == 0
    lines = capsys.readouterr().out.splitlines()
    subjects = [line.split()[0].rstrip(':') for line in lines[:5]]
    assert subjects == ['film', 'tags', 'plane', 'bodies', 'window']
    assert all('to change: ' in line for line in lines[:5])
    start = next(k for k, line in enumerate(lines) if line.startswith('length'))
    lengths = [float(line.split()[2]) for line in lines[start + 1 : start + 5]]
    assert sorted(lengths) == pytest.approx([120, 280, 360, 400], rel=0.005)
    assert page.stat().st_size > 100_000


def test_options_of_videos_are_refused_for_other_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / 'points.csv'
    table.write_text('t,a_x,a_y\n0,0,0\n')
    assert main(['report', str(table), '--size', '24mm']) == 2
    assert 'is no video, and --size are of videos' in capsys.readouterr().err
    assert main(['report', str(tmp_path / 'x.mp4'), '--scale', '30']) == 2
    assert 'its scale is --size; --scale are for files of points' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('content', 'text'),
    [(b'', 'cannot be read as a video'), (b'\0' * 5000, 'cannot be read as a video')],
)
def test_what_is_no_video_is_refused_in_one_line(
    content: bytes, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'x.mp4'
    path.write_bytes(content)
    assert main(['film', str(path), '--output', str(tmp_path / 'x.mcap')]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count('\n') == 1
    assert not (tmp_path / 'x.mcap').exists()


def test_tags_of_a_camera_are_placed_after_a_second_and_a_half(
    four_bar: tuple[Film, Path],
) -> None:
    film, path = four_bar
    live, whole = LiveTags(OPTIONS), exact(film)
    seen = 0
    for k, picture in enumerate(Video(path).pictures()):
        names, places = live.find(picture.gray)
        assert bool(names) == (k >= 44)
        for name, place in zip(names, places, strict=True):
            if np.isnan(place):
                continue
            seen += 1
            tag, corner = map(int, name.removeprefix('tag').split('_'))
            assert abs(place - whole[k, tag, corner - 1]) < 1.5e-3
    assert seen > 0.98 * 28 * 16


def test_pictures_of_a_camera_that_come_too_fast_are_left_out() -> None:
    gray, all_came, may_end = np.zeros((2, 2), np.uint8), threading.Event(), threading.Event()

    def pictures() -> Iterator[Picture]:
        yield Picture(0, gray)
        assert may_end.wait(20)
        for stamp in range(1, 6):
            yield Picture(stamp, gray)
        all_came.set()
        raise FilmError('no more')

    seen = ahead(pictures(), 1, are_old_left_out=True)
    assert next(seen).stamp == 0
    may_end.set()
    assert all_came.wait(20)
    assert next(seen).stamp == 5
    with pytest.raises(FilmError, match='no more'):
        next(seen)


def test_a_live_camera_has_to_stand_still(tmp_path: Path) -> None:
    t = times(46)
    shake = np.stack((8 * np.sin(5 * t), 6 * np.cos(4 * t)), axis=-1)
    corners = Film(t, FOUR_BAR[:1], SMALL).corners()[0] + shake[:, None]
    live = LiveTags(OPTIONS)
    with pytest.raises(FilmError, match=r'the camera moves against .* live it has to stand still'):
        for places in corners:
            live.place([0], places[None], SMALL.size, '36h11')
    with pytest.raises(FilmError, match='--line-time is for videos'):
        LiveTags(FilmOptions(line_time=1e-5))


def test_a_camera_publishes_markers(four_bar: tuple[Film, Path]) -> None:
    pytest.importorskip('rclpy')
    from kinpole_ros.ros.listener import listen

    words = ['-m', 'kinpole_ros.tools.cli', 'camera', str(four_bar[1]), '--size', '24mm']
    command = [*LIMITED, *words, '--topic', '/film/markers']
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        try:
            assert process.stdout is not None
            while b'markers on /film/markers' not in process.stdout.readline():
                assert process.poll() is None
            frames, _ = listen('/film/markers', 0.2)
            out, _ = process.communicate(timeout=50)
        finally:
            process.kill()
    assert b'16 messages published' in out and b'is the origin' in out
    steps = np.diff(np.concatenate([one.stamps for one in frames]))
    assert len(steps) and np.abs(steps % (10**9 / 30)).min() < 1e6
    assert frames[0].points.shape[1] == 28


# A camera that waits for a signal before it places its first tags.
PAUSE = """
import sys, time
from kinpole_ros.film import LiveTags
from kinpole_ros.ros import executor
from kinpole_ros.tools.cli import main

place, start, requests = LiveTags.place, executor.start_ros, []

def start_ros(words):
    requests.append(start(words))
    return requests[0]

def wait_and_place(*given):
    while not requests[0]():
        time.sleep(0.01)
    return place(*given)

executor.start_ros, LiveTags.place = start_ros, wait_and_place
sys.exit(main())
"""


def test_ctrl_c_ends_a_camera_with_its_count(four_bar: tuple[Film, Path]) -> None:
    pytest.importorskip('rclpy')
    words = ['-c', PAUSE, 'camera', str(four_bar[1]), '--size', '24mm']
    command = [*LIMITED, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        try:
            assert process.stdout is not None
            assert b'learning the plane' in process.stdout.readline()
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=50)
        finally:
            process.kill()
    assert (process.returncode, out) == (0, b'0 messages published\n')


def test_a_film_without_tags_is_refused(tmp_path: Path) -> None:
    film = Film(times(8), tags=(Tag(1, 'crank', 5.0 + 0j),), camera=Camera((320, 180)))
    with pytest.raises(FilmError, match='shows no tag'):
        read_film(film.write(tmp_path / 'empty.mp4'))


@pytest.mark.parametrize('ending', ['mp4', 'mkv'])
def test_damaged_videos_end_in_one_line(ending: str, tmp_path: Path) -> None:
    film = Film(times(7), camera=SMALL)
    whole = film.write(tmp_path / f'whole.{ending}').read_bytes()
    random = np.random.default_rng(0)
    path = tmp_path / f'damaged.{ending}'
    read = 0
    for number in range(10):
        damaged = bytearray(whole)
        for place in random.integers(0, len(whole), 1 + 3 * number):
            damaged[place] = random.integers(256)
        path.write_bytes(
            damaged[: random.integers(len(whole) // 2, len(whole)) if number % 2 else None]
        )
        try:
            read += bool(read_film(path, OPTIONS).tags)
        except FilmError as error:
            assert '\n' not in str(error)
    assert read


def test_pictures_are_turned_as_players_show_them(tmp_path: Path) -> None:
    path = Film(times(2), camera=Camera((320, 180))).write(tmp_path / 'flat.mp4')
    flat = [picture.gray for picture in Video(path).pictures()]
    # The matrix of the track, as phones write it that were held upright.
    one, zero, less = b'\0\1\0\0', b'\0' * 4, b'\xff\xff\0\0'
    before, matrix = path.read_bytes().rsplit(one + 3 * zero + one, 1)
    upright = tmp_path / 'upright.mp4'
    upright.write_bytes(before + zero + one + zero + less + zero + matrix)
    turned = [picture.gray for picture in Video(upright).pictures()]
    assert len(turned) == 2 and turned[0].shape == (320, 180)
    assert (turned[0] == np.rot90(flat[0], -1)).all()


def test_an_unknown_compression_is_refused(tmp_path: Path) -> None:
    film = Film(times(2), camera=Camera((320, 180)))
    whole = film.write(tmp_path / 'whole.mp4').read_bytes()
    (tmp_path / 'odd.mp4').write_bytes(whole.replace(b'avc1', b'zzz1'))
    with pytest.raises(FilmError, match='cannot be read as a video'):
        read_film(tmp_path / 'odd.mp4')


def test_without_the_extra_one_line_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith('kinpole_ros.film')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'cv2', None)
    monkeypatch.setitem(sys.modules, 'av', None)
    assert main(['film', 'x.mp4', '--output', str(tmp_path / 'x.mcap')]) == 2
    error = capsys.readouterr().err
    assert 'install them with pip install av opencv-python-headless' in error
    assert error.count('\n') == 1
