"""
The page of a report as one HTML file, from a record and the files in page/.

Values are rounded to a tenth of their standard deviation, which keeps the page small.
"""

import base64
import html
import json
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from kinpole_ros.files import printable
from kinpole_ros.tools.record.record import (
    Columns,
    MotionRecord,
    Subject,
    joints_of,
    pairs_of,
)
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, ellipse_axes, sigma_along

Json: TypeAlias = dict[str, Any]
# Values are rounded to these fractions of their standard deviation or, without one, of the 90th
# percentile of the values; never finer than this fraction of the value itself.
_OF_SIGMA, _OF_LARGE, _OF_VALUE = 0.1, 1e-5, 1e-7
_LARGE = 0.9
_ELLIPSE_STEP = 0.02  # rad, for the direction of an ellipse
_FOLDER = Path(__file__).parent / 'page'
# In this order: each script uses those before it.
_SCRIPTS = (
    'data', 'drawing', 'motion', 'curvature', 'instant', 'film', 'stage', 'table', 'charts',
    'polygons', 'input', 'live', 'solver', 'editor', 'page',
)  # fmt: skip
# The page loads nothing; a live page reads its stream of events.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"


def page(data: dict[str, Any]) -> str:
    """
    Return the HTML of a page with the data of `pack`, and the titles that `report` adds.

    With `live` in the data, it is the page of a stream of events next to it.
    """
    is_live, has_editor = 'live' in data, 'edit' in data
    needed = {'film': 'film' in data, 'live': is_live, 'solver': has_editor, 'editor': has_editor}
    scripts = [f'{name}.js' for name in _SCRIPTS if needed.get(name, True)]
    values = {
        'POLICY': f"{_POLICY}; connect-src 'self'" if is_live else _POLICY,
        'TITLE': html.escape(printable(data['title'])),
        'STYLE': _read('style.css'),
        'SCRIPT': '\n'.join(map(_read, scripts)),
        'DATA': _embedded(data),
    }
    return re.sub('@([A-Z]+)@', lambda match: values[match[1]], _read('page.html'))


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding='utf-8')


def _embedded(data: Json) -> str:
    """Return data as it is in the page: JSON, deflated, in base64."""
    text = json.dumps(data, separators=(',', ':'), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode())).decode()


def pack(record: MotionRecord) -> Json:
    """Return a record as JSON: columns have T values, null where undetermined."""
    first = int(record.stamp[0])
    seconds = (record.stamp - first) * 1e-9
    return {
        'start': f'{first // 10**9}.{first % 10**9:09d}',
        'total': record.total,
        'along': list(record.along),
        't': np.round(seconds, 6).tolist(),
        'bodies': [_body(record, body) for body in record.bodies],
        'pairs': [
            {'bodies': list(pair), 'icr': _point(record.columns, pair, 'icr')}
            for pair in pairs_of(record)
        ],
        'joints': [
            {'bodies': list(joint.bodies), 'at': [_rounded_point(z) for z in joint.at]}
            for joint in joints_of(record)
        ],
    }


def _body(record: MotionRecord, body: str) -> Json:
    columns = record.columns
    size = record.sizes[body]
    position, sigma = columns[body, 'position'], columns[body, 'position_sigma']
    velocity = columns[body, 'velocity']
    packed: Json = {
        'name': body,
        'size': float(f'{size:.4g}') if np.isfinite(size) else None,
        'outlines': [
            [start, [_rounded_point(z) for z in points]] for start, points in record.outlines[body]
        ],
        'missing': intervals(columns[body, 'missing']),
        'x': rounded(position.real, sigma),
        'y': rounded(position.imag, sigma),
        'angle': rounded(columns[body, 'angle'], columns[body, 'angle_sigma']),
        'vx': rounded(velocity.real),
        'vy': rounded(velocity.imag),
    }
    for name in (*RATE_NAMES, 'centrode_curvature', 'inflection_diameter'):
        if (body, name) in columns:
            value, sigma = columns[body, name], columns[body, f'{name}_sigma']
            packed[name] = {'value': rounded(value, sigma), 'sigma': _rounded_sigma(sigma)}
    for name in (*POLE_NAMES, 'ball_point'):
        if (body, name) in columns:
            packed[name] = _point(columns, body, name)
    if (body, 'icr_velocity') in columns:
        packed['icr_velocity'] = _velocity(columns, body)
    packed['theory'] = {
        name: rounded(columns[body, f'{name}_theory'], columns[body, f'{name}_sigma'])
        for name in RATE_NAMES
        if (body, f'{name}_theory') in columns
    }
    packed['withheld'] = {
        name.removesuffix('_withheld'): intervals(values)
        for (subject, name), values in columns.items()
        if subject == body and name.endswith('_withheld')
    }
    first = int(record.stamp[0])
    packed['events'] = [
        [round((stamp - first) * 1e-9, 6), order] for stamp, order in record.events.get(body, [])
    ]
    return packed


