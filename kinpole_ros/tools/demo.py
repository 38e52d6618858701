"""
The main job, shown on any machine: a real node, a bag played into it over DDS, a recording.

Every process is its own, as on a rig: node, recorder, and the player in this one. What is recorded
is then compared with the exact answer that the bag carries.
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
from rclpy.serialization import deserialize_message

from kinpole_ros.bags import BagError, message_class, read_messages
from kinpole_ros.mechanism import share_folder
from kinpole_ros.ros.player import own_context, play
from kinpole_ros.tracking.estimate import POLE_NAMES
from kinpole_ros.tracking.parameters import Settings, load_settings

_START = 20.0  # s that node and recorder have to come up
_STOP = 10.0  # s that they have to end
# No result for so long after the last marker: all have come, to a recorder too that lost some on
# its way while its cores were busy, for Fast DDS sends those again every 3 s.
_QUIET = 3.5


def demo(output: str | Path) -> int:
    """Run the demo, writing into the folder `output`; returns the exit status."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    share = share_folder()
    bag, config = share / 'bags' / 'four_bar.mcap', share / 'config' / 'four_bar.yaml'
    if not bag.exists():
        raise BagError(f'{bag} is missing; make it with make bags')
    recording, picture = folder / 'demo.mcap', folder / 'demo.png'
    # Nobody else's nodes in our demo, and ours in nobody else's network.
    os.environ.setdefault('ROS_DOMAIN_ID', str(100 + os.getpid() % 100))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

    # As a shell tells it; at once, SIGTERM would leave node and recorder running.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    recording.unlink(missing_ok=True)
    print(f'node:     kinpole node --ros-args --params-file {config}')
    print(f'recorder: kinpole record --output {recording}')
    print(f'player:   kinpole play {bag}')
    count = live_run(bag, config, recording)
    print(f'{count} frames of markers played over DDS; what the node said is in {recording}\n')
    print('latency: from a frame to its results, as the recorder received both')
    for line in _comparison(bag, recording, load_settings(config)):
        print(line)

    from kinpole_ros.tools.plot import plot

    plot(recording, picture, truth=bag)
    print(f'\nthe picture: {picture}')
    return 0


def live_run(bag: Path, config: Path, recording: Path) -> int:
    """
    Play the markers of `bag` into a node of its own; record them, and everything it publishes.

    The node is set to lose no marker. Returns the number of messages played.
    Raises BagError when the node or the recorder does not come up.
    """
    settings = load_settings(config)
    topic = settings.marker_topic
    name = topic if topic.startswith('/') else f'/{topic}'
    node_words = ['node', '--ros-args', '--params-file', str(config)]
    prefix = f'qos_overrides.{name}.subscription'
    node_words += ['-p', f'{prefix}.reliability:=reliable', '-p', f'{prefix}.depth:=1000']
    record = ['record', '--topic', '/kinpole/', '--topic', '/diagnostics', '--topic', name]
    context = own_context()
    executor = SingleThreadedExecutor(context=context)
    watcher = rclpy.create_node('kinpole_demo', context=context)
    executor.add_node(watcher)
    heard: list[float] = []
    first = f'/kinpole/{next(iter(settings.bodies))}/odom'
    watcher.create_subscription(Odometry, first, lambda _: heard.append(time.monotonic()), 1)
    try:
        with (
            _process(node_words) as node,
            _process([*record, '--output', str(recording)]) as recorder,
        ):
            # Play only when every topic of the node is being recorded.
            _await(lambda: _all_recorded(watcher), node, recorder)
            # Node and recorder hear the markers.
            count = play(bag, [name], wait=_START, subscribers=2)
            _await_quiet(executor, heard)
            if node.poll() is not None or recorder.poll() is not None:
                raise BagError('the node or its recorder ended on the way; see what it printed')
            return count
    finally:
        watcher.destroy_node()
        context.try_shutdown()


def _all_recorded(watcher: Any) -> bool:
    names = [n for n, _ in watcher.get_topic_names_and_types() if n.startswith('/kinpole/')]
    results = [n for n in names if n.endswith(('/odom', '/visualization', '/icr'))]
    if not any(n.endswith('/visualization') for n in results):
        return False
    return all(watcher.count_subscribers(n) for n in names if 'transition_event' not in n)


def _await(condition: Callable[[], bool], *processes: 'subprocess.Popen[bytes]') -> None:
    deadline = time.monotonic() + _START
    while not condition():
        ended = any(process.poll() is not None for process in processes)
        if ended or time.monotonic() > deadline:
            raise BagError(
                f'the node and its recorder did not come up within {_START:g} s; see what they '
                'printed, and whether ROS_DOMAIN_ID or a firewall blocks traffic between processes'
            )
        time.sleep(0.02)


