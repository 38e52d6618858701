"""What the parts of the benchmarks' page share: tables and numbers in Markdown, and a bar."""

from collections.abc import Iterable

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
