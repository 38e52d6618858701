"""
Names of markers checked against the shapes of the bodies, frame by frame.

Nothing is done while all markers fit where their names say. A frame in which they do not fit, or
whose points have no meaningful names, is matched by shape (see `identity`). The result holds for
all later messages with the same names in the same order, until its markers do not fit either.
"""

from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import Complex
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.candidates import fit_points
from kinpole_ros.tracking.grouping import group
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.identity import (
    Expected,
    Match,
    match,
    merge_names,
    predict_poses,
    unpredicted,
)
from kinpole_ros.tracking.placed_frames import PlacedFrames, count_misnamed
from kinpole_ros.tracking.placing import MarkerAssignment
from kinpole_ros.tracking.thresholds import (
    CONFIRMING_FRAMES,
    MEMORY_FRAMES,
    MIN_SAMPLES,
    N_SIGMA,
    NEGLIGIBLE,
)

# What is counted in `Tracker.update_counts`.
REGROUPED, BY_SHAPE, UNCERTAIN = 'markers_regrouped', 'frames_by_shape', 'bodies_ambiguous'
# If the parameters name points 0 to n - 1, a cloud of exactly n points counts as so many clouds of
# another size, while the usual size is learned.
_EXACT_SIZE_WEIGHT = 4
# Corrections that are listed by name at most.
_MOST_NOTES = 12


class GivenShapes(NamedTuple):
    """
    What the parameters say of B bodies of n markers.

    `shapes` (B, n), complex, m, are the places of the markers, NaN for none, and `has_shape` (B,)
    says for which bodies there are any. `pins` (B, 2) are those of `Expected`, None for none.
    `by_shape` is whether names mean nothing.
    """

    names: tuple[str, ...]
    shapes: Complex
    has_shape: np.ndarray
    pins: Complex | None
    by_shape: bool


def given_shapes(settings: Settings, width: int) -> GivenShapes:
    """Return what the parameters say of the bodies, which have so many slots."""
    names = tuple(settings.bodies)
    shapes = np.full((len(names), width), complex(np.nan, np.nan))
    for b, name in enumerate(names):
        shape = settings.shapes.get(name, ())
        shapes[b, : len(shape)] = shape
    pins = [settings.pins.get(name, (np.nan, np.nan)) for name in names]
    has_shape = ~np.isnan(shapes).all(axis=1)
    on_ground = np.array(pins, complex) if settings.pins else None
    return GivenShapes(names, shapes, has_shape, on_ground, settings.marker_identity == 'shape')


class KnownNames(NamedTuple):
    """
    What is learned of the names of markers since a start.

    `regrouped` and `full_count` are those of `Matcher`; None for a count that may still change.
    """

    assignment: MarkerAssignment
    regrouped: list[tuple[str, str, str]]
    full_count: int | None


