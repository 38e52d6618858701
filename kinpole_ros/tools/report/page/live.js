// ---- The live page: a stream of frames in place of a record ----

// Frames that are kept, and the time (s) that the charts show.
const [FRAMES, SPAN] = [300, 10];
// Charts that can be hidden, and layers and charts that are hidden at first.
const OPTIONAL_CHARTS = [
  ...RATES.slice(1), 'icr_velocity', 'centrode_curvature', 'inflection_diameter',
];
const HIDDEN_LIVE = [...HIDDEN, 'iap', ...OPTIONAL_CHARTS, 'relative'];
// The stage is fitted to the motion, and time, numbers and charts are drawn, only every so many
// frames: ten updates a second are enough to read.
const [FIT_EVERY, CHARTS_EVERY] = [15, 3];
// Intervals below this (s) are no gaps in a line: the page or the network was slow.
const LEAST_PERIOD = 0.1;

function watch() {
  const { dataset } = document.documentElement;
  dataset.live = 'waiting';
  byId('title').textContent = 'kinpole view';
  byId('about').textContent = 'connecting';
  let [actions, data, source] = [null, null, null];
  let [following, count, settled] = [true, 0, 0];
  byId('live').onclick = () => follow(!following);
  // A hidden page reads nothing.
  document.addEventListener('visibilitychange', connect);
  connect();

  function follow(on) {
    if (following === on) return;
    following = on;
    if (on) actions?.play(false);
    else actions?.redraw('all');
    byId('live').setAttribute('aria-pressed', on);
    connect();
  }

  function connect() {
    source?.close();
    source = null;
    if (!following || document.hidden) return;
    source = new EventSource('stream');
    source.addEventListener('rig', (event) => onRig(JSON.parse(event.data)));
    source.addEventListener('frame', (event) => onFrame(JSON.parse(event.data)));
    source.onopen = () => showState('');
    source.onerror = ({ target }) => {
      showState('disconnected, trying again; if kinpole view was restarted, open the address that it prints');
      // The browser does not retry after a refusal.
      if (target.readyState === EventSource.CLOSED) {
        setTimeout(() => target === source && connect(), 1000);
      }
    };
  }

  function onRig(rig) {
    if (rig.waiting) {
      byId('about').textContent = rig.waiting;
      return;
    }
    const key = JSON.stringify([rig.title, rig.bodies.map(({ name }) => name), rig.figures, rig.pairs]);
    if (!actions) begin(rig, key);
    if (key !== data.key) {
      // Another rig needs a new page.
      source.close();
      location.reload();
      return;
    }
    const { about, joints, notes, along } = rig;
    Object.assign(data, { about, joints, notes, along });
    showAbout(data);
    for (const { name, size, outline } of rig.bodies) {
      Object.assign(data.byName[name], { size, outlines: outline ? [[0, outline]] : [] });
    }
    drawNotes(byId('notes'), data);
    actions.stage.updateMotion();
    actions.redraw('all');
  }

  function begin(rig, key) {
    data = { ...prepare(emptyRecord(rig)), key, begin: -SPAN };
    byId('title').textContent = rig.title;
    dataset.live = 'yes';
    actions = makePage(data, HIDDEN_LIVE, () => follow(false));
    actions.page.k = FRAMES - 1;
    actions.showAll();
    dataset.ready = 'yes';
  }

  function onFrame(frame) {
    if (!data) return;
    appendFrame(data, frame);
    data.bodies.forEach((body, b) => setReasons(body, frame.reasons[b]));
    const { page, stage, redraw } = actions;
    const length = Math.min(SPAN, page.range[1] - page.range[0]) || SPAN;
    page.range = [data.end - length, data.end];
    page.k = FRAMES - 1;
    if (count % FIT_EVERY === 0) stage.updateMotion();
    redraw(count++ % CHARTS_EVERY ? 'instant' : 'all');
    // The last frame, if no other follows, is drawn as a whole.
    clearTimeout(settled);
    settled = setTimeout(redraw, 1e3 * LEAST_PERIOD, 'all');
    // To measure the delay of the page.
    requestAnimationFrame(() => { dataset.published = frame.published; });
  }
}

function setReasons(body, reasons) {
  const { '': all, ...others } = reasons;
  body.missing = all === undefined ? [] : [[0, FRAMES, all]];
  body.withheld = Object.fromEntries(
    Object.entries(others).map(([name, reason]) => [name, [[0, FRAMES, reason]]]));
}

const POINT_COLUMNS = ['x', 'y', 'a', 'b', 'd'];

function columnNames(quantity) {
  if (POLES.includes(quantity) || quantity === 'ball_point') return POINT_COLUMNS;
  return quantity === 'icr_velocity' ? ['x', 'y', 'sigma'] : ['value', 'sigma'];
}

// The record of a rig without any results.
function emptyRecord(rig) {
  const none = () => new Array(FRAMES).fill(null);
  const columns = (names) => Object.fromEntries(names.map((name) => [name, none()]));
  const bodies = rig.bodies.map(({ name }) => {
    const quantities = ['angular_velocity', ...rig.figures].map((one) => [one, columns(columnNames(one))]);
    return { name, outlines: [], missing: [], withheld: {}, theory: {},
      ...columns(['x', 'y', 'angle', 'vx', 'vy']), ...Object.fromEntries(quantities) };
  });
  const pairs = rig.pairs.map((pair) => ({ bodies: pair, icr: columns(POINT_COLUMNS) }));
  // Times increase, also without results.
  const t = none().map((_, k) => k * 1e-9);
  return { live: true, t, along: rig.along, bodies, pairs, joints: [], notes: [], deviations: [] };
}

// Appends a frame and drops the oldest one; a jump of the stamps drops all.
function appendFrame(data, { t, bodies, pairs }) {
  const last = data.n - 1;
  const jumps = !(t > data.t[last] && t < data.t[last] + SPAN);
  for (const column of columnsIn(data)) {
    if (jumps) column.fill(NaN);
    else column.copyWithin(0, 1);
    column[last] = NaN;
  }
  if (jumps) data.t.forEach((_, k) => { data.t[k] = t - (last - k) * 1e-9; });
  data.t[last] = t;
  data.count = jumps ? 1 : Math.min(data.n, data.count + 1);
  bodies.forEach((values, b) => values && setValues(data.bodies[b], values, last));
  data.pairs.forEach(({ j, i, icr, rate }, p) => {
    POINT_COLUMNS.forEach((name, n) => { icr[name][last] = pairs[p]?.[n] ?? NaN; });
    const [one, other] = [j.angular_velocity, i.angular_velocity];
    rate.value[last] = one.value[last] - other.value[last];
    rate.sigma[last] = Math.hypot(one.sigma[last], other.sigma[last]);
  });
  data.period = Math.max(LEAST_PERIOD, medianInterval(data.t.subarray(data.n - data.count)));
  [data.begin, data.end] = [t - SPAN, t];
}

function setValues(body, values, k) {
  for (const [name, value] of Object.entries(values)) {
    const column = body[name];
    if (column instanceof Float64Array) column[k] = value ?? NaN;
    else if (column && value) {
      columnNames(name).forEach((part, n) => { column[part][k] = value[n] ?? NaN; });
      if (name === 'icr_velocity') column.value[k] = Math.hypot(value[0], value[1]);
    }
  }
}
