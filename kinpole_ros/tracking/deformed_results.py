"""What the deformation of bodies adds to the covariances of results."""

import numpy as np

from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.deformation import ResultWindow, deformation_covariance, hold_hidden
from kinpole_ros.tracking.estimate import Results
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.reasons import REASONS


def add_deformation(results: Results, first: int, bodies: Bodies, history: History) -> None:
    """Add to the covariances of the results from `first` on what the deformation of bodies adds."""
    for t in range(first, results.filled):
        usable = results.array('reason')[t] == REASONS['KNOWN']
        for b in np.flatnonzero(usable & (bodies.freedom > 0)).tolist():
            _add_deformation_of(results, t, bodies, b, history)


def _add_deformation_of(results: Results, t: int, bodies: Bodies, b: int, history: History) -> None:
    """Add to the covariances of a body at an instant what its deformation adds."""
    now, oldest, newest = results.array('rows')[t].tolist()
    time = history['time']
    interval = int(time[newest] - time[oldest]) / max(newest - oldest, 1) * 1e-9
    first = max(0, oldest - (newest + 1 - oldest))
    residual = hold_hidden(history['residual'][first : newest + 1, b : b + 1])[:, 0]
    slow = deformation_covariance(
        residual,
        ResultWindow(now - first, oldest - first, interval),
        float(results.array('span')[t, b]),
        float(results.array('parameters')[t, b]) - 1,
        float(bodies.white[b] * np.sqrt(bodies.hidden_factor[b])),
        float(bodies.freedom[b]),
        results.orders - 1,
    )
    turned, placed = results.array('information')[t, :, b]
    results.array('angle_covariance')[:, :, t, b] += slow / turned
    hub = results.array('reference')[t, b]
    spread = _spread_at(hub, bodies.fitting.middle[b], turned, placed)
    results.array('position_covariance')[:, :, t, b] += slow * spread


def _spread_at(hub: complex, middle: complex, turned: float, placed: float) -> float:
    """Variance of a point `hub` of a body; `turned` and `placed` are information of its pose."""
    if hub == 0:
        return 1 / placed
    least = max(1 / placed - abs(middle) ** 2 / turned, 0.0)
    return least + abs(hub - middle) ** 2 / turned
