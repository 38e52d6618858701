"""The engine of linkages against 50-digit arithmetic, closed forms, and where it loses its rank."""

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from kinpole_ros.mechanism import _mechanism, rotation_derivatives
from kinpole_ros.mechanism._assembly import assemble
from kinpole_ros.mechanism._dead_points import unit_input
from kinpole_ros.mechanism._joint_kinds import Joint, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._laws import constant_rate, sine, smooth_step, table
from kinpole_ros.mechanism._loop_closure import solve
from kinpole_ros.mechanism._loops import LinkageError, loop_jacobian
from kinpole_ros.mechanism._mechanism import Driver, Mechanism
from kinpole_ros.mechanism._start import mobility

G = 'ground'
DIGITS = 50


def mechanism(joints: list[Joint], motion: Callable, drive: str, **start: float) -> Mechanism:
    """A linkage of these joints, `drive` driven by `motion`."""
    bodies = [b for b in dict.fromkeys(b for j in joints for b in (j.one, j.other)) if b != G]
    assembly = assemble(bodies, joints)
    names = assembly.loops.variables
    row = np.array([float(name == drive) for name in names])
    at = {drive: float(motion(np.zeros(()))[0]), **start}
    return Mechanism(
        assembly, (Driver(drive, row, motion),), np.array([at.get(name, 0.0) for name in names])
    )


def four_bar(ground: float, crank: float, coupler: float, rocker: float) -> list[Joint]:
    return [
        Revolute('O', G, 0j, 'crank', 0j),
        Revolute('A', 'crank', crank + 0j, 'coupler', 0j),
        Revolute('C', G, ground + 0j, 'rocker', 0j),
        Revolute('B', 'coupler', coupler + 0j, 'rocker', rocker + 0j),
    ]


def slider_crank(crank: float, rod: float, offset: float = 0.0) -> list[Joint]:
    return [
        Revolute('O', G, 0j, 'crank', 0j),
        Revolute('A', 'crank', crank + 0j, 'rod', 0j),
        Slot('piston', G, 1j * offset, 'rod', rod + 0j, 0.0),
    ]


def value(motion: Mechanism, t: object, name: str) -> np.ndarray:
    """A variable and its derivatives, (5, ...)."""
    return motion.motion(t).values[:, motion.assembly.loops.variables.index(name)]


# Against positions in 50 digits


def solved(motion: Mechanism, t: object, near: np.ndarray) -> mp.matrix:
    """
    All variables at the time t (mpf) in DIGITS digits: loops, ties and the driver by Newton's
    method from `near`, written here once more, in mpmath.
    """
    loops = motion.assembly.loops
    (driver,) = motion.drivers
    count = len(loops.variables)
    # Constant rate: exact in any arithmetic.
    start, rate = (mp.mpf(float(x)) for x in driver.motion(np.zeros(()))[:2])
    u = mp.matrix([mp.mpf(float(x)) for x in near])

    def numbers(array: np.ndarray) -> list:
        return [[mp.mpf(float(x)) for x in row] for row in np.atleast_2d(array)]

    lengths, angles, signs = numbers(loops.lengths), numbers(loops.angles), loops.loops
    length0, angle0 = numbers(loops.length0)[0], numbers(loops.angle0)[0]
    ties, tie0 = numbers(loops.ties) if len(loops.ties) else [], loops.tie0
    for _ in range(12):
        gap, matrix = [], []
        for row, right in zip(ties, tie0, strict=True):
            gap.append(mp.fdot(row, u) - mp.mpf(float(right)))
            matrix.append(row)
        gap.append(mp.fdot(numbers(driver.row)[0], u) - start - rate * t)
        matrix.append(numbers(driver.row)[0])
        for loop in signs:
            total, by = mp.mpc(0), [mp.mpc(0)] * count
            for k in np.flatnonzero(loop):
                size = mp.fdot(lengths[k], u) + length0[k]
                turn = loop[k] * mp.expj(mp.fdot(angles[k], u) + angle0[k])
                total += size * turn
                for n in range(count):
                    by[n] += (lengths[k][n] + 1j * size * angles[k][n]) * turn
            gap += [total.real, total.imag]
            matrix += [[b.real for b in by], [b.imag for b in by]]
        step = mp.lu_solve(mp.matrix(matrix), -mp.matrix(gap))
        u += step
        if mp.norm(step) < mp.mpf(10) ** (-DIGITS + 5):
            break
    return u


