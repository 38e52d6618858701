"""`kinpole solve --export`: read again by MuJoCo, yourdfpy and as DXF, and moved over a turn."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import polylines

from kinpole_ros.mechanism import load_scene
from kinpole_ros.tools import cli
from kinpole_ros.tools.solve._dxf import write_linkage
from kinpole_ros.tools.solve._robot_models import write_model
from kinpole_ros.tools.solve._solution import (
    SolvedScene,
    over_full_motion,
    over_time,
    point_motions,
)

# A Whitworth drive: the lever slides through a block that is pinned to it, which closes the loop.
# The block is guided, so that its closure keeps an angle too.
GUIDED = """
bodies:
  ground: {O: [0, 0], C: [0, -0.2]}
  crank:  {O: [0, 0], A: [0.08, 0]}
  lever:  {C: [0, 0], P: [0.4, 0.02]}
  block:  {A: [0, 0], Q: [0.01, 0]}
joints:
  - {prismatic: block.Q, on: lever.C, along: 10 deg, turned: 30 deg, name: slide}
drivers: [{drive: crank, rate: 1 rev/s, start: 20 deg}]
start: {lever: 75 deg}
"""
ARC = """
bodies:
  ground: {O: [0, 0], C: [0.4, 0]}
  crank:  {O: [0, 0], A: [0.12, 0]}
  coupler: {A: [0, 0], B: [0.36, 0], P: [0.1, 0.15]}
