// ---- Shapes, marks and text on a canvas ----

const [INK, GRAY, GRID] = ['#1c2127', '#5b6570', '#edf0f2'];
const FONT = 'px system-ui, sans-serif';

// An empty canvas as large as its box, whose context draws in CSS pixels. For printing it is emptied
// by setting its size, since printers take clearRect for a white sheet.
function emptyCanvas(canvas, printing) {
  const ratio = printing ? 2 : Math.min(3, window.devicePixelRatio || 1);
  const box = canvas.parentElement.getBoundingClientRect();
  const [width, height] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
  const context = canvas.getContext('2d');
  if (printing || canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  } else {
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width: box.width, height: box.height, ratio };
}

// Adds straight lines through points to a path or context.
function addLines(path, points) {
  points.forEach(([x, y], k) => path[k ? 'lineTo' : 'moveTo'](x, y));
}

function strokeLines(context, ...lines) {
  context.beginPath();
  for (const points of lines) addLines(context, points);
  context.stroke();
}

function hull(points) {
  const sorted = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  if (sorted.length < 3) return sorted;
  const half = (list) => {
    const corners = [];
    for (const p of list) {
      while (corners.length > 1) {
        const [[ax, ay], [bx, by]] = corners.slice(-2);
        if ((bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0) break;
        corners.pop();
      }
      corners.push(p);
    }
    return corners.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

// The convex hull as a bar of a linkage: rounded, r beyond its corners.
function barPath(points, r) {
  const corners = hull(points);
  const path = new Path2D();
  const n = corners.length;
  if (n === 1) path.arc(...corners[0], r, 0, 2 * Math.PI);
  for (let k = 0; n > 1 && k < n; k++) {
    const [a, b, c] = [corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]];
    const from = Math.atan2(a[0] - b[0], b[1] - a[1]);
    const to = Math.atan2(b[0] - c[0], c[1] - b[1]);
    path.arc(b[0], b[1], r, from, to);
  }
  path.closePath();
  return path;
}

// A body from its points and rims: a bar, a disk if it is one point, and wheels with a spoke.
function outlinePath(points, rims, thickness, size) {
  const onRim = ([x, y]) => rims.some(([u, v, r]) => Math.abs(Math.hypot(x - u, y - v) - r) < 1e-6 * r);
  const corners = points.filter((point) => !onRim(point));
  const isPoint = corners.length < 2 && !rims.length;
  const radius = isPoint ? Math.max(thickness, (size || 0) / 2) : thickness;
  const path = barPath(corners.length ? corners : [[0, 0]], radius);
  for (const [u, v, r] of rims) {
    path.moveTo(u, v);
    path.lineTo(u + r, v);
    path.arc(u, v, r, 0, 2 * Math.PI);
  }
  return path;
}

// A line through x and y without details that the eye cannot see: points nearer than `step` to the
// one before, and, of long lines, parts in cells of two steps where the line has been before.
// NaN, and `breaksAt(k)` before point k, interrupt the line.
function thinPath(x, y, step, breaksAt) {
  const path = new Path2D();
  const visited = new Set();
  const isLong = x.length > 2000;
  // The last point, whether the pen is there, and whether it is connected to the next one.
  let [px, py, penDown, connected] = [0, 0, false, false];
  for (let k = 0; k < x.length; k++) {
    if (!isFinite(x[k]) || !isFinite(y[k])) {
      connected = false;
      continue;
    }
    if (!connected || breaksAt(k)) penDown = connected = false;
    else if (Math.abs(x[k] - px) + Math.abs(y[k] - py) < step) continue;
    const cell = Math.round(x[k] / (2 * step)) * 67108864 + Math.round(y[k] / (2 * step));
    const isNew = !visited.has(cell);
    if (isNew) {
      if (isLong) visited.add(cell);
      if (!penDown) path.moveTo(connected ? px : x[k], connected ? py : y[k]);
      if (connected) path.lineTo(x[k], y[k]);
    }
    [px, py, penDown, connected] = [x[k], y[k], isNew, true];
  }
  return path;
}

// About `count` round numbers in a range.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0) || !isFinite(rough)) return { step: 1, at: [] };
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999) * power;
  const at = [];
  for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) at.push(k * step);
  return { step, at };
}

