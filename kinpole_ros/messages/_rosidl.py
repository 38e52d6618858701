"""Message classes of an installed ROS by name, and their fields."""

import re
from array import array
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# Basic types that rosidl names as IDL does, by their names in .msg files.
_BASIC = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}


def message_class(name: str) -> Any:
    """
    Return a message class by name.

    Parameters
    ----------
    name : str
        'package/msg/Name' or 'package/Name'.

    Returns
    -------
    type
        The class.

    Raises
    ------
    LookupError
        For a type that is not installed.
    """
    try:
        package, *_, short = name.split('/')
        if not _has_messages(package):
            raise LookupError(name)
        return getattr(import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError, ValueError) as error:
        raise LookupError(name) from error


@cache
def _has_messages(package: str) -> bool:
    """Whether it is a package of messages: a name in a bag must not import any other package."""
    spec = find_spec(package) if package.isidentifier() else None
    folders = spec.submodule_search_locations if spec is not None else None
    return any((Path(folder) / 'msg').is_dir() for folder in folders or ())


def type_name(cls: Any) -> str:
    """
    Return the name of a message class.

    Parameters
    ----------
    cls : type
        The class.

    Returns
    -------
    str
        The full name, such as 'geometry_msgs/msg/PointStamped'.
    """
    package, kind = cls.__module__.split('.')[:2]
    return f'{package}/{kind}/{cls.__name__}'


def fields(cls: Any) -> dict[str, str]:
    """
    Return the fields of a message class.

    Parameters
    ----------
    cls : type
        The class.

    Returns
    -------
    dict
        Types by name, as a .msg file has them.
    """
    return {name: _msg_type(idl) for name, idl in cls.get_fields_and_field_types().items()}


def constants(cls: Any) -> dict[str, Any]:
    """
    Return the constants of a message class.

    Parameters
    ----------
    cls : type
        The class.

    Returns
    -------
    dict
        Values by name.
    """
    # The namespace that a class prepares for its metaclass has constants and defaults of fields.
    namespace = type(cls).__prepare__(cls.__name__, ())
    return {k: v for k, v in namespace.items() if not k.endswith('__DEFAULT')}


def octets(data: bytes) -> Any:
    """
    Return the value of a field of type uint8[].

    Parameters
    ----------
    data : bytes
        Its bytes.

    Returns
    -------
    object
        What such a field takes.
    """
    return array('B', data)


def _msg_type(idl: str) -> str:
    """'sequence<double, 3>' becomes 'float64[<=3]', and so on."""
    if match := re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', idl):
        return _msg_type(match[1]) + (f'[<={match[2]}]' if match[2] else '[]')
    if match := re.fullmatch(r'(.+)(\[\d+\])', idl):
        return _msg_type(match[1]) + match[2]
    if match := re.fullmatch(r'(w?string)<(\d+)>', idl):
        return f'{match[1]}<={match[2]}'
    return _BASIC.get(idl, idl)


class _TFMessage:
    """The type tf2_msgs/msg/TFMessage where that package is not installed: enough for a bag."""

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        """Types of the fields by name, as rosidl has them."""
        return {'transforms': 'sequence<geometry_msgs/TransformStamped>'}


_TFMessage.__module__, _TFMessage.__name__ = 'tf2_msgs.msg', 'TFMessage'
try:
    from tf2_msgs.msg import TFMessage

    WITH_TF = True
except ImportError:
    TFMessage = _TFMessage
    WITH_TF = False
