"""
The Python API, without ROS: markers in an array, or a bag, to the motion of bodies in real arrays.

The pipeline is that of node and replay, so the results are the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.files import did_you_mean
from kinpole_ros.packages import install_command
from kinpole_ros.planar import to_plane
from kinpole_ros.settings import Settings, load_settings, settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.reasons import KNOWN
from kinpole_ros.tracking.tracker import Tracker, learn_recording
from kinpole_ros.tracking.values import (
    Numbers,
    Vectors,
    known_arrays,
    measured_pairs,
    quantity_names,
)

if TYPE_CHECKING:
    import pandas

_BLOCK_FRAMES = 1000  # that the tracker takes at once, as in a replay
_NS_PER_S = 1_000_000_000
_Key = TypeVar('_Key')
_Record = TypeVar('_Record')


class UnknownNameError(KeyError):
    """A body or pair of bodies that a result does not have; the message lists those it has."""

    def __str__(self) -> str:
        # A KeyError shows its message in quotes.
        return str(self.args[0])


class _Records(dict[_Key, _Record]):
    """Records by name; a missing name raises an `UnknownNameError` that lists the names."""

    def __missing__(self, key: object) -> NoReturn:
        names = {_shown(name): name for name in self}
        if isinstance(key, tuple) and key[::-1] in self:
            suggestion = f'did you mean {_shown(key[::-1])}? '
        else:
            suggestion = did_you_mean(_shown(key), names)
        raise UnknownNameError(
            f'{_shown(key)} is not tracked; {suggestion}known: {", ".join(names) or "none"}'
        )


def _shown(key: object) -> str:
    return ' wrt '.join(map(str, key)) if isinstance(key, tuple) else str(key)


class _Motion:
    """A dataclass of arrays (M, ...) that lists its fields, and so where an unknown one is read."""

    def __repr__(self) -> str:
        names = [one.name for one in fields(self)]  # type: ignore[arg-type]
        count = len(getattr(self, names[0]))
        return f'{type(self).__name__} at {count} instants: {", ".join(names)}'

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            names = list(type(self).__dataclass_fields__)
            raise AttributeError(
                f'{type(self).__name__} has no {name}; {did_you_mean(name, names)}known: '
                f'{", ".join(names)}',
                name=name,
                obj=self,
            )


@dataclass(frozen=True)
class Events:
    """
    E instants at which the velocity, acceleration or jerk of a body steps, in the order found.

    `t` (E,) s and `t_sigma` are when; `order` (E,) is that of the lowest derivative that steps, 1
    for the velocity, as at an impact. By how much, in rad/s^order and m/s^order: `angle_step` (E,)
    with `angle_step_sigma`, and `step` (E, 2) of the origin of the body's frame with
    `step_covariance` (E, 2, 2).
    """

    t: np.ndarray
    t_sigma: np.ndarray
    order: np.ndarray
    angle_step: np.ndarray
    angle_step_sigma: np.ndarray
    step: np.ndarray
    step_covariance: np.ndarray

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, repr=False)
class BodyMotion(_Motion):
    """
    The motion of one body at M instants; NaN where undetermined, or beyond `derivative_order`.

    SI units and rad. Numbers are (M,) and come with NAME_sigma, one standard deviation; vectors are
    (M, 2), along the axes of the plane, and come with NAME_covariance (M, 2, 2). `position` and
    `angle` are those of the body's frame. `missing` (M,) says why there is no estimate, '' else.
    """

    position: np.ndarray
    angle: np.ndarray
    missing: np.ndarray
    angular_velocity: np.ndarray
    angular_velocity_sigma: np.ndarray
    angular_acceleration: np.ndarray
    angular_acceleration_sigma: np.ndarray
    angular_jerk: np.ndarray
    angular_jerk_sigma: np.ndarray
    angular_snap: np.ndarray
    angular_snap_sigma: np.ndarray
    icr: np.ndarray
    icr_covariance: np.ndarray
    iap: np.ndarray
    iap_covariance: np.ndarray
    ijp: np.ndarray
    ijp_covariance: np.ndarray
    isp: np.ndarray
    isp_covariance: np.ndarray
    icr_velocity: np.ndarray
    icr_velocity_covariance: np.ndarray
    centrode_curvature: np.ndarray
    centrode_curvature_sigma: np.ndarray
    inflection_circle: np.ndarray
    inflection_circle_covariance: np.ndarray
    inflection_diameter: np.ndarray
    inflection_diameter_sigma: np.ndarray


@dataclass(frozen=True, repr=False)
class PairMotion(_Motion):
    """The motion of body j with respect to body i at M instants, in arrays as those of a body."""

    angular_velocity: np.ndarray
    angular_velocity_sigma: np.ndarray
    icr: np.ndarray
    icr_covariance: np.ndarray


@dataclass(frozen=True, repr=False)
class Tracked:
    """
    The motion of bodies at M instants: `tracked['crank'].angular_velocity` (M,), and so on.

    `stamp` (M,) int64, ns, and the same as `t` (M,), s. `pairs` are relative motions by names
    (j, i), i before j in `bodies`. `events` are those of each body, as far as the window after them
    is known. A name that is missing raises an
    `UnknownNameError`, a KeyError that lists the names.
    """

    t: np.ndarray
    stamp: np.ndarray
    bodies: Mapping[str, BodyMotion]
    pairs: Mapping[tuple[str, str], PairMotion]
    events: Mapping[str, Events] = field(default_factory=dict)

    def __getitem__(self, body: str) -> BodyMotion:
        return self.bodies[body]

    def __repr__(self) -> str:
        title, rows = self._summary()
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return '\n'.join([title, *lines])

    def _repr_html_(self) -> str:
        """Return the summary as a table, as notebooks show it."""
        title, (head, *rows) = self._summary()
        cells = ''.join(f'<th>{cell}</th>' for cell in head)
        for row in rows:
            cells += '</tr><tr>' + ''.join(f'<td>{cell}</td>' for cell in row)
        return f'<p>{title}</p><table><tr>{cells}</tr></table>'

    def _summary(self) -> tuple[str, list[list[str]]]:
        """Return a line on the instants, and a table of the bodies below its head."""
        span = f', t = {self.t[0]:.6g} to {self.t[-1]:.6g} s' if len(self.t) else ''
        rows = [['body', 'angular velocity, rad/s', 'deviation', 'known at', 'ICR at']]
        for name, body in self.bodies.items():
            is_known = np.isfinite(body.angular_velocity)
            row = [name, '-', '-', '-', '-']
            if is_known.any():
                known = body.angular_velocity[is_known]
                sigma = np.median(body.angular_velocity_sigma[is_known])
                row[1:3] = f'{known.min():.4g} to {known.max():.4g}', f'{sigma:.2g}'
            if len(self.t):
                icr = np.isfinite(body.icr[:, 0])
                row[3:] = f'{is_known.mean():.1%}', f'{icr.mean():.1%}'
            rows.append(row)
        return f'Tracked at {len(self.t)} instants{span}', rows

    def to_frame(self) -> pandas.DataFrame:
        """
        Return a pandas frame with a row an instant, indexed by `t`.

        Columns are named as in the tables of `kinpole replay`: BODY_x, BODY_angle,
        BODY_angular_velocity and BODY_angular_velocity_sigma, BODY_icr_x and BODY_icr_x_sigma,
        J_wrt_I_icr_x and so on, and stamp, ns.

        Returns
        -------
        pandas.DataFrame
            (M, columns), float64 but for stamp; NaN where undetermined.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise ImportError(f'to_frame needs pandas; fix: {install_command("pandas")}') from None
        columns = {'stamp': self.stamp}
        for body, motion in self.bodies.items():
            columns |= _table_columns(body, motion)
        for (j, i), relative in self.pairs.items():
            columns |= _table_columns(f'{j}_wrt_{i}', relative)
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name='t'))


