// ---- Charts: every figure over time, on one time axis, with one cursor ----

const [LEFT, RIGHT, TOP, BOTTOM] = [58, 92, 6, 20];

function chartList(data) {
  const list = [];
  const ofBodies = (name) => data.bodies.filter((body) => body[name]).map((body) => ({
    name: body.name, bodies: [body.name], color: body.color, ...body[name],
    theory: body.theory[name],
  }));
  for (const name of [...RATES, 'icr_velocity', 'centrode_curvature']) {
    const series = ofBodies(name).filter(({ value }) => data.live || value.some(isFinite));
    if (series.length) list.push({ name, title: WORDS[name][0], unit: WORDS[name][1], series });
  }
  if (data.pairs.length) {
    const series = data.somePairs.map(({ j, i, rate, color }) => ({
      name: `${j.name}/${i.name}`, bodies: [j.name, i.name], color, ...rate,
    }));
    list.splice(RATES.length, 0, {
      name: 'relative', title: 'relative angular velocity', unit: 'rad/s', series,
    });
  }
  return list;
}

function makeCharts(element, page, data) {
  const charts = chartList(data).map((spec) => {
    const figure = document.createElement('figure');
    figure.className = 'chart';
    figure.dataset.name = spec.name;
    figure.innerHTML = '<figcaption><b></b><span class="unit"></span></figcaption>'
      + '<div class="plot"><canvas></canvas><canvas></canvas></div>';
    figure.querySelector('b').textContent = spec.title;
    figure.querySelector('.unit').textContent = spec.unit;
    if (!data.live && !spec.series.some(({ sigma }) => sigma?.some(isFinite))) {
      figure.firstChild.append(tag('span', data.solved ? 'solved' : 'no deviations in this bag', { class: 'unit' }));
    }
    if (spec.series.some(({ theory }) => theory)) {
      figure.firstChild.append(tag('span', `dashed: theory of ${data.scene}`, { class: 'unit' }));
    }
    element.append(figure);
    const [under, over] = figure.querySelectorAll('canvas');
    return { ...spec, figure, plot: figure.querySelector('.plot'), under, over, seen: true };
  });
  const watcher = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const chart = charts.find(({ plot }) => plot === target);
      chart.seen = isIntersecting;
      if (isIntersecting) draw(chart);
    }
  }, { rootMargin: '200px' });
  for (const { plot } of charts) watcher.observe(plot);

  const shown = (series) => series.filter(({ bodies }) => !bodies.some((b) => page.hidden.has(b)));

  function draw(chart) {
    const { context, width, height } = fitted(chart.under, page.printing);
    const [from, to] = page.range;
    const series = shown(chart.series);
    const first = Math.max(0, instantAt(data, from) - 1);
    const last = Math.min(data.n - 1, instantAt(data, to) + 1);
    const [low, high] = heights(series, first, last);
    const x = (t) => LEFT + ((t - from) / (to - from || 1)) * (width - LEFT - RIGHT);
    const y = (v) => TOP + ((high - v) / (high - low)) * (height - TOP - BOTTOM);
    Object.assign(chart, { x, y, low, high, width, height });
    drawAxes(context, chart, from, to);
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
    context.clip();
    for (const one of series) drawSeries(context, one, first, last, x, y);
    context.restore();
    drawEnds(context, chart, series, last);
    mark(chart);
  }

  // Ranges are those of the figures themselves; a few far ones do not squeeze the rest.
  function heights(series, first, last) {
    const step = Math.max(1, Math.floor((last - first) / 500));
    const found = [];
    const noise = [];
    for (const { value, sigma, theory } of series) {
      for (let k = first; k <= last; k += step) {
        if (isFinite(value[k])) found.push(value[k]);
        if (sigma && isFinite(sigma[k])) noise.push(2 * sigma[k]);
        if (theory && isFinite(theory[k])) found.push(theory[k]);
      }
    }
    if (!found.length) return [-1, 1];
    found.sort((a, b) => a - b);
    noise.sort((a, b) => a - b);
    const [q, p] = [0.02, 0.98].map((part) => tamed(found, part));
    // Bands are seen whole as a rule, as long as they leave something to see of the figures.
    const [band, wide] = noise.length ? [0.5, 0.75].map((part) => quantile(noise, part)) : [0, 0];
    const usual = Math.min(wide, Math.max(band, p - q));
    // What is one figure throughout has an axis of its own size.
    const flat = p === q ? 0.2 * Math.abs(p) || 1 : 1e-6 * Math.max(Math.abs(p), Math.abs(q));
    const room = Math.max(0.4 * (p - q), usual, flat);
    const low = Math.max(found[0] - usual, q - room);
    const high = Math.min(found[found.length - 1] + usual, p + room);
    const margin = 0.06 * (high - low) || room;
    return [low - margin, high + margin];
  }

  function drawAxes(context, chart, from, to) {
    const { width, height, x, y } = chart;
    // Two at least, or nobody knows the scale.
    const few = ticks(chart.low, chart.high, height / 36);
    const up = few.at.length > 1 ? few : ticks(chart.low, chart.high, height / 18);
    drawTimes(context, ticks(from, to, (width - LEFT - RIGHT) / 70), x, width, height);
    for (const v of up.at) {
      context.fillStyle = Math.abs(v) < up.step / 2 ? '#b9c1c9' : '#edf0f2';
      context.fillRect(LEFT, Math.round(y(v)), width - LEFT - RIGHT, 1);
      context.fillStyle = '#6a737c';
      context.textAlign = 'right';
      context.fillText(tickWords(v, up.step), LEFT - 6, y(v) + 4);
    }
  }

  function drawSeries(context, { value, sigma, theory, color }, first, last, x, y) {
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
      context.strokeStyle = '#1c2127';
      context.stroke(linePath(data, theory, first, last, x, y));
      context.setLineDash([]);
    }
  }

  // Names at the ends of the lines, one under the other where they would meet.
  function drawEnds(context, chart, series, last) {
    const [top, bottom] = [TOP + 6, chart.height - BOTTOM - 5];
    const gap = Math.min(12, (bottom - top) / Math.max(1, series.length - 1));
    const ends = series.map((one) => {
      let k = last;
      while (k > 0 && !isFinite(one.value[k])) k--;
      const at = chart.y(one.value[k]);
      return { one, at: Math.max(top, isFinite(at) ? at : 0) };
    }).sort((a, b) => a.at - b.at);
    // Down from the first, then up from the last, which stays above the numbers of the time axis.
    ends.forEach((end, k) => {
      if (k) end.at = Math.max(end.at, ends[k - 1].at + gap);
    });
    for (let k = ends.length - 1, most = bottom; k >= 0; k--, most -= gap) {
      ends[k].at = Math.min(ends[k].at, most);
    }
    context.textAlign = 'left';
    context.font = '600 11px system-ui, sans-serif';
    for (const { one, at } of ends) {
      context.fillStyle = one.color;
      const name = one.name.length > 15 ? `${one.name.slice(0, 14)}…` : one.name;
      context.fillText(name, chart.width - RIGHT + 5, at + 4, RIGHT - 7);
    }
  }

  // The cursor, with a dot on each line.
  function mark(chart) {
    const { context } = fitted(chart.over, page.printing);
    const t = data.t[page.k];
    if (t < page.range[0] || t > page.range[1]) return;
    const left = chart.x(t);
    context.fillStyle = '#1c2127';
    context.fillRect(Math.round(left) - 0.5, TOP, 1, chart.height - TOP - BOTTOM);
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
    rest: () => charts.forEach((chart) => {
      // The layer of that name is of centers, not of rates.
      chart.figure.hidden = chart.name !== 'relative' && page.off.has(chart.name);
      if ((chart.seen || page.printing) && !chart.figure.hidden) draw(chart);
    }),
    move: () => charts.forEach((chart) => (chart.seen || page.printing) && chart.x && mark(chart)),
    plots: charts.map(({ plot }) => plot),
  };
}

