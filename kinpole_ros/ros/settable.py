"""
A node whose settings are the table of parameters: declared, checked, and set while it runs.

Which bodies there are, and of which markers, may be set while the node is not active. They are set
one after the other, so for a while they may contradict each other: then the node cannot be
activated.
"""

from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter as RosParameter

from kinpole_ros.messages import WITH_TF, theory_of
from kinpole_ros.ros.declare import declare, declare_own, given_to, values_of
from kinpole_ros.ros.private import wrap_service
from kinpole_ros.tracking.parameters import (
    NODE_PARAMETERS,
    PARAMETERS,
    ParameterError,
    Settings,
    check_value,
    is_of_bodies,
    known_rows,
    settings_from,
)

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

# Parameters that others depend on being there.
_FIRST = ('bodies', 'joints')


class SettableNode(LifecycleNode, ABC):
    """
    A managed node with the parameters of the table as `settings`, and the `theory` they name.

    `incomplete` says why parameters contradict each other, '' if none does; while they do, the
    settings are those of before. A node of this kind keeps `active`, and says what is to be done
    with new settings.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.active = False
        self.given_nothing = not {*PARAMETERS, *NODE_PARAMETERS} & given_to(self).keys()
        self.settings = declare(self)
        self.theory = _theory_of(self.settings)
        self.incomplete = ''
        # While a request sets several parameters, and whether it changed one of ours.
        self._setting = self._changed = False
        # While what bodies have of their own is declared.
        self._declaring = False

    @abstractmethod
    def use_settings(self) -> None:
        """The settings have changed."""

    @abstractmethod
    def check_settings(self, settings: Settings) -> None:
        """Raise ParameterError for settings that do not go with what the node does just now."""

    def let_parameters_be_set(self) -> None:
        """Check and take what is set from now on."""
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        for kind in (SetParameters, SetParametersAtomically):
            wrap_service(self, kind, self._set_at_once)

    def declare_parameters(
        self, namespace: str, parameters: Sequence[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[RosParameter]:
        """As in rclpy, but name those that were given without a value, where it raises without."""
        try:
            return list(super().declare_parameters(namespace, parameters, ignore_override))
        except ValueError:
            names = [row[0] for row in parameters if len(row) > 1 and row[1] is None]
            if not names:
                raise
            raise ParameterError(
                f'parameter {", ".join(names)} has no value; leave it out or give it one'
            ) from None

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """
        As in rclpy, but take what stays as it is, read-only or not, as dumps of parameters have it.

        Tell the names that are known, where rclpy raises without any; and of bodies that come with
        their markers see to it that these can be set.
        """
        changes = [p for p in parameter_list if not self._is_so(p)]
        if not changes:
            return SetParametersResult(successful=True)
        if not all(self.has_parameter(p.name) for p in changes):
            result = self._check_parameters(changes)
            if not result.successful:
                return result
            first = [p for p in changes if p.name in _FIRST]
            changes = [p for p in changes if p.name not in _FIRST]
            if first:
                super().set_parameters_atomically(first)
        return super().set_parameters_atomically(changes)

    def _is_so(self, change: RosParameter) -> bool:
        """Whether a parameter has this value already."""
        if not self.has_parameter(change.name):
            return False
        now, new = (
            list(value) if isinstance(value, list | tuple | array) else value
            for value in (self.get_parameter(change.name).value, change.value)
        )
        return bool(now == new and isinstance(now, bool) == isinstance(new, bool))

    def _set_at_once(self, set_all: Callable[..., Any], request: Any, response: Any) -> Any:
        """Answer a request to set parameters: start anew once, and not by what has no end."""
        named = {p.name: p.value.string_array_value for p in request.parameters}
        new = sum(2 * len(named.get(name, ())) for name in _FIRST)
        count, most = len(request.parameters), len(given_to(self)) + new
        if count > most:
            reason = f'{count} parameters in one request, and this node has {most}: set each once'
            refused = SetParametersResult(successful=False, reason=reason)
            if isinstance(response, SetParameters.Response):
                response.results = [refused] * count
            else:
                response.result = refused
            return response
        # Bodies before their markers, in whatever order a file has them.
        order = sorted(range(count), key=lambda k: request.parameters[k].name not in _FIRST)
        request.parameters = [request.parameters[k] for k in order]
        self._setting, self._changed = True, False
        try:
            response = set_all(request, response)
        finally:
            self._setting = False
            if self._changed:
                self._use_parameters()
        if isinstance(response, SetParameters.Response):
            found = dict(zip(order, response.results, strict=True))
            response.results = [found[k] for k in range(count)]
        return response

    def _check_parameters(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        if self._declaring:
            return SetParametersResult(successful=True)
        new = {p.name: p.value for p in changes}
        try:
            self._check_alone(new)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        try:
            settings = settings_from(values_of(self, new))
            _theory_of(settings)
            self.check_settings(settings)
        except ParameterError as error:
            # Of bodies and their markers one comes after the other.
            later = not self.active and (self.incomplete != '' or any(map(is_of_bodies, new)))
            return SetParametersResult(successful=later, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_alone(self, new: dict[str, Any]) -> None:
        """Raise ParameterError for parameters that cannot be set so, whatever the others are."""
        for name in new:
            # rclpy declares them itself, to be set, and reads them when it subscribes.
            if name.startswith('qos_overrides.') and self.has_parameter(name):
                raise ParameterError(f'parameter {name} is read at the start only; set it there')
        of_bodies = [name for name in new if is_of_bodies(name)]
        values = values_of(self, new)
        known = known_rows(values)
        for name in new.keys() & known.keys():
            check_value(name, known[name], new)
        if of_bodies and self.active:
            raise ParameterError(
                f'parameter {", ".join(of_bodies)} cannot be set while the node is active, as its '
                'topics go by it; fix: ros2 lifecycle set '
                f'{self.get_fully_qualified_name()} deactivate, set it, and activate again'
            )

    def _take_parameters(self, changes: Sequence[RosParameter]) -> None:
        names = {p.name for p in changes}
        if self._declaring or not any(n in PARAMETERS or is_of_bodies(n) for n in names):
            return
        if names & {*_FIRST}:
            self._declaring = True
            try:
                declare_own(self)
            finally:
                self._declaring = False
        if self._setting:
            self._changed = True
        else:
            self._use_parameters()

    def _use_parameters(self) -> None:
        """Take the parameters for settings, unless they contradict each other."""
        try:
            settings = settings_from(values_of(self))
            self.theory = _theory_of(settings)
        except ParameterError as error:
            self.incomplete = str(error)
            self.get_logger().warning(f'{error}; until then the node cannot be activated')
            return
        self.settings, self.incomplete = settings, ''
        self.use_settings()


def _theory_of(settings: Settings) -> 'Theory | None':
    """As `theory_of`, for settings that the node can do; raises ParameterError for others."""
    for name, value, wants in (
        ('publish_tf', 'true', settings.publish_tf),
        ('marker_type', 'tf', settings.marker_type == 'tf'),
    ):
        if wants and not WITH_TF:
            raise ParameterError(
                f'parameter {name} is {value}, and tf2_msgs is not installed; install '
                'ros-jazzy-tf2-msgs, or set it otherwise'
            )
    return theory_of(settings)
