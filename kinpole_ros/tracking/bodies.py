"""What is known of the bodies: shapes, weights and noise of their markers, pins, hubs."""

from dataclasses import dataclass, field

import numpy as np

from kinpole_ros.planar import procrustes_factors
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.tracking.thresholds import ROUNDED

# A marker farther off than this is an outlier, in standard deviations of residuals.
OUTLIER_SIGMAS = 6.0
# The same while the residuals are not known, as a share of the diameter of the body.
YOUNG_OUTLIER = 0.03
# An angle noisier than this wanders, and its errors are no longer small, rad.
UNSTEADY = 0.15
# Fewer fits, or degrees of freedom, than these give no usable variance.
MIN_FITS = 20
# Number of frames after which the place of a marker is known well enough to be kept.
SETTLED_FRAMES = 1000


@dataclass
class Bodies:
    """
    What is known of B bodies of up to n markers.

    shape : complex (B, n), m. Places of the markers in the frame of the body.
    frames : int (B, n). Number of frames that each place is known from, at most SETTLED_FRAMES.
    order : int (B, n). Which marker of the message is in each place, where some were exchanged.
    exchanged_for : int (B,). Number of frames since the order has changed.
    relative : (B, n). Variance of each marker over that of the others of its body, mostly 1.
    deviation : (B, n), m. Standard deviation of markers that count for less; 0 for the others.
    begun : bool (B,). Its first frames were looked at for outliers.
    fits : int (B,). Number of fits, of bodies that move, that `misfit` is known from.
    misfit : (B,), m^2. Variance of a coordinate of a marker about its place, whatever the cause.
    noise : (B,), m. Standard deviation of a coordinate, as far as it is noise; NaN if unknown.
    lasting : bool (B,). The noise is correlated for longer than can be measured.
    jump_scale : (2, B), rad and m. A pose that leaves the path of its body by more is wrong.
    """

    count: int
    width: int
    shape: Complex = field(init=False)

    def __post_init__(self) -> None:
        both = self.count, self.width
        self.shape = np.zeros(both, complex)
        self.frames = np.zeros(both, int)
        self.order = np.tile(np.arange(self.width), (self.count, 1))
        self.relative = np.ones(both)
        self.deviation = np.zeros(both)
        self.fits = np.zeros(self.count, int)
        self.misfit = np.zeros(self.count)
        self.noise = np.full(self.count, np.nan)
        self.lasting = np.zeros(self.count, bool)
        self.jump_scale = np.full((2, self.count), np.inf)
        self.exchanged = False
        self.begun = np.zeros(self.count, bool)
        self.exchanged_for = np.zeros(self.count, int)
        self.least_noise = np.zeros(self.count)
        self.angle_noise = np.full(self.count, np.nan)
        self.scale = np.ones((2, self.count))
        self.extra_turn = np.zeros(self.count)
        self.last_angle = np.full(self.count, np.nan)
        self.given = np.zeros(self.count, bool)
        self.white = np.full(self.count, np.nan)
        self.degrees = np.zeros(self.count)
        self.freedom = np.zeros(self.count)
        self.held = np.ones(self.count)
        self.hub = np.zeros(self.count, complex)
        self.update()

    def update(self) -> None:
        """Compute what follows from shapes, weights and misfit, and every fit needs."""
        known = self.frames > 0
        self.known = known.sum(axis=1)
        self.incomplete_places = ~known
        self.incomplete = bool(self.incomplete_places.any())
        self.unmet = np.flatnonzero(self.known == 0)
        mean = np.where(known, self.shape, 0).sum(axis=1) / np.maximum(self.known, 1)
        arms = np.where(known, self.shape - mean[:, None], 0)
        self.spread = (arms.real**2 + arms.imag**2).sum(axis=1)
        self.size = 2 * np.sqrt(self.spread / np.maximum(self.known, 1))
        # A place known from N frames adds 1 / N to the variance of its marker.
        self.weights = self.frames / (self.frames + 1.0) / self.relative
        self.grip = procrustes_factors(self.shape, self.weights)
        self.middle = self.grip.mean
        self.mature = self.fits >= MIN_FITS
        usual = OUTLIER_SIGMAS * np.sqrt(np.maximum(self.misfit, ROUNDED**2 * self.spread))
        young = np.maximum(YOUNG_OUTLIER * self.size, 2 * usual)
        self.limit = np.where(self.mature, usual, young)
        self.largest = np.where(self.mature, usual**2, np.inf)[:, None] * self.relative
        # What moves by less, as on soft tissue, still has its name.
        doubtful = np.maximum(self.limit, YOUNG_OUTLIER * self.size)
        self.doubtful = (doubtful**2)[:, None] * self.relative
        self.loosest = self.error / UNSTEADY**2

    @property
    def error(self) -> Real:
        """Variance (B,) of a coordinate of a marker, m^2: the misfit, no less than rounding."""
        return np.maximum(self.misfit, self.least_noise**2)

    def begin(self, markers: Complex) -> None:
        """Take shapes of bodies not seen before from a frame (B, n); origin at the mean."""
        seen = ~np.isnan(markers)
        number = seen.sum(axis=1)
        mean = np.where(seen, markers, 0).sum(axis=1) / np.maximum(number, 1)
        arms = np.where(seen, markers - mean[:, None], 0)
        distinct = np.abs(arms).max(axis=1) > ROUNDING * np.abs(mean)
        new = ((self.known == 0) & (number >= 2) & distinct)[:, None] & seen
        if new.any():
            self.shape = np.where(new, arms, self.shape)
            self.frames[new] = 1
            self.update()

    def give(self, shapes: Complex) -> None:
        """Begin with shapes (B, n) that are known, NaN for none; they are refined like others."""
        given = ~np.isnan(shapes)
        self.shape = np.where(given, shapes, self.shape)
        self.frames[given] = 1
        self.given |= given.any(axis=1)
        self.update()

    def restart(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,): they begin anew as they are seen next."""
        for part in (self.shape, self.frames, self.fits, self.misfit, self.deviation, self.freedom):
            part[which] = 0
        self.order[which] = np.arange(self.width)
        self.relative[which] = 1.0
        self.noise[which] = self.white[which] = self.last_angle[which] = np.nan
        self.jump_scale[:, which] = np.inf
        self.given[which] = self.begun[which] = False
        self.update()

    def widen(self, width: int) -> None:
        """Make room for up to `width` markers per body."""
        more = (0, 0), (0, width - self.width)
        self.shape, self.frames, self.deviation = (
            np.pad(part, more) for part in (self.shape, self.frames, self.deviation)
        )
        self.relative = np.pad(self.relative, more, constant_values=1.0)
        added = np.tile(np.arange(self.width, width), (self.count, 1))
        self.order = np.hstack((self.order, added))
        self.width = width
        self.update()

    def markers(self) -> Complex:
        """Places (B, n) of the markers, NaN for those not seen yet."""
        return np.where(self.frames > 0, self.shape, complex(np.nan, np.nan))
