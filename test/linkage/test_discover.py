"""kinpole discover: from markers alone to bodies, joints, lengths and files that work."""

import shlex
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import options_of

from kinpole_ros.bags import BagError, BagWriter
from kinpole_ros.linkage import (
    Linkage,
    UndiscoveredError,
    _rigid,
    discover,
    draft,
    parameter_file,
    table,
)
from kinpole_ros.linkage._body_poses import GROUND_NUMBER, fit_body, ground, refine_groups
from kinpole_ros.linkage._discover import candidate_pairs
from kinpole_ros.linkage._matches import match_markers
from kinpole_ros.linkage._record import gather, near_pairs
from kinpole_ros.linkage._rigid import Groups, quantiles
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import load_scene, marker_positions
from kinpole_ros.messages import to_message
from kinpole_ros.settings import ParameterError, settings_from
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.discover import discover_rig
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.statistics import medians

START = 10**18
NOISE = 2e-4
ROOT = Path(__file__).parents[2]
XY_COLUMNS = ((0, 'x'), (1, 'y'))


def rotation(degrees, axis=(1.0, 0.3, 0.0)):
    a = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    angle = np.deg2rad(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def markers_of(name, seconds, rate=200, noise=NOISE, hidden=0.05, tilt=0.0, scale=1.0, seed=0):
    """Frames of a scene's markers with their names, and the scene."""
    rng = np.random.default_rng(seed)
    scene = load_scene(name)
    t = np.arange(round(rate * seconds)) / rate
    motion = scene.motion(t)
    flat = np.concatenate([marker_positions(motion[b], m) for b, m in scene.markers.items()], 1)
    points = np.zeros((*flat.shape[:2], 3))
    points[..., :2] = flat
    points += noise * rng.normal(size=points.shape)
    points = scale * points @ rotation(tilt).T
    points[rng.random(points.shape[:2]) < hidden] = np.nan
    names = tuple(name for body in scene.markers for name in scene.marker_names[body])
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    return MarkerFrames(stamps, 'world', names, points), scene


def shuffled(frames, seed=0):
    """The same as points in another order in every frame, without those not seen."""
    rng = np.random.default_rng((seed, 1))
    parts = []
    for stamp, points in zip(frames.stamps, frames.points, strict=True):
        seen = rng.permutation(points[np.isfinite(points[:, 0])])
        names = tuple(map(str, range(len(seen))))
        parts.append(MarkerFrames(np.array([stamp]), 'world', names, seen[None]))
    return parts


def joined(linkage: Linkage):
    """Pairs of bodies by kind of joint."""
    found = [(j.kind, {linkage.name(j.one), linkage.name(j.other)}) for j in linkage.joints]
    return found + [
        ('rolling', {linkage.name(wheel.one), linkage.name(wheel.other)})
        for wheel in linkage.rolling
    ]


def assert_lengths(linkage: Linkage, scene, exact=1e-3):
    """Each length between joints is one of the scene's, to 0.1% or 3 deviations."""
    places = {}
    for body, z in scene.points.values():
        places.setdefault(body, []).append(z)
    joints = {place.name for place in linkage.places}
    found = [one for one in linkage.lengths() if {one.one, one.other} <= joints]
    for length in found:
        # Without names any body may be meant.
        bodies = [places[length.body]] if length.body in places else places.values()
        true = [abs(a - b) for one in bodies for a, b in combinations(one, 2)]
        off = min(abs(length.value - value) for value in true)
        assert off < max(exact * length.value, 3 * length.deviation), length
    return found


def test_four_bar_with_names_is_found_as_it_is():
    frames, scene = markers_of('four_bar', 5)
    found = discover([frames])
    assert found.names == ['crank', 'coupler', 'rocker']
    assert found.markers == [list(scene.marker_names[body]) for body in found.names]
    assert [place.name for place in found.places] == ['O', 'O2', 'A', 'B']
    ground = [place.on[-1] for place in found.places if -1 in place.on]
    assert np.abs(np.array(ground) - [0, 0.4]).max() < 1e-4
    assert found.freedom == 1
    assert (found.plane.name, found.scale) == ('xy', 1.0)
    assert len(assert_lengths(found, scene)) == 4
    # Deviations are those of the errors: about as many of them.
    assert all(1e-6 < one.deviation < 1e-4 for one in found.lengths())
    assert all(0.8 < joint.ratio < 1.2 for joint in found.joints)
    assert all(abs(pose.noise / NOISE - 1) < 0.1 for pose in found.poses)


def test_six_bar_in_mm_tilted_and_in_no_order():
    frames, scene = markers_of('six_bar', 3, tilt=30, scale=1000)
    found = discover(shuffled(frames))
    assert sorted(map(len, found.columns)) == [3] * 5
    assert [kind for kind, _ in joined(found)] == ['pin'] * 7
    assert sum('ground' in pair for _, pair in joined(found)) == 3
    assert found.scale == 0.001
    assert found.plane.tilt == pytest.approx(30, abs=0.1)
    assert np.abs(found.plane.normal - rotation(30)[:, 2]).max() < 1e-3
    assert len(assert_lengths(found, scene)) == 10
    text = parameter_file(found)
    assert 'scale: 0.001' in text
    assert 'marker_identity: shape' in text
    assert 'plane: [0.1' in text
    assert text.count('shape: [') == 5
    told = draft(found)
    assert told is not None
    assert not told[1].problem
    assert told[1].first < 3 * NOISE


@pytest.mark.parametrize('name, bodies', [('six_bar', 5), ('double_pendulum', 2), ('loader', 3)])
def test_bodies_are_told_apart_where_noise_is_a_tenth_of_their_motion(name, bodies):
    """Markers near a pin keep their distances to most of the next body, but not to all of it."""
    frames, scene = markers_of(name, 20, rate=100, noise=1e-3, seed=2)
    found = discover([frames])
    assert sorted(found.markers) == sorted(map(list, scene.marker_names.values()))
    assert len(found.names) == bodies


def test_bodies_in_no_order_of_which_a_marker_is_not_found_again():
    frames, _ = markers_of('antiparallelogram', 20, rate=100, noise=1e-3, tilt=30, scale=1000)
    assert len(discover(shuffled(frames)).names) == 3


@pytest.mark.parametrize('noise, said', [(2e-4, False), (1e-3, True)])
def test_points_left_over_are_told_of(noise, said):
    """At 1 mm two of the ten markers cannot be followed for long, and are on no body."""
    frames, _ = markers_of('four_bar', 20, rate=100, noise=noise, tilt=30, scale=1000, seed=1)
    found = discover(shuffled(frames))
    assert ('unassigned' in [note.code for note in found.notes]) == said
    assert (sum(map(len, found.markers)) < 10) == said


@pytest.mark.parametrize(
    'name, kinds',
    [
        ('slider_crank', ['pin', 'pin', 'slot']),
        ('cardan', ['trammel']),
        ('rolling_wheel', ['rolling']),
        ('planetary_gear', ['pin', 'pin', 'pin', 'pin', 'rolling', 'rolling']),
        ('loader_cylinder', ['pin', 'pin', 'pin', 'pin', 'pin', 'slot']),
        ('double_pendulum', ['pin', 'pin']),
        ('bike_suspension', ['pin']),
    ],
)
def test_joints_and_a_draft_that_closes(name, kinds):
    frames, scene = markers_of(name, 8, rate=100)
    found = discover([frames])
    assert len(found.names) == len(scene.markers)
    assert sorted(kind for kind, _ in joined(found)) == kinds
    assert found.freedom == (2 if name == 'double_pendulum' else 1)
    _, checked = draft(found)
    assert not checked.problem
    assert checked.first < 20 * NOISE
    lines = '\n'.join(table(found, checked))
    assert 'the draft scene closes' in lines


def test_radii_of_wheels_and_gears():
    (wheel,) = discover([markers_of('rolling_wheel', 4)[0]]).rolling
    assert wheel.radius == pytest.approx(0.1, rel=1e-3)
    gears = discover([markers_of('planetary_gear', 4)[0]]).rolling
    assert sorted(gear.circle for gear in gears) == pytest.approx([-0.048, 0.024], rel=2e-3)
    assert [gear.radius for gear in gears] == pytest.approx([0.012, 0.012], rel=2e-3)


def test_names_exchanged_for_some_frames_do_no_harm():
    frames, scene = markers_of('four_bar', 5)
    bad = np.random.default_rng(0).random(len(frames.stamps)) < 0.02
    points = frames.points.copy()
    points[bad] = points[bad][:, [1, 0, 2, 3, 4, 5, 6, 7, 8, 9]]
    found = discover([frames._replace(points=points)])
    assert found.markers == [list(scene.marker_names[body]) for body in found.names]
    assert len(assert_lengths(found, scene)) == 4


@pytest.mark.parametrize('seed', range(4))
def test_names_exchanged_for_good_are_named_and_do_no_harm(seed):
    frames, scene = markers_of('four_bar', 10, seed=seed)
    points, at, two = frames.points.copy(), 600 + 37 * seed, [2, 3]
    points[at:, two] = points[at:, two[::-1]]
    found = discover([frames._replace(points=points)])
    assert found.markers == [list(scene.marker_names[body]) for body in found.names]
    assert_lengths(found, scene)
    one, other = (frames.identities[k] for k in two)
    (note,) = found.notes
    assert note.words().startswith(f'{one!r} and {other!r} exchange names at {at / 200:.2f} s')


@pytest.mark.parametrize('seed', range(5))
def test_markers_that_pass_each_other_while_one_is_hidden_do_not_exchange_names(seed):
    """Two legs of a walk: a marker that was hidden for long may lead to any other one's place."""
    rng = np.random.default_rng(seed)
    t = np.arange(600) / 75
    flat = []
    for phase in (0.0, np.pi):
        step = 2 * np.pi * t + phase
        hip = 0.2 + 0.9j + 1.0 * t
        knee = hip + 0.45 * np.exp(1j * (-np.pi / 2 + 0.1 + 0.45 * np.sin(step)))
        shank = np.exp(1j * (-np.pi / 2 - 0.4 + 0.5 * np.sin(step - 1.2)))
        ankle = knee + 0.42 * shank
        foot = np.exp(1j * (-0.2 + 0.6 * np.sin(step - 1.7)))
        flat += [knee - 0.05 * shank, knee + (0.1 + 0.05j) * shank, ankle + 0.01 * shank]
        flat += [ankle - 0.06 * foot, ankle + 0.1 * foot, ankle + (0.13 - 0.03j) * foot]
    points = np.stack((np.real(flat).T, np.imag(flat).T, np.zeros((len(t), len(flat)))), axis=-1)
    points[..., :2] += NOISE * rng.normal(size=points[..., :2].shape)
    hidden = rng.random(points.shape[:2]) < 0.015
    for late in range(15):
        points[late:][hidden[: len(t) - late]] = np.nan
    names = tuple(f'm{k}' for k in range(len(flat)))
    record, _ = gather([MarkerFrames(START + np.rint(t * 1e9).astype(int), 'w', names, points)])
    assert record.names == names
    assert not record.exchanged


@pytest.mark.parametrize('scale, words', [(1, 'm'), (1000, 'scale 0.001)'), (39.37, 'inches')])
def test_another_unit_that_is_as_likely_is_named(scale, words):
    frames, _ = markers_of('four_bar', 3, scale=scale)
    (line,) = [line for line in table(discover([frames]), None) if line.startswith('unit:')]
    assert line.endswith(words) or words in line
    assert ('0.0254' in line) == (words == 'inches')


def test_names_that_change_in_every_frame_are_not_believed():
    frames, _ = markers_of('four_bar', 2, hidden=0.0)
    order = np.argsort(np.random.default_rng(0).random(frames.points.shape[:2]), axis=1)
    mixed = np.take_along_axis(frames.points, order[..., None], 1)
    found = discover([frames._replace(points=mixed)])
    assert not found.ordered
    assert sorted(map(len, found.columns)) == [3, 3, 4]


def test_a_marker_on_the_axis_of_a_pin_is_of_both_bodies():
    # As on the measured double pendulum: a marker on the pivot, one on the joint, one at the end.
    t = np.arange(2000) / 200
    joint = np.exp(1j * 1.2 * np.sin(3 * t)) * 0.3
    end = joint + 0.2 * np.exp(1j * 2.0 * np.sin(4.3 * t + 1))
    flat = np.stack((0 * t, joint, end), axis=1) + 1.0
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += NOISE * np.random.default_rng(0).normal(size=points.shape)
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    found = discover([MarkerFrames(stamps, 'world', ('red', 'green', 'blue'), points)])
    assert found.markers == [['red', 'green'], ['green', 'blue']]
    values = [one.value for one in found.lengths()]
    assert values == pytest.approx([0.3, 0.2], abs=1e-4)
    assert found.places[0].on[-1] == pytest.approx(1.0, abs=1e-4)


def test_what_stands_still_is_told_apart():
    frames, _ = markers_of('four_bar', 3)
    base = np.array([(0.0, -0.1, 0.0), (0.3, -0.1, 0.0)])
    still = base + NOISE * np.random.default_rng(1).normal(size=(len(frames.stamps), 2, 3))
    names = (*frames.identities, 'base_1', 'base_2')
    both = np.concatenate((frames.points, still), axis=1)
    found = discover([frames._replace(points=both, identities=names)])
    assert found.fixed == [10, 11]
    assert found.names == ['crank', 'coupler', 'rocker']


def test_what_cannot_be_told_is_said():
    # A plate that is carried around without turning.
    t = np.arange(1000) / 200
    center = 0.1 * np.exp(2j * t)
    flat = center[:, None] + np.array([0, 0.1, 0.05 + 0.1j])
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += NOISE * np.random.default_rng(0).normal(size=points.shape)
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    found = discover([MarkerFrames(stamps, 'world', ('a', 'b', 'c'), points)])
    assert found.joints == []
    assert 'no_turn' in [note.code for note in found.notes]
    assert draft(found) is None


@pytest.mark.parametrize(
    'change, words',
    [
        (lambda p: p[:, :1], 'one marker'),
        (lambda p: p[:, :0], 'no marker'),
        (lambda p: p[:10], 'too few'),
        (lambda p: p[:1] + 1e-4 * np.sin(np.arange(p.size) ** 2).reshape(p.shape), 'moves'),
        (lambda p: p[:, [0, 4, 8]], 'keep their distance'),
    ],
)
def test_too_little_is_refused_with_the_fix(change, words):
    frames, _ = markers_of('four_bar', 1, hidden=0.0)
    points = change(frames.points)
    names = tuple(f'm{k}' for k in range(points.shape[1]))
    frames = MarkerFrames(frames.stamps[: len(points)], 'world', names, points)
    with pytest.raises(UndiscoveredError, match=f'{words}.*; fix: '):
        discover([frames])


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('order', ['named', 'unnamed'])
@pytest.mark.parametrize(
    'change',
    [
        lambda p: p[:21],
        lambda p: p[:, :2],
        lambda p: 0 * p,
        lambda p: p[:1] + 0 * p,
        lambda p: p + 1e9,
        lambda p: p * np.array([1, 0, 0]),
        lambda p: p[:, :1] + 0 * p,
        lambda p: np.where(np.arange(len(p))[:, None, None] % 20 == 0, p, np.nan),
        lambda p: np.where(np.arange(p.shape[1])[:, None] % 3 == 0, np.nan, p),
        lambda p: np.where(
            np.random.default_rng(0).random(p.shape[:2])[..., None] < 0.1, p, np.nan
        ),
        lambda p: np.where(
            (np.arange(len(p)) < 50)[:, None, None] == (np.arange(p.shape[1]) < 5)[:, None],
            p,
            np.nan,
        ),
    ],
)
def test_odd_markers_are_discovered_or_refused_without_a_warning(change, order):
    frames, _ = markers_of('four_bar', 0.5, hidden=0.0)
    points = change(frames.points)
    names = tuple(f'm{k}' for k in range(points.shape[1]))
    frames = MarkerFrames(frames.stamps[: len(points)], 'world', names, points)
    parts = [frames] if order == 'named' else shuffled(frames)
    try:
        found = discover(parts)
    except UndiscoveredError as error:
        assert '; fix: ' in str(error)
        return
    assert table(found, (draft(found) or (None, None))[1])


def test_bodies_whose_markers_are_never_seen_together_are_none():
    frames, _ = markers_of('four_bar', 1, hidden=0.0)
    tracks = frames.points[:, :2, 0] + 1j * frames.points[:, :2, 1]
    tracks[::2, 0], tracks[1::2, 1] = np.nan, np.nan
    assert not fit_body(tracks).seen.any()
    groups = Groups([[0, 1]], [], [])
    assert refine_groups(tracks, groups) == (groups._replace(bodies=[], single=[0, 1]), [])


def test_command_writes_what_replay_and_solve_take(tmp_path, capsys):
    bag, rig, scene = ROOT / 'bags/four_bar.mcap', tmp_path / 'rig.yaml', tmp_path / 'draft.yaml'
    picture = tmp_path / 'rig.png'
    words = ['discover', str(bag), '--output', str(rig), '--scene', str(scene)]
    drawing = pytest.importorskip('matplotlib') and ['--plot', str(picture)]
    assert main([*words, *drawing]) == 0
    printed = capsys.readouterr().out
    assert 'pin A' in printed
    assert 'the draft scene closes' in printed
    assert picture.read_bytes()[:4] == b'\x89PNG'
    assert 'plane: xy\n' in rig.read_text()
    assert main(['replay', str(bag), '--config', str(rig)]) == 0
    assert 'coupler: determined at icr 9' in capsys.readouterr().out
    assert main(['solve', str(scene), '--centers']) == 0
    assert 'driven: crank' in capsys.readouterr().out


def test_command_refuses_in_one_line(tmp_path, capsys):
    assert main(['discover', str(tmp_path / 'none.mcap')]) == 2
    bag = tmp_path / 'still.mcap'
    with BagWriter(bag) as writer:
        for k in range(50):
            points = np.array([(0.0, 0, 0), (1.0, 0, 0)])
            message = to_message('pose_array', START + k * 10**7, 'world', ['a', 'b'], points)
            writer.write('/points', message, START + k * 10**7)
    assert main(['discover', str(bag)]) == 2
    assert main(['discover', str(bag), '--seconds', '0']) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert 'none of 2 markers moves; fix: ' in lines[1]
    with pytest.raises(BagError, match='it holds /points'):
        discover_rig(options_of('discover', str(bag), topic='/other'))


@pytest.mark.parametrize(
    'name',
    [
        *('four_bar', 'slider_crank', 'cardan'),
        # The markers of two links, or of two turns of one, look about the same.
        *('trebuchet', 'exercise_machine', 'exercise_seat'),
        # Two links, or nearly two, have the same shape: their pins tell them apart.
        *('antiparallelogram', 'eight_bar'),
        # Radii that have to add up to the length of the arm.
        'planetary_gear',
    ],
)
def test_rig_and_draft_of_markers_without_names_are_fitted_and_replayed_unedited(
    name, tmp_path, capsys
):
    bag, rig, scene = tmp_path / 'r.mcap', tmp_path / 'rig.yaml', tmp_path / 'draft.yaml'
    fitted = tmp_path / 'fitted.yaml'
    made = ['--tilt', '20', '--arrival', '0.001', '--scale', '1000', '--message', 'point_cloud2']
    made += ['--unlabeled', '--noise', '0.0002', '--duration', '2', '--output', str(bag)]
    assert main(['simulate', name, *made]) == 0
    assert main(['discover', str(bag), '--output', str(rig), '--scene', str(scene)]) == 0
    assert 'marker_identity: shape' in rig.read_text()
    capsys.readouterr()
    words = ['fit', str(scene), str(bag), '--config', str(rig), '--output', str(fitted)]
    assert main(words) == 0
    *rows, last, written = capsys.readouterr().out.splitlines()
    assert written == f'written to {fitted}'
    assert sum(', deviation ' in row for row in rows) >= 2
    # The draft already fits the markers that it was drawn from.
    ratio = float(last.partition('chi^2/n ')[2].split()[0])
    assert 0.3 < ratio < 3
    with rig.open('a') as file:
        file.write(f'    scene: {fitted}\n')
    assert main(['replay', str(bag), '--config', str(rig)]) == 0


def test_a_fit_leaves_no_more_than_the_draft_that_it_began_with(tmp_path, capsys):
    """Its slot ends 3 m away, so that full steps of the fit lead to lengths of 1e12 m."""
    bag, rig, scene = tmp_path / 'r.mcap', tmp_path / 'rig.yaml', tmp_path / 'draft.yaml'
    made = ['--tilt', '20', '--arrival', '0.001', '--scale', '1000', '--message', 'point_cloud2']
    made += ['--unlabeled', '--noise', '0.0002', '--seed', '1', '--output', str(bag)]
    assert main(['simulate', 'loader_cylinder', '--duration', '3', *made]) == 0
    assert main(['discover', str(bag), '--output', str(rig), '--scene', str(scene)]) == 0
    capsys.readouterr()
    assert main(['fit', str(scene), str(bag), '--config', str(rig)]) == 0
    (line,) = [row for row in capsys.readouterr().out.splitlines() if row.startswith('chi^2/n')]
    assert float(line.split()[1]) < float(line.split()[-1])


def test_markers_without_noise_are_of_one_rigid_body(tmp_path, capsys):
    bag, rig = tmp_path / 'r.mcap', tmp_path / 'rig.yaml'
    made = ['--tilt', '20', '--arrival', '0.001', '--scale', '1000', '--message', 'point_cloud2']
    made += ['--unlabeled', '--duration', '3', '--output', str(bag)]
    assert main(['simulate', 'planetary_gear', *made]) == 0
    assert main(['discover', str(bag), '--output', str(rig)]) == 0
    capsys.readouterr()
    assert main(['replay', str(bag), '--config', str(rig)]) == 0
    assert 'off one rigid body' not in capsys.readouterr().err


def test_a_draft_whose_markers_are_not_those_of_the_shape_is_refused(tmp_path):
    shape = [0.0, 0.0, 0.1, 0.0, 0.0, 0.05]
    rig = {'bodies': ['crank'], 'marker_identity': 'shape', 'crank.shape': shape}
    scene = tmp_path / 'scene.yaml'
    text = (ROOT / 'config/scenes/four_bar.yaml').read_text()
    # The mirror image of the crank's markers: no pose of it puts them there.
    points = '{crank_1: [0, 0], crank_2: [0.1, 0], crank_3: [0, -0.05]}'
    head, _, tail = text.partition('  crank:\n    crank_1')
    scene.write_text(f'{head}  crank: {points}\n  coupler:{tail.partition("  coupler:")[2]}')
    with pytest.raises(ParameterError, match=r'not where parameter crank\.shape has them; '):
        load_theory(settings_from({**rig, 'scene': str(scene)}))


def test_markers_of_two_drawings_are_paired_by_their_places():
    places = np.array([0, 0.1, 0.03 + 0.05j, 0.08 - 0.02j])
    order = np.array([2, 0, 3, 1])
    other = (places * np.exp(0.7j) + 3)[order]
    one, two = match_markers(places, other)
    assert np.array_equal(order[two], one)
    # A marker that only one of them has.
    one, two = match_markers(places[1:], other)
    assert np.array_equal(order[two], one + 1)
    one, two = match_markers(places, other[1:])
    assert np.array_equal(order[1:][two], one)
    assert match_markers(places[:1], other) is None


@pytest.mark.parametrize('noise', [0.0, NOISE])
@pytest.mark.parametrize('name', ['loader_cylinder', 'planetary_gear'])
def test_a_draft_closes_where_a_joint_or_a_pin_only_seems_to_be_another(name, noise):
    """A cylinder that nearly moves as a trammel would; three bodies on one pin at the origin."""
    frames, _ = markers_of(name, 5, noise=noise, hidden=0.0, tilt=20)
    found = discover([frames])
    assert found.freedom >= 1
    drawn = draft(found)
    assert drawn is not None
    assert not drawn[1].problem


@pytest.mark.parametrize(('name', 'told'), [('loader_cylinder', True), ('slider_crank', False)])
def test_a_slide_that_may_be_on_either_body_is_noted(name, told):
    """The cylinder turns by 13 degrees only: a line on the ground fits as well as its own."""
    frames, _ = markers_of(name, 4)
    notes = discover([frames]).notes
    lines = [note.values['other'] for note in notes if note.code == 'line_of_either']
    assert ('ground' in lines) == told


# --- many bodies --------------------------------------------------------------------------------


def grid_of_bodies(count: int, frames: int = 100) -> np.ndarray:
    """Markers (T, 4 count, 3), four a body, of bodies that turn and move about their places."""
    rng = np.random.default_rng(count)
    time = np.arange(frames)[:, None] / 100
    kite = np.array([0.13 + 0.02j, -0.03 + 0.1j, -0.12 - 0.05j, 0.05 - 0.11j])
    rate, phase = rng.uniform(2, 5, (3, count)), rng.uniform(0, 6, (3, count))
    swing = np.sin(rate[:, None] * time + phase[:, None])
    center = 0.6 * (np.arange(count) % 10 + 1j * (np.arange(count) // 10))
    place = center + 0.06 * (swing[0] + 1j * swing[1])
    flat = (place[..., None] + np.exp(1j * swing[2])[..., None] * kite).reshape(frames, -1)
    flat = flat + 1e-4 * (rng.normal(size=(2, *flat.shape)).T @ (1, 1j)).T
    return np.stack((flat.real, flat.imag, np.zeros(flat.shape)), axis=-1)


def test_forty_bodies_are_found() -> None:
    names = tuple(f'b{k // 4}_m{k % 4}' for k in range(160))
    stamps = 10**9 + np.arange(100) * 10_000_000
    found = discover([MarkerFrames(stamps, 'map', names, grid_of_bodies(40))])
    assert sorted(found.columns) == [[4 * k + m for m in range(4)] for k in range(40)]


def test_distances_are_sorted_once_a_marker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each pair of markers had a quantile of its own: 720,000 of 1,200 markers."""
    calls = 0

    def counted(*args: Any) -> Any:
        nonlocal calls
        calls += 1
        return quantiles(*args)

    monkeypatch.setattr(_rigid, 'quantiles', counted)
    points = grid_of_bodies(10)
    tracks = points[..., 0] + 1j * points[..., 1]
    groups = _rigid.group(tracks, np.full(40, 1e-4))
    assert sorted(groups.bodies) == [[4 * k + m for m in range(4)] for k in range(10)]
    assert calls <= 41


def test_quantiles_of_rows_are_those_of_numpy() -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(50, 101))
    rows[10:][rng.random((40, 101)) < 0.3] = np.nan
    found, counts = quantiles(rows, (0.01, 0.9))
    middle = medians(rows)
    for k, row in enumerate(rows):
        values = row[np.isfinite(row)]
        assert counts[k] == len(values)
        assert found[:, k].tolist() == np.quantile(values, (0.01, 0.9)).tolist()
        assert middle[k] == np.median(values)


def test_points_are_compared_with_near_ones_only() -> None:
    rng = np.random.default_rng(4)
    compared = {}
    for count in (200, 400):
        points = rng.uniform(0, count, (count, 3))
        others = points + 0.1 * rng.normal(size=points.shape)
        others[::7] = np.nan
        reach = np.linalg.norm(points - others, axis=1)
        one, other = near_pairs(points, others, reach)
        compared[count] = len(one)
        nearer = np.linalg.norm(points[:, None] - others, axis=-1) <= reach[:, None]
        assert set(zip(*np.nonzero(nearer), strict=True)) <= set(zip(one, other, strict=True))
    assert compared[400] < 3 * compared[200]


def test_joints_are_sought_between_near_bodies_only() -> None:
    """Pairs of all bodies, each with a fit of its own, grew with the square."""
    pairs = {}
    for count in (20, 100, 200):
        points = grid_of_bodies(count, 30)
        tracks = points[..., 0] + 1j * points[..., 1]
        bodies = {k: fit_body(tracks[:, 4 * k : 4 * k + 4]) for k in range(count)}
        bodies[GROUND_NUMBER] = ground(30)
        pairs[count] = candidate_pairs(bodies)
        # A body with the ground, and with the next one in its row.
        assert all((k, GROUND_NUMBER) in pairs[count] for k in range(count))
        assert all((k, k + 1) in pairs[count] for k in range(count - 1) if k % 10 < 9)
    assert len(pairs[20]) == 210
    assert len(pairs[200]) < 2.3 * len(pairs[100])


def test_a_filmed_double_pendulum_has_two_pins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The real recording of the repository, with the figures that its page gives."""
    told = (ROOT / 'examples' / 'double_pendulum' / 'README.md').read_text(encoding='utf-8')
    (line,) = [line for line in told.splitlines() if line.startswith('kinpole report')]
    _, _, file, *figures = shlex.split(line)
    bag = str(tmp_path / 'pendulum.mcap')
    assert main(['import', str(ROOT / file), *figures, '--output', bag]) == 0
    capsys.readouterr()
    assert main(['discover', bag]) == 0
    text = ' '.join(capsys.readouterr().out.split())
    assert 'pin O body_1 ground' in text
    assert 'pin A body_1 body_2' in text
    assert 'O-A body_1 90.96' in text
    assert 'A-blue body_2 69.5' in text


def exchanged_columns() -> MarkerFrames:
    """A four-bar in which the x of the first two markers of the crank are exchanged."""
    frames, _ = markers_of('four_bar', 4, hidden=0.0)
    points = frames.points.copy()
    points[:, [0, 1], 0] = points[:, [1, 0], 0]
    return frames._replace(points=points)


def test_two_markers_with_one_coordinate_exchanged_are_no_trammel() -> None:
    linkage = discover([exchanged_columns()])
    assert [joint.kind for joint in linkage.joints] == ['pin', 'pin']
    assert ('trammel_or_pin', 'crank') in [note[:2] for note in linkage.notes]


def test_report_says_of_a_table_what_discover_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = exchanged_columns()
    named = enumerate(frames.identities)
    columns = {
        f'{name}_{axis}': frames.points[:, k, i] for k, name in named for i, axis in XY_COLUMNS
    }
    rows = np.stack([(frames.stamps - START) * 1e-9, *columns.values()], axis=1)
    path, bag = tmp_path / 'a.csv', tmp_path / 'a.mcap'
    np.savetxt(path, rows, '%.7f', ',', header=','.join(['t', *columns]), comments='')
    assert main(['import', str(path), '--output', str(bag)]) == 0
    capsys.readouterr()
    assert main(['discover', str(bag)]) == 0
    found = capsys.readouterr().out.splitlines()
    assert main(['report', str(path), '--output', str(tmp_path / 'a.html')]) == 0
    reported = capsys.readouterr().out.splitlines()
    first = next(k for k, line in enumerate(found) if line.startswith('joint'))
    said = [line for line in found[first:] if line and not line.startswith('the draft')]
    assert any(line.startswith('length') for line in said)
    start = reported.index(said[0])
    assert reported[start : start + len(said)] == said
