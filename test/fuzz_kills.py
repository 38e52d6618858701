"""
Commands killed at random moments and out of disk: results are those of before, or whole.

`python test/fuzz_kills.py [COUNT [SEED]]` stops each command so many times, 20 unless told; the
test suite does it a few times. Commands run in forks of this process, so that no moment is spent on
Python's start. What a kill leaves beside a result must be gone after the next run.
"""

import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from fuzzing import tell

from kinpole_ros.tools.cli import main

# With {0}, a folder of what is needed, and {1}, where results go.
COMMANDS = (
    'replay {0}/bag.mcap --output {1}/out.mcap --csv {1}/out.csv --parquet {1}/out.parquet',
    'simulate four_bar --duration 2 --rate 500 --output {1}/out.mcap',
    'import {0}/table.csv --output {1}/out.mcap',
    'plot {0}/result.mcap --output {1}/out.png',
    'solve four_bar --sweep --csv {1}/out.csv --plot {1}/out.png',
    'report {0}/result.mcap --output {1}/out.html',
    'discover {0}/bag.mcap --output {1}/out.yaml',
)
_BEFORE = b'before'
_LONGEST = 60  # s
_FORKED = multiprocessing.get_context('fork')


def fuzz_kills(
    count: int,
    seed: int = 0,
    folder: str | Path | None = None,
    commands: tuple[str, ...] = COMMANDS,
) -> Counter[str]:
    """
    Kill each command `count` times, end it by SIGTERM and fill its disk as often.

    Returns how many results were as before, and how many were whole. Raises AssertionError for any
    other, and for what is left beside them.
    """
    place = Path(folder or tempfile.mkdtemp(prefix='fuzz_kills_'))
    generator = random.Random(seed)
    make_inputs(place)
    outcomes: Counter[str] = Counter()
    for command in commands:
        out = place / 'out'
        out.mkdir()
        words = command.format(place, out).split()
        _quietly(words)  # what it imports is there in all forks from now on
        begun = time.monotonic()
        assert _stopped(words) == 0
        seconds = time.monotonic() - begun
        sound = {path.name: path.read_bytes() for path in out.iterdir()}
        largest = max(path.stat().st_size for path in out.iterdir())
        left: set[str] = set()
        for number in range(3 * count):
            for name in sound:
                (out / name).write_bytes(_BEFORE)
            # More often near the end, where results get their names.
            moment = seconds * (1.2 - 1.2 * generator.random() ** 2)
            if number % 3 == 0:
                status = _stopped(words, moment, signal.SIGKILL)
                assert status in (0, -signal.SIGKILL), (command, status)
            elif number % 3 == 1:
                status = _stopped(words, moment, signal.SIGTERM)
                assert status in (0, 128 + signal.SIGTERM, -signal.SIGTERM), (command, status)
            else:
                most = generator.randrange(largest)
                status = _stopped(words, most=most)
                assert status == 2, (command, most, status)
            for name, content in sound.items():
                found = (out / name).read_bytes()
                assert found in (_BEFORE, content), (command, name, moment, status)
                assert status != 0 or found == content, (command, name)
                outcomes['as before' if found == _BEFORE else 'whole'] += 1
            # One that is ended before it begins to write has not removed what a killed one left.
            before, left = left, {path.name for path in out.iterdir()} - set(sound)
            assert status == -signal.SIGKILL or left <= before, (command, left, status)
            assert status != 0 or not left, (command, left, status)
            assert all(name.endswith('.part') for name in left), (command, left)
            outcomes['left beside'] += len(left - before)
        assert _stopped(words) == 0
        assert {path.name: path.read_bytes() for path in out.iterdir()} == sound
        for name in sound:
            (out / name).unlink()
        out.rmdir()
    return outcomes


def make_inputs(place: Path) -> None:
    """A bag, its results and a table."""
    bag = str(place / 'bag.mcap')
    simulated = ['--duration', '2', '--rate', '200', '--noise', '1e-4', '--output', bag]
    assert _quietly(['simulate', 'four_bar', *simulated]) == 0
    assert _quietly(['replay', bag, '--output', str(place / 'result.mcap')]) == 0
    rows = (f'{k / 100},{k * 0.01},{k * 0.02}\n' for k in range(5000))
    (place / 'table.csv').write_text('t,a_x,a_y\n' + ''.join(rows))


def _stopped(
    words: list[str], moment: float | None = None, sign: int = 0, most: int | None = None
) -> int:
    """Run a command in a fork, with a signal at a moment, s, or little disk; how it ended."""
    process = _FORKED.Process(target=_run, args=(words, most))
    process.start()
    process.join(moment)
    if moment is not None and process.is_alive():
        os.kill(process.pid or 0, sign)
    process.join(_LONGEST)
    assert process.exitcode is not None, words
    return process.exitcode


def _run(words: list[str], most: int | None) -> None:
    if most is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    sys.exit(_quietly(words))


def _quietly(words: list[str]) -> int:
    with open(os.devnull, 'w') as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        return main(words)


if __name__ == '__main__':
    tell('kills of each command', 20, fuzz_kills)
