"""The door for Python: arrays in, arrays out, the figures of replay."""

import inspect
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import bodies_of, write_config

import kinpole_ros
from kinpole_ros import UnknownNameError, mechanism, planar, replay, track
from kinpole_ros.bags import BagWriter, read_frames
from kinpole_ros.bags import replay as replay_bag
from kinpole_ros.messages import to_message
from kinpole_ros.settings import ParameterError, Settings


@pytest.fixture(scope='module')
def rig(simulated: Callable[..., Path]) -> Path:
    return simulated('four_bar', duration=0.5, noise=2e-4, dropout=0.02)


@pytest.mark.parametrize('module', [kinpole_ros, planar, mechanism], ids=lambda one: one.__name__)
def test_signatures_name_types_and_do_not_spell_them_out(module: Any) -> None:
    """ArrayLike is a union of protocols, which takes 20 lines of help()."""
    for name in module.__all__:
        if inspect.isfunction(function := getattr(module, name)):
            assert 'NestedSequence' not in (shown := str(inspect.signature(function))), name
            assert len(shown) < 700, name


def all_arrays(tracked: kinpole_ros.Tracked) -> dict[str, np.ndarray]:
    parts = {**tracked.bodies, **{'/'.join(pair): one for pair, one in tracked.pairs.items()}}
    return {
        f'{name}.{key}': array for name, one in parts.items() for key, array in vars(one).items()
    }


def test_replay_has_the_cells_of_the_table(rig: Path, tmp_path: Path) -> None:
    settings = Settings(bodies=bodies_of('four_bar'))
    config = write_config(tmp_path / 'rig.yaml', settings)
    replay_bag(rig, settings, csv=tmp_path / 'result.csv')
    table = np.genfromtxt(tmp_path / 'result.csv', delimiter=',', names=True)
    found = replay(rig, config)
    coupler = found['coupler']
    assert found.t == pytest.approx(table['t'])
    for ours, column in (
        (coupler.position[:, 1], 'coupler_y'),
        (coupler.angular_jerk, 'coupler_angular_jerk'),
        (coupler.angular_jerk_sigma, 'coupler_angular_jerk_sigma'),
        (coupler.iap[:, 0], 'coupler_iap_x'),
        (np.sqrt(coupler.iap_covariance[:, 0, 0]), 'coupler_iap_x_sigma'),
        (coupler.icr_velocity[:, 1], 'coupler_icr_velocity_y'),
        (coupler.centrode_curvature, 'coupler_centrode_curvature'),
        (coupler.centrode_curvature_sigma, 'coupler_centrode_curvature_sigma'),
        (found.pairs['rocker', 'coupler'].icr[:, 0], 'rocker_wrt_coupler_icr_x'),
    ):
        assert np.array_equal(ours, table[column], equal_nan=True), column
    assert {array.dtype.kind for array in all_arrays(found).values()} == {'f', 'U'}


def test_a_frame_of_pandas_has_the_columns_of_the_table(rig: Path, tmp_path: Path) -> None:
    pytest.importorskip('pandas', reason='pandas is an extra')
    settings = Settings(bodies=bodies_of('four_bar'))
    replay_bag(rig, settings, csv=tmp_path / 'result.csv')
    table = np.genfromtxt(tmp_path / 'result.csv', delimiter=',', names=True)
    frame = replay(rig, write_config(tmp_path / 'rig.yaml', settings)).to_frame()
    numbers = [name for name in table.dtype.names if not name.endswith('_reason')]
    names = [name for name in numbers if '_event_' not in name]
    assert set(names) == {'t', *frame.columns} - {'stamp'}
    for column in names[1:]:
        assert np.array_equal(frame[column], table[column], equal_nan=True), column
    assert frame.index.to_numpy() == pytest.approx(table['t'])
    assert (frame['stamp'].to_numpy() * 1e-9 == frame.index.to_numpy()).all()


def test_a_frame_without_pandas_is_refused_with_the_fix(rig: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, 'pandas', None)
    settings = {'bodies': ['coupler'], 'coupler.markers': bodies_of('four_bar')['coupler']}
    with pytest.raises(ImportError, match='needs pandas; fix: pip install pandas'):
        replay(rig, **settings).to_frame()


