// ---- What moves on the stage: bodies, joints, velocities, poles at one instant ----

// Draws by what a `stage` knows: how it lies on the canvas, and what the motion is like.
function makeMoving(stage) {
  const { page, data, view, shown, on, screen, toWorld, toScreen, lociOf } = stage;
  // Of the points that the stage knows of.
  let [bars, barsOf] = [new Map(), null];

  function draw(context, k) {
    const here = shown().filter((body) => isFinite(body.x[k]) && isFinite(body.angle[k]));
    for (const body of here) if (on('outlines')) drawBody(context, body, k);
    for (const body of here) if (on('moving')) drawMoving(context, body, k);
    toScreen(context);
    if (on('outlines')) drawJoints(context, here, k);
    if (on('outlines')) for (const belt of data.belts ?? []) drawBelt(context, belt, k);
    for (const body of here) if (on('velocities')) drawVelocities(context, body, k);
    if (on('relative')) drawRelative(context, k);
    for (const name of [...POLES].reverse()) {
      for (const body of here) if (on(name) && body[name]) drawPole(context, body, name, k);
    }
    if (on('names')) for (const body of here) drawName(context, body, k);
    if (on('velocities')) drawArrowScale(context);
    if (!here.length) {
      const why = shown().length ? reasonAt(shown()[0], '', k) || 'nothing known' : 'nothing shown';
      say(context, `${why} at this instant`, 12, 22, '#5b6570');
    }
  }

  function barOf(body, k) {
    if (barsOf !== stage.points) [bars, barsOf] = [new Map(), stage.points];
    const outline = outlineAt(body, k);
    const key = `${body.name} ${outline ? outline[0] : ''}`;
    if (!bars.has(key)) {
      bars.set(key, outlinePath(anchors(data, body, outline), rimsOf(body), stage.thickness, body.size));
    }
    return bars.get(key);
  }

  function drawBody(context, body, k) {
    toWorld(context, body.angle[k], body.x[k], body.y[k]);
    const path = barOf(body, k);
    context.fillStyle = body.color;
    context.strokeStyle = body.color;
    context.globalAlpha = 0.16;
    context.fill(path);
    context.globalAlpha = 1;
    context.lineWidth = 1.8 / view.scale;
    context.stroke(path);
    const markers = outlineAt(body, k)?.[1] ?? [];
    context.beginPath();
    for (const [u, v] of markers) {
      context.moveTo(u + 2.6 / view.scale, v);
      context.arc(u, v, 2.6 / view.scale, 0, 2 * Math.PI);
    }
    context.fill();
    if (!markers.length) {
      // The frame of the body shows its turn, where its markers are not known.
      context.beginPath();
      context.moveTo(0, 0);
      context.lineTo(2 * stage.thickness, 0);
      context.stroke();
    }
  }

  function drawMoving(context, body, k) {
    toWorld(context, body.angle[k], body.x[k], body.y[k]);
    context.strokeStyle = body.color;
    context.lineWidth = 1.5 / view.scale;
    // Dashes cost a browser without a graphics card a sixth of a frame.
    if (!page.dragging) context.setLineDash([6 / view.scale, 4 / view.scale]);
    context.stroke(lociOf(body).moving);
    context.setLineDash([]);
  }

  function place(body, k, [u, v]) {
    const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
    return [body.x[k] + c * u - s * v, body.y[k] + s * u + c * v];
  }

  function drawJoints(context, here, k) {
    context.lineWidth = 1.6;
    context.strokeStyle = '#1c2127';
    context.fillStyle = '#fff';
    for (const joint of data.joints) {
      const body = data.byName[joint.bodies[0]];
      if (!here.includes(body)) continue;
      const [left, top] = screen(
        ...(joint.bodies.length > 1 ? place(body, k, joint.at[0]) : joint.at[0]),
      );
      context.beginPath();
      context.arc(left, top, 5.5, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }

  // The strands of a belt, each on the same sides of its wheels as the radii are.
  function drawBelt(context, { ends, closed }, k) {
    const [a, b] = ends.map(({ body, at }) => (body ? place(data.byName[body], k, at) : at));
    const [x, y] = [b[0] - a[0], b[1] - a[1]];
    context.strokeStyle = '#1c2127';
    context.lineWidth = 1.6;
    context.beginPath();
    for (const side of closed ? [1, -1] : [1]) {
      const [first, last] = ends.map(({ radius }) => side * radius);
      const length = Math.sqrt(x * x + y * y - (first - last) ** 2);
      const square = x * x + y * y;
      // The direction of the strand, (x + i y) / (length + i (first - last)).
      const c = (x * length + y * (first - last)) / square;
      const s = (y * length - x * (first - last)) / square;
      context.moveTo(...screen(a[0] - first * s, a[1] + first * c));
      context.lineTo(...screen(b[0] - last * s, b[1] + last * c));
    }
    context.stroke();
  }

  function drawVelocities(context, body, k) {
    const factor = arrowLength() / (stage.fastest || 1);
    const [w, c, s] = [
      body.angular_velocity.value[k], Math.cos(body.angle[k]), Math.sin(body.angle[k]),
    ];
    context.strokeStyle = context.fillStyle = body.color;
    context.lineWidth = 1.3;
    for (const [u, v] of stage.points[data.bodies.indexOf(body)].concat([])) {
      const [x, y] = [c * u - s * v, s * u + c * v];
      const [vx, vy] = [body.vx[k] - w * y, body.vy[k] + w * x];
      arrow(context, screen(body.x[k] + x, body.y[k] + y), [vx * factor, -vy * factor]);
    }
  }

  const arrowLength = () => 0.16 * Math.min(stage.sizes.width, stage.sizes.height);

  function drawArrowScale(context) {
    const { step } = ticks(0, stage.fastest, 2);
    if (!(stage.fastest > 0)) return;
    const length = (step * arrowLength()) / stage.fastest;
    context.strokeStyle = context.fillStyle = '#5b6570';
    context.lineWidth = 1.3;
    arrow(context, [12, 14], [length, 0]);
    say(context, `${tickWords(step, step)} m/s`, 18 + length, 18, '#5b6570');
  }

  function drawRelative(context, k) {
    for (const { j, i, icr } of data.somePairs) {
      if (page.hidden.has(j.name) || page.hidden.has(i.name) || !isFinite(icr.x[k])) continue;
      const [left, top] = screen(icr.x[k], icr.y[k]);
      if (!inside(left, top)) continue;
      drawEllipse(context, icr, k, '#5b6570');
      context.strokeStyle = '#fff';
      context.lineWidth = 3.5;
      const mark = markPath('cross', left, top, 5);
      context.stroke(mark);
      context.strokeStyle = '#1c2127';
      context.lineWidth = 1.1;
      context.stroke(mark);
      if (!on('names') || data.somePairs.length > 3) continue;
      const name = `${j.name}/${i.name}`;
      context.font = '11px system-ui, sans-serif';
      const room = stage.sizes.width - 4 - context.measureText(name).width;
      say(context, name, Math.min(left + 9, room), top + 14, '#5b6570', 11);
    }
  }

  const inside = (x, y) => x > 0 && y > 0 && x < stage.sizes.width && y < stage.sizes.height;

  function drawEllipse(context, pole, k, color) {
    const [a, b] = [2 * pole.a[k] * view.scale, 2 * pole.b[k] * view.scale];
    if (!(a > 1.5) || a > 20 * stage.sizes.width) return;
    context.beginPath();
    const [left, top] = screen(pole.x[k], pole.y[k]);
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
    let [left, top] = screen(pole.x[k], pole.y[k]);
    const out = !inside(left, top);
    if (out) {
      // A pole that is not in the picture: a hollow mark on the edge, toward it.
      const [midX, midY] = [stage.sizes.width / 2, stage.sizes.height / 2];
      const [x, y] = [left - midX, top - midY];
      const shrink = Math.max(Math.abs(x) / (midX - 11), Math.abs(y) / (midY - 11));
      [left, top] = [midX + x / shrink, midY + y / shrink];
    }
    const mark = markPath(MARKS[name], left, top, out ? 4 : name === 'icr' ? 5 : 6);
    context.globalAlpha = out ? 0.6 : 1;
    context.lineWidth = 4;
    context.strokeStyle = '#fff';
    context.stroke(mark);
    context.fillStyle = name === 'icr' && !out ? body.color : '#fff';
    context.fill(mark);
    context.strokeStyle = body.color;
    context.lineWidth = 1.8;
    context.stroke(mark);
    context.globalAlpha = 1;
    if (name === 'icr' && !out && on('velocities') && moves(body, k)) {
      const u = body.icr_velocity;
      const factor = arrowLength() / (stage.fastest || 1);
      context.strokeStyle = context.fillStyle = '#1c2127';
      context.lineWidth = 2;
      const length = u.value[k] * factor;
      const shrink = Math.min(1, (2.5 * arrowLength()) / length);
      arrow(context, [left, top], [u.x[k] * factor * shrink, -u.y[k] * factor * shrink], shrink < 1);
    }
  }

  // Whether the ICR goes anywhere, as far as is known.
  function moves(body, k) {
    const u = body.icr_velocity;
    if (!u || !(u.value[k] > 0)) return false;
    return u.sigma[k] > 0 ? u.value[k] > 2 * u.sigma[k]
      : !reasonAt(body, 'centrode_curvature', k).startsWith('pinned');
  }

  function drawName(context, body, k) {
    const list = stage.points[data.bodies.indexOf(body)];
    const middle = [0, 1].map((axis) => list.reduce((sum, p) => sum + p[axis], 0) / list.length);
    const [left, top] = screen(...place(body, k, list.length ? middle : [0, 0]));
    context.textAlign = 'center';
    say(context, body.name, left, top + 4, body.color, 12.5, 600);
    context.textAlign = 'left';
  }

  return { draw };
}
