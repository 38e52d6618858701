"""A scene held against positions: what agrees says nothing, what is wrong is named and fitted."""

from argparse import Namespace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinpole_ros.bags import simulate
from kinpole_ros.linkage._scene_poses import Anchors, residuals
from kinpole_ros.linkage.fit import fit_scene, free_dimensions
from kinpole_ros.linkage.positions import LivePositions, PositionReport, Positions
from kinpole_ros.linkage.theory import Theory, load_theory
from kinpole_ros.mechanism import (
    Scene,
    SceneError,
    load_scene,
    marker_positions,
    scene_names,
    scene_text,
)
from kinpole_ros.mechanism._scene_file import rewritten
from kinpole_ros.messages import DiagnosticsMaker
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.settings import settings_from
from kinpole_ros.tools import cli
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

NOISE = 2e-4
# Where the tracker's world has the scene's ground.
TURN, SHIFT = np.exp(0.7j), 0.3 - 0.2j


def settings(scene: str, hidden: str = '') -> dict[str, Any]:
    loaded = load_scene(scene)
    bodies = [body for body in loaded.markers if body != hidden]
    values: dict[str, Any] = {'bodies': bodies, 'window': 0.1, 'lag': 0.02}
    for body in bodies:
        values[f'{body}.markers'] = list(loaded.marker_names[body])
    return values


def frames(scene: Scene, seconds: float, turn: complex = 1.0, shift: complex = 0.0) -> MarkerFrames:
    """Noisy markers at 100 Hz, one in twenty hidden."""
    rng = np.random.default_rng(3)
    times = np.arange(round(seconds * 100)) / 100
    motion = scene.motion(times)
    flat = np.concatenate(
        [marker_positions(motion[body], scene.markers[body]) for body in scene.markers], axis=1
    )
    moved = turn * (flat[..., 0] + 1j * flat[..., 1]) + shift
    points = np.zeros((*moved.shape, 3))
    points[..., 0], points[..., 1] = moved.real, moved.imag
    points[..., :2] += NOISE * rng.normal(size=flat.shape)
    points[rng.random(moved.shape) < 0.05] = np.nan
    names = tuple(name for body in scene.markers for name in scene.marker_names[body])
    return MarkerFrames(10**9 + (times * 1e9).astype(np.int64), 'world', names, points)


@cache
def estimates(name: str, seconds: float = 3.0, turned: bool = False) -> tuple[Estimate, ...]:
    way = (TURN, SHIFT) if turned else (1.0, 0.0)
    tracker = Tracker(settings_from(settings(name)))
    return tuple(tracker.add(frames(load_scene(name), seconds, *way), 1))


def theory(scene: Path | str, named: str) -> Theory:
    found = load_theory(settings_from({**settings(named), 'scene': str(scene)}))
    assert found is not None
    return found


def compared(scene: Path | str, named: str, turned: bool = False) -> PositionReport:
    held = theory(scene, named)
    positions = Positions(held.scene, held.matches)
    for estimate in estimates(named, turned=turned):
        positions.append(estimate)
    found = positions.report()
    assert found is not None
    return found


def changed(folder: Path, name: str, dimension: str, by: float) -> Path:
    """The scene with its first number of that dimension larger."""
    loaded = load_scene(name)
    rows = [one for one in loaded.equations.dimensions if one.name == dimension]
    values = {one: one.value + (by if k == 0 else 0) for k, one in enumerate(rows)}
    path = folder / f'{name}.yaml'
    path.write_text(rewritten(scene_text(name), values), encoding='utf-8')
    return path