def _point(columns: Columns, subject: Subject, name: str) -> Json:
    """Return coordinates, and half axes and direction of the ellipse of one sigma."""
    value, covariance = columns[subject, name], columns[subject, f'{name}_covariance']
    major, minor, direction = ellipse_axes(covariance)
    return {
        'x': rounded(value.real, np.sqrt(covariance[:, 0, 0])),
        'y': rounded(value.imag, np.sqrt(covariance[:, 1, 1])),
        'a': _rounded_sigma(major),
        'b': _rounded_sigma(minor),
        'd': _with_nulls(np.round(np.round(direction / _ELLIPSE_STEP) * _ELLIPSE_STEP, 2)),
    }


def _velocity(columns: Columns, body: str) -> Json:
    """Return components, and the standard deviation along the vector."""
    u = columns[body, 'icr_velocity']
    sigma = sigma_along(u, columns[body, 'icr_velocity_covariance'])
    return {
        'x': rounded(u.real, sigma),
        'y': rounded(u.imag, sigma),
        'sigma': _rounded_sigma(sigma),
    }


def rounded(values: np.ndarray, sigma: np.ndarray | None = None) -> list[float | None]:
    """Return values rounded to a tenth of sigma; without it, to five digits of the large ones."""
    size = np.abs(np.where(np.isfinite(values), values, 0.0))
    # A percentile, since rates go to infinity next to a limit.
    large = np.quantile(size, _LARGE) if len(size) else 0.0
    step = np.full(values.shape, _OF_LARGE * large)
    if sigma is not None:
        step = np.where(np.isfinite(sigma) & (sigma > 0), _OF_SIGMA * sigma, step)
    return _with_nulls(_round_to(values, np.maximum(step, _OF_VALUE * size)))


def _rounded_sigma(sigma: np.ndarray) -> list[float | None]:
    """Return standard deviations with two digits, or three if the first is a 1."""
    return _with_nulls(_round_to(sigma, 0.05 * np.abs(sigma)))


def _round_to(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return values rounded to the decimal at or below `step`."""
    with np.errstate(divide='ignore', invalid='ignore'):
        decimals = np.ceil(-np.log10(step))
    decimals = np.where(np.isfinite(decimals), decimals, 0).astype(int)
    result = np.full(values.shape, np.nan)
    for count in np.unique(decimals):
        mask = decimals == count
        result[mask] = np.round(values[mask], int(count))
    return result


def _with_nulls(values: np.ndarray) -> list[float | None]:
    cells = (np.asarray(values, float) + 0.0).astype(object)  # without -0.0
    cells[~np.isfinite(values)] = None
    return list(cells)


def _rounded_point(z: complex) -> list[float]:
    return [float(f'{z.real:.6g}'), float(f'{z.imag:.6g}')]


def intervals(reasons: np.ndarray) -> list[tuple[int, int, str]]:
    """Return [start, end) of each reason in instants, without those of ''."""
    changes: Sequence[int] = np.flatnonzero(reasons[1:] != reasons[:-1]).tolist()
    starts = [0, *(k + 1 for k in changes)]
    ends = [*starts[1:], len(reasons)]
    pairs = zip(starts, ends, strict=True)
    return [(start, end, str(reasons[start])) for start, end in pairs if reasons[start]]
