"""
The live node: markers in, results out, nothing computed that nobody reads.

A thin shell around the tracker: it takes parameters, transitions and markers, and publishes the
rows of the results table that have subscribers, and the diagnostics.
"""

import gc
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from kinpole_ros.messages import (
    DRAWING,
    TF,
    DiagnosticsMaker,
    MessageError,
    Output,
    live_outputs,
    nothing_drawn,
)
from kinpole_ros.ros.declare import given_in_vain
from kinpole_ros.ros.executor import make_executor
from kinpole_ros.ros.private import RCLError, wrap_service
from kinpole_ros.ros.process import reason_of, start_ros
from kinpole_ros.ros.settable import SettableNode
from kinpole_ros.ros.source import MarkerSource, publishers_of
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.parameters import ParameterError, Settings
from kinpole_ros.tracking.tracker import Tracker

_DIAGNOSTICS_EVERY = 1.0
_LOOK_EVERY = 0.1
# With so many waiting the node is behind: all are taken into the window, only the newest is
# published.
_BEHIND = 25
# Results kept for a reliable reader that is slow, such as a recorder on a busy machine: what waits
# is taken at once, so they come in bunches. Those who asked for less do not get more.
_KEPT = 1000
# So many failures, for so long (s), with nothing done between them are no weather to ride out.
_MOST_FAILURES, _LONGEST_FAILURE = 100, 10.0
# rclpy's own callbacks only log, and cost 6 us a publisher whenever it waits.
_NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
# s. It takes ms, but Fast DDS has readers say every 3 s only what they have.
_ARRIVES_WITHIN = 0.1
_LATEST_STAMP = 2**31 * 10**9 - 1


