// ---- Tables: values at the cursor, what was withheld and why, theory, and warnings ----

function tag(name, text, attributes = {}) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

// A table with a row of column titles; returns the table and its body.
function newTable(titles) {
  const table = tag('table');
  table.createTHead().insertRow().append(
    ...titles.map((title) => (typeof title === 'string' ? tag('th', title) : title)));
  return [table, table.createTBody()];
}

function makeTable(element, page, data) {
  // The cells, with functions that return the value and a note at instant k.
  const cells = [];
  const titles = data.bodies.map((body) =>
    tag('th', body.name, { style: `color:${body.color}`, scope: 'col' }));
  const corner = data.exact ? tag('th')
    : tag('th', '± 2σ', { title: 'at the cursor, with two standard deviations' });
  const [table, content] = newTable([corner, ...titles]);
  for (const [name, [title, unit, symbol]] of Object.entries(QUANTITIES)) {
    if (!data.bodies.some((body) => body[name])) continue;
    const row = content.insertRow();
    row.dataset.name = name;
    const heading = tag('th', `${symbol} `, { scope: 'row', title });
    heading.append(tag('span', unit, { class: 'unit' }));
    row.append(heading);
    for (const body of data.bodies) addCell(row, (k) => quantityTexts(body, name, k));
  }
  const hint = tag('p', 'There are more columns: scroll the table sideways.', { class: 'cut' });
  element.replaceChildren(hint, table);
  if (data.pairs.length) element.append(pairTable());
  const showHint = () => {
    const { scrollWidth, clientWidth, scrollLeft } = element;
    element.classList.toggle('scrolls', scrollLeft + clientWidth < scrollWidth - 1);
    hint.hidden = scrollWidth <= clientWidth + 1;
  };
  new ResizeObserver(showHint).observe(element);
  element.addEventListener('scroll', showHint);

  // Changing text nodes is faster than making elements anew.
  function addCell(row, textsAt) {
    const [cell, small] = [row.insertCell(), tag('small')];
    const [value, note] = [new Text(''), new Text('')];
    small.append(note);
    cell.append(value, small);
    cells.push({ cell, value, note, textsAt });
  }

  function pairTable() {
    const details = tag('details');
    details.open = data.pairs.length <= MOST_PAIRS;
    details.append(tag('summary', `relative motion of ${data.pairs.length} pairs`));
    const [pairs, rows] = newTable(['', 'center mm', 'ω rad/s']);
    const unknown = ['', 'not known'];
    for (const { j, i, icr, rate } of data.pairs) {
      const row = rows.insertRow();
      row.dataset.name = `${j.name}/${i.name}`;
      row.append(tag('th', `${j.name} wrt ${i.name}`, { scope: 'row' }));
      const noCenter = (k) => (isFinite(rate.value[k]) ? ['', 'no relative rotation'] : unknown);
      addCell(row, (k) => pointTexts(icr, k) ?? noCenter(k));
      addCell(row, (k) => numberTexts(rate, k) ?? unknown);
    }
    details.append(pairs);
    return details;
  }

  return {
    drawCursor() {
      for (const one of cells) {
        const [value, note] = one.textsAt(page.k);
        const text = `${value} ${note}`;
        if (one.text === text) continue;
        one.text = text;
        one.cell.className = value ? '' : 'withheld';
        one.value.data = value && `${value} `;
        one.note.data = note;
      }
      showHint();
    },
  };
}

function quantityTexts(body, name, k) {
  const quantity = body[name];
  if (!quantity) return ['', 'not in the bag'];
  const texts = quantity.value ? numberTexts(quantity, k) : pointTexts(quantity, k);
  return texts ?? ['', reasonAt(body, name, k)];
}

function numberTexts({ value, sigma }, k) {
  return isFinite(value[k]) ? valueText(value[k], sigma ? sigma[k] : NaN) : null;
}

// Coordinates in mm, and two standard deviations along the longer axis of the ellipse.
function pointTexts({ x, y, a }, k) {
  if (!isFinite(x[k])) return null;
  const scale = a[k] > 0 ? 2e3 * a[k] : Math.hypot(x[k], y[k]);
  const note = a[k] > 0 ? `± ${roundedTo(scale, scale)}` : '';
  return [`${roundedTo(1e3 * x[k], scale)}, ${roundedTo(1e3 * y[k], scale)}`, note];
}

function drawWithheld(element, data) {
  const names = WITHHELD.filter((name) => data.bodies.some((body) => body[name]));
  const titles = ['rates', ...names.map((name) => QUANTITIES[name][2])];
  const [table, content] = newTable(
    ['share of the instants', ...titles.map((title) => tag('th', title, { scope: 'col' }))]);
  for (const body of data.bodies) {
    const cells = ['angular_velocity', ...names].map((name) => shareCell(data, body, name));
    content.insertRow().append(tag('th', body.name, { scope: 'row' }), ...cells);
  }
  const scroll = tag('div', undefined, { class: 'scroll' });
  scroll.append(table);
  const title = tag('h2', 'What is determined, and why the rest is withheld');
  element.append(title, scroll, tag('p', 'A quantity that is not larger than its noise is '
    + 'withheld. A longer lag or window, more markers or a faster motion determine more.'));
}

// The share of the instants that are not lost at which a quantity is determined, and the reasons for the others.
function shareCell(data, body, name) {
  const quantity = body[name];
  if (!quantity) return tag('td', 'not in the bag');
  const determined = (quantity.value ?? quantity.x).filter(isFinite).length;
  const frames = data.n - body.lost.reduce((sum, [start, end]) => sum + end - start, 0);
  const cell = tag('td', percent(determined, frames));
  const counts = {};
  for (const [start, end, reason] of withheldIntervals(body, name)) {
    counts[reason] = (counts[reason] ?? 0) + Math.min(end, data.n) - start;
  }
  for (const [reason, count] of Object.entries(counts).sort((a, b) => b[1] - a[1])) {
    cell.append(tag('small', `${percent(count, frames)} ${reason}`));
  }
  return cell;
}

// 100% and 0% are exact.
function percent(count, total) {
  const share = (100 * count) / Math.max(1, total);
  if (share > 0 && share < 0.1) return '< 0.1%';
  if (share < 100 && share > 99.9) return '> 99.9%';
  return `${share === 0 || share === 100 ? share : share.toFixed(1)}%`;
}

function drawTheory(element, data) {
  if (!data.deviations.length) return;
  const [table, content] = newTable(['joint', 'off, rms', 'in deviations']);
  for (const [subject, ...cells] of data.deviations) {
    const row = content.insertRow();
    row.append(tag('th', subject, { scope: 'row' }), ...cells.map((text) => tag('td', text)));
  }
  element.append(tag('h2', `Against the scene ${data.scene}`), table, tag('p', 'How far the '
    + 'measured bodies are off its joints. Expected are 1.4 standard deviations for a pin.'));
}

function drawNotes(element, data) {
  element.replaceChildren();
  if (!data.notes.length) return;
  const list = tag('ul');
  list.append(...data.notes.map((note) => tag('li', note)));
  element.append(tag('h2', 'Warnings'), list);
}
