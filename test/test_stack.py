"""What robot stacks rely on: joints at an even rate, frames that are there, deviations of all."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import bodies_of, decoded, read_back, stamp_of

from kinpole_ros.bags import read_messages, replay, topics
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import RIG, STATE, TF, VIEW, outputs_of
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate

Bag = Callable[..., Path]
ROOT = Path(__file__).parents[1]
JOINTS = {'elbow': ('crank', 'coupler'), 'shaft': ('ground', 'crank')}
SETTINGS = Settings(
    bodies=bodies_of('four_bar'),
    joints=JOINTS,
    joint_state_rate=37.0,
    lag=0.15,
    scene='four_bar',
    topics='all',
)
COVARIANT = (('nav_msgs', 'Odometry'), ('geometry_msgs', 'PoseWithCovarianceStamped'))
PERIOD = 10**9 / 37


@pytest.fixture(scope='module')
def results(simulated: Bag, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Estimate]:
    """A bag of results with every topic there is, and the estimates in it."""
    bag = simulated('four_bar', noise=2e-4, duration=2.0)
    written = tmp_path_factory.mktemp('stack') / 'result.mcap'
    found: list[Estimate] = []
    replay(bag, SETTINGS, written, take=found.append)
    return written, found[0]


def states(built: Sequence[bytes]) -> dict[int, Any]:
    """JointStates by stamp."""
    read = [read_back(data, 'sensor_msgs/msg/JointState') for data in built]
    return {stamp_of(m): m for m in read}


def joint_rows(settings: Settings) -> dict[str, Callable[[Estimate], Any]]:
    rows = outputs_of(settings, None)
    return {row.topic: row.build for row in rows if row.topic.startswith('joint_states')}


def test_joint_states_come_at_even_stamps_with_deviations_that_hold(
    results: tuple[Path, Estimate],
) -> None:
    written, found = results
    listed = decoded(written, '/kinpole/joint_states', '/kinpole/joint_states/deviation')
    both = [{stamp_of(m): m for m in listed[topic]} for topic in listed]
    stamps = np.array(list(both[0]))
    assert list(both[1]) == list(both[0])
    first = int(stamps[0] / PERIOD + 0.5)
    np.testing.assert_array_equal(stamps, np.rint((first + np.arange(len(stamps))) * PERIOD))
    assert stamps[0] - found.stamp[0] <= PERIOD and found.stamp[-1] - stamps[-1] <= PERIOD
    # Hardly any of them is at an instant.
    assert np.isin(stamps, found.stamp).mean() < 0.2
    motion = load_scene('four_bar').motion((stamps - 10**9) * 1e-9)
    angle = {body: motion[body].angle for body in ('crank', 'coupler')}
    true = np.stack((angle['coupler'][1] - angle['crank'][1], angle['crank'][1]), axis=-1)
    rates, deviations = (np.array([m.velocity for m in each.values()]) for each in both)
    off = (rates - true) / deviations
    assert np.sqrt((off[3:-3] ** 2).mean()) < 1.3
    # Of the angles as they are from one to the next: where 0 is depends on the first frame.
    angles = np.unwrap(np.array([m.position for m in both[0].values()]), axis=0)
    steps = np.diff(angles, axis=0) * 37 - (true[1:] + true[:-1]) / 2
    assert np.abs(steps).max() < 0.25


def test_joint_states_do_not_depend_on_how_instants_are_handed_over(
    results: tuple[Path, Estimate],
) -> None:
    _, found = results
    whole, single = joint_rows(SETTINGS), joint_rows(SETTINGS)
    for topic, build in whole.items():
        _, at_once = build(found)
        one_by_one = []
        for k in range(len(found)):
            part = _part(found, slice(k, k + 1))
            when, data = single[topic](part)
            assert set(when) <= {0}
            one_by_one += data
        assert one_by_one == at_once


def test_joint_states_pass_over_a_gap_and_begin_anew_after_a_reset(
    results: tuple[Path, Estimate],
) -> None:
    _, found = results
    build = joint_rows(SETTINGS)['joint_states']
    kept = np.r_[0:100, 250:300]
    stamps = np.array(list(states(build(_part(found, kept))[1])))
    gap = np.diff(stamps).max()
    assert 0.5 * (found.stamp[250] - found.stamp[99]) < gap < found.stamp[250] - found.stamp[99]
    other = _part(found, slice(120, 150))
    other.run += 1
    stamps = np.array(list(states(build(other)[1])))
    assert (stamps >= found.stamp[120]).all() and (stamps <= found.stamp[149]).all()


def _part(estimate: Estimate, rows: Any) -> Estimate:
    """Some instants of an estimate, as one."""
    derivatives = ('position', 'angle', 'position_covariance', 'angle_covariance')
    arrays = {name: getattr(estimate, name)[..., rows, :] for name in derivatives}
    for name in ('stamp', 'size', 'height', 'span', 'degree', 'reason'):
        arrays[name] = getattr(estimate, name)[rows]
    return Estimate.of_arrays(arrays, estimate.frame_id, estimate.bodies, estimate.run)


def documented() -> list[tuple[str, str]]:
    """Topics and types of the table in the documentation."""
    text = (ROOT / 'docs' / 'live.md').read_text()
    table = text[text.index('## What does the node publish?') :].partition('\n## ')[0]
    rows = re.findall(r'^\| (`.+?) \| (`.+?) \|', table, re.MULTILINE)
    found = []
    for names, kind in rows:
        listed = re.findall('`([^`]+)`', names)
        # Those after the first share what is before its last slash.
        place = listed[0].rpartition('/')[0]
        for name in listed:
            if name.startswith('/') and name != listed[0]:
                name = listed[0] + name
            found.append((name if '/' in name or not place else f'{place}/{name}', kind))
    return found


def pattern(topic: str) -> str:
    """The topic of the table that a topic of the results is an instance of."""
    bodies = '|'.join(SETTINGS.bodies)
    topic = re.sub(r'/points/\w+', '/points/<P>', topic)
    topic = re.sub(rf'({bodies})/wrt/({bodies})', '<j>/wrt/<i>', topic)
    return re.sub(rf'^({bodies})/', '<body>/', topic)


def test_every_topic_of_the_documentation_has_its_deviation_or_covariance(
    results: tuple[Path, Estimate],
) -> None:
    written, _ = results
    there = topics(written)
    kinds = {pattern(topic.removeprefix('/kinpole/')): kind for topic, kind in there.items()}
    listed = [name for name, _ in documented()]
    assert len(listed) > 15
    # Neither figures, nor of a single instant.
    plain = {'/tf', '/diagnostics', 'visualization', RIG}
    # Of scenes with loads: test_theory.py has it with its deviation.
    plain.add('balance')
    # With all deviations in them; the first is sent by a live node alone, to pages.
    plain |= {VIEW, STATE, '<body>/event'}
    plain |= {f'<body>/centrode/{name}' for name in ('fixed', 'moving')}
    with_it = {f'{package}/msg/{kind}' for package, kind in COVARIANT}
    for name in listed:
        if name.startswith('<...>') or name in plain:
            continue
        assert name in kinds, f'{name} is documented and not there'
        covered = kinds[name] in with_it
        beside = f'{name}/deviation' in kinds or f'{name}/with_covariance' in kinds
        assert covered or beside, f'{name} has neither'
        assert kinds.get(f'{name}/deviation', kinds[name]) == kinds[name]
    rest = {name for name in kinds if not name.endswith(('/deviation', '/with_covariance'))}
    assert rest - {*listed} <= {'/diagnostics'}, 'not documented'


def test_every_frame_of_a_result_bag_is_on_its_tf(simulated: Bag, tmp_path: Path) -> None:
    bag, prefix = simulated('four_bar', noise=2e-4, duration=1.0), 'rig1/'
    written = tmp_path / 'result.mcap'
    settings = Settings(
        bodies=bodies_of('four_bar'), joints=JOINTS, frame_prefix=prefix, topics='all'
    )
    replay(bag, settings, written)
    parents: dict[str, str] = {}
    named: dict[str, set[str]] = {}
    for message in read_messages(written):
        read = read_back(message.data, message.type_name)
        if message.topic == TF:
            parents.update({t.child_frame_id: t.header.frame_id for t in read.transforms})
            continue
        named.setdefault(message.topic, set()).update(frame_ids(read))
    assert set(parents) == {prefix + body for body in settings.bodies}
    assert set(parents.values()) == {'world'}
    assert len(named) > 50
    for topic, frames in named.items():
        # Joints and diagnostics have no frame.
        allowed = {*parents, 'world'} | ({''} if 'joint' in topic or 'diag' in topic else set())
        assert frames <= allowed, topic


def frame_ids(message: Any) -> set[str]:
    """All the frames that a message names."""
    found = set()
    for name in ('frame_id', 'child_frame_id'):
        if hasattr(message, name):
            found.add(getattr(message, name))
    # A texture has a header of its own, and no drawing has one.
    for name in {*getattr(message, '__slots__', ())} - {'_texture'}:
        value = getattr(message, name)
        for part in value if isinstance(value, list) else [value]:
            if hasattr(part, '__slots__'):
                found |= frame_ids(part)
    return found
