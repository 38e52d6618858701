"""
The live node: markers in, results out.

A thin shell around the tracker: it takes parameters, transitions and markers, and publishes the
topics of results that have subscribers, and the diagnostics.
"""

import gc
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock as ClockMessage
from std_msgs.msg import String
from std_srvs.srv import Trigger

from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.messages import (
    RIG,
    TF,
    DiagnosticsMaker,
    MessageError,
    RigChanges,
    live_outputs,
    serialize_message,
)
from kinpole_ros.ros.executor import make_executor, reason_of, start_ros
from kinpole_ros.ros.parameters import ParameterNode, qos_overrides_without_effect
from kinpole_ros.ros.private import RCLError, wrap_service
from kinpole_ros.ros.publishers import LATCHED, NO_EVENTS, ResultPublishers
from kinpole_ros.ros.source import MarkerSource, publishers_of
from kinpole_ros.settings import ParameterError, Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.tracker import Tracker

_DISCOVERY_INTERVAL = 0.1  # s: how often subscribers and publishers are looked up
# The node ends after so many failures, for so long (s), without a success between them.
_MAX_FAILURES, _MAX_FAILING = 100, 10.0
_MAX_STAMP = 2**31 * 10**9 - 1  # ns
# Faults that are over when they were not noted again in the time of one diagnostics.
_PASSING_FAULTS = frozenset({'message', 'failure', 'clock', 'behind'})


