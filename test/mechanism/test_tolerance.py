"""`kinpole tolerance`: errors of dimensions against closed forms and linkages solved at random."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import data_of, options_of

from kinpole_ros.mechanism import (
    LinkageError,
    SceneError,
    _dimension_errors,
    load_scene,
    transmission_angles,
)
from kinpole_ros.mechanism._dimension_errors import (
    ToleranceSpread,
    propagate_tolerances,
    tolerances_of,
)
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve import tolerances


def spread_of(
    name: str,
    at: np.ndarray,
    deviations: dict[str, float],
    play: dict[str, float] | None = None,
    samples: int = 0,
) -> ToleranceSpread:
    """Of a scene at values of its driver, which moves at 1."""
    scene = load_scene(name)
    values = scene.mechanism.sweep(at).values[0]
    errors = tolerances_of(scene, deviations, play or {})
    return propagate_tolerances(scene, errors, values, np.ones((1, len(at))), samples)


def test_linkages_solved_together_are_those_solved_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a four-bar with play, and of wheels, whose radii tie their angles."""
    for name, play in (('four_bar', {'B': 5e-5}), ('rolling_wheel', {}), ('loader_loop', {})):
        at = np.linspace(0.1, 0.9, 5)
        found = spread_of(name, at, {'length': 1e-4, 'angle': 1e-3}, play, 7)
        with monkeypatch.context() as alone:
            alone.setattr(_dimension_errors, '_MOST_POSITIONS', 0)
            single = spread_of(name, at, {'length': 1e-4, 'angle': 1e-3}, play, 7)
        np.testing.assert_allclose(found.samples, single.samples, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.parts, single.parts, rtol=1e-7, atol=1e-12)


def quantity(found: ToleranceSpread, name: str, what: str) -> int:
    return found.names.index((name, what))


def test_a_coupler_too_long_turns_the_rocker_by_the_transmission_angle() -> None:
    """Along the coupler the rocker's end goes by the error: over its length and that sine."""
    at = np.linspace(0, 6, 13)
    found = spread_of('four_bar', at, {'coupler.B': 1e-6})
    scene = load_scene('four_bar')
    values = scene.mechanism.sweep(at).values[0]
    (angle,) = transmission_angles(scene.mechanism, values).values()
    rocker = np.abs(found.parts[0, quantity(found, 'rocker', 'angle')])
    np.testing.assert_allclose(rocker, 1e-6 / (0.28 * np.sin(angle)), rtol=1e-4)
    # An error across it only turns the coupler's frame.
    assert np.abs(found.parts[1, quantity(found, 'rocker', 'angle')]).max() < 1e-10


def test_first_order_is_as_linkages_at_random_are() -> None:
    """Of the coupler point of the four-bar; with 10,000 samples they agree to 1.3%."""
    at = np.linspace(0, 6, 7)
    found = spread_of('four_bar', at, {'length': 1e-4}, {'B': 5e-5}, 3000)
    off = found.samples - found.value
    for what in 'xy':
        q = quantity(found, 'coupler.P', what)
        sampled = off[:, q].std(axis=0, ddof=1)
        np.testing.assert_allclose(found.deviation[q], sampled, rtol=0.04)
        low, high = np.percentile(off[:, q], [2.5, 97.5], axis=0)
        np.testing.assert_allclose(high - low, 2 * 1.96 * found.deviation[q], rtol=0.06)
    for name in ('coupler', 'rocker'):
        q = quantity(found, name, 'angle')
        np.testing.assert_allclose(found.deviation[q], off[:, q].std(axis=0, ddof=1), rtol=0.04)


def test_play_is_anywhere_in_a_circle() -> None:
    found = spread_of('four_bar', np.array([0.5]), {}, {'A': 1e-4}, 600)
    # The pin of crank and coupler, as the coupler has it, is off the crank's.
    x, y = (found.samples[:, quantity(found, 'coupler.A', c), 0] for c in 'xy')
    crank = [found.samples[:, quantity(found, 'crank.A', c), 0] for c in 'xy']
    # The coupler's hole is where the crank's pin is: its frame moves by the play.
    assert np.abs(x - crank[0]).max() < 1e-12 and np.abs(y - crank[1]).max() < 1e-12
    reach = np.hypot(
        *(
            found.samples[:, quantity(found, 'coupler.P', c), 0]
            - found.value[quantity(found, 'coupler.P', c), 0]
            for c in 'xy'
        )
    )
    assert 1e-5 < reach.max() < 4e-4
    parts = found.deviation[quantity(found, 'coupler.P', 'x')]
    sampled = found.samples[:, quantity(found, 'coupler.P', 'x')].std(axis=0, ddof=1)
    np.testing.assert_allclose(parts, sampled, rtol=0.05)


