"""
The command `kinpole`: each subcommand checks its words, calls one function and tells the outcome.

Exit status 0 is done, 2 bad usage or bad input with one line on stderr. What a subcommand needs is
imported when it runs, so that --help comes at once.
"""

import argparse
import io
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinpole_ros import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator

# The products computed here are small. A BLAS that has them done by threads waits for these longer
# than it computes where other processes run: 207 us a frame of replay on 2 busy cores against 60.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

_EPILOG = """examples:
  kinpole simulate four_bar --output four_bar.mcap --noise 0.0002
  kinpole replay four_bar.mcap --config config/four_bar.yaml --output result.mcap
  kinpole batch runs/*.mcap --config rig.yaml --output results
  kinpole plot result.mcap --output result.png
  kinpole solve four_bar --sweep --centers --plot four_bar.png
  kinpole import tracked.csv --rate 240 --scale 0.001 --y-down --output markers.mcap
  kinpole node --ros-args --params-file config/kinpole.yaml
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit status."""
    words = list(sys.argv[1:] if args is None else args)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What a locale has no letter for, or a file name that is no text, is told by its number.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        if words[:1] == ['node'] and not {'-h', '--help'} & set(words):
            # All that follows belongs to ROS.
            from kinpole_ros.node import main as run_node

            return run_node(['kinpole', *words[1:]])
        options = _parser().parse_args(words)
        return int(options.run(options) or 0)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 0
    except Exception as error:
        # Interrupted in an extension, which raises an error of its own for it.
        if isinstance(error.__cause__, KeyboardInterrupt):
            return 130
        if not _is_for_the_user(error):
            raise
        print(f'kinpole {words[0]}: {_line(error)}', file=sys.stderr)
        return 2


def node() -> int:
    """Run the node as `ros2 run` and launch files do."""
    return main(['node', *sys.argv[1:]])


def _is_for_the_user(error: Exception) -> bool:
    """Whether it is one of our own one-line errors, not a bug that deserves its traceback."""
    from kinpole_ros.bags import BagError
    from kinpole_ros.mechanism import LinkageError, SceneError
    from kinpole_ros.parameters import ParameterError

    ours = (BagError, LinkageError, ParameterError, SceneError, OSError)
    return isinstance(error, ours) or _lacks_matplotlib(error)


def _lacks_matplotlib(error: object) -> bool:
    return isinstance(error, ImportError) and 'matplotlib' in str(error)


def _line(error: object) -> str:
    if _lacks_matplotlib(error):
        return "drawing needs matplotlib; install it with pip install 'kinpole_ros[plot]'"
    return ' '.join(str(error).split())


