"""Every format with every oddity is right, or one line names the cause: nothing is wrong unsaid."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import options_of
from exports import DOUBTFUL, LOST, RATE, Kind, Variant, kinds, tracker_project, truth, vicon

from kinpole_ros.bags import BagError, import_points, read_messages
from kinpole_ros.bags.formats import FORMATS
from kinpole_ros.messages import deserialize_message
from kinpole_ros.messages._types import MarkerArray
from kinpole_ros.settings import settings_from
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.report import prepared

KINDS = kinds(Path())
NAN = float('nan')
VARIANTS: dict[str, Variant] = {
    'plain': Variant(),
    **{f'unit {unit}': Variant(unit=unit) for unit in ('m', 'cm', 'in', 'ft', 'furlong')},
    'decimal commas': Variant(comma=True),
    'thousands': Variant(comma=True, thousands=True),
    'CRLF': Variant(end='\r\n'),
    'CR': Variant(end='\r'),
    'no last end of line': Variant(is_ended=False),
    'BOM': Variant(bom=True),
    'gap': Variant(gap=True),
    'lost, empty': Variant(lost=NAN),
    **{f'lost, {value:g}': Variant(lost=value) for value in (0.0, -1.0, 9999.0)},
    'doubtful': Variant(doubtful=True, options={'likelihood': 0.5}),
    'rate of another': Variant(rate=50.0),
    'times in ms': Variant(seconds=1e-3),
    'wrong count': Variant(count=47),
    'option rate': Variant(options={'rate': RATE / 2}),
    'option scale': Variant(options={'scale': 0.5}),
    'option y_down': Variant(options={'y_down': True}),
    'option no y_down': Variant(options={'y_down': False}),
}
TEXT = ('decimal commas', 'thousands', 'CRLF', 'CR', 'no last end of line', 'BOM')


def holds(kind: Kind, name: str) -> bool:
    """Whether a kind of file can have this oddity."""
    if name in TEXT:
        return bool(kind.mark)
    if name.startswith('unit '):
        return not kind.unit
    if name in ('rate of another', 'wrong count'):
        return kind.has_rate
    if kind.write is tracker_project and name in ('lost, -1', 'lost, 9999'):
        return False  # these are in pixels
    has_seconds = kind.has_times and bool(kind.mark) and kind.write is not vicon
    return name != 'times in ms' or has_seconds


def outcome(folder: Path, kind: Kind, variant: Variant) -> tuple[bool, str]:
    """Return whether a file is read as the motion is, and what was said."""
    options: dict[str, Any] = {**kind.needed(), **variant.options}
    path, output = folder / 'file.dat', folder / 'out.mcap'
    path.write_bytes(kind.content(variant))
    try:
        done = import_points(path, output, **options)
    except BagError as error:
        assert '\n' not in str(error)
        assert 'fix: ' in str(error)
        return False, str(error)
    _, points = truth(kind.is_flat)
    scale = options.get('scale', kind.length(variant)) / kind.length(variant)
    is_turned = options.get('y_down', kind.y_down) != kind.y_down
    points = points * [scale, -scale if is_turned else scale, scale]
    if variant.lost is not None:
        points[LOST[1], LOST[0]] = NAN
    if variant.doubtful:
        points[DOUBTFUL[1], DOUBTFUL[0]] = NAN
    if variant.gap:
        points[10:15] = NAN
    # Frames without points may be empty, or not there.
    stamps, got = read_bag(output, done.markers)
    rows = np.rint(stamps * options.get('rate', RATE)).astype(int)
    whole = np.full((40, 3, 3), NAN)
    whole[rows[rows < 40]] = got[rows < 40]
    is_same = np.allclose(whole, points, rtol=0, atol=2e-6 * scale, equal_nan=True)
    is_even = np.allclose(stamps, rows / options.get('rate', RATE), rtol=0, atol=1e-6)
    is_whole = len(stamps) in (40, 35 if variant.gap else 40)
    return is_same and is_even and is_whole, ' / '.join((str(done), *done.notes))


def read_bag(path: Path, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return times from the first frame on (T,), s, and points (T, n, 3), NaN where hidden."""
    messages = list(read_messages(path, ['/markers']))
    points = np.full((len(messages), len(names), 3), NAN)
    for row, message in enumerate(messages):
        for marker in deserialize_message(message.data, MarkerArray).markers:
            place = marker.pose.position
            points[row, names.index(marker.ns)] = place.x, place.y, place.z
    stamps = np.array([message.log_time for message in messages])
    return (stamps - stamps[0]) * 1e-9, points


