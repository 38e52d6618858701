"""
The tracker: frames of markers in, motion of bodies out, one frame at a time.

Node and replay call it alike, so live results equal replayed ones. Stamps drive it, never the time
of the machine.
"""

import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.pipeline.estimate import Estimate
from kinpole_ros.pipeline.frame import MarkerFrames
from kinpole_ros.pipeline.matcher import Matcher
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.roster import Roster
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid.levels import LITTLE, SURE, TINY
from kinpole_ros.rigid.plane import Plane
from kinpole_ros.rigid.space import Space, SpaceReport
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.center import Pins, find_hubs
from kinpole_ros.tracking.deformation import deformed_freedom
from kinpole_ros.tracking.fit import correct_frame, fit_markers, odd_bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.learn import NOISE_FRAMES, freedom_of, learn, record_fit
from kinpole_ros.tracking.outliers import leave_out_wrong_poses, path_scale
from kinpole_ros.tracking.results import estimate_of, result_at

# Frames kept to learn from, and at least so many windows.
LEARNED_FRAMES, LEARNED_WINDOWS = 1024, 4
# Frames between two updates: this share of those that have come, at most so many.
UPDATE_SHARE, MOST_BETWEEN_UPDATES = 1 / 8, 64
# Intervals after which a frame does not go on from the one before.
GAP = 2.5
# Markers that are off by this share of the size of their body are of other bodies: no tissue moves
# so far.
OTHER_BODIES = 0.05
TISSUE = 'tissue'
_run_numbers = itertools.count(1)


class Outage(NamedTuple):
    """How often nothing came for a window or more; the latest and the longest, from when, ns."""

    times: int
    latest: tuple[int, int]
    longest: tuple[int, int]


def one_more(outage: Outage | None, since: int, lasted: int) -> Outage:
    """The outages so far, if any, and one that `lasted` so long since then, ns."""
    new = since, lasted
    if outage is None:
        return Outage(1, new, new)
    longest = max(outage.longest, new, key=lambda each: each[1])
    return Outage(outage.times + 1, new, longest)


