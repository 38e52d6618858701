"""What the editor in the page of `kinpole solve --html` needs: the scene as its loops."""

from typing import Any

import numpy as np

from kinpole_ros.mechanism import (
    GROUND,
    Belt,
    Rolling,
    Strut,
    loop_form,
    value_spans,
    with_laws,
)
from kinpole_ros.tools.solve._solved import Solved


def editable(solved: Solved, text: str, order: np.ndarray) -> dict[str, Any] | None:
    """
    The scene of a motion for solver.js, None where it has vectors and so no points to drag.

    `text` is that of its file, `order` (T,) that of the instants in the page. A body is the number
    of its angle among the variables, the ground the number after all; points are [body, name, x, y,
    and from and to which letter of the text they are].
    """
    mechanism = solved.scene.mechanism
    assembly, linkage = mechanism.assembly, mechanism.linkage
    loops = linkage.loops
    if not assembly.joints:
        return None
    names = [*loops.variables, GROUND]
    spans = value_spans(text, [('bodies', *name.split('.')) for name in solved.scene.points])
    points: list[list[Any]] = [
        [names.index(body), name.partition('.')[2], place.real, place.imag, *span]
        for (name, (body, place)), span in zip(solved.scene.points.items(), spans, strict=True)
    ]
    (start,) = value_spans(text, [('start',)])
    places = {(names[row[0]], complex(*row[2:4])): k for k, row in enumerate(points)}
    joints: list[dict[str, Any]] = []
    fixed = {hub for law in loops.laws for hub in law.hubs}
    for joint in assembly.joints:
        ends = places[joint.one, joint.a], places[joint.other, joint.b]
        if isinstance(joint, Rolling | Belt):
            fixed |= {points[end][1] for end in ends}
        joints.append(
            {
                'one': names.index(joint.one),
                'a': ends[0],
                'other': names.index(joint.other),
                'b': ends[1],
                'terms': [
                    {
                        'point': -1,
                        'fixed': [
                            term.length * np.cos(term.offset),
                            term.length * np.sin(term.offset),
                        ],
                        'turn': names.index(term.turn),
                        'slide': names.index(term.slide) if term.slide else -1,
                    }
                    for term in loop_form(joint).terms
                ],
                'loose': isinstance(joint, Strut | Belt),
                'held': isinstance(joint, Belt) and joint.carrier is not None,
            }
        )
    inputs = with_laws(linkage, _inputs(solved))[:, :, order]
    ties = np.repeat(loops.tie0[:, None], inputs.shape[2], axis=1)
    zero = with_laws(linkage, np.stack([d.motion(np.zeros(1)) for d in mechanism.drivers], axis=1))
    laws = [law.row for law in loops.laws]
    regular = np.flatnonzero(solved.motion.regular[order])
    at = int(regular[len(regular) // 2]) if len(regular) else 0
    return {
        'text': text,
        'start': start,
        'points': points,
        'fixed': sorted(fixed),
        'joints': joints,
        'size': len(loops.variables),
        'rows': [row.tolist() for row in (*loops.ties, *loops.drives, *laws)],
        'inputs': [
            *([row.tolist()] for row in ties),
            *(
                [part.tolist() if part.any() else None for part in inputs[:, r]]
                for r in range(inputs.shape[1])
            ),
        ],
        'zero': [
            *([value] for value in loops.tie0.tolist()),
            *zero[:, :, 0].T.tolist(),
        ],
        'at': at,
        'values': solved.values[:, order[at]].tolist(),
    }


def _inputs(solved: Solved) -> np.ndarray:
    """Values and derivatives (5, d, T) of the drivers, at a steady rate over a range."""
    if solved.times is not None:
        drivers = solved.scene.mechanism.drivers
        return np.stack([driver.motion(solved.times) for driver in drivers], axis=1)
    inputs = np.zeros((5, *solved.inputs.shape))
    inputs[0], inputs[1] = solved.inputs, solved.rates
    return inputs
