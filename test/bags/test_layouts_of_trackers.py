"""Layouts of trackers' files, written from the documentation of each, are read exactly."""

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_formats import NAN, SEEN, bring, c3d_file, cells, motive, peak_memory, trc

from kinpole_ros.bags import BagError, read_messages
from kinpole_ros.bags.formats import read_points
from kinpole_ros.messages import PoseReader

FLAT = SEEN * [1, 1, 0]
TURNS = np.radians([0.0, 30.0, 120.0, 250.0])  # about z, of a body in four frames


def qualisys_3d(times: bool = False) -> str:
    """What was not seen is zeros; titles, events and types of trajectories are in newer files."""
    lines = ['NO_OF_FRAMES\t4', 'NO_OF_CAMERAS\t8', 'NO_OF_MARKERS\t2', 'FREQUENCY\t250',
             'NO_OF_ANALOG\t0', 'DESCRIPTION\t--', 'DATA_INCLUDED\t3D']  # fmt: skip
    if times:
        lines = ['FILE_VERSION\t2.0.0', *lines, 'EVENT\tstart\t1\t0.00000', 'EVENT\tend\t4\t0.012']
    lines += ['MARKER_NAMES\tR tip\theel']
    if times:
        lines += ['TRAJECTORY_TYPES\tMeasured\tMixed',
                  'Frame\tTime\tR tip X\tR tip Y\tR tip Z\theel X\theel Y\theel Z']  # fmt: skip
    for k, row in enumerate(np.nan_to_num(SEEN)):
        numbers = '\t'.join(f'{value:.3f}' for value in row.ravel())
        lines.append(f'{k + 1}\t{k / 250:.5f}\t{numbers}' if times else f'{numbers}\t')
    return '\r\n'.join(lines) + '\r\n'


def qualisys_6d(times: bool) -> str:
    """Two bodies that turn about z and about x; the second was not tracked in one frame."""
    lines = ['NO_OF_FRAMES\t4', 'NO_OF_BODIES\t2', 'FREQUENCY\t100', 'DATA_INCLUDED\t6D',
             'BODY_NAMES\tarm\trod']  # fmt: skip
    titles = 'X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t' + '\t'.join(f'Rot[{k}]' for k in range(9))
    if times:
        lines.append(f'Frame\tTime\tarm {titles}\trod {titles}')
    for k, turn in enumerate(TURNS):
        c, s = np.cos(turn), np.sin(turn)
        about_z, about_x = [[c, -s, 0], [s, c, 0], [0, 0, 1]], [[1, 0, 0], [0, c, -s], [0, s, c]]
        numbers = [*SEEN[k, 0], 0, 0, np.degrees(turn), 0.5, *np.ravel(about_z, 'F')]
        if np.isnan(SEEN[k, 1]).any():
            numbers += [0] * 6 + [-1] + [0] * 9
        else:
            numbers += [*SEEN[k, 1], np.degrees(turn), 0, 0, 0.5, *np.ravel(about_x, 'F')]
        row = '\t'.join(f'{value:.5f}' for value in numbers)
        lines.append(f'{k + 1}\t{k / 100:.5f}\t{row}' if times else row)
    return '\n'.join(lines) + '\n'


def sleap_h5(is_reversed: bool) -> bytes:
    h5py = pytest.importorskip('h5py')
    from io import BytesIO

    places = SEEN[:, :, :2].transpose(1, 2, 0)[:, :, None]  # track, axis, node, frame
    content = BytesIO()
    with h5py.File(content, 'w') as file:
        file['tracks'] = places.T if is_reversed else places
        file['node_names'] = np.array([b'tip'])
        file['track_names'] = np.array([b'rod_0', b'rod_1'])
        file['track_occupancy'] = np.ones((4, 2), np.uint8)
    return content.getvalue()


