// ---- The page: its state, the actions that change it, and its drawing ----

const MEANINGS = {
  icr: 'ICR: the point of the body with velocity zero, about which it turns at this instant',
  iap: 'IAP: the point with acceleration zero',
  ijp: 'IJP: the point with jerk zero',
  isp: 'ISP: the point with snap zero',
  relative: 'relative center: the point at which two bodies have the same velocity, such as their pin',
  fixed: 'fixed centrode: the path of the ICR in the plane',
  moving: 'moving centrode: its path in the body, which rolls on the fixed one without slip',
  circle: 'inflection circle: the points of the body whose paths are straight at this instant',
  ball: "Ball's point: the one whose path is straight for longest",
  cubic: 'cubic of stationary curvature: the points whose paths stay on their circles for longest',
  path: 'path at the pointer: the circle on which the point of the body under the pointer moves',
};
// The parts to draw again, from least to most: the moving part of the stage, the stage, all parts that
// move with the cursor, everything.
const REDRAWS = ['', 'instant', 'stage', 'cursor', 'all'];

const byId = (id) => document.getElementById(id);

// `off` are the layers that are hidden at first; `onCursor` is called when the reader moves the cursor.
function makePage(data, off = HIDDEN, onCursor = () => {}) {
  const page = {
    k: 0, playing: false, pace: 1, range: [data.begin, data.end], hidden: new Set(),
    off: new Set(off), printing: false, turnsPages: false,
  };
  const stage = makeStage(byId('stage'), page, data);
  const charts = makeCharts(byId('charts'), page, data);
  const table = makeTable(byId('values'), page, data);
  const polygons = data.live ? null : makePolygons(byId('polygons'), page, data);
  let pending = '';
  let time = 0;

  // Draws once per animation frame, however often it is called.
  function redraw(what = 'cursor') {
    if (!pending) requestAnimationFrame(draw);
    if (REDRAWS.indexOf(what) > REDRAWS.indexOf(pending)) pending = what;
  }

  function draw() {
    const what = pending;
    pending = '';
    if (what === 'all') charts.draw();
    if (what === 'cursor') charts.drawCursor();
    if (what === 'all' || what === 'stage') stage.draw();
    else stage.drawCursor();
    if (what === 'all' || what === 'cursor') {
      table.drawCursor();
      polygons?.draw();
      byId('scrub').value = page.k;
      byId('clock').textContent = `t = ${data.t[page.k].toFixed(3)} s`;
    }
  }

  function goTo(k) {
    onCursor();
    page.k = Math.min(data.n - 1, Math.max(0, k));
    time = data.t[page.k];
    const [from, to] = page.range;
    // The charts always show the cursor.
    if (time < from || time > to) zoom(time - (to - from) / 2, time + (to - from) / 2);
    else redraw();
  }

  function stopAt(k) {
    play(false);
    goTo(k);
  }

  function play(on) {
    page.playing = on;
    byId('play').textContent = on ? 'pause' : 'play';
    if (!on) return;
    onCursor();
    let before = performance.now();
    const advance = (now) => {
      if (!page.playing) return;
      time += ((now - before) / 1000) * page.pace;
      before = now;
      const [from, to] = page.range;
      if (time > to && page.turnsPages) {
        time = to < data.end - data.period / 2 ? to : data.begin;
        zoom(time, time + to - from);
      } else if (time > to || time < from) time = from;
      const k = instantAt(data, time);
      if (k !== page.k) {
        page.k = k;
        redraw();
      }
      requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  function setPace(pace) {
    page.pace = pace;
    byId('pace').value = pace;
  }

  // Shows a readable length of time, and the next when the cursor reaches its end.
  function showReadableTime() {
    showAll();
    const length = readableTime(data);
    page.turnsPages = length < data.end - data.begin;
    zoom(data.begin, data.begin + length);
  }

  function zoom(from, to) {
    const length = Math.min(data.end - data.begin, Math.max(4 * data.period, to - from));
    const start = Math.min(data.end - length, Math.max(data.begin, from));
    page.range = [start, start + length];
    showRange();
    redraw('all');
  }

  function showAll() {
    page.range = [data.begin, data.end];
    page.turnsPages = false;
    showRange();
    stage.showAll();
    redraw('all');
  }

  // Says which part of the time the charts show.
  function showRange() {
    const [[from, to], length] = [page.range, data.end - data.begin];
    const isPart = !data.live && to - from < length - data.period / 2;
    byId('range').textContent = isPart
      ? `${from.toFixed(1)} to ${to.toFixed(1)} of ${length.toFixed(1)} s; fit (f) shows all` : '';
  }

  function toggle(set, name, button) {
    if (!set.delete(name)) set.add(name);
    button.setAttribute('aria-pressed', !set.has(name));
    redraw('all');
  }

  const actions = {
    goTo, stopAt, play, setPace, zoom, showReadableTime, showAll, toggle, redraw,
    page, stage, charts, data,
  };
  addButtons(actions);
  listen(actions);
  return actions;
}

function addButtons({ page, data, toggle }) {
  const addToggle = (parent, set, name, attributes, ...content) => {
    const pressed = { 'aria-pressed': !set.has(name), ...attributes };
    const button = tag('button', undefined, pressed);
    button.append(...content);
    button.onclick = () => toggle(set, name, button);
    byId(parent).append(button);
  };
  for (const { name, color } of data.bodies) {
    addToggle('bodies', page.hidden, name, {}, tag('i', undefined, { style: `background:${color}` }), name);
  }
  for (const [layer, title] of Object.entries(LAYERS)) {
    const needed = LAYER_NEEDS[layer] ?? (POLES.includes(layer) ? layer : 'angle');
    if (!data.bodies.some((body) => body[needed])) continue;
    if (layer === 'film' && !data.film) continue;
    if (layer === 'relative' && !data.pairs.length) continue;
    addToggle('layers', page.off, layer, {}, layerIcon(layer), title);
  }
  for (const name of data.live ? OPTIONAL_CHARTS.filter((one) => data.bodies.some((b) => b[one])) : []) {
    const [title, , symbol] = QUANTITIES[name];
    addToggle('rates', page.off, name, { title }, symbol);
  }
  for (const pace of PACES) byId('pace').append(tag('option', `${pace}×`, { value: pace }));
  byId('pace').value = 1;
  byId('scrub').max = data.n - 1;
}

// A sample of a layer.
function layerIcon(layer) {
  const shapes = {
    film: '<rect x="1" y="2" width="16" height="10" fill="#1c2127"/><circle cx="9" cy="7" r="3" fill="#fff"/>',
    outlines: '<rect x="1" y="3" width="16" height="8" rx="4" fill="#0072b233" stroke="#0072b2"/>',
    tracks: '<path d="M1 12Q7-4 17 8" fill="none" stroke="#0072b2" opacity=".5"/>',
    fixed: '<path d="M1 12Q7-4 17 8" fill="none" stroke="#0072b2" opacity=".42" stroke-width="4"/>',
    moving: '<path d="M1 12Q7-4 17 8" fill="none" stroke="#0072b2" stroke-width="1.5" '
      + 'stroke-dasharray="4 2"/>',
    icr: '<circle cx="9" cy="7" r="4.5" fill="#1c2127"/>',
    iap: '<path d="M9 1l5.5 11h-11z" fill="none" stroke="#1c2127" stroke-width="1.6"/>',
    ijp: '<path d="M4 2h10v10h-10z" fill="none" stroke="#1c2127" stroke-width="1.6"/>',
    isp: '<path d="M9 0l5.5 7-5.5 7-5.5-7z" fill="none" stroke="#1c2127" stroke-width="1.6"/>',
    relative: '<circle cx="9" cy="7" r="5" fill="none" stroke="#1c2127"/>'
      + '<path d="M4 7h10M9 2v10" stroke="#1c2127"/>',
    circle: '<circle cx="9" cy="7" r="5.5" fill="none" stroke="#0072b2" stroke-dasharray="2 2"/>',
    ball: '<path d="M9 1l1.6 4h4.2l-3.4 2.6 1.3 4.2L9 9.3l-3.7 2.5 1.3-4.2L3.2 5h4.2z" fill="none" stroke="#1c2127"/>',
    cubic: '<path d="M1 13C6 12 15 11 13 5S4 3 9 8s5 5 8 5" fill="none" stroke="#0072b2" stroke-dasharray="1 2"/>',
    path: '<path d="M2 12A9 9 0 0 1 16 12" fill="none" stroke="#1c2127"/><path d="M9 9v4" stroke="#1c2127"/>',
    velocities: '<path d="M1 11L12 4" stroke="#1c2127"/><path d="M17 1l-8 2 3 4z"/>',
    names: '<text x="2" y="12" font-size="12" font-weight="600">ab</text>',
  };
  const template = document.createElement('template');
  template.innerHTML = `<svg viewBox="0 0 18 14" aria-hidden="true">${shapes[layer]}</svg>`;
  return template.content;
}

const showState = (text) => { byId('state').textContent = text; };
const showError = (text) => byId('title').after(tag('p', text, { id: 'trouble' }));

async function start() {
  if (typeof DecompressionStream === 'undefined') {
    showError('This browser is too old to unpack the data; use Chrome 80, Firefox 113, Safari 16.4 '
      + 'or newer.');
    return;
  }
  const raw = await inflate(byId('data').textContent);
  byId('made').textContent = raw.made;
  for (const [layer, meaning] of Object.entries(MEANINGS)) {
    const mark = tag('dt');
    mark.append(layerIcon(layer));
    byId('marks').append(mark, tag('dd', meaning));
  }
  if (raw.live) watch();
  else show(prepare(raw));
}

function showAbout({ about, notes }) {
  byId('about').textContent = about;
  if (!notes.length) return;
  const text = notes.length > 1 ? `${notes.length} warnings` : '1 warning';
  byId('about').append(' · ', tag('a', text, { href: '#notes' }));
}

function show(data) {
  byId('title').textContent = data.title;
  showAbout(data);
  drawWithheld(byId('withheld'), data);
  drawTheory(byId('theory'), data);
  drawNotes(byId('notes'), data);
  byId('work').hidden = !data.work?.length;
  byId('work').querySelector('pre').textContent = (data.work || []).join('\n').trim();
  if (data.solved) byId('values').after(byId('polygons'));
  const actions = makePage(data);
  if (data.edit) makeEditor(actions);
  actions.showReadableTime();
  const reducesMotion = matchMedia('(prefers-reduced-motion: reduce)').matches;
  if (!goToAddress(actions) && !reducesMotion) actions.play(true);
  document.documentElement.dataset.ready = 'yes';
}

start().catch((error) => {
  showError(`This page cannot be shown: ${error.message}. The file may be cut off; make or copy it again.`);
  throw error;
});
