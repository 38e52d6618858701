// ---- The editor of a solved scene: drag points, solve the motion again, save the scene ----

// Distance of the pointer at which a point is dragged, pixels.
const DRAG_DISTANCE = 14;
// Rates and speeds below this fraction of the largest are rounding.
const AT_REST = 1e-9;
// While a point is dragged, the loops are closed at one of so many instants; the others are
// extrapolated by derivatives.
const SOLVED_EVERY = 3;
// Moves of a point after which the lines, and numbers and charts, are drawn again.
const [LINES_EVERY, ALL_EVERY] = [2, 12];

function makeEditor({ data, page, stage, redraw, play }) {
  const { edit } = data;
  const solver = makeSolver(edit, data.t);
  const ground = edit.size;
  const original = edit.points.map((point) => [...point]);
  const history = [];
  // The name of the dragged point, the points before, and the number of moves.
  let [dragged, before, moves] = [null, null, 0];
  const [editButton, undoButton, element] = [byId('edit'), byId('undo'), byId('stage')];
  document.documentElement.dataset.edit = 'yes';
  data.joints = pins();

  function positionOf([body, , u, v]) {
    return body === ground ? [u, v] : pointAt(data.bodies[body], page.k, [u, v]);
  }

  // Moves the point of this name in all bodies that have one, as a pin does.
  function movePoint(name, at) {
    for (const point of edit.points.filter((one) => one[1] === name)) {
      const body = data.bodies[point[0]];
      [point[2], point[3]] = body ? inBody(body, page.k, at) : at;
    }
  }

  // The pins of the scene; a report has only those that it detects.
  function pins() {
    return edit.joints.filter(({ terms }) => !terms.length).map(({ a, b }) => {
      const ends = [a, b].map((index) => edit.points[index]);
      const moving = ends.filter(([body]) => body !== ground);
      const onGround = ends.find(([body]) => body === ground);
      const at = (onGround ? [onGround] : ends).map((point) => point.slice(2, 4));
      return { bodies: moving.map(([body]) => data.bodies[body].name), at };
    });
  }

  // Solves all instants, first `from`; returns false where the loops do not close there.
  function solveAgain(from = page.k) {
    const open = [];
    const markOpen = (k) => {
      open.push(k);
      for (const column of columnsIn(data)) if (column !== data.t) column[k] = NaN;
    };
    const every = page.dragging ? SOLVED_EVERY : 1;
    if (!solver.solveAll(from, (k) => setInstant(data, solver, k), markOpen, every)) return false;
    data.edited = true;
    data.bodies.forEach((body, b) => {
      const own = edit.points.filter(([owner]) => owner === b);
      body.points = own.map(([, name, u, v]) => [name, u, v]);
      const rims = (body.rims ?? []).flatMap(([u, v, r]) => [[u, v], [u + r, v]]);
      body.outlines = [[0, [...own.map(([, , u, v]) => [u, v]), ...rims]]];
      body.missing = open.map((k) => [k, k + 1, 'the loops do not close']);
      const isPinned = body.icr_velocity.value.includes(0);
      const still = [[0, data.n, 'the ICR stands still']];
      body.withheld = isPinned ? { centrode_curvature: still, inflection_circle: still } : {};
    });
    // How far points go in slots is that of the first scene.
    data.shapes = data.shapes.filter(({ kind }) => kind !== 'guide');
    for (const end of data.spans.flatMap(({ ends }) => ends)) {
      const owner = end.body ? data.bodies.indexOf(data.byName[end.body]) : ground;
      const point = edit.points.find(([body, name]) => body === owner && name === end.name);
      if (point) end.at = point.slice(2, 4);
    }
    data.joints = pins();
    stage.view.isFixed = true;
    stage.updatePoints();
    redraw(moves % ALL_EVERY ? (moves % LINES_EVERY ? 'instant' : 'stage') : 'all');
    moves += 1;
    return true;
  }

  const copy = () => ({
    points: edit.points.map((point) => [...point]), values: solver.values.map((row) => row.slice()),
  });

  function restore({ points, values }) {
    points.forEach((point, p) => { edit.points[p].splice(0, 6, ...point); });
    values.forEach((row, k) => solver.values[k].set(row));
  }

  const isEditing = () => editButton.ariaPressed === 'true';

  // The name of the nearest point that may be moved.
  function draggedName(event) {
    const box = element.getBoundingClientRect();
    const distance = (point) => {
      const [left, top] = stage.toScreen(...positionOf(point));
      return Math.hypot(left - event.clientX + box.left, top - event.clientY + box.top);
    };
    const [nearest] = edit.points.filter((point) => distance(point) < DRAG_DISTANCE)
      .sort((p, q) => distance(p) - distance(q));
    if (!nearest) return null;
    if (!edit.fixed.includes(nearest[1])) return nearest[1];
    showState(`${nearest[1]} is the hub of a wheel, which stays`);
    return null;
  }

  function onDown(event) {
    if (!isEditing() || event.target.closest('button')) return;
    dragged = draggedName(event);
    if (!dragged) return;
    event.stopImmediatePropagation();
    element.setPointerCapture(event.pointerId);
    page.dragging = true;
    before = copy();
  }

  function onMove(event) {
    if (!dragged) return;
    event.stopImmediatePropagation();
    const box = element.getBoundingClientRect();
    const last = copy();
    movePoint(dragged, stage.toPlane(event.clientX - box.left, event.clientY - box.top));
    const closes = solveAgain();
    if (!closes) restore(last);
    else if (history[history.length - 1] !== before) history.push(before);
    showState(closes ? '' : 'the loops do not close there');
  }

  function onUp() {
    if (!dragged) return;
    page.dragging = false;
    dragged = null;
    undoButton.disabled = !history.length;
    moves = 0;
    solveAgain();
    stage.updateMotion();
  }

  function undo() {
    if (!history.length) return;
    restore(history.pop());
    undoButton.disabled = !history.length;
    showState('');
    moves = 0;
    const isClosed = (row) => isFinite(row[0]);
    const { values } = solver;
    solveAgain(isClosed(values[page.k]) ? page.k : values.findIndex(isClosed));
  }

  function save() {
    const text = new Blob([yamlOf(edit, original, solver, data)], { type: 'text/yaml' });
    const href = URL.createObjectURL(text);
    tag('a', undefined, { download: `${data.scene}.yaml`, href }).click();
    URL.revokeObjectURL(href);
  }

  page.drawOver = (context) => {
    if (!isEditing()) return;
    context.lineWidth = 1.6;
    context.strokeStyle = '#c2273d';
    for (const point of edit.points.filter(([, name]) => !edit.fixed.includes(name))) {
      const [left, top] = stage.toScreen(...positionOf(point));
      context.strokeRect(left - 7, top - 7, 14, 14);
    }
  };

  editButton.onclick = () => {
    const on = !isEditing();
    editButton.ariaPressed = on;
    if (on) play(false);
    // The values in the page are rounded.
    const needsValues = on && !data.edited;
    if (needsValues && !solver.solveAll(edit.at, () => {}, () => {})) showState('it cannot be edited');
    redraw();
  };
  undoButton.onclick = undo;
  byId('save').onclick = save;
  document.addEventListener('keydown', (event) => {
    if (event.key === 'z' && (event.ctrlKey || event.metaKey)) undo();
  });
  element.addEventListener('pointerdown', onDown, { capture: true });
  element.addEventListener('pointermove', onMove, { capture: true });
  for (const end of ['pointerup', 'pointercancel']) element.addEventListener(end, onUp);
}

