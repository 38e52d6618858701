"""What a page shows of a rig beside figures: outlines, joints, what is withheld, warnings."""

import json
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from kinpole_ros.tools.plot import decode
from kinpole_ros.tools.report import Record, joints_of, words_of
from kinpole_ros.tools.view._figures import Frame, Rig

# Instants that joints are found from: ten seconds or so.
_KEPT = 300
# s without results, after which they are missed.
_SILENT = 1.5


class Known:
    """What is known of the rig of a node, as messages tell it."""

    def __init__(self, node: str, topic: str) -> None:
        self.node = node
        # The one of its topics that is shown.
        self.topic = topic
        # As the diagnostics name them, in order.
        self.body_names: list[str] = []
        # None until there are figures.
        self.rig: Rig | None = None
        self.notes: list[str] = []
        # What went wrong here since the pages were told before.
        self.trouble = ''
        self._withheld: dict[str, dict[str, str]] = {}
        # Of frames, Hz.
        self._rate = 0.0
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._along = ('x', 'y')
        self._sizes: dict[str, float] = {}
        self._outlines: dict[str, list[list[float]]] = {}
        self._recent: deque[Frame] = deque(maxlen=_KEPT)

    def add(self, frame: Frame) -> None:
        """Take the figures of an instant."""
        if frame.rig != self.rig:
            self._begin_anew()
            self.rig = frame.rig
        self._along = frame.along
        # A body that is not seen keeps those it had.
        self._sizes |= frame.sizes
        self._outlines |= frame.outlines
        self._recent.append(frame)

    def add_diagnostics(self, kind: str, data: bytes) -> None:
        """Take what diagnostics say of the node, if they are its own."""
        name = self.node.lstrip('/')
        ours = [s for s in decode(kind, data).status if s.name.startswith(f'{name}: ')]
        if not ours:
            return
        self.notes, self._withheld = [], {}
        # The first is the input, and behind the bodies there may be one of the linkage.
        self.body_names = [words_of(status)[0] for status in ours[1:]]
        for status in ours:
            subject, level, text, reasons = words_of(status)
            values = {pair.key: pair.value for pair in status.values}
            self._rate = float(values.get('rate (Hz)', self._rate))
            if level:
                reasons[''] = text
                self.notes.append(f'{subject}: {text}')
            self._withheld[subject] = reasons

    def as_json(self, rig: Rig, silence: float, others: Sequence[str]) -> str:
        """All of it for a page; after s of `silence`, with the names of `others` that publish."""
        return json.dumps(
            {
                'title': self.node,
                'about': self._about(silence, others),
                'along': self._along,
                'figures': rig.figures,
                'bodies': [
                    {
                        'name': body,
                        'size': self._sizes.get(body) or None,
                        'outline': self._outlines.get(body) or None,
                        'withheld': self._withheld.get(body, {}),
                    }
                    for body in rig.bodies
                ],
                'pairs': rig.pairs,
                'joints': [
                    {'bodies': joint.bodies, 'at': [_pair(z) for z in joint.at]}
                    for joint in joints_of(self._record(rig))
                ],
                'notes': [*self.notes, *filter(None, [self.trouble])],
            },
            separators=(',', ':'),
            allow_nan=False,
        )

    def _about(self, silence: float, others: Sequence[str]) -> str:
        parts = [f'markers at {self._rate:.4g} Hz'] if self._rate else []
        if silence > _SILENT:
            parts = [f'no results for {silence:.0f} s']
        if others:
            parts.append(f'also there: {", ".join(others)} (kinpole view --topic NAME)')
        return '; '.join(parts)

    def _record(self, rig: Rig) -> Record:
        """What joints are found from."""
        columns: dict[Any, np.ndarray] = {}
        for b, body in enumerate(rig.bodies):
            parts = [frame.bodies[b] or {} for frame in self._recent]
            place = _rows([_listed(part, 'x', 'y', 'angle') for part in parts], 3)
            columns[body, 'position'] = place[:, 0] + 1j * place[:, 1]
            columns[body, 'angle'] = place[:, 2]
            _add_points(columns, body, [part.get('icr') for part in parts])
            u = _rows([part.get('icr_velocity') for part in parts], 3)
            columns[body, 'icr_velocity'] = u[:, 0] + 1j * u[:, 1]
        for p, pair in enumerate(rig.pairs):
            _add_points(columns, pair, [frame.pairs[p] for frame in self._recent])
        # Bodies that were never seen have no size to compare with.
        bodies = tuple(body for body in rig.bodies if body in self._sizes)
        none = np.empty(0, np.int64)
        return Record(none, len(self._recent), bodies, columns, self._sizes, {}, self._along)


def _listed(part: dict[str, Any], *names: str) -> list[float] | None:
    return [part[name] for name in names] if part else None


def _rows(found: Sequence[list[float] | None], size: int) -> np.ndarray:
    """Numbers (T, size), NaN where there are none."""
    return np.array([[np.nan] * size if row is None else row for row in found])


def _add_points(columns: dict[Any, np.ndarray], subject: Any, found: Sequence[Any]) -> None:
    rows = _rows(found, 5)
    columns[subject, 'icr'] = rows[:, 0] + 1j * rows[:, 1]
    # As if along the axes: joints are found from its trace.
    columns[subject, 'icr_covariance'] = rows[:, 2:4, None] ** 2 * np.eye(2)


def _pair(z: complex) -> list[float]:
    return [float(f'{z.real:.6g}'), float(f'{z.imag:.6g}')]
