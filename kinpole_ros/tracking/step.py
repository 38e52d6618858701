"""The usual frame, compiled: _follow.c works on the arrays of the history and the bodies."""

from ctypes import POINTER, Structure, byref, c_double, c_longlong, c_void_p
from typing import Any, ClassVar

import numpy as np

from kinpole_ros.compiled import address_of, library
from kinpole_ros.derivatives import Call, go_on, new_call, pass_tables
from kinpole_ros.tracking.bodies import UNSTEADY, Bodies
from kinpole_ros.tracking.center import Pins
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.results import NOISE_UNKNOWN, TOO_NOISY, Results
from kinpole_ros.tracking.thresholds import N_SIGMA

# A pose is wrong beyond this many standard deviations of what poses are off the cubic through their
# neighbors; the newest, which no pose follows yet, beyond three times as many off every polynomial
# through those before.
FAR, NEWEST_FAR = 7.0, 3.0
# A pose is not wrong within this share of the diameter, or this angle, rad.
NEAR = 0.01
# Intervals after which a frame does not go on from the one before.
GAP = 2.5
# What is unusual of a body in a frame, and why the loop over the frames ends: see _frames.h and
# _follow.c.
ODD, NAME_DOUBTFUL = 1, 2
DONE, UNUSUAL, SEEN_AGAIN, DEFORMED, FULL = 0, 2, 3, 4, 5

_SCALARS = (
    *('bodies', 'markers', 'first', 'end', 'due', 'frame', 'frames', 'until_update'),
    *('hidden_is_unusual', 'window', 'samples', 'posed'),
)
_REALS = 'lag', 'interval', 'far', 'newest_far', 'near', 'gap', 'sure'
_COLUMNS = (
    *('stamp', 'time', 'count', 'goes_on', 'used', 'angle', 'turns', 'information'),
    *('height', 'heights', 'extra_turn', 'position', 'residual', 'markers'),
)
_LEARNED = (
    *('shape', 'hub', 'middle', 'pin', 'pin_arm', 'known_shape', 'weights', 'largest', 'doubtful'),
    *('spread', 'loosest', 'last_angle', 'jump_scale', 'size', 'error', 'scale', 'noise'),
    *('freedom', 'pin_variance', 'turned', 'pin_since', 'unusable'),
)
_COUNTED = 'unusual', 'wrong', 'newest', 'seen_last'
_CAME = 'new_stamp', 'new_time', 'new_count', 'points', 'point_heights'


