"""
The command `kinpole`: each subcommand checks its words, calls one function and tells the outcome.

Exit status 0 is done, 2 bad usage or bad input with one line on stderr. What a subcommand needs is
imported when it runs, so that --help comes at once.
"""

import argparse
import io
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinpole_ros.files import cut_line, printable
from kinpole_ros.tools.usage import make_parser

if TYPE_CHECKING:
    from collections.abc import Iterator

    from kinpole_ros.linkage.positions import PositionsFound
    from kinpole_ros.pipeline.parameters import Settings

# The products computed here are small. A BLAS that has them done by threads waits for these longer
# than it computes where other processes run: 207 us a frame of replay on 2 busy cores against 60.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# Packages that may be missing, and how to come by them.
_FIXES = {
    'bench': 'the benchmarks are in a checkout of the source, not in an installed package: run '
    'kinpole bench from one, after pip install --editable .',
    'matplotlib': "drawing needs matplotlib; install it with pip install 'kinpole_ros[plot]'",
    'mcap': "reading and writing bags needs mcap; install it with pip install 'mcap>=1.5'",
}
# Characters: a bag may have any number of topics, and markers, with any names.
_LONGEST_LINE = 5000
# What SIGTERM ends as Ctrl-C does: nothing is left of results that are not whole, and of a player
# others do not believe for many seconds that it is there.
_ENDED = ('replay', 'simulate', 'solve', 'discover', 'plot', 'import', 'play')
_NO_ROS = (
    'source a ROS 2 installation first, or the .venv that `make demo` sets up, or get the wheels '
    "for Linux on x86-64 with pip install 'kinpole_ros[ros]'"
)


def main(args: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit status."""
    words = list(sys.argv[1:] if args is None else args)
    _fill_closed()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What a locale has no letter for, or a file name that is no text, is shown by its number.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        if words[:1] == ['node'] and not {'-h', '--help'} & set(words):
            # All that follows belongs to ROS.
            from kinpole_ros.ros.node import main as run_node

            return run_node(['kinpole', *words[1:]])
        options = make_parser().parse_args(words)
        with _ended_by_sigterm() if options.command in _ENDED else nullcontext():
            return _COMMANDS[options.command](options)
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


@contextmanager
def _ended_by_sigterm() -> 'Iterator[None]':
    """Have SIGTERM end it in good order meanwhile."""
    here = threading.current_thread() is threading.main_thread()
    end = lambda number, _: sys.exit(128 + number)  # noqa: E731
    before = signal.signal(signal.SIGTERM, end) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGTERM, before)


def node() -> int:
    """Run the node as `ros2 run` and launch files do."""
    return main(['node', *sys.argv[1:]])


def _fill_closed() -> None:
    """Open what is closed of stdin to stderr: else a bag takes its place, and gets the output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)


def _is_for_the_user(error: Exception) -> bool:
    """Whether it is one of our own one-line errors, not a bug that deserves its traceback."""
    if isinstance(error, OSError | MemoryError) or _package_missing(error):
        return True
    from kinpole_ros.mechanism import LinkageError, SceneError
    from kinpole_ros.pipeline.parameters import ParameterError

    ours: tuple[type[Exception], ...] = (LinkageError, ParameterError, SceneError)
    with suppress(ImportError):  # without mcap, nothing can have raised it
        from kinpole_ros.bags import BagError

        ours = (*ours, BagError)
    return isinstance(error, ours)


def _package_missing(error: object) -> str:
    """The package, not one of ours, that could not be imported; '' if that is not the error."""
    name = (error.name or '') if isinstance(error, ImportError) else ''
    package = name.partition('.')[0]
    return '' if package == 'kinpole_ros' else package


def _line(error: object) -> str:
    if package := _package_missing(error):
        ros = package == 'rclpy' or package.endswith(('_msgs', '_interfaces'))
        fix = _NO_ROS if ros else f'install it with pip install {package}'
        return _FIXES.get(package, f'the Python package {package} cannot be imported; {fix}')
    text = cut_line(printable(' '.join(str(error).split())), _LONGEST_LINE)
    if isinstance(error, OSError) and error.strerror:
        # From wherever nobody had words of his own for it.
        fix = 'check the path, its rights and the space on the disk'
        return f'{error.filename or "a file"} cannot be used: {error.strerror}; fix: {fix}'
    if isinstance(error, MemoryError):
        return f'the memory is too small for this ({text or "full"}); fix: do it in shorter parts'
    return text


def _told(command: str, troubles: list[object]) -> int:
    """Tell what a bag lacks of which all the rest was used; the exit status."""
    for trouble in troubles:
        print(f'kinpole {command}: {_line(trouble)}', file=sys.stderr)
    return 2 if troubles else 0


def _on_terminal() -> bool:
    """Whether somebody watches stderr, which may be closed."""
    return sys.stderr is not None and sys.stderr.isatty()


