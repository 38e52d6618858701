"""Frames that wait for the node: each is answered, in order, and a node that is behind says so."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from conftest import sent, stamp_of, write_config
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from test_faults import LAG, STEP, Rig, message, rod
from test_node import LIMIT, TOO_SLOW, process, warnings_of

from kinpole_ros.messages import MARKER_TYPES, MessageError, serialize_message
from kinpole_ros.ros import source as source_module
from kinpole_ros.ros.node import KinpoleNode
from kinpole_ros.settings import Settings

SETTINGS = Settings(bodies={'rod': ('0', '1', '2', '3')}, marker_identity='index')
OMEGA = 'rod/angular_velocity'
SLOW = """
import sys, time
from kinpole_ros.ros.node import main
from kinpole_ros.tracking.tracker import Tracker
add = Tracker.add
def slow(self, frames, *rest):
    if int(frames.stamps[0]) % 1000 == 7:
        time.sleep(0.012 * len(frames.stamps))
    return add(self, frames, *rest)
Tracker.add = slow
sys.exit(main(['kinpole', *sys.argv[1:]]))
"""


def child_of(process: 'subprocess.Popen[bytes]') -> int:
    """The command that `timeout` runs."""
    return int(Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split()[0])


def answered_stamps(rig: Rig, since: int) -> list[int]:
    """Stamps of the results of instants after this one, as they came."""
    stamps = map(stamp_of, rig.heard(f'/{rig.name}/{OMEGA}'))
    return [stamp for stamp in stamps if stamp > since]


@pytest.mark.parametrize('executor', ['lean', 'rclpy'])
def test_every_frame_sent_while_the_node_is_stopped_is_answered_in_order(
    tmp_path: Path, executor: str
) -> None:
    # With best effort Fast DDS loses all that is sent during one stop in fifty.
    reliable = {'qos_overrides./stalled.subscription.reliability': 'reliable'}
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index', **reliable)
    rig = Rig('stalled', '/stalled')
    try:
        with process(*rig.words(config, executor=executor), log=tmp_path / 'stderr') as node:
            rig.listen()
            with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
                rig.begin(publisher)
                rig.good(publisher, 20)
                start, child = rig.stamp, child_of(node)
                frames = [message(start + k * STEP, rod(rig.frame + k)) for k in range(1, 151)]
                os.kill(child, signal.SIGSTOP)
                for frame in frames:
                    publisher.publish(sent(frame))
                os.kill(child, signal.SIGCONT)
                rig.until(lambda: rig.newest() >= start + 150 * STEP - LAG, 'the last result')
                expected = [start - LAG + k * STEP for k in range(1, 151)]
                assert answered_stamps(rig, start - LAG) == expected
    finally:
        rig.close()


def test_a_node_slower_than_the_stream_says_so_and_catches_up_with_all_frames(
    tmp_path: Path,
) -> None:
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    rig = Rig('slow', '/slow')
    words = ['timeout', '--foreground', '-k', '2', '60', sys.executable, '-c', SLOW]
    log = tmp_path / 'stderr'
    with (
        open(log, 'wb') as err,
        subprocess.Popen([*words, *rig.words(config)[1:]], stderr=err) as node,
    ):
        try:
            rig.listen()
            with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
                rig.begin(publisher)
                rig.good(publisher, 20)
                start = rig.stamp
                # From now on a frame takes three times as long as until the next one.
                rig.stamp += 7
                rig.diagnosed(
                    lambda: rig.send_next(publisher),
                    DiagnosticStatus.WARN,
                    TOO_SLOW,
                    None,
                )
                last = rig.stamp
                rig.until(lambda: rig.newest() >= last - LAG, 'results of all frames')
                count = (last - start) // STEP
                stamps = answered_stamps(rig, start - LAG)
                assert stamps == sorted(stamps)
                assert len(stamps) == count
                rig.stamp = start + (count + 1) * STEP
                rig.diagnosed(
                    lambda: rig.send_next(publisher),
                    DiagnosticStatus.OK,
                    'receiving markers',
                    None,
                )
        finally:
            node.send_signal(signal.SIGINT)
            assert node.wait(LIMIT) == 0
            rig.close()
    (told,) = warnings_of(log)
    assert TOO_SLOW in told


@pytest.mark.parametrize('given', [None, 7])
def test_the_bytes_that_wait_are_bounded_and_the_depth_can_be_overridden(
    monkeypatch: pytest.MonkeyPatch, given: int | None
) -> None:
    """A depth is a count, so it follows the size of the largest message."""
    sent = serialize_message(message(1, rod(1)))
    monkeypatch.setattr(source_module, 'MAX_WAITING_BYTES', 100 * len(sent))
    words = ['-p', 'marker_type:=marker_array']
    if given is not None:
        words += ['-p', f'qos_overrides./markers.subscription.depth:={given}']
    rclpy.init(args=['kinpole', '--ros-args', *words])
    node = KinpoleNode()
    try:
        depth = lambda: node.source.subscriptions[0].qos_profile.depth  # noqa: E731
        assert depth() == (given or source_module.SUBSCRIPTION_DEPTH)
        node.source.take(sent, {})
        for _ in range(2):
            node.source.update()
            assert depth() == given if given else 50 <= depth() <= 100
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.parametrize('is_behind', [True, False])
def test_what_has_waited_for_seconds_is_dropped_in_one_gap_if_the_node_is_behind(
    monkeypatch: pytest.MonkeyPatch, is_behind: bool
) -> None:
    """Many gaps would make many kinds of windows. After a stall of any length nothing is lost."""
    now = 10**18
    clock = SimpleNamespace(
        monotonic=time.monotonic, process_time=time.process_time, time_ns=lambda: now
    )
    monkeypatch.setattr(source_module, 'time', clock)
    rclpy.init(args=['kinpole', '--ros-args', '-p', 'marker_type:=marker_array'])
    node = KinpoleNode()
    # All but one wait for less than 5 s; after it, those are left out that are late at all.
    ages = (4.0, 6.0, 4.0, 1.0, 0.01, 1.0)
    waiting = [
        (serialize_message(message(k, rod(k))), {'received_timestamp': now - round(age * 1e9)})
        for k, age in enumerate(ages)
    ]
    monkeypatch.setattr(source_module, 'take', lambda *_: iter(waiting[1:]))
    node.source._behind_since = (time.monotonic() - 1.0, 0.0) if is_behind else None
    try:
        results, lost = node.source.take(*waiting[0])
        frames = [result for result in results if not isinstance(result, MessageError)]
        stamps = [int(stamp) for part in frames for stamp in part.stamps]
        assert stamps == ([0, 4, 5] if is_behind else [0, 1, 2, 3, 4, 5])
        assert lost == (3 if is_behind else 0)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_publishers_are_looked_for_once_a_second_or_when_another_one_seems_to_send(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    offer = SimpleNamespace(
        endpoint_gid=b'1',
        topic_type='visualization_msgs/msg/MarkerArray',
        qos_profile=QoSProfile(depth=1),
    )
    asked, now = [], 100.0
    clock = SimpleNamespace(monotonic=lambda: now, time_ns=time.time_ns)
    monkeypatch.setattr(source_module, 'time', clock)
    rclpy.init(args=['kinpole'])
    node = KinpoleNode()
    look = lambda topic: asked.append(now) or [offer]  # noqa: E731
    monkeypatch.setattr(node, 'get_publishers_info_by_topic', look)
    try:
        # It finds the publisher, and then knows it.
        for _ in range(21):
            node._discover()
            now += 0.1
        assert len(asked) <= 4
        for number in (5, 6):
            node.source.take(b'', {'publication_sequence_number': number})
        asked.clear()
        node._discover()
        assert asked == []
        node.source.take(b'', {'publication_sequence_number': 1})
        node._discover()
        assert len(asked) == 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
