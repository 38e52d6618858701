"""Public functions and classes document their parameters, results and errors (numpydoc)."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

import kinpole_ros
from kinpole_ros import bags, linkage, mechanism, messages, planar

# Those of which docs/python.md has all functions.
PACKAGES = kinpole_ros, planar, bags, mechanism, linkage


def public_objects(package: ModuleType) -> Iterator[tuple[str, Any]]:
    """Yield the functions and classes of a package's `__all__` with their names."""
    for name in package.__all__:
        value = getattr(package, name)
        is_documented_here = getattr(value, '__module__', '').startswith('kinpole_ros')
        if is_documented_here and (inspect.isfunction(value) or inspect.isclass(value)):
            yield name, value


def sections_of(text: str) -> dict[str, str]:
    """Return the sections of a docstring by heading."""
    return dict(re.findall(r'^(\w+)\n-+\n(.*?)(?=\n\n\w+\n-|\Z)', text, re.M | re.S))


def names_in(section: str) -> list[str]:
    """Return the names that a section describes."""
    headings = re.findall(r'^\S.*', section, re.M)
    return [name.lstrip('*') for line in headings for name in line.split(' : ')[0].split(', ')]


def raised_by(function: Any) -> set[str]:
    """Return the exceptions that a function raises in its own body."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    calls = [node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise)]
    names = [call.func if isinstance(call, ast.Call) else call for call in calls]
    return {name.id for name in names if isinstance(name, ast.Name) and name.id[0].isupper()}


def missing_in(value: Any) -> list[str]:
    """Return what the docstring of a function or class does not document."""
    text = inspect.getdoc(value) or ''
    if inspect.isclass(value):
        return [] if text else ['docstring']
    sections = sections_of(text)
    missing = []
    signature = inspect.signature(value)
    if sorted(names_in(sections.get('Parameters', ''))) != sorted(signature.parameters):
        missing.append('Parameters')
    result = 'Yields' if inspect.isgeneratorfunction(value) else 'Returns'
    if (result in sections) != (signature.return_annotation is not None):
        missing.append(result)
    if not raised_by(value) <= {*names_in(sections.get('Raises', ''))}:
        missing.append('Raises')
    return missing


# Functions still without sections, by package. Lower a number when you document one.
INCOMPLETE = {bags: 11, linkage: 5}


@pytest.mark.parametrize('package', PACKAGES, ids=lambda package: package.__name__)
def test_public_objects_have_numpydoc_sections(package: ModuleType) -> None:
    missing = {name: missing_in(value) for name, value in public_objects(package)}
    incomplete = {name: sections for name, sections in missing.items() if sections}
    assert len(incomplete) <= INCOMPLETE.get(package, 0), incomplete


def test_what_other_packages_take_from_messages_has_a_docstring() -> None:
    assert all(inspect.getdoc(value) for _, value in public_objects(messages))
