// ---- The editor of a solved scene: points dragged, all figures solved anew, saved as YAML ----

// Pixels about a point at which it is taken; share of the largest rate, or speed, that counts as none.
const [GRIP, STILL] = [14, 1e-9];
// Of instants, while a point is dragged, one in so many is closed, others follow from its derivatives.
const CLOSED_EACH = 3;
// Moves of a point after which lines, and figures and charts, are drawn too: fast enough to the eye.
const [LINES_EACH, READ_EACH] = [2, 12];

function makeEditor({ data, page, stage, redraw, play }) {
  const { edit } = data;
  const solver = makeSolver(edit, data.t);
  const ground = edit.size;
  const original = edit.points.map((point) => [...point]);
  const history = [];
  let [dragged, undone, moves] = [null, null, 0];
  const [button, undoing] = [by('edit'), by('undo')];
  const element = by('stage');
  document.documentElement.dataset.edit = 'yes';

  const pose = (body, k) => (body === ground ? [0, 0, 1, 0] : [data.bodies[body].x[k],
    data.bodies[body].y[k], Math.cos(data.bodies[body].angle[k]), Math.sin(data.bodies[body].angle[k])]);

  function world([body, , u, v]) {
    const [x, y, c, s] = pose(body, page.k);
    return [x + c * u - s * v, y + s * u + c * v];
  }

  // Every body with a point of this name has it moved to this place of the ground, as a pin has it.
  function movePoint(name, [x, y]) {
    for (const point of edit.points.filter((one) => one[1] === name)) {
      const [px, py, c, s] = pose(point[0], page.k);
      const [dx, dy] = [x - px, y - py];
      [point[2], point[3]] = [c * dx + s * dy, c * dy - s * dx];
    }
  }

  // The scene's own pins; a report has only those that it sees.
  const pins = () => edit.joints.filter(({ terms }) => !terms.length).map(({ a, b }) => {
    const ends = [a, b].map((point) => edit.points[point]);
    const still = ends.find(([body]) => body === ground);
    const moving = ends.filter(([body]) => body !== ground);
    const at = (still ? [still] : ends).map((point) => point.slice(2, 4));
    return { bodies: moving.map(([body]) => data.bodies[body].name), at };
  });
  data.joints = pins();

  // Solves all instants from one on; false, and nothing changed, where the loops do not close there.
  function solveAgain(from = page.k) {
    data.lost = [];
    const every = page.dragging ? CLOSED_EACH : 1;
    if (!solver.solveAll(from, (k) => fill(data, solver, k), (k) => lose(data, k), every)) return false;
    data.edited = true;
    data.bodies.forEach((body, b) => {
      const own = edit.points.filter(([of]) => of === b);
      body.points = own.map(([, name, u, v]) => [name, u, v]);
      const rims = rimsOf(body).flatMap(([u, v, r]) => [[u, v], [u + r, v]]);
      body.outlines = [[0, [...own.map(([, , u, v]) => [u, v]), ...rims]]];
      body.missing = data.lost.map((k) => [k, k + 1, 'the loops do not close']);
      const pinned = body.icr_velocity.value.includes(0);
      body.withheld = pinned ? { centrode_curvature: [[0, data.n, 'the ICR stands still']] } : {};
    });
    data.joints = pins();
    stage.view.held = true;
    stage.reshape();
    redraw(moves % READ_EACH ? (moves % LINES_EACH ? 'pose' : 'shape') : 'rest');
    moves += 1;
    return true;
  }

  const copy = () => ({ points: edit.points.map((point) => [...point]), values: solver.values.map((row) => row.slice()) });

  function restore({ points, values }) {
    points.forEach((point, p) => { edit.points[p].splice(0, 6, ...point); });
    values.forEach((row, k) => solver.values[k].set(row));
  }

  const tell = (text) => { by('state').textContent = text; };

  // The nearest point that may be moved.
  function grip(event) {
    const box = element.getBoundingClientRect();
    const off = (point) => {
      const [left, top] = stage.screen(...world(point));
      return Math.hypot(left - event.clientX + box.left, top - event.clientY + box.top);
    };
    const near = edit.points.filter((point) => off(point) < GRIP).sort((p, q) => off(p) - off(q))[0];
    if (near && edit.fixed.includes(near[1])) tell(`${near[1]} is the hub of a wheel, which stays`);
    return near && !edit.fixed.includes(near[1]) ? near[1] : null;
  }

  function onDown(event) {
    if (button.ariaPressed !== 'true' || event.target.closest('button')) return;
    dragged = grip(event);
    if (!dragged) return;
    event.stopImmediatePropagation();
    element.setPointerCapture(event.pointerId);
    page.dragging = true;
    undone = copy();
  }

  function onMove(event) {
    if (!dragged) return;
    event.stopImmediatePropagation();
    const box = element.getBoundingClientRect();
    const before = copy();
    movePoint(dragged, stage.plane(event.clientX - box.left, event.clientY - box.top));
    const closes = solveAgain();
    if (!closes) restore(before);
    else if (history.at(-1) !== undone) history.push(undone);
    tell(closes ? '' : 'the loops do not close there');
  }

  function onUp() {
    if (!dragged) return;
    page.dragging = false;
    dragged = null;
    undoing.disabled = !history.length;
    moves = 0;
    solveAgain();
    stage.learn();
  }

  function undo() {
    if (!history.length) return;
    restore(history.pop());
    undoing.disabled = !history.length;
    tell('');
    moves = 0;
    const closed = (k) => isFinite(solver.values[k][0]);
    solveAgain(closed(page.k) ? page.k : solver.values.findIndex((row, k) => closed(k)));
  }

  function save() {
    const link = tag('a', undefined, { download: `${data.scene}.yaml`,
      href: URL.createObjectURL(new Blob([yamlOf(edit, original, solver, data)], { type: 'text/yaml' })) });
    link.click();
    URL.revokeObjectURL(link.href);
  }

  page.drawOver = (context) => {
    if (button.ariaPressed !== 'true') return;
    context.lineWidth = 1.6;
    context.strokeStyle = '#c2273d';
    for (const point of edit.points.filter(([, name]) => !edit.fixed.includes(name))) {
      const [left, top] = stage.screen(...world(point));
      context.strokeRect(left - 7, top - 7, 14, 14);
    }
  };

  button.onclick = () => {
    const on = button.ariaPressed !== 'true';
    button.ariaPressed = on;
    if (on) play(false);
    // What the page came with is rounded.
    if (on && !data.edited && !solver.solveAll(edit.at, () => {}, () => {})) tell('it cannot be edited');
    redraw();
  };
  undoing.onclick = undo;
  by('save').onclick = save;
  document.addEventListener('keydown', (event) => {
    if (event.key === 'z' && (event.ctrlKey || event.metaKey)) undo();
  });
  element.addEventListener('pointerdown', onDown, { capture: true });
  element.addEventListener('pointermove', onMove, { capture: true });
  for (const end of ['pointerup', 'pointercancel']) element.addEventListener(end, onUp);
}

