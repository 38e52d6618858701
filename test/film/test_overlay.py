"""Poles and outlines lie on what the film shows, in a video and in a page."""

import re
import shlex
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from conftest import data_of
from rendered import Camera, Film, Tag

from kinpole_ros.film import FilmOptions
from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._families import codes
from kinpole_ros.film._filmed import Seen
from kinpole_ros.film._overlay import Shape, draw_shape
from kinpole_ros.film._placing import place_seen
from kinpole_ros.mechanism import load_scene
from kinpole_ros.tools.cli import main

DOCS = Path(__file__).parents[2] / 'docs'
PICTURE = DOCS / 'film.jpg'
CAMERA = Camera((960, 540), 0.95, 0.15 + 0.1j)
TAGS = tuple(
    Tag(number, body, center, turn, 0.04)
    for number, (body, center, turn) in enumerate(
        [
            ('ground', -0.12 - 0.1j, 0.0),
            ('crank', 0.025 + 0j, 0.0),
            ('crank', 0.095 + 0j, 0.3),
            ('coupler', 0.06 + 0.14j, 0.2),
            ('coupler', 0.25 + 0.03j, -0.4),
            ('rocker', 0.07 + 0j, 0.0),
            ('rocker', 0.2 + 0j, 1.0),
        ]
    )
)


@pytest.fixture(scope='module')
def four_bar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Film, Path]:
    film = Film(0.1 + np.arange(60) / 30, TAGS, CAMERA)
    return film, film.write(tmp_path_factory.mktemp('film') / 'four_bar.mp4')


