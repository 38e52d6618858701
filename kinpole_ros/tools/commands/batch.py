"""Replay of many bags."""

import argparse
import sys
from importlib.util import find_spec
from typing import Any

from kinpole_ros.files import printable
from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands._shared import (
    add_set,
    check_outputs,
    cleared,
    on_terminal,
    one_line,
    progress_bar,
    settings_of,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    batch = commands.add_parser(
        'batch',
        help='many bags, on all cores or a Dask cluster, and a table over all',
        description='Replays every bag by itself and writes summary.csv, a line for each named:\n'
        'frames, time span (s), noise (m), resets, share of instants with each pole, and what\n'
        'went wrong. A bag that fails is reported, and the rest go on. Run again, it does what is\n'
        'not done yet: results appear under their names only when whole, and stay as long as bag\n'
        'and settings are the same. A folder is one bag: name recordings that lie in one folder\n'
        'by FOLDER/*.mcap. Bags and output may be URLs of stores that fsspec knows, as s3://...\n'
        'Of more than 10,000 bags results lie in 256 folders of the output.\n'
        'A list of bags is trusted like the command line: it can name any file that you can read,\n'
        'and any address.\n'
        f'Stores need fsspec ({install_command("batch")}),\n'
        f'a cluster Dask ({install_command("cluster")}).',
        epilog='examples:\n'
        '  kinpole batch runs/*.mcap --config rig.yaml --output results\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --parquet --workers 4\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --scheduler tls://hub:8786 \\\n'
        '    --tls-ca ca.pem --tls-cert me.pem --tls-key me.key\n'
        '\n'
        'A cluster is `dask scheduler --protocol tls` on one machine and `dask worker tls://hub:8786\n'
        '--nthreads 1` on each of the others, all with --tls-ca-file, --tls-cert and --tls-key.\n'
        'They have kinpole_ros installed, and see bags and output under the same paths. Dask runs\n'
        'code from whoever reaches it: without TLS, anyone in the network can do so. What the\n'
        'configuration of Dask names need not be given here. Without --scheduler, the workers are\n'
        'processes of this machine, and listen to nobody.\n'
        'Exit status: 0 all bags done; 2 some failed, are cut off, or never estimated a body:\n'
        'see the columns error, truncated, unknown and warnings.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    batch.add_argument(
        'bags',
        metavar='BAG',
        nargs='*',
        help='.mcap and .db3 files and rosbag2 folders, or URLs such as s3://lab/run.mcap',
    )
    batch.add_argument(
        '--list',
        metavar='FILE',
        help='a file, from somebody you trust, that names more bags, one a line',
    )
    batch.add_argument(
        '--config', metavar='FILE', help='ROS 2 parameter file for all of them, as for replay'
    )
    add_set(batch)
    batch.add_argument(
        '--output',
        metavar='DIR',
        default='batch',
        help='folder for results and summary, or its URL (batch)',
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
    batch.add_argument('--tls-ca', metavar='PEM', help='certificate that signed those of a cluster')
    batch.add_argument('--tls-cert', metavar='PEM', help='certificate that it is shown')
    batch.add_argument('--tls-key', metavar='PEM', help='key of --tls-cert, if not in its file')
    batch.add_argument('--workers', type=int, metavar='N', help='processes here (one a core)')


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.bags import BagError, assumed_body
    from kinpole_ros.bags.batch import KINDS, TlsFiles, batch, is_open_to_all, listed_bags

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
    kinds = [kind for kind in KINDS if getattr(options, kind)] or ['mcap']
    check_outputs([options.list, options.config, settings.scene], [f'{options.output}/summary.csv'])

    if options.scheduler is not None and is_open_to_all(options.scheduler):
        print(
            f'kinpole batch: anyone who reaches {one_line(options.scheduler)} can run code on its '
            'workers; fix: start it with TLS and give its tls:// address (see docs/security.md)',
            file=sys.stderr,
        )

    def report(row: dict[str, Any]) -> None:
        for trouble in (row['error'], row.get('truncated'), row.get('warnings')):
            if trouble:
                name = '' if row['bag'] in trouble else f'{row["bag"]}: '
                clear = cleared() if on_terminal() else ''
                print(f'{clear}kinpole batch: {one_line(f"{name}{trouble}")}', file=sys.stderr)

    with progress_bar('batch') as progress:
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
            tls,
        )
    failed = sum(bool(row['error']) for row in rows)
    cut = sum(bool(row.get('truncated')) for row in rows)
    lacking = sum(bool(row.get('unknown')) for row in rows)
    frames = sum(row.get('frames', 0) for row in rows)
    assumptions = [assumed_body(row.get('markers', 0), settings, row['bag']) for row in rows]
    lack = f', {lacking} never estimated a body' if lacking else ''
    print(f'{len(rows)} bags, {failed} failed, {cut} cut off{lack}; {frames} frames in')
    if first := next(filter(None, assumptions), ''):
        others = sum(map(bool, assumptions)) - 1
        more = f'; so it is for {others} other bag{"s"[others == 1 :]}' if others else ''
        print(f'{printable(first)}{more}')
    print(f'written to {options.output}, with a table over all in {options.output}/summary.csv')
    return 2 if failed or cut or lacking else 0
