"""
Which named markers move as one rigid body, when those named for a body do not.

Two markers that were exchanged in the parameters, or before the shape was learned, leave two bodies
that are not rigid. The distances between all markers say which exchange makes them so.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex
from kinpole_ros.tracking.thresholds import N_SIGMA

# Frames that are looked at.
_FRAMES = 64


class Grouping(NamedTuple):
    """
    `order` (B, n) says which slot, counted through all bodies, belongs in the place of which, None
    where nothing is to be exchanged; `confused` are bodies that several exchanges make rigid.
    """

    order: np.ndarray | None
    confused: list[int]


def group(points: Complex, loose: np.ndarray) -> Grouping:
    """Look for the exchange that makes `loose` (B,) bodies rigid, in `points` (T, B, n), m."""
    points = points[np.unique(np.linspace(0, len(points) - 1, _FRAMES).round().astype(int))]
    bodies, width = points.shape[1:]
    flat = points.reshape(len(points), -1)
    slots = np.flatnonzero((~np.isnan(flat)).mean(axis=0) > 0.7)
    body = slots // width
    distance = np.abs(flat[:, slots, None] - flat[:, None, slots])
    varied = np.sqrt(np.nanmean(np.square(distance - np.nanmean(distance, axis=0)), axis=0))
    i, j = np.triu_indices(len(slots), 1)
    within = int((body[i] == body[j]).sum())
    if not within:
        return Grouping(None, [])
    # Distances of one body, as the most constant ones: of those are about as many as of one body.
    rigid = varied <= N_SIGMA * np.median(np.sort(varied[i, j])[:within])
    members = [np.flatnonzero(body == b).tolist() for b in range(bodies)]
    bent = [b for b in np.flatnonzero(loose).tolist() if not _is_rigid(members[b], rigid)]
    exchanges = _exchanges(members, bent, rigid)
    times = [sum(b in pair for pair, _ in exchanges) for b in range(bodies)]
    confused = [b for b in range(bodies) if times[b] > 1]
    clear = [swap for (b, c), swap in exchanges if times[b] == times[c] == 1]
    order = np.arange(bodies * width)
    for x, y in clear:
        order[slots[[x, y]]] = slots[[y, x]]
    if not exchanges and (moved := _by_cores(members, bent, rigid)) is not None:
        for old, new in moved:
            order[slots[old]] = slots[new]
        clear = moved
    return Grouping(order.reshape(bodies, width) if clear else None, confused)


def _is_rigid(members: list[int], rigid: np.ndarray) -> bool:
    return bool(rigid[np.ix_(members, members)].all())


def _exchanges(
    members: list[list[int]], bent: list[int], rigid: np.ndarray
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Pairs of bodies with the markers of each that, exchanged, leave both rigid."""
    found = []
    for b, c in combinations(bent, 2):
        for x in members[b]:
            ones = [m for m in members[b] if m != x]
            for y in members[c]:
                others = [m for m in members[c] if m != y]
                fits = rigid[y, ones].all() and rigid[x, others].all()
                if fits and _is_rigid(ones, rigid) and _is_rigid(others, rigid):
                    found.append(((b, c), (x, y)))
    return found


def _by_cores(
    members: list[list[int]], bent: list[int], rigid: np.ndarray
) -> list[tuple[int, int]] | None:
    """
    Markers of bodies and those to take their places, where most of each body are rigid.

    Those that are not must each be rigid with just one other body that lacks some, and as many as
    it lacks; else None.
    """
    cores = {b: _core(members[b], rigid) for b in bent}
    strays = {b: [m for m in members[b] if m not in core] for b, core in cores.items() if core}
    homes: dict[int, list[int]] = {b: [] for b in strays}
    for b, some in strays.items():
        for x in some:
            fits = [c for c in strays if c != b and rigid[x, cores[c]].all()]
            if len(fits) != 1:
                return None
            homes[fits[0]].append(x)
    if not homes or any(len(homes[b]) != len(strays[b]) for b in strays):
        return None
    return [pair for b in strays for pair in zip(strays[b], homes[b], strict=True)]


def _core(members: list[int], rigid: np.ndarray) -> list[int]:
    """Most of the members that are rigid with one another; none where that is not clear."""
    for left in (len(members) - 1, len(members) - 2):
        if left < 2 or 2 * left <= len(members):
            return []
        whole = [list(some) for some in combinations(members, left) if _is_rigid([*some], rigid)]
        if whole:
            return whole[0] if len(whole) == 1 else []
    return []
