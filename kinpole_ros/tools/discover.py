"""`kinpole discover`: the bodies and joints of an unknown rig, from its markers alone."""

from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, in_place_of, read_frames
from kinpole_ros.files import printable
from kinpole_ros.linkage import (
    Checked,
    Linkage,
    UndiscoveredError,
    discover,
    draft,
    parameter_file,
    table,
)
from kinpole_ros.settings import canonical_name
from kinpole_ros.tracking.plane import NORMALS

# Seconds of data that are used by default.
_SECONDS_OF_BAG, _SECONDS_LIVE = 60.0, 20.0
# Shares of the time that reading and the search take.
_READING, _SEARCH = 0.2, 0.7

Progress = Callable[[float], None] | None


class Found(NamedTuple):
    """A linkage, the topic of its markers, and whether that is live."""

    linkage: Linkage
    topic: str
    is_live: bool


def find_linkage(
    source: str,
    topic: str | None = None,
    seconds: float | None = None,
    plane: str = 'auto',
    progress: Progress = None,
    on_truncated: Callable[[BagError], None] | None = None,
) -> Found:
    """
    Find the bodies and joints of a bag of markers, or of a topic that is being published.

    `topic`, `seconds` and `plane` are those of `kinpole discover`. `progress` is called with the
    fraction done, `on_truncated` with what is missing from a truncated bag. Raises BagError if the
    markers cannot be read, or nothing is found.
    """
    if seconds is not None and not 0 < seconds < float('inf'):
        raise BagError(f'--seconds is {seconds}; it must be more than 0')
    normal = _normal(plane)
    reading = progress and (lambda share: progress(_READING * share))
    search = progress and (lambda share: progress(_READING + _SEARCH * share))
    is_live = not (Path(source).exists() or source.endswith('.mcap') or topic is not None)
    if is_live:
        from kinpole_ros.ros.listener import listen

        frames, name = listen(source, seconds or _SECONDS_LIVE, reading)
    else:
        duration = seconds or _SECONDS_OF_BAG
        frames, name = read_frames(source, topic, duration, reading, on_truncated)
    try:
        return Found(discover(frames, search, normal), name, is_live)
    except UndiscoveredError as error:
        raise BagError(f'{source}: {error}') from None


def discover_rig(
    options: Namespace,
    progress: Progress = None,
    on_truncated: Callable[[BagError], None] | None = None,
) -> list[str]:
    """
    Find the bodies and joints of a rig; return lines to print, and write the files of the options.

    `options` are those of `kinpole discover`. Calls and errors are those of `find_linkage`; a file
    that cannot be written is a BagError.
    """
    source = options.source
    if options.plot is not None:
        from kinpole_ros.tools.plot import picture_format

        picture_format(options.plot)
    linkage, name, is_live = find_linkage(
        source, options.topic, options.seconds, options.plane, progress, on_truncated
    )
    about = f'Found by kinpole discover {printable(source)}'
    drawn = draft(linkage, f'{about}: a draft, to be checked and named.')
    if progress is not None:
        progress(1.0)
    lines = table(linkage, drawn[1] if drawn else None)
    if options.output is not None:
        _write(options.output, parameter_file(linkage, name, f'{about}.'))
        lines.append(f'parameters written to {options.output}')
    if options.scene is not None:
        if drawn is None or not drawn[1].explains:
            raise BagError(f'{options.scene} is not written: {_why_no_scene(linkage, drawn)}')
        _write(options.scene, drawn[0])
        lines.append(f'draft scene written to {options.scene}')
    if options.plot is not None:
        from kinpole_ros.tools.plot import draw_linkage

        title = name if is_live else Path(source).name
        draw_linkage(linkage, options.plot, printable(title))
        lines.append(f'drawn to {options.plot}')
    return lines


def _normal(plane: str) -> np.ndarray | None:
    """Return the normal (3,) of a plane, None for that of the motion."""
    if plane == 'auto':
        return None
    name = canonical_name(plane)
    with suppress(ValueError):
        normal = np.array(NORMALS.get(name) or [float(x) for x in name.strip('[]').split(',')])
        if normal.shape == (3,) and np.isfinite(normal).all() and normal.any():
            return normal
    raise BagError(f'--plane is {plane!r}; it must be auto, xy, yz, zx or a normal nx,ny,nz')


def _why_no_scene(linkage: Linkage, drawn: tuple[str, Checked] | None) -> str:
    if linkage.space is not None:
        return (
            'the bodies do not move in one plane, as those of a scene; fix: guide the motion, or '
            'use the parameter file alone, for results of the projection'
        )
    if drawn is None:
        return (
            'no joint connects a body with the ground; fix: record more of the motion, or put '
            'markers on the bodies between'
        )
    checked = drawn[1]
    why = checked.problem or (
        f'its markers differ by {checked.first * 1e3:.2g} mm rms from those measured at the first '
        f'frame, with a noise of {checked.noise * 1e3:.2g} mm'
    )
    return (
        f'the draft does not explain the markers: {why}; fix: see the column "left over" in the '
        'table, and record more of the motion'
    )


def _write(path: str | Path, text: str) -> None:
    with in_place_of(path) as part:
        part.write_text(text, encoding='utf-8')
