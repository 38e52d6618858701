"""Why a body has no result, and why a quantity of a body with a pose is undetermined."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import codes_of
from kinpole_ros.derivatives import FEWEST_SAMPLES

# A denominator counts as known when it exceeds its standard deviation this many times. Beyond this
# many body sizes a pole is as good as at infinity.
SIGNIFICANT, FARTHEST = codes_of('POLE_LIMITS').values()
# The codes by name: see codes.h.
REASONS = codes_of('REASONS')
KNOWN = REASONS['KNOWN']


class Reason(NamedTuple):
    """What a code says to people, and what they can do, where anything helps."""

    text: str
    fix: str = ''


TABLE = {
    'KNOWN': Reason(''),
    'NOT_FULL': Reason(
        'window not full',
        f'raise the parameter window: it must hold {FEWEST_SAMPLES} frames with it',
    ),
    'TOO_NOISY': Reason(
        'markers too close for their noise',
        'move them farther from each other, or set the parameter noise',
    ),
    'NOISE_UNKNOWN': Reason('noise not known yet', 'record longer, or set the parameter noise'),
    'NOT_SEEN': Reason(
        'too few markers seen, or all at one place',
        'see that two of them, at distinct places in the plane, are in a frame at once and finite',
    ),
    'OFF_PATH': Reason(
        'its pose is far off its path, and may be wrong',
        'see that the tracker takes no other markers for it',
    ),
    'ANGLE_NOISY': Reason(
        'the noise of its angle is too large', 'see to the driver: it is more than 0.15 rad'
    ),
    'NO_POSE': Reason(
        'no pose of it came',
        'see that its driver sees it, and that its orientation is a quaternion',
    ),
    'PLANE_UNKNOWN': Reason(
        'plane not known yet',
        'it is found when bodies have moved in two directions of it, by more than their noise, and '
        'after 100 frames or more where they leave any plane; record such a motion, or set plane: '
        '[x, y, z], its normal, as kinpole discover gives it',
    ),
    'IN_NOISE': Reason('lost in its noise'),
    'NO_ROTATION': Reason('no rotation'),
    'AT_INFINITY': Reason('pole at infinity'),
    'ON_PIN': Reason('pinned: the ICR stands still'),
    'ICR_IN_NOISE': Reason('the velocity of the ICR does not stand out of its noise'),
    'STRAIGHT': Reason('at infinity: the inflection circle is a line'),
}
"""The reasons by the names of their codes."""

_BY_CODE = np.array([TABLE[name].text for name in REASONS], object)
# The codes of bodies whose poses come as such, by those that C gives.
_OF_POSES = np.array([*REASONS.values()], np.uint8)
_OF_POSES[[REASONS['TOO_NOISY'], REASONS['NOT_SEEN']]] = (
    REASONS['ANGLE_NOISY'],
    REASONS['NO_POSE'],
)


def reason_of(code: int) -> Reason:
    """Return what a code says."""
    return TABLE[next(name for name, number in REASONS.items() if number == code)]


def texts_of(codes: np.ndarray) -> np.ndarray:
    """Return the texts (...) of codes (...), '' where all is known."""
    return np.asarray(_BY_CODE[codes])


def reasons_of_poses(codes: np.ndarray) -> np.ndarray:
    """Return the codes (...) of bodies whose poses come as such, not their markers."""
    return np.asarray(_OF_POSES[codes])


def stands_out(values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return where (..., B) any derivative (K, ..., B) of order 1 or higher exceeds its noise."""
    variance = np.einsum('kk...->k...', covariance)
    with np.errstate(invalid='ignore'):
        return np.asarray((values > SIGNIFICANT * np.sqrt(variance))[1:].any(axis=0))
