"""
Values of a scene's keys as people write them: quantities with units, vectors, names of points.

A number without a unit is SI (m, rad, s, N, kg). A value that cannot be read raises SceneError with
what was written and an example of what can be.
"""

import re
from cmath import exp
from collections.abc import Callable
from contextlib import suppress
from math import isfinite, pi
from typing import Any, NamedTuple

from kinpole_ros.files import did_you_mean


class SceneError(ValueError):
    """A scene file that cannot be used: one line with the file, the key and the fix."""


# Body and position in its frame, complex, m, of the points by their names BODY.POINT.
Points = dict[str, tuple[str, complex]]
_DEGREE, _TURN = pi / 180, 2 * pi
UNITS: dict[str, dict[str, float]] = {
    'length': {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'in': 0.0254, 'ft': 0.3048},
    'angle': {'rad': 1.0, 'deg': _DEGREE, '°': _DEGREE, 'rev': _TURN},
    'velocity': {'m/s': 1.0, 'cm/s': 0.01, 'mm/s': 0.001, 'in/s': 0.0254, 'ft/s': 0.3048},
    'angular velocity': {'rad/s': 1.0, 'deg/s': _DEGREE, 'rev/s': _TURN, 'rpm': _TURN / 60},
    'time': {'s': 1.0, 'ms': 0.001, 'us': 1e-6, 'µs': 1e-6, 'min': 60.0},
    'frequency': {'Hz': 1.0, '1/s': 1.0, 'rpm': 1 / 60},
    'force': {'N': 1.0, 'kN': 1000.0, 'lbf': 4.4482216152605},
    'torque': {'N m': 1.0, 'N cm': 0.01, 'N mm': 0.001, 'kN m': 1000.0},
    'mass': {'kg': 1.0, 'g': 0.001, 't': 1000.0, 'lb': 0.45359237},
    'moment of inertia': {'kg m2': 1.0, 'kg cm2': 1e-4, 'kg mm2': 1e-6, 'g mm2': 1e-9},
    'stiffness': {'N/m': 1.0, 'N/cm': 100.0, 'N/mm': 1000.0, 'kN/m': 1000.0},
    'torsional stiffness': {
        'N m/rad': 1.0,
        'N cm/rad': 0.01,
        'N mm/rad': 0.001,
        'N m/deg': 1 / _DEGREE,
        'N cm/deg': 0.01 / _DEGREE,
        'N mm/deg': 0.001 / _DEGREE,
    },
}
# In SI units: no linkage is so long or fast, and fourth powers of smaller values do not overflow.
_LARGEST = 1e15
_EXAMPLES = {
    'length': '0.12 or 12 cm',
    'angle': '0.5 or 30 deg',
    'velocity': '0.2 or 20 cm/s',
    'angular velocity': '6.28 or 1 rev/s',
    'time': '2 or 200 ms',
    'frequency': '1.5 or 1.5 Hz',
    'force': '500 or 0.5 kN',
    'torque': '2 or 200 N cm',
    'mass': '80 or 80 kg',
    'moment of inertia': '0.02 or 200 kg cm2',
    'stiffness': '2000 or 2 N/mm',
    'torsional stiffness': '3 or 3 N m/rad',
}
_QUANTITY = re.compile(r'\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*')


class Form(NamedTuple):
    """How a scene states a joint or a follower: its keys, an example, and what reads them."""

    keys: tuple[str, ...]
    example: str
    read: Callable[..., Any]


