"""
`kinpole solve`: the classical analysis of a scene, as tables, a spreadsheet or a picture.

Everything is computed by `mechanism`; here it is only asked for and laid out.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kinpole_ros import files
from kinpole_ros.mechanism import SceneError, centrodes, load_scene, write_pitch_curves
from kinpole_ros.tools.solve._lines import (
    center_lines,
    head_lines,
    motion_lines,
    range_lines,
    static_lines,
    sweep_lines,
)
from kinpole_ros.tools.solve._solved import drawn, solve_positions
from kinpole_ros.tools.solve._spreadsheet import write_table

__all__ = ['solve_scene']

# Positions over a range in the spreadsheet and the picture.
_SAMPLES = 361


def solve_scene(
    scene: str | Path,
    at: str | None = None,
    sweep: bool = False,
    centers: bool = False,
    statics: bool = False,
    table: str | Path | None = None,
    picture: str | Path | None = None,
    pitch: Sequence[str] | None = None,
) -> list[str]:
    """
    The analysis as lines to print; also writes the CSV `table`, the `picture`, the `pitch` curves.

    `at` is a value of the one driver, with a unit or in SI; `sweep` takes its whole range; neither,
    the position at time 0. `pitch` is two bodies and a file (.csv or .svg). Raises SceneError and
    LinkageError for what the scene cannot do, SceneError for files too.
    """
    loaded = load_scene(scene)
    here = solve_positions(loaded, at, None)
    whole = here
    if sweep or picture or pitch:
        whole = solve_positions(loaded, None, _SAMPLES)
    lines = head_lines(loaded)
    if sweep:
        lines += range_lines(whole) + sweep_lines(whole)
    else:
        lines += motion_lines(here)
    if centers:
        lines += center_lines(whole if sweep else here)
    if statics:
        lines += static_lines(whole if sweep else here)
    if table:
        with _writing(table) as part:
            write_table(part, whole if sweep else here, centers, statics)
        lines.append(f'written to {table}')
    if pitch:
        one, other, file = pitch
        low, high = float(whole.inputs[0, 0]), float(whole.inputs[0, -1])
        curves = centrodes(loaded.mechanism, one, other, low, high)
        write_pitch_curves(file, curves)
        lines.append(
            f'the curves of {one} and {other} roll on each other, arc lengths equal to '
            f'{curves.slip:.1e}; written to {file}'
        )
    if picture:
        from kinpole_ros.tools.solve._picture import draw

        kind = _kind_of(Path(picture))
        with _writing(picture) as part:
            draw(part, kind, whole, drawn(whole, here), centers)
        lines.append(f'written to {picture}')
    return lines


@contextmanager
def _writing(path: str | Path) -> Iterator[Path]:
    """A place to write it to until it is whole; says which file it was that could not be."""
    try:
        with files.whole(path) as part:
            yield part
    except OSError as error:
        raise SceneError(
            f'{path} cannot be written: {error.strerror}; '
            'fix: check the path, its rights and the space on the disk'
        ) from None


def _kind_of(path: Path) -> str:
    """The kind of picture, by its suffix; raises SceneError for what matplotlib does not draw."""
    from matplotlib.backend_bases import FigureCanvasBase

    known = sorted(FigureCanvasBase.get_supported_filetypes())
    kind = path.suffix.lower().lstrip('.')
    if kind not in known:
        raise SceneError(f'{path} is no picture; end its name in one of {", ".join(known)}')
    return kind
