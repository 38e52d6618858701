"""Efforts and reactions of linkages against statics by hand, each other, and their symmetries."""

from collections.abc import Sequence

import numpy as np
import pytest
from hand_statics import Freed, balance, freed_reactions
from hypothesis import assume, example, given
from hypothesis import strategies as st

from kinpole_ros.mechanism import _equilibrium, load_scene
from kinpole_ros.mechanism._assembly import assemble
from kinpole_ros.mechanism._equilibrium import Statics, undetermined
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._loads import Force, Holder, Load, Torque
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Driver, Mechanism
from kinpole_ros.mechanism._transmission import advantage, holding

G = 9.80665
DEGREE = np.pi / 180


def driven(
    bodies: Sequence[str], joints: Sequence[Joint], drives: Sequence[str], start: dict[str, float]
) -> Mechanism:
    """Build a mechanism in which some variables, by name, are driven and held at their start."""
    assembly = assemble(bodies, joints)
    names = assembly.loops.variables
    first = np.array([start.get(name, 0.0) for name in names])
    drivers = []
    for name in drives:
        row = np.eye(len(names))[names.index(name)]

        def motion(t: np.ndarray, held: float = start.get(name, 0.0)) -> np.ndarray:
            values = np.zeros((5, *np.shape(t)))
            values[0] = held
            return values

        drivers.append(Driver(name, row, motion))
    return Mechanism(assembly, tuple(drivers), first)


def at_start(mechanism: Mechanism) -> np.ndarray:
    """Return the variables (n, 1) a mechanism is drawn with."""
    return mechanism.start[:, None]


def agree(one: Statics, two: Statics | Freed, tolerance: float = 1e-9) -> None:
    """Check that two sets of reactions are the same, relative to the largest, NaN for NaN."""
    size = max(np.nanmax(np.abs(one.along), initial=0), np.nanmax(np.abs(one.across), initial=0))
    torque = max(np.nanmax(np.abs(one.moment), initial=0), size)
    size = max(size, 1e-300)
    np.testing.assert_allclose(two.along, one.along, rtol=0, atol=tolerance * size)
    np.testing.assert_allclose(two.across, one.across, rtol=0, atol=tolerance * size)
    np.testing.assert_allclose(two.moment, one.moment, rtol=0, atol=tolerance * torque)
    most = max(np.nanmax(np.abs(one.effort), initial=0.0), size)
    np.testing.assert_allclose(two.effort, one.effort, rtol=0, atol=tolerance * most)
    np.testing.assert_array_equal(one.determined, two.determined)


def slider_crank(drive: str = 'crank') -> Mechanism:
    """Return a crank of 0.1 m, a rod of 0.3 m and a block guided along the x axis."""
    joints = [
        Revolute('O', GROUND, 0j, 'crank', 0j),
        Revolute('A', 'crank', 0.1, 'rod', 0j),
        Revolute('B', 'rod', 0.3, 'block', 0j),
        Slot('slide', GROUND, 0j, 'block', 0j, 0.0, 0.0),
    ]
    angle = np.arcsin(-0.1 * np.sin(0.5) / 0.3)
    slide = 0.1 * np.cos(0.5) + 0.3 * np.cos(angle)
    start = {'crank': 0.5, 'rod': angle, 'slide': slide}
    return driven(['crank', 'rod', 'block'], joints, [drive], start)


def four_bar() -> Mechanism:
    """Return a crank-rocker of 0.12, 0.36, 0.28 m on a ground of 0.4 m."""
    joints = [
        Revolute('O', GROUND, 0j, 'crank', 0j),
        Revolute('A', 'crank', 0.12, 'coupler', 0j),
        Revolute('B', 'coupler', 0.36, 'rocker', 0.28),
        Revolute('C', GROUND, 0.4, 'rocker', 0j),
    ]
    return driven(
        ['crank', 'coupler', 'rocker'], joints, ['crank'], {'coupler': 0.8, 'rocker': 1.7}
    )


def parallelogram(cranks: int) -> Mechanism:
    """Return equal cranks of 0.12 m on a coupler parallel to the ground."""
    joints: list[Joint] = []
    for k in range(cranks):
        joints.append(Revolute(f'O{k}', GROUND, 0.3 * k, f'c{k}', 0j))
        joints.append(Revolute(f'A{k}', 'coupler', 0.3 * k, f'c{k}', 0.12))
    bodies = [*(f'c{k}' for k in range(cranks)), 'coupler']
    return driven(bodies, joints, ['c0'], {f'c{k}': 0.5 for k in range(cranks)})


def test_lever_signs_are_those_of_what_the_ground_does() -> None:
    """A load down on the right is borne upward by the ground, and held by a torque to the left."""
    for swapped in (False, True):
        ends = ('lever', 0j, GROUND, 1j) if swapped else (GROUND, 1j, 'lever', 0j)
        lever = driven(['lever'], [Revolute('O', *ends)], ['lever'], {'lever': 0.0})
        loads = [Force('lever', 2.0 + 0j, -30j)]
        found = Statics(lever, at_start(lever), loads)
        assert found.effort[0, 0] == pytest.approx(60.0, rel=1e-14)
        assert found.force[0, 0] == pytest.approx(-30j if swapped else 30j, rel=1e-14)
        assert found.at[0, 0] == pytest.approx(1j)
        agree(found, freed_reactions(lever, at_start(lever), loads))


