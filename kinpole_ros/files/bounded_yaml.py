"""
YAML of strangers: bounded in size, depth and number of values, without repeated keys.

Aliases are refused, by which a few lines become gigabytes, or take hours to be merged.
"""

import re
from typing import Any

import yaml

# As fast as ROS reads it, in C; some builds of PyYAML lack that.
_Base: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)

MOST_YAML = 1 << 20  # bytes of a file
_DEEPEST = 50  # levels; parameters and scenes have five
# Directives are compared in pairs, before any value can be counted.
_MOST_DIRECTIVES = 10


class Loader(_Base):
    """
    YAML of texts, null, lists, and mappings without repeated keys.

    A subclass adds numbers: PyYAML would take `on` for true, 1:30 for 90 and 010 for 8, as YAML 1.1
    has it, silently keep the last of two keys, and take minutes for 1:1:1 and so on.
    """

    longest: int | None = None  # characters of a value
    most = 50_000  # values

    yaml_constructors = {  # noqa: RUF012
        tag: make
        for tag, make in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.endswith((':null', ':str', ':seq', ':map'))
    }
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in rows if tag.endswith((':null', ':merge'))]
        for first, rows in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Return the mapping, or raise as the base class does for other faults."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            name = str(key.value)
            if name in seen:
                raise _refused(f"the key '{name[:80]}' is given twice: keep one", key)
            seen.add(name)
        return dict(super().construct_mapping(node, deep))


def load_yaml(text: str | bytes, loader: type[Loader] = Loader) -> Any:
    """
    Return the content of a text in YAML: mappings, lists, texts and what else the loader makes.

    Raises YAMLError, ValueError, LookupError, TypeError or AttributeError where the text is
    damaged, or exceeds a limit.
    """
    size = len(text.encode() if isinstance(text, str) else text)
    if size > MOST_YAML:
        raise yaml.YAMLError(f'larger than {MOST_YAML >> 20} MiB')
    percent = '^%' if isinstance(text, str) else b'^%'
    if len(re.findall(percent, text, re.MULTILINE)) > _MOST_DIRECTIVES:  # type: ignore[arg-type]
        raise yaml.YAMLError(f'more than {_MOST_DIRECTIVES} directives')
    _check(text, loader)
    return yaml.load(text, loader)


def _check(text: str | bytes, loader: type[Loader]) -> None:
    """Raise YAMLError where the text exceeds a limit, before any value is made."""
    values = depth = 0
    for event in yaml.parse(text, _Base):
        if isinstance(event, yaml.AliasEvent):
            raise _refused('aliases (*) are not read: write out what is meant', event)
        if isinstance(event, yaml.NodeEvent):
            values += 1
            if values > loader.most:
                raise _refused(f'more than {loader.most} values', event)
        if loader.longest is not None and len(getattr(event, 'value', '')) > loader.longest:
            raise _refused(f'a value of more than {loader.longest} characters', event)
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > _DEEPEST:
                raise _refused(f'nesting is deeper than {_DEEPEST} levels', event)
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _refused(problem: str, where: Any) -> yaml.YAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, where.start_mark)
