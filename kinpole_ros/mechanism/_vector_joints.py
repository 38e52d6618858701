"""
The joints between the vectors of a loop form, and what these bear (seed 003, example 4).

Vectors that turn together are one body. Two bodies have a pin where their vectors meet, or a slot
where one of them is of free length; a vector that alone is free in length and angle is a strut.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism._assembly import assemble, poses_of
from kinpole_ros.mechanism._equations import joint_at, part_sum
from kinpole_ros.mechanism._equilibrium import Statics
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Pose, Revolute, Slot, Strut
from kinpole_ros.mechanism._loads import Force, Load
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._scene import Scene
from kinpole_ros.mechanism._start import mobility
from kinpole_ros.planar._plane import Real


def joints_of(scene: Scene, loaded: Sequence[str] = ()) -> tuple[Joint, ...]:
    """
    The joints of a scene, also of one that is written as vectors.

    Bodies that are `loaded` are no struts.
    """
    if scene.mechanism.assembly.joints:
        return scene.mechanism.assembly.joints
    equations = scene.equations
    sizes = np.array([dimension.value for dimension in equations.dimensions])
    joints = [joint_at(equations, k, sizes)[0] for k in range(len(equations.joints))]
    free = {name.removesuffix('.length') for name in scene.mechanism.assembly.loops.variables}
    for body in (free - {*loaded}) & {*equations.bodies}:
        both = [joint for joint in joints if body in (joint.one, joint.other)]
        if len(both) == 2 and isinstance(both[1], Slot) and isinstance(both[0], Revolute):
            pin, slot = both
            if pin.one == slot.one == body and pin.a == slot.a:
                strut = Strut(body, pin.other, pin.b, slot.other, slot.b)
                joints = [strut if one is slot else one for one in joints if one is not pin]
    return tuple(joints)


def reactions(scene: Scene, values: Real, loads: Sequence[Load]) -> Statics:
    """
    The forces in the joints of a scene that balance loads, also of one that is written as vectors.

    Parameters
    ----------
    scene
        The scene.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m, on its bodies.

    Returns
    -------
    Statics
        That of the scene; of vectors, that of a mechanism of bodies and joints, which are named by
        two bodies, 'r2-r3', or by the vector that is a strut. If there is no such mechanism, that
        of the vectors, which has efforts alone.

    """
    sizes = np.array([dimension.value for dimension in scene.equations.dimensions])
    on_carriers = []
    for load in loads:
        body, parts = scene.equations.frames.get(load.body, (load.body, ()))
        load = load._replace(body=body)
        if isinstance(load, Force):
            load = load._replace(point=load.point + part_sum(parts, sizes)[0])
        on_carriers.append(load)
    mechanism, here = jointed(scene, values, [load.body for load in on_carriers])
    if mechanism is scene.mechanism:
        return Statics(mechanism, values, loads)
    return Statics(mechanism, here, on_carriers)


def jointed(scene: Scene, values: Real, loaded: Sequence[str] = ()) -> tuple[Mechanism, Real]:
    """
    The mechanism of bodies and joints that vectors are, and its variables at theirs (n, T).

    The scene's own mechanism and `values` if it has joints, or if its vectors are no such
    mechanism.
    """
    joints = joints_of(scene, loaded)
    if scene.mechanism.assembly.joints:
        return scene.mechanism, values
    struts = {joint.name for joint in joints if joint.is_span}
    bodies = [body for body in scene.equations.bodies if body not in (GROUND, *struts)]
    try:
        assembly = assemble(bodies, joints)
    except LinkageError:
        return scene.mechanism, values
    poses = poses_of(scene.mechanism.assembly, values)
    own = {body: poses[body].angle for body in bodies}
    for joint in joints:
        own |= _own_values(joint, poses[joint.one], poses[joint.other])
    names = assembly.loops.variables
    drivers = tuple(
        driver._replace(row=_row(scene, names, driver.row)) for driver in scene.mechanism.drivers
    )
    here = np.array([own[name] for name in names])
    if mobility(assembly, here[:, 0])[1] != len(drivers):
        return scene.mechanism, values
    return Mechanism(assembly, drivers, here[:, 0]), here


def _own_values(joint: Joint, one: Pose, other: Pose) -> dict[str, Real]:
    """The variables (T,) of a slot or strut at poses of its bodies."""
    between = other.point(joint.b) - one.point(joint.a)
    if isinstance(joint, Slot):
        return {joint.name: (between * one.turn.conj() * np.exp(-1j * joint.along)).real}
    if isinstance(joint, Strut):
        return {joint.name: np.abs(between), f'{joint.name}.angle': np.unwrap(np.angle(between))}
    return {}


def _row(scene: Scene, names: Sequence[str], row: Real) -> Real:
    """The row of a driver, with the names of the joints' variables in place of the vectors'."""
    equations = scene.equations
    slots = {
        equations.dimensions[equation.sizes['along']].name.partition('.')[0]: equation.name
        for equation in equations.joints
        if 'along' in equation.sizes
    }
    moved = np.zeros(len(names))
    for weight, name in zip(row, scene.mechanism.assembly.loops.variables, strict=True):
        vector, _, kind = name.partition('.')
        if kind == 'length':
            own = vector if vector in names else slots.get(vector, '')
        else:
            own = f'{vector}.angle' if f'{vector}.angle' in names else vector
            own = own if own in names else equations.frames.get(vector, ('',))[0]
        if weight and own in names:
            moved[list(names).index(own)] += weight
    return moved
