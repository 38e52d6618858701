"""What the command `kinpole` understands, and what its --help tells."""

import argparse
from collections.abc import Sequence

from kinpole_ros import __version__
from kinpole_ros.tools.commands import COMMANDS
from kinpole_ros.tools.words import files_first

_EPILOG = """Of each option, what is in parentheses at the end of its help is the default.

examples:
  kinpole simulate four_bar --output four_bar.mcap --noise 0.0002
  kinpole replay four_bar.mcap --config config/four_bar.yaml --output result.mcap
  kinpole batch runs/*.mcap --config rig.yaml --output results
  kinpole plot result.mcap --output result.png
  kinpole report recording.mcap --config rig.yaml --output report.html
  kinpole view
  kinpole discover recording.mcap --output rig.yaml --scene draft.yaml --plot rig.png
  kinpole solve four_bar --sweep --centers --plot four_bar.png
  kinpole import walk.trc --output walk.mcap
  kinpole node --ros-args --params-file config/kinpole.yaml
"""


def make_parser() -> argparse.ArgumentParser:
    """The parser of all words; `command` is which was given."""
    parser = argparse.ArgumentParser(
        prog='kinpole',
        description='Planar kinematics of mechanisms from tracked markers: angular rates, poles '
        'and centrodes of every body, and between bodies, with their uncertainty.',
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'kinpole {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')

    commands.add_parser(
        'node',
        help='the live node',
        description='The live node. Everything after it goes to ROS: '
        'kinpole node --ros-args --params-file config/kinpole.yaml -r markers:=/mocap/markers',
    )
    for command in COMMANDS.values():
        command.add(commands)
    return parser


def parse_words(words: Sequence[str]) -> argparse.Namespace:
    """Parse the words after `kinpole`; ends the process for --help and for bad usage."""
    if words[:1] == ['fit']:
        words = ['fit', *files_first(words[1:], 2, '--free', {'--help': 0})]
    if words[:1] == ['tolerance']:
        words = ['tolerance', *files_first(words[1:], 1, '--tolerances', {'--help': 0})]
    if words[:1] == ['solve']:
        sizes = dict.fromkeys(('--help', '--sweep', '--centers', '--statics', '--work'), 0)
        sizes |= {'--pitch': 3, '--decompose': 2}
        words = ['solve', *files_first(words[1:], 1, '--centrodes', sizes)]
    return make_parser().parse_args(words)
