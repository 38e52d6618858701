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
    """`Table` of _window.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('count', 'block', 'exact', 'orders')),
        ('at', c_double),
        *((name, c_void_p) for name in ('integers', 'numbers')),
    ]


class _Call(Structure):
    """`Call` of _window.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('frames', 'bodies', 'instants', 'next', 'orders')),
        ('table_count', c_longlong),
        ('window', c_double),
        ('flat', c_double),
        *((name, POINTER(c_char)) for name in _ARRAYS),
        ('lacking', _Table),
    ]


_derive = library.kinpole_derive
_derive.argtypes = [POINTER(_Call)]


class _Tables(NamedTuple):
    """Integers and numbers of `Table` of _window.h, and all tables as the library takes them."""

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
    effort: str = 'normal',
) -> Derivatives:
    """
    Differentiate poses at the instants of `windows`, up to `order`.

    `left_out` (T, B) is how many of the newest frames of each window do not count, `noise` (T, B)
    the deviation of a sample with information of 1, and `window`, s, the longest there is. `effort`
    makes no difference any more.
    """
    (instants, bodies), (frames,), orders = noise.shape, poses.time.shape, order + 1
    shapes = [array.shape for array in (*poses[1:], *windows, left_out)]
    if shapes != [(frames, bodies)] * 5 + [(instants,)] * 3 + [(instants, bodies)] or order > 4:
        raise ValueError(f'shapes do not fit to {frames} frames and noise {noise.shape}: {shapes}')
    results = np.empty((3 * orders + 2 * orders**2 + 2, instants, bodies))
    call = _Call(
        *(frames, bodies, instants, 0, orders, 0, window, FLAT),
        pass_array(poses.time, np.int64),
        pass_array(np.array(windows), np.int64),
        pass_array(left_out, np.int64),
        pass_array(poses.angle),
        pass_array(poses.turns),
        pass_array(poses.position, complex),
        pass_array(poses.angle_information),
        pass_array(poses.position_information),
        pass_array(noise),
        results=pass_array(results),
    )
    code = 1
    while code:
        tables = _tables.tables
        call.table_count, call.tables = len(tables), pass_array(tables, np.int64)
        code = _derive(byref(call))
        if code < 0:
            raise MemoryError if code < -1 else IndexError('windows lie beyond the frames')
        if code:
            _make(call.lacking)
    first, second, square = 2 * orders, 3 * orders, (orders, orders, instants, bodies)
    third = second + orders * orders
    position = results[:first].reshape(orders, instants, bodies, 2).view(complex)[..., 0]
    of_position = results[second:third].reshape(square)
    of_angle = results[third:-2].reshape(square)
    return Derivatives(
        position, results[first:second], of_position, of_angle, results[-2], results[-1]
    )


def _make(lacking: _Table) -> None:
    """Make what the library lacks for a kind of window."""
    global _tables
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
