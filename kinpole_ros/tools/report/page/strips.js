// ---- Strips: when which figure was withheld, and why ----

const REASON_COLORS = ['#98a1aa', '#d9a441', '#7d6aa8', '#b5654a', '#3f8f86', '#1c2127'];
const [ROW, GAP] = [13, 3];

// One row a body and figure that is lacking at times, with its spells.
function stripRows(data) {
  const rows = [];
  for (const body of data.bodies) {
    const names = [...POLES, 'centrode_curvature'].filter((name) => body[name]);
    for (const name of names) {
      const spells = [...body.missing, ...(body.withheld[name] ?? [])];
      if (spells.length) rows.push({ body, label: `${WORDS[name][2]} ${body.name}`, spells });
    }
  }
  return rows;
}

function makeStrips(element, page, data) {
  const rows = stripRows(data);
  if (!rows.length) return { rest() {}, move() {}, plots: [] };
  const reasons = [...new Set(rows.flatMap(({ spells }) => spells.map(([, , why]) => why)))];
  const colorOf = (why) => REASON_COLORS[Math.min(reasons.indexOf(why), REASON_COLORS.length - 1)];
  const figure = tag('figure', undefined, { class: 'chart', 'data-name': 'withheld' });
  const caption = tag('figcaption');
  caption.append(tag('b', 'withheld'));
  for (const why of reasons) {
    const entry = tag('span', undefined, { class: 'unit' });
    entry.append(tag('i', undefined, { style: `background:${colorOf(why)}` }), why);
    caption.append(entry);
  }
  const plot = tag('div', undefined, { class: 'plot' });
  plot.append(tag('canvas'), tag('canvas'));
  figure.append(caption, plot);
  element.append(figure);
  const [under, over] = plot.children;
  const shown = () => rows.filter(({ body }) => !page.hidden.has(body.name));
  let x = null;
  let box = null;

  function rest() {
    const list = shown();
    plot.style.height = `${list.length * (ROW + GAP) + TOP + BOTTOM}px`;
    box = fitted(under, page.printing);
    const { context, width, height } = box;
    const [from, to] = page.range;
    x = (t) => LEFT + ((t - from) / (to - from || 1)) * (width - LEFT - RIGHT);
    drawTimes(context, ticks(from, to, (width - LEFT - RIGHT) / 70), x, width, height);
    const within = (t) => Math.min(width - RIGHT, Math.max(LEFT, x(t)));
    list.forEach(({ body, label, spells }, k) => {
      const top = TOP + k * (ROW + GAP);
      context.fillStyle = '#f1f3f5';
      context.fillRect(LEFT, top, width - LEFT - RIGHT, ROW);
      for (const [start, end, why] of spells) {
        // Half a period to both sides of its instants.
        const left = within(data.t[start] - data.period / 2);
        const right = within(data.t[Math.min(end, data.n) - 1] + data.period / 2);
        context.fillStyle = colorOf(why);
        if (right > left) context.fillRect(left, top, Math.max(1, right - left), ROW);
      }
      context.textAlign = 'left';
      context.font = '600 11px system-ui, sans-serif';
      context.fillStyle = body.color;
      context.fillText(label, width - RIGHT + 5, top + ROW - 3);
    });
    move();
  }

  function move() {
    if (!box) return;
    const { context } = fitted(over, page.printing);
    const t = data.t[page.k];
    if (t < page.range[0] || t > page.range[1]) return;
    context.fillStyle = '#1c2127';
    context.fillRect(Math.round(x(t)) - 0.5, TOP, 1, box.height - TOP - BOTTOM);
  }

  return { rest, move, plots: [plot] };
}
