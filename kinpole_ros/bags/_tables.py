"""Results as tables, CSV or Parquet: a row for each instant, empty where undetermined."""

import csv
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from kinpole_ros.bags._files import BagError, unwritable
from kinpole_ros.files import as_cell
from kinpole_ros.packages import install_command
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, Numbers, Vectors, measured_pairs

_GROUP_ROWS = 8192  # of a Parquet file, which are in memory at once
# The event of a body that was found with an instant: its time, and the step of the derivative of
# this order, of the angle and of the origin of the body's frame.
EVENT_COLUMNS = (
    *('event_t', 'event_t_sigma', 'event_order', 'event_angle_step', 'event_angle_step_sigma'),
    *('event_step_x', 'event_step_y', 'event_step_x_sigma', 'event_step_y_sigma'),
)


def column_names(bodies: tuple[str, ...], order: int) -> list[str]:
    """
    Return the names of the quantities of an instant, up to the derivative of `order`.

    Of every body x, y, angle, the rates and curvature each with the column NAME_sigma behind it,
    and the poles and the ICR's velocity as NAME_x, NAME_y and their sigmas; of every pair the
    relative rate and center. Last come the EVENT_COLUMNS of every body. SI units, sigma is one
    standard deviation. x and y are along the axes of the plane: those of the frame in xy, yz and
    zx, else those of `messages.plane_words`.
    """
    numbers = [*RATE_NAMES[:order], *(['centrode_curvature'] if order >= 3 else [])]
    vectors = [*POLE_NAMES[:order], *(['icr_velocity'] if order >= 2 else [])]
    names = []
    for body in bodies:
        names += [f'{body}_{name}' for name in ('x', 'y', 'angle')]
        names += _value_and_sigma_names(body, numbers, vectors)
    for i, j in measured_pairs(len(bodies)):
        names += _value_and_sigma_names(
            f'{bodies[j]}_wrt_{bodies[i]}', ['angular_velocity'], ['icr']
        )
    return names + [f'{body}_{name}' for body in bodies for name in EVENT_COLUMNS]


def _event_columns(estimate: Estimate, shape: tuple[int, int]) -> np.ndarray:
    """Return the EVENT_COLUMNS of all bodies, (T, B, columns)."""
    columns = np.full((*shape, len(EVENT_COLUMNS)), np.nan)
    for instant, event in zip(estimate.instants_of_events(), estimate.events, strict=True):
        sigmas = np.sqrt(np.diag(event.step_covariance))
        columns[instant, event.body] = (
            *(event.stamp * 1e-9, event.time_sigma, event.order),
            *(event.angle_step, event.angle_step_sigma, event.step.real, event.step.imag, *sigmas),
        )
    return columns


def _value_and_sigma_names(prefix: str, numbers: list[str], vectors: list[str]) -> Iterator[str]:
    for name in numbers:
        yield from (f'{prefix}_{name}', f'{prefix}_{name}_sigma')
    for name in vectors:
        yield from (f'{prefix}_{name}_{end}' for end in ('x', 'y', 'x_sigma', 'y_sigma'))


def table_rows(estimate: Estimate, order: int) -> np.ndarray:
    """Return the quantities of `column_names` at T instants, (T, columns); NaN if undetermined."""
    count = np.size(estimate.stamp)
    shape = (count, len(estimate.bodies))
    is_known = np.reshape(np.asarray(estimate.missing), (*shape, 1)) == ''
    origin = estimate.origin(0).reshape(shape)
    pose = np.stack((origin.real, origin.imag, estimate.angle[0].reshape(shape)), axis=-1)
    body_columns = [np.where(is_known, pose, np.nan)]
    body_columns += [_number_columns(estimate.rate(k), shape) for k in range(1, order + 1)]
    if order >= 3:
        body_columns.append(_number_columns(estimate.centrode_curvature, shape))
    body_columns += [_vector_columns(estimate.pole(k), shape) for k in range(1, order + 1)]
    if order >= 2:
        body_columns.append(_vector_columns(estimate.icr_velocity, shape))
    pairs = (count, len(measured_pairs(shape[1])))
    pair_columns = [
        _number_columns(estimate.relative_rate, pairs),
        _vector_columns(estimate.relative_icr, pairs),
    ]
    blocks = [np.concatenate(columns, axis=-1) for columns in (body_columns, pair_columns)]
    blocks.append(_event_columns(estimate, shape))
    return np.concatenate([block.reshape(count, -1) for block in blocks], axis=1)


