"""What rclpy does not document is used in ros/private.py alone, and works as it relies on."""

import ast
import importlib.util
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import String

import kinpole_ros
from kinpole_ros.ros import private

PACKAGE = Path(kinpole_ros.__file__).parent
# Public in spite of their names: methods and attributes of a NamedTuple, a function of os.
OF_TUPLES = {'_replace', '_asdict', '_fields', '_make'}
DOCUMENTED = {'_exit', '_fields_'}  # of os, and of structures of ctypes
# Public by name, but not documented.
UNDOCUMENTED = {'handle', 'take_message'}


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init(args=[])
    node = rclpy.create_node('private')
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, f'rclpy has changed: {what}'
        time.sleep(0.01)


@pytest.mark.parametrize(
    ('owner', 'names'),
    [
        (rclpy_implementation, ['RCLError', 'WaitSet']),
        (
            rclpy_implementation.WaitSet,
            ['clear_entities', 'add_subscription', 'wait', 'get_ready_entities'],
        ),
        (Executor, ['can_execute', 'spin_once', 'wait_for_ready_callbacks', 'shutdown']),
        (rclpy_implementation.Subscription, ['take_message', '__enter__', '__exit__']),
        (Subscription, ['handle']),
        (Publisher, ['handle']),
        (rclpy_implementation.Publisher, ['publish_raw']),
        (rclpy.Context, ['handle']),
        (LifecycleNode, ['services']),
    ],
)
def test_the_names_that_are_relied_on_are_there(owner: Any, names: list[str]) -> None:
    lacking = [name for name in names if not hasattr(owner, name)]
    assert not lacking, f'rclpy has changed: {owner} has no {lacking}; see ros/private.py'


def test_a_failure_of_rcl_is_an_rcl_error() -> None:
    assert issubclass(private.RCLError, RuntimeError), 'rclpy has changed: RCLError'
    context = rclpy.Context()
    with pytest.raises(private.RCLError, match=r'log.level'):
        rclpy.init(args=['--ros-args', '--log-level', 'none_of_these'], context=context)


def test_one_wait_set_serves_many_waits_and_take_has_all_messages(node: Node) -> None:
    quiet = node.create_subscription(String, 'quiet', print, 10, raw=True)
    heard = node.create_subscription(String, 'heard', print, 10, raw=True)
    publisher = node.create_publisher(String, 'heard', 10)
    until(publisher.get_subscription_count, 'a publisher does not find its subscription')
    prepared = private.PreparedWait(node.context, [quiet, heard])
    for _ in range(2):
        begun = time.monotonic()
        assert not prepared.wait(0.1), 'rclpy has changed: WaitSet.get_ready_entities of none'
        assert time.monotonic() - begun >= 0.09, 'rclpy has changed: WaitSet.wait does not wait'
    assert [*private.take(heard, 5)] == [], 'rclpy has changed: take_message of nothing'
    for word in ('a', 'b', 'c'):
        private.sender(publisher)(serialize_message(String(data=word)))
    begun = time.monotonic()
    assert prepared.wait(5.0), 'rclpy has changed: WaitSet.get_ready_entities'
    assert time.monotonic() - begun < 4, 'rclpy has changed: WaitSet.wait misses a message'
    taken = [*private.take(heard, 2)]
    until(lambda: taken.extend(private.take(heard, 3 - len(taken))) or len(taken) == 3, 'no take')
    words = [deserialize_message(data, String).data for data, _ in taken]
    assert words == ['a', 'b', 'c'], 'rclpy has changed: take_message does not give the bytes'
    numbers = [private.sequence_number(info) for _, info in taken]
    assert numbers == [1, 2, 3], 'rclpy has changed: messages have no publication_sequence_number'
    when = [private.received_at(info) or 0 for _, info in taken]
    assert when == sorted(when), 'rclpy has changed: messages have no received_timestamp'
    assert abs(time.time_ns() - when[0]) < 60e9, 'rclpy has changed: received_timestamp'
    assert [*private.take(quiet, 1)] == []
    assert not prepared.wait(0.0), 'rclpy has changed: WaitSet.wait keeps what was ready'
    node.destroy_subscription(heard)
    until(lambda: not publisher.get_subscription_count(), 'a subscription is held on')


def test_the_node_of_an_endpoint_is_known_but_for_a_moment(node: Node) -> None:
    node.create_publisher(String, 'known', 1)

    def known() -> bool:
        found = node.get_publishers_info_by_topic('/known')
        return bool(found) and private.has_known_node(found[0])

    until(known, 'the node of a publisher stays unknown')
    assert not private.has_known_node(SimpleNamespace(node_name='_NODE_NAME_UNKNOWN_'))
    # The name is written by the middleware, in which it stands as it is.
    maps = Path('/proc/self/maps').read_text().split()
    library = next((name for name in maps if 'librmw_dds_common.so' in name), None)
    if library is not None:
        assert b'_NODE_NAME_UNKNOWN_' in Path(library).read_bytes(), 'rmw_dds_common has changed'


