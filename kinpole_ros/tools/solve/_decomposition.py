"""
Poisson's decomposition of the motion of a body into translation and rotation, for two points.

Equation numbers are those of seed 001 in docs/course_notes.md.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros import planar
from kinpole_ros.mechanism import Poles, SceneError, poles, polygon
from kinpole_ros.tools.solve._panels import Panel, round_down
from kinpole_ros.tools.solve._shapes import body_vector
from kinpole_ros.tools.solve._solution import SolvedScene
from kinpole_ros.tools.solve._text import Row, table_lines

_WIDTH, _HEIGHT = 620.0, 480.0  # px
# The longest velocity arrow, and how far centrodes are drawn, as fractions of the body's size.
_ARROW, _CENTRODE_EXTENT = 0.4, 1.9


class DecomposedBody(NamedTuple):
    """
    A body with its points `labels`, first the two reference points, at two positions.

    `ends` (2, points) complex, m, and `angles` (2,), rad, are of the former position and of this
    one; `velocity` (points,), m/s, and `rates` (ω, α) of this one. `here` is the scene there,
    `motion` the scene over its range, with the `poles` of all bodies.
    """

    name: str
    labels: tuple[str, ...]
    ends: np.ndarray
    angles: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    here: SolvedScene
    motion: SolvedScene
    poles: Poles

    @property
    def number(self) -> int:
        """The number of the body among those of the scene."""
        return self.here.scene.mechanism.bodies.index(self.name)


def decompose(
    text: str, former: SolvedScene, here: SolvedScene, motion: SolvedScene
) -> DecomposedBody:
    """
    Return the points of a body at two positions, from 'BODY:A,B'.

    Raises SceneError for an unknown body or point, and at a dead point.
    """
    scene, bodies = here.scene, here.scene.mechanism.bodies
    body, _, chosen_text = text.partition(':')
    if body not in bodies:
        listed = ', '.join(bodies)
        raise SceneError(f'--decompose: there is no moving body {body!r}; give one of {listed}')
    points = {name.rpartition('.')[2]: z for name, (of, z) in scene.points.items() if of == body}
    if not scene.mechanism.assembly.joints:
        vector = body_vector(scene, body)
        points |= {'tail': 0j, 'head': vector} if vector else {'tail': 0j}
    chosen = [name.strip() for name in chosen_text.split(',')]
    if len({points.get(name) for name in chosen} - {None}) != 2 or len(chosen) != 2:
        raise SceneError(
            f'--decompose {text!r}: give two reference points of {body} at different positions, as '
            f'{body}:A,B; it has {", ".join(points)}'
        )
    labels = (*chosen, *(name for name in points if name not in chosen))
    arms = np.array([points[name] for name in labels])
    b = bodies.index(body)
    position = np.array([one.motion.position[0, b, 0] for one in (former, here)])
    angles = np.array([one.motion.angle[0, b, 0] for one in (former, here)])
    rates = here.motion.angle[1:3, b, 0]
    turned = arms * np.exp(1j * angles[:, None])
    velocity = here.motion.position[1, b, 0] + 1j * rates[0] * turned[1]
    if not np.isfinite(velocity).all():
        raise SceneError(
            '--decompose: in a dead point there are no velocities; give a value next to it'
        )
    return DecomposedBody(
        body,
        labels,
        position[:, None] + turned,
        angles,
        velocity,
        rates,
        here,
        motion,
        poles(scene.mechanism, motion.motion),
    )


def decomposition_lines(body: DecomposedBody) -> list[str]:
    """Return the displacements, the velocities, and the pole from the first reference point."""
    rotation = float(np.degrees(body.angles[1] - body.angles[0]))
    moves = body.ends[1] - body.ends[0]
    w, alpha = body.rates
    rows: list[Row] = [
        [name, z.real, z.imag, abs(z), rotation]
        for name, z in zip(body.labels[:2], moves, strict=False)
    ]
    lines = ['', f'{body.name} from the former position: translation with, then rotation about']
    lines += table_lines(['reference', 'x m', 'y m', 'm', 'rotation deg'], rows)
    (a, b), (v_a, v_b) = body.labels[:2], body.velocity[:2]
    lines += ['', f'at this instant, ω = {w:.6g} rad/s whatever the reference point']
    vectors = {f'v_{a}': v_a, f'v_{b}/{a}': v_b - v_a, f'v_{b}': v_b, f'v_{a}/{b}': v_a - v_b}
    rows = [[name, abs(z), np.degrees(np.angle(z)), z.real, z.imag] for name, z in vectors.items()]
    lines += table_lines(['vector', 'm/s', 'deg', 'x m/s', 'y m/s'], rows)
    if not w:
        return [*lines, 'it does not turn: the pole is at infinity']
    # The acceleration of A from that of the origin: eq. 4.
    origin = body.here.motion.position[:3, body.number, 0]
    arm = planar.to_plane(body.ends[1, 0] - origin[0])
    r, v, origin_acceleration = (planar.to_plane(z) for z in (body.ends[1, 0], v_a, origin[2]))
    acceleration = origin_acceleration + planar.relative_acceleration(w, alpha, arm)
    fixed, moving = planar.centrode_velocities(v, acceleration, w, alpha)
    in_body_axes = planar.moving_centrode_from_reference(v, w, body.angles[1])
    rows = [
        [f'r_P/{a} (eq. 21)', *planar.pole_from_reference(v, w)],
        [f'the same in axes of {body.name} (eq. 22)', *in_body_axes],
        ['r_P (eq. 23)', *planar.fixed_centrode_from_reference(r, v, w)],
        ['u along the fixed centrode', *fixed],
        ['u along the moving centrode', *moving],
    ]
    return [*lines, '', *table_lines(['pole', 'x m, m/s', 'y m, m/s'], rows)]


def decomposition_panels(body: DecomposedBody) -> list[Panel]:
    """Return two panels of displacements, two of velocities, and the centrodes below."""
    panels: list[Panel] = []
    for row, draw in enumerate((_draw_displacement, _draw_velocities)):
        for k in (0, 1):
            low = complex(k * _WIDTH, row * _HEIGHT)
            panel = Panel('', 'm', low, low + complex(_WIDTH, _HEIGHT))
            draw(panel, body, k)
            panels.append(panel)
    panel = Panel('', 'm', 2j * _HEIGHT, complex(2 * _WIDTH, 3.4 * _HEIGHT))
    _draw_centrodes(panel, body)
    return [*panels, panel]


def _draw_displacement(panel: Panel, body: DecomposedBody, k: int) -> None:
    """Draw the translation with reference point k, then the rotation about it."""
    (start, end), move = (body.ends[:, :2], body.ends[1, k] - body.ends[0, k])
    shifted = start + move
    rotation = body.angles[1] - body.angles[0]
    rotation -= 2 * np.pi * np.round(rotation / (2 * np.pi))  # without whole turns
    arc = end[k] + (shifted[1 - k] - end[k]) * np.exp(1j * rotation * np.linspace(0, 1, 60))
    panel.fit(np.concatenate((start, shifted, end, arc)))
    name, moved = body.labels[k], body.labels[1 - k]
    degrees = np.degrees(rotation)
    panel.title = f'translation with {name}, then rotation about {name} by {degrees:.4g}°'
    panel.line(start, 'former')
    panel.line(shifted, 'former')
    panel.line(end, 'link')
    for n in (k, 1 - k):
        panel.line([start[n], shifted[n]], 'relative', f's_{{{name}}}')
    panel.line(arc, 'tangential', f'φ_{{{name}}}')
    for number, points in (('1', start), ('2', end)):
        for n in (0, 1):
            panel.point(points[n], f'{body.labels[n]}_{{{number}}}')
    panel.point(shifted[1 - k], f'({moved}_{{2}})_{{T}}')
    panel.scale_bar(f'φ_{{{name}}} = {degrees:.6g}°')


def _draw_links(panel: Panel, body: DecomposedBody, *points: np.ndarray) -> None:
    """Draw the linkage with the body in front; fit the panel to it and to the `points`."""
    sides = polygon(body.here.scene, body.here.motion, 0).sides
    lines = [np.array([side.tail, side.head]) for side in sides]
    panel.fit(np.concatenate([*lines, body.ends[1], *points]))
    for line in lines:
        panel.line(line, 'shape')
    corners = body.ends[1]
    panel.line([*corners, *(corners[:1] if len(corners) > 2 else [])], 'link')


def _draw_velocities(panel: Panel, body: DecomposedBody, k: int) -> None:
    """Draw each velocity as that of reference point k, plus that of the rotation about it."""
    points, name = body.ends[1], body.labels[k]
    fastest = float(np.abs(body.velocity).max()) or 1.0
    size = max(float(np.abs(points[:, None] - points).max()), 1e-12)
    panel.rate = round_down(_ARROW * size / fastest)
    arrows = panel.rate * body.velocity
    _draw_links(panel, body, points + arrows, points + arrows[k])
    panel.title = f'velocities: translation with {name} + rotation about {name}'
    for n, z in enumerate(points):
        own = body.labels[n]
        panel.line([z, z + arrows[k]], 'relative', f'v_{{{name}}}')
        if n != k:
            panel.line([z + arrows[k], z + arrows[n]], 'tangential', f'v_{{{own}/{name}}}')
            panel.line([z, z + arrows[n]], 'absolute', f'v_{{{own}}}')
    for own, z in zip(body.labels, points, strict=True):
        panel.point(z, own)
    panel.scale_bar(f'arrows: 1 m/s is {panel.rate:g} m long; ω = {body.rates[0]:.5g} rad/s')


def _draw_centrodes(panel: Panel, body: DecomposedBody) -> None:
    """Draw the centrodes near the pole, their common tangent and the velocity of the pole."""
    b, motion, here = body.number, body.motion.motion, body.here.motion
    here_poles = poles(body.here.scene.mechanism, here)
    pole, velocity = complex(here_poles.icr[b, 0]), complex(here_poles.velocity[b, 0])
    panel.title = f'centrodes of {body.name}: the moving one rolls on the fixed one'
    if not np.isfinite(pole):
        _draw_links(panel, body)
        panel.scale_bar('it does not turn: the pole is at infinity')
        return
    fixed = body.poles.icr[b]
    turned = np.exp(1j * (body.angles[1] - motion.angle[0, b]))
    moving = here.position[0, b, 0] + (fixed - motion.position[0, b]) * turned
    points = body.ends[1]
    size = max(float(np.abs(np.append(points, pole) - pole).max()), 1e-12)
    lines = []
    for curve, style, name in ((fixed, 'fixed', 'k_{P}'), (moving, 'moving', 'k_{H}')):
        near = np.abs(curve - pole) < _CENTRODE_EXTENT * size
        pieces = np.split(curve, np.flatnonzero(near[1:] != near[:-1]) + 1)
        near_pieces = (z for z in pieces if abs(z[0] - pole) < _CENTRODE_EXTENT * size)
        lines += [(z, style, name) for z in near_pieces]
    tangent = 0.5 * size * velocity / abs(velocity) if velocity else 0j
    _draw_links(panel, body, *(z for z, *_ in lines), pole + np.array([-tangent, tangent]))
    labeled = set()
    for z, style, name in sorted(lines, key=lambda line: -len(line[0])):
        panel.line(z, style, '' if name in labeled else name)
        labeled.add(name)
    for name, point in zip(body.labels, points, strict=True):
        panel.line([pole, point], 'construction')
        panel.point(point, name)
    if tangent and abs(velocity) > 1e-9 * size * abs(body.rates[0]):
        panel.line([pole - 1.3 * tangent, pole + 1.3 * tangent], 'construction', 't_{P}')
        panel.rate = abs(tangent) / abs(velocity)
        panel.line([pole, pole + tangent], 'absolute', 'u')
    panel.point(pole, 'pole')
    speed = (
        f'u = {abs(velocity):.5g} m/s along both' if velocity else 'the pole stands still: u = 0'
    )
    panel.scale_bar(speed)
