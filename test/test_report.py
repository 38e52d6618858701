"""Reports: the figures in the page are those of the replay, and a browser shows them so."""

import base64
import copy
import itertools
import json
import os
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_layouts_of_trackers import openpose

from kinpole_ros import planar
from kinpole_ros.bags import (
    BagError,
    BagWriter,
    message_class,
    read_messages,
    replay,
    simulate,
)
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import RECEIVED, RESTARTS, DiagnosticArray
from kinpole_ros.messages._types import DiagnosticStatus, KeyValue, Odometry
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.record.diagnostics_log import DiagnosticsLog
from kinpole_ros.tools.report import _record_page, report, settings_for
from kinpole_ros.tools.report._collector import Collector, theory_rates
from kinpole_ros.tracking.reasons import SLOW_ICR
from kinpole_ros.tracking.values import RATE_NAMES

ROOT = Path(__file__).parents[1]
BAG = ROOT / 'bags' / 'four_bar.mcap'


@pytest.fixture(scope='module')
def made(tmp_path_factory) -> Path:
    """The report of a four-bar."""
    # No name that HTML or a regular expression would take for something else.
    output = tmp_path_factory.mktemp('report') / 'four <b>bar.html'
    report(BAG, output, load_settings(ROOT / 'config' / 'four_bar.yaml'))
    return output


@pytest.fixture(scope='module')
def blocks() -> list[Any]:
    """The estimates it is made of."""
    found: list[Any] = []
    replay(BAG, load_settings(ROOT / 'config' / 'four_bar.yaml'), take=found.append)
    return found


def data_of(made: Path) -> dict[str, Any]:
    (text,) = re.findall(r'<script id="data"[^>]*>([^<]*)</script>', made.read_text())
    data: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(text)))
    return data


def test_report_of_four_seconds_is_one_file_under_250_kB(made) -> None:
    assert made.stat().st_size < 250_000
    text = made.read_text()
    assert not re.search(r'(src|href)\s*=|https?://|@import|url\(', text.split('<script id')[0])


def test_figures_are_those_of_the_replay_to_a_tenth_of_their_deviation(made, blocks) -> None:
    data = data_of(made)
    assert len(data['t']) == sum(map(len, blocks)) == data['total']
    for b, body in enumerate(data['bodies']):
        for name, order in (('angular_velocity', 1), ('angular_snap', 4)):
            rates = [block.rate(order) for block in blocks]
            sigma = np.sqrt(np.concatenate([rate.variance[:, b] for rate in rates]))
            value = np.concatenate([rate.value[:, b] for rate in rates])
            shown = np.array(body[name]['value'], float)
            assert (np.abs(shown - value) <= 0.06 * sigma).all()
            np.testing.assert_allclose(np.array(body[name]['sigma'], float), sigma, rtol=0.06)
        poles = [block.pole(2) for block in blocks]
        known = np.concatenate([pole.determined[:, b] for pole in poles])
        shown = np.array([x is not None for x in body['iap']['x']])
        np.testing.assert_array_equal(shown, known)
        # What is not shown has its reason, and nothing else has.
        withheld = np.zeros(len(known), bool)
        for start, end, reason in body['withheld']['iap']:
            assert reason
            withheld[start:end] = True
        np.testing.assert_array_equal(withheld, ~known)


def test_pins_are_found_and_nothing_else(made) -> None:
    joints = [joint['bodies'] for joint in data_of(made)['joints']]
    assert joints == [['crank'], ['rocker'], ['coupler', 'crank'], ['rocker', 'coupler']]


@pytest.mark.parametrize(
    'value, sigma, expected',
    [
        (1.23456, 0.01, 1.235),
        (-123456.0, 3000.0, -123500.0),
        (0.00012345, 1e-12, 0.00012345),
        (np.nan, 1.0, None),
    ],
)
def test_figures_are_rounded_by_their_deviation(value, sigma, expected) -> None:
    assert _record_page.rounded(np.array([value]), np.array([sigma])) == [expected]


