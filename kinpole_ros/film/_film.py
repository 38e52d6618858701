"""Tags and dots of a film as markers in the plane of motion: the corners of a tag, and each dot."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags import write_points
from kinpole_ros.film._dots import Dots
from kinpole_ros.film._families import smallest
from kinpole_ros.film._filmed import Filmed, FilmOptions, Seen
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._tags import LEAST_PICTURES, NO_TAGS, TagFinder
from kinpole_ros.film._video import FilmError, Progress, Video

SAME_STAMP = 1e6  # ns; a picture may be so much earlier than --at


def read_film(
    path: str | Path, options: FilmOptions | None = None, progress: Progress | None = None
) -> Filmed:
    """
    Find the tags of a film, follow chosen dots, and place them in the plane of motion.

    `progress` is called with the fraction done. Raises FilmError if the film cannot be read, or
    shows no tags.
    """
    options = options or FilmOptions()
    options.check()
    video = Video(path)
    seen = _search(video, options, progress)
    filmed = place_seen(seen, options)
    return replace(filmed, assumed=[_film_line(video, seen, options), *filmed.assumed])


def film_to_bag(
    path: str | Path,
    output: str | Path,
    options: FilmOptions | None = None,
    progress: Progress | None = None,
) -> Filmed:
    """
    Write the tags and dots of a film to an .mcap bag, as MarkerArray on /markers, and return them.

    The arguments, and the errors, are those of `read_film`.
    """
    filmed = read_film(path, options, progress)
    write_points(output, filmed.names, filmed.stamps, filmed.points)
    return filmed


def _search(video: Video, options: FilmOptions, progress: Progress | None) -> Seen:
    """Find the tags in all pictures, and follow the dots from that in which they are chosen."""
    finder = TagFinder(options.family)
    stamps, found, places = [], [], []
    picture, dots = (0, 0), None
    chosen = np.reshape([(place.real, place.imag) for place in options.points.values()], (-1, 2))
    for stamp, gray in video.pictures():
        height, width = gray.shape
        if picture not in ((0, 0), (width, height)):
            video.cut = f'{video.path}: the size of its pictures changes; what follows is left out'
            break
        picture = width, height
        tags, corners = finder.find(gray) if options.ruler is None else NO_TAGS
        stamps.append(stamp)
        found.append((tags, corners.astype(np.float32)))
        if dots is not None:
            places.append(dots.follow(gray))
        elif options.points and stamp >= options.at * 1e9 - SAME_STAMP:
            dots = Dots(gray, list(options.points), chosen)
            places.append(dots.places)
        else:
            places.append(np.full(chosen.shape, np.nan))
        if progress is not None and video.count:
            progress(min(1.0, len(stamps) / video.count))
    seen = gather(stamps, found, picture, finder)
    if options.points and dots is None:
        raise FilmError(f'--at is {options.at:g} s, and {video.path} ends before')
    if not seen.tags and options.ruler is None:
        raise _no_tags(video, seen, finder, bool(options.points))
    return replace(seen, dots=np.array(places))


def _no_tags(video: Video, seen: Seen, finder: TagFinder, has_points: bool) -> FilmError:
    """Return the error of a film without tags that can be used."""
    count = f'{len(seen.stamps)} pictures were searched'
    if video.cut:
        count += f', and {video.cut}'
    if finder.mirrored and not seen.unused:
        return FilmError(
            f'{video.path} shows tags of family {finder.mirrored} as in a mirror; fix: mirror it, '
            'as by ffmpeg -i IN -vf hflip OUT.mp4'
        )
    fix = 'tape tags of `kinpole film --print` on the links, and film nearer, in more light'
    if has_points:
        fix = 'give --scale'
    if any(finder.twice.values()):
        fix = 'print a number once, and tape another tag on each link'
    found = f'; seen and not used: {"; ".join(seen.unused)}' if seen.unused else ''
    return FilmError(
        f'{video.path} shows no tag in {LEAST_PICTURES} pictures or more ({count}{found}); '
        f'fix: {fix}'
    )


def gather(
    stamps: list[int],
    found: list[tuple[list[int], np.ndarray]],
    picture: tuple[int, int],
    finder: TagFinder,
    family: str = '',
) -> Seen:
    """
    Return the tags, and corners (n, 4, 2), of each picture as arrays.

    The family is that of the finder, but for tags that another program found.
    """
    counts = Counter(tag for tags, _ in found for tag in tags)
    unused = finder.unused(counts)
    kept = sorted(tag for tag in counts if tag not in unused)
    columns = {tag: k for k, tag in enumerate(kept)}
    pixels = np.full((len(stamps), len(kept), 4, 2), np.nan, np.float32)
    for row, (tags, places) in enumerate(found):
        for tag, place in zip(tags, places, strict=True):
            if tag in columns:
                pixels[row, columns[tag]] = place
    no_dots = np.empty((len(stamps), 0, 2))
    texts = [f'{tag} ({why})' for tag, why in unused.items()]
    texts += [
        f'{", ".join(map(str, tags))} (of family {smallest(name, tags)})'
        for name, tags in finder.others.items()
        if tags
    ]
    family = family or finder.name(kept)
    return Seen(kept, np.array(stamps, np.int64), pixels, no_dots, picture, family, tuple(texts))


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
