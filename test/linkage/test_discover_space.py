"""kinpole discover on markers in space: bodies, planes, axes and joints, simulated and real."""

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import options_of
from test_discover import START, rotation, shuffled

from kinpole_ros.bags import BagError, import_points, read_frames
from kinpole_ros.linkage import Checked, Linkage, UndiscoveredError, discover, draft, table
from kinpole_ros.settings import settings_from
from kinpole_ros.tools.discover import discover_rig
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.space import Space

DATA = Path(__file__).parents[3] / 'shared' / 'data'
RATE, NOISE = 100, 2e-4


def turned(vectors):
    """Rotation matrices (T, 3, 3) of rotation vectors (T, 3), rad."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    x, y, z = (vectors / np.maximum(angle, 1e-12)).T
    zero = np.zeros(len(x))
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    a = angle[:, :, None]
    return np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross


def leg(sway, soft=0.0, tilt=0.0, hidden=0.05, seed=0, seconds=6.0):
    """
    A walking trunk, thigh, shank and foot of four markers each, in the plane xz, turned by `tilt`.

    Joints are at hip, knee and ankle; `sway`, rad, turns all out of the plane; skin moves markers
    by `soft`, m, slowly and each in its own way.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(RATE * seconds)) / RATE
    step = 2 * np.pi * 0.9 * t
    flex = np.cumsum(
        [
            0.05 * np.sin(2 * step),
            0.45 * np.sin(step),
            -0.5 + 0.5 * np.sin(step - 1.2),
            0.2 + 0.4 * np.sin(step - 2.0),
        ],
        axis=0,
    )
    origin = np.stack((1.2 * t, 0.0 * t, 0.9 + 0.03 * np.sin(2 * step)), axis=1)
    points, names = [], []
    for number, (name, length) in enumerate(
        (('trunk', 0.0), ('thigh', 0.42), ('shank', 0.4), ('foot', 0.2))
    ):
        swayed = sway * np.sin(0.37 * step + number), sway * np.cos(0.61 * step)
        vectors = np.stack((swayed[0], flex[number], swayed[1]), axis=1)
        frames = turned(vectors)
        reach = 0.45 if name == 'trunk' else -length
        local = np.array([[0.08, 0, 0], [-0.06, 0.06, 0.4], [0.05, -0.07, 0.7], [0, 0.05, 0.95]])
        local = local * [1, 1, reach] + 0.01 * rng.normal(size=(4, 3))
        skin = np.sin(2 * np.pi * rng.uniform(0.3, 1.5, (4, 3)) * t[:, None, None])
        moved = local + soft * skin
        points.append(origin[:, None] + np.einsum('tij,tnj->tni', frames, moved))
        names += [f'{name}{k}' for k in range(4)]
        origin = origin + frames @ np.array([0, 0, -length])
    points = np.concatenate(points, axis=1) @ rotation(tilt).T
    points += NOISE * rng.normal(size=points.shape)
    points[rng.random(points.shape[:2]) < hidden] = np.nan
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    return MarkerFrames(stamps, 'world', tuple(names), points)


def degrees_between(one, other):
    return float(np.degrees(np.arccos(min(abs(float(one @ other)), 1.0))))


LEG = ['trunk', 'thigh', 'shank', 'foot']


def segments(found):
    """
    Names of the leg's segments by number of the body that has all of their markers.

    A marker over a joint may be on two bodies, where skin moves it by as much as the joint does.
    """
    names = {}
    for number, markers in enumerate(found.markers):
        (own,) = [name for name in LEG if {f'{name}{k}' for k in range(4)} <= set(markers)]
        assert len(markers) < 6
        names[number] = own
    assert sorted(names.values()) == sorted(LEG)
    return names


