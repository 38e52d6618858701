"""Usual frames, taken by compiled code on the arrays of the history and the bodies."""

from ctypes import addressof, byref

import numpy as np

from kinpole_ros.core.bindings import (
    BodyArrays,
    BodyTracks,
    FrameLimits,
    Frames,
    NewFrames,
    codes_of,
    library,
    pass_new_array,
)
from kinpole_ros.derivatives import go_on, new_call, pass_tables
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.center import Pins
from kinpole_ros.tracking.estimate import Results, new_results
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.rejection import FAR, GAP, NEAR, NEWEST_FACTOR, reasons_of
from kinpole_ros.tracking.thresholds import N_SIGMA

# Why the compiled loop ends: see call.h and frames.h.
_ENDS = codes_of('CALL_ENDS') | codes_of('LOOP_ENDS')
DONE, TABLE_LACKING, UNUSUAL = _ENDS['DONE'], _ENDS['LACKING'], _ENDS['UNUSUAL']

# Arrays of new frames, but for `corrected`, which is one frame.
_NEW_FRAMES = list(NewFrames.elements.items())[:-1]


def new_tracks(bodies: int, outages: np.ndarray, wrong: np.ndarray) -> dict[str, np.ndarray]:
    """
    Return what only the library writes of each body, before the first frame.

    Parameters
    ----------
    bodies : int
        Their number B.
    outages : (B + 1,) Gaps
        Gaps without each body, and last without any frame: see frames.h.
    wrong : (B,) int64
        Number of poses that left the path of their body.

    Returns
    -------
    dict of str to ndarray
        The fields of `BodyTracks` of frames.h, by their names.

    """
    return BodyTracks.new_arrays(B=bodies) | {
        'wrong': wrong,
        'outages': outages,
        'seen_last': np.full(bodies, -1, np.int64),
        'sure_angle': np.full(bodies, np.nan),
        'sure_tilt': np.full(bodies, complex(np.nan, np.nan)),
    }


class Step:
    """
    Takes frames into a history, and computes the results that are due.

    Attributes
    ----------
    columns, known, incoming : HistoryColumns, BodyArrays, NewFrames
        The parts of `Frames` that the library works on: they hold the arrays.
    tracks : dict of str to ndarray
        What only the library writes: see `new_tracks`.

    """

    def __init__(self, settings: Settings, posed: bool, tracks: dict[str, np.ndarray]) -> None:
        limits = FrameLimits(
            window_ns=round(settings.window * 1e9),
            lag_ns=settings.lag * 1e9,
            posed=posed,
            far=FAR,
            newest_factor=NEWEST_FACTOR,
            near=NEAR,
            gap=GAP,
            n_sigma=N_SIGMA,
        )
        fields = Frames(limits)
        self._frames = byref(fields)
        self.columns, self.known, self.incoming = fields.history, fields.known, fields.incoming
        self.tracks, self._posed, self._tracks = tracks, posed, fields.tracks
        for name in BodyTracks.elements:
            self._tracks.bind(name, tracks[name])
        self._call = new_call(settings.window, 0)
        # Keeps the tables alive while the library uses them.
        self._tables = pass_tables(self._call)
        self._new_frames: list[np.ndarray | None] = []
        self._corrected: np.ndarray | None = None

    def bind(self, bodies: Bodies, pins: Pins, history: History) -> None:
        """Use these arrays, after an update of the bodies or growth of the history."""
        known, self._history = self.known, history
        known.bodies, known.width = bodies.shape.shape
        hub, angle_noise = bodies.hub, None
        if self._posed:
            # The derivatives assume independent errors of position and angle: so at the middle.
            hub, angle_noise = np.where(hub == 0, bodies.fitting.middle, hub), bodies.angle_noise
        learned = {
            'hub': hub,
            'pin': pins.center,
            'pin_arm': pins.arm,
            'pin_variance': pins.variance,
            'pin_since': pins.since,
            'noise': np.where(bodies.noise > 0, bodies.noise, 1.0),
            'reason': reasons_of(bodies.noise, bodies.fitting.spread, angle_noise),
        }
        for name in BodyArrays.elements:
            owner = bodies.fitting if hasattr(bodies.fitting, name) else bodies
            value = learned[name] if name in learned else getattr(owner, name)
            array = np.ascontiguousarray(value)
            if name == 'last_angle':
                # The compiled code updates the last angles.
                bodies.last_angle = array
            known.bind(name, array)
        self.bind_history()

    def bind_history(self) -> None:
        """Use the columns of the history, after they have grown."""
        for name, column in self._history.columns.items():
            self.columns.bind(name, column)

    def pass_frames(
        self, number: int, new_frames: tuple[np.ndarray | None, ...], hidden_is_unusual: bool
    ) -> None:
        """
        Pass the next frames to the compiled code.

        Parameters
        ----------
        number : int
            How many there are.
        new_frames : tuple of ndarray or None
            Stamps, times and counts (T,), int64, points in the plane (T, B, n), complex, their
            heights, and the tilts (T, B) of poses, None for markers.
        hidden_is_unusual : bool
            Whether a frame with a hidden marker is unusual.

        """
        self._new_frames, incoming = [], self.incoming
        for (name, element), array in zip(_NEW_FRAMES, new_frames, strict=True):
            address = None
            if array is not None:
                # As `bind`, without a call of Python for each array of a frame.
                array = np.ascontiguousarray(array, element)
                array = array if array.flags.writeable else array.copy()
                address = addressof(pass_new_array(array))
            # Keeps the arrays alive while the library uses them.
            self._new_frames.append(array)
            setattr(incoming, name, address)
        incoming.frame, incoming.frames = 0, number
        incoming.hidden_is_unusual = hidden_is_unusual

    def reserve_results(self, frames: int, order: int | None) -> Results:
        """Return memory for the results that so many frames can complete; none without an order."""
        if order is None:
            return new_results(0, 1, 0, 0)
        waiting = self._history.end - self._history.first - self.columns.next_result
        return new_results(frames + waiting, order + 1, self.known.bodies, self.known.width)

    def follow(self, until_update: int, results: Results) -> bool:
        """Take usual frames, at most so many; return whether the next frame is unusual."""
        columns, incoming, history, call = self.columns, self.incoming, self._history, self._call
        incoming.until_update = min(until_update, incoming.frames - incoming.frame)
        if history.end + incoming.until_update > history.capacity:
            history.reserve(incoming.until_update)
            self.bind_history()
        columns.first, columns.end = history.first, history.end
        call.orders, call.instants = results.orders, 1
        result_fields = pass_new_array(results.fields)
        while (
            code := library.kinpole_follow(self._frames, call, result_fields)
        ) <= TABLE_LACKING and code != DONE:
            self._tables = go_on(call, code)
        history.end = columns.end
        assert code in (DONE, UNUSUAL), code
        return bool(code == UNUSUAL)

    def try_next(self, markers: np.ndarray) -> int:
        """Fit markers (B, n), complex, of the next frame; return what is unusual."""
        history = self._history
        if history.end + 1 > history.capacity:
            history.reserve(1)
            self.bind_history()
        self.columns.first, self.columns.end = history.first, history.end
        return int(library.kinpole_try_frame(self._frames, pass_new_array(markers)))

    def correct_next(self, markers: np.ndarray) -> None:
        """Fit the next frame to these markers (B, n), complex, whatever is unusual of it."""
        # As in `pass_frames`; the struct is to keep the array alive.
        self._corrected = markers
        self.incoming.corrected = addressof(pass_new_array(markers))
