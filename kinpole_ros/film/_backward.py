"""
Tags followed backward, from the picture in which they are first read to those before it.

A tag that is blurred is followed by its code, but not found by it. So the pictures before its first
sharp one have it only if they are gone through once more, from the last to the first.
"""

from collections import defaultdict, deque
from contextlib import closing

import numpy as np

from kinpole_ros.film._tags import TagFinder
from kinpole_ros.film._video import Video

_KEPT = 64 << 20  # bytes: a second of 1080p at 30 Hz, the usual time between two key frames
_AHEAD = 2  # pictures after the first one with a tag, which tell how fast it is


class TagsBothWays:
    """
    The tags of a film: a finder follows them forward, and from their first pictures backward.

    `found` has their numbers and their corners (n, 4, 2) float32 in each picture.
    """

    def __init__(self, finder: TagFinder) -> None:
        self.found: list[tuple[list[int], np.ndarray]] = []
        self._finder = finder
        self._family, self._since = '', 0  # and the picture from which on it is the family
        self._kept: deque[np.ndarray] = deque()
        self._most = 0  # pictures that are kept
        self._shown = 0  # pictures up to the last one that is kept
        self._unfinished: defaultdict[int, list[int]] = defaultdict(list)  # tags by picture

    def add(self, gray: np.ndarray) -> None:
        """Find the tags in the next picture, and follow those back that began shortly before."""
        tags, corners = self._finder.find(gray)
        if self._finder.family != self._family:  # a tag was misread before
            self._family, self._since = self._finder.family, len(self.found)
            self._unfinished.clear()
        self.found.append((tags, corners.astype(np.float32)))
        self._keep(gray)
        self._follow_new(len(self.found) - 1 - _AHEAD)

    def finish(self, video: Video) -> None:
        """Read the film again as far as tags lead back to pictures that are no longer kept."""
        for row in range(len(self.found) - _AHEAD, len(self.found)):
            self._follow_new(row)
        while self._unfinished:
            last = max(self._unfinished)
            self._kept.clear()
            self._shown = max(0, last - self._most)
            with closing(video.read_again(self._shown)) as pictures:  # type: ignore[type-var]
                for gray in pictures:
                    self._keep(gray)
                    if self._shown in self._unfinished:
                        self._follow_back(self._shown, self._unfinished.pop(self._shown))
                    if self._shown == last:
                        break
            self._unfinished.pop(last, None)  # of a file that can no longer be read

    def _keep(self, gray: np.ndarray) -> None:
        self._most = max(_AHEAD + 2, _KEPT // gray.nbytes)
        self._kept.append(gray.copy())  # a picture may be part of a larger frame
        self._shown += 1
        if len(self._kept) > self._most:
            self._kept.popleft()

    def _follow_new(self, row: int) -> None:
        """Follow back the tags that are in a picture, and not in the one before it."""
        if row > 0 and row >= self._since:
            before = self.found[row - 1][0]
            new = [tag for tag in self.found[row][0] if tag not in before]
            if new:
                self._follow_back(row, new)

    def _follow_back(self, row: int, tags: list[int]) -> None:
        """Follow tags of a picture back, as far as they are seen or pictures are kept."""
        places = {tag: self._places(tag, row) for tag in tags}
        for gray in list(self._kept)[len(self._kept) - self._shown + row - 1 :: -1]:
            row -= 1
            known, corners = self.found[row]
            places = {tag: near for tag, near in places.items() if tag not in known}
            seen = self._finder.follow(gray, places)
            if not seen:
                return
            self.found[row] = [*known, *seen], np.float32([*corners, *seen.values()])
            places = {tag: [own, *places[tag][:_AHEAD]] for tag, own in seen.items()}
        if row > 0 and places:
            self._unfinished[row] += places

    def _places(self, tag: int, row: int) -> list[np.ndarray]:
        """Return the corners of a tag in a picture, and in those after it without a gap."""
        places = []
        for tags, corners in self.found[row : row + 1 + _AHEAD]:
            if tag not in tags:
                break
            places.append(corners[tags.index(tag)])
        return places
