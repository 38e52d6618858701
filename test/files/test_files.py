"""Files of strangers are refused at once, in one line, and none of them is waited for."""

import errno
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

import pytest
import rclpy
import yaml
from fuzz_kills import COMMANDS, fuzz_kills
from geometry_msgs.msg import Point
from rclpy.node import Node

from kinpole_ros.bags import (
    BagError,
    BagWriter,
    Truncated,
    bag_files,
    import_points,
    read_messages,
)
from kinpole_ros.files import cut, cut_line, open_regular, printable, read_limited, whole_file
from kinpole_ros.files.bounded_yaml import load_yaml
from kinpole_ros.mechanism import SceneError, load_scene
from kinpole_ros.settings import ParameterError, assignments, load_settings
from kinpole_ros.tools import commands
from kinpole_ros.tools.cli import main

MAGIC = b'\x89MCAP0\r\n'
LAUGHS = 'a: &a [x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{name}: &{name} [{", ".join([f"*{before}"] * 8)}]\n'
    for before, name in zip('abcdefg', 'bcdefgh', strict=True)
)
MERGES = 'a: &a {x: 1}\n' + ''.join(
    f'{name}: &{name} {{<<: [{", ".join([f"*{before}"] * 8)}]}}\n'
    for before, name in zip('abcdefg', 'bcdefgh', strict=True)
)


def fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def one_line(error: pytest.ExceptionInfo[Exception]) -> str:
    text = str(error.value)
    assert text.isprintable()
    assert len(text) < 3000
    return text


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        (LAUGHS, 'aliases'),
        (MERGES, 'aliases'),
        ('junk\n' * 1_000_000, 'larger than 1 MiB'),
        ('- a\n' * 200_000, 'more than '),
        ('[' * 100_000, 'nesting'),
        ('? ' * 100_000, 'nesting'),
        ('%TAG !a! x\n' * 50_000, 'directives'),
        ('a: 1\nb: 2\na: 3\n', "the key 'a' is given twice"),
    ],
    ids=['aliases', 'merges', 'junk', 'many', 'deep', 'keys', 'directives', 'twice'],
)
def test_yaml_that_would_take_long_or_much_is_refused(
    tmp_path: Path, text: str, complaint: str
) -> None:
    with pytest.raises(yaml.YAMLError, match=complaint.replace('(', r'\(')):
        load_yaml(text)
    for name, read, error in (
        ('metadata.yaml', lambda path: bag_files(path.parent), BagError),
        ('config.yaml', load_settings, ParameterError),
        ('scene.yaml', load_scene, SceneError),
    ):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(error) as refused:
            read(path)
        assert complaint in one_line(refused)
        assert name in one_line(refused)


def test_numbers_of_many_parts_stay_texts() -> None:
    # PyYAML takes minutes to make a number of this.
    text = '1' + ':1' * 400_000
    assert load_yaml(f'a: {text}') == {'a': text}


@pytest.mark.parametrize('make', [fifo, lambda path: path.symlink_to('/dev/zero')])
@pytest.mark.parametrize(
    'read',
    [
        load_settings,
        load_scene,
        bag_files,
        lambda path: import_points(path, path.parent / 'out.mcap'),
        open_regular,
    ],
    ids=['config', 'scene', 'bag', 'table', 'any'],
)
def test_what_is_no_regular_file_is_refused_without_waiting_for_it(
    tmp_path: Path, make: Callable[[Path], Any], read: Callable[[Path], Any]
) -> None:
    path = tmp_path / 'odd.yaml'
    make(path)
    with pytest.raises((ParameterError, SceneError, BagError, OSError)) as refused:
        read(path)
    assert 'odd.yaml' in one_line(refused)


def test_a_file_larger_than_it_need_be_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / 'sparse'
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(OSError, match='larger than 1 MiB'):
        read_limited(path, 1 << 20)


def about(*names: str, **more: str) -> str:
    listed = ', '.join(f'"{name}"' for name in names)
    rows = [
        f'storage_identifier: {more.pop("storage", "mcap")}',
        f'relative_file_paths: [{listed}]',
    ]
    rows += [f'{key}: {value}' for key, value in more.items()]
    return f'rosbag2_bagfile_information: {{{", ".join(rows)}}}\n'


def folder_of(place: Path, *names: str) -> Path:
    folder = place / 'bag'
    folder.mkdir()
    for name in names:
        (folder / name).write_bytes(MAGIC)
    return folder


def of_a_fifo(folder: Path, outside: Path) -> None:
    fifo(folder / 'b.mcap')


def of_a_fifo_that_is_named(folder: Path, outside: Path) -> None:
    fifo(folder / 'b.mcap')
    (folder / 'metadata.yaml').write_text(about('a.mcap', 'b.mcap'))


