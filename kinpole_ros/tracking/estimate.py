"""
The estimated motion of all bodies at some instants.

An estimate holds poses with their derivatives and covariances. Rates, poles and centrodes are
computed from them when they are first asked for. A quantity that does not exceed its noise is
undetermined, for a reason that is named.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes import addressof
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from kinpole_ros import planar
from kinpole_ros.core.bindings import Motion, pass_new_array
from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.tracking.events import BodyEvent
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.quantities import (
    CIRCLE_CENTER,
    CIRCLE_DIAMETER,
    CURVATURE,
    DETERMINED,
    FREE,
    MOVES,
    VELOCITY,
    ball_of_motion,
    compute_origins,
    compute_quantity,
    motion_of,
    relative_centers,
    withheld_quantities,
)
from kinpole_ros.tracking.reasons import (
    KNOWN,
    REASONS,
    SIGNIFICANT,
    reasons_of_poses,
    stands_out,
    texts_of,
)
from kinpole_ros.tracking.result_layout import FILLED, INSTANT_AXIS, ArrayPart, layout_of
from kinpole_ros.tracking.values import (
    POLE_NAMES,
    RATE_NAMES,
    FramePoses,
    Numbers,
    Vectors,
    pair_indices,
    quantity_names,
)

_Arrays = TypeVar('_Arrays', bound=Vectors | Numbers | FramePoses)
_Computed = TypeVar('_Computed')


class Results(NamedTuple):
    """
    The results of up to so many instants, of bodies with some markers, as follow.c fills them.

    Attributes
    ----------
    fields : (n,) int64
        Those of `Results` of frames.h: the number of instants that there is memory for, how many
        have results, the fewest samples of a window, how many results are of deformed bodies, and
        where the arrays begin.
    layout : dict of str to Part
        Where each array is in the buffer.
    buffer : ndarray
        All arrays, from `address` on.
    of_motion : (m,) int64
        Where the arrays of `Motion` are in the buffer.
    instants, orders, bodies : int
        Sizes of the arrays.

    """

    fields: np.ndarray
    layout: dict[str, ArrayPart]
    buffer: np.ndarray
    address: int
    of_motion: np.ndarray
    instants: int
    orders: int
    bodies: int

    @property
    def filled(self) -> int:
        """How many instants have results."""
        return int(self.fields[FILLED])

    def array(self, name: str) -> np.ndarray:
        """Return an array, of all instants that there is memory for."""
        shape, dtype, offset = self.layout[name]
        return np.ndarray(shape, dtype, self.buffer, offset)

    def column(self, name: str) -> np.ndarray:
        """Return an array, of the instants that have results."""
        array, count = self.array(name), self.filled
        if count == self.instants:
            return array
        return array[(slice(None),) * INSTANT_AXIS.get(name, 0) + (slice(count),)]

    def motion(self) -> Motion:
        """Return the motion of the instants that have results."""
        count = self.filled
        numbers = count * self.bodies, self.instants * self.bodies, self.orders
        fields = np.empty(len(numbers) + len(self.of_motion), np.int64)
        fields[: len(numbers)] = numbers
        np.add(self.of_motion, self.address, out=fields[len(numbers) :])
        motion = Motion.from_buffer(fields)
        motion.shape, motion.owners = (count, self.bodies), [self.buffer]
        return motion


def new_results(instants: int, orders: int, bodies: int, markers: int) -> Results:
    """Return memory for the results of so many instants, with derivatives of so many `orders`."""
    layout, offsets, of_motion, size = layout_of(instants, orders, bodies, markers)
    numbers = instants, 0, FEWEST_SAMPLES, 0
    fields = np.empty(len(numbers) + len(offsets), np.int64)
    fields[: len(numbers)] = numbers
    buffer = np.empty(size, np.uint8)
    address = addressof(pass_new_array(buffer))
    np.add(offsets, address, out=fields[len(numbers) :])
    return Results(fields, layout, buffer, address, of_motion, instants, orders, bodies)


def _column(name: str) -> Any:
    """Return an array of an estimate, fetched when it is first asked for."""

    def fetch(estimate: 'Estimate') -> np.ndarray:
        return estimate._column(name)

    return cached_property(fetch)


class Estimate:
    """
    Motion of B bodies at T instants, in the plane of the frame `frame_id`.

    An index gives one instant as an estimate of its own, in which all arrays lack the axis of T.
    What is computed from these arrays has the shape (T, B) too, and (T, pairs) for pairs of bodies.

    Attributes
    ----------
    stamp : (T,) int64
        The instants, ns.
    angle : (order + 1, T, B) float
        Angles of the bodies' frames and their derivatives, rad/s^order.
    position : (order + 1, T, B) complex
        A point of each body and its derivatives, m/s^order.
    reference : (T, B) complex
        That point in the frame of the body, m: see `origin`.
    angle_covariance, position_covariance : (order + 1, order + 1, T, B) float
        Covariances between the orders, of one axis.
    size, height : (T, B) float
        Diameter of each body, and the height of its markers along the normal, m.
    span, degree : (T, B) float
        How long the samples of the angular velocity take, s, and by how many parameters less one
        they are described.
    reason : (T, B) uint8
        The code of why nothing is known of a body, KNOWN if it is known: see reasons.py. Its
        arrays are NaN.
    pin, pin_variance : (T, B)
        The fixed point a body was found to turn about, complex, m, and the variance of one of its
        coordinates, m^2. NaN for a body on no pin.
    shape : (T, B, n) complex
        The markers in the frames of the bodies, m.
    due : (T,) int64
        The frame, of those given to the tracker in one call, with which each instant fell due.
    run : int
        Another number each time a tracker starts anew, with other frames of the bodies.
    plane : Plane or None
        Where all this lies in `frame_id`; None for the plane that the parameters name.
    events : tuple of BodyEvent
        Events that were found with these instants: see `instants_of_events`.

    """

    stamp: np.ndarray = _column('stamp')
    angle: np.ndarray = _column('angle')
    position: np.ndarray = _column('position')
    reference: np.ndarray = _column('reference')
    angle_covariance: np.ndarray = _column('angle_covariance')
    position_covariance: np.ndarray = _column('position_covariance')
    size: np.ndarray = _column('size')
    height: np.ndarray = _column('height')
    span: np.ndarray = _column('span')
    degree: np.ndarray = _column('degree')
    reason: np.ndarray = _column('reason')
    pin: np.ndarray = _column('pin')
    pin_variance: np.ndarray = _column('pin_variance')
    shape: np.ndarray = _column('shape')
    due: np.ndarray = _column('due')

    def __init__(
        self,
        column: Callable[[str], np.ndarray],
        frame_id: str,
        bodies: tuple[str, ...],
        run: int = 0,
        plane: Plane | None = None,
        frame_poses: Callable[[], FramePoses] | None = None,
        events: tuple[BodyEvent, ...] = (),
    ) -> None:
        self._column = column
        self.events = events
        self.frame_id = frame_id
        self.bodies = bodies
        self.run = run
        self.plane = plane
        self._make_frame_poses = frame_poses
        # By the function and its arguments.
        self._computed: dict[tuple[Any, ...], Any] = {}

    @classmethod
    def of_arrays(
        cls,
        arrays: Mapping[str, np.ndarray],
        frame_id: str,
        bodies: tuple[str, ...],
        run: int = 0,
        plane: Plane | None = None,
    ) -> 'Estimate':
        """
        Return an estimate of arrays by their names.

        Pins, shapes and references may be left out: then no body has any. So may reasons: then all
        bodies are known.
        """
        shape, stamp = np.shape(arrays['position'])[1:], np.asarray(arrays['stamp'])
        defaults = {
            'pin': np.full(shape, np.nan + 0j),
            'pin_variance': np.full(shape, np.nan),
            'shape': np.empty((*shape, 0), complex),
            'due': np.arange(stamp.size).reshape(stamp.shape),
            'reference': np.zeros(shape, complex),
            'reason': np.full(shape, KNOWN, np.uint8),
        }
        return cls((defaults | dict(arrays)).__getitem__, frame_id, bodies, run, plane)

    def __len__(self) -> int:
        return len(self.stamp)

    def __iter__(self) -> Iterator['Estimate']:
        return (self[instant] for instant in range(len(self)))

    def __getitem__(self, instant: int) -> 'Estimate':
        def column(name: str) -> np.ndarray:
            index = *(slice(None),) * INSTANT_AXIS.get(name, 0), instant
            part: np.ndarray = getattr(self, name)[index]
            return part

        make = self._make_frame_poses and partial(self._frame_poses_at, instant)
        shared = self.frame_id, self.bodies, self.run, self.plane, make
        found_with = zip(self.events, self.instants_of_events(), strict=True)
        events = tuple(event for event, number in found_with if number == instant)
        one = Estimate(column, *shared, events)
        # Quantities of all instants are not computed again for one.
        poles = [key for key in self._computed if key[0] is _pole]
        one._computed = {key: _at(instant, self._computed[key]) for key in poles}
        for name, quantity in vars(self).items():
            if isinstance(quantity, Vectors | Numbers):
                vars(one)[name] = _at(instant, quantity)
        return one

    @property
    def missing(self) -> np.ndarray:
        """Why nothing is known of a body (T, B), in words; '' if it is known."""
        return texts_of(self.reason)

    @cached_property
    def pinned(self) -> np.ndarray:
        """Which bodies (T, B) turn about a fixed point."""
        return np.isfinite(self.pin)

    @cached_property
    def frame_poses(self) -> FramePoses | None:
        """Poses fitted to single frames; None if they are not available."""
        return self._make_frame_poses and self._make_frame_poses()

    def instants_of_events(self) -> list[int]:
        """With which of the instants (T,) each of `events` was found."""
        if not self.events:
            return []
        found = np.searchsorted(np.atleast_1d(self.due), [event.due for event in self.events])
        return np.minimum(found, np.size(self.due) - 1).tolist()

    def _frame_poses_at(self, instant: int) -> FramePoses:
        assert self.frame_poses is not None
        return _at(instant, self.frame_poses)

    @property
    def order(self) -> int:
        """The highest derivative."""
        return len(self.angle) - 1

    def origin(self, order: int) -> np.ndarray:
        """Return the origins of the bodies' frames (T, B), or a derivative, complex, m/s^order."""
        return self.once(_origin, order)

    def rate(self, order: int) -> Numbers:
        """Return the derivative of the angle of order 1 to 4, rad/s^order."""
        return self.once(_rate, order)

    @cached_property
    def compiled_motion(self) -> Motion:
        """The arrays as the compiled code takes them."""
        return motion_of(*(getattr(self, name) for name in Motion.elements))

    def general_pole(self, order: int) -> Vectors:
        """Return the pole of order 1 to 4, m, from the motion alone, without pins."""
        return _pole(FREE + order, self)

    def pole(self, order: int) -> Vectors:
        """Return ICR, IAP, IJP or ISP, m, for order 1 to 4; the pin of a pinned body."""
        return self.once(_pole, order)

    def motion(self, body: int) -> str:
        """
        Return the motion of a body at one instant: 'still', 'translating', 'pinned' or 'general'.

        Empty if nothing is known of the body.
        """
        if self.reason[body]:
            return ''
        if stands_out(np.abs(self.angle), self.angle_covariance)[body]:
            return 'pinned' if self.pinned[body] else 'general'
        # The length of a vector has twice the variance of one coordinate.
        moves = stands_out(np.abs(self.position), 2 * self.position_covariance)
        return 'translating' if moves[body] else 'still'

    @cached_property
    def icr_velocity(self) -> Vectors:
        """Velocity of the ICR along both centrodes (m/s)."""
        value, covariance, flags, _ = compute_quantity(VELOCITY, self.compiled_motion)
        return Vectors(value, covariance, (flags & DETERMINED) > 0)

    @cached_property
    def centrode_curvature(self) -> Numbers:
        """Signed curvature of the fixed centrode (1/m); undetermined where the ICR stands still."""
        value, covariance, flags, _ = compute_quantity(CURVATURE, self.compiled_motion)
        return Numbers(value.real, covariance[..., 0, 0], (flags & DETERMINED) > 0)

    @cached_property
    def inflection_circle(self) -> Vectors:
        """Center of the inflection circle (m); undetermined where the ICR stands still."""
        value, covariance, flags, _ = compute_quantity(CIRCLE_CENTER, self.compiled_motion)
        return Vectors(value, covariance, (flags & DETERMINED) > 0)

    @cached_property
    def inflection_diameter(self) -> Numbers:
        """Diameter of the inflection circle (m); undetermined where the ICR stands still."""
        value, covariance, flags, _ = compute_quantity(CIRCLE_DIAMETER, self.compiled_motion)
        return Numbers(value.real, covariance[..., 0, 0], (flags & DETERMINED) > 0)

    @cached_property
    def ball_point(self) -> Vectors:
        """Ball's point (m); undetermined where it does not stand out of its noise on the circle."""
        motion = self.position[:4], self.angle[:4]
        covariances = self.position_covariance[:4, :4], self.angle_covariance[:4, :4]
        value, covariance = planar.propagate(ball_of_motion, *motion, *covariances)
        with np.errstate(invalid='ignore'):
            deviation = np.sqrt(np.trace(covariance, axis1=-2, axis2=-1))
            known = SIGNIFICANT * deviation < self.inflection_diameter.value
        return Vectors(value, covariance, self.inflection_diameter.determined & known)

    def quantities(self, order: int) -> dict[str, Numbers | Vectors]:
        """Return the quantities of `quantity_names`."""
        found: dict[str, Numbers | Vectors] = {}
        for name in quantity_names(order):
            if name in RATE_NAMES:
                found[name] = self.rate(RATE_NAMES.index(name) + 1)
            elif name in POLE_NAMES:
                found[name] = self.pole(POLE_NAMES.index(name) + 1)
            else:
                found[name] = getattr(self, name)
        return found

    def once(self, compute: Callable[..., _Computed], *arguments: Any) -> _Computed:
        """Return `compute` of these arguments and this estimate, computed when first asked for."""
        key = compute, *arguments
        if key not in self._computed:
            self._computed[key] = compute(*arguments, self)
        found: _Computed = self._computed[key]
        return found

    @property
    def icr_moves(self) -> np.ndarray:
        """Where (T, B) the velocity of the ICR exceeds its noise; nowhere for a pinned body."""
        return (compute_quantity(VELOCITY, self.compiled_motion)[2] & MOVES) > 0

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices (j, i) of the measured pairs of bodies, i before j: see `measured_pairs`."""
        return pair_indices(len(self.bodies))

    @cached_property
    def relative_rate(self) -> Numbers:
        """Angular velocity of j with respect to i (rad/s) for every pair."""
        j, i = self.pairs
        rate, noise, _ = self.rate(1)
        value = rate[..., j] - rate[..., i]
        return Numbers(value, noise[..., j] + noise[..., i], np.isfinite(value))

    @cached_property
    def relative_icr(self) -> Vectors:
        """
        Relative instant center of j with respect to i (m) for every pair.

        From the velocities as measured, pins or no: what bends both cancels between them.
        """
        value, covariance, flags = relative_centers(self.compiled_motion, np.array(self.pairs))
        return Vectors(value, covariance, flags > 0)

    def reasons(self, body: int) -> dict[str, str]:
        """Return why quantities of a body at one instant are undetermined, by name, in words."""
        if self.reason[body]:
            return {'all': str(self.missing[body])}
        codes = {name: code[body] for name, code in self.withheld().items()}
        return {name: str(texts_of(code)) for name, code in codes.items() if code}

    def withheld(self) -> dict[str, np.ndarray]:
        """
        Return the code (T, B) of why each quantity is undetermined, KNOWN where it is determined.

        The quantities are the poles, the curvature of the centrode and the inflection circle, up to
        the order. A `reason` of the body holds for all of them.
        """
        motion, names = self.compiled_motion, withheld_quantities(self.order)
        return {name: compute_quantity(what, motion)[3] for what, name in names.items()}


def _origin(order: int, estimate: Estimate) -> np.ndarray:
    """Return the origins of the bodies' frames, or a derivative."""
    origin = compute_origins(estimate.compiled_motion)
    if order > 0:
        motion = estimate.position, estimate.angle
        origin = planar.body_point_derivative(order, origin, *motion)
    return np.asarray(origin)


