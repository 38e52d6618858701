"""
What knocks nodes over on real rigs, done to the real node in its own process over real DDS.

After each fault: the node still runs, no number it sent is anything but finite, it is right again
within one window, and its diagnostics named the fault.
"""

import itertools
import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path as FilePath
from typing import Any, cast

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from conftest import numbers, ros_class, sent, stamp_of, write_config
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Path
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from test_node import LIMIT, RELIABLE, Peer, complaints, node_words, process
from visualization_msgs.msg import MarkerArray

import kinpole_ros.ros.node as node_module
from kinpole_ros.messages import MARKER_TYPES, TF, outputs_of, serialize_message, to_message
from kinpole_ros.ros.source import MAX_MESSAGE_BYTES
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE
SETTINGS = Settings(bodies={'rod': ('0', '1', '2', '3')}, marker_identity='index')
WINDOW, LAG = round(SETTINGS.window * 1e9), round(SETTINGS.lag * 1e9)
STEP = 5_000_000
PACE = 0.004
TURN = 2 * np.pi
PIVOT = 0.3 - 0.2j
ARMS = np.array([0.10 + 0.02j, 0.25 - 0.03j, 0.18 + 0.08j, 0.05 - 0.06j])
_noise = np.random.default_rng(3)


def rod(k: float, arms: np.ndarray = ARMS) -> np.ndarray:
    """Markers (4, 3) of a rod that turns evenly about PIVOT, in its frame k."""
    flat = PIVOT + arms * np.exp(1j * TURN * k * STEP * 1e-9)
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points[:, :2] += 1e-4 * _noise.normal(size=(4, 2))
    return points


def message(stamp: int, points: np.ndarray, kind: str = 'marker_array') -> Any:
    return to_message(kind, stamp, 'world', 'abcd', points)


CHECKED: dict[str, tuple[Callable[[Any], complex], complex, float]] = {
    'angular_velocity': (lambda m: m.vector.z, TURN, 0.02 * TURN),
    'icr': (lambda m: m.point.x + 1j * m.point.y, PIVOT, 0.003),
}


