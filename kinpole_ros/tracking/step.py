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
from kinpole_ros.derivatives import finish_call, new_call, set_spectra
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.estimate import Results, new_results
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.rejection import FAR, GAP, NEAR, NEWEST_FACTOR
from kinpole_ros.tracking.thresholds import N_SIGMA

# Why the compiled loop ends: see codes.h.
UNUSUAL = codes_of('CALL_ENDS')['UNUSUAL']

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
        'last_angle': np.full(bodies, np.nan),
        'sure_tilt': np.full(bodies, complex(np.nan, np.nan)),
    }


class Step:
    """
    Takes frames into a history, and computes the results that are due.

    Attributes
    ----------
    limits, columns, known, incoming : FrameLimits, HistoryColumns, BodyArrays, NewFrames
        The parts of `Frames` that the library works on: they hold the arrays.
    tracks : dict of str to ndarray
        What only the library writes: see `new_tracks`.

    """

    def __init__(self, settings: Settings, tracks: dict[str, np.ndarray]) -> None:
        limits = FrameLimits(
            window_ns=round(settings.window * 1e9),
            lag_ns=settings.lag * 1e9,
            far=FAR,
            newest_factor=NEWEST_FACTOR,
            near=NEAR,
            gap=GAP,
            n_sigma=N_SIGMA,
        )
        fields = Frames(limits)
        self._frames = byref(fields)
        self.limits, self.columns = fields.limits, fields.history
        self.known, self.incoming = fields.known, fields.incoming
        self.tracks, passed = tracks, fields.tracks
        for name in BodyTracks.elements:
            passed.bind(name, tracks[name])
        self._call = new_call(settings.window, 0)
        # Keeps the arrays of new frames alive.
        self._new_frames: list[np.ndarray | None] = []

    def bind(self, bodies: Bodies, history: History) -> None:
        """Use these arrays, after an update of the bodies or growth of the history."""
        known, self._history = self.known, history
        # Tables for windows that came since the last update may take too much memory.
        finish_call(self._call, 0)
        known.bodies, known.width = bodies.shape.shape
        fields = bodies.placement._asdict() | bodies.fitting._asdict() | vars(bodies)
        fields |= {'reference': bodies.reference, 'spectrum': bodies.spectrum}
        set_spectra(self._call, bodies.spectra)
        for name in BodyArrays.elements:
            known.bind(name, np.ascontiguousarray(fields[name]))
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
        code = library.kinpole_follow(self._frames, call, result_fields)
        if code < 0:
            finish_call(call, code)
        history.end = columns.end
        return bool(code == UNUSUAL)

    def complete_results(self, is_complete: bool) -> None:
        """Whether each frame gets a result, the first ones once the window is full."""
        self.limits.complete = is_complete

    def follow_to_end(self, results: Results) -> None:
        """Compute the results of all frames that are left from the newest window."""
        lag, self.limits.lag_ns, self.limits.complete = self.limits.lag_ns, 0.0, 0
        self.follow(0, results)
        self.limits.lag_ns = lag

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
        self._new_frames.append(markers)
        self.incoming.corrected = addressof(pass_new_array(markers))
