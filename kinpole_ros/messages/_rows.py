"""
Messages of one quantity, for all bodies or pairs: rows of doubles after a header.

A frame that comes alone, as in the node, is made for all of them at once: to make a row costs far
less than to call what makes it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import doubles_at, stamped_doubles
from kinpole_ros.messages._loci import Build, Built
from kinpole_ros.pipeline.estimate import Estimate

# An index of (T, B): all instants of one body, or all bodies at one instant.
At: TypeAlias = tuple[slice, int] | tuple[int, slice]
# Which of these N are known (N,), and their doubles (N, n).
Rows: TypeAlias = tuple[np.ndarray, np.ndarray]
Figures: TypeAlias = Callable[[Estimate, At], Rows]


def each(
    count: int, figures: Figures, children: Sequence[str] | None = None, listed: bool = False
) -> list[Build]:
    """
    What makes the messages of a quantity, for each of `count` bodies or pairs.

    `children` are the second strings of messages that have one; `listed` as for `stamped_doubles`.
    """
    names: Sequence[str | None] = [None] * count if children is None else children
    taken: Estimate | None = None
    made: list[Built] = []

    def of_one(estimate: Estimate, k: int) -> Built:
        known, rows = figures(estimate, (slice(None), k))
        when = known.nonzero()[0]
        if not len(when):
            return [], []
        chosen = slice(None) if len(when) == len(known) else when
        about = estimate.stamp[chosen], estimate.frame_id, rows[chosen], names[k], listed
        return when.tolist(), stamped_doubles(*about)

    def of_all(estimate: Estimate) -> list[Built]:
        known, rows = figures(estimate, (0, slice(None)))
        data = doubles_at(int(estimate.stamp[0]), estimate.frame_id, rows, names, listed)
        there = zip(known.tolist(), data, strict=True)
        return [([0], [one]) if is_known else ([], []) for is_known, one in there]

    def build(k: int, estimate: Estimate) -> Built:
        nonlocal taken, made
        if estimate is taken:
            return made[k]
        # What is not known may be anything.
        with np.errstate(invalid='ignore', over='ignore'):
            if len(estimate) > 1:
                return of_one(estimate, k)
            taken, made = estimate, of_all(estimate)
        return made[k]

    return [partial(build, k) for k in range(count)]


def both(count: int, figures: Callable[[bool], Figures]) -> tuple[list[Build], list[Build]]:
    """The same of a quantity, and of its standard deviation: those of False and True."""
    return each(count, figures(False)), each(count, figures(True))