def _replay(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import replay, warnings_of
    from kinpole_ros.messages import plane_words
    from kinpole_ros.rigid.plane import AXES

    outputs = (options.output, options.csv, options.parquet)
    _keep(options.config, *outputs)
    settings = _settings(options)
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
        ('frames lost on the way', result.lost),
        ('jumps', result.resets),
        ('changes of frame_id', result.frame_changes),
    ):
        if count:
            print(f'{what}: {count}')
    if (state := result.stamps) is not None:
        used = ', regularized' if state.regularized else ''
        print(
            f'stamps: every {state.interval * 1e3:.6g} ms, jitter {state.jitter * 1e3:.3g} ms rms, '
            f'{state.largest * 1e3:.3g} ms at most{used}'
        )
    for body, shares in result.determined.items():
        listed = ', '.join(f'{pole} {share:.1%}' for pole, share in shares.items())
        print(f'{body}: determined at {listed} of them')
    for row in result.scene_deviations:
        print(
            f'{row.subject}: {row.what} {row.rms:.2g} {row.unit}, {row.deviations:.1f} deviations '
            f'(rms of {row.instants} instants)'
        )
    for line in _positions_lines(result.scene_positions):
        print(line)
    for target in outputs:
        if target:
            print(f'written to {target}')
    if result.space.plane is not None and settings.plane not in AXES:
        print(f'plane: {plane_words(result.space.plane)}')
    for line in warnings_of(result, settings):
        print(f'kinpole replay: {_line(line)}', file=sys.stderr)
    if result.truncated is not None:
        print(f'kinpole replay: {_line(result.truncated)}', file=sys.stderr)
    return 2 if result.truncated is not None or result.unknown else 0


def _positions_lines(found: 'PositionsFound | None') -> 'Iterator[str]':
    """How far the joints of the scene are off, and whether that is its fault."""
    if found is None:
        return
    for joint in found.joints:
        yield (
            f'joint {joint.joint}: off {joint.rms:.2g} m, {joint.deviations:.1f} deviations, rms '
            f'over {joint.instants} instants'
        )
    verdict = 'differs from what is measured' if found.words else 'agrees with what is measured'
    yield (
        f'the scene {verdict}: residuals are {found.ratio**0.5:.3g} times their noise, over '
        f'{found.instants} instants'
    )


