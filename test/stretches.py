"""Frames one by one and joined, and through the learned shapes and noise as the tracker does it."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from kinpole_ros.pipeline.estimate import Estimate
from kinpole_ros.pipeline.frame import MarkerFrames
from kinpole_ros.planar import Fit
from kinpole_ros.rigid import Noise, Shapes


def fit_frames(
    points: np.ndarray, shapes: Shapes, noise: Noise | None = None
) -> Iterator[tuple[Fit, np.ndarray]]:
    """Fits (B,) of frames (T, B, n) and the markers they are of, as each frame is taken."""
    news: list[tuple[np.ndarray, ...]] = []
    least = np.zeros(points.shape[1])
    for k, row in enumerate(points[:, None]):
        if not shapes.unseen(row):
            shapes.begin(row[0])
        fit, mended, _ = shapes.fit(row, np.array([5_000_000 * k]), least)
        news.append((fit.residual, fit.freedom, np.ones(1, bool)))
        if len(news) >= shapes.beat:
            if noise is not None:
                noise.add(*map(np.concatenate, zip(*news, strict=True)))
            shapes.learn()
            news = []
        yield Fit(*(field[0] for field in fit)), mended[0]


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
