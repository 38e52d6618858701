"""Commands that show results: plot, report and layout."""

import argparse
from pathlib import Path

from kinpole_ros.tools.commands._command import (
    FILM_OPTIONS,
    POINT_OPTIONS,
    SET,
    TOPIC,
    command,
    option,
)
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import print_error, print_lines, progress_bar
from kinpole_ros.tools.commands.replay import settings_of


@command(
    'plot',
    option('bag BAG', 'bag of results, from replay or recorded live'),
    option('--output FILE.png', 'picture to write', required=True),
)
def plot(options: argparse.Namespace) -> int:
    """
    Draw a picture of a bag of results.

    Draws centrodes, poles and rates with their bands. A bag of markers has no results: replay it
    first, or use kinpole report, which does both.
    """
    from kinpole_ros.tools.plot import plot as plot_bag

    check_outputs([options.bag], [('--output', options.output, '')])
    with progress_bar('plot') as progress:
        truncated = plot_bag(options.bag, options.output, progress)
    print(f'drawn to {options.output}')
    if truncated:
        print_error('plot', truncated)
    return 2 if truncated else 0


@command(
    'report',
    option('bag FILE', 'bag of markers or of results, a file of points, or a film of tags'),
    option('--output FILE.html', 'report to write (named as FILE, in this folder)'),
    option('--config FILE', 'parameter file, as for replay'),
    SET,
    TOPIC,
    option(
        '--scene SCENE', 'show the theory of a scene too; without --config, its bodies are tracked'
    ),
    *POINT_OPTIONS,
    option('--video VIDEO', 'the film that the bag was made of, to be shown behind the drawing'),
    *FILM_OPTIONS,
)
def report(options: argparse.Namespace) -> int:
    """
    Write a report of a recording as one HTML file that works offline.

    The report shows the linkage in motion with its poles, centrodes and velocities, all quantities
    over time with their bands, and what was withheld and why. It needs a browser and nothing else.
    Markers are read twice, so that each frame has a result, as with replay --whole.
    FILE may be any file that import reads, or a film of printed tags, as film reads it. Without
    --config or --scene the bodies and the plane are found first, as discover does; the assumptions
    are printed, with the option that changes each.

    Examples:
      kinpole report recording.mcap --config rig.yaml --output report.html
      kinpole report recording.mcap --scene four_bar --output report.html
      kinpole report walk.trc
      kinpole report crank.mp4 --size 40mm
      kinpole report result.mcap --output report.html
    """
    from kinpole_ros.tools.report import prepared, settings_for
    from kinpole_ros.tools.report import report as write_report

    settings = settings_for(settings_of(options), options.scene)
    output = options.output or f'{Path(options.bag).stem}.html'
    check_outputs(
        [options.config, settings.scene, options.bag, options.video, options.camera],
        [('--output', output, 'an HTML page')],
    )
    with (
        progress_bar('report') as progress,
        prepared(options, settings, progress) as ready,
    ):
        assumptions = list(ready.assumed)
        record = write_report(
            ready.bag,
            output,
            ready.settings,
            ready.topic,
            progress,
            assumptions.append,
            options.bag,
            ready.film,
        )
    thinned = '' if len(record.stamp) == record.total else f' of {record.total}'
    if assumptions:
        print_lines(assumptions)
    lost = f'; {record.lost} frames lost' if record.lost else ''
    print(f'{len(record.stamp)}{thinned} instants of {", ".join(record.bodies)}{lost}')
    print(f'written to {output}')
    return 0


@command(
    'layout',
    option(
        'viewer',
        'foxglove (also for Lichtblick) or plotjuggler',
        choices=('foxglove', 'plotjuggler'),
    ),
    option(
        '--config FILE', 'parameter file, or bag of results; without it, the default parameters'
    ),
    option('--output FILE', 'layout to write', required=True),
)
def layout(options: argparse.Namespace) -> int:
    """
    Write a layout of a rig's topics for Foxglove, Lichtblick or PlotJuggler.

    The layout has the drawing, rates with their standard deviations, and diagnostics; in
    PlotJuggler also the paths of the poles, and joints.

    Examples:
      kinpole layout foxglove --config rig.yaml --output rig.json
      kinpole layout plotjuggler --config result.mcap --output rig.xml
    """
    from kinpole_ros.tools.layout import write_layout

    kinds = {'foxglove': 'a Foxglove layout', 'plotjuggler': 'a PlotJuggler layout'}
    check_outputs([options.config], [('--output', options.output, kinds[options.viewer])])
    rig = write_layout(options.viewer, options.config, options.output)
    print(f'{options.output}: {", ".join(rig.bodies)} of {rig.node}')
    return 0
