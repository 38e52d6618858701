"""From a node's messages to the pages, step by step: what to listen to, and what to tell."""

import json
import os
import struct
import time
from typing import TYPE_CHECKING

from kinpole_ros.tools.view._feed import Feed
from kinpole_ros.tools.view._figures import (
    Rig,
    as_json,
    common_instant,
    rig_of,
    stamp_of,
)
from kinpole_ros.tools.view._known import Known
from kinpole_ros.tools.view._server import LASTING

if TYPE_CHECKING:
    from kinpole_ros.ros.watch import Watcher

# s, between frames, and between looks at the graph, until a node is found and from then on.
_FRAME, _SEARCH, _LOOK = 1 / 30, 0.25, 1.0
# s. Outlines and joints lie still in their bodies, and drawings and relative centers cost the node
# more than all else: they are looked at in the beginning, and then now and then for so long.
_RELEARN, _FIRST, _LATER = 60.0, 10.0, 3.0
_DIAGNOSTICS, _DIAGNOSTICS_TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'
# Where the stamp of the first marker is in a MarkerArray.
_FIRST_MARKER = 8


class Live:
    """Feeds pages from a watcher; `chosen` as `view` has it."""

    def __init__(self, watcher: 'Watcher', feed: Feed, chosen: str) -> None:
        self._watcher, self._feed = watcher, feed
        self._chosen = f'/{chosen.strip("/")}/' if chosen.strip('/') else ''
        # What was found before, which may not be all of it yet.
        self._seen: Rig | None = None
        self._known: Known | None = None
        self._frame_due = self._look_due = self._relearn_due = self._heard = 0.0
        self._learned = 0.0
        # Of instants, ns.
        self._first: int | None = None
        self._last: int | None = None
        # Whether no page was open of late.
        self._rests = False

    def step(self) -> None:
        """Wait for the next frame, and feed it; without a page, rest."""
        shown = self._feed.shown()
        if shown is None:
            self._watcher.want({})
            self._rests, self._look_due = True, 0.0
            self._feed.wait_for_page(0.1)
            return
        time.sleep(max(0.0, self._frame_due - time.monotonic()))
        now = time.monotonic()
        self._frame_due = max(now, self._frame_due + _FRAME)
        try:
            if now >= self._look_due:
                self._look(now)
            if self._known is not None:
                self._follow(self._known, shown, now)
        # What comes from the network may be anything; rclpy raises RuntimeError for what it cannot
        # read.
        except (RuntimeError, ValueError, struct.error) as error:
            if self._known is not None:
                self._known.trouble = f'a message cannot be read: {error}'

    def _look(self, now: float) -> None:
        """See who is there, and tell the pages how things stand."""
        there = {
            name: kinds
            for name, kinds in self._watcher.nodes().items()
            if not self._chosen
            or f'{name}/'.startswith(self._chosen)
            # By a topic of it.
            or self._chosen.startswith(f'{name}/')
        }
        if self._rests and self._known is not None and self._known.rig.node not in there:
            self._known = None
        self._rests = False
        name = self._known.rig.node if self._known is not None else min(there, default='')
        if name in there:
            rig = rig_of(name, there[name])
            settled, self._seen = rig == self._seen, rig
            if settled and (self._known is None or rig != self._known.rig):
                self._known, self._first, self._last = Known(rig), None, None
                self._heard, self._relearn_due, self._learned = now, 0.0, now + _FIRST
        self._look_due = now + (_SEARCH if self._known is None else _LOOK)
        if self._known is None:
            self._feed.put(LASTING, json.dumps({'waiting': self._waiting()}))
            return
        others = sorted(there.keys() - {name})
        self._feed.put(LASTING, self._known.as_json(now - self._heard, others))
        self._known.plane, self._known.trouble = None, ''

    def _waiting(self) -> str:
        which = f'node under {self._chosen[:-1]}' if self._chosen else 'node'
        domain = os.environ.get('ROS_DOMAIN_ID') or '0'
        return (
            f'No kinpole {which} publishes in this ROS domain ({domain}) yet. Start one: '
            'kinpole node --ros-args --params-file rig.yaml'
        )

    def _follow(self, known: Known, shown: frozenset[str], now: float) -> None:
        rig, drawing = known.rig, known.rig.drawing
        learning = now < self._learned
        wanted = rig.topics(shown | {'relative'} if learning else shown)
        topics = {**wanted, _DIAGNOSTICS: _DIAGNOSTICS_TYPE}
        if drawing in rig.kinds and now >= self._relearn_due:
            topics[drawing] = rig.kinds[drawing]
        self._watcher.want(topics)
        self._watcher.take()
        newest = self._watcher.newest
        by_stamp = {
            topic: {stamp_of(message.data): message for message in newest[topic]}
            for topic in wanted
        }
        while newest[_DIAGNOSTICS]:
            known.add_diagnostics(_DIAGNOSTICS_TYPE, newest[_DIAGNOSTICS].popleft().data)

        def at(stamp: int) -> dict[str, bytes]:
            return {t: one[stamp].data for t, one in by_stamp.items() if stamp in one}

        stamps = {topic: list(one) for topic, one in by_stamp.items()}
        stamp = common_instant(stamps, rig.poses, self._last)
        if stamp is None:
            return
        if self._first is None:
            self._first = stamp
        self._last, self._heard = stamp, now
        messages = at(stamp)
        figures = known.figures(messages)
        if learning:
            known.keep(figures)
        published = next(by_stamp[pose][stamp].published for pose in rig.poses if pose in messages)
        self._feed.put('frame', as_json(rig, figures, (stamp - self._first) * 1e-9, published))
        if drawing in topics and newest[drawing]:
            data = newest[drawing].pop().data
            then = at(stamp_of(data, _FIRST_MARKER))
            if any(pose in then for pose in rig.poses):
                known.add_drawing(rig.kinds[drawing], data, known.figures(then))
            if not known.lacks_outlines(figures):
                self._relearn_due = now + _RELEARN
                self._learned = max(self._learned, now + _LATER)
