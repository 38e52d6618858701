"""docs/course_notes.md has the results of its commands and expressions."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / 'docs'


def test_the_page_of_the_course_notes_is_up_to_date() -> None:
    module = runpy.run_path(str(DOCS / '_course_notes.py'))
    number = module['NUMBER']
    new, stored = module['page'](), (DOCS / 'course_notes.md').read_text('utf-8')
    assert number.sub('#', new) == number.sub('#', stored), 'run python docs/_course_notes.py'
    # Numbers may differ between machines by rounding.
    new_numbers, stored_numbers = (list(map(float, number.findall(text))) for text in (new, stored))
    assert new_numbers == pytest.approx(stored_numbers, rel=2e-4, abs=1e-9)
