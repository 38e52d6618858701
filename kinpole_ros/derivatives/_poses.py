"""
From poses at stamps to derivatives at instants: the arguments of the compiled library.

Nothing is remembered but the models of windows, which take time to make.
"""

from ctypes import POINTER, Structure, byref, c_char, c_double, c_longlong, c_void_p
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kinpole_ros.compiled import library, pass_array
from kinpole_ros.derivatives._models import FLAT, models_of, slopes_of, stencils_of
from kinpole_ros.planar._plane import Complex, Real

_ARRAYS = (
    *('time', 'windows', 'left_out', 'angle', 'turns', 'position', 'angle_information'),
    *('position_information', 'noise', 'tables', 'results'),
)
# What is made for windows, the oldest of which is forgotten: 100 kB to 3 MB for each kind of them.
_MOST_BYTES = 64_000_000


class Poses(NamedTuple):
    """
    Poses of B bodies in N frames at `time` (N,), ns.

    `angle` (N, B), rad, is that beyond so many whole `turns` (N, B): separate, since their sum
    would be rounded by how many turns it is counted from. `position` (N, B) is complex, m.
    `angle_information` and `position_information` (N, B) are inverse variances of angles and of
    each coordinate, in units of the noise; 0 where a body is not known.
    """

    time: np.ndarray
    angle: Real
    turns: Real
    position: Complex
    angle_information: Real
    position_information: Real


class Windows(NamedTuple):
    """Frames (T,) that are instants, and the oldest and newest frames of their windows."""

    now: np.ndarray
    oldest: np.ndarray
    newest: np.ndarray

    def part(self, which: slice) -> 'Windows':
        return Windows(self.now[which], self.oldest[which], self.newest[which])


class Derivatives(NamedTuple):
    """
    Derivatives (K, T, B) of poses of B bodies at T instants, K orders; NaN where too few are known.

    With covariances (K, K, T, B), of one coordinate. `span` (T, B) is how long the window is, s,
    and `freedom` (T, B) how many parameters the angle's motion has in it, 2 if it is steady.
    """

    position: Complex
    angle: Real
    position_covariance: Real
    angle_covariance: Real
    span: Real
    freedom: Real


class _Table(Structure):
    """`Table` of _call.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('count', 'block', 'exact', 'orders')),
        ('at', c_double),
        *((name, c_void_p) for name in ('integers', 'numbers')),
    ]


class Call(Structure):
    """`Call` of _call.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('frames', 'bodies', 'instants', 'next', 'orders')),
        ('table_count', c_longlong),
        ('window', c_double),
        ('flat', c_double),
        *((name, POINTER(c_char)) for name in _ARRAYS),
        ('lacking', _Table),
    ]


_derive = library.kinpole_derive
_derive.argtypes = [POINTER(Call)]


class _Tables(NamedTuple):
    """Integers and numbers of `Table` of _call.h, and all tables as the library takes them."""

    arrays: tuple[tuple[np.ndarray, Real], ...]
    tables: np.ndarray


# It is never changed, but replaced: another thread may be using it.
_tables = _Tables((), np.empty((0, 7), np.int64))


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

    `left_out` (T, B) is how many of the newest frames of each window do not count, `noise` (T, B)
    the deviation of a sample with information of 1, and `window`, s, the longest there is.
    """
    (instants, bodies), (frames,), orders = noise.shape, poses.time.shape, order + 1
    shapes = [array.shape for array in (*poses[1:], *windows, left_out)]
    if shapes != [(frames, bodies)] * 5 + [(instants,)] * 3 + [(instants, bodies)] or order > 4:
        raise ValueError(f'shapes do not fit to {frames} frames and noise {noise.shape}: {shapes}')
    results = np.empty((3 * orders + 2 * orders**2 + 2, instants, bodies))
    call = new_call(window, order)
    call.frames, call.bodies, call.instants = frames, bodies, instants
    call.time = pass_array(poses.time, np.int64)
    call.windows = pass_array(np.array(windows), np.int64)
    call.left_out = pass_array(left_out, np.int64)
    call.angle, call.turns = pass_array(poses.angle), pass_array(poses.turns)
    call.position = pass_array(poses.position, complex)
    call.angle_information = pass_array(poses.angle_information)
    call.position_information = pass_array(poses.position_information)
    call.noise, call.results = pass_array(noise), pass_array(results)
    tables = pass_tables(call)
    while code := _derive(byref(call)):
        tables = go_on(call, code)
    del tables
    first, second, square = 2 * orders, 3 * orders, (orders, orders, instants, bodies)
    third = second + orders * orders
    position = results[:first].reshape(orders, instants, bodies, 2).view(complex)[..., 0]
    of_position = results[second:third].reshape(square)
    of_angle = results[third:-2].reshape(square)
    return Derivatives(
        position, results[first:second], of_position, of_angle, results[-2], results[-1]
    )


def new_call(window: float, order: int) -> Call:
    """Begin the arguments of the library."""
    return Call(orders=order + 1, window=window, flat=FLAT)


def pass_tables(call: Call) -> _Tables:
    """Pass all tables that there are; they are to be held while the library is called."""
    tables = _tables
    call.table_count, call.tables = len(tables.tables), pass_array(tables.tables, np.int64)
    return tables


def go_on(call: Call, code: int) -> _Tables:
    """
    Make what the library lacks for a kind of window, and pass it; the tables are to be held.

    Raises what the return value of the library says.
    """
    global _tables
    if code < 0:
        raise MemoryError if code < -1 else IndexError('windows lie beyond the frames')
    lacking = call.lacking
    window = lacking.count, lacking.block, bool(lacking.exact)
    none = np.empty(0, np.int64)
    if lacking.orders > 0:
        made = none, stencils_of(*window, lacking.orders, lacking.at)
    else:
        made = models_of(*window) if lacking.orders == 0 else (none, slopes_of(*window))
    lacking.integers, lacking.numbers = (array.ctypes.data for array in made)
    arrays = (*_tables.arrays, made)
    tables = np.concatenate((_tables.tables, np.frombuffer(bytes(lacking), np.int64)[None]))
    sizes = np.cumsum([sum(array.nbytes for array in one) for one in arrays][::-1])[::-1]
    kept = max(int(np.count_nonzero(sizes <= _MOST_BYTES)), 1)
    _tables = _Tables(arrays[-kept:], tables[-kept:].copy())
    return pass_tables(call)