def test_play_of_a_slot_lifts_the_slider_off_its_line() -> None:
    at = np.array([0.7])
    found = spread_of('slider_crank', at, {}, {'piston': 1e-4}, 600)
    q = quantity(found, 'rod.B', 'y')
    off = found.samples[:, q, 0] - found.value[q, 0]
    assert 0.99e-4 < np.abs(off).max() <= 1e-4 * (1 + 1e-9)
    np.testing.assert_allclose(found.deviation[q], 1e-4 / np.sqrt(3), rtol=1e-6)
    np.testing.assert_allclose(found.deviation[q], off.std(ddof=1), rtol=0.05)
    # By the rod: across it goes what is along the line over the sine of its angle.
    rod = found.value[quantity(found, 'rod', 'angle'), 0]
    along = np.abs(found.parts[0, quantity(found, 'rod.B', 'x'), 0])
    np.testing.assert_allclose(along, 1e-4 / np.sqrt(3) * np.abs(np.tan(rod)), rtol=1e-4)


def test_backlash_of_gears_turns_the_arm_by_the_lever_of_both_contacts() -> None:
    """By 24 mm sun and 48 mm ring: the sun's teeth move the arm by 1 / 72 mm, the planet by -3."""
    found = spread_of('planetary_gear', np.array([0.7]), {}, {'sun_teeth': 3e-4}, 500)
    for body, rate in (('arm', 1 / 0.072), ('planet', 3 / 0.072)):
        q = quantity(found, body, 'angle')
        np.testing.assert_allclose(found.deviation[q], 3e-4 / np.sqrt(3) * rate, rtol=1e-6)
        off = np.abs(found.samples[:, q, 0] - found.value[q, 0])
        assert off.max() <= 3e-4 * rate * (1 + 1e-6)


def test_vectors_and_slides_have_errors_too() -> None:
    scene = load_scene('cardan')
    # The rod's two guides: one turned by 1 mrad moves the rod's end across by its way.
    found = spread_of('cardan', np.array([0.4]), {'A.along': 1e-3})
    place = found.value[quantity(found, 'rod.A', 'y')]
    moved = np.abs(found.parts[0, quantity(found, 'rod.A', 'x')])
    np.testing.assert_allclose(moved, 1e-3 * np.abs(place), rtol=1e-3)
    assert len(tolerances_of(scene, {'angle': 1e-3}, {})) == 2
    loop = spread_of(
        'loader_loop', np.radians([40.0, 50.0]), {'r3p.angle': 1e-3, 'r3p.length': 1e-3}
    )
    # P turns about the end of r2, and goes along r3p.
    for part, size in ((0, 2e-3), (1, 1e-3)):
        moved = [loop.parts[part, quantity(loop, 'P', c)] for c in 'xy']
        np.testing.assert_allclose(np.hypot(*moved), size, rtol=1e-4)


def test_an_angle_that_the_scene_leaves_out_has_an_error_too(tmp_path: Path) -> None:
    """A guide is not turned unless the scene says so; a guide that tilts turns its block."""
    scene = tmp_path / 'guide.yaml'
    scene.write_text(
        'bodies: {ground: {O: [0, 0]}, crank: {O: [0, 0], A: [0.1, 0]},\n'
        '  rod: {A: [0, 0], B: [0.3, 0]}, block: {B: [0, 0]}}\n'
        'joints: [{prismatic: block.B, on: ground.O, along: 0 deg, name: piston}]\n'
        'drivers: [{drive: crank, rate: 1 rev/s, start: 30 deg}]\n'
    )
    found = spread_of(str(scene), np.array([0.7]), {'piston.turned': 1e-3})
    angle = quantity(found, 'block', 'angle')
    np.testing.assert_allclose(np.abs(found.parts[0, angle]), 1e-3, rtol=1e-9)


def test_the_command_prints_writes_and_draws(tmp_path: Path, capsys) -> None:
    files = {kind: tmp_path / f'a.{kind}' for kind in ('csv', 'png', 'html')}
    words = ['tolerance', '--tolerances', 'coupler.B=0.2mm', 'play:A=0.05 mm', 'four_bar']
    words += ['--samples', '20', '--csv', str(files['csv'])]
    words += ['--plot', str(files['png']), '--html', str(files['html'])]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert re.search(r'^play A x +0.025 +mm$', out, re.M)
    assert re.search(r'^coupler.P x +mm .* coupler.B ', out, re.M)
    with files['csv'].open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 121 and float(rows[0]['sigma_coupler_P_x']) > 0
    assert files['png'].read_bytes().startswith(b'\x89PNG')
    bodies = data_of(files['html'])['bodies']
    assert max(bodies[2]['angular_velocity']['sigma']) > 0


