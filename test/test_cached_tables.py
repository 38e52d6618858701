"""Tables in files: the same bits as if made anew, whatever is in the folder."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.derivatives import _cached_tables
from kinpole_ros.derivatives._cached_tables import cached_table
from kinpole_ros.derivatives._models import models_of, slopes_of, stencils_of

KIND = (12, 1, False, 0, 0.0)
FEW = np.arange(3), np.array([0.5, -np.inf])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the files, not made yet."""
    monkeypatch.setenv('KINPOLE_CACHE', str(tmp_path / 'tables'))
    yield tmp_path / 'tables'
    _cached_tables._maker.cache_clear()


class Maker:
    """Makes arrays, and counts how often."""

    def __init__(self, arrays: _cached_tables.Arrays = FEW) -> None:
        self.arrays, self.count = arrays, 0

    def __call__(self) -> _cached_tables.Arrays:
        self.count += 1
        return self.arrays


def check(kind: tuple[float, ...], maker: Maker, count: int) -> None:
    """The table of a kind has the bits of what the maker makes, which is asked `count` times."""
    before = maker.count
    for found, made in zip(cached_table(kind, maker), maker.arrays, strict=True):
        assert found.dtype == made.dtype
        assert found.tobytes() == made.tobytes()
    assert maker.count == before + count


@pytest.mark.parametrize(
    'arrays',
    [
        models_of(12, 1, False),
        models_of(13, 2, True),
        (np.empty(0, np.int64), slopes_of(12, 1, False)),
        (np.empty(0, np.int64), stencils_of(12, 1, False, 3, -0.3)),
    ],
    ids=['models', 'of exact samples', 'slopes', 'stencils'],
)
def test_a_table_of_a_file_has_the_same_bits(folder: Path, arrays: _cached_tables.Arrays) -> None:
    maker = Maker(arrays)
    check(KIND, maker, 1)
    check(KIND, maker, 0)


@pytest.mark.parametrize('kind', [(13, *KIND[1:]), (*KIND[:4], 1e-300), (*KIND[:3], -1, 0.0)])
def test_another_kind_has_a_file_of_its_own(folder: Path, kind: tuple[float, ...]) -> None:
    check(KIND, Maker(), 1)
    check(kind, Maker((np.arange(2), np.ones(3))), 1)
    check(KIND, Maker(), 0)


def test_whatever_happened_to_a_file_the_table_is_made_anew(folder: Path) -> None:
    check(KIND, Maker(), 1)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    changed = [bytes([*whole[:i], whole[i] ^ 1, *whole[i + 1 :]]) for i in range(0, len(whole), 5)]
    shorter = [whole[:length] for length in range(0, len(whole), 5)]
    for damaged in (*changed, *shorter, whole + bytes(8), bytes(len(whole))):
        path.write_bytes(damaged)
        check(KIND, Maker(), 1)
        assert path.read_bytes() == whole


@pytest.mark.parametrize('name', ['__version__', 'SIZES'])
def test_a_table_of_another_version_is_not_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    check(KIND, Maker(), 1)
    monkeypatch.setattr(_cached_tables, name, 'other')
    _cached_tables._maker.cache_clear()
    check(KIND, Maker(), 1)
    check(KIND, Maker(), 0)


def test_code_that_was_changed_makes_its_own_tables(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check(KIND, Maker(), 1)
    changed = tmp_path / 'changed.py'
    changed.write_text('_MAX_LENGTH = 2.0\n')
    monkeypatch.setattr(_cached_tables._models, '__file__', str(changed))
    _cached_tables._maker.cache_clear()
    check(KIND, Maker(), 1)
    changed.unlink()
    _cached_tables._maker.cache_clear()
    check(KIND, Maker(), 1)
    check(KIND, Maker(), 1)


def test_several_that_write_at_once_do_not_disturb_each_other(folder: Path) -> None:
    arrays = np.arange(1000), np.linspace(0, 1, 10_000)
    fit = []

    def use() -> None:
        for number in range(20):
            found = cached_table((number % 3, *KIND[1:]), lambda: arrays)
            fit.append(all(map(np.array_equal, found, arrays)))

    threads = [threading.Thread(target=use) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert fit == [True] * 80
    assert len([*folder.iterdir()]) == 3


def test_the_oldest_files_make_room_and_no_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_cached_tables, '_MAX_FILE_BYTES', 30_000)
    folder.mkdir()
    other = folder / 'other.txt'
    other.write_bytes(bytes(100_000))
    (folder / '00000000.table.1.1.part').write_bytes(bytes(10_000))
    maker = Maker((np.arange(3), np.ones(1_000)))
    for count in range(10):
        check((count, *KIND[1:]), maker, 1)
    files = [path for path in folder.iterdir() if path != other]
    assert other.exists()
    assert sum(path.stat().st_size for path in files) <= 30_000
    assert len(files) == 3
    check((9, *KIND[1:]), maker, 0)
    check((0, *KIND[1:]), maker, 1)


def test_where_no_file_can_be_written_tables_are_made(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.write_text('a file where the folder should be')
    check(KIND, Maker(), 1)
    check(KIND, Maker(), 1)
    folder.unlink()

    def full(path: Path, content: bytes) -> int:
        with open(path, 'wb') as file:
            file.write(content[:100])
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'write_bytes', full)
    check(KIND, Maker(), 1)
    check(KIND, Maker(), 1)
    assert not [*folder.iterdir()]


def test_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('KINPOLE_CACHE', '')
    check(KIND, Maker(), 1)
    check(KIND, Maker(), 1)
    monkeypatch.delenv('KINPOLE_CACHE')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    monkeypatch.setenv('USERPROFILE', str(tmp_path / 'home'))
    monkeypatch.setenv('XDG_CACHE_HOME', 'relative')
    assert _cached_tables._folder() == tmp_path / 'home' / '.cache' / 'kinpole_ros'
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert _cached_tables._folder() == tmp_path / 'kinpole_ros'
