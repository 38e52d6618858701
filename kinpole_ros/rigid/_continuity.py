"""
Frames in which a body as a whole is wrong: its markers agree, but not with the frames around.

A tracker that takes a body for another, or sees it mirrored in a window, gives a pose that fits its
shape and is far from where the body can be. So each pose is predicted from those before it, by the
polynomial that predicts best of late, and its innovation is held against those of late (an
innovation test, Bar-Shalom 2001). One of a higher degree may do as well: a body at rest may begin
to move. A pose that is far off is suspect until the next ones come: they
go back to where the body was to be, and it was wrong, or they do not, and the body did jump.
"""

import math
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._noise import tame_part
from kinpole_ros.rigid._predict import (
    AGO,
    GAINS,
    POINTS,
    REACHES,
    WEIGHTS,
    innovations,
    lagrange,
)
from kinpole_ros.rigid.levels import FEW, KEPT, LITTLE, RECENT, RUNNING

# An innovation is far that is so many times what all but the worst three tenths of late stay below.
_FAR = 7.0
# A pose has gone back that is off by no more than this share of what the suspect ones were off.
_BACK = 0.5
_TURN = math.tau
_NOTHING = complex(np.nan, np.nan)
# What is predicted from nothing comes out as NaN.
_UNDEFINED = np.errstate(divide='ignore', invalid='ignore', over='ignore')


class Verdict(NamedTuple):
    """
    What frames say of bodies (T, B): how often they have turned round, how many of the newest
    frames are `suspect` then, and how many before this one were `wrong`, as it shows.
    """

    turns: Real
    suspect: np.ndarray
    wrong: np.ndarray


