"""The file of a camera: its matrix and lens, as OpenCV's calibration and ROS write them."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml

from kinpole_ros.files import read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml
from kinpole_ros.film._video import FilmError

_COUNTS = (4, 5, 8, 12, 14)  # of the coefficients of a lens, in OpenCV
_ASPECT = 0.01  # of a picture: if it differs by more, parts of it were cut off
_DAMAGED = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, OverflowError)


class Lens(NamedTuple):
    """A camera: its matrix (3, 3), pixels, and the coefficients (k,) of its lens."""

    matrix: np.ndarray
    coefficients: np.ndarray

    def straight(self, pixels: np.ndarray) -> np.ndarray:
        """Return where a perfect lens shows what is seen at pixels (..., 2)."""
        flat = np.ascontiguousarray(pixels.reshape(-1, 1, 2), float)
        if not len(flat):
            return pixels
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-6)
        # OpenCV 4 has another function for more than 5 rounds.
        undistort = getattr(cv2, 'undistortPointsIter', cv2.undistortPoints)
        done = undistort(
            flat, self.matrix, self.coefficients, R=None, P=self.matrix, criteria=criteria
        )
        return np.asarray(done.reshape(pixels.shape))

    def curved(self, pixels: np.ndarray) -> np.ndarray:
        """Return where this lens shows what a perfect one shows at pixels (..., 2)."""
        flat = np.column_stack((pixels.reshape(-1, 2), np.ones(pixels.size // 2)))
        if not len(flat):
            return pixels
        rays = flat @ np.linalg.inv(self.matrix).T
        shown, _ = cv2.projectPoints(
            rays[:, None], np.zeros(3), np.zeros(3), self.matrix, self.coefficients
        )
        return np.asarray(shown.reshape(pixels.shape))


def read_lens(path: str | Path, size: tuple[int, int]) -> Lens:
    """
    Read the file of a camera, for pictures of `size` (width, height).

    The matrix is scaled to pictures smaller or larger than those of the calibration. Raises
    FilmError.
    """
    try:
        text = read_limited(path, MOST_YAML).decode()
        # OpenCV's header is not YAML, and its matrices have a tag of their own.
        text = re.sub(r'^%YAML:1\.0\s*', '', text).replace('!!opencv-matrix', '')
        content = load_yaml(text)
        matrix = _numbers(content['camera_matrix']).reshape(3, 3)
        name = 'distortion_coefficients'
        coefficients = _numbers(content[name if name in content else 'dist_coeffs'])
        width, height = float(content['image_width']), float(content['image_height'])
    except _DAMAGED as error:
        raise FilmError(
            f'{path} is not the file of a camera ({" ".join(str(error).split())[:120]}); fix: '
            'camera_matrix, distortion_coefficients, image_width and image_height, as kinpole film '
            '--calibrate writes them'
        ) from None
    if content.get('distortion_model', 'plumb_bob') not in ('plumb_bob', 'rational_polynomial'):
        raise FilmError(f'{path} is of a fisheye lens; fix: calibrate as plumb_bob')
    scale = size[0] / width if width > 0 else np.nan
    good = len(coefficients) in _COUNTS and np.isfinite(coefficients).all()
    if not (good and np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise FilmError(f'{path} has no camera_matrix of a camera; fix: calibrate it again')
    if not abs(scale * height / size[1] - 1) < _ASPECT:
        raise FilmError(
            f'{path} is of pictures of {width:g} x {height:g}, and the video has {size[0]} x '
            f'{size[1]}; fix: calibrate the camera in the mode in which it films'
        )
    # Pixel centers are at whole numbers.
    matrix = np.array([[scale, 0, scale / 2 - 0.5], [0, scale, scale / 2 - 0.5], [0, 0, 1]]) @ (
        matrix + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    )
    return Lens(matrix, coefficients)


def _numbers(value: Any) -> np.ndarray:
    """Return the numbers of a matrix with rows, cols and data, or of a list."""
    data = value['data'] if isinstance(value, dict) else value
    return np.array([float(x) for x in data])
