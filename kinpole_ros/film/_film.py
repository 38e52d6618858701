"""Tags and dots of a film as markers in the plane of motion: the corners of a tag, and each dot."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags import write_points
from kinpole_ros.film._dots import Dots
from kinpole_ros.film._ground import (
    PlaneMap,
    different_views,
    fit_plane,
    map_of_ruler,
    off_square,
    square_poses,
)
from kinpole_ros.film._lens import Lens, read_lens
from kinpole_ros.film._tags import NO_TAGS, TagFinder
from kinpole_ros.film._video import FilmError, Progress, Video

# m; the black square of a tag that `kinpole film --print` draws.
SIZE = 0.04
_LEAST_FRAMES = 5  # in which a tag is seen, else it is left out
_MOST_OFF = 8.0  # residuals: a tag whose corners are farther off their square is partly hidden
_LEAST_OFF = 0.03  # of the side, at least, which blur may well move a corner
_MOVES = 3.0  # residuals that the ground moves in the picture, if the camera moves
_SHOWN = 12  # tags or dots that are named
SAME_STAMP = 1e6  # ns; a picture may be so much earlier than --at


@dataclass(frozen=True)
class FilmOptions:
    """
    What a film does not tell.

    Attributes
    ----------
    size : float
        Side of the black square of a tag, m.
    ground : tuple of int
        Tags that stand still. The center of the first is the origin, and x points to that of the
        second; with one tag, along its top edge.
    family : str
        A key of `FAMILIES`, or 'auto'.
    camera : str, optional
        The file of the camera.
    line_time : float
        s from one row of a picture to the next (rolling shutter); the stamps are of the middle row.
    points : dict of str to complex
        Dots to follow by name, pixels, x + y i, in the picture at `at`.
    at : float
        s from the first picture to that in which they are chosen.
    ruler : tuple, optional
        Two places, pixels, and their distance, m: the first is the origin, and x points to the
        second. Then no tags are searched.

    """

    size: float = SIZE
    ground: tuple[int, ...] = (0,)
    family: str = 'auto'
    camera: str | None = None
    line_time: float = 0.0
    points: dict[str, complex] = field(default_factory=dict)
    at: float = 0.0
    ruler: tuple[complex, complex, float] | None = None

    def check(self) -> None:
        """Raise FilmError for a value out of range."""
        if not 0 < self.size < 100:
            raise FilmError(f'--size is {self.size}; it must be more than 0 m, the side of a tag')
        if not 0 <= self.line_time < 0.01:
            raise FilmError(f'--line-time is {self.line_time}; it must be from 0 to 0.01 s')
        if self.ruler is not None and not (
            self.points and self.ruler[0] != self.ruler[1] and 0 < self.ruler[2] < 1000
        ):
            raise FilmError('--scale is for --points; it must be two places and their distance, m')


@dataclass(frozen=True)
class Filmed:
    """
    The tags and dots of a film.

    Attributes
    ----------
    tags : tuple of int
        Their numbers.
    stamps : ndarray
        (T,) int64, ns, from the first picture on.
    corners : ndarray
        (T, n, 4), complex, m, in the plane of motion; NaN where not seen.
    dots : dict of str to ndarray
        The places (T,) of dots, likewise.
    heights : dict of int to float
        Heights of tags above the plane of `maps`, m, by a known camera; else 0.
    maps : list of PlaneMap
        The map of each picture, or one for all.
    lens : Lens or None
        The camera, if its file was given.
    picture : tuple of int
        Width and height, pixels.
    assumed : list of str
        What was assumed, and the options that change it, a line each.

    """

    tags: tuple[int, ...]
    stamps: np.ndarray
    corners: np.ndarray
    dots: dict[str, np.ndarray]
    heights: dict[int, float]
    maps: list[PlaneMap]
    lens: Lens | None
    picture: tuple[int, int]
    assumed: list[str]

    @property
    def names(self) -> list[str]:
        """The names of the markers: the corners of tags, and dots."""
        return marker_names(self.tags) + list(self.dots)

    @property
    def places(self) -> np.ndarray:
        """The places (T, N) of the markers, complex, m."""
        corners = self.corners.reshape(len(self.stamps), -1)
        return np.column_stack((corners, *self.dots.values()))

    def to_pixels(self, points: np.ndarray, number: int) -> np.ndarray:
        """Return the pixels (..., 2) of points (...), complex, m, in the picture of a number."""
        pixels = self.maps[min(number, len(self.maps) - 1)].to_pixels(points)
        return self.lens.curved(pixels) if self.lens is not None else pixels


def marker_names(tags: Sequence[int]) -> list[str]:
    """Return the names of corners: tag3_1 is the top left corner of tag 3, then clockwise."""
    return [f'tag{tag}_{k}' for tag in tags for k in range(1, 5)]


@dataclass(frozen=True)
class Seen:
    """
    What the pictures show: tags, stamps (T,), and pixels of corners (T, n, 4, 2), dots (T, m, 2).

    `picture` is the width and height of one.
    """

    tags: list[int]
    stamps: np.ndarray
    pixels: np.ndarray
    dots: np.ndarray
    picture: tuple[int, int]
    family: str


def read_film(
    path: str | Path, options: FilmOptions | None = None, progress: Progress | None = None
) -> Filmed:
    """
    Find the tags of a film, follow chosen dots, and place them in the plane of motion.

    Parameters
    ----------
    path : str or Path
        The video.
    options : FilmOptions, optional
        What it does not tell.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    Filmed

    Raises
    ------
    FilmError
        If it cannot be read, or shows no tags.

    """
    options = options or FilmOptions()
    options.check()
    video = Video(path)
    seen = _search(video, options, progress)
    filmed = place_seen(seen, options)
    return replace(filmed, assumed=[_film_line(video, seen, options), *filmed.assumed])


def place_seen(seen: Seen, options: FilmOptions, lens: Lens | None = None) -> Filmed:
    """Place tags and dots in the plane of motion; raises FilmError."""
    if options.camera is not None:
        lens = read_lens(options.camera, seen.picture)
    pixels, dots = (_straight(seen, marks, options, lens) for marks in (seen.pixels, seen.dots))
    if options.ruler is not None:
        *ends, length = options.ruler
        ends = np.array([[end.real, end.imag] for end in ends])
        maps = [map_of_ruler(ends if lens is None else lens.straight(ends), length)]
        corners, heights = np.empty((len(dots), 0, 4), complex), np.empty(0)
        by = 'not corrected' if lens is None else f'by {options.camera}'
        assumed = [
            f'plane: the first end of --scale is the origin, x toward the second, {length:.4g} m '
            f'away; the camera stands still, square to the plane; lens {by}; to change: --scale, '
            '--camera FILE'
        ]
    else:
        corners, heights, maps, assumed = _place_tags(seen, pixels, options, lens)
    rows = zip(dots, [maps[min(k, len(maps) - 1)] for k in range(len(dots))], strict=True)
    places = np.array([plane.to_plane(row) for row, plane in rows]).reshape(len(dots), -1)
    named = dict(zip(options.points, places.T, strict=True))
    if named:
        assumed.insert(len(assumed) - 1, _dot_line(named, options))
    high = dict(zip(seen.tags, heights.tolist(), strict=True))
    tags = tuple(seen.tags)
    return Filmed(tags, seen.stamps, corners, named, high, maps, lens, seen.picture, assumed)


def _place_tags(
    seen: Seen, pixels: np.ndarray, options: FilmOptions, lens: Lens | None
) -> tuple[np.ndarray, np.ndarray, list[PlaneMap], list[str]]:
    """Return corners (T, n, 4), complex, m, and heights (n,) of tags; maps; what was assumed."""
    views, columns = different_views(pixels)
    matrix = lens.matrix if lens is not None else None
    plane, heights = fit_plane(views, columns, options.size, seen.picture, matrix)
    corners = plane.to_plane(pixels, heights[:, None])
    pixel = options.size / np.median(np.linalg.norm(np.diff(views, axis=1), axis=-1))
    _leave_out_hidden(corners, options.size, plane.residual, pixel)
    maps, ground_text = _on_ground(corners, seen.tags, plane, options, pixel)
    for tag in options.ground:
        if tag in seen.tags:  # it stands still, also where it is hidden
            corners[:, seen.tags.index(tag)] = _median(corners[:, seen.tags.index(tag)])
    lens_text = f'too (it bends by {abs(plane.bending):.1%} at the edge of the picture)'
    if lens is not None:
        lens_text = f'by {options.camera or "its CameraInfo"}'
    if heights.any():
        lens_text += f'; the heights of tags differ by {np.ptp(heights) * 1e3:.2g} mm'
    return (
        corners,
        heights,
        maps,
        [
            f'{_tag_line(seen, corners, options)}; noise of a corner {plane.residual:.2g} pixels '
            f'or {plane.residual * pixel * 1e3:.2g} mm; to change: --size 40mm, --family',
            f'plane: {ground_text}; perspective such that all tags are squares of one size, lens '
            f'{lens_text}; to change: --ground 7, --camera FILE',
        ],
    )


def _straight(
    seen: Seen, pixels: np.ndarray, options: FilmOptions, lens: Lens | None
) -> np.ndarray:
    """Return pixels (T, ..., 2) at the stamps of their pictures, as a perfect lens shows them."""
    pixels = pixels.astype(float)
    if options.line_time:
        pixels = _at_one_instant(seen, pixels, options.line_time)
    return pixels if lens is None else lens.straight(pixels)


def film_to_bag(
    path: str | Path,
    output: str | Path,
    options: FilmOptions | None = None,
    progress: Progress | None = None,
) -> Filmed:
    """
    Write the tags and dots of a film to a bag, as visualization_msgs/MarkerArray on /markers.

    Parameters
    ----------
    path : str or Path
        The video.
    output : str or Path
        The .mcap file.
    options : FilmOptions, optional
        What the film does not tell.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    Filmed

    """
    filmed = read_film(path, options, progress)
    flat = filmed.places
    points = np.stack((flat.real, flat.imag, np.where(np.isnan(flat), np.nan, 0.0)), axis=-1)
    write_points(output, filmed.names, filmed.stamps, points)
    return filmed


def _search(video: Video, options: FilmOptions, progress: Progress | None) -> Seen:
    """Find the tags in all pictures, and follow the dots from that in which they are chosen."""
    finder = None if options.ruler is not None else TagFinder(options.family)
    stamps, found, places = [], [], []
    picture, dots = (0, 0), None
    chosen = np.reshape([(place.real, place.imag) for place in options.points.values()], (-1, 2))
    for stamp, gray in video.pictures():
        height, width = gray.shape
        if picture not in ((0, 0), (width, height)):
            video.cut = f'{video.path}: the size of its pictures changes; what follows is left out'
            break
        picture = width, height
        tags, corners = finder.find(gray) if finder is not None else NO_TAGS
        stamps.append(stamp)
        found.append((tags, corners.places.astype(np.float32)))
        if dots is not None:
            places.append(dots.follow(gray))
        elif options.points and stamp >= options.at * 1e9 - SAME_STAMP:
            dots = Dots(gray, list(options.points), chosen)
            places.append(dots.places)
        else:
            places.append(np.full(chosen.shape, np.nan))
        if progress is not None and video.count:
            progress(min(1.0, len(stamps) / video.count))
    seen = gather(stamps, found, picture, finder.family if finder is not None else '')
    if options.points and dots is None:
        raise FilmError(f'--at is {options.at:g} s, and {video.path} ends before')
    if not seen.tags and finder is not None:
        cut = f', and {video.cut}' if video.cut else ''
        fix = 'tape tags of `kinpole film --print` on the links, and film nearer, in more light'
        if options.points:
            fix = 'give --scale'
        raise FilmError(
            f'{video.path} shows no tag in {_LEAST_FRAMES} pictures ({len(stamps)} were searched'
            f'{cut}); fix: {fix}'
        )
    return replace(seen, dots=np.array(places))


def gather(
    stamps: list[int],
    found: list[tuple[list[int], np.ndarray]],
    picture: tuple[int, int],
    family: str,
) -> Seen:
    """Return the tags, and corners (n, 4, 2), of each picture as arrays."""
    counts: dict[int, int] = {}
    for tags, _ in found:
        for tag in tags:
            counts[tag] = counts.get(tag, 0) + 1
    kept = sorted(tag for tag, count in counts.items() if count >= _LEAST_FRAMES)
    columns = {tag: k for k, tag in enumerate(kept)}
    pixels = np.full((len(stamps), len(kept), 4, 2), np.nan, np.float32)
    for row, (tags, places) in enumerate(found):
        for tag, place in zip(tags, places, strict=True):
            if tag in columns:
                pixels[row, columns[tag]] = place
    no_dots = np.empty((len(stamps), 0, 2))
    return Seen(kept, np.array(stamps, np.int64), pixels, no_dots, picture, family)


def _at_one_instant(seen: Seen, pixels: np.ndarray, line_time: float) -> np.ndarray:
    """
    Return pixels (T, ..., 2) at the stamps of their pictures.

    A row is exposed later than the one above it. A corner is moved to the stamp along the parabola
    through three pictures; one that is seen in fewer at a time is left out.
    """
    stamp = (seen.stamps * 1e-9).reshape(-1, *[1] * (pixels.ndim - 2))
    time = stamp + line_time * (pixels[..., 1] - (seen.picture[1] - 1) / 2)
    moved = np.full(pixels.shape, np.nan)
    for first in (-1, -2, 0):  # the middle one of three pictures, else the last or the first
        steps = [first, first + 1, first + 2]
        rows = np.arange(max(0, -first), len(pixels) - max(0, first + 2))
        near = [(time[rows + step], pixels[rows + step]) for step in steps]
        total = np.zeros((len(rows), *pixels.shape[1:]))
        for k, (own, place) in enumerate(near):
            share = np.ones(own.shape)
            for other, _ in near[:k] + near[k + 1 :]:
                share = share * (stamp[rows] - other) / (own - other)
            total += share[..., None] * place
        target = moved[rows]
        moved[rows] = np.where(np.isnan(target), total, target)
    return moved


def _leave_out_hidden(corners: np.ndarray, size: float, residual: float, pixel: float) -> None:
    """Set the corners (T, n, 4) of tags that are no squares to NaN, in place."""
    with np.errstate(invalid='ignore'):
        off = np.abs(off_square(corners, size)).max(axis=-1) / pixel
        corners[off > max(_MOST_OFF * residual, _LEAST_OFF * size / pixel)] = np.nan


def _on_ground(
    corners: np.ndarray, tags: list[int], plane: PlaneMap, options: FilmOptions, pixel: float
) -> tuple[list[PlaneMap], str]:
    """Move corners (T, n, 4), in place, and the map to the axes of the ground; return a text."""
    own = [tags.index(tag) for tag in options.ground if tag in tags]
    if not own:
        ids = ', '.join(map(str, options.ground))
        return [plane], (
            f'tag {ids} is not seen, so the origin is the middle of the picture, and the camera is '
            'taken to stand still'
        )
    ground = corners[:, own]
    noise = max(plane.residual * pixel, 1e-12)
    first = ground[:, 0].mean(axis=-1)
    moved = np.nanmedian(np.abs(first - _median(first)))
    stands_still = not moved > _MOVES * noise
    # All pictures of what stands still may have one error, as a video repeats what it compressed.
    places, angles = _ground_motion(_median(ground)[None] if stands_still else ground)
    corners -= places[:, None, None]
    corners *= np.exp(-1j * angles)[:, None, None]
    maps = [plane.moved(complex(p), float(a)) for p, a in zip(places, angles, strict=True)]
    arm = float(np.abs(_median(corners[:, own[1]].mean(axis=-1)))) if len(own) > 1 else options.size
    axis = f'toward tag {tags[own[1]]}' if len(own) > 1 else 'along its top edge'
    camera = 'the camera stands still'
    if not stands_still:
        camera = f'the camera moves by {moved / pixel:.2g} pixels, which the ground corrects'
    text = f'tag {tags[own[0]]} is the origin, x {axis} to {1e3 * noise / arm:.1g} mrad; {camera}'
    return maps, text


def _ground_motion(ground: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places and angles (T,) of the ground, of which corners (T, G, 4) are seen."""
    center, turn = square_poses(ground)
    # The other tags of the ground, as the first one sees them.
    shape = (ground - center[:, :1, None]) * np.conj(turn[:, :1, None])
    shape = _median(shape)
    if len(shape) > 1:
        shape *= np.exp(-1j * np.angle(shape[1].mean()))
    is_seen = np.isfinite(ground) & np.isfinite(shape)
    count = np.maximum(is_seen.sum(axis=(1, 2)), 1)
    seen, wanted = np.where(is_seen, ground, 0), np.where(is_seen, shape, 0)
    middle = seen.sum(axis=(1, 2)) / count
    middle_wanted = wanted.sum(axis=(1, 2)) / count
    arm = np.where(is_seen, ground - middle[:, None, None], 0)
    arm_wanted = np.where(is_seen, shape - middle_wanted[:, None, None], 0)
    angle = np.unwrap(np.angle((arm * np.conj(arm_wanted)).sum(axis=(1, 2))))
    place = middle - middle_wanted * np.exp(1j * angle)
    unseen = ~is_seen.any(axis=(1, 2))
    place[unseen], angle[unseen] = np.nan, np.nan
    return place, angle


