"""Kinds of values that a parameter may have: each a check, and the words for what it allows."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

# A normal, or the name of a plane of the axes; 'fit' for one that is found from the motion.
PlaneSetting: TypeAlias = str | tuple[float, float, float]
# Columns of a marker that span the plane, and the one along its normal.
AXES = {'xy': (0, 1, 2), 'yz': (1, 2, 0), 'zx': (2, 0, 1)}
FIT = 'fit'


class ParameterError(ValueError):
    """A parameter that is unknown, or whose value cannot be used; the message has the fix."""


@dataclass(frozen=True)
class Kind:
    """
    A kind of values: what is allowed in words, whether a value is, and how Settings have it.

    `is_right` may also raise TypeError, ValueError or OverflowError. Numbers have a range and unit.
    """

    allowed: str
    is_right: Callable[[Any], bool]
    convert: Callable[[Any], Any] = lambda value: value
    span: tuple[float, float] | None = None
    unit: str = ''


def canonical_name(name: str) -> str:
    """The name of a plane of the axes whichever of its two axes is named first."""
    return name if name in AXES else next((k for k in AXES if k[::-1] == name), name)


def text(pattern: str, allowed: str) -> Kind:
    """Texts of which all matches the pattern."""
    return Kind(
        allowed, lambda value: isinstance(value, str) and bool(re.fullmatch(pattern, value))
    )


def one_of(*names: str) -> Kind:
    """One of these texts."""
    return Kind('one of ' + ', '.join(names), lambda value: value in names)


def number(lowest: float, highest: float, unit: str) -> Kind:
    """Numbers in a range, both ends included."""

    def is_right(value: Any) -> bool:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return is_number and math.isfinite(value) and lowest <= value <= highest

    allowed = f'a number from {lowest:g} to {highest:g} {unit}'
    return Kind(allowed, is_right, float, (lowest, highest), unit)


def names(allowed: str, pattern: str = '(?s).+', fewest: int = 0, most: float = math.inf) -> Kind:
    """Lists of different texts of which each matches the pattern."""
    name = text(pattern, '')

    def is_right(value: Any) -> bool:
        is_list = not isinstance(value, str) and fewest <= len(value) <= most
        return is_list and all(map(name.is_right, value)) and len(set(value)) == len(value)

    return Kind(allowed, is_right, tuple)


def identifiers(fewest: int = 0) -> Kind:
    """Lists of different names as of variables."""
    allowed = 'a list of different names of letters, digits and _, with no digit first'
    return names(allowed, r'(?a:[A-Za-z_]\w*)', fewest)


def _is_plane(value: Any) -> bool:
    if isinstance(value, str):
        return canonical_name(value) in (*AXES, FIT)
    return len(value) == 3 and _are_numbers(value, 1e300) and any(value)


def _are_numbers(values: Any, largest: float) -> bool:
    return not isinstance(values, str) and all(map(number(-largest, largest, '').is_right, values))


def _points(value: Any) -> tuple[complex, ...]:
    return tuple(map(complex, value[::2], value[1::2]))


def _is_shape(value: Any) -> bool:
    """Whether these are x and y of no marker, or of two or more at different places."""
    count = len(value) / 2
    return _are_numbers(value, 1e6) and count != 1 and len(set(_points(value))) == count


FLAG = Kind('true or false', lambda value: isinstance(value, bool))
PLANE = Kind(
    'one of xy, yz, zx, fit, or a normal [x, y, z] of three numbers, not all 0',
    _is_plane,
    lambda value: canonical_name(value) if isinstance(value, str) else tuple(map(float, value)),
)
# As ROS 2 has it: names of letters, digits and _ between slashes, with no digit first.
TOPIC = text(
    r'(?a:(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*)',
    'the name of a topic, such as markers or /rig/markers',
)
ORDER = Kind(
    'auto, 1, 2, 3 or 4',
    lambda value: type(value) in (int, str) and str(value) in ('auto', '1', '2', '3', '4'),
    lambda value: None if value == 'auto' else int(value),
)
MARKERS = names("a list of different marker identities, as text, such as ['0', '1', '2']")
PAIR = names(
    "two different names of bodies, or 'ground' and one, such as ['crank', 'coupler']",
    fewest=2,
    most=2,
)
SHAPE = Kind(
    'a flat list of x, y of two or more markers at different places, m, such as '
    '[0.0, 0.0, 0.1, 0.0, 0.05, 0.08]',
    _is_shape,
    _points,
)
PIN = Kind(
    'a flat list of four numbers, m, such as [0.0, 0.0, 0.3, 0.1]',
    lambda value: _are_numbers(value, 1e6) and len(value) in (0, 4),
    _points,
)
