"""Commands that compute results from bags of markers: replay and batch."""

import argparse
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from kinpole_ros.files import printable
from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands import _terminal
from kinpole_ros.tools.commands._command import CONFIG, SET, TOPIC, command, flag, option
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import UsageError, print_error, progress_bar

if TYPE_CHECKING:
    from kinpole_ros.bags.batch import Cluster
    from kinpole_ros.linkage.positions import PositionReport
    from kinpole_ros.settings import Settings


def settings_of(options: argparse.Namespace) -> 'Settings':
    """Return the settings of --config, or the defaults, with the changes of --set."""
    from kinpole_ros.settings import assignments, load_settings, settings_from

    changes = assignments(options.set)
    if options.config:
        return load_settings(options.config, changes=changes)
    return settings_from(changes)


@command(
    'replay',
    option(
        'bag BAG',
        'an .mcap or .db3 file, or a rosbag2 folder; a folder without metadata.yaml is read as one '
        'recording of all its .mcap files',
    ),
    option(
        '--config FILE',
        'ROS 2 parameter file, as for the node; without it, all markers are one body named "body"',
    ),
    SET,
    option('--output OUT.mcap', 'bag of results, under /kinpole/...'),
    option('--csv OUT.csv', 'the results as a table, in SI units, with standard deviations'),
    option(
        '--parquet OUT.parquet',
        f'the same table for pandas and others ({install_command("parquet")})',
    ),
    TOPIC,
    flag(
        '--whole',
        'know from the first frame on what is learned up to the last one, with results to both '
        'ends: right for a finished recording; without it, results are those of the node',
    ),
    flag('--strict', 'exit with 1 if the scene differs from what is measured'),
)
def replay(options: argparse.Namespace) -> int:
    """
    Compute results from a bag of markers, as fast as the machine goes.

    Runs the markers of a bag through the same pipeline as the node. The same bag and parameters
    give the same results every time. New results replace earlier ones only when they are complete.
    A killed run leaves its incomplete results next to them, as NAME.….part, until the next run.
    """
    from kinpole_ros.bags import assumed_body
    from kinpole_ros.bags import replay as replay_bag
    from kinpole_ros.messages import faults
    from kinpole_ros.tracking.plane import AXES

    settings = settings_of(options)
    if options.strict and not settings.scene:
        raise UsageError('--strict compares with a scene; fix: add --set scene:=SCENE')
    outputs = options.output, options.csv, options.parquet
    kinds = 'an MCAP bag', 'a CSV table', 'a Parquet table'
    names = '--output', '--csv', '--parquet'
    check_outputs(
        [options.config, settings.scene, options.bag], [*zip(names, outputs, kinds, strict=True)]
    )
    with progress_bar('replay') as progress:
        result = replay_bag(
            options.bag,
            settings,
            options.output,
            options.csv,
            options.topic,
            progress,
            options.parquet,
            whole=options.whole,
        )
    print(f'{result.frames} frames in, {result.estimates} instants out')
    if assumption := assumed_body(len(result.identities), settings, options.bag):
        print(printable(assumption))
    for line in _result_lines(result):
        print(line)
    for line in _position_lines(result.scene_positions):
        print(line)
    for output in filter(None, outputs):
        print(f'written to {output}')
    if result.space.plane is not None and settings.plane not in AXES:
        print(f'plane: {faults.plane_words(result.space.plane)}')
    for warning in result.warnings:
        print_error('replay', warning)
    if result.truncated is not None:
        print_error('replay', result.truncated)
    if result.truncated is not None or result.unknown:
        return 2
    return int(options.strict and not _agrees(result.scene_positions))


def _agrees(positions: 'PositionReport | None') -> bool:
    return positions is not None and not positions.findings


