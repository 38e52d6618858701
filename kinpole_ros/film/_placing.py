"""Tags and dots of pictures, placed in the plane of motion by the tags of the ground or a ruler."""

from typing import NamedTuple

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
from kinpole_ros.film._tags import LEAST_PICTURES
from kinpole_ros.film._turning import Turning, place_turning
from kinpole_ros.findings import Finding, all_words

_MOVES = 3.0  # residuals that the ground moves in the picture, if the camera moves
_SHOWN = 12  # tags or dots that are named
# Tags in space are tried if a corner is off by more, pixels, or if a tag is no square in a larger
# share of its pictures: flat tags are off by 0.03 to 0.1.
_FLAT, _MOST_LOST = 0.1, 0.5
_MUCH_NEARER, _MORE = 0.5, 1.1  # they are taken if corners are so much nearer, or more tags placed
# Of the side: corners that scatter by more do not show which of them are on one body, and those
# that are farther off do not move in one plane.
_MOST_SCATTER, _MOST_OFF_PLANE = 0.03, 0.02
_MOST_UNCERTAIN = 0.05  # rad: an axis of the motion that is known less well is none


def place_seen(
    seen: Seen, options: FilmOptions, lens: Lens | None = None, may_turn: bool = True
) -> Filmed:
    """
    Place tags and dots in the plane of motion; raises FilmError.

    Tags that turn out of the picture are placed in space, by a known camera, if they `may_turn`.
    """
    if options.camera is not None:
        lens = read_lens(options.camera, seen.picture)
    pixels, dots = (_straight(seen, marks, options, lens) for marks in (seen.pixels, seen.dots))
    if options.ruler is not None:
        *ends, length = options.ruler
        ends = np.array([[end.real, end.imag] for end in ends])
        maps = [map_of_ruler(ends if lens is None else lens.straight(ends), length)]
        corners, heights, lifted = np.empty((len(dots), 0, 4), complex), np.empty(0), None
        by = 'not corrected' if lens is None else f'by {options.camera}'
        assumed = [
            f'plane: the first end of --scale is the origin, x toward the second, {length:.4g} m '
            f'away; the camera stands still, square to the plane; lens {by}; to change: --scale, '
            '--camera FILE'
        ]
    else:
        placed = _place_tags(seen, pixels, options, lens, may_turn)
        corners, heights, maps, assumed, lifted = placed
        if lifted is not None and options.points:
            raise seen.refused(
                '--points are placed in the plane of motion, which is seen from its side, as the '
                'tags turn out of the picture; fix: leave them out, or film along the axis'
            )
    rows = zip(dots, [maps[min(k, len(maps) - 1)] for k in range(len(dots))], strict=True)
    places = np.array([plane.to_plane(row) for row, plane in rows]).reshape(len(dots), -1)
    named = dict(zip(options.points, places.T, strict=True))
    if named:
        assumed.insert(len(assumed) - 1, _dot_line(named, options))
    high = dict(zip(seen.tags, heights.tolist(), strict=True))
    tags = tuple(seen.tags)
    return Filmed(
        tags, seen.stamps, corners, named, high, maps, lens, seen.picture, assumed, lifted
    )


class _Placed(NamedTuple):
    """Corners (T, n, 4), complex, m; heights (n,) of tags, m; maps; what was assumed; `Filmed`."""

    corners: np.ndarray
    heights: np.ndarray
    maps: list[PlaneMap]
    assumed: list[str]
    corner_heights: np.ndarray | None = None


