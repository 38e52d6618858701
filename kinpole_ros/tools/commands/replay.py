"""Replay of a bag of markers."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from kinpole_ros.files import printable
from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands._shared import (
    add_set,
    check_ending,
    check_outputs,
    one_line,
    progress_bar,
    settings_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from kinpole_ros.linkage.positions import PositionReport


def add(commands: Any) -> None:
    """Add the words of the command."""
    replay = commands.add_parser(
        'replay',
        help='a bag of markers to results, as fast as the machine goes',
        description='Runs the markers of a bag through the same pipeline as the node. The same '
        'bag and parameters give the same figures every time. Results take the place of earlier '
        'ones only when whole; what a killed run wrote is beside them, as NAME.….part, until '
        'the next.',
    )
    replay.add_argument(
        'bag',
        metavar='BAG',
        help='an .mcap or .db3 file or a rosbag2 folder; one without metadata.yaml is read as one '
        'recording of all its .mcap files',
    )
    replay.add_argument(
        '--config',
        metavar='FILE',
        help='ROS 2 parameter file, as for the node; without it one body, "body", of all markers',
    )
    add_set(replay)
    replay.add_argument('--output', metavar='OUT.mcap', help='bag of results, under /kinpole/...')
    replay.add_argument(
        '--csv', metavar='OUT.csv', help='the same as a table, in SI units, with sigmas'
    )
    replay.add_argument(
        '--parquet',
        metavar='OUT.parquet',
        help=f'the same table for pandas and the like ({install_command("parquet")})',
    )
    replay.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.bags import assumed_body, replay, warnings_of
    from kinpole_ros.messages import plane_words
    from kinpole_ros.tracking.plane import AXES

    outputs = (options.output, options.csv, options.parquet)
    settings = settings_of(options)
    check_outputs([options.config, settings.scene, options.bag], outputs)
    check_ending('--output', options.output, 'an MCAP bag')
    check_ending('--csv', options.csv, 'a CSV table')
    check_ending('--parquet', options.parquet, 'a Parquet table')
    with progress_bar('replay') as progress:
        result = replay(
            options.bag,
            settings,
            options.output,
            options.csv,
            options.topic,
            progress,
            options.parquet,
        )
    print(f'{result.frames} frames in, {result.estimates} instants out')
    if assumption := assumed_body(len(result.identities), settings, options.bag):
        print(printable(assumption))
    for what, count in (
        ('stamps repeated', result.repeated),
        ('frames late', result.late),
        ('frames lost on the way', result.lost),
        ('jumps', result.resets),
        ('changes of frame_id', result.frame_changes),
    ):
        if count:
            print(f'{what}: {count}')
    if (state := result.stamps) is not None:
        used = ', regularized' if state.regularized else ''
        print(
            f'stamps: every {state.interval * 1e3:.6g} ms, jitter {state.jitter * 1e3:.3g} ms rms, '
            f'{state.largest * 1e3:.3g} ms at most{used}'
        )
    for body, shares in result.determined.items():
        listed = ', '.join(f'{pole} {share:.1%}' for pole, share in shares.items())
        print(f'{body}: determined at {listed} of them')
    for row in result.scene_deviations:
        print(
            f'{row.subject}: {row.what} {row.rms:.2g} {row.unit}, {row.deviations:.1f} deviations '
            f'(rms of {row.instants} instants)'
        )
    for line in _positions_lines(result.scene_positions):
        print(line)
    for target in outputs:
        if target:
            print(f'written to {target}')
    if result.space.plane is not None and settings.plane not in AXES:
        print(f'plane: {plane_words(result.space.plane)}')
    for line in warnings_of(result, settings):
        print(f'kinpole replay: {one_line(line)}', file=sys.stderr)
    if result.truncated is not None:
        print(f'kinpole replay: {one_line(result.truncated)}', file=sys.stderr)
    return 2 if result.truncated is not None or result.unknown else 0


def _positions_lines(found: 'PositionReport | None') -> 'Iterator[str]':
    """How far the joints of the scene are off, and whether that is its fault."""
    if found is None:
        return
    for joint in found.joints:
        yield (
            f'joint {joint.joint}: off {joint.rms:.2g} m, {joint.deviations:.1f} deviations, rms '
            f'over {joint.instants} instants'
        )
    verdict = 'differs from what is measured' if found.words else 'agrees with what is measured'
    yield (
        f'the scene {verdict}: residuals are {found.ratio**0.5:.3g} times their noise, over '
        f'{found.instants} instants'
    )
