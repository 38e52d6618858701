"""Motions with events, at which a derivative steps, and the other motions as records like these."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bench._motions import motions, other_motions
from kinpole_ros import planar
from kinpole_ros.mechanism import BodyMotion
from kinpole_ros.mechanism._motions import ORDERS, rotation_derivatives


class Record(NamedTuple):
    """A motion of one body in N frames, (5, N), and the instants of its events, s."""

    position: np.ndarray
    angle: np.ndarray
    events: np.ndarray


def event_motions() -> dict[str, Callable[[np.ndarray], Record]]:
    """Return the motions with events by name."""
    return {
        'bounce': _bounce,
        'stick-slip': _stick_slip,
        'Geneva drive': _geneva,
        'backlash': _backlash,
        'Coulomb friction': _coulomb,
        'trapezoid drive': _trapezoid,
        'S-curve drive': _s_curve,
        'impact on a slider': _impact,
        'ratchet': _ratchet,
        'reversing drive': _reversing,
    }


def smooth_motions() -> dict[str, Callable[[np.ndarray], Record]]:
    """Return the other motions of the benchmarks by name."""

    def observed(motion: Callable[[np.ndarray], BodyMotion], markers: np.ndarray) -> Callable:
        mean = planar.to_complex(markers).mean()

        def record(t: np.ndarray) -> Record:
            moved = motion(t)
            position = moved.position + mean * rotation_derivatives(moved.angle)
            return Record(position, moved.angle, np.empty(0))

        return record

    return {name: observed(*one) for name, one in (motions() | other_motions()).items()}


Segment = tuple[float, float, float | None, float | None]


def _segments(t: np.ndarray, segments: list[Segment]) -> tuple[np.ndarray, np.ndarray]:
    """
    A signal (5, N) of cubic pieces, and where they meet.

    A segment is its duration, its jerk, and the acceleration and velocity that it begins with, None
    for those that the segment before ends with. Segments repeat.
    """
    signal, events = np.zeros((ORDERS, len(t))), []
    start, state, k = 0.0, np.zeros(3), 0
    while start <= t[-1]:
        duration, jerk, acceleration, velocity = segments[k % len(segments)]
        state[2] = state[2] if acceleration is None else acceleration
        state[1] = state[1] if velocity is None else velocity
        piece = np.polynomial.Polynomial((*state / (1, 1, 2), jerk / 6))
        inside = (t >= start) & (t < start + duration)
        for order in range(ORDERS):
            signal[order, inside] = (piece.deriv(order) if order else piece)(t[inside] - start)
        state = np.array([piece(duration), piece.deriv()(duration), piece.deriv(2)(duration)])
        start, k = start + duration, k + 1
        events.append(start)
    return signal, np.array(events)


def _sine(t: np.ndarray, size: float, hertz: float, phase: float = 0.0) -> np.ndarray:
    rate = 2 * np.pi * hertz
    return np.stack([size * (rate * 1j) ** k * np.exp(1j * (rate * t + phase)) for k in range(5)])


def _pinned(angle: np.ndarray, events: np.ndarray) -> Record:
    """A body that turns about a point 0.2 m above it."""
    return Record(-0.2j * rotation_derivatives(angle), angle, events)


def _bounce(t: np.ndarray) -> Record:
    """A ball that bounces, with a spin that changes."""
    speeds, spins = (1.5, 1.1, 0.8, 1.7, 1.25), (4.0, -1.0, 2.5, 6.0, -3.0)
    flights = [2 * speed / 9.81 for speed in speeds]
    height, events = _segments(
        t, [(flight, 0.0, -9.81, speed) for flight, speed in zip(flights, speeds, strict=True)]
    )
    angle, _ = _segments(
        t, [(flight, 0.0, 0.0, spin) for flight, spin in zip(flights, spins, strict=True)]
    )
    along = np.zeros_like(height)
    along[0], along[1] = 0.3 * t, 0.3
    return Record(along + 1j * height, angle, events)


def _stick_slip(t: np.ndarray) -> Record:
    """A rocker held by friction to a belt, and pulled back by a spring."""
    half, speed, rate = 0.15, 0.7, 2 * np.pi * 4
    lean = np.arctan2(half * rate, speed)
    slip, stick = (2 * np.pi - 2 * lean) / rate, 2 * half / speed
    phase = np.mod(t, slip + stick)
    angle = np.zeros((ORDERS, len(t)))
    size = np.hypot(half, speed / rate)
    for k in range(ORDERS):
        slipping = size * rate**k * np.sin(rate * phase + lean + k * np.pi / 2)
        sticking = (-half + speed * (phase - slip), speed, 0.0, 0.0, 0.0)[k]
        angle[k] = np.where(phase < slip, slipping, sticking)
    cycles = (slip + stick) * np.arange(int(t[-1] / (slip + stick)) + 2)
    return _pinned(angle, np.sort(np.concatenate((cycles, cycles + slip))))


def _geneva(t: np.ndarray) -> Record:
    """A Geneva wheel of four slots."""
    rate = 2 * np.pi * 1.2
    turns, crank = np.divmod(rate * t + np.pi, 2 * np.pi)
    crank -= np.pi
    s, q = np.sqrt(2), np.exp(-1j * np.clip(crank, -np.pi / 4, np.pi / 4))
    d = s - q
    wave = (
        np.log(d),
        1j * q / d,
        s * q / d**2,
        -1j * s * q * (s + q) / d**3,
        -s * q * (s**2 + 4 * s * q + q**2) / d**4,
    )
    angle = np.stack([rate**k * each.imag for k, each in enumerate(wave)])
    angle[0] += np.pi / 2 * turns
    angle[1:, np.abs(crank) >= np.pi / 4] = 0.0
    cycles = 2 * np.pi * np.arange(turns[-1] + 2)
    return _pinned(angle, np.sort(np.concatenate((cycles - np.pi / 4, cycles + np.pi / 4))) / rate)


def _backlash(t: np.ndarray) -> Record:
    """The driven side of a joint with play: it stays where the drive reverses, until it is hit."""
    size, play, hertz = 0.5, 0.06, 0.8
    halves = 2 * hertz * t - 0.5
    half = np.floor(halves)
    sign = np.where(half % 2 == 0, 1.0, -1.0)
    drive = _sine(t, size, hertz).imag
    hit = np.arccos(1 - 2 * play / size) / np.pi
    held = halves - half < hit
    angle = drive.copy()
    angle[0] += sign * play
    angle[:, held] = 0.0
    angle[0, held] = sign[held] * (size - play)
    number = np.arange(half[-1] + 2)
    return _pinned(angle, np.sort(np.concatenate((number, number + hit)) + 0.5) / 2 / hertz)


def _coulomb(t: np.ndarray) -> Record:
    """A swing with dry friction."""
    size, friction, hertz = 1.0, 0.025, 1.1
    half = np.floor(2 * hertz * t)
    angle = np.zeros((ORDERS, len(t)))
    sign = np.where(half % 2 == 0, 1.0, -1.0)
    angle = (size - friction * (2 * half + 1)) * _sine(t, 1.0, hertz).real
    angle[0] += sign * friction
    return _pinned(angle, np.arange(half[-1] + 2) / 2 / hertz)


def _trapezoid(t: np.ndarray) -> Record:
    go: list[Segment] = [(0.15, 0.0, 20.0, None), (0.31, 0.0, 0.0, None), (0.15, 0.0, -20.0, None)]
    back: list[Segment] = [
        (0.15, 0.0, -20.0, None),
        (0.31, 0.0, 0.0, None),
        (0.15, 0.0, 20.0, None),
    ]
    rest: list[Segment] = [(0.29, 0.0, 0.0, 0.0)]
    return _pinned(*_segments(t, go + rest + back + rest))


def _s_curve(t: np.ndarray) -> Record:
    def move(jerk: float) -> list[Segment]:
        each = ((0.09, jerk), (0.09, -jerk), (0.23, 0.0), (0.09, -jerk), (0.09, jerk))
        return [*((length, one, None, None) for length, one in each), (0.27, 0.0, 0.0, 0.0)]

    return _pinned(*_segments(t, move(350.0) + move(-350.0)))


def _impact(t: np.ndarray) -> Record:
    """A slider on a slow wave is hit now and then, and rings."""
    period, decay = 0.83, complex(-12.0, 2 * np.pi * 9)
    x, angle = _sine(t, 0.1, 0.7).imag, _sine(t, 0.3, 0.9, 0.4).imag
    hits = period * np.arange(1, int(t[-1] / period) + 1)
    for k, hit in enumerate(hits):
        since = t - hit
        ring = np.stack([(decay**n * np.exp(decay * np.maximum(since, 0))).imag for n in range(5)])
        ring *= (since >= 0) * (0.3, -0.2, 0.1)[k % 3] / decay.imag
        x, angle = x + ring, angle + 3.0 * ring
    return Record(x + 0.02j * _sine(t, 1.0, 0.7, 0.3).imag, angle, hits)


def _ratchet(t: np.ndarray) -> Record:
    return _pinned(*_segments(t, [(0.2, 0.0, 15.0, 0.0), (0.34, 0.0, 0.0, 0.0)]))


def _reversing(t: np.ndarray) -> Record:
    push = (25.0, -25.0, -10.0, 10.0)
    return _pinned(*_segments(t, [(0.31, 0.0, one, None) for one in push]))
