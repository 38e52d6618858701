"""
The families of printed tags, and which tags the squares in a picture are.

OpenCV finds the squares. Their codes are compared with those of all families at once, which it does
for one family at a time, and slowly for large ones.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from kinpole_ros.film._corners import brightness_at
from kinpole_ros.film._decoder import FilmError

# Of families with equally many tags in a picture the first is taken: one with longer codes, or with
# fewer of them, is mistaken less. The first 50 tags of 4x4_1000 are those of 4x4_50, and so on.
LARGEST = (
    *('36h11', 'mip_36h12', '36h10', '7x7_1000', '6x6_1000', '25h9', '5x5_1000', 'original'),
    *('16h5', '4x4_1000'),
)
_SIZES = 50, 100, 250, 1000  # tags
FAMILIES = {
    '36h11': cv2.aruco.DICT_APRILTAG_36h11,
    '36h10': cv2.aruco.DICT_APRILTAG_36h10,
    '25h9': cv2.aruco.DICT_APRILTAG_25h9,
    '16h5': cv2.aruco.DICT_APRILTAG_16h5,
    'mip_36h12': cv2.aruco.DICT_ARUCO_MIP_36h12,
    'original': cv2.aruco.DICT_ARUCO_ORIGINAL,
    **{
        f'{n}x{n}_{size}': getattr(cv2.aruco, f'DICT_{n}X{n}_{size}')
        for n in (7, 6, 5, 4)
        for size in _SIZES
    },
}
# Half and twice as much were measured on films of all exposures: what they change is said.
# Of the wrong bits that the family can correct; 0.2: 0.5% of blurred tags are lost.
_CORRECTED = 0.4
_BRIGHT_BORDER = 0.35  # white modules of the border, over those of the code, as in OpenCV
# Of the longer side of the picture: smaller squares are not looked at. Half takes half more time.
_LEAST_PERIMETER = 0.03
_LEAST_CONTRAST = 10.0  # gray levels between black and white, as in OpenCV
_IN_MODULE = np.array([0.3, 0.5, 0.7])  # places in a module that are looked at
_ROUNDS = 4  # by which the level between black and white is found


class Tag(NamedTuple):
    """A tag in a picture: its number, and its corners (4, 2), pixels, from top left, clockwise."""

    number: int
    quad: np.ndarray

    def is_at(self, other: 'Tag') -> bool:
        """Return whether both are at one place."""
        distance = np.linalg.norm(self.quad.mean(axis=0) - other.quad.mean(axis=0))
        return bool(distance < np.linalg.norm(self.quad[1] - self.quad[0]))


def family_of(name: str) -> str:
    """Return a key of `FAMILIES`, '' for 'auto'; raises FilmError for another name."""
    if name != 'auto' and name not in FAMILIES:
        known = ', '.join(FAMILIES)
        raise FilmError(f'--family is {name!r}; it must be auto or one of {known}')
    return '' if name == 'auto' else name


def tag_count(family: str) -> int:
    """Return the number of tags of a family."""
    return len(cv2.aruco.getPredefinedDictionary(FAMILIES[family]).bytesList)


def largest(family: str) -> str:
    """Return the family that has all tags of a family: 4x4_1000 of 4x4_50."""
    grid, _, size = family.rpartition('_')
    return f'{grid}_{_SIZES[-1]}' if size.isdigit() else family


def smallest(family: str, tags: Iterable[int]) -> str:
    """Return the smallest family that has these tags of a family: 4x4_50 of 4x4_1000."""
    grid, _, size = family.rpartition('_')
    if not size.isdigit():
        return family
    last = max(tags, default=0)
    return f'{grid}_{next(size for size in _SIZES if last < size)}'


def codes(family: str, tags: Sequence[int]) -> np.ndarray:
    """Return the modules (n, M, M) of tags, black border included: 1 for white, 0 for black."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[family])
    modules = dictionary.markerSize + 2
    drawn = [cv2.aruco.generateImageMarker(dictionary, tag, modules) for tag in tags]
    return np.stack(drawn) / 255


