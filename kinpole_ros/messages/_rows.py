"""
Messages of one quantity, for all bodies or pairs: rows of doubles after a header.

A frame that comes alone, as in the node, is made for all of them at once: to make a row costs far
less than to call what makes it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import rows_of_bytes, stamped_doubles, stamped_head
from kinpole_ros.messages._loci import Build, Built
from kinpole_ros.tracking.estimate import Estimate

# An index of (T, B): some instants of one body, or some bodies at one instant.
At: TypeAlias = tuple[slice | np.ndarray, int] | tuple[int, slice | np.ndarray]
# Where a quantity is known, (T,) or (T, B), and what makes its doubles (N, n) where it is.
Found: TypeAlias = tuple[np.ndarray, Callable[[At], np.ndarray]]
# That of an estimate, of one body or of all.
Figures: TypeAlias = Callable[[Estimate, int | slice], Found]


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
        known, rows = figures(estimate, k)
        when = known.nonzero()[0]
        if not len(when):
            return [], []
        chosen = slice(None) if len(when) == len(known) else when
        about = estimate.stamp[chosen], estimate.frame_id, rows((chosen, k)), names[k], listed
        return when.tolist(), stamped_doubles(*about)

    def of_all(estimate: Estimate) -> list[Built]:
        known, rows = figures(estimate, slice(None))
        there = known[0].nonzero()[0]
        found: list[Built] = [([], [])] * count
        if len(there):
            doubles = rows((0, slice(None) if len(there) == count else there))
            head = int(estimate.stamp[0]), estimate.frame_id
            for k, row in zip(there.tolist(), rows_of_bytes(doubles), strict=True):
                found[k] = [0], [stamped_head(*head, names[k], listed) + row]
        return found

    def build(k: int, estimate: Estimate) -> Built:
        nonlocal taken, made
        if estimate is not taken:
            if len(estimate) > 1:
                return of_one(estimate, k)
            taken, made = estimate, of_all(estimate)
        return made[k]

    return [partial(build, k) for k in range(count)]


def both(count: int, figures: Callable[[bool], Figures]) -> tuple[list[Build], list[Build]]:
    """The same of a quantity, and of its standard deviation: those of False and True."""
    return each(count, figures(False)), each(count, figures(True))
