// ---- Properties of the whole motion: its extent, its speed, and the lines of points and poles ----

const SAMPLES = 400;

// Points of a body that are drawn, in its frame: markers of an outline, and pins.
function drawnPoints(data, body, outline = body.outlines[0]) {
  const points = outline ? outline[1].map((point) => [...point]) : [];
  for (const joint of data.joints) {
    const end = joint.bodies.indexOf(body.name);
    if (end < 0) continue;
    // A pin on the ground is at rest in the frame of its body.
    const known = body.x.findIndex((value) => isFinite(value));
    if (joint.bodies.length > 1) points.push(joint.at[end]);
    else if (known >= 0) points.push(inBody(body, known, joint.at[0]));
  }
  return points;
}

function* sampledInstants(data) {
  const step = Math.max(1, Math.floor(data.n / SAMPLES));
  for (let k = 0; k < data.n; k += step) yield k;
}

// The box of all bodies over time, of the ICRs near to them, and of the box before.
function motionBox(data, before) {
  const box = { low: [Infinity, Infinity], high: [-Infinity, -Infinity] };
  const add = (x, y) => {
    if (!isFinite(x) || !isFinite(y)) return;
    box.low = [Math.min(box.low[0], x), Math.min(box.low[1], y)];
    box.high = [Math.max(box.high[0], x), Math.max(box.high[1], y)];
  };
  for (const body of data.bodies) {
    const points = drawnPoints(data, body);
    if (!points.length) points.push([0, 0]);
    for (const k of sampledInstants(data)) {
      for (const point of points) add(...pointAt(body, k, point));
      for (const [u, v, r] of body.rims ?? []) {
        const [x, y] = pointAt(body, k, [u, v]);
        add(x - r, y - r);
        add(x + r, y + r);
      }
    }
  }
  for (const { body, kind, points } of data.shapes ?? []) {
    for (const k of body ? sampledInstants(data) : [0]) {
      const every = kind === 'contour' ? 8 : 1;
      for (let p = 0; p < points.length; p += every) {
        add(...(body ? pointAt(data.byName[body], k, points[p]) : points[p]));
      }
    }
  }
  for (const { body, at } of (data.spans ?? []).flatMap(({ ends }) => ends)) if (!body) add(...at);
  const [x, y] = [0, 1].map((axis) => (box.low[axis] + box.high[axis]) / 2);
  const distance = 0.6 * Math.max(box.high[0] - box.low[0], box.high[1] - box.low[1]);
  for (const { icr } of data.bodies) {
    for (const k of icr ? sampledInstants(data) : []) {
      const isNear = Math.abs(icr.x[k] - x) < distance && Math.abs(icr.y[k] - y) < distance;
      if (isNear) add(icr.x[k], icr.y[k]);
    }
  }
  if (!isFinite(box.low[0])) return before ?? { x: -0.5, y: -0.5, width: 1, height: 1, empty: true };
  if (before && !before.empty) {
    add(before.x, before.y);
    add(before.x + before.width, before.y + before.height);
  }
  const least = 1e-6 + 0.1 * Math.hypot(box.high[0] - box.low[0], box.high[1] - box.low[1]);
  const [width, height] = [0, 1].map((axis) => Math.max(box.high[axis] - box.low[axis], least));
  return { x: box.low[0], y: box.low[1], width, height };
}

// The 98th percentile of the speeds of the drawn points, m/s.
function topSpeed(data, points) {
  const speeds = [];
  data.bodies.forEach((body, b) => {
    for (const k of sampledInstants(data)) {
      for (const point of points[b]) speeds.push(Math.hypot(...velocityAt(body, k, point)));
    }
  });
  const sorted = speeds.filter(isFinite).sort((a, b) => a - b);
  return sorted.length ? quantile(sorted, 0.98) : 0;
}

// Tracks of markers and the fixed centrode in the plane, the moving centrode in the body.
function motionPaths(data, body, step, extent) {
  const cos = body.angle.map(Math.cos);
  const sin = body.angle.map(Math.sin);
  const markers = body.outlines[0]?.[1] ?? [];
  const tracks = (markers.length ? markers : [[0, 0]]).map(([u, v]) =>
    thinPath(
      body.x.map((x, k) => x + cos[k] * u - sin[k] * v),
      body.y.map((y, k) => y + sin[k] * u + cos[k] * v),
      step,
      (k) => isGap(data, k),
    ),
  );
  const { icr } = body;
  if (!icr) return { tracks, fixed: new Path2D(), moving: new Path2D() };
  // Parts where the ICR is uncertain are left out: noise would draw a star over the picture.
  const x = icr.x.map((value, k) => (icr.a[k] > 0.02 * extent ? NaN : value));
  const { y } = icr;
  const rate = body.angular_velocity.value;
  // A pole that goes through infinity comes back from the other side.
  const breaksAt = (k) => isGap(data, k) || rate[k] * rate[k - 1] < 0
    || Math.hypot(x[k] - x[k - 1], y[k] - y[k - 1]) > extent / 2;
  const [dx, dy] = [x.map((value, k) => value - body.x[k]), y.map((value, k) => value - body.y[k])];
  const moving = thinPath(
    dx.map((u, k) => cos[k] * u + sin[k] * dy[k]),
    dy.map((v, k) => cos[k] * v - sin[k] * dx[k]),
    step,
    breaksAt,
  );
  return { tracks, fixed: thinPath(x, y, step, breaksAt), moving };
}
