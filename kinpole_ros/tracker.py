"""
The one pipeline: frames of markers in, motion of bodies out.

Node and replay both call it and nothing else does the job, so what is seen live is what a bag
gives. Header stamps drive it; it never asks for the time.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from kinpole_ros.estimate import Estimate
from kinpole_ros.frame import MarkerFrame
from kinpole_ros.parameters import Settings
from kinpole_ros.planar import landmark_kinematics, to_complex, to_plane
from kinpole_ros.window import (
    FEWEST_SAMPLES,
    Noise,
    Pins,
    Samples,
    Shapes,
    Spectrum,
    differentiate,
)

# Columns of a marker that span the plane, and the one along its normal.
AXES = {'xy': (0, 1, 2), 'yz': (1, 2, 0), 'zx': (2, 0, 1)}
# A body of all markers takes new ones up to this many: a driver that numbers its markers anew in
# every frame must not fill the memory.
MOST_MARKERS = 1024
# Coordinates are known no better than a few units of their last place.
_ROUNDING = 4 * np.finfo(float).eps
# m. No marker is that far, and the squares of what is nearer do not overflow.
_FARTHEST = 1e15
# rad. An angle noisier than this wanders round, and its errors are no longer small.
_UNSTEADY = 0.15
# Weights this near to 1 are not worth fits of their own.
_ALIKE = 0.97


class Tracker:
    """
    Follows the bodies of `settings` from frame to frame.

    `counts` says what became of the frames, for diagnostics: frames, repeated, resets,
    markers_not_seen, markers_unknown, and the markers_... that were mended, see `window.untangle`.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self.counts: Counter[str] = Counter()
        self._all_markers = not any(settings.bodies.values())
        self._axes = AXES[settings.plane]
        self._window = round(settings.window * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget all samples, and the shapes and noise learned from them."""
        count = len(self.bodies)
        self._markers = [list(markers) for markers in self.settings.bodies.values()]
        width = max(2, *(len(markers) for markers in self._markers))
        self._shapes = Shapes(count, width)
        self._noise = Noise(count)
        self._pins = Pins(count)
        self._spectrum = Spectrum()
        self._places: dict[tuple[str, ...], np.ndarray] = {}
        self._stamps = Samples((), np.int64)
        self._positions = Samples((count,), complex)
        self._angles = Samples((count,), float)
        self._information = Samples((2 * count,), float)
        self._heights = Samples((count,), float)
        self._points: Samples | None = None
        if self.settings.method == 'landmarks':
            self._points = Samples((count, width), complex)
        self._largest = 0.0
        self._since = 0
        self._due = 0

    @property
    def samples(self) -> int:
        """How many frames the window holds."""
        return len(self._stamps)

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        stamps = self._stamps.view()
        if len(stamps) < 2:
            return float('nan')
        return float(stamps[-1] - stamps[0]) * 1e-9 / (len(stamps) - 1)

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        if self.settings.noise > 0:
            return np.full(len(self.bodies), self.settings.noise)
        return np.maximum(self._noise.level(), _ROUNDING * self._largest)

    def add(self, frame: MarkerFrame, order: int | None) -> list[Estimate]:
        """
        Take one frame; return what is now known, stamped `lag` earlier, mostly one estimate.

        `order` is the highest derivative wanted now (1 to 4), None for no estimates at all. A stamp
        seen already is left out; one that steps back, or forward by more than the window, starts
        everything anew.
        """
        self.counts['frames'] += 1
        stamps = self._stamps.view()
        if len(stamps):
            step = frame.stamp - int(stamps[-1])
            if step == 0:
                self.counts['repeated'] += 1
                return []
            if step < 0 or step > self._window:
                self.counts['resets'] += 1
                self.reset()
        if not len(self._stamps):
            self._since = frame.stamp
        self._append(frame)
        return self._estimates(frame.frame_id, order)

    def _append(self, frame: MarkerFrame) -> None:
        place = self._place(frame.identities)
        # One more row of NaN stands for every marker that is not in the message.
        padded = np.full((len(frame.points) + 1, 3), np.nan)
        padded[:-1] = frame.points
        points = padded[place]
        with np.errstate(invalid='ignore'):
            points[~(np.abs(points) < _FARTHEST).all(axis=-1)] = np.nan
        flat = to_complex(points[..., self._axes[:2]])
        seen = ~np.isnan(flat)
        wanted = sum(len(markers) for markers in self._markers)
        self.counts['markers_not_seen'] += wanted - int(seen.sum())

        if self._stamps.view().size and self._gap(frame.stamp):
            self._shapes.forget_motion()
            self._noise.forget_neighbors()
        fit, flat = self._shapes.fit(flat)
        self._noise.add(fit)
        self.counts.update(self._shapes.mended)
        self._shapes.mended.clear()
        seen = ~np.isnan(flat)
        self._largest = max(self._largest, np.abs(flat).max(where=seen, initial=0.0))
        with np.errstate(divide='ignore', invalid='ignore'):
            # Inverse variances of angle and position, per variance of a coordinate of a marker.
            off_center = np.abs(fit.mean) ** 2
            position = 1 / (1 / fit.total + off_center / fit.spread)
            height = np.where(seen, points[..., self._axes[2]], 0).sum(axis=-1) / seen.sum(axis=-1)
        information = np.concatenate((fit.spread, position))
        known = np.isfinite(np.concatenate((fit.angle, fit.angle)))
        if self._points is None:
            with np.errstate(divide='ignore', invalid='ignore'):
                variance = self._misfit() / np.stack((position, fit.spread))
            self._pins.add(frame.stamp, fit.position, fit.angle, variance, self._size())
        self._stamps.append(frame.stamp)
        self._positions.append(fit.position)
        self._angles.append(fit.angle)
        self._information.append(np.where(known, information, 0.0))
        self._heights.append(height)
        if self._points is not None:
            self._points.append(flat)
        self._trim(frame.stamp - self._window)

    def _misfit(self) -> np.ndarray:
        """Variance (B,) of one coordinate of a marker, of all that keeps it off its place."""
        rounding = _ROUNDING * self._largest
        return np.maximum(self._shapes.misfit(), max(self.settings.noise, rounding) ** 2)

    def _size(self) -> np.ndarray:
        """Diameters (B,) of the bodies: twice the rms distance of their markers from the mean."""
        return np.asarray(2 * np.sqrt(self._shapes.spread / np.maximum(self._shapes.known, 1)))

    def _gap(self, stamp: int) -> bool:
        """Whether this frame comes much later than the frames before it did."""
        late = (stamp - int(self._stamps.view()[-1])) * 1e-9
        return bool(late > 2.5 * self.interval)

    def _trim(self, oldest: int) -> None:
        count = int(np.searchsorted(self._stamps.view(), oldest))
        buffers = (
            self._stamps,
            self._positions,
            self._angles,
            self._information,
            self._heights,
            self._points,
        )
        for buffer in buffers:
            if buffer is not None:
                buffer.drop(count)
        self._due = max(0, self._due - count)

    def _place(self, identities: tuple[str, ...]) -> np.ndarray:
        """Where (B, n) each body's markers are in a message; the last place + 1 for one not in."""
        place = self._places.get(identities)
        if place is None:
            if self._all_markers:
                self._take_new(identities)
            place = np.full((len(self.bodies), self._shapes.points.shape[1]), len(identities))
            used = set()
            for body, markers in enumerate(self._markers):
                for k, marker in enumerate(markers):
                    place[body, k] = find_marker(marker, identities)
                    used.add(place[body, k])
            self.counts['markers_unknown'] = len(set(range(len(identities))) - used)
            if len(self._places) > 64:
                self._places.clear()
            self._places[identities] = place
        return place

    def _take_new(self, identities: tuple[str, ...]) -> None:
        """A body of all markers: add those not met before."""
        markers = self._markers[0]
        new = [name for name in dict.fromkeys(identities) if name not in set(markers)]
        markers += new[: MOST_MARKERS - len(markers)]
        if len(markers) > self._shapes.points.shape[1]:
            self._shapes.widen(len(markers))
            self._noise.forget_neighbors()
            self._places.clear()
            if self._points is not None:
                # The landmarks of the new ones are not known in the frames before.
                old = self._points.view()
                self._points = Samples((1, len(markers)), complex)
                for row in old:
                    missing = np.full((1, len(markers) - row.shape[1]), complex(np.nan, np.nan))
                    self._points.append(np.concatenate((row, missing), axis=1))

    def _estimates(self, frame_id: str, order: int | None) -> list[Estimate]:
        """All estimates that fall due: waiting for one more frame would trail by more than lag."""
        stamps = self._stamps.view()
        newest = int(stamps[-1])
        slack = 0.75 * self.interval if len(stamps) > 1 else 0.0
        last = newest - round((self.settings.lag - slack) * 1e9)
        end = min(int(np.searchsorted(stamps, last, side='right')), len(stamps))
        due, self._due = range(self._due, end), max(self._due, end)
        if order is None or len(stamps) < FEWEST_SAMPLES:
            return []
        return [self._estimate(now, frame_id, order) for now in due]

    def _estimate(self, now: int, frame_id: str, order: int) -> Estimate:
        count = len(self.bodies)
        stamps = self._stamps.view()
        times = stamps - stamps[now]
        noise = self.noise()
        information = self._information.view()
        seen = information[now, :count] > 0
        measured = np.isfinite(noise)
        with np.errstate(invalid='ignore'):
            firm = noise**2 < _UNSTEADY**2 * self._shapes.spread
        usable = seen & measured & firm
        noise = np.where(measured, noise, 1.0)
        differentiated = self._from_poses if self._points is None else self._from_landmarks
        found = differentiated(times, now, noise, order)
        position, angle, position_covariance, angle_covariance, span, degree = found
        for array in found:
            array[..., ~usable] = np.nan
        few = ~np.isfinite(angle[1]) | ~np.isfinite(position[1])
        missing = tuple(
            _why_missing(*flags) for flags in zip(seen, measured, firm, few, strict=True)
        )
        return Estimate(
            int(stamps[now]),
            frame_id,
            self.bodies,
            position,
            angle,
            position_covariance,
            angle_covariance,
            self._size(),
            self._heights.view()[now].copy(),
            span,
            degree,
            missing,
            self._since,
            *self._pinned(),
            self._shapes.markers(),
        )

    def _pinned(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Fixed pins (B,) of the bodies, complex, NaN for none, and their variance.

        A pin holds for the whole window or not at all.
        """
        held = np.isfinite(self._pins.center) & (self._pins.since <= self._stamps.view()[0])
        return (
            np.where(held, self._pins.center, complex(np.nan, np.nan)),
            np.where(held, self._pins.variance, np.nan),
        )

    def _from_poses(
        self, times: np.ndarray, now: int, noise: np.ndarray, order: int
    ) -> tuple[np.ndarray, ...]:
        """Derivatives of the fitted poses: angle and position, each with models of its own."""
        count = len(self.bodies)
        information = self._information.view()
        most = information.max(axis=0)
        most = np.where(most > 0, most, 1.0)
        weights = information / most
        signals = np.zeros((len(times), 2 * count, 2))
        signals[:, :count, 0] = _unwrapped(self._angles.view())
        signals[:, count:] = to_plane(self._positions.view())
        dimensions = np.repeat((1, 2), count)
        level = np.concatenate((noise, noise)) / np.sqrt(most)
        alike = bool(np.all(weights > _ALIKE))
        found = differentiate(
            times,
            signals,
            None if alike else weights,
            level,
            dimensions,
            order,
            self._spectrum,
        )
        position = found.values[:, count:, 0] + 1j * found.values[:, count:, 1]
        angle = found.values[:, :count, 0].copy()
        covariance = found.covariance
        return (
            position,
            angle,
            covariance[..., count:],
            covariance[..., :count],
            found.span[:count],
            found.degree[:count],
        )

    def _from_landmarks(
        self, times: np.ndarray, now: int, noise: np.ndarray, order: int
    ) -> tuple[np.ndarray, ...]:
        """Derivatives of each landmark, then the seeds' formulas (seed 000)."""
        assert self._points is not None
        points = self._points.view()
        count, width = points.shape[1:]
        signals = to_plane(points.reshape(len(points), -1))
        weights = np.where(np.isfinite(signals[..., 0]), 1.0, 0.0)
        found = differentiate(
            times,
            signals,
            None if weights.all() else weights,
            np.repeat(noise, width),
            np.full(count * width, 2),
            order,
            self._spectrum,
        )
        derivatives = found.values.reshape(order + 1, count, width, 2)
        here = np.asarray(np.isfinite(derivatives).all(axis=(0, -1)))
        given = np.where(here[..., None], derivatives, 0.0)
        landmarks, velocities, *higher = given
        motion = landmark_kinematics(
            landmarks,
            velocities,
            *higher,
            weights=here.astype(float),  # type: ignore[misc]
        )
        covariance = np.where(here, found.covariance.reshape(order + 1, -1, count, width), 0.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            number = here.sum(axis=-1)
            arms = np.where(here, _squared_arms(given[0], here), 0.0)
            position_covariance = covariance.sum(axis=-1) / number**2
            angle_covariance = (covariance * arms).sum(axis=-1) / arms.sum(axis=-1) ** 2
        span = found.span.reshape(count, width).mean(axis=1)
        degree = found.degree.reshape(count, width).mean(axis=1)
        angle = motion.angle[: order + 1].copy()
        angle[0] = self._angles.view()[now]
        position = motion.position[: order + 1].copy()
        return position, angle, position_covariance, angle_covariance, span, degree


def find_marker(marker: str, identities: Sequence[str]) -> int:
    """
    Place of a marker in a message, len(identities) if it is not there.

    A name stands for the full identity, else for the one marker of that namespace, else for the
    one of that id: 'tip/3', 'tip' or '3'.
    """
    if marker in identities:
        return list(identities).index(marker)
    for part in (0, 2):
        found = [
            k
            for k, name in enumerate(identities)
            if '/' in name and name.rpartition('/')[part] == marker
        ]
        if len(found) == 1:
            return found[0]
    return len(identities)


def _squared_arms(points: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Squared distances (B, n) of the markers that are here from their mean."""
    number = np.maximum(here.sum(axis=-1), 1)
    mean = (points * here[..., None]).sum(axis=-2) / number[:, None]
    return np.asarray(((points - mean[:, None]) ** 2).sum(axis=-1))


def _unwrapped(angles: np.ndarray) -> np.ndarray:
    """Continuous angles (N, B); where one is NaN, whatever was before stands in."""
    known = np.isfinite(angles)
    if not known.all():
        rows = np.where(known, np.arange(len(angles))[:, None], known.argmax(axis=0))
        filled = np.take_along_axis(angles, np.maximum.accumulate(rows), axis=0)
        angles = np.where(np.isfinite(filled), filled, 0.0)
    return np.unwrap(angles, axis=0)


def _why_missing(seen: bool, measured: bool, firm: bool, few: bool) -> str:
    if not seen:
        return 'too few markers seen, or all at one place'
    if not measured:
        return 'noise not known yet'
    if not firm:
        return 'markers too close together for their noise'
    return 'window not full' if few else ''
