"""What the window of frames says of one instant: derivatives, with covariance, of all bodies."""

from collections.abc import Callable
from typing import Any

import numpy as np

from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import UNSTEADY, Bodies
from kinpole_ros.tracking.center import Pins
from kinpole_ros.tracking.deformation import deformation_covariance, hold_hidden
from kinpole_ros.tracking.estimate import Estimate, FramePoses
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.plane import Plane

TOO_FEW, NO_POSE = 'too few markers seen, or all at one place', 'no pose of it came'
TOO_CLOSE = 'markers too close together for their noise'
AMBIGUOUS = 'its stamp does not tell whether it was captured before or after a lost frame'
NOISY_POSES = 'the noise of its angle is too large'


def result_at(
    bodies: Bodies,
    pins: Pins,
    history: History,
    now: int,
    oldest: int,
    interval: float,
    window: float,
    order: int,
    effort: str,
    doubtful: np.ndarray,
    posed: bool,
    derive: Callable[..., Derivatives] = derive_poses,
) -> dict[str, Any]:
    """
    Compute what the frames from `oldest` on say of the frame `now`.

    `interval` and `window` are in s, `order` is the highest derivative; `doubtful` (B,) is the
    number of the newest poses that do not count; `posed` says whether poses came as such. Returns
    fields of `Estimate` for one instant, derivatives with an axis of one instant.
    """
    newest = len(history) - 1
    rows = slice(oldest, newest + 1)
    pin, variance = pins_of_window(bodies, pins, history, oldest)
    hub = bodies.hub
    if posed:
        # The errors of its position and of the angle are independent, as they are taken to be.
        hub = np.where(hub == 0, bodies.middle, hub)
    hub = np.where(np.isfinite(pin), 0.0, hub)
    noise = np.where(bodies.noise > 0, bodies.noise, 1.0)
    angle = heading = history['angle'][rows]
    tilted = posed and bool(history['extra_turn'][rows].any())
    if tilted:
        # Rates are those of the rotation in space, and so is the motion of the hub.
        angle = angle + history['extra_turn'][rows] - bodies.extra_turn
    position, information = poses_of_hubs(bodies, history, rows, hub, angle)
    poses = Poses(
        history['time'][rows],
        angle,
        history['turns'][rows],
        position,
        information[:, 0],
        information[:, 1],
    )
    windows = Windows(np.array([now - oldest]), np.array([0]), np.array([newest - oldest]))
    how = windows, doubtful[None], noise[None], window, order, effort
    found = derive(poses, *how)
    if tilted:
        # The angle itself is the heading; the hub has turned by the angle.
        of_heading = derive(poses._replace(angle=heading), *how).angle[0]
        hub = hub * np.exp(1j * np.nan_to_num(found.angle[0, 0] - of_heading[0]))
        found.angle[0] = of_heading
    seen = (history['information'][now] > 0).all(axis=0) & (now <= newest - doubtful)
    measured = np.isfinite(bodies.noise)
    observable = bodies.noise**2 < UNSTEADY**2 * bodies.spread
    if posed:
        observable = bodies.angle_noise < UNSTEADY
    usable = seen & measured & observable
    for b in np.flatnonzero(usable & (bodies.freedom > 0)).tolist():
        slow = _deformation(bodies, history, b, now, oldest, interval, found, order)
        found.angle_covariance[:, :, 0, b] += slow / information[now - oldest, 0, b]
        found.position_covariance[:, :, 0, b] += slow / information[now - oldest, 1, b]
    missing = np.full(bodies.count, '', object)
    enough = np.isfinite(found.angle[1, 0]) & np.isfinite(found.position[1, 0])
    missing[~enough] = 'window not full'
    missing[~observable] = NOISY_POSES if posed else TOO_CLOSE
    missing[~measured] = 'noise not known yet'
    missing[~seen] = NO_POSE if posed else TOO_FEW
    if history['ambiguous'][now]:
        missing[:] = AMBIGUOUS
    for part in found:
        part[..., 0, ~usable] = np.nan
    return {
        'stamp': history['stamp'][now],
        'found': found,
        'size': bodies.size.copy(),
        'height': history['height'][now].copy(),
        'missing': missing,
        'pin': pin,
        'pin_variance': variance,
        'shape': bodies.markers(),
        'reference': hub,
        'angle': history['angle'][now] + 2 * np.pi * history['turns'][now],
        'position': history['position'][now].copy(),
        'information': np.where(seen, history['information'][now] * bodies.scale, 0.0),
        'middle': bodies.middle if posed else middle_of_seen(bodies, history['used'][now]),
        'noise': noise,
    }


