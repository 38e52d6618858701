"""
Instants at which a derivative of a pose steps, as an impact or a drive makes them.

The compiled library lists the events of a window: see window_events.h. A process of one amplitude
may explain the motion of one window badly, so an event is what windows of several lengths show.
"""

from collections.abc import Iterator
from ctypes import byref
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import SIZES, EventArrays, library
from kinpole_ros.derivatives._pose_derivatives import Poses, finish_call, new_call
from kinpole_ros.planar._plane import Real

# Windows have so many lengths, each shorter than the one before by this factor, and the shortest
# this many samples on either side of an event.
_LENGTHS, _RATIO = 6, 2**0.5
_FEWEST = 6
# Log odds of an event in a length that does not show it, though a shorter one does.
_NOT_SHOWN = -5.0
# An event has these log odds in all lengths together, where each counts for so many at most,
# because its models may be wrong: docs/estimator.md has what other values find.
_ENOUGH, _MOST = 80.0, 45.0
# Lengths, over the window: of a share of time, and of what is needed before and after it.
SHARE, AROUND = 0.5, 0.75
# Events nearer to each other than this share of the window are one.
APART = 1 / 8


class Event(NamedTuple):
    """
    A step of the derivative of this `order` at `time`, ns, with its standard deviation, s.

    `share` is the number of the share of time, and `body` that of the body. `step` (3,) is by how
    much the derivatives of the angle and of both coordinates of the point step, rad/s^order and
    m/s^order, with standard deviations `step_sigma` (3,). `odds` are the log odds of the event.
    """

    share: int
    body: int
    time: int
    time_sigma: float
    order: int
    step: Real
    step_sigma: Real
    odds: float


class _Shown(NamedTuple):
    """
    An event as windows of a length show it: arrays by the order of the derivative that steps.

    `time` (O,), s, is since the share began; `step` and `step_sigma` are (O, 3). `length` is the
    number of the length, 0 for the longest.
    """

    length: int
    odds: Real
    time: Real
    time_sigma: Real
    step: Real
    step_sigma: Real


def find_events(poses: Poses, noise: Real, window: float, begins: np.ndarray) -> list[Event]:
    """
    Find the events of bodies in shares of time, each half a window long.

    An event follows from the poses up to AROUND windows before and after its share alone.

    Parameters
    ----------
    poses : Poses
        Of B bodies.
    noise : ndarray (B,), m
        Standard deviation of a pose with information of 1.
    window : float, s
        Twice the length of the shares, and half that of the longest windows.
    begins : ndarray (S,), ns
        When the shares begin.

    Returns
    -------
    list of Event
        By share, body and time. Shares that meet may both have an event near their border.

    """
    interval = float(np.median(np.diff(poses.time))) * 1e-9
    halves = window / _RATIO ** np.arange(_LENGTHS)
    halves = halves[np.rint(halves / interval) >= _FEWEST]
    shown: dict[tuple[int, int], list[_Shown]] = {}
    for length, half in enumerate(halves.tolist()):
        for share, body, arrays in _list_events(poses, noise, window, half, begins):
            shown.setdefault((share, body), []).append(_Shown(length, *arrays))
    return [
        Event(
            share=share,
            body=body,
            time=int(begins[share]) + round(float(best.time[order]) * 1e9),
            time_sigma=float(best.time_sigma[order]),
            order=order,
            step=best.step[order],
            step_sigma=best.step_sigma[order],
            odds=odds,
        )
        for (share, body), each in sorted(shown.items())
        for odds, order, best in _choose(each, window, interval)
    ]


