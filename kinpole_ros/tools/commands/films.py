"""The command that makes markers of films: film."""

import argparse
from typing import TYPE_CHECKING

from kinpole_ros.tools.commands._command import LENGTH, TIME, command, option
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import print_lines, progress_bar

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions

# What a film does not tell; `report` has these options too.
FILM_OPTIONS = (
    option('--size M', 'side of the black square of a tag, m, or as 40mm (0.04)', LENGTH),
    option('--ground ID...', 'tags that stand still; the first is the origin (0)', int),
    option('--family NAME', 'family of the tags, as 36h11 (auto: by what is seen)'),
    option('--camera FILE', "file of the camera, as OpenCV's calibration writes it"),
    option('--line-time S', 'time between two rows of a rolling shutter, s, or as 20us (0)', TIME),
)


def film_options(options: argparse.Namespace) -> 'FilmOptions':
    """Return the options of a film that are given; the others have their defaults."""
    from kinpole_ros.film import FilmOptions

    names = 'size', 'ground', 'family', 'camera', 'line_time'
    given = {name: getattr(options, name) for name in names}
    given['ground'] = given['ground'] and tuple(given['ground'])
    return FilmOptions(**{name: value for name, value in given.items() if value is not None})


@command(
    'film',
    option('video VIDEO', 'a video of the mechanism with tags on its links'),
    option('--output BAG', '.mcap file to write', required=True),
    *FILM_OPTIONS,
)
def film(options: argparse.Namespace) -> int:
    """
    Convert a video of printed tags to a bag of markers.

    A tag becomes four markers, tag3_1 to tag3_4: its corners in the plane of motion, from top left,
    clockwise. Several tags may be on one link, and one on the ground. The stamps are those of the
    video. It prints what it assumed, and the option that changes it.

    Examples:
      kinpole film crank.mp4 --output crank.mcap --size 40mm
      kinpole discover crank.mcap --output rig.yaml
      kinpole report crank.mp4
    """
    from kinpole_ros.film import film_to_bag

    check_outputs([options.video, options.camera], [('--output', options.output, 'an MCAP bag')])
    with progress_bar('film') as progress:
        filmed = film_to_bag(options.video, options.output, film_options(options), progress)
    print_lines(filmed.assumed)
    print(f'{len(filmed.stamps)} frames of {len(filmed.names)} markers written to {options.output}')
    return 0