def test_slider_crank_closed_form() -> None:
    """Torque F r sin(φ + β) / cos β, side thrust F tan β and the rod's F / cos β hold all round."""
    mechanism = slider_crank()
    crank = np.linspace(0.0, 2 * np.pi, 100)
    values = mechanism.sweep(crank).values[0]
    loads = [Force('block', 0j, -50.0)]
    beta = np.arcsin(np.sin(crank) / 3)
    torque = -50 * 0.1 * np.sin(crank + beta) / np.cos(beta)
    found = Statics(mechanism, values, loads)
    np.testing.assert_allclose(found.effort[0], torque, rtol=0, atol=1e-12)
    np.testing.assert_allclose(Statics(mechanism, values, loads).effort[0], torque, atol=1e-12)
    # The rod pushes the block to the right and, from a pin above, down: the guide pushes up.
    np.testing.assert_allclose(found.force[2], 50 - 50j * np.tan(beta), atol=1e-11)
    np.testing.assert_allclose(found.across[3], 50 * np.tan(beta), atol=1e-11)
    np.testing.assert_allclose(found.moment, 0.0, atol=1e-11)
    agree(found, freed_reactions(mechanism, values, loads))


def test_a_guide_bears_the_moment_of_a_load_beside_it() -> None:
    """A force beside the pin of a guided block is a moment in the guide, of the opposite sign."""
    mechanism = slider_crank()
    values = at_start(mechanism)
    loads = [Force('block', 0.2j, 10.0), Torque('block', 3.0)]
    found = Statics(mechanism, values, loads)
    assert found.moment[3, 0] == pytest.approx(0.2 * 10.0 - 3.0, rel=1e-12)
    agree(found, freed_reactions(mechanism, values, loads))


def test_wheel_needs_friction_and_is_pressed_on() -> None:
    """A wheel held on a slope by a torque bears its weight by friction and a normal force."""
    slope = 0.3
    joint = Rolling('way', GROUND, 1 + 2j, 'wheel', 0.01j, 0.25, along=slope)
    for drive in ('wheel', 'way'):
        wheel = driven(['wheel'], [joint], [drive], {})
        loads = [Force('wheel', 0.01j, -100j)]
        found = Statics(wheel, at_start(wheel), loads)
        up = 100 * np.sin(slope)
        assert found.across[0, 0] == pytest.approx(100 * np.cos(slope), rel=1e-12)
        # A torque that turns it up the slope, which is to the right: by friction. Or a pull.
        assert found.effort[0, 0] == pytest.approx(-up * 0.25 if drive == 'wheel' else up)
        assert found.along[0, 0] == pytest.approx(up if drive == 'wheel' else 0.0, abs=1e-10)
        agree(found, freed_reactions(wheel, at_start(wheel), loads))


def test_strut_pushes_along_itself() -> None:
    """A cylinder that holds a lever pushes along its axis; its pins bear nothing else."""
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'lever', 0j),
        Strut('cylinder', GROUND, 1 - 1j, 'lever', 1.0 + 0j),
    ]
    start = {'cylinder': 1.0, 'cylinder.angle': np.pi / 2}
    lever = driven(['lever'], joints, ['cylinder'], start)
    loads = [Force('lever', 2.0 + 0j, -30j)]
    found = Statics(lever, at_start(lever), loads)
    assert found.effort[0, 0] == pytest.approx(60.0, rel=1e-12)
    assert found.force[1, 0] == pytest.approx(60j, rel=1e-12)
    assert found.force[0, 0] == pytest.approx(-30j, rel=1e-12)
    agree(found, freed_reactions(lever, at_start(lever), loads))


def test_four_bar_both_ways_all_round() -> None:
    """Multipliers and freed constraints agree to 1e-9, the power closes, and loads add up."""
    mechanism = four_bar()
    values = mechanism.sweep(np.linspace(0, 2 * np.pi, 200)).values[0]
    loads = [Force('coupler', 0.2 * np.exp(2j), 3 - 50j), Torque('rocker', np.linspace(-2, 2, 200))]
    found = Statics(mechanism, values, loads)
    agree(found, freed_reactions(mechanism, values, loads))
    total = Statics(mechanism, values, loads)
    np.testing.assert_allclose(total.effort, total.share.sum(axis=0), rtol=1e-14)
    np.testing.assert_allclose(total.effort, found.effort, rtol=1e-9, atol=1e-9)
    velocity, omega = mechanism.unit_rates(values)[:2]
    arm = 0.2 * np.exp(2j) * np.exp(1j * values[mechanism.bodies.index('coupler')])
    moving = velocity[0, 1] + 1j * omega[0, 1] * arm
    power = (np.conj(3 - 50j) * moving).real + np.linspace(-2, 2, 200) * omega[0, 2]
    np.testing.assert_allclose(total.effort[0], -power, rtol=0, atol=1e-12)


