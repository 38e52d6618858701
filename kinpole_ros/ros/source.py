"""The topic of the markers: found in the graph, subscribed to, read, and watched for faults."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_support import check_is_valid_msg_type

from kinpole_ros.findings import ERROR, WARN, Finding
from kinpole_ros.messages import (
    AUTO_TYPES,
    INPUT_TYPE_NAMES,
    MessageError,
    installed_class,
    reader_of,
)
from kinpole_ros.ros.offered_qos import strictest_qos
from kinpole_ros.ros.private import has_known_node, received_at, sequence_number, take
from kinpole_ros.settings import ParameterError, Settings
from kinpole_ros.tracking.frame import MarkerFrames

# Messages that wait in the middleware: 2 s at 4 kHz, as 20 markers at 200 Hz make that come as one
# message each. It is less where so many of the largest messages are more than MAX_WAITING_BYTES:
# 2 s at 1 kHz of 65 kB, and at 60 Hz of the largest that are read.
SUBSCRIPTION_DEPTH = 8192
MAX_WAITING_BYTES = 1 << 27
# Messages that are processed at once: a failure costs no more, and all else has its turn between.
_BATCH = 64
_UPDATE_INTERVAL = 1.0  # s between looks for publishers, once subscribed
# s. A node is behind if messages have waited for more than _LATE for _PATIENCE. If one has waited
# for _TOO_LATE then, all that are late are dropped: one gap costs less than many, of which each
# makes another kind of window. After a stall of any length the node is not behind: it catches up.
_LATE, _PATIENCE, _TOO_LATE = 0.05, 0.7, 5.0
# Larger messages are not read: 4,000 markers of a MarkerArray, or 65,000 points of a PointCloud2.
MAX_MESSAGE_BYTES = 1 << 20


class MarkerSource:
    """
    The subscription to the markers.

    `on_markers` is called with a message and its info, by rclpy or by `take_messages`; it calls
    `take` to read it and all that wait. `note(kind, finding)` is called for each fault, and with
    None when that kind of fault is over.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        on_markers: Callable[[bytes, Mapping[str, Any]], None],
        note: Callable[[str, Finding | None], None],
    ) -> None:
        self._node, self._settings = node, settings
        self._on_markers, self._note = on_markers, note
        self.topic = node.resolve_topic_name(settings.marker_topic)
        self._subscription: Any = None
        self._kind = ''
        self._update_due = 0.0
        self._depth, self._largest_size = SUBSCRIPTION_DEPTH, 0
        # Parameters of the user are there before the first subscription declares its own.
        reliability = f'qos_overrides.{self.topic}.subscription.reliability'
        self._is_reliability_given = node.has_parameter(reliability)
        # Since when all messages are taken late, and the CPU time of the node then, s; None while
        # they are in time.
        self._behind_since: tuple[float, float] | None = None
        self._is_skipping = False
        self._publishers: set[bytes] = set()
        # The number that the publisher gave to the last message.
        self._number: int | None = None
        # How often the number did not increase since `note_several_publishers`: another publisher
        # sent the message.
        self._alternations = 0

    @property
    def is_subscribed(self) -> bool:
        """Whether the topic is subscribed to."""
        return self._subscription is not None

    @property
    def subscriptions(self) -> list[Subscription]:
        """The subscription to the markers, once there is one."""
        return [self._subscription] if self.is_subscribed else []

    def take_messages(self) -> None:
        """Take a message, if one waits, and have it processed."""
        for taken in [*take(self._subscription, 1)]:
            self._on_markers(*taken)

    def _take_waiting(self) -> None:
        """Have what waits now processed; of a stream faster than the node, more waits then."""
        now = time.time_ns()
        for _ in range(0, self._depth, _BATCH):
            waiting = [*take(self._subscription, 1)]
            if not waiting:
                return
            self._on_markers(*waiting[0])
            if (received_at(waiting[0][1]) or 0) >= now:
                return

    def close(self) -> None:
        """Unsubscribe; the next `update` may subscribe again."""
        self._unsubscribe()
        self._kind = ''
        self._publishers = set()
        self._update_due = 0.0

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._subscription = self._number = self._behind_since = None

    def restart(self, settings: Settings) -> None:
        """Forget the messages so far, and read markers by these settings."""
        self._settings = settings
        self._number = None
        if self._kind:
            self._reader = reader_of(self._kind, settings)

    def check(self, settings: Settings) -> None:
        """Raise ParameterError for settings that do not go with the type of the messages."""
        if self._kind:
            reader_of(self._kind, settings)

    def update(self) -> bool:
        """
        Subscribe once the type of the markers is known, and note the faults of the publishers.

        When subscribed it does so once a second. Returns whether other publishers have replaced all
        earlier ones, whose markers may differ. Raises ParameterError for a QoS that cannot be used.
        """
        if time.monotonic() < self._update_due:
            return False
        offers = self._node.get_publishers_info_by_topic(self.topic)
        seen = {bytes(offer.endpoint_gid) for offer in offers}
        is_replaced = self._note_publishers(seen)
        published = {offer.topic_type for offer in offers}
        kinds, fault = self._readable_kinds(published)
        if kinds and self._kind not in kinds:
            try:
                subscribed_class(kinds[0])
                reader_of(kinds[0], self._settings)
            except ParameterError as error:
                about = {'type': INPUT_TYPE_NAMES[kinds[0]], 'problem': str(error)}
                kinds, fault = [], self._finding('unusable_type', ERROR, **about)
        self._note('type', fault)
        if kinds and self._kind not in kinds:
            self.close()
            self._subscribe(kinds[0], offers)
            self._publishers = seen
        elif self.is_subscribed and self._is_other_qos_due(offers):
            self._take_waiting()
            self._unsubscribe()
            self._subscribe(self._kind, offers)
        if self.is_subscribed:
            self._update_due = time.monotonic() + _UPDATE_INTERVAL
        if is_replaced and self._kind:
            self._reader = reader_of(self._kind, self._settings)
        self._note_other_types(published)
        self._note_incompatible(offers)
        return is_replaced

    def _finding(self, code: str, level: int, **values: Any) -> Finding:
        """Return a finding about the topic."""
        return Finding(code, values={'topic': self.topic, **values}, level=level)

    def _readable_kinds(self, published: set[str]) -> tuple[list[str], Finding | None]:
        """Return the input types that can be subscribed to, and the fault if none is published."""
        marker_type = self._settings.marker_type
        is_auto = marker_type == 'auto'
        readable = list(AUTO_TYPES) if is_auto else [marker_type]
        matching = [kind for kind in readable if INPUT_TYPE_NAMES[kind] in published]
        fault = None
        if published and not matching:
            is_tf = INPUT_TYPE_NAMES['tf'] in published and is_auto
            fault = self._finding(
                'wrong_type_or_tf' if is_tf else 'wrong_type',
                ERROR,
                published=', '.join(sorted(published)),
                readable=', '.join(INPUT_TYPE_NAMES[kind] for kind in readable),
            )
        return matching if is_auto else readable, fault

    def _highest_depth(self) -> int:
        """Return the depth that bounds the bytes that wait, a power of two."""
        depth = SUBSCRIPTION_DEPTH
        while depth > 1 and depth * self._largest_size > MAX_WAITING_BYTES:
            depth //= 2
        return depth

    def _is_other_qos_due(self, offers: Sequence[TopicEndpointInfo]) -> bool:
        """Whether the depth is too high, or the publishers offer another reliability."""
        used = self._subscription.qos_profile
        if self._highest_depth() < self._depth == used.depth:
            # A depth that the user has set stays.
            return True
        kind = INPUT_TYPE_NAMES[self._kind]
        is_offered = any(offer.topic_type == kind for offer in offers)
        offered = strictest_qos(offers, kind, self._depth).reliability
        return is_offered and not self._is_reliability_given and used.reliability != offered

    def _subscribe(self, kind: str, offers: Sequence[TopicEndpointInfo]) -> None:
        # First, as it may not go with the parameters.
        self._reader = reader_of(kind, self._settings)
        self._depth = self._highest_depth()
        # Reliable where it is offered: then no frame is lost in a stall. Frames of before are not
        # asked for.
        offered = strictest_qos(offers, INPUT_TYPE_NAMES[kind], self._depth)
        qos = QoSProfile(depth=self._depth, reliability=offered.reliability)
        policies = [QoSPolicyKind.HISTORY]
        if self._is_reliability_given:
            policies.append(QoSPolicyKind.RELIABILITY)
        if self._depth == SUBSCRIPTION_DEPTH:
            policies.append(QoSPolicyKind.DEPTH)
        overrides = f'qos_overrides.{self.topic}.subscription'
        try:
            self._subscription = self._node.create_subscription(
                subscribed_class(kind),
                self._settings.marker_topic,
                self._on_markers,
                qos,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=QoSOverridingOptions(policies),
                raw=True,
            )
        except Exception as error:  # rclpy raises many types, some without a text
            raise ParameterError(
                f'parameters {overrides} cannot be used '
                f'({str(error) or type(error).__name__}); correct them or leave them out'
            ) from None
        self._kind = kind
        bodies = ', '.join(self._settings.bodies)
        self._node.get_logger().info(f'follows {bodies} on {self.topic} ({INPUT_TYPE_NAMES[kind]})')

    def _note_incompatible(self, offers: Sequence[TopicEndpointInfo]) -> None:
        """Note a publisher that offers too little QoS; rclpy reports it only when it appears."""
        fault = None
        for offer in offers:
            if offer.topic_type != INPUT_TYPE_NAMES.get(self._kind):
                continue
            match, reason = qos_check_compatible(offer.qos_profile, self._subscription.qos_profile)
            if match == QoSCompatibility.ERROR:
                problem = reason.replace('ERROR: ', '').rstrip(';')
                fault = self._finding('less_qos', ERROR, problem=problem)
        self._note('qos', fault)

    def _note_other_types(self, published: set[str]) -> None:
        followed = INPUT_TYPE_NAMES.get(self._kind)
        fault = None
        if followed in published and len(published) > 1:
            others = ', '.join(sorted(published - {followed}))
            fault = self._finding('other_types', WARN, others=others, type=followed)
        self._note('other types', fault)

    def _note_publishers(self, seen: set[bytes]) -> bool:
        """Note the present publishers; return whether they have replaced all earlier ones."""
        if not seen or seen == self._publishers:
            return False
        is_replaced = bool(self._publishers) and not seen & self._publishers
        self._publishers, self._number = seen, None
        return is_replaced

    def take(
        self, message: bytes, info: Mapping[str, Any]
    ) -> tuple[list[MarkerFrames | MessageError], int]:
        """
        Read this message and those that wait, some of them at most; the rest waits on.

        Returns the results, and how many messages were lost, on the way or since they are too old.
        A message that is too large is released before the next one is taken.
        """
        small: list[bytes] = []
        refused: list[MarkerFrames | MessageError] = []
        numbers: list[int | None] = []
        now, waited, lost = time.time_ns(), 0.0, 0
        waiting = take(self._subscription, _BATCH - 1)
        too_late = _TOO_LATE if self._is_behind() else math.inf
        for data, details in chain([(message, info)], waiting):
            numbers.append(sequence_number(details))
            self._largest_size = max(self._largest_size, len(data))
            age = (now - (received_at(details) or now)) * 1e-9
            waited = max(waited, age)
            self._is_skipping = age > (_LATE if self._is_skipping else too_late)
            if self._is_skipping:
                lost += 1
            elif len(data) > MAX_MESSAGE_BYTES:
                refused.append(MessageError(describe_excess(self.topic, len(data))))
            else:
                small.append(data)
        self._note_wait(waited)
        # Errors first, so that the last result is the newest frame.
        return [*refused, *self._reader.read(small)], lost + self._count_lost(numbers)

    def _is_behind(self) -> bool:
        """Whether messages have been taken late for more than a stall."""
        since = self._behind_since
        return since is not None and time.monotonic() - since[0] > _PATIENCE

    def _note_wait(self, seconds: float) -> None:
        """Note where messages have been waiting for long, over more than a stall."""
        if seconds < _LATE:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = time.monotonic(), time.process_time()
        elif self._is_behind():
            began, cpu_time = self._behind_since
            share = (time.process_time() - cpu_time) / (time.monotonic() - began)
            about = {'seconds': seconds, 'share': share}
            self._note('behind', Finding('behind', values=about))

    def _count_lost(self, numbers: Iterable[int | None]) -> int:
        """Count the messages missing between these, where one publisher numbers them."""
        lost = 0
        if not self._publishers:
            # The first message of a publisher that came since the last look.
            self._update_due = 0.0
        for number in numbers:
            if number and self._number is not None:
                if number <= self._number:
                    # Another publisher, or the same one started again.
                    self._update_due = 0.0
                if len(self._publishers) == 1:
                    lost += max(0, number - self._number - 1)
                elif number <= self._number:
                    self._alternations += 1
            self._number = number
        return lost

    def note_pose_fault(self) -> None:
        """Note names of poses that no message has, or stamped too late, and what is no marker."""
        reader = self._reader if self._kind else None
        self._note('names', reader.fault() if reader is not None else None)

    def note_several_publishers(self) -> None:
        """Note whether several publishers have sent alternately since the last call."""
        fault = None
        # Once may be a driver that was killed and has restarted, before its end was noticed.
        # Several nodes may publish on /tf.
        if self._alternations > 1 and self._kind != 'tf':
            names = ', '.join(publishers_of(self._node, self.topic))
            fault = self._finding('several_publishers', WARN, names=names)
        self._note('sources', fault)
        self._alternations = 0


