"""
The compiled library: its functions, and its structs as classes of ctypes.

The library describes its structs and enums itself (core/src/structs.c), so their fields and codes
are listed in its headers alone. A field that is an array knows the type of its elements, and takes
no others.
"""

import ctypes
from collections.abc import Mapping
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

_FILE = Path(__file__).parents[1] / f'_compiled{EXTENSION_SUFFIXES[0]}'
_Bytes = ctypes.c_char * 0
# An argument of type c_void_p that points to a new array, in half the time of `address_of`.
pass_new_array = _Bytes.from_buffer
# By the types of C: those of ctypes, and of the elements of arrays.
_VALUES: dict[str, Any] = {
    'long long': ctypes.c_longlong,
    'double': ctypes.c_double,
    'Axis': 3 * ctypes.c_double,
}
_ELEMENTS = {
    'long long': np.dtype(np.int64),
    'double': np.dtype(float),
    'Number': np.dtype(complex),
    'unsigned char': np.dtype(np.uint8),
    'Flag': np.dtype(bool),
    'Workspace': np.dtype(np.void),
}
_IS_VALUE, _IS_ARRAY = 0, -1


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


class Struct(ctypes.Structure):
    """
    A struct of the library.

    Attributes
    ----------
    elements : mapping of str to dtype
        The fields that are arrays, in their order, and the type of their elements.
    shapes : mapping of str to tuple of str
        Their shapes, of numbers and of symbols that the headers explain.
    meanings : mapping of str to str
        What each field is, after its unit.

    """

    elements: ClassVar[Mapping[str, np.dtype]]
    shapes: ClassVar[Mapping[str, tuple[str, ...]]]
    meanings: ClassVar[Mapping[str, str]]
    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    @classmethod
    def shapes_for(cls, **sizes: int) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the fields that are arrays, for the sizes of their symbols."""

        def size_of(text: str) -> int:
            return sum(int(part) if part.isdigit() else sizes[part] for part in text.split(' + '))

        return {name: tuple(map(size_of, shape)) for name, shape in cls.shapes.items()}

    @classmethod
    def new_arrays(cls, **sizes: int) -> dict[str, np.ndarray]:
        """Return arrays of zeros for all fields that are arrays, by their names."""
        shapes = cls.shapes_for(**sizes).items()
        return {name: np.zeros(shape, cls.elements[name]) for name, shape in shapes}

    def bind(self, name: str, array: np.ndarray | None) -> None:
        """
        Let a field point to the elements of an array, which the struct keeps alive.

        Raises
        ------
        TypeError
            If the elements are of another type, or not one after the other.

        """
        if array is None:
            setattr(self, name, None)
            return
        element, flags = self.elements[name], array.flags
        if array.dtype is not element and array.dtype != element:
            raise TypeError(
                f'{type(self).__name__}.{name} has elements {element}, not {array.dtype}'
            )
        if not flags.c_contiguous:
            raise TypeError(f'{type(self).__name__}.{name} needs an array that is contiguous')
        setattr(self, name, address_of(array))
        # A field of ctypes goes before an attribute of this name, which keeps the array alive.
        self.__dict__[name] = array


def _record(**fields: Any) -> type[ctypes.Structure]:
    """Return the class of a struct of structs.h that describes others, with fields in its order."""
    return type('_Record', (ctypes.Structure,), {'_fields_': [*fields.items()]})


_TEXT, _NUMBER = ctypes.c_char_p, ctypes.c_longlong
_Field = _record(name=_TEXT, type=_TEXT, shape=_TEXT, meaning=_TEXT, count=_NUMBER, offset=_NUMBER)
_Description = _record(name=_TEXT, size=_NUMBER, count=_NUMBER, fields=ctypes.POINTER(_Field))
_Code = _record(name=_TEXT, value=_NUMBER)
_Codes = _record(name=_TEXT, count=_NUMBER, codes=ctypes.POINTER(_Code))


class Table(Struct):
    """What _models.py makes for a kind of window: see call.h."""


class DerivativeArrays(Struct):
    """Derivatives of poses: see call.h."""


class Call(Struct):
    """The arguments of `kinpole_derive`, and the memory it works in: see call.h."""

    def __del__(self, free: Any = library.kinpole_free_workspace) -> None:
        free(ctypes.byref(self))


class FrameLimits(Struct):
    """Lengths and limits that do not change: see frames.h."""


class HistoryColumns(Struct):
    """The columns of the history, and which rows are in use: see frames.h."""


class BodyArrays(Struct):
    """What is known of the bodies: see frames.h."""


class Gaps(Struct):
    """Times without a body: see frames.h."""


class BodyTracks(Struct):
    """What only the library writes of the bodies: see frames.h."""


class NewFrames(Struct):
    """Frames to be taken: see frames.h."""


class Frames(Struct):
    """Limits, history, bodies, their tracks, and new frames: see frames.h."""


class Results(Struct):
    """The results of some instants: see frames.h."""


class Motion(Struct):
    """Derivatives of bodies at instants: see motion.h."""


class Slots(Struct):
    """Which rows of messages the slots of markers take: see messages.h."""


class MessageLayout(Struct):
    """Where stamps and points are in messages: see messages.h."""


class Row(Struct):
    """The messages of a topic: see messages.h."""


class Plane(Struct):
    """The plane of the motion in space: see messages.h."""


class Joints(Struct):
    """The joints of joint states: see messages.h."""


class ChangePoint(Struct):
    """An event: see change_points.h."""


def _add_fields(struct: type[Struct], description: Any) -> None:
    """Give a class the fields of its struct, and check it against the compiler's layout."""
    fields: list[tuple[str, Any]] = []
    offsets: dict[str, int] = {}
    elements: dict[str, np.dtype] = {}
    shapes: dict[str, tuple[str, ...]] = {}
    meanings: dict[str, str] = {}
    for field in description.fields[: description.count]:
        name, type_name = field.name.decode(), field.type.decode().removeprefix('const ')
        offsets[name], meanings[name] = field.offset, field.meaning.decode()
        if field.count == _IS_ARRAY:
            elements[name] = _ELEMENTS.get(type_name) or np.dtype(_VALUES[type_name])
            shapes[name] = tuple(field.shape.decode().strip('()').split(', '))
            fields.append((name, ctypes.c_void_p))
        else:
            value = _VALUES[type_name]
            fields.append((name, value if field.count == _IS_VALUE else field.count * value))
    struct._fields_, struct.elements = fields, MappingProxyType(elements)
    struct.shapes, struct.meanings = MappingProxyType(shapes), MappingProxyType(meanings)
    found = {name: getattr(struct, name).offset for name in offsets}
    if found != offsets or ctypes.sizeof(struct) != description.size:
        raise ImportError(f'{_FILE} has a layout of {struct.__name__} that is not that of ctypes')
    _VALUES[struct.__name__] = struct


