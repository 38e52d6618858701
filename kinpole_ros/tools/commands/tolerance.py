"""What errors of dimensions and play make of the motion of a mechanism."""

import argparse
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.commands._shared import UsageError, check_ending, check_outputs


def add(commands: Any) -> None:
    """Add the words of the command."""
    tolerance = commands.add_parser(
        'tolerance',
        help='how errors of lengths and play in pins become errors of points, angles and centers',
        description='Deviations of all points, angles and centers over the range of a scene, to\n'
        'first order and of linkages with errors at random, and where they come from.',
        epilog='examples:\n'
        '  kinpole tolerance four_bar --tolerances length=0.1mm play:B=0.05mm\n'
        '  kinpole tolerance four_bar --tolerances coupler.B=0.2mm --plot errors.png\n'
        '  kinpole fit four_bar run.mcap > fitted.txt\n'
        '  kinpole tolerance four_bar --tolerances fitted.txt --html expected.html\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    tolerance.add_argument(
        'scene', metavar='SCENE', help='a file, or a name that `kinpole simulate --list` has'
    )
    tolerance.add_argument(
        '--tolerances',
        nargs='+',
        default=(),
        metavar='NAME=DEVIATION',
        help='standard deviations of a point, a length or an angle (coupler.B=0.1mm), of all of a '
        'body, vector or joint, or of every length or angle; play (play:B=0.05mm): radial of pins, '
        'to either side of a slot, half the backlash of gears; or a file with what `kinpole fit` '
        'printed (length=0.1mm angle=0.1deg)',
    )
    tolerance.add_argument(
        '--samples',
        type=int,
        default=1000,
        metavar='N',
        help='linkages with errors at random (1000); 0 for the first order alone',
    )
    tolerance.add_argument('--csv', metavar='FILE', help='all of it over the range, SI units')
    tolerance.add_argument('--plot', metavar='FILE.png', help='deviations over the range')
    tolerance.add_argument('--html', metavar='FILE.html', help='the motion, with its bands')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.solve import tolerances

    if options.samples < 0:
        raise UsageError(f'--samples is {options.samples}; it must be 0 or more')
    check_outputs([options.scene], [options.csv, options.plot, options.html])
    check_ending('--csv', options.csv, 'a CSV table')
    check_ending('--html', options.html, 'an HTML page')
    check_ending('--plot', options.plot, 'a picture')
    lines = tolerances(
        options.scene,
        options.tolerances,
        options.samples,
        options.csv,
        options.plot,
        options.html,
    )
    print('\n'.join(map(printable, lines)))
    return 0
