"""Killed, or out of disk: what replay and record had written until then is there to be read."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32, String

from kinpole_ros.bags import RECORDER, BagError, BagMessage, BagWriter, read_messages, recorder_of
from kinpole_ros.messages import to_message
from kinpole_ros.ros.recorder import Recorder

ROOT = Path(__file__).parents[3]
TOPIC = '/kinpole/test_stopped'
FILE_SIZE = 600_000


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """So many frames of a turning body that a replay can be stopped on its way."""
    path = tmp_path_factory.mktemp('long') / 'turning.mcap'
    times = np.arange(1000) * 0.005
    corners = np.array([0.1, 0.1j, -0.1]) * np.exp(2j * np.sin(times))[:, None]
    points = np.stack((corners.real, corners.imag, np.zeros_like(corners.real)), axis=-1)
    with BagWriter(path) as writer:
        for k, stamp in enumerate((10**9 + times * 1e9).astype(int).tolist()):
            cloud = to_message('point_cloud2', stamp, 'world', ['a', 'b', 'c'], points[k])
            writer.write('/markers', cloud, stamp)
    return path


# The command; where a bag that it writes has become this large, it says so and waits for a signal,
# which so never comes to one that has ended.
PAUSE = """
import sys, time
from pathlib import Path
from kinpole_ros.bags import BagWriter
from kinpole_ros.tools.cli import main

folder, write = Path(sys.argv.pop(1)), BagWriter.write_many

def write_and_pause(self, columns):
    write(self, columns)
    if any(part.stat().st_size > 200_000 for part in folder.glob('*.part')):
        print('on its way', flush=True)
        while True:
            time.sleep(1)

BagWriter.write_many = write_and_pause
sys.exit(main())
"""
COMMAND = ('-m', 'kinpole_ros.tools.cli')


@contextmanager
def kinpole(
    *words: object, most: int | None = None, program: tuple[str, ...] = COMMAND
) -> Iterator['subprocess.Popen[str]']:
    """The command in a process of its own; no file it writes gets larger than `most` bytes."""

    def limit() -> None:
        if most is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    started = subprocess.Popen(
        [sys.executable, *program, *map(str, words)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limit,
    )
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


@contextmanager
def peer() -> Iterator[Node]:
    """A node of a process of its own, as others see it."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = Node('test_stopped', context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


@contextmanager
def publisher(qos: QoSProfile | None = None) -> Iterator[Publisher]:
    with peer() as node:
        yield node.create_publisher(String, TOPIC, qos or QoSProfile(depth=1000))


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def readable(path: Path) -> list[BagMessage]:
    """All that can be read, of a bag that need not be there yet."""
    messages = []
    with suppress(BagError):
        for message in read_messages(path):
            messages.append(message)
    return messages


def test_replay_killed_on_the_way_leaves_the_results_of_before(bag: Path, tmp_path: Path) -> None:
    result, table = tmp_path / 'out.mcap', tmp_path / 'out.csv'
    result.write_bytes(b'before')

    left: set[Path] = set()

    def parts() -> list[Path]:
        return [part for part in tmp_path.glob('out.mcap.*.part') if part not in left]

    program = ('-c', PAUSE, str(tmp_path))
    for stop in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP):
        words = ('replay', bag, '--output', result, '--csv', table)
        with kinpole(*words, program=program) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == 'on its way\n'
            process.send_signal(stop)
            assert process.wait(30) in (-signal.SIGKILL, 128 + stop)
        assert result.read_bytes() == b'before'
        assert not table.exists()
        # What a kill leaves can be read; what can end by itself leaves nothing of that either.
        if stop == signal.SIGKILL:
            (part,) = left = {*parts()}
            assert len([m for m in readable(part) if m.topic == '/kinpole/body/odom']) > 50
            continue
        assert sorted(tmp_path.iterdir()) == [result]


# Python runs this before the command. At many of the imports from the command's own on, a copy of
# the process is made and interrupted; in the end the process prints how each of them ended.
INTERRUPT = """
import atexit, os, signal, sys

count, moment, ended = 0, 1.0, []

def hear(event, words):
    global count, moment
    if event != 'import' or not (count or words[0] == 'kinpole_ros.tools.commands'):
        return
    count += 1
    if count < moment:
        return
    moment *= 1.3
    copy = os.fork()
    if copy:
        ended.append(os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]))
        return
    moment = float('inf')
    ended.clear()
    said = os.open('said', os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    os.dup2(said, 1)
    os.dup2(said, 2)
    os.kill(os.getpid(), signal.SIGINT)

sys.addaudithook(hear)
atexit.register(lambda: ended and print(count, *ended))
"""


