"""
The shapes of cams and Geneva drives, in the frames of their bodies.

Sources: J. E. Shigley and J. J. Uicker, Theory of Machines and Mechanisms, chapters 5 (cams: the
pitch curve, its parallel at the radius of the roller, pressure angle, undercutting) and 7 (Geneva
wheels: the pin enters a slot along it where the crank's radius is d sin(π/n)).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._laws import Function
from kinpole_ros.planar._plane import Complex, Real

# A line on a body: its name, and points (n,) in its frame, m.
Outline = tuple[str, Complex]
# Angles at which a cam is drawn and checked, and points of a circular arc.
_CAM_ANGLES, _ARC_POINTS = 721, 25
# The radius of a Geneva drive's pin, as a share of the crank's.
_PIN_SHARE = 0.1


class CamContour(NamedTuple):
    """
    A cam over its angle (T,), rad, relative to the body that holds it and its follower.

    `pitch` and `profile` (T,), m, in the cam's frame, are the path of the roller's center and its
    parallel; `pressure` (T,), rad, is the angle between the common normal and the way of the
    roller; `curvature` (T,), 1/m, is that of the pitch curve, positive where it is convex.
    """

    angle: Real
    pitch: Complex
    profile: Complex
    pressure: Real
    curvature: Real


class Cam(NamedTuple):
    """
    A cam, and a roller of the `radius`, m, at the point `roller` of the body `follower`.

    The cam's `body` turns about `hub` in its frame, which is at `center` in the frame of the body
    that holds it. There the roller's center is `base` + s e^{i along} at the lift s, or, with
    `along` None, `base` + `arm` e^{is}.
    """

    body: str
    hub: complex
    center: complex
    follower: str
    roller: complex
    radius: float
    lift: Function
    base: complex
    arm: complex = 0j
    along: float | None = None

    def contour(self) -> CamContour:
        """The cam over one turn."""
        angle = np.linspace(0.0, 2 * np.pi, _CAM_ANGLES)
        lift = self.lift(angle)[:3]
        if self.along is None:
            arm = self.arm * np.exp(1j * lift[0])
            place = [self.base + arm, 1j * arm * lift[1], arm * (1j * lift[2] - lift[1] ** 2)]
            way = 1j * arm / abs(self.arm)
        else:
            way = np.full(len(angle), np.exp(1j * self.along))
            place = [self.base + lift[0] * way, lift[1] * way, lift[2] * way]
        place[0] = place[0] - self.center
        back = np.exp(-1j * angle)
        # The cam's own turn, as seen from its frame.
        first = (place[1] - 1j * place[0]) * back
        second = (place[2] - 2j * place[1] - place[0]) * back
        pitch = place[0] * back
        # Clockwise, since the cam turns forward under the roller, unless it is beside the hub.
        side = np.sign((pitch.conj() * first).imag.sum())
        inward = 1j * side * first / np.abs(first)
        pressure = np.arccos(np.minimum(np.abs((inward.conj() * way * back).real), 1.0))
        curvature = side * (first.conj() * second).imag / np.abs(first) ** 3
        pitch = self.hub + pitch
        return CamContour(angle, pitch, pitch + self.radius * inward, pressure, curvature)

    def outlines(self) -> list[Outline]:
        """The profile, and the roller."""
        roller = self.roller + self.radius * _arc(0, 2 * np.pi)
        return [(self.body, self.contour().profile), (self.follower, roller)]


class Geneva(NamedTuple):
    """
    A Geneva drive of `slots` and the `distance` of its hubs, m.

    The `wheel` turns about `hub` in its frame, and a slot is in the direction `slot`, rad; the pin
    of the `crank` is in the direction `pin` from `center` in that one's frame.
    """

    wheel: str
    hub: complex
    slot: float
    crank: str
    center: complex
    pin: float
    slots: int
    distance: float

    def outlines(self) -> list[Outline]:
        """The wheel with its slots, the crank's pin and arm, and the disk that locks the wheel."""
        n, d = self.slots, self.distance
        crank, tip = d * np.sin(np.pi / n), d * np.cos(np.pi / n)
        pin = _PIN_SHARE * crank
        lock = crank - 2 * pin
        # From the mouth of a slot around its end, then to where the locking arc begins and ends.
        mouth = np.arcsin(pin / tip)
        slot = [tip * np.exp(-1j * mouth), *(d - crank + pin * _arc(1.5 * np.pi, 0.5 * np.pi))]
        to_lock = np.arccos((tip**2 + d**2 - lock**2) / (2 * tip * d))
        rim = tip * _arc(mouth, np.pi / n - to_lock)
        end = np.angle(tip * np.exp(1j * to_lock) - d)
        lower = (d + lock * _arc(2 * np.pi - end, end)) * np.exp(1j * np.pi / n)
        other_rim = tip * _arc(np.pi / n + to_lock, 2 * np.pi / n - mouth)
        sector = np.concatenate((slot, rim, lower, other_rim))
        turns = np.exp(1j * (self.slot + 2 * np.pi * np.arange(n) / n))
        wheel = self.hub + np.ravel(turns[:, None] * sector)
        toward = np.exp(1j * self.pin)
        around = crank + pin * _arc(0, 2 * np.pi)
        lines = self._disk(sector), np.array([0, crank - pin]), around
        return [
            (self.wheel, np.append(wheel, wheel[0])),
            *((self.crank, self.center + toward * line) for line in lines),
        ]

    def _disk(self, sector: Complex) -> Complex:
        """The disk that locks the wheel, cut out where the wheel passes; the pin is along x."""
        ratio, free = np.sin(np.pi / self.slots), np.pi / 2 - np.pi / self.slots
        psi = np.linspace(-free, free, _CAM_ANGLES)
        turns = np.exp(2j * np.pi * np.arange(-1, 2) / self.slots)
        # The wheel as seen from the crank, while the pin is in a slot.
        slot = np.exp(1j * np.angle(1 - ratio * np.exp(1j * psi)))
        passing = self.distance - slot * np.ravel(turns[:, None] * sector)[:, None]
        passing = np.ravel(passing * np.exp(-1j * psi))
        lock = ratio * self.distance * (1 - 2 * _PIN_SHARE)
        angle = np.linspace(-np.pi, np.pi, 2 * _ARC_POINTS * 4 + 1)
        radius = np.full(len(angle), lock)
        nearest = np.searchsorted(angle[1:], np.angle(passing))
        np.minimum.at(radius, nearest, np.abs(passing))
        np.minimum.at(radius, nearest + 1, np.abs(passing))
        return radius * np.exp(1j * angle)


