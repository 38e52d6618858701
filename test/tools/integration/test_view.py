"""The page of a live node: its figures arrive and move; who may see it, and what it asks for."""

import http.client
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from pages import BLUE, GREEN, RED, await_color, cell
from rclpy.node import Node

from kinpole_ros.bags import BagWriter, read_messages, replay
from kinpole_ros.messages import (
    STATE,
    VIEW,
    String,
    live_outputs,
    quantity_lists,
    serialize_message,
    view_of,
)
from kinpole_ros.ros.listener import Arrived
from kinpole_ros.ros.player import own_context, play
from kinpole_ros.settings import load_settings
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.report import page as page_of
from kinpole_ros.tools.view._frames import frame_of_view
from kinpole_ros.tools.view._live import Live, RigState
from kinpole_ros.tools.view._server import Feed, serving
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import XY
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, Vectors

ROOT = Path(__file__).parents[3]
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


@pytest.mark.parametrize('path', ['http://[/x', '//[x', '/secret]/', 'http://[::1'])
def test_a_request_for_no_address_is_answered_without_a_word_on_the_terminal(
    path: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with served() as address:
        assert answer(address, path)[0] in (400, 403)
    assert capfd.readouterr() == ('', '')


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
    assert first.startswith(f'kinpole view: --port {port} of 127.0.0.1 cannot be used')
    assert '65535' in second


def test_a_slow_page_gets_the_newest_and_misses_the_rest() -> None:
    feed = Feed()
    feed.put('rig', '0')
    feed.put('frame', 'old')
    events = feed.events('rig')
    # What lasts is told anew, what was of its moment is not.
    assert next(events) == b'event: rig\ndata: 0\n\n'
    for number in range(1000):
        feed.put('frame', str(number))
    assert next(events) == b'event: frame\ndata: 999\n\n'
    other = feed.events('rig')
    next(other)
    events.close()
    assert feed.wait_for_page(0.0)
    feed.close()
    assert list(other) == []
    assert not feed.wait_for_page(0.0)


def test_a_page_gets_the_rig_before_frames_and_no_frame_from_before_that_rig() -> None:
    feed = Feed()
    events = feed.events('rig')
    assert next(events) == b':\n\n'  # the page is open
    feed.put('frame', 'without a rig')
    assert next(events) == b':\n\n'
    feed.put('rig', '0')
    assert next(events) == b'event: rig\ndata: 0\n\n'
    # Bodies change before the page has taken the last frame of the others.
    feed.put('frame', 'of rig 0')
    feed.put('rig', '1')
    assert next(events) == b'event: rig\ndata: 1\n\n'
    feed.put('rig', '2')
    feed.put('frame', 'of rig 2')
    assert next(events) == b'event: rig\ndata: 2\n\nevent: frame\ndata: of rig 2\n\n'


def test_the_address_without_its_slash_leads_to_the_page() -> None:
    with served() as address, urllib.request.urlopen(address.rstrip('/')) as page:
        assert (page.status, page.url) == (200, address)


@pytest.mark.parametrize('request_text', ['GET /sec', 'GET /secret/stream HTTP/1.1\r\n\r\n'])
def test_a_connection_that_is_cut_off_leaves_no_word_on_the_terminal(
    request_text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    before = threading.active_count()
    with served() as address:
        port = int(re.findall(r':(\d+)/', address)[0])
        for _ in range(10):
            with socket.create_connection(('127.0.0.1', port)) as connection:
                connection.sendall(request_text.encode())
                # Closed by a reset instead of an orderly end.
                linger = struct.pack('ii', 1, 0)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        deadline = time.monotonic() + LIMIT
        while threading.active_count() > before + 1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert capfd.readouterr() == ('', '')


# ---- The figures ----


@pytest.fixture(scope='module')
def replayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Estimate]]:
    """A bag of results of the four-bar, in which nothing is for pages, and its estimates."""
    bag, found = tmp_path_factory.mktemp('view') / 'replayed.mcap', []
    replay(BAG, load_settings(ROOT / 'config' / 'four_bar.yaml'), bag, take=found.append)
    return bag, found


