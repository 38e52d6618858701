"""
Poses of bodies as input, and markers in the types of trackers.

They are PoseStamped, a PoseArray with a pose for each body, frames on /tf, and the types of which
MESSAGE_TYPES has the fields. They are read from their bytes, so that their packages need not be
installed. Some drivers send the bodies of one frame on /tf in several messages of one stamp; these
are assembled here.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain, count, groupby
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._offsets import MessageOffsets, stamp_at, text_at
from kinpole_ros.messages._points import blank_unseen, rotation_matrices
from kinpole_ros.messages._reader import MarkerReader
from kinpole_ros.messages._tf_frames import TransformFrames
from kinpole_ros.messages._types import (
    END_OF_TIME,
    INPUT_TYPE_NAMES,
    SECOND,
    MessageError,
)
from kinpole_ros.settings import (
    MESSAGE_TYPES,
    POSE_TYPES,
    ParameterError,
    Settings,
    check_poses,
)
from kinpole_ros.tracking.frame import MarkerFrames

AUTO_TYPES = tuple(kind for kind, row in MESSAGE_TYPES.items() if row.is_recognized)
"""The input types that are recognized by the type of the messages alone."""
_LENGTH_TOLERANCE = 1e-3  # of a quaternion: generous for one of 32-bit floats
_LISTED_NAMES, _SHOWN_CHARACTERS = 12, 80  # in messages: there may be any number, of any length
_UNSEEN = np.full(7, np.nan)
_NUMBER_FORMS: dict[Any, str] = {'uint16': 'H', 'int32': 'i', 'uint32': 'I'}
_NUMBER_IS_MEANT = 1  # `id_type` of mocap4r2_msgs/msg/Marker


def kind_of(type_name: str, marker_type: str = 'auto') -> str | None:
    """
    Return the input type, a key of `MESSAGE_TYPES`, of messages of a type of this name.

    None where they are not read with this parameter `marker_type`.
    """
    kinds = AUTO_TYPES if marker_type == 'auto' else (marker_type,)
    return next((kind for kind in kinds if INPUT_TYPE_NAMES[kind] == type_name), None)


def reader_of(kind: str, settings: Settings) -> 'MarkerReader | PoseReader':
    """
    Return the reader of messages of an input type, a key of `MESSAGE_TYPES`.

    Raises ParameterError where the settings do not go with the type.
    """
    if kind not in POSE_TYPES:
        return marker_reader(kind, settings.marker_identity)
    check_poses(settings, kind)
    return PoseReader(kind, [name for names in settings.bodies.values() for name in names])


def marker_reader(kind: str, identity: str) -> 'MarkerReader | PoseReader':
    """
    Return the reader of messages of markers by the parameter `marker_identity`.

    `kind` is a key of `MESSAGE_TYPES` without poses. Raises ParameterError where it has no such
    identities.
    """
    if not MESSAGE_TYPES[kind].item:
        return MarkerReader(kind, identity)
    if identity not in ('auto', 'index', 'shape'):
        raise ParameterError(
            f'parameter marker_identity is {identity}, and a marker of {INPUT_TYPE_NAMES[kind]} '
            'has its name or number, and its index: set it to auto or index'
        )
    return PoseReader(kind, (), has_names=identity == 'auto')


class PoseReader:
    """
    Reads serialized messages of poses of the bodies called `names`, or of the only body.

    A body is called '0' in a PoseStamped, by its index in a PoseArray, and by its child_frame_id on
    /tf, where a chain of frames is multiplied out. Types of which MESSAGE_TYPES has the fields name
    their bodies, or their markers, which are all read; without `has_names` the index is the name.
    """

    def __init__(self, kind: str, names: Sequence[str], has_names: bool = True) -> None:
        self._kind, self._names = kind, tuple(names)
        self._has_names = has_names
        self._width = 7 if MESSAGE_TYPES[kind].has_poses else 3
        self._transforms = TransformFrames(self._names)
        # Names in the messages: of bodies, and of no body.
        self._seen_names: set[str] = set()
        self._stamps_of: dict[str, _Stamps] = {}  # of the bodies on /tf
        self._unused_names: dict[str, None] = {}

    def read(self, messages: Iterable[bytes]) -> list[MarkerFrames | MessageError]:
        """Read serialized messages: their frames in order, and errors."""
        return [result for result, _ in self.read_numbered(messages)]

    def fault(self) -> Finding | None:
        """Return which of the names no message had, or which were stamped too late, if any."""
        return self._unseen_names() or self._late_names() or self._stamps_apart()

    def _stamps_apart(self) -> Finding | None:
        """Return which body is on a frame that moves and came with other stamps."""
        for (name, below), times in self._transforms.separate.most_common(1):
            # The first time the frames below may not be known yet.
            if times > 1:
                about = {'name': _shown(name), 'below': _shown(below), 'count': times}
                return Finding('stamped_apart', '', about, ERROR)
        return None

    def _late_names(self) -> Finding | None:
        """Return which body on /tf always came with older stamps than another one before it."""
        for name, own in self._stamps_of.items():
            others = {k: one for k, one in self._stamps_of.items() if k != name}
            if others and 0 < own.least_late < END_OF_TIME:
                other, newest = max(others.items(), key=lambda pair: pair[1].last)
                seconds = own.least_late / SECOND
                about = {'name': _shown(name), 'other': _shown(other), 'seconds': seconds}
                code = 'two_clocks' if own.last < newest.first else 'stamped_earlier'
                return Finding(code, '', about, ERROR)
        return None

    def _unseen_names(self) -> Finding | None:
        unseen = [name for name in self._names if name not in self._seen_names]
        if not unseen or not (self._seen_names or self._unused_names):
            return None
        is_list = bool(MESSAGE_TYPES[self._kind].item)
        about = {
            'names': ', '.join(map(_shown, unseen)),
            'noun': 'frames' if self._kind == 'tf' else 'names' if is_list else 'places',
            'others': ', '.join(map(_shown, self._unused_names)) or 'no others',
        }
        return Finding('unseen_names', '', about, ERROR)

    def read_numbered(
        self, messages: Iterable[bytes]
    ) -> Iterator[tuple[MarkerFrames | MessageError, np.ndarray]]:
        """Yield the results of `read`, each with the numbers (T,) of the completing messages."""
        results = chain.from_iterable(map(self._read_one, count(), messages))
        for _, group in groupby(results, _layout):
            same_layout = list(group)
            poses = [result for result, _ in same_layout if isinstance(result, _Poses)]
            if poses:
                yield _frames(poses, self._width), np.array([number for _, number in same_layout])
            for result, number in same_layout:
                if isinstance(result, MessageError):
                    yield result, np.array([number])

    def _read_one(self, number: int, data: bytes) -> 'list[_Result]':
        """Return the frames that this message completes, and the errors in it, errors first."""
        results: list[_Poses | MessageError] = []
        try:
            offsets = MessageOffsets(self._kind, data)
            if self._kind == 'tf':
                self._read_transforms(offsets, data, results)
            else:
                results.append(self._whole_frame(offsets, data))
        except MessageError as error:
            results.append(error)
        faults: list[MessageError | None] = []
        if self._width == len(_UNSEEN):
            faults += [one.fault(self._names) for one in results if isinstance(one, _Poses)]
        return [(one, number) for one in (*faults, *results) if one is not None]

    def _whole_frame(self, offsets: MessageOffsets, data: bytes) -> '_Poses':
        """Read a message that is a frame: a PoseStamped, a PoseArray, or a list of a tracker."""
        if self._kind in ('pose_stamped', 'body_poses'):
            (found,) = offsets.poses
            stamp, frame_id, (start, size) = found.stamp, found.frame_id, found.poses
            starts = [start + 8 * len(_UNSEEN) * k for k in range(size)]
            names = list(map(str, range(size)))
        else:
            stamp, frame_id = offsets.stamp, offsets.frame_id
            field = 'pose' if self._width == len(_UNSEEN) else 'point'
            starts = [one[field] for one in offsets.entries]
            names = [self._name(k, one, data) for k, one in enumerate(offsets.entries)]
        if self._width == len(_UNSEEN) and not self._names and len(starts) > 1:
            raise MessageError(
                f'{INPUT_TYPE_NAMES[self._kind].rpartition("/")[2]} has {len(starts)} poses, and '
                'it is not known which is that of the body; fix: name it, as <body>.markers: '
                f'[{names[0]!r}]'
            )
        kind, count = f'{offsets.order}f8', self._width
        named = {
            name: np.frombuffer(data, kind, count, start)
            for name, start in zip(names, starts, strict=True)
        }
        if len(named) < len(names):
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise MessageError(
                f'{INPUT_TYPE_NAMES[self._kind]} has {_shown(twice)} several times; see that the '
                'driver gives each its own name'
            )
        if self._width == len(_UNSEEN):
            self._note_names(named)
        return _Poses(stamp_at(data, stamp, offsets.order), text_at(data, frame_id), named)

    def _name(self, index: int, entry: Mapping[str, Any], data: bytes) -> str:
        """Return the name in the message of a marker or body, else its number, else its index."""
        if not self._has_names:
            return str(index)
        is_numbered = 'id_type' in entry and data[entry['id_type']] == _NUMBER_IS_MEANT
        has_name = 'name' in entry and not is_numbered
        name = text_at(data, entry['name']) if has_name else ''
        if name or 'number' not in entry:
            return name or str(index)
        form = _NUMBER_FORMS[dict(MESSAGE_TYPES[self._kind].item)['number']]
        order = '<' if data[1] else '>'
        return str(struct.unpack_from(order + form, data, entry['number'])[0])

    def _read_transforms(
        self, offsets: MessageOffsets, data: bytes, results: 'list[_Poses | MessageError]'
    ) -> None:
        """Append the frames that transforms of /tf complete, and the errors of others."""
        frames = self._transforms
        links = [(text_at(data, one.child), text_at(data, one.frame_id)) for one in offsets.poses]
        self._note_names(child for child, _ in links)
        frames.link(dict(links))
        for (child, parent), transform in zip(links, offsets.poses, strict=True):
            if child not in frames.needed:
                continue
            if other := frames.parent_fault(child, parent):
                results.append(
                    MessageError(
                        f'/tf has {_shown(child)} in {_shown(parent)}, and others in '
                        f'{_shown(other)}: the frames of all bodies must lead to one fixed frame; '
                        'fix: have the driver publish them so, or name other frames'
                    )
                )
                continue
            stamp = stamp_at(data, transform.stamp, offsets.order)
            if child in self._names:
                self._note_stamp(child, stamp)
            pose = np.frombuffer(data, f'{offsets.order}f8', 7, transform.poses.start)
            results += (_Poses(*one) for one in frames.add(child, stamp, pose))
        children = {child for child, _ in links}
        results += (_Poses(*one) for one in frames.end_message(children))

    def add_static(self, data: bytes) -> None:
        """Read a message of /tf_static: frames that do not move in their parents."""
        with suppress(MessageError):
            offsets = MessageOffsets('tf', data)
            for one in offsets.poses:
                pose = np.frombuffer(data, f'{offsets.order}f8', 7, one.poses.start)
                child = text_at(data, one.child)
                self._note_names((child,))
                self._transforms.add_static(child, text_at(data, one.frame_id), pose)

    def _note_names(self, names: Iterable[str]) -> None:
        for name in names:
            if name in self._names:
                self._seen_names.add(name)
            elif len(self._unused_names) < _LISTED_NAMES:
                self._unused_names[name] = None

    def _note_stamp(self, name: str, stamp: int) -> None:
        """Note how far a body is behind the newest stamp of the others."""
        newest = max((one.last for k, one in self._stamps_of.items() if k != name), default=None)
        late = 0 if newest is None else newest - stamp
        own = self._stamps_of.get(name)
        if own is None:
            # The first body has none before it, and may yet be late.
            self._stamps_of[name] = _Stamps(stamp, stamp, END_OF_TIME if newest is None else late)
        else:
            self._stamps_of[name] = _Stamps(
                own.first, max(own.last, stamp), min(own.least_late, late)
            )


class _Stamps(NamedTuple):
    """Of a body: first and newest stamp, and how far it was behind those of others at least, ns."""

    first: int
    last: int
    least_late: int


class _Poses(NamedTuple):
    """Poses of one instant, ns, by name: x, y, z, and a quaternion x, y, z, w; or markers."""

    stamp: int
    frame_id: str
    poses: dict[str, np.ndarray]

    def fault(self, names: Sequence[str]) -> MessageError | None:
        """Return the error of a quaternion of these bodies, or of all without names, if any."""
        for name, pose in self.poses.items():
            quaternion = pose[3:]
            if name not in (names or self.poses) or not np.isfinite(quaternion).all():
                continue
            if not _have_length_1(quaternion):
                shown = ', '.join(f'{value:.4g}' for value in quaternion)
                return MessageError(
                    f'the orientation of pose {_shown(name)} is [{shown}], and no quaternion of '
                    'length 1, so that pose is left out; fix: have the driver send one'
                )
        return None


_Result: TypeAlias = tuple[_Poses | MessageError, int]


def _layout(result: _Result) -> tuple[str, tuple[str, ...]] | None:
    """Return frame and names of poses, which become one array if equal; None for an error."""
    poses, _ = result
    return None if isinstance(poses, MessageError) else (poses.frame_id, tuple(poses.poses))


def _frames(poses: Sequence[_Poses], width: int) -> MarkerFrames:
    """Make frames of poses of one layout; one that is not finite, or no pose, becomes NaN."""
    first, names = poses[0], tuple(poses[0].poses)
    stamps = np.array([one.stamp for one in poses])
    rows = np.array([list(one.poses.values()) for one in poses], float)
    rows = rows.reshape(len(poses), len(names), width)
    if width < len(_UNSEEN):
        blank_unseen(rows)
        return MarkerFrames(stamps, first.frame_id, names, rows)
    rows[~(np.isfinite(rows).all(axis=-1) & _have_length_1(rows[..., 3:]))] = np.nan
    length = np.sqrt((rows[..., 3:] ** 2).sum(axis=-1))
    rotations = rotation_matrices(rows[..., 3:] / length[..., None])
    axes = np.ascontiguousarray(rotations.swapaxes(-1, -2)[..., :2, :])
    return MarkerFrames(stamps, first.frame_id, names, rows[..., :3].copy(), axes)


def _have_length_1(quaternions: np.ndarray) -> np.ndarray:
    with np.errstate(over='ignore', invalid='ignore'):
        square = (quaternions**2).sum(axis=-1)
        return np.asarray(np.abs(square - 1) < 2 * _LENGTH_TOLERANCE)


def _shown(name: str) -> str:
    return repr(name)[:_SHOWN_CHARACTERS]


def poses_data(
    kind: str, stamp: int, frame_id: str, names: Sequence[str], poses: np.ndarray
) -> bytes:
    """
    Write a message of poses of n bodies, with a stamp in ns.

    `kind` is pose_stamped, of the first pose alone, body_poses or tf, where `names` are the child
    frames. `poses` (n, 7) are x, y, z, m, and quaternions x, y, z, w. One that is not finite is
    not on /tf.
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
