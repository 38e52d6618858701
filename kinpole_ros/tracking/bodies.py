"""What is known of the bodies: shapes, weights and noise of their markers, pins, hubs."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.planar._procrustes import (
    ProcrustesFactors,
    fit_pose_with_factors,
    procrustes_factors,
)
from kinpole_ros.tracking.rejection import marker_limits
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, N_SIGMA, NEGLIGIBLE, ROUNDED

# The place of a marker is kept after so many frames.
SETTLED_FRAMES = 1000


class Fitting(NamedTuple):
    """
    What every fit needs, as it follows from shapes, weights and misfit.

    Attributes
    ----------
    places : (B, n) complex
        Places of the markers in the frame of the body, m, NaN for those not seen yet.
    learned_count : (B,) int
        Number of markers with a place; `unseen` are the bodies that have none.
    unknown_slots : (B, n) bool
        Slots of markers without a place; `incomplete` says whether there are any.
    spread, size : (B,) float
        Sum of squared distances from the mean of the markers, m^2, and diameter, m.
    weights, factors : (B, n) float, ProcrustesFactors
        Weights of the markers, and what the fit to all of them needs.
    middle : (B,) complex
        Where the errors of angle and position are independent, m.
    mature : (B,) bool
        Whether the misfit is known.
    limit, largest, doubtful, loosest
        See `MarkerLimits`.

    """

    places: Complex
    learned_count: np.ndarray
    unseen: np.ndarray
    unknown_slots: np.ndarray
    incomplete: bool
    spread: Real
    size: Real
    weights: Real
    factors: ProcrustesFactors
    middle: Complex
    mature: np.ndarray
    limit: Real
    largest: Real
    doubtful: Real
    loosest: Real


@dataclass
class Bodies:
    """
    What is known of B bodies of up to n markers.

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
    angle_noise : (B,) float
        Noise of the angles of input poses, rad.
    information_factor : (2, B) float
        Factors of the information of angle and position, for input poses.
    jump_scale : (2, B) float
        Residuals of angle, rad, and position, m, about the paths of the bodies.
    repetition : (B,) uint8
        Whether noise is so far above rounding that markers of two frames are never the same: see
        `noise.repetition`.
    freedom : (B,) float
        Degrees of freedom of the residuals of deformed bodies, 0 for rigid ones.
    hidden_factor : (B,) float
        By how much the noise of these residuals is larger, where markers are hidden.
    hub : (B,) complex
        Hub in the frame of the body, m, 0 for none.
    learned_tilt_turn, last_angle : (B,) float
        See `BodyArrays` of frames.h.

    """

    shape: Complex

    def __post_init__(self) -> None:
        self.frames = np.zeros(self.shape.shape, int)
        self.relative = np.ones(self.shape.shape)
        self.deviation = np.zeros(self.shape.shape)
        self.fits = np.zeros(self.count, int)
        self.misfit = np.zeros(self.count)
        self.noise = np.full(self.count, np.nan)
        self.lasting = np.zeros(self.count, bool)
        self.repetition = np.zeros(self.count, np.uint8)
        self.jump_scale = np.full((2, self.count), np.inf)
        self.begun = np.zeros(self.count, bool)
        self.least_noise = np.zeros(self.count)
        self.angle_noise = np.full(self.count, np.nan)
        self.information_factor = np.ones((2, self.count))
        self.learned_tilt_turn = np.zeros(self.count)
        self.last_angle = np.full(self.count, np.nan)
        self.given = np.zeros(self.count, bool)
        self.white = np.full(self.count, np.nan)
        self.degrees = np.zeros(self.count)
        self.freedom = np.zeros(self.count)
        self.hidden_factor = np.ones(self.count)
        self.hub = np.zeros(self.count, complex)
        self.update()

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.shape)

    @property
    def width(self) -> int:
        """Number of slots of each body."""
        return self.shape.shape[1]

    def update(self) -> None:
        """Compute what every fit needs from shapes, weights and misfit."""
        is_learned = self.frames > 0
        learned_count = is_learned.sum(axis=1)
        count = np.maximum(learned_count, 1)
        mean = np.where(is_learned, self.shape, 0).sum(axis=1) / count
        arms = np.where(is_learned, self.shape - mean[:, None], 0)
        spread = (arms.real**2 + arms.imag**2).sum(axis=1)
        size = 2 * np.sqrt(spread / count)
        # A place learned from N frames adds 1 / N to the variance of its marker.
        weights = self.frames / (self.frames + 1.0) / self.relative
        factors = procrustes_factors(self.shape, weights)
        mature = self.fits >= MIN_SAMPLES
        limits = marker_limits(mature, self.misfit, self.error, spread, size, self.relative)
        self.fitting = Fitting(
            places=np.where(is_learned, self.shape, complex(np.nan, np.nan)),
            learned_count=learned_count,
            unseen=np.flatnonzero(learned_count == 0),
            unknown_slots=~is_learned,
            incomplete=bool((~is_learned).any()),
            spread=spread,
            size=size,
            weights=weights,
            factors=factors,
            middle=factors.mean,
            mature=mature,
            **limits._asdict(),
        )

    @property
    def error(self) -> Real:
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
        factors = self.fitting.factors
        if np.count_nonzero(unseen):
            factors = procrustes_factors(self.shape, np.where(unseen, 0.0, self.fitting.weights))
        return fit_pose_with_factors(markers, factors)

    def begin(self, markers: Complex) -> None:
        """Take the shapes of new bodies from a frame (B, n); their origins are the means."""
        seen = ~np.isnan(markers)
        number = seen.sum(axis=1)
        mean = np.where(seen, markers, 0).sum(axis=1) / np.maximum(number, 1)
        arms = np.where(seen, markers - mean[:, None], 0)
        distinct = np.abs(arms).max(axis=1) > ROUNDING * np.abs(mean)
        new = ((self.fitting.learned_count == 0) & (number >= 2) & distinct)[:, None] & seen
        if new.any():
            self.shape = np.where(new, arms, self.shape)
            self.frames[new] = 1
            self.update()

    def give(self, shapes: Complex) -> None:
        """Start from given shapes (B, n), NaN for none, which are refined like learned ones."""
        given = ~np.isnan(shapes)
        self.shape = np.where(given, shapes, self.shape)
        self.frames[given] = 1
        self.given |= given.any(axis=1)
        self.update()

    def restart(self, which: np.ndarray) -> None:
        """Forget some bodies (B,), which start again when they are seen next."""
        for part in (self.shape, self.frames, self.fits, self.misfit, self.deviation, self.freedom):
            part[which] = 0
        self.relative[which] = 1.0
        self.noise[which] = self.white[which] = self.last_angle[which] = np.nan
        self.jump_scale[:, which] = np.inf
        self.given[which] = self.begun[which] = False
        self.repetition[which] = 0
        self.update()

    def widen(self, width: int) -> None:
        """Make room for up to `width` markers per body."""
        added_slots = (0, 0), (0, width - self.width)
        self.shape, self.frames, self.deviation = (
            np.pad(part, added_slots) for part in (self.shape, self.frames, self.deviation)
        )
        self.relative = np.pad(self.relative, added_slots, constant_values=1.0)
        self.update()
