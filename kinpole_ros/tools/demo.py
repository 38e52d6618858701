"""
`kinpole demo`: a node, a bag that is played into it over DDS, and a recording of its results.

Node, recorder and player are processes of their own, as on a rig. The recording is compared with
the exact motion in the bag.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from kinpole_ros.bags import BagError, read_messages
from kinpole_ros.bags import topics as topics_of
from kinpole_ros.mechanism import share_folder
from kinpole_ros.messages import (
    DRAWING,
    RIG,
    STATE,
    installed_class,
    outputs_of,
    read_state,
    stamp_to_ns,
)
from kinpole_ros.ros.player import headers, own_context, play, with_slash
from kinpole_ros.ros.private import take
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.plot import plot
from kinpole_ros.tools.record.result_bag import decode, read_record, read_truth
from kinpole_ros.tracking.values import POLE_NAMES

# s. Processes that live are waited for, with a line now and then: a busy machine needs minutes.
_PATIENCE, _STOP_TIMEOUT, _NEXT_LINE, _POLL_INTERVAL = 1800.0, 60.0, 5.0, 0.02
# Seconds without a result after which all have arrived: if the last one that is due is among them,
# and if not. Fast DDS resends lost messages every 3 s.
_SILENCE, _LONG_SILENCE = 3.5, 60.0
# s; the node may find a subscriber so much later than the watcher does.
_SETTLING = 1.0
_MANY = 10_000  # messages, more than a demo has
# s; a node and a recorder on an idle machine need a few milliseconds.
_LONG = 0.1
_UNITS = {
    'angular_velocity': 'rad/s',
    'angular_acceleration': 'rad/s^2',
    **dict.fromkeys(POLE_NAMES[:3], 'm'),
    'centrode_curvature': '1/m',
}
_TABLE = '{:9} {:21} {:>10} {:>12} {:>6} {:>13} {:>10} {:>9}  {}'


class LiveRun(NamedTuple):
    """Frames of markers that were played, and by stamp, ns, when markers and states were sent."""

    frames: int
    sent: dict[int, int]
    results: dict[int, int]


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

    recording.unlink(missing_ok=True)
    print(f'node:     kinpole node --ros-args --params-file {config}')
    print(f'recorder: kinpole record --output {recording}')
    print(f'player:   kinpole play {bag}', flush=True)
    settings = load_settings(config)
    run = live_run(bag, config, recording, _shown_topics(settings))
    print(f'{run.frames} frames of markers played over DDS; the results are in {recording}\n')
    for line in (*_comparison_lines(bag, recording), '', *_latency_lines(run, recording, settings)):
        print(line)
    print(f'\ndrawing {picture} ...', flush=True)
    plot(recording, picture, truth=bag)
    print(f'the picture: {picture}')
    return 0


def _shown_topics(settings: Settings) -> list[str]:
    """Return the topics of table and picture: the state has almost all numbers."""
    names = re.compile(rf'{RIG}|{STATE}|{DRAWING}|\w+/(odom|event|wrt/\w+/icr)')
    topics = [RIG, *(output.topic for output in outputs_of(settings, None))]
    return [f'/kinpole/{topic}' for topic in topics if names.fullmatch(topic)]


def live_run(
    bag: Path, config: Path, recording: Path, topics: Sequence[str] = ('/kinpole/',)
) -> LiveRun:
    """
    Play the markers of `bag` into a node; record them, and its topics that begin with `topics`.

    The node is set to lose no marker. Raises BagError if node or recorder end on the way.
    """
    settings = load_settings(config)
    markers = with_slash(settings.marker_topic)
    node_words = ['node', '--ros-args', '--params-file', str(config)]
    prefix = f'qos_overrides.{markers}.subscription'
    node_words += ['-p', f'{prefix}.reliability:=reliable', '-p', f'{prefix}.depth:=1000']
    record_words = ['record', '--output', str(recording)]
    for topic in (*topics, '/diagnostics', markers):
        record_words += ['--topic', topic]
    context = own_context()
    watcher = rclpy.create_node('kinpole_demo', context=context)
    types = {markers: topics_of(bag)[markers], f'/kinpole/{STATE}': 'sensor_msgs/msg/PointCloud2'}
    watched = [
        watcher.create_subscription(
            installed_class(kind), topic, print, QoSProfile(depth=_MANY), raw=True
        )
        for topic, kind in types.items()
    ]
    try:
        with _process(node_words) as node, _process(record_words) as recorder:
            _await(lambda: _missing(watcher, tuple(topics)), node, recorder, lasting=_SETTLING)
            count = play(bag, [markers], wait=_PATIENCE, subscribers=3)
            sent = {
                stamp_to_ns(next(headers(decode(types[markers], data))).stamp): time_sent
                for data, time_sent in _taken(watched[0])
            }
            results: dict[int, int] = {}
            _await(lambda: _still_due(watched[1], results, sent, settings.lag), node, recorder)
            return LiveRun(count, sent, results)
    finally:
        watcher.destroy_node()
        context.try_shutdown()


def _missing(watcher: Any, prefixes: tuple[str, ...]) -> str:
    """Return what keeps the run from starting; '' for nothing."""
    names = [n for n, _ in watcher.get_topic_names_and_types() if n.startswith('/kinpole/')]
    # The state has a subscriber already, which is the watcher.
    if not any(name.endswith(f'/{DRAWING}') for name in names):
        return 'the node to announce its topics'
    recorded = [n for n in names if n.startswith(prefixes) and 'transition_event' not in n]
    left = [n for n in recorded if watcher.count_subscribers(n) < 1 + n.endswith(f'/{STATE}')]
    return f'the recorder to subscribe to {len(left)} of {len(recorded)} topics' if left else ''


def _taken(subscription: Subscription) -> Iterator[tuple[bytes, int]]:
    """Yield the messages that wait, and when they were sent, ns since 1970."""
    for data, info in take(subscription, _MANY):
        yield data, info['source_timestamp']


def _still_due(
    subscription: Subscription, results: dict[int, int], sent: dict[int, int], lag: float
) -> str:
    """Add the results that have come to those before; return what is still missing."""
    for data, time_sent in _taken(subscription):
        results[read_state(data)[0]] = time_sent
    silence = time.time() - 1e-9 * max([*sent.values(), *results.values()], default=0)
    # The stamps of results are not those of frames where the clock of these is corrected.
    last = max(sent, default=0) * 1e-9 - lag - 0.1 - max(results, default=0) * 1e-9
    if last > 0 and silence < _LONG_SILENCE:
        return f'the results of the last of {len(sent)} frames, of which {len(results)} have some'
    return '' if silence > _SILENCE else 'results that may come late'


def _await(
    missing: Callable[[], str], *processes: 'subprocess.Popen[bytes]', lasting: float = 0.0
) -> None:
    """Wait until nothing is missing for `lasting` s, while the processes live; say what for."""
    start = found = time.monotonic()
    line_due = start + _NEXT_LINE
    while (what := missing()) or time.monotonic() - found < lasting:
        now = time.monotonic()
        if what:
            found = now
        else:
            what = 'the others to find each other too'
        if any(process.poll() is not None for process in processes):
            raise BagError('the node or its recorder ended on the way; see what it printed')
        hint = 'see whether ROS_DOMAIN_ID or a firewall blocks traffic between processes'
        if now > start + _PATIENCE:
            raise BagError(f'waited {_PATIENCE:g} s in vain for {what}; {hint}')
        if now > line_due:
            line_due = now + _NEXT_LINE
            print(f'waiting for {what}: {now - start:.0f} s; {_load()}', flush=True)
        time.sleep(_POLL_INTERVAL)


def _load() -> str:
    return f'load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors'


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


def _comparison_lines(bag: Path, recording: Path) -> Iterator[str]:
    """Yield a table of the recording against the exact motion."""
    record = read_record(recording)
    truth = read_truth(bag, record)
    head = ('determined', 'undetermined', 'lost', 'median error', 'deviation', 'error/dev')
    yield _TABLE.format('body', 'quantity', *head, '').rstrip()
    for body in record.bodies:
        for name, unit in _UNITS.items():
            found, exact = record.series(body, name), truth[body].get(name)
            assert found is not None
            counts = len(found.stamp), len(record.stamp) - len(found.stamp), record.lost
            if exact is None or not len(found.stamp):
                outcome = 'as it should be' if exact is None and not len(found.stamp) else ''
                yield _TABLE.format(body, name, *counts, '', '', '', outcome).rstrip()
                continue
            _, own, its = np.intersect1d(found.stamp, exact.stamp, return_indices=True)
            error, spread = np.abs(found.value[own] - exact.value[its]), found.spread[own]
            if spread.ndim > 1:
                spread = np.sqrt(np.trace(spread, axis1=1, axis2=2))
            yield _TABLE.format(
                body,
                name,
                *counts,
                f'{np.median(error):.3g}',
                f'{np.median(spread):.3g}',
                f'{np.sqrt(np.mean((error / spread) ** 2)):.2f}',
                unit,
            )


def _latency_lines(run: LiveRun, recording: Path, settings: Settings) -> Iterator[str]:
    """Yield the latencies of node and recorder, with a remark if they are long."""
    stamps = np.array(sorted(run.sent), np.int64)
    lag = round(settings.lag * 1e9)
    # A result is due when the frame that is `lag` newer has been sent.
    newest = {
        stamp: int(stamps[stamps.searchsorted(stamp + lag - 1000) - len(stamps)])
        for stamp in run.results
    }
    node = [run.results[stamp] - run.sent[newest[stamp]] for stamp in run.results]
    recorder = [
        message.log_time - run.results[stamp]
        for message in read_messages(recording, [f'/kinpole/{STATE}'])
        if (stamp := read_state(message.data)[0]) in run.results
    ]
    what = {'node': 'from a frame to its results', 'recorder': 'from results to their recording'}
    for name, latencies in (('node', node), ('recorder', recorder)):
        if not latencies:
            continue
        median, late = np.percentile(latencies, [50, 99]) * 1e-6
        yield f'latency of the {name}, {what[name]}: {median:.1f} ms, 99% within {late:.1f} ms'
        if late > 1e3 * _LONG:
            yield f'  which is long: on an idle machine it is a few ms, and here {_load()}'
