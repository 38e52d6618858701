"""Commands from bag to bag: replay, batch, simulate and import."""

import argparse
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from kinpole_ros.files import printable
from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands._command import (
    BAG_OUTPUT,
    CONFIG,
    POINT_OPTIONS,
    SCENE,
    SET,
    TOPIC,
    command,
    flag,
    option,
)
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import (
    erased_bar,
    on_terminal,
    one_line,
    print_error,
    progress_bar,
)

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import PositionsFound
    from kinpole_ros.tracking.parameters import Settings


def settings_of(options: argparse.Namespace) -> 'Settings':
    """Return the settings of --config, or the defaults, with the changes of --set."""
    from kinpole_ros.tracking.parameters import assignments, load_settings, settings_from

    changes = assignments(options.set)
    if options.config:
        return load_settings(options.config, changes=changes)
    return settings_from(changes)


@command(
    'replay',
    option(
        'bag',
        'BAG',
        'an .mcap or .db3 file, or a rosbag2 folder; a folder without metadata.yaml is read as one '
        'recording of all its .mcap files',
    ),
    option(
        '--config',
        'FILE',
        'ROS 2 parameter file, as for the node; without it, all markers are one body named "body"',
    ),
    SET,
    option('--output', 'OUT.mcap', 'bag of results, under /kinpole/...'),
    option('--csv', 'OUT.csv', 'the results as a table, in SI units, with standard deviations'),
    option(
        '--parquet',
        'OUT.parquet',
        f'the same table for pandas and others ({install_command("parquet")})',
    ),
    TOPIC,
)
def replay(options: argparse.Namespace) -> int:
    """
    Compute results from a bag of markers, as fast as the machine goes.

    Runs the markers of a bag through the same pipeline as the node. The same bag and parameters
    give the same results every time. New results replace earlier ones only when they are complete.
    A killed run leaves its incomplete results beside them, as NAME.….part, until the next run.
    """
    from kinpole_ros.bags import assumed_body, warnings_of
    from kinpole_ros.bags import replay as replay_bag
    from kinpole_ros.messages import plane_words
    from kinpole_ros.tracking.plane import AXES

    settings = settings_of(options)
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
        print(f'plane: {plane_words(result.space.plane)}')
    for warning in warnings_of(result, settings):
        print_error('replay', warning)
    if result.truncated is not None:
        print_error('replay', result.truncated)
    return 2 if result.truncated is not None or result.unknown else 0


