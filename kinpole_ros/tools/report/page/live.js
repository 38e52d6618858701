// ---- Live: a stream of figures in place of a record ----

// Instants that are kept, and the time (s) that charts show of them.
const [KEPT, SPAN] = [300, 10];
// What is not shown until the reader wants it.
const CHOSEN = [...RATES.slice(1), 'icr_velocity', 'centrode_curvature'];
const UNASKED = [...POLES.slice(1), ...CHOSEN, 'relative'];
// Instants after which the picture is made to hold all that moved, and figures and charts are drawn:
// nobody reads more of these in a second.
const [LEARN_EVERY, READ_EVERY] = [15, 3];
// Less time than this (s) without a frame is no gap in a line: the page or its way was slow.
const LATE = 0.1;

function watch() {
  const { dataset } = document.documentElement;
  dataset.live = 'waiting';
  by('title').textContent = 'kinpole view';
  let [actions, data, source] = [null, null, null];
  let [following, count] = [true, 0];
  by('live').onclick = () => follow(!following);
  // A page that nobody sees asks for nothing.
  document.addEventListener('visibilitychange', connect);
  connect();

  function follow(on) {
    if (following === on) return;
    following = on;
    if (on) actions?.play(false);
    by('live').setAttribute('aria-pressed', on);
    connect();
  }

  function connect() {
    source?.close();
    source = null;
    if (!following || document.hidden) return;
    source = new EventSource('stream');
    source.addEventListener('rig', (event) => onRig(JSON.parse(event.data)));
    source.addEventListener('frame', (event) => onFrame(JSON.parse(event.data)));
    source.onopen = () => tell('');
    source.onerror = ({ target }) => {
      tell('disconnected, trying again; where kinpole view was started anew, open the address it prints');
      // A refusal is for good, for the browser.
      if (target.readyState === 2) setTimeout(() => target === source && connect(), 1000);
    };
  }

  const tell = (text) => { by('state').textContent = text; };

  function onRig(rig) {
    if (rig.waiting) {
      by('about').textContent = rig.waiting;
      return;
    }
    const names = JSON.stringify([rig.title, rig.bodies.map(({ name }) => name), rig.figures, rig.pairs]);
    if (!actions) begin(rig, names);
    if (names !== data.names) {
      // Another rig is another page.
      source.close();
      location.reload();
      return;
    }
    const { about, joints, notes, along } = rig;
    Object.assign(data, { about, joints, notes, along });
    tellAbout(data);
    for (const { name, size, outline, withheld } of rig.bodies) {
      const outlines = outline ? [[0, outline]] : [];
      Object.assign(data.byName[name], { size, outlines });
      // Frames say it of their own instant; the diagnostics, once a second, lag behind.
      if (!data.byName[name].saysWhy) giveReasons(data.byName[name], withheld);
    }
    drawNotes(by('notes'), data);
    actions.stage.learn();
    actions.redraw('rest');
  }

  function begin(rig, names) {
    data = { ...prepare(emptyRecord(rig)), names, begin: -SPAN };
    by('title').textContent = rig.title;
    dataset.live = 'yes';
    actions = makePage(data, UNASKED, () => follow(false));
    actions.page.k = KEPT - 1;
    actions.whole();
    dataset.ready = 'yes';
  }

  function onFrame(frame) {
    if (!data) return;
    append(data, frame);
    data.bodies.forEach((body, b) => {
      body.saysWhy = Boolean(frame.reasons[b]);
      if (body.saysWhy) giveReasons(body, frame.reasons[b]);
    });
    const { page, stage, redraw } = actions;
    const width = Math.min(SPAN, page.range[1] - page.range[0]) || SPAN;
    page.range = [data.end - width, data.end];
    page.k = KEPT - 1;
    if (count % LEARN_EVERY === 0) stage.learn();
    redraw(count++ % READ_EVERY ? 'pose' : 'rest');
    // For whoever measures how late it is.
    requestAnimationFrame(() => { dataset.published = frame.published; });
  }
}

function giveReasons(body, reasons) {
  const spells = Object.entries(reasons).map(([figure, why]) => [figure, [[0, KEPT, why]]]);
  const { '': missing = [], ...withheld } = Object.fromEntries(spells);
  Object.assign(body, { missing, withheld });
}

const OF_POINT = ['x', 'y', 'a', 'b', 'd'];

function partsOf(figure) {
  if (POLES.includes(figure)) return OF_POINT;
  return figure === 'icr_velocity' ? ['x', 'y', 'sigma'] : ['value', 'sigma'];
}

// A record of a rig in which nothing is known yet.
function emptyRecord(rig) {
  const none = () => new Array(KEPT).fill(null);
  const columns = (...names) => Object.fromEntries(names.map((name) => [name, none()]));
  const bodies = rig.bodies.map(({ name }) => {
    const body = { name, outlines: [], missing: [], withheld: {}, theory: {},
      ...columns('x', 'y', 'angle', 'vx', 'vy'), angular_velocity: columns('value', 'sigma') };
    for (const figure of rig.figures) {
      body[figure] = columns(...partsOf(figure));
    }
    return body;
  });
  const pairs = rig.pairs.map((pair) => ({ bodies: pair, icr: columns(...OF_POINT) }));
  // Times rise, also of what is not known.
  const t = none().map((_, k) => k * 1e-9);
  return { live: true, t, along: rig.along, bodies, pairs, joints: [], notes: [], deviations: [] };
}

// One more instant, and the oldest gone. Stamps that jump begin anew.
function append(data, { t, bodies, pairs }) {
  const last = data.n - 1;
  const anew = !(t > data.t[last] && t < data.t[last] + SPAN);
  for (const column of columnsIn(data)) {
    if (anew) column.fill(NaN);
    else column.copyWithin(0, 1);
    column[last] = NaN;
  }
  if (anew) data.t.forEach((_, k) => { data.t[k] = t - (last - k) * 1e-9; });
  data.t[last] = t;
  data.known = anew ? 1 : Math.min(data.n, data.known + 1);
  bodies.forEach((figures, b) => figures && put(data.bodies[b], figures, last));
  data.pairs.forEach((pair, p) => {
    const { j, i, icr, rate } = pair;
    OF_POINT.forEach((part, n) => { icr[part][last] = pairs[p]?.[n] ?? NaN; });
    rate.value[last] = j.angular_velocity.value[last] - i.angular_velocity.value[last];
    rate.sigma[last] = Math.hypot(j.angular_velocity.sigma[last], i.angular_velocity.sigma[last]);
  });
  data.period = Math.max(LATE, periodOf(data.t.subarray(data.n - data.known)));
  [data.begin, data.end] = [t - SPAN, t];
}

function put(body, figures, k) {
  for (const [name, found] of Object.entries(figures)) {
    const column = body[name];
    if (column instanceof Float64Array) column[k] = found ?? NaN;
    else if (column && found) {
      partsOf(name).forEach((part, n) => { column[part][k] = found[n] ?? NaN; });
      if (name === 'icr_velocity') column.value[k] = Math.hypot(found[0], found[1]);
    }
  }
}
