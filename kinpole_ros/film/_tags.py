"""
Tags in the pictures of a film: near their last places in each picture, anywhere now and then.

OpenCV reads the codes. The corners are then those by which a code fits the picture.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._video import FilmError

# The first family of which tags are seen is taken: one with longer codes is mistaken less.
FAMILIES = {
    '36h11': cv2.aruco.DICT_APRILTAG_36h11,
    'mip_36h12': cv2.aruco.DICT_ARUCO_MIP_36h12,
    '7x7_250': cv2.aruco.DICT_7X7_250,
    '6x6_250': cv2.aruco.DICT_6X6_250,
    '5x5_250': cv2.aruco.DICT_5X5_250,
    'original': cv2.aruco.DICT_ARUCO_ORIGINAL,
    '4x4_50': cv2.aruco.DICT_4X4_50,
}
_SEARCH_STEP = 12  # pictures between searches of the whole picture
_LOST_STEP = 4  # the same while a tag is lost
_JUST_LOST = 2  # pictures for which each whole picture is searched for it
_UNKNOWN_STEP = 5  # the same until the family is known
_LONGEST_SIDE = 2000  # pixels in which the whole picture is searched
_KEPT = 10  # pictures for which a lost tag is searched near its last place
_MARGIN = 0.7  # of the side of a tag, around its expected place
_CORRECTED = 0.4  # of the wrong bits that the family can correct
_LEAST_SIDE = 10.0  # pixels
# Perimeters of tags over the longer side of what is searched: smaller squares are not looked at.
_LEAST_OF_WHOLE, _LEAST_OF_PART = 0.03, 0.8
_JUMP = 0.5  # of the side: a corner may be so far from where a detector of contours saw it


class _Track(NamedTuple):
    """The last picture with a tag, and its corners (4, 2) in that, and in one or two before."""

    number: int
    places: tuple[np.ndarray, ...]

    def after(self, steps: int) -> np.ndarray:
        """Return the corners (4, 2) that are expected some pictures later: a parabola's."""
        last, *before = self.places
        if not before:
            return last
        velocity = last - before[0]
        if steps == 1 and len(before) > 1:
            velocity = velocity + last - 2 * before[0] + before[1]
        return np.asarray(last + steps * velocity)

    def then(self, number: int, corners: np.ndarray) -> '_Track':
        """Return the track with its next corners (4, 2)."""
        steps = number - self.number
        if steps > _KEPT:
            return _Track(number, (corners,))
        before = corners + (self.places[0] - corners) / steps
        return _Track(number, (corners, before, *(self.places[1:2] if steps == 1 else ())))


NO_TAGS: tuple[list[int], np.ndarray] = [], np.empty((0, 4, 2))


