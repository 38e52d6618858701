"""Films on the command line: which files are videos, and the options of films."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions

# Files with these endings are videos.
_ENDINGS = (
    *('.mp4', '.mov', '.m4v', '.mkv', '.webm', '.avi', '.3gp', '.mts', '.m2ts'),
    *('.mjpeg', '.mjpg', '.h264', '.264', '.h265', '.265', '.hevc'),
)
_OF_PICTURES = '.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff'
_OPTIONS = 'size', 'ground', 'family', 'camera', 'line_time'
# Those that are of other files, too, or of films that are no video.
_SHARED = 'points', 'at', 'ruler', 'rate', 'topic'


def is_video(path: str | Path) -> bool:
    """
    Return whether a file is a video, or a folder has pictures, by the names.

    To look into them needs the extra `film`.
    """
    if Path(path).is_dir():
        return any(file.suffix.lower() in _OF_PICTURES for file in Path(path).iterdir())
    return Path(path).suffix.lower() in _ENDINGS


def is_bag_of_pictures(types: dict[str, str], topic: str | None) -> bool:
    """Return whether a bag with topics of these types is read as a film: it has no markers."""
    from kinpole_ros.messages import COMPRESSED_IMAGE, DETECTIONS, IMAGE, INPUT_TYPE_NAMES

    of_film = IMAGE, COMPRESSED_IMAGE, DETECTIONS
    if topic is not None:
        return types.get(topic if topic.startswith('/') else f'/{topic}') in of_film
    # A camera of depth has clouds of points, which are no markers.
    markers = {
        name for kind, name in INPUT_TYPE_NAMES.items() if kind not in ('tf', 'point_cloud2')
    }
    return any(kind in of_film for kind in types.values()) and not markers & set(types.values())


def given_names(options: Namespace) -> list[str]:
    """Return the options of films that are given, as on the command line."""
    names = [name for name in _OPTIONS if getattr(options, name) is not None]
    return [f'--{name.replace("_", "-")}' for name in names]


def film_options(options: Namespace) -> 'FilmOptions':
    """Return the options of a film that are given; the others have their defaults."""
    from kinpole_ros.film import FilmOptions

    given = {name: getattr(options, name, None) for name in _OPTIONS + _SHARED}
    given['ground'] = given['ground'] and tuple(given['ground'])
    return FilmOptions(**{name: value for name, value in given.items() if value is not None})
