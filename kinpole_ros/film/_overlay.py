"""
Shapes of the plane of motion over a film, and a film straightened to the plane for a page.

A page draws in the plane, so its pictures are straightened: the perspective and the lens are taken
out, and the motion of the camera.
"""

import base64
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np

from kinpole_ros.files import whole_file
from kinpole_ros.film._decoder import FilmError, upright
from kinpole_ros.film._film import SAME_STAMP
from kinpole_ros.film._filmed import Filmed, FilmOptions
from kinpole_ros.film._video import Progress, Video

_TICKS = 90_000  # of a second, in which stamps are written
_BITS = 4  # of the parts of a pixel in which OpenCV draws
_FARTHEST = 20_000.0  # pixels; lines that go farther are cut
_PAGE_WIDTH = 800  # pixels of a straightened picture
_MOST_PICTURES = 400  # in a page: some 50 kB each
_QUALITY = 65  # of a JPEG
_AROUND = 0.3  # of the extent of the tags, which a page shows around them
_GRID = 50  # pixels between the lines by which dots are chosen
_STEP = 16  # pixels between exact places of a straightened picture; it is smooth between them


class Shape(NamedTuple):
    """
    A line through points (n,), complex, m, in a color (red, green, blue), `width` pixels wide.

    `kind` is 'line'; 'hull', the outline of the points; or 'dot', a disk about each point. They are
    `height` m above the plane.
    """

    points: np.ndarray
    color: tuple[int, int, int]
    width: float = 2.0
    kind: str = 'line'
    height: float = 0.0


def write_overlay(
    filmed: Filmed,
    shapes_at: Callable[[int], list[Shape]],
    output: str | Path,
    progress: Progress | None = None,
) -> None:
    """
    Write a film again with shapes drawn over it, as .mp4.

    `filmed` is what was found in it, `shapes_at` returns the shapes at a stamp, ns, and `progress`
    is called with the fraction done. Raises FilmError if the video cannot be written.
    """
    stamps = filmed.stamps.tolist()
    rate = 1e9 * (len(stamps) - 1) / max(stamps[-1] - stamps[0], 1)
    try:
        with whole_file(output) as part, av.open(str(part), 'w', format='mp4') as container:
            stream: Any = container.add_stream('libx264', rate=round(rate) or 30)
            stream.pix_fmt, stream.options = 'yuv420p', {'crf': '20', 'preset': 'veryfast'}
            stream.codec_context.time_base = Fraction(1, _TICKS)
            for number, frame in filmed.frames():
                picture = upright(frame.to_ndarray(format='bgr24'), frame)
                # H.264 has half as many colors each way.
                height, width = (side // 2 * 2 for side in picture.shape[:2])
                picture = np.ascontiguousarray(picture[:height, :width])
                for shape in shapes_at(stamps[number]):
                    pixels = filmed.to_pixels(shape.points, number, shape.height)
                    draw_shape(picture, pixels, shape)
                if number == 0:
                    stream.height, stream.width = height, width
                drawn = av.VideoFrame.from_ndarray(picture, 'bgr24')
                drawn.pts = round((stamps[number] - stamps[0]) * _TICKS / 1e9)
                drawn.time_base = Fraction(1, _TICKS)
                container.mux(stream.encode(drawn))
                if progress is not None:
                    progress((number + 1) / len(filmed.stamps))
            container.mux(stream.encode())
    except (av.FFmpegError, ValueError) as error:
        raise FilmError(f'{output} cannot be written ({error}); fix: see to the disk') from None


def write_picture(path: str | Path, output: str | Path, options: FilmOptions) -> float:
    """
    Write the picture in which dots are chosen, with a grid of its pixels, as .png.

    Returns its instant, s from the first picture.
    """
    first = None
    for picture in Video(path, options.rate, options.topic).pictures():
        first = picture.stamp if first is None else first
        if picture.stamp - first >= options.at * 1e9 - SAME_STAMP:
            break
    else:
        raise FilmError(f'--at is {options.at:g} s, and {path} ends before')
    shown = cv2.cvtColor(picture.gray, cv2.COLOR_GRAY2BGR)
    for along, side in enumerate(picture.gray.shape[::-1]):
        for place in range(0, side, _GRID):
            line = shown[:, place] if along == 0 else shown[place]
            line[:] = 0.6 * line + (0, 80, 80)
            corner = (place + 2, 12) if along == 0 else (2, place + 12)
            cv2.putText(shown, str(place), corner, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 255, 255))
    with whole_file(output) as part:
        part.write_bytes(cv2.imencode('.png', shown)[1].tobytes())
    return (picture.stamp - first) * 1e-9


