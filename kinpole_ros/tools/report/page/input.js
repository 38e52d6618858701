// ---- Keys, pointers and fingers ----

const MEANINGS = {
  icr: 'ICR: the point of the body at rest, about which it turns at this instant',
  iap: 'IAP: the point without acceleration',
  ijp: 'IJP: the point without jerk',
  isp: 'ISP: the point without snap',
  relative: 'relative center: the point at which two bodies move alike; the pin, where there is one',
  fixed: 'fixed centrode: where the ICR goes in the plane',
  moving: 'moving centrode: where it goes in the body; rolls on the fixed one without slip',
};

function onKey(event, actions, stopped) {
  const { page, data, play, whole } = actions;
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  // A slider or a list that has the focus keeps its own keys.
  const own = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
  if (own && event.key !== ' ') return;
  const step = event.shiftKey ? 10 : 1;
  const faster = (by) => {
    const at = PACES.indexOf(page.pace) + by;
    actions.setPace(PACES[Math.min(PACES.length - 1, Math.max(0, at))]);
  };
  const keys = {
    ' ': () => play(!page.playing),
    ArrowLeft: () => stopped(page.k - step),
    ArrowRight: () => stopped(page.k + step),
    Home: () => stopped(0),
    End: () => stopped(data.n - 1),
    '+': () => faster(1),
    '=': () => faster(1),
    '-': () => faster(-1),
    f: whole,
    l: () => by('live').click(),
  };
  const body = by('bodies').children[Number(event.key) - 1];
  if (body) body.click();
  else if (keys[event.key]) keys[event.key]();
  else return;
  // A button with the focus is not pressed by the space that plays.
  event.preventDefault();
}

// Drag and tap move the cursor; ctrl and wheel show less or more time about it.
function onChart(plot, { data, page, zoom }, stopped) {
  const timeAt = (event) => {
    const box = plot.getBoundingClientRect();
    const part = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return page.range[0] + Math.min(1, Math.max(0, part)) * (page.range[1] - page.range[0]);
  };
  const follow = (event) => stopped(instantAt(data, timeAt(event)));
  plot.addEventListener('pointerdown', (event) => {
    plot.setPointerCapture(event.pointerId);
    follow(event);
  });
  plot.addEventListener('pointermove', (event) => {
    if (plot.hasPointerCapture(event.pointerId)) follow(event);
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

function closer(stage, redraw, factor, at = null) {
  const { view, sizes } = stage;
  const [u, v] = at ? [at[0] - sizes.width / 2, sizes.height / 2 - at[1]] : [0, 0];
  view.x += (u / view.scale) * (1 - 1 / factor);
  view.y += (v / view.scale) * (1 - 1 / factor);
  view.scale *= factor;
  view.held = true;
  redraw('rest');
}

// Drag moves the picture, wheel and pinch bring it closer.
function onStage(element, { stage, redraw, whole }) {
  const fingers = new Map();
  const place = (event) => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const spread = () => {
    const [[ax, ay], [bx, by_]] = [...fingers.values()];
    return { at: [(ax + bx) / 2, (ay + by_) / 2], apart: Math.hypot(ax - bx, ay - by_) };
  };
  element.addEventListener('pointerdown', (event) => {
    if (event.target.closest('button')) return;
    element.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
  });
  element.addEventListener('pointermove', (event) => {
    if (!fingers.has(event.pointerId)) return;
    const [before, [px, py]] = [fingers.size > 1 && spread(), fingers.get(event.pointerId)];
    const [x, y] = place(event);
    fingers.set(event.pointerId, [x, y]);
    const part = 1 / fingers.size;
    stage.view.x -= (part * (x - px)) / stage.view.scale;
    stage.view.y += (part * (y - py)) / stage.view.scale;
    stage.view.held = true;
    if (before) closer(stage, redraw, spread().apart / (before.apart || 1), spread().at);
    redraw('rest');
  });
  for (const end of ['pointerup', 'pointercancel']) {
    element.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  element.addEventListener('wheel', (event) => {
    event.preventDefault();
    closer(stage, redraw, Math.exp(-event.deltaY * 0.0015), place(event));
  }, { passive: false });
  element.addEventListener('dblclick', whole);
}
