"""The topic `rig`: with it alone a subscriber reads the topic `state`."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import bodies_of, decoded
from mcap.reader import make_reader

from kinpole_ros.bags import read_messages, replay
from kinpole_ros.messages import (
    RIG,
    STATE,
    RigChanges,
    String,
    plane_of_rig,
    read_rig,
    read_state_blocks,
    rig_of,
    serialize_message,
    state_fields,
)
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import REASONS, TABLE
from kinpole_ros.tracking.tracker import Tracker

ROOT = Path(__file__).parents[1]
FOUR_BAR = Settings(bodies=bodies_of('four_bar'), window=0.3, lag=0.1)


@pytest.fixture(scope='module')
def replayed(simulated: Callable[..., Path], tmp_path_factory: Any) -> tuple[Path, list[Estimate]]:
    """A result bag of markers that are lost now and then, and the estimates in it."""
    found: list[Estimate] = []
    bag = simulated('four_bar', rate=100, duration=1.5, noise=2e-4, dropout=0.3)
    output = tmp_path_factory.mktemp('rig') / 'result.mcap'
    replay(bag, FOUR_BAR, output, take=found.append)
    return output, found


def last_rig(bag: Path) -> dict[str, Any]:
    return read_rig([m.data for m in read_messages(bag, [f'/kinpole/{RIG}'])][-1])


def test_it_is_the_first_message_and_says_what_was_learned(replayed: Any) -> None:
    bag, estimates = replayed
    first = next(iter(read_messages(bag)))
    assert first.topic == f'/kinpole/{RIG}'
    begun, rig, last = read_rig(first.data), last_rig(bag), estimates[-1][-1]
    assert [body['name'] for body in begun['bodies']] == list(FOUR_BAR.bodies)
    assert begun['plane']['name'] == 'xy' and begun['bodies'][0]['size'] is None
    assert rig['run'] == begun['run'] and rig['frame_id'] == last.frame_id
    assert (rig['window'], rig['lag'], rig['order']) == (0.3, 0.1, 4)
    assert rig['pairs'] == [
        [last.bodies[j], last.bodies[i]] for j, i in zip(*last.pairs, strict=True)
    ]
    for b, body in enumerate(rig['bodies']):
        assert body['size'] == pytest.approx(last.size[b], rel=0.01)
        assert list(body['markers']) == list(FOUR_BAR.bodies[body['name']])
        places = np.array([*body['markers'].values()]) @ [1, 1j]
        np.testing.assert_allclose(places, last.shape[b][: len(places)], atol=2e-4)
        assert (body['pin'] is None) == bool(np.isnan(last.pin[b]))
        assert body['noise'] == pytest.approx(2e-4, rel=0.3)


def test_a_player_offers_it_to_subscribers_that_come_late(replayed: Any) -> None:
    """As the node does: `ros2 bag play` reads what was offered from the bag."""
    bag, _ = replayed
    with open(bag, 'rb') as file:
        channels = make_reader(file).get_summary().channels.values()
    (text,) = [c.metadata['offered_qos_profiles'] for c in channels if c.topic.endswith(f'/{RIG}')]
    (qos,) = yaml.safe_load(text)
    assert (qos['reliability'], qos['durability']) == ('reliable', 'transient_local')


def test_reasons_of_every_instant_are_those_of_the_replay(replayed: Any) -> None:
    bag, estimates = replayed
    states = [m.data for m in read_messages(bag, [f'/kinpole/{STATE}'])]
    (block,) = read_state_blocks(states)
    expected = np.concatenate([one.reason for one in estimates])
    np.testing.assert_array_equal(block.reasons['pose'], expected)
    assert len({*expected.ravel().tolist()}) > 1
    for name in estimates[0].withheld():
        expected = np.concatenate([one.withheld()[name] for one in estimates])
        np.testing.assert_array_equal(block.reasons[name], expected)


def test_the_lines_of_the_docs_read_the_state(replayed: Any) -> None:
    bag, estimates = replayed
    text = (ROOT / 'docs' / 'interfaces.md').read_text(encoding='utf-8')
    (code,) = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    scope: dict[str, Any] = {}
    exec(code, scope)
    topics = [f'/kinpole/{name}' for name in (RIG, STATE)]
    rigs, states = decoded(bag, *topics).values()
    results, last = scope['read'](rigs[-1], states[-1]), estimates[-1][-1]
    assert {name for _, name in results} == {
        *('position', 'angle', 'velocity'),
        *list(state_fields(4))[1:],
    }
    for b, body in enumerate(last.bodies):
        reasons = last.reasons(b)
        value = results[body, 'angular_velocity']
        if 'all' in reasons:
            assert value == reasons['all']
        else:
            assert value[0] == last.rate(1).value[b]
            assert results[body, 'centrode_curvature'] == reasons.get(
                'centrode_curvature', results[body, 'centrode_curvature']
            )


def test_it_is_sent_where_it_says_something_new() -> None:
    changes, tracker = RigChanges(), Tracker(FOUR_BAR)
    assert changes.message(tracker) is not None
    assert changes.message(tracker) is None
    tracker.reset()
    data = changes.message(tracker)
    assert data is not None and read_rig(data)['run'] == 2
    assert changes.is_of(tracker.run)
    other = Tracker(Settings(bodies={'a': ('1', '2')}, plane='yz', lag=0.05))
    data = changes.message(other)
    assert data is not None
    rig = read_rig(data)
    assert (rig['run'], rig['lag'], rig['plane']['normal']) == (3, 0.05, [1.0, 0.0, 0.0])
    assert plane_of_rig(rig).name == 'yz'


def test_the_plane_is_not_known_before_it_is_fitted() -> None:
    rig = rig_of(Tracker(Settings(bodies={'a': ('1', '2')}, plane='fit')), 1)
    assert rig['plane'] is None and rig['bodies'][0]['outline'] == []


def test_every_code_has_a_text() -> None:
    assert [*TABLE] == [*REASONS] and [*REASONS.values()] == [*range(len(REASONS))]
    assert all(reason.text for name, reason in TABLE.items() if name != 'KNOWN')


@pytest.mark.parametrize('text', ['', '[]', '{"schema": 2, "bodies": []}', '{"schema": 1}'])
def test_what_is_no_such_message_is_refused(text: str) -> None:
    data = serialize_message(String(data=text))
    with pytest.raises(ValueError, match=r'not a message of a topic `rig`|its schema is 2'):
        read_rig(data)


def test_names_are_those_that_json_holds() -> None:
    rig = rig_of(Tracker(FOUR_BAR), 1)
    assert json.loads(json.dumps(rig, allow_nan=False)) == rig
