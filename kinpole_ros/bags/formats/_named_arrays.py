"""
HDF5 files that name the axes of their arrays or say what each series is.

`movement` (netCDF): position by time, space, keypoints and individuals, with confidence, times in
s or frames, and fps. NWB (Neurodata Without Borders): a series of positions for each point, with
its unit, a factor to that, and time stamps or a rate.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells, _hdf
from kinpole_ros.bags.formats._file import File, Format, Options, Points, frame_times

_MOVEMENT_FIX = "save it by movement's to_netcdf again"
_NWB_FIX = 'write it by pynwb again'
_NETCDF_3 = (b'CDF\x01', b'CDF\x02', b'CDF\x05')
# Types of series in NWB that hold places; the first is that of ndx-pose.
_SERIES = ('PoseEstimationSeries', 'SpatialSeries')
_MOST_OBJECTS = 10_000  # in a file, that are looked at
_PIXELS = ('px', 'pixel', 'pixels')


def _is_movement(file: File) -> bool:
    if file.head.startswith(_NETCDF_3):
        return True
    is_hdf = file.head.startswith(_hdf.HDF_MAGIC)
    return is_hdf and all(name in file.data for name in (b'position', b'space', b'individuals'))


def _is_nwb(file: File) -> bool:
    return file.head.startswith(_hdf.HDF_MAGIC) and b'nwb_version' in file.data


# movement


def _read_movement(file: File, options: Options) -> Points:
    if file.head.startswith(_NETCDF_3):
        raise BagError(
            f'{file.path} is netCDF 3, which is not read; fix: save it by '
            "to_netcdf(engine='h5netcdf')"
        )
    with _hdf.opened_hdf(file, 'movement', _MOVEMENT_FIX) as content:
        axes, values = _named_array(file, content, 'position')
        order = [axes.index(axis) for axis in ('time', 'individuals', 'keypoints', 'space')
                 if axis in axes]  # fmt: skip
        if len(order) < len(axes) or 'time' not in axes or 'space' not in axes:
            raise BagError(f'{file.path} has position by {", ".join(axes)}; fix: {_MOVEMENT_FIX}')
        letters = _hdf.hdf_texts(file, content, 'space', _MOVEMENT_FIX)
        if letters not in (['x', 'y'], ['x', 'y', 'z']):
            raise BagError(f'{file.path} has axes {letters} in space; fix: {_MOVEMENT_FIX}')
        named = [axis for axis in ('individuals', 'keypoints') if axis in axes]
        lists = [_hdf.hdf_texts(file, content, axis, _MOVEMENT_FIX) for axis in named]
        values = values.transpose(order)
        values = values.reshape(len(values), -1, len(letters))
        points = np.zeros((*values.shape[:2], 3))
        points[..., : len(letters)] = values
        if options.likelihood is not None:
            names, scores = _named_array(file, content, 'confidence')
            scores = scores.transpose([names.index(axes[k]) for k in order[:-1]])
            points[~(scores.reshape(points.shape[:2]) >= options.likelihood)] = np.nan
        times = _movement_times(file, content, options)
    several = [names for names in lists if len(names) > 1] or lists[-1:]
    labels = ['']
    for names in several:
        labels = [f'{label}.{name}'.lstrip('.') for label in labels for name in names]
    points[np.isnan(points).any(axis=-1)] = np.nan
    frames, in_space = np.arange(len(points)), len(letters) == 3
    labels = _cells.number_names(file.path, labels, file.notes)
    return Points(labels, points, frames, times, '' if in_space else 'px', y_down=not in_space)


def _named_array(file: File, content: Any, name: str) -> tuple[list[str], np.ndarray]:
    """Return the names of the axes of an array, and its numbers."""
    if name not in content:
        raise BagError(f'{file.path} has no {name}; fix: {_MOVEMENT_FIX}')
    item = _hdf.hdf_item(file, content, name, _MOVEMENT_FIX)
    _cells.check_cells(file.path, 3 * item.size)
    axes = [one[0].name.strip('/') if len(one) else '' for one in item.dims]
    return axes, np.asarray(item[:], np.float64)


def _movement_times(file: File, content: Any, options: Options) -> np.ndarray | None:
    """Return the times of frames, s; None where they are numbers of frames, without fps."""
    if options.rate is not None or 'time' not in content:
        return None
    times = np.asarray(_hdf.hdf_item(file, content, 'time', _MOVEMENT_FIX)[:], np.float64)
    rate = float(np.ravel(content.attrs.get('fps', 0.0))[0] or 0.0)
    unit = content.attrs.get('time_unit', 'seconds')
    if (unit.decode() if isinstance(unit, bytes) else str(unit)) == 'seconds':
        return frame_times(file, np.arange(len(times)), rate, times)
    return times / rate if rate > 0 else None


MOVEMENT = Format(
    'movement',
    'netCDF of movement',
    '(binary)',
    _is_movement,
    _read_movement,
    has_likelihood=True,
)


# NWB


def _read_nwb(file: File, options: Options) -> Points:
    with _hdf.opened_hdf(file, 'NWB', _NWB_FIX) as content:
        found = list(_series_in(content, '', [_MOST_OBJECTS]))
        if not found:
            raise BagError(f'{file.path} has no series of places of points; fix: {_NWB_FIX}')
        kinds = {kind for kind, *_ in found}
        kind = next(one for one in _SERIES if one in kinds)
        rows = [_read_series(file, group, options) for own, _, group in found if own == kind]
        names = [name for own, name, _ in found if own == kind]
    all_times = [times for times, *_ in rows if times is not None]
    lengths = {len(values) for _, values, _ in rows}
    if len(lengths) > 1 or any(not np.array_equal(all_times[0], one) for one in all_times[1:]):
        raise BagError(
            f'{file.path} has series of different times; fix: write those of one film alone'
        )
    units = {unit for *_, unit in rows}
    if len(units) > 1:
        raise BagError(
            f'{file.path} has places in {_cells.listed(sorted(map(_cells.shown, units)))}; '
            f'fix: {_NWB_FIX}'
        )
    points = np.stack([values for _, values, _ in rows], axis=1)
    unit, names = units.pop(), _cells.number_names(file.path, _shortened(names), file.notes)
    times = all_times[0] if len(all_times) == len(rows) else None
    is_down = unit.lower() in _PIXELS
    return Points(names, points, np.arange(len(points)), times, unit, y_down=is_down)


def _series_in(group: Any, path: str, left: list[int]) -> Iterator[tuple[str, str, Any]]:
    """Yield type, path and group of series of places, in groups of the file itself."""
    import h5py

    for name in group:
        left[0] -= 1
        if left[0] < 0 or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if not isinstance(item, h5py.Group):
            continue
        kind = item.attrs.get('neurodata_type', '')
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        own = f'{path}/{name}'
        if kind in _SERIES and 'data' in item:
            yield kind, own, item
        elif own.count('/') < 12:
            yield from _series_in(item, own, left)


def _read_series(
    file: File, group: Any, options: Options
) -> tuple[np.ndarray | None, np.ndarray, str]:
    """Read times (T,), s, places (T, 3), and the unit of a series."""
    data = _hdf.hdf_item(file, group, 'data', _NWB_FIX)
    _cells.check_cells(file.path, 2 * data.size)
    if data.ndim != 2 or data.shape[1] not in (2, 3):
        raise BagError(f'{file.path} has places of shape {data.shape}; fix: {_NWB_FIX}')
    values = np.zeros((len(data), 3))
    factor, offset = (float(data.attrs.get(key, usual)) for key, usual in
                      (('conversion', 1.0), ('offset', 0.0)))  # fmt: skip
    values[:, : data.shape[1]] = np.asarray(data[:], np.float64) * factor + offset
    values[np.isnan(values).any(axis=-1)] = np.nan
    if options.likelihood is not None:
        if 'confidence' not in group:
            raise _hdf.no_scores(file)
        score = np.asarray(_hdf.hdf_item(file, group, 'confidence', _NWB_FIX)[:], np.float64)
        values[~(score >= options.likelihood)] = np.nan
    unit = data.attrs.get('unit', '')
    unit = unit.decode() if isinstance(unit, bytes) else str(unit)
    return _series_times(file, group, len(data)), values, unit


def _series_times(file: File, group: Any, count: int) -> np.ndarray | None:
    if 'timestamps' in group:
        item = _hdf.hdf_item(file, _linked_group(file, group), 'timestamps', _NWB_FIX)
        return np.asarray(item[:], np.float64)
    if 'starting_time' not in group:
        return None
    start = _hdf.hdf_item(file, group, 'starting_time', _NWB_FIX)
    rate = float(start.attrs.get('rate', 0.0))
    return float(start[()]) + np.arange(count) / rate if rate > 0 else None


def _linked_group(file: File, group: Any) -> Any:
    """Return the group whose times a series has, which may be another one's in the file."""
    import h5py

    link = group.get('timestamps', getlink=True)
    if not isinstance(link, h5py.SoftLink) or not link.path.startswith('/'):
        return group
    *parts, last = link.path.strip('/').split('/')
    target = group.file
    for part in parts:
        target = _hdf.hdf_item(file, target, part, _NWB_FIX)
    return target if last == 'timestamps' else group


def _shortened(paths: list[str]) -> list[str]:
    """Name series by the ends of their paths: nose of /processing/.../nose, with what differs."""
    parts = [path.split('/') for path in paths]
    last = [words[-1] for words in parts]
    if len(set(last)) == len(last):
        return [name.removeprefix('PoseEstimationSeries') or name for name in last]
    return ['.'.join(words[-2:]) for words in parts]


NWB = Format(
    'nwb',
    'NWB file of estimated poses or places',
    '(binary)',
    _is_nwb,
    _read_nwb,
    has_likelihood=True,
)
