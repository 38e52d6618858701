"""Guesses for Newton's method at any number of inputs at once, from the nodes of a path."""

from math import factorial, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._dead_points import Inputs, unit_input
from kinpole_ros.mechanism._loops import Linkage
from kinpole_ros.mechanism._path import LONGEST, MOST_NODES, Path
from kinpole_ros.mechanism._solution import solve
from kinpole_ros.planar._plane import Real

# Determinants above this are far from dead points.
_EASY = 0.05


class Table(NamedTuple):
    """
    Guesses for `solve`: nodes of a path so dense that one step of Newton's method is left.

    `inputs` (K,), `between` the nodes, and in `values` (orders, unknowns, K) the unknowns and their
    derivatives: three, or one where all loops are dyads, which need but a rough guess, and far from
    dead points. `period` and `winding` as in Path.
    """

    between: Real
    inputs: Real
    values: Real
    period: float
    winding: Real


def tabulate(linkage: Linkage, path: Path, inputs: Inputs = unit_input) -> Table:
    """A table for `initial_guess` over the whole path, its steps split into up to 16 parts."""
    parts = min(16, max(1, MOST_NODES // len(path.inputs)))
    share = np.arange(parts) / parts
    at = (path.inputs[:-1, None] + np.diff(path.inputs)[:, None] * share).ravel()
    # Each step is predicted from the node it was found from: next to a limit only that one reaches.
    near = np.arange(len(path.inputs) - 1)
    near = np.append(np.repeat(near + (near < path.start), parts), len(path.inputs) - 1)
    at = np.append(at, path.inputs[-1])
    step = at - path.inputs[near]
    guess = sum(path.values[k][:, near] * (step**k / factorial(k)) for k in range(5))
    found = solve(linkage, inputs(at), np.asarray(guess), 4)
    good, rows = found.regular, list(linkage.unknown)
    at, rates = at[good], np.abs(found.values[1:3][:, rows][:, :, good]).max(axis=1, initial=0.0)
    easy = all(block.dyad for block in linkage.blocks)
    easy &= bool((np.abs(found.determinant) > _EASY).all())
    # A series reaches as far as its terms fall, which next to a limit is as good as nowhere.
    gap = np.diff(at)
    with np.errstate(divide='ignore', invalid='ignore'):
        reach = np.nan_to_num(rates[0] / rates[1], nan=np.inf, posinf=np.inf)
        one, other = np.minimum(reach[:-1], gap), np.minimum(reach[1:], gap)
        share = np.nan_to_num(one / (one + other), nan=0.5)
    return Table(
        at[:-1] + share * gap,
        at,
        np.ascontiguousarray(found.values[: 2 if easy else 4, rows][:, :, good]),
        path.period,
        path.winding[rows],
    )


def initial_guess(table: Table, at: Real) -> Real:
    """The unknowns (w, T) near the inputs `at` (T,), by Taylor's series at the nearest node."""
    turns = None
    if table.period:
        turns = np.floor((at - table.inputs[0]) / table.period)
        at = at - turns * table.period
    node = np.searchsorted(table.between, at)
    # No farther than the nodes go: a value beyond a limit does not close, and is found out.
    step = np.clip(at - table.inputs[node], -LONGEST, LONGEST)
    found = table.values[-1].take(node, axis=1)
    for k in reversed(range(len(table.values) - 1)):
        found *= step * (1 / (k + 1))
        found += table.values[k].take(node, axis=1)
    if turns is not None and table.winding.any():
        found += 2 * pi * table.winding[:, None] * turns
    return found