def _table_columns(prefix: str, record: BodyMotion | PairMotion) -> dict[str, np.ndarray]:
    """Return the numbers of a record as columns (M,), named as in tables."""
    columns: dict[str, np.ndarray] = {}
    for name in (one.name for one in fields(record)):
        values = getattr(record, name)
        if name == 'missing':
            continue
        if values.ndim == 1:
            columns[f'{prefix}_{name}'] = values
            continue
        # A position has no name of its own: BODY_x.
        own = f'{prefix}_{name.removesuffix("_covariance")}'.removesuffix('_position')
        for k, axis in enumerate('xy'):
            if values.ndim == 2:
                columns[f'{own}_{axis}'] = values[:, k]
            else:
                with np.errstate(invalid='ignore'):
                    columns[f'{own}_{axis}_sigma'] = np.sqrt(values[:, k, k])
    return columns


def track(
    points: ArrayLike,
    stamps: ArrayLike,
    bodies: Mapping[str, Sequence[int]] | None = None,
    whole: bool = True,
    **parameters: Any,
) -> Tracked:
    """
    Follow bodies by their markers.

    What is learned up to the last frame is known at the first one, and each frame has a result.
    With ``whole=False`` it is as in the node: what is known of an instant is learned from the
    frames before it. It warns of all that makes results fewer.

    Parameters
    ----------
    points
        Positions of the markers (T, n, 2) or (T, n, 3), m, NaN where one is not seen. With two
        coordinates they are in the plane xy.
    stamps
        Times of the frames (T,): integers are ns, floats are s. Frames that repeat a stamp, or go
        back a little, are left out, with a warning.
    bodies
        Which columns of the points are on which body; without it, all are on one, `body`.
    whole
        Whether all frames are read once to learn from them, then again to estimate the motion.
    **parameters
        Those of the node by their names, such as window=0.3, lag=0.1, noise=2e-4,
        derivative_order=3, plane='fit'. With the lag left at its default, instants of a whole are
        in the middle of the window, but for those near the ends.

    Returns
    -------
    Tracked
        The motion at M instants, one a frame. With ``whole=False`` the last `lag` is left out.

    Raises
    ------
    ValueError
        For shapes that do not fit, for stamps that are not finite, and as ParameterError for a
        parameter.

    """
    positions = np.asarray(points, float)
    if positions.ndim != 3 or positions.shape[2] not in (2, 3):
        raise ValueError(f'points must have shape (T, n, 2) or (T, n, 3), not {positions.shape}')
    times = _stamps_ns(stamps, positions.shape[:1])
    if positions.shape[2] == 2:
        if parameters.get('plane', 'xy') != 'xy':
            raise ValueError('points of two coordinates are in the plane xy; give three for others')
        positions = np.pad(positions, ((0, 0), (0, 0), (0, 1)))
    count = positions.shape[1]
    settings = settings_from({**parameters, **_markers(bodies, count)})
    frames = MarkerFrames(times, '', tuple(map(str, range(count))), positions)
    estimates, tracker = _estimates(frames, settings, whole)
    _warn(_losses(tracker, estimates))
    return _tracked(estimates, settings)