class TagFinder:
    """Finds the tags of a film, picture by picture; `family` is '' until a tag was seen."""

    def __init__(self, family: str = 'auto') -> None:
        self.family = family_of(family)
        self._detectors = {
            name: _detector(name) for name in ([self.family] if self.family else FAMILIES)
        }
        self._near = {name: _detector(name, _LEAST_OF_PART) for name in self._detectors}
        self._number = -1
        self._tracks: dict[int, _Track] = {}
        self._searched = -_SEARCH_STEP

    def find(self, gray: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Return the numbers of the n tags in the next picture, and their corners (n, 4, 2)."""
        self._number += 1
        if not self.family and not self._find_family(gray):
            return NO_TAGS
        expected = {
            tag: track.after(1)
            for tag, track in self._tracks.items()
            if track.number == self._number - 1
        }
        seen = self._refined(gray, expected)
        others = self._near_last_places(gray, seen)
        if self._number - self._searched >= self._search_step(seen | others):
            self._searched = self._number
            others = self._in_whole_picture(gray) | others
        seen |= self._refined(gray, {tag: quad for tag, quad in others.items() if tag not in seen})
        for tag, corners in seen.items():
            last = self._tracks.get(tag, _Track(-1 - _KEPT, ()))
            self._tracks[tag] = last.then(self._number, corners)
        return (list(seen), np.stack(list(seen.values()))) if seen else NO_TAGS

    def _find_family(self, gray: np.ndarray) -> bool:
        """Take the first family of which a tag is seen, and return whether there is one."""
        if self._number % _UNKNOWN_STEP:
            return False
        for name, detector in self._detectors.items():
            if _read(detector, gray):
                self.family = name
                self._detectors = {name: detector}
                return True
        return False

    def _search_step(self, seen: dict[int, np.ndarray]) -> int:
        """Return the pictures between searches of the whole picture, at the moment."""
        lost = [
            self._number - track.number for tag, track in self._tracks.items() if tag not in seen
        ]
        if lost and min(lost) <= _JUST_LOST:
            return 1
        return _LOST_STEP if not seen or (lost and min(lost) <= _KEPT) else _SEARCH_STEP

    def _near_last_places(
        self, gray: np.ndarray, known: dict[int, np.ndarray]
    ) -> dict[int, np.ndarray]:
        """Return quads (4, 2) of tags, but known ones, near the places where they are expected."""
        seen = {}
        for tag, track in self._tracks.items():
            steps = self._number - track.number
            if steps > _KEPT or tag in known:
                continue
            expected = track.after(steps)
            side = np.linalg.norm(track.places[0][1] - track.places[0][0])
            # What was not foreseen grows with what was.
            margin = _MARGIN * side * (1 + 0.5 * (steps - 1))
            margin += 0.5 * np.linalg.norm((expected - track.places[0]).mean(axis=0))
            low = np.maximum(np.floor(expected.min(axis=0) - margin), 0).astype(int)
            high = np.ceil(expected.max(axis=0) + margin).astype(int)
            part = gray[low[1] : high[1], low[0] : high[0]]
            if min(part.shape) < _LEAST_SIDE:
                continue
            quad = _read(self._near[self.family], part).get(tag)
            if quad is not None:
                seen[tag] = quad + low
        return seen

    def _in_whole_picture(self, gray: np.ndarray) -> dict[int, np.ndarray]:
        """Return quads (4, 2) of all tags in a picture."""
        shrink = min(1.0, _LONGEST_SIDE / max(gray.shape))
        if shrink < 1:
            gray = cv2.resize(gray, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        quads = _read(self._detectors[self.family], gray)
        return {tag: (quad + 0.5) / shrink - 0.5 for tag, quad in quads.items()}

    def _refined(self, gray: np.ndarray, quads: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Return the corners (4, 2) of those tags near quads (4, 2) whose codes match."""
        if not quads:
            return {}
        near = np.stack(list(quads.values()))
        corners = refine_corners(gray, near, codes(self.family, list(quads)))
        side = np.linalg.norm(near[:, 1] - near[:, 0], axis=-1)
        moved = np.abs(corners - near).max(axis=(1, 2))
        good = (moved < _JUMP * side) & (side > _LEAST_SIDE)
        return {tag: corners[k] for k, tag in enumerate(quads) if good[k]}


def family_of(name: str) -> str:
    """Return a key of `FAMILIES`, '' for 'auto'; raises FilmError for another name."""
    if name != 'auto' and name not in FAMILIES:
        known = ', '.join(FAMILIES)
        raise FilmError(f'--family is {name!r}; it must be auto or one of {known}')
    return '' if name == 'auto' else name


def codes(family: str, tags: Sequence[int]) -> np.ndarray:
    """Return the modules (n, M, M) of tags, black border included: 1 for white, 0 for black."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[family])
    modules = dictionary.markerSize + 2
    drawn = [cv2.aruco.generateImageMarker(dictionary, tag, modules) for tag in tags]
    return np.stack(drawn) / 255


def _detector(family: str, least: float = _LEAST_OF_WHOLE) -> 'cv2.aruco.ArucoDetector':
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = _CORRECTED
    parameters.minMarkerPerimeterRate = least
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILIES[family]), parameters)


def _read(detector: 'cv2.aruco.ArucoDetector', gray: np.ndarray) -> dict[int, np.ndarray]:
    """Return the quads (4, 2) of the tags in a picture; one that is seen twice counts as none."""
    quads, numbers, _ = detector.detectMarkers(gray)
    if numbers is None:
        return {}
    tags = numbers.ravel().tolist()
    return {
        tag: quad.reshape(4, 2).astype(float)
        for tag, quad in zip(tags, quads, strict=True)
        if tags.count(tag) == 1
    }
