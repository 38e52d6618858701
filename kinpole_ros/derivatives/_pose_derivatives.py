"""
Call the compiled kernel: from poses at stamps to derivatives at instants.

The tables of window kinds are kept between calls, and in files between processes.
"""

import weakref
from collections.abc import Sequence
from ctypes import byref
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import (
    SIZES,
    Call,
    DerivativeArrays,
    Table,
    TableMaker,
    codes_of,
    library,
)
from kinpole_ros.derivatives._cached_tables import cached_table
from kinpole_ros.derivatives._models import models_of, slopes_of, stencils_of
from kinpole_ros.derivatives._spectra import Spectrum, spectrum_numbers
from kinpole_ros.planar._plane import Complex, Real

# Memory of all tables, of which the oldest are dropped; a kind of window has 100 kB to 5 MB, and so
# has each body with a spectrum.
_MAX_TABLE_BYTES = 128_000_000
_ENDS = codes_of('CALL_ENDS')
DONE, NO_TABLE, NO_FRAMES = _ENDS['DONE'], _ENDS['NO_TABLE'], _ENDS['NO_FRAMES']
SLOPES, MODELS = codes_of('TABLE_ORDERS').values()


class Poses(NamedTuple):
    """
    Poses of B bodies in N frames at `time` (N,), ns.

    The orientation is `angle` (N, B), rad, plus whole `turns` (N, B), separate because rounding
    would grow with the turns. `position` (N, B) is complex, m. `angle_information` and
    `position_information` (N, B) are inverse variances of the angle and of one coordinate, times
    the squared `noise` of `derive_poses`, and 0 for a missing pose.
    """

    time: np.ndarray
    angle: Real
    turns: Real
    position: Complex
    angle_information: Real
    position_information: Real


class Windows(NamedTuple):
    """Frames (T,) of the instants, and the oldest and newest frames of their windows."""

    now: np.ndarray
    oldest: np.ndarray
    newest: np.ndarray


class Derivatives(NamedTuple):
    """
    Derivatives (K, T, B) of order 0 to K - 1, of B bodies at T instants; NaN with too few poses.

    Units are rad, m and s. Covariances (K, K, T, B) are between the orders, of the angle and of one
    coordinate. `span` (T, B) is the length of the window, s, and `parameters` (T, B) the effective
    number of parameters of the motion of the angle, 2 if it is steady. The position is that of the
    point `reference` (T, B) of the body, m from the given one in the frame of the body: 0, or the
    hub that the body turns about.
    """

    position: Complex
    angle: Real
    position_covariance: Real
    angle_covariance: Real
    span: Real
    parameters: Real
    reference: Complex


# The integers and numbers of tables by their kinds, the oldest first. Replaced and never changed,
# because another thread may be using it.
_tables: dict[tuple[float, ...], tuple[np.ndarray, Real]] = {}


def derive_poses(
    poses: Poses,
    windows: Windows,
    left_out: np.ndarray,
    noise: Real,
    window: float,
    order: int,
    spectra: Sequence[Spectrum | None] | None = None,
) -> Derivatives:
    """
    Differentiate poses at the instants of `windows`, up to `order`.

    `left_out` (T, B) is the number of newest frames of each window that are ignored, `noise` (T, B)
    the standard deviation of a pose with information of 1, and `window`, s, the length of a full
    window. `spectra` (B,) are those of the bodies, as far as known: see `find_spectrum`.

    Raises
    ------
    ValueError
        If shapes do not fit, stamps do not increase, or the window or the order is out of range.
    IndexError
        If a frame of `windows` is not among those of `poses`.

    """
    _check_arguments(poses, windows, left_out, noise, window, order)
    (instants, bodies), (frames,), orders = noise.shape, poses.time.shape, order + 1
    call = new_call(window, order)
    call.frames, call.bodies, call.instants = frames, bodies, instants
    known = spectra if spectra is not None else [None] * bodies
    set_spectra(call, known)
    about = {'windows': np.array(windows), 'left_out': left_out, 'noise': noise}
    about['spectrum'] = spectrum_numbers(known)
    for name, array in (poses._asdict() | about).items():
        call.bind(name, np.ascontiguousarray(array, call.elements[name]))
    derivatives = Derivatives(**DerivativeArrays.new_arrays(K=orders, T=instants, B=bodies))
    for name, array in derivatives._asdict().items():
        call.derivatives.bind(name, array)
    finish_call(call, library.kinpole_derive(byref(call)))
    return derivatives