def of_a_fifo_for_metadata(folder: Path, outside: Path) -> None:
    fifo(folder / 'metadata.yaml')


def of_a_link_to_a_device(folder: Path, outside: Path) -> None:
    (folder / 'b.mcap').symlink_to('/dev/zero')


def of_a_link_elsewhere(folder: Path, outside: Path) -> None:
    (folder / 'b.mcap').symlink_to(outside)


def of_a_link_elsewhere_that_is_named(folder: Path, outside: Path) -> None:
    of_a_link_elsewhere(folder, outside)
    (folder / 'metadata.yaml').write_text(about('a.mcap', 'b.mcap'))


def of_a_folder_that_is_a_link(folder: Path, outside: Path) -> None:
    (folder / 'sub').symlink_to(outside.parent)
    (folder / 'metadata.yaml').write_text(about(f'sub/{outside.name}'))


def of_metadata_elsewhere(folder: Path, outside: Path) -> None:
    (outside.parent / 'about.yaml').write_text(about('a.mcap'))
    (folder / 'metadata.yaml').symlink_to(outside.parent / 'about.yaml')


def of_metadata_that_is_gone(folder: Path, outside: Path) -> None:
    (folder / 'metadata.yaml').symlink_to(folder / 'none')


def of_one_file_three_times(folder: Path, outside: Path) -> None:
    (folder / 'metadata.yaml').write_text(about(*['a.mcap'] * 3))


def of_one_file_by_two_names(folder: Path, outside: Path) -> None:
    os.link(folder / 'a.mcap', folder / 'b.mcap')


def of_one_file_by_another_path(folder: Path, outside: Path) -> None:
    (folder / 'metadata.yaml').write_text(about('a.mcap', './a.mcap'))


def of_long_values(folder: Path, outside: Path) -> None:
    (folder / 'metadata.yaml').write_text(about('a.mcap', storage='x' * 500_000))


def of_nested_values(folder: Path, outside: Path) -> None:
    nested = '[' + 'x, ' * 20_000 + ']'
    (folder / 'metadata.yaml').write_text(about('a.mcap', compression_format=nested))


def of_values_for_a_terminal(folder: Path, outside: Path) -> None:
    (folder / 'metadata.yaml').write_text(about('a.mcap', storage='"\\e[2J"'))


def of_a_folder_for_a_file(folder: Path, outside: Path) -> None:
    (folder / 'b.mcap').mkdir()


@pytest.mark.parametrize(
    'made', [made for name, made in globals().items() if name.startswith('of_')]
)
def test_a_folder_is_trusted_no_more_than_a_bag(
    tmp_path: Path, made: Callable[[Path, Path], None]
) -> None:
    folder = folder_of(tmp_path, 'a.mcap')
    outside = tmp_path / 'outside.mcap'
    outside.write_bytes(MAGIC)
    made(folder, outside)
    with pytest.raises(BagError) as refused:
        bag_files(folder)
    assert str(folder) in one_line(refused)


def test_links_within_a_folder_and_to_a_bag_are_followed(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 'a.data')
    (folder / 'a.mcap').symlink_to('a.data')
    link = tmp_path / 'link'
    link.symlink_to(folder)
    assert bag_files(link) == [link / 'a.mcap']
    (tmp_path / 'one.mcap').symlink_to(folder / 'a.mcap')
    assert bag_files(tmp_path / 'one.mcap') == [tmp_path / 'one.mcap']


def test_what_is_shown_is_short_and_no_command_to_a_terminal() -> None:
    assert cut('x' * 1000) == 'x' * 80 + '...'
    assert cut('\x1b[2J') == "'\\x1b[2J'"
    assert printable('a\x1b[2J\u202eb') == 'a\\x1b[2J\\u202eb'
    assert len(cut_line('x' * 10_000, 100)) < 110


# Results.


@pytest.mark.parametrize('ending', [None, OSError, KeyboardInterrupt])
def test_a_result_is_whole_or_not_there(tmp_path: Path, ending: type[BaseException] | None) -> None:
    new, old, link = tmp_path / 'new' / 'a.csv', tmp_path / 'old.csv', tmp_path / 'link'
    old.write_text('before')
    old.chmod(0o640)
    link.symlink_to(old)
    for path in (new, link):
        try:
            with whole_file(path) as part:
                part.write_text('half')
                assert (path.read_text() == 'before') if path.exists() else path is new
                part.write_text('after')
                if ending is not None:
                    raise ending
        except (OSError, KeyboardInterrupt):
            assert ending is not None
    assert old.read_text() == ('before' if ending else 'after')
    assert new.exists() == (ending is None)
    assert link.is_symlink()
    assert old.stat().st_mode & 0o777 == 0o640
    assert not [*tmp_path.rglob('*.part')]


