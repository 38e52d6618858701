"""Where results of a batch lie: in a folder or a store; of very many bags in folders of that."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from kinpole_ros.bags._files import unwritable
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._results import (
    Row,
    finished,
    finished_in_store,
    name_of,
    shard_of,
    write_summary,
)
from kinpole_ros.tracking.parameters import Settings

# Bags whose results may lie in one folder; of more they lie in 256 folders in it.
_MOST_IN_FOLDER = 10_000


def absolute(bag: str | Path) -> str:
    """The one name of a bag: its whole path, or its URL."""
    return str(bag) if _store.is_url(bag) else os.path.abspath(_store.on_disk(bag))


class Places:
    """Where results lie: in a folder, or in a store by its URL; of very many in folders of it."""

    def __init__(self, output: str | Path) -> None:
        self.folder: Path | str = (
            str(output).rstrip('/')
            if _store.is_url(output)
            else Path(os.path.abspath(_store.on_disk(output)))
        )
        self._sharded = False
        # What a store holds, as looked at once: to ask for each bag takes long.
        self._known: tuple[dict[str, Any], set[str]] = ({}, set())

    def divide(self, bags: int) -> None:
        """Take so many bags, whose results may be too many for one folder."""
        self._sharded = bags > _MOST_IN_FOLDER

    def prepare(self) -> None:
        """Make the folder. Raises BagError when it cannot be written, once for all bags."""
        if isinstance(self.folder, str):
            self._known = _store.recorded(self.folder)
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            TemporaryFile(dir=self.folder).close()
        except OSError as error:
            raise unwritable(self.folder, error) from None

    def home(self, bag: str) -> Path | str:
        """The folder of the results of a bag, which is there: as before, if it has any."""
        shard = self._shard(bag)
        if isinstance(self.folder, str):
            return f'{self.folder}/{shard}' if shard else self.folder
        home = self.folder / shard
        home.mkdir(exist_ok=True)
        return home

    def _shard(self, bag: str) -> str:
        """Folder in the folder, '' for none: where results are from before, or should be now."""
        shard, record = shard_of(bag), f'{name_of(bag)}.json'
        now, other = (shard, '') if self._sharded else ('', shard)
        if isinstance(self.folder, str):
            record = record.removesuffix('.json')
            before = f'{other}/{record}'.lstrip('/') in self._known[0]
        else:
            before = not (self.folder / now / record).exists()
            before = before and (self.folder / other / record).exists()
        return other if before else now

    def finished(
        self, bag: str, settings: Settings, topic: str | None, kinds: list[str]
    ) -> Row | None:
        """The row of a bag whose results are there."""
        shard = self._shard(bag)
        if isinstance(self.folder, str):
            row = finished_in_store(bag, shard, self._known, settings, topic, kinds)
        else:
            row = finished(bag, self.folder / shard, settings, topic, kinds)
        return row and self.as_seen(row, shard)

    def as_seen(self, row: Row, shard: str | None = None) -> Row:
        """A row with its results as they are found from the folder."""
        shard = self._shard(row['bag']) if shard is None else shard
        if not shard or not row.get('results'):
            return row
        return row | {'results': ' '.join(f'{shard}/{name}' for name in row['results'].split())}

    def write_summary(self, rows: list[Row]) -> None:
        """A table over all."""
        if isinstance(self.folder, str):
            with TemporaryDirectory(prefix='kinpole') as scratch:
                write_summary(Path(scratch) / 'summary.csv', rows)
                _store.send(Path(scratch), [], 'summary.csv', self.folder)
            return
        write_summary(self.folder / 'summary.csv', rows)
