"""Instant centers by Kennedy's theorem and by the rates, and what measured ones can show."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros.mechanism import _kennedy
from kinpole_ros.mechanism._assembly import assemble
from kinpole_ros.mechanism._centers import Centers, centers_by_rates, instant_centers
from kinpole_ros.mechanism._joint_kinds import Joint, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._kennedy import deduce, explain, kennedy_centers
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Driver, Mechanism
from kinpole_ros.planar import relative_pole
from kinpole_ros.planar._poles import kennedy_residual
from kinpole_ros.planar._uncertainty import covariance

pytestmark = pytest.mark.filterwarnings('error')

FOUR_BAR = {'O': 0, 'A': 0.1 + 0.07j, 'B': 0.35 + 0.3j, 'C': 0.4}


def pin(name: str, one: str, other: str, at: complex) -> Revolute:
    """A pin that is `at` where the linkage is drawn: there all angles and origins are zero."""
    return Revolute(name, one, at, other, at)


def linkage(joints: Sequence[Joint], *drive: str, start: dict[str, float] | None = None) -> Any:
    """The mechanism of joints as drawn; the variables `drive` are driven at the rate 1."""
    names = dict.fromkeys(name for joint in joints for name in (joint.one, joint.other))
    assembly = assemble([name for name in names if name != 'ground'], joints)
    variables = assembly.loops.variables
    values = np.array([(start or {}).get(name, 0.0) for name in variables])
    drivers = []
    for name in drive:
        row = np.eye(len(variables))[variables.index(name)]
        drivers.append(Driver(name, row, steady(row @ values)))
    return Mechanism(assembly, tuple(drivers), values)


def steady(value: float) -> Callable[[Any], Any]:
    def motion(t: Any) -> Any:
        found = np.zeros((5, *np.shape(t)))
        found[0], found[1] = value + t, 1.0
        return found

    return motion


def four_bar(places: dict[str, complex] = FOUR_BAR) -> list[Joint]:
    links = (('ground', 'crank'), ('crank', 'coupler'), ('coupler', 'rocker'), ('ground', 'rocker'))
    return [pin(name, *two, places[name]) for name, two in zip('OABC', links, strict=True)]


def dyad(on: str, at: complex, other: str, end: complex, middle: complex) -> list[Joint]:
    """Two more links, from a point of one body to a point of another."""
    return [pin('D', on, 'd', at), pin('E', 'd', 'e', middle), pin('F', other, 'e', end)]


def eight_bar() -> list[Joint]:
    """Eight links on a ring with two chords: no four of them make a loop."""
    ring = 0.3 * np.exp(2j * np.pi * (np.arange(8) + [0, 0.1, -0.2, 0.3, 0, -0.1, 0.2, 0.1]) / 8)
    names = ['ground', *'abcdefg']
    joints = [pin(f'P{k}', names[k], names[(k + 1) % 8], ring[k]) for k in range(8)]
    return [*joints, pin('Q', 'ground', 'd', 0.03 + 0.05j), pin('R', 'b', 'f', -0.02 + 0.1j)]


LINKAGES: dict[str, tuple[list[Joint], float]] = {
    'four-bar': (four_bar(), 6.2),
    'slider-crank': (
        [
            *four_bar()[:2],
            pin('B', 'coupler', 'slider', 0.35 + 0.02j),
            Slot('slide', 'ground', 0.35 + 0.02j, 'slider', 0.35 + 0.02j, 0.0, 0.0),
        ],
        6.2,
    ),
    'pin in slot': (
        [*four_bar()[:2], Slot('S', 'ground', 0.35 + 0.02j, 'coupler', 0.35 + 0.02j, 0.1)],
        6.2,
    ),
    'quick return': (
        [
            pin('O', 'ground', 'crank', 0),
            pin('C', 'ground', 'lever', -0.3j),
            Slot('S', 'lever', 0.1, 'crank', 0.1, 1.25),
        ],
        6.2,
    ),
    'watt': ([*four_bar(), *dyad('rocker', 0.5 + 0.2j, 'ground', 0.9, 0.8 + 0.3j)], 6.2),
    'stephenson 3': ([*four_bar(), *dyad('coupler', 0.3 + 0.4j, 'ground', 0.9, 0.8 + 0.3j)], 2.4),
    'stephenson 2': ([*four_bar(), *dyad('crank', -0.1j, 'rocker', 0.5 + 0.3j, 0.6 - 0.1j)], 0.2),
    'eight-bar': (eight_bar(), 0.1),
}


def swept(name: str, count: int = 50) -> tuple[Mechanism, Any]:
    """A linkage of the table, and its variables (n, T)."""
    joints, high = LINKAGES[name]
    mechanism = linkage(joints, joints[0].other)
    return mechanism, mechanism.sweep(np.linspace(0, high, count)).values[0]


def by_name(centers: Centers) -> dict[str, Any]:
    """Places (3, T) by the bodies' names."""
    names = centers.bodies
    return {
        ' '.join(sorted((names[i], names[j]))): centers.places[:, row]
        for row, (i, j) in enumerate(centers.pairs)
    }


