"""The files of scenes: where they are, the YAML in them, and their text with other dimensions."""

import re
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path
from typing import Any

import yaml

from kinpole_ros.files import did_you_mean, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, Loader, load_yaml
from kinpole_ros.mechanism._equations import Dimension
from kinpole_ros.mechanism._scene_values import SceneError

_PACKAGE = Path(__file__).resolve().parents[1]
_DIGITS = 12  # lengths that have to be equal must be so to one in 1e9


def share_folder() -> Path:
    """
    The folder that holds `config/`.

    Returns
    -------
    Path
        In a source tree (also through a link from a workspace) the folder of package.xml. Installed
        by pip or colcon, `share/kinpole_ros` under the prefix that the package lies in
        (sys.prefix, the user's or a workspace's own), or else what the ament index names.

    Raises
    ------
    FileNotFoundError
        If none of them has it.

    """
    candidates = [_PACKAGE.parent] if (_PACKAGE.parent / 'package.xml').is_file() else []
    candidates += [prefix / 'share' / 'kinpole_ros' for prefix in _PACKAGE.parents]
    for folder in candidates:
        if (folder / 'config').is_dir():
            return folder
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory('kinpole_ros'))
    # No ament; a package that its index does not have; no ROS sourced.
    except (ImportError, LookupError, OSError):
        raise FileNotFoundError(
            f'{_PACKAGE}: no config/ folder goes with this copy of kinpole_ros: install it with '
            'pip or colcon, or give the path of the file'
        ) from None


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
        If they are not installed.

    """
    return share_folder() / 'config' / 'scenes'


def scene_names() -> list[str]:
    """
    The names that `load_scene` accepts without a path.

    Returns
    -------
    list of str
        Sorted.

    Raises
    ------
    FileNotFoundError
        If the scenes are not installed.

    """
    return sorted(path.stem for path in scenes_folder().glob('*.yaml'))


def scene_path(path_or_name: str | Path) -> Path:
    """The path of a scene's file; raises SceneError if it does not exist."""
    path = Path(path_or_name)
    names = hint = ''
    if path.suffix == '' and len(path.parts) <= 1:
        try:
            path = scenes_folder() / f'{path_or_name}.yaml'
            local = f' as {path_or_name}.yaml' if Path(f'{path_or_name}.yaml').is_file() else ''
            names = f'{local}, or a name: {", ".join(scene_names())}'
            hint = did_you_mean(str(path_or_name)[:100], scene_names())
        except FileNotFoundError as error:
            raise SceneError(str(error)) from None
    if not path.exists():
        raise SceneError(f'{path}: there is no such scene file: {hint}give the path of one{names}')
    return path


def is_text(source: str | Path) -> bool:
    """Whether this is the text of a scene, which has lines, and no path."""
    return isinstance(source, str) and '\n' in source


def scene_text(source: str | Path) -> str:
    """
    The text of a scene's file.

    Parameters
    ----------
    source
        A path, a bare name or a text, as `load_scene` takes them.

    Returns
    -------
    str
        As in the file.

    Raises
    ------
    SceneError
        For a file that cannot be read.

    """
    if is_text(source):
        return str(source)
    path = scene_path(source)
    try:
        return read_limited(path, MOST_YAML).decode()
    except (OSError, ValueError) as error:
        raise SceneError(f'{path}: cannot be read: {error}') from None


def read_scene(path: Path) -> Any:
    """The data in a YAML file."""
    try:
        return parse_scene(path, read_limited(path, MOST_YAML))
    except OSError as error:
        raise SceneError(
            f'{path}: cannot be read: {error.strerror}; give the path of a scene file'
        ) from None


def parse_scene(path: str | Path, text: str | bytes) -> Any:
    """The data in a YAML text; `path` names it in messages."""
    try:
        return load_yaml(text, _Loader)
    # ValueError: a whole number of thousands of digits.
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, 'problem_mark', None)
        line = f'line {mark.line + 1}: ' if mark else ''
        problem = getattr(error, 'problem', None) or ' '.join(str(error).split())
        raise SceneError(f'{path}: {line}not a usable YAML file: {problem}') from None


class _Loader(Loader):
    """A loader for numbers as people write them, such as 1e3."""

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


def rewritten(text: str, changes: Mapping[Dimension, float]) -> str:
    """The text of a scene's file with some dimensions at new values, m or rad; comments stay."""
    by_path: dict[tuple[str | int, ...], list[tuple[Dimension, float]]] = {}
    for dimension, value in changes.items():
        by_path.setdefault(dimension.path, []).append((dimension, value))
    edits = []
    for (first, end), rows in zip(value_spans(text, list(by_path)), by_path.values(), strict=True):
        rows.sort(key=lambda row: row[0].axis)
        edits.append((first, end, _value_text(text[first:end], rows)))
    for first, end, new in sorted(edits, reverse=True):
        text = text[:first] + new + text[end:]
    return text


def value_spans(text: str, paths: Sequence[Sequence[str | int]]) -> list[tuple[int, int]]:
    """
    The positions of values in the text of a scene's file: first letter, and that after the last.

    `paths` are the keys that lead to each value, and positions in lists. A missing 'start' is at
    the end of the text; for any other missing value SceneError is raised.
    """
    root = yaml.compose(text, yaml.SafeLoader)
    spans = []
    for path in paths:
        if list(path) == ['start'] and 'start' not in [key.value for key, _ in root.value]:
            spans.append((len(text), len(text)))
            continue
        first = last = _node(root, path)
        # A block ends only where the next one begins, after comments.
        while isinstance(last, yaml.CollectionNode) and not last.flow_style and last.value:
            last = last.value[-1][1] if isinstance(last, yaml.MappingNode) else last.value[-1]
        spans.append((first.start_mark.index, last.end_mark.index))
    return spans


def _node(node: yaml.Node | None, path: Sequence[str | int]) -> yaml.Node:
    for key in path:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
        elif isinstance(node, yaml.MappingNode):
            node = next((value for name, value in node.value if name.value == key), None)
    if node is None:
        raise SceneError(f'the scene has no {".".join(map(str, path))} of its own to be changed')
    return node


def _value_text(old: str, rows: Sequence[tuple[Dimension, float]]) -> str:
    if rows[0][0].path[0] == 'bodies':
        return f'[{", ".join(_digits(value) for _, value in rows)}]'
    dimension, value = rows[0]
    if dimension.kind == 'length':
        return _digits(value)
    # An angle relative to another vector stays so.
    words = old.strip('\'"').split()
    if len(words) > 1 and words[1] in '+-' and not words[0][0].isdigit():
        return f'{words[0]} {"-" if value < 0 else "+"} {_digits(degrees(abs(value)))} deg'
    return f'{_digits(degrees(value))} deg'


def _digits(value: float) -> str:
    text = f'{value:.{_DIGITS}g}'
    return '0' if text == '-0' else text
