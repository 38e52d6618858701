"""The measurements of the docs."""

import argparse
import sys
from pathlib import Path
from typing import Any

from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands._shared import progress_bar


def add(commands: Any) -> None:
    """Add the words of the command."""
    bench = commands.add_parser(
        'bench',
        help='measure errors, uncertainty, peers and limits, and draw the charts of the docs',
        description='Writes benchmarks.md, benchmarks-tables.md and charts/ anew. Takes a quarter '
        'of an hour on two cores; wants '
        'matplotlib, and compares with PyNumDiff where it is installed: '
        f'{install_command("bench")}.',
    )
    bench.add_argument('--output', metavar='FOLDER', default='docs', help='where to write (docs)')
    bench.add_argument('--quick', action='store_true', help='little data: shows that it works')
    part = bench.add_mutually_exclusive_group()
    part.add_argument(
        '--only',
        nargs='+',
        metavar='PART',
        help='only these parts; the pages quote the others as they were measured before: costs, '
        'speed, live, hindsight, peers, lag, model, pynumdiff, atlas, pendulum, rigs',
    )
    part.add_argument(
        '--pages',
        action='store_true',
        help='measure nothing: pages and charts of charts/*.csv',
    )
    part.add_argument(
        '--long', action='store_true', help='only the run of 1e7 frames: some minutes'
    )
    part.add_argument(
        '--rigs',
        action='store_true',
        help='only what drivers send of real rigs, late stamps to soft tissue: two minutes',
    )
    part.add_argument(
        '--soak',
        type=float,
        metavar='MINUTES',
        help='only the live node, for so long at 500 Hz with dropouts, outliers and clock jumps',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    # Next to the package: an installed one has none.
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
    from bench import PARTS, bench, bench_long, bench_soak, make_pages

    with progress_bar('bench') as progress:
        if options.long:
            written = bench_long(options.output, progress)
        elif options.soak is not None:
            written = bench_soak(options.output, options.soak, progress)
        elif options.pages:
            written = make_pages(options.output)
        else:
            only = ['rigs'] if options.rigs else options.only or PARTS
            written = bench(options.output, options.quick, progress, only)
    for path in written:
        print(f'written to {path}')
    return 0