class Continuity:
    """
    Whether the poses of B bodies go on as those before; angles are in (-pi, pi].

    Signals (2 B,) are angles with whole turns, and then positions; NaN where nothing is known.
    """

    def __init__(self, bodies: int) -> None:
        self._bodies = bodies
        # The last samples of each body that are right, oldest first: stamps, ns, numbers of their
        # frames, signals.
        self._stamps = np.zeros((POINTS, bodies))
        self._numbers = np.zeros((POINTS, bodies), int)
        self._signals = np.full((POINTS, 2 * bodies), _NOTHING)
        # How many frames came.
        self._number = 0
        self._last_angle = np.zeros(bodies)
        self._last_turn = np.zeros(bodies)
        # What `odd` found of the next frames.
        self._next: tuple[np.ndarray, Real, Real, Complex] | None = None
        # Stamps and signals since a body was off, by body.
        self._runs: dict[int, list[tuple[float, Complex]]] = {}
        # Squares of innovations of late, by degree, and the frames since the last beat, of which
        # the first so many are from before.
        self._squares = np.full((KEPT, POINTS, 2 * bodies), np.nan)
        self._count = self._before = 0
        self._news: list[tuple[Real, Complex]] = []
        self._degree = np.zeros(2 * bodies, int)
        self._weights = WEIGHTS[self._degree].T + 0j
        self._limit = np.full(2 * bodies, np.inf)

    def forget(self) -> None:
        """Do not expect the next poses to go on from those before a gap."""
        self.begin(np.ones(self._bodies, bool))

    def begin(self, which: np.ndarray) -> None:
        """Forget the poses of the bodies `which` (B,): those to come do not go on from them."""
        both = np.tile(which, 2)
        self._signals[:, both] = _NOTHING
        for b in np.flatnonzero(which).tolist():
            self._runs.pop(b, None)
        for _, signals in self._news:
            signals[:, both] = _NOTHING

    def were_at(self, times: np.ndarray) -> None:
        """The newest frames that were taken turned out to be at `times` (T,), ns."""
        place = len(times) - (self._number - self._numbers)
        # Those that no sample was taken of yet have the number of the next frame.
        known = (place >= 0) & (place < len(times))
        self._stamps = np.where(known, times[np.where(known, place, 0)], self._stamps)
        for run in self._runs.values():
            for k in range(min(len(run), len(times))):
                run[-1 - k] = float(times[-1 - k]), run[-1 - k][1]

    @_UNDEFINED
    def odd(self, stamps: np.ndarray, angle: Real, position: Complex) -> np.ndarray:
        """
        Which of the next frames (T,), by stamps, ns, and poses (T, B), are far off.

        Of these the first is meant: it is to be taken by `step`.
        """
        unwrapped, turns = self._unwrapped(angle)
        signals = np.concatenate((unwrapped, position), axis=-1)
        self._next = stamps, angle, turns, signals
        count = len(stamps)
        if self._runs:
            return np.ones(count, bool)
        # What is where even steps lead to is not far off, however long they are. That is soon seen.
        every = np.concatenate((self._signals, signals))
        off = signals - self._weights[0] * every[:count]
        for k in range(1, POINTS):
            off -= self._weights[k] * every[k : k + count]
        near = off.real**2 + off.imag**2 <= self._limit
        consecutive = self._numbers == self._number - AGO
        if np.count_nonzero(consecutive) < consecutive.size:
            near[:POINTS] &= np.tile(consecutive, 2)[:count]
        if np.count_nonzero(near) < near.size:
            near |= np.isnan(signals)
        if np.count_nonzero(near) == near.size:
            return np.zeros(count, bool)
        return np.logical_or.reduce(self._off(stamps, signals)[2] & ~near, axis=-1)

    def follow(self, count: int) -> Real:
        """Take the first frames that were not found odd; the turns (T, B) of the bodies."""
        assert self._next is not None
        stamps, angle, turns, signals = (part[:count] for part in self._next)
        times = stamps.astype(float)
        numbers = self._number + np.arange(count)
        if np.count_nonzero(np.isnan(signals)):
            for b in range(self._bodies):
                kept = np.isfinite(signals[:, b]).nonzero()[0][-POINTS:]
                self._append(b, times[kept], numbers[kept], signals[kept])
        else:
            new = min(count, POINTS)
            for kept, rows in (
                (self._stamps, times[:, None]),
                (self._numbers, numbers[:, None]),
                (self._signals, signals),
            ):
                kept[:-new] = kept[new:]
                kept[-new:] = rows[-new:]
        self._go_on(times, angle, turns, signals)
        return turns

    @_UNDEFINED
    def step(self, stamp: int, angle: Real, position: Complex) -> Verdict:
        """Take the one next frame (1, B), which may be odd."""
        stamps = np.array([stamp])
        chain, turns = self._unwrapped(angle)
        signals = np.concatenate((chain, position), axis=-1)
        ahead, off, far = (part[0] for part in self._off(stamps, signals))
        far = far.reshape(2, -1).any(axis=0)
        wrong = np.zeros(self._bodies, int)
        held = signals.copy()
        for b in sorted({*far.nonzero()[0].tolist(), *self._runs}):
            both = [b, self._bodies + b]
            run = self._runs.setdefault(b, [])
            near = not far[b] and np.isfinite(off[both]).all()
            if near and self._back(signals[0, both], float(stamp), run, b):
                # The suspect poses may have been taken for so many turns more.
                more = np.rint((signals[0, b] - off[b] - ahead[b]).real / _TURN)
                turns[0, b] -= more
                held[0, b] -= _TURN * more
                wrong[b] = len(run)
                del self._runs[b]
                continue
            run.append((float(stamp), signals[0, both]))
            held[0, both] = _NOTHING
            if len(run) > RUNNING:
                # It has jumped, and what was before says nothing of it.
                self._signals[:, both] = _NOTHING
                for k, (time, here) in enumerate(run):
                    if np.isfinite(here[0]):
                        number = self._number + k + 1 - len(run)
                        self._put(b, time, number, here)
                del self._runs[b]
        for b in np.isfinite(held[0, : self._bodies]).nonzero()[0].tolist():
            self._put(b, float(stamp), self._number, held[0, [b, self._bodies + b]])
        self._go_on(stamps.astype(float), angle, turns, held)
        suspect = np.zeros(self._bodies, int)
        for b, run in self._runs.items():
            suspect[b] = len(run)
        return Verdict(turns, suspect[None], wrong[None])

    @_UNDEFINED
    def learn(self, size: Real) -> None:
        """A beat: see how well the frames since the last were predicted; `size` (B,), m."""
        if not self._news:
            return
        stamps, signals = (np.concatenate(part) for part in zip(*self._news, strict=True))
        fresh = innovations(stamps, signals)[max(self._before, POINTS) :][-KEPT:]
        # The next frames are predicted from the last of these.
        self._news = [(stamps[-RECENT:], signals[-RECENT:])]
        self._before = len(self._news[0][0])
        if not len(fresh):
            return
        self._squares[(self._count + np.arange(len(fresh))) % KEPT] = fresh
        self._count += len(fresh)
        filled = self._squares[: min(self._count, KEPT)]
        enough = np.isfinite(filled).sum(axis=0) >= FEW
        usual = tame_part(filled.reshape(len(filled), -1).T).reshape(enough.shape)
        usual = np.where(enough, usual, np.inf)
        self._degree = usual.argmin(axis=0)
        self._weights = WEIGHTS[self._degree].T + 0j
        least = LITTLE * np.concatenate((np.ones(self._bodies), size))
        # rad, and m: what is nearer is no jump, however smooth the motion.
        self._limit = np.maximum(_FAR**2 * usual.min(axis=0), least**2)

    def _off(self, stamps: np.ndarray, signals: Complex) -> tuple[Complex, Complex, np.ndarray]:
        """
        Signals of frames (T, 2 B) as predicted at true times, and what they are off that.

        NaN where nothing tells. Also where that is too far.
        """
        ahead, off = np.full((2, *signals.shape), _NOTHING)
        far = np.zeros(signals.shape, bool)
        if not np.isfinite(self._limit).any():
            return ahead, off, far
        numbers = self._number + np.arange(len(stamps))
        found: dict[bytes, Real] = {}
        for b in range(self._bodies):
            kept = np.isfinite(signals[:, b]).nonzero()[0]
            times = np.concatenate((self._stamps[:, b], stamps[kept]))
            every = np.concatenate((self._numbers[:, b], numbers[kept]))
            # As a rule all bodies are seen in the same frames.
            key = every.tobytes()
            if key not in found:
                found[key] = lagrange(times, every)
            for signal in (b, self._bodies + b):
                values = np.concatenate((self._signals[:, signal], signals[kept, signal]))
                parts = self._predicted(signal, values, found[key])
                ahead[kept, signal], off[kept, signal], far[kept, signal] = parts
        return ahead, off, far

    def _predicted(
        self, signal: int, values: Complex, weights: Real
    ) -> tuple[Complex, Complex, np.ndarray]:
        """
        The same of one signal, `values` (4 + T,), by the best of predictions of `weights`.

        Of degrees from that on which is best as a rule.
        """
        rows = np.arange(len(weights))
        past = values[rows[:, None] + np.arange(POINTS)]
        ahead = (weights * past[:, None]).sum(axis=-1)
        off = values[POINTS:, None] - ahead
        if signal < self._bodies:
            off = _wrapped(off.real) + 0j
        degree = int(self._degree[signal])
        # So much more than one step ahead of even samples, and than by the degree that is best.
        growth = np.fmax(np.abs(weights).sum(axis=-1) / REACHES, 1.0) ** 2
        growth *= GAINS / GAINS[degree]
        share = (off.real**2 + off.imag**2) / (self._limit[signal] * growth)
        best = degree + np.where(np.isnan(share), np.inf, share)[:, degree:].argmin(axis=1)
        return ahead[rows, best], off[rows, best], share[rows, best] > 1

    def _back(self, here: Complex, stamp: float, run: list[tuple[float, Complex]], b: int) -> bool:
        """
        Whether a sample `here` (2,) is back from where the run was.

        By any of the degrees: what follows the motion best from frame to frame has the noise grow
        most over several.
        """
        for part, signal in enumerate((b, self._bodies + b)):
            off = self._ahead(signal, stamp, here[part])[0]
            for time, there in run:
                away, far = self._ahead(signal, time, there[part])
                if far and not (np.abs(off) <= _BACK * np.abs(away)).any():
                    return False
        return True

    def _ahead(self, signal: int, stamp: float, value: complex) -> tuple[Complex, bool]:
        """How far (degrees,) a sample is off what each predicts; whether that is too far."""
        times = np.append(self._stamps[:, signal % self._bodies], stamp)
        weights = lagrange(times, np.arange(len(times)))
        values = np.append(self._signals[:, signal], value)
        off = value - weights[0] @ values[:POINTS]
        if signal < self._bodies:
            off = _wrapped(off.real) + 0j
        return off, bool(self._predicted(signal, values, weights)[2][0])

    def _append(self, b: int, times: Real, numbers: np.ndarray, signals: Complex) -> None:
        for time, number, row in zip(times, numbers, signals, strict=True):
            self._put(b, time, number, row[[b, self._bodies + b]])

    def _put(self, b: int, time: float, number: int, signals: Complex) -> None:
        """One more sample (2,) of a body."""
        both = [b, self._bodies + b]
        self._stamps[:-1, b], self._stamps[-1, b] = self._stamps[1:, b].copy(), time
        self._numbers[:-1, b], self._numbers[-1, b] = self._numbers[1:, b].copy(), number
        self._signals[:-1, both] = self._signals[1:, both]
        self._signals[-1, both] = signals

    def _go_on(self, times: Real, angle: Real, turns: Real, signals: Complex) -> None:
        """Count frames, and keep what they tell until a beat."""
        known = np.isfinite(angle)
        if np.count_nonzero(known) == known.size:
            self._last_angle, self._last_turn = angle[-1], turns[-1]
        else:
            row = np.where(known, np.arange(len(angle))[:, None], -1).max(axis=0)
            there, body = row >= 0, np.arange(self._bodies)
            self._last_angle = np.where(there, angle[row, body], self._last_angle)
            self._last_turn = np.where(there, turns[row, body], self._last_turn)
        self._number += len(times)
        self._news.append((times, signals))
        self._next = None

    def _unwrapped(self, angle: Real) -> tuple[Real, Real]:
        """Angles (T, B) with whole turns, as what comes between -pi and pi goes on; the turns."""
        known, given = np.isfinite(angle), angle
        if np.count_nonzero(known) < known.size:
            # Where nothing is known it is as it was.
            rows = np.where(known, np.arange(1, len(angle) + 1)[:, None], 0)
            before = np.concatenate((self._last_angle[None], np.where(known, angle, 0.0)))
            angle = np.take_along_axis(before, np.maximum.accumulate(rows, axis=0), axis=0)
        steps = angle - np.concatenate((self._last_angle[None], angle[:-1]))
        turns = self._last_turn - np.add.accumulate(np.rint(steps / _TURN))
        return given + _TURN * turns, turns


def _wrapped(angle: Real) -> Real:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % _TURN - np.pi)
