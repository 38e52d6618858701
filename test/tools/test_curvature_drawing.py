"""`kinpole solve --curvature`: centers and circles against closed forms, drawn to scale."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from test_polygons import covered

from kinpole_ros import planar
from kinpole_ros.mechanism import SceneError, load_scene, scene_names
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve._curvature_drawing import (
    BodyCurvature,
    curvature_lines,
    curvature_panels,
    curved_bodies,
)
from kinpole_ros.tools.solve._shapes import SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene, at_value, over_time, point_motions

SVG = '{http://www.w3.org/2000/svg}'
WHEEL = """
bodies:
  ground: {O: [0, 0]}
  wheel:  {H: [0, 0], T: [0, 0.1], S: [0.1, 0]}
joints: [{rolling: wheel.H, radius: 0.1, on: ground.O, along: 0 deg}]
drivers: [{drive: wheel, rate: -1 rev/s}]
"""


def here(name: str, at: str = '') -> SolvedScene:
    scene = load_scene(name)
    return at_value(scene, at) if at else over_time(scene, np.zeros(1))


@pytest.mark.parametrize('at', ['60 deg', '0 deg', '200 deg', '311 deg'])
def test_centers_of_pins_on_links_are_the_pivots_of_these(at: str) -> None:
    (body,) = curved_bodies(here('four_bar', at))
    assert body.name == 'coupler'
    assert body.centers['A'] == pytest.approx(0, abs=1e-9)
    assert body.centers['B'] == pytest.approx(0.4, abs=1e-9)
    # Any point, by the derivatives of its path. The pole has the letter P.
    _, v, a, _ = point_motions(here('four_bar', at))['coupler.P'][:, 0]
    center = body.points['coupler P'] + 1j * v * abs(v) ** 2 / (v.conjugate() * a).imag
    assert body.centers['coupler P'] == pytest.approx(center, rel=1e-9)


def test_a_rolling_wheel_has_the_circle_between_its_contact_and_its_hub() -> None:
    (body,) = curved_bodies(here(WHEEL))
    assert body.pole == pytest.approx(0, abs=1e-12)
    assert body.inflection == pytest.approx(0.1j)
    assert np.isnan(body.centers['H'])  # on a line
    # Of the cycloid: at its top the radius is four times that of the wheel.
    assert body.centers['T'] == pytest.approx(-0.2j)
    assert abs(body.centers['S'] - body.points['S']) == pytest.approx(2 * np.sqrt(2) * 0.1)


def test_the_circle_of_a_trammel_is_that_on_the_rod() -> None:
    (body,) = curved_bodies(here('cardan', '40 deg'))
    assert body.inflection == pytest.approx(0, abs=1e-12)
    assert abs(body.pole) == pytest.approx(0.3)
    for name in 'AB':
        assert body.on_circle(body.points[name]) == pytest.approx(body.points[name])
        assert np.isnan(body.centers[name])


@pytest.mark.parametrize('name', scene_names())
def test_rays_and_axis_meet_the_equations_of_euler_savary_and_bobillier(name: str) -> None:
    try:
        bodies = curved_bodies(here(name))
    except SceneError:
        # One body, about a pin; a coupler that is moved by parallel links.
        assert name in ('pool_lift', 'bike_suspension', 'exercise_seat')
        return
    for body in bodies:
        for point, z in body.points.items():
            if np.isfinite(body.centers[point]):
                to_pole, to_center, to_circle = (
                    end - z for end in (body.pole, body.centers[point], body.on_circle(z))
                )
                product = (to_center * to_circle.conjugate()).real
                assert product == pytest.approx(abs(to_pole) ** 2, rel=1e-8)
        first, second = [*body.points][:2] if len(body.points) > 1 else ('', '')
        ends = [(body.points[n], body.centers[n]) for n in (first, second) if n]
        if len(ends) == 2 and np.isfinite(ends).all():
            points = [planar.to_plane(z) for pair in ends for z in pair]
            axis = planar.to_complex(planar.bobillier_axis(*points).axis)
            if np.isfinite(axis):  # else a line is parallel to the other
                assert abs((axis.conjugate() * body.axis(first, second)).imag) < 1e-6


@pytest.mark.parametrize('name', ['four_bar', 'six_bar', 'slider_crank', 'cardan', WHEEL])
def test_names_do_not_cover_each_other_and_all_lies_in_the_panels(name: str) -> None:
    solved = here(name)
    for panel in curvature_panels(solved, SceneLines(solved), curved_bodies(solved)):
        panel.place_labels()
        assert not covered(panel)
        ends = np.concatenate([line.points for line in panel.lines])
        assert (ends.real >= panel.low.real).all() and (ends.real <= panel.high.real).all()
        assert (ends.imag >= panel.low.imag).all() and (ends.imag <= panel.high.imag).all()


def test_the_drawing_is_to_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'c.svg'
    words = ['solve', 'six_bar', '--at', '0 deg', '--curvature', str(file)]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert f'written to {file}' in out
    found = re.search(r'coupler: pole P at .* inflection circle of diameter (\S+) m', out)
    groups = list(ET.parse(file).getroot().iter(f'{SVG}g'))
    assert len(groups) == 4  # coupler and rod
    for group in groups[:2]:
        (circle,) = (
            line for line in group.iter(f'{SVG}polyline') if line.get('class') == 'inflection'
        )
        across = [float(z.split(',')[0]) for z in circle.attrib['points'].split()]
        assert found
        diameter = np.ptp(across) / float(group.attrib['data-scale'])
        assert diameter == pytest.approx(float(found[1]), rel=1e-4)
    assert cli.main([*words[:-1], str(tmp_path / 'c.png')]) == 0
    assert (tmp_path / 'c.png').read_bytes().startswith(b'\x89PNG')


def test_vectors_that_turn_together_are_one_body() -> None:
    bodies = {body.name: body for body in curved_bodies(here('loader_cylinder'))}
    assert [*bodies] == ['r3', 'r5']
    # The pole has the letter P; the tails of r3p and r3b are that of r3.
    assert {*bodies['r3'].points} >= {'r3 tail', 'r3 head', 'point P', 'E'}
    assert isinstance(bodies['r3'], BodyCurvature)
    # Its ends are the pins of the links r2 and r4.
    assert bodies['r3'].centers['r3 tail'] == pytest.approx(0, abs=1e-9)
    assert abs(bodies['r3'].centers['r3 head']) == pytest.approx(2.19702258, rel=1e-8)
    lines = '\n'.join(curvature_lines([*bodies.values()]))
    assert 'Bobillier for r3 tail, r3 head' in lines


@pytest.mark.parametrize(
    ('words', 'says'),
    [
        (('pool_lift',), 'no body of pool_lift has a pole that moves here: give another --at'),
        (('antiparallelogram', '--at', '180 deg'), 'has a pole that moves here'),
        (('four_bar', '--at', '9 kg'), 'unit'),
    ],
)
def test_where_there_is_no_construction_one_line_says_so(
    words: tuple[str, ...], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(['solve', *words, '--curvature', str(tmp_path / 'a.svg')]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1
    assert cli.main(['solve', 'four_bar', '--curvature', str(tmp_path / 'a.foo')]) == 2
    assert 'end its name in one of' in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]
