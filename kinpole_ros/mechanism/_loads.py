"""What acts on a scene's bodies: its loads as they are written, and what is to hold them."""

from typing import Any

from kinpole_ros.mechanism._assembly import GROUND
from kinpole_ros.mechanism._joints import Points, mapping, named_point, need, refuse_unknown
from kinpole_ros.mechanism._statics import Force, Holder, Load, Torque
from kinpole_ros.mechanism._units import SceneError, quantity, vector

_GRAVITY = 9.80665


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
