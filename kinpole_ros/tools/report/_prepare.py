"""From any file that can be read to a bag and its parameters, with what was assumed on the way."""

import shlex
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from kinpole_ros.bags import BagError, Imported, import_points, topics
from kinpole_ros.tools.report._results import has_results
from kinpole_ros.tracking.parameters import Settings, load_settings

# These are bags, whatever is wrong with them.
_BAGS = ('.mcap', '.db3', '.bag')
_NAMED = 4  # bodies that are named in a line


class Points(NamedTuple):
    """What a file of points may not say: frames per second, m per unit, whether y points down."""

    rate: float | None
    scale: float | None
    y_down: bool | None


class Prepared(NamedTuple):
    """A bag, the settings to replay it with, and lines on what was assumed, with how to change."""

    bag: str
    settings: Settings
    assumed: list[str]


@contextmanager
def prepared(
    file: str,
    settings: Settings,
    changes: dict[str, object],
    topic: str | None,
    points: Points,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Prepared]:
    """
    Import `file` where it is no bag, and find its bodies where `settings` name none.

    `changes` are parameters given besides. What is made on the way is removed at the end. Raises
    BagError for a file that cannot be read; bodies that are not found are said in a line.
    """
    assumed: list[str] = []
    with tempfile.TemporaryDirectory(prefix='kinpole_') as folder:
        bag = file
        if not _is_bag(file):
            bag = str(Path(folder) / f'{Path(file).stem}.mcap')
            done = import_points(file, bag, points.rate, points.scale, points.y_down)
            assumed.append(_about_import(done))
        is_open = settings.bodies == Settings().bodies
        if is_open and (topic is not None or not has_results(bag)):
            found, lines = _discovered(file, bag, topic, Path(folder) / 'rig.yaml', progress)
            assumed += lines
            if found is not None:
                settings = load_settings(found, changes=changes)
                assumed.append(
                    f'window {settings.window:g} s, lag {settings.lag:g} s, noise estimated from '
                    'the markers; to change: --set window:=0.2 --set lag:=0.1'
                )
        yield Prepared(bag, settings, assumed)


def _is_bag(file: str) -> bool:
    if not Path(file).is_file() or Path(file).suffix.lower() in _BAGS:
        return True
    try:
        topics(file)
    except BagError:
        return False
    return True


def _about_import(done: Imported) -> str:
    notes = ''.join(f'; {note}' for note in done.notes)
    return (
        f'file: {done.frames} frames of {len(done.markers)} markers ({done.format}, 1 unit = '
        f'{done.scale:g} m){notes}; to change: --scale, --rate, --y-down'
    )


def _discovered(
    file: str,
    bag: str,
    topic: str | None,
    rig: Path,
    progress: Callable[[float], None] | None,
) -> tuple[Path | None, list[str]]:
    """The parameter file that discover writes, None where it finds nothing, and lines on it."""
    from kinpole_ros.tools.discover import discover_rig

    try:
        lines = discover_rig(bag, topic, output=rig, progress=progress)
    except BagError as error:
        return None, [f'bodies: not found: {str(error).removeprefix(f"{bag}: ")}']
    said = dict(line.split(':', 1) for line in lines[:4])
    bodies = load_settings(rig).bodies
    names = [f'{name} of {len(markers)} markers' for name, markers in bodies.items()]
    more = f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''
    command = f'kinpole discover {shlex.quote(file if file == bag else "BAG")} --output rig.yaml'
    first = '' if file == bag else 'kinpole import FILE --output BAG, then '
    return rig, [
        f'plane: {said["plane"].strip()}; to change: --set plane:=xy',
        f'unit: {said["unit"].strip()}; names: {said["names"].strip()}; to change: --set scale:=1',
        f'bodies: {", ".join(names[:_NAMED])}{more}, found from the motion; to change: {first}'
        f'{command}, edit it, and give --config rig.yaml',
    ]
