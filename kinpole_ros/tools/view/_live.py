"""From the messages of a node to the pages: which topics to read, and what to send to the pages."""

import json
import os
import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kinpole_ros.messages import (
    PAGE_TOPICS,
    RIG,
    STATE,
    DiagnosticArray,
    String,
    read_rig,
    type_name,
    warnings_in,
)
from kinpole_ros.tools.record.record import MotionRecord, joints_of
from kinpole_ros.tools.record.result_bag import decode
from kinpole_ros.tools.view._frames import Frame, Rig, frame_of_state, frame_of_view
from kinpole_ros.tools.view._server import RIG_EVENT, Feed

if TYPE_CHECKING:
    from kinpole_ros.ros.listener import Watcher

# Seconds between searches of the graph, until there are results and afterwards.
_SEARCH_INTERVAL, _UPDATE_INTERVAL = 0.25, 1.0
# Shortest interval of frames, s. Nodes send 30 a second at most; a bag may be played faster.
_FRAME_INTERVAL = 0.02
# Seconds without results before the page says so.
_SILENT = 1.5
# Frames from which joints are found: about ten seconds.
_HISTORY = 300
_DIAGNOSTICS = '/diagnostics'


class RigState:
    """The state of a rig for a page: outlines, joints and warnings."""

    def __init__(self, node: str, topic: str) -> None:
        self.node = node
        # The name of the topic that is shown, below the node.
        self.topic = topic
        # What the node says of itself on its topic `rig`.
        self.description: dict[str, Any] | None = None
        # None until there are results.
        self.rig: Rig | None = None
        self.notes: list[str] = []
        # An error since the last event was sent.
        self.trouble = ''
        self._rate = 0.0  # of frames, Hz
        self._clear()

    def _clear(self) -> None:
        self._along = ('x', 'y')
        self._sizes: dict[str, float] = {}
        self._outlines: dict[str, list[list[float]]] = {}
        self._history: deque[Frame] = deque(maxlen=_HISTORY)

    def add_frame(self, frame: Frame) -> None:
        """Append the results of an instant; a body that is not visible keeps its outline."""
        if frame.rig != self.rig:
            self._clear()
            self.rig = frame.rig
        self._along = frame.along
        self._sizes |= frame.sizes
        self._outlines |= frame.outlines
        self._history.append(frame)

    def add_diagnostics(self, kind: str, data: bytes) -> None:
        """Read the diagnostics of the node; those of other nodes are ignored."""
        prefix = f'{self.node.lstrip("/")}: '
        statuses = [s for s in decode(kind, data).status if s.name.startswith(prefix)]
        if not statuses:
            return
        for status in statuses:
            values = {pair.key: pair.value for pair in status.values}
            self._rate = float(values.get('rate (Hz)', self._rate))
        self.notes = list(warnings_in(statuses))

    def as_json(self, rig: Rig, silence: float, other_nodes: Sequence[str]) -> str:
        """Return the state as a page takes it, after some seconds of `silence`."""
        data = {
            'title': self.node,
            'about': self._about(silence, other_nodes),
            'along': self._along,
            'figures': rig.figures,
            'bodies': [
                {
                    'name': body,
                    'size': self._sizes.get(body) or None,
                    'outline': self._outlines.get(body) or None,
                }
                for body in rig.bodies
            ],
            'pairs': rig.pairs,
            'joints': [
                {'bodies': joint.bodies, 'at': [_rounded(z) for z in joint.at]}
                for joint in joints_of(self._record(rig))
            ],
            'notes': [*self.notes, *filter(None, [self.trouble])],
        }
        return json.dumps(data, separators=(',', ':'), allow_nan=False)

    def _about(self, silence: float, other_nodes: Sequence[str]) -> str:
        words = [f'markers at {self._rate:.4g} Hz'] if self._rate else []
        if silence > _SILENT:
            words = [f'no results for {silence:.0f} s']
        if other_nodes:
            words.append(f'other nodes: {", ".join(other_nodes)} (kinpole view --topic NAME)')
        return '; '.join(words)

    def _record(self, rig: Rig) -> MotionRecord:
        """Return the history of frames with what `joints_of` reads."""
        columns: dict[Any, np.ndarray] = {}

        def add_center(subject: Any, values: Sequence[Any]) -> None:
            rows = _rows(values, 5)
            columns[subject, 'icr'] = rows[:, 0] + 1j * rows[:, 1]
            # `joints_of` reads only the trace of the covariance.
            columns[subject, 'icr_covariance'] = rows[:, 2:4, None] ** 2 * np.eye(2)

        for b, body in enumerate(rig.bodies):
            values = [frame.bodies[b] or {} for frame in self._history]
            poses = [[v['x'], v['y'], v['angle']] if v else None for v in values]
            pose = _rows(poses, 3)
            columns[body, 'position'] = pose[:, 0] + 1j * pose[:, 1]
            columns[body, 'angle'] = pose[:, 2]
            add_center(body, [v.get('icr') for v in values])
            velocity = _rows([v.get('icr_velocity') for v in values], 3)
            columns[body, 'icr_velocity'] = velocity[:, 0] + 1j * velocity[:, 1]
        for p, pair in enumerate(rig.pairs):
            add_center(pair, [frame.pairs[p] for frame in self._history])
        # A body that was never visible has no size.
        bodies = tuple(body for body in rig.bodies if body in self._sizes)
        none, count = np.empty(0, np.int64), len(self._history)
        return MotionRecord(none, count, bodies, columns, self._sizes, {}, self._along)


