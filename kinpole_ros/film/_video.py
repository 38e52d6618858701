"""
The pictures of a video and their stamps, decoded in a thread beside the search for tags.

A video may come from anybody: only common containers and codecs are opened, which read no other
file and no network, and pictures have a limit, so memory has one too.
"""

import os
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np

from kinpole_ros.bags import BagError
from kinpole_ros.files import open_regular, printable

_FORMATS = 'mov,matroska,webm,avi,mpegts,mjpeg'
_CODECS = 'h264,hevc,av1,libdav1d,vp8,vp9,libvpx,libvpx-vp9,mpeg4,mjpeg,prores,rawvideo,ffv1'
# A picture of 4K video has 8.8 million pixels; a decoder keeps up to 20 of them.
_MOST_PIXELS = 4096 * 2176
_LEAST_SIDE = 32  # pixels
_WAITING = 3  # pictures between decoder and search
_LONGEST = 2.0**31  # s, as stamps of ROS
Progress = Callable[[float], None]
# The first plane of these is the brightness, one byte a pixel.
_PLANAR = ('yuv420p', 'yuvj420p', 'yuv422p', 'yuvj422p', 'yuv444p', 'yuvj444p', 'nv12', 'gray')


class FilmError(BagError):
    """A video, camera file or sheet that cannot be used: one line that names it and the fix."""


class Picture(NamedTuple):
    """A picture: its stamp, ns from the first one on, and its brightness (h, w), uint8."""

    stamp: int
    gray: np.ndarray


class Video:
    """
    The pictures of a video in order.

    `rate` is the mean number per second and `count` the number of pictures as the container has
    them, 0 if unknown; `late` counts pictures left out because their stamps do not increase, and
    `cut` says where a damaged video ends, '' for a sound one.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.late, self.cut = str(path), 0, ''
        with self._opened() as (_, stream):
            self.count = int(stream.frames)
            self.rate = float(stream.average_rate or 0.0)

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures; a thread decodes ahead. Raises FilmError."""
        for stamp, frame in self.frames():
            yield Picture(stamp, _brightness(frame))

    def frames(self) -> Iterator[tuple[int, Any]]:
        """Yield stamps and frames of the decoder; a thread decodes ahead. Raises FilmError."""
        yield from ahead(self._decoded(), _WAITING)

    def _decoded(self) -> Iterator[tuple[int, Any]]:
        first = last = -1
        number = 0
        with self._opened() as (container, stream):
            try:
                for frame in container.decode(stream):
                    self._check_size(frame.width, frame.height)
                    time = frame.time
                    if time is None:
                        time = number / (self.rate or 30.0)
                    number += 1
                    if not abs(time) < _LONGEST:
                        self.late += 1
                        continue
                    stamp = round(time * 1e9)
                    first = stamp if number == 1 + self.late else first
                    if stamp - first <= last:
                        self.late += 1
                        continue
                    last = stamp - first
                    yield last, frame
            except (av.FFmpegError, OSError, ValueError) as error:
                if last < 0:
                    raise self._unreadable(error) from None
                self.cut = f'{self.path} is damaged after {last * 1e-9:.4g} s: what follows is lost'
        if last < 0:
            raise FilmError(f'{self.path} has no pictures; fix: film it again, or convert it')

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, Any]]:
        """Open the file, and give the container and its stream of pictures."""
        options = {'format_whitelist': _FORMATS, 'codec_whitelist': _CODECS}
        with open_regular(self.path) as file:
            try:
                container = av.open(file, options=options, metadata_errors='replace')
            except (av.FFmpegError, OSError, ValueError) as error:
                raise self._unreadable(error) from None
            with container:
                if not container.streams.video:
                    raise FilmError(f'{self.path} has sound only; fix: give a video')
                stream = container.streams.video[0]
                context = stream.codec_context
                if context is None:
                    raise self._unreadable(ValueError('its compression is not known'))
                self._check_size(context.width, context.height)
                context.thread_count = min(2, os.cpu_count() or 1)
                context.thread_type = 'AUTO'
                context.options = {'max_pixels': str(_MOST_PIXELS)}
                yield container, stream

    def _check_size(self, width: int, height: int) -> None:
        if not width * height <= _MOST_PIXELS:
            raise FilmError(
                f'{self.path} has pictures of {width} x {height}, and at most {_MOST_PIXELS} '
                'pixels are read; fix: make it smaller (ffmpeg -i IN -vf scale=1920:-2 OUT.mp4)'
            )
        if min(width, height) < _LEAST_SIDE:
            raise FilmError(
                f'{self.path} has pictures of {width} x {height}; fix: film larger ones'
            )

    def _unreadable(self, error: Exception) -> FilmError:
        text = printable(getattr(error, 'strerror', None) or str(error))
        return FilmError(
            f'{self.path} cannot be read as a video ({text}); fix: convert it, as by '
            'ffmpeg -i IN OUT.mp4'
        )


def ahead(items: Iterator[Any], most: int, are_old_left_out: bool = False) -> Iterator[Any]:
    """
    Yield items that a thread takes ahead, `most` at a time; an error among them is raised here.

    Where `are_old_left_out`, the thread does not wait: items that came too fast are not yielded.
    """
    waiting: queue.Queue[Any] = queue.Queue(most)
    is_over = threading.Event()

    def put(item: Any) -> None:
        while not is_over.is_set():
            with suppress(queue.Full):
                waiting.put(item, timeout=0.1)
                return

    def take() -> None:
        end = None
        try:
            for item in items:
                if are_old_left_out:
                    with suppress(queue.Empty):
                        waiting.get_nowait()
                put(item)
                if is_over.is_set():
                    return
        except Exception as error:
            end = error
        put(end)

    thread = threading.Thread(target=take, daemon=True)
    thread.start()
    try:
        while (item := waiting.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        is_over.set()
        thread.join()


def _brightness(frame: Any) -> np.ndarray:
    """Return the brightness of a frame (h, w), upright, uint8."""
    if frame.format.name not in _PLANAR:
        frame = frame.reformat(format='gray')
    plane = frame.planes[0]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    return upright(rows[: frame.height, : frame.width], frame)


def upright(picture: np.ndarray, frame: Any) -> np.ndarray:
    """Return a picture (h, w, ...) turned as its frame says that players show it."""
    return np.ascontiguousarray(np.rot90(picture, round((frame.rotation or 0) / 90) % 4))
