"""
Frames of a decoder: their limits, their brightness, and where they come from.

A film may come from anybody: pictures have a limit, so memory has one too.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import av
import numpy as np

from kinpole_ros.bags import BagError
from kinpole_ros.files import printable

# A picture of 4K video has 8.8 million pixels; a decoder keeps up to 20 of them.
MOST_PIXELS = 4096 * 2176
_LEAST_SIDE = 32  # pixels
# The first plane of these is the brightness, one byte a pixel.
_PLANAR = ('yuv420p', 'yuvj420p', 'yuv422p', 'yuvj422p', 'yuv444p', 'yuvj444p', 'nv12', 'gray')
# How pictures begin, and the decoders that FFmpeg has for them.
_DECODERS = {b'\xff\xd8': 'mjpeg', b'\x89PNG': 'png', b'BM': 'bmp', b'II': 'tiff', b'MM': 'tiff'}


class FilmError(BagError):
    """A video, camera file or sheet that cannot be used: one line that names it and the fix."""


class DamagedError(FilmError):
    """A film that cannot be read any further."""


class Timed(NamedTuple):
    """
    A frame of the decoder, its time, ns, None if it has none, and its number from 0 on.

    The number of the second field of an interlaced frame is larger by a half.
    """

    time: int | None
    number: float
    frame: Any


class Source(NamedTuple):
    """
    Where the frames of a film are.

    Attributes
    ----------
    read : callable
        Yields all frames from the first one on; from a `Timed` on, or from one before it, if that
        is given and can be found.
    clock : str
        What their times are, for a line; of a film without, why it has none.
    has_times : bool
    pictures : int
        Number of frames, 0 if it is not known.
    is_absolute : bool
        Whether times count from 1970, and not from the first frame.
    capture : tuple, optional
        The name of a tag, and the rate, Hz, at which the camera took pictures by it.
    times : callable, optional
        Returns the times (T,), ns, of all frames, without their pictures.

    """

    read: Callable[[Timed | None], Iterator[Timed]]
    clock: str
    has_times: bool = True
    pictures: int = 0
    is_absolute: bool = False
    capture: tuple[str, float] | None = None
    times: Callable[[], np.ndarray] | None = None


def check_size(path: str, width: int, height: int) -> None:
    """Raise FilmError for pictures that are too large or too small."""
    if not width * height <= MOST_PIXELS:
        raise FilmError(
            f'{path} has pictures of {width} x {height}, and at most {MOST_PIXELS} pixels are '
            'read; fix: make it smaller (ffmpeg -i IN -vf scale=1920:-2 OUT.mp4)'
        )
    if min(width, height) < _LEAST_SIDE:
        raise FilmError(f'{path} has pictures of {width} x {height}; fix: film larger ones')


def decoded_picture(name: str, data: bytes) -> Any:
    """Return the frame of a picture in JPEG, PNG, BMP or TIFF; raises DamagedError."""
    decoder = next((own for head, own in _DECODERS.items() if data.startswith(head)), None)
    if decoder is None:
        raise DamagedError(f'{name} is no picture in JPEG, PNG, BMP or TIFF; fix: convert it')
    context: Any = av.CodecContext.create(decoder, 'r')
    context.options = {'max_pixels': str(MOST_PIXELS)}
    try:
        frames = context.decode(av.Packet(data)) or context.decode(None)
    except (av.FFmpegError, ValueError) as error:
        text = printable(getattr(error, 'strerror', None) or str(error))
        raise DamagedError(f'{name} is a damaged picture ({text}); fix: leave it out') from None
    if not frames:
        raise DamagedError(f'{name} is a damaged picture; fix: leave it out')
    return frames[0]


def fields(frames: Iterable[Any]) -> Iterator[tuple[float, Any]]:
    """
    Yield numbers and frames, and the two fields of interlaced ones, which are of two instants.

    From the first interlaced frame on all go through the filter bwdif of FFmpeg.
    """
    graph: Any = None
    count = 0
    for number, frame in enumerate(frames):
        if graph is None and not frame.interlaced_frame:
            yield number, frame
            continue
        if graph is None:
            graph, count = _field_filter(frame), 2 * number
        graph.push(frame)
        for field in _filtered(graph):
            yield count / 2, field
            count += 1
    if graph is not None:
        graph.push(None)
        for field in _filtered(graph):
            yield count / 2, field
            count += 1


def _field_filter(frame: Any) -> Any:
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base
    )
    graph.link_nodes(source, graph.add('bwdif', 'send_field'), graph.add('buffersink')).configure()
    return graph


def _filtered(graph: Any) -> Iterator[Any]:
    """Yield the frames that are ready."""
    with suppress(av.BlockingIOError, av.EOFError):
        while True:
            yield graph.pull()


def quarter_turns(frame: Any) -> int:
    """Return by how many quarter turns to the left a frame is shown, 0 to 3."""
    return round((frame.rotation or 0) / 90) % 4


def brightness(frame: Any) -> np.ndarray:
    """Return the brightness of a frame (h, w), upright, uint8."""
    if frame.format.name not in _PLANAR:
        frame = frame.reformat(format='gray')
    plane = frame.planes[0]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    return upright(rows[: frame.height, : frame.width], frame)


def upright(picture: np.ndarray, frame: Any) -> np.ndarray:
    """Return a picture (h, w, ...) turned as its frame says that players show it."""
    return np.ascontiguousarray(np.rot90(picture, quarter_turns(frame)))
