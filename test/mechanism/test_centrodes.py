"""Centrodes of linkages against closed forms, ellipses, circles and lines, and their rolling."""

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import polylines
from test_centers import FOUR_BAR, four_bar, linkage, pin

from kinpole_ros.mechanism import SceneError
from kinpole_ros.mechanism._centers import instant_centers
from kinpole_ros.mechanism._centrodes import centrodes
from kinpole_ros.mechanism._joint_kinds import Rolling, Slot
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.tools.solve._pitch import write_pitch_curves

pytestmark = pytest.mark.filterwarnings('error')

TURN = 2 * np.pi
DRAWN = 0.5


def antiparallelogram(ground: float, crank: float) -> Mechanism:
    """A four-bar of two pairs of equal links, crossed; flat at the inputs -DRAWN, π - DRAWN."""
    a = crank * np.exp(1j * DRAWN)
    diagonal = (ground - a) / abs(ground - a)
    # The corner of the parallelogram, mirrored at its diagonal.
    b = a + diagonal**2 * ground
    return linkage(four_bar({'O': 0, 'A': a, 'B': b, 'C': ground}), 'crank')


def ellipse_length(long: float, short: float) -> float:
    """The whole way round, by the trapezoidal rule, which is exact to rounding on a period."""
    t = np.arange(400) * TURN / 400
    return float(np.hypot(long * np.sin(t), short * np.cos(t)).mean() * TURN)


def ellipse_curvature(points: np.ndarray, long: float, short: float) -> np.ndarray:
    """At points along the axes."""
    x, y = points.real, points.imag
    return long * short / ((y * long / short) ** 2 + (x * short / long) ** 2) ** 1.5


def test_crossed_cranks_roll_like_elliptic_gears() -> None:
    # The foci of either ellipse are the two pins of its crank.
    curves = centrodes(antiparallelogram(0.3, 0.1), 'crank', 'rocker', -DRAWN, TURN - DRAWN)
    for points, foci in zip((curves.fixed, curves.moving), curves.pins, strict=True):
        assert len(foci) == 2
        assert abs(foci[0] - foci[1]) == pytest.approx(0.1, abs=1e-15)
        total = np.abs(points - foci[0]) + np.abs(points - foci[1])
        assert total == pytest.approx(0.3, abs=1e-10)
    assert curves.piece.max() == 0
    assert curves.slip < 1e-12
    whole = ellipse_length(0.15, np.sqrt(0.15**2 - 0.05**2))
    assert curves.fixed_length[-1] == pytest.approx(whole, rel=1e-9)
    assert curves.moving_length[-1] == pytest.approx(whole, rel=1e-9)


def test_coupler_of_crossed_long_cranks_rolls_on_the_grounds_ellipse() -> None:
    curves = centrodes(antiparallelogram(0.1, 0.3), 'ground', 'coupler', -DRAWN, TURN - DRAWN)
    for points, foci in zip((curves.fixed, curves.moving), curves.pins, strict=True):
        total = np.abs(points - foci[0]) + np.abs(points - foci[1])
        assert total == pytest.approx(0.3, abs=1e-10)
    bend = ellipse_curvature(curves.fixed - 0.05, 0.15, np.sqrt(0.15**2 - 0.05**2))
    # Near the change points digits are lost to the third derivative.
    clear = np.abs(np.sin(curves.at + DRAWN)) > 0.1
    assert np.abs(curves.fixed_curvature)[clear] == pytest.approx(bend[clear], rel=1e-8)
    assert np.abs(curves.moving_curvature)[clear] == pytest.approx(bend[clear], rel=1e-8)
    # One lies outside of the other: they bend apart.
    assert (curves.fixed_curvature * curves.moving_curvature < 0)[clear].all()


def test_crossed_short_cranks_coupler_has_hyperbolas() -> None:
    curves = centrodes(antiparallelogram(0.3, 0.1), 'ground', 'coupler', 0.5, 2.5)
    for points, foci in zip((curves.fixed, curves.moving), curves.pins, strict=True):
        differ = np.abs(np.abs(points - foci[0]) - np.abs(points - foci[1]))
        near = np.abs(points) < 3
        assert near.mean() > 0.8
        assert differ[near] == pytest.approx(0.1, abs=1e-10)


