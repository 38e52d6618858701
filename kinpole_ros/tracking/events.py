"""Events of the bodies: instants at which their velocity, acceleration or jerk steps."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import SIZES
from kinpole_ros.derivatives import Event, Samples, find_event
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import median

# Frames after which the poses of those before are sure: see `wrong_before_last` in rejection.c.
FRAMES_BEHIND = 6
# Places are searched a share of the window at a time, when motion has gone on for a window.
_SHARE = 8


class BodyEvent(NamedTuple):
    """
    An event of the body of number `body`: the derivative of this `order` steps.

    stamp, time_sigma : int, ns, and float, s
        When, by the stamps of the frames, and the standard deviation.
    angle_step, angle_step_sigma : float, rad/s^order
        By how much the derivative of the angle steps.
    step, step_covariance : complex, m/s^order, and (2, 2)
        By how much that of the origin of the body's frame steps.
    position, height : complex and float, m
        Where that origin was.
    due : int
        The frame, of those given to the tracker in one call, with which the event was found.
    """

    body: int
    stamp: int
    time_sigma: float
    order: int
    angle_step: float
    angle_step_sigma: float
    step: complex
    step_covariance: np.ndarray
    position: complex
    height: float
    due: int


# ns, before all times.
_ALWAYS = -(2**62)


class EventSearch:
    """
    Finds the events of bodies in their poses, each once, a `window`, ns, after it.

    An event follows from the frames around it alone, so it is the same whether these came one by
    one or many at once.

    Attributes
    ----------
    due : int
        The time, ns, of the newest settled frame before which there is nothing to search.

    """

    def __init__(self, window: int, bodies: int) -> None:
        self._window = window
        self.due = _ALWAYS
        # Where the search goes on, ns; the last event of each body, ns.
        self._next: int | None = None
        self._is_paused = False
        self._last = [-window] * bodies

    @property
    def _share(self) -> int:
        """Length of the parts of time that are searched at once, ns."""
        return self._window // _SHARE

    def pause(self) -> None:
        """Go on only with frames that come after the next call of `search`."""
        self._next, self._is_paused, self.due = None, True, _ALWAYS

    def search(self, history: History, bodies: Bodies, numbers: np.ndarray) -> list[BodyEvent]:
        """
        Search where the frames that have come allow it.

        `numbers` (T,) are those of the newest frames of the history, as `due` of the events counts
        them.
        """
        hub = np.where(np.isfinite(bodies.pin), 0.0, bodies.hub)
        time = history.columns['time'][history.first : history.end]
        if len(time) <= FRAMES_BEHIND:
            return []
        if self._next is None:
            # Shares begin at multiples of their length, wherever the search begins.
            begin = int(time[-1 if self._is_paused else 0]) + self._window
            self._next = -(-begin // self._share) * self._share
            self._last = [self._next - self._window] * len(self._last)
        self.due = self._next + self._window + self._share
        settled = int(time[-1 - FRAMES_BEHIND]) - self._window - self._share
        if self._next > settled:
            return []
        begins = np.arange(self._next, settled + 1, self._share)
        self._next = int(begins[-1]) + self._share
        self.due = self._next + self._window + self._share
        body_events = []
        values, variance = _poses(history, bodies, hub)
        for begin in begins.tolist():
            first, last = np.searchsorted(
                time,
                (
                    begin - SIZES['TIMES_BEFORE'] * self._window - self._share,
                    begin + self._window + self._share,
                ),
            )
            rows = slice(int(first), int(last))
            since = (time[rows] - begin) * 1e-9
            for b in np.flatnonzero(np.isfinite(bodies.noise)).tolist():
                samples = Samples(
                    since, values[rows, b], variance[rows, b], 0.0, self._share * 1e-9
                )
                event = find_event(samples, self._window * 1e-9)
                at = begin if event is None else begin + round(event.time * 1e9)
                if event is None or at - self._last[b] < self._share // 2:
                    continue
                self._last[b] = at
                # The frame that showed it: the sixth after a window after the places.
                ready = begin + self._window + self._share
                with_frame = int(np.searchsorted(time, ready)) + FRAMES_BEHIND
                number = int(numbers[max(len(numbers) - (len(time) - with_frame), 0)])
                body_events.append(_body_event(event, b, at, rows, history, hub[b], number))
        return body_events


def _poses(history: History, bodies: Bodies, hub: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and hubs (N, B, 3), and their variances (N, B, 2), infinite for those not known."""
    angle, turns = history['angle'], history['turns']
    position = history['position'] + hub * np.exp(1j * angle)
    values = np.stack((angle + 2 * np.pi * turns, position.real, position.imag), axis=-1)
    information = np.moveaxis(history['information'] * bodies.fitting.information_factor, 1, -1)
    turned, placed = information[..., 0], information[..., 1]
    with np.errstate(divide='ignore', invalid='ignore'):
        # Farther from the middle of the markers the error of the angle tells more.
        near = np.maximum(1 / placed - np.abs(bodies.fitting.middle) ** 2 / turned, 0.0)
        far = near + np.abs(hub - bodies.fitting.middle) ** 2 / turned
        far = np.where(hub == 0, 1 / placed, far)
        variance = np.stack((1 / turned, far), axis=-1) * bodies.noise[:, None] ** 2
    is_known = (information > 0).all(axis=-1) & np.isfinite(values).all(axis=-1)
    return values, np.where(is_known[..., None], variance, np.inf)


def _body_event(
    event: Event, body: int, at: int, rows: slice, history: History, hub: complex, due: int
) -> BodyEvent:
    """An event of the hub of a body as one of the origin of its frame."""
    time, angle = history['time'][rows], history['angle'][rows, body]
    position, height = history['position'][rows, body], history['height'][rows, body]
    seen = np.flatnonzero(np.isfinite(angle))
    near = seen[np.abs(time[seen] - at).argmin()]
    # The origin lies at -arm from the hub.
    arm = hub * np.exp(1j * float(angle[near]))
    turned, x, y = event.step.tolist()
    along = np.array((arm.imag, -arm.real))
    covariance = np.diag(event.step_sigma[1:] ** 2)
    covariance += event.step_sigma[0] ** 2 * np.outer(along, along)
    late = int(median(history['stamp'][rows] - time))
    return BodyEvent(
        body=body,
        stamp=at + late,
        time_sigma=event.time_sigma,
        order=event.order,
        angle_step=turned,
        angle_step_sigma=float(event.step_sigma[0]),
        step=complex(x, y) - 1j * turned * arm,
        step_covariance=covariance,
        position=complex(position[near]),
        height=float(height[near]),
        due=due,
    )
