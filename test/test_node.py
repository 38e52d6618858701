"""The live node, in a process of its own and over real DDS: it says what replay says."""

import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import rclpy
from conftest import (
    WITH_TF,
    assert_alike,
    bodies_of,
    decoded,
    figures,
    ros_class,
    sent,
    stamp_of,
    write_config,
)
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, Vector3Stamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import DescribeParameters, SetParameters, SetParametersAtomically
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from kinpole_ros.bags import BagError, BagWriter, message_class, read_messages, replay, topics
from kinpole_ros.mechanism import scenes_folder
from kinpole_ros.messages import (
    MARKER_TYPES,
    VIEW,
    Output,
    deserialize_message,
    live_outputs,
    read_markers,
    stamp_to_ns,
    to_message,
)
from kinpole_ros.ros import player as player_module
from kinpole_ros.ros.node import KinpoleNode
from kinpole_ros.ros.player import headers, play
from kinpole_ros.settings import NODE_PARAMETERS, PARAMETERS, Settings
from kinpole_ros.tools.demo import live_run
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

Bag = Callable[..., Path]
ROD = Settings(bodies=bodies_of('cardan'))
# The markers by place: the one identity that all four types of messages have.
BY_PLACE = Settings(bodies={'rod': ('0', '1', '2', '3')}, marker_identity='index')
TOO_SLOW = 'the node is slower than the stream'
LIMIT = 30.0  # s; machines that build are slow, and stop now and then
RELIABLE = {
    f'qos_overrides./markers.subscription.{key}': value
    for key, value in (('reliability', 'reliable'), ('depth', 1000))
}


