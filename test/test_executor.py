"""How the node waits: markers never keep all else from its turn."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.node import Node

from kinpole_ros.ros.executor import MessagesFirst


class Flood:
    """Stands for markers that come without end."""

    def __init__(self) -> None:
        self.found = True
        self.waited: list[float] = []

    def wait(self, seconds: float) -> bool:
        self.waited.append(seconds)
        return True


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init(args=[])
    node = rclpy.create_node('waiting')
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def spin(node: Node, flood: Flood, until: Callable[[], Any]) -> None:
    executor = MessagesFirst(flood)
    executor.add_node(node)
    deadline = time.monotonic() + 10
    try:
        while not until():
            assert time.monotonic() < deadline
            executor.spin_once()
    finally:
        executor.shutdown()


def test_timers_and_services_have_their_turn_in_a_flood_of_markers(node: Node) -> None:
    beats: list[int] = []
    node.create_timer(0.02, lambda: beats.append(1))
    client = node.create_client(ListParameters, '/waiting/list_parameters')
    flood = Flood()
    spin(node, flood, client.service_is_ready)
    answer = client.call_async(ListParameters.Request())
    spin(node, flood, lambda: answer.done() and len(beats) > 3)
    # And markers are what it waits for, never for long at a time.
    assert len(flood.waited) > 100
    assert max(flood.waited) <= 0.1


def test_while_no_markers_come_all_else_waits_a_tenth_of_a_second_at_most(node: Node) -> None:
    beats: list[float] = []
    node.create_timer(0.02, lambda: beats.append(time.monotonic()))
    silence = Flood()

    def wait(seconds: float) -> bool:
        silence.waited.append(seconds)
        time.sleep(seconds)
        return False

    silence.wait = wait  # type: ignore[method-assign]
    spin(node, silence, lambda: len(beats) > 3)
    assert max(silence.waited) <= 0.1
    # One wait for each turn: it does not wake in between.
    assert len(silence.waited) <= len(beats) + 1


def test_with_no_topic_of_markers_it_waits_as_ever(node: Node) -> None:
    flood = Flood()
    flood.found = False
    beats: list[int] = []
    node.create_timer(0.02, lambda: beats.append(1))
    spin(node, flood, lambda: len(beats) > 3)
    assert not flood.waited


def test_what_fails_is_raised_once_and_the_rest_has_its_turn(node: Node) -> None:
    beats: list[int] = []

    def fail() -> None:
        raise ValueError('of a timer')

    failing = node.create_timer(0.02, fail)
    node.create_timer(0.02, lambda: beats.append(1))
    flood = Flood()
    with pytest.raises(ValueError, match='of a timer'):
        spin(node, flood, lambda: False)
    failing.cancel()
    spin(node, flood, lambda: len(beats) > 3)


def test_markers_that_fail_each_time_leave_all_else_its_turn(node: Node) -> None:
    """So that diagnostics go on to tell of it."""
    beats: list[int] = []
    node.create_timer(0.02, lambda: beats.append(1))
    flood = Flood()

    def fail(seconds: float) -> bool:
        raise ValueError('of markers')

    flood.wait = fail  # type: ignore[method-assign]
    executor = MessagesFirst(flood)
    executor.add_node(node)
    deadline = time.monotonic() + 10
    try:
        while len(beats) < 3:
            assert time.monotonic() < deadline
            with suppress(ValueError):
                executor.spin_once()
    finally:
        executor.shutdown()
