"""
A scene as a model for MuJoCo (MJCF) or as a URDF, in the x-y plane, in m, kg and rad.

Both are trees of links. MuJoCo closes the loops by `connect` and `weld`; URDF cannot, so that it
has a pair of frames for each closure, NAME.one and NAME.other, which coincide at all positions.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from kinpole_ros.mechanism import GROUND, LinkageError, Mass, SceneError, Spring
from kinpole_ros.mechanism._joint_tree import JointTree, Link, joint_tree
from kinpole_ros.mechanism._vector_joints import jointed
from kinpole_ros.tools.solve._solution import SolvedScene

# Links without a stated mass: kg per m, and kg of those that have no length.
_MASS_PER_LENGTH, _LEAST_MASS = 1.0, 1e-3
# The radius of links, as a share of the linkage's size.
_THICKNESS = 0.015
# Loops: the time constant, s, twice the time step, and the impedance near 1, so that a closure is
# within 1e-6 of the linkage's size (test_robot_models.py).
_TIME_STEP, _SOFTNESS = 1e-4, '0.9999 0.9999 0.001'
# Positions of the motion that an MJCF has as keys; damping of a motor, for links of 1 kg/m.
_KEYS, _MOTOR = 37, 100.0

_Element = ElementTree.Element


def write_model(path: Path, kind: str, motion: SolvedScene, here: SolvedScene) -> list[str]:
    """
    Write an MJCF ('xml') or a 'urdf'; return lines about what they leave out.

    `here` is the position in which the model is drawn, `motion` gives the ranges of its joints.
    Raises SceneError for a scene with joints that are no hinges or slides.
    """
    scene = motion.scene
    positions = np.linspace(0, motion.inputs.shape[1] - 1, _KEYS).astype(int)
    values = np.concatenate((here.values[:, :1], motion.values[:, positions]), axis=1)
    mechanism, values = jointed(scene, values)
    if not mechanism.assembly.joints:
        raise SceneError(f'{scene.name}: its vectors are no bodies and joints; export a .dxf')
    try:
        tree = joint_tree(mechanism, values)
    except LinkageError as error:
        raise SceneError(f'{scene.name}: {error}; export a .dxf') from None
    inputs = mechanism.driver_rows @ values
    model = _Model(motion, tree, inputs)
    root = model.mjcf() if kind == 'xml' else model.urdf()
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding='unicode')
    path.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding='utf-8')
    return [f'{kind}: {line}' for line in model.left_out(kind)]


class _Model:
    """
    The links of a scene, and what the formats need of it.

    Values of the joints are (1 + T,): at the position that is drawn, and over the motion. `inputs`
    (d, 1 + T) are those of the drivers.
    """

    def __init__(self, motion: SolvedScene, tree: JointTree, inputs: np.ndarray) -> None:
        self._scene, self._tree, self._inputs = motion.scene, tree, inputs
        ends = [link.at for link in tree.links] + [z for _, z in self._scene.points.values()]
        self._size = max(map(abs, ends), default=0.0) or 1.0
        drivers = motion.scene.mechanism.drivers
        # Each with the link that it moves, if one alone moves as it does.
        self._motors = {
            driver.name: next((one for one in tree.links if _moves_as(one.value, row)), None)
            for driver, row in zip(drivers, inputs, strict=True)
        }

    def left_out(self, kind: str) -> Iterator[str]:
        """Yield a line for all that the format does not have."""
        scene = self._scene
        springs = [one for one in scene.springs if kind != 'xml' or not isinstance(one, Spring)]
        names = {'loads': scene.loads, 'held_by': scene.held_by, 'springs': springs}
        if left := [name for name, what in names.items() if what]:
            yield f'without {", ".join(left)}'
        if idle := [name for name, link in self._motors.items() if link is None and kind == 'xml']:
            yield f'no motor for {", ".join(idle)}, which moves no single hinge or slide'
        if kind == 'urdf' and self._tree.closures:
            names_of = ', '.join(one.name for one in self._tree.closures)
            yield f'a tree; frames NAME.one and NAME.other coincide where loops close: {names_of}'

    def mjcf(self) -> _Element:
        """Return the model of MuJoCo."""
        root = ElementTree.Element('mujoco', model=self._scene.name)
        ElementTree.SubElement(root, 'compiler', angle='radian', autolimits='true')
        option = {'timestep': f'{_TIME_STEP:g}', 'gravity': '0 0 0', 'integrator': 'implicitfast'}
        ElementTree.SubElement(root, 'option', option)
        default = ElementTree.SubElement(root, 'default')
        ElementTree.SubElement(default, 'geom', contype='0', conaffinity='0', type='capsule')
        softness = {'solref': f'{2 * _TIME_STEP:g} 1', 'solimp': _SOFTNESS}
        ElementTree.SubElement(default, 'equality', softness)
        world = ElementTree.SubElement(root, 'worldbody')
        ElementTree.SubElement(world, 'light', pos='0 0 5', dir='0 0 -1', directional='true')
        elements, order = {GROUND: world}, list[Link]()
        self._add_body_parts(world, Link(GROUND, '', '', 0j, 0.0, 0.0, np.zeros(1), GROUND))
        for link in self._tree.links:
            elements[link.name] = self._add_body(elements[link.parent], link)
        # MuJoCo numbers the joints by the order of their elements.
        by_name = {link.name: link for link in self._tree.links}
        order = [by_name[str(joint.get('name'))] for joint in world.iter('joint')]
        self._add_closures(root, elements)
        self._add_motors(root)
        keys = ElementTree.SubElement(root, 'keyframe')
        for k in range(len(self._inputs.T)):
            angles = _numbers(*(link.value[k] for link in order))
            ElementTree.SubElement(keys, 'key', name=f'position_{k}', qpos=angles)
        return root

    def _add_body(self, parent: _Element, link: Link) -> _Element:
        """Add a link to its parent, where it is at the first position."""
        at, turn, first = link.at, link.turn, float(link.value[0])
        axis = np.exp(1j * link.axis)
        if link.kind == 'slide':
            at = at + first * axis * np.exp(1j * turn)
        else:
            turn += first
        half = turn / 2
        quaternion = _numbers(np.cos(half), 0, 0, np.sin(half))
        body = ElementTree.SubElement(parent, 'body', name=link.name, pos=_at(at), quat=quaternion)
        joint = {'name': link.name, 'type': link.kind, 'ref': _numbers(first)}
        joint['axis'] = '0 0 1' if link.kind == 'hinge' else _at(axis)
        ElementTree.SubElement(body, 'joint', joint)
        self._add_body_parts(body, link)
        return body

    def _add_body_parts(self, body: _Element, link: Link) -> None:
        """Add mass, capsules and named points of a link."""
        mass = self._mass(link)
        if mass:
            moment = max(mass.moment, 1e-9)
            ElementTree.SubElement(
                body,
                'inertial',
                pos=_at(link.point(mass.center)),
                mass=_numbers(max(mass.mass, _LEAST_MASS)),
                diaginertia=_numbers(moment, moment, moment),
            )
        radius = _THICKNESS * self._size
        bars = self._bars(link) if link.name != GROUND else []
        for a, b in bars:
            shape = {'fromto': f'{_at(a)} {_at(b)}', 'size': _numbers(radius)}
            shape['mass'] = _numbers(_MASS_PER_LENGTH * abs(b - a))
            ElementTree.SubElement(body, 'geom', shape)
        if not bars and link.name != GROUND:
            shape = {'type': 'sphere', 'size': _numbers(radius), 'mass': _numbers(_LEAST_MASS)}
            ElementTree.SubElement(body, 'geom', shape)
        for name, z in self._points(link):
            ElementTree.SubElement(body, 'site', name=name, pos=_at(z))

    def _add_closures(self, root: _Element, elements: dict[str, _Element]) -> None:
        equality = ElementTree.SubElement(root, 'equality')
        for one in self._tree.closures:
            ends = {'body1': self._world(one.one), 'body2': self._world(one.other)}
            # How two bodies are welded is taken from the position that is drawn.
            about = {'name': one.name, **ends, 'anchor': _at(one.b if one.welded else one.a)}
            ElementTree.SubElement(equality, 'weld' if one.welded else 'connect', about)
            for end, link, z in (('one', one.one, one.a), ('other', one.other, one.b)):
                site = {'name': f'{one.name}.{end}', 'pos': _at(z)}
                ElementTree.SubElement(elements[link], 'site', site)
        tendons = ElementTree.SubElement(root, 'tendon')
        names_of = {point: name for name, point in self._scene.points.items()}
        for spring in self._scene.springs:
            if isinstance(spring, Spring):
                spatial = ElementTree.SubElement(
                    tendons,
                    'spatial',
                    stiffness=_numbers(spring.stiffness),
                    springlength=_numbers(spring.free),
                )
                for point in ((spring.one, spring.a), (spring.other, spring.b)):
                    ElementTree.SubElement(spatial, 'site', site=names_of[point])

    def _add_motors(self, root: _Element) -> None:
        motors = ElementTree.SubElement(root, 'actuator')
        for name, link in self._motors.items():
            if link is not None:
                strength = _MOTOR * self._size ** (3 if link.kind == 'hinge' else 1)
                motor = {'name': name, 'joint': link.name, 'kv': _numbers(strength)}
                ElementTree.SubElement(motors, 'velocity', motor)

    @staticmethod
    def _world(name: str) -> str:
        return 'world' if name == GROUND else name

    def urdf(self) -> _Element:
        """Return the robot of a URDF."""
        root = ElementTree.Element('robot', name=self._scene.name)
        ground = Link(GROUND, '', '', 0j, 0.0, 0.0, np.zeros(1), GROUND)
        for link in (ground, *self._tree.links):
            element = ElementTree.SubElement(root, 'link', name=link.name)
            self._add_visuals(element, link)
            if link.parent:
                self._add_urdf_joint(root, link)
        for one in self._tree.closures:
            ends = ('one', one.one, one.a, one.turned), ('other', one.other, one.b, 0.0)
            for end, parent, at, turn in ends:
                name = f'{one.name}.{end}'
                ElementTree.SubElement(root, 'link', name=name)
                fixed = ElementTree.SubElement(root, 'joint', name=name, type='fixed')
                _relate(fixed, parent, name, at, turn if one.welded else 0.0)
        return root

    def _add_urdf_joint(self, root: _Element, link: Link) -> None:
        kind = 'continuous' if link.kind == 'hinge' else 'prismatic'
        joint = ElementTree.SubElement(root, 'joint', name=link.name, type=kind)
        _relate(joint, link.parent, link.name, link.at, link.turn)
        axis = '0 0 1' if link.kind == 'hinge' else _at(np.exp(1j * link.axis))
        ElementTree.SubElement(joint, 'axis', xyz=axis)
        if link.kind == 'slide':
            low, high = float(link.value.min()), float(link.value.max())
            limit = {'lower': _numbers(low), 'upper': _numbers(high)}
            ElementTree.SubElement(joint, 'limit', limit, effort='0', velocity='0')

    def _add_visuals(self, element: _Element, link: Link) -> None:
        if mass := self._mass(link):
            inertial = ElementTree.SubElement(element, 'inertial')
            origin = _at(link.point(mass.center))
            ElementTree.SubElement(inertial, 'origin', xyz=origin, rpy='0 0 0')
            ElementTree.SubElement(inertial, 'mass', value=_numbers(mass.mass))
            moment = _numbers(mass.moment)
            inertia = dict.fromkeys(('ixy', 'ixz', 'iyz'), '0')
            inertia |= dict.fromkeys(('ixx', 'iyy', 'izz'), moment)
            ElementTree.SubElement(inertial, 'inertia', inertia)
        width = _numbers(2 * _THICKNESS * self._size)
        for a, b in self._bars(link) if link.name != GROUND else ():
            visual = ElementTree.SubElement(element, 'visual')
            turn = f'0 0 {_numbers(np.angle(b - a))}'
            ElementTree.SubElement(visual, 'origin', xyz=_at((a + b) / 2), rpy=turn)
            geometry = ElementTree.SubElement(visual, 'geometry')
            ElementTree.SubElement(geometry, 'box', size=f'{_numbers(abs(b - a))} {width} {width}')

    def _mass(self, link: Link) -> Mass | None:
        return next((one for one in self._scene.masses if one.body == link.body), None)

    def _points(self, link: Link) -> list[tuple[str, complex]]:
        """Return the named points of a link in its frame; those of vectors have other frames."""
        if not self._scene.mechanism.assembly.joints:
            return []
        points = self._scene.points.items()
        return [(name, link.point(z)) for name, (body, z) in points if body == link.body]

    def _bars(self, link: Link) -> list[tuple[complex, complex]]:
        """Return the lines between the points of a link: those with names, and where links hang."""
        points = [z for _, z in self._points(link)]
        points += [0j, *(one.at for one in self._tree.links if one.parent == link.name)]
        for one in self._tree.closures:
            points += [z for name, z in ((one.one, one.a), (one.other, one.b)) if name == link.name]
        near = 1e-9 * self._size
        corners: list[complex] = []
        for z in points:
            if all(abs(z - other) > near for other in corners):
                corners.append(z)
        around = [*corners, corners[0]] if len(corners) > 2 else corners
        return list(pairwise(around))


def _moves_as(value: np.ndarray, row: np.ndarray) -> bool:
    """Return whether a joint's values (T,) differ from those of a driver by a constant."""
    return bool(np.ptp(value - row) < 1e-9 * (1 + np.ptp(row)))


def _relate(joint: _Element, parent: str, child: str, at: complex, turn: float) -> None:
    """Add to a joint of a URDF what it connects, and where."""
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)
    ElementTree.SubElement(joint, 'origin', xyz=_at(at), rpy=f'0 0 {_numbers(turn)}')


def _at(z: complex) -> str:
    return _numbers(z.real, z.imag, 0.0)


def _numbers(*values: float) -> str:
    """Return numbers with all their digits."""
    return ' '.join(f'{float(value) + 0.0:.16g}' for value in values)