def _result_lines(result: Any) -> Iterator[str]:
    """Yield lines on the stamps, and on what was determined."""
    counts = {
        'stamps repeated': result.repeated,
        'frames late': result.late,
        'frames lost on the way': result.lost,
        'messages without markers': result.empty,
        'jumps': result.resets,
        'changes of frame_id': result.frame_changes,
    }
    yield from (f'{title}: {count}' for title, count in counts.items() if count)
    if (state := result.stamps) is not None:
        regularized = ', regularized' if state.regularized else ''
        yield (
            f'stamps: every {state.interval * 1e3:.6g} ms, jitter {state.jitter * 1e3:.3g} ms rms, '
            f'{state.largest * 1e3:.3g} ms at most{regularized}'
        )
    for body, shares in result.determined.items():
        listed = ', '.join(f'{pole} {share:.1%}' for pole, share in shares.items())
        yield f'{body}: determined at {listed} of them'


def _position_lines(positions: 'PositionReport | None') -> Iterator[str]:
    """Yield how far the joints of the scene are off, and whether the scene explains the poses."""
    if positions is None:
        return
    for joint in positions.joints:
        yield (
            f'joint {joint.joint}: off {joint.rms:.2g} m, {joint.deviations:.1f} deviations, rms '
            f'over {joint.instants} instants'
        )
    agreement = 'agrees with' if _agrees(positions) else 'differs from'
    yield (
        f'the scene {agreement} what is measured: residuals are {positions.ratio**0.5:.3g} times '
        f'their noise, over {positions.instants} instants'
    )


@command(
    'batch',
    option(
        'bags BAG',
        '.mcap and .db3 files and rosbag2 folders, or URLs such as s3://lab/run.mcap',
        nargs='*',
    ),
    option('--list FILE', 'a file, from somebody you trust, with one more bag in each line'),
    CONFIG,
    SET,
    option('--output DIR', 'folder for results and summary, or its URL (batch)', default='batch'),
    TOPIC,
    flag('--mcap', 'write a bag of results for each bag (the default)'),
    flag('--csv', 'write a CSV table for each bag'),
    flag('--parquet', 'write a Parquet table for each bag'),
    option('--scheduler ADDRESS', 'address of a Dask cluster; without it, use this machine'),
    option('--tls-ca PEM', 'certificate that signed the certificates of the cluster'),
    option('--tls-cert PEM', 'certificate to show to the cluster'),
    option('--tls-key PEM', 'key of --tls-cert, if it is not in the same file'),
    option('--workers N', 'processes on this machine (one per core)', int),
)
def batch(options: argparse.Namespace) -> int:
    r"""
    Replay many bags, on all cores or a Dask cluster, with a table over all.

    Replays each bag by itself, as with replay --whole, and writes summary.csv with one line per
    bag: frames, time span (s), noise (m), resets, share of the instants at which each pole is
    determined, and errors. If a bag fails, the others continue. Run it again to do only what is
    missing: results are written when they are complete, and reused as long as bag and settings stay
    the same.

    A folder is one bag; name several recordings in one folder as FOLDER/*.mcap. Bags and output may
    be URLs of stores that fsspec knows, such as s3://... (pip install fsspec). Results of more than
    10,000 bags are in 256 subfolders. A list of bags is trusted like the command line: it can name
    any file that you can read, and any address but those of one store in another.

    A cluster (pip install dask distributed) is `dask scheduler --protocol tls` on one machine and
    `dask worker tls://hub:8786 --nthreads 1` on each of the others, all with --tls-ca-file,
    --tls-cert and --tls-key. They have kinpole_ros installed, and bags and output have the same
    paths there. Dask runs code from whoever can reach it: without TLS, that is anyone in the
    network. Options in the configuration of Dask need not be repeated here. Without --scheduler,
    the workers are processes of this machine and listen to nobody; without Dask, bags are replayed
    one after another.

    Exit status: 0 if all bags are done; 2 if one failed, is cut off, or has a body without any
    estimate: see the columns error, truncated, unknown and warnings.

    Examples:
      kinpole batch runs/*.mcap --config rig.yaml --output results
      kinpole batch runs/*/ --config rig.yaml --output results --parquet --workers 4
      kinpole batch runs/*/ --config rig.yaml --output results --scheduler tls://hub:8786 \
        --tls-ca ca.pem --tls-cert me.pem --tls-key me.key
    """
    from dataclasses import replace

    from kinpole_ros.bags.batch import KINDS
    from kinpole_ros.bags.batch import batch as replay_bags

    cluster = _checked_cluster(options)
    bags = _named_bags(options)
    settings = settings_of(options)
    if options.topic:
        settings = replace(settings, marker_topic=options.topic)
    summary = f'{options.output}/summary.csv'
    check_outputs([options.list, options.config, settings.scene], [('--output', summary, '')])
    if cluster is not None and cluster.is_open_to_all:
        print_error(
            'batch',
            f'anyone who reaches {options.scheduler} can run code on its workers; fix: start it '
            'with TLS and give its tls:// address (see docs/security.md)',
        )
    kinds = [kind for kind in KINDS if getattr(options, kind)] or ['mcap']
    with progress_bar('batch') as progress:
        where = options.output, settings, kinds, cluster, options.workers
        rows = replay_bags(bags, *where, progress, _print_errors_of)
    _print_totals(rows, settings)
    print(f'written to {options.output}, with a table over all in {summary}')
    return 2 if any(map(_is_faulty, rows)) else 0


