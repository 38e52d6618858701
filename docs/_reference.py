"""
The references of parameters, topics, commands and structs, generated from the code as Markdown.

Each replaces its comment in a page when the site is built, so it cannot be out of date.
"""

import argparse
import inspect
import re
from pathlib import Path
from typing import Any

from kinpole_ros import settings as parameters
from kinpole_ros.core.bindings import Struct
from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import live_outputs, result_outputs, type_name
from kinpole_ros.tools.usage import make_parser

_ROW = re.compile(r'^\| (`.*?) \| .* \| (.*) \|$', re.MULTILINE)
_NAME = re.compile(r'`([^`]+)`')
_TOPICS_HEADING = '## What does the node publish?'


def parameter_reference() -> str:
    """Return a section for each parameter: description, default, range, when it can be set."""
    rows = {
        **parameters.PARAMETERS,
        **parameters.OWN_PARAMETERS,
        **parameters.NODE_PARAMETERS,
    }
    sections = []
    for name, row in rows.items():
        default = '(none)' if row.default in ('', []) else f'`{_yaml(row.default)}`'
        sections.append(
            f'## `{name}`\n\n{_escape(row.description)}\n\n- default: {default}\n'
            f'- allowed: {_escape(row.kind.allowed)}\n- can be set {row.settable}\n'
        )
    return '\n'.join(sections)


def topic_reference() -> str:
    """Return a table of all topics: description of docs/live.md, type, uncertainty, derivatives."""
    scene = load_scene('trebuchet')
    theory = Theory(scene, {}, 'a body', tuple(scene.loads))
    outputs = result_outputs(('<i>', '<j>'), 'xy', theory, {'joint': ('<i>', '<j>')})
    outputs.append(live_outputs(parameters.Settings(), None)[-1])
    descriptions = _topic_descriptions()
    lines = [
        '| topic | what | unit | type | uncertainty | needs | topics |',
        f'|{" --- |" * 7}',
    ]
    standard = {output.topic: output.is_standard for output in outputs}
    for output in outputs:
        topic = output.topic
        if topic.endswith(('/with_covariance', '/deviation')):
            continue
        if topic.startswith('<j>') and '/wrt/' not in topic:
            continue
        uncertainty = ', '.join(
            f'`/{name}`{"" if standard[f"{topic}/{name}"] else " (all)"}'
            for name in ('with_covariance', 'deviation')
            if f'{topic}/{name}' in standard
        )
        chosen = 'standard' if output.is_standard else 'all'
        topic = re.sub(r'^<i>', '<body>', topic)
        if topic not in descriptions:
            raise ValueError(f'docs/live.md has no row for the topic {topic}')
        message = type_name(output.message_type).replace('/msg/', '/')
        cells = f'`{topic}`', descriptions[topic], output.unit, f'`{message}`', uncertainty
        lines.append(f'| {" | ".join(cells)} | {output.order} | {chosen} |')
    return '\n'.join(lines) + '\n'


def command_reference() -> str:
    """Return a section for each command: its description and its arguments."""
    parser = make_parser()
    [choices] = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    return '\n'.join(_command_section(name, one) for name, one in choices.choices.items())


def struct_reference() -> str:
    """Return a section for each struct of the compiled library, with a table of its fields."""
    lines = []
    for struct in Struct.__subclasses__():
        lines += [f'## {struct.__name__}', '', inspect.getdoc(struct) or '', '']
        lines += ['| field | type | shape | what |', '| --- | --- | --- | --- |']
        for name, meaning in struct.meanings.items():
            array = name in struct.elements
            kind = struct.elements[name] if array else dict(struct._fields_)[name].__name__
            shape = f'({", ".join(struct.shapes[name])})' if array else ''
            lines.append(f'| `{name}` | {_escape(str(kind))} | {shape} | {_escape(meaning)} |')
        lines.append('')
    return '\n'.join(lines)


REFERENCES = {
    '<!-- every parameter -->': parameter_reference,
    '<!-- every topic -->': topic_reference,
    '<!-- every command -->': command_reference,
    '<!-- every struct -->': struct_reference,
}


def _yaml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _escape(text: str) -> str:
    """Return the text with the special characters of Markdown escaped."""
    return re.sub(r'([\\`*_{}\[\]<>#|~$])', r'\\\1', text)


def _topic_descriptions() -> dict[str, str]:
    """Return the table of docs/live.md; a short name is a sibling of the first one in its row."""
    text = (Path(__file__).parent / 'live.md').read_text('utf-8')
    descriptions = {}
    for cell, description in _ROW.findall(text.partition(_TOPICS_HEADING)[2]):
        first, *short = _NAME.findall(cell)
        names = [first, *(f'{first.rpartition("/")[0]}/{name}' for name in short)]
        descriptions |= dict.fromkeys(names, description.replace('](#', '](live.md#'))
    return descriptions


def _command_section(name: str, parser: argparse.ArgumentParser) -> str:
    # The width of the terminal must not affect the page.
    parser.formatter_class = lambda prog: argparse.RawDescriptionHelpFormatter(prog, width=90)
    lines = [f'## kinpole {name}', '', '```text', parser.format_usage().strip(), '```', '']
    lines += _paragraphs(parser.description or '')
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        options = ', '.join(action.option_strings) or str(action.metavar or action.dest)
        value = '' if action.nargs == 0 or not action.option_strings else action.metavar
        words = ' '.join(value) if isinstance(value, tuple) else value or ''
        lines += [f'`{f"{options} {words}".strip()}`', f': {_escape(action.help or "")}', '']
    if parser.epilog:
        lines += ['```text', parser.epilog.strip(), '```', '']
    return '\n'.join(lines)


def _paragraphs(text: str) -> list[str]:
    """Return paragraphs as escaped text, and indented ones as blocks."""
    lines = []
    for paragraph in text.split('\n\n'):
        if paragraph.startswith('  '):
            lines += ['```text', paragraph, '```', '']
        else:
            lines += [_escape(paragraph), '']
    return lines
