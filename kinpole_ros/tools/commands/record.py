"""What a node publishes, recorded."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._shared import check_ending


def add(commands: Any) -> None:
    """Add the words of the command."""
    record = commands.add_parser(
        'record',
        help='record the results of a running node, where there is no ros2 bag record',
        description='Records until Ctrl-C. A kill loses no more than the last second.',
    )
    record.add_argument('--output', metavar='BAG', required=True, help='.mcap file to write')
    record.add_argument(
        '--topic',
        action='append',
        metavar='PREFIX',
        help='beginning of the topics to record; repeatable (/kinpole/ and /diagnostics)',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.ros.recorder import record

    check_ending('--output', options.output, 'an MCAP bag')
    count = record(options.output, options.topic or ['/kinpole/', '/diagnostics'])
    print(f'{count} messages written to {options.output}')
    return 0