@pytest.mark.parametrize('name', scene_names())
def test_derivatives_of_what_joints_lack_are_those_of_differences(name: str) -> None:
    scene = load_scene(name)
    equations, rng = scene.equations, np.random.default_rng(0)
    values = np.array([one.value for one in equations.dimensions])
    motion = scene.motion(np.linspace(0, 1, 7))
    still = np.zeros(7)
    ground = (still.astype(complex), still)
    poses = [
        ground if body == 'ground' else (motion[body].position[0], motion[body].angle[0])
        for body in equations.bodies
    ]
    position, angle = (np.stack(part, axis=1) for part in zip(*poses, strict=True))
    assert np.abs(residuals(equations, values, position, angle, {}).value).max() < 1e-12
    angle = angle + 1e-3 * rng.normal(size=angle.shape)
    anchors: Anchors = {}
    here, step = residuals(equations, values, position, angle, anchors), 1e-6

    def slope(moved: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
        two = [
            residuals(
                equations, values + s * moved, position + s * shift, angle + s * turn, anchors
            ).value
            for s in (step, -step)
        ]
        return (two[0] - two[1]) / (2 * step)

    none = np.zeros(len(equations.bodies))
    for k in range(len(values)):
        by = slope(np.eye(len(values))[k], none, none)
        np.testing.assert_allclose(here.by_dimension[..., k], by, atol=1e-8)
    for b, way in enumerate(np.eye(len(none))):
        for k, (shift, turn) in enumerate(((way, none), (1j * way, none), (none, way))):
            by = slope(np.zeros(len(values)), shift, turn)
            np.testing.assert_allclose(here.by_pose[:, :, b, k], by, atol=1e-7)


@pytest.mark.parametrize('name', ['cardan', 'planetary_gear', 'loader_cylinder', 'double_pendulum'])
def test_a_scene_agrees_with_its_own_simulation_wherever_its_ground_is(name: str) -> None:
    found = compared(name, name, turned=True)
    assert found.findings == []
    assert 0.8 < found.ratio < 1.25
    joints = load_scene(name).equations.joints
    assert [row.joint for row in found.joints] == [joint.name for joint in joints]
    assert all(0.8 < row.deviations < 1.6 for row in found.joints)


@pytest.mark.parametrize(
    ('name', 'dimension'),
    [
        ('slider_crank', 'rod.B'),
        ('slider_crank', 'crank.A'),
        ('loader_cylinder', 'r3b.length'),
        ('four_bar', 'ground.C'),
    ],
)
def test_a_length_that_is_1_mm_off_is_named_with_its_size(
    name: str, dimension: str, tmp_path: Path
) -> None:
    found = compared(changed(tmp_path, name, dimension, 1e-3), name)
    first = found.faults[0]
    assert first.subject == dimension
    assert first.deviations > 5
    assert abs(first.off - 1e-3) < 4 * first.deviation
    assert len(found.faults) == 1
    assert dimension == found.findings[0].values['name']


def test_a_loop_is_closed_through_a_body_without_markers(tmp_path: Path) -> None:
    def look(scene: Path | str) -> PositionReport | None:
        values = settings('four_bar', hidden='coupler')
        held = load_theory(settings_from({**values, 'scene': str(scene)}))
        assert held is not None
        positions = Positions(held.scene, held.matches)
        for estimate in Tracker(settings_from(values)).add(frames(held.scene, 2.0), 1):
            positions.append(estimate)
        return positions.report()

    found = look('four_bar')
    assert found is not None
    assert found.findings == []
    # One condition of the loop, and the pins to the ground.
    assert [row.joint for row in found.joints] == ['O', 'C']


def test_markers_that_sit_elsewhere_are_told_from_lengths(tmp_path: Path) -> None:
    text = scene_text('slider_crank').replace(
        'rod_1: [0.03, 0.02], rod_2: [0.15, -0.03], rod_3: [0.27, 0.02]',
        'rod_1: [0.031, 0.021], rod_2: [0.151, -0.029], rod_3: [0.271, 0.021]',
    )
    path = tmp_path / 'moved.yaml'
    path.write_text(text, encoding='utf-8')
    first = compared(path, 'slider_crank').faults[0]
    assert 'the markers of rod' in (first.subject, *first.alternatives)


def test_the_live_node_names_the_same_from_an_instant_a_second(tmp_path: Path) -> None:
    for scene, wrong in (
        ('slider_crank', []),
        (changed(tmp_path, 'slider_crank', 'rod.B', 3e-3), ['rod.B']),
    ):
        held = theory(scene, 'slider_crank')
        live, found = LivePositions(held.scene, held.matches), None
        for block in estimates('slider_crank'):
            for k in range(0, len(block), 10):
                found = live.append(block[k]) or found
        assert found is not None
        assert [fault.subject for fault in found.faults] == wrong


@pytest.mark.parametrize('name', ['slider_crank', 'loader_cylinder'])
def test_a_fit_finds_lengths_within_their_deviations(name: str, tmp_path: Path) -> None:
    truth = load_scene(name)
    held = theory(
        changed(tmp_path, name, {'slider_crank': 'rod.B'}.get(name, 'r2.length'), 5e-3), name
    )
    fit = fit_scene(held, estimates(name), free_dimensions(held.scene, ()))
    true = {(one.name, one.axis): one.value for one in truth.equations.dimensions}
    known = [row for row in fit.dimensions if not row.undetermined]
    off = [
        (row.value - true[row.dimension.name, row.dimension.axis]) / row.deviation for row in known
    ]
    assert len(known) >= 6
    assert np.abs(off).max() < 4
    assert 0.85 < fit.ratio < 1.15 < fit.ratio_before


def test_fit_writes_the_scene_in_its_own_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, out = tmp_path / 'run.mcap', tmp_path / 'fitted.yaml'
    words = ['--duration', '2', '--rate', '100', '--noise', '1e-4', '--output', str(bag)]
    assert cli.main(['simulate', 'slider_crank', *words]) == 0
    wrong = changed(tmp_path, 'slider_crank', 'rod.B', 2e-3)
    fit = ['fit', str(wrong), str(bag), '--free', 'rod.B', '--output', str(out)]
    assert cli.main(fit) == 0
    assert 'chi^2/n' in capsys.readouterr().out
    assert load_scene(out).points['rod.B'][1] == pytest.approx(0.3, abs=1e-4)
    before, after = (path.read_text(encoding='utf-8').splitlines() for path in (wrong, out))
    assert [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b] == [
        k for k, line in enumerate(before) if line.startswith('  rod:    {A')
    ]
    assert cli.main(['fit', str(wrong), str(bag), '--free', 'shaft']) == 2
    assert '--free shaft is no dimension' in capsys.readouterr().err


@pytest.mark.parametrize(
    'words',
    [
        'SCENE BAG --free rod.B crank',
        '--free rod.B crank SCENE BAG',
        '--free rod.B,crank SCENE BAG',
        '--free rod.B --free crank SCENE BAG',
        '--free rod.B SCENE BAG --free crank',
        'SCENE --free rod.B crank BAG',
        '--free rod.B crank SCENE --output OUT BAG',
        '--output=OUT --free rod.B crank --topic /t SCENE BAG',
        '--free rod.B crank --output OUT SCENE BAG',
    ],
)
def test_the_names_after_free_may_stand_before_or_after_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    (tmp_path / 'BAG').touch()
    monkeypatch.chdir(tmp_path)
    taken: list[Namespace] = []
    monkeypatch.setattr('kinpole_ros.tools.fit_scene.fit_bag', lambda o, *_: taken.append(o) or [])
    assert cli.main(['fit', *words.split()]) == 0
    (options,) = taken
    names = [name for listed in options.free for part in listed for name in part.split(',')]
    assert (options.scene, options.bag, names) == ('SCENE', 'BAG', ['rod.B', 'crank'])
    assert options.output == ('OUT' if 'OUT' in words else None)


def test_fit_uses_a_bag_that_is_cut_off_and_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, cut = tmp_path / 'whole.mcap', tmp_path / 'cut.mcap'
    simulate(load_scene('four_bar'), whole, rate=100, duration=2.0, noise=NOISE)
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 3 // 4])
    assert cli.main(['fit', 'four_bar', str(cut)]) == 2
    out, err = capsys.readouterr()
    assert 'chi^2/n' in out
    assert err.startswith(f'kinpole fit: {cut} ')
    assert 'messages up to stamp' in err


@pytest.mark.parametrize('words', ['SCENE', '--free rod.B', '--free rod.B BAG', 'A B C', ''])
def test_fit_without_its_files_is_bad_usage(words: str) -> None:
    with pytest.raises(SystemExit, match='2'):
        cli.main(['fit', *words.split()])


def test_a_scene_may_be_text_or_a_mapping() -> None:
    text = scene_text('four_bar')
    assert load_scene(text).mechanism.bodies == ('crank', 'coupler', 'rocker')
    with pytest.raises(SceneError, match="scene: 'drivers'"):
        load_scene({'bodies': {'ground': {'O': [0, 0]}, 'a': {'O': [0, 0]}}, 'drivers': 3})


def test_diagnostics_warn_in_the_words_of_the_verdict(tmp_path: Path) -> None:
    held = theory(changed(tmp_path, 'slider_crank', 'rod.B', 3e-3), 'slider_crank')
    tracker = Tracker(settings_from(settings('slider_crank')))
    found = tracker.add(frames(load_scene('slider_crank'), 2.0), 1)
    maker, levels = DiagnosticsMaker('kinpole', held.comparison()), []
    for k in range(60, 180, 8):
        array = maker.make(10**9, tracker, found[0][k : k + 1], 1.0, {})
        (linkage,) = [status for status in array.status if status.name == 'kinpole: linkage']
        levels.append(linkage.level)
    assert levels[0] == DiagnosticStatus.OK
    assert levels[-1] == DiagnosticStatus.WARN
    assert linkage.message.startswith('scene slider_crank: rod.B is ')
    keys = {pair.key for pair in linkage.values}
    assert {'joint piston: off (m)', 'joint piston: the same in deviations'} <= keys