function drawTimes(context, { step, at }, x, width, height) {
  context.font = '11px system-ui, sans-serif';
  context.textAlign = 'center';
  for (const t of at) {
    context.fillStyle = '#edf0f2';
    context.fillRect(Math.round(x(t)), TOP, 1, height - TOP - BOTTOM);
    context.fillStyle = '#6a737c';
    // The unit is with the last one, where nothing else stands.
    const unit = t === at[at.length - 1] ? ' s' : '';
    context.fillText(tickWords(t, step) + unit, x(t), height - 6);
  }
}

// A quantile, or that of the inner 80% where the outer ones are far beyond these, as of speeds
// that go through infinity.
function tamed(sorted, part) {
  const [middle, inner] = [quantile(sorted, 0.5), quantile(sorted, part > 0.5 ? 0.9 : 0.1)];
  const found = quantile(sorted, part);
  return Math.abs(found - middle) > 8 * Math.abs(inner - middle) ? inner : found;
}

// ---- Lines of at most four points a pixel column, so that long recordings cost no more ----

function columnsOf(data, value, first, last, x, visit, lift) {
  const dense = last - first > 2 * Math.max(1, x(data.t[last]) - x(data.t[first]));
  for (let k = first; k <= last;) {
    if (!isFinite(value[k])) {
      lift();
      k++;
      continue;
    }
    if (k > first && data.t[k] - data.t[k - 1] > 2.5 * data.period) lift();
    const column = Math.floor(x(data.t[k]));
    const start = k;
    k++;
    while (dense && k <= last && isFinite(value[k]) && Math.floor(x(data.t[k])) === column) k++;
    visit(start, k);
  }
  lift();
}

function linePath(data, value, first, last, x, y) {
  const path = new Path2D();
  let alone = null;
  let pen = false;
  const to = (k) => {
    const [left, top] = [x(data.t[k]), y(value[k])];
    path[pen ? 'lineTo' : 'moveTo'](left, top);
    alone = pen ? null : [left, top];
    pen = true;
  };
  columnsOf(data, value, first, last, x, (start, end) => {
    let [low, high] = [start, start];
    for (let k = start + 1; k < end; k++) {
      if (value[k] < value[low]) low = k;
      if (value[k] > value[high]) high = k;
    }
    for (const k of [...new Set([start, low, high, end - 1])].sort((a, b) => a - b)) to(k);
  }, () => {
    // A figure between two gaps is a dot.
    if (pen && alone) path.rect(alone[0] - 0.5, alone[1] - 0.5, 1, 1);
    pen = false;
    alone = null;
  });
  return path;
}

function bandPath(data, value, sigma, first, last, x, y) {
  const path = new Path2D();
  let edge = [];
  columnsOf(data, value, first, last, x, (start, end) => {
    let [low, high] = [Infinity, -Infinity];
    for (let k = start; k < end; k++) {
      low = Math.min(low, value[k] - 2 * sigma[k]);
      high = Math.max(high, value[k] + 2 * sigma[k]);
    }
    if (isFinite(low) && isFinite(high)) edge.push([x(data.t[start]), y(high), y(low)]);
  }, () => {
    edge.forEach(([left, top], k) => path[k ? 'lineTo' : 'moveTo'](left, top));
    for (const [left, , bottom] of edge.reverse()) path.lineTo(left, bottom);
    if (edge.length) path.closePath();
    edge = [];
  });
  return path;
}