def test_cardan_circles() -> None:
    joints = [
        Slot('X', 'ground', 0.4, 'rod', 0.4, 0.0),
        Slot('Y', 'ground', 0.3j, 'rod', 0.3j, np.pi / 2),
    ]
    curves = centrodes(linkage(joints, 'rod'), 'ground', 'rod', 0.0, TURN)
    assert np.abs(curves.fixed) == pytest.approx(0.5, abs=1e-12)
    assert np.abs(curves.moving - (0.2 + 0.15j)) == pytest.approx(0.25, abs=1e-12)
    # As the rod turns left the center goes round to the right, twice in the small circle.
    assert curves.fixed_curvature == pytest.approx(-2, rel=1e-10)
    assert curves.moving_curvature == pytest.approx(-4, rel=1e-10)
    assert curves.fixed_length == pytest.approx(0.5 * curves.at, abs=1e-10)
    assert curves.slip < 1e-12


def test_wheel_rolls_with_its_rim_on_the_line() -> None:
    joints = [Rolling('roll', 'ground', 0, 'wheel', 0.1j, 0.1)]
    curves = centrodes(linkage(joints, 'wheel'), 'ground', 'wheel', 0.0, 5.0, 41)
    assert curves.fixed == pytest.approx(-0.1 * curves.at, abs=1e-12)
    assert np.abs(curves.moving - 0.1j) == pytest.approx(0.1, abs=1e-12)
    assert curves.fixed_curvature == pytest.approx(0, abs=1e-12)
    assert curves.moving_curvature == pytest.approx(-10, rel=1e-12)
    assert curves.moving_length == pytest.approx(0.1 * curves.at, abs=1e-12)


@pytest.mark.parametrize('one', ['ground', 'crank'])
@pytest.mark.parametrize('other', ['coupler', 'rocker'])
def test_centrodes_are_the_centers_seen_from_either_body(one: str, other: str) -> None:
    mechanism = linkage(four_bar(), 'crank')
    curves = centrodes(mechanism, one, other, 0.0, TURN, 100)
    motion = mechanism.sweep(curves.at)
    centers = instant_centers(mechanism, motion.values[0])
    place = centers.points[centers.row(one, other)]
    for name, points in ((one, curves.fixed), (other, curves.moving)):
        if name != 'ground':
            k = mechanism.bodies.index(name)
            points = motion.position[0, k] + points * np.exp(1j * motion.angle[0, k])
        there = curves.piece >= 0
        assert points[there] == pytest.approx(place[there], rel=1e-8)


def test_the_pair_seen_from_the_other_body_is_the_pair_exchanged() -> None:
    # The curvature of the moving centrode, by the law of rolling, against its own derivatives.
    mechanism = linkage(four_bar(), 'crank')
    one = centrodes(mechanism, 'crank', 'rocker', 0.1, 3.0)
    other = centrodes(mechanism, 'rocker', 'crank', 0.1, 3.0)
    assert one.fixed == pytest.approx(other.moving, rel=1e-10)
    assert one.moving == pytest.approx(other.fixed, rel=1e-10)
    known = np.isfinite(one.moving_curvature)
    assert known.mean() > 0.9
    largest = np.abs(one.moving_curvature[known]).max()
    assert one.moving_curvature[known] == pytest.approx(
        other.fixed_curvature[known], rel=1e-7, abs=1e-7 * largest
    )


def test_arc_lengths_are_those_of_the_chords() -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'ground', 'coupler', 0.0, TURN, 4001)
    for points, length in (
        (curves.fixed, curves.fixed_length),
        (curves.moving, curves.moving_length),
    ):
        near = np.abs(points) < 3
        same = (np.diff(curves.piece) == 0) & near[1:] & near[:-1]
        chords = np.abs(np.diff(points))[same]
        assert same.mean() > 0.5
        assert np.diff(length)[same] == pytest.approx(chords, rel=1e-3)
    assert curves.slip < 1e-10


def test_slip_tells_curves_that_do_not_roll_on_each_other() -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'ground', 'coupler', 0.0, 1.0)
    wrong = curves._replace(moving_length=1.001 * curves.moving_length)
    assert curves.slip < 1e-12
    assert wrong.slip == pytest.approx(
        0.001 * min(1, curves.fixed_length[-1] / curves.size), rel=0.1
    )


def test_curves_break_where_the_center_passes_infinity() -> None:
    mechanism = linkage(four_bar(), 'crank')
    curves = centrodes(mechanism, 'ground', 'coupler', 0.0, TURN, 722)
    rate = mechanism.sweep(curves.at).angle[1, mechanism.bodies.index('coupler')]
    turns = int((np.diff(np.sign(rate)) != 0).sum())
    assert turns == 2
    assert curves.piece.max() == turns
    for piece in range(turns + 1):
        rows = np.flatnonzero(curves.piece == piece)
        assert len(set(np.sign(rate[rows]))) == 1
        assert curves.fixed_length[rows[0]] == 0
        assert (np.diff(curves.fixed_length[rows]) > 0).all()


