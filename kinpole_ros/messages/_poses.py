"""
Poses of bodies that come as such: PoseStamped, PoseArray of one body each, and frames on /tf.

Read from their bytes, so that none of their classes need be there. A frame of all bodies may come
in several messages of one stamp, as /tf brings it from some drivers; then it is assembled here.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count, groupby
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._cloud import MessageError
from kinpole_ros.messages._markers import (
    END_OF_TIME,
    INPUT_TYPE_NAMES,
    MARKER_TYPES,
)
from kinpole_ros.messages._reader import MarkerReader
from kinpole_ros.messages._walk import Items, Walk
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.parameters import POSE_TYPES, Settings, check_poses

AUTO_TYPES = (*MARKER_TYPES, 'pose_stamped')
"""What is recognized by its type alone."""
# A quaternion may be as much longer or shorter than 1, as one of floats of 32 bits is.
_ROUNDED = 1e-3
# Names that are listed, and characters of each that are shown: it may be as long as the message.
_MOST_NAMES, _MOST_SHOWN = 12, 80
_SECOND = 1_000_000_000


def kind_of(type_name: str, wanted: str = 'auto') -> str | None:
    """The key of INPUT_TYPES for messages of this type, as `marker_type` has it; None if none."""
    kinds = AUTO_TYPES if wanted == 'auto' else (wanted,)
    return next((kind for kind in kinds if INPUT_TYPE_NAMES[kind] == type_name), None)


def reader_of(kind: str, settings: Settings) -> 'MarkerReader | PoseReader':
    """
    What reads messages of this kind, a key of INPUT_TYPES, of the bodies of these settings.

    Raises ParameterError where these do not go with the kind.
    """
    if kind not in POSE_TYPES:
        return MarkerReader(kind, settings.marker_identity)
    check_poses(settings, kind)
    return PoseReader(kind, [name for names in settings.bodies.values() for name in names])


class PoseReader:
    """
    Reads serialized messages of poses, those of the bodies called `names`, or of the only one.

    A body is called '0' in a PoseStamped, by its place in a PoseArray, and by its child_frame_id on
    /tf. There only transforms straight from one fixed frame count.
    """

    def __init__(self, kind: str, names: Sequence[str]) -> None:
        self._kind, self._names = kind, tuple(names)
        # What is being put together, and the fixed frame it is in.
        self._pending: _Poses | None = None
        self._parent = ''
        # Names that came, and others that no body has.
        self._met: set[str] = set()
        self._others: dict[str, None] = {}
        # Whether all bodies come in one message.
        self._partial = kind != 'tf' or len(self._names) == 1

    def read(self, messages: Iterable[bytes]) -> list[MarkerFrames | MessageError]:
        """Frames of serialized messages, in order, and errors where something is wrong."""
        return [part for part, _ in self.read_numbered(messages)]

    def lacking(self) -> str:
        """Which of the names no message had, in words, and what they had; '' if none is lacking."""
        absent = [name for name in self._names if name not in self._met]
        if not absent or not (self._met or self._others):
            return ''
        listed = ', '.join(map(_short, self._others)) or 'no others'
        what = 'frames' if self._kind == 'tf' else 'places'
        return (
            f'no pose came of {", ".join(map(_short, absent))}; {what} that came, and no body has: '
            f'{listed}; fix: name the one of each body, as <body>.markers'
        )

    def read_numbered(
        self, messages: Iterable[bytes]
    ) -> Iterator[tuple[MarkerFrames | MessageError, np.ndarray]]:
        """The same with the numbers (T,) of the messages that made the frames complete."""
        parts = chain.from_iterable(map(self._parts, count(), messages))
        for _, group in groupby(parts, _layout):
            some = list(group)
            poses = [part for part, _ in some if isinstance(part, _Poses)]
            if poses:
                yield _frames(poses), np.array([number for _, number in some])
            for part, number in some:
                if isinstance(part, MessageError):
                    yield part, np.array([number])

    def _parts(self, number: int, data: bytes) -> 'list[tuple[_Poses | MessageError, int]]':
        """What is complete with a message, and what is wrong in it."""
        found: list[_Poses | MessageError] = []
        try:
            walk = Walk(self._kind, data)
            if self._kind == 'tf':
                self._take_transforms(walk, data, found)
            else:
                found.append(self._poses(walk, data))
        except MessageError as error:
            found.append(error)
        faults = [part.fault(self._names) for part in found if isinstance(part, _Poses)]
        return [(part, number) for part in (*(f for f in faults if f is not None), *found)]

    def _poses(self, walk: Walk, data: bytes) -> '_Poses':
        """Those of a PoseStamped or PoseArray."""
        (place,) = walk.transforms
        size = place.poses.number
        if not self._names and size > 1:
            raise MessageError(
                f'PoseArray has {size} poses, and it is not known which is that of the body; fix: '
                "name its place, as <body>.markers: ['0']"
            )
        figures = np.frombuffer(data, f'{walk.order}f8', 7 * size, place.poses.start)
        named = dict(zip(map(str, range(size)), figures.reshape(-1, 7), strict=True))
        self._note_names(named)
        return _Poses(_stamp(data, place.stamp, walk.order), _text(data, place.frame_id), named)

    def _take_transforms(
        self, walk: Walk, data: bytes, found: 'list[_Poses | MessageError]'
    ) -> None:
        """Add a TFMessage to what is being assembled; what is complete then is `found`."""
        children = set()
        for place in walk.transforms:
            child = _text(data, place.child)
            self._note_names((child,))
            if child not in self._names:
                continue
            children.add(child)
            parent = _text(data, place.frame_id)
            if parent in self._names or parent != (self._parent or parent):
                others = f', and others in {_short(self._parent)}' if self._parent else ''
                found.append(
                    MessageError(
                        f'/tf has {_short(child)} in {_short(parent)}{others}: the frames of all '
                        'bodies must be straight in one fixed frame; fix: have the driver publish '
                        'them so, or name other frames'
                    )
                )
                continue
            self._parent = parent
            stamp = _stamp(data, place.stamp, walk.order)
            now = self._pending
            if now is None or stamp != now.stamp or child in now.poses:
                self._complete(found)
                now = self._pending = _Poses(stamp, parent, {})
            now.poses[child] = np.frombuffer(data, f'{walk.order}f8', 7, place.poses.start)
        self._partial |= children == set(self._names)
        if self._pending and (self._partial or len(self._pending.poses) == len(self._names)):
            self._complete(found)

    def _note_names(self, names: Iterable[str]) -> None:
        for name in names:
            if name in self._names:
                self._met.add(name)
            elif len(self._others) < _MOST_NAMES:
                self._others[name] = None

    def _complete(self, found: 'list[_Poses | MessageError]') -> None:
        """What was being assembled is complete, with those that were not seen."""
        if self._pending is not None:
            seen = self._pending.poses
            whole = {name: seen.get(name, _UNSEEN) for name in self._names}
            found.append(self._pending._replace(poses=whole))
        self._pending = None


class _Poses(NamedTuple):
    """Poses of one instant, ns, by name: x, y, z, and a quaternion x, y, z, w."""

    stamp: int
    frame_id: str
    poses: dict[str, np.ndarray]

    def fault(self, names: Sequence[str]) -> MessageError | None:
        """What is wrong with the quaternions of these bodies, or of all, if anything is."""
        for name, pose in self.poses.items():
            turn = pose[3:]
            if name in (names or self.poses) and np.isfinite(turn).all() and not _are_turns(turn):
                shown = ', '.join(f'{value:.4g}' for value in turn)
                return MessageError(
                    f'the orientation of pose {_short(name)} is [{shown}], and no quaternion of '
                    'length 1, so that pose is left out; fix: have the driver send one'
                )
        return None


_UNSEEN = np.full(7, np.nan)


def _layout(part: 'tuple[_Poses | MessageError, int]') -> tuple[str, tuple[str, ...]] | None:
    """What frames have in common that are made at once; None for an error."""
    poses, _ = part
    return None if isinstance(poses, MessageError) else (poses.frame_id, tuple(poses.poses))


def _frames(poses: Sequence[_Poses]) -> MarkerFrames:
    """Frames of one layout; poses that are not finite, or no poses, become NaN."""
    first, names = poses[0], tuple(poses[0].poses)
    rows = np.array([list(one.poses.values()) for one in poses], float)
    rows = rows.reshape(len(poses), len(names), 7)
    rows[~(np.isfinite(rows).all(axis=-1) & _are_turns(rows[..., 3:]))] = np.nan
    length = np.sqrt((rows[..., 3:] ** 2).sum(axis=-1))
    x, y, z, w = np.moveaxis(rows[..., 3:], -1, 0) / length
    axes = np.empty((*rows.shape[:2], 2, 3))
    axes[..., 0, :] = np.stack(
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)), axis=-1
    )
    axes[..., 1, :] = np.stack(
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)), axis=-1
    )
    stamps = np.array([one.stamp for one in poses])
    return MarkerFrames(stamps, first.frame_id, names, rows[..., :3].copy(), axes)


def _are_turns(quaternions: np.ndarray) -> np.ndarray:
    """Where quaternions (..., 4) have the length 1."""
    with np.errstate(over='ignore', invalid='ignore'):
        square = (quaternions**2).sum(axis=-1)
        return np.asarray(np.abs(square - 1) < 2 * _ROUNDED)


def _stamp(data: bytes, place: int, order: str) -> int:
    """Stamp, ns, of a header."""
    seconds, rest = struct.unpack_from(f'{order}iI', data, place)
    stamp = int(seconds * _SECOND + rest)
    if not 0 <= stamp < END_OF_TIME or rest >= _SECOND:
        raise MessageError(
            f'header.stamp is {seconds} s and {rest} ns; see that the driver sets it to the time '
            'of capture, counted from 1970 or from its start'
        )
    return stamp


def _text(data: bytes, place: Items) -> str:
    return data[place.start : place.start + place.number].rstrip(b'\0').decode(errors='replace')


def _short(name: str) -> str:
    return repr(name)[:_MOST_SHOWN]


def poses_data(
    kind: str, stamp: int, frame_id: str, names: Sequence[str], poses: np.ndarray
) -> bytes:
    """
    A message of poses (n, 7) of bodies: points, m, and quaternions x, y, z, w; `stamp` in ns.

    `kind` is one of POSE_TYPES; a PoseStamped has the first. What is not finite is not on /tf.
    """
    writer = Writer()
    if kind == 'tf':
        seen = np.flatnonzero(np.isfinite(poses).all(axis=1)).tolist()
        writer.pack('I', len(seen))
        for k in seen:
            writer.header(stamp, frame_id)
            writer.string(names[k])
            writer.doubles(poses[k])
        return bytes(writer.data)
    writer.header(stamp, frame_id)
    if kind == 'body_poses':
        writer.pack('I', len(poses))
    writer.doubles(poses[:1] if kind == 'pose_stamped' else poses)
    return bytes(writer.data)
