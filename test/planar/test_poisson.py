"""Seed 001, equation by equation, on motions known exactly; and its poles against seed 000's."""

import numpy as np
import pytest

from kinpole_ros import planar
from kinpole_ros.mechanism import BodyMotion, load_scene, rotation_derivatives

pytestmark = pytest.mark.filterwarnings('error')

BODIES = 50


@pytest.fixture(params=range(3))
def motion(request: pytest.FixtureRequest) -> BodyMotion:
    """Random bodies in random motion, (5, BODIES), of very different sizes and rates."""
    rng = np.random.default_rng(request.param)
    size, rate = 10.0 ** rng.uniform(-3, 3, (2, BODIES))
    scale = size * rate ** np.arange(5)[:, None]
    position = scale * (rng.normal(size=(5, BODIES, 2)) @ (1, 1j))
    angle = rate ** np.arange(5)[:, None] * rng.normal(size=(5, BODIES))
    angle[1] = rate * rng.uniform(0.5, 2, BODIES) * rng.choice((-1, 1), BODIES)
    return BodyMotion(position, angle)


def arms(motion: BodyMotion, seed: int = 0) -> np.ndarray:
    """A second point B on each body, from A, in the body's axes; as large as the motion."""
    rng = np.random.default_rng(seed)
    return np.abs(motion.position[0]) * (rng.normal(size=(BODIES, 2)) @ (1, 1j))


def same(found: np.ndarray, truth: np.ndarray, scale: np.ndarray | float = 1.0) -> None:
    """Complex truth and vectors found agree to 1e-9 of the larger of `truth` and `scale`."""
    difference = np.abs(planar.to_complex(found) - truth)
    assert (difference <= 1e-9 * np.maximum(np.abs(truth), scale)).all()


def test_eq_2_and_3_translation_and_rotation_add_up_to_the_velocity(motion: BodyMotion) -> None:
    rotation = rotation_derivatives(motion.angle)
    b = arms(motion)
    r_ba = planar.to_plane(rotation[0] * b)
    v_b = motion.position[1] + rotation[1] * b
    v_ba = planar.relative_velocity(motion.angle[1], r_ba)
    same(planar.to_plane(motion.position[1]) + v_ba, v_b, np.abs(motion.position[1]))
    # Euler's circumference velocity is square to the arm.
    assert (v_ba * r_ba).sum(axis=-1) == pytest.approx(0, abs=1e-12 * np.abs(v_ba * r_ba).max())


def test_eq_4_translation_and_rotation_add_up_to_the_acceleration(motion: BodyMotion) -> None:
    rotation = rotation_derivatives(motion.angle)
    b = arms(motion)
    r_ba = planar.to_plane(rotation[0] * b)
    a_b = motion.position[2] + rotation[2] * b
    a_ba = planar.relative_acceleration(motion.angle[1], motion.angle[2], r_ba)
    same(planar.to_plane(motion.position[2]) + a_ba, a_b, np.abs(motion.position[2]))
    # The other form of eq. 4: w x v_BA in place of w x (w x r_BA).
    turned = planar.relative_velocity(motion.angle[2], r_ba) + planar.relative_velocity(
        motion.angle[1], planar.relative_velocity(motion.angle[1], r_ba)
    )
    assert a_ba == pytest.approx(turned, rel=1e-12)


def test_eq_15_the_pole_goes_along_both_centrodes_at_one_velocity(motion: BodyMotion) -> None:
    v_a, a_a = planar.to_plane(motion.position[1]), planar.to_plane(motion.position[2])
    fixed, moving = planar.centrode_velocities(v_a, a_a, motion.angle[1], motion.angle[2])
    scale = np.abs(motion.position[1]) + np.abs(motion.position[2] / motion.angle[1])
    same(moving, planar.to_complex(fixed), scale)
    # And it is seed 000's velocity of the ICR.
    same(fixed, planar.icr_velocity(*motion).value, scale)


def test_eq_15_does_not_depend_on_the_reference_point(motion: BodyMotion) -> None:
    b = arms(motion) * rotation_derivatives(motion.angle)
    answers = []
    for derivatives in (motion.position, motion.position + b):
        v, a = planar.to_plane(derivatives[1]), planar.to_plane(derivatives[2])
        answers.append(planar.centrode_velocities(v, a, motion.angle[1], motion.angle[2]))
    scale = np.abs(b[1]) + np.abs(b[2] / motion.angle[1]) + np.abs(motion.position[1])
    for of_a, of_b in zip(*answers, strict=True):
        same(of_b, planar.to_complex(of_a), 10 * scale)


def test_eq_16_transport_is_what_differentiating_coordinates_gives() -> None:
    """A vector given in the axes of a space {a} that turns in {b}, differentiated in both."""
    times = np.linspace(0, 2, 9)
    step = 1e-4

    def turn(t: np.ndarray) -> np.ndarray:
        return 0.3 + 1.7 * t - 0.4 * t**2

    def in_a(t: np.ndarray) -> np.ndarray:
        return 1.2 * np.cos(2 * t) + 1j * (0.5 + t**2)

    def rate(function: object) -> np.ndarray:
        samples = [function(times + k * step) for k in (-2, -1, 1, 2)]  # type: ignore[operator]
        return (samples[0] - 8 * samples[1] + 8 * samples[2] - samples[3]) / (12 * step)

    axes = np.exp(1j * turn(times))
    seen_from_a = rate(in_a) * axes
    seen_from_b = rate(lambda t: in_a(t) * np.exp(1j * turn(t)))
    vector, omega = in_a(times) * axes, 1.7 - 0.8 * times
    found = planar.transport(planar.to_plane(seen_from_a), omega, planar.to_plane(vector))
    assert planar.to_complex(found) == pytest.approx(seen_from_b, rel=1e-9)
    # And back: {b} turns in {a} at the opposite rate.
    back = planar.transport(found, -omega, planar.to_plane(vector))
    assert planar.to_complex(back) == pytest.approx(seen_from_a, rel=1e-9)


