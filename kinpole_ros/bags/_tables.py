"""
Results as tables, CSV or Parquet: a row for each instant, empty where undetermined.

The last columns say in words why a body, or a quantity of it, is undetermined.
"""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kinpole_ros.bags._files import BagError, write_errors
from kinpole_ros.files import as_cell
from kinpole_ros.packages import install_command
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.quantities import withheld_quantities
from kinpole_ros.tracking.reasons import KNOWN, texts_of
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.values import Numbers, Vectors, measured_pairs, quantity_names

AddRows: TypeAlias = Callable[[Estimate], None]

_GROUP_ROWS = 8192  # of a Parquet file, which are in memory at once
# The event of a body that was found with an instant: its time, and the step of the derivative of
# this order, of the angle and of the origin of the body's frame.
EVENT_COLUMNS = (
    *('event_t', 'event_t_sigma', 'event_order', 'event_angle_step', 'event_angle_step_sigma'),
    *('event_step_x', 'event_step_y', 'event_step_x_sigma', 'event_step_y_sigma'),
)


def column_names(
    bodies: tuple[str, ...], order: int, registered: Sequence[RegisteredQuantity] = ()
) -> list[str]:
    """
    Return the names of the quantities of an instant, up to the derivative of `order`.

    Of every body x, y, angle, the numbers of `quantity_names` each with the column NAME_sigma
    behind it, and the vectors as NAME_x, NAME_y and their sigmas; of every pair the
    relative rate and center; of every quantity that is `registered` with a topic, the name of that
    with _ for /. Last come the EVENT_COLUMNS of every body. SI units, sigma is one
    standard deviation. x and y are along the axes of the plane: those of the frame in xy, yz and
    zx, else those of `messages.faults.plane_words`. Raises BagError where two have one name, as
    those of the bodies `rod` and `rod_icr`.
    """
    quantities = quantity_names(order)
    numbers, vectors = (
        [name for name, is_vector in quantities.items() if is_vector == wanted]
        for wanted in (False, True)
    )
    names = []
    for body in bodies:
        names += [f'{body}_{name}' for name in ('x', 'y', 'angle')]
        names += _value_and_sigma_names(body, numbers, vectors)
    for i, j in measured_pairs(len(bodies)):
        names += _value_and_sigma_names(
            f'{bodies[j]}_wrt_{bodies[i]}', ['angular_velocity'], ['icr']
        )
    for quantity in _up_to(order, registered):
        ends = ('_x', '_y', '_x_sigma', '_y_sigma') if quantity.is_vector else ('', '_sigma')
        names += [quantity.topic.replace('/', '_') + end for end in ends]
    names += [f'{body}_{name}' for body in bodies for name in EVENT_COLUMNS]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise BagError(
            f'two quantities would have the column {twice[0]}; fix: rename the body, or the point '
            'of the scene, whose name continues that of another'
        )
    return names


def reason_names(bodies: tuple[str, ...], order: int) -> list[str]:
    """Return the names of the columns of reasons: of each body, and of its quantities."""
    names = ['pose', *withheld_quantities(order).values()]
    return [f'{body}_{name}_reason' for body in bodies for name in names]


def reason_rows(estimate: Estimate) -> np.ndarray:
    """Return the texts of `reason_names` at T instants, (T, columns), '' where all is known."""
    codes = np.stack([estimate.reason, *estimate.withheld().values()], axis=-1)
    return texts_of(codes.reshape(np.size(estimate.stamp), -1))


def _up_to(order: int, registered: Sequence[RegisteredQuantity]) -> list[RegisteredQuantity]:
    return [quantity for quantity in registered if quantity.order <= order]


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


