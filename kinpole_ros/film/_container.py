"""
The frames of a video file, by FFmpeg.

Only common containers and codecs are opened, which read no other file and no network.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import av
import numpy as np

from kinpole_ros.files import open_regular, printable
from kinpole_ros.film._decoder import (
    MOST_PIXELS,
    DamagedError,
    FilmError,
    Source,
    Timed,
    check_size,
    fields,
)

# FFmpeg invents 25 Hz for these, which have pictures and no times.
_UNTIMED = {'h264': 'raw H.264', 'hevc': 'raw H.265', 'm4v': 'raw MPEG-4', 'mjpeg': 'raw MJPEG'}
_FORMATS = ','.join(('mov,matroska,webm,avi,mpeg,mpegts', *_UNTIMED))
_CODECS = (
    'h264,hevc,av1,libdav1d,vp8,vp9,libvpx,libvpx-vp9,mpeg4,mpeg2video,dvvideo,mjpeg,prores,'
    'rawvideo,ffv1'
)
_LONGEST = 2.0**31  # s, as stamps of ROS
# com.android.capture.fps, which Android writes, and others like it.
_CAPTURE = re.compile(r'capture[._-]?(fps|frame_?rate)$', re.IGNORECASE)


def video_source(path: str) -> Source:
    """Return the frames of a video file; raises FilmError."""
    with _opened(path) as (container, stream):
        kind = _UNTIMED.get(container.format.name)
        return Source(
            lambda since: _frames(path, since if kind is None else None),
            'the stamps of the file' if kind is None else f'is {kind}',
            kind is None,
            int(stream.frames),
            capture=_capture_rate({**container.metadata, **stream.metadata}),
            times=lambda: _times(path),
        )


def _capture_rate(tags: dict[str, str]) -> tuple[str, float] | None:
    """Return the tag of the rate at which the camera took pictures, and this rate, Hz."""
    for name, text in tags.items():
        match = re.match(r'[\d.]+', str(text)) if _CAPTURE.search(name) else None
        if match and match[0].count('.') < 2 and 0 < float(match[0]) < 1e6:
            return printable(name), float(match[0])
    return None


def _times(path: str) -> np.ndarray:
    """Return the times (T,), ns, of the frames, without decoding them."""
    with _opened(path) as (container, stream):
        try:
            times = [
                float(packet.pts * stream.time_base)
                for packet in container.demux(stream)
                if packet.pts is not None
            ]
        except (av.FFmpegError, OSError, ValueError):  # they are read as far as they go
            times = []
    return np.unique(np.array(times) * 1e9)


def _frames(path: str, since: Timed | None) -> Iterator[Timed]:
    with _opened(path) as (container, stream):
        rate = float(stream.average_rate or 0.0)
        try:
            if since is not None and since.time is not None:
                rate = 0.0  # the frames before it are not counted
                # To the frame before it from which on frames can be decoded.
                container.seek(int(since.time * 1e-9 / stream.time_base), stream=stream)
            for number, frame in fields(container.decode(stream)):
                check_size(path, frame.width, frame.height)
                time = frame.time
                if time is None and rate:
                    time = number / rate
                is_time = time is not None and abs(time) < _LONGEST
                yield Timed(round(time * 1e9) if is_time else None, number, frame)
        except (av.FFmpegError, OSError, ValueError) as error:
            raise _unreadable(path, error) from None


@contextmanager
def _opened(path: str) -> Iterator[tuple[Any, Any]]:
    """Open the file, and give the container and its stream of pictures."""
    options = {'format_whitelist': _FORMATS, 'codec_whitelist': _CODECS}
    with open_regular(path) as file:
        try:
            container = av.open(file, options=options, metadata_errors='replace')
        except (av.FFmpegError, OSError, ValueError) as error:
            raise _unreadable(path, error) from None
        with container:
            if not container.streams.video:
                raise FilmError(f'{path} has sound only; fix: give a video')
            stream = container.streams.video[0]
            context = stream.codec_context
            if context is None:
                raise _unreadable(path, ValueError('its compression is not known'))
            check_size(path, context.width, context.height)
            context.thread_count = min(2, os.cpu_count() or 1)
            context.thread_type = 'AUTO'
            context.options = {'max_pixels': str(MOST_PIXELS)}
            yield container, stream


def _unreadable(path: str, error: Exception) -> FilmError:
    text = printable(getattr(error, 'strerror', None) or str(error))
    return DamagedError(
        f'{path} cannot be read as a video ({text}); fix: convert it, as by ffmpeg -i IN OUT.mp4'
    )
