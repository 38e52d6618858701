"""What is wrong with the stamps of a driver, by their pace against the rate of arrival."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.tracking.stamps import StampState

# Steps of the stamps over those of the arrivals; a bag played at ten times its pace is in order.
_ODD_PACE = 100.0
# Of frames in bunches most follow the one before within this share of the mean step.
_BUNCHED = 0.25
_FEWEST = 5
_FIX = 'see that the driver sets header.stamp to the time of capture, in s and ns'


def stamp_faults(stamps: Sequence[int], seconds: float, window: float) -> list[tuple[bytes, str]]:
    """
    Levels and words of what is wrong with header stamps (ns) that came within `seconds`.

    Found are stamps that stand still, that advance in another unit than time does, and that come
    in bunches; single jumps and repetitions, which the tracker counts, are not. `window` is the
    parameter, in s: longer steps are jumps.
    """
    steps = np.diff(np.array(stamps, dtype=np.int64)) * 1e-9
    if len(stamps) < _FEWEST or seconds <= 0:
        return []
    if not steps.any():
        text = f'the stamps stand still at {stamps[-1] * 1e-9:.9g} s: {_FIX}'
        return [(DiagnosticStatus.ERROR, text)]
    ahead = steps[steps > 0]
    if len(ahead) < _FEWEST - 1:
        return []
    arrivals = seconds / len(stamps)
    fast, slow = np.median(ahead) / arrivals, ahead.mean() / arrivals
    if fast > _ODD_PACE or slow < 1 / _ODD_PACE:
        pace = fast if fast > _ODD_PACE else slow
        text = f'the stamps advance {pace:.2g} times as fast as the messages come: {_FIX}'
        return [(DiagnosticStatus.ERROR, text)]
    regular = ahead[ahead <= window]
    if len(regular) and np.median(regular) < _BUNCHED * regular.mean():
        text = (
            f'the stamps come in bunches, mostly in steps of {np.median(regular):.2g} s where the '
            f'mean is {regular.mean():.2g} s: {_FIX}'
        )
        return [(DiagnosticStatus.WARN, text)]
    return []


def stamp_values(state: StampState) -> dict[str, float | str]:
    """What is found of the stamps, in the words of diagnostics."""
    return {
        'interval of the clock of the stamps (s)': state.interval,
        'jitter of the stamps, rms (s)': state.jitter,
        'jitter of the stamps, largest (s)': state.largest,
        'frames taken to be at': 'ticks of that clock' if state.regularized else 'their stamps',
    }


def jitter_fault(state: StampState, mode: str) -> str:
    """What is to be said of stamps that are late, by the parameter `mode`; '' if nothing."""
    if state.regularized and state.jitter > state.interval:
        return (
            f'the stamps are late by {state.jitter:.2g} s rms, up to {state.largest:.2g} s, more '
            f'than the {state.interval:.2g} s between frames: nobody can tell by them which frames '
            'were lost, and figures may be off by more than their deviations; fix: let the driver '
            'stamp the time of capture'
        )
    if not state.costs:
        return ''
    if mode == 'capture':
        fix = 'set stamps: arrival, or auto, if the camera has an even clock'
    else:
        fix = 'set stamps: arrival if the camera has an even clock'
    return (
        f'the stamps jitter by {state.jitter:.2g} s rms, up to {state.largest:.2g} s, which moves '
        f'the markers by more than their noise; fix: {fix}, or let the driver stamp the time of '
        'capture'
    )
