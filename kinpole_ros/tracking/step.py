"""The usual frame, compiled: _step.c works on the arrays of the history and the bodies."""

from ctypes import POINTER, Structure, byref, c_double, c_longlong, c_void_p
from typing import Any, ClassVar

import numpy as np

from kinpole_ros.compiled import library
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History

# A pose is wrong beyond this many standard deviations of what poses are off the cubic through their
# neighbors; the newest, which no pose follows yet, beyond three times as many off every polynomial
# through those before.
FAR, NEWEST_FAR = 7.0, 3.0
# A pose is not wrong within this share of the diameter, or this angle, rad.
NEAR = 0.01
# What the compiled functions say of a body.
ODD, NAME_DOUBTFUL = 1, 2

_COLUMNS = 'time', 'angle', 'turns', 'information', 'position', 'residual', 'used'
_LEARNED = (
    'shape',
    'weights',
    'largest',
    'doubtful',
    'spread',
    'loosest',
    'last_angle',
    'jump_scale',
    'size',
)


class _Frames(Structure):
    """`Frames` of _step.c."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('bodies', 'markers', 'first', 'end')),
        *((name, c_void_p) for name in (*_COLUMNS, *_LEARNED)),
        *((name, c_double) for name in ('far', 'newest_far', 'near')),
    ]


_fit_frame = library.kinpole_fit_frame
_fit_frame.argtypes = [POINTER(_Frames), c_void_p, c_longlong, c_void_p]
_follow_paths = library.kinpole_follow_paths
_follow_paths.argtypes = [POINTER(_Frames), c_void_p, c_void_p]


class Step:
    """
    Fits frames into the newest row of a history.

    `unusual` (B,) says what is unusual of each body in the last frame, `wrong` (B,) counts poses
    that left the path of their body, and `doubtful` (B,) the newest that may have.
    """

    def __init__(self, bodies: Bodies, history: History) -> None:
        self.unusual = np.zeros(bodies.count, np.uint8)
        self.wrong, self.doubtful = np.zeros((2, bodies.count), np.int64)
        self._frames = _Frames(far=FAR, newest_far=NEWEST_FAR, near=NEAR)
        self._arguments = byref(self._frames)
        self._unusual, self._wrong, self._doubtful = (
            part.ctypes.data for part in (self.unusual, self.wrong, self.doubtful)
        )
        self._arrays: list[np.ndarray] = []
        self.bind(bodies, history)

    def bind(self, bodies: Bodies, history: History) -> None:
        """Use these arrays, after an update of the bodies or growth of the history."""
        frames, self._history = self._frames, history
        frames.bodies, frames.markers = bodies.shape.shape
        self._arrays = [history.columns[name] for name in _COLUMNS]
        for name in _LEARNED:
            array = np.ascontiguousarray(getattr(bodies, name))
            setattr(bodies, name, array)
            self._arrays.append(array)
        for name, array in zip((*_COLUMNS, *_LEARNED), self._arrays, strict=True):
            setattr(frames, name, array.ctypes.data)

    def fit(self, markers: int, goes_on: bool) -> int:
        """Fit markers (B, n), complex, at an address, into the newest row; what is unusual."""
        frames, history = self._frames, self._history
        frames.first, frames.end = history.first, history.end
        return int(_fit_frame(self._arguments, markers, goes_on, self._unusual))

    def follow(self) -> None:
        """Complete the newest row: whole turns, and poses that it shows to be wrong."""
        _follow_paths(self._arguments, self._wrong, self._doubtful)
