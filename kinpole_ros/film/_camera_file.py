"""
The file of a camera as programs write it: its matrix, its lens, and the size of its pictures.

| program | file |
| --- | --- |
| `kinpole film --calibrate`, OpenCV | YAML, XML or JSON, also with matrices as lists of rows |
| camera_calibration of ROS | ost.yaml, and its ost.txt |
| `ros2 topic echo` of a CameraInfo | YAML |
| Kalibr | camchain.yaml of one camera |
| Anipose | TOML of one camera |
"""

import re
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import yaml

from kinpole_ros.files import cut, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml
from kinpole_ros.film._decoder import FilmError

_COUNTS = (0, 4, 5, 8, 12, 14)  # of the coefficients of a lens, in OpenCV
# Names in small letters, without what is no letter and no digit.
_MATRICES = 'cameramatrix', 'k', 'mtx', 'matrix', 'intrinsicmatrix', 'intrinsics', 'intrinsic'
_LENSES = (
    *('distortioncoefficients', 'distcoeffs', 'distcoeff', 'distortioncoeffs', 'distortions'),
    *('distortion', 'd', 'dist', 'coeffs'),
)
_SIZES = 'imagesize', 'imgsize', 'framesize', 'size', 'resolution'
_MODELS = '', 'none', 'plumbbob', 'rationalpolynomial', 'radtan', 'pinhole', 'opencv'
_FISHEYE = 'equidistant', 'fisheye', 'kannalabrandt', 'kannalabrandt4', 'opencvfisheye'
_DAMAGED = (
    *(yaml.YAMLError, ElementTree.ParseError, ValueError, LookupError, TypeError),
    *(AttributeError, OverflowError),
)
_TO_CALIBRATE = 'as `kinpole film --calibrate` writes them'


class CameraFile(NamedTuple):
    """A matrix (3, 3), pixels, the coefficients (k,) of a lens, and the size (2,) of pictures."""

    matrix: np.ndarray
    coefficients: np.ndarray
    size: tuple[float, float]


