"""
Titles of the columns of a table: which are coordinates of points, and which rotations of bodies.

Columns of one name and the axes x, y, z are a group. A group with w is a quaternion. Velocities,
accelerations, forces and the like have axes, too, and are no places: they are known by their words,
by their unit, or by a letter such as v beside the places of the same name.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

# "x", "X (mm)", "x1", "cx", "x_mm", "X 2 (m)", "tip_x", "tip.x [cm]", "/rod/pose/position/x".
_COORDINATE = re.compile(
    r'(?:(?P<name>.+)[ _.:/-])?c?(?P<axis>[xyzw])(?P<number>(?:[ _]?[0-9]+)?)'
    r'(?:\s*[(\[](?P<unit>.*)[)\]]|[ _](?P<suffix>mm|cm|m|px|pixels?|norm|normalized))?',
    re.IGNORECASE,
)
_AXIS_FIRST = re.compile(  # "X Position (m)", "x-position"
    r'(?P<axis>[xyz])[ _-]?(?P<name>position|pos|coordinate|coord)\.?(?P<number>[ _]?[0-9]*)'
    r'\s*(?:[(\[](?P<unit>.*)[)\]])?',
    re.IGNORECASE,
)
_FUSED = re.compile(r'(?:(?P<name>.+)[ _.:/-])?(?P<kind>[qtp])_?(?P<axis>[xyzw])')  # "qx", "tx"
_PLAIN = re.compile(r'(?s).+_[xyz]')
_WORD = re.compile(r'[ _.:/-]+|(?<=[a-z])(?=[A-Z])')
# Around the name of a body in the fields of ROS messages.
_FIELD = re.compile(
    r'^(?:field|msg)(?=[./]|$)|^[./]+|[./]+$'
    r'|(?:^|(?<=[./]))(?:pose|position|translation|transform|orientation|rotation|point)$'
)
BODY = 'body'  # the name of the only one, where its columns have none
_TURNS = frozenset(('q', 'quat', 'quaternion', 'orientation', 'rotation', 'rot', 'ori', 'attitude'))
_PLACES = frozenset(('position', 'positions', 'pos', 'translation', 'location', 'coords'))
_AROUND = _TURNS | _PLACES | {'pose', 'transform', 'point'}  # behind the name of a body
_NO_PLACES = frozenset(
    (
        *('velocity', 'velocities', 'vel', 'speed', 'acceleration', 'accelerations', 'accel'),
        *(
            'acc',
            'jerk',
            'force',
            'forces',
            'momentum',
            'moment',
            'torque',
            'linear',
            'angular',
            'omega',
        ),
        *('twist', 'wrench', 'gyro', 'covariance', 'cov', 'std', 'stddev', 'sigma', 'variance'),
        *('var', 'err', 'error', 'dot', 'ddot', 'rvec', 'euler', 'flow', 'geschwindigkeit'),
        *('grf', 'mag', 'magnetometer', 'accelerometer', 'gyroscope', 'imu'),
        *('beschleunigung', 'vitesse', 'velocidad', 'aceleracion', 'aceleración'),
    )
)
_LETTERS = frozenset(('v', 'a', 'f', 'w', 'j', 'd', 'u', 'dv', 'alpha', 'mom'))
_NO_PLACES_OF_ROS = frozenset(('scale', 'color', 'normal', 'axis', 'magnetic', 'field'))
_MOMENTS = ('M', 'T')
# Of units that are no lengths; those with a / are others.
_NO_LENGTHS = frozenset(
    ('n', 'kn', 'lbf', 'nm', 'n·m', 'n*m', 'n.m', 'nmm', 'rad', 'deg', '°', 'degrees', 'g', 'kg')
)
_RATE_UNIT = re.compile(r'/|mps|[sS]\s*\^?\s*[-−⁻]|[sS]\s*[²³]')


class Layout(NamedTuple):
    """Columns of the points and bodies of a table."""

    points: dict[str, dict[str, int]]  # columns by axis, by the name of each point
    turns: dict[str, list[int]]  # columns of the quaternion x, y, z, w, by the name of each body
    unit: str  # of the points; '' where no title says one


class _Group(NamedTuple):
    """Columns of one name, by axis."""

    name: str
    columns: dict[str, int]
    units: set[str]
    is_plain: bool  # titled NAME_x in small letters

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(word.lower() for word in _WORD.split(self.name) if word)

    @property
    def stem(self) -> tuple[str, ...]:
        """Return the words of the name of a body, without those of places and rotations."""
        words = self.words
        while words and words[-1] in _AROUND:
            words = words[:-1]
        return words[1:] if words[:1] in (('field',), ('msg',)) else words

    @property
    def bare(self) -> tuple[str, ...]:
        """Return the stem without a word of places before it, as of "pos_A"."""
        stem = self.stem
        return stem[1:] if stem[:1] and stem[0] in _PLACES else stem


def find_columns(header: Sequence[str]) -> Layout:
    """
    Find the columns of points and bodies by their titles, in the order of the header.

    Where no column is named NAME_x, those with x and y in another notation count. A point that is
    named NAME_x alone is returned as it is, without y.
    """
    groups = _groups_of(header)
    turns = {one.stem: one for one in groups if _is_turn(one)}
    fused = _fused_groups(header)
    turns = {one.stem: one for one in fused if one.words[-1] == 'q' and _is_turn(one)} | turns
    places = [one for one in groups if not (_is_turn(one) or _is_no_place(one, groups))]
    plain = [one for one in places if one.is_plain]
    # A quaternion beside tx, ty, tz or px, py, pz has its place there.
    stems = {one.stem for one in places if {'x', 'y'} <= one.columns.keys()}
    for one in fused:
        if one.words[-1] != 'q' and one.words[:-1] in turns.keys() - stems:
            places.append(one._replace(name=one.name[:-1].rstrip(' _.:/-')))
            stems.add(one.words[:-1])
    of_bodies = [one for one in places if one.stem in turns]
    chosen = [one for one in places if one in plain or one in of_bodies] if plain else places
    if not plain:
        chosen = [one for one in chosen if {'x', 'y'} <= one.columns.keys()]
    points: dict[str, dict[str, int]] = {}
    bodies = {}
    for one in chosen:
        is_body = one.stem in turns
        name = _body_name(one.name) if one.stem else ''
        name = name or (BODY if is_body else 'point')
        name = name if name not in points else one.name
        points[name] = {axis: one.columns[axis] for axis in 'xyz' if axis in one.columns}
        if is_body:
            bodies[name] = [turns[one.stem].columns[axis] for axis in 'xyzw']
    units = {unit for one in chosen for unit in one.units}
    return Layout(points, bodies, ' and '.join(sorted(units)))


def _groups_of(header: Sequence[str]) -> list[_Group]:
    groups: dict[str, _Group] = {}
    for column, title in enumerate(header):
        if (match := _COORDINATE.fullmatch(title) or _AXIS_FIRST.fullmatch(title)) is None:
            continue
        is_plain = bool(_PLAIN.fullmatch(title))
        number = match['number'].strip(' _')
        name = title[:-2] if is_plain else match['name'] or (f'point{number}' if number else '')
        group = groups.setdefault(name, _Group(name, {}, set(), is_plain))
        group.columns.setdefault(match['axis'].lower(), column)
        suffix = match.groupdict().get('suffix')
        group.units.add((match['unit'] or suffix or '').strip())
        groups[name] = group._replace(is_plain=group.is_plain or is_plain)
    return list(groups.values())


def _fused_groups(header: Sequence[str]) -> list[_Group]:
    """Find qx, qy, qz, qw, and tx, ty, tz or px, py, pz, which count only beside a quaternion."""
    groups: dict[str, _Group] = {}
    for column, title in enumerate(header):
        if match := _FUSED.fullmatch(title):
            name = f'{match["name"]}_{match["kind"]}' if match['name'] else match['kind']
            group = groups.setdefault(name, _Group(name, {}, set(), False))
            group.columns.setdefault(match['axis'], column)
            group.units.add('')
    return list(groups.values())


def _is_turn(group: _Group) -> bool:
    return {'x', 'y', 'z', 'w'} <= group.columns.keys()


def _is_no_place(group: _Group, groups: Sequence[_Group]) -> bool:
    """Return whether columns are velocities and the like: by unit, by word, or beside places."""
    units = ' '.join(group.units)
    if _RATE_UNIT.search(units) or units.strip().lower() in _NO_LENGTHS:
        return True
    words = group.words
    if not words:
        return False
    is_of_ros = re.search('[./]', group.name) is not None
    kind = words[-1].rstrip('0123456789')
    if kind in _NO_PLACES or (is_of_ros and kind in _NO_PLACES_OF_ROS):
        return True
    others = [other for other in groups if other is not group]
    # A marker, as of L, M and N, has x and y; a moment in the plane has z alone, beside a force F.
    moments = [one for one in groups if one.name in _MOMENTS and one.columns.keys() == {'z'}]
    if group in moments or (moments and group.name == 'F'):
        return True
    if group.name == 'A':
        return False  # a marker, as of A, B and C; an acceleration is a
    stems = {stem for other in others for stem in (other.stem, other.bare)}
    names = {other.words for other in groups}
    # p_x beside v_x is the place of which that is the velocity.
    stems |= {name[:-1] for name in names if name[-1:] in (('p',), ('r',), ('s',))
              and (*name[:-1], 'v') in names and name != words}  # fmt: skip
    return (words[-1] in _LETTERS and words[:-1] in stems) or (
        len(words) > 1 and words[0] in _LETTERS | _NO_PLACES and words[1:] in stems
    )


def _body_name(name: str) -> str:
    """Return the name of a body in the path of a field of a message; others are as they are."""
    while (shorter := _FIELD.sub('', name)) != name:
        name = shorter
    return name