def _rows(values: Sequence[list[float] | None], size: int) -> np.ndarray:
    """Return numbers (T, size), NaN where there are none."""
    return np.array([[np.nan] * size if row is None else row for row in values])


def _rounded(z: complex) -> list[float]:
    return [float(f'{z.real:.6g}'), float(f'{z.imag:.6g}')]


class Live:
    """Feeds the pages with the messages of one node, `chosen` as in `view`."""

    def __init__(self, watcher: 'Watcher', feed: Feed, chosen: str) -> None:
        self._watcher, self._feed = watcher, feed
        self._chosen = f'/{chosen.strip("/")}/' if chosen.strip('/') else ''
        self._state: RigState | None = None
        # Times of the monotonic clock.
        self._frame_due = self._update_due = self._last_frame = 0.0
        self._first_stamp: int | None = None

    def step(self) -> None:
        """Wait for the next frame and feed it; if no page is open, wait for a page."""
        if not self._feed.wait_for_page(0.0):
            self._watcher.want({})
            self._update_due = 0.0
            self._feed.wait_for_page(0.1)
            return
        time.sleep(max(0.0, self._frame_due - time.monotonic()))
        if time.monotonic() >= self._update_due:
            self._update()
        self._watcher.wait(max(0.0, self._update_due - time.monotonic()))
        if self._state is None:
            return
        try:
            self._read_messages(self._state)
        except ValueError as error:
            self._state.trouble = f'a message cannot be read: {error}'

    def _update(self) -> None:
        """Search the graph, subscribe to the topics, and send the state of the rig to the pages."""
        now = time.monotonic()
        nodes = {n: topic for n, topic in self._watcher.nodes().items() if self._is_chosen(n)}
        state, was_idle = self._state, not self._update_due
        if state is None or (was_idle and state.node not in nodes):
            first = next(iter(nodes.items()), None)
            state = self._state = RigState(*first) if first else None
            self._first_stamp, self._last_frame = None, now
        no_results = state is None or state.rig is None
        self._update_due = now + (_SEARCH_INTERVAL if no_results else _UPDATE_INTERVAL)
        topics = {_DIAGNOSTICS: type_name(DiagnosticArray)}
        if state is not None:
            state.topic = nodes.get(state.node, state.topic)
            topics[f'{state.node}/{state.topic}'] = PAGE_TOPICS[state.topic]
            topics[f'{state.node}/{RIG}'] = type_name(String)
        self._watcher.want(topics)
        if state is None or state.rig is None:
            self._feed.put(RIG_EVENT, json.dumps({'waiting': self._waiting_text(state)}))
            return
        other_nodes = [name for name in nodes if name != state.node]
        self._feed.put(RIG_EVENT, state.as_json(state.rig, now - self._last_frame, other_nodes))
        state.trouble = ''

    def _is_chosen(self, node: str) -> bool:
        """Return whether a node is chosen by its name, its namespace or a topic of it."""
        chosen = self._chosen
        return not chosen or f'{node}/'.startswith(chosen) or chosen.startswith(f'{node}/')

    def _waiting_text(self, state: RigState | None) -> str:
        if state is not None:
            notes = ''.join(f'; {note}' for note in [*state.notes, state.trouble] if note)
            topic = f'{state.node}/{state.topic}'
            return f'waiting for data on {topic}: {state.node} has no results yet{notes}'
        node = f'node under {self._chosen[:-1]}' if self._chosen else 'node'
        domain = os.environ.get('ROS_DOMAIN_ID') or '0'
        return (
            f'No kinpole {node} publishes in this ROS domain ({domain}) yet. Start one: '
            'kinpole node --ros-args --params-file rig.yaml'
        )

    def _read_messages(self, state: RigState) -> None:
        """Read the diagnostics that arrived and the newest frame, and feed the frame."""
        newest = self._watcher.newest
        while newest[_DIAGNOSTICS]:
            data = newest[_DIAGNOSTICS].popleft().data
            state.add_diagnostics(type_name(DiagnosticArray), data)
        rigs = newest[f'{state.node}/{RIG}']
        while rigs:
            state.description = read_rig(rigs.popleft().data)
        arrived = newest[f'{state.node}/{state.topic}']
        if not arrived:
            return
        now = time.monotonic()
        data, published = arrived.pop()
        arrived.clear()
        if state.topic == STATE:
            frame = frame_of_state(data, state.description)
        else:
            frame = frame_of_view(data)
        is_new_rig = frame.rig != state.rig
        state.add_frame(frame)
        if is_new_rig:
            # A page needs the bodies before their frames.
            self._update()
        if self._first_stamp is None:
            self._first_stamp = frame.stamp
        self._last_frame, self._frame_due = now, now + _FRAME_INTERVAL
        seconds = (frame.stamp - self._first_stamp) * 1e-9
        self._feed.put('frame', frame.as_json(seconds, published))
