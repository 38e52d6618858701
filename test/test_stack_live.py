"""Two nodes in namespaces of their own over real DDS, and what a stack does to a managed node."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml
from conftest import WITH_TF, assert_alike, bodies_of, decoded, figures, sent
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from std_srvs.srv import Trigger
from test_node import RELIABLE, Peer, process
from visualization_msgs.msg import MarkerArray

from kinpole_ros.bags import replay
from kinpole_ros.messages import message_class
from kinpole_ros.settings import NODE_PARAMETERS, PARAMETERS, Settings

Bag = Callable[..., Path]
# Of all nodes.
COMMON = {'/diagnostics', '/parameter_events', '/rosout', '/tf'}
PREFIXES = ('left', 'right')
ROD = {'bodies': ['rod'], 'rod': {'markers': list(bodies_of('cardan')['rod'])}}
RIGID_BODY = {'bodies': ['wand']}


@pytest.fixture(scope='module')
def rigs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    """A node of a rigid body's poses in /left, and one of a rod's markers in /right."""
    folder, peer = tmp_path_factory.mktemp('rigs'), Peer()
    with ExitStack() as stack:
        for side, values in zip(PREFIXES, (RIGID_BODY, ROD), strict=True):
            reliable = {
                name.replace('/markers', f'/{side}/markers'): v for name, v in RELIABLE.items()
            }
            own = {'frame_prefix': f'{side}/', 'publish_tf': WITH_TF, **values, **reliable}
            config = folder / f'{side}.yaml'
            config.write_text(yaml.safe_dump({'/**': {'ros__parameters': own}}))
            words = ('node', '--ros-args', '-r', f'__ns:=/{side}', '--params-file', config)
            stack.enter_context(process(*words, log=folder / f'{side}.log'))
        yield peer
    peer.close()


@pytest.fixture
def peer(rigs: Peer) -> Iterator[Peer]:
    yield rigs
    rigs.forget()


def offered(peer: Peer, side: str) -> tuple[set[str], set[str]]:
    """Topics a node publishes, and its services."""
    node = peer.node
    topics = node.get_publisher_names_and_types_by_node('kinpole', f'/{side}')
    services = node.get_service_names_and_types_by_node('kinpole', f'/{side}')
    return {name for name, _ in topics}, {name for name, _ in services}


def test_two_nodes_in_namespaces_do_not_collide_and_each_says_what_replay_says(
    peer: Peer, simulated: Bag, tmp_path: Path
) -> None:
    told = peer.hear('/diagnostics', DiagnosticArray)
    frames = peer.hear('/tf', message_class('tf2_msgs/msg/TFMessage')) if WITH_TF else []
    kinds = {'left': ('wand', PoseStamped, 'pose_stamped'), 'right': ('rod', MarkerArray, '')}
    heard, expected = {}, {}
    followed = {'left': {'wand': ()}, 'right': bodies_of('cardan')}
    with ExitStack() as stack:
        for side, (body, kind, message) in kinds.items():
            bag = simulated(
                'cardan', rate=100, duration=0.8, noise=1e-4, message=message or 'marker_array'
            )
            result = tmp_path / f'{side}.mcap'
            replay(bag, Settings(bodies=followed[side]), result)
            name = f'/kinpole/{body}/odom'
            expected[side] = figures(decoded(result, name))
            heard[side] = peer.hear(f'/{side}{name}', Odometry)
            publisher = stack.enter_context(peer.publisher(kind, f'/{side}/markers'))
            for one in decoded(bag, '/markers')['/markers']:
                publisher.publish(sent(one))
        for side, (body, *_) in kinds.items():
            (due,) = expected[side].values()
            peer.until(lambda s=side, d=due: len(heard[s]) == len(d), f'results of {side}')
            found = figures({f'/kinpole/{body}/odom': heard[side]})
            assert_alike(found, expected[side])
            named = {(m.header.frame_id, m.child_frame_id) for m in heard[side]}
            assert named == {('world', f'{side}/{body}')}
        both = {'left/kinpole', 'right/kinpole'}
        peer.until(
            lambda: both <= {s.name.partition(':')[0] for m in told for s in m.status},
            'diagnostics of both',
        )
    if WITH_TF:
        children = {t.child_frame_id for m in frames for t in m.transforms}
        assert children == {'left/wand', 'right/rod'}
    (topics, services), (others, other_services) = (offered(peer, side) for side in PREFIXES)
    assert not topics & others - COMMON and not services & other_services
    for side, names in zip(PREFIXES, (topics | services, others | other_services), strict=True):
        assert len(names) > 25
        assert all(name.startswith(f'/{side}/kinpole/') for name in names - COMMON)


def test_asked_to_relearn_it_begins_anew_with_poses_too(peer: Peer, simulated: Bag) -> None:
    heard = peer.hear('/left/kinpole/wand/odom', Odometry)
    answer = peer.call('/left/kinpole/relearn', Trigger, Trigger.Request())
    assert answer.success
    bag = simulated('cardan', rate=100, duration=0.8, noise=1e-4, message='pose_stamped')
    with peer.publisher(PoseStamped, '/left/markers') as publisher:
        for one in decoded(bag, '/markers')['/markers']:
            publisher.publish(sent(one))
        # That another publisher sends may be noticed amid them, and a window starts anew then.
        peer.until(lambda: len(heard) > 5, 'results of what was learned anew')


def dumped(peer: Peer, node: str) -> dict[str, Any]:
    """What `ros2 param dump` asks a node for."""
    request = ListParameters.Request()
    names = list(peer.call(f'{node}/list_parameters', ListParameters, request).result.names)
    request = GetParameters.Request(names=names)
    values = peer.call(f'{node}/get_parameters', GetParameters, request).values
    return {name: parameter_value_to_python(v) for name, v in zip(names, values, strict=True)}


def load(peer: Peer, node: str, values: dict[str, Any]) -> dict[str, str]:
    """What was refused, and why, of values set as `ros2 param load` does: by their text."""
    text = yaml.safe_dump({name: _plain(value) for name, value in values.items()})
    parameters = [
        ParameterMessage(name=name, value=get_parameter_value(str(value)))
        for name, value in yaml.safe_load(text).items()
    ]
    request = SetParameters.Request(parameters=parameters)
    results = peer.call(f'{node}/set_parameters', SetParameters, request).results
    assert len(results) == len(parameters)
    both = zip(parameters, results, strict=True)
    return {p.name: result.reason for p, result in both if not result.successful}


def _plain(value: Any) -> Any:
    return list(value) if hasattr(value, '__len__') and not isinstance(value, str) else value


@pytest.mark.parametrize('side', PREFIXES)
def test_a_node_takes_its_own_dump_and_is_none_the_worse(peer: Peer, side: str) -> None:
    node = f'/{side}/kinpole'
    before = dumped(peer, node)
    assert {*PARAMETERS, *NODE_PARAMETERS, 'use_sim_time', 'start_type_description_service'} <= {
        *before
    }
    assert any(name.startswith('qos_overrides.') for name in before)
    assert load(peer, node, before) == {}
    assert dumped(peer, node) == before
    refused = load(peer, node, {'marker_topic': 'others', 'lag': 0.11, 'bodies': ['a']})
    assert refused.keys() == {'marker_topic', 'bodies'}
    assert 'read-only' in refused['marker_topic']
    assert 'cannot be set while the node is active' in refused['bodies']
    assert f'ros2 lifecycle set {node} deactivate' in refused['bodies']
    assert load(peer, node, {'lag': before['lag']}) == {}


def test_bodies_are_set_while_the_node_is_inactive(peer: Peer, simulated: Bag) -> None:
    node = '/right/kinpole'

    def change(label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return bool(peer.call(f'{node}/change_state', ChangeState, request).success)

    before = dumped(peer, node)
    assert change('deactivate')
    # In the order of the alphabet, as in a dump: an arm comes before the bodies.
    new = {
        'arm.markers': ['rod_1', 'rod_2'],
        'bodies': ['arm', 'rod'],
        'elbow.bodies': ['arm', 'rod'],
        'joints': ['elbow'],
        'rod.markers': ['rod_3', 'rod_4'],
    }
    assert load(peer, node, new) == {}
    now = dumped(peer, node)
    assert {name: now[name] for name in new} == new
    assert change('activate')
    peer.until(lambda: '/right/kinpole/rod/wrt/arm/icr' in offered(peer, 'right')[0], 'its topics')
    heard = peer.hear('/right/kinpole/arm/odom', Odometry)
    with peer.publisher(MarkerArray, '/right/markers') as publisher:
        bag = simulated('cardan', rate=100, duration=0.8, noise=1e-4, message='marker_array')
        for one in decoded(bag, '/markers')['/markers']:
            publisher.publish(sent(one))
        peer.until(lambda: len(heard) > 50, 'results of the new body')
    # What does not go together is taken, and not activated.
    assert change('deactivate')
    assert load(peer, node, {'bodies': ['rod', 'claw']}) == {}
    assert 'arm.markers' not in dumped(peer, node)
    assert not change('activate')
    assert load(peer, node, {'beak.markers': ['a', 'b']}).keys() == {'beak.markers'}
    assert (
        load(peer, node, {name: before[name] for name in ('bodies', 'joints', 'rod.markers')}) == {}
    )
    assert dumped(peer, node) == before
    assert change('activate')
