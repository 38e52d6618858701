"""`kinpole solve`: what it prints, writes and refuses."""

import csv
import json
import re
import xml.etree.ElementTree as ET
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import data_of, options_of, title_of

from kinpole_ros.mechanism import (
    SceneError,
    Statics,
    holding,
    load_scene,
    poles,
    scene_names,
    scene_text,
    scenes_folder,
)
from kinpole_ros.mechanism._vector_joints import reactions
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve import _scene_picture, _shapes, solve_scene, tolerances
from kinpole_ros.tools.solve._solution import acting_loads, over_full_motion, over_range, over_time
from kinpole_ros.tools.solve._statics import work_lines

SCENES_PAGE = Path(__file__).parents[2] / 'docs' / 'scenes.md'


def told(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    assert cli.main(['solve', *words]) == 0
    return capsys.readouterr().out.splitlines()


def row(lines: list[str], name: str) -> list[float]:
    """The numbers of the first row of a table that begins with `name`."""
    found = next(line for line in lines if re.match(rf'{re.escape(name)}\s', line))
    return [float(cell) for cell in found.split()[1:]]


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline='') as file:
        head, *rows = list(csv.reader(file))
    cells = np.array([[float(cell or 'nan') for cell in line] for line in rows])
    return dict(zip(head, cells.T, strict=True))


def test_the_loader_of_the_seed_moves_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, 'loader', '--at', '45 deg', '--statics')
    assert row(lines, 'lift')[1] == pytest.approx(-0.4154, rel=1e-3)
    assert row(lines, 'link')[1] == pytest.approx(0.4985, rel=1e-3)
    assert row(lines, 'lift.P')[2:4] == pytest.approx([0.08896, 1.086], rel=1e-3)
    (effort,) = [line for line in lines if 'balances' in line]
    # 1000 kg at P, by the power of its weight: g V_Py over the input's rate.
    assert float(effort.split()[-3]) == pytest.approx(1000 * 9.80665 * 1.08601 / 0.5, rel=1e-5)


def test_the_trebuchet_of_the_seed_moves_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, 'trebuchet')
    assert row(lines, 'bar')[1] == pytest.approx(-1.443, rel=1e-3)
    assert row(lines, 'bar.P')[2:4] == pytest.approx([3.6075, 3.7484], rel=1e-3)


def test_the_text_of_a_scene_is_solved_as_its_file_is(tmp_path: Path) -> None:
    text = scene_text('four_bar')
    page = tmp_path / 'page.html'
    lines = solve_scene(options_of('solve', text, at='60 deg', html=page))
    file = tmp_path / 'scene.yaml'
    file.write_text(text)
    assert lines[:-1] == solve_scene(options_of('solve', file, at='60 deg'))
    assert page.stat().st_size
    assert tolerances(options_of('tolerance', text, samples=2)) == tolerances(
        options_of('tolerance', str(file), samples=2)
    )


def test_the_web_cutter_has_the_printed_poles(tmp_path: Path) -> None:
    """Seed 000, check 1, in cm: ICR, IAP, IJP, the velocity of the ICR and the curvature."""
    table = tmp_path / 'cutter.csv'
    lines = solve_scene(options_of('solve', 'web_cutter', csv=table))
    head = next(k for k, line in enumerate(lines) if 'ICR x m' in line)
    found = next(line for line in lines[head:] if line.startswith('coupler ')).split()
    centimeters = [100 * float(cell) for cell in found[1:9]]
    printed = [18.8257, 6.8520, -49.1784, 13.0846, 12.8647, 3.9747, -37.0807, 72.0169]
    assert centimeters == pytest.approx(printed, rel=3e-4)
    assert float(found[9]) / 100 == pytest.approx(-0.0151, abs=1e-4)
    cells = columns(table)
    names = [f'{what}_{c}' for what in ('icr', 'iap', 'ijp', 'icr_velocity') for c in 'xy']
    assert [100 * cells[f'coupler_{name}'][0] for name in names] == pytest.approx(printed, rel=3e-4)
    # The pinned ones have poles that stand still, and no curvature.
    assert np.isnan(cells['crank_centrode_curvature']).all()


def test_the_pool_lift_of_the_seed_is_its_triangle() -> None:
    """Example 5 prints its dimensions only: the angle follows by the law of cosines."""
    lines = solve_scene(options_of('solve', 'pool_lift', at='20 in', statics=True))
    r1, r2b, r3 = 0.0254 * np.array([16.69, 16, 20])
    between = np.arccos((r1**2 + r2b**2 - r3**2) / (2 * r1 * r2b))
    angle = np.degrees(between) - 90 + 65.58
    rate = 2 * np.pi * 0.1 * 5 * 0.0254
    turning = r3 * rate / (r1 * r2b * np.sin(between))
    assert row(lines, 'arm')[:2] == pytest.approx([angle, turning], rel=1e-5)
    seat = 30.5 * 0.0254 * turning * 1j * np.exp(1j * np.radians(angle))
    assert row(lines, 'arm.P')[2:4] == pytest.approx([seat.real, seat.imag], rel=1e-5)
    (effort,) = [line for line in lines if 'cylinder balances the loads' in line]
    assert float(effort.split()[-2]) == pytest.approx(980.665 * seat.imag / rate, rel=1e-8)


def test_advantages_and_transmission_angles_are_the_closed_forms(tmp_path: Path) -> None:
    table = tmp_path / 'a.csv'
    solve_scene(options_of('solve', 'slider_crank', sweep=True, csv=table))
    cells = columns(table)
    crank = cells['crank']
    rod = -np.arcsin(np.sin(crank) * 0.1 / 0.3)
    moving = np.abs(np.sin(crank)) > 1e-9
    gain = -np.cos(rod) / (0.1 * np.sin(crank - rod))
    np.testing.assert_allclose(cells['advantage_piston'][moving], gain[moving], rtol=1e-9)
    # Between the rod and the normal to the slide.
    angle = cells['transmission_angle_rod_piston']
    np.testing.assert_allclose(angle, np.pi / 2 - np.abs(rod), atol=1e-7)
    lines = solve_scene(options_of('solve', 'four_bar', at='60 deg'))
    (four_bar,) = [line for line in lines if line.startswith('coupler, rocker ')]
    crank, coupler, rocker, ground = 0.12, 0.36, 0.28, 0.4
    across = crank**2 + ground**2 - 2 * crank * ground * np.cos(np.radians(60))
    cosine = (coupler**2 + rocker**2 - across) / (2 * coupler * rocker)
    assert float(four_bar.split()[-1]) == pytest.approx(np.degrees(np.arccos(cosine)), rel=1e-5)