class _Frames(Structure):
    """`Frames` of _frames.h; columns that have the names of other fields are apart there."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in _SCALARS),
        *((name, c_double) for name in _REALS),
        *(('marker' if name == 'markers' else name, c_void_p) for name in _COLUMNS),
        *((name, c_void_p) for name in (*_LEARNED, *_COUNTED, *_CAME)),
    ]


_fit_frame = library.kinpole_fit_frame
_fit_frame.argtypes = [POINTER(_Frames), c_void_p, c_longlong, c_void_p]
_follow_paths = library.kinpole_follow_paths
_follow_paths.argtypes = [POINTER(_Frames), c_void_p, c_void_p]
_follow = library.kinpole_follow
_follow.argtypes = [POINTER(_Frames), POINTER(Call), c_void_p]


class Step:
    """
    Takes frames into a history as long as they are usual, and computes what falls due.

    `fields` are those of `Frames` of _frames.h. `unusual` (B,) says what is unusual of each body in
    the last frame, `wrong` (B,) counts poses that left the path of their body, `newest` (B,) the
    newest that may have, and `seen_last` (B,) is the stamp each was last seen at, -1 for none.
    """

    def __init__(
        self, settings: Settings, bodies: Bodies, pins: Pins, history: History, posed: bool
    ) -> None:
        self._settings, self._pins, self._posed = settings, pins, posed
        self.unusual = np.zeros(bodies.count, np.uint8)
        self.wrong, self.newest = np.zeros((2, bodies.count), np.int64)
        self.seen_last = np.full(bodies.count, -1, np.int64)
        self.fields = _Frames(
            window=round(settings.window * 1e9),
            lag=settings.lag * 1e9,
            posed=posed,
            far=FAR,
            newest_far=NEWEST_FAR,
            near=NEAR,
            gap=GAP,
            sure=N_SIGMA,
        )
        self._frames = byref(self.fields)
        for name in _COUNTED:
            setattr(self.fields, name, address_of(getattr(self, name)))
        self._call = new_call(settings.window, 0)
        self._arrays: dict[str, np.ndarray] = {}
        self._came: tuple[np.ndarray, ...] = ()
        self.bind(bodies, history)

    def bind(self, bodies: Bodies, history: History) -> None:
        """Use these arrays, after an update of the bodies or growth of the history."""
        fields, self._history = self.fields, history
        fields.bodies, fields.markers = bodies.shape.shape
        hub, observable = bodies.hub, bodies.noise**2 < UNSTEADY**2 * bodies.spread
        if self._posed:
            # The errors of its position and of the angle are independent, as they are taken to be.
            hub = np.where(hub == 0, bodies.middle, hub)
            observable = bodies.angle_noise < UNSTEADY
        measured = np.isfinite(bodies.noise)
        learned = {
            'hub': hub,
            'pin': self._pins.center,
            'pin_arm': self._pins.arm,
            'pin_variance': self._pins.variance,
            'pin_since': self._pins.since,
            'known_shape': bodies.markers(),
            'noise': np.where(bodies.noise > 0, bodies.noise, 1.0),
            'turned': bodies.extra_turn,
            'unusable': np.where(measured, np.where(observable, 0, TOO_NOISY), NOISE_UNKNOWN),
        }
        learned['unusable'] = learned['unusable'].astype(np.uint8)
        for name in _LEARNED:
            value = learned[name] if name in learned else getattr(bodies, name)
            array = np.ascontiguousarray(value)
            if name == 'last_angle':
                bodies.last_angle = array
            self._arrays[name] = array
            setattr(fields, name, address_of(array))
        self.bind_history()

    def bind_history(self) -> None:
        """Use the columns of the history, after they have grown."""
        for name in _COLUMNS:
            column = self._history.columns[name]
            setattr(self.fields, 'marker' if name == 'markers' else name, address_of(column))

    def hand_over(self, came: tuple[np.ndarray, ...], hidden_is_unusual: bool) -> None:
        """
        Take frames next.

        `came` are their stamps, times and counts (T,), int64, points in the plane (T, B, n), and
        heights of these. With `hidden_is_unusual` so is a marker not seen.
        """
        self._came = tuple(map(np.ascontiguousarray, came))
        for name, array in zip(_CAME, self._came, strict=True):
            setattr(self.fields, name, address_of(array))
        self.fields.frame, self.fields.frames = 0, len(came[0])
        self.fields.hidden_is_unusual = hidden_is_unusual

    def follow(self, until_update: int, results: Results) -> int:
        """Take frames, up to so many, and compute results; returns why it does not go on."""
        fields, history, call = self.fields, self._history, self._call
        fields.until_update = min(until_update, fields.frames - fields.frame)
        if history.reserve(fields.until_update):
            self.bind_history()
        fields.first, fields.end = history.first, history.end
        call.orders, call.instants = results.orders, 1
        tables, fields_of_results = pass_tables(call), address_of(results.fields)
        while (code := _follow(self._frames, call, fields_of_results)) < DONE or code == 1:
            tables = go_on(call, code)
        del tables
        history.end = fields.end
        return int(code)

    def fit(self, markers: np.ndarray, goes_on: bool) -> int:
        """Fit markers (B, n), complex, into the newest row; returns what is unusual."""
        history = self._history
        self.fields.first, self.fields.end = history.first, history.end
        unusual = address_of(self.unusual)
        return int(_fit_frame(self._frames, address_of(markers), goes_on, unusual))

    def follow_paths(self) -> None:
        """Complete the newest row: whole turns, and poses that it shows to be wrong."""
        _follow_paths(self._frames, address_of(self.wrong), address_of(self.newest))
