"""Message classes of a ROS: found by name, and what they say of themselves."""

import re
from array import array
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# rosidl names basic types as IDL does; .msg files use their own names for these.
_BASIC = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}


def message_class(name: str) -> Any:
    """The class of a message type, 'package/msg/Name' or 'package/Name'; LookupError if unknown."""
    try:
        package, *_, short = name.split('/')
        if not _has_messages(package):
            raise ImportError(package)
        return getattr(import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError, ValueError) as error:
        raise LookupError(name) from error


@cache
def _has_messages(package: str) -> bool:
    """Whether it is a package of messages: names in bags must not have anything else imported."""
    found = find_spec(package) if package.isidentifier() else None
    places = found.submodule_search_locations if found is not None else None
    return any((Path(place) / 'msg').is_dir() for place in places or ())


def type_name(cls: Any) -> str:
    """Full name of a message class, such as 'geometry_msgs/msg/PointStamped'."""
    package, kind = cls.__module__.split('.')[:2]
    return f'{package}/{kind}/{cls.__name__}'


def fields(cls: Any) -> dict[str, str]:
    """Types of the fields, as a .msg file has them."""
    return {name: _msg_type(idl) for name, idl in cls.get_fields_and_field_types().items()}


def constants(cls: Any) -> dict[str, Any]:
    """Constants of a message type."""
    # Where a class lists them for its metaclass; the same dict has defaults of fields.
    listed = type(cls).__prepare__(cls.__name__, ())
    return {k: v for k, v in listed.items() if not k.endswith('__DEFAULT')}


def octets(data: bytes) -> Any:
    """What a field uint8[] takes."""
    return array('B', data)


def _msg_type(idl: str) -> str:
    """'sequence<double, 3>' becomes 'float64[<=3]', and so on."""
    if found := re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', idl):
        return _msg_type(found[1]) + (f'[<={found[2]}]' if found[2] else '[]')
    if found := re.fullmatch(r'(.+)(\[\d+\])', idl):
        return _msg_type(found[1]) + found[2]
    if found := re.fullmatch(r'(w?string)<(\d+)>', idl):
        return f'{found[1]}<={found[2]}'
    return _BASIC.get(idl, idl)


class _TFMessage:
    """The type tf2_msgs/msg/TFMessage where that package is not installed: enough for a bag."""

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        """As the class has it."""
        return {'transforms': 'sequence<geometry_msgs/TransformStamped>'}


_TFMessage.__module__, _TFMessage.__name__ = 'tf2_msgs.msg', 'TFMessage'
try:
    from tf2_msgs.msg import TFMessage

    WITH_TF = True
except ImportError:
    TFMessage = _TFMessage
    WITH_TF = False