@pytest.fixture(scope='module')
def estimates(replayed) -> list[Estimate]:
    """What a node estimates of the four-bar."""
    return replayed[1]


@pytest.fixture(scope='module')
def results(replayed) -> Path:
    """What a node sends to pages, and its diagnostics, as a bag."""
    bag, estimates = replayed
    output = bag.with_name('results.mcap')
    made = [
        (stamp, f'/kinpole/{VIEW}', String, message(view_of(block[k], XY)))
        for block in estimates
        for k, stamp in enumerate(block.stamp.tolist())
    ]
    others = read_messages(bag, ['/diagnostics', '/kinpole/visualization'])
    made += [(m.log_time, m.topic, m.type_name, m.data) for m in others]
    with BagWriter(output) as writer:
        for log_time, topic, kind, data in sorted(made, key=lambda row: row[0]):
            writer.write_raw(topic, kind, data, log_time)
    return output


def test_figures_are_those_of_the_estimate_and_no_more(estimates) -> None:
    block, k = estimates[-1], -1
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml')
    when, (data,) = live_outputs(settings, None)[-1].build(block)
    assert when == [len(block) - 1]
    frame = frame_of_view(data)
    assert frame.stamp == block.stamp[k]
    assert frame.rig.bodies == ('crank', 'coupler', 'rocker')
    withheld = 0
    for b, body in enumerate(frame.bodies):
        assert body is not None
        place = block.origin(0)[k, b]
        np.testing.assert_allclose([body['x'], body['y']], [place.real, place.imag], rtol=1e-6)
        for order, (rate, pole) in enumerate(zip(RATE_NAMES, POLE_NAMES, strict=True), 1):
            value, variance, _ = (part[k, b] for part in block.rate(order))
            np.testing.assert_allclose(body[rate], [value, np.sqrt(variance)], rtol=1e-6)
            value, covariance, known = (part[k, b] for part in block.pole(order))
            assert known == (body[pole] is not None)
            withheld += not known
            if known:
                x, y, major, minor, direction = body[pole]
                turn = np.exp(1j * direction)
                axes = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
                ellipse = axes @ np.diag([major**2, minor**2]) @ axes.T
                np.testing.assert_allclose([x, y], [value.real, value.imag], rtol=1e-6)
                least = 1e-6 * np.trace(covariance)
                np.testing.assert_allclose(ellipse, covariance, atol=least)
        assert (body['centrode_curvature'] is not None) == block.centrode_curvature.determined[k, b]
    assert withheld
    for b, reasons in enumerate(frame.reasons):
        said = block[k].reasons(b)
        assert reasons == {'' if name == 'all' else name: why for name, why in said.items()}
        lacking = {name for name in POLE_NAMES if frame.bodies[b][name] is None}
        assert lacking <= reasons.keys()
    for center, value in zip(frame.pairs, block.relative_icr.value[k], strict=True):
        assert center is not None
        np.testing.assert_allclose(center[:2], [value.real, value.imag], rtol=1e-6)


def message(said: Any) -> bytes:
    return serialize_message(String(data=said if isinstance(said, str) else json.dumps(said)))


def test_what_is_no_message_to_pages_is_refused(estimates) -> None:
    good = view_of(estimates[0][0], XY)
    frame_of_view(message(good))

    def with_body(**figures: Any) -> dict[str, Any]:
        return {**good, 'bodies': [{**good['bodies'][0], **figures}, *good['bodies'][1:]]}

    wrong: list[Any] = [
        '{',
        '[' * 10_000,
        '3',
        '[]',
        {**good, 'stamp': -1},
        {**good, 'stamp': 1e300},
        {**good, 'along': ['x']},
        {**good, 'bodies': 3},
        {**good, 'pairs': [{'bodies': ['crank', 'nobody'], 'icr': None}]},
        with_body(x='here'),
        with_body(x=float('nan')),
        with_body(icr=[1.0, 2.0]),
        with_body(icr=3.0),
        with_body(outline=[[1.0]]),
        with_body(size=None),
    ]
    for said in wrong:
        with pytest.raises(ValueError):
            frame_of_view(message(said))