def test_what_answers_requests_for_a_transition_can_be_wrapped() -> None:
    rclpy.init(args=[])
    managed = LifecycleNode('managed')
    asked: list[int] = []

    def refuse(change: Callable[..., object], request: object, response: object) -> object:
        asked.append(request.transition.id)  # type: ignore[attr-defined]
        with pytest.raises(private.RCLError):
            change(request, response)
        return response

    try:
        private.wrap_service(managed, ChangeState, refuse)
        client = managed.create_client(ChangeState, '/managed/change_state')
        # Which is not possible before configure.
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
        answer = client.call_async(request)
        rclpy.spin_until_future_complete(managed, answer, timeout_sec=10)
        assert answer.done(), 'rclpy has changed: change_state is not answered'
        assert asked == [Transition.TRANSITION_ACTIVATE]
        assert not answer.result().success
    finally:
        managed.destroy_node()
        rclpy.try_shutdown()


def is_private(name: str) -> bool:
    public = OF_TUPLES | DOCUMENTED
    return name.startswith('_') and not name.endswith('__') and name not in public


def defined(tree: ast.AST) -> set[str]:
    """Private names that this code makes: functions, fields, variables and attributes of self."""
    found = set()
    for each in ast.walk(tree):
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(each.name)
        elif isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            found.add(each.id)
        elif isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store) and of_self(each):
            found.add(each.attr)
    return {name for name in found if is_private(name)}


def of_self(each: ast.Attribute) -> bool:
    return isinstance(each.value, ast.Name) and each.value.id in ('self', 'cls')


def names_of_rclpy() -> set[str]:
    """Private names that rclpy defines anywhere."""
    spec = importlib.util.find_spec('rclpy')
    assert spec is not None and spec.origin is not None
    return {
        name
        for path in Path(spec.origin).parent.rglob('*.py')
        for name in defined(ast.parse(path.read_text()))
    }


def private_uses(tree: ast.Module, ours: set[str], of_rclpy: set[str]) -> list[str]:
    """
    What this module uses that others keep private, as 'line: what'.

    `ours` are the private names that the package defines, `of_rclpy` those that rclpy does. What
    derives from a class of rclpy may have no attribute of such a name, by chance or not.
    """
    found = []
    imports: set[str] = set()
    for each in ast.walk(tree):
        if isinstance(each, ast.Import):
            imports |= {alias.name for alias in each.names}
        elif isinstance(each, ast.ImportFrom) and each.module and not each.level:
            imports |= {f'{each.module}.{alias.name}' for alias in each.names}
    for name in imports:
        top, *rest = name.split('.')
        if top != 'kinpole_ros' and (any(map(is_private, rest)) or name.startswith('rclpy.impl')):
            found.append(f'0: import of {name}')
    alone = {
        attribute
        for each in ast.walk(tree)
        if isinstance(each, ast.ClassDef) and not each.bases
        for attribute in ast.walk(each)
        if isinstance(attribute, ast.Attribute) and of_self(attribute)
    }
    near_rclpy = any(name.split('.')[0] == 'rclpy' for name in imports)
    for each in ast.walk(tree):
        if isinstance(each, ast.Attribute):
            name = each.attr
            if is_private(name):
                foreign = name not in ours or (
                    near_rclpy and name in of_rclpy and each not in alone
                )
            else:
                foreign = near_rclpy and name in UNDOCUMENTED
            if foreign:
                found.append(f'{each.lineno}: {ast.unparse(each)}')
        # As for getattr and its like.
        elif near_rclpy and isinstance(each, ast.Constant) and each.value in of_rclpy:
            found.append(f'{each.lineno}: {each.value!r}')
    return found


def test_no_private_name_of_others_is_used_elsewhere() -> None:
    trees = {path: ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob('*.py'))}
    ours = {name for tree in trees.values() for name in defined(tree)}
    of_rclpy = names_of_rclpy()
    assert {'_parameter_overrides', '_service_change_state'} <= of_rclpy
    found = [
        f'{path.relative_to(PACKAGE.parent)}:{use}'
        for path, tree in trees.items()
        if path != Path(private.__file__)
        for use in private_uses(tree, ours, of_rclpy)
    ]
    assert not found, 'to be put in ros/private.py:\n' + '\n'.join(found)


@pytest.mark.parametrize(
    'line',
    [
        'node._parameter_overrides',
        'self._service_change_state.callback = 1',
        'class Ours(Node):\n    def __init__(self):\n        self._clock = 1',
        "getattr(node, '_parameter_overrides')",
        'subscription.handle',
        'handle.take_message(kind, True)',
        'array._mask_of_another',
        'from rclpy.impl.implementation_singleton import rclpy_implementation',
        'from rclpy._rclpy_pybind11 import RCLError',
        'import rclpy._rclpy_pybind11',
    ],
)
def test_a_private_use_is_found(line: str) -> None:
    known = ({'_own', '_clock'}, names_of_rclpy())
    assert len(private_uses(ast.parse(f'import rclpy\n{line}'), *known)) == 1


def test_what_is_our_own_is_no_private_use() -> None:
    code = """
import rclpy

class Source:
    def wait(self):
        self._node = record._replace(x=1)
        return other._own.__class__
"""
    assert private_uses(ast.parse(code), {'_own', '_node'}, names_of_rclpy()) == []
