"""Commands on scenes and rigs: solve, tolerance, discover and fit."""

import argparse

from kinpole_ros.tools.commands._command import BAG, SCENE, TIME, TOPIC, command, flag, option
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import UsageError, print_error, print_lines, progress_bar


@command(
    'solve',
    SCENE,
    [
        option(
            '--at VALUE',
            'value of the driver: "-45 deg", "0.5 rad", "12 cm"; a number without a unit is in rad '
            'or m, and the output says so',
        ),
        flag('--sweep', 'all positions over the whole range of the driver'),
        option('--time S', 'the motion that the drivers prescribe, for S seconds'),
    ],
    flag('--centers', 'instant centers, with the deduction by hand'),
    flag('--statics', 'efforts of the drivers and forces in the joints'),
    flag(
        '--work',
        'the statics step by step: virtual work line by line, the share of each load, each bearing '
        'force by releasing the bearing, mechanical advantages',
    ),
    option('--csv FILE', 'all quantities as a table, in SI units'),
    option('--plot FILE.png', 'picture of the linkage, and of the rates over the range'),
    option(
        '--centrodes BODY...',
        'draw the centrodes of these bodies in the picture of --plot',
        default=(),
    ),
    option(
        '--inflection BODY...',
        "draw the inflection circles of these bodies, Ball's points, cubics of stationary "
        'curvature, and the circles on which their points move, in the picture of --plot',
        default=(),
    ),
    option(
        '--polygon FILE.svg',
        'velocity and acceleration polygons to scale, and the linkage, .svg or .png: at --at, at '
        'time 0, or at the end of --time',
    ),
    option(
        '--curvature FILE.svg',
        'inflection circles and centers of curvature by Euler-Savary and Bobillier, to scale, .svg '
        'or .png, at the same position',
    ),
    option(
        '--decompose BODY:A,B FILE.svg',
        "Poisson's decomposition: translation with the point A and rotation about it, and the same "
        'for B, from time 0 to --at or the end of --time, and of the velocities there',
        default=(),
    ),
    option(
        '--animate FILE.gif',
        'the linkage in motion, over and over: .gif, .svg, or .mp4 if ffmpeg is installed',
    ),
    option(
        '--export FILE.dxf',
        'the linkage for other programs: .dxf with the paths of its points, in mm; .xml for MuJoCo '
        'or .urdf, for pins, slots and cylinders',
    ),
    option(
        '--html FILE.html',
        'the linkage in motion, as in a report; you can drag its points and save the scene',
    ),
    option(
        '--pitch BODY BODY FILE',
        'centrodes of two bodies as pitch curves: .csv, or .svg and .dxf true to scale',
        default=(),
    ),
)
def solve(options: argparse.Namespace) -> int:
    """
    Analyze a mechanism: motion, dead points, instant centers and forces.

    Solves a scene exactly: positions and rates at time 0, at a value of its driver, over the whole
    range that the linkage allows, with limits and dead points, or over time.

    Examples:
      kinpole solve four_bar --at "45 deg" --centers
      kinpole solve slider_crank --sweep --csv crank.csv --plot crank.png
      kinpole solve double_pendulum --time 5 --csv course.csv --html course.html
      kinpole solve loader_cylinder --statics
      kinpole solve four_bar --at "60 deg" --polygon polygons.svg
      kinpole solve four_bar --at "60 deg" --curvature curvature.svg
      kinpole solve pool_lift --animate lift.gif --export lift.dxf
      kinpole solve elliptic_gears --pitch crank follower gears.svg
    """
    from kinpole_ros.tools.solve import solve_scene

    outputs = [
        ('--csv', options.csv, 'a CSV table'),
        ('--plot', options.plot, ''),
        ('--html', options.html, 'an HTML page'),
        ('--polygon', options.polygon, ''),
        ('--curvature', options.curvature, ''),
        ('--animate', options.animate, ''),
        ('--export', options.export, 'a linkage for other programs'),
        ('--pitch', options.pitch[2] if options.pitch else None, 'a pair of pitch curves'),
        ('--decompose', options.decompose[1] if options.decompose else None, ''),
    ]
    check_outputs([options.scene], outputs)
    print_lines(solve_scene(options))
    return 0


