"""
The tracker: frames of markers in, motion of bodies out, one frame at a time.

Node and replay call it alike, so live results equal replayed ones. Stamps drive it, never the time
of the machine.
"""

import itertools
from collections import Counter, deque
from collections.abc import Iterable

import numpy as np

from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.center import Pins, find_hubs
from kinpole_ros.tracking.corrections import EXCHANGED
from kinpole_ros.tracking.deformation import TISSUE, deformed_freedom
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.fit import correct_frame, fit_markers
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.learn import MOVED_FRAMES, NOISE_FRAMES, freedom_of, learn
from kinpole_ros.tracking.levels import LITTLE, SURE, TINY
from kinpole_ros.tracking.matcher import Matcher
from kinpole_ros.tracking.outages import Outage, one_more
from kinpole_ros.tracking.outliers import path_scale
from kinpole_ros.tracking.parameters import Settings, of_poses
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.posed import TiltedTurns, learn_poses
from kinpole_ros.tracking.results import Results, add_deformation, estimate_of
from kinpole_ros.tracking.roster import Roster
from kinpole_ros.tracking.space import Space, SpaceReport
from kinpole_ros.tracking.stamps import StampState
from kinpole_ros.tracking.step import (
    DEFORMED,
    FULL,
    GAP,
    NAME_DOUBTFUL,
    ODD,
    SEEN_AGAIN,
    UNUSUAL,
    Step,
)
from kinpole_ros.tracking.timeline import Timeline

# Frames kept to learn from, and at least so many windows.
LEARNED_FRAMES, LEARNED_WINDOWS = 1024, 4
# Frames between two updates: this share of those that have come, at most so many.
UPDATE_SHARE, MOST_BETWEEN_UPDATES = 1 / 8, 128
# Frames between two searches for the names of markers, if those before found none.
MOST_BETWEEN_SEARCHES = 16
# Markers that are off by this share of the size of their body are of other bodies: no tissue moves
# so far.
OTHER_BODIES = 0.05
_run_numbers = itertools.count(1)