@pytest.mark.parametrize('most', [0, 500])
def test_batches_of_positions_change_nothing(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However few positions are solved at a time, forces are the same, with loads of each."""
    mechanism = slider_crank()
    values = mechanism.sweep(np.linspace(0.1, 3.0, 23)).values[0]
    loads = [Force('block', 0j, np.linspace(-50.0, 90.0, 23)), Torque('rod', 1.0)]
    whole = Statics(mechanism, values, loads)
    monkeypatch.setattr(_equilibrium, 'MOST_NUMBERS', most)
    agree(whole, Statics(mechanism, values, loads), 1e-13)


def test_no_rounding_is_left_of_forces_that_are_zero() -> None:
    """Loads on the ground pins of a linkage of eight bars need no effort at all, not 1e-15."""
    scene = load_scene('eight_bar')
    values = scene.mechanism.motion(np.linspace(0.0, 0.4, 5)).values[0]
    joints = scene.mechanism.assembly.joints
    loads = [Force(one.other, one.b, 12.0 - 7j) for one in joints if one.one == GROUND]
    found = Statics(scene.mechanism, values, loads)
    assert len(loads) > 1
    assert not found.share.any()
    assert not np.signbit(found.effort).any()


def test_each_position_is_solved_by_itself() -> None:
    """A position that closes nowhere, or is dead, leaves its neighbors' answers alone."""
    mechanism = slider_crank('slide')
    values = mechanism.sweep(np.linspace(0.25, 0.35, 5)).values[0]
    loads = [Force('block', 0j, -50.0), Torque('rod', 1.0)]
    alone = [Statics(mechanism, values[:, [k]], loads).force for k in range(5)]
    broken = values.copy()
    broken[:, 2] = np.nan
    found = Statics(mechanism, broken, loads)
    assert found.determined.tolist() == [True, True, False, True, True]
    assert undetermined(mechanism, broken[:, 2]) == (
        'the loops do not close here: no forces without a position',
    )
    assert undetermined(mechanism, broken[:, 1]) == ()
    assert np.isnan(found.force[:, 2]).all()
    for k in (0, 1, 3, 4):
        np.testing.assert_allclose(found.force[:, [k]], alone[k], rtol=1e-12)


def random_linkage(seed: int, turn: float = 0.0, scale: float = 1.0) -> Mechanism:
    """
    Return a crank with two or three dyads of any joints, some driven, all body angles zero.

    All body frames lie on the ground's, so a point is the same in all of them.
    """
    rng = np.random.default_rng(seed)
    bodies, joints, drives = ['b0'], [], ['b0']
    start: dict[str, float] = {}

    def place() -> complex:
        return complex(rng.uniform(-1, 1), rng.uniform(-1, 1)) * scale * np.exp(1j * turn)

    def way() -> float:
        return float(rng.uniform(-np.pi, np.pi)) + turn

    def pin(one: str, other: str) -> None:
        at = place()
        joints.append(Revolute(f'j{len(joints)}', one, at, other, at))

    pin(GROUND, 'b0')
    for _ in range(rng.integers(2, 4)):
        first, second = rng.choice([GROUND, *bodies], 2, replace=False).tolist()
        x, y = f'b{len(bodies)}', f'b{len(bodies) + 1}'
        name, at = f'j{len(joints)}', place()
        kind = rng.integers(6)
        if kind < 2:
            bodies += [x, y]
            pin(first, x)
            pin(x, y)
            if kind == 0:
                pin(second, y)
            else:
                joints.append(Slot(f'j{len(joints)}', second, at, y, at, way(), 0.0))
            continue
        bodies.append(x)
        if kind == 2:
            joints.append(Slot(name, first, at, x, at, way()))
            pin(second, x)
        elif kind == 3:
            far = place()
            joints.append(Strut(name, first, at, x, far))
            start |= {name: abs(far - at), f'{name}.angle': float(np.angle(far - at))}
            drives.append(name if rng.integers(2) else f'{name}.angle')
            pin(second, x)
        else:
            radius, along = rng.uniform(0.1, 0.5) * scale, way()
            wheel = Rolling(
                name, first, at, x, at + radius * np.exp(1j * along) * 1j, radius, along
            )
            if kind == 5:
                circle = rng.choice([-1.0, 1.0]) * rng.uniform(0.6, 1.2) * scale
                hub = at + (circle + radius) * np.exp(1j * along)
                wheel = Rolling(name, first, at, x, hub, radius, 0.0, circle, along)
                start[name] = along
            joints.append(wheel)
            if rng.integers(2):
                drives.append(name)
                continue
            slot = place()
            joints.append(Slot(f'j{len(joints)}', second, slot, x, slot, way()))
    return driven(bodies, joints, drives, start)


def random_loads(
    seed: int, mechanism: Mechanism, turn: float = 0.0, scale: float = 1.0
) -> list[Load]:
    """Return a force and a torque on each of the bodies."""
    rng = np.random.default_rng(seed + 1)
    loads: list[Load] = []
    for body in mechanism.bodies:
        point, force = rng.normal(size=(2, 2)) @ [1, 1j]
        both = np.exp(1j * turn)
        loads.append(Force(body, point * scale * both, force * both))
        loads.append(Torque(body, rng.normal() * scale))
    return loads


def well_posed(mechanism: Mechanism, loads: list[Load]) -> Statics:
    """Return the reactions, of linkages that are not next to a dead point only."""
    found = Statics(mechanism, at_start(mechanism), loads)
    assume(bool(found.determined.all()))
    assume(np.nanmax(np.abs(found.force), initial=0.0) < 300)
    return found


SEEDS = st.integers(0, 10**6)


@given(SEEDS)
def test_random_linkages_both_ways(seed: int) -> None:
    """Multipliers and freed constraints agree for any joints and loads, and so do the efforts."""
    mechanism = random_linkage(seed)
    loads = random_loads(seed, mechanism)
    found = well_posed(mechanism, loads)
    agree(found, freed_reactions(mechanism, at_start(mechanism), loads))


@given(SEEDS)
def test_every_body_is_in_equilibrium(seed: int) -> None:
    """Loads, reactions and efforts on each body add up to no force and no moment."""
    mechanism = random_linkage(seed)
    loads = random_loads(seed, mechanism)
    found = well_posed(mechanism, loads)
    force = dict.fromkeys((*mechanism.bodies, GROUND), 0j)
    moment = dict.fromkeys(force, 0.0)
    for load in loads:
        if isinstance(load, Force):
            force[load.body] += load.force
            moment[load.body] += (np.conj(load.point) * load.force).imag
        else:
            moment[load.body] += load.torque
    for k, joint in enumerate(mechanism.assembly.joints):
        for body, sign in ((joint.one, -1), (joint.other, 1)):
            force[body] += sign * found.force[k, 0]
            arm = (np.conj(found.at[k, 0]) * found.force[k, 0]).imag
            moment[body] += sign * (arm + found.moment[k, 0])
    for driver, effort in zip(mechanism.drivers, found.effort[:, 0], strict=True):
        name = mechanism.assembly.loops.variables[int(driver.row.argmax())]
        if name == 'b0':
            moment['b0'] += effort
            continue
        k, joint = next(
            (k, joint)
            for k, joint in enumerate(mechanism.assembly.joints)
            if name in (joint.name, f'{joint.name}.angle')
        )
        if name != joint.name or getattr(joint, 'circle', 0.0):
            # What turns a direction holds on to the ground, and pushes at the end of an arm.
            moment[joint.one] += effort
        if isinstance(joint, Rolling):
            push = effort * found.axis[k, 0]
            if joint.circle:
                push /= -(joint.circle + joint.radius)
            for body, sign in ((joint.one, -1), (joint.other, 1)):
                force[body] += sign * push
                moment[body] += sign * (np.conj(joint.b) * push).imag
    for body in mechanism.bodies:
        assert abs(force[body]) < 1e-9
        assert abs(moment[body]) < 1e-9


@given(SEEDS)
@example(510511)  # A set of loops that counts right and yet does not hold its unknowns.
def test_a_rod_too_many_leaves_open_what_both_ways_leave_open(seed: int) -> None:
    """With one more rod than needed both ways give the same figures, and none where none is."""
    plain = random_linkage(seed)
    rng = np.random.default_rng(seed + 2)
    one, other = rng.choice([GROUND, *plain.bodies], 2, replace=False).tolist()
    ends = rng.normal(size=(2, 2)) @ [1, 1j]
    joints = [
        *plain.assembly.joints,
        Revolute('p', one, ends[0], 'rod', ends[0]),
        Revolute('q', other, ends[1], 'rod', ends[1]),
    ]
    names = plain.assembly.loops.variables
    start = dict(zip(names, plain.start.tolist(), strict=True))
    drives = [names[int(driver.row.argmax())] for driver in plain.drivers]
    mechanism = driven([*plain.bodies, 'rod'], joints, drives, start)
    loads = [*random_loads(seed, plain), Force('rod', ends.mean(), 1j)]
    found = well_posed(mechanism, loads)
    assert not found.unique.all()
    # Across the rod's ends its own load is borne in any case.
    assert np.isfinite(found.across[-2:]).all()
    agree(found, freed_reactions(mechanism, at_start(mechanism), loads), 1e-8)
    (line,) = undetermined(mechanism, at_start(mechanism)[:, 0])
    assert line.startswith('overconstrained: ')


@given(SEEDS)
def test_loads_superpose(seed: int) -> None:
    """Reactions to all loads are the sums of those to each, and twice the load is twice of all."""
    mechanism = random_linkage(seed)
    loads = random_loads(seed, mechanism)
    whole = well_posed(mechanism, loads)
    values = at_start(mechanism)
    single = [Statics(mechanism, values, [load]) for load in loads]
    size = np.nanmax(np.abs(whole.force)) + 1
    np.testing.assert_allclose(sum(r.force for r in single), whole.force, atol=1e-10 * size)
    total = Statics(mechanism, values, loads)
    for k, one in enumerate(single):
        np.testing.assert_allclose(one.effort, total.share[k], atol=1e-9 * size)
    twice = Statics(mechanism, values, loads + loads)
    np.testing.assert_allclose(twice.force, 2 * whole.force, atol=1e-10 * size)


@given(SEEDS, st.floats(-3, 3), st.floats(0.1, 10))
def test_turned_and_scaled_scenes(seed: int, turn: float, scale: float) -> None:
    """Turn a scene and its forces turn along; draw it larger and only its torques grow."""
    mechanism = random_linkage(seed)
    found = well_posed(mechanism, random_loads(seed, mechanism))
    other = random_linkage(seed, turn, scale)
    loads = random_loads(seed, other, turn, scale)
    moved = Statics(other, at_start(other), loads)
    size = np.nanmax(np.abs(found.force)) + 1
    np.testing.assert_allclose(moved.force, found.force * np.exp(1j * turn), atol=1e-9 * size)
    np.testing.assert_allclose(moved.moment, found.moment * scale, atol=1e-9 * size * scale)


def test_mechanical_advantage_of_slider_crank() -> None:
    """The advantage is the closed form's, its inverse the other way, and the driver's torque."""
    mechanism = slider_crank()
    crank = np.linspace(0.3, 2.8, 30)
    values = mechanism.sweep(crank).values[0]
    beta = np.arcsin(np.sin(crank) / 3)
    push, turn = Force('block', 0j, -7.0), Torque('crank', 5.0)
    forward = advantage(mechanism, values, 'crank', push)
    # The block moves against x while the crank turns on.
    np.testing.assert_allclose(forward, np.cos(beta) / (0.1 * np.sin(crank + beta)), rtol=1e-11)
    np.testing.assert_allclose(advantage(mechanism, values, turn, push), forward, rtol=1e-12)
    np.testing.assert_allclose(advantage(mechanism, values, push, turn), 1 / forward, rtol=1e-12)
    effort = Statics(mechanism, values, [Force('block', 0j, 1.0)]).effort[0]
    np.testing.assert_allclose(1 / forward, effort, rtol=1e-11)


def test_advantage_at_a_toggle_is_infinite_and_its_inverse_zero() -> None:
    """With crank and rod in line the block stands still: no large number of rounding errors."""
    mechanism = slider_crank()
    values = mechanism.sweep(np.array([0.0, np.pi])).values[0]
    push = Force('block', 0j, 1.0)
    assert np.all(np.isposinf(advantage(mechanism, values, 'crank', push)))
    assert np.all(advantage(mechanism, values, push, 'crank') == 0)
    assert np.isnan(advantage(slider_crank('slide'), values, 'slide', Torque('crank', 1.0))).all()


def test_the_advantage_of_a_body_that_stands_but_for_printed_digits_is_infinite() -> None:
    """The lengths of exercise_seat have nine digits, so the seat turns with 5e-11 of the rate."""
    seat = load_scene('exercise_seat').mechanism
    values = seat.sweep(np.zeros(1)).values[0]
    assert np.isposinf(advantage(seat, values, 'link_2', Torque('link_3', 1.0)))


def test_advantage_with_several_drivers_names_the_mend() -> None:
    """With two drivers the motion between two ports is open, and the line says what to give."""
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'upper', 0j),
        Revolute('A', 'upper', 1.0, 'lower', 0j),
    ]
    arm = driven(['upper', 'lower'], joints, ['upper', 'lower'], {'upper': 0.4})
    tip = Force('lower', 1.0, 1j)
    with pytest.raises(LinkageError, match=r'2 drivers.*upper'):
        advantage(arm, at_start(arm), Torque('upper', 1.0), tip)
    with pytest.raises(LinkageError, match='2 drivers'):
        advantage(arm, at_start(arm), 'upper', 'lower')
    assert advantage(arm, at_start(arm), 'lower', tip)[0] == pytest.approx(1.0)
    with pytest.raises(LinkageError, match='no variable motor: there are crank'):
        advantage(slider_crank(), at_start(slider_crank()), 'motor', 'crank')
    with pytest.raises(LinkageError, match='direction'):
        advantage(slider_crank(), at_start(slider_crank()), 'crank', Force('block', 0j, 0.0))


