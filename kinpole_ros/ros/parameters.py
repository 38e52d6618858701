"""
A node whose settings are the table of parameters: declared, checked, and set while it runs.

The bodies and their markers can be set while the node is not active. They are set one after the
other and may contradict each other meanwhile; until they agree the node cannot be activated.
"""

from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos_overriding_options import QoSOverridingOptions

from kinpole_ros.messages import INPUT_TYPE_NAMES, installed_class
from kinpole_ros.ros.private import wrap_service
from kinpole_ros.settings import (
    INACTIVE,
    NODE_PARAMETERS,
    PARAMETERS,
    START,
    Parameter,
    ParameterError,
    Settings,
    check_value,
    known_rows,
    own_name,
    own_parameters,
    settings_from,
)

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

_NAME_LISTS = ('bodies', 'joints')  # set first: each name in them has parameters of its own
_POLICIES = [p.name.lower() for p in QoSOverridingOptions.with_default_policies().policy_kinds]


class ParameterNode(LifecycleNode, ABC):
    """
    A managed node with the parameters of the table as `settings`, and the `theory` they name.

    `incomplete` says why parameters contradict each other, '' if they do not; while they do, the
    settings stay as they were. A subclass sets `active`, and applies new settings.
    """

    def __init__(self, name: str) -> None:
        # Parameters of bodies to come are undeclared, and the same check refuses unknown ones.
        super().__init__(
            name,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self.active = False
        given = _values(self)
        self.has_given_parameters = bool({*PARAMETERS, *NODE_PARAMETERS} & given.keys())
        self.settings = _declare_all(self, given)
        self.theory = checked_theory(self.settings)
        self.incomplete = ''
        # While a request sets several parameters, and whether one of the table has changed.
        self._in_request = self._has_changed = False

    @abstractmethod
    def use_settings(self) -> None:
        """Apply changed settings."""

    @abstractmethod
    def check_settings(self, settings: Settings) -> None:
        """Raise ParameterError for settings that do not go with the present state of the node."""

    def accept_changes(self) -> None:
        """Check and apply parameters that are set from now on."""
        self.add_on_set_parameters_callback(self._check_changes)
        self.add_post_set_parameters_callback(self._apply_changes)
        for kind in (SetParameters, SetParametersAtomically):
            wrap_service(self, kind, self._answer_request)

    def declare_parameters(
        self, namespace: str, parameters: Sequence[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[RosParameter]:
        """As in rclpy, but name the parameters that were given without a value."""
        self._is_declaring = True
        try:
            return list(super().declare_parameters(namespace, parameters, ignore_override))
        except ValueError:
            names = [row[0] for row in parameters if len(row) > 1 and row[1] is None]
            if not names:
                raise
            raise ParameterError(
                f'parameter {", ".join(names)} has no value; leave it out or give it one'
            ) from None
        finally:
            self._is_declaring = False

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """As in rclpy, but accept read-only parameters that keep their value, as in a dump."""
        changes = [p for p in parameter_list if not self._is_unchanged(p)]
        return super().set_parameters_atomically(changes)

    def _is_unchanged(self, change: RosParameter) -> bool:
        if not self.has_parameter(change.name):
            return False
        now, new = (
            list(value) if isinstance(value, list | tuple | array) else value
            for value in (self.get_parameter(change.name).value, change.value)
        )
        return bool(now == new and isinstance(now, bool) == isinstance(new, bool))

    def _answer_request(self, set_all: Callable[..., Any], request: Any, response: Any) -> Any:
        """Answer a request to set parameters: bound its size, and apply all changes at once."""
        named = {p.name: p.value.string_array_value for p in request.parameters}
        new = sum(2 * len(named.get(name, ())) for name in _NAME_LISTS)
        count, limit = len(request.parameters), len(_values(self)) + new
        if count > limit:
            reason = f'{count} parameters in one request, and this node has {limit}: set each once'
            refused = SetParametersResult(successful=False, reason=reason)
            if isinstance(response, SetParameters.Response):
                response.results = [refused] * count
            else:
                response.result = refused
            return response
        # Bodies before their markers, in whatever order a file has them.
        order = sorted(range(count), key=lambda k: request.parameters[k].name not in _NAME_LISTS)
        request.parameters = [request.parameters[k] for k in order]
        self._in_request, self._has_changed = True, False
        try:
            response = set_all(request, response)
        finally:
            self._in_request = False
            if self._has_changed:
                self._use_parameters()
        if isinstance(response, SetParameters.Response):
            results = dict(zip(order, response.results, strict=True))
            response.results = [results[k] for k in range(count)]
        return response

    def _check_changes(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        if self._is_declaring:
            return SetParametersResult(successful=True)
        new = {p.name: p.value for p in changes}
        may_follow = False
        try:
            may_follow = self._check_each(new)
            settings = settings_from(_known_values(self, new))
            checked_theory(settings)
            self.check_settings(settings)
        except ParameterError as error:
            return SetParametersResult(successful=may_follow, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_each(self, new: dict[str, Any]) -> bool:
        """
        Whether these changes may contradict other parameters until those are set too.

        Raises ParameterError for a change that is wrong whatever the other parameters are.
        """
        rows = known_rows(_known_values(self, new))
        for name in new:
            # rclpy reads these only when it subscribes.
            if name.startswith('qos_overrides.'):
                raise ParameterError(f'parameter {name} is read at the start only; set it there')
            if name in rows:
                check_value(name, rows[name], new)
        of_bodies = [name for name in new if name in rows and rows[name].settable == INACTIVE]
        if of_bodies and self.active:
            raise ParameterError(
                f'parameter {", ".join(of_bodies)} cannot be set while the node is active, as its '
                'topics go by it; fix: ros2 lifecycle set '
                f'{self.get_fully_qualified_name()} deactivate, set it, and activate again'
            )
        return not self.active and bool(self.incomplete or of_bodies)

    def _apply_changes(self, changes: Sequence[RosParameter]) -> None:
        names = {p.name for p in changes}
        if self._is_declaring or not any(n in PARAMETERS or own_name(n) for n in names):
            return
        if names & {*_NAME_LISTS}:
            _redeclare_own(self)
        if self._in_request:
            self._has_changed = True
        else:
            self._use_parameters()

    def _use_parameters(self) -> None:
        """Make the parameters the settings, unless they contradict each other."""
        try:
            settings = settings_from(_known_values(self))
            self.theory = checked_theory(settings)
        except ParameterError as error:
            self.incomplete = str(error)
            self.get_logger().warning(f'{error}; until then the node cannot be activated')
            return
        self.settings, self.incomplete = settings, ''
        self.use_settings()


def qos_overrides_without_effect(node: Node, topic: str) -> list[str]:
    """Return QoS overrides of other topics, where none is of `topic`: a misspelled name."""
    overrides = [name for name in _values(node) if name.startswith('qos_overrides.')]
    # Nodes in several namespaces may share a file with the topics of all.
    is_right = any(name.startswith(f'qos_overrides.{topic}.') for name in overrides)
    return [] if is_right else overrides


def _declare_all(node: Node, given: Mapping[str, Any]) -> Settings:
    """
    Declare all parameters with description and range, with the values `given` or the defaults.

    Raises ParameterError for an unknown one, also for the QoS of the topic of the markers.
    """
    settings = settings_from(given)
    topic = node.resolve_topic_name(settings.marker_topic)
    overrides = [f'qos_overrides.{topic}.subscription.{policy}' for policy in _POLICIES]
    for name in given:
        if name.startswith(f'qos_overrides.{topic}.') and name not in overrides:
            raise ParameterError(f'unknown parameter {name}; known are {", ".join(overrides)}')
    # rclpy would complain of other values in several lines, or accept them.
    name = f'qos_overrides.{topic}.subscription.depth'
    depth = given.get(name, 1)
    if type(depth) is not int or depth < 1:
        raise ParameterError(f'parameter {name} is {depth!r}; it must be a whole number from 1 up')
    rows = {**PARAMETERS, **NODE_PARAMETERS}
    rows.update(own_parameters(settings.bodies, settings.joints))
    _declare(node, rows, given)
    return settings


def _redeclare_own(node: Node) -> None:
    """Declare the parameters of the present bodies and joints, and undeclare those of others."""
    given = _values(node)
    rows = own_parameters(given['bodies'], given['joints'])
    for name in given.keys() - rows.keys():
        if own_name(name):
            node.undeclare_parameter(name)
    _declare(node, rows, given)


def _declare(node: Node, rows: Mapping[str, Parameter], given: Mapping[str, Any]) -> None:
    for name, row in rows.items():
        descriptor = ParameterDescriptor(
            description=row.description,
            additional_constraints=row.kind.allowed,
            read_only=row.settable == START,
            dynamic_typing=True,
        )
        value = given.get(name, row.default)
        if row.kind.span:
            lowest, highest = row.kind.span
            span = FloatingPointRange(from_value=lowest, to_value=highest)
            descriptor.floating_point_range = [span]
            value = float(value)
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        node.declare_parameter(name, value, descriptor, ignore_override=True)


def _values(node: Node) -> dict[str, Any]:
    """The values of all declared parameters by name."""
    return {name: p.value for name, p in node.get_parameters_by_prefix('').items()}


def _known_values(node: Node, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """
    The values of the parameters of the table, with these changes.

    Raises ParameterError for changes that name no bodies or no joints.
    """
    new = dict(changes or {})
    values = {**_values(node), **new}
    name_lists = (check_value(name, PARAMETERS[name], values) for name in _NAME_LISTS)
    names = {*PARAMETERS, *own_parameters(*name_lists), *new}
    return {name: value for name, value in values.items() if name in names}


def checked_theory(settings: Settings) -> 'Theory | None':
    """Load the theory; ParameterError for settings that need tf2_msgs where it is missing."""
    for name, value, is_needed in (
        ('publish_tf', 'true', settings.publish_tf),
        ('marker_type', 'tf', settings.marker_type == 'tf'),
    ):
        if not is_needed:
            continue
        try:
            installed_class(INPUT_TYPE_NAMES['tf'])
        except LookupError:
            raise ParameterError(
                f'parameter {name} is {value}, and tf2_msgs is not installed; install '
                'ros-jazzy-tf2-msgs, or set it otherwise'
            ) from None
    if not settings.scene:
        return None
    # Linkages take as long to import as the rest of the node.
    from kinpole_ros.linkage.theory import load_theory

    return load_theory(settings)