class Tracker:
    """Follows the bodies of `settings` from frame to frame."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self._counts: Counter[str] = Counter()
        self._window = round(settings.window * 1e9)
        self._frame_id = ''
        # Whether poses come, and not markers.
        self._posed = False
        self._outages: dict[str, Outage] = {}
        self._wrong = np.zeros(len(self.bodies), int)
        self._start()

    def reset(self) -> None:
        """Forget all frames, and what was learned from them."""
        self._start()

    def _start(self, before: Timeline | None = None) -> None:
        """Start anew; `before` a jump of the stamps frames were as in that timeline."""
        count = len(self.bodies)
        if hasattr(self, '_step'):
            self._wrong = self.wrong()
        settings = of_poses(self.settings) if self._posed else self.settings
        self._roster = Roster(settings, self._posed)
        self._space = Space(self.settings.plane, count, self._roster.width)
        self._roster.plane = self._space.plane
        # Frames before the plane is known: stamps, times and markers.
        self._early: deque[tuple[int, int, MarkerFrames]] = deque(maxlen=LEARNED_FRAMES)
        self._run_number = next(_run_numbers)
        self._begin_bodies()
        self._timeline = Timeline(self.settings, self._counts, self._history, before)

    def _begin_bodies(self) -> None:
        """Begin with bodies of which nothing is known."""
        self._known = Bodies(len(self.bodies), self._roster.width)
        self._history = History(len(self.bodies), self._roster.width)
        self._pins = Pins(self._known)
        settings = of_poses(self.settings) if self._posed else self.settings
        self._turns = TiltedTurns(len(self.bodies))
        self.matcher = Matcher(settings, self._roster, self._known, self._history, self._counts)
        self._step = Step(settings, self._known, self._pins, self._history, self._posed)
        self._frames = self._new = self._counted = 0
        # Searches for the names of markers, in a row, that found none.
        self._futile = self._next_search = 0
        self._next_update = 1
        self._names_changed = False

    # What diagnostics ask for.

    @property
    def counts(self) -> Counter[str]:
        """What became of the frames, and of their markers."""
        self._count_new()
        return self._counts

    @property
    def samples(self) -> int:
        """Number of frames in the window."""
        return int(self._step.fields.samples)

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self._step.fields.interval * 1e-9 if self.samples > 1 else float('nan')

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
        self._count_new()
        return self._space.report()

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        return self._known.noise

    def angle_noise(self) -> np.ndarray | None:
        """Noise (B,) of the angles of poses that come as such, rad; None where markers come."""
        return self._known.angle_noise if self._posed else None

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
        return self._wrong + self._step.wrong

    def outages(self) -> dict[str, Outage]:
        """For how long bodies, by name, were not seen, a window or more; all frames by ''."""
        return self._outages

    def lacking(self) -> dict[str, list[str]]:
        """Markers by body that the last message has not, where less than two of the body are."""
        lacks = zip(self.bodies, self._roster.lacking(), strict=False)
        return {body: names for body, names in lacks if names}

    def stamp_state(self) -> StampState | None:
        """How the stamps lie on the clock found behind them; None while too few have come."""
        return self._timeline.stamp_state()

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
        self._results: list[Results] = []
        number = 0
        for frames in parts:
            stamps = np.asarray(frames.stamps)
            if not len(stamps):
                continue
            posed = frames.axes is not None
            if frames.frame_id != self._frame_id or posed != self._posed:
                estimates += self._estimates_so_far()
                used = len(self._history) > 0
                self._counts['frame_changes'] += used
                anew = used or posed != self._posed
                self._frame_id, self._posed = frames.frame_id, posed
                if anew:
                    self._start()
            self._counts['frames'] += len(stamps)
            first = 0
            while first < len(stamps):
                if self._timeline.clock_update_is_due:
                    # By the noise as it is known to whoever takes frames one by one.
                    self._names_changed = self._update_if_due()
                    self._timeline.update_clock(self.samples, self.noise())
                some = slice(first, None)
                steps, end, anew = self._timeline.accept(stamps[some], frames.points[some])
                new = first + (steps > 0).nonzero()[0]
                if len(new):
                    taken = frames if len(new) == len(stamps) else part_of(frames, new)
                    for part, numbers in self._timeline.count(taken, number + new):
                        estimates += self._take_all(part, numbers, order)
                first += end
                if anew:
                    estimates += self._estimates_so_far()
                    self._begin_again(int(stamps[first]))
            number += len(stamps)
            self._counts['markers_unknown'] = self._roster.unknown
        return estimates + self._estimates_so_far()

    def _take_all(
        self, frames: MarkerFrames, numbers: np.ndarray, order: int | None
    ) -> list[Estimate]:
        """Take frames whose times are sure; returns estimates that are complete."""
        estimates: list[Estimate] = []
        width = self._known.width
        solid = self._sort(frames)
        if self._known.width > width:
            estimates += self._estimates_so_far()
        times = self._timeline.enter(frames.stamps)
        self._hand_over(frames.stamps, times)
        results = self._room_for(len(frames.stamps), order)
        first, count = 0, len(frames.stamps)
        while first < count:
            if self._update_if_due():
                self.matcher.sort_again(first)
                self._step.fields.hidden_is_unusual = self.matcher.has_extras
            if self._roster.plane is not self._space.plane:
                self._keep(results, numbers)
                estimates += self._estimates_so_far()
                self._catch_up()
                solid = self._sort(frames)
                self._hand_over(frames.stamps, times)
                self._step.fields.frame = first
                results = self._room_for(count - first, order)
            usual = not self._posed and self._roster.plane is not None and not self._known.exchanged
            if not (usual and self.matcher.in_order):
                code = UNUSUAL
            else:
                code = self._follow(self._next_update - self._frames, results)
            first = self._step.fields.frame
            if code == UNUSUAL:
                self._take(int(frames.stamps[first]), int(times[0][first]), first, solid[first])
                self._history['count'][-1] = times[1][first]
                first += 1
                self._step.fields.frame = first
                self._follow(0, results)
        self._keep(results, numbers)
        if self._posed and self._roster.plane is not None:
            self._space.add(solid)
        return estimates

    def _hand_over(self, stamps: np.ndarray, times: tuple[np.ndarray, ...]) -> None:
        """Hand the frames sorted last to the compiled step."""
        came = stamps, *times, self._points, self._heights
        self._step.hand_over(came, self.matcher.has_extras)

    def _follow(self, until_update: int, results: Results) -> int:
        """Take usual frames, and compute what falls due; why it does not go on."""
        step, history = self._step, self._history
        fields = step.fields
        while True:
            before = fields.frame
            code = step.follow(until_update, results)
            taken = fields.frame - before
            until_update -= taken
            self._frames += taken
            self._new += taken
            if code == SEEN_AGAIN:
                self._note_outages(int(history['stamp'][-1]))
            elif code == DEFORMED:
                now, oldest = fields.due - 1, len(history) - fields.samples
                interval = fields.interval * 1e-9
                add_deformation(results, self._known, history, now, oldest, interval)
            else:
                assert code != FULL
                return code

    def _room_for(self, frames: int, order: int | None) -> Results:
        """Room for the results that so many frames can make due."""
        if order is None:
            return Results(0, 1, 0, 0)
        waiting = len(self._history) - self._step.fields.due
        known = self._known
        return Results(frames + waiting, order + 1, known.count, known.width)

    def _keep(self, results: Results, numbers: np.ndarray) -> None:
        """Keep results for the next estimate; `numbers` are those of the frames handed over."""
        if results.count:
            due = results.of_instants('due')
            due[:] = numbers[due]
            self._results.append(results)

    def settle(self) -> None:
        """Learn from the frames of late if it is time for it; else the next `add` does."""
        if self._update_if_due():
            self._names_changed = True

    def _update_if_due(self) -> bool:
        """Learn if it is time for it; whether names stand for other markers since."""
        if self._frames >= self._next_update:
            self._names_changed |= self._update()
        changed, self._names_changed = self._names_changed, False
        return changed

    def _estimates_so_far(self) -> list[Estimate]:
        """The results so far as one estimate, if there are any, and begin with none."""
        results, self._results = self._results, []
        if not results:
            return []
        about = self._frame_id, self.bodies, self._run_number, self.plane, self._posed
        return [estimate_of(results, *about)]

    def _sort(self, frames: MarkerFrames) -> np.ndarray:
        """The markers (T, B, n, 3) of the bodies, m; hands them to the matcher in the plane."""
        solid = self._roster.sort(frames)
        if self._roster.width > self._known.width:
            self._widen()
        self._block = frames
        # The matcher corrects both in place.
        points, heights = self._roster.flat(solid)
        self._points, self._heights = np.ascontiguousarray(points), np.ascontiguousarray(heights)
        if self._posed and self._roster.plane is not None:
            self._tilts = self._roster.tilts(solid)
        self.matcher.begin(np.asarray(frames.stamps), self._points, self._heights)
        return solid

    def _widen(self) -> None:
        """A body of all markers has more of them: begin with those, as of the same frames."""
        width = self._roster.width
        self._known.widen(width)
        self._history.widen(width)
        self._pins.widen(width)
        self._space.widen(width)
        self._step.bind(self._known, self._history)
        self._early.clear()

    def _begin_again(self, stamp: int) -> None:
        """Start anew after a jump of the stamps."""
        newest = int(self._history['stamp'][-1]) if len(self._history) else stamp
        if stamp > newest:
            self._outages[''] = one_more(self._outages.get(''), newest, stamp - newest)
        self._counts['resets'] += 1
        self._start(self._timeline)

    def _take(self, stamp: int, time: int, k: int, solid: np.ndarray) -> None:
        """Fit the poses of frame `k` of those sorted last, and append them to the history."""
        bodies, history, matcher = self._known, self._history, self.matcher
        markers, interval = self._points[k], self._step.fields.interval
        newest = history['time'][-1] if len(history) else time
        goes_on = bool(interval == 0 or time - newest <= GAP * interval)
        if self._roster.plane is None:
            self._early.append((stamp, time, part_of(self._block, slice(k, k + 1))))
            if matcher.lacks_order():
                solid = np.full_like(solid, np.nan)
            self._append(stamp, time, goes_on)
            for name in ('markers', 'residual', 'angle', 'position', 'heights', 'height'):
                history[name][-1] = np.nan
            history['used'][-1] = False
            history['information'][-1] = history['turns'][-1] = 0.0
            self._space.add(solid[None])
            return
        if matcher.is_nameless and matcher.arrange(k):
            self._begin_anew(np.ones(bodies.count, bool))
        if len(bodies.unmet):
            bodies.begin(markers)
            self._step.bind(bodies, history)
        if bodies.incomplete and (bodies.incomplete_places & ~np.isnan(markers)).any():
            # New markers are learned as soon as they are seen.
            self._next_update = min(self._next_update, self._frames + 1)
        if bodies.exchanged:
            markers[...] = np.take_along_axis(markers, bodies.order, axis=1)
        row = self._append(stamp, time, goes_on)
        matcher.fits_next(k)
        unusual = self._step.fit(markers, goes_on)
        if (unusual & NAME_DOUBTFUL or matcher.has_extras) and self._renamed(k, unusual):
            unusual = self._step.fit(markers, goes_on)
        came = markers
        if unusual & ODD:
            odd = (self._step.unusual & ODD) > 0
            came = correct_frame(bodies, history, markers, odd, self._counts)
            self._step.fit(markers, False)
        if bodies.exchanged:
            # Names that stay exchanged were wrong before.
            recent = bodies.exchanged_for < MOVED_FRAMES
            moved = bodies.order[recent] != np.arange(bodies.width)
            self._counts[EXCHANGED] += int(np.count_nonzero(moved))
            bodies.exchanged_for += 1
        columns = history.columns
        columns['markers'][row] = came
        columns['heights'][row] = self._heights[k]
        columns['height'][row] = mean_heights(markers, self._heights[k])
        self._step.follow_paths()
        if self._posed:
            known = np.isfinite(columns['angle'][row])
            columns['information'][row] = known
            sure = known & (self._step.newest == 0)
            heading, tilt = columns['angle'][row], self._tilts[k]
            columns['extra_turn'][row] = self._turns.follow(heading, tilt, sure)
        self._note_outages(stamp)

    def _append(self, stamp: int, time: int, goes_on: bool) -> int:
        """Append a frame to the history; returns its row, which has no poses yet."""
        history = self._history
        if history.reserve(1):
            self._step.bind_history()
        row = history.append()
        columns = history.columns
        columns['stamp'][row], columns['time'][row] = stamp, time
        columns['goes_on'][row] = goes_on
        self._new += 1
        self._frames += 1
        return row

    def _renamed(self, k: int, unusual: int) -> bool:
        """Whether markers of the frame had wrong names, which are corrected then."""
        if not unusual & NAME_DOUBTFUL:
            unseen = np.isnan(self._points[k])
            if not unseen.any():
                return False
            fit = fit_markers(self._known, self._points[k][None])
            doubtful = self.matcher.doubtful(fit, unseen[None])
            if doubtful is None or not doubtful.any():
                return False
        # Bodies that are not rigid stay in doubt, and a search takes long.
        if self._frames < self._next_search:
            return False
        corrected = self.matcher.correct()
        self._futile = 0 if corrected else self._futile + 1
        self._next_search = self._frames + min(2 ** max(self._futile - 1, 0), MOST_BETWEEN_SEARCHES)
        return corrected

    def _note_outages(self, stamp: int) -> None:
        """Note which bodies are seen again after a window or more."""
        seen, seen_last = np.isfinite(self._history['angle'][-1]), self._step.seen_last
        lasted = np.where(seen_last >= 0, stamp - seen_last, 0)
        for b in np.flatnonzero(seen & (lasted >= self._window)).tolist():
            body, since = self.bodies[b], int(seen_last[b])
            self._outages[body] = one_more(self._outages.get(body), since, int(lasted[b]))
        seen_last[seen] = stamp

    def _begin_anew(self, which: np.ndarray) -> None:
        """Forget what was learned of the bodies `which` (B,)."""
        self._known.restart(which)
        if self.matcher.has_shape.any():
            self._known.give(np.where(which[:, None], self.matcher.given, np.nan))
        self._history['information'][:, :, which] = 0.0
        self._history['used'][:, which] = False
        self._history['markers'][:, which] = np.nan
        self._history['angle'][:, which] = np.nan
        self._pins.forget(which)
        self._step.bind(self._known, self._history)

    def _catch_up(self) -> None:
        """The plane has become known: take the frames before as they lie in it."""
        early = list(self._early)
        self._early.clear()
        due = self._step.fields.due - (len(self._history) - len(early))
        seen_last = self._step.seen_last
        self._roster.plane = self._space.plane
        assert self._roster.plane is not None
        self._begin_bodies()
        self._timeline.history = self._history
        for stamp, time, frame in early:
            self._update_if_due()
            self._take(stamp, time, 0, self._sort(frame)[0])
        self._step.fields.due = max(due, 0)
        self._step.seen_last[:] = seen_last

    def _update(self) -> bool:
        """Learn from the frames of late; whether names stand for other markers since."""
        bodies, history = self._known, self._history
        self._next_update = self._frames + max(
            1, min(int(self._frames * UPDATE_SHARE), MOST_BETWEEN_UPDATES)
        )
        if self._roster.plane is None:
            self._drop_old()
            return False
        self._count_new()
        if self._posed:
            learn_poses(bodies, history, self.settings.noise)
            bodies.extra_turn = self._turns.total
        else:
            anew = learn(bodies, history, self._window, self.settings.noise, self._counts)
            self._pins.forget(anew)
        self._pins.update(bodies, history, min(self._new, len(history)), self._posed)
        self._new = self._counted = 0
        self._drop_old()
        bodies.hub = find_hubs(bodies, history, self._window, bodies.hub)
        bodies.jump_scale = path_scale(history, bodies)
        if not self._posed:
            self._find_deformed()
        changed = False
        if self.matcher.look_is_due():
            regrouped = self.matcher.regroup(self.rigidity_residual() > 0)
            changed = bool(regrouped.any() or self.matcher.withheld.any())
            if regrouped.any():
                self._begin_anew(regrouped)
        self._step.bind(bodies, history)
        return changed

    def _find_deformed(self) -> None:
        """Find the bodies whose markers move against each other."""
        bodies, history = self._known, self._history
        rows = slice(-NOISE_FRAMES - 2, None)
        time, residual = history['time'][rows], history['residual'][rows]
        interval = float(np.median(np.diff(time))) if len(time) > 1 else self._window / 2
        free = freedom_of(bodies, residual).sum(axis=-1)
        noise = np.fmax(bodies.noise, bodies.white)
        half = round(self._window / 2 / max(interval, 1.0))
        bodies.freedom, bodies.held = deformed_freedom(residual, free, noise, bodies.degrees, half)

    def _count_new(self) -> None:
        """Count what the frames since the last update lack, and measure how they lie in space."""
        new = min(self._new - self._counted, len(self._history))
        self._counted = self._new
        if not new or self._roster.plane is None:
            return
        markers, heights = (self._history[name][-new:] for name in ('markers', 'heights'))
        seen = np.count_nonzero(~np.isnan(markers[..., 0] if self._posed else markers))
        lacking = self._roster.wanted * new - seen
        self._counts['markers_not_seen'] += int(lacking)
        if not self._posed:
            self._space.add(self._roster.plane.in_space(markers, heights))

    def _drop_old(self) -> None:
        """Drop the frames that are neither in the window nor to be learned from."""
        history, fields = self._history, self._step.fields
        oldest = len(history) - self.samples
        drop = min(oldest, len(history) - max(LEARNED_FRAMES, LEARNED_WINDOWS * self.samples))
        if drop > 0:
            history.drop(drop)
            fields.due = max(0, fields.due - drop)


def mean_heights(markers: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Mean heights (B,) of the markers (B, n) that were seen."""
    seen = ~np.isnan(markers)
    with np.errstate(invalid='ignore'):
        return np.asarray(np.where(seen, heights, 0.0).sum(axis=-1) / seen.sum(axis=-1))
