"""
The six motions the benchmarks are made on, each exact to the fourth derivative.

They differ in what is hard about them: a mechanism's many harmonics, far turning within a window,
rates that pass through zero, rest, poles that stand still in the body, and a sudden whip.
"""

from collections.abc import Callable
from math import comb, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import BodyMotion, load_scene
from kinpole_ros.mechanism._motions import ORDERS, four_bar


class Motion(NamedTuple):
    """One body: `motion` gives its BodyMotion (5, ...) at times (...) in s, `markers` (n, 2), m."""

    motion: Callable[[np.ndarray], BodyMotion]
    markers: np.ndarray

    @property
    def size(self) -> float:
        """Diameter of the markers, m, as the tracker reckons it: twice their rms radius."""
        arms = self.markers - self.markers.mean(axis=0)
        return float(2 * np.sqrt((arms**2).sum(axis=1).mean()))


# m, about the reference point: four markers of a body 0.2 m across, their mean off that point.
_MARKERS = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])
# m. Crank and ground together are almost as long as coupler and rocker: near where they lie in one
# line the coupler whips round: the peak of its acceleration lasts 0.06 s at half its height.
_NEAR_DEAD = {'ground': 0.4, 'crank': 0.2, 'coupler': 0.32, 'rocker': 0.281}


def motions() -> dict[str, Motion]:
    """Return the six motions by name, in the order of the tables."""
    bar, wheel = load_scene('four_bar'), load_scene('rolling_wheel')
    return {
        'four-bar coupler': Motion(lambda t: bar.motion(t)['coupler'], bar.markers['coupler']),
        'fast rotation': Motion(_fast_rotation, _MARKERS),
        'two sines': Motion(_two_sines, _MARKERS),
        'stop and go': Motion(_stop_and_go, _MARKERS),
        'rolling wheel': Motion(lambda t: wheel.motion(t)['wheel'], wheel.markers['wheel']),
        'dead point': Motion(_dead_point, bar.markers['coupler']),
    }


def still_turning(t: np.ndarray, rate: float, orbit: float = 0.05) -> BodyMotion:
    """A body that turns at `rate` rad/s while its reference point goes round a circle at 0.7 Hz."""
    angle = np.zeros((ORDERS, *t.shape))
    angle[0], angle[1] = rate * t, rate
    return BodyMotion(orbit * _turning(t, 2 * pi * 0.7), angle)


def swinging(t: np.ndarray, amplitude: float) -> BodyMotion:
    """Swings by `amplitude` rad to either side, on the orbit of `still_turning`."""
    return still_turning(t, 0.0)._replace(angle=amplitude * _turning(t, 2 * pi * 0.8).imag)


def cusped(t: np.ndarray, least: float) -> BodyMotion:
    """
    A body whose ICR slows down once a second, when t is whole, to `least` of its usual speed.

    The ICR P goes like a point of a wheel on a wheel, P' = i r c (exp(i c t) - (1 - least)
    exp(2 i c t)): a cusp of the centrode where `least` is 0. A body turning at a constant w, with P
    for its ICR, has a reference point z with z' = i w (z - P), term by term
    z = P w / (w - k c) for the term of k c.
    """
    circling, rate = 2 * pi, 2 * pi * 3.3
    body = still_turning(t, rate)
    position = sum(
        share * 0.05 * rate / (rate - k * circling) * _turning(t, k * circling)
        for k, share in ((1, 1.0), (2, (least - 1) / 2))
    )
    return BodyMotion(np.asarray(position), body.angle)


def _fast_rotation(t: np.ndarray) -> BodyMotion:
    return still_turning(t, 2 * pi * 5.0)


def _two_sines(t: np.ndarray) -> BodyMotion:
    slow, fast = 2 * pi * 0.8, 2 * pi * 1.9
    angle = 1.0 * _turning(t, slow).imag + 0.3 * _turning(t, fast, 0.5).imag
    x = 0.15 * _turning(t, slow, 1.1).imag + 0.03 * _turning(t, fast, 2.0).imag
    y = 0.1 * _turning(t, slow, -0.4).imag + 0.05 * _turning(t, fast, 0.9).imag
    return BodyMotion(x + 1j * y, angle)


def _stop_and_go(t: np.ndarray) -> BodyMotion:
    """Half a second of rest, half a second of motion on an arc, there and back, turning on."""
    cycle = np.floor(t)
    u = np.clip((t - cycle - 0.5) / 0.5, 0.0, 1.0)
    # The polynomial of degree 9 from 0 to 1 whose first four derivatives vanish at both ends.
    step = np.polynomial.Polynomial((0, 0, 0, 0, 0, 126, -420, 540, -315, 70))
    s = np.stack([step.deriv(k)(u) / 0.5**k if k else step(u) for k in range(ORDERS)])
    s[1:, (u == 0) | (u == 1)] = 0.0
    turned = s.copy()
    turned[0] += cycle
    back = cycle % 2 == 1
    s = np.where(back, -s, s)
    s[0] += back
    return BodyMotion(0.2 * s + 0.1j * (_product(s, s) - s), 1.2 * turned)


def _dead_point(t: np.ndarray) -> BodyMotion:
    return four_bar(t, turns_per_second=0.5, phase=0.3, branch='open', **_NEAR_DEAD)['coupler']


def _turning(t: np.ndarray, rate: float, phase: float = 0.0) -> np.ndarray:
    """exp(i (rate t + phase)) and its derivatives, (5, ...)."""
    return np.stack([(1j * rate) ** k * np.exp(1j * (rate * t + phase)) for k in range(ORDERS)])


def _product(f: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Derivatives of a product from those of its factors (Leibniz)."""
    return np.stack(
        [sum(comb(k, j) * f[j] * g[k - j] for j in range(k + 1)) for k in range(ORDERS)]
    )
