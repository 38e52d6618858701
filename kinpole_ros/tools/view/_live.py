"""From a node's messages to the pages, step by step: what to listen to, and what to tell."""

import json
import os
import time
from typing import TYPE_CHECKING

from kinpole_ros.messages import PAGE_TOPICS, STATE, DiagnosticArray, type_name
from kinpole_ros.tools.view._feed import Feed
from kinpole_ros.tools.view._figures import frame_of, frame_of_state
from kinpole_ros.tools.view._known import Known
from kinpole_ros.tools.view._server import LASTING

if TYPE_CHECKING:
    from kinpole_ros.ros.listener import Watcher

# s, between looks at the graph, until there are figures and from then on.
_SEARCH, _LOOK = 0.25, 1.0
# s. Nodes send 30 instants a second at most; of what is played faster some are left out.
_LEAST = 0.02
_DIAGNOSTICS = '/diagnostics'


class Live:
    """Feeds pages from a watcher; `chosen` as `view` has it."""

    def __init__(self, watcher: 'Watcher', feed: Feed, chosen: str) -> None:
        self._watcher, self._feed = watcher, feed
        self._chosen = f'/{chosen.strip("/")}/' if chosen.strip('/') else ''
        self._known: Known | None = None
        self._frame_due = self._look_due = self._heard = 0.0
        # The first instant, ns.
        self._first: int | None = None

    def step(self) -> None:
        """Wait for the next frame, and feed it; without a page, rest."""
        if not self._feed.wait_for_page(0.0):
            self._watcher.want({})
            self._look_due = 0.0
            self._feed.wait_for_page(0.1)
            return
        time.sleep(max(0.0, self._frame_due - time.monotonic()))
        if time.monotonic() >= self._look_due:
            self._look()
        self._watcher.wait(max(0.0, self._look_due - time.monotonic()))
        # What comes from the network may be anything; rclpy raises RuntimeError for what it cannot
        # read.
        try:
            if self._known is not None:
                self._follow(self._known)
        except (RuntimeError, ValueError) as error:
            if self._known is not None:
                self._known.trouble = f'a message cannot be read: {error}'

    def _look(self) -> None:
        """See who is there, and tell the pages how things stand."""
        now = time.monotonic()
        there = {
            name: topic
            for name, topic in self._watcher.nodes().items()
            if not self._chosen
            or f'{name}/'.startswith(self._chosen)
            # By a topic of it.
            or self._chosen.startswith(f'{name}/')
        }
        rests = not self._look_due
        known = self._known
        if known is None or (rests and known.node not in there):
            first = next(iter(there.items()), None)
            known = self._known = Known(*first) if first else None
            self._first, self._heard = None, now
        self._look_due = now + (_SEARCH if known is None or known.rig is None else _LOOK)
        topics = {_DIAGNOSTICS: type_name(DiagnosticArray)}
        if known is not None:
            known.topic = there.get(known.node, known.topic)
            topics[f'{known.node}/{known.topic}'] = PAGE_TOPICS[known.topic]
        self._watcher.want(topics)
        if known is None or known.rig is None:
            self._feed.put(LASTING, json.dumps({'waiting': self._waiting(known)}))
            return
        others = [name for name in there if name != known.node]
        self._feed.put(LASTING, known.as_json(known.rig, now - self._heard, others))
        known.trouble = ''

    def _waiting(self, known: Known | None) -> str:
        if known is not None:
            notes = ''.join(f'; {note}' for note in [*known.notes, known.trouble] if note)
            return f'{known.node} is there, and has no results yet{notes}'
        which = f'node under {self._chosen[:-1]}' if self._chosen else 'node'
        domain = os.environ.get('ROS_DOMAIN_ID') or '0'
        return (
            f'No kinpole {which} publishes in this ROS domain ({domain}) yet. Start one: '
            'kinpole node --ros-args --params-file rig.yaml'
        )

    def _follow(self, known: Known) -> None:
        newest = self._watcher.newest
        while newest[_DIAGNOSTICS]:
            data = newest[_DIAGNOSTICS].popleft().data
            known.add_diagnostics(type_name(DiagnosticArray), data)
        arrived = newest[f'{known.node}/{known.topic}']
        if not arrived:
            return
        now = time.monotonic()
        data, published = arrived.pop()
        arrived.clear()
        frame = frame_of_state(data, known.body_names) if known.topic == STATE else frame_of(data)
        news = frame.rig != known.rig
        known.add(frame)
        if news:
            # A page needs to know of its bodies first.
            self._look()
        if self._first is None:
            self._first = frame.stamp
        self._heard, self._frame_due = now, now + _LEAST
        self._feed.put('frame', frame.as_json((frame.stamp - self._first) * 1e-9, published))
