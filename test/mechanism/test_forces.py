"""Springs and inertia: by hand, by energy, in equilibrium, and with the plane they lie in."""

import numpy as np
import pytest
from hand_statics import freed_reactions

from kinpole_ros.mechanism import (
    Force,
    Load,
    Motion,
    Scene,
    Statics,
    load_scene,
    poles,
    transmission_angles,
)
from kinpole_ros.mechanism._loads import inertial_loads, spring_loads


def acting(scene: Scene, motion: Motion) -> list[Load]:
    """All that acts on a scene in a motion."""
    springs = spring_loads(scene.mechanism, motion.values[0], scene.springs)
    return [*scene.loads, *springs, *inertial_loads(scene.mechanism, motion, scene.masses)]


def solved(scene: Scene, times: np.ndarray) -> tuple[Motion, list[Load]]:
    motion = scene.mechanism.motion(times)
    return motion, acting(scene, motion)


LINKAGE = """
bodies:
  ground:  {{O: {o}, C: {c}, S: {s}}}
  crank:   {{O: [0, 0], A: [{size} m, 0]}}
  coupler: {{A: [0, 0], B: [{coupler} m, 0], P: [{size} m, {size} m]}}
  rocker:  {{C: [0, 0], B: [{rocker} m, 0]}}
drivers:
  - {{drive: crank, mean: {mean} rad, amplitude: 0.8, frequency: 1.5 Hz, phase: 0.3}}
start: {{coupler: {start} rad, rocker: {rocker_start} rad}}
loads:
  - {{force: {force}, at: coupler.P}}
springs:
  - {{between: [ground.S, coupler.P], stiffness: {stiffness} N/m, free: {size} m}}
  - {{between: [rocker, coupler], stiffness: {torsion} N m/rad, free: {free} rad}}
masses:
  crank: {{mass: {light}, center: [{half} m, 0], moment: {moment}}}
  coupler: {{mass: {mass}, center: [{size} m, {half} m], moment: {moment} kg m²}}
  rocker: {{mass: {mass}, center: [{half} m, 0], moment: {moment} kg m^2}}
"""


def linkage(turn: float = 0.0, size: float = 1.0, shift: complex = 0j) -> Scene:
    """A four-bar with everything on it, drawn turned, shifted and larger, with the same forces."""

    def placed(z: complex) -> list[float]:
        at = complex(z * size * np.exp(1j * turn) + shift)
        return [at.real, at.imag]

    force = complex((3 - 20j) * np.exp(1j * turn))
    return load_scene(
        LINKAGE.format(
            o=placed(0j),
            c=placed(0.4 + 0j),
            s=placed(0.1 + 0.5j),
            size=0.12 * size,
            half=0.06 * size,
            coupler=0.36 * size,
            rocker=0.28 * size,
            mean=0.6 + turn,
            start=0.8 + turn,
            rocker_start=1.7 + turn,
            force=[force.real, force.imag],
            stiffness=300 / size,
            torsion=2 * size,
            free=-0.7,
            light=0.5 / size,
            mass=2 / size,
            moment=0.02 * size,
        )
    )


def test_an_arm_bears_what_keeps_it_turning() -> None:
    """Torque (I + m c²) α + k (θ - θ0); the pin pulls with m c ω² inward, and m c α across."""
    arm = load_scene(
        'bodies: {ground: {O: [0, 0]}, arm: {O: [0, 0], A: [0.3, 0]}}\n'
        'drivers: [{drive: arm, mean: 20 deg, amplitude: 40 deg, frequency: 2}]\n'
        'masses: {arm: {mass: 1.5 kg, center: [20 cm, 0], moment: 300 kg cm2}}\n'
        'springs: [{between: [ground, arm], stiffness: 0.1 N m/deg, free: 30 deg}]\n'
    )
    motion, loads = solved(arm, np.linspace(0, 0.5, 9))
    angle, rate, acceleration = motion.angle[:3, 0]
    found = Statics(arm.mechanism, motion.values[0], loads)
    torque = (0.03 + 1.5 * 0.04) * acceleration + 0.1 * (np.degrees(angle) - 30)
    np.testing.assert_allclose(found.effort[0], torque, rtol=1e-9, atol=1e-9)
    pull = 1.5 * 0.2 * (1j * acceleration - rate**2) * np.exp(1j * angle)
    np.testing.assert_allclose(found.force[0], pull, rtol=1e-9, atol=1e-9)


def test_a_piston_and_its_spring_by_hand() -> None:
    """Of a piston alone the rod, without mass, pushes along itself: F = m a + k (x - x0)."""
    piston = load_scene(
        'bodies:\n  ground: {O: [0, 0], S: [0.6, 0]}\n  crank: {O: [0, 0], A: [0.1, 0]}\n'
        '  rod: {A: [0, 0], B: [0.3, 0]}\n  block: {B: [0, 0]}\n'
        'joints: [{prismatic: block.B, on: ground.O, along: 0, name: slide}]\n'
        'drivers: [{drive: crank, rate: 300 rpm, start: 10 deg}]\n'
        'masses: {block: {mass: 800 g, center: [0, 0]}}\n'
        'springs: [{between: [ground.S, block.B], stiffness: 4 N/mm, free: 25 cm}]\n'
    )
    motion, loads = solved(piston, np.linspace(0, 0.2, 21))
    crank, rate = motion.angle[:2, 0]
    rod = np.arcsin(np.sin(crank) / 3)
    place = 0.1 * np.cos(crank) + 0.3 * np.cos(rod)
    # x = r cos φ + sqrt(l² - r² sin² φ), twice derived.
    root = np.sqrt(0.09 - 0.01 * np.sin(crank) ** 2)
    second = -0.1 * np.cos(crank) - 0.01 * np.cos(2 * crank) / root
    second -= (0.01 * np.sin(crank) * np.cos(crank)) ** 2 / root**3
    push = 0.8 * second * rate**2 - 4000 * (0.25 - (0.6 - place)) * -1
    torque = -push * 0.1 * np.sin(crank + rod) / np.cos(rod)
    found = Statics(piston.mechanism, motion.values[0], loads)
    np.testing.assert_allclose(found.effort[0], torque, rtol=0, atol=1e-9 * 200)
    rows = dict(zip(found.joints, found.force, strict=True))
    np.testing.assert_allclose(rows['B'].real, push, rtol=0, atol=1e-9 * 1000)
    np.testing.assert_allclose(rows['slide'].imag, push * np.tan(rod), rtol=0, atol=1e-9 * 1000)