def subscribed_class(kind: str) -> type:
    """
    Return the class that rclpy subscribes to an input type with.

    Raises ParameterError where its package is not installed, or cannot be used here.
    """
    name = INPUT_TYPE_NAMES[kind]
    package = name.partition('/')[0]
    reason = f'the package {package} is not installed, or its workspace is not sourced'
    try:
        found: type = installed_class(name)
        reason = f'the package {package} that is installed has no {name} for this Python'
        check_is_valid_msg_type(found)
    except Exception:  # LookupError, and whatever rclpy raises where it loads the type
        raise ParameterError(
            f'{reason}; fix: install {package} for this ROS, source it, and start the node again'
        ) from None
    return found


def describe_excess(topic: str, size: int) -> str:
    """Return the fault of a message of `size` bytes that is too large to be read."""
    return (
        f'a message on {topic} has {size} bytes, and messages of more than {MAX_MESSAGE_BYTES} are '
        'not read: publish only markers there, or set marker_topic to a topic of markers'
    )


def publishers_of(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish a topic, once for each known publisher."""
    offers = node.get_publishers_info_by_topic(topic)
    named = [offer for offer in offers if has_known_node(offer)]
    return sorted(f'{o.node_namespace.rstrip("/")}/{o.node_name}' for o in named)
