"""What acts on a scene's bodies, as it is written: loads, what holds them, springs and masses."""

from typing import Any

from kinpole_ros.mechanism._joints import GROUND
from kinpole_ros.mechanism._scene_bodies import Points, mapping, named_point, need, refuse_unknown
from kinpole_ros.mechanism._statics import Force, Holder, Load, Mass, Spring, Torque, Torsion
from kinpole_ros.mechanism._units import SceneError, quantity, vector

_GRAVITY = 9.80665  # m/s^2, the standard one


def read_loads(said: Any, points: Points, bodies: tuple[str, ...]) -> tuple[Load, ...]:
    if said is not None and not isinstance(said, list):
        raise SceneError("'loads' is no list: write each as - {force: [0, -100], at: coupler.P}")
    loads: list[Load] = []
    for k, one in enumerate(said or []):
        where = f"'loads: {k + 1}'"
        mapping(where, one, '{force: [0, -100], at: coupler.P}')
        kind = next((k for k in ('force', 'weight', 'torque') if k in one), None)
        if kind is None:
            raise SceneError(
                f'{where} is {one!r}: give force: [0, -100] or weight: 10 kg and at: BODY.POINT, '
                'or torque: 5 and on: BODY'
            )
        where_to = 'on' if kind == 'torque' else 'at'
        refuse_unknown(where, one, (kind, where_to))
        need(where, one, (where_to,), f'{{{kind}: ..., {where_to}: ...}}')
        if kind == 'torque':
            if one['on'] not in bodies:
                raise SceneError(
                    f'{where}: on is {one["on"]!r}: give a moving body, one of {", ".join(bodies)}'
                )
            loads.append(Torque(one['on'], quantity(f'{where}: torque', one['torque'], 'torque')))
            continue
        body, place = named_point(f'{where}: at', one['at'], points)
        if body == GROUND:
            raise SceneError(f'{where}: at is {one["at"]!r} on the ground: load a moving body')
        if kind == 'weight':
            force = -1j * _GRAVITY * quantity(f'{where}: weight', one['weight'], 'mass')
        else:
            force = vector(f'{where}: force', one['force'], 'force')
        loads.append(Force(body, place, force))
    return tuple(loads)


def read_held_by(said: Any, points: Points, bodies: tuple[str, ...]) -> Holder:
    where, example = "'held_by'", '{at: bar.P, along: 90 deg, of: bar} or {on: bar}'
    mapping(where, said, example)
    for key in ('on', 'of'):
        if key in said and said[key] not in (*bodies, *([GROUND] if key == 'of' else [])):
            raise SceneError(
                f'{where}: {key} is {said[key]!r}: give a moving body, one of {", ".join(bodies)}'
            )
    if 'on' in said:
        refuse_unknown(f'{where}, a torque', said, ('on',))
        return Holder(said['on'])
    refuse_unknown(where, said, ('at', 'along', 'of'))
    need(where, said, ('at', 'along'), example)
    body, place = named_point(f'{where}: at', said['at'], points)
    if body == GROUND:
        raise SceneError(f'{where}: at is {said["at"]!r} on the ground: hold a moving body')
    along = quantity(f'{where}: along', said['along'], 'angle')
    return Holder(body, place, along, said.get('of', GROUND))


def read_springs(
    said: Any, points: Points, bodies: tuple[str, ...]
) -> tuple[Spring | Torsion, ...]:
    """The springs of a scene; raises SceneError."""
    example = '{between: [ground.S, crank.A], stiffness: 2 N/mm, free: 10 cm}'
    if said is None:
        return ()
    if not isinstance(said, list):
        raise SceneError(f"'springs' is no list: write each as - {example}")
    return tuple(
        _spring(f"'springs: {k + 1}'", mapping(f"'springs: {k + 1}'", one, example), points, bodies)
        for k, one in enumerate(said)
    )


def _spring(
    where: str, said: dict[str, Any], points: Points, bodies: tuple[str, ...]
) -> Spring | Torsion:
    keys = ('between', 'stiffness', 'free')
    refuse_unknown(where, said, keys)
    need(where, said, keys, '{between: [ground.S, crank.A], stiffness: 2 N/mm, free: 10 cm}')
    ends = said['between']
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(e, str) for e in ends):
        raise SceneError(
            f'{where}: between is {ends!r}: give two points, as [ground.S, crank.A], or two '
            'bodies, as [ground, crank], for a spring that turns them'
        )
    turns = all(end in (*bodies, GROUND) and end not in points for end in ends)
    if turns:
        one, other = ends
    else:
        (one, a), (other, b) = (named_point(f'{where}: between', end, points) for end in ends)
    if one == other:
        raise SceneError(f"{where}: both its ends are on '{one}': give two bodies")
    kinds = ('torsional stiffness', 'angle') if turns else ('stiffness', 'length')
    stiffness = quantity(f'{where}: stiffness', said['stiffness'], kinds[0])
    free = quantity(f'{where}: free', said['free'], kinds[1])
    if stiffness <= 0:
        raise SceneError(f'{where}: stiffness is {said["stiffness"]!r}: give one greater than 0')
    if turns:
        return Torsion(one, other, stiffness, free)
    if free < 0:
        raise SceneError(f'{where}: free is {said["free"]!r}: give a length of 0 or more')
    return Spring(one, a, other, b, stiffness, free)


def read_masses(said: Any, bodies: tuple[str, ...]) -> tuple[Mass, ...]:
    """The masses of a scene's bodies; raises SceneError."""
    if said is None:
        return ()
    example = '{mass: 2 kg, center: [5 cm, 0], moment: 20 kg cm2}'
    of_bodies = mapping("'masses'", said, f'{bodies[0]}: {example}')
    refuse_unknown("'masses'", of_bodies, bodies)
    found = []
    for body, one in of_bodies.items():
        where = f"'masses: {body}'"
        mapping(where, one, example)
        refuse_unknown(where, one, ('mass', 'center', 'moment'))
        need(where, one, ('mass', 'center'), example)
        mass = quantity(f'{where}: mass', one['mass'], 'mass')
        moment = quantity(f'{where}: moment', one.get('moment', 0.0), 'moment of inertia')
        for key, value in (('mass', mass), ('moment', moment)):
            if value < 0:
                raise SceneError(f'{where}: {key} is {one[key]!r}: give one of 0 or more')
        found.append(Mass(body, mass, vector(f'{where}: center', one['center']), moment))
    return tuple(found)
