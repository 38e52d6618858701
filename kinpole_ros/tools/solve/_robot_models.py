"""
A scene as a model for MuJoCo (MJCF) or as a URDF, in the x-y plane, in m, kg and rad.

Both are trees of links. MuJoCo closes the loops by `connect` and `weld`; URDF cannot, so that it
has two frames for each closure, NAME.one and NAME.other, which coincide at all positions.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from kinpole_ros.mechanism import GROUND, LinkageError, SceneError, Spring
from kinpole_ros.mechanism._joint_tree import JointTree, Link, joint_tree
from kinpole_ros.mechanism._vector_joints import jointed
from kinpole_ros.tools.solve._solution import SolvedScene

# Links without a stated mass: kg per m, and kg of those that have no length; kg m² at least.
_MASS_PER_LENGTH, _LEAST_MASS, _LEAST_MOMENT = 1.0, 1e-3, 1e-9
# The radius of links, as a share of the linkage's size.
_THICKNESS = 0.015
# Loops: the time step, s, half the time constant, and an impedance near 1, with which the loops of
# the scenes open by less than 1e-6 m in a turn.
_TIME_STEP, _SOFTNESS = 1e-4, '0.9999 0.9999 0.001'
# Positions of the motion that an MJCF has as keys; damping of a motor, for links of 1 kg/m.
_KEYS, _MOTOR = 37, 100.0


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
    model = _Model(motion, tree, mechanism.driver_rows @ values)
    root = model.mjcf() if kind == 'xml' else model.urdf()
    indent(root)
    text = tostring(root, encoding='unicode')
    path.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding='utf-8')
    return [f'{kind}: {line}' for line in model.left_out(kind)]


class _Model:
    """
    The links of a scene, the ground first, and what the formats need of it.

    Values of the joints are (1 + T,): at the position that is drawn, and over the motion. `inputs`
    (d, 1 + T) are those of the drivers.
    """

    def __init__(self, motion: SolvedScene, tree: JointTree, inputs: np.ndarray) -> None:
        self._scene, self._tree, self._count = motion.scene, tree, inputs.shape[1]
        self._links = [link for link in tree.links.values() if link.parent]
        points = [link.at for link in self._links] + [z for _, z in self._scene.points.values()]
        self._size = max(map(abs, points), default=0.0) or 1.0
        drivers = motion.scene.mechanism.drivers
        # Each with the link that it moves, if one alone moves as it does.
        self._motors = {
            driver.name: next((one for one in self._links if _moves_as(one.value, row)), None)
            for driver, row in zip(drivers, inputs, strict=True)
        }

    def left_out(self, kind: str) -> Iterator[str]:
        """Yield a line for all that the format does not have."""
        scene = self._scene
        springs = [one for one in scene.springs if kind != 'xml' or not isinstance(one, Spring)]
        names = {'loads': scene.loads, 'held_by': scene.held_by, 'springs': springs}
        if left := [name for name, what in names.items() if what]:
            yield f'without {", ".join(left)}'
        if idle := [name for name, link in self._motors.items() if not link and kind == 'xml']:
            yield f'no motor for {", ".join(idle)}, which moves no single hinge or slide'
        if kind == 'urdf' and self._tree.closures:
            closed = ', '.join(one.name for one in self._tree.closures)
            yield f'a tree; frames NAME.one and NAME.other coincide where loops close: {closed}'

    def mjcf(self) -> Element:
        """Return the model of MuJoCo."""
        root = Element('mujoco', model=self._scene.name)
        _add(root, 'compiler', angle='radian', autolimits='true')
        _add(root, 'option', timestep=_TIME_STEP, gravity='0 0 0', integrator='implicitfast')
        default = _add(root, 'default')
        _add(default, 'geom', contype='0', conaffinity='0', type='capsule')
        _add(default, 'equality', solref=f'{2 * _TIME_STEP} 1', solimp=_SOFTNESS)
        world = _add(root, 'worldbody')
        _add(world, 'light', pos='0 0 5', dir='0 0 -1', directional='true')
        elements = {GROUND: world}
        for link in self._tree.links.values():
            if link.parent:
                elements[link.name] = _add_body(elements[link.parent], link)
                self._add_shape(elements[link.name], link)
            for name, z in self._points(link):
                _add(elements[link.name], 'site', name=name, pos=z)
        equality, tendon, actuator = (_add(root, t) for t in ('equality', 'tendon', 'actuator'))
        for one in self._tree.closures:
            # How two bodies are welded is taken from the position that is drawn.
            tag, anchor = ('weld', one.b) if one.welded else ('connect', one.a)
            names = ['world' if name == GROUND else name for name in (one.one, one.other)]
            _add(equality, tag, name=one.name, body1=names[0], body2=names[1], anchor=anchor)
            _add(elements[one.one], 'site', name=f'{one.name}.one', pos=one.a)
            _add(elements[one.other], 'site', name=f'{one.name}.other', pos=one.b)
        names_of = {point: name for name, point in self._scene.points.items()}
        for spring in self._scene.springs:
            if isinstance(spring, Spring):
                about = {'stiffness': spring.stiffness, 'springlength': spring.free}
                spatial = _add(tendon, 'spatial', **about)
                for end in ((spring.one, spring.a), (spring.other, spring.b)):
                    _add(spatial, 'site', site=names_of[end])
        for name, moved in self._motors.items():
            if moved:
                damping = _MOTOR * self._size ** (3 if moved.kind == 'hinge' else 1)
                _add(actuator, 'velocity', name=name, joint=moved.name, kv=damping)
        keys = _add(root, 'keyframe')
        # MuJoCo numbers the joints by the order of their elements.
        order = [self._tree.links[str(joint.get('name'))] for joint in world.iter('joint')]
        for k in range(self._count):
            _add(keys, 'key', name=f'position_{k}', qpos=[link.value[k] for link in order])
        return root

    def _add_shape(self, body: Element, link: Link) -> None:
        """Add mass and capsules of a link."""
        for mass in self._scene.masses:
            if mass.body == link.name:
                kg, moment = max(mass.mass, _LEAST_MASS), max(mass.moment, _LEAST_MOMENT)
                center = mass.center - link.origin
                _add(body, 'inertial', pos=center, mass=kg, diaginertia=[moment] * 3)
        bars, radius = self._bars(link), _THICKNESS * self._size
        for a, b in bars:
            mass_of_bar = _MASS_PER_LENGTH * abs(b - a)
            _add(body, 'geom', fromto=f'{_text(a)} {_text(b)}', size=radius, mass=mass_of_bar)
        if not bars:
            _add(body, 'geom', type='sphere', size=radius, mass=_LEAST_MASS)

    def urdf(self) -> Element:
        """Return the robot of a URDF."""
        root = Element('robot', name=self._scene.name)
        _add(root, 'link', name=GROUND)
        for link in self._links:
            self._add_visuals(_add(root, 'link', name=link.name), link)
            kind = 'continuous' if link.kind == 'hinge' else 'prismatic'
            joint = _add_joint(root, kind, link.name, link.parent, link.at, link.turn)
            _add(joint, 'axis', xyz=_axis(link))
            if link.kind == 'slide':
                ends = {'lower': link.value.min(), 'upper': link.value.max()}
                _add(joint, 'limit', effort='0', velocity='0', **ends)
        for one in self._tree.closures:
            turned = one.turned if one.welded else 0.0
            ends_of = ('one', one.one, one.a, turned), ('other', one.other, one.b, 0.0)
            for end, parent, at, turn in ends_of:
                _add(root, 'link', name=f'{one.name}.{end}')
                _add_joint(root, 'fixed', f'{one.name}.{end}', parent, at, turn)
        return root

    def _add_visuals(self, element: Element, link: Link) -> None:
        for mass in self._scene.masses:
            if mass.body == link.name:
                inertial = _add(element, 'inertial')
                _add(inertial, 'origin', xyz=mass.center - link.origin, rpy='0 0 0')
                _add(inertial, 'mass', value=mass.mass)
                moments = dict.fromkeys(('ixx', 'iyy', 'izz'), mass.moment)
                _add(inertial, 'inertia', **moments, **dict.fromkeys(('ixy', 'ixz', 'iyz'), 0.0))
        width = 2 * _THICKNESS * self._size
        for a, b in self._bars(link):
            visual = _add(element, 'visual')
            _add(visual, 'origin', xyz=(a + b) / 2, rpy=[0, 0, np.angle(b - a)])
            _add(_add(visual, 'geometry'), 'box', size=[abs(b - a), width, width])

    def _points(self, link: Link) -> list[tuple[str, complex]]:
        """Return the named points of a link in its frame; those of vectors have other frames."""
        points = self._scene.points.items() if self._scene.mechanism.assembly.joints else ()
        return [(name, z - link.origin) for name, (body, z) in points if body == link.name]

    def _bars(self, link: Link) -> list[tuple[complex, complex]]:
        """Return the lines between the points of a link: those with names, and where links hang."""
        points = [z for _, z in self._points(link)]
        points += [0j, *(one.at for one in self._links if one.parent == link.name)]
        for one in self._tree.closures:
            points += [z for name, z in ((one.one, one.a), (one.other, one.b)) if name == link.name]
        corners: list[complex] = []
        for z in points:
            if all(abs(z - other) > 1e-9 * self._size for other in corners):
                corners.append(z)
        return list(pairwise([*corners, corners[0]] if len(corners) > 2 else corners))


def _moves_as(value: np.ndarray, row: np.ndarray) -> bool:
    """Return whether a joint's values (T,) differ from those of a driver by a constant."""
    return bool(np.ptp(value - row) < 1e-9 * (1 + np.ptp(row)))


