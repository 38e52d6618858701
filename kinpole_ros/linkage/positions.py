"""
A scene held against the positions of measured bodies: how far joints are off, and what is wrong.

Whatever drives the mechanism, and with or without markers on all of its bodies: all that counts is
what its joints say of the poses in each frame.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._adjust import left_over
from kinpole_ros.linkage._faults import Fault, faults
from kinpole_ros.linkage._residuals import Anchors
from kinpole_ros.linkage._scene_poses import Lie, ScenePoses, concatenated, scene_poses
from kinpole_ros.linkage._unknowns import (
    Guess,
    Normal,
    Solved,
    always_free,
    excess_of,
    find_ground,
    independent,
    normal_of,
    solve,
)
from kinpole_ros.mechanism import Dimension, LinkageError, Scene
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.estimate import Estimate

# Instants that are compared, evenly over a recording.
_MOST = 3000
# Of the live node: instants before the first verdict, and those that it remembers.
_FIRST, _LEAST, _MEMORY = 10, 8.0, 60.0
# Residuals this many times their noise say that something is wrong, whatever it is.
_TOO_MUCH = 2.0
# Instants at the beginning, an eighth at the most, that are left out.
_LEARNING = 200
# A body that is seen more seldom counts as one without markers.
_SELDOM = 0.5
# Positions of the scene among which bodies without markers are looked for first.
_POSITIONS = 256


class JointSummary(NamedTuple):
    """How far a joint is off over `instants`: rms, m, and that in deviations."""

    joint: str
    rms: float
    deviations: float
    instants: int


class PositionsFound(NamedTuple):
    """
    What positions say of a scene: each joint that bodies with markers share, and what is wrong.

    `ratio` is the mean square of all residuals in deviations, 1 where the scene is right; `words`
    say what is wrong, with the fix, in lines, none where nothing is.
    """

    joints: list[JointSummary]
    faults: list[Fault]
    ratio: float
    instants: int
    words: list[str]


class Positions:
    """The poses of a recording, to be compared with a scene as a whole."""

    def __init__(self, scene: Scene, lies: Mapping[str, Lie], most: int = _MOST) -> None:
        self.scene = scene
        self.values = np.array([one.value for one in scene.equations.dimensions])
        self._lies, self._most = lies, most
        self._parts: list[ScenePoses] = []

    def add(self, estimate: Estimate) -> None:
        """Take estimates (T, B)."""
        found = scene_poses(self.scene.equations, self.values, self._lies, estimate)
        if found is not None and found.seen.any():
            self._parts.append(found.part(found.seen.any(axis=1)))
            if sum(len(part.stamp) for part in self._parts) > 4 * self._most:
                self._parts = [concatenated(self._parts, 2 * self._most)]

    def poses(self) -> ScenePoses | None:
        """All poses in which bodies are seen that are not seldom seen; None for too few."""
        if not self._parts or not self.scene.equations.joints:
            return None
        whole = concatenated(self._parts, self._most)
        # Poses of the first frames are of shapes that had hardly been seen.
        whole = whole.part(slice(min(len(whole.stamp) // 8, _LEARNING), None))
        often = np.flatnonzero(whole.seen.mean(axis=0) >= _SELDOM)
        whole = whole.of_bodies(often).part(whole.seen[:, often].all(axis=1))
        return whole if len(whole.stamp) >= 2 and len(often) else None

    def solved(self, free: tuple[int, ...] = ()) -> tuple[Solved, ScenePoses] | None:
        """The least squares with the dimensions `free`, None where nothing can be compared."""
        poses = self.poses()
        if poses is None:
            return None
        anchors: Anchors = {}
        guess = guess_of(self.scene, poses)
        ground = find_ground(self.scene.equations, self.values, poses, anchors, guess)
        found = solve(self.scene.equations, self.values, ground, poses, free, anchors, guess)
        return (found, poses) if found.normal.used else None

    def found(self) -> PositionsFound | None:
        """The comparison, None where bodies and joints say nothing of each other."""
        result = self.solved()
        if result is None:
            return None
        solved, poses = result
        left, equations = solved.left, self.scene.equations
        measured = [equations.bodies[b] for b in poses.bodies]

        def excess(columns: list[int], change: Real) -> float:
            return excess_of(left.value + np.einsum('tku,u->tk', left.by[..., columns], change))

        wrong = faults(equations, solved.normal, measured, excess)
        ratio = solved.normal.chi_square / solved.freedom
        joints = []
        for k, joint in enumerate(equations.joints):
            known = np.isfinite(left.joint_deviations[:, k])
            if known.any():
                rms = np.sqrt(np.mean(left.joint[known, k] ** 2))
                deviations = np.sqrt(np.mean(left.joint_deviations[known, k] ** 2))
                summary = float(rms), float(deviations), int(known.sum())
                joints.append(JointSummary(joint.name, *summary))
        return PositionsFound(
            joints, wrong, ratio, len(poses.stamp), _words(self.scene, wrong, ratio)
        )


class LivePositions:
    """The same of a stream, instant by instant, of which the last minute or so counts."""

    def __init__(self, scene: Scene, lies: Mapping[str, Lie]) -> None:
        self._positions = Positions(scene, lies, round(_MEMORY))
        self._lies = lies
        self._run: int | None = None
        self._early: list[ScenePoses] = []
        self._ground: Real | None = None
        self._begin()

    def _begin(self) -> None:
        self._anchors: Anchors = {}
        self._normal: Normal | None = None
        self._waited = 0
        self._bodies: tuple[int, ...] = ()

    def add(self, now: Estimate) -> PositionsFound | None:
        """Take the estimate of one instant; what is known by then, None for too little."""
        scene, values = self._positions.scene, self._positions.values
        if now.run != self._run:
            self._run = now.run
            self._begin()
        here = scene_poses(scene.equations, values, self._lies, now)
        if here is None or not here.seen.any() or not scene.equations.joints:
            return None
        if self._ground is None:
            self._positions.add(now)
            self._early = [*self._early, here][-round(_MEMORY) :]
            result = self._positions.solved() if len(self._early) >= _FIRST else None
            if result is None:
                return None
            self._ground = result[0].ground
            for one in self._early[:-1]:
                self._take(one, self._ground)
            self._early = []
        return self._take(here, self._ground)

    def _take(self, here: ScenePoses, ground: Real) -> PositionsFound | None:
        """The poses of one instant, with what was taken before."""
        scene, values = self._positions.scene, self._positions.values
        here = here.of_bodies(np.flatnonzero(here.seen[0]))
        guess = guess_of(scene, here)
        hidden = None if guess is None else guess(here, ground)
        left = left_over(scene.equations, values, ground, here, self._anchors, hidden)
        if not left.used:
            return None
        if here.bodies != self._bodies:
            # Unknowns are others: wait for the bodies that are hidden, but not forever.
            self._waited += 1
            if {*here.bodies} < {*self._bodies} and self._waited < _FIRST:
                return None
            self._normal, self._bodies = None, here.bodies
        self._waited = 0
        new = normal_of(left)
        old = self._normal or Normal(np.zeros_like(new.square), np.zeros_like(new.gradient), 0, 0)
        fade = 1 - 1 / _MEMORY
        normal = Normal(*(fade * before + one for before, one in zip(old, new, strict=True)))
        self._normal = normal
        count = normal.used / left.used
        if count < _LEAST:
            return None

        def excess(columns: list[int], change: Real) -> float:
            return max(1.0, normal.corrected(columns, change) / normal.used)

        measured = [scene.equations.bodies[b] for b in here.bodies]
        wrong = faults(scene.equations, normal, measured, excess)
        base, _, inverse = independent(normal.square, always_free(scene.equations))
        change = -inverse @ normal.gradient[base]
        ratio = normal.corrected(base, change) / max(normal.used - len(base), 1)
        joints = [
            JointSummary(joint.name, float(left.joint[0, k]), float(left.joint_deviations[0, k]), 1)
            for k, joint in enumerate(scene.equations.joints)
            if np.isfinite(left.joint_deviations[0, k])
        ]
        return PositionsFound(joints, wrong, ratio, round(count), _words(scene, wrong, ratio))


def guess_of(scene: Scene, poses: ScenePoses) -> Guess | None:
    """Where the bodies without markers may be, by those positions of the scene that are nearest."""
    bodies = scene.equations.bodies
    if len(poses.bodies) == len(bodies) - 1:
        return None
    position, angle = _positions_of(scene)

    def guess(poses: ScenePoses, ground: Real) -> tuple[Complex, Real]:
        measured = list(poses.bodies)
        turned = poses.angle - ground[2]
        near = np.abs(np.exp(1j * turned[:, None]) - np.exp(1j * angle[None][..., measured]))
        best = (near**2).sum(axis=-1).argmin(axis=1)
        turn = np.exp(1j * ground[2])
        return complex(*ground[:2]) + turn * position[best], angle[best] + ground[2]

    return guess


@lru_cache(maxsize=4)
def _positions_of(scene: Scene) -> tuple[Complex, Real]:
    """Positions and angles (n, bodies) of the equations' bodies over what the scene does."""
    mechanism = scene.mechanism
    try:
        if len(mechanism.drivers) == 1 and np.isfinite(mechanism.drivers[0].high):
            driver = mechanism.drivers[0]
            motion = mechanism.sweep(np.linspace(driver.low, driver.high, _POSITIONS), 3)
        else:
            motion = mechanism.motion(np.linspace(0.0, 10.0, _POSITIONS), 3)
    except LinkageError:
        motion = mechanism.motion(np.zeros(1), 3)
    bodies = scene.equations.bodies
    count = motion.angle.shape[-1]
    position, angle = np.zeros((count, len(bodies)), complex), np.zeros((count, len(bodies)))
    for k, body in enumerate(bodies[:-1]):
        number = mechanism.bodies.index(body)
        position[:, k], angle[:, k] = motion.position[0, number], motion.angle[0, number]
    return position, angle


