"""Files of unknown format as bytes, cells or XML, and the record that every format is read into."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from kinpole_ros.bags._files import BagError, read_errors
from kinpole_ros.bags.formats._cells import number_in
from kinpole_ros.bags.formats._sheet import Sheet
from kinpole_ros.files import open_regular, read_limited

MOST_BYTES = 256 << 20  # of a file; hours of tracked points are less
# m in the units that programs write, by their names in small letters. C3D cuts names to four.
UNITS = {
    **dict.fromkeys(('m', 'meter', 'meters', 'metre', 'metres', 'mete', 'metr'), 1.0),
    **dict.fromkeys(('dm', 'decimeters', 'decimetres'), 0.1),
    **dict.fromkeys(('cm', 'centimeter', 'centimeters', 'centimetres', 'cent'), 0.01),
    **dict.fromkeys(('mm', 'millimeter', 'millimeters', 'millimetres', 'mill'), 0.001),
    **dict.fromkeys(('um', 'µm', 'micrometers', 'micron', 'microns'), 1e-6),
    **dict.fromkeys(('in', 'inch', 'inches'), 0.0254),
    **dict.fromkeys(('ft', 'foot', 'feet'), 0.3048),
}
_MARKUP = re.compile(rb'(?:\xef\xbb\xbf)?\s*(?:<|\{|\[\s*\{)')
_HEAD_BYTES = 4096  # by which a format is recognized
_MOST_XML_BYTES = 48 << 20
_MOST_ELEMENTS = 400_000  # of XML, at some 200 bytes each, and as much for each attribute
# A point stands for none if it is so many of the steps of its marker away from all of at least so
# many others; this share of its steps is shorter.
_FAR_STEPS, _FEWEST_SEEN, _MOST_STEPS = 10.0, 5, 0.9
_SLICE_POINTS = 1 << 14  # that are looked at together
SAME_RATE = 0.01  # within which a rate is the one of the times, which may be rounded
_MOST_DECIMALS = 17  # no float64 needs more digits


class Options(NamedTuple):
    """Options of the user; None for those that were not given."""

    rate: float | None = None  # Hz; times in the file do not count then
    likelihood: float | None = None  # the least at which a point counts as seen


@dataclass(frozen=True)
class Points:
    """Tracked points of any format: n markers in T frames."""

    names: Sequence[str]  # n
    points: np.ndarray  # (T, n, 3), in the unit of the file; NaN where a marker was not seen
    frames: np.ndarray  # (T,), int64: number of each frame
    times: np.ndarray | None  # (T,), s; None where the file has none
    unit: str  # as the file calls it; '' where it does not say
    y_down: bool = False
    lines: Sequence[int] = ()  # of each frame, in a text file
    time_column: str = 'Time'
    no_times: str = 'has no times'  # why `times` is None
    notes: Sequence[str] = field(default=())  # what the user should know, a line each
    stamps: np.ndarray | None = None  # (T,), ns: `times` as they were written, where they were
    # Poses (T, B, 7) of the bodies: a point, in the unit of the file, and a quaternion x, y, z, w.
    bodies: Sequence[str] = ()
    poses: np.ndarray | None = None

    @property
    def scale(self) -> float | None:
        """Return the length of a unit, m; None where only the user can say."""
        return UNITS.get(self.unit.lower())


def _slices(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield rows in slices, each with the first of the next: all may fill the memory."""
    step = max(1, _SLICE_POINTS // max(1, points.shape[1]))
    for first in range(0, len(points), step):
        yield points[first : first + step + 1]


def without_stand_ins(points: np.ndarray) -> np.ndarray:
    """
    Return which points (T, n) of (T, n, 3) stand for a marker that was not seen.

    Programs write 0, -1, 9999 and the like for each coordinate then. Such a point has one whole
    number in all of its coordinates, and is far from all others of its marker, which is never so of
    one that passes there. z is not looked at where a file has none.
    """
    flat = not any(np.nan_to_num(rows[..., 2]).any() for rows in _slices(points))
    result = np.zeros(points.shape[:2], bool)
    alike_at = [(rows[..., 0] == rows[..., 1]).any(axis=0) for rows in _slices(points)]
    for k in np.flatnonzero(np.any(alike_at, axis=0)).tolist():
        own = points[:, k, : 2 if flat else 3]
        is_constant = (own == own[:, :1]).all(axis=-1) & (own[:, 0] == np.rint(own[:, 0]))
        others = own[~is_constant & np.isfinite(own).all(axis=-1)] if is_constant.any() else own[:0]
        if len(others) < _FEWEST_SEEN:
            continue
        usual = float(np.quantile(np.linalg.norm(np.diff(others, axis=0), axis=1), _MOST_STEPS))
        for value in np.unique(own[is_constant, 0]).tolist():
            if np.linalg.norm(others - value, axis=1).min() > _FAR_STEPS * usual:
                result[is_constant & (own[:, 0] == value), k] = True
    return result


class Format(NamedTuple):
    """One format: how it is recognized and read."""

    name: str  # for --format
    what: str
    example: str  # its first lines, shortened
    recognizes: Callable[['File'], bool]
    read: Callable[['File', Options], Points]
    is_always_ended: bool = False  # its programs end the last line, too
    has_likelihood: bool = False  # of its points, in some files at least


class File:
    """A file or folder of unknown format. Raises BagError when it cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []  # what the user should know, a line each
        self.claimed_frames = 0.0  # by its head; 0 where it says nothing
        self.is_folder = path.is_dir()
        self.head = b''
        if not self.is_folder:
            with read_errors(path), open_regular(path) as file:
                self.head = file.read(_HEAD_BYTES)

    @cached_property
    def data(self) -> bytes:
        """Return all its bytes."""
        with read_errors(self.path):
            return read_limited(self.path, MOST_BYTES)

    @cached_property
    def sheet(self) -> Sheet:
        """Return its cells, where it is text; text that is not UTF-8 is taken for Windows-1252."""
        line = _not_utf8_line(self.data)
        if b'\0' in self.data:  # UTF-16, or no text at all
            raise not_utf8(self.path, line or 1)
        return Sheet(self.path, self.data, self.notes, line)

    @property
    def is_text(self) -> bool:
        """Return whether it can be text."""
        return not self.is_folder and b'\0' not in self.data[:_HEAD_BYTES]

    @property
    def is_sheet(self) -> bool:
        """Return whether it can be rows of cells, which XML and JSON are not."""
        return self.is_text and not _MARKUP.match(self.head)

    def note_count(self, claim: str, count: int) -> None:
        """Note that the head of the file has another count of frames than the file."""
        self.claimed_frames = number_in(claim)
        self.notes += count_notes(self.path, claim, count)

    def counts_left_out_row(self, count: int) -> bool:
        """Return whether the head counts one frame more, and a last row was left out."""
        is_left_out = 'sheet' in vars(self) and self.sheet.left_out is not None
        return is_left_out and self.claimed_frames == count + 1

    def xml(self, fix: str) -> ElementTree.Element:
        """Parse it as XML; raises BagError, with this fix, where it is damaged or too large."""
        try:
            # Entities can multiply, and no program that tracks points writes them.
            if b'<!DOCTYPE' in self.data:
                raise ValueError('it defines entities')
            if len(self.data) > _MOST_XML_BYTES or self.data.count(b'=') > 2 * _MOST_ELEMENTS:
                raise ValueError('it is too large')
            elements = ElementTree.iterparse(BytesIO(self.data), ['start'])
            root: ElementTree.Element = next(elements)[1]
            if sum(1 for _ in islice(elements, _MOST_ELEMENTS)) == _MOST_ELEMENTS:
                raise ValueError(f'it has more than {_MOST_ELEMENTS} elements')
        except (ElementTree.ParseError, ValueError, LookupError) as error:
            raise BagError(f'{self.path} is not XML that can be read: {error}; {fix}') from error
        return root


def not_utf8(path: Path, line: int) -> BagError:
    """Return the error of a text that is not UTF-8."""
    return BagError(f'{path}, line {line}: not UTF-8; fix: save it as CSV UTF-8')


def count_notes(path: Path, claim: str, count: int, noun: str = 'frames') -> list[str]:
    """Note that the head of a file has another count than the file."""
    claimed = number_in(claim)
    if not claimed or claimed == count:
        return []
    return [f'{path} says that it has {claimed:.0f} {noun}, and has {count}']


def frame_times(
    file: File, frames: np.ndarray, rate: float, times: np.ndarray | None = None
) -> np.ndarray | None:
    """
    Return the times (T,), s, of frames by the rate (Hz) and the times that a file gives.

    They are exact multiples of the interval where these agree with the times of the file, which are
    rounded; else those of the file, with a note where the rate is another; None where there is
    neither.
    """
    if times is not None and np.isnan(times).all():
        times = None
    if not (math.isfinite(rate) and rate > 0):
        return times
    even = frames / rate
    if times is None:
        return even
    start = times[0] - even[0]
    # Both times of a difference are rounded. A missing frame is off by a whole interval.
    step = 10.0 ** -_decimals(times)
    most = step * (1.01 if step * rate < 0.99 else 0.99)
    if np.nanmax(np.abs(times - even - start), initial=0.0) > most:
        steps = np.diff(times) / np.diff(frames)
        own_rate = 1.0 / float(np.nanmedian(steps)) if np.nanmedian(steps) else math.inf
        if abs(own_rate / rate - 1.0) > SAME_RATE:
            file.notes.append(
                f'{file.path} says {rate:.6g} Hz, and its times go on at {own_rate:.6g} Hz: the '
                f'times are taken; fix: give --rate {rate:.6g} if they are wrong'
            )
        return times
    return even + start


def _decimals(numbers: np.ndarray) -> int:
    """Return the fewest decimals with which all of these numbers can be written."""
    numbers = numbers[~np.isnan(numbers)]
    for digits in range(_MOST_DECIMALS):
        if np.array_equal(np.round(numbers, digits), numbers):
            return digits
    return _MOST_DECIMALS


def _not_utf8_line(data: bytes) -> int:
    """Return the number of the first line that is not UTF-8; 0 where all are."""
    if not data.isascii():
        for number, line in enumerate(BytesIO(data), start=1):
            try:
                line.decode()
            except UnicodeDecodeError:
                return number
    return 0
