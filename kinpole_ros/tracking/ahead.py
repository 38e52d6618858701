"""Where bodies are to be expected in the next frame, by their last velocity."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.levels import RECENT


def ahead(
    track: Sequence[tuple[np.ndarray, Complex, Real]], now: int, bodies: int
) -> tuple[Complex, Complex]:
    """
    Positions (B,), complex, m, and turns (B,), of length 1, at `now`, ns; NaN where nothing tells.

    `track` has stamps (T,), ns, positions and angles (T, B), NaN for a body not seen. A body seen
    once is expected where it was.
    """
    if not track:
        nowhere = np.full(bodies, complex(np.nan, np.nan))
        return nowhere, nowhere
    stamps, position, angle = (np.concatenate(part)[-RECENT:] for part in zip(*track, strict=True))
    row, body = np.arange(1, len(stamps) + 1)[:, None], np.arange(bodies)
    there = np.where(np.isfinite(angle), row, 0)
    last = there.max(axis=0)
    prior = np.where(there < last, there, 0).max(axis=0)
    seconds = (stamps - now) * 1e-9
    # Of one frame alone there is no interval.
    recent = 1.01 * RECENT * (seconds[-1] - seconds[0]) / max(len(stamps) - 1, 1) or np.inf
    ago, step = -seconds[last - 1], seconds[last - 1] - seconds[prior - 1]
    here, was = position[last - 1, body], position[prior - 1, body]
    turned = angle[last - 1, body] - angle[prior - 1, body]
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    moves = (prior > 0) & (step <= recent)
    times = np.where(moves, ago / np.where(moves, step, 1.0), 0.0)
    known = (last > 0) & (ago <= recent)
    there_now = np.where(known, here + times * np.where(moves, here - was, 0), np.nan)
    turn = np.exp(1j * (angle[last - 1, body] + times * np.where(moves, turned, 0)))
    return there_now, np.where(known, turn, np.nan)