# What is said of a file that is not read as it was meant, or that contradicts itself.
REFUSED = {
    'unit furlong': r'is in furl.*; fix: give --scale',
    'thousands': r'two decimal marks|is not t, x and y',
    'doubtful': r'has no likelihoods|has no scores',
}
SAID = {
    'lost, -1': 'count as not seen: B(/1)? in 4 frames',
    'lost, 9999': 'count as not seen: B(/1)? in 4 frames',
    'rate of another': 'says 50 Hz, and its times go on at 100 Hz: the times are taken; fix: ',
    'wrong count': 'says that it has 47 frames, and has 40',
}


@pytest.mark.parametrize('name', VARIANTS)
@pytest.mark.parametrize('kind_name', KINDS)
def test_a_cell_is_right_or_says_why_not(tmp_path, kind_name, name) -> None:
    kind, variant = kinds(tmp_path)[kind_name], VARIANTS[name]
    if not holds(kind, name):
        return
    is_right, said = outcome(tmp_path, kind, variant)
    if name == 'times in ms':
        # Where nothing contradicts them, what is printed shows it.
        assert not is_right
        rate = 'says 100 Hz, and its times go on at 0.1 Hz: the times are taken; fix: give --rate'
        assert re.search(rate if kind.has_rate else '390 s at 0.1 Hz|; fix: ', said)
    elif name in REFUSED and not (name == 'doubtful' and kind.has_likelihood):
        assert not is_right
        assert re.search(REFUSED[name], said)
    else:
        assert is_right, said
        assert re.search(SAID.get(name, ''), said)
        assert '40 frames of 3 markers' in said or variant.gap


def test_all_formats_are_in_the_table() -> None:
    names = {name.partition(' ')[0].partition(',')[0] for name in KINDS}
    assert names == set(FORMATS)


ENDINGS = {'sleap .h5': '.h5', 'movement': '.nc', 'nwb': '.nwb',
           'keypoints': '.json', 'kinovea text': '.txt', 'kinovea .xml': '.xml',
           'tracker': '.txt', 'tracker .trk': '.trk', 'qualisys': '.tsv', 'trc': '.trc',
           'c3d': '.c3d', 'bag': '.mcap'}  # fmt: skip


def written(folder: Path, kind_name: str) -> Path:
    """A plain file of a kind, with the ending that its program gives it."""
    path = folder / f'file{ENDINGS.get(kind_name, ".csv")}'
    path.write_bytes(kinds(folder)[kind_name].content(Variant()))
    return path


@pytest.mark.parametrize('kind_name', KINDS)
def test_the_option_format_acts_or_is_refused(tmp_path, kind_name) -> None:
    path, needed = written(tmp_path, kind_name), KINDS[kind_name].needed()
    for name in FORMATS:
        try:
            done = import_points(path, tmp_path / 'out.mcap', format=name, **needed)
        except BagError as error:
            assert name != kind_name.partition(' ')[0].rstrip(',')
            assert re.search(r'not what .* begins with.*; fix: |; fix: ', str(error))
        else:
            assert (done.format, done.frames, done.markers[0][0]) == (name, 40, 'A')


@pytest.mark.parametrize('kind_name', KINDS)
@pytest.mark.parametrize(
    ('option', 'value'), [('rate', 50.0), ('scale', 0.5), ('y_down', True), ('y_down', False)]
)
def test_an_option_of_report_acts_or_is_refused(tmp_path, kind_name, option, value) -> None:
    path, kind = written(tmp_path, kind_name), KINDS[kind_name]
    settings = settings_from({'bodies': ['rod'], 'rod.markers': list('ABC')})
    given = {'rate': None, 'scale': None, 'y_down': None, **kind.needed(), option: value}
    options = options_of('report', path, **given)
    if kind_name == 'bag':
        with pytest.raises(BagError, match=r'are for files of points; fix: leave them out'):
            prepared(options, settings).__enter__()
        return
    with prepared(options, settings) as ready:
        stamps, points = read_bag(Path(ready.bag), ('A', 'B', 'C'))
    up = 1.0 if given['y_down'] in (None, kind.y_down) else -1.0
    scale = (given['scale'] or kind.length(Variant())) / kind.length(Variant())
    expected = truth(kind.is_flat)[1][1] * scale * [1.0, up, 1.0]
    np.testing.assert_allclose(points[1], expected, atol=2e-6 * scale)
    np.testing.assert_allclose(stamps[1], 1.0 / (given['rate'] or RATE), atol=1e-6)


@pytest.mark.parametrize('kind_name', sorted(set(KINDS) - {'bag'}))
@pytest.mark.parametrize('command', ['replay', 'discover'])
def test_replay_and_discover_send_every_file_of_points_to_import(
    tmp_path, capsys, kind_name, command
) -> None:
    path = written(tmp_path, kind_name)
    words = ['--csv', str(tmp_path / 'o.csv')] if command == 'replay' else ['--seconds', '1']
    assert main([command, str(path), *words]) == 2
    assert re.search(r'is a file of points.*`kinpole import ', capsys.readouterr().err)
