"""Where a rigid body was in every frame, and how well its markers tell."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._columns import medians, quantiles
from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real

# Residuals beyond so many deviations are of another marker.
_OUTLIER = 6.0
_ROUNDS = 3
# As many are enough to see whether a marker is on a body, and fewer say nothing.
_FRAMES = 3000
_FEWEST = 30


class Pose(NamedTuple):
    """
    A body's motion over T frames, and its markers.

    `position` (T,) complex is where the mean of its markers is, `angle` (T,) its turn from the
    first frame on, rad, both NaN where it was not seen. `shape` (n,) are its markers in its own
    axes about their mean. `noise` is that of a marker per axis as the fit leaves it,
    `position_variance` (per axis) and `angle_variance` are those of one frame. `share` (n,) is how
    often each of its markers was seen and fits.
    """

    position: Complex
    angle: Real
    shape: Complex
    noise: float
    position_variance: float
    angle_variance: float
    share: Real

    @property
    def size(self) -> float:
        """Largest distance of two of its markers."""
        return float(np.abs(self.shape[:, None] - self.shape).max())

    @property
    def seen(self) -> np.ndarray:
        """Frames (T,) in which it was."""
        return np.isfinite(self.angle)


GROUND = 'ground'


def ground(frames: int) -> Pose:
    """The body that stands still."""
    nothing = np.zeros(frames)
    return Pose(nothing + 0j, nothing, np.zeros(1, complex), 0.0, 0.0, 0.0, np.ones(1))


def fit_body(tracks: Complex) -> Pose:
    """
    The motion of a body of the tracks (T, n), complex, NaN for none.

    Generalized Procrustes: poses by the shape, the shape by the poses (Gower 1975), with what is of
    another marker left out.
    """
    seen = np.isfinite(tracks.real)
    full = int(seen.sum(axis=1).argmax())
    shape = np.where(seen[full], tracks[full] - np.mean(tracks[full][seen[full]]), np.nan)
    used = seen.copy()
    for _ in range(_ROUNDS + 1):
        known = np.isfinite(shape)
        fit = fit_pose(tracks, np.where(known, shape, 0), (used & known).astype(float))
        turn = np.exp(1j * fit.angle)
        local = (tracks - fit.position[:, None]) * turn.conj()[:, None]
        # What does not fit is left out from the second round on, when the shape is known.
        with np.errstate(invalid='ignore'):
            off = np.abs(local - shape)
            off[~np.isfinite(fit.angle)] = np.nan
            fitted = off[:, known]
            fitted = fitted[np.isfinite(fitted)]
            usual = np.median(fitted) / 1.1774 if len(fitted) else 0.0
            used = seen & ~(off > _OUTLIER * usual + 1e-12)
        local = np.where(used & np.isfinite(fit.angle)[:, None], local, np.nan)
        counts = np.isfinite(local.real).sum(axis=0)
        mean = np.nansum(local, axis=0) / np.maximum(counts, 1)
        shape = np.where(counts > 0, mean, np.nan)
        if not counts.any():
            # Its markers were never seen together where they keep their distances.
            return _never_seen(tracks)
        shape = shape - np.mean(shape[np.isfinite(shape)])
    used &= np.isfinite(shape)
    # A body of two markers that are not as far from each other as they should be.
    fit = fit_pose(tracks, np.nan_to_num(shape), used.astype(float))
    freedom = np.maximum(2 * used.sum(axis=1) - 3, 0)
    square = np.nansum(np.where(used, np.abs(fit.residual) ** 2, 0), axis=1)
    noise = float(np.sqrt(square[freedom > 0].sum() / max(freedom.sum(), 1)))
    good = np.isfinite(fit.angle) & ~_flipped(fit.angle)
    if not good.any():
        return _never_seen(tracks)
    angle = np.full(len(tracks), np.nan)
    angle[good] = np.unwrap(fit.angle[good])
    # Shape and positions are about the mean of all; with some unseen they are known a little less.
    variance = noise**2
    return Pose(
        np.where(good, fit.position, np.nan),
        angle,
        shape,
        noise,
        variance * float(np.mean(1 / fit.weight[good])),
        variance * float(np.mean(1 / fit.spread[good])),
        used.mean(axis=0),
    )


def _never_seen(tracks: Complex) -> Pose:
    """The pose of a body of which no frame of the tracks (T, n) has two markers that fit."""
    frames, count = tracks.shape
    unknown = np.full(frames, np.nan)
    shape = np.full(count, complex(np.nan, np.nan))
    return Pose(unknown + 0j, unknown, shape, 0.0, np.inf, np.inf, np.zeros(count))


def _flipped(angle: Real) -> np.ndarray:
    """Frames (T,) that are turned against those before and after: two markers exchanged."""
    seen = np.isfinite(angle).nonzero()[0]
    step = np.abs(np.angle(np.exp(1j * np.diff(angle[seen]))))
    over = np.abs(np.angle(np.exp(1j * (angle[seen][2:] - angle[seen][:-2]))))
    flipped = np.zeros(len(angle), bool)
    flipped[seen[1:-1][np.minimum(step[:-1], step[1:]) > 1 + over]] = True
    return flipped


def off_body(pose: Pose, track: Complex, noise: float) -> tuple[float, complex]:
    """
    How far from fixed on a body a track (T,) is, in deviations, and its place there.

    A median, so that other points do not count.
    """
    off, place = off_body_all(pose, track[:, None], noise)
    return float(off[0]), complex(place[0])


def off_body_all(pose: Pose, tracks: Complex, noise: float) -> tuple[Real, Complex]:
    """Compute the same of tracks (T, n), for each (n,); infinitely far for one hardly seen."""
    every = slice(None, None, max(1, len(tracks) // _FRAMES))
    turn = np.exp(-1j * pose.angle[every])
    local = np.ascontiguousarray((tracks[every] - pose.position[every, None]).T) * turn
    (real, counts), (imag, _) = medians(local.real), medians(local.imag)
    place = real + 1j * imag
    (far,), _ = quantiles(np.abs(local - place[:, None]), (0.9,))
    variance = noise**2 + pose.position_variance + np.abs(place) ** 2 * pose.angle_variance / 2
    off = far / 2.146 / np.sqrt(np.maximum(variance, 1e-300))
    few = counts < _FEWEST
    return np.where(few, np.inf, off), np.where(few, complex(np.nan), place)
