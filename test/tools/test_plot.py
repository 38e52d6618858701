"""Pictures of result bags: drawn whatever is missing, and the curves in them are the right ones."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import title_of
from geometry_msgs.msg import Vector3Stamped
from matplotlib.figure import Figure
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

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
from kinpole_ros.messages import deserialize_message, stamp_to_ns
from kinpole_ros.settings import Settings
from kinpole_ros.tools.plot import _instant, _result_picture, _style, plot
from kinpole_ros.tools.record import lost
from kinpole_ros.tools.record.record import MotionRecord, pairs_of
from kinpole_ros.tools.record.result_bag import read_record
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES

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
        replay(markers, Settings(bodies=bodies, topics='all'), found[name])
    four_bar = folder / 'four_bar_markers.mcap'
    return {**found, 'markers': markers, 'cardan_markers': markers, 'four_bar_markers': four_bar}


def known(record: MotionRecord, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Where a body has a pose, and the stamps there."""
    is_known = np.isfinite(record.columns[body, 'position'])
    return is_known, record.stamp[is_known]


def thinned(bag: Path, output: Path, keep) -> Path:
    """The messages of a bag, less the drawings in it, for which `keep(topic, stamp in s)`."""
    with BagWriter(output) as writer:
        drawings = ('/visualization', '/centrode/fixed', '/centrode/moving', '/tf')
        for message in read_messages(bag, [t for t in topics(bag) if not t.endswith(drawings)]):
            decoded = deserialize_message(message.data, message_class(message.type_name))
            # What a node says of itself has no stamp.
            is_rig = message.topic.endswith('/rig')
            if is_rig or keep(message.topic, stamp_to_ns(decoded.header.stamp) * 1e-9):
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
    fixed, moving = _instant.centrodes(read_record(bags['rolling_wheel']), 'wheel')
    settled = np.flatnonzero(np.isfinite(fixed))[20:]
    assert len(settled) > 60
    np.testing.assert_allclose(fixed[settled].imag, 0, atol=2e-3)
    # A circle about the hub, wherever that is in the frame of the body: |z - c|² = r² is linear.
    rim = moving[settled]
    equations = np.column_stack([2 * rim.real, 2 * rim.imag, np.ones(len(rim))])
    x, y, rest = np.linalg.lstsq(equations, np.abs(rim) ** 2, rcond=None)[0]
    assert np.sqrt(rest + x**2 + y**2) == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(np.abs(rim - (x + 1j * y)), 0.1, atol=2e-3)