def _place_tags(
    seen: Seen, pixels: np.ndarray, options: FilmOptions, lens: Lens | None, may_turn: bool
) -> _Placed:
    """Place tags in the plane of motion, or in space where they turn out of the picture."""
    views, columns = different_views(pixels)
    matrix = lens.matrix if lens is not None else None
    plane, heights = fit_plane(views, columns, options.size, seen.picture, matrix)
    heights = np.append(heights, np.zeros(len(seen.tags) - len(heights)))  # of tags never whole
    corners = plane.to_plane(pixels, heights[:, None])
    pixel = options.size / np.median(np.linalg.norm(np.diff(views, axis=1), axis=-1))
    leave_out_hidden(corners, options.size)
    lost = _share_off(pixels, corners)
    if lens is not None and may_turn and (plane.residual > _FLAT or lost.max() > _MOST_LOST):
        turning = place_turning(pixels, options.size, lens.matrix, seen.picture)
        if turning is not None and _is_better(turning, corners, plane):
            return _placed_in_space(seen, turning, options, pixel)
    is_lost = lost.max() > _MOST_LOST
    lost_text = _lost_text(seen, corners, lost, options, lens) if is_lost else ''
    maps, ground_text = _on_ground(corners, seen.tags, plane, options, pixel)
    _complete_ground(corners, seen.tags, options)
    lens_text = f'too (it bends by {abs(plane.bending):.1%} at the edge of the picture)'
    if lens is not None:
        lens_text = f'by {options.camera or "its CameraInfo"}'
    if heights.any():
        lens_text += f'; the heights of tags differ by {np.ptp(heights) * 1e3:.2g} mm'
    lines = [
        f'{_tag_line(seen, corners, options)}; noise of a corner {plane.residual:.2g} pixels '
        f'or {plane.residual * pixel * 1e3:.2g} mm{lost_text}; to change: --size 40mm, --family',
        f'plane: {ground_text}; perspective such that all tags are squares of one size, lens '
        f'{lens_text}; to change: --ground 7, --camera FILE',
    ]
    return _Placed(corners, heights, maps, lines)


def _placed_in_space(seen: Seen, turning: Turning, options: FilmOptions, pixel: float) -> _Placed:
    """Return tags that turn out of the picture, in the axes of the ground; raises FilmError."""
    if turning.residual * pixel > _MOST_OFF_PLANE * options.size:
        raise seen.refused(
            f'the tags turn out of the picture, and are {turning.residual:.2g} pixels off any '
            'motion in one plane: the camera moves, or the motion is in space; fix: hold the '
            'camera by a tripod, and see that each tag is stiff'
        )
    if not turning.deviation < _MOST_UNCERTAIN:
        raise seen.refused(
            'the tags turn out of the picture, and show the axis of their motion to '
            f'{np.degrees(turning.deviation):.2g} deg only; fix: film a wider motion'
        )
    if turning.scatter > _MOST_SCATTER * options.size:
        raise seen.refused(
            f'the tags turn out of the picture, and their poses are known to '
            f'{turning.along * 1e3:.2g} mm only along the line of sight, too little for tags of '
            f'{options.size * 1e3:.4g} mm; fix: larger tags, or nearer, or film along the axis '
            'about which they turn'
        )
    corners = turning.corners.copy()
    maps, ground_text = _on_ground(corners, seen.tags, turning.plane, options, pixel, turning.along)
    _complete_ground(corners, seen.tags, options)
    axis = ', '.join(f'{x:.3f}' for x in turning.normal)
    lines = [
        f'{_tag_line(seen, corners, options)}; noise of a corner {turning.residual:.2g} pixels; to '
        'change: --size 40mm, --family',
        f'plane: {ground_text}; tags turn out of the picture, so each is placed in space by its '
        f'pose, to {turning.along * 1e3:.2g} mm along the line of sight and '
        f'{turning.across * 1e3:.2g} mm across; the axis of the motion is ({axis}) to '
        f'{np.degrees(turning.deviation):.1g} deg, right, down and away from the camera; lens by '
        f'{options.camera or "its CameraInfo"}; to change: --ground 7, --camera FILE',
    ]
    return _Placed(corners, turning.heights.mean(axis=1), maps, lines, turning.heights)


