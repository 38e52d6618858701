"""A camera: what its lens bends, and its matrix for pictures of any size."""

from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from kinpole_ros.film._camera_file import read_camera_file
from kinpole_ros.film._decoder import FilmError

_ASPECT = 0.01  # of a picture: if it differs by more, parts of it were cut off


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


def rectified_lens(info: Any) -> Lens | None:
    """Return the camera of rectified pictures by a CameraInfo; None if it is not calibrated."""
    matrix = np.array(info.p, float).reshape(3, 4)[:, :3]
    return Lens(matrix, np.zeros(5)) if matrix[0, 0] > 0 and matrix[1, 1] > 0 else None


def read_lens(path: str | Path, size: tuple[int, int]) -> Lens:
    """
    Read the file of a camera, for pictures of `size` (width, height).

    The matrix is scaled to pictures smaller or larger than those of the calibration. Raises
    FilmError.
    """
    matrix, coefficients, (width, height) = read_camera_file(path)
    scale = size[0] / width if width > 0 else np.nan
    if not abs(scale * height / size[1] - 1) < _ASPECT:
        raise FilmError(
            f'{path} is of pictures of {width:g} x {height:g}, and the video has {size[0]} x '
            f'{size[1]}; fix: calibrate the camera in the mode in which it films'
        )
    # The centers of pixels are at whole numbers, so the corner of a picture is at -1/2.
    shift = scale / 2 - 0.5
    return Lens(np.array([[scale, 0, shift], [0, scale, shift], [0, 0, 1]]) @ matrix, coefficients)
