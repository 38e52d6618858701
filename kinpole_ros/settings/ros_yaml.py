"""
Values in YAML as ROS reads them, from which the node gets its parameters.

So that replay, which reads the same file, takes and refuses the same. What ROS makes of a value is
in rcl_yaml_param_parser; a test holds this against the one that is installed.
"""

import math
import re
import sys
from contextlib import suppress
from typing import Any

import yaml

from kinpole_ros.files.bounded_yaml import Loader

_PLAIN, _TEXT = '!plain', 'tag:yaml.org,2002:str'
_YES, _NO = (
    {form for word in words.split() for form in (word, word.title(), word.upper())}
    for words in ('y yes true on', 'n no false off')
)
_WHOLE = re.compile(r'[-+]?(0x[0-9a-f]+|[0-9]+)', re.IGNORECASE)
_DECIMAL = re.compile(r'[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[-+]?[0-9]+)?', re.IGNORECASE)
_HEXADECIMAL = re.compile(
    r'[-+]?0x([0-9a-f]+(\.[0-9a-f]*)?|\.[0-9a-f]+)(p[-+]?[0-9]+)?', re.IGNORECASE
)
_NO_NUMBER = re.compile(r'\.(nan|NaN|NAN)|[-+]?\.(inf|Inf|INF)|[-+]?(?i:nan|inf|infinity)')
_NOT_ZERO = re.compile(r'[-+]?(0x)?[0.]*[1-9a-f]', re.IGNORECASE)
_LEAST = sys.float_info.min


class RosLoader(Loader):
    """
    YAML as ROS reads it, of which the node gets its parameters.

    1e-3 is a number although it has no point, 010 is 8 as in C, and 1_000, 1:30 and null are texts.
    """

    longest = 5000
    yaml_constructors = {  # noqa: RUF012
        tag: make
        for tag, make in Loader.yaml_constructors.items()
        if tag and not tag.endswith(':null')
    }
    yaml_implicit_resolvers = {None: [(_PLAIN, re.compile(''))]}  # noqa: RUF012

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Return the mapping, its keys as they are written."""
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode):
                key.tag = _TEXT
        return super().construct_mapping(node, deep)


def _any_tag(loader: RosLoader, node: Any) -> Any:
    """What has a tag that ROS does not look at."""
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    return loader.construct_scalar(node) if node.style in ('"', "'") else _scalar(node.value)


RosLoader.add_constructor(None, _any_tag)


def _scalar(text: str) -> Any:
    """What ROS makes of a value that is not in quotes, by C's strtol and strtod, as rcl does it."""
    if not text:
        return None
    if text in _YES or text in _NO:
        return text in _YES
    if _WHOLE.fullmatch(text):
        digits = text.lstrip('+-')
        with suppress(ValueError):  # 08
            number = int(text, 8 if digits.isdecimal() and digits[0] == '0' else 0)
            if -(2**63) <= number < 2**63:
                return number
    value = None
    if _DECIMAL.fullmatch(text) or _HEXADECIMAL.fullmatch(text):
        with suppress(OverflowError):
            value = float(text) if _DECIMAL.fullmatch(text) else float.fromhex(text)
            # Out of range: then it is a text.
            lost = math.isinf(value) or (abs(value) < _LEAST and _NOT_ZERO.match(text))
            value = None if lost else value
    elif _NO_NUMBER.fullmatch(text):
        value = float(text.replace('.', ''))
    return text if value is None else value
