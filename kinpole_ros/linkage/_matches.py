"""Bodies that are both tracked and in a scene, matched by the names or positions of markers."""

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Scene
from kinpole_ros.planar import fit_pose, to_complex
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.thresholds import NEGLIGIBLE


class BodyMatch(NamedTuple):
    """
    A body that is both tracked and in the scene.

    `tracked` and `in_scene` are its numbers in both. `markers` (k,) are those of its tracked
    markers that the scene has, at `positions` (k,) in the scene's frame of it, complex, m.
    """

    tracked: int
    in_scene: int
    markers: np.ndarray
    positions: Complex

    def fit_frame(self, shape: Complex) -> tuple[Complex, Real]:
        """Origin (T,) and angle (T,) of the scene's frame in the tracked one, by shapes (T, n)."""
        markers = shape[..., self.markers]
        fit = fit_pose(markers, self.positions, np.isfinite(markers).astype(float))
        return fit.position, fit.angle


class MismatchError(Exception):
    """Why a scene does not match the tracked bodies."""


def match_bodies(
    scene: Scene,
    bodies: Mapping[str, Sequence[str]],
    shapes: Mapping[str, Sequence[complex]],
    is_posed: bool,
) -> dict[str, BodyMatch]:
    """Match tracked bodies with markers, or with shapes only, or that come as poses."""
    matches = {}
    for b, (body, markers) in enumerate(bodies.items()):
        if is_posed and body in scene.mechanism.bodies:
            # The frames of poses are those of the scene's bodies.
            positions = np.array(shapes[body])
            rows = np.arange(len(positions))
        elif body in scene.marker_names:
            rows, positions = _match_body(scene, body, markers, shapes)
        else:
            continue
        matches[body] = BodyMatch(b, scene.mechanism.bodies.index(body), rows, positions)
    if not matches:
        raise MismatchError(
            f'it has markers on {", ".join(scene.markers) or "no body"}, and the parameter bodies '
            f'names {", ".join(bodies)}; give both the same names'
        )
    return matches


def _match_body(
    scene: Scene, body: str, markers: Sequence[str], shapes: Mapping[str, Sequence[complex]]
) -> tuple[np.ndarray, Complex]:
    """The tracked markers that the scene has, by name or else by shape, and their positions."""
    names, positions = scene.marker_names[body], to_complex(scene.markers[body])
    if not markers:
        pairs = match_markers(positions, np.array(shapes[body]))
        if pairs is None:
            raise MismatchError(
                f'the {len(positions)} markers of its {body} are not where parameter {body}.shape '
                'has them; give both the same distances between the markers'
            )
        return pairs[1], positions[pairs[0]]
    rows = [k for k, marker in enumerate(markers) if marker in names]
    if len(rows) < 2:
        raise MismatchError(
            f'its {body} has the markers {", ".join(names)}; parameter {body}.markers must '
            'name two of them at least'
        )
    return np.array(rows), positions[[names.index(markers[k]) for k in rows]]


def match_markers(first: Complex, second: Complex) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Pair the markers (m,) and (n,) of two drawings of one rigid body by their positions alone.

    Each drawing has a frame of its own; the one with fewer markers is a part of the other. Returns
    the numbers of the paired markers in both. None where no pose puts each marker of the smaller on
    one of the larger, to 1% of the size.
    """
    is_swapped = len(first) > len(second)
    few, many = (second, first) if is_swapped else (first, second)
    if len(few) < 2:
        return None
    # Any two markers of the larger drawing may be the two that are farthest apart in the smaller.
    a, b = np.unravel_index(np.abs(few[:, None] - few).argmax(), (len(few), len(few)))
    least, best = np.inf, None
    for i, j in permutations(range(len(many)), 2):
        turn = np.exp(1j * np.angle((many[j] - many[i]) / (few[b] - few[a])))
        shift = (many[i] + many[j] - turn * (few[a] + few[b])) / 2
        nearest = np.abs(turn * few[:, None] + shift - many).argmin(axis=1)
        if len(set(nearest.tolist())) < len(few):
            continue
        fit = fit_pose(many[nearest], few, np.ones(len(few)))
        worst = float(np.abs(fit.residual).max())
        if worst < least:
            least, best = worst, nearest
    if best is None or least > NEGLIGIBLE * abs(few[b] - few[a]):
        return None
    order = np.arange(len(few))
    return (best, order) if is_swapped else (order, best)