def apart(one: Any, other: Any, size: float) -> float:
    """The largest difference of two sets of places (3, ...), whose unit is `size`."""
    # As lines through the origin of homogeneous coordinates, for a center may be nearly infinite.
    first, second = (
        p / np.array([size, size, 1]).reshape(3, *[1] * (p.ndim - 1)) for p in (one, other)
    )
    first, second = (p / np.linalg.norm(p, axis=0) for p in (first, second))
    return float(np.linalg.norm(np.cross(first, second, axis=0), axis=0).max())


@pytest.mark.parametrize('name', LINKAGES)
def test_kennedy_and_the_rates_agree(name: str) -> None:
    mechanism, values = swept(name)
    kennedy = kennedy_centers(mechanism, deduce(mechanism, values), values)
    rates = centers_by_rates(mechanism, values)
    both = np.isfinite(kennedy[2]) & np.isfinite(rates[2])
    deduced = 10 if name == 'eight-bar' else kennedy.shape[1]
    assert (both.mean(axis=1) > 0.9).sum() == deduced
    assert apart(kennedy[:, both], rates[:, both], 1.0) < 1e-9


def test_the_deduction_reads_as_a_student_would_write_it() -> None:
    mechanism, values = swept('four-bar')
    lines = explain(mechanism, deduce(mechanism, values))
    assert lines[:5] == [
        '1 ground, 2 crank, 3 coupler, 4 rocker',
        'I12: pin O',
        'I23: pin A',
        'I34: pin B',
        'I14: pin C',
    ]
    assert sorted(lines[5:]) == [
        'I13: line I12-I23 meets line I14-I34',
        'I24: line I12-I14 meets line I23-I34',
    ]


def test_slides_and_slots_are_named_in_the_deduction() -> None:
    mechanism, values = swept('slider-crank')
    lines = explain(mechanism, deduce(mechanism, values))
    assert 'I14: at infinity, normal to slide slide' in lines
    assert 'I13: line I12-I23 meets line I14-I34' in lines
    mechanism, values = swept('pin in slot')
    assert explain(mechanism, deduce(mechanism, values))[-1] == (
        'I13: line I12-I23 meets the normal to slot S through its pin'
    )


def test_four_bar_centers_are_where_its_links_meet() -> None:
    mechanism, values = swept('four-bar')
    centers = instant_centers(mechanism, values)
    assert not centers.by_rates.any()
    crank, _, rocker = np.exp(1j * values[:3])
    o, c = FOUR_BAR['O'], FOUR_BAR['C']
    a = o + crank * (FOUR_BAR['A'] - o)
    b = c + rocker * (FOUR_BAR['B'] - c)
    assert centers.points[centers.row('crank', 'coupler')] == pytest.approx(a, abs=1e-14)
    assert centers.points[centers.row('coupler', 'rocker')] == pytest.approx(b, abs=1e-14)
    pole = centers.points[centers.row('coupler', 'ground')]
    assert ((pole - o) * (a - o).conj()).imag == pytest.approx(0, abs=1e-9)
    assert ((pole - c) * (b - c).conj()).imag == pytest.approx(0, abs=1e-9)
    between = centers.points[centers.row('rocker', 'crank')]
    assert between.imag == pytest.approx(0, abs=1e-9)
    assert ((between - a) * (b - a).conj()).imag == pytest.approx(0, abs=1e-9)


