"""Where a linkage has its pins at an instant, as far as its results show them."""

import numpy as np

from kinpole_ros.tools.plot._read import Body, Results

# A relative center that strays no more than this part of the smaller body's size is a pin.
_STILL = 0.05
_FEWEST = 10


def pins(
    results: Results, instant: int
) -> tuple[dict[str, complex], dict[tuple[str, str], complex]]:
    """
    The pins on the ground, by body, and those between bodies, by pair: complex, m.

    A body is on a pin of the ground where the tracker holds its ICR still. Two bodies have a pin
    where their relative center stands still in the frames of both, by the median.
    """
    grounded = {
        body.name: body.series['icr'].value[k]
        for body in results.bodies
        for k in _held(body, instant)
    }
    bodies = {body.name: body for body in results.bodies}
    between = {}
    for (j, i), series in results.relative.items():
        places = [_still(bodies[name], series.stamp, series.value) for name in (j, i)]
        here = np.flatnonzero(bodies[i].stamp == instant)
        if all(place is not None for place in places) and len(here):
            turn = np.exp(1j * bodies[i].angle[here[0]])
            between[j, i] = complex(bodies[i].position[here[0]] + places[1] * turn)
    return grounded, between


def _held(body: Body, instant: int) -> np.ndarray:
    """The index of the instant among the ICRs, if the tracker holds the body on a pin then."""
    icr, velocity = body.series.get('icr'), body.series.get('icr_velocity')
    if icr is None or velocity is None:
        return np.empty(0, int)
    still = velocity.stamp[velocity.value == 0]
    return np.flatnonzero((icr.stamp == instant) & np.isin(icr.stamp, still))


def _still(body: Body, stamp: np.ndarray, value: np.ndarray) -> complex | None:
    """Where on the body the points are, if they stay at one place."""
    _, own, other = np.intersect1d(body.stamp, stamp, return_indices=True)
    if len(own) < _FEWEST:
        return None
    places = (value[other] - body.position[own]) * np.exp(-1j * body.angle[own])
    middle = complex(np.median(places.real), np.median(places.imag))
    return middle if np.median(np.abs(places - middle)) < _STILL * body.size else None
