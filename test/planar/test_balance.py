"""The measured balance of forces against the linkage's own statics, noise drawn, and its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinpole_ros.mechanism._assembly import assemble
from kinpole_ros.mechanism._equilibrium import Statics
from kinpole_ros.mechanism._joint_kinds import GROUND, Revolute
from kinpole_ros.mechanism._loads import Force, Torque
from kinpole_ros.mechanism._mechanism import Driver, Mechanism
from kinpole_ros.planar._balance import Port, balancing_effort, measured_balance, port_power
from kinpole_ros.planar._uncertainty import Linear

NONE = np.zeros((2, 2, 3))


def moving_bodies(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places (2, 3) and angles (2, 3) of three bodies that move anyhow."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(2, 3, 2)) @ [1, 1j], rng.normal(size=(2, 3))


def four_bar() -> tuple[Mechanism, np.ndarray]:
    """Return a crank-rocker and its variables (n, 50) all the way round."""
    joints = [
        Revolute('O', GROUND, 0j, 'crank', 0j),
        Revolute('A', 'crank', 0.12, 'coupler', 0j),
        Revolute('B', 'coupler', 0.36, 'rocker', 0.28),
        Revolute('C', GROUND, 0.4, 'rocker', 0j),
    ]
    assembly = assemble(['crank', 'coupler', 'rocker'], joints)

    def motion(t: np.ndarray) -> np.ndarray:
        return np.zeros((5, *np.shape(t)))

    driver = Driver('crank', np.array([1.0, 0, 0]), motion)
    mechanism = Mechanism(assembly, (driver,), np.array([0.0, 0.8, 1.7]))
    return mechanism, mechanism.sweep(np.linspace(0, 2 * np.pi, 50)).values[0]


def test_a_measured_linkage_needs_what_its_statics_say() -> None:
    """From velocities alone, at any speed and without joints, comes the effort of virtual work."""
    mechanism, values = four_bar()
    found = mechanism.sweep(values[0])
    # Bodies (3,) by orders: as tracked at a crank rate of -2.5 rad/s.
    position, angle = found.position[:2].copy(), found.angle[:2].copy()
    position[1] *= -2.5
    angle[1] *= -2.5
    nothing = np.zeros((2, 2, 3, 50))
    point = 0.2 * np.exp(2j)
    value, noise, determined = measured_balance(
        Port(0, 1.0), [Port(1, 3 - 50j, point), Port(2, -2.0)], position, angle, nothing, nothing
    )
    loads = [Force('coupler', point, 3 - 50j), Torque('rocker', -2.0)]
    np.testing.assert_allclose(value, Statics(mechanism, values, loads).effort[0], atol=1e-12)
    assert np.all(noise == 0)
    assert determined.all()
    # The same torque as a force across the crank's end; its length is of no account.
    across = 7j * np.exp(1j * values[0])
    for k in range(0, 50, 7):
        force, _, _ = measured_balance(
            Port(0, across[k], 0.12),
            [Port(1, 3 - 50j, point), Port(2, -2.0)],
            position[..., k],
            angle[..., k],
            NONE,
            NONE,
        )
        assert force == pytest.approx(value[k] / 0.12, rel=1e-9, abs=1e-11)


def test_lever_sign() -> None:
    """A load that goes up with the input pushed down is held by a push down as arms have it."""
    position, angle = np.zeros((2, 1), complex), np.array([[0.0], [-1.0]])
    nothing = np.zeros((2, 2, 1))
    effort, _, _ = measured_balance(
        Port(0, -1j, 2.0), [Port(0, -30j, -1.0)], position, angle, nothing, nothing
    )
    assert effort == pytest.approx(15.0)


@given(st.integers(0, 10**6), st.booleans(), st.integers(0, 2))
def test_partials_are_those_of_differences(seed: int, turning: bool, loaded: int) -> None:
    """Each partial derivative is what a small change of that derivative does, on any bodies."""
    position, angle = moving_bodies(seed)
    through = (0, 1.0, None) if turning else (0, np.exp(0.7j), 0.3 - 0.2j)
    ports = [(loaded, 3 - 5j, 0.4 + 0.1j), (1, 2.0, None)]

    def effort(z: np.ndarray, a: np.ndarray) -> dict[int, Linear]:
        rate, *powers = (
            port_power(force, point, z[:, body], a[:, body])
            for body, force, point in (through, *ports)
        )
        return balancing_effort(
            (0, rate), [(port[0], power) for port, power in zip(ports, powers, strict=True)]
        )

    found = effort(position, angle)
    assert set(found) == {0, 1, loaded}
    rate = port_power(*through[1:], position[:, 0], angle[:, 0]).value
    if abs(rate) < 0.1:
        return
    step = 1e-6
    size = 1 + sum(np.abs(one.by_angle).sum() for one in found.values())
    for body, linear in found.items():
        by_position, by_angle = np.zeros((2, 2), complex)
        by_position[linear.position_orders] = linear.by_position
        by_angle[linear.angle_orders] = linear.by_angle
        for k in (0, 1):
            for unit in (1.0, 1j):
                change = np.zeros_like(position)
                change[k, body] = step * unit
                ends = [effort(position + s * change, angle)[0].value for s in (1, -1)]
                slope = (by_position[k] * unit).real
                assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(slope, abs=1e-6 * size)
            change = np.zeros_like(angle)
            change[k, body] = step
            ends = [effort(position, angle + s * change)[0].value for s in (1, -1)]
            slope = by_angle[k].real
            assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(slope, abs=1e-6 * size)


@pytest.mark.parametrize('loaded', [0, 1])
def test_variance_is_that_of_drawn_noise(loaded: int) -> None:
    """The variance matches 200,000 draws, load on the input's body (correlated) or on another."""
    position, angle = moving_bodies(3)
    angle[1, 0] = 2.0
    rng = np.random.default_rng(0)
    root = rng.normal(size=(2, 2, 2, 3)) * 2e-3
    place, turn = (np.stack([r[..., b] @ r[..., b].T for b in range(3)], axis=-1) for r in root)
    through, loads = Port(0, 1j, 0.5 + 0.1j), [Port(loaded, 3 - 5j, 0.4 + 0.1j), Port(2, 1.5)]
    value, noise, determined = measured_balance(through, loads, position, angle, place, turn)
    assert determined
    draws = 200_000
    drawn = rng.normal(size=(3, 2, 3, draws))
    errors = [
        np.stack([r[..., b] @ d[:, b] for b in range(3)], axis=1)
        for r, d in zip((root[0], root[0], root[1]), drawn, strict=True)
    ]
    many = measured_balance(
        through,
        loads,
        position[..., None] + errors[0] + 1j * errors[1],
        angle[..., None] + errors[2],
        place[..., None],
        turn[..., None],
    )[0]
    assert np.mean(many) == pytest.approx(float(value), rel=5e-3)
    assert np.var(many) == pytest.approx(float(noise), rel=0.03)


