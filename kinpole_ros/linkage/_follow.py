"""
Bodies of known shape found again among points in no order, in all other frames of a record.

A body goes on as it did, and its shape identifies its markers where they pass others: single
points cannot be identified there.
"""

from collections.abc import Callable, Sequence

import numpy as np

from kinpole_ros.planar._plane import Complex

# As for single tracks; a body that was seen some frames ago may be anywhere by then.
_GATE = 8.0
_FARTHEST = 0.4  # of a body's size
_SMOOTH = 0.25  # least share of what is new in a rate
_LOOSE = 6.0  # deviations of a marker from its place on the body

_NOWHERE = complex(np.nan, np.nan)


class _State:
    """Bodies (B,) as they were last: places, turns, their rates by step, errors, and when."""

    def __init__(self, position: Complex, angle: np.ndarray, step: int, error: np.ndarray) -> None:
        self.position, self.angle = position.copy(), angle.copy()
        self.speed = np.zeros(len(angle), complex)
        self.turning = np.zeros(len(angle))
        self.step = np.full(len(angle), step)
        self.error = error.copy()


def follow(
    points: Complex,
    steps: np.ndarray,
    shapes: list[Complex],
    same: np.ndarray,
    position: Complex,
    angle: np.ndarray,
    noise: float,
    progress: Callable[[float], None] | None = None,
    begin: tuple[int, int] | None = None,
) -> Complex:
    """
    The markers (T, N) of bodies, one body's after the other's, NaN where they are not found.

    `points` (T, n) in no order; `shapes` are the markers of each body in its own frame, and those
    with one number in `same` (N,) are one, on the axis of a pin. `position`, `angle` (T, B) are the
    poses as far as they are known, NaN elsewhere. From the frames `begin` on, back from the first
    and on from the second: by default the middle of those known. `steps` (T,) number the frames.
    """
    count = sum(map(len, shapes))
    width = max(map(len, shapes))
    body = np.repeat(np.arange(len(shapes)), [len(shape) for shape in shapes])
    place = np.concatenate([np.arange(len(shape)) for shape in shapes])
    local = np.zeros((len(shapes), width), complex)
    local[body, place] = np.concatenate(shapes)
    size = np.array([np.abs(s[:, None] - s).max() for s in shapes])
    found = np.full((len(points), count), _NOWHERE)
    known = np.isfinite(angle).all(axis=1).nonzero()[0]
    middle = int(known[len(known) // 2])
    back, on = begin or (middle, middle)
    seen = np.isfinite(points.real)
    done = 0

    def go(at: int, frames: Sequence[int]) -> None:
        nonlocal done
        start = _State(position[at], angle[at], int(steps[at]), 0.05 * size)
        near = known[np.abs(known - at).argsort()[:2]]
        interval = int(steps[near[1]] - steps[near[0]])
        if interval:
            start.speed = (position[near[1]] - position[near[0]]) / interval
            start.turning = (angle[near[1]] - angle[near[0]]) / interval
        for k in frames:
            done += 1
            if progress is not None and done % 500 == 0:
                progress(min(1.0, done / len(points)))
            there = points[k, seen[k]]
            if len(there):
                got = _step(start, there, int(steps[k]), local, body, place, same, size, noise)
                found[k] = np.where(got >= 0, there[got], _NOWHERE)

    go(on, range(on, len(points)))
    go(back, range(back - 1, -1, -1))
    return found


def _step(
    state: _State,
    there: Complex,
    step: int,
    local: Complex,
    body: np.ndarray,
    place: np.ndarray,
    same: np.ndarray,
    size: np.ndarray,
    noise: float,
) -> np.ndarray:
    """Which of the points (m,) is each marker (N,), -1 for none; moves the state on."""
    gap = step - state.step
    turn = np.exp(1j * (state.angle + state.turning * gap))
    ahead = (state.position + state.speed * gap)[body] + (turn[:, None] * local)[body, place]
    off = np.abs(ahead[:, None] - there)
    long = np.abs(gap) ** 1.5
    gate = np.minimum(
        _GATE * np.maximum(state.error, noise) * np.maximum(long, 1), _FARTHEST * size
    )
    got = off.argmin(axis=1)
    best = off[np.arange(len(got)), got]
    good = (same[off.argmin(axis=0)[got]] == same) & (best < gate[body])
    limit = _LOOSE * noise
    for _ in range(3):
        weight = np.zeros(local.shape)
        weight[body[good], place[good]] = 1.0
        at = np.zeros(local.shape, complex)
        at[body[good], place[good]] = there[got[good]]
        count = weight.sum(axis=1)
        each = np.maximum(count, 1)
        mean, center = at.sum(axis=1) / each, (weight * local).sum(axis=1) / each
        arms = weight * (local - center[:, None])
        cross = (at * arms.conj()).sum(axis=1)
        enough = (count > 1) & (np.abs(cross) > 0)
        turned = np.where(enough, cross / np.where(enough, np.abs(cross), 1), 1)
        left = weight * np.abs(at - mean[:, None] - turned[:, None] * arms)
        worst = left.max(axis=1)
        bad = enough & (worst > limit)
        if not bad.any():
            break
        # The one that fits least goes; of two nobody knows which.
        column = left.argmax(axis=1)
        drop = good & bad[body] & ((place == column[body]) | (count[body] == 2))
        good &= ~drop
    position = mean - turned * center
    # Where the markers should have been, and where the body has them.
    swing = np.angle(turned * turn.conj())
    angle = state.angle + state.turning * gap + swing
    error = np.zeros(len(size))
    np.maximum.at(error, body[good], best[good])
    some = enough & (gap != 0)
    interval = np.where(gap == 0, 1, gap)
    # Rates are smoothed where noise is most of what is new in them, so that gaps are bridged.
    gain = np.maximum(_SMOOTH, error**2 / (error**2 + (4 * noise) ** 2))
    late = gain * (position - state.position - state.speed * gap) / interval
    state.speed = np.where(some, state.speed + late, state.speed)
    state.turning = np.where(some, state.turning + gain * swing / interval, state.turning)
    state.error = np.where(
        enough, 0.7 * state.error + 0.3 * error / np.maximum(long, 1), state.error
    )
    state.position = np.where(enough, position, state.position)
    state.angle = np.where(enough, angle, state.angle)
    state.step = np.where(enough, step, state.step)
    return np.where(good & enough[body], got, -1)
