"""
A record as the JSON that the page reads.

Figures are rounded to a tenth of their deviation, so the page is small and no digit is made up.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from kinpole_ros.tools.report._record import Columns, Record, joints_of
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES

Json: TypeAlias = dict[str, Any]
# Of a deviation, of its larger figures, and of a figure itself: finer than this is not kept.
_OF_SIGMA, _OF_LARGER, _OF_ITSELF = 0.1, 1e-5, 1e-7
_LARGE = 0.9
_DIRECTION = 0.02  # rad, of an ellipse


def pack(record: Record) -> Json:
    """All of a record: what is there once, and columns of T figures, null where undetermined."""
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
            for pair in dict.fromkeys(s for s, _ in record.columns if isinstance(s, tuple))
        ],
        'joints': [
            {'bodies': list(joint.bodies), 'at': [_pair(z) for z in joint.at]}
            for joint in joints_of(record)
        ],
    }


def embedded(data: Mapping[str, Any]) -> str:
    """JSON as it stands in the page: deflated, in base64."""
    text = json.dumps(data, separators=(',', ':'), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def _body(record: Record, body: str) -> Json:
    columns = record.columns
    size = record.sizes[body]
    position, sigma = columns[body, 'position'], columns[body, 'position_sigma']
    velocity = columns[body, 'velocity']
    found: Json = {
        'name': body,
        'size': float(f'{size:.4g}') if np.isfinite(size) else None,
        'outlines': [
            [start, [_pair(z) for z in points]] for start, points in record.outlines[body]
        ],
        'missing': _spells(columns[body, 'missing']),
        'x': rounded(position.real, sigma),
        'y': rounded(position.imag, sigma),
        'angle': rounded(columns[body, 'angle'], columns[body, 'angle_sigma']),
        'vx': rounded(velocity.real),
        'vy': rounded(velocity.imag),
    }
    for name in (*RATE_NAMES, 'centrode_curvature'):
        if (body, name) in columns:
            value, sigma = columns[body, name], columns[body, f'{name}_sigma']
            found[name] = {'value': rounded(value, sigma), 'sigma': _short(sigma)}
    for name in POLE_NAMES:
        if (body, name) in columns:
            found[name] = _point(columns, body, name)
    if (body, 'icr_velocity') in columns:
        found['icr_velocity'] = _velocity(columns, body)
    found['theory'] = {
        name: rounded(columns[body, f'{name}_theory'], columns[body, f'{name}_sigma'])
        for name in RATE_NAMES
        if (body, f'{name}_theory') in columns
    }
    found['withheld'] = {
        name.removesuffix('_withheld'): _spells(values)
        for (subject, name), values in columns.items()
        if subject == body and name.endswith('_withheld')
    }
    return found


def _point(columns: Columns, subject: str | tuple[str, str], name: str) -> Json:
    """Coordinates, and the half axes of the ellipse of one deviation with its direction."""
    value, covariance = columns[subject, name], columns[subject, f'{name}_covariance']
    xx, yy, xy = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
    middle, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    half = [np.sqrt(np.maximum(part, 0)) for part in (middle + radius, middle - radius)]
    direction = np.arctan2(2 * xy, xx - yy) / 2
    return {
        'x': rounded(value.real, np.sqrt(xx)),
        'y': rounded(value.imag, np.sqrt(yy)),
        'a': _short(half[0]),
        'b': _short(half[1]),
        'd': _listed(np.round(np.round(direction / _DIRECTION) * _DIRECTION, 2)),
    }


def _velocity(columns: Columns, body: str) -> Json:
    """Components, and the deviation along the vector."""
    u, covariance = columns[body, 'icr_velocity'], columns[body, 'icr_velocity_covariance']
    with np.errstate(invalid='ignore', divide='ignore'):
        unit = np.stack((u.real, u.imag), axis=-1) / np.abs(u)[:, None]
    sigma = np.sqrt(np.maximum(np.einsum('ti,tij,tj->t', unit, covariance, unit), 0))
    return {'x': rounded(u.real, sigma), 'y': rounded(u.imag, sigma), 'sigma': _short(sigma)}


def rounded(values: np.ndarray, sigma: np.ndarray | None = None) -> list[float | None]:
    """Figures to a tenth of their deviation, to five digits of the larger ones without any."""
    known = np.isfinite(values)
    size = np.abs(np.where(known, values, 0.0))
    # Not the very largest: next to a limit rates have no bound.
    large = np.quantile(size, _LARGE) if len(size) else 0.0
    step = np.full(values.shape, _OF_LARGER * large)
    if sigma is not None:
        step = np.where(np.isfinite(sigma) & (sigma > 0), _OF_SIGMA * sigma, step)
    return _listed(_to(values, np.maximum(step, _OF_ITSELF * size)))


def _short(sigma: np.ndarray) -> list[float | None]:
    """To two digits, or three where the first is a 1."""
    return _listed(_to(sigma, 0.05 * np.abs(sigma)))


def _to(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """To the decimal at or below `step`."""
    with np.errstate(divide='ignore', invalid='ignore'):
        decimals = np.ceil(-np.log10(step))
    decimals = np.where(np.isfinite(decimals), decimals, 0).astype(int)
    found = np.full(values.shape, np.nan)
    for places in np.unique(decimals):
        there = decimals == places
        found[there] = np.round(values[there], int(places))
    return found


def _listed(values: np.ndarray) -> list[float | None]:
    # -0.0 is no figure anybody wants to read.
    cells = (np.asarray(values, float) + 0.0).astype(object)
    cells[~np.isfinite(values)] = None
    return list(cells)


def _pair(z: complex) -> list[float]:
    return [float(f'{z.real:.6g}'), float(f'{z.imag:.6g}')]


def _spells(reasons: np.ndarray) -> list[tuple[int, int, str]]:
    """From and to which instant (that one not included) each reason holds, '' left out."""
    changes: Sequence[int] = np.flatnonzero(reasons[1:] != reasons[:-1]).tolist()
    starts = [0, *(k + 1 for k in changes)]
    ends = [*starts[1:], len(reasons)]
    spells = zip(starts, ends, strict=True)
    return [(start, end, str(reasons[start])) for start, end in spells if reasons[start]]
