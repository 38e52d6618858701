"""Files laid out as each program writes them import in one call, exactly, oddities and all."""

import json
import os
import pickle
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinpole_ros.bags import BagError, Imported, import_points, read_messages
from kinpole_ros.bags.formats import FORMATS, Options, read_points
from kinpole_ros.messages import deserialize_message
from kinpole_ros.messages._types import MarkerArray
from kinpole_ros.tools.cli import main

WALK = Path(__file__).parents[3] / 'shared' / 'data' / 'gait' / 'walk1.trc'
NAN = float('nan')
# Two markers in four frames; the second is hidden in one of them.
SEEN = np.array(
    [
        [[10.5, 20.25, 1.5], [-30.0, 40.125, 2.0]],
        [[11.5, 21.25, 1.0], [NAN, NAN, NAN]],
        [[12.5, 22.25, 0.5], [-32.0, 42.125, 4.0]],
        [[13.5, 23.25, 0.0], [-33.0, 43.125, 5.0]],
    ]
)
FLAT = SEEN * [1, 1, 0]


def bring(folder: Path, content: str | bytes, **options: Any) -> tuple[Imported, np.ndarray, Any]:
    """What a file becomes: the record, stamps in s, and points by marker, NaN where hidden."""
    file, bag = folder / 'points.dat', folder / 'out.mcap'
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    done = import_points(file, bag, **options)
    points = np.full((done.frames, len(done.markers), 3), NAN)
    stamps = []
    for row, message in enumerate(read_messages(bag, ['/markers'])):
        stamps.append(message.log_time)
        for marker in deserialize_message(message.data, MarkerArray).markers:
            place = marker.pose.position
            points[row, done.markers.index(marker.ns)] = place.x, place.y, place.z
    return done, np.array(stamps) / 1e9, points


def cells(values: np.ndarray, mark: str = ',', comma: bool = False) -> str:
    texts = ['' if np.isnan(value) else f'{value:.6f}' for value in np.ravel(values)]
    return mark.join(text.replace('.', ',') if comma else text for text in texts)


def deeplabcut(animals: tuple[str, ...] = (), mark: str = ',', comma: bool = False) -> str:
    """The CSV of analyze_videos: what is hidden has a place, too, of little likelihood."""
    parts = ('tip', 'heel') if not animals else ('tip',)
    columns = [(a, p, c) for a in animals or ('',) for p in parts for c in ('x', 'y', 'likelihood')]
    head = [['scorer', *('DLC_resnet50_rigAug1' for _ in columns)]]
    if animals:
        head.append(['individuals', *(animal for animal, _, _ in columns)])
    head += [['bodyparts', *(p for _, p, _ in columns)], ['coords', *(c for _, _, c in columns)]]
    sure = np.where(np.isnan(SEEN[..., :1]), 0.2, 0.99)
    values = np.concatenate((np.nan_to_num(SEEN[..., :2], nan=7.0), sure), axis=-1)
    lines = [mark.join(row) for row in head]
    lines += [f'{k}{mark}{cells(row, mark, comma)}' for k, row in enumerate(values)]
    return '\n'.join(lines) + '\n'


def sleap() -> str:
    """The analysis CSV: an instance that was not found has no line."""
    lines = ['track,frame_idx,instance.score,tip.x,tip.y,tip.score']
    for track in range(2):
        for frame, row in enumerate(SEEN[:, track, :2]):
            if not np.isnan(row).any():
                lines.append(f'rod_{track},{frame},0.9,{cells(row)},0.5')
    return '\n'.join(lines)


def kinovea(comma: bool) -> str:
    """Every cell in quotes; the second trajectory has two points, as an angle has."""
    mark = ';' if comma else ','
    titles = ['Time', 'Tip/0/X', 'Tip/0/Y', 'Angle 1/a/X', 'Angle 1/a/Y', 'Angle 1/b/X',
              'Angle 1/b/Y']  # fmt: skip
    lines = [mark.join(f'"{title}"' for title in titles)]
    for k, (first, second) in enumerate(SEEN[..., :2]):
        values = [k * 0.04, *first, *second, *second]
        texts = [f'{v:.6g}'.replace('.', ',' if comma else '.') for v in values]
        quoted = ['' if text == 'nan' else f'"{text}"' for text in texts]
        lines.append(mark.join(quoted))
    return '\r\n'.join(lines) + '\r\n'


def tracker_one(unit: str = '', comma: bool = False) -> str:
    """One track, unformatted: ten digits with an exponent, in the decimals of the computer."""
    lines = ['mass_A', f't\tx{unit}\ty{unit}\tv_{{x}}']
    for k, row in enumerate(SEEN[:, 1, :2]):
        texts = ['' if np.isnan(v) else f'{v:.9E}' for v in (k * 0.04, *row)] + ['']
        line = '\t'.join(texts)
        lines.append(line.replace('.', ',') if comma else line)
    return '\r\n'.join(lines)


def tracker_many() -> str:
    lines = ['#multi:', '\tmass A\t\tmass B\t\t\t\t', 't\tx\ty\tx\ty\t']
    lines += [f'{k * 0.04:.3f}\t{cells(row[:, :2], chr(9))}\t' for k, row in enumerate(SEEN)]
    return '\n'.join(lines)


def motive(unit: str) -> str:
    """A take of format 1.23 with a rigid body, whose columns are no markers."""
    kinds = ['Rigid Body'] * 8 + ['Rigid Body Marker'] * 4 + ['Marker'] * 6
    names = ['rod'] * 8 + ['rod:Marker1'] * 4 + ['rod:Marker1'] * 3 + ['Unlabeled 1189'] * 3
    what = ['Rotation'] * 4 + ['Position'] * 3 + ['Mean Marker Error'] + ['Position'] * 3
    what += ['Marker Quality'] + ['Position'] * 6
    axes = [*'XYZWXYZ', '', *'XYZ', '', *'XYZXYZ']
    lines = [
        'Format Version,1.23,Take Name,run 1,Take Notes,,Capture Frame Rate,120.000000,'
        'Export Frame Rate,120.000000,Capture Start Time,2026-08-04 03.25.39.000 PM,'
        f'Total Frames in Take,4,Rotation Type,Quaternion,Length Units,{unit},'
        'Coordinate Space,Global',
        '',
        ',Type,' + ','.join(kinds),
        ',Name,' + ','.join(names),
        ',ID,' + ','.join('"4CF0B31A"' for _ in kinds),
        ',,' + ','.join(what),
        'Frame,Time (Seconds),' + ','.join(axes),
    ]
    for k, row in enumerate(SEEN):
        lines.append(f'{k},{k / 120:.6f},{"0.1," * 12}{cells(row)}')
    return '\n'.join(lines) + '\n'


