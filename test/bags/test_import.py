"""Tables of tracked points become bags; a cell that is wrong is named by line and column."""

import os
import re
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from kinpole_ros.bags import (
    BagError,
    import_points,
    read_messages,
    replay,
    topics,
)
from kinpole_ros.bags.formats import FORMATS, read_points
from kinpole_ros.messages import deserialize_message
from kinpole_ros.messages._types import MarkerArray
from kinpole_ros.settings import settings_from
from kinpole_ros.tools.cli import main

DATA = Path(__file__).parents[3] / 'shared' / 'data' / 'double_pendulum' / 'run16.csv'


def import_text(folder: Path, text: str | bytes, **options) -> list[tuple[int, dict]]:
    """Stamp and marker positions by name of each frame of the bag made from a CSV text."""
    table, bag = folder / 'table.csv', folder / 'out.mcap'
    table.write_bytes(text if isinstance(text, bytes) else text.encode())
    count = import_points(table, bag, **options).frames
    frames = []
    for message in read_messages(bag):
        markers = deserialize_message(message.data, MarkerArray).markers
        positions = {
            m.ns: (m.pose.position.x, m.pose.position.y, m.pose.position.z) for m in markers
        }
        for marker in markers:
            stamp = marker.header.stamp
            assert stamp.sec * 1_000_000_000 + stamp.nanosec == message.log_time
        frames.append((message.log_time, positions))
    assert len(frames) == count
    return frames


def test_times_points_and_names(tmp_path):
    text = (
        'frame,t,red_x,red_y,top left_x,top left_y,top left_z\n7,2,1,2,3,4,5\n8,2.5,6,7,8,9,1e1\n'
    )
    assert import_text(tmp_path, text) == [
        (2_000_000_000, {'red': (1.0, 2.0, 0.0), 'top left': (3.0, 4.0, 5.0)}),
        (2_500_000_000, {'red': (6.0, 7.0, 0.0), 'top left': (8.0, 9.0, 10.0)}),
    ]
    assert topics(tmp_path / 'out.mcap') == {'/markers': 'visualization_msgs/msg/MarkerArray'}


def test_scale_and_y_down(tmp_path):
    text = 't,a_x,a_y,a_z\n1,10,20,30\n'
    (_, markers), *_ = import_text(tmp_path, text, scale=0.1, y_down=True)
    assert markers['a'] == pytest.approx((1.0, -2.0, 3.0))
    (message,) = read_messages(tmp_path / 'out.mcap')
    assert message.topic == '/markers'
    assert deserialize_message(message.data, MarkerArray).markers[0].header.frame_id == 'world'


def test_missing_cells_are_missing_markers_and_all_missing_an_empty_array(tmp_path):
    text = 't,a_x,a_y,b_x,b_y\n1,,,3,4\n2,nan,NaN,5,6\n3,1, ,,\n4,1,2,3,4\n'
    frames = import_text(tmp_path, text)
    assert [set(markers) for _, markers in frames] == [{'b'}, {'b'}, set(), {'a', 'b'}]


@pytest.mark.parametrize('row', ['', '\r\n\r\n'])
def test_spreadsheet_habits_are_read(tmp_path, row):
    text = b'\xef\xbb\xbf"t", a_x ,"a_y",\r\n1, 1.5,"2",\r\n2,3,4,left\r\n' + row.encode()
    assert import_text(tmp_path, text) == [
        (1_000_000_000, {'a': (1.5, 2.0, 0.0)}),
        (2_000_000_000, {'a': (3.0, 4.0, 0.0)}),
    ]


@pytest.mark.parametrize(
    ('times', 'stamps'),
    [
        ('0 0.004 0.008', [0, 4_000_000, 8_000_000]),
        ('-0.5 0 0.25', [0, 500_000_000, 750_000_000]),
        ('0.004 0.008 1', [4_000_000, 8_000_000, 1_000_000_000]),
        ('1700000000 1700000000.5', [1_700_000_000_000_000_000, 1_700_000_000_500_000_000]),
    ],
)
def test_stamps_are_t_unless_t_starts_before_zero(tmp_path, times, stamps):
    text = 't,a_x,a_y\n' + ''.join(f'{time},0,0\n' for time in times.split())
    assert [stamp for stamp, _ in import_text(tmp_path, text)] == stamps


