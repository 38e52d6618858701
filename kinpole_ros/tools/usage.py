"""The command line of `kinpole`: its parser, and the order of its words."""

import argparse
import os
import textwrap
from collections.abc import Sequence
from typing import Any

from kinpole_ros import __version__
from kinpole_ros.files import cut, did_you_mean
from kinpole_ros.tools.commands import COMMANDS
from kinpole_ros.tools.commands._command import Option

_EPILOG = """The default of an option is in parentheses at the end of its help.

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


class _HelpFormatter(argparse.HelpFormatter):
    """Wraps paragraphs to the terminal; keeps the lines of paragraphs that have an indented one."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return '\n\n'.join(
            paragraph
            if '\n  ' in f'\n{paragraph}'
            else textwrap.fill(' '.join(paragraph.split()), width, break_on_hyphens=False)
            for paragraph in text.split('\n\n')
        )


def make_parser(only: str | None = None) -> argparse.ArgumentParser:
    """
    Return the parser of the whole command line; `command` is the name of the subcommand.

    It knows all subcommands, or `only` one.
    """
    parser = argparse.ArgumentParser(
        prog='kinpole',
        description='Planar kinematics of mechanisms from tracked markers: angular rates, poles '
        'and centrodes of every body, and between bodies, with their uncertainty.',
        epilog=_EPILOG,
        formatter_class=_HelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'kinpole {__version__}')
    subparsers = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    subparsers.add_parser(
        'node',
        help='Run the live node',
        description='Run the live node. All words after `node` go to ROS: '
        'kinpole node --ros-args --params-file config/kinpole.yaml -r markers:=/mocap/markers',
    )
    for name in COMMANDS if only is None else (only,):
        COMMANDS[name].add_parser(name, subparsers, _HelpFormatter)
    return parser


def parse_words(words: Sequence[str]) -> argparse.Namespace:
    """Parse the words after `kinpole`; end the process for --help and for bad usage."""
    parser = make_parser(words[0] if words and words[0] in COMMANDS else None)
    if words and words[0] in COMMANDS:
        words = [words[0], *_files_first(words[1:], COMMANDS[words[0]].options)]
    elif words and not words[0].startswith('-') and words[0] != 'node':
        known = ['node', *COMMANDS]
        hint = did_you_mean(words[0], known)
        parser.error(f'no command {cut(words[0])}; {hint}known: {", ".join(known)}')
    options, rest = parser.parse_known_args(words)
    if rest:
        known = ['--help', *(option.name for option in COMMANDS[options.command].options)]
        hints = [did_you_mean(word, known) for word in rest if word.startswith('-')]
        hint = '; '.join(filter(None, [' '.join(rest), ''.join(hints).strip()]))
        parser.error(f'unrecognized arguments: {hint}')
    return options


def _files_first(words: Sequence[str], options: Sequence[Option]) -> list[str]:
    """
    Move the files of a command before its options.

    argparse gives an option with nargs='+' all words up to the next option, so files that come
    after such an option would become its values. Files that are missing elsewhere are taken from
    the last words of the option.
    """
    sizes = {option.name: option.values for option in options if option.name.startswith('-')}
    sizes['--help'] = 0
    files = sum(not option.name.startswith('-') for option in options)
    if '+' not in sizes.values() or not files or '--' in words:
        return list(words)
    file_words, greedy_runs = _split_words(words, sizes)
    missing = files - len(file_words)
    # The option keeps at least one value. Of several options, take the one that ends with a file.
    candidates = [run for run in reversed(greedy_runs) if len(run) > missing]
    if missing > 0 and candidates:
        run = max(candidates, key=lambda run: os.path.exists(words[run[-1]]))
        file_words = sorted([*file_words, *run[-missing:]])
    other_words = [word for k, word in enumerate(words) if k not in file_words]
    return [*(words[k] for k in file_words), *other_words]


def _split_words(words: Sequence[str], sizes: dict[str, Any]) -> tuple[list[int], list[list[int]]]:
    """Return the indices of words that belong to no option, and of those after greedy options."""
    free: list[int] = []
    greedy: list[list[int]] = []
    owned: Any = 0  # how many of the next words belong to the option before them; '+' is all
    for k, word in enumerate(words):
        if word.startswith('--') and '=' not in word:
            # argparse accepts the beginning of a name for the name.
            owned = next((size for name, size in sizes.items() if name.startswith(word)), 1)
            if owned == '+':
                greedy.append([])
        elif word.startswith('-') and not word[1:2].isdigit() and word != '-':
            owned = 0
        elif owned == '+':
            greedy[-1].append(k)
        elif owned:
            owned -= 1
        else:
            free.append(k)
    return free, greedy
