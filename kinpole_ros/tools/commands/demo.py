"""The main job, shown."""

import argparse
from typing import Any


def add(commands: Any) -> None:
    """Add the words of the command."""
    demo = commands.add_parser(
        'demo',
        help='the main job, shown: node, bag, recording and picture',
        description='Starts the node, plays a bag of a four-bar into it, records what it '
        'publishes, prints a table and draws a picture.',
    )
    demo.add_argument('--output', metavar='FOLDER', default='out', help='where to write (out)')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.demo import demo

    return demo(options.output)
