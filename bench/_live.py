"""
What the live node costs, against a relay: the least that any ROS 2 node in Python can do.

The relay reads the same message the ordinary way and publishes one Vector3Stamped. Both run at the
same time, each in its own process, and are asked in turn.
"""

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, Vector3Stamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2

from bench._speed import compared
from kinpole_ros.messages import stamp_to_ns, to_message

RELAY = 'relay'
NODE = 'kinpole'
RESULTS = {
    'angular_velocity': Vector3Stamped,
    'icr': PointStamped,
    'centrode_curvature': Vector3Stamped,
}
LAG = 100_000_000
_MARKERS = 20
_BODY = ['3', '7', '11', '15']
_BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
_WAIT = 20.0
# As many messages may wait for the relay as for the node.
_DEPTH = 200
# Rates tried, each so many times the one before unless asked otherwise, for so long (s), up to so
# often: whatever else runs on the machine may take a core for a moment.
_STEP_UP = 1.1
_TRY = 2.0
_TRIES = 3
_LOWEST, _HIGHEST = 500.0, 12000.0


class Latency(NamedTuple):
    """Times from sending a message to the arrival of its last result, s."""

    times: np.ndarray
    sent: int

    def percentile(self, share: float) -> float:
        """Time that this share (0 to 100) of the messages is answered within, s."""
        return float(np.percentile(self.times, share))


class Live(NamedTuple):
    """Latency and highest rate (Hz) of node and relay; start and help in s."""

    latency: dict[str, Latency]
    rate: dict[str, float]
    first_answer: float
    help: float


def relay() -> None:
    """The other node: read, publish one vector, count. Runs until told to stop."""
    rclpy.init()
    node = rclpy.create_node(RELAY)
    publisher = node.create_publisher(Vector3Stamped, f'/{RELAY}/answer', 10)
    counter = node.create_publisher(Vector3Stamped, f'/{RELAY}/count', 1)
    count = 0

    def answer(cloud: PointCloud2) -> None:
        nonlocal count
        count += 1
        publisher.publish(Vector3Stamped(header=cloud.header))

    def tell() -> None:
        message = Vector3Stamped()
        message.vector.x = float(count)
        counter.publish(message)

    node.create_subscription(
        PointCloud2, f'/{RELAY}/markers', answer, QoSProfile(depth=_DEPTH, reliability=_BEST_EFFORT)
    )
    node.create_timer(0.2, tell)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


class Cloud:
    """Clouds of 20 markers, four of them on a wheel that rolls and speeds up and down, as bytes."""

    def __init__(self) -> None:
        names = [str(k) for k in range(_MARKERS)]
        still = np.arange(3.0 * _MARKERS).reshape(_MARKERS, 3) / 10 + 2
        self._data = serialize_message(to_message('point_cloud2', 0, 'world', names, still))
        self._start = self._data.index(still.tobytes())
        self._points = still
        self._noise = np.random.default_rng(1)
        self._arms = 0.1 * np.exp(2j * np.pi * np.array([0.0, 0.2, 0.45, 0.8]))

    def at(self, stamp: int, hidden: bool = False, off: bool = False) -> bytes:
        """The message of an instant, ns, maybe with a marker of the body hidden or 0.1 m off."""
        t = stamp % 10**12 * 1e-9
        angle = 6 * t + 0.5 * math.sin(3 * t)
        flat = -0.1 * angle + self._arms * np.exp(1j * angle)
        body = self._points[[int(name) for name in _BODY]]
        body[:, 0], body[:, 1] = flat.real, flat.imag
        body[:, :2] += 2e-4 * self._noise.normal(size=(4, 2))
        body[:, 2] = 0
        if hidden:
            body[self._noise.integers(4)] = np.nan
        if off:
            body[self._noise.integers(4)] += 0.1
        self._points[[int(name) for name in _BODY]] = body
        made = bytearray(self._data)
        made[self._start : self._start + self._points.nbytes] = self._points.tobytes()
        made[4:12] = np.array(divmod(stamp, 10**9), '<u4').tobytes()
        return bytes(made)


class Asker:
    """A ROS node that sends clouds and hears answers."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node('asker', context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        qos = QoSProfile(depth=10, reliability=_BEST_EFFORT)
        self.publishers = {
            name: self.node.create_publisher(PointCloud2, f'/{name}/markers', qos)
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

    def hear(self, topic: str, message_type: type, qos: Any = 10) -> list[tuple[Any, int]]:
        """Messages from now on, as bytes, and when the middleware received them, ns."""
        heard: list[tuple[Any, int]] = []

        def keep(data: bytes, info: Mapping[str, int]) -> None:
            heard.append((data, info['received_timestamp']))

        self.node.create_subscription(message_type, topic, keep, qos, raw=True)
        return heard


@contextmanager
def processes() -> Iterator[dict[str, 'subprocess.Popen[bytes]']]:
    """Node and relay, each in its process, on a domain of their own."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(200 + os.getpid() % 32))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with (
        tempfile.TemporaryDirectory() as folder,
        started(node_words(Path(folder))) as node,
        started(_relay_words()) as other,
    ):
        yield {NODE: node, RELAY: other}


