"""
`kinpole discover`: a rig that nobody has described, from its markers alone.

Reads a bag or listens to a topic, has `linkage` find what there is, and writes it down.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from kinpole_ros.bags import BagError, Truncated, in_place_of, read_frames
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
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.plane import NORMALS, canonical_name

# s of data, where nobody says.
_OF_A_BAG = 60.0
_LIVE = 20.0
# Share of the time that reading takes.
_READING = 0.2


def discover_rig(
    source: str,
    topic: str | None = None,
    seconds: float | None = None,
    output: str | Path | None = None,
    scene: str | Path | None = None,
    picture: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    report: Callable[[Truncated], None] | None = None,
    plane: str = 'auto',
) -> list[str]:
    """
    What the markers of a bag or topic show, as lines to print; also writes the files named.

    `output` is the parameter file, `scene` the draft scene, `picture` what was found, drawn;
    `report` is called with what a bag lacks that is not whole. `plane` is xy, yz, zx, a normal as
    'nx,ny,nz', or auto for that of the motion. Raises BagError for what cannot be
    read, found or written, with the fix.
    """
    if seconds is not None and not 0 < seconds < float('inf'):
        raise BagError(f'--seconds is {seconds}; it must be more than 0')

    normal = _normal(plane)
    if picture is not None:
        from kinpole_ros.tools.plot import picture_format

        picture_format(picture)

    def part(first: float, share: float) -> Callable[[float], None] | None:
        return None if progress is None else (lambda done: progress(first + share * done))

    parts, name, live = _read(source, topic, seconds, part(0.0, _READING), report)
    try:
        found = discover(parts, part(_READING, 0.9 - _READING), normal)
    except UndiscoveredError as error:
        raise BagError(f'{source}: {error}') from None
    about = f'Found by kinpole discover {printable(source)}'
    drawn = draft(found, f'{about}: a draft, to be checked and named.')
    if progress is not None:
        progress(1.0)
    lines = table(found, drawn[1] if drawn else None)
    if output is not None:
        _write(output, parameter_file(found, name, f'{about}.'))
        lines.append(f'parameters written to {output}')
    if scene is not None:
        if drawn is None or not drawn[1].explains:
            raise BagError(f'{scene} is not written: {_why_no_scene(found, drawn)}')
        _write(scene, drawn[0])
        lines.append(f'draft scene written to {scene}')
    if picture is not None:
        from kinpole_ros.tools.plot import draw_linkage

        draw_linkage(found, picture, printable(Path(source).name if not live else name))
        lines.append(f'drawn to {picture}')
    return lines


def _normal(plane: str) -> np.ndarray | None:
    """The normal (3,) of a plane as it is given, None for that of the motion."""
    if plane == 'auto':
        return None
    name = canonical_name(plane)
    with suppress(ValueError):
        normal = np.array(
            NORMALS.get(name) or [float(part) for part in name.strip('[]').split(',')]
        )
        if normal.shape == (3,) and np.isfinite(normal).all() and normal.any():
            return normal
    raise BagError(f'--plane is {plane!r}; it must be auto, xy, yz, zx or a normal nx,ny,nz')


def _why_no_scene(found: Linkage, drawn: tuple[str, Checked] | None) -> str:
    if found.space is not None:
        return (
            'the bodies do not move in one plane, and a scene is of one; fix: guide the motion, or '
            'go on with the parameter file: figures are then those of the projection'
        )
    if drawn is None:
        return (
            'no joint connects a body with the ground; fix: record more of the motion, or mark the '
            'bodies between'
        )
    checked = drawn[1]
    why = checked.problem or (
        f'its markers are {checked.first * 1e3:.2g} mm rms off those measured at the first frame, '
        f'of a noise of {checked.noise * 1e3:.2g} mm'
    )
    return (
        f'the draft does not explain the markers: {why}; fix: see what is left over in the table, '
        'and record more of the motion'
    )


def _read(
    source: str,
    topic: str | None,
    seconds: float | None,
    progress: Callable[[float], None] | None,
    report: Callable[[Truncated], None] | None,
) -> tuple[list[MarkerFrames], str, bool]:
    """The frames, the topic, and whether it is live."""
    if Path(source).exists() or source.endswith('.mcap') or topic is not None:
        parts, name = read_frames(source, topic, seconds or _OF_A_BAG, progress, report)
        return parts, name, False
    from kinpole_ros.ros.listener import listen

    parts, name = listen(source, seconds or _LIVE, progress)
    return parts, name, True


def _write(path: str | Path, text: str) -> None:
    with in_place_of(path) as part:
        part.write_text(text, encoding='utf-8')
