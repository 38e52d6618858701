// ---- Charts: all quantities over time, and when they were withheld, with one cursor ----

const [LEFT, RIGHT, TOP, BOTTOM] = [58, 92, 6, 20];
const REASON_COLORS = ['#98a1aa', '#d9a441', '#7d6aa8', '#b5654a', '#3f8f86', INK];
const [EVENT_COLOR, EVENT_TICK] = ['#c00000', 9]; // and pixels
const [ROW, GAP] = [13, 3]; // of the chart of withheld quantities, pixels

function chartSpecs(data) {
  const specs = [];
  for (const name of [...RATES, 'icr_velocity', 'centrode_curvature', 'inflection_diameter']) {
    const series = data.bodies.filter((body) => body[name]).map((body) => ({
      name: body.name, bodies: [body.name], color: body.color, ...body[name],
      theory: body.theory[name], events: body.events ?? [],
    })).filter(({ value }) => data.live || value.some(isFinite));
    const [title, unit] = QUANTITIES[name];
    if (series.length) specs.push({ name, title, unit, series });
  }
  if (data.pairs.length) {
    const series = data.shownPairs.map(({ j, i, rate, color }) => ({
      name: `${j.name}/${i.name}`, bodies: [j.name, i.name], color, ...rate,
    }));
    const spec = { name: 'relative', title: 'relative angular velocity', unit: 'rad/s', series };
    specs.splice(RATES.length, 0, spec);
  }
  return specs;
}

// A figure with two canvases on top of each other, and notes after its title.
function addChart(element, name, title, notes) {
  const figure = tag('figure', undefined, { class: 'chart', 'data-name': name });
  const caption = tag('figcaption');
  caption.append(tag('b', title), ...notes);
  const plot = tag('div', undefined, { class: 'plot' });
  const [under, over] = [tag('canvas'), tag('canvas')];
  plot.append(under, over);
  figure.append(caption, plot);
  element.append(figure);
  return { name, figure, plot, under, over };
}

function makeCharts(element, page, data) {
  const charts = chartSpecs(data).map((spec) => {
    const note = (text) => tag('span', text, { class: 'unit' });
    const notes = [note(spec.unit)];
    if (!data.live && !spec.series.some(({ sigma }) => sigma?.some(isFinite))) {
      notes.push(note(data.solved ? 'solved' : 'no deviations in this bag'));
    }
    if (spec.series.some(({ events }) => events?.length)) {
      notes.push(note('red ticks: velocity, acceleration or jerk steps'));
    }
    if (spec.series.some(({ theory }) => theory)) notes.push(note(`dashed: theory of ${data.scene}`));
    const chart = { ...spec, ...addChart(element, spec.name, spec.title, notes), isVisible: true };
    return Object.assign(chart, { draw: () => draw(chart), drawCursor: () => drawCursor(chart) });
  });
  const watcher = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const chart = charts.find(({ plot }) => plot === target);
      chart.isVisible = isIntersecting;
      if (isIntersecting) draw(chart);
    }
  }, { rootMargin: '200px' });
  for (const { plot } of charts) watcher.observe(plot);
  const all = [...charts, ...makeWithheldChart(element, page, data)];

  const shown = (series) => series.filter(({ bodies }) => !bodies.some((b) => page.hidden.has(b)));

  function draw(chart) {
    const { context, width, height } = emptyCanvas(chart.under, page.printing);
    const [from, to] = page.range;
    const series = shown(chart.series);
    const first = Math.max(0, instantAt(data, from) - 1);
    const last = Math.min(data.n - 1, instantAt(data, to) + 1);
    const [low, high] = valueRange(series, first, last);
    const x = timeScale(page, width);
    const y = (v) => TOP + ((high - v) / (high - low)) * (height - TOP - BOTTOM);
    Object.assign(chart, { x, y, low, high, width, height });
    drawTimes(context, page, x, width, height);
    drawValues(context, chart);
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
    context.clip();
    for (const one of series) drawSeries(context, data, one, first, last, x, y);
    context.fillStyle = EVENT_COLOR;
    for (const { events } of series) {
      for (const [time] of events ?? []) context.fillRect(x(time) - 1, TOP, 2, EVENT_TICK);
    }
    context.restore();
    drawEndNames(context, chart, series, last);
    drawCursor(chart);
  }

  // The cursor, with a dot on each line.
  function drawCursor(chart) {
    if (!chart.x) return;
    const { context } = emptyCanvas(chart.over, page.printing);
    const left = drawCursorLine(context, page, data, chart.x, chart.height);
    if (left === null) return;
    for (const { value, color } of shown(chart.series)) {
      const top = chart.y(value[page.k]);
      if (!(top >= TOP && top <= chart.height - BOTTOM)) continue;
      context.beginPath();
      context.arc(left, top, 3.6, 0, 2 * Math.PI);
      context.fillStyle = color;
      context.fill();
      context.strokeStyle = '#fff';
      context.lineWidth = 1.2;
      context.stroke();
    }
  }

  return {
    draw() {
      for (const chart of all) {
        // The layer `relative` is of centers, not of rates.
        chart.figure.hidden = chart.name !== 'relative' && page.off.has(chart.name);
        if ((chart.isVisible || page.printing) && !chart.figure.hidden) chart.draw();
      }
    },
    drawCursor() {
      for (const chart of all) if (chart.isVisible || page.printing) chart.drawCursor();
    },
    plots: all.map(({ plot }) => plot),
  };
}