def _share_off(pixels: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the share (n,) of pictures with a tag in which its corners are no square."""
    found = np.isfinite(pixels).all(axis=(2, 3))
    whole = np.isfinite(corners).all(axis=2)
    return np.asarray((found & ~whole).sum(axis=0) / np.maximum(found.sum(axis=0), 1))


def _is_better(turning: Turning, corners: np.ndarray, plane: PlaneMap) -> bool:
    """Return whether tags in space are seen more often, or nearer, than in one plane."""
    own, flat = (np.isfinite(part).all(axis=2).sum() for part in (turning.corners, corners))
    is_nearer = turning.residual < _MUCH_NEARER * plane.residual
    return bool(own > _MORE * flat or (is_nearer and own >= flat))


def _lost_text(
    seen: Seen, corners: np.ndarray, lost: np.ndarray, options: FilmOptions, lens: Lens | None
) -> str:
    """Name the tag that is no square most often; raises FilmError if no other tag is left."""
    worst = int(lost.argmax())
    about = {'tag': seen.tags[worst], 'size': options.size * 1e3, 'share': float(lost[worst])}
    code = 'tag_no_square' if lens is None else 'tag_no_square_by_camera'
    words = Finding(code, values=about).words()
    if np.isfinite(corners).all(axis=2).sum(axis=0).max() < LEAST_PICTURES:
        raise seen.refused(words)
    return f'; {words}'


def _complete_ground(corners: np.ndarray, tags: list[int], options: FilmOptions) -> None:
    """Place tags of the ground, which stand still, also where they are hidden, in place."""
    for tag in options.ground:
        if tag in tags:
            corners[:, tags.index(tag)] = _median(corners[:, tags.index(tag)])


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
    corners: np.ndarray,
    tags: list[int],
    plane: PlaneMap,
    options: FilmOptions,
    pixel: float,
    in_space: float = 0.0,
) -> tuple[list[PlaneMap], str]:
    """
    Move corners (T, n, 4), in place, and the map to the axes of the ground; return a text.

    `in_space` is the deviation of the place of a tag, m, that is known by its pose.
    """
    own = [tags.index(tag) for tag in options.ground if tag in tags]
    if not own:
        ids = ', '.join(map(str, options.ground))
        return [plane], (
            f'tag {ids} is not seen, so the origin is the {"camera" if in_space else "middle"}'
            f'{"" if in_space else " of the picture"}, and the camera is taken to stand still'
        )
    ground = corners[:, own]
    noise = max(plane.residual * pixel, in_space, 1e-12)
    first = ground[:, 0].mean(axis=-1)
    moved = np.nanmedian(np.abs(first - _median(first)))
    stands_still = not moved > _MOVES * noise
    # All pictures of what stands still may have one error, as a video repeats what it compressed.
    still = _median(ground)[None] if stands_still else ground
    places, angles = _ground_motion(still, is_flat=in_space == 0)
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


def _ground_motion(ground: np.ndarray, is_flat: bool) -> tuple[np.ndarray, np.ndarray]:
    """
    Return places and angles (T,) of the ground, of which corners (T, G, 4) are seen.

    Tags that lean are no squares in the plane: then the edges at their top and bottom give x.
    """
    center, turn = square_poses(ground)
    if not is_flat:
        turn = (ground * [-1, 1, 1, -1]).sum(axis=-1)
        turn /= np.abs(turn)
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
    whole, found = np.isfinite(corners).all(axis=-1), np.isfinite(seen.pixels).all(axis=(2, 3))
    names = ', '.join(map(str, seen.tags[:_SHOWN])) + (', ...' if len(seen.tags) > _SHOWN else '')
    worst = int(whole.sum(axis=0).argmin())
    side = float(np.nanmedian(np.linalg.norm(np.diff(seen.pixels, axis=2), axis=-1)))
    lost = ~whole[:, worst]
    causes = {
        'not found': (lost & ~found[:, worst]).sum(),
        'no square': (lost & found[:, worst]).sum(),
    }
    texts = [f'{cause} in {count}' for cause, count in causes.items() if count]
    cause = f' ({", ".join(texts)})' if texts else ''
    unused = f'; seen and not used: {all_words(seen.unused)}' if seen.unused else ''
    return (
        f'tags: {names} of family {seen.family}, {side:.3g} pixels and {options.size * 1e3:.4g} mm '
        f'wide, {_seen_least(f"tag {seen.tags[worst]}", whole[:, worst])}{cause}{unused}'
    )


def _seen_least(name: str, is_seen: np.ndarray) -> str:
    return f'{name} seen least, in {int(is_seen.sum())} of {len(is_seen)} pictures'
