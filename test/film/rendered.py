"""
Films with a known answer: printed tags on the bodies of a scene in exact motion, as a camera sees.

The camera has perspective, a lens, motion blur over the exposure, a rolling shutter and noise; the
film is compressed by H.264 and may have a variable frame rate. All is repeatable.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from kinpole_ros.mechanism import load_scene

TICKS = 90_000  # of a second, in which stamps are written
SHUTTERS = 8  # instants of an exposure that are averaged
FINE = 2  # samples of a pixel, per axis
PAPER, INK, WALL, BAR = 205, 35, 120, 90  # gray levels
QUIET = 1  # modules of white around a tag
SHARPNESS = 0.6  # pixels, the blur of the lens
FAMILY = cv2.aruco.DICT_APRILTAG_36h11


@dataclass(frozen=True)
class Tag:
    """
    A tag on a body: its center (m) and turn (rad) in the frame of the body.

    It is `height` m nearer to the camera than the plane of motion. One with a number below 0 is a
    dark dot, half as wide, on white paper.
    """

    number: int
    body: str
    center: complex
    turn: float = 0.0
    size: float = 0.024
    height: float = 0.0


@dataclass(frozen=True)
class Camera:
    """
    A camera that looks at the plane of motion.

    It looks at `target` (m) of the plane, leans by `tilt` (degrees), and shows `width` m over its
    picture. `lens` are k1, k2, p1, p2 of OpenCV; the focal length is one width of the picture.
    """

    size: tuple[int, int] = (1920, 1080)
    width: float = 1.1
    target: complex = 0.15 + 0.12j
    tilt: float = 12.0
    lens: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @property
    def matrix(self) -> np.ndarray:
        """The matrix of the camera (3, 3)."""
        w, h = self.size
        return np.array([[w, 0, w / 2 - 0.5], [0, w, h / 2 - 0.5], [0, 0, 1.0]])

    def homography(self, height: float = 0.0) -> np.ndarray:
        """The map (3, 3) from a plane, m, to the picture of a perfect lens, pixels."""
        c, s = np.cos(np.radians(self.tilt)), np.sin(np.radians(self.tilt))
        # y of the plane is up, and that of the picture down.
        turn = np.array([[1.0, 0, 0], [0, -c, -s], [0, s, -c]])
        shift = np.array([0, 0, self.width]) - turn[:, :2] @ (self.target.real, self.target.imag)
        shift += height * np.cross(turn[:, 0], turn[:, 1])
        return self.matrix @ np.column_stack((turn[:, :2], shift))

    def pixels(self, points: np.ndarray, height: float = 0.0) -> np.ndarray:
        """Return the pixels (..., 2) of points of a plane (...), complex, m."""
        flat = np.stack((points.real, points.imag, np.ones(points.shape)), axis=-1)
        seen = flat @ self.homography(height).T @ np.linalg.inv(self.matrix).T
        rays = (seen / seen[..., 2:]).reshape(-1, 1, 3)
        drawn, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.matrix, self.lens)
        return drawn.reshape(*points.shape, 2)

    def plane(self, height: float = 0.0) -> np.ndarray:
        """Return the points of a plane (h, w, 2), m, under the centers of the pixels."""
        w, h = self.size
        grid = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 1, 2)
        straight = cv2.undistortPoints(
            grid.astype(np.float64), self.matrix, np.array(self.lens), P=self.matrix
        )
        back = cv2.perspectiveTransform(straight, np.linalg.inv(self.homography(height)))
        return back.reshape(h, w, 2).astype(np.float32)

    def write(self, path: Path) -> None:
        """Write the file of the camera as OpenCV's calibration does."""
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write('image_width', self.size[0])
        storage.write('image_height', self.size[1])
        storage.write('camera_matrix', self.matrix)
        storage.write('distortion_coefficients', np.array([[*self.lens, 0.0]]))
        storage.release()


FOUR_BAR = (
    Tag(0, 'ground', -0.1 - 0.13j, 0.0),
    Tag(1, 'crank', 0.035 + 0j),
    Tag(2, 'crank', 0.085 + 0j, 0.3),
    Tag(3, 'coupler', 0.07 + 0.1j, 0.2),
    Tag(4, 'coupler', 0.25 + 0.03j, -0.4),
    Tag(5, 'rocker', 0.06 + 0j),
    Tag(6, 'rocker', 0.2 + 0j, 1.0),
)