@command(
    'tolerance',
    SCENE,
    option(
        '--tolerances NAME=DEVIATION...',
        'standard deviations of a point, a length or an angle (coupler.B=0.1mm), of all of a body, '
        'vector or joint, or without a name of every length or angle; play (play:B=0.05mm): radial '
        'of pins, to either side of a slot, half the backlash of gears, uniform; or a file with '
        'the output of `kinpole fit` (0.1mm 0.1deg)',
        default=(),
    ),
    option(
        '--samples N', 'linkages with random errors (1000); 0 for the first order alone', int, 1000
    ),
    option('--csv FILE', 'all results over the range as a table, in SI units'),
    option('--plot FILE.png', 'picture of the standard deviations over the range'),
    option('--html FILE.html', 'the linkage in motion, with its bands'),
)
def tolerance(options: argparse.Namespace) -> int:
    """
    Compute how errors of lengths and play in pins move points, angles and centers.

    Prints the standard deviations of all points, angles and centers over the range of a scene, to
    first order and of linkages with random errors, and which dimensions cause them.

    Examples:
      kinpole tolerance four_bar --tolerances 0.1mm play:B=0.05mm
      kinpole tolerance four_bar --tolerances coupler.B=0.2mm --plot errors.png
      kinpole fit four_bar run.mcap > fitted.txt
      kinpole tolerance four_bar --tolerances fitted.txt --html expected.html
    """
    from kinpole_ros.tools.solve import tolerances

    if options.samples < 0:
        raise UsageError(f'--samples is {options.samples}; it must be 0 or more')
    outputs = [
        ('--csv', options.csv, 'a CSV table'),
        ('--html', options.html, 'an HTML page'),
        ('--plot', options.plot, 'a picture'),
    ]
    check_outputs([options.scene], outputs)
    print_lines(tolerances(options))
    return 0


@command(
    'discover',
    option(
        'source BAG_OR_TOPIC',
        'an .mcap or .db3 file or a rosbag2 folder, or a topic that is being published',
    ),
    option('--topic T', 'topic of the markers in the bag (/markers, or the only one)'),
    option(
        '--seconds S',
        'use the first S seconds of a bag (60), or S seconds of a live topic (20)',
        TIME,
    ),
    option(
        '--plane P',
        'plane of motion: xy, yz, zx or its normal nx,ny,nz (auto: found from the motion)',
        default='auto',
    ),
    option('--output RIG.yaml', 'parameter file to write'),
    option('--scene SCENE.yaml', 'draft scene to write'),
    option('--plot FILE.png', 'picture of bodies and joints to write'),
)
def discover(options: argparse.Namespace) -> int:
    """
    Find the bodies, joints and lengths of a rig from its markers.

    Finds which markers belong to which rigid body, in which plane and unit, and what joins the
    bodies: pins, slides, wheels and gears, with positions, lengths and standard deviations. Needs
    two or more markers per body, in motion. Names, order and dropouts do not matter. Bodies that do
    not move in one plane, such as in a walk, are listed with their axes and joints in space; they
    need names, and three markers each.

    Prints a table. Writes a parameter file for replay and the node, and a draft scene for solve and
    simulate, in which names and drivers are a first guess.

    Examples:
      kinpole discover recording.mcap
      kinpole discover recording.mcap --output rig.yaml --scene draft.yaml --plot rig.png
      kinpole discover /mocap/markers --seconds 30 --output rig.yaml
    and then
      kinpole replay recording.mcap --config rig.yaml --output result.mcap
      kinpole solve draft.yaml --centers

    Move all joints through their range, one against the other, at changing speed: a joint that does
    not move cannot be found. "left over" is the residual of a joint over the noise: 1 is perfect;
    more is play, a distorting lens, or a body that bends.
    """
    from kinpole_ros.tools.discover import discover_rig

    outputs = [
        ('--output', options.output, 'a YAML file'),
        ('--scene', options.scene, 'a YAML file'),
        ('--plot', options.plot, ''),
    ]
    check_outputs([options.source], outputs)
    troubles: list[object] = []
    with progress_bar('discover') as progress:
        lines = discover_rig(options, progress, troubles.append)
    print_lines(lines)
    return _print_troubles('discover', troubles)


@command(
    'fit',
    SCENE,
    BAG,
    option(
        '--config FILE',
        "ROS 2 parameter file, as for the node; without it, the scene's bodies and markers",
    ),
    option(
        '--free NAME...',
        'what to fit: a point (rocker.B), a length (r2.length), or all of a body, vector or joint; '
        'repeatable, or separated by commas (the list "free" of the scene, or all)',
        action='append',
    ),
    option('--output SCENE.yaml', 'fitted scene to write'),
    TOPIC,
)
def fit(options: argparse.Namespace) -> int:
    """
    Fit the dimensions of a scene to measured markers, with standard deviations.

    Fits points, lengths and angles of a scene to the poses of its bodies in all frames, however
    they are driven: least squares over the residuals of the joints. Dimensions that the data do not
    determine stay as they are, and are named. The positions of the markers are those of the scene.

    Examples:
      kinpole fit machine.yaml run.mcap
      kinpole fit machine.yaml run.mcap --free rocker.B coupler --output fitted.yaml
      kinpole fit --free rocker.B,coupler machine.yaml run.mcap
    """
    from kinpole_ros.tools.fit_scene import fit_bag

    inputs = [options.scene, options.bag, options.config]
    check_outputs(inputs, [('--output', options.output, 'a YAML file')])
    troubles: list[object] = []
    with progress_bar('fit') as progress:
        lines = fit_bag(options, progress, troubles.append)
    print_lines(lines)
    return _print_troubles('fit', troubles)


def _print_troubles(name: str, troubles: list[object]) -> int:
    """Print what is missing from a bag that was used otherwise; return the exit status."""
    for trouble in troubles:
        print_error(name, trouble)
    return 2 if troubles else 0
