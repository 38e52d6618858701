"""
Messages of a header and doubles, of bodies or pairs, that compiled code writes.

A row is what rows.c needs to know of a topic. The messages of all rows, of all instants of an
estimate, are made by one call: in a node that sleeps between frames each call of numpy is dear.
"""

from collections.abc import Callable, Iterable, Sequence
from ctypes import byref, c_double, sizeof
from itertools import chain
from operator import itemgetter
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.core import bindings
from kinpole_ros.core.bindings import address_of, codes_of, library, pass_new_array
from kinpole_ros.messages._cdr import Writer
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.quantities import QUANTITIES
from kinpole_ros.tracking.values import Numbers, Vectors

# The messages of an estimate: indices of its instants, in order, and a message for each.
Built: TypeAlias = tuple[list[int], list[bytes]]
Build: TypeAlias = Callable[[Estimate], Built]
# For the frame_id and the number of bodies: a message with zeros for its stamp and its numbers, and
# how many bytes precede these numbers.
Template: TypeAlias = Callable[[str, int], tuple[bytes, int]]

# Kinds of messages, and quantities besides those that `compute_quantity` takes: see codes.h.
NORMAL, VECTOR, POINT, POSE, ODOMETRY, FRAME, STATE_POINTS = codes_of('MESSAGE_KINDS').values()
RATE, RELATIVE_RATE, RELATIVE_CENTER, _GIVEN = (
    QUANTITIES[name] for name in ('RATE', 'RELATIVE_RATE', 'RELATIVE_CENTER', 'GIVEN')
)
_SIZES = codes_of('MESSAGE_DOUBLES')
_DOUBLES = dict.fromkeys((NORMAL, VECTOR, POINT), _SIZES['VECTOR_DOUBLES']) | {
    POSE: _SIZES['POSE_DOUBLES'],
    ODOMETRY: _SIZES['ODOMETRY_DOUBLES'],
    FRAME: _SIZES['FRAME_DOUBLES'],
}
# Rows are filled as integers, all of their fields at once.
_ROW_FIELDS = len(bindings.Row._fields_)
_ADDED_FIELD = _ROW_FIELDS - 1
_GIVEN_FIELDS = slice(_ADDED_FIELD - 3, _ADDED_FIELD)
_PLANE_NUMBERS = sizeof(bindings.Plane) // sizeof(c_double)

_UNMEASURED = 1e6  # m², rad², ...: a variance that a planar measurement says nothing about
# The same in a plane oblique to the axes of the frame, where it adds to all cells of the matrix and
# must not round away what is measured: standard deviations down to 1e-7 m are kept.
_UNMEASURED_OBLIQUE = 1e2


class Row(NamedTuple):
    """
    The messages of one quantity: of `body`, or of the body `other` with respect to it.

    `order` is the highest derivative it needs. `values` returns the quantity (T,), or (T, 1), where
    no compiled code computes it. `added` returns what a `state` has of each body besides, (T, B,
    `added_count`).
    """

    kind: int
    quantity: int
    template: Template
    order: int
    body: int = 0
    other: int = 0
    is_deviation: bool = False
    values: Callable[[Estimate], Numbers | Vectors] | None = None
    added: Callable[[Estimate], np.ndarray] | None = None
    added_count: int = 0


