"""
Keypoints as JSON: of OpenPose, a folder with a file a frame, and in the form of COCO, one file.

OpenPose lists people, each with flat lists x, y, confidence of its pose, hands and face, or with z
where it has several cameras. COCO has annotations, each with its image and a flat list x, y,
visibility; results of other programs are such a list alone, with scores in place of visibility.
Zeros are points that were not seen. Pixels, y down; no times.
"""

import errno
import json
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError, read_errors
from kinpole_ros.bags.formats._cells import MOST_COLUMNS, check_cells, check_names, shown
from kinpole_ros.bags.formats._file import File, Format, Options, Points
from kinpole_ros.files import read_limited

_MOST_JSON_BYTES = 32 << 20
# Bytes of memory that an object, a list and an element take at most.
_OBJECT_BYTES = {b'{': 240, b'[': 88, b',': 64}
_MOST_BYTES = 150 << 20  # of memory
_MOST_SCANNED = 10_000  # files of a folder, until one is of a frame
_ARMS = 'RShoulder RElbow RWrist LShoulder LElbow LWrist'
_LEGS = 'RHip RKnee RAnkle LHip LKnee LAnkle'
_FACE = 'REye LEye REar LEar'
_FEET = 'LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel'
# Names of points by their number: MPI, COCO, and OpenPose with 18 and 25.
_NAMES = {
    15: f'Head Neck {_ARMS} {_LEGS} Chest',
    17: 'nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow '
    'right_elbow left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle '
    'right_ankle',
    18: f'Nose Neck {_ARMS} {_LEGS} {_FACE}',
    25: f'Nose Neck {_ARMS} MidHip {_LEGS} {_FACE} {_FEET}',
}
_PART = re.compile(r'(?P<part>\w+?)_keypoints(?:_(?P<axes>[23])d)?')
_FIX = 'give the folder of _keypoints.json that OpenPose wrote, or keypoints in the form of COCO'
# What JSON of another form raises.
_MALFORMED = (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError)


class _Person(NamedTuple):
    """The points of one person in one frame."""

    frame: int
    person: str
    names: tuple[str, ...]
    values: np.ndarray  # (n, 4): x, y, z, confidence


def _is_keypoints(file: File) -> bool:
    if file.is_folder:
        return any(_frame_files(file.path, _MOST_SCANNED))
    head = file.head.lstrip(b'\xef\xbb\xbf \t\r\n')
    return head[:1] in (b'{', b'[') and (b'keypoints' in file.data or b'"people"' in file.data)


def _frame_files(folder: Path, most: int | None = None) -> Iterator[tuple[int, Path]]:
    """Yield the files of a folder named ...NUMBER.json or ...NUMBER_keypoints.json."""
    for path in islice(folder.iterdir(), most):
        if match := re.search(r'([0-9]{1,15})(?:_keypoints)?\.json$', path.name):
            yield int(match[1]), path


def _read(file: File, options: Options) -> Points:
    persons: list[_Person] = []
    size = 0
    for person in _persons(file):
        persons.append(person)
        size += 2 * person.values.size + 20
        check_cells(file.path, size)
    persons.sort(key=lambda person: person.frame)
    frames = np.array(sorted({person.frame for person in persons}), np.int64)
    columns: dict[str, dict[str, int]] = {}
    count = 0
    for person in persons:
        of_person = columns.setdefault(person.person, {})
        for name in person.names:
            if name not in of_person:
                of_person[name] = count
                count += 1
        if count > MOST_COLUMNS:
            raise BagError(f'{file.path}: more than {MOST_COLUMNS} points; fix: track people first')
    check_cells(file.path, 3 * len(frames) * count)
    points = np.full((len(frames), count, 3), np.nan)
    likelihood = options.likelihood or 0.0
    for person in persons:
        x, y, _, confidence = person.values.T
        is_unseen = (confidence < likelihood) | (confidence <= 0) | ((x == 0) & (y == 0))
        xyz = person.values[:, :3]
        indices = [columns[person.person][name] for name in person.names]
        points[np.searchsorted(frames, person.frame), indices] = np.where(
            is_unseen[:, None] | ~np.isfinite(xyz), np.nan, xyz
        )
    names = [
        name if len(columns) == 1 else f'{person_name}.{name}'
        for person_name, of_person in columns.items()
        for name in of_person
    ]
    check_names(file.path, names)
    if len(columns) > 1 and any(name.startswith('person_') for name in columns):
        file.notes.append(
            f'{file.path} has up to {len(columns)} people in a frame, in any order: one may become '
            'another; fix: track them first'
        )
    in_space = bool(np.nan_to_num(points[..., 2]).any())
    return Points(names, points, frames, None, '' if in_space else 'px', y_down=not in_space)


