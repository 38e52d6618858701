"""Tracked points of other programs, to a bag."""

import argparse
import sys
from typing import Any

from kinpole_ros.packages import install_command
from kinpole_ros.tools.commands._shared import (
    check_ending,
    check_outputs,
    one_line,
    progress_bar,
)


def add(commands: Any) -> None:
    """Add the words of the command."""
    imported = commands.add_parser(
        'import',
        help='tracked points from the files of other programs to a bag',
        description='Reads tracked points as other programs write them. What a file says of units\n'
        'and times is used; what it does not say is asked for. Pixels count y down.\n'
        '\n'
        '  table       columns NAME_x, NAME_y, maybe NAME_z, and t in s (or time_ms ...), in m;\n'
        '              or t, x, y of one point\n'
        '  deeplabcut  .csv or .h5, one animal or several\n'
        '  sleap       analysis .csv or .h5\n'
        '  anipose     .csv of points in space\n'
        '  keypoints   OpenPose, a folder of .json; COCO .json\n'
        '  kinovea     trajectories as .csv, .txt or .xml, and angles as .csv\n'
        '  tracker     data files and .trk of Tracker (Open Source Physics)\n'
        '  motive      .csv of OptiTrack\n'
        '  vicon       .csv of Nexus\n'
        '  qualisys    .tsv, 3D or 6D\n'
        '  trc         .trc of OpenSim, Cortex and others\n'
        '  c3d         .c3d\n'
        '  bag         .bag of ROS 1; .db3, .mcap or a folder of ROS 2: markers, poses, or what\n'
        '              mocap4r2, motion_capture_tracking and VRPN publish\n'
        '\n'
        f'.h5 needs h5py: {install_command("formats")}\n'
        'Cells are separated by commas, semicolons or tabs; with the latter two, decimals may be\n'
        'commas. Empty cells are markers that were not seen. Poses of bodies are written to /tf.',
        epilog='examples:\n'
        '  kinpole import walk.trc --output walk.mcap\n'
        '  kinpole import run_6D.tsv --output run.mcap\n'
        '  kinpole import videoDLC_resnet50.csv --rate 240 --scale 0.00051 --output video.mcap\n',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    imported.add_argument('file', metavar='FILE', help='the file of points, or a folder')
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


def run(options: argparse.Namespace) -> int:
    """Do it, and print the outcome; the exit status."""
    from kinpole_ros.bags import import_points

    check_outputs([options.file], [options.output])
    check_ending('--output', options.output, 'an MCAP bag')
    with progress_bar('import') as progress:
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
        print(f'kinpole import: {one_line(note)}', file=sys.stderr)
    unit = f'in {done.unit}' if options.scale is None else f'1 unit = {done.scale:g} m'
    print(
        f'{done.frames} frames of {len(done.markers)} markers ({done.format}, {unit}) '
        f'written to {options.output}'
    )
    return 0