def kinovea_text(is_old: bool) -> str:
    lines = ['#Kinovea Trajectory data export', '#T X Y']
    for name, marker in (('hip', 0), ('Angle 1', 1)):
        lines += [] if is_old else ['', f'# {name}']
        for k, (x, y, _) in enumerate(SEEN[:, marker]):
            if not np.isnan(x):
                point = f'{x:.3f} {y:.3f} '.replace('.', ',' if k % 2 else '.')
                time = f'0:00:01:{4 * k:02d}' if is_old else f'{1 + k * 0.04:.2f}'
                both = is_old or name == 'hip'
                lines.append(f'{time} {point}' if both else f'{time} {point}{point}')
        lines += ['', ''] if is_old else []
    return '\r\n'.join(lines) + '\r\n'


def kinovea_xml() -> str:
    return kinovea_sheet({
        name: [
            [f'{x:.3f}', f'{y:.3f}', f'0:00:00:{4 * k:02d}']
            for k, (x, y, _) in enumerate(SEEN[:, marker])
            if not np.isnan(x)
        ]
        for name, marker in (('hip', 0), ('knee', 1))
    }, 'cm')  # fmt: skip


def kinovea_sheet(tracks: dict[str, list[list[str]]], unit: str) -> str:
    """The sheet of Excel, with key images before the tracks."""
    rows = [['Key Images'], ['Title', 'Time'], ['0:00:00:04 (1)', '0:00:00:04']]
    for name, track in tracks.items():
        title = f'Coords (x,y:{unit}; t:time)'
        rows += [[''], ['Track'], ['Label :', name], [title], ['x', 'y', 't'], *track]
    space = 'urn:schemas-microsoft-com:office:spreadsheet'
    body = ''.join(
        '<Row>'
        + ''.join(f'<Cell><Data ss:Type="String">{cell}</Data></Cell>' for cell in row)
        + '</Row>'
        for row in rows
    )
    return (
        f'<?xml version="1.0"?><Workbook xmlns="{space}" xmlns:ss="{space}"><Worksheet><Table>'
        f'{body}</Table></Worksheet></Workbook>'
    )


def tracker_project(scale: float, angle: float, unit: str = '') -> str:
    tracks = {
        name: {10 + k: (x, y) for k, (x, y, _) in enumerate(SEEN[:, marker]) if not np.isnan(x)}
        for name, marker in (('mass A', 0), ('mass B', 1))
    }
    return tracker_project_of(tracks, scale, angle, unit, 10, 500.0, 40.0)


def tracker_project_of(
    points: dict[str, Any], scale: float, angle: float, unit: str, first: int, start: float,
    step: float,
) -> str:  # fmt: skip
    """Marks in the picture, y down, of points in the user's axes, by name and frame."""

    def value(name: str, text: object, kind: str = 'double') -> str:
        return f'<property name="{name}" type="{kind}">{text}</property>'

    def thing(name: str, cls: str, *inner: str) -> str:
        begin = f'{name}<object class="org.opensourcephysics.{cls}">'
        return f'{begin}{"".join(inner)}</object></property>'

    def framedata(cls: str, rows: dict[int, dict[str, float]]) -> str:
        items = (
            thing(f'<property name="[{k}]" type="object">', f'{cls}$FrameData',
                  *(value(*one) for one in row.items()))
            for k, row in rows.items()
        )  # fmt: skip
        return f'<property name="framedata" type="array">{"".join(items)}</property>'

    turn, tracks = np.radians(angle), ''
    for name, places in points.items():
        marks = {}
        for k, (x, y) in places.items():
            right = x * np.cos(turn) - y * np.sin(turn)
            up = x * np.sin(turn) + y * np.cos(turn)
            marks[k] = {'x': float(320 + scale * right), 'y': float(240 - scale * up)}
        point_mass = 'cabrillo.tracker.PointMass'
        tracks += thing('<property name="item" type="object">', point_mass,
                        value('mass', 1.0), value('name', name, 'string'),
                        framedata(point_mass, marks))  # fmt: skip
    axes = {
        0: {'xorigin': 320.0, 'yorigin': 240.0, 'angle': angle, 'xscale': scale, 'yscale': scale}
    }
    system = 'media.core.ImageCoordSystem'
    panel = [
        thing('<property name="videoclip" type="object">', 'media.core.VideoClip',
              value('startframe', first, 'int'), value('starttime', start)),
        thing('<property name="clipcontrol" type="object">', 'media.core.StepperClipControl',
              value('delta_t', step)),
        thing('<property name="coords" type="object">', system, framedata(system, axes)),
        value('length_unit', unit, 'string') if unit else '',
        f'<property name="tracks" type="collection">{tracks}</property>',
    ]  # fmt: skip
    whole = thing('', 'cabrillo.tracker.TrackerPanel', *panel).removesuffix('</property>')
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{whole}\n'