def by_differences(motion: Mechanism, t: float) -> np.ndarray:
    """Derivatives (5, n) of the variables by central differences of positions in DIGITS digits."""
    with mp.workdps(DIGITS):
        h, near = mp.mpf(10) ** -5, motion.motion(t).values[0]
        points = {k: solved(motion, mp.mpf(t) + k * h, near) for k in range(-4, 5)}
        # Weights of nine points, exact for polynomials of degree 8: errors of h^4 at the worst.
        powers = mp.matrix([[mp.mpf(k) ** n for k in points] for n in range(9)])
        rows = []
        for order in range(5):
            right = mp.matrix([mp.factorial(n) if n == order else 0 for n in range(9)])
            weights = mp.lu_solve(powers, right)
            rows.append(
                [
                    mp.fsum(w * p[n] for w, p in zip(weights, points.values(), strict=True))
                    / h**order
                    for n in range(len(near))
                ]
            )
        return np.array([[float(x) for x in row] for row in rows])


def agree(motion: Mechanism, t: float) -> None:
    found = motion.motion(t)
    expected = by_differences(motion, t)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found.values - expected) <= 1e-9 * np.maximum(scale, 1e-3)).all()


lengths = st.floats(0.2, 1.0)


@settings(max_examples=8)
@given(st.floats(0.05, 0.15), lengths, lengths, lengths, st.floats(0.0, 1.0), st.floats(0.5, 3))
def test_four_bar_derivatives_are_those_of_50_digit_positions(
    crank: float, ground: float, coupler: float, rocker: float, t: float, rate: float
) -> None:
    sides = sorted((ground, coupler, rocker))
    assume(crank + sides[2] < 0.95 * (sides[0] + sides[1]))
    motion = mechanism(
        four_bar(ground, crank, coupler, rocker),
        constant_rate(rate, 0.3),
        'crank',
        coupler=0.8,
        rocker=1.6,
    )
    agree(motion, t)


@settings(max_examples=6)
@given(st.floats(0.05, 0.15), st.floats(0.3, 0.8), st.floats(-0.1, 0.1), st.floats(0.0, 2.0))
def test_slider_crank_derivatives_are_those_of_50_digit_positions(
    crank: float, rod: float, offset: float, t: float
) -> None:
    joints = slider_crank(crank, rod, offset)
    agree(mechanism(joints, constant_rate(2.0, 0.3), 'crank', piston=rod), t)


def six_bar(lever: float, rod: float, point: complex, pivot: complex) -> list[Joint]:
    """A Stephenson six-bar: a dyad between the point of a four-bar's coupler and the ground."""
    return [
        *four_bar(0.3, 0.1, 0.28, 0.22),
        Revolute('D', 'coupler', point, 'rod', 0j),
        Revolute('F', G, pivot, 'lever', 0j),
        Revolute('E', 'rod', rod + 0j, 'lever', lever + 0j),
    ]


@settings(max_examples=4)
@given(st.floats(0.25, 0.35), st.floats(0.28, 0.36), st.floats(0.05, 0.12), st.floats(0.0, 3.0))
def test_six_bar_derivatives_are_those_of_50_digit_positions(
    lever: float, rod: float, height: float, t: float
) -> None:
    joints = six_bar(lever, rod, 0.15 + 1j * height, 0.5 + 0.15j)
    start = {'coupler': 0.8, 'rocker': 1.8, 'rod': 0.5, 'lever': 1.9}
    agree(mechanism(joints, constant_rate(2.0, 0.3), 'crank', **start), t)


def lifted_boom() -> list[Joint]:
    """A boom on its cylinder."""
    return [
        Revolute('O', G, 0j, 'boom', 0j),
        Strut('cylinder', G, 0.3 - 0.2j, 'boom', 0.5 + 0.1j),
    ]


