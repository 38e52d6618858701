"""A scene beside the measurement: what is off is told, and what balances its loads is published."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import bodies_of, decoded
from recordings import START, follow, record

from kinpole_ros import planar
from kinpole_ros.bags import read_messages
from kinpole_ros.linkage import theory
from kinpole_ros.linkage.positions import Positions
from kinpole_ros.linkage.theory import balance, balance_direction, load_theory
from kinpole_ros.mechanism import (
    Statics,
    holding,
    load_scene,
    rotation_derivatives,
    scene_names,
    scenes_folder,
)
from kinpole_ros.messages import read_state_blocks, stamp_to_ns
from kinpole_ros.settings import ParameterError, Settings, load_settings, settings_from
from kinpole_ros.tools import cli
from kinpole_ros.tracking import update
from kinpole_ros.tracking.bodies import Bodies

LOADS = """
loads:
  - {force: [0, -50], at: coupler.P}
  - {torque: 2, on: rocker}
"""
CONFIG = scenes_folder().parent / 'four_bar.yaml'


def scene(folder: Path, name: str = 'loaded', loads: str = LOADS, **changes: str) -> Path:
    """The four-bar with loads, and with some of its text changed."""
    text = (scenes_folder() / 'four_bar.yaml').read_text(encoding='utf-8') + loads
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    path = folder / f'{name}.yaml'
    path.write_text(text, encoding='utf-8')
    return path


def config(folder: Path, scene_path: Path | str) -> Path:
    path = folder / 'rig.yaml'
    path.write_text(
        f'{CONFIG.read_text(encoding="utf-8")}\n    scene: {scene_path}\n    topics: all\n', 'utf-8'
    )
    return path


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The loaded four-bar, 1.5 s at 100 Hz, noise of 0.1 mm."""
    folder = tmp_path_factory.mktemp('theory')
    words = ['--noise', '1e-4', '--duration', '1.5', '--rate', '100']
    assert (
        cli.main(['simulate', str(scene(folder)), '--output', str(folder / 'in.mcap'), *words]) == 0
    )
    return folder / 'in.mcap'


def replayed(bag: Path, folder: Path, scene_path: Path) -> dict[str, list[Any]]:
    words = ['--config', str(config(folder, scene_path)), '--output', str(folder / 'out.mcap')]
    assert cli.main(['replay', str(bag), *words]) == 0
    return decoded(folder / 'out.mcap')


def linkage(messages: dict[str, list[Any]]) -> list[dict[str, float]]:
    """What diagnostics say of the linkage, but of the first second."""
    return [
        {pair.key: float(pair.value) for pair in status.values}
        for array in messages['/diagnostics'][1:]
        for status in array.status
        if status.name.endswith('linkage')
    ]