def vicon(unit: str = 'mm') -> str:
    """Trajectories behind another section, with velocities, in a file that begins with a blank."""
    lines = ['', 'Model Outputs', '200', ',,Rig:Angle,,', 'Frame,Sub Frame,X,Y,Z',
             ',,deg,deg,deg', '101,0,1,2,3', '102,0,1,2,3', '', 'Trajectories', '200',
             ',,Rig:tip,,,,,,Rig:heel,,,,,', 'Frame,Sub Frame' + ",X,Y,Z,X',Y',Z'" * 2,
             ',,' + ','.join(([unit] * 3 + [f'{unit}/s'] * 3) * 2)]  # fmt: skip
    for k, (tip, heel) in enumerate(SEEN):
        lines.append(f'{101 + k},0,{cells(tip)},1,1,1,{cells(heel)},1,1,1')
    return '\n'.join([*lines, '', 'Devices', '1000', '1,0,5'])


def trc(unit: str = 'mm', frames: int = 4) -> bytes:
    """As Cortex writes it: a path in the letters of Windows, times in ms, tabs at the ends."""
    lines = [
        'PathFileType\t4\t(X/Y/Z)\tC:\\Läufe\\run.trc',
        'DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate',
        f'150.00\t150.00\t{frames}\t2\t{unit}\t150.00',
        'Frame#\tTime\tR.tip\t\t\tR.heel\t\t\t',
        '\t\tX1\tY1\tZ1\tX2\tY2\tZ2\t',
        '',
    ]
    lines += [f'{k + 1}\t{k / 150:.3f}\t{cells(row, chr(9))}\t' for k, row in enumerate(SEEN)]
    return '\r\n'.join(lines).encode('cp1252')


