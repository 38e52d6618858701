"""The loops of a scene as data for the editor in the page of `kinpole solve --html`."""

from typing import Any

import numpy as np

from kinpole_ros.mechanism import GROUND
from kinpole_ros.mechanism._joint_kinds import Joint
from kinpole_ros.mechanism._loops import with_laws
from kinpole_ros.mechanism._scene_file import value_spans
from kinpole_ros.tools.solve._solution import SolvedScene


def editor_data(solution: SolvedScene, text: str, order: np.ndarray) -> dict[str, Any] | None:
    """
    Return the scene for solver.js; None for a scene of vectors, which has no points to drag.

    `text` is the file of the scene, and `order` (T,) are the indices of the positions in the order
    of the page. Bodies are indices of their angles among the variables; the ground is the index
    after the last variable. Points are [body, name, x, y, start, end] with the span in the text.
    """
    mechanism = solution.scene.mechanism
    linkage, loops = mechanism.linkage, mechanism.linkage.loops
    if not mechanism.assembly.joints:
        return None
    names = [*loops.variables, GROUND]
    scene_points = solution.scene.points
    spans = value_spans(text, [('bodies', *name.split('.')) for name in scene_points])
    points: list[list[Any]] = [
        [names.index(body), name.partition('.')[2], point.real, point.imag, *span]
        for (name, (body, point)), span in zip(scene_points.items(), spans, strict=True)
    ]
    indices = {(names[row[0]], complex(*row[2:4])): k for k, row in enumerate(points)}
    joints: list[dict[str, Any]] = []
    fixed = {hub for law in loops.laws for hub in law.hubs}
    for joint in mechanism.assembly.joints:
        ends = indices[joint.one, joint.a], indices[joint.other, joint.b]
        if joint.rims():
            fixed |= {points[end][1] for end in ends}
        joints.append(_joint_data(joint, names, ends))
    inputs = with_laws(linkage, _inputs(solution))[:, :, order]
    zero = with_laws(linkage, np.stack([d.motion(np.zeros(1)) for d in mechanism.drivers], axis=1))
    tied = loops.tie0.tolist()
    regular = np.flatnonzero(solution.motion.regular[order])
    at = int(regular[len(regular) // 2]) if len(regular) else 0
    return {
        'text': text,
        'start': value_spans(text, [('start',)])[0],
        'points': points,
        'fixed': sorted(fixed),
        'joints': joints,
        'size': len(loops.variables),
        'rows': [
            row.tolist() for row in (*loops.ties, *loops.drives, *(law.row for law in loops.laws))
        ],
        'inputs': [
            *([[value] * inputs.shape[2]] for value in tied),
            *(
                [values.tolist() if values.any() else None for values in inputs[:, r]]
                for r in range(inputs.shape[1])
            ),
        ],
        'zero': [*([value] for value in tied), *zero[:, :, 0].T.tolist()],
        'at': at,
        'values': solution.values[:, order[at]].tolist(),
    }


def _joint_data(joint: Joint, names: list[str], ends: tuple[int, int]) -> dict[str, Any]:
    """Return a joint between the points number `ends`, with the indices of its variables."""
    terms = [
        {
            'point': -1,
            'fixed': [term.length * np.cos(term.offset), term.length * np.sin(term.offset)],
            'turn': names.index(term.turn),
            'slide': names.index(term.slide) if term.slide else -1,
        }
        for term in joint.loop_form().terms
    ]
    return {
        'one': names.index(joint.one),
        'a': ends[0],
        'other': names.index(joint.other),
        'b': ends[1],
        'terms': terms,
        'loose': joint.is_span,
        'held': joint.is_carried,
    }


def _inputs(solution: SolvedScene) -> np.ndarray:
    """Return values and derivatives (5, d, T) of the drivers; over a range, at a constant rate."""
    if solution.times is not None:
        drivers = solution.scene.mechanism.drivers
        return np.stack([driver.motion(solution.times) for driver in drivers], axis=1)
    inputs = np.zeros((5, *solution.inputs.shape))
    inputs[0], inputs[1] = solution.inputs, solution.rates
    return inputs