def test_range_ends_at_the_limits_of_the_linkage() -> None:
    places = {'O': 0, 'A': 0.3 + 0.05j, 'B': 0.35 + 0.2j, 'C': 0.4}
    mechanism = linkage(four_bar(places), 'crank')
    limits = [dead.at for dead in mechanism.path(-7.0, 7.0).dead_points if dead.turns_back]
    curves = centrodes(mechanism, 'ground', 'coupler', -7.0, 7.0)
    assert curves.at[[0, -1]] == pytest.approx(limits, abs=1e-4)
    assert ((limits[0] < curves.at) & (curves.at < limits[1])).all()
    # There all moves as the root of the way left, which the lengths are not to miss.
    finer = centrodes(mechanism, 'ground', 'coupler', -7.0, 7.0, 4 * 721)
    for ends in (slice(-60, None), slice(60)):
        at = curves.at[ends]
        limit = limits[0 if at[0] < 0 else 1]
        root, known = np.sqrt(np.abs(limit - at)), np.sqrt(np.abs(limit - finer.at))
        order = np.argsort(known)
        expected = np.interp(root, known[order], finer.fixed_length[order])
        rolled = curves.fixed_length[ends]
        assert rolled[-1] - rolled[0] == pytest.approx(expected[-1] - expected[0], rel=1e-4)


def test_samples_keep_clear_of_change_points() -> None:
    # The start, a half and a whole turn are change points, and would be samples.
    mechanism = antiparallelogram(0.3, 0.1)
    curves = centrodes(mechanism, 'crank', 'rocker', -DRAWN, TURN - DRAWN, 73)
    assert np.isfinite(curves.fixed).all()
    assert np.abs(np.sin(curves.at + DRAWN)).min() > 0.01
    # A whole turn stays one.
    assert curves.at[-1] - curves.at[0] == pytest.approx(TURN, abs=1e-9)


def test_centrode_of_a_pin_is_a_point() -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'crank', 'coupler', 0.0, TURN, 50)
    assert curves.fixed == pytest.approx(FOUR_BAR['A'], abs=1e-12)
    assert curves.moving == pytest.approx(FOUR_BAR['A'], abs=1e-12)
    assert curves.fixed_length == pytest.approx(0, abs=1e-10)
    assert np.isnan(curves.fixed_curvature).all()
    assert np.isnan(curves.moving_curvature).all()


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (('ground', 'piston', 0.0, 1.0), 'no body piston: name one of ground, crank'),
        (('crank', 'crank', 0.0, 1.0), 'crank has no centrode with itself'),
        (('ground', 'coupler', 1.0, 0.0), 'from 1 to 0 are no range'),
        (('ground', 'coupler', 0.0, 1.0, 1), '1 samples'),
    ],
)
def test_what_has_no_centrodes_is_refused_in_one_line(arguments: tuple, message: str) -> None:
    with pytest.raises(LinkageError, match=message) as caught:
        centrodes(linkage(four_bar(), 'crank'), *arguments)
    assert '\n' not in str(caught.value)


def test_bodies_that_only_shift_are_refused() -> None:
    mechanism = linkage(four_bar({'O': 0, 'A': 0.1j, 'B': 0.3 + 0.1j, 'C': 0.3}), 'crank')
    with pytest.raises(LinkageError, match='coupler does not turn as seen from ground'):
        centrodes(mechanism, 'ground', 'coupler', 0.0, 1.0)


def test_several_drivers_are_refused() -> None:
    joints = [pin('O', 'ground', 'upper', 0), pin('A', 'upper', 'lower', 0.3)]
    with pytest.raises(LinkageError, match='2 drivers'):
        centrodes(linkage(joints, 'upper', 'lower'), 'ground', 'lower', 0.0, 1.0)


