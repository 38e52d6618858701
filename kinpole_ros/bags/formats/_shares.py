"""Coordinates that are shares of a picture's width and height, as MediaPipe writes them."""

import re
from collections.abc import Sequence

import numpy as np

SHARES = 'shares of the picture'  # in place of a unit
_UNITS = ('norm', 'normalized', 'normalised', '0-1', '0..1', 'relative')
_FEWEST_NAMES = 3  # by which a pose, a hand or a face is known
# Of a pose and a hand of MediaPipe, and columns that no other program has.
_LANDMARK = re.compile(
    r'(?:nose|(?:left|right)[ _]?(?:eye|ear|shoulder|elbow|wrist|pinky|index|thumb|hip|knee|ankle'
    r'|heel|foot[ _]?index)|(?:left|right)[ _]?eye[ _]?(?:inner|outer)|mouth[ _]?(?:left|right)'
    r'|wrist|(?:thumb|index|middle|ring|pinky)(?:[ _]?finger)?[ _]?(?:cmc|mcp|pip|dip|ip|tip)'
    r'|(?:pose[ _]?|hand[ _]?|face[ _]?)?landmark[ _]?[0-9]+)[ _.:]?[xyz]',
    re.IGNORECASE,
)
_SEEN = re.compile(r'(?:.*[ _.])?(?:visibility|presence)(?:[ _]?[0-9]+)?|v[0-9]+', re.IGNORECASE)
_USUAL, _MOST = 0.95, (-0.5, 1.5)  # the share of coordinates that lie in, or next to, the picture


def unit_of_picture(header: Sequence[str], points: np.ndarray, unit: str) -> str:
    """
    Return the unit of points (T, n, 3), by their names and values.

    That of landmarks of a person, where `unit` is '', is SHARES or px.
    """
    if unit.lower() in _UNITS:
        return SHARES
    named = sum(bool(_LANDMARK.fullmatch(title)) for title in header) >= 2 * _FEWEST_NAMES
    seen = any(map(_SEEN.fullmatch, header))
    if unit or not (named or seen):
        return unit
    return SHARES if in_unit_square(points) else 'px' if seen else unit


def in_unit_square(points: np.ndarray) -> bool:
    """Return whether nearly all points (T, n, 3) that were seen lie in 0 to 1, or next to that."""
    seen = points[..., :2][np.isfinite(points[..., :2]).all(axis=-1)]
    if not len(seen):
        return False
    inside = (seen > _MOST[0]).all(axis=-1) & (seen < _MOST[1]).all(axis=-1)
    middle = np.median(seen, axis=0)
    return bool(inside.mean() > _USUAL and (middle > 0).all() and (middle < 1).all())
