"""Findings: codes and values between programs, sentences for people, one table for both."""

import ast
import string
from pathlib import Path

import pytest

from kinpole_ros import finding_table, findings
from kinpole_ros.finding_table import TABLE
from kinpole_ros.findings import ERROR, STALE, WARN, Finding, all_words, finding_of
from kinpole_ros.messages import FINDING, DiagnosticsMaker, warnings_in
from kinpole_ros.messages._types import DiagnosticStatus, KeyValue
from kinpole_ros.settings import Settings
from kinpole_ros.tracking import reasons
from kinpole_ros.tracking.tracker import Tracker

PACKAGE = Path(findings.__file__).parent


def strings_of(file: Path) -> set[str]:
    tree = ast.parse(file.read_text(encoding='utf-8'))
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return {node.value for node in nodes if isinstance(node.value, str)}


@pytest.fixture(scope='module')
def strings() -> dict[Path, set[str]]:
    """The texts in each module of the package."""
    return {file: strings_of(file) for file in PACKAGE.rglob('*.py')}


def test_each_sentence_of_a_cause_or_fix_is_in_one_table(strings: dict[Path, set[str]]) -> None:
    """So nothing can be looked up by one: a better word would lose it in silence."""
    texts = {text for row in (*TABLE.values(), *reasons.TABLE.values()) for text in row if text}
    tables = Path(finding_table.__file__), Path(reasons.__file__)
    for file, own in strings.items():
        assert file in tables or not own & {t for t in texts if ' ' in t}, file


def test_each_code_is_used(strings: dict[Path, set[str]]) -> None:
    elsewhere = set().union(
        *(own for file, own in strings.items() if file != Path(finding_table.__file__))
    )
    often = {f'often_{code}' for code in ('not_seen', 'no_frames')}
    assert {*TABLE} - often <= elsewhere


@pytest.mark.parametrize('code', TABLE)
def test_a_finding_is_the_same_on_the_other_side(code: str) -> None:
    """Of a program that reads diagnostics: it has the values, and can say them."""
    parts = [part for text in TABLE[code] for part in string.Formatter().parse(text)]
    values = {name: 2.5 if spec else 'x' for _, name, spec, _ in parts if name}
    finding = Finding(code, 'rod', values, ERROR)
    same = finding_of(finding.as_json())
    assert same == finding and same.words() == finding.words()
    assert same.line().startswith('rod: ')


@pytest.mark.parametrize('text', ['', '{}', '[]', '{"code": "new"}', '{"code": "unit"}', 'null'])
def test_what_is_no_finding_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r'no finding|Expecting'):
        finding_of(text)


def test_the_fix_follows_the_sentence() -> None:
    found = [Finding('off_plane', 'rod', {'off': 0.0123}), Finding('stamps_jumped')]
    assert all_words(found) == (
        'its markers are 0.012 m off one rigid body as the plane shows them, while they keep '
        'their distances in space; fix: set plane; stamps jumped: the window starts anew'
    )
    assert Finding('never_estimated', values={'body': 'a', 'reason': 'why'}, fix='do').words() == (
        'a was never estimated: why; fix: do'
    )


def test_diagnostics_have_codes_as_keys_and_pages_print_from_them() -> None:
    tracker = Tracker(Settings(bodies={'rod': ('1', '2')}))
    maker = DiagnosticsMaker('kinpole', topic='/markers')
    status = maker.make(0, tracker, None, 1.0, {}).status[0]
    keys = [pair.key for pair in status.values if pair.key.startswith(FINDING)]
    assert keys == [f'{FINDING}nothing_on_topic'] and status.level == STALE
    found = Finding('wrong_poses', 'rod', {'count': 3})
    values = [KeyValue(key=f'{FINDING}wrong_poses', value=found.as_json())]
    # Whatever the sentence is.
    rod = DiagnosticStatus(name='kinpole: rod', level=WARN, message='other words', values=values)
    assert list(warnings_in([status, rod])) == [found.line()]