@pytest.fixture(scope='module')
def gappy(tmp_path_factory) -> Path:
    """The markers of the four-bar without 170 frames, and without one more."""
    bag = tmp_path_factory.mktemp('gappy') / 'gappy.mcap'
    with BagWriter(bag) as writer:
        for k, message in enumerate(read_messages(BAG, ['/markers'])):
            if not 100 <= k < 270 and k != 300:
                cls = message_class(message.type_name)
                writer.write_raw('/markers', cls, message.data, message.log_time)
    return bag


def test_lost_frames_are_no_undetermined_ones(gappy, tmp_path, capsys) -> None:
    output = tmp_path / 'gap.html'
    config = str(ROOT / 'config' / 'four_bar.yaml')
    assert main(['report', str(gappy), '--config', config, '--output', str(output)]) == 0
    assert '; 181 frames lost' in capsys.readouterr().out
    from_markers = data_of(output)
    replay(gappy, load_settings(config), tmp_path / 'results.mcap')
    report(tmp_path / 'results.mcap', output, Settings())
    for data in from_markers, data_of(output):
        assert ' at 100 Hz, 181 frames lost' in data['about']
        # The 10 frames of the lag before the gap have no results either. Both ends of the gap and
        # the single frame are without a value, so no line crosses them.
        spans = [(data['t'][start], data['t'][end - 1]) for start, end, _ in data['lost']]
        np.testing.assert_allclose(spans, [(0.9, 2.69), (3.0, 3.0)], atol=1e-6)
        for body in data['bodies']:
            assert not any('lost:' in reason for _, _, reason in body['missing'])
            for start, end, _ in data['lost']:
                assert body['x'][start:end] == [None] * (end - start)


def test_long_recordings_are_thinned_evenly_and_say_so(blocks) -> None:
    collector = Collector(100)
    for block in blocks:
        for k in range(0, len(block), 7):
            collector.add(block[k : k + 7])
    kept = collector.record(('x', 'y'))
    stamps = np.concatenate([block.stamp for block in blocks])
    assert kept.total == len(stamps)
    np.testing.assert_array_equal(kept.stamp, stamps[::4])
    value = np.concatenate([block.rate(1).value[:, 2] for block in blocks])
    np.testing.assert_array_equal(kept.columns['rocker', 'angular_velocity'], value[::4])


def test_report_of_results_is_that_of_their_markers(made, tmp_path) -> None:
    # With the relative centers of all pairs.
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml', changes={'topics': 'all'})
    results, output = tmp_path / 'results.mcap', tmp_path / 'results.html'
    replay(BAG, settings, results)
    report(results, output, Settings())
    shown, expected = data_of(output), data_of(made)
    assert shown['t'] == expected['t']
    for one, other in zip(shown['bodies'], expected['bodies'], strict=True):
        for name in ('vx', 'vy', 'x', 'y'):
            np.testing.assert_allclose(one[name], other[name], atol=1e-4, err_msg=name)
        assert one['angular_velocity'] == other['angular_velocity']
        assert one['ijp'] == other['ijp']
        numbers = [np.array(body['angular_snap']['value']) for body in (one, other)]
        sigma = np.array(other['angular_snap']['sigma'])
        assert (np.abs(numbers[0] - numbers[1]) < 0.2 * sigma).all()
    icr = [
        np.array([one is None for one in data['pairs'][1]['icr']['x']])
        for data in (shown, expected)
    ]
    np.testing.assert_array_equal(*icr)
    assert [joint['bodies'] for joint in shown['joints']] == [
        ['crank'],
        ['rocker'],
        ['coupler', 'crank'],
        ['rocker', 'coupler'],
    ]
    # Drawn with their markers, about where they are in the frame of the body.
    for one, other in zip(shown['bodies'], expected['bodies'], strict=True):
        ((_, found),), ((_, markers),) = one['outlines'], other['outlines']
        assert len(found) == len(markers)
        away = np.abs(_complex(found)[:, None] - _complex(markers)).min(axis=1)
        assert away.max() < 1e-3
    for one, other in zip(shown['pairs'], expected['pairs'], strict=True):
        parts = [[pair['icr'][half] for half in 'ab'] for pair in (one, other)]
        spread = [np.hypot(*np.array(part, float)) for part in parts]
        np.testing.assert_allclose(*spread, rtol=0.1)
    # As its diagnostics said.
    with pytest.raises(BagError, match='give the bag of markers'):
        report(results, output, settings_for(settings, 'four_bar'))
    reasons = {reason for _, _, reason in shown['bodies'][1]['withheld']['isp']}
    assert 'lost in its noise' in reasons


