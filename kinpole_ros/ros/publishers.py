"""The publishers of the topics of results, of which those with subscribers are used."""

import time
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeAlias

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState
from rclpy.qos import DurabilityPolicy, QoSProfile

from kinpole_ros.messages import (
    DRAWING,
    Output,
    deletion_of_all,
    installed_class,
    joint_build,
    type_name,
)
from kinpole_ros.ros.private import sender
from kinpole_ros.tracking.estimate import Estimate

# Results kept for a reliable reader that is slow, such as a recorder on a busy machine: messages
# that wait are taken at once, so results come in bunches. A reader that asks for less gets less.
_DEPTH = 2000
# The callbacks of rclpy only log, and cost 6 us a publisher in each wait.
NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
# Of a topic whose last message a subscriber needs whenever it comes.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_ACKNOWLEDGMENT_WAIT = 0.1  # s; ms suffice, but a reader of Fast DDS may acknowledge after 3 s
_Row: TypeAlias = tuple[Output, Any]  # a topic and its publisher


class ResultPublishers:
    """The publishers of a node, by the rows of the table of topics."""

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._publisher_of_topic: dict[str, Any] = {}
        self._rows: list[_Row] = []
        # Those with subscribers: those of every frame, and those for displays, with the time at
        # which the next is due.
        self._frame_rows: list[_Row] = []
        self._display_rows: list[_Row] = []
        self._build_frame = joint_build(())
        self._send_frame: list[Callable[[bytes], None]] = []
        self._frame_order: int | None = None
        # Whether a topic of events is read.
        self.need_events = False
        self._display_due = 0.0
        # The last estimate published since the drawing was deleted.
        self._drawn: Estimate | None = None

    def make(self, outputs: Sequence[Output], is_active: bool) -> None:
        """Make the publishers of these topics, and destroy all others."""
        self.drop({output.topic for output in outputs})
        for output in outputs:
            publisher = self._publisher_of_topic.get(output.topic)
            if publisher is None:
                cls = installed_class(type_name(output.message_type))
                publisher = self._node.create_lifecycle_publisher(
                    cls, output.under('~'), _DEPTH, event_callbacks=NO_EVENTS
                )
                if is_active:
                    publisher.on_activate(LifecycleState('active', 0))
                self._publisher_of_topic[output.topic] = publisher
            self._rows.append((output, publisher))
        self.look_up_subscribers()

    def drop(self, retained: Collection[str] = ()) -> None:
        """Destroy the publishers of all topics but the retained ones."""
        if DRAWING not in retained:
            self.delete_drawing()
        dropped = [
            self._publisher_of_topic.pop(topic)
            for topic in self._publisher_of_topic.keys() - set(retained)
        ]
        # Readers drop messages on their way when their publisher is destroyed.
        deadline = time.monotonic() + _ACKNOWLEDGMENT_WAIT
        for publisher in dropped:
            remaining = max(0.0, deadline - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=remaining))
        for publisher in dropped:
            self._node.destroy_lifecycle_publisher(publisher)
        self._rows = []
        self.look_up_subscribers()

    @property
    def are_made(self) -> bool:
        """Whether there are publishers."""
        return bool(self._rows)

    @property
    def first_topic(self) -> str:
        """The full name of the first topic."""
        return str(next(iter(self._publisher_of_topic.values())).topic_name)

    def delete_drawing(self) -> None:
        """Have viewers delete what was drawn, which they keep otherwise."""
        drawn, self._drawn = self._drawn, None
        publisher = self._publisher_of_topic.get(DRAWING)
        if drawn is not None and publisher is not None and publisher.get_subscription_count():
            publisher.publish(deletion_of_all(int(drawn.stamp[-1]), drawn.frame_id))

    def look_up_subscribers(self) -> None:
        """Find the topics with subscribers, which takes 0.6 us each."""
        self.use([row for row in self._rows if row[1].get_subscription_count()])

    def use(self, read: Sequence[_Row]) -> None:
        """Publish these topics from now on."""
        self._display_rows = [row for row in read if row[0].interval]
        frame_rows = [row for row in read if not row[0].interval]
        if frame_rows != self._frame_rows:
            self._frame_rows = frame_rows
            self._build_frame = joint_build([output for output, _ in frame_rows])
            self._send_frame = [sender(publisher) for _, publisher in frame_rows]
            self._frame_order = max((output.order for output, _ in frame_rows), default=None)
            self.need_events = any(output.of_events for output, _ in frame_rows)

    def due_displays(self, now: float) -> list[_Row]:
        """Return the topics for displays, if they are due at this monotonic time, s."""
        return self._display_rows if now >= self._display_due else []

    def highest_order(self, displays: Sequence[_Row]) -> int | None:
        """Return the highest derivative that is read; None where no topic is."""
        if not displays:
            return self._frame_order
        return max(self._frame_order or 0, *(output.order for output, _ in displays))

    def publish(self, estimate: Estimate) -> None:
        """Publish the topics of every frame."""
        self._drawn = estimate
        # All messages are made before the first is sent: its readers wake, and take the core.
        for k, data in self._build_frame(estimate):
            self._send_frame[k](data)

    def publish_displays(self, displays: Sequence[_Row], estimate: Estimate, now: float) -> None:
        """Publish the topics for displays that were due at this time, after all others."""
        for output, publisher in displays:
            for data in output.build(estimate)[1]:
                publisher.publish(data)
        self._display_due = now + max(output.interval for output, _ in displays)
