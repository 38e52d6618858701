"""
Corrupted files of trackers by the hundred: each is read, or refused in one line, soon, in 512 MiB.

`python test/fuzz_captures.py [COUNT [SEED]]` damages each layout so many times, 200 unless told;
the test suite does so a few times.
"""

import random
import tempfile
import warnings
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import test_formats
import test_import_bags
import test_layouts_of_trackers
from fuzzing import damaged, fuzz, tell

from kinpole_ros.bags import BagError, import_points

EXPORTS = Path(__file__).parents[2] / 'shared' / 'data' / 'exports'
# What the files do not say.
OPTIONS: dict[str, Any] = {'rate': 100.0, 'scale': 0.001}
# Marks that mean something in text, which damage to bytes seldom hits upon.
_MARKS = (b'', b',', b'\t', b'\n', b'"', b'-', b'1e999', b'nan', b'<', b'>', b'{', b']', b'\xff')


def captures(folder: Path) -> dict[str, bytes]:
    """A file of each layout, and those of `EXPORTS` where that is there."""
    found: dict[str, bytes] = {}
    for cases in (test_formats.CASES, test_layouts_of_trackers.CASES):
        for name, (_, make, *_) in cases.items():
            content = make()
            found[name] = content if isinstance(content, bytes) else content.encode()
    for kind, storage in test_import_bags.CASES:
        (place := folder / f'{kind} {storage}').mkdir()
        path = test_import_bags.write_bag(place, kind, storage)
        files = sorted(path.glob('bag.*')) or [path]
        found[f'{kind}, {storage}'] = files[0].read_bytes()
    frames = test_layouts_of_trackers.openpose(folder / 'openpose', people=2).iterdir()
    found['openpose'] = next(frames).read_bytes()
    for path in sorted(EXPORTS.rglob('*.*')):
        # Larger ones take seconds to write as bags.
        if path.suffix != '.md' and path.stat().st_size < 100_000:
            found[path.name] = path.read_bytes()
    return found


def fuzz_captures(count: int, seed: int = 0, folder: str | Path | None = None) -> Counter[str]:
    """
    Read `count` files of each layout with damage that follows from `seed`; how many were refused.

    Raises AssertionError where one takes too long or too much memory, or raises anything else than
    a BagError of one line.
    """
    place = Path(folder or tempfile.mkdtemp(prefix='fuzz_captures_'))
    generator = random.Random(seed)
    outcomes: Counter[str] = Counter()
    for name, content in captures(place).items():
        file = place / f'{name}.dat'
        end = partial(_ending, file, place / 'out.mcap')
        with warnings.catch_warnings():
            # numpy's, which would be seen on a terminal.
            warnings.simplefilter('error')
            try:
                outcomes += fuzz(count, generator, file, [content], _damaged, end)
            except AssertionError as error:
                raise AssertionError(f'{name}: {error}') from error
    return outcomes


def _damaged(generator: random.Random, content: bytes) -> bytes:
    if generator.random() < 0.5:
        return damaged(generator, content)
    changed = bytearray(content)
    for _ in range(generator.choice((1, 1, 3, 10))):
        at = generator.randrange(len(changed) + 1)
        changed[at : at + generator.randrange(30)] = generator.choice(_MARKS)
    return bytes(changed)


def _ending(file: Path, output: Path, content: bytes) -> str:
    file.write_bytes(content)
    try:
        import_points(file, output, **OPTIONS)
    except BagError as error:
        assert str(error).isprintable(), error
        assert 'fix: ' in str(error), error
        return 'refused'
    return 'read'


if __name__ == '__main__':
    tell('files of each layout', 200, fuzz_captures)
