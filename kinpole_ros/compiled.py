"""The compiled library of the package, C that needs no headers of Python, and arrays for it."""

import ctypes
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np

_FILE = Path(__file__).with_name(f'_compiled{sysconfig.get_config_var("EXT_SUFFIX")}')
_Bytes = ctypes.c_char * 0
# An argument of type c_void_p that points to a new array, in half the time of `address_of`.
pass_new_array = _Bytes.from_buffer


def _load() -> ctypes.CDLL:
    """Load the library that setup.py builds."""
    if not _FILE.exists():
        raise ImportError(
            f'{_FILE} is not there: build it with `pip install --editable .` in the source folder'
        )
    return ctypes.CDLL(str(_FILE))


library = _load()


def address_of(array: np.ndarray) -> int:
    """Return where the elements of an array begin: a quarter of the time of `array.ctypes.data`."""
    if array.flags.writeable:
        return ctypes.addressof(_Bytes.from_buffer(array))
    return array.ctypes.data


def pass_array(array: np.ndarray | None, dtype: Any = float) -> Any:
    """
    Return an argument of a function of `library` that points to the elements of an array.

    An array of another type, layout, or that is read-only is copied.
    """
    if array is None:
        return None
    array = np.ascontiguousarray(array, dtype)
    return _Bytes.from_buffer(array if array.flags.writeable else array.copy())


def _listed(symbol: str) -> list[tuple[str, str]]:
    """Return the names and values of a list that C exports as text, `name=value;` for each."""
    text = ctypes.c_char_p.in_dll(library, symbol).value
    assert text is not None
    pairs = (entry.split('=') for entry in text.decode().split(';') if entry)
    return [(name, value) for name, value in pairs]


def codes_of(symbol: str) -> dict[str, int]:
    """Return the numbers of an enum of C by their names."""
    return {name: int(value) for name, value in _listed(symbol)}


def names_of(symbol: str) -> tuple[str, ...]:
    """Return the names of some fields of a struct of C."""
    return tuple(name for name, _ in _listed(symbol))


def structure_of(symbol: str) -> type[ctypes.Structure]:
    """Return a struct of C, whose pointers take addresses."""
    kinds = {'long long': ctypes.c_longlong, 'double': ctypes.c_double}
    fields = [(name, kinds.get(kind, ctypes.c_void_p)) for name, kind in _listed(symbol)]
    assert all('*' in kind or kind in kinds for _, kind in _listed(symbol))
    return type(symbol, (ctypes.Structure,), {'_fields_': fields})