@cache
def _detector() -> 'cv2.aruco.ArucoDetector':
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = _LEAST_PERIMETER
    # Squares within others, as a tag on its paper, are all wanted.
    parameters.minMarkerDistanceRate = parameters.minGroupDistance = 0.0
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    dictionary.bytesList = dictionary.bytesList[:1]  # no code is looked for
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def squares_in(gray: np.ndarray) -> np.ndarray:
    """Return the corners (n, 4, 2) of what may be squares in perspective, pixels, clockwise."""
    found, _, rejected = _detector().detectMarkers(gray)
    return np.array([quad.reshape(4, 2) for quad in (*found, *rejected)], float).reshape(-1, 4, 2)


def read_tags(
    gray: np.ndarray, quads: np.ndarray, families: Sequence[str], is_mirrored: bool = False
) -> dict[str, list[Tag]]:
    """
    Return the tags of each family in a picture, or those that it shows as in a mirror.

    `quads` (n, 4, 2) are the squares that were found in it.
    """
    seen: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    found = {}
    for family in families:
        known, wrong = _known_codes(family)
        modules = round(known.shape[-1] ** 0.5)
        if modules not in seen:
            seen[modules] = _bits(gray, quads, modules)
        rows, bits = seen[modules]
        if is_mirrored:
            bits = bits[:, :, ::-1]
        # The product of two codes of -1 and 1 falls by 2 with each bit in which they differ.
        agreement = bits.reshape(-1, modules**2) @ known.reshape(-1, modules**2).T
        best = agreement.argmax(axis=1)
        good = agreement.max(axis=1, initial=-np.inf) >= modules**2 - 2 * wrong
        number, turns = np.divmod(best, 4)
        tags: list[Tag] = []
        for k in np.flatnonzero(good).tolist():
            tag = Tag(int(number[k]), np.roll(quads[rows[k]], turns[k], axis=0))
            # The squares are found several times each.
            if not any(tag.number == other.number and tag.is_at(other) for other in tags):
                tags.append(tag)
        found[family] = tags
    return found


@cache
def _known_codes(family: str) -> tuple[np.ndarray, int]:
    """Return the codes (n, 4, M * M) of a family, -1 and 1, turned, and the wrong bits allowed."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[family])
    white = codes(family, range(len(dictionary.bytesList)))[:, 1:-1, 1:-1]
    turned = np.stack([np.rot90(white, k, axes=(1, 2)) for k in range(4)], axis=1)
    signs = np.float32(2 * turned - 1).reshape(len(white), 4, -1)
    return signs, int(_CORRECTED * dictionary.maxCorrectionBits)


def _bits(gray: np.ndarray, quads: np.ndarray, modules: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which quads (n, 4, 2) have a black border, and their codes (k, M, M), -1 and 1."""
    if not len(quads):
        return np.empty(0, int), np.empty((0, modules, modules), np.float32)
    side = modules + 2
    steps = (np.arange(side)[:, None] + _IN_MODULE).ravel()
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
    corners = np.float32([[0, 0], [side, 0], [side, side], [0, side]])
    maps = [cv2.getPerspectiveTransform(corners, np.float32(quad)) for quad in quads]
    at = np.concatenate([cv2.perspectiveTransform(grid, matrix) for matrix in maps])
    values = brightness_at(gray, at).astype(np.float32)
    samples = len(_IN_MODULE)
    values = values.reshape(-1, side, samples, side, samples).mean(axis=(2, 4))
    level = (values.min(axis=(1, 2)) + values.max(axis=(1, 2)))[:, None, None] / 2
    for _ in range(_ROUNDS):
        is_white = values > level
        count = is_white.sum(axis=(1, 2)).clip(1, side**2 - 1)
        white = np.where(is_white, values, 0).sum(axis=(1, 2)) / count
        black = np.where(is_white, 0, values).sum(axis=(1, 2)) / (side**2 - count)
        level = (white + black)[:, None, None] / 2
    inner = is_white[:, 1:-1, 1:-1]
    border = is_white.sum(axis=(1, 2)) - inner.sum(axis=(1, 2))
    good = (border <= _BRIGHT_BORDER * modules**2) & (white - black > _LEAST_CONTRAST)
    return np.flatnonzero(good), np.float32(2.0 * inner[good] - 1)