@dataclass(frozen=True)
class Film:
    """
    What is filmed, and how.

    `times` are the instants (T,) of the middles of the exposures, s. `line_time` is the time from
    one row to the next of a rolling shutter, s, and `noise` that of a pixel, gray levels. `hidden`
    maps the number of a tag to the frames in which a finger is in front of it, and `shake` (T, 3)
    moves and turns the picture, pixels and rad, as a hand does.
    """

    times: np.ndarray
    tags: tuple[Tag, ...] = FOUR_BAR
    camera: Camera = field(default_factory=Camera)
    scene: str = 'four_bar'
    exposure: float = 1 / 250
    line_time: float = 0.0
    noise: float = 2.0
    crf: int = 20
    hidden: dict[int, range] = field(default_factory=dict)
    shake: np.ndarray | None = None
    family: int = FAMILY

    def poses(self, times: np.ndarray) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Return the center and angle (3, ...) of each tag, with two derivatives."""
        motion = load_scene(self.scene).motion(times)
        poses = {}
        for tag in self.tags:
            zero = np.zeros((3, *times.shape))
            turn, place = zero.copy(), zero + 0j
            if tag.body != 'ground':
                turn, place = motion[tag.body].angle[:3].copy(), motion[tag.body].position[:3]
            arm = tag.center * np.exp(1j * turn[0])
            rates = 1j * turn[1] * arm, (1j * turn[2] - turn[1] ** 2) * arm
            poses[tag.number] = place + np.stack((arm, *rates)), turn
            poses[tag.number][1][0] += tag.turn
        return poses

    def corners(self, times: np.ndarray | None = None) -> dict[int, np.ndarray]:
        """Return the pixels (T, 4, 2) of the corners of each tag: from top left, clockwise."""
        times = self.times if times is None else times
        square = np.array([-1 + 1j, 1 + 1j, 1 - 1j, -1 - 1j]) / 2
        return {
            tag.number: self.camera.pixels(
                place[0][..., None] + tag.size * square * np.exp(1j * turn[0])[..., None],
                tag.height,
            )
            for tag, (place, turn) in zip(self.tags, self.poses(times).values(), strict=True)
        }

    def write(self, path: Path) -> Path:
        """Write the film, and return its path."""
        with av.open(str(path), 'w') as container:
            stream = container.add_stream('libx264', rate=30)
            stream.width, stream.height = self.camera.size
            stream.pix_fmt = 'yuv420p'
            stream.codec_context.time_base = Fraction(1, TICKS)
            stream.options = {'crf': str(self.crf), 'preset': 'veryfast', 'threads': '2'}
            for time, picture in zip(self.times, self.pictures(), strict=True):
                frame = av.VideoFrame.from_ndarray(
                    np.concatenate(
                        (picture, np.full((picture.shape[0] // 2, picture.shape[1]), 128, np.uint8))
                    ),
                    'yuv420p',
                )
                frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path

    def pictures(self) -> Iterator[np.ndarray]:
        """Yield the pictures (h, w) uint8."""
        random = np.random.default_rng(0)
        planes = {height: self.camera.plane(height) for height in {t.height for t in self.tags}}
        w, h = self.camera.size
        wall = cv2.GaussianBlur(random.standard_normal((h, w)).astype(np.float32), (0, 0), 3)
        wall = ((WALL + 60 * wall) * np.linspace(0.9, 1.1, w)).astype(np.uint8)
        # Two fields of noise, of positive and negative values, moved anew for each frame.
        grain = random.standard_normal((h, w)) * self.noise
        over, under = np.rint(grain.clip(0)).astype(np.uint8), np.rint(-grain.clip(None, 0))
        under = under.astype(np.uint8)
        poses = self.poses(self.times)
        for k in range(len(self.times)):
            picture = wall.copy()
            self._draw_bars(picture, {tag: place[0, k] for tag, (place, _) in poses.items()})
            for tag in self.tags:
                place, turn = poses[tag.number]
                self._draw_tag(picture, planes[tag.height], tag, place[:, k], turn[:, k])
                if k in self.hidden.get(tag.number, ()):
                    center = self.camera.pixels(place[:1, k])[0] + (6, 6)
                    cv2.circle(picture, np.rint(center).astype(int).tolist(), 14, 150.0, -1)
            if self.shake is not None:
                right, down, turn = self.shake[k]
                move = cv2.getRotationMatrix2D((w / 2, h / 2), np.degrees(turn), 1)
                move[:, 2] += right, down
                picture = cv2.warpAffine(picture, move, (w, h), borderMode=cv2.BORDER_REPLICATE)
            for field_of_noise, apply in ((over, cv2.add), (under, cv2.subtract)):
                shift = random.integers(0, min(h, w), 2)
                picture = apply(picture, np.roll(field_of_noise, shift, axis=(0, 1)))
            yield picture

    def _draw_bars(self, picture: np.ndarray, places: dict[int, complex]) -> None:
        """Draw the links as bars between their first and last tag."""
        for body in dict.fromkeys(tag.body for tag in self.tags if tag.body != 'ground'):
            ends = np.array([places[t.number] for t in self.tags if t.body == body])
            first, last = self.camera.pixels(ends[[0, -1]]) * 16
            cv2.line(
                picture,
                first.astype(int).tolist(),
                last.astype(int).tolist(),
                float(BAR),
                max(2, self.camera.size[0] // 60),
                cv2.LINE_AA,
                4,
            )

    def _draw_tag(
        self, picture: np.ndarray, plane: np.ndarray, tag: Tag, place: np.ndarray, turn: np.ndarray
    ) -> None:
        """Draw a tag over the picture, averaged over the exposure."""
        code = bits(tag.number, self.family)
        modules = len(code) - 2 * QUIET
        reach = tag.size * len(code) / modules * 0.75 + abs(place[1]) * self.exposure
        around = place[0] + reach * np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j])
        corners = self.camera.pixels(around, tag.height)
        u0, v0 = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
        u1, v1 = np.ceil(corners.max(axis=0)).astype(int) + 3
        patch = plane[v0:v1, u0:u1]
        if not patch.size:
            return
        rows, columns = patch.shape[:2]
        fine = cv2.resize(patch, (columns * FINE, rows * FINE), interpolation=cv2.INTER_LINEAR)
        points = fine - np.float32((place[0].real, place[0].imag))
        row = v0 + (np.arange(rows * FINE) + 0.5) / FINE - 0.5
        delay = self.line_time * (row - (self.camera.size[1] - 1) / 2)
        value, cover = np.zeros((2, rows * FINE, columns * FINE), np.float32)
        # Each instant has samples of its own between those of the others.
        across, down = fine[0, 1] - fine[0, 0], fine[1, 0] - fine[0, 0]
        padded = np.pad(code, 1)
        opaque = np.pad(np.ones(code.shape, np.float32), 1)
        for number in range(SHUTTERS):
            dt = delay + ((number + 0.5) / SHUTTERS - 0.5) * self.exposure
            fraction = np.array([0.7548777 * number, 0.5698403 * number]) % 1 - 0.5
            aside = fraction[0] * across + fraction[1] * down
            at = (place[1] * dt + place[2] * dt**2 / 2)[:, None]
            angle = (turn[0] + turn[1] * dt + turn[2] * dt**2 / 2)[:, None]
            x = points[..., 0] + np.float32(aside[0] - at.real)
            y = points[..., 1] + np.float32(aside[1] - at.imag)
            c = np.float32(np.cos(angle) / tag.size * modules)
            s = np.float32(np.sin(angle) / tag.size * modules)
            middle = np.float32((len(padded) - 1) / 2)
            where = x * c + y * s + middle, middle - (y * c - x * s)
            value += cv2.remap(padded, *where, cv2.INTER_NEAREST)
            cover += cv2.remap(opaque, *where, cv2.INTER_NEAREST)
        size = columns, rows
        value = cv2.resize(value / SHUTTERS, size, interpolation=cv2.INTER_AREA)
        cover = cv2.resize(cover / SHUTTERS, size, interpolation=cv2.INTER_AREA)
        part = picture[v0:v1, u0:u1]
        drawn = cv2.GaussianBlur(part * (1 - cover) + value, (0, 0), SHARPNESS)
        part[:] = np.rint(drawn)


def bits(number: int, family: int) -> np.ndarray:
    """Return the gray levels of the modules of a tag, with its white margin; below 0 of a dot."""
    if number < 0:
        steps = np.arange(-15.5, 16)
        return np.where(np.hypot(steps, steps[:, None]) > 8, PAPER, INK).astype(np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(family)
    modules = dictionary.markerSize + 2
    code = cv2.aruco.generateImageMarker(dictionary, number, modules)
    code = np.pad(code, QUIET, constant_values=255)
    return np.where(code > 0, PAPER, INK).astype(np.float32)