@pytest.mark.parametrize('soft, off', [(0.0, 0.05), (0.005, 3.0)])
@pytest.mark.parametrize('tilt', [0, 35])
def test_a_planar_chain_is_found_in_any_plane_on_skin_too(tilt, soft, off):
    found = discover([leg(0.0, soft, tilt)])
    names = segments(found)
    assert found.space is None
    assert degrees_between(found.plane.normal, rotation(tilt)[:, 1]) < off
    pins = {frozenset(names.get(k, '') for k in (j.one, j.other)) for j in found.joints}
    assert {frozenset(pair) for pair in pairwise(LEG)} <= pins
    assert all(length.value < 2 for length in found.lengths())


@pytest.mark.parametrize('soft', [0.0, 0.005])
@pytest.mark.parametrize('seed', range(3))
def test_a_chain_that_sways_is_not_planar_and_its_joints_are_in_space(seed, soft):
    found = discover([leg(0.2, soft, 20, seed=seed)])
    names = segments(found)
    assert found.space is not None
    assert degrees_between(found.plane.normal, rotation(20)[:, 1]) < 3
    pairs = {frozenset((names[j.one], names[j.other])) for j in found.space.joints}
    assert pairs == {frozenset(pair) for pair in pairwise(LEG)}
    if not soft:
        assert all(joint.residual < 5 * NOISE for joint in found.space.joints)
    assert draft(found) is None
    lines = '\n'.join(table(found, None))
    assert 'plane:   not one: bodies leave any plane by up to' in lines
    assert 'degrees of freedom' not in lines


def test_a_body_on_a_fixed_ball_joint_has_its_center():
    rng = np.random.default_rng(1)
    t = np.arange(600) / RATE
    turns = turned(0.5 * np.sin(2 * np.pi * np.array([0.41, 0.27, 0.33]) * t[:, None]))
    shape, center = 0.1 * rng.normal(size=(5, 3)) - [0, 0, 0.3], np.array([1.0, 2.0, 0.5])
    points = center + np.einsum('tij,nj->tni', turns, shape)
    points += NOISE * rng.normal(size=points.shape)
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    found = discover([MarkerFrames(stamps, 'world', tuple('abcde'), points)])
    assert found.space is not None
    (joint,) = found.space.joints
    assert found.name(joint.other) == 'ground'
    assert np.abs(joint.on_other - center).max() < 1e-3
    assert 'body_1 ground' in '\n'.join(table(found, None))


def test_several_walkers_are_kept_apart():
    walkers = []
    for k in range(4):
        frames = leg(0.2, 0.003, 20, seed=k)
        points = frames.points[25 * k : 25 * k + 500] * (1 + 0.05 * k) + [0, 1.5 * k, 0]
        names = tuple(f'{name}_{k}' for name in frames.identities)
        walkers.append((names, points))
    stamps = leg(0.0).stamps[:500]
    names = tuple(name for own, _ in walkers for name in own)
    points = np.concatenate([own for _, own in walkers], axis=1)
    found = discover([MarkerFrames(stamps, 'world', names, points)])
    assert len(found.names) == 16
    assert all(len({name[-1] for name in markers}) == 1 for markers in found.markers)
    assert found.space is not None
    assert len(found.space.joints) == 12


def test_a_film_of_a_chain_on_skin_has_its_segments_and_pins():
    """A camera shows what sways as bodies that are not quite rigid: nothing slides or rolls."""
    frames = leg(0.05, 0.002, hidden=0.0)
    points = frames.points[..., [0, 2, 1]] * [1, 1, 0]
    found = discover([frames._replace(points=points)])
    names = segments(found)
    assert found.space is None
    assert found.plane.name == 'xy'
    assert {joint.kind for joint in found.joints} == {'pin'}
    assert not found.rolling
    pins = {frozenset(names.get(k, '') for k in (j.one, j.other)) for j in found.joints}
    assert {frozenset(pair) for pair in pairwise(LEG)} <= pins


