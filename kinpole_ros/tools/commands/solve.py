"""The analysis of a mechanism."""

import argparse
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.commands._shared import (
    check_ending,
    check_outputs,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    solve = commands.add_parser(
        'solve',
        help='the analysis of a mechanism: motion, dead points, centers, forces',
        description='Solves a scene exactly: positions and rates at time 0, at a value of its '
        'driver, over all the way the linkage gives it, with limits and dead points, or over time.',
        epilog='examples:\n'
        '  kinpole solve four_bar --at "45 deg" --centers\n'
        '  kinpole solve slider_crank --sweep --csv crank.csv --plot crank.png\n'
        '  kinpole solve double_pendulum --time 5 --csv course.csv --html course.html\n'
        '  kinpole solve loader_cylinder --statics\n'
        '  kinpole solve four_bar --at "60 deg" --polygon polygons.svg\n'
        '  kinpole solve antiparallelogram --pitch crank follower gears.svg\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    solve.add_argument(
        'scene', metavar='SCENE', help='a file, or a name that `kinpole simulate --list` has'
    )
    where = solve.add_mutually_exclusive_group()
    where.add_argument(
        '--at',
        metavar='VALUE',
        help='value of the driver: "-45 deg", "0.5 rad", "12 cm"; a number without a unit is in '
        'rad or m, and the output says so',
    )
    where.add_argument(
        '--sweep', action='store_true', help='all positions, over the whole range of its driver'
    )
    where.add_argument(
        '--time', metavar='S', help='the motion that its drivers give it, for S seconds'
    )
    solve.add_argument('--centers', action='store_true', help='instant centers, as deduced by hand')
    solve.add_argument('--statics', action='store_true', help='what drivers and joints bear')
    solve.add_argument(
        '--work',
        action='store_true',
        help='the statics step by step: virtual work line by line, the share of each load, each '
        'bearing force by letting the bearing go, mechanical advantages',
    )
    solve.add_argument('--csv', metavar='FILE', help='all figures as a table, SI units')
    solve.add_argument('--plot', metavar='FILE.png', help='the linkage, and rates over the range')
    solve.add_argument(
        '--centrodes',
        nargs='+',
        default=(),
        metavar='BODY',
        help='draw the centrodes of these bodies into the picture of --plot',
    )
    solve.add_argument(
        '--polygon',
        metavar='FILE.svg',
        help='velocity and acceleration polygons to scale beside the linkage, .svg or .png: at '
        '--at, at time 0, or at the end of --time',
    )
    solve.add_argument(
        '--decompose',
        nargs=2,
        default=(),
        metavar=('BODY:A,B', 'FILE.svg'),
        help="Poisson's decomposition: translation with the point A and rotation about it against "
        'the same with B, from time 0 to --at or the end of --time, and of the velocities there',
    )
    solve.add_argument(
        '--html',
        metavar='FILE.html',
        help='the linkage in motion, as in a report; its points can be dragged, and the scene '
        'saved',
    )
    solve.add_argument(
        '--pitch',
        nargs=3,
        default=(),
        metavar=('BODY', 'BODY', 'FILE'),
        help='centrodes of two bodies as pitch curves: .csv, or .svg, .dxf true to scale',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.solve import solve_scene

    pitch = options.pitch[2] if options.pitch else None
    files = [options.csv, options.plot, options.html, options.polygon, pitch]
    check_outputs([options.scene], [*files, *options.decompose[1:]])
    check_ending('--html', options.html, 'an HTML page')
    check_ending('--csv', options.csv, 'a CSV table')
    check_ending('--pitch', pitch, 'a pair of pitch curves')
    lines = solve_scene(
        options.scene,
        options.at,
        options.sweep,
        options.centers,
        options.statics,
        options.csv,
        options.plot,
        options.pitch,
        options.time,
        options.html,
        options.centrodes,
        polygons=options.polygon,
        decomposed=options.decompose,
        work=options.work,
    )
    print('\n'.join(map(printable, lines)))
    return 0
