"""The command line: what is wrong is one clear line, and what can be done is done."""

import ast
import importlib.machinery
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from conftest import bodies_of, decoded, figures, stamp_of, write_config
from geometry_msgs.msg import PoseArray
from mcap.writer import Writer

from kinpole_ros.bags import RECORDER, BagWriter, Truncated, read_messages
from kinpole_ros.mechanism import scene_names, scene_text, scenes_folder
from kinpole_ros.messages import to_message
from kinpole_ros.packages import EXTRAS
from kinpole_ros.settings import Settings
from kinpole_ros.tools import cli
from kinpole_ros.tools.commands import COMMANDS as COMMAND_MODULES
from kinpole_ros.tools.usage import make_parser

Bag = Callable[..., Path]
ROOT = Path(__file__).parents[2]
COMMANDS = ['node', 'replay', 'simulate', 'plot', 'import', 'play', 'record', 'demo']


class Said(NamedTuple):
    """How a command ended, and what it printed."""

    status: int
    out: str
    err: str


@pytest.fixture
def kinpole(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Run a command in this process."""

    def run(*words: str | Path) -> Said:
        try:
            status = cli.main([str(word) for word in words])
        except SystemExit as end:
            status = int(end.code or 0)
        return Said(status, *capsys.readouterr())

    return run


def process(*words: str | Path, **options: Any) -> Said:
    """Run a command as a user does."""
    done = subprocess.run(
        [sys.executable, '-m', 'kinpole_ros.tools.cli', *map(str, words)],
        capture_output=True,
        text=True,
        timeout=60,
        **options,
    )
    return Said(done.returncode, done.stdout, done.stderr)


def refusal(said: Said) -> str:
    """The one line of a refusal."""
    assert said.status == 2
    assert said.err.endswith('\n')
    assert said.err.count('\n') == 1, said.err
    assert 'Traceback' not in said.err
    return said.err


@pytest.fixture
def rod(simulated: Bag, tmp_path: Path) -> Path:
    """A bag of a rod that a test may spoil."""
    bag = tmp_path / 'rod.mcap'
    bag.write_bytes(simulated('cardan', rate=100, duration=0.3, noise=1e-4).read_bytes())
    return bag


# Help and usage


@pytest.mark.parametrize('words', [[], *([command] for command in COMMANDS)])
def test_help_tells_what_each_command_does(kinpole: Any, words: list[str]) -> None:
    said = kinpole(*words, '--help')
    assert said.status == 0
    assert said.out.startswith('usage: kinpole')
    assert said.err == ''
    listed = COMMANDS if not words else []
    assert all(f'    {command} ' in said.out for command in listed)


@pytest.mark.parametrize('words', [[], ['solve']])
def test_examples_of_the_help_do_what_they_say(
    kinpole: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    lines = [
        line.split('kinpole ', 1)[1]
        for line in kinpole(*words, '--help').out.splitlines()
        if line.startswith('  kinpole ')
    ]
    told = ('simulate four_bar', 'replay four_bar', 'plot', 'solve')
    examples = [shlex.split(line) for line in lines if line.startswith(told)]
    assert len(examples) >= 4
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'config').symlink_to(scenes_folder().parent)
    for example in examples:
        shorter = ['--duration', '1'] if example[0] == 'simulate' else []
        said = kinpole(*example, *shorter)
        assert (said.status, said.err) == (0, ''), example
        if example[0] == 'replay':
            assert 'rocker: determined' in said.out


def test_help_comes_without_ros_and_numpy() -> None:
    program = (
        'import sys\nfrom kinpole_ros.tools import cli\n'
        'try:\n    cli.main(["--help"])\nexcept SystemExit:\n    pass\n'
        'print("loaded:", sorted({"rclpy", "numpy", "mcap", "yaml"} & set(sys.modules)))'
    )
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert 'usage: kinpole' in done.stdout
    assert done.stdout.endswith('loaded: []\n'), done.stderr


def test_version_is_told(kinpole: Any) -> None:
    from kinpole_ros import __version__

    assert kinpole('--version').out == f'kinpole {__version__}\n'


@pytest.mark.parametrize(
    'words, complaint',
    [
        ([], 'COMMAND'),
        (['fly'], 'no command fly; known: node, '),
        (['reprot', 'a.csv'], 'no command reprot; did you mean report? known: node, '),
        (['replay', 'a.mcap', '--sctrict'], 'arguments: --sctrict; did you mean --strict?'),
        (['simulate', 'cardan', '--noise', '2 kg', '--output', 'x'], "--noise: it is '2 kg', w"),
        (['replay'], 'BAG'),
        (['replay', 'a.mcap', '--speed', '2'], 'unrecognized arguments: --speed 2'),
        (['simulate', 'cardan'], '--output'),
        (
            ['simulate', 'cardan', '--output', 'x', '--rate', 'fast'],
            "--rate: it is 'fast': give a finite number",
        ),
        (['plot', 'a.mcap'], '--output'),
        (['import', 'a.csv'], '--output'),
        (['record'], '--output'),
    ],
)
def test_bad_usage_is_status_2_and_names_what_is_missing(
    kinpole: Any, words: list[str], complaint: str
) -> None:
    said = kinpole(*words)
    assert said.status == 2
    assert said.out == ''
    assert complaint in said.err.splitlines()[-1]


def test_options_take_units_as_scenes_do() -> None:
    words = 'simulate cardan --output x --noise 0.2mm --duration 500ms --rate 1e2 --tilt 0.5rad'
    given = make_parser().parse_args([*shlex.split(words), '--arrival', '0.001'])
    found = [given.noise, given.duration, given.rate, given.tilt, given.arrival]
    assert found == pytest.approx([2e-4, 0.5, 100.0, np.degrees(0.5), 0.001])


def test_strict_is_1_where_scene_and_markers_differ(
    kinpole: Any, simulated: Bag, tmp_path: Path
) -> None:
    bag = simulated('four_bar', rate=100, duration=2, noise=2e-4)
    long = tmp_path / 'long.yaml'
    long.write_text(scene_text('four_bar').replace('B: [0.36, 0]', 'B: [0.361, 0]'))
    assert long.read_text() != scene_text('four_bar')
    words = ['replay', bag, '--config', ROOT / 'config' / 'four_bar.yaml']
    for scene, strict, status in (('four_bar', 1, 0), (long, 1, 1), (long, 0, 0)):
        changes = ['--set', f'scene:={scene}', *['--strict'][:strict]]
        assert kinpole(*words, *changes).status == status
    assert '--strict compares with a scene' in refusal(kinpole(*words, '--strict'))


def test_scenes_are_listed(kinpole: Any) -> None:
    said = kinpole('simulate', '--list')
    assert (said.status, said.out.split()) == (0, scene_names())
    assert 'four_bar' in scene_names()


# Bad input


def test_as_a_process_a_refusal_is_one_line_and_status_2(rod: Path, tmp_path: Path) -> None:
    assert 'no such file or folder: nofile.csv' in refusal(
        process('replay', 'nofile.csv', cwd=tmp_path)
    )
    config = tmp_path / 'config.yaml'
    config.write_text('/**: {ros__parameters: {windows: 1}}\n')
    line = refusal(process('replay', rod, '--config', config))
    assert line.startswith(f'kinpole replay: {config}: unknown parameter windows')


def test_a_bag_that_is_not_there_or_no_bag_is_named(kinpole: Any, tmp_path: Path) -> None:
    nothing, text = tmp_path / 'none.mcap', tmp_path / 'text.mcap'
    text.write_text('hello, this is no bag')
    for command in (['replay'], ['plot', '--output', tmp_path / 'x.png'], ['play']):
        assert f'no such file or folder: {nothing}' in refusal(kinpole(*command, nothing))
        assert f'{text} is not an MCAP file' in refusal(kinpole(*command, text))
        assert f'{tmp_path}' in refusal(kinpole(*command, tmp_path / 'text.mcap'))


def test_a_topic_that_is_not_there_is_named_with_those_that_are(kinpole: Any, rod: Path) -> None:
    line = refusal(kinpole('replay', rod, '--topic', '/mocap'))
    assert f'{rod}: no topic /mocap; it holds ' in line
    assert '/markers (visualization_msgs/msg/MarkerArray)' in line
    assert 'no topic /mocap' in refusal(kinpole('play', rod, '--topic', '/mocap'))


def test_topics_that_cannot_be_meant_are_not_listed(kinpole: Any, rod: Path) -> None:
    only = 'no topic /mocap; it holds /markers'
    replayed = refusal(kinpole('replay', rod, '--topic', '/mocap'))
    assert f'{only} (visualization_msgs/msg/MarkerArray); name one with --topic\n' in replayed
    assert f'{only}\n' in refusal(kinpole('play', rod, '--topic', '/mocap'))


def test_a_topic_of_another_type_is_named_with_the_types_that_are_read(
    kinpole: Any, rod: Path
) -> None:
    line = refusal(kinpole('replay', rod, '--topic', '/kinpole/truth/rod/icr'))
    assert 'topic /kinpole/truth/rod/icr is geometry_msgs/msg/PointStamped' in line
    assert 'sensor_msgs/msg/PointCloud2' in line


def test_a_topic_of_another_type_than_the_parameter_says_is_named(
    kinpole: Any, rod: Path, tmp_path: Path
) -> None:
    config = write_config(tmp_path / 'c.yaml', Settings(), marker_type='pose_array')
    line = refusal(kinpole('replay', rod, '--config', config))
    assert 'marker_type is pose_array; set it to marker_array or auto' in line


@pytest.mark.parametrize(
    'text, complaint',
    [
        ('', 'no section for this node'),
        ('other: {ros__parameters: {lag: 0.1}}', 'no section for this node'),
        ('/**: {ros__parameters: {lag: 0.1', 'not YAML'),
        (
            '/**: {ros__parameters: {window: wide}}',
            "parameter window is 'wide'; it must",
        ),
        ('/**: {ros__parameters: {plane: zz}}', 'one of xy, yz, zx'),
        ('/**: {ros__parameters: {stamps: 2001-99-99}}', "stamps is '2001-99-99'"),
        ('/**: {ros__parameters: {bodies: [a], b.markers: [p, q]}}', 'unknown parameter b.markers'),
        ('/**: {ros__parameters: {colour: red}}', 'unknown parameter colour; known are '),
        ('/**: {ros__parameters: {window: 0.1, lag: 0.2}}', 'parameter lag is 0.2 s'),
    ],
)
def test_a_config_that_cannot_be_used_is_named_with_the_parameter(
    kinpole: Any, rod: Path, tmp_path: Path, text: str, complaint: str
) -> None:
    config, output = tmp_path / 'config.yaml', tmp_path / 'out.mcap'
    config.write_text(text)
    line = refusal(kinpole('replay', rod, '--config', config, '--output', output))
    assert line.startswith(f'kinpole replay: {config}: ')
    assert complaint in line
    assert not output.exists()


def test_a_config_that_is_not_there_is_named(kinpole: Any, rod: Path, tmp_path: Path) -> None:
    line = refusal(kinpole('replay', rod, '--config', tmp_path / 'none.yaml'))
    assert f'{tmp_path}/none.yaml: No such file' in line


def test_a_bag_of_nothing_readable_is_one_line(kinpole: Any, tmp_path: Path) -> None:
    bag = tmp_path / 'bad.mcap'
    with BagWriter(bag) as writer:
        writer.write_raw('/markers', 'sensor_msgs/msg/PointCloud2', b'\x00\x01\x00\x00\xff', 5)
    line = refusal(kinpole('replay', bag))
    assert f'{bag}: no message on /markers can be read' in line


def test_some_messages_left_out_are_told_and_the_rest_is_done(
    kinpole: Any, rod: Path, tmp_path: Path
) -> None:
    bag = tmp_path / 'some.mcap'
    with BagWriter(bag) as writer:
        for m in read_messages(rod, ['/markers']):
            writer.write_raw(m.topic, m.type_name, m.data, m.log_time)
        writer.write_raw('/markers', m.type_name, b'\x00\x01\x00\x00\xff', m.log_time)
    said = kinpole('replay', bag)
    assert said.status == 0
    assert said.err.startswith('kinpole replay: 1 messages left out, the first: ')
    assert said.err.count('\n') == 1
    assert said.out.startswith('30 frames in')


@pytest.mark.parametrize(
    'text, complaint',
    [
        ('t,a_x,a_y\n0,1,two\n', "line 2, column a_y: 'two' is not a number"),
        ('t,a_x\n0,1\n', 'no column a_y'),
        ('a_x,a_y\n0,1\n', 'has no times; fix: give --rate'),
        ('', 'is empty'),
    ],
)
def test_a_table_with_a_fault_is_named_with_line_and_column(
    kinpole: Any, tmp_path: Path, text: str, complaint: str
) -> None:
    table, output = tmp_path / 'table.csv', tmp_path / 'out.mcap'
    table.write_text(text)
    line = refusal(kinpole('import', table, '--output', output))
    assert line.startswith(f'kinpole import: {table}')
    assert complaint in line
    assert not output.exists()


def test_a_scene_without_markers_makes_no_bag(kinpole: Any, tmp_path: Path) -> None:
    (tmp_path / 'bare.yaml').write_text(
        'bodies: {ground: {O: [0, 0]}, arm: {O: [0, 0], P: [0.1, 0]}}\n'
        'drivers: [{drive: arm, rate: 1}]\n'
    )
    line = refusal(kinpole('simulate', tmp_path / 'bare.yaml', '--output', tmp_path / 'x.mcap'))
    assert 'bare has no markers' in line
    assert not (tmp_path / 'x.mcap').exists()


def test_a_scene_that_is_not_there_is_named_with_those_that_are(
    kinpole: Any, tmp_path: Path
) -> None:
    line = refusal(kinpole('simulate', 'five_bar', '--output', tmp_path / 'x.mcap'))
    assert 'five_bar.yaml: there is no such scene' in line
    assert 'antiparallelogram' in line
    assert 'four_bar, ' in line
    line = refusal(kinpole('simulate', tmp_path / 'my.yaml', '--output', tmp_path / 'x.mcap'))
    assert f'{tmp_path}/my.yaml: there is no such scene' in line


@pytest.mark.parametrize(
    'option, value, complaint',
    [
        ('--rate', '0', '--rate is 0.0; it must be more than 0 Hz, '),
        ('--rate', 'nan', '--rate is nan'),
        ('--rate', '1e12', 'it must be more than 0 Hz, and 1e9 Hz at most'),
        ('--duration', '-1', '--duration is -1.0; it must be more than 0 s'),
        ('--duration', '3e9', '--rate times --duration is 600000000000.0'),
        ('--noise', '-0.1', '--noise is -0.1; it must be 0 m or more'),
        ('--seed', '-1', '--seed is -1; it must be 0 or more'),
        ('--dropout', '1.5', '--dropout is 1.5; it must be from 0 to 1'),
        ('--jitter', '-1', '--jitter is -1.0; it must be 0 s or more'),
        ('--jitter', '1e12', '--jitter make a bag of'),
        ('--message', 'images', '--message is images; it must be one of marker_array, marker, '),
    ],
)
def test_an_option_out_of_range_is_named_with_the_range(
    kinpole: Any, tmp_path: Path, option: str, value: str, complaint: str
) -> None:
    output = tmp_path / 'x.mcap'
    line = refusal(kinpole('simulate', 'cardan', '--output', output, f'{option}={value}'))
    assert complaint in line
    assert not output.exists()


@pytest.mark.parametrize('speed', ['0', '-1', 'nan', 'inf'])
def test_a_bag_is_not_played_at_no_speed(kinpole: Any, rod: Path, speed: str) -> None:
    assert 'it must be more than 0' in refusal(kinpole('play', rod, f'--speed={speed}'))


def test_a_topic_of_a_bag_that_is_none_in_ros_is_named(kinpole: Any, tmp_path: Path) -> None:
    bag = tmp_path / 'odd.mcap'
    with BagWriter(bag) as writer:
        writer.write('/lab 1/markers', to_message('marker', 0, 'world', 'ab', np.zeros((2, 3))), 0)
    line = refusal(kinpole('play', bag))
    assert f'{bag}: Invalid topic name: ' in line
    assert "'/lab 1/markers'; name other topics with --topic" in line


def test_a_rate_and_a_scale_out_of_range_are_named(kinpole: Any, tmp_path: Path) -> None:
    table = tmp_path / 'table.csv'
    table.write_text('a_x,a_y\n0,1\n')
    words = ['import', table, '--output', tmp_path / 'x.mcap']
    assert 'rate is -5' in refusal(kinpole(*words, '--rate', '-5'))
    assert 'scale is 0' in refusal(kinpole(*words, '--rate', '5', '--scale', '0'))


# Outputs


def test_an_output_that_cannot_be_written_is_named(kinpole: Any, rod: Path, tmp_path: Path) -> None:
    wrong = rod / 'under_a_file.out'
    table = tmp_path / 'table.csv'
    table.write_text('t,a_x,a_y\n0,1,2\n')
    for words in (
        ['replay', rod, '--output'],
        ['replay', rod, '--csv'],
        ['simulate', 'cardan', '--output'],
        ['import', table, '--output'],
        ['record', '--output'],
    ):
        assert f'{wrong} cannot be written' in refusal(kinpole(*words, wrong))
        line = refusal(kinpole(*words, tmp_path))
        assert f'{tmp_path} cannot be written: Is a directory' in line
        if words != ['record', '--output']:
            line = refusal(kinpole(*words, tmp_path / ('y' * 300)))
            assert 'yyy cannot be written: File name too long; ' in line
    for words in ['record'], ['demo'], ['bench', '--quick'], ['simulate', wrong.name * 30]:
        line = refusal(kinpole(*words, '--output', tmp_path / ('y' * 300)))
        assert ' cannot be used: File name too long; fix: check the path' in line


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
@pytest.mark.parametrize('option', ['--output', '--csv'])
def test_a_full_disk_is_one_line(kinpole: Any, rod: Path, option: str) -> None:
    line = refusal(kinpole('replay', rod, option, '/dev/full'))
    assert '/dev/full cannot be written: No space left on device' in line


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
def test_a_recording_on_a_full_disk_ends_before_anything_comes() -> None:
    line = refusal(process('record', '--output', '/dev/full'))
    assert '/dev/full cannot be written: No space left on device' in line


@pytest.mark.parametrize(
    'words, told',
    [
        ('replay ROD --output a.csv', '--output a.csv: the output is an MCAP bag; end its name in'),
        ('replay ROD --csv a.parquet', '--csv a.parquet: the output is a CSV table; end its name'),
        ('replay ROD --parquet a.csv', '--parquet a.csv: the output is a Parquet table; end its'),
        ('simulate cardan --output a.yaml', 'the output is an MCAP bag; end its name in .mcap'),
        ('import a.txt --output a.html', 'the output is an MCAP bag; end its name in .mcap'),
        ('record --output a.csv', 'the output is an MCAP bag; end its name in .mcap'),
        ('solve cardan --html a.png', '--html a.png: the output is an HTML page; end its name in'),
        ('solve cardan --csv b.csv --plot a.html', 'a.html is no picture; end its name in one of'),
        ('plot ROD --output a.html', 'a.html is no picture; end its name in one of'),
        ('tolerance cardan --plot a.foo', 'a.foo is no picture; end its name in one of'),
        ('discover ROD --output b.yaml --plot a.html', 'a.html is no picture; end its name in'),
        ('discover ROD --output a.mcap', 'the output is a YAML file; end its name in .yaml'),
        ('fit cardan ROD --output a.mcap', 'the output is a YAML file; end its name in .yaml'),
        (
            'layout foxglove --output a.xml',
            'the output is a Foxglove layout; end its name in .json',
        ),
    ],
)
def test_a_name_that_ends_as_another_kind_of_file_is_refused_before_anything_is_done(
    kinpole: Any, rod: Path, monkeypatch: pytest.MonkeyPatch, words: str, told: str
) -> None:
    monkeypatch.chdir(rod.parent)
    before = sorted(rod.parent.iterdir())
    assert told in refusal(kinpole(*words.replace('ROD', rod.name).split()))
    assert sorted(rod.parent.iterdir()) == before


def test_a_replay_says_that_it_took_all_markers_as_one_body(
    kinpole: Any, simulated: Bag, rod: Path
) -> None:
    said = kinpole('replay', rod).out
    assert 'markers are taken as one rigid body, "body"' in said
    assert f'kinpole discover {rod} --output rig.yaml' in said
    config = scenes_folder().parent / 'cardan.yaml'
    assert 'one rigid body' not in kinpole('replay', rod, '--config', config).out


def test_no_command_writes_over_what_it_reads(kinpole: Any, rod: Path, tmp_path: Path) -> None:
    table, config, scene = (tmp_path / name for name in ('t.csv', 'c.yaml', 's.yaml'))
    table.write_text('t,a_x,a_y\n0,1,2\n')
    write_config(config, Settings())
    scene.write_text((scenes_folder() / 'cardan.yaml').read_text())
    link = tmp_path / 'link.mcap'
    link.symlink_to(rod)
    hard, hard_config = tmp_path / 'hard.mcap', tmp_path / 'hard.yaml'
    os.link(rod, hard)
    os.link(config, hard_config)
    before = [path.read_bytes() for path in (rod, table, config, scene)]
    for target, *words in (
        (rod, 'replay', rod, '--output', rod),
        (link, 'replay', rod, '--output', link),
        (rod, 'replay', rod, '--csv', rod),
        (hard, 'replay', rod, '--output', hard),
        (hard, 'replay', rod, '--parquet', hard),
        (config, 'replay', rod, '--config', config, '--csv', hard_config),
        (config, 'replay', rod, '--config', config, '--output', config),
        (config, 'replay', rod, '--config', config, '--csv', config),
        (table, 'import', table, '--output', table),
        (scene, 'simulate', scene, '--output', scene),
        (scene, 'solve', scene, '--csv', scene),
        (rod, 'plot', rod, '--output', rod),
    ):
        assert str(target) in refusal(kinpole(*words))
        assert [path.read_bytes() for path in (rod, table, config, scene)] == before
    both = tmp_path / 'both'
    line = refusal(kinpole('replay', rod, '--output', both, '--csv', both))
    assert f'{both} is another output; name another file to write' in line


def test_what_does_not_fit_the_memory_is_one_line(
    kinpole: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = mock.Mock(side_effect=MemoryError('Unable to allocate 3.73 GiB'))
    monkeypatch.setattr('kinpole_ros.bags.simulate', full)
    line = refusal(kinpole('simulate', 'four_bar', '--output', tmp_path / 'run.mcap'))
    assert 'the memory is too small for this (Unable to allocate 3.73 GiB); fix: ' in line


@pytest.mark.parametrize('command', ['node', 'play', 'record', 'demo'])
def test_an_environment_that_ros_cannot_use_is_one_line(
    rod: Path, tmp_path: Path, command: str
) -> None:
    output: list[str | Path] = ['--output', tmp_path / 'out']
    words = {'node': [], 'play': [rod], 'record': output, 'demo': output}[command]
    faults = {
        'lab': ('ROS_DOMAIN_ID', 'failed to initialize rcl: ROS_DOMAIN_ID is not an integral'),
        '233': ('ROS_DOMAIN_ID', 'ROS_DOMAIN_ID is 233; it must be a number from 0 to 232'),
        str(rod / 'no'): ('ROS_LOG_DIR', "/no': 20; set ROS_LOG_DIR to a folder that can be"),
    }
    # Each command checks all of it in one place.
    tried = {'node': [*faults], 'play': ['lab'], 'record': ['233'], 'demo': [str(rod / 'no')]}
    for value in tried[command]:
        name, reason = faults[value]
        said = process(command, *words, env={**os.environ, name: value})
        assert 'environment: ' in refusal(said)
        assert reason in said.err
    assert not (tmp_path / 'out').is_file()


def test_results_do_not_become_a_part_of_the_bag_they_are_of(kinpole: Any, rod: Path) -> None:
    output = rod.parent / 'results.mcap'
    line = refusal(kinpole('replay', rod.parent, '--output', output))
    assert f'{output} would be a part of the bag to be replayed' in line
    assert not output.exists()
    assert kinpole('replay', rod.parent, '--csv', rod.parent / 'results.csv').status == 0


TWO_OUTPUTS = (
    'replay {bag} --output {0} --csv {1}',
    'replay {bag} --csv {0} --parquet {1}',
    'solve four_bar --csv {0} --plot {1}',
    'solve four_bar --csv {0} --html {1}',
    'solve four_bar --html {0} --pitch crank follower {1}',
    'discover {bag} --output {0} --scene {1}',
    'discover {bag} --output {0} --plot {1}',
)
INPUT_AS_OUTPUT = (
    'replay {bag} --csv {bag}',
    'replay {bag} --config {config} --csv {config}',
    'replay {bag} --set scene:={scene} --csv {scene}',
    'replay {folder} --csv {folder}/part.mcap',
    'batch {bag} --output {summary} --list {summary}/summary.csv',
    'simulate {scene} --output {scene}',
    'solve {scene} --csv {scene}',
    'discover {bag} --output {bag}',
    'discover {folder} --scene {folder}/part.mcap',
    'fit {scene} {bag} --output {scene}',
    'fit {scene} {bag} --output {bag}',
    'fit {scene} {bag} --config {config} --output {config}',
    'plot {bag} --output {bag}',
    'report {bag} --output {bag}',
    'report {bag} --config {config} --output {config}',
    'report {bag} --scene {scene} --output {scene}',
    'layout foxglove --config {config} --output {config}',
    'import {table} --output {table}',
)


@pytest.mark.parametrize('there', [False, True])
@pytest.mark.parametrize('words', TWO_OUTPUTS)
def test_two_outputs_of_one_name_are_refused(
    kinpole: Any, rod: Path, tmp_path: Path, words: str, there: bool
) -> None:
    output = tmp_path / 'out'
    if there:  # by another name then
        output.write_text('before')
        os.link(output, tmp_path / 'other')
    others = str(output), str(tmp_path / 'other') if there else f'{tmp_path}/./out'
    line = refusal(kinpole(*words.format(*others, bag=rod).split()))
    assert others[0] in line
    assert others[1] in line
    assert ' is another output; name another file to write' in line
    assert output.exists() == there
    assert not there or output.read_text() == 'before'


@pytest.mark.parametrize('words', INPUT_AS_OUTPUT)
def test_an_output_does_not_take_the_place_of_an_input(
    kinpole: Any, rod: Path, tmp_path: Path, words: str
) -> None:
    folder, summary = tmp_path / 'folder', tmp_path / 'results'
    for made in (folder, summary):
        made.mkdir()
    files = {'bag': rod, 'table': tmp_path / 'table.csv', 'part': folder / 'part.mcap'}
    os.link(rod, files['part'])
    files['table'].write_text('t,a_x,a_y\n0,1,2\n')
    files['listed'] = summary / 'summary.csv'
    files['listed'].write_text(f'{rod}\n')
    files['scene'] = tmp_path / 'mine.yaml'
    files['scene'].write_bytes((scenes_folder() / 'cardan.yaml').read_bytes())
    files['config'] = write_config(tmp_path / 'rig.yaml', Settings())
    before = {path: path.read_bytes() for path in files.values()}
    named = {**files, 'folder': folder, 'summary': summary}
    line = refusal(kinpole(*words.format(**named).split()))
    assert ' is an input; name another file to write' in line
    assert {path: path.read_bytes() for path in files.values()} == before


def test_what_goes_to_a_device_is_no_file_written_twice(kinpole: Any) -> None:
    words = ('solve', 'four_bar', '--csv', '/dev/null', '--html', '/dev/null')
    assert 'is another output' not in kinpole(*words).err


@pytest.mark.parametrize(
    'words',
    [
        'solve {scene} --html {out}.html --csv {other}',
        'solve {scene} --plot {other}.png --pitch crank rocker {out}.svg',
        'discover {bag} --output {out} --scene {other}',
        'discover {bag} --output {out} --plot {other}.png',
        'report {bag} --output {out}.html',
        'report {bag} --scene {scene} --output {out}.html',
        'replay {bag} --output {out} --csv {other}',
        'simulate {scene} --duration 0.2 --output {out}',
        'fit {scene} {bag} --output {out}',
    ],
)
def test_names_of_files_that_are_no_text_are_written_down_all_the_same(
    kinpole: Any, simulated: Bag, tmp_path: Path, words: str
) -> None:
    odd = os.fsdecode(b'\xff')
    scene, bag = tmp_path / f'scene{odd}.yaml', tmp_path / f'bag{odd}\n.mcap'
    scene.write_bytes((scenes_folder() / 'four_bar.yaml').read_bytes())
    bag.write_bytes(simulated('four_bar', rate=100, duration=1.5, noise=1e-4).read_bytes())
    named = {'scene': scene, 'bag': bag, 'out': tmp_path / 'out', 'other': tmp_path / 'other'}
    said = kinpole(*[word.format(**named) for word in words.split()])
    assert 'Traceback' not in said.err
    written = [file.stat().st_size for file in tmp_path.iterdir() if file not in (scene, bag)]
    assert written, said.err
    assert min(written) > 100


@pytest.mark.parametrize('program', ['libmcap 1.4', RECORDER])
def test_a_recording_is_not_written_over(
    kinpole: Any, rod: Path, tmp_path: Path, program: str
) -> None:
    recording, table = tmp_path / 'recorded.mcap', tmp_path / 'table.csv'
    with open(recording, 'wb') as file:
        writer = Writer(file)
        writer.start('ros2', program)
        writer.finish()
    table.write_text('t,a_x,a_y\n0,1,2\n')
    before = recording.read_bytes()
    for words in (
        ['replay', rod, '--output'],
        ['replay', rod, '--csv'],
        ['simulate', 'cardan', '--output'],
        ['import', table, '--output'],
        ['solve', 'cardan', '--csv'],
    ):
        line = refusal(kinpole(*words, recording))
        assert f'{recording} is a recording, made by {program!r}; name another file' in line
        assert recording.read_bytes() == before
    # What is made here can be made again.
    output = tmp_path / 'out.mcap'
    for _ in range(2):
        assert kinpole('replay', rod, '--output', output).status == 0


def test_a_recording_does_not_begin_on_another(rod: Path) -> None:
    before = rod.read_bytes()
    line = refusal(process('record', '--output', rod))
    assert f'{rod} is there already; name another file' in line
    assert rod.read_bytes() == before


def test_folders_of_outputs_are_made(kinpole: Any, rod: Path, tmp_path: Path) -> None:
    output, table = tmp_path / 'new' / 'out.mcap', tmp_path / 'other' / 'out.csv'
    said = kinpole('replay', rod, '--output', output, '--csv', table)
    assert said.status == 0
    assert f'written to {output}' in said.out
    assert f'written to {table}' in said.out
    assert decoded(output)['/kinpole/body/odom']
    assert table.read_text().startswith('t,body_x,')


# Replays that come to less than was asked for


def test_markers_that_are_in_no_message_are_named_with_those_that_are(
    kinpole: Any, simulated: Bag, tmp_path: Path
) -> None:
    bag = simulated('four_bar', rate=100, duration=0.5)
    bodies = bodies_of('four_bar')
    some = {'crank': (*bodies['crank'], 'crank_9'), 'coupler': bodies['coupler']}
    config = write_config(tmp_path / 'a.yaml', Settings(bodies=some))
    said = kinpole('replay', bag, '--config', config)
    assert said.status == 0
    assert said.err.startswith(
        "kinpole replay: messages lack 'crank_9' of crank; the last one has 'crank_1/0', "
    )
    none = {**some, 'coupler': ('coupler_1', 'cuopler_2')}
    config, output = write_config(tmp_path / 'b.yaml', Settings(bodies=none)), tmp_path / 'out.mcap'
    said = kinpole('replay', bag, '--config', config, '--output', output)
    assert said.status == 2
    assert "messages lack 'cuopler_2' of coupler; " in said.err
    assert 'correct the parameter coupler.markers' in said.err
    assert decoded(output)['/kinpole/crank/odom']


@pytest.mark.parametrize('kind', ['nan', 'single', 'one place'])
def test_a_body_known_at_no_instant_is_told_with_status_2(
    kinpole: Any, tmp_path: Path, kind: str
) -> None:
    bag = tmp_path / 'bag.mcap'
    points = np.full((3, 3), np.nan) if kind == 'nan' else np.zeros((3, 3))
    names = ['a', 'b', 'c'][: 1 if kind == 'single' else 3]
    with BagWriter(bag) as writer:
        for stamp in range(10**9, 2 * 10**9, 10**7):
            message = to_message('point_cloud2', stamp, 'world', names, points[: len(names)])
            writer.write('/markers', message, stamp)
    line = refusal(kinpole('replay', bag))
    assert 'body was never estimated: too few markers seen, or all at one place; fix: see' in line


def test_files_of_a_folder_that_do_not_run_on_are_told_to_be_read_as_one(
    kinpole: Any, rod: Path, simulated: Bag, tmp_path: Path
) -> None:
    joined = 'rod.mcap to rod_2.mcap, 2 files, were read as one recording'
    shutil.copy(rod, rod.parent / 'rod_2.mcap')
    assert joined in kinpole('replay', rod.parent).err
    (rod.parent / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information:\n'
        '  {storage_identifier: mcap, relative_file_paths: [rod.mcap, rod_2.mcap]}\n'
    )
    assert joined not in kinpole('replay', rod.parent).err

    # One recording that was split.
    folder = tmp_path / 'split'
    messages = list(read_messages(simulated('cardan', rate=100, duration=0.6), ['/markers']))
    for name, part in (('a.mcap', messages[:30]), ('b.mcap', messages[30:])):
        with BagWriter(folder / name) as writer:
            for message in part:
                writer.write_raw(message.topic, message.type_name, message.data, message.log_time)
    said = kinpole('replay', folder)
    assert (said.status, said.err) == (0, '')
    assert said.out.startswith('60 frames in')


@pytest.mark.parametrize(
    'stamps, complaint',
    [
        ([], 'the topic has no messages'),
        (
            range(10**9, 2 * 10**9, 10**8),
            'must hold 7 frames, and they come every 0.1 s; fix: raise it',
        ),
        ([0] * 30, 'all stamps are the same; fix: see that the driver sets header.stamp'),
        (
            range(0, 30 * 10**9, 10**9),
            'jump by more than the parameter window, 0.3 s; fix: raise it',
        ),
        (
            range(0, 5 * 10**6, 10**6),
            'when it is 0.1 s old (the parameter lag), and there are 0.004 s',
        ),
        (
            range(0, 24 * 10**7, 4 * 10**7),
            'they take 7 frames, and there are 6; fix: record longer',
        ),
        (
            range(12 * 10**8, 10**9, -(10**7)),
            'the stamps run backward; fix: see that the driver sets',
        ),
    ],
)
def test_why_there_are_no_results_is_told(
    kinpole: Any, tmp_path: Path, stamps: Any, complaint: str
) -> None:
    bag = tmp_path / 'bag.mcap'
    with BagWriter(bag) as writer:
        writer.add_topic('/markers', PoseArray)
        for k, stamp in enumerate(stamps):
            points = np.array([[0.0, 0.0, 0.0], [0.1, 0.001 * k, 0.0]])
            message = to_message('pose_array', stamp, 'world', ['a', 'b'], points)
            writer.write('/markers', message, k)
    assert complaint in refusal(kinpole('replay', bag))


# Damaged bags


@pytest.mark.parametrize('share', [0.35, 0.8])
def test_a_bag_cut_off_gives_the_results_of_all_before_the_cut(
    kinpole: Any, simulated: Bag, tmp_path: Path, share: float
) -> None:
    whole = simulated('four_bar', rate=100, duration=1.5, noise=1e-4)
    data = whole.read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[: int(share * len(data))])
    left = 0
    with pytest.raises(Truncated):
        for _ in read_messages(cut, ['/markers']):
            left += 1
    assert 20 < left < 145

    config = write_config(tmp_path / 'c.yaml', Settings(bodies=bodies_of('four_bar')))
    tables = [tmp_path / f'{name}.csv' for name in ('whole', 'cut')]
    words = ['--config', config, '--csv', tables[0], '--output']
    assert kinpole('replay', whole, *words, tmp_path / 'whole_out.mcap').status == 0
    words[3] = tables[1]
    line = refusal(kinpole('replay', cut, *words, tmp_path / 'cut_out.mcap'))
    assert line.startswith(f'kinpole replay: {cut} ')
    assert f'{left} messages up to stamp' in line

    odom = '/kinpole/coupler/odom'
    found, expected = decoded(tmp_path / 'cut_out.mcap'), decoded(tmp_path / 'whole_out.mcap')
    assert len(found[odom]) == left - 10
    last = stamp_of(found[odom][-1])
    for topic, listed in expected.items():
        if topic not in ('/diagnostics', '/kinpole/rig'):
            kept = [m for m in listed if stamp_of(m) <= last]
            same = found.get(topic, [])
            assert [*map(stamp_of, same)] == [*map(stamp_of, kept)], topic
            assert same == kept, topic
    assert_same_but_for_rounding(*tables)
    assert found['/diagnostics'] == expected['/diagnostics'][: len(found['/diagnostics'])]


def assert_same_but_for_rounding(whole: Path, part: Path) -> None:
    """The rows of `part` are the first ones of `whole`, to 1e-9 of the deviation they state."""
    expected, found = (np.genfromtxt(path, delimiter=',', names=True) for path in (whole, part))
    expected = expected[: len(found)]
    names = expected.dtype.names
    assert names is not None
    for name in names:
        sigma = expected[f'{name}_sigma'] if f'{name}_sigma' in names else 1e-4
        if name.endswith('_sigma'):
            sigma = expected[name]
        gap = np.abs(found[name] - expected[name])
        assert (np.isnan(found[name]) == np.isnan(expected[name])).all(), name
        assert not (gap > 1e-9 * sigma).any(), name


def test_a_bag_cut_in_its_head_is_one_line(kinpole: Any, rod: Path) -> None:
    rod.write_bytes(rod.read_bytes()[:40])
    assert str(rod) in refusal(kinpole('replay', rod))
    rod.write_bytes(b'')
    assert f'{rod} is empty' in refusal(kinpole('replay', rod))


# What is done


def test_replay_warns_of_a_body_whose_markers_are_of_several_links(
    kinpole: Any, tmp_path: Path
) -> None:
    bag = tmp_path / 'markers.mcap'
    assert kinpole('simulate', 'four_bar', '--output', str(bag)).status == 0
    said = kinpole('replay', str(bag))
    assert said.status == 0
    assert 'off one rigid body' in said.err


def test_replay_warns_of_markers_that_were_smoothed_beyond_what_can_be_measured(
    kinpole: Any, tmp_path: Path
) -> None:
    times = np.arange(1000) / 100
    shake = np.fft.rfft(np.random.default_rng(3).normal(size=(1000, 3, 2)), axis=0)
    shake[30:] = 0.0
    shape = np.array([[0.05, 0.03], [-0.05, 0.02], [0.0, -0.05]])
    turn = np.array([[np.cos(times), -np.sin(times)], [np.sin(times), np.cos(times)]])
    seen = np.einsum('ijt,nj->tni', turn, shape) + 1e-3 * np.fft.irfft(shake, axis=0)
    table, bag = tmp_path / 'tracked.csv', tmp_path / 'markers.mcap'
    rows = [','.join(map(repr, row)) for row in seen.reshape(1000, 6).tolist()]
    table.write_text('\n'.join(['a_x,a_y,b_x,b_y,c_x,c_y', *rows]))
    assert kinpole('import', str(table), '--rate', '100', '--output', str(bag)).status == 0
    said = kinpole('replay', str(bag))
    assert said.status == 0
    assert 'send them unsmoothed' in said.err


def test_simulate_replay_and_plot_go_together(kinpole: Any, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    bag, result, picture = (tmp_path / name for name in ('a.mcap', 'b.mcap', 'c.png'))
    said = kinpole('simulate', 'rolling_wheel', '--output', bag, '--rate', '100', '--duration', '1')
    assert (said.status, said.err) == (0, '')
    assert said.out == f'100 frames of wheel written to {bag}\n'
    said = kinpole('replay', bag, '--output', result)
    assert (said.status, said.err) == (0, '')
    assert '100 frames in, 90 instants out' in said.out
    assert 'body: determined at icr 100.0%' in said.out
    said = kinpole('plot', result, '--output', picture)
    assert (said.status, said.err) == (0, '')
    assert picture.read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize('message', ['marker_array', 'marker', 'pose_array', 'point_cloud2'])
def test_simulated_messages_are_of_the_type_asked_for(
    kinpole: Any, tmp_path: Path, message: str
) -> None:
    words = ['--rate', '50', '--duration', '0.5', '--message', message]
    assert kinpole('simulate', 'cardan', '--output', tmp_path / 'a.mcap', *words).status == 0
    assert kinpole('replay', tmp_path / 'a.mcap', '--output', tmp_path / 'b.mcap').status == 0
    assert len(figures(decoded(tmp_path / 'b.mcap'))['/kinpole/body/odom']) > 15


def test_the_seed_decides_the_noise_and_dropout_the_markers_missing(
    kinpole: Any, tmp_path: Path
) -> None:
    def markers(name: str, *words: str) -> list[Any]:
        bag = tmp_path / f'{name}.mcap'
        command = ['simulate', 'four_bar', '--output', bag, '--rate', '50', '--duration', '1']
        assert kinpole(*command, *words).status == 0
        return decoded(bag, '/markers')['/markers']

    noisy = ['--noise', '1e-3', '--dropout', '0.2', '--jitter', '0.001']
    first, again = markers('a', *noisy, '--seed', '3'), markers('b', *noisy, '--seed', '3')
    other, exact = markers('c', *noisy, '--seed', '4'), markers('d')
    assert first == again != other
    assert all(len(message.markers) == 10 for message in exact)
    missing = 1 - np.mean([len(message.markers) for message in first if message.markers]) / 10
    assert 0.14 < missing < 0.26
    steps = np.diff([stamp_of(message) for message in exact])
    assert (steps == 20_000_000).all()
    uneven = np.diff([stamp_of(message) for message in first if message.markers])
    assert uneven.min() > 0
    assert np.ptp(uneven) > 1_000_000


def test_a_table_of_points_becomes_results(kinpole: Any, tmp_path: Path) -> None:
    table, bag = tmp_path / 'table.csv', tmp_path / 'bag.mcap'
    # Two points that turn about (2, 1) by 2 rad/s, in cm, y down.
    t = np.arange(60) / 100
    arms = np.exp(1j * (2 * t[:, None] + [0.0, 1.5])) * [5, 8]
    lines = [f'{a.real + 2},{-(a.imag + 1)},{b.real + 2},{-(b.imag + 1)}' for a, b in arms]
    table.write_text('\n'.join(['a_x,a_y,b_x,b_y', *lines]))
    words = ['--rate', '100', '--scale', '0.01', '--y-down', '--output', bag]
    said = kinpole('import', table, *words)
    assert (said.status, said.out) == (
        0,
        f'60 frames of 2 markers (table, 1 unit = 0.01 m), 0.59 s at 100 Hz, written to {bag}\n',
    )
    assert kinpole('replay', bag, '--output', tmp_path / 'out.mcap').status == 0
    found = decoded(tmp_path / 'out.mcap')
    for icr, omega in zip(
        found['/kinpole/body/icr'], found['/kinpole/body/angular_velocity'], strict=True
    ):
        assert [icr.point.x, icr.point.y] == pytest.approx([0.02, 0.01], abs=1e-9)
        assert omega.vector.z == pytest.approx(2.0)


def test_a_pipe_shows_no_progress_and_a_terminal_does(
    rod: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli.main(['replay', str(rod)]) == 0
    assert capsys.readouterr().err == ''

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, 'stderr', terminal)
    assert cli.main(['replay', str(rod)]) == 0
    shown = terminal.getvalue()
    assert 'replay [' in shown
    assert '100%' in shown
    # The bar is wiped away in the end.
    assert shown.endswith(' \r')

    monkeypatch.setenv('COLUMNS', '40')
    monkeypatch.setattr(sys, 'stderr', terminal := Terminal())
    assert cli.main(['replay', str(rod)]) == 0
    assert max(map(len, terminal.getvalue().split('\r'))) == 39


def test_without_stderr_all_is_done_as_with_it(rod: Path, tmp_path: Path) -> None:
    output = tmp_path / 'out.mcap'
    words = f"'{sys.executable}' -m kinpole_ros.tools.cli replay '{rod}' --output '{output}' 2>&-"
    assert subprocess.run(words, shell=True, stdout=subprocess.DEVNULL, timeout=60).returncode == 0
    assert decoded(output)['/kinpole/body/odom']


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '<&- >&- 2>&-'])
def test_no_file_takes_the_place_of_what_was_closed(tmp_path: Path, closed: str) -> None:
    """All that is told went into the recording, at its place in the file."""
    opened = tmp_path / 'opened'
    code = (
        "from kinpole_ros.tools import cli; cli.main(['solve', 'cardan'])\n"
        f"with open('{opened}', 'w') as file: file.write(str(file.fileno()))"
    )
    subprocess.run(f'{sys.executable} -c "{code}" {closed}', shell=True, check=True, timeout=60)
    assert int(opened.read_text()) > 2


def test_what_stdout_has_no_letters_for_is_told_all_the_same(rod: Path) -> None:
    said = process('solve', 'four_bar', env={**os.environ, 'PYTHONIOENCODING': 'ascii'})
    assert (said.status, said.err) == (0, '')
    assert '\\u03c9 rad/s' in said.out
    odd = rod.parent / os.fsdecode(b'no text \xff.csv')
    assert process('replay', rod, '--csv', odd).status == 0
    assert odd.exists()


@pytest.mark.parametrize(('cause', 'status'), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
def test_interrupted_in_an_extension_it_ends_as_at_any_place(
    kinpole: Any, monkeypatch: pytest.MonkeyPatch, cause: BaseException, status: int
) -> None:
    def interrupted(*_: object) -> None:
        raise SystemError('<class> returned a result with an exception set') from cause

    monkeypatch.setattr(COMMAND_MODULES['plot'], 'run', interrupted)
    assert kinpole('plot', 'results.mcap', '--output', 'picture.png') == (status, '', '')


@pytest.mark.parametrize('words', [['solve', 'four_bar', '--plot', 'p.png'], ['bench', '--quick']])
def test_missing_matplotlib_is_told_with_the_mend(
    kinpole: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.partition('.')[0] == 'matplotlib']:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    line = refusal(kinpole(*words))
    assert 'needs matplotlib; install it with pip install matplotlib' in line


@pytest.mark.parametrize(
    'package, words, told',
    [
        ('rclpy', ['node'], 'rclpy cannot be imported; source a ROS 2 installation'),
        ('rclpy', ['play', 'a.mcap'], 'rclpy cannot be imported; source a ROS 2 installation'),
        ('rclpy', ['solve', 'five_bar'], 'five_bar.yaml: there is no such scene'),
        ('mcap', ['solve', 'five_bar'], 'five_bar.yaml: there is no such scene'),
        ('mcap', ['import', 'a.csv', '--output', 'x'], "install it with pip install 'mcap>=1.5'"),
        ('yaml', ['solve', 'four_bar'], 'yaml cannot be imported; install it with'),
    ],
)
def test_a_package_that_is_not_there_is_told_with_the_mend(
    tmp_path: Path, package: str, words: list[str], told: str
) -> None:
    program = (
        f'import sys; sys.modules[{package!r}] = None\n'
        f'from kinpole_ros.tools import cli; sys.exit(cli.main({words!r}))'
    )
    done = subprocess.run(
        [sys.executable, '-c', program], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert told in refusal(Said(done.returncode, done.stdout, done.stderr))


@pytest.mark.parametrize(
    'content, told',
    [
        (b'', 'rclpy is installed but has no _rclpy_pybind11 for Python 3.'),
        (b'no library', 'rclpy is installed but fails to load: '),
    ],
    ids=['of another Python', 'spoiled'],
)
def test_an_rclpy_that_cannot_load_is_told_by_its_own_error(
    tmp_path: Path, content: bytes, told: str
) -> None:
    """As with a ROS installation for another Python, or without the libraries it links to."""
    package = tmp_path / 'rclpy'
    package.mkdir()
    (package / '__init__.py').write_text('from rclpy import _parts\n')
    code = "import importlib\nimportlib.import_module('._rclpy_pybind11', package='rclpy')\n"
    (package / '_parts.py').write_text(code)
    if content:
        suffix = importlib.machinery.EXTENSION_SUFFIXES[0]
        (package / f'_rclpy_pybind11{suffix}').write_bytes(content)
    paths = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])
    line = refusal(process('node', env={**os.environ, 'PYTHONPATH': paths}))
    assert told in line
    assert 'pip install _rclpy_pybind11' not in line
    assert 'fix: run kinpole with the Python and in the environment of that ROS 2' in line


def test_commands_that_install_name_packages_of_the_extra() -> None:
    """The names of extras would do in a checkout only: no package index has kinpole_ros."""
    root = Path(__file__).parents[2]
    setup = ast.parse((root / 'setup.py').read_text())
    constants = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in setup.body
        if isinstance(node, ast.Assign) and node.targets[0].id == 'ROS'
    }
    words = {node.arg: node.value for node in ast.walk(setup) if isinstance(node, ast.keyword)}
    extras = words['extras_require']
    declared = {
        key.value: constants[value.id] if isinstance(value, ast.Name) else ast.literal_eval(value)
        for key, value in zip(extras.keys, extras.values, strict=True)
    }
    for extra, names in EXTRAS.items():
        assert [re.split('[<>=]', name)[0] for name in declared[extra]] == [*names], extra
    pages = [*root.glob('kinpole_ros/**/*.py'), *root.glob('docs/**/*.md')]
    assert [page for page in pages if 'kinpole_ros' + '[' in page.read_text()] == []


def test_a_reader_that_goes_away_is_no_error(rod: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    words = [sys.executable, '-m', 'kinpole_ros.tools.cli', 'replay', str(rod)]
    with os.fdopen(writing, 'wb') as out:
        done = subprocess.run(words, stdout=out, stderr=subprocess.PIPE, text=True, timeout=60)
    assert 'Traceback' not in done.stderr
