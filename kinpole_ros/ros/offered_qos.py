"""The quality of service of a subscription, by what the publishers of its topic offer."""

from collections.abc import Iterable

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo


def strictest_qos(offers: Iterable[TopicEndpointInfo], kind: str, depth: int) -> QoSProfile:
    """
    Return the strictest QoS that all publishers of messages of a type offer.

    Where there are none yet, it is the one that all can serve.

    Parameters
    ----------
    offers : iterable of TopicEndpointInfo
        The publishers of a topic.
    kind : str
        The type of messages, as 'package/msg/Name'.
    depth : int
        How many messages may wait.

    Returns
    -------
    QoSProfile
        Reliable, or transient local, where all are.

    """
    own = [offer.qos_profile for offer in offers if offer.topic_type == kind]
    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
    if own and all(o.reliability == ReliabilityPolicy.RELIABLE for o in own):
        qos.reliability = ReliabilityPolicy.RELIABLE
    if own and all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in own):
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return qos
