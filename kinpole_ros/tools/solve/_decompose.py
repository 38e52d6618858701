"""Poisson's decomposition of the motion of a body, drawn as seed 001 does in its Figs. 1 to 3."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros import planar
from kinpole_ros.mechanism import Poles, SceneError, poles, polygon
from kinpole_ros.tools.solve._lines import table_lines
from kinpole_ros.tools.solve._sheet import Panel, write_sheet
from kinpole_ros.tools.solve._solved import Solved

_WIDTH, _HEIGHT = 620.0, 480.0
# The longest arrow of a velocity, of the size of what is drawn; how far out centrodes are drawn.
_ARROW, _FAR = 0.4, 0.9


class Decomposed(NamedTuple):
    """
    A body `name` with its points `names`, first the two reference points, at two positions.

    `ends` (2, points) complex, m, and `angles` (2,), rad, are of the former and of this position;
    `velocity` (points,), m/s, and `rates` (ω, α) of this one. `here` is the scene there, `whole`
    over its range; `around` are the body's poles over this.
    """

    name: str
    names: tuple[str, ...]
    ends: np.ndarray
    angles: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    here: Solved
    whole: Solved
    around: Poles


def decompose(words: str, former: Solved, here: Solved, whole: Solved) -> Decomposed:
    """
    Read BODY:A,B, and where its points are at two positions of the scene.

    Raises SceneError for what is no body or point of it, and where nothing moves on.
    """
    scene = here.scene
    body, _, said = words.partition(':')
    if body not in scene.mechanism.bodies:
        known = ', '.join(scene.mechanism.bodies)
        raise SceneError(f'--decompose: there is no moving body {body!r}: give one of {known}')
    places = {name.rpartition('.')[2]: z for name, (of, z) in scene.points.items() if of == body}
    if not scene.mechanism.assembly.joints:
        loops, b = scene.mechanism.assembly.loops, scene.mechanism.bodies.index(body)
        term = np.flatnonzero(loops.angles.any(axis=1))[b]
        length = complex(loops.length0[term] * np.exp(1j * loops.angle0[term]))
        places |= {'tail': 0j, 'head': length} if length else {'tail': 0j}
    chosen = [name.strip() for name in said.split(',')]
    if len({places.get(name) for name in chosen} - {None}) != 2 or len(chosen) != 2:
        raise SceneError(
            f'--decompose {words!r}: give two reference points of {body} at different places, as '
            f'{body}:A,B; it has {", ".join(places)}'
        )
    names = (*chosen, *(name for name in places if name not in chosen))
    arms = np.array([places[name] for name in names])
    b = scene.mechanism.bodies.index(body)
    position = np.array([one.motion.position[0, b, 0] for one in (former, here)])
    angles = np.array([one.motion.angle[0, b, 0] for one in (former, here)])
    rates = here.motion.angle[1:3, b, 0]
    turned = arms * np.exp(1j * angles[:, None])
    velocity = here.motion.position[1, b, 0] + 1j * rates[0] * turned[1]
    if not np.isfinite(velocity).all():
        raise SceneError(
            '--decompose: in a dead point it has no velocities: give a value next to it'
        )
    ends = position[:, None] + turned
    around = poles(scene.mechanism, whole.motion)
    return Decomposed(body, names, ends, angles, velocity, rates, here, whole, around)


def decomposition_lines(found: Decomposed) -> list[str]:
    """Both ways from the former position to this, and both ways of composing the velocity."""
    turn = float(np.degrees(found.angles[1] - found.angles[0]))
    moves = found.ends[1] - found.ends[0]
    w, alpha = found.rates
    rows = [
        [name, z.real, z.imag, abs(z), turn]
        for name, z in zip(found.names[:2], moves, strict=False)
    ]
    lines = ['', f'{found.name} from the former position: translation with, then rotation about']
    lines += table_lines(['reference', 'x m', 'y m', 'm', 'rotation deg'], rows)
    (a, b), (v_a, v_b) = found.names[:2], found.velocity[:2]
    lines += ['', f'at this instant, ω = {w:.6g} rad/s whatever the reference point']
    rows = []
    for name, z in (
        (f'v_{a}', v_a),
        (f'v_{b}/{a}', v_b - v_a),
        (f'v_{b}', v_b),
        (f'v_{a}/{b}', v_a - v_b),
    ):
        rows.append([name, abs(z), np.degrees(np.angle(z)), z.real, z.imag])
    lines += table_lines(['vector', 'm/s', 'deg', 'x m/s', 'y m/s'], rows)
    if not w:
        return [*lines, 'it does not turn: the pole is at infinity']
    body = found.here.scene.mechanism.bodies.index(found.name)
    # The acceleration of A from that of the origin: eq. 4.
    origin = found.here.motion.position[:3, body, 0]
    arm = found.ends[1, 0] - origin[0]
    r, v = (planar.to_plane(z) for z in (found.ends[1, 0], v_a))
    a_a = planar.to_plane(origin[2]) + planar.relative_acceleration(w, alpha, planar.to_plane(arm))
    fixed, moving = planar.centrode_velocities(v, a_a, w, alpha)
    rows = [
        [f'r_P/{a} (eq. 21)', *planar.pole_from_reference(v, w)],
        [
            f'the same in axes of {found.name} (eq. 22)',
            *planar.moving_centrode_from_reference(v, w, found.angles[1]),
        ],
        ['r_P (eq. 23)', *planar.fixed_centrode_from_reference(r, v, w)],
        ['u along the fixed centrode', *fixed],
        ['u along the moving centrode', *moving],
    ]
    return [*lines, '', *table_lines(['pole', 'x m, m/s', 'y m, m/s'], rows)]


def draw_decomposition(path: Path, kind: str, found: Decomposed) -> None:
    """Draw both ways between the positions and at the instant, and the centrodes rolling."""
    title = f'{found.here.scene.name}: motion of {found.name} as translation and rotation'
    write_sheet(path, kind, title, decomposition_panels(found))


def decomposition_panels(found: Decomposed) -> list[Panel]:
    """Two of displacements, two of velocities, and the centrodes below."""
    panels = []
    for row, draw in enumerate((_displacement, _instant)):
        for k in (0, 1):
            low = complex(k * _WIDTH, row * _HEIGHT)
            panel = Panel('', 'm', low, low + complex(_WIDTH, _HEIGHT))
            draw(panel, found, k)
            panels.append(panel)
    panel = Panel('', 'm', 2j * _HEIGHT, complex(2 * _WIDTH, 3.4 * _HEIGHT))
    _centrodes(panel, found)
    return [*panels, panel]


def _displacement(panel: Panel, found: Decomposed, k: int) -> None:
    """Fig. 1: with reference point k to (B2)T or (A2)T, then about it to the position."""
    (start, end), move = found.ends[:, :2], found.ends[1, k] - found.ends[0, k]
    shifted = start + move
    turn = found.angles[1] - found.angles[0]
    # Less the whole turns that it made between.
    turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
    arc = end[k] + (shifted[1 - k] - end[k]) * np.exp(1j * turn * np.linspace(0, 1, 60))
    panel.fit(np.concatenate((start, shifted, end, arc)))
    name, other = found.names[k], found.names[1 - k]
    panel.title = f'translation with {name}, then rotation about {name} by {np.degrees(turn):.4g}°'
    panel.line(start, 'former')
    panel.line(shifted, 'former')
    panel.line(end, 'link')
    for at in (k, 1 - k):
        panel.line([start[at], shifted[at]], 'relative', f's_{{{name}}}')
    panel.line(arc, 'tangential', f'φ_{{{name}}}')
    for which, ends in (('1', start), ('2', end)):
        for at in (0, 1):
            panel.point(ends[at], f'{found.names[at]}_{{{which}}}')
    panel.point(shifted[1 - k], f'({other}_{{2}})_{{T}}')
    panel.bar(f'φ_{{{name}}} = {np.degrees(turn):.6g}°')


def _links(panel: Panel, found: Decomposed, *more: np.ndarray) -> None:
    """The whole linkage, the body in front; the panel is fit to it and `more`."""
    sides = polygon(found.here.scene, found.here.motion, 0).sides
    lines = [np.array([side.tail, side.head]) for side in sides]
    panel.fit(np.concatenate([*lines, found.ends[1], *more]))
    for line in lines:
        panel.line(line, 'shape')
    shape = found.ends[1]
    panel.line([*shape, *(shape[:1] if len(shape) > 2 else [])], 'link')


def _instant(panel: Panel, found: Decomposed, k: int) -> None:
    """Fig. 2 at each point: velocities are those of the reference point and about it."""
    points, name = found.ends[1], found.names[k]
    fastest = float(np.abs(found.velocity).max()) or 1.0
    size = max(float(np.abs(points[:, None] - points).max()), 1e-12)
    ten = 10.0 ** np.floor(np.log10(_ARROW * size / fastest))
    panel.rate = ten * max(n for n in (1, 2, 5) if n * ten <= _ARROW * size / fastest)
    along = panel.rate * found.velocity
    _links(panel, found, points + along, points + along[k])
    panel.title = f'velocities: translation with {name} + rotation about {name}'
    for at, z in enumerate(points):
        of = found.names[at]
        panel.line([z, z + along[k]], 'relative', f'v_{{{name}}}')
        if at != k:
            panel.line([z + along[k], z + along[at]], 'tangential', f'v_{{{of}/{name}}}')
            panel.line([z, z + along[at]], 'absolute', f'v_{{{of}}}')
    for at, z in enumerate(points):
        panel.point(z, found.names[at])
    panel.bar(f'arrows: 1 m/s is {panel.rate:g} m long; ω = {found.rates[0]:.5g} rad/s')


def _centrodes(panel: Panel, found: Decomposed) -> None:
    """Fig. 3: the centrodes with the pole, their common tangent and u."""
    whole, here = found.whole.motion, found.here
    b = here.scene.mechanism.bodies.index(found.name)
    at = poles(here.scene.mechanism, here.motion)
    pole, u = complex(at.icr[b, 0]), complex(at.velocity[b, 0])
    panel.title = f'centrodes of {found.name}: the moving one rolls on the fixed one'
    if not np.isfinite(pole):
        _links(panel, found)
        panel.bar('it does not turn: the pole is at infinity')
        return
    turned = np.exp(1j * (found.angles[1] - whole.angle[0, b]))
    moving = here.motion.position[0, b, 0] + (found.around.icr[b] - whole.position[0, b]) * turned
    points = found.ends[1]
    size = max(float(np.abs(np.append(points, pole) - pole).max()), 1e-12)
    lines = []
    for curve, style, name in (
        (found.around.icr[b], 'fixed', 'k_{P}'),
        (moving, 'moving', 'k_{H}'),
    ):
        near = np.abs(curve - pole) < (1 + _FAR) * size
        runs = np.split(curve, np.flatnonzero(near[1:] != near[:-1]) + 1)
        lines += [(run, style, name) for run in runs if abs(run[0] - pole) < (1 + _FAR) * size]
    tangent = 0.5 * size * u / abs(u) if u else 0j
    _links(panel, found, *(run for run, *_ in lines), pole + np.array([-tangent, tangent]))
    named = set()
    for run, style, name in sorted(lines, key=lambda line: -len(line[0])):
        panel.line(run, style, '' if name in named else name)
        named.add(name)
    for name, z in zip(found.names, points, strict=True):
        panel.line([pole, z], 'construction')
        panel.point(z, name)
    if tangent and abs(u) > 1e-9 * size * abs(found.rates[0]):
        panel.line([pole - 1.3 * tangent, pole + 1.3 * tangent], 'construction', 't_{P}')
        panel.rate = abs(tangent) / abs(u)
        panel.line([pole, pole + tangent], 'absolute', 'u')
    panel.point(pole, 'pole')
    panel.bar(f'u = {abs(u):.5g} m/s along both' if u else 'the pole stands still: u = 0')
