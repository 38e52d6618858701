"""
Which named markers move as one rigid body, when those named for a body do not.

Two markers that were exchanged in the parameters, or before the shape was learned, leave two bodies
that are not rigid. The distances between all markers say which exchange makes them so.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex

# A distance is that of one body if it varies by no more than so many times what those of the most
# constant ones do, and is not beyond doubt by more than so many.
_RIGID, _SURE = 3.0, 10.0
# Frames that are looked at.
_FRAMES = 64


class Grouping(NamedTuple):
    """
    `order` (B, n) says which slot, counted through all bodies, belongs in the place of which, None
    where nothing is to be exchanged; `confused` are bodies whose markers belong to others, but not
    clearly to which.
    """

    order: np.ndarray | None
    confused: list[int]


def group(points: Complex, loose: np.ndarray) -> Grouping:
    """Look for the exchange that makes `loose` (B,) bodies rigid, in `points` (T, B, n), m."""
    points = points[np.unique(np.linspace(0, len(points) - 1, _FRAMES).round().astype(int))]
    bodies, width = points.shape[1:]
    flat = points.reshape(len(points), -1)
    usual = (~np.isnan(flat)).mean(axis=0) > 0.7
    slots = np.flatnonzero(usual)
    body = slots // width
    apart = np.abs(flat[:, slots, None] - flat[:, None, slots])
    with np.errstate(invalid='ignore'):
        varied = np.sqrt(np.nanmean(np.square(apart - np.nanmean(apart, axis=0)), axis=0))
    i, j = np.triu_indices(len(slots), 1)
    within = int((body[i] == body[j]).sum())
    if not within:
        return Grouping(None, [])
    usually = np.median(np.sort(varied[i, j])[:within])
    rigid = varied <= _RIGID * usually
    members = [np.flatnonzero(body == b).tolist() for b in range(bodies)]
    cores = [_core(some, rigid) if loose[b] else some for b, some in enumerate(members)]
    strays = [
        sorted(set(some) - set(core or [])) for some, core in zip(members, cores, strict=True)
    ]
    confused = _confused(members, strays, loose, varied, usually)
    homes: dict[int, list[int]] = {b: [] for b in range(bodies)}
    for b in np.flatnonzero(loose).tolist():
        for x in strays[b]:
            fits = [
                c
                for c in np.flatnonzero(loose).tolist()
                if c != b and strays[c] and cores[c] and all(rigid[x, y] for y in cores[c] or [])
            ]
            if len(fits) != 1:
                return Grouping(None, confused)
            homes[fits[0]].append(x)
    if not any(homes.values()) or any(len(homes[b]) != len(strays[b]) for b in homes):
        return Grouping(None, confused)
    order = np.arange(bodies * width)
    for b, new in homes.items():
        order[slots[strays[b]]] = slots[new]
    return Grouping(order.reshape(bodies, width), [])


def _core(members: list[int], rigid: np.ndarray) -> list[int] | None:
    """Most of the members that are rigid with one another; None where that is not clear."""
    for leave in range(len(members)):
        left = len(members) - leave
        if left < 2 or 2 * left <= len(members) or leave > 2:
            return None
        whole = [
            some
            for some in combinations(members, left)
            if all(rigid[x, y] for x, y in combinations(some, 2))
        ]
        if whole:
            return list(whole[0]) if len(whole) == 1 else None
    return None


def _confused(
    members: list[list[int]],
    strays: list[list[int]],
    loose: np.ndarray,
    varied: np.ndarray,
    usually: float,
) -> list[int]:
    """Loose bodies with a marker that is rigid with one of another loose body, and not its own."""
    found = []
    for b in np.flatnonzero(loose).tolist():
        for x in strays[b]:
            own = [y for y in members[b] if y != x]
            others = [y for c in np.flatnonzero(loose) if c != b for y in members[c]]
            if (
                own
                and others
                and varied[x, own].min() > _SURE * usually
                and varied[x, others].min() <= _RIGID * usually
            ):
                found.append(b)
                break
    return found if len(found) > 1 else []
