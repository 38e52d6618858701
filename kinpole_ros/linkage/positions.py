"""
A scene compared with the positions of measured bodies: how far its joints are off, and why.

Only what the joints say of the poses in each frame counts, whatever drives the mechanism and
whether or not all of its bodies have markers.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.findings import OK, Finding
from kinpole_ros.linkage._least_squares import (
    Adjustment,
    Normal,
    Problem,
    adjust,
    always_free,
    find_ground,
    independent,
    normal_of,
    solve,
    variance_excess,
)
from kinpole_ros.linkage._matches import BodyMatch
from kinpole_ros.linkage._scene_faults import Fault, find_faults
from kinpole_ros.linkage._scene_poses import Anchors, ScenePoses, concatenated, scene_poses
from kinpole_ros.mechanism import LinkageError, Scene
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.estimate import Estimate

# Instants of a recording that are compared, evenly spaced.
_MAX_INSTANTS = 3000
# Instants at the beginning that are left out, since the shapes were hardly known, and the largest
# share of all instants that these may be.
_BURN_IN, _BURN_IN_SHARE = 200, 1 / 8
# Of the live node: instants before the ground is sought, instants before the first report, and
# instants that are remembered.
_FIRST, _MIN_INSTANTS, _MEMORY = 10, 8.0, 60.0
# Rms residual over the noise beyond which something is wrong, even if no dimension explains it.
_MAX_RATIO = 2.0
# A body that is seen in a smaller share of the instants counts as one without markers.
_MIN_SEEN = 0.5
# Positions of the scene from which bodies without markers are placed first, and the time that a
# scene with several drivers is moved for, s.
_POSITIONS, _MOVED_SECONDS = 256, 10.0


class JointSummary(NamedTuple):
    """How far a joint is off over `instants`: rms in m, and rms in standard deviations."""

    joint: str
    rms: float
    deviations: float
    instants: int


class PositionReport(NamedTuple):
    """
    Positions compared with a scene: the joints that bodies with markers share, and what is wrong.

    `ratio` is the mean square of all normalized residuals, 1 where the scene is right. There are no
    `findings` where nothing is wrong.
    """

    joints: list[JointSummary]
    faults: list[Fault]
    ratio: float
    instants: int
    findings: list[Finding]


class Positions:
    """The poses of a recording, to be compared with a scene."""

    def __init__(
        self, scene: Scene, matches: Mapping[str, BodyMatch], limit: int = _MAX_INSTANTS
    ) -> None:
        self.scene = scene
        self.values = np.array([dimension.value for dimension in scene.equations.dimensions])
        self._matches, self._limit = matches, limit
        self._blocks: list[ScenePoses] = []

    def append(self, estimate: Estimate) -> None:
        """Append estimates (T, B)."""
        poses = scene_poses(self.scene.equations, self.values, self._matches, estimate)
        if poses is not None and poses.seen.any():
            self._blocks.append(poses.at_instants(poses.seen.any(axis=1)))
            if sum(block.instants for block in self._blocks) > 4 * self._limit:
                self._blocks = [concatenated(self._blocks, 2 * self._limit)]

    def poses(self) -> ScenePoses | None:
        """The instants that have all bodies but those seen seldom; None for too few."""
        if not self._blocks or not self.scene.equations.joints:
            return None
        poses = concatenated(self._blocks, self._limit)
        burn_in = min(int(poses.instants * _BURN_IN_SHARE), _BURN_IN)
        poses = poses.at_instants(slice(burn_in, None))
        often = np.flatnonzero(poses.seen.mean(axis=0) >= _MIN_SEEN)
        poses = poses.of_bodies(often)
        poses = poses.at_instants(poses.seen.all(axis=1))
        return poses if poses.instants >= 2 and len(often) else None

    def solve(self, free: tuple[int, ...] = ()) -> tuple[Adjustment, ScenePoses] | None:
        """Fit the dimensions `free` by least squares; None where nothing can be compared."""
        poses = self.poses()
        if poses is None:
            return None
        problem = _problem(self.scene, self.values, poses, {})
        solution = solve(problem, find_ground(problem), free)
        return (solution, poses) if solution.normal.used else None

    def report(self) -> PositionReport | None:
        """Compare the poses with the scene; None where bodies and joints have nothing in common."""
        result = self.solve()
        if result is None:
            return None
        solution, poses = result
        adjusted, equations = solution.adjusted, self.scene.equations
        measured = [equations.bodies[b] for b in poses.bodies]

        def excess(unknowns: list[int], change: Real) -> float:
            corrections = np.einsum('tku,u->tk', adjusted.by[..., unknowns], change)
            return variance_excess(adjusted.value + corrections)

        faults = find_faults(equations, solution.normal, measured, excess)
        ratio = solution.normal.chi_square / solution.freedom
        joints = []
        for k, joint in enumerate(equations.joints):
            valid = np.isfinite(adjusted.joint_deviations[:, k])
            if valid.any():
                rms, deviations = (
                    float(np.sqrt(np.mean(values[valid, k] ** 2)))
                    for values in (adjusted.joint, adjusted.joint_deviations)
                )
                joints.append(JointSummary(joint.name, rms, deviations, int(valid.sum())))
        found = _findings(self.scene, faults, ratio)
        return PositionReport(joints, faults, ratio, poses.instants, found)


class LivePositions:
    """The same comparison of a stream, instant by instant. About the last minute counts."""

    def __init__(self, scene: Scene, matches: Mapping[str, BodyMatch]) -> None:
        self._positions = Positions(scene, matches, round(_MEMORY))
        self._matches = matches
        self._run: int | None = None
        self._early: list[ScenePoses] = []
        self._ground: Real | None = None
        self._restart()

    def _restart(self) -> None:
        self._anchors: Anchors = {}
        self._normal: Normal | None = None
        self._waited = 0
        self._bodies: tuple[int, ...] = ()

    def append(self, estimate: Estimate) -> PositionReport | None:
        """Append one instant; returns the comparison so far, None for too few instants."""
        scene, values = self._positions.scene, self._positions.values
        if estimate.run != self._run:
            self._run = estimate.run
            self._restart()
        poses = scene_poses(scene.equations, values, self._matches, estimate)
        if poses is None or not poses.seen.any() or not scene.equations.joints:
            return None
        if self._ground is None:
            self._positions.append(estimate)
            self._early = [*self._early, poses][-round(_MEMORY) :]
            result = self._positions.solve() if len(self._early) >= _FIRST else None
            if result is None:
                return None
            self._ground = result[0].ground
            for early in self._early[:-1]:
                self._update(early, self._ground)
            self._early = []
        return self._update(poses, self._ground)

    def diagnose(self, estimate: Estimate) -> tuple[list[Finding], dict[str, float]]:
        """Append one instant; returns what was found of the scene, and figures by name."""
        report, about = self.append(estimate), {'scene': self._positions.scene.name}
        if report is None:
            return [Finding('scene_early', values=about, level=OK)], {}
        figures = {}
        for joint in report.joints:
            figures[f'joint {joint.joint}: off (m)'] = joint.rms
            figures[f'joint {joint.joint}: the same in deviations'] = joint.deviations
        figures['residuals of the joints over their noise, rms'] = float(np.sqrt(report.ratio))
        return report.findings or [Finding('scene_compared', values=about, level=OK)], figures

    def _update(self, poses: ScenePoses, ground: Real) -> PositionReport | None:
        """Add the poses of one instant to the normal equations, and compare."""
        scene, values = self._positions.scene, self._positions.values
        equations = scene.equations
        poses = poses.of_bodies(np.flatnonzero(poses.seen[0]))
        problem = _problem(scene, values, poses, self._anchors)
        adjusted = adjust(problem, values, ground, problem.hidden(ground))
        if not adjusted.used:
            return None
        if poses.bodies != self._bodies:
            # The unknowns would change: wait a while for the bodies that are hidden.
            self._waited += 1
            if {*poses.bodies} < {*self._bodies} and self._waited < _FIRST:
                return None
            self._normal, self._bodies = None, poses.bodies
        self._waited = 0
        normal = normal_of(adjusted)
        if self._normal is not None:
            fade = 1 - 1 / _MEMORY
            pairs = zip(self._normal, normal, strict=True)
            normal = Normal(*(fade * before + now for before, now in pairs))
        self._normal = normal
        instants = normal.used / adjusted.used
        if instants < _MIN_INSTANTS:
            return None

        def excess(unknowns: list[int], change: Real) -> float:
            return max(1.0, normal.corrected(unknowns, change) / normal.used)

        measured = [equations.bodies[b] for b in poses.bodies]
        faults = find_faults(equations, normal, measured, excess)
        base, inverse = independent(normal.square, always_free(equations))
        change = -inverse @ normal.gradient[base]
        ratio = normal.corrected(base, change) / max(normal.used - len(base), 1)
        joints = [
            JointSummary(joint.name, float(rms), float(deviations), 1)
            for joint, rms, deviations in zip(
                equations.joints, adjusted.joint[0], adjusted.joint_deviations[0], strict=True
            )
            if np.isfinite(deviations)
        ]
        return PositionReport(
            joints, faults, ratio, round(instants), _findings(scene, faults, ratio)
        )


def _problem(scene: Scene, values: Real, poses: ScenePoses, anchors: Anchors) -> Problem:
    """The comparison of a scene with poses, bodies without markers by the scene's positions."""
    if len(poses.bodies) == len(scene.equations.bodies) - 1:
        return Problem(scene.equations, values, poses, anchors, None)
    position, angle = _scene_positions(scene)

    def guess(poses: ScenePoses, ground: Real) -> tuple[Complex, Real]:
        turned = np.exp(1j * (poses.angle - ground[2]))[:, None]
        off = np.abs(turned - np.exp(1j * angle[None][..., list(poses.bodies)]))
        nearest = (off**2).sum(axis=-1).argmin(axis=1)
        origin = complex(*ground[:2]) + np.exp(1j * ground[2]) * position[nearest]
        return origin, angle[nearest] + ground[2]

    return Problem(scene.equations, values, poses, anchors, guess)