@pytest.mark.parametrize('t', [0.0, 0.4])
def test_a_cylinder_a_planet_and_a_guide_are_as_exact(t: float) -> None:
    start = {'boom': 0.9, 'cylinder.angle': 1.8}
    agree(mechanism(lifted_boom(), constant_rate(0.1, 0.7), 'cylinder', **start), t)
    # The planet's rolling as a loop of its own, with an arm.
    planet: list[Joint] = [
        Revolute('O', G, 0j, 'arm', 0j),
        Revolute('P', 'arm', 0.3 + 0j, 'planet', 0j),
        Revolute('Q', 'planet', 0.05 + 0.02j, 'rod', 0j),
        Slot('slide', G, -0.8 + 0.1j, 'rod', 0.9 + 0j, 0.2),
    ]
    ring = Rolling('roll', G, 0j, 'planet', 0j, 0.1, circle=0.2)
    with_arm = mechanism([*planet, ring], constant_rate(1.0, 0.2), 'arm', rod=2.8, slide=0.3)
    found = with_arm.motion(t)
    arm, wheel = (found.angle[:, with_arm.bodies.index(b)] for b in ('arm', 'planet'))
    # (R + r) / r turns of the planet for each of the arm.
    np.testing.assert_allclose(wheel, 3 * arm, atol=1e-13)
    guided: list[Joint] = [
        *slider_crank(0.1, 0.4)[:2],
        Revolute('B', 'rod', 0.4 + 0j, 'block', 0j),
        Slot('guide', G, 0.05j, 'block', 0.02 + 0j, 0.1, turned=0.5),
    ]
    agree(mechanism(guided, constant_rate(2.0, 0.3), 'crank', guide=0.4, block=0.6), t)


# Dyads in closed form


def following_cylinder() -> list[Joint]:
    """A crank whose cylinder just follows: an angle and a length that turns with it."""
    return [
        Revolute('O', G, 0j, 'crank', 0j),
        Strut('cylinder', G, 0.5 + 0.1j, 'crank', 0.2 + 0.02j),
    ]


def quick_return(offset: float) -> list[Joint]:
    """The crank's pin in a slot of the lever."""
    return [
        Revolute('O', G, 0j, 'crank', 0j),
        Revolute('C', G, -0.3j, 'lever', 0j),
        Slot('slide', 'lever', 1j * offset, 'crank', 0.1 + 0j, 0.1),
    ]


@pytest.mark.parametrize(
    ('joints', 'drive', 'start', 'low', 'high'),
    [
        (four_bar(0.4, 0.12, 0.36, 0.28), 'crank', {'coupler': 0.8, 'rocker': 1.7}, -9, 9),
        (four_bar(0.4, 0.12, 0.36, 0.28), 'crank', {'coupler': -1, 'rocker': -2}, -9, 9),
        (four_bar(0.3, 0.4, 0.35, 0.38), 'crank', {'coupler': 0.2, 'rocker': 1.5}, 0, 6),
        (slider_crank(0.1, 0.3, 0.02), 'crank', {'piston': 0.4}, -9, 9),
        (slider_crank(0.1, 0.3), 'crank', {'piston': -0.3, 'rod': np.pi}, 0, 7),
        (quick_return(0.0), 'crank', {'lever': 1.5, 'slide': 0.3}, -9, 9),
        (quick_return(0.03), 'crank', {'lever': 1.5, 'slide': 0.3}, 0, 7),
        (quick_return(0.03), 'crank', {'lever': 4.6, 'slide': -0.3}, 0, 7),
        (following_cylinder(), 'crank', {'cylinder': 0.4, 'cylinder.angle': 2.5}, 0, 7),
        (lifted_boom(), 'cylinder', {'boom': 0.9, 'cylinder.angle': 1.8}, 0.45, 0.8),
        (
            six_bar(0.3, 0.32, 0.15 + 0.1j, 0.5 + 0.15j),
            'crank',
            {'coupler': 0.8, 'rocker': 1.8, 'rod': 0.5, 'lever': 1.9},
            0,
            7,
        ),
    ],
)
def test_loops_close_from_a_rough_guess(
    joints: list[Joint], drive: str, start: dict, low: float, high: float
) -> None:
    motion = mechanism(joints, constant_rate(1.0, (low + high) / 2), drive, **start)
    at = np.linspace(low, high, 500)
    found = motion.sweep(at)
    linkage = motion.linkage
    rows = list(linkage.unknown)
    # From a guess as far away as guesses may be.
    guess = found.values[0, rows] + np.random.default_rng(1).normal(0, 1e-3, (len(rows), len(at)))
    inputs = np.stack([at, np.ones_like(at), *np.zeros((3, len(at)))])[:, None]
    one = solve(linkage, inputs, guess)
    assert one.closed.all() and one.regular.all()
    gap, _ = loop_jacobian(linkage.loops, one.values[0])
    np.testing.assert_allclose(gap, 0.0, atol=1e-14)
    scale = np.abs(found.values).max(axis=(1, 2), keepdims=True, initial=1.0)
    np.testing.assert_allclose(one.values / scale, found.values / scale, atol=2e-12)


