"""What a running node publishes, in a browser."""

import argparse
from typing import Any


def add(commands: Any) -> None:
    """Add the words of the command."""
    view = commands.add_parser(
        'view',
        help='a page like that of report, live: what a running node publishes, in a browser',
        description='Serves the page of a report, live, to browsers on this machine: 30 times a\n'
        'second bodies, poles with their ellipses, velocities and rates, of a node that publishes\n'
        'anywhere in the ROS graph. Prints the address to open, which has a token in it.\n'
        'The node sends that as one message, after all else, and only while a page is open.',
        epilog='examples:\n'
        '  kinpole view\n'
        '  kinpole view --topic /rig2 --port 8080\n'
        '\n'
        'From another machine: ssh -L 8080:127.0.0.1:8080 RIG, then open the address here.\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    view.add_argument(
        '--topic', metavar='NAME', help='a node, its namespace, or a topic of it (the first found)'
    )
    view.add_argument(
        '--port', type=int, default=0, metavar='N', help='port on 127.0.0.1 (one that is free)'
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.view import view

    view(options.topic or '', options.port)
    return 0
