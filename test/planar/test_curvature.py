"""Circles, centers, cubic and Ball's point against paths in 40 digits, and closed forms."""

from collections.abc import Callable

import mpmath as mp
import numpy as np
import pytest

from kinpole_ros import planar
from kinpole_ros.mechanism import load_scene
from kinpole_ros.planar._curvature import Circle

pytestmark = pytest.mark.filterwarnings('error')

DIGITS = 40
TURN = 2 * np.pi
# Poses of a body as functions of time, in mpmath: a point of it, and the direction of its x axis.
Pose = Callable[[mp.mpf], tuple[mp.mpc, mp.mpc]]


def crossing(a: mp.mpc, b: mp.mpc, from_a: float, from_b: float, side: int) -> mp.mpc:
    """The point at distances from a and b, on the left of the line from a to b for side 1."""
    line = b - a
    square = abs(line) ** 2
    along = (square + mp.mpf(from_a) ** 2 - mp.mpf(from_b) ** 2) / (2 * square)
    return a + line * mp.mpc(along, side * mp.sqrt(mp.mpf(from_a) ** 2 / square - along**2))


def unit(z: mp.mpc) -> mp.mpc:
    return z / abs(z)


def four_bar_coupler(t: mp.mpf) -> tuple[mp.mpc, mp.mpc]:
    a = mp.mpf('0.12') * mp.expj(2 * mp.pi * t)
    b = crossing(a, mp.mpc('0.4'), mp.mpf('0.36'), mp.mpf('0.28'), 1)
    return a, unit(b - a)


def slider_crank_rod(t: mp.mpf) -> tuple[mp.mpc, mp.mpc]:
    a = mp.mpf('0.1') * mp.expj(2 * mp.pi * t + mp.pi / 6)
    b = a.real + mp.sqrt(mp.mpf('0.3') ** 2 - a.imag**2)
    return a, unit(b - a)


def six_bar_rod(t: mp.mpf) -> tuple[mp.mpc, mp.mpc]:
    a = mp.mpf('0.1') * mp.expj(2 * mp.pi * t)
    b = crossing(a, mp.mpc('0.3'), mp.mpf('0.28'), mp.mpf('0.22'), 1)
    d = a + unit(b - a) * mp.mpf('0.2') * mp.expj(40 * mp.pi / 180)
    e = crossing(d, mp.mpc('0.5', '0.15'), mp.mpf('0.32'), mp.mpf('0.25'), 1)
    return d, unit(e - d)


def cardan_rod(t: mp.mpf) -> tuple[mp.mpc, mp.mpc]:
    return mp.expj(-t - mp.mpf('0.3')) / 2, mp.expj(t + mp.mpf('0.3'))


def wheel(t: mp.mpf) -> tuple[mp.mpc, mp.mpc]:
    """At a rate that grows."""
    angle = -(t + t * t / 3)
    return mp.mpc(-angle / 2, 0.5), mp.expj(angle)


def taylor(function: Callable, t: float, order: int) -> np.ndarray:
    """A complex function of time and its derivatives (order + 1,)."""
    real = mp.taylor(lambda s: mp.re(function(s)), mp.mpf(t), order)
    imag = mp.taylor(lambda s: mp.im(function(s)), mp.mpf(t), order)
    pairs = zip(real, imag, strict=True)
    return np.array([complex(x, y) * float(mp.factorial(k)) for k, (x, y) in enumerate(pairs)])


