"""Where scene files are, and what the YAML in them holds."""

import re
from pathlib import Path
from typing import Any

import yaml

from kinpole_ros.files import read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, Loader, load_yaml
from kinpole_ros.mechanism._share import share_folder
from kinpole_ros.mechanism._units import SceneError


def scenes_folder() -> Path:
    """
    The folder of the scenes that come with the package.

    Returns
    -------
    Path
        It is in `share_folder()`.

    Raises
    ------
    FileNotFoundError
        Where they are not installed.

    """
    return share_folder() / 'config' / 'scenes'


def scene_names() -> list[str]:
    """
    The names that `load_scene` knows without a path.

    Returns
    -------
    list of str
        Sorted.

    Raises
    ------
    FileNotFoundError
        Where the scenes are not installed.

    """
    return sorted(path.stem for path in scenes_folder().glob('*.yaml'))


class _Loader(Loader):
    """With numbers as people write them."""

    longest, most = 1000, 5000


def _number(loader: _Loader, node: yaml.ScalarNode) -> int | float:
    text = loader.construct_scalar(node)
    return int(text) if re.fullmatch(r'[-+]?\d+', text) else float(text)


_Loader.add_constructor('tag:yaml.org,2002:float', _number)
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$', re.ASCII),
    list('-+.0123456789'),
)


def scene_path(path_or_name: str | Path) -> Path:
    """Return the file that is meant; raise SceneError where there is none."""
    path = Path(path_or_name)
    known = ''
    if path.suffix == '' and len(path.parts) <= 1:
        try:
            path = scenes_folder() / f'{path_or_name}.yaml'
            here = f' as {path_or_name}.yaml' if Path(f'{path_or_name}.yaml').is_file() else ''
            known = f'{here}, or a name: {", ".join(scene_names())}'
        except FileNotFoundError as error:
            raise SceneError(str(error)) from None
    if not path.exists():
        raise SceneError(f'{path}: there is no such scene file: give the path of one{known}')
    return path


def read_scene(path: Path) -> Any:
    """Return what the YAML file holds."""
    try:
        return parsed(path, read_limited(path, MOST_YAML))
    except OSError as error:
        raise SceneError(
            f'{path}: cannot be read: {error.strerror}; give the path of a scene file'
        ) from None


def scene_text(path_or_name: str | Path) -> str:
    """
    The text of a scene's file.

    Parameters
    ----------
    path_or_name
        As `load_scene` takes it.

    Returns
    -------
    str
        As in the file.

    Raises
    ------
    SceneError
        For a file that cannot be read.

    """
    path = scene_path(path_or_name)
    try:
        return read_limited(path, MOST_YAML).decode()
    except (OSError, ValueError) as error:
        raise SceneError(f'{path}: cannot be read: {error}') from None


def parsed(path: str | Path, text: str | bytes) -> Any:
    """Return what the YAML text holds; `path` names it in messages."""
    try:
        return load_yaml(text, _Loader)
    # ValueError: a whole number of thousands of digits.
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, 'problem_mark', None)
        line = f'line {mark.line + 1}: ' if mark else ''
        problem = getattr(error, 'problem', None) or ' '.join(str(error).split())
        raise SceneError(f'{path}: {line}not a usable YAML file: {problem}') from None
