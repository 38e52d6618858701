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
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import MOST_COLUMNS, check_cells, check_names, shown
from kinpole_ros.files import read_limited

_MOST_JSON = 32 << 20  # bytes of a file
# Bytes of memory that what begins with a mark takes at most, and of all of these in a file.
_OBJECT_BYTES = {b'{': 240, b'[': 88, b',': 64}
_MOST_BYTES = 150 << 20
_SCANNED = 10_000  # files of a folder that are looked at until one is of a frame
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
# What comes of JSON that has another form.
_MALFORMED = (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError)


class _Person(NamedTuple):
    """The points of one person in one frame."""

    frame: int
    person: str
    names: tuple[str, ...]
    values: np.ndarray  # (n, 4): x, y, z, confidence


def _recognizes(file: File) -> bool:
    if file.is_folder:
        return any(_frame_files(file.path, _SCANNED))
    head = file.head.lstrip(b'\xef\xbb\xbf \t\r\n')
    return head[:1] in (b'{', b'[') and (b'keypoints' in file.data or b'"people"' in file.data)


def _frame_files(folder: Path, most: int | None = None) -> Iterator[tuple[int, Path]]:
    """Yield the files of a folder named ...NUMBER.json or ...NUMBER_keypoints.json."""
    for count, path in enumerate(folder.iterdir()):
        if count == most:
            return
        if match := re.search(r'([0-9]{1,15})(?:_keypoints)?\.json$', path.name):
            yield int(match[1]), path


def _read(file: File, wanted: Wanted) -> Points:
    persons: list[_Person] = []
    size = 0
    for one in _persons(file):
        persons.append(one)
        size += 2 * one.values.size + 20
        check_cells(file.path, size)
    persons.sort(key=lambda one: one.frame)
    frames = np.array(sorted({one.frame for one in persons}), np.int64)
    names: dict[str, dict[str, int]] = {}
    count = 0
    for one in persons:
        of_person = names.setdefault(one.person, {})
        for name in one.names:
            if name not in of_person:
                of_person[name] = count
                count += 1
        if count > MOST_COLUMNS:
            raise BagError(f'{file.path}: more than {MOST_COLUMNS} points; fix: track people first')
    check_cells(file.path, 3 * len(frames) * count)
    points = np.full((len(frames), count, 3), np.nan)
    least = wanted.likelihood or 0.0
    for one in persons:
        x, y, _, confidence = one.values.T
        unseen = (confidence < least) | (confidence <= 0) | ((x == 0) & (y == 0))
        columns = [names[one.person][name] for name in one.names]
        places = np.where(
            unseen[:, None] | ~np.isfinite(one.values[:, :3]), np.nan, one.values[:, :3]
        )
        points[np.searchsorted(frames, one.frame), columns] = places
    listed = [
        name if len(names) == 1 else f'{person}.{name}'
        for person, of_person in names.items()
        for name in of_person
    ]
    check_names(file.path, listed)
    if len(names) > 1 and any(person.startswith('person_') for person in names):
        file.notes.append(
            f'{file.path} has up to {len(names)} people in a frame, in any order: one may become '
            'another; fix: track them first'
        )
    in_space = bool(np.nan_to_num(points[..., 2]).any())
    return Points(listed, points, frames, None, '' if in_space else 'px', y_down=not in_space)


def _persons(file: File) -> Iterable[_Person]:
    if not file.is_folder:
        content = _parse(file.path)
        try:
            if isinstance(content, dict) and 'people' in content:
                yield from _of_openpose(0, content)
            elif isinstance(content, list) and content and 'people' in content[0]:
                for number, frame in enumerate(content):
                    yield from _of_openpose(number, frame)
            else:
                yield from _of_coco(content)
        except _MALFORMED as error:
            raise _malformed(file.path) from error
        return
    before = -1
    for number, path in sorted(_frame_files(file.path)):
        if number == before:
            raise BagError(f'{path}: frame {number} is there twice; fix: a folder for each video')
        before = number
        try:
            yield from _of_openpose(number, _parse(path))
        except _MALFORMED as error:
            raise _malformed(path) from error