// One row for each quantity of a body that is withheld at times, colored by the reason.
function makeWithheldChart(element, page, data) {
  const rows = data.bodies.flatMap((body) => WITHHELD.filter((name) => body[name]).map((name) => ({
    body, label: `${QUANTITIES[name][2]} ${body.name}`, intervals: [...body.lost, ...withheldIntervals(body, name)],
  }))).filter(({ intervals }) => intervals.length);
  if (!rows.length) return [];
  const reasons = [...new Set(rows.flatMap(({ intervals }) => intervals.map(([, , text]) => text)))];
  const colorOf = (text) => REASON_COLORS[Math.min(reasons.indexOf(text), REASON_COLORS.length - 1)];
  const notes = reasons.map((text) => {
    const note = tag('span', undefined, { class: 'unit' });
    note.append(tag('i', undefined, { style: `background:${colorOf(text)}` }), text);
    return note;
  });
  const chart = { ...addChart(element, 'withheld', 'withheld', notes), isVisible: true };
  let [x, height] = [null, 0];

  chart.draw = () => {
    const shown = rows.filter(({ body }) => !page.hidden.has(body.name));
    chart.plot.style.height = `${shown.length * (ROW + GAP) + TOP + BOTTOM}px`;
    const { context, width, height: newHeight } = emptyCanvas(chart.under, page.printing);
    [x, height] = [timeScale(page, width), newHeight];
    drawTimes(context, page, x, width, height);
    const inChart = (t) => Math.min(width - RIGHT, Math.max(LEFT, x(t)));
    shown.forEach(({ body, label, intervals }, k) => {
      const top = TOP + k * (ROW + GAP);
      context.fillStyle = '#f1f3f5';
      context.fillRect(LEFT, top, width - LEFT - RIGHT, ROW);
      for (const [start, end, text] of intervals) {
        // Half a period to both sides of its instants.
        const left = inChart(data.t[start] - data.period / 2);
        const right = inChart(data.t[Math.min(end, data.n) - 1] + data.period / 2);
        context.fillStyle = colorOf(text);
        if (right > left) context.fillRect(left, top, Math.max(1, right - left), ROW);
      }
      context.textAlign = 'left';
      context.font = `600 11${FONT}`;
      context.fillStyle = body.color;
      context.fillText(label, width - RIGHT + 5, top + ROW - 3);
    });
    chart.drawCursor();
  };

  chart.drawCursor = () => {
    if (!x) return;
    const { context } = emptyCanvas(chart.over, page.printing);
    drawCursorLine(context, page, data, x, height);
  };

  return [chart];
}

