"""The text of message types, as bags have it.

The .msg files do not come with every installation of rclpy, so it is made from the classes.
"""

import re
from functools import cache
from typing import Any

from kinpole_ros import messages
from kinpole_ros.bags._files import BagError
from kinpole_ros.messages import constants, fields


def message_class(name: str) -> type:
    """
    Return the class of a message type.

    Parameters
    ----------
    name : str
        'package/msg/Name' or 'package/Name'.

    Returns
    -------
    type

    Raises
    ------
    BagError
        If the type is not installed.

    """
    try:
        cls: type = messages.message_class(name)
    except (LookupError, ValueError) as error:
        raise BagError(
            f"message type '{name}' is not installed; fix: source the workspace that has it"
        ) from error
    return cls


@cache
def definition(message_class: type) -> str:
    """
    Return the text of a message type and of all types in it, in rosbag2's form ('ros2msg').

    Classes keep no types of constants and no comments: whole numbers are int32 where they fit, and
    defaults of fields are left out. Neither matters for decoding.

    Parameters
    ----------
    message_class : type
        The class of the type.

    Returns
    -------
    str
        The type itself, then the types that it contains, once, in order of first appearance, below
        a line of 80 '=' and a line 'MSG: package/Name'.

    """
    texts = {'': _own_text(message_class)}
    _add_dependencies(message_class, texts)
    separator = '=' * 80
    return texts.pop('') + ''.join(
        f'{separator}\nMSG: {name}\n{text}' for name, text in texts.items()
    )


def _add_dependencies(cls: Any, texts: dict[str, str]) -> None:
    for kind in fields(cls).values():
        name = re.sub(r'\[.*|<.*', '', kind)
        if '/' in name and name not in texts:
            dependency = message_class(name)
            texts[name] = _own_text(dependency)
            _add_dependencies(dependency, texts)


def _own_text(cls: Any) -> str:
    lines = [_constant(name, value) for name, value in constants(cls).items()]
    return '\n'.join([*lines, *(f'{kind} {name}' for name, kind in fields(cls).items()), ''])


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