def c3d_file(
    unit: str = 'mm', points: Any = SEEN, rate: float = 200.0, names: Any = ('tip', 'heel')
) -> bytes:
    """Floats in Intel order, frames from 5 on, and an angle among the points."""
    names, count = [*names, 'Knee'], len(points)

    def group(number: int, name: str) -> bytes:
        return struct.pack('<bb', len(name), -number) + name.encode() + struct.pack('<hb', 3, 0)

    def value(name: str, kind: int, size: tuple[int, ...], data: bytes, of: int = 1) -> bytes:
        tail = struct.pack('<bB', kind, len(size)) + bytes(size) + data + b'\0'
        return struct.pack('<bb', len(name), of) + name.encode() + struct.pack('<h', 2 + len(tail)) + tail  # noqa: E501  # fmt: skip

    def texts(*words: str) -> tuple[int, tuple[int, ...], bytes]:
        return -1, (8, len(words)), b''.join(word.ljust(8).encode() for word in words)

    parameters = b'\0\0\x01\x54' + group(1, 'POINT')
    parameters += value('USED', 2, (), struct.pack('<h', len(names)))
    parameters += value('SCALE', 4, (), struct.pack('<f', -1.0))
    parameters += value('RATE', 4, (), struct.pack('<f', rate))
    parameters += value('DATA_START', 2, (), struct.pack('<h', 3))
    parameters += value('FRAMES', 2, (), struct.pack('<h', count))
    parameters += value('LABELS', *texts(*names)) + value('UNITS', -1, (4,), unit.ljust(4).encode())
    parameters += value('ANGLES', *texts('Knee')) + b'\0\0'
    assert len(parameters) < 512
    words = len(names), 0, 5, 4 + count, 10, -1.0, 3, 0, rate
    header = struct.pack('<BBHHHHHfHHf', 2, 0x50, *words)
    data = b''
    for row in points:
        for point in (*row, np.full(3, 90.0)):
            # A point that is not seen has places of any kind, and a negative residual.
            lost = np.isnan(point).any()
            data += struct.pack('<4f', *(np.zeros(3) if lost else point), -1.0 if lost else 0.5)
    blocks = header.ljust(512, b'\0') + parameters.ljust(512, b'\0')
    return blocks + data.ljust(-(-len(data) // 512) * 512, b'\0')


def deeplabcut_h5(names: bytes = b'') -> bytes:
    """What pandas writes by PyTables: names of columns are a pickle in an attribute."""
    h5py = pytest.importorskip('h5py')
    from io import BytesIO

    columns = [('DLC', p, c) for p in ('tip', 'heel') for c in ('x', 'y', 'likelihood')]
    sure = np.where(np.isnan(SEEN[..., :1]), 0.2, 0.99)
    values = np.concatenate((np.nan_to_num(SEEN[..., :2], nan=7.0), sure), axis=-1).reshape(4, 6)
    table = np.zeros(4, [('index', '<i8'), ('values_block_0', '<f8', (6,))])
    table['index'], table['values_block_0'] = np.arange(4), values
    with BytesIO() as file:
        with h5py.File(file, 'w') as content:
            written = content.create_dataset('df_with_missing/table', data=table)
            written.attrs['values_block_0_kind'] = np.bytes_(names or pickle.dumps(columns, 0))
        return file.getvalue()


# Of each: what it is, the file, what must be given, markers, stamps, places.
def even(rate: float, first: float) -> np.ndarray:
    return first + np.arange(4) / rate


PIXELS = {'rate': 100.0, 'scale': 0.5}
TIP_HEEL = ('tip', 'heel')
IN_PIXELS = FLAT * [0.5, -0.5, 1]
CASES: dict[str, tuple[str, Callable[[], str | bytes], dict[str, Any], Any, Any, np.ndarray]] = {
    'dlc': ('deeplabcut', deeplabcut, PIXELS, TIP_HEEL, even(100, 0), IN_PIXELS),
    'dlc, animals, decimal commas': (
        'deeplabcut', lambda: deeplabcut(('a', 'b'), ';', comma=True), PIXELS,
        ('a.tip', 'b.tip'), even(100, 0), IN_PIXELS,
    ),
    'dlc .h5': ('deeplabcut', deeplabcut_h5, PIXELS, TIP_HEEL, even(100, 0), IN_PIXELS),
    'sleap': ('sleap', sleap, PIXELS, ('rod_0.tip', 'rod_1.tip'), even(100, 0), IN_PIXELS),
    'kinovea': (
        'kinovea', lambda: kinovea(False), {'scale': 1.0},
        ('Tip', 'Angle 1.a', 'Angle 1.b'), even(25, 0), FLAT[:, [0, 1, 1]],
    ),
    'kinovea, decimal commas, BOM': (
        'kinovea', lambda: b'\xef\xbb\xbf' + kinovea(True).encode(), {'scale': 1.0},
        ('Tip', 'Angle 1.a', 'Angle 1.b'), even(25, 0), FLAT[:, [0, 1, 1]],
    ),
    'tracker': ('tracker', tracker_one, {'scale': 1.0}, ('mass_A',), even(25, 0), FLAT[:, 1:]),
    'tracker, unit, decimal commas': (
        'tracker', lambda: tracker_one(' (cm)', comma=True), {},
        ('mass_A',), even(25, 0), FLAT[:, 1:] * 0.01,
    ),
    'tracker, many': (
        'tracker', tracker_many, {'scale': 0.01}, ('mass A', 'mass B'), even(25, 0), FLAT * 0.01
    ),
    'motive': (
        'motive', lambda: motive('Meters'), {},
        ('rod:Marker1', 'Unlabeled 1189'), even(120, 0), SEEN,
    ),
    'motive, mm': (
        'motive', lambda: motive('Millimeters'), {},
        ('rod:Marker1', 'Unlabeled 1189'), even(120, 0), SEEN * 1e-3,
    ),
    'vicon': ('vicon', vicon, {}, ('Rig:tip', 'Rig:heel'), even(200, 0.505), SEEN * 1e-3),
    'trc': ('trc', trc, {}, ('R.tip', 'R.heel'), even(150, 0), SEEN * 1e-3),
    'trc, inches': ('trc', lambda: trc('in'), {}, ('R.tip', 'R.heel'), even(150, 0), SEEN * 0.0254),
    'trc, told otherwise': (
        'trc', trc, {'scale': 1.0, 'rate': 50.0, 'y_down': True},
        ('R.tip', 'R.heel'), even(50, 0), SEEN * [1, -1, 1],
    ),
    'c3d': ('c3d', c3d_file, {}, TIP_HEEL, even(200, 0.025), SEEN * 1e-3),
    'c3d, m': ('c3d', lambda: c3d_file('m'), {}, TIP_HEEL, even(200, 0.025), SEEN),
    'table, decimal commas': (
        'table', lambda: 't;a_x;a_y\n' + '\n'.join(
            f'{k};{cells(row, ";", comma=True)}' for k, row in enumerate(SEEN[:, 1, :2])
        ), {}, ('a',), even(1, 0), FLAT[:, 1:],
    ),
}  # fmt: skip


@pytest.mark.parametrize('case', CASES)
def test_a_file_as_its_program_writes_it_is_recognized_and_exact(tmp_path, case):
    kind, content, options, markers, stamps, places = CASES[case]
    done, got_stamps, got = bring(tmp_path, content(), **options)
    assert (done.format, done.markers) == (kind, markers)
    np.testing.assert_allclose(got_stamps, stamps, rtol=0, atol=1e-9)
    # float32 is what a C3D has.
    np.testing.assert_allclose(got, places, rtol=1e-7 if kind == 'c3d' else 1e-12, atol=1e-12)
    named, *_ = bring(tmp_path, content(), format=kind, **options)
    assert named == done


@pytest.mark.parametrize('kind', ['trc', 'motive', 'vicon', 'c3d'])
def test_markers_of_one_name_are_numbered(tmp_path, kind):
    _, make, _, names, _, places = CASES[kind]
    content = make() if isinstance(make(), bytes) else make().encode()
    first, second = (name.encode() for name in names)
    if kind == 'c3d':
        first = first.ljust(len(second))
    done, _, got = bring(tmp_path, content.replace(second, first))
    assert done.markers == (names[0], f'{names[0]}_2')
    assert f"markers of one name; they are numbered: '{names[0]}_2'" in str(done.notes)
    np.testing.assert_allclose(got, places, rtol=1e-7)


@pytest.mark.parametrize('case', CASES)
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path, case):
    kind, content, options, *_ = CASES[case]
    sound = content()
    sound = sound if isinstance(sound, bytes) else sound.encode()
    draw = np.random.default_rng(7)
    for count in range(20):
        damaged = bytearray(sound)
        for place in draw.integers(len(sound), size=1 + count % 3).tolist():
            piece = [b'', b',', b'\n', b'"', b'\xff', b'\t'][draw.integers(6)]
            damaged[place : place + int(draw.integers(30))] = piece
        try:
            bring(tmp_path, bytes(damaged), format=kind if count % 2 else 'auto', **options)
        except BagError as error:
            assert 'fix: ' in str(error)
            assert str(error).isprintable()


def test_likelihood_decides_what_is_seen(tmp_path):
    _, _, points = bring(tmp_path, deeplabcut(), likelihood=0.1, **PIXELS)
    assert np.array_equal(points[1, 1], [3.5, -3.5, 0])
    _, _, points = bring(tmp_path, sleap(), likelihood=0.6, **PIXELS)
    assert np.isnan(points).all()


def test_labeled_images_are_frames_by_their_number_and_have_no_likelihood(tmp_path):
    head = 'scorer,,,me,me,me\nbodyparts,,,tip,tip,tip\ncoords,,,x,y,likelihood\n'
    rows = 'labeled-data,run 1,img07.png,1,2,\nlabeled-data,run 1,img09.png,,,\n'
    _, stamps, points = bring(tmp_path, head + rows, **PIXELS)
    np.testing.assert_allclose(stamps, [0.0, 0.02], atol=1e-9)
    assert np.array_equal(points[:, 0], [[0.5, -1, 0], [NAN] * 3], equal_nan=True)


def test_frames_without_a_line_leave_a_gap(tmp_path):
    lines = deeplabcut().splitlines()
    _, stamps, _ = bring(tmp_path, '\n'.join([*lines[:4], *lines[5:], '']), **PIXELS)
    np.testing.assert_allclose(stamps, [0.0, 0.02, 0.03], atol=1e-9)
    lines = kinovea(False).splitlines()
    _, stamps, _ = bring(tmp_path, '\n'.join(lines[:3] + lines[4:]), rate=50.0, scale=1.0)
    np.testing.assert_allclose(stamps, [0.0, 0.02, 0.06], atol=1e-9)


def test_times_that_are_not_the_rates_are_kept(tmp_path):
    late = trc().decode('cp1252').replace('\t0.020\t', '\t0.050\t')
    _, stamps, _ = bring(tmp_path, late)
    np.testing.assert_allclose(stamps, [0.0, 0.007, 0.013, 0.05], atol=1e-9)


def test_times_rounded_to_ms_are_the_rates_however_many_zeros_follow(tmp_path):
    """Motive rounds times to ms and prints them with six digits."""
    content = motive('Meters').replace('120.000000', '360.000000')
    for k in range(4):
        content = content.replace(f'\n{k},{k / 120:.6f},', f'\n{k},{k / 360:.3f}000,')
    _, stamps, _ = bring(tmp_path, content)
    np.testing.assert_allclose(stamps, even(360.0, 0.0), atol=1e-9)


def test_a_frame_missing_from_times_of_whole_intervals_is_seen(tmp_path):
    content = motive('Meters').replace('120.000000', '100.000000')
    for k, time in enumerate((0.0, 0.01, 0.03, 0.04)):
        content = content.replace(f'\n{k},{k / 120:.6f},', f'\n{k},{time:.6f},')
    _, stamps, _ = bring(tmp_path, content)
    np.testing.assert_allclose(stamps, [0.0, 0.01, 0.03, 0.04], atol=1e-9)


def test_what_a_head_says_and_the_file_lacks_is_noted(tmp_path):
    done, *_ = bring(tmp_path, trc(frames=9))
    assert any('says that it has 9 frames, and has 4' in note for note in done.notes)
    done, *_ = bring(tmp_path, motive('Meters').replace(cells(SEEN[:, 0]), ''))
    assert not done.notes
    hidden = 't,a_x,a_y,b_x,b_y\n1,,,3,4\n2,,,5,6\n'
    done, *_ = bring(tmp_path, hidden)
    assert done.notes == ('seen in no frame: a',)


SCORED = 'frame_idx,track,tip.x,tip.y\n0,,1,2\n0,,3,4\n'


@pytest.mark.parametrize(
    ('content', 'options', 'complaint'),
    [
        (deeplabcut, {'rate': 100.0}, r'\(deeplabcut\) is in px; fix: give --scale'),
        (deeplabcut, {'scale': 1.0}, 'has no times; fix: give --rate'),
        (deeplabcut, {}, 'is in px and has no times; fix: give --scale, .*; and give --rate'),
        (sleap, {'rate': 100.0}, r'\(sleap\) is in px; fix: give --scale'),
        (tracker_one, {}, r'\(tracker\) is in a unit that the file does not say; fix: give --sc'),
        (lambda: tracker_one(' (furlong)'), {}, 'is in furlong; fix: give --scale'),
        (lambda: trc('au'), {}, 'is in au; fix: give --scale'),
        (
            lambda: kinovea(False).replace('"0.0', '"4').replace('"0.1', '"9'),
            {'scale': 1.0},
            'line, frames or milliseconds.*fix: give --rate',
        ),
        (lambda: motive('Meters').replace(',Marker', ',Bone').replace('d Body,', 'd,'), {},
         'no columns of type Marker, only Rigi'),
        (lambda: motive('Meters').replace('X,Y,Z\n', 'X,Y,Y\n'), {}, 'columns than X, Y, Z'),
        (lambda: vicon().replace('mm,mm,mm', 'mm,cm,mm', 1), {}, 'several units, cm mm; fix'),
        (lambda: vicon().replace('s\n200\n,,Rig:t', 's\nfast\n,,Rig:t'), {}, 'has no times; fix'),
        (lambda: trc().replace(b'R.tip\t', b'R.tip\tR.m\t'), {}, '4: frames have 9 cells, and 3 m'),
        (lambda: trc().replace(b'\n2\t', b'\n7\t'), {}, 'line 9, column Frame#: 3 is not the numb'),
        (lambda: trc().replace(b'10.5', b'1o.5'), {}, "line 7, column R.tip x: '1o.500000' is not"),
        (lambda: SCORED, PIXELS, 'frame 0 has 2 instances of track .*fix: track them in SLEAP'),
        (lambda: deeplabcut().replace('\n0,', '\nfirst,'), PIXELS, 'line 4, column 1: nan is not'),
        (lambda: deeplabcut().replace('heel,heel', 'heel,tip'), PIXELS, 'one coordinate twice'),
        (lambda: deeplabcut_h5(pickle.dumps([print], 0)), PIXELS, 'is not an .h5 of DeepLabCut'),
        (lambda: deeplabcut_h5(b'(lp99999999999\n.'), PIXELS, 'is not an .h5 of DeepLabCut'),
        (lambda: deeplabcut_h5()[:900], PIXELS, 'is not an .h5 of DeepLabCut'),
        (lambda: c3d_file()[:530], {}, 'is not a C3D file that can be read|has no frames'),
        (lambda: 'time\tpos\x1b[2J\n1\t2\n', {},
         "begins with 'time pos.*2J' / '1 2': of no format known here .bag, sleap.*fix: .*"
         't,tip_x,tip_y'),
        (lambda: b'\x89PNG\r\n\x1a\n\0\0', {}, 'is binary and begins with 89 50 4e 47'),
    ],
)  # fmt: skip
def test_what_a_file_lacks_is_asked_for_in_one_line(tmp_path, content, options, complaint):
    (tmp_path / 'out.mcap').write_text('precious')
    with pytest.raises(BagError, match=complaint) as error:
        bring(tmp_path, content(), **options)
    assert 'fix: ' in str(error.value)
    assert str(error.value).isprintable()
    assert (tmp_path / 'out.mcap').read_text() == 'precious'


def test_a_format_by_a_wrong_name_and_a_file_of_another(tmp_path):
    with pytest.raises(BagError, match=f"'qtm' is unknown; fix: auto, {', '.join(FORMATS)}"):
        bring(tmp_path, trc(), format='qtm')
    for name in FORMATS:
        if name != 'trc':
            with pytest.raises(BagError, match='fix: '):
                bring(tmp_path, trc(), format=name)


def test_the_command_says_what_it_recognized(tmp_path, capsys):
    (tmp_path / 'run.trc').write_bytes(trc(frames=9))
    assert main(['import', str(tmp_path / 'run.trc'), '--output', str(tmp_path / 'run.mcap')]) == 0
    out, err = capsys.readouterr()
    assert out.startswith('4 frames of 2 markers (trc, in mm), 0.02 s at 150 Hz, written to ')
    assert 'says that it has 9 frames' in err
    words = ['--rate', '100', '--scale', '0.5', '--no-y-down', '--likelihood', '0.1']
    (tmp_path / 'dlc.csv').write_text(deeplabcut())
    arguments = ['import', str(tmp_path / 'dlc.csv'), '--output', str(tmp_path / 'dlc.mcap')]
    assert main([*arguments, *words, '--format', 'deeplabcut']) == 0
    message = next(iter(read_messages(tmp_path / 'dlc.mcap')))
    assert deserialize_message(message.data, MarkerArray).markers[0].pose.position.y == 10.125


@pytest.mark.skipif(not WALK.exists(), reason='the measured gait is not on this machine')
def test_measured_gait_has_its_rate_and_unit():
    name, read = read_points(WALK)
    assert (name, read.points.shape, read.scale) == ('trc', (364, 28, 3), 0.001)
    assert read.times is not None
    np.testing.assert_allclose(read.times, np.arange(364) / 150, atol=1e-9)
    knee = read.points[0, list(read.names).index('R.Knee')]
    assert knee.tolist() == [-255.79147, 532.41669, -490.22989]


@pytest.mark.parametrize(
    ('names', 'complaint'),
    [
        (('frames', 'instances', 'points', 'metadata'), 'is a project of SLEAP .*; fix: export an'),
        (('pos_x', 'pos_y'), 'no program that is known here, with pos_x, pos_y in it; fix: '),
    ],
)
def test_hdf_of_another_program_is_named_as_what_it_is(tmp_path, names, complaint):
    h5py = pytest.importorskip('h5py')
    with h5py.File(tmp_path / 'a.h5', 'w') as file:
        for name in names:
            file[name] = np.zeros(3)
    with pytest.raises(BagError, match=complaint) as error:
        read_points(tmp_path / 'a.h5')
    assert 'DeepLabCut' not in str(error.value)
    (tmp_path / 'b.nc').write_bytes(b'CDF\x01' + bytes(40))
    with pytest.raises(BagError, match=r'is netCDF 3, .*; fix: save it by to_netcdf'):
        read_points(tmp_path / 'b.nc')


def redirect(content: bytes, folder: Path, how: str) -> bytes:
    """An .h5 of DeepLabCut whose table is somewhere else, or is no numbers."""
    h5py = pytest.importorskip('h5py')
    path, secret = folder / 'redirected.h5', folder / 'secret'
    path.write_bytes(content)
    with h5py.File(path, 'r+') as file:
        name = next(iter(file))
        group = file[name]
        table = group['table']
        kind, attributes, rows = table.dtype, dict(table.attrs), table[:]
        secret.write_bytes(rows.tobytes())
        del group['table']
        if how == 'external storage':
            group.create_dataset('table', rows.shape, kind, external=[(str(secret), 0, 10**6)])
        elif how == 'virtual':
            layout = h5py.VirtualLayout(rows.shape, kind)
            layout[:] = h5py.VirtualSource(str(secret), 'x', rows.shape)
            group.create_virtual_dataset('table', layout)
        elif how == 'external link':
            group['table'] = h5py.ExternalLink(str(secret), '/x')
        elif how == 'soft link':
            file['other'] = rows
            group['table'] = h5py.SoftLink('/other')
        else:
            fields = [(n, kind[n]) for n in kind.names] + [('v', h5py.vlen_dtype(np.float64))]
            group.create_dataset('table', rows.shape, np.dtype(fields), chunks=(4,))
        if how.endswith(('storage', 'virtual', 'vlen')):
            group['table'].attrs.update(attributes)
    return path.read_bytes()


@pytest.mark.parametrize(
    'how', ['external storage', 'virtual', 'external link', 'soft link', 'vlen']
)
def test_an_h5_that_leads_elsewhere_or_has_no_numbers_is_refused(tmp_path, how):
    content = redirect(deeplabcut_h5(), tmp_path, how)
    with pytest.raises(BagError, match=r'is a link|are elsewhere|is not of numbers'):
        bring(tmp_path, content, **PIXELS)


def test_an_external_link_to_a_pipe_is_refused_unopened(tmp_path):
    h5py = pytest.importorskip('h5py')
    os.mkfifo(tmp_path / 'pipe')
    for place in ('/df_with_missing', '/df_with_missing/table'):
        (tmp_path / 'points.h5').write_bytes(deeplabcut_h5())
        with h5py.File(tmp_path / 'points.h5', 'r+') as file:
            del file[place]
            file[place] = h5py.ExternalLink(str(tmp_path / 'pipe'), '/x')
        command = [sys.executable, '-c', PEAK, str(tmp_path / 'points.h5')]
        # A pipe that is opened never ends.
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        assert 'is a link; fix: ' in done.stderr


def write_large_h5(path: Path, kind: str) -> None:
    """Small files that would unpack to far more than their bytes."""
    h5py = pytest.importorskip('h5py')
    columns = [('DLC', p, c) for p in ('tip', 'heel') for c in ('x', 'y', 'likelihood')]
    row: list[Any] = [('index', '<i8'), ('values_block_0', '<f8', (6,))]
    with h5py.File(path, 'w') as file:
        if kind.endswith('rows'):
            # Of one marker, since each frame has memory of its own.
            columns, row[1] = columns[:3], ('values_block_0', '<f8', (3,))
            options = {'chunks': (1 << 18,), 'compression': 'gzip'}
            count = 6_500_000 if kind == 'rows' else 11_000_000
            table = file.create_dataset('df/table', (count,), row, **options)
            for first in range(0, len(table), 1 << 18):
                rows = np.zeros(min(1 << 18, count - first), row)
                rows['index'] = np.arange(first, first + len(rows))
                table[first : first + len(rows)] = rows
        elif kind == 'a row':
            row.append(('other', '<f8', (100_000_000,)))
            table = file.create_dataset('df/table', (4,), row)
        elif kind == 'a column of lists':
            # 3.2 GB in 1.3 MB: all rows refer to one list.
            row.append(('other', h5py.vlen_dtype(np.float64)))
            one = file.create_dataset('one', (1,), row, chunks=(1,))
            filled = np.zeros(1, one.dtype)
            filled['other'][0] = np.zeros(160_000)
            one[:] = filled
            count, (_, packed) = 2500, one.id.read_direct_chunk((0,))
            options = {'chunks': (count,), 'compression': 'gzip'}
            table = file.create_dataset('df/table', (count,), row, **options)
            table.id.write_direct_chunk((0,), zlib.compress(packed * count))
        else:
            table = file.create_dataset('df/table', (4,), row)
        pickled = pickle.dumps(columns, 0)
        names = [pickled] if kind == 'names' else pickled
        # Names in an array may all refer to the same long text.
        table.attrs['values_block_0_kind'] = np.array(names, f'S{len(pickled)}')


@pytest.mark.parametrize(
    ('kind', 'complaint'),
    [
        ('rows', ''),
        ('more rows', 'has more than 33000000 cells'),
        ('a row', 'a chunk of 1 rows is more than 32 MiB'),
        ('a column of lists', 'is not of numbers'),
        ('names', 'is not an .h5 of DeepLabCut'),
    ],
)
def test_an_h5_takes_memory_by_its_numbers(tmp_path, kind, complaint):
    write_large_h5(tmp_path / 'points.h5', kind)
    peak, error = peak_memory(tmp_path / 'points.h5')
    assert complaint in error
    assert bool(error) == bool(complaint)
    assert peak < 500  # MB; what is refused takes no more than to begin
    assert peak < 150 or not complaint


@pytest.mark.parametrize('text', ['1_000', '\u0661\u0662', '0x10', '1e', '.'])
def test_a_number_is_in_ascii_digits(tmp_path, text):
    with pytest.raises(BagError, match=r'line 2, column a_x: .* is not a number'):
        bring(tmp_path, f't,a_x,a_y\n0,{text},0\n')


@pytest.mark.parametrize('case', [c for c in CASES if 'h5' not in c and 'c3d' not in c])
def test_a_file_that_is_cut_amid_its_last_row_gives_all_rows_before(tmp_path, case):
    _, content, options, *_ = CASES[case]
    sound = content()
    sound = (sound if isinstance(sound, bytes) else sound.encode()).partition(b'\nDevices')[0]
    sound = sound.rstrip(b'\r\n')
    _, stamps, points = bring(tmp_path, sound, **options)
    last = max(sound.rfind(mark) for mark in (b',', b'\t', b';'))
    end = max(sound.rfind(mark, 0, last) for mark in (b',', b'\t', b';')) + 1
    done, got_stamps, got = bring(tmp_path, sound[: end - 1], **options)
    assert any('the row is left out' in note for note in done.notes)
    known = len(got) if case.startswith('sleap') else 3
    assert len(got) == known
    if not case.startswith('sleap'):
        np.testing.assert_array_equal(got_stamps, stamps[:3])
        np.testing.assert_array_equal(got, points[:3])


def test_a_last_line_of_separators_alone_is_no_frame(tmp_path):
    done, *_ = bring(tmp_path, trc() + b'\r\n\t\t')
    assert done.frames == 4
    assert not done.notes


PEAK = """
import sys
from pathlib import Path
from kinpole_ros.bags import BagError
from kinpole_ros.bags.formats import read_points
try:
    read_points(sys.argv[1])
except BagError as error:
    print(error, file=sys.stderr)
# Not ru_maxrss, which a child has from its parent.
print(int(Path('/proc/self/status').read_text().partition('VmHWM:')[2].split()[0]) >> 10)
"""


def peak_memory(file: Path) -> tuple[int, str]:
    """Megabytes that it takes to read a file, and the complaint."""
    done = subprocess.run(
        [sys.executable, '-c', PEAK, str(file)], capture_output=True, text=True, check=True
    )
    return int(done.stdout), done.stderr


@pytest.mark.parametrize(
    ('content', 'complaint', 'megabytes'),
    [
        (b',\n' * 3_000_000, 'of no format known here', 150),  # was 184
        (b't,a_x,a_y\n' + b''.join(b'%d,2,3\n' % k for k in range(1_000_000)), '', 180),  # was 270
        (b't,a_x,a_y\n' + b'1_0,2,3\n' * 1_000_000, "'1_0' is not a number", 150),
        ('\U0001f600'.encode() * 15_000_000, 'a row has more than', 250),  # was 400
        (b't,a_x,a_y\n' + b',"\n"' * 5_000_000, '10001 columns', 150),  # was one endless row
    ],
    ids=['empty cells', 'a table', 'no numbers', 'one line', 'one row of many lines'],
)
def test_a_text_file_takes_memory_by_its_numbers(tmp_path, content, complaint, megabytes):
    file = tmp_path / 'points.csv'
    file.write_bytes(content)
    peak, error = peak_memory(file)
    assert complaint in error
    assert bool(error) == bool(complaint)
    assert peak < megabytes


@pytest.mark.parametrize('end', ['', '_0', 'x'])
def test_numbers_are_those_of_float_in_every_block_of_rows(tmp_path, monkeypatch, end):
    monkeypatch.setattr('kinpole_ros.bags.formats._sheet._BLOCK_CELLS', 64)
    draw = np.random.default_rng(5)
    texts = [
        repr(x) for x in (draw.normal(size=490) * 10.0 ** draw.integers(-300, 300, 490)).tolist()
    ]
    texts[::7] = ['', ' ', 'NaN', '+.5', '5.', '-1E-3', ' 7 '] * 10
    rows = [f'{k},{text},{k}' for k, text in enumerate(texts)]
    (tmp_path / 'points.csv').write_text('\n'.join(['t,a_x,a_y', *rows, f'900,1{end},2\n']))
    if end:
        with pytest.raises(BagError, match=f"line 492, column a_x: '1{end}' is not a number"):
            read_points(tmp_path / 'points.csv')
        return
    _, read = read_points(tmp_path / 'points.csv')
    expected = [float(text.strip() or 'nan') for text in [*texts, '1']]
    assert read.points[:, 0, 0].tobytes() == np.array(expected).tobytes()


@pytest.mark.parametrize('ends', [b'\r', b'\n', b'\r\n'])
def test_lines_may_end_as_on_any_computer(tmp_path, ends):
    rows = b''.join(b'%d,1,2%b' % (k, ends) for k in range(6000))
    done, stamps, _ = bring(tmp_path, b't,a_x,a_y' + ends + rows)
    assert (done.frames, stamps[-1]) == (6000, 5999.0)


def test_tracks_of_sleap_that_would_need_a_frame_each_are_refused(tmp_path):
    rows = ''.join(f't{k},{k},1,2\n' for k in range(9000))
    with pytest.raises(BagError, match='cells; fix: cut it into parts'):
        bring(tmp_path, 'track,frame_idx,tip.x,tip.y\n' + rows, **PIXELS)


def test_more_cells_than_are_held_are_refused_while_reading(tmp_path, monkeypatch):
    monkeypatch.setattr('kinpole_ros.bags.formats._cells.MOST_CELLS', 1000)
    with pytest.raises(BagError, match='more than 1000 cells; fix: cut it into parts'):
        bring(tmp_path, 't,a_x,a_y\n' + '1,2,3\n' * 300)


def test_a_c3d_with_fewer_frames_than_it_claims_is_refused(tmp_path):
    content = bytearray(c3d_file())
    claimed = struct.unpack_from('<H', content, 8)[0] + 500
    struct.pack_into('<H', content, 8, claimed)
    with pytest.raises(BagError, match=r'says that it has .* frames, and has .* cut off'):
        bring(tmp_path, bytes(content))


def test_a_c3d_that_is_cut_anywhere_has_all_frames_or_is_refused(tmp_path):
    content = c3d_file()
    end = 1024 + 4 * 48
    for length in range(520, len(content), 24):
        if length >= end:
            done, *_ = bring(tmp_path, content[:length])
            assert (done.frames, done.notes) == (4, ())
            continue
        with pytest.raises(BagError, match=r'cut off|has no frames|cannot be read|not a C3D'):
            bring(tmp_path, content[:length])


def test_padding_of_a_c3d_supplies_no_frames(tmp_path):
    content = bytearray(c3d_file())
    struct.pack_into('<H', content, 8, struct.unpack_from('<H', content, 8)[0] + 3)
    done, _, points = bring(tmp_path, bytes(content))
    assert done.frames == 4
    assert any('3 of its 7 frames are left out' in note for note in done.notes)
    np.testing.assert_allclose(points, SEEN * 1e-3, rtol=1e-7)


@pytest.mark.parametrize('cut', [0, 16, 32])
def test_a_c3d_filled_up_with_zeros_gives_no_points_at_the_origin(tmp_path, cut):
    content = bytearray(c3d_file())
    frames, first = 70, struct.unpack_from('<H', content, 6)[0]
    struct.pack_into('<H', content, 8, first + frames - 1)
    struct.pack_into('<h', content, content.index(b'FRAMES') + 10, frames)
    content[1024 + 4 * 48 - cut :] = bytes(cut)
    content += bytes(-(-(1024 + frames * 48 - len(content)) // 512) * 512)
    done, _, points = bring(tmp_path, bytes(content))
    assert done.frames == 4 - bool(cut)
    np.testing.assert_allclose(points, SEEN[: done.frames] * 1e-3, rtol=1e-7)
    (note,) = done.notes
    begin = f'amid frame {first + 3}' if cut else f'frame {first + 4}'
    assert f'is zeros from {begin} on' in note
    assert f'{frames - done.frames} of its {frames} frames are left out' in note


def test_points_at_the_origin_in_all_frames_are_kept(tmp_path):
    content = bytearray(c3d_file())
    for frame in range(4):  # the angle, and the second marker
        content[1024 + 48 * frame + 16 : 1024 + 48 * (frame + 1)] = bytes(32)
    done, _, points = bring(tmp_path, bytes(content))
    assert (done.frames, done.notes) == (4, ())
    assert not points[:, 1].any()


def test_motive_that_has_other_frames_than_it_claims_is_noted(tmp_path):
    lines = motive('Meters').splitlines(keepends=True)
    done, *_ = bring(tmp_path, ''.join(lines[:-1]))
    assert any('says that it has 4 frames, and has 3' in note for note in done.notes)


@pytest.mark.parametrize('case', ['dlc', 'motive', 'table', 'sleap', 'kinovea'])
def test_a_last_number_without_an_end_of_line_is_not_believed_in_silence(tmp_path, case):
    if case == 'table':
        options, content = {}, 't,a_x,a_y\n0,1,2\n1,2,3\n2,3,41.5\n'
    else:
        _, make, options, *_ = CASES[case]
        content = str(make()).rstrip() + '\n'
    whole, *_ = bring(tmp_path, content, **options)
    assert not whole.notes
    cut, *_ = bring(tmp_path, content.rstrip()[:-2], **options)
    if case == 'kinovea':
        assert 'cut off amid a cell in quotes; the row is left out' in cut.notes[0]
    else:
        assert 'ends without the end of a line' in cut.notes[0]
    # The head of a file of Motive counts the row.
    assert whole.frames - cut.frames == (0 if case in ('table', 'sleap', 'motive') else 1)


@pytest.mark.parametrize('case', ['table', 'tracker'])
def test_rows_of_separators_at_the_end_are_no_frames(tmp_path, case):
    content = 'a_x,a_y\n1,2\n,\n3,4\n,\n,\n' if case == 'table' else tracker_one() + '\n\t\t\t\n'
    done, *_ = bring(tmp_path, content, rate=10.0, scale=1.0)
    assert done.frames == (3 if case == 'table' else 4)


def test_a_c3d_says_what_it_has_in_place_of_points(tmp_path):
    content = bytearray(c3d_file(names=()).replace(b'POINT', b'XOINT'))
    struct.pack_into('<H', content, 2, 0)
    with pytest.raises(BagError, match='has no points; fix: export positions of markers'):
        bring(tmp_path, bytes(content))
    begin = struct.pack('<bb', 8, -1) + b'ROTATION'
    rotations = content.replace(struct.pack('<bb', 5, -1) + b'XOINT', begin)
    with pytest.raises(BagError, match='has no points, only rotation data, which are not read'):
        bring(tmp_path, bytes(rotations))


def test_counts_and_rates_of_a_c3d_that_differ_are_named(tmp_path):
    content = bytearray(c3d_file())
    struct.pack_into('<h', content, content.index(b'FRAMES') + 10, 3)
    (note,) = bring(tmp_path, bytes(content))[0].notes
    assert note.endswith('says that it has 3 frames, and has 4')
    content = bytearray(c3d_file())
    struct.pack_into('<f', content, 20, 100.0)
    done, stamps, _ = bring(tmp_path, bytes(content))
    assert 'has 200 Hz as its parameter and 100 Hz in its header: the former' in done.notes[0]
    np.testing.assert_allclose(np.diff(stamps), 0.005, atol=1e-9)


@pytest.mark.parametrize(
    ('place', 'wrong'), [('header', 2), ('header', 0), ('USED', 2), ('USED', 0)]
)
def test_points_of_a_c3d_are_those_that_fill_the_file(tmp_path, place, wrong):
    """Frames are read by the wrong bytes else, so that markers are seen in other frames."""
    content = bytearray(c3d_file())
    where = 2 if place == 'header' else content.index(b'USED') + 8
    struct.pack_into('<h', content, where, wrong)
    done, _, points = bring(tmp_path, bytes(content))
    assert '3 are taken, which fill the file' in ''.join(done.notes)
    np.testing.assert_allclose(points, SEEN * 1e-3, rtol=1e-7)


def sleap_orders(axes: str, dims: bool, shape: tuple[int, int, int], scores: bool) -> bytes:
    """An .h5 with axes in this order, f, t, n, x, and places 1000 f + 100 t + 10 n + x."""
    h5py = pytest.importorskip('h5py')
    from io import BytesIO

    f, t, n, x = np.ogrid[: shape[0], : shape[1], : shape[2], :2]
    places = (1000 * f + 100 * t + 10 * n + x + 1).astype(float)
    names = {'f': 'frame', 't': 'track', 'n': 'node', 'x': 'xy'}
    with BytesIO() as file:
        with h5py.File(file, 'w') as content:
            arrays = {'tracks': (axes, places)}
            if scores:
                doubt = np.where((f + t + n)[..., 0] % 3, 0.9, 0.1)
                arrays['point_scores'] = axes.replace('x', ''), doubt
            for name, (order, array) in arrays.items():
                plain = 'ftnx' if 'x' in order else 'ftn'
                content[name] = array.transpose([plain.index(axis) for axis in order])
                if dims:
                    content[name].attrs['dims'] = json.dumps([names[axis] for axis in order])
            content['node_names'] = np.array([f'n{k}'.encode() for k in range(shape[2])])
            content['track_names'] = np.array([f't{k}'.encode() for k in range(shape[1])])
        return file.getvalue()


@pytest.mark.parametrize(
    'shape', [(2, 2, 2), (7, 2, 2), (7, 1, 2), (2, 3, 5), (7, 2, 1), (3, 3, 2)]
)
@pytest.mark.parametrize(
    ('axes', 'dims'),
    [
        *((axes, True) for axes in ('txnf', 'fnxt', 'ftnx', 'xnft')),
        ('txnf', False),
        ('fnxt', False),
    ],
)
def test_axes_of_sleap_are_as_the_file_says_or_the_only_ones_that_fit(tmp_path, shape, axes, dims):
    path = tmp_path / 'a.h5'
    path.write_bytes(sleap_orders(axes, dims, shape, scores=True))
    expected = [1000 * f + 100 * t + 10 * n + 1 for f in range(shape[0])
                for t in range(shape[1]) for n in range(shape[2])]  # fmt: skip
    try:
        _, found = read_points(path)
    except BagError as error:
        assert not dims
        assert 'may be by track, xy, node, frame or the reverse; fix: ' in str(error)
        assert shape[2] == 2
        return
    assert found.points[..., 0].ravel().tolist() == expected
    _, sure = read_points(path, options=Options(likelihood=0.5))
    doubtful = (np.indices(shape).sum(axis=0) % 3 == 0).ravel().tolist()
    assert np.isnan(sure.points[..., 0]).ravel().tolist() == doubtful


def test_axes_of_sleap_that_fit_no_names_are_refused(tmp_path):
    (tmp_path / 'a.h5').write_bytes(sleap_orders('ftnx', False, (7, 1, 2), scores=False))
    with pytest.raises(BagError, match=r'has places by \(7, 1, 2, 2\), which fit no names; fix: '):
        read_points(tmp_path / 'a.h5')


@pytest.mark.parametrize('is_text', [True, False])
def test_a_sleap_file_without_scores_refuses_a_likelihood(tmp_path, is_text):
    path = tmp_path / 'a.dat'
    if is_text:
        path.write_text('track,frame_idx,tip.x,tip.y\na,0,1,2\na,1,2,2\n')
    else:
        path.write_bytes(sleap_orders('txnf', False, (7, 1, 3), scores=False))
    read_points(path)
    with pytest.raises(BagError, match='has no scores of points; fix: leave'):
        read_points(path, options=Options(likelihood=0.5))