def test_a_linkage_keeps_to_the_side_and_the_turns_of_the_guess() -> None:
    motion = turning_four_bar()
    open_side = np.array([0.9, 1.7])
    inputs = unit_input(np.full(4, 0.3))
    turns = 2 * np.pi * np.array([0, 3, -2, 0])
    # The unknowns in the order of the linkage's variables: coupler, rocker.
    guess = np.stack([open_side[0] + turns, open_side[1] - turns])
    guess[:, 3] = -0.9, -1.7
    found = solve(motion.linkage, inputs, guess)
    assert found.closed.all()
    _, coupler, rocker = found.values[0]
    np.testing.assert_allclose(coupler[:3] - turns[:3], coupler[0], atol=1e-13)
    np.testing.assert_allclose(rocker[:3] + turns[:3], rocker[0], atol=1e-13)
    # Mirrored at the diagonal from crank pin to rocker pivot.
    diagonal = np.angle(0.4 - 0.12 * np.exp(0.3j))
    assert coupler[3] == pytest.approx(2 * diagonal - coupler[0])


def test_what_is_out_of_reach_does_not_close() -> None:
    reach = mechanism(
        four_bar(0.4, 0.3, 0.3, 0.2), constant_rate(1.0, 0.5), 'crank', coupler=0.8, rocker=1.7
    )
    far = solve(reach.linkage, unit_input(np.array([0.5, np.pi])), np.array([[0.8], [1.7]]))
    np.testing.assert_array_equal(far.closed, [True, False])
    assert np.isnan(far.values[:, :, 1]).all()


# Closed forms


def test_slider_crank_is_its_closed_form() -> None:
    crank, rod, rate = 0.1, 0.3, 2 * np.pi
    t = np.linspace(0, 3, 500)
    found = value(
        mechanism(slider_crank(crank, rod), constant_rate(rate, 0.5), 'crank', piston=0.4),
        t,
        'piston',
    )
    angle = rate * t + 0.5
    s, c = np.sin(angle), np.cos(angle)
    q = np.sqrt(rod**2 - (crank * s) ** 2)
    # x = r cos + q; q q' = -r² s c w, and so on.
    np.testing.assert_allclose(found[0], crank * c + q, rtol=1e-13)
    dq = -(crank**2) * s * c * rate / q
    np.testing.assert_allclose(found[1], -crank * s * rate + dq, atol=1e-10)
    ddq = (-(crank**2) * (c**2 - s**2) * rate**2 - dq**2) / q
    np.testing.assert_allclose(found[2], -crank * c * rate**2 + ddq, atol=1e-10 * rate**2)


def test_antiparallelogram_moves_on_ellipses() -> None:
    # Ground 0.2, cranks 0.4: they cross where the coupler turns about the ground, whose distances
    # from the two pins of either have a constant sum.
    joints = four_bar(0.2, 0.4, 0.2, 0.4)
    motion = mechanism(joints, sine(1.5, 1.0, 0.5, 0.0), 'crank', coupler=3.78, rocker=2.5)
    t = np.linspace(0.0, 2.0, 401)
    found = motion.motion(t)
    k = motion.bodies.index('coupler')
    z, turn = found.position[:, k], found.angle[:, k]
    moves = np.abs(turn[1]) > 1e-6
    pole = z[0] + 1j * z[1] / np.where(moves, turn[1], 1.0)
    np.testing.assert_allclose((np.abs(pole) + np.abs(pole - 0.2))[moves], 0.4, atol=1e-10)
    moving = (pole - z[0]) * np.exp(-1j * turn[0])
    np.testing.assert_allclose((np.abs(moving) + np.abs(moving - 0.2))[moves], 0.4, atol=1e-10)


