"""`kinpole solve` and `kinpole tolerance`: a scene as text, tables, pictures and a page."""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from kinpole_ros.mechanism import LinkageError, SceneError, centrodes, load_scene, scene_text
from kinpole_ros.tools.solve import _solution, _text
from kinpole_ros.tools.solve._animation import animation_kind, write_animation
from kinpole_ros.tools.solve._panels import Panel, write_drawing
from kinpole_ros.tools.solve._pitch import write_pitch_curves
from kinpole_ros.tools.solve._shapes import SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene
from kinpole_ros.tools.solve._spreadsheet import write_table
from kinpole_ros.tools.solve._statics import static_lines, work_lines
from kinpole_ros.tools.solve._tolerance import tolerances

__all__ = ['solve_scene', 'tolerances']

# Positions over a range, in tables and pictures.
_SAMPLES = 361


def solve_scene(options: Namespace) -> list[str]:
    """
    Analyze a scene: return lines to print, and write the files that the options name.

    `options` are those of `kinpole solve`; the scene may be a text too. Raises SceneError if it, an
    option or a file cannot be used, BagError for a picture that cannot be written, and LinkageError
    if the linkage does not reach the position.
    """
    # Drawings are written as SVG without matplotlib.
    files = options.polygon, options.curvature, *options.decompose[1:]
    drawings = [path for path in files if path]
    for path in (options.plot, *(path for path in drawings if _ending(path) != 'svg')):
        if path:
            from kinpole_ros.tools.plot import picture_format  # which needs mcap

            picture_format(path)
    if options.animate:
        animation_kind(options.animate)
    loaded = load_scene(options.scene)
    for name in ('centrodes', 'inflection'):
        for body in getattr(options, name):
            if body not in loaded.mechanism.bodies:
                names = ', '.join(loaded.mechanism.bodies)
                raise SceneError(f'--{name}: there is no moving body {body}; give some of {names}')
    single = (
        _solution.over_time(loaded, np.zeros(1))
        if options.at is None
        else _solution.at_value(loaded, options.at)
    )
    solution = single
    if options.time is not None:
        solution = _solution.over_duration(loaded, options.time, _SAMPLES)
    elif options.sweep:
        solution = _solution.over_range(loaded, _SAMPLES)
    here = single if options.time is None else solution.at(-1)
    analysis = _Analysis(options, solution, single, here, scene_text(options.scene))
    return [*analysis.text(), *analysis.write_tables(), *analysis.write_pictures()]


