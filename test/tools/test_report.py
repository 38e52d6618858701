"""Reports: the figures in the page are those of the replay."""

import copy
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import data_of
from test_layouts_of_trackers import openpose

from kinpole_ros.bags import (
    BagError,
    BagWriter,
    read_messages,
    replay,
    simulate,
    write_points,
)
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import String, read_rig, serialize_message
from kinpole_ros.messages._types import Odometry
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.record.result_bag import read_record
from kinpole_ros.tools.report import _record_page, report, settings_for
from kinpole_ros.tools.report._collector import Collector, theory_rates
from kinpole_ros.tracking.values import RATE_NAMES

ROOT = Path(__file__).parents[2]
BAG = ROOT / 'bags' / 'four_bar.mcap'


@pytest.fixture(scope='module')
def blocks() -> list[Any]:
    """The estimates it is four_bar_page of."""
    found: list[Any] = []
    replay(BAG, load_settings(ROOT / 'config' / 'four_bar.yaml'), take=found.append, whole=True)
    return found


def test_report_of_four_seconds_is_one_file_under_250_kB(four_bar_page) -> None:
    assert four_bar_page.stat().st_size < 250_000
    text = four_bar_page.read_text()
    assert not re.search(r'(src|href)\s*=|https?://|@import|url\(', text.split('<script id')[0])


def test_figures_are_those_of_the_replay_to_a_tenth_of_their_deviation(
    four_bar_page, blocks
) -> None:
    data = data_of(four_bar_page)
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


def test_pins_are_found_and_nothing_else(four_bar_page) -> None:
    joints = [joint['bodies'] for joint in data_of(four_bar_page)['joints']]
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


def test_lost_frames_are_no_undetermined_ones(gappy_bag, tmp_path, capsys) -> None:
    output = tmp_path / 'gap.html'
    config = str(ROOT / 'config' / 'four_bar.yaml')
    assert main(['report', str(gappy_bag), '--config', config, '--output', str(output)]) == 0
    assert '; 171 frames lost' in capsys.readouterr().out
    from_markers = data_of(output)
    replay(gappy_bag, load_settings(config), tmp_path / 'results.mcap', whole=True)
    report(tmp_path / 'results.mcap', output, Settings())
    for data in from_markers, data_of(output):
        assert ' at 100 Hz, 171 frames lost' in data['about']
        # Both ends of the gap and the single frame are without a value, so no line crosses them.
        spans = [(data['t'][start], data['t'][end - 1]) for start, end, _ in data['lost']]
        np.testing.assert_allclose(spans, [(1.0, 2.69), (3.0, 3.0)], atol=1e-6)
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


def test_report_of_results_is_that_of_their_markers(four_bar_page, tmp_path) -> None:
    # With the relative centers of all pairs.
    settings = load_settings(ROOT / 'config' / 'four_bar.yaml', changes={'topics': 'all'})
    results, output = tmp_path / 'results.mcap', tmp_path / 'results.html'
    replay(BAG, settings, results, whole=True)
    report(results, output, Settings())
    shown, expected = data_of(output), data_of(four_bar_page)
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
    with pytest.raises(BagError, match='give the bag of markers'):
        report(results, output, settings_for(settings, 'four_bar'))
    for one, other in zip(shown['bodies'], expected['bodies'], strict=True):
        assert one['missing'] == other['missing'] and one['withheld'] == other['withheld']
        assert one['size'] == pytest.approx(other['size'], rel=0.01)
    reasons = {reason for _, _, reason in shown['bodies'][1]['withheld']['isp']}
    assert 'lost in its noise' in reasons


def _complex(points: list[list[float]]) -> np.ndarray:
    return np.array([complex(*point) for point in points])


def test_each_run_of_a_node_has_its_outlines(tmp_path) -> None:
    """A node that starts anew defines new frames of its bodies."""
    results, twice = tmp_path / 'results.mcap', tmp_path / 'twice.mcap'
    replay(BAG, load_settings(ROOT / 'config' / 'four_bar.yaml'), results)
    messages = list(read_messages(results, ['/kinpole/rig', '/kinpole/state']))
    with BagWriter(twice) as writer:
        for run in (1, 2):
            for message in messages:
                data = message.data
                if message.topic.endswith('/rig'):
                    rig = read_rig(data) | {'run': run}
                    data = serialize_message(String(data=json.dumps(rig)))
                elif run == 2:
                    data = (
                        data[:4]
                        + (int.from_bytes(data[4:8], 'little') + 100).to_bytes(4, 'little')
                        + data[8:]
                    )
                log_time = message.log_time + (run - 1) * 100 * 10**9
                writer.write_raw(message.topic, message.type_name, data, log_time)
    record = read_record(twice)
    half = len(record.stamp) // 2
    for body, outlines in record.outlines.items():
        (first, one), (second, other) = outlines
        assert (first, second) == (0, half) and np.array_equal(one, other), body


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
    points = np.random.default_rng(0).normal(size=(3, 2, 3))
    write_points(tmp_path / 'three.mcap', ['a', 'b'], np.arange(3) * 10**7, points)
    with pytest.raises(BagError, match='no results, since they take 7 frames, and there are 3'):
        report(tmp_path / 'three.mcap', output, Settings(bodies={'rod': ('a', 'b')}))


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


def test_a_report_of_a_table_of_poses_has_their_rates(tmp_path, capsys) -> None:
    t = np.arange(100) / 50
    turns = np.stack((t, 0 * t, 0 * t, np.sin(t), np.cos(t)), axis=1)
    table, output = tmp_path / 'poses.csv', tmp_path / 'a.html'
    head = ','.join(
        ['__time', '/1st/x', '/1st/y', *(f'/1st/orientation/{axis}' for axis in 'xyzw')]
    )
    rows = np.insert(turns, 1, [[0.1], [0.2]], axis=1)
    np.savetxt(table, rows, delimiter=',', header=head, comments='')
    assert main(['report', str(table), '--output', str(output)]) == 0
    assert 'bodies: body_1, each by its pose; to change: ' in capsys.readouterr().out
    (body,) = data_of(output)['bodies']
    # In the first half second the noise is not known yet.
    rates = np.array(body['angular_velocity']['value'][30:], float)
    np.testing.assert_allclose(rates, 2, atol=1e-6)


def test_a_report_of_a_folder_of_openpose_imports_it(tmp_path, capsys) -> None:
    folder = openpose(tmp_path / 'json')
    words = ['--rate', '50', '--scale', '0.001', '--output', str(tmp_path / 'page.html')]
    assert main(['report', str(folder), *words]) == 2
    # Its frames were read, and are too few.
    assert f'{folder}: no results, since they take 7 frames' in capsys.readouterr().err


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