// ---- Axes ----

function timeScale(page, width) {
  const [from, to] = page.range;
  return (t) => LEFT + ((t - from) / (to - from || 1)) * (width - LEFT - RIGHT);
}

function drawTimes(context, page, x, width, height) {
  const { step, at } = ticks(...page.range, (width - LEFT - RIGHT) / 70);
  context.font = `11${FONT}`;
  context.textAlign = 'center';
  at.forEach((t, k) => {
    context.fillStyle = GRID;
    context.fillRect(Math.round(x(t)), TOP, 1, height - TOP - BOTTOM);
    context.fillStyle = '#6a737c';
    const unit = k === at.length - 1 ? ' s' : '';
    context.fillText(tickText(t, step) + unit, x(t), height - 6);
  });
}

function drawValues(context, { low, high, width, height, y }) {
  // At least two, which show the scale.
  let { step, at } = ticks(low, high, height / 36);
  if (at.length < 2) ({ step, at } = ticks(low, high, height / 18));
  for (const v of at) {
    context.fillStyle = Math.abs(v) < step / 2 ? '#b9c1c9' : GRID;
    context.fillRect(LEFT, Math.round(y(v)), width - LEFT - RIGHT, 1);
    context.fillStyle = '#6a737c';
    context.textAlign = 'right';
    context.fillText(tickText(v, step), LEFT - 6, y(v) + 4);
  }
}

// Returns where the cursor is, null if it is not in the range of the charts.
function drawCursorLine(context, page, data, x, height) {
  const t = data.t[page.k];
  if (t < page.range[0] || t > page.range[1]) return null;
  context.fillStyle = INK;
  context.fillRect(Math.round(x(t)) - 0.5, TOP, 1, height - TOP - BOTTOM);
  return x(t);
}

// The range of the values; a few outliers do not squeeze the others, and bands are mostly visible.
function valueRange(series, first, last) {
  const step = Math.max(1, Math.floor((last - first) / 500));
  const [values, bands] = [[], []];
  for (const { value, sigma, theory } of series) {
    for (let k = first; k <= last; k += step) {
      if (isFinite(value[k])) values.push(value[k]);
      if (sigma && isFinite(sigma[k])) bands.push(2 * sigma[k]);
      if (theory && isFinite(theory[k])) values.push(theory[k]);
    }
  }
  if (!values.length) return [-1, 1];
  values.sort((a, b) => a - b);
  bands.sort((a, b) => a - b);
  const [low, high] = [0.02, 0.98].map((share) => innerQuantile(values, share));
  const [median, wide] = bands.length ? [0.5, 0.75].map((share) => quantile(bands, share)) : [0, 0];
  const band = Math.min(wide, Math.max(median, high - low));
  // The axis of a constant has its own size.
  const flat = low === high ? 0.2 * Math.abs(high) || 1
    : 1e-6 * Math.max(Math.abs(low), Math.abs(high));
  const margin = Math.max(0.4 * (high - low), band, flat);
  const bottom = Math.max(values[0] - band, low - margin);
  const top = Math.min(values[values.length - 1] + band, high + margin);
  const edge = 0.06 * (top - bottom) || margin;
  return [bottom - edge, top + edge];
}

// A quantile; that of the inner 80% if the outer ones are far away, as of speeds near infinity.
function innerQuantile(sorted, share) {
  const [median, inner] = [quantile(sorted, 0.5), quantile(sorted, share > 0.5 ? 0.9 : 0.1)];
  const outer = quantile(sorted, share);
  return Math.abs(outer - median) > 8 * Math.abs(inner - median) ? inner : outer;
}

