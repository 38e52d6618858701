"""The page of a live node: its figures arrive and move; who may see it, and what it asks for."""

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from rclpy.node import Node
from test_report import BLUE, GREEN, RED, browser, cell, colored

from kinpole_ros.bags import read_messages, replay
from kinpole_ros.pipeline.parameters import load_settings
from kinpole_ros.ros.live import own_context, play
from kinpole_ros.ros.watch import Arrived
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.plot import plane_of_motion, row_of
from kinpole_ros.tools.report import page as page_of
from kinpole_ros.tools.report._results import read_record
from kinpole_ros.tools.view._feed import Feed
from kinpole_ros.tools.view._figures import as_json, common_instant, figures_of, rig_of, stamp_of
from kinpole_ros.tools.view._known import Known
from kinpole_ros.tools.view._live import Live
from kinpole_ros.tools.view._server import serving

__all__ = ['browser']
ROOT = Path(__file__).parents[1]
BAG = ROOT / 'bags' / 'four_bar.mcap'
LIMIT = 20.0


# ---- The server ----


@contextmanager
def served(feed: Feed | None = None, port: int = 0) -> Iterator[str]:
    """The address of a page under a token of its own, without a node."""
    page = page_of({'live': True, 'title': 'kinpole view', 'made': ''})
    with serving(feed or Feed(), page, port, 'secret') as address:
        yield address


def answer(address: str, path: str, host: str = '') -> tuple[int, str]:
    port = int(re.findall(r':(\d+)/', address)[0])
    connection = http.client.HTTPConnection('127.0.0.1', port, timeout=LIMIT)
    connection.putrequest('GET', path, skip_host=True)
    connection.putheader('Host', host or f'127.0.0.1:{port}')
    connection.endheaders()
    found = connection.getresponse()
    return found.status, found.read().decode()


def test_only_who_has_the_token_under_a_name_of_this_machine_gets_anything() -> None:
    with served() as address:
        assert address.startswith('http://127.0.0.1:') and address.endswith('/secret/')
        assert answer(address, '/secret/')[0] == 200
        assert answer(address, '/secret/', 'localhost:1234')[0] == 200
        assert answer(address, '/secret/else')[0] == 404
        for path in ('/', '/wrong/', '/secre/', '/stream', '/wrong/stream'):
            status, text = answer(address, path)
            assert (status, 'secret' in text) == (403, False), path
        # A page from elsewhere whose name was resolved to this machine.
        for host in ('evil.example:80', '127.0.0.1.evil.example', '[::1]:80', ''):
            assert answer(address, '/secret/', host or ' ')[0] == 403, host


def test_a_taken_port_is_one_line_and_exit_2(capsys) -> None:
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        assert main(['view', '--port', str(port)]) == 2
    assert main(['view', '--port', '70000']) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f'kinpole view: --port {port} of 127.0.0.1 cannot be had')
    assert '65535' in second


def test_a_slow_page_gets_the_newest_and_misses_the_rest() -> None:
    feed = Feed()
    feed.put('rig', '0')
    feed.put('frame', 'old')
    events = feed.events(['icr'], 'rig')
    # What lasts is told anew, what was of its moment is not.
    assert next(events) == b'event: rig\ndata: 0\n\n'
    for number in range(1000):
        feed.put('frame', str(number))
    assert next(events) == b'event: frame\ndata: 999\n\n'
    other = feed.events(['iap', 'relative'], 'rig')
    next(other)
    assert feed.shown() == {'icr', 'iap', 'relative'}
    events.close()
    assert feed.shown() == {'iap', 'relative'}
    feed.close()
    assert list(other) == []
    assert feed.shown() is None


# ---- The figures ----


def test_the_instant_is_the_newest_that_most_topics_tell_of() -> None:
    pose = ['a/odom', 'b/odom']
    stamps = {'a/odom': [1, 2, 3], 'b/odom': [1, 2, 3], 'a/icr': [1, 2], 'b/icr': [1, 2]}
    # Those of 3 are still on their way.
    assert common_instant(stamps, pose, None) == 2
    assert common_instant(stamps, pose, 2) is None
    stamps = {name: [2, 3] for name in stamps}
    assert common_instant(stamps, pose, 2) == 3
    # A pole that is no longer determined, and a clock that steps back.
    assert common_instant({**stamps, 'a/icr': [1]}, pose, 2) == 3
    assert common_instant({name: [9, 1, 2] for name in stamps}, pose, 9) == 2
    assert common_instant({}, pose, None) is None


