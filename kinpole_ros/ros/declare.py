"""The table of parameters as rclpy has it: declared for the node, and read back."""

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions

from kinpole_ros.tracking.parameters import (
    NODE_PARAMETERS,
    PARAMETERS,
    Parameter,
    ParameterError,
    Settings,
    check_value,
    is_of_bodies,
    own_parameters,
    settings_from,
)

_POLICIES = [p.name.lower() for p in QoSOverridingOptions.with_default_policies().policy_kinds]


def declare(node: Node) -> Settings:
    """
    Declare every parameter with its description and range; returns what they are set to.

    Raises ParameterError for what is not known, QoS of the topic of the markers included.
    """
    given = given_to(node)
    settings = settings_from(given)
    topic = node.resolve_topic_name(settings.marker_topic)
    known = [f'qos_overrides.{topic}.subscription.{policy}' for policy in _POLICIES]
    for name in given:
        if name.startswith(f'qos_overrides.{topic}.') and name not in known:
            raise ParameterError(f'unknown parameter {name}; known are {", ".join(known)}')
    # Of others rclpy makes something else, or a complaint of several lines.
    name = f'qos_overrides.{topic}.subscription.depth'
    depth = given.get(name, 1)
    if type(depth) is not int or depth < 1:
        raise ParameterError(f'parameter {name} is {depth!r}; it must be a whole number from 1 up')
    rows = {**PARAMETERS, **NODE_PARAMETERS}
    rows.update(own_parameters(settings.bodies, settings.joints))
    _declare(node, rows, given)
    return settings


def declare_own(node: Node) -> None:
    """Declare what bodies and joints there are now have of their own, and no others."""
    given = given_to(node)
    rows = own_parameters(given['bodies'], given['joints'])
    for name in given.keys() - rows.keys():
        if is_of_bodies(name) and name not in PARAMETERS:
            node.undeclare_parameter(name)
    _declare(node, {name: row for name, row in rows.items() if name not in given}, {})


def _declare(node: Node, rows: Mapping[str, Parameter], given: Mapping[str, Any]) -> None:
    """Declare these as they are given, or by default."""
    for name, row in rows.items():
        descriptor = ParameterDescriptor(
            description=row.description,
            additional_constraints=row.allowed,
            read_only=row.fixed,
            dynamic_typing=True,
        )
        value = given.get(name, row.default)
        if row.lowest is not None and row.highest is not None:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=row.lowest, to_value=row.highest)
            ]
            value = float(value)
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        node.declare_parameter(name, value, descriptor, ignore_override=True)


def given_to(node: Node) -> dict[str, Any]:
    """Parameters by name, of a node that has declared what it was given."""
    return {name: p.value for name, p in node.get_parameters_by_prefix('').items()}


def values_of(node: Node, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """
    The parameters of the table, as they are set now, or will be with these changes.

    Raises ParameterError for changes that name no bodies or no joints.
    """
    new = dict(changes or {})
    values = {**given_to(node), **new}
    named = (check_value(name, PARAMETERS[name], values) for name in ('bodies', 'joints'))
    names = {*PARAMETERS, *own_parameters(*named), *new}
    return {name: value for name, value in values.items() if name in names}


def given_in_vain(node: Node, topic: str) -> list[str]:
    """QoS given for other topics alone, where this node reads `topic`: a slip in the name."""
    given = [name for name in given_to(node) if name.startswith('qos_overrides.')]
    # Nodes in several namespaces may share a file with the topics of all.
    ours = any(name.startswith(f'qos_overrides.{topic}.') for name in given)
    return [] if ours else given
