"""The spectrum of the motion of a body, found in the history."""

import numpy as np

from kinpole_ros.derivatives import Spectrum, find_spectrum
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History


def spectrum_of_body(bodies: Bodies, history: History, window_ns: int, b: int) -> Spectrum | None:
    """
    Return the spectrum of body `b` in the history, None where it says too little.

    That of the position is that of the point whose position is derived.
    """
    # After the last gap in which the body may have done anything.
    time = history['time']
    gaps = np.flatnonzero(np.diff(time) > window_ns)
    rows = slice(gaps[-1] + 1 if len(gaps) else 0, None)
    information, angle, turns, tilt_turn, position = (
        history[name][rows, ..., b]
        for name in ('information', 'angle', 'turns', 'tilt_turn', 'position')
    )
    has_pose = information[:, 0] > 0
    if not has_pose.any():
        return None
    angle = angle + 2 * np.pi * turns + tilt_turn
    # A body on a pin has its origin derived.
    reference = 0.0 if np.isfinite(bodies.pin[b]) else bodies.reference[b]
    poses = np.array((angle, position + reference * np.exp(1j * angle)))[:, has_pose]
    noise = _noise_of(bodies, np.median(information[has_pose], axis=0), reference, b)
    return find_spectrum(time[rows][has_pose], poses[0].real, poses[1], noise, window_ns * 1e-9)


def _noise_of(bodies: Bodies, information: Real, reference: complex, b: int) -> tuple[float, float]:
    """Return the standard deviations of the angle, rad, and of the position of `reference`, m."""
    of_angle, of_origin = bodies.noise[b] ** 2 / (
        information * bodies.fitting.information_factor[:, b]
    )
    if reference == 0:
        return float(np.sqrt(of_angle)), float(np.sqrt(of_origin))
    # As in `fill_window` of follow.c: the errors of the middle and of the angle are independent.
    middle = bodies.fitting.middle[b]
    of_middle = max(of_origin - abs(middle) ** 2 * of_angle, 0.0)
    of_reference = of_middle + abs(reference - middle) ** 2 * of_angle
    return float(np.sqrt(of_angle)), float(np.sqrt(of_reference))
