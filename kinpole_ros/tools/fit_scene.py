"""`kinpole fit`: the dimensions of a scene from a bag of markers."""

from argparse import Namespace
from collections.abc import Callable, Iterator

from kinpole_ros.bags import BagError, bag_files, in_place_of, read_frames
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
# Shares of the time that reading and tracking take.
_READING, _TRACKING = 0.2, 0.7


def fit_bag(
    options: Namespace,
    progress: Callable[[float], None] | None = None,
    on_truncated: Callable[[BagError], None] | None = None,
) -> list[str]:
    """
    Fit a scene to the markers of a bag; return lines to print, and write it to the output.

    `options` are those of `kinpole fit`. `progress` is called with the fraction done,
    `on_truncated` with what is missing from a truncated bag. Raises SceneError, ParameterError or
    BagError for what cannot be used.
    """
    scene, bag, config, output = options.scene, options.bag, options.config, options.output
    bag_files(bag)  # a table is refused before its scene is read
    loaded = load_scene(scene)
    free = [name for names in options.free or [] for part in names for name in part.split(',')]
    numbers = free_dimensions(loaded, free or loaded.free)
    if not numbers:
        raise SceneError(f'{scene}: its joints have no dimensions to fit; add joints')
    settings = _settings(loaded, scene, config)
    theory = load_theory(settings)
    reading = progress and (lambda share: progress(_READING * share))
    tracking = progress and (lambda share: progress(_READING + _TRACKING * share))
    topic = options.topic or (settings.marker_topic if config else None)
    identity = settings.marker_identity
    frames, _ = read_frames(bag, topic, None, reading, on_truncated, identity)
    fit = fit_scene(theory, _estimates(settings, frames, tracking), numbers)
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
