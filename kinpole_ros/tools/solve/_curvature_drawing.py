"""
The constructions of curvature theory for `kinpole solve --curvature`, as books draw them.

Euler and Savary: on the ray from the pole P through a point A, the center O of its path and its
point A_J on the inflection circle satisfy PA² = AO · AA_J. Bobillier: for two points, the line AB
and that of their centers meet on the collineation axis through P, which makes with one ray the
angle that the pole tangent makes with the other (J. E. Shigley and J. J. Uicker, Theory of Machines
and Mechanisms, chapter 4).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from kinpole_ros import planar
from kinpole_ros.mechanism import SceneError, poles
from kinpole_ros.tools.solve._panels import Panel
from kinpole_ros.tools.solve._shapes import SceneLines, body_vector
from kinpole_ros.tools.solve._solution import SolvedScene
from kinpole_ros.tools.solve._text import Row, table_lines

_WIDTH, _HEIGHT = 620.0, 560.0  # px
# In sizes of a body with its pole: what is farther away than this is not drawn.
_REACH = 2.5
# Lengths below this share of others are rounding; so is an angle between two rays, rad.
_ROUNDING, _SAME_RAY = 1e-9, 1e-3
_ARC = np.linspace(0, 1, 40)
# The pole, the inflection pole, and where two lines meet on the axis.
_LETTERS = 'P', 'J', 'Q', 't'


class BodyCurvature(NamedTuple):
    """
    A body at one position: its points by name, first two on different rays, complex, m.

    `centers` are those of their paths, NaN where a path is straight; `tangent` is the direction of
    the pole's velocity, `inflection` the inflection pole J.
    """

    name: str
    points: dict[str, complex]
    centers: dict[str, complex]
    pole: complex
    velocity: complex
    inflection: complex

    @property
    def tangent(self) -> complex:
        """The direction of the pole tangent, of length 1."""
        return self.velocity / abs(self.velocity)

    @property
    def size(self) -> float:
        """The greatest distance of its points from the pole, m."""
        return max(abs(z - self.pole) for z in self.points.values())

    def on_circle(self, z: complex) -> complex:
        """The second point of the ray through z on the inflection circle."""
        ray = (z - self.pole) / abs(z - self.pole)
        return self.pole + ray * ((self.inflection - self.pole) * ray.conjugate()).real

    def axis(self, first: str, second: str) -> complex:
        """The direction of the collineation axis of two points, of length 1."""
        rays = (self.points[first] - self.pole) * (self.points[second] - self.pole)
        return rays / abs(rays) / self.tangent


def curved_bodies(here: SolvedScene) -> list[BodyCurvature]:
    """Return the bodies whose pole moves; bodies that move alike are one. Raises SceneError."""
    scene, motion = here.scene, here.motion
    of_bodies = poles(scene.mechanism, motion)
    by_motion: dict[tuple[float, ...], tuple[str, dict[str, complex]]] = {}
    found: dict[str, BodyCurvature] = {}
    for b, body in enumerate(scene.mechanism.bodies):
        if np.isnan(of_bodies.inflection_circle[b, 0]):
            continue
        own = {_label(n): z for n, (of, z) in scene.points.items() if of == body}
        if not scene.mechanism.assembly.joints:
            own |= {f'{body} tail': 0j, f'{body} head': body_vector(scene, body)}
        turn, origin = np.exp(1j * motion.angle[0, b, 0]), motion.position[0, b, 0]
        rate, pole = float(motion.angle[1, b, 0]), complex(of_bodies.icr[b, 0])
        key = tuple(np.round([rate, *planar.to_plane(pole)], 9))
        name, points = by_motion.setdefault(key, (body, {}))
        points |= {point: complex(origin + z * turn) for point, z in own.items()}
        ordered = _ordered(points, pole)
        if not ordered:
            continue
        velocity = complex(of_bodies.velocity[b, 0])
        at, *about = (planar.to_plane(z) for z in (np.array([*ordered.values()]), pole, velocity))
        centers = planar.to_complex(planar.path_curvature(at, rate, *about).center)
        inflection = 2 * complex(of_bodies.inflection_circle[b, 0]) - pole
        # A center this far away is at infinity but for rounding.
        centers[~(np.abs(centers - pole) < np.abs(inflection - pole) / _ROUNDING)] = np.nan
        named = dict(zip(ordered, centers.tolist(), strict=True))
        found[name] = BodyCurvature(name, ordered, named, pole, velocity, inflection)
    if not found:
        raise SceneError(
            f'--curvature: no body of {scene.name} has a pole that moves here: give another --at'
        )
    return list(found.values())


def _label(name: str) -> str:
    """Return the name of a point without its body, unless it is one of the construction."""
    body, _, short = name.rpartition('.')
    return f'{body or "point"} {short}' if short in _LETTERS else short


def _ordered(points: dict[str, complex], pole: complex) -> dict[str, complex]:
    """Return each point once, without the pole, two on different rays first."""
    size = max((abs(z - pole) for z in points.values()), default=0.0)
    kept: dict[str, complex] = {}
    for name, z in points.items():
        if all(abs(z - other) > _ROUNDING * size for other in (*kept.values(), pole)):
            kept[name] = z
    names = list(kept)
    for second in names[1:]:
        if abs(np.sin(np.angle((kept[second] - pole) / (kept[names[0]] - pole)))) > _SAME_RAY:
            names.insert(1, names.pop(names.index(second)))
            break
    return {name: kept[name] for name in names}


def curvature_lines(bodies: list[BodyCurvature]) -> list[str]:
    """Return the circle of each body, and the centers of curvature of its points."""
    lines = []
    for body in bodies:
        pole, inflection = body.pole, body.inflection
        degrees = np.degrees(np.angle(body.tangent))
        lines += [
            '',
            f'{body.name}: pole P at ({pole.real:.6g}, {pole.imag:.6g}) m, its tangent along '
            f'{degrees:.6g} deg; inflection circle of diameter {abs(inflection - pole):.6g} m to '
            f'J at ({inflection.real:.6g}, {inflection.imag:.6g}) m',
        ]
        rows: list[Row] = []
        for name, z in body.points.items():
            on_circle, center = body.on_circle(z), body.centers[name]
            radius = abs(z - center) if np.isfinite(center) else np.inf
            ends = [part for end in (on_circle, center) for part in (end.real, end.imag)]
            rows.append([name, abs(z - pole), abs(z - on_circle), radius, *ends])
        head = ['point A', 'PA m', 'AA_J m', 'AO m', 'A_J x m', 'A_J y m', 'O x m', 'O y m']
        lines += table_lines(head, rows)
        if _has_two_rays(body):
            first, second = list(body.points)[:2]
            angle = np.degrees(_angle(body, first))
            axis = np.degrees(np.angle(body.axis(first, second)))
            lines.append(
                f'Bobillier for {first}, {second}: the axis along {axis:.6g} deg makes with '
                f'P{second} the {angle:.6g} deg of the tangent and P{first}'
            )
    return lines


def _has_two_rays(body: BodyCurvature) -> bool:
    rays = [z - body.pole for z in list(body.points.values())[:2]]
    return len(rays) > 1 and abs(np.sin(np.angle(rays[1] / rays[0]))) > _SAME_RAY


def _angle(body: BodyCurvature, name: str) -> float:
    """Return the angle, rad, from the tangent to the ray of a point, as lines: within ±π/2."""
    angle = np.angle((body.points[name] - body.pole) / body.tangent)
    return float((angle + np.pi / 2) % np.pi - np.pi / 2)


class _Stroke(NamedTuple):
    """A line of a drawing, m, or with the style 'dot' a point."""

    points: np.ndarray
    style: str
    name: str = ''


def curvature_panels(
    here: SolvedScene, drawn: SceneLines, bodies: list[BodyCurvature]
) -> list[Panel]:
    """Return two panels for each body, to scale: Euler and Savary, and Bobillier."""
    panels = []
    for row, body in enumerate(bodies):
        links = [_Stroke(line.points, 'shape') for line in drawn.at(here)]
        shared = [one for one in links if np.abs(one.points - body.pole).max() < _REACH * body.size]
        shared += _circle_marks(body)
        drawings = [(f'{body.name}, Euler–Savary: PA² = AO · AA_J', list(_ray_marks(body)))]
        if _has_two_rays(body):
            first, second = list(body.points)[:2]
            title = f'{body.name}, Bobillier: collineation axis of {first} and {second}'
            drawings.append((title, list(_axis_marks(body))))
        for column, (title, marks) in enumerate(drawings):
            low = complex(column * _WIDTH, row * _HEIGHT)
            panel = Panel(title, 'm', low, low + complex(_WIDTH, _HEIGHT))
            panel.fit(np.concatenate([mark.points for mark in (*shared, *marks)]))
            for mark in (*shared, *marks):
                if mark.style == 'dot':
                    panel.point(complex(mark.points[0]), mark.name)
                else:
                    panel.line(*mark)
            angle = f'φ = {np.degrees(_angle(body, next(iter(body.points)))):.5g}°'
            panel.scale_bar(angle if column else f'PJ = {abs(body.inflection - body.pole):.5g} m')
            panels.append(panel)
    return panels


def _near(body: BodyCurvature, z: complex) -> bool:
    return bool(abs(z - body.pole) < _REACH * body.size)


def _dot(z: complex, name: str) -> _Stroke:
    return _Stroke(np.array([z]), 'dot', name)


def _circle_marks(body: BodyCurvature) -> list[_Stroke]:
    """Return what both constructions share: the circle, the pole, its tangent and the points."""
    middle = (body.pole + body.inflection) / 2
    # From the far side on, the part near the pole is one piece.
    circle = middle + (body.inflection - middle) * np.exp(2j * np.pi * np.linspace(0, 1, 721))
    marks = [_dot(body.pole, 'P'), *(_dot(z, name) for name, z in body.points.items())]
    if _near(body, body.inflection):
        marks.append(_Stroke(np.array([body.pole, body.inflection]), 'construction'))
        marks.append(_dot(body.inflection, 'J'))
    else:
        circle = circle[np.abs(circle - body.pole) < body.size]
    tangent = body.pole + 0.4 * body.size * body.tangent * np.array([-1, 1])
    return [*marks, _Stroke(circle, 'inflection'), _Stroke(tangent, 'construction', 't')]


def _ray(body: BodyCurvature, name: str) -> Iterator[_Stroke]:
    """Yield the ray of a point to its center, or to the point alone if that is far away."""
    z, center = body.points[name], body.centers[name]
    ends = [body.pole, z]
    if _near(body, center):
        ends.append(center)
        yield _dot(center, f'O_{{{name}}}')
    ends.sort(key=lambda end: ((end - body.pole) * (z - body.pole).conjugate()).real)
    yield _Stroke(np.array([ends[0], ends[-1]]), 'ray')


def _ray_marks(body: BodyCurvature) -> Iterator[_Stroke]:
    """Yield the rays of all points, with their points on the inflection circle."""
    for name, z in body.points.items():
        yield from _ray(body, name)
        on_circle = body.on_circle(z)
        if _near(body, on_circle) and abs(on_circle - z) > 1e-6 * body.size:
            yield _Stroke(np.array([z, on_circle]), 'ray')
            yield _dot(on_circle, f'{name}_{{J}}')


def _axis_marks(body: BodyCurvature) -> Iterator[_Stroke]:
    """Yield two rays, the axis and both equal angles; from the axis of a third point its center."""
    first, second, *others = body.points
    for name in (first, second):
        yield from _ray(body, name)
    yield from _pair_marks(body, first, second, 'axis', 'Q')
    angle = _angle(body, first)
    rays = [body.points[name] - body.pole for name in (first, second)]
    for k, start in enumerate((rays[0] * np.exp(-1j * angle), rays[1])):
        radius = (0.22 + 0.04 * k) * body.size * start / abs(start)
        yield _Stroke(body.pole + radius * np.exp(1j * angle * _ARC), 'angle', 'φ')
    for name in others[:1]:
        yield from _ray(body, name)
        yield from _pair_marks(body, first, name, 'construction', f'Q_{{{name}}}')


def _pair_marks(
    body: BodyCurvature, first: str, second: str, style: str, name: str
) -> Iterator[_Stroke]:
    """Yield the collineation axis of two points, and the lines that meet on it."""
    axis, (a, b) = body.axis(first, second), (body.points[first], body.points[second])
    across = ((b - a).conjugate() * axis).imag
    offset = ((body.pole - a).conjugate() * axis).imag
    crossing = a + (b - a) * offset / across if across else complex(np.inf)
    if not _near(body, crossing):
        yield _Stroke(body.pole + 0.5 * body.size * axis * np.array([-1, 1]), style)
        return
    yield _Stroke(np.array([body.pole, crossing]), style)
    yield _dot(crossing, name)
    for ends in ((a, b), (body.centers[first], body.centers[second])):
        if all(_near(body, z) for z in ends):
            far = max(ends, key=lambda z: abs(z - crossing))
            yield _Stroke(np.array([far, crossing]), 'construction')