def motive_121() -> str:
    """Rows of the head have no titles."""
    lines = motive('Meters').replace('1.23', '1.21').split('\n')
    return '\n'.join(
        line.replace(',Type,', ',,')
        .replace(',Name,', ',,')
        .replace(',ID,', ',,')
        .replace('(Sec', '')
        for line in lines
    )


def anipose() -> str:
    names = [f'{part}_{what}' for part in ('l-tip', 'l_heel')
             for what in ('x', 'y', 'z', 'error', 'ncams', 'score')]  # fmt: skip
    lines = [','.join([*names, 'M_00', 'M_01', 'center_0', 'fnum'])]
    for k, row in enumerate(SEEN):
        numbers = [','.join('nan' if NAN is v or v != v else repr(float(v)) for v in one)
                   + ',0.5,3,0.9' for one in row]  # fmt: skip
        lines.append(','.join([*numbers, '1.0,0.0,0.0', str(k)]))
    return '\n'.join(lines) + '\n'


def coco(results: bool) -> str:
    annotations = [
        {'image_id': 40 + k, 'category_id': 1, 'score': 0.9,
         'keypoints': [v for x, y, _ in row for v in ((x, y, 2) if x == x else (0, 0, 0))]}
        for k, row in enumerate(SEEN.tolist())
    ]  # fmt: skip
    if results:
        return json.dumps(annotations)
    images = [{'id': 40 + k, 'file_name': f'video/img_{k + 7:05d}.jpg'} for k in range(4)]
    keypoints = {'id': 1, 'name': 'rod', 'keypoints': ['tip', 'heel']}
    whole = {'images': images, 'annotations': annotations, 'categories': [keypoints]}
    return json.dumps(whole)


def c3d_of(kind: str) -> bytes:
    """The file of c3d_file in the numbers of another processor, or in integers."""
    content = bytearray(c3d_file())
    frames = np.frombuffer(bytes(content[1024 : 1024 + 4 * 48]), '<f4').copy()

    def dec(values: np.ndarray) -> bytes:
        halves = (values.astype('<f4') * np.float32(4)).view('<u2').reshape(-1, 2)
        return halves[:, ::-1].tobytes()

    if kind == 'integers':
        # In steps of an eighth, with two analog samples in each frame.
        scaled = np.where(np.arange(48) % 4 == 3, frames, frames * 8).reshape(4, 12)
        words = np.concatenate((np.rint(scaled), np.full((4, 2), 77)), axis=1).astype('<i2')
        for place in (512 + content[512:].index(b'SCALE') + 9, 12):
            content[place : place + 4] = struct.pack('<f', 0.125)
        struct.pack_into('<H', content, 4, 2)
        return bytes(content[:1024]) + words.tobytes().ljust(512, b'\0')
    if kind == 'DEC':
        content[512 + 3] = 85
        for place in (512 + content[512:].index(b'SCALE') + 9, 12):
            content[place : place + 4] = dec(np.array([-1.0]))
        for place in (512 + content[512:].index(b'RATE') + 8, 20):
            content[place : place + 4] = dec(np.array([200.0]))
        return bytes(content[:1024]) + dec(frames).ljust(512, b'\0')
    raise ValueError(kind)


