"""The folder or store of the results of a batch, in subfolders for very many bags."""

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

from kinpole_ros.bags._files import in_place_of, write_errors
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._jobs import Job, Row, finished, result_name
from kinpole_ros.files import as_cell
from kinpole_ros.settings import Settings

# Results of more bags lie in 256 subfolders.
_MOST_IN_FOLDER = 10_000
_FIRST = ('bag', 'error', 'truncated', 'results', 'frames', 'estimates', 'start', 'end', 'seconds')


def absolute(bag: str | Path) -> str:
    """Return the one name of a bag: its whole path, or its URL."""
    return str(bag) if _store.is_url(bag) else os.path.abspath(_store.on_disk(bag))


class ResultFolder:
    """A folder of results, or a store by its URL."""

    def __init__(self, output: str | Path) -> None:
        self.root: Path | str = (
            str(output).rstrip('/')
            if _store.is_url(output)
            else Path(os.path.abspath(_store.on_disk(output)))
        )
        self._is_sharded = False
        # Read at once: to ask a store for each bag takes long.
        self._stored: _store.Content | None = None

    def prepare(self, bags: int) -> None:
        """Make the folder for so many bags. Raises BagError when it cannot be written."""
        self._is_sharded = bags > _MOST_IN_FOLDER
        if isinstance(self.root, str):
            self._stored = _store.content(self.root)
            return
        with write_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            TemporaryFile(dir=self.root).close()

    def job(self, bag: str, settings: Settings, kinds: Sequence[str]) -> Job:
        """Return the job of a bag, whose results stay in the subfolder where they are."""
        name = result_name(bag)
        shard = name[-10:-8]
        shard, other_shard = (shard, '') if self._is_sharded else ('', shard)
        if self._exists(other_shard, name) and not self._exists(shard, name):
            shard = other_shard
        return Job(bag, self.root, settings, kinds, shard)

    def _exists(self, shard: str, name: str) -> bool:
        if self._stored is not None:
            return f'{shard}/{name}'.lstrip('/') in self._stored.records
        return (Path(self.root) / shard / f'{name}.json').exists()

    def finished(self, job: Job) -> Row | None:
        """Return the row of a bag whose results exist."""
        row = finished(job, self._stored)
        return row and row_in_folder(job, row)

    def write_summary(self, rows: list[Row]) -> None:
        """Write summary.csv, the table over all."""
        if isinstance(self.root, Path):
            write_summary(self.root / 'summary.csv', rows)
            return
        with TemporaryDirectory(prefix='kinpole') as scratch:
            write_summary(Path(scratch) / 'summary.csv', rows)
            _store.send(Path(scratch), [], 'summary.csv', self.root)


def row_in_folder(job: Job, row: Row) -> Row:
    """Return a row with its results relative to the folder of all results."""
    names = [f'{job.shard}/{name}'.lstrip('/') for name in row.get('results', '').split()]
    return row | {'results': ' '.join(names)} if names else row


def write_summary(path: Path, rows: list[Row]) -> None:
    """Write a line for each bag, with a column for all that any of them has."""
    columns = dict.fromkeys(_FIRST) | dict.fromkeys(name for row in rows for name in row)
    with (
        in_place_of(path) as part,
        # A file name need not be text.
        open(part, 'w', encoding='utf-8', errors='backslashreplace', newline='') as file,
    ):
        table = csv.writer(file)
        table.writerow(map(as_cell, columns))
        table.writerows([as_cell(row.get(name, '')) for name in columns] for row in rows)
