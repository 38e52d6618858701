"""Frames one by one and joined, and tracked."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker


def follow(points: np.ndarray, **values: Any) -> tuple[Tracker, list[Estimate]]:
    """Track frames (T, B, n) of markers, complex, of B bodies, 200 frames a second."""
    count, bodies, width = points.shape
    names = tuple(f'{b}_{k}' for b in range(bodies) for k in range(width))
    solid = np.zeros((count, bodies * width, 3))
    flat = points.reshape(count, -1)
    solid[..., 0], solid[..., 1] = flat.real, flat.imag
    solid[np.isnan(flat)] = np.nan
    markers = {f'body_{b}.markers': list(names[b * width : (b + 1) * width]) for b in range(bodies)}
    given = {'bodies': [f'body_{b}' for b in range(bodies)], 'lag': 0.0, **markers, **values}
    tracker = Tracker(settings_from(given))
    stamps = 10**9 + 5_000_000 * np.arange(count)
    return tracker, tracker.add(MarkerFrames(stamps, 'world', names, solid), 1)


def instants(found: list[Estimate]) -> list[Estimate]:
    """Every instant of some estimates as an estimate of its own."""
    return [one for estimate in found for one in estimate]


def one_frame(
    stamp: int, frame_id: str, identities: tuple[str, ...], points: np.ndarray
) -> MarkerFrames:
    """The frame of one instant, with points (n, 3)."""
    return MarkerFrames(np.array([stamp], np.int64), frame_id, identities, points[None])


def joined(frames: Sequence[MarkerFrames]) -> MarkerFrames:
    """Frames of the same markers as one: a tracker takes them far sooner than one by one."""
    stamps, points = (np.concatenate([frame[k] for frame in frames]) for k in (0, 3))
    return MarkerFrames(stamps, frames[0].frame_id, frames[0].identities, points)


def stretches(frames: Sequence[MarkerFrames]) -> Iterator[MarkerFrames]:
    """Frames, with those joined that follow each other and have the same markers."""
    for _, alike in groupby(frames, lambda frame: (frame.frame_id, frame.identities)):
        yield joined(list(alike))
