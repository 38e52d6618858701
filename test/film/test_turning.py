"""Tags that turn out of the picture are placed in space: doors, lids, and knees from their side."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from kinpole_ros.bags import write_points
from kinpole_ros.film import FilmError, FilmOptions, Lens, _turning
from kinpole_ros.film._filmed import Filmed, Seen
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._turning import place_turning
from kinpole_ros.tools.discover import find_linkage

PICTURE = 1280, 720
MATRIX = np.array([[900.0, 0, 639.5], [0, 900, 359.5], [0, 0, 1]])
LENS = Lens(MATRIX, np.zeros(5))
SQUARE = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) / 2
TO_CAMERA = np.diag([1.0, -1, -1])  # turns a tag to the camera
NOISE = 0.05  # pixels
TIMES = np.arange(120) / 30


def turn(x: float, y: float, z: float) -> np.ndarray:
    return np.asarray(cv2.Rodrigues(np.array([x, y, z], float))[0])


@dataclass(frozen=True)
class Hinge:
    """A tag on an arm that turns about an axis, in the axes of the camera, m and rad."""

    axis: tuple[float, float, float]
    arm: tuple[float, float, float]
    lean: tuple[float, float, float] = (0, 0, 0)
    place: tuple[float, float, float] = (0, 0, 1)
    size: float = 0.1
    swing: tuple[float, float] = (-0.6, 0.6)

    @property
    def normal(self) -> np.ndarray:
        return np.array(self.axis) / np.linalg.norm(self.axis)

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(np.cross(self.normal, self.arm)))

    def corners(self) -> np.ndarray:
        """Return the corners (T, 4, 3), m."""
        low, high = self.swing
        angles = (low + high) / 2 - (high - low) / 2 * np.cos(2 * np.pi * TIMES / 2.5)
        tag = np.array(self.arm) + self.size * SQUARE @ (turn(*self.lean) @ TO_CAMERA).T
        return np.stack([self.place + tag @ turn(*(a * self.normal)).T for a in angles])


DOOR = Hinge((0, -1, 0.05), (-0.4, 0.02, 0), place=(0.1, 0, 0.9), size=0.14)
HINGES = {
    'door': DOOR,
    'lid': Hinge((1, 0, 0.02), (0, 0.3, 0), place=(0, -0.1, 0.8), swing=(-0.9, 0.3)),
    'knee': Hinge((0.4, 0, -1), (0, 0.3, 0.04), (0, 0.38, 0), size=0.06),
    'oblique': Hinge((0.5, -0.6, -0.6), (0.15, 0.1, 0), (0.3, 0.2, 0), size=0.06),
}


def seen_from(*corners: np.ndarray, first: int = 1) -> Seen:
    """Return tags first, first + 1, ... with corners (T, 4, 3), m, as a camera shows them."""
    shown = np.stack(corners, axis=1) @ MATRIX.T
    pixels = shown[..., :2] / shown[..., 2:]
    pixels += NOISE * np.random.default_rng(0).standard_normal(pixels.shape)
    stamps = np.rint(1e9 * TIMES).astype(np.int64)
    dots = np.empty((len(stamps), 0, 2))
    tags = list(range(first, first + len(corners)))
    return Seen(tags, stamps, pixels, dots, PICTURE, '36h11')


def pin_of(filmed: Filmed, path: Path) -> tuple[float, float]:
    """Return the distance of the pin from the center of the tag, m, and its deviation."""
    write_points(path, filmed.names, filmed.stamps, filmed.points)
    (pin,) = find_linkage(str(path)).linkage.joints
    on_tag = pin.on_one if pin.one >= 0 else pin.on_other
    return abs(on_tag), max(pin.deviation)


@pytest.mark.parametrize('name', HINGES)
def test_the_axis_and_the_radius_of_a_hinge_are_within_their_deviations(
    name: str, tmp_path: Path
) -> None:
    hinge = HINGES[name]
    seen = seen_from(hinge.corners())
    found = place_turning(seen.pixels, hinge.size, MATRIX, PICTURE)
    assert found is not None
    assert found.residual == pytest.approx(NOISE, rel=0.2)
    off = np.linalg.norm(np.cross(found.normal, hinge.normal))
    assert off < 3 * found.deviation < 3e-3
    filmed = place_seen(seen, FilmOptions(size=hinge.size), LENS)
    radius, deviation = pin_of(filmed, tmp_path / 'hinge.mcap')
    assert abs(radius - hinge.radius) < min(3e-3, 4 * deviation + 1e-4)
    assert deviation < 3e-3
    # The corners are where they are seen, but for what they scatter.
    shown = filmed.to_pixels(filmed.corners[:, 0], 0, filmed.corner_heights[0])
    assert abs((shown - seen.pixels[:, 0]).mean()) < 1


def test_a_tag_on_the_wall_is_the_origin() -> None:
    wall = np.array([0.2, -0.1, 0.95]) + 0.14 * SQUARE @ (turn(0, 0.2, 0) @ TO_CAMERA).T
    seen = seen_from(np.broadcast_to(wall, (len(TIMES), 4, 3)), DOOR.corners(), first=0)
    filmed = place_seen(seen, FilmOptions(size=DOOR.size), LENS)
    assert 'tag 0 is the origin, x along its top edge' in filmed.assumed[1]
    # The plane is seen from above: y is its normal times x.
    x = wall[1] - wall[0]
    x -= DOOR.normal * (x @ DOOR.normal)
    x /= np.linalg.norm(x)
    arm = DOOR.corners() - wall.mean(axis=0)
    exact = arm @ x + 1j * (arm @ np.cross(DOOR.normal, x))
    assert np.abs((filmed.corners[:, 1] - exact).mean(axis=1)).std() < 1e-3
    assert abs((filmed.corners[:, 1] - exact).mean()) < 3e-3
    heights = filmed.corner_heights
    assert np.abs(heights[1] - heights[0].mean() - arm[0] @ DOOR.normal).max() < 2e-3


def test_a_long_film_is_fitted_by_a_part_of_its_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    still = np.broadcast_to(DOOR.corners()[:1], (len(TIMES), 4, 3)) - (0.1, 0.3, 0)
    pixels = seen_from(DOOR.corners(), still).pixels
    pixels[:-3, 1] = np.nan  # seen in three pictures
    whole = place_turning(pixels, DOOR.size, MATRIX, PICTURE)
    monkeypatch.setattr(_turning, '_MOST_VIEWS', 60)
    part = place_turning(pixels, DOOR.size, MATRIX, PICTURE)
    assert np.abs(part.normal - whole.normal).max() < 1e-3
    off = np.abs((part.corners - whole.corners).mean(axis=2))
    assert np.nanmax(off) < 3e-3
    assert np.isfinite(off).sum() == len(TIMES) + 3


def test_tags_in_the_plane_of_the_picture_are_placed_in_it() -> None:
    flat = Hinge((0, 0, -1), (0.2, 0.1, 0), size=0.05)
    seen = seen_from(flat.corners(), replace(flat, arm=(-0.2, 0, 0)).corners())
    filmed = place_seen(seen, FilmOptions(size=flat.size), LENS)
    assert filmed.corner_heights is None
    assert not filmed.points[..., 2].any()


def test_without_a_camera_a_line_says_so_and_how_often() -> None:
    seen = seen_from(DOOR.corners())
    cause = r'tag 1 is no square of 140 mm in \d+% .* turns out of the picture.*--camera FILE'
    with pytest.raises(FilmError, match=cause):
        place_seen(seen, FilmOptions(size=DOOR.size))
    wall = 0.14 * SQUARE @ TO_CAMERA + (0, 0, 0.9)
    walls = [wall + (x, y, 0) for x in (-0.4, 0.4) for y in (-0.3, 0.3)]
    still = [np.broadcast_to(wall, (len(TIMES), 4, 3)) for wall in walls]
    both = seen_from(*still, DOOR.corners(), first=0)
    lines = place_seen(both, FilmOptions(size=DOOR.size)).assumed
    assert 'tag 4 is no square of 140 mm in' in lines[0] and '--camera FILE, by' in lines[0]
    hidden = seen.pixels.copy()
    hidden[10:20], hidden[30:35, :, 2] = np.nan, hidden[30:35, :, 2] + 15
    filmed = place_seen(replace(seen, pixels=hidden), FilmOptions(size=DOOR.size), LENS)
    text = 'tag 1 seen least, in 105 of 120 pictures (not found in 10, no square in 5)'
    assert text in filmed.assumed[0]


def test_a_motion_in_space_is_named() -> None:
    both = [turn(0, 0, 0.4 * np.sin(2 * t)) for t in TIMES]
    corners = np.stack([c @ r.T for c, r in zip(DOOR.corners(), both, strict=True)])
    seen = replace(seen_from(corners), path='door.mp4')
    cause = r'door.mp4: .* pixels off any motion in one plane: the camera moves'
    with pytest.raises(FilmError, match=cause):
        place_seen(seen, FilmOptions(size=DOOR.size), LENS)


def test_dots_are_not_placed_in_a_plane_that_is_seen_from_its_side() -> None:
    seen = replace(seen_from(DOOR.corners()), dots=np.zeros((len(TIMES), 1, 2)))
    options = FilmOptions(size=DOOR.size, points={'a_1': 1 + 2j})
    with pytest.raises(FilmError, match='--points are placed in the plane of motion, which is'):
        place_seen(seen, options, LENS)


def test_tags_that_are_too_small_for_their_distance_are_refused() -> None:
    small = replace(DOOR, place=(0.1, 0, 2.5), size=0.05)
    with pytest.raises(FilmError, match='mm only along the line of sight, too little for tags'):
        place_seen(seen_from(small.corners()), FilmOptions(size=small.size), LENS)