def test_the_pole_of_the_rocker_is_drawn_on_its_pin(
    four_bar: tuple[Film, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film, path = four_bar
    output = tmp_path / 'poles.mp4'
    assert main(['film', str(path), '--overlay', str(output)]) == 0
    assert 'drawn over the video' in capsys.readouterr().out
    with av.open(str(output)) as container:
        pictures = [frame.to_ndarray(format='rgb24') for frame in container.decode(video=0)]
    assert len(pictures) == len(film.times)
    x, y = CAMERA.pixels(np.array([0.4 + 0j]))[0]
    rates = load_scene('four_bar').motion(film.times)['rocker'].angle[1]
    # Where the rocker turns back its pole is not known.
    turning = np.flatnonzero(np.abs(rates) > 1)
    offs = []
    for picture in [pictures[k] for k in turning if k % 4 == 0 and 10 < k < 50]:
        part = picture[round(y) - 9 : round(y) + 10, round(x) - 9 : round(x) + 10].astype(int)
        # The rocker is green, and the wall gray.
        weight = np.clip(part[..., 1] - part[..., 0] - 60, 0, None)
        assert weight[9, 9] > 60
        rows, columns = np.indices(weight.shape)
        row, column = ((values * weight).sum() / weight.sum() for values in (rows, columns))
        offs.append((column + round(x) - 9 - x, row + round(y) - 9 - y))
    # Colors have half the resolution of a video.
    assert np.abs(np.median(offs, axis=0)).max() < 0.7
    assert np.abs(offs).max() < 1.5


def test_a_page_shows_the_film_under_the_drawing_at_the_same_instant(
    four_bar: tuple[Film, Path], tmp_path: Path, browser: Any
) -> None:
    output = tmp_path / 'four_bar.html'
    assert main(['report', str(four_bar[1]), '--output', str(output)]) == 0
    data = data_of(output)
    assert len(data['film']['at']) == len(data['t'])
    page = browser.new_page(viewport={'width': 1800, 'height': 1300})
    requests: list[str] = []
    page.on('request', lambda request: requests.append(request.url))
    page.goto(f'{output.as_uri()}#t=0.2')
    page.wait_for_selector('html[data-ready]')
    # What is drawn over the film would hide it.
    page.add_style_tag(content='#stage canvas:not([data-view]), #views { visibility: hidden }')
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    )
    rates = [abs(one['angular_velocity']['value'][9]) for one in data['bodies']]
    body = data['bodies'][int(np.argmax(rates))]
    for k in range(5, 45, 4):
        page.evaluate(
            'k => { const s = document.getElementById("scrub"); s.value = k; '
            's.dispatchEvent(new Event("input")); }',
            k,
        )
        number = data['film']['at'][k]
        page.wait_for_selector(f'#stage canvas[data-shown="{number}"]')
        shot = cv2.imdecode(np.frombuffer(page.query_selector('#stage').screenshot(), np.uint8), 0)
        quads, numbers, _ = detector.detectMarkers(shot)
        x, y, scale = map(
            float, page.get_attribute('#stage canvas[data-view]', 'data-view').split(',')
        )
        own = np.isin(numbers.ravel(), (1, 2))
        assert own.sum() == 2
        own_codes = codes('36h11', numbers.ravel()[own].tolist())
        seen = refine_corners(shot, np.array(quads).reshape(-1, 4, 2)[own], own_codes)
        seen = seen.reshape(-1, 2)
        marks = np.array(body['outlines'][0][1]) @ (1, 1j)
        place = body['x'][k] + 1j * body['y'][k] + marks * np.exp(1j * body['angle'][k])
        box = page.eval_on_selector(
            '#stage', 'e => { const r = e.getBoundingClientRect(); return [r.width, r.height]; }'
        )
        inner = page.eval_on_selector('#stage canvas', 'c => [c.clientWidth, c.clientHeight]')
        drawn = np.stack((place.real - x, y - place.imag), axis=-1) * scale + np.array(box) / 2
        # The border of the stage, and centers of pixels at whole numbers.
        border = (np.array(box) - inner) / 2
        drawn = drawn * inner / box + border - 0.5
        off = np.abs(drawn[:, None] - seen).max(axis=-1).min(axis=1)
        assert off.max() < 1
    page.close()
    assert [url for url in requests if not url.startswith(('file:', 'data:'))] == []


def test_the_tutorial_of_films(
    four_bar: tuple[Film, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'crank.mp4').symlink_to(four_bar[1])
    text = (DOCS / 'film.md').read_text('utf-8')
    lines = ''.join(re.findall(r'```bash\n(.*?)```', text, re.S)).splitlines()
    assert len(lines) == 9
    for line in lines:
        assert main(shlex.split(line)[1:]) == 0, line
    printed = capsys.readouterr().out.splitlines()
    (shown,) = re.findall(r'```text\n(.*?)```', text, re.S)
    for line in shown.splitlines():
        # Numbers depend on the version of the encoder.
        assert re.sub('[0-9.]+', '#', line) in [re.sub('[0-9.]+', '#', one) for one in printed]
    for name in (
        'crank.html',
        'poles.mp4',
        'crank.csv',
        'draft.yaml',
        'tags.pdf',
        'first.png',
        'dots.mcap',
    ):
        assert (tmp_path / name).stat().st_size > 500
    assert 'film' in data_of(tmp_path / 'crank.html')
    with av.open('poles.mp4') as container:
        frames = [frame.to_ndarray(format='bgr24') for frame in container.decode(video=0)]
    picture = cv2.resize(frames[32], (768, 432), interpolation=cv2.INTER_AREA)
    cv2.imwrite('film.jpg', picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    committed = cv2.imread(str(PICTURE))
    off = np.abs(cv2.imread('film.jpg').astype(int) - committed)
    assert off.mean() < 4, f'{PICTURE} is not what is drawn: replace it by {tmp_path}/film.jpg'


def test_lines_are_broken_where_the_plane_is_behind_the_camera() -> None:
    picture = np.zeros((90, 160, 3), np.uint8)
    points = np.array([[10, 10], [80, 10], [np.nan, np.nan], [10, 50], [80, 50]], float)
    draw_shape(picture, points, Shape(points @ (1, 1j), (255, 255, 255)))
    assert picture[10, 40].all() and picture[50, 40].all() and not picture[30].any()


def test_points_behind_the_camera_have_no_pixels() -> None:
    film = Film(0.1 + np.arange(20) / 30, TAGS, CAMERA)
    corners = np.stack(list(film.corners().values()), axis=1)
    no_dots = np.empty((20, 0, 2))
    seen = Seen(list(range(7)), np.arange(20), corners, no_dots, CAMERA.size, '36h11')
    filmed = place_seen(seen, FilmOptions())
    pixels = filmed.to_pixels(np.array([0j, 50 - 50j, 50j]), 0)
    assert np.isfinite(pixels[0]).all()
    assert np.isnan(pixels).any()