def _persons(file: File) -> Iterator[_Person]:
    if not file.is_folder:
        with _json_errors(file.path):
            content = _parse(file.path)
            if isinstance(content, dict) and 'people' in content:
                yield from _openpose_persons(0, content)
            elif isinstance(content, list) and content and 'people' in content[0]:
                for number, frame in enumerate(content):
                    yield from _openpose_persons(number, frame)
            else:
                yield from _coco_persons(content)
        return
    last_number = -1
    for number, path in sorted(_frame_files(file.path)):
        if number == last_number:
            raise BagError(f'{path}: frame {number} is there twice; fix: a folder for each video')
        last_number = number
        with _json_errors(path):
            yield from _openpose_persons(number, _parse(path))


@contextmanager
def _json_errors(path: Path) -> Iterator[None]:
    """Turn what JSON of another form raises into BagError."""
    try:
        with read_errors(path):
            yield
    except _MALFORMED as error:
        raise BagError(f'{path} is not JSON of keypoints; fix: {_FIX}') from error


def _parse(path: Path) -> Any:
    data = read_limited(path, _MOST_JSON_BYTES)
    if sum(size * data.count(mark) for mark, size in _OBJECT_BYTES.items()) > _MOST_BYTES:
        raise OSError(errno.EFBIG, 'File too large')
    return json.loads(data)


def _openpose_persons(number: int, frame: dict[str, Any]) -> Iterator[_Person]:
    for index, person in enumerate(frame['people']):
        (track,) = person.get('person_id') or [-1]
        person_name = f'person_{index}' if track == -1 else f'track_{track}'
        lists: dict[str, dict[str, Any]] = {}
        for key, numbers in person.items():
            if (match := _PART.fullmatch(key)) and numbers:
                # Points in space are the same ones, so they replace those of the picture.
                lists.setdefault(match['part'], {})[match['axes'] or '2'] = numbers
        for part, by_axes in lists.items():
            axes = max(by_axes)
            values = np.array(by_axes[axes], float).reshape(-1, int(axes) + 1)
            prefix = '' if part == 'pose' else f'{part}.'
            yield _person(number, person_name, prefix, None, values)


def _coco_persons(content: Any) -> Iterator[_Person]:
    images, categories = {}, {}
    annotations = content
    if isinstance(content, dict):
        annotations = content['annotations']
        images = {image['id']: image.get('file_name', '') for image in content.get('images', [])}
        categories = {one['id']: one.get('keypoints') for one in content.get('categories', [])}
    counts: Counter[int] = Counter()
    numbers = {key: _image_number(name, key) for key, name in images.items()}
    if len(set(numbers.values())) < len(numbers):
        numbers = {key: _image_number('', key) for key in images}
    for annotation in annotations:
        if not annotation.get('keypoints'):
            continue
        key = annotation['image_id']
        number = numbers[key] if key in numbers else _image_number(str(key), key)
        tracks = (annotation[k] for k in ('track_id', 'instance_id', 'idx') if k in annotation)
        track = next(tracks, None)
        person_name = f'person_{counts[number]}'
        if track is not None:
            person_name = f'track_{shown(str(track))}'
        counts[number] += 1
        names = categories.get(annotation.get('category_id'))
        values = np.array(annotation['keypoints'], float).reshape(-1, 3)
        yield _person(number, person_name, '', names, values)


def _image_number(name: str, key: Any) -> int:
    """Return the last number in the name of an image, or the number of the image itself."""
    match = re.search(r'([0-9]{1,15})[^0-9]*$', name.rpartition('.')[0] or name)
    return int(match[1]) if match else int(key)


def _person(number: int, person_name: str, prefix: str, names: Any, values: np.ndarray) -> _Person:
    if not -(2**53) < number < 2**53:
        raise ValueError('a frame of no number')
    if values.shape[1] == 3:
        values = np.insert(values, 2, 0.0, axis=1)
    names = tuple(map(str, names)) if names is not None else None
    return _Person(number, person_name, _point_names(prefix, names, len(values)), values)


@lru_cache(maxsize=64)
def _point_names(prefix: str, names: tuple[str, ...] | None, count: int) -> tuple[str, ...]:
    """Name the points of a part of a person, by one tuple for all frames."""
    if names is None:
        names = () if prefix else tuple(_NAMES.get(count, '').split())
    if len(names) != count or len(set(names)) < count:
        names = tuple(f'{"" if prefix else "point "}{k}' for k in range(count))
    return tuple(f'{prefix}{name}' for name in names)


KEYPOINTS = Format(
    'keypoints',
    'OpenPose, a folder of .json; COCO .json',
    '{"people": [{"pose_keypoints_2d": [101.5, 55.2, 0.98]}]}',
    _is_keypoints,
    _read,
    has_likelihood=True,
)
