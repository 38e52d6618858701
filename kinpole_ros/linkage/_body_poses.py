"""Poses of rigid bodies in the plane, frame by frame, and which markers are fixed on them."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._rigid import Groups, quantiles, single_markers
from kinpole_ros.linkage.limits import OUTLIER_SIGMAS, PAIR_FRAMES
from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.statistics import medians

GROUND, GROUND_NUMBER = 'ground', -1
_ROUNDS = 3
# A marker is on a body if it is no farther from a fixed place than this many standard deviations,
# or than this many times the body's own markers.
_ON_BODY = 2.0
# A marker on the axis of a pin is on both bodies if it is off each by less than this many standard
# deviations, or by less than this many times the smaller of both.
_SHARED, _SHARED_RATIO = 1.3, 1.3
_SAMPLED_FRAMES = 3000


class BodyPoses(NamedTuple):
    """
    A body's motion over T frames, and its markers.

    `position` (T,), complex, is that of the mean of its markers, `angle` (T,) its angle from the
    first frame on, rad, both NaN where it was not seen. `shape` (n,) are its markers about their
    mean in its own axes. `noise` is the rms residual of a marker per axis; `position_variance` (per
    axis) and `angle_variance` are those of one frame.
    """

    position: Complex
    angle: Real
    shape: Complex
    noise: float
    position_variance: float
    angle_variance: float

    @property
    def size(self) -> float:
        """Largest distance of two of its markers."""
        return float(np.abs(self.shape[:, None] - self.shape).max())

    @property
    def seen(self) -> np.ndarray:
        """Whether it was seen in each frame (T,)."""
        return np.isfinite(self.angle)


def ground(frames: int) -> BodyPoses:
    """The pose of the ground, which stands still."""
    zeros = np.zeros(frames)
    return BodyPoses(zeros + 0j, zeros, np.zeros(1, complex), 0.0, 0.0, 0.0)


def fit_body(tracks: Complex) -> BodyPoses:
    """
    Fit the motion of a body to its tracks (T, n), complex, NaN for none.

    Generalized Procrustes: poses by the shape, the shape by the poses (Gower 1975). Points of other
    markers are left out from the second round on.
    """
    seen = np.isfinite(tracks.real)
    full = int(seen.sum(axis=1).argmax())
    shape = np.where(seen[full], tracks[full] - np.mean(tracks[full][seen[full]]), np.nan)
    used = seen.copy()
    for _ in range(_ROUNDS + 1):
        has_place = np.isfinite(shape)
        weights = (used & has_place).astype(float)
        fit = fit_pose(tracks, np.where(has_place, shape, 0), weights)
        is_fitted = np.isfinite(fit.angle)
        local = (tracks - fit.position[:, None]) * np.exp(1j * fit.angle).conj()[:, None]
        with np.errstate(invalid='ignore'):
            off = np.abs(local - shape)
            off[~is_fitted] = np.nan
            residuals = off[:, has_place]
            residuals = residuals[np.isfinite(residuals)]
            # The median of a Rayleigh distribution is 1.1774 standard deviations.
            noise = np.median(residuals) / 1.1774 if len(residuals) else 0.0
            used = seen & ~(off > OUTLIER_SIGMAS * noise + 1e-12)
        local = np.where(used & is_fitted[:, None], local, np.nan)
        counts = np.isfinite(local.real).sum(axis=0)
        if not counts.any():
            return _never_seen(tracks)
        shape = np.where(counts > 0, np.nansum(local, axis=0) / np.maximum(counts, 1), np.nan)
        shape = shape - np.mean(shape[np.isfinite(shape)])
    used &= np.isfinite(shape)
    fit = fit_pose(tracks, np.nan_to_num(shape), used.astype(float))
    freedom = np.maximum(2 * used.sum(axis=1) - 3, 0)
    square = np.nansum(np.where(used, np.abs(fit.residual) ** 2, 0), axis=1)
    noise = float(np.sqrt(square[freedom > 0].sum() / max(freedom.sum(), 1)))
    valid = np.isfinite(fit.angle) & ~_is_flipped(fit.angle)
    if not valid.any():
        return _never_seen(tracks)
    angle = np.full(len(tracks), np.nan)
    angle[valid] = np.unwrap(fit.angle[valid])
    variance = noise**2
    return BodyPoses(
        np.where(valid, fit.position, np.nan),
        angle,
        shape,
        noise,
        variance * float(np.mean(1 / fit.weight[valid])),
        variance * float(np.mean(1 / fit.spread[valid])),
    )


def _never_seen(tracks: Complex) -> BodyPoses:
    """The pose of a body of which no frame of the tracks (T, n) has two markers that fit."""
    frames, count = tracks.shape
    nan = np.full(frames, np.nan)
    shape = np.full(count, complex(np.nan, np.nan))
    return BodyPoses(nan + 0j, nan, shape, 0.0, np.inf, np.inf)


def _is_flipped(angle: Real) -> np.ndarray:
    """Frames (T,) turned against those around them, as where two markers are exchanged."""
    seen = np.isfinite(angle).nonzero()[0]
    step = np.abs(np.angle(np.exp(1j * np.diff(angle[seen]))))
    over_two = np.abs(np.angle(np.exp(1j * (angle[seen][2:] - angle[seen][:-2]))))
    flipped = np.zeros(len(angle), bool)
    flipped[seen[1:-1][np.minimum(step[:-1], step[1:]) > 1 + over_two]] = True
    return flipped


def off_body(pose: BodyPoses, tracks: Complex, noise: float) -> tuple[Real, Complex]:
    """
    How far tracks (T, n) are from fixed on a body, in standard deviations, and where they are.

    Both are (n,), by quantiles, so that points of other markers do not count. Infinitely far for a
    track that is hardly ever seen.
    """
    rows = slice(None, None, max(1, len(tracks) // _SAMPLED_FRAMES))
    turn = np.exp(-1j * pose.angle[rows])
    local = np.ascontiguousarray((tracks[rows] - pose.position[rows, None]).T) * turn
    position = medians(local.real) + 1j * medians(local.imag)
    (far,), counts = quantiles(np.abs(local - position[:, None]), (0.9,))
    variance = noise**2 + pose.position_variance + np.abs(position) ** 2 * pose.angle_variance / 2
    # The 90% quantile of a Rayleigh distribution is 2.146 standard deviations.
    off = far / 2.146 / np.sqrt(np.maximum(variance, 1e-300))
    is_rare = counts < PAIR_FRAMES
    return np.where(is_rare, np.inf, off), np.where(is_rare, complex(np.nan), position)


def refine_groups(tracks: Complex, groups: Groups) -> tuple[Groups, list[BodyPoses]]:
    """
    Correct the bodies of tracks (T, N) by their motion, and fit their poses.

    The distance to a marker near the axis of a pin hardly changes; the motion of the body over all
    frames shows more. Markers fixed on a body are added, others removed.
    """
    poses = [fit_body(tracks[:, body]) for body in groups.bodies]
    noise = float(np.median([pose.noise for pose in poses if pose.noise > 0] or [0.0]))
    bodies = [list(body) for body in groups.bodies]
    for body, pose in zip(bodies, poses, strict=True):
        if len(body) > 2:
            off, _ = off_body(pose, tracks, noise)
            limit = _ON_BODY * max(1.0, float(np.median(off[body])))
            body += [k for k in np.flatnonzero(off < limit).tolist() if k not in body]
    for k in range(tracks.shape[1]):
        holders = [body for body in bodies if k in body and len(body) > 2]
        if len(holders) > 1:
            # The body is fitted without the marker, which would draw the fit to itself.
            without = [fit_body(tracks[:, [m for m in body if m != k]]) for body in holders]
            far = [float(off_body(pose, tracks[:, [k]], noise)[0][0]) for pose in without]
            for body, distance in zip(holders, far, strict=True):
                if distance > max(_SHARED, _SHARED_RATIO * min(far)):
                    body.remove(k)
    sets = [set(body) for body in bodies]
    refined = [
        sorted(body)
        for k, body in enumerate(sets)
        if len(body) > 1 and body not in sets[:k] and not any(body < larger for larger in sets)
    ]
    if refined != groups.bodies:
        poses = [fit_body(tracks[:, body]) for body in refined]
    seen = [k for k, pose in enumerate(poses) if pose.seen.any()]
    refined, poses = [refined[k] for k in seen], [poses[k] for k in seen]
    single = single_markers(refined, groups.fixed, tracks.shape[1])
    return groups._replace(bodies=refined, single=single), poses
