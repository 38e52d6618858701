"""The other side of the live node: what sends it markers and hears its results, and the relay."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from geometry_msgs.msg import Vector3Stamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from kinpole_ros.messages import ROS_TYPE_NAMES, installed_class, serialize_message, to_message
from kinpole_ros.ros.source import SUBSCRIPTION_DEPTH

RELAY = 'relay'
NODE = 'kinpole'
# s.
LAG = 0.1
_MARKERS = 20
_BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
_WAIT = 20.0


def wheels(bodies: int) -> dict[str, list[str]]:
    """The markers of each body, by its name: four of 20 markers, or of all there are."""
    stride = max(_MARKERS // 4, bodies)
    return {f'wheel_{b}': [str(b + k * stride) for k in range(4)] for b in range(bodies)}


class Rig:
    """Wheels that roll and speed up and down, each with four markers, among 20 or more."""

    def __init__(self, bodies: int = 1, kind: str = 'point_cloud2') -> None:
        places = np.array([[int(name) for name in names] for names in wheels(bodies).values()])
        count = max(_MARKERS, 4 * bodies)
        self._kind = kind
        self._places = places
        self._names = [str(k) for k in range(count)]
        self._points = np.arange(3.0 * count).reshape(count, 3) / 10 + 2
        self._noise = np.random.default_rng(1)
        self._arms = 0.1 * np.exp(2j * np.pi * np.array([0.0, 0.2, 0.45, 0.8]))

    def at(self, stamp: int, hidden: bool = False, off: bool = False) -> bytes:
        """
        The message of an instant, ns.

        One marker of the first body may be hidden, or 0.1 m off.
        """
        t = stamp % 10**12 * 1e-9
        number = np.arange(len(self._places))[:, None]
        angle = (6 + 0.3 * number) * t + 0.5 * np.sin(3 * t + number)
        flat = 0.5j * number - 0.1 * angle + self._arms * np.exp(1j * angle)
        seen = np.stack((flat.real, flat.imag, np.zeros_like(flat.real)), axis=-1)
        seen[..., :2] += 2e-4 * self._noise.normal(size=(*flat.shape, 2))
        if hidden:
            seen[0, self._noise.integers(4)] = np.nan
        if off:
            seen[0, self._noise.integers(4)] += 0.1
        self._points[self._places] = seen
        return serialize_message(to_message(self._kind, stamp, 'world', self._names, self._points))


class Asker:
    """A ROS node that sends markers and hears answers."""

    def __init__(self, kind: str = 'point_cloud2') -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node('asker', context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        qos = QoSProfile(depth=10, reliability=_BEST_EFFORT)
        self.publishers = {
            name: self.node.create_publisher(
                installed_class(ROS_TYPE_NAMES[kind]), f'/{name}/markers', qos
            )
            for name in (NODE, RELAY)
        }

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Let things happen until the condition holds; TimeoutError if it does not in time."""
        deadline = time.monotonic() + _WAIT
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f'live bench: {what}: not within {_WAIT:g} s')
            self.executor.spin_once(timeout_sec=0.02)

    def until_found(self, topics: Iterable[str]) -> None:
        """Let things happen until node and relay read their markers, and publish these topics."""
        for name, publisher in self.publishers.items():
            self.until(publisher.get_subscription_count, f'{name} at its markers')
        for topic in topics:
            self.until(partial(self.node.count_publishers, topic), f'a publisher of {topic}')

    def hear(self, topic: str, message_type: type) -> list[tuple[Any, int]]:
        """Messages from now on, as bytes, and when the middleware received them, ns."""
        heard: list[tuple[Any, int]] = []

        def keep(data: bytes, info: Mapping[str, int]) -> None:
            heard.append((data, info['received_timestamp']))

        self.node.create_subscription(message_type, topic, keep, 10, raw=True)
        return heard


def relay(kind: str) -> None:
    """Read each message of markers as rclpy makes it and publish one vector, until stopped."""
    rclpy.init()
    node = rclpy.create_node(RELAY)
    publisher = node.create_publisher(Vector3Stamped, f'/{RELAY}/answer', 10)

    def answer(message: Any) -> None:
        header = message.markers[0].header if kind == 'marker_array' else message.header
        publisher.publish(Vector3Stamped(header=header))

    qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=_BEST_EFFORT)
    node.create_subscription(
        installed_class(ROS_TYPE_NAMES[kind]), f'/{RELAY}/markers', answer, qos
    )
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


@contextmanager
def processes(
    bodies: int = 1, kind: str = 'point_cloud2', lag: float = LAG
) -> Iterator[dict[str, 'subprocess.Popen[bytes]']]:
    """Node and relay, each in its process, on a domain of their own."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 90))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    relay_words = ['-c', f'from bench._rig import relay; relay({kind!r})']
    with (
        tempfile.TemporaryDirectory() as folder,
        started(node_words(Path(folder), bodies, kind, lag)) as node,
        started(relay_words) as other,
    ):
        yield {NODE: node, RELAY: other}


def node_words(
    folder: Path, bodies: int = 1, kind: str = 'point_cloud2', lag: float = LAG
) -> list[str]:
    """The command that starts the node, with a file of its parameters in `folder`."""
    config = folder / 'config.yaml'
    values = {
        'marker_topic': f'/{NODE}/markers',
        'marker_type': kind,
        'lag': lag,
        'topics': 'all',
        'bodies': list(wheels(bodies)),
        **{name: {'markers': markers} for name, markers in wheels(bodies).items()},
    }
    config.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    # Its log would run through the bar of progress.
    quiet = ['--log-level', 'kinpole:=warn']
    words = ['-m', 'kinpole_ros.tools.cli', 'node', '--ros-args', *quiet]
    return [*words, '--params-file', str(config)]


@contextmanager
def started(words: list[str]) -> Iterator['subprocess.Popen[bytes]']:
    """A Python process that is ended with the block."""
    process = subprocess.Popen([sys.executable, *words])
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
