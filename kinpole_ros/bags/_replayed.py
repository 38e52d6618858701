"""The outcome of a replay, for the command line, batches and Python."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from kinpole_ros.bags._files import Truncated
from kinpole_ros.messages import identity_lines
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.marker_rows import find_rows
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.space import SpaceReport, updated
from kinpole_ros.tracking.timeline import StampState
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import MOST_PAIRED_BODIES, POLE_NAMES

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import PositionReport
    from kinpole_ros.linkage.theory import Theory

_SECOND = 1_000_000_000  # ns


class Replayed(NamedTuple):
    """
    The outcome of a replay.

    Attributes
    ----------
    frames, estimates : int
        Frames read, and instants estimated.
    determined : dict
        Share of the estimates at which each pole is determined, by body and pole.
    unreadable, problem : int, str
        Messages that could not be read, and why the first one.
    repeated, late, lost : int
        Frames left out, as they repeat a stamp or are older than the one before; and frames that
        never came, by the clock of the stamps.
    resets, frame_changes : int
        Restarts of the tracker, at jumps of the stamps and at changes of the frame_id.
    truncated : Truncated or None
        Where a damaged bag ended; None for a sound one.
    noise : dict
        Noise of a marker of each body at the end, per axis, m; NaN where it is not known.
    rigidity_residual, causes : dict
        How far the markers of each body are off a rigid body, m, 0 where they may be of one, and by
        what, '' where that is not known.
    noise_underestimated : list of str
        The bodies whose noise is more than was measured.
    first, last : int
        The earliest and the latest stamp, ns; 0 without frames.
    absent : dict
        The markers of each body that are in no message.
    identities : tuple of str
        The markers in the last message.
    unknown : dict
        The bodies that were never estimated, and why not at the last instant, '' without instants.
    concatenated : list of str
        The files that were read as one recording only because they are in one folder.
    scene_positions : PositionReport or None
        How far the joints are from the scene, if there is one.
    space : SpaceReport
        How the motion lay in space, at the end.
    stamps : StampState or None
        How the stamps deviate from their clock; None where there are too few.
    misnamed : list of str
        Markers that are not those that their names say, and further remarks, a line each.
    pose_problem : str
        Poses that no message has, or that are stamped too late; '' if all is well.
    erring : dict
        Deviations of markers that count for less than others, m, by body and name.
    wrong : dict
        In how many frames each body as a whole was wrong and left out.
    outages : dict
        When a body, or '' for all, was not seen for a window or longer.

    """

    frames: int
    estimates: int
    determined: dict[str, dict[str, float]]
    unreadable: int
    problem: str
    repeated: int
    late: int
    resets: int
    frame_changes: int
    truncated: Truncated | None
    noise: dict[str, float]
    rigidity_residual: dict[str, float]
    causes: dict[str, str]
    noise_underestimated: list[str]
    first: int
    last: int
    absent: dict[str, list[str]]
    identities: tuple[str, ...]
    unknown: dict[str, str]
    concatenated: list[str]
    scene_positions: 'PositionReport | None'
    space: SpaceReport
    lost: int
    stamps: StampState | None
    misnamed: list[str]
    pose_problem: str
    erring: dict[str, dict[str, float]]
    wrong: dict[str, int]
    outages: dict[str, Outage]


class ReplayTotals:
    """Counts over the frames and estimates of a replay."""

    def __init__(self, settings: Settings, tracker: Tracker, theory: 'Theory | None') -> None:
        self.problem = ''
        self.truncated: Truncated | None = None
        self._settings, self._tracker = settings, tracker
        self._first: int | None = None
        self._last = 0
        self._identities: tuple[str, ...] = ()
        self._absent = {body: list(names) for body, names in settings.bodies.items() if names}
        if settings.marker_identity == 'shape':
            for body in settings.shapes:
                self._absent.pop(body, None)
        self._space, self._space_stamp = tracker.space(), 0
        self._estimates = 0
        poles = POLE_NAMES[: settings.highest_order]
        self._determined = {body: dict.fromkeys(poles, 0) for body in tracker.bodies}
        self._unknown = dict.fromkeys(tracker.bodies, '')
        self._positions = None
        if theory is not None:
            from kinpole_ros.linkage.positions import Positions

            self._positions = Positions(theory.scene, theory.matches)

    def add_frames(self, frames: MarkerFrames) -> None:
        """Add frames (T,) before the tracker takes them."""
        earliest = int(frames.stamps.min())
        self._first = earliest if self._first is None else min(self._first, earliest)
        self._last = max(self._last, int(frames.stamps.max()))
        if frames.identities != self._identities:
            self._identities = frames.identities
            absent = {
                body: [
                    name
                    for name, row in zip(names, find_rows(frames.identities, names), strict=True)
                    if row == len(frames.identities)
                ]
                for body, names in self._absent.items()
            }
            self._absent = {body: names for body, names in absent.items() if names}

    def update_space(self) -> None:
        """Note how the motion lies in space, once a second of stamps."""
        if self._last - self._space_stamp >= _SECOND:
            self._space_stamp = self._last
            self._space = updated(self._space, self._tracker.space())

    def add_estimate(self, estimate: Estimate) -> None:
        """Add the estimates (T,) of consecutive instants."""
        self._estimates += len(estimate)
        for b, poles in enumerate(self._determined.values()):
            for order, pole in enumerate(poles, 1):
                poles[pole] += int(estimate.pole(order).determined[:, b].sum())
        for body, reasons in zip(estimate.bodies, estimate.missing.T, strict=True):
            if (reasons == '').any():
                self._unknown.pop(body, None)
            elif body in self._unknown:
                self._unknown[body] = str(reasons[-1])
        if self._positions is not None:
            self._positions.append(estimate)

    def result(self, concatenated: list[str], pose_problem: str) -> Replayed:
        """Return the outcome; `pose_problem` is a line on the input, '' if nothing is wrong."""
        tracker, counts, positions = self._tracker, self._tracker.counts, self._positions

        def by_body(values: Sequence[float] | Sequence[str]) -> dict[str, Any]:
            return dict(zip(tracker.bodies, values, strict=True))

        return Replayed(
            frames=counts['frames'],
            estimates=self._estimates,
            determined={
                body: {pole: count / max(self._estimates, 1) for pole, count in poles.items()}
                for body, poles in self._determined.items()
            },
            unreadable=counts['unreadable'],
            problem=self.problem,
            repeated=counts['repeated'],
            late=counts['late'],
            resets=counts['resets'],
            frame_changes=counts['frame_changes'],
            truncated=self.truncated,
            noise=by_body(tracker.noise().tolist()),
            rigidity_residual=by_body(tracker.rigidity_residual().tolist()),
            causes=by_body(tracker.causes()),
            noise_underestimated=[
                body for body, is_more in by_body(tracker.noise_underestimated()).items() if is_more
            ],
            first=self._first or 0,
            last=self._last,
            absent=self._absent,
            identities=self._identities,
            unknown=self._unknown,
            concatenated=concatenated,
            scene_positions=None if positions is None else positions.report(),
            space=updated(self._space, tracker.space()),
            lost=counts['lost'],
            stamps=tracker.stamp_state(),
            misnamed=[
                *identity_lines(tracker, counts),
                *filter(None, [_pairs_line(self._settings)]),
            ],
            pose_problem=pose_problem,
            erring=tracker.erring(),
            wrong=by_body(tracker.wrong().tolist()),
            outages=tracker.outages(),
        )


def _pairs_line(settings: Settings) -> str:
    """Say that relative motions of pairs are not measured, if there are too many bodies."""
    count = len(settings.bodies)
    if count <= MOST_PAIRED_BODIES:
        return ''
    return (
        f'relative rates and centers of pairs are left out: there are {count} bodies, and pairs '
        f'are measured of up to {MOST_PAIRED_BODIES}; fix: for these, name fewer bodies'
    )