def test_all_forces_do_no_work_and_the_effort_changes_the_energy() -> None:
    scene = linkage()
    times = np.linspace(0.0, 0.6, 13)
    motion, loads = solved(scene, times)
    effort = Statics(scene.mechanism, motion.values[0], loads).effort[0]
    rate = motion.angle[1, 0]
    power = effort * rate
    for load in loads:
        b = scene.mechanism.bodies.index(load.body)
        omega = motion.angle[1, b]
        if isinstance(load, Force):
            arm = load.point * np.exp(1j * motion.angle[0, b])
            velocity = motion.position[1, b] + 1j * omega * arm
            power = power + (np.conj(load.force) * velocity).real
        else:
            power = power + load.torque * omega
    assert np.abs(power).max() < 1e-9 * np.abs(effort * rate).max()

    def energy(t: np.ndarray) -> np.ndarray:
        """What masses and springs hold, less what the constant force has done."""
        motion = scene.mechanism.motion(t)
        frames = {
            body: (motion.position[0, b], motion.angle[0, b])
            for b, body in enumerate(scene.mechanism.bodies)
        }
        frames['ground'] = (0j, np.zeros(t.shape))
        total = np.zeros(t.shape)
        for mass in scene.masses:
            b = scene.mechanism.bodies.index(mass.body)
            omega = motion.angle[1, b]
            arm = mass.center * np.exp(1j * motion.angle[0, b])
            speed = np.abs(motion.position[1, b] + 1j * omega * arm)
            total += mass.mass / 2 * speed**2 + mass.moment / 2 * omega**2
        ends = [
            frames[body][0] + scene.points[f'{body}.{name}'][1] * np.exp(1j * frames[body][1])
            for body, name in (('ground', 'S'), ('coupler', 'P'))
        ]
        total += 300 / 2 * (np.abs(ends[1] - ends[0]) - 0.12) ** 2
        total += 2 / 2 * (frames['coupler'][1] - frames['rocker'][1] + 0.7) ** 2
        return np.asarray(total - (np.conj(3 - 20j) * ends[1]).real)

    # Central differences of order 8.
    step, weights = 1e-3, (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    slope = sum(
        w * (energy(times + k * step) - energy(times - k * step))
        for k, w in enumerate(weights, start=1)
    )
    np.testing.assert_allclose(effort * rate, slope / step, rtol=0, atol=1e-8)


def test_bearing_loads_are_the_same_both_ways_and_balance_each_body() -> None:
    scene = linkage()
    motion, loads = solved(scene, np.linspace(0.0, 0.6, 7))
    found = Statics(scene.mechanism, motion.values[0], loads)
    other = freed_reactions(scene.mechanism, motion.values[0], loads)
    np.testing.assert_allclose(other.force, found.force, rtol=0, atol=1e-9 * 100)
    for body in scene.mechanism.bodies:
        total = sum(load.force for load in loads if isinstance(load, Force) and load.body == body)
        for k, joint in enumerate(scene.mechanism.assembly.joints):
            total = total + found.force[k] * (float(joint.other == body) - float(joint.one == body))
        assert np.abs(total).max() < 1e-9


@pytest.mark.parametrize(('turn', 'size', 'shift'), [(2.0, 1.0, 0j), (-0.7, 3.0, 5 - 2j)])
def test_all_turns_moves_and_scales_with_the_scene(
    turn: float, size: float, shift: complex
) -> None:
    times = np.linspace(0.0, 0.6, 7)
    plain, moved = linkage(), linkage(turn, size, shift)
    forces = []
    for scene in (plain, moved):
        motion, loads = solved(scene, times)
        forces.append(Statics(scene.mechanism, motion.values[0], loads))
    one, other = forces
    np.testing.assert_allclose(other.force, one.force * np.exp(1j * turn), rtol=0, atol=1e-7)
    np.testing.assert_allclose(other.effort, one.effort * size, rtol=1e-9, atol=1e-7)
    was, now = (poles(scene.mechanism, scene.mechanism.motion(times)) for scene in (plain, moved))
    for name in ('icr', 'iap', 'ijp', 'isp'):
        place = getattr(was, name) * size * np.exp(1j * turn) + shift
        np.testing.assert_allclose(getattr(now, name), place, rtol=1e-8, atol=1e-8)
    velocity = was.velocity * size * np.exp(1j * turn)
    np.testing.assert_allclose(now.velocity, velocity, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(now.curvature, was.curvature / size, rtol=1e-7)
    angles = [
        transmission_angles(scene.mechanism, scene.mechanism.motion(times).values[0])
        for scene in (plain, moved)
    ]
    assert list(angles[0]) == [('coupler', 'rocker')]
    for names, angle in angles[0].items():
        np.testing.assert_allclose(angles[1][names], angle, atol=1e-7)
