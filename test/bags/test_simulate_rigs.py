"""Bags that are as bad as what real rigs send, and parameters set on the command line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinpole_ros.bags import message_class, read_messages, replay
from kinpole_ros.messages import deserialize_message, read_markers, stamp_to_ns
from kinpole_ros.settings import (
    ParameterError,
    Settings,
    assignments,
    load_settings,
    settings_from,
)
from kinpole_ros.tools import cli

Simulated = Callable[..., Path]
PLAIN: dict[str, Any] = {'rate': 100, 'duration': 1.0, 'noise': 1e-3}


def messages(bag: Path, topic: str = '/markers') -> list[Any]:
    found = read_messages(bag, [topic])
    return [deserialize_message(m.data, message_class(m.type_name)) for m in found]


def points(bag: Path) -> np.ndarray:
    """Those (T, n, 3) of a bag whose messages have all markers."""
    return np.concatenate([read_markers(message).points for message in messages(bag)])


def stamps(bag: Path, topic: str = '/markers') -> np.ndarray:
    found = messages(bag, topic)
    headers = [getattr(m, 'header', None) or m.markers[0].header for m in found]
    return np.array([stamp_to_ns(header.stamp) for header in headers])


def vectors(bag: Path, topic: str) -> np.ndarray:
    """Points or vectors (T, 3) of a topic."""
    found = [getattr(m, 'point', None) or m.vector for m in messages(bag, topic)]
    return np.array([(v.x, v.y, v.z) for v in found])


def about_x(degrees: float) -> np.ndarray:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([(1, 0, 0), (0, cos, -sin), (0, sin, cos)])


def test_late_stamps_keep_the_order_and_the_motion_of_the_capture(simulated: Simulated) -> None:
    even = simulated('four_bar', **PLAIN, message='pose_array')
    late = simulated('four_bar', **PLAIN, message='pose_array', arrival=0.02)
    delay = stamps(late) - stamps(even)
    assert delay.min() >= 0
    assert (np.diff(stamps(late)) > 0).all()
    # At a mean of two intervals many frames wait for one before them.
    assert (np.diff(stamps(late)) == 1).mean() > 0.3
    assert 0.01 < delay.mean() / 1e9 < 0.08
    assert np.array_equal(points(late), points(even))
    # The answer is under the stamp of its frame, and logged with it.
    topic = '/kinpole/truth/coupler/icr'
    assert np.array_equal(stamps(late, topic), stamps(late))
    assert np.array_equal(vectors(late, topic), vectors(even, topic))
    assert [m.log_time for m in read_messages(late, [topic])] == stamps(late).tolist()


def test_delays_have_the_mean_asked_for(simulated: Simulated) -> None:
    words: dict[str, Any] = {'rate': 10, 'duration': 200, 'arrival': 0.003}
    bag = simulated('cardan', **words, message='point_cloud2')
    delay = (stamps(bag) - 10**9 - 10**8 * np.arange(2000)) / 1e9
    assert delay.mean() == pytest.approx(0.003, rel=0.1)
    assert delay.std() == pytest.approx(0.003, rel=0.15)


@pytest.mark.parametrize('degrees', [20.0, 90.0, -135.0])
def test_a_tilted_plane_takes_the_truth_with_it(simulated: Simulated, degrees: float) -> None:
    flat = simulated('four_bar', rate=50, duration=0.5)
    tilted = simulated('four_bar', rate=50, duration=0.5, tilt=degrees)
    turn = about_x(degrees)
    assert points(tilted) == pytest.approx(points(flat) @ turn.T, abs=1e-12)
    for name in ('icr', 'isp', 'icr_velocity', 'angular_velocity', 'centrode_curvature'):
        topic = f'/kinpole/truth/coupler/{name}'
        before, after = vectors(flat, topic), vectors(tilted, topic)
        assert after == pytest.approx(before @ turn.T, rel=1e-12, abs=1e-12)
    # Odometry: from pose and twist follows the velocity of every point.
    topic = '/kinpole/truth/coupler/odom'
    for before, after in zip(messages(flat, topic), messages(tilted, topic), strict=True):
        places = [
            np.array([getattr(m.pose.pose.position, k) for k in 'xyz']) for m in (before, after)
        ]
        assert places[1] == pytest.approx(turn @ places[0])
        axes = [rotation(m.pose.pose.orientation) for m in (before, after)]
        assert axes[1] == pytest.approx(turn @ axes[0])
        twists = [m.twist.twist for m in (before, after)]
        assert twists[0] == twists[1]
        covariances = [m.pose.covariance.reshape(6, 6) for m in (before, after)]
        for part in (slice(3), slice(3, 6)):
            expected = turn @ covariances[0][part, part] @ turn.T
            assert covariances[1][part, part] == pytest.approx(expected)


def rotation(q: Any) -> np.ndarray:
    """The matrix of a unit quaternion, Rodrigues: 1 + 2 w K + 2 K K."""
    k = np.array([(0, -q.z, q.y), (q.z, 0, -q.x), (-q.y, q.x, 0)])
    return np.eye(3) + 2 * q.w * k + 2 * k @ k


def test_a_tilted_plane_has_noise_along_its_normal_and_the_same_within(
    simulated: Simulated,
) -> None:
    flat = points(simulated('four_bar', **PLAIN))
    tilted = points(simulated('four_bar', **PLAIN, tilt=30.0)) @ about_x(30.0)
    assert tilted[..., :2] == pytest.approx(flat[..., :2], abs=1e-12)
    assert not flat[..., 2].any()
    assert tilted[..., 2].std() == pytest.approx(1e-3, rel=0.1)


def test_units_are_those_of_the_markers_alone(simulated: Simulated) -> None:
    meters = simulated('four_bar', **PLAIN)
    millimeters = simulated('four_bar', **PLAIN, scale=1000.0)
    assert points(millimeters) == pytest.approx(1000 * points(meters), rel=1e-12)
    topic = '/kinpole/truth/crank/icr'
    assert np.array_equal(vectors(millimeters, topic), vectors(meters, topic))


@pytest.mark.parametrize('message', ['marker_array', 'marker', 'pose_array', 'point_cloud2'])
def test_unlabeled_points_are_the_same_in_another_order(simulated: Simulated, message: str) -> None:
    words: dict[str, Any] = {'rate': 50, 'duration': 1.0, 'noise': 1e-4, 'message': message}
    named = points(simulated('four_bar', **words))
    mixed = points(simulated('four_bar', **words, unlabeled=True))
    assert not np.array_equal(named, mixed)
    assert np.array_equal(np.sort(named, axis=1), np.sort(mixed, axis=1))
    # Another order in each frame.
    places = (named[:, None] == mixed[:, :, None]).all(axis=-1).argmax(axis=-1)
    assert len(np.unique(places, axis=0)) > 45
    missing = simulated('four_bar', **words, unlabeled=True, dropout=0.2)
    seen = [read_markers(m) for m in messages(missing)]
    assert {len(frame.identities) for frame in seen} >= {7, 8, 9}
    for frame in seen:
        assert frame.identities == tuple(map(str, range(len(frame.identities))))
        assert np.isfinite(frame.points).all()


def test_one_way_to_spoil_a_bag_leaves_the_others_as_they_are(simulated: Simulated) -> None:
    both = simulated('four_bar', **PLAIN, arrival=0.01, scale=1000.0, unlabeled=True)
    late = simulated('four_bar', **PLAIN, arrival=0.01)
    mixed = simulated('four_bar', **PLAIN, unlabeled=True)
    assert np.array_equal(stamps(both), stamps(late))
    assert points(both) == pytest.approx(1000 * points(mixed), rel=1e-12)


@pytest.mark.parametrize(
    'option, value, complaint',
    [
        ('--arrival', '-1', '--arrival is -1.0; it must be 0 s or more'),
        ('--arrival', 'nan', '--arrival is nan'),
        ('--arrival', '1e300', '--arrival and --jitter make a bag of'),
        ('--tilt', '200', '--tilt is 200.0; it must be from -180 to 180 degrees'),
        ('--tilt', 'nan', '--tilt is nan'),
        ('--scale', '0', '--scale is 0.0; it must be from 1e-9 to 1e9 units per m'),
        ('--scale', '-1', '--scale is -1.0'),
    ],
)
def test_a_way_to_spoil_out_of_range_is_named_with_the_range(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, complaint: str
) -> None:
    output = tmp_path / 'x.mcap'
    assert cli.main(['simulate', 'cardan', '--output', str(output), f'{option}={value}']) == 2
    said = capsys.readouterr().err
    assert complaint in said
    assert said.count('\n') == 1
    assert not output.exists()


def test_the_command_spoils_as_the_function_does(simulated: Simulated, tmp_path: Path) -> None:
    output = tmp_path / 'x.mcap'
    words = '--rate 50 --duration 0.5 --arrival 0.002 --tilt 10 --scale 1000 --unlabeled'
    assert cli.main(['simulate', 'cardan', '--output', str(output), *words.split()]) == 0
    given: dict[str, Any] = {'arrival': 0.002, 'tilt': 10.0, 'scale': 1000.0, 'unlabeled': True}
    expected = simulated('cardan', rate=50, duration=0.5, **given)
    assert output.read_bytes() == expected.read_bytes()


def test_the_example_of_a_real_rig_tracks_what_it_says(
    simulated: Simulated, tmp_path: Path
) -> None:
    words: dict[str, Any] = {'message': 'point_cloud2', 'unlabeled': True, 'scale': 1000.0}
    words |= {'tilt': 20.0, 'arrival': 0.001, 'noise': 2e-4, 'dropout': 0.02}
    bag = simulated('four_bar', duration=4.0, **words)
    config = Path(__file__).parents[2] / 'config' / 'real_rig.yaml'
    output = tmp_path / 'rig.mcap'
    replay(bag, load_settings(config), output)
    for body in 'crank', 'coupler', 'rocker':
        for name, most in ('angular_velocity', 0.05), ('icr', 0.01):
            truth = f'/kinpole/truth/{body}/{name}'
            known = dict(zip(stamps(bag, truth).tolist(), vectors(bag, truth), strict=True))
            found = f'/kinpole/{body}/{name}'
            # Figures keep the stamps of their frames; the clock is known after 2 s.
            found_at = stamps(output, found)
            late = found_at > 3 * 10**9
            assert late.sum() > 200
            expected = np.array([known[stamp] for stamp in found_at[late].tolist()])
            off = np.linalg.norm(vectors(output, found)[late] - expected, axis=1)
            assert np.median(off) < most


class TestSet:
    def test_values_are_read_as_ros_reads_them(self) -> None:
        words = [
            'lag:=5e-2',
            'plane:=yz',
            "crank.markers:=['0', '1']",
            'lag:=1e-2',
            'autostart:=on',
        ]
        expected = {'lag': 0.01, 'plane': 'yz', 'crank.markers': ['0', '1'], 'autostart': True}
        assert assignments(words) == expected
        assert assignments(['crank:={markers: [a, b]}']) == {'crank.markers': ['a', 'b']}
        assert assignments(['scene:=a:=b']) == {'scene': 'a:=b'}

    @pytest.mark.parametrize('word', ['lag', 'lag=1', ':=1', '', 'lag:=[1'])
    def test_a_word_that_is_none_is_named(self, word: str) -> None:
        with pytest.raises(ParameterError, match=r'is not NAME:=VALUE|the value is not YAML'):
            assignments([word])

    def test_it_overrides_the_file_before_the_whole_is_checked(self, tmp_path: Path) -> None:
        path = tmp_path / 'rig.yaml'
        path.write_text('kinpole: {ros__parameters: {lag: 2.0, window: 0.4, noise: 0.001}}')
        with pytest.raises(ParameterError, match=r'rig\.yaml: parameter lag is 2 s'):
            load_settings(path)
        settings = load_settings(path, changes=assignments(['lag:=0.2']))
        assert settings == settings_from({'lag': 0.2, 'window': 0.4, 'noise': 0.001})
        assert settings_from({}) == Settings()

    @pytest.mark.parametrize(
        'word, complaint',
        [
            ('lag:=soon', "parameter lag is 'soon'; it must be a number from 0 to 3600 s"),
            ('lag:=', 'parameter lag has no value; leave it out or give it one'),
            ('lag:=2001-99-99', "parameter lag is '2001-99-99'; it must be a number"),
            ('speed:=1', 'unknown parameter speed; known are '),
            ('lag:=0.5', 'parameter lag is 0.5 s; it must be less than window, 0.3 s'),
        ],
    )
    @pytest.mark.parametrize('command', ['replay', 'batch'])
    def test_it_is_refused_in_the_words_of_a_file(
        self,
        simulated: Simulated,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        command: str,
        word: str,
        complaint: str,
    ) -> None:
        bag = simulated('cardan', rate=50, duration=0.5)
        assert cli.main([command, str(bag), '--set', word]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f'kinpole {command}: {complaint}')
        assert said.count('\n') == 1

    def test_replay_uses_it(
        self, simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        bag = simulated('cardan', rate=100, duration=0.6, noise=1e-4)
        outputs = [tmp_path / 'a.csv', tmp_path / 'b.csv']
        words = ['--set', 'lag:=0.02', '--set', 'bodies:=[rod]', '--csv', str(outputs[0])]
        assert cli.main(['replay', str(bag), *words]) == 0
        assert 'rod: determined at' in capsys.readouterr().out
        replay(bag, settings_from({'lag': 0.02, 'bodies': ['rod']}), csv=outputs[1])
        assert outputs[0].read_text() == outputs[1].read_text()
