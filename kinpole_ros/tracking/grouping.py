"""
Markers that are listed for the wrong body.

Two markers that were exchanged in the parameters, or before the shape was learned, leave two bodies
that are not rigid. The distances between all markers show which exchange makes them rigid.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex
from kinpole_ros.tracking.thresholds import N_SIGMA

# Frames for the distances.
_FRAMES = 64


class Grouping(NamedTuple):
    """
    The exchange of markers that makes bodies rigid.

    `order` (B, n) is the slot, counted through all bodies, whose marker belongs in each slot; None
    if no marker is to be exchanged. `confused` are bodies that several exchanges make rigid.
    """

    order: np.ndarray | None
    confused: list[int]


def group(points: Complex, loose: np.ndarray) -> Grouping:
    """Find the exchange that makes `loose` (B,) bodies rigid, from their markers (T, B, n), m."""
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
    # The most constant distances are those within bodies; as many as the bodies have.
    rigid = varied <= N_SIGMA * np.median(np.sort(varied[i, j])[:within])
    bent = [b for b in np.flatnonzero(loose) if not rigid[np.ix_(body == b, body == b)].all()]
    mates = np.array([rigid[:, body == b].sum(axis=1) for b in range(bodies)])
    # The core of a body are its markers that are rigid with most of them.
    in_core = 2 * mates[body, np.arange(len(body))] > (body == body[:, None]).sum(axis=1)
    lost = [b for b in bent if not in_core[body == b].any()]
    others = {b: [c for c in bent if c != b] for b in lost}
    confused = [int(b) for b in lost if mates[others[b]][:, body == b].any(axis=0).all()]
    order = np.arange(bodies * width)
    homes = _homes(body, rigid, in_core, [b for b in bent if b not in lost])
    for b in homes:
        order[slots[(body == b) & ~in_core]] = slots[homes[b]]
    return Grouping(order.reshape(bodies, width) if homes else None, confused)


def _homes(
    body: np.ndarray, rigid: np.ndarray, in_core: np.ndarray, bent: list[int]
) -> dict[int, list[int]]:
    """
    Return the markers that belong in each body in place of those not in its core.

    Each has to be rigid with the core of just one other body, and each body needs as many as it
    lost; otherwise there are none.
    """
    homes: dict[int, list[int]] = {b: [] for b in bent}
    for x in np.flatnonzero(np.isin(body, bent) & ~in_core).tolist():
        fits = [b for b in bent if b != body[x] and rigid[x, (body == b) & in_core].all()]
        if len(fits) != 1:
            return {}
        homes[fits[0]].append(x)
    lacking = {b: np.count_nonzero((body == b) & ~in_core) for b in bent}
    return homes if all(len(homes[b]) == lacking[b] for b in bent) else {}
