// ---- Curvature of the paths of a body's points: circle, cubic, and the path at the pointer ----

// What a layer needs of a body, besides its pose.
const LAYER_NEEDS = {
  circle: 'inflection_diameter', ball: 'ball_point', cubic: 'ball_point', path: 'icr_velocity',
};
const CUBIC_POINTS = 720;
// A radius of curvature longer than this, in widths of the picture, is drawn as a straight line.
const STRAIGHT = 20;

// The ICR, its speed, the directions along its velocity and to the left of it, and the angular
// velocity; null where the inflection circle is not determined.
function poleMotion(body, k) {
  const { icr, icr_velocity: u, angular_velocity: rate, inflection_diameter: diameter } = body;
  if (!isFinite(diameter?.value[k]) || !isFinite(icr.x[k]) || !(u.value[k] > 0)) return null;
  const [c, s] = [u.x[k] / u.value[k], u.y[k] / u.value[k]];
  return { at: [icr.x[k], icr.y[k]], speed: u.value[k], along: [c, s], left: [-s, c], w: rate.value[k] };
}

// The center of curvature of the path of the body's point at [x, y], and its signed radius, by the
// equation of Euler and Savary; null for the ICR and where it is not determined.
function pathAt(body, k, [x, y]) {
  const pole = poleMotion(body, k);
  const w = body.angular_velocity.value[k];
  const [px, py] = pole ? pole.at : [body.icr?.x[k], body.icr?.y[k]];
  const [rx, ry] = [x - px, y - py];
  const distance = Math.hypot(rx, ry);
  if (!(distance > 0) || !isFinite(w)) return null;
  const isStill = body.icr_velocity?.value[k] === 0;
  if (!pole && !isStill) return null;
  // From the ICR to the inflection pole: -i u / w.
  const [jx, jy] = isStill ? [0, 0] : [0, 1].map((axis) => (-pole.left[axis] * pole.speed) / w);
  const across = rx * (rx - jx) + ry * (ry - jy);
  const factor = (distance * distance) / across;
  return { center: [x - rx * factor, y - ry * factor], radius: (Math.sign(w) * distance ** 3) / across };
}

// The cubic 1/r = overM / sin φ + overN / cos φ, from the curvature of the fixed centrode and Ball's
// point, which is on it; null where these are not determined.
function cubicAt(body, k, { at, along, left, speed, w }) {
  const ball = [body.ball_point.x[k] - at[0], body.ball_point.y[k] - at[1]];
  const curvature = body.centrode_curvature.value[k];
  if (!isFinite(ball[0]) || !isFinite(curvature)) return null;
  const [x, y] = [along, left].map((axis) => axis[0] * ball[0] + axis[1] * ball[1]);
  const overM = (curvature - (2 * w) / speed) / 3;
  return [overM, ((-w / speed - overM) * x) / y];
}

// Returns a function that draws the inflection circle and the cubic of a body at instant k.
function makeCurvatureDrawer(stage) {
  const { view, isOn } = stage;

  function drawCircle(context, { at, left, speed, w }) {
    const radius = speed / w / 2;
    const center = [0, 1].map((axis) => at[axis] - left[axis] * radius);
    context.setLineDash([7, 4]);
    strokeCircle(context, stage, center, Math.abs(radius), at);
    context.setLineDash([]);
  }

  function drawCubic(context, [overM, overN], { at, along, left }) {
    const [width, height] = [stage.sizes.width, stage.sizes.height];
    const longest = (2 * Math.hypot(width, height)) / view.scale
      + Math.hypot(at[0] - view.x, at[1] - view.y);
    context.beginPath();
    let isDrawn = false;
    for (let n = 0; n <= CUBIC_POINTS; n++) {
      const [c, s] = [Math.cos((n * Math.PI) / CUBIC_POINTS), Math.sin((n * Math.PI) / CUBIC_POINTS)];
      const r = (s * c) / (overM * c + overN * s);
      if (!(Math.abs(r) < longest)) {
        isDrawn = false;
        continue;
      }
      const point = [0, 1].map((axis) => at[axis] + r * (c * along[axis] + s * left[axis]));
      context[isDrawn ? 'lineTo' : 'moveTo'](...stage.toScreen(...point));
      isDrawn = true;
    }
    context.setLineDash([2, 3]);
    context.stroke();
    context.setLineDash([]);
  }

  return (context, body, k) => {
    const pole = isOn('circle') || isOn('cubic') ? poleMotion(body, k) : null;
    if (!pole) return;
    context.strokeStyle = body.color;
    context.lineWidth = 1.4;
    if (isOn('circle')) drawCircle(context, pole);
    const cubic = isOn('cubic') && body.ball_point ? cubicAt(body, k, pole) : null;
    if (cubic) drawCubic(context, cubic, pole);
  };
}

// A circle, or the line that it is nearly, through a point of it.
function strokeCircle(context, stage, center, radius, through) {
  const { width } = stage.sizes;
  const [[left, top], [x, y]] = [stage.toScreen(...center), stage.toScreen(...through)];
  const pixels = radius * stage.view.scale;
  if (pixels < STRAIGHT * width) {
    context.beginPath();
    context.arc(left, top, pixels, 0, 2 * Math.PI);
    context.stroke();
    return;
  }
  const length = Math.hypot(left - x, top - y);
  const [c, s] = [(-2 * width * (top - y)) / length, (2 * width * (left - x)) / length];
  strokeLines(context, [[x - c, y - s], [x + c, y + s]]);
}

// The circle of curvature of the path of the body's point under the pointer, its center and radius.
function drawPathCurvature(context, stage, body, k) {
  const [left, top] = stage.page.pointer;
  const point = stage.toPlane(left, top);
  const path = pathAt(body, k, point);
  context.strokeStyle = context.fillStyle = INK;
  context.lineWidth = 1.2;
  context.beginPath();
  context.arc(left, top, 3, 0, 2 * Math.PI);
  context.fill();
  if (!path) return;
  const isStraight = !(Math.abs(path.radius) * stage.view.scale < STRAIGHT * stage.sizes.width);
  strokeCircle(context, stage, path.center, Math.abs(path.radius), point);
  if (!isStraight) {
    const center = stage.toScreen(...path.center);
    context.setLineDash([3, 3]);
    strokeLines(context, [[left, top], center]);
    context.setLineDash([]);
    context.stroke(markPath('cross', ...center, 4));
  }
  const size = 1e3 * Math.abs(path.radius);
  const text = isStraight ? 'straight' : `R ${roundedTo(size, 0.1 * size)} mm`;
  drawText(context, text, left + 9, top - 9, INK);
}