joints: [{slot: coupler.B, on: ground.C, circle: 28 cm, name: arc}]
drivers: [{drive: crank, rate: 1 rev/s}]
start: {coupler: 50 deg}
"""
SCENES = ['four_bar', 'six_bar', 'slider_crank', 'cardan', 'eight_bar', 'trebuchet', 'pool_lift']
SCENES += ['bike_suspension', 'double_pendulum', 'loader_cylinder', GUIDED, ARC]
TURNING = ['four_bar', 'six_bar', 'slider_crank', 'cardan', GUIDED, ARC]


def solved(source: str) -> tuple[SolvedScene, SolvedScene]:
    scene = load_scene(source)
    return over_full_motion(scene, 361), over_time(scene, np.zeros(1))


def mujoco_model(source: str, tmp_path: Path) -> tuple[Any, Any, SolvedScene]:
    mujoco = pytest.importorskip('mujoco')
    motion, here = solved(source)
    write_model(tmp_path / 'm.xml', 'xml', motion, here)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / 'm.xml'))
    return model, mujoco.MjData(model), motion


def gap(model: Any, data: Any) -> float:
    """How far the loops are open, m."""
    names = [model.eq(k).name for k in range(model.neq)]
    ends = [(data.site(f'{name}.one').xpos, data.site(f'{name}.other').xpos) for name in names]
    return max((float(np.abs(a - b).max()) for a, b in ends), default=0.0)


@pytest.mark.parametrize('source', SCENES)
def test_mujoco_has_the_positions_of_the_motion_with_closed_loops(
    source: str, tmp_path: Path
) -> None:
    mujoco = pytest.importorskip('mujoco')
    model, data, motion = mujoco_model(source, tmp_path)
    assert model.nkey == 38
    at = np.linspace(0, 360, 37).astype(int)
    points = point_motions(motion)
    for key, k in enumerate(at, start=1):
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
        assert gap(model, data) < 1e-9
        # Residuals of all constraints, with those of angles of welds.
        assert np.abs(data.efc_pos[: data.ne]).max(initial=0.0) < 1e-9
        for name, path in points.items() if motion.scene.mechanism.assembly.joints else ():
            x, y, z = data.site(name).xpos
            assert complex(x, y) == pytest.approx(path[0, k], abs=1e-9)
            assert z == 0


@pytest.mark.parametrize('source', TURNING)
def test_loops_stay_closed_over_one_turn_of_mujoco(source: str, tmp_path: Path) -> None:
    mujoco = pytest.importorskip('mujoco')
    model, data, motion = mujoco_model(source, tmp_path)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    first, rate, widest = float(data.actuator_length[0]), float(motion.rates[0, 0]), 0.0
    for step in range(int(2.5 * np.pi / abs(rate) / model.opt.timestep)):
        data.ctrl[0] = rate * min(1.0, step * model.opt.timestep / 0.2)
        mujoco.mj_step(model, data)
        widest = max(widest, gap(model, data))
    assert abs(float(data.actuator_length[0]) - first) > 2 * np.pi
    assert widest < 1e-6


@pytest.mark.parametrize('source', SCENES)
def test_the_frames_at_which_a_urdf_closes_coincide(source: str, tmp_path: Path) -> None:
    yourdfpy = pytest.importorskip('yourdfpy')
    motion, here = solved(source)
    left_out = write_model(tmp_path / 'm.urdf', 'urdf', motion, here)
    robot = yourdfpy.URDF.load(str(tmp_path / 'm.urdf'), load_meshes=False)
    assert robot.validate()
    model, _, _ = mujoco_model(source, tmp_path)
    closures = {name.removesuffix('.one') for name in robot.link_map if name.endswith('.one')}
    assert bool(closures) == any('coincide where loops close' in line for line in left_out)
    for key in range(model.nkey):
        # Both formats have the same joints.
        names = [model.joint(k).name for k in range(model.njnt)]
        assert {*names} == {*robot.actuated_joint_names}
        robot.update_cfg(dict(zip(names, model.key_qpos[key], strict=True)))
        for name in closures:
            ends = [robot.get_transform(f'{name}.{end}') for end in ('one', 'other')]
            np.testing.assert_allclose(ends[0][:, 3], ends[1][:, 3], atol=1e-9)
            if source == GUIDED and name == 'slide':
                np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_a_dxf_has_the_links_and_the_paths_of_their_points(tmp_path: Path) -> None:
    motion, here = solved('four_bar')
    write_linkage(tmp_path / 'a.dxf', motion, here)
    lines = {layer: (line, closed) for layer, closed, line in polylines(tmp_path / 'a.dxf')}
    path, closed = lines['PATH_COUPLER_P']
    assert closed
    exact = point_motions(motion)['coupler.P'][0]
    np.testing.assert_allclose(path, 1e3 * exact[:-1], atol=1e-6)
    link, closed = lines['COUPLER']
    assert closed
    at = point_motions(here)
    exact = np.array([at[f'coupler.{name}'][0, 0] for name in 'ABP'])
    np.testing.assert_allclose(link, 1e3 * exact, atol=1e-6)
    # The path of a rocker's pin goes back on itself, and is not closed by a line.
    assert {'CRANK', 'ROCKER', 'GROUND', 'PATH_ROCKER_B'} <= {*lines}


def test_the_command_exports_and_says_what_a_format_lacks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind, says in (
        ('dxf', ''),
        ('xml', 'xml: without loads'),
        ('urdf', 'urdf: a tree; frames NAME.one and NAME.other coincide where loops close: B'),
    ):
        file = tmp_path / f'loader.{kind}'
        assert cli.main(['solve', 'loader', '--export', str(file)]) == 0
        out = capsys.readouterr().out
        assert f'written to {file}' in out
        assert says in out


@pytest.mark.parametrize(
    ('scene', 'file', 'says'),
    [
        ('planetary_gear', 'a.xml', 'sun_teeth, ring_teeth cannot be written as hinges and slides'),
        ('rolling_wheel', 'a.urdf', 'cannot be written as hinges and slides; export a .dxf'),
        ('four_bar', 'a.step', 'end its name in .dxf or .xml or .urdf'),
        ('four_bar', '/dev/null/a.xml', 'a.xml'),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(
    scene: str, file: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(['solve', scene, '--export', str(tmp_path / file)]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1
    assert not [*tmp_path.iterdir()]
