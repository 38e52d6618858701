"""
The points of a PointCloud2, whose fields describe the layout of its own data.

A message may come from anywhere, so every size and offset is checked against the data before an
array is made.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from kinpole_ros.messages._offsets import Cloud
from kinpole_ros.messages._points import PointLayout
from kinpole_ros.messages._types import Header, MessageError, PointCloud2, PointField

_FLOATS = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}
_INTEGERS = {
    PointField.INT8: 'i1',
    PointField.UINT8: 'u1',
    PointField.INT16: 'i2',
    PointField.UINT16: 'u2',
    PointField.INT32: 'i4',
    PointField.UINT32: 'u4',
}


def cloud_layout(cloud: Cloud) -> PointLayout:
    """
    Return where the points of a cloud are in its message; z may be missing and is 0 then.

    `is_dense` is ignored, since some drivers set it wrongly. Raises MessageError when x or y is
    missing, when a field or size contradicts another, or when the data is too short.
    """
    axes = {name: _type_and_offset(cloud, name, _FLOATS) for name in 'xyz'}
    for name in 'xy':
        if axes[name] is None:
            raise MessageError(f"PointCloud2 has no field '{name}': publish x and y (and z)")
    _refuse_overlap(axes)
    height, width = _shape(cloud)
    rows, columns = np.arange(height) * cloud.row_step, np.arange(width) * cloud.point_step
    return PointLayout(
        cloud.data.start + np.add.outer(rows, columns).ravel(),
        cloud.is_bigendian,
        tuple(0 if field is None else field[1] for field in axes.values()),
        tuple(0 if field is None else int(field[0][2]) for field in axes.values()),
    )


def id_column(cloud: Cloud, message: Any) -> np.ndarray:
    """
    Return a view (height, width) of the integer field `id` in a message with such a cloud.

    Raises MessageError when there is no field `id`.
    """
    field = _type_and_offset(cloud, 'id', _INTEGERS)
    if field is None:
        raise MessageError(
            "PointCloud2 has no field 'id', so no identities but the index: "
            'set marker_identity to auto or index'
        )
    code, offset = field
    shape = _shape(cloud)
    if not shape[0]:
        return np.empty(shape, code)
    first = cloud.data.start + offset
    return np.ndarray(shape, code, message, first, (cloud.row_step, cloud.point_step))


def make_cloud(header: Header, points: np.ndarray) -> PointCloud2:
    """Make a cloud of one row of float64 x, y, z from points (n, 3)."""
    n = len(points)
    cloud = PointCloud2(header=header, height=1, width=n, point_step=24, row_step=24 * n)
    cloud.fields = [
        PointField(name=name, offset=8 * axis, datatype=PointField.FLOAT64, count=1)
        for axis, name in enumerate('xyz')
    ]
    cloud.is_dense = bool(np.isfinite(points).all())
    cloud.data = points.astype('<f8').view(np.uint8).ravel()
    return cloud


def _type_and_offset(cloud: Cloud, name: str, datatypes: dict[int, str]) -> tuple[str, int] | None:
    """Type and offset of one field, or None when the cloud has no such field."""
    fields = [field for field in cloud.fields if field.name == name]
    if not fields:
        return None
    if len(fields) > 1:
        raise MessageError(f"PointCloud2 has {len(fields)} fields '{name}': publish only one")
    field = fields[0]
    if field.datatype not in datatypes:
        kind = 'FLOAT32 (7) or FLOAT64 (8)' if datatypes is _FLOATS else 'an integer (1 to 6)'
        raise MessageError(
            f"PointCloud2 field '{name}' has datatype {field.datatype}: publish it as {kind}"
        )
    if field.number > 1:
        raise MessageError(f"PointCloud2 field '{name}' has count {field.number}: publish it as 1")
    code = datatypes[field.datatype]
    offset, step = field.offset, cloud.point_step
    if offset + int(code[1]) > step:
        raise MessageError(
            f"PointCloud2 field '{name}' at offset {offset} ends beyond point_step {step}: "
            'correct its offset or point_step'
        )
    return ('>' if cloud.is_bigendian else '<') + code, offset


def _refuse_overlap(axes: dict[str, tuple[str, int] | None]) -> None:
    """Raise MessageError where two of the fields share bytes."""
    fields = sorted((field[1], int(field[0][2]), name) for name, field in axes.items() if field)
    for (first, size, name), (second, _, next_name) in pairwise(fields):
        if second < first + size:
            raise MessageError(
                f"PointCloud2 fields '{name}' at offset {first} and '{next_name}' at {second} "
                'overlap: correct their offsets'
            )


def _shape(cloud: Cloud) -> tuple[int, int]:
    """Height and width, checked against the data that is there."""
    height, width, row_step, step = cloud.height, cloud.width, cloud.row_step, cloud.point_step
    size = cloud.data.number
    if not height * width:
        return 0, 0
    if row_step < width * step:
        raise MessageError(
            f'PointCloud2 row_step {row_step} is less than width {width} x point_step {step}: '
            'correct row_step'
        )
    if size < height * row_step:
        raise MessageError(
            f'PointCloud2 data has {size} bytes, fewer than height {height} x '
            f'row_step {row_step}: publish all rows or correct the height'
        )
    return height, width