@pytest.mark.parametrize('side', [0.2, 0.4])
def test_dead_points_of_the_slide_are_named(side: float) -> None:
    """At both limits the slide cannot hold the crank: no number, and a line with the joints."""
    mechanism = slider_crank('slide')
    values = np.array([0.0 if side > 0.3 else np.pi, 0.0, 0.0, side])[:, None]
    loads = [Torque('crank', 1.0)]
    for found in (
        Statics(mechanism, values, loads),
        freed_reactions(mechanism, values, loads),
    ):
        assert not found.determined.any()
        assert np.isnan(found.effort).all()
        assert np.isnan(found.force).all()
    assert np.isnan(Statics(mechanism, values, loads).effort).all()
    (line,) = undetermined(mechanism, values[:, 0])
    assert line.startswith('dead point of the loop of crank, rod, in the joints O, A, B')
    assert 'slide cannot hold it' in line


def test_next_to_a_dead_point_the_answer_is_right() -> None:
    """A thousandth of a radian from the limit the slide's effort is still the closed form's."""
    mechanism = slider_crank()
    crank = np.array([1e-3, np.pi - 1e-3])
    values = mechanism.sweep(crank).values[0]
    held = slider_crank('slide')
    found = Statics(held, values, [Torque('crank', -1.0)])
    beta = np.arcsin(np.sin(crank) / 3)
    push = -np.cos(beta) / (0.1 * np.sin(crank + beta))
    np.testing.assert_allclose(found.effort[0], push, rtol=1e-9)
    np.testing.assert_allclose(found.force[3].imag, -push * np.tan(beta), rtol=1e-9)