@lru_cache(maxsize=4)
def _scene_positions(scene: Scene) -> tuple[Complex, Real]:
    """Positions and angles (n, bodies) of the equations' bodies over the motion of the scene."""
    mechanism = scene.mechanism
    try:
        if len(mechanism.drivers) == 1 and np.isfinite(mechanism.drivers[0].high):
            driver = mechanism.drivers[0]
            motion = mechanism.sweep(np.linspace(driver.low, driver.high, _POSITIONS), 3)
        else:
            motion = mechanism.motion(np.linspace(0.0, _MOVED_SECONDS, _POSITIONS), 3)
    except LinkageError:
        motion = mechanism.motion(np.zeros(1), 3)
    bodies = scene.equations.bodies
    count = motion.angle.shape[-1]
    position, angle = np.zeros((count, len(bodies)), complex), np.zeros((count, len(bodies)))
    for k, body in enumerate(bodies[:-1]):
        number = mechanism.bodies.index(body)
        position[:, k], angle[:, k] = motion.position[0, number], motion.angle[0, number]
    return position, angle


def _findings(scene: Scene, faults: list[Fault], ratio: float) -> list[Finding]:
    """Return what is wrong with a scene."""
    found = [fault.finding(scene.name, scene.equations.dimensions) for fault in faults]
    if not faults and ratio > _MAX_RATIO**2:
        about = {'scene': scene.name, 'ratio': float(np.sqrt(ratio))}
        found.append(Finding('scene_joints', values=about))
    return found
