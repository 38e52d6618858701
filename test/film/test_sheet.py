"""The printed sheet: tags to scale that are found, and a camera from a film of it."""

import re
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from kinpole_ros.film import FilmError, FilmOptions, calibrate, print_sheet
from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._families import FAMILIES, codes
from kinpole_ros.film._lens import read_lens
from kinpole_ros.tools.cli import main

DOTS = 6  # a mm


def drawn(path: Path) -> np.ndarray:
    """The sheet (h, w), uint8, from the rectangles of its SVG, or of its PDF."""
    page = np.full((297 * DOTS, 210 * DOTS), 255, np.uint8)
    text = path.read_text()
    pattern = r'x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)" fill="#(..)'
    rows = [(*map(float, row[:4]), int(row[4], 16)) for row in re.findall(pattern, text)]
    if path.suffix == '.pdf':
        found = re.findall(r'(\S+) g (\S+) (\S+) (\S+) (\S+) re f', text)
        rows = [
            (float(x), 297 - float(y) - float(h), float(w), float(h), 255 * float(g))
            for g, x, y, w, h in found
        ]
    for x, y, w, h, gray in rows:
        left, top, right, bottom = np.rint(np.array([x, y, x + w, y + h]) * DOTS).astype(int)
        page[top:bottom, left:right] = gray
    return page


def tags_on(page: np.ndarray, family: str) -> dict[int, np.ndarray]:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILIES[family]))
    quads, numbers, _ = detector.detectMarkers(page)
    tags = numbers.ravel().tolist()
    places = refine_corners(page, np.array(quads).reshape(-1, 4, 2), codes(family, tags))
    return dict(zip(tags, places, strict=True))


@pytest.mark.parametrize('ending', ['svg', 'pdf'])
def test_tags_are_printed_to_scale(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f'tags.{ending}'
    assert main(['film', '--print', str(path), '--size', '40mm']) == 0
    assert f'tags of 40 mm written to {path}' in capsys.readouterr().out
    tags = tags_on(drawn(path), '36h11')
    assert sorted(tags) == list(range(len(tags))) and len(tags) % 2 == 1 and len(tags) >= 7
    sides = [np.linalg.norm(np.diff(quad, axis=0), axis=1) / DOTS for quad in tags.values()]
    assert np.abs(np.array(sides) - 40).max() < 0.1
    # Upright: the first corner is the top left one.
    assert all((quad[0] < quad[2]).all() for quad in tags.values())


def test_another_family_and_another_size(tmp_path: Path) -> None:
    assert print_sheet(tmp_path / 'tags.svg', 0.02, '6x6_250') > 20
    assert len(tags_on(drawn(tmp_path / 'tags.svg'), '6x6_250')) > 20
    with pytest.raises(FilmError, match='three tags must fit on A4'):
        print_sheet(tmp_path / 'large.svg', 0.15)
    assert not (tmp_path / 'large.svg').exists()


def film_of_sheet(path: Path, page: np.ndarray, matrix: np.ndarray, lens: np.ndarray) -> None:
    """Film a sheet from several sides."""
    size = 960, 540
    grid = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1)
    rays = cv2.undistortPoints(grid.reshape(-1, 1, 2).astype(float), matrix, lens).reshape(-1, 2)
    rays = np.column_stack((rays, np.ones(len(rays))))
    soft, random = cv2.GaussianBlur(page, (0, 0), 3), np.random.default_rng(0)
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('libx264', rate=30)
        stream.width, stream.height, stream.pix_fmt = *size, 'yuv420p'
        stream.options = {'crf': '16', 'preset': 'veryfast'}
        stream.codec_context.time_base = Fraction(1, 30)
        for number in range(16):
            turn = cv2.Rodrigues(np.array([*random.uniform(-0.6, 0.6, 2), random.uniform(-3, 3)]))[
                0
            ]
            middle = np.array([*random.uniform(-0.06, 0.06, 2), random.uniform(0.28, 0.4)])
            to_page = np.linalg.inv(np.column_stack((turn[:, :2], middle)))
            on_page = rays @ to_page.T
            at = on_page[:, :2] / on_page[:, 2:] * 1000 * DOTS + (105 * DOTS, 148.5 * DOTS) - 0.5
            at = at.reshape(size[1], size[0], 2).astype(np.float32)
            view = cv2.remap(soft, at, None, cv2.INTER_LINEAR, borderValue=120)
            gray = np.concatenate((view, np.full((size[1] // 2, size[0]), 128, np.uint8)))
            frame = av.VideoFrame.from_ndarray(gray, 'yuv420p')
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def test_a_camera_is_calibrated_by_the_uncut_sheet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    print_sheet(tmp_path / 'tags.svg', 0.04)
    matrix = np.array([[900.0, 0, 470], [0, 900, 280], [0, 0, 1]])
    lens = np.array([-0.15, 0.03, 0.001, 0, 0])
    film_of_sheet(tmp_path / 'sheet.mp4', drawn(tmp_path / 'tags.svg'), matrix, lens)
    words = ['film', str(tmp_path / 'sheet.mp4'), '--calibrate', str(tmp_path / 'camera.yaml')]
    assert main(words) == 0
    assert 'focal length' in capsys.readouterr().out
    found = read_lens(tmp_path / 'camera.yaml', (960, 540))
    assert found.matrix[0, 0] == pytest.approx(900, rel=0.01)
    grid = np.stack(np.meshgrid([100.0, 480, 860], [60.0, 270, 480]), axis=-1)
    exact = cv2.undistortPoints(grid.reshape(-1, 1, 2), matrix, lens, P=matrix).reshape(-1, 2)
    off = found.straight(grid).reshape(-1, 2) - exact
    assert np.abs(off - off.mean(axis=0)).max() < 3
    assert np.abs(found.curved(found.straight(grid)) - grid).max() < 0.01
    # Pictures of half the size are of the same camera.
    assert read_lens(tmp_path / 'camera.yaml', (480, 270)).matrix[0, 0] == pytest.approx(
        found.matrix[0, 0] / 2
    )
    with pytest.raises(FilmError, match='calibrate the camera in the mode'):
        read_lens(tmp_path / 'camera.yaml', (640, 480))


@pytest.mark.parametrize('text', ['', 'a: 1', 'camera_matrix: [1, 2]', '!!opencv-matrix', '{' * 90])
def test_what_is_no_file_of_a_camera_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / 'camera.yaml').write_text(text)
    with pytest.raises(FilmError, match='is not the file of a camera') as error:
        read_lens(tmp_path / 'camera.yaml', (640, 480))
    assert '\n' not in str(error.value)


def test_a_film_that_shows_the_sheet_from_one_side_is_refused(tmp_path: Path) -> None:
    page = np.full((297 * DOTS, 210 * DOTS), 255, np.uint8)
    film_of_sheet(tmp_path / 'x.mp4', page, np.diag([900.0, 900, 1]), np.zeros(5))
    with pytest.raises(FilmError, match='from 0 sides, and 8 are needed'):
        calibrate(tmp_path / 'x.mp4', tmp_path / 'x.yaml', FilmOptions())