def turning(first: float, seen: int) -> str:
    """A body that turns, at 100 Hz from `first` on, hidden to 0.5 s after `seen` frames."""
    lines = ['t,a_x,a_y,b_x,b_y']
    for k in [*range(seen), *range(50, 300)]:
        a, b = 0.1 * np.exp(0.02j * k), 0.2 * np.exp(0.02j * k + 1j)
        lines.append(f'{first + k / 100:.2f},{a.real},{a.imag},{b.real},{b.imag}')
    return '\n'.join(lines)


@pytest.mark.parametrize('seen', [1, 50])
def test_a_table_from_time_zero_replays_as_the_same_one_from_another_time(tmp_path, seen):
    """A stamp of 0 is a time like any other, in the figures and in what is said of outages."""
    tables, said = [], []
    for first in (0.0, 5.0):
        import_text(tmp_path, turning(first, seen))
        settings = settings_from({'window': 0.2, 'bodies': ['rod'], 'rod.markers': ['a', 'b']})
        done = replay(tmp_path / 'out.mcap', settings, csv=tmp_path / 'out.csv')
        rows = np.genfromtxt(tmp_path / 'out.csv', delimiter=',', skip_header=1)
        rows[:, 0] -= first
        tables.append(rows)
        outages = [one for one in done.findings if one.code.endswith(('not_seen', 'no_frames'))]
        said.append([(one.subject, one.values['times']) for one in outages])
    assert tables[0][0, 0] == (0 if seen == 50 else 0.5)
    assert np.isfinite(tables[0]).any(axis=0)[:10].all()
    np.testing.assert_allclose(tables[0], tables[1], rtol=1e-9, atol=1e-9)
    assert said[0] == said[1]
    assert bool(said[0]) == (seen == 1)


def test_times_before_zero_are_told(tmp_path):
    (tmp_path / 't.csv').write_text('t,a_x,a_y\n-0.5,0,0\n0,0,0\n')
    (note,) = import_points(tmp_path / 't.csv', tmp_path / 'o.mcap').notes
    assert 'begins at -0.5 s' in note


@pytest.mark.parametrize(
    ('title', 'unit'),
    [
        ('time', 1.0),
        ('Time', 1.0),
        ('time (s)', 1.0),
        ('t [s]', 1.0),
        ('timestamp', 1.0),
        ('Time (Seconds)', 1.0),
        ('time_ms', 1e3),
        ('Timestamp [us]', 1e6),
        ('time_s', 1.0),
    ],
)
def test_a_column_named_as_one_of_times_is_one(tmp_path, title, unit):
    text = f'{title},a_x,a_y\n{0.25 * unit},0,0\n{0.5 * unit},0,0\n'
    assert [stamp for stamp, _ in import_text(tmp_path, text)] == [250_000_000, 500_000_000]


def test_a_column_that_may_not_be_the_times_is_asked_for(tmp_path):
    with pytest.raises(BagError, match="in any of 'time', 'timestamp'; fix: name the one to use t"):
        import_text(tmp_path, 'time,timestamp,a_x,a_y\n1,2,0,0\n')
    with pytest.raises(BagError, match=r"'time \[frames\]' is in a unit that is not known; fix: "):
        import_text(tmp_path, 'time [frames],a_x,a_y\n1,0,0\n')
    text = 'time,t,a_x,a_y\n9,1,0,0\n'
    assert [stamp for stamp, _ in import_text(tmp_path, text)] == [1_000_000_000]


