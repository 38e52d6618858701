"""The demo: it waits while its processes live, says what for, and tells lost from undetermined."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.bags import BagError, BagWriter, message_class, read_messages, replay, topics
from kinpole_ros.messages import read_state
from kinpole_ros.settings import load_settings
from kinpole_ros.tools import demo

pytest.importorskip('matplotlib')
ROOT = Path(__file__).parents[3]
BAG, CONFIG = ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml'


@pytest.fixture(scope='module')
def results(tmp_path_factory) -> Path:
    """The results of the bag of the demo, as a node that loses nothing publishes them."""
    bag = tmp_path_factory.mktemp('demo') / 'results.mcap'
    replay(BAG, load_settings(CONFIG), bag)
    return bag


def part_of(bag: Path, output: Path, keep) -> Path:
    """The messages of a bag with their stamps (s) for which `keep(topic, time)`."""
    names = [name for name in topics(bag) if name != '/tf']
    with BagWriter(output) as writer:
        for message in read_messages(bag, names):
            if keep(message.topic, message.log_time * 1e-9):
                cls = message_class(message.type_name)
                writer.write_raw(message.topic, cls, message.data, message.log_time)
    return output


def test_the_demo_records_what_it_shows(tmp_path) -> None:
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(20 + os.getpid() % 70)}
    done = subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', 'demo', '--output', tmp_path],
        env={**environment, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / 'demo.png').stat().st_size > 50_000
    recorded = topics(tmp_path / 'demo.mcap')
    assert {'/kinpole/state', '/markers', '/diagnostics'} < set(recorded)
    assert not [name for name in recorded if name.endswith(('angular_jerk', 'iap', 'ijp'))]
    assert sum(1 for _ in read_messages(tmp_path / 'demo.mcap')) < 6000
    assert 'latency of the node, from a frame to its results: ' in done.stdout
    assert 'latency of the recorder, from results to their recording: ' in done.stdout
    table = [line.split() for line in done.stdout.splitlines()]
    assert ['body', 'quantity', 'determined', 'undetermined', 'lost'] in [row[:5] for row in table]
    assert len([row for row in table if row[:1] in (['crank'], ['coupler'], ['rocker'])]) == 18


def test_the_table_tells_lost_frames_from_undetermined_ones(results, tmp_path) -> None:
    whole = [line.split() for line in demo._comparison_lines(BAG, results)][1:]
    gappy = part_of(results, tmp_path / 'gappy.mcap', lambda _, time: not 2.0 < time < 3.7)
    lossy = [line.split() for line in demo._comparison_lines(BAG, gappy)][1:]
    assert len(whole) == len(lossy) == 18
    for before, after in zip(whole, lossy, strict=True):
        assert before[:2] == after[:2]
        counts = np.array([before[2:5], after[2:5]], int)
        assert counts[0, 2] == 0
        assert 160 < counts[1, 2] < 180
        # What is lost is neither determined nor undetermined.
        np.testing.assert_array_equal(counts.sum(axis=1), counts[0].sum())
        assert counts[0, 1] - counts[1, 1] <= counts[1, 2]


def test_waiting_says_what_for_and_ends_with_the_processes(monkeypatch, capsys) -> None:
    monkeypatch.setattr(demo, '_NEXT_LINE', 0.0)
    monkeypatch.setattr(demo, '_POLL_INTERVAL', 0.0)
    left = ['the node to announce its topics', 'the recorder to subscribe to 3 topics', '']
    with subprocess.Popen([sys.executable, '-c', 'input()'], stdin=subprocess.PIPE) as living:
        demo._await(lambda: left.pop(0), living)
        first, second = capsys.readouterr().out.splitlines()
        assert first.startswith('waiting for the node to announce its topics: 0 s; load ')
        assert second.startswith('waiting for the recorder to subscribe to 3 topics: 0 s; load ')
        living.communicate(b'\n')
        with pytest.raises(BagError, match='ended on the way; see what it printed'):
            demo._await(lambda: 'results', living)


def test_the_run_starts_when_all_has_been_there_for_a_while() -> None:
    """A node that found its subscribers later than the watcher did not send its first results."""
    looks: list[float] = []

    def missing() -> str:
        looks.append(time.monotonic())
        return 'a subscriber' if len(looks) in (1, 3) else ''

    demo._await(missing, lasting=0.2)
    assert looks[-1] - looks[2] >= 0.2


@pytest.mark.parametrize(('in_node', 'in_recorder'), [(2, 1), (2, 7000), (6000, 1)])
def test_the_latency_of_the_node_is_not_that_of_the_recorder(results, in_node, in_recorder) -> None:
    settings, ms = load_settings(CONFIG), 1_000_000
    recorded = {
        read_state(message.data)[0]: message.log_time
        for message in read_messages(results, ['/kinpole/state'])
    }
    published = {stamp: time - in_recorder * ms for stamp, time in recorded.items()}
    lag = round(settings.lag * 1e9)
    sent = {stamp + lag: time - in_node * ms for stamp, time in published.items()}
    run = demo.LiveRun(len(sent), sent, published)
    lines = list(demo._latency_lines(run, results, settings))
    assert lines[0].endswith(
        f'from a frame to its results: {in_node}.0 ms, 99% within {in_node}.0 ms'
    )
    remarks = dict(zip(lines, [*lines[1:], ''], strict=True))
    for name, latency in (('node', in_node), ('recorder', in_recorder)):
        (line,) = (line for line in lines if f'latency of the {name}' in line)
        assert f' {latency}.0 ms' in line
        assert ('which is long' in remarks[line]) == (latency > 100)