def test_an_instant_without_a_velocity_is_sent_without_that_body(estimates) -> None:
    instant = estimates[-1][-1]
    position = instant.position.copy()
    position[1, 0] = np.nan
    vars(instant)['position'] = position
    frame = frame_of_view(message(view_of(instant, XY)))
    assert [body is not None for body in frame.bodies] == [False, True, True]


def test_coordinates_far_from_the_origin_keep_micrometers(estimates) -> None:
    instant = estimates[-1][-1]
    position = instant.position.copy()
    position[0] += 5e6 - 2e6j
    vars(instant)['position'] = position
    body, origin = view_of(instant, XY)['bodies'][0], instant.origin(0)[0]
    assert abs(body['x'] + 1j * body['y'] - origin) < 1e-6


def test_a_vector_of_no_length_is_as_uncertain_as_in_its_worst_direction() -> None:
    covariance = np.array([[[2.0, 1.0], [1.0, 2.0]]])
    vectors = Vectors(np.zeros(1, complex), covariance, np.ones(1, bool))
    assert quantity_lists({'icr_velocity': vectors}) == {
        'icr_velocity': [[0.0, 0.0, pytest.approx(np.sqrt(3), abs=1e-6)]]
    }


def test_more_bodies_than_a_page_can_show_are_refused_and_told_of(estimates) -> None:
    good = view_of(estimates[0][0], XY)
    bodies = [{**good['bodies'][0], 'name': f'body_{k}'} for k in range(5000)]
    pair = {'bodies': ['body_0', 'body_1'], 'icr': None}
    frame_of_view(message({**good, 'bodies': bodies[:200], 'pairs': [pair] * 200}))
    for said, complaint in (
        ({**good, 'bodies': bodies[:201], 'pairs': []}, '201 bodies and 0 pairs of them; a page'),
        ({**good, 'bodies': bodies[:2], 'pairs': [pair] * 201}, '2 bodies and 201 pairs of them'),
        ({**good, 'bodies': bodies}, r'\d{7} bytes; a page takes 1048576 at most'),
        (' ' * 2_000_000, r'2000009 bytes'),
    ):
        with pytest.raises(ValueError, match=complaint):
            frame_of_view(message(said))


class Scripted:
    """Stands for the watcher: nodes that are there, and what came from them."""

    def __init__(self, names: Sequence[str] = ('/kinpole',), topic: str = VIEW) -> None:
        self._nodes = dict.fromkeys(names, topic)
        self.newest: dict[str, deque[Any]] = {}

    def nodes(self) -> dict[str, str]:
        return self._nodes

    def want(self, topics: dict[str, str]) -> None:
        self.newest = {topic: self.newest.get(topic, deque(maxlen=4)) for topic in topics}

    def wait(self, seconds: float) -> None:
        pass


class Told:
    """Stands for the feed: one page is open, and this is what it was told."""

    def __init__(self) -> None:
        self.rigs: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []

    def wait_for_page(self, seconds: float) -> bool:
        return True

    def put(self, kind: str, data: str) -> None:
        (self.rigs if kind == 'rig' else self.frames).append(json.loads(data))


def live_of(watcher: Scripted, chosen: str = '') -> tuple[Live, Told]:
    """What shows a node of the watcher, with how things stand told."""
    told = Told()
    live = Live(cast(Any, watcher), cast(Any, told), chosen)
    live.step()
    return live, told


