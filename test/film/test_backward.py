"""Tags are followed back from where they are first read, so blurred first pictures have them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered import Camera, Film
from test_tags import picture

from kinpole_ros.film import FilmOptions, LiveTags, _backward, read_film
from kinpole_ros.film._tags import TagFinder

SHARP = 14  # the first picture that is sharp
COUNT = 24
STEP = 3  # pixels a picture
BLURRED = 11  # pixels: the tags of 48 are followed at this blur, and not found


def shown(k: int, tags: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
    """Return a picture of tags that move to the right, in the first ones with a long exposure."""
    moved = np.full((160, 640), 120, np.uint8)
    moved[20:140, 20 + STEP * k : 500 + STEP * k] = picture(tags)
    return cv2.blur(moved, (BLURRED, 1)) if k < SHARP else moved


def write_film(path: Path, pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(Film, 'pictures', lambda _: iter(pictures))
    size = pictures[0].shape[::-1]
    return Film(np.arange(len(pictures)) / 30, camera=Camera(size), crf=10).write(path)


@pytest.mark.parametrize('kept', [_backward._KEPT, 0])
def test_pictures_before_the_first_sharp_one_have_tags(
    kept: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where only a few pictures are kept, so that the film is read again."""
    monkeypatch.setattr(_backward, '_KEPT', kept)
    film = write_film(tmp_path / 'film.mp4', [shown(k) for k in range(COUNT)], monkeypatch)
    filmed = read_film(film, FilmOptions(ground=(9,)))
    assert filmed.tags == (0, 1, 2)
    assert np.isfinite(filmed.corners).all()
    centers = np.stack([filmed.to_pixels(row, 0).mean(axis=1) for row in filmed.corners])
    assert np.abs(np.diff(centers, axis=0) - [STEP, 0]).max() < 0.3


def test_a_camera_does_not_wait_for_sharp_pictures() -> None:
    live, finder = LiveTags(FilmOptions()), TagFinder()
    tags = [finder.find(shown(k))[0] for k in range(COUNT)]
    assert not any(tags[:SHARP])
    assert all(tags[SHARP + 4 :])
    assert [live.find(shown(k))[0] for k in range(SHARP)] == [[]] * SHARP


def test_a_tag_is_not_followed_into_pictures_that_have_it_not() -> None:
    """It is laid down in the middle of the film; another one is taken away before."""
    finder = TagFinder()
    both = _backward.TagsBothWays(finder)
    for k in range(COUNT):
        both.add(shown(k + SHARP, (0, 1, 3) if k < 9 else (0, 2, 3)))
    assert [sorted(tags) for tags, _ in both.found] == [[0, 1, 3]] * 9 + [[0, 2, 3]] * (COUNT - 9)
    assert all(len(tags) == len(corners) for tags, corners in both.found)