def test_slider_has_its_center_at_infinity_across_its_slide() -> None:
    mechanism, values = swept('slider-crank')
    for places in (
        instant_centers(mechanism, values).places,
        centers_by_rates(mechanism, values),
    ):
        centers = Centers(('ground', *mechanism.bodies), _pairs(4), places, places[2] == 0, ())
        row = centers.row('ground', 'slider')
        assert centers.directions[row] == pytest.approx(np.pi / 2, abs=1e-12)
        assert np.isnan(centers.points[row]).all()
        assert np.isnan(centers.directions[centers.row('ground', 'crank')]).all()


def _pairs(count: int) -> tuple[tuple[int, int], ...]:
    return tuple((i, j) for i in range(count) for j in range(i + 1, count))


def test_parallel_cranks_have_centers_at_infinity() -> None:
    mechanism = linkage(four_bar({'O': 0, 'A': 0.1j, 'B': 0.3 + 0.1j, 'C': 0.3}), 'crank')
    values = mechanism.sweep(np.linspace(0, 1, 9)).values[0]
    for places in (
        instant_centers(mechanism, values).places,
        centers_by_rates(mechanism, values),
    ):
        centers = Centers(('ground', *mechanism.bodies), _pairs(4), places, places[2] == 0, ())
        # The coupler only shifts, at a right angle to the cranks; so does a crank for the other.
        coupler = centers.directions[centers.row('ground', 'coupler')]
        assert coupler == pytest.approx(np.pi / 2 + values[0] - np.pi * (values[0] > np.pi / 2))
        cranks = centers.directions[centers.row('crank', 'rocker')]
        assert np.sin(cranks) == pytest.approx(0, abs=1e-12)


def test_watt_and_stephenson_six_bars_need_no_rates() -> None:
    # Both hold a four-bar, whose six centers give the dyad's.
    for name in ('watt', 'stephenson 2', 'stephenson 3'):
        mechanism, values = swept(name)
        steps = deduce(mechanism, values)
        assert len(steps) == 15
        assert all(step.rule != 'rates' for step in steps)
        assert np.isfinite(kennedy_centers(mechanism, steps, values)).all()


def test_without_a_four_bar_loop_the_rates_have_to_tell() -> None:
    mechanism, values = swept('eight-bar')
    centers = instant_centers(mechanism, values)
    assert centers.places.shape[1] == 28
    assert centers.by_rates.all(axis=1).sum() == 18
    assert np.isfinite(centers.places).all()
    lines = explain(mechanism, centers.steps)
    assert sum('from the rates: Kennedy has ' in line for line in lines) == 18
    assert any(line.endswith('only line I12-I23 for it') for line in lines)
    # Kennedy's theorem holds for them as well: any three are in line.
    at = centers.places / np.linalg.norm(centers.places, axis=0)
    rows = [centers.pairs.index(pair) for pair in ((0, 2), (2, 5), (0, 5))]
    assert np.abs(np.linalg.det(np.moveaxis(at[:, rows], -1, 0))).max() < 1e-9


def test_wheels_turn_about_their_point_of_contact() -> None:
    # On a slope; inside of a ring; a planet on an arm about a sun.
    slope = np.exp(0.3j)
    line = [Rolling('roll', 'ground', 0, 'wheel', 0.1j * slope, 0.1, along=0.3)]
    ring = [Rolling('roll', 'ground', 0, 'wheel', 0.2, 0.1, circle=-0.3)]
    planet = [
        pin('O', 'ground', 'arm', 0),
        pin('H', 'arm', 'wheel', 0.3),
        Rolling('roll', 'ground', 0, 'wheel', 0.3, 0.1, circle=0.2),
    ]
    at = np.linspace(0, 2, 7)
    for joints, contact, start in (
        (line, lambda u: u[1] * slope, {}),
        (ring, lambda u: -0.3 * np.exp(1j * u[1]), {'roll': np.pi}),
        (planet, lambda u: 0.2 * np.exp(1j * u[0]), {}),
    ):
        if joints is ring:
            joints = [ring[0].changed(start=np.pi)]
        mechanism = linkage(joints, joints[0].other, start=start)
        values = mechanism.sweep(at).values[0]
        centers = instant_centers(mechanism, values)
        assert not centers.by_rates.any()
        place = centers.points[centers.row('ground', 'wheel')]
        assert place == pytest.approx(contact(values), abs=1e-14)
        assert apart(centers.places, centers_by_rates(mechanism, values), 1.0) < 1e-12
    assert 'I13: point of contact of roll' in explain(mechanism, centers.steps)