def _arc(first: float, last: float) -> Complex:
    return np.exp(1j * np.linspace(first, last, _ARC_POINTS))


class Follower(NamedTuple):
    """
    The variable `moved` as a `function` of the angle of the body `of`, a cam or a Geneva crank.

    That angle is relative to the body `seen`, and so is `moved` if it is the angle of a body. The
    function depends on the positions of the points with the names `hubs`. Its `shape` is that of a
    cam only where the scene states a roller.
    """

    name: str
    moved: str
    of: str
    seen: str
    function: Function
    hubs: tuple[str, ...] = ()
    shape: Cam | Geneva | None = None


def cam_lines(followers: tuple[Follower, ...]) -> list[str]:
    """A line for each cam with a roller: the pressure angle, and whether it is undercut."""
    lines = []
    for follower in followers:
        if not isinstance(cam := follower.shape, Cam):
            continue
        contour = cam.contour()
        steep, sharp = int(contour.pressure.argmax()), int(contour.curvature.argmax())
        pressure, *at = np.degrees(
            (contour.pressure[steep], contour.angle[steep], contour.angle[sharp])
        )
        radius, least = 1e3 * cam.radius, 1e3 / contour.curvature[sharp]
        is_cut = least <= radius
        verdict = 'undercut; take a smaller roller or a larger cam' if is_cut else 'no undercut'
        lines.append(
            f'cam {cam.body} for {follower.moved}: pressure angle up to {pressure:.4g} deg, at '
            f'{at[0]:.4g} deg; least radius of the pitch curve {least:.4g} mm, at {at[1]:.4g} deg, '
            f'roller {radius:.4g} mm: {verdict}'
        )
    return lines