class Matcher:
    """
    Matches the points of frames to the bodies of `settings`.

    Attributes
    ----------
    given : GivenShapes
        What the parameters say.
    bodies : Bodies
        What is known now, put in by `put_bodies` of state.py.
    notes : Counter of str
        Corrected names, and how often each correction began.
    regrouped : list of (str, str, str)
        Mistakes of the parameters: a marker, the body it is listed for, the body it moves with.
    full_count : int
        Number of points of a complete cloud without names, 0 while not known.

    """

    def __init__(
        self, settings: Settings, assignment: MarkerAssignment, bodies: Bodies, history: History
    ) -> None:
        self._assignment, self._history = assignment, history
        self.given = given_shapes(settings, bodies.width)
        self.bodies = bodies.give(self.given.shapes) if self.given.has_shape.any() else bodies
        self.notes: Counter[str] = Counter()
        self.regrouped: list[tuple[str, str, str]] = []
        self.full_count = 0
        # How many of the first clouds without names had which number of points.
        self._cloud_sizes: Counter[int] = Counter()
        self._disordered_frames = 0
        # Frames without names so far, up to MIN_SAMPLES, and in how many each body was found.
        self._arranged = 0
        self._times_found = np.zeros(bodies.count, int)
        self._next_regrouping, self._regroupings = MIN_SAMPLES, 0
        # Residual variances, m^2, of the recent best fits by `match`, right or wrong.
        self._variances: deque[float] = deque(maxlen=MEMORY_FRAMES)

    @property
    def withheld(self) -> np.ndarray:
        """Bodies (B,) of which nothing is published, since their markers are not known."""
        return self._assignment.withheld

    @property
    def disordered(self) -> bool:
        """Whether points came in random order before the shapes were known."""
        return self._disordered_frames >= CONFIRMING_FRAMES

    def known_names(self) -> KnownNames:
        """Return what is learned of names."""
        is_learned = self._arranged >= MIN_SAMPLES
        full_count = self.full_count if is_learned else None
        return KnownNames(self._assignment, self.regrouped, full_count)

    def take_names(self, known: KnownNames) -> None:
        """Take what another matcher learned of names, before the first frame."""
        self._assignment.take_names(known.assignment)
        self.regrouped = known.regrouped
        if known.full_count is not None:
            self.full_count, self._arranged = known.full_count, MIN_SAMPLES

    def is_incomplete_cloud(self, placed: PlacedFrames) -> bool:
        """
        Return whether the last frames are a cloud without names of an unusual size.

        Such a frame cannot be matched by shape while the plane is not known. The usual size is
        learned from these calls.
        """
        if not placed.is_nameless:
            return False
        self._update_full_count(placed)
        return placed.size != self.full_count

    def arrange(self, placed: PlacedFrames, k: int, counts: Counter[str]) -> tuple[bool, bool]:
        """
        Match frame `k` by shape if names mean nothing.

        Returns whether all bodies have to start again, since earlier frames were assigned wrongly,
        and whether the frame was matched.
        """
        if not placed.is_nameless:
            return False, False
        restarts = False
        if self._arranged < MIN_SAMPLES:
            has_changed = self._update_full_count(placed)
            restarts = has_changed and not self.given.has_shape.all()
            self._arranged += 1
            if self._arranged == MIN_SAMPLES and not self.given.by_shape:
                self._assignment.ordered_size = self.full_count
        is_full = placed.size == self.full_count
        if is_full and not self.given.by_shape:
            return restarts, False
        was_in_order = not self.disordered
        ambiguous = self._arrange_by_shape(placed, k, is_full, restarts)
        counts.update({BY_SHAPE: 1, UNCERTAIN: ambiguous})
        # Frames before the disorder was noticed did not show the bodies they were taken for.
        return restarts or (was_in_order and self.disordered), True

    def is_doubtful(self, placed: PlacedFrames, k: int, fit: Fit, hidden: np.ndarray) -> bool:
        """
        Return whether frame `k` has an unassigned point that may be one of the hidden markers.

        Parameters
        ----------
        placed, k : PlacedFrames, int
            The frames, and which of them.
        fit : Fit
            Poses of the bodies in the frame, of shape (B,).
        hidden : (B, n) bool
            Markers that were not seen.

        """
        unassigned = self._assignment.layout_of(placed).unassigned
        if not len(unassigned):
            return False
        points = self._assignment.project_all(placed, k)[0][unassigned]
        points = points[~np.isnan(points)]
        if not len(points):
            return False
        shapes, limit = self.bodies.placement.places, self.bodies.fitting.limit
        predicted = fit.position[:, None] + np.exp(1j * fit.angle)[:, None] * shapes
        predicted = np.where(hidden, predicted, np.nan)
        if (np.abs(predicted[..., None] - points) <= limit[:, None, None]).any():
            return True
        # A body without a pose is doubtful if it and the unassigned points have enough markers.
        lost = np.isnan(fit.angle) & (self.bodies.placement.learned_count >= 2) & ~self.withheld
        return bool((lost & (len(points) + (~hidden).sum(axis=1) >= 2)).any())

    def correct_names(self, placed: PlacedFrames, k: int, counts: Counter[str]) -> bool:
        """Correct the names from frame `k` on; return whether any was wrong."""
        # One body that has all points, and poses, cannot be confused.
        layout, frames = self._assignment.layout_of(placed), len(placed.frames.stamps) - k
        is_alone = len(self.given.names) == 1 and not len(layout.unassigned)
        if self.given.by_shape or is_alone or self.bodies.are_measured:
            return False
        points, _ = self._assignment.project_all(placed, k)
        assigned = np.where(layout.rows < len(points), layout.rows, -1)
        hidden = (assigned >= 0) & np.isnan(np.append(points, np.nan)[assigned])
        named = np.where(hidden, -1, assigned)
        named[self.withheld] = -1
        fits = self._fits_by_name(points, named, self.bodies.placement.places)
        rows = merge_names(self._match(placed, k, points, named, fits), named)
        if rows is None:
            return False
        count_misnamed(counts, layout, -frames)
        # A hidden marker that found no other point keeps its name.
        rows = np.where(hidden & (rows < 0), assigned, rows)
        self._assignment.correct_names(placed, rows, not placed.is_nameless)
        count_misnamed(counts, self._assignment.layout_of(placed), frames)
        self._note_corrections(placed)
        self._assignment.assign_again(placed, k)
        return True

    @property
    def _frames(self) -> int:
        """Number of frames so far, with those dropped from the history."""
        return self._history.dropped + len(self._history)

    def regrouping_is_due(self) -> bool:
        """Return whether it is time to check which markers move as one body."""
        return self._frames >= self._next_regrouping

    def regroup(self, loose: np.ndarray, counts: Counter[str]) -> np.ndarray:
        """
        Exchange markers of bodies permanently where that makes them rigid.

        Parameters
        ----------
        loose : (B,) bool
            Bodies that are not rigid.
        counts : Counter
            The number of exchanged markers, updated.

        Returns
        -------
        (B,) bool
            Bodies that have to begin again.

        """
        self._next_regrouping = self._frames + min(self._frames // 2, MEMORY_FRAMES)
        loose = loose & ~self.given.has_shape & ~self.withheld
        tried_enough = self._regroupings > 2 * len(loose)
        if loose.sum() < 2 or tried_enough or self.given.by_shape or not len(self._history):
            return np.zeros(len(loose), bool)
        order, confused = group(self._history['markers'][-MEMORY_FRAMES:], loose)
        if confused:
            self._assignment.withhold(np.isin(np.arange(len(loose)), confused))
        if order is None:
            return np.zeros(len(loose), bool)
        self._regroupings += 1
        moved = order != np.arange(order.size).reshape(order.shape)
        for b, slot in zip(*np.nonzero(moved), strict=True):
            c, k = divmod(int(order[b, slot]), order.shape[1])
            marker = self._assignment.markers[c][k]
            self.regrouped.append((marker, self.given.names[c], self.given.names[b]))
            counts[REGROUPED] += 1
        self._assignment.permute(order)
        return np.asarray(moved.any(axis=1))

    def wrong_shapes(self, placed: PlacedFrames | None = None) -> dict[str, str]:
        """
        Return bodies whose given shape was not seen: 'mirrored', 'other' or 'nowhere'.

        `placed` are the last frames.
        """
        found = {}
        for b in np.flatnonzero(self.given.has_shape & ~self.withheld).tolist():
            given, learned, name = self.given.shapes[b], self.bodies.shape[b], self.given.names[b]
            markers = given[~np.isnan(given)]
            size = np.abs(markers - markers.mean()).max()
            limit = max(
                N_SIGMA * float(np.nan_to_num(self.bodies.fitting.limit[b])), NEGLIGIBLE * size
            )
            indices = np.where(np.isnan(given), -1, np.arange(len(given)))
            if not fit_points(learned, np.nan_to_num(given), indices)[2] <= limit:
                mirrored = fit_points(learned, np.nan_to_num(given.conj()), indices)[2] <= limit
                found[name] = 'mirrored' if mirrored else 'other'
            elif self.given.by_shape and self._frames >= MIN_SAMPLES and not self._times_found[b]:
                found[name] = 'mirrored' if self._fits_mirrored(placed, b) else 'nowhere'
        return found

    def _note_corrections(self, placed: PlacedFrames) -> None:
        """Remember which markers were corrected."""
        layout, names = self._assignment.layout_of(placed), placed.identities
        if placed.is_nameless:
            return
        corrected = (layout.rows != layout.named_rows) & (layout.rows < len(names))
        for b, k in zip(*np.nonzero(corrected), strict=True):
            marker = f'{self._assignment.markers[b][k]!r} of {self.given.names[b]}'
            note = f'{names[layout.rows[b, k]]!r} is {marker}'
            if note in self.notes or len(self.notes) < _MOST_NOTES:
                self.notes[note] += 1

    def _update_full_count(self, placed: PlacedFrames) -> bool:
        """Count the points of a cloud; return whether the full count, known before, changed."""
        size = placed.size
        self._cloud_sizes[size] += 1
        numbers = [int(n) for names in self._assignment.markers for n in names if n.isdecimal()]
        named = max(numbers, default=-1) + 1
        # A cloud of exactly the named points is probably complete.
        score = {
            n: times * (_EXACT_SIZE_WEIGHT if n == named else 1)
            for n, times in self._cloud_sizes.items()
            if n >= named
        }
        before, self.full_count = self.full_count, max(score, key=lambda n: score[n], default=0)
        return before not in (0, self.full_count)

    def _arrange_by_shape(self, placed: PlacedFrames, k: int, is_full: bool, restarts: bool) -> int:
        """
        Assign the points of a frame by shape; to bodies without one by name, if it is full.

        Returns how many bodies fit in several ways.
        """
        points, heights = self._assignment.project_all(placed, k)
        # Learned shapes are void after a restart.
        shapes = self.given.shapes if restarts else self.bodies.placement.places
        has_shape = (~np.isnan(shapes)).sum(axis=1) >= 2
        rows = self._assignment.layout_of(placed).rows
        named = np.where(rows < len(points), rows, -1)
        # While it is not known whether the order is stable, the names are tried first.
        learns_order = is_full and self._arranged < MIN_SAMPLES and not self.disordered
        names = np.where(self.given.has_shape[:, None] | (not learns_order), -1, named)
        fits = np.zeros(len(has_shape), bool)
        if learns_order:
            fits = self._fits_by_name(points, names, shapes)
        found = self._match(placed, k, points, names, fits, shapes)
        rows = np.where(has_shape[:, None], found.indices, named if is_full else -1)
        if is_full:
            as_named = ((rows == named) | np.isnan(shapes)).all(axis=1)
            rows = np.where(as_named[:, None], named, rows)
            self._check_order(as_named | self.given.has_shape | ~has_shape)
        rows[self.withheld] = -1
        placed.points[k] = np.where(rows >= 0, np.append(points, np.nan)[rows], np.nan)
        placed.heights[k] = np.where(rows >= 0, np.append(heights, np.nan)[rows], np.nan)
        self._times_found += np.isfinite(found.turn)
        return int((found.uncertain & ~self.withheld).sum())

    def _fits_by_name(self, points: Complex, named: np.ndarray, shapes: Complex) -> np.ndarray:
        """Which bodies (B,) fit their shapes with all markers where they are `named`."""
        named = np.where(np.isnan(shapes), -1, named)
        _, turn, worst = fit_points(points, np.where(np.isnan(shapes), 0, shapes), named)
        enough = (named >= 0).sum(axis=1) >= 2
        return np.asarray(enough & np.isfinite(turn) & (worst <= self.bodies.fitting.limit))

    def _check_order(self, in_order: np.ndarray) -> None:
        """Withhold bodies if points come in random order; `in_order` (B,) is of one frame."""
        if self.given.by_shape and self._arranged < MIN_SAMPLES and not in_order.all():
            self._disordered_frames += 1
            if self.disordered:
                self._assignment.withhold(~self.given.has_shape)

    def _match(
        self,
        placed: PlacedFrames,
        k: int,
        points: Complex,
        named: np.ndarray,
        fits: np.ndarray,
        shapes: Complex | None = None,
    ) -> Match:
        """Match the points of a frame by shape, and by the predicted poses."""
        shapes = self.bodies.placement.places if shapes is None else shapes
        if self.withheld.any():
            shapes = np.where(self.withheld[:, None], np.nan, shapes)
        # Most best fits are right, so their median variance is that of the noise.
        variance = np.inf
        if len(self._variances) >= MIN_SAMPLES:
            variance = float(np.median(self._variances))
        stamp = placed.frames.stamps[k]
        predicted = predict_poses(*self._history.poses_before(stamp, 2 * MIN_SAMPLES))
        expected = Expected(predicted, named, fits, variance, pins=self.given.pins)
        found = match(points, shapes, self.bodies.fitting.limit, expected)
        self._variances.extend(found.variance[np.isfinite(found.variance)].tolist())
        return found

    def _fits_mirrored(self, placed: PlacedFrames | None, b: int) -> bool:
        """Whether the points of the last frame have a body's given shape mirrored."""
        assert placed is not None
        points, _ = self._assignment.project_all(placed, -1)
        shapes = self.given.shapes[b : b + 1].conj()
        expected = Expected(unpredicted(1), np.full(shapes.shape, -1), np.zeros(1, bool))
        found = match(points, shapes, self.bodies.fitting.limit[b : b + 1], expected)
        return bool(np.isfinite(found.turn[0]) or found.uncertain[0])
