"""
What is not used of the frames, and why: every verdict and its threshold.

C applies the rules that run for every frame (core/src/rejection.c), with the limits given here. A
rule that needs a search for a correction is in `correction` or `identity`, and takes its limits
here.

| what | verdict | rule | applied in | counted as |
| --- | --- | --- | --- | --- |
| a frame | LATE | older than the newest, or than the clock allows | `judge_arrivals` | late |
| a frame | REPEATED | as the last one | `judge_arrivals` | repeated |
| a frame | RESET | a step over a window; two late in a row | `judge_arrivals` | resets |
| a marker | TOO_FAR | not below `FARTHEST_MARKER` | `write_point` in C | markers_too_far |
| a marker | OVERFLOW | more than `MOST_MARKERS` of a body | `_take_new` | markers_unknown |
| a marker | ODD | off its place by `OUTLIER_SIGMAS` | `verdict_on_marker` in C | - |
| a body | ODD | turned by more than a quarter in a frame | `fit` in C | - |
| a marker | NAME_DOUBTFUL | ODD, by `YOUNG_OUTLIER` of the size | `verdict_on_marker` in C | - |
| a marker | NEW_MARKER | no place on its body yet | `fit` in C | - |
| a marker | LEFT_OUT | ODD: the least cost is without it | `correct_markers` | markers_left_out |
| a marker | EXCHANGED | ODD: the least is elsewhere | `correct_markers` | markers_exchanged |
| a body | MIRRORED | ODD: the least is mirrored | `correct_markers` | markers_mirrored |
| a body | DROPPED | ODD: no pose costs less | `correct_markers` | markers_of_misfits |
| a body | DROPPED | corrected, above `MAX_SQUARE_RATIO` | `_correct_body` | markers_of_misfits |
| a body | UNCERTAIN | points fit it in several ways | `match` | bodies_ambiguous |
| a pose | NOT_SEEN | less than two markers, or all at one place | `fit` in C | a reason |
| a marker | HELD | repeats the last two | `kinpole_is_marker_held` in C | markers_held |
| a pose | HELD | repeats the last: `MAX_REPEAT_CHANCE` | `kinpole_is_held` in C | poses_held |
| a pose | NOT_SEEN | its markers too close: `MAX_ANGLE_NOISE` | `is_unsteady` in C | a reason |
| a pose | OFF_PATH | off its neighbors by `FAR` | `wrong_before_last` in C | a reason |
| a pose | OFF_PATH | newest, off by `NEWEST_FACTOR` | `doubtful_newest` in C | a reason |
| a pin | off | by `N_SIGMA` in more than two frames | `kinpole_holds_on_pin` in C | - |
| a pin | dropped | off in `CONFIRMING_FRAMES` in a row | `update_pins` | - |
| a result | TOO_NOISY | `MAX_ANGLE_NOISE` | `reasons_of` | a reason |
| a result | NOISE_UNKNOWN | less than `MIN_SAMPLES` frames | `reasons_of` | a reason |

What is counted is a key of `Tracker.update_counts`, which diagnostics print. A verdict without a
count leads to another one. A reason stands with the results that are missing for it.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import codes_of
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.reasons import REASONS
from kinpole_ros.tracking.thresholds import ROUNDED

# What is counted of markers that are not used as they came, by verdict.
EXCHANGED, LEFT_OUT = 'markers_exchanged', 'markers_left_out'
MIRRORED, DROPPED = 'markers_mirrored', 'markers_of_misfits'
TOO_FAR, HELD, HELD_MARKERS = 'markers_too_far', 'poses_held', 'markers_held'

# m. Squares of smaller coordinates do not overflow; no marker is farther.
FARTHEST_MARKER = 1e15
# Markers that a body of all markers takes at most: a driver that numbers its markers anew in every
# frame must not fill the memory.
MOST_MARKERS = 1024
# A marker farther off than this is an outlier, in standard deviations of residuals.
OUTLIER_SIGMAS = 6.0
# The same as a share of the body size, while the residuals are not known.
YOUNG_OUTLIER = 0.03
# rad. Errors of an angle with more noise are not small, and its whole turns are not known.
MAX_ANGLE_NOISE = 0.15
# A pose, or a marker, that repeats the one before to the last bit is held by the tracker if noise
# repeats it with less than this probability.
MAX_REPEAT_CHANCE = 1e-6
# Mean square residual of a corrected body over that of the body; 0.1% of chi-squares of three
# degrees exceed it. Without it a soft kite on a fast rod, with spikes, has 13 times the error.
MAX_SQUARE_RATIO = 5.4
# A point is taken for a predicted marker if the second nearest point is this many times as far.
DISTANCE_RATIO = 2.0
# nats. What makes a way to place a body on its markers unlikely: a marker left out, which costs as
# much as one at the limit of outliers, markers exchanged, and a mirrored body.
OUTLIER_NATS = OUTLIER_SIGMAS**2 / 2
EXCHANGE_NATS, MIRROR_NATS = 0.5 * OUTLIER_NATS, 0.75 * OUTLIER_NATS
# Most frames between two searches for the names of markers after searches without a result.
MAX_SEARCH_INTERVAL = 16
# A marker has moved if it was seen in half of so many frames and fitted in none. Markers that stay
# exchanged for as long had wrong names before.
MOVED_FRAMES = 100
# A pose is wrong if it is off the cubic through its neighbors by so many standard deviations. The
# newest has no later neighbors: it is wrong if it is off every polynomial through those before, by
# the second factor times as many.
FAR, NEWEST_FACTOR = 7.0, 3.0
# A pose within this share of the body size, or this angle, rad, of the curve is never wrong.
NEAR = 0.01
# A frame later than so many intervals follows a gap.
GAP = 2.5

# What is unusual of a body in a frame: see codes.h.
UNUSUAL = codes_of('UNUSUAL_BITS')
MAY_REPEAT, NO_POSE_REPEATS, NO_MARKER_REPEATS = codes_of('REPETITIONS').values()
ODD, NAME_DOUBTFUL = UNUSUAL['ODD'], UNUSUAL['NAME_DOUBTFUL']


class MarkerLimits(NamedTuple):
    """
    How far the markers of B bodies may be off their places.

    `limit` (B,), m, is that of a marker. `largest` and `doubtful` (B, n), m^2, are squares, the
    second for the name. `loosest` (B,), m^2, is the least spread of markers that show an angle.
    """

    limit: Real
    largest: Real
    doubtful: Real
    loosest: Real


def marker_limits(
    mature: np.ndarray,
    misfit: Real,
    marker_variance: Real,
    spread: Real,
    size: Real,
    relative: Real,
) -> MarkerLimits:
    """
    Compute how far markers may be off their places.

    Parameters
    ----------
    mature : (B,) bool
        Whether there are enough fits for the misfit.
    misfit, marker_variance : (B,) float
        Variance of a coordinate of a marker about its place, and the same with rounding, m^2.
    spread, size : (B,) float
        Sum of squared arms, m^2, and diameter, m.
    relative : (B, n) float
        Variance of each marker over that of the others.

    """
    usual = OUTLIER_SIGMAS * np.sqrt(np.maximum(misfit, ROUNDED**2 * spread))
    young = np.maximum(YOUNG_OUTLIER * size, 2 * usual)
    limit = np.where(mature, usual, young)
    largest = np.where(mature, usual**2, np.inf)[:, None] * relative
    # A marker on soft tissue that moves by less keeps its name.
    doubtful = (np.maximum(limit, YOUNG_OUTLIER * size) ** 2)[:, None] * relative
    return MarkerLimits(limit, largest, doubtful, marker_variance / MAX_ANGLE_NOISE**2)


def reasons_of(noise: Real, spread: Real, angle_noise: Real) -> np.ndarray:
    """
    Return the codes (B,) of why bodies have no results.

    Parameters
    ----------
    noise, spread : (B,) float
        Noise of a coordinate of a marker, m, NaN while not known; sum of squared arms, m^2.
    angle_noise : (B,) float
        Noise of measured angles, rad, NaN of those that are fitted to markers.

    """
    is_steady = noise**2 < MAX_ANGLE_NOISE**2 * spread
    is_steady = np.where(np.isnan(angle_noise), is_steady, angle_noise < MAX_ANGLE_NOISE)
    steady = np.where(is_steady, REASONS['KNOWN'], REASONS['TOO_NOISY'])
    return np.where(np.isfinite(noise), steady, REASONS['NOISE_UNKNOWN']).astype(np.uint8)


def is_unsteady(bodies_spread: Real, spread: Real, loosest: Real) -> np.ndarray:
    """Return which poses are fitted to markers too close together; as `is_unsteady` of C."""
    return np.asarray((bodies_spread > loosest) & (spread < loosest))


class LastFrame(NamedTuple):
    """The last frame that came, used or not: its stamp, ns, and points; the latest stamp so far."""

    stamp: int
    newest: int
    points: np.ndarray | None


class Arrivals(NamedTuple):
    """
    The verdicts on the first n of the next frames.

    `is_used` (n,) says which frames are used, and `is_new` (n,) which are not repeated. `late` and
    `repeated` are how many are left out for which reason. `last` is frame n - 1. If n is less than
    the number of frames, frame n restarts everything.
    """

    is_used: np.ndarray
    is_new: np.ndarray
    late: int
    repeated: int
    last: LastFrame


def judge_arrivals(
    last: LastFrame,
    stamps: np.ndarray,
    points: np.ndarray,
    window: int,
    max_lateness: int,
    may_be_late: bool,
) -> Arrivals:
    """
    Decide which of the next frames are used.

    Parameters
    ----------
    last : LastFrame
        The frame before.
    stamps : (T,) int64
        Stamps, ns.
    points : (T, ...) float
        Markers, which distinguish a repeated frame from one with the same stamp.
    window : int
        The longest step between two frames, ns.
    max_lateness : int
        The most that a frame may be late, ns.
    may_be_late : bool
        Whether late frames are used. Otherwise each frame has to be later than all before.

    Returns
    -------
    Arrivals
        The verdicts.

    """
    # The latest stamp before each frame.
    latest = np.maximum.accumulate(np.concatenate(((last.newest,), stamps[:-1])))
    before = np.concatenate(((last.stamp,), stamps[:-1]))
    ahead = stamps - latest
    too_late = ahead <= -max_lateness
    # A frame that is too late is just late. Two in a row, the second newer than the first, come
    # from a clock that was set back.
    restarts = too_late & (before < latest) & (before < stamps)
    restarts |= np.abs(ahead) > window
    end = int(restarts.argmax()) if restarts.any() else len(stamps)
    ahead, too_late = ahead[:end], too_late[:end]
    repeated = _find_repeated((stamps == before)[:end], points, last.points)
    if may_be_late:
        late, twice, is_used = too_late, repeated, ~(too_late | repeated)
    else:
        late, twice, is_used = ahead < 0, ahead == 0, ahead > 0
    if end:
        newest = max(last.newest, int(np.maximum.reduce(stamps[:end])))
        last = LastFrame(int(stamps[end - 1]), newest, points[end - 1].copy())
    return Arrivals(is_used, ~repeated, int(late.sum()), int(twice.sum()), last)


def _find_repeated(
    same_stamp: np.ndarray, points: np.ndarray, before: np.ndarray | None
) -> np.ndarray:
    """Find the frames (T,) that are equal to the one before, of those with the same stamp."""
    repeated = np.zeros(len(same_stamp), bool)
    for k in same_stamp.nonzero()[0].tolist():
        earlier = points[k - 1] if k else before
        repeated[k] = earlier is not None and np.array_equal(points[k], earlier, equal_nan=True)
    return repeated
