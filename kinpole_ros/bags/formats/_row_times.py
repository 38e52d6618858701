"""The columns of a table that have the time of each row, by their titles, and their unit."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import shown
from kinpole_ros.bags.formats._sheet import Sheet

# "time", "Time (s)", "t [s]", "timestamp_ns", "time_ms", "POSITION_T (sec)", "__time", "%time".
_TIME = re.compile(
    r'(?:(?:__|%)?time|t|timestamp|time[ _]?stamp|rosbagtimestamp|position_t|seconds'
    r'|zeit|temps|tiempo|tempo|tijd|czas|время|时间|時間)\s*'
    r'(?:[(\[](?P<bracketed>[^)\]]*)[)\]]|[_ ](?P<unit>[a-zµ]+))?',
    re.IGNORECASE,
)
_SECONDS = {
    **dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 1.0),
    **dict.fromkeys(('ms', 'msec', 'millisecond', 'milliseconds'), 1e-3),
    **dict.fromkeys(('us', 'µs', 'usec', 'microsecond', 'microseconds'), 1e-6),
    **dict.fromkeys(('ns', 'nsec', 'nanosecond', 'nanoseconds'), 1e-9),
    **dict.fromkeys(('min', 'minute', 'minutes'), 60.0),
}
_TRACKMATE, _FRAMES = 'position_t', ('frame', 'frames')  # in place of a unit of its times
# The stamp in the header of a message: one number, in ns, or seconds and nanoseconds.
_STAMP = re.compile(r'(?:.*[./])?stamp', re.IGNORECASE)
_STAMP_PARTS = re.compile(r'(?:.*[./])?stamp[./](?P<part>n?secs?|nanosec)', re.IGNORECASE)
_ECHOED = '%time'  # of `rostopic echo -p`, in ns as its stamps
_EPOCH = 1e9, 4e9  # s since 1970 that recordings of this age have


class TimeColumns(NamedTuple):
    """Columns of times: one, or seconds and nanoseconds, with the s of their units."""

    columns: tuple[int, ...]
    units: tuple[float, ...]
    is_stated: bool  # whether the title, or its program, says the unit
    title: str


def find_times(sheet: Sheet, header: Sequence[str]) -> TimeColumns | None:
    """
    Find the columns of times; None where there are none.

    A column t is that of times, whatever others there are; then come stamps in the headers of
    messages of one topic. Raises BagError where several others could be, or one is in a unit that
    is not known.
    """
    if 't' in header:
        return TimeColumns((header.index('t'),), (1.0,), False, 't')
    if (stamps := _header_stamps(sheet, header)) is not None:
        return stamps
    units = {}
    for column, name in enumerate(header):
        if match := _TIME.fullmatch(name):
            unit = (match['bracketed'] or match['unit'] or '').strip().lower()
            unit = 'ns' if name.lower() == _ECHOED else unit
            if not (name.lower().startswith(_TRACKMATE) and unit in _FRAMES):
                units[column] = unit
    if len(units) > 1:
        names = ', '.join(f"'{shown(header[column])}'" for column in units)
        raise BagError(
            f'{sheet.path}, line {sheet.lines[0]}: the times could be in any of {names}; '
            'fix: name the one to use t, in seconds, or give --rate HZ'
        )
    for column, unit in units.items():
        if (unit or 's') not in _SECONDS:
            raise BagError(
                f"{sheet.path}, line {sheet.lines[0]}: column '{shown(header[column])}' is in a "
                f'unit that is not known; fix: name it t, in seconds, or give --rate HZ'
            )
        return TimeColumns((column,), (_SECONDS[unit or 's'],), bool(unit), header[column])
    return None


def _header_stamps(sheet: Sheet, header: Sequence[str]) -> TimeColumns | None:
    """Find the stamps of the only topic of a table, if they were set."""
    whole = [k for k, name in enumerate(header) if _STAMP.fullmatch(name)]
    parts = {k: match['part'].lower()[0] for k, name in enumerate(header)
             if (match := _STAMP_PARTS.fullmatch(name))}  # fmt: skip
    found = None
    if len(whole) == 1 and not parts:
        unit = 1e-9 if _ECHOED in header else 1.0
        found = TimeColumns((whole[0],), (unit,), _ECHOED in header, header[whole[0]])
    elif sorted(parts.values()) == ['n', 's'] and not whole:
        seconds, nanoseconds = sorted(parts, key=lambda k: parts[k], reverse=True)
        found = TimeColumns((seconds, nanoseconds), (1.0, 1e-9), True, header[seconds])
    if found is None or not all(any(map(_is_set, sheet.texts(k, 1))) for k in found.columns[:1]):
        return None
    return found


def _is_set(cell: str) -> bool:
    return bool(cell.strip('0.'))


def read_times(sheet: Sheet, found: TimeColumns) -> tuple[np.ndarray, np.ndarray | None]:
    """
    Read the times (T,), s, of all rows below the titles, NaN where a cell is empty.

    Returns the stamps (T,), ns, too, where all are whole numbers of a unit that are more exact so.
    """
    units = list(found.units)
    numbers = sheet.numbers(found.columns, [found.title] * len(units), 1)
    usual = float(np.nanmedian(numbers[:, 0])) if np.isfinite(numbers[:, 0]).any() else 0.0
    if not found.is_stated:
        # Times of day count from 1970, which no unit but one allows.
        likely = [one for one in (1.0, 1e-3, 1e-6, 1e-9) if _EPOCH[0] < usual * one < _EPOCH[1]]
        units[0] = likely[0] if likely else units[0]
    if units[-1] != 1e-9:
        return numbers @ units, None
    texts = [list(sheet.texts(column, 1)) for column in found.columns]
    if all(cell.isascii() and cell.isdecimal() for t in texts for cell in t):
        scales = [round(unit * 1e9) for unit in units]
        rows = zip(*texts, strict=True)
        exact = [sum(int(c) * n for c, n in zip(row, scales, strict=True)) for row in rows]
        if all(0 <= one < 2**63 for one in exact):
            stamps = np.array(exact, np.int64)
            return stamps * 1e-9, stamps
    return numbers @ units, None
