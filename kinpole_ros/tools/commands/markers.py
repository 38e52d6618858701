"""Commands that make bags of markers: simulate and import."""

import argparse
from typing import Any

from kinpole_ros.tools.commands._command import (
    BAG_OUTPUT,
    DEGREES,
    FREQUENCY,
    LENGTH,
    POINT_OPTIONS,
    SCENE,
    TIME,
    command,
    flag,
    option,
)
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import print_error, progress_bar


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
    option('--rate HZ', 'frames per second (200)', FREQUENCY, 200.0),
    option('--duration S', 'length of the recording, s (5)', TIME, 5.0),
    option('--noise M', 'noise of a marker per axis, m, or as 0.2mm (0)', LENGTH, 0.0),
    option('--seed N', 'seed of the random numbers (0)', int, 0),
    option('--dropout P', 'share of markers not seen (0)', float, 0.0),
    option(
        '--jitter S',
        'jitter of the times of the frames, s (0); the stamps have the true times',
        TIME,
        0.0,
    ),
    option(
        '--message TYPE',
        'marker_array (the default), marker, pose_array or point_cloud2; or poses of the bodies: '
        'pose_stamped, body_poses or tf',
        default='marker_array',
    ),
    option(
        '--arrival S',
        'mean of an exponential delay of the stamps, s (0); the frames keep their order',
        TIME,
        0.0,
    ),
    option('--tilt DEG', 'turn of the plane of motion about the x axis, degrees (0)', DEGREES, 0.0),
    option('--scale F', 'units per meter: 1000 for mm (1)', float, 1.0),
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
    option('file FILE', 'the file of points, or a folder'),
    BAG_OUTPUT,
    option('--format NAME', 'one of the above (auto: by content)', default='auto'),
    *POINT_OPTIONS,
    option(
        '--likelihood P',
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
                  or t, x, y of one point; or a row for each point, with its id; or poses,
                  as rostopic, PlotJuggler and bagpy write them
      deeplabcut  .csv or .h5, one animal or several
      sleap       analysis .csv or .h5
      movement    .nc (netCDF)
      nwb         series of poses or places
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

    Files that end in .h5, .nc or .nwb need h5py (pip install h5py). Cells are separated by commas,
    semicolons or tabs; with the latter two, decimals may be commas. Empty cells are markers that
    were not seen. Poses of bodies are written to /tf.

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
    print(f'{imported}, written to {options.output}')
    return 0
