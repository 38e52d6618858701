"""Films on the command line: which files are videos, and the options of films."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kinpole_ros.film import FilmOptions

# Files with these endings are videos.
_ENDINGS = ('.mp4', '.mov', '.m4v', '.mkv', '.webm', '.avi', '.3gp', '.mts', '.m2ts', '.mjpeg')
_OPTIONS = 'size', 'ground', 'family', 'camera', 'line_time'
_OF_DOTS = 'points', 'at', 'ruler'


def is_video(path: str | Path) -> bool:
    """Return whether a file is a video, by its name: to look into it needs the extra `film`."""
    return Path(path).suffix.lower() in _ENDINGS


def given_names(options: Namespace) -> list[str]:
    """Return the options of films that are given, as on the command line."""
    names = [name for name in _OPTIONS if getattr(options, name) is not None]
    return [f'--{name.replace("_", "-")}' for name in names]


def film_options(options: Namespace) -> 'FilmOptions':
    """Return the options of a film that are given; the others have their defaults."""
    from kinpole_ros.film import FilmOptions

    given = {name: getattr(options, name, None) for name in _OPTIONS + _OF_DOTS}
    given['ground'] = given['ground'] and tuple(given['ground'])
    return FilmOptions(**{name: value for name, value in given.items() if value is not None})
