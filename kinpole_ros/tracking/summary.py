"""What diagnostics say of a tracker: read from its state."""

from collections import Counter

import numpy as np

from kinpole_ros.tracking.clock import StampState
from kinpole_ros.tracking.deformation import TISSUE
from kinpole_ros.tracking.names import Matcher
from kinpole_ros.tracking.outages import Outage, named_outages
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.space import SpaceReport
from kinpole_ros.tracking.state import State
from kinpole_ros.tracking.update import count_new_frames

# Residuals beyond this share of the body size are of markers on other bodies: tissue moves less.
OTHER_BODY_SHARE = 0.05


class TrackerSummary:
    """The state of a tracker in the terms of its user."""

    state: State

    def count(self, what: str, number: int = 1) -> None:
        """Count something that the readers of messages found."""
        self.state.totals.counts[what] += number

    def update_counts(self) -> Counter[str]:
        """
        Count up to the last frame, and return the counts.

        They are the numbers of frames and markers that were dropped, corrected or not seen, by
        cause.
        """
        count_new_frames(self.state)
        self.state.timeline.count_lost()
        return self.state.totals.counts

    @property
    def matcher(self) -> Matcher:
        """The names of markers, with their corrections."""
        return self.state.matcher

    @property
    def samples(self) -> int:
        """Number of frames in the window."""
        return int(self.state.step.columns.window_frames)

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self.state.step.columns.interval * 1e-9 if self.samples > 1 else float('nan')

    @property
    def plane(self) -> Plane | None:
        """The plane of the results; None until it is fitted."""
        return self.state.assignment.plane

    @property
    def identities(self) -> tuple[str, ...]:
        """Identities of the markers in the last message."""
        return () if self.state.placed is None else self.state.placed.identities

    @property
    def run(self) -> int:
        """Another number for each start, with other frames of the bodies."""
        return self.state.run

    @property
    def has_markers(self) -> bool:
        """Whether bodies are known by markers, not by poses."""
        return not self.state.bodies.are_measured

    @property
    def markers(self) -> list[list[str]]:
        """Names of the markers of each body."""
        return self.state.assignment.markers

    def places(self) -> np.ndarray:
        """Return the places (B, n) of the markers in the frames of bodies, m, NaN if unknown."""
        return self.state.bodies.placement.places

    def sizes(self) -> np.ndarray:
        """Return the diameters (B,) of the bodies, m; 0 if unknown."""
        return self.state.bodies.fitting.size

    def pins(self) -> np.ndarray:
        """Return the fixed point (B,) about which each body turns, in the plane, m; NaN: none."""
        return self.state.bodies.pin

    def space(self) -> SpaceReport:
        """Return the tilt of the motion against the plane, and how far it leaves the plane."""
        count_new_frames(self.state)
        return self.state.space.report()

    def noise(self) -> np.ndarray:
        """Return the noise (B,) of one coordinate of a marker, m; NaN while not measured."""
        return self.state.bodies.noise

    def angle_noise(self) -> np.ndarray | None:
        """Return the noise (B,) of the angles of input poses, rad; None for markers."""
        bodies = self.state.bodies
        known = np.where(np.isinf(bodies.angle_noise), np.nan, bodies.angle_noise)
        return known if bodies.are_measured else None

    def rigidity_residual(self) -> np.ndarray:
        """Return the rms residual (B,) of each body, m, per axis; 0 for one that is rigid."""
        return self.state.bodies.rigidity_residual()

    def causes(self) -> list[str]:
        """Return why the markers of each body move against each other, '' if it is not known."""
        known = self.state.bodies
        off = np.sqrt(known.misfit)
        tissue = (known.freedom > 0) & ~(off > OTHER_BODY_SHARE * known.fitting.size)
        return [TISSUE if one else '' for one in tissue]

    def noise_underestimated(self) -> np.ndarray:
        """Return which bodies (B,) have noise that is correlated for too long to be measured."""
        return self.state.bodies.lasting & (self.state.settings.noise == 0)

    def erring(self) -> dict[str, dict[str, float]]:
        """Return the standard deviations of noisy markers by body and name, m, per axis."""
        return {
            body: {self.state.assignment.markers[b][k]: float(row[k]) for k in np.flatnonzero(row)}
            for b, (body, row) in enumerate(
                zip(self.state.settings.bodies, self.state.bodies.deviation, strict=True)
            )
        }

    def wrong(self) -> np.ndarray:
        """Return in how many frames each body (B,) was left out since its pose was off its path."""
        return self.state.totals.wrong

    def outages(self) -> dict[str, Outage]:
        """Return gaps of a window or more, by body; '' for gaps without any frame."""
        return named_outages(self.state.totals.outages, list(self.state.settings.bodies))

    def absent_markers(self) -> dict[str, list[str]]:
        """Return the markers that the last message lacks, of bodies with less than two in it."""
        if self.state.placed is None:
            return {}
        lacks = zip(
            self.state.settings.bodies,
            self.state.assignment.absent_of_bodies(self.state.placed),
            strict=False,
        )
        return {body: names for body, names in lacks if names}

    def stamp_state(self) -> StampState | None:
        """Return how the stamps lie on the estimated clock; None while too few have come."""
        return self.state.timeline.stamp_state()
