"""What a page shows of a rig beside figures: outlines, pins, what is withheld and why, warnings."""

import json
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kinpole_ros.rigid.plane import Plane, as_parameter
from kinpole_ros.tools.plot import decode, plane_of_motion, row_of
from kinpole_ros.tools.report import Record, joints_of, words_of
from kinpole_ros.tools.view._figures import Figures, Rig, figures_of

# Instants that joints are found from: ten seconds or so.
_KEPT = 300
# s without results, after which they are missed.
_SILENT = 1.5
# What joints are found from.
_OF_JOINTS = ('position', 'angle', 'icr', 'icr_covariance')


class Known:
    """What is known of one rig, as messages tell it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        # Where the bodies move; None until it is found, and to have it found anew.
        self.plane: Plane | None = None
        self._outlines: dict[str, np.ndarray] = {}
        self._pins: set[str] = set()
        self._withheld: dict[str, dict[str, str]] = {}
        self._notes: list[str] = []
        # Of frames, Hz.
        self._rate = 0.0
        # What went wrong here since the pages were told before.
        self.trouble = ''
        self._recent: deque[Figures] = deque(maxlen=_KEPT)

    def figures(self, messages: Mapping[str, bytes]) -> Figures:
        """All figures in messages of one instant, by whole topic; a pose is among them."""
        if self.plane is None:
            kinds = self.rig.kinds
            rows = [row_of(kinds[t], data) for t, data in messages.items() if t.endswith('/odom')]
            self.plane = plane_of_motion(np.array(rows))
        return figures_of(self.rig, messages, self.plane)

    def keep(self, figures: Figures) -> None:
        """Have joints found from these figures too."""
        known = {k: v for k, v in figures.items() if k[1] in _OF_JOINTS}
        self._recent.append({k: v for k, v in known.items() if np.isfinite(v).all()})

    def lacks_outlines(self, figures: Figures) -> bool:
        """Whether any body that is seen has none yet."""
        return any((b, 'position') in figures and b not in self._outlines for b in self.rig.bodies)

    def add_drawing(self, kind: str, data: bytes, figures: Figures) -> None:
        """Take the outlines from a drawing, of bodies whose poses at its instant are given."""
        if self.plane is None:
            return
        for marker in decode(kind, data).markers:
            body = marker.ns.removesuffix('/outline')
            # The first point comes again at the end.
            points = np.array([[p.x, p.y, p.z] for p in marker.points[:-1]])
            if body == marker.ns or not len(points) or (body, 'position') not in figures:
                continue
            if not np.isfinite(points).all():
                continue
            arm = self.plane.project(points)[0] - figures[body, 'position']
            self._outlines[body] = arm * np.exp(-1j * figures[body, 'angle'])

    def add_diagnostics(self, kind: str, data: bytes) -> None:
        """Take what diagnostics say of the node, if they are its own."""
        name = self.rig.node.lstrip('/')
        ours = [s for s in decode(kind, data).status if s.name.startswith(f'{name}: ')]
        if not ours:
            return
        self._notes, self._withheld = [], {}
        for status in ours:
            subject, level, text, reasons = words_of(status)
            values = {pair.key: pair.value for pair in status.values}
            self._rate = float(values.get('rate (Hz)', self._rate))
            if 'motion' in values:
                self._pins.discard(subject)
            if values.get('motion') == 'pinned':
                self._pins.add(subject)
            if level:
                reasons[''] = text
                self._notes.append(f'{subject}: {text}')
            self._withheld[subject] = reasons

    def as_json(self, silence: float, others: Sequence[str]) -> str:
        """All of it for a page; after s of `silence`, with the names of `others` that publish."""
        rig = self.rig
        along = ['x', 'y']
        if self.plane is not None:
            basis, axes = self.plane.basis, self.plane.axes
            along = (
                list(self.plane.name) if axes else [f'along {as_parameter(e)}' for e in basis[:2]]
            )
        return json.dumps(
            {
                'title': rig.node,
                'about': self._about(silence, others),
                'along': along[:2],
                'figures': rig.figures,
                'bodies': [self._body(body) for body in rig.bodies],
                'pairs': rig.pairs,
                'joints': [
                    {'bodies': joint.bodies, 'at': [_pair(z) for z in joint.at]}
                    for joint in joints_of(self._record())
                ],
                'notes': [*self._notes, *filter(None, [self.trouble])],
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

    def _body(self, body: str) -> dict[str, Any]:
        outline = self._outlines.get(body)
        return {
            'name': body,
            'size': _size(outline) or None,
            'outline': None if outline is None else [_pair(z) for z in outline],
            'withheld': self._withheld.get(body, {}),
        }

    def _record(self) -> Record:
        """What joints are found from."""
        keys = {key for row in self._recent for key in row}

        def column(key: Any) -> np.ndarray:
            none = np.full((2, 2), np.nan) if key[1].endswith('_covariance') else np.nan
            return np.array([row.get(key, none) for row in self._recent])

        columns = {key: column(key) for key in keys}
        for body in self.rig.bodies:
            # A pin has a pole that does not move.
            if (body, 'icr') in columns and body in self._pins:
                columns[body, 'icr_velocity'] = np.zeros(len(self._recent), complex)
        sizes = {body: _size(self._outlines.get(body)) for body in self.rig.bodies}
        bodies = tuple(body for body in self.rig.bodies if (body, 'position') in keys)
        none = np.empty(0, np.int64)
        return Record(none, len(self._recent), bodies, columns, sizes, {}, ('', ''))


def _size(outline: np.ndarray | None) -> float:
    """Twice the root mean square distance of markers from their mean, m; 0 if it is not known."""
    return 0.0 if outline is None else float(f'{2 * np.std(outline):.4g}')


def _pair(z: complex) -> list[float]:
    return [float(f'{z.real:.6g}'), float(f'{z.imag:.6g}')]