def node_words(folder: Path) -> list[str]:
    """The command that starts the node with its one body, with its parameters in `folder`."""
    config = folder / 'config.yaml'
    config.write_text(
        '/**: {ros__parameters: {bodies: [rod], rod: {markers: '
        f'{_BODY}}}, marker_topic: /{NODE}/markers, marker_type: point_cloud2, '
        f'lag: {LAG * 1e-9}}}}}\n'
    )
    # What it says of itself would run through the bar of progress.
    quiet = ['--log-level', 'kinpole:=warn']
    return [
        '-m',
        'kinpole_ros.tools.cli',
        'node',
        '--ros-args',
        *quiet,
        '--params-file',
        str(config),
    ]


def _relay_words() -> list[str]:
    return ['-c', 'from bench._live import relay; relay()']


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


def measure_live(
    messages: int = 2000,
    rate: float = 200.0,
    step_up: float = _STEP_UP,
    progress: Callable[[float], None] | None = None,
) -> Live:
    """
    Measure all of it.

    `messages` are sent to each of the two at `rate` Hz for the latency; of the rates they hold,
    each tried is `step_up` times the one before. `progress` is called with the share done, by time.
    """
    tell = progress or (lambda share: None)
    tell(0.0)
    with processes():
        asker = Asker()
        try:
            for name, publisher in asker.publishers.items():
                asker.until(publisher.get_subscription_count, f'{name} at its markers')
            latency = _latency(asker, messages, rate)
        finally:
            asker.close()
    with processes():
        asker = Asker()
        try:
            for name, publisher in asker.publishers.items():
                asker.until(publisher.get_subscription_count, f'{name} at its markers')
            rates = _rates(asker, step_up, lambda share: tell(0.05 + 0.9 * share))
        finally:
            asker.close()
    tell(0.95)
    starts = [_first_answer() for _ in range(3)]
    helps = [_help() for _ in range(5)]
    return Live(latency, rates, float(np.median(starts)), float(np.median(helps)))


def _latency(asker: Asker, messages: int, rate: float) -> dict[str, Latency]:
    heard = {
        NODE: [asker.hear(f'/{NODE}/rod/{topic}', kind) for topic, kind in RESULTS.items()],
        RELAY: [asker.hear(f'/{RELAY}/answer', Vector3Stamped)],
    }
    types = {NODE: list(RESULTS.values()), RELAY: [Vector3Stamped]}
    sent: dict[str, dict[int, int]] = {NODE: {}, RELAY: {}}
    cloud = Cloud()
    step = round(1e9 / rate)
    stamp = 10**12
    warm_up = 200
    due = time.monotonic()
    for _ in range(messages + warm_up):
        stamp += step
        # In turn, so that each has them at even times.
        for name in (NODE, RELAY):
            data = cloud.at(stamp)
            due += 0.5 / rate
            # What is heard is taken off before the moment to send, and nothing runs after it.
            while (left := due - time.monotonic()) > 0:
                asker.executor.spin_once(timeout_sec=max(0, left - 2e-4))
            sent[name][stamp] = time.time_ns()
            asker.publishers[name].publish(data)
    quiet = time.monotonic() + 0.5
    asker.until(lambda: time.monotonic() > quiet, 'the last answers')
    found = {}
    for name, lists in heard.items():
        lag = LAG if name == NODE else 0
        arrived: dict[int, list[int]] = {}
        for listed, kind in zip(lists, types[name], strict=True):
            for data, received in listed:
                answered = stamp_to_ns(deserialize_message(data, kind).header.stamp) + lag
                arrived.setdefault(answered, []).append(received)
        first = 10**12 + warm_up * step
        times = [
            max(received) - sent[name][stamp]
            for stamp, received in arrived.items()
            if stamp > first and stamp in sent[name] and len(received) == len(lists)
        ]
        found[name] = Latency(np.array(times) * 1e-9, messages)
    return found


