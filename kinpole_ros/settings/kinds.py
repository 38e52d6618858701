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
    A kind of values: what is allowed, in words, and between which numbers and in which unit.

    `check` returns the value as Settings have it, and raises ValueError or TypeError for another.
    """

    check: Callable[[Any], Any]
    allowed: str
    span: tuple[float, float] | None = None
    unit: str = ''


def canonical_name(name: str) -> str:
    """The name of a plane of the axes whichever of its two axes is named first."""
    return name if name in AXES else next((k for k in AXES if k[::-1] == name), name)


def _require(is_right: bool) -> None:
    if not is_right:
        raise ValueError


def text(pattern: str, allowed: str) -> Kind:
    """Texts of which all matches the pattern."""

    def check(value: Any) -> str:
        _require(isinstance(value, str) and re.fullmatch(pattern, value) is not None)
        return str(value)

    return Kind(check, allowed)


def one_of(*names: str) -> Kind:
    """One of these texts."""

    def check(value: Any) -> str:
        _require(value in names)
        return str(value)

    return Kind(check, 'one of ' + ', '.join(names))


def number(lowest: float, highest: float, unit: str) -> Kind:
    """Numbers in a range, both ends included."""

    def check(value: Any) -> float:
        _require(isinstance(value, int | float) and not isinstance(value, bool))
        _require(math.isfinite(value) and lowest <= value <= highest)
        return float(value)

    return Kind(check, f'a number from {lowest:g} to {highest:g} {unit}', (lowest, highest), unit)


def names(allowed: str, pattern: str = '(?s).+', fewest: int = 0, most: float = math.inf) -> Kind:
    """Lists of different texts of which each matches the pattern."""

    def check(value: Any) -> tuple[str, ...]:
        _require(not isinstance(value, str) and fewest <= len(value) <= most)
        _require(all(isinstance(name, str) and re.fullmatch(pattern, name) for name in value))
        _require(len(set(value)) == len(value))
        return tuple(value)

    return Kind(check, allowed)


def identifiers(fewest: int = 0) -> Kind:
    """Lists of different names as of variables."""
    allowed = 'a list of different names of letters, digits and _'
    return names(allowed, r'(?a:[A-Za-z_]\w*)', fewest)


def _flag(value: Any) -> bool:
    _require(isinstance(value, bool))
    return bool(value)


def _plane(value: Any) -> PlaneSetting:
    if isinstance(value, str):
        return str(one_of(*AXES, FIT).check(canonical_name(value)))
    x, y, z = map(number(-1e300, 1e300, '').check, value)
    _require(bool(x or y or z))
    return x, y, z


def _order(value: Any) -> int | None:
    if value == 'auto':
        return None
    order = int(value) if isinstance(value, str) and value.isdigit() else value
    _require(isinstance(order, int) and not isinstance(order, bool) and 1 <= order <= 4)
    return int(order)


def _points(value: Any) -> tuple[complex, ...]:
    _require(not isinstance(value, str) and len(value) % 2 == 0)
    numbers = [number(-1e6, 1e6, 'm').check(each) for each in value]
    return tuple(map(complex, numbers[::2], numbers[1::2]))


def _shape(value: Any) -> tuple[complex, ...]:
    shape = _points(value)
    _require(len(shape) != 1 and len(set(shape)) == len(shape))
    return shape


def _pin(value: Any) -> tuple[complex, ...]:
    _require(len(value) in (0, 4))
    return _points(value)


FLAG = Kind(_flag, 'true or false')
PLANE = Kind(_plane, 'one of xy, yz, zx, fit, or a normal [x, y, z] of three numbers, not all 0')
# As ROS 2 has it: names of letters, digits and _ between slashes.
TOPIC = text(
    r'(?a:(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*)',
    'the name of a topic, such as markers or /rig/markers',
)
ORDER = Kind(_order, 'auto, 1, 2, 3 or 4')
MARKERS = names("a list of different marker identities, as text, such as ['0', '1', '2']")
PAIR = names(
    "two different names of bodies, or 'ground' and one, such as ['crank', 'coupler']",
    fewest=2,
    most=2,
)
SHAPE = Kind(
    _shape,
    'a flat list of x, y of two or more markers at different places, m, such as '
    '[0.0, 0.0, 0.1, 0.0, 0.05, 0.08]',
)
PIN = Kind(_pin, 'a flat list of four numbers, m, such as [0.0, 0.0, 0.3, 0.1]')
