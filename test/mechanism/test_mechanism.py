"""The exact motions against geometry and calculus done another way, and where scenes are found."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import yaml
from closed_forms import cardan, four_bar, rolling_wheel
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros.mechanism import (
    BodyMotion,
    Scene,
    SceneError,
    _scene_file,
    load_scene,
    marker_positions,
    rotation_derivatives,
    scene_names,
    scenes_folder,
    share_folder,
)

SCENES = Path(__file__).resolve().parents[2] / 'config' / 'scenes'
BODIES = [
    ('cardan', 'rod'),
    ('four_bar', 'crank'),
    ('four_bar', 'coupler'),
    ('four_bar', 'rocker'),
    ('rolling_wheel', 'wheel'),
]
NAMES = sorted({name for name, _ in BODIES})
TIMES = np.linspace(-0.7, 2.1, 1001)


def scene(name: str) -> Scene:
    """Return a scene of the source tree, wherever the package under test is installed."""
    return load_scene(SCENES / f'{name}.yaml')


def written(name: str) -> dict:
    """Return what a scene's file says, in which 'on' is a word."""
    return yaml.load((SCENES / f'{name}.yaml').read_text(), yaml.BaseLoader)


def drive(data: dict, **changes: object) -> None:
    data['drivers'][0].update(changes)


def edited(folder: Path, name: str, edit: Callable[[dict], object]) -> Path:
    """Write a scene of the package again, changed by `edit`."""
    data = written(name)
    edit(data)
    path = folder / 'edited.yaml'
    path.write_text(yaml.safe_dump(data))
    return path


def icr(motion: BodyMotion) -> np.ndarray:
    """Return the velocity pole z + i ż/ω."""
    return motion.position[0] + 1j * motion.position[1] / motion.angle[1]