@pytest.mark.parametrize('command', ['discover', 'fit', 'replay', 'plot', 'batch'])
def test_a_table_in_place_of_a_bag_is_sent_to_import(tmp_path, capsys, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    Path('film.csv').write_text('t,a_x,a_y\n1,0,0\n')
    Path('config.yaml').write_text('/**:\n  ros__parameters:\n    window: 0.3\n')
    scene = ['no_such_scene'] if command == 'fit' else []
    words = {
        'replay': ['--csv', 'o.csv'],
        'plot': ['--output', 'o.png'],
        'batch': ['--config', 'config.yaml', '--output', 'o'],
    }
    assert main([command, *scene, 'film.csv', *words.get(command, [])]) == 2
    out, err = capsys.readouterr()
    assert re.search(
        'film.csv is a file of points.*`kinpole import .*film.csv --output .*film.mcap`', out + err
    )


def test_rate_wins_over_t_and_does_not_drift(tmp_path):
    text = 't,a_x,a_y\n' + 'x,0,0\n' * 301
    stamps = [stamp for stamp, _ in import_text(tmp_path, text, rate=300.0)]
    assert stamps[0] == 0
    assert stamps[1] == 3_333_333
    assert stamps[2] == 6_666_667
    assert stamps[300] == 1_000_000_000


@pytest.mark.parametrize(
    ('text', 'rate', 'complaint'),
    [
        ('', None, 'is empty'),
        ('\n\n', None, 'is empty'),
        ('t,a_x,a_y\n', None, 'has no frames'),
        ('t,a_x,a_y\n1,0,0\n2,0,zero\n', None, "line 3, column a_y: 'zero' is not a number"),
        ('t,a_x,a_y\n\n1,0,0\n\n2,0,"1,5"\n', None, "line 5, column a_y: '1,5' is not a number"),
        ('t,a_x,a_y\n1,inf,0\n', None, "line 2, column a_x: 'inf' is not a number"),
        ('t,a_x,a_y\n1,1e999,0\n', None, "line 2, column a_x: '1e999' is not a number"),
        ('t,a_x,a_y\nnow,0,0\n', None, "line 2, column t: 'now' is not a number"),
        ('t,a_x,a_y\n1,0,0\n,0,0\n', None, "line 3, column t: '' is not a time"),
        ('t,a_x,a_y\n,0,0\n1,0,0\n', None, "line 2, column t: '' is not a time"),
        ('t,a_x,a_y\n1,0,0\nnan,0,0\n', None, "line 3, column t: '' is not a time"),
        # An int32 has no more seconds.
        ('t,a_x,a_y\n2147483648,0,0\n', None, "'2147483648' is not a time in seconds"),
        ('t,a_x,a_y\n1,0,0\n2,0,0\n2,0,0\n', None, "line 4, column t: '2' is not later"),
        ('t,a_x,a_y\n0,0,0\n-1,0,0\n', None, "line 3, column t: '-1' is not later"),
        ('a_x,a_y\n1,2\n', None, 'has no times'),
        ('t,a_x\n1,2\n', None, "marker 'a' has no column a_y"),
        ('t,a_y\n1,2\n', None, "marker 'a' has no column a_x"),
        ('t,a_x,a_y,b_z\n1,2,3,4\n', None, "marker 'b' has no column b_x"),
        ('t,a,b\n1,2,3\n', None, 'no column is named NAME_x'),
        ('t,_x,_y\n1,2,3\n', None, 'no column is named NAME_x'),
        ('t,a_x,a_y,a_x\n1,2,3,4\n', None, "line 1: column 'a_x' is there twice"),
        ('t,a_x,a_y\n1,2\n', None, 'line 2: 2 cells under 3 names'),
        ('t,a_x,a_y\n1,2,3\n1,2,3,4\n', None, 'line 3: 4 cells under 3 names'),
        (b't,a_x,a_y\n1,2,3\n2,\xb5,3\n', None, 'line 3: not UTF-8'),
        ('t,a_x,a_y\n1,2,3\n'.encode('utf-16'), None, 'line 1: not UTF-8'),
        ('t,a_x,a_y\n1,"2"x,3\n', None, 'line 2: '),
        ('t,a_x,a_y\n1,"2,3\n', None, 'line 2: '),
        ('a_x,a_y\n1,2\n', 0.0, 'rate is 0'),
        ('a_x,a_y\n1,2\n', -5.0, 'rate is -5'),
        ('a_x,a_y\n1,2\n', np.nan, 'rate is nan'),
        ('a_x,a_y\n1,2\n', 1e-10, 'rate is 1e-10'),
        ('a_x,a_y\n1,2\n', 1.1e9, 'rate is 1.1e[+]09'),
    ],
)
def test_bad_table_is_one_line_and_leaves_the_output_alone(tmp_path, text, rate, complaint):
    (tmp_path / 'out.mcap').write_text('precious')
    with pytest.raises(BagError, match=complaint) as error:
        import_text(tmp_path, text, rate=rate)
    assert '\n' not in str(error.value)
    assert 'fix: ' in str(error.value)
    if rate is None:
        assert 'table.csv' in str(error.value)
    assert (tmp_path / 'out.mcap').read_text() == 'precious'


def test_more_columns_than_a_rig_has_are_refused(tmp_path):
    header = 't,' + ','.join(f'm{k}_x,m{k}_y' for k in range(5000))
    with pytest.raises(BagError, match='line 1: 10001 columns; fix: give 10000 at most'):
        import_text(tmp_path, f'{header}\n')


def test_a_point_that_was_not_seen_has_no_z(tmp_path):
    (tmp_path / 'table.csv').write_text('t,a_x,a_y,b_x,b_y\n1,2,3,,\n2,,4,5,6\n')
    _, read = read_points(tmp_path / 'table.csv')
    is_seen = [[True, False], [False, True]]
    np.testing.assert_array_equal(np.isfinite(read.points[..., 2]), is_seen)


@pytest.mark.parametrize('scale', [0.0, -1.0, 1e308, np.inf, np.nan])
def test_bad_scale_is_refused(tmp_path, scale):
    with pytest.raises(BagError, match='scale is'):
        import_text(tmp_path, 't,a_x,a_y\n1,2,3\n', scale=scale)


def test_missing_table_and_table_as_output(tmp_path):
    with pytest.raises(BagError, match='cannot be read: No such file'):
        import_points(tmp_path / 'none.csv', tmp_path / 'out.mcap')
    table = tmp_path / 'table.csv'
    table.write_text('t,a_x,a_y\n1,2,3\n')
    with pytest.raises(BagError, match='is the file of points itself'):
        import_points(table, tmp_path / '.' / 'table.csv')
    assert table.read_text() == 't,a_x,a_y\n1,2,3\n'


def test_too_large_and_endless_files_are_refused(tmp_path):
    with open(tmp_path / 'large.csv', 'wb') as file:
        file.truncate((256 << 20) + 1)  # no blocks on the disk
    with pytest.raises(BagError, match=r'larger than 256 MiB.*; fix: cut it into parts'):
        import_points(tmp_path / 'large.csv', tmp_path / 'out.mcap')
    os.mkfifo(tmp_path / 'pipe')
    for endless in ('/dev/zero', tmp_path / 'pipe'):
        with pytest.raises(BagError, match='not a regular file'):
            import_points(endless, tmp_path / 'out.mcap')
    assert not (tmp_path / 'out.mcap').exists()


def test_progress_rises_to_one(tmp_path):
    seen: list[float] = []
    import_text(tmp_path, 'a_x,a_y\n' + '1,2\n' * 1001, rate=100.0, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert 100 < len(seen) <= 201


@pytest.mark.skipif(not DATA.exists(), reason='the measured double pendulum is not on this machine')
def test_measured_double_pendulum_keeps_its_pivot_and_lengths(tmp_path):
    # 2,000 frames are enough to see a wrong column, sign or scale.
    head = DATA.read_bytes().splitlines(keepends=True)[:2001]
    frames = import_text(tmp_path, b''.join(head), rate=400.0, scale=1e-3 / 6.47, y_down=True)
    assert len(frames) == 2000
    red, green, blue = (
        np.array([markers[name] for _, markers in frames]) for name in ('red', 'green', 'blue')
    )
    unit = 1e-3 / 6.47
    assert red.std(axis=0).max() < 2 * unit
    assert np.median(np.linalg.norm(green - red, axis=1)) == pytest.approx(588.7 * unit, rel=3e-3)
    assert np.median(np.linalg.norm(blue - green, axis=1)) == pytest.approx(450.5 * unit, rel=3e-3)
    assert (red[:, 1] < 0).all()


def circle(count: int = 40, rate: float = 100.0) -> np.ndarray:
    """Points (T, 2) of a marker at 5 rad/s on a circle of 0.1 about (0.7, 0.5)."""
    angle = 5.0 * np.arange(count) / rate
    return np.stack((0.7 + 0.1 * np.cos(angle), 0.5 + 0.1 * np.sin(angle)), axis=-1)


def table_of(columns: dict[str, np.ndarray], kept=slice(None), separator: str = ',') -> str:
    rows = zip(*(values[kept].tolist() for values in columns.values()), strict=True)
    lines = [separator.join(columns), *(separator.join(map(repr, row)) for row in rows)]
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize('title', ['frame', 'Frame', 'FRAME', 'Frame#', 'frame_number', 'fnum'])
@pytest.mark.parametrize('first', [0, 1, 700])
def test_frame_numbers_with_gaps_are_times_with_gaps(tmp_path, title, first) -> None:
    points, kept = circle(), np.r_[0:10, 25:40]
    columns = {title: first + np.arange(40), 'a_x': points[:, 0], 'a_y': points[:, 1]}
    frames = import_text(tmp_path, table_of(columns, kept), rate=100.0)
    assert [stamp for stamp, _ in frames] == [10_000_000 * k for k in kept]
    backward = table_of(columns, np.r_[0:10, 5:10])
    with pytest.raises(BagError, match=rf'column {title}: .* is not the number of a frame after'):
        import_text(tmp_path, backward, rate=100.0)


@pytest.mark.parametrize('title', ['a_likelihood', 'a_score'])
def test_a_point_of_a_table_below_the_likelihood_is_not_seen(tmp_path, title) -> None:
    points, likelihood = circle(), np.ones(40)
    likelihood[[3, 20]] = 0.1, 0.59
    columns = {'t': np.arange(40) / 100, 'a_x': points[:, 0], 'a_y': points[:, 1]}
    columns[title] = likelihood
    text = table_of(columns)
    unseen = [
        k for k, (_, seen) in enumerate(import_text(tmp_path, text, likelihood=0.6)) if not seen
    ]
    assert unseen == [3, 20]
    assert all(seen for _, seen in import_text(tmp_path, text))
    del columns[title]
    with pytest.raises(BagError, match='has no likelihoods; fix: name their columns'):
        import_text(tmp_path, table_of(columns), likelihood=0.6)


def test_columns_that_are_not_read_are_named(tmp_path) -> None:
    points = circle()
    columns = {'t': np.arange(40) / 100, 'a_x': points[:, 0], 'a_y': points[:, 1]}
    (tmp_path / 'plain.csv').write_text(table_of(columns))
    assert import_points(tmp_path / 'plain.csv', tmp_path / 'out.mcap').notes == ()
    columns |= {f'a_q{axis}': np.ones(40) for axis in 'xyz'}
    (tmp_path / 'poses.csv').write_text(table_of(columns))
    (note,) = import_points(tmp_path / 'poses.csv', tmp_path / 'out.mcap').notes
    assert note.endswith('poses.csv: columns that are not read: a_qx, a_qy, a_qz')


@pytest.mark.parametrize('unit', ['px', 'pixels'])
def test_y_points_down_in_pixels_unless_the_user_says_otherwise(tmp_path, unit) -> None:
    points = 1000 * circle()
    columns = {'t': np.arange(40) / 100}
    columns |= {f'a x [{unit}]': points[:, 0], f'a y [{unit}]': points[:, 1]}
    table = tmp_path / 'px.csv'
    table.write_text(table_of(columns))
    (note,) = import_points(table, tmp_path / 'out.mcap', scale=1e-3).notes
    assert 'is in pixels, so y points down unless you give --no-y-down' in note
    down = import_text(tmp_path, table_of(columns), scale=1e-3)
    up = import_text(tmp_path, table_of(columns), scale=1e-3, y_down=False)
    assert down[7][1]['a'][1] == pytest.approx(-up[7][1]['a'][1])


@pytest.mark.parametrize(
    ('first', 'second'), [('0.010', '250,5'), ('250,5', '0.58'), ('1.028,5', '1'), ('1,0', '2.')]
)
def test_two_decimal_marks_in_one_file_are_refused(tmp_path, first, second) -> None:
    text = f't;a_x;a_y\n0;1;2\n1;{first};2\n2;3;{second}\n'
    with pytest.raises(
        BagError, match=r'table\.csv has two decimal marks: .* in line \d, column a_'
    ):
        import_text(tmp_path, text)


def test_marks_of_times_that_a_rate_replaces_count_too(tmp_path) -> None:
    text = 't;a_x;a_y\n' + ''.join(f'0.{k:02};250,{k:03};1,250\n' for k in range(5))
    with pytest.raises(BagError, match=r"two decimal marks: '0\.00' in line 2, column t, and '250"):
        import_text(tmp_path, text, rate=100.0)
    # A text is no number.
    assert import_text(tmp_path, text.replace('0.', 'v'), rate=100.0)


@pytest.mark.parametrize('head', ['sep=;', 'SEP=;', '"sep=;"', '\ufeffsep=;'])
@pytest.mark.parametrize('end', ['\n', '\r\n'])
def test_the_line_by_which_excel_knows_the_delimiter_is_none_of_the_table(
    tmp_path, head, end
) -> None:
    text = end.join((head, 't;a_x;a_y', '0,5;0,25;1', '1,5;2;3', ''))
    assert import_text(tmp_path, text) == [
        (500_000_000, {'a': (0.25, 1.0, 0.0)}),
        (1_500_000_000, {'a': (2.0, 3.0, 0.0)}),
    ]
    with pytest.raises(BagError, match="line 4, column a_x: 'x' is not a number"):
        import_text(tmp_path, text.replace('1,5;2', '1,5;x'))


@pytest.mark.parametrize('above', ['My measurement\n\n', 'date: 2026\nby: me\n', '# a comment\n'])
def test_lines_above_the_names_of_columns_are_named(tmp_path, above) -> None:
    line = above.count('\n') + 1
    with pytest.raises(BagError, match=f'names its columns in line {line}; fix: delete the lines'):
        import_text(tmp_path, f'{above}t,a_x,a_y\n0,1,2\n1,2,3\n2,2,3\n3,2,3\n')


@pytest.mark.parametrize('value', [0.0, -1.0, 9999.0, -9999.0])
@pytest.mark.parametrize('in_space', [False, True])
def test_values_that_stand_for_no_marker_are_no_positions(tmp_path, value, in_space) -> None:
    points = np.pad(circle(), ((0, 0), (0, 1)), constant_values=0.3 if in_space else 0.0)
    lost = np.r_[7, 20:25]
    points[lost, : 3 if in_space else 2] = value
    columns = {'t': np.arange(40) / 100}
    columns |= {f'a_{axis}': points[:, k] for k, axis in enumerate('xyz' if in_space else 'xy')}
    table = tmp_path / 'table.csv'
    table.write_text(table_of(columns))
    (note,) = import_points(table, tmp_path / 'out.mcap').notes
    assert note.endswith('count as not seen: a in 6 frames')
    frames = import_text(tmp_path, table_of(columns))
    assert [k for k, (_, seen) in enumerate(frames) if not seen] == lost.tolist()


def test_a_marker_that_passes_or_rests_at_the_origin_is_seen(tmp_path) -> None:
    passing = circle() - circle()[13]
    for points in passing, np.zeros((40, 2)), np.round(passing * 100):
        columns = {'t': np.arange(40) / 100, 'a_x': points[:, 0], 'a_y': points[:, 1]}
        assert all(seen for _, seen in import_text(tmp_path, table_of(columns)))


def test_a_format_without_likelihoods_refuses_the_option(tmp_path) -> None:
    path = tmp_path / 'a.trc'
    path.write_text(FORMATS['trc'].example)
    for name, format in FORMATS.items():
        if not format.has_likelihood and name != 'bag':
            with pytest.raises(BagError, match=rf'a\.trc \({name}\) has no likelihoods; fix: '):
                monkeyed = format._replace(recognizes=lambda _: True)
                with mock.patch.dict(FORMATS, {name: monkeyed}):
                    import_points(path, tmp_path / 'out.mcap', format=name, likelihood=0.5)


@pytest.mark.parametrize('format', ['trc', 'table'])
@pytest.mark.parametrize('decimals', [1, 4])
def test_a_last_row_that_is_whole_is_kept_without_its_end(tmp_path, format, decimals) -> None:
    rows = [f'{k + 1}\t{k / 100:.2f}\t{10 * k:.{decimals}f}\t2.5' for k in range(12)]
    head = ['t1\tt\ta_x\ta_y']
    if format == 'trc':
        head = FORMATS['trc'].example.split('\n')[:3] + ['Frame#\tTime\ttip', '\t\tX1\tY1\tZ1']
        rows = [f'{row}\t{k:.{decimals}f}' for k, row in enumerate(rows)]
    whole = '\n'.join((*head, *rows))
    path, output = tmp_path / 'a.txt', tmp_path / 'out.mcap'
    path.write_text(whole)
    done = import_points(path, output, rate=100.0, scale=1.0)
    assert done.frames == 12
    assert not any('cut off' in note for note in done.notes)
    path.write_text(whole.removesuffix(whole[-1]))
    assert 'may be cut off' in ''.join(import_points(path, output, rate=100.0, scale=1.0).notes)


def test_values_in_the_head_of_a_trc_may_be_tabs_apart(tmp_path) -> None:
    head = 'DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate'
    body = 'Frame#\tTime\ttip\n\t\tX1\tY1\tZ1\n' + ''.join(
        f'{k}\t{k / 100:.3f}\t1\t2\t{k}\n' for k in range(1, 9)
    )
    for values in (
        '100\t100\t8\t1\tmm\t100',
        '100\t\t100\t\t8\t\t1\t\tmm\t\t100',
        '100\t100\t8\t1\t\tmm',
    ):
        text = f'PathFileType\t4\t(X/Y/Z)\trun.trc\n{head}\n{values}\n{body}'
        (tmp_path / 'a.trc').write_text(text)
        done = import_points(tmp_path / 'a.trc', tmp_path / 'out.mcap')
        assert (done.unit, done.frames, done.notes) == ('mm', 8, ())
        assert str(done) == '8 frames of 1 markers (trc, in mm), 0.07 s at 100 Hz'