def test_undetermined_where_the_input_hardly_moves() -> None:
    """An input's rate within its noise gives no effort; standing still, or NaN, neither."""
    position = np.zeros((2, 4), complex)
    angle = np.array([[0.0] * 4, [0.1, 0.02, 0.0, np.nan]])
    nothing, noise = np.zeros((2, 2, 4)), np.zeros((2, 2, 4))
    noise[1, 1] = 0.01**2
    for body, expected in enumerate([True, False, False, False]):
        value, variance, determined = measured_balance(
            Port(body, 1.0), [Port(0, 2.0)], position, angle, nothing, noise
        )
        assert bool(determined) == expected
        if determined:
            assert value == pytest.approx(-2.0)
            # Input and load are one body: whatever its rate is, the torques are opposite.
            assert variance == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize('port', [Port(0, 0.0), Port(0, 0j, 1.0), Port(0, 1j), Port(0, np.nan)])
def test_an_input_without_direction_is_refused(port: Port) -> None:
    """No force, no torque, or a torque out of the plane is no input, and the line says so."""
    with pytest.raises(ValueError, match='needs a direction'):
        measured_balance(port, [], np.zeros((2, 1)) + 0j, np.ones((2, 1)), NONE, NONE)


def test_no_load_needs_no_effort() -> None:
    """Without loads the effort is zero, with no doubt."""
    position, angle = moving_bodies(1)
    value, noise, determined = measured_balance(Port(0, 1.0), [], position, angle, NONE, NONE)
    assert value == 0
    assert noise == 0
    assert determined