def test_a_hinge_has_its_axis_and_a_ball_joint_its_center():
    """A plate that turns anyhow, an arm on a hinge of it, and a hand on a ball joint of the arm."""
    rng = np.random.default_rng(3)
    t = np.arange(800) / RATE
    waves = np.sin(2 * np.pi * np.array([0.31, 0.47, 0.23]) * t[:, None] + [0, 1, 2])
    plate = turned(0.6 * waves)
    axis = np.array([0.6, 0.0, 0.8])
    arm = plate @ turned(1.0 * np.sin(3.0 * t)[:, None] * axis)
    hand = arm @ turned(0.7 * waves[:, [2, 0, 1]])
    at = 0.2 * waves
    ball = at + arm @ np.array([0.0, 0.3, 0.0])
    shapes = 0.1 * rng.normal(size=(3, 4, 3))
    points = np.concatenate(
        [
            origin[:, None] + np.einsum('tij,nj->tni', frames, shape)
            for origin, frames, shape in zip(
                (at, at, ball), (plate, arm, hand), shapes, strict=True
            )
        ],
        axis=1,
    )
    points += NOISE * rng.normal(size=points.shape)
    names = tuple(f'{body}{k}' for body in ('plate', 'arm', 'hand') for k in range(4))
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    found = discover([MarkerFrames(stamps, 'world', names, points)])
    assert sorted(found.names) == ['arm', 'hand', 'plate']
    space = found.space
    assert space is not None
    joints = {frozenset((found.names[j.one], found.names[j.other])): j for j in space.joints}
    hinge, center = joints[frozenset(('plate', 'arm'))], joints[frozenset(('arm', 'hand'))]
    assert len(joints) == 2
    assert hinge.axis is not None
    assert center.axis is None
    # Shapes are in the axes of the first full frame: so are the places on them.
    number = found.names.index('hand')
    on_hand = center.on_one if center.one == number else center.on_other
    own = np.array([found.markers[number].index(f'hand{k}') for k in range(4)])
    shape = space.solid[number].shape[own]
    true = shapes[2]
    distances = np.linalg.norm(shape - on_hand, axis=1)
    assert distances == pytest.approx(np.linalg.norm(true, axis=1), abs=5 * NOISE)


@pytest.mark.parametrize(
    'checked, words',
    [
        (Checked('', 1e-4, 1e-4, 1e-4), '(1.0 x noise), 0.1 mm over 2 s'),
        (Checked('', 1e-4, 1e-2, 1e-4), 'its drivers are a first guess'),
        (Checked('', 1e-2, 1e-2, 1e-4), 'does not explain the markers'),
        (Checked('no loop', np.nan, np.nan, 1e-4), 'does not close: no loop'),
    ],
)
def test_a_draft_is_said_to_explain_the_markers_or_not(checked, words):
    line = table(discover([leg(0.0, hidden=0.0)]), checked)[-1]
    assert words in line
    assert checked.explains == (checked.first < 1e-3)


def test_points_without_names_that_leave_any_plane_are_refused_with_the_reason():
    with pytest.raises(
        UndiscoveredError, match=r'leave any plane by .*fix: give the markers names'
    ):
        discover(shuffled(leg(0.2, hidden=0.0)))


def test_markers_that_stand_still_are_said_to():
    points = leg(0.2, hidden=0.0).points[:1] + 1e-4 * np.random.default_rng(0).normal(
        size=(300, 16, 3)
    )
    points += 0.004 * np.sin(np.arange(300) / 40)[:, None, None]
    frames = leg(0.2)
    still = MarkerFrames(frames.stamps[:300], 'world', frames.identities, points)
    with pytest.raises(UndiscoveredError, match='stand still'):
        discover([still])


def test_a_line_does_not_show_its_plane_and_one_may_be_given(tmp_path):
    """A slide along x: its markers lie in zx."""
    rng = np.random.default_rng(0)
    t = np.arange(400) / RATE
    local = np.array([[0, 0, 0], [0.1, 0, 0.05], [0.05, 0, -0.08]])
    points = local + np.stack((np.sin(t), 0 * t, 0 * t), 1)[:, None] * 0.2
    points = points + NOISE * rng.normal(size=points.shape)
    stamps = START + np.rint(t * 1e9).astype(np.int64)
    frames = [MarkerFrames(stamps, 'world', ('a', 'b', 'c'), points)]
    found = discover(frames)
    assert (found.plane.name, found.plane.source) == ('zx', 'layout')
    assert 'does not show it' in '\n'.join(table(found, None))
    given = discover(frames, normal=np.array([0.0, 0.0, 2.0]))
    assert (given.plane.name, given.plane.source) == ('xy', 'given')