def middle_of_seen(bodies: Bodies, used: np.ndarray) -> Complex:
    """Weighted means (B,) of the markers that are `used` (B, n), in the axes of the bodies."""
    if used.all():
        return bodies.middle
    weights = np.where(used, bodies.weights, 0.0)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray((weights * bodies.shape).sum(axis=-1) / weights.sum(axis=-1))


def pins_of_window(
    bodies: Bodies, pins: Pins, history: History, oldest: int
) -> tuple[Complex, Real]:
    """Pins (B,) that hold for the window from `oldest` on, NaN for none, and their variances."""
    held = np.isfinite(pins.center)
    if held.any():
        rows = slice(oldest, None)
        held &= pins.since <= history['time'][oldest]
        information = history['information'][rows] * bodies.scale
        with np.errstate(divide='ignore', invalid='ignore'):
            off = pins.off(
                history['position'][rows], history['angle'][rows], bodies.error / information
            )
        held &= (off & (information > 0).all(axis=1)).sum(axis=0) < 3
    return np.where(held, pins.center, np.nan), np.where(held, pins.variance, np.nan)


def poses_of_hubs(
    bodies: Bodies, history: History, rows: slice, hub: Complex, angle: Real
) -> tuple[Complex, Real]:
    """Positions (N, B) of the hubs of bodies turned by `angle`, and the information (N, 2, B)."""
    position = history['position'][rows]
    information = history['information'][rows] * bodies.scale
    if not hub.any():
        return position, information
    position = position + hub * np.exp(1j * angle)
    turned, placed = information[:, 0], information[:, 1]
    seen = placed > 0
    # Farther from the middle of the markers the error of the angle tells more.
    nearer, farther = np.abs(bodies.middle) ** 2, np.abs(hub - bodies.middle) ** 2
    share = np.divide(placed, turned, out=np.zeros_like(placed), where=seen)
    left = np.maximum(1 - nearer * share, 0.0) + farther * share
    # Without its other markers a body that keeps its origin may seem to lie far from its middle.
    np.divide(placed, left, out=placed, where=seen & (left > 0) & (hub != 0))
    return position, information


def _deformation(
    bodies: Bodies,
    history: History,
    b: int,
    now: int,
    oldest: int,
    interval: float,
    found: Any,
    order: int,
) -> Real:
    """Covariance of what the deformation of one body adds, over its information."""
    first = max(0, oldest - (len(history) - oldest))
    residual = hold_hidden(history['residual'][first:, b : b + 1])[:, 0]
    return deformation_covariance(
        residual,
        now - first,
        oldest - first,
        interval,
        float(found.span[0, b]),
        float(found.freedom[0, b]) - 1,
        float(bodies.noise[b] * np.sqrt(bodies.held[b])),
        float(bodies.freedom[b]),
        order,
    )


def estimate_of(
    results: list[dict[str, Any]],
    frame_id: str,
    bodies: tuple[str, ...],
    run: int,
    plane: Plane | None,
) -> Estimate:
    """Results of several instants as one estimate."""

    def stacked(name: str) -> np.ndarray:
        return np.stack([each[name] for each in results])

    position, angle, position_covariance, angle_covariance, span, freedom = (
        np.concatenate([each['found'][k] for each in results], axis=-2) for k in range(6)
    )

    def frame_poses() -> FramePoses:
        information = stacked('information')
        return FramePoses(
            stacked('angle'),
            stacked('position'),
            information[:, 0],
            information[:, 1],
            stacked('middle'),
            stacked('noise'),
        )

    return Estimate(
        stacked('stamp'),
        frame_id,
        bodies,
        position,
        angle,
        position_covariance,
        angle_covariance,
        stacked('size'),
        stacked('height'),
        span,
        freedom - 1,
        stacked('missing'),
        run,
        stacked('pin'),
        stacked('pin_variance'),
        stacked('shape'),
        np.array([each['due'] for each in results]),
        stacked('reference'),
        plane,
        frame_poses,
    )