def _estimates(
    frames: MarkerFrames, settings: Settings, whole: bool
) -> tuple[list[Estimate], Tracker]:
    """Return the estimates of consecutive instants, and the tracker that learned from frames."""
    order, count = settings.highest_order, len(frames.stamps)
    starts = range(0, count, _BLOCK_FRAMES)
    parts = [part_of(frames, slice(first, first + _BLOCK_FRAMES)) for first in starts]
    if not whole:
        tracker = Tracker(settings)
        return [one for part in parts for one in tracker.add(part, order, True)], tracker
    settings = settings.of_recording()
    learned, recording = learn_recording(settings, parts)
    tracker = Tracker(settings, recording)
    estimates = [one for part in parts for one in tracker.add(part, order, True)]
    return estimates + tracker.finish(order), learned


def replay(
    bag: str | Path,
    config: str | Path | None = None,
    topic: str | None = None,
    whole: bool = False,
    **parameters: Any,
) -> Tracked:
    """
    Follow bodies by the markers in a bag, as the node does, or as a whole.

    It warns of what `kinpole replay` prints on stderr.

    Parameters
    ----------
    bag
        An .mcap or .db3 file or a rosbag2 folder.
    config
        A ROS 2 parameter file, as for the node; without it, all markers are on one body, `body`.
    topic
        The topic of the markers, instead of the parameter `marker_topic`.
    whole
        Whether what is learned up to the last frame is known at the first one, as for `track`.
    **parameters
        Parameters in place of those of `config`, by name; ``**{'crank.markers': ['0', '1']}`` for
        names with a dot.

    Returns
    -------
    Tracked
        The motion at M instants.

    Raises
    ------
    BagError
        For a bag that cannot be used.
    ParameterError
        For a parameter.

    """
    from kinpole_ros import bags

    if config is None:
        settings = settings_from(parameters)
    else:
        settings = load_settings(config, changes=parameters)
    estimates: list[Estimate] = []
    outcome = bags.replay(bag, settings, topic=topic, take=estimates.append, whole=whole)
    _warn(outcome.warnings)
    if outcome.truncated is not None:
        _warn([str(outcome.truncated)])
    return _tracked(estimates, settings)


