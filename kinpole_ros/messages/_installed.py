"""
Classes of an installed ROS by the names of message types.

Publishers and subscriptions of rclpy need them; all else reads and writes by the classes of
_types.py. Types that rosbags does not have are known by their fields.
"""

import re
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# Basic types that rclpy names as IDL does, by their names in .msg files.
_BASIC = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}


def installed_class(name: str) -> Any:
    """
    Return the class that rclpy publishes and subscribes to a type with, by its name.

    Raises LookupError for a type that is not installed.
    """
    try:
        package, *_, short = name.split('/')
        if not _has_messages(package):
            raise LookupError(name)
        return getattr(import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError, LookupError, ValueError) as error:
        raise LookupError(
            f"message type '{name}' is not installed; fix: source the workspace that has it"
        ) from error


def installed_fields(name: str) -> dict[str, str]:
    """
    Return the fields of an installed type by name, as a .msg file has them.

    Classes keep no constants and no defaults, which do not matter for decoding. Raises LookupError
    for a type that is not installed.
    """
    idl = installed_class(name).get_fields_and_field_types()
    return {field: _msg_type(kind) for field, kind in idl.items()}


@cache
def _has_messages(package: str) -> bool:
    """Whether it is a package of messages: a name in a bag must not import any other package."""
    spec = find_spec(package) if package.isidentifier() else None
    folders = spec.submodule_search_locations if spec is not None else None
    return any((Path(folder) / 'msg').is_dir() for folder in folders or ())


def _msg_type(idl: str) -> str:
    """'sequence<double, 3>' becomes 'float64[<=3]', and so on."""
    if match := re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', idl):
        return _msg_type(match[1]) + (f'[<={match[2]}]' if match[2] else '[]')
    if match := re.fullmatch(r'(.+)(\[\d+\])', idl):
        return _msg_type(match[1]) + match[2]
    if match := re.fullmatch(r'(w?string)<(\d+)>', idl):
        return f'{match[1]}<={match[2]}'
    return _BASIC.get(idl, idl)
