"""A report of a recording: one HTML file that needs no network and no other program."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.bags import BagError, assumed_body, in_place_of, replay
from kinpole_ros.files import printable
from kinpole_ros.linkage.positions import JointSummary
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.mechanism import load_scene
from kinpole_ros.settings import Settings
from kinpole_ros.tools.record.record import MotionRecord, with_lost_frames
from kinpole_ros.tools.record.result_bag import has_results, read_record
from kinpole_ros.tools.report._collector import Collector
from kinpole_ros.tools.report._prepare import found_rig, prepared
from kinpole_ros.tools.report._record_page import intervals, pack, page
from kinpole_ros.tracking.plane import XY, plane_of

__all__ = ['found_rig', 'pack', 'page', 'prepared', 'replayed', 'report', 'settings_for']

if TYPE_CHECKING:
    from kinpole_ros.film import Filmed

# More instants are no clearer on a screen. With more than three bodies there are fewer, which keeps
# the page below about 4 MB.
_MOST_INSTANTS, _MOST_POSES = 10_000, 30_000
_LOST = 'lost: no result of these frames'


def settings_for(settings: Settings, scene: str | None) -> Settings:
    """
    Return the settings with a scene to compare with, if any.

    If the settings name no bodies, those of the scene are tracked. Raises SceneError.
    """
    if not scene:
        return settings
    bodies = settings.bodies
    if bodies == Settings().bodies:
        bodies = {body: tuple(names) for body, names in load_scene(scene).marker_names.items()}
    return replace(settings, scene=scene, bodies=bodies)


def report(
    bag: str | Path,
    output: str | Path,
    settings: Settings,
    topic: str | None = None,
    progress: Callable[[float], None] | None = None,
    on_assumption: Callable[[str], None] | None = None,
    source: str | Path | None = None,
    film: 'Filmed | None' = None,
) -> MotionRecord:
    """
    Write the report of a bag to `output`, an .html file; return what the page shows.

    A bag of results is shown as it is, unless `topic` names markers; markers are replayed with the
    settings first, and `on_assumption` is called with what the replay assumed. `source` is the file
    that the bag was made of, which the page names, and `film` what was found in a video that it
    shows. Raises BagError if there is nothing to show, or `output` cannot be written.
    """
    joints: list[JointSummary] = []
    if topic is None and has_results(bag):
        if settings.scene:
            raise BagError(
                f'{bag} holds results, and a scene is compared with markers; give the bag of '
                'markers, or leave out the scene'
            )
        record = read_record(bag, progress)
        cut = ('the bag is cut off; what follows is not shown',) if record.cut else ()
        record = record.at_most(_most_instants(len(record.bodies)))
        record = record._replace(notes=(*cut, *record.notes))
    else:
        record, joints = replayed(bag, settings, topic, progress, on_assumption, source or bag)
    shown, is_lost = with_lost_frames(record)
    data = {
        **pack(shown),
        'lost': intervals(np.where(is_lost, _LOST, '').astype(object)),
        'title': printable(Path(source or bag).resolve().name),
        'about': _about(record),
        'notes': record.notes,
        'scene': Path(settings.scene).stem,
        'deviations': [[row.joint, f'{row.rms:.2g} m', f'{row.deviations:.1f}'] for row in joints],
        'made': f'kinpole {__version__}',
    }
    # Where tags turn out of the picture, the plane of motion is seen from its side.
    if film is not None and film.video is not None and film.corner_heights is None:
        from kinpole_ros.film import straightened

        data['film'] = straightened(film, shown.stamp)
    with in_place_of(output) as part:
        part.write_text(page(data), encoding='utf-8')
    return record


def replayed(
    bag: str | Path,
    settings: Settings,
    topic: str | None,
    progress: Callable[[float], None] | None,
    on_assumption: Callable[[str], None] | None,
    source: str | Path,
) -> tuple[MotionRecord, list[JointSummary]]:
    """Return the record of a bag of markers, and how far the joints of the scene are off."""
    theory = load_theory(settings) if settings.scene else None
    collector = Collector(_most_instants(len(settings.bodies)), theory)
    result = replay(bag, settings, topic=topic, progress=progress, take=collector.add, whole=True)
    notes = result.warnings
    if assumption := assumed_body(len(result.identities), settings, source):
        notes.insert(0, assumption)
        if on_assumption is not None:
            on_assumption(assumption)
    if result.truncated is not None:
        notes.append(str(result.truncated))
    if not collector.total:
        raise BagError(f'{source}: {notes[-1] if notes else "no results"}')
    plane = result.space.plane or plane_of(settings.plane) or XY
    along = plane.name[:1], plane.name[1:2]
    if plane.axes is None:
        along = _axis_name(plane.basis[0], 'e1'), _axis_name(plane.basis[1], 'e2')
    joints = result.scene_positions.joints if result.scene_positions is not None else []
    return collector.record(along)._replace(notes=tuple(notes)), joints


def _axis_name(axis: np.ndarray, default: str) -> str:
    """Return the coordinate axis within 15 deg of a unit vector (3,), if there is one."""
    nearest = int(np.abs(axis).argmax())
    if abs(axis[nearest]) < np.cos(np.radians(15)):
        return default
    return f'≈ {"−" if axis[nearest] < 0 else ""}{"xyz"[nearest]}'


def _most_instants(bodies: int) -> int:
    return min(_MOST_INSTANTS, _MOST_POSES // bodies)


def _about(record: MotionRecord) -> str:
    seconds = (record.stamp[-1] - record.stamp[0]) * 1e-9
    count = len(record.stamp)
    thinned = '' if count == record.total else f' of {record.total}'
    rate = f' at {(record.total + record.lost - 1) / seconds:.4g} Hz' if seconds > 0 else ''
    lost = f', {record.lost} frames lost' if record.lost else ''
    return f'{count}{thinned} instants in {seconds:.4g} s{rate}{lost}'
