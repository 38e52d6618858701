"""Commands that make markers of films and cameras: film and camera."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from kinpole_ros.tools.commands._command import (
    FILM_OPTIONS,
    FREQUENCY,
    LENGTH,
    TIME,
    command,
    option,
)
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import UsageError, print_lines, progress_bar
from kinpole_ros.tools.filmed import film_options

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions

_TO_WRITE = 'output', 'overlay', 'print', 'calibrate', 'picture'
_PLACE = r'(-?[\d.]+),(-?[\d.]+)'  # pixels


def _dots(text: str) -> dict[str, complex]:
    """Return dots, pixels, of 'crank=120,340 132,360; rod=7,8': crank_1, crank_2 and rod_1."""
    found = {}
    for part in filter(str.strip, text.split(';')):
        match = re.fullmatch(rf'\s*(\w+)\s*=((?:\s*{_PLACE})+)\s*', part)
        if match is None:
            raise argparse.ArgumentTypeError(
                f"{part!r} is not as 'crank=120,340 132,360; rod=250,90'"
            )
        for k, (x, y) in enumerate(re.findall(_PLACE, match[2]), 1):
            found[f'{match[1]}_{k}'] = complex(float(x), float(y))
    return found


def _ruler(text: str) -> tuple[complex, complex, float]:
    """Return two places, pixels, and their distance, m, of the text '120,340 520,338=0.35'."""
    match = re.fullmatch(rf'\s*{_PLACE}\s+{_PLACE}\s*=\s*(\S.*)', text)
    if match is None:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not as '120,340 520,338=0.35', two places and m"
        )
    x, y, u, v = map(float, match.groups()[:4])
    return complex(x, y), complex(u, v), LENGTH(match[5].strip())


@command(
    'film',
    option(
        'video VIDEO',
        'a video of the mechanism with tags on its links, a folder of pictures, or a bag of them',
        nargs='?',
    ),
    option('--output BAG', '.mcap file to write'),
    option('--overlay VIDEO', '.mp4 to write: the video with poles and centrodes drawn over it'),
    option('--print SHEET', 'write a sheet of tags to print, .svg or .pdf, and end'),
    option('--calibrate CAMERA', 'write the file of the camera that filmed the uncut sheet'),
    option(
        '--points DOTS', "dots to follow, pixels, as 'crank=120,340 132,360; rod=250,90'", _dots
    ),
    option('--at S', 'time of the picture in which the dots are chosen, s (0)', TIME),
    option(
        '--scale ENDS',
        "two places, pixels, and their distance, as '120,340 520,338=0.35': the axes without tags",
        _ruler,
        dest='ruler',
    ),
    option('--picture PNG', 'write the picture in which dots are chosen, with a grid of pixels'),
    option('--rate HZ', 'pictures per second that the camera took, instead of stamps', FREQUENCY),
    option('--topic T', 'topic of pictures or of detected tags in a bag (the only one)'),
    *FILM_OPTIONS,
)
def film(options: argparse.Namespace) -> int:
    """
    Convert a video of printed tags to a bag of markers.

    A tag becomes four markers, tag3_1 to tag3_4: its corners in the plane of motion, from top left,
    clockwise. Several tags may be on one link, and one on the ground. The stamps are those of the
    video, at the rate of its camera, or of the headers in a bag. It prints what it assumed, and the
    option that changes it.

    A folder of pictures, raw H.264, and the films of high-speed cameras do not say when a picture
    was taken: give --rate. A bag may have pictures, or the tags that apriltag_ros found in them.

    Films without tags have points to follow: dots, corners of paint, bolts. --picture writes the
    picture in which to choose them. One that is hidden or blurred is lost until it matches again.

    To calibrate a camera, film the uncut sheet, flat, from several sides, tilted by 30 degrees and
    more. It corrects the lens better than the tags of a film do by themselves.

    Examples:
      kinpole film --print tags.pdf
      kinpole film crank.mp4 --output crank.mcap --size 40mm
      kinpole film crank.mp4 --overlay poles.mp4
      kinpole film sheet.mp4 --calibrate phone.yaml
      kinpole film crank.mp4 --output crank.mcap --camera phone.yaml
      kinpole film slow.avi --output slow.mcap --rate 1000
      kinpole report crank.mp4
      kinpole film old.mp4 --picture first.png
      kinpole film old.mp4 --points 'crank=320,240 382,236; rod=512,190 700,205'
        --scale '300,410 690,408=0.35' --output old.mcap
    """
    check_outputs(
        [options.video, options.camera],
        [
            ('--output', options.output, 'an MCAP bag'),
            ('--overlay', options.overlay, 'a video'),
            ('--print', options.print, 'a sheet of tags'),
            ('--calibrate', options.calibrate, 'a YAML file'),
            ('--picture', options.picture, 'a PNG picture'),
        ],
    )
    if options.print is None and options.video is None:
        raise UsageError('film needs a VIDEO, or --print SHEET for tags to tape on the links')
    if not any(getattr(options, name) for name in _TO_WRITE):
        names = ', '.join(f'--{name}' for name in _TO_WRITE)
        raise UsageError(f'film needs a file to write: one of {names}')
    from kinpole_ros.film import calibrate, print_sheet, write_picture

    given = film_options(options)
    given.check()
    if options.print is not None:
        count = print_sheet(options.print, given.size, given.family)
        print(f'{count} tags of {given.size * 1e3:g} mm written to {options.print}')
        return 0
    if options.calibrate is not None:
        found = calibrate(options.video, options.calibrate, given)
        print(f'{found}; written to {options.calibrate}')
    if options.picture is not None:
        shown = write_picture(options.video, options.picture, given)
        print(f'the picture at {shown:.4g} s written to {options.picture}')
    if options.output is not None or options.overlay is not None:
        _write_markers(options, given)
    return 0


def _write_markers(options: argparse.Namespace, given: 'FilmOptions') -> None:
    """Write the bag of a video, and the video with what follows from it drawn over it."""
    import tempfile

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
    option(
        'source SOURCE', 'number or device of a camera, as 0 or /dev/video0; or a video', nargs='?'
    ),
    option('--topic T', 'topic of the markers (/markers)', default='/markers'),
    option('--detections T', 'topic of the tags that apriltag_ros finds, instead of a camera'),
    option('--info T', 'topic of their CameraInfo (/camera/camera_info)'),
    *FILM_OPTIONS,
)
def camera(options: argparse.Namespace) -> int:
    """
    Publish the tags that a camera sees as markers for a node.

    The camera stands still. In the first 45 pictures with tags it learns the plane of motion, as
    film does, and prints what it assumed; from then on it publishes a MarkerArray per picture, and
    the pictures on /kinpole_camera/image while somebody looks. The stamps are those of receipt, or
    of the video. It needs ROS.

    With --detections another detector finds the tags, in rectified pictures, as apriltag_ros does.
    The stamps are those of its messages.

    Examples:
      kinpole camera 0 --size 40mm
      kinpole camera --detections /detections --info /camera/camera_info --size 40mm
      kinpole camera crank.mp4 --topic /film/markers
    """
    from kinpole_ros.tools.camera import publish, publish_detections

    given = film_options(options)
    if (options.source is None) == (options.detections is None):
        raise UsageError('camera needs a SOURCE, or --detections TOPIC, and not both')
    if options.detections is None:
        if options.info is not None:
            raise UsageError('--info is for --detections')
        count = publish(options.source, given, options.topic)
    else:
        info = options.info or '/camera/camera_info'
        count = publish_detections(options.detections, info, given, options.topic)
    print(f'{count} messages published')
    return 0