def _complex(points: list[list[float]]) -> np.ndarray:
    return np.array([complex(*point) for point in points])


@pytest.mark.parametrize(
    'counts, expected',
    [
        ([(10, 0), (20, 0)], False),
        ([(10, 0), (20, 1)], True),
        # Told to relearn.
        ([(10, 0), (5, 0)], True),
    ],
)
def test_outlines_drawn_last_are_of_a_bag_in_which_nothing_was_learned_anew(
    counts, expected
) -> None:
    log = DiagnosticsLog()
    for received, restarts in counts:
        told = {RECEIVED: received, f'{RESTARTS} after a jump of the stamps': restarts}
        values = [KeyValue(key=key, value=str(value)) for key, value in told.items()]
        status = DiagnosticStatus(name='kinpole: markers', values=values)
        log.add(DiagnosticArray(status=[status]))
    assert log.restarted == expected


def test_markers_beside_the_odometry_of_a_robot_are_replayed(tmp_path) -> None:
    """Any odometry passed for results."""
    bag, output = tmp_path / 'rig.mcap', tmp_path / 'rig.html'
    with BagWriter(bag) as writer:
        writer.add_topic('/robot/odom', Odometry)
        for message in read_messages(BAG, ['/markers']):
            writer.write_raw(message.topic, message.type_name, message.data, message.log_time)
    record = report(bag, output, load_settings(ROOT / 'config' / 'four_bar.yaml'))
    assert record.bodies == ('crank', 'coupler', 'rocker')


def test_scene_names_the_bodies_unless_a_file_does() -> None:
    scene = settings_for(Settings(), 'four_bar')
    assert list(scene.bodies) == ['crank', 'coupler', 'rocker']
    given = Settings(bodies={'crank': ('crank_1', 'crank_2')})
    assert settings_for(given, 'four_bar').bodies == given.bodies


def test_theory_of_the_scene_lies_in_the_bands_of_the_measurement(tmp_path) -> None:
    output = tmp_path / 'a.html'
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml')
    report(BAG, output, settings_for(settings, 'four_bar'))
    data = data_of(output)
    assert (data['scene'], data['bodies'][0]['theory']) == ('four_bar', {})
    for body in data['bodies'][1:]:
        for name, theory in body['theory'].items():
            off = np.array(body[name]['value']) - np.array(theory, float)
            assert np.isfinite(off).all()
            assert np.median(np.abs(off / np.array(body[name]['sigma']))) < 1.5, name
        assert list(body['theory']) == list(RATE_NAMES)
    assert [row[0] for row in data['deviations']] == ['O', 'C', 'A', 'B']


def test_theory_does_not_depend_on_how_the_frames_of_bodies_lie(blocks) -> None:
    theory = load_theory(settings_for(Settings(), 'four_bar'))
    assert theory is not None
    turned = copy.copy(blocks[-1])
    angle = turned.angle.copy()
    angle[0] += 1.0
    vars(turned).update(angle=angle, shape=turned.shape * np.exp(-1j))
    expected = theory_rates(theory, blocks[-1])
    for body, rates in theory_rates(theory, turned).items():
        np.testing.assert_allclose(rates, expected[body], rtol=1e-6, atol=1e-6)


