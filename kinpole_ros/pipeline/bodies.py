"""
Where the bodies are in each frame, and what is learned of them on the way.

Poses are fitted to shapes that are learned from the frames before, as are noise, pins and reference
points. They are learned at beats only, which are counted in frames: what comes between two beats is
fitted at once, with the same outcome as one by one.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from kinpole_ros.pipeline.matcher import Matcher
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.roster import Roster
from kinpole_ros.planar import Fit
from kinpole_ros.rigid import (
    LENS,
    SLANT,
    TISSUE,
    Deformation,
    Fields,
    LastingNoise,
    Noise,
    Pins,
    References,
    Samples,
    Shapes,
    Verdict,
)
from kinpole_ros.rigid.levels import FEWEST, LITTLE, ROUNDING, SURE, TINY

# rad. An angle noisier than this wanders round, and its errors are no longer small.
UNSTEADY = 0.15
# Those that are off by this share of its size are of other links: no tissue moves so far.
_OTHERS = 0.05


class News(NamedTuple):
    """Frames that were taken since the last beat: fits, and what is left of them, (T, ...)."""

    stamps: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    information: np.ndarray  # (T, 2 B)
    residual: np.ndarray
    freedom: np.ndarray
    gaps: np.ndarray


class Outage(NamedTuple):
    """How often nothing came for a window or more; the latest and the longest, from when, ns."""

    times: int
    latest: tuple[int, int]
    longest: tuple[int, int]


def one_more(outage: Outage | None, since: int, lasted: int) -> Outage:
    """These, if any, and one that `lasted` so long since then, ns."""
    new = since, lasted
    if outage is None:
        return Outage(1, new, new)
    longest = max(outage.longest, new, key=lambda each: each[1])
    return Outage(outage.times + 1, new, longest)


def pose_columns(bodies: int) -> list[tuple]:
    """What `RigidBodies.take` fills of a frame; angles come before positions."""
    return [
        # Which row of `RigidBodies.known` was known then.
        ('beat', np.int64),
        # Angles with whole turns, as what comes between -pi and pi goes on, and positions.
        ('poses', float, (2 * bodies, 2)),
        # Inverse variances over that of a coordinate of a marker, 0 for a body not seen.
        ('information', float, (2 * bodies,)),
        # The mean of the markers seen, in the frame of the body.
        ('middle', complex, (bodies,)),
        ('height', float, (bodies,)),
        # Of poses that come as such: `Roster.tilts`, and `PosedBodies.extra_turn` of the frame.
        ('tilt', complex, (bodies,)),
        ('extra_turn', float, (bodies,)),
        ('off_pin', bool, (bodies,)),
        # How many of the newest frames, with this one, may be wrong of a body: not to be relied on
        # until the next.
        ('suspect', np.int64, (bodies,)),
    ]


def _known_type(bodies: int, width: int) -> np.dtype:
    """What is known of the bodies from one beat to the next, in one row."""
    columns: list[tuple] = [
        ('noise', float, (bodies,)),
        ('measured', bool, (bodies,)),
        # As of `Deformation`.
        ('deformed', float, (bodies,)),
        ('held', float, (bodies,)),
        ('deformed_since', np.int64, (bodies,)),
        ('orientation_observable', bool, (bodies,)),
        ('size', float, (bodies,)),
        # What information is to be multiplied by, 1 but where poses come as such.
        ('scale', float, (2 * bodies,)),
        ('pin', complex, (bodies,)),
        ('pin_variance', float, (bodies,)),
        ('pin_since', np.int64, (bodies,)),
        # ns: poses from before are not of this shape. 0 unless the body began anew.
        ('since', np.int64, (bodies,)),
        ('reference', complex, (bodies,)),
        ('middle', complex, (bodies,)),
        # The `extra_turn` of the newest frame that this was learned from.
        ('extra_turn', float, (bodies,)),
        ('shape', complex, (bodies, width)),
    ]
    return np.dtype(columns, align=True)


class RigidBodies:
    """
    B bodies of up to `width` markers each, as learned from their frames.

    `window`, ns, is as long as the estimates'; `roster` sorts the frames. What is corrected in
    frames is added to `counts`; `matcher` holds the names of markers against the shapes.
    """

    def __init__(
        self, settings: Settings, window: int, roster: Roster, counts: Counter[str]
    ) -> None:
        width = roster.width
        self._count = len(settings.bodies)
        self._given = settings.noise
        self._by_pose = settings.method == 'pose'
        self._counts = counts
        self._shapes = Shapes(self._count, width)
        self.matcher = Matcher(settings, roster, self._shapes, counts)
        self._noise = Noise(self._count)
        self._lasting = LastingNoise(self._count, window)
        self.deformation = Deformation(self._count, width, window)
        self._fields = Fields()
        self._pins = Pins(self._count, width)
        self._references = References(self._count, window)
        self._since = np.zeros(self._count, np.int64)
        self._newest = 0
        # In how many frames each body as a whole was wrong, and when it was not seen.
        self.wrong = np.zeros(self._count, int)
        self.outages: dict[int, Outage] = {}
        self._window = window
        # ns, -1 before a body is seen.
        self._seen_last = np.full(self._count, -1, np.int64)
        # Frames since the last beat.
        self._news: list[News] = []
        self._new = 0
        # What was known with the frames that wait to be estimated, now in the last row unless
        # something was learned since.
        self._known = Samples((), _known_type(self._count, width))
        self._learned = True

    @property
    def width(self) -> int:
        """How many markers a body may have."""
        return self._shapes.points.shape[1]

    @property
    def known(self) -> np.ndarray:
        """What was known at the beats of late, a row for each, up to `forget`."""
        return self._known.view()

    def forget(self) -> None:
        """Forget what was known before now."""
        self._known.drop(len(self._known) - 1)

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        if self._given > 0:
            level = np.full(self._count, self._given)
        else:
            level = self._lasting.level(self._noise.level())
            # While hardly any frames come running, by all that keeps markers off their places.
            few = self._noise.degrees() < FEWEST
            level = np.where(few, np.sqrt(self._shapes.misfit()), level)
        return np.maximum(level, ROUNDING * self._shapes.farthest)

    def angle_noise(self) -> np.ndarray | None:
        """Noise (B,) of the angles of poses that come as such, rad; None where markers come."""
        return None

    def rigidity_residual(self) -> np.ndarray:
        """
        How far (B,) markers are off one rigid body, m, per axis; 0 where they may well be of one.

        No noise accounts for it: the markers are of several links, or their body bends.
        """
        off, noise = np.sqrt(self._shapes.misfit()), self._noise.level()
        loose = (off > SURE * noise) & (off > LITTLE * self._size())
        # A lens moves poles by more than it bends bodies.
        loose |= [cause in (LENS, SLANT) for cause in self.causes()]
        # Coordinates without noise show how they are rounded.
        loose &= off > TINY * self._size()
        return np.where(loose, off, 0.0)

    def causes(self) -> list[str]:
        """What moves the markers of each body against each other, '' unless it is known."""
        deformed, noise = self.deformation.freedom > 0, np.fmax(self._noise.level(), 0.0)
        causes = self._fields.cause(deformed, noise, self.deformation.freedom)
        far = np.sqrt(self._shapes.misfit()) > _OTHERS * self._size()
        return [
            cause or (TISSUE if one and not off else '')
            for cause, one, off in zip(causes, deformed, far, strict=True)
        ]

    def erring(self) -> np.ndarray:
        """Deviations (B, width), m, of markers that count for less than others, 0 for these."""
        return self._shapes.deviation

    def noise_underestimated(self) -> np.ndarray:
        """Which bodies (B,) have more noise than can be measured: see `LastingNoise.longer`."""
        return self._lasting.longer(self._noise.level())

    def take(
        self,
        rows: np.ndarray,
        points: np.ndarray,
        heights: np.ndarray,
        gaps: np.ndarray,
        landmarks: np.ndarray | None,
    ) -> None:
        """
        Find the poses of frames, by the markers `points` (T, B, width) and their `heights`.

        Fills the last T of the `rows`, which have their stamps, and `landmarks` (T, B, width), if
        wanted, with the markers as they are identified; `gaps` (T,) says which frames come much
        later than those before. Rows before these are of earlier frames, some of which may turn out
        to be wrong.
        """
        every, rows = rows, rows[len(rows) - len(points) :]
        earlier = len(every) - len(rows)
        first, matcher = 0, self.matcher
        matcher.begin(rows['stamp'], points, heights)
        while first < len(rows):
            if self.settle():
                matcher.sort_again(first)
            room = min(self._shapes.beat - self._new, len(rows) - first)
            room, anew = matcher.arrange(first, room)
            if anew:
                self._learn()
                self._begin_anew(np.ones(self._count, bool))
            unseen = self._shapes.unseen(points[first : first + room])
            if not unseen:
                self._learn()
                self._shapes.begin(points[first])
                self._learned = True
                unseen = 1
            end = first + unseen
            later = gaps[first + 1 : end].nonzero()[0]
            if len(later):
                end = first + 1 + int(later[0])
            part = slice(first, end)
            matcher.fits_next(first, end)
            seen, course = self._fit(rows[part], points[part], heights[part], gaps[part])
            self._leave_out(every, earlier + first, course)
            if landmarks is not None:
                # One line goes on, whatever the marker is called.
                stand_in = np.broadcast_to(self._shapes.stand_in, seen.shape)
                landmarks[part] = np.take_along_axis(seen, stand_in, axis=-1)
                landmarks[part][course.suspect > 0] = complex(np.nan, np.nan)
            rows['beat'][part] = self._known_now()
            first = end

    def were_at(self, times: np.ndarray) -> None:
        """The newest frames that were taken turned out to be at `times` (T,), ns."""
        if len(times):
            self._shapes.were_at(times)
        for news in reversed(self._news):
            if not len(times):
                return
            here = min(len(news.stamps), len(times))
            news.stamps[len(news.stamps) - here :] = times[len(times) - here :]
            times = times[: len(times) - here]
        self._references.were_at(times)

    def take_unseen(self, rows: np.ndarray) -> None:
        """Fill rows (T,) of frames that nothing can be made of: the plane is not known."""
        rows['poses'] = rows['height'] = rows['middle'] = np.nan
        rows['information'], rows['off_pin'], rows['suspect'] = 0.0, False, 0
        rows['tilt'], rows['extra_turn'] = np.nan, 0.0
        rows['beat'] = self._known_now()

    def settle(self) -> bool:
        """Learn if it is time for a beat; whether names stand for other markers then."""
        if self._new < self._shapes.beat:
            return False
        self._learn()
        if not self.matcher.look_is_due():
            return False
        anew = self.matcher.regroup(self.rigidity_residual() > 0)
        if not anew.any():
            return bool(self.matcher.withheld.any())
        self._begin_anew(anew)
        return True

    def _begin_anew(self, which: np.ndarray) -> None:
        """Forget what was learned of the bodies `which` (B,), at a beat."""
        self._shapes.restart(which)
        if self.matcher.has_shape.any():
            self._shapes.give(np.where(which[:, None], self.matcher.given, np.nan))
        self._forget_learned(which, self._newest)
        self._learned = True

    def _forget_learned(self, which: np.ndarray, newest: int) -> None:
        """Of the bodies `which` (B,) nothing holds that was learned up to the `newest`, ns."""
        learners = self._pins, self._references, self._noise, self._lasting, self.deformation
        for learned in learners:
            learned.forget(which)
        self._since[which] = newest + 1

    def retime(self) -> None:
        """Look at reference points afresh: frames before were not when they seemed to be."""
        self._learn()
        self._references.forget(np.ones(self._count, bool))
        self._learned = True

    def widen(self, width: int) -> None:
        """Let bodies have more markers; nothing may wait for what was known before."""
        self._learn()
        self._shapes.widen(width)
        self.matcher.forget_points()
        self.deformation.widen(width)
        self._pins.widen(width)
        self._known = Samples((), _known_type(self._count, width))
        self._learned = True

    def _fit(
        self, rows: np.ndarray, points: np.ndarray, heights: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, Verdict]:
        """
        Fit frames between which nothing is learned and no gap is.

        Returns the points as corrected, and how the poses go on.
        """
        if gaps[0]:
            self._shapes.forget_motion()
        least = self._least_spread()
        fit, points, course = self._shapes.fit(points, rows['time'], least, self.matcher)
        self.matcher.follow(fit)
        self._newest = int(rows['time'][-1])
        if self._shapes.corrected:
            self._counts.update(self._shapes.corrected)
            self._shapes.corrected.clear()
            self._learned = True
        known = np.isfinite(fit.angle)
        information = self._information(fit)
        if np.count_nonzero(known) < known.size:
            information[np.concatenate((~known, ~known), axis=-1)] = 0.0
        count, poses = self._count, rows['poses']
        poses[:, :count, 0], poses[:, :count, 1] = fit.angle, course.turns
        poses[:, count:, 0], poses[:, count:, 1] = fit.position.real, fit.position.imag
        rows['information'], rows['suspect'] = information, course.suspect
        rows['middle'] = self._middle(fit)
        seen = ~np.isnan(points)
        with np.errstate(invalid='ignore'):
            total = np.add.reduce(heights, -1, where=seen)
            rows['height'] = total / np.add.reduce(seen, -1)
        rows['off_pin'] = False
        if np.count_nonzero(np.isfinite(self._pins.center)):
            variance = self._variance(information)
            rows['off_pin'] = self._pins.off_pin(fit.position, fit.angle, variance)
        if np.count_nonzero(course.suspect):
            # Nothing is learned from them, whatever they turn out to be.
            suspect = course.suspect > 0
            nowhere = np.where(suspect, np.nan, 0.0)
            fit = fit._replace(angle=fit.angle + nowhere, position=fit.position + nowhere)
            information = np.where(np.tile(suspect, 2), 0.0, information)
        self.deformation.add(fit.residual)
        self._news.append(
            News(
                rows['time'].copy(),
                fit.position,
                fit.angle,
                information,
                fit.residual,
                fit.freedom,
                gaps,
            )
        )
        self._new += len(rows)
        self._note_outages(rows['stamp'], known)
        return points, course

    def _note_outages(self, stamps: np.ndarray, known: np.ndarray) -> None:
        """Note which bodies were not seen for a window or more, by where (T, B) they are known."""
        if np.count_nonzero(known) == known.size:
            if np.count_nonzero(stamps[0] - self._seen_last >= self._window):
                self._note_outage(stamps[0], np.ones(self._count, bool))
            self._seen_last[:] = stamps[-1]
            return
        for stamp, row in zip(stamps, known, strict=True):
            self._note_outage(stamp, row)
            self._seen_last[row] = stamp

    def _note_outage(self, stamp: np.int64, seen: np.ndarray) -> None:
        lasted = np.where(self._seen_last >= 0, stamp - self._seen_last, 0)
        for b in np.flatnonzero(seen & (lasted >= self._window)).tolist():
            last = int(self._seen_last[b])
            self.outages[b] = one_more(self.outages.get(b), last, int(lasted[b]))

    def _leave_out(self, rows: np.ndarray, first: int, course: Verdict) -> None:
        """Leave the bodies out of the frames, before those from `first` on, that were wrong."""
        if not np.count_nonzero(course.wrong):
            return
        for row, b in zip(*course.wrong.nonzero(), strict=True):
            count = int(course.wrong[row, b])
            wrong = slice(max(first + int(row) - count, 0), first + int(row))
            rows['information'][wrong, [b, self._count + b]] = 0.0
            rows['off_pin'][wrong, b] = False
            self.wrong[b] += count

    def _known_now(self) -> int:
        """The row of what is known now."""
        if self._learned:
            self._learned = False
            known, pins, noise = self._known.room(1), self._pins, self.noise()
            known['noise'] = np.where(noise > 0, noise, 1.0)
            known['measured'] = np.isfinite(noise)
            known['deformed'] = self.deformation.freedom
            known['held'] = self.deformation.held
            known['deformed_since'] = self.deformation.since
            known['orientation_observable'] = noise**2 < UNSTEADY**2 * self._shapes.spread
            known['size'], known['scale'] = self._size(), self._scale()
            known['pin'], known['pin_variance'] = pins.center, pins.variance
            known['pin_since'], known['since'] = pins.since, self._since
            # On a pin the poles are the pin, and relative centers are best where a lens bends two
            # bodies residuals: from velocities at the origins of both.
            references = self._references
            known['reference'] = np.where(np.isfinite(pins.center), 0.0, references.point)
            known['middle'] = references.middle
            known['extra_turn'] = 0.0
            known['shape'] = self._shapes.markers()
        return len(self._known) - 1

    def _learn(self) -> None:
        """A beat: learn shapes, noise, pins and reference points from the frames since the last."""
        if not self._new:
            return
        size = self._size()
        news = News(*map(np.concatenate, zip(*self._news, strict=True)))
        self._news, self._new = [], 0
        self._learned = True
        if self._by_pose:
            variance = self._variance(news.information)
            poses = news.stamps, news.position, news.angle, variance
            with np.errstate(divide='ignore', invalid='ignore'):
                left = self._shapes.weighted(news.residual) / np.sqrt(self._misfit())[:, None]
            self._pins.add(*poses, size, left)
            self._references.add(*poses, self._middle())
        self._learn_noise(news)

    def _learn_noise(self, news: News) -> None:
        """Learn the shapes and the noise, and what else the fits of these frames leave."""
        residuals = self._shapes.of_the_same(news.residual)
        self._noise.add(residuals, news.freedom, ~news.gaps)
        if not self._given:
            self._lasting.add(news.stamps, residuals, news.freedom, news.gaps)
        anew = self._shapes.learn()
        if anew.any():
            self._forget_learned(anew, int(news.stamps[-1]))
        # What a body left that begins anew was not the error of its markers.
        left = np.where(anew[:, None], complex(np.nan, np.nan), news.residual)
        noise = np.fmax(self.noise(), self._noise.level())
        fits = news.stamps, left, news.freedom
        self.deformation.learn(*fits, noise, self._noise.degrees())
        if anew.any():
            self._fields.forget()
        elif np.count_nonzero(self.deformation.freedom):
            self._fields.add(news.position, news.angle, news.residual, self._shapes.markers())
        changed = self._shapes.weigh(left, news.freedom, ~news.gaps)
        if changed.any():
            # Poses from before are by other weights.
            for weighed in (self._pins, self._references, self._lasting, self.deformation):
                weighed.forget(changed)
            self._since[changed] = news.stamps[-1] + 1
            for b in np.flatnonzero(changed).tolist():
                self._noise.replace(b, *self._shapes.refitted(b))

    def _variance(self, information: np.ndarray) -> np.ndarray:
        """Variances (T, 2, B) of one coordinate of the positions, and of the angles."""
        of_angle_first = (information * self._scale()).reshape(len(information), 2, -1)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray(self._misfit() / of_angle_first[:, ::-1])

    def _misfit(self) -> np.ndarray:
        """Variance (B,) of one coordinate of a marker, of all that keeps it off its place."""
        rounding = ROUNDING * self._shapes.farthest
        return np.maximum(self._shapes.misfit(), np.maximum(self._given, rounding) ** 2)

    def _size(self) -> np.ndarray:
        """Diameters (B,) of the bodies: twice the rms distance of their markers from the mean."""
        return np.asarray(2 * np.sqrt(self._shapes.spread / np.maximum(self._shapes.known, 1)))

    def _least_spread(self) -> np.ndarray:
        """Of markers that are closer together, m^2, their noise leaves no angle (B,)."""
        return np.asarray(self._misfit() / UNSTEADY**2)

    def _information(self, fit: Fit) -> np.ndarray:
        """Inverse variances (T, 2 B) of angles and positions, before the `_scale`."""
        return np.concatenate((fit.spread, fit.weight), axis=-1)

    def _scale(self) -> np.ndarray:
        """What the information (2 B,) is to be multiplied by."""
        return np.ones(2 * self._count)

    def _middle(self, fit: Fit | None = None) -> np.ndarray:
        """Means of the markers (B,) in the bodies' frames, or of those (T, B) that were seen."""
        return self._shapes.middle if fit is None else self._shapes.middle_of(fit.residual)