// Zero for a value that is only rounding, compared with a size.
const withoutRounding = (value, size) => (Math.abs(value) < AT_REST * size ? 0 : value);

// Sets all quantities of instant k from the derivatives in the solver.
function setInstant(data, solver, k) {
  const { u, cos, sin } = solver;
  const fastest = Math.max(...data.bodies.map((_, b) => Math.abs(u[1][b])));
  data.bodies.forEach((body, b) => {
    const [x, y] = solver.originOf(b);
    const bodySize = body.size || 1;
    body.x[k] = x[0];
    body.y[k] = y[0];
    body.angle[k] = u[0][b];
    body.vx[k] = x[1];
    body.vy[k] = y[1];
    for (let n = 1; n < ORDERS; n++) {
      body[RATES[n - 1]].value[k] = withoutRounding(u[n][b], fastest ** n);
      // The n-th derivative of a point r is z + r ρ, where ρ is that of e^{iθ} over e^{iθ}.
      const c = cos[n][b] * cos[0][b] + sin[n][b] * sin[0][b];
      const s = sin[n][b] * cos[0][b] - cos[n][b] * sin[0][b];
      const square = c * c + s * s > AT_REST ** 2 ? c * c + s * s : NaN;
      const pole = body[POLES[n - 1]];
      pole.x[k] = withoutRounding(x[0] - (x[n] * c + y[n] * s) / square, bodySize);
      pole.y[k] = withoutRounding(y[0] - (y[n] * c - x[n] * s) / square, bodySize);
    }
    // The ICR z + i z' / ω, differentiated twice.
    const w = u[1][b];
    const first = u[2][b] / w;
    const second = u[3][b] / w - 2 * first * first;
    const ux = x[1] - (y[2] - y[1] * first) / w;
    const uy = y[1] + (x[2] - x[1] * first) / w;
    const ax = x[2] - (y[3] - 2 * y[2] * first - y[1] * second) / w;
    const ay = y[2] + (x[3] - 2 * x[2] * first - x[1] * second) / w;
    const speed = Math.hypot(ux, uy);
    const isPinned = speed <= AT_REST * Math.abs(w) * bodySize;
    body.icr_velocity.x[k] = isPinned ? 0 : ux;
    body.icr_velocity.y[k] = isPinned ? 0 : uy;
    body.icr_velocity.value[k] = isPinned ? 0 : speed;
    body.centrode_curvature.value[k] = isPinned ? NaN : (ux * ay - uy * ax) / speed ** 3;
    body.inflection_diameter.value[k] = isPinned ? NaN : speed / Math.abs(w);
    // Along g = i u + d(u / ω)/dt from the ICR, as far as the inflection circle goes.
    const gx = (ax - first * ux) / w - uy;
    const gy = (ay - first * uy) / w + ux;
    const isBall = !isPinned && Math.hypot(gx, gy) > AT_REST * speed;
    const share = isBall ? (gx * uy - gy * ux) / (w * (gx * gx + gy * gy)) : NaN;
    body.ball_point.x[k] = body.icr.x[k] + share * gx;
    body.ball_point.y[k] = body.icr.y[k] + share * gy;
  });
  for (const { j, i, icr, rate } of data.pairs) {
    const [v, w] = [j.angular_velocity.value[k], i.angular_velocity.value[k]];
    const sx = j.vx[k] + v * j.y[k] - i.vx[k] - w * i.y[k];
    const sy = j.vy[k] - v * j.x[k] - i.vy[k] + w * i.x[k];
    const relative = Math.abs(v - w) > AT_REST * Math.abs(v) ? v - w : NaN;
    icr.x[k] = -sy / relative;
    icr.y[k] = sx / relative;
    rate.value[k] = v - w;
  }
}

// The text of the scene with the moved points, and a start that says which way the loops close.
function yamlOf({ text, points, start }, original, solver, { bodies }) {
  const decimal = (value) => String(Number(value.toFixed(12)));
  const edits = points.filter(([, , u, v], p) => u !== original[p][2] || v !== original[p][3])
    .map(([, , u, v, from, to]) => [from, to, `[${decimal(u)}, ${decimal(v)}]`]);
  if (!edits.length) return text;
  const letters = [...text];
  const values = solver.atTimeZero();
  if (values) {
    const angles = bodies.map(({ name }, b) => `${name}: ${decimal((values[b] * 180) / Math.PI)} deg`);
    const key = start[0] < letters.length ? '' : '\nstart: ';
    edits.push([...start, `${key}{${angles.join(', ')}}`]);
  }
  edits.sort((one, other) => other[0] - one[0]);
  for (const [from, to, words] of edits) letters.splice(from, to - from, ...words);
  return letters.join('').replace(/\n*$/, '\n');
}