class Instant:
    """The motion of a body at an instant, and the paths of its points."""

    def __init__(self, pose: Pose, t: float) -> None:
        self.pose, self.t = pose, t
        with mp.workdps(DIGITS):
            self.position = taylor(lambda s: pose(s)[0], t, 4)
            start = pose(mp.mpf(t))[1]
            self.angle = taylor(lambda s: mp.arg(pose(s)[1] / start), t, 4).real
        self.at, self.x_axis = self.position[0], complex(start)
        u = planar.icr_velocity(self.position, self.angle).value
        du = planar.icr_acceleration(self.position, self.angle).value
        icr = planar.pole(1, self.position, self.angle)
        vectors = map(planar.to_plane, (icr.value, u, du))
        self.icr, self.u, self.du = vectors
        self.all = self.angle[1], self.angle[2], self.icr, self.u, self.du

    def curvature(self, point: np.ndarray) -> tuple[float, float]:
        """Curvature of the path of the body's point here (2,), and its rate by the arc length."""
        arm = (complex(*point) - self.at) / self.x_axis

        def path(s: mp.mpf) -> mp.mpc:
            origin, x_axis = self.pose(s)
            return origin + x_axis * mp.mpc(arm)

        with mp.workdps(DIGITS):
            _, v, a, j = taylor(path, self.t, 3)
        speed = abs(v)
        bend, lag = (v.conjugate() * a).imag, (v.conjugate() * a).real
        rate = (v.conjugate() * j).imag / speed**3 - 3 * bend * lag / speed**5
        return bend / speed**3, rate / speed


SCENES: dict[str, tuple[Pose, tuple[float, ...]]] = {
    'four_bar': (four_bar_coupler, (0.05, 0.31, 0.6, 0.88)),
    'slider_crank': (slider_crank_rod, (0.05, 0.4, 0.7)),
    'six_bar': (six_bar_rod, (0.1, 0.45, 0.8)),
    'cardan': (cardan_rod, (0.2, 1.7)),
    'rolling_wheel': (wheel, (0.0, 0.4)),
}
INSTANTS = [
    pytest.param(pose, t, id=f'{name} at {t}')
    for name, (pose, times) in SCENES.items()
    for t in times
]
CURVED = [one for one in INSTANTS if not str(one.id).startswith('cardan')]