@pytest.mark.parametrize('reference', [0.0, 0.1 - 0.05j], ids=['origin', 'another point'])
def test_the_effort_that_balances_the_loads_is_that_of_virtual_work(
    bag: Path, tmp_path: Path, reference: complex, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stand(bodies: Bodies, *_: Any) -> np.ndarray:
        return np.full(bodies.count, reference + 0j)

    # Whatever point of each body is differentiated.
    monkeypatch.setattr(update, 'find_hubs', stand)
    path = scene(tmp_path)
    messages = replayed(bag, tmp_path, path)
    found = messages['/kinpole/balance']
    assert len(found) > 130
    stamps = np.array([stamp_to_ns(message.header.stamp) for message in found])
    begin = stamp_to_ns(decoded(bag)['/markers'][0].markers[0].header.stamp)
    loaded = load_scene(path)
    values = loaded.mechanism.motion((stamps - begin) * 1e-9).values[0]
    true = Statics(loaded.mechanism, values, loaded.loads).effort[0]
    said = np.array([message.wrench.torque.z for message in found])
    sigma = np.array(
        [message.wrench.torque.z for message in messages['/kinpole/balance/deviation']]
    )
    assert np.median(np.abs(said - true)) < 0.005 * np.abs(true).max()
    assert np.mean(np.abs(said - true) < 1.96 * sigma) > 0.9


@pytest.mark.parametrize('name', ['trebuchet', 'exercise_machine', 'loader_loop'])
def test_what_holds_the_loads_is_what_the_scene_says_holds_them(name: str) -> None:
    """A force across a bar that turns, one at a handle, and a load on a vector of another body."""
    seen = record(name, noise=1e-5)
    values = {**seen.values, 'scene': name}
    theory = load_theory(settings_from(values))
    assert theory is not None
    assert theory.balances
    _, found = follow(seen.frames, values, order=1)
    found = [estimate for estimate in found if not any(estimate.missing)][2:]
    known = 0
    for estimate in found:
        at = np.array([(int(estimate.stamp) - START) * 1e-9])
        scene = theory.scene
        variables = scene.mechanism.motion(at).values[0]
        if scene.held_by is not None:
            true, load = holding(scene.mechanism, variables, scene.loads, scene.held_by)
            way = balance_direction(theory, estimate)
            assert way is not None
            assert complex(load.force[0]) == pytest.approx(complex(true[0] * way), rel=1e-2)  # type: ignore[union-attr,index]
        else:
            true = Statics(scene.mechanism, variables, scene.loads).effort[0]
        said = balance(theory, estimate)
        if said.determined:
            known += 1
            off = abs(float(said.value) - float(true[0]))
            assert off < max(5 * float(said.variance) ** 0.5, 1e-3 * abs(float(true[0])))
    assert known > 5


def test_points_of_the_scene_are_published_to_their_jerk(bag: Path, tmp_path: Path) -> None:
    """P of the coupler, which no joint uses: where it is and how it moves, with deviations."""
    path = scene(tmp_path)
    messages = replayed(bag, tmp_path, path)
    begin = stamp_to_ns(decoded(bag)['/markers'][0].markers[0].header.stamp)
    loaded = load_scene(path)
    body, place = loaded.points['coupler.P']
    assert {topic.split('/points/')[-1][0] for topic in messages if '/points/' in topic} == {'P'}
    for order, what in enumerate(('', '/velocity', '/acceleration', '/jerk')):
        topic = f'/kinpole/coupler/points/P{what}'
        found = messages[topic]
        assert len(found) > 130
        stamps = np.array([stamp_to_ns(message.header.stamp) for message in found])
        motion = loaded.motion((stamps - begin) * 1e-9)[body]
        true = motion.position[order] + place * rotation_derivatives(motion.angle)[order]
        field = 'vector' if order else 'point'
        said, sigma = (
            np.array([(getattr(m, field).x, getattr(m, field).y) for m in messages[name]])
            for name in (topic, f'{topic}/deviation')
        )
        off = said - np.stack((true.real, true.imag), axis=-1)
        # Of what it is in all: 0.3 m, 1.5 m/s, 12 m/s² and so on.
        assert np.median(np.abs(off)) < (1e-4, 2e-3, 0.1, 4)[order]
        assert np.mean(np.abs(off) < 1.96 * sigma) > 0.85


def test_paths_of_points_have_centers_which_are_withheld_near_an_inflection(
    bag: Path, tmp_path: Path
) -> None:
    """In topics and in tables: a radius there would be thousands of meters of either sign."""
    path = scene(tmp_path, 'bent', bent=('P: [0.1, 0.15]', 'P: [0.5, -0.1]'))
    messages = replayed(bag, tmp_path, path)
    begin = stamp_to_ns(decoded(bag)['/markers'][0].markers[0].header.stamp)
    loaded = load_scene(path)
    body, place = loaded.points['coupler.P']
    every = np.array([stamp_to_ns(m.header.stamp) for m in messages['/kinpole/coupler/odom']])
    topic = '/kinpole/coupler/points/P/path_radius'
    stamps = np.array([stamp_to_ns(message.header.stamp) for message in messages[topic]])

    def true(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        motion = loaded.motion((at - begin) * 1e-9)[body]
        v, a = (motion.position[k] + place * rotation_derivatives(motion.angle)[k] for k in (1, 2))
        radius = np.abs(v) ** 3 / (v.conj() * a).imag
        at_point = motion.position[0] + place * rotation_derivatives(motion.angle)[0]
        return radius, at_point + 1j * v / np.abs(v) * radius

    radius, center = true(stamps)
    assert {*np.sign(radius)} == {-1, 1}
    said, sigma = (
        np.array([message.vector.z for message in messages[name]])
        for name in (topic, f'{topic}/deviation')
    )
    assert (np.abs(said / radius - 1) < 1).all()
    assert np.mean(np.abs(said - radius) < 1.96 * sigma) > 0.9
    withheld = np.setdiff1d(every, stamps)
    assert 0 < len(withheld) < len(every) / 4
    assert np.abs(true(withheld)[0]).min() > np.median(np.abs(radius))
    points = messages['/kinpole/coupler/points/P/path_center']
    spreads = messages['/kinpole/coupler/points/P/path_center/deviation']
    off = np.array([complex(m.point.x, m.point.y) for m in points]) - center
    spread = np.array([complex(m.point.x, m.point.y) for m in spreads])
    for part in (np.real, np.imag):
        assert np.mean(np.abs(part(off)) < 1.96 * part(spread)) > 0.9


def test_the_state_of_a_result_bag_has_the_points_as_tables_and_topics_have_them(
    bag: Path, tmp_path: Path
) -> None:
    """A path that bends both ways, so that its radius is known at some instants only."""
    path = scene(tmp_path, 'bent', bent=('P: [0.1, 0.15]', 'P: [0.5, -0.1]'))
    table, output = tmp_path / 'out.csv', tmp_path / 'out.mcap'
    words = ['--config', str(config(tmp_path, path)), '--csv', str(table), '--output', str(output)]
    assert cli.main(['replay', str(bag), *words]) == 0
    columns = np.genfromtxt(table, delimiter=',', names=True)
    topics = decoded(output)
    states = read_messages(output, ['/kinpole/state'])
    ((stamps, quantities, _),) = read_state_blocks(message.data for message in states)
    found = {}
    for name in (name for name in quantities if '/' in name):
        # Other bodies have no such point.
        assert not quantities[name].determined[:, [0, 2]].any()
        value, spread, known = (part[:, 1] for part in quantities[name])
        assert known.any()
        assert not value[~known].any() and not spread[~known].any()
        of_topic = topics[f'/kinpole/coupler/{name}']
        assert stamps[known].tolist() == [stamp_to_ns(message.header.stamp) for message in of_topic]
        if np.iscomplexobj(value):
            ends = {'_x': value.real, '_y': value.imag}
            ends |= {'_x_sigma': spread[:, 0, 0] ** 0.5, '_y_sigma': spread[:, 1, 1] ** 0.5}
        else:
            ends = {'': value, '_sigma': spread**0.5}
        found |= {f'coupler_{name.replace("/", "_")}{end}': (ends[end], known) for end in ends}
    assert set(found) == {name for name in columns.dtype.names or () if '_points_' in name}
    for name, (values, known) in found.items():
        np.testing.assert_allclose(columns[name], np.where(known, values, np.nan), rtol=1e-14)
    assert not all(known.all() for _, known in found.values())


def test_the_state_of_exact_markers_has_the_motion_and_the_path_of_a_point(tmp_path: Path) -> None:
    path, clean = scene(tmp_path), tmp_path / 'clean.mcap'
    words = ['--duration', '1.5', '--rate', '200', '--output', str(clean)]
    assert cli.main(['simulate', str(path), *words]) == 0
    replayed(clean, tmp_path, path)
    states = read_messages(tmp_path / 'out.mcap', ['/kinpole/state'])
    ((stamps, quantities, _),) = read_state_blocks(message.data for message in states)
    begin = stamp_to_ns(decoded(clean)['/markers'][0].markers[0].header.stamp)
    loaded = load_scene(path)
    body, place = loaded.points['coupler.P']
    motion = loaded.motion((stamps - begin) * 1e-9)[body]
    exact = motion.position[:4] + place * rotation_derivatives(motion.angle)[:4]
    position, velocity, acceleration, jerk = exact
    radius = np.abs(velocity) ** 3 / (velocity.conj() * acceleration).imag
    true = {
        '': (position, 1e-12),
        '/velocity': (velocity, 1e-10),
        '/acceleration': (acceleration, 1e-7),
        '/jerk': (jerk, 1e-5),
        '/path_radius': (radius, 1e-7),
        '/path_center': (position + 1j * velocity / np.abs(velocity) * radius, 1e-7),
    }
    assert [f'points/P{end}' for end in true] == [name for name in quantities if '/' in name]
    for end, (values, bound) in true.items():
        value, _, determined = (part[:, 1] for part in quantities[f'points/P{end}'])
        assert determined.all()
        np.testing.assert_allclose(value, values, rtol=bound)


def test_what_a_quantity_of_the_scene_follows_from_is_computed_once(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Topics, their deviations, the state and the table read center and radius of a path."""
    calls: dict[str, list[Any]] = {'_paths': [], '_motion_of_points': []}

    def counted(compute: Any, estimates: list[Any]) -> Any:
        def computed(*arguments: Any) -> Any:
            estimates.append(arguments[-1])
            return compute(*arguments)

        return computed

    for name, estimates in calls.items():
        monkeypatch.setattr(theory, name, counted(getattr(theory, name), estimates))
    path, table = scene(tmp_path), tmp_path / 'out.csv'
    words = ['--config', str(config(tmp_path, path)), '--csv', str(table)]
    assert cli.main(['replay', str(bag), *words, '--output', str(tmp_path / 'out.mcap')]) == 0
    for estimates in calls.values():
        assert estimates
        assert len({*map(id, estimates)}) == len(estimates)


def test_centers_of_bodies_that_are_as_the_scene_says_are_on_the_line_of_the_pins(
    bag: Path, tmp_path: Path
) -> None:
    told = linkage(replayed(bag, tmp_path, scene(tmp_path)))
    assert told
    for values in told:
        assert abs(values.get('rocker wrt crank: the same in deviations', 0)) < 5


@pytest.mark.parametrize('size', [0.28, 0.3])
def test_replay_tells_how_far_the_joints_are_from_the_scene(
    size: float, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene(tmp_path, f'rocker_{size}', rocker=('B: [0.28, 0]', f'B: [{size}, 0]'))
    assert cli.main(['replay', str(bag), '--config', str(config(tmp_path, path))]) == 0
    told = {}
    for line in capsys.readouterr().out.splitlines():
        if line.startswith('joint '):
            subject, figures = line.removeprefix('joint ').split(': ')
            told[subject] = float(figures.split(', ')[1].split()[0])
    assert set(told) == {'O', 'A', 'B', 'C'}
    assert (max(told['B'], told['C']) < 3) == (size == 0.28)
    # The coupler, which is as described, meets the crank where it should.
    assert told['A'] < 3


def test_a_short_bag_is_held_against_the_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, bag = scene(tmp_path), tmp_path / 'short.mcap'
    words = ['--duration', '0.3', '--rate', '100', '--noise', '1e-4', '--output', str(bag)]
    assert cli.main(['simulate', str(path), *words]) == 0
    assert cli.main(['replay', str(bag), '--config', str(config(tmp_path, path))]) == 0
    assert 'joint B: off' in capsys.readouterr().out


def test_replay_says_where_a_scene_cannot_be_put_on_the_rig(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Positions, 'report', lambda _: None)
    assert cli.main(['replay', str(bag), '--config', str(config(tmp_path, scene(tmp_path)))]) == 0
    said = capsys.readouterr()
    assert 'joint ' not in said.out
    assert 'was compared at no instant: bodies that its joints connect' in said.err


def test_without_loads_there_is_no_balance(bag: Path, tmp_path: Path) -> None:
    messages = replayed(bag, tmp_path, scene(tmp_path, 'plain', loads=''))
    assert '/kinpole/balance' not in messages
    assert linkage(messages)


@pytest.mark.parametrize(
    ('name', 'says'),
    [
        ('nowhere', 'there is no such scene'),
        ('double_pendulum', 'it has markers on upper, lower, and the parameter bodies names crank'),
    ],
)
def test_a_scene_that_does_not_go_with_the_bodies_is_refused(
    tmp_path: Path, name: str, says: str, capsys: pytest.CaptureFixture[str], bag: Path
) -> None:
    path = config(tmp_path, name)
    with pytest.raises(ParameterError, match=says):
        load_theory(load_settings(path))
    assert cli.main(['replay', str(bag), '--config', str(path)]) == 2
    err = capsys.readouterr().err.strip()
    assert 'scene' in err
    assert '\n' not in err


@pytest.mark.parametrize(
    ('coupler', 'says'),
    [
        (
            ('coupler_1', 'else'),
            'its coupler has the markers coupler_1, coupler_2, coupler_3, coupler_4; parameter '
            'coupler.markers must name two of them at least',
        ),
        ((), 'it has a load on coupler, which is not tracked'),
    ],
)
def test_a_scene_needs_markers_of_its_bodies_and_bodies_of_its_loads(
    coupler: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    bodies = {**bodies_of('four_bar'), 'coupler': coupler}
    bodies = {body: markers for body, markers in bodies.items() if markers}
    with pytest.raises(ParameterError, match=says):
        load_theory(Settings(bodies=bodies, scene=str(scene(tmp_path))))


def test_of_a_record_without_estimates_nothing_is_compared(tmp_path: Path) -> None:
    theory = load_theory(load_settings(config(tmp_path, 'four_bar')))
    assert theory is not None
    assert Positions(theory.scene, theory.matches).report() is None


@pytest.mark.parametrize('name', scene_names())
def test_what_is_measured_of_exact_markers_is_what_is_solved(name: str) -> None:
    seen = record(name, count=700, step=2_000_000)
    _, found = follow(seen.frames, seen.values, order=4, every=40)
    found = [estimate for estimate in found if not any(estimate.missing)][3:]
    assert len(found) > 8
    truth = seen.truth([estimate.stamp for estimate in found])
    for b, body in enumerate(found[0].bodies):
        position, angle = truth[body]
        for order, close in ((1, 1e-6), (2, 1e-6), (3, 1e-6), (4, 1e-5)):
            poles = [estimate.pole(order) for estimate in found]
            true = planar.pole(order, position, angle).value
            off = np.abs(np.array([pole.value[b] for pole in poles]) - true) / found[0].size[b]
            near = np.abs(true - position[0]) < 20 * found[0].size[b]
            assert all(pole.determined[b] for pole, here in zip(poles, near, strict=True) if here)
            assert off[near].max(initial=0.0) < close, (body, order)
