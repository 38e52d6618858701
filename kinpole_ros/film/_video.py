"""The pictures of a film and their stamps, decoded in a thread beside the search for tags."""

import queue
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.film._container import video_source
from kinpole_ros.film._decoder import (
    DamagedError,
    FilmError,
    Source,
    Timed,
    brightness,
    quarter_turns,
)
from kinpole_ros.film._recorded_pictures import bag_source, folder_source, is_bag_of_pictures
from kinpole_ros.findings import Finding

_WAITING = 3  # pictures between decoder and search
# A camera in the dark takes pictures at less than its rate, whose times are right. Slow motion is
# slower than that.
_SLOWER = 1.5
Progress = Callable[[float], None]


class Picture(NamedTuple):
    """A picture: its stamp, ns, and its brightness (h, w), uint8."""

    stamp: int
    gray: np.ndarray


class Video:
    """
    The pictures of a film in order: of a video, a folder of pictures, or a topic of a bag.

    Stamps count from the first picture on, those of a bag from 1970. `rate` numbers the pictures
    instead, Hz, and `topic` is one of a bag.

    `count` is the number of pictures as the container has them, 0 if unknown; `clock` says what
    the stamps are, and `turns` are the quarter turns to the left by which pictures are shown.
    `late` counts pictures left out because their stamps do not increase, `is_interlaced` says that
    the fields of its frames are pictures of their own, and `cut` where a film ends that is not
    sound.
    """

    def __init__(
        self, path: str | Path, rate: float | None = None, topic: str | None = None
    ) -> None:
        self.path, self.late, self.turns = str(path), 0, 0
        self.cut: Finding | None = None
        self.is_interlaced = False
        self._rate = rate
        self._source = _source_of(self.path, topic)
        self.count = self._source.pictures
        self._slowing = 1.0
        self._read: list[tuple[int | None, float]] = []  # times, ns, and numbers of its pictures
        self.clock = f'by {self._source.clock}'
        if rate is not None:
            self.clock = 'by --rate'
        elif not self._source.has_times:
            raise FilmError(
                f'{path} {self._source.clock}, which does not say when its pictures were taken; '
                'fix: give --rate HZ, those per second that the camera took'
            )
        elif self._source.capture is not None:
            self._correct_slow_motion(*self._source.capture)

    def _correct_slow_motion(self, tag: str, rate: float) -> None:
        """Take the rate of a tag, Hz, where the film is played at quite another one."""
        played = _even_rate(self._source.times()) if self._source.times is not None else 0.0
        if played and not 1 / _SLOWER < rate / played < _SLOWER:
            self._slowing = played / rate
            self.clock = f'by its tag {tag}, while it is played at {played:.4g} Hz'

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures; a thread decodes ahead. Raises FilmError."""
        for stamp, frame in self.frames():
            yield Picture(stamp, brightness(frame))

    def frames(self) -> Iterator[tuple[int, Any]]:
        """Yield stamps and frames of the decoder; a thread decodes ahead. Raises FilmError."""
        yield from ahead(self._stamped(), _WAITING)

    def read_again(self, first: int) -> Iterator[np.ndarray]:
        """Yield the brightness of the pictures that were read once more, from a number on."""
        yield from ahead(self._read_again(first), _WAITING)

    def _read_again(self, first: int) -> Generator[np.ndarray, None, None]:
        times, numbers = zip(*self._read, strict=True)
        is_timed = None not in times and bool((np.diff(times) > 0).all())
        wanted = times if is_timed else numbers
        # The fields of interlaced frames follow from those before, so from the first ones.
        time = times[first] if is_timed and not self.is_interlaced else None
        for since in (Timed(time, numbers[first], None), None):
            row = first
            with suppress(DamagedError):  # what was read comes before the damage
                for own in self._source.read(since):
                    key = own.time if is_timed else own.number
                    if row == first and key is not None and key > wanted[row]:
                        break  # the search in the file led beyond it
                    if key == wanted[row]:
                        yield brightness(own.frame)
                        row += 1
                    if row == len(wanted):
                        return
            if row > first:
                return

    def _stamped(self) -> Generator[tuple[int, Any], None, None]:
        first, last = None, -1
        begin = self.late = 0
        self._read.clear()
        try:
            for own, number, frame in self._source.read(None):
                time = own if self._rate is None else round(number * 1e9 / self._rate)
                if time is None:
                    self.late += 1
                    continue
                self.is_interlaced = self.is_interlaced or bool(number % 1)
                if first is None:
                    first, begin = (0, time) if self._source.is_absolute else (time, 0)
                    self.turns = quarter_turns(frame)
                stamp = time - first
                if self._slowing != 1:
                    stamp = round(stamp * self._slowing)
                if stamp <= last:
                    self.late += 1
                    continue
                last = stamp
                self._read.append((own, number))
                yield stamp, frame
        except DamagedError:
            if last < 0:
                raise
            seconds = (last - begin) * 1e-9
            about = {'path': self.path, 'seconds': seconds}
            self.cut = Finding('damaged_film', values=about)
        if last < 0:
            raise FilmError(f'{self.path} has no pictures; fix: film it again, or convert it')


def _source_of(path: str, topic: str | None) -> Source:
    if is_bag_of_pictures(path):
        return bag_source(path, topic)
    if topic is not None:
        raise FilmError(f'{path} is no bag, and --topic is of bags; fix: leave it out')
    return folder_source(path) if Path(path).is_dir() else video_source(path)


def _even_rate(times: np.ndarray) -> float:
    """Return the rate, Hz, of times (T,), ns, of which some may be missing; 0 if it has none."""
    steps = np.diff(times)
    if not len(steps):
        return 0.0
    return float(1e9 * np.rint(steps / np.median(steps)).sum() / steps.sum())


def ahead(
    items: Generator[Any, None, None], most: int, are_old_left_out: bool = False
) -> Iterator[Any]:
    """
    Yield items that a thread takes ahead, `most` at a time; an error among them is raised here.

    Where `are_old_left_out`, the thread does not wait: items that came too fast are not yielded.
    """
    waiting: queue.Queue[Any] = queue.Queue(most)
    is_over = threading.Event()

    def put(item: Any) -> None:
        while not is_over.is_set():
            with suppress(queue.Full):
                waiting.put(item, timeout=0.1)
                return

    def take() -> None:
        end = None
        try:
            # A file is closed by the thread that opened it.
            with closing(items):
                for item in items:
                    if are_old_left_out:
                        with suppress(queue.Empty):
                            waiting.get_nowait()
                    put(item)
                    if is_over.is_set():
                        return
        except Exception as error:
            end = error
        put(end)

    thread = threading.Thread(target=take, daemon=True)
    thread.start()
    try:
        while (item := waiting.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        is_over.set()
        thread.join()
