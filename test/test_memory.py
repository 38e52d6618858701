"""The memory that a publisher can take of the live node and of `kinpole discover` is bounded."""

import threading
from pathlib import Path

import pytest
from conftest import write_config
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import serialize_message
from test_faults import SETTINGS, Rig, message, rod
from test_node import LIMIT, process

import kinpole_ros.ros.listener as listen_module
from kinpole_ros.bags import BagError
from kinpole_ros.messages import MARKER_TYPES
from kinpole_ros.ros.source import MAX_MESSAGE_BYTES


@pytest.mark.parametrize('given', [None, 7])
def test_the_default_depth_bounds_memory_and_can_be_overridden(
    tmp_path: Path, given: int | None
) -> None:
    topic = '/bounded'
    depth = f'qos_overrides.{topic}.subscription.depth'
    more = {} if given is None else {depth: given}
    config = write_config(tmp_path / 'rod.yaml', SETTINGS, marker_identity='index', **more)
    rig = Rig('bounded', topic)
    try:
        with (
            process(*rig.words(config), log=tmp_path / 'stderr'),
            rig.publisher(MARKER_TYPES['marker_array']),
        ):
            request = GetParameters.Request(names=[depth])
            asked = rig.call('/bounded/get_parameters', GetParameters, request)
        found = asked.values[0].integer_value
        if given is None:
            assert 0 < found * MAX_MESSAGE_BYTES <= 64 << 20
        else:
            assert found == given
    finally:
        rig.close()


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
    made = rig.node.create_publisher(MARKER_TYPES['marker_array'], '/flooded', 10)

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