@pytest.mark.parametrize('name', ['loader_loop', 'loader_cylinder', 'slider_crank'])
def test_efforts_and_rates_have_one_limit_for_a_dead_point(name: str) -> None:
    """Over the whole range, to its limits, efforts are known where the rates are."""
    mechanism = load_scene(name).mechanism
    path = mechanism.path(-np.pi, np.pi)
    values = mechanism.sweep(np.linspace(path.inputs[0], path.inputs[-1], 361)).values[0]
    found = Statics(mechanism, values, [Torque(mechanism.bodies[-1], 1.0)])
    known = mechanism.rates(values).regular
    np.testing.assert_array_equal(np.isfinite(found.effort[0]), known)
    np.testing.assert_array_equal(found.determined, known)


def test_change_point_of_a_parallelogram_is_named() -> None:
    """Folded, a parallelogram can go on in two ways and crank effort is open; beside it is not."""
    mechanism = parallelogram(2)
    loads = [Force('coupler', 0.1, -100j)]
    folded = np.zeros((3, 1))
    found = Statics(mechanism, folded, loads)
    assert not found.determined.any()
    assert np.isnan(Statics(mechanism, folded, loads).effort).all()
    (line,) = undetermined(mechanism, folded[:, 0])
    assert line.startswith('dead point of the loop of c1, coupler')
    beside = np.array([0.01, 0.01, 0.0])[:, None]
    found = Statics(mechanism, beside, loads)
    assert found.effort[0, 0] == pytest.approx(12 * np.cos(0.01), rel=1e-9)
    assert undetermined(mechanism, beside[:, 0]) == ()