def test_pitch_curves_as_a_table_read_back(tmp_path: Path) -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'ground', 'coupler', 0.0, TURN, 100)
    write_pitch_curves(tmp_path / 'new' / 'curves.csv', curves)
    with open(tmp_path / 'new' / 'curves.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    there = curves.piece >= 0
    assert len(rows) == there.sum()
    read = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    assert np.array_equal(read['fixed_x'] + 1j * read['fixed_y'], curves.fixed[there])
    assert np.array_equal(read['moving_x'] + 1j * read['moving_y'], curves.moving[there])
    assert np.array_equal(read['arc_length'], curves.fixed_length[there])
    assert np.array_equal(read['piece'], curves.piece[there])
    assert np.array_equal(read['input'], curves.at[there])


def test_pitch_curves_are_drawn_to_scale_in_millimeters(tmp_path: Path) -> None:
    curves = centrodes(antiparallelogram(0.3, 0.1), 'crank', 'rocker', 0.0, TURN, 200)
    write_pitch_curves(tmp_path / 'gears.SVG', curves)
    root = ElementTree.parse(tmp_path / 'gears.SVG').getroot()
    space = '{http://www.w3.org/2000/svg}'
    _, top, width, height = map(float, root.get('viewBox', '').split())
    assert root.get('width') == f'{width:.4f}mm'
    assert root.get('height') == f'{height:.4f}mm'
    groups = root.findall(f'{space}g')
    assert [group.get('id') for group in groups] == ['crank', 'rocker']
    right = 0.0
    for group, points, pins in zip(groups, (curves.fixed, curves.moving), curves.pins, strict=True):
        paths = [path.get('d', '') for path in group.findall(f'{space}path')]
        # After a full turn it is closed.
        assert paths[0].endswith(' Z')
        drawn = np.array([part.split() for part in paths[0][2:-2].split(' L ')], float)
        inside = points[:-1]
        assert drawn == pytest.approx(1e3 * np.stack((inside.real, -inside.imag), axis=1), abs=1e-4)
        x, y = paths[1].split()[1:3]
        cross = complex(float(x) + 2, -float(y))
        assert cross == pytest.approx(1e3 * pins[0], abs=1e-3)
        shift = float(group.get('transform', '')[len('translate(') :].split()[0])
        # On the paper, and side by side.
        assert shift + drawn[:, 0].min() > right
        right = shift + drawn[:, 0].max()
        assert right < width
        assert top < drawn[:, 1].min()
        assert drawn[:, 1].max() < top + height
        assert [text.text for text in group.findall(f'{space}text')][:2] == ['x', 'y']


def test_pitch_curves_as_dxf_are_closed_where_they_close(tmp_path: Path) -> None:
    curves = centrodes(antiparallelogram(0.3, 0.1), 'crank', 'rocker', 0.0, TURN, 200)
    write_pitch_curves(tmp_path / 'gears.dxf', curves)
    text = (tmp_path / 'gears.dxf').read_text()
    assert text.startswith('999\nCentrodes of crank and rocker, in mm\n')
    assert '\n1\nin mm\n' in text
    for name, points in (('CRANK', curves.fixed), ('ROCKER', curves.moving)):
        ((_, closed, drawn),) = [one for one in polylines(tmp_path / 'gears.dxf') if one[0] == name]
        assert closed
        shape = 1e3 * points[:-1]
        np.testing.assert_allclose(drawn - drawn[0], shape - shape[0], atol=2e-6)
    # Half a turn is open.
    curves = centrodes(antiparallelogram(0.3, 0.1), 'crank', 'rocker', 0.1, 2.0, 50)
    write_pitch_curves(tmp_path / 'half.dxf', curves)
    layers = [one for one in polylines(tmp_path / 'half.dxf') if one[0] == 'CRANK']
    assert [(closed, len(points)) for _, closed, points in layers] == [(False, 50)]


def test_drawing_ends_where_the_curves_leave_for_infinity(tmp_path: Path) -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'ground', 'coupler', 0.0, TURN)
    write_pitch_curves(tmp_path / 'curves.svg', curves)
    root = ElementTree.parse(tmp_path / 'curves.svg').getroot()
    assert float(root.get('viewBox', '').split()[2]) < 2 * 1e3 * 2 * 3.5 * curves.size
    assert np.nanmax(np.abs(curves.fixed)) > 10 * curves.size


def test_names_that_are_markup_are_escaped(tmp_path: Path) -> None:
    joints = [Rolling('roll', 'ground', 0, 'a<"&', 0.1j, 0.1)]
    curves = centrodes(linkage(joints, 'a<"&'), 'ground', 'a<"&', 0.0, 5.0, 41)
    write_pitch_curves(tmp_path / 'curves.svg', curves)
    groups = ElementTree.parse(tmp_path / 'curves.svg').getroot()[1:]
    assert groups[1].get('id') == 'a<"&'


def test_files_that_cannot_be_written_are_named_in_one_line(tmp_path: Path) -> None:
    curves = centrodes(linkage(four_bar(), 'crank'), 'ground', 'coupler', 0.0, 1.0, 5)
    with pytest.raises(LinkageError, match=r'curves\.dwg is no pitch curves; end its name in one'):
        write_pitch_curves(tmp_path / 'curves.dwg', curves)
    (tmp_path / 'taken').write_text('')
    for suffix in ('csv', 'dxf', 'svg'):
        with pytest.raises(SceneError, match='cannot be written') as caught:
            write_pitch_curves(tmp_path / 'taken' / f'curves.{suffix}', curves)
        assert '\n' not in str(caught.value)
