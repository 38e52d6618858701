"""`kinpole solve` and `kinpole tolerance`: a scene as text, tables, pictures and a page."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import (
    Scene,
    SceneError,
    centrodes,
    load_scene,
    scene_text,
    write_pitch_curves,
)
from kinpole_ros.tools.solve._solution import (
    Solution,
    at_rate,
    at_value,
    open_output,
    over_duration,
    over_full_motion,
    over_range,
    over_time,
    unit_note,
)
from kinpole_ros.tools.solve._spreadsheet import write_table
from kinpole_ros.tools.solve._statics import static_lines, work_lines
from kinpole_ros.tools.solve._text import (
    center_lines,
    head_lines,
    motion_lines,
    range_lines,
    time_lines,
)
from kinpole_ros.tools.solve._tolerance import tolerances

__all__ = ['SolveOptions', 'solve_scene', 'tolerances']

# Positions over a range, in tables and pictures.
_SAMPLES = 361


class SolveOptions(NamedTuple):
    """
    What `solve_scene` computes and writes; the names are those of the options of `kinpole solve`.

    Attributes
    ----------
    at : str or None
        The value of the one driver, with a unit or in rad or m.
    sweep : bool
        Solve the whole range of the driver.
    time : str or None
        Solve the motion of all drivers from 0 to this time, with a unit or in s. Without `at`,
        `sweep` and `time`, the position at time 0 is solution.
    centers, statics, work : bool
        Print instant centers, forces, and the statics step by step.
    csv, plot, html, polygon : path or None
        The table, picture, page, and drawing of the velocity and acceleration polygons to write.
    centrodes : sequence of str
        Bodies whose centrodes the picture shows.
    decompose : sequence of str
        'BODY:A,B' and the file of the drawing of Poisson's decomposition.
    pitch : sequence of str
        Two bodies and the .csv, .svg or .dxf file for their centrodes as pitch curves.
    """

    at: str | None = None
    sweep: bool = False
    time: str | None = None
    centers: bool = False
    statics: bool = False
    work: bool = False
    csv: str | Path | None = None
    plot: str | Path | None = None
    centrodes: Sequence[str] = ()
    polygon: str | Path | None = None
    decompose: Sequence[str | Path] = ()
    html: str | Path | None = None
    pitch: Sequence[str | Path] = ()


def solve_scene(scene: str | Path, options: SolveOptions | None = None) -> list[str]:
    """
    Analyze a scene, and write the files that the options name.

    Parameters
    ----------
    scene : str or path
        The file, the name of a scene that comes with kinpole, or the text of a scene.
    options : SolveOptions, optional
        What to compute and write. The polygons, the decomposition and the statics step by step are
        those of the position `at`, or at the end of `time`.

    Returns
    -------
    list of str
        Lines to print.

    Raises
    ------
    SceneError
        If the scene or an option cannot be used, or a file cannot be written.
    LinkageError
        If the linkage does not reach the position.
    """
    options = options or SolveOptions()
    decompose_file = options.decompose[1] if options.decompose else None
    drawings = options.plot, options.polygon, decompose_file
    formats = {path: _picture_format(Path(path)) for path in drawings if path}
    loaded = load_scene(scene)
    for body in options.centrodes:
        if body not in loaded.mechanism.bodies:
            names = ', '.join(loaded.mechanism.bodies)
            raise SceneError(f'--centrodes: there is no moving body {body}: give some of {names}')
    single = over_time(loaded, np.zeros(1)) if options.at is None else at_value(loaded, options.at)
    solution = single
    if options.time is not None:
        solution = over_duration(loaded, options.time, _SAMPLES)
    elif options.sweep:
        solution = over_range(loaded, _SAMPLES)
    here = single if options.time is None else solution.at(-1)
    lines = _text(options, solution, single, here)

    def write(path: str | Path, write_file: Callable[[Path], None]) -> None:
        with open_output(path) as part:
            write_file(part)
        lines.append(f'written to {path}')

    curves = None
    if options.pitch:  # before any file is written, since there may be no such bodies
        one, other, pitch_file = map(str, options.pitch)
        inputs = _full_motion(solution).inputs[0]
        curves = centrodes(loaded.mechanism, one, other, float(inputs.min()), float(inputs.max()))
    if options.csv:
        write(
            options.csv, lambda part: write_table(part, solution, options.centers, options.statics)
        )
    if curves is not None:
        write_pitch_curves(pitch_file, curves)
        lines.append(
            f'the curves of {one} and {other} roll on each other, arc lengths equal to '
            f'{curves.slip:.1e}; written to {pitch_file}'
        )
    if options.html:
        from kinpole_ros.tools.solve._page import write_page

        text, motion = scene_text(scene), _full_motion(solution)
        write(options.html, lambda part: write_page(part, motion, here, text=text))
    if options.plot:
        from kinpole_ros.tools.solve._picture import draw_solution

        motion, kind, position = _full_motion(solution), formats[options.plot], single
        if motion.times is None:
            position = at_rate(loaded, single.inputs[0], float(motion.rates[0, 0]))
        centers, bodies = options.centers, options.centrodes
        write(
            options.plot, lambda part: draw_solution(part, kind, motion, position, centers, bodies)
        )
    if options.polygon:
        from kinpole_ros.tools.solve._polygons import draw_polygons, polygon_lines

        polygon_format = formats[options.polygon]
        lines += polygon_lines(here)
        write(options.polygon, lambda part: draw_polygons(part, polygon_format, here))
    if decompose_file:
        from kinpole_ros.tools.solve import _decomposition

        motion = _full_motion(solution)
        start = _former_position(loaded, here, motion)
        parts = _decomposition.decompose(str(options.decompose[0]), start, here, motion)
        lines += _decomposition.decomposition_lines(parts)
        kind = formats[decompose_file]
        write(decompose_file, lambda part: _decomposition.draw_decomposition(part, kind, parts))
    return lines


def _text(options: SolveOptions, solution: Solution, single: Solution, here: Solution) -> list[str]:
    """Return the analysis as lines to print."""
    scene = solution.scene
    lines = head_lines(scene)
    if options.at is not None and (note := unit_note(scene, options.at)):
        lines.append(note)
    if options.time is not None:
        lines += time_lines(solution)
    elif options.sweep:
        lines += range_lines(solution)
    else:
        lines += motion_lines(single)
    if options.centers:
        lines += center_lines(solution)
    if options.statics:
        lines += static_lines(solution)
    if options.work:
        lines += work_lines(here if options.time is not None else solution)
    return lines


def _full_motion(solution: Solution) -> Solution:
    """Return the positions that were solution; for a single position, the whole motion."""
    return solution if solution.inputs.shape[1] > 1 else over_full_motion(solution.scene, _SAMPLES)


def _former_position(scene: Scene, here: Solution, motion: Solution) -> Solution:
    """Return the position at time 0; if that is `here`, one an eighth of the range away."""
    start = over_time(scene, np.zeros(1))
    if np.abs(start.values - here.values).max() > 1e-9:
        return start
    distance = np.abs(motion.inputs[0] - here.inputs[0, 0])
    return motion.at(int(np.abs(distance - np.ptp(motion.inputs[0]) / 8).argmin()))


def _picture_format(path: Path) -> str:
    """Return the format that the ending of a picture names."""
    kind = path.suffix.lower().lstrip('.')
    if kind == 'svg':  # some drawings are written as SVG without matplotlib
        return kind
    from matplotlib.backend_bases import FigureCanvasBase

    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    if kind not in formats:
        raise SceneError(f'{path} is no picture; end its name in one of {", ".join(formats)}')
    return kind
