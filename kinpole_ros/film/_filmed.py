"""What a film does not tell, what its pictures show, and what follows in the plane of motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._ground import PlaneMap
from kinpole_ros.film._lens import Lens
from kinpole_ros.film._video import Video
from kinpole_ros.findings import Finding

# m; the black square of a tag that `kinpole film --print` draws.
SIZE = 0.04


@dataclass(frozen=True)
class FilmOptions:
    """
    What a film does not tell.

    Attributes
    ----------
    size : float
        Side of the black square of a tag, m.
    ground : tuple of int
        Tags that stand still. The center of the first is the origin, and x points to that of the
        second; with one tag, along its top edge.
    family : str
        A key of `FAMILIES`, or 'auto'.
    camera : str, optional
        The file of the camera.
    line_time : float
        s from one row of a picture to the next (rolling shutter); the stamps are of the middle row.
    points : dict of str to complex
        Dots to follow by name, pixels, x + y i, in the picture at `at`.
    at : float
        s from the first picture to that in which they are chosen.
    ruler : tuple, optional
        Two places, pixels, and their distance, m: the first is the origin, and x points to the
        second. Then no tags are searched.
    rate : float, optional
        Pictures per second that the camera took, Hz, instead of the stamps of the film.
    topic : str, optional
        The topic of pictures or detected tags in a bag, if there are several.

    """

    size: float = SIZE
    ground: tuple[int, ...] = (0,)
    family: str = 'auto'
    camera: str | None = None
    line_time: float = 0.0
    points: dict[str, complex] = field(default_factory=dict)
    at: float = 0.0
    ruler: tuple[complex, complex, float] | None = None
    rate: float | None = None
    topic: str | None = None

    def check(self) -> None:
        """Raise FilmError for a value out of range."""
        if not 0 < self.size < 100:
            raise FilmError(f'--size is {self.size}; it must be more than 0 m, the side of a tag')
        if not 0 <= self.line_time < 0.01:
            raise FilmError(f'--line-time is {self.line_time}; it must be from 0 to 0.01 s')
        if self.rate is not None and not 1e-3 < self.rate < 1e7:
            raise FilmError(f'--rate is {self.rate:g}; it must be more than 0.001 Hz')
        if self.ruler is not None and not (
            self.points and self.ruler[0] != self.ruler[1] and 0 < self.ruler[2] < 1000
        ):
            raise FilmError('--scale is for --points; it must be two places and their distance, m')


@dataclass(frozen=True)
class Filmed:
    """
    The tags and dots of a film.

    Attributes
    ----------
    tags : tuple of int
        Their numbers.
    stamps : ndarray
        (T,) int64, ns, from the first picture on; those of a bag from 1970.
    corners : ndarray
        (T, n, 4), complex, m, in the plane of motion; NaN where not seen.
    dots : dict of str to ndarray
        The places (T,) of dots, likewise.
    heights : dict of int to float
        Heights of tags above the plane of `maps`, m, by a known camera; else 0.
    maps : list of PlaneMap
        The map of each picture, or one for all.
    lens : Lens or None
        The camera, if its file was given.
    picture : tuple of int
        Width and height, pixels.
    assumed : list of str
        What was assumed, and the options that change it, a line each.
    corner_heights : ndarray or None
        (n, 4), m, of tags that turn out of the picture, over the plane of `maps`; None if they move
        in it.
    video : Video or None
        The film, if it has pictures.
    numbers : ndarray
        (T,) int, of the pictures in it, as some are left out.

    """

    tags: tuple[int, ...]
    stamps: np.ndarray
    corners: np.ndarray
    dots: dict[str, np.ndarray]
    heights: dict[int, float]
    maps: list[PlaneMap]
    lens: Lens | None
    picture: tuple[int, int]
    assumed: list[str]
    corner_heights: np.ndarray | None = None
    video: Video | None = None
    numbers: np.ndarray = field(default_factory=lambda: np.empty(0, int))

    def frames(self) -> Iterator[tuple[int, Any]]:
        """Yield the row of each picture and its frame; raises FilmError if there are none."""
        if self.video is None:
            raise FilmError(
                'there are tags, but no pictures that show them; fix: record pictures, too'
            )
        wanted = iter(enumerate(self.numbers.tolist()))
        row, own = next(wanted)
        for number, (_, frame) in enumerate(self.video.frames()):
            if number == own:
                yield row, frame
                row, own = next(wanted, (0, -1))
            if own < 0:
                break

    @property
    def names(self) -> list[str]:
        """The names of the markers: the corners of tags, and dots."""
        return marker_names(self.tags) + list(self.dots)

    @property
    def places(self) -> np.ndarray:
        """The places (T, N) of the markers, complex, m."""
        corners = self.corners.reshape(len(self.stamps), -1)
        return np.column_stack((corners, *self.dots.values()))

    @property
    def points(self) -> np.ndarray:
        """The markers (T, N, 3), m; z is 0 but for corners of tags that turn out of the picture."""
        flat = self.places
        z = np.zeros(flat.shape)
        if self.corner_heights is not None:
            z[:, : self.corner_heights.size] = self.corner_heights.ravel()
        return np.stack((flat.real, flat.imag, np.where(np.isnan(flat), np.nan, z)), axis=-1)

    def to_pixels(
        self, points: np.ndarray, number: int, height: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Return the pixels (..., 2) of points (...), complex, m, in the picture of a number."""
        pixels = self.maps[min(number, len(self.maps) - 1)].to_pixels(points, height)
        return self.lens.curved(pixels) if self.lens is not None else pixels


def marker_names(tags: Sequence[int]) -> list[str]:
    """Return the names of corners: tag3_1 is the top left corner of tag 3, then clockwise."""
    return [f'tag{tag}_{k}' for tag in tags for k in range(1, 5)]


@dataclass(frozen=True)
class Seen:
    """
    What the pictures show: tags, stamps (T,), and pixels of corners (T, n, 4, 2), dots (T, m, 2).

    `picture` is the width and height of one, which was turned to the left by so many quarter turns.
    `unused` are tags that were found and left out, each with its cause. `path` is that of the film,
    '' of a live camera.
    """

    tags: list[int]
    stamps: np.ndarray
    pixels: np.ndarray
    dots: np.ndarray
    picture: tuple[int, int]
    family: str
    turns: int = 0
    unused: tuple[Finding, ...] = ()
    path: str = ''

    def refused(self, text: str) -> FilmError:
        """Return the error of a film whose tags cannot be placed."""
        return FilmError(f'{self.path}: {text}' if self.path else text)
