"""PointCloud2 describes its own bytes: read any layout it allows, and none that leads astray.

A message comes from anywhere, so every size and offset is checked against the data that is there
before an array is made.
"""

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

_FLOATS = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}
_INTEGERS = {
    PointField.INT8: 'i1',
    PointField.UINT8: 'u1',
    PointField.INT16: 'i2',
    PointField.UINT16: 'u2',
    PointField.INT32: 'i4',
    PointField.UINT32: 'u4',
}


class MessageError(ValueError):
    """A message that cannot be read; the text names the field and says how to mend it."""


def cloud_points(cloud: PointCloud2) -> np.ndarray:
    """Positions in a cloud, row after row, as a new float64 array (n, 3), in m; no z reads as 0.

    `is_dense` is not looked at, since some drivers set it wrongly. Raises MessageError when x or y
    is missing, when a field or size contradicts another, or when the data is too short.
    """
    x, y, z = (_column(cloud, name, _FLOATS) for name in 'xyz')
    if x is None or y is None:
        missing = 'x' if x is None else 'y'
        raise MessageError(f"PointCloud2 has no field '{missing}': publish x and y (and z)")
    points = np.zeros((*x.shape, 3))
    # A signaling NaN in the data is a marker not seen, not worth a warning.
    with np.errstate(invalid='ignore'):
        points[..., 0] = x
        points[..., 1] = y
        if z is not None:
            points[..., 2] = z
    return points.reshape(-1, 3)


def cloud_ids(cloud: PointCloud2) -> tuple[str, ...]:
    """Integers of the field `id`, row after row, as strings. Raises MessageError without it."""
    column = _column(cloud, 'id', _INTEGERS)
    if column is None:
        raise MessageError(
            "PointCloud2 has no field 'id', so no identities but the index: "
            'set marker_identity to auto or index'
        )
    return tuple(map(str, column.ravel().tolist()))


def make_cloud(header: Header, points: np.ndarray) -> PointCloud2:
    """One row of float64 x, y, z from points (n, 3), `is_dense` true when all are finite."""
    n = len(points)
    cloud = PointCloud2(header=header, height=1, width=n, point_step=24, row_step=24 * n)
    cloud.fields = [
        PointField(name=name, offset=8 * axis, datatype=PointField.FLOAT64, count=1)
        for axis, name in enumerate('xyz')
    ]
    cloud.is_dense = bool(np.isfinite(points).all())
    cloud.data.frombytes(points.astype('<f8').tobytes())
    return cloud


def _column(cloud: PointCloud2, name: str, datatypes: dict[int, str]) -> np.ndarray | None:
    """View of one field, (height, width), or None when the cloud has no such field."""
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
    height, width, row_step, data = cloud.height, cloud.width, cloud.row_step, cloud.data
    if not height * width:
        return np.empty((0, 0))
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
    order = '>' if cloud.is_bigendian else '<'
    return np.ndarray((height, width), order + code, data, offset, (row_step, step))
