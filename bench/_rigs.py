"""
The rigs of the benchmark of real rigs: exact motions of several bodies, seen as markers.

A rig is two of the six motions side by side, with different markers on each, or the links of a
four-bar. Its camera's interval is 100 ppm off the nominal one; noise is on all three axes.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from bench._motions import motions
from bench._record import START
from kinpole_ros.mechanism import BodyMotion, load_scene, marker_positions
from kinpole_ros.planar import to_complex

NOISE = 2e-4  # m
_DRIFT = 1e-4
# m. Two links are not marked alike.
_KITE = np.array([(0.09, 0.02), (-0.03, 0.1), (-0.08, -0.05), (0.05, -0.06)])
_BOAT = np.array([(0.11, 0.0), (0.02, 0.05), (-0.09, 0.03), (-0.02, -0.07)])
# m, between the two bodies of a pair.
_BESIDE = 0.6j
# Motions of the bodies at times (T,), s, and the markers (n, 2) of each, m.
Rig: TypeAlias = Callable[[np.ndarray], tuple[dict[str, BodyMotion], list[np.ndarray]]]


class Recording(NamedTuple):
    """
    T frames of a rig of B bodies, taken at `times` (T,), s, and stamped so, `stamps` (T,), ns.

    `points` (T, N, 3), m, with noise, are of the markers `names` (N,), of which number n is on body
    `owner[n]` and at `shape[n]`, complex, m, in its frame. `position` (5, T, B), complex, m, and
    `angle` (5, T, B), rad, are the exact motion of `bodies`.
    """

    bodies: tuple[str, ...]
    times: np.ndarray
    stamps: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]
    owner: np.ndarray
    shape: np.ndarray
    position: np.ndarray
    angle: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Diameters (B,) of the bodies, m: twice the rms radius of their markers."""
        each = [self.shape[self.owner == b] for b in range(len(self.bodies))]
        return 2 * np.array([np.sqrt(np.mean(np.abs(s - s.mean()) ** 2)) for s in each])


def rigs() -> dict[str, Rig]:
    """The rigs by name."""
    known = {name.replace(' ', '_').replace('-', '_'): one for name, one in motions().items()}
    names = list(known)

    def pair(one: str, other: str, t: np.ndarray) -> tuple[dict[str, BodyMotion], list[np.ndarray]]:
        moved = {name: known[name].motion(t) for name in (one, other)}
        place = moved[other].position.copy()
        place[0] += _BESIDE
        moved[other] = moved[other]._replace(position=place)
        return moved, [_KITE, _BOAT]

    def links(t: np.ndarray) -> tuple[dict[str, BodyMotion], list[np.ndarray]]:
        scene = load_scene('four_bar')
        motion = scene.motion(t)
        return {name: motion[name] for name in scene.markers}, list(scene.markers.values())

    pairs = zip(names[::2], names[1::2], strict=True)
    found = {f'{one}, {other}': partial(pair, one, other) for one, other in pairs}
    return {**found, 'four-bar links': links}


def record(rig: str, rate: float, seconds: float, uneven: float = 0.0) -> Recording:
    """A rig at so many frames per s; `uneven` is how far they are off even instants, intervals."""
    number = list(rigs()).index(rig)
    rng = np.random.default_rng((number, round(rate)))
    ticks = np.arange(round(seconds * rate)) + uneven * rng.uniform(-1, 1, round(seconds * rate))
    stamps = START + np.rint(1e9 * ticks * (1 + _DRIFT) / rate).astype(np.int64)
    times = (stamps - START) * 1e-9
    moved, markers = rigs()[rig](times)
    bodies = tuple(moved)
    owner = np.repeat(np.arange(len(bodies)), [len(m) for m in markers])
    names = tuple(
        f'{body}_{k}' for body, m in zip(bodies, markers, strict=True) for k in range(len(m))
    )
    points = np.zeros((len(times), len(names), 3))
    flat = [marker_positions(moved[b], m) for b, m in zip(bodies, markers, strict=True)]
    points[..., :2] = np.concatenate(flat, axis=1)
    points += NOISE * rng.normal(size=points.shape)
    position = np.stack([moved[body].position for body in bodies], axis=-1)
    angle = np.stack([moved[body].angle for body in bodies], axis=-1)
    shape = to_complex(np.concatenate(markers))
    return Recording(bodies, times, stamps, points, names, owner, shape, position, angle)
