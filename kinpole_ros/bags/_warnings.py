"""The findings of a replay, and its warnings: each line says what is wrong and how to fix it."""

import shlex
from collections.abc import Iterator
from pathlib import Path

from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.findings import Finding
from kinpole_ros.messages import body_faults, faults
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.reasons import REASONS, reason_of

_FEW_REPEATED = 0.02  # of all frames: messages that a network sent twice


def warnings_of(result: Replayed, settings: Settings) -> list[str]:
    """
    Return the warnings of a replay.

    Parameters
    ----------
    result : Replayed
        Its outcome.
    settings : Settings
        The settings of the replay.

    Returns
    -------
    list of str
        Lines on what makes its results fewer or worse.

    """
    return [finding.line() for finding in findings_of(result, settings)]


def findings_of(result: Replayed, settings: Settings) -> Iterator[Finding]:
    """Yield the findings of a replay, as `warnings_of` returns their words."""
    if result.unreadable:
        about = {'count': result.unreadable, 'problem': result.problem}
        yield Finding('unreadable', values=about)
    files = result.concatenated
    if files and (result.resets or result.late):
        about = {'first': files[0], 'last': files[-1], 'count': len(files)}
        yield Finding('concatenated', values=about)
    if result.repeated > _FEW_REPEATED * result.frames and result.estimates:
        repeated = {'count': result.repeated, 'frames': result.frames}
        yield Finding('repeated', values=repeated)
    yield from faults.jitter_findings(result.stamps, settings.stamps)
    for body, names in result.absent.items() if result.frames else ():
        yield body_faults.absence_finding(body, names, result.identities)
    for body, code in result.unknown.items():
        is_pose_explained = result.pose_problem and code == REASONS['NO_POSE']
        if code and body not in result.absent and not is_pose_explained:
            text, fix = reason_of(code)
            about = {'body': body, 'reason': text}
            yield Finding('never_estimated', values=about, fix=fix)
    yield from result.misnamed
    if result.pose_problem:
        yield Finding('source', values={'text': result.pose_problem})
    yield from faults.tilt_findings(result.space, settings.plane)
    yield from _body_findings(result, settings)
    # Without any results the last line says why.
    for body, outage in result.outages.items() if result.estimates else ():
        yield body_faults.outage_finding(body, outage.longest, outage.times)
    if settings.scene and result.estimates:
        if result.scene_positions is not None:
            for text in result.scene_positions.words:
                yield Finding('scene', values={'scene': settings.scene, 'text': text})
        else:
            yield Finding('scene_not_compared', values={'scene': settings.scene})
    if not result.estimates and not result.pose_problem:
        yield _no_results(result, settings)


def _body_findings(result: Replayed, settings: Settings) -> Iterator[Finding]:
    """Yield what is wrong with the shapes, the noise and the poses of bodies."""
    for b, (body, off) in enumerate(result.rigidity_residual.items()):
        yield from body_faults.unit_findings(body, float(result.space.size[b]), settings.scale)
        yield from body_faults.shape_findings(body, b, off, result.causes[body], result.space)
    for body in result.noise_underestimated:
        if not result.rigidity_residual[body]:
            yield Finding('smoothed', body)
    for body, erring in result.erring.items():
        yield from body_faults.marker_findings(body, erring, result.noise[body])
    for body, count in result.wrong.items():
        if count:
            yield Finding('wrong_poses', body, {'count': count})


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


def _no_results(result: Replayed, settings: Settings) -> Finding:
    """Return why there are no results."""
    seconds = (result.last - result.first) / 1e9
    taken = result.frames - result.repeated - result.late
    if not result.frames:
        code = 'no_messages'
    elif result.repeated and result.repeated + 1 == result.frames:
        code = 'no_time'
    elif result.late and taken == 1:
        code = 'backward'
    elif result.resets:
        code = 'all_jumps'
    elif seconds <= settings.lag:
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