def test_two_slots_give_the_center_of_a_trammel() -> None:
    slots = [
        Slot('X', 'ground', 0.4, 'rod', 0.4, 0.0),
        Slot('Y', 'ground', 0.3j, 'rod', 0.3j, np.pi / 2),
    ]
    mechanism = linkage(slots, 'rod')
    values = mechanism.sweep(np.linspace(0, 6, 20)).values[0]
    centers = instant_centers(mechanism, values)
    x, y = 0.4 + values[1], 0.3 + values[2]
    assert centers.points[0] == pytest.approx(x + 1j * y, abs=1e-12)
    assert not centers.by_rates.any()


def test_three_bodies_on_one_pin_have_one_center() -> None:
    places = FOUR_BAR | {'E': 0.6 + 0.1j}
    joints = [
        *four_bar(places),
        pin('B2', 'rocker', 'link', places['B']),
        pin('E', 'link', 'swing', places['E']),
        pin('F', 'ground', 'swing', 0.7 - 0.2j),
    ]
    mechanism = linkage(joints, 'crank')
    values = mechanism.sweep(np.linspace(0, 1, 20)).values[0]
    centers = instant_centers(mechanism, values)
    lines = explain(mechanism, centers.steps)
    assert 'I35: where I34 and I45 are one' in lines
    assert apart(centers.places, centers_by_rates(mechanism, values), 1.0) < 1e-9
    assert not centers.by_rates.all(axis=1).any()


def test_cylinders_hold_nothing_and_leave_the_centers_alone() -> None:
    joints = [Strut('cylinder', 'ground', 0.1 - 0.2j, 'coupler', 0.3 + 0.3j), *four_bar()]
    start = {'cylinder': abs(0.2 + 0.5j), 'cylinder.angle': float(np.angle(0.2 + 0.5j))}
    mechanism = linkage(joints, 'cylinder', start=start)
    values = mechanism.sweep(start['cylinder'] + np.linspace(-0.02, 0, 5)).values[0]
    centers = instant_centers(mechanism, values)
    assert not centers.by_rates.any()
    assert 'cylinder' not in ' '.join(explain(mechanism, centers.steps))
    assert apart(centers.places, centers_by_rates(mechanism, values), 1.0) < 1e-9


def test_kennedy_holds_at_a_dead_point_where_the_drivers_tell_nothing() -> None:
    # No link turns round: the driven one has limits, where coupler and rocker are in line.
    mechanism = linkage(four_bar({'O': 0, 'A': 0.3 + 0.05j, 'B': 0.35 + 0.2j, 'C': 0.4}), 'crank')
    limit = mechanism.path(-7.0, 7.0).dead_points[-1]
    assert limit.turns_back
    values = limit.values[:, None]
    centers = instant_centers(mechanism, values)
    assert not centers.by_rates.any()
    assert np.isnan(centers_by_rates(mechanism, values)).all()
    # The driven link stands still, and the coupler turns about the pin on it.
    a = np.exp(1j * values[0, 0]) * (0.3 + 0.05j)
    assert centers.points[centers.row('coupler', 'ground'), 0] == pytest.approx(a, abs=1e-6)
    assert centers.points[centers.row('rocker', 'crank'), 0] == pytest.approx(0.4, abs=1e-6)


def test_bodies_that_move_alike_have_no_center_by_the_rates() -> None:
    joints = [pin('O', 'ground', 'upper', 0), pin('A', 'upper', 'lower', 0.3)]
    # The variables are the angles of both: at equal rates they move as one.
    mechanism = linkage(joints, 'upper', 'lower')
    values = np.array([[0.2, 0.5], [0.4, 0.1]])
    alike = centers_by_rates(mechanism, values, np.array([1.0, 1.0]))
    pairs = _pairs(3)
    assert np.isnan(alike[:, pairs.index((1, 2))]).all()
    assert np.isfinite(alike[:, pairs.index((0, 2))]).all()
    # At opposite rates the lower one turns about a point on the line of the upper.
    opposite = centers_by_rates(mechanism, values, np.array([[1.0, 1.0], [-1.0, 2.0]]))
    place = opposite[0, 1] + 1j * opposite[1, 1]
    assert place == pytest.approx(np.exp(1j * values[0]) * 0.3 * np.array([2.0, 0.5]))
    with pytest.raises(LinkageError, match='rates of the 2 drivers: give them'):
        instant_centers(mechanism, values)