class Rig(Peer):
    """
    A tracker that can do wrong, and ears for all the node says.

    A node that runs beside that of the other tests here has a name and a topic of its own, lest one
    be taken for the other.
    """

    def __init__(self, name: str = 'kinpole', topic: str = '/markers') -> None:
        super().__init__()
        self.name, self.topic = name, topic
        self.frame = 0.0
        self.stamp = 1_000_000_000_000
        self._next, self.pace = 0.0, PACE
        self._ears: dict[str, Any] = {}
        self._heard_so_far: dict[str, list[Any]] = {}

    def words(self, config: FilePath, **parameters: Any) -> list[str]:
        """What starts the node."""
        words = node_words(config, marker_topic=self.topic, **parameters)
        return [*words, '-r', f'__node:={self.name}']

    def listen(self) -> None:
        """
        Hear all results.

        No executor has to wait for them: the middleware keeps them until they are looked at.
        """
        ears = rclpy.create_node('ears', context=self.node.context)
        outputs = outputs_of(SETTINGS, None)
        # /tf is published if it is asked for.
        topics = {o.under(f'/{self.name}'): o.message_type for o in outputs if o.topic != TF}
        for topic, kind in {**topics, '/diagnostics': DiagnosticArray}.items():
            qos = QoSProfile(depth=2000)
            cls = ros_class(kind)
            self._ears[topic] = ears.create_subscription(cls, topic, lambda _: None, qos)
            self._heard_so_far[topic] = []
        heard = lambda: all(self.node.count_publishers(topic) for topic in self._ears)  # noqa: E731
        self.until(heard, 'all publishers')

    def heard(self, topic: str) -> list[Any]:
        """All messages of a topic since the last time that what was heard was forgotten."""
        ear, listed = self._ears[topic], self._heard_so_far[topic]
        with ear.handle:
            while (taken := ear.handle.take_message(ear.msg_type, False)) is not None:
                listed.append(taken[0])
        return listed

    def forget_heard(self, *topics: str) -> None:
        for topic in topics or self._ears:
            self.heard(topic).clear()

    def until(self, condition: Callable[[], Any], what: str) -> None:
        deadline = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < deadline, f'{what}: not within {LIMIT:g} s'
            self._executor.spin_once(timeout_sec=0.002)

    @contextmanager
    def publisher(self, message_type: type) -> Iterator[Any]:
        """A publisher that the node has found, gone whatever happens meanwhile."""
        cls = ros_class(message_type)
        made = self.node.create_publisher(cls, self.topic, QoSProfile(depth=1000))
        try:
            self.until(made.get_subscription_count, f'the node on {self.topic}')
            yield made
        finally:
            self.node.destroy_publisher(made)

    def send(self, publisher: Any, message: Any) -> None:
        """Publish at the pace of a tracker."""
        publisher.publish(sent(message))
        self._next = max(self._next + self.pace, time.monotonic())
        self._executor.spin_once(timeout_sec=max(0, self._next - time.monotonic()))

    def good(
        self, publisher: Any, count: int, kind: str = 'marker_array', step: int = STEP
    ) -> None:
        """Frames as they should be, until their results are there."""
        for _ in range(count):
            self.send_next(publisher, kind, step)
        self.until(lambda: self.newest() >= self.stamp - LAG - step, 'the results')

    def begin(self, publisher: Any, kind: str = 'marker_array') -> None:
        """Good frames until results come; the node may yet begin anew, with this publisher."""
        enough = self.stamp + WINDOW // 2

        def send_and_look() -> bool:
            self.send_next(publisher, kind)
            return self.newest() >= enough

        self.until(send_and_look, 'the first results')

    def send_next(self, publisher: Any, kind: str = 'marker_array', step: int = STEP) -> None:
        self.frame += step / STEP
        self.stamp += step
        self.send(publisher, message(self.stamp, rod(self.frame), kind))

    def newest(self) -> int:
        """The last instant that all the results are there of that are checked."""
        last = [self.heard(f'/{self.name}/rod/{topic}')[-1:] for topic in CHECKED]
        return min(stamp_of(found[0]) for found in last) if all(last) else 0

    def check_right(self, since: int) -> None:
        """All that holds for instants from `since` on is right, and there is enough of it."""
        for topic, (read, expected, tolerance) in CHECKED.items():
            found = [m for m in self.heard(f'/{self.name}/rod/{topic}') if stamp_of(m) >= since]
            assert len(found) >= 5, topic
            off = max(abs(read(m) - expected) for m in found)
            assert off < tolerance, f'{topic} {off} off'

    def check_finite(self) -> None:
        for topic, ear in self._ears.items():
            # A path holds again what the one before did.
            most = 2 if ear.msg_type in (Path, MarkerArray) else 0
            for heard in self.heard(topic)[-most:]:
                assert np.isfinite(list(numbers(heard))).all(), topic
        for told in self.heard('/diagnostics'):
            for pair in itertools.chain.from_iterable(s.values for s in told.status):
                assert pair.value.strip('-') not in ('nan', 'inf'), pair.key

    def named(self, level: bytes | None, words: str, counted: str | None, status: int = 0) -> bool:
        """Whether diagnostics were heard of this level, with these words and a count."""
        for told in (heard.status[status] for heard in self.heard('/diagnostics')):
            ours = told.name.startswith(f'{self.name}: ')
            if ours and words in told.message and level in (None, told.level):
                values = {pair.key: pair.value for pair in told.values}
                if counted is None or int(values[counted]) > 0:
                    return True
        return False

    def fault(
        self,
        publisher: Any,
        faulty: Callable[[int], Any],
        level: bytes | None,
        words: str,
        counted: str | None,
        kind: str = 'marker_array',
        status: int = 0,
    ) -> None:
        """Good frames, then faulty ones until diagnostics name the fault, then good ones again."""
        self.begin(publisher, kind)
        frames = itertools.count(1)
        act = lambda: self.send(publisher, faulty(next(frames)))  # noqa: E731
        self.diagnosed(act, level, words, counted, status)
        self.forget_heard()
        self.stamp += 1_000_000_000_000
        # The first good frame begins a new window.
        since = self.stamp + WINDOW - LAG
        self.good(publisher, 100, kind)
        self.go_on_right(publisher, since, kind)
        self.check_finite()

    def go_on_right(self, publisher: Any, since: int, kind: str = 'marker_array') -> None:
        """Good frames until there are enough results of `since` and after, which are right."""

        def send_and_count() -> bool:
            self.send_next(publisher, kind)
            heard = [self.heard(f'/{self.name}/rod/{topic}') for topic in CHECKED]
            return all(sum(stamp_of(m) >= since for m in found) >= 5 for found in heard)

        self.until(send_and_count, 'enough results')
        self.check_right(since)

    def diagnosed(
        self,
        act: Callable[[], None],
        level: bytes | None,
        words: str,
        counted: str | None,
        status: int = 0,
    ) -> None:
        """Do something until diagnostics tell of it."""
        self.forget_heard('/diagnostics')

        def act_and_look() -> bool:
            if self.named(level, words, counted, status):
                return True
            act()
            return False

        # They come once a second, however many frames do.
        self.pace = 2 * PACE
        try:
            self.until(act_and_look, f'diagnostics of level {level!r} that say: {words}')
        finally:
            self.pace = PACE
        self.check_finite()


