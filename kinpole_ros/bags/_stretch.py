"""Stretches of a bag, which several processes replay at the same time."""

from itertools import pairwise

# Results before a stretch on which its messages depend: drawings show the centrodes of 2 s, and
# diagnostics describe the last estimate of 1 s.
_WARM_UP = 3_000_000_000  # ns
# Share of the time of a replay that goes into learning. Measured with bags of markers alone: 0.13
# where stamps jitter, 0.21 where they are even; up to 0.4 where no bag of results is written. The
# value between these only balances the work of processes.
_LEARNING_SHARE = 0.25


class Stretch:
    """
    A stretch of a bag, by which several processes replay one bag.

    What is learned, of shapes, noise, pins and the clock, depends on all frames before. So the
    process of a stretch also learns from these, which takes a fraction of the time. Its results are
    those of the whole bag, to the last bit.

    It begins at the seam of the share `first` of the bag's bytes, and ends at that of `last`.

    Attributes
    ----------
    is_estimated, is_written : bool
        Whether the frames of the last `update` are estimated, and their results written.
    is_over : bool
        Whether these frames are beyond the end.

    """

    def __init__(self, first: float = 0.0, last: float = 1.0) -> None:
        self.is_estimated = self.is_written = self.is_over = False
        self._first, self._last = _Seam(first), _Seam(last)

    def update(self, share: float, stamp: int) -> None:
        """Go on to frames from `stamp` on, ns, with which this share of the bag has been read."""
        self._first.update(share, stamp)
        self._last.update(share, stamp)
        self.is_estimated = self._first.warm_up_stamp is not None
        self.is_written, self.is_over = self._first.is_passed, self._last.is_passed


class _Seam:
    """
    The block of frames at which a stretch ends and the next one begins.

    The warm-up begins with the first block beyond a share of the bag's bytes; the seam is the first
    block after it. Blocks and shares depend only on the bag, so that the processes of both
    stretches find the same seam. The begin of a bag (0) has no warm-up, and its end (1) is no seam.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self.warm_up_stamp: int | None = None
        self.is_passed = False

    def update(self, share: float, stamp: int) -> None:
        if share < self._share or self._share >= 1:
            return
        if self.warm_up_stamp is None:
            self.warm_up_stamp = stamp
        # Stamps may also go back, where a clock was set.
        is_warm = self._share <= 0 or abs(stamp - self.warm_up_stamp) >= _WARM_UP
        self.is_passed = self.is_passed or is_warm


def equal_stretches(count: int) -> list[Stretch]:
    """
    Return stretches that take `count` processes, 1 or more, the same time.

    The stretch from a to b takes r a to learn, with r the learning share, and b - a for its own
    frames. With q = 1 - r that is b - q a, which is the same for all stretches if stretch k ends at
    (1 - q^k) / (1 - q^count).
    """
    q = 1 - _LEARNING_SHARE
    ends = [(1 - q**k) / (1 - q**count) for k in range(count + 1)]
    return [Stretch(first, last) for first, last in pairwise(ends)]
