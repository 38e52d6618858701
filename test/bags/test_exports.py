"""Real files of trackers read as readers written here for each, which share no code with ours."""

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz_captures import EXPORTS, fuzz_captures

from kinpole_ros.bags import BagError, import_points
from kinpole_ros.bags.formats import read_points

Read = tuple[np.ndarray, np.ndarray | None]  # points (T, n, 3), times (T,)


def rows_of(path: Path, mark: str) -> list[list[str]]:
    return [line.split(mark) for line in path.read_text('latin-1').splitlines()]


def numbers(cells: list[str]) -> list[float]:
    return [float(cell) if cell.strip() else np.nan for cell in cells]


def trc(path: Path) -> Read:
    mark = ',' if 'pyomeca' in path.name else '\t'
    rows = [row for row in rows_of(path, mark)[5:] if row[0].strip().isdigit()]
    count = len([name for name in rows_of(path, mark)[3][2:] if name])
    table = np.array([numbers(row[: 2 + 3 * count]) for row in rows])
    return table[:, 2:].reshape(len(table), -1, 3), table[:, 1]


def vicon(path: Path) -> Read:
    rows = rows_of(path, ',')[5:]
    count = len([name for name in rows_of(path, ',')[2] if name])
    found = [numbers(row[: 2 + 3 * count]) for row in rows if row[0].strip().isdigit()]
    table = np.array(found)
    return table[:, 2:].reshape(len(table), -1, 3), table[:, 0] / 100


def motive(path: Path) -> Read:
    rows = rows_of(path, ',')
    chosen = [k for k, kind in enumerate(rows[2]) if kind == 'Marker']
    table = np.array([numbers(row) for row in rows[7:] if len(row) > 1])
    return table[:, chosen].reshape(len(table), -1, 3), table[:, 1]


def qualisys(path: Path) -> Read:
    table = np.array([numbers(row) for row in rows_of(path, '\t')[10:] if len(row) > 1])
    points = table.reshape(len(table), -1, 3)
    points[(points == 0).all(axis=-1)] = np.nan
    return points, np.arange(len(table)) / 256


def sleap(path: Path) -> Read:
    h5py = pytest.importorskip('h5py')
    with h5py.File(path) as file:
        tracks = file['tracks'][:]
    points = np.zeros((tracks.shape[3], tracks.shape[0] * tracks.shape[2], 3))
    for track in range(tracks.shape[0]):
        for node in range(tracks.shape[2]):
            points[:, track * tracks.shape[2] + node, :2] = tracks[track, :, node].T
    points[np.isnan(points).any(axis=-1)] = np.nan
    return points, None


def kinovea(path: Path) -> Read:
    """Row after row of each track; the last begins a frame later, or ends one later."""
    space = '{urn:schemas-microsoft-com:office:spreadsheet}'
    tracks: list[list[list[str]]] = []
    for row in ET.parse(path).iter(f'{space}Row'):
        cells = [cell.text or '' for cell in row.iter(f'{space}Data')]
        if cells == ['x', 'y', 't']:
            tracks.append([])
        elif tracks and len(cells) == 3:
            tracks[-1].append(cells)
    points = np.full((max(map(len, tracks)), len(tracks), 3), np.nan)
    for column, track in enumerate(tracks):
        points[: len(track), column] = [[float(x), float(y), 0] for x, y, _ in track]
    return points, None


def deeplabcut(path: Path) -> Read:
    rows = rows_of(path, ',')
    first = next(k for k, row in enumerate(rows) if row[0] == 'coords')
    chosen = [k for k, name in enumerate(rows[first]) if name in ('x', 'y')]
    table = np.array([numbers([row[k] for k in chosen]) for row in rows[first + 1 :]])
    flat = table.reshape(len(table), -1, 2)
    points = np.concatenate((flat, np.where(np.isnan(flat[..., :1]), np.nan, 0)), axis=-1)
    return points, None


READERS: dict[str, Callable[[Path], Read]] = {
    'trc/*.trc': trc,
    'vicon/*.csv': vicon,
    'motive/*.csv': motive,
    'qualisys/*.tsv': qualisys,
    'sleap/*.h5': sleap,
    'kinovea/*.xml': kinovea,
    'deeplabcut/*.csv': deeplabcut,
}
FILES = [(path, read) for name, read in READERS.items() for path in sorted(EXPORTS.glob(name))]


@pytest.mark.parametrize(('path', 'read'), FILES, ids=[path.name for path, _ in FILES])
def test_an_export_is_as_another_reader_has_it(path, read):
    _, found = read_points(path)
    points, times = read(path)
    seen = np.where(np.isnan(points).any(axis=-1, keepdims=True), np.nan, points)
    ours = np.where(np.isnan(found.points).any(axis=-1, keepdims=True), np.nan, found.points)
    np.testing.assert_array_equal(ours, seen)
    if times is not None:
        # Many have times rounded to ms.
        np.testing.assert_allclose(found.times, times, atol=6e-4)


@pytest.mark.parametrize('path', sorted(EXPORTS.glob('c3d/*')), ids=lambda path: path.name)
@pytest.mark.parametrize('package', ['c3d', 'ezc3d'])
def test_a_c3d_is_as_other_packages_have_it(path, package):
    module = pytest.importorskip(package, reason='one of the two peers is not on this machine')
    _, found = read_points(path)
    if package == 'ezc3d':
        expected = module.c3d(str(path))['data']['points'][:3].transpose(2, 1, 0)
    else:
        try:
            with warnings.catch_warnings(), path.open('rb') as file:
                warnings.simplefilter('ignore')
                rows = np.array([row[:, :4] for _, row, _ in module.Reader(file).read_frames()])
        except AssertionError:
            pytest.skip('the package c3d rejects this file')
        expected = np.where(rows[..., 3:] < 0, np.nan, rows[..., :3])
    np.testing.assert_array_equal(found.points, expected)


@pytest.mark.skipif(not EXPORTS.exists(), reason='the exports are not on this machine')
def test_an_export_without_markers_is_refused_and_all_others_become_bags(tmp_path):
    for path in sorted(path for path in EXPORTS.rglob('*.*') if path.suffix != '.md'):
        if path.name == 'base_msgs_0.mcap':
            with pytest.raises(BagError, match='has no topic of markers or poses'):
                import_points(path, tmp_path / 'out.mcap')
            continue
        try:
            import_points(path, tmp_path / 'out.mcap')
        except BagError as error:
            # Pixels have no length, and videos no rate in these files; both are asked for at once.
            assert re.search('is in px and has no times; fix: .* and give --rate', str(error))
            import_points(path, tmp_path / 'out.mcap', rate=50.0, scale=1.0)


def test_damaged_files_are_read_or_refused_in_one_line(tmp_path):
    outcomes = fuzz_captures(3, seed=5, folder=tmp_path)
    assert outcomes['read']
    assert outcomes['refused']
