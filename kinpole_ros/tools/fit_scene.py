"""`kinpole fit`: the dimensions of a scene from a bag of markers."""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from kinpole_ros.bags import Truncated, bag_files, in_place_of, read_frames
from kinpole_ros.linkage.fit import fit_scene, fitted_lines, free_dimensions
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import Scene, SceneError, load_scene, scene_text
from kinpole_ros.mechanism._scene_file import rewritten
from kinpole_ros.settings import ParameterError, Settings, load_settings, settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

# Frames between two reports of the progress.
_BLOCK = 1000
# Fractions of the time until reading, and tracking, are done.
_READING, _TRACKING = 0.2, 0.9


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
    Fit the scene to the markers of a bag; return lines to print, and write it to `output`.

    Without `config`, the bodies and markers of the scene are tracked. `free` are names of the
    dimensions to fit; without any, those that the scene lists as free, or all. `progress` is called
    with the fraction done, `report` with what is missing from a truncated bag. Raises SceneError,
    ParameterError or BagError for what cannot be used.
    """
    bag_files(bag)  # a table is refused before its scene is read
    loaded = load_scene(scene)
    numbers = free_dimensions(loaded, list(chain(*free)) or loaded.free)
    if not numbers:
        raise SceneError(f'{scene}: its joints have no dimensions to fit; add joints')
    settings = _settings(loaded, scene, config)
    theory = load_theory(settings)

    def stage(first: float, last: float) -> Callable[[float], None] | None:
        if progress is None:
            return None
        return lambda fraction: progress(first + (last - first) * fraction)

    topic = topic or (settings.marker_topic if config else None)
    identity = settings.marker_identity
    frames, _ = read_frames(bag, topic, None, stage(0.0, _READING), identity=identity)
    fit = fit_scene(theory, _estimates(settings, frames, stage(_READING, _TRACKING)), numbers)
    if progress is not None:
        progress(1.0)
    lines = fitted_lines(fit)
    if output is None:
        return lines
    values = {row.dimension: row.value for row in fit.dimensions if not row.undetermined}
    paths = {dimension.path for dimension in values}
    # Both coordinates of a point are written.
    changes = {
        dimension: values.get(dimension, dimension.value)
        for dimension in loaded.equations.dimensions
        if dimension.path in paths
    }
    text = rewritten(scene_text(scene), changes)
    with in_place_of(output) as part:
        part.write_text(text, encoding='utf-8')
    lines.append(f'written to {output}')
    try:
        load_scene(text if '\n' in text else output)
    except SceneError as error:
        lines.append(f'the fitted scene cannot move as its drivers prescribe: {error}')
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
    """Yield all estimates, up to the first derivative."""
    tracker = Tracker(settings)
    total = sum(len(one.stamps) for one in frames)
    done = 0
    for one in frames:
        for first in range(0, len(one.stamps), _BLOCK):
            block = part_of(one, slice(first, first + _BLOCK))
            yield from tracker.add(block, 1)
            done += len(block.stamps)
            if progress is not None:
                progress(done / total)
