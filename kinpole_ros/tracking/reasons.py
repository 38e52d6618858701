"""Why quantities of bodies are undetermined, from their values and noise."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.core.bindings import codes_of
from kinpole_ros.tracking.values import Vectors

# A denominator counts as known when it exceeds its standard deviation this many times. Beyond this
# many body sizes a pole is as good as at infinity.
SIGNIFICANT, FARTHEST = codes_of('POLE_LIMITS').values()
IN_NOISE, NO_ROTATION, AT_INFINITY = 'lost in its noise', 'no rotation', 'pole at infinity'
# Reasons why a body with a determined ICR has no curvature of the centrode, or inflection circle.
PINNED = 'pinned: the ICR stands still'
SLOW_ICR = 'the velocity of the ICR does not stand out of its noise'
STRAIGHT = 'at infinity: the inflection circle is a line'


def stands_out(values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return where (..., B) any derivative (K, ..., B) of order 1 or higher exceeds its noise."""
    variance = np.einsum('kk...->k...', covariance)
    with np.errstate(invalid='ignore'):
        return np.asarray((values > SIGNIFICANT * np.sqrt(variance))[1:].any(axis=0))


def why_no_poles(
    poles: Sequence[Vectors], position: np.ndarray, size: np.ndarray
) -> list[np.ndarray]:
    """
    Return why each pole is undetermined.

    Parameters
    ----------
    poles : sequence of Vectors
        Poles (T, B) of order 1 and higher, m.
    position : (T, B) complex
        A point of each body, m.
    size : (T, B) float
        Diameters of the bodies, m.

    Returns
    -------
    list of (T, B) str
        A reason for each pole, '' where it is determined.

    """
    reasons = []
    for pole in poles:
        with np.errstate(invalid='ignore'):
            is_far = np.abs(pole.value - position) > FARTHEST * size
        reason = np.where(poles[0].determined, IN_NOISE, NO_ROTATION)
        reason = np.where(is_far, AT_INFINITY, reason)
        reasons.append(np.where(pole.determined, '', reason))
    return reasons


def why_no_motion_of_icr(
    has_icr: np.ndarray, is_pinned: np.ndarray, icr_moves: np.ndarray, is_known: np.ndarray
) -> np.ndarray:
    """
    Return why a quantity that follows from the motion of the ICR is undetermined.

    Parameters
    ----------
    has_icr, is_pinned, icr_moves, is_known : (T, B) bool
        Whether the ICR is determined, the body turns about a pin, the velocity of the ICR exceeds
        its noise, and the quantity is determined.

    Returns
    -------
    (T, B) str
        A reason, '' where the quantity is determined, and where no ICR is.

    """
    # A velocity within its noise does not show a pin; all poses together do.
    reason = np.where(has_icr, SLOW_ICR, '')
    reason = np.where(is_pinned & has_icr, PINNED, reason)
    reason = np.where(icr_moves, IN_NOISE, reason)
    return np.where(is_known, '', reason)
