"""Structs of the library: as the compiler lays them out, and filled with arrays of their types."""

import re
import shutil
import subprocess
import sys
from ctypes import addressof, sizeof
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros.core import bindings
from kinpole_ros.core.bindings import Frames, HistoryColumns, Struct, codes_of, library

BYTES = 8


@pytest.mark.parametrize('struct', Struct.__subclasses__())
def test_structs_have_no_padding(struct: type[Struct]) -> None:
    """Arrays of integers are made into some of them, field by field."""
    fields = [getattr(struct, field) for field, *_ in struct._fields_]
    assert sum(field.size for field in fields) == sizeof(struct)
    assert all(field.offset % BYTES == 0 for field in fields)


def test_a_field_takes_arrays_of_its_type_only() -> None:
    columns = HistoryColumns()
    columns.bind('angle', np.zeros(3))
    columns.bind('goes_on', np.zeros(3, bool))
    with pytest.raises(TypeError, match=r'HistoryColumns.angle has elements float64, not float32'):
        columns.bind('angle', np.zeros(3, np.float32))
    with pytest.raises(TypeError, match=r'HistoryColumns.angle needs an array that is contiguous'):
        columns.bind('angle', np.zeros((3, 2))[:, 0])


def test_a_field_keeps_its_array() -> None:
    columns = HistoryColumns()
    columns.bind('angle', np.full(1000, 7.0))
    others = [np.zeros(1000) for _ in range(100)]
    view = np.ctypeslib.as_array((np.ctypeslib.ctypes.c_double * 1000).from_address(columns.angle))
    assert (view == 7.0).all()
    assert len(others) == 100


def test_lists_of_headers_are_read() -> None:
    assert codes_of('UNUSUAL_BITS') == {'ODD': 1, 'NAME_DOUBTFUL': 2, 'NEW_MARKER': 4}
    assert codes_of('MESSAGE_DOUBLES')['ODOMETRY_DOUBLES'] == 7 + 36 + 6 + 36


def test_a_part_of_a_struct_is_in_it() -> None:
    frames = Frames()
    frames.history.end = 7
    part = frames.history
    assert part.end == 7
    assert addressof(part) == addressof(frames) + Frames.history.offset


def declared() -> dict[str, int]:
    """Functions that headers declare as API, and how many arguments each has."""
    headers = (Path(bindings.__file__).parent / 'include').glob('*.h')
    pattern = r'^API [^;(]*?(kinpole_\w+)\(([^)]*)\);'
    found = [re.findall(pattern, file.read_text(), re.MULTILINE) for file in headers]
    return {
        name: 0 if arguments == 'void' else arguments.count(',') + 1
        for one in found
        for name, arguments in one
    }


def bound() -> dict[str, int]:
    """Functions that Python has looked up, and how many arguments it passes."""
    functions = {name: it for name, it in vars(library).items() if name.startswith('kinpole_')}
    return {name: len(function.argtypes or ()) for name, function in functions.items()}


def test_functions_that_python_calls_are_declared_for_export() -> None:
    """A library of Windows has no others, and then the package cannot be imported."""
    assert bound() == declared()


@pytest.mark.skipif(sys.platform != 'linux' or not shutil.which('nm'), reason='needs nm')
def test_the_library_exports_what_python_calls() -> None:
    command = ['nm', '-D', '--defined-only', library._name]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in listed.splitlines()} == set(bound())


def test_python_calls_no_function_that_is_not_declared() -> None:
    files = Path(bindings.__file__).parents[1].rglob('*.py')
    called = {name for file in files for name in re.findall(r'library\.(\w+)', file.read_text())}
    assert called <= set(bound())