@pytest.mark.parametrize('plane', ['zz', '', '1,2', 'nan,0,1', '0,0,0'])
def test_a_bad_plane_is_refused(plane):
    with pytest.raises(BagError, match='auto, xy, yz, zx or a normal'):
        discover_rig(options_of('discover', 'none.mcap', plane=plane))


def test_a_plane_to_be_fitted_settles_on_a_motion_that_leaves_any_plane():
    frames = leg(0.15, 0.003, 20, hidden=0.0)
    space = Space('fit', 4, 4)
    solid = frames.points.reshape(len(frames.stamps), 4, 4, 3)
    for first in range(0, len(solid), 16):
        space.add(solid[first : first + 16])
    assert space.plane is not None
    assert degrees_between(space.plane.normal, rotation(20)[:, 1]) < 8
    assert (space.report().off_plane > 0.01).any()


@pytest.mark.parametrize('name, plane', [('xz', 'zx'), ('yx', 'xy'), ('zy', 'yz'), ('zx', 'zx')])
def test_a_plane_may_be_named_by_its_axes_in_either_order(name, plane):
    assert settings_from({'plane': name}).plane == plane


# --- real captures ------------------------------------------------------------------------------

WALKS = [
    ('gait/walk1.trc', 'z', ['R.HF R.TT R.Ankle R.Ankle.Medial', 'L.Heel L.MT1 L.MT2 L.MT5']),
    (
        'exports/trc/subject01_walk1.trc',
        'z',
        ['R.Thigh.Upper R.Thigh.Front R.Thigh.Rear', 'L.Shank.Upper L.Shank.Front L.Shank.Rear']
        + ['R.ASIS L.ASIS V.Sacral', 'R.Temple L.Temple Top.Head'],
    ),
]


def discovered(file, tmp_path) -> Linkage:
    if not (DATA / file).exists():
        pytest.skip(f'{DATA / file} is not there')
    bag = tmp_path / 'walk.mcap'
    import_points(DATA / file, bag)
    parts, _ = read_frames(bag, None, 60.0, None, None)
    return discover(parts)


@pytest.mark.parametrize('file, axis, segments', WALKS)
def test_segments_of_a_walk_are_found_and_it_is_not_planar(file, axis, segments, tmp_path):
    found = discovered(file, tmp_path)
    for segment in segments:
        assert any(set(segment.split()) <= set(markers) for markers in found.markers), segment
    assert found.space is not None
    assert degrees_between(found.plane.normal, np.eye(3)['xyz'.index(axis)]) < 3
    solid = [pose for pose in found.space.solid if pose is not None]
    assert all(pose.noise < 6e-3 and pose.size < 1 for pose in solid)
    assert all(joint.residual < 0.015 for joint in found.space.joints)


def test_the_command_says_that_a_walk_is_not_planar_and_writes_parameters(tmp_path):
    file = DATA / 'gait' / 'walk1.trc'
    if not file.exists():
        pytest.skip(f'{file} is not there')
    bag, rig = tmp_path / 'walk.mcap', tmp_path / 'rig.yaml'
    import_points(file, bag)
    command = [sys.executable, '-m', 'kinpole_ros.tools.cli', 'discover', str(bag)]
    done = subprocess.run([*command, '--output', str(rig)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'not one' in done.stdout
    assert 'hinge' in done.stdout
    assert 'rolls' not in done.stdout
    assert rig.read_text().count('markers: [') == 7
    scene = tmp_path / 'scene.yaml'
    done = subprocess.run([*command, '--scene', str(scene)], capture_output=True, text=True)
    assert done.returncode == 2
    assert 'do not move in one plane' in done.stderr
    assert not scene.exists()
