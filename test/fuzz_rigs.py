"""
Rigs with several troubles at once, chosen at random: nothing may fail.

`PYTHONPATH=. python test/fuzz_rigs.py [COUNT [SEED]]` runs as many as you like, 100 unless told,
and says of which most figures are far off by their own deviations; the test suite runs a few.
"""

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench._cases import CASES, Case
from bench._outcome import FIGURES, run
from bench._rigs import record, rigs
from bench._spoil import combined

RATES = (60.0, 100.0, 120.0, 200.0, 240.0, 400.0)
SECONDS = 4.0
# How often each of the other troubles comes with those of the stamps, in an order that can be.
_SHARES = {'bodies': 0.2, 'markers': 0.5, 'frames': 0.3, 'plane': 0.4, 'names': 0.4}
# Levels of troubles that only show where it breaks, and units, which change more than the points.
_LEFT_OUT = ('10 ms', '30 ms', '50%', '70%', '60%', '90%', '5%', 'no scale', 'scale: 0.001')
# So many of their own deviations off, figures are far off.
FAR = 10.0


class Fuzzed(NamedTuple):
    """What was tried, and which share of the determined figures is far off."""

    what: str
    far: float


def fuzz_rigs(count: int, seed: int = 0) -> Iterator[Fuzzed]:
    """Try `count` rigs, from number `seed` on; AssertionError says what fails."""
    for number in range(seed, seed + count):
        rng = np.random.default_rng(number)
        rig, rate = str(rng.choice(list(rigs()))), float(rng.choice(RATES))
        cases = [_one_of('stamps', rng)]
        cases += [_one_of(part, rng) for part, share in _SHARES.items() if rng.random() < share]
        what = f'{number}: {rig} at {rate:g} Hz: ' + '; '.join(case.what for case in cases)
        r = record(rig, rate, SECONDS, cases[0].uneven)
        try:
            found = run(r, combined(*(case.spoil for case in cases))(r, rng))
        except Exception as error:
            raise AssertionError(what) from error
        squares = np.concatenate([found.square[name].ravel() for name in FIGURES])
        squares = squares[np.isfinite(squares)]
        yield Fuzzed(what, float(np.mean(squares > FAR**2)) if len(squares) else 0.0)


def _one_of(part: str, rng: np.random.Generator) -> Case:
    """One of the cases of that part."""
    known = [case for case in CASES if case.part == part and case.level not in _LEFT_OUT]
    return known[int(rng.integers(len(known)))]


if __name__ == '__main__':
    words = [int(word) for word in sys.argv[1:]]
    count, seed = (words + [100, 0][len(words) :])[:2]
    every = sorted(fuzz_rigs(count, seed), key=lambda one: -one.far)
    for one in every[:10]:
        print(f'{one.far:.2%} beyond {FAR:g} deviations: {one.what}')
