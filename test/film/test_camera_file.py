"""Files of cameras, as programs write them, give the camera that they are of."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinpole_ros.film import FilmError
from kinpole_ros.film._lens import read_lens

SIZE = 1280, 720
MATRIX = np.array([[1078.2, 0, 684.88], [0, 1073.1, 408.74], [0, 0, 1]])
LENS = np.array([0.16, -0.93, 0.0042, 0.0059, 2.28])
FLAT, FOUR = MATRIX.ravel().tolist(), LENS[:4].tolist()
ROWS = '\n'.join(' '.join(map(str, row)) for row in MATRIX.tolist())
ALL = f'[{", ".join(map(str, LENS.tolist()))}]'
OST = f'# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n1280\n\nheight\n720\n\n[narrow]\n\n\
camera matrix\n{ROWS}\n\ndistortion\n{" ".join(map(str, LENS))}\n\nrectification\n{ROWS}\n'
ECHO = f'header:\n  stamp:\n    sec: 1\nheight: 720\nwidth: 1280\ndistortion_model: %s\nd: {ALL}\n\
k: {FLAT}\nbinning_x: 0\n---\nheight: 720\nwidth: 1280\n---\n'
KALIBR = f'cam0:\n  camera_model: pinhole\n  intrinsics: [1078.2, 1073.1, 684.88, 408.74]\n\
  distortion_model: radtan\n  distortion_coeffs: {FOUR}\n  resolution: [1280, 720]\n'
ANIPOSE = f'[cam_0]\nname = "a"\nsize = [ 1280, 720,]\nmatrix = {MATRIX.tolist()}\n\
distortions = {ALL}\nrotation = [ 0.0, 0.0, 0.0,]\n\n[metadata]\nadjusted = false\n'
FILES = {
    'rows.yaml': f'camera_matrix: {MATRIX.tolist()}\ndist_coeff: [{ALL}]\nsize: [1280, 720]\n',
    'camera.json': json.dumps({'K': MATRIX.tolist(), 'D': LENS.tolist(), 'size': SIZE}),
    'sizes.json': json.dumps({'mtx': MATRIX.tolist(), 'dist': [LENS.tolist()], 'img_size': SIZE}),
    'flat.yaml': '%YAML 1.2\n---\ncameraMatrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n'
    f'   data: {FLAT}\ndistCoeffs: !!opencv-nd-matrix\n   sizes: [ 5 ]\n   dt: d\n   data: {ALL}\n'
    'imageSize: [ 1280, 720 ]\n',
    'ost.txt': OST,
    'echo.yaml': ECHO % 'plumb_bob',
    'empty.yaml': ECHO % "''",
    'calib.toml': ANIPOSE,
}


@pytest.mark.parametrize('name', FILES)
def test_files_of_other_programs_are_read(name: str, tmp_path: Path) -> None:
    if name.endswith('.toml'):
        pytest.importorskip('tomllib')
    (tmp_path / name).write_text(FILES[name])
    lens = read_lens(tmp_path / name, SIZE)
    np.testing.assert_allclose(lens.matrix, MATRIX)
    np.testing.assert_allclose(lens.coefficients, LENS)


@pytest.mark.parametrize('name', ['c.xml', 'c.yaml', 'c.json'])
def test_files_of_opencv_are_read(name: str, tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    for key, value in {'image_width': 1280, 'image_height': 720, 'camera_matrix': MATRIX}.items():
        storage.write(key, value)
    storage.write('distortion_coefficients', LENS[None])
    storage.release()
    lens = read_lens(tmp_path / name, SIZE)
    np.testing.assert_allclose(lens.matrix, MATRIX)
    np.testing.assert_allclose(lens.coefficients, LENS)


def test_a_file_of_kalibr_has_four_numbers_and_four_coefficients(tmp_path: Path) -> None:
    path = tmp_path / 'camchain.yaml'
    path.write_text(KALIBR)
    lens = read_lens(path, SIZE)
    np.testing.assert_allclose(lens.matrix, MATRIX)
    np.testing.assert_allclose(lens.coefficients, FOUR)
    path.write_text(KALIBR + KALIBR.replace('cam0', 'cam1'))
    with pytest.raises(FilmError, match='has the cameras cam0, cam1; fix'):
        read_lens(path, SIZE)


@pytest.mark.parametrize(
    ('text', 'fault'),
    [
        (f'K: {FLAT}\nD: {ALL}\n', 'does not say the size of the pictures'),
        (f'K: {FLAT}\nwidth: 1280\nheight: 720\n', 'has no distortion_coefficients; fix: add'),
        (f'D: {ALL}\nwidth: 1280\nheight: 720\n', 'has no camera_matrix; fix: add'),
        (ECHO % 'equidistant', 'is of a fisheye lens'),
        (KALIBR.replace('radtan', 'equidistant'), 'is of a fisheye lens'),
        (KALIBR.replace('pinhole', 'omni'), 'a lens of the model omni, which is not read'),
        (f'K: {FLAT}\nD: [1, 2, 3]\nsize: [9, 9]', 'has 3 coefficients of a lens'),
        ('', 'it has no camera_matrix'),
        ('<a>', 'is not the file of a camera'),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a/>', 'it defines entities'),
        ('[1, 2]', 'it has no camera_matrix'),
        ('# Camera list\n1 OPENCV 1280 720 900 901 640 360\n', 'it has no camera_matrix'),
    ],
)
def test_what_a_file_lacks_is_named(text: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / 'camera'
    path.write_text(text)
    with pytest.raises(FilmError, match=fault) as caught:
        read_lens(path, SIZE)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('scale', [1.0, 0.5])
def test_points_are_seen_where_opencv_sees_them(scale: float, tmp_path: Path) -> None:
    """The centers of pixels are at whole numbers, so a smaller picture begins at -1/2, too."""
    path = tmp_path / 'echo.yaml'
    path.write_text(FILES['echo.yaml'])
    size = round(scale * SIZE[0]), round(scale * SIZE[1])
    points = np.random.default_rng(0).uniform((-0.3, -0.2, 1), (0.3, 0.2, 1), (20, 3))
    exact = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, LENS)[0].reshape(-1, 2)
    exact = scale * (exact + 0.5) - 0.5
    lens = read_lens(path, size)
    straight = (points @ lens.matrix.T)[:, :2]
    np.testing.assert_allclose(lens.curved(straight), exact, atol=1e-9)
    np.testing.assert_allclose(lens.straight(exact), straight, atol=1e-3)
