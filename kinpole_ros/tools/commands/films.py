"""Commands that make markers of films and cameras: film and camera."""

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from kinpole_ros.tools.commands._command import FILM_OPTIONS, command, option
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import UsageError, print_lines, progress_bar

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions


@command(
    'film',
    option('video VIDEO', 'a video of the mechanism with tags on its links', nargs='?'),
    option('--output BAG', '.mcap file to write'),
    option('--overlay VIDEO', '.mp4 to write: the video with poles and centrodes drawn over it'),
    option('--print SHEET', 'write a sheet of tags to print, .svg or .pdf, and end'),
    option('--calibrate CAMERA', 'write the file of the camera that filmed the uncut sheet'),
    *FILM_OPTIONS,
)
def film(options: argparse.Namespace) -> int:
    """
    Convert a video of printed tags to a bag of markers.

    A tag becomes four markers, tag3_1 to tag3_4: its corners in the plane of motion, from top left,
    clockwise. Several tags may be on one link, and one on the ground. The stamps are those of the
    video. It prints what it assumed, and the option that changes it.

    To calibrate a camera, film the uncut sheet, flat, from several sides, tilted by 30 degrees and
    more. It corrects the lens better than the tags of a film do by themselves.

    Examples:
      kinpole film --print tags.pdf
      kinpole film crank.mp4 --output crank.mcap --size 40mm
      kinpole film crank.mp4 --overlay poles.mp4
      kinpole film sheet.mp4 --calibrate phone.yaml
      kinpole film crank.mp4 --output crank.mcap --camera phone.yaml
      kinpole report crank.mp4
    """
    check_outputs(
        [options.video, options.camera],
        [
            ('--output', options.output, 'an MCAP bag'),
            ('--overlay', options.overlay, 'a video'),
            ('--print', options.print, 'a sheet of tags'),
            ('--calibrate', options.calibrate, 'a YAML file'),
        ],
    )
    if options.print is None and options.video is None:
        raise UsageError('film needs a VIDEO, or --print SHEET for tags to tape on the links')
    if not any((options.print, options.output, options.overlay, options.calibrate)):
        raise UsageError('film needs --output BAG, --overlay VIDEO or --calibrate CAMERA to write')
    from kinpole_ros.film import calibrate, print_sheet
    from kinpole_ros.tools.filmed import film_options

    given = film_options(options)
    given.check()
    if options.print is not None:
        count = print_sheet(options.print, given.size, given.family)
        print(f'{count} tags of {given.size * 1e3:g} mm written to {options.print}')
        return 0
    if options.calibrate is not None:
        found = calibrate(options.video, options.calibrate, given.size, given.family)
        print(f'{found}; written to {options.calibrate}')
    if options.output is not None or options.overlay is not None:
        _write_markers(options, given)
    return 0


def _write_markers(options: argparse.Namespace, given: 'FilmOptions') -> None:
    """Write the bag of a video, and the video with what follows from it drawn over it."""
    from kinpole_ros.film import film_to_bag
    from kinpole_ros.tools.overlay import draw_over

    with tempfile.TemporaryDirectory(prefix='kinpole_') as folder:
        bag = options.output or str(Path(folder) / 'markers.mcap')
        with progress_bar('film') as progress:
            filmed = film_to_bag(options.video, bag, given, progress)
        lines = filmed.assumed
        if options.overlay is not None:
            with progress_bar('overlay') as progress:
                lines = lines + draw_over(options.video, filmed, bag, options.overlay, progress)
    print_lines(lines)
    if options.output is not None:
        frames = f'{len(filmed.stamps)} frames of {len(filmed.names)} markers'
        print(f'{frames} written to {options.output}')
    if options.overlay is not None:
        print(f'drawn over the video in {options.overlay}')


@command(
    'camera',
    option('source SOURCE', 'number or device of a camera, as 0 or /dev/video0; or a video'),
    option('--topic T', 'topic of the markers (/markers)', default='/markers'),
    *FILM_OPTIONS,
)
def camera(options: argparse.Namespace) -> int:
    """
    Publish the tags that a camera sees as markers for a node.

    The camera stands still. In the first 45 pictures with tags it learns the plane of motion, as
    film does, and prints what it assumed; from then on it publishes a MarkerArray per picture, and
    the pictures on /kinpole_camera/image while somebody looks. The stamps are those of receipt, or
    of the video. It needs ROS.

    Examples:
      kinpole camera 0 --size 40mm
      kinpole camera crank.mp4 --topic /film/markers
    """
    from kinpole_ros.tools.camera import publish
    from kinpole_ros.tools.filmed import film_options

    count = publish(options.source, film_options(options), options.topic)
    print(f'{count} messages published')
    return 0