// What is zero but for rounding, next to a size, is zero.
const nonzero = (value, size) => (Math.abs(value) < STILL * size ? 0 : value);

// The figures of all bodies and pairs at instant k, from the solver's derivatives.
function fill(data, solver, k) {
  const { u, re, im } = solver;
  const fastest = u[1].reduce((most, w, b) => (b in data.bodies ? Math.max(most, Math.abs(w)) : most), 0);
  data.bodies.forEach((body, b) => {
    const [x, y] = solver.place(b);
    body.x[k] = x[0];
    body.y[k] = y[0];
    body.angle[k] = u[0][b];
    body.vx[k] = x[1];
    body.vy[k] = y[1];
    for (let n = 1; n < ORDERS; n++) {
      body[RATES[n - 1]].value[k] = nonzero(u[n][b], fastest ** n);
      // The field of order n is z + r ρ, where ρ is that derivative of e^{iθ} over itself.
      const c = re[n][b] * re[0][b] + im[n][b] * im[0][b];
      const s = im[n][b] * re[0][b] - re[n][b] * im[0][b];
      const size = c * c + s * s > STILL ** 2 ? c * c + s * s : NaN;
      const pole = body[POLES[n - 1]];
      pole.x[k] = nonzero(x[0] - (x[n] * c + y[n] * s) / size, body.size || 1);
      pole.y[k] = nonzero(y[0] - (y[n] * c - x[n] * s) / size, body.size || 1);
    }
    // The ICR z + i z' / ω, differentiated twice.
    const w = u[1][b];
    const bend = u[2][b] / w;
    const last = u[3][b] / w - 2 * bend * bend;
    const ux = x[1] - (y[2] - y[1] * bend) / w;
    const uy = y[1] + (x[2] - x[1] * bend) / w;
    const ax = x[2] - (y[3] - 2 * y[2] * bend - y[1] * last) / w;
    const ay = y[2] + (x[3] - 2 * x[2] * bend - x[1] * last) / w;
    const speed = Math.hypot(ux, uy);
    const rests = speed <= STILL * Math.abs(w) * (body.size || 1);
    body.icr_velocity.x[k] = rests ? 0 : ux;
    body.icr_velocity.y[k] = rests ? 0 : uy;
    body.icr_velocity.value[k] = rests ? 0 : speed;
    body.centrode_curvature.value[k] = rests ? NaN : (ux * ay - uy * ax) / speed ** 3;
  });
  for (const { j, i, icr, rate } of data.pairs) {
    const [v, w] = [j.angular_velocity.value[k], i.angular_velocity.value[k]];
    const sx = j.vx[k] + v * j.y[k] - i.vx[k] - w * i.y[k];
    const sy = j.vy[k] - v * j.x[k] - i.vy[k] + w * i.x[k];
    const turn = Math.abs(v - w) > STILL * Math.abs(v) ? v - w : NaN;
    icr.x[k] = -sy / turn;
    icr.y[k] = sx / turn;
    rate.value[k] = v - w;
  }
}

function lose(data, k) {
  data.lost.push(k);
  for (const column of columnsIn(data)) if (column !== data.t) column[k] = NaN;
}

// The scene's text with the points where they are, and a start that says which way the loops close.
function yamlOf({ text, points, start }, original, solver, { bodies }) {
  const plain = (value) => String(Number(value.toFixed(12)));
  const edits = points.filter(([, , u, v], p) => u !== original[p][2] || v !== original[p][3])
    .map(([, , u, v, from, to]) => [from, to, `[${plain(u)}, ${plain(v)}]`]);
  if (!edits.length) return text;
  const letters = [...text];
  const values = solver.atZero();
  const angles = bodies.map(({ name }, b) => `${name}: ${plain((values?.[b] * 180) / Math.PI)} deg`);
  if (values) edits.push([...start, `${start[0] < letters.length ? '' : '\nstart: '}{${angles.join(', ')}}`]);
  edits.sort((one, other) => other[0] - one[0]);
  for (const [from, to, words] of edits) letters.splice(from, to - from, ...words);
  return letters.join('').replace(/\n*$/, '\n');
}
