"""Tables of results: CSV and Parquet say the same, whole blocks of instants at a time."""

import csv
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import bodies_of

from kinpole_ros.bags import BagError, replay
from kinpole_ros.bags._tables import TABLES, column_names, csv_table, parquet_table, table_rows
from kinpole_ros.settings import Settings
from kinpole_ros.tools.cli import main
from kinpole_ros.tracking.quantities import withheld_quantities
from kinpole_ros.tracking.reasons import KNOWN, REASONS
from kinpole_ros.tracking.values import Numbers, Vectors, quantity_names

Simulated = Callable[..., Path]
FOUR_BAR = Settings(bodies=bodies_of('four_bar'), window=0.3, lag=0.1)


class Known:
    """What a table reads of an estimate of T instants: numbers at random, some undetermined."""

    def __init__(self, instants: int, bodies: tuple[str, ...], seed: int = 0) -> None:
        draw = np.random.default_rng(seed)
        shape = (instants, len(bodies))
        self.bodies, self.events = bodies, ()
        self.instants_of_events = list
        self.stamp = np.arange(instants) * 1_000_000 + 1_700_000_000_123_456_789
        self.reason = np.where(draw.random(shape) < 0.2, REASONS['NOT_SEEN'], KNOWN)
        self.withheld = lambda: dict.fromkeys(withheld_quantities(4).values(), self.reason)
        self.position = draw.standard_normal((5, *shape)) * 1e-3 + 1j
        self.angle = draw.standard_normal((5, *shape))
        self.origin = lambda order: self.position[order]
        pairs = (instants, len(bodies) * (len(bodies) - 1) // 2)
        self._quantities = {
            name: self._vectors(draw, shape) if is_vector else self._numbers(draw, shape)
            for name, is_vector in quantity_names(4).items()
        }
        self.relative_rate = self._numbers(draw, pairs)
        self.relative_icr = self._vectors(draw, pairs)

    def quantities(self, order: int) -> dict[str, Any]:
        return {name: self._quantities[name] for name in quantity_names(order)}

    @staticmethod
    def _numbers(draw: Any, shape: tuple[int, ...]) -> Numbers:
        known = draw.random(shape) < 0.7
        value = np.where(known, draw.standard_normal(shape), np.nan)
        return Numbers(value, np.where(known, draw.random(shape), -1.0), known)

    @staticmethod
    def _vectors(draw: Any, shape: tuple[int, ...]) -> Vectors:
        value = draw.standard_normal(shape) + 1j * draw.standard_normal(shape)
        return Vectors(value, draw.random((*shape, 2, 2)), draw.random(shape) < 0.7)


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, newline='', encoding='utf-8') as file:
        return list(csv.DictReader(file))


def test_a_block_of_instants_makes_the_rows_of_its_instants(tmp_path: Path) -> None:
    known: Any = Known(50, ('a', 'b', 'c'))
    settings = Settings(bodies={'a': (), 'b': (), 'c': ()})
    with csv_table(tmp_path / 'out.csv', settings) as add:
        add(known)
    with open(tmp_path / 'out.csv', newline='') as file:
        assert file.readline().endswith('\r\n')
    rows = rows_of(tmp_path / 'out.csv')
    assert len(rows) == 50
    pairs = {'b_wrt_a': 0, 'c_wrt_a': 1, 'c_wrt_b': 2}
    undetermined = 0
    for k, row in enumerate(rows):
        assert row['t'] == f'1700000000.{123_456_789 + k * 1_000_000:09d}'
        for b, body in enumerate('abc'):
            place, there = known.position[0, k, b], known.reason[k, b] == KNOWN
            expected = [place.real, place.imag, known.angle[0, k, b]]
            cells = [row[f'{body}_{name}'] for name in ('x', 'y', 'angle')]
            assert cells == ([repr(float(v)) for v in expected] if there else ['', '', ''])
            quantities = known.quantities(4)
            jerk, velocity = quantities['angular_jerk'], quantities['icr_velocity']
            cells = [row[f'{body}_angular_jerk'], row[f'{body}_angular_jerk_sigma']]
            expected = [jerk.value[k, b], math.sqrt(max(jerk.variance[k, b], 0))]
            assert cells == (
                [repr(float(v)) for v in expected] if jerk.determined[k, b] else ['', '']
            )
            undetermined += not jerk.determined[k, b]
            assert bool(row[f'{body}_icr_velocity_x']) == velocity.determined[k, b]
        for pair, p in pairs.items():
            center = known.relative_icr
            sigma = math.sqrt(center.covariance[k, p, 1, 1])
            expected = [center.value[k, p].real, center.value[k, p].imag, sigma]
            cells = [row[f'{pair}_icr_{end}'] for end in ('x', 'y', 'y_sigma')]
            assert cells == (
                [repr(float(v)) for v in expected] if center.determined[k, p] else ['', '', '']
            )
    assert 20 < undetermined < 80


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_there_is_a_name_for_every_figure(order: int) -> None:
    for bodies in (('a',), ('a', 'b'), ('a', 'b', 'c', 'd')):
        known: Any = Known(3, bodies)
        names = column_names(bodies, order)
        assert table_rows(known, order).shape == (3, len(names))
        assert len(set(names)) == len(names)


