"""A scene's dimensions from measured markers."""

import argparse
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.commands._shared import (
    check_ending,
    check_outputs,
    progress_bar,
    reported,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    fit = commands.add_parser(
        'fit',
        help="a scene's dimensions from measured markers, each with its deviation",
        description='Fits points, lengths and angles of a scene to the poses of its bodies in all\n'
        'frames, whatever drives them: least squares over what the joints lack. What the data do\n'
        'not tell stays as it is, and is named. Markers sit where the scene has them.',
        epilog='examples:\n'
        '  kinpole fit machine.yaml run.mcap\n'
        '  kinpole fit machine.yaml run.mcap --free rocker.B coupler --output fitted.yaml\n'
        '  kinpole fit --free rocker.B,coupler machine.yaml run.mcap\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fit.add_argument(
        'scene',
        metavar='SCENE',
        help='the scene to fit: a file, or a name that `kinpole simulate --list` has',
    )
    fit.add_argument('bag', metavar='BAG', help='an .mcap or .db3 file or a rosbag2 folder')
    fit.add_argument(
        '--config',
        metavar='FILE',
        help="ROS 2 parameter file, as for the node; without it the scene's bodies and markers",
    )
    fit.add_argument(
        '--free',
        action='append',
        nargs='+',
        metavar='NAME',
        help='what to fit: a point (rocker.B), a length (r2.length), or all of a body, vector or '
        'joint; repeatable, and commas separate too (the list free of the scene, or all)',
    )
    fit.add_argument('--output', metavar='SCENE.yaml', help='the scene, as fitted, to write')
    fit.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.fit import fit_bag

    check_outputs([options.scene, options.bag, options.config], [options.output])
    check_ending('--output', options.output, 'a YAML file')
    troubles: list[object] = []
    with progress_bar('fit') as progress:
        lines = fit_bag(
            options.scene,
            options.bag,
            options.config,
            [name.split(',') for names in options.free or [] for name in names],
            options.output,
            options.topic,
            progress,
            troubles.append,
        )
    print('\n'.join(map(printable, lines)))
    return reported('fit', troubles)