def _check_arguments(
    poses: Poses, windows: Windows, left_out: np.ndarray, noise: Real, window: float, order: int
) -> None:
    """Raise an exception for arguments of `derive_poses` that the library cannot take."""
    (instants, bodies), (frames,) = noise.shape, poses.time.shape
    shapes = [array.shape for array in (*poses[1:], *windows, left_out)]
    if shapes != [(frames, bodies)] * 5 + [(instants,)] * 3 + [(instants, bodies)]:
        raise ValueError(f'shapes do not fit to {frames} frames and noise {noise.shape}: {shapes}')
    highest = SIZES['HIGHEST']
    if not 0 <= order <= highest:
        raise ValueError(f'order is {order}, but derivatives have order 0 to {highest}')
    if not 0 < window < np.inf:
        raise ValueError(f'window is {window} s, but a length is finite and more than 0')
    early = np.flatnonzero(poses.time[1:] <= poses.time[:-1])
    if early.size:
        frame = early[0] + 1
        stamp, before = poses.time[frame], poses.time[frame - 1]
        raise ValueError(f'stamp {stamp} of frame {frame} is not after the one before, {before}')


def new_call(window: float, order: int) -> Call:
    """Return arguments of the library without arrays; tables are made as it needs them."""
    call = Call(orders=order + 1, window=window)
    forget_tables(call)
    call.spectra = {}
    # The call must not refer to itself, since it frees memory when it is deleted.
    reference = weakref.ref(call)
    call.make_table = TableMaker(lambda table: _pass_table(reference(), table.contents))
    return call


def set_spectra(call: Call, spectra: Sequence[Spectrum | None]) -> None:
    """Let a call know these spectra of bodies, and no others."""
    known = {one.number: one for one in spectra if one is not None}
    if not call.spectra.keys() <= known.keys():
        tables = vars(call)['tables']
        _keep_tables(call, np.isin(tables['spectrum_number'], [0, *known]))
    call.spectra = known


def forget_tables(call: Call) -> None:
    """Let a call begin without tables."""
    call.held, call.held_bytes, call.error, call.table_count = [], 0, None, 0
    call.bind('tables', np.empty(0, Table))


def _keep_tables(call: Call, which: np.ndarray) -> None:
    """Let a call forget all tables but some."""
    call.held = [arrays for arrays, is_kept in zip(call.held, which, strict=True) if is_kept]
    call.held_bytes, call.table_count = sum(map(_size_of, call.held)), len(call.held)
    call.bind('tables', vars(call)['tables'][which])


def finish_call(call: Call, code: int) -> None:
    """
    Raise an exception if the return value `code` of the library is an error.

    Otherwise, forget tables that take too much memory: those still needed are passed again.
    """
    if call.held_bytes > _MAX_TABLE_BYTES or code < 0:
        error = call.error or MemoryError()
        forget_tables(call)
        if code == NO_FRAMES:
            raise IndexError('windows lie beyond the frames')
        if code < 0:
            raise error


def _pass_table(call: Any, table: Table) -> int:
    """Pass a table that the library needs in a call, which keeps its arrays alive."""
    window = table.count, table.block, table.exact, table.orders, table.from_middle
    kind, spectrum = (*window, table.spectrum_number), call.spectra.get(table.spectrum_number)
    try:
        arrays = _tables.get(kind)
        if arrays is None:
            make = partial(_make, *window, spectrum)
            # Another process has hardly the same spectrum.
            arrays = make() if spectrum else cached_table(window, make)
        _keep_table(kind, arrays)
    except BaseException as error:  # The library has to return first.
        call.error = error
        return NO_TABLE
    table.integers, table.numbers = (array.ctypes.data for array in arrays)
    call.held.append(arrays)
    call.held_bytes += _size_of(arrays)
    call.bind('tables', np.append(vars(call)['tables'], np.frombuffer(table, Table)))
    call.table_count += 1
    return DONE


def _keep_table(kind: tuple[float, ...], arrays: tuple[np.ndarray, Real]) -> None:
    """Keep a table for other calls, and drop the oldest ones of too many."""
    global _tables
    kept = _tables | {kind: arrays}
    sizes = np.cumsum([_size_of(one) for one in kept.values()][::-1])[::-1]
    dropped = min(int(np.count_nonzero(sizes > _MAX_TABLE_BYTES)), len(kept) - 1)
    _tables = dict(list(kept.items())[dropped:])


def _size_of(arrays: tuple[np.ndarray, Real]) -> int:
    return sum(array.nbytes for array in arrays)


def _make(
    count: int,
    block: int,
    exact: int,
    orders: int,
    from_middle: float,
    spectrum: Spectrum | None,
) -> tuple[np.ndarray, Real]:
    """Make the integers and numbers of a table of this kind: see `Table` of call.h."""
    window = count, block, bool(exact)
    if orders == MODELS:
        return models_of(*window, spectrum)
    if orders == SLOPES:
        return np.empty(0, np.int64), slopes_of(*window)
    return np.empty(0, np.int64), stencils_of(*window, orders, from_middle, spectrum)
