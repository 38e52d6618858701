"""
`kinpole demo`: a node, a bag that is played into it over DDS, and a recording of its results.

Node, recorder and player are processes of their own, as on a rig. The recording is compared with
the exact motion in the bag.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor

from kinpole_ros.bags import BagError, read_messages
from kinpole_ros.mechanism import share_folder
from kinpole_ros.messages import stamp_to_ns
from kinpole_ros.ros.player import own_context, play
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.plot import decode, plot, row_of
from kinpole_ros.tracking.values import POLE_NAMES

_START_TIMEOUT, _STOP_TIMEOUT = 20.0, 10.0  # s
# Seconds without a result after the last marker, after which all have arrived. Fast DDS resends
# lost messages every 3 s.
_SILENCE = 3.5
_UNITS = {
    'angular_velocity': 'rad/s',
    'angular_acceleration': 'rad/s^2',
    **dict.fromkeys(POLE_NAMES[:3], 'm'),
    'centrode_curvature': '1/m',
}
_TABLE = '{:9} {:21} {:>8} {:>13} {:>10} {:>9} {:>12}  {}'


def demo(output: str | Path) -> int:
    """Run the demo, writing into the folder `output`; return the exit status."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    share = share_folder()
    bag, config = share / 'bags' / 'four_bar.mcap', share / 'config' / 'four_bar.yaml'
    if not bag.exists():
        raise BagError(f'{bag} is missing; make it with make bags')
    recording, picture = folder / 'demo.mcap', folder / 'demo.png'
    # A domain of its own, so that other nodes do not interfere, and stay undisturbed.
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 90))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

    # By default SIGTERM would leave node and recorder running.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    recording.unlink(missing_ok=True)
    print(f'node:     kinpole node --ros-args --params-file {config}')
    print(f'recorder: kinpole record --output {recording}')
    print(f'player:   kinpole play {bag}')
    count = live_run(bag, config, recording)
    print(f'{count} frames of markers played over DDS; what the node said is in {recording}\n')
    print('latency: from a frame to its results, as the recorder received both')
    for line in _comparison_lines(bag, recording, load_settings(config)):
        print(line)
    plot(recording, picture, truth=bag)
    print(f'\nthe picture: {picture}')
    return 0


def live_run(bag: Path, config: Path, recording: Path) -> int:
    """
    Play the markers of `bag` into a node; record them and all that it publishes.

    The node is set to lose no marker. Returns the number of messages played. Raises BagError if the
    node or the recorder does not start.
    """
    settings = load_settings(config)
    markers = _absolute(settings.marker_topic)
    node_words = ['node', '--ros-args', '--params-file', str(config)]
    prefix = f'qos_overrides.{markers}.subscription'
    node_words += ['-p', f'{prefix}.reliability:=reliable', '-p', f'{prefix}.depth:=1000']
    record_words = ['record', '--topic', '/kinpole/', '--topic', '/diagnostics', '--topic', markers]
    context = own_context()
    executor = SingleThreadedExecutor(context=context)
    watcher = rclpy.create_node('kinpole_demo', context=context)
    executor.add_node(watcher)
    times: list[float] = []  # of results
    topic = f'/kinpole/{next(iter(settings.bodies))}/odom'
    watcher.create_subscription(Odometry, topic, lambda _: times.append(time.monotonic()), 1)
    try:
        with (
            _process(node_words) as node,
            _process([*record_words, '--output', str(recording)]) as recorder,
        ):
            _await(lambda: _all_recorded(watcher), node, recorder)
            count = play(bag, [markers], wait=_START_TIMEOUT, subscribers=2)
            times.append(time.monotonic())
            while time.monotonic() - times[-1] < _SILENCE:
                executor.spin_once(timeout_sec=_SILENCE)
            if node.poll() is not None or recorder.poll() is not None:
                raise BagError('the node or its recorder ended on the way; see what it printed')
            return count
    finally:
        watcher.destroy_node()
        context.try_shutdown()


def _absolute(topic: str) -> str:
    return topic if topic.startswith('/') else f'/{topic}'


def _all_recorded(watcher: Any) -> bool:
    """Return whether all topics of the node exist and have a subscriber."""
    names = [n for n, _ in watcher.get_topic_names_and_types() if n.startswith('/kinpole/')]
    if not any(name.endswith('/visualization') for name in names):
        return False
    return all(watcher.count_subscribers(n) for n in names if 'transition_event' not in n)


