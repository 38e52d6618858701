"""What a rig is, from its markers."""

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
    discover = commands.add_parser(
        'discover',
        help='what a rig is, from its markers: bodies, joints, lengths; a parameter file to start',
        description='Finds which markers make which rigid body, in which plane and unit, and what\n'
        'joins the bodies: pins, slides, wheels and gears, with places, lengths and deviations.\n'
        'Needs two or more markers a body, in motion. Names, order and dropouts do not matter.\n'
        'Bodies that do not move in one plane, as those of a walk, are listed with their axes and\n'
        'joints in space; they need names, and three markers each.\n'
        'Prints a table; writes a parameter file for replay and the node, and a draft scene for\n'
        'solve and simulate, where names and drivers are a first guess.',
        epilog='examples:\n'
        '  kinpole discover recording.mcap\n'
        '  kinpole discover recording.mcap --output rig.yaml --scene draft.yaml --plot rig.png\n'
        '  kinpole discover /mocap/markers --seconds 30 --output rig.yaml\n'
        'and then\n'
        '  kinpole replay recording.mcap --config rig.yaml --output result.mcap\n'
        '  kinpole solve draft.yaml --centers\n'
        '\n'
        'Move all joints through their range, one against the other, at changing speed: what does\n'
        'not move cannot be found. "left over" is what a joint does not explain, over the noise:\n'
        '1 is perfect, more is play, a lens, or a body that bends.\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    discover.add_argument(
        'source',
        metavar='BAG_OR_TOPIC',
        help='an .mcap or .db3 file or a rosbag2 folder, or a topic that is being published',
    )
    discover.add_argument(
        '--topic', metavar='T', help='topic of the markers in the bag (/markers, or the only one)'
    )
    discover.add_argument(
        '--seconds',
        type=float,
        metavar='S',
        help='use the first S seconds of a bag (60), or S seconds of a live topic (20)',
    )
    discover.add_argument(
        '--plane',
        default='auto',
        metavar='P',
        help='plane to take: xy, yz, zx or its normal nx,ny,nz (auto: that of the motion)',
    )
    discover.add_argument('--output', metavar='RIG.yaml', help='parameter file to write')
    discover.add_argument('--scene', metavar='SCENE.yaml', help='draft scene to write')
    discover.add_argument('--plot', metavar='FILE.png', help='picture of what was found')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.discover import discover_rig

    check_outputs([options.source], [options.output, options.scene, options.plot])
    check_ending('--output', options.output, 'a YAML file')
    check_ending('--scene', options.scene, 'a YAML file')
    troubles: list[object] = []
    with progress_bar('discover') as progress:
        lines = discover_rig(
            options.source,
            options.topic,
            options.seconds,
            options.output,
            options.scene,
            options.plot,
            progress,
            troubles.append,
            options.plane,
        )
    print('\n'.join(map(printable, lines)))
    return reported('discover', troubles)
