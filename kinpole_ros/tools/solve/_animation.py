"""A scene in motion, for `kinpole solve --animate`: a GIF, a film, or an SVG that moves."""

import shutil
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism import GROUND, SceneError
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._panels import Panel, svg_of, svg_points
from kinpole_ros.tools.solve._shapes import BODY_COLORS, INK, DrawnLine, SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene

_SIZE = complex(640, 560)  # px
# Frames a second and frames of films, at most; frames of an SVG, which a browser interpolates.
_RATE, _MOST_FRAMES, _SVG_FRAMES = 25, 120, 121
# A motion is shown at its own pace if it lasts this long, s, else in the nearer of both.
_SHORTEST, _LONGEST = 2.0, 12.0
_WIDTHS = {'guide': 3.0, 'span': 1.4, 'contour': 1.5, 'wheel': 1.5, 'link': 3.0}
ANIMATIONS = ('gif', 'mp4', 'svg')


class _Film(NamedTuple):
    """Frames (T,) that follow each other over a `duration`, s, and the lines of the scene."""

    frames: SolvedScene
    duration: float
    drawn: SceneLines
    panel: Panel


def animation_kind(file: str) -> str:
    """Return the format that the ending names; raise SceneError where it cannot be written."""
    kind = Path(file).suffix.lower().lstrip('.')
    if kind not in ANIMATIONS:
        raise SceneError(f'{file} is no animation; end its name in .{", .".join(ANIMATIONS)}')
    if kind == 'mp4' and not shutil.which('ffmpeg'):
        raise SceneError(f'{file}: films need the program ffmpeg; install it, or write a .gif')
    if kind != 'svg':
        from kinpole_ros.tools.plot import picture_format

        picture_format(f'{file}.png')  # raises where there is no matplotlib
    return kind


def write_animation(path: Path, kind: str, motion: SolvedScene) -> str:
    """Write the motion, over and over; return a line about it."""
    times = motion.inputs[0] / motion.rates[0, 0] if motion.times is None else motion.times
    own, ways = float(np.ptp(times)), 2 if motion.limits != (None, None) else 1
    duration = float(np.clip(own, _SHORTEST, _LONGEST))
    count = _SVG_FRAMES
    if kind != 'svg':
        count = min(round(duration * _RATE), _MOST_FRAMES // ways) + 1
    frames = _frames(motion, count)
    if ways > 1:  # back from the limit
        frames = frames.at([*range(count), *range(count - 2, 0, -1)])
    film = _Film(frames, ways * duration, SceneLines(motion), _panel(motion))
    if kind == 'svg':
        path.write_text(_svg(film), encoding='utf-8')
    else:
        _save_film(path, kind, film)
    pace = 'at its own pace' if own == duration else f'for {ways * own:.4g} s of motion'
    return f'{frames.inputs.shape[1]} frames in {film.duration:.4g} s, {pace}'


def _frames(motion: SolvedScene, count: int) -> SolvedScene:
    """Return the motion at evenly spaced positions, in the order of time."""
    if motion.times is not None:
        return _solution.over_time(motion.scene, np.linspace(*motion.times[[0, -1]], count))
    rate = float(motion.rates[0, 0])
    ends = motion.inputs[0, [0, -1]][:: 1 if rate > 0 else -1]
    return _solution.at_rate(motion.scene, np.linspace(*ends, count), rate)


def _panel(motion: SolvedScene) -> Panel:
    """Return a panel with what stands still: paths of points, the ground, and a scale."""
    panel = Panel(motion.scene.name, 'm', 0j, _SIZE)
    drawn = SceneLines(motion)
    count = motion.inputs.shape[1]
    lines = [line.points for k in range(0, count, 4) for line in drawn.at(motion.at(k))]
    bodies = motion.scene.mechanism.bodies
    ground = {n: z for n, (body, z) in motion.scene.points.items() if body not in bodies}
    panel.fit(np.concatenate([*lines, [*ground.values()]]))
    for path in _solution.point_motions(motion).values():
        panel.line(path[0], 'shape')
    for name, z in ground.items():
        panel.point(z, name.rpartition('.')[2])
    panel.scale_bar()
    panel.place_labels()
    return panel


def _save_film(path: Path, kind: str, film: _Film) -> None:
    """Write a GIF or a film by matplotlib."""
    from matplotlib.animation import FFMpegWriter, PillowWriter
    from matplotlib.figure import Figure

    from kinpole_ros.tools.solve._panels import draw_panels

    figure = Figure(figsize=(_SIZE.real / 100, _SIZE.imag / 100))
    axis = draw_panels(figure, _SIZE, [film.panel])
    bodies, count = film.frames.scene.mechanism.bodies, film.frames.inputs.shape[1]
    # A GIF counts in hundredths of a second.
    rate = 100 / round(100 * film.duration / count)
    writer = (PillowWriter if kind == 'gif' else FFMpegWriter)(fps=rate)
    # Both go by the ending of a file.
    named = path.with_name(f'{path.name}.{kind}')
    artists: list[Any] = []
    try:
        with writer.saving(figure, str(named), 100):
            for k in range(count):
                lines = film.drawn.at(film.frames.at(k))
                artists = artists or [
                    axis.plot([], [], color=_color(line, bodies), linewidth=_WIDTHS[line.kind])[0]
                    for line in lines
                ]
                for artist, line in zip(artists, lines, strict=True):
                    at = film.panel.pixels(line.points)
                    artist.set_data(at.real, at.imag)
                writer.grab_frame()
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)