def _on_terminal() -> bool:
    """Whether somebody watches stderr, which may be closed."""
    return sys.stderr is not None and sys.stderr.isatty()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='kinpole',
        description='Planar kinematics of mechanisms from tracked markers: angular rates, poles '
        'and centrodes of every body, and between bodies, with their uncertainty.',
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'kinpole {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')

    node = commands.add_parser(
        'node',
        help='the live node',
        description='The live node. Everything after it goes to ROS: '
        'kinpole node --ros-args --params-file config/kinpole.yaml -r markers:=/mocap/markers',
    )
    node.set_defaults(run=lambda options: 0)

    replay = commands.add_parser(
        'replay',
        help='a bag of markers to results, as fast as the machine goes',
        description='Runs the markers of a bag through the same pipeline as the node. The same '
        'bag and parameters give the same figures every time. What is written before a kill or a '
        'full disk can be read; a Parquet table only when whole.',
    )
    replay.add_argument('bag', metavar='BAG', help='an .mcap file or a rosbag2 folder')
    replay.add_argument(
        '--config',
        metavar='FILE',
        help='ROS 2 parameter file, as for the node; without it one body, "body", of all markers',
    )
    replay.add_argument('--output', metavar='OUT.mcap', help='bag of results, under /kinpole/...')
    replay.add_argument(
        '--csv', metavar='OUT.csv', help='the same as a table, in SI units, with sigmas'
    )
    replay.add_argument(
        '--parquet',
        metavar='OUT.parquet',
        help="the same table for pandas and the like (pip install 'kinpole_ros[parquet]')",
    )
    replay.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")
    replay.set_defaults(run=_replay)

    batch = commands.add_parser(
        'batch',
        help='many bags, on all cores or a Dask cluster, and a table over all',
        description='Replays every bag by itself and writes summary.csv, a line a bag: frames,\n'
        'time span (s), noise (m), resets, share of instants with each pole, and what went wrong.\n'
        'A bag that fails is reported, and the rest go on. Run again, it does what is not done\n'
        'yet: results appear under their names only when whole, and stay as long as bag and\n'
        "settings are the same. Needs Dask: pip install 'kinpole_ros[batch]'.",
        epilog='examples:\n'
        '  kinpole batch runs/*.mcap --config rig.yaml --output results\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --parquet --workers 4\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --scheduler tcp://hub:8786\n'
        '\n'
        'A cluster is `dask scheduler` on one machine and `dask worker tcp://hub:8786 --nthreads 1`'
        '\non each of the others. All of them have kinpole_ros installed, and see bags and output\n'
        'under the same paths. Dask takes code from whoever reaches it: keep it inside your lab.\n'
        'Exit status: 0 all bags done, 2 some failed or are cut off; see the column error.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    batch.add_argument('bags', metavar='BAG', nargs='+', help='.mcap files and rosbag2 folders')
    batch.add_argument(
        '--config', metavar='FILE', help='ROS 2 parameter file for all of them, as for replay'
    )
    batch.add_argument(
        '--output', metavar='DIR', default='batch', help='folder for results and summary (batch)'
    )
    batch.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")
    batch.add_argument(
        '--mcap', action='store_true', help='a bag of results for each (if nothing else is asked)'
    )
    batch.add_argument('--csv', action='store_true', help='a CSV table for each')
    batch.add_argument('--parquet', action='store_true', help='a Parquet table for each')
    batch.add_argument(
        '--scheduler', metavar='ADDRESS', help='of a Dask cluster; without it, this machine'
    )
    batch.add_argument('--workers', type=int, metavar='N', help='processes here (one a core)')
    batch.set_defaults(run=_batch)

    simulate = commands.add_parser(
        'simulate',
        help='a bag of markers from a mechanism, with the exact answer beside it',
        description='Writes markers on /markers and the exact motion on /kinpole/truth/...',
    )
    simulate.add_argument(
        'scene', metavar='SCENE', help='a file, or the name of one in config/scenes: see --list'
    )
    simulate.add_argument('--list', action=_ListScenes, help='name the scenes that come along')
    simulate.add_argument('--output', metavar='BAG', required=True, help='.mcap file to write')
    simulate.add_argument('--rate', type=float, default=200.0, metavar='HZ', help='frames (200)')
    simulate.add_argument('--duration', type=float, default=5.0, metavar='S', help='length (5)')
    simulate.add_argument(
        '--noise', type=float, default=0.0, metavar='M', help='noise of a marker per axis, m (0)'
    )
    simulate.add_argument('--seed', type=int, default=0, metavar='N', help='of the noise (0)')
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
        help='marker_array (the default), marker, pose_array or point_cloud2',
    )
    simulate.set_defaults(run=_simulate)

    solve = commands.add_parser(
        'solve',
        help='the analysis of a mechanism: motion, dead points, centers, forces',
        description='Solves a scene exactly: positions and rates at time 0, at a value of its '
        'driver, or over its whole range, with limits and dead points.',
        epilog='examples:\n'
        '  kinpole solve four_bar --at "45 deg" --centers\n'
        '  kinpole solve slider_crank --sweep --csv crank.csv --plot crank.png\n'
        '  kinpole solve loader_cylinder --statics\n'
        '  kinpole solve antiparallelogram --pitch crank follower gears.svg\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    solve.add_argument('scene', metavar='SCENE', help='name or path of a scene, see simulate')
    where = solve.add_mutually_exclusive_group()
    where.add_argument('--at', metavar='VALUE', help='value of the driver: 0.5, "45 deg", "12 cm"')
    where.add_argument('--sweep', action='store_true', help='the whole range of the driver')
    solve.add_argument('--centers', action='store_true', help='instant centers, as deduced by hand')
    solve.add_argument('--statics', action='store_true', help='what drivers and joints bear')
    solve.add_argument('--csv', metavar='FILE', help='all figures as a table, SI units')
    solve.add_argument('--plot', metavar='FILE.png', help='the linkage, and rates over the range')
    solve.add_argument(
        '--pitch',
        nargs=3,
        metavar=('BODY', 'BODY', 'FILE'),
        help='centrodes of two bodies as pitch curves: .csv, or .svg true to scale',
    )
    solve.set_defaults(run=_solve)

    plot = commands.add_parser(
        'plot',
        help='a picture of a result bag',
        description='Draws centrodes, poles and rates with their bands.',
    )
    plot.add_argument('bag', metavar='BAG', help='bag of results, from replay or recorded live')
    plot.add_argument('--output', metavar='FILE.png', required=True, help='picture to write')
    plot.set_defaults(run=_plot)

    imported = commands.add_parser(
        'import',
        help='tracked points from a spreadsheet to a bag',
        description='Columns NAME_x, NAME_y and maybe NAME_z make the marker NAME; empty cells are '
        'markers that were not seen. Column t holds seconds, unless --rate is given.',
    )
    imported.add_argument('csv', metavar='CSV', help='the table')
    imported.add_argument('--output', metavar='BAG', required=True, help='.mcap file to write')
    imported.add_argument('--rate', type=float, metavar='HZ', help='frames per second')
    imported.add_argument(
        '--scale', type=float, default=1.0, metavar='M_PER_UNIT', help='m per unit of the table (1)'
    )
    imported.add_argument(
        '--y-down', action='store_true', help='y of the table points down, as in pictures'
    )
    imported.set_defaults(run=_import)

    play = commands.add_parser(
        'play',
        help='publish a bag, where there is no ros2 bag play',
        description='Publishes a bag at the pace it was recorded, once somebody listens.',
    )
    play.add_argument('bag', metavar='BAG', help='an .mcap file or a rosbag2 folder')
    play.add_argument('--topic', action='append', metavar='T', help='only this one; repeatable')
    play.add_argument('--speed', type=float, default=1.0, metavar='X', help='times the pace (1)')
    play.set_defaults(run=_play)

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
    record.set_defaults(run=_record)

    demo = commands.add_parser(
        'demo',
        help='the main job, shown: node, bag, recording and picture',
        description='Starts the node, plays a bag of a four-bar into it, records what it '
        'publishes, prints a table and draws a picture.',
    )
    demo.add_argument('--output', metavar='FOLDER', default='out', help='where to write (out)')
    demo.set_defaults(run=_demo)

    bench = commands.add_parser(
        'bench',
        help='measure errors, uncertainty, peers and limits, and draw the charts of the docs',
        description='Writes benchmarks.md and charts/ anew. Takes several minutes; wants '
        'matplotlib, and compares with PyNumDiff where it is installed: '
        "pip install 'kinpole_ros[bench]'.",
    )
    bench.add_argument('--output', metavar='FOLDER', default='docs', help='where to write (docs)')
    bench.add_argument('--quick', action='store_true', help='little data: shows that it works')
    bench.add_argument(
        '--long', action='store_true', help='only the run of 1e7 frames: some minutes'
    )
    bench.add_argument(
        '--soak',
        type=float,
        metavar='MINUTES',
        help='only the live node, for so long at 500 Hz with dropouts, outliers and clock jumps',
    )
    bench.set_defaults(run=_bench)
    return parser


class _ListScenes(argparse.Action):
    """--list: print the scenes and end, as --version does."""

    def __init__(self, **words: Any) -> None:
        super().__init__(nargs=0, **words)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from kinpole_ros.mechanism import scene_names

        print('\n'.join(scene_names()))
        parser.exit()


def _replay(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import replay, warnings_of
    from kinpole_ros.parameters import Settings, load_settings

    outputs = (options.output, options.csv, options.parquet)
    _keep(options.config, *outputs)
    settings = load_settings(options.config) if options.config else Settings()
    with _progress('replay') as progress:
        result = replay(
            options.bag,
            settings,
            options.output,
            options.csv,
            options.topic,
            progress,
            options.parquet,
        )
    print(f'{result.frames} frames in, {result.estimates} instants out')
    for what, count in (
        ('stamps repeated', result.repeated),
        ('frames late', result.late),
        ('jumps', result.resets),
        ('changes of frame_id', result.frame_changes),
    ):
        if count:
            print(f'{what}: {count}')
    for body, shares in result.determined.items():
        told = ', '.join(f'{pole} {share:.1%}' for pole, share in shares.items())
        print(f'{body}: determined at {told} of them')
    for target in outputs:
        if target:
            print(f'written to {target}')
    for line in warnings_of(result, settings):
        print(f'kinpole replay: {line}', file=sys.stderr)
    if result.truncated is not None:
        print(f'kinpole replay: {_line(result.truncated)}', file=sys.stderr)
    lost = any(len(settings.bodies[b]) - len(names) < 2 for b, names in result.absent.items())
    return 2 if result.truncated is not None or lost or not result.estimates else 0


def _batch(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import BagError
    from kinpole_ros.batch import KINDS, batch
    from kinpole_ros.parameters import Settings, load_settings

    if options.workers is not None and options.workers < 1:
        raise BagError(f'--workers is {options.workers}; it must be 1 or more')
    if options.workers is not None and options.scheduler is not None:
        raise BagError('--workers is for this machine alone; leave it out with --scheduler')
    settings = load_settings(options.config) if options.config else Settings()
    kinds = [kind for kind in KINDS if getattr(options, kind)] or ['mcap']

    def report(row: dict[str, Any]) -> None:
        for trouble in (row['error'], row.get('truncated'), row.get('warnings')):
            if trouble:
                name = '' if row['bag'] in trouble else f'{row["bag"]}: '
                clear = _cleared() if _on_terminal() else ''
                print(f'{clear}kinpole batch: {name}{_line(trouble)}', file=sys.stderr)

    with _progress('batch') as progress:
        rows = batch(
            options.bags,
            options.output,
            settings,
            options.topic,
            kinds,
            options.scheduler,
            options.workers,
            progress,
            report,
        )
    failed = sum(bool(row['error']) for row in rows)
    cut = sum(bool(row.get('truncated')) for row in rows)
    frames = sum(row.get('frames', 0) for row in rows)
    print(f'{len(rows)} bags, {failed} failed, {cut} cut off; {frames} frames in')
    print(f'written to {options.output}, with a table over all in {options.output}/summary.csv')
    return 2 if failed or cut else 0


def _keep(given: str | None, *outputs: str | None) -> None:
    """Refuse to write over a file that is read."""
    from kinpole_ros.bags import BagError

    if given is not None and Path(given).resolve() in {Path(o).resolve() for o in outputs if o}:
        raise BagError(f'{given} is to be read; name another file to write')


def _simulate(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import simulate
    from kinpole_ros.mechanism import load_scene

    _keep(options.scene, options.output)
    scene = load_scene(options.scene)
    with _progress('simulate') as progress:
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
            progress=progress,
        )
    print(f'{count} frames of {", ".join(scene.markers)} written to {options.output}')
    return 0


def _plot(options: argparse.Namespace) -> int:
    from kinpole_ros.plot import plot

    with _progress('plot') as progress:
        plot(options.bag, options.output, progress)
    print(f'drawn to {options.output}')
    return 0


def _import(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import import_csv

    with _progress('import') as progress:
        count = import_csv(
            options.csv,
            options.output,
            rate=options.rate,
            scale=options.scale,
            y_down=options.y_down,
            progress=progress,
        )
    print(f'{count} frames written to {options.output}')
    return 0


def _play(options: argparse.Namespace) -> int:
    from kinpole_ros.live import play

    with _progress('play') as progress:
        count = play(options.bag, options.topic, options.speed, progress=progress)
    print(f'{count} messages played')
    return 0


def _record(options: argparse.Namespace) -> int:
    from kinpole_ros.live import record

    count = record(options.output, options.topic or ['/kinpole/', '/diagnostics'])
    print(f'{count} messages written to {options.output}')
    return 0


def _solve(options: argparse.Namespace) -> int:
    from kinpole_ros.solve import solve_scene

    lines = solve_scene(
        options.scene,
        options.at,
        options.sweep,
        options.centers,
        options.statics,
        options.csv,
        options.plot,
        options.pitch,
    )
    print('\n'.join(lines))
    return 0


def _demo(options: argparse.Namespace) -> int:
    from kinpole_ros.demo import demo

    return demo(options.output)


def _bench(options: argparse.Namespace) -> int:
    from kinpole_ros.bench import bench, bench_long, bench_soak

    with _progress('bench') as progress:
        if options.long:
            written = bench_long(options.output, progress)
        elif options.soak is not None:
            written = bench_soak(options.output, options.soak, progress)
        else:
            written = bench(options.output, options.quick, progress)
    for path in written:
        print(f'written to {path}')
    return 0


@contextmanager
def _progress(what: str) -> 'Iterator[Callable[[float], None] | None]':
    """A bar on a terminal, nothing in a pipe."""
    if not _on_terminal():
        yield None
        return
    start = shown = time.monotonic()

    def show(share: float) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < 0.1 and share < 1:
            return
        shown = now
        left = (now - start) * (1 - share) / share if share > 0.01 else float('nan')
        bar = '#' * round(30 * share)
        tail = f'{left:4.0f} s left' if left == left else ''
        text = f'{what} [{bar:<30}] {share:4.0%} {tail:12}'[: _width()]
        print(f'\r{text}', end='', file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        print(_cleared(), end='', file=sys.stderr, flush=True)


def _width() -> int:
    """Columns of a line of progress: one that wraps is not gone back over."""
    return min(70, shutil.get_terminal_size().columns - 1)


def _cleared() -> str:
    return f'\r{"":{_width()}}\r'


if __name__ == '__main__':
    sys.exit(main())
