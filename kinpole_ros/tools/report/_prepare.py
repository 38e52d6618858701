"""A bag and its parameters from any file of points, with the assumptions that were made."""

import shlex
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from kinpole_ros.bags import BagError, Imported, import_points, topics
from kinpole_ros.messages import TF
from kinpole_ros.settings import GROUND, Settings, assignments, load_settings, settings_from
from kinpole_ros.tools.filmed import film_options, given_names, is_bag_of_pictures, is_video
from kinpole_ros.tools.record.result_bag import has_results, is_bag

if TYPE_CHECKING:
    from kinpole_ros.film import Filmed

_OF_POINTS = 'rate', 'scale', 'y_down'  # options for data that a file of points may lack
_OF_FILM = 0.7  # of the time, which the search for tags takes
_MOST_NAMES = 4  # bodies that are named in a line


Progress = Callable[[float], None] | None


class Prepared(NamedTuple):
    """
    A bag, the settings to replay it with, and the assumptions, with the options to change.

    `topic` is that of its markers, if it was given, and `film` what was found in the video of the
    bag, if there is one.
    """

    bag: str
    settings: Settings
    assumed: list[str]
    topic: str | None = None
    film: 'Filmed | None' = None


@contextmanager
def prepared(
    options: Namespace, settings: Settings, progress: Progress = None
) -> Iterator[Prepared]:
    """
    Import the file of `kinpole report` if it is no bag; find its bodies if `settings` name none.

    Temporary files are removed at the end. Raises BagError for a file that cannot be read; if no
    bodies are found, an assumption says so.
    """
    file, topic = options.bag, options.topic
    assumed: list[str] = []
    film = None
    with tempfile.TemporaryDirectory(prefix='kinpole_') as folder:
        bag = file
        is_film = _is_film(file, topic)
        if is_film:
            _refuse(options, ('scale', 'y_down'), f'{file} is a film; its scale is --size')
            bag, topic = str(Path(folder) / f'{Path(file).stem}.mcap'), None
            film = _read(file, options, bag, progress)
            assumed += film.assumed
        elif (names := given_names(options)) and options.video is None:
            raise BagError(
                f'{file} is no video, and {", ".join(names)} are of videos; fix: leave them out'
            )
        elif not is_bag(file):
            bag = str(Path(folder) / f'{Path(file).stem}.mcap')
            imported = import_points(file, bag, options.rate, options.scale, options.y_down)
            assumed.append(_import_text(imported))
            if imported.bodies == imported.markers and settings.bodies == Settings().bodies:
                settings = _settings_of_poses(imported.bodies, options.set)
                assumed.append(_pose_text(settings))
        else:
            own = _OF_POINTS if options.video is None else _OF_POINTS[1:]
            _refuse(options, own, f'{file} is a bag, which has its stamps and is in m')
        if options.video is not None:
            film = _read(options.video, options, None, progress)
        has_bodies = settings.bodies != Settings().bodies
        if not has_bodies and (topic is not None or not has_results(bag)):
            rig, lines, found = found_rig(file, bag, topic, Path(folder) / 'rig.yaml', progress)
            assumed += lines
            if rig is not None:
                settings = load_settings(rig, changes=assignments(options.set))
                lag = settings.of_recording().lag
                assumed.append(
                    f'window {settings.window:g} s, lag {lag:g} s, noise estimated from '
                    'the markers; to change: --set window:=0.2 --set lag:=0.1'
                )
            assumed += found
        yield Prepared(bag, settings, assumed, topic, film)


def _is_film(file: str, topic: str | None) -> bool:
    """Return whether a file is a film, of a container, a folder or a bag."""
    if is_video(file) or not (Path(file).exists() and is_bag(file)):
        return is_video(file)
    return is_bag_of_pictures(topics(file), topic) and not has_results(file)


def _refuse(options: Namespace, names: tuple[str, ...], why: str) -> None:
    """Raise BagError if one of these options, of files of points, is given."""
    if given := [one for one in names if getattr(options, one) is not None]:
        listed = ', '.join(f'--{name.replace("_", "-")}' for name in given)
        raise BagError(
            f'{why}; {listed} are for files of points; fix: leave them out, or set the parameter '
            'scale'
        )


def _read(file: str, options: Namespace, bag: str | None, progress: Progress) -> 'Filmed':
    """Return what is found in a video, and write it to a bag, if there is one to write."""
    from kinpole_ros.film import film_to_bag, read_film

    share = progress and (lambda done: progress(_OF_FILM * done))
    given = film_options(options)
    given = given if bag else replace(given, topic=None)  # that of the markers
    return film_to_bag(file, bag, given, share) if bag else read_film(file, given, share)


def _settings_of_poses(names: tuple[str, ...], changes: Sequence[str]) -> Settings:
    """Return the settings by which each pose on /tf is a body, of its name where that may be."""
    bodies = {
        name if name.isascii() and name.isidentifier() and name != GROUND else f'body_{k}': name
        for k, name in enumerate(names, 1)
    }
    values = {'marker_type': 'tf', 'marker_topic': TF, 'bodies': list(bodies)}
    values |= {f'{body}.markers': [name] for body, name in bodies.items()}
    return settings_from(values | assignments(changes))


def _pose_text(settings: Settings) -> str:
    names = list(settings.bodies)
    more = f' and {len(names) - _MOST_NAMES} more' if len(names) > _MOST_NAMES else ''
    return (
        f'bodies: {", ".join(names[:_MOST_NAMES])}{more}, each by its pose; to change: kinpole '
        'import FILE --output BAG, and give it with --config rig.yaml'
    )


def _import_text(imported: Imported) -> str:
    notes = ''.join(f'; {note}' for note in imported.notes)
    return f'file: {imported}{notes}; to change: --scale, --rate, --y-down, --no-y-down'


def found_rig(
    file: str, bag: str, topic: str | None, rig: Path, progress: Progress
) -> tuple[Path | None, list[str], list[str]]:
    """Write the parameter file of a rig; return it or None, assumptions, and what was found."""
    from kinpole_ros.linkage import input_texts, joint_lines, marker_lines, parameter_file
    from kinpole_ros.tools.discover import find_linkage

    try:
        linkage, marker_topic, _ = find_linkage(bag, topic, progress=progress)
    except BagError as error:
        return None, [f'bodies: not found: {str(error).removeprefix(f"{bag}: ")}'], []
    rig.write_text(parameter_file(linkage, marker_topic), encoding='utf-8')
    values = input_texts(linkage)
    counts = zip(linkage.names, map(len, linkage.markers), strict=True)
    names = [f'{name} of {count} markers' for name, count in counts]
    suffix = f' and {len(names) - _MOST_NAMES} more' if len(names) > _MOST_NAMES else ''
    command = f'kinpole discover {shlex.quote(file if file == bag else "BAG")} --output rig.yaml'
    is_film = is_video(file) or (file != bag and is_bag(file))
    first = f'kinpole {"film" if is_film else "import"} FILE --output BAG, then '
    first = '' if file == bag else first
    lines = [
        f'plane: {values["plane"]}; to change: --set plane:=xy',
        f'unit: {values["unit"]}; names: {values["names"]}; to change: --set scale:=1',
    ]
    # The plane and the unit of a film are those of its tags.
    lines = [
        *([] if is_film else lines),
        f'bodies: {", ".join(names[:_MOST_NAMES])}{suffix}, found from the motion; to change: '
        f'{first}{command}, edit it, and give --config rig.yaml',
    ]
    return rig, lines, [*marker_lines(linkage), *filter(None, joint_lines(linkage))]