class Peer:
    """A ROS node of the test's own, beside the one under test."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node('peer', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._heard: list[Any] = []
        self.also: Callable[[], None] = lambda: None

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Let things happen until the condition holds."""
        deadline = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < deadline, f'{what}: not within {LIMIT:g} s'
            self._executor.spin_once(timeout_sec=0.02)
            self.also()

    def hear(self, topic: str, message_type: type) -> list[Any]:
        """What comes on a topic from now on, as it comes."""
        heard: list[Any] = []
        qos = QoSProfile(depth=1000)
        made = self.node.create_subscription(ros_class(message_type), topic, heard.append, qos)
        self._heard.append(made)
        self.until(lambda: self.node.count_publishers(topic), f'a publisher of {topic}')
        return heard

    def forget(self) -> None:
        """Hear no more."""
        for subscription in self._heard:
            self.node.destroy_subscription(subscription)
        self._heard = []

    def call(self, service: str, service_type: Any, request: Any) -> Any:
        client = self.node.create_client(service_type, service)
        self.until(client.service_is_ready, f'the service {service}')
        asked: list[Any] = []
        again = 0.0

        def answered() -> bool:
            # An answer is lost where the node has met the client's request but not its reader yet.
            nonlocal again
            if time.monotonic() >= again:
                asked.append(client.call_async(request))
                again = time.monotonic() + LIMIT / 5
            return any(future.done() for future in asked)

        self.until(answered, f'an answer of {service}')
        self.node.destroy_client(client)
        return next(future.result() for future in asked if future.done())

    def state(self) -> str:
        return str(
            self.call('/kinpole/get_state', GetState, GetState.Request()).current_state.label
        )

    def change(self, label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        return bool(self.call('/kinpole/change_state', ChangeState, request).success)

    def set(self, **values: Any) -> list[Any]:
        parameters: list[ParameterMessage] = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        return list(self.call('/kinpole/set_parameters', SetParameters, request).results)

    @contextmanager
    def publisher(self, message_type: type, topic: str = '/markers') -> Iterator[Any]:
        """A publisher that the node has found."""
        made = self.node.create_publisher(ros_class(message_type), topic, QoSProfile(depth=1000))
        self.until(made.get_subscription_count, f'the node on {topic}')
        yield made
        self.node.destroy_publisher(made)

    def feed(
        self, publisher: Any, messages: Iterator[Any], condition: Callable[[], Any], what: str
    ) -> None:
        """Publish one message after the other until the condition holds."""

        def publish_and_look() -> bool:
            if condition():
                return True
            publisher.publish(sent(next(messages)))
            return False

        self.until(publish_and_look, what)


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@contextmanager
def process(*words: str | Path, log: Path, limit: int = 60) -> Iterator['subprocess.Popen[bytes]']:
    """A `kinpole` command beside the test, which ends with it at the latest."""
    command = [sys.executable, '-m', 'kinpole_ros.tools.cli', *map(str, words)]
    with open(log, 'wb') as err:
        started = subprocess.Popen(
            ['timeout', '--foreground', '-k', '2', str(limit), *command], stderr=err
        )
    try:
        yield started
    finally:
        started.send_signal(signal.SIGINT)
        started.wait(LIMIT)


def complaints(log: Path) -> list[str]:
    """Lines of a node's log that are more than information, but of a machine that is too busy."""
    # rclpy gives up an answer, in two lines, if the reader of the client is not met in time.
    busy = TOO_SLOW, 'failed to send response (timeout)', 'service_send_response(response'
    return [line for line in warnings_of(log) if not any(words in line for words in busy)]


def warnings_of(log: Path) -> list[str]:
    """Lines of a node's log that are more than information."""
    return [line for line in log.read_text().splitlines() if '[INFO]' not in line]


# s, between diagnostics.
INTERVAL = 0.1


def node_words(config: Path, **parameters: Any) -> list[str]:
    words = ['node', '--ros-args', '--params-file', str(config)]
    for name, value in ({'diagnostics_interval': INTERVAL} | parameters).items():
        words += ['-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}']
    return words


@pytest.fixture(scope='module')
def by_place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('config')
    return write_config(folder / 'by_place.yaml', BY_PLACE, marker_identity='index', **RELIABLE)


def rod_messages(simulated: Bag, kind: str = 'marker_array') -> list[Any]:
    bag = simulated('cardan', rate=100, duration=0.8, noise=1e-4, message=kind)
    return decoded(bag, '/markers')['/markers']


def endless(simulated: Bag, kind: str = 'marker_array') -> Iterator[Any]:
    """Frames of the rod one after the other, with stamps that go on; never the same ones twice."""
    first = read_markers(rod_messages(simulated)[0])
    generator = np.random.default_rng(5)
    start = next(_starts)
    for k in itertools.count():
        turn = np.exp(1j * 2 * np.pi * k / 100)
        flat = turn * (first.points[0, :, 0] + 1j * first.points[0, :, 1])
        points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
        points[:, :2] += 1e-4 * generator.normal(size=(len(points), 2))
        yield to_message(kind, start + 10_000_000 * k, 'world', 'abcd', points)


_starts = itertools.count(1_000_000_000_000, 1_000_000_000_000)


def said(arrays: list[Any], status: int = 0) -> dict[str, str]:
    """The last diagnostics: key and value of one status, and its message."""
    last = arrays[-1].status[status]
    return {'message': last.message, **{pair.key: pair.value for pair in last.values}}


# The main job


def test_live_figures_are_those_of_replay(simulated: Bag, tmp_path: Path) -> None:
    loaded = tmp_path / 'loaded.yaml'
    loads = 'loads: [{force: [0, -50], at: coupler.P}, {torque: 2, on: rocker}]'
    loaded.write_text(f'{(scenes_folder() / "four_bar.yaml").read_text()}\n{loads}\n')
    bag = simulated(loaded, rate=100, duration=1.2, noise=2e-4, dropout=0.02)
    joints = {'elbow': ('crank', 'coupler'), 'shaft': ('ground', 'rocker')}
    settings = Settings(
        bodies=bodies_of('four_bar'), joints=joints, scene=str(loaded), topics='all'
    )
    pairs = {name: {'bodies': list(pair)} for name, pair in joints.items()}
    more = {'joints': list(joints), 'scene': str(loaded), 'topics': 'all', **pairs}
    config = write_config(tmp_path / 'config.yaml', settings, **more)
    assert live_run(bag, config, tmp_path / 'live.mcap').frames == 120
    replay(bag, settings, tmp_path / 'replay.mcap')
    live = decoded(tmp_path / 'live.mcap')
    assert [array.status[1].name for array in live['/diagnostics']][:1] == ['kinpole: crank']
    live.pop('/kinpole/transition_event', None)
    found = figures(live)
    expected = figures(decoded(tmp_path / 'replay.mcap'))
    for topic in ('coupler/odom', 'joint_states', 'crank/angular_velocity/deviation'):
        assert len(found[f'/kinpole/{topic}']) == 110
    assert len(found['/kinpole/balance']) > 50
    assert_alike(found, expected)


@pytest.fixture(scope='class')
def running(by_place: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    peer = Peer()
    log = tmp_path_factory.mktemp('shared') / 'stderr'
    with process(*node_words(by_place), log=log):
        yield peer
    peer.close()


class TestOneNode:
    """One node, asked many things."""

    @pytest.fixture
    def shared(self, running: Peer) -> Iterator[Peer]:
        yield running
        running.forget()

    def test_the_node_is_active_from_the_start(self, shared: Peer) -> None:
        assert shared.state() == 'active'

    @pytest.mark.parametrize('kind', MARKER_TYPES)
    def test_the_node_finds_out_the_type_of_the_markers(
        self, shared: Peer, simulated: Bag, kind: str
    ) -> None:
        odom = shared.hear('/kinpole/rod/odom', Odometry)
        with shared.publisher(MARKER_TYPES[kind]) as publisher:
            messages = endless(simulated, kind)
            shared.feed(publisher, messages, lambda: len(odom) >= 10, f'results from {kind}')
        omega = [message.twist.twist.angular.z for message in odom[5:]]
        assert omega == pytest.approx([2 * np.pi] * len(omega), rel=0.1)

    def test_a_topic_of_another_type_is_named_in_the_diagnostics(self, shared: Peer) -> None:
        arrays = shared.hear('/diagnostics', DiagnosticArray)
        publisher = shared.node.create_publisher(PointStamped, '/markers', 1)
        shared.until(
            lambda: arrays and '/markers is published as geometry_msgs' in said(arrays)['message'],
            'diagnostics of the type',
        )
        assert arrays[-1].status[0].level == DiagnosticStatus.ERROR
        assert 'sensor_msgs/msg/PointCloud2' in said(arrays)['message']
        shared.node.destroy_publisher(publisher)
        over = lambda: said(arrays)['message'] == 'no markers received on /markers'  # noqa: E731
        shared.until(over, 'the end of the complaint')
        assert arrays[-1].status[0].level == DiagnosticStatus.STALE

    def test_diagnostics_come_by_themselves_and_tell_of_the_markers(
        self, shared: Peer, simulated: Bag
    ) -> None:
        arrays = shared.hear('/diagnostics', DiagnosticArray)
        odom = shared.hear('/kinpole/rod/odom', Odometry)
        with shared.publisher(MarkerArray) as publisher:
            messages = endless(simulated)
            shared.feed(publisher, messages, lambda: len(odom) >= 5, 'results')
            arrays.clear()
            shared.feed(publisher, messages, lambda: len(arrays) >= 3, 'three diagnostics')
        # Once an interval of the node's clock, whatever the stamps of the markers do.
        steps = np.diff([stamp_of(array) for array in arrays]) * 1e-9
        assert steps.min() > 0
        assert 0.4 < steps.mean() / INTERVAL < 5
        assert [status.name for status in arrays[-1].status] == ['kinpole: markers', 'kinpole: rod']
        values = said(arrays)
        assert values['message'] == 'receiving markers'
        assert float(values['rate (Hz)']) > 5
        assert float(values['mean interval (s)']) == pytest.approx(0.01)
        body = said(arrays, 1)
        assert body['message'].startswith('tracking')
        assert float(body['noise of a marker per axis (m)']) == pytest.approx(1e-4, rel=0.5)

    def test_a_message_that_cannot_be_read_is_named_in_the_diagnostics(
        self, shared: Peer, simulated: Bag
    ) -> None:
        arrays = shared.hear('/diagnostics', DiagnosticArray)
        cloud = to_message('point_cloud2', 5, 'world', 'ab', np.zeros((2, 3)))
        cloud.fields = cloud.fields[1:]
        with shared.publisher(MARKER_TYPES['point_cloud2']) as publisher:
            shared.feed(
                publisher,
                itertools.repeat(cloud),
                # The first ones may be of a second in which good frames came too.
                lambda: (
                    arrays
                    and "no field 'x'" in said(arrays)['message']
                    and arrays[-1].status[0].level == DiagnosticStatus.ERROR
                ),
                'diagnostics of the message',
            )
        assert int(said(arrays)['messages that could not be read']) > 0

    def test_asked_to_relearn_it_begins_anew_with_the_shapes(
        self, shared: Peer, simulated: Bag
    ) -> None:
        odom = shared.hear('/kinpole/rod/odom', Odometry)
        messages = endless(simulated)
        with shared.publisher(MARKER_TYPES['marker_array']) as publisher:
            shared.feed(publisher, messages, lambda: len(odom) >= 40, 'results')
            before = odom[-1]
            answer = shared.call('/kinpole/relearn', Trigger, Trigger.Request())
            assert answer.success and 'anew' in answer.message
            odom.clear()
            later = lambda: len(odom) and stamp_of(odom[-1]) > stamp_of(before) + 4e8  # noqa: E731
            shared.feed(publisher, messages, later, 'results of what was learned anew')
        # Axes of a body are along the ground's where it is first seen, 0.1 s before it is answered.
        angles = [2 * np.arctan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w)
                  for m in odom]  # fmt: skip
        assert min(np.abs(angles)) < 0.2

    def test_bad_values_set_live_are_refused_with_the_reason(self, shared: Peer) -> None:
        refused = {
            'window': (-1.0, 'Parameter window out of range Min: 1e-06, Max: 3600.0'),
            'stamps': (
                'late',
                "parameter stamps is 'late'; it must be one of auto, capture, arrival",
            ),
            'method': (
                'pose',
                'unknown parameter method; leave it out, as it has no effect; known',
            ),
            'lag': (0.5, 'parameter lag is 0.5 s; it must be less than window, 0.3 s'),
            'plane': ('zz', "parameter plane is 'zz'; it must be one of xy, yz, zx"),
            'derivative_order': (9, 'auto, 1, 2, 3 or 4'),
            'noise': ('low', 'a number from 0 to 1e+06 m'),
            **({} if WITH_TF else {'publish_tf': (True, 'tf2_msgs is not installed; install')}),
            'marker_topic': ('others', 'read-only'),
            'bodies': (['other'], 'parameter bodies cannot be set while the node is active'),
            'windows': (0.3, 'parameter windows; did you mean window? known are bodies, '),
            'qos_overrides./others.subscription.depth': (5, 'is read at the start only; set it'),
        }
        for name, (value, reason) in refused.items():
            (result,) = shared.set(**{name: value})
            assert not result.successful
            assert reason in result.reason
            assert '\n' not in result.reason

    def test_a_good_value_set_live_takes_effect_and_the_counts_start_anew(
        self, shared: Peer, simulated: Bag
    ) -> None:
        arrays = shared.hear('/diagnostics', DiagnosticArray)
        odom = shared.hear('/kinpole/rod/odom', Odometry)
        sent: list[int] = []

        def messages() -> Iterator[Any]:
            for message in endless(simulated):
                sent.append(stamp_of(message))
                yield message

        with shared.publisher(MarkerArray) as publisher:
            frames = messages()
            for lag in (0.05, 0.1):
                assert [result.successful for result in shared.set(lag=lag)] == [True]
                odom.clear()
                shared.feed(publisher, frames, lambda: len(odom) >= 10, f'results with lag {lag}')
                trails = partial(lambda lag: sent[-1] - stamp_of(odom[-1]) <= lag * 1e9, lag)
                shared.until(trails, f'a lag of {lag}')
                arrays.clear()
                shared.until(lambda: arrays, 'diagnostics')
                assert float(said(arrays)['rate (Hz)']) >= 0

    def test_every_parameter_describes_itself(self, shared: Peer) -> None:
        names = [*PARAMETERS, 'rod.markers', *NODE_PARAMETERS]
        request = DescribeParameters.Request(names=names)
        answer = shared.call('/kinpole/describe_parameters', DescribeParameters, request)
        for name, descriptor in zip(names, answer.descriptors, strict=True):
            assert descriptor.name == name
            assert descriptor.description.endswith('.')
            assert descriptor.additional_constraints
        ranges = {d.name: d.floating_point_range for d in answer.descriptors}
        assert (ranges['lag'][0].from_value, ranges['lag'][0].to_value) == (0.0, 3600.0)


# Nodes of their own


def test_a_managed_node_waits_stops_and_starts_again(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    messages = rod_messages(simulated)
    replay(
        simulated('cardan', rate=100, duration=0.8, noise=1e-4), BY_PLACE, tmp_path / 'replay.mcap'
    )
    topics = {
        '/kinpole/rod/odom': Odometry,
        '/kinpole/rod/angular_velocity': Vector3Stamped,
        '/kinpole/rod/icr': PointStamped,
    }
    expected = figures(decoded(tmp_path / 'replay.mcap', *topics))
    assert len(messages) == 80

    def reached(due: int) -> bool:
        return all(each and stamp_of(each[-1]) == due for each in heard.values())

    def run_through(publisher: Any) -> None:
        """Each frame once its result is there: as fast as the node goes, and none is lost."""
        for each in heard.values():
            each.clear()
        for k, message in enumerate(messages):
            publisher.publish(sent(message))
            due = stamp_of(message) - 100_000_000
            if k >= 20:
                peer.until(partial(reached, due), f'the result at {due} ns')
        assert_alike(figures(heard), expected)

    with process(*node_words(by_place, autostart=False), log=tmp_path / 'stderr'):
        assert peer.state() == 'unconfigured'
        assert peer.node.count_subscribers('/markers') == 0
        assert peer.change('configure')
        heard = {topic: peer.hear(topic, kind) for topic, kind in topics.items()}
        assert peer.state() == 'inactive'
        assert peer.change('activate')
        with peer.publisher(MarkerArray) as publisher:
            run_through(publisher)
            # A bag that loops: the stamps jump back, and all is right again.
            arrays = peer.hear('/diagnostics', DiagnosticArray)
            run_through(publisher)
            peer.until(lambda: arrays, 'diagnostics')
            assert said(arrays)['starts anew after a jump of the stamps'] == '1'

            assert peer.change('deactivate')
            assert peer.state() == 'inactive'
            gone = lambda: not publisher.get_subscription_count()  # noqa: E731
            peer.until(gone, 'the end of the subscription')
            assert peer.change('activate')
            peer.until(publisher.get_subscription_count, 'the subscription again')
            run_through(publisher)
        assert peer.change('deactivate')
        assert peer.change('cleanup')
        assert peer.state() == 'unconfigured'
        peer.until(lambda: not peer.node.count_publishers('/kinpole/rod/odom'), 'the end')
    told = (tmp_path / 'stderr').read_text()
    assert 'waits for markers on /markers' in told
    assert 'follows rod on /markers (visualization_msgs/msg/MarkerArray)' in told
    assert not complaints(tmp_path / 'stderr')


def test_what_was_drawn_is_taken_away_when_no_more_is_drawn(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    with process(*node_words(by_place), log=tmp_path / 'stderr'):
        drawn = peer.hear('/kinpole/visualization', MarkerArray)
        with peer.publisher(MarkerArray) as publisher:
            for stop, again in (
                (['deactivate'], ['activate']),
                # Its publisher goes at once, and then every tenth or so used to be lost.
                *4 * [(['deactivate', 'cleanup'], ['configure', 'activate'])],
            ):
                drawn.clear()
                peer.feed(publisher, endless(simulated), lambda: drawn, 'a drawing')
                assert len(drawn[-1].markers) == 13
                assert all(map(peer.change, stop))
                gone = lambda: drawn[-1].markers[0].action == Marker.DELETEALL  # noqa: E731
                peer.until(gone, 'its end')
                assert all(map(peer.change, again))
        assert [len(array.markers) for array in drawn].count(1) == 1
        # Nothing was drawn since.
        assert peer.change('deactivate')
        assert peer.change('cleanup')
    assert not complaints(tmp_path / 'stderr')
    assert [len(array.markers) for array in drawn].count(1) == 1


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[KinpoleNode]:
    monkeypatch.setenv('ROS_DOMAIN_ID', '94')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(args=['kinpole'])
    made = KinpoleNode()
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def ask_to_set(node: KinpoleNode, kind: Any, values: list[tuple[str, Any]]) -> Any:
    """What the node answers a client that asks for these parameters in one request."""
    (service,) = (each for each in node.services if each.srv_type is kind)
    parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values]
    return service.callback(kind.Request(parameters=parameters), kind.Response())


def test_one_request_for_parameters_has_the_node_start_anew_once(
    node: KinpoleNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[None] = []
    monkeypatch.setattr(KinpoleNode, '_restart', lambda node: started.append(None))
    wanted = [('window', 0.4), ('lag', 0.2), ('noise', -1.0), ('scale', 0.001)]
    results = ask_to_set(node, SetParameters, wanted).results
    assert [result.successful for result in results] == [True, True, False, True]
    assert (node.settings.window, node.settings.lag, node.settings.scale) == (0.4, 0.2, 0.001)
    assert len(started) == 1
    assert ask_to_set(node, SetParametersAtomically, [('lag', 0.1)]).result.successful
    assert node.settings.lag == 0.1
    assert len(started) == 2


def test_bodies_and_their_markers_are_set_in_one_go_while_the_node_is_inactive(
    node: KinpoleNode,
) -> None:
    new = [
        ('arm.markers', ['a', 'b']),
        ('arm.shape', [0.0, 0.0, 0.1, 0.0]),
        ('bodies', ['arm', 'tip']),
        ('tip.markers', ['c', 'd']),
    ]
    answer = ask_to_set(node, SetParametersAtomically, new).result
    assert not answer.successful and 'while the node is active' in answer.reason
    node.trigger_deactivate()
    assert ask_to_set(node, SetParametersAtomically, new).result.successful
    assert node.settings.bodies == {'arm': ('a', 'b'), 'tip': ('c', 'd')}
    assert node.settings.shapes == {'arm': (0j, 0.1 + 0j)}
    # One bad value, and none is taken.
    bad = [('bodies', ['x', 'y']), ('x.markers', ['a', 'a'])]
    answer = ask_to_set(node, SetParametersAtomically, bad).result
    assert not answer.successful and 'x.markers' in answer.reason
    assert list(node.settings.bodies) == ['arm', 'tip']
    # What does not go together yet is said, and keeps the node from being activated.
    (answer,) = ask_to_set(node, SetParameters, [('bodies', ['arm', 'claw'])]).results
    assert answer.successful and 'parameter claw.markers is missing' in node.incomplete
    assert node.trigger_activate() == TransitionCallbackReturn.FAILURE
    (answer,) = ask_to_set(node, SetParameters, [('lag', 0.05)]).results
    assert answer.successful
    (answer,) = ask_to_set(node, SetParameters, [('claw.markers', ['c', 'd'])]).results
    assert answer.successful and not node.incomplete
    assert node.settings.lag == 0.05 and list(node.settings.bodies) == ['arm', 'claw']
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS


def test_a_request_for_more_parameters_than_there_are_is_refused(node: KinpoleNode) -> None:
    before = node.settings
    many = [('lag', 0.001 * k) for k in range(300)]
    results = ask_to_set(node, SetParameters, many).results
    assert len(results) == 300
    assert not any(result.successful for result in results)
    assert results[0].reason.startswith('300 parameters in one request, and this node has ')
    assert not ask_to_set(node, SetParametersAtomically, many).result.successful
    assert node.settings == before


def test_publishers_stay_until_readers_have_their_last_messages_but_not_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With all cores busy 19 of 510 were lost: the end of a writer overtakes its messages."""
    waited: dict[str, float] = {}
    gone: list[str] = []
    destroy = KinpoleNode.destroy_lifecycle_publisher

    def wait(publisher: Publisher, timeout: Duration) -> bool:
        waited[publisher.topic_name] = timeout.nanoseconds * 1e-9
        return publisher.topic_name.endswith('odom')

    def watched(node: KinpoleNode, publisher: Any) -> Any:
        gone.append(publisher.topic_name)
        assert publisher.topic_name in waited
        return destroy(node, publisher)

    monkeypatch.setattr(Publisher, 'wait_for_all_acked', wait)
    monkeypatch.setattr(KinpoleNode, 'destroy_lifecycle_publisher', watched)
    rclpy.init(args=['kinpole'])
    node = KinpoleNode()
    try:
        assert node.set_parameters([Parameter('derivative_order', value=1)])[0].successful
        assert '/kinpole/body/icr_velocity' in gone
        assert '/kinpole/body/odom' not in waited
        node.close_outputs()
        assert '/kinpole/body/odom' in gone
        # Whoever was killed never has them.
        assert 0 <= min(waited.values()) <= max(waited.values()) <= 0.2
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_activated_again_the_node_compares_no_publisher_with_those_of_before(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    with process(*node_words(by_place), log=tmp_path / 'stderr'):
        arrays = peer.hear('/diagnostics', DiagnosticArray)
        messages = endless(simulated)
        with peer.publisher(MarkerArray) as publisher:
            counted = lambda: arrays and said(arrays)['frames received'] != '0'  # noqa: E731
            peer.feed(publisher, messages, counted, 'diagnostics of frames')
            assert peer.change('deactivate')
        assert peer.change('activate')
        arrays.clear()
        with peer.publisher(MarkerArray) as publisher:
            peer.feed(publisher, messages, counted, 'diagnostics of frames again')
        assert not [a for a in arrays if 'another publisher' in a.status[0].message]
        assert said(arrays)['starts anew with another publisher of the markers'] == '0'


def test_messages_that_cannot_be_read_are_warned_of_when_they_begin_and_told_of_all_along(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    """As from a driver that sends empty arrays all night, for it sees nothing."""
    log, words = tmp_path / 'stderr', 'MarkerArray without markers has no stamp'
    with process(*node_words(by_place), log=log):
        arrays = peer.hear('/diagnostics', DiagnosticArray)
        with peer.publisher(MarkerArray) as publisher:
            good, empty = endless(simulated), itertools.repeat(MarkerArray())

            def told(times: int, so: bool) -> bool:
                last = [words in array.status[0].message for array in arrays[-times:]]
                return last == [so] * times

            for messages, so in ((empty, True), (good, False), (empty, True)):
                done = partial(told, 2, so)
                peer.feed(publisher, messages, done, 'two diagnostics of the same')
    assert [words in line for line in complaints(log)] == [True, True]


def test_simulated_time_that_stands_still_stops_nothing(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    with process(*node_words(by_place, use_sim_time=True), log=tmp_path / 'stderr'):
        odom = peer.hear('/kinpole/rod/odom', Odometry)
        arrays = peer.hear('/diagnostics', DiagnosticArray)
        with peer.publisher(MarkerArray) as publisher:
            messages = endless(simulated)
            both = lambda: len(odom) >= 5 and len(arrays) >= 2  # noqa: E731
            peer.feed(publisher, messages, both, 'results and diagnostics')
    assert np.diff([stamp_of(message) for message in odom]).min() > 0
    assert {stamp_of(array) for array in arrays} == {0}


def written(recording: Path, topic: str) -> int:
    """How many messages of a topic are in a bag that is still being written."""
    count = 0
    try:
        for _ in read_messages(recording, [topic]):
            count += 1
    except BagError:
        pass  # not there yet, or cut off at its end
    return count


@pytest.fixture
def unheard(tmp_path: Path) -> Path:
    """A bag of three messages on a topic of its own."""
    bag = tmp_path / 'unheard.mcap'
    with BagWriter(bag) as writer:
        for k in range(3):
            cloud = to_message('point_cloud2', k, 'world', ['a'], np.zeros((1, 3)))
            writer.write('/unheard', cloud, k)
    return bag


def test_play_says_to_what_nobody_listens(unheard: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert play(unheard, wait=0.1) == 3
    assert 'nobody listens to /unheard' in capfd.readouterr().err


@pytest.mark.parametrize(('asked', 'begins'), [(None, 2.5), (1, 1.0), (2, 1.5), (3, 10.0)])
def test_play_begins_when_the_subscribers_asked_for_are_there_or_no_more_come(
    monkeypatch: pytest.MonkeyPatch, asked: int | None, begins: float
) -> None:
    now, said = 0.0, []

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    # One comes after a second, and another half a second later.
    source = SimpleNamespace(get_subscription_count=lambda: (now >= 0.999) + (now >= 1.499))
    node = SimpleNamespace(
        context=SimpleNamespace(ok=lambda: True),
        get_logger=lambda: SimpleNamespace(info=said.append, warning=said.append),
    )
    clock = SimpleNamespace(monotonic=lambda: now, sleep=sleep)
    monkeypatch.setattr('kinpole_ros.ros.player.time', clock)
    player_module._wait_for_subscribers(cast(Any, node), {'/m': cast(Any, source)}, 10.0, asked)
    assert now == pytest.approx(begins, abs=0.02)
    assert said == [f'the first messages go to the subscribers: {1 + (begins > 1)} of /m']


def test_play_refuses_a_number_of_subscribers_below_one(unheard: Path) -> None:
    with pytest.raises(BagError, match='--subscribers is 0; it must be 1 or more'):
        play(unheard, subscribers=0)


def test_play_says_once_that_the_pace_is_not_held(
    unheard: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(player_module, '_MAX_BEHIND', 0.0)
    assert play(unheard, speed=1e9, wait=0.0) == 3
    assert capfd.readouterr().err.count('the pace asked for is not held: 0.0 s behind') == 1


def test_a_loop_reads_each_message_once(simulated: Bag, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = simulated('four_bar', rate=100, duration=0.1)
    read: list[bytes] = []

    def deserialize(data: bytes, kind: type) -> Any:
        read.append(data)
        return deserialize_message(data, kind)

    def publish(publisher: Publisher, message: Any) -> None:
        published.extend([message] * (publisher.topic_name == '/markers'))
        if len(published) == 35:
            raise KeyboardInterrupt

    published: list[Any] = []
    monkeypatch.setattr(player_module, 'deserialize_message', deserialize)
    monkeypatch.setattr(Publisher, 'publish', publish)
    with pytest.raises(KeyboardInterrupt):
        play(bag, ['/markers'], speed=50.0, wait=0.0, loop=True)
    assert len(read) == 10
    assert all(isinstance(message, bytes) for message in published)


def test_a_topic_to_be_played_may_lack_its_slash(unheard: Path) -> None:
    assert play(unheard, ['unheard'], wait=0.1) == 3


def test_play_loops_until_interrupted_with_the_time_of_the_bag_on_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, second = tmp_path / 'two.mcap', 1_000_000_000
    with BagWriter(bag) as writer:
        for stamp in (5 * second, 5 * second + second // 5):
            cloud = to_message('point_cloud2', stamp, 'world', ['a'], np.zeros((1, 3)))
            writer.write('/unheard', cloud, stamp)
    said: list[tuple[str, Any]] = []

    def publish(publisher: Publisher, message: Any) -> None:
        said.append((publisher.topic_name, message))
        if [topic for topic, _ in said].count('/unheard') == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(Publisher, 'publish', publish)
    with pytest.raises(KeyboardInterrupt):
        play(bag, wait=0.0, loop=True, clock=100.0)
    ends = [k for k, (topic, _) in enumerate(said) if topic == '/unheard'][1::2]
    times = [
        [stamp_to_ns(m.clock) for t, m in said[a:b] if t == '/clock']
        for a, b in [(0, ends[0]), (ends[0], ends[1])]
    ]
    for round_ in times:
        # Many between the two messages, never ahead of the next.
        assert len(round_) > 2
    clock = [stamp for round_ in times for stamp in round_]
    assert clock[0] == 5 * second
    assert clock == sorted(clock)
    # The next loop begins one interval, 0.2 s, after the end of the first.
    assert times[0][-1] <= 5 * second + second // 5
    assert times[1][-1] <= 5 * second + 3 * second // 5
    with pytest.raises(BagError, match='--clock is 0'):
        play(bag, clock=0.0)


@pytest.mark.parametrize('kind', ['marker_array', 'marker', 'pose_array', 'point_cloud2'])
def test_the_stamps_of_a_loop_follow_the_last_one_by_an_interval(
    simulated: Bag, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    bag = simulated('four_bar', rate=100, duration=0.1, message=kind)
    cls = message_class(topics(bag)['/markers'])
    stamps: list[set[int]] = []

    def publish(publisher: Publisher, message: Any) -> None:
        if publisher.topic_name != '/markers':
            return
        read = deserialize_message(message, cls)
        # The texture of a marker has no stamp.
        stamps.append({stamp_to_ns(header.stamp) for header in headers(read)} - {0})
        if len(stamps) == 35:
            raise KeyboardInterrupt

    monkeypatch.setattr(Publisher, 'publish', publish)
    with pytest.raises(KeyboardInterrupt):
        play(bag, speed=50.0, wait=0.0, loop=True)
    first = 1_000_000_000
    assert stamps == [{first + k * 10_000_000} for k in range(35)]


def test_play_can_be_interrupted_while_it_waits_for_a_reader_that_has_stopped(
    unheard: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def wait(_: Publisher, timeout: Duration = Duration(seconds=-1)) -> bool:  # noqa: B008
        asked.append(timeout.nanoseconds * 1e-9)
        return len(asked) == 3

    monkeypatch.setattr(Publisher, 'wait_for_all_acked', wait)
    assert play(unheard, wait=0.1) == 3
    assert len(asked) == 3
    # Within rclpy nothing interrupts it.
    assert 0 < min(asked) <= max(asked) <= 1


def test_play_ends_with_a_warning_where_a_reader_never_takes_its_messages(
    unheard: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Publisher, 'wait_for_all_acked', lambda *_: False)
    monkeypatch.setattr(player_module, '_LONGEST_ACKNOWLEDGMENT', 0.0)
    assert play(unheard, wait=0.1) == 3
    assert capfd.readouterr().err.count('a subscriber of /unheard does not take its messages') == 1


def test_told_to_stop_node_and_recorder_end_and_the_recording_is_whole(
    peer: Peer, simulated: Bag, by_place: Path, tmp_path: Path
) -> None:
    logs, recording = (tmp_path / 'node', tmp_path / 'recorder'), tmp_path / 'live.mcap'
    with (
        process(*node_words(by_place), log=logs[0]) as node,
        process('record', '--output', recording, log=logs[1]) as recorder,
    ):
        odom = peer.hear('/kinpole/rod/odom', Odometry)
        drawn = peer.hear('/kinpole/visualization', MarkerArray)
        topic = '/kinpole/rod/odom'
        peer.until(lambda: peer.node.count_subscribers(topic) == 2, 'the recorder')
        with peer.publisher(MarkerArray) as publisher:
            # The recorder hears of all topics, and may be slower than we are.
            enough = lambda: drawn and len(odom) >= 30 and written(recording, topic) >= 25  # noqa: E731
            peer.feed(publisher, endless(simulated), enough, 'results and their recording')
        for told, sign in ((node, signal.SIGINT), (recorder, signal.SIGTERM)):
            told.send_signal(sign)
        gone = lambda: drawn[-1].markers[0].action == Marker.DELETEALL  # noqa: E731
        peer.until(gone, 'the end of what was drawn')
        assert [told.wait(LIMIT) for told in (node, recorder)] == [0, 0]
    assert [complaints(log) for log in logs] == [[], []]
    recorded = decoded(recording)
    assert len(recorded[topic]) >= 25
    assert recorded[topic][-1].header.frame_id == 'world'


REFUSED = [
    (['-p', 'windows:=0.3'], 'unknown parameter windows; did you mean window? known are '),
    (['-p', 'window:=-1.0'], 'parameter window is -1.0; it must be a number from 1e-06 to'),
    (['-p', 'plane:=zz'], 'one of xy, yz, zx'),
    (['-p', 'autostart:=5'], 'parameter autostart is 5; it must be true or false'),
    (['-p', 'bodies:=[]'], 'parameter bodies has no value'),
    (['-p', "marker_topic:='a b'"], "parameter marker_topic is 'a b'"),
    *([] if WITH_TF else [(['-p', 'marker_type:=tf', '-p', "body.markers:=['a']"],
                           'parameter marker_type is tf, and tf2_msgs is not installed')]),
    (['-p', 'marker_type:=marker', '-p', 'qos_overrides./markers.subscription.history:=much'],
     'parameters qos_overrides./markers.subscription cannot be used'),
    (['-p', 'qos_overrides./markers.subscription.relability:=reliable'],
     'unknown parameter qos_overrides./markers.subscription.relability; known are'),
    (['-p', 'qos_overrides./markers.subscription.depth:=-1'],
     'depth is -1; it must be a whole number from 1 up'),
    (['--params-file', 'none.yaml'], "parse params file: '--params-file none.yaml'"),
    (['--params-file', 'broken.yaml'], "parse params file: '--params-file broken.yaml'"),
    (['--unknown'], '--unknown'),
    (['--', 'window', '0.3'], 'unknown words window 0.3; those for ROS follow --ros-args'),
]  # fmt: skip

# What a user's own process says, without the time that each takes to begin.
FORKS = """
import json, os, sys
import kinpole_ros.ros.node
from kinpole_ros.tools.cli import main
for k, words in enumerate(json.loads(sys.argv[1])):
    if not os.fork():
        os.dup2(os.open(str(k), os.O_CREAT | os.O_WRONLY), 2)
        sys.exit(main(['node', '--ros-args', *words]))
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
"""


@pytest.fixture(scope='module')
def refusals(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[int, str]]:
    """How each node of `REFUSED` ends, and what it says."""
    folder = tmp_path_factory.mktemp('refused')
    (folder / 'broken.yaml').write_text('/**: {ros__parameters: {lag: 0.1')
    words = ['timeout', '-k', '2', '60', sys.executable, '-c', FORKS]
    cases = json.dumps([case for case, _ in REFUSED])
    done = subprocess.run([*words, cases], cwd=folder, stdout=subprocess.PIPE, text=True)
    said = [(folder / str(k)).read_text() for k in range(len(REFUSED))]
    return list(zip(map(int, done.stdout.split()), said, strict=True))


@pytest.mark.parametrize('case', range(len(REFUSED)))
def test_a_node_that_cannot_start_as_told_says_why_in_one_line(
    refusals: list[tuple[int, str]], case: int
) -> None:
    status, said = refusals[case]
    assert status == 2, said
    assert said.startswith('kinpole node: ')
    assert said.count('\n') == 1, said
    assert REFUSED[case][1] in said


def test_in_a_namespace_the_node_tells_under_its_full_name_and_of_what_was_given_in_vain(
    peer: Peer, tmp_path: Path
) -> None:
    config = tmp_path / 'other.yaml'
    config.write_text('kinpole: {ros__parameters: {lag: 0.05}}')
    slip = 'qos_overrides./markers.subscription.reliability'
    # A parameter of the node would be for this name.
    words = ['--params-file', config, '-p', f'{slip}:=reliable', '-r', '__ns:=/left']
    with process('node', '--ros-args', *words, log=tmp_path / 'stderr'):
        arrays = peer.hear('/diagnostics', DiagnosticArray)
        peer.until(lambda: arrays, 'diagnostics')
        names = [status.name for status in arrays[-1].status]
        assert names == ['left/kinpole: markers', 'left/kinpole: body']
    told = complaints(tmp_path / 'stderr')
    assert len(told) == 2, told
    assert f'{slip} set nothing: the markers come on /left/markers' in told[0]
    assert 'no parameter file has anything for /left/kinpole' in told[1]


def test_one_file_may_hold_the_qos_of_several_nodes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    qos = {f'qos_overrides./{n}.subscription.depth': 10 for n in ('markers', 'left/markers')}
    config = write_config(tmp_path / 'c.yaml', Settings(), **qos)
    rclpy.init(args=['kinpole', '--ros-args', '--params-file', str(config)])
    node = KinpoleNode()
    try:
        assert node.active
        assert '[WARN]' not in capfd.readouterr().err
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


# What nobody asks for


def test_nothing_is_computed_that_nobody_subscribes_to(
    peer: Peer, simulated: Bag, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int | None] = []

    class Watched(Tracker):
        def add(
            self, frames: MarkerFrames, order: int | None, events: bool = False
        ) -> list[Estimate]:
            asked.append(order)
            return super().add(frames, order, events)

    monkeypatch.setattr('kinpole_ros.ros.node.Tracker', Watched)
    context = rclpy.get_default_context()
    rclpy.init(args=['kinpole', '--ros-args', '-p', 'marker_type:=marker_array'])
    node = KinpoleNode()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    peer.also = lambda: executor.spin_once(timeout_sec=0)
    try:
        with peer.publisher(MarkerArray) as publisher:
            messages = endless(simulated)
            peer.feed(publisher, messages, lambda: asked, 'a frame')
            assert set(asked) == {None}
            subscriptions = []
            for topic, message_type, order in (
                ('/kinpole/body/odom', Odometry, 1),
                ('/kinpole/body/icr_velocity', Vector3Stamped, 2),
                ('/kinpole/state', PointCloud2, 4),
            ):
                subscriptions.append(
                    peer.node.create_subscription(message_type, topic, lambda _: None, 1)
                )
                asked.clear()
                reached = lambda order=order: asked and asked[-1] == order  # noqa: E731
                peer.feed(publisher, messages, reached, f'the order of {topic}')
                before = subscriptions[:-1]
                assert set(asked) <= {order, (None, 1, 2)[len(before)]}
            for subscription in subscriptions:
                peer.node.destroy_subscription(subscription)
            peer.feed(publisher, messages, lambda: asked[-1] is None, 'the end of the work')
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_what_pages_show_is_computed_30_times_a_second_and_after_all_else_is_sent(
    node: KinpoleNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, sent, now = [], [], 100.0

    class Scripted(Tracker):
        def add(self, frames: MarkerFrames, order: int | None, events: bool = False) -> list[Any]:
            asked.append(order)
            return [] if order is None else [SimpleNamespace(run=self.state.run)]

    def build(estimate: Any) -> Any:
        return [0], [estimate]

    class Sent:
        def __init__(self, topic: str) -> None:
            self.publish = lambda data: sent.append(topic)
            self.handle = SimpleNamespace(publish_raw=self.publish)

    view = live_outputs(node.settings, None)[-1]
    assert view.topic == VIEW
    monkeypatch.setattr('kinpole_ros.ros.node.time.monotonic', lambda: now)
    frames = MarkerFrames(np.zeros(1, np.int64), 'world', ('a',), np.zeros((1, 1, 3)))
    monkeypatch.setattr(node.source, 'take', lambda *_: ([frames], 0))
    monkeypatch.setattr(node, '_tracker', Scripted(node.settings))
    for read, order in (([], None), ([Output('odom', Odometry, 1, build)], 1)):
        asked.clear()
        monkeypatch.setattr(node.results, '_display_due', 0.0)
        shown = view._replace(build=build)
        node.results.use([(row, Sent(row.topic)) for row in (*read, shown)])
        # A second of frames at 200 Hz.
        for _ in range(200):
            now += 0.005
            node._on_markers(b'', {})
        assert 25 <= asked.count(4) <= 30
        assert set(asked) == {4, order}
        assert sent.count(VIEW) == asked.count(4)
        assert sent.count('odom') == (200 if read else 0)
        assert sent[:2] == (['odom', VIEW] if read else [VIEW, VIEW])
        sent.clear()


def test_a_node_that_is_subscribed_looks_for_publishers_once_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also while none is there: ten looks a second were most of what an idle node did."""
    rclpy.init(args=['kinpole', '--ros-args', '-p', 'marker_type:=marker_array'])
    node = KinpoleNode()
    try:
        assert node.source.is_subscribed
        looks: list[str] = []
        find = node.get_publishers_info_by_topic

        def look(topic: str) -> Any:
            looks.append(topic)
            return find(topic)

        monkeypatch.setattr(node, 'get_publishers_info_by_topic', look)
        for _ in range(5):
            node.source.update()
        assert len(looks) <= 1
    finally:
        node.close_outputs()
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.parametrize('override', [(), ('reliability:=best_effort',)])
def test_markers_are_asked_for_as_reliably_as_all_publishers_offer(
    override: tuple[str, ...],
) -> None:
    """And again when one joins or leaves, unless the user says how."""
    words = [f'qos_overrides./markers.subscription.{word}' for word in override]
    rclpy.init(args=['kinpole', '--ros-args', *itertools.chain(*(('-p', w) for w in words))])
    node = KinpoleNode()

    def asks_for(expected: ReliabilityPolicy) -> None:
        deadline = time.monotonic() + LIMIT
        while True:
            node.source._update_due = 0.0
            node.source.update()
            found = [one.qos_profile.reliability for one in node.source.subscriptions]
            if found == [expected]:
                return
            assert time.monotonic() < deadline, found

    reliable, best_effort = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
    least = best_effort if override else reliable
    try:
        offers = [QoSProfile(depth=1, reliability=one) for one in (reliable, best_effort)]
        node.create_publisher(ros_class(MarkerArray), '/markers', offers[0])
        asks_for(least)
        other = node.create_publisher(ros_class(MarkerArray), '/markers', offers[1])
        asks_for(best_effort)
        node.destroy_publisher(other)
        asks_for(least)
    finally:
        node.close_outputs()
        node.destroy_node()
        rclpy.try_shutdown()


def test_a_late_subscriber_learns_from_the_rig_what_the_results_are(
    peer: Peer, tmp_path: Path, by_place: Path
) -> None:
    """Also after a change of parameters, which is a new run."""
    log = tmp_path / 'node.log'
    with process(*node_words(by_place), log=log), peer.publisher(PointCloud2) as markers:
        state = peer.hear('/kinpole/state', PointCloud2)
        stamps = itertools.count(10**9, 10**7)
        corners = np.array([[0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]])
        frames = (
            to_message('point_cloud2', stamp, 'world', list('0123'), corners) for stamp in stamps
        )
        peer.feed(markers, frames, lambda: len(state) > 50, 'results')
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        rigs: list[dict[str, Any]] = []
        add = lambda message: rigs.append(json.loads(message.data))  # noqa: E731
        peer.node.create_subscription(String, '/kinpole/rig', add, qos)
        peer.until(lambda: rigs, 'what the node says of itself')
        (body,) = rigs[0]['bodies']
        assert (body['name'], rigs[0]['frame_id'], rigs[0]['plane']['name']) == (
            *('rod', 'world', 'xy'),
        )
        assert body['size'] == pytest.approx(0.2) and list(body['markers']) == list('0123')
        peer.set(lag=0.01)
        peer.until(lambda: rigs[-1]['lag'] == 0.01, 'the new lag')
        assert rigs[-1]['run'] > rigs[0]['run'] and rigs[-1]['bodies'][0]['size'] is None
    assert not complaints(tmp_path / 'node.log')
