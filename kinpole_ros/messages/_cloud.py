"""
The points of a PointCloud2, whose fields describe the layout of its own data.

A message may come from anywhere, so every size and offset is checked against the data before an
array is made.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.messages._types import Header, MessageError, PointCloud2, PointField, octets

_FLOATS = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}
_INTEGERS = {
    PointField.INT8: 'i1',
    PointField.UINT8: 'u1',
    PointField.INT16: 'i2',
    PointField.UINT16: 'u2',
    PointField.INT32: 'i4',
    PointField.UINT32: 'u4',
}


class CloudLayout(NamedTuple):
    """
    The layout of x, y and z in the data of clouds.

    `shape` is height and width, `strides` the bytes from row to row and point to point; `axes` the
    type and offset of each coordinate, None for no z; `spacing` the bytes from one coordinate to
    the next where all distances are equal, else 0.
    """

    shape: tuple[int, int]
    strides: tuple[int, int]
    axes: tuple[tuple[str, int] | None, ...]
    spacing: int

    def points(self, data: Any, first: int = 0, count: int = 1, stride: int = 0) -> np.ndarray:
        """
        Copy the points (count, n, 3) of `count` clouds, row after row.

        In the buffer `data` the first cloud begins at `first`, the next one `stride` bytes later.
        """
        shape, strides = (count, *self.shape), (stride, *self.strides)
        if not self.shape[0]:
            return np.zeros((count, 0, 3))
        if self.spacing:
            assert self.axes[0] is not None
            code, offset = self.axes[0]
            steps = (*strides, self.spacing)
            view = np.ndarray((*shape, 3), code, data, first + offset, steps)
            if code.endswith('8'):
                return view.astype(np.float64).reshape(count, -1, 3)
            # A signaling NaN in the data is an unseen marker, not worth a warning.
            with np.errstate(invalid='ignore'):
                return view.astype(np.float64).reshape(count, -1, 3)
        points = np.zeros((*shape, 3))
        with np.errstate(invalid='ignore'):
            for axis, field in enumerate(self.axes):
                if field is not None:
                    code, offset = field
                    points[..., axis] = np.ndarray(shape, code, data, first + offset, strides)
        return points.reshape(count, -1, 3)


def cloud_layout(cloud: PointCloud2) -> CloudLayout:
    """
    Return the layout of the points of a cloud; z may be missing and is 0 then.

    `is_dense` is ignored, since some drivers set it wrongly. Raises MessageError when x or y is
    missing, when a field or size contradicts another, or when the data is too short.
    """
    x, y, z = (_type_and_offset(cloud, name, _FLOATS) for name in 'xyz')
    if x is None or y is None:
        missing = 'x' if x is None else 'y'
        raise MessageError(f"PointCloud2 has no field '{missing}': publish x and y (and z)")
    _refuse_overlap({'x': x, 'y': y, 'z': z})
    spacing = y[1] - x[1]
    if spacing <= 0 or y != (x[0], x[1] + spacing) or z != (x[0], y[1] + spacing):
        spacing = 0
    return CloudLayout(_shape(cloud), (cloud.row_step, cloud.point_step), (x, y, z), spacing)


def id_column(cloud: PointCloud2, data: Any, first: int = 0) -> np.ndarray:
    """
    Return a view (height, width) of the integer field `id` in the data of a cloud like this one.

    The data begins at `first` in the buffer `data`. Raises MessageError when there is no field
    `id`.
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
    return np.ndarray(shape, code, data, first + offset, (cloud.row_step, cloud.point_step))


def cloud_ids(cloud: PointCloud2) -> tuple[str, ...]:
    """The integers of the field `id`, row after row, as strings; MessageError without one."""
    return tuple(map(str, id_column(cloud, cloud.data).ravel().tolist()))


def make_cloud(header: Header, points: np.ndarray) -> PointCloud2:
    """Make a cloud of one row of float64 x, y, z from points (n, 3)."""
    n = len(points)
    cloud = PointCloud2(header=header, height=1, width=n, point_step=24, row_step=24 * n)
    cloud.fields = [
        PointField(name=name, offset=8 * axis, datatype=PointField.FLOAT64, count=1)
        for axis, name in enumerate('xyz')
    ]
    cloud.is_dense = bool(np.isfinite(points).all())
    cloud.data = octets(points.astype('<f8').tobytes())
    return cloud


def _type_and_offset(
    cloud: PointCloud2, name: str, datatypes: dict[int, str]
) -> tuple[str, int] | None:
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
    if field.count > 1:
        raise MessageError(f"PointCloud2 field '{name}' has count {field.count}: publish it as 1")
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


def _shape(cloud: PointCloud2) -> tuple[int, int]:
    """Height and width, checked against the data that is there."""
    height, width, row_step, data = cloud.height, cloud.width, cloud.row_step, cloud.data
    step = cloud.point_step
    if not height * width:
        return 0, 0
    if row_step < width * step:
        raise MessageError(
            f'PointCloud2 row_step {row_step} is less than width {width} x point_step {step}: '
            'correct row_step'
        )
    if len(data) < height * row_step:
        raise MessageError(
            f'PointCloud2 data has {len(data)} bytes, fewer than height {height} x '
            f'row_step {row_step}: publish all rows or correct the height'
        )
    return height, width