def _color(line: DrawnLine, bodies: tuple[str, ...]) -> str:
    if line.kind == 'guide':
        return '#c8ced4'
    return BODY_COLORS[bodies.index(line.body) % len(BODY_COLORS)] if line.body in bodies else INK


def _svg(film: _Film) -> str:
    """Return an SVG in which bodies are moved by SMIL: it needs no script, and runs in an <img>."""
    rows = [
        *(row for body in film.frames.scene.mechanism.bodies for row in _moving_body(film, body)),
        *_still_and_changing_lines(film),
    ]
    still = svg_of(film.panel.title, _SIZE, [film.panel])
    return still.replace('</svg>', '\n'.join([*rows, '</svg>']))


def _moving_body(film: _Film, body: str) -> Iterator[str]:
    """Yield a group of the lines and points of a body, which is shifted and turned."""
    scene, motion, panel = film.frames.scene, film.frames.motion, film.panel
    b = scene.mechanism.bodies.index(body)
    origin, degrees = panel.pixels(motion.position[0, b]), -np.degrees(motion.angle[0, b])
    moves = {
        'translate': [f'{z.real:.2f} {z.imag:.2f}' for z in origin],
        'rotate': [f'{angle:.3f}' for angle in degrees],
    }
    yield f'<g transform="translate({moves["translate"][0]}) rotate({moves["rotate"][0]})">'
    for kind, values in moves.items():
        yield (
            f'<animateTransform attributeName="transform" type="{kind}" additive='
            f'"{"replace" if kind == "translate" else "sum"}" dur="{film.duration:g}s" '
            f'repeatCount="indefinite" values="{";".join(values)}"/>'
        )
    color = BODY_COLORS[b % len(BODY_COLORS)]
    for line in film.drawn.on_bodies:
        if line.body == body:
            color = _color(line, scene.mechanism.bodies)
            yield _polyline(line, panel.scale * line.points.conj(), color)
    for name, (owner, z) in scene.points.items():
        if owner == body:
            at = panel.scale * z.conjugate()
            yield (
                f'<circle cx="{at.real:.2f}" cy="{at.imag:.2f}" r="3.2" fill="{color}">'
                f'<title>{escape(name)}</title></circle>'
            )
    yield '</g>'


def _still_and_changing_lines(film: _Film) -> Iterator[str]:
    """Yield the lines on the ground, and cylinders, springs, belts and vectors, point by point."""
    panel, bodies = film.panel, film.frames.scene.mechanism.bodies
    for line in film.drawn.on_bodies:
        if line.body == GROUND:
            yield _polyline(line, panel.pixels(line.points), _color(line, bodies))
    frames = [
        list(film.drawn.between_bodies(film.frames.at(k)))
        for k in range(film.frames.inputs.shape[1])
    ]
    for lines in zip(*frames, strict=True):
        points = [panel.pixels(line.points) for line in lines]
        values = ';'.join(svg_points(one, 2) for one in points)
        animate = (
            f'<animate attributeName="points" dur="{film.duration:g}s" repeatCount="indefinite" '
            f'values="{values}"/>'
        )
        yield _polyline(lines[0], points[0], _color(lines[0], bodies), animate)


def _polyline(line: DrawnLine, points: np.ndarray, color: str, inside: str = '') -> str:
    return (
        f'<polyline points="{svg_points(points, 2)}" fill="none" stroke="{color}" '
        f'stroke-width="{_WIDTHS[line.kind]}" stroke-linejoin="round">{inside}</polyline>'
    )
