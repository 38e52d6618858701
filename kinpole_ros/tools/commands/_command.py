"""How a subcommand of `kinpole` is declared: its options, and a docstring that is its --help."""

import argparse
import textwrap
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, NamedTuple

Run = Callable[[argparse.Namespace], int]


class Option(NamedTuple):
    """
    One positional argument or option: what `argparse.add_argument` takes.

    `values` is the number of words that follow the name, '+' for all up to the next option.
    """

    name: str
    values: int | str
    settings: dict[str, Any]


class Command:
    """A subcommand: `run` does its work and returns the exit status."""

    def __init__(self, run: Run, entries: Iterable[Option | list[Option]]) -> None:
        self.run = run
        self._entries = list(entries)

    @property
    def options(self) -> list[Option]:
        """All options, exclusive ones too."""
        groups = [entry if isinstance(entry, list) else [entry] for entry in self._entries]
        return [option for group in groups for option in group]

    def add_parser(self, name: str, subparsers: Any, formatter: type) -> None:
        """
        Add the parser of the command.

        The first paragraph of the docstring of `run` is the summary in `kinpole --help`, and the
        paragraphs from 'Examples:' on stand below the options.
        """
        text = textwrap.dedent(self.run.__doc__ or '').strip()
        summary, _, details = text.partition('\n\n')
        description, _, examples = details.partition('Examples:')
        summary = ' '.join(summary.split())
        parser = subparsers.add_parser(
            name,
            help=summary.rstrip('.'),
            description=f'{summary}\n\n{description.strip()}'.strip(),
            epilog=f'examples:{examples}' if examples else None,
            formatter_class=formatter,
        )
        for entry in self._entries:
            if isinstance(entry, list):
                group = parser.add_mutually_exclusive_group()
                for one in entry:
                    group.add_argument(one.name, **one.settings)
            else:
                parser.add_argument(entry.name, **entry.settings)


COMMANDS: dict[str, Command] = {}


def command(name: str, *options: Option | list[Option]) -> Callable[[Run], Run]:
    """Declare a function to be the subcommand `name`; a list holds exclusive options."""

    def declare(run: Run) -> Run:
        COMMANDS[name] = Command(run, options)
        return run

    return declare


def option(usage: str, text: str, kind: Any = str, default: Any = None, **settings: Any) -> Option:
    """
    Return an option or positional argument with values of the type `kind`.

    `usage` is its name and a word for each value: '--rate HZ', '--free NAME...' for one or more.
    """
    name, *words = usage.split()
    settings |= {'help': text, 'type': kind, 'default': default}
    if words and words[-1].endswith('...'):
        settings |= {'nargs': '+', 'metavar': words[-1].removesuffix('...')}
    elif len(words) > 1:
        settings |= {'nargs': len(words), 'metavar': tuple(words)}
    elif words:
        settings['metavar'] = words[0]
    return Option(name, settings.get('nargs', 1), settings)


def measured(kind: str, unit: str) -> Callable[[str], float]:
    """Return what reads a number in `unit`, or with a unit of its own as scenes have them."""

    def read(text: str) -> float:
        from kinpole_ros.mechanism import SceneError, quantity
        from kinpole_ros.mechanism._scene_values import UNITS

        with suppress(ValueError):
            return float(text)
        try:
            return quantity('it', text, kind) / UNITS[kind][unit]
        except SceneError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


LENGTH, TIME = measured('length', 'm'), measured('time', 's')
FREQUENCY, DEGREES = measured('frequency', 'Hz'), measured('angle', 'deg')


def _scale(text: str) -> float | tuple[float, float]:
    """Read a number, or the two sides of a picture."""
    sides = text.split(',')
    return (float(sides[0]), float(sides[1])) if len(sides) == 2 else float(text)


def flag(name: str, text: str, action: Any = 'store_true') -> Option:
    """Return an option without a value."""
    return Option(name, 0, {'action': action, 'help': text})


BAG = option('bag BAG', 'an .mcap or .db3 file, or a rosbag2 folder')
SCENE = option('scene SCENE', 'a scene file, or a name that `kinpole simulate --list` prints')
CONFIG = option('--config FILE', 'ROS 2 parameter file, as for the node')
SET = option(
    '--set NAME:=VALUE',
    'override a parameter of the file, as `ros2 run` does after -p; repeatable',
    default=[],
    action='append',
)
TOPIC = option('--topic T', "topic of the markers (the parameter file's, or /markers)")
BAG_OUTPUT = option('--output BAG', '.mcap file to write', required=True)
# Options for data that a file of points may lack.
POINT_OPTIONS = (
    option(
        '--rate HZ', 'frames per second of a file of points or a film, not its times', FREQUENCY
    ),
    option(
        '--scale M_PER_UNIT',
        'meters per unit of a file of points (as it says); WIDTH,HEIGHT of a picture in shares',
        _scale,
    ),
    flag(
        '--y-down',
        'y points down in a file of points, as in pictures (as its format has it)',
        argparse.BooleanOptionalAction,
    ),
)
# What a film does not tell.
FILM_OPTIONS = (
    option('--size M', 'side of the black square of a tag, m, or as 40mm (0.04)', LENGTH),
    option('--ground ID...', 'tags that stand still; the first is the origin (0)', int),
    option('--family NAME', 'family of the tags, as 36h11 (auto: by what is seen)'),
    option('--camera FILE', 'file of the camera, as OpenCV, ROS, Kalibr or Anipose write it'),
    option('--line-time S', 'time between two rows of a rolling shutter, s, or as 20us (0)', TIME),
)
