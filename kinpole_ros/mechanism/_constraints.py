"""
Equations of a joint between the poses of its bodies, with derivatives, for `linkage`.

They follow from the joint's chain of vectors (`loop_form`): its own variable, if it has one, is
where the poses say, and leaves one equation of the chain; each tie is another.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, LoopForm, Pose
from kinpole_ros.planar._plane import Real

# Columns of derivatives: the poses of both bodies, and x and y of both points.
ANGLE, OTHER_ANGLE, POINTS = 2, 5, 10


class ConstraintRows(NamedTuple):
    """
    The k equations of a joint at T instants: `value` (T, k), m or rad, zero where they hold.

    `slope` (T, k, 10 + s) is the derivative by x, y and angle of both bodies, by x and y of `a` and
    of `b`, and by the s `sizes` of the joint.
    """

    value: Real
    slope: Real


# The joint's own variable, and the angles of both bodies.
Anchor = tuple[float, float, float]


class _Chain(NamedTuple):
    """
    The chain of a joint: its `own` variable (T,), if any, and the equations (T, k) that are left.

    Slopes as those of `ConstraintRows`.
    """

    own: Real | None
    own_slope: Real
    value: Real
    slope: Real


def constraint_rows(
    joint: Joint, one: Pose, other: Pose, anchor: Anchor | None = None
) -> ConstraintRows:
    """
    Equations of a joint between the poses of its bodies at T instants, with their derivatives.

    A pin has the distances along x and y; a slot the distance across it; a guide also the turn; a
    wheel the error of the distance of its hub, and its slip. Ties are measured from `anchor`, or
    from where the variable and both angles are zero, and hold but for whole turns of `other`.
    """
    form, slopes = joint.loop_form(), _form_slopes(joint)
    chain = _chain(joint, form, slopes, one, other)
    values, by = [chain.value], [chain.slope]
    first = dict(zip((*form.variables, joint.one, joint.other), anchor or (0.0,) * 3, strict=False))
    for k, tie in enumerate(form.ties):
        angles = {joint.one: one.angle, joint.other: other.angle}
        variables = {name: angle - first.get(name, 0.0) for name, angle in angles.items()}
        own = form.variables[0] if form.variables else ''
        if chain.own is not None:
            variables[own] = chain.own - first[own]
        gap = sum(weight * variables[name] for name, weight in tie.weights.items()) - tie.value
        if own in tie.weights and not form.terms[0].slide:
            # The direction of the hub is known but for whole turns; the angles tell how many.
            turns = -2 * np.pi * np.round(gap / (2 * np.pi * tie.weights[own]))
            variables[own] = variables[own] + turns
            gap = gap + tie.weights[own] * turns
        slope = np.zeros((len(gap), chain.slope.shape[-1]))
        if own in tie.weights:
            slope += tie.weights[own] * chain.own_slope
        for name, column in ((joint.one, ANGLE), (joint.other, OTHER_ANGLE)):
            slope[:, column] += tie.weights.get(name, 0.0)
        for column, changed in enumerate(slopes, POINTS):
            weights = changed.ties[k].weights
            slope[:, column] += sum(w * variables[name] for name, w in weights.items() if w)
            slope[:, column] -= changed.ties[k].value
        whole = 2 * np.pi * abs(tie.weights.get(joint.other, np.inf))
        values.append(((gap + whole / 2) % whole - whole / 2)[:, None])
        by.append(slope[:, None])
    return ConstraintRows(np.concatenate(values, axis=1), np.concatenate(by, axis=1))


def anchor_of(joint: Joint, one: Pose, other: Pose) -> Anchor | None:
    """Where a joint is at the first instant, of one whose own variable no scene tells."""
    form = joint.loop_form()
    first = (Pose(pose.position[:1], pose.angle[:1]) for pose in (one, other))
    own = _chain(joint, form, (), *first).own
    if own is None or 'start' not in joint.sizes():
        return None
    return float(own[0]), float(one.angle[0]), float(other.angle[0])


def _form_slopes(joint: Joint) -> list[LoopForm]:
    """Derivatives of the numbers of a joint's form by its sizes, of which they are quadratic."""
    slopes = []
    for name in joint.sizes():
        size = getattr(joint, name)
        step = abs(size) / 2 or 1.0
        up, down = (joint.changed(**{name: size + s}).loop_form() for s in (step, -step))
        by = 0.5 / step
        terms = [
            a._replace(length=by * (a.length - b.length), offset=by * (a.offset - b.offset))
            for a, b in zip(up.terms, down.terms, strict=True)
        ]
        ties = [
            a._replace(
                weights={n: by * (w - b.weights[n]) for n, w in a.weights.items()},
                value=by * (a.value - b.value),
            )
            for a, b in zip(up.ties, down.ties, strict=True)
        ]
        slopes.append(up._replace(terms=tuple(terms), ties=tuple(ties)))
    return slopes


def _chain(
    joint: Joint, form: LoopForm, slopes: list[LoopForm] | tuple[()], one: Pose, other: Pose
) -> _Chain:
    """The vector from `a` to `b` less the joint's vectors without its own variable, split by it."""
    count, width = len(one.angle), POINTS + len(slopes)
    turn, other_turn = one.turn, other.turn
    slope = np.zeros((count, width), complex)
    for column, by in enumerate((-1, -1j, -1j * joint.a * turn, 1, 1j, 1j * joint.b * other_turn)):
        slope[:, column] = by
    for column, by in enumerate((-turn, -1j * turn, other_turn, 1j * other_turn), 6):
        slope[:, column] = by
    between = other.position + joint.b * other_turn - one.position - joint.a * turn
    columns = {joint.one: (one.angle, ANGLE), joint.other: (other.angle, OTHER_ANGLE)}
    own: tuple[float, Real, dict[int, float]] | None = None
    for k, term in enumerate(form.terms):
        # Derivatives of its length and direction, by their columns.
        by_size = {column: changed.terms[k] for column, changed in enumerate(slopes, POINTS)}
        by_length = {column: by.length for column, by in by_size.items() if by.length}
        by_angle = {column: by.offset for column, by in by_size.items() if by.offset}
        angle = np.full(count, term.offset)
        if term.turn in columns:
            angle += columns[term.turn][0]
            by_angle[columns[term.turn][1]] = 1.0
        if term.slide or term.turn not in (*columns, GROUND):
            own = term.length, angle, by_angle if term.slide else by_length
            continue
        direction = np.exp(1j * angle)
        between = between - term.length * direction
        for column, by in by_length.items():
            slope[:, column] -= by * direction
        for column, by in by_angle.items():
            slope[:, column] -= by * 1j * term.length * direction
    if own is None:
        parts = np.stack((between.real, between.imag), axis=1)
        return _Chain(None, np.zeros(0), parts, np.stack((slope.real, slope.imag), axis=1))
    length, angle, by_own = own
    if form.terms[0].slide:
        turned = np.exp(-1j * angle)
        local = turned * between
        slope *= turned[:, None]
        for column, by in by_own.items():
            slope[:, column] -= by * 1j * local
        return _Chain(local.real, slope.real, local.imag[:, None], slope.imag[:, None])
    outward = length * between / np.abs(length * between)
    gap = (outward.conj() * between).real - length
    by_gap = (outward.conj()[:, None] * slope).real
    for column, by in by_own.items():
        by_gap[:, column] -= by
    direction = np.angle(outward) - angle
    return _Chain(direction, (slope / between[:, None]).imag, gap[:, None], by_gap[:, None])
