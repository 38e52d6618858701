"""Commands around a running node: view, play, record, demo; and bench."""

import argparse
import sys
from pathlib import Path

from kinpole_ros.tools.commands._command import BAG, BAG_OUTPUT, command, flag, option
from kinpole_ros.tools.commands._output_files import check_ending
from kinpole_ros.tools.commands._terminal import progress_bar


@command(
    'view',
    option('--topic NAME', 'a node, its namespace, or one of its topics (the first node found)'),
    option('--port N', 'port on 127.0.0.1 (a free one)', int, 0),
)
def view(options: argparse.Namespace) -> int:
    """
    Show the results of a running node live in a browser.

    Serves the page of a report, live, to browsers on this machine: 30 times a second bodies, poles
    with their ellipses, velocities and rates, of a node anywhere in the ROS graph. Prints the
    address to open, which has a token in it. The node sends one message per frame for the page,
    after all other results, and only while a page is open.

    Examples:
      kinpole view
      kinpole view --topic /rig2 --port 8080

    From another machine: ssh -L 8080:127.0.0.1:8080 RIG, then open the address there.
    """
    from kinpole_ros.tools.view import view as serve_view

    serve_view(options.topic or '', options.port)
    return 0


@command(
    'play',
    BAG,
    option('--topic T', 'publish only this topic; repeatable', action='append'),
    option('--speed X', 'play X times as fast as it was recorded (1)', float, 1.0),
    flag('--loop', 'repeat until Ctrl-C; the stamps increase from loop to loop'),
    option(
        '--subscribers N',
        'begin when each topic has N subscribers (when those found stay the same for 1 s)',
        int,
    ),
    option(
        '--clock HZ',
        'publish the time of the bag on /clock too, for nodes with use_sim_time (40 Hz)',
        float,
        nargs='?',
        const=40.0,
    ),
)
def play(options: argparse.Namespace) -> int:
    """
    Publish a bag, where there is no ros2 bag play.

    Publishes a bag at the pace it was recorded, once there are subscribers, or after 10 s.
    """
    from kinpole_ros.ros.player import play as play_bag

    with progress_bar('play') as progress:
        count = play_bag(
            options.bag,
            options.topic,
            options.speed,
            progress=progress,
            loop=options.loop,
            clock=options.clock,
            subscribers=options.subscribers,
        )
    print(f'{count} messages played')
    return 0


@command(
    'record',
    BAG_OUTPUT,
    option(
        '--topic PREFIX',
        'beginning of the topics to record; repeatable (/kinpole/ and /diagnostics)',
        action='append',
    ),
)
def record(options: argparse.Namespace) -> int:
    """
    Record the results of a running node, where there is no ros2 bag record.

    Records until Ctrl-C. A killed recorder loses at most the last second.
    """
    from kinpole_ros.ros.recorder import record as record_topics

    check_ending('--output', options.output, 'an MCAP bag')
    count = record_topics(options.output, options.topic or ['/kinpole/', '/diagnostics'])
    print(f'{count} messages written to {options.output}')
    return 0


@command('demo', option('--output FOLDER', 'where to write (out)', default='out'))
def demo(options: argparse.Namespace) -> int:
    """
    Run a node on a bag, and show a table and a picture of its results.

    Starts the node, plays a bag of a four-bar into it, records what it publishes, prints a table
    and draws a picture.
    """
    print('starting a node, a recorder and a player ...', flush=True)
    from kinpole_ros.tools.demo import demo as run_demo

    return run_demo(options.output)


@command(
    'bench',
    option('--output FOLDER', 'where to write (docs)', default='docs'),
    flag('--quick', 'use little data, only to see that it works'),
    [
        option(
            '--only PART...',
            'measure only these parts, and copy the others from the pages as they are: costs, '
            'speed, live, hindsight, peers, lag, model, pynumdiff, rates, spectra, atlas, '
            'pendulum, rigs',
        ),
        flag('--pages', 'measure nothing: make pages and charts from charts/*.csv'),
        flag('--long', 'only the run of 1e7 frames: some minutes'),
        flag(
            '--rigs', 'only the faults of real rigs, from late stamps to soft tissue: two minutes'
        ),
        option(
            '--soak MINUTES',
            'only the live node, for this time at 500 Hz with dropouts, outliers and clock jumps',
            float,
        ),
    ],
)
def bench(options: argparse.Namespace) -> int:
    """
    Measure errors, uncertainty, other methods and limits, and draw the charts of the docs.

    Writes benchmarks.md, benchmarks-tables.md and charts/ anew. Takes a quarter of an hour on two
    cores. Needs matplotlib, and compares with PyNumDiff where it is installed (pip install
    matplotlib pynumdiff scipy).
    """
    # The package bench is next to kinpole_ros in a checkout, and not installed.
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
    from bench import PARTS, bench_long, bench_soak, make_pages
    from bench import bench as run_bench

    with progress_bar('bench') as progress:
        if options.long:
            written = bench_long(options.output, progress)
        elif options.soak is not None:
            written = bench_soak(options.output, options.soak, progress)
        elif options.pages:
            written = make_pages(options.output)
        else:
            only = ['rigs'] if options.rigs else options.only or PARTS
            written = run_bench(options.output, options.quick, progress, only)
    for path in written:
        print(f'written to {path}')
    return 0
