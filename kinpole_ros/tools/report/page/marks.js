// ---- Marks: one shape for each kind of pole ----

const MARKS = { icr: 'circle', iap: 'triangle', ijp: 'square', isp: 'diamond', relative: 'cross' };

function markPath(kind, x, y, r) {
  const path = new Path2D();
  const polygon = (...corners) => {
    corners.forEach(([u, v], k) => path[k ? 'lineTo' : 'moveTo'](x + r * u, y + r * v));
    path.closePath();
  };
  if (kind === 'circle') path.arc(x, y, r, 0, 2 * Math.PI);
  if (kind === 'triangle') polygon([0, -1.3], [1.15, 0.8], [-1.15, 0.8]);
  if (kind === 'square') polygon([-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]);
  if (kind === 'diamond') polygon([0, -1.35], [1.1, 0], [0, 1.35], [-1.1, 0]);
  if (kind === 'cross') {
    path.arc(x, y, r, 0, 2 * Math.PI);
    path.moveTo(x - r, y);
    path.lineTo(x + r, y);
    path.moveTo(x, y - r);
    path.lineTo(x, y + r);
  }
  return path;
}

function say(context, text, x, y, color, size = 12, weight = 400) {
  context.font = `${weight} ${size}px system-ui, sans-serif`;
  context.lineWidth = 3.5;
  context.lineJoin = 'round';
  context.strokeStyle = 'rgba(255,255,255,.9)';
  context.strokeText(text, x, y);
  context.fillStyle = color;
  context.fillText(text, x, y);
}

// An arrow from a point by a vector, in pixels; none for less than it takes to see one.
function arrow(context, [x, y], [u, v], cut = false) {
  const length = Math.hypot(u, v);
  if (!(length > 3)) return;
  const head = Math.min(8, 0.6 * length);
  const [c, s] = [u / length, v / length];
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + u - c * head, y + v - s * head);
  if (cut) context.setLineDash([5, 3]);
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  context.moveTo(x + u, y + v);
  context.lineTo(x + u - c * head - s * head * 0.42, y + v - s * head + c * head * 0.42);
  context.lineTo(x + u - c * head + s * head * 0.42, y + v - s * head - c * head * 0.42);
  context.fill();
}
