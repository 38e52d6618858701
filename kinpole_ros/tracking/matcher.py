"""
Names of markers held against the shapes of the bodies, frame by frame.

As long as all markers fit where their names say, nothing is done. A frame in which they do not, or
whose points have no names that mean anything, is matched by shape (see `identity`). What was found
goes on for all messages of that layout until it does not fit in its turn.
"""

from collections import Counter, deque

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.ahead import ahead
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.grouping import group
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.identity import Expected, Match, fit_place, match, merge_names
from kinpole_ros.tracking.levels import FEW, KEPT, LITTLE, RECENT, RUNNING, SURE
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.roster import Layout, Roster

# Counted in `Tracker.counts`.
OTHERS, RENAMED, REGROUPED = 'markers_of_others', 'markers_renamed', 'markers_regrouped'
BY_SHAPE, UNCERTAIN = 'frames_by_shape', 'bodies_ambiguous'
# A number of points that is just those named counts so many times.
_ALL_NAMED = 4
# Corrections that are remembered by name.
_MOST_NOTES = 12


class Matcher:
    """
    Matches the points of frames to the bodies of `settings`, as `roster` has sorted them.

    What it does is added to `counts`; `notes` says of which markers, and how often it set in.
    """

    def __init__(
        self,
        settings: Settings,
        roster: Roster,
        shapes: Bodies,
        history: History,
        counts: Counter[str],
    ) -> None:
        bodies, width = shapes.shape.shape
        self._history = history
        self.notes: Counter[str] = Counter()
        # What the parameters have wrong: marker, the body it is named for, and its own.
        self.regrouped: list[tuple[str, str, str]] = []
        # Bodies (B,) of which nothing is published, since their markers are not theirs.
        self.withheld = np.zeros(bodies, bool)
        self._withholds = False
        # Whether points come in any order before a shape is known.
        self.disordered = False
        self._names = tuple(settings.bodies)
        self._roster, self._shapes, self._counts = roster, shapes, counts
        self._by_shape = settings.marker_identity == 'shape'
        # A body of all markers takes whatever comes for one more.
        self._may_be_nameless = (
            settings.marker_identity in ('auto', 'index', 'shape') and not roster.all_markers
        )
        self.given = np.full((bodies, width), complex(np.nan, np.nan))
        for b, name in enumerate(self._names):
            shape = settings.shapes.get(name, ())
            self.given[b, : len(shape)] = shape
        pins = [settings.pins.get(name, (np.nan, np.nan)) for name in self._names]
        self._pins = np.array(pins, complex) if settings.pins else None
        self.has_shape = ~np.isnan(self.given).all(axis=1)
        if self.has_shape.any():
            shapes.give(self.given)
        # How many points a cloud without names has when it is whole, and how often it had how many.
        self._whole = 0
        self._sizes: Counter[int] = Counter()
        self._out_of_order = 0
        # Frames that were arranged by shape, and in which each body was found.
        self._arranged = 0
        self.found = np.zeros(bodies, int)
        self._next_look, self._groupings = FEW, 0
        # Variances (m^2) of the ways that fit best, of bodies that were searched for of late.
        self._variances: deque[float] = deque(maxlen=KEPT)
        self._frame = 0
        self._matched_here = False

    @property
    def whole(self) -> int:
        """How many points a cloud without names has when it is whole, 0 while not known."""
        return self._whole

    @property
    def is_nameless(self) -> bool:
        """Whether the names of the last frames may mean nothing."""
        return self._nameless

    @property
    def in_order(self) -> bool:
        """Whether the markers of the last frames are as their names say, for all one knows."""
        whole = len(self._roster.identities) == self._whole
        return not self._nameless or (whole and not self._by_shape and self._arranged >= FEW)

    @property
    def has_extras(self) -> bool:
        """Whether the last frames have points that are no markers."""
        return len(self._layout.extras) > 0 and not self._by_shape

    def begin(self, stamps: np.ndarray, points: Complex, heights: Real) -> None:
        """Frames come, sorted by names: `points` and `heights` (T, B, n), corrected in place."""
        self._stamps, self._points, self._heights = stamps, points, heights
        if not self._layout.indexed and not self._by_shape:
            self._may_be_nameless = False
        self._nameless = self._may_be_nameless and self._layout.indexed
        self._count(0, 1)
        if self._withholds:
            points[:, self.withheld] = np.nan

    def lacks_order(self) -> bool:
        """
        Whether a frame of those sorted last has points without names, more or fewer than usual.

        While the plane is not known they cannot be matched by shape. How many there are is learned.
        """
        if not (self._may_be_nameless and self._layout.indexed):
            return False
        self._is_whole_anew()
        return len(self._roster.identities) != self._whole

    def arrange(self, k: int) -> bool:
        """
        Match frame `k` by shape, where names mean nothing.

        Returns whether all bodies have to begin anew, since frames were not as they seemed.
        """
        self._matched_here = False
        self._roster.in_order = True
        if not self._nameless:
            return False
        anew = False
        if self._arranged < FEW:
            anew = self._is_whole_anew() and not self.has_shape.all()
            self._arranged += 1
        whole = len(self._roster.identities) == self._whole
        self._roster.in_order = whole and not self._by_shape
        if self._roster.in_order:
            return anew
        in_order = not self.disordered
        self._match_by_shape(k, whole, anew)
        self._counts[BY_SHAPE] += 1
        self._matched_here = True
        # What was seen before it was known to be in any order was of no body.
        return anew or (in_order and self.disordered)

    def fits_next(self, k: int) -> None:
        """Frame `k` of those sorted last is fitted next."""
        self._frame = k

    def sort_again(self, first: int) -> None:
        """Sort the frames from `first` on anew, since names stand for others."""
        points, heights = self._roster.flat(self._roster.sorted(first))
        self._points[first:], self._heights[first:] = points, heights
        if self.withheld.any():
            self._points[first:, self.withheld] = np.nan

    def doubtful(self, fit: Fit, unseen: np.ndarray) -> np.ndarray | None:
        """Which frames (T,) have points without a marker where one is `unseen` (T, B, n)."""
        if not len(self._layout.extras) or self._by_shape or self._matched_here:
            return None
        extras = self._roster.extras(self._frame, 1)
        some = ~np.isnan(extras)
        if not some.any():
            return None
        shapes, limit = self._shapes.markers(), self._shapes.limit
        there = fit.position[..., None] + np.exp(1j * fit.angle)[..., None] * shapes
        there = np.where(unseen, there, np.nan)
        near = np.zeros(len(unseen), bool)
        for e in range(extras.shape[1]):
            off = np.abs(there - extras[:, e, None, None])
            near |= (off <= limit[:, None]).any(axis=(1, 2))
        lost = np.isnan(fit.angle) & (self._shapes.known >= 2) & ~self.withheld
        enough = some.sum(axis=1)[:, None] + (~unseen).sum(axis=2) >= 2
        return np.asarray(near | ((lost & enough).any(axis=1) & some.any(axis=1)))

    def correct(self) -> bool:
        """Correct the names in a frame, and in those that follow; whether anything was."""
        alone = len(self._names) == 1 and not len(self._layout.extras)
        if self._by_shape or self._matched_here or alone or self._roster.posed:
            return False
        k, layout = self._frame, self._layout
        points, _ = self._roster.all_points(k)
        kept = np.where(layout.place < len(points), layout.place, -1)
        hidden = (kept >= 0) & np.isnan(np.append(points, np.nan)[kept])
        named = np.where(hidden, -1, kept)
        named[self.withheld] = -1
        held = self._fits_by_name(points, named, self._shapes.markers())
        found = self._match(k, points, named, held)
        place = merge_names(found, named)
        if place is None:
            return False
        self._count(k, -1)
        # What is hidden just now keeps its name.
        place = np.where(hidden & (place < 0), kept, place)
        self._roster.correct(place, not self._nameless)
        self._count(k, 1)
        self._note()
        self.sort_again(k)
        return True

    @property
    def _frames(self) -> int:
        """How many frames there were."""
        return self._history.dropped + len(self._history)

    def look_is_due(self) -> bool:
        """Whether it is time to see which markers bodies that are not rigid are made of."""
        return self._frames >= self._next_look

    def regroup(self, loose: np.ndarray) -> np.ndarray:
        """
        Exchange markers for good where that makes `loose` (B,) bodies rigid, at a beat.

        Returns which bodies (B,) begin anew.
        """
        nothing = np.zeros(len(loose), bool)
        self._next_look = self._frames + min(self._frames // 2, KEPT)
        loose = loose & ~self.has_shape & ~self.withheld
        if (
            loose.sum() < 2
            or self._groupings > 2 * len(loose)
            or self._by_shape
            or not len(self._history)
        ):
            return nothing
        order, confused = group(self._history['markers'][-KEPT:], loose)
        self.withheld[confused] = True
        self._withholds = bool(self.withheld.any())
        if order is None:
            return nothing
        self._groupings += 1
        own = np.arange(order.size).reshape(order.shape)
        for b, slot in zip(*np.nonzero(order != own), strict=True):
            c, other = divmod(int(order[b, slot]), order.shape[1])
            self.regrouped.append((self._roster.markers[c][other], self._names[c], self._names[b]))
            self._counts[REGROUPED] += 1
        self._roster.permute(order)
        return np.asarray((order != own).any(axis=1))

    def differ(self) -> dict[str, str]:
        """Bodies whose given shape is not what was seen: 'mirrored', 'other' or 'nowhere'."""
        found = {}
        for b in np.flatnonzero(self.has_shape & ~self.withheld).tolist():
            given, now = self.given[b], self._shapes.shape[b]
            here = np.flatnonzero(~np.isnan(given))
            size = np.abs(given[here] - given[here].mean()).max()
            most = max(SURE * float(np.nan_to_num(self._shapes.limit[b])), LITTLE * size)
            off = fit_place(now, np.nan_to_num(given), np.where(np.isnan(given), -1, _row(given)))
            mirror = np.nan_to_num(given.conj())
            if not off[2] <= most:
                turned = fit_place(now, mirror, np.where(np.isnan(given), -1, _row(given)))
                found[self._names[b]] = 'mirrored' if turned[2] <= most else 'other'
            elif self._by_shape and self._frames >= FEW and not self.found[b]:
                found[self._names[b]] = 'mirrored' if self._fits_mirrored(b) else 'nowhere'
        return found

    @property
    def _layout(self) -> Layout:
        layout = self._roster.layout
        assert layout is not None
        return layout

    def _count(self, first: int, sign: int) -> None:
        """Count what is corrected in the frames from `first` on, or take it back."""
        frames = sign * (len(self._stamps) - first)
        if self._layout.others:
            self._counts[OTHERS] += frames * self._layout.others
        if self._layout.renamed:
            self._counts[RENAMED] += frames * self._layout.renamed

    def _note(self) -> None:
        """Remember which markers were corrected."""
        layout, names = self._layout, self._roster.identities
        other = (layout.place != layout.named) & (layout.place < len(names))
        if self._nameless:
            return
        for b, k in zip(*np.nonzero(other), strict=True):
            text = f'{names[layout.place[b, k]]!r} is {self._roster.markers[b][k]!r}'
            if text in self.notes or len(self.notes) < _MOST_NOTES:
                self.notes[f'{text} of {self._names[b]}'] += 1

    def _is_whole_anew(self) -> bool:
        """Count the points of a frame among the first; whether another number of them is whole."""
        size = len(self._roster.identities)
        self._sizes[size] += 1
        named = [int(name) for some in self._roster.markers for name in some if name.isdecimal()]
        least = max(named, default=-1) + 1
        # As many as are named are all there are, if they ever are: what else there is, always is.
        score = {
            n: times * (_ALL_NAMED if n == least else 1)
            for n, times in self._sizes.items()
            if n >= least
        }
        best = max(score, key=lambda n: score[n], default=0)
        before, self._whole = self._whole, best
        return before not in (0, best)

    def _match_by_shape(self, k: int, whole: bool, anew: bool) -> None:
        """Sort the points of a frame by shape; bodies that are not known yet by place, if whole."""
        points, heights = self._roster.all_points(k)
        shapes = self._shapes.markers()
        if anew:
            shapes = self.given
        known = (~np.isnan(shapes)).sum(axis=1) >= 2
        nowhere = len(points)
        named = np.where(self._layout.place < nowhere, self._layout.place, -1)
        # Where the order is to be learned from, it goes first.
        learning = whole and self._arranged < FEW and not self.disordered
        names = np.where(self.has_shape[:, None] | (not learning), -1, named)
        held = np.zeros(len(known), bool)
        if learning:
            held = self._fits_by_name(points, names, shapes)
        found = self._match(k, points, names, held, shapes)
        place = np.where(known[:, None], found.place, named if whole else -1)
        if whole:
            same = ((place == named) | np.isnan(shapes)).all(axis=1)
            place = np.where(same[:, None], named, place)
            self._see_order(same | self.has_shape | ~known)
        place[self.withheld] = -1
        seen = place >= 0
        self._points[k] = np.where(seen, np.append(points, np.nan)[place], np.nan)
        self._heights[k] = np.where(seen, np.append(heights, np.nan)[place], np.nan)
        self.found += np.isfinite(found.turn)
        self._counts[UNCERTAIN] += int((found.uncertain & ~self.withheld).sum())

    def _fits_by_name(self, points: Complex, named: np.ndarray, shapes: Complex) -> np.ndarray:
        """Which bodies (B,) fit their shapes with all markers where they are `named`."""
        named = np.where(np.isnan(shapes), -1, named)
        _, turn, off = fit_place(points, np.where(np.isnan(shapes), 0, shapes), named)
        enough = (named >= 0).sum(axis=1) >= 2
        return np.asarray(enough & np.isfinite(turn) & (off <= self._shapes.limit))

    def _see_order(self, same: np.ndarray) -> None:
        """Note a frame among the first in which bodies (B,) do not keep their order."""
        if self._by_shape and self._arranged < FEW and not same.all():
            self._out_of_order += 1
            if self._out_of_order >= RUNNING:
                self.disordered = True
                self.withheld |= ~self.has_shape
                self._withholds = True

    def _match(
        self,
        k: int,
        points: Complex,
        named: np.ndarray,
        held: np.ndarray,
        shapes: Complex | None = None,
    ) -> Match:
        """Match the points of a frame by shape, and by where the bodies are to be expected."""
        shapes = self._shapes.markers() if shapes is None else shapes
        if self.withheld.any():
            shapes = np.where(self.withheld[:, None], np.nan, shapes)
        position, turn = self._ahead(k)
        # Whichever way is right, most of the best ones err by no more than the noise.
        few = len(self._variances) < FEW
        variance = np.inf if few else float(np.median(self._variances))
        expected = Expected(position, turn, named, held, variance, self._pins)
        found = match(points, shapes, self._shapes.limit, expected)
        self._variances.extend(found.variance[np.isfinite(found.variance)].tolist())
        return found

    def _ahead(self, k: int) -> tuple[Complex, Complex]:
        """Where bodies (B,) are to be expected in a frame, by their last velocity."""
        # Without the newest row, which is of this frame where it was appended already.
        count = len(self._history)
        if count and self._history['stamp'][-1] == self._stamps[k]:
            count -= 1
        rows = slice(max(count - RECENT, 0), count)
        track = tuple(self._history[name][rows] for name in ('stamp', 'position', 'angle'))
        return ahead([track] if count else [], int(self._stamps[k]), len(self._names))

    def _fits_mirrored(self, b: int) -> bool:
        """Whether the points of the last frame have a body's given shape mirrored."""
        points, _ = self._roster.all_points(-1)
        shapes = self.given[b : b + 1].conj()
        nowhere = np.full(1, complex(np.nan, np.nan))
        named = np.full(shapes.shape, -1)
        limit = self._shapes.limit[b : b + 1]
        found = match(points, shapes, limit, Expected(nowhere, nowhere, named, np.zeros(1, bool)))
        return bool(np.isfinite(found.turn[0]) or found.uncertain[0])


def _row(given: Complex) -> np.ndarray:
    return np.arange(len(given))
