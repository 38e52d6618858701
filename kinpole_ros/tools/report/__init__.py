"""
A report of a recording to look through: one HTML file that needs no network and no program.

The page is in page/, as it is read; the figures are put into it here.
"""

import html
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.bags import BagError, assumed_body, in_place_of, replay, warnings_of
from kinpole_ros.files import printable
from kinpole_ros.linkage.theory import DeviationSummary
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import theory_of
from kinpole_ros.tools.report._pack import embedded, pack
from kinpole_ros.tools.report._prepare import Points, prepared
from kinpole_ros.tools.report._record import Collector, Record, joints_of
from kinpole_ros.tools.report._results import has_results, read_record, words_of
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.plane import XY, plane_of

__all__ = [
    'Points',
    'Record',
    'joints_of',
    'pack',
    'page',
    'prepared',
    'report',
    'settings_for',
    'words_of',
]

_PAGE = Path(__file__).parent / 'page'
# In this order: each uses those before it.
_SCRIPTS = (
    'data',
    'geometry',
    'marks',
    'motion',
    'moving',
    'stage',
    'charts',
    'table',
    'strips',
    'polygons',
    'input',
    'live',
    'solver',
    'edit',
    'page',
)
# Nothing may be loaded from anywhere; a live page has its stream.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
# More instants than these are no clearer on a screen; with more bodies than three they are fewer,
# so that the page stays below some 4 MB.
_MOST_INSTANTS, _MOST_POSES = 10_000, 30_000


def settings_for(settings: Settings, scene: str | None) -> Settings:
    """
    These settings with a scene to be compared with, if any.

    Its bodies are tracked where the settings name none. Raises SceneError.
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
    tell: Callable[[str], None] | None = None,
    source: str | Path | None = None,
) -> Record:
    """
    Write the report of a bag to `output`, an .html file; returns what is in it.

    A bag of results is shown as it is, unless a `topic` of markers is named; markers are replayed
    with `settings` first, and `tell` is called with what the replay assumed. `source` is the file
    that the bag was made of, if any: the page names it. Raises BagError when
    there is nothing to show, or `output` cannot be written.
    """
    theory: list[DeviationSummary] = []
    if topic is None and has_results(bag):
        if settings.scene:
            raise BagError(
                f'{bag} holds results; theory is held against markers: give the bag of these, or '
                'leave the scene out'
            )
        record, notes = read_record(bag, _most_instants, progress)
    else:
        record, notes, theory = _replayed(bag, settings, topic, progress, tell, source or bag)
    data = {
        **pack(record),
        'title': printable(Path(source or bag).resolve().name),
        'about': _about(record),
        'notes': notes,
        'scene': Path(settings.scene).stem,
        'deviations': [
            [row.subject, row.what, f'{row.rms:.2g} {row.unit}', f'{row.deviations:.1f}']
            for row in theory
        ],
        'made': f'kinpole {__version__}',
    }
    _write(output, page(data))
    return record


def _replayed(
    bag: str | Path,
    settings: Settings,
    topic: str | None,
    progress: Callable[[float], None] | None,
    tell: Callable[[str], None] | None,
    source: str | Path,
) -> tuple[Record, list[str], list[DeviationSummary]]:
    collector = Collector(_most_instants(len(settings.bodies)), theory_of(settings))
    result = replay(bag, settings, topic=topic, progress=progress, take=collector.add)
    notes = warnings_of(result, settings)
    if assumption := assumed_body(len(result.identities), settings, source):
        notes.insert(0, assumption)
        if tell is not None:
            tell(assumption)
    if result.truncated is not None:
        notes.append(str(result.truncated))
    if not collector.total:
        raise BagError(f'{source}: {notes[-1] if notes else "no results"}')
    plane = result.space.plane or plane_of(settings.plane) or XY
    along = (plane.name[0], plane.name[1])
    if plane.axes is None:
        along = (_axis_name(plane.basis[0], 'e1'), _axis_name(plane.basis[1], 'e2'))
    return collector.record(along), notes, result.scene_deviations


def _axis_name(axis: np.ndarray, otherwise: str) -> str:
    """The axis of the frame that a unit vector (3,) is within 15 deg of, if there is one."""
    nearest = int(np.abs(axis).argmax())
    if abs(axis[nearest]) < np.cos(np.radians(15)):
        return otherwise
    return f'≈ {"−" if axis[nearest] < 0 else ""}{"xyz"[nearest]}'


def page(data: dict[str, Any]) -> str:
    """
    The whole page of what `pack` makes, and of what `report` adds to it.

    If `data` has `live` instead, the page of a stream of events beside it.
    """
    live = 'live' in data
    wanted = {'live': live, 'solver': 'edit' in data, 'edit': 'edit' in data}
    scripts = [name for name in _SCRIPTS if wanted.get(name, True)]
    parts = {
        'POLICY': f"{_POLICY}; connect-src 'self'" if live else _POLICY,
        'TITLE': html.escape(printable(data['title'])),
        'STYLE': (_PAGE / 'style.css').read_text(encoding='utf-8'),
        'SCRIPT': '\n'.join((_PAGE / f'{name}.js').read_text(encoding='utf-8') for name in scripts),
        'DATA': embedded(data),
    }
    text = (_PAGE / 'page.html').read_text(encoding='utf-8')
    return re.sub('@([A-Z]+)@', lambda place: parts[place[1]], text)


def _most_instants(bodies: int) -> int:
    return min(_MOST_INSTANTS, _MOST_POSES // bodies)


def _about(record: Record) -> str:
    seconds = (record.stamp[-1] - record.stamp[0]) * 1e-9
    count = len(record.stamp)
    thinned = '' if count == record.total else f' of {record.total}'
    rate = f' at {(record.total - 1) / seconds:.4g} Hz' if seconds > 0 else ''
    return f'{count}{thinned} instants in {seconds:.4g} s{rate}'


def _write(output: str | Path, text: str) -> None:
    """In place of what is there only when it is whole."""
    with in_place_of(output) as part:
        part.write_text(text, encoding='utf-8')