@pytest.mark.parametrize(('pose', 't'), INSTANTS)
def test_curvature_and_center_are_those_of_the_path(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    points = one.icr + np.random.default_rng(1).normal(size=(8, 2))
    found = planar.path_curvature(points, one.angle[1], one.icr, one.u)
    expected = np.array([one.curvature(point)[0] for point in points])
    np.testing.assert_allclose(found.curvature, expected, rtol=1e-9, atol=1e-9)
    distance = np.linalg.norm(found.center - points, axis=1)
    np.testing.assert_allclose(distance, 1 / np.abs(expected), rtol=1e-9)


@pytest.mark.parametrize(('pose', 't'), INSTANTS)
def test_paths_of_the_inflection_circle_are_straight(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    center, diameter = planar.inflection_circle(one.angle[1], one.icr, one.u)
    for turn in (0.7, 2.0, 4.0):
        along = (one.icr - center) @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        assert np.linalg.norm(along) == pytest.approx(diameter / 2, rel=1e-12)
        assert abs(one.curvature(center + along)[0]) < 1e-9 / diameter


@pytest.mark.parametrize(('pose', 't'), CURVED)
def test_paths_of_the_cubic_keep_their_curvature(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    cubic, size = planar.stationary_curvature(*one.all), np.linalg.norm(one.u / one.angle[1])
    for point in cubic.points(np.array([0.4, 1.2, 2.0, 2.9])):
        distance = np.linalg.norm(point - one.icr) / size
        # Near the pole the curvature itself is large.
        assert abs(one.curvature(point)[1]) < 1e-9 / size**2 * max(1.0, distance**-5)


@pytest.mark.parametrize(('pose', 't'), CURVED)
def test_path_of_balls_point_is_straight_to_one_order_more(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    point = planar.ball_point(*one.all)
    curvature, rate = one.curvature(point)
    size, distance = np.linalg.norm(one.u / one.angle[1]), np.linalg.norm(point - one.icr)
    # An error of the point by 1e-12 of the circle bends its path by so much.
    near = size / distance
    assert abs(curvature) < 1e-12 * near**3 / size
    assert abs(rate) < 1e-12 * near**5 / size**2


@pytest.mark.parametrize(('pose', 't'), INSTANTS)
def test_centers_of_the_inverse_motion_are_the_points(pose: Pose, t: float) -> None:
    """Conjugate points: and Burmester's cubic of centers has the centers of the other cubic."""
    one = Instant(pose, t)
    w, _, icr, u, _ = inverse = planar.inverse_motion(*one.all)
    points = one.icr + np.random.default_rng(2).normal(size=(5, 2))
    center = planar.path_curvature(points, one.angle[1], one.icr, one.u).center
    np.testing.assert_allclose(planar.path_curvature(center, w, icr, u).center, points, rtol=1e-9)
    phi = np.array([0.4, 1.2, 2.0])
    if not np.isnan(planar.ball_point(*one.all)).any():
        of_points = planar.stationary_curvature(*one.all).points(phi)
        centers = planar.path_curvature(of_points, one.angle[1], one.icr, one.u).center
        of_centers = planar.stationary_curvature(*inverse).points(phi)
        is_finite = np.isfinite(centers).all(axis=1) & (np.abs(centers).max(axis=1) < 1e6)
        np.testing.assert_allclose(of_centers[is_finite], centers[is_finite], rtol=1e-9)


@pytest.mark.parametrize(('pose', 't'), INSTANTS)
def test_bobillier_finds_pole_and_tangent_of_two_points(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    a, b = one.icr + np.random.default_rng(3).normal(size=(2, 2))
    centers = (
        planar.path_curvature(point, one.angle[1], one.icr, one.u).center for point in (a, b)
    )
    a0, b0 = centers
    found = planar.bobillier_axis(a, a0, b, b0)
    np.testing.assert_allclose(found.icr, one.icr, rtol=1e-9, atol=1e-12)
    across = found.tangent[0] * one.u[1] - found.tangent[1] * one.u[0]
    assert abs(across) < 1e-9 * np.linalg.norm(one.u)


@pytest.mark.parametrize(('pose', 't'), INSTANTS)
def test_bresse_circles_meet_in_the_acceleration_pole(pose: Pose, t: float) -> None:
    one = Instant(pose, t)
    circles = planar.bresse_circles(*one.all[:4])
    iap = planar.to_plane(planar.pole(2, one.position, one.angle).value)
    np.testing.assert_allclose(circles.iap, iap, rtol=1e-9, atol=1e-12)
    for center, diameter in circles[:2]:
        if np.isfinite(diameter):
            assert np.linalg.norm(iap - center) == pytest.approx(diameter / 2, rel=1e-9)


@pytest.mark.parametrize(
    ('name', 'body', 'expected'),
    [
        ('four_bar', 'coupler', {'A': 'ground.O', 'B': 'ground.C'}),
        ('six_bar', 'coupler', {'A': 'ground.O', 'B': 'ground.C'}),
        ('six_bar', 'rod', {'E': 'ground.F'}),
        ('slider_crank', 'rod', {'A': 'ground.O'}),
    ],
)
def test_pins_on_cranks_have_their_pivots_for_centers(
    name: str, body: str, expected: dict[str, str]
) -> None:
    scene = load_scene(name)
    motion = scene.mechanism.motion(np.linspace(0, 1, 37))
    b = scene.mechanism.assembly.bodies.index(body)
    position, angle = motion.position[:, b], motion.angle[:, b]
    icr = planar.to_plane(planar.pole(1, position, angle).value)
    u = planar.to_plane(planar.icr_velocity(position, angle).value)
    for point, pivot in expected.items():
        on_body, at = scene.points[f'{body}.{point}'][1], scene.points[pivot][1]
        here = planar.to_plane(position[0] + on_body * np.exp(1j * angle[0]))
        center = planar.path_curvature(here, angle[1], icr, u).center
        np.testing.assert_allclose(center, np.full((37, 2), [at.real, at.imag]), atol=1e-9)


def test_circle_of_cardan_is_its_moving_centrode() -> None:
    """And so all its points move on straight lines for good: none of them is Ball's."""
    one = Instant(cardan_rod, 0.7)
    circle = planar.inflection_circle(one.angle[1], one.icr, one.u)
    np.testing.assert_allclose(circle.center, planar.to_plane(one.at), atol=1e-15)
    assert circle.diameter == pytest.approx(1.0, abs=1e-15)
    assert np.isnan(planar.ball_point(*one.all)).all()


def test_circle_of_a_wheel_ends_at_its_hub() -> None:
    one = Instant(wheel, 0.4)
    circle = planar.inflection_circle(one.angle[1], one.icr, one.u)
    hub = planar.to_plane(one.at)
    np.testing.assert_allclose(circle.center, (hub + one.icr) / 2, atol=1e-14)
    assert circle.diameter == pytest.approx(0.5, abs=1e-15)
    np.testing.assert_allclose(planar.ball_point(*one.all), hub, atol=1e-14)
    top = planar.path_curvature(2 * hub - one.icr, one.angle[1], one.icr, one.u)
    np.testing.assert_allclose(top.center - one.icr, [0, -1], atol=1e-13)


def test_what_does_not_turn_has_no_circle() -> None:
    circle: Circle = planar.inflection_circle([0.0, 2.0], np.zeros((2, 2)), [[1.0, 0], [0, 0]])
    assert np.isnan(circle.center[0]).all()
    assert np.isnan(circle.diameter[0])
    assert circle.diameter[1] == 0
    cubic = planar.stationary_curvature(2.0, 0.0, [0, 0], [0, 0], [0, 0])
    assert np.isnan(cubic.over_m)
    assert np.isnan(cubic.points(np.array([1.0]))).all()
    still = planar.path_curvature([[0, 0], [0, 1]], 2.0, [0, 0], [1, 0])
    assert np.isnan(still.curvature[0])
    assert np.isnan(planar.bresse_circles(2.0, 0.0, [0, 0], [1, 0]).tangential.diameter)
    parallel = planar.bobillier_axis([0, 0], [0, 1], [1, 0], [1, 1])
    assert np.isnan(parallel.icr).all()


def test_covariance_by_differences_is_exact_for_lines_and_squares() -> None:
    """Of a square of independent errors: its variance, and the square of its shift."""
    rng = np.random.default_rng(5)
    position = rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))
    angle = rng.normal(size=(3, 4))
    spreads = []
    for scale in (0.3, 0.2):
        roots = scale * rng.normal(size=(4, 3, 3))
        spreads.append(np.moveaxis(roots @ roots.swapaxes(1, 2), 0, -1))

    def linear(z: np.ndarray, a: np.ndarray) -> np.ndarray:
        return (2 - 1j) * z[0] + 3j * z[2] + (0.5 + 1j) * a[1]

    by_position, by_angle = np.zeros((3, 4), complex), np.zeros((3, 4), complex)
    by_position[0], by_position[2], by_angle[1] = 2 - 1j, 3j, 0.5 + 1j
    orders = slice(0, 3)
    exact = planar.Linear(linear(position, angle), by_position, by_angle, orders, orders)
    value, covariance = planar.propagate(linear, position, angle, *spreads)
    np.testing.assert_array_equal(value, exact.value)
    np.testing.assert_allclose(covariance, planar.covariance(exact, *spreads), rtol=1e-9)
    spreads[1] *= np.eye(3)[..., None]
    variance = spreads[1][1, 1]
    square = planar.propagate(lambda z, a: a[1] ** 2 + 0j, position, 0 * angle, *spreads)[1]
    np.testing.assert_allclose(square[:, 0, 0], 3 * variance**2, rtol=1e-9)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match='icr must have shape'):
        planar.inflection_circle(1.0, [0.0, 0.0, 0.0], [1.0, 0.0])
    with pytest.raises(ValueError, match='point must have shape'):
        planar.path_curvature([1.0], 1.0, [0.0, 0.0], [1.0, 0.0])
