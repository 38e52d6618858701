"""Times without a body, or without any frame."""

from typing import NamedTuple


class Outage(NamedTuple):
    """How often nothing came for a window or more; the latest and the longest, from when, ns."""

    times: int
    latest: tuple[int, int]
    longest: tuple[int, int]


def one_more(outage: Outage | None, since: int, lasted: int) -> Outage:
    """The outages so far, if any, and one that `lasted` so long since then, ns."""
    new = since, lasted
    if outage is None:
        return Outage(1, new, new)
    longest = max(outage.longest, new, key=lambda each: each[1])
    return Outage(outage.times + 1, new, longest)