def draw_shape(picture: np.ndarray, pixels: np.ndarray, shape: Shape) -> None:
    """Draw a shape on a picture, in place; `pixels` (n, 2) are its points, NaN breaks a line."""
    color = shape.color[::-1]
    scale = picture.shape[1] / 1280  # lines are as wide in films of any size
    width = max(1, round(shape.width * scale))
    seen = np.isfinite(pixels).all(axis=-1) & (np.abs(pixels) < _FARTHEST).all(axis=-1)
    fine = np.where(seen[:, None], np.rint(np.nan_to_num(pixels) * 2**_BITS), 0).astype(np.int32)
    if shape.kind == 'dot':
        for place in fine[seen]:
            radius = round(shape.width * scale * 2**_BITS)
            cv2.circle(picture, place.tolist(), radius, color, -1, cv2.LINE_AA, _BITS)
        return
    if shape.kind == 'hull':
        lines = [cv2.convexHull(fine[seen])] if seen.sum() > 1 else []
    else:
        ends = np.flatnonzero(np.diff(np.concatenate(([0], seen, [0])).astype(int)))
        lines = [fine[a:b] for a, b in ends.reshape(-1, 2)]
    is_closed = shape.kind == 'hull'
    cv2.polylines(picture, lines, is_closed, color, width, cv2.LINE_AA, _BITS)


def straightened(
    filmed: Filmed, stamps: np.ndarray, progress: Progress | None = None
) -> dict[str, Any]:
    """
    Return the pictures of a film as the plane of motion, for a page with instants (T,), ns.

    `x`, `y`, `width` and `height` are m, from the lower left; `pictures` are JPEGs in base64, and
    `at` is the picture of each instant.
    """
    low, high = _box(filmed)
    wide = max(filmed.picture[0] / 2, _PAGE_WIDTH)
    scale = min(wide, _PAGE_WIDTH) / (high - low).real  # pixels per m
    size = round((high - low).real * scale), round((high - low).imag * scale)
    # Each instant shows the picture of its stamp, or the nearest of those that are kept.
    nearest = np.abs(filmed.stamps.searchsorted(stamps).clip(0, len(filmed.stamps) - 1))
    step = -(-len(np.unique(nearest)) // _MOST_PICTURES)
    kept = np.unique(nearest)[::step]
    at = kept.searchsorted(nearest, 'right') - 1
    wanted, pictures = set(kept.tolist()), []
    places = None
    for number, frame in filmed.frames():
        if number in wanted:
            if places is None or len(filmed.maps) > 1:
                places = _places(filmed, number, low + 1j * (high - low).imag, scale, size)
            picture = upright(frame.to_ndarray(format='bgr24'), frame)
            flat = cv2.remap(picture, places, None, cv2.INTER_LINEAR, borderValue=(255,) * 3)
            _, data = cv2.imencode('.jpg', flat, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            pictures.append(base64.b64encode(data.tobytes()).decode())
            if progress is not None:
                progress(len(pictures) / len(kept))
        if len(pictures) == len(kept):
            break
    return {
        'x': low.real,
        'y': low.imag,
        'width': size[0] / scale,
        'height': size[1] / scale,
        'pictures': pictures,
        'at': np.minimum(at, len(pictures) - 1).tolist(),
    }


def _box(filmed: Filmed) -> tuple[complex, complex]:
    """Return the lower left and upper right of what a page shows, complex, m."""
    seen = filmed.places[np.isfinite(filmed.places)]
    low = complex(seen.real.min(), seen.imag.min())
    high = complex(seen.real.max(), seen.imag.max())
    around = _AROUND * max((high - low).real, (high - low).imag)
    return low - around * (1 + 1j), high + around * (1 + 1j)


def _places(
    filmed: Filmed, number: int, corner: complex, scale: float, size: tuple[int, int]
) -> np.ndarray:
    """Return the pixels (h, w, 2) that a straightened picture shows; `corner` is its top left."""
    columns = np.arange(0, size[0] + _STEP, _STEP)
    rows = np.arange(0, size[1] + _STEP, _STEP)
    points = corner + ((columns + 0.5) - 1j * (rows[:, None] + 0.5)) / scale
    coarse = np.nan_to_num(filmed.to_pixels(points, number), nan=-1e4).astype(np.float32)
    x, y = np.meshgrid(np.arange(size[0]) / _STEP, np.arange(size[1]) / _STEP)
    return cv2.remap(coarse, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
