// ---- What of the motion the stage needs once: where it all is, how fast, along which lines ----

const SAMPLES = 400;

// Points of a body that are drawn, in its frame: markers of an outline, and pins.
function anchors(data, body, outline = body.outlines[0]) {
  const found = outline ? outline[1].map((point) => [...point]) : [];
  for (const joint of data.joints) {
    const place = joint.bodies.indexOf(body.name);
    if (place < 0) continue;
    const at = joint.bodies.length > 1 ? joint.at[place] : inBody(body, joint.at[0]);
    if (at) found.push(at);
  }
  return found;
}

// Circles of a body that roll, in its frame: x and y of the middle, and the radius.
const rimsOf = (body) => body.rims ?? [];

// A point of the ground in the frame of a body that turns about it.
function inBody(body, [x, y]) {
  const k = body.x.findIndex((value) => isFinite(value));
  if (k < 0) return null;
  const [u, v] = [x - body.x[k], y - body.y[k]];
  const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
  return [c * u + s * v, c * v - s * u];
}

function* someInstants(data) {
  const step = Math.max(1, Math.floor(data.n / SAMPLES));
  for (let k = 0; k < data.n; k += step) yield k;
}

// The box of all bodies over time, and of the ICRs that are near to it; and of what was `before`.
function frame(data, before) {
  const box = { low: [Infinity, Infinity], high: [-Infinity, -Infinity] };
  const take = (x, y) => {
    if (!isFinite(x) || !isFinite(y)) return;
    box.low = [Math.min(box.low[0], x), Math.min(box.low[1], y)];
    box.high = [Math.max(box.high[0], x), Math.max(box.high[1], y)];
  };
  for (const body of data.bodies) {
    const list = anchors(data, body);
    for (const k of someInstants(data)) {
      const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
      for (const [u, v] of list.length ? list : [[0, 0]]) {
        take(body.x[k] + c * u - s * v, body.y[k] + s * u + c * v);
      }
      for (const [u, v, r] of rimsOf(body)) {
        const [x, y] = [body.x[k] + c * u - s * v, body.y[k] + s * u + c * v];
        take(x - r, y - r);
        take(x + r, y + r);
      }
    }
  }
  const [x, y] = [0, 1].map((axis) => (box.low[axis] + box.high[axis]) / 2);
  const reach = 0.6 * Math.max(box.high[0] - box.low[0], box.high[1] - box.low[1]);
  for (const { icr } of data.bodies) {
    for (const k of icr ? someInstants(data) : []) {
      const near = Math.abs(icr.x[k] - x) < reach && Math.abs(icr.y[k] - y) < reach;
      if (near) take(icr.x[k], icr.y[k]);
    }
  }
  if (!isFinite(box.low[0])) return before ?? { x: -0.5, y: -0.5, width: 1, height: 1, empty: true };
  if (before && !before.empty) {
    take(before.x, before.y);
    take(before.x + before.width, before.y + before.height);
  }
  const least = 1e-6 + 0.1 * Math.hypot(box.high[0] - box.low[0], box.high[1] - box.low[1]);
  const [width, height] = [0, 1].map((axis) => Math.max(box.high[axis] - box.low[axis], least));
  return { x: box.low[0], y: box.low[1], width, height };
}

// The speed that 98% of the drawn points stay below, m/s.
function topSpeed(data, points) {
  const speeds = [];
  data.bodies.forEach((body, b) => {
    for (const k of someInstants(data)) {
      const w = body.angular_velocity.value[k];
      const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
      for (const [u, v] of points[b]) {
        speeds.push(Math.hypot(body.vx[k] - w * (s * u + c * v), body.vy[k] + w * (c * u - s * v)));
      }
    }
  });
  const known = speeds.filter(isFinite).sort((a, b) => a - b);
  return known.length ? quantile(known, 0.98) : 0;
}

// Paths of markers and fixed centrode in the plane, of the moving centrode in the body.
function lociPaths(data, body, points, step, extent) {
  const gap = (k) => data.t[k] - data.t[k - 1] > 2.5 * data.period;
  const cos = body.angle.map(Math.cos);
  const sin = body.angle.map(Math.sin);
  const list = (body.outlines[0]?.[1] ?? []).length ? body.outlines[0][1] : [[0, 0]];
  const tracks = list.map(([u, v]) =>
    thinPath(
      body.x.map((x, k) => x + cos[k] * u - sin[k] * v),
      body.y.map((y, k) => y + sin[k] * u + cos[k] * v),
      step,
      gap,
    ),
  );
  const { icr } = body;
  if (!icr) return { tracks, fixed: new Path2D(), moving: new Path2D() };
  // Where noise alone would draw a star across the picture there is no line.
  const sharp = (k) => !(icr.a[k] > 0.02 * extent);
  const x = icr.x.map((value, k) => (sharp(k) ? value : NaN));
  const y = icr.y;
  const rate = body.angular_velocity.value;
  // On its way through infinity the pole comes back from the other side.
  const broken = (k) =>
    gap(k) || rate[k] * rate[k - 1] < 0 || Math.hypot(x[k] - x[k - 1], y[k] - y[k - 1]) > extent / 2;
  const [dx, dy] = [x.map((value, k) => value - body.x[k]), y.map((value, k) => value - body.y[k])];
  const moving = thinPath(
    dx.map((u, k) => cos[k] * u + sin[k] * dy[k]),
    dy.map((v, k) => cos[k] * v - sin[k] * dx[k]),
    step,
    broken,
  );
  return { tracks, fixed: thinPath(x, y, step, broken), moving };
}
