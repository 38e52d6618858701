// ---- The page's own solver: the loops of a scene, closed for points that the reader moved ----

const ORDERS = 5; // position to snap
const BINOMIAL = [[1], [1, 1], [1, 2, 1], [1, 3, 3, 1], [1, 4, 6, 4, 1]];
// Of residuals, in sizes of the linkage, and next to a change point, where no step is to be trusted;
// and the rank there.
const [CLOSED, NEARLY, SINGULAR] = [1e-10, 1e-6, 1e-6];

// Variables u (n) of `scene`, with four derivatives: those of bodies' angles come first. Each joint
// says that a chain of terms z l e^{iα} closes; z is of a point or constant, the length l is 1 or a
// variable, and so is the angle α; all else is linear, rows @ u = inputs.
function makeSolver(scene, times) {
  const { points, joints, rows, inputs, size: n } = scene;
  const [chains, loops, terms] = chainsOf(joints, n);
  const [m, count] = [rows.length + 2 * loops.length, times.length];
  // By order and variable; the last direction is that of the ground.
  const u = zeros(ORDERS, n);
  const [re, im] = [zeros(ORDERS, n + 1), zeros(ORDERS, n + 1)];
  re[0][n] = 1;
  const [matrix, right, step] = [zeros(m, n), new Float64Array(m), new Float64Array(n)];
  matrix.diagonal = new Float64Array(n);
  const sum = new Float64Array(2);
  // What the next instant is guessed from, and the guess.
  const [known, guess] = [zeros(ORDERS, n), new Float64Array(n)];
  const values = zeros(count, n).map((row) => row.fill(NaN));
  values[scene.at].set(scene.values);
  const extent = Math.max(...points.map(([, , x, y]) => Math.hypot(x, y))) || 1;

  const largest = (list) => list.reduce((most, one) => Math.max(most, Math.abs(one)), 0);

  // The k-th derivatives of e^{iα}, without those of α itself for order k if `open`.
  function turn(k, open = false) {
    for (let v = 0; v < n; v++) {
      let c = k ? 0 : Math.cos(u[0][v]);
      let s = k ? 0 : Math.sin(u[0][v]);
      for (let j = 0; j < (open ? k - 1 : k); j++) {
        const weight = BINOMIAL[k - 1][j] * u[j + 1][v];
        c -= weight * im[k - 1 - j][v];
        s += weight * re[k - 1 - j][v];
      }
      re[k][v] = c;
      im[k][v] = s;
    }
  }

  // The k-th derivative of a sum of terms, x and y in `sum`.
  function total(chain, k) {
    sum[0] = sum[1] = 0;
    for (const { term, sign } of chain) {
      let c = term.slide < 0 ? re[k][term.turn] : 0;
      let s = term.slide < 0 ? im[k][term.turn] : 0;
      if (term.slide >= 0) {
        for (let j = 0; j <= k; j++) {
          const weight = BINOMIAL[k][j] * u[j][term.slide];
          c += weight * re[k - j][term.turn];
          s += weight * im[k - j][term.turn];
        }
      }
      sum[0] += sign * (term.x * c - term.y * s);
      sum[1] += sign * (term.x * s + term.y * c);
    }
    return sum;
  }

  // How far all equations are from being met, of order k; returns the largest.
  function residual(k, given) {
    rows.forEach((row, r) => {
      right[r] = -given(r, k);
      for (let v = 0; v < n; v++) right[r] += row[v] * u[k][v];
    });
    loops.forEach((loop, l) => {
      total(loop, k);
      right[rows.length + 2 * l] = sum[0];
      right[rows.length + 2 * l + 1] = sum[1];
    });
    return largest(right);
  }

  // The equations' derivatives by the variables, factored.
  function factor() {
    rows.forEach((row, r) => matrix[r].set(row));
    loops.forEach((loop, l) => {
      const across = matrix[rows.length + 2 * l].fill(0);
      const up = matrix[rows.length + 2 * l + 1].fill(0);
      for (const { term, sign } of loop) {
        const c = re[0][term.turn];
        const s = im[0][term.turn];
        const x = sign * (term.x * c - term.y * s);
        const y = sign * (term.x * s + term.y * c);
        const length = term.slide < 0 ? 1 : u[0][term.slide];
        if (term.turn < n) {
          across[term.turn] -= length * y;
          up[term.turn] += length * x;
        }
        if (term.slide >= 0) {
          across[term.slide] += x;
          up[term.slide] += y;
        }
      }
    });
    return triangle(matrix, m, n);
  }

  function solveFor(k) {
    leastSquares(matrix, right, step, m, n);
    for (let v = 0; v < n; v++) u[k][v] -= step[v];
  }

  // Closes the loops from u[0] on and finds the derivatives; false where they do not close.
  function settle(given) {
    for (let k = 1; k < ORDERS; k++) u[k].fill(0);
    let rank = 0;
    for (let steps = 0, most = 1; steps < 30 && most > 1e-6; steps++) {
      turn(0);
      residual(0, given);
      rank = factor();
      if (rank < SINGULAR) break;
      leastSquares(matrix, right, step, m, n);
      most = largest(step);
      if (!isFinite(most)) return false;
      const part = Math.min(1, 0.5 / most);
      for (let v = 0; v < n; v++) u[0][v] -= part * step[v];
    }
    turn(0);
    residual(0, given);
    rank = factor();
    if (rank > SINGULAR) solveFor(0);
    turn(0);
    const most = (rank > SINGULAR ? CLOSED : NEARLY) * Math.max(1, extent);
    if (!(residual(0, given) < most)) return false;
    for (let k = 1; k < ORDERS; k++) {
      turn(k, true);
      residual(k, given);
      if (rank > SINGULAR) solveFor(k);
      else u[k].fill(NaN);
      turn(k);
    }
    return true;
  }

  // Closes it at instant k from a guess, or says that it does not.
  function at(k, near) {
    u[0].set(near);
    const closed = settle((r, order) => inputs[r][order]?.[k] ?? 0);
    return closed && u[0].every((one, v) => Math.abs(one - near[v]) < 0.7);
  }

  // A derivative of the variables, h after those known.
  function ahead(order, v, h) {
    let value = known[ORDERS - 1][v];
    for (let k = ORDERS - 2; k >= order; k--) value = known[k][v] + (h / (k - order + 1)) * value;
    return value;
  }

  // All instants from k on to both sides, each from the one before; `take(k)` is called where they
  // close, or `lose(k)`. False where it does not even close at k. Of `every` instants but one is only
  // as the derivatives of the one before have it.
  function solveAll(k, take, lose, every = 1) {
    for (const term of terms) [term.x, term.y] = term.point < 0 ? term.fixed : points[term.point].slice(2, 4);
    const start = values[k].slice();
    if (!at(k, start)) return false;
    for (const way of [1, -1]) {
      at(k, start);
      let from = k;
      known.forEach((row, order) => row.set(u[order]));
      for (let there = way > 0 ? k : k - 1; there >= 0 && there < count; there += way) {
        const h = times[there] - times[from];
        for (let v = 0; v < n; v++) guess[v] = ahead(0, v, h);
        if ((there - k) % every) {
          for (let order = 0; order < ORDERS; order++) {
            for (let v = 0; v < n; v++) u[order][v] = ahead(order, v, h);
            turn(order);
          }
          values[there].set(guess);
          take(there);
          continue;
        }
        if (!at(there, guess)) {
          for (; there >= 0 && there < count; there += way) {
            values[there].fill(NaN);
            lose(there);
          }
          break;
        }
        values[there].set(u[0]);
        take(there);
        if (!isFinite(u[1][0])) continue;
        from = there;
        for (let order = 0; order < ORDERS; order++) known[order].set(u[order]);
      }
    }
    return true;
  }

  // The variables at time 0, from the instant whose inputs are nearest; null where it does not close.
  function atZero() {
    const { zero } = scene;
    const off = (k) => zero.reduce((sum, row, r) => sum + Math.abs(inputs[r][0][k] - row[0]), 0);
    const near = values.map((row, k) => (isFinite(row[0]) ? off(k) : Infinity));
    u[0].set(values[near.indexOf(Math.min(...near))]);
    return settle((r, order) => zero[r][order]) ? u[0].slice() : null;
  }

  // Where a body's origin is, with its derivatives: x and y by order.
  const origin = zeros(2, ORDERS);
  function place(body) {
    const chain = chains.get(body);
    for (let k = 0; k < ORDERS; k++) {
      total(chain, k);
      origin[0][k] = sum[0];
      origin[1][k] = sum[1];
    }
    return origin;
  }

  return { solveAll, atZero, values, u, re, im, place };
}

