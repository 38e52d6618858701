"""Tags and dots of pictures, placed in the plane of motion by the tags of the ground or a ruler."""

import numpy as np

from kinpole_ros.film._filmed import Filmed, FilmOptions, Seen
from kinpole_ros.film._ground import (
    PlaneMap,
    different_views,
    fit_plane,
    leave_out_hidden,
    map_of_ruler,
    square_poses,
)
from kinpole_ros.film._lens import Lens, read_lens

_MOVES = 3.0  # residuals that the ground moves in the picture, if the camera moves
_SHOWN = 12  # tags or dots that are named


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
    heights = np.append(heights, np.zeros(len(seen.tags) - len(heights)))  # of tags never whole
    corners = plane.to_plane(pixels, heights[:, None])
    pixel = options.size / np.median(np.linalg.norm(np.diff(views, axis=1), axis=-1))
    leave_out_hidden(corners, options.size)
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


def _at_one_instant(seen: Seen, pixels: np.ndarray, line_time: float) -> np.ndarray:
    """
    Return pixels (T, ..., 2) at the stamps of their pictures.

    A row is exposed later than the one above it. A corner is moved to the stamp along the parabola
    through three pictures; one that is seen in fewer at a time is left out.
    """
    stamp = ((seen.stamps - seen.stamps[0]) * 1e-9).reshape(-1, *[1] * (pixels.ndim - 2))
    # The rows of the sensor run right, up or left in a picture that was turned upright.
    along, sign = ((1, 1), (0, 1), (1, -1), (0, -1))[seen.turns]
    row = sign * (pixels[..., along] - (seen.picture[along] - 1) / 2)
    time = stamp + line_time * row
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


def _dot_line(dots: dict[str, np.ndarray], options: FilmOptions) -> str:
    is_seen = {name: np.isfinite(places) for name, places in dots.items()}
    worst = min(is_seen, key=lambda name: int(is_seen[name].sum()))
    names = ', '.join(list(dots)[:_SHOWN]) + (', ...' if len(dots) > _SHOWN else '')
    return (
        f'dots: {names}, chosen in the picture at {options.at:g} s, '
        f'{_seen_least(worst, is_seen[worst])}; to change: --points, --at'
    )


def _tag_line(seen: Seen, corners: np.ndarray, options: FilmOptions) -> str:
    is_seen = np.isfinite(corners).all(axis=-1)
    names = ', '.join(map(str, seen.tags[:_SHOWN])) + (', ...' if len(seen.tags) > _SHOWN else '')
    worst = int(is_seen.sum(axis=0).argmin())
    side = float(np.nanmedian(np.linalg.norm(np.diff(seen.pixels, axis=2), axis=-1)))
    return (
        f'tags: {names} of family {seen.family}, {side:.3g} pixels and {options.size * 1e3:.4g} mm '
        f'wide, {_seen_least(f"tag {seen.tags[worst]}", is_seen[:, worst])}'
    )


def _seen_least(name: str, is_seen: np.ndarray) -> str:
    return f'{name} seen least, in {int(is_seen.sum())} of {len(is_seen)} pictures'