@pytest.mark.parametrize(
    ('words', 'domain'),
    [
        (['node', 'unknown_word'], '0'),  # it ends by itself once ROS has started
        (['view'], 'none'),  # and these where ROS cannot start
        (['record', '--output', 'out.mcap'], 'none'),
        (['replay', 'no_bag.mcap', '--csv', 'out.csv'], '0'),
        (['plot', 'no_bag.mcap', '--output', 'out.png'], '0'),
    ],
    ids=lambda given: given[0] if isinstance(given, list) else '',
)
def test_a_command_interrupted_while_it_starts_ends_without_a_word(
    tmp_path: Path, words: list[str], domain: str
) -> None:
    (tmp_path / 'sitecustomize.py').write_text(INTERRUPT)
    paths = os.pathsep.join((str(tmp_path), str(ROOT)))
    done = subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', *words],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': paths, 'ROS_DOMAIN_ID': domain},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    count, *ended = map(int, done.stdout.split())
    assert count > 50
    assert len(ended) > 10
    assert set(ended) == {130}
    assert (tmp_path / 'said').read_text() == ''


def test_what_was_sent_before_and_is_kept_for_those_who_come_late_is_recorded(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'live.mcap'
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with publisher(kept) as source:
        source.publish(String(data='early'))
        with kinpole('record', '--output', path, '--topic', TOPIC):
            until(lambda: len(readable(path)) == 1, 15)


def test_a_publisher_that_comes_back_and_offers_less_is_recorded_too(tmp_path: Path) -> None:
    path = tmp_path / 'live.mcap'
    kept = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    less = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    with kinpole('record', '--output', path, '--topic', TOPIC):
        for name, qos in (('kept', kept), ('reliable', QoSProfile(depth=1000)), ('less', less)):
            with publisher(qos) as source:

                def recorded(source: Publisher = source, name: str = name) -> bool:
                    source.publish(String(data=name))
                    return any(name.encode() in message.data for message in readable(path))

                until(recorded, 15)


def test_a_recorder_that_is_behind_when_told_to_stop_records_all_that_has_come(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'live.mcap'
    # The slash of a topic may be missing.
    words = ('record', '--output', path, '--topic', TOPIC[1:])
    with publisher() as source, kinpole(*words) as process:
        until(lambda: source.get_subscription_count() > 0, 15)
        for k in range(1000):
            source.publish(String(data=str(k)))
        assert source.wait_for_all_acked(Duration(seconds=15))
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert len(readable(path)) == 1000
    assert recorder_of(path) == RECORDER


@pytest.mark.parametrize('ignored', [False, True])
def test_a_closed_terminal_ends_a_recording_well_unless_nohup_keeps_it(
    tmp_path: Path, ignored: bool
) -> None:
    path = tmp_path / 'live.mcap'
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        with publisher() as source, kinpole('record', '--output', path, '--topic', TOPIC) as told:
            until(lambda: source.get_subscription_count() > 0, 15)
            source.publish(String(data='before'))
            until(lambda: len(readable(path)) == 1)
            told.send_signal(signal.SIGHUP)
            if ignored:
                source.publish(String(data='after'))
                until(lambda: len(readable(path)) == 2)
                told.send_signal(signal.SIGINT)
            assert told.wait(15) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert len(list(read_messages(path))) == 1 + ignored


def test_little_is_imported_before_ctrl_c_is_handled() -> None:
    code = 'import sys; known = {*sys.modules}; import kinpole_ros.tools.cli; '
    code += 'print(*{*sys.modules} - known)'
    words = [sys.executable, '-c', code]
    new = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=60).stdout.split()
    assert 'kinpole_ros.tools.cli' in new
    # `contextlib` and what it needs are imported before where the package is not a plain folder.
    assert not {*new} & {'typing', 'collections.abc', 'argparse', 'pathlib', 'numpy', 'rclpy'}


def test_a_recorder_names_what_it_cannot_record_and_what_nobody_publishes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def unknown(name: str) -> type:
        raise LookupError(f'message type {name} is not installed')

    monkeypatch.setattr('kinpole_ros.ros.recorder.installed_class', unknown)
    monkeypatch.setattr('kinpole_ros.ros.recorder._PATIENCE', 0.3)
    told = ''
    rclpy.init(args=[])
    executor = SingleThreadedExecutor()
    with publisher(), BagWriter(tmp_path / 'live.mcap') as writer:
        recorder = Recorder(writer, [TOPIC, '/nowhere/'])
        executor.add_node(recorder)

        def heard() -> bool:
            nonlocal told
            executor.spin_once(timeout_sec=0.1)
            told += capfd.readouterr().err
            return 'begins with' in told and 'not recorded' in told

        try:
            until(heard, 15)
        finally:
            executor.shutdown()
            recorder.destroy_node()
            rclpy.try_shutdown()
    assert f'{TOPIC} is not recorded: message type std_msgs/msg/String is not installed' in told
    assert 'nobody publishes on a topic that begins with /nowhere/ yet' in told
    assert len(told.splitlines()) == 2


def test_a_player_that_is_terminated_leaves_the_network_at_once(bag: Path) -> None:
    with peer() as other, kinpole('play', bag, '--loop') as process:
        until(lambda: other.count_publishers('/markers') == 1, 15)
        process.terminate()
        assert process.wait(15) == 128 + signal.SIGTERM
        # Of one that is killed they are known for 20 s more.
        until(lambda: other.count_publishers('/markers') == 0, 10)


def test_where_ros_cannot_start_no_recording_is_begun(tmp_path: Path) -> None:
    path = tmp_path / 'live.mcap'
    path.touch()
    os.utime(path, ns=(7, 7))
    done = subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', 'record', '--output', str(path)],
        cwd=ROOT,
        env={**os.environ, 'ROS_DOMAIN_ID': 'none'},
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == 2
    assert done.stderr.startswith('kinpole record: ROS cannot start in this environment: ')
    assert done.stderr.count('\n') == 1
    assert path.stat().st_mtime_ns == 7


def test_recording_killed_on_the_way_keeps_what_came_before_the_last_second(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'live.mcap'
    with publisher() as source, kinpole('record', '--output', path, '--topic', TOPIC) as process:
        until(lambda: source.get_subscription_count() > 0)
        for k in range(20):
            source.publish(String(data=f'early {k}'))
        # Few and small, so that only the clock can have sent them to the disk.
        until(lambda: len(readable(path)) == 20)
        for k in range(20):
            source.publish(String(data=f'late {k}'))
        process.kill()
        assert process.wait() == -signal.SIGKILL
    assert len(readable(path)) >= 20
    assert [b'early' in m.data for m in readable(path)[:20]] == [True] * 20


@pytest.mark.parametrize('target', ['--output', '--csv'])
def test_a_full_disk_ends_a_replay_in_one_line(bag: Path, tmp_path: Path, target: str) -> None:
    path = tmp_path / 'out'
    path.write_bytes(b'before')
    with kinpole('replay', bag, target, path, most=250_000) as process:
        said, complaints = process.communicate(timeout=120)
    assert process.returncode == 2
    assert said == ''
    assert complaints.count('\n') == 1
    assert f'{path} cannot be written: File too large; ' in complaints
    assert path.read_bytes() == b'before'
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_full_disk_ends_a_recording_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / 'live.mcap'
    recording = ('record', '--output', path, '--topic', TOPIC)
    with publisher() as source, kinpole(*recording, most=FILE_SIZE) as process:
        until(lambda: source.get_subscription_count() > 0)
        sent = 0

        def publish_until_it_ends() -> bool:
            nonlocal sent
            source.publish(String(data=os.urandom(10_000).hex()))
            sent += 1
            return process.poll() is not None

        until(publish_until_it_ends)
        said, complaints = process.communicate(timeout=60)
    assert process.returncode == 2
    assert said == ''
    assert complaints.count('\n') == 1
    assert f'{path} cannot be written: File too large; fix: ' in complaints
    assert 20 <= len(readable(path)) < sent


# The demo, which waits for a signal where it would play.
DEMO = """
import sys, time
from kinpole_ros.tools import demo
from kinpole_ros.tools.cli import main

demo.play = lambda *_, **__: time.sleep(60)
sys.exit(main())
"""


def test_a_demo_that_is_terminated_takes_its_processes_with_it(tmp_path: Path) -> None:
    with kinpole('demo', '--output', tmp_path, program=('-c', DEMO)) as process:
        children = Path(f'/proc/{process.pid}/task/{process.pid}/children')
        until((tmp_path / 'demo.mcap').exists)
        begun = children.read_text().split()
        assert len(begun) == 2
        try:
            process.terminate()
            assert process.wait(30) == 128 + signal.SIGTERM
            until(lambda: not any(Path(f'/proc/{pid}').exists() for pid in begun), 15)
        finally:
            for pid in begun:
                with suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGKILL)


def test_a_topic_is_recorded_as_it_is_published_and_another_type_on_it_is_told_of(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, told = tmp_path / 'live.mcap', ''
    rclpy.init(args=[])
    executor = SingleThreadedExecutor()
    with peer() as other, publisher() as source, BagWriter(path) as writer:
        # Who listens may do so in vain.
        other.create_subscription(Int32, TOPIC, print, 1)
        before = Node('before')
        until(lambda: len(dict(before.get_topic_names_and_types()).get(TOPIC, [])) == 2, 15)
        recorder = Recorder(writer, [TOPIC])
        executor.add_node(recorder)

        def recorded() -> bool:
            source.publish(String(data='here'))
            executor.spin_once(timeout_sec=0.1)
            return recorder.messages > 0

        def heard() -> bool:
            nonlocal told
            executor.spin_once(timeout_sec=0.1)
            told += capfd.readouterr().err
            return 'too' in told

        try:
            until(recorded, 15)
            other.create_publisher(Int32, TOPIC, 1)
            until(heard, 15)
        finally:
            executor.shutdown()
            recorder.destroy_node()
            before.destroy_node()
            rclpy.try_shutdown()
    assert f'{TOPIC} is published as std_msgs/msg/Int32 too, and that is not recorded' in told
    assert {message.type_name for message in readable(path)} == {'std_msgs/msg/String'}