def icr_derivatives(motion: BodyMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and second time derivative of z + i ż/ω, by the quotient rule."""
    _, z1, z2, z3, _ = motion.position
    _, w, a, j, _ = motion.angle
    u = z1 + 1j * z2 / w - 1j * z1 * a / w**2
    du = z2 + 1j * z3 / w - 2j * z2 * a / w**2 - 1j * z1 * j / w**2 + 2j * z1 * a**2 / w**3
    return u, du


def curvature(motion: BodyMotion) -> np.ndarray:
    """Return the signed curvature of the fixed centrode, 1/m."""
    u, du = icr_derivatives(motion)
    return (u.conj() * du).imag / np.abs(u) ** 3


def moving_centrode(motion: BodyMotion) -> np.ndarray:
    """Return the ICR in the body's own frame."""
    return (icr(motion) - motion.position[0]) * np.exp(-1j * motion.angle[0])


def place(motion: BodyMotion, point: complex) -> np.ndarray:
    """Return where a point of the body's frame is."""
    return motion.position[0] + point * np.exp(1j * motion.angle[0])


# Exact motions


@pytest.mark.parametrize(('name', 'body'), BODIES)
@pytest.mark.parametrize('part', BodyMotion._fields)
def test_each_order_is_the_time_derivative_of_the_one_below(
    name: str, body: str, part: str
) -> None:
    # The drives turn once a second, so what is left after the steady growth over a turn is periodic
    # and its Fourier series differentiates it to rounding.
    motion = scene(name).motion
    times = np.arange(256) / 256
    rows = getattr(motion(times)[body], part)
    growth = np.subtract(*(getattr(motion(t)[body], part)[:, None] for t in (1.0, 0.0)))
    frequency = 2j * np.pi * np.fft.fftfreq(256, 1 / 256)
    derivatives = np.fft.ifft(frequency * np.fft.fft(rows - growth * times)) + growth
    scale = np.abs(rows).max(axis=1)
    for k in range(4):
        error = np.abs(derivatives[k] - rows[k + 1]).max()
        assert error <= 1e-11 * max(scale[k], scale[k + 1]), k


@given(st.lists(st.floats(-10, 10), min_size=5, max_size=5))
def test_rotation_derivatives_are_the_pole_matrices(values: list[float]) -> None:
    theta, w, a, j, s = values
    factors = [
        1,
        1j * w,
        1j * a - w**2,
        1j * (j - w**3) - 3 * w * a,
        1j * (s - 6 * w**2 * a) + w**4 - 4 * w * j - 3 * a**2,
    ]
    expected = np.array(factors) * np.exp(1j * theta)
    np.testing.assert_allclose(rotation_derivatives(np.array(values)), expected, 1e-12, 1e-10)


def test_a_sweep_of_positions_alone_goes_up_to_dead_points() -> None:
    """Of positions without derivatives all are sound, also next to a dead point."""
    mechanism = load_scene('eight_bar').mechanism
    ends = mechanism.path(-7.0, 7.0).inputs[[0, -1]]
    alone, all_orders = mechanism.sweep(ends, 1), mechanism.sweep(ends)
    np.testing.assert_allclose(alone.values[0], all_orders.values[0], rtol=0, atol=1e-12)
    assert alone.sound.tolist() == [1, 1]


def test_wheel_rolls_along_x_about_its_contact_point(tmp_path: Path) -> None:
    def edit(data: dict) -> None:
        # At time 0 the hub is at 0.5: it would be at 0.56 with the angle turned back to 0.
        data['joints'][0].update(radius=0.2, start=0.56)
        drive(data, start=0.3)

    path = edited(tmp_path, 'rolling_wheel', edit)
    rolling = load_scene(path).motion
    wheel = rolling(TIMES)['wheel']
    hub = wheel.position[0]
    np.testing.assert_allclose(wheel.angle[1], -2 * np.pi, 1e-15)
    np.testing.assert_allclose(wheel.position[1], 0.4 * np.pi, 1e-15)
    np.testing.assert_allclose(hub.imag, 0.2, 1e-15)
    np.testing.assert_allclose(icr(wheel), hub.real, atol=1e-12)
    np.testing.assert_allclose(icr_derivatives(wheel)[0], wheel.position[1], 1e-12)
    np.testing.assert_allclose(np.abs(moving_centrode(wheel)), 0.2, 1e-10)
    np.testing.assert_allclose(curvature(wheel), 0.0, atol=1e-10)
    assert rolling(0.0)['wheel'].position[0] == pytest.approx(0.5 + 0.2j, abs=1e-15)
    assert rolling(0.0)['wheel'].angle[0] == 0.3


def test_rod_slides_on_the_axes_and_has_cardan_circles_for_centrodes(tmp_path: Path) -> None:
    def edit(data: dict) -> None:
        data['bodies']['rod'] = {'A': [-0.25, 0], 'B': [0.25, 0]}
        drive(data, start=0.7)

    path = edited(tmp_path, 'cardan', edit)
    rod = load_scene(path).motion(TIMES)['rod']
    np.testing.assert_allclose(place(rod, -0.25).real, 0.0, atol=1e-12)
    np.testing.assert_allclose(place(rod, 0.25).imag, 0.0, atol=1e-12)
    np.testing.assert_allclose(rod.angle[0], 0.7 + 2 * np.pi * TIMES, 1e-12)
    corner = place(rod, 0.25).real + 1j * place(rod, -0.25).imag
    np.testing.assert_allclose(icr(rod), corner, atol=1e-12)
    np.testing.assert_allclose(np.abs(icr(rod)), 0.5, 1e-10)
    np.testing.assert_allclose(np.abs(moving_centrode(rod)), 0.25, 1e-10)
    # The pole runs clockwise while the rod turns counterclockwise.
    np.testing.assert_allclose(curvature(rod), -2.0, 1e-10)


def test_scenes_are_their_closed_forms() -> None:
    times = np.linspace(-100, 100, 1001)
    lengths = {'ground': 0.4, 'crank': 0.12, 'coupler': 0.36, 'rocker': 0.28}
    truth = {
        'four_bar': four_bar(times, **lengths, branch='open', turns_per_second=1.0, phase=0.0),
        'cardan': cardan(times, length=0.3, turns_per_second=1.0, phase=0.4),
        'rolling_wheel': rolling_wheel(
            times, radius=0.1, start=0.0, turns_per_second=1.0, phase=0.0
        ),
    }
    for name, bodies in truth.items():
        found = scene(name).motion(times)
        assert list(found) == list(bodies)
        for body, expected in bodies.items():
            for part in BodyMotion._fields:
                one, other = getattr(found[body], part), getattr(expected, part)
                scale = np.maximum(np.abs(other).max(axis=1, keepdims=True), 1)
                np.testing.assert_allclose(one / scale, other / scale, atol=1e-12)


@st.composite
def crank_rockers(draw: st.DrawFn) -> dict:
    """Draw lengths whose crank turns fully, and a branch."""
    crank = draw(st.floats(0.05, 0.3))
    middle = [crank * draw(st.floats(1.05, 5.0)) for _ in range(2)]
    share = draw(st.floats(0.0, 0.97))
    longest = max(middle) + share * (sum(middle) - crank - max(middle))
    ground, coupler, rocker = draw(st.permutations([*middle, longest]))
    branch = draw(st.sampled_from(['open', 'crossed']))
    lengths = {'ground': ground, 'crank': crank, 'coupler': coupler, 'rocker': rocker}
    return {**lengths, 'branch': branch, 'turns_per_second': 1.0, 'phase': 0.2}


@given(crank_rockers())
def test_joints_of_neighboring_bodies_coincide(linkage: dict) -> None:
    bodies = four_bar(TIMES, **linkage)
    pin = place(bodies['crank'], linkage['crank'])
    end = place(bodies['rocker'], linkage['rocker'])
    np.testing.assert_allclose(place(bodies['crank'], 0), 0, atol=1e-15)
    np.testing.assert_allclose(place(bodies['rocker'], 0), linkage['ground'], 1e-15)
    np.testing.assert_allclose(place(bodies['coupler'], 0), pin, atol=1e-12)
    np.testing.assert_allclose(place(bodies['coupler'], linkage['coupler']), end, atol=1e-12)
    side = (np.conj(linkage['ground'] - pin) * (end - pin)).imag
    assert np.all(side > 0 if linkage['branch'] == 'open' else side < 0)


@given(crank_rockers())
def test_joint_b_moves_alike_on_coupler_and_rocker_up_to_snap(linkage: dict) -> None:
    bodies = four_bar(TIMES, **linkage)
    on_coupler = linkage['coupler'] * rotation_derivatives(bodies['coupler'].angle)
    on_coupler += bodies['coupler'].position
    on_rocker = linkage['rocker'] * rotation_derivatives(bodies['rocker'].angle)
    on_rocker += bodies['rocker'].position
    scale = np.abs(on_rocker).max(axis=1, keepdims=True)
    np.testing.assert_allclose(on_coupler / scale, on_rocker / scale, atol=1e-12)


@given(crank_rockers())
def test_angles_are_continuous_and_only_the_crank_turns_fully(linkage: dict) -> None:
    bodies = four_bar(TIMES, **linkage)
    np.testing.assert_allclose(bodies['crank'].angle[0], 0.2 + 2 * np.pi * TIMES, atol=1e-12)
    assert np.ptp(bodies['rocker'].angle[0]) < np.pi
    assert np.ptp(bodies['coupler'].angle[0]) < np.pi


@pytest.mark.parametrize('side', [1, -1], ids=['open', 'crossed'])
def test_coupler_icr_is_where_the_lines_of_crank_and_rocker_meet(tmp_path: Path, side: int) -> None:
    def edit(data: dict) -> None:
        drive(data, start=0.3)
        data['start'] = {'coupler': side * 0.8, 'rocker': side * 1.7}

    path = edited(tmp_path, 'four_bar', edit)
    bodies = load_scene(path).motion(TIMES)
    assert np.sign(bodies['rocker'].angle[0]) == pytest.approx(side)
    pole = icr(bodies['coupler'])
    for link in ('crank', 'rocker'):
        pivot = bodies[link].position[0]
        off_line = ((pole - pivot) * np.exp(-1j * bodies[link].angle[0])).imag
        np.testing.assert_allclose(off_line / np.maximum(np.abs(pole), 1), 0, atol=1e-10)


def test_phase_and_rate_shift_and_scale_time(tmp_path: Path) -> None:
    path = edited(tmp_path, 'four_bar', lambda d: drive(d, rate='-2 rev/s', start=1.0))
    slow = scene('four_bar').motion(1 / (2 * np.pi) - 2 * TIMES)
    for body, motion in load_scene(path).motion(TIMES).items():
        factor = (-2.0) ** np.arange(5)[:, None]
        for part in BodyMotion._fields:
            expected = factor * getattr(slow[body], part)
            np.testing.assert_allclose(getattr(motion, part), expected, 1e-9, 1e-9)


@pytest.mark.parametrize('name', NAMES)
def test_times_keep_their_shape(name: str) -> None:
    exact = scene(name)
    grid = TIMES[:12].reshape(3, 4)
    for body, motion in exact.motion(grid).items():
        single = exact.motion(TIMES[7])[body]
        assert motion.position.shape == motion.angle.shape == (5, 3, 4)
        assert single.position.shape == single.angle.shape == (5,)
        np.testing.assert_allclose(motion.position[:, 1, 3], single.position, 1e-12)
        np.testing.assert_allclose(motion.angle[:, 1, 3], single.angle, 1e-12)


# Markers


def test_marker_positions_turn_then_shift_the_body_points() -> None:
    angle, position = np.zeros((5, 2)), np.zeros((5, 2), dtype=complex)
    angle[0], position[0] = [0, np.pi / 2], [1 + 2j, 3 + 4j]
    points = np.array([[0.5, 0.0], [0.0, 0.25], [0.0, 0.0]])
    placed = marker_positions(BodyMotion(position, angle), points)
    first = [[1.5, 2.0], [1.0, 2.25], [1.0, 2.0]]
    second = [[3.0, 4.5], [2.75, 4.0], [3.0, 4.0]]
    np.testing.assert_allclose(placed, [first, second], 1e-15)


@pytest.mark.parametrize('name', NAMES)
@given(times=st.lists(st.floats(-100, 100), min_size=1, max_size=20))
def test_markers_of_a_body_keep_their_distances(name: str, times: list[float]) -> None:
    exact = scene(name)
    for body, motion in exact.motion(np.array(times)).items():
        points = exact.markers[body]
        placed = marker_positions(motion, points)
        assert placed.shape == (len(times), len(points), 2)
        between = np.linalg.norm(placed[:, :, None] - placed[:, None], axis=-1)
        rigid = np.linalg.norm(points[:, None] - points[None], axis=-1)
        np.testing.assert_allclose(between, np.broadcast_to(rigid, between.shape), atol=1e-12)


@pytest.mark.parametrize('name', sorted(path.stem for path in SCENES.glob('*.yaml')))
def test_scene_markers_are_named_apart_and_match_the_file(name: str) -> None:
    exact = scene(name)
    assert exact.name == name
    listed = written(name)['markers']
    assert set(exact.markers) == set(exact.marker_names) == set(listed)
    assert set(listed) <= set(exact.motion(0.0))
    everyone = [marker for names in exact.marker_names.values() for marker in names]
    assert len(everyone) == len(set(everyone))
    for body, names in exact.marker_names.items():
        assert len(names) >= 3
        points = [[float(x) for x in listed[body][n]] for n in names]
        np.testing.assert_array_equal(exact.markers[body], points)


@pytest.mark.parametrize('name', NAMES)
def test_every_body_of_the_first_scenes_has_markers(name: str) -> None:
    exact = scene(name)
    assert set(exact.markers) == set(exact.motion(0.0))


def test_a_body_may_go_without_markers(tmp_path: Path) -> None:
    exact = load_scene(edited(tmp_path, 'four_bar', lambda d: d['markers'].pop('crank')))
    assert set(exact.markers) == {'coupler', 'rocker'}
    assert set(exact.motion(0.0)) == {'crank', 'coupler', 'rocker'}


@pytest.mark.parametrize('wrong', ['absent.yaml', ''])
def test_a_path_without_a_file_is_refused(tmp_path: Path, wrong: str) -> None:
    with pytest.raises(SceneError, match=r'there is no such scene file|Is a directory'):
        load_scene(tmp_path / wrong)


# Where scenes are looked up


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Make the package seem to lie deep under an empty prefix, with ament out of reach."""
    package = tmp_path / 'lib' / 'python3' / 'site-packages' / 'kinpole_ros'
    package.mkdir(parents=True)
    monkeypatch.setattr(_scene_file, '_PACKAGE', package)
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', None)
    return SimpleNamespace(prefix=tmp_path, site=package.parent)


def with_scene(folder: Path) -> Path:
    """Give a folder a config/ with one scene, 'mine'."""
    (folder / 'config' / 'scenes').mkdir(parents=True)
    (folder / 'config' / 'scenes' / 'mine.yaml').write_text((SCENES / 'cardan.yaml').read_text())
    return folder


def test_the_scenes_that_come_with_the_package_load_by_name() -> None:
    assert set(NAMES) <= set(scene_names())
    for name in scene_names():
        assert load_scene(name).name == name


def test_a_source_tree_is_known_by_its_package_xml(tree: SimpleNamespace) -> None:
    installed = with_scene(tree.prefix / 'share' / 'kinpole_ros')
    with_scene(tree.site)
    assert share_folder() == installed
    (tree.site / 'package.xml').touch()
    assert share_folder() == tree.site


def test_an_installed_package_finds_the_share_folder_of_its_prefix(tree: SimpleNamespace) -> None:
    installed = with_scene(tree.prefix / 'share' / 'kinpole_ros')
    assert scenes_folder() == installed / 'config' / 'scenes'
    assert scene_names() == ['mine']
    assert load_scene('mine').name == 'mine'
    with pytest.raises(SceneError, match=r'yours\.yaml: there is no such scene.* a name: mine$'):
        load_scene('yours')


def test_the_ament_index_is_asked_last(
    tree: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    ament = ModuleType('ament_index_python.packages')
    elsewhere = with_scene(tree.prefix / 'elsewhere')
    ament.get_package_share_directory = lambda name: str(elsewhere)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', ament)
    assert share_folder() == elsewhere
    installed = with_scene(tree.prefix / 'share' / 'kinpole_ros')
    assert share_folder() == installed


def test_a_package_without_its_files_says_how_to_get_them(tree: SimpleNamespace) -> None:
    with pytest.raises(FileNotFoundError, match='install it with pip or colcon'):
        share_folder()
    with pytest.raises(SceneError, match='or give the path'):
        load_scene('cardan')


# What ament raises for a package it does not know, and where no ROS is sourced.
@pytest.mark.parametrize('error', [KeyError, EnvironmentError])
def test_an_ament_index_that_fails_is_no_answer(
    tree: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    def unknown(name: str) -> str:
        raise error(name)

    ament = ModuleType('ament_index_python.packages')
    ament.get_package_share_directory = unknown  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', ament)
    with pytest.raises(FileNotFoundError, match='install it with pip or colcon'):
        share_folder()
