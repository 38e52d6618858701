"""
Markers that are listed for the wrong body.

Two markers that were exchanged in the parameters, or before the shape was learned, leave two bodies
that are not rigid. The distances between all markers show which exchange makes them rigid.
"""

from itertools import combinations
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
    members = [np.flatnonzero(body == b).tolist() for b in range(bodies)]
    bent = [b for b in np.flatnonzero(loose).tolist() if not _is_rigid(members[b], rigid)]
    exchanges = _exchanges(members, bent, rigid)
    times = [sum(b in pair for pair, _ in exchanges) for b in range(bodies)]
    confused = [b for b in range(bodies) if times[b] > 1]
    clear = [swap for (b, c), swap in exchanges if times[b] == times[c] == 1]
    order = np.arange(bodies * width)
    for x, y in clear:
        order[slots[[x, y]]] = slots[[y, x]]
    if not exchanges and (moved := _moves_to_cores(members, bent, rigid)) is not None:
        for old, new in moved:
            order[slots[old]] = slots[new]
        clear = moved
    return Grouping(order.reshape(bodies, width) if clear else None, confused)


def _is_rigid(members: list[int], rigid: np.ndarray) -> bool:
    return bool(rigid[np.ix_(members, members)].all())


def _exchanges(
    members: list[list[int]], bent: list[int], rigid: np.ndarray
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Pairs of bodies, each with the pair of markers whose exchange makes both rigid."""
    exchanges = []
    for b, c in combinations(bent, 2):
        for x in members[b]:
            of_b = [m for m in members[b] if m != x]
            for y in members[c]:
                of_c = [m for m in members[c] if m != y]
                fits = rigid[y, of_b].all() and rigid[x, of_c].all()
                if fits and _is_rigid(of_b, rigid) and _is_rigid(of_c, rigid):
                    exchanges.append(((b, c), (x, y)))
    return exchanges


def _moves_to_cores(
    members: list[list[int]], bent: list[int], rigid: np.ndarray
) -> list[tuple[int, int]] | None:
    """
    Pairs of markers, the second to take the slot of the first, if most of each body is rigid.

    Each stray marker has to be rigid with just one other body, and each body needs as many as it
    lost; otherwise None.
    """
    cores = {b: _core(members[b], rigid) for b in bent}
    strays = {b: [m for m in members[b] if m not in core] for b, core in cores.items() if core}
    homes: dict[int, list[int]] = {b: [] for b in strays}
    for b, markers in strays.items():
        for x in markers:
            fits = [c for c in strays if c != b and rigid[x, cores[c]].all()]
            if len(fits) != 1:
                return None
            homes[fits[0]].append(x)
    if not homes or any(len(homes[b]) != len(strays[b]) for b in strays):
        return None
    return [pair for b in strays for pair in zip(strays[b], homes[b], strict=True)]


def _core(members: list[int], rigid: np.ndarray) -> list[int]:
    """All but one or two of the members that are rigid; none if the choice is ambiguous."""
    for size in (len(members) - 1, len(members) - 2):
        if size < 2 or 2 * size <= len(members):
            return []
        cores = [list(part) for part in combinations(members, size) if _is_rigid([*part], rigid)]
        if cores:
            return cores[0] if len(cores) == 1 else []
    return []
