"""
The ways in which drivers, cameras and bodies spoil markers.

Each takes an exact recording and says what is sent of it, and with which parameters it is tracked.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from bench._rigs import NOISE, Recording
from kinpole_ros.planar import to_complex

# ns, between frames that a driver takes from its queue.
_WAIT = 100_000
# Share of frames.
LOST = 0.02
# s. When names begin to fail: before shapes are learned, and after.
EARLY, LATE = 0.1, 2.5


class Sent(NamedTuple):
    """
    What of a recording a driver sends: the `frames` (M,) by number, `stamps` (M,), ns, and `points`
    (M, n, 3) under `names`.

    `settings` are the parameters, by their ROS names; `turn` (3, 3) takes the plane of the
    recording to that of the points. `nameless` points are known by their place alone, and those
    that are not seen, which come last, are in no message.
    """

    frames: np.ndarray
    stamps: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]
    settings: dict[str, Any]
    turn: np.ndarray
    nameless: bool = False


Spoil: TypeAlias = Callable[[Recording, np.random.Generator], Sent]


def ideal(r: Recording, rng: np.random.Generator | None = None, **changes: Any) -> Sent:
    """All as it is; `changes` are other parts of what is sent, and more settings."""
    settings = {'bodies': list(r.bodies)} | _markers(r, r.names) | changes.pop('settings', {})
    sent = Sent(np.arange(len(r.times)), r.stamps, r.points, r.names, settings, np.eye(3))
    return sent._replace(**changes)


def _markers(r: Recording, names: tuple[str, ...]) -> dict[str, Any]:
    """The parameters <body>.markers where the markers have these names."""
    return {
        f'{body}.markers': [name for name, b in zip(names, r.owner, strict=True) if b == k]
        for k, body in enumerate(r.bodies)
    }


def combined(stamps: Spoil, *others: Spoil) -> Spoil:
    """
    Several at once: what becomes of the stamps, and then the others, one after the other.

    What becomes of the plane comes after what moves markers in it, and what of names comes last.
    """

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        first = sent = stamps(r, rng)
        kept, settings, turn = first.frames, first.settings, first.turn
        r = r._replace(
            times=r.times[kept],
            stamps=first.stamps,
            position=r.position[:, kept],
            angle=r.angle[:, kept],
        )
        for other in others:
            sent = other(r._replace(points=sent.points), rng)
            settings, turn = settings | sent.settings, turn @ sent.turn
        return sent._replace(frames=kept, stamps=first.stamps, settings=settings, turn=turn)

    return spoil


def parameters(**settings: Any) -> Spoil:
    return lambda r, rng: ideal(r, settings=settings)


def stamped(
    late: Callable[[np.random.Generator, int], np.ndarray],
    step: int = 1,
    lost: float = LOST,
    wait: int = 1,
) -> Spoil:
    """
    Stamps late by times (M,), s, rounded to `step` ns, in order; so many frames are lost.

    Those that come at once are stamped `wait` ns after each other.
    """

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        kept = np.flatnonzero(rng.random(len(r.times)) >= lost)
        stamps = r.stamps[kept] + np.rint(1e9 * late(rng, len(kept))).astype(np.int64)
        stamps = (stamps + step // 2) // step * step
        # What overtakes waits in the queue for those before.
        queue = wait * np.arange(len(kept))
        stamps = np.maximum.accumulate(stamps - queue) + queue
        return ideal(r, frames=kept, stamps=stamps, points=r.points[kept])

    return spoil


def exponential(mean: float, lost: float = LOST) -> Spoil:
    return stamped(lambda rng, count: rng.exponential(mean, count), lost=lost, wait=_WAIT)


def in_time(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.zeros(count)


def tilted(degrees: float, plane: str) -> Spoil:
    """The plane turned about any axis in it."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        axis = rng.uniform(0, 2 * np.pi)
        x, y = np.cos(axis), np.sin(axis)
        cross = np.array([(0, 0, y), (0, 0, -x), (-y, x, 0)])
        angle = np.deg2rad(degrees)
        # Rodrigues' rotation formula.
        turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        return ideal(r, points=r.points @ turn.T, turn=turn, settings={'plane': plane})

    return spoil


def in_mm(**settings: Any) -> Spoil:
    return lambda r, rng: ideal(r, points=1e3 * r.points, settings=settings)


def _two(r: Recording) -> list[int]:
    """The last marker of the first body and the first of the next."""
    return [int((r.owner == 0).sum()) - 1, int((r.owner == 0).sum())]


