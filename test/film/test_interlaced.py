"""The two fields of an interlaced frame are pictures of two instants."""

from pathlib import Path

import av
import numpy as np
import pytest
from rendered import FOUR_BAR, Camera, Film

from kinpole_ros.film import FilmOptions, read_film
from kinpole_ros.film._video import Video

SMALL = Camera((768, 432), width=0.55, target=0.0 - 0.03j)


def write(path: Path, pictures: list[np.ndarray]) -> Path:
    """Write each two pictures as the fields of a frame, the lower one first, at 25 Hz."""
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('libx264', rate=25)
        stream.height, stream.width = pictures[0].shape
        stream.pix_fmt = 'yuv420p'
        stream.options = {'x264-params': 'bff=1', 'crf': '18', 'preset': 'veryfast'}
        for lower, upper in zip(pictures[::2], pictures[1::2], strict=True):
            frame = upper.copy()
            frame[1::2] = lower[1::2]
            gray = np.full((frame.shape[0] // 2, frame.shape[1]), 128, np.uint8)
            both = av.VideoFrame.from_ndarray(np.concatenate((frame, gray)), 'yuv420p')
            container.mux(stream.encode(both))
        container.mux(stream.encode())
    return path


def test_tags_of_an_interlaced_film_are_found_in_both_fields(tmp_path: Path) -> None:
    film = Film(0.1 + np.arange(10) / 50, FOUR_BAR[:3], SMALL, exposure=1e-3)
    path = write(tmp_path / 'interlaced.mp4', list(film.pictures()))
    filmed = read_film(path, FilmOptions(size=FOUR_BAR[0].size))
    assert 'at 50 Hz by the stamps of the file; interlaced, so each field' in filmed.assumed[0]
    assert filmed.tags == (0, 1, 2)
    assert filmed.video is not None and filmed.video.is_interlaced
    assert abs(np.median(np.diff(filmed.stamps)) - 1e9 / 50) < 10
    shown = np.stack([filmed.to_pixels(row, k) for k, row in enumerate(filmed.corners)])
    off = shown - np.stack(list(film.corners().values()), axis=1)
    assert np.isfinite(off).mean() > 0.9
    assert np.sqrt(np.nanmean(off**2)) < 0.3


def test_numbered_fields_are_two_to_a_frame(tmp_path: Path) -> None:
    pictures = [np.full((64, 96), 10 * k, np.uint8) for k in range(8)]
    video = Video(write(tmp_path / 'gray.mp4', pictures), rate=100.0)
    found = [(picture.stamp, picture.gray.mean()) for picture in video.pictures()]
    assert [stamp for stamp, _ in found] == [5_000_000 * k for k in range(8)]
    assert [gray for _, gray in found] == sorted(gray for _, gray in found)


@pytest.mark.parametrize(('codec', 'name', 'size'), [
    ('mpeg2video', 'tape.mpg', (96, 64)), ('dvvideo', 'tape.avi', (720, 576)),
])  # fmt: skip
def test_films_of_camcorders_are_read(codec: str, name: str, size: tuple, tmp_path: Path) -> None:
    """Converted, they would lose that they are interlaced."""
    with av.open(str(tmp_path / name), 'w') as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height = size
        stream.pix_fmt = 'yuv420p'
        for k in range(4):
            gray = np.full((size[1] * 3 // 2, size[0]), 60 + 20 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(gray, 'yuv420p')))
        container.mux(stream.encode())
    found = [(picture.stamp, picture.gray.mean()) for picture in Video(tmp_path / name).pictures()]
    assert {stamp % 20_000_000 for stamp, _ in found} == {0}
    assert found[0][1] == pytest.approx(60, abs=3) and found[-1][1] == pytest.approx(120, abs=3)
