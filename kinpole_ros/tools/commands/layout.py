"""Layouts for other viewers."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._shared import check_ending, check_outputs


def add(commands: Any) -> None:
    """Add the words of the command."""
    layout = commands.add_parser(
        'layout',
        help='a layout for Foxglove, Lichtblick or PlotJuggler, of the topics of a rig',
        description='Writes a layout to open there: the drawing, rates with their deviations, and\n'
        'diagnostics; in PlotJuggler also the paths of the poles, and joints.',
        epilog='examples:\n'
        '  kinpole layout foxglove --config rig.yaml --output rig.json\n'
        '  kinpole layout plotjuggler --config result.mcap --output rig.xml\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    layout.add_argument(
        'viewer', choices=('foxglove', 'plotjuggler'), help='foxglove is for Lichtblick too'
    )
    layout.add_argument(
        '--config', metavar='FILE', help='parameter file, or a bag of results; without it as replay'
    )
    layout.add_argument('--output', metavar='FILE', required=True, help='layout to write')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.layout import write_layout

    check_outputs([options.config], [options.output])
    kinds = {'foxglove': 'a Foxglove layout', 'plotjuggler': 'a PlotJuggler layout'}
    check_ending('--output', options.output, kinds[options.viewer])
    shown = write_layout(options.viewer, options.config, options.output)
    print(f'{options.output}: {", ".join(shown.bodies)} of {shown.node}')
    return 0
