"""
Rows of figures as CSV files: what was measured is kept there, and the pages are made of it.

So a part can be measured again by itself, and a page quotes what was measured before.
"""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Rows = list[dict[str, Any]]


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say which file it was that could not be written, which a full disk does not."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_rows(path: Path, rows: Rows) -> None:
    """Write rows, of which some may lack something; floats have five digits."""
    fields = list(dict.fromkeys(field for row in rows for field in row))
    with writing(path), path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, fields, restval='', lineterminator='\n')
        writer.writeheader()
        for row in rows:
            writer.writerow({f: f'{v:.5g}' if isinstance(v, float) else v for f, v in row.items()})


def read_rows(path: Path) -> Rows:
    """
    The rows of a file, none where it is not there.

    A column is of numbers, NaN where there is none, of booleans, or of text.
    """
    if not path.exists():
        return []
    with path.open(newline='', encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    columns = {name: _column([row[name] or '' for row in rows]) for name in (rows or [{}])[0]}
    return [{name: column[k] for name, column in columns.items()} for k in range(len(rows))]


def _column(texts: list[str]) -> list[Any]:
    if not any(texts):
        return list(texts)
    if {*texts} <= {'True', 'False'}:
        return [text == 'True' for text in texts]
    try:
        return [float(text or 'nan') for text in texts]
    except ValueError:
        return list(texts)