def test_eq_21_the_body_has_no_velocity_at_the_pole(motion: BodyMotion) -> None:
    v_a, omega = planar.to_plane(motion.position[1]), motion.angle[1]
    arm = planar.pole_from_reference(v_a, omega)
    # Eq. 17 to 19: v_A + w x r_PA = 0.
    same(v_a + planar.relative_velocity(omega, arm), np.zeros(BODIES), np.abs(motion.position[1]))
    crossed = np.cross(np.stack([0 * omega, 0 * omega, omega], -1), np.pad(v_a, ((0, 0), (0, 1))))
    assert arm == pytest.approx(crossed[:, :2] / omega[:, None] ** 2, rel=1e-12)


def test_eq_22_is_the_moving_and_eq_23_the_fixed_centrode_of_seed_000(motion: BodyMotion) -> None:
    position, angle = motion
    r_a, v_a = planar.to_plane(position[0]), planar.to_plane(position[1])
    icr = planar.pole(1, position, angle).value
    scale = np.abs(position[0]) + np.abs(position[1] / angle[1])
    fixed = planar.fixed_centrode_from_reference(r_a, v_a, angle[1])
    same(fixed, icr, scale)
    moving = planar.moving_centrode_from_reference(v_a, angle[1], angle[0])
    seen = planar.moving_centrode(planar.to_plane(icr), r_a, angle[0])
    same(moving, planar.to_complex(seen), scale)
    # The determinant of eq. 22, with v_A's components in the body's own axes.
    own = position[1] * np.exp(-1j * angle[0])
    same(moving, (-own.imag + 1j * own.real) / angle[1], scale)


def test_the_centrodes_of_a_rolling_wheel_are_line_and_rim_and_of_a_cardan_rod_two_circles() -> (
    None
):
    times = np.linspace(0, 1, 101)
    loci = {}
    for name, body in (('rolling_wheel', 'wheel'), ('cardan', 'rod')):
        position, angle = load_scene(name).motion(times)[body]
        r_a, v_a = planar.to_plane(position[0]), planar.to_plane(position[1])
        loci[name] = (
            planar.fixed_centrode_from_reference(r_a, v_a, angle[1]),
            planar.moving_centrode_from_reference(v_a, angle[1], angle[0]),
        )
    line, rim = loci['rolling_wheel']
    assert line[:, 1] == pytest.approx(0, abs=1e-12)
    assert np.diff(line[:, 0]) == pytest.approx(2 * np.pi * 0.1 / 100)
    assert np.hypot(*rim.T) == pytest.approx(0.1)
    large, small = loci['cardan']
    assert np.hypot(*large.T) == pytest.approx(0.3)
    assert np.hypot(*small.T) == pytest.approx(0.15)


def test_a_body_that_does_not_turn_has_no_pole() -> None:
    v = np.array([[1.0, 2.0], [0.0, 0.0], [3.0, 0.0]])
    omega = np.array([0.0, 0.0, 2.0])
    turning = np.array([False, False, True])
    answers = (
        planar.pole_from_reference(v, omega),
        planar.fixed_centrode_from_reference(v, v, omega),
        planar.moving_centrode_from_reference(v, omega, 0.3),
        *planar.centrode_velocities(v, v, omega, 1.0),
    )
    for answer in answers:
        assert np.array_equal(np.isfinite(answer), np.stack([turning, turning], -1))
    for answer in (planar.pole_from_reference([1.0, 2.0], 0.0), planar.relative_velocity(0.0, v)):
        assert answer.shape in ((2,), (3, 2))


@pytest.mark.parametrize(
    ('call', 'name'),
    [
        (lambda bad: planar.relative_velocity(1.0, bad), 'r_ba'),
        (lambda bad: planar.relative_acceleration(1.0, 1.0, bad), 'r_ba'),
        (lambda bad: planar.transport(bad, 1.0, [1, 0]), 'derivative_a'),
        (lambda bad: planar.transport([1, 0], 1.0, bad), 'vector'),
        (lambda bad: planar.pole_from_reference(bad, 1.0), 'v_a'),
        (lambda bad: planar.fixed_centrode_from_reference(bad, [1, 0], 1.0), 'r_a'),
        (lambda bad: planar.centrode_velocities([1, 0], bad, 1.0, 1.0), 'a_a'),
    ],
)
def test_vectors_of_another_shape_are_refused_by_name(call: object, name: str) -> None:
    for bad in ([1.0, 2.0, 3.0], 4.0):
        with pytest.raises(ValueError, match=f'{name} must have shape'):
            call(bad)  # type: ignore[operator]