def test_the_first_part_of_a_bag_ends_before_its_first_late_frame(tmp_path: Path) -> None:
    seconds = [0, 1, 2, 5, 1, 2]
    with BagWriter(tmp_path / 'a.mcap') as bag:
        for k, second in enumerate(seconds):
            # Layouts change, so that each frame is a part of its own.
            names = [str(marker) for marker in range(2 + k % 2)]
            points, stamp = np.ones((len(names), 3)), 10**9 * (1 + second)
            bag.write('/a', to_message('marker_array', stamp, 'world', names, points), 10**9 + k)
    parts, _ = read_frames(tmp_path / 'a.mcap', seconds=3.0)
    assert [int(stamp) // 10**9 - 1 for part in parts for stamp in part.stamps] == [0, 1, 2]


@pytest.mark.parametrize('whole', [False, True])
def test_track_is_replay_of_an_array(rig: Path, whole: bool) -> None:
    parts, _ = read_frames(rig)
    count = max(part.points.shape[1] for part in parts)
    names = next(part.identities for part in parts if part.points.shape[1] == count)
    points = np.full((sum(len(part.stamps) for part in parts), count, 3), np.nan)
    row = 0
    for part in parts:
        columns = [names.index(name) for name in part.identities]
        points[row : row + len(part.stamps), columns] = part.points
        row += len(part.stamps)
    stamps = np.concatenate([part.stamps for part in parts])
    bodies = {
        body: [k for k, name in enumerate(names) if name.split('/')[0] in markers]
        for body, markers in bodies_of('four_bar').items()
    }
    # Markers that are not seen are NaN here, and absent from the messages of the bag.
    expected = replay(
        rig,
        whole=whole,
        **{'bodies': list(bodies), **{f'{k}.markers': v for k, v in bodies_of('four_bar').items()}},
    )
    for given in (points, points[..., :2]):
        found = track(given, stamps, bodies, whole)
        assert np.array_equal(found.stamp, expected.stamp)
        for name, array in all_arrays(expected).items():
            ours = all_arrays(found)[name]
            if array.dtype.kind == 'U':
                assert (ours == array).all()
            else:
                assert ours == pytest.approx(array, rel=1e-6, abs=1e-9, nan_ok=True), name


def test_less_is_nan_and_nothing_is_empty_and_warned_of() -> None:
    stamps = np.arange(60) * 5_000_000
    angle = 2e-9 * stamps
    arms = np.array([0.1, 0.1j])
    places = np.exp(1j * angle)[:, None] * arms
    points = np.stack((places.real, places.imag), axis=-1)
    body = track(points, stamps, derivative_order=1)['body']
    assert np.isfinite(body.angular_velocity).all()
    for none in (body.angular_acceleration, body.iap, body.icr_velocity_covariance):
        assert np.isnan(none).all()
    assert body.iap.shape == (len(body.angle), 2)
    with pytest.warns(UserWarning, match='body was never estimated: too few frames'):
        few = track(points[:3], stamps[:3])
    assert few['body'].icr_covariance.shape == (0, 2, 2)
    assert few.t.shape == few['body'].missing.shape == (0,)
    with pytest.warns(UserWarning, match='1 frames have the stamp of the one before'):
        track(points, np.where(np.arange(60) == 30, stamps[29], stamps))


@pytest.mark.parametrize(
    'frames, hidden, noise', [(1200, 0.12, 1e-5), (1200, 0.2, 1e-5), (500, 0.1, 0)]
)
def test_a_body_hidden_now_and_then_has_its_rate_whenever_it_is_seen(
    frames: int, hidden: float, noise: float
) -> None:
    """Also while few samples are seen since it came back, and without noise."""
    stamps = np.arange(frames) * 5_000_000
    time = stamps * 1e-9
    shape = np.array([0.4 + 0.1j, 0.2 + 0.1j, 0.2 - 0.1j, 0.4 - 0.1j])
    places = np.exp(0.8j * np.sin(4 * np.pi * time))[:, None] * shape
    points = np.stack((places.real, places.imag), axis=-1)
    points += noise * np.random.default_rng(0).normal(size=points.shape)
    covered = (time > 1) & (time % 0.9 < hidden)
    points[covered] = np.nan
    found = track(points, stamps, window=0.5, lag=0.05)
    body, seen = found['body'], ~covered[np.searchsorted(stamps, found.stamp)]
    assert (body.missing[seen] == '').all()
    assert np.isfinite(body.angular_velocity[seen]).all()


@pytest.mark.parametrize(
    'words, told',
    [
        ({'points': np.zeros((5, 2))}, r'points must have shape \(T, n, 2\)'),
        ({'stamps': ['1'] * 5}, 'stamps must be integers, ns, or floats, s'),
        ({'stamps': [0, 1, np.nan, 3, 4]}, 'stamps must be finite; stamp 2 is nan'),
        ({'stamps': 1.7e18 + np.arange(5.0)}, 'floats are taken for s, give ns as integers'),
        ({'stamps': np.arange(5, dtype=np.uint64) + 2**63}, 'beyond the 292 years'),
        ({'stamps': np.arange(4)}, r'of shape \(5,\)'),
        ({'bodies': {'rod': [0, 7]}}, 'rod has the marker 7; points have those from 0 to 2'),
        ({'plane': 'yz'}, 'points of two coordinates are in the plane xy'),
        ({'windo': 0.3}, 'unknown parameter windo'),
        ({'lag': -1.0}, 'parameter lag is -1.0'),
    ],
)
def test_what_does_not_fit_is_refused(words: dict[str, Any], told: str) -> None:
    given = {'points': np.zeros((5, 3, 2)), 'stamps': np.arange(5), **words}
    with pytest.raises(ValueError, match=told):
        track(**given)


def test_stamps_in_seconds_are_stamps_in_ns() -> None:
    stamps = 1_700_000_000_000_000_000 + np.arange(60) * 5_000_000
    places = np.exp(2e-9j * (stamps - stamps[0]))[:, None] * np.array([0.1, 0.1j])
    points = np.stack((places.real, places.imag), axis=-1)
    for offset in (0, stamps[0]):
        expected = track(points, stamps - offset)
        found = track(points, (stamps - offset) * 1e-9)
        # Floats of seconds since 1970 have steps of 240 ns; making them here rounds twice.
        most = 0 if offset else 480
        assert np.abs(found.stamp - expected.stamp).max() <= most
        rate = expected['body'].angular_velocity
        assert found['body'].angular_velocity == pytest.approx(rate, rel=1e-3)


def test_a_name_that_is_missing_is_told_with_those_there_are(rig: Path) -> None:
    markers = bodies_of('four_bar')
    names = {'bodies': list(markers), **{f'{k}.markers': v for k, v in markers.items()}}
    found = replay(rig, derivative_order=1, **names)
    with pytest.raises(UnknownNameError) as missing:
        found['crnk']
    assert str(missing.value) == (
        'crnk is not tracked; did you mean crank? known: crank, coupler, rocker'
    )
    with pytest.raises(KeyError, match='crank is not'):
        kinpole_ros.Tracked(found.t, found.stamp, type(found.bodies)(), {})['crank']
    with pytest.raises(KeyError, match='did you mean rocker wrt coupler'):
        found.pairs['coupler', 'rocker']
    with pytest.raises(
        AttributeError, match=r'no angular_velocty; did you mean angular_velocity\?'
    ):
        _ = found['crank'].angular_velocty
    assert found.bodies.get('crnk') is None
    assert 'crnk' not in found.bodies
    assert (pickle.loads(pickle.dumps(found)).stamp == found.stamp).all()


def test_replay_warns_as_the_command_does(rig: Path) -> None:
    with pytest.warns(UserWarning, match='tip'):
        replay(rig, **{'bodies': ['rod'], 'rod.markers': ['tip', 'heel']})
    with pytest.raises(ParameterError, match='windo'):
        replay(rig, windo=1)


def test_a_result_shows_a_summary_and_no_arrays() -> None:
    t = np.arange(200) / 200
    turn = np.exp(2j * t)[:, None] * np.array([0.1, -0.05 + 0.08j, -0.05 - 0.08j])
    points = np.stack((turn.real, turn.imag), axis=-1)
    hidden = np.full_like(points[:, :2], np.nan)
    with pytest.warns(UserWarning, match='never estimated'):
        found = track(np.hstack((points, hidden)), t, {'rotor': [0, 1, 2], 'far': [3, 4]})
    title, head, turning, far = repr(found).splitlines()
    assert title.startswith(f'Tracked at {len(found.t)} instants, t = 0 to 0.')
    assert head.split()[:2] == ['body', 'angular']
    assert turning.split()[:4] == ['rotor', '2', 'to', '2']
    assert far.split() == ['far', '-', '-', '0.0%', '0.0%']
    assert '<td>rotor</td><td>2 to 2</td>' in found._repr_html_()
    assert repr(found['far']).startswith(f'BodyMotion at {len(found.t)} instants: position, ')
