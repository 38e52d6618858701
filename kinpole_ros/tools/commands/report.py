"""A recording to move through."""

import argparse
from pathlib import Path
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.commands._shared import (
    add_set,
    check_ending,
    check_outputs,
    progress_bar,
    settings_of,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    report = commands.add_parser(
        'report',
        help='a recording to move through: one HTML file that works anywhere, without a network',
        description='Writes one HTML file: the linkage in motion with its poles, centrodes and\n'
        'velocities, all figures over time with their bands, and what was withheld and why.\n'
        'It needs a browser and nothing else. Any file that import reads will do. Without\n'
        '--config or --scene the bodies and the plane are found first, as discover does; what\n'
        'is assumed is printed, with how to change it.',
        epilog='examples:\n'
        '  kinpole report recording.mcap --config rig.yaml --output report.html\n'
        '  kinpole report recording.mcap --scene four_bar --output report.html\n'
        '  kinpole report walk.trc\n'
        '  kinpole report result.mcap --output report.html\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    report.add_argument(
        'bag', metavar='FILE', help='bag of markers or of results, or a file of points'
    )
    report.add_argument(
        '--output', metavar='FILE.html', help='report to write (named as FILE, in this folder)'
    )
    report.add_argument('--config', metavar='FILE', help='parameter file, as for replay')
    add_set(report)
    report.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")
    report.add_argument(
        '--scene',
        metavar='SCENE',
        help='draw its theory beside the measurement; without --config its bodies are tracked',
    )
    report.add_argument(
        '--rate', type=float, metavar='HZ', help='frames per second of a file of points'
    )
    report.add_argument(
        '--scale', type=float, metavar='M_PER_UNIT', help='m per unit of a file of points'
    )
    report.add_argument(
        '--y-down',
        action=argparse.BooleanOptionalAction,
        help='y points down in a file of points (as its format has it)',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.report import Points, prepared, report, settings_for
    from kinpole_ros.tracking.parameters import assignments

    settings = settings_for(settings_of(options), options.scene)
    output = options.output or f'{Path(options.bag).stem}.html'
    check_outputs([options.config, settings.scene, options.bag], [output])
    check_ending('--output', output, 'an HTML page')
    assumptions: list[str] = []
    points = Points(options.rate, options.scale, options.y_down)
    changes = assignments(options.set)
    with (
        progress_bar('report') as progress,
        prepared(options.bag, settings, changes, options.topic, points, progress) as ready,
    ):
        assumptions += ready.assumed
        record = report(
            ready.bag,
            output,
            ready.settings,
            options.topic,
            progress,
            assumptions.append,
            options.bag,
        )
    thinned = '' if len(record.stamp) == record.total else f' of {record.total}'
    for line in assumptions:
        print(printable(line))
    print(f'{len(record.stamp)}{thinned} instants of {", ".join(record.bodies)}')
    print(f'written to {output}')
    return 0