def _axis(link: Link) -> complex | str:
    return '0 0 1' if link.kind == 'hinge' else complex(np.exp(1j * link.axis))


def _add_body(parent: Element, link: Link) -> Element:
    """Add a link of an MJCF with its joint, where it is at the first position."""
    at, turn, first = link.at, link.turn, float(link.value[0])
    if link.kind == 'slide':
        at += first * complex(np.exp(1j * (turn + link.axis)))
    else:
        turn += first
    quaternion = [np.cos(turn / 2), 0, 0, np.sin(turn / 2)]
    body = _add(parent, 'body', name=link.name, pos=at, quat=quaternion)
    _add(body, 'joint', name=link.name, type=link.kind, ref=first, axis=_axis(link))
    return body


def _add_joint(
    root: Element, kind: str, child: str, parent: str, at: complex, turn: float
) -> Element:
    """Add a joint of a URDF, named after its child."""
    joint = _add(root, 'joint', name=child, type=kind)
    _add(joint, 'parent', link=parent)
    _add(joint, 'child', link=child)
    _add(joint, 'origin', xyz=at, rpy=[0, 0, turn])
    return joint


def _add(parent: Element, tag: str, **values: str | complex | list[float]) -> Element:
    """Add an element; points of the plane are complex."""
    return SubElement(parent, tag, {name: _text(value) for name, value in values.items()})


def _text(value: str | complex | list[float]) -> str:
    """Return numbers with all their digits."""
    if isinstance(value, str):
        return value
    if isinstance(value, complex):
        value = [value.real, value.imag, 0.0]
    numbers = value if isinstance(value, list) else [value]
    return ' '.join(f'{float(number) + 0.0:.16g}' for number in numbers)