def test_overconstrained_linkage_says_which_reactions_are_open() -> None:
    """Three equal cranks share the load as stiffness has it; the effort is unique all the same."""
    mechanism = parallelogram(3)
    loads = [Force('coupler', 0.1, -100j), Torque('c2', 1.0)]
    found = Statics(mechanism, at_start(mechanism), loads)
    other = freed_reactions(mechanism, at_start(mechanism), loads)
    expected = 100 * 0.12 * np.cos(0.5) - 1
    for one in (found, other):
        assert one.determined.all()
        assert one.effort[0, 0] == pytest.approx(expected, rel=1e-10)
    # What no combination of cranks can tell is along the cranks; across one is what turns it.
    assert not found.unique.any()
    agree(found, other)
    (line,) = undetermined(mechanism, at_start(mechanism)[:, 0])
    assert line.startswith('overconstrained: the reactions in the joints O0, A0, O1, A1, O2, A2 ')
    assert 'the efforts are' in line


def test_beam_on_two_pins_bears_upward_what_can_be_told() -> None:
    """A beam between two pins: the upward shares are unique, the thrust between the pins is not."""
    joints = [Revolute('L', GROUND, 0j, 'beam', 0j), Revolute('R', GROUND, 3.0, 'beam', 3.0)]
    beam = driven(['beam'], joints, [], {})
    loads = [Force('beam', 1.0 + 0j, 5 - 30j)]
    for found in (
        Statics(beam, at_start(beam), loads),
        freed_reactions(beam, at_start(beam), loads),
    ):
        np.testing.assert_allclose(np.abs(found.axis), 1.0, rtol=1e-12)
        up = found.across[:, 0] * (1j * found.axis[:, 0]).imag
        np.testing.assert_allclose(up, [20.0, 10.0], rtol=1e-10)
        assert np.isnan(found.along).all()
        assert not found.unique.any()
    with pytest.raises(LinkageError, match='add a driver'):
        advantage(beam, at_start(beam), Torque('beam', 1.0), Torque('beam', 1.0))


def test_gears_on_an_arm_bear_by_their_teeth() -> None:
    """The arm already keeps gears apart: tooth force is unique, thrust between hubs is not."""
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'arm', 0j),
        Revolute('P', 'arm', 0.3, 'planet', 0j),
        Revolute('S', GROUND, 0j, 'sun', 0j),
        Rolling('teeth', 'sun', 0j, 'planet', 0j, 0.1, circle=0.2),
    ]
    train = driven(['arm', 'planet', 'sun'], joints, ['arm', 'sun'], {})
    loads = [Torque('planet', 5.0)]
    found = Statics(train, at_start(train), loads)
    # The planet's contact is at its left; teeth push it up there, against its torque.
    assert found.axis[3, 0] == pytest.approx(-1j)
    assert found.along[3, 0] == pytest.approx(-50.0, rel=1e-12)
    assert np.isnan(found.across[3, 0])
    assert found.effort[:, 0] == pytest.approx([-15.0, 10.0], rel=1e-12)
    agree(found, freed_reactions(train, at_start(train), loads))


@pytest.mark.parametrize('torque', [6.0, -6.0])
@pytest.mark.parametrize('turn', [0.0, 2.1])
def test_gears_with_a_pressure_angle_load_their_bearings(torque: float, turn: float) -> None:
    """Two gears on the ground bear T / r along their teeth, and its tangent across, both ways."""
    hubs, pressure = np.array([0.0, 0.3 * np.exp(1j * turn)]), 20 * DEGREE
    joints: list[Joint] = [
        Revolute('A', GROUND, hubs[0], 'pinion', 0j),
        Revolute('B', GROUND, hubs[1], 'gear', 0j),
        Rolling('teeth', 'pinion', 0j, 'gear', 0j, 0.2, circle=0.1, start=turn, pressure=pressure),
    ]
    train = driven(['pinion', 'gear'], joints, ['pinion'], {'teeth': turn})
    loads: list[Load] = [Torque('gear', torque)]
    found = Statics(train, at_start(train), loads)
    assert found.effort[0, 0] == pytest.approx(torque / 2, rel=1e-12)
    # The pinion holds the gear against its torque, and pushes it away.
    out = np.exp(1j * turn)
    tooth = (1j * torque / 0.2 + abs(torque) / 0.2 * np.tan(pressure)) * out
    assert found.force[2, 0] == pytest.approx(tooth, rel=1e-12)
    assert found.force[1, 0] == pytest.approx(-tooth, rel=1e-12)
    assert found.force[0, 0] == pytest.approx(tooth, rel=1e-12)
    assert abs(found.force[1, 0]) == pytest.approx(30 / np.cos(pressure), rel=1e-12)
    agree(found, freed_reactions(train, at_start(train), loads))
    assert undetermined(train, at_start(train)[:, 0]) == ()


def test_a_rack_with_a_pressure_angle_presses_on_its_guide() -> None:
    """The pinion's torque pulls the rack; its teeth press pinion and rack apart."""
    pressure = 14.5 * DEGREE
    joints: list[Joint] = [
        Revolute('H', GROUND, 0.05j, 'pinion', 0j),
        Slot('guide', GROUND, 0j, 'rack', 0j, 0.0, 0.0),
        Rolling('teeth', 'rack', 0j, 'pinion', 0j, 0.05, pressure=pressure),
    ]
    train = driven(['pinion', 'rack'], joints, ['guide'], {})
    loads: list[Load] = [Torque('pinion', 2.0), Force('rack', 0.03 - 0.01j, -3j)]
    found = Statics(train, at_start(train), loads)
    # Turning to the left the pinion, on top, would push the rack to the right.
    assert found.effort[0, 0] == pytest.approx(-40.0, rel=1e-12)
    apart = 40 * np.tan(pressure)
    assert found.force[2, 0] == pytest.approx(-40 + 1j * apart, rel=1e-12)
    assert found.force[0, 0] == pytest.approx(40 - 1j * apart, rel=1e-12)
    assert found.force[1, 0] == pytest.approx(1j * (apart + 3), rel=1e-12)
    assert found.moment[1, 0] == pytest.approx(0.03 * 3, rel=1e-12)
    agree(found, freed_reactions(train, at_start(train), loads))