class Rows:
    """Makes the messages of rows; `given` is the plane of estimates that have none."""

    def __init__(self, rows: Sequence[Row], given: Plane) -> None:
        self.rows, self.given = rows, given
        self._order = max((row.order for row in rows), default=0)
        self._given_rows = [(k, row.values) for k, row in enumerate(rows) if row.values]
        self._added_rows = [(k, row.added) for k, row in enumerate(rows) if row.added]
        self._fields = np.zeros((len(rows), _ROW_FIELDS), np.int64)
        self._space = np.empty(_PLANE_NUMBERS)
        # What the fields are made for, and the slices of a single instant.
        self._plane: Plane | None = None
        self._layout: tuple[str, int] | None = None
        self._slices: list[slice] = []

    def __call__(self, estimate: Estimate) -> Built:
        """Return the messages of an estimate in the order of its instants."""
        data, made = self._write(estimate)
        if len(self.rows) == 1:
            return self._messages_of(0, data, made)
        by_row = (zip(*self._messages_of(k, data, made), strict=True) for k in range(len(made)))
        messages = sorted(chain.from_iterable(by_row), key=itemgetter(0))
        return [instant for instant, _ in messages], [one for _, one in messages]

    def messages(self, estimate: Estimate) -> list[tuple[int, bytes]]:
        """Return the messages of an estimate with their rows, row by row."""
        if not self.rows:
            return []
        data, made = self._write(estimate)
        if made.shape[1] == 1:
            parts = enumerate(zip(self._slices, made.tobytes(), strict=True))
            return [(k, data[part]) for k, (part, is_made) in parts if is_made]
        rows = range(len(made))
        return [(k, one) for k in rows for one in self._messages_of(k, data, made)[1]]

    def _messages_of(self, k: int, data: bytes, made: np.ndarray) -> Built:
        """Return the messages of a row from what `_write` returned."""
        count, part = made.shape[1], self._slices[k]
        first, end, size = part.start * count, part.stop * count, part.stop - part.start
        instants = made[k].nonzero()[0]
        starts: Iterable[int] = range(first, end, size)
        if len(instants) < count:
            starts = (first + size * instants).tolist()
        return instants.tolist(), [data[start : start + size] for start in starts]

    def _write(self, estimate: Estimate) -> tuple[bytes, np.ndarray]:
        """Return the bytes of all rows, of all instants of each; which (rows, T) are messages."""
        motion = estimate.compiled_motion
        instants, bodies = motion.shape
        self._bind(estimate, bodies)
        # Keeps the arrays alive while the library uses them.
        arrays = [self._pass_values(k, values(estimate)) for k, values in self._given_rows]
        arrays += [self._pass_added(k, added(estimate)) for k, added in self._added_rows]
        if motion.orders <= self._order:
            raise ValueError(f'expected derivatives up to order {self._order}')
        out = np.empty(self._size * instants, np.uint8)
        made = np.empty((len(self.rows), instants), np.uint8)
        given = pass_new_array(self._space), pass_new_array(self._fields)
        into = pass_new_array(out), pass_new_array(made)
        library.kinpole_write_rows(byref(motion), bodies, *given, len(self.rows), *into)
        del arrays
        return out.tobytes(), made

    def _bind(self, estimate: Estimate, bodies: int) -> None:
        """Update the fields for another plane, frame_id or number of bodies."""
        plane = estimate.plane or self.given
        if plane is not self._plane:
            self._plane = plane
            self._space[:9] = plane.basis.ravel()
            self._space[9] = _UNMEASURED if plane.axes else _UNMEASURED_OBLIQUE
        layout = estimate.frame_id, bodies
        if layout == self._layout:
            return
        if any(max(row.body, row.other) >= bodies for row in self.rows):
            raise ValueError(f'expected an estimate of all bodies, got {bodies}')
        templates = [row.template(*layout) for row in self.rows]
        self._templates = np.frombuffer(b''.join(data for data, _ in templates), np.uint8)
        start, address = 0, address_of(self._templates)
        self._slices = []
        for fields, row, (data, head) in zip(self._fields, self.rows, templates, strict=True):
            quantity = _GIVEN if row.values else row.quantity
            about = row.kind, quantity, row.order, row.body, row.other, row.is_deviation
            fields[: len(about) + 4] = *about, row.added_count, head, len(data), address + start
            self._slices.append(slice(start, start + len(data)))
            start += len(data)
        self._size, self._layout = start, layout

    def _pass_values(self, k: int, values: Numbers | Vectors) -> list[np.ndarray]:
        """Pass the quantity of a row, and return the arrays that the row refers to."""
        value, spread, determined = (np.asarray(array) for array in values)
        if isinstance(values, Numbers):
            spread = spread[:, None] * np.ones(4)
        arrays = [
            np.array(array, kind, order='C')
            for array, kind in ((value, complex), (spread, float), (determined, np.uint8))
        ]
        self._fields[k, _GIVEN_FIELDS] = [address_of(array) for array in arrays]
        return arrays

    def _pass_added(self, k: int, added: np.ndarray) -> list[np.ndarray]:
        self._fields[k, _ADDED_FIELD] = address_of(added)
        return [added]


def stamped(kind: int, child: str | None = None, before: int = 0, after: int = 0) -> Template:
    """
    Return the template of messages of a header and doubles.

    `child` is the second string of messages that have one, the child_frame_id of Odometry. So many
    doubles before and after those of the row are 0.
    """

    def template(frame_id: str, _: int) -> tuple[bytes, int]:
        writer = Writer()
        if kind == FRAME:
            # A TFMessage is a list, of this one item.
            writer.pack('I', 1)
        writer.header(0, frame_id)
        if child is not None:
            writer.string(child)
        writer.align(8)
        head = len(writer.data) + 8 * before
        return bytes(writer.data) + bytes(8 * (before + _DOUBLES[kind] + after)), head

    return template