function tickText(value, step) {
  const size = Math.max(Math.abs(value), step);
  if (size >= 1e5 || step < 1e-5) return withMinus(value === 0 ? '0' : value.toExponential(0));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return withMinus(value.toFixed(Math.min(9, decimals)));
}

// ---- Marks ----

const MARKS = {
  icr: 'circle', iap: 'triangle', ijp: 'square', isp: 'diamond', relative: 'cross', ball_point: 'star',
};
const MARK_CORNERS = {
  triangle: [[0, -1.3], [1.15, 0.8], [-1.15, 0.8]],
  square: [[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
  diamond: [[0, -1.35], [1.1, 0], [0, 1.35], [-1.1, 0]],
  star: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9].map((k) => [
    (k % 2 ? 0.6 : 1.4) * Math.sin((k * Math.PI) / 5), (k % 2 ? -0.6 : -1.4) * Math.cos((k * Math.PI) / 5),
  ]),
};

function markPath(kind, x, y, r) {
  const path = new Path2D();
  if (MARK_CORNERS[kind]) {
    addLines(path, MARK_CORNERS[kind].map(([u, v]) => [x + r * u, y + r * v]));
    path.closePath();
    return path;
  }
  path.arc(x, y, r, 0, 2 * Math.PI);
  if (kind === 'cross') {
    addLines(path, [[x - r, y], [x + r, y]]);
    addLines(path, [[x, y - r], [x, y + r]]);
  }
  return path;
}

// Text with a white outline.
function drawText(context, text, x, y, color, size = 12, weight = 400) {
  context.font = `${weight} ${size}${FONT}`;
  context.lineWidth = 3.5;
  context.lineJoin = 'round';
  context.strokeStyle = 'rgba(255,255,255,.9)';
  context.strokeText(text, x, y);
  context.fillStyle = color;
  context.fillText(text, x, y);
}

// Returns a function that draws texts, each on the nearest line on which it covers none before it.
function makeLabels(context) {
  const before = { left: 0, center: 0.5, right: 1 };
  const taken = [];
  return (text, x, y, color, size = 12, weight = 400) => {
    context.font = `${weight} ${size}${FONT}`;
    const width = context.measureText(text).width;
    const left = x - before[context.textAlign] * width;
    const boxAt = (line) => ({ left, right: left + width, top: y + (line - 1) * size, bottom: y + line * size });
    const covers = (box) => taken.some((other) => box.left < other.right && other.left < box.right
      && box.top < other.bottom && other.top < box.bottom);
    const line = [0, 1, -1, 2, -2, 3, -3].find((one) => !covers(boxAt(one))) ?? 0;
    taken.push(boxAt(line));
    drawText(context, text, x, y + line * size, color, size, weight);
  };
}

// An arrow from a point along a vector, in pixels; none if it is too short to be seen. The line of
// an arrow that is cut off is dashed.
function drawArrow(context, [x, y], [u, v], isCut = false) {
  const length = Math.hypot(u, v);
  if (!(length > 3)) return;
  const head = Math.min(8, 0.6 * length);
  const [c, s] = [u / length, v / length];
  const [left, top] = [x + u - c * head, y + v - s * head];
  if (isCut) context.setLineDash([5, 3]);
  strokeLines(context, [[x, y], [left, top]]);
  context.setLineDash([]);
  context.beginPath();
  addLines(context, [
    [x + u, y + v],
    [left - s * head * 0.42, top + c * head * 0.42],
    [left + s * head * 0.42, top - c * head * 0.42],
  ]);
  context.fill();
}