const zeros = (rows, columns) => Array.from({ length: rows }, () => new Float64Array(columns));

// From the ground each body through one joint, as a chain of [term, sign]; and the loops that the
// other joints close. Struts and belts place only what nothing else does.
function chainsOf(joints, ground) {
  const sides = joints.map(({ one, a, other, b, terms }) => [
    [{ point: a, slide: -1, turn: one }, ...terms.map((term) => ({ ...term }))],
    [{ point: b, slide: -1, turn: other }],
  ]);
  const chains = new Map([[ground, []]]);
  const left = new Set(joints.keys());
  const grow = (last) => [...left].some((k) => {
    const { one, other, loose } = joints[k];
    if (chains.has(one) === chains.has(other) || (loose && !last)) return false;
    const [from, to, here, there] = chains.has(one) ? [one, other, ...sides[k]]
      : [other, one, ...[...sides[k]].reverse()];
    chains.set(to, sumOf(chains.get(from), here, there));
    return left.delete(k);
  });
  while (grow(false) || grow(true));
  // What a carrier keeps closed is no loop.
  const loops = [...left].filter((k) => !joints[k].held).map((k) => sumOf(
    sumOf(chains.get(joints[k].one), ...sides[k]), [], [], chains.get(joints[k].other)));
  return [chains, loops, sides.flat(2)];
}

