// ---- Tables: the figures at the cursor, and what was withheld and why ----

function tag(name, text, attributes = {}) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function makeTable(element, page, data) {
  const cells = [];
  const rows = [...RATES, ...POLES, 'icr_velocity', 'centrode_curvature'].filter((name) =>
    data.bodies.some((body) => body[name]));
  const table = tag('table');
  const head = table.createTHead().insertRow();
  const spread = { title: 'at the cursor, with two standard deviations' };
  head.append(data.exact ? tag('th') : tag('th', '± 2σ', spread));
  for (const body of data.bodies) {
    head.append(tag('th', body.name, { style: `color:${body.color}`, scope: 'col' }));
  }
  const content = table.createTBody();
  for (const name of rows) {
    const row = content.insertRow();
    row.dataset.name = name;
    const heading = tag('th', `${WORDS[name][2]} `, { scope: 'row', title: WORDS[name][0] });
    heading.append(tag('span', WORDS[name][1], { class: 'unit' }));
    row.append(heading);
    for (const body of data.bodies) cells.push(cellOf(row, body, name));
  }
  const hint = tag('p', 'There is more to the right: scroll the table sideways.', { class: 'cut' });
  element.replaceChildren(hint, table);
  const tellCut = () => {
    const { scrollWidth, clientWidth, scrollLeft } = element;
    element.classList.toggle('more', scrollLeft + clientWidth < scrollWidth - 1);
    hint.hidden = scrollWidth <= clientWidth + 1;
  };
  new ResizeObserver(tellCut).observe(element);
  element.addEventListener('scroll', tellCut);
  if (data.pairs.length) element.append(pairTable());
  // Text that is written over costs a browser less than elements made anew.
  for (const one of cells) {
    [one.figure, one.rest] = [new Text(''), new Text('')];
    const small = tag('small');
    small.append(one.rest);
    one.cell.append(one.figure, small);
  }

  function pairTable() {
    const details = tag('details');
    details.open = data.pairs.length <= MOST_PAIRS;
    details.append(tag('summary', `relative motion of ${data.pairs.length} pairs`));
    const pairs = tag('table');
    const heading = pairs.createTHead().insertRow();
    for (const text of ['', 'center mm', 'ω rad/s']) heading.append(tag('th', text));
    const rows = pairs.createTBody();
    for (const { j, i, icr, rate } of data.pairs) {
      const row = rows.insertRow();
      row.dataset.name = `${j.name}/${i.name}`;
      row.append(tag('th', `${j.name} wrt ${i.name}`, { scope: 'row' }));
      const unknown = ['', 'not known'];
      const none = (k) => (isFinite(rate.value[k]) ? ['', 'no relative rotation'] : unknown);
      cells.push({ cell: row.insertCell(), words: (k) => pointWords(icr, k) ?? none(k) });
      cells.push({ cell: row.insertCell(), words: (k) => numberWords(rate, k) ?? unknown });
    }
    details.append(pairs);
    return details;
  }

  function cellOf(row, body, name) {
    const cell = row.insertCell();
    const figure = body[name];
    return {
      cell,
      words: (k) => {
        const found = figure && (figure.value ? numberWords(figure, k) : pointWords(figure, k));
        return found ?? ['', figure ? reasonAt(body, name, k) : 'not in the bag'];
      },
    };
  }

  return {
    move() {
      for (const one of cells) {
        const [value, rest] = one.words(page.k);
        const text = `${value} ${rest}`;
        if (one.text === text) continue;
        one.text = text;
        one.cell.className = value ? '' : 'withheld';
        one.figure.data = value && `${value} `;
        one.rest.data = rest;
      }
      tellCut();
    },
  };
}

function numberWords({ value, sigma }, k) {
  return isFinite(value[k]) ? worded(value[k], sigma ? sigma[k] : NaN) : null;
}

// Coordinates in mm, and two deviations along the longer axis of the ellipse.
function pointWords({ x, y, a }, k) {
  if (!isFinite(x[k])) return null;
  const scale = a[k] > 0 ? 2e3 * a[k] : Math.hypot(x[k], y[k]);
  const rest = a[k] > 0 ? `± ${roundedTo(scale, scale)}` : '';
  return [`${roundedTo(1e3 * x[k], scale)}, ${roundedTo(1e3 * y[k], scale)}`, rest];
}

// ---- What was withheld ----

function drawLacking(element, data) {
  const names = [...POLES, 'centrode_curvature'].filter((name) =>
    data.bodies.some((body) => body[name]));
  element.append(tag('h2', 'What is determined, and why the rest is withheld'));
  const table = tag('table');
  const head = table.createTHead().insertRow();
  head.append(tag('th', 'share of the instants'), ...['rates', ...names].map((name) =>
    tag('th', WORDS[name]?.[2] ?? name, { scope: 'col' })));
  const content = table.createTBody();
  for (const body of data.bodies) {
    const row = content.insertRow();
    row.append(tag('th', body.name, { scope: 'row' }));
    for (const name of ['angular_velocity', ...names]) {
      row.append(shareCell(data, body, name));
    }
  }
  const scroll = tag('div', undefined, { class: 'scroll' });
  scroll.append(table);
  element.append(scroll, tag('p', 'kinpole guesses nothing: a figure that does not stand out of its '
    + 'noise is not given. A longer lag or window, more markers or a faster motion determine more.'));
}

function shareCell(data, body, name) {
  const cell = tag('td');
  const figure = body[name];
  if (!figure) return tag('td', 'not in the bag');
  const known = (figure.value ?? figure.x).reduce((sum, v) => sum + (isFinite(v) ? 1 : 0), 0);
  cell.append(percent(known, data.n));
  const counts = {};
  for (const [from, to, reason] of [...body.missing, ...(body.withheld[name] ?? [])]) {
    counts[reason] = (counts[reason] ?? 0) + Math.min(to, data.n) - from;
  }
  for (const [reason, count] of Object.entries(counts).sort((a, b) => b[1] - a[1])) {
    cell.append(tag('small', `${percent(count, data.n)} ${reason}`));
  }
  return cell;
}

// Nothing less than all is written as 100%, nothing more than none as 0%.
function percent(count, whole) {
  const share = (100 * count) / Math.max(1, whole);
  if (share > 0 && share < 0.1) return '< 0.1%';
  if (share < 100 && share > 99.9) return '> 99.9%';
  return `${share === 0 || share === 100 ? share : share.toFixed(1)}%`;
}

function drawTheory(element, data) {
  if (!data.deviations.length) return;
  element.append(tag('h2', `Against the theory of ${data.scene}`));
  const table = tag('table');
  const head = table.createTHead().insertRow();
  for (const text of ['', 'figure', 'rms', 'in deviations']) head.append(tag('th', text));
  const content = table.createTBody();
  for (const [subject, ...cells] of data.deviations) {
    const row = content.insertRow();
    row.append(tag('th', subject, { scope: 'row' }), ...cells.map((text) => tag('td', text)));
  }
  element.append(table, tag('p', 'The driver is taken as it is seen. In deviations, 1 is as it '
    + 'should be for rates, and 1.4 for distances.'));
}

function drawNotes(element, data) {
  element.replaceChildren();
  if (!data.notes.length) return;
  element.append(tag('h2', 'Warnings'));
  const list = tag('ul');
  for (const note of data.notes) list.append(tag('li', note));
  element.append(list);
}
