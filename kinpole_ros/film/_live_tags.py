"""The pictures of a camera as they come, and their tags in the plane of motion."""

import time
from collections.abc import Generator, Iterator
from contextlib import closing

import cv2
import numpy as np

from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._film import gather, mirror_fault
from kinpole_ros.film._filmed import Filmed, FilmOptions, marker_names
from kinpole_ros.film._ground import leave_out_hidden
from kinpole_ros.film._lens import Lens
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._tags import TagFinder
from kinpole_ros.film._video import Picture, Video, ahead

_LEARNED = 45  # pictures from which the map to the plane is learned: a second and a half
_MOST = 250  # tags
_QUALITY = 70  # of a JPEG


class LiveTags:
    """
    Places the tags of a camera that stands still, picture by picture.

    The map to the plane is learned from the first pictures with tags, and kept. `learned` is None
    until then. `lens` is the camera if it is known otherwise than by a file. Raises FilmError for a
    camera that moves or mirrors, and for options of videos.
    """

    def __init__(self, options: FilmOptions, lens: Lens | None = None) -> None:
        options.check()
        if options.line_time:
            raise FilmError('--line-time is for videos, whose stamps are exact; fix: leave it out')
        self.learned: Filmed | None = None
        self._options, self._lens = options, lens
        self._finder = TagFinder(options.family)
        self._found: list[tuple[list[int], np.ndarray]] = []
        self._without_tags = 0  # pictures since the last one with tags
        self._known: list[int] = []  # tags, in the order of their markers

    def find(self, gray: np.ndarray) -> tuple[list[str], np.ndarray]:
        """
        Return names of markers and their places (N,), complex, m; none until it is learned.

        A tag has its columns from its first picture on, with NaN where it is hidden.
        """
        tags, places = self._finder.find(gray)
        self._without_tags = 0 if tags else self._without_tags + 1
        if self.learned is None and self._finder.mirrored and self._without_tags >= _LEARNED:
            fix = 'switch that off, as by v4l2-ctl --set-ctrl horizontal_flip=0'
            raise mirror_fault('the camera', self._finder, fix)
        height, width = gray.shape
        return self.place(tags, places, (width, height))

    def place(
        self, tags: list[int], places: np.ndarray, picture: tuple[int, int], family: str = ''
    ) -> tuple[list[str], np.ndarray]:
        """
        Return the same of tags that are found already, with corners (n, 4, 2), pixels.

        `family` is that of another program.
        """
        if self.learned is None:
            self._learn(tags, places, picture, family)
        if self.learned is None:
            return [], np.empty(0, complex)
        self._known += [tag for tag in tags if tag not in self._known][: _MOST - len(self._known)]
        rows = [k for k, tag in enumerate(tags) if tag in self._known]
        tags, pixels = [tags[k] for k in rows], places[rows]
        if self.learned.lens is not None:
            pixels = self.learned.lens.straight(pixels)
        heights = np.reshape([self.learned.heights.get(tag, 0.0) for tag in tags], (-1, 1))
        corners = self.learned.maps[0].to_plane(pixels, heights)
        leave_out_hidden(corners, self._options.size)
        shown = np.full((len(self._known), 4), np.nan, complex)
        shown[[self._known.index(tag) for tag in tags]] = corners
        return marker_names(self._known), shown.ravel()

    def _learn(
        self, tags: list[int], places: np.ndarray, picture: tuple[int, int], family: str
    ) -> None:
        if tags:
            self._found.append((tags, places.astype(np.float32)))
        if len(self._found) < _LEARNED:
            return
        seen = gather(list(range(len(self._found))), self._found, picture, self._finder, family)
        self._found.clear()
        if seen.tags:
            filmed = place_seen(seen, self._options, self._lens, may_turn=False)
            if len(filmed.maps) > 1:
                raise FilmError(
                    'the camera moves against the tags of the ground, and live it has to stand '
                    'still; fix: hold it by a tripod, or name a tag of the ground by --ground'
                )
            self.learned, self._known = filmed, list(filmed.tags)


def live_pictures(source: str) -> Iterator[Picture]:
    """
    Yield the pictures of a camera, or of a video at its pace, with stamps from the first one on.

    `source` is the number of a camera, its device, as /dev/video0, or a video. The stamps of a
    camera are those of receipt. Raises FilmError if it cannot be opened.
    """
    if source.isdigit() or source.startswith('/dev/'):
        yield from ahead(_camera_pictures(source), 1, are_old_left_out=True)
        return
    start = None
    with closing(Video(source).pictures()) as pictures:  # type: ignore[type-var]
        for picture in pictures:
            # Not before the first picture is there, which takes the longest.
            start = time.monotonic() - picture.stamp * 1e-9 if start is None else start
            time.sleep(max(0.0, start + picture.stamp * 1e-9 - time.monotonic()))
            yield picture


def _camera_pictures(source: str) -> Generator[Picture, None, None]:
    camera = cv2.VideoCapture(int(source) if source.isdigit() else source)
    try:
        if not camera.isOpened():
            raise FilmError(f'no camera at {source}; fix: see to its number and your rights to it')
        start = None
        while True:
            is_read, picture = camera.read()
            now = time.monotonic_ns()
            start = now if start is None else start
            if not is_read:
                raise FilmError(f'camera {source} gives no more pictures; fix: see to its cable')
            gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
            yield Picture(now - start, gray)
    finally:
        camera.release()


def jpeg(gray: np.ndarray) -> bytes:
    """Return a picture as a JPEG."""
    return bytes(cv2.imencode('.jpg', gray, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