def test_rolled_centrode_touches_the_fixed_one_in_the_pole(bags) -> None:
    record = read_record(bags['cardan'])
    fixed, moving = _instant.centrodes(record, 'rod')
    known = np.flatnonzero(np.isfinite(fixed))
    k = known[len(known) // 2]
    position, angle = (record.columns['rod', name][k] for name in ('position', 'angle'))
    rolled = position + moving * np.exp(1j * angle)
    assert rolled[k] == pytest.approx(fixed[k], abs=1e-12)
    # Inside the fixed circle everywhere, so tangent there.
    assert np.abs(rolled[known[20:]]).max() < 0.3 + 2e-3


def test_bodies_come_in_the_order_of_the_node_and_truth_is_left_out(bags, tmp_path) -> None:
    """Whatever the order in the bag; odometry without messages or of another node is no body."""
    bag = tmp_path / 'bag.mcap'
    with BagWriter(bag) as writer:
        for name in ('kinpole/gone', 'robot', 'kinpole/rocker', 'kinpole/crank', 'kinpole/truth/x'):
            writer.add_topic(f'/{name}/odom', Odometry)
        for message in read_messages(bags['four_bar'], topics(bags['four_bar'])):
            if message.topic != '/tf':
                decoded = deserialize_message(message.data, message_class(message.type_name))
                writer.write(message.topic, decoded, message.log_time)
    record = read_record(bag)
    assert record.bodies == ('crank', 'coupler', 'rocker')
    pairs = {('coupler', 'crank'), ('rocker', 'crank'), ('rocker', 'coupler')}
    assert set(pairs_of(record)) == pairs
    with pytest.raises(BagError, match='kinpole replay'):
        read_record(bags['markers'])


def test_bodies_of_standard_topics_come_in_the_order_of_the_node(bags, tmp_path) -> None:
    """Whatever the order of topics in a recording, and without relative centers."""
    bodies = {body: tuple(names) for body, names in load_scene('four_bar').marker_names.items()}
    result, bag = tmp_path / 'standard.mcap', tmp_path / 'recorded.mcap'
    replay(bags['four_bar_markers'], Settings(bodies=bodies), result)
    kinds = {topic: kind for topic, kind in topics(result).items() if topic != '/tf'}
    with BagWriter(bag) as writer:
        for topic in sorted(kinds):
            writer.add_topic(topic, message_class(kinds[topic]))
        for message in read_messages(result, list(kinds)):
            cls = message_class(message.type_name)
            writer.write_raw(message.topic, cls, message.data, message.log_time)
    record = read_record(bag)
    assert record.bodies == ('crank', 'coupler', 'rocker')
    assert not pairs_of(record)
    assert np.isfinite(record.columns['crank', 'ijp']).sum() > 50


@pytest.mark.parametrize(
    'missing', ['/icr', '/with_covariance', '/centrode_curvature', '/angular_']
)
def test_missing_topics_leave_the_rest_drawn(bags, tmp_path, missing) -> None:
    bag = thinned(bags['cardan'], tmp_path / 'less.mcap', lambda topic, _: missing not in topic)
    assert drawn(bag, tmp_path / 'out.png')


def test_relative_centers_without_a_topic_are_left_out(bags, tmp_path) -> None:
    bag = thinned(
        bags['four_bar'], tmp_path / 'less.mcap', lambda topic, _: '/wrt/crank' not in topic
    )
    assert set(pairs_of(read_record(bag))) == {('rocker', 'coupler')}


def test_results_of_an_earlier_version_are_refused_with_the_command(bags, tmp_path) -> None:
    old = tmp_path / 'old.mcap'
    with BagWriter(old) as writer:
        for message in read_messages(bags['cardan'], ['/kinpole/state', '/kinpole/visualization']):
            writer.write_raw(message.topic, message.type_name, message.data, message.log_time)
    with pytest.raises(BagError, match=r'earlier version.*kinpole replay MARKERS\.mcap --output'):
        plot(old, tmp_path / 'out.png')


def test_recording_without_the_state_is_refused_with_the_mend(bags, tmp_path) -> None:
    bag = thinned(
        bags['cardan'], tmp_path / 'less.mcap', lambda topic, _: not topic.endswith('/state')
    )
    with pytest.raises(BagError, match=r'no topic state of a node.* kinpole replay '):
        plot(bag, tmp_path / 'out.png')


def test_body_with_rates_of_the_first_order_only_is_drawn(bags, tmp_path) -> None:
    bodies = {body: tuple(names) for body, names in load_scene('cardan').marker_names.items()}
    bag = tmp_path / 'first.mcap'
    replay(bags['cardan_markers'], Settings(bodies=bodies, derivative_order=1), bag)
    names = {name for _, name in read_record(bag).columns}
    assert names & {*RATE_NAMES, *POLE_NAMES, 'icr_velocity'} == {'angular_velocity', 'icr'}
    assert drawn(bag, tmp_path / 'out.png')


def test_single_instant_is_drawn(bags, tmp_path) -> None:
    only = read_record(bags['cardan']).stamp[60] * 1e-9
    bag = thinned(bags['cardan'], tmp_path / 'one.mcap', lambda _, stamp: abs(stamp - only) < 1e-4)
    assert len(read_record(bag).stamp) == 1
    assert drawn(bag, tmp_path / 'out.png')


def test_bag_cut_off_is_drawn_as_far_as_it_goes(bags, tmp_path) -> None:
    cut = tmp_path / 'cut.mcap'
    whole = bags['cardan'].read_bytes()
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    assert read_record(cut).cut and len(read_record(cut).stamp) > 10
    assert b', bag cut off; poles' in drawn(cut, tmp_path / 'out.svg')
    assert b'cut off' not in drawn(bags['cardan'], tmp_path / 'out.svg')


def test_recording_that_ends_between_a_drawing_and_its_poses_is_drawn(bags, tmp_path) -> None:
    whole = bags['four_bar']
    early = read_record(whole).stamp[60]
    bag = tmp_path / 'cut.mcap'
    with BagWriter(bag) as writer:
        for message in read_messages(whole, [t for t in topics(whole) if t != '/tf']):
            if message.topic.endswith('/visualization') or message.log_time <= early:
                decoded = deserialize_message(message.data, message_class(message.type_name))
                writer.write(message.topic, decoded, message.log_time)
    # The outlines are those of the last drawing with poses.
    outlines = read_record(bag).outlines
    assert [len(outline) for ((_, outline),) in outlines.values()] == [3, 4, 3]
    assert drawn(bag, tmp_path / 'out.png')


def test_more_bodies_than_rows_are_named_in_the_title(tmp_path) -> None:
    scene = load_scene('six_bar')
    simulate(scene, tmp_path / 'markers.mcap', rate=100, duration=0.5)
    bodies = {body: tuple(names) for body, names in scene.marker_names.items()}
    replay(tmp_path / 'markers.mcap', Settings(bodies=bodies), tmp_path / 'many.mcap')
    # In an SVG letters are paths, but each text stands beside them as a comment.
    assert b'not drawn: lever' in drawn(tmp_path / 'many.mcap', tmp_path / 'out.svg')


def test_lines_stop_at_gaps_and_where_the_pole_passes_infinity(bags, tmp_path) -> None:
    start = read_record(bags['cardan']).stamp[0] * 1e-9
    gappy = thinned(
        bags['cardan'], tmp_path / 'gap.mcap', lambda _, stamp: not 0.4 < stamp - start < 0.7
    )
    record = read_record(gappy)
    _, stamp = known(record, 'rod')
    (gap,) = lost.breaks_of(record.stamp, stamp)
    assert stamp[gap + 1] - stamp[gap] > 0.29e9
    values, alone = lost.broken(np.arange(4.0), np.array([1, 2]))
    np.testing.assert_array_equal(values, [0, 1, np.nan, 2, np.nan, 3])
    assert alone == [3, 5]
    axis, stamp = Figure().add_subplot(), 10**7 * np.arange(5)
    _style.line(axis, stamp, np.arange(5) + 0j, {}, np.array([1.0, 2, -1, -1, 3]))
    expected = [0, 1, np.nan, 2, 3, np.nan, 4]
    np.testing.assert_array_equal(axis.lines[0].get_xdata(), expected)


@pytest.mark.parametrize('share', [0.0, 0.3, 0.7])
@pytest.mark.parametrize('jitter', [0, 300_000])
def test_the_usual_interval_does_not_depend_on_how_many_frames_are_lost(share, jitter) -> None:
    generator = np.random.default_rng(1)
    stamp = 5_000_000 * np.arange(2000) + generator.integers(0, jitter + 1, 2000)
    kept = stamp[generator.random(2000) >= share]
    interval = lost.usual_interval(kept)
    assert interval == pytest.approx(5e6, rel=0.01)
    between = np.round((kept[-1] - kept[0]) / 5e6) + 1 - len(kept)
    assert lost.lost_count(kept) == between


def test_lost_frames_are_counted_and_shaded_and_no_line_crosses_them(
    bags, tmp_path, monkeypatch
) -> None:
    start = read_record(bags['cardan']).stamp[0] * 1e-9
    gappy = thinned(
        bags['cardan'], tmp_path / 'gap.mcap', lambda _, stamp: not 0.395 < stamp - start < 0.695
    )
    figure = pictured(gappy, tmp_path, monkeypatch, bags['cardan_markers'])
    assert ', 30 frames lost' in title_of(figure)
    for axis in figure.axes[1:]:
        span = axis.collections[0].get_paths()[0].vertices[:, 0]
        assert (span.min(), span.max()) == pytest.approx((0.395, 0.695))
        # Each quantity is determined in every frame that is there.
        assert not [text for text in axis.texts if 'determined' in text.get_text()]
    for axis in figure.axes[1::2]:
        curve = axis.lines[1]
        times = np.asarray(curve.get_xdata(), float)
        steps = np.diff(times)
        assert np.nanmax(steps) < 0.02
        for band in axis.collections[1:]:
            assert len(band.get_paths()) == 2


def test_odometry_that_the_recorder_lost_is_not_missed(bags, tmp_path) -> None:
    whole = read_record(bags['cardan'])
    thin = thinned(
        bags['cardan'],
        tmp_path / 'thin.mcap',
        lambda topic, stamp: round(100 * stamp) % 3 == 0 or topic.endswith('/state'),
    )
    record = read_record(thin)
    np.testing.assert_array_equal(record.stamp, whole.stamp)
    position = 'rod', 'position'
    np.testing.assert_array_equal(record.columns[position], whole.columns[position])
    assert set(record.columns) == set(whole.columns)


def test_a_body_that_is_hidden_in_frames_that_are_there_is_undetermined_and_not_lost(
    bags, tmp_path, monkeypatch
) -> None:
    scene, markers = load_scene('four_bar'), tmp_path / 'hidden.mcap'
    simulate(scene, tmp_path / 'all.mcap', rate=100, duration=1.2, noise=1e-5)
    with BagWriter(markers) as writer:
        for k, message in enumerate(read_messages(tmp_path / 'all.mcap', ['/markers'])):
            array = deserialize_message(message.data, message_class(message.type_name))
            if 40 <= k < 80:
                seen = [m for m in array.markers if m.ns not in scene.marker_names['coupler']]
                assert 0 < len(seen) < len(array.markers)
                array.markers = seen
            writer.write('/markers', array, message.log_time)
    bodies = {body: tuple(names) for body, names in scene.marker_names.items()}
    replay(markers, Settings(bodies=bodies), tmp_path / 'result.mcap')
    record = read_record(tmp_path / 'result.mcap')
    _, stamp = known(record, 'coupler')
    assert 20 < len(record.stamp) - len(stamp) <= 40
    assert lost.lost_count(record.stamp) == 0
    figure = pictured(tmp_path / 'result.mcap', tmp_path, monkeypatch)
    assert 'lost' not in title_of(figure)
    share = len(stamp) / len(record.stamp)
    rate_axis = figure.axes[13 + 1]
    assert [f'known at {share:.0%} of instants'] == [t.get_text() for t in rate_axis.texts]


def pictured(bag: Path, folder: Path, monkeypatch, truth=None):
    """The figure that would have been written."""
    made = []
    with monkeypatch.context() as kept:
        kept.setattr(
            'matplotlib.figure.Figure.savefig', lambda figure, *_, **__: made.append(figure)
        )
        plot(bag, folder / 'out.png', truth=truth)
    return made[0]


def places(line) -> np.ndarray:
    """What a line goes through, complex, without its gaps."""
    found = np.asarray(line.get_xdata(), float) + 1j * np.asarray(line.get_ydata(), float)
    return found[np.isfinite(found)]


def test_poles_and_centrodes_of_one_instant_are_drawn_where_they_are(
    bags, tmp_path, monkeypatch
) -> None:
    figure = pictured(bags['four_bar'], tmp_path, monkeypatch)
    record = read_record(bags['four_bar'])
    start = min(known(record, body)[1][0] for body in record.bodies)
    since = float(re.search(r'centrode at t = ([\d.]+) s', title_of(figure))[1])
    kinds = set()
    (k,) = np.flatnonzero(np.abs((record.stamp - start) * 1e-9 - since) < 6e-4)
    for row, body in enumerate(record.bodies):
        axis = figure.axes[11 * row]
        assert axis.get_title() == body
        marked = {}
        lines = [line for line in axis.lines if line.get_gid() != 'linkage']
        for line in lines:
            marked.setdefault(line.get_marker(), []).extend(places(line))
        now = {name: values[k] for (of, name), values in record.columns.items() if of == body}
        assert marked['+'] == [now['position']]
        for pole, sign in (('icr', 'o'), ('iap', '^'), ('ijp', 's')):
            expected = [now[pole]] if np.isfinite(now[pole]) else []
            np.testing.assert_array_equal(marked.get(sign, []), expected)
        pairs = [pair for pair in pairs_of(record) if pair[0] == body]
        centers = [z for pair in pairs if np.isfinite(z := record.columns[pair, 'icr'][k])]
        assert sorted(marked.get('D', []), key=abs) == sorted(centers, key=abs)
        icr, u = now['icr'], now['icr_velocity']
        styles = {line.get_linestyle(): places(line) for line in lines}
        np.testing.assert_array_equal(
            styles[':'], record.columns[body, 'position'][known(record, body)[0]]
        )
        # The centrodes roll on each other, now in the ICR.
        assert np.abs(styles['-'] - icr).min() < 1e-9
        assert np.abs(styles['--'] - icr).min() < 1e-9
        assert ('-.' in styles) == bool(pairs)
        spread = np.linalg.eigvalsh(now['icr_covariance'])
        ellipses = [one for one in axis.patches if hasattr(one, 'center')]
        ellipse = next(one for one in ellipses if complex(*one.center) == icr)
        assert (ellipse.width, ellipse.height) == pytest.approx(4 * np.sqrt(spread[::-1]))
        arrows = [text for text in axis.texts if getattr(text, 'arrow_patch', None)]
        if np.isfinite(now['centrode_curvature']):
            (arrow,) = arrows
            way = complex(*arrow.xy) - complex(*arrow.xyann)
            assert complex(*arrow.xyann) == icr
            assert way / abs(way) == pytest.approx(u / abs(u))
            assert any(f'{abs(u):.3g} m/s' in text.get_text() for text in axis.texts)
        else:
            assert not arrows
            # On its pin it is not even said.
            said = {text.get_text() for text in axis.texts}
            assert ('ICR not seen to move' in said) == bool(u)
        kinds.add(bool(arrows))
    assert kinds == {True, False}


def test_rates_are_drawn_over_time_with_their_bands(bags, tmp_path, monkeypatch) -> None:
    figure = pictured(bags['cardan'], tmp_path, monkeypatch)
    record = read_record(bags['cardan'])
    _, stamps = known(record, 'rod')
    start, names = stamps[0], (*RATE_NAMES[:3], 'centrode_curvature', 'icr_velocity')
    series = {name: record.series('rod', name) for name in names}
    for axis, (name, (stamp, value, _)) in zip(figure.axes[1::2], series.items(), strict=True):
        if name == 'icr_velocity':
            value = np.abs(value)
        now, curve = axis.lines
        assert places(curve) == pytest.approx((stamp - start) * 1e-9 + 1j * value)
        assert axis.get_xlim() == pytest.approx((0, (stamps[-1] - start) * 1e-9))
        assert f't = {now.get_xdata()[0]:.3f} s' in title_of(figure)
        low, high = axis.get_ylim()
        assert np.mean((low < value) & (value < high)) > 0.9
    (band,) = figure.axes[1].collections
    edge = series['angular_velocity'].value + 2 * series['angular_velocity'].spread
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(edge.max())
    # Every curve has a band, and below it the band at its own scale.
    for axis, strip in zip(figure.axes[1::2], figure.axes[2::2], strict=True):
        assert axis.collections
        (band,) = strip.collections
        low, high = strip.get_ylim()
        assert low == -high
        top = band.get_paths()[0].vertices[:, 1]
        assert np.mean(np.abs(top) <= high) > 0.8


def test_exact_answers_are_drawn_with_the_error_in_its_band(bags, tmp_path, monkeypatch) -> None:
    figure = pictured(bags['cardan'], tmp_path, monkeypatch, bags['cardan_markers'])
    rates = read_record(bags['cardan']).series('rod', 'angular_velocity')
    exact = load_scene('cardan').motion(rates.stamp * 1e-9 - 1.0)['rod'].angle
    axis, strip = figure.axes[1:3]
    *_, curve = axis.lines
    np.testing.assert_allclose(places(curve).imag, exact[1], atol=1e-9)
    *_, error = strip.lines
    np.testing.assert_allclose(places(error).imag, rates.value - exact[1], atol=1e-9)


def test_the_linkage_is_drawn_with_its_pins_where_they_are(bags, tmp_path, monkeypatch) -> None:
    figure = pictured(bags['four_bar'], tmp_path, monkeypatch)
    record = read_record(bags['four_bar'])
    assert [len(record.outlines[body][-1][1]) for body in record.bodies] == [3, 4, 3]
    pins = [
        complex(line.get_xdata()[0], line.get_ydata()[0])
        for line in figure.axes[11].lines
        if line.get_gid() == 'linkage' and line.get_marker() == 'o'
    ]
    start = min(known(record, body)[1][0] for body in record.bodies)
    since = float(re.search(r'centrode at t = ([\d.]+) s', title_of(figure))[1])
    motion = load_scene('four_bar').motion(start * 1e-9 - 1.0 + since)
    arm, rod = (motion[name] for name in ('crank', 'coupler'))
    expected = [
        # The rocker's own is not known after so short a time.
        0.0,
        arm.position[0] + 0.12 * np.exp(1j * arm.angle[0]),
        rod.position[0] + 0.36 * np.exp(1j * rod.angle[0]),
    ]
    np.testing.assert_allclose(sorted(pins, key=abs), sorted(expected, key=abs), atol=2e-3)


@pytest.mark.parametrize(('scene', 'related'), [('four_bar', True), ('cardan', False)])
def test_the_legend_tells_of_what_is_drawn(bags, tmp_path, monkeypatch, scene, related) -> None:
    (legend,) = pictured(bags[scene], tmp_path, monkeypatch).legends
    assert ('relative instant center' in {t.get_text() for t in legend.get_texts()}) == related


def test_what_is_in_view_and_known_well_enough_is_kept() -> None:
    box = _style.Box(-1 - 1j, 1 + 1j)
    points = np.array([0.5 - 0.5j, 2, -2, 2j, -2j])
    assert box.contains(points).tolist() == [True, False, False, False, False]
    covariance = np.array([0.04, 0.06, np.nan])[:, None, None] ** 2 * np.diag([1.0, 0.0])
    assert _instant._is_blurred(covariance, 1.0).tolist() == [False, True, False]


def test_poles_at_infinity_do_not_squash_the_picture(bags) -> None:
    record = read_record(bags['four_bar'])
    assert np.nanmax(np.abs(record.columns['coupler', 'icr'])) > 20
    view = _instant.scope_of(record, 'coupler').view
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


def test_bodies_that_were_never_tracked_are_named(tmp_path) -> None:
    bag = tmp_path / 'nothing.mcap'
    with BagWriter(bag) as writer:
        writer.add_topic('/kinpole/rig', String)
        writer.add_topic('/kinpole/state', PointCloud2)
    with pytest.raises(BagError, match=r'no pose of /kinpole; .* name the markers'):
        plot(bag, tmp_path / 'out.png')


def test_a_curve_of_few_instants_is_not_called_one_of_none(bags, tmp_path, monkeypatch) -> None:
    record = read_record(bags['cardan'])
    curvature = record.columns['rod', 'centrode_curvature']
    curvature[np.flatnonzero(np.isfinite(curvature))[1:]] = np.nan
    monkeypatch.setattr(_result_picture, 'read_record', lambda *_: record)
    text = b'known at less than 1% of instants'
    assert text in drawn(bags['cardan'], tmp_path / 'few.svg')


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
    # An old matplotlib uses what a new pyparsing deprecates.
    assert not [each for each in recwarn if not issubclass(each.category, DeprecationWarning)]


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
    monkeypatch.setitem(sys.modules, 'matplotlib.backend_bases', None)
    with pytest.raises(BagError, match='pip install matplotlib'):
        plot(bags['cardan'], tmp_path / 'out.png')


def test_pyplot_is_left_alone(bags, tmp_path) -> None:
    script = (
        'import sys; from kinpole_ros.tools.plot import plot; '
        "assert 'matplotlib' not in sys.modules; plot(*sys.argv[1:]); "
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    words = [sys.executable, '-c', script, str(bags['cardan']), str(tmp_path / 'out.png')]
    subprocess.run(words, check=True, timeout=60)


def test_clouds_of_another_program_are_no_results(tmp_path) -> None:
    bag = tmp_path / 'robot.mcap'
    with BagWriter(bag) as writer:
        writer.write('/robot/base/odom', Odometry(), 0)
        writer.write('/robot/state', PointCloud2(), 0)
    with pytest.raises(BagError, match='no results'):
        plot(bag, tmp_path / 'out.png')
