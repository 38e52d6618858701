"""Times without a body, or without any frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import Gaps


class Outage(NamedTuple):
    """Number of gaps of a window or more; begin and length, ns, of the latest and the longest."""

    times: int
    latest: tuple[int, int]
    longest: tuple[int, int]


def no_outages(bodies: int) -> np.ndarray:
    """Return the gaps (B + 1,) of bodies, and last of all frames, before there is any."""
    return np.zeros(bodies + 1, Gaps)


def note_gap(outages: np.ndarray, since: int, lasted: int) -> None:
    """Note a gap without any frame; C notes those of bodies."""
    gaps = outages[-1]
    gaps['times'] += 1
    gaps['latest_begin'], gaps['latest_length'] = since, lasted
    if lasted > gaps['longest_length']:
        gaps['longest_begin'], gaps['longest_length'] = since, lasted


def named_outages(outages: np.ndarray, bodies: Sequence[str]) -> dict[str, Outage]:
    """Return the gaps by body; '' for those without any frame."""
    rows = zip((*bodies, ''), outages.tolist(), strict=True)
    return {name: Outage(n, (a, b), (c, d)) for name, (n, a, b, c, d) in rows if n}
