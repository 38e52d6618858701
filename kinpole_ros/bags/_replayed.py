"""The outcome of a replay, for the command line, batches and Python."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinpole_ros.bags._files import Truncated
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.findings import Finding
from kinpole_ros.messages import body_faults, faults
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.clock import StampState
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.marker_rows import find_rows
from kinpole_ros.tracking.reasons import KNOWN, REASONS, reason_of
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import SpaceReport, updated
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import MOST_PAIRED_BODIES, POLE_NAMES

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import PositionReport

_FEW_REPEATED = 0.02  # of all frames: messages that a network sent twice
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
    first, last : int
        The earliest and the latest stamp, ns; 0 without frames.
    identities : tuple of str
        The markers in the last message.
    unknown : dict
        The bodies that were never estimated, and the code of why not at the last instant, KNOWN
        without instants.
    scene_positions : PositionReport or None
        How far the joints are from the scene, if there is one.
    stamps : StampState or None
        How the stamps deviate from their clock; None where there are too few.
    findings : list of Finding
        What makes results fewer or worse; without any, the last one says why.

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
    first: int = 0
    last: int = 0
    identities: tuple[str, ...] = ()
    unknown: dict[str, int] = field(default_factory=dict)
    scene_positions: 'PositionReport | None' = None
    stamps: StampState | None = None
    findings: list[Finding] = field(default_factory=list)

    @property
    def warnings(self) -> list[str]:
        """The findings in words, a line each."""
        return [finding.line() for finding in self.findings]


@dataclass
class ReplayedSoFar:
    """
    What a replay has found so far, as fields of `Replayed`.

    `determined` has the numbers of instants at which poles are determined, by body and pole, and
    `absent` the markers of each body that are in no message. `concatenated` are files that were
    read as one recording only because they are in one folder. `drawings` are in messages besides
    markers, `pose_fault` is of poses that no message has, or that are stamped too late, and
    `converted` of frames that repeat others, as in a film whose rate was changed.
    """

    space: SpaceReport
    determined: dict[str, dict[str, int]]
    absent: dict[str, list[str]]
    unknown: dict[str, int]
    is_whole: bool  # known as a whole, with results to both ends
    estimates: int = 0
    problem: str = ''
    empty: int = 0
    truncated: Truncated | None = None
    first: int = _LATEST
    last: int = 0
    identities: tuple[str, ...] = ()
    concatenated: list[str] = field(default_factory=list)
    scene_positions: 'PositionReport | None' = None
    drawings: Finding | None = None
    pose_fault: Finding | None = None
    converted: Finding | None = None


def begin(settings: Settings, tracker: Tracker, is_whole: bool) -> ReplayedSoFar:
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
        is_whole=is_whole,
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


def finish(outcome: ReplayedSoFar, tracker: Tracker) -> Replayed:
    """Return the outcome, with what the tracker knows at the end."""
    counts = tracker.update_counts()
    outcome.space = updated(outcome.space, tracker.space())
    outcome.first = outcome.first if counts['frames'] else 0
    estimates = max(outcome.estimates, 1)
    own: dict[str, Any] = {one.name: getattr(outcome, one.name, None) for one in fields(Replayed)}
    return Replayed(
        **own
        | {name: counts[name] for name in _COUNTED}
        | {
            'determined': {
                body: {pole: number / estimates for pole, number in poles.items()}
                for body, poles in outcome.determined.items()
            },
            # Messages without markers came, but have no stamps.
            'lost': max(counts['lost'] - outcome.empty, 0),
            'noise': dict(zip(tracker.bodies, tracker.noise().tolist(), strict=True)),
            'stamps': tracker.stamp_state(),
            'findings': [*_findings(outcome, tracker, counts)],
        }
    )


def _findings(
    outcome: ReplayedSoFar, tracker: Tracker, counts: Mapping[str, int]
) -> Iterator[Finding]:
    """Yield what makes results fewer or worse."""
    settings = tracker.settings
    if counts['unreadable']:
        about = {'count': counts['unreadable'], 'problem': outcome.problem}
        yield Finding('unreadable', values=about)
    files = outcome.concatenated
    if files and (counts['resets'] or counts['late']):
        of_files = {'first': files[0], 'last': files[-1], 'count': len(files)}
        yield Finding('concatenated', values=of_files)
    if counts['repeated'] > _FEW_REPEATED * counts['frames'] and outcome.estimates:
        yield Finding('repeated', values={'count': counts['repeated'], 'frames': counts['frames']})
    yield from faults.jitter_findings(tracker.stamp_state(), settings.stamps)
    yield from _unknown_bodies(outcome, counts['frames'])
    unexplained = {**counts, HELD: 0} if outcome.converted else counts
    yield from faults.identity_findings(tracker, unexplained)
    yield from filter(None, (outcome.converted, outcome.drawings))
    if (bodies := len(tracker.bodies)) > MOST_PAIRED_BODIES:
        yield Finding('unpaired', values={'count': bodies, 'most': MOST_PAIRED_BODIES})
    yield from filter(None, [outcome.pose_fault])
    yield from faults.tilt_findings(outcome.space, settings.plane)
    for own, of_markers in body_faults.body_findings(tracker, outcome.space):
        yield from (*own, *of_markers)
    for body, count in zip(tracker.bodies, tracker.wrong().tolist(), strict=True):
        if count:
            yield Finding('wrong_poses', body, {'count': count})
    if not outcome.estimates:
        if outcome.pose_fault is None:
            yield _no_results(outcome, settings, counts)
        return
    for body, outage in tracker.outages().items():
        yield body_faults.outage_finding(body, outage.longest, outage.times)
    if outcome.scene_positions is not None:
        yield from outcome.scene_positions.findings
    elif settings.scene:
        yield Finding('scene_not_compared', values={'scene': settings.scene})


def _unknown_bodies(outcome: ReplayedSoFar, frames: int) -> Iterator[Finding]:
    """Yield which markers are in no message, and which bodies were never estimated."""
    for body, names in outcome.absent.items() if frames else ():
        yield body_faults.absence_finding(body, names, outcome.identities)
    for body, code in outcome.unknown.items():
        is_pose_explained = outcome.pose_fault and code == REASONS['NO_POSE']
        if code and body not in outcome.absent and not is_pose_explained:
            text, fix = reason_of(code)
            yield Finding('never_estimated', values={'body': body, 'reason': text}, fix=fix)


def _no_results(outcome: ReplayedSoFar, settings: Settings, counts: Mapping[str, int]) -> Finding:
    """Return why there are no results."""
    seconds = (outcome.last - outcome.first) / 1e9
    frames, repeated, late = counts['frames'], counts['repeated'], counts['late']
    taken = frames - repeated - late
    if not frames:
        code = 'no_messages'
    elif repeated and repeated + 1 == frames:
        code = 'no_time'
    elif late and taken == 1:
        code = 'backward'
    elif counts['resets']:
        code = 'all_jumps'
    elif seconds <= settings.lag and not outcome.is_whole:
        code = 'within_lag'
    else:
        code = 'few_frames' if taken < FEWEST_SAMPLES else 'short_window'
    about = {
        'window': settings.window,
        'lag': settings.lag,
        'seconds': seconds,
        'needed': FEWEST_SAMPLES,
        'count': taken,
        'interval': seconds / max(taken - 1, 1),
    }
    return Finding(code, values=about)


def assumed_body(markers: int, settings: Settings, bag: str | Path) -> str:
    """
    Say that all markers were taken as one body, where no parameters name bodies.

    Parameters
    ----------
    markers : int
        How many markers or poses its messages have.
    settings : Settings
        The settings that the bag was replayed with.
    bag : str or Path
        The bag, for the command that finds its bodies.

    Returns
    -------
    str
        The assumption and how to change it, in one line; '' where bodies are named, or there is
        no more than one marker or pose.

    """
    if settings.bodies != Settings().bodies or markers < 2:
        return ''
    (body,) = settings.bodies
    about = {'count': markers, 'body': body, 'bag': shlex.quote(str(bag))}
    return Finding('all_one_body', values=about).words()
