"""
The live node: markers in, results out, nothing computed that nobody reads.

A thin shell around the tracker: it declares the parameters, finds the type of the marker topic,
and publishes the rows of the results table that have subscribers.
"""

import re
import sys
from collections.abc import Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.utilities import remove_ros_args

from kinpole_ros.estimate import Estimate
from kinpole_ros.messages import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    DiagnosticsMaker,
    MessageError,
    Output,
    read_markers,
    result_outputs,
)
from kinpole_ros.parameters import AUTOSTART, MARKERS, PARAMETERS, ParameterError, settings_from
from kinpole_ros.theory import load_theory
from kinpole_ros.tracker import Tracker

_DIAGNOSTICS_EVERY = 1.0
_LOOK_EVERY = 0.1


class KinpoleNode(LifecycleNode):
    """Tracks the bodies its parameters name; managed, and active from the start."""

    def __init__(self) -> None:
        try:
            super().__init__('kinpole', automatically_declare_parameters_from_overrides=True)
        except ValueError:
            # rclpy does not say which, and what was given is not public.
            given = getattr(self, '_parameter_overrides', {})
            names = [name for name, p in given.items() if p.type_ == RosParameter.Type.NOT_SET]
            raise ParameterError(
                f'parameter {", ".join(names)} has no value; leave it out or give it one'
            ) from None
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._declare()
        self.settings = settings_from(self._values())
        self._theory = load_theory(self.settings)
        self._tracker = Tracker(self.settings)
        self._diagnostics = DiagnosticsMaker(self.get_name(), self._theory)
        self._outputs: list[tuple[Output, Any]] = []
        self._subscription: Any = None
        self._kind = ''
        self._timers_made: list[Any] = []
        self._latest: Estimate | None = None
        self._trouble: dict[str, str] = {}
        self._told = self._steady.now()
        self._status: Any = None
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        if self.get_parameter('autostart').value:
            self.trigger_configure()
            self.trigger_activate()

    def _declare(self) -> None:
        """Declare every parameter with its description and range; unknown ones are refused."""
        given = {name: p.value for name, p in self.get_parameters_by_prefix('').items()}
        settings = settings_from(given)
        rows = {**PARAMETERS, 'autostart': AUTOSTART}
        rows.update({f'{body}.markers': MARKERS for body in settings.bodies})
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
            if self.has_parameter(name):
                self.undeclare_parameter(name)
            self.declare_parameter(name, value, descriptor, ignore_override=True)

    def _values(self) -> dict[str, Any]:
        names = {*PARAMETERS, *(f'{b}.markers' for b in self.get_parameter('bodies').value)}
        return {name: self.get_parameter(name).value for name in names}

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """As in rclpy, but tell the names that are known, where it raises without any."""
        if not all(self.has_parameter(p.name) for p in parameter_list):
            result = self._check_parameters(parameter_list)
            if not result.successful:
                return result
        return super().set_parameters_atomically(parameter_list)

    def _check_parameters(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        try:
            load_theory(settings_from({**self._values(), **{p.name: p.value for p in changes}}))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, changes: Sequence[RosParameter]) -> None:
        """Start anew with the changed settings."""
        if not any(self._is_ours(p.name) for p in changes):
            return
        self.settings = settings_from(self._values())
        self._theory = load_theory(self.settings)
        self._tracker = Tracker(self.settings)
        self._diagnostics = DiagnosticsMaker(self.get_name(), self._theory)
        self._latest = None
        if self._outputs:
            self._drop_outputs()
            self._make_outputs()

    def _is_ours(self, name: str) -> bool:
        return name in PARAMETERS or name.endswith('.markers')

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the publishers."""
        self._make_outputs()
        self._status = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start listening, with an empty window."""
        result = super().on_activate(state)
        self._tracker = Tracker(self.settings)
        self._diagnostics = DiagnosticsMaker(self.get_name(), self._theory)
        self._latest = None
        self._told = self._steady.now()
        # A steady clock: these beat even where simulated time stands still.
        self._timers_made = [
            self.create_timer(_DIAGNOSTICS_EVERY, self._tell, clock=self._steady),
            self.create_timer(_LOOK_EVERY, self._find_markers, clock=self._steady),
        ]
        self._find_markers()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening."""
        for timer in self._timers_made:
            self.destroy_timer(timer)
        self._timers_made = []
        self._unsubscribe()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take the publishers down."""
        self._drop_outputs()
        if self._status is not None:
            self.destroy_publisher(self._status)
            self._status = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From wherever the node is, stop and take everything down."""
        self.on_deactivate(state)
        return self.on_cleanup(state)

    def _make_outputs(self) -> None:
        highest = self.settings.derivative_order or 4
        for output in result_outputs(
            tuple(self.settings.bodies), self.settings.plane, self._theory
        ):
            if output.order <= highest:
                publisher = self.create_lifecycle_publisher(
                    output.message_type, f'~/{output.topic}', 10
                )
                if self._timers_made:
                    publisher.on_activate(LifecycleState('active', 0))
                self._outputs.append((output, publisher))

    def _drop_outputs(self) -> None:
        for _, publisher in self._outputs:
            self.destroy_lifecycle_publisher(publisher)
        self._outputs = []

    def _find_markers(self) -> None:
        """Subscribe as soon as the type of the markers is known; tell when none can be read."""
        topic = self.settings.marker_topic
        resolved = self.resolve_topic_name(topic)
        published = {p.topic_type for p in self.get_publishers_info_by_topic(resolved)}
        wanted = self.settings.marker_type
        readable = [wanted] if wanted != 'auto' else list(MARKER_TYPES)
        found = [kind for kind in readable if ROS_TYPE_NAMES[kind] in published]
        if published and not found:
            self._warn(
                'type',
                f'{resolved} is published as {", ".join(sorted(published))}; it must be '
                f'one of {", ".join(ROS_TYPE_NAMES[kind] for kind in readable)}',
            )
        else:
            self._trouble.pop('type', None)
        kinds = found if wanted == 'auto' else readable
        if not kinds or self._kind in kinds:
            return
        self._unsubscribe()
        # Drivers mostly send as sensors do; what is late is not worth waiting for.
        qos = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        try:
            self._subscription = self.create_subscription(
                MARKER_TYPES[kinds[0]],
                topic,
                self._on_markers,
                qos,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
        except Exception as error:  # rclpy raises many things, some without words
            raise ParameterError(
                f'parameters qos_overrides.{resolved}.subscription cannot be used '
                f'({str(error) or type(error).__name__}); correct them or leave them out'
            ) from None
        self._kind = kinds[0]

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
        self._subscription = None
        self._kind = ''

    def _on_markers(self, message: Any) -> None:
        try:
            frame = read_markers(message, self.settings.marker_identity)
        except MessageError as error:
            self._tracker.counts['unreadable'] += 1
            self._warn('message', str(error))
            return
        wanted = [row for row in self._outputs if row[1].get_subscription_count()]
        order = max((output.order for output, _ in wanted), default=None)
        if order is None:
            self._latest = None
        for estimate in self._tracker.add(frame, order):
            self._latest = estimate
            for output, publisher in wanted:
                result = output.build(estimate)
                if result is not None:
                    publisher.publish(result)

    def _warn(self, topic: str, text: str) -> None:
        """Say once what is wrong, and keep it for the diagnostics."""
        if self._trouble.get(topic) != text:
            self.get_logger().warning(text)
        self._trouble[topic] = text

    def _tell(self) -> None:
        now = self._steady.now()
        seconds = (now - self._told).nanoseconds * 1e-9
        self._told = now
        stamp = self.get_clock().now().nanoseconds
        array = self._diagnostics.make(stamp, self._tracker, self._latest, seconds, self._trouble)
        self._trouble.pop('message', None)
        self._status.publish(array)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; returns the exit status."""
    words = list(sys.argv if args is None else args)
    node = None
    started = False
    try:
        # rcl logs what it also raises, and one line says it all.
        set_logger_level('rcl', LoggingSeverity.FATAL)
        rclpy.init(args=words)
        set_logger_level('rcl', LoggingSeverity.UNSET)
        started = True
        if unknown := remove_ros_args(words)[1:]:
            return _refuse(f'unknown words {" ".join(unknown)}; those for ROS follow --ros-args')
        node = KinpoleNode()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (ParameterError, ParameterException) as error:
        return _refuse(str(error))
    except Exception as error:
        if not started:
            # Less the places in rcl's source.
            reason = re.sub(r', at \S+:\d+', '', str(error))
            return _refuse(f'ROS cannot use the words after --ros-args: {reason}')
        # Told to stop amid a call, rclpy raises whatever that call makes of it.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _refuse(reason: str) -> int:
    print(f'kinpole node: {" ".join(reason.split())}', file=sys.stderr)
    return 2


if __name__ == '__main__':
    sys.exit(main())
