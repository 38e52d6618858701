"""A bag of exact or noisy markers from a mechanism."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._shared import (
    check_ending,
    check_outputs,
    progress_bar,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    simulate = commands.add_parser(
        'simulate',
        help='a bag of markers from a mechanism, with the exact answer in it',
        description='Writes markers on /markers and the exact motion on /kinpole/truth/... (m, in '
        'the frame of the markers, under the stamp of its frame). Noise, dropout, jitter, arrival, '
        'tilt, scale and unlabeled spoil the markers as real rigs do.',
    )
    simulate.add_argument(
        'scene', metavar='SCENE', help='a file, or the name of one in config/scenes: see --list'
    )
    simulate.add_argument('--list', action=_ListScenes, help='name the scenes that come along')
    simulate.add_argument('--output', metavar='BAG', required=True, help='.mcap file to write')
    simulate.add_argument(
        '--rate', type=float, default=200.0, metavar='HZ', help='frames per second (200)'
    )
    simulate.add_argument('--duration', type=float, default=5.0, metavar='S', help='length, s (5)')
    simulate.add_argument(
        '--noise', type=float, default=0.0, metavar='M', help='noise of a marker per axis, m (0)'
    )
    simulate.add_argument(
        '--seed', type=int, default=0, metavar='N', help='seed of all that is random (0)'
    )
    simulate.add_argument(
        '--dropout', type=float, default=0.0, metavar='P', help='share of markers not seen (0)'
    )
    simulate.add_argument(
        '--jitter',
        type=float,
        default=0.0,
        metavar='S',
        help='how unevenly the frames are taken, s (0); the stamps tell the true instants',
    )
    simulate.add_argument(
        '--message',
        default='marker_array',
        metavar='TYPE',
        help='marker_array (the default), marker, pose_array or point_cloud2; or poses of the '
        'bodies: pose_stamped, body_poses or tf',
    )
    simulate.add_argument(
        '--arrival',
        type=float,
        default=0.0,
        metavar='S',
        help='stamps are late by a random time of this mean, exponential, s (0); the frames come '
        'in the order in which they were taken',
    )
    simulate.add_argument(
        '--tilt',
        type=float,
        default=0.0,
        metavar='DEG',
        help='turns the plane of the motion about the x axis, degrees (0)',
    )
    simulate.add_argument(
        '--scale',
        type=float,
        default=1.0,
        metavar='F',
        help='times by which the markers are larger than in m: 1000 for mm (1)',
    )
    simulate.add_argument(
        '--unlabeled',
        action='store_true',
        help='points without names, in random order in each frame; those not seen leave no gap',
    )


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.bags import simulate
    from kinpole_ros.mechanism import load_scene

    check_outputs([options.scene], [options.output])
    check_ending('--output', options.output, 'an MCAP bag')
    scene = load_scene(options.scene)
    with progress_bar('simulate') as progress:
        count = simulate(
            scene,
            options.output,
            rate=options.rate,
            duration=options.duration,
            noise=options.noise,
            seed=options.seed,
            dropout=options.dropout,
            jitter=options.jitter,
            message=options.message,
            arrival=options.arrival,
            tilt=options.tilt,
            scale=options.scale,
            unlabeled=options.unlabeled,
            progress=progress,
        )
    print(f'{count} frames of {", ".join(scene.markers)} written to {options.output}')
    return 0


class _ListScenes(argparse.Action):
    """--list: print the scenes and end, as --version does."""

    def __init__(self, **words: Any) -> None:
        super().__init__(nargs=0, **words)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from kinpole_ros.mechanism import scene_names

        print('\n'.join(scene_names()))
        parser.exit()
