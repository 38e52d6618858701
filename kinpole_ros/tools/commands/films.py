"""The command that makes markers of films: film."""

import argparse

from kinpole_ros.tools.commands._command import FILM_OPTIONS, command, option
from kinpole_ros.tools.commands._output_files import check_outputs
from kinpole_ros.tools.commands._terminal import print_lines, progress_bar


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
    from kinpole_ros.tools.filmed import film_options

    check_outputs([options.video, options.camera], [('--output', options.output, 'an MCAP bag')])
    with progress_bar('film') as progress:
        filmed = film_to_bag(options.video, options.output, film_options(options), progress)
    print_lines(filmed.assumed)
    print(f'{len(filmed.stamps)} frames of {len(filmed.names)} markers written to {options.output}')
    return 0