CM, MM = FLAT * 0.01, SEEN * 1e-3
PX = {'scale': 1.0, 'rate': 50.0}
DOWN = FLAT * [1, -1, 1]
Case = tuple[str, Callable[[], str | bytes], dict[str, Any], Any, Any, np.ndarray]
CASES: dict[str, Case] = {
    'qualisys': ('qualisys', qualisys_3d, {}, ('R tip', 'heel'), (250, 0), MM),
    'qualisys, times': (
        'qualisys', lambda: qualisys_3d(True), {}, ('R tip', 'heel'), (250, 0), MM,
    ),
    'qualisys 6D': ('qualisys', lambda: qualisys_6d(False), {}, ('arm', 'rod'), (100, 0), MM),
    'qualisys 6D, times': ('qualisys', lambda: qualisys_6d(True), {}, ('arm', 'rod'), (100, 0), MM),
    'sleap .h5': (
        'sleap', lambda: sleap_h5(False), PX, ('rod_0.tip', 'rod_1.tip'), (50, 0), DOWN,
    ),
    'sleap .h5, reversed': (
        'sleap', lambda: sleap_h5(True), PX, ('rod_0.tip', 'rod_1.tip'), (50, 0), DOWN,
    ),
    'kinovea text': (
        'kinovea', lambda: kinovea_text(True), {'scale': 1.0},
        ('track 1', 'track 2'), (25, 1), FLAT,
    ),
    'kinovea text, names': (
        'kinovea', lambda: kinovea_text(False), {'scale': 1.0},
        ('hip', 'Angle 1.1', 'Angle 1.2'), (25, 1), FLAT[:, [0, 1, 1]],
    ),
    'kinovea .xml': ('kinovea', kinovea_xml, {}, ('hip', 'knee'), (25, 0), CM),
    'tracker .trk': (
        'tracker', lambda: tracker_project(50.0, 20.0), {}, ('mass A', 'mass B'), (25, 0.5), FLAT,
    ),
    'tracker .trk, cm': (
        'tracker', lambda: tracker_project(0.5, -90.0, 'cm'), {},
        ('mass A', 'mass B'), (25, 0.5), CM,
    ),
    'tracker .trk, pixels': (
        'tracker', lambda: tracker_project(1.0, 0.0), {'scale': 0.5},
        ('mass A', 'mass B'), (25, 0.5), FLAT * 0.5,
    ),
    't x y': (
        'table', lambda: 't\tx\ty\n' + ''.join(
            f'{k / 25}\t{cells(row, chr(9))}\n' for k, row in enumerate(SEEN[:, 1, :2])
        ), {}, ('point',), (25, 0), FLAT[:, 1:],
    ),
    't x y of numpy': (
        'table', lambda: '# t x y z\n' + ''.join(
            f'{k / 25} {cells(row, "  ")}\n' for k, row in enumerate(SEEN[:, 0])
        ), {}, ('point',), (25, 0), SEEN[:, :1],
    ),
    'x1 y1 in mm': (
        'table', lambda: 'Time (ms),X1 (mm),Y1 (mm),X2 (mm),Y2 (mm)\n' + ''.join(
            f'{k * 40},{cells(row[:, :2])}\n' for k, row in enumerate(SEEN)
        ), {}, ('point1', 'point2'), (25, 0), FLAT * 1e-3,
    ),
    'anipose': (
        'anipose', anipose, {'rate': 50.0, 'scale': 1e-3}, ('l-tip', 'l_heel'), (50, 0), MM
    ),
    'motive 1.21': (
        'motive', motive_121, {}, ('rod:Marker1', 'Unlabeled 1189'), (120, 0), SEEN
    ),
    'trc, two tabs': (
        'trc', lambda: trc().replace(b'\t\t\tR.heel\t\t\t', b'\t\tR.heel').replace(
            b'Time\t', b'Time\t\t'), {}, ('R.tip', 'R.heel'), (150, 0), MM,
    ),
    'trc, one tab': (
        'trc', lambda: trc().replace(b'\t\t\tR.heel\t\t\t', b'\tR.heel'),
        {}, ('R.tip', 'R.heel'), (150, 0), MM,
    ),
    'trc, tabs behind': (
        'trc', lambda: trc().replace(b'\r\n', b'\t\t\t\r\n') + b'\t\t\t\r\n',
        {}, ('R.tip', 'R.heel'), (150, 0), MM,
    ),
    'trc, wrong counts': (
        'trc', lambda: trc().replace(b'\t4\t2\tmm', b'\t8\t99\tmm'),
        {}, ('R.tip', 'R.heel'), (150, 0), MM,
    ),
    'coco': ('keypoints', lambda: coco(False), PX, ('tip', 'heel'), (50, 0), DOWN),
    'coco results': ('keypoints', lambda: coco(True), PX, ('point 0', 'point 1'), (50, 0), DOWN),
    'c3d, integers': ('c3d', lambda: c3d_of('integers'), {}, ('tip', 'heel'), (200, 0.025), MM),
    'c3d, DEC': ('c3d', lambda: c3d_of('DEC'), {}, ('tip', 'heel'), (200, 0.025), MM),
}  # fmt: skip


