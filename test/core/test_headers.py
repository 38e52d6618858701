"""Headers of the library compile alone, and so do the files of the estimator."""

import re
import shlex
import shutil
import subprocess
import sysconfig
from collections import defaultdict
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / 'kinpole_ros'
COMPILER = shlex.split(sysconfig.get_config_var('CC') or 'cc')
FILES = [*PACKAGE.rglob('*.h'), *PACKAGE.rglob('*.c')]

pytestmark = pytest.mark.skipif(not shutil.which(COMPILER[0]), reason='no C compiler')


@pytest.mark.parametrize('file', sorted(FILES), ids=lambda file: file.name)
def test_each_file_compiles_alone(file: Path) -> None:
    """A header that needs another before it would not."""
    flags = '-fsyntax-only', '-Wall', '-Wextra', '-Wno-sign-compare', '-Wno-unknown-pragmas'
    done = subprocess.run(
        [*COMPILER, *flags, '-x', 'c', str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and not done.stderr, done.stderr


def test_lines_of_c_have_100_columns_at_most() -> None:
    """As those of Python, which ruff measures."""
    lines = {file.name: file.read_text(encoding='utf-8').splitlines() for file in FILES}
    long = [f'{name}: {line}' for name, own in lines.items() for line in own if len(line) > 100]
    assert not long


def test_every_function_of_c_says_what_it_does() -> None:
    """Beside its body, or beside its prototype in a header, which others may share."""
    bodies, told = set(), set()
    for file in FILES:
        text = file.read_text(encoding='utf-8')
        bodies |= set(re.findall(r'^([a-z]\w*)\([^;{}]*\)\n\{', text, re.MULTILINE))
        for block in re.findall(r'\*/\n((?:.+\n)+)', text):
            told |= set(re.findall(r'^(?:\w[\w *]*\b)?([a-z]\w*)\(', block, re.MULTILINE))
    assert not bodies - told


def test_a_name_of_c_is_defined_once() -> None:
    """Functions, types and constants, except those that a file may set before others."""
    owners = defaultdict(set)
    for file in FILES:
        text = file.read_text(encoding='utf-8')
        names = re.findall(r'^([a-z]\w*)\([^;{}]*\)\n\{', text, re.MULTILINE)
        names += re.findall(r'^(?:\} |#define |static const \w+ )(\w+)', text, re.MULTILINE)
        for constants in re.findall(r'^enum \{(?! \w+\()(.*?)\};', text, re.MULTILINE | re.DOTALL):
            names += [constant.split('=')[0].strip() for constant in constants.split(',')]
        for name in {*names} - {*re.findall(r'^#ifndef (\w+)', text, re.MULTILINE)}:
            owners[name].add(file.name)
    assert {name: files for name, files in owners.items() if len(files) > 1} == {}
