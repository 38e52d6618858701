"""`kinpole fit`: the dimensions of a scene from a bag of markers, as lines, and as a scene."""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from kinpole_ros.bags import Truncated, bag_files, in_place_of, read_frames
from kinpole_ros.linkage.fit import fit_scene, fitted_lines, free_dimensions
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import Scene, SceneError, load_scene, rewritten, scene_text
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.parameters import ParameterError, Settings, load_settings, settings_from
from kinpole_ros.tracking.tracker import Tracker

# Frames at a time, to tell how far it is.
_AT_ONCE = 1000
# Share of the time that reading takes.
_READING = 0.2


def fit_bag(
    scene: str,
    bag: str | Path,
    config: str | None = None,
    free: Sequence[Sequence[str]] = (),
    output: str | Path | None = None,
    topic: str | None = None,
    progress: Callable[[float], None] | None = None,
    report: Callable[[Truncated], None] | None = None,
) -> list[str]:
    """
    Fit the scene to the markers of a bag; returns lines to print, and writes the scene to `output`.

    `report` is called with what a bag lacks that is not whole.

    Raises SceneError, ParameterError or BagError for what cannot be used, with the fix.
    """
    bag_files(bag)  # a table is refused before its scene is read
    loaded = load_scene(scene)
    numbers = free_dimensions(loaded, list(chain(*free)) or loaded.free)
    if not numbers:
        raise SceneError(f'{scene}: its joints have no dimensions to be fitted: add joints')
    settings = _settings(loaded, scene, config)
    theory = load_theory(settings)

    def part(first: float, share: float) -> Callable[[float], None] | None:
        return None if progress is None else (lambda done: progress(first + share * done))

    topic = topic or (settings.marker_topic if config else None)
    frames, _ = read_frames(
        bag, topic, None, part(0.0, _READING), identity=settings.marker_identity
    )
    found = fit_scene(theory, _estimates(settings, frames, part(_READING, 0.7)), numbers)
    if progress is not None:
        progress(1.0)
    lines = fitted_lines(found)
    if output is None:
        return lines
    changes = {row.dimension: row.value for row in found.dimensions if not row.undetermined}
    # Both coordinates of a point are written.
    changes = {
        one: changes.get(one, one.value)
        for one in loaded.equations.dimensions
        if one.path in {other.path for other in changes}
    }
    text = rewritten(scene_text(scene), changes)
    with in_place_of(output) as target:
        target.write_text(text, encoding='utf-8')
    lines.append(f'written to {output}')
    try:
        load_scene(text if '\n' in text else output)
    except SceneError as error:
        lines.append(f'as fitted it does not move as it is driven: {error}')
    return lines


def _settings(scene: Scene, name: str, config: str | None) -> Settings:
    if config is not None:
        return load_settings(config, changes={'scene': name})
    if not scene.markers:
        raise ParameterError(f'{name} has no markers: add them, or name a parameter file, --config')
    values: dict[str, object] = {'scene': name, 'bodies': list(scene.markers)}
    for body, markers in scene.marker_names.items():
        values[f'{body}.markers'] = list(markers)
    return settings_from(values)


def _estimates(
    settings: Settings, frames: list[MarkerFrames], progress: Callable[[float], None] | None
) -> Iterator[Estimate]:
    """All estimates; of derivatives no more than the first is wanted."""
    tracker = Tracker(settings)
    total = sum(len(part.stamps) for part in frames)
    done = 0
    for part in frames:
        for first in range(0, len(part.stamps), _AT_ONCE):
            some = part_of(part, slice(first, first + _AT_ONCE))
            yield from tracker.add(some, 1)
            done += len(some.stamps)
            if progress is not None:
                progress(done / total)
