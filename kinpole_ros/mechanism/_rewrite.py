"""A scene's text with other dimensions: only their values change, so comments and layout stay."""

from collections.abc import Mapping, Sequence
from math import degrees

import yaml

from kinpole_ros.mechanism._equations import Dimension
from kinpole_ros.mechanism._units import SceneError

_DIGITS = 12  # lengths that have to be equal must be so to one in 1e9


def rewritten(text: str, changes: Mapping[Dimension, float]) -> str:
    """
    The text of a scene's file with some dimensions at other values.

    Parameters
    ----------
    text
        As in the file; its comments stay.
    changes
        New values, m or rad, by dimension.

    Returns
    -------
    str
        The new text.

    """
    by_path: dict[tuple[str | int, ...], list[tuple[Dimension, float]]] = {}
    for dimension, value in changes.items():
        by_path.setdefault(dimension.path, []).append((dimension, value))
    edits = []
    for (first, end), rows in zip(value_spans(text, list(by_path)), by_path.values(), strict=True):
        rows.sort(key=lambda row: row[0].axis)
        edits.append((first, end, _written(text[first:end], rows)))
    for first, end, new in sorted(edits, reverse=True):
        text = text[:first] + new + text[end:]
    return text


def value_spans(text: str, paths: Sequence[Sequence[str | int]]) -> list[tuple[int, int]]:
    """
    Where values are in the text of a scene's file.

    Parameters
    ----------
    text
        As in the file.
    paths
        The keys that lead to each value, and places in lists.

    Returns
    -------
    list of tuple
        The first letter of each, and that after the last; for a 'start' that is not there, the end.

    Raises
    ------
    SceneError
        For another value that is not there.

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


def _written(old: str, rows: Sequence[tuple[Dimension, float]]) -> str:
    if rows[0][0].path[0] == 'bodies':
        return f'[{", ".join(_number(value) for _, value in rows)}]'
    dimension, value = rows[0]
    if dimension.kind == 'length':
        return f'{_number(value)}'
    shown = f'{_number(degrees(value))} deg'
    # An angle that is said from that of another vector stays so.
    words = old.strip('\'"').split()
    if len(words) > 1 and words[1] in '+-' and not words[0][0].isdigit():
        sign = '-' if value < 0 else '+'
        return f'{words[0]} {sign} {shown.lstrip("-")}'
    return shown


def _number(value: float) -> str:
    text = f'{value:.{_DIGITS}g}'
    return '0' if text == '-0' else text