def _rates(asker: Asker, step_up: float, tell: Callable[[float], None]) -> dict[str, float]:
    """The highest rate (Hz) at which each loses nothing, while its answers are subscribed to."""
    # Subscribed to and never taken: so they are sent, and cost this process next to nothing.
    sink = rclpy.create_node('sink', context=asker.node.context)
    for topic, kind in RESULTS.items():
        sink.create_subscription(kind, f'/{NODE}/rod/{topic}', lambda _: None, 1, raw=True)
    sink.create_subscription(Vector3Stamped, f'/{RELAY}/answer', lambda _: None, 1, raw=True)
    told = {
        NODE: asker.hear('/diagnostics', DiagnosticArray),
        RELAY: asker.hear(f'/{RELAY}/count', Vector3Stamped),
    }
    cloud = Cloud()
    # Made before: the sender must not be what limits.
    frames = [cloud.at(10**12 + k * 1_000_000) for k in range(2000)]
    stamps = {NODE: 2 * 10**12, RELAY: 2 * 10**12}

    def held(name: str, rate: float) -> bool:
        before = _received(asker, name, told[name])
        count, achieved = _send(asker.publishers[name], frames, rate, stamps, name)
        after = _received(asker, name, told[name])
        return after - before == count and achieved >= 0.95 * rate

    best = {}
    for number, name in enumerate((NODE, RELAY)):
        rate = _LOWEST
        best[name] = 0.0
        while rate < _HIGHEST:
            # As if both came to the highest: one that does not is done sooner, not later.
            tell((number + math.log(rate / _LOWEST) / math.log(_HIGHEST / _LOWEST)) / 2)
            if not any(held(name, rate) for _ in range(_TRIES)):
                break
            best[name] = rate
            rate *= step_up
    sink.destroy_node()
    return best


def _received(asker: Asker, name: str, told: list[tuple[Any, int]]) -> int:
    """How many messages it took so far, once that stands still."""
    before = -1
    while True:
        told.clear()
        asker.until(lambda: told, f'the count of {name}')
        data = told[-1][0]
        if name == RELAY:
            now = int(deserialize_message(data, Vector3Stamped).vector.x)
        else:
            status = deserialize_message(data, DiagnosticArray).status[0]
            now = int({v.key: v.value for v in status.values}['frames received'])
        if now == before:
            return now
        before = now


def _send(
    publisher: Any, frames: list[bytes], rate: float, stamps: dict[str, int], name: str
) -> tuple[int, float]:
    """Send for a while; returns how many were sent, and the rate that was reached, Hz."""
    count = round(_TRY * rate)
    step = round(1e9 / rate)
    start = time.monotonic()
    for k in range(count):
        stamps[name] += step
        data = bytearray(frames[round(k * step / 1e6) % len(frames)])
        data[4:12] = np.array(divmod(stamps[name], 10**9), '<u4').tobytes()
        left = start + k / rate - time.monotonic()
        if left > 0:
            time.sleep(left)
        publisher.publish(bytes(data))
    return count, count / (time.monotonic() - start)


def _first_answer() -> float:
    """From the start of the process to the first result, s, with markers there already."""
    asker = Asker()
    heard = asker.hear(f'/{NODE}/rod/angular_velocity', Vector3Stamped)
    cloud = Cloud()
    begun = time.monotonic_ns()

    def send_and_look() -> bool:
        asker.publishers[NODE].publish(cloud.at(10**12 + time.monotonic_ns() - begun))
        # About 200 Hz.
        until = time.monotonic() + 0.005
        while (left := until - time.monotonic()) > 0:
            asker.executor.spin_once(timeout_sec=left)
        return bool(heard)

    with tempfile.TemporaryDirectory() as folder:
        words = node_words(Path(folder))
        start = time.time_ns()
        with started(words):
            asker.until(send_and_look, 'the first answer')
    asker.close()
    return (heard[0][1] - start) * 1e-9


def _help() -> float:
    start = time.monotonic()
    subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', '--help'],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.monotonic() - start


def live_rows(live: Live) -> list[dict[str, Any]]:
    """One row by comparison, as of `_speed.speed_rows`; a time alone is compared with 1 s."""
    node, other = live.latency[NODE], live.latency[RELAY]
    rows = []
    for share, bar in ((50, 1.5), (99, 2.0)):
        ours, theirs = (1e6 * each.percentile(share) for each in (node, other))
        rows.append(compared(f'latency, p{share}, against a relay', ours, theirs, 'µs', bar))
    rates = live.rate[NODE], live.rate[RELAY]
    held = compared('rate held without a drop, against the relay', *rates, 'Hz', 0.5)
    rows.append(held | {'least': True})
    rows.append(compared('node from start to first answer', live.first_answer, 1.0, 's', 2.0))
    rows.append(compared('kinpole --help', live.help, 1.0, 's', 0.3))
    return rows