def _batch(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import BagError
    from kinpole_ros.bags.batch import KINDS, batch, listed_bags

    if options.workers is not None and options.workers < 1:
        raise BagError(f'--workers is {options.workers}; it must be 1 or more')
    if options.workers is not None and options.scheduler is not None:
        raise BagError('--workers is for this machine alone; leave it out with --scheduler')
    bags = [*options.bags, *(listed_bags(options.list) if options.list else [])]
    if not bags:
        raise BagError('no bags are named; give some, or a file that names them by --list')
    settings = _settings(options)
    kinds = [kind for kind in KINDS if getattr(options, kind)] or ['mcap']

    def report(row: dict[str, Any]) -> None:
        for trouble in (row['error'], row.get('truncated'), row.get('warnings')):
            if trouble:
                name = '' if row['bag'] in trouble else f'{row["bag"]}: '
                clear = _cleared() if _on_terminal() else ''
                print(f'{clear}kinpole batch: {_line(f"{name}{trouble}")}', file=sys.stderr)

    with _progress('batch') as progress:
        rows = batch(
            bags,
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
    lacking = sum(bool(row.get('unknown')) for row in rows)
    frames = sum(row.get('frames', 0) for row in rows)
    lack = f', {lacking} never estimated a body' if lacking else ''
    print(f'{len(rows)} bags, {failed} failed, {cut} cut off{lack}; {frames} frames in')
    print(f'written to {options.output}, with a table over all in {options.output}/summary.csv')
    return 2 if failed or cut or lacking else 0


def _settings(options: argparse.Namespace) -> 'Settings':
    """Those of --config, or the defaults, with what --set says instead."""
    from kinpole_ros.pipeline.parameters import assignments, load_settings, settings_from

    changes = assignments(options.set)
    if options.config:
        return load_settings(options.config, changes=changes)
    return settings_from(changes)


def _keep(given: str | None, *outputs: str | None) -> None:
    """Refuse to write over a file that is read, or a recording, which cannot be made again."""
    for output in filter(None, outputs):
        # By another name too. What cannot be looked at is reported when it is opened.
        there = given is not None and os.path.exists(given) and os.path.exists(output)
        if there and os.path.samefile(str(given), output):
            raise FileExistsError(f'{given} is to be read; name another file to write')
        if os.path.isfile(output) and (recorder := _recorder_of(output)):
            raise FileExistsError(
                f'{output} is a recording, made by {recorder!r}; name another file to write, or '
                'remove that one first'
            )


def _recorder_of(path: str) -> str:
    with suppress(ImportError):  # solve does without mcap
        from kinpole_ros.bags import recorder_of

        return recorder_of(path)
    return ''


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
            arrival=options.arrival,
            tilt=options.tilt,
            scale=options.scale,
            unlabeled=options.unlabeled,
            progress=progress,
        )
    print(f'{count} frames of {", ".join(scene.markers)} written to {options.output}')
    return 0


def _plot(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.plot import plot

    with _progress('plot') as progress:
        cut = plot(options.bag, options.output, progress)
    print(f'drawn to {options.output}')
    return _told('plot', [cut] if cut else [])


def _report(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.report import report, settings_for

    _keep(options.config, options.output)
    _keep(options.bag, options.output)
    settings = settings_for(_settings(options), options.scene)
    with _progress('report') as progress:
        record = report(options.bag, options.output, settings, options.topic, progress)
    thinned = '' if len(record.stamp) == record.total else f' of {record.total}'
    print(f'{len(record.stamp)}{thinned} instants of {", ".join(record.bodies)}')
    print(f'written to {options.output}')
    return 0


def _view(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.view import view

    view(options.topic or '', options.port)
    return 0


def _layout(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.layout import write_layout

    _keep(options.config, options.output)
    shown = write_layout(options.viewer, options.config, options.output)
    print(f'{options.output}: {", ".join(shown.bodies)} of {shown.node}')
    return 0


def _import(options: argparse.Namespace) -> int:
    from kinpole_ros.bags import import_points

    _keep(options.file, options.output)
    with _progress('import') as progress:
        done = import_points(
            options.file,
            options.output,
            rate=options.rate,
            scale=options.scale,
            y_down=options.y_down,
            progress=progress,
            format=options.format,
            likelihood=options.likelihood,
        )
    for note in done.notes:
        print(f'kinpole import: {_line(note)}', file=sys.stderr)
    unit = f'in {done.unit}' if options.scale is None else f'1 unit = {done.scale:g} m'
    print(
        f'{done.frames} frames of {len(done.markers)} markers ({done.format}, {unit}) '
        f'written to {options.output}'
    )
    return 0


def _play(options: argparse.Namespace) -> int:
    from kinpole_ros.ros.live import play

    with _progress('play') as progress:
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


def _record(options: argparse.Namespace) -> int:
    from kinpole_ros.ros.live import record

    count = record(options.output, options.topic or ['/kinpole/', '/diagnostics'])
    print(f'{count} messages written to {options.output}')
    return 0


def _solve(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.solve import solve_scene

    pitch = options.pitch[2] if options.pitch else None
    _keep(options.scene, options.csv, options.plot, pitch, options.html)
    lines = solve_scene(
        options.scene,
        options.at,
        options.sweep,
        options.centers,
        options.statics,
        options.csv,
        options.plot,
        options.pitch,
        options.time,
        options.html,
        options.centrodes,
    )
    print('\n'.join(map(printable, lines)))
    return 0


def _fit(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.fit import fit_bag

    _keep(options.config, options.output)
    troubles: list[object] = []
    with _progress('fit') as progress:
        lines = fit_bag(
            options.scene,
            options.bag,
            options.config,
            options.free or [],
            options.output,
            options.topic,
            progress,
            troubles.append,
        )
    print('\n'.join(map(printable, lines)))
    return _told('fit', troubles)


def _discover(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.discover import discover_rig

    _keep(options.source, options.output, options.scene, options.plot)
    troubles: list[object] = []
    with _progress('discover') as progress:
        lines = discover_rig(
            options.source,
            options.topic,
            options.seconds,
            options.output,
            options.scene,
            options.plot,
            progress,
            troubles.append,
        )
    print('\n'.join(map(printable, lines)))
    return _told('discover', troubles)


def _demo(options: argparse.Namespace) -> int:
    from kinpole_ros.tools.demo import demo

    return demo(options.output)


def _bench(options: argparse.Namespace) -> int:
    # Next to the package: an installed one has none.
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    from bench import PARTS, bench, bench_long, bench_soak, make_pages

    with _progress('bench') as progress:
        if options.long:
            written = bench_long(options.output, progress)
        elif options.soak is not None:
            written = bench_soak(options.output, options.soak, progress)
        elif options.pages:
            written = make_pages(options.output)
        else:
            only = ['rigs'] if options.rigs else options.only or PARTS
            written = bench(options.output, options.quick, progress, only)
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


_COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    'replay': _replay,
    'batch': _batch,
    'simulate': _simulate,
    'solve': _solve,
    'discover': _discover,
    'fit': _fit,
    'plot': _plot,
    'report': _report,
    'view': _view,
    'layout': _layout,
    'import': _import,
    'play': _play,
    'record': _record,
    'demo': _demo,
    'bench': _bench,
}


if __name__ == '__main__':
    sys.exit(main())