class Tracker:
    """
    Follows the bodies of `settings` from frame to frame.

    `samples` is the number of frames in the window. `counts` says what became of the frames, for
    diagnostics.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self.counts: Counter[str] = Counter()
        self._window = round(settings.window * 1e9)
        self._lag = settings.lag * 1e9
        self._frame_id = ''
        self._outages: dict[str, Outage] = {}
        self._wrong = np.zeros(len(self.bodies), int)
        self._start()

    def reset(self) -> None:
        """Forget all frames, and what was learned from them."""
        self._start()

    def _start(self) -> None:
        count = len(self.bodies)
        self._roster = Roster(self.settings, False)
        self._space = Space(self.settings.plane, count, self._roster.width)
        self._roster.plane = self._space.plane
        # Frames before the plane is known: stamps and markers in space.
        self._early: list[tuple[int, np.ndarray]] = []
        self.samples = 0
        self._interval = 0.0
        self._last: tuple[int, np.ndarray] | None = None
        self._due = 0
        self._seen_last = np.full(count, -1, np.int64)
        self._run_number = next(_run_numbers)
        self._begin_bodies()

    def _begin_bodies(self) -> None:
        """Begin with bodies of which nothing is known."""
        self._known = Bodies(len(self.bodies), self._roster.width)
        self._history = History(len(self.bodies), self._roster.width)
        self._pins = Pins(self._known)
        self.matcher = Matcher(self.settings, self._roster, self._known, self.counts)
        self._frames = 0
        self._new = 0
        self._next_update = 1

    # What diagnostics ask for.

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self._interval * 1e-9 if self.samples > 1 else float('nan')

    @property
    def plane(self) -> Plane | None:
        """The plane of the results; None while it is to be fitted and not known yet."""
        return self._roster.plane

    @property
    def identities(self) -> tuple[str, ...]:
        """The markers that the last message has."""
        return self._roster.identities

    def space(self) -> SpaceReport:
        """How the motion lies in space: its tilt against the plane, and what leaves the plane."""
        return self._space.report()

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        return self._known.noise

    def angle_noise(self) -> np.ndarray | None:
        """Noise (B,) of the angles of poses that come as such, rad; None where markers come."""
        return None

    def rigidity_residual(self) -> np.ndarray:
        """How far (B,) markers are off one rigid body, m, per axis; 0 where they may be of one."""
        known = self._known
        off = np.sqrt(np.where(known.mature, known.misfit, np.nan))
        with np.errstate(invalid='ignore'):
            loose = (off > SURE * known.white) & (off > LITTLE * known.size)
            loose &= off > TINY * known.size
        return np.where(loose, off, 0.0)

    def causes(self) -> list[str]:
        """What moves the markers of each body against each other, '' unless it is known."""
        known = self._known
        off = np.sqrt(known.misfit)
        tissue = (known.freedom > 0) & ~(off > OTHER_BODIES * known.size)
        return [TISSUE if one else '' for one in tissue]

    def noise_underestimated(self) -> np.ndarray:
        """Which bodies (B,) have more noise than can be measured, since it lasts long."""
        return self._known.lasting & (self.settings.noise == 0)

    def erring(self) -> dict[str, dict[str, float]]:
        """Deviations, m, per axis, of markers, by name, that count for less than the others."""
        return {
            body: {self._roster.markers[b][k]: float(row[k]) for k in np.flatnonzero(row)}
            for b, (body, row) in enumerate(zip(self.bodies, self._known.deviation, strict=True))
        }

    def wrong(self) -> np.ndarray:
        """In how many frames each body (B,) as a whole was wrong, and left out."""
        return self._wrong

    def outages(self) -> dict[str, Outage]:
        """For how long bodies, by name, were not seen, a window or more; all frames by ''."""
        return self._outages

    def lacking(self) -> dict[str, list[str]]:
        """Markers by body that the last message has not, where less than two of the body are."""
        lacks = zip(self.bodies, self._roster.lacking(), strict=False)
        return {body: names for body, names in lacks if names}

    def stamp_state(self) -> None:
        """How the stamps lie on the clock found behind them; None while too few have come."""
        return None

    # Frames.

    def add(self, frames: MarkerFrames, order: int | None) -> list[Estimate]:
        """
        Take frames; return what is now known, stamped `lag` earlier.

        `order` is the highest derivative wanted now (1 to 4), None for no estimates at all. A stamp
        seen already is left out, and so is a frame that comes late: before the newest, within the
        window. Everything starts anew with another frame_id, and with a stamp farther from the
        newest than the window.
        """
        return self.add_parts((frames,), order)

    def add_parts(self, parts: Iterable[MarkerFrames], order: int | None) -> list[Estimate]:
        """The same of frames in parts. Instants are `due` by the number of the frame in all."""
        estimates: list[Estimate] = []
        number = 0
        for frames in parts:
            stamps = np.asarray(frames.stamps).tolist()
            if not stamps:
                continue
            if frames.frame_id != self._frame_id:
                if len(self._history):
                    self.counts['frame_changes'] += 1
                    self._start()
                self._frame_id = frames.frame_id
            results: list[dict[str, Any]] = []
            solid = self._sort(frames)
            for k, stamp in enumerate(stamps):
                self.counts['frames'] += 1
                accepted = self._accepts(stamp, frames.points[k])
                if accepted is None:
                    estimates += self._joined(results)
                    results = []
                    self._begin_again(stamp)
                    solid = self._sort(frames)
                if accepted is not False:
                    self.settle()
                    if self._roster.plane is not self._space.plane:
                        estimates += self._joined(results)
                        results = []
                        self._catch_up()
                        solid = self._sort(frames)
                    self._take(stamp, k, solid[k])
                    for result in self._due_results(order):
                        result['due'] = number
                        results.append(result)
                number += 1
            self.counts['markers_unknown'] = self._roster.unknown
            estimates += self._joined(results)
        return estimates

    def settle(self) -> None:
        """Learn from the frames of late if it is time for it; else the next `add` does."""
        if self._frames >= self._next_update:
            self._update()

    def _joined(self, results: list[dict[str, Any]]) -> list[Estimate]:
        if not results:
            return []
        return [
            estimate_of(results, self._frame_id, self.bodies, self._run_number, self.plane)
        ]

    def _sort(self, frames: MarkerFrames) -> np.ndarray:
        """The markers (T, B, n, 3) of the bodies, m; hands them to the matcher in the plane."""
        solid = self._roster.sort(frames)
        if self._roster.width > self._known.width:
            self._widen()
        points, heights = self._roster.flat(solid)
        self._points, self._heights = points, heights
        self.matcher.begin(np.asarray(frames.stamps), points, heights)
        return solid

    def _widen(self) -> None:
        """A body of all markers has more of them: begin with those, as of the same frames."""
        width = self._roster.width
        self._known.widen(width)
        self._history.widen(width)
        self._pins.widen(width)
        self._space.widen(width)
        self.matcher.forget_points()
        self._early = []

    def _accepts(self, stamp: int, points: np.ndarray) -> bool | None:
        """Whether a frame goes on from those before; None if everything has to start anew."""
        last, self._last = self._last, (stamp, points)
        if not len(self._history):
            return True
        newest = int(self._history['stamp'][-1])
        ahead = stamp - newest
        if abs(ahead) > self._window:
            return None
        if ahead > 0:
            return True
        assert last is not None
        if ahead < 0 and last[0] < newest and stamp > last[0]:
            # Stamps go on from a late one: the clock has stepped back.
            return None
        self.counts['repeated' if ahead == 0 else 'late'] += 1
        return False

    def _begin_again(self, stamp: int) -> None:
        """Start anew after a jump of the stamps."""
        newest = int(self._history['stamp'][-1])
        if stamp > newest:
            self._outages[''] = one_more(self._outages.get(''), newest, stamp - newest)
        self.counts['resets'] += 1
        last = self._last
        self._start()
        self._last = last

    def _take(self, stamp: int, k: int, solid: np.ndarray) -> None:
        """Fit the poses of frame `k` of those sorted last, and append them to the history."""
        bodies, history, matcher = self._known, self._history, self.matcher
        goes_on = not (
            len(history) and self._interval > 0 and stamp - history['stamp'][-1] > GAP * self._interval
        )
        if self._roster.plane is None:
            self._early.append((stamp, solid))
            if matcher.lacks_order(1):
                solid = np.full_like(solid, np.nan)
            self._append(stamp, goes_on, np.full(solid.shape[:2], complex(np.nan, np.nan)))
            self._space.add(solid[None])
            return
        _, anew = matcher.arrange(k, 1)
        if anew:
            self._begin_anew(np.ones(bodies.count, bool))
        if len(bodies.unmet):
            bodies.begin(self._points[k])
        matcher.fits_next(k, k + 1)
        fit = fit_markers(bodies, self._points[k])
        if self._name_in_doubt(fit, k) and matcher.correct(0, []):
            fit = fit_markers(bodies, self._points[k])
        odd = odd_bodies(bodies, history, fit, goes_on)
        came = self._points[k].copy()
        if bodies.exchanged or odd.any():
            fit, came = correct_frame(bodies, history, self._points[k], odd, self.counts)
        self._append(stamp, goes_on, came)
        last = slice(len(history) - 1, None)
        history['used'][-1] = ~np.isnan(fit.residual)
        record_fit(bodies, history, type(fit)(*(part[None] for part in fit)), last)
        matcher.follow(type(fit)(*(part[None] for part in fit)))
        self._unwrap()
        seen = ~np.isnan(came)
        number = np.maximum(seen.sum(axis=1), 1)
        history['height'][-1] = np.where(seen, self._heights[k], 0).sum(axis=1) / number
        self._wrong += leave_out_wrong_poses(history, bodies)
        self._note_outages(stamp)
        self._space.add(self._roster.plane.in_space(came, self._heights[k])[None])
        self.counts['markers_not_seen'] += int(self._roster.wanted - seen.sum())

    def _append(self, stamp: int, goes_on: bool, markers: Complex) -> None:
        """Append a frame to the history, without poses."""
        history = self._history
        history.append()
        history['stamp'][-1] = history['time'][-1] = stamp
        history['goes_on'][-1] = goes_on
        history['markers'][-1] = markers
        history['used'][-1] = False
        for name in ('residual', 'angle', 'position', 'height'):
            history[name][-1] = np.nan
        history['information'][-1] = history['turns'][-1] = 0.0
        self._new += 1
        self._frames += 1

    def _name_in_doubt(self, fit: Any, k: int) -> bool:
        """Whether markers of the frame may have wrong names."""
        bodies = self._known
        limit = (bodies.limit**2)[:, None] * bodies.relative
        square = fit.residual.real**2 + fit.residual.imag**2
        if (square > limit).any():
            return True
        unseen = np.isnan(self._points[k])
        if not unseen.any():
            return False
        one = type(fit)(*(part[None] for part in fit))
        doubtful = self.matcher.doubtful(one, unseen[None])
        return doubtful is not None and bool(doubtful.any())

    def _unwrap(self) -> None:
        """Count the whole turns of the newest angles from the last ones known."""
        angle, turns = self._history['angle'], self._history['turns']
        now = np.where(np.isfinite(angle[-1]), angle[-1], self._known.last_angle)
        before = np.where(np.isfinite(self._known.last_angle), self._known.last_angle, now)
        count = turns[-2] if len(turns) > 1 else np.zeros_like(now)
        with np.errstate(invalid='ignore'):
            turns[-1] = count - np.nan_to_num(np.rint((now - before) / (2 * np.pi)))
        self._known.last_angle = now

    def _note_outages(self, stamp: int) -> None:
        """Note which bodies are seen again after a window or more."""
        seen = np.isfinite(self._history['angle'][-1])
        lasted = np.where(self._seen_last >= 0, stamp - self._seen_last, 0)
        for b in np.flatnonzero(seen & (lasted >= self._window)).tolist():
            body, since = self.bodies[b], int(self._seen_last[b])
            self._outages[body] = one_more(self._outages.get(body), since, int(lasted[b]))
        self._seen_last[seen] = stamp

    def _begin_anew(self, which: np.ndarray) -> None:
        """Forget what was learned of the bodies `which` (B,)."""
        self._known.restart(which)
        if self.matcher.has_shape.any():
            self._known.give(np.where(which[:, None], self.matcher.given, np.nan))
        self._history['information'][:, :, which] = 0.0
        self._history['used'][:, which] = False
        self._history['angle'][:, which] = np.nan
        self._pins.forget(which)

    def _catch_up(self) -> None:
        """The plane has become known: take the frames before as they lie in it."""
        early, self._early = self._early, []
        due = self._due + self._history.dropped
        dropped = self._history.dropped
        self._roster.plane = self._space.plane
        assert self._roster.plane is not None
        self._begin_bodies()
        space, self._space = self._space, _NoSpace()
        for stamp, solid in early:
            self.settle()
            points, heights = self._roster.flat(solid[None])
            self._points, self._heights = points, heights
            self.matcher.begin(np.array([stamp]), points, heights)
            self._take(stamp, 0, solid)
        self._space = space
        self._due = due - dropped

    def _update(self) -> None:
        """Learn from the frames of late."""
        bodies, history = self._known, self._history
        self._next_update = self._frames + max(
            1, min(int(self._frames * UPDATE_SHARE), MOST_BETWEEN_UPDATES)
        )
        if self._roster.plane is None:
            return
        anew = learn(bodies, history, self._window, self.settings.noise, self.counts)
        self._pins.forget(anew)
        self._pins.update(bodies, history, min(self._new, len(history)))
        self._new = 0
        bodies.hub = find_hubs(bodies, history, self._window, bodies.hub)
        bodies.jump_scale = path_scale(history, bodies)
        rows = slice(-NOISE_FRAMES - 2, None)
        time, residual = history['time'][rows], history['residual'][rows]
        interval = float(np.median(np.diff(time))) if len(time) > 1 else self._window / 2
        free = freedom_of(bodies, residual).sum(axis=-1)
        noise = np.fmax(bodies.noise, bodies.white)
        half = round(self._window / 2 / max(interval, 1.0))
        bodies.freedom, bodies.held = deformed_freedom(residual, free, noise, bodies.degrees, half)
        if self.matcher.look_is_due():
            regrouped = self.matcher.regroup(self.rigidity_residual() > 0)
            if regrouped.any():
                self._begin_anew(regrouped)

    def _due_results(self, order: int | None) -> list[dict[str, Any]]:
        """Results of the instants that fall due with the newest frame."""
        history = self._history
        time = history['time']
        newest = len(time) - 1
        oldest = int(time.searchsorted(time[-1] - self._window))
        self.samples = newest - oldest + 1
        self._interval = float(time[-1] - time[oldest]) / max(newest - oldest, 1)
        last = int(time[-1]) - int(np.rint(self._lag - 0.75 * self._interval))
        end = max(min(int(time.searchsorted(last, side='right')), newest + 1), self._due)
        found = []
        for now in range(self._due, end):
            if order is not None and newest - oldest >= FEWEST_SAMPLES - 1 and now >= oldest:
                found.append(
                    result_at(
                        self._known,
                        self._pins,
                        history,
                        now,
                        oldest,
                        self._interval * 1e-9,
                        self.settings.window,
                        order,
                        self.settings.effort,
                    )
                )
                if self._roster.plane is None:
                    found[-1]['missing'][:] = 'plane not known yet'
        self._due = end
        kept = max(LEARNED_FRAMES, LEARNED_WINDOWS * self.samples)
        if newest + 1 > kept and oldest > 0:
            drop = min(oldest, newest + 1 - kept)
            history.drop(drop)
            self._due = max(0, self._due - drop)
        return found


class _NoSpace:
    """Stands for the measurement in space while frames are taken a second time."""

    def add(self, solid: np.ndarray) -> None:
        """Take nothing."""
