"""One exact motion, written as each program would write it, with the oddities of a `Variant`."""

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from test_formats import c3d_file
from test_layouts_of_trackers import kinovea_sheet, tracker_project_of

from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags.formats._file import UNITS
from kinpole_ros.messages import INPUT_TYPES, marker_arrays

NAMES = ('A', 'B', 'C')
RATE = 100.0
LOST, DOUBTFUL = (1, slice(20, 24)), (2, 11)  # marker and frames
PIXEL = 1e-3  # m


@dataclass(frozen=True)
class Variant:
    """How a file differs from the plainest one."""

    unit: str = 'mm'  # where a format can say one
    comma: bool = False  # for the decimal point
    thousands: bool = False  # a mark between them, in one cell
    end: str = '\n'
    is_ended: bool = True
    bom: bool = False
    gap: bool = False  # frames 10 to 14 are missing
    lost: float | None = None  # in place of a marker that was not seen; NaN is an empty cell
    doubtful: bool = False  # one point is wrong, and says so
    rate: float = RATE  # that the file claims, where it has times, too
    seconds: float = 1.0  # of the unit of its times, which the file calls seconds
    count: int | None = None  # of frames, that the file claims
    options: dict[str, Any] = field(default_factory=dict)


class Motion(NamedTuple):
    """What a file has: frames (T,), times (T,), points (T, n, 3), likelihoods (T, n)."""

    variant: Variant
    frames: np.ndarray
    times: np.ndarray
    points: np.ndarray
    likelihoods: np.ndarray
    unit: str

    def cell(self, value: float, digits: int = 6) -> str:
        text = '' if np.isnan(value) else f'{value:.{digits}f}'
        return text.replace('.', ',') if self.variant.comma else text

    def cells(self, values: Sequence[float] | np.ndarray) -> list[str]:
        return [self.cell(value) for value in np.ravel(values)]


