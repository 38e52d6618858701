// ---- The stage: the plane of the motion, what rests on one canvas and what moves on another ----

const LAYERS = {
  outlines: 'bodies', tracks: 'tracks', fixed: 'fixed centrode', moving: 'moving centrode',
  icr: 'ICR', iap: 'IAP', ijp: 'IJP', isp: 'ISP', relative: 'relative centers',
  velocities: 'velocities', names: 'names',
};
const HIDDEN = ['ijp', 'isp'];

function makeStage(element, page, data) {
  const [under, over] = element.querySelectorAll('canvas');
  const view = { x: 0, y: 0, scale: 100 };
  const shown = () => data.bodies.filter((body) => !page.hidden.has(body.name));
  const on = (layer) => !page.off.has(layer);
  const bars = new Map();
  let [jump, extent, thickness, points, fastest] = [null, 1, 1, [], 0];
  let loci = new Map();
  let sizes = null;
  learn();

  // What the motion is like, as far as it is known; where it goes beyond all before, show all.
  function learn() {
    const known = jump && Object.values(jump).join();
    jump = frame(data, jump);
    extent = Math.hypot(jump.width, jump.height) || 1;
    thickness = 0.022 * extent;
    points = data.bodies.map((body) => anchors(data, body));
    fastest = Math.max(fastest, topSpeed(data, points));
    bars.clear();
    if (sizes && !view.held && known !== Object.values(jump).join()) fit();
  }

  // All of the motion that is known now.
  function whole() {
    [jump, fastest] = [null, 0];
    learn();
    fit();
  }

  function fit() {
    sizes = fitted(under, page.printing);
    view.held = false;
    view.scale = 0.9 * Math.min(sizes.width / jump.width, sizes.height / jump.height);
    view.x = jump.x + jump.width / 2;
    view.y = jump.y + jump.height / 2;
    rest();
  }

  const screen = (x, y) => [
    sizes.width / 2 + (x - view.x) * view.scale,
    sizes.height / 2 - (y - view.y) * view.scale,
  ];

  function toWorld(context, turn = 0, x = 0, y = 0) {
    const [c, s] = [view.scale * Math.cos(turn), view.scale * Math.sin(turn)];
    const [left, top] = screen(x, y);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.scale(sizes.ratio, sizes.ratio);
    context.transform(c, -s, -s, -c, left, top);
  }

  function toScreen(context) {
    context.setTransform(sizes.ratio, 0, 0, sizes.ratio, 0, 0);
  }

  // Lines in the world, thinned for this scale: made anew when it changes.
  function lociOf(body) {
    if (!loci.has(body)) loci.set(body, lociPaths(data, body, points, 0.7 / view.scale, extent));
    return loci.get(body);
  }

  // What rests: the grid, tracks of markers, fixed centrodes.
  function rest() {
    sizes = fitted(under, page.printing);
    if (data.live || loci.scale !== view.scale) loci = Object.assign(new Map(), { scale: view.scale });
    const { context } = sizes;
    drawGrid(context);
    for (const body of shown()) {
      toWorld(context);
      context.lineJoin = 'round';
      context.strokeStyle = body.color;
      if (on('tracks')) {
        context.globalAlpha = 0.28;
        context.lineWidth = 0.9 / view.scale;
        for (const path of lociOf(body).tracks) context.stroke(path);
      }
      if (on('fixed')) {
        context.globalAlpha = 0.42;
        context.lineWidth = 4 / view.scale;
        context.stroke(lociOf(body).fixed);
      }
      context.globalAlpha = 1;
    }
    toScreen(context);
    for (const joint of data.joints) {
      const [body] = joint.bodies;
      if (joint.bodies.length === 1 && !page.hidden.has(body)) drawGround(context, joint.at[0]);
    }
    move();
  }

  function drawGrid(context) {
    const { width, height } = sizes;
    const [wide, high] = [width / view.scale, height / view.scale];
    const { step, at } = ticks(view.x - wide / 2, view.x + wide / 2, width / 90);
    context.font = '11px system-ui, sans-serif';
    context.lineWidth = 1;
    context.strokeStyle = '#edf0f2';
    context.fillStyle = '#6a737c';
    context.beginPath();
    const rows = [];
    for (let y = Math.ceil((view.y - high / 2) / step); y * step < view.y + high / 2; y++) {
      rows.push(y * step);
    }
    for (const x of at) {
      const [left] = screen(x, 0);
      context.moveTo(Math.round(left) + 0.5, 0);
      context.lineTo(Math.round(left) + 0.5, height);
    }
    for (const y of rows) {
      const [, top] = screen(0, y);
      context.moveTo(0, Math.round(top) + 0.5);
      context.lineTo(width, Math.round(top) + 0.5);
    }
    context.stroke();
    context.textAlign = 'center';
    const last = at.filter((x) => screen(x, 0)[0] < width - 72 && screen(x, 0)[0] > 30);
    for (const x of last) context.fillText(tickWords(1e3 * x, 1e3 * step), screen(x, 0)[0], height - 6);
    context.textAlign = 'left';
    for (const y of rows) {
      const top = screen(0, y)[1];
      if (top > 14 && top < height - 20) context.fillText(tickWords(1e3 * y, 1e3 * step), 5, top - 3);
    }
    const names = data.along.join(', ');
    context.textAlign = 'right';
    context.fillText(`${names} (mm)`, width - 6, height - 6);
  }

  // The sign of a pin on the ground: a triangle on hatching.
  function drawGround(context, [x, y]) {
    const [left, top] = screen(x, y);
    const r = 9;
    context.strokeStyle = '#3c444c';
    context.fillStyle = '#fff';
    context.lineWidth = 1.3;
    context.beginPath();
    context.moveTo(left, top);
    context.lineTo(left - 0.9 * r, top + 1.6 * r);
    context.lineTo(left + 0.9 * r, top + 1.6 * r);
    context.closePath();
    context.fill();
    context.moveTo(left - 1.6 * r, top + 1.6 * r);
    context.lineTo(left + 1.6 * r, top + 1.6 * r);
    for (let k = -1.5; k < 1.6; k += 0.6) {
      context.moveTo(left + k * r, top + 1.6 * r);
      context.lineTo(left + (k - 0.4) * r, top + 2.2 * r);
    }
    context.stroke();
  }

  // What moves, at the instant of the cursor.
  function move() {
    const { context } = fitted(over, page.printing);
    const k = page.k;
    const here = shown().filter((body) => isFinite(body.x[k]) && isFinite(body.angle[k]));
    for (const body of here) if (on('outlines')) drawBody(context, body, k);
    for (const body of here) if (on('moving')) drawMoving(context, body, k);
    toScreen(context);
    if (on('outlines')) drawJoints(context, here, k);
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
    const outline = outlineAt(body, k);
    const key = `${body.name} ${outline ? outline[0] : ''}`;
    if (!bars.has(key)) {
      const corners = anchors(data, body, outline);
      bars.set(key, barPath(corners.length ? corners : [[0, 0]], corners.length > 1
        ? thickness : Math.max(thickness, (body.size || 0) / 2)));
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
      context.lineTo(2 * thickness, 0);
      context.stroke();
    }
  }

  function drawMoving(context, body, k) {
    toWorld(context, body.angle[k], body.x[k], body.y[k]);
    context.strokeStyle = body.color;
    context.lineWidth = 1.5 / view.scale;
    context.setLineDash([6 / view.scale, 4 / view.scale]);
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

  function drawVelocities(context, body, k) {
    const factor = arrowLength() / (fastest || 1);
    const [w, c, s] = [
      body.angular_velocity.value[k], Math.cos(body.angle[k]), Math.sin(body.angle[k]),
    ];
    context.strokeStyle = context.fillStyle = body.color;
    context.lineWidth = 1.3;
    for (const [u, v] of points[data.bodies.indexOf(body)].concat([])) {
      const [x, y] = [c * u - s * v, s * u + c * v];
      const [vx, vy] = [body.vx[k] - w * y, body.vy[k] + w * x];
      arrow(context, screen(body.x[k] + x, body.y[k] + y), [vx * factor, -vy * factor]);
    }
  }

  const arrowLength = () => 0.16 * Math.min(sizes.width, sizes.height);

  function drawArrowScale(context) {
    const { step } = ticks(0, fastest, 2);
    if (!(fastest > 0)) return;
    const length = (step * arrowLength()) / fastest;
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
      if (on('names') && data.somePairs.length < 4) say(context, `${j.name}/${i.name}`, left + 9, top + 14, '#5b6570', 11);
    }
  }

  const inside = (x, y) => x > 0 && y > 0 && x < sizes.width && y < sizes.height;

  function drawEllipse(context, pole, k, color) {
    const [a, b] = [2 * pole.a[k] * view.scale, 2 * pole.b[k] * view.scale];
    if (!(a > 1.5) || a > 20 * sizes.width) return;
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
      const [x, y] = [left - sizes.width / 2, top - sizes.height / 2];
      const shrink = Math.max(Math.abs(x) / (sizes.width / 2 - 11), Math.abs(y) / (sizes.height / 2 - 11));
      [left, top] = [sizes.width / 2 + x / shrink, sizes.height / 2 + y / shrink];
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
      const factor = arrowLength() / (fastest || 1);
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
    const list = points[data.bodies.indexOf(body)];
    const middle = [0, 1].map((axis) => list.reduce((sum, p) => sum + p[axis], 0) / list.length);
    const [left, top] = screen(...place(body, k, list.length ? middle : [0, 0]));
    context.textAlign = 'center';
    say(context, body.name, left, top + 4, body.color, 12.5, 600);
    context.textAlign = 'left';
  }

  return { fit, whole, learn, rest, move, view, get sizes() { return sizes; } };
}
