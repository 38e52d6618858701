"""The warnings of a replay: each line says what is wrong and how to fix it."""

import shlex
from pathlib import Path

from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.messages import body_faults, faults
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.reasons import REASONS, reason_of


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
    lines = []
    if result.unreadable:
        lines.append(f'{result.unreadable} messages left out, the first: {result.problem}')
    files = result.concatenated
    if files and (result.resets or result.late):
        lines.append(
            f'{files[0]} to {files[-1]}, {len(files)} files, were read as '
            'one recording, since the folder has no metadata.yaml to tell, but the stamps do not '
            'run on; if they are several, give each file by itself'
        )
    if result.stamps is not None and (fault := faults.jitter_fault(result.stamps, settings.stamps)):
        lines.append(fault)
    if result.frames:
        absent = result.absent.items()
        lines += [
            body_faults.absent_markers_fault(body, names, result.identities)
            for body, names in absent
        ]
    for body, reason in result.unknown.items():
        is_pose_explained = result.pose_problem and reason == REASONS['NO_POSE']
        if reason and body not in result.absent and not is_pose_explained:
            text, fix = reason_of(reason)
            lines.append(f'{body} was never estimated: {text}' + (f'; {fix}' if fix else ''))
    lines += result.misnamed + [result.pose_problem] * bool(result.pose_problem)
    if tilt := faults.tilt_fault(result.space, settings.plane):
        lines.append(tilt)
    lines += _body_warnings(result, settings)
    # Without any results the last line says why.
    for body, outage in result.outages.items() if result.estimates else ():
        name = f'{body}: ' if body else ''
        count = f'; {outage.times} such times, this the longest' if outage.times > 1 else ''
        lines.append(f'{name}{body_faults.outage_fault(body, outage.longest)}{count}')
    if settings.scene and result.estimates:
        if result.scene_positions is not None:
            lines += [f'scene {settings.scene}: {text}' for text in result.scene_positions.words]
        else:
            lines.append(
                f'the scene {settings.scene} was compared at no instant: bodies that its joints '
                'connect were never all seen; mark more of them, or see to the view of the markers'
            )
    if not result.estimates and not result.pose_problem:
        lines.append(_no_results(result, settings))
    return lines


def _body_warnings(result: Replayed, settings: Settings) -> list[str]:
    """Return what is wrong with the shapes, the noise and the poses of bodies."""
    lines = []
    for b, (body, off) in enumerate(result.rigidity_residual.items()):
        unit = body_faults.unit_fault(float(result.space.size[b]), settings.scale)
        wrong = unit, body_faults.shape_fault(b, off, result.causes[body], result.space)
        lines += [f'{body}: {text}' for text in wrong if text]
    lines += [
        f'{body}: {body_faults.SMOOTHED}'
        for body in result.noise_underestimated
        if not result.rigidity_residual[body]
    ]
    for body, erring in result.erring.items():
        lines += [
            f'{body}: {fault}' for fault in body_faults.marker_faults(erring, result.noise[body])
        ]
    lines += [
        f'{body}: {body_faults.wrong_pose_fault(count)}'
        for body, count in result.wrong.items()
        if count
    ]
    return lines


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
    (name,) = settings.bodies
    return (
        f'all {markers} markers are taken as one rigid body, "{name}", since no '
        f'parameters name bodies; to track several: kinpole discover {shlex.quote(str(bag))} '
        '--output rig.yaml, then the same command with --config rig.yaml'
    )


def _no_results(result: Replayed, settings: Settings) -> str:
    """Say why there are no results."""
    seconds = (result.last - result.first) / 1e9
    taken = result.frames - result.repeated - result.late
    capture_fix = 'see that the driver sets header.stamp to the time of capture'
    if not result.frames:
        reason, fix = 'the topic has no messages', 'record again, or name another --topic'
    elif result.repeated and result.repeated + 1 == result.frames:
        reason, fix = 'all stamps are the same', capture_fix
    elif result.late and taken == 1:
        reason, fix = 'the stamps run backward', capture_fix
    elif result.resets:
        reason = f'the stamps jump by more than the parameter window, {settings.window:g} s'
        fix = 'raise it, or see to the stamps'
    elif seconds <= settings.lag:
        reason = (
            f'a frame has one when it is {settings.lag:g} s old (the parameter lag), and there are '
            f'{seconds:.3g} s'
        )
        fix = 'record longer, or see to the stamps'
    elif taken < FEWEST_SAMPLES:
        reason = f'they take {FEWEST_SAMPLES} frames, and there are {taken}'
        fix = 'record longer, or see to the stamps'
    else:
        reason = (
            f'the parameter window, {settings.window:g} s, must hold {FEWEST_SAMPLES} frames, and '
            f'they come every {seconds / max(taken - 1, 1):.3g} s'
        )
        fix = 'raise it, or see to the stamps'
    return f'no results, since {reason}; {fix}'
