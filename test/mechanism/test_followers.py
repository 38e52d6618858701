"""The shapes of cams and Geneva drives, against eccentric circles and against what they touch."""

import numpy as np
import pytest

from kinpole_ros.mechanism import SceneError, load_scene
from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._followers import Cam, Follower, cam_lines

pytestmark = pytest.mark.filterwarnings('error')

# Radius of the pitch circle, its eccentricity and the radius of the roller, m.
CIRCLE, ECCENTRICITY, ROLLER = 0.04, 0.012, 0.007
CAMS = """
bodies:
  ground: {K: [10 mm, 20 mm], G: [15 mm, 20 mm], C: [90 mm, 0]}
  shaft:  {K: [3 mm, -4 mm]}
  stem:   {S: [0, 0], R: [2 mm, -10 mm]}
  rocker: {C: [5 mm, 1 mm], Q: [60 mm, 0]}
joints:
  - {prismatic: stem.S, on: ground.G, along: 80 deg, turned: -20 deg, name: stroke}
  - {cam: shaft, moves: stroke, law: 3-4-5, roller: stem.R, radius: 8 mm,
     angles: [0 deg, 120 deg, 180 deg, 300 deg, 360 deg], lift: [5 cm, 5 cm, 7 cm, 7 cm, 5 cm]}
  - {cam: shaft, moves: rocker, roller: rocker.Q, radius: 6 mm, law: harmonic,
     angles: [0 deg, 120 deg, 180 deg, 300 deg, 360 deg],
     lift: [150 deg, 150 deg, 130 deg, 130 deg, 150 deg]}
drivers:
  - {drive: shaft, rate: 30 rpm}
"""
GENEVA = """
bodies:
  ground: {O: [0, 0], W: [80 mm, 60 mm]}
  crank:  {O: [5 mm, 0]}
  table:  {W: [0, 7 mm]}
joints:
  - {geneva: table.W, on: crank.O, slots: SLOTS, pin: 25 deg, slot: 10 deg}
drivers:
  - {drive: crank, rate: 30 rpm}
"""


def eccentric(turn: float = 0.0) -> Cam:
    """A translating roller on a circle about a point beside the hub, by its lift in closed form."""

    def lift(angle: np.ndarray) -> np.ndarray:
        e, sine, cosine = ECCENTRICITY, np.sin(angle - turn), np.cos(angle - turn)
        root = np.sqrt(CIRCLE**2 - (e * sine) ** 2)
        first = -e * e * sine * cosine / root
        second = -e * e * (cosine**2 - sine**2) / root - first**2 / root
        return np.stack([e * cosine + root, -e * sine + first, -e * cosine + second])

    return Cam('shaft', 0.01j, 0.02, 'stem', 0j, ROLLER, lift, 0.02, along=np.pi / 2)


@pytest.mark.parametrize('turn', [0.0, 0.7])
def test_the_cam_of_a_circle_is_that_circle(turn: float) -> None:
    cam = eccentric(turn)
    contour = cam.contour()
    middle = cam.hub + ECCENTRICITY * 1j * np.exp(-1j * turn)
    np.testing.assert_allclose(np.abs(contour.pitch - middle), CIRCLE, rtol=1e-12)
    np.testing.assert_allclose(np.abs(contour.profile - middle), CIRCLE - ROLLER, rtol=1e-12)
    np.testing.assert_allclose(contour.curvature, 1 / CIRCLE, rtol=1e-9)
    sine = ECCENTRICITY * np.abs(np.sin(contour.angle - turn)) / CIRCLE
    np.testing.assert_allclose(contour.pressure, np.arcsin(sine), atol=1e-7)


def test_a_roller_larger_than_the_pitch_curve_undercuts_the_cam() -> None:
    for radius, says in ((ROLLER, ': no undercut'), (0.041, ': undercut; take a smaller roller')):
        cam = eccentric()._replace(radius=radius)
        (line,) = cam_lines((Follower('', 'stroke', 'shaft', 'ground', cam.lift, (), cam),))
        assert says in line
        assert 'pressure angle up to 17.46 deg' in line
        assert 'pitch curve 40 mm' in line


def test_rollers_touch_their_cams_at_all_positions() -> None:
    mechanism = load_scene(CAMS).mechanism
    motion = mechanism.sweep(np.linspace(0.3, 6.5, 40))
    poses = poses_of(mechanism.assembly, motion.values[0])
    for follower in mechanism.assembly.followers:
        cam = follower.shape
        assert isinstance(cam, Cam)
        profile, shaft = cam.contour().profile, poses['shaft']
        roller = poses[cam.follower].point(cam.roller)
        at = shaft.position + profile[:, None] * shaft.turn
        # The nearest of the drawn points is beside the point of contact.
        nearest = np.abs(at - roller).min(axis=0)
        np.testing.assert_allclose(nearest, cam.radius, atol=2e-5)
        assert (nearest >= cam.radius - 1e-12).all()


@pytest.mark.parametrize(
    ('old', 'new', 'says'),
    [
        (', radius: 8 mm', '', "the key 'radius' is missing"),
        ('radius: 8 mm', 'radius: -8 mm', 'greater than 0'),
        ('roller: stem.R', 'roller: rocker.Q', 'give a point of stem'),
        ('roller: rocker.Q', 'roller: rocker.C', 'give a point of rocker beside its pin'),
        ('radius: 8 mm', 'radius: 80 mm', 'reaches the hub of shaft'),
        ('shaft:  {K:', 'shaft:  {L:', 'turn about a pin on ground'),
    ],
)
def test_a_roller_that_cannot_be_is_refused(old: str, new: str, says: str) -> None:
    assert old in CAMS
    with pytest.raises(SceneError, match=says) as error:
        load_scene(CAMS.replace(old, new))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize('slots', [3, 4, 6, 12])
def test_the_pin_and_the_disk_of_a_geneva_drive_stay_off_its_wheel(slots: int) -> None:
    mechanism = load_scene(GENEVA.replace('SLOTS', str(slots))).mechanism
    poses = poses_of(mechanism.assembly, mechanism.sweep(np.linspace(0.1, 13, 300)).values[0])
    (follower,) = mechanism.assembly.followers
    assert follower.shape
    (_, wheel), (_, disk), _, (_, pin) = follower.shape.outlines()
    table, crank = poses['table'], poses['crank']
    at = table.position + wheel[:, None] * table.turn
    middle, radius = pin[:-1].mean(), np.ptp(pin.real) / 2
    assert (np.abs(at - crank.point(middle)) > radius - 1e-9).all()
    # The pin comes as near as the width of the slot.
    dense = np.interp(np.linspace(0, 1, 40 * len(wheel)), np.linspace(0, 1, len(wheel)), wheel)
    nearest = np.abs(table.position + dense[:, None] * table.turn - crank.point(middle)).min(axis=0)
    assert nearest.min() == pytest.approx(radius, rel=1e-2)
    # Nor is any point of the wheel in the disk.
    local = (at - crank.position) * crank.turn.conj() - follower.shape.center
    local = np.ravel(local) * np.exp(-1j * follower.shape.pin)
    disk = (disk - follower.shape.center) * np.exp(-1j * follower.shape.pin)
    edge = np.interp(np.angle(local), np.linspace(-np.pi, np.pi, len(disk)), np.abs(disk))
    assert (np.abs(local) > 0.99 * edge).all()
    assert (np.abs(local) < 1.01 * edge).any()