def _parse(path: Path) -> Any:
    try:
        data = read_limited(path, _MOST_JSON)
        if sum(size * data.count(mark) for mark, size in _OBJECT_BYTES.items()) > _MOST_BYTES:
            raise OSError(errno.EFBIG, 'File too large')
        return json.loads(data)
    except OSError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; fix: cut it into parts'
        ) from error
    except _MALFORMED as error:
        raise _malformed(path) from error


def _malformed(path: Path) -> BagError:
    return BagError(f'{path} is not JSON of keypoints; fix: {_FIX}')


def _of_openpose(number: int, frame: dict[str, Any]) -> Iterator[_Person]:
    for index, person in enumerate(frame['people']):
        (tracked,) = person.get('person_id') or [-1]
        who = f'person_{index}' if tracked == -1 else f'track_{tracked}'
        lists: dict[str, dict[str, Any]] = {}
        for key, numbers in person.items():
            if (match := _PART.fullmatch(key)) and numbers:
                # Points in space are the same ones, so they replace those of the picture.
                lists.setdefault(match['part'], {})[match['axes'] or '2'] = numbers
        for part, by_axes in lists.items():
            axes = max(by_axes)
            values = np.array(by_axes[axes], float).reshape(-1, int(axes) + 1)
            yield _person(number, who, '' if part == 'pose' else f'{part}.', None, values)


def _of_coco(content: Any) -> Iterator[_Person]:
    images, categories = {}, {}
    annotations = content
    if isinstance(content, dict):
        annotations = content['annotations']
        images = {image['id']: image.get('file_name', '') for image in content.get('images', [])}
        categories = {one['id']: one.get('keypoints') for one in content.get('categories', [])}
    counts: dict[int, int] = {}
    numbers = {key: _number_in(name, key) for key, name in images.items()}
    if len(set(numbers.values())) < len(numbers):
        numbers = {key: _number_in('', key) for key in images}
    for one in annotations:
        if not one.get('keypoints'):
            continue
        key = one['image_id']
        number = numbers[key] if key in numbers else _number_in(str(key), key)
        counts[number] = counts.get(number, 0) + 1
        track = next((one[k] for k in ('track_id', 'instance_id', 'idx') if k in one), None)
        who = f'person_{counts[number] - 1}' if track is None else f'track_{shown(str(track))}'
        names = categories.get(one.get('category_id'))
        yield _person(number, who, '', names, np.array(one['keypoints'], float).reshape(-1, 3))


def _number_in(name: str, key: Any) -> int:
    """Return the last number in the name of an image, or the number of the image itself."""
    match = re.search(r'([0-9]{1,15})[^0-9]*$', name.rpartition('.')[0] or name)
    return int(match[1]) if match else int(key)


def _person(number: int, who: str, prefix: str, names: Any, values: np.ndarray) -> _Person:
    if not -(2**53) < number < 2**53:
        raise ValueError('a frame of no number')
    if values.shape[1] == 3:
        values = np.insert(values, 2, 0.0, axis=1)
    known = tuple(map(str, names)) if names is not None else None
    return _Person(number, who, _point_names(prefix, known, len(values)), values)


@lru_cache(maxsize=64)
def _point_names(prefix: str, known: tuple[str, ...] | None, count: int) -> tuple[str, ...]:
    """Name the points of a part of a person, by one tuple for all frames."""
    if known is None:
        known = () if prefix else tuple(_NAMES.get(count, '').split())
    if len(known) != count or len(set(known)) < count:
        known = tuple(f'{"" if prefix else "point "}{k}' for k in range(count))
    return tuple(f'{prefix}{name}' for name in known)


FORMAT = Format(
    'keypoints',
    'OpenPose, a folder of .json; COCO .json',
    '{"people": [{"pose_keypoints_2d": [101.5, 55.2, 0.98]}]}',
    _recognizes,
    _read,
)
