"""
The references of the site, made from the code as Markdown: parameters, topics and commands.

Each is where its comment is in a page. None is kept in a file, so none can be out of date.
"""

import argparse
import re
from pathlib import Path
from typing import Any

from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import live_outputs, result_outputs, type_name
from kinpole_ros.tools.usage import make_parser
from kinpole_ros.tracking import parameters

_ROW = re.compile(r'^\| (`.*?) \| .* \| (.*) \|$', re.MULTILINE)
_NAME = re.compile(r'`([^`]+)`')


def every_parameter() -> str:
    """A section for each parameter: what it means, its default and range, when it can be set."""
    rows = {**parameters.PARAMETERS}
    rows |= {f'<body>.{name}': row for name, row in _own('body').items()}
    rows['<joint>.bodies'] = parameters.JOINT_BODIES
    rows |= parameters.NODE_PARAMETERS
    sections = []
    for name, row in rows.items():
        when = _settable(name, row)
        default = '(none)' if row.default in ('', []) else f'`{_yaml(row.default)}`'
        sections.append(
            f'## `{name}`\n\n{_plain(row.description)}\n\n- default: {default}\n'
            f'- allowed: {_plain(row.allowed)}\n- {when}\n'
        )
    return '\n'.join(sections)


def _settable(name: str, row: parameters.Parameter) -> str:
    """Tell when a parameter can be set, as `ros.parameters` has it."""
    if row.fixed:
        return 'can be set at the start only'
    if parameters.is_of_bodies(name):
        return 'can be set at the start and while the node is inactive'
    return 'can be set while the node runs'


def every_topic() -> str:
    """A table of all topics: what docs/live.md says, type, uncertainty, and derivatives needed."""
    scene = load_scene('trebuchet')
    theory = Theory(scene, {}, 'a body', tuple(scene.loads))
    outputs = result_outputs(('<i>', '<j>'), 'xy', theory, {'joint': ('<i>', '<j>')})
    outputs.append(live_outputs(parameters.Settings(), None)[-1])
    meanings = _meanings()
    rows = ['| topic | what | type | uncertainty | needs |', '| --- | --- | --- | --- | --- |']
    names = {output.topic for output in outputs}
    for output in outputs:
        name = output.topic
        beside = [part for part in ('with_covariance', 'deviation') if f'{name}/{part}' in names]
        if name.endswith(('/with_covariance', '/deviation')):
            continue
        if name.startswith('<j>') and '/wrt/' not in name:
            continue
        name = re.sub(r'^<i>', '<body>', name)
        if name not in meanings:
            raise ValueError(f'docs/live.md has no row for the topic {name}')
        kind = type_name(output.message_type).replace('/msg/', '/')
        more = ', '.join(f'`/{part}`' for part in beside)
        rows.append(f'| `{name}` | {meanings[name]} | `{kind}` | {more} | {output.order} |')
    return '\n'.join(rows) + '\n'


def every_command() -> str:
    """A section for each command: what it does, and what it takes."""
    parser = make_parser()
    [choices] = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    return '\n'.join(_command(name, one) for name, one in choices.choices.items())


MADE = {
    '<!-- every parameter -->': every_parameter,
    '<!-- every topic -->': every_topic,
    '<!-- every command -->': every_command,
}


def _own(body: str) -> dict[str, parameters.Parameter]:
    found = parameters.own_parameters([body], [])
    return {name.removeprefix(f'{body}.'): row for name, row in found.items()}


def _yaml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _plain(text: str) -> str:
    """Text in which nothing is Markdown."""
    return re.sub(r'([\\`*_{}\[\]<>#|~$])', r'\\\1', text)


def _meanings() -> dict[str, str]:
    """What the table of docs/live.md says of each topic; short names go on from the first."""
    text = (Path(__file__).parent / 'live.md').read_text('utf-8')
    meanings = {}
    for cell, what in _ROW.findall(text.partition('## What it publishes')[2]):
        first, *others = _NAME.findall(cell)
        names = [first, *(f'{first.rpartition("/")[0]}/{other}' for other in others)]
        meanings |= dict.fromkeys(names, what)
    return meanings


def _command(name: str, parser: argparse.ArgumentParser) -> str:
    # The usage is wrapped by the width of a terminal, which is none of the page's.
    parser.formatter_class = lambda prog: argparse.RawDescriptionHelpFormatter(prog, width=90)
    lines = [f'## kinpole {name}', '', '```text', parser.format_usage().strip(), '```', '']
    lines += _prose(parser.description or '')
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        shown = ', '.join(action.option_strings) or str(action.metavar or action.dest)
        value = '' if action.nargs == 0 or not action.option_strings else action.metavar
        words = ' '.join(value) if isinstance(value, tuple) else value or ''
        lines += [f'`{f"{shown} {words}".strip()}`', f': {_plain(action.help or "")}', '']
    if parser.epilog:
        lines += ['```text', parser.epilog.strip(), '```', '']
    return '\n'.join(lines)


def _prose(text: str) -> list[str]:
    """Paragraphs as text; what is indented stays as it is."""
    lines = []
    for paragraph in text.split('\n\n'):
        if paragraph.startswith('  '):
            lines += ['```text', paragraph, '```', '']
        else:
            lines += [_plain(paragraph), '']
    return lines
