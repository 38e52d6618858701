"""
Tags in the pictures of a film.

OpenCV finds tags and reads their codes, in the whole picture, now and then. From picture to picture
they are followed by their codes, which match also where blur hides them from OpenCV.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._frames import FilmError

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
# Half and twice as much were measured on films of all exposures: what they change is said.
_SEARCH_STEP = 12  # pictures between searches of the whole picture, for tags that were not seen yet
# After a tag was lost: half as long, and 1% of the tags behind fingers are found later.
_LOST_STEP, _LONG_LOST = 4, 20  # pictures between searches, for so many pictures
_JUST_LOST = 2  # pictures that are all searched: two in a row tell how fast a tag is
_UNKNOWN_STEP = 5  # pictures between searches until the family is known
_LONGEST_SIDE = 2000  # pixels in which the whole picture is searched: time only
# Of the wrong bits that the family can correct; 0.2: 0.5% of blurred tags are lost.
_CORRECTED = 0.4
_LEAST_SIDE = 10.0  # pixels; no effect on tags of 42
# Of the longer side of the picture: smaller squares are not looked at. Half takes half more time.
_LEAST_PERIMETER = 0.03
_JUMP = 0.5  # of the side: a corner may be so far from where it was expected; no effect


NO_TAGS: tuple[list[int], np.ndarray] = [], np.empty((0, 4, 2))


class TagFinder:
    """Finds the tags of a film, picture by picture; `family` is '' until a tag was seen."""

    def __init__(self, family: str = 'auto') -> None:
        self.family = family_of(family)
        self._detectors = {
            name: _detector(name) for name in ([self.family] if self.family else FAMILIES)
        }
        self._number = -1
        self._places: dict[int, list[np.ndarray]] = {}  # in the last picture, and in two before
        self._searched, self._lost = -_SEARCH_STEP, -_LONG_LOST  # pictures

    def find(self, gray: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Return the numbers of the n tags in the next picture, and their corners (n, 4, 2)."""
        self._number += 1
        if not self.family and not self._find_family(gray):
            return NO_TAGS
        seen = self._refined(gray, {tag: _next(places) for tag, places in self._places.items()})
        if len(seen) < len(self._places):
            self._lost = self._number
        if self._number - self._searched >= self._search_step(bool(seen)):
            self._searched = self._number
            others = self._in_whole_picture(gray)
            quads = {tag: quad for tag, quad in others.items() if tag not in seen}
            seen |= self._refined(gray, quads)
        self._places = {
            tag: [corners, *self._places.get(tag, [])[:2]] for tag, corners in seen.items()
        }
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

    def _search_step(self, is_any_seen: bool) -> int:
        """Return the pictures between searches of the whole picture, at the moment."""
        since = self._number - self._lost
        if since < _JUST_LOST:
            return 1
        return _SEARCH_STEP if is_any_seen and since >= _LONG_LOST else _LOST_STEP

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
        # The code of a tag that is partly outside of the picture is not known there.
        good &= ((corners > 0) & (corners < np.array(gray.shape[::-1]) - 1)).all(axis=(1, 2))
        return {tag: corners[k] for k, tag in enumerate(quads) if good[k]}


def _next(places: list[np.ndarray]) -> np.ndarray:
    """Return the corners (4, 2) that follow those of one to three pictures, newest first."""
    weights = {1: (1,), 2: (2, -1), 3: (3, -3, 1)}[len(places)]  # of a polynomial
    return np.tensordot(weights, places, axes=1)


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


def _detector(family: str) -> 'cv2.aruco.ArucoDetector':
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = _CORRECTED
    parameters.minMarkerPerimeterRate = _LEAST_PERIMETER
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
