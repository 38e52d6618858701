"""
What weights make of fits: coefficients weighted, evaluated, and the windows put together.

Which weights, is a choice (`_choice.py`); this is what every instant takes, chosen anew or not.
"""

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._models import Models
from kinpole_ros.window._projection import Projection, evaluate


def squares_of(fits: Projection, dimensions: np.ndarray) -> Real:
    """
    Mean squares (L, D + 1, M, G) by component: of coefficients, and of what the fits leave.

    The latter by degree of freedom; `dimensions` (G,) says how many components a signal has.
    """
    levels, degrees, _, *rest = fits.coefficients.shape
    result = np.empty((levels, degrees + 1, *rest))
    np.einsum('ldkmg,ldkmg->ldmg', fits.coefficients, fits.coefficients, out=result[:, :-1])
    np.add(fits.squares[:, 0], fits.squares[:, 1], out=result[:, -1])
    result[:, -1] /= np.maximum(fits.models.freedom, 1)
    result /= dimensions
    return result


def apart(fits: Projection, share: Real, mix: Real) -> Real:
    """Derivatives (K, 2, M, G) by the weights of `Weights`, from the sample at time 0."""
    values = evaluate(fits.models.rows, share[:, :, None] * fits.coefficients)
    return np.asarray((mix[:, :, None] * values).sum(axis=0))


def both_ways(fits: Projection, share: Real, mix: Real) -> Real:
    """
    Derivatives (K, 3, A + 1, M, B) of angle, x and y, from the sample at time 0.

    The weights, (L, D, A + 2, M, B) and (L, K, A + 2, M, B), are those of the angle by itself, of
    `Together` for each arm, and of the position by itself. So the first of the angles and the last
    of the positions are apart, the others together.
    """
    bodies = share.shape[-1]
    # Copied, lest each product goes by pieces of B numbers.
    angle = fits.coefficients[:, :, :1, :, :bodies].copy()
    position = fits.coefficients[..., None, :, bodies:].copy()
    members = np.empty((*share.shape[:2], 3, share.shape[2] - 1, *share.shape[3:]))
    np.multiply(share[:, :, :-1], angle, out=members[:, :, 0])
    np.multiply(share[:, :, None, 1:], position, out=members[:, :, 1:])
    values = evaluate_poses(fits.models, members)
    values[:, :, 0] *= mix[:, :, :-1]
    values[:, :, 1:] *= mix[:, :, None, 1:]
    return np.asarray(values.sum(axis=0))


def evaluate_poses(models: Models, members: Real) -> Real:
    """Rows of angles and positions applied to members (L, D, 3, A, M, B): (L, K, 3, A, M, B)."""
    if models.rows.shape[1] == 1:
        return evaluate(models.rows, members)
    bodies = members.shape[-1]
    angle = evaluate(models.rows[:, :bodies], members[:, :, :1])
    position = evaluate(models.rows[:, bodies:], members[:, :, 1:])
    return np.concatenate((angle, position), axis=2)