def _read_list(function: str, kind: type[ctypes.Structure]) -> dict[str, Any]:
    """Return the descriptions in a list of the library, by their names."""
    read = getattr(library, function)
    read.restype = ctypes.POINTER(kind)
    found, number, entries = {}, 0, read()
    while entries[number].name:
        found[entries[number].name.decode()] = entries[number]
        number += 1
    return found


def _read_structs() -> None:
    """Give all classes of structs the fields that the library describes."""
    classes = {struct.__name__: struct for struct in Struct.__subclasses__()}
    for name, description in _read_list('kinpole_structs', _Description).items():
        _add_fields(classes.pop(name), description)
    if classes:
        raise ImportError(f'{_FILE} has no {", ".join(classes)}: build it again')


def codes_of(enum: str) -> dict[str, int]:
    """Return the codes of an enum of a header by their names, as `REASONS` of codes.h."""
    listed = _CODES[enum]
    return {code.name.decode(): code.value for code in listed.codes[: listed.count]}


# A function of Python that C calls: it makes the table that its argument points to.
TableMaker = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(Table))
_VALUES['TableMaker'] = TableMaker
_read_structs()
_CODES = _read_list('kinpole_codes', _Codes)
# Sizes of arrays that C and Python share: see codes.h.
SIZES = codes_of('SIZES')

_pointer = ctypes.POINTER
_POINT = _pointer(ChangePoint)
_ARRAY, _DATA = ctypes.c_void_p, ctypes.c_char_p
# What the functions of the headers return, and their arguments. Structs that are rows of an array,
# or in one, are passed as arrays: `Results`, `Plane` and `Row`.
_PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    'derive': (ctypes.c_int, [_pointer(Call)]),
    'free_workspace': (None, [_pointer(Call)]),
    'try_frame': (ctypes.c_int, [_pointer(Frames), _ARRAY]),
    'follow': (ctypes.c_int, [_pointer(Frames), _pointer(Call), _ARRAY]),
    'find_event': (ctypes.c_int, [*2 * [_ARRAY], *2 * [_NUMBER], *2 * [ctypes.c_double], _POINT]),
    'assign': (_NUMBER, [_pointer(Slots), _ARRAY, _NUMBER, *3 * [_ARRAY]]),
    'origins': (None, [_pointer(Motion), _ARRAY]),
    'quantities': (None, [ctypes.c_int, _pointer(Motion), *4 * [_ARRAY]]),
    'relative_centers': (None, [_pointer(Motion), _NUMBER, _ARRAY, _NUMBER, *3 * [_ARRAY]]),
    'count_matches': (_NUMBER, [_pointer(MessageLayout), _DATA, _NUMBER, _NUMBER]),
    'read_messages': (None, [_pointer(MessageLayout), _DATA, _NUMBER, _NUMBER, _ARRAY, _ARRAY]),
    'write_rows': (None, [_pointer(Motion), _NUMBER, _ARRAY, _ARRAY, _NUMBER, _ARRAY, _ARRAY]),
    'write_joints': (
        None,
        [_pointer(Motion), _pointer(Joints), _ARRAY, _ARRAY, _NUMBER, _ARRAY, _ARRAY],
    ),
}


for _name, (_result, _arguments) in _PROTOTYPES.items():
    _function = getattr(library, f'kinpole_{_name}')
    _function.restype, _function.argtypes = _result, _arguments