def test_vectors_alone_have_efforts_but_no_reactions() -> None:
    """Of a linkage given as loops the efforts are found; reactions are refused with the mend."""
    mechanism = four_bar()
    values = mechanism.sweep(np.linspace(0, 6, 7)).values[0]
    loads = [Torque('rocker', 2.0)]
    bare = Mechanism(mechanism.assembly._replace(joints=()), mechanism.drivers, mechanism.start)
    expected = Statics(mechanism, values, loads).effort
    np.testing.assert_allclose(Statics(bare, values, loads).effort, expected, rtol=1e-12)
    assert undetermined(bare, values[:, 0]) == ()
    with pytest.raises(LinkageError, match='bodies and joints'):
        _ = Statics(bare, values, loads).force
    with pytest.raises(LinkageError, match='bodies and joints'):
        freed_reactions(bare, values, loads)


def test_load_on_a_body_that_is_not_there_is_named() -> None:
    """The line names the body and those there are; a load on the ground does nothing."""
    mechanism = four_bar()
    values = mechanism.sweep(np.array([0.3])).values[0]
    for way in (Statics, freed_reactions):
        with pytest.raises(LinkageError, match=r'bucket.*crank, coupler, rocker'):
            way(mechanism, values, [Torque('bucket', 1.0)])
        found = way(mechanism, values, [Force(GROUND, 1j, 5.0), Torque(GROUND, 2.0)])
        assert found.effort[0, 0] == 0


# Seed 003. Its page prints no figures for statics; each is found from the velocities it gives, and
# again with the linkage's constraints or the balance of forces.


def loader() -> Mechanism:
    """Seed 003, example 1: the Bobcat with the pivot where the given angles close the loop."""
    pivot = 1.41 * np.exp(45j * DEGREE) + 1.2 - 1j
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'r2', 0j),
        Revolute('A', 'r2', 1.41, 'r3', 0j),
        Revolute('B', 'r3', 1.2, 'r4', 0j),
        Revolute('C', GROUND, pivot, 'r4', 1.0 + 0j),
    ]
    return driven(['r2', 'r3', 'r4'], joints, ['r2'], {'r2': 45 * DEGREE, 'r4': -90 * DEGREE})


def test_seed_loader_lifts_a_tonne() -> None:
    """The torque at link 2: by the power balance by hand, by moments, and by both reactions."""
    mechanism, weight = loader(), 1000 * G
    rate = 0.5
    lifted = 1.41 * rate * np.cos(45 * DEGREE)
    third = -lifted / 1.2
    velocity = 1.41 * rate * 1j * np.exp(45j * DEGREE) + 2 * third * 1j * np.exp(135j * DEGREE)
    assert velocity == pytest.approx(0.08896 + 1.086j, rel=1e-3)
    torque = balance(rate, (-1j * weight, velocity))
    # Link 4 only pulls along itself, straight down; moments about A on link 3, about O on link 2.
    pull = weight * 2 * np.cos(45 * DEGREE) / 1.2
    assert torque == pytest.approx((weight + pull) * 1.41 * np.cos(45 * DEGREE), rel=1e-12)
    assert torque == pytest.approx(21300.245, rel=1e-7)
    loads = [Force('r3', 2 * np.exp(135j * DEGREE), -1j * weight)]
    found = Statics(mechanism, at_start(mechanism), loads)
    for effort in (
        found.effort,
        freed_reactions(mechanism, at_start(mechanism), loads).effort,
        Statics(mechanism, at_start(mechanism), loads).effort,
    ):
        assert effort[0, 0] == pytest.approx(float(torque), rel=1e-9)
    agree(found, freed_reactions(mechanism, at_start(mechanism), loads))
    assert found.force[3, 0] == pytest.approx(1j * -pull, rel=1e-9)


def test_seed_suspension_spring() -> None:
    """The spring pulls with 833 N: it grows longer by 0.75 m/s while the load moves up at 1.25."""
    velocity = 0.05 + 1.25j
    spring = balance(0.75, (500j, velocity))
    assert spring == pytest.approx(-2500 / 3, rel=1e-14)
    # A swing arm about the origin, with the axle where it moves as given.
    end, shock = 0.35 * np.exp((180 - 85.6) * 1j * DEGREE), 0.25 * np.exp(128.5j * DEGREE)
    along = shock / abs(shock)
    turning = 0.75 / (np.conj(along) * 1j * end).real
    axle = velocity / (1j * turning)
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'arm', 0j),
        Strut('r2', GROUND, end - shock, 'arm', end),
    ]
    start = {'r2': 0.25, 'r2.angle': 128.5 * DEGREE}
    arm = driven(['arm'], joints, ['r2'], start)
    loads = [Force('arm', axle, 500j)]
    found = Statics(arm, at_start(arm), loads)
    assert found.effort[0, 0] == pytest.approx(float(spring), rel=1e-9)
    agree(found, freed_reactions(arm, at_start(arm), loads))
    # Moments about the pivot.
    assert (np.conj(end) * along).imag * spring + axle.real * 500 == pytest.approx(0, abs=1e-9)


