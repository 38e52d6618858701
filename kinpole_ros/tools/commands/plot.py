"""A picture of a result bag."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._shared import check_outputs, progress_bar, reported


def add(commands: Any) -> None:
    """Add the words of the command."""
    plot = commands.add_parser(
        'plot',
        help='a picture of a result bag',
        description='Draws centrodes, poles and rates with their bands. A bag of markers has none: '
        'replay it first, or see kinpole report, which does.',
    )
    plot.add_argument('bag', metavar='BAG', help='bag of results, from replay or recorded live')
    plot.add_argument('--output', metavar='FILE.png', required=True, help='picture to write')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.plot import plot

    check_outputs([options.bag], [options.output])
    with progress_bar('plot') as progress:
        cut = plot(options.bag, options.output, progress)
    print(f'drawn to {options.output}')
    return reported('plot', [cut] if cut else [])
