"""
What could be reached at all: how far the best setting in hindsight itself varies, and a bound.

The bound is that of Cramér and Rao for a local polynomial of the window and degree that proved
best: no unbiased estimate from these samples with that model has a smaller variance.
"""

import numpy as np

from bench._hindsight import (
    Best,
    Key,
    apply_weights,
    by_condition,
    covered,
    fixed_weights,
)
from bench._record import (
    POLES,
    QUANTITIES,
    RATES,
    Recording,
    fit_poses,
    rms,
    squared_error,
)
from kinpole_ros import planar


def propagated(
    quantity: str,
    position: np.ndarray,
    angle: np.ndarray,
    position_variance: np.ndarray,
    angle_variance: np.ndarray,
    weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    A quantity (M, S) and its variance to first order, of poles the covariance (M, S, 2, 2).

    At the state `position` (4, M, S) and `angle` (4, M, S), from samples whose variances (S,) are
    those of one axis of the position and of the angle, by the rows `weights` (4, n) that make
    derivatives of them. At the true state it is the least variance, since of white noise the fit by
    least squares is the efficient one.
    """
    gram = (weights @ weights.T)[..., None]
    by_position, by_angle = gram * position_variance, gram * angle_variance
    if quantity in RATES:
        order = RATES.index(quantity) + 1
        return angle[order], np.broadcast_to(by_angle[order, order], angle.shape[1:])
    if quantity in POLES:
        linear = planar.pole(POLES.index(quantity) + 1, position, angle)
        return linear.value, planar.covariance(linear, by_position, by_angle)
    curvature = planar.centrode_curvature(position, angle)
    return curvature.value.real, planar.variance(curvature, by_position, by_angle)


def bounds(
    recording: Recording,
    frames: np.ndarray,
    errors: dict[str, np.ndarray],
    where: dict[str, np.ndarray],
    best: dict[Key, Best],
) -> list[dict[str, object]]:
    """
    Rows by motion, noise and quantity, of `errors` (M, C) counted in `where` (M, C).

    `seeds_10` and `seeds_90` are percentiles of the best setting's RMS on each single seed over its
    pooled RMS. `bound` is the bound's pooled RMS; `ours_over_bound` and `best_over_bound` are
    medians over the seeds of the RMS on that seed over the bound's there. `best_covered` is the
    share of what counts that lies in the 95% interval of the best setting, from the true noise.
    """
    count = recording.shape.shape[1]
    seen, turned = (by_condition(recording, part) for part in fit_poses(recording))
    position, angle = (
        by_condition(recording, part[:, frames]) for part in (recording.position, recording.angle)
    )
    position_variance = by_condition(recording, recording.noise**2 / count)
    spread = (np.abs(recording.shape) ** 2).sum(axis=1)
    angle_variance = by_condition(recording, recording.noise**2 / spread)
    rows: list[dict[str, object]] = []
    for name in QUANTITIES:
        mine, masks = (by_condition(recording, part[name]) for part in (errors, where))
        for (motion, noise), error in mine.items():
            chosen = best.get((motion, noise, name))
            if chosen is None:
                continue
            key = motion, noise
            weights, ahead = fixed_weights(chosen.samples, chosen.degree)
            noises = position_variance[key], angle_variance[key]
            z, turn = apply_weights(weights, ahead, frames, seen[key], turned[key])
            with np.errstate(all='ignore'):
                truth, spread = propagated(name, position[key], angle[key], *noises, weights)
                found, stated = propagated(name, z, turn, *noises, weights)
                if name in POLES:
                    variance = spread[..., 0, 0] + spread[..., 1, 1]
                    squares = squared_error(found - truth, stated)
                else:
                    variance, squares = spread, (found - truth) ** 2 / stated
                counts = masks[key] & np.isfinite(variance)
                least = rms(np.sqrt(variance), counts)
                ours = rms(error, counts)
                seeds = chosen.seeds[np.isfinite(chosen.seeds)] / chosen.error
                rows.append(
                    {
                        'motion': motion,
                        'noise': noise,
                        'quantity': name,
                        'samples': chosen.samples,
                        'degree': chosen.degree,
                        'seeds_10': float(np.percentile(seeds, 10)),
                        'seeds_90': float(np.percentile(seeds, 90)),
                        'bound': float(
                            rms(np.sqrt(variance).reshape(-1, 1), counts.reshape(-1, 1))[0]
                        ),
                        'ours_over_bound': float(np.nanmedian(ours / least)),
                        'best_over_bound': float(np.nanmedian(chosen.seeds / least)),
                        'best_covered': float(covered(name, squares)[counts].mean()),
                    }
                )
    return rows