@pytest.mark.parametrize('case', CASES)
def test_a_layout_is_recognized_and_exact(tmp_path, case):
    kind, content, options, markers, (rate, start), places = CASES[case]
    done, stamps, got = bring(tmp_path, content(), **options)
    assert (done.format, done.markers) == (kind, markers)
    np.testing.assert_allclose(stamps, start + np.arange(4) / rate, rtol=0, atol=1e-9)
    np.testing.assert_allclose(got, places, rtol=1e-7, atol=1e-12)


def test_wrong_counts_of_a_trc_are_noted(tmp_path):
    done, *_ = bring(tmp_path, CASES['trc, wrong counts'][1]())
    assert 'says that it has 8 frames, and has 4' in str(done.notes)
    assert 'says that it has 99 markers, and has 2' in str(done.notes)


def poses_in(bag: Path, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, B, 3) and x and y axes (T, B, 2, 3) on /tf, as the tracker reads them."""
    messages = [m.data for m in read_messages(bag, ['/tf'])]
    parts = PoseReader('tf', names).read(messages)
    axes = [part.axes for part in parts]
    return np.concatenate([part.points for part in parts]), np.concatenate(axes)


@pytest.mark.parametrize('times', [False, True])
def test_bodies_of_qualisys_have_their_poses(tmp_path, times):
    done, *_ = bring(tmp_path, qualisys_6d(times))
    assert any('marker_type: tf' in note for note in done.notes)
    points, axes = poses_in(tmp_path / 'out.mcap', ('arm', 'rod'))
    np.testing.assert_allclose(points, MM, atol=1e-12)
    zero, one = np.zeros(4), np.ones(4)
    c, s = np.cos(TURNS), np.sin(TURNS)
    expected = np.array(
        [[[c, s, zero], [-s, c, zero]], [[one, zero, zero], [zero, c, s]]]
    ).transpose(3, 0, 1, 2)
    expected[1, 1] = np.nan
    np.testing.assert_allclose(axes, expected, atol=2e-5)


def test_angles_of_qualisys_are_turned_about_x_then_y_then_z(tmp_path):
    """By the documentation each turn is about an axis of the body as turned before."""
    head = 'NO_OF_FRAMES\t1\nFREQUENCY\t100\nDATA_INCLUDED\t6D\nBODY_NAMES\tarm\n'
    bring(tmp_path, f'{head}1\t2\t3\t90\t0\t90\t0.1\n1\t2\t3\t90\t0\t90\t0.1\n')
    _, axes = poses_in(tmp_path / 'out.mcap', ('arm',))
    np.testing.assert_allclose(axes[0, 0], [[0, 0, 1], [-1, 0, 0]], atol=1e-12)


def test_bodies_of_motive_without_markers_have_their_poses(tmp_path):
    lines = motive('Meters').split('\n')
    for k, turn in enumerate(TURNS):
        pose = [0, 0, np.sin(turn / 2), np.cos(turn / 2), *SEEN[k, 0]]
        lines[7 + k] = f'{k},{k / 120:.6f},{cells(np.array(pose))},0.001'
    # Only the body is exported.
    lines[2:7] = [','.join(line.split(',')[:10]) for line in lines[2:7]]
    done, _, got = bring(tmp_path, '\n'.join(lines) + '\n')
    assert done.markers == ('rod',)
    np.testing.assert_allclose(got[:, 0], SEEN[:, 0])
    points, axes = poses_in(tmp_path / 'out.mcap', ('rod',))
    np.testing.assert_allclose(points[:, 0], SEEN[:, 0])
    expected = np.stack([np.cos(TURNS), np.sin(TURNS)], axis=-1)
    np.testing.assert_allclose(axes[:, 0, 0, :2], expected, atol=3e-6)


@pytest.mark.parametrize(('unit', 'factor'), [('', 1.0), (' (rad)', np.pi / 180)])
def test_angles_of_kinovea_are_poses(tmp_path, unit, factor):
    rows = ''.join(f'{40 * k};{v * factor}\n' for k, v in enumerate([10.0, 20.5, 200.0]))
    done, stamps, _ = bring(tmp_path, f'Time (ms);Angle 1{unit}\n{rows}')
    assert (done.format, stamps.tolist()) == ('kinovea', [0, 0.04, 0.08])
    _, axes = poses_in(tmp_path / 'out.mcap', (f'Angle 1{unit}',))
    angles = np.degrees(np.arctan2(axes[:, 0, 0, 1], axes[:, 0, 0, 0]))
    np.testing.assert_allclose(angles, [10.0, 20.5, -160.0], atol=1e-9)


@pytest.mark.parametrize(
    'head',
    [
        *(
            'Tiempo (ms);Ángulo 1',
            'Zeit (ms);Winkel 1',
            'Temps (ms);Angle 1',
            'Tempo (ms);Angolo 1',
        ),
        *('Tijd (ms);Hoek 1', 'Czas (ms);Kąt 1', 'Время (ms);Угол 1', '时间 (ms);角度 1'),
    ],
)
def test_kinovea_writes_headings_in_any_language(tmp_path, head):
    done, stamps, _ = bring(tmp_path, f'{head}\n0;10,0\n40;20,5\n80;200,0\n')
    assert (done.format, stamps.tolist()) == ('kinovea', [0, 0.04, 0.08])
    time = head.partition(';')[0]
    rows = '"0";"1";"2"\n"40";"3";"4"\n'
    done, stamps, got = bring(tmp_path, f'"{time}";"bob/P/X";"bob/P/Y"\n{rows}', scale=1.0)
    assert (done.format, stamps.tolist()) == ('kinovea', [0, 0.04])
    np.testing.assert_allclose(got[:, 0, :2], [[1, 2], [3, 4]])


def test_y_down_mirrors_poses(tmp_path):
    bring(tmp_path, qualisys_6d(True), y_down=True)
    points, axes = poses_in(tmp_path / 'out.mcap', ('arm',))
    np.testing.assert_allclose(points, MM[:, :1] * [1, -1, 1], atol=1e-12)
    expected = np.stack([np.cos(TURNS), -np.sin(TURNS)], axis=-1)
    np.testing.assert_allclose(axes[:, 0, 0, :2], expected, atol=2e-5)


def openpose(folder: Path, people: int = 1, in_space: bool = False) -> Path:
    """A file a frame, numbered by the program; a person of two points of 25."""
    folder.mkdir()
    for k, row in enumerate(SEEN.tolist()):
        found = []
        for person in range(people):
            flat = [0.0] * (100 if in_space else 75)
            for index, (x, y, z) in ((4, row[0]), (7, row[1])):
                if x == x:
                    step = 4 if in_space else 3
                    point = (x + person, y, z, 0.9) if in_space else (x + person, y, 0.9)
                    flat[step * index : step * index + step] = point
            two, three = ([], flat) if in_space else (flat, [])
            found.append({'person_id': [-1], 'pose_keypoints_2d': two, 'pose_keypoints_3d': three,
                          'hand_left_keypoints_2d': []})  # fmt: skip
        text = json.dumps({'version': 1.3, 'people': found})
        (folder / f'run_{k:012d}_keypoints.json').write_text(text)
    return folder


@pytest.mark.parametrize('in_space', [False, True])
def test_a_folder_of_openpose_is_one_capture(tmp_path, in_space):
    kind, read = read_points(openpose(tmp_path / 'json', in_space=in_space))
    assert (kind, read.frames.tolist(), read.y_down) == ('keypoints', [0, 1, 2, 3], not in_space)
    assert read.unit == ('' if in_space else 'px')
    columns = [list(read.names).index(name) for name in ('RWrist', 'LWrist')]
    np.testing.assert_array_equal(read.points[:, columns], SEEN if in_space else FLAT)
    assert np.isnan(np.delete(read.points, columns, axis=1)).all()


@pytest.mark.parametrize('content', ['{},', '{"a":1},', '[],', '1,', '"\U0001f600aaaaaaaa",'])
def test_json_of_many_parts_is_bounded(tmp_path, content):
    count = ((32 << 20) - 100) // len(content.encode())
    (tmp_path / 'points.json').write_text('[{"keypoints":1},' + content * count + '1]')
    peak, complaint = peak_memory(tmp_path / 'points.json')
    assert re.search('File too large; fix: cut|is not JSON of keypoints; fix', complaint)
    assert peak < 512


@pytest.mark.parametrize('content', ['<a/>', '<a b="1" c="2"/>', '<a>text</a>', 'x' * 1000])
def test_xml_of_many_parts_is_bounded(tmp_path, content):
    count = (47 << 20) // len(content)
    text = kinovea_xml().replace('<Table>', '<Table>' + content * count)
    (tmp_path / 'points.xml').write_text(text)
    peak, complaint = peak_memory(tmp_path / 'points.xml')
    assert ('is not XML that can be read' in complaint) == ('<' in content)
    assert peak < 512


def test_people_of_openpose_have_numbers_and_a_note(tmp_path):
    _, read = read_points(openpose(tmp_path / 'json', people=2))
    assert 'in any order' in str(read.notes)
    first, second = (list(read.names).index(f'person_{k}.RWrist') for k in range(2))
    np.testing.assert_array_equal(read.points[:, second] - read.points[:, first], [[1, 0, 0]] * 4)


@pytest.mark.parametrize(
    ('content', 'options', 'complaint'),
    [
        (lambda: qualisys_3d().replace('Y\t250', 'Y\tEXT'), {}, 'has no times; fix: give --rate'),
        (lambda: qualisys_3d().replace('MARKER_NAMES', 'OTHER'), {}, 'names no markers or bodies'),
        (lambda: qualisys_3d().replace('heel', 'heel\tmid'), {}, 'cells, which is no number'),
        (anipose, {}, 'in a unit that the file does not say and has no times; fix: .*; and give'),
        (lambda: sleap_h5(False), {}, 'is in px and has no times; fix: .*; and give --rate'),
        (lambda: coco(False), {}, 'is in px and has no times; fix: .*; and give --rate'),
        (lambda: coco(False)[:-9], PX, 'is not JSON of keypoints'),
        (lambda: '[' * 100_000 + '"keypoints"', PX, 'is not JSON of keypoints'),
        (lambda: tracker_project(1.0, 0.0), {}, 'is in px; fix: give --scale'),
        (lambda: tracker_project(0.0, 0.0), {}, 'the scale is 0'),
        (lambda: tracker_project(9.0, 0.0)[:-200], {}, 'is not XML that can be read'),
        (lambda: tracker_project(9.0, 0.0).replace('name="y"', 'name="z"'), {}, 'has no y; fix'),
        (lambda: kinovea_xml().replace('209', 'a').replace('10.5', 'x'), {}, 'is not t, x and y'),
        (lambda: kinovea_xml().replace('<W', '<!DOCTYPE a [<!ENTITY b "c">]><W', 1), {},
         'it defines entities'),
        (lambda: kinovea_xml().replace('<Row>', '<a/>' * 400_000 + '<Row>', 2), {},
         'more than 400000 elements'),
        (lambda: kinovea_text(True), {}, 'in a unit that the file does not say; fix: give --scale'),
        (lambda: 'Time;Angle 1\n0;10\n40;20\n', {}, 'times that go on by 40 .*fix: give --rate'),
    ],
)  # fmt: skip
def test_what_a_layout_lacks_is_asked_for_in_one_line(tmp_path, content, options, complaint):
    with pytest.raises(BagError, match=complaint) as error:
        bring(tmp_path, content(), **options)
    assert str(error.value).isprintable()


def motive_angles(order: str) -> str:
    """A body alone, with angles in place of quaternions: 90 degrees about the first two axes."""
    lines = motive('Meters').split('\n')
    lines[0] += f',Rotation Type,{order}'
    for k in range(4):
        angles = dict(zip(order, (90.0, 90.0, 0.0), strict=True))
        numbers = np.array([*(angles[axis] for axis in 'XYZ'), *SEEN[k, 0]])
        lines[7 + k] = f'{k},{k / 120:.6f},{cells(numbers)},0.001'
    lines[2:7] = [','.join(line.split(',')[:5] + line.split(',')[6:10]) for line in lines[2:7]]
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize(
    ('order', 'x_axis'), [('XYZ', (0, 0, -1)), ('ZYX', (0, 0, -1)), ('YXZ', (0, 0, -1))]
)
def test_angles_of_motive_are_about_the_axes_of_the_body_in_their_order(tmp_path, order, x_axis):
    done, *_ = bring(tmp_path, motive_angles(order))
    assert done.markers == ('rod',)
    points, axes = poses_in(tmp_path / 'out.mcap', ('rod',))
    np.testing.assert_allclose(points[:, 0], SEEN[:, 0])
    c, s = 0.0, 1.0
    turns = {'X': [[1, 0, 0], [0, c, -s], [0, s, c]], 'Y': [[c, 0, s], [0, 1, 0], [-s, 0, c]],
             'Z': [[c, -s, 0], [s, c, 0], [0, 0, 1]]}  # fmt: skip
    whole = np.array(turns[order[0]]) @ turns[order[1]]
    np.testing.assert_allclose(axes[0, 0], whole.T[:2], atol=1e-9)


def test_model_outputs_of_nexus_alone_are_read_where_they_are_places(tmp_path):
    head = 'Model Outputs\n100\n,,rig:Angle,,,rig:Center,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n'
    rows = ''.join(f'{k + 1},0,1,2,3,{cells(SEEN[k, 0])}\n' for k in range(4))
    done, stamps, got = bring(tmp_path, f'{head},,deg,deg,deg,mm,mm,mm\n{rows}')
    assert (done.format, done.markers) == ('vicon', ('rig:Center',))
    assert 'outputs of the model that are not read: rig:Angle' in ' '.join(done.notes)
    np.testing.assert_allclose(np.diff(stamps), 0.01, atol=1e-9)
    np.testing.assert_allclose(got[:, 0], SEEN[:, 0] * 1e-3)
    with pytest.raises(BagError, match='which are no places: rig:Angle, rig:Center; fix: export'):
        bring(tmp_path, f'{head},,deg,deg,deg,N,N,N\n{rows}')


@pytest.mark.parametrize('kind', ['motive', 'trc', 'qualisys'])
def test_a_last_row_that_the_head_counts_is_kept_without_its_end(tmp_path, kind):
    content = {'motive': motive('Meters').encode(), 'trc': trc(),
               'qualisys': qualisys_3d(True).encode()}[kind]  # fmt: skip
    done, *_ = bring(tmp_path, content.rstrip()[:-2])
    assert done.frames == 4
    notes = ' '.join(done.notes)
    assert 'the file counts that row, so it is kept: see that its last number is whole' in notes
    assert 'says that it has' not in notes
