"""
`kinpole solve`: the classical analysis of a scene, as tables, a spreadsheet or a picture.

Everything is computed by `mechanism`; here it is only asked for and laid out.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinpole_ros.mechanism import (
    Scene,
    SceneError,
    centrodes,
    load_scene,
    scene_text,
    write_pitch_curves,
)
from kinpole_ros.tools.solve._lines import (
    center_lines,
    course_lines,
    head_lines,
    motion_lines,
    range_lines,
    static_lines,
)
from kinpole_ros.tools.solve._solved import (
    Solved,
    at_value,
    course,
    drawn,
    everywhere,
    over_range,
    over_time,
    unit_note,
    writing,
)
from kinpole_ros.tools.solve._spreadsheet import write_table
from kinpole_ros.tools.solve._tolerance import tolerances
from kinpole_ros.tools.solve._work import work_lines

__all__ = ['solve_scene', 'tolerances']

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
    time: str | None = None,
    page: str | Path | None = None,
    curves: Sequence[str] = (),
    *,
    polygons: str | Path | None = None,
    decomposed: Sequence[str] = (),
    work: bool = False,
) -> list[str]:
    """
    The analysis as lines to print; also writes the CSV `table`, the `picture`, the `pitch` curves,
    the HTML `page` and drawings.

    `at` is a value of the one driver, with a unit or in SI; `sweep` takes all the way the linkage
    gives it; `time` all drivers as they move, from 0 to so long, with a unit or in s; none of them,
    the position at time 0. `pitch` is two bodies and a file (.csv, .svg or .dxf), `curves` are
    bodies whose centrodes the picture has. `polygons`, the decomposition of BODY:A,B into a file
    (`decomposed`) and `work`, the statics step by step, are those of the position `at`, or at the
    end of `time`. Raises SceneError and LinkageError for what the scene cannot do, SceneError for
    files too.
    """
    drawings = (picture, polygons, decomposed[1] if decomposed else None)
    kind, polygon_kind, decomposed_kind = (_kind_of(Path(p)) if p else '' for p in drawings)
    loaded = load_scene(scene)
    for body in curves:
        if body not in loaded.mechanism.bodies:
            names = ', '.join(loaded.mechanism.bodies)
            raise SceneError(f'--centrodes: there is no moving body {body}: give some of {names}')
    here = over_time(loaded, np.zeros(1)) if at is None else at_value(loaded, at)
    asked = here
    if time is not None:
        asked = course(loaded, time, _SAMPLES)
    elif sweep:
        asked = over_range(loaded, _SAMPLES)
    there = here if time is None else asked.at(-1)
    lines = head_lines(loaded)
    if at is not None and (note := unit_note(loaded, at)):
        lines.append(note)
    if time is not None:
        lines += course_lines(asked)
    elif sweep:
        lines += range_lines(asked)
    else:
        lines += motion_lines(here)
    if centers:
        lines += center_lines(asked)
    if statics:
        lines += static_lines(asked)
    if work:
        lines += work_lines(there if time is not None else asked)
    rolled = None
    if pitch:  # before anything is written, since there may be no such bodies
        one, other, file = pitch
        way = _whole(asked).inputs[0]
        rolled = centrodes(loaded.mechanism, one, other, float(way.min()), float(way.max()))
    if table:
        with writing(table) as part:
            write_table(part, asked, centers, statics)
        lines.append(f'written to {table}')
    if rolled is not None:
        write_pitch_curves(file, rolled)
        lines.append(
            f'the curves of {one} and {other} roll on each other, arc lengths equal to '
            f'{rolled.slip:.1e}; written to {file}'
        )
    if page:
        from kinpole_ros.tools.solve._page import write_page

        with writing(page) as part:
            write_page(part, _whole(asked), there, text=scene_text(scene))
        lines.append(f'written to {page}')
    if picture:
        from kinpole_ros.tools.solve._picture import draw

        whole = _whole(asked)
        with writing(picture) as part:
            draw(part, kind, whole, drawn(whole, here), centers, curves)
        lines.append(f'written to {picture}')
    if polygons:
        from kinpole_ros.tools.solve._polygons import draw_polygons, polygon_lines

        lines += polygon_lines(there)
        with writing(polygons) as part:
            draw_polygons(part, polygon_kind, there)
        lines.append(f'written to {polygons}')
    if decomposed:
        from kinpole_ros.tools.solve._decompose import (
            decompose,
            decomposition_lines,
            draw_decomposition,
        )

        body, file = decomposed
        whole = _whole(asked)
        found = decompose(body, _former(loaded, there, whole), there, whole)
        lines += decomposition_lines(found)
        with writing(file) as part:
            draw_decomposition(part, decomposed_kind, found)
        lines.append(f'written to {file}')
    return lines


def _whole(asked: Solved) -> Solved:
    """What was asked for, or of a single position all the way that the drivers go."""
    if asked.inputs.shape[1] > 1:
        return asked
    return everywhere(asked.scene, _SAMPLES)


def _former(scene: Scene, there: Solved, whole: Solved) -> Solved:
    """The position at time 0, or where that is `there` one an eighth of the range from it."""
    start = over_time(scene, np.zeros(1))
    if np.abs(start.values - there.values).max() > 1e-9:
        return start
    away = np.abs(whole.inputs[0] - there.inputs[0, 0])
    return whole.at(int(np.abs(away - np.ptp(whole.inputs[0]) / 8).argmin()))


def _kind_of(path: Path) -> str:
    """The kind of picture, by its suffix; raises SceneError for what matplotlib does not draw."""
    if path.suffix.lower() == '.svg':
        return 'svg'
    from matplotlib.backend_bases import FigureCanvasBase

    known = sorted(FigureCanvasBase.get_supported_filetypes())
    kind = path.suffix.lower().lstrip('.')
    if kind not in known:
        raise SceneError(f'{path} is no picture; end its name in one of {", ".join(known)}')
    return kind
