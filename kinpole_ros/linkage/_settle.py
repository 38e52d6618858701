"""
Bodies once more, by their motion: which markers really go with them.

A distance to a marker near the axis of a pin hardly changes; where a body has been in every frame
tells more.
"""

import numpy as np

from kinpole_ros.linkage._poses import Pose, fit_body, off_body, off_body_all
from kinpole_ros.linkage._rigid import Groups
from kinpole_ros.planar._plane import Complex

# Times the deviation of the body's own markers that another may be off it and still be on it.
_ON = 2.0
# Deviations that a marker on a pin's axis may be off either body.
_SHARED = 1.3


def settle(tracks: Complex, groups: Groups) -> tuple[Groups, list[Pose]]:
    """`groups` of tracks (T, N) with what is fixed on each body and no more, and their poses."""
    count = tracks.shape[1]
    poses = [fit_body(tracks[:, body]) for body in groups.bodies]
    usual = float(np.median([pose.noise for pose in poses if pose.noise > 0] or [0.0]))
    bodies = [list(body) for body in groups.bodies]
    for body, pose in zip(bodies, poses, strict=True):
        if len(body) > 2:
            off, _ = off_body_all(pose, tracks, usual)
            limit = _ON * max(1.0, float(np.median(off[body])))
            body += [k for k in np.flatnonzero(off < limit).tolist() if k not in body]
    for k in range(count):
        holders = [body for body in bodies if k in body and len(body) > 2]
        if len(holders) > 1:
            # How far it is off the others of each: its own share in a fit hides it.
            without = [fit_body(tracks[:, [m for m in body if m != k]]) for body in holders]
            far = [off_body(pose, tracks[:, k], usual)[0] for pose in without]
            for body, distance in zip(holders, far, strict=True):
                if distance > max(_SHARED, 1.3 * min(far)):
                    body.remove(k)
    sets = [set(body) for body in bodies]
    kept = [
        sorted(body)
        for k, body in enumerate(sets)
        if len(body) > 1 and body not in sets[:k] and not any(body < other for other in sets)
    ]
    if kept != groups.bodies:
        poses = [fit_body(tracks[:, body]) for body in kept]
    both = [(body, pose) for body, pose in zip(kept, poses, strict=True) if pose.seen.any()]
    kept, poses = [body for body, _ in both], [pose for _, pose in both]
    held = {k for body in kept for k in body}
    single = [k for k in range(count) if k not in held and k not in groups.fixed]
    return groups._replace(bodies=kept, single=single), poses
