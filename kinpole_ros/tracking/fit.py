"""The poses of the bodies in one frame, with markers corrected that do not fit."""

from collections import Counter

import numpy as np

from kinpole_ros.planar import Fit, fit_pose, fit_pose_with_factors, procrustes_factors
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.corrections import EXCHANGED, correct_markers, half_turn
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import mean_square

# Markers may be exchanged if a body is this far, rad, from where it would have turned to, while it
# turns by less than the other, rad per frame.
REVERSED, SLOW = 0.75 * np.pi, 0.25 * np.pi
# Mean square residual per degree of freedom, over the misfit, of a body that was corrected; 0.1% of
# chi-squares of three degrees exceed it.
CONSISTENT = 5.4
# Number of frames that show how a body turns.
RECENT = 8


def fit_markers(bodies: Bodies, markers: Complex) -> Fit:
    """Fit the poses of all bodies to their markers (..., B, n), NaN for those not seen."""
    unseen = np.isnan(markers)
    grip = bodies.grip
    if np.count_nonzero(unseen):
        grip = procrustes_factors(bodies.shape, np.where(unseen, 0.0, bodies.weights))
    return fit_pose_with_factors(markers, grip)


def correct_frame(
    bodies: Bodies, history: History, markers: Complex, odd: np.ndarray, counts: Counter[str]
) -> Complex:
    """
    Correct the markers of the `odd` bodies (B,) of one frame.

    Markers that were exchanged are put in the order of their places, which following frames keep.
    Markers that do not fit are left out; a body that cannot be corrected has no pose.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known; the order of exchanged markers is updated in place.
    markers : array, shape (B, n), complex, m
        Markers in the plane, NaN for those not seen; changed in place.
    odd : array, shape (B,), bool
        Bodies that do not fit.
    counts : Counter
        Numbers of corrected markers by kind, updated.

    Returns
    -------
    array, shape (B, n), complex, m
        The markers in the order of their places, with those that were left out.

    """
    came = markers.copy()
    for b in np.flatnonzero(odd).tolist():
        came[b] = _correct(
            bodies, history['angle'][-2 * MIN_TURNS - 1 : -1, b], markers, came[b], b, counts
        )
    return came


MIN_TURNS = 20


def _correct(
    bodies: Bodies, angles: Real, markers: Complex, came: Complex, b: int, counts: Counter[str]
) -> Complex:
    """Correct the markers of one body in place; returns those that came in their new order."""
    known = np.where(np.isnan(markers[b]), 0.0, bodies.weights[b])
    ahead, slow = _angle_ahead(angles)
    angle = fit_pose(markers[b], bodies.shape[b], known).angle
    order = np.arange(bodies.width)
    if (
        slow
        and np.cos(angle - ahead) < np.cos(REVERSED)
        and (bodies.limit[b] ** 2 < bodies.spread[b])
    ):
        turned = half_turn(bodies.shape[b], known, float(bodies.limit[b]))
        if turned is not None:
            order, markers[b] = turned, markers[b, turned]
    residual = np.abs(fit_pose(markers[b], bodies.shape[b], known).residual)
    if bodies.mature[b] and (residual > np.sqrt(bodies.largest[b])).any():
        found = correct_markers(
            markers[b],
            bodies.shape[b],
            bodies.weights[b],
            float(bodies.limit[b]),
            ahead,
            np.sqrt(bodies.relative[b]),
        )
        markers[b], order = found.points, order[found.order]
        left = fit_pose(markers[b], bodies.shape[b], np.where(np.isnan(markers[b]), 0, known))
        square = mean_square(left.residual / np.sqrt(bodies.relative[b]), left.freedom)[0]
        if square > CONSISTENT * bodies.misfit[b]:
            # Where one marker is wrong another may be, by less than makes it an outlier.
            markers[b] = np.nan
        counts.update({kind: n for kind, n in found.counts.items() if kind != EXCHANGED})
    if (order != np.arange(bodies.width)).any():
        bodies.order[b] = bodies.order[b, order]
        bodies.exchanged_for[b] = 0
        bodies.exchanged = bool((bodies.order != np.arange(bodies.width)).any())
    return came[order]


def _angle_ahead(angles: Real) -> tuple[float, bool]:
    """The angle of a body that is expected after `angles` (N,), and whether it turned slowly."""
    seen = np.flatnonzero(np.isfinite(angles[-RECENT:])) + max(len(angles) - RECENT, 0)
    if not len(seen):
        return np.nan, False
    last = int(seen[-1])
    ahead = float(angles[last])
    if len(seen) > 1:
        turn = _wrapped(angles[last] - angles[seen[-2]]) / (last - seen[-2])
        ahead += turn * (len(angles) - last)
    steps = np.abs(_wrapped(np.diff(angles)))
    slow = np.isfinite(steps).sum() >= MIN_TURNS // 2 and not (steps > SLOW).any()
    return ahead, bool(slow and np.abs(ahead - angles[last]) < SLOW)


def _wrapped(angle: Real | float) -> Real:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
