// ---- The page: one state, what changes it, and what is then drawn again ----

const PACES = [0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];
const by = (id) => document.getElementById(id);

// `off` is what is not shown at first; `moved` is called when the reader moves the cursor.
function makePage(data, off = HIDDEN, moved = () => {}) {
  const page = {
    k: 0, playing: false, pace: 1, range: [data.begin, data.end], hidden: new Set(),
    off: new Set(off), printing: false, turning: false,
  };
  const stage = makeStage(by('stage'), page, data);
  const [lines, strips] = [makeCharts, makeStrips].map((make) => make(by('charts'), page, data));
  const charts = {
    rest: () => [lines, strips].forEach((part) => part.rest()),
    move: () => [lines, strips].forEach((part) => part.move()),
    plots: [...lines.plots, ...strips.plots],
  };
  const table = makeTable(by('now'), page, data);
  const polygons = data.live ? null : makePolygons(by('polygons'), page, data);
  let waiting = '';
  let time = 0;

  // Drawn again is what moves in the picture, for 'pose'; all of the picture, for 'shape'; for 'move'
  // what moves with the cursor; for 'rest' all. Once a frame, however often asked for.
  const parts = ['', 'pose', 'shape', 'move', 'rest'];
  function redraw(what = 'move') {
    if (!waiting) requestAnimationFrame(show);
    if (parts.indexOf(what) > parts.indexOf(waiting)) waiting = what;
  }

  function show() {
    const what = waiting;
    waiting = '';
    if (what === 'move' || what === 'rest') {
      charts[what]();
      table.move();
    }
    stage[what === 'rest' || what === 'shape' ? 'rest' : 'move']();
    if (what === 'move' || what === 'rest') polygons?.draw();
    by('scrub').value = page.k;
    by('clock').textContent = `t = ${data.t[page.k].toFixed(3)} s`;
  }

  function goTo(k) {
    moved();
    page.k = Math.min(data.n - 1, Math.max(0, k));
    time = data.t[page.k];
    const [from, to] = page.range;
    // The charts show the time about the cursor.
    if (time < from || time > to) zoom(time - (to - from) / 2, time + (to - from) / 2);
    else redraw();
  }

  function play(on) {
    page.playing = on;
    by('play').textContent = on ? 'pause' : 'play';
    if (!on) return;
    moved();
    let before = performance.now();
    const advance = (now) => {
      if (!page.playing) return;
      time += ((now - before) / 1000) * page.pace;
      before = now;
      const [from, to] = page.range;
      if (time > to && page.turning) {
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
    by('pace').value = pace;
  }

  // Shows so much time that its swings can be told apart, and the next when the cursor is through.
  function open() {
    whole();
    const time = readableTime(data);
    page.turning = time < data.end - data.begin;
    zoom(data.begin, data.begin + time);
  }

  function zoom(from, to) {
    const width = Math.min(data.end - data.begin, Math.max(4 * data.period, to - from));
    const start = Math.min(data.end - width, Math.max(data.begin, from));
    page.range = [start, start + width];
    tellRange();
    redraw('rest');
  }

  function whole() {
    page.range = [data.begin, data.end];
    page.turning = false;
    tellRange();
    stage.whole();
    redraw('rest');
  }

  // How much of the time the charts show, where it is not all.
  function tellRange() {
    const [[from, to], all] = [page.range, data.end - data.begin];
    const part = !data.live && to - from < all - data.period / 2;
    by('range').textContent = part
      ? `${from.toFixed(1)} to ${to.toFixed(1)} of ${all.toFixed(1)} s; fit (f) shows all` : '';
  }

  function toggle(set, name, button) {
    if (!set.delete(name)) set.add(name);
    button.setAttribute('aria-pressed', !set.has(name));
    redraw('rest');
  }

  const actions = { goTo, play, setPace, zoom, open, whole, toggle, redraw, page, stage, charts, data };
  fillButtons(actions);
  listen(actions);
  return actions;
}

function fillButtons({ page, data, toggle }) {
  for (const body of data.bodies) {
    const button = tag('button', undefined, { 'aria-pressed': true });
    button.append(tag('i', undefined, { style: `background:${body.color}` }), body.name);
    button.onclick = () => toggle(page.hidden, body.name, button);
    by('bodies').append(button);
  }
  for (const [layer, words] of Object.entries(LAYERS)) {
    if (POLES.includes(layer) && !data.bodies.some((body) => body[layer])) continue;
    if (layer === 'relative' && !data.pairs.length) continue;
    const button = tag('button', undefined, { 'aria-pressed': !page.off.has(layer) });
    button.innerHTML = sample(layer);
    button.append(words);
    button.onclick = () => toggle(page.off, layer, button);
    by('layers').append(button);
  }
  for (const name of data.live ? CHOSEN.filter((one) => data.bodies.some((b) => b[one])) : []) {
    const button = tag('button', WORDS[name][2], { 'aria-pressed': !page.off.has(name), title: WORDS[name][0] });
    button.onclick = () => toggle(page.off, name, button);
    by('rates').append(button);
  }
  for (const pace of PACES) by('pace').append(tag('option', `${pace}×`, { value: pace }));
  by('pace').value = 1;
  by('scrub').max = data.n - 1;
}

// What a layer looks like in the picture.
function sample(layer) {
  const shapes = {
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
    velocities: '<path d="M1 11L12 4" stroke="#1c2127"/><path d="M17 1l-8 2 3 4z"/>',
    names: '<text x="2" y="12" font-size="12" font-weight="600">ab</text>',
  };
  return `<svg viewBox="0 0 18 14" aria-hidden="true">${shapes[layer]}</svg>`;
}

function listen(actions) {
  const { page, data, goTo, play, redraw, whole, stage } = actions;
  const stopped = (k) => {
    play(false);
    goTo(k);
  };
  by('play').onclick = () => play(!page.playing);
  by('back').onclick = () => stopped(page.k - 1);
  by('ahead').onclick = () => stopped(page.k + 1);
  by('scrub').oninput = (event) => stopped(Number(event.target.value));
  by('pace').onchange = (event) => actions.setPace(Number(event.target.value));
  by('whole').onclick = whole;
  by('closer').onclick = () => closer(stage, redraw, 1.4);
  by('farther').onclick = () => closer(stage, redraw, 1 / 1.4);
  const less = (factor) => () => {
    page.turning = false;
    const [[from, to], t] = [page.range, data.t[page.k]];
    const at = from <= t && t <= to ? t : (from + to) / 2;
    actions.zoom(at - (at - from) * factor, at + (to - at) * factor);
  };
  by('shorter').onclick = less(0.5);
  by('longer').onclick = less(2);
  document.addEventListener('keydown', (event) => onKey(event, actions, stopped));
  for (const plot of actions.charts.plots) onChart(plot, actions, stopped);
  onStage(by('stage'), actions);
  const again = () => {
    stage.fit();
    redraw('rest');
  };
  new ResizeObserver(again).observe(by('stage'));
  // Printed as it stands at the cursor, finely, and at once: a browser does not wait for frames.
  const printing = (on) => () => {
    page.printing = on;
    stage.fit();
    actions.charts.rest();
  };
  addEventListener('beforeprint', printing(true));
  addEventListener('afterprint', printing(false));
  matchMedia('print').addEventListener('change', (event) => printing(event.matches)());
  addEventListener('hashchange', () => toAddress(actions));
}

// An address that ends in #t=1.25 shows that instant.
function toAddress({ data, play, goTo }) {
  const time = Number(/[#&]t=([-+.\de]+)/.exec(location.hash)?.[1] ?? NaN);
  if (!isFinite(time)) return false;
  play(false);
  goTo(instantAt(data, time));
  return true;
}

const trouble = (text) => by('title').after(tag('p', text, { id: 'trouble' }));

async function start() {
  if (typeof DecompressionStream === 'undefined') {
    trouble('This browser is too old to unpack the figures: Chrome 80, Firefox 113, Safari 16.4 '
      + 'or newer can.');
    return;
  }
  const raw = await inflate(by('data').textContent);
  by('made').textContent = raw.made;
  for (const layer of [...POLES, 'relative', 'fixed', 'moving']) {
    const mark = tag('dt');
    mark.innerHTML = sample(layer);
    by('marks').append(mark, tag('dd', MEANINGS[layer]));
  }
  if (raw.live) watch();
  else show(prepare(raw));
}

function tellAbout({ about, notes }) {
  by('about').textContent = about;
  if (!notes.length) return;
  const words = notes.length > 1 ? `${notes.length} warnings` : '1 warning';
  by('about').append(' · ', tag('a', words, { href: '#notes' }));
}

function show(data) {
  by('title').textContent = data.title;
  tellAbout(data);
  drawLacking(by('lacking'), data);
  drawTheory(by('theory'), data);
  drawNotes(by('notes'), data);
  by('work').hidden = !data.work?.length;
  by('work').querySelector('pre').textContent = (data.work || []).join('\n').trim();
  if (data.solved) by('now').after(by('polygons'));
  const actions = makePage(data);
  if (data.edit) makeEditor(actions);
  actions.open();
  const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
  if (!toAddress(actions) && !still) actions.play(true);
  document.documentElement.dataset.ready = 'yes';
}

start().catch((error) => {
  trouble(`This page cannot be shown: ${error.message}. The file may be cut off; get it anew.`);
  throw error;
});