@pytest.fixture(scope='module')
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a node tells of the four-bar, as a bag."""
    output = tmp_path_factory.mktemp('view') / 'results.mcap'
    replay(BAG, load_settings(ROOT / 'config' / 'four_bar.yaml'), output)
    return output


def test_figures_are_those_of_a_report_of_the_same_messages(results) -> None:
    record, _ = read_record(results, lambda _: 10_000)
    kinds, stamped = messages_of(results)
    rig, messages = rig_of('/kinpole', kinds), stamped[110]
    assert rig.bodies == ('crank', 'coupler', 'rocker')
    poses = [row_of(kinds[pose], messages[pose]) for pose in rig.poses]
    found = figures_of(rig, messages, plane_of_motion(np.array(poses)))
    for key, values in record.columns.items():
        if key in found and np.isfinite(values[110]).all():
            np.testing.assert_allclose(
                found[key], values[110], rtol=1e-9, atol=1e-12, err_msg=str(key)
            )
    assert {name for _, name in found} >= {'isp', 'angular_snap_sigma', 'icr_velocity_covariance'}


class Scripted:
    """Stands for the watcher: nodes that are there, and what came from them."""

    def __init__(self, kinds: dict[str, str], names: Sequence[str] = ('/kinpole',)) -> None:
        self._nodes = {
            name: {topic.replace('/kinpole', name): kind for topic, kind in kinds.items()}
            for name in names
        }
        self.newest: dict[str, deque[Any]] = {}

    def nodes(self) -> dict[str, dict[str, str]]:
        return self._nodes

    def want(self, topics: dict[str, str]) -> None:
        self.newest = {topic: self.newest.get(topic, deque(maxlen=4)) for topic in topics}

    def take(self) -> None:
        pass


class Told:
    """Stands for the feed: one page is open, and this is what it was told."""

    def __init__(self) -> None:
        self.rigs: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []

    def shown(self) -> frozenset[str]:
        return frozenset()

    def put(self, kind: str, data: str) -> None:
        (self.rigs if kind == 'rig' else self.frames).append(json.loads(data))


def live_of(watcher: Scripted, chosen: str = '') -> tuple[Live, Told]:
    """What shows a node of the watcher, with words about it told."""
    told = Told()
    live = Live(cast(Any, watcher), cast(Any, told), chosen)
    step_until(live, lambda: [rig for rig in told.rigs if 'bodies' in rig or chosen == 'none'])
    return live, told


def step_until(live: Live, condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline
        live.step()


def test_what_is_no_message_is_told_of_and_what_follows_is_shown(results) -> None:
    kinds, stamped = messages_of(results)
    watcher = Scripted(kinds)
    live, told = live_of(watcher)
    poses = watcher.newest['/kinpole/crank/odom']
    good = stamped[0]['/kinpole/crank/odom']
    for data in (b'', good[:40], b'\0\1' + bytes(30)):
        poses.append(Arrived(data, 0))
        live.step()
        poses.clear()
    step_until(live, lambda: told.rigs[-1]['notes'])
    assert told.rigs[-1]['notes'][0].startswith('a message cannot be read: ')
    assert told.frames == []
    poses.append(Arrived(good, 0))
    live.step()
    assert [body is not None for body in told.frames[0]['bodies']] == [True, False, False]


def test_of_several_nodes_the_chosen_one_is_shown_and_others_are_named(results) -> None:
    kinds, _ = messages_of(results)
    watcher = Scripted(kinds, ('/a/kinpole', '/b/kinpole'))
    for chosen, shown in (('', 'a'), ('b', 'b'), ('/b/kinpole/', 'b'), ('b/kinpole/crank', 'b')):
        _, told = live_of(watcher, chosen)
        assert told.rigs[-1]['title'] == f'/{shown}/kinpole'
        assert ('/b/kinpole' in told.rigs[-1]['about']) == (not chosen)
    _, told = live_of(watcher, 'none')
    assert 'under /none ' in told.rigs[-1]['waiting']


def messages_of(results: Path) -> tuple[dict[str, str], list[dict[str, bytes]]]:
    """Types by topic, and the messages of figures, instant by instant."""
    kinds: dict[str, str] = {}
    stamped: dict[int, dict[str, bytes]] = {}
    for message in read_messages(results):
        kinds[message.topic] = message.type_name
        if message.type_name.startswith(('geometry_msgs', 'nav_msgs/msg/Odometry')):
            stamped.setdefault(stamp_of(message.data), {})[message.topic] = message.data
    return kinds, [stamped[stamp] for stamp in sorted(stamped)]


# ---- In a browser ----


@contextmanager
def opened(browser: Any, address: str) -> Iterator[Any]:
    """A page of that address; no error, and no request but to it."""
    troubles: list[str] = []
    page = browser.new_page(viewport={'width': 1280, 'height': 800})
    page.on('console', lambda message: troubles.append(message.text))
    page.on('pageerror', lambda error: troubles.append(str(error)))
    page.on('request', lambda request: troubles.append(request.url))
    page.set_default_timeout(LIMIT * 1e3)
    page.goto(address)
    yield page
    page.close()
    # That a server is gone is told in the console too.
    expected = (address, 'Failed to load resource: net::ERR')
    assert [text for text in troubles if not text.startswith(expected)] == []


@contextmanager
def played(results: Path) -> Iterator[None]:
    """The results published meanwhile, over and over, as a node does: whoever listens."""
    stop = threading.Event()

    class Stopped(Exception):
        pass

    def look(_: float) -> None:
        if stop.is_set():
            raise Stopped

    def run() -> None:
        with suppress(Stopped):
            play(results, wait=0.0, loop=True, progress=look)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.fixture
def watcher() -> Iterator[Node]:
    context = own_context()
    node = Node('watcher', context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def await_readers(node: Node, topic: str, there: bool) -> None:
    deadline = time.monotonic() + LIMIT
    while bool(node.count_subscribers(topic)) != there:
        assert time.monotonic() < deadline, f'{topic}: {node.count_subscribers(topic)} readers'
        time.sleep(0.02)


def await_motion(page: Any) -> None:
    """Until another instant is shown, and another."""
    for _ in range(2):
        shown = page.locator('#clock').inner_text()
        page.wait_for_function('t => document.querySelector("#clock").textContent !== t', arg=shown)


def seconds(page: Any) -> float:
    return float(page.locator('#clock').inner_text().split()[2].replace('−', '-'))


def test_page_waits_for_a_node_shows_it_and_asks_for_no_more(browser, results, watcher) -> None:
    command = [sys.executable, '-m', 'kinpole_ros.tools.cli', 'view']
    with ExitStack() as closing:
        view = closing.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        closing.callback(view.kill)
        assert view.stdout is not None
        (address,) = re.findall(r'http://\S+', view.stdout.readline())
        tab = ExitStack()
        page = closing.enter_context(tab).enter_context(opened(browser, address))
        page.locator('#about', has_text='No kinpole node publishes in this ROS domain').wait_for()
        with played(results):
            page.wait_for_selector('html[data-ready]')
            assert page.locator('h1').inner_text() == '/kinpole'
            await_motion(page)
            page.locator('#about', has_text='markers at 100 Hz').wait_for()
            for color in (BLUE, RED, GREEN):
                assert colored(page, '#stage canvas', color) > 100
                assert colored(page, '[data-name=angular_velocity] canvas', color) > 20
            value, spread = cell(page, 'angular_velocity', 0).split('±')
            assert abs(float(value) - 2 * np.pi) < 3 * float(spread) < 0.3
            # What is not shown is not asked for.
            await_readers(watcher, '/kinpole/rocker/icr/with_covariance', True)
            assert not watcher.count_subscribers('/kinpole/rocker/angular_jerk')
            page.locator('#rates button', has_text='jerk').click()
            await_readers(watcher, '/kinpole/rocker/angular_jerk', True)
            page.locator('#now [data-name=angular_jerk] td', has_text='±').first.wait_for()
            # The last seconds can be looked through, and nothing is asked for meanwhile.
            page.keyboard.press('l')
            await_readers(watcher, '/kinpole/rocker/odom', False)
            held = seconds(page)
            page.keyboard.press('Shift+ArrowLeft')
            page.wait_for_function(
                't => parseFloat(document.querySelector("#clock").textContent.slice(4)) < t',
                arg=held - 0.1,
            )
            page.keyboard.press('l')
            await_motion(page)
        page.locator('#about', has_text='no results for').wait_for()
        with played(results):
            await_motion(page)
            page.locator('#about', has_text='markers at').wait_for()
        tab.close()
        await_readers(watcher, '/kinpole/rocker/odom', False)
        view.send_signal(signal.SIGTERM)
        assert view.wait(LIMIT) == 0


def test_page_goes_on_when_the_server_is_back_and_begins_anew_with_other_bodies(
    browser, results
) -> None:
    kinds, stamped = messages_of(results)
    rig = rig_of('/kinpole', kinds)
    known, port = Known(rig), 0
    with ExitStack() as closing:
        for messages, at in zip(stamped[50:], (0.5, 1.25), strict=False):
            feed = Feed()
            with served(feed, port) as address:
                if not port:
                    port = int(re.findall(r':(\d+)/', address)[0])
                    page = closing.enter_context(opened(browser, address))
                feed.wait_for_page(LIMIT)
                feed.put('rig', known.as_json(0.0, []))
                feed.put('frame', as_json(rig, known.figures(messages), at, 0))
                page.locator('#clock', has_text=f't = {at:.3f} s').wait_for()
                assert page.locator('#state').inner_text() == ''
                if at > 1:
                    # A node with other bodies is another page.
                    other = Known(rig._replace(bodies=('rod',), pairs=()))
                    feed.put('rig', other.as_json(0.0, []))
                    page.locator('#bodies', has_text='rod').wait_for()
            page.locator('#state', has_text='disconnected').wait_for()
