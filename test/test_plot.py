"""Pictures of result bags: drawn whatever is missing, and the curves in them are the right ones."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message

from kinpole_ros.bags import (
    BagError,
    BagWriter,
    message_class,
    read_messages,
    replay,
    simulate,
    topics,
)
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import ns_to_stamp, stamp_to_ns
from kinpole_ros.parameters import Settings
from kinpole_ros.plot import _draw, centrodes, plot, read_results

pytest.importorskip('matplotlib')


@pytest.fixture(scope='session')
def bags(tmp_path_factory) -> dict[str, Path]:
    """Result bags of the three scenes, and the markers of one as `markers`."""
    folder = tmp_path_factory.mktemp('plot')
    found = {}
    for name in ('four_bar', 'rolling_wheel', 'cardan'):
        scene = load_scene(name)
        markers, found[name] = folder / f'{name}_markers.mcap', folder / f'{name}.mcap'
        simulate(scene, markers, rate=100, duration=1.2, noise=1e-5)
        bodies = {body: tuple(names) for body, names in scene.marker_names.items()}
        replay(markers, Settings(bodies=bodies), found[name])
    return {**found, 'markers': markers}


def thinned(bag: Path, output: Path, keep) -> Path:
    """The messages of a bag, less the drawings in it, for which `keep(topic, stamp in s)`."""
    with BagWriter(output) as writer:
        drawings = ('/visualization', '/centrode/fixed', '/centrode/moving')
        for message in read_messages(bag, [t for t in topics(bag) if not t.endswith(drawings)]):
            decoded = deserialize_message(message.data, message_class(message.type_name))
            stamp = stamp_to_ns(decoded.header.stamp) * 1e-9
            if keep(message.topic, stamp):
                writer.write(message.topic, decoded, message.log_time)
    return output


def drawn(bag: Path, output: Path) -> bytes:
    plot(bag, output)
    return output.read_bytes()


@pytest.mark.parametrize('scene', ['four_bar', 'rolling_wheel', 'cardan'])
def test_every_scene_is_drawn_1800_px_wide(bags, tmp_path, scene) -> None:
    picture = drawn(bags[scene], tmp_path / 'out.png')
    assert picture[:8] == b'\x89PNG\r\n\x1a\n'
    assert int.from_bytes(picture[16:20], 'big') == 1800


def test_suffix_chooses_the_format(bags, tmp_path) -> None:
    assert b'<svg' in drawn(bags['cardan'], tmp_path / 'out.svg')


def test_moving_centrode_of_a_wheel_is_its_rim_and_the_fixed_one_the_ground(bags) -> None:
    (wheel,) = read_results(bags['rolling_wheel']).bodies
    locus = centrodes(wheel)
    settled = slice(20, None)
    assert len(locus.stamp) > 80
    np.testing.assert_allclose(locus.fixed[settled].imag, 0, atol=2e-3)
    # A circle about the hub, wherever that is in the frame of the body: |z - c|² = r² is linear.
    rim = locus.moving[settled]
    equations = np.column_stack([2 * rim.real, 2 * rim.imag, np.ones(len(rim))])
    x, y, rest = np.linalg.lstsq(equations, np.abs(rim) ** 2, rcond=None)[0]
    assert np.sqrt(rest + x**2 + y**2) == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(np.abs(rim - (x + 1j * y)), 0.1, atol=2e-3)


def test_rolled_centrode_touches_the_fixed_one_in_the_pole(bags) -> None:
    (rod,) = read_results(bags['cardan']).bodies
    locus = centrodes(rod)
    k = len(locus.stamp) // 2
    here = np.flatnonzero(rod.stamp == locus.stamp[k])[0]
    rolled = rod.position[here] + locus.moving * np.exp(1j * rod.angle[here])
    assert rolled[k] == pytest.approx(locus.fixed[k], abs=1e-12)
    # Inside the fixed circle everywhere, so tangent there.
    assert np.abs(rolled[20:]).max() < 0.3 + 2e-3


def test_bodies_come_in_the_order_of_the_node_and_truth_is_left_out(bags) -> None:
    results = read_results(bags['four_bar'])
    assert [body.name for body in results.bodies] == ['crank', 'coupler', 'rocker']
    pairs = {('coupler', 'crank'), ('rocker', 'crank'), ('rocker', 'coupler')}
    assert set(results.relative) == pairs
    with pytest.raises(BagError, match='kinpole replay'):
        read_results(bags['markers'])


@pytest.mark.parametrize('plane', ['xy', 'yz', 'zx'])
@pytest.mark.parametrize('rate', [2.0, 0.0])
def test_plane_is_found_from_the_turning_or_else_from_what_was_measured(
    tmp_path, plane, rate
) -> None:
    normal = {'xy': 2, 'yz': 0, 'zx': 1}[plane]
    bag = tmp_path / 'bag.mcap'
    with BagWriter(bag) as writer:
        for k in range(5):
            stamp = k * 10**7
            message = Odometry()
            message.header.stamp = ns_to_stamp(stamp)
            setattr(message.twist.twist.angular, 'xyz'[normal], rate)
            diagonal = np.full(6, 1e6)
            diagonal[3 + normal] = 1e-4
            message.pose.covariance = np.diag(diagonal).ravel()
            writer.write('/ns/kinpole/link/odom', message, stamp)
    results = read_results(bag)
    assert results.plane == plane
    np.testing.assert_array_equal(results.bodies[0].rate, rate)


@pytest.mark.parametrize(
    'missing', ['/icr', '/with_covariance', '/icr_velocity', '/centrode_curvature', '/angular_']
)
def test_missing_topics_leave_the_rest_drawn(bags, tmp_path, missing) -> None:
    bag = thinned(bags['cardan'], tmp_path / 'less.mcap', lambda topic, _: missing not in topic)
    assert drawn(bag, tmp_path / 'out.png')


def test_relative_centers_to_a_body_without_results_are_left_out(bags, tmp_path) -> None:
    bag = thinned(
        bags['four_bar'], tmp_path / 'less.mcap', lambda topic, _: '/crank/odom' not in topic
    )
    assert set(read_results(bag).relative) == {('rocker', 'coupler')}


def test_pole_is_read_from_either_of_its_topics(bags, tmp_path) -> None:
    only = [
        thinned(bags['cardan'], tmp_path / f'{k}.mcap', lambda t, _, end=end: t.endswith(end))
        for k, end in enumerate([('/odom', '/icr'), ('/odom', '/icr/with_covariance')])
    ]
    plain, full = (read_results(bag).bodies[0].series['icr'] for bag in only)
    np.testing.assert_array_equal(plain.value, full.value)
    assert np.isnan(plain.covariance).all() and np.isfinite(full.covariance).all()


def test_body_without_poles_and_rates_is_drawn(tmp_path) -> None:
    bag = tmp_path / 'bag.mcap'
    with BagWriter(bag) as writer:
        writer.write('/kinpole/link/odom', Odometry(), 0)
    assert drawn(bag, tmp_path / 'out.png')


def test_single_instant_is_drawn(bags, tmp_path) -> None:
    (body,) = read_results(bags['cardan']).bodies
    only = body.stamp[60] * 1e-9
    bag = thinned(bags['cardan'], tmp_path / 'one.mcap', lambda _, stamp: abs(stamp - only) < 1e-4)
    assert len(read_results(bag).bodies[0].stamp) == 1
    assert drawn(bag, tmp_path / 'out.png')


def test_bag_cut_off_is_drawn_as_far_as_it_goes(bags, tmp_path) -> None:
    cut = tmp_path / 'cut.mcap'
    whole = bags['cardan'].read_bytes()
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    results = read_results(cut)
    assert results.cut and len(results.bodies[0].stamp) > 10
    assert drawn(cut, tmp_path / 'out.png')


def test_more_bodies_than_rows_are_named_in_the_title(tmp_path) -> None:
    bag, names = tmp_path / 'many.mcap', ['a', 'b', 'c', 'd', 'extra_one']
    with BagWriter(bag) as writer:
        for name in names:
            writer.write(f'/kinpole/{name}/odom', Odometry(), 0)
    # In an SVG letters are paths, but each text stands beside them as a comment.
    assert b'not drawn: extra_one' in drawn(bag, tmp_path / 'out.svg')


def test_lines_stop_at_gaps_and_where_the_pole_passes_infinity(bags, tmp_path) -> None:
    start = read_results(bags['cardan']).bodies[0].stamp[0] * 1e-9
    gappy = thinned(
        bags['cardan'], tmp_path / 'gap.mcap', lambda _, stamp: not 0.4 < stamp - start < 0.7
    )
    (rod,) = read_results(gappy).bodies
    (gap,) = _draw._breaks(rod, rod.stamp)
    assert rod.stamp[gap + 1] - rod.stamp[gap] > 0.29e9
    values, alone = _draw._broken(np.arange(4.0), np.array([1, 2]))
    np.testing.assert_array_equal(values, [0, 1, np.nan, 2, np.nan, 3])
    assert alone == [3, 5]
    np.testing.assert_array_equal(_draw._reversals(np.array([1.0, 2, -1, -1, 3])), [1, 3])


def test_poles_at_infinity_do_not_squash_the_picture(bags) -> None:
    coupler = read_results(bags['four_bar']).bodies[1]
    locus = centrodes(coupler)
    assert np.abs(locus.fixed).max() > 20
    view = _draw._view(coupler, locus, _draw._reach(coupler, locus))
    assert max(abs(view.low), abs(view.high)) < 3


def test_bag_without_results_says_so_and_how_to_make_them(bags, tmp_path) -> None:
    with pytest.raises(BagError, match=r'no results.*kinpole replay .*markers\.mcap'):
        plot(bags['markers'], tmp_path / 'out.png')
    other = tmp_path / 'other.mcap'
    with BagWriter(other) as writer:
        writer.write('/imu', Vector3Stamped(), 0)
        writer.write('/robot/odom', Odometry(), 0)
    with pytest.raises(BagError, match='no results'):
        plot(other, tmp_path / 'out.png')
    assert not (tmp_path / 'out.png').exists()


def test_bodies_that_were_never_tracked_are_named(bags, tmp_path) -> None:
    bag = tmp_path / 'nothing.mcap'
    with BagWriter(bag) as writer:
        writer.add_topic('/kinpole/crnk/odom', Odometry)
    with pytest.raises(BagError, match=r'no pose of /kinpole/crnk; .* name the markers'):
        plot(bag, tmp_path / 'out.png')


def test_a_curve_of_few_instants_is_not_called_one_of_none(bags, tmp_path) -> None:
    topic = '/kinpole/rod/centrode_curvature'
    start = read_results(bags['cardan']).bodies[0].series['centrode_curvature'].stamp[0] * 1e-9
    few = thinned(
        bags['cardan'], tmp_path / 'few.mcap', lambda t, s: t != topic or s < start + 1e-4
    )
    assert len(read_results(few).bodies[0].series['centrode_curvature'].stamp) == 1
    assert b'determined at less than 1% of the instants' in drawn(few, tmp_path / 'out.svg')


@pytest.mark.parametrize('name', ['out', 'out.mcap', 'file/out.png'])
def test_output_that_cannot_be_written_is_named(bags, tmp_path, name) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match=name):
        plot(bags['cardan'], tmp_path / name)


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
def test_a_full_disk_is_told_as_one(bags, tmp_path) -> None:
    (tmp_path / 'full.png').symlink_to('/dev/full')
    with pytest.raises(BagError, match=r'full\.png cannot be written: No space left.* the disk'):
        plot(bags['cardan'], tmp_path / 'full.png')


@pytest.mark.parametrize('name', [b'cost $5_$.mcap', '日本.mcap'.encode(), b'no text \xff.mcap'])
def test_any_name_of_a_bag_is_drawn_in_a_folder_that_is_made(bags, tmp_path, name, recwarn) -> None:
    bag = tmp_path / os.fsdecode(name)
    os.link(bags['cardan'], bag)
    plot(bag, tmp_path / 'new' / 'folder' / 'out.png')
    assert (tmp_path / 'new' / 'folder' / 'out.png').read_bytes().startswith(b'\x89PNG')
    assert not recwarn.list


def test_progress_is_not_over_before_the_picture_is_there(bags, tmp_path) -> None:
    picture = tmp_path / 'out.png'
    told: list[tuple[float, bool]] = []
    plot(bags['cardan'], picture, lambda share: told.append((share, picture.exists())))
    assert told == sorted(told)
    assert told[-1] == (1.0, True)
    assert all(share <= 0.9 for share, drawn in told if not drawn)


def test_the_mend_of_a_bag_without_results_can_be_typed(bags, tmp_path) -> None:
    bag = tmp_path / 'run 1.mcap'
    os.link(bags['markers'], bag)
    with pytest.raises(BagError, match=rf"kinpole replay '{bag}' --output"):
        plot(bag, tmp_path / 'out.png')


def test_missing_matplotlib_is_told_with_the_mend(monkeypatch, bags, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
    with pytest.raises(BagError, match=r"pip install 'kinpole_ros\[plot\]'"):
        plot(bags['cardan'], tmp_path / 'out.png')


def test_pyplot_is_left_alone(bags, tmp_path) -> None:
    script = (
        'import sys; from kinpole_ros.plot import plot; '
        "assert 'matplotlib' not in sys.modules; plot(*sys.argv[1:]); "
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    words = [sys.executable, '-c', script, str(bags['cardan']), str(tmp_path / 'out.png')]
    subprocess.run(words, check=True, timeout=60)