def test_two_at_one_result_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / 'a.csv'
    with whole_file(path) as one:
        one.write_text('one')
        with whole_file(path) as other:
            other.write_text('other')
        assert path.read_text() == 'other'
    assert path.read_text() == 'one'


def test_what_a_killed_process_left_goes_with_the_next_result(tmp_path: Path) -> None:
    path = tmp_path / 'a[1].csv'
    dead, other = tmp_path / 'a[1].csv.01234567.part', tmp_path / 'a[1].csv.my_notes.part'
    with whole_file(path) as live:
        dead.touch()
        other.touch()
        with whole_file(path) as part:
            part.write_text('after')
        assert live.exists()
    assert sorted(tmp_path.iterdir()) == [path, other]


def test_a_signal_amid_any_line_of_the_writer_ends_it_and_leaves_whole_chunks(
    tmp_path: Path,
) -> None:
    """SIGTERM raises SystemExit wherever the program is."""
    columns = [('/a', Point, [1, 2], [bytes(200_000)] * 2)]
    own_or_mcaps = '_writer.py', 'mcap/writer.py', '_chunk_builder.py', 'records.py'
    line, last = 0, -1

    def step(frame: FrameType, event: str, arg: Any) -> Any:
        nonlocal line
        line += event == 'line'
        if line == last:
            sys.settrace(None)
            raise SystemExit(143)
        return step if frame.f_code.co_filename.endswith(own_or_mcaps) else None

    def write() -> None:
        nonlocal line
        with BagWriter(tmp_path / 'out.mcap') as bag:
            line = 0
            sys.settrace(step)
            try:
                bag.write_many(columns)
            finally:
                sys.settrace(None)

    before = sys.gettrace()
    try:
        write()
        for last in range(1, line):  # noqa: B007 - `step` looks at it
            with pytest.raises(SystemExit):
                write()
            fault = ''
            try:
                count = len(list(read_messages(tmp_path / 'out.mcap')))
            except Truncated as error:
                fault = str(error)
            assert 'is cut off' in fault or (not fault and count <= 2)
    finally:
        sys.settrace(before)
    assert last > 100


def test_stopped_at_any_moment_a_replay_leaves_what_was_there_or_all_of_its_own(
    tmp_path: Path,
) -> None:
    pytest.importorskip('pyarrow')
    outcomes = fuzz_kills(1, seed=5, folder=tmp_path, commands=COMMANDS[:1])
    assert outcomes['as before'] > 0


