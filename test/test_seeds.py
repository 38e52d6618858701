"""docs/seeds.md is what its commands and expressions give, and these are as printed."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / 'docs'


def test_the_page_of_the_seeds_is_what_comes_out() -> None:
    made = runpy.run_path(str(DOCS / '_seeds.py'))
    number = made['NUMBER']
    text, kept = made['page'](), (DOCS / 'seeds.md').read_text('utf-8')
    # Numbers may differ by rounding from one machine to another.
    assert number.sub('#', text) == number.sub('#', kept), 'run python docs/_seeds.py'
    found, there = (list(map(float, number.findall(one))) for one in (text, kept))
    assert found == pytest.approx(there, rel=2e-4, abs=1e-9)
