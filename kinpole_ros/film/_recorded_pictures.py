"""Pictures that are no video: those of a folder, and those or their tags in a bag of ROS 2."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np

from kinpole_ros.bags import Truncated, read_messages, topics
from kinpole_ros.files import cut, read_limited
from kinpole_ros.film._decoder import (
    DamagedError,
    FilmError,
    Source,
    Timed,
    check_size,
    decoded_picture,
)
from kinpole_ros.messages import (
    COMPRESSED_IMAGE,
    DETECTIONS,
    IMAGE,
    MessageError,
    deserialize_message,
    message_class,
    read_detections,
    stamp_to_ns,
)

_ENDINGS = '.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff'
_MOST_BYTES = 64 << 20  # of a picture
_BAG_ENDINGS = '.mcap', '.db3'
# FFmpeg's names of the encodings of sensor_msgs/Image, and bytes of a pixel.
_ENCODINGS = {
    **dict.fromkeys(('mono8', '8UC1'), ('gray', 1)),
    **dict.fromkeys(('bgr8', '8UC3'), ('bgr24', 3)),
    **dict.fromkeys(('bgra8', '8UC4'), ('bgra', 4)),
    **dict.fromkeys(('yuv422', 'uyvy'), ('uyvy422', 2)),
    **dict.fromkeys(('yuv422_yuy2', 'yuyv'), ('yuyv422', 2)),
    'rgb8': ('rgb24', 3),
    'rgba8': ('rgba', 4),
    'mono16': ('gray16le', 2),
    **{f'bayer_{order}8': (f'bayer_{order}8', 1) for order in ('rggb', 'bggr', 'gbrg', 'grbg')},
}


def folder_source(path: str) -> Source:
    """Return the pictures of a folder by the numbers in their names; raises FilmError."""
    files = [file for file in Path(path).iterdir() if file.suffix.lower() in _ENDINGS]
    if not files:
        raise FilmError(f'{path} has no pictures; fix: give a folder of {", ".join(_ENDINGS)}')
    files.sort(key=lambda file: [int(part) if part.isdigit() else part for part in _parts(file)])
    numbers = _numbers(files)

    def read(since: Timed | None) -> Iterator[Timed]:
        for number, file in zip(numbers, files, strict=True):
            if since is not None and number < since.number:
                continue
            frame = decoded_picture(str(file), read_limited(file, _MOST_BYTES))
            check_size(str(file), frame.width, frame.height)
            yield Timed(None, number, frame)

    return Source(read, 'is a folder of pictures', False, len(files))


def _parts(file: Path) -> list[str]:
    """Return the texts and the numbers of a name, in turn."""
    return re.split(r'(\d+)', file.stem)


def _numbers(files: list[Path]) -> list[int]:
    """Return the number of each picture, from 0 on: that in its name, if they are in even steps."""
    own = [int(parts[-2]) if len(parts := _parts(file)) > 1 else 0 for file in files]
    steps = np.diff(own)
    step = int(steps.min()) if len(steps) else 0
    # Other numbers are times, or of something else.
    if step < 1 or (steps % step).any() or (steps == step).mean() < 0.5:
        return list(range(len(files)))
    return [(number - own[0]) // step for number in own]


def is_bag_of_pictures(path: str) -> bool:
    """Return whether a path is a bag, by its name or what is in the folder."""
    if Path(path).is_dir():
        return any(any(Path(path).glob(f'*{ending}*')) for ending in _BAG_ENDINGS)
    return any(ending in _BAG_ENDINGS for ending in Path(path).suffixes[-2:])


def film_topics(path: str) -> dict[str, str]:
    """Return the topics of pictures of a bag and their types, else those of detected tags."""
    types = topics(path)
    pictures = {one: kind for one, kind in types.items() if kind in (IMAGE, COMPRESSED_IMAGE)}
    return pictures or {one: kind for one, kind in types.items() if kind == DETECTIONS}


def film_topic(path: str, topic: str | None) -> tuple[str, str]:
    """Return the topic of pictures or tags that is read, and its type; raises FilmError."""
    if topic is not None:
        topic = topic if topic.startswith('/') else f'/{topic}'
        kind = topics(path).get(topic)
        if kind not in (IMAGE, COMPRESSED_IMAGE, DETECTIONS):
            there = f'of the type {kind}' if kind else 'not in it'
            raise FilmError(
                f'{path} has no pictures on {topic}, which is {there}; fix: name a topic of '
                f'{IMAGE}, {COMPRESSED_IMAGE} or {DETECTIONS}'
            )
        return topic, kind
    found = film_topics(path)
    if not found:
        listed = ', '.join(f'{one} ({kind})' for one, kind in sorted(topics(path).items())[:10])
        raise FilmError(
            f'{path} has no topic of pictures or detected tags, only {listed or "none"}; fix: '
            f'record {COMPRESSED_IMAGE}'
        )
    if len(found) > 1:
        raise FilmError(
            f'{path} has several topics of pictures, {", ".join(sorted(found)[:8])}; fix: name '
            'one by --topic'
        )
    return next(iter(found.items()))


def bag_source(path: str, topic: str | None) -> Source:
    """Return the pictures of a topic of a bag, with the stamps of their headers."""
    topic, kind = film_topic(path, topic)
    to_frame = _frame if kind == IMAGE else _compressed_frame
    first = next(bag_messages(path, topic), None)
    is_stamped = first is not None and stamp_to_ns(first[1].header.stamp) != 0

    def read(since: Timed | None) -> Iterator[Timed]:
        for number, (log_time, message) in enumerate(bag_messages(path, topic)):
            if since is not None and number < since.number:
                continue
            frame = to_frame(f'{path}, picture {number} on {topic}', message)
            check_size(path, frame.width, frame.height)
            time = stamp_to_ns(message.header.stamp) if is_stamped else log_time
            yield Timed(time, number, frame)

    clock = f'the headers of {topic}'
    if not is_stamped:
        clock = f'the log times of {topic}, whose headers have no stamps'
    return Source(read, clock, is_absolute=True)


def bag_messages(path: str, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield log times, ns, and messages of a topic, detections as they are read."""
    try:
        for one in read_messages(path, [topic]):
            if one.type_name == DETECTIONS:
                yield one.log_time, read_detections(one.data)
            else:
                yield one.log_time, deserialize_message(one.data, message_class(one.type_name))
    except (Truncated, MessageError) as error:
        raise DamagedError(f'{path}: {error}') from None


def _compressed_frame(name: str, message: Any) -> Any:
    return decoded_picture(f'{name} ({cut(message.format)})', bytes(message.data))


def _frame(name: str, message: Any) -> Any:
    """Return the frame of a sensor_msgs/Image."""
    if message.encoding not in _ENCODINGS:
        raise FilmError(
            f'{name} has the encoding {cut(message.encoding)}, which is not read; fix: record '
            'mono8, bgr8 or rgb8'
        )
    kind, size = _ENCODINGS[message.encoding]
    width, height, step = int(message.width), int(message.height), int(message.step)
    check_size(name, width, height)
    data = np.asarray(message.data, np.uint8)
    if step < width * size or len(data) < height * step:
        raise DamagedError(f'{name} has {len(data)} bytes, too few; fix: record it again')
    frame: Any = av.VideoFrame(width, height, kind)
    plane = frame.planes[0]
    rows = np.zeros((height, plane.line_size), np.uint8)
    rows[:, : width * size] = data[: height * step].reshape(height, step)[:, : width * size]
    if kind == 'gray16le' and message.is_bigendian:
        rows = rows.view('>u2').astype('<u2').view(np.uint8)
    plane.update(rows)
    return frame