// Names at the ends of the lines, shifted so that they do not overlap.
function drawEndNames(context, chart, series, last) {
  const [top, bottom] = [TOP + 6, chart.height - BOTTOM - 5];
  const gap = Math.min(12, (bottom - top) / Math.max(1, series.length - 1));
  const names = series.map(({ name, color, value }) => {
    let k = last;
    while (k > 0 && !isFinite(value[k])) k--;
    const at = chart.y(value[k]);
    return { name, color, at: Math.max(top, isFinite(at) ? at : 0) };
  }).sort((a, b) => a.at - b.at);
  // Down from the first one, then up from the last one, which stays above the time axis.
  names.forEach((name, k) => {
    if (k) name.at = Math.max(name.at, names[k - 1].at + gap);
  });
  for (let k = names.length - 1, lowest = bottom; k >= 0; k--, lowest -= gap) {
    names[k].at = Math.min(names[k].at, lowest);
  }
  context.textAlign = 'left';
  context.font = `600 11${FONT}`;
  for (const { name, color, at } of names) {
    context.fillStyle = color;
    const text = name.length > 15 ? `${name.slice(0, 14)}…` : name;
    context.fillText(text, chart.width - RIGHT + 5, at + 4, RIGHT - 7);
  }
}

// ---- Lines of at most four points per pixel column, so that long recordings cost no more ----

function drawSeries(context, data, { value, sigma, theory, color }, first, last, x, y) {
  context.lineJoin = 'round';
  context.strokeStyle = context.fillStyle = color;
  if (sigma) {
    context.globalAlpha = 0.22;
    context.fill(bandPath(data, value, sigma, first, last, x, y));
    context.globalAlpha = 1;
  }
  context.lineWidth = 1.6;
  context.stroke(linePath(data, value, first, last, x, y));
  if (theory) {
    context.setLineDash([4, 3]);
    context.lineWidth = 1.2;
    context.strokeStyle = INK;
    context.stroke(linePath(data, theory, first, last, x, y));
    context.setLineDash([]);
  }
}

// Calls `visit(start, end)` for the values in each pixel column, and `endLine()` at gaps.
function visitColumns(data, value, first, last, x, visit, endLine) {
  const isDense = last - first > 2 * Math.max(1, x(data.t[last]) - x(data.t[first]));
  for (let k = first; k <= last;) {
    if (!isFinite(value[k])) {
      endLine();
      k++;
      continue;
    }
    if (k > first && isGap(data, k)) endLine();
    const column = Math.floor(x(data.t[k]));
    const start = k;
    k++;
    while (isDense && k <= last && isFinite(value[k]) && Math.floor(x(data.t[k])) === column) k++;
    visit(start, k);
  }
  endLine();
}

function linePath(data, value, first, last, x, y) {
  const path = new Path2D();
  let points = [];
  visitColumns(data, value, first, last, x, (start, end) => {
    let [low, high] = [start, start];
    for (let k = start + 1; k < end; k++) {
      if (value[k] < value[low]) low = k;
      if (value[k] > value[high]) high = k;
    }
    const indices = [...new Set([start, low, high, end - 1])].sort((a, b) => a - b);
    points.push(...indices.map((k) => [x(data.t[k]), y(value[k])]));
  }, () => {
    addLines(path, points);
    // A value between two gaps is a dot.
    if (points.length === 1) path.rect(points[0][0] - 0.5, points[0][1] - 0.5, 1, 1);
    points = [];
  });
  return path;
}

function bandPath(data, value, sigma, first, last, x, y) {
  const path = new Path2D();
  let edge = [];
  visitColumns(data, value, first, last, x, (start, end) => {
    let [low, high] = [Infinity, -Infinity];
    for (let k = start; k < end; k++) {
      low = Math.min(low, value[k] - 2 * sigma[k]);
      high = Math.max(high, value[k] + 2 * sigma[k]);
    }
    if (isFinite(low) && isFinite(high)) edge.push([x(data.t[start]), y(high), y(low)]);
  }, () => {
    const bottom = edge.map(([left, , low]) => [left, low]).reverse();
    addLines(path, [...edge, ...bottom]);
    if (edge.length) path.closePath();
    edge = [];
  });
  return path;
}
