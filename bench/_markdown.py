"""What the parts of the benchmarks' page share: tables and numbers in Markdown, and a bar."""

import re
from collections.abc import Iterable
from textwrap import fill

import numpy as np

# Ratio that the project promises against peers at equal lag, and fixed windows on the pendulum.
PEER_BAR = 1.1


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [list(head)]
    lines.append(['---'] * len(lines[0]))
    lines += [list(row) for row in rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)


def number(value: float) -> str:
    if not np.isfinite(value):
        return '–'
    return f'{value:.2f}' if 0.005 <= value < 99.5 else f'{value:.2g}'


def wrapped(text: str) -> str:
    """Markdown with its paragraphs and lists in lines of 100 columns, and all else as it is."""
    blocks = []
    for block in re.split(r'\n{2,}', text.strip()):
        if block.startswith('- '):
            items = re.split(r'\n(?=- )', block)
            blocks.append('\n'.join(_filled(item, '  ') for item in items))
        elif block.startswith(('#', '|', '![', '<')):
            blocks.append(block)
        else:
            blocks.append(_filled(block))
    return '\n\n'.join(blocks) + '\n'


def _filled(text: str, indent: str = '') -> str:
    words = ' '.join(text.split())
    return fill(
        words, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
