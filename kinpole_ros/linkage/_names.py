"""Names of bodies and markers: the markers' own as far as they go."""

import re
from itertools import takewhile

from kinpole_ros.linkage._identify import Bodies
from kinpole_ros.linkage._poses import GROUND

_BODY = re.compile(r'[A-Za-z_][A-Za-z0-9_]+')
_OTHER = re.compile(r'[.:/ -]+')


def body_names(labels: list[list[str]]) -> list[str]:
    """A name for each body: what the names of its markers begin with, else body_1, body_2, ..."""
    found = [_common(each) for each in labels]
    return [
        name if name and name != GROUND and found.count(name) == 1 else f'body_{k}'
        for k, name in enumerate(found, 1)
    ]


def _common(labels: list[str]) -> str:
    parts = [label.rpartition('/')[0] or label for label in labels]
    # Of texts in order, what first and last begin with all do.
    both = zip(min(parts), max(parts), strict=False)
    name = ''.join(a for a, _ in takewhile(lambda pair: pair[0] == pair[1], both))
    name = _OTHER.sub('_', name.rstrip('0123456789').rstrip('_-/. '))
    return name if _BODY.fullmatch(name) else ''


def marker_names(found: Bodies, names: list[str]) -> list[list[str]]:
    """Names of the markers of each body: as short as is unique, or NAME_1, NAME_2, ..."""
    short = {}
    spaces = [label.rpartition('/')[0] for label in found.labels]
    for label, space in zip(found.labels, spaces, strict=True):
        short[label] = space if space and spaces.count(space) == 1 else label
    result = []
    named: dict[int, str] = {}
    for name, body in zip(names, found.groups.bodies, strict=True):
        for place, k in enumerate(body, 1):
            # A marker on the axis of a pin is of two bodies, by one name.
            named.setdefault(k, short[found.labels[k]] if found.labels[k] else f'{name}_{place}')
        result.append([named[k] for k in body])
    return result