def test_seed_trebuchet() -> None:
    """The force across the bar at P that 100 kg on the vertical slider hold."""
    bar = np.exp(150j * DEGREE)
    rate = -2.5 / (2 * np.cos(30 * DEGREE))
    velocity = -2.5j + 5 * rate * 1j * bar
    assert velocity == pytest.approx(3.6075 + 3.7484j, rel=1e-3)
    across = 1j * bar
    force = balance((velocity * np.conj(across)).real, (-100j * G, -2.5j))
    # By hand: the guides bear at right angles to themselves, so where their lines cross they have
    # no moment; the weight's balances that of the force.
    center = complex(2 * bar.real, -1.0)
    weight = (np.conj(-1j - center) * -100j * G).imag
    other = (np.conj(-1j + 5 * bar - center) * across).imag
    assert force == pytest.approx(-weight / other, rel=1e-12)
    assert force == pytest.approx(485.3033, rel=1e-6)
    joints: list[Joint] = [
        Slot('r2', GROUND, 0j, 'bar', 0j, -90 * DEGREE),
        Slot('r1', GROUND, 0j, 'bar', 2 + 0j, 180 * DEGREE),
    ]
    start = {'bar': 150 * DEGREE, 'r2': 1.0, 'r1': 2 * np.cos(30 * DEGREE)}
    trebuchet = driven(['bar'], joints, ['r2'], start)
    port, load = Force('bar', 5 + 0j, across), Force('bar', 0j, -100j * G)
    here = at_start(trebuchet)
    found = Statics(trebuchet, here, [port, load])
    assert -found.share[1, 0, 0] / found.share[0, 0, 0] == pytest.approx(float(force), rel=1e-9)
    size, _ = holding(trebuchet, here, [load], Holder('bar', 5 + 0j, 90 * DEGREE, 'bar'))
    assert size[0] == pytest.approx(float(force), rel=1e-9)
    # With it, the slider needs no drive at all.
    held = Statics(trebuchet, here, [port._replace(force=across * force), load])
    assert held.effort[0, 0] == pytest.approx(0, abs=1e-9)
    agree(held, freed_reactions(trebuchet, here, [port._replace(force=across * force), load]))


def test_seed_exercise_machine() -> None:
    """The force to the left at P against 100 N cm of resistance at twice the handle's rate."""
    rpm = 2 * np.pi / 60
    velocity = 4.5 * 10 * rpm * 1j * np.exp(100j * DEGREE)
    force = balance(-velocity.real, (-1.0, 20 * rpm))
    assert force == pytest.approx(2 / (4.5 * np.sin(100 * DEGREE)), rel=1e-12)
    assert force == pytest.approx(0.4513, rel=1e-4)
    # Any linkage with these rates: parallel arms, one half as long.
    joints: list[Joint] = [
        Revolute('O', GROUND, 0j, 'handle', 0j),
        Revolute('A', 'handle', 2j, 'link', 0j),
        Revolute('B', 'link', 3 + 0j, 'wheel', 1j),
        Revolute('C', GROUND, 3 + 1j, 'wheel', 0j),
    ]
    machine = driven(['handle', 'link', 'wheel'], joints, ['handle'], {})
    loads: list[Load] = [
        Torque('wheel', -1.0),
        Force('handle', 4.5 * np.exp(100j * DEGREE), -float(force)),
    ]
    here = at_start(machine)
    assert machine.unit_rates(here)[1][0, 2, 0] == pytest.approx(2.0, rel=1e-12)
    for way in (Statics, freed_reactions):
        assert way(machine, here, loads).effort[0, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    'holder',
    [
        Holder('rocker'),
        Holder('coupler', 0.1 + 0.2j, 0.7),
        Holder('coupler', 0.1 + 0.2j, 0.7, 'crank'),
    ],
)
def test_what_holds_the_loads_leaves_nothing_to_the_driver(holder: Holder) -> None:
    mechanism = four_bar()
    values = mechanism.sweep(np.linspace(0.1, 2 * np.pi, 50)).values[0]
    loads = [Force('coupler', 0.2 * np.exp(2j), 3 - 50j), Torque('crank', 2.0)]
    size, held = holding(mechanism, values, loads, holder)
    assert np.isfinite(size).all()
    found = Statics(mechanism, values, [*loads, held])
    scale = np.abs(Statics(mechanism, values, loads).share).max()
    np.testing.assert_allclose(found.effort, 0.0, atol=1e-9 * scale)
    if isinstance(held, Force):
        seen = values[mechanism.bodies.index('crank')] if holder.of == 'crank' else 0.0
        np.testing.assert_allclose(held.force, size * np.exp(1j * (0.7 + seen)), rtol=1e-12)


def test_nothing_holds_where_it_does_not_move() -> None:
    mechanism = four_bar()
    loads = [Torque('crank', 2.0)]
    size, _ = holding(mechanism, at_start(mechanism), loads, Holder('crank', 0j, 0.0))
    assert np.isnan(size).all()
    two = driven(
        ['arm', 'hand'],
        [Revolute('O', GROUND, 0j, 'arm', 0j), Revolute('A', 'arm', 1j, 'hand', 0j)],
        ['arm', 'hand'],
        {},
    )
    with pytest.raises(LinkageError, match='2 drivers cannot be replaced by what holds hand'):
        holding(two, at_start(two), [Torque('arm', 1.0)], Holder('hand'))


def test_balance_of_velocities_knows_when_there_is_none() -> None:
    """A port that stands still balances nothing; loads of both kinds add up."""
    assert np.isnan(balance(0.0, (1.0, 2.0)))
    found = balance(np.array([2.0, -4.0]), (3 + 4j, 1 + 1j), (2.0, 0.5))
    np.testing.assert_allclose(found, [-4.0, 2.0])