class KinpoleNode(SettableNode):
    """Tracks the bodies its parameters name; managed, and active from the start."""

    def __init__(self) -> None:
        super().__init__('kinpole')
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.source = MarkerSource(self, self.settings, self._on_markers, self._note)
        if in_vain := given_in_vain(self, self.source.topic):
            self.get_logger().warning(
                f'{", ".join(in_vain)} set nothing: the markers come on {self.source.topic}; '
                f'write qos_overrides.{self.source.topic}.subscription...'
            )
        self._tracker = Tracker(self.settings)
        self._diagnostics = self._make_diagnostics()
        self._outputs: list[tuple[Output, Any]] = []
        # Those that somebody reads, looked up now and then: it takes 0.6 us each.
        self._wanted: list[tuple[Output, Any]] = []
        # Those that people look at, and when the next is due.
        self._viewed: list[tuple[Output, Any]] = []
        self._view_due = 0.0
        self._publishers_made: dict[str, Any] = {}
        self._amid_markers = False
        # Of the frames since the last diagnostics.
        self._stamps: list[int] = []
        self._latest: Estimate | None = None
        # The last one published since the drawings were taken away.
        self._drawn: Estimate | None = None
        self._trouble: dict[str, str] = {}
        # What of it was noted since the last diagnostics.
        self._noted: set[str] = set()
        self._last_diagnostics = self._steady.now()
        self._status_publisher: Any = None
        # A steady clock: these beat even where simulated time stands still. The second one does so
        # in every state, for whoever spins.
        self._telling = self.create_timer(
            _DIAGNOSTICS_EVERY, self._tell, clock=self._steady, autostart=False
        )
        self.create_timer(_LOOK_EVERY, self._look, clock=self._steady)
        self.let_parameters_be_set()
        self.create_service(Trigger, '~/relearn', self._relearn)
        wrap_service(self, ChangeState, _change_if_possible)
        if self.get_parameter('autostart').value:
            self.trigger_configure()
            if self.trigger_activate() != TransitionCallbackReturn.SUCCESS:
                raise ParameterError(self._trouble['start'])

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *words: Any, **more: Any
    ) -> Any:
        """As in rclpy, but of a clock leave out what is before 0, where it raises."""

        def take_clock(message: ClockMessage) -> None:
            if message.clock.sec >= 0:
                callback(message)
                return
            self._note(
                'clock',
                f'/clock tells of {message.clock.sec} s, and ROS has no time before 0; that is '
                'left out: see to what publishes it',
            )

        take = take_clock if msg_type is ClockMessage else callback
        return super().create_subscription(msg_type, topic, take, *words, **more)

    def use_settings(self) -> None:
        """Start anew with the changed settings; publishers that stay in use are not touched."""
        self._start_anew()
        if self._outputs:
            self._make_outputs()

    def check_settings(self, settings: Settings) -> None:
        """Raise ParameterError for settings that do not go with the messages that come."""
        self.source.check(settings)

    def _make_diagnostics(self) -> DiagnosticsMaker:
        # With the namespace, if any: nodes of several rigs tell on one topic.
        name = self.get_fully_qualified_name().lstrip('/')
        return DiagnosticsMaker(name, self.theory, self.source.topic)

    def _start_anew(self) -> None:
        """Forget all frames, and the counts."""
        self._tracker = Tracker(self.settings)
        self._diagnostics = self._make_diagnostics()
        self.source.start_anew(self.settings)
        self._latest = None
        self._stamps = []

    def _relearn(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Markers were moved on their bodies: learn shapes, noise and pins anew."""
        self._start_anew()
        response.success, response.message = True, 'all is learned anew from the next frame on'
        return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the publishers."""
        if self.incomplete:
            self.get_logger().error(self.incomplete)
            return TransitionCallbackReturn.FAILURE
        self._make_outputs()
        self._status_publisher = self.create_publisher(
            DiagnosticArray, '/diagnostics', 10, event_callbacks=_NO_EVENTS
        )
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start listening, with an empty window."""
        if self.incomplete:
            self.get_logger().error(self.incomplete)
            return TransitionCallbackReturn.FAILURE
        result = super().on_activate(state)
        self._start_anew()
        self._trouble.clear()
        self._last_diagnostics = self._steady.now()
        self._telling.reset()
        self.active = True
        try:
            self._look()
        except ParameterError as error:
            self.on_deactivate(state)
            self._trouble['start'] = str(error)
            if not self.get_parameter('autostart').value:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        if not self.source.found:
            self.get_logger().info(f'waits for markers on {self.source.topic}')
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening."""
        self._telling.cancel()
        self.active = False
        self.source.close()
        self._take_drawings_away()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take the publishers down."""
        self.close_outputs()
        if self._status_publisher is not None:
            self.destroy_publisher(self._status_publisher)
            self._status_publisher = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From wherever the node is, stop and take everything down."""
        self.on_deactivate(state)
        return self.on_cleanup(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that failed, be as before the first."""
        return self.on_shutdown(state)

    def _make_outputs(self) -> None:
        outputs = [
            output
            for output in live_outputs(self.settings, self.theory)
            if output.topic != TF or self.settings.publish_tf
        ]
        self._drop_outputs([output.topic for output in outputs])
        for output in outputs:
            publisher = self._publishers_made.get(output.topic)
            if publisher is None:
                publisher = self.create_lifecycle_publisher(
                    output.message_type,
                    output.under('~'),
                    _KEPT,
                    event_callbacks=_NO_EVENTS,
                )
                if self.active:
                    publisher.on_activate(LifecycleState('active', 0))
                self._publishers_made[output.topic] = publisher
            self._outputs.append((output, publisher))
        self._note_readers()

    def close_outputs(self) -> None:
        """Take the drawings away, and the publishers of all results down."""
        self._drop_outputs([])

    def _drop_outputs(self, kept: Sequence[str]) -> None:
        """Destroy the publishers of all topics but those kept."""
        if DRAWING not in kept:
            self._take_drawings_away()
        going = [self._publishers_made.pop(t) for t in self._publishers_made.keys() - set(kept)]
        _let_arrive(going)
        for publisher in going:
            self.destroy_lifecycle_publisher(publisher)
        self._outputs = []
        self._note_readers()

    def _take_drawings_away(self) -> None:
        """Viewers keep what was drawn until a message deletes it."""
        drawn, self._drawn = self._drawn, None
        publisher = self._publishers_made.get(DRAWING)
        if drawn is not None and publisher is not None and publisher.get_subscription_count():
            publisher.publish(nothing_drawn(int(drawn.stamp[-1]), drawn.frame_id))

    def _note_readers(self) -> None:
        read = [row for row in self._outputs if row[1].get_subscription_count()]
        self._wanted = [row for row in read if not row[0].every]
        self._viewed = [row for row in read if row[0].every]

    def _look(self) -> None:
        """See who is there, to read and to be read."""
        if not self.active:
            return
        self._note_readers()
        if self.source.look():
            self._tracker.reset()
            self._tracker.counts['restarts'] += 1

    def _on_markers(self, message: bytes, info: Mapping[str, Any]) -> None:
        """Take all that waits at once: what is behind catches up, and loses the oldest first."""
        self._amid_markers = True
        now = time.monotonic()
        viewed = self._viewed if now >= self._view_due else []
        order = max((output.order for output, _ in (*self._wanted, *viewed)), default=None)
        events = any(output.of_events for output, _ in self._wanted)
        read, messages, dropped = self.source.take(message, info)
        self._tracker.counts['dropped'] += dropped
        last: Estimate | None = None
        # On /tf there may be none of ours among them.
        if read and messages >= _BEHIND and not self.source.lossless:
            read = self._newest_last(read)
        for frames in read:
            if isinstance(frames, MessageError):
                self._tracker.counts['unreadable'] += 1
                self._note('message', str(frames))
                continue
            self._stamps.extend(frames.stamps.tolist())
            for estimate in self._tracker.add(frames, order, events):
                self._latest = self._drawn = estimate
                _publish(self._wanted, estimate)
                last = estimate
        # Nobody else waits for what people look at.
        if viewed and last is not None:
            _publish(viewed, last)
            self._view_due = now + max(output.every for output, _ in viewed)
        self._tracker.settle()
        self._amid_markers = False

    def _newest_last(
        self, read: list[MarkerFrames | MessageError]
    ) -> list[MarkerFrames | MessageError]:
        """Take all but the newest frame into the window, without results."""
        *earlier, last = read
        for frames in (f for f in earlier if not isinstance(f, MessageError)):
            self._take_silently(frames)
        if not isinstance(last, MessageError) and len(last.stamps) > 1:
            self._take_silently(part_of(last, slice(-1)))
            last = part_of(last, slice(-1, None))
        return [*(f for f in earlier if isinstance(f, MessageError)), last]

    def _take_silently(self, frames: MarkerFrames) -> None:
        self._stamps.extend(frames.stamps.tolist())
        self._tracker.add(frames, None)
        self._tracker.counts['untold'] += len(frames.stamps)

    def _note(self, trouble: str, text: str) -> None:
        """Keep what is wrong for the diagnostics, and say it when it begins; '' is its end."""
        if not text:
            self._trouble.pop(trouble, None)
            return
        if trouble not in self._trouble:
            self.get_logger().warning(text)
        self._trouble[trouble] = text
        self._noted.add(trouble)

    def _tell(self) -> None:
        now = self._steady.now()
        seconds = (now - self._last_diagnostics).nanoseconds * 1e-9
        self._last_diagnostics = now
        # A simulated clock may tell any time.
        stamp = min(max(0, self.get_clock().now().nanoseconds), _LATEST_STAMP)
        self.source.note_turns()
        self.source.note_names()
        self._note_rivals()
        for passing in {'message', 'failure', 'clock'} - self._noted:
            self._note(passing, '')
        self._noted.clear()
        array = self._diagnostics.make(
            stamp, self._tracker, self._latest, seconds, self._trouble, self._stamps
        )
        self._stamps, self._latest = [], None
        self._status_publisher.publish(array)

    def _note_rivals(self) -> None:
        """Note where other nodes publish the same results."""
        results = next(iter(self._publishers_made.values())).topic_name
        text = ''
        # Asked for by number first, which is cheaper.
        if self.count_publishers(results) > 1:
            names = publishers_of(self, results)
            own = self.get_fully_qualified_name()
            if own in names:
                names.remove(own)
            if names:
                listed = ', '.join('another node of this name' if n == own else n for n in names)
                text = (
                    f'{results} and the like are published by {listed} too: give each node a '
                    'name of its own (-r __node:=NAME), and play of a bag the markers alone; what '
                    'was killed counts for some seconds more'
                )
        self._note('rivals', text)

    def recover(self, error: Exception) -> None:
        """After what no callback caught: tell of it, and if it was amid markers start anew."""
        what = 'goes on'
        if self._amid_markers:
            self._amid_markers = False
            self._tracker.reset()
            self._latest = None
            what = 'starts anew'
        self._tracker.counts['failures'] += 1
        text = ' '.join(str(error).split())
        self._note('failure', f'the node failed ({type(error).__name__}: {text}) and {what}')


def _publish(outputs: Sequence[tuple[Output, Any]], estimate: Estimate) -> None:
    """All are made before the first goes out: its readers wake, and take the core."""
    made = [
        (publisher, data) for output, publisher in outputs for data in output.build(estimate)[1]
    ]
    for publisher, data in made:
        publisher.publish(data)


def _let_arrive(publishers: Sequence[Any]) -> None:
    """Before publishers go: readers that hear of that drop what of theirs is still on its way."""
    deadline = time.monotonic() + _ARRIVES_WITHIN
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


def _change_if_possible(change: Callable[..., Any], request: Any, response: Any) -> Any:
    """Answer a request for a transition; rclpy raises for one that is not possible now."""
    try:
        return change(request, response)
    except RCLError:
        response.success = False
        return response


def _spin(node: KinpoleNode, executor: Executor, stop_requested: Callable[[], bool]) -> None:
    """As rclpy.spin, but a node that others rely upon does not end with its first failure."""
    failures, well = 0, time.monotonic()
    while not stop_requested():
        try:
            executor.spin_once()
            failures, well = 0, time.monotonic()
        except ParameterError:
            raise
        except Exception as error:
            failures += 1
            if failures > _MOST_FAILURES and time.monotonic() - well > _LONGEST_FAILURE:
                raise
            node.recover(error)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a stop is requested; returns the exit status."""
    words = list(sys.argv if args is None else args)
    node = executor = stop_requested = None
    try:
        # rcl logs what it also raises, and one line says it all.
        set_logger_level('rcl', LoggingSeverity.FATAL)
        stop_requested = start_ros(words)
        set_logger_level('rcl', LoggingSeverity.UNSET)
        # It warns of what it also raises.
        warnings.filterwarnings('ignore', 'Failed to fini', RuntimeWarning)
        if unknown := remove_ros_args(words)[1:]:
            return _refuse(f'unknown words {" ".join(unknown)}; those for ROS follow --ros-args')
        # What was imported stays: to look through it for garbage takes up to 40 ms. The node does
        # not, so that it goes with the interpreter and not after it.
        gc.freeze()
        node = KinpoleNode()
        if '--params-file' in words and node.given_nothing:
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
