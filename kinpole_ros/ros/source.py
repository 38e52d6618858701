"""Where the markers come from: a topic that is found, subscribed to, taken from and watched."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from kinpole_ros.messages import (
    AUTO_TYPES,
    INPUT_TYPE_NAMES,
    INPUT_TYPES,
    MessageError,
    PoseReader,
    reader_of,
)
from kinpole_ros.ros.executor import SubscriptionGroup
from kinpole_ros.ros.private import has_known_node, sequence_number, take
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.parameters import ParameterError, Settings

# Messages that wait while others are read: a stall of 50 ms at 1 kHz. The middleware keeps the
# memory of the largest ones, so the depth bounds it.
SUBSCRIPTION_DEPTH = 50
# Larger messages are not read: 4,000 markers of a MarkerArray, or 65,000 points of a PointCloud2.
MAX_MESSAGE_BYTES = 1 << 20


class MarkerSource:
    """
    The topic of the markers.

    `on_markers` is called with a message and its info, by rclpy or by `take_messages`, and has them
    and all that waits read by `take`. `note` is given what is wrong, by a word for it, and '' when
    that is over.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        on_markers: Callable[[bytes, Mapping[str, Any]], None],
        note: Callable[[str, str], None],
    ) -> None:
        self._node, self._settings = node, settings
        self._on_markers, self._note = on_markers, note
        self.topic = node.resolve_topic_name(settings.marker_topic)
        self._subscription: Any = None
        self.group = SubscriptionGroup()
        self._kind = ''
        # Whether the markers were asked for reliably.
        self.lossless = False
        self._publishers: set[bytes] = set()
        # Of the last message, as its publisher numbers them.
        self._number: int | None = None
        # How often, of late, the number was no higher: another publisher took its turn.
        self._turns = 0

    @property
    def found(self) -> bool:
        """Whether the topic is subscribed to."""
        return self._subscription is not None

    @property
    def subscriptions(self) -> list[Subscription]:
        """That of the markers, once there is one."""
        return [self._subscription] if self.found else []

    def take_messages(self) -> None:
        """Take markers, if any wait, and have them worked on."""
        for taken in [*take(self._subscription, 1)]:
            self._on_markers(*taken)

    def close(self) -> None:
        """Listen no more; to look again begins again."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._subscription = None
        self._kind = ''
        self._number = None
        self._publishers = set()

    def start_anew(self, settings: Settings) -> None:
        """Forget what came, and identify markers as these settings say."""
        self._settings = settings
        self._number = None
        if self._kind:
            self._reader = reader_of(self._kind, settings)

    def check(self, settings: Settings) -> None:
        """Raise ParameterError where what is read does not go with these settings."""
        if self._kind:
            reader_of(self._kind, settings)

    def look(self) -> bool:
        """
        Subscribe as soon as the type of the markers is known; note it where none can be read.

        Returns whether another publisher has taken over, whose markers may be other ones. Raises
        ParameterError for a QoS that cannot be used.
        """
        offers = self._node.get_publishers_info_by_topic(self.topic)
        replaced = self._note_publishers({bytes(offer.endpoint_gid) for offer in offers})
        published = {offer.topic_type for offer in offers}
        wanted = self._settings.marker_type
        readable = [wanted] if wanted != 'auto' else [k for k in INPUT_TYPES if k in AUTO_TYPES]
        found = [kind for kind in readable if INPUT_TYPE_NAMES[kind] in published]
        unreadable = ''
        if published and not found:
            unreadable = (
                f'{self.topic} is published as {", ".join(sorted(published))}; it must be '
                f'one of {", ".join(INPUT_TYPE_NAMES[kind] for kind in readable)}'
            )
            if INPUT_TYPE_NAMES['tf'] in published and wanted == 'auto':
                unreadable += ', or marker_type must be tf and <body>.markers name its frame'
        kinds = found if wanted == 'auto' else readable
        if kinds and self._kind not in kinds:
            try:
                reader_of(kinds[0], self._settings)
            except ParameterError as error:
                kinds, unreadable = [], f'{self.topic} is published as poses: {error}'
        self._note('type', unreadable)
        if kinds and self._kind not in kinds:
            self.close()
            self._subscribe(kinds[0])
        if replaced and self._kind:
            self._reader = reader_of(self._kind, self._settings)
        self._note_other_types(published)
        self._note_unheard(offers)
        return replaced

    def _subscribe(self, kind: str) -> None:
        # First, as it may not go with the parameters.
        self._reader = reader_of(kind, self._settings)
        # Drivers mostly send as sensors do; what is late is not worth waiting for.
        qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        overrides = f'qos_overrides.{self.topic}.subscription'
        try:
            self._subscription = self._node.create_subscription(
                INPUT_TYPES[kind],
                self._settings.marker_topic,
                self._on_markers,
                qos,
                callback_group=self.group,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                raw=True,
            )
            reliability = self._node.get_parameter(f'{overrides}.reliability').value
        except Exception as error:  # rclpy raises many things, some without words
            raise ParameterError(
                f'parameters {overrides} cannot be used '
                f'({str(error) or type(error).__name__}); correct them or leave them out'
            ) from None
        self.lossless = reliability == 'reliable'
        self._kind = kind
        bodies = ', '.join(self._settings.bodies)
        self._node.get_logger().info(f'follows {bodies} on {self.topic} ({INPUT_TYPE_NAMES[kind]})')

    def _note_unheard(self, offers: Sequence[TopicEndpointInfo]) -> None:
        """Note a publisher whose QoS is less than is asked for; rclpy tells only when it comes."""
        text = ''
        for offer in offers:
            if offer.topic_type != INPUT_TYPE_NAMES.get(self._kind):
                continue
            match, reason = qos_check_compatible(offer.qos_profile, self._subscription.qos_profile)
            if match == QoSCompatibility.ERROR:
                why = reason.replace('ERROR: ', '').rstrip(';')
                text = (
                    f'a publisher of {self.topic} offers less QoS than this node asks for, and '
                    f'nothing is received from it ({why}): set the parameters '
                    f'qos_overrides.{self.topic}.subscription... to what it offers'
                )
        self._note('qos', text)

    def _note_other_types(self, published: set[str]) -> None:
        followed = INPUT_TYPE_NAMES.get(self._kind)
        text = ''
        if followed in published and len(published) > 1:
            others = ', '.join(sorted(published - {followed}))
            text = (
                f'{self.topic} is published as {others} too, and that is not read: {followed} is '
                'followed; set the parameter marker_type, or publish only one of them'
            )
        self._note('other types', text)

    def _note_publishers(self, seen: set[bytes]) -> bool:
        """Whether none is left of those that were there."""
        if not seen or seen == self._publishers:
            return False
        replaced = bool(self._publishers) and not seen & self._publishers
        self._publishers, self._number = seen, None
        return replaced

    def take(
        self, message: bytes, info: Mapping[str, Any]
    ) -> tuple[list[MarkerFrames | MessageError], int, int]:
        """
        Read this message and those that wait, as many as the default depth.

        Returns what was read, of how many messages, and how many more were dropped on the way.
        Messages that are too large are released one by one, before the next is taken.
        """
        small: list[bytes] = []
        refused: list[MarkerFrames | MessageError] = []
        numbers: list[int | None] = []
        for data, details in chain(
            [(message, info)], take(self._subscription, SUBSCRIPTION_DEPTH - 1)
        ):
            numbers.append(sequence_number(details))
            if len(data) > MAX_MESSAGE_BYTES:
                refused.append(MessageError(describe_excess(self.topic, len(data))))
            else:
                small.append(data)
        # Errors come first, so that the last entry is the newest frame.
        return [*refused, *self._reader.read(small)], len(numbers), self._dropped(numbers)

    def _dropped(self, numbers: Iterable[int | None]) -> int:
        """Count what is missing between messages, where they have numbers and one publisher."""
        dropped = 0
        for number in numbers:
            if number and self._number is not None:
                if len(self._publishers) == 1:
                    dropped += max(0, number - self._number - 1)
                elif number <= self._number:
                    self._turns += 1
            self._number = number
        return dropped

    def note_names(self) -> None:
        """Note names of poses that no message has."""
        reader = self._reader if self._kind else None
        lacking = reader.unseen_names() if isinstance(reader, PoseReader) else ''
        self._note('names', f'on {self.topic} {lacking}' if lacking else '')

    def note_turns(self) -> None:
        """Note whether several publishers have sent in turn since this was asked before."""
        text = ''
        # Once may be a driver that was killed and is back, before its end was noticed. /tf is for
        # all to send on.
        if self._turns > 1 and self._kind != 'tf':
            names = ', '.join(publishers_of(self._node, self.topic))
            text = (
                f'several publishers send markers on {self.topic} in turn ({names}), and results '
                'are of all of them mixed: stop all but one'
            )
        self._note('sources', text)
        self._turns = 0


def describe_excess(topic: str, size: int) -> str:
    """Say that a message of `size` bytes is too large to be read, and how to fix it."""
    return (
        f'a message on {topic} has {size} bytes, and messages of more than {MAX_MESSAGE_BYTES} are '
        'not read: publish only markers there, or set marker_topic to a topic of markers'
    )


def publishers_of(node: Node, topic: str) -> list[str]:
    """Full names of the nodes that publish a topic, as far as known; once for each publisher."""
    offers = node.get_publishers_info_by_topic(topic)
    known = [offer for offer in offers if has_known_node(offer)]
    return sorted(f'{o.node_namespace.rstrip("/")}/{o.node_name}' for o in known)