def _await_quiet(executor: SingleThreadedExecutor, heard: list[float]) -> None:
    """Until the node has said nothing for a while."""
    heard.append(time.monotonic())
    while time.monotonic() - heard[-1] < _QUIET:
        executor.spin_once(timeout_sec=_QUIET)


@contextmanager
def _process(words: list[str]) -> 'Iterator[subprocess.Popen[bytes]]':
    """A `kinpole` command that runs along with us, and is asked to stop at the end."""
    process = subprocess.Popen([sys.executable, '-m', 'kinpole_ros.tools.cli', *words])
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_STOP)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


_TABLE = '{:9} {:21} {:>8} {:>13} {:>10} {:>9} {:>12}  {}'


def _comparison(bag: Path, recording: Path, settings: Settings) -> Iterator[str]:
    """A table of what was measured against the exact answer, line by line."""
    wanted = ['angular_velocity', 'angular_acceleration', *POLE_NAMES[:3], 'centrode_curvature']
    units = ['rad/s', 'rad/s^2', 'm', 'm', 'm', '1/m']
    bodies = settings.bodies
    truth = _heard(bag, [f'/kinpole/truth/{b}/{q}' for b in bodies for q in wanted])
    topics = [f'/kinpole/{b}/{q}' for b in bodies for q in wanted]
    spreads = [f'{topic}/{part}' for topic in topics for part in ('deviation', 'with_covariance')]
    marker_topic = settings.marker_topic
    name = marker_topic if marker_topic.startswith('/') else f'/{marker_topic}'
    found = _heard(recording, [name, *topics, *spreads])
    sent = found.get(name, {})
    stamps = np.array(sorted(sent), np.int64)
    yield _TABLE.format(
        'body', 'quantity', 'instants', 'median error', 'deviation', 'error/dev', 'latency, ms', ''
    )
    for body in bodies:
        for quantity, unit in zip(wanted, units, strict=True):
            exact = truth.get(f'/kinpole/truth/{body}/{quantity}', {})
            topic = f'/kinpole/{body}/{quantity}'
            measured = found.get(topic, {})
            stated = found.get(f'{topic}/deviation') or found.get(f'{topic}/with_covariance', {})
            both = [stamp for stamp in measured if stamp in exact and stamp in stated]
            if not both:
                outcome = 'undetermined, as it should be' if not exact else 'undetermined'
                yield f'{body:9} {quantity:21} {len(measured):8} {outcome}'
                continue
            error = np.array([np.linalg.norm(measured[s].value - exact[s].value) for s in both])
            deviation = np.array([stated[s].deviation for s in both])
            # The frame that a result waited for is that which is `lag` newer.
            awaited = np.array(list(measured)) + round(settings.lag * 1e9)
            newest = stamps[np.minimum(stamps.searchsorted(awaited - 1000), len(stamps) - 1)]
            waits = [
                one.log_time - sent[int(s)].log_time
                for one, s in zip(measured.values(), newest, strict=True)
            ]
            yield _TABLE.format(
                body,
                quantity,
                len(measured),
                f'{np.median(error):.3g}',
                f'{np.median(deviation):.3g}',
                f'{np.sqrt(np.mean((error / deviation) ** 2)):.2f}',
                f'{np.median(waits) * 1e-6:.1f}',
                unit,
            )


class _Heard(NamedTuple):
    """A message: when it came (ns), its vector, and one standard deviation of its length."""

    log_time: int
    value: np.ndarray
    deviation: float


def _heard(bag: Path, topics: list[str]) -> dict[str, dict[int, _Heard]]:
    """What came on some topics, by stamp; of markers only when."""
    found: dict[str, dict[int, _Heard]] = {}
    for message in read_messages(bag, topics):
        decoded: Any = deserialize_message(message.data, message_class(message.type_name))
        first = decoded.markers[0] if hasattr(decoded, 'markers') else decoded
        value, deviation = np.empty(0), float('nan')
        if hasattr(decoded, 'pose'):
            deviation = float(
                np.sqrt(np.trace(np.reshape(decoded.pose.covariance, (6, 6))[:2, :2]))
            )
        elif first is decoded:
            vector = decoded.vector if hasattr(decoded, 'vector') else decoded.point
            value = np.array([vector.x, vector.y, vector.z])
            deviation = float(np.linalg.norm(value))
        stamp = first.header.stamp.sec * 1_000_000_000 + first.header.stamp.nanosec
        found.setdefault(message.topic, {})[stamp] = _Heard(message.log_time, value, deviation)
    return found
