"""Drawings of `kinpole solve` to scale: polygons and Poisson's decomposition."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from conftest import options_of

from kinpole_ros import planar
from kinpole_ros.mechanism import (
    SceneError,
    load_scene,
    poles,
    polygon,
    scene_names,
    scene_text,
)
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve import solve_scene
from kinpole_ros.tools.solve._decomposition import decompose, decomposition_panels
from kinpole_ros.tools.solve._panels import Panel, width_of
from kinpole_ros.tools.solve._polygons import polygon_panels
from kinpole_ros.tools.solve._shapes import SceneLines
from kinpole_ros.tools.solve._solution import at_value, over_time, point_motions

SVG = '{http://www.w3.org/2000/svg}'


def drawn(file: Path) -> list[dict[str, complex]]:
    """Of each panel the named vectors, in its unit."""
    panels = []
    for group in ET.parse(file).getroot().iter(f'{SVG}g'):
        scale, found = float(group.attrib['data-scale']), {}
        for line in group.iter(f'{SVG}polyline'):
            if name := line.get('data-name'):
                ends = [complex(*map(float, z.split(','))) for z in line.attrib['points'].split()]
                found[name.translate({123: None, 125: None})] = (
                    ends[-1] - ends[0]
                ).conjugate() / scale
        panels.append(found)
    return panels


def arrows(file: Path, panel: int) -> dict[str, list[complex]]:
    """Of a panel all arrows by name, in m, those of velocities in m/s."""
    group = list(ET.parse(file).getroot().iter(f'{SVG}g'))[panel]
    scale, found = float(group.attrib['data-scale']), {}
    for line in group.iter(f'{SVG}polyline'):
        if name := line.get('data-name'):
            ends = [complex(*map(float, z.split(','))) for z in line.attrib['points'].split()]
            rate = float(group.attrib['data-rate']) if name[0] in 'uv' else 1.0
            vector = (ends[-1] - ends[0]).conjugate() / scale / rate
            found.setdefault(name.translate({123: None, 125: None}), []).append(vector)
    return found


def table(lines: list[str]) -> dict[str, complex]:
    """Vectors by name, as printed."""
    rows = [line.split() for line in lines if re.match(r'[va]_\S+ ', line)]
    return {cells[0]: complex(float(cells[-2]), float(cells[-1])) for cells in rows}


def same(found: complex, truth: complex, size: float) -> None:
    assert abs(found - truth) < 1e-6 * size


@pytest.mark.parametrize('at', ['60 deg', '200 deg'])
def test_lengths_are_those_of_poissons_equations(tmp_path: Path, at: str) -> None:
    """Seed 001, eq. 2 to 4, with the functions of `planar` that say so."""
    file = tmp_path / 'a.svg'
    solve_scene(options_of('solve', 'four_bar', at=at, polygon=file))
    _, v, a = drawn(file)
    solved = at_value(load_scene('four_bar'), at)
    points = {name: z[:, 0] for name, z in point_motions(solved).items()}
    coupler, rocker = (solved.motion.angle[:, b, 0] for b in (1, 2))
    for name, key in (('A', 'crank.A'), ('B', 'rocker.B'), ('P', 'coupler.P')):
        same(v[f'v_{name}'], points[key][1], abs(points['crank.A'][1]))
        same(a[f'a_{name}'], points[key][2], abs(points['crank.A'][2]))
    for head in 'BP':
        arm = planar.to_plane(points[f'coupler.{head}'][0] - points['coupler.A'][0])
        relative = planar.to_complex(planar.relative_velocity(coupler[1], arm))
        same(v[f'v_{head}A'], relative, abs(points['crank.A'][1]))
        parts = [
            planar.relative_acceleration(coupler[1], 0.0, arm),
            planar.relative_acceleration(0.0, coupler[2], arm),
        ]
        size = abs(points['crank.A'][2])
        for mark, part in zip('nt', parts, strict=True):
            same(a[f'a_{head}A^{mark}'], planar.to_complex(part), size)
        same(a[f'a_{head}A'], planar.to_complex(sum(parts)), size)
        same(v['v_A'] + v[f'v_{head}A'], v[f'v_{head}'], abs(points['crank.A'][1]))
        same(a['a_A'] + a[f'a_{head}A'], a[f'a_{head}'], size)
    # The rocker turns about the ground.
    arm = points['rocker.B'][0] - 0.4
    same(a['a_B^n'], -(rocker[1] ** 2) * arm, abs(points['crank.A'][2]))


def test_the_polygons_of_the_seeds_examples_have_the_printed_lengths(tmp_path: Path) -> None:
    file = tmp_path / 'a.svg'
    # Seed 003, example 1: 70.5 cm/s of the arm, 0.4154 · 120 and 0.4985 · 100 cm/s.
    solve_scene(options_of('solve', 'loader', at='45 deg', polygon=file))
    _, v, _ = drawn(file)
    found = [abs(v[name]) for name in ('v_A', 'v_BA', 'v_B', 'v_PA')]
    assert found == pytest.approx([0.705, 0.4985, 0.4985, 0.8308], rel=1e-3)
    assert v['v_P'] == pytest.approx(0.08896 + 1.086j, rel=1e-3)
    # The closed polygon of its loop equation: r2 + r3 + r4.
    solve_scene(options_of('solve', 'loader_loop', at='45 deg', polygon=file))
    _, v, a = drawn(file)
    for sides in ([v['v_r2'], v['v_r3'], v['v_r4']], [a['a_r2'], a['a_r3'], a['a_r4']]):
        assert abs(sum(sides)) < 1e-6 * abs(sides[0])
    # Example 2: 250 and 144.3 cm/s along the guides, 200 and 500 cm times 1.443 rad/s.
    solve_scene(options_of('solve', 'trebuchet', polygon=file))
    _, v, _ = drawn(file)
    assert v['v_A'] == pytest.approx(-2.5j, rel=1e-6)
    assert abs(v['v_BA']) == pytest.approx(2 * 1.443, rel=1e-3)
    assert abs(v['v_PA']) == pytest.approx(5 * 1.443, rel=1e-3)
    assert v['v_P'] == pytest.approx(3.6075 + 3.7484j, rel=1e-3)


def test_a_slide_that_turns_has_coriolis_part(tmp_path: Path) -> None:
    """A pump jack: the block B of the crank slides on an arm that turns about O."""
    scene = tmp_path / 'whitworth.yaml'
    scene.write_text(
        'bodies:\n'
        '  ground: {O: [0, 0], C: [0.2, 0]}\n'
        '  crank: {C: [0, 0], B: [0.3, 0]}\n'
        '  arm: {O: [0, 0], Q: [0.6, 0]}\n'
        'joints:\n'
        '  - {slot: crank.B, on: arm.O, along: 0 deg, name: block}\n'
        'drivers:\n'
        '  - {drive: crank, rate: 3 rad/s, start: 40 deg}\n'
        'start: {arm: 20 deg}\n'
    )
    file = tmp_path / 'a.svg'
    lines = solve_scene(options_of('solve', scene, at='75 deg', polygon=file))
    _, v, a = drawn(file)
    z = 0.2 + 0.3 * np.exp(1j * np.radians(75))
    e, r, velocity = z / abs(z), abs(z), 0.9j * np.exp(1j * np.radians(75))
    slide, turn = ((velocity / e).real, (velocity / e).imag / r)
    assert v['v_BO^s'] == pytest.approx(slide * e, rel=1e-6)
    assert v['v_BO^t'] == pytest.approx(1j * r * turn * e, rel=1e-6)
    assert a['a_BO^C'] == pytest.approx(2j * slide * turn * e, rel=1e-6)
    assert a['a_BO^n'] == pytest.approx(-r * turn**2 * e, rel=1e-6)
    acceleration = -2.7 * np.exp(1j * np.radians(75))
    total = sum(a[f'a_BO^{mark}'] for mark in 'nCst')
    assert total == pytest.approx(acceleration, rel=1e-6)
    printed = table(lines)
    assert {*printed} == {*v, *a} - {'scale'}
    for name, vector in {**v, **a}.items():
        if name != 'scale':
            assert printed[name] == pytest.approx(vector, rel=1e-4, abs=1e-4)


def covered(panel: Panel) -> list[tuple[str, str]]:
    """Names of a panel that cover each other."""
    panel.place_labels()
    boxes = [(n.text, n.at, width_of(n.text) / 2) for n in panel.labels if n.text]
    return [
        (text, other)
        for k, (text, at, half) in enumerate(boxes)
        for other, there, wide in boxes[:k]
        if abs((at - there).real) < half + wide - 1e-6 and abs((at - there).imag) < 16 - 1e-6
    ]


@pytest.mark.parametrize('name', scene_names())
def test_names_do_not_cover_each_other_and_polygons_close(name: str) -> None:
    scene = load_scene(name)
    for time in (0.0, 0.13, 0.4):
        solved = over_time(scene, np.array([time]))
        for panel in polygon_panels(solved, SceneLines(solved)):
            assert not covered(panel)
            ends = np.concatenate([line.points for line in panel.lines])
            assert (ends.real >= panel.low.real).all() and (ends.real <= panel.high.real).all()
            assert (ends.imag >= panel.low.imag).all() and (ends.imag <= panel.high.imag).all()
        for order in (1, 2):
            figure = polygon(scene, solved.motion, order)
            size = max(abs(z) for z in (1e-12, *figure.points.values()))
            images = np.array([0j, *figure.points.values()])
            for side in figure.sides:
                if scene.mechanism.assembly.joints:
                    assert np.abs(images - side.head).min() < 1e-9 * size
                    assert np.abs(images - side.tail).min() < 1e-9 * size


def test_polygons_are_drawn_by_the_command(tmp_path: Path, capsys) -> None:
    for file in (tmp_path / 'a.svg', tmp_path / 'a.png'):
        words = ['solve', 'double_pendulum', '--time', '0.7', '--polygon', str(file)]
        assert cli.main(words) == 0
        assert f'written to {file}' in capsys.readouterr().out
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
    # At the end of the time.
    _, v, _ = drawn(tmp_path / 'a.svg')
    solved = over_time(load_scene('double_pendulum'), np.array([0.7]))
    upper = point_motions(solved)['upper.A'][1, 0]
    assert v['v_A'] == pytest.approx(upper, rel=1e-6)
    assert cli.main(['solve', 'four_bar', '--polygon', str(tmp_path / 'a.csv')]) == 2
    assert 'end its name in one of' in capsys.readouterr().err


def test_the_ends_of_a_belt_have_one_velocity_along_it(tmp_path: Path) -> None:
    """The strand of a rope that is wound up on a drum turns, since the load is on a guide."""
    path = tmp_path / 'rope.yaml'
    path.write_text("""
