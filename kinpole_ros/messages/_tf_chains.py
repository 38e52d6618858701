"""Poses of frames in others that move, as /tf has them, multiplied out into one fixed frame."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np


def chains_of(
    names: Sequence[str], parents: Mapping[str, str], static: Collection[str] = ()
) -> dict[str, tuple[str, ...]]:
    """
    Return the chain of each frame: the fixed frame, and what leads from there to it.

    Parameters
    ----------
    names : sequence of str
        Frames of bodies; those without a parent are left out.
    parents : mapping
        The parent of each frame that has one.
    static : collection of str
        Frames that do not move in their parents. Where all chains begin with the same ones, these
        are left out: the fixed frame is the nearest that all have.

    Returns
    -------
    dict
        (fixed frame, ..., frame) by name. Fixed frames differ where the chains do not meet.

    """
    chains = {}
    for name in names:
        chain = [name]
        # A loop has no fixed frame; it ends where it closes.
        while (parent := parents.get(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        if len(chain) > 1:
            chains[name] = tuple(reversed(chain))
    # (root, static, static, moving, ...): the second frame is as fixed as the root.
    while chains and all(len(chain) > 2 and chain[1] in static for chain in chains.values()):
        if len({chain[:2] for chain in chains.values()}) > 1:
            break
        chains = {name: chain[1:] for name, chain in chains.items()}
    return chains


def multiply_out(poses: Sequence[np.ndarray]) -> np.ndarray:
    """
    Return the pose of the last frame in the first one's parent.

    Parameters
    ----------
    poses : sequence of ndarray
        (..., 7), each in the frame of the one before: x, y, z and a quaternion x, y, z, w.

    Returns
    -------
    ndarray
        (..., 7).

    """
    result = poses[0]
    for pose in poses[1:]:
        turn, own = result[..., 3:], pose[..., 3:]
        place = result[..., :3] + _rotated(turn, pose[..., :3])
        vector = (
            turn[..., 3:] * own[..., :3]
            + own[..., 3:] * turn[..., :3]
            + np.cross(turn[..., :3], own[..., :3])
        )
        scalar = turn[..., 3:] * own[..., 3:] - (turn[..., :3] * own[..., :3]).sum(-1)[..., None]
        result = np.concatenate((place, vector, scalar), axis=-1)
    return result


def _rotated(turn: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return points (..., 3) turned by quaternions (..., 4) of about length 1."""
    length = (turn**2).sum(axis=-1)[..., None]
    cross = np.cross(turn[..., :3], point)
    twice = turn[..., 3:] * cross + np.cross(turn[..., :3], cross)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray(point + 2.0 * twice / length)