def step_until(live: Live, condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline
        live.step()


def test_what_is_no_message_is_told_of_and_what_follows_is_shown(results) -> None:
    watcher = Scripted()
    live, told = live_of(watcher)
    assert told.rigs[-1]['waiting'].startswith(f'waiting for data on /kinpole/{VIEW}: ')
    arrived = watcher.newest[f'/kinpole/{VIEW}']
    good = sent_to_pages(results)[0]
    for data in (b'', good[:40], b'\0\1' + bytes(30)):
        arrived.append(Arrived(data, 0))
        live.step()
    step_until(live, lambda: 'cannot be read' in told.rigs[-1]['waiting'])
    assert told.frames == []
    arrived.append(Arrived(good, 0))
    live.step()
    assert told.rigs[-1]['title'] == '/kinpole'
    assert [body is not None for body in told.frames[0]['bodies']] == [True, True, True]
    arrived.append(Arrived(good[:40], 0))
    step_until(live, lambda: told.rigs[-1]['notes'])
    assert told.rigs[-1]['notes'][0].startswith('a message cannot be read: ')


def test_of_several_nodes_the_chosen_one_is_shown_and_others_are_named(results) -> None:
    data = sent_to_pages(results)[0]
    for chosen, shown in (('', 'a'), ('b', 'b'), ('/b/kinpole/', 'b'), ('b/kinpole/crank', 'b')):
        watcher = Scripted(('/a/kinpole', '/b/kinpole'))
        live, told = live_of(watcher, chosen)
        watcher.newest[f'/{shown}/kinpole/{VIEW}'].append(Arrived(data, 0))
        live.step()
        assert told.rigs[-1]['title'] == f'/{shown}/kinpole'
        assert ('/b/kinpole' in told.rigs[-1]['about']) == (not chosen)
    _, told = live_of(watcher, 'none')
    assert 'under /none ' in told.rigs[-1]['waiting']


def sent_to_pages(results: Path) -> list[bytes]:
    return [message.data for message in read_messages(results, [f'/kinpole/{VIEW}'])]


def test_a_bag_of_results_is_shown_by_its_topic_state(replayed) -> None:
    bag, estimates = replayed
    watcher = Scripted(topic=STATE)
    live, told = live_of(watcher)
    (state, *_), (rig, *_) = (
        [message.data for message in read_messages(bag, [topic])][-1:]
        for topic in (f'/kinpole/{STATE}', '/kinpole/rig')
    )
    watcher.newest[f'/kinpole/{STATE}'].append(Arrived(state, 0))
    live.step()
    step_until(live, lambda: 'no message `rig` has named' in told.rigs[-1].get('waiting', ''))
    assert told.frames == []
    watcher.newest['/kinpole/rig'].append(Arrived(rig, 0))
    watcher.newest[f'/kinpole/{STATE}'].append(Arrived(state, 0))
    live.step()
    assert [body['name'] for body in told.rigs[-1]['bodies']] == ['crank', 'coupler', 'rocker']
    (frame,) = told.frames
    said = view_of(estimates[-1][-1], XY)
    expected = frame_of_view(message(said))
    assert frame['reasons'] == expected.reasons
    assert all(body['outline'] and body['size'] for body in told.rigs[-1]['bodies'])
    for body, other in zip(frame['bodies'], expected.bodies, strict=True):
        assert other is not None
        assert body.keys() == other.keys()
        # Ball's point is in the node's message for pages only.
        del body['ball_point']
        for name, value in other.items():
            if name == 'ball_point':
                continue
            assert (body[name] is None) == (value is None), name
            if value is not None:
                np.testing.assert_allclose(body[name], value, rtol=1e-4, atol=1e-7, err_msg=name)


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


def test_page_says_that_it_is_connecting_until_it_hears_of_a_node(browser) -> None:
    feed = Feed()
    with served(feed) as address, opened(browser, address) as page:
        page.locator('#about', has_text='connecting').wait_for()
        feed.put('rig', json.dumps({'waiting': 'waiting for data on /kinpole/view'}))
        page.locator('#about', has_text='waiting for data on').wait_for()
        assert not page.locator('main').is_visible()


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
                await_color(page, '#stage canvas', color, above=100)
                await_color(page, '[data-name=angular_velocity] canvas', color, above=20)
            value, spread = cell(page, 'angular_velocity', 0).split('±')
            assert abs(float(value) - 2 * np.pi) < 3 * float(spread) < 0.3
            # One topic is asked for, whatever is shown.
            await_readers(watcher, f'/kinpole/{VIEW}', True)
            page.locator('#values [data-name=angular_jerk] td', has_text='±').first.wait_for()
            assert not page.locator('.chart[data-name=angular_jerk]').is_visible()
            page.locator('#rates button', has_text='jerk').click()
            page.locator('.chart[data-name=angular_jerk]').wait_for()
            await_color(page, '[data-name=angular_jerk] canvas', BLUE, above=20)
            # The last seconds can be looked through, and nothing is asked for meanwhile.
            page.keyboard.press('l')
            await_readers(watcher, f'/kinpole/{VIEW}', False)
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
        await_readers(watcher, f'/kinpole/{VIEW}', False)
        view.send_signal(signal.SIGTERM)
        assert view.wait(LIMIT) == 0


def test_page_shows_a_bag_of_results_that_is_played(browser, replayed, watcher) -> None:
    command = [sys.executable, '-m', 'kinpole_ros.tools.cli', 'view']
    with ExitStack() as closing:
        view = closing.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        closing.callback(view.kill)
        assert view.stdout is not None
        (address,) = re.findall(r'http://\S+', view.stdout.readline())
        with played(replayed[0]):
            page = closing.enter_context(opened(browser, address))
            page.wait_for_selector('html[data-ready]')
            await_motion(page)
            page.locator('#about', has_text='markers at 100 Hz').wait_for()
            await_readers(watcher, f'/kinpole/{STATE}', True)
            # A body is a circle there, for its outline is not known.
            for color in (BLUE, RED, GREEN):
                await_color(page, '#stage canvas', color, above=0)
                await_color(page, '[data-name=angular_velocity] canvas', color, above=20)
            value, spread = cell(page, 'angular_velocity', 0).split('±')
            assert abs(float(value) - 2 * np.pi) < 3 * float(spread) < 0.3
        view.send_signal(signal.SIGTERM)
        assert view.wait(LIMIT) == 0


def test_page_goes_on_when_the_server_is_back_and_begins_anew_with_other_bodies(
    browser, results
) -> None:
    state, port = RigState('/kinpole', VIEW), 0
    with ExitStack() as closing:
        for data, at in zip(sent_to_pages(results)[50:], (0.5, 1.25), strict=False):
            frame = frame_of_view(data)
            state.add_frame(frame)
            feed = Feed()
            with served(feed, port) as address:
                if not port:
                    port = int(re.findall(r':(\d+)/', address)[0])
                    page = closing.enter_context(opened(browser, address))
                feed.wait_for_page(LIMIT)
                feed.put('rig', state.as_json(frame.rig, 0.0, []))
                feed.put('frame', frame.as_json(at, 0))
                page.locator('#clock', has_text=f't = {at:.3f} s').wait_for()
                assert page.locator('#state').inner_text() == ''
                if at > 1:
                    # A node with other bodies is another page.
                    other = frame.rig._replace(bodies=('rod',), pairs=())
                    feed.put('rig', state.as_json(other, 0.0, []))
                    page.locator('#bodies', has_text='rod').wait_for()
            page.locator('#state', has_text='disconnected').wait_for()


def test_time_and_numbers_are_of_one_frame_while_they_come_and_when_the_page_is_paused(
    browser, results
) -> None:
    """The numbers were up to two frames older than the time."""
    state, feed = RigState('/kinpole', VIEW), Feed()
    frame = frame_of_view(next(iter(sent_to_pages(results)[50:])))
    state.add_frame(frame)
    # A rate that tells the time.
    look = """() => {
      const names = ['#clock', '[data-name=angular_velocity] td'];
      const found = names.map((name) => document.querySelector(name));
      return found.map(({ textContent }) => parseFloat(textContent.replace('t = ', '')));
    }"""
    with served(feed) as address, opened(browser, address) as page:
        feed.wait_for_page(LIMIT)
        feed.put('rig', state.as_json(frame.rig, 0.0, []))
        for n in range(20):
            at = 1 + n / 32
            assert frame.bodies[0] is not None
            body = frame.bodies[0] | {'angular_velocity': [at, 1e-5]}
            feed.put('frame', frame._replace(bodies=[body, *frame.bodies[1:]]).as_json(at, n))
            drawn = 'n => document.documentElement.dataset.published == n'
            page.wait_for_function(drawn, arg=n / 1e6)
            shown, number = page.evaluate(look)
            assert abs(shown - number) < 1e-3
        page.keyboard.press('l')
        page.locator('#clock', has_text='t = 1.594 s').wait_for()
        shown, number = page.evaluate(look)
        assert abs(shown - number) < 1e-3
