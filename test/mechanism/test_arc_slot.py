"""Slots along an arc: a pin or a block in one moves as on a link from the center of curvature."""

from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.mechanism import (
    GROUND,
    Scene,
    SceneError,
    Statics,
    instant_centers,
    load_scene,
    scene_text,
)
from kinpole_ros.mechanism._arc_slot import ArcSlot
from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._constraints import anchor_of, constraint_rows
from kinpole_ros.tools import cli

# The four-bar of config/scenes, with its rocker's pin B in a slot about C instead.
PIN = scene_text('four_bar').replace('  rocker:  {C: [0, 0], B: [0.28, 0]}\n', '').split('# In')[0]
PIN = PIN.replace(', rocker: 100 deg', '')
PIN = PIN.replace(
    'drivers:', 'joints:\n  - {slot: coupler.B, on: ground.C, circle: 28 cm, name: arc}\ndrivers:'
)
# With a block in the slot, whose x axis is at 30 deg to the radius.
BLOCK = scene_text('four_bar').split('# In')[0].replace('C: [0, 0], B: [0.28, 0]', 'B: [0, 0]')
BLOCK = BLOCK.replace('rocker: 100', 'rocker: 130').replace(
    'drivers:',
    'joints:\n  - {prismatic: rocker.B, on: ground.C, circle: 28 cm, turned: 30 deg, name: arc}\n'
    'drivers:',
)
LOADS = 'loads: [{force: [10, -20], at: coupler.P}]\n'


def solved(text: str) -> tuple[Scene, np.ndarray]:
    scene = load_scene(text)
    return scene, scene.mechanism.sweep(np.linspace(0.0, 2 * np.pi, 61)).values[0]


@pytest.mark.parametrize('text', [PIN, BLOCK])
def test_a_point_in_an_arc_slot_moves_as_on_a_link_to_snap(text: str) -> None:
    four_bar, arc = load_scene('four_bar').mechanism, load_scene(text).mechanism
    at = np.linspace(0.0, 2 * np.pi, 61)
    exact, motion = four_bar.sweep(at), arc.sweep(at)
    coupler = arc.bodies.index('coupler')
    for order in range(5):
        size = np.abs(exact.angle[order, 1]).max()
        np.testing.assert_allclose(
            motion.angle[order, coupler], exact.angle[order, 1], atol=1e-11 * size
        )
    if text == BLOCK:
        turned = np.where(np.arange(5) == 0, np.pi / 6, 0.0)[:, None]
        np.testing.assert_allclose(motion.angle[:, 2] - turned, exact.angle[:, 2], atol=1e-8)


def test_the_center_of_curvature_is_the_instant_center_of_a_block() -> None:
    scene, values = solved(BLOCK)
    centers = instant_centers(scene.mechanism, values)
    np.testing.assert_allclose(centers.points[centers.row(GROUND, 'rocker')], 0.4, atol=1e-12)
    four_bar = instant_centers(load_scene('four_bar').mechanism, solved_four_bar())
    row = centers.row(GROUND, 'coupler'), four_bar.row(GROUND, 'coupler')
    np.testing.assert_allclose(centers.places[:, row[0]], four_bar.places[:, row[1]], atol=1e-9)
    # A pin in the slot leaves its own center on the normal, which goes through that of curvature.
    pin, values = solved(PIN)
    of_pin = instant_centers(pin.mechanism, values)
    row = of_pin.row(GROUND, 'coupler'), row[1]
    np.testing.assert_allclose(of_pin.places[:, row[0]], four_bar.places[:, row[1]], atol=1e-9)


def solved_four_bar() -> np.ndarray:
    return np.asarray(solved(scene_text('four_bar'))[1])


@pytest.mark.parametrize('text', [PIN, BLOCK])
def test_an_arc_slot_bears_the_force_of_the_link(text: str) -> None:
    link, arc = (load_scene(one + LOADS) for one in (scene_text('four_bar'), text))
    forces = [
        Statics(scene.mechanism, scene.mechanism.sweep(np.array([1.0])).values[0], scene.loads)
        for scene in (link, arc)
    ]
    exact, found = (dict(zip(one.joints, one.force[:, 0], strict=True)) for one in forces)
    np.testing.assert_allclose(found['O'], exact['O'], rtol=1e-9)
    # On the coupler from the ground; the pin C has the force of the ground on the rocker.
    np.testing.assert_allclose(found['arc'], exact['C'], rtol=1e-9)
    np.testing.assert_allclose(forces[0].effort, forces[1].effort, rtol=1e-9)
    assert np.abs(forces[1].moment).max() < 1e-9


@pytest.mark.parametrize('text', [PIN, BLOCK])
def test_poses_of_an_arc_slot_meet_its_equations_and_slopes_are_differences(text: str) -> None:
    scene, values = solved(text)
    (joint,) = (one for one in scene.mechanism.assembly.joints if isinstance(one, ArcSlot))
    poses = poses_of(scene.mechanism.assembly, values)
    both = poses[joint.one], poses[joint.other]
    assert anchor_of(joint, *both) is None
    rows = constraint_rows(joint, *both)
    assert rows.value.shape[1] == (1 if text == PIN else 2)
    assert np.abs(rows.value).max() < 1e-12
    for k, name in enumerate(joint.sizes(), 10):
        step = 1e-6
        ends = [
            constraint_rows(joint.changed(**{name: getattr(joint, name) + s}), *both).value
            for s in (step, -step)
        ]
        np.testing.assert_allclose(rows.slope[:, :, k], (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_fit_finds_the_radius_of_an_arc_slot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    markers = scene_text('four_bar').split('markers:')[1].split('  rocker:')[0]
    scene, bag = tmp_path / 'arc.yaml', tmp_path / 'run.mcap'
    scene.write_text(f'{PIN}markers:{markers}')
    assert cli.main(['simulate', str(scene), '--duration', '1', '--output', str(bag)]) == 0
    wrong = tmp_path / 'wrong.yaml'
    wrong.write_text(scene.read_text().replace('28 cm', '27 cm'))
    assert cli.main(['fit', str(wrong), str(bag), '--free', 'arc.circle']) == 0
    (line,) = (one for one in capsys.readouterr().out.splitlines() if 'arc.circle' in one)
    assert '0.28' in line


@pytest.mark.parametrize(
    ('old', 'new', 'says'),
    [
        ('circle: 28 cm', 'circle: -28 cm', 'circle is '),
        ('circle: 28 cm', 'circle: 28 cm, along: 0 deg', 'leave one out'),
        ('circle: 28 cm, ', '', "the key 'along' is missing"),
        ('circle: 28 cm', 'circle: 28 kg', 'unit'),
    ],
)
def test_an_arc_slot_that_cannot_be_is_refused(old: str, new: str, says: str) -> None:
    with pytest.raises(SceneError, match=says):
        load_scene(PIN.replace(old, new))