def test_a_sweep_is_the_linkages_range_and_the_time_that_of_the_drivers(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # The scene drives its cylinder from 1.5 to 1.8 m; the linkage goes farther.
    lines = told(capsys, 'loader_cylinder', '--sweep')
    assert 'r5.length from 0.920227378 m (limit) to 2.35533988 m (limit)' in lines
    table = tmp_path / 'course.csv'
    lines = told(capsys, 'loader_cylinder', '--time', '4', '--csv', str(table))
    assert 'from 0 to 4 s' in lines
    cells = columns(table)
    np.testing.assert_allclose(cells['t'], np.linspace(0, 4, len(cells['t'])))
    np.testing.assert_allclose(
        cells['r5.length'], 1.65 + 0.15 * np.sin(np.pi / 2 * cells['t']), rtol=1e-12
    )
    # Several drivers, each with its own rate; the last body by hand.
    told(capsys, 'double_pendulum', '--time', '500 ms', '--csv', str(table))
    cells = columns(table)
    exact = load_scene('double_pendulum').motion(cells['t'])['lower']
    np.testing.assert_allclose(cells['lower_angle_jerk'], exact.angle[3], rtol=1e-12)
    np.testing.assert_allclose(cells['lower_y_acceleration'], exact.position[2].imag, rtol=1e-12)


def test_a_value_without_a_unit_is_taken_in_si_units_and_the_output_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = told(capsys, 'four_bar', '--at', '45')
    said = "taken as 45 rad = 2578.3 deg; for degrees write --at '45 deg'"
    assert any(line.endswith(said) for line in lines)
    assert lines[2].startswith('at crank = 2578.31008 deg')
    assert 'taken as' not in ''.join(told(capsys, 'four_bar', '--at', '45 deg'))
    lines = told(capsys, 'loader_cylinder', '--at', '1.5')
    assert any("taken as 1.5 m; for centimeters write --at '1.5 cm'" in line for line in lines)
    # Where degrees were meant, rad are mostly out of reach: the refusal tells why.
    assert cli.main(['solve', 'loader', '--at', '45']) != 0
    assert "for degrees write --at '45 deg'" in capsys.readouterr().err


def test_centers_come_with_their_deduction(capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, 'four_bar', '--at', '45 deg', '--centers')
    assert 'I13: line I12-I23 meets line I14-I34' in lines
    assert 'I24: line I12-I14 meets line I23-I34' in lines
    # The coupler's center is on the crank, 45 degrees up.
    (found,) = [line for line in lines if line.startswith('I13 ')]
    x, y = (float(cell) for cell in found.split()[-2:])
    assert x == pytest.approx(y, rel=1e-5)


@pytest.mark.parametrize('name', scene_names())
def test_ratios_of_rates_from_three_centers_are_those_of_the_motion(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    lines = told(capsys, name, '--centers')
    rates = over_time(load_scene(name), np.zeros(1)).motion.angle[1, :, 0]
    ratios = [re.fullmatch(r'ω(\d)/ω(\d) = .*?(\S+)', line) for line in lines]
    for ratio in filter(None, ratios):
        j, r, value = int(ratio[1]), int(ratio[2]), float(ratio[3])
        assert value == pytest.approx(rates[j - 2] / rates[r - 2], rel=2e-5), ratio[0]
    if name == 'four_bar':
        assert 'ω4/ω2 = I12I24 / I14I24 = 0.12 m / -0.28 m = -0.428571' in lines
    if name == 'planetary_gear':
        assert 'ω3/ω2: not from centers, since I13 and I23 are one' in lines


def test_a_body_that_does_not_turn_has_a_velocity_from_centers(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / 'crank.yaml'
    path.write_text(
        scene_text('slider_crank')
        .split('# What')[0]
        .replace('joints:', '  block: {B: [0, 0]}\njoints:')
        .replace('slot: rod.B', 'prismatic: block.B')
    )
    lines = told(capsys, str(path), '--centers')
    (line,) = (line for line in lines if line.startswith('v4/ω2'))
    found = re.fullmatch(r'v4/ω2 = I12I24 = (\S+) m, along 180 deg', line)
    solved = over_time(load_scene(path), np.zeros(1))
    velocity, rate = solved.motion.position[1, 2, 0], solved.motion.angle[1, 0, 0]
    assert found
    assert float(found[1]) == pytest.approx(-velocity.real / rate, rel=1e-5)


def test_where_kennedy_does_not_suffice_the_chain_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = told(capsys, 'eight_bar', '--centers')
    assert len([line for line in lines if re.match(r'I\d\d  ', line)]) == 28
    assert len([line for line in lines if re.match(r'I\d\d: pin', line)]) == 10
    assert len([line for line in lines if 'from the rates: Kennedy has ' in line]) == 18
    assert 'I26: from the rates: Kennedy has no line for it' in lines


def test_a_sweep_tells_limits_and_dead_points(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = told(capsys, 'antiparallelogram', '--sweep', '--csv', str(tmp_path / 'a.csv'))
    dead = [line for line in lines if line.startswith('dead point')]
    assert len(dead) == 2
    assert all('change point' in line and 'follower' in line for line in dead)
    assert all('can move, in the loop O, A, B, C' in line for line in dead)
    at = [float(re.search(r'= ([\d.]+) deg', line)[1]) for line in dead]  # type: ignore[index]
    assert np.deg2rad(at) == pytest.approx([np.pi, 2 * np.pi], abs=1e-9)
    table = columns(tmp_path / 'a.csv')
    assert len(table['crank']) > 300
    # At a change point there are no rates, and beside it there are.
    rates = table['follower_angle_velocity']
    assert 0 < np.isnan(rates).sum() <= 3


@pytest.mark.parametrize('name', ['four_bar', 'rolling_wheel', 'loader_cylinder'])
def test_all_that_is_drawn_lies_in_the_picture(name: str) -> None:
    figures = pytest.importorskip('matplotlib.figure')
    axis = figures.Figure().add_subplot()
    scene = load_scene(name)
    here = over_time(scene, np.zeros(1))
    _scene_picture.draw_linkage(axis, over_range(scene, 19), here, centers=False)
    arrows = [text.xy for text in axis.texts if text.arrow_patch]
    assert arrows
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    assert all(left < x < right and bottom < y < top for x, y in arrows)
    # Thick lines: bodies, turning vectors, the rim of a wheel.
    lines = [line for line in axis.lines if line.get_zorder() == 3 and len(line.get_xdata()) > 1]
    # One of the vectors is a cylinder.
    assert len(lines) >= len(scene.mechanism.bodies) - (name == 'loader_cylinder')
    for line in lines:
        assert left < min(line.get_xdata()) and max(line.get_xdata()) < right
        assert bottom < min(line.get_ydata()) and max(line.get_ydata()) < top


def test_slides_are_in_the_tables(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    # Example 2 of seed 003: the other slide.
    lines = told(capsys, 'trebuchet', '--csv', str(tmp_path / 'a.csv'))
    assert [100 * cell for cell in row(lines, 'shift')[:2]] == pytest.approx(
        [173.2, -144.3], rel=1e-3
    )
    assert columns(tmp_path / 'a.csv')['shift_velocity'][0] == pytest.approx(-1.4434, rel=1e-4)
    # Of a slide that is driven there is one column, its own.
    lines = told(capsys, 'loader_cylinder', '--sweep')
    (head,) = [line for line in lines if line.startswith('r5.length (m)')]
    assert head.count('r5.length') == 1
    lines = told(capsys, 'slider_crank', '--sweep')
    head = next(line for line in lines if line.startswith('crank (deg)'))
    assert head.endswith('piston m  piston m/s')


@pytest.mark.parametrize(
    ('scene', 'force', 'told_as'),
    [
        ('trebuchet', 485.303316, 'N at bar.P, along -120 deg, balance the loads, with drop free'),
        ('exercise_machine', 0.451301, 'N at link_2.P, along 180 deg, balance the loads, with'),
    ],
)
def test_statics_answer_the_questions_of_the_seed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, scene: str, force: float, told_as: str
) -> None:
    lines = told(capsys, scene, '--statics', '--csv', str(tmp_path / 'a.csv'))
    (line,) = [line for line in lines if told_as in line]
    assert float(line.split()[0]) == pytest.approx(force, rel=1e-6)
    table = columns(tmp_path / 'a.csv')
    assert table['held_by'] == pytest.approx(force, rel=1e-6)
    (effort,) = [column for name, column in table.items() if name.endswith('_effort')]
    assert effort == pytest.approx(0.0, abs=1e-9)


def test_teeth_of_gears_bear_what_turns_them(tmp_path: Path) -> None:
    """What presses gears apart is not unique where an arm holds their hubs, what turns them is."""
    path = tmp_path / 'gear.yaml'
    text = (scenes_folder() / 'planetary_gear.yaml').read_text()
    path.write_text(text.replace(', pressure: 20 deg', ''))
    lines = solve_scene(options_of('solve', path, statics=True))
    assert 'sun balances the loads with 1 N m' in lines
    # 1 N m over 24 mm; the arm bears the sum of both teeth.
    assert 'sun_teeth: of its force the part along 90 deg is unique: 41.6667 N' in lines
    assert 'ring_teeth: of its force the part along 90 deg is unique: 41.6667 N' in lines
    assert 'P: of its force the part along 270 deg is unique: 83.3333 N' in lines
    assert any(line.startswith('overconstrained: ') for line in lines)
    # With a pressure angle all is: the sun's pin bears its tooth, the planet's what turns the arm.
    lines = solve_scene(options_of('solve', 'planetary_gear', statics=True))
    assert not any(line.startswith('overconstrained: ') for line in lines)
    push, apart = 1 / 0.024, np.tan(np.radians(20)) / 0.024
    assert row(lines, 'sun_teeth')[:2] == pytest.approx([apart, push], rel=1e-5)
    assert row(lines, 'ring_teeth')[:2] == pytest.approx([-apart, push], rel=1e-5)
    assert row(lines, 'P')[:2] == pytest.approx([0, -2 * push], rel=1e-5)
    assert row(lines, 'O.sun')[:2] == pytest.approx([apart, push], rel=1e-5)


def test_right_in_a_dead_point_nothing_is_made_up(capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, 'antiparallelogram', '--at', '180 deg')
    assert 'a dead point of the loop O, A, B, C: the drivers do not determine the motion' in lines
    follower = next(line for line in lines if line.startswith('follower '))
    assert follower.split()[1:] == ['180', '-', '-', '-', '-']
    # Beside it rounding leaves rates, but no snap: 1e5 of it would be noise.
    lines = told(capsys, 'antiparallelogram', '--at', '180.006 deg')
    assert 'next to a change point: the missing rates would have no correct digits' in lines
    follower = next(line for line in lines if line.startswith('follower '))
    assert float(follower.split()[2]) == pytest.approx(188.495559 / 180 * np.pi / 3, rel=1e-4)
    assert follower.split()[-1] == '-'


@pytest.mark.parametrize('scene', scene_names())
def test_every_scene_is_solved_at_its_start(
    scene: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = told(capsys, scene, '--centers', '--csv', str(tmp_path / 'one.csv'))
    assert lines[0].startswith(f'{scene}: ')
    table = columns(tmp_path / 'one.csv')
    assert all(len(values) == 1 for values in table.values())


def test_the_table_holds_forces_over_the_whole_range(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    told(capsys, 'bike_suspension', '--sweep', '--statics', '--csv', str(tmp_path / 'b.csv'))
    table = columns(tmp_path / 'b.csv')
    force = np.hypot(table['spring_force_x'], table['spring_force_y'])
    known = np.isfinite(force)
    assert known.sum() > 300
    np.testing.assert_allclose(force[known], np.abs(table['spring_effort'][known]), rtol=1e-9)


def test_the_table_holds_centers_where_they_are_and_only_if_asked_for(tmp_path: Path) -> None:
    table = tmp_path / 'c.csv'
    lines = solve_scene(options_of('solve', 'slider_crank', sweep=True, csv=table))
    assert not [line for line in lines if line.startswith('instant centers')]
    assert not [name for name in columns(table) if name.startswith('center_')]
    lines = solve_scene(options_of('solve', 'slider_crank', sweep=True, centers=True, csv=table))
    assert 'instant centers at the start of the range' in lines
    found = columns(table)
    # Empty is unknown.
    assert not re.search(r'\b(inf|nan)\b', table.read_text())
    # The rod turns about the point on the crank's line that is above the piston, wherever that is.
    x, y = found['center_ground_rod_x'], found['center_ground_rod_y']
    known = np.isfinite(x)
    assert np.count_nonzero(~known) == 2  # the crank upright
    assert x[known] == pytest.approx(found['piston'][known])
    assert y[known] == pytest.approx((x * np.tan(found['crank']))[known])


@pytest.mark.parametrize(
    ('driver', 'ends', 'rate'),
    [
        ('{drive: arm, rate: 2}', (0, 2 * np.pi), 2),
        # At rest when it starts: as fast as one unit per second.
        ('{drive: arm, from: 0.5, to: 1, duration: 2}', (0.5, 0.5 + 2 * np.pi), 1),
    ],
)
def test_a_lone_arm_is_swept_by_a_full_turn(
    driver: str, ends: tuple[float, float], rate: float, tmp_path: Path
) -> None:
    path, table = tmp_path / 'arm.yaml', tmp_path / 'arm.csv'
    path.write_text(
        f'bodies: {{ground: {{O: [0, 0]}}, arm: {{O: [0, 0], A: [0.1, 0]}}}}\ndrivers: [{driver}]\n'
    )
    lines = solve_scene(options_of('solve', path, sweep=True, csv=table))
    assert not any('limit' in line for line in lines)
    found = columns(table)
    assert found['arm'][[0, -1]] == pytest.approx(ends)
    assert found['arm_angle_velocity'] == pytest.approx(rate)


def test_efforts_are_told_load_by_load_or_as_a_torque_on_a_body(tmp_path: Path) -> None:
    path = tmp_path / 'held.yaml'
    four_bar = (scenes_folder() / 'four_bar.yaml').read_text()
    loads = 'loads:\n  - {force: [0, -50], at: coupler.P}\n'

    def statics(rest: str, at: str | None = None) -> list[str]:
        path.write_text(four_bar + loads + rest)
        return solve_scene(options_of('solve', path, at=at, sweep=at is None, statics=True))

    one, two = statics(''), statics('  - {torque: 2, on: rocker}\n')
    assert 'forces at the start of the range' in one
    assert not any(line.startswith('  of this, load by load: ') for line in one)
    (shares,) = [line for line in two if line.startswith('  of this, load by load: ')]
    (whole,) = [line for line in two if 'crank balances the loads with' in line]
    parts = [float(part) for part in re.findall(r'-?[\d.]+', shares)]
    assert len(parts) == 2
    assert sum(parts) == pytest.approx(float(whole.split()[-3]), rel=1e-4)
    assert whole.endswith(' N m') and shares.endswith(' N m')
    # On the driven body itself it is the driver's effort.
    (held,) = [line for line in statics('held_by: {on: crank}\n') if ' balance the loads' in line]
    assert held.endswith(' N m on crank balance the loads, with crank free')
    (driven,) = [line for line in one if 'crank balances the loads with' in line]
    assert float(held.split()[0]) == pytest.approx(float(driven.split()[-3]))


def test_springs_and_inertia_are_in_the_statics(tmp_path: Path) -> None:
    table = tmp_path / 's.csv'
    lines = solve_scene(options_of('solve', 'slider_crank', at='50 deg', statics=True, csv=table))
    (whole,) = [line for line in lines if line.startswith('crank balances the loads with ')]
    (shares,) = [line for line in lines if line.startswith('  of this, springs: ')]
    spring, inertia = map(float, re.findall(r': (\S+?)[; ]', shares))
    assert float(whole.split()[-3]) == pytest.approx(spring + inertia, rel=1e-4)
    found = columns(table)
    # 0.2 N/mm, pulled out from 20 cm: the power of the spring, and what it costs the crank.
    pull = 200 * (found['piston'] - 0.2)
    assert spring == pytest.approx((pull * found['piston_velocity'] / (2 * np.pi))[0], rel=1e-5)
    assert found['crank_effort'] == pytest.approx(spring + inertia, rel=1e-4)


# The loader of loader_cylinder as bodies and joints: what its vectors r2 to r5 are.
LOADER = """
bodies:
  ground: {O: [0, 0], C: 219.702258 cm @ -0.0777 deg, S: 42 cm @ 135 deg}
  arm:  {O: [0, 0], A: [141 cm, 0]}
  lift: {A: [0, 0], B: [120 cm, 0], P: 200 cm @ 135 deg, E: 80 cm @ 120 deg}
  link: {C: [0, 0], B: [100 cm, 0]}
joints: [{strut: [lift.E, ground.S], name: r5}]
drivers: [{drive: r5, mean: 165 cm, amplitude: 15 cm, frequency: 0.25 Hz}]
start: {arm: 45 deg, lift: 0 deg, link: 90 deg}
loads: [{weight: 1000 kg, at: lift.P}]
"""


def test_vectors_bear_what_the_same_bodies_and_joints_bear(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Example 4 of seed 003. A joint r2-r3 has the force of r3 on r2."""
    vectors, bodies = tmp_path / 'v.csv', tmp_path / 'b.csv'
    path = tmp_path / 'loader.yaml'
    path.write_text(LOADER)
    lines = told(capsys, 'loader_cylinder', '--statics', '--sweep', '--csv', str(vectors))
    assert not any('no joints' in line for line in lines)
    told(capsys, str(path), '--statics', '--sweep', '--csv', str(bodies))
    found, exact = columns(vectors), columns(bodies)
    names = {'r2-ground': ('O', 1), 'r2-r3': ('A', -1), 'r3-r4': ('B', -1), 'r4-ground': ('C', 1)}
    for name, (same, sign) in (names | {'r5': ('r5', 1)}).items():
        for axis in 'xy':
            np.testing.assert_allclose(
                found[f'{name}_force_{axis}'], sign * exact[f'{same}_force_{axis}'], rtol=1e-6
            )
    np.testing.assert_allclose(found['r5.length_effort'], exact['r5_effort'], rtol=1e-6)
    # The force along the cylinder, and nothing across it, is the effort.
    force = np.hypot(found['r5_force_x'], found['r5_force_y'])
    np.testing.assert_allclose(force, np.abs(found['r5.length_effort']), rtol=1e-9)


def test_a_vector_of_free_length_on_a_line_is_a_slide(tmp_path: Path) -> None:
    path = tmp_path / 'crank.yaml'
    path.write_text("""
vectors:
  r1: {length: unknown, angle: 0 deg}
  r2: {length: 10 cm, angle: unknown}
  r3: {length: 30 cm, angle: unknown}
loops: [r2 + r3 - r1]
points: {B: r2 + r3}
drivers: [{drive: r2.angle, rate: 1 rev/s, start: 30 deg}]
start: {r3.angle: -10 deg, r1.length: 0.38}
loads: [{force: [-100, 0], at: B}]
""")
    scene = load_scene(path)
    solved = over_time(scene, np.zeros(1))
    forces = reactions(scene, solved.values, scene.loads)
    found = dict(zip(forces.joints, forces.force[:, 0], strict=True))
    # The rod is a two-force member, at asin(1/6).
    assert found['r3-ground'] == pytest.approx(100j * np.tan(np.arcsin(1 / 6)))
    assert found['r2-r3'] == pytest.approx(-100 * (1 - 1j * np.tan(np.arcsin(1 / 6))))


def test_the_reactions_of_a_vector_scene_hold_it_with_its_power(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = told(capsys, 'loader_loop', '--statics', '--csv', str(tmp_path / 'l.csv'))
    assert any('balances the loads' in line for line in lines)
    assert np.isfinite(columns(tmp_path / 'l.csv')['r2.angle_effort']).all()
    # The weight is borne by both pins of the ground.
    assert row(lines, 'r2-ground')[1] + row(lines, 'r4-ground')[1] == pytest.approx(9806.65)


def test_the_picture_is_one(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    one = ['--csv', str(tmp_path / 'one.csv')]
    lines = told(capsys, 'four_bar', '--centers', '--plot', str(tmp_path / 'four_bar.png'), *one)
    # It has the whole range; what is printed and tabulated has not.
    assert 'instant centers' in lines
    assert len(columns(tmp_path / 'one.csv')['crank']) == 1
    image = pytest.importorskip('matplotlib.image').imread(tmp_path / 'four_bar.png')
    assert image.shape[0] > 800
    assert image.shape[1] > 1500
    assert (image[..., :3] < 0.5).any()


def figure_of(monkeypatch: pytest.MonkeyPatch, **asked: Any) -> Any:
    """The figure that a picture is made of."""
    figures = pytest.importorskip('matplotlib.figure')
    made = []
    monkeypatch.setattr(figures.Figure, 'savefig', lambda figure, *_, **__: made.append(figure))
    scene = asked.pop('scene')
    solve_scene(options_of('solve', scene, **asked))
    return made[0]


def test_only_the_centrodes_asked_for_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = tmp_path / 'a.png'
    bare = figure_of(monkeypatch, scene='four_bar', plot=picture)
    asked = figure_of(monkeypatch, scene='four_bar', plot=picture, centrodes=['coupler'])
    few, more = (figure.axes[0].lines for figure in (bare, asked))
    assert len(more) == len(few) + 2
    fixed = next(line for line in more if line.get_linewidth() == 4)
    icr = poles(
        load_scene('four_bar').mechanism,
        over_range(load_scene('four_bar'), 361).motion,
    ).icr[1]
    seen = fixed.get_xdata() + 1j * fixed.get_ydata()
    np.testing.assert_allclose(seen[np.isfinite(seen)], icr[np.isfinite(seen)])
    with pytest.raises(SceneError, match='no moving body wheel; give some of crank, coupler'):
        solve_scene(options_of('solve', 'four_bar', plot=picture, centrodes=['wheel']))


def test_only_the_curvature_asked_for_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And of a rod of Cardan, whose points on the axes move straight, no circles without end."""
    picture = tmp_path / 'a.png'
    bare = figure_of(monkeypatch, scene='cardan', plot=picture)
    figure = figure_of(monkeypatch, scene='cardan', plot=picture, inflection=['rod'])
    added = {*figure.axes[0].patches}
    assert not bare.axes[0].patches
    rod = load_scene('cardan').motion(0.0)['rod']
    (circle,) = (patch for patch in added if patch.get_linestyle() == '--')
    assert complex(*circle.get_center()) == pytest.approx(complex(rod.position[0]), abs=1e-12)
    assert all(patch.get_radius() < 100 for patch in added)
    with pytest.raises(SceneError, match='--inflection: there is no moving body wheel'):
        solve_scene(options_of('solve', 'four_bar', plot=picture, inflection=['wheel']))


def test_axes_do_not_show_rounding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = figure_of(monkeypatch, scene='cardan', plot=tmp_path / 'a.png')
    _, rate, acceleration = figure.axes
    low, high = rate.get_ylim()
    assert high - low > 1 and low < 2 * np.pi < high
    assert acceleration.get_ylim() == (-0.2, 0.2)


def test_the_page_has_the_motion_that_is_solved(tmp_path: Path) -> None:
    page = tmp_path / 'a.html'
    solve_scene(options_of('solve', 'double_pendulum', time='1', html=page))
    data = data_of(page)
    exact = load_scene('double_pendulum').motion(np.array(data['t']))['lower']
    (lower,) = [body for body in data['bodies'] if body['name'] == 'lower']
    np.testing.assert_allclose(lower['x'], exact.position[0].real, atol=1e-4)
    np.testing.assert_allclose(lower['angular_velocity']['value'], exact.angle[1], atol=1e-3)
    assert set(lower['angular_velocity']['sigma']) == {None}
    assert {tuple(joint['bodies']) for joint in data['joints']} == {('upper',), ('lower', 'upper')}
    # One driver: over its range, at the rate it is driven at; backward too.
    solve_scene(options_of('solve', 'rolling_wheel', html=page))
    data = data_of(page)
    assert data['t'][-1] == pytest.approx(1.0)
    assert np.all(np.diff(data['bodies'][0]['angle']) < 0)
    # A wheel is a circle with a spoke.
    (wheel,) = [body for body in data['bodies'] if body['rims']]
    assert wheel['rims'] == [[0.0, 0.0, 0.1]]
    assert [0.0, 0.0] in wheel['outlines'][0][1] and [0.1, 0.0] in wheel['outlines'][0][1]


def test_the_page_says_why_a_pole_does_not_exist(tmp_path: Path) -> None:
    page, scene = tmp_path / 'a.html', tmp_path / 'geneva.yaml'
    bodies = {
        'ground': {'O': [0, 0], 'W': [0.1, 0]},
        'crank': {'O': [0, 0]},
        'wheel': {'W': [0, 0]},
    }
    joints = [{'geneva': 'wheel.W', 'on': 'crank.O', 'slots': 4}]
    drivers = [{'drive': 'crank', 'rate': 2.0}]
    scene.write_text(json.dumps({'bodies': bodies, 'joints': joints, 'drivers': drivers}))
    solve_scene(options_of('solve', scene, html=page))
    driven, dwelling = data_of(page)['bodies']
    assert {why for _, _, why in driven['withheld']['icr']} == set()
    assert {why for _, _, why in driven['withheld']['centrode_curvature']} == {
        'the ICR stands still'
    }
    assert {why for _, _, why in dwelling['withheld']['icr']} == {'at rest'}
    # The rod of a slider-crank translates for an instant when the crank is at a right angle.
    solve_scene(options_of('solve', 'slider_crank', html=page))
    (rod,) = [body for body in data_of(page)['bodies'] if body['name'] == 'rod']
    assert {why for _, _, why in rod['withheld']['icr']} == {'at infinity'}


@pytest.mark.parametrize(('at', 'mark'), [('10.5 deg', 370.5), ('45.5 deg', 45.5)])
def test_the_picture_shows_the_position_asked_for(
    at: str, mark: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Neither is among the positions of the range, 30 to 390 deg in steps of one.
    figures = pytest.importorskip('matplotlib.figure')
    made = []
    monkeypatch.setattr(figures.Figure, 'savefig', lambda figure, *_, **__: made.append(figure))
    solve_scene(options_of('solve', 'slider_crank', at=at, plot=tmp_path / 'crank.png'))
    linkage, rates, _ = made[0].axes
    crank = next(line for line in linkage.lines if line.get_zorder() == 3)
    angle = np.radians(float(at.split()[0]))
    np.testing.assert_allclose(crank.get_xdata(), [0, 0.1 * np.cos(angle)], atol=1e-15)
    np.testing.assert_allclose(crank.get_ydata(), [0, 0.1 * np.sin(angle)], atol=1e-15)
    assert [*rates.lines][-1].get_xdata()[0] == pytest.approx(mark)
    assert f'crank (deg) = {at.split()[0]}' in title_of(made[0])


def test_a_slide_driven_steadily_is_swept_as_far_as_the_linkage_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'pressed.yaml'
    told = (scenes_folder() / 'slider_crank.yaml').read_text()
    steady = '{drive: piston, rate: 1 cm/s, start: 0.3}\nstart: {crank: 80 deg, rod: -20 deg}'
    path.write_text(re.sub(r'\{drive: .*\}', steady, told))
    assert cli.main(['solve', str(path), '--sweep']) == 0
    assert 'piston from 0.2 m (limit) to 0.4 m (limit)' in capsys.readouterr().out
    path.write_text(
        'bodies: {ground: {O: [0, 0]}, block: {A: [0, 0]}}\n'
        'joints: [{prismatic: block.A, on: ground.O, along: 0, name: guide}]\n'
        'drivers: [{drive: guide, rate: 1 cm/s}]\n'
    )
    assert cli.main(['solve', str(path), '--sweep']) == 2
    assert (
        'the driver guide has no limits, so it has no range; give --time' in capsys.readouterr().err
    )


def test_two_columns_of_one_name_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table = tmp_path / 'names.yaml', tmp_path / 'names.csv'
    path.write_text(
        'bodies: {ground: {O: [0, 0]}, arm: {O: [0, 0], a: [0.1, 0]}, arm_a: {a: [0.02, 0]}}\n'
        'drivers: [{drive: arm, rate: 1}, {drive: arm_a, rate: 2}]\n'
    )
    assert cli.main(['solve', str(path), '--csv', str(table)]) == 2
    assert "two columns would be called 'arm_a_x'" in capsys.readouterr().err
    assert not table.exists()


def test_centers_are_called_alike_in_the_table_and_the_deduction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A chain of ten, so that I1,11 is not I11,1.
    path = tmp_path / 'chain.yaml'
    links = ''.join(f'  b{k}: {{P{k}: [0, 0], P{k + 1}: [0.1, 0]}}\n' for k in range(10))
    rates = ''.join(f'  - {{drive: b{k}, rate: {k + 1}}}\n' for k in range(10))
    path.write_text(f'bodies:\n  ground: {{P0: [0, 0]}}\n{links}drivers:\n{rates}')
    assert cli.main(['solve', str(path), '--centers']) == 0
    table, deduced = capsys.readouterr().out.split('center  of')[1].split('1 ground')
    deduced = deduced.split('\n\n')[0]
    names = {line.split()[0] for line in table.splitlines()[1:] if line}
    assert names == {line.split(':')[0] for line in deduced.splitlines()[1:]}
    assert 'I1,11' in names


def test_the_circles_that_gears_roll_on_are_drawn() -> None:
    solved = over_time(load_scene('planetary_gear'), np.zeros(1))
    # The planet with its spoke, sun and ring: their radii about their centers.
    lines = _shapes.SceneLines(solved).at(solved)
    radii = {np.round(np.ptp(line.points.real) / 2, 9) for line in lines if line.kind == 'wheel'}
    assert radii == {0.012, 0.024, 0.048}


def test_a_cylinder_ends_at_its_points_and_its_barrel_keeps_its_length() -> None:
    motion = over_range(load_scene('pool_lift'), 19)
    drawn = _shapes.SceneLines(motion)
    arm = load_scene('pool_lift').points
    barrels = []
    for k in range(19):
        here = motion.at(k)
        box, tail, rod = (line.points for line in drawn.between_bodies(here))
        angle = here.motion.angle[0, 0, 0]
        assert tail[0] == pytest.approx(arm['ground.S'][1])
        assert rod[1] == pytest.approx(arm['arm.E'][1] * np.exp(1j * angle))
        barrels.append(abs(rod[0] - tail[0]))
        assert abs(rod[0] - tail[0]) < here.values[1, 0]
        assert np.isfinite(box).all()
    # Where the driver asks for it: from 17 inches on.
    long = [size for size, length in zip(barrels, motion.values[1], strict=True) if length > 0.432]
    np.testing.assert_allclose(long, 0.7 * 17 * 0.0254, rtol=1e-9)


@pytest.mark.parametrize('name', [*scene_names(), 'indexer'])
def test_all_that_a_page_draws_has_an_end_on_a_body_or_on_the_ground(
    name: str, tmp_path: Path
) -> None:
    if name == 'indexer':
        blocks = re.findall(r'```yaml\n(.*?)```', SCENES_PAGE.read_text(encoding='utf-8'), re.S)
        path = tmp_path / 'indexer.yaml'
        path.write_text(next(block for block in blocks if block.startswith('# indexer')))
    scene = load_scene(path if name == 'indexer' else name)
    data = _shapes.drawn_data(over_full_motion(scene, 37))
    bodies = {*scene.mechanism.bodies, ''}
    assert all(shape['body'] in bodies for shape in data['shapes'])
    ends = [end for span in data['spans'] for end in span['ends']]
    assert all(end['body'] in bodies for end in ends)
    spans = {'pool_lift': 1, 'bike_suspension': 1, 'loader_cylinder': 1, 'slider_crank': 1}
    assert len(data['spans']) == spans.get(name, 0)
    assert len(data['belts']) == (name == 'indexer')
    if name == 'indexer':
        # The wheel; of the crank the disk, the arm and the pin; the way of the stamp.
        kinds = [(shape['kind'], shape['body']) for shape in data['shapes']]
        assert kinds == [
            ('guide', ''),
            ('contour', 'table'),
            *[('contour', 'crank')] * 3,
        ]


def test_letters_on_lines_can_be_read() -> None:
    figures = pytest.importorskip('matplotlib.figure')
    axis = figures.Figure().add_subplot()
    scene = load_scene('four_bar')
    _scene_picture.draw_linkage(
        axis, over_range(scene, 19), over_time(scene, np.zeros(1)), centers=True
    )
    letters = [text for text in axis.texts if text.get_text()]
    assert {'crank', 'coupler', 'rocker', 'I12'} <= {text.get_text() for text in letters}
    assert all(text.get_path_effects() for text in letters)


def test_pitch_curves_are_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = told(
        capsys, 'elliptic_gears', '--pitch', 'crank', 'follower', str(tmp_path / 'gears.svg')
    )
    assert 'roll on each other' in lines[-1]
    drawing = ET.parse(tmp_path / 'gears.svg').getroot()
    assert drawing.tag.endswith('svg')
    # Both are closed ellipses with the pins for foci.
    curves = [
        np.array([[float(x) for x in pair.split()] for pair in path.get('d', '')[2:-2].split('L')])
        for path in drawing.iter('{http://www.w3.org/2000/svg}path')
        if path.get('d', '').endswith('Z')
    ]
    assert len(curves) == 2
    for curve, foci in zip(curves, ((0.0, 200.0), (0.0, 200.0)), strict=True):
        sums = sum(np.hypot(*(curve - [focus, 0]).T) for focus in foci)
        np.testing.assert_allclose(sums, 400.0, atol=1e-3)


@pytest.mark.parametrize(
    ('words', 'says'),
    [
        (('nowhere',), 'no such scene'),
        (('four_bar', '--at', '3 furlongs'), 'unit'),
        (('four_bar', '--at', 'nan'), 'finite'),
        (('double_pendulum', '--sweep'), '2 drivers, and --sweep needs one; give --time'),
        (('double_pendulum', '--time', '0'), 'greater than 0'),
        (('double_pendulum', '--time', '2 m'), 'unit'),
        (('six_bar', '--statics'), 'no loads'),
        (('loader_cylinder', '--at', '5 m'), 'to r5.length = 5 m, it turns back at 2.35533988 m: '),
        (('loader', '--at', '500 deg'), 'to arm = 500 deg, it turns back at 71.333396 deg: '),
        (('four_bar', '--csv', 'x.csv', '--pitch', 'crank', 'wheel', 'x.svg'), 'no body wheel'),
        (('four_bar', '--csv', 'x.csv', '--pitch', 'crank', 'rocker', 'x.pdf'), 'or .dxf'),
        (('four_bar', '--plot', '/dev/null/x.png'), 'x.png'),
        (('four_bar', '--plot', 'x.foo'), 'no picture'),
        (('four_bar', '--plot', 'x'), 'no picture'),
    ],
)
def test_what_cannot_be_solved_is_said_in_one_line(
    words: tuple[str, ...],
    says: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(['solve', *words]) == 2
    assert not [*tmp_path.iterdir()]
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1


def test_a_scene_of_any_name_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    scene = tmp_path / 'cost $5_$.yaml'
    scene.write_text((scenes_folder() / 'cardan.yaml').read_text())
    assert cli.main(['solve', str(scene), '--plot', str(tmp_path / 'out.png')]) == 0
    assert (tmp_path / 'out.png').read_bytes().startswith(b'\x89PNG')


# As printed with twelve digits, and with nine, which is a little beyond.
@pytest.mark.parametrize('at', ['71.3333959863 deg', '71.333396 deg'])
def test_at_a_limit_as_it_is_printed_no_rate_is_made_of_its_last_digit(at: str) -> None:
    lines = solve_scene(options_of('solve', 'loader', at=at, statics=True))
    assert any('a dead point of the loop O, A, B, C' in line for line in lines)
    assert next(line for line in lines if line.startswith('lift ')).split()[2:] == ['-'] * 4
    assert 'not determined: in a dead point the drivers do not move the loads' in lines
    near = solve_scene(options_of('solve', 'loader', at='71.3333 deg'))
    assert float(next(line for line in near if line.startswith('lift ')).split()[2]) < -100


def test_a_position_at_the_very_limit_spoils_none_before_it() -> None:
    """A series at the limit reaches nowhere: positions beside it are found from another."""
    mechanism = load_scene('loader').mechanism
    limit = over_range(load_scene('loader'), 3).limits[1]
    assert limit is not None
    there = mechanism.sweep(np.array([limit - 1e-12])).values[0, :, 0]
    for left in (1e-5, 1e-7, 1e-9):
        found = mechanism.sweep(np.array([limit - left])).values[0, :, 0]
        # Beside a limit all goes as the root of what is left to it.
        assert 0.5 < np.abs(found - there).max() / np.sqrt(left) < 4


@pytest.mark.parametrize(
    'words',
    [
        '--centrodes coupler rocker four_bar --plot a.png',
        '--plot a.png --centrodes coupler rocker four_bar',
        'four_bar --plot a.png --centrodes coupler rocker',
        '--sweep --centrodes coupler rocker four_bar --plot a.png',
        '--pitch crank rocker a.svg --centrodes coupler rocker --plot a.png four_bar',
    ],
)
def test_the_bodies_after_centrodes_may_stand_before_or_after_the_scene(
    monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    taken: list[Namespace] = []
    monkeypatch.setattr('kinpole_ros.tools.solve.solve_scene', lambda o: taken.append(o) or [])
    assert cli.main(['solve', *words.split()]) == 0
    assert (taken[0].scene, taken[0].centrodes) == ('four_bar', ['coupler', 'rocker'])


@pytest.mark.parametrize('name', scene_names())
def test_virtual_work_step_by_step_gives_the_statics(name: str) -> None:
    """Each number that `--work` comes to is that of `--statics`."""
    scene = load_scene(name)
    here = over_time(scene, np.zeros(1))
    loads = acting_loads(here).loads
    if not loads:
        with pytest.raises(SceneError, match='has no loads'):
            solve_scene(options_of('solve', name, work=True))
        return
    lines = work_lines(here)
    if scene.held_by:
        size, holder = holding(scene.mechanism, here.values, loads, scene.held_by)
        loads = [*loads, holder]
        truth = size
    else:
        truth = Statics(scene.mechanism, here.values, loads).effort[:, 0]
    found = [re.search(r'= (-?[\d.e+-]+) N( m)?$', line) for line in lines]
    assert [float(one[1]) for one in found if one] == pytest.approx(truth, rel=1e-8)
    # The shares add up to it, and it does the power that the loads do not.
    sums = [float(line.split()[1]) for line in lines if line.startswith('sum ')]
    assert sums == pytest.approx(truth, rel=1e-5)
    for power, rate, size in zip(
        *(re.findall(words, '\n'.join(lines)) for words in (r'(\S+) W \+', r'· (\S+) \S+ = 0')),
        truth,
        strict=True,
    ):
        assert float(power) + float(rate) * size == pytest.approx(0, abs=1e-8 * abs(float(power)))
    if not scene.mechanism.assembly.joints:
        assert lines[-1].startswith('r4-ground')
        return
    borne = Statics(scene.mechanism, here.values, loads)
    rows = [line.split() for line in lines if re.search(r' (deg|turning) .* N( m)?$', line)]
    assert rows
    least = 1e-5 * float(np.abs(borne.force).max())
    for joint, *cells in rows:
        j = borne.joints.index(joint)
        if cells[0] == 'turning':
            assert float(cells[-3]) == pytest.approx(borne.moment[j, 0], abs=least)
            continue
        way = np.exp(1j * np.radians(float(cells[0])))
        along = float((borne.force[j, 0] * way.conjugate()).real)
        assert float(cells[-2]) == pytest.approx(along, rel=1e-5, abs=least)
        powers = np.array(cells[2:-2], float)
        assert -powers.sum() == pytest.approx(float(cells[-2]), rel=1e-4, abs=least)


def test_advantages_of_the_work_are_loads_over_their_shares() -> None:
    """Seed 003: the loader lifts 9806.65 N with 21300 N m; the advantage is their ratio."""
    lines = solve_scene(options_of('solve', 'loader', at='45 deg', work=True))
    row = next(line for line in reversed(lines) if line.startswith('1 load, force at lift.P'))
    share, gain = map(float, row.split()[-2:])
    assert share == pytest.approx(1000 * 9.80665 * 1.08601 / 0.5, rel=1e-5)
    assert gain == pytest.approx(1000 * 9.80665 / share, rel=1e-5)
    (row,) = [line for line in lines if line.startswith('the force at lift.P')]
    assert float(row.split()[4]) == pytest.approx(gain, rel=1e-5)
    # A toggle: the load stands still, so no effort holds it.
    lines = solve_scene(options_of('solve', 'slider_crank', work=True))
    (row,) = [
        line for line in lines if line.startswith('2 inertia, force at crank  ') and 'inf' in line
    ]
    assert row.split()[-2:] == ['0', 'infinite']


def test_the_page_has_the_virtual_work(tmp_path: Path) -> None:
    for name in ('loader', 'four_bar'):
        page = tmp_path / f'{name}.html'
        lines = solve_scene(options_of('solve', name, html=page, work=name == 'loader'))
        work = data_of(page)['work']
        assert set(work) <= set(lines) and bool(work) == (name == 'loader')


def test_the_work_of_several_drivers_and_at_a_limit(tmp_path: Path) -> None:
    scene = tmp_path / 'arm.yaml'
    scene.write_text(scene_text('double_pendulum') + 'loads: [{weight: 2 kg, at: lower.P}]\n')
    lines = solve_scene(options_of('solve', scene, time='0.3', work=True))
    solved = over_time(load_scene(scene), np.array([0.3]))
    truth = Statics(solved.scene.mechanism, solved.values, solved.scene.loads).effort[:, 0]
    found = [float(line.split()[-3]) for line in lines if re.match('the effort of .* = ', line)]
    assert found == pytest.approx(truth, rel=1e-6)
    assert sum('the other drivers held' in line for line in lines) == 2
    lines = solve_scene(options_of('solve', 'loader_cylinder', at='0.920227378 m', work=True))
    assert lines[-1] == 'virtual work: in a dead point the drivers do not move the loads'