def _rate(order: int, estimate: Estimate) -> Numbers:
    """Return a derivative of the angle."""
    value, variance = estimate.angle[order], estimate.angle_covariance[order, order]
    return Numbers(value, variance, np.isfinite(value))


def _pole(order: int, estimate: Estimate) -> Vectors:
    """Return a pole, with pins, or without for FREE + its order."""
    value, covariance, flags, _ = compute_quantity(order, estimate.compiled_motion)
    return Vectors(value, covariance, flags > 0)


def _at(instant: int, arrays: _Arrays) -> _Arrays:
    """One instant of arrays (T, ...)."""
    return type(arrays)(*(array[instant] for array in arrays))


def estimate_of(
    parts: Sequence[tuple[Results, np.ndarray]],
    frame_id: str,
    bodies: tuple[str, ...],
    run: int,
    plane: Plane | None,
    are_measured: bool,
    events: tuple[BodyEvent, ...] = (),
) -> Estimate:
    """
    Return results, of one instant after the other, as one estimate.

    Each of the `parts` is with the numbers of the frames of which `due` counts.
    """
    results = [part for part, _ in parts]
    for part, numbers in parts:
        due, reason = part.column('due'), part.column('reason')
        due[:] = numbers[due]
        if plane is None:
            reason[:] = REASONS['PLANE_UNKNOWN']
        elif are_measured:
            reason[:] = reasons_of_poses(reason)

    def stored(name: str) -> np.ndarray:
        axis = INSTANT_AXIS.get(name, 0)
        return np.concatenate([part.column(name) for part in results], axis)

    if len(results) == 1:
        stored = results[0].column

    def column(name: str) -> np.ndarray:
        return stored('parameters') - 1 if name == 'degree' else stored(name)

    def frame_poses() -> FramePoses:
        turned, placed = stored('information').swapaxes(0, 1)
        return FramePoses(
            angle=stored('frame_angle'),
            position=stored('frame_position'),
            angle_information=turned,
            position_information=placed,
            middle=stored('middle'),
            noise=stored('noise'),
        )

    estimate = Estimate(column, frame_id, bodies, run, plane, frame_poses, events)
    if len(results) == 1:
        estimate.compiled_motion = results[0].motion()
    return estimate