def test_report_refuses_in_one_line_what_it_cannot_show(tmp_path, capsys) -> None:
    output = str(tmp_path / 'a.html')
    assert main(['report', str(tmp_path / 'none.mcap'), '--output', output]) == 2
    assert main(['report', str(BAG), '--output', str(BAG)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
    assert not os.path.exists(output)
    with pytest.raises(BagError, match='no results'):
        report(BAG, output, Settings(window=1.0, lag=100.0))


@pytest.mark.parametrize('name', ['a.pdf', 'a', 'a.mcap'])
def test_a_report_under_a_name_that_browsers_do_not_open_is_refused(tmp_path, capsys, name) -> None:
    assert main(['report', str(BAG), '--output', str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f'{name}: the output is an HTML page; end its name in .html or .htm')
    assert not (tmp_path / name).exists()


def test_a_report_of_a_bag_finds_its_bodies(tmp_path, capsys) -> None:
    output = tmp_path / 'a.html'
    assert main(['report', str(BAG), '--output', str(output), '--set', 'window:=0.2']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(':')[0] for line in lines[:3]] == ['plane', 'unit', 'bodies']
    assert 'crank of' in lines[2]
    assert f'kinpole discover {BAG} --output rig.yaml' in lines[2]
    assert lines[3].startswith('window 0.2 s')


def test_a_report_of_a_table_imports_it(tmp_path, capsys) -> None:
    t = np.arange(300) / 100
    rows = np.stack((t, 100 * np.cos(5 * t), 100 * np.sin(5 * t), 0 * t, 0 * t), axis=1)
    table, output = tmp_path / 'film.csv', tmp_path / 'a.html'
    np.savetxt(table, rows, delimiter=',', header='t,tip_x,tip_y,hub_x,hub_y', comments='')
    words = ['report', str(table), '--scale', '0.001', '--output', str(output)]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(
        'file: 300 frames of 2 markers (table, 1 unit = 0.001 m), 2.99 s at 100 Hz'
    )
    assert len([line for line in lines if 'to change: ' in line]) == 5
    assert output.exists()


def test_a_report_of_a_folder_of_openpose_imports_it(tmp_path, capsys) -> None:
    folder = openpose(tmp_path / 'json')
    words = ['--rate', '50', '--scale', '0.001', '--output', str(tmp_path / 'page.html')]
    assert main(['report', str(folder), *words]) == 2
    # Its frames were read, and are too few.
    assert f'{folder}: no results, since a frame has one when' in capsys.readouterr().err


def test_a_report_prints_what_discover_prints_of_markers_in_no_body(tmp_path, capsys) -> None:
    """As where the columns of two markers are exchanged in a table."""
    t = np.arange(400) / 200
    arm, rod = np.exp(3j * t), np.exp(2j * np.sin(4 * t))
    places = [0.1 * arm, 0.1j * arm, -0.1 * arm, 1 + 0.1 * rod, 1 + 0.1j * rod, 1 - 0.1 * rod]
    noise = np.random.default_rng(0).normal(size=(400, 12), scale=1e-4)
    columns = np.stack([part for one in places for part in (one.real, one.imag)], axis=1) + noise
    titles = ['t', *(f'{name}_{axis}' for name in 'abcdef' for axis in 'xy')]
    titles[1], titles[3] = titles[3], titles[1]
    table, bag = tmp_path / 'film.csv', tmp_path / 'film.mcap'
    rows = np.column_stack((t, columns))
    np.savetxt(table, rows, delimiter=',', header=','.join(titles), comments='')
    assert main(['import', str(table), '--output', str(bag)]) == 0
    assert main(['discover', str(bag)]) == 0
    (line,) = (
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith('markers of no body: ')
    )
    for file in table, bag:
        assert main(['report', str(file), '--output', str(tmp_path / 'a.html')]) == 0
        assert line in capsys.readouterr().out.splitlines()


@pytest.mark.parametrize('words', [['--rate', '50'], ['--scale', '0.1'], ['--no-y-down']])
def test_a_report_of_a_bag_refuses_what_only_files_of_points_lack(tmp_path, capsys, words) -> None:
    bag = tmp_path / 'a.mcap'
    simulate(load_scene('four_bar'), bag, duration=0.5)
    assert main(['report', str(bag), *words, '--output', str(tmp_path / 'a.html')]) == 2
    option = words[0].replace('--no-', '--')
    assert re.search(
        rf'is a bag, .*; {option} are for files of points; fix: ', capsys.readouterr().err
    )
    assert not (tmp_path / 'a.html').exists()


def test_a_report_says_that_it_took_all_markers_as_one_body(tmp_path, capsys) -> None:
    t = np.arange(300) / 100
    rows = np.stack((t, np.cos(5 * t), np.sin(5 * t), 0.5 * np.sin(2 * t), np.cos(3 * t)), axis=1)
    table, output = tmp_path / 'loose.csv', tmp_path / 'a.html'
    np.savetxt(table, rows, delimiter=',', header='t,a_x,a_y,b_x,b_y', comments='')
    assert main(['report', str(table), '--scale', '1', '--output', str(output)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith('bodies: not found: ') for line in lines)
    assumption = next(line for line in lines if 'one rigid' in line)
    assert 'all 2 markers are taken as one rigid body, "body"' in assumption
    assert f'kinpole discover {table} --output rig.yaml' in assumption
    assert data_of(output)['notes'][0] == assumption
    config = str(ROOT / 'config' / 'four_bar.yaml')
    assert main(['report', str(BAG), '--config', config, '--output', str(output)]) == 0
    assert 'one rigid body' not in capsys.readouterr().out + output.read_text()
    assert not [note for note in data_of(output)['notes'] if 'one rigid body, ' in note]


# ---- In a browser ----


@pytest.fixture(scope='module')
def long(tmp_path_factory) -> Path:
    """The report of seven bodies that swing 15 times in 30 s."""
    folder = tmp_path_factory.mktemp('long')
    bag, output = folder / 'eight.mcap', folder / 'eight.html'
    simulate(load_scene('eight_bar'), bag, rate=50.0, duration=30.0, noise=1e-4)
    report(bag, output, settings_for(Settings(derivative_order=1), 'eight_bar'))
    return output


@pytest.fixture
def opened(browser, made) -> Iterator[Any]:
    """`opened(width, height)` is a page with the report at 1.1 s; no error, no request."""
    troubles: list[str] = []
    contexts = []

    def open_page(
        width: int = 1280,
        height: int = 800,
        at: str = '#t=1.1',
        file: Path = made,
        **more: Any,
    ) -> Any:
        context = browser.new_context(viewport={'width': width, 'height': height}, **more)
        contexts.append(context)
        page = context.new_page()
        page.on('console', lambda message: troubles.append(message.text))
        page.on('pageerror', lambda error: troubles.append(str(error)))
        page.on('request', lambda request: troubles.append(request.url))
        page.goto(file.as_uri() + at)
        page.wait_for_selector('html[data-ready]')
        drawn(page)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [text for text in troubles if not text.startswith('file://')] == []


def drawn(page: Any) -> None:
    """Wait until all is drawn that was asked for."""
    page.evaluate('new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))')


COUNT_PIXELS = """([selector, color]) => [...document.querySelectorAll(selector)].reduce(
    (sum, canvas) => {
      const copy = new OffscreenCanvas(canvas.width, canvas.height);
      const context = copy.getContext('2d', { willReadFrequently: true });
      context.drawImage(canvas, 0, 0);
      const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
      const wanted = [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
      for (let k = 0; k < data.length; k += 4) {
        if (data[k + 3] > 250 && wanted.every((w, c) => Math.abs(w - data[k + c]) < 8)) sum++;
      }
      return sum;
    }, 0)"""


def colored(page: Any, selector: str, color: str) -> int:
    """Count the pixels near the color in all canvases of the selected elements."""
    count: int = page.evaluate(COUNT_PIXELS, [selector, color])
    return count


def await_color(page: Any, selector: str, color: str, above: int) -> None:
    """Wait until more than `above` pixels are near the color: a live page redraws all the time."""
    page.wait_for_function(f'(a) => ({COUNT_PIXELS})(a) > {above}', arg=[selector, color])


def cell(page: Any, name: str, column: int) -> str:
    text: str = page.locator(f'#values tr[data-name={name}] td').nth(column).inner_text()
    return text.replace('−', '-')


BLUE, RED, GREEN = '#0072b2', '#d55e00', '#007a5a'


def test_page_shows_the_linkage_its_curves_and_the_figures_at_the_cursor(opened) -> None:
    page = opened()
    assert page.locator('h1').inner_text() == 'four_bar.mcap'
    assert page.locator('#clock').inner_text() == 't = 1.100 s'
    for color in (BLUE, RED, GREEN):
        assert colored(page, '#stage canvas', color) > 100
        assert colored(page, '[data-name=angular_velocity] canvas', color) > 40
    # All of the first chart and the stage are on the first screen.
    for selector in ('#stage', '#transport', '.chart[data-name=angular_velocity]'):
        box = page.locator(selector).bounding_box()
        assert box['y'] + box['height'] <= 800, selector
    value, spread = cell(page, 'angular_velocity', 0).split('±')
    assert abs(float(value) - 2 * np.pi) < float(spread) < 0.1
    assert cell(page, 'icr', 2) == 'no rotation'
    assert cell(page, 'centrode_curvature', 0) == 'pinned: the ICR stands still'
    assert '0.5% lost in its noise' in page.locator('#withheld').inner_text()
    strips = page.locator('[data-name=withheld]')
    strips.scroll_into_view_if_needed()
    assert 'pinned: the ICR stands still' in strips.inner_text()
    assert SLOW_ICR in strips.inner_text()
    # Two whole strips, of the crank and nearly of the rocker: first not known, then on a pin.
    width = strips.bounding_box()['width'] - 58 - 92
    unknown, pinned = (
        colored(page, '[data-name=withheld] canvas', color) / (13 * width)
        for color in ('#d9a441', '#7d6aa8')
    )
    assert pinned > 1
    assert 1.9 < unknown + pinned <= 2


def test_charts_of_a_long_run_open_at_as_much_time_as_can_be_read(opened, long) -> None:
    """Twelve swings, about the cursor; all of the time is a key away."""
    page = opened(file=long)
    assert re.fullmatch(r'0\.0 to 2[34]\.\d of 29\.\d s; .*', page.locator('#range').inner_text())
    page.locator('#scrub').fill('1400')
    drawn(page)
    assert re.fullmatch(r'\d\.\d to 29\.\d of 29\.\d s; .*', page.locator('#range').inner_text())
    page.locator('#fit').click()
    assert page.locator('#range').inner_text() == ''
    assert opened().locator('#range').inner_text() == ''


@pytest.mark.parametrize('width', [1280, 390])
def test_a_table_that_is_cut_says_so(opened, long, width) -> None:
    hint = opened(width, file=long).locator('#values .cut')
    assert hint.is_visible()
    assert 'scroll' in hint.inner_text()
    assert opened(1280).locator('#values .cut').is_hidden()


def test_names_at_the_ends_of_lines_keep_off_the_numbers_of_the_time_axis(opened, long) -> None:
    page = opened(file=long)
    # Pixels right of the lines and beside the numbers that are not gray, as only names are.
    code = """() => {
      const canvas = document.querySelector('[data-name=angular_velocity] canvas');
      const scale = canvas.width / canvas.clientWidth;
      const [left, top] = [canvas.clientWidth - 90, canvas.clientHeight - 14].map((v) => v * scale);
      const { data } = canvas.getContext('2d').getImageData(
        left, top, canvas.width - left, canvas.height - top);
      let colored = 0;
      for (let k = 0; k < data.length; k += 4) {
        const part = [data[k], data[k + 1], data[k + 2]];
        if (data[k + 3] > 100 && Math.max(...part) - Math.min(...part) > 60) colored++;
      }
      return colored;
    }"""
    assert page.evaluate(code) == 0


def test_keys_buttons_slider_and_chart_move_one_cursor(opened) -> None:
    page = opened()
    clock = page.locator('#clock')
    before = page.locator('#stage canvas').nth(1).screenshot()
    for keys, expected in (
        ('ArrowRight', 't = 1.110 s'),
        ('Shift+ArrowRight', 't = 1.210 s'),
        ('ArrowLeft', 't = 1.200 s'),
        ('End', 't = 3.890 s'),
        ('Home', 't = 0.000 s'),
    ):
        page.keyboard.press(keys)
        drawn(page)
        assert clock.inner_text() == expected
    assert page.locator('#stage canvas').nth(1).screenshot() != before
    page.locator('#next').click()
    page.locator('#scrub').evaluate("e => { e.value = 200; e.dispatchEvent(new Event('input')); }")
    drawn(page)
    assert clock.inner_text() == 't = 2.000 s'
    plot = page.locator('[data-name=angular_velocity] .plot').bounding_box()
    # In the middle of the time axis.
    page.mouse.click(plot['x'] + 58 + (plot['width'] - 58 - 92) / 2, plot['y'] + 40)
    drawn(page)
    assert clock.inner_text() in ('t = 1.940 s', 't = 1.950 s')
    page.locator('#play').focus()
    page.keyboard.press(' ')
    page.locator('#clock', has_text=re.compile('t = 2.[1-9]')).wait_for()
    page.keyboard.press(' ')
    assert page.locator('#play').inner_text() == 'play'


def test_bodies_and_layers_are_hidden_and_shown(opened) -> None:
    page = opened()
    page.keyboard.press('2')
    drawn(page)
    assert colored(page, '#stage canvas', RED) == 0
    assert colored(page, '[data-name=angular_velocity] canvas', RED) == 0
    assert page.locator('#bodies button').nth(1).get_attribute('aria-pressed') == 'false'
    page.keyboard.press('2')
    for layer in ('bodies', 'velocities', 'names', 'ICR', 'IAP', 'moving centrode'):
        page.locator('#layers button', has_text=layer).first.click()
    drawn(page)
    assert colored(page, '#stage canvas', BLUE) == 0
    assert colored(page, '[data-name=angular_velocity] canvas', RED) > 100


def test_wheel_drag_and_buttons_come_closer_and_fit_goes_back(opened) -> None:
    page = opened()
    stage, chart = (page.locator(f'{name} canvas').first for name in ('#stage', '.chart'))

    def pictures() -> tuple[str, str]:
        drawn(page)
        first, second = (one.evaluate('e => e.toDataURL()') for one in (stage, chart))
        return first, second

    seen = [pictures()]
    box = page.locator('#stage').bounding_box()
    page.mouse.move(box['x'] + 200, box['y'] + 200)
    page.mouse.wheel(0, -300)
    seen.append(pictures())
    page.mouse.down()
    page.mouse.move(box['x'] + 260, box['y'] + 230)
    page.mouse.up()
    seen.append(pictures())
    page.locator('#reduce').click()
    seen.append(pictures())
    pairs = itertools.pairwise(seen)
    assert all(one[0] != other[0] and one[1] == other[1] for one, other in pairs)
    page.locator('#zoom-in').click()
    assert pictures()[1] != seen[0][1]
    page.keyboard.press('f')
    assert pictures() == seen[0]


def test_first_screen_of_a_telephone_has_the_linkage_and_figures_and_taps_work(opened) -> None:
    page = opened(390, 844, has_touch=True, is_mobile=True)
    assert page.evaluate('document.documentElement.scrollWidth') == 390
    heading = page.locator('#values thead').first
    box = heading.bounding_box()
    assert box['y'] + box['height'] < 844
    chart = page.locator('[data-name=angular_acceleration] .plot')
    chart.scroll_into_view_if_needed()
    plot = chart.bounding_box()
    page.touchscreen.tap(plot['x'] + plot['width'] - 93, plot['y'] + 40)
    drawn(page)
    assert page.locator('#clock').inner_text() > 't = 3.8'


def test_motion_starts_by_itself_unless_the_reader_asked_for_rest(opened) -> None:
    page = opened(at='')
    page.locator('#clock', has_text=re.compile(r't = (0\.[1-9]|[1-3])')).wait_for()
    assert page.locator('#play').inner_text() == 'pause'
    resting = opened(at='', reduced_motion='reduce')
    assert resting.locator('#play').inner_text() == 'play'


def test_print_holds_all_charts_and_no_buttons(opened) -> None:
    page = opened()
    page.emulate_media(media='print')
    drawn(page)
    assert not page.locator('#transport').is_visible()
    charts = page.locator('.chart')
    names = [charts.nth(k).get_attribute('data-name') for k in range(charts.count())]
    assert names.pop() == 'withheld'
    assert len(names) == 7
    for name in names:
        curves = sum(colored(page, f'[data-name={name}] canvas', c) for c in (RED, '#56a0d0'))
        assert curves > 50, name
    # Twice as fine as on the screen.
    canvas = page.locator('.chart canvas').first
    assert canvas.evaluate('e => e.width / e.getBoundingClientRect().width') > 1.9
    assert page.pdf(format='A4').startswith(b'%PDF')


def test_polygons_show_the_images_of_the_bodies_shown(opened) -> None:
    page = opened()
    canvases = page.locator('#polygons canvas')
    assert canvases.count() == 2
    before = [canvases.nth(k).screenshot() for k in (0, 1)]
    assert colored(page, '#polygons canvas', BLUE) > 50
    page.keyboard.press('Shift+ArrowRight')
    drawn(page)
    assert all(canvases.nth(k).screenshot() != before[k] for k in (0, 1))
    page.keyboard.press('1')
    drawn(page)
    assert colored(page, '#polygons canvas', BLUE) == 0


def test_images_of_points_are_their_velocities_and_accelerations(opened) -> None:
    """What the page's script makes of poles and rates, against the motion itself."""
    page = opened()
    scene = load_scene('four_bar')
    motion, point = scene.motion(0.3)['coupler'], 0.1 + 0.15j
    iap = planar.pole(2, motion.position, motion.angle).value
    z = motion.position
    body = {
        'points': [['P', point.real, point.imag]],
        'angle': [motion.angle[0]],
        **{name: [value] for name, value in zip('xy', (z[0].real, z[0].imag), strict=True)},
        **{name: [value] for name, value in zip(('vx', 'vy'), (z[1].real, z[1].imag), strict=True)},
        'angular_velocity': {'value': [motion.angle[1]]},
        'angular_acceleration': {'value': [motion.angle[2]]},
        'iap': {'x': [float(iap.real)], 'y': [float(iap.imag)]},
    }
    folder = Path(_record_page.__file__).parent / 'page'
    code = '\n'.join((folder / f'{name}.js').read_text() for name in ('data', 'motion', 'polygons'))
    found = page.evaluate(
        f'([body, orders]) => {{ {code}; return orders.map((n) => imagesOf(null, body, 0, n)); }}',
        [body, [1, 2]],
    )
    turn = np.exp(1j * motion.angle[0])
    w, alpha = motion.angle[1:3]
    for (image,), truth in zip(
        found,
        (z[1] + 1j * w * point * turn, z[2] + (1j * alpha - w**2) * point * turn),
        strict=True,
    ):
        assert image[0] == 'P'
        assert complex(*image[1:]) == pytest.approx(complex(truth), rel=1e-9)


def test_page_shows_lost_frames_apart_from_undetermined_ones(opened, gappy, tmp_path) -> None:
    output = tmp_path / 'gap.html'
    report(gappy, output, load_settings(ROOT / 'config' / 'four_bar.yaml'))
    page = opened(file=output, at='#t=1.8')
    assert '181 frames lost' in page.text_content('body')
    assert {cell(page, name, 1) for name in ('angular_velocity', 'icr')} == {
        'lost: no result of these frames'
    }
    # Of the frames that are there, all have a pose.
    shares = page.locator('td', has_text='100%')
    assert shares.count() >= 3
    assert page.locator('figure[data-name=withheld] .unit', has_text='lost: no result').count() == 1