def _stamps_ns(stamps: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return stamps (T,) as int64, ns, from integers, ns, or floats, s."""
    times = np.asarray(stamps)
    if times.shape != shape or times.dtype.kind not in 'iuf':
        raise ValueError(
            f'stamps must be integers, ns, or floats, s, of shape {shape}, not {times.dtype} of '
            f'shape {times.shape}'
        )
    if times.dtype.kind == 'f':
        wrong = np.flatnonzero(~np.isfinite(times))
        if len(wrong):
            raise ValueError(f'stamps must be finite; stamp {wrong[0]} is {times[wrong[0]]}')
        # Longer floats keep the ns of times since 1970.
        times = np.rint(times.astype(np.longdouble) * _NS_PER_S)
    most = np.iinfo(np.int64).max
    if len(times) and (times.max() > most or times.min() < -most):
        raise ValueError(
            'stamps are beyond the 292 years that int64 counts in ns; floats are taken for s, give '
            'ns as integers'
        )
    return times.astype(np.int64)


def _markers(bodies: Mapping[str, Sequence[int]] | None, count: int) -> dict[str, Any]:
    """Return the parameters that say which of `count` markers are on which body."""
    if bodies is None:
        return {}
    values: dict[str, Any] = {'bodies': list(bodies)}
    for body, columns in bodies.items():
        wrong = [k for k in columns if k not in range(count)]
        if wrong:
            raise ValueError(
                f'bodies: {body} has the marker {wrong[0]!r}; points have those from 0 to '
                f'{count - 1}'
            )
        values[f'{body}.markers'] = [str(int(k)) for k in columns]
    return values


def _losses(tracker: Tracker, estimates: list[Estimate]) -> Iterator[str]:
    """Yield a line on frames without results, and on bodies without any."""
    counts = tracker.update_counts()
    for key, text in (
        ('repeated', 'frames have the stamp of the one before, and are left out'),
        ('late', 'frames are older than the one before, and are left out'),
        ('resets', 'jumps of the stamps, at which all starts anew'),
    ):
        if counts[key]:
            yield f'{counts[key]} {text}'
    for b, body in enumerate(tracker.bodies):
        if all(estimate.reason[:, b].all() for estimate in estimates):
            reason = 'too few frames for window and lag'
            if estimates:
                reason = estimates[-1].missing[-1, b]
            yield f'{body} was never estimated: {reason}'


def _warn(lines: Iterable[str]) -> None:
    for line in lines:
        warnings.warn(line, stacklevel=3)


def _tracked(estimates: list[Estimate], settings: Settings) -> Tracked:
    """Return consecutive estimates as one record."""
    names = tuple(settings.bodies)
    pairs = [(names[j], names[i]) for i, j in measured_pairs(len(names))]
    stamp = np.concatenate([np.empty(0, np.int64), *(one.stamp for one in estimates)])
    return Tracked(
        stamp * 1e-9,
        stamp,
        _records(BodyMotion, names, [_body_arrays(one) for one in estimates]),
        _records(PairMotion, pairs, [_pair_arrays(one) for one in estimates]),
        _Records((name, _events(estimates, b)) for b, name in enumerate(names)),
    )


def _events(found: list[Estimate], b: int) -> Events:
    events = [event for one in found for event in one.events if event.body == b]
    return Events(
        np.array([event.stamp for event in events], float) * 1e-9,
        np.array([event.time_sigma for event in events], float),
        np.array([event.order for event in events], int),
        np.array([event.angle_step for event in events], float),
        np.array([event.angle_step_sigma for event in events], float),
        to_plane(np.array([event.step for event in events], complex)),
        np.array([event.step_covariance for event in events]).reshape(-1, 2, 2),
    )


def _records(
    kind: type[_Record], keys: Sequence[_Key], blocks: list[dict[str, np.ndarray]]
) -> _Records[_Key, _Record]:
    """Return a record for each key from blocks of arrays (T, keys, ...); NaN for those missing."""
    count = sum(len(block['angular_velocity']) for block in blocks)
    arrays = {}
    for name in (one.name for one in fields(kind)):  # type: ignore[arg-type]
        if blocks and name in blocks[0]:
            arrays[name] = np.concatenate([block[name] for block in blocks])
        elif name == 'missing':
            arrays[name] = np.empty((0, len(keys)), str)
        else:
            shape: tuple[int, ...] = ()
            if name.endswith('_covariance'):
                shape = 2, 2
            elif name == 'position' or quantity_names(4).get(name):
                shape = (2,)
            arrays[name] = np.full((count, len(keys), *shape), np.nan)
    return _Records(
        (key, kind(**{name: array[:, k] for name, array in arrays.items()}))
        for k, key in enumerate(keys)
    )


def _body_arrays(estimate: Estimate) -> dict[str, np.ndarray]:
    """Return the fields of all `BodyMotion`, (T, B, ...)."""
    is_known = estimate.reason == KNOWN
    arrays = {
        'position': np.where(is_known[..., None], to_plane(estimate.origin(0)), np.nan),
        'angle': np.where(is_known, estimate.angle[0], np.nan),
        'missing': estimate.missing.astype(str),
    }
    return arrays | _real_arrays(estimate.quantities(estimate.order))


def _pair_arrays(estimate: Estimate) -> dict[str, np.ndarray]:
    """Return the fields of all `PairMotion`, (T, pairs, ...)."""
    return _real_arrays({'angular_velocity': estimate.relative_rate, 'icr': estimate.relative_icr})


def _real_arrays(quantities: Mapping[str, Numbers | Vectors]) -> dict[str, np.ndarray]:
    arrays = known_arrays(quantities)
    return {name: to_plane(a) if np.iscomplexobj(a) else a for name, a in arrays.items()}
