"""A scene's dimensions from measured markers."""

import argparse
import os
from collections.abc import Sequence
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.tools.commands._shared import (
    check_ending,
    keep,
    progress_bar,
    reported,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    fit = commands.add_parser(
        'fit',
        help="a scene's dimensions from measured markers, each with its deviation",
        description='Fits points, lengths and angles of a scene to the poses of its bodies in all\n'
        'frames, whatever drives them: least squares over what the joints lack. What the data do\n'
        'not tell stays as it is, and is named. Markers sit where the scene has them.',
        epilog='examples:\n'
        '  kinpole fit rig.yaml run.mcap\n'
        '  kinpole fit rig.yaml run.mcap --free rocker.B coupler --output fitted.yaml\n'
        '  kinpole fit --free rocker.B,coupler rig.yaml run.mcap\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    fit.add_argument('scene', metavar='SCENE', help='a file, or a name, see simulate')
    fit.add_argument('bag', metavar='BAG', help='an .mcap file or a rosbag2 folder')
    fit.add_argument(
        '--config',
        metavar='FILE',
        help="ROS 2 parameter file, as for the node; without it the scene's bodies and markers",
    )
    fit.add_argument(
        '--free',
        action='append',
        nargs='+',
        metavar='NAME',
        help='what to fit: a point (rocker.B), a length (r2.length), or all of a body, vector or '
        'joint; repeatable, and commas separate too (the list free of the scene, or all)',
    )
    fit.add_argument('--output', metavar='SCENE.yaml', help='the scene, as fitted, to write')
    fit.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.tools.fit import fit_bag

    keep(options.config, options.output)
    check_ending('--output', options.output, 'a YAML file')
    troubles: list[object] = []
    with progress_bar('fit') as progress:
        lines = fit_bag(
            options.scene,
            options.bag,
            options.config,
            [name.split(',') for names in options.free or [] for name in names],
            options.output,
            options.topic,
            progress,
            troubles.append,
        )
    print('\n'.join(map(printable, lines)))
    return reported('fit', troubles)


def arrange_words(words: Sequence[str]) -> list[str]:
    """
    Move SCENE and BAG before all options, so that --free does not take them for names.

    argparse gives an option with several values every word up to the next option. SCENE and BAG
    that are missing elsewhere are therefore the last words of a --free.

    Parameters
    ----------
    words : sequence of str
        The words after `kinpole fit`.

    Returns
    -------
    list of str
        The same words, SCENE and BAG first.
    """
    if '--' in words:  # then the words are told apart already
        return list(words)
    places, runs = _places_of(words)
    lacking = 2 - len(places)
    if lacking > 0:
        # A --free keeps one name at least. Of several, it is the one that ends with a file.
        able = [run for run in reversed(runs) if len(run) > lacking]
        if able:
            run = max(able, key=lambda run: os.path.exists(words[run[-1]]))
            places = sorted([*places, *run[-lacking:]])
    rest = [word for k, word in enumerate(words) if k not in places]
    return [*(words[k] for k in places), *rest]


def _places_of(words: Sequence[str]) -> tuple[list[int], list[list[int]]]:
    """Indices of the words that belong to no option, and of those after each --free."""
    places: list[int] = []
    runs: list[list[int]] = []
    # How many of the next words belong to the option before them; -1 is all up to the next option.
    owned = 0
    for k, word in enumerate(words):
        if word.startswith('-') and word != '-':
            owned = 0 if '=' in word or word in ('-h', '--help') else 1
            if owned and len(word) > 2 and '--free'.startswith(word):
                runs.append([])
                owned = -1
        elif owned < 0:
            runs[-1].append(k)
        elif owned:
            owned = 0
        else:
            places.append(k)
    return places, runs
