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

_EFFORTS = 'low', 'normal', 'high'
_ARRAYS = (
    *('time', 'windows', 'left_out', 'angle', 'turns', 'position', 'angle_information'),
    *('position_information', 'noise', 'models', 'stencils', 'results'),
)
# How many are kept: models of one window are some 200 kB.
_MOST_MODELS, _MOST_SLOPES, _MOST_STENCILS = 64, 24, 256


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


class _Lacking(Structure):
    """`StencilTable` of _window.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('count', 'block', 'flags', 'orders')),
        ('at', c_double),
        ('numbers', c_void_p),
    ]


class _Call(Structure):
    """`Call` of _window.h."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('frames', 'bodies', 'instants', 'next', 'orders')),
        *((name, c_longlong) for name in ('effort', 'model_tables', 'stencil_tables')),
        ('window', c_double),
        ('flat', c_double),
        *((name, POINTER(c_char)) for name in _ARRAYS),
        ('lacking', _Lacking),
    ]


_derive = library.kinpole_derive
_derive.argtypes = [POINTER(_Call)]


class _Tables(NamedTuple):
    """What is made, by the window it is for, and its addresses: two arrays of _window.h."""

    models: dict[tuple[int, ...], tuple[np.ndarray, Real]]
    slopes: dict[tuple[int, ...], Real]
    stencils: dict[tuple[int, ...], Real]
    of_models: np.ndarray
    of_stencils: np.ndarray


_tables = _Tables({}, {}, {}, np.empty((0, 6), np.int64), np.empty((0, 6), np.int64))


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
    the deviation of a sample with information of 1, and `window`, s, the longest there is. With low
    `effort` no window is taken for two parts, with high effort there are twice as many processes.
    """
    (instants, bodies), (frames,), orders = noise.shape, poses.time.shape, order + 1
    shapes = [array.shape for array in (*poses[1:], *windows, left_out)]
    if shapes != [(frames, bodies)] * 5 + [(instants,)] * 3 + [(instants, bodies)] or order > 4:
        raise ValueError(f'shapes do not fit to {frames} frames and noise {noise.shape}: {shapes}')
    results = np.empty((3 * orders + 2 * orders**2 + 2, instants, bodies))
    call = _Call(
        *(frames, bodies, instants, 0, orders, _EFFORTS.index(effort), 0, 0, window, FLAT),
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
        tables = _tables
        call.model_tables, call.stencil_tables = len(tables.of_models), len(tables.of_stencils)
        call.models = pass_array(tables.of_models, np.int64)
        call.stencils = pass_array(tables.of_stencils, np.int64)
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


def _make(lacking: _Lacking) -> None:
    """Make the models, their slopes or the stencils that the library lacks."""
    global _tables
    models, slopes, stencils = _tables.models.copy(), _tables.slopes.copy(), _tables.stencils.copy()
    key = lacking.count, lacking.block, lacking.flags
    window = lacking.count, lacking.block, bool(lacking.flags & 1), bool(lacking.flags & 2)
    if lacking.orders > 0:
        # All columns are integers: of the instant the bits.
        bits = int(np.float64(lacking.at).view(np.int64))
        instant = (*key, lacking.orders, bits)
        stencils[instant] = stencils_of(*window, lacking.orders, lacking.at)
    elif lacking.orders < 0:
        slopes[key] = slopes_of(*window)
    else:
        models[key] = models_of(*window)
    kept: Any
    for kept, most in ((models, _MOST_MODELS), (slopes, _MOST_SLOPES), (stencils, _MOST_STENCILS)):
        while len(kept) > most:
            del kept[next(iter(kept))]
    of_models = [
        (*one, *(a.ctypes.data for a in arrays), slopes[one].ctypes.data if one in slopes else 0)
        for one, arrays in models.items()
    ]
    of_stencils = [(*one, numbers.ctypes.data) for one, numbers in stencils.items()]
    tables = (np.array(rows, np.int64).reshape(-1, 6) for rows in (of_models, of_stencils))
    _tables = _Tables(models, slopes, stencils, *tables)