def table_rows(
    estimate: Estimate, order: int, registered: Sequence[RegisteredQuantity] = ()
) -> np.ndarray:
    """Return the quantities of `column_names` at T instants, (T, columns); NaN if undetermined."""
    count = np.size(estimate.stamp)
    shape = (count, len(estimate.bodies))
    is_known = np.reshape(np.asarray(estimate.reason), (*shape, 1)) == KNOWN
    origin = estimate.origin(0).reshape(shape)
    pose = np.stack((origin.real, origin.imag, estimate.angle[0].reshape(shape)), axis=-1)
    quantities = estimate.quantities(order).values()
    body_columns = [
        np.where(is_known, pose, np.nan),
        *(_number_columns(one, shape) for one in quantities if isinstance(one, Numbers)),
        *(_vector_columns(one, shape) for one in quantities if isinstance(one, Vectors)),
    ]
    pairs = (count, len(measured_pairs(shape[1])))
    pair_columns = [
        _number_columns(estimate.relative_rate, pairs),
        _vector_columns(estimate.relative_icr, pairs),
    ]
    blocks = [np.concatenate(columns, axis=-1) for columns in (body_columns, pair_columns)]
    for quantity in _up_to(order, registered):
        values = quantity.values(estimate)
        of_kind = _number_columns if isinstance(values, Numbers) else _vector_columns
        blocks.append(of_kind(values, (count, 1)))  # type: ignore[arg-type]
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


@contextmanager
def csv_table(
    path: str | Path,
    settings: Settings,
    name: str | Path | None = None,
    registered: Sequence[RegisteredQuantity] = (),
) -> Iterator[AddRows]:
    """
    Give a function that writes the rows of an estimate to a spreadsheet.

    t in s with all its digits, then the quantities; empty is undetermined. `name` is the one in
    messages, where that is not its path. Raises BagError when it cannot be written.
    """
    order, named = settings.highest_order, name or path
    names = column_names(tuple(settings.bodies), order, registered)
    with write_errors(named), open(path, 'w', newline='', encoding='utf-8') as file:
        table = csv.writer(file)
        reasons = reason_names(tuple(settings.bodies), order)
        table.writerow(['t', *map(as_cell, [*names, *reasons])])

        def add(estimate: Estimate) -> None:
            rows = table_rows(estimate, order, registered)
            cells = rows.astype(object)
            cells[np.isnan(rows)] = None
            cells = np.concatenate((cells, reason_rows(estimate)), axis=1)
            stamps = np.atleast_1d(estimate.stamp).tolist()
            times = [f'{stamp // 10**9}.{stamp % 10**9:09d}' for stamp in stamps]
            with write_errors(named):
                table.writerows(
                    [time, *row] for time, row in zip(times, cells.tolist(), strict=True)
                )

        yield add


@contextmanager
def parquet_table(
    path: str | Path,
    settings: Settings,
    name: str | Path | None = None,
    registered: Sequence[RegisteredQuantity] = (),
) -> Iterator[AddRows]:
    """
    Give a function that writes the rows of an estimate to a file for pandas, Polars and the like.

    Columns: stamp, ns, exact; t, s; then the quantities; null is undetermined. It is written in
    groups of rows. Otherwise as `csv_table`; needs pyarrow.
    """
    order, named = settings.highest_order, name or path
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise BagError(
            f'{named} needs pyarrow; fix: {install_command("parquet")}, or write a CSV table'
        ) from None
    names = ('t', *column_names(tuple(settings.bodies), order, registered))
    reasons = reason_names(tuple(settings.bodies), order)
    columns = [('stamp', pyarrow.int64()), *((column, pyarrow.float64()) for column in names)]
    columns += [(column, pyarrow.string()) for column in reasons]
    schema = pyarrow.schema(columns)
    blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    with (
        write_errors(named),
        open(path, 'wb') as file,
        parquet.ParquetWriter(file, schema, compression='zstd') as writer,
    ):

        def write_group() -> None:
            stamps, rows, texts = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
            blocks.clear()
            texts[texts == ''] = None
            arrays = [
                pyarrow.array(column, from_pandas=True)
                for column in (stamps, stamps * 1e-9, *rows.T)
            ]
            arrays += [pyarrow.array(column, pyarrow.string()) for column in texts.T]
            with write_errors(named):
                writer.write_table(pyarrow.table(arrays, schema=schema))

        def add(estimate: Estimate) -> None:
            rows = table_rows(estimate, order, registered)
            blocks.append((np.atleast_1d(estimate.stamp), rows, reason_rows(estimate)))
            if sum(len(stamps) for stamps, *_ in blocks) >= _GROUP_ROWS:
                write_group()

        yield add
        if blocks:
            write_group()


TABLES = {'csv': csv_table, 'parquet': parquet_table}