def test_what_is_no_file_is_written_as_it_goes_and_stays(tmp_path: Path) -> None:
    with whole_file('/dev/null') as place:
        assert place == Path('/dev/null')
    assert Path('/dev/null').is_char_device()
    with pytest.raises(IsADirectoryError), whole_file(tmp_path):
        pass


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bag, its results and a table."""
    folder = tmp_path_factory.mktemp('made')
    bag = str(folder / 'bag.mcap')
    simulated = ['simulate', 'cardan', '--duration', '1', '--rate', '100', '--noise', '1e-5']
    assert main([*simulated, '--output', bag]) == 0
    assert main(['replay', bag, '--output', str(folder / 'result.mcap')]) == 0
    (folder / 'table.csv').write_text('t,a_x,a_y\n0,1,2\n1,2,3\n')
    return folder


@pytest.mark.parametrize(
    'words',
    [
        'replay {0}/bag.mcap --output {1}.mcap',
        'replay {0}/bag.mcap --csv {1}.csv',
        'replay {0}/bag.mcap --parquet {1}.parquet',
        'simulate cardan --duration 0.1 --output {1}.mcap',
        'import {0}/table.csv --output {1}.mcap',
        'plot {0}/result.mcap --output {1}.png',
        'solve four_bar --csv {1}.csv',
        'solve four_bar --plot {1}.png',
        'solve four_bar --pitch coupler ground {1}.svg',
        'discover {0}/bag.mcap --output {1}.yaml',
    ],
)
def test_every_command_leaves_the_result_of_before_until_its_own_is_whole(
    made: Path,
    tmp_path: Path,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name, package in (('.parquet', 'pyarrow'), ('.png', 'matplotlib')):
        if name in words:
            pytest.importorskip(package)
    given = words.format(made, tmp_path / 'out').split()
    path = Path(given[-1])
    path.write_text('before')
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr('kinpole_ros.files._writing.os.fsync', mock.Mock(side_effect=full))
    handler = signal.getsignal(signal.SIGTERM)
    assert main(given) == 2
    assert signal.getsignal(signal.SIGTERM) == handler
    said = capsys.readouterr().err
    assert f'{path} cannot be written: No space left on device; fix: ' in said.splitlines()[-1]
    assert path.read_text() == 'before'
    assert sorted(tmp_path.iterdir()) == [path]


# What replay makes of a value, and what the node, of which ROS reads the parameters.

VALUES = [
    '1_000',
    '1:30',
    '{}',
    '010',
    '0x10',
    '1e-3',
    '1.',
    '.5',
    '+5',
    'yes',
    'Y',
    'y',
    'on',
    'off',
    'n',
    'null',
    '~',
    'nan',
    '.nan',
    '.inf',
    'inf',
    'infinity',
    '-.inf',
    '"5"',
    '2001-01-01',
    '[1,2]',
    '[1,2.5]',
    '[]',
    '[a,1]',
    '0b1',
    '1e5',
    '1E5',
    '0x1p3',
    '-0',
    '0o7',
    '9223372036854775808',
    '1e400',
    '1e-400',
    '[true,yes]',
    '[y,1]',
    '[y,n]',
    '["1","2"]',
    'TRUE',
    'tRUE',
    '0.5e',
    '1e',
    '=',
    '<<',
    '[~]',
    '[a,]',
    '{a:1}',
    '.Inf',
    '+.nan',
    '.',
    '1__0',
    '08',
    '1d3',
    '99999999999999999999.5',
    '[0,-0.5]',
    '[0x10,2]',
    '0x',
    '0x.8',
    '-0x1F',
    '1.e5',
    '+.5e-2',
    'Infinity',
    'nAn',
]
TAGGED = ['!!str 5', '!!int "5"', '!!float 5', '!!null x', '!foo 5', '!!bool yes', "'5'", '', '*a']


def test_replay_reads_the_values_of_parameters_as_ros_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '93')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    differing = []
    good: list[str] = []
    for text in (*VALUES, *TAGGED):
        try:
            values = assignments([f'p:={text}'])
        except ParameterError:
            values = None
        if values is None:
            if as_ros_reads(tmp_path, [text]) is not None:
                differing.append(text)
        else:
            good.append(text)
    # Those that it takes at once, for it takes its time to start.
    read = as_ros_reads(tmp_path, good)
    assert read is not None
    for k, text in enumerate(good):
        ours = list(assignments([f'p:={text}']).items())
        names = {f'p{k}': 'p', f'p{k}.a': 'p.a'}
        theirs = [(names[name], value) for name, value in read.items() if name in names]
        if repr(ours) != repr(theirs):
            differing.append(f'{text}: {ours} {theirs}')
    assert differing == []


def as_ros_reads(place: Path, texts: list[str]) -> dict[str, Any] | None:
    """What a node gets for parameters p0, p1, ... of these values; None if it does not start."""
    path = place / 'values.yaml'
    rows = ''.join(f'    p{k}: {text}\n' for k, text in enumerate(texts))
    path.write_text(f'/**:\n  ros__parameters:\n{rows}')
    context = rclpy.Context()
    try:
        rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
        node = Node(
            'values',
            context=context,
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
        )
    except Exception:
        return None
    else:
        found = {
            name: value.tolist() if hasattr(value := p.value, 'tolist') else value
            for name, p in node.get_parameters_by_prefix('').items()
        }
        node.destroy_node()
        return found
    finally:
        context.try_shutdown()


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('window: 1_000', "parameter window is '1_000'"),
        ('window: 1:30', "parameter window is '1:30'"),
        ('window: {}', 'parameter window has no value'),
        ('window:', 'parameter window has no value'),
        ('bodies: []', 'parameter bodies has no value'),
        ('plane: [0, -0.5, 0.87]', 'a list of several types; give all numbers of a list a point'),
        ('window: 0.2\n    window: 0.3', "the key 'window' is given twice"),
        ('a.b: 1\n    a: {b: 2}', 'parameter a.b is given twice; keep one'),
    ],
)
def test_values_that_the_node_refuses_are_refused_in_a_file(
    tmp_path: Path, text: str, complaint: str
) -> None:
    path = tmp_path / 'config.yaml'
    path.write_text(f'/**:\n  ros__parameters:\n    {text}\n')
    with pytest.raises(ParameterError) as refused:
        load_settings(path)
    assert complaint in one_line(refused)
    assert 'config.yaml' in one_line(refused)


@pytest.mark.parametrize('command', ['report', 'fit', 'layout', 'batch', 'plot'])
def test_a_command_that_writes_files_ends_in_good_order_by_sigterm(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM left the incomplete files of some."""
    cleaned = []

    def run(_: object) -> int:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            return 0
        finally:
            cleaned.append(command)

    monkeypatch.setattr(commands.COMMANDS[command], 'run', run)
    words = {
        'report': ['report', 'x'],
        'fit': ['fit', 'x', 'y'],
        'layout': ['layout', 'foxglove', '--output', 'x'],
        'batch': ['batch', 'x', '--output', 'y'],
        'plot': ['plot', 'x', '--output', 'y'],
    }
    with pytest.raises(SystemExit, match=str(128 + signal.SIGTERM)):
        main(words[command])
    assert cleaned == [command]
