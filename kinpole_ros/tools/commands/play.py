"""A bag published."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._shared import progress_bar


def add(commands: Any) -> None:
    """Add the words of the command."""
    play = commands.add_parser(
        'play',
        help='publish a bag, where there is no ros2 bag play',
        description='Publishes a bag at the pace it was recorded, once somebody listens.',
    )
    play.add_argument('bag', metavar='BAG', help='an .mcap or .db3 file or a rosbag2 folder')
    play.add_argument('--topic', action='append', metavar='T', help='only this one; repeatable')
    play.add_argument(
        '--speed',
        type=float,
        default=1.0,
        metavar='X',
        help='play X times as fast as it was recorded (1)',
    )
    play.add_argument(
        '--loop',
        action='store_true',
        help='over and over, until Ctrl-C; the stamps go on from loop to loop',
    )
    play.add_argument(
        '--clock',
        type=float,
        nargs='?',
        const=40.0,
        metavar='HZ',
        help='have the time of the bag on /clock too, for nodes with use_sim_time (40 Hz)',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.ros.player import play

    with progress_bar('play') as progress:
        count = play(
            options.bag,
            options.topic,
            options.speed,
            progress=progress,
            loop=options.loop,
            clock=options.clock,
        )
    print(f'{count} messages played')
    return 0