def truth(is_flat: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return times (T,), s, and points (T, 3, 3), m, of a body at 5 rad/s about (0.7, 0.5)."""
    times = np.arange(40) / RATE
    phases = np.exp(1j * (5.0 * times[:, None] + np.arange(3)))
    places = 0.7 + 0.5j + np.array([0.1, 0.15, 0.2]) * phases
    heights = np.zeros(3) if is_flat else np.array([0.3, 0.31, 0.32])
    return times, np.stack((places.real, places.imag, np.tile(heights, (40, 1))), axis=-1)


class Kind(NamedTuple):
    """A kind of file: how it is written, and what it can hold."""

    write: Callable[[Motion], Any]  # rows of cells, or bytes
    mark: str = ''  # between cells; '' for bytes
    unit: str = ''  # the only one; '' where the file says its own
    is_flat: bool = False
    y_down: bool = False
    has_times: bool = True
    says_unit: bool = True
    has_likelihood: bool = False
    has_rate: bool = False  # and times
    needs_h5py: bool = False
    names: tuple[str, ...] = NAMES

    def needed(self) -> dict[str, Any]:
        """Return the options that such a file needs."""
        needed: dict[str, Any] = {} if self.has_times else {'rate': RATE}
        return needed if self.says_unit else {**needed, 'scale': self.length(Variant())}

    def length(self, variant: Variant) -> float:
        """Return m per unit of the file."""
        unit = self.unit or variant.unit
        return PIXEL if unit == 'px' else UNITS.get(unit, 1.0)

    def motion(self, variant: Variant) -> Motion:
        """Return what the file has."""
        times, points = truth(self.is_flat)
        frames, likelihoods = np.arange(len(times)), np.full(points.shape[:2], 0.99)
        points = points / self.length(variant) * [1, -1 if self.y_down else 1, 1]
        if variant.doubtful:
            points[DOUBTFUL[1], DOUBTFUL[0], :2] += 0.4 / self.length(variant)
            likelihoods[DOUBTFUL[1], DOUBTFUL[0]] = 0.1
        if variant.lost is not None:
            points[LOST[1], LOST[0], : 2 if self.is_flat else 3] = variant.lost
        kept = np.r_[0:10, 15:40] if variant.gap else np.arange(40)
        return Motion(variant, frames[kept], times[kept] / variant.seconds, points[kept],
                      likelihoods[kept], self.unit or variant.unit)  # fmt: skip

    def content(self, variant: Variant) -> bytes:
        """Return the file."""
        written = self.write(self.motion(variant))
        if isinstance(written, bytes):
            return written
        mark = ';' if variant.comma and self.mark == ',' else self.mark
        if variant.thousands:
            written[-5] = [f'1.00{cell}' if ',' in cell else cell for cell in written[-5]]
        text = variant.end.join(mark.join(row) for row in written)
        text += variant.end if variant.is_ended else ''
        return (b'\xef\xbb\xbf' if variant.bom else b'') + text.encode()


def table(motion: Motion) -> list[list[str]]:
    titles = [f'{n} {axis} ({motion.unit})' for n in NAMES for axis in 'xyz']
    likelihoods = [f'{n}_likelihood' for n in NAMES]
    rows = zip(motion.frames, motion.times, motion.points, motion.likelihoods, strict=True)
    return [['frame', 't', *titles, *likelihoods]] + [
        [str(k), motion.cell(t), *motion.cells(p), *motion.cells(s)] for k, t, p, s in rows
    ]


def plain(motion: Motion) -> list[list[str]]:
    titles = [f'{n}_{axis}' for n in NAMES for axis in 'xy']
    rows = zip(motion.times, motion.points[..., :2], strict=True)
    return [['time', *titles]] + [[motion.cell(t), *motion.cells(p)] for t, p in rows]


def deeplabcut(motion: Motion) -> list[list[str]]:
    columns = [(n, c) for n in NAMES for c in ('x', 'y', 'likelihood')]
    head = [['scorer', *('DLC' for _ in columns)], ['bodyparts', *(n for n, _ in columns)],
            ['coords', *(c for _, c in columns)]]  # fmt: skip
    values = np.concatenate((motion.points[..., :2], motion.likelihoods[..., None]), axis=-1)
    return head + [
        [str(k), *motion.cells(row)] for k, row in zip(motion.frames, values, strict=True)
    ]


def sleap(motion: Motion) -> list[list[str]]:
    titles = [f'{n}.{what}' for n in NAMES for what in ('x', 'y', 'score')]
    values = np.concatenate((motion.points[..., :2], motion.likelihoods[..., None]), axis=-1)
    return [['track', 'frame_idx', 'instance.score', *titles]] + [
        ['rod', str(k), motion.cell(0.9), *motion.cells(row)]
        for k, row in zip(motion.frames, values, strict=True)
    ]


def sleap_h5(motion: Motion) -> bytes:
    h5py = pytest.importorskip('h5py')
    places = np.full((1, 2, 3, 40), np.nan)  # track, axis, node, frame
    places[0][..., motion.frames] = motion.points[..., :2].transpose(2, 1, 0)
    scores = np.zeros((1, 3, 40))
    scores[0][:, motion.frames] = motion.likelihoods.T
    with BytesIO() as file:
        with h5py.File(file, 'w') as content:
            content['tracks'], content['point_scores'] = places, scores
            content['node_names'] = np.array([n.encode() for n in NAMES])
            content['track_names'] = np.array([b'rod'])
        return file.getvalue()


def movement(motion: Motion) -> bytes:
    """A dataset as xarray writes it, by the dimensions of each array."""
    h5py = pytest.importorskip('h5py')
    content = BytesIO()
    with h5py.File(content, 'w') as file:
        file['position'] = motion.points[..., :2].transpose(0, 2, 1)[..., None]
        file['confidence'] = motion.likelihoods[..., None]
        scales = {'time': motion.times, 'space': [b'x', b'y'],
                  'keypoints': [n.encode() for n in NAMES], 'individuals': [b'rod']}  # fmt: skip
        for name, values in scales.items():
            text = {} if name == 'time' else {'dtype': h5py.string_dtype()}
            file.create_dataset(name, data=values, **text)
            file[name].make_scale(name)
        for array in ('position', 'confidence'):
            axes = [name for name in scales if array == 'position' or name != 'space']
            for k, name in enumerate(axes):
                file[array].dims[k].attach_scale(file[name])
        file.attrs.update(time_unit='seconds', ds_type='poses', fps=RATE)
    return content.getvalue()


def nwb(motion: Motion) -> bytes:
    """Series of ndx-pose; the times of all are links to those of the first."""
    h5py = pytest.importorskip('h5py')
    content = BytesIO()
    with h5py.File(content, 'w') as file:
        file.attrs['nwb_version'] = '2.6.0'
        for k, name in enumerate(NAMES):
            series = file.create_group(f'processing/behavior/PoseEstimation/{name}')
            series.attrs['neurodata_type'] = 'PoseEstimationSeries'
            series['data'] = 2.0 * motion.points[:, k]
            series['data'].attrs.update(unit=motion.unit, conversion=0.5)
            series['confidence'] = motion.likelihoods[:, k]
            first = f'/processing/behavior/PoseEstimation/{NAMES[0]}/timestamps'
            series['timestamps'] = motion.times if k == 0 else h5py.SoftLink(first)
    return content.getvalue()


def anipose(motion: Motion) -> list[list[str]]:
    titles = [f'{n}_{what}' for n in NAMES for what in ('x', 'y', 'z', 'error', 'ncams', 'score')]
    rows = zip(motion.frames, motion.points, motion.likelihoods, strict=True)
    return [[*titles, 'fnum']] + [
        [*(c for p, s in zip(points, scores, strict=True)
           for c in (*motion.cells(p), motion.cell(0.5), '3', motion.cell(s))), str(k)]
        for k, points, scores in rows
    ]  # fmt: skip


def coco(motion: Motion) -> bytes:
    def triple(place: np.ndarray, score: float) -> list[float]:
        return [0.0, 0.0, 0.0] if np.isnan(place[0]) else [*place[:2].tolist(), float(score)]

    rows = zip(motion.frames.tolist(), motion.points, motion.likelihoods, strict=True)
    annotations = [
        {'image_id': k, 'category_id': 1,
         'keypoints': [v for p, s in zip(points, scores, strict=True) for v in triple(p, s)]}
        for k, points, scores in rows
    ]  # fmt: skip
    images = [{'id': k, 'file_name': f'img_{k:05d}.png'} for k in motion.frames.tolist()]
    categories = [{'id': 1, 'name': 'rod', 'keypoints': NAMES}]
    whole = {'images': images, 'annotations': annotations, 'categories': categories}
    return json.dumps(whole).encode()


def kinovea(motion: Motion) -> list[list[str]]:
    titles = [f'{n}/0/{axis}' for n in NAMES for axis in 'XY']
    rows = zip(motion.times, motion.points[..., :2], strict=True)
    return [['Time', *titles]] + [[motion.cell(t, 3), *motion.cells(p)] for t, p in rows]


def kinovea_text(motion: Motion) -> list[list[str]]:
    lines = [['#Kinovea', 'Trajectory', 'data', 'export'], ['#T', 'X', 'Y']]
    for k, name in enumerate(NAMES):
        lines += [[''], ['#', name]]
        rows = zip(motion.times, motion.points[:, k, :2], strict=True)
        lines += [[motion.cell(t, 3), *motion.cells(p)] for t, p in rows if not np.isnan(p).any()]
    return lines


def kinovea_xml(motion: Motion) -> bytes:
    tracks = {}
    for k, name in enumerate(NAMES):
        rows = zip(motion.times, motion.points[:, k, :2], strict=True)
        tracks[name] = [
            [*motion.cells(p), f'0:00:00:{round(t * 100):02d}']
            for t, p in rows
            if not np.isnan(p).any()
        ]
    return kinovea_sheet(tracks, motion.unit).encode()


def tracker(motion: Motion) -> list[list[str]]:
    head = [['#multi:'], ['', *(c for n in NAMES for c in (n, ''))],
            ['t', *(f'{axis} ({motion.unit})' for _ in NAMES for axis in 'xy')]]  # fmt: skip
    rows = zip(motion.times, motion.points[..., :2], strict=True)
    return head + [[motion.cell(t), *motion.cells(p)] for t, p in rows]


def motive(motion: Motion) -> list[list[str]]:
    count = motion.variant.count or len(motion.frames)
    about = ['Format Version', '1.23', 'Export Frame Rate', motion.cell(motion.variant.rate),
             'Total Exported Frames', str(count), 'Length Units', motion.unit]  # fmt: skip
    columns = [(n, axis) for n in NAMES for axis in 'XYZ']
    head = [about, ['', 'Type', *('Marker' for _ in columns)],
            ['', 'Name', *(n for n, _ in columns)],
            ['', '', *('Position' for _ in columns)],
            ['Frame', 'Time (Seconds)', *(axis for _, axis in columns)]]  # fmt: skip
    rows = zip(motion.frames, motion.times, motion.points, strict=True)
    return head + [[str(k), motion.cell(t), *motion.cells(p)] for k, t, p in rows]


def vicon(motion: Motion) -> list[list[str]]:
    head = [['Trajectories'], [motion.cell(motion.variant.rate)],
            ['', '', *(c for n in NAMES for c in (n, '', ''))],
            ['Frame', 'Sub Frame', *('XYZ' * len(NAMES))],
            ['', '', *[motion.unit] * 3 * len(NAMES)]]  # fmt: skip
    rows = zip(motion.frames, motion.points, strict=True)
    return head + [[str(k), '0', *motion.cells(p)] for k, p in rows]


def qualisys(motion: Motion) -> list[list[str]]:
    count = motion.variant.count or len(motion.frames)
    head = [['FILE_VERSION', '2.0.0'], ['NO_OF_FRAMES', str(count)],
            ['NO_OF_MARKERS', '3'], ['FREQUENCY', motion.cell(motion.variant.rate)],
            ['DATA_INCLUDED', '3D'], ['MARKER_NAMES', *NAMES],
            ['Frame', 'Time', *(f'{n} {axis}' for n in NAMES for axis in 'XYZ')]]  # fmt: skip
    rows = zip(motion.frames, motion.times, motion.points, strict=True)
    return head + [[str(k), motion.cell(t), *motion.cells(p)] for k, t, p in rows]


def trc(motion: Motion) -> list[list[str]]:
    count = motion.variant.count or len(motion.frames)
    head = [['PathFileType', '4', '(X/Y/Z)', 'run.trc'],
            ['DataRate', 'CameraRate', 'NumFrames', 'NumMarkers', 'Units'],
            [motion.cell(motion.variant.rate), motion.cell(motion.variant.rate), str(count), '3',
             motion.unit],
            ['Frame#', 'Time', *(c for n in NAMES for c in (n, '', ''))],
            ['', '', *(f'{axis}{k}' for k in (1, 2, 3) for axis in 'XYZ')]]  # fmt: skip
    rows = zip(motion.frames, motion.times, motion.points, strict=True)
    return head + [[str(k), motion.cell(t), *motion.cells(p)] for k, t, p in rows]


def c3d(motion: Motion) -> bytes:
    points = np.full((40, 3, 3), np.nan)
    points[motion.frames] = motion.points
    content = c3d_file(motion.unit, points, motion.variant.rate, NAMES)
    if motion.variant.count:
        place = 512 + content[512:].index(b'FRAMES') + 10
        content = content[:place] + struct.pack('<h', motion.variant.count) + content[place + 2 :]
    return content


def tracker_project(motion: Motion) -> bytes:
    tracks = {
        name: {int(k): p[:2] for k, p in zip(motion.frames, motion.points[:, index], strict=True)
               if not np.isnan(p).any()}
        for index, name in enumerate(NAMES)
    }  # fmt: skip
    return tracker_project_of(tracks, 50.0, 20.0, motion.unit, 0, 0.0, 1000 / RATE).encode()


def bag(folder: Path, motion: Motion) -> bytes:
    stamps = np.rint(motion.times * 1e9).astype(np.int64)
    data = marker_arrays(stamps, 'world', NAMES, motion.points)
    with BagWriter(folder / 'bag.mcap') as writer:
        writer.write_many([('/markers', INPUT_TYPES['marker_array'], stamps.tolist(), data)])
    return (folder / 'bag.mcap').read_bytes()


def kinds(folder: Path) -> dict[str, Kind]:
    """Return all kinds of files; files that others are made of are written in the folder."""
    pixels = {'unit': 'px', 'is_flat': True, 'y_down': True, 'says_unit': False,
              'has_times': False, 'has_likelihood': True}  # fmt: skip
    return {
        'table': Kind(table, ',', has_likelihood=True),
        'table, plain': Kind(plain, ',', 'm', is_flat=True),
        'deeplabcut': Kind(deeplabcut, ',', **pixels),
        'sleap': Kind(sleap, ',', **pixels),
        'sleap .h5': Kind(sleap_h5, '', **pixels, needs_h5py=True),
        'movement': Kind(
            movement,
            '',
            'px',
            is_flat=True,
            y_down=True,
            says_unit=False,
            has_likelihood=True,
            needs_h5py=True,
        ),
        'nwb': Kind(nwb, '', has_likelihood=True, needs_h5py=True),
        'anipose': Kind(anipose, ',', 'mm', says_unit=False, has_times=False, has_likelihood=True),
        'keypoints': Kind(coco, '', **pixels),
        'kinovea': Kind(kinovea, ',', 'cm', is_flat=True, says_unit=False),
        'kinovea text': Kind(kinovea_text, ' ', 'cm', is_flat=True, says_unit=False),
        'kinovea .xml': Kind(kinovea_xml, '', is_flat=True),
        'tracker': Kind(tracker, '\t', is_flat=True),
        'tracker .trk': Kind(tracker_project, '', is_flat=True),
        'motive': Kind(motive, ',', has_rate=True),
        'vicon': Kind(vicon, ','),
        'qualisys': Kind(qualisys, '\t', 'mm', has_rate=True),
        'trc': Kind(trc, '\t', has_rate=True),
        'c3d': Kind(c3d, ''),
        'bag': Kind(partial(bag, folder), '', 'm'),
    }
