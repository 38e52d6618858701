"""
Printed tags in a film: from a video to markers in the plane of motion.

Nothing outside this package uses OpenCV or FFmpeg (PyAV), which the extra `film` installs.
"""

from kinpole_ros.film._calibration import calibrate
from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._film import film_to_bag, read_film
from kinpole_ros.film._filmed import SIZE, Filmed, FilmOptions
from kinpole_ros.film._lens import Lens, rectified_lens
from kinpole_ros.film._live_tags import LiveTags, jpeg, live_pictures
from kinpole_ros.film._overlay import Shape, straightened, write_overlay, write_picture
from kinpole_ros.film._printed import print_sheet

__all__ = [
    'SIZE',
    'FilmError',
    'FilmOptions',
    'Filmed',
    'Lens',
    'LiveTags',
    'Shape',
    'calibrate',
    'film_to_bag',
    'jpeg',
    'live_pictures',
    'print_sheet',
    'read_film',
    'rectified_lens',
    'straightened',
    'write_overlay',
    'write_picture',
]