def _list_events(
    poses: Poses, noise: Real, window: float, half: float, begins: np.ndarray
) -> Iterator[tuple[int, int, list[Real]]]:
    """
    List what windows of the length 2 `half`, s, show: share, body, and the arrays of `_Shown`.

    Windows tile each share, and list the events near their middles.
    """
    tiles = int(np.ceil(SHARE * window / half - 1e-6))
    tile = SHARE * window / tiles
    middles = (begins[:, None] + (np.arange(tiles) + 0.5) * (tile * 1e9)).ravel()
    before = np.clip(np.searchsorted(poses.time, middles), 1, len(poses.time) - 1)
    is_nearer = middles - poses.time[before - 1] < poses.time[before] - middles
    now = before - is_nearer
    oldest = np.searchsorted(poses.time, poses.time[now] - round(half * 1e9))
    newest = np.searchsorted(poses.time, poses.time[now] + round(half * 1e9), 'right') - 1
    bodies = len(noise)
    call = new_call(2 * half, 0)
    call.frames, call.bodies, call.instants = len(poses.time), bodies, len(now)
    call.radius = tile / 2
    arrays = poses._asdict() | {
        'windows': np.array((now, oldest, newest)),
        'left_out': np.zeros((len(now), bodies), np.int64),
        'noise': np.tile(noise, (len(now), 1)),
    }
    for name, array in arrays.items():
        call.bind(name, np.ascontiguousarray(array, call.elements[name]))
    sizes = {'E': SIZES['MOST_EVENTS'], 'O': SIZES['EVENT_ORDERS'], 'T': len(now), 'B': bodies}
    events = EventArrays.new_arrays(**sizes)
    results = call.events
    for name, array in events.items():
        results.bind(name, array)
    finish_call(call, library.kinpole_derive(byref(call)))
    for number, instant, body in np.argwhere((events['odds'] > 0).any(axis=1)).tolist():
        share = instant // tiles
        shown = [array[number, ..., instant, body] for array in events.values()]
        shown[1] = shown[1] + (poses.time[now[instant]] - begins[share]) * 1e-9
        yield share, body, shown


def _choose(shown: list[_Shown], window: float, interval: float) -> list[tuple[float, int, _Shown]]:
    """Choose the events of a share: log odds, order, and the window that shows each best."""
    clear = np.array([one.odds.max() for one in shown])
    likeliest = [(one, int(one.odds.argmax())) for one in shown]
    time = np.array([one.time[order] for one, order in likeliest])
    found: list[tuple[float, float, list[_Shown]]] = []
    for k in range(len(shown)):
        same = np.abs(time - time[k]) <= interval
        # Of each length the window that shows it best.
        best: dict[int, int] = {}
        for j in np.flatnonzero(same)[np.argsort(clear[same], kind='stable')].tolist():
            best[shown[j].length] = j
        each = clear[list(best.values())]
        # Windows shorter than those that show it have too few samples.
        missing = max(best) + 1 - len(best)
        odds = float(np.minimum(each, _MOST).sum() + _NOT_SHOWN * missing)
        if odds >= _ENOUGH:
            found.append((odds, float(time[k]), [shown[j] for j in best.values()]))
    kept: list[tuple[float, float, list[_Shown]]] = []
    for one in sorted(found, key=lambda one: -one[0]):
        if all(abs(one[1] - other[1]) >= APART * window for other in kept):
            kept.append(one)
    events = []
    for odds, _, windows in sorted(kept, key=lambda one: one[1]):
        order = _order_of(windows)
        # A jump of the pose, and a gradual start, are no events.
        if 0 < order < SIZES['STEP_ORDERS']:
            events.append((odds, order, _most_precise(windows, order)))
    return events


def _order_of(windows: list[_Shown]) -> int:
    """Return the order of an event that these windows show."""
    odds = np.stack([one.odds for one in windows])
    loss = np.minimum(odds.max(axis=1, keepdims=True) - odds, _MOST).mean(axis=0)
    return int(loss.argmin())


def _most_precise(windows: list[_Shown], order: int) -> _Shown:
    """Return the window that shows the time of an event of this order best."""
    return min(
        windows, key=lambda one: float(one.time_sigma[order]) if one.odds[order] > 0 else np.inf
    )