class KinpoleNode(ParameterNode):
    """Tracks the bodies that its parameters name; managed, and active from the start."""

    def __init__(self) -> None:
        super().__init__('kinpole')
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.source = MarkerSource(self, self.settings, self._on_markers, self._note)
        if overrides := qos_overrides_without_effect(self, self.source.topic):
            self.get_logger().warning(
                f'{", ".join(overrides)} set nothing: the markers come on {self.source.topic}; '
                f'write qos_overrides.{self.source.topic}.subscription...'
            )
        self._tracker = Tracker(self.settings)
        self._diagnostics = self._make_diagnostics()
        self.results = ResultPublishers(self)
        self._is_processing = False
        # Failures of the processing without a success between.
        self._failures = 0
        # Stamps and newest estimate of the frames since the last diagnostics.
        self._stamps: list[int] = []
        self._latest: Estimate | None = None
        # Present findings by their kind, and the kinds of those noted since the last diagnostics.
        self._faults: dict[str, Finding] = {}
        self._noted: set[str] = set()
        self._refusal = ''  # why the last activation failed
        self._last_diagnostics = self._steady.now()
        self._status_publisher: Any = None
        self._rig_publisher: Any = None
        # A node that is started again goes on with later numbers of runs.
        self._rig = RigChanges(int(time.time()))
        # With a steady clock timers run though simulated time stands still. The second one runs in
        # every state, so that no wait is endless.
        self._diagnostics_timer = self.create_timer(
            self.get_parameter('diagnostics_interval').value,
            self._publish_diagnostics,
            clock=self._steady,
            autostart=False,
        )
        self.create_timer(_DISCOVERY_INTERVAL, self._discover, clock=self._steady)
        self.accept_changes()
        self.create_service(Trigger, '~/relearn', self._relearn)
        wrap_service(self, ChangeState, _change_if_possible)
        if self.get_parameter('autostart').value:
            self.trigger_configure()
            if self.trigger_activate() != TransitionCallbackReturn.SUCCESS:
                raise ParameterError(self._refusal)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        """As in rclpy, but ignore times before 0 on /clock, for which rclpy raises."""

        def take_clock(message: ClockMessage) -> None:
            if message.clock.sec >= 0:
                callback(message)
                return
            about = {'seconds': message.clock.sec}
            self._note('clock', Finding('negative_time', values=about))

        checked = take_clock if msg_type is ClockMessage else callback
        return super().create_subscription(msg_type, topic, checked, *args, **kwargs)

    def use_settings(self) -> None:
        """Restart with the changed settings; publishers that stay in use are kept."""
        self._restart()
        if self.results.are_made:
            self._make_outputs()

    def check_settings(self, settings: Settings) -> None:
        """Raise ParameterError for settings that do not go with the messages that come."""
        self.source.check(settings)

    def _make_diagnostics(self) -> DiagnosticsMaker:
        # With the namespace: the nodes of several rigs share the topic.
        name = self.get_fully_qualified_name().lstrip('/')
        compare = self.theory.comparison() if self.theory else None
        return DiagnosticsMaker(name, compare, self.source.topic)

    def _restart(self) -> None:
        """Forget all frames and counts."""
        self._tracker = Tracker(self.settings)
        self._diagnostics = self._make_diagnostics()
        self.source.restart(self.settings)
        self._latest = None
        self._stamps = []
        self._publish_rig()

    def _publish_rig(self) -> None:
        """Publish what a subscriber has to know, if it has changed."""
        if self._rig_publisher is None:
            return
        registered = self.theory.quantities(self._tracker.bodies) if self.theory else ()
        data = self._rig.message(self._tracker, registered)
        if data is not None:
            self._rig_publisher.publish(data)

    def _relearn(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Learn shapes, noise and pins again: markers were moved on their bodies."""
        self._restart()
        response.success, response.message = True, 'all is learned anew from the next frame on'
        return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the publishers."""
        if self.incomplete:
            self.get_logger().error(self.incomplete)
            return TransitionCallbackReturn.FAILURE
        self._make_outputs()
        self._status_publisher = self.create_publisher(
            DiagnosticArray, '/diagnostics', 10, event_callbacks=NO_EVENTS
        )
        self._rig_publisher = self.create_publisher(
            String, f'~/{RIG}', LATCHED, event_callbacks=NO_EVENTS
        )
        self._rig = RigChanges(int(time.time()))
        self._publish_rig()
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the markers, with an empty window."""
        if self.incomplete:
            self.get_logger().error(self.incomplete)
            return TransitionCallbackReturn.FAILURE
        result = super().on_activate(state)
        self._restart()
        self._faults.clear()
        self._last_diagnostics = self._steady.now()
        self._diagnostics_timer.reset()
        self.active = True
        try:
            self._discover()
        except ParameterError as error:
            self.on_deactivate(state)
            self._refusal = str(error)
            if not self.get_parameter('autostart').value:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        if not self.source.is_subscribed:
            self.get_logger().info(f'waits for markers on {self.source.topic}')
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unsubscribe from the markers."""
        self._diagnostics_timer.cancel()
        self.active = False
        self.source.close()
        self.results.delete_drawing()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy the publishers."""
        self.close_outputs()
        for publisher in filter(None, (self._status_publisher, self._rig_publisher)):
            self.destroy_publisher(publisher)
        self._status_publisher = self._rig_publisher = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unsubscribe and destroy the publishers, from any state."""
        self.on_deactivate(state)
        return self.on_cleanup(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that failed, return to the state before the first."""
        return self.on_shutdown(state)

    def _make_outputs(self) -> None:
        outputs = [
            output
            for output in live_outputs(self.settings, self.theory)
            if output.topic != TF or self.settings.publish_tf
        ]
        self.results.make(outputs, self.active)

    def close_outputs(self) -> None:
        """Delete the drawing, and destroy the publishers of all results."""
        self.results.drop()

    def _discover(self) -> None:
        """Look up subscribers of the results and publishers of the markers."""
        if not self.active:
            return
        self.results.look_up_subscribers()
        if self.source.update():
            self._tracker.reset()
            self._tracker.count('restarts')

    def _on_markers(self, message: bytes, info: Mapping[str, Any]) -> None:
        """Process this message and those that wait, and publish all results in order."""
        self._is_processing = True
        now = time.monotonic()
        displays = self.results.due_displays(now)
        order = self.results.highest_order(displays)
        needs_events = self.results.need_events
        results, lost = self.source.take(message, info)
        self._tracker.count('dropped', lost)
        last: Estimate | None = None
        for frames in results:
            if isinstance(frames, MessageError):
                self._tracker.count('unreadable')
                about = {'problem': str(frames)}
                self._note('message', Finding('unreadable_message', '', about, ERROR))
                continue
            self._stamps.extend(frames.stamps.tolist())
            for estimate in self._tracker.add(frames, order, needs_events):
                self._latest = last = estimate
                if not self._rig.is_of(estimate.run):
                    self._publish_rig()
                self.results.publish(estimate)
        if displays and last is not None:
            self.results.publish_displays(displays, last, now)
        self._tracker.learn_if_due()
        self._is_processing = False
        self._failures = 0

    def _note(self, kind: str, finding: Finding | None) -> None:
        """Keep a finding for the diagnostics, and log it when it begins; None ends its kind."""
        if finding is None:
            self._faults.pop(kind, None)
            return
        if kind not in self._faults:
            self.get_logger().warning(finding.words())
        self._faults[kind] = finding
        self._noted.add(kind)

    def _publish_diagnostics(self) -> None:
        now = self._steady.now()
        seconds = (now - self._last_diagnostics).nanoseconds * 1e-9
        self._last_diagnostics = now
        # A simulated clock may have any time.
        stamp = min(max(0, self.get_clock().now().nanoseconds), _MAX_STAMP)
        self.source.note_several_publishers()
        self.source.note_pose_fault()
        self._note_duplicate_publishers()
        for kind in _PASSING_FAULTS - self._noted:
            self._note(kind, None)
        self._noted.clear()
        array = self._diagnostics.make(
            stamp, self._tracker, self._latest, seconds, self._faults.values(), self._stamps
        )
        self._stamps, self._latest = [], None
        self._status_publisher.publish(serialize_message(array))
        self._publish_rig()

    def _note_duplicate_publishers(self) -> None:
        """Note other nodes that publish the same results."""
        topic = self.results.first_topic
        finding = None
        # The count is cheaper than the names.
        if self.count_publishers(topic) > 1:
            names = publishers_of(self, topic)
            own = self.get_fully_qualified_name()
            if own in names:
                names.remove(own)
            if names:
                listed = ', '.join('another node of this name' if n == own else n for n in names)
                finding = Finding('duplicate_results', values={'topic': topic, 'names': listed})
        self._note('duplicates', finding)

    def recover(self, error: Exception) -> None:
        """Note an error that no callback caught; the tracker forgets as little as helps."""
        outcome = 'goes on'
        if self._is_processing:
            self._is_processing = False
            outcome = self._tracker.recover(self._failures)
            self._failures += 1
        self._tracker.count('failures')
        *_, place = traceback.extract_tb(error.__traceback__)
        cause = f'{type(error).__name__}: {" ".join(str(error).split())}'
        where = f'{Path(place.filename).name}:{place.lineno}'
        about = {'cause': cause, 'place': where, 'outcome': outcome}
        self._note('failure', Finding('node_failed', '', about, ERROR))


def _change_if_possible(change: Callable[..., Any], request: Any, response: Any) -> Any:
    """Answer a request for a transition; rclpy raises for one that is not possible now."""
    try:
        return change(request, response)
    except RCLError:
        response.success = False
        return response


def _spin(node: KinpoleNode, executor: Executor, stop_requested: Callable[[], bool]) -> None:
    """As rclpy.spin, but go on after failures, since other nodes rely on this one."""
    failures, last_success = 0, time.monotonic()
    while not stop_requested():
        try:
            executor.spin_once()
            failures, last_success = 0, time.monotonic()
        except ParameterError:
            raise
        except Exception as error:
            failures += 1
            if failures > _MAX_FAILURES and time.monotonic() - last_success > _MAX_FAILING:
                raise
            node.recover(error)


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node until SIGINT or SIGTERM, and return the exit status.

    Without `args` the command line is that of the process.
    """
    words = list(sys.argv if args is None else args)
    node = executor = stop_requested = None
    try:
        # rcl logs the errors that it raises too; one line is enough.
        set_logger_level('rcl', LoggingSeverity.FATAL)
        stop_requested = start_ros(words)
        set_logger_level('rcl', LoggingSeverity.UNSET)
        warnings.filterwarnings('ignore', 'Failed to fini', RuntimeWarning)
        if unknown := remove_ros_args(words)[1:]:
            return _refuse(f'unknown words {" ".join(unknown)}; those for ROS follow --ros-args')
        # Modules are not garbage, and a search among them takes up to 40 ms. The node is made
        # later, so that it is collected before the interpreter ends.
        gc.freeze()
        node = KinpoleNode()
        if '--params-file' in words and not node.has_given_parameters:
            name = node.get_fully_qualified_name()
            node.get_logger().warning(
                f'no parameter file has anything for {name}, and all is as by default: call its '
                f'section {name}, or /**'
            )
        executor = make_executor(node.source, node, node.get_parameter('executor').value)
        _spin(node, executor, stop_requested)
    except KeyboardInterrupt:
        pass
    except Exception as error:
        if isinstance(error, (ParameterError, ParameterException)):
            return _refuse(str(error))
        reason = reason_of(error)
        if stop_requested is None:
            return _refuse(f'ROS cannot start with these words and this environment: {reason}')
        if node is None and isinstance(error, RCLError):
            return _refuse(f'ROS cannot make the node: {reason}')
        raise
    finally:
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.close_outputs()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _refuse(reason: str) -> int:
    print(f'kinpole node: {" ".join(reason.split())}', file=sys.stderr)
    return 2


if __name__ == '__main__':
    sys.exit(main())
