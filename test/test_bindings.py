"""Structs of the library: as the compiler lays them out, and filled with arrays of their types."""

from ctypes import sizeof

import numpy as np
import pytest

from kinpole_ros.core.bindings import Frames, Struct, codes_of, fields_of

BYTES = 8


@pytest.mark.parametrize('struct', Struct.__subclasses__())
def test_structs_have_no_padding(struct: type[Struct]) -> None:
    """Arrays of integers are made into some of them, field by field."""
    fields = [getattr(struct, field) for field, *_ in struct._fields_]
    assert sum(field.size for field in fields) == sizeof(struct)
    assert all(field.offset % BYTES == 0 for field in fields)


def test_a_field_takes_arrays_of_its_type_only() -> None:
    frames = Frames()
    frames.bind('angle', np.zeros(3))
    frames.bind('goes_on', np.zeros(3, bool))
    with pytest.raises(TypeError, match=r'Frames.angle has elements float64, not float32'):
        frames.bind('angle', np.zeros(3, np.float32))
    with pytest.raises(TypeError, match=r'Frames.angle needs an array that is contiguous'):
        frames.bind('angle', np.zeros((3, 2))[:, 0])


def test_a_field_keeps_its_array() -> None:
    frames = Frames()
    frames.bind('angle', np.full(1000, 7.0))
    others = [np.zeros(1000) for _ in range(100)]
    view = np.ctypeslib.as_array((np.ctypeslib.ctypes.c_double * 1000).from_address(frames.angle))
    assert (view == 7.0).all()
    assert len(others) == 100


def test_lists_of_headers_are_read() -> None:
    assert codes_of('UNUSUAL_BITS') == {'ODD': 1, 'NAME_DOUBTFUL': 2, 'NEW_MARKER': 4}
    lists = 'BODY_ARRAYS', 'TRACKING_STATE', 'NEW_FRAMES'
    arrays = [name for part in lists for name in fields_of(part)]
    assert len(set(arrays)) == len(arrays)
    assert set(arrays) < set(Frames.elements)
