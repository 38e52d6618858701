"""Tags and dots of a film as markers in the plane of motion: the corners of a tag, and each dot."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags import leave_out_repeats, topics, write_points
from kinpole_ros.film._backward import TagsBothWays
from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._dots import Dots
from kinpole_ros.film._families import smallest
from kinpole_ros.film._filmed import Filmed, FilmOptions, Seen
from kinpole_ros.film._lens import Lens, rectified_lens
from kinpole_ros.film._placing import place_seen
from kinpole_ros.film._recorded_pictures import bag_messages, film_topic, is_bag_of_pictures
from kinpole_ros.film._tags import LEAST_PICTURES, TagFinder
from kinpole_ros.film._video import Progress, Video
from kinpole_ros.findings import Finding, all_words
from kinpole_ros.messages import CAMERA_INFO, DETECTIONS, Detections

_LEAST_STEP = 0.05  # pixels; in a still film the compression moves corners by less
SAME_STAMP = 1e6  # ns; a picture may be so much earlier than --at


def read_film(
    path: str | Path, options: FilmOptions | None = None, progress: Progress | None = None
) -> Filmed:
    """
    Find the tags of a film, follow chosen dots, and place them in the plane of motion.

    The film is a video, a folder of pictures, or a bag of pictures or of tags that are found
    already. `progress` is called with the fraction done. Raises FilmError if the film cannot be
    read, or shows no tags.
    """
    options = options or FilmOptions()
    options.check()
    if is_bag_of_pictures(str(path)):
        topic, kind = film_topic(str(path), options.topic)
        if kind == DETECTIONS:
            return _read_detections(str(path), topic, options)
    video = Video(path, options.rate, options.topic)
    seen = _search(video, options, progress)
    marks = np.concatenate((seen.pixels.reshape(len(seen.stamps), -1, 2), seen.dots), axis=1)
    kept = leave_out_repeats(video.path, 'pictures', seen.stamps, marks, options.rate, _LEAST_STEP)
    own = kept.is_kept
    seen = replace(seen, stamps=kept.stamps, pixels=seen.pixels[own], dots=seen.dots[own])
    late = Finding('late_pictures', values={'count': video.late}) if video.late else None
    found = [one.words() for one in (kept.finding, late) if one is not None]
    interlaced = 'interlaced, so each field is a picture of its own' if video.is_interlaced else ''
    shutter = f'{options.line_time * 1e6:.3g} us' if options.line_time else 'none'
    changed = [f'rolling shutter: {shutter}', 'to change: --line-time, --rate']
    cut = video.cut.words() if video.cut is not None else ''
    line = _film_line(seen, video.clock, [*found, interlaced, cut, *changed])
    filmed = place_seen(seen, options)
    return replace(
        filmed,
        assumed=[line, *filmed.assumed],
        video=video,
        numbers=np.flatnonzero(own),
    )


def _read_detections(path: str, topic: str, options: FilmOptions) -> Filmed:
    """Place the tags that another program found in the pictures of a bag."""
    if options.points or options.line_time or options.rate:
        raise FilmError(
            f'{path} has tags on {topic} and no pictures, and --points, --line-time and --rate are '
            'for pictures; fix: leave them out'
        )
    found = [seen for _, seen in bag_messages(path, topic)]
    stamps = np.array([seen.stamp for seen in found], np.int64)
    is_later = np.diff(np.maximum.accumulate(stamps), prepend=-1) > 0
    rows = [(found[k].tags, found[k].corners) for k in np.flatnonzero(is_later)]
    picture, lens = _picture_of_detections(path, found)
    family = next((seen.family for seen in found if seen.family), '')
    finder = TagFinder()
    seen = gather(stamps[is_later].tolist(), rows, picture, finder, family)
    if not seen.tags:
        raise _no_tags(path, seen, finder, None, 'see to the detector')
    late = Finding('late_pictures', values={'count': int((~is_later).sum())})
    notes = [] if is_later.all() else [late.words()]
    line = _film_line(seen, f'by the headers of {topic}', notes)
    filmed = place_seen(replace(seen, path=path), options, lens)
    return replace(filmed, assumed=[line, *filmed.assumed])


def _picture_of_detections(
    path: str, found: list[Detections]
) -> tuple[tuple[int, int], Lens | None]:
    """Return the size of pictures and the camera by the CameraInfo of a bag, if there is one."""
    infos = [topic for topic, kind in topics(path).items() if kind == CAMERA_INFO]
    for topic in infos if len(infos) == 1 else ():
        for _, info in bag_messages(path, topic):
            if min(info.width, info.height) > 0:
                return (int(info.width), int(info.height)), rectified_lens(info)
    corners = np.concatenate([seen.corners.reshape(-1, 2) for seen in found] or [np.ones((1, 2))])
    width, height = np.ceil(np.append(corners, [[1, 1]], axis=0).max(axis=0)).astype(int).tolist()
    return (width, height), None


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
    stamps, places = [], []
    tagged = TagsBothWays(finder)
    picture, dots = (0, 0), None
    chosen = np.reshape([(place.real, place.imag) for place in options.points.values()], (-1, 2))
    for stamp, gray in video.pictures():
        height, width = gray.shape
        if picture not in ((0, 0), (width, height)):
            video.cut = Finding('resized_film', values={'path': video.path})
            break
        picture = width, height
        stamps.append(stamp)
        if options.ruler is None:
            tagged.add(gray)
        if dots is not None:
            places.append(dots.follow(gray))
        elif options.points and stamp - stamps[0] >= options.at * 1e9 - SAME_STAMP:
            dots = Dots(gray, list(options.points), chosen)
            places.append(dots.places)
        else:
            places.append(np.full(chosen.shape, np.nan))
        if progress is not None and video.count:
            progress(min(1.0, len(stamps) / video.count))
    tagged.finish(video)
    seen = gather(stamps, tagged.found, picture, finder)
    if options.points and dots is None:
        raise FilmError(f'--at is {options.at:g} s, and {video.path} ends before')
    if not seen.tags and options.ruler is None:
        fix = 'tape tags of `kinpole film --print` on the links, and film nearer, in more light'
        fix = 'give --scale' if options.points else fix
        raise _no_tags(video.path, seen, finder, video.cut, fix)
    return replace(seen, dots=np.array(places), turns=video.turns, path=video.path)


def _no_tags(
    path: str, seen: Seen, finder: TagFinder, damage: Finding | None, fix: str
) -> FilmError:
    """Return the error of a film without tags that can be used."""
    if finder.mirrored and not seen.unused:
        return mirror_fault(path, finder, 'mirror it, as by ffmpeg -i IN -vf hflip OUT.mp4')
    if any(finder.twice.values()):
        fix = 'print a number once, and tape another tag on each link'
    texts = [f'seen and not used: {all_words(seen.unused)}'] if seen.unused else []
    texts += [damage.words()] if damage is not None else []
    notes = ''.join(f'; {text}' for text in texts)
    return FilmError(
        f'{path} shows no tag: none was found in {LEAST_PICTURES} or more of its '
        f'{len(seen.stamps)} pictures{notes}; fix: {fix}'
    )


def mirror_fault(source: str, finder: TagFinder, fix: str) -> FilmError:
    """Return the error of a film or a camera whose pictures are mirrored."""
    return FilmError(f'{source} shows tags of family {finder.mirrored} as in a mirror; fix: {fix}')


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
    left_out = list(unused.values())
    for name, tags in finder.others.items():
        if tags:
            about = {'tags': ', '.join(map(str, tags)), 'family': smallest(name, tags)}
            left_out.append(Finding('tags_of_others', values=about))
    family = family or finder.name(kept)
    return Seen(
        kept, np.array(stamps, np.int64), pixels, no_dots, picture, family, unused=tuple(left_out)
    )


def _film_line(seen: Seen, clock: str, notes: list[str]) -> str:
    """Say how many pictures there are, and when they were taken, with notes that are not empty."""
    count = len(seen.stamps)
    seconds = float(seen.stamps[-1] - seen.stamps[0]) * 1e-9
    rate = f' at {1e9 / float(np.median(np.diff(seen.stamps))):.4g} Hz' if count > 1 else ''
    texts = [
        f'film: {count} pictures of {seen.picture[0]} x {seen.picture[1]} in {seconds:.4g} s{rate} '
        f'{clock}',
        *filter(None, notes),
    ]
    return '; '.join(texts)
