"""
Call the compiled kernel: from poses at stamps to derivatives at instants.

The tables of window kinds are kept between calls, and in files between processes.
"""

from ctypes import byref
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import SIZES, Call, DerivativeArrays, Table, library
from kinpole_ros.derivatives._cached_tables import cached_table
from kinpole_ros.derivatives._models import FLAT, models_of, slopes_of, stencils_of
from kinpole_ros.planar._plane import Complex, Real

# Memory of all tables, of which the oldest are dropped; a kind of window has 100 kB to 3 MB.
_MAX_TABLE_BYTES = 64_000_000


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

    def part(self, which: slice) -> 'Windows':
        return Windows(self.now[which], self.oldest[which], self.newest[which])


class Derivatives(NamedTuple):
    """
    Derivatives (K, T, B) of order 0 to K - 1, of B bodies at T instants; NaN with too few poses.

    Units are rad, m and s. Covariances (K, K, T, B) are between the orders, of the angle and of one
    coordinate. `span` (T, B) is the length of the window, s, and `freedom` (T, B) the effective
    number of parameters of the motion of the angle, 2 if it is steady. The position is that of the
    point `reference` (T, B) of the body, m from the given one in the frame of the body: 0, or the
    hub that the body turns about.
    """

    position: Complex
    angle: Real
    position_covariance: Real
    angle_covariance: Real
    span: Real
    freedom: Real
    reference: Complex


class _Tables(NamedTuple):
    """The `arrays` that tables point to, and the `tables` (n,) with the fields of `Table`."""

    arrays: tuple[tuple[np.ndarray, Real], ...]
    tables: np.ndarray


# Replaced and never changed, because another thread may be using it.
_tables = _Tables((), np.empty(0, Table))


def derive_poses(
    poses: Poses,
    windows: Windows,
    left_out: np.ndarray,
    noise: Real,
    window: float,
    order: int,
) -> Derivatives:
    """
    Differentiate poses at the instants of `windows`, up to `order`.

    `left_out` (T, B) is the number of newest frames of each window that are ignored, `noise` (T, B)
    the standard deviation of a pose with information of 1, and `window`, s, the length of a full
    window.

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
    about = {'windows': np.array(windows), 'left_out': left_out, 'noise': noise}
    for name, array in (poses._asdict() | about).items():
        call.bind(name, np.ascontiguousarray(array, call.elements[name]))
    derivatives = Derivatives(**DerivativeArrays.new_arrays(K=orders, T=instants, B=bodies))
    for name, array in derivatives._asdict().items():
        call.derivatives.bind(name, array)
    tables = pass_tables(call)
    while code := library.kinpole_derive(byref(call)):
        tables = go_on(call, code)
    del tables
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
    """Return arguments of the library without arrays."""
    return Call(orders=order + 1, window=window, flat=FLAT)


def pass_tables(call: Call) -> _Tables:
    """Pass all tables, and return them; the caller holds them during the call of the library."""
    tables = _tables
    if vars(call).get('tables') is not tables.tables:
        call.table_count = len(tables.tables)
        call.bind('tables', tables.tables)
    return tables


def go_on(call: Call, code: int) -> _Tables:
    """
    Make the table that the library lacks, and pass all tables, as `pass_tables`.

    Raises an exception if the return value `code` of the library is an error.
    """
    global _tables
    if code < 0:
        raise MemoryError if code < -1 else IndexError('windows lie beyond the frames')
    lacking = call.lacking
    window = lacking.count, lacking.block, bool(lacking.exact)
    made = cached_table(
        (*window, lacking.orders, lacking.at), lambda: _make(window, lacking.orders, lacking.at)
    )
    lacking.integers, lacking.numbers = (array.ctypes.data for array in made)
    arrays = (*_tables.arrays, made)
    tables = np.concatenate((_tables.tables, np.frombuffer(lacking, Table)))
    sizes = np.cumsum([sum(array.nbytes for array in one) for one in arrays][::-1])[::-1]
    number = max(int(np.count_nonzero(sizes <= _MAX_TABLE_BYTES)), 1)
    _tables = _Tables(arrays[-number:], tables[-number:].copy())
    return pass_tables(call)


def _make(window: tuple[int, int, bool], orders: int, at: float) -> tuple[np.ndarray, Real]:
    """Make stencils for these `orders`, or models if it is 0, or slopes if it is negative."""
    if orders == 0:
        return models_of(*window)
    numbers = stencils_of(*window, orders, at) if orders > 0 else slopes_of(*window)
    return np.empty(0, np.int64), numbers