def _median(numbers: np.ndarray) -> np.ndarray:
    """Return the medians (...) of both parts of complex numbers (T, ...), without NaN."""
    return np.asarray(np.nanmedian(numbers.real, axis=0) + 1j * np.nanmedian(numbers.imag, axis=0))


def _film_line(video: Video, seen: Seen, options: FilmOptions) -> str:
    count = len(seen.stamps)
    seconds = float(seen.stamps[-1]) * 1e-9
    rate = f' at {1e9 / float(np.median(np.diff(seen.stamps))):.4g} Hz' if count > 1 else ''
    late = f', {video.late} left out whose stamps do not increase' if video.late else ''
    cut = f'; {video.cut}' if video.cut else ''
    shutter = f'{options.line_time * 1e6:.3g} us' if options.line_time else 'none'
    return (
        f'film: {count} pictures of {seen.picture[0]} x {seen.picture[1]} in {seconds:.4g} s{rate} '
        f'by the stamps of the file{late}; rolling shutter: {shutter}{cut}; to change: --line-time'
    )


def _dot_line(dots: dict[str, np.ndarray], options: FilmOptions) -> str:
    shares = {name: np.isfinite(places).mean() for name, places in dots.items()}
    worst = min(shares, key=lambda name: shares[name])
    names = ', '.join(list(dots)[:_SHOWN]) + (', ...' if len(dots) > _SHOWN else '')
    return (
        f'dots: {names}, chosen in the picture at {options.at:g} s, seen in {shares[worst]:.0%} of '
        f'the pictures or more ({worst}); to change: --points, --at'
    )


def _tag_line(seen: Seen, corners: np.ndarray, options: FilmOptions) -> str:
    shares = np.isfinite(corners).all(axis=-1).mean(axis=0)
    names = ', '.join(map(str, seen.tags[:_SHOWN])) + (', ...' if len(seen.tags) > _SHOWN else '')
    worst = int(shares.argmin())
    side = float(np.nanmedian(np.linalg.norm(np.diff(seen.pixels, axis=2), axis=-1)))
    return (
        f'tags: {names} of family {seen.family}, {side:.3g} pixels and {options.size * 1e3:.4g} mm '
        f'wide, seen in {shares.min():.0%} of the pictures or more (tag {seen.tags[worst]})'
    )
