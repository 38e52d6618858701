"""
A linkage as programs for robots want it: a tree of hinges and slides, and closures of its loops.

A pin in a slot and a strut have links of their own, named after the joint: a block, or a barrel and
a rod. Breadth first from the ground, the first joint that reaches a link is in the tree; every
other one closes a loop.
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


class Link(NamedTuple):
    """
    A link of the tree, which hangs on its `parent` by a 'hinge' or a 'slide', its `kind`.

    Its frame is parallel to that of its body, with the origin at the point `origin` of it, m; there
    it is joined to the point `at` of the parent's frame, m. The joint's `value` (T,) is the angle
    to the parent, rad, or how far it slid in the direction `axis` of its own frame, m; a link that
    slides stands at the angle `turn`, rad, to the parent.
    """

    name: str
    parent: str
    kind: str
    at: complex
    origin: complex
    value: Real
    axis: float = 0.0
    turn: float = 0.0


class Closure(NamedTuple):
    """
    Where the loop of a joint closes: at `a` and `b` in the frames of its links, m.

    The links turn freely, or are `welded`, the second at the angle `turned` (rad) to the first.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    welded: bool = False
    turned: float = 0.0


class JointTree(NamedTuple):
    """The links by name, each after its parent, the ground first; and the closures."""

    links: dict[str, Link]
    closures: tuple[Closure, ...]


class _Simple(NamedTuple):
    """A hinge, or a slide in the direction `along` (rad) of `one`, between two links."""

    name: str
    one: str
    a: complex
    other: str
    b: complex
    along: float | None = None


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
    assembly = mechanism.assembly
    kinds = Revolute | Slot | ArcSlot | Strut
    others = [joint.name for joint in assembly.joints if not isinstance(joint, kinds)]
    if others := [*others, *(follower.name for follower in assembly.followers)]:
        raise LinkageError(f'{", ".join(others)} cannot be written as hinges and slides')
    poses = poses_of(assembly, values)
    ordered = sorted(assembly.joints, key=lambda joint: joint.is_span)
    left = [simple for joint in ordered for simple in _simple_joints(joint, poses)]
    links = {GROUND: Link(GROUND, '', '', 0j, 0j, np.zeros(values.shape[1]))}
    closures: list[Closure] = []
    while left:
        # A chain is followed from its end only where its beginning is not reached otherwise.
        ways = [one for link in links for one in left if one.one == link]
        ways += [one for link in links for one in left if one.other == link]
        joint = ways[0]
        left.remove(joint)
        if joint.one in links and joint.other in links:
            closures.append(_close(links, joint, poses))
        else:
            link = _hang(links, joint, poses)
            links[link.name] = link
    return JointTree(links, tuple(closures))


def _simple_joints(joint: Joint, poses: dict[str, Pose]) -> Iterator[_Simple]:
    """The hinges and slides of a joint, in a chain from `one`; adds the poses of new links."""
    name, one, other = joint.name, poses[joint.one], poses[joint.other]
    toward = np.unwrap(np.angle(other.point(joint.b) - one.point(joint.a)))
    begin, end = (joint.one, joint.a), (joint.other, joint.b)
    if isinstance(joint, Slot) and joint.turned is not None:
        yield _Simple(name, *begin, *end, joint.along)
    elif isinstance(joint, Slot):
        poses[name] = Pose(other.point(joint.b), one.angle)
        yield _Simple(name, *begin, name, 0j, joint.along)
        yield _Simple(name, name, 0j, *end)
    elif isinstance(joint, ArcSlot) and joint.turned is not None:
        # A block turns about the center of curvature.
        center = joint.b - joint.circle * np.exp(-1j * joint.turned)
        yield _Simple(name, *begin, joint.other, complex(center))
    elif isinstance(joint, ArcSlot):
        poses[name] = Pose(one.point(joint.a), toward)
        yield _Simple(name, *begin, name, 0j)
        yield _Simple(name, name, complex(joint.circle), *end)
    elif isinstance(joint, Strut):
        rod = f'{name}.rod'
        poses[name] = Pose(one.point(joint.a), toward)
        poses[rod] = Pose(other.point(joint.b), toward)
        yield _Simple(name, *begin, name, 0j)
        yield _Simple(name, name, 0j, rod, 0j, 0.0)
        yield _Simple(name, rod, 0j, *end)
    else:
        yield _Simple(name, *begin, *end)


def _hang(links: dict[str, Link], joint: _Simple, poses: dict[str, Pose]) -> Link:
    """The link that a joint hangs on the tree."""
    parent, a, child, b = joint[1:5]
    if parent not in links:
        parent, a, child, b = child, b, parent, a
    at = a - links[parent].origin
    angle = poses[child].angle - poses[parent].angle
    if joint.along is None:
        return Link(child, parent, 'hinge', at, b, angle)
    axis = joint.along + poses[joint.one].angle[0] - poses[child].angle[0]
    between = poses[child].point(b) - poses[parent].point(a)
    value = (between * np.exp(-1j * (poses[child].angle + axis))).real
    return Link(child, parent, 'slide', at, b, value, float(axis), float(angle[0]))


def _close(links: dict[str, Link], joint: _Simple, poses: dict[str, Pose]) -> Closure:
    """The closure of a joint; a slide has a block on it, to which the other body is welded."""
    one, other = links[joint.one], links[joint.other]
    b = joint.b - other.origin
    if joint.along is None:
        return Closure(joint.name, one.name, joint.a - one.origin, other.name, b)
    poses[joint.name] = Pose(poses[joint.other].point(joint.b), poses[joint.one].angle)
    block = _hang(links, joint._replace(other=joint.name, b=0j), poses)
    links[block.name] = block
    turned = float(poses[joint.other].angle[0] - poses[joint.one].angle[0])
    return Closure(joint.name, block.name, 0j, other.name, b, True, turned)
