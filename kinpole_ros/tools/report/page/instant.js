// ---- The instant at the cursor on the stage: bodies, joints, velocities and poles ----

// Returns a function that draws instant k.
function makeInstantDrawer(stage) {
  const { page, data, view, isOn, shownBodies } = stage;
  const drawCurvature = makeCurvatureDrawer(stage);
  // Outlines of bodies, for the points that the stage has.
  let [outlines, outlinePoints] = [new Map(), null];

  function draw(context, k) {
    const bodies = shownBodies().filter((body) => isFinite(body.x[k]) && isFinite(body.angle[k]));
    if (isOn('outlines')) {
      for (const shape of data.shapes ?? []) drawShape(context, shape, k);
      for (const body of bodies) drawBody(context, body, k);
    }
    if (isOn('moving')) for (const body of bodies) drawMovingCentrode(context, body, k);
    stage.usePixels(context);
    if (isOn('outlines')) {
      for (const span of data.spans ?? []) drawSpan(context, span, k);
      drawJoints(context, bodies, k);
      for (const belt of data.belts ?? []) drawBelt(context, belt, k);
    }
    if (isOn('velocities')) for (const body of bodies) drawVelocities(context, body, k);
    if (isOn('relative')) drawRelativeCenters(context, k);
    for (const body of bodies) drawCurvature(context, body, k);
    if (isOn('path')) drawPathAtPointer(context, bodies, k);
    for (const name of [...POLES].reverse()) {
      for (const body of bodies) if (isOn(name) && body[name]) drawPole(context, body, name, k);
    }
    for (const body of bodies) {
      if (isOn('ball') && body.ball_point) drawPole(context, body, 'ball_point', k);
    }
    if (isOn('names')) drawNames(context, bodies, k);
    if (isOn('velocities')) drawArrowScale(context);
    if (!bodies.length) {
      const [first] = shownBodies();
      const reason = first ? reasonAt(first, '', k) || 'nothing known' : 'nothing shown';
      drawText(context, `${reason} at this instant`, 12, 22, GRAY);
    }
  }

  function outlineOf(body, k) {
    if (outlinePoints !== stage.points) [outlines, outlinePoints] = [new Map(), stage.points];
    const outline = outlineAt(body, k);
    const key = `${body.name} ${outline ? outline[0] : ''}`;
    if (!outlines.has(key)) {
      const points = drawnPoints(data, body, outline);
      outlines.set(key, outlinePath(points, body.rims ?? [], stage.thickness, body.size));
    }
    return outlines.get(key);
  }

  function drawBody(context, body, k) {
    stage.useMeters(context, body.angle[k], body.x[k], body.y[k]);
    const path = outlineOf(body, k);
    context.fillStyle = context.strokeStyle = body.color;
    context.globalAlpha = 0.16;
    context.fill(path);
    context.globalAlpha = 1;
    context.lineWidth = 1.8 / view.scale;
    context.stroke(path);
    const markers = outlineAt(body, k)?.[1] ?? [];
    const radius = 2.6 / view.scale;
    context.beginPath();
    for (const [u, v] of markers) {
      context.moveTo(u + radius, v);
      context.arc(u, v, radius, 0, 2 * Math.PI);
    }
    context.fill();
    // A body without markers shows its angle by an axis.
    if (!markers.length) strokeLines(context, [[0, 0], [2 * stage.thickness, 0]]);
  }

  // The body under the pointer, or the only one that is shown.
  function drawPathAtPointer(context, bodies, k) {
    if (!page.pointer) return;
    const isUnder = (body) => {
      stage.useMeters(context, body.angle[k], body.x[k], body.y[k]);
      const { ratio } = stage.sizes;
      return context.isPointInPath(outlineOf(body, k), page.pointer[0] * ratio, page.pointer[1] * ratio);
    };
    const body = bodies.length === 1 ? bodies[0] : [...bodies].reverse().find(isUnder);
    stage.usePixels(context);
    if (body) drawPathCurvature(context, stage, body, k);
  }

  function drawMovingCentrode(context, body, k) {
    stage.useMeters(context, body.angle[k], body.x[k], body.y[k]);
    context.strokeStyle = body.color;
    context.lineWidth = 1.5 / view.scale;
    // Without a graphics card, dashes take a sixth of the time of a frame.
    if (!page.dragging) context.setLineDash([6 / view.scale, 4 / view.scale]);
    context.stroke(stage.pathsOf(body).moving);
    context.setLineDash([]);
  }

  function drawJoints(context, bodies, k) {
    context.lineWidth = 1.6;
    context.strokeStyle = INK;
    context.fillStyle = '#fff';
    for (const joint of data.joints) {
      const body = data.byName[joint.bodies[0]];
      if (!bodies.includes(body)) continue;
      const at = joint.bodies.length > 1 ? pointAt(body, k, joint.at[0]) : joint.at[0];
      context.beginPath();
      context.arc(...stage.toScreen(...at), 5.5, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }

  // A cam, a Geneva wheel or a slot on a body, or a circle of the ground.
  function drawShape(context, { body, kind, points }, k) {
    const { angle, x, y, color } = data.byName[body] ?? {};
    if (x && (page.hidden.has(body) || !isFinite(x[k]))) return;
    if (x) stage.useMeters(context, angle[k], x[k], y[k]);
    else stage.useMeters(context, 0, 0, 0);
    context.strokeStyle = kind === 'guide' ? GRAY : color ?? INK;
    context.lineWidth = (kind === 'guide' ? 3 : 1.4) / view.scale;
    context.globalAlpha = kind === 'guide' ? 0.35 : 1;
    strokeLines(context, points);
    context.globalAlpha = 1;
  }

  // The points at which a span or belt ends.
  const endsAt = (ends, k) => ends.map(({ body, at }) => (body ? pointAt(data.byName[body], k, at) : at));

  // A cylinder or spring: points are shares of the way between its ends, m along and m to the left.
  function drawSpan(context, { ends, least, lines }, k) {
    const [a, b] = endsAt(ends, k);
    const [x, y] = [b[0] - a[0], b[1] - a[1]];
    const length = Math.hypot(x, y);
    if (!(length > 0)) return;
    const [c, s] = [x / length, y / length];
    const shrink = Math.min(1, length / least);
    context.strokeStyle = INK;
    context.lineWidth = 1.4;
    strokeLines(context, ...lines.map((line) => line.map(([share, along, left]) => {
      const way = share * length + shrink * along;
      return stage.toScreen(a[0] + c * way - s * left, a[1] + s * way + c * left);
    })));
  }

  // The strands of a belt, each on the side of its wheels that the signs of the radii say.
  function drawBelt(context, { ends, closed }, k) {
    const [a, b] = endsAt(ends, k);
    const [x, y] = [b[0] - a[0], b[1] - a[1]];
    const square = x * x + y * y;
    context.strokeStyle = INK;
    context.lineWidth = 1.6;
    for (const side of closed ? [1, -1] : [1]) {
      const [first, last] = ends.map(({ radius }) => side * radius);
      const length = Math.sqrt(square - (first - last) ** 2);
      // The direction of the strand, (x + i y) / (length + i (first - last)).
      const c = (x * length + y * (first - last)) / square;
      const s = (y * length - x * (first - last)) / square;
      strokeLines(context, [
        stage.toScreen(a[0] - first * s, a[1] + first * c),
        stage.toScreen(b[0] - last * s, b[1] + last * c),
      ]);
    }
  }

  const longestArrow = () => 0.16 * Math.min(stage.sizes.width, stage.sizes.height);
  const arrowScale = () => longestArrow() / (stage.fastest || 1); // pixels per m/s

  function drawVelocities(context, body, k) {
    const scale = arrowScale();
    context.strokeStyle = context.fillStyle = body.color;
    context.lineWidth = 1.3;
    for (const point of stage.points[data.bodies.indexOf(body)]) {
      const [vx, vy] = velocityAt(body, k, point);
      const tail = stage.toScreen(...pointAt(body, k, point));
      drawArrow(context, tail, [vx * scale, -vy * scale]);
    }
  }

  function drawArrowScale(context) {
    if (!(stage.fastest > 0)) return;
    const { step } = ticks(0, stage.fastest, 2);
    const length = (step * longestArrow()) / stage.fastest;
    context.strokeStyle = context.fillStyle = GRAY;
    context.lineWidth = 1.3;
    // Below the buttons, which fill the width of a telephone.
    const top = stage.sizes.height - 34;
    drawArrow(context, [12, top], [length, 0]);
    drawText(context, `${tickText(step, step)} m/s`, 18 + length, top + 4, GRAY);
  }

  const isInside = (x, y) => x > 0 && y > 0 && x < stage.sizes.width && y < stage.sizes.height;

  // The pairs of bodies that are shown, with a relative center in the picture.
  const drawnPairs = (k) => data.shownPairs.filter(({ j, i, icr }) => !page.hidden.has(j.name)
    && !page.hidden.has(i.name) && isInside(...stage.toScreen(icr.x[k], icr.y[k])));

  function drawRelativeCenters(context, k) {
    for (const { icr } of drawnPairs(k)) {
      const [left, top] = stage.toScreen(icr.x[k], icr.y[k]);
      drawEllipse(context, icr, k, GRAY);
      const mark = markPath('cross', left, top, 5);
      for (const [color, width] of [['#fff', 3.5], [INK, 1.1]]) {
        context.strokeStyle = color;
        context.lineWidth = width;
        context.stroke(mark);
      }
    }
  }

  // The ellipse of two standard deviations.
  function drawEllipse(context, pole, k, color) {
    const [a, b] = [2 * pole.a[k] * view.scale, 2 * pole.b[k] * view.scale];
    if (!(a > 1.5) || a > 20 * stage.sizes.width) return;
    context.beginPath();
    const [left, top] = stage.toScreen(pole.x[k], pole.y[k]);
    context.ellipse(left, top, a, Math.max(b, 0.5), -(pole.d[k] || 0), 0, 2 * Math.PI);
    context.fillStyle = context.strokeStyle = color;
    context.globalAlpha = 0.15;
    context.fill();
    context.globalAlpha = 0.8;
    context.lineWidth = 1;
    context.stroke();
    context.globalAlpha = 1;
  }

  function drawPole(context, body, name, k) {
    const pole = body[name];
    if (!isFinite(pole.x[k])) return;
    drawEllipse(context, pole, k, body.color);
    let [left, top] = stage.toScreen(pole.x[k], pole.y[k]);
    const isOutside = !isInside(left, top);
    if (isOutside) {
      // A hollow mark on the edge, in the direction of the pole.
      const [midX, midY] = [stage.sizes.width / 2, stage.sizes.height / 2];
      const [x, y] = [left - midX, top - midY];
      const shrink = Math.max(Math.abs(x) / (midX - 11), Math.abs(y) / (midY - 11));
      [left, top] = [midX + x / shrink, midY + y / shrink];
    }
    const isIcr = name === 'icr';
    const mark = markPath(MARKS[name], left, top, isOutside ? 4 : isIcr ? 5 : 6);
    context.globalAlpha = isOutside ? 0.6 : 1;
    context.lineWidth = 4;
    context.strokeStyle = '#fff';
    context.stroke(mark);
    context.fillStyle = isIcr && !isOutside ? body.color : '#fff';
    context.fill(mark);
    context.strokeStyle = body.color;
    context.lineWidth = 1.8;
    context.stroke(mark);
    context.globalAlpha = 1;
    if (isIcr && !isOutside && isOn('velocities') && icrMoves(body, k)) {
      const u = body.icr_velocity;
      const scale = arrowScale();
      const shrink = Math.min(1, (2.5 * longestArrow()) / (u.value[k] * scale));
      context.strokeStyle = context.fillStyle = INK;
      context.lineWidth = 2;
      const vector = [u.x[k] * scale * shrink, -u.y[k] * scale * shrink];
      drawArrow(context, [left, top], vector, shrink < 1);
    }
  }

  // Whether the ICR moves measurably.
  function icrMoves(body, k) {
    const u = body.icr_velocity;
    if (!u || !(u.value[k] > 0)) return false;
    if (u.sigma[k] > 0) return u.value[k] > 2 * u.sigma[k];
    return !reasonAt(body, 'centrode_curvature', k).startsWith('pinned');
  }

  function drawNames(context, bodies, k) {
    const drawLabel = makeLabels(context);
    context.textAlign = 'center';
    for (const body of bodies) {
      const points = stage.points[data.bodies.indexOf(body)];
      const mean = [0, 1].map((axis) => points.reduce((sum, p) => sum + p[axis], 0) / points.length);
      const [left, top] = stage.toScreen(...pointAt(body, k, points.length ? mean : [0, 0]));
      drawLabel(body.name, left, top + 4, body.color, 12.5, 600);
    }
    context.textAlign = 'left';
    if (!isOn('relative') || data.shownPairs.length > 3) return;
    for (const { j, i, icr } of drawnPairs(k)) {
      const [left, top] = stage.toScreen(icr.x[k], icr.y[k]);
      const name = `${j.name}/${i.name}`;
      context.font = `11${FONT}`;
      const rightmost = stage.sizes.width - 4 - context.measureText(name).width;
      drawLabel(name, Math.min(left + 9, rightmost), top + 14, GRAY, 11);
    }
  }

  return draw;
}
