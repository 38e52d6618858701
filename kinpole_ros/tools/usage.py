"""
What the command `kinpole` understands, and what its --help tells.

It comes at once, so nothing heavy is imported here.
"""

import argparse
from typing import Any

from kinpole_ros import __version__

_EPILOG = """examples:
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


def make_parser() -> argparse.ArgumentParser:
    """The parser of all words; `command` is which was given."""
    parser = argparse.ArgumentParser(
        prog='kinpole',
        description='Planar kinematics of mechanisms from tracked markers: angular rates, poles '
        'and centrodes of every body, and between bodies, with their uncertainty.',
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'kinpole {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')

    commands.add_parser(
        'node',
        help='the live node',
        description='The live node. Everything after it goes to ROS: '
        'kinpole node --ros-args --params-file config/kinpole.yaml -r markers:=/mocap/markers',
    )

    replay = commands.add_parser(
        'replay',
        help='a bag of markers to results, as fast as the machine goes',
        description='Runs the markers of a bag through the same pipeline as the node. The same '
        'bag and parameters give the same figures every time. Results take the place of earlier '
        'ones only when whole; what a killed run wrote is beside them, as NAME.….part.',
    )
    replay.add_argument(
        'bag',
        metavar='BAG',
        help='an .mcap file or a rosbag2 folder; one without metadata.yaml is read as one '
        'recording of all its .mcap files',
    )
    replay.add_argument(
        '--config',
        metavar='FILE',
        help='ROS 2 parameter file, as for the node; without it one body, "body", of all markers',
    )
    _add_set(replay)
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
        "Needs Dask: pip install 'kinpole_ros[batch]'.",
        epilog='examples:\n'
        '  kinpole batch runs/*.mcap --config rig.yaml --output results\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --parquet --workers 4\n'
        '  kinpole batch runs/*/ --config rig.yaml --output results --scheduler tcp://hub:8786\n'
        '\n'
        'A cluster is `dask scheduler` on one machine and `dask worker tcp://hub:8786 --nthreads 1`'
        '\non each of the others. All of them have kinpole_ros installed, and see bags and output\n'
        'under the same paths. Dask takes code from whoever reaches it: keep it inside your lab.\n'
        'Exit status: 0 all bags done; 2 some failed, are cut off, or never estimated a body:\n'
        'see the columns error, truncated, unknown and warnings.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    batch.add_argument(
        'bags',
        metavar='BAG',
        nargs='*',
        help='.mcap files and rosbag2 folders, or URLs such as s3://lab/run.mcap',
    )
    batch.add_argument('--list', metavar='FILE', help='a file that names more bags, one a line')
    batch.add_argument(
        '--config', metavar='FILE', help='ROS 2 parameter file for all of them, as for replay'
    )
    _add_set(batch)
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
    batch.add_argument('--workers', type=int, metavar='N', help='processes here (one a core)')

    simulate = commands.add_parser(
        'simulate',
        help='a bag of markers from a mechanism, with the exact answer in it',
        description='Writes markers on /markers and the exact motion on /kinpole/truth/... The '
        'last four options spoil the markers as real rigs do; the exact motion is in m, in the '
        'frame of the markers, under the stamp of its frame.',
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

    solve = commands.add_parser(
        'solve',
        help='the analysis of a mechanism: motion, dead points, centers, forces',
        description='Solves a scene exactly: positions and rates at time 0, at a value of its '
        'driver, over all the way the linkage gives it, with limits and dead points, or over time.',
        epilog='examples:\n'
        '  kinpole solve four_bar --at "45 deg" --centers\n'
        '  kinpole solve slider_crank --sweep --csv crank.csv --plot crank.png\n'
        '  kinpole solve double_pendulum --time 5 --csv course.csv --html course.html\n'
        '  kinpole solve loader_cylinder --statics\n'
        '  kinpole solve antiparallelogram --pitch crank follower gears.svg\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    solve.add_argument('scene', metavar='SCENE', help='name or path of a scene, see simulate')
    where = solve.add_mutually_exclusive_group()
    where.add_argument('--at', metavar='VALUE', help='value of the driver: 0.5, "-45 deg", "12 cm"')
    where.add_argument('--sweep', action='store_true', help='all the way the linkage gives it')
    where.add_argument('--time', metavar='S', help='as its drivers move it for S seconds')
    solve.add_argument('--centers', action='store_true', help='instant centers, as deduced by hand')
    solve.add_argument('--statics', action='store_true', help='what drivers and joints bear')
    solve.add_argument('--csv', metavar='FILE', help='all figures as a table, SI units')
    solve.add_argument('--plot', metavar='FILE.png', help='the linkage, and rates over the range')
    solve.add_argument(
        '--centrodes',
        nargs='+',
        default=(),
        metavar='BODY',
        help='draw their centrodes (--plot)',
    )
    solve.add_argument('--html', metavar='FILE.html', help='the linkage in motion, as in a report')
    solve.add_argument(
        '--pitch',
        nargs=3,
        metavar=('BODY', 'BODY', 'FILE'),
        help='centrodes of two bodies as pitch curves: .csv, or .svg, .dxf true to scale',
    )

    _add_discover(commands)
    _add_fit(commands)

    plot = commands.add_parser(
        'plot',
        help='a picture of a result bag',
        description='Draws centrodes, poles and rates with their bands.',
    )
    plot.add_argument('bag', metavar='BAG', help='bag of results, from replay or recorded live')
    plot.add_argument('--output', metavar='FILE.png', required=True, help='picture to write')

    _add_report(commands)
    _add_view(commands)
    _add_layout(commands)
    _add_import(commands)

    play = commands.add_parser(
        'play',
        help='publish a bag, where there is no ros2 bag play',
        description='Publishes a bag at the pace it was recorded, once somebody listens.',
    )
    play.add_argument('bag', metavar='BAG', help='an .mcap file or a rosbag2 folder')
    play.add_argument('--topic', action='append', metavar='T', help='only this one; repeatable')
    play.add_argument('--speed', type=float, default=1.0, metavar='X', help='times the pace (1)')
    play.add_argument('--loop', action='store_true', help='over and over, until Ctrl-C')
    play.add_argument(
        '--clock',
        type=float,
        nargs='?',
        const=40.0,
        metavar='HZ',
        help='have the time of the bag on /clock too, for nodes with use_sim_time (40 Hz)',
    )

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

    demo = commands.add_parser(
        'demo',
        help='the main job, shown: node, bag, recording and picture',
        description='Starts the node, plays a bag of a four-bar into it, records what it '
        'publishes, prints a table and draws a picture.',
    )
    demo.add_argument('--output', metavar='FOLDER', default='out', help='where to write (out)')

    bench = commands.add_parser(
        'bench',
        help='measure errors, uncertainty, peers and limits, and draw the charts of the docs',
        description='Writes benchmarks.md, benchmarks-tables.md and charts/ anew. Takes a quarter '
        'of an hour on two cores; wants '
        'matplotlib, and compares with PyNumDiff where it is installed: '
        "pip install 'kinpole_ros[bench]'.",
    )
    bench.add_argument('--output', metavar='FOLDER', default='docs', help='where to write (docs)')
    bench.add_argument('--quick', action='store_true', help='little data: shows that it works')
    part = bench.add_mutually_exclusive_group()
    part.add_argument(
        '--only',
        nargs='+',
        metavar='PART',
        help='only these parts; the pages quote the others as they were measured before: costs, '
        'speed, live, hindsight, peers, lag, model, pynumdiff, atlas, pendulum, rigs',
    )
    part.add_argument(
        '--pages',
        action='store_true',
        help='measure nothing: pages and charts of charts/*.csv',
    )
    part.add_argument(
        '--long', action='store_true', help='only the run of 1e7 frames: some minutes'
    )
    part.add_argument(
        '--rigs',
        action='store_true',
        help='only what drivers send of real rigs, late stamps to soft tissue: two minutes',
    )
    part.add_argument(
        '--soak',
        type=float,
        metavar='MINUTES',
        help='only the live node, for so long at 500 Hz with dropouts, outliers and clock jumps',
    )
    return parser


def _add_set(command: argparse.ArgumentParser) -> None:
    """--set, for what takes --config."""
    command.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME:=VALUE',
        help='a parameter instead of what the file says, as ros2 run takes it after -p; repeatable',
    )


def _add_report(commands: Any) -> None:
    report = commands.add_parser(
        'report',
        help='a recording to move through: one HTML file that works anywhere, without a network',
        description='Writes one HTML file: the linkage in motion with its poles, centrodes and\n'
        'velocities, all figures over time with their bands, and what was withheld and why.\n'
        'It needs a browser and nothing else. A bag of markers is replayed first.',
        epilog='examples:\n'
        '  kinpole report recording.mcap --config rig.yaml --output report.html\n'
        '  kinpole report recording.mcap --scene four_bar --output report.html\n'
        '  kinpole report result.mcap --output report.html\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    report.add_argument('bag', metavar='BAG', help='bag of markers, or of results')
    report.add_argument('--output', metavar='FILE.html', required=True, help='report to write')
    report.add_argument('--config', metavar='FILE', help='parameter file, as for replay')
    _add_set(report)
    report.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")
    report.add_argument(
        '--scene',
        metavar='SCENE',
        help='draw its theory beside the measurement; without --config its bodies are tracked',
    )


def _add_view(commands: Any) -> None:
    view = commands.add_parser(
        'view',
        help='the same live: a page in the browser of what a running node publishes',
        description='Serves the page of a report, live, to browsers on this machine: 30 times a\n'
        'second bodies, poles with their ellipses, velocities and rates, of a node that publishes\n'
        'anywhere in the ROS graph. Prints the address to open, which has a token in it.\n'
        'Only what the page shows is asked of the node, and only while a page is open.',
        epilog='examples:\n'
        '  kinpole view\n'
        '  kinpole view --topic /rig2 --port 8080\n'
        '\n'
        'From another machine: ssh -L 8080:127.0.0.1:8080 RIG, then open the address here.\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    view.add_argument(
        '--topic', metavar='NAME', help='a node, its namespace, or a topic of it (the first found)'
    )
    view.add_argument(
        '--port', type=int, default=0, metavar='N', help='port on 127.0.0.1 (one that is free)'
    )


def _add_layout(commands: Any) -> None:
    layout = commands.add_parser(
        'layout',
        help='a layout for Foxglove, Lichtblick or PlotJuggler, of the topics of a rig',
        description='Writes a layout to open there: the drawing, rates with their deviations, and\n'
        'diagnostics; in PlotJuggler also the paths of the poles, and joints.',
        epilog='examples:\n'
        '  kinpole layout foxglove --config rig.yaml --output rig.json\n'
        '  kinpole layout plotjuggler --config result.mcap --output rig.xml\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    layout.add_argument(
        'viewer', choices=('foxglove', 'plotjuggler'), help='foxglove is for Lichtblick too'
    )
    layout.add_argument(
        '--config', metavar='FILE', help='parameter file, or a bag of results; without it as replay'
    )
    layout.add_argument('--output', metavar='FILE', required=True, help='layout to write')


def _add_discover(commands: Any) -> None:
    discover = commands.add_parser(
        'discover',
        help='what a rig is, from its markers: bodies, joints, lengths; a parameter file to start',
        description='Finds which markers make which rigid body, in which plane and unit, and what\n'
        'joins the bodies: pins, slides, wheels and gears, with places, lengths and deviations.\n'
        'Needs two or more markers a body, in motion. Names, order and dropouts do not matter.\n'
        'Prints a table; writes a parameter file for replay and the node, and a draft scene for\n'
        'solve and simulate, where names and drivers are a first guess.',
        epilog='examples:\n'
        '  kinpole discover recording.mcap\n'
        '  kinpole discover recording.mcap --output rig.yaml --scene draft.yaml --plot rig.png\n'
        '  kinpole discover /mocap/markers --seconds 30 --output rig.yaml\n'
        'and then\n'
        '  kinpole replay recording.mcap --config rig.yaml --output result.mcap\n'
        '  kinpole solve draft.yaml --centers\n'
        '\n'
        'Move all joints through their range, one against the other, at changing speed: what does\n'
        'not move cannot be found. "left over" is what a joint does not explain, over the noise:\n'
        '1 is perfect, more is play, a lens, or a body that bends.\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    discover.add_argument(
        'source',
        metavar='BAG_OR_TOPIC',
        help='an .mcap file or a rosbag2 folder, or a topic that is being published',
    )
    discover.add_argument(
        '--topic', metavar='T', help='topic of the markers in the bag (/markers, or the only one)'
    )
    discover.add_argument(
        '--seconds', type=float, metavar='S', help='use so much of it (60; of a live topic 20)'
    )
    discover.add_argument('--output', metavar='RIG.yaml', help='parameter file to write')
    discover.add_argument('--scene', metavar='SCENE.yaml', help='draft scene to write')
    discover.add_argument('--plot', metavar='FILE.png', help='picture of what was found')


def _add_import(commands: Any) -> None:
    imported = commands.add_parser(
        'import',
        help='tracked points from the files of other programs to a bag',
        description='Reads tracked points as other programs write them. What a file says of units\n'
        'and times is used; what it does not say is asked for. Pixels count y down.\n'
        '\n'
        '  table       columns NAME_x, NAME_y, maybe NAME_z, and t in seconds, lengths in m\n'
        '  deeplabcut  .csv or .h5 (the latter by kinpole_ros[formats]), one animal or several\n'
        '  sleap       analysis .csv\n'
        '  kinovea     trajectories as .csv\n'
        '  tracker     data files of Tracker (Open Source Physics), one track or several\n'
        '  motive      .csv of OptiTrack\n'
        '  vicon       .csv of Nexus\n'
        '  trc         .trc of OpenSim, Cortex and others\n'
        '  c3d         .c3d, by kinpole_ros[formats]\n'
        '\n'
        'Cells are separated by commas, semicolons or tabs; with the latter two, decimals may be\n'
        'commas. Empty cells are markers that were not seen.',
        epilog='examples:\n'
        '  kinpole import walk.trc --output walk.mcap\n'
        '  kinpole import videoDLC_resnet50.csv --rate 240 --scale 0.00051 --output video.mcap\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    imported.add_argument('file', metavar='FILE', help='the file of points')
    imported.add_argument('--output', metavar='BAG', required=True, help='.mcap file to write')
    imported.add_argument(
        '--format', default='auto', metavar='NAME', help='one of the above (auto: by content)'
    )
    imported.add_argument(
        '--rate', type=float, metavar='HZ', help='frames per second, instead of times of the file'
    )
    imported.add_argument(
        '--scale', type=float, metavar='M_PER_UNIT', help='m per unit of the file (as it says)'
    )
    imported.add_argument(
        '--y-down',
        action=argparse.BooleanOptionalAction,
        help='y points down, as in pictures (as the format has it)',
    )
    imported.add_argument(
        '--likelihood',
        type=float,
        metavar='P',
        help='least at which a point counts as seen (DeepLabCut 0.6, SLEAP 0)',
    )


def _add_fit(commands: Any) -> None:
    fit = commands.add_parser(
        'fit',
        help="a scene's dimensions from measured markers, each with its deviation",
        description='Fits points, lengths and angles of a scene to the poses of its bodies in all\n'
        'frames, whatever drives them: least squares over what the joints lack. What the data do\n'
        'not tell stays as it is, and is named. Markers sit where the scene has them.',
        epilog='examples:\n'
        '  kinpole fit rig.yaml run.mcap\n'
        '  kinpole fit rig.yaml run.mcap --free rocker.B --free coupler --output fitted.yaml\n',
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
        help="what to fit: rocker.B, r2.length, or all of a body, vector or joint (the scene's "
        'free, or all)',
    )
    fit.add_argument('--output', metavar='SCENE.yaml', help='the scene, as fitted, to write')
    fit.add_argument('--topic', metavar='T', help="topic of the markers (config's, /markers)")


class _ListScenes(argparse.Action):
    """--list: print the scenes and end, as --version does."""

    def __init__(self, **words: Any) -> None:
        super().__init__(nargs=0, **words)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from kinpole_ros.mechanism import scene_names

        print('\n'.join(scene_names()))
        parser.exit()