def test_a_third_crank_that_changes_nothing_is_borne() -> None:
    # Gruebler counts no freedom; the rank leaves one.
    joints = [
        *four_bar(0.3, 0.1, 0.3, 0.1),
        Revolute('D', G, 0.15 + 0j, 'third', 0j),
        Revolute('E', 'coupler', 0.15 + 0j, 'third', 0.1 + 0j),
    ]
    motion = mechanism(joints, constant_rate(1.0, 0.5), 'crank', rocker=0.5, third=0.5)
    assert mobility(motion.assembly, motion.start) == (0, 1)
    found = motion.motion(np.linspace(0, 2, 50))
    np.testing.assert_allclose(found.angle[:, 2:], found.angle[:, :1].repeat(2, axis=1), atol=1e-12)
    np.testing.assert_allclose(found.angle[:, 1], 0.0, atol=1e-12)
    bent = [*joints[:-1], joints[-1].changed(b=0.11 + 0j)]
    with pytest.raises(LinkageError, match='do not close'):
        mechanism(bent, constant_rate(1.0, 0.5), 'crank', rocker=0.5, third=0.5).motion(0.0)


def test_a_loop_of_which_all_is_driven_is_held_against_its_closing() -> None:
    free = mechanism(four_bar(0.4, 0.1, 0.3, 0.25), constant_rate(1.0, 0.5), 'crank', rocker=1.5)
    closed = free.motion(0.0).values[0]
    for off in (0.0, 0.01):
        drivers = tuple(
            Driver(name, np.eye(3)[k], constant_rate(0.0, closed[k] + off * (k == 2)))
            for k, name in enumerate(free.bodies)
        )
        held = Mechanism(free.assembly, drivers, closed)
        if not off:
            np.testing.assert_allclose(held.motion(0.0).angle[0], closed, atol=1e-14)
            continue
        with pytest.raises(LinkageError, match='the loops do not close with'):
            held.motion(0.0)


# Dead points


def test_change_points_of_a_four_bar_are_found_and_passed() -> None:
    # 0.4 + 0.1 = 0.3 + 0.2: all in one line once a turn.
    motion = mechanism(
        four_bar(0.4, 0.1, 0.3, 0.2), constant_rate(1.0, 1.0), 'crank', coupler=0.7, rocker=1.9
    )
    (dead,) = motion.path(1.0, 1.0 + 2 * np.pi).dead_points
    assert dead.at == pytest.approx(np.pi, abs=1e-9)
    np.testing.assert_allclose(dead.values, [np.pi, 0.0, np.pi], atol=1e-9)
    assert not dead.turns_back
    assert set(dead.moving) == {'coupler', 'rocker'}
    assert dead.loop == ('O', 'A', 'B', 'C')
    at = np.pi + np.array([-1e-3, -1e-5, 1e-5, 1e-3])
    found = motion.sweep(at)
    assert found.regular.all()
    gap = 0.1 * np.exp(1j * at) + 0.3 * np.exp(1j * found.angle[0, 1])
    gap -= 0.4 + 0.2 * np.exp(1j * found.angle[0, 2])
    assert np.abs(gap).max() < 1e-15
    # Smooth through it: the rates on both sides are those of one branch.
    rates = found.angle[1, 1:]
    np.testing.assert_allclose(rates[:, 1], rates[:, 2], rtol=1e-4)


def test_right_in_a_change_point_there_are_no_rates() -> None:
    motion = mechanism(
        four_bar(0.4, 0.1, 0.3, 0.2), constant_rate(1.0, 1.0), 'crank', coupler=0.7, rocker=1.9
    )
    found = motion.sweep(np.pi + np.array([0.0, 1e-9, 1e-7]))
    assert not found.regular.any()
    assert np.isnan(found.angle[1:, 1:]).all()
    np.testing.assert_allclose(found.values[0], [[np.pi], [0.0], [np.pi]] * np.ones(3), atol=1e-6)


def test_derivatives_without_digits_are_told_from_those_with() -> None:
    # Around a change point of the antiparallelogram all derivatives are moderate and smooth.
    joints = four_bar(0.2, 0.4, 0.2, 0.4)
    motion = mechanism(joints, constant_rate(1.0, 1.5), 'crank', coupler=3.78, rocker=2.5)
    away = np.geomspace(1e-5, 0.3, 60)
    found = motion.sweep(np.pi + away)
    near = motion.sweep(np.pi + np.array([0.1]))
    assert found.regular.all()
    assert (np.diff(found.sound) >= 0).all()
    assert set(found.sound) == {2, 3, 4, 5}
    for k in range(1, 5):
        kept = found.values[k, 1:][:, found.sound > k]
        assert np.abs(kept).max() < 1.5 * np.abs(near.values[k, 1:]).max() + 0.05
    # The nearest that is kept agrees with 50 digits.
    first = float(away[found.sound > 4][0])
    exact = by_differences(motion, np.pi + first - 1.5)
    np.testing.assert_allclose(motion.motion(np.pi + first - 1.5).values, exact, atol=2e-3)
    # Next to a limit all are large, and right.
    limited = mechanism(slider_crank(0.1, 0.3), constant_rate(1.0, 0.21), 'piston', crank=1.2)
    limited.start[limited.assembly.loops.variables.index('rod')] = -0.3
    sweep = limited.sweep(0.4 - np.geomspace(1e-8, 1e-3, 20))
    assert (sweep.sound == 5).all()


