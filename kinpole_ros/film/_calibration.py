"""A camera from a film of the uncut sheet of tags, which is its board."""

from pathlib import Path

import cv2
import numpy as np

from kinpole_ros.files import whole_file
from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._filmed import FilmOptions
from kinpole_ros.film._printed import sheet_places
from kinpole_ros.film._tags import TagFinder
from kinpole_ros.film._video import Video

_MOST_VIEWS = 40  # pictures by which a camera is calibrated
_LEAST_VIEWS, _LEAST_TAGS = 8, 4
_APART = 0.02  # of the picture's width, between views that are used
_MOST_UNCERTAIN = 0.02  # of the focal length


def calibrate(path: str | Path, output: str | Path, options: FilmOptions) -> str:
    """
    Write the file of the camera that filmed a sheet, uncut and flat, from several sides.

    Returns what was found, in a line. Raises FilmError if the sheet is not seen often enough, or
    the views do not determine the camera.
    """
    # Views need no times, so pictures of any rate will do.
    video = Video(path, 1.0, options.topic)
    objects, images, picture = _views(video, options.size, options.family)
    if len(objects) < _LEAST_VIEWS:
        raise FilmError(
            f'{path} shows the sheet from {len(objects)} sides, and {_LEAST_VIEWS} are needed; '
            'fix: film the whole sheet, uncut and flat, from all sides, tilted by 30 degrees'
        )
    error, matrix, coefficients, _, _, sigma, *_ = cv2.calibrateCameraExtended(
        objects, images, picture, None, None
    )
    focal, uncertain = float(matrix[0, 0]), float(sigma[0, 0])
    if not uncertain < _MOST_UNCERTAIN * focal:
        raise FilmError(
            f'{path} determines the focal length to {uncertain / focal:.1%} only; fix: film the '
            'sheet tilted more, and nearer'
        )
    storage = cv2.FileStorage('.yaml', cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write('image_width', picture[0])
    storage.write('image_height', picture[1])
    storage.write('camera_matrix', matrix)
    storage.write('distortion_coefficients', coefficients)
    with whole_file(output) as part:
        part.write_text(storage.releaseAndGetString(), encoding='utf-8')
    return (
        f'{len(objects)} views, {float(error):.2g} pixels rms off; focal length {focal:.5g} pixels '
        f'(deviation {uncertain:.2g})'
    )


def _views(
    video: Video, size: float, family: str
) -> tuple[list[np.ndarray], list[np.ndarray], tuple[int, int]]:
    """Return the corners on the sheet, m, and in the picture, of views that differ."""
    finder, places = TagFinder(family), np.array(sheet_places(size)) * 1e-3
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2
    objects, images, last = [], [], np.full((len(places), 2), np.inf)
    picture = (0, 0)
    for one in video.pictures():
        picture = one.gray.shape[1], one.gray.shape[0]
        tags, corners = finder.find(one.gray)
        rows = [k for k, tag in enumerate(tags) if tag < len(places)]
        if len(rows) < _LEAST_TAGS:
            continue
        own = [tags[k] for k in rows]
        center = corners[rows].mean(axis=1)
        if np.median(np.abs(center - last[own])) < _APART * picture[0]:
            continue
        last[own] = center
        flat = (places[own][:, None] + square).reshape(-1, 2)
        objects.append(np.column_stack((flat, np.zeros(len(flat)))).astype(np.float32))
        images.append(corners[rows].reshape(-1, 2).astype(np.float32))
    step = max(1, -(-len(objects) // _MOST_VIEWS))
    return objects[::step], images[::step], picture
