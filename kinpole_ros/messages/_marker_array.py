"""The markers of a MarkerArray in its bytes: which are shown, and how they are called."""

import struct
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from kinpole_ros.messages._offsets import Items, MarkerOffsets, MessageOffsets, text_at
from kinpole_ros.messages._types import Marker, MessageError, NoMarkersError

LISTS = (Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS)  # drawn at each of their points
SINGLE = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)  # drawn once, at their pose
_SHOWN_CHARACTERS = 80  # of a name, which may be as long as the message

# Reads the identities in a message of a known layout; None where they are not plain ASCII.
Names = Callable[[bytes], tuple[str, ...] | None]


class Entry(NamedTuple):
    """A marker of an array."""

    ns: str
    number: int
    kind: int
    action: int


def entry_of(marker: MarkerOffsets, data: bytes, order: str) -> Entry:
    """Return the fields of a marker that decide what it is."""
    numbers = struct.unpack_from(f'{order}3i', data, marker.number)
    return Entry(text_at(data, marker.ns), *numbers)


def shown_entries(entries: Sequence[Entry]) -> Sequence[int]:
    """Return the indices of the markers that a viewer shows after the whole array."""
    if all(entry.action < Marker.DELETE for entry in entries):
        return range(len(entries))
    # Backward, because a deletion applies only to the entries before it.
    rows: list[int] = []
    deleted: set[tuple[str, int]] = set()
    for k in reversed(range(len(entries))):
        entry = entries[k]
        if entry.action == Marker.DELETEALL:
            break
        if entry.action == Marker.DELETE:
            deleted.add((entry.ns, entry.number))
        elif (entry.ns, entry.number) not in deleted:
            rows.append(k)
    return rows[::-1]


def header_of(
    offsets: MessageOffsets, data: bytes, entries: Sequence[Entry], rows: Sequence[int]
) -> tuple[int, Items]:
    """
    Return where stamp and frame_id of an array are: the header of its first marker that is shown.

    Raises MessageError for an array without a stamp, or with markers in several frames.
    """
    markers = offsets.markers
    first = rows[0] if rows else 0
    if not rows and not (markers and _has_header(markers[0], data)):
        raise NoMarkersError(
            'MarkerArray without markers has no stamp; see that the driver sends nothing when it '
            'sees nothing, or markers with coordinates that are not finite'
        )
    # A marker without a frame is in the frame of the other markers.
    frame_ids = {text_at(data, markers[k].frame_id): k for k in reversed(rows)}
    frame_ids.pop('', None)
    if len(frame_ids) > 1:
        shown = ', '.join(repr(name)[:_SHOWN_CHARACTERS] for name in sorted(frame_ids)[:2])
        raise MessageError(
            f'MarkerArray has markers in {len(frame_ids)} frames, as {shown}: publish all of them '
            'in one, such as that of the ground'
        )
    # If only some entries are lists they may be a drawing, and the others are the markers.
    if rows and all(markers[k].points.number > 1 and entries[k].kind in LISTS for k in rows):
        raise MessageError(
            'MarkerArray has lists of points, and a marker of an array is but one point: send a '
            'list as a Marker, or each point as a marker of the array'
        )
    framed = next(iter(frame_ids.values()), first)
    return markers[first].stamp, markers[framed].frame_id


def _has_header(marker: MarkerOffsets, data: bytes) -> bool:
    """Whether stamp or frame of a marker are given."""
    return any(data[marker.stamp : marker.stamp + 8]) or bool(text_at(data, marker.frame_id))


def marker_names(keys: Sequence[tuple[str, int]], identity: str) -> tuple[str, ...]:
    """Return the identities of markers by ns and id; MessageError where one comes twice."""
    if identity == 'id':
        identities = tuple([str(number) for _, number in keys])
    elif identity == 'ns':
        identities = tuple([ns for ns, _ in keys])
    else:
        identities = tuple([f'{ns}/{number}' if ns else str(number) for ns, number in keys])
    check_unique(identities, 'MarkerArray', identity)
    return identities


def check_unique(identities: tuple[str, ...], kind: str, identity: str) -> None:
    """Raise MessageError for an identity that comes twice."""
    if len(set(identities)) < len(identities):
        name, times = Counter(identities).most_common(1)[0]
        raise MessageError(
            f"{kind} has the identity {name[:_SHOWN_CHARACTERS]!r} {times} times by '{identity}': "
            'set another marker_identity (index always works)'
        )


def names_at(markers: Sequence[MarkerOffsets], identity: str, order: str) -> Names:
    """Return what reads the identities of the markers of an array."""
    number_at = struct.Struct(f'{order}i').unpack_from

    def names(data: bytes) -> tuple[str, ...] | None:
        keys = []
        for _, _, (start, length), number, *_ in markers:
            ns, end, remainder = data[start : start + length].partition(b'\0')
            if not end or remainder or not ns.isascii():
                return None
            keys.append((ns.decode(), number_at(data, number)[0]))
        try:
            return marker_names(keys, identity)
        except MessageError:
            return None

    return names
