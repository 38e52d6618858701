"""
A linkage as programs for robots want it: a tree of hinges and slides, and closures of its loops.

Every joint is a chain of hinges, slides and rigid steps from one body to the other. A slot or a
strut needs a link between its bodies, named after the joint. The first joints that reach a body are
in the tree; of any other one all but the last hinge is, which is then a closure.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._arc_slot import ArcSlot
from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Pose, Revolute, Slot, Strut
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import Real


class Step(NamedTuple):
    """
    A step from frame to frame: a 'hinge' or 'slide' with values (T,), rad or m, or neither.

    A slide is in the `direction`, rad; a rigid step shifts by `shift`, m, and turns by `direction`.
    """

    kind: str
    value: Real | None = None
    direction: float = 0.0
    shift: complex = 0j

    def reversed(self) -> tuple['Step', ...]:
        """The step from the other side."""
        if self.value is not None:
            return (self._replace(value=-self.value),)
        return Step('', direction=-self.direction), Step('', shift=-self.shift)


class Link(NamedTuple):
    """
    A link of the tree, which hangs on its `parent` by one joint; the ground is not among them.

    The joint is at `at`, m, in the parent's frame, turned by `turn`, rad; the link's frame is there
    where the joint's value (T,) is zero. A slide is in the direction `axis`, rad, in this frame.
    The link carries the frame of the `body`, '' for none, at `origin`, turned by `angle`.
    """

    name: str
    parent: str
    kind: str
    at: complex
    turn: float
    axis: float
    value: Real
    body: str = ''
    origin: complex = 0j
    angle: float = 0.0

    def point(self, z: complex) -> complex:
        """A point of the body in the link's frame."""
        return complex(self.origin + z * np.exp(1j * self.angle))


class Closure(NamedTuple):
    """
    Two links that are joined where a loop closes: at `a` and at `b` in their frames, m.

    They turn freely, unless they are `welded`, `turned` (rad) from the first to the second.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    welded: bool = False
    turned: float = 0.0


class JointTree(NamedTuple):
    """The links in an order in which parents come first, and the closures."""

    links: tuple[Link, ...]
    closures: tuple[Closure, ...]


def joint_tree(mechanism: Mechanism, values: Real) -> JointTree:
    """
    The tree of a linkage whose joints are pins, slots and struts.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.

    Returns
    -------
    JointTree
        Its links with the values (T,) of their joints, and the closures of its loops.

    Raises
    ------
    LinkageError
        For wheels, belts, cams and Geneva drives, which are no hinges or slides.

    """
    if others := _not_carried(mechanism):
        raise LinkageError(f'{", ".join(others)} cannot be written as hinges and slides')
    poses = poses_of(mechanism.assembly, values)
    tree = {GROUND: Link(GROUND, '', '', 0j, 0.0, 0.0, np.zeros(values.shape[1]), GROUND)}
    closures: list[Closure] = []
    left = list(mechanism.assembly.joints)
    while left:
        # Breadth first, since chains are then short; struts last.
        joint = min(left, key=lambda one: (one.is_span, _depth(tree, one)))
        left.remove(joint)
        steps = list(_steps(joint, poses[joint.one], poses[joint.other]))
        if joint.one in tree and joint.other in tree:
            closures.append(_close(tree, joint, steps))
        elif joint.one in tree:
            _hang(tree, joint.name, tree[joint.one], joint.a, steps, (joint.other, joint.b))
        else:
            back = [one for step in reversed(steps) for one in step.reversed()]
            _hang(tree, joint.name, tree[joint.other], joint.b, back, (joint.one, joint.a))
    return JointTree(tuple(tree.values())[1:], tuple(closures))


def _not_carried(mechanism: Mechanism) -> list[str]:
    """What is neither hinge nor slide: names of joints, and what laws prescribe."""
    names = [
        joint.name
        for joint in mechanism.assembly.joints
        if not isinstance(joint, Revolute | Slot | ArcSlot | Strut)
    ]
    return [*names, *(follower.name for follower in mechanism.assembly.followers)]


def _depth(tree: dict[str, Link], joint: Joint) -> int:
    """How far from the ground a joint begins; beyond all if it reaches no link yet."""
    names = list(tree)
    return min(
        (names.index(body) for body in (joint.one, joint.other) if body in tree),
        default=len(names),
    )


def _steps(joint: Joint, one: Pose, other: Pose) -> Iterator[Step]:
    """The steps from the point `a`, in the axes of `one`, to the point `b`, in those of `other`."""
    turn = other.angle - one.angle
    between = other.point(joint.b) - one.point(joint.a)
    if isinstance(joint, Slot):
        slide = (between * one.turn.conj() * np.exp(-1j * joint.along)).real
        yield Step('slide', slide, joint.along)
        if joint.turned is not None:
            yield Step('', direction=joint.turned)
            return
    elif isinstance(joint, ArcSlot | Strut):
        toward = np.unwrap(np.angle(between)) - one.angle
        if isinstance(joint, ArcSlot) and joint.turned is not None:
            yield Step('hinge', turn - joint.turned)
            yield Step('', shift=joint.circle)
            yield Step('', direction=joint.turned)
            return
        yield Step('hinge', toward)
        if isinstance(joint, Strut):
            yield Step('slide', np.abs(between))
        else:
            yield Step('', shift=joint.circle)
        turn = turn - toward
    yield Step('hinge', turn)


def _hang(
    tree: dict[str, Link],
    name: str,
    link: Link,
    point: complex,
    steps: list[Step],
    end: tuple[str, complex] | None,
) -> tuple[Link, complex, float]:
    """
    Hang the links of a chain on a link; return the last, and where its end is in that one's frame.

    It begins at the `point` of the link's body; the last link carries the body of `end`, of which
    the chain ends at a point.
    """
    at, turn = link.point(point), link.angle
    moving = [k for k, step in enumerate(steps) if step.value is not None]
    for k, step in enumerate(steps):
        if step.value is None:
            at += step.shift * np.exp(1j * turn)
            turn += step.direction
            continue
        is_last = k == moving[-1] and end is not None
        own = end[0] if is_last and end else name if k == moving[0] else f'{name}.{k}'
        link = Link(own, link.name, step.kind, complex(at), turn, step.direction, step.value)
        tree[own], at, turn = link, 0j, 0.0
    if end is not None:
        origin = at - end[1] * np.exp(1j * turn)
        link = tree[link.name] = link._replace(body=end[0], origin=complex(origin), angle=turn)
    return link, complex(at), turn


def _close(tree: dict[str, Link], joint: Joint, steps: list[Step]) -> Closure:
    """The closure of a joint between two bodies of the tree, with the links that it needs."""
    other = tree[joint.other]
    welded = not (steps and steps[-1].kind == 'hinge')
    kept = steps if welded else steps[:-1]
    link, at, turn = _hang(tree, joint.name, tree[joint.one], joint.a, kept, None)
    return Closure(
        joint.name, link.name, at, other.name, other.point(joint.b), welded, turn - other.angle
    )