def test_what_fit_prints_is_taken(tmp_path: Path) -> None:
    file = tmp_path / 'fitted.txt'
    file.write_text(
        'coupler.B x  0.359993216 m, deviation 9.2e-06; the scene has 0.36, -6.78e-06\n'
        'coupler.B y  1e-06 m, deviation 3e-06; the scene has 0, +1e-06\n'
        'chi^2/n 1.02 (n = 2466, 410 instants), with the scene as it is 1.05\n'
    )
    lines = tolerances(options_of('tolerance', 'four_bar', tolerances=[str(file)], samples=0))
    for axis, size in (('x', '0.0092'), ('y', '0.003')):
        assert any(line.split()[:3] == ['coupler.B', axis, size] for line in lines)
    assert not any('sampled' in line for line in lines)


@pytest.mark.parametrize(
    ('said', 'words'),
    [
        ('coupler.Q=1mm', 'coupler.Q is no dimension that joints use: give some of'),
        (
            'play:Q=1mm',
            'Q is no pin, slot or pair of gears, which alone have play: give some',
        ),
        ('coupler.B=1 deg', 'coupler.B=1 deg'),
        ('0.1', 'give 0.1mm, NAME=0.1mm'),
        ('nothing.txt', 'or a file with what `kinpole fit` printed'),
        ('coupler.B=0', 'no dimension has an error'),
    ],
)
def test_what_is_no_tolerance_is_said(said: str, words: str) -> None:
    with pytest.raises(SceneError, match=re.escape(words)):
        tolerances(options_of('tolerance', 'four_bar', tolerances=[said], samples=0))


def test_gears_are_refused_with_the_reason() -> None:
    with pytest.raises(
        LinkageError, match=r'arm\.O x cannot be off by itself: the loop .* never closes'
    ):
        tolerances(
            options_of('tolerance', 'planetary_gear', tolerances=['length=0.1mm'], samples=0)
        )


def test_a_value_without_a_name_is_of_all_lengths_or_angles() -> None:
    named = tolerances(
        options_of(
            'tolerance', 'slider_crank', tolerances=['length=0.1mm', 'angle=0.2deg'], samples=0
        )
    )
    assert (
        tolerances(
            options_of('tolerance', 'slider_crank', tolerances=['0.1mm', '0.2 deg'], samples=0)
        )
        == named
    )


RACK = """
bodies: {ground: {O: [0, 0], H: [0, 50 mm]}, wheel: {H: [0, 0]}, rack: {Q: [0, 0]}}
joints:
  - {prismatic: rack.Q, on: ground.O, along: 0 deg, name: guide}
  - {rolling: wheel.H, radius: 50 mm, on: rack.Q, along: 0 deg, name: mesh}
drivers: [{drive: wheel, rate: 1}]
"""


THREE_CRANKS = """
bodies:
  ground: {O: [0, 0], D: [0.15, 0], C: [0.4, 0]}
  one:    {O: [0, 0], A: [0.1, 0]}
  other:  {C: [0, 0], B: [0.1, 0]}
  third:  {D: [0, 0], E: [0.1, 0]}
  bar:    {A: [0, 0], E: [0.15, 0], B: [0.4, 0]}
drivers: [{drive: one, from: 40 deg, to: 80 deg, duration: 1}]
start: {other: 40 deg, third: 40 deg}
"""


def test_a_guided_rack_stays_in_mesh_with_its_wheel(tmp_path: Path) -> None:
    """Both hold the distance of the wheel, so that no loop closed, and the table was empty."""
    scene = load_scene(RACK)
    at = np.linspace(0.0, 1.0, 5)
    values = scene.mechanism.sweep(at).values[0]
    for joint, axis, still in (('guide', 'y', 'x'), ('mesh', 'x', 'y')):
        errors = tolerances_of(scene, {}, {joint: 1e-4})
        found = propagate_tolerances(scene, errors, values, np.ones((1, 5)), 50)
        off = found.deviation[quantity(found, 'rack.Q', axis)]
        np.testing.assert_allclose(off, 1e-4 / np.sqrt(3), rtol=1e-9)
        np.testing.assert_allclose(found.deviation[quantity(found, 'rack.Q', still)], 0, atol=1e-15)
        assert np.isfinite(found.samples[:, quantity(found, 'rack.Q', axis)]).all()
    path = tmp_path / 'rack.yaml'
    path.write_text(RACK)
    assert 'rack.Q y' in '\n'.join(tolerances(options_of('tolerance', str(path), samples=0)))


def test_an_error_with_which_no_loop_closes_is_refused(tmp_path: Path) -> None:
    scene = tmp_path / 'cranks.yaml'
    scene.write_text(THREE_CRANKS)
    with pytest.raises(LinkageError, match=r'bar\.E x cannot be off by itself: .* parallel cranks'):
        tolerances(options_of('tolerance', str(scene), tolerances=['bar.E=0.1mm'], samples=0))
    with pytest.raises(LinkageError, match=r'coupler\.B x is off by 1 m or rad, and the loops'):
        tolerances(options_of('tolerance', 'four_bar', tolerances=['coupler.B=1m'], samples=0))
