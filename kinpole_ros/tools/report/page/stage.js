// ---- The stage: the plane of the motion. What rests is on one canvas, what moves on another ----

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
  let [jump, extent, thickness, points, fastest] = [null, 1, 1, [], 0];
  let loci = new Map();
  let sizes = null;
  const moving = makeMoving({
    page, data, view, shown, on, screen, toWorld, toScreen, lociOf,
    get sizes() { return sizes; },
    get points() { return points; },
    get fastest() { return fastest; },
    get thickness() { return thickness; },
  });
  learn();

  // What the motion is like, as far as it is known; where it goes beyond all before, show all.
  function learn() {
    const known = jump && Object.values(jump).join();
    jump = frame(data, jump);
    extent = Math.hypot(jump.width, jump.height) || 1;
    thickness = 0.022 * extent;
    reshape();
    fastest = Math.max(fastest, topSpeed(data, points));
    if (sizes && !view.held && known !== Object.values(jump).join()) fit();
  }

  // Bodies that have other points than before.
  function reshape() {
    points = data.bodies.map((body) => anchors(data, body));
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

  function screen(x, y) {
    const [across, up] = [(x - view.x) * view.scale, (y - view.y) * view.scale];
    return [sizes.width / 2 + across, sizes.height / 2 - up];
  }

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
    if (!loci.has(body)) loci.set(body, lociPaths(data, body, points, (page.dragging ? 4 : 0.7) / view.scale, extent));
    return loci.get(body);
  }

  // What rests: the grid, tracks of markers, fixed centrodes.
  function rest() {
    sizes = fitted(under, page.printing);
    if (data.live || data.edited || loci.scale !== view.scale) loci = Object.assign(new Map(), { scale: view.scale });
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
      if (top > 34 && top < height - 20) context.fillText(tickWords(1e3 * y, 1e3 * step), 5, top - 3);
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
    moving.draw(context, page.k);
    page.drawOver?.(context);
  }

  // The place in the plane that is at so many pixels.
  const plane = (left, top) => [
    view.x + (left - sizes.width / 2) / view.scale, view.y + (sizes.height / 2 - top) / view.scale,
  ];

  return { fit, whole, learn, reshape, rest, move, view, screen, plane, get sizes() { return sizes; } };
}