// A chain with terms added and others, and another chain, taken away; what cancels is left out.
function sumOf(chain, plus, minus, away = []) {
  const total = new Map(chain.map(({ term, sign }) => [term, sign]));
  const add = (term, sign) => total.set(term, (total.get(term) ?? 0) + sign);
  for (const term of plus) add(term, 1);
  for (const term of minus) add(term, -1);
  for (const { term, sign } of away) add(term, -sign);
  return [...total].filter(([, sign]) => sign).map(([term, sign]) => ({ term, sign }));
}

// Householder's reflections in place, below and on the diagonal; `rows.diagonal` is that of R.
// Returns its least share of the largest.
function triangle(rows, m, n) {
  let [least, most] = [Infinity, 0];
  for (let k = 0; k < n; k++) {
    let square = 0;
    for (let r = k; r < m; r++) square += rows[r][k] ** 2;
    const size = rows[k][k] > 0 ? -Math.sqrt(square) : Math.sqrt(square);
    rows.diagonal[k] = size;
    least = Math.min(least, Math.abs(size));
    most = Math.max(most, Math.abs(size));
    if (!size) continue;
    for (let r = k; r < m; r++) rows[r][k] /= -size;
    rows[k][k] += 1;
    for (let c = k + 1; c < n; c++) {
      let dot = 0;
      for (let r = k; r < m; r++) dot += rows[r][k] * rows[r][c];
      dot /= rows[k][k];
      for (let r = k; r < m; r++) rows[r][c] -= dot * rows[r][k];
    }
  }
  return least / most;
}

// Fills in `found` with the least squares of R found = right, whose reflections are in `rows`.
function leastSquares(rows, right, found, m, n) {
  for (let k = 0; k < n; k++) {
    if (!rows.diagonal[k]) continue;
    let dot = 0;
    for (let r = k; r < m; r++) dot += rows[r][k] * right[r];
    dot /= rows[k][k];
    for (let r = k; r < m; r++) right[r] -= dot * rows[r][k];
  }
  for (let k = n - 1; k >= 0; k--) {
    let rest = right[k];
    for (let c = k + 1; c < n; c++) rest -= rows[k][c] * found[c];
    found[k] = rows.diagonal[k] ? rest / rows.diagonal[k] : 0;
  }
}