@dataclass
class _Analysis:
    """A scene, solved; `single` is the one position asked for, `here` that of the drawings."""

    options: Namespace
    solution: SolvedScene
    single: SolvedScene
    here: SolvedScene
    scene_text: str

    @cached_property
    def motion(self) -> SolvedScene:
        """The positions that were asked for; for a single one, the whole motion."""
        if self.solution.inputs.shape[1] > 1:
            return self.solution
        return _solution.over_full_motion(self.solution.scene, _SAMPLES)

    @cached_property
    def drawn(self) -> SceneLines:
        """The lines of the scene; without a range they are those of the one position."""
        try:
            return SceneLines(self.motion)
        except (SceneError, LinkageError):
            return SceneLines(self.here)

    def text(self) -> Iterator[str]:
        """Yield the analysis as lines to print."""
        options, solution = self.options, self.solution
        yield from _text.head_lines(solution.scene)
        if options.at is not None and (note := _solution.unit_note(solution.scene, options.at)):
            yield note
        if options.time is not None:
            yield from _text.time_lines(solution)
        elif options.sweep:
            yield from _text.range_lines(solution)
        else:
            yield from _text.motion_lines(self.single)
        if options.centers:
            yield from _text.center_lines(solution)
        if options.statics:
            yield from static_lines(solution)
        if options.work:
            yield from work_lines(self.here if options.time is not None else solution)

    def write_tables(self) -> Iterator[str]:
        """Write the table, the pitch curves and the page; yield a line for each."""
        options = self.options
        if options.pitch:  # before any file is written, since there may be no such bodies
            first, second, pitch_file = options.pitch
            inputs = self.motion.inputs[0]
            ends = float(inputs.min()), float(inputs.max())
            curves = centrodes(self.solution.scene.mechanism, first, second, *ends)
        if options.csv:
            with _solution.open_output(options.csv) as part:
                write_table(part, self.solution, options.centers, options.statics)
            yield f'written to {options.csv}'
        if options.pitch:
            write_pitch_curves(pitch_file, curves)
            yield (
                f'the curves of {first} and {second} roll on each other, arc lengths equal to '
                f'{curves.slip:.1e}; written to {pitch_file}'
            )
        if options.html:
            from kinpole_ros.tools.solve._scene_page import write_page

            with _solution.open_output(options.html) as part:
                write_page(part, self.motion, self.here, text=self.scene_text)
            yield f'written to {options.html}'

    def write_pictures(self) -> Iterator[str]:
        """Write the picture and the drawings; yield a line for each, and those of the drawings."""
        options = self.options
        if options.plot:
            from kinpole_ros.tools.solve._scene_picture import draw_solution

            position = self.single
            if self.motion.times is None:
                rate = float(self.motion.rates[0, 0])
                position = _solution.at_rate(position.scene, position.inputs[0], rate)
            extras = options.centers, options.centrodes, options.inflection
            draw_solution(options.plot, self.motion, position, *extras)
            yield f'written to {options.plot}'
        if options.animate:
            kind = animation_kind(options.animate)
            with _solution.open_output(options.animate) as part:
                about = write_animation(part, kind, self.motion)
            yield f'written to {options.animate}: {about}'
        if options.export:
            yield from self._export(options.export)
        if options.polygon:
            from kinpole_ros.tools.solve._polygons import polygon_lines, polygon_panels

            yield from polygon_lines(self.here)
            title = 'velocity and acceleration polygons'
            yield self._draw(options.polygon, title, polygon_panels(self.here, self.drawn))
        if options.curvature:
            from kinpole_ros.tools.solve import _curvature_drawing

            bodies = _curvature_drawing.curved_bodies(self.here)
            yield from _curvature_drawing.curvature_lines(bodies)
            panels = _curvature_drawing.curvature_panels(self.here, self.drawn, bodies)
            yield self._draw(options.curvature, 'curvature of paths', panels)
        if options.decompose:
            from kinpole_ros.tools.solve import _decomposition

            text, file = options.decompose
            start = self._former_position()
            body = _decomposition.decompose(text, start, self.here, self.motion)
            yield from _decomposition.decomposition_lines(body)
            title = f'motion of {body.name} as translation and rotation'
            yield self._draw(file, title, _decomposition.decomposition_panels(body))

    def _export(self, file: str) -> Iterator[str]:
        """Write the linkage for another program; yield lines about it."""
        kind, left_out = _ending(file), list[str]()
        with _solution.open_output(file) as part:
            if kind == 'dxf':
                from kinpole_ros.tools.solve._dxf import write_linkage

                write_linkage(part, self.motion, self.here)
            else:
                from kinpole_ros.tools.solve._robot_models import write_model

                left_out = write_model(part, kind, self.motion, self.here)
        yield f'written to {file}'
        yield from left_out

    def _draw(self, file: str, title: str, panels: list[Panel]) -> str:
        """Write panels as one drawing; return a line."""
        with _solution.open_output(file) as part:
            write_drawing(part, _ending(file), f'{self.here.scene.name}: {title}', panels)
        return f'written to {file}'

    def _former_position(self) -> SolvedScene:
        """Return the position at time 0; if that is `here`, one an eighth of the range away."""
        start = _solution.over_time(self.here.scene, np.zeros(1))
        if np.abs(start.values - self.here.values).max() > 1e-9:
            return start
        inputs = self.motion.inputs[0]
        distance = np.abs(inputs - self.here.inputs[0, 0])
        return self.motion.at(int(np.abs(distance - np.ptp(inputs) / 8).argmin()))


def _ending(path: str | Path) -> str:
    return Path(path).suffix.lower().lstrip('.')