def test_unknown_bodies_are_refused_in_one_line() -> None:
    mechanism, values = swept('four-bar', 3)
    centers = instant_centers(mechanism, values)
    with pytest.raises(LinkageError, match='no body piston: name one of ground, crank'):
        centers.row('piston', 'ground')
    with pytest.raises(LinkageError, match='no center with itself'):
        centers.row('crank', 'crank')


@given(
    name=st.sampled_from([name for name in LINKAGES if name != 'eight-bar']),
    turn=st.floats(-3, 3),
    scale=st.floats(1e-3, 1e3),
    shift=st.complex_numbers(max_magnitude=5),
    order=st.randoms(use_true_random=False),
)
def test_centers_turn_move_and_scale_with_the_linkage_whatever_its_names(
    name: str, turn: float, scale: float, shift: complex, order: Any
) -> None:
    joints, high = LINKAGES[name]
    factor = scale * np.exp(1j * turn)
    bodies = list(dict.fromkeys(b for j in joints for b in (j.one, j.other) if b != 'ground'))
    new = dict(zip(bodies, [f'link_{k}' for k in range(len(bodies))], strict=True))
    new['ground'] = 'ground'
    moved: list[Joint] = []
    for joint in joints:
        changed = joint.changed(
            one=new[joint.one],
            other=new[joint.other],
            # Only the ground's frame stays where it is.
            a=factor * joint.a + shift,
            b=factor * joint.b + shift,
        )
        moved.append(
            changed.changed(along=joint.along + turn) if isinstance(joint, Slot) else changed
        )
    first = joints[0].other
    order.shuffle(moved)
    at = np.linspace(0.05, 0.95 * high, 12)
    before, after = linkage(joints, first), linkage(moved, new[first])
    one = by_name(instant_centers(before, before.sweep(at).values[0]))
    other = by_name(instant_centers(after, after.sweep(at).values[0]))
    for pair, places in one.items():
        x, y, w = places
        place = factor * (x + 1j * y) + w * shift
        expected = np.stack((place.real, place.imag, w))
        names = ' '.join(sorted(new[body] for body in pair.split()))
        assert apart(_near(expected, shift), _near(other[names], shift), scale) < 1e-7


def _near(places: Any, origin: complex) -> Any:
    """Places (3, T) seen from another origin."""
    x, y, w = places
    return np.stack((x - w * origin.real, y - w * origin.imag, w))


@pytest.mark.parametrize('name', ['four-bar', 'slider-crank', 'watt', 'eight-bar'])
def test_all_positions_are_evaluated_at_once(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    cross = _kennedy.cross

    def counted(one: Any, other: Any) -> Any:
        calls.append(one[0].shape[-1])
        return cross(one, other)

    mechanism, many = swept(name, 1000)
    steps = deduce(mechanism, many)
    monkeypatch.setattr(_kennedy, 'cross', counted)
    whole = kennedy_centers(mechanism, steps, many)
    needed = len(calls)
    single = kennedy_centers(mechanism, steps, many[:, 500:501])
    assert len(calls) == 2 * needed
    assert np.array_equal(np.isnan(whole[:, :, 500]), np.isnan(single[:, :, 0]))
    assert whole[:, :, 500] == pytest.approx(single[:, :, 0], rel=1e-9, abs=1e-9, nan_ok=True)


# What measured centers show.

PINS = np.array([0.1 + 0.2j, 0.5 - 0.1j])


def measured(
    noise: float, seed: int = 1, moved: complex = 0, count: int = 4000
) -> tuple[Any, Any, Any]:
    """Two bodies that turn about PINS, as measured: relative centers, covariance and their pins."""
    rng = np.random.default_rng(seed)
    arms, rates = np.array([0.2 + 0.1j, -0.1 + 0.25j]), np.array([2.0, -3.0])
    true = PINS + np.array([0, moved])
    position = np.zeros((2, 2, count), complex)
    angle = np.zeros((2, 2, count))
    position[0], position[1] = (true + arms)[:, None], (1j * rates * arms)[:, None]
    angle[1] = rates[:, None]
    position[1] += noise * (rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count)))
    angle[1] += 5 * noise * rng.normal(size=(2, count))
    spread, turns = np.zeros((2, 2, count)), np.zeros((2, 2, count))
    spread[1, 1], turns[1, 1] = noise**2, (5 * noise) ** 2
    by_j, by_i = relative_pole(position[:, 1], angle[:, 1], position[:, 0], angle[:, 0])
    total = covariance(by_j, spread, turns) + covariance(by_i, spread, turns)
    return by_j.value, total, true


