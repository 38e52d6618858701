"""Times without a body, or without any frame."""

from typing import NamedTuple


class Outage(NamedTuple):
    """Number of gaps of a window or more; begin and length, ns, of the latest and the longest."""

    times: int
    latest: tuple[int, int]
    longest: tuple[int, int]


def one_more(outage: Outage | None, since: int, lasted: int) -> Outage:
    """Add a gap, which began at `since` and `lasted` so long, ns."""
    new = since, lasted
    if outage is None:
        return Outage(1, new, new)
    longest = max(outage.longest, new, key=lambda gap: gap[1])
    return Outage(outage.times + 1, new, longest)
