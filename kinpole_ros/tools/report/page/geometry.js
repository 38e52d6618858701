// ---- Shapes and lines: outlines of bodies, lines thinned to what the eye can tell apart ----

function hull(points) {
  const sorted = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  if (sorted.length < 3) return sorted;
  const half = (list) => {
    const kept = [];
    for (const p of list) {
      while (kept.length > 1) {
        const [[ax, ay], [bx, by]] = kept.slice(-2);
        if ((bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0) break;
        kept.pop();
      }
      kept.push(p);
    }
    return kept.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

// The convex hull, as a bar of a linkage has it: rounded, r beyond its corners.
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

// A body by its points and rims: a bar, round where it is one point, and wheels with a spoke.
function outlinePath(points, rims, thickness, size) {
  const onRim = ([x, y]) => rims.some(([u, v, r]) => Math.abs(Math.hypot(x - u, y - v) - r) < 1e-6 * r);
  const corners = points.filter((point) => !onRim(point));
  const alone = corners.length < 2 && !rims.length;
  const radius = alone ? Math.max(thickness, (size || 0) / 2) : thickness;
  const path = barPath(corners.length ? corners : [[0, 0]], radius);
  for (const [u, v, r] of rims) {
    path.moveTo(u, v);
    path.lineTo(u + r, v);
    path.arc(u, v, r, 0, 2 * Math.PI);
  }
  return path;
}

// x and y as a path of no more than the eye can tell apart: without points nearer than `step` to
// the one before, and of many points without going again where it has been, in cells of two steps.
// NaN, and whatever `broken(k)` says of the way to point k, ends a line.
function thinPath(x, y, step, broken) {
  const path = new Path2D();
  const visited = new Set();
  const many = x.length > 2000;
  let [px, py, pen, known] = [0, 0, false, false];
  for (let k = 0; k < x.length; k++) {
    if (!(x[k] - x[k] === 0 && y[k] - y[k] === 0)) {
      known = false;
      continue;
    }
    if (!known || broken(k)) pen = known = false;
    else if (Math.abs(x[k] - px) + Math.abs(y[k] - py) < step) continue;
    const cell = Math.round(x[k] / (2 * step)) * 67108864 + Math.round(y[k] / (2 * step));
    const again = visited.has(cell);
    if (!again) {
      if (many) visited.add(cell);
      if (!pen) path.moveTo(known ? px : x[k], known ? py : y[k]);
      if (known) path.lineTo(x[k], y[k]);
    }
    [px, py, pen, known] = [x[k], y[k], !again, true];
  }
  return path;
}

// Round numbers over a range, about `count` of them.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0) || !isFinite(rough)) return { step: 1, at: [] };
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999) * power;
  const at = [];
  for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) at.push(k * step);
  return { step, at };
}

function tickWords(value, step) {
  const size = Math.max(Math.abs(value), step);
  if (size >= 1e5 || step < 1e-5) return minus(value === 0 ? '0' : value.toExponential(0));
  return minus(value.toFixed(Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))));
}

// A canvas as large as its box, empty; its context draws in CSS pixels. What is to be printed is
// emptied by its size: printers take clearRect for a white sheet.
function fitted(canvas, printing) {
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