def test_residual_of_pins_and_a_measured_center_is_as_large_as_its_noise_says() -> None:
    noise = 1e-3
    between, spread, pins = measured(noise)
    # The pins are known from elsewhere, with an error of their own.
    rng = np.random.default_rng(2)
    off = 2e-4 * (rng.normal(size=(2, 4000)) + 1j * rng.normal(size=(2, 4000)))
    centers = np.stack((*(pins[:, None] + off), between))
    share = np.broadcast_to(4e-8 * np.eye(2), (4000, 2, 2))
    distance, deviations = kennedy_residual(centers, np.stack((share, share, spread)))
    assert np.sqrt((deviations**2).mean()) == pytest.approx(1, abs=0.05)
    assert 1e-4 < np.abs(distance).mean() < 1e-3


def test_residual_shows_a_pin_that_was_moved_across_and_not_one_moved_along() -> None:
    # The second pin has moved since; its old place is still believed.
    normal = 1j * (PINS[1] - PINS[0]) / abs(PINS[1] - PINS[0])
    between, spread, _ = measured(1e-4, moved=0.01 * normal)
    pins = np.broadcast_to(PINS[:, None], (2, 4000))
    exact = np.zeros((4000, 2, 2))
    distance, deviations = kennedy_residual(
        np.stack((*pins, between)), np.stack((exact, exact, spread))
    )
    # By the weights of the rates: -3 / (-3 - 2) of the way the pin moved.
    assert distance.mean() == pytest.approx(0.006, rel=0.01)
    assert np.abs(deviations).min() > 10
    # Along the line it is blind.
    along = -1j * normal
    between, spread, _ = measured(1e-4, moved=0.01 * along)
    _, deviations = kennedy_residual(np.stack((*pins, between)), np.stack((exact, exact, spread)))
    assert np.sqrt((deviations**2).mean()) < 1.2


def test_residual_of_centers_of_one_set_of_velocities_is_zero_whatever_these_are() -> None:
    # What the docstring warns of: random motions of three bodies, no mechanism at all.
    rng = np.random.default_rng(3)
    position = rng.normal(size=(2, 3, 50)) + 1j * rng.normal(size=(2, 3, 50))
    angle = rng.normal(size=(2, 3, 50))
    centers = [
        relative_pole(position[:, j], angle[:, j], position[:, i], angle[:, i])[0].value
        for i, j in ((0, 2), (1, 2), (0, 1))
    ]
    distance, _ = kennedy_residual(np.array(centers), np.ones((3, 50, 1, 1)) * np.eye(2))
    assert distance / np.abs(centers).max(axis=0) == pytest.approx(0, abs=1e-9)


@given(
    places=st.lists(st.complex_numbers(max_magnitude=10), min_size=3, max_size=3),
    turn=st.floats(-3, 3),
    shift=st.complex_numbers(max_magnitude=10),
)
def test_residual_turns_and_moves_with_the_plane(
    places: list[complex], turn: float, shift: complex
) -> None:
    rng = np.random.default_rng(4)
    roots = rng.normal(size=(3, 2, 2))
    spread = roots @ roots.swapaxes(1, 2)
    places = [*np.array(places) + [0, 20, 0]]
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    before = kennedy_residual(np.array(places), spread)
    after = kennedy_residual(
        np.exp(1j * turn) * np.array(places) + shift, matrix @ spread @ matrix.T
    )
    assert after == pytest.approx(before, rel=1e-9, abs=1e-12)


def test_residual_says_nothing_without_a_line() -> None:
    distance, deviations = kennedy_residual(np.array([1j, 1j, 2.0]), np.tile(np.eye(2), (3, 1, 1)))
    assert np.isnan(distance)
    assert np.isnan(deviations)