def exchanged(since: float) -> Spoil:
    """The names of two markers of two bodies, from so many s on."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        points, two = r.points.copy(), _two(r)
        after = r.times >= since
        points[np.ix_(after, two)] = r.points[np.ix_(after, two[::-1])]
        return ideal(r, points=points)

    return spoil


def renamed(r: Recording, rng: np.random.Generator) -> Sent:
    """Two ids gone for 0.3 s, then back as new ones."""
    two = _two(r)
    points = np.concatenate((r.points, r.points[:, two]), axis=1)
    points[np.ix_(r.times >= LATE, two)] = np.nan
    points[r.times < LATE + 0.3, -2:] = np.nan
    return ideal(r, points=points, names=(*r.names, 'new_1', 'new_2'))


def _nameless(r: Recording, points: np.ndarray, **settings: Any) -> Sent:
    """Points (T, n, 3) known by their place, less those that are not seen."""
    unseen = ~np.isfinite(points[..., 0])
    order = np.argsort(unseen, axis=1, kind='stable')
    points = np.take_along_axis(points, order[..., None], axis=1)
    names = tuple(map(str, range(points.shape[1])))
    settings = _markers(r, names[: len(r.names)]) | settings
    return ideal(r, points=points, names=names, settings=settings, nameless=True)


def absent(share: float) -> Spoil:
    """So many of the points of a cloud without names are not there."""
    return lambda r, rng: _nameless(r, _gone(r, rng, share))


def _gone(r: Recording, rng: np.random.Generator, share: float) -> np.ndarray:
    gone = rng.random(r.points.shape[:2]) < share
    return np.where(gone[..., None], np.nan, r.points)


def ghost(r: Recording, rng: np.random.Generator) -> Sent:
    """A point that stands amid the bodies from a time on, somewhere in the order of each frame."""
    count = len(r.names)
    ghost = np.full((len(r.times), 1, 3), np.nan)
    ghost[r.times >= LATE] = r.points.mean(axis=(0, 1))
    ghost += NOISE * rng.normal(size=ghost.shape)
    place = rng.integers(count + 1, size=(len(ghost), 1)) - 0.5
    order = np.argsort(np.concatenate((np.arange(count) + 0 * place, place), axis=1), axis=1)
    every = np.concatenate((r.points, ghost), axis=1)
    return _nameless(r, np.take_along_axis(every, order[..., None], axis=1))


def any_order(r: Recording, rng: np.random.Generator) -> Sent:
    order = rng.permuted(np.tile(np.arange(len(r.names)), (len(r.times), 1)), axis=1)
    shapes = {
        f'{body}.shape': np.ravel([(w.real, w.imag) for w in r.shape[r.owner == b]]).tolist()
        for b, body in enumerate(r.bodies)
    }
    points = np.take_along_axis(r.points, order[..., None], axis=1)
    return _nameless(r, points, marker_identity='shape', **shapes)


def _firsts(r: Recording) -> np.ndarray:
    """The first marker (B,) of each body."""
    return np.searchsorted(r.owner, np.arange(len(r.bodies)))


def _moved(r: Recording, by: np.ndarray, **changes: Any) -> Sent:
    """All markers moved by (T, N), complex, m, in the plane."""
    points = r.points.copy()
    points[..., 0] += by.real
    points[..., 1] += by.imag
    return ideal(r, points=points, **changes)


def noisier(times: float) -> Spoil:
    """One marker of each body has so many times the noise."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        points = r.points.copy()
        more = NOISE * np.sqrt(times**2 - 1) * rng.normal(size=(len(points), len(r.bodies), 3))
        points[:, _firsts(r)] += more
        return ideal(r, points=points)

    return spoil


def slipping(far: float) -> Spoil:
    """One marker of each body slides so far, m, to either side along its x axis as it turns."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        by, phase = np.zeros(r.points.shape[:2], complex), np.sin(r.angle[0])
        by[:, _firsts(r)] = far * phase / np.abs(phase).max(axis=0) * np.exp(1j * r.angle[0])
        return _moved(r, by)

    return spoil


def soft(far: float) -> Spoil:
    """Each marker wobbles by so much per axis, m, with a correlation of 1/e after 0.2 s."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        white = rng.normal(size=(*r.points.shape[:2], 2)) @ (1, 1j)
        # White noise through a Gaussian of s seconds is correlated as exp(-(t / 2 s)^2), s = 0.1.
        frequency = np.fft.fftfreq(len(white), r.times[1] - r.times[0])
        wave = np.exp(-2 * (np.pi * 0.1 * frequency) ** 2)
        wobble = np.fft.ifft(np.fft.fft(white, axis=0) * wave[:, None], axis=0)
        return _moved(r, far * wobble / np.sqrt(np.mean(wave**2)))

    return spoil


def barrel(share: float) -> Spoil:
    """A lens that draws in what it sees at the edge by this share, and less inside: r^3."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        flat = to_complex(r.points[..., :2])
        arm = flat - (flat.real.max() + flat.real.min()) / 2
        arm -= 1j * (flat.imag.max() + flat.imag.min()) / 2
        return _moved(r, -share * arm * (np.abs(arm) / np.abs(arm).max()) ** 2)

    return spoil


def misplaced(angle: float, shift: float) -> Spoil:
    """In a frame every 0.6 s one body, in turn, is turned about its middle and shifted, rad, m."""

    def spoil(r: Recording, rng: np.random.Generator) -> Sent:
        wrong = np.arange(np.searchsorted(r.times, 2.0), len(r.times))
        wrong = wrong[rng.integers(30) :: round(0.6 / (r.times[1] - r.times[0])) + 1]
        flat, by = to_complex(r.points[..., :2]), np.zeros(r.points.shape[:2], complex)
        for b in range(len(r.bodies)):
            cells = np.ix_(wrong[b :: len(r.bodies)], r.owner == b)
            arms = flat[cells] - flat[cells].mean(axis=1, keepdims=True)
            by[cells] = arms * (np.exp(1j * angle) - 1) + shift
        return _moved(r, by)

    return spoil


def hidden(share: float) -> Spoil:
    """So many of the markers are not seen, each frame others."""
    return lambda r, rng: ideal(r, points=_gone(r, rng, share))
