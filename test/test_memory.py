"""The memory that a publisher can take of the live node and of `kinpole discover` is bounded."""

import threading

import pytest
from conftest import ros_class
from test_faults import Rig, message, rod
from test_node import LIMIT

import kinpole_ros.ros.listener as listen_module
from kinpole_ros.bags import BagError
from kinpole_ros.messages import MARKER_TYPES, serialize_message
from kinpole_ros.ros.source import MAX_MESSAGE_BYTES


@pytest.mark.parametrize(
    ('size', 'told'),
    [(MAX_MESSAGE_BYTES, 'are not read: publish only markers'), (0, 'MiB came on /flooded; fix: ')],
)
def test_what_is_kept_of_a_flooded_topic_is_bounded(
    monkeypatch: pytest.MonkeyPatch, size: int, told: str
) -> None:
    monkeypatch.setattr(listen_module, '_MAX_KEPT_BYTES', 1000)
    sent = serialize_message(message(1, rod(1))) + bytes(size)
    rig, done = Rig(), threading.Event()
    made = rig.node.create_publisher(ros_class(MARKER_TYPES['marker_array']), '/flooded', 10)

    def flood() -> None:
        while not done.wait(0.01):
            made.publish(sent)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        with pytest.raises(BagError, match=told):
            listen_module.listen('flooded', 1.0)
    finally:
        done.set()
        thread.join(LIMIT)
        rig.close()
