"""What is known of the bodies: shapes, weights and noise of their markers, pins, hubs."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import spectrum_numbers
from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.planar._procrustes import (
    ProcrustesFactors,
    fit_pose_with_factors,
    procrustes_factors,
)
from kinpole_ros.tracking.rejection import marker_limits, reasons_of
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, N_SIGMA, NEGLIGIBLE, ROUNDED

# The place of a marker is kept after so many frames.
SETTLED_FRAMES = 1000
# What is known of each marker, and what is forgotten of a body that starts again.
_OF_MARKERS = 'shape', 'frames', 'relative', 'deviation'
_FORGOTTEN = (
    *('fits', 'misfit', 'noise', 'white', 'jump_scale', 'freedom', 'given', 'begun'),
    *('repetition', 'pin', 'pin_variance', 'spectra'),
)
# Arrays from which the others follow.
_CAUSES = {
    'placement': {'shape', 'frames', 'relative'},
    'fitting': {
        *('shape', 'frames', 'relative', 'fits', 'misfit', 'noise', 'least_noise'),
        *('angle_noise', 'pose_middle'),
    },
    'are_measured': {'angle_noise'},
    'spectrum': {'spectra'},
}


class Placement(NamedTuple):
    """
    What follows from places of markers and their weights.

    Attributes
    ----------
    places, spread, weights
        See `BodyArrays` of frames.h.
    learned_count : (B,) int
        Number of markers with a place; `unseen` are the bodies that have none.
    unknown_slots : (B, n) bool
        Slots of markers without a place; `incomplete` says whether there are any.
    factors : ProcrustesFactors
        What the fit to all markers needs.

    """

    places: Complex
    spread: Real
    weights: Real
    learned_count: np.ndarray
    unseen: np.ndarray
    unknown_slots: np.ndarray
    incomplete: bool
    factors: ProcrustesFactors


class Fitting(NamedTuple):
    """
    What follows from places and noise.

    `mature` (B,) says whether the misfit is known. For `limit` (B,) see `MarkerLimits`, for the
    others `BodyArrays` of frames.h.
    """

    size: Real
    middle: Complex
    mature: np.ndarray
    marker_variance: Real
    fit_noise: Real
    information_factor: Real
    reason: np.ndarray
    limit: Real
    largest: Real
    doubtful: Real
    loosest: Real


@dataclass(frozen=True)
class Bodies:
    """
    What is known of B bodies of up to n markers; an update makes new arrays.

    C sees those arrays, and those that follow from them, that `BodyArrays` of frames.h names.

    Attributes
    ----------
    shape : (B, n) complex
        Places of the markers in the frame of the body, m; 0 at first.
    frames : (B, n) int
        Number of frames that each place is learned from, at most SETTLED_FRAMES.
    relative : (B, n) float
        Variance of each marker over that of the others of its body, mostly 1.
    deviation : (B, n) float
        Standard deviation of noisy markers, m, 0 for the others.
    begun : (B,) bool
        Whether the first frames were checked for outliers.
    given : (B,) bool
        Whether the parameters give the shape.
    fits : (B,) int
        Number of fits, of bodies that move, behind `misfit`.
    misfit : (B,) float
        Variance of a coordinate of a marker about its place, m^2, whatever the cause.
    noise : (B,) float
        Standard deviation of a coordinate, m, as far as it is noise; NaN if unknown.
    white, degrees : (B,) float
        The part that is independent from frame to frame, and its degrees of freedom.
    lasting : (B,) bool
        Whether the noise is correlated for longer than can be measured.
    least_noise : (B,) float
        Noise that is given, or due to rounding, m.
    angle_noise, pose_middle : (B,) float, (B,) complex
        Of bodies whose poses are measured: noise of the angle, rad, inf if unknown, and where its
        error and that of the position are independent, m. NaN for bodies fitted to markers.
    jump_scale : (2, B) float
        Residuals of angle, rad, and position, m, about the paths of the bodies.
    repetition : (B,) uint8
        Whether noise is so far above rounding that markers of two frames are never the same: see
        `find_repetition`.
    freedom : (B,) float
        Degrees of freedom of the residuals of deformed bodies, 0 for rigid ones.
    hidden_factor : (B,) float
        By how much the noise of these residuals is larger, where markers are hidden.
    hub : (B,) complex
        Hub in the frame of the body, m, 0 for none.
    learned_tilt_turn : (B,) float
        See `BodyArrays` of frames.h.
    pin, pin_arm : (B,) complex
        Where the pins are in the plane, m, NaN for none, and in the frames of the bodies, m.
    pin_variance, pin_since : (B,) float, (B,) int64
        Variance of a coordinate, m^2; when each body was first seen to turn about its pin, ns.
    spectra : (B,) object
        The `Spectrum` of the motion of each body; None while unknown.

    """

    shape: Complex
    frames: np.ndarray
    relative: Real
    deviation: Real
    begun: np.ndarray
    given: np.ndarray
    fits: np.ndarray
    misfit: Real
    noise: Real
    white: Real
    degrees: Real
    lasting: np.ndarray
    least_noise: Real
    angle_noise: Real
    pose_middle: Complex
    jump_scale: Real
    repetition: np.ndarray
    freedom: Real
    hidden_factor: Real
    hub: Complex
    learned_tilt_turn: Real
    pin: Complex
    pin_arm: Complex
    pin_variance: Real
    pin_since: np.ndarray
    spectra: np.ndarray

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.shape)

    @property
    def width(self) -> int:
        """Number of slots of each body."""
        return self.shape.shape[1]

    @cached_property
    def are_measured(self) -> bool:
        """Whether poses of the bodies are measured, not fitted to markers."""
        return not np.isnan(self.angle_noise).any()

    def change(self, **arrays: np.ndarray) -> 'Bodies':
        """Return bodies with other arrays; what follows from the others is not computed again."""
        bodies, followed = replace(self, **arrays), vars(self)
        for name, causes in _CAUSES.items():
            if name in followed and causes.isdisjoint(arrays):
                vars(bodies)[name] = followed[name]
        return bodies

    @cached_property
    def placement(self) -> Placement:
        """What follows from places of markers and their weights."""
        is_learned = self.frames > 0
        learned_count = is_learned.sum(axis=1)
        mean = np.where(is_learned, self.shape, 0).sum(axis=1) / np.maximum(learned_count, 1)
        arms = np.where(is_learned, self.shape - mean[:, None], 0)
        # A place learned from N frames adds 1 / N to the variance of its marker.
        weights = self.frames / (self.frames + 1.0) / self.relative
        return Placement(
            places=np.where(is_learned, self.shape, complex(np.nan, np.nan)),
            spread=(arms.real**2 + arms.imag**2).sum(axis=1),
            weights=weights,
            learned_count=learned_count,
            unseen=np.flatnonzero(learned_count == 0),
            unknown_slots=~is_learned,
            incomplete=not is_learned.all(),
            factors=procrustes_factors(self.shape, weights),
        )

    @cached_property
    def fitting(self) -> Fitting:
        """What follows from places and noise."""
        placement, mature = self.placement, self.fits >= MIN_SAMPLES
        spread = placement.spread
        size = 2 * np.sqrt(spread / np.maximum(placement.learned_count, 1))
        limits = marker_limits(
            mature, self.misfit, self.marker_variance, spread, size, self.relative
        )
        middle, factor = placement.factors.mean, np.ones((2, self.count))
        if self.are_measured:
            # Distance from their mean of markers with such noise.
            arm = self.noise / self.angle_noise
            middle, size = self.pose_middle, 2 * arm
            factor = np.stack((arm**2, arm**2 / (arm**2 + np.abs(middle) ** 2)))
            factor = np.where(np.isnan(factor), 1.0, factor)
        return Fitting(
            size=size,
            middle=middle,
            mature=mature,
            marker_variance=self.marker_variance,
            fit_noise=np.where(self.noise > 0, self.noise, 1.0),
            information_factor=factor,
            reason=reasons_of(self.noise, spread, self.angle_noise),
            **limits._asdict(),
        )

    @cached_property
    def reference(self) -> Complex:
        """Points (B,) whose positions are derived, in the frames of the bodies, m."""
        if not self.are_measured:
            return self.hub
        # The derivatives assume independent errors of position and angle: so at the middle.
        return np.where(self.hub == 0, self.fitting.middle, self.hub)

    @cached_property
    def spectrum(self) -> np.ndarray:
        """Numbers (B,) of the spectra, 0 for none."""
        return spectrum_numbers(self.spectra)

    @property
    def marker_variance(self) -> Real:
        """Variance (B,) of a coordinate of a marker, m^2: the misfit, no less than rounding."""
        return np.maximum(self.misfit, self.least_noise**2)

    def rigidity_residual(self) -> Real:
        """Return the rms residual (B,) of each body, m, per axis; 0 for one that is rigid."""
        off = np.sqrt(np.where(self.fitting.mature, self.misfit, np.nan))
        with np.errstate(invalid='ignore'):
            loose = (off > N_SIGMA * self.white) & (off > NEGLIGIBLE * self.fitting.size)
            loose &= off > ROUNDED * self.fitting.size
        return np.where(loose, off, 0.0)

    def fit(self, markers: Complex) -> Fit:
        """Fit the poses of all bodies to their markers (..., B, n), m, NaN for those not seen."""
        unseen = np.isnan(markers)
        factors = self.placement.factors
        if np.count_nonzero(unseen):
            factors = procrustes_factors(self.shape, np.where(unseen, 0.0, self.placement.weights))
        fit = fit_pose_with_factors(markers, factors)
        if self.are_measured:
            fit = fit._replace(spread=np.ones_like(fit.spread), weight=np.ones_like(fit.weight))
        return fit

    def begin(self, markers: Complex) -> 'Bodies':
        """Take the shapes of new bodies from a frame (B, n); their origins are the means."""
        seen = ~np.isnan(markers)
        number = seen.sum(axis=1)
        mean = np.where(seen, markers, 0).sum(axis=1) / np.maximum(number, 1)
        arms = np.where(seen, markers - mean[:, None], 0)
        distinct = np.abs(arms).max(axis=1) > ROUNDING * np.abs(mean)
        new = ((self.placement.learned_count == 0) & (number >= 2) & distinct)[:, None] & seen
        return self._with_places(new, arms) if new.any() else self

    def give(self, shapes: Complex) -> 'Bodies':
        """Start from given shapes (B, n), NaN for none, which are refined like learned ones."""
        given = ~np.isnan(shapes)
        bodies = self._with_places(given, shapes)
        return bodies.change(given=self.given | given.any(axis=1))

    def _with_places(self, which: np.ndarray, places: Complex) -> 'Bodies':
        """Return bodies with these places of some markers (B, n), as seen in one frame."""
        shape, frames = np.where(which, places, self.shape), np.where(which, 1, self.frames)
        return self.change(shape=shape, frames=frames)

    def restart(self, which: np.ndarray) -> 'Bodies':
        """Forget some bodies (B,), which start again when they are seen next."""
        return self.take(new_bodies(self.count, self.width), which, (*_FORGOTTEN, *_OF_MARKERS))

    def take(self, other: 'Bodies', which: np.ndarray, names: Iterable[str]) -> 'Bodies':
        """Return bodies with arrays of `other`, by their `names`, for those of `which` (B,)."""
        if which.all():
            return self.change(**{name: getattr(other, name) for name in names})
        arrays = {}
        for name in names:
            part = which[:, None] if name in _OF_MARKERS else which
            arrays[name] = np.where(part, getattr(other, name), getattr(self, name))
        return self.change(**arrays)

    def widen(self, width: int) -> 'Bodies':
        """Make room for up to `width` markers per body."""
        added = new_bodies(self.count, width - self.width)
        arrays = {
            name: np.hstack((getattr(self, name), getattr(added, name))) for name in _OF_MARKERS
        }
        return self.change(**arrays)


def new_bodies(count: int, width: int, are_measured: bool = False) -> Bodies:
    """Return B bodies of up to n markers, or with measured poses, of which nothing is known."""
    of_markers = count, width
    unknown, nowhere = np.full(count, np.nan), np.full(count, complex(np.nan, np.nan))
    return Bodies(
        shape=np.zeros(of_markers, complex),
        frames=np.zeros(of_markers, int),
        relative=np.ones(of_markers),
        deviation=np.zeros(of_markers),
        begun=np.zeros(count, bool),
        given=np.zeros(count, bool),
        fits=np.zeros(count, int),
        misfit=np.zeros(count),
        noise=unknown,
        white=unknown,
        degrees=np.zeros(count),
        lasting=np.zeros(count, bool),
        least_noise=np.zeros(count),
        angle_noise=np.full(count, np.inf if are_measured else np.nan),
        pose_middle=np.zeros(count, complex) if are_measured else nowhere,
        jump_scale=np.full((2, count), np.inf),
        repetition=np.zeros(count, np.uint8),
        freedom=np.zeros(count),
        hidden_factor=np.ones(count),
        hub=np.zeros(count, complex),
        learned_tilt_turn=np.zeros(count),
        pin=nowhere,
        pin_arm=np.zeros(count, complex),
        pin_variance=unknown,
        pin_since=np.zeros(count, np.int64),
        spectra=np.full(count, None),
    )