@pytest.mark.parametrize(
    ('joints', 'drive', 'at', 'end', 'start', 'loop'),
    [
        (slider_crank(0.1, 0.3), 'piston', 0.4, 0.25, {}, 'piston, A, O'),
        (four_bar(0.4, 0.1, 0.3, 0.2), 'crank', np.pi, 4.0, {'rocker': np.pi}, 'O, A, B, C'),
        # Coupler and rocker in line: 0.3, 0.4, 0.5.
        (
            four_bar(0.4, 0.3, 0.3, 0.2),
            'crank',
            np.pi / 2,
            1.0,
            {'coupler': -0.6435, 'rocker': 2.4981},
            'O, A, B, C',
        ),
    ],
)
def test_a_start_in_a_dead_point_is_refused_not_left(
    joints: list[Joint], drive: str, at: float, end: float, start: dict, loop: str
) -> None:
    motion = mechanism(joints, smooth_step(at, end, 0.0, 1.0), drive, **start)
    with pytest.raises(LinkageError, match=f'is a dead point of the loop {loop}, from which'):
        motion.motion(np.linspace(0, 1, 5))


def test_a_dead_point_names_the_loop_that_has_it() -> None:
    # The lever is too short for the rod to pass.
    joints = six_bar(0.1, 0.3, 0.15 + 0.1j, 0.5 + 0.15j)
    start = {'coupler': 0.8, 'rocker': 1.8, 'rod': 0.5, 'lever': 1.9}
    path = mechanism(joints, constant_rate(1.0, 0.3), 'crank', **start).path(-7.0, 7.0)
    assert len(path.dead_points) == 2
    for dead in path.dead_points:
        assert dead.turns_back and {'D', 'E', 'F'} <= set(dead.loop)
        assert set(dead.moving) == {'rod', 'lever'}


@pytest.mark.parametrize(
    ('joints', 'drive', 'start', 'low', 'high', 'moving'),
    [
        (slider_crank(0.1, 0.3), 'piston', {'crank': 1.2, 'rod': -0.3}, 0.2, 0.4, {'crank', 'rod'}),
        (
            [
                Slot('a', G, 0j, 'rod', -0.15 + 0j, np.pi / 2),
                Slot('b', G, 0j, 'rod', 0.15 + 0j, 0.0),
            ],
            'b',
            {'rod': 0.8, 'a': -0.2},
            -0.3,
            0.3,
            {'rod', 'a'},
        ),
    ],
    ids=['slider-crank', 'folding trammel'],
)
def test_limits_of_a_slide_are_dead_points(
    joints: list[Joint], drive: str, start: dict, low: float, high: float, moving: set
) -> None:
    motion = mechanism(joints, constant_rate(1.0, 0.21), drive, **start)
    path = motion.path(-1.0, 1.0)
    assert [dead.at for dead in path.dead_points] == pytest.approx([low, high], abs=1e-9)
    assert all(dead.turns_back and set(dead.moving) == moving for dead in path.dead_points)
    near = motion.sweep(np.array([low + 1e-6, high - 1e-6]))
    np.testing.assert_allclose(near.values[1, motion.assembly.loops.variables.index(drive)], 1.0)
    assert np.isfinite(near.values).all()
    with pytest.raises(
        LinkageError, match=r'cannot follow its drivers.*it turns back at .* and .* m: '
    ):
        motion.sweep(np.array([high + 1e-6]))
    with pytest.raises(LinkageError, match=r'cannot follow its drivers at 0\.5 s'):
        motion.motion([0.0, 0.5])


# Many positions, many turns


