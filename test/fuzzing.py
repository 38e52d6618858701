"""What the fuzzers share: damage to bytes, limits, and what damage is worth going on from."""

import random
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

Subject = TypeVar('Subject')

LONGEST = 5.0  # s
MOST_MEMORY = 512 * 2**20
# Of those that are damaged, the share that had got farther than others.
_FARTHER = 0.3
EXTREMES = (0, 1, 2**31 - 1, 2**32 - 1, 2**40, 2**63, 2**64 - 1)


def fuzz(
    count: int,
    generator: random.Random,
    place: Path,
    seeds: list[Subject],
    damage: Callable[[random.Random, Subject], Subject],
    ending: Callable[[Subject], str],
    reached: 'Reached | None' = None,
) -> Counter[str]:
    """
    Damage one of `seeds`, `count` times; returns how many ended in which way, as `ending` says.

    `ending` leaves in `place` what it was at. With `reached`, what got from one line to another as
    nothing did before is damaged further as well. Raises AssertionError where `ending` raises or
    takes over 5 s, or where over 512 MiB have been taken in all.
    """
    outcomes: Counter[str] = Counter()
    farther: list[Subject] = []
    before = _peak()
    for number in range(count):
        from_ = farther if farther and generator.random() < _FARTHER else seeds
        subject = damage(generator, generator.choice(from_))
        try:
            with _in_time(), reached.watching() if reached else nullcontext():
                outcomes[ending(subject)] += 1
        except BaseException as error:
            raise AssertionError(
                f'number {number}, left in {place}: {type(error).__name__}: {error}'
            ) from error
        grown = _peak() - before
        assert grown < MOST_MEMORY, f'number {number}, left in {place}: {grown} bytes'
        if reached and reached.farther():
            farther.append(subject)
    return outcomes


class TooLong(BaseException):
    """No Exception, which what is tested might catch."""


class Reached:
    """Which lines of the files in a folder were run, and which after which."""

    def __init__(self, folder: Path) -> None:
        self.steps: set[tuple[Any, ...]] = set()
        self._folder = str(folder)
        self._known = 0
        self._last: tuple[str, int] = ('', 0)

    @property
    def lines(self) -> int:
        """How many lines were run."""
        return len({step[1] for step in self.steps})

    def farther(self) -> bool:
        """Whether there are new steps since this was last asked."""
        known, self._known = self._known, len(self.steps)
        return self._known > known

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Note what is run within."""
        before = sys.gettrace()
        self._last = ('', 0)
        sys.settrace(self._enter)
        try:
            yield
        finally:
            sys.settrace(before)

    def _enter(self, frame: FrameType, event: str, arg: Any) -> Any:
        return self._step if frame.f_code.co_filename.startswith(self._folder) else None

    def _step(self, frame: FrameType, event: str, arg: Any) -> Any:
        if event == 'line':
            here = frame.f_code.co_filename, frame.f_lineno
            self.steps.add((self._last, here))
            self._last = here
        return self._step


def damaged(generator: random.Random, content: bytes) -> bytes:
    """With bits, numbers or a stretch of bytes changed, or with an end missing."""
    changed = bytearray(content)
    for _ in range(generator.choice((1, 1, 2, 5, 20))):
        if not changed:
            break
        at = generator.randrange(len(changed))
        way = generator.randrange(6)
        if way == 0:
            changed[at] ^= 1 << generator.randrange(8)
        elif way == 1:
            changed[at] = generator.randrange(256)
        elif way == 2:
            number = generator.choice(EXTREMES).to_bytes(8, 'little')
            size = generator.choice((2, 4, 8))
            changed[at : at + size] = number[:size]
        elif way == 3 and generator.random() < 0.5:
            del changed[at:]
        elif way == 4:
            other = generator.randrange(len(changed))
            changed[at : at + generator.randrange(60)] = changed[other : other + 30]
        elif way == 5:
            changed[at : at + 40] = bytes(len(changed[at : at + 40]))
    return bytes(changed)


def tell(what: str, count: int, fuzzer: Callable[..., Counter[str]]) -> None:
    """Run as many as the command line asks for, `count` unless told, and say how they ended."""
    words = [int(word) for word in sys.argv[1:]]
    count, seed = (words + [count, 0][len(words) :])[:2]
    start = time.monotonic()
    outcomes = fuzzer(count, seed)
    told = ', '.join(f'{name} {number}' for name, number in sorted(outcomes.items()))
    seconds, peak = time.monotonic() - start, _peak() / 2**20
    print(f'{count} {what} in {seconds:.0f} s: {told}; {peak:.0f} MiB at most')


def _peak() -> int:
    """Bytes of memory this process has had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@contextmanager
def _in_time() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLong(f'not done in {LONGEST:g} s')

    old = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)