def quantity(where: str, value: Any, kind: str) -> float:
    """
    The value of a key of a scene in SI units.

    Parameters
    ----------
    where
        Begins the message of an error.
    value
        A number, or a text with a unit.
    kind
        A key of UNITS.

    Returns
    -------
    float
        m, rad, s, N and so on.

    Raises
    ------
    SceneError
        For a value that is no number, is too large, or has a unit of another kind.

    """
    number, unit = float('nan'), ''
    if isinstance(value, str) and (match := _QUANTITY.fullmatch(value)):
        number, unit = float(match[1]), ' '.join(re.split(r'[\s*·]+', match[2]))
        # Greek mu and the sign of micro look the same.
        unit = unit.replace('²', '2').replace('^2', '2').replace('\u03bc', 'µ')
    elif isinstance(value, int | float) and not isinstance(value, bool):
        # Whole numbers may be too large for a float.
        with suppress(OverflowError):
            number = float(value)
    units = UNITS[kind]
    if unit and unit not in units:
        raise SceneError(
            f'{where} is {value!r}, whose unit is none of {kind}: use one of {", ".join(units)}'
        )
    result = number * (units[unit] if unit else 1.0)
    if not isfinite(result):
        raise SceneError(f'{where} is {value!r}: give a finite number, as {_EXAMPLES[kind]}')
    if abs(result) > _LARGEST:
        raise SceneError(f'{where} is {value!r}, beyond all use: check the number and its unit')
    return result


def positive(where: str, value: Any, kind: str) -> float:
    """A quantity greater than 0."""
    result = quantity(where, value, kind)
    if result <= 0:
        raise SceneError(f'{where} is {value!r}: give one greater than 0')
    return result


def vector(where: str, value: Any, kind: str = 'length') -> complex:
    """A vector of the plane, complex: [x, y], or polar, LENGTH @ ANGLE."""
    if isinstance(value, str) and value.count('@') == 1:
        size, angle = (part.strip() for part in value.split('@'))
        # Turned by exact quarters, so that 0.2 @ 90 deg lies on the axis.
        return quantity(where, size, kind) * direction(quantity(where, angle, 'angle'))
    if isinstance(value, list | tuple) and len(value) == 2:
        return complex(*(quantity(where, part, kind) for part in value))
    raise SceneError(f'{where} is {value!r}: give [x, y], or LENGTH @ ANGLE as 0.2 @ 135 deg')


def direction(angle: float) -> complex:
    """The unit vector at `angle` (rad), exact at quarter turns."""
    quarters = angle / (pi / 2)
    if abs(quarters - round(quarters)) < 1e-14 * max(1.0, abs(quarters)):
        return 1j ** (round(quarters) % 4)
    return exp(1j * angle)


def named_point(where: str, value: Any, points: Points) -> tuple[str, complex]:
    """The body and position of a point written as BODY.POINT."""
    # A list cannot be looked up.
    if not isinstance(value, str) or value not in points:
        raise SceneError(
            f'{where} is {value!r}, which is no point: give one of {", ".join(points)}'
        )
    return points[value]


def mapping(where: str, value: Any, example: str) -> dict[str, Any]:
    """`value` if it is a mapping with text for keys, and not empty."""
    if not isinstance(value, dict) or not value:
        raise SceneError(f'{where} holds no keys and values: write {example}')
    for key in value:
        if not isinstance(key, str):
            raise SceneError(
                f"{where} has a name {key!r} that is not text: write it in quotes, '{key}'"
            )
    return value


def refuse_unknown(where: str, data: dict[str, Any], allowed: tuple[str, ...]) -> None:
    """Refuse the first key that is not among those `allowed`."""
    for key in data:
        if key not in allowed:
            hint = did_you_mean(key[:100], allowed)
            raise SceneError(f"{where}: unknown key '{key}': {hint}use {', '.join(allowed)}")


def need(where: str, data: dict[str, Any], keys: tuple[str, ...], example: str) -> None:
    """Refuse data without one of `keys`."""
    for key in keys:
        if key not in data:
            raise SceneError(f"{where}: the key '{key}' is missing: add it, as in {example}")


def one_of(where: str, value: Any, allowed: tuple[str, ...] | list[str]) -> str:
    """`value` if it is one of those allowed."""
    if value not in allowed:
        raise SceneError(f'{where} is {value!r}: give one of {", ".join(allowed)}')
    return str(value)


def refuse_one_body(where: str, first: str, second: str) -> None:
    if first == second:
        raise SceneError(f"{where}: both its points are on '{first}': give points of two bodies")
