"""Parameters from ROS 2 parameter files, and from words as of `ros2 run ... -p`."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from kinpole_ros.files import cut, cut_line, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml
from kinpole_ros.settings.consistency import settings_from
from kinpole_ros.settings.kinds import ParameterError
from kinpole_ros.settings.ros_yaml import RosLoader
from kinpole_ros.settings.settings import Settings

# Raised for malformed YAML; PyYAML lets some errors of Python through.
_MALFORMED = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError)


def load_settings(
    path: str | Path, node_name: str = 'kinpole', changes: Mapping[str, Any] | None = None
) -> Settings:
    """
    Read a ROS 2 parameter file: the sections '/**' and that of the node.

    `changes`, by ROS names, override what it says. Raises ParameterError naming the file for
    anything that cannot be used.
    """
    try:
        document = load_yaml(read_limited(path, MOST_YAML), RosLoader)
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}; name a readable parameter file') from None
    except _MALFORMED as error:
        reason = cut_line(' '.join(str(error).split()))
        raise ParameterError(f'{path}: not YAML ({reason})') from None
    wanted = {'/**', node_name, f'/{node_name}'}
    sections = document if isinstance(document, dict) else {}
    values: dict[str, Any] = {}
    found = False
    for key, section in sections.items():
        if key not in wanted:
            continue
        if not isinstance(section, dict) or not isinstance(section.get('ros__parameters'), dict):
            raise ParameterError(
                f'{path}: {key} must hold the key ros__parameters, and that the parameters'
            )
        found = True
        try:
            values.update(_flat(section['ros__parameters']))
        except ParameterError as error:
            raise ParameterError(f'{path}: {error}') from None
    if not found:
        raise ParameterError(
            f'{path}: no section for this node; write {node_name}: or /**: and under it '
            'ros__parameters:'
        )
    try:
        return settings_from(values | dict(changes or {}))
    except ParameterError as error:
        source = f'{path} and --set' if changes else path
        raise ParameterError(f'{source}: {error}') from None


def assignments(words: Iterable[str]) -> dict[str, Any]:
    """
    Parameters by their ROS names from words as of `ros2 run ... -p`: NAME:=VALUE, VALUE in YAML.

    The last of several of one name holds. Raises ParameterError for a word that is none.
    """
    values: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition(':=')
        if not sign or not name:
            raise ParameterError(f'{cut(word)} is not NAME:=VALUE, such as lag:=0.05')
        try:
            value = load_yaml(text, RosLoader)
        except _MALFORMED as error:
            reason = cut_line(' '.join(str(error).split()))
            raise ParameterError(f'{cut(word)}: the value is not YAML ({reason})') from None
        values.update(_flat({name: value}))
    return values


def _flat(section: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """
    Names as ROS has them: nested keys with dots between them.

    Raises ParameterError for what the node does not take either: no value, and lists of values of
    several types, of which there are none in ROS.
    """
    values: dict[str, Any] = {}
    for key, value in section.items():
        name = f'{prefix}{key}'
        if value is None or value in ({}, []):
            raise ParameterError(f'parameter {cut(name)} has no value; leave it out or give it one')
        if isinstance(value, list) and len({type(each) for each in value}) > 1:
            raise ParameterError(
                f'parameter {cut(name)} is {cut(repr(value))}, a list of several types; give all '
                'numbers of a list a point, as in [0.0, 1.0], or all texts quotes'
            )
        new = _flat(value, f'{name}.') if isinstance(value, dict) else {name: value}
        if twice := values.keys() & new.keys():
            raise ParameterError(f'parameter {cut(min(twice))} is given twice; keep one')
        values.update(new)
    return values