def read_camera_file(path: str | Path) -> CameraFile:
    """Read the file of a camera; raises FilmError that says what it lacks."""
    try:
        content = _camera_of(path, _content(_text(path)))
        _check_model(path, content)
        matrix = _matrix(path, content)
        coefficients = _numbers(_named(path, content, 'distortion_coefficients', _LENSES))
        width, height = _size(path, content)
    except _DAMAGED as error:
        raise FilmError(
            f'{path} is not the file of a camera ({cut(" ".join(str(error).split()))}); fix: '
            'camera_matrix, distortion_coefficients, image_width and image_height, '
            f'{_TO_CALIBRATE}'
        ) from None
    is_finite = np.isfinite(matrix).all() and np.isfinite(coefficients).all()
    if not (is_finite and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise FilmError(f'{path} has no camera_matrix of a camera; fix: calibrate it again')
    if len(coefficients) not in _COUNTS:
        raise FilmError(
            f'{path} has {len(coefficients)} coefficients of a lens, and OpenCV has '
            f'{", ".join(map(str, _COUNTS))}; fix: calibrate it again'
        )
    coefficients = coefficients if len(coefficients) else np.zeros(5)
    return CameraFile(matrix, coefficients, (width, height))


def _text(path: str | Path) -> str:
    try:
        return read_limited(path, MOST_YAML).decode()
    except UnicodeDecodeError:
        raise ValueError('it is no text, as of numpy or pickle') from None


def _content(text: str) -> dict[str, Any]:
    """Return the values in a text by name: of XML, TOML, ost.txt, or YAML with JSON."""
    if text.lstrip().startswith('<'):
        return _of_xml(text)
    if re.search(r'^\s*\[[^\],]+\]\s*$', text, re.MULTILINE):
        return _of_toml(text) if '=' in text else _of_ost(text)
    # OpenCV's header is not YAML, and its matrices have tags of their own. A topic is echoed
    # message by message.
    text = re.sub('^%YAML.*|!!opencv-(nd-)?matrix', '', text)
    parts = re.split(r'^---\s*$', text, flags=re.MULTILINE)
    content = load_yaml(next(filter(str.strip, parts), ''))
    return content if isinstance(content, dict) else {}


def _of_xml(text: str) -> dict[str, Any]:
    if '<!DOCTYPE' in text:  # entities can multiply
        raise ValueError('it defines entities')
    rows = ((one, one.find('data')) for one in ElementTree.fromstring(text))
    return {
        one.tag: (one.text if data is None else (data.text or '').split()) for one, data in rows
    }


def _of_toml(text: str) -> dict[str, Any]:
    try:
        import tomllib  # type: ignore[import-not-found]
    except ImportError:
        raise ValueError('TOML takes Python 3.11') from None
    return tomllib.loads(text)


def _of_ost(text: str) -> dict[str, Any]:
    """Return the numbers of ost.txt: a name in a line, and the numbers of it below."""
    found: dict[str, Any] = {}
    name = ''
    for line in filter(None, map(str.strip, text.splitlines())):
        if re.match(r'[-+.\d]', line):
            found.setdefault(name, []).extend(line.split())
        elif line[0] not in '#[':
            name = line
    sizes = {key: found[key][0] for key in ('width', 'height') if key in found}
    return found | sizes


def _plain(name: Any) -> str:
    return re.sub(r'[^a-z0-9]', '', str(name).lower())


def _camera_of(path: str | Path, content: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the only camera in a file, by their plain names."""
    values = {_plain(name): value for name, value in content.items()}
    if any(name in values for name in (*_MATRICES, *_LENSES)):
        return values
    cameras = {
        name: {_plain(own): value for own, value in part.items()}
        for name, part in content.items()
        if isinstance(part, dict)
    }
    cameras = {k: part for k, part in cameras.items() if any(name in part for name in _MATRICES)}
    if len(cameras) > 1:
        names = ', '.join(map(str, cameras))
        raise FilmError(f'{path} has the cameras {names}; fix: give a file with one of them')
    if not cameras:
        raise ValueError('it has no camera_matrix')
    return next(iter(cameras.values()))


def _check_model(path: str | Path, content: dict[str, Any]) -> None:
    """Raise FilmError for a lens that is not one of OpenCV's pinhole cameras."""
    flags = [content.get(name, False) for name in ('fisheye', 'fisheyemodel')]
    names = [content.get(name) or '' for name in ('distortionmodel', 'cameramodel', 'model')]
    if any(_plain(flag) in ('true', '1') for flag in flags) or any(
        _plain(name) in _FISHEYE for name in names
    ):
        raise FilmError(f'{path} is of a fisheye lens; fix: calibrate as plumb_bob')
    for name in names:
        if _plain(name) not in _MODELS:
            raise FilmError(
                f'{path} has a lens of the model {cut(str(name))}, which is not read; fix: '
                'calibrate as plumb_bob (radtan, in Kalibr)'
            )


def _named(path: str | Path, content: dict[str, Any], wanted: str, names: tuple[str, ...]) -> Any:
    """Return the first value of these names that there is; FilmError calls it by `wanted`."""
    for name in names:
        if content.get(name) is not None:
            return content[name]
    raise FilmError(f'{path} has no {wanted}; fix: add it, {_TO_CALIBRATE}')


def _numbers(value: Any) -> np.ndarray:
    """Return the numbers of a matrix with rows, cols and data, or of lists, in a row."""
    data = value['data'] if isinstance(value, dict) else value
    return np.array(data, float).ravel()


def _matrix(path: str | Path, content: dict[str, Any]) -> np.ndarray:
    numbers = _numbers(_named(path, content, 'camera_matrix', _MATRICES))
    if len(numbers) == 4:  # as Kalibr has it
        right, down, x, y = numbers
        numbers = np.array([right, 0, x, 0, down, y, 0, 0, 1])
    return numbers.reshape(3, 3)


def _size(path: str | Path, content: dict[str, Any]) -> tuple[float, float]:
    """Return the width and height of the pictures by which the camera was calibrated."""
    for names in (('imagewidth', 'imageheight'), ('width', 'height')):
        if all(content.get(name) is not None for name in names):
            width, height = (float(content[name]) for name in names)
            return width, height
    for name in _SIZES:
        if content.get(name) is not None:
            width, height = _numbers(content[name])
            return float(width), float(height)
    raise FilmError(
        f'{path} does not say the size of the pictures by which the camera was calibrated; fix: '
        'add image_width and image_height to it'
    )