def turning_four_bar() -> Mechanism:
    """A crank-rocker at 1 rev/s."""
    return mechanism(
        four_bar(0.4, 0.12, 0.36, 0.28),
        constant_rate(2 * np.pi, 0.0),
        'crank',
        coupler=0.8,
        rocker=1.7,
    )


def test_chunks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = turning_four_bar()
    t = np.random.default_rng(0).uniform(-3, 3, (7, 30))
    whole = motion.motion(t)
    monkeypatch.setattr(_mechanism, '_CHUNK', 16)
    parts = motion.motion(t)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    assert whole.position.shape == (5, 3, 7, 30)


def test_fewer_orders_are_the_same_numbers() -> None:
    motion = mechanism(slider_crank(0.1, 0.3), constant_rate(2.0, 0.3), 'crank', piston=0.4)
    t = np.linspace(0, 5, 100)
    whole, some = motion.motion(t), motion.motion(t, orders=3)
    for one, other in zip(whole[:3], some[:3], strict=True):
        np.testing.assert_array_equal(one[:3], other)


def test_a_thousand_turns_keep_to_the_branch() -> None:
    motion = turning_four_bar()
    one, many = motion.motion(0.3), motion.motion(1000.3)
    np.testing.assert_allclose(many.angle[0, 1:], one.angle[0, 1:], atol=1e-11)
    np.testing.assert_allclose(many.angle[0, 0] - one.angle[0, 0], 2000 * np.pi, rtol=1e-15)
    assert len(motion.path(0.0, 1.0).inputs) < 200


def test_rates_hold_at_the_position_given_closed_or_not() -> None:
    motion = mechanism(
        four_bar(0.4, 0.12, 0.36, 0.28), constant_rate(1.0, 0.0), 'crank', coupler=0.8, rocker=1.7
    )
    open_position = np.array([[0.3], [0.9], [2.0]])
    velocity, turning = motion.unit_rates(open_position)[:2]
    arms = [0.12j * np.exp(0.3j), 0.36j * np.exp(0.9j), -0.28j * np.exp(2.0j)]
    rest = sum(w * arm for w, arm in zip(turning[0, :, 0], arms, strict=True))
    assert abs(rest) < 1e-15
    assert velocity[0, 1, 0] == pytest.approx(arms[0])


def test_solver_starts_from_the_unknowns_whatever_hangs_on_them() -> None:
    # The wheel's angle is three times the unknown one: no start for it.
    joints = [
        Revolute('O', G, 0j, 'arm', 0j),
        Revolute('P', 'arm', 0.3 + 0j, 'wheel', 0j),
        Rolling('roll', G, 0j, 'wheel', 0j, 0.1, circle=0.2),
    ]
    motion = mechanism(joints, constant_rate(1.0, 0.0), 'arm')
    at = np.linspace(0, 6, 13)
    np.testing.assert_allclose(motion.sweep(at).angle[0, 1], 3 * at, atol=1e-12)


