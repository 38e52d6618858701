"""How the node waits: messages never keep all else from its turn, whichever executor waits."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Int64, String

from kinpole_ros.ros import executor as executor_module
from kinpole_ros.ros.executor import LeanExecutor, make_executor
from kinpole_ros.ros.private import PreparedWait, take

KINDS = ('lean', 'rclpy')
LIMIT = 10.0


class Source:
    """A topic of messages; where `is_flood` is set each has another one follow at once."""

    def __init__(self, node: Node, is_flood: bool = True) -> None:
        self._node = node
        self._is_flood = is_flood
        self.subscriptions: list[Any] = []
        self.publisher = node.create_publisher(String, 'flood', 10)
        self.by_source = self.by_rclpy = 0
        self.failing = False

    @property
    def count(self) -> int:
        return self.by_source + self.by_rclpy

    def subscribe(self) -> None:
        for subscription in self.subscriptions:
            self._node.destroy_subscription(subscription)
        made = self._node.create_subscription(String, 'flood', self._on_message, 10, raw=True)
        self.subscriptions = [made]

    def begin(self) -> None:
        deadline = time.monotonic() + LIMIT
        while self.publisher.get_subscription_count() != 1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        self.publisher.publish(String(data='first'))

    def take_messages(self) -> None:
        for _ in take(self.subscriptions[0], 10):
            self.by_source += 1
            self._answer()

    def _on_message(self, _: bytes) -> None:
        self.by_rclpy += 1
        self._answer()

    def _answer(self) -> None:
        if self._is_flood:
            self.publisher.publish(String(data='next'))
        if self.failing:
            raise ValueError('of messages')


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init(args=[])
    node = rclpy.create_node('waiting')
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def flood_of(node: Node) -> Source:
    source = Source(node)
    source.subscribe()
    source.begin()
    return source


def spin(executor: Executor, until: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LIMIT
    while not until():
        assert time.monotonic() < deadline
        executor.spin_once()


@pytest.mark.parametrize('kind', KINDS)
def test_timers_and_services_have_their_turn_in_a_flood_of_messages(node: Node, kind: str) -> None:
    source = flood_of(node)
    executor = make_executor(source, node, kind)
    assert isinstance(executor, LeanExecutor) == (kind == 'lean')
    calls: list[int] = []
    node.create_timer(0.02, lambda: calls.append(1))
    client = node.create_client(ListParameters, '/waiting/list_parameters')
    spin(executor, client.service_is_ready)
    answer = client.call_async(ListParameters.Request())
    spin(executor, lambda: answer.done() and len(calls) > 3 and source.count > 100)
    assert (source.by_source, source.by_rclpy)[kind == 'lean'] == 0
    executor.shutdown()


@pytest.mark.parametrize('kind', KINDS)
def test_all_else_has_its_turn_in_a_flood_of_messages(node: Node, kind: str) -> None:
    """Other subscriptions, answers to clients and guard conditions."""
    source = flood_of(node)
    executor = make_executor(source, node, kind)
    heard: list[int] = []
    guarded: list[int] = []
    node.create_subscription(Int64, 'other', lambda message: heard.append(message.data), 10)
    guard = node.create_guard_condition(lambda: guarded.append(1))
    other = node.create_publisher(Int64, 'other', 10)
    spin(executor, other.get_subscription_count)
    for number in range(3):
        other.publish(Int64(data=number))
    guard.trigger()
    spin(executor, lambda: heard == [0, 1, 2] and guarded)
    executor.shutdown()


def test_while_no_messages_come_all_else_waits_a_tenth_of_a_second_at_most(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    class Counted(PreparedWait):
        def wait(self, seconds: float) -> bool:
            waits.append(seconds)
            return super().wait(seconds)

    monkeypatch.setattr(executor_module, 'PreparedWait', Counted)
    source = Source(node, is_flood=False)
    source.subscribe()
    executor = make_executor(source, node)
    calls: list[float] = []
    node.create_timer(0.02, lambda: calls.append(time.monotonic()))
    spin(executor, lambda: len(calls) > 3)
    # A wake costs 0.3 ms, so that 20 a second were half of an idle node.
    assert 0.09 < max(waits) <= 0.1
    # One wait of some time for each turn: it does not wake in between.
    assert len([seconds for seconds in waits if seconds]) <= len(calls) + 1
    executor.shutdown()


def test_a_subscription_that_comes_later_is_waited_for_and_one_that_goes_is_let_go(
    node: Node,
) -> None:
    source = Source(node, is_flood=False)
    executor = make_executor(source, node)
    calls: list[int] = []
    timer = node.create_timer(0.02, lambda: calls.append(1))
    spin(executor, lambda: len(calls) > 3)
    for number in range(1, 4):
        # Each time another one, as where the type of the markers changes.
        source.subscribe()
        spin(executor, lambda: source.publisher.get_subscription_count() == 1)
        source.begin()
        spin(executor, lambda number=number: source.count == number)
    assert source.by_rclpy == 0
    node.destroy_subscription(source.subscriptions.pop())
    spin(executor, lambda: not source.publisher.get_subscription_count())
    node.destroy_timer(timer)
    calls.clear()
    node.create_timer(0.02, lambda: calls.append(1))
    spin(executor, lambda: len(calls) > 3)
    executor.shutdown()


def test_a_service_that_comes_later_is_waited_for(node: Node) -> None:
    source = flood_of(node)
    executor = make_executor(source, node)
    spin(executor, lambda: source.count > 10)
    service = node.create_service(ListParameters, 'late', lambda request, response: response)
    client = node.create_client(ListParameters, 'late')
    spin(executor, client.service_is_ready)
    answer = client.call_async(ListParameters.Request())
    spin(executor, answer.done)
    node.destroy_service(service)
    spin(executor, lambda: not client.service_is_ready())
    executor.shutdown()


@pytest.mark.parametrize('kind', KINDS)
def test_what_fails_is_raised_once_and_the_rest_has_its_turn(node: Node, kind: str) -> None:
    executor = make_executor(flood_of(node), node, kind)
    calls: list[int] = []

    def fail() -> None:
        raise ValueError('of a timer')

    failing = node.create_timer(0.02, fail)
    node.create_timer(0.02, lambda: calls.append(1))
    with pytest.raises(ValueError, match='of a timer'):
        spin(executor, lambda: False)
    failing.cancel()
    spin(executor, lambda: len(calls) > 3)
    executor.shutdown()


@pytest.mark.parametrize('kind', KINDS)
def test_messages_that_fail_each_time_leave_all_else_its_turn(node: Node, kind: str) -> None:
    """So that diagnostics go on to tell of it."""
    source = flood_of(node)
    source.failing = True
    executor = make_executor(source, node, kind)
    calls: list[int] = []
    node.create_timer(0.02, lambda: calls.append(1))
    deadline = time.monotonic() + LIMIT
    while len(calls) < 3 or source.count < 3:
        assert time.monotonic() < deadline
        with suppress(ValueError):
            executor.spin_once()
    executor.shutdown()


@pytest.mark.parametrize('error', [AttributeError('no add_service'), TypeError('7 arguments')])
def test_where_rclpy_has_changed_its_own_executor_waits_and_one_warning_says_so(
    node: Node,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    error: Exception,
) -> None:
    def change(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(executor_module, 'PreparedWait', change)
    source = flood_of(node)
    executor = make_executor(source, node)
    spin(executor, lambda: source.count > 10)
    source.subscribe()
    source.begin()
    before = source.count
    spin(executor, lambda: source.count > before)
    executor.shutdown()
    assert source.by_source == 0
    (line,) = [line for line in capfd.readouterr().err.splitlines() if 'internals' in line]
    assert str(error) in line and 'set the parameter executor to rclpy' in line


def test_the_executor_of_rclpy_is_one_of_its_own_classes(node: Node) -> None:
    source = Source(node)
    executor = make_executor(source, node, 'rclpy')
    assert type(executor) is SingleThreadedExecutor
    assert executor.get_nodes() == [node]
    executor.shutdown()
