// ---- Keys, mouse and touch ----

const PACES = [0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];

function onKey(event, actions) {
  const { page, data, play, stopAt } = actions;
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  // A slider or list with the focus keeps its own keys.
  const isField = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
  if (isField && event.key !== ' ') return;
  const step = event.shiftKey ? 10 : 1;
  const changePace = (by) => {
    const index = PACES.indexOf(page.pace) + by;
    actions.setPace(PACES[Math.min(PACES.length - 1, Math.max(0, index))]);
  };
  const keys = {
    ' ': () => play(!page.playing),
    ArrowLeft: () => stopAt(page.k - step),
    ArrowRight: () => stopAt(page.k + step),
    Home: () => stopAt(0),
    End: () => stopAt(data.n - 1),
    '+': () => changePace(1),
    '=': () => changePace(1),
    '-': () => changePace(-1),
    f: actions.showAll,
    l: () => byId('live').click(),
  };
  const bodyButton = byId('bodies').children[Number(event.key) - 1];
  if (bodyButton) bodyButton.click();
  else if (keys[event.key]) keys[event.key]();
  else return;
  // Otherwise the space would also press a button with the focus.
  event.preventDefault();
}

// In a chart, drag and tap move the cursor; ctrl and wheel zoom about it.
function listenToChart(plot, { data, page, zoom, stopAt }) {
  const timeAt = (event) => {
    const box = plot.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return page.range[0] + Math.min(1, Math.max(0, share)) * (page.range[1] - page.range[0]);
  };
  const moveCursor = (event) => stopAt(instantAt(data, timeAt(event)));
  plot.addEventListener('pointerdown', (event) => {
    plot.setPointerCapture(event.pointerId);
    moveCursor(event);
  });
  plot.addEventListener('pointermove', (event) => {
    if (plot.hasPointerCapture(event.pointerId)) moveCursor(event);
  });
  plot.addEventListener('dblclick', () => zoom(data.begin, data.end));
  plot.addEventListener('wheel', (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    const factor = Math.exp(event.deltaY * 0.004);
    const at = timeAt(event);
    zoom(at - (at - page.range[0]) * factor, at + (page.range[1] - at) * factor);
  }, { passive: false });
}

// Enlarges the stage about a point in pixels, or about its middle.
function enlarge({ stage, redraw }, factor, at = null) {
  const { view, sizes } = stage;
  const [u, v] = at ? [at[0] - sizes.width / 2, sizes.height / 2 - at[1]] : [0, 0];
  view.x += (u / view.scale) * (1 - 1 / factor);
  view.y += (v / view.scale) * (1 - 1 / factor);
  view.scale *= factor;
  view.isFixed = true;
  redraw('all');
}

// On the stage, drag moves the picture, wheel and pinch enlarge it.
function listenToStage(element, actions) {
  const { view } = actions.stage;
  const fingers = new Map();
  const position = (event) => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const pinch = () => {
    const [[ax, ay], [bx, by]] = [...fingers.values()];
    return { at: [(ax + bx) / 2, (ay + by) / 2], distance: Math.hypot(ax - bx, ay - by) };
  };
  element.addEventListener('pointerdown', (event) => {
    if (event.target.closest('button')) return;
    element.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, position(event));
  });
  const point = (at) => {
    actions.page.pointer = at;
    if (actions.stage.isOn('path')) actions.redraw('instant');
  };
  element.addEventListener('pointerleave', () => point(null));
  element.addEventListener('pointermove', (event) => {
    point(position(event));
    if (!fingers.has(event.pointerId)) return;
    const [before, [px, py]] = [fingers.size > 1 && pinch(), fingers.get(event.pointerId)];
    const [x, y] = position(event);
    fingers.set(event.pointerId, [x, y]);
    const pixels = view.scale * fingers.size;
    view.x -= (x - px) / pixels;
    view.y += (y - py) / pixels;
    view.isFixed = true;
    if (before) enlarge(actions, pinch().distance / (before.distance || 1), pinch().at);
    actions.redraw('all');
  });
  for (const end of ['pointerup', 'pointercancel']) {
    element.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  element.addEventListener('wheel', (event) => {
    event.preventDefault();
    enlarge(actions, Math.exp(-event.deltaY * 0.0015), position(event));
  }, { passive: false });
  element.addEventListener('dblclick', actions.showAll);
}

function listen(actions) {
  const { page, data, play, stopAt, stage, charts } = actions;
  byId('play').onclick = () => play(!page.playing);
  byId('previous').onclick = () => stopAt(page.k - 1);
  byId('next').onclick = () => stopAt(page.k + 1);
  byId('scrub').oninput = (event) => stopAt(Number(event.target.value));
  byId('pace').onchange = (event) => actions.setPace(Number(event.target.value));
  byId('fit').onclick = actions.showAll;
  byId('enlarge').onclick = () => enlarge(actions, 1.4);
  byId('reduce').onclick = () => enlarge(actions, 1 / 1.4);
  const zoomBy = (factor) => () => {
    page.turnsPages = false;
    const [[from, to], t] = [page.range, data.t[page.k]];
    const at = from <= t && t <= to ? t : (from + to) / 2;
    actions.zoom(at - (at - from) * factor, at + (to - at) * factor);
  };
  byId('zoom-in').onclick = zoomBy(0.5);
  byId('zoom-out').onclick = zoomBy(2);
  document.addEventListener('keydown', (event) => onKey(event, actions));
  for (const plot of charts.plots) listenToChart(plot, actions);
  listenToStage(byId('stage'), actions);
  new ResizeObserver(() => {
    stage.fit();
    actions.redraw('all');
  }).observe(byId('stage'));
  // The page is printed as it is at the cursor, in high resolution. It is drawn at once, since a
  // browser does not wait for animation frames.
  const setPrinting = (printing) => {
    page.printing = printing;
    stage.fit();
    charts.draw();
  };
  addEventListener('beforeprint', () => setPrinting(true));
  addEventListener('afterprint', () => setPrinting(false));
  matchMedia('print').addEventListener('change', (event) => setPrinting(event.matches));
  addEventListener('hashchange', () => goToAddress(actions));
}

// An address that ends in #t=1.25 shows that instant.
function goToAddress({ data, stopAt }) {
  const time = Number(/[#&]t=([-+.\de]+)/.exec(location.hash)?.[1] ?? NaN);
  if (!isFinite(time)) return false;
  stopAt(instantAt(data, time));
  return true;
}