def _await(condition: Callable[[], bool], *processes: 'subprocess.Popen[bytes]') -> None:
    deadline = time.monotonic() + _START_TIMEOUT
    while not condition():
        ended = any(process.poll() is not None for process in processes)
        if ended or time.monotonic() > deadline:
            raise BagError(
                f'the node and its recorder did not come up within {_START_TIMEOUT:g} s; see what '
                'they printed, and whether ROS_DOMAIN_ID or a firewall blocks traffic between '
                'processes'
            )
        time.sleep(0.02)


@contextmanager
def _process(words: list[str]) -> 'Iterator[subprocess.Popen[bytes]]':
    """Run a `kinpole` command meanwhile, and interrupt it at the end."""
    process = subprocess.Popen([sys.executable, '-m', 'kinpole_ros.tools.cli', *words])
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class _Received(NamedTuple):
    """A message: its time of arrival (ns), its vector, and the standard deviation of its length."""

    log_time: int
    value: np.ndarray
    deviation: float


def _comparison_lines(bag: Path, recording: Path, settings: Settings) -> Iterator[str]:
    """Yield a table of the recording against the exact motion."""
    topics = [f'{body}/{name}' for body in settings.bodies for name in _UNITS]
    markers = _absolute(settings.marker_topic)
    truth = _received(bag, [f'/kinpole/truth/{topic}' for topic in topics])
    ends = ('', '/deviation', '/with_covariance')
    names = [f'/kinpole/{topic}{end}' for topic in topics for end in ends]
    received = _received(recording, [markers, *names])
    frames = received.get(markers, {})
    head = ('body', 'quantity', 'instants', 'median error', 'deviation', 'error/dev')
    yield _TABLE.format(*head, 'latency, ms', '')
    for body in settings.bodies:
        for name, unit in _UNITS.items():
            topic = f'/kinpole/{body}/{name}'
            exact = truth.get(f'/kinpole/truth/{body}/{name}', {})
            results = received.get(topic, {})
            spread = received.get(f'{topic}/deviation') or received.get(
                f'{topic}/with_covariance', {}
            )
            stamps = [stamp for stamp in results if stamp in exact and stamp in spread]
            if not stamps:
                outcome = 'undetermined' if exact else 'undetermined, as it should be'
                yield f'{body:9} {name:21} {len(results):8} {outcome}'
                continue
            error = np.array([np.linalg.norm(results[s].value - exact[s].value) for s in stamps])
            deviation = np.array([spread[s].deviation for s in stamps])
            yield _TABLE.format(
                body,
                name,
                len(results),
                f'{np.median(error):.3g}',
                f'{np.median(deviation):.3g}',
                f'{np.sqrt(np.mean((error / deviation) ** 2)):.2f}',
                f'{np.median(_latencies(results, frames, settings.lag)) * 1e-6:.1f}',
                unit,
            )


def _latencies(
    results: dict[int, _Received], frames: dict[int, _Received], lag: float
) -> list[int]:
    """Return the times, ns, from the frames that are `lag` (s) newer to their results."""
    stamps = np.array(sorted(frames), np.int64)
    awaited = np.array(list(results)) + round(lag * 1e9)
    newest = stamps[np.minimum(stamps.searchsorted(awaited - 1000), len(stamps) - 1)].tolist()
    return [
        result.log_time - frames[stamp].log_time
        for result, stamp in zip(results.values(), newest, strict=True)
    ]


def _received(bag: Path, topics: list[str]) -> dict[str, dict[int, _Received]]:
    """Return the messages by topic and stamp; of markers only their times."""
    received: dict[str, dict[int, _Received]] = {}
    for message in read_messages(bag, topics):
        decoded = decode(message.type_name, message.data)
        value, deviation = np.empty(0), float('nan')
        if hasattr(decoded, 'markers'):
            stamp = stamp_to_ns(decoded.markers[0].header.stamp)
        else:
            stamp = stamp_to_ns(decoded.header.stamp)
            row = np.array(row_of(message.type_name, message.data))
            value, covariance = row[:3], row[3:]
            deviation = float(np.linalg.norm(value))
            if len(covariance):
                deviation = float(np.sqrt(np.trace(covariance.reshape(6, 6)[:2, :2])))
        received.setdefault(message.topic, {})[stamp] = _Received(
            message.log_time, value, deviation
        )
    return received
