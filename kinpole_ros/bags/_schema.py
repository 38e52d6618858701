"""Bags carry the text of their message types; here it is made from the installed classes.

The .msg files do not come with every installation of rclpy, the classes do.
"""

import re
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from kinpole_ros.bags._reader import BagError

# rosidl names basic types as IDL does; .msg files use their own names for these.
_BASIC = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}


def type_name(message_class: type) -> str:
    """Full name of a message class, such as 'geometry_msgs/msg/PointStamped'."""
    package, kind = message_class.__module__.split('.')[:2]
    return f'{package}/{kind}/{message_class.__name__}'


def message_class(name: str) -> type:
    """The class of a message type, from 'package/msg/Name' or 'package/Name'.

    Raises BagError when the type is not installed.
    """
    try:
        package, *_, short = name.split('/')
        if not _has_messages(package):
            raise ImportError(package)
        found = getattr(import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError, ValueError) as error:
        raise BagError(
            f"message type '{name}' is not installed; fix: source the workspace that has it"
        ) from error
    return found


@cache
def _has_messages(package: str) -> bool:
    """Whether it is a package of messages: names in bags must not have anything else imported."""
    found = find_spec(package) if package.isidentifier() else None
    places = found.submodule_search_locations if found is not None else None
    return any((Path(place) / 'msg').is_dir() for place in places or ())


@cache
def definition(message_class: type) -> str:
    """Text of a message type and all it is made of, in rosbag2's form ('ros2msg').

    The type itself comes first, then each type it contains, once, in order of first appearance,
    below a line of 80 '=' and a line 'MSG: package/Name'. Classes keep no types of constants and
    no comments: whole numbers are int32 where they fit, and defaults of fields are left out;
    neither matters to who decodes.
    """
    texts = {'': _own_text(message_class)}
    _add_dependencies(message_class, texts)
    separator = '=' * 80
    return texts.pop('') + ''.join(
        f'{separator}\nMSG: {name}\n{text}' for name, text in texts.items()
    )


def _add_dependencies(cls: Any, texts: dict[str, str]) -> None:
    for idl_type in cls.get_fields_and_field_types().values():
        name = re.sub(r'\[.*|<.*', '', _msg_type(idl_type))
        if '/' in name and name not in texts:
            dependency = message_class(name)
            texts[name] = _own_text(dependency)
            _add_dependencies(dependency, texts)


def _own_text(cls: Any) -> str:
    # Where a class lists its constants for its metaclass; the same dict has defaults of fields.
    listed = type(cls).__prepare__(cls.__name__, ())
    lines = [_constant(k, v) for k, v in listed.items() if not k.endswith('__DEFAULT')]
    fields = cls.get_fields_and_field_types().items()
    return '\n'.join([*lines, *(f'{_msg_type(idl_type)} {name}' for name, idl_type in fields), ''])


def _msg_type(idl: str) -> str:
    """'sequence<double, 3>' becomes 'float64[<=3]', and so on."""
    if found := re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', idl):
        return _msg_type(found[1]) + (f'[<={found[2]}]' if found[2] else '[]')
    if found := re.fullmatch(r'(.+)(\[\d+\])', idl):
        return _msg_type(found[1]) + found[2]
    if found := re.fullmatch(r'(w?string)<(\d+)>', idl):
        return f'{found[1]}<={found[2]}'
    return _BASIC.get(idl, idl)


def _constant(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return f'bool {name}={str(value).lower()}'
    if isinstance(value, bytes):
        return f'byte {name}={value[0]}'
    if isinstance(value, float):
        return f'float64 {name}={value!r}'
    if isinstance(value, str):
        return f'string {name}="{value}"'
    if -(2**31) <= value < 2**31:
        return f'int32 {name}={value}'
    return f'{"int64" if value < 2**63 else "uint64"} {name}={value}'
