"""
Bodies on /tf, assembled into frames: their poses at one stamp, in one fixed frame.

Some drivers send the bodies of a frame in several messages of one stamp. A body may be on another
that moves: then both are multiplied out, if they have one stamp.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._tf_chains import chains_of, multiply_out

_MOST_LINKS = 10_000  # frames whose parents are known; beyond, anyone may have made names up
_UNSEEN = np.full(7, np.nan)


class TransformFrame(NamedTuple):
    """Poses (7,) of bodies by name at a stamp, ns, in a fixed frame; NaN for what was not seen."""

    stamp: int
    frame_id: str
    poses: dict[str, np.ndarray]


class TransformFrames:
    """Assembles the transforms of the bodies called `names`."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._parents: dict[str, str] = {}
        self._static: dict[str, np.ndarray] = {}  # poses of frames that do not move
        self._chains: dict[str, tuple[str, ...]] = {}
        self.needed: set[str] = set(names)  # frames whose transforms count
        self.fixed = ''  # the frame of the first body that came
        self._stamp: int | None = None
        self._poses: dict[str, np.ndarray] = {}  # at this stamp
        # Whether a frame is complete with each message, though bodies are missing.
        self._is_single = len(self._names) == 1
        # Frames below bodies that came with other stamps, and how often.
        self.separate: Counter[tuple[str, str]] = Counter()

    def add_static(self, child: str, parent: str, pose: np.ndarray) -> None:
        """Add a frame that does not move in its parent."""
        self._static[child] = pose
        self.link({child: parent})

    def link(self, parents: Mapping[str, str]) -> None:
        """Note the parents of frames; the first one that a frame has counts."""
        new = {child: parent for child, parent in parents.items() if child not in self._parents}
        if not new or len(self._parents) + len(new) > _MOST_LINKS:
            return
        self._parents.update(new)
        self._chains = chains_of(self._names, self._parents, self._static)
        needed = {frame for chain in self._chains.values() for frame in chain[1:]}
        needed = (needed | set(self._names)) - self._static.keys()
        if needed != self.needed:
            self._is_single = len(needed) == 1
        self.needed = needed
        first = next((name for name in self._parents if name in self._chains), None)
        self.fixed = self._chains[first][0] if first is not None else ''

    def parent_fault(self, child: str, parent: str) -> str:
        """Return the frame besides `parent` that a frame is in, or that bodies are; '' if none."""
        known = self._parents.get(child, parent)
        chain = self._chains.get(child, (self.fixed,))
        return known if known != parent else self.fixed if chain[0] != self.fixed else ''

    def add(self, child: str, stamp: int, pose: np.ndarray) -> Iterator[TransformFrame]:
        """Add the pose of a needed frame; yield the frame of an earlier stamp."""
        if stamp != self._stamp or child in self._poses:
            yield from self._complete()
            self._stamp = stamp
        self._poses[child] = pose

    def end_message(self, children: set[str]) -> Iterator[TransformFrame]:
        """Yield the frame where no later message can add to it."""
        self._is_single = self._is_single or children >= self.needed
        if self._is_single or self._poses.keys() >= self.needed:
            yield from self._complete()

    def _complete(self) -> Iterator[TransformFrame]:
        known = {**self._static, **self._poses}
        poses = {name: self._pose(name, known) for name in self._names}
        if self._stamp is not None and not self._poses.keys().isdisjoint(self._names):
            yield TransformFrame(self._stamp, self.fixed, poses)
        elif any(np.isfinite(pose).all() for name, pose in poses.items() if name in self._static):
            # A body that is fixed to a moving frame has no transforms of its own.
            assert self._stamp is not None
            yield TransformFrame(self._stamp, self.fixed, poses)
        self._stamp, self._poses = None, {}

    def _pose(self, name: str, known: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the pose of a body in the fixed frame; NaN where its chain is not whole."""
        chain = self._chains.get(name, ())
        absent = [frame for frame in chain[1:] if frame not in known]
        if not chain or chain[0] != self.fixed or name in absent:
            return _UNSEEN
        if absent:
            self.separate[name, absent[-1]] += 1
            return _UNSEEN
        return multiply_out([known[frame] for frame in chain[1:]])