@pytest.mark.parametrize('table', [csv_table, parquet_table])
def test_two_quantities_with_one_column_are_refused_before_the_file(
    tmp_path: Path, table: Any
) -> None:
    if table is parquet_table:
        pytest.importorskip('pyarrow')
    settings = Settings(bodies={'rod': (), 'rod_icr': ()})
    fault = 'two quantities would have the column rod_icr_x; fix: rename the body'
    with pytest.raises(BagError, match=fault), table(tmp_path / 'out', settings):
        pass
    assert not (tmp_path / 'out').exists()


def test_parquet_and_csv_hold_the_same_figures(simulated: Simulated, tmp_path: Path) -> None:
    parquet = pytest.importorskip('pyarrow.parquet')
    bag = simulated('four_bar', rate=100, duration=1.5, noise=2e-4, dropout=0.3)
    replay(bag, FOUR_BAR, csv=tmp_path / 'out.csv', parquet=tmp_path / 'deep' / 'out.parquet')
    rows = rows_of(tmp_path / 'out.csv')
    table = parquet.read_table(tmp_path / 'deep' / 'out.parquet')
    assert table.column_names == ['stamp', *rows[0]]
    assert len(rows) == table.num_rows > 100
    empty = 0
    for name in rows[0]:
        cells = [row[name] for row in rows]
        found = table[name].to_pylist()
        assert [value is None for value in found] == [cell == '' for cell in cells]
        empty += found.count(None)
        if name != 't':
            same = str if name.endswith('_reason') else repr
            assert [same(v) for v in found if v is not None] == [c for c in cells if c]
    assert empty > 100
    stamps = [int(row['t'].replace('.', '')) for row in rows]
    assert table['stamp'].to_pylist() == stamps
    np.testing.assert_allclose(table['t'].to_numpy() * 1e9, stamps, rtol=1e-15)


def test_parquet_is_written_in_groups_so_that_memory_stays_bounded(tmp_path: Path) -> None:
    parquet = pytest.importorskip('pyarrow.parquet')
    settings = Settings(bodies={'a': (), 'b': ()})
    blocks: list[Any] = [Known(1000, ('a', 'b'), seed) for seed in range(20)]
    with parquet_table(tmp_path / 'out.parquet', settings) as add:
        for block in blocks:
            add(block)
    with parquet.ParquetFile(tmp_path / 'out.parquet') as file:
        sizes = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
        found = file.read()
    assert sizes == [9000, 9000, 2000]
    expected = np.concatenate([table_rows(block, 4) for block in blocks])
    columns = [found[name].to_numpy() for name in column_names(('a', 'b'), 4)]
    np.testing.assert_array_equal(np.stack(columns, axis=1), expected)


def test_a_run_without_any_instant_leaves_tables_with_names(
    simulated: Simulated, tmp_path: Path
) -> None:
    parquet = pytest.importorskip('pyarrow.parquet')
    bag = simulated('cardan', rate=100, duration=0.02)
    result = replay(bag, Settings(), csv=tmp_path / 'o.csv', parquet=tmp_path / 'o.parquet')
    assert result.estimates == 0
    assert (tmp_path / 'o.csv').read_text().startswith('t,body_x,body_y,')
    assert parquet.read_table(tmp_path / 'o.parquet').num_rows == 0


def test_the_command_writes_parquet_and_says_what_is_missing(
    simulated: Simulated,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    parquet = pytest.importorskip('pyarrow.parquet')
    bag = str(simulated('cardan', rate=100, duration=0.5))
    target = tmp_path / 'out.parquet'
    assert main(['replay', bag, '--parquet', str(target)]) == 0
    assert f'written to {target}' in capsys.readouterr().out
    assert parquet.read_table(target).num_rows > 10
    assert main(['replay', bag, '--parquet', str(target), '--csv', str(target)]) == 2
    assert f'{target} is another output; name another file' in capsys.readouterr().err
    assert main(['replay', bag, '--parquet', str(tmp_path)]) == 2
    assert f'{tmp_path} cannot be written: Is a directory' in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, 'pyarrow', None)
    assert main(['replay', bag, '--parquet', str(target)]) == 2
    line = capsys.readouterr().err
    assert f'{target} needs pyarrow; fix: pip install pyarrow' in line
    assert line.count('\n') == 1


@pytest.mark.parametrize('kind', TABLES)
def test_a_full_disk_is_one_line(kind: str) -> None:
    if kind == 'parquet':
        pytest.importorskip('pyarrow')
    known: Any = Known(3000, ('a', 'b'))
    with (
        pytest.raises(BagError, match=r'/dev/full cannot be written: No space left'),
        TABLES[kind]('/dev/full', Settings(bodies={'a': (), 'b': ()})) as add,
    ):
        for _ in range(10):
            add(known)
