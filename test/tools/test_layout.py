"""Layouts for other viewers: whole files, each of whose curves is there in a bag of results."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from conftest import read_back, write_config

from kinpole_ros.bags import read_messages, replay
from kinpole_ros.settings import load_settings
from kinpole_ros.tools.cli import main

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope='module', params=['standard', 'all'])
def rig(request, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Parameters with a joint, and the results that they give."""
    folder = tmp_path_factory.mktemp('layout')
    joint = {'joints': ['elbow'], 'elbow': {'bodies': ['crank', 'coupler']}}
    joint |= {'topics': request.param}
    config = write_config(
        folder / 'rig.yaml', load_settings(ROOT / 'config' / 'four_bar.yaml'), **joint
    )
    results = folder / 'results.mcap'
    replay(ROOT / 'bags' / 'four_bar.mcap', load_settings(config), results)
    return config, results


@pytest.fixture(scope='module')
def messages(rig: tuple[Path, Path]) -> dict[str, Any]:
    """A message of each topic of the results."""
    found: dict[str, Any] = {}
    for message in read_messages(rig[1]):
        if message.topic not in found:
            found[message.topic] = read_back(message.data, message.type_name)
    return found


def made(viewer: str, source: Path, output: Path) -> str:
    words = ['layout', viewer, '--config', str(source), '--output', str(output)]
    assert main(words) == 0
    return output.read_text(encoding='utf-8')


def leaves(layout: Any) -> list[str]:
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column')
    assert 0 < layout['splitPercentage'] < 100
    return leaves(layout['first']) + leaves(layout['second'])


@pytest.mark.parametrize('source', [0, 1], ids=['parameters', 'results'])
def test_foxglove_shows_topics_that_are_there(rig, messages, tmp_path, source) -> None:
    layout = json.loads(made('foxglove', rig[source], tmp_path / 'a.json'))
    panels = layout['configById']
    assert sorted(leaves(layout['layout'])) == sorted(panels)
    for topic in panels['3D!kinpole']['topics']:
        assert type(messages[topic]).__name__ == 'MarkerArray'
    # Whatever frames are there.
    assert panels['3D!kinpole'].get('followTf') == (None, 'world')[source]
    assert panels['DiagnosticSummary!kinpole']['topicToRender'] in messages
    paths = [row for panel in panels.values() for row in panel.get('paths', [])]
    is_standard = load_settings(rig[0]).topics == 'standard'
    assert len(paths) == (3 * 3 + 1 if is_standard else 2 * (4 * 3 + 3))
    for row in paths:
        topic, *fields = row['value'].split('.')
        value = messages[topic]
        for field in fields:
            value = getattr(value, field)
        # Along the normal, where nothing else is.
        assert value == value and (topic.endswith('/deviation')) <= (value > 0)


@pytest.mark.parametrize('source', [0, 1], ids=['parameters', 'results'])
def test_plotjuggler_shows_topics_that_are_there(rig, messages, tmp_path, source) -> None:
    root = ET.fromstring(made('plotjuggler', rig[source], tmp_path / 'a.xml'))
    assert [tab.get('tab_name') for tab in root.iter('Tab')] == ['rates', 'poles', 'joints']
    for split in root.iter('DockSplitter'):
        sizes = [float(size) for size in split.attrib['sizes'].split(';')]
        assert int(split.attrib['count']) == len(split) == len(sizes)
        assert sum(sizes) == pytest.approx(1, abs=1e-5)
    # PlotJuggler names curves by topic and field, those of joints by topic, joint and field.
    numbers: dict[str, float] = {}
    for topic, message in messages.items():
        for part in ('vector', 'point'):
            for axis in 'xyz' if hasattr(message, part) else '':
                numbers[f'{topic}/{part}/{axis}'] = getattr(getattr(message, part), axis)
        for k, name in enumerate(getattr(message, 'name', [])):
            numbers[f'{topic}/{name}/position'] = message.position[k]
            numbers[f'{topic}/{name}/velocity'] = message.velocity[k]
    for plot in root.iter('plot'):
        for curve in plot.iter('curve'):
            assert re.fullmatch('#[0-9a-f]{6}', curve.attrib['color'])
            names = ('curve_x', 'curve_y') if plot.get('mode') == 'XYPlot' else ('name',)
            assert all(curve.attrib[name] in numbers for name in names)
    is_standard = load_settings(rig[0]).topics == 'standard'
    rates, poles = (3 * 3 + 1, 3) if is_standard else (2 * (4 * 3 + 3), 4 * 3)
    assert len([*root.iter('curve')]) == rates + poles + 2


def test_layout_refuses_in_one_line_what_has_nothing_to_show(tmp_path, capsys) -> None:
    output = tmp_path / 'a.json'
    bag = str(ROOT / 'bags' / 'four_bar.mcap')
    for source in (bag, str(tmp_path / 'none.yaml')):
        assert main(['layout', 'foxglove', '--config', source, '--output', str(output)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
    assert not output.exists()


def test_a_bag_of_any_name_is_no_parameter_file(rig, tmp_path, capsys) -> None:
    bag, output = tmp_path / 'monday.bak', tmp_path / 'a.json'
    bag.write_bytes(rig[1].read_bytes())
    assert main(['layout', 'foxglove', '--config', str(bag), '--output', str(output)]) == 0
    assert 'crank, coupler, rocker of /kinpole' in capsys.readouterr().out