def test_what_lies_in_memory_does_not_decide_whether_loops_close(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A trammel and behind it a rod whose slide is known last.
    joints: list[Joint] = [
        Slot('up', G, 0j, 'bar', 0j, np.pi / 2),
        Slot('right', G, 0j, 'bar', 0.3 + 0j, 0.0),
        Revolute('A', 'bar', 0.1 + 0j, 'rod', 0j),
        Slot('low', G, -0.2j, 'rod', 0.5 + 0j, 0.0),
    ]
    motion = mechanism(joints, constant_rate(1.0, 0.4), 'bar', right=0.27, up=-0.12, low=0.58)
    empty = np.empty

    def littered(shape: Any, dtype: Any = float) -> np.ndarray:
        made = empty(shape, dtype)
        if made.dtype.kind in 'fc':
            made[...] = np.nan
        return made

    monkeypatch.setattr(np, 'empty', littered)
    at = np.linspace(0.4, 1.2, 5)
    found = motion.sweep(at)
    np.testing.assert_allclose(found.position[0, 0], -0.3j * np.sin(at), atol=1e-14)
    end = found.position[0, 1] + 0.5 * np.exp(1j * found.angle[0, 1])
    np.testing.assert_allclose(end.imag, -0.2, atol=1e-14)


def test_a_wheel_that_only_others_roll_on_turns_for_good() -> None:
    # Its angle is in no loop, yet with equal wheels all is as before after a turn of it.
    joints: list[Joint] = [
        Revolute('Q', G, -0.1 + 0j, 'pinion', 0j),
        Rolling('teeth', 'pinion', 0j, 'crank', 0j, 0.05, circle=0.05),
        *four_bar(0.4, 0.12, 0.36, 0.28),
    ]
    motion = mechanism(joints, constant_rate(-1.0, 0.0), 'pinion', coupler=0.87, rocker=1.75)
    assert motion.path(0.0, 100.0).period == 2 * np.pi
    turned = motion.motion(np.array([0.1, 0.1 + 2000 * np.pi])).angle[0]
    np.testing.assert_allclose(np.exp(1j * turned[:, 1]), np.exp(1j * turned[:, 0]), atol=1e-11)


# Motions of drivers


@pytest.mark.parametrize(
    'motion',
    [
        constant_rate(-2.0, 0.4),
        sine(0.3, 0.2, 1.5, 0.7),
        smooth_step(0.5, 0.8, 0.25, 1.5),
        table([0.1, 0.5, 1.3, 1.9], [0.5, 0.7, 0.4, 0.45]),
    ],
    ids=['rate', 'sine', 'step', 'table'],
)
def test_each_order_of_a_drive_is_the_derivative_of_the_one_below(motion: Callable) -> None:
    t = np.linspace(-0.313, 2.287, 41)
    h = 1e-4
    # Five points: errors of h^4, times ten derivatives' growth.
    between = [motion(t + k * h) for k in (-2, -1, 1, 2)]
    slope = (between[0] - 8 * between[1] + 8 * between[2] - between[3]) / (12 * h)
    exact = motion(t)
    scale = np.abs(exact).max(axis=1, keepdims=True)[1:] + 1
    np.testing.assert_allclose(slope[:4] / scale, exact[1:] / scale, atol=1e-8)


def test_steps_and_tables_stand_still_outside() -> None:
    step = smooth_step(0.5, 0.8, 0.25, 1.5)
    np.testing.assert_array_equal(step(np.array([-1.0, 0.25, 1.75, 9.0]))[0], [0.5, 0.5, 0.8, 0.8])
    assert not step(np.array([-1.0, 0.25, 1.75, 9.0]))[1:].any()
    times, values = [0.1, 0.5, 1.3, 1.9], [0.5, 0.7, 0.4, 0.45]
    through = table(times, values)
    np.testing.assert_allclose(through(np.array(times))[0], values, atol=1e-14)
    np.testing.assert_allclose(through(np.array([0.1, 1.9]))[1:3], 0.0, atol=1e-11)
    assert not through(np.array([0.0, 2.0]))[1:].any()
    np.testing.assert_allclose(through(np.array([0.0, 2.0]))[0], [0.5, 0.45], atol=1e-14)
    # The fourth derivative goes on across the inner times.
    before, after = (through(np.array([0.5, 1.3]) + shift) for shift in (-1e-9, 1e-9))
    np.testing.assert_allclose(before, after, rtol=1e-5, atol=1e-5)


def test_a_table_of_a_polynomial_is_that_polynomial() -> None:
    # Degree 5, at rest at both ends: 10 u³ - 15 u⁴ + 6 u⁵ through any of its values.
    u = np.array([0.0, 0.2, 0.35, 0.7, 1.0])
    rise = np.polynomial.Polynomial((0, 0, 0, 10, -15, 6))
    at = np.linspace(0, 1, 33)
    np.testing.assert_allclose(table(u, rise(u))(at)[0], rise(at), atol=1e-13)


def test_turning_terms_have_the_pole_matrices_for_derivatives() -> None:
    # An open chain has no loops: its end is a sum of turning terms alone.
    joints = [Revolute('O', G, 0j, 'arm', 0j), Revolute('A', 'arm', 0.5j, 'hand', 0.2 + 0j)]
    names = ('arm', 'hand')
    drivers = tuple(
        Driver(name, np.array([float(name == n) for n in names]), sine(0.1, a, f, 0.3))
        for name, a, f in (('arm', 0.7, 0.4), ('hand', 1.9, 0.9))
    )
    motion = Mechanism(assemble(names, joints), drivers, np.zeros(2))
    t = np.linspace(0, 4, 50)
    found = motion.motion(t)
    arm, hand = (driver.motion(t) for driver in drivers)
    expected = 0.5j * rotation_derivatives(arm) - 0.2 * rotation_derivatives(hand)
    np.testing.assert_allclose(found.position[:, 1], expected, atol=1e-12)
