"""What a scene says of the rates of its bodies, the driver being as it is seen."""

import numpy as np

from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import LinkageError
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.estimate import Estimate


def theory_rates(theory: Theory, estimate: Estimate) -> dict[str, np.ndarray]:
    """
    Angular velocity (rad/s) and what follows it, by body (order, T), NaN where it is not known.

    Not of the driver, which has none of its own. All NaN where the linkage cannot be put so, and
    none where its driver is no tracked body's angle.
    """
    if not theory.driver:
        return {}
    own, _, markers, places = theory.matches[theory.driver]
    shape = estimate.shape[:, own, markers]
    turn = fit_pose(shape, places, np.isfinite(shape).astype(float)).angle
    mechanism = theory.scene.mechanism
    start = float(mechanism.drivers[0].motion(np.zeros(1))[0, 0])
    inputs = np.zeros((5, len(estimate)))
    inputs[: estimate.order + 1] = estimate.angle[:, :, own]
    inputs[0] = start + (inputs[0] + turn - start + np.pi) % (2 * np.pi) - np.pi
    known = np.isfinite(inputs).all(axis=0)
    bodies = {
        body: match.in_scene for body, match in theory.matches.items() if body != theory.driver
    }
    found = {body: np.full((estimate.order, len(estimate)), np.nan) for body in bodies}
    if not known.any():
        return found
    try:
        motion = mechanism.at_inputs(inputs[:, None, known], None)
    except LinkageError:
        return found
    for body, number in bodies.items():
        rates = motion.angle[1 : estimate.order + 1, number]
        sound = np.arange(1, estimate.order + 1)[:, None] < motion.sound
        found[body][:, known] = np.where(sound & motion.regular, rates, np.nan)
    return found