@pytest.fixture(scope='module')
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    folder = tmp_path_factory.mktemp('faults')
    config = write_config(folder / 'rod.yaml', SETTINGS, marker_identity='index', **RELIABLE)
    made = Rig()
    with process(*node_words(config), log=folder / 'stderr', limit=600) as node:
        made.listen()
        yield made
        assert node.poll() is None
    assert 'Traceback' not in (folder / 'stderr').read_text()
    made.close()


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.forget_heard()
    return running


RESETS = 'starts anew after a jump of the stamps'
REPEATED = 'frames with the stamp of the one before, left out'
LATE = 'frames that came late, after newer ones, left out'
HOUR = 3600 * 10**9
# Stamps of faulty frames after the last good one, by how many frames ago that was.
WRONG_STAMPS: dict[str, tuple[Callable[[int], int], bytes, str, str | None]] = {
    'clock jumps back': (lambda k: k * STEP - k // 40 * HOUR, WARN, 'stamps jumped', RESETS),
    'a bag shorter than the window loops': (lambda k: k % 20 * STEP, WARN, 'stamps jumped', RESETS),
    'all stamps run backwards': (lambda k: -k * STEP, WARN, 'stamps jumped', RESETS),
    'frames overtake one another': (lambda k: (k ^ 1) * STEP, WARN, 'came late', LATE),
    'every message comes twice': (lambda k: k // 2 * STEP, WARN, 'stamps repeat', REPEATED),
    'all stamps are the same': (lambda k: 0, ERROR, 'the stamps stand still at', REPEATED),
    'ns taken for s': (lambda k: k * STEP * 10**9, ERROR, 'times as fast as the messages', None),
    'ms taken for ns': (lambda k: 5 * k, ERROR, 'times as fast as the messages', None),
}


@pytest.mark.parametrize('fault', WRONG_STAMPS)
def test_wrong_stamps(rig: Rig, fault: str) -> None:
    offset, *expected = WRONG_STAMPS[fault]

    def faulty(k: int) -> Any:
        # Frames of one stamp that differ are of two ticks, and come in pairs.
        frame = rig.frame + (k // 2 if 'twice' in fault else k)
        # As far as the 32 bits of s go round.
        return message((rig.stamp + offset(k)) % (2**31 * 10**9), rod(frame))

    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.fault(publisher, faulty, *expected)


def test_frames_too_seldom_for_the_window_are_told_of(rig: Rig) -> None:
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.begin(publisher)
        send = lambda: rig.send_next(publisher, step=WINDOW + STEP)  # noqa: E731
        words = 'if frames come so seldom, raise the parameter window, 0.3 s, to hold 7'
        rig.diagnosed(send, WARN, words, RESETS)
        # What was known before is not told as if it were known still.
        rig.diagnosed(send, STALE, 'nothing known: too few frames yet', None, status=1)


def test_frames_that_come_late_disturb_nothing(rig: Rig) -> None:
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.begin(publisher)
        rig.forget_heard()
        start, first, frame = rig.stamp, rig.stamp + STEP, rig.frame
        waiting: list[Any] = []

        def send() -> None:
            rig.frame += 1
            rig.stamp += STEP
            sent = message(rig.stamp, rod(rig.frame))
            if rig.frame % 10 == 0:
                waiting.append(sent)
                return
            rig.send(publisher, sent)
            if rig.frame % 10 == 4 and waiting:
                rig.send(publisher, waiting.pop())

        rig.diagnosed(send, WARN, 'came late', LATE)
        rig.good(publisher, 50)
        rig.check_right(start)
        # Nothing began anew: all but the late ones are answered, without a break.
        answered = {stamp_of(m) for m in rig.heard('/kinpole/rod/angular_velocity')}
        for k in range(round(rig.frame - frame) - LAG // STEP - 52):
            if (frame + 1 + k) % 10:
                assert first + k * STEP in answered
    rig.check_finite()


def test_another_frame_id_starts_anew_and_nothing_is_mixed(rig: Rig) -> None:
    """As where a driver's origin is set while it runs: the same rod is elsewhere in its frame."""
    shift = np.array([5.0, 0.0, 0.0])
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.begin(publisher)
        rig.forget_heard()

        def send() -> None:
            """A window and more in one frame, then in the other."""
            rig.frame += 1
            rig.stamp += STEP
            elsewhere = rig.frame // 150 % 2
            points = rod(rig.frame) + elsewhere * shift
            name = ('world', 'camera')[int(elsewhere)]
            rig.send(publisher, to_message('marker_array', rig.stamp, name, 'abcd', points))

        words = 'the markers have another frame_id'
        rig.diagnosed(send, WARN, words, 'starts anew with another frame_id')
        for _ in range(300):
            send()
        found = rig.heard('/kinpole/rod/icr')
        assert {m.header.frame_id for m in found} == {'world', 'camera'}
        for m in found:
            expected = PIVOT + 5.0 * (m.header.frame_id == 'camera')
            # The first ones after a start are of a few frames.
            assert abs(m.point.x + 1j * m.point.y - expected) < 0.1
        rig.forget_heard()
        start = rig.stamp
        rig.good(publisher, 100)
        rig.check_right(start + WINDOW)
    rig.check_finite()


def with_nothing_finite(k: int, points: np.ndarray) -> None:
    points[:] = (np.nan, np.inf, -np.inf)[k % 3]


def with_one_marker_gone(k: int, points: np.ndarray) -> None:
    points[k % 4] = np.nan


def with_absurd_numbers(k: int, points: np.ndarray) -> None:
    points[k % 4] = (1e300, -1e300, 1.7e308)


def with_a_marker_that_jumps(k: int, points: np.ndarray) -> None:
    points[2, :2] += (k % 10 == 0) * 0.7


LEFT_OUT = 'markers left out, since they did not fit their body'


@pytest.mark.parametrize(
    'spoil, status, level, words, counted',
    [
        (with_nothing_finite, 1, WARN, 'too few markers seen', None),
        (with_one_marker_gone, 0, OK, 'receiving markers', 'markers not seen, summed over frames'),
        (with_absurd_numbers, 0, OK, 'receiving markers', 'markers not seen, summed over frames'),
        (with_a_marker_that_jumps, 0, OK, 'receiving markers', LEFT_OUT),
    ],
)
def test_wrong_coordinates(
    rig: Rig,
    spoil: Callable[[int, np.ndarray], None],
    status: int,
    level: bytes,
    words: str,
    counted: str | None,
) -> None:
    def faulty(k: int) -> Any:
        points = rod(rig.frame + k)
        spoil(k, points)
        cloud = message(rig.stamp + k * STEP, np.zeros((4, 3)), 'point_cloud2')
        cloud.data[:] = array('B', points.tobytes())
        return cloud

    with rig.publisher(MARKER_TYPES['point_cloud2']) as publisher:
        rig.fault(publisher, faulty, level, words, counted, 'point_cloud2', status)


def test_changes_of_rate(rig: Rig) -> None:
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.begin(publisher)
        for rate in (200, 50, 500):
            rig.forget_heard()
            start = rig.stamp
            rig.good(publisher, round(0.6 * rate), step=10**9 // rate)
            rig.check_right(start + WINDOW)
    rig.check_finite()


@pytest.mark.parametrize('kind', ['pose_array', 'marker_array'])
def test_a_publisher_that_comes_back_with_other_markers_in_other_messages(
    rig: Rig, kind: str
) -> None:
    """The rod's markers sit elsewhere on it, and one more is in the message."""
    moved = 1.3 * ARMS * np.exp(0.4j)
    extra = np.array([[3.0, 3.0, 0.0]])
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.begin(publisher)
    rig.forget_heard()
    start = rig.stamp
    with rig.publisher(MARKER_TYPES[kind]) as publisher:
        for _ in range(100):
            rig.frame += 1
            rig.stamp += STEP
            points = np.concatenate((rod(rig.frame, moved), extra))
            rig.send(publisher, to_message(kind, rig.stamp, 'world', 'abcde', points))
        rig.until(lambda: rig.newest() >= rig.stamp - LAG - STEP, 'the results')
        rig.check_right(start + WINDOW)
        rig.diagnosed(
            lambda: None,
            STALE,
            'no markers received',
            'markers in the last new layout that no body names',
        )
    rig.check_finite()


def test_a_publisher_that_offers_less_than_the_node_asks_for(rig: Rig) -> None:
    kind = MARKER_TYPES['marker_array']
    qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    unreliable = rig.node.create_publisher(ros_class(kind), '/markers', qos)
    words = 'offers less QoS than this node asks for, and nothing is received from it (Best effort'
    unheard = lambda: rig.send_next(unreliable)  # noqa: E731
    try:
        rig.diagnosed(unheard, ERROR, words, None)
        # Another one that is heard changes nothing about it.
        with rig.publisher(kind) as publisher:
            rig.begin(publisher)
            rig.diagnosed(lambda: rig.send_next(publisher), WARN, words, None)
        rig.diagnosed(unheard, ERROR, words, None)
    finally:
        rig.node.destroy_publisher(unreliable)
    rig.diagnosed(lambda: None, STALE, 'no markers received', None)
    rig.forget_heard()
    rig.diagnosed(lambda: None, STALE, 'no markers received', None)
    assert not rig.named(None, words, None)


def test_publishers_that_take_turns_on_the_topic_are_named(rig: Rig) -> None:
    kind = MARKER_TYPES['marker_array']
    with rig.publisher(kind) as publisher:
        rig.begin(publisher)
        send = lambda: rig.send_next(publisher)  # noqa: E731
        with rig.publisher(kind) as other:

            def in_turn() -> None:
                send()
                rig.send(other, message(rig.stamp, rod(rig.frame)))

            words = 'several publishers send markers on /markers in turn (/peer, /peer)'
            rig.diagnosed(in_turn, WARN, words, None)
            # That it is there is no fault: one that was killed is there for a while.
            rig.diagnosed(send, OK, 'receiving markers', None)


def test_a_type_on_the_topic_that_is_not_followed_is_named(rig: Rig) -> None:
    other = Peer()
    try:
        with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
            rig.begin(publisher)
            send = lambda: rig.send_next(publisher)  # noqa: E731
            poses = other.node.create_publisher(ros_class(MARKER_TYPES['pose_array']), rig.topic, 1)
            words = '/markers is published as geometry_msgs/msg/PoseArray too'
            rig.diagnosed(send, WARN, words, None)
            other.node.destroy_publisher(poses)
            rig.diagnosed(send, OK, 'receiving markers', None)
    finally:
        other.close()


def test_another_node_of_the_name_is_told_of(tmp_path: FilePath) -> None:
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    rig = Rig('twin', '/twins')
    words = 'published by another node of this name too; fix: give each node a name'
    logs = (tmp_path / 'one', tmp_path / 'other')
    both = lambda: all(words in log.read_text() for log in logs)  # noqa: E731
    try:
        with process(*rig.words(config), log=logs[0]):
            rig.listen()
            with process(*rig.words(config), log=logs[1]):
                rig.diagnosed(lambda: None, STALE, words, None)
                rig.until(both, 'the same in both logs')
            rig.forget_heard('/diagnostics')
            gone = lambda: any(  # noqa: E731
                told.status[0].message == 'no markers received on /twins'
                for told in rig.heard('/diagnostics')
            )
            rig.until(gone, 'the end of the complaint')
    finally:
        rig.close()


def mutilated(good: bytes) -> Iterator[bytes]:
    """What bad memory, bad drivers and bad will make of a message."""
    generator = np.random.default_rng(11)
    yield from (b'\x00', good[:4], good[:-1], good + good, bytes(len(good)))
    while True:
        data = bytearray(good)
        place = int(generator.integers(4, len(data) - 4))
        match generator.integers(5):
            case 0:
                yield generator.bytes(int(generator.integers(1, 400)))
            case 1:
                yield bytes(data[:place])
            case 2:
                data[place : place + 4] = b'\xff\xff\xff\x7f'
                yield bytes(data)
            case 3:
                data[place] ^= 1 << int(generator.integers(8))
                yield bytes(data)
            case _:
                # No text in UTF-8, and no end to it.
                yield bytes(data).replace(b'world\0', b'\xff\xfe\xc0\x80\x01\x02')


@pytest.mark.parametrize('kind', MARKER_TYPES)
def test_mutilated_messages(rig: Rig, kind: str) -> None:
    good = serialize_message(message(rig.stamp, rod(1), kind))
    faulty = mutilated(good)
    with rig.publisher(MARKER_TYPES[kind]) as publisher:
        rig.fault(
            publisher,
            lambda _: next(faulty),
            None,
            'nothing is damaged',
            'messages that could not be read',
            kind,
        )


def test_messages_that_are_too_large_are_dropped_and_told(rig: Rig) -> None:
    # The fields are right, so only the size can be wrong.
    large = serialize_message(message(rig.stamp, rod(1))) + bytes(MAX_MESSAGE_BYTES)
    told = f'has {len(large)} bytes, and messages of more than {MAX_MESSAGE_BYTES} are not read'
    with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
        rig.fault(
            publisher, lambda _: large, None, f'{told}: publish', 'messages that could not be read'
        )


def test_a_simulated_clock_may_tell_any_time(tmp_path: FilePath) -> None:
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    rig = Rig('simulated', '/simulated')
    try:
        words = rig.words(config, use_sim_time=True)
        with process(*words, log=tmp_path / 'stderr') as node:
            rig.listen()
            clock = rig.node.create_publisher(Clock, '/clock', 1)
            rig.until(clock.get_subscription_count, 'the clock of the node')
            with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
                rig.begin(publisher)
                times = itertools.cycle((Time(sec=-5), Time(sec=2**31 - 1, nanosec=2**32 - 1)))

                def say() -> None:
                    clock.publish(Clock(clock=next(times)))
                    rig.send_next(publisher)

                start = rig.stamp
                rig.diagnosed(say, WARN, '/clock tells of -5 s', None)
                clock.publish(b'\x00\x01\x00\x00\xff')
                # Nothing started anew.
                rig.go_on_right(publisher, start)
            rig.check_finite()
            assert node.poll() is None
    finally:
        rig.close()


FAILING = """
import sys
from kinpole_ros.ros.node import main
from kinpole_ros.tracking.tracker import Tracker
add = Tracker.add
def failing(self, frames, *rest):
    if (frames.stamps % 1000 == 7).any():
        raise IndexError('what nobody thought of')
    return add(self, frames, *rest)
Tracker.add = failing
sys.exit(main(['kinpole', *sys.argv[1:]]))
"""


@pytest.fixture
def failing(tmp_path: FilePath) -> Iterator[Rig]:
    """A node that fails at stamps that end in 7."""
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    rig = Rig('failing', '/failing')
    words = ['timeout', '--foreground', '-k', '2', '60', sys.executable, '-c', FAILING]
    with (
        open(tmp_path / 'stderr', 'wb') as err,
        subprocess.Popen([*words, *rig.words(config)[1:]], stderr=err) as node,
    ):
        try:
            rig.listen()
            yield rig
        finally:
            node.send_signal(signal.SIGINT)
            assert node.wait(LIMIT) == 0
            rig.close()


def test_failures_in_a_row_are_told_of_and_ridden_out(failing: Rig) -> None:
    with failing.publisher(MARKER_TYPES['marker_array']) as publisher:
        failing.fault(
            publisher,
            lambda k: message(failing.stamp + k * STEP + 7, rod(failing.frame + k)),
            ERROR,
            'the node failed (IndexError: what nobody thought of, <string>:8) and starts anew',
            'failures of the node itself',
        )


def test_a_frame_at_which_the_node_fails_costs_no_other(failing: Rig, tmp_path: FilePath) -> None:
    told = 'the node failed (IndexError: what nobody thought of, <string>:8) and goes on without'
    with failing.publisher(MARKER_TYPES['marker_array']) as publisher:
        failing.begin(publisher)
        failing.good(publisher, 20)
        start = failing.stamp
        # Frames that wait together are lost together.
        failing.until(lambda: failing.newest() >= start - LAG, 'the result of the newest frame')
        failing.send(publisher, message(start + STEP + 7, rod(failing.frame + 1)))
        failing.until(lambda: told in (tmp_path / 'stderr').read_text(), 'the failure')
        failing.stamp, failing.frame = start + STEP, failing.frame + 1
        failing.good(publisher, 40)
    for topic in CHECKED:
        found = {stamp_of(m) for m in failing.heard(f'/failing/rod/{topic}')}
        assert found >= {start + k * STEP for k in range(-20, 20) if k != 1}, topic
    failing.check_right(start)


def test_failures_that_go_on_cost_one_body_after_the_other_and_at_last_all() -> None:
    """Nothing of a frame says what is wrong: the state of the body that is given up last."""
    tracker = Tracker(Settings(bodies={'rod': ('a', 'b', 'c', 'd'), 'other': ('e', 'f', 'g', 'h')}))
    for k in range(100):
        points = np.concatenate((rod(k), rod(-k)))[None]
        tracker.add(MarkerFrames(np.array([k * STEP]), 'world', tuple('abcdefgh'), points), 1)
    known = lambda: np.isfinite(tracker.state.history['angle']).any(axis=0).tolist()  # noqa: E731
    assert known() == [True, True]
    assert tracker.recover(0) == 'goes on without that frame'
    assert known() == [True, True]
    assert tracker.recover(1) == 'starts anew with rod'
    assert known() == [False, True]
    assert tracker.recover(2) == 'starts anew with other'
    assert known() == [False, False]
    assert tracker.samples > 0
    assert tracker.recover(3) == 'starts anew'
    assert tracker.samples == 0


# Parameters, transitions, signals


def test_parameters_set_while_markers_come(rig: Rig) -> None:
    """Every parameter: bad values are refused in one line, good ones taken, and results go on."""
    refused = {
        'window': ('wide', -1.0, float('nan'), 1e300, [0.1], True),
        'lag': (SETTINGS.window, -0.1, float('inf'), 'late', [b'\xff']),
        'noise': (-1e-9, float('nan'), 'loud', False),
        'derivative_order': (0, 5, 'high', 2.5, [1]),
        'plane': ('xz', '', 1, ['xy'], [0.0, 0.0, 0.0], [1.0, 2.0]),
        'scale': (0.0, -1.0, 'mm', float('nan')),
        'method': ('pose', 'poses', 0),
        'stamps': ('camera', 0, ''),
        'marker_identity': ('name', 7),
        'marker_type': ('marker', 0),
        'marker_topic': ('/other', '../../etc'),
        'bodies': (['other'], [], 'rod'),
        'rod.markers': (['0'], ['5', '6']),
        'autostart': (False, 'yes'),
        'executor': ('rclpy', 'lazy'),
        'scene': ('four_bar', '/etc/passwd', '../secrets.yaml'),
        'qos_overrides./markers.subscription.depth': (-1, 'deep', 10**12),
        'no_such_parameter': (0.3, ''),
    }
    taken = {
        'noise': (1e-4, 0.0),
        'window': (0.25, SETTINGS.window),
        'lag': (0.05, SETTINGS.lag),
        'derivative_order': (1, '2', 'auto'),
        'stamps': ('capture', 'auto'),
        'marker_identity': ('auto', 'index'),
        'plane': ('zx', [0.0, 0.6, 0.8], [0, 0, 2], 'fit', 'xy'),
        'scale': (0.001, 1.0),
    }
    with rig.publisher(MARKER_TYPES['point_cloud2']) as publisher:
        rig.begin(publisher, 'point_cloud2')
        given = [Parameter(name, value=v) for name, values in refused.items() for v in values]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in given])
        results = rig.call('/kinpole/set_parameters', SetParameters, request).results
        for parameter, result in zip(given, results, strict=True):
            assert not result.successful, parameter
            assert result.reason and '\n' not in result.reason
            assert 'root:' not in result.reason
        # A value taken away, as rclpy understands a parameter without one.
        for name in ('window', 'plane', 'bodies', 'rod.markers'):
            assert not rig.set(**{name: None})[0].successful
        for name, values in taken.items():
            for value in values:
                assert [r.successful for r in rig.set(**{name: value})] == [True], (name, value)
                for _ in range(3):
                    rig.send_next(publisher, 'point_cloud2')
        rig.forget_heard()
        start = rig.stamp
        for _ in range(100):
            rig.send_next(publisher, 'point_cloud2')
        rig.until(lambda: rig.newest() >= rig.stamp - LAG - STEP, 'the results')
        rig.check_right(start + WINDOW)
    rig.check_finite()


def test_impossible_transitions_are_refused_and_the_node_stays(rig: Rig) -> None:
    for number in (*range(12), 60, 97, 99, 255):
        if number not in (4, 7):  # deactivate and shutdown are possible
            request = ChangeState.Request()
            request.transition.id = number
            assert not rig.call('/kinpole/change_state', ChangeState, request).success, number
    assert not rig.change('no such transition')
    assert rig.state() == 'active'


STATES = {
    'unconfigured': (),
    'inactive': ('configure', 'cleanup', 'configure'),
    'active': ('configure', 'activate', 'deactivate', 'activate'),
    'finalized': ('configure', 'activate', 'shutdown'),
}


def test_told_to_stop_in_any_state_the_node_ends_at_once(tmp_path: FilePath) -> None:
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    words = node_words(config, autostart=False)
    asker = Peer()
    with ExitStack() as all_nodes:
        all_nodes.callback(asker.close)
        nodes = {
            state: all_nodes.enter_context(
                process(*words, '-r', f'__node:={state}', log=tmp_path / state)
            )
            for state in STATES
        }
        for state, node in nodes.items():
            for transition in STATES[state]:
                request = ChangeState.Request()
                request.transition.label = transition
                # Where an answer is lost, it is asked again, and refused: the state tells.
                asker.call(f'/{state}/change_state', ChangeState, request)
            found = asker.call(f'/{state}/get_state', GetState, GetState.Request())
            assert found.current_state.label == state
            node.send_signal((signal.SIGINT, signal.SIGTERM)[len(STATES[state]) % 2])
            assert node.wait(LIMIT) == 0, state
            assert not complaints(tmp_path / state)


@pytest.mark.parametrize('sign', [signal.SIGINT, signal.SIGTERM], ids=lambda sign: sign.name)
def test_told_to_stop_again_and_again_amid_markers_the_node_ends_well(
    sign: signal.Signals, tmp_path: FilePath
) -> None:
    """As by a terminal and by the launch file that it told too: no call is broken off by it."""
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    rig = Rig('stopped', '/seen')
    try:
        with process(*rig.words(config), log=tmp_path / 'stderr') as node:
            with rig.publisher(MARKER_TYPES['marker_array']) as publisher:
                heard = rig.hear('/stopped/rod/icr', PointStamped)
                rig.until(lambda: rig.send_next(publisher) or heard, 'the first results')

                def ended() -> bool:
                    node.send_signal(sign)
                    rig.send_next(publisher)
                    return node.poll() is not None

                rig.until(ended, 'the end of the node')
            assert node.returncode == 0
        assert not complaints(tmp_path / 'stderr')
    finally:
        rig.close()


AMID = """
import os, signal, sys
from kinpole_ros.ros.node import KinpoleNode, main
from rclpy.signals import get_current_signal_handlers_options
activate = KinpoleNode.on_activate
def interrupted(self, state):
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGTERM)
    result = activate(self, state)
    print('whole', get_current_signal_handlers_options(), flush=True)
    return result
KinpoleNode.on_activate = interrupted
sys.exit(main(['kinpole', *sys.argv[1:]]))
"""


def test_told_to_stop_amid_a_transition_the_node_finishes_it_first(tmp_path: FilePath) -> None:
    """And has no thread of rclpy's that shuts ROS down meanwhile: one stop in many crashed."""
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index')
    words = ['timeout', '-k', '2', '30', sys.executable, '-c', AMID, *node_words(config)[1:]]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ['whole', 'SignalHandlerOptions.NO']
    assert [line for line in done.stderr.splitlines() if '[INFO]' not in line] == []


class Failing:
    """Stands for a node and for its executor, which fails as often as it is asked."""

    def __init__(self) -> None:
        self.survived = 0

    def add_node(self, node: Any) -> None:
        pass

    def spin_once(self) -> None:
        raise ValueError('again')

    def recover(self, error: Exception) -> None:
        self.survived += 1


def test_failures_in_a_row_however_many_end_nothing_at_once() -> None:
    """A clock before 1970 makes one of each of its messages, hundreds a second."""
    failing = Failing()
    node_module._spin(cast(Any, failing), cast(Any, failing), lambda: failing.survived == 1000)
    assert failing.survived == 1000


def test_failures_with_nothing_between_for_too_long_end_the_node(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(node_module, '_MAX_FAILING', 0.0)
    failing = Failing()
    with pytest.raises(ValueError, match='again'):
        node_module._spin(cast(Any, failing), cast(Any, failing), lambda: False)
    assert failing.survived == node_module._MAX_FAILURES


def crowd(count: int = 100) -> Callable[[int, int], bytes]:
    """Frames k of `count` markers on one turning body as bytes, with a stamp: cheap to make."""
    marks = np.arange(3.0 * count).reshape(count, 3) + 0.123
    data = serialize_message(to_message('marker_array', 0, 'world', ['m'] * count, marks))
    places = np.array([data.index(row.tobytes()) for row in marks])[:, None] + np.arange(24)
    flat = 0.2 * np.exp(1j * np.arange(count)) * np.linspace(0.2, 1, count)

    def frame(k: int, stamp: int) -> bytes:
        turned = PIVOT + flat * np.exp(1j * TURN * k / 1000)
        points = np.stack((turned.real, turned.imag, 0 * turned.real), axis=-1)
        points[:, :2] += 1e-4 * _noise.normal(size=(count, 2))
        made = np.frombuffer(data, np.uint8).copy()
        made[places] = points.view(np.uint8).reshape(count, 24)
        made[8:16] = np.array(divmod(stamp, 10**9), '<u4').view(np.uint8)
        return made.tobytes()

    return frame


def test_a_flood_is_told_of_and_forgotten(tmp_path: FilePath) -> None:
    """100 markers at 1 kHz and more, for a node with one core that it shares with the sender."""
    frame = crowd()
    rig = Rig('flooded', '/flood')
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    config = write_config(tmp_path / 'rod.yaml', Settings(bodies={'rod': ()}))
    try:
        with process(*rig.words(config), log=tmp_path / 'stderr') as node:
            rig.listen()
            qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            publisher = rig.node.create_publisher(MarkerArray, rig.topic, qos)
            rig.until(publisher.get_subscription_count, 'the node')

            def send() -> None:
                for _ in range(20):
                    rig.frame += 1
                    rig.stamp += 1_000_000
                    publisher.publish(frame(int(rig.frame), rig.stamp))

            rig.diagnosed(send, WARN, 'slower than the stream', None)

            def send_and_look() -> bool:
                send()
                return (tmp_path / 'stderr').read_text().count('follows rod on') == 2

            rig.until(send_and_look, 'the subscription for messages so large')
            rig.diagnosed(send, WARN, 'slower than the stream', None)
            rig.forget_heard()
            # At a pace that can be borne it is right again.
            start = rig.stamp

            def send_slowly() -> bool:
                rig.frame += 5
                rig.stamp += STEP
                rig.send(publisher, frame(int(rig.frame), rig.stamp))
                found = [rig.heard(f'/flooded/rod/{topic}') for topic in CHECKED]
                return all(sum(stamp_of(m) >= start + WINDOW for m in f) >= 5 for f in found)

            rig.until(send_slowly, 'results of after the flood')
            rig.check_right(start + WINDOW)
            rig.check_finite()
            assert node.poll() is None
    finally:
        os.sched_setaffinity(0, cores)
        rig.close()
