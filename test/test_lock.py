"""The lock files in requirements/ are whole: pip has nothing to resolve, today or later."""

import re
import shutil
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PYTHONS = ['3.10', '3.11', '3.12', '3.13', '3.14']
# The extras that each command of the Makefile installs.
EXTRAS = {
    'demo': ['plot', 'ros'],
    'test': ['batch', 'cluster', 'film', 'formats', 'parquet', 'plot', 'ros', 'test'],
    'docs': ['docs', 'plot', 'ros'],
}
# A bare install of what the demo needs has 100 packages.
MOST_PACKAGES_OF_DEMO = 110
# Packages that a lock is to lack.
LACKING = (r'numpy==\S+', r'coverage\[toml\]==\S+', r'kiwisolver==\S+')


def environment(python: str) -> dict[str, str]:
    """The markers of CPython on Linux x86-64, for which rclpy has wheels."""
    return {
        'implementation_name': 'cpython',
        'os_name': 'posix',
        'platform_machine': 'x86_64',
        'platform_python_implementation': 'CPython',
        'platform_system': 'Linux',
        'python_full_version': f'{python}.0',
        'python_version': python,
        'sys_platform': 'linux',
    }


def pins(text: str, python: str) -> dict[str, str]:
    """The `name[extra]==version` that one Python takes of a lock, by canonical name."""
    found: dict[str, str] = {}
    for entry in text.replace('\\\n', ' ').splitlines():
        requirement = Requirement(re.split(r' +--hash=', entry)[0])
        if requirement.marker is None or requirement.marker.evaluate(environment(python)):
            key = canonicalize_name(requirement.name)
            assert key not in found, f'{key} is pinned twice for Python {python}'
            extras = ','.join(sorted(requirement.extras))
            found[key] = f'{key}[{extras}]{requirement.specifier}'
    return found


def file_of(name: str) -> Path:
    return ROOT / 'requirements' / f'{name}.txt'


@lru_cache
def lock(name: str) -> str:
    return file_of(name).read_text(encoding='utf-8')


def resolved(lock_file: Path, name: str, python: str) -> str:
    """Resolve setup.py together with a lock file, as a lock of its own."""
    uv = shutil.which('uv', path=str(Path(sys.executable).parent)) or shutil.which('uv')
    if uv is None:
        pytest.skip('uv, of the extra test, is not installed')
    command = [uv, 'pip', 'compile', 'setup.py', str(lock_file), '--quiet', '--no-strip-extras']
    command += ['--no-header', '--no-annotate', '--python-version', python]
    command += ['--no-python-downloads', '--python', sys.executable]
    command += ['--python-platform', 'x86_64-manylinux_2_28']
    command += [word for extra in EXTRAS[name] for word in ('--extra', extra)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    if run.returncode and re.search('error sending request|dns error', run.stderr):
        pytest.skip('the package index, which knows what packages require, cannot be reached')
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('name', EXTRAS)
def test_every_requirement_of_a_locked_package_is_met_inside_the_lock(
    name: str, python: str
) -> None:
    # Resolving adds nothing: no package, no other version, and no extra, which pip before 23.3
    # would take for a requirement of its own.
    whole = resolved(file_of(name), name, python)
    assert pins(whole, python) == pins(lock(name), python)


@pytest.mark.parametrize('line', LACKING)
def test_a_lock_that_lacks_a_package_is_seen(line: str, tmp_path: Path) -> None:
    lacking = tmp_path / 'lacking.txt'
    lacking.write_text(re.sub(rf'(?m)^{line}.*\\\n( .*\n)+', '', lock('test')))
    assert pins(resolved(lacking, 'test', '3.12'), '3.12') != pins(lacking.read_text(), '3.12')


@pytest.mark.parametrize('name', [*EXTRAS, 'compiler'])
def test_every_pin_has_a_hash(name: str) -> None:
    entries = lock(name).replace('\\\n', ' ').splitlines()
    assert [entry for entry in entries if not re.search('--hash=sha256:[0-9a-f]{64}', entry)] == []


@pytest.mark.parametrize('python', PYTHONS)
def test_commands_share_one_environment(python: str) -> None:
    shared: dict[str, str] = {}
    for name in EXTRAS:
        for key, pin in pins(lock(name), python).items():
            assert shared.setdefault(key, pin) == pin
    assert set(pins(lock('demo'), python)) < set(pins(lock('test'), python))


@pytest.mark.parametrize('python', PYTHONS)
def test_the_demo_installs_no_more_than_it_needs(python: str) -> None:
    assert len(pins(lock('demo'), python)) <= MOST_PACKAGES_OF_DEMO
