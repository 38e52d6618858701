"""
When poses are judged: how windows and degrees suit a body is looked at now and then, not each time.

By the numbers of the samples alone, so that it is the same for instants that come singly and many
at once.
"""

from typing import NamedTuple

import numpy as np

# Bodies are asked so many times while a judgment holds.
_ASKED = 6


class Plan(NamedTuple):
    """
    What is judged at M instants, when a judgment of all bodies holds for `every` instants.

    All bodies where `due` (M,), for the instants after and where `at_once` (M,) for the instant
    itself too; elsewhere those that refute what holds `since` (M,) so many instants, if asked.
    """

    due: np.ndarray
    at_once: np.ndarray
    since: np.ndarray
    every: int

    def part(self, chosen: slice) -> 'Plan':
        """That for some of the instants."""
        return Plan(self.due[chosen], self.at_once[chosen], self.since[chosen], self.every)

    def asked(self) -> np.ndarray:
        """At which instants (M,) bodies are asked."""
        return (self.since % _between(self.every) == 0) & ~self.due

    def ahead(self) -> np.ndarray:
        """For how many instants (M,) more what is judged anew is good, 0 where none is asked."""
        count = np.minimum(_between(self.every), self.every - self.since)
        # Up to those that are judged for themselves.
        index = np.arange(len(count))
        anew = np.append(self.at_once.nonzero()[0], len(count) + self.every)
        left = anew[anew.searchsorted(index, side='right')] - index - 1
        return np.where(self.asked(), np.minimum(count, left), 0)


def _between(every: int) -> int:
    """Instants from one at which bodies are asked to the next, where judgments hold for `every`."""
    return -(-every // _ASKED)


def planned(numbers: np.ndarray, before: int | None, every: int) -> Plan:
    """
    The plan for samples of `numbers` (M,), rising, when a judgment holds for `every` instants.

    There is one for the sample after that `before`; None if there is none.
    """
    last = np.concatenate(((-2 if before is None else before,), numbers[:-1]))
    at_once = numbers != last + 1
    since = numbers % every
    return Plan(at_once | (since == 0), at_once, since, every)