bodies:
  ground: {H: [0, 0.5], G: [0.3, 0]}
  drum:   {H: [0, 0]}
  load:   {L: [0, 0]}
joints:
  - {prismatic: load.L, on: ground.G, along: 90 deg, name: height}
  - {belt: [drum.H, load.L], radii: [0.1, -0.04], length: 40 cm, direction: -60 deg, name: rope}
drivers:
  - {drive: drum, from: 0, to: 1, duration: 1}
start: {rope.angle: -63 deg}
""")
    scene = load_scene(path)
    solved = over_time(scene, np.array([0.4]))
    velocities = polygon(scene, solved.motion, 1)
    (strand,) = (side for side in velocities.sides if side.name == 'rope')
    names = scene.mechanism.assembly.loops.variables
    values = solved.motion.values[:, :, 0]
    length, winding = values[0, names.index('rope')], values[1, names.index('drum')]
    angle, turning = values[:2, names.index('rope.angle')]
    along = np.exp(1j * angle)
    assert abs(turning) > 0.01
    assert velocities.points['rope on drum'] == pytest.approx(-0.1 * winding * along)
    assert strand.vector == pytest.approx(1j * length * turning * along)
    assert strand.head == pytest.approx(solved.motion.position[1, 1, 0])
    assert (strand.head * along.conjugate()).real == pytest.approx(-0.1 * winding)
    # Of accelerations both ends have that which turns the strand, and wheels one to the hub more.
    accelerations = polygon(scene, solved.motion, 2)
    (strand,) = (side for side in accelerations.sides if side.name == 'rope')
    assert strand.tail == pytest.approx(accelerations.points['rope on drum'])
    images = accelerations.points
    assert strand.head == pytest.approx(next(images[n] for n in images if 'rope on load' in n))
    faster, second = turning - winding, values[2, names.index('rope.angle')]
    assert strand.parts['normal'] == pytest.approx(-length * turning**2 * along)
    assert strand.parts['tangential'] == pytest.approx(1j * length * second * along)
    to_hubs = 0.1 * faster**2 + 0.04 * turning**2
    assert strand.parts['winding'] == pytest.approx(1j * to_hubs * along)
    assert abs(strand.parts['winding']) > 0.05 * abs(strand.vector)
    # The linkage has the strand itself.
    (line,) = (side for side in polygon(scene, solved.motion, 0).sides if side.name == 'rope')
    assert line.vector == pytest.approx(length * along)
    assert line.tail == pytest.approx(0.5j + 0.1j * along)
    file = tmp_path / 'a.svg'
    solve_scene(options_of('solve', path, time='0.4', polygon=file))
    assert 'v_rope' in drawn(file)[1]


def test_in_a_dead_point_there_is_no_polygon(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='no polygon in a dead point'):
        solve_scene(
            options_of('solve', 'loader_cylinder', at='0.920227378 m', polygon=tmp_path / 'a.svg')
        )


@pytest.mark.parametrize(
    ('name', 'body', 'at'), [('slider_crank', 'rod', '75 deg'), ('four_bar', 'coupler', '200 deg')]
)
def test_both_reference_points_give_the_same_motion(
    tmp_path: Path, name: str, body: str, at: str
) -> None:
    """Seed 001, Figs. 1 to 3."""
    file = tmp_path / 'a.svg'
    lines = solve_scene(options_of('solve', name, at=at, decompose=(f'{body}:A,B', file)))
    scene = load_scene(name)
    former, here = over_time(scene, np.zeros(1)), at_value(scene, at)
    b = scene.mechanism.bodies.index(body)
    turn = here.motion.angle[0, b, 0] - former.motion.angle[0, b, 0]
    then, now = ({k: z[:, 0] for k, z in point_motions(one).items()} for one in (former, here))
    names = [f'{body}.A', f'{body}.B']
    size = abs(now[names[0]][0] - now[names[1]][0])
    for k, letter in enumerate('AB'):
        found = arrows(file, k)
        move = now[names[k]][0] - then[names[k]][0]
        assert len(found[f's_{letter}']) == 2
        for vector in found[f's_{letter}']:
            same(vector, move, size)
        # The chord of the rotation, about one point and about the other.
        arm = then[names[1 - k]][0] - then[names[k]][0]
        same(found[f'φ_{letter}'][0], arm * (np.exp(1j * turn) - 1), size)
        # The velocities: v_B = v_A + w x r_BA.
        found, other = arrows(file, 2 + k), 'BA'[k]
        v, fastest = [now[one][1] for one in names], abs(now[names[0]][1])
        same(found[f'v_{letter}'][0], v[k], fastest)
        same(found[f'v_{other}/{letter}'][0], v[1 - k] - v[k], fastest)
        same(
            found[f'v_{letter}'][1] + found[f'v_{other}/{letter}'][0],
            found[f'v_{other}'][0],
            fastest,
        )
    pole = poles(scene.mechanism, here.motion)
    u, tangent = arrows(file, 4)['u'][0], arrows(file, 4)['t_P'][0]
    same(u, pole.velocity[b, 0], abs(pole.velocity[b, 0]))
    assert abs((u * tangent.conjugate()).imag) < 1e-6 * abs(u * tangent)
    printed = {line.split('  ')[0]: line.split()[-2:] for line in lines}
    along = [
        np.array(printed[f'u along the {which} centrode'], float) for which in ('fixed', 'moving')
    ]
    assert along[0] == pytest.approx(along[1], rel=1e-5)
    assert complex(*along[0]) == pytest.approx(u, rel=1e-5)
    assert complex(*map(float, printed['r_P (eq. 23)'])) == pytest.approx(pole.icr[b, 0], rel=1e-5)
    rotations = [float(line.split()[-1]) for line in lines if re.match('[AB]  ', line)]
    assert rotations == pytest.approx([np.degrees(turn)] * 2, rel=1e-5)


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('four_bar', 'crank:O,A'),
        ('four_bar', 'rocker:B,C'),
        ('loader_loop', 'r3p:tail,head'),
        ('loader_loop', 'r3p:P,tail'),
        ('double_pendulum', 'lower:A,P'),
        ('cardan', 'rod:A,B'),
    ],
)
def test_decompositions_of_other_bodies_are_legible(name: str, words: str) -> None:
    scene = load_scene(name)
    here, whole = over_time(scene, np.array([0.2])), over_time(scene, np.linspace(0, 1, 61))
    for panel in decomposition_panels(decompose(words, over_time(scene, np.zeros(1)), here, whole)):
        assert not covered(panel)


@pytest.mark.parametrize(
    ('words', 'fix'),
    [
        ('none:A,B', 'there is no moving body'),
        ('coupler:A', 'coupler:A,B; it has A, B, P'),
        ('coupler:A,A', 'two reference points'),
        ('coupler:A,C', 'it has A, B, P'),
    ],
)
def test_what_cannot_be_decomposed_is_said(tmp_path: Path, words: str, fix: str) -> None:
    with pytest.raises(SceneError, match=re.escape(fix)):
        solve_scene(options_of('solve', 'four_bar', decompose=(words, tmp_path / 'a.svg')))


def test_a_wheel_has_no_velocity_where_it_touches_but_an_acceleration(tmp_path: Path) -> None:
    file = tmp_path / 'a.svg'
    solve_scene(options_of('solve', 'rolling_wheel', polygon=file))
    _, v, a = drawn(file)
    assert v['v_H'] == pytest.approx(0.2 * np.pi, rel=1e-6)
    assert a['a_contact of wheel'] == pytest.approx(0.1j * (2 * np.pi) ** 2, rel=1e-6)
    assert a['a_H/contact'] == pytest.approx(-0.1j * (2 * np.pi) ** 2, rel=1e-6)


def test_at_rest_there_are_no_arrows(tmp_path: Path) -> None:
    scene = tmp_path / 'rest.yaml'
    text = scene_text('four_bar')
    to = '{drive: crank, from: 0 deg, to: 90 deg, duration: 2, begin: 1}'
    scene.write_text(text.replace('{drive: crank, rate: 1 rev/s, start: 0 deg}', to))
    file = tmp_path / 'a.svg'
    solve_scene(options_of('solve', scene, polygon=file))
    assert [len(panel) for panel in drawn(file)] == [1, 0, 0]
    assert 'velocities: none, it is at rest' in file.read_text()
    lines = solve_scene(options_of('solve', scene, decompose=('coupler:A,B', file)))
    assert 'it does not turn: the pole is at infinity' in lines
    assert not arrows(file, 2).keys() & {'v_A', 'v_B'}