def _number_columns(numbers: Numbers, shape: tuple[int, int]) -> np.ndarray:
    """Return value and sigma, (..., 2)."""
    with np.errstate(invalid='ignore'):
        columns = np.stack((numbers.value, np.sqrt(numbers.variance)), axis=-1)
    return np.where(numbers.determined[..., None], columns, np.nan).reshape(*shape, 2)


def _vector_columns(vectors: Vectors, shape: tuple[int, int]) -> np.ndarray:
    """Return two components and their sigmas, (..., 4)."""
    value = np.stack((vectors.value.real, vectors.value.imag), axis=-1)
    with np.errstate(invalid='ignore'):
        sigmas = np.sqrt(np.diagonal(vectors.covariance, axis1=-2, axis2=-1))
    columns = np.concatenate((value, sigmas), axis=-1)
    return np.where(vectors.determined[..., None], columns, np.nan).reshape(*shape, 4)


class _Table(ABC):
    """
    A file that estimates are written to; use it in a `with` block.

    `name` is the one in messages, where that is not its path. Raises BagError when it cannot be
    written.
    """

    def __init__(
        self, path: str | Path, settings: Settings, name: str | Path | None = None
    ) -> None:
        self._path, self._name = Path(path), name or path
        self._order = settings.highest_order
        self._names = column_names(tuple(settings.bodies), self._order)
        with self._write_errors():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._open()

    def __enter__(self) -> '_Table':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            with self._write_errors():
                self._close()
        except BagError:
            if kind is None:  # else the first error is the one to be seen
                raise

    def add(self, estimate: Estimate) -> None:
        """Write the rows of its instants."""
        rows = table_rows(estimate, self._order)
        with self._write_errors():
            self._write(np.atleast_1d(estimate.stamp), rows)

    @contextmanager
    def _write_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise unwritable(self._name, error) from None

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _write(self, stamps: np.ndarray, rows: np.ndarray) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...


class CsvTable(_Table):
    """A spreadsheet: t in s with all its digits, then the quantities; empty is undetermined."""

    def _open(self) -> None:
        self._file = open(self._path, 'w', newline='', encoding='utf-8')  # noqa: SIM115
        self._rows = csv.writer(self._file)
        self._rows.writerow(['t', *map(as_cell, self._names)])

    def _write(self, stamps: np.ndarray, rows: np.ndarray) -> None:
        cells = rows.astype(object)
        cells[np.isnan(rows)] = None
        times = [f'{stamp // 10**9}.{stamp % 10**9:09d}' for stamp in stamps.tolist()]
        self._rows.writerows([time, *row] for time, row in zip(times, cells.tolist(), strict=True))

    def _close(self) -> None:
        self._file.close()


class ParquetTable(_Table):
    """
    A Parquet file for pandas, Polars, DuckDB and the like, written in groups of rows.

    Columns: stamp, ns, exact; t, s; then the quantities; null is undetermined. Needs pyarrow.
    """

    def _open(self) -> None:
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise BagError(
                f'{self._name} needs pyarrow; fix: {install_command("parquet")}, or write a CSV '
                'table'
            ) from None
        self._arrow: Any = pyarrow
        double = pyarrow.float64()
        self._schema = pyarrow.schema(
            [('stamp', pyarrow.int64()), *((name, double) for name in ('t', *self._names))]
        )
        self._blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self._file = open(self._path, 'wb')  # noqa: SIM115
        self._writer = parquet.ParquetWriter(self._file, self._schema, compression='zstd')

    def _write(self, stamps: np.ndarray, rows: np.ndarray) -> None:
        self._blocks.append((stamps, rows))
        if sum(len(stamps) for stamps, _ in self._blocks) >= _GROUP_ROWS:
            self._write_group()

    def _write_group(self) -> None:
        if not self._blocks:
            return
        stamps, rows = (np.concatenate(column) for column in zip(*self._blocks, strict=True))
        self._blocks = []
        columns = [stamps, stamps * 1e-9, *rows.T]
        arrays = [self._arrow.array(column, from_pandas=True) for column in columns]
        self._writer.write_table(self._arrow.table(arrays, schema=self._schema))

    def _close(self) -> None:
        try:
            self._write_group()
            self._writer.close()
        finally:
            self._file.close()
