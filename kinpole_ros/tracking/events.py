"""Events of the bodies: instants at which their velocity or acceleration steps."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import APART, AROUND, SHARE, Event, Poses, find_events
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import median

# Frames after which the poses of those before are sure: see `wrong_before_last` in rejection.c.
FRAMES_BEHIND = 6
# Frames on either side of an event by which stamps are late in the median.
_AROUND = 30


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
    Finds the events of bodies in their poses, each once, 1.25 times a `window`, ns, after it.

    Time is searched a share of the window at a time. An event follows from the frames around it
    alone, so it is the same whether these came one by one or many at once.

    Attributes
    ----------
    due : int
        The time, ns, of the newest settled frame before which there is nothing to do.

    """

    def __init__(self, window: int, bodies: int) -> None:
        self._window = window
        self._share = round(SHARE * window)
        # What is needed before and after a share, and how long after it an event is reported.
        self._around = round(AROUND * window)
        self._after = self._share + self._around
        self.due = _ALWAYS
        # Where the search goes on, ns; the last event of each body, ns; those not yet reported.
        self._next: int | None = None
        self._is_paused = False
        self._last = [_ALWAYS] * bodies
        self._found: list[tuple[Event, complex]] = []

    def pause(self) -> None:
        """Go on only with frames that come after the next call of `search`."""
        self._next, self._is_paused, self.due, self._found = None, True, _ALWAYS, []

    def search(self, history: History, bodies: Bodies, numbers: np.ndarray) -> list[BodyEvent]:
        """
        Search where the frames that have come allow it, and return the events that are due.

        `numbers` (T,) are those of the newest frames of the history, as `due` of the events counts
        them.
        """
        time = history['time']
        if len(time) <= FRAMES_BEHIND:
            return []
        settled = int(time[-1 - FRAMES_BEHIND])
        if self._next is None:
            # Shares begin at multiples of their length, wherever the search begins.
            self._next = -(-int(time[-1 if self._is_paused else 0]) // self._share) * self._share
        begins = np.arange(self._next, settled - self._after + 1, self._share)
        if begins.size:
            self._next = int(begins[-1]) + self._share
            self._find(history, bodies, begins)
        due = [found for found in self._found if found[0].time + self._after <= settled]
        self._found = self._found[len(due) :]
        self.due = min([self._next, *(found[0].time for found in self._found)]) + self._after
        body_events = []
        for event, hub in due:
            # The frame that showed it: the sixth after all that were needed.
            with_frame = int(np.searchsorted(time, event.time + self._after)) + FRAMES_BEHIND
            number = int(numbers[max(len(numbers) - (len(time) - with_frame), 0)])
            body_events.append(_body_event(event, history, hub, number))
        return body_events

    def _find(self, history: History, bodies: Bodies, begins: np.ndarray) -> None:
        """Find the events of shares, with the hub of the body at this time."""
        known = np.flatnonzero(np.isfinite(bodies.noise))
        if not known.size:
            return
        hub = np.where(np.isfinite(bodies.pin), 0.0, bodies.hub)
        ends = begins[0] - self._around, begins[-1] + self._after + 1
        rows = slice(*np.searchsorted(history['time'], ends).tolist())
        poses = _poses(history, bodies, hub, rows, known)
        for event in find_events(poses, bodies.noise[known], self._window * 1e-9, begins):
            b = int(known[event.body])
            # Shares that meet may both show an event at their border.
            if event.time - self._last[b] >= APART * self._window:
                self._last[b] = event.time
                self._found.append((event._replace(body=b), complex(hub[b])))
        self._found.sort(key=lambda found: found[0].time)


def _poses(
    history: History, bodies: Bodies, hub: np.ndarray, rows: slice, known: np.ndarray
) -> Poses:
    """Return the poses of the hubs of the bodies `known`, of some rows of the history."""
    hub, middle = hub[known], bodies.fitting.middle[known]
    angle, turns = history['angle'][rows, known], history['turns'][rows, known]
    position = history['position'][rows, known] + hub * np.exp(1j * angle)
    information = history['information'][rows][..., known]
    turned, placed = np.moveaxis(information * bodies.fitting.information_factor[:, known], 1, 0)
    with np.errstate(divide='ignore', invalid='ignore'):
        # Farther from the middle of the markers the error of the angle tells more.
        near = np.maximum(1 / placed - np.abs(middle) ** 2 / turned, 0.0)
        far = near + np.abs(hub - middle) ** 2 / turned
        at_hub = np.where(hub == 0, placed, 1 / far)
    is_known = (turned > 0) & (placed > 0) & np.isfinite(position) & np.isfinite(at_hub)
    turned, at_hub = np.where(is_known, turned, 0.0), np.where(is_known, at_hub, 0.0)
    return Poses(history['time'][rows], angle, turns, position, turned, at_hub)


def _body_event(event: Event, history: History, hub: complex, due: int) -> BodyEvent:
    """An event of the hub of a body as one of the origin of its frame."""
    body = event.body
    time, angle = history['time'], history['angle'][:, body]
    seen = np.flatnonzero(np.isfinite(angle))
    near = seen[np.abs(time[seen] - event.time).argmin()]
    # The origin lies at -arm from the hub.
    arm = hub * np.exp(1j * float(angle[near]))
    turned, x, y = event.step.tolist()
    along = np.array((arm.imag, -arm.real))
    covariance = np.diag(event.step_sigma[1:] ** 2)
    covariance += event.step_sigma[0] ** 2 * np.outer(along, along)
    around = slice(max(near - _AROUND, 0), near + _AROUND + 1)
    late = int(median((history['stamp'] - time)[around]))
    return BodyEvent(
        body=body,
        stamp=event.time + late,
        time_sigma=event.time_sigma,
        order=event.order,
        angle_step=turned,
        angle_step_sigma=float(event.step_sigma[0]),
        step=complex(x, y) - 1j * turned * arm,
        step_covariance=covariance,
        position=complex(history['position'][near, body]),
        height=float(history['height'][near, body]),
        due=due,
    )
