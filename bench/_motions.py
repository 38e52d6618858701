"""
The motions the benchmarks are made on, each exact to the fourth derivative.

Six differ in what is hard about them: a mechanism's many harmonics, far turning within a window,
rates that pass through zero, rest, poles that stand still in the body, and a sudden whip. The
others were added later, to see whether what is good for those six is good for the rest: harmonics
near the noise, at several speeds, dwells, motion that dies away, and motion with no period.
"""

from collections.abc import Callable
from functools import partial
from math import comb, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import BodyMotion, load_scene
from kinpole_ros.mechanism._motions import ORDERS, rotation_derivatives


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
_NEAR_DEAD = {
    'bodies': {
        'ground': {'O': [0, 0], 'C': [0.4, 0]},
        'crank': {'O': [0, 0], 'A': [0.2, 0]},
        'coupler': {'A': [0, 0], 'B': [0.32, 0]},
        'rocker': {'C': [0, 0], 'B': [0.281, 0]},
    },
    'drivers': [{'drive': 'crank', 'rate': '0.5 rev/s', 'start': 0.3}],
    'start': {'coupler': 0.9, 'rocker': 1.8},
}


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


def other_motions() -> dict[str, Motion]:
    """Return the other motions by name."""
    rods = {
        f'rod at {rate} rev/s': Motion(partial(_periodic, _rod, rate), _MARKERS)
        for rate in (2, 4, 8, 15)
    }
    return rods | {
        'Jansen leg': Motion(partial(_periodic, _jansen_leg, 1.0), _MARKERS),
        'cam with dwells': Motion(_cam, _MARKERS),
        'decaying pendulum': Motion(_decaying, _MARKERS),
        'random': Motion(_random, _MARKERS),
        'turning with a ripple': Motion(_ripple, _MARKERS),
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
    s = _rise(t - cycle - 0.5, 0.5)
    turned = s.copy()
    turned[0] += cycle
    back = cycle % 2 == 1
    s = np.where(back, -s, s)
    s[0] += back
    return BodyMotion(0.2 * s + 0.1j * (_product(s, s) - s), 1.2 * turned)


def _dead_point(t: np.ndarray) -> BodyMotion:
    return load_scene(_NEAR_DEAD).motion(t)['coupler']


def _periodic(
    pose: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], rate: float, t: np.ndarray
) -> BodyMotion:
    """
    Motion at times (N,), s, of a body on a crank that turns at `rate` rev/s.

    `pose` gives position (M,), complex, m, and angle (M,), rad, by angles (M,) of the crank. The
    derivatives are those of its Fourier series, which ends soon: both are smooth.
    """
    count = 512
    position, angle = pose(2 * pi * np.arange(count) / count)
    series = np.fft.fft(np.stack((position, angle))) / count
    series[np.abs(series) < 1e-13] = 0.0
    number = np.rint(np.fft.fftfreq(count, 1 / count))
    kept = np.flatnonzero(series.any(axis=0))
    found = sum(series[:, k, None, None] * _turning(t, 2 * pi * rate * number[k]) for k in kept)
    return BodyMotion(found[0], found[1].real)


def _rod(crank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The middle and the angle of the rod of a slider-crank, its crank a third of it."""
    pin = 0.1 * np.exp(1j * crank)
    angle = -np.arcsin(pin.imag / 0.3)
    return pin + 0.15 * np.exp(1j * angle), angle


def _jansen_leg(crank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    The last link of a leg of Theo Jansen's (with his eleven holy numbers, in units of 5 mm).

    Each joint is where two circles meet, on the left of the way from the first to the second.
    """
    a, b, c, d, e, f, g, h, i, j, k, up, m = (
        np.array((38.0, 41.5, 39.3, 40.1, 55.8, 39.4, 36.7, 65.7, 49.0, 50.0, 61.9, 7.8, 15.0))
        * 0.005
    )

    def meet(p: np.ndarray, to_p: float, q: np.ndarray, to_q: float) -> np.ndarray:
        apart = np.abs(q - p)
        along = (apart**2 + to_p**2 - to_q**2) / (2 * apart)
        return np.asarray(p + (along + 1j * np.sqrt(to_p**2 - along**2)) * (q - p) / apart)

    pin = a + 1j * up + m * np.exp(1j * crank)
    ground = np.zeros_like(pin)
    upper, lower = meet(ground, b, pin, j), meet(pin, k, ground, c)
    left = meet(ground, d, upper, e)
    knee = meet(lower, g, left, f)
    foot = meet(lower, i, knee, h)
    return (knee + foot) / 2, np.unwrap(np.angle(foot - knee))


def _cam(t: np.ndarray) -> BodyMotion:
    """A rocker on a pin that rises by 0.6 rad, dwells and returns, once in a second."""
    cycle = t - np.floor(t)
    return _on_a_pin(0.6 * (_rise(cycle - 0.1, 0.25) - _rise(cycle - 0.6, 0.3)))


def _rise(t: np.ndarray, length: float) -> np.ndarray:
    """A rise from 0 to 1 in `length` s, and its derivatives, (5, ...), all continuous."""
    u = np.clip(t / length, 0.0, 1.0)
    # The polynomial of degree 9 from 0 to 1 whose first four derivatives vanish at both ends.
    step = np.polynomial.Polynomial((0, 0, 0, 0, 0, 126, -420, 540, -315, 70))
    found = np.stack([step.deriv(k)(u) / length**k if k else step(u) for k in range(ORDERS)])
    found[1:, (u == 0) | (u == 1)] = 0.0
    return found


def _decaying(t: np.ndarray) -> BodyMotion:
    """A pendulum that starts at 0.8 rad and loses a third of its swing in a second."""
    rate = complex(-0.4, 2 * pi * 1.1)
    return _on_a_pin(np.stack([(0.8 * rate**k * np.exp(rate * t)).real for k in range(ORDERS)]))


def _on_a_pin(angle: np.ndarray) -> BodyMotion:
    """A body that turns about a point 0.2 m above it, by that angle and its derivatives."""
    position = -0.2j * rotation_derivatives(angle)
    return BodyMotion(position, angle)


def _random(t: np.ndarray) -> BodyMotion:
    """Gaussian motion of all frequencies up to 3 Hz alike."""
    rng = np.random.default_rng(5)
    waves = [
        (scale * rng.normal(), 2 * pi * rng.uniform(0, 3), rng.uniform(0, 2 * pi))
        for scale in (0.1, 0.03, 0.03)
        for _ in range(40)
    ]
    each = np.stack([size * _turning(t, *wave).real for size, *wave in waves])
    angle, x, y = each.reshape(3, 40, *each.shape[1:]).sum(axis=1)
    return BodyMotion(x + 1j * y, angle)


def _ripple(t: np.ndarray) -> BodyMotion:
    """Turning at 2 rev/s, with a ripple of 0.1% of a turn six times in each."""
    body = still_turning(t, 2 * pi * 2.0)
    return body._replace(angle=body.angle + 0.002 * pi * _turning(t, 2 * pi * 12.0).imag)


def _turning(t: np.ndarray, rate: float, phase: float = 0.0) -> np.ndarray:
    """exp(i (rate t + phase)) and its derivatives, (5, ...)."""
    return np.stack([(1j * rate) ** k * np.exp(1j * (rate * t + phase)) for k in range(ORDERS)])


def _product(f: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Derivatives of a product from those of its factors (Leibniz)."""
    return np.stack(
        [sum(comb(k, j) * f[j] * g[k - j] for j in range(k + 1)) for k in range(ORDERS)]
    )
