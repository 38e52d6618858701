"""The examples print what they say; this file needs no ROS, so it runs on any system."""

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


def said(run: Callable[[], Any]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        run()
    return out.getvalue()


@pytest.mark.parametrize('path', EXAMPLES, ids=lambda path: path.stem)
def test_examples_print_what_they_say(path: Path) -> None:
    """The same words; a number may differ by half, as measured ones do from estimator to next."""
    printed = said(lambda: runpy.run_path(str(path)))
    expected = (
        str(ast.get_docstring(ast.parse(path.read_text('utf-8')))).partition('Prints:\n')[2] + '\n'
    )
    assert NUMBER.sub('#', printed) == NUMBER.sub('#', expected)
    numbers = [[float(x) for x in NUMBER.findall(text)] for text in (printed, expected)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.5, abs=0.01)


def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('MPLBACKEND', 'agg')
    monkeypatch.chdir(ROOT / 'examples')
    notebook = json.loads((ROOT / 'examples' / 'four_bar.ipynb').read_text(encoding='utf-8'))
    codes = [''.join(cell['source']) for cell in notebook['cells'] if cell['cell_type'] == 'code']
    assert not any(cell.get('outputs') for cell in notebook['cells'])
    names: dict[str, Any] = {}
    said(lambda: [exec(code, names) for code in codes])
    names['plt'].close('all')
    assert names['known'].sum() > 50
    assert names['rms'] < 3