def _result_lines(result: Any) -> Iterator[str]:
    """Yield lines on the stamps, on what was determined, and on the deviations from a scene."""
    counts = {
        'stamps repeated': result.repeated,
        'frames late': result.late,
        'frames lost on the way': result.lost,
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
    for row in result.scene_deviations:
        yield (
            f'{row.subject}: {row.what} {row.rms:.2g} {row.unit}, {row.deviations:.1f} deviations '
            f'(rms of {row.instants} instants)'
        )


def _position_lines(positions: 'PositionsFound | None') -> Iterator[str]:
    """Yield how far the joints of the scene are off, and whether the scene explains the poses."""
    if positions is None:
        return
    for joint in positions.joints:
        yield (
            f'joint {joint.joint}: off {joint.rms:.2g} m, {joint.deviations:.1f} deviations, rms '
            f'over {joint.instants} instants'
        )
    agreement = (
        'differs from what is measured' if positions.words else 'agrees with what is measured'
    )
    yield (
        f'the scene {agreement}: residuals are {positions.ratio**0.5:.3g} times their noise, over '
        f'{positions.instants} instants'
    )


@command(
    'batch',
    option(
        'bags',
        'BAG',
        '.mcap and .db3 files and rosbag2 folders, or URLs such as s3://lab/run.mcap',
        nargs='*',
    ),
    option('--list', 'FILE', 'a file, from somebody you trust, with one more bag in each line'),
    CONFIG,
    SET,
    option(
        '--output', 'DIR', 'folder for results and summary, or its URL (batch)', default='batch'
    ),
    TOPIC,
    flag('--mcap', 'write a bag of results for each bag (the default)'),
    flag('--csv', 'write a CSV table for each bag'),
    flag('--parquet', 'write a Parquet table for each bag'),
    option('--scheduler', 'ADDRESS', 'address of a Dask cluster; without it, use this machine'),
    option('--tls-ca', 'PEM', 'certificate that signed the certificates of the cluster'),
    option('--tls-cert', 'PEM', 'certificate to show to the cluster'),
    option('--tls-key', 'PEM', 'key of --tls-cert, if it is not in the same file'),
    option('--workers', 'N', 'processes on this machine (one per core)', int),
)
def batch(options: argparse.Namespace) -> int:
    r"""
    Replay many bags, on all cores or a Dask cluster, with a table over all.

    Replays each bag by itself and writes summary.csv with one line per bag: frames, time span (s),
    noise (m), resets, share of the instants at which each pole is determined, and errors. If a bag
    fails, the others continue. Run it again to do only what is missing: results are written when
    they are complete, and reused as long as bag and settings stay the same.

    A folder is one bag; name several recordings in one folder as FOLDER/*.mcap. Bags and output may
    be URLs of stores that fsspec knows, such as s3://... (pip install fsspec). Results of more than
    10,000 bags are in 256 subfolders. A list of bags is trusted like the command line: it can name
    any file that you can read, and any address.

    A cluster (pip install dask distributed) is `dask scheduler --protocol tls` on one machine and
    `dask worker tls://hub:8786 --nthreads 1` on each of the others, all with --tls-ca-file,
    --tls-cert and --tls-key. They have kinpole_ros installed, and bags and output have the same
    paths there. Dask runs code from whoever can reach it: without TLS, that is anyone in the
    network. Options in the configuration of Dask need not be repeated here. Without --scheduler,
    the workers are processes of this machine and listen to nobody.

    Exit status: 0 if all bags are done; 2 if one failed, is cut off, or has a body without any
    estimate: see the columns error, truncated, unknown and warnings.

    Examples:
      kinpole batch runs/*.mcap --config rig.yaml --output results
      kinpole batch runs/*/ --config rig.yaml --output results --parquet --workers 4
      kinpole batch runs/*/ --config rig.yaml --output results --scheduler tls://hub:8786 \
        --tls-ca ca.pem --tls-cert me.pem --tls-key me.key
    """
    from kinpole_ros.bags import BagError
    from kinpole_ros.bags.batch import KINDS, TlsFiles, is_open_to_all, listed_bags
    from kinpole_ros.bags.batch import batch as replay_bags

    if options.workers is not None and options.workers < 1:
        raise BagError(f'--workers is {options.workers}; it must be 1 or more')
    if options.workers is not None and options.scheduler is not None:
        raise BagError('--workers is for this machine alone; leave it out with --scheduler')
    tls = TlsFiles(options.tls_ca, options.tls_cert, options.tls_key)
    if options.scheduler is None and tls != TlsFiles():
        raise BagError('--tls-ca, --tls-cert and --tls-key are for a cluster; give --scheduler too')
    if options.parquet and options.scheduler is None and find_spec('pyarrow') is None:
        raise BagError(f'--parquet needs pyarrow; fix: {install_command("parquet")}, or use --csv')
    bags = [*options.bags, *(listed_bags(options.list) if options.list else [])]
    if not bags:
        raise BagError('no bags are named; give some, or a file that names them by --list')
    settings = settings_of(options)
    summary = f'{options.output}/summary.csv'
    check_outputs([options.list, options.config, settings.scene], [('--output', summary, '')])
    if options.scheduler is not None and is_open_to_all(options.scheduler):
        print(
            f'kinpole batch: anyone who reaches {one_line(options.scheduler)} can run code on its '
            'workers; fix: start it with TLS and give its tls:// address (see docs/security.md)',
            file=sys.stderr,
        )
    kinds = [kind for kind in KINDS if getattr(options, kind)] or ['mcap']
    with progress_bar('batch') as progress:
        rows = replay_bags(
            bags,
            options.output,
            settings,
            options.topic,
            kinds,
            options.scheduler,
            options.workers,
            progress,
            _print_errors_of,
            tls,
        )
    failed = sum(bool(row['error']) for row in rows)
    truncated = sum(bool(row.get('truncated')) for row in rows)
    unknown = sum(bool(row.get('unknown')) for row in rows)
    frames = sum(row.get('frames', 0) for row in rows)
    never = f', {unknown} never estimated a body' if unknown else ''
    print(f'{len(rows)} bags, {failed} failed, {truncated} cut off{never}; {frames} frames in')
    _print_assumptions(rows, settings)
    print(f'written to {options.output}, with a table over all in {summary}')
    return 2 if failed or truncated or unknown else 0


def _print_errors_of(row: dict[str, Any]) -> None:
    """Print what went wrong with one bag, in place of the progress bar."""
    for trouble in filter(None, (row['error'], row.get('truncated'), row.get('warnings'))):
        name = '' if row['bag'] in trouble else f'{row["bag"]}: '
        if on_terminal():
            print(erased_bar(), end='', file=sys.stderr)
        print_error('batch', f'{name}{trouble}')


def _print_assumptions(rows: list[dict[str, Any]], settings: 'Settings') -> None:
    """Print the first assumption about the bodies of a bag, and how many bags have one too."""
    from kinpole_ros.bags import assumed_body

    assumptions = [assumed_body(row.get('markers', 0), settings, row['bag']) for row in rows]
    if first := next(filter(None, assumptions), ''):
        others = sum(map(bool, assumptions)) - 1
        more = f'; so it is for {others} other bag{"s"[others == 1 :]}' if others else ''
        print(f'{printable(first)}{more}')


class _ListScenes(argparse.Action):
    """Print the names of the scenes and exit, as --version does."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(nargs=0, **settings)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from kinpole_ros.mechanism import scene_names

        print('\n'.join(scene_names()))
        parser.exit()


@command(
    'simulate',
    SCENE,
    flag('--list', 'print the names of the scenes that come with kinpole', _ListScenes),
    BAG_OUTPUT,
    option('--rate', 'HZ', 'frames per second (200)', float, 200.0),
    option('--duration', 'S', 'length of the recording, s (5)', float, 5.0),
    option('--noise', 'M', 'noise of a marker per axis, m (0)', float, 0.0),
    option('--seed', 'N', 'seed of the random numbers (0)', int, 0),
    option('--dropout', 'P', 'share of markers not seen (0)', float, 0.0),
    option(
        '--jitter',
        'S',
        'jitter of the times of the frames, s (0); the stamps have the true times',
        float,
        0.0,
    ),
    option(
        '--message',
        'TYPE',
        'marker_array (the default), marker, pose_array or point_cloud2; or poses of the bodies: '
        'pose_stamped, body_poses or tf',
        default='marker_array',
    ),
    option(
        '--arrival',
        'S',
        'mean of an exponential delay of the stamps, s (0); the frames keep their order',
        float,
        0.0,
    ),
    option(
        '--tilt', 'DEG', 'angle of the plane of motion about the x axis, degrees (0)', float, 0.0
    ),
    option('--scale', 'F', 'units per meter: 1000 for mm (1)', float, 1.0),
    flag(
        '--unlabeled',
        'points without names, in random order in each frame; an unseen point leaves no gap',
    ),
)
def simulate(options: argparse.Namespace) -> int:
    """
    Write a bag of markers of a simulated mechanism, with the exact motion.

    Writes markers on /markers and the exact motion on /kinpole/truth/... (m, in the frame of the
    markers, each with the stamp of its frame). Noise, dropout, jitter, arrival, tilt, scale and
    unlabeled imitate the faults of real rigs.
    """
    from kinpole_ros.bags import simulate as simulate_bag
    from kinpole_ros.mechanism import load_scene

    check_outputs([options.scene], [('--output', options.output, 'an MCAP bag')])
    scene = load_scene(options.scene)
    with progress_bar('simulate') as progress:
        count = simulate_bag(
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


@command(
    'import',
    option('file', 'FILE', 'the file of points, or a folder'),
    BAG_OUTPUT,
    option('--format', 'NAME', 'one of the above (auto: by content)', default='auto'),
    *POINT_OPTIONS,
    option(
        '--likelihood',
        'P',
        'least likelihood of a point that counts as seen (DeepLabCut 0.6, SLEAP 0)',
        float,
    ),
)
def import_points(options: argparse.Namespace) -> int:
    """
    Convert tracked points of other programs to a bag.

    Units and times are taken from the file where it has them; you are asked for the others. Pixel
    coordinates count y down. The formats:

      table       columns NAME_x, NAME_y, maybe NAME_z, and t in s (or time_ms ...), in m;
                  or t, x, y of one point
      deeplabcut  .csv or .h5, one animal or several
      sleap       analysis .csv or .h5
      anipose     .csv of points in space
      keypoints   OpenPose, a folder of .json; COCO .json
      kinovea     trajectories as .csv, .txt or .xml, and angles as .csv
      tracker     data files and .trk of Tracker (Open Source Physics)
      motive      .csv of OptiTrack
      vicon       .csv of Nexus
      qualisys    .tsv, 3D or 6D
      trc         .trc of OpenSim, Cortex and others
      c3d         .c3d
      bag         .bag of ROS 1; .db3, .mcap or a folder of ROS 2: markers, poses, or what
                  mocap4r2, motion_capture_tracking and VRPN publish

    Files that end in .h5 need h5py (pip install h5py). Cells are separated by commas, semicolons
    or tabs; with the latter two, decimals may be commas. Empty cells are markers that were not
    seen. Poses of bodies are written to /tf.

    Examples:
      kinpole import walk.trc --output walk.mcap
      kinpole import run_6D.tsv --output run.mcap
      kinpole import videoDLC_resnet50.csv --rate 240 --scale 0.00051 --output video.mcap
    """
    from kinpole_ros.bags import import_points as import_file

    check_outputs([options.file], [('--output', options.output, 'an MCAP bag')])
    with progress_bar('import') as progress:
        imported = import_file(
            options.file,
            options.output,
            rate=options.rate,
            scale=options.scale,
            y_down=options.y_down,
            progress=progress,
            format=options.format,
            likelihood=options.likelihood,
        )
    for note in imported.notes:
        print_error('import', note)
    unit = f'in {imported.unit}' if options.scale is None else f'1 unit = {imported.scale:g} m'
    print(
        f'{imported.frames} frames of {len(imported.markers)} markers ({imported.format}, {unit}) '
        f'written to {options.output}'
    )
    return 0
