"""The outcome of a replay, for the command line, batches and Python."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import compress
from typing import TYPE_CHECKING, Any

from kinpole_ros.bags._files import Truncated
from kinpole_ros.findings import Finding
from kinpole_ros.messages import faults
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.clock import StampState
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.marker_rows import find_rows
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.reasons import KNOWN
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import SpaceReport, updated
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import MOST_PAIRED_BODIES, POLE_NAMES

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import PositionReport

_LATEST = 2**63 - 1  # ns; ROS has no later time
# Fields that are counts of the tracker.
_COUNTED = ('frames', 'unreadable', 'repeated', 'late', 'lost', 'resets', 'frame_changes')


@dataclass(frozen=True)
class Replayed:
    """
    The outcome of a replay.

    Attributes
    ----------
    space : SpaceReport
        How the motion lay in space, at the end.
    frames, estimates : int
        Frames read, and instants estimated.
    determined : dict
        Share of the estimates at which each pole is determined, by body and pole.
    unreadable, problem : int, str
        Messages that could not be read, and why the first one.
    empty : int
        Messages without markers, as of rows of a table in which none was seen.
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
        The bodies that were never estimated, and the code of why not at the last instant, KNOWN
        without instants.
    concatenated : list of str
        The files that were read as one recording only because they are in one folder.
    scene_positions : PositionReport or None
        How far the joints are from the scene, if there is one.
    stamps : StampState or None
        How the stamps deviate from their clock; None where there are too few.
    misnamed : list of Finding
        Markers that are not those that their names say, and further remarks.
    pose_problem : str
        Poses that no message has, or that are stamped too late; '' if all is well.
    erring : dict
        Deviations of markers that count for less than others, m, by body and name.
    wrong : dict
        In how many frames each body as a whole was wrong and left out.
    outages : dict
        When a body, or '' for all, was not seen for a window or longer.

    """

    space: SpaceReport
    frames: int = 0
    estimates: int = 0
    determined: dict[str, dict[str, float]] = field(default_factory=dict)
    unreadable: int = 0
    problem: str = ''
    empty: int = 0
    repeated: int = 0
    late: int = 0
    lost: int = 0
    resets: int = 0
    frame_changes: int = 0
    truncated: Truncated | None = None
    noise: dict[str, float] = field(default_factory=dict)
    rigidity_residual: dict[str, float] = field(default_factory=dict)
    causes: dict[str, str] = field(default_factory=dict)
    noise_underestimated: list[str] = field(default_factory=list)
    first: int = 0
    last: int = 0
    absent: dict[str, list[str]] = field(default_factory=dict)
    identities: tuple[str, ...] = ()
    unknown: dict[str, int] = field(default_factory=dict)
    concatenated: list[str] = field(default_factory=list)
    scene_positions: 'PositionReport | None' = None
    stamps: StampState | None = None
    misnamed: list[Finding] = field(default_factory=list)
    pose_problem: str = ''
    erring: dict[str, dict[str, float]] = field(default_factory=dict)
    wrong: dict[str, int] = field(default_factory=dict)
    outages: dict[str, Outage] = field(default_factory=dict)


@dataclass
class ReplayedSoFar:
    """
    What a replay has found so far, as fields of `Replayed`.

    `determined` has the numbers of instants at which poles are determined, by body and pole.
    """

    space: SpaceReport
    determined: dict[str, dict[str, int]]
    absent: dict[str, list[str]]
    unknown: dict[str, int]
    estimates: int = 0
    problem: str = ''
    empty: int = 0
    truncated: Truncated | None = None
    first: int = _LATEST
    last: int = 0
    identities: tuple[str, ...] = ()
    concatenated: list[str] = field(default_factory=list)
    scene_positions: 'PositionReport | None' = None
    misnamed: list[Finding] = field(default_factory=list)
    pose_problem: str = ''


def begin(settings: Settings, tracker: Tracker) -> ReplayedSoFar:
    """Return what a replay has found that has no frames yet."""
    absent = {body: list(names) for body, names in settings.bodies.items() if names}
    for body in settings.shapes if settings.marker_identity == 'shape' else ():
        absent.pop(body, None)
    poles = POLE_NAMES[: settings.highest_order]
    return ReplayedSoFar(
        space=tracker.space(),
        determined={body: dict.fromkeys(poles, 0) for body in tracker.bodies},
        absent=absent,
        unknown=dict.fromkeys(tracker.bodies, KNOWN),
    )


def add_frames(outcome: ReplayedSoFar, frames: MarkerFrames) -> None:
    """Add frames (T,) before the tracker takes them."""
    outcome.first = min(outcome.first, int(frames.stamps.min()))
    outcome.last = max(outcome.last, int(frames.stamps.max()))
    if frames.identities != outcome.identities:
        outcome.identities = frames.identities
        absent = {
            body: [
                name
                for name, row in zip(names, find_rows(frames.identities, names), strict=True)
                if row == len(frames.identities)
            ]
            for body, names in outcome.absent.items()
        }
        outcome.absent = {body: names for body, names in absent.items() if names}


def add_estimate(outcome: ReplayedSoFar, estimate: Estimate) -> None:
    """Add the estimates (T,) of consecutive instants."""
    outcome.estimates += len(estimate)
    for b, poles in enumerate(outcome.determined.values()):
        for order, pole in enumerate(poles, 1):
            poles[pole] += int(estimate.pole(order).determined[:, b].sum())
    for body, reasons in zip(estimate.bodies, estimate.reason.T, strict=True):
        if (reasons == KNOWN).any():
            outcome.unknown.pop(body, None)
        elif body in outcome.unknown:
            outcome.unknown[body] = int(reasons[-1])


def finish(outcome: ReplayedSoFar, tracker: Tracker, converted: str = '') -> Replayed:
    """
    Return the outcome, with what the tracker knows at the end.

    `converted` says why frames repeat others, if it is known.
    """
    bodies, counts = tracker.bodies, tracker.update_counts()
    unexplained = {**counts, HELD: 0} if converted else counts
    found = [*faults.identity_findings(tracker, unexplained)]
    if converted:
        found.append(Finding('source', values={'text': converted}))
    outcome.misnamed = [*found, *outcome.misnamed]
    if len(bodies) > MOST_PAIRED_BODIES:
        about = {'count': len(bodies), 'most': MOST_PAIRED_BODIES}
        outcome.misnamed.append(Finding('unpaired', values=about))
    estimates = max(outcome.estimates, 1)
    shares = {
        body: {pole: number / estimates for pole, number in poles.items()}
        for body, poles in outcome.determined.items()
    }

    def by_body(values: Iterable[Any]) -> dict[str, Any]:
        return dict(zip(bodies, values, strict=True))

    at_end = {
        'determined': shares,
        'first': outcome.first if counts['frames'] else 0,
        # Messages without markers came, but have no stamps.
        'lost': max(counts['lost'] - outcome.empty, 0),
        'noise': by_body(tracker.noise().tolist()),
        'rigidity_residual': by_body(tracker.rigidity_residual().tolist()),
        'causes': by_body(tracker.causes()),
        'noise_underestimated': [*compress(bodies, tracker.noise_underestimated())],
        'space': updated(outcome.space, tracker.space()),
        'stamps': tracker.stamp_state(),
        'erring': tracker.erring(),
        'wrong': by_body(tracker.wrong().tolist()),
        'outages': tracker.outages(),
    }
    return Replayed(**vars(outcome) | {name: counts[name] for name in _COUNTED} | at_end)
