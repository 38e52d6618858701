"""A draft scene held against the markers that it was drawn from."""

import tempfile
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._draft import draft_scenes, first_frame
from kinpole_ros.linkage._model import Linkage
from kinpole_ros.mechanism import LinkageError, SceneError, load_scene, marker_positions

# Frames at which it is looked whether the draft goes on as the markers do.
_LATER = 20
_SECONDS = 2.0
# Drafts that are tried, and noises that the markers of a good one are off at the first frame.
_MOST_DRAFTS = 6
_CLOSE = 5.0
_EXPLAINED = 6.0  # noises that a draft that is worth writing is off, at most


class Checked(NamedTuple):
    """
    How a draft does: `problem` says why it cannot be loaded or moved, '' if it can.

    `first` is the rms distance of its markers from those measured at the first frame, `later` over
    the first 2 s, m: the drivers are fits, too. `noise` is that of the markers.
    """

    problem: str
    first: float
    later: float
    noise: float = 0.0

    @property
    def drives(self) -> bool:
        """Whether its drivers move it as measured for a while."""
        return not self.later > _EXPLAINED * self.noise

    @property
    def explains(self) -> bool:
        """Whether it can be moved, and is as far off the first frame as the noise makes it."""
        return not self.problem and not self.first > _EXPLAINED * self.noise


def draft(linkage: Linkage, about: str = '') -> tuple[str, Checked] | None:
    """
    The scene of a linkage as text, by the first drivers with which it moves as measured, and how.

    The best of those tried if none does; None where nothing is connected to the ground, or bodies
    leave the plane.
    """
    if linkage.space is not None:
        return None
    best: tuple[str, Checked] | None = None
    for text in islice(draft_scenes(linkage, about), _MOST_DRAFTS):
        checked = check_draft(text, linkage)
        if best is None or _off(checked) < _off(best[1]):
            best = text, checked
        if not checked.problem and not checked.first > _CLOSE * _usual_noise(linkage):
            break
    return best


def _off(checked: Checked) -> float:
    return np.inf if checked.problem else float(np.nan_to_num(checked.first))


def _usual_noise(linkage: Linkage) -> float:
    return max(float(np.median([pose.noise for pose in linkage.poses])), 1e-6)


def check_draft(text: str, linkage: Linkage) -> Checked:
    """Load a draft from its text, and compare."""
    noise = _usual_noise(linkage)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'draft.yaml'
        path.write_text(text, encoding='utf-8')
        try:
            scene = load_scene(path)
            start = first_frame(linkage)
            seconds = linkage.seconds - linkage.seconds[start]
            frames = np.flatnonzero((seconds >= 0) & (seconds <= _SECONDS))
            frames = frames[:: max(1, len(frames) // _LATER)]
            motion = scene.motion(seconds[frames])
        except (LinkageError, SceneError) as error:
            return Checked(str(error).replace(f'{path}: ', ''), np.nan, np.nan, noise)
    off = []
    for name, places in scene.markers.items():
        number = linkage.names.index(name)
        drawn = marker_positions(motion[name], places)
        flat = drawn[..., 0] + 1j * drawn[..., 1]
        known = dict(zip(linkage.markers[number], linkage.columns[number], strict=True))
        columns = [known[marker] for marker in scene.marker_names[name]]
        off.append(np.abs(flat - linkage.tracks[frames][:, columns]))
    if not off:
        return Checked('', np.nan, np.nan, noise)
    square = np.concatenate(off, axis=1) ** 2
    with np.errstate(invalid='ignore'):
        first = float(np.sqrt(np.nanmean(square[0])))
        return Checked('', first, float(np.sqrt(np.nanmean(square))), noise)
