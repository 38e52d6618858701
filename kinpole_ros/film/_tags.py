"""
Tags in the pictures of a film.

Now and then the whole picture is searched for squares, and their codes are read. From picture to
picture tags are followed by their codes, which match also where blur hides their squares.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from kinpole_ros.film._corners import refine_corners
from kinpole_ros.film._families import (
    LARGEST,
    Tag,
    codes,
    family_of,
    largest,
    read_tags,
    smallest,
    squares_in,
    tag_count,
)
from kinpole_ros.findings import Finding

# Half and twice as much were measured on films of all exposures: what they change is said.
_SEARCH_STEP = 12  # pictures between searches of the whole picture, for tags that were not seen yet
# After a tag was lost: half as long, and 1% of the tags behind fingers are found later.
_LOST_STEP, _LONG_LOST = 4, 20  # pictures between searches, for so many pictures
_JUST_LOST = 2  # pictures that are all searched: two in a row tell how fast a tag is
_UNKNOWN_STEP = 5  # pictures between searches until the family is known
_LONGEST_SIDE = 2000  # pixels in which the whole picture is searched: time only
_LEAST_SIDE = 10.0  # pixels; no effect on tags of 42
_JUMP = 0.5  # of the side: a corner may be so far from where it was expected; no effect


_LEAST_TWICE = 2  # pictures with a tag at two places, which one misreading does not make
LEAST_PICTURES = 5  # in which a tag is seen, else it is left out

NO_TAGS: tuple[list[int], np.ndarray] = [], np.empty((0, 4, 2))


class TagFinder:
    """
    Finds the tags of a film, picture by picture.

    `family` is '' until a tag was seen; black and white are exchanged in tags that are `inverse`.
    `mirrored` is the family whose tags are seen only as in a mirror, `others` has tags of other
    families in the picture by which the family was found, and `twice` counts the pictures in which
    a tag was seen at two places.
    """

    def __init__(self, family: str = 'auto') -> None:
        given = family_of(family)
        self.family, self.is_inverse, self.mirrored = '', False, ''
        self.others: dict[str, list[int]] = {}
        self.twice: Counter[int] = Counter()
        self._given = given
        self._families = (largest(given),) if given else LARGEST
        self._number, self._seen = -1, 0  # pictures; those with tags of this family
        self._places: dict[int, list[np.ndarray]] = {}  # in the last picture, and in two before
        self._searched, self._lost = -_SEARCH_STEP, -_LONG_LOST  # pictures

    def find(self, gray: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Return the numbers of the n tags in the next picture, and their corners (n, 4, 2)."""
        self._number += 1
        if not self.family and not self._find_family(gray):
            return NO_TAGS
        if self.is_inverse:
            gray = 255 - gray
        seen = self._refined(gray, {tag: _next(places) for tag, places in self._places.items()})
        if len(seen) < len(self._places):
            self._lost = self._number
        if self._number - self._searched >= self._search_step(bool(seen)):
            self._searched = self._number
            others = self._in_whole_picture(gray)
            quads = {tag: quad for tag, quad in others.items() if tag not in seen}
            seen |= self._refined(gray, quads)
            if not seen and self._seen < LEAST_PICTURES:
                self.family = ''  # one picture was misread
        self._seen += bool(seen)
        self._places = {
            tag: [corners, *self._places.get(tag, [])[:2]] for tag, corners in seen.items()
        }
        return (list(seen), np.stack(list(seen.values()))) if seen else NO_TAGS

    def follow(
        self, gray: np.ndarray, places: Mapping[int, list[np.ndarray]]
    ) -> dict[int, np.ndarray]:
        """
        Return the corners (4, 2) of those tags that are seen where their places lead to.

        The places are those of one to three pictures next to this one, the nearest first.
        """
        quads = {tag: _next(near) for tag, near in places.items()}
        return self._refined(255 - gray if self.is_inverse else gray, quads)

    def unused(self, counts: Mapping[int, int]) -> dict[int, Finding]:
        """Return why tags, that were found in so many pictures each, are not used."""
        reasons = {}
        for tag in sorted({*counts, *self.twice}):
            is_rare = counts.get(tag, 0) < LEAST_PICTURES
            if self.twice[tag] >= _LEAST_TWICE or (self.twice[tag] and is_rare):
                reasons[tag] = Finding('tag_twice', values={'tag': tag})
            elif self._given and tag >= tag_count(self._given):
                about = {'tag': tag, 'family': self._given}
                reasons[tag] = Finding('tag_of_no_family', values=about)
            elif is_rare:
                reasons[tag] = Finding('tag_rare', values={'tag': tag, 'count': counts[tag]})
        return reasons

    def name(self, tags: Sequence[int]) -> str:
        """Return the name of the family: the given one, or the smallest that has these tags."""
        name = self._given or smallest(self.family, tags)
        return f'{name}, white on black' if self.is_inverse else name

    def _find_family(self, gray: np.ndarray) -> bool:
        """Take the family of which most tags are seen, and return whether there is one."""
        if self._number % _UNKNOWN_STEP:
            return False
        found: dict[tuple[str, str], list[Tag]] = {}
        inverse = 255 - gray
        quads = squares_in(gray)
        shown = {
            '': (gray, quads),
            'inverse': (inverse, squares_in(inverse)),
            'mirror': (gray, quads),
        }
        for side, (picture, squares) in shown.items():
            read = read_tags(picture, squares, self._families, side == 'mirror')
            found.update({(side, name): tags for name, tags in read.items()})
        side, name = max(found, key=lambda key: len(found[key]))
        own = found[side, name]
        if side == 'mirror' or not own:
            self.mirrored = smallest(name, [tag.number for tag in own]) if own else self.mirrored
            return False
        self.family, self.is_inverse, self._seen = name, side == 'inverse', 0
        self._searched = self._number - _SEARCH_STEP
        # A tag may be misread as one of a family with shorter codes.
        taken, self.others = list(own), {}
        rest = [key for key in found if key[0] == side and key[1] != name]
        for key in sorted(rest, key=lambda key: -len(found[key])):
            tags = [tag for tag in found[key] if not any(map(tag.is_at, taken))]
            self.others[key[1]] = sorted(tag.number for tag in tags)
            taken += tags
        return True

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
        tags = read_tags(gray, squares_in(gray), [self.family])[self.family]
        numbers = [tag.number for tag in tags]
        self.twice.update({number for number in numbers if numbers.count(number) > 1})
        return {
            tag.number: (tag.quad + 0.5) / shrink - 0.5
            for tag in tags
            if numbers.count(tag.number) == 1
        }

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
