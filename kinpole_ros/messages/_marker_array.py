"""The markers of a MarkerArray in its bytes: which are shown, and how they are called."""

import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from kinpole_ros.findings import Finding
from kinpole_ros.messages._offsets import Items, MarkerOffsets, MessageOffsets, text_at
from kinpole_ros.messages._types import Marker, MessageError, NoMarkersError

LISTS = (Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS)  # drawn at each of their points
SINGLE = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)  # drawn once, at their pose
# Drawings that stand at no marker, as they are called in a line.
_DRAWINGS = {
    Marker.ARROW: 'arrows',
    Marker.LINE_STRIP: 'line strips',
    Marker.LINE_LIST: 'line lists',
    Marker.TEXT_VIEW_FACING: 'texts',
    Marker.MESH_RESOURCE: 'meshes',
    Marker.TRIANGLE_LIST: 'triangle lists',
}
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


def drawn_points(
    markers: Sequence[MarkerOffsets], entries: Sequence[Entry], rows: Sequence[int]
) -> list[tuple[int, int | None]]:
    """
    Return the entry of each point, and its index in the list of that, None for a single one.

    Spheres, cubes and cylinders are points, and lists of them and of points have several. Arrows,
    lines, texts and meshes have none.
    """
    points: list[tuple[int, int | None]] = []
    for k in rows:
        if entries[k].kind in SINGLE:
            points.append((k, None))
        elif entries[k].kind in LISTS:
            points += [(k, index) for index in range(markers[k].points.number)]
    return points


def drawings_of(entries: Sequence[Entry], rows: Sequence[int]) -> Counter[str]:
    """Return how many of the entries that are shown are no markers, by their kind."""
    kinds = [entries[k].kind for k in rows if entries[k].kind not in (*SINGLE, *LISTS)]
    return Counter(_DRAWINGS.get(kind, f'of type {kind}') for kind in kinds)


def drawings_finding(drawings: Mapping[str, int]) -> Finding | None:
    """Return which drawings are left out, and how many of them a message has, if any."""
    listed = ', '.join(f'{count} {kind}' for kind, count in drawings.items())
    return Finding('drawings', values={'drawings': listed}) if listed else None


def header_of(
    offsets: MessageOffsets, data: bytes, rows: Sequence[int], shown: Sequence[int]
) -> tuple[int, Items]:
    """
    Return where stamp and frame_id of an array are: the header of the first of its markers `rows`.

    Without markers it is that of the first entry that is shown, or of the first. Raises
    MessageError for an array without a stamp, or with markers in several frames.
    """
    markers = offsets.markers
    first = [*rows[:1], *shown[:1], 0][0]
    if not rows and not (markers and _has_header(markers[first], data)):
        raise NoMarkersError(
            'MarkerArray without markers has no stamp; see that the driver sends nothing when it '
            'sees nothing, or markers with coordinates that are not finite'
        )
    # A marker without a frame is in the frame of the other markers.
    frame_ids = {text_at(data, markers[k].frame_id): k for k in reversed(rows)}
    frame_ids.pop('', None)
    if len(frame_ids) > 1:
        names = ', '.join(repr(name)[:_SHOWN_CHARACTERS] for name in sorted(frame_ids)[:2])
        raise MessageError(
            f'MarkerArray has markers in {len(frame_ids)} frames, as {names}: publish all of them '
            'in one, such as that of the ground'
        )
    framed = next(iter(frame_ids.values()), first)
    return markers[first].stamp, markers[framed].frame_id


def _has_header(marker: MarkerOffsets, data: bytes) -> bool:
    """Whether stamp or frame of a marker are given."""
    return any(data[marker.stamp : marker.stamp + 8]) or bool(text_at(data, marker.frame_id))


def marker_names(
    keys: Sequence[tuple[str, int]], points: Sequence[int | None], identity: str
) -> tuple[str, ...]:
    """
    Return the identities of points by ns and id of their entries, and their index in a list.

    Raises MessageError where one comes twice.
    """
    if identity == 'id':
        names = [str(number) for _, number in keys]
    elif identity == 'ns':
        names = [ns for ns, _ in keys]
    else:
        names = [f'{ns}/{number}' if ns else str(number) for ns, number in keys]
    identities = in_lists(names, points)
    check_unique(identities, 'MarkerArray', identity)
    return identities


def in_lists(names: Sequence[str], points: Sequence[int | None]) -> tuple[str, ...]:
    """Return names with the index of each point of a list behind that of the list."""
    return tuple(
        name if index is None else f'{name}/{index}'
        for name, index in zip(names, points, strict=True)
    )


def check_unique(identities: tuple[str, ...], kind: str, identity: str) -> None:
    """Raise MessageError for an identity that comes twice."""
    if len(set(identities)) < len(identities):
        name, times = Counter(identities).most_common(1)[0]
        raise MessageError(
            f"{kind} has the identity {name[:_SHOWN_CHARACTERS]!r} {times} times by '{identity}': "
            'set another marker_identity (index always works)'
        )


def names_at(
    markers: Sequence[MarkerOffsets], points: Sequence[int | None], identity: str, order: str
) -> Names:
    """Return what reads the identities of points, each of an entry and maybe in its list."""
    number_at = struct.Struct(f'{order}i').unpack_from

    def names(data: bytes) -> tuple[str, ...] | None:
        keys = []
        for _, _, (start, length), number, *_ in markers:
            ns, end, remainder = data[start : start + length].partition(b'\0')
            if not end or remainder or not ns.isascii():
                return None
            keys.append((ns.decode(), number_at(data, number)[0]))
        try:
            return marker_names(keys, points, identity)
        except MessageError:
            return None

    return names
