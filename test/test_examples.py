"""The examples print what their docstrings say. This file needs no ROS and runs on any system."""

import ast
import contextlib
import io
import json
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / 'examples').glob('*.py'))
NUMBER = re.compile(r'-?\d+(?:\.\d+)?')


def printed_by(run: Callable[[], Any]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        run()
    return out.getvalue()


@pytest.mark.parametrize('path', EXAMPLES, ids=lambda path: path.stem)
def test_examples_print_what_their_docstrings_say(path: Path) -> None:
    """Words are equal; numbers may differ by half, because they depend on the estimator."""
    printed = printed_by(lambda: runpy.run_path(str(path)))
    expected = (
        str(ast.get_docstring(ast.parse(path.read_text('utf-8')))).partition('Prints:\n')[2] + '\n'
    )
    assert NUMBER.sub('#', printed) == NUMBER.sub('#', expected)
    numbers = [[float(x) for x in NUMBER.findall(text)] for text in (printed, expected)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.5, abs=0.01)


def test_the_notebook_runs_and_contains_its_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('MPLBACKEND', 'agg')
    monkeypatch.chdir(ROOT / 'examples')
    notebook = json.loads((ROOT / 'examples' / 'four_bar.ipynb').read_text(encoding='utf-8'))
    cells = [cell for cell in notebook['cells'] if cell['cell_type'] == 'code']
    names: dict[str, Any] = {}
    printed = printed_by(lambda: [exec(''.join(cell['source']), names) for cell in cells])
    names['plt'].close('all')
    assert names['accurate'].sum() > 50
    assert names['rms'] < 3
    outputs = [output for cell in cells for output in cell['outputs']]
    stored = ''.join(text for output in outputs for text in output.get('text', ''))
    assert NUMBER.sub('#', stored) == NUMBER.sub('#', printed)
    assert sum('image/png' in output.get('data', {}) for output in outputs) == 2