def _named_bags(options: argparse.Namespace) -> list[str]:
    from kinpole_ros.bags import BagError
    from kinpole_ros.bags.batch import listed_bags

    bags = [*options.bags, *(listed_bags(options.list) if options.list else [])]
    if not bags:
        raise BagError('no bags are named; give some, or a file that names them by --list')
    return bags


def _checked_cluster(options: argparse.Namespace) -> 'Cluster | None':
    """Return the cluster, if any; raise BagError for options that exclude each other."""
    from kinpole_ros.bags import BagError
    from kinpole_ros.bags.batch import Cluster

    if options.workers is not None and options.workers < 1:
        raise BagError(f'--workers is {options.workers}; it must be 1 or more')
    if options.workers is not None and options.scheduler is not None:
        raise BagError('--workers is for this machine alone; leave it out with --scheduler')
    tls = options.tls_ca, options.tls_cert, options.tls_key
    if options.scheduler is None and any(path is not None for path in tls):
        raise BagError('--tls-ca, --tls-cert and --tls-key are for a cluster; give --scheduler too')
    if options.parquet and options.scheduler is None and find_spec('pyarrow') is None:
        raise BagError(f'--parquet needs pyarrow; fix: {install_command("parquet")}, or use --csv')
    return Cluster(options.scheduler, *tls) if options.scheduler is not None else None


def _print_errors_of(row: dict[str, Any]) -> None:
    """Print what went wrong with one bag, in place of the progress bar."""
    for trouble in filter(None, (row['error'], row.get('truncated'), row.get('warnings'))):
        name = '' if row['bag'] in trouble else f'{row["bag"]}: '
        if _terminal.on_terminal():
            print(_terminal.erased_bar(), end='', file=sys.stderr)
        print_error('batch', f'{name}{trouble}')


def _is_faulty(row: dict[str, Any]) -> bool:
    return any(row.get(name) for name in ('error', 'truncated', 'unknown'))


def _print_totals(rows: list[dict[str, Any]], settings: 'Settings') -> None:
    """Print counts, the first assumption about bodies, and how many bags have one too."""
    from kinpole_ros.bags import assumed_body

    failed, truncated, unknown = (
        sum(bool(row.get(name)) for row in rows) for name in ('error', 'truncated', 'unknown')
    )
    frames = sum(row.get('frames', 0) for row in rows)
    never = f', {unknown} never estimated a body' if unknown else ''
    print(f'{len(rows)} bags, {failed} failed, {truncated} cut off{never}; {frames} frames in')
    assumptions = [assumed_body(row.get('markers', 0), settings, row['bag']) for row in rows]
    if first := next(filter(None, assumptions), ''):
        count = sum(map(bool, assumptions)) - 1
        note = f'; so it is for {count} other bag{"s"[count == 1 :]}' if count else ''
        print(f'{printable(first)}{note}')
