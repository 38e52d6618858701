"""
Stand-ins for message types whose packages are not on the package index.

A generated package needs a compiler and the generators of ROS. A stand-in has the compiled type
support of sensor_msgs/msg/PointCloud2 under another name. Bytes are all that is published and
taken, so the type of the fields does not matter: DDS compares names of types alone.
"""

import ctypes
from typing import Any

from rclpy.type_support import check_for_type_support
from sensor_msgs.msg import PointCloud2

_POINTERS = 6  # in a rosidl_message_type_support_t
_CALLBACK_POINTERS = 9  # at most in a message_type_support_callbacks_t: 2 are the names
_IDENTIFIER = b'rosidl_typesupport_fastrtps_c'
_RESOLVE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_KEPT: list[Any] = []  # memory that the middleware points to, for the life of the process


def stand_in(type_name: str) -> Any:
    """Return a class that rclpy publishes and subscribes to under this name, as bytes."""
    package, folder, short = type_name.split('/')
    check_for_type_support(PointCloud2)
    python = ctypes.pythonapi
    python.PyCapsule_GetPointer.restype = ctypes.c_void_p
    python.PyCapsule_GetPointer.argtypes = ctypes.py_object, ctypes.c_char_p
    python.PyCapsule_New.restype = ctypes.py_object
    python.PyCapsule_New.argtypes = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
    own = type(PointCloud2)
    dispatch = python.PyCapsule_GetPointer(own._TYPE_SUPPORT, None)
    table = ctypes.c_void_p * _POINTERS
    of_dispatch = table.from_address(dispatch)
    resolve = _RESOLVE(of_dispatch[2])
    handle = table.from_address(resolve(dispatch, _IDENTIFIER))
    callbacks = ctypes.c_void_p * _CALLBACK_POINTERS
    texts = [ctypes.create_string_buffer(text.encode()) for text in (f'{package}::{folder}', short)]
    renamed = callbacks(*callbacks.from_address(handle[1]))
    renamed[0], renamed[1] = map(ctypes.addressof, texts)
    made = table(*handle)
    made[1] = ctypes.addressof(renamed)

    @_RESOLVE
    def find(_: int, identifier: bytes) -> int | None:
        own_address = ctypes.addressof(made)
        return own_address if identifier == _IDENTIFIER else resolve(dispatch, identifier)

    made[2] = ctypes.cast(find, ctypes.c_void_p).value
    _KEPT.extend((texts, renamed, made, find))
    capsule = python.PyCapsule_New(ctypes.addressof(made), None, None)
    names = '_CREATE_ROS_MESSAGE', '_CONVERT_FROM_PY', '_CONVERT_TO_PY', '_DESTROY_ROS_MESSAGE'
    values = {name: getattr(own, name) for name in names}
    kind = type(f'Metaclass_{short}', (type,), {**values, '_TYPE_SUPPORT': capsule})
    module = f'{package}.{folder}'
    return kind(short, (), {'__module__': f'{module}._{short.lower()}'})