def _words(scene: Scene, wrong: list[Fault], ratio: float) -> list[str]:
    """What is wrong, in lines."""
    lines = [fault_words(scene.equations.dimensions, fault) for fault in wrong]
    if not wrong and ratio > _TOO_MUCH**2:
        lines.append(
            f'the bodies are off the joints by {np.sqrt(ratio):.2g} times their noise, which no '
            'dimension of the scene explains: see to play in the joints, to bodies that bend, and '
            'that markers sit where the scene has them'
        )
    return lines


def fault_words(dimensions: tuple[Dimension, ...], fault: Fault) -> str:
    """What is wrong, by how much, and what would be right."""
    size, unit = (1e3, 'mm') if fault.unit == 'm' else (180 / np.pi, 'deg')
    off = (
        f'{fault.off * size:.4g} {unit} off (deviation {fault.deviation * size:.2g} {unit}; '
        f'{fault.deviations:.0f} deviations)'
    )
    others = f'; or else {", ".join(fault.others)}' if fault.others else ''
    rows = [k for k in range(len(dimensions)) if dimensions[k].name == fault.subject]
    if not rows:
        return (
            f'{fault.subject} are {off}, all together, from where the scene has them{others}: '
            'correct their places in the scene, or the dimensions named'
        )
    shown = [
        ', '.join(f'{part:.6g}' for part in values)
        for values in (
            [dimensions[k].value for k in rows],
            [dimensions[k].value + fault.step.get(k, 0.0) for k in rows],
        )
    ]
    said, right = (f'[{text}]' if len(rows) > 1 else text for text in shown)
    return (
        f'{fault.subject} is {off}: the scene says {said} {fault.unit}, the bodies move as with '
        f'{right} {fault.unit}{others}'
    )
