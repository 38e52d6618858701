// ---- The solver of the editor: closes the loops of a scene with moved points, at all instants ----

const ORDERS = 5; // position to snap
const BINOMIAL = [[1], [1, 1], [1, 2, 1], [1, 3, 3, 1], [1, 4, 6, 4, 1]];
// Largest residual of closed loops, in sizes of the linkage; a matrix with singular values below
// this ratio is that of a change point, where loops count as closed up to the third value.
const [CLOSED, SINGULAR, NEARLY_CLOSED] = [1e-10, 1e-6, 1e-6];
const [MOST_STEPS, LARGEST_STEP, SMALLEST_STEP] = [30, 0.5, 1e-6];
// A solution that differs more from its guess is another branch, rad or m.
const BRANCH_DISTANCE = 0.7;

// Solves for the variables u (n) of `scene` and their derivatives. The first variables are the
// angles of the bodies. A joint says that a chain of terms z l e^{iα} closes: z is that of a point or
// constant, the length l is 1 or a variable, the angle α is a variable. All other equations are
// linear: rows @ u = inputs.
function makeSolver(scene, times) {
  const { points, joints, rows, inputs, size: n } = scene;
  const [chains, loops, terms] = makeChains(joints, n);
  const [m, count] = [rows.length + 2 * loops.length, times.length];
  // By order and variable: values, and the derivatives of cos and sin; the last one is the ground.
  const u = zeros(ORDERS, n);
  const [cos, sin] = [zeros(ORDERS, n + 1), zeros(ORDERS, n + 1)];
  cos[0][n] = 1;
  const [matrix, right, step] = [zeros(m, n), new Float64Array(m), new Float64Array(n)];
  matrix.diagonal = new Float64Array(n);
  const sum = new Float64Array(2);
  // The solution at the last instant, from which the next one is guessed.
  const [base, guess] = [zeros(ORDERS, n), new Float64Array(n)];
  const values = zeros(count, n).map((row) => row.fill(NaN));
  values[scene.at].set(scene.values);
  const extent = Math.max(...points.map(([, , x, y]) => Math.hypot(x, y))) || 1;

  const largest = (list) => list.reduce((most, value) => Math.max(most, Math.abs(value)), 0);

  // Sets the k-th derivatives of e^{iα}; with `partial`, without the term of the k-th one of α.
  function setRotations(k, partial = false) {
    for (let v = 0; v < n; v++) {
      let c = k ? 0 : Math.cos(u[0][v]);
      let s = k ? 0 : Math.sin(u[0][v]);
      for (let j = 0; j < (partial ? k - 1 : k); j++) {
        const weight = BINOMIAL[k - 1][j] * u[j + 1][v];
        c -= weight * sin[k - 1 - j][v];
        s += weight * cos[k - 1 - j][v];
      }
      cos[k][v] = c;
      sin[k][v] = s;
    }
  }

  // Returns the k-th derivative of a chain, in `sum`.
  function chainSum(chain, k) {
    sum[0] = sum[1] = 0;
    for (const { term, sign } of chain) {
      let c = term.slide < 0 ? cos[k][term.turn] : 0;
      let s = term.slide < 0 ? sin[k][term.turn] : 0;
      if (term.slide >= 0) {
        for (let j = 0; j <= k; j++) {
          const weight = BINOMIAL[k][j] * u[j][term.slide];
          c += weight * cos[k - j][term.turn];
          s += weight * sin[k - j][term.turn];
        }
      }
      sum[0] += sign * (term.x * c - term.y * s);
      sum[1] += sign * (term.x * s + term.y * c);
    }
    return sum;
  }

  // Sets the residuals of order k, and returns the largest.
  function setResiduals(k, inputAt) {
    rows.forEach((row, r) => {
      right[r] = -inputAt(r, k);
      for (let v = 0; v < n; v++) right[r] += row[v] * u[k][v];
    });
    loops.forEach((loop, l) => right.set(chainSum(loop, k), rows.length + 2 * l));
    return largest(right);
  }

  // Factors the derivatives of the residuals by the variables; returns the ratio of the smallest to
  // the largest diagonal element.
  function factor() {
    rows.forEach((row, r) => matrix[r].set(row));
    loops.forEach((loop, l) => {
      const rowX = matrix[rows.length + 2 * l].fill(0);
      const rowY = matrix[rows.length + 2 * l + 1].fill(0);
      for (const { term, sign } of loop) {
        const [c, s] = [cos[0][term.turn], sin[0][term.turn]];
        const x = sign * (term.x * c - term.y * s);
        const y = sign * (term.x * s + term.y * c);
        const length = term.slide < 0 ? 1 : u[0][term.slide];
        if (term.turn < n) {
          rowX[term.turn] -= length * y;
          rowY[term.turn] += length * x;
        }
        if (term.slide >= 0) {
          rowX[term.slide] += x;
          rowY[term.slide] += y;
        }
      }
    });
    return factorQR(matrix, m, n);
  }

  // Newton's step for the derivatives of order k; returns its largest element.
  function takeStep(k, limit = Infinity) {
    solveLeastSquares(matrix, right, step, m, n);
    const size = largest(step);
    const part = Math.min(1, limit / size || 1);
    for (let v = 0; v < n; v++) u[k][v] -= part * step[v];
    return size;
  }

  // Prepares a step for the positions; returns the ratio of `factor`.
  function linearize(inputAt) {
    setRotations(0);
    setResiduals(0, inputAt);
    return factor();
  }

  // Closes the loops from u[0] on and finds the derivatives; returns false if they do not close.
  function closeLoops(inputAt) {
    for (let k = 1; k < ORDERS; k++) u[k].fill(0);
    for (let steps = 0; steps < MOST_STEPS; steps++) {
      if (linearize(inputAt) < SINGULAR) break;
      const size = takeStep(0, LARGEST_STEP);
      if (!isFinite(size)) return false;
      if (size <= SMALLEST_STEP) break;
    }
    const isRegular = linearize(inputAt) > SINGULAR;
    if (isRegular) takeStep(0);
    setRotations(0);
    const allowed = (isRegular ? CLOSED : NEARLY_CLOSED) * Math.max(1, extent);
    if (!(setResiduals(0, inputAt) < allowed)) return false;
    for (let k = 1; k < ORDERS; k++) {
      setRotations(k, true);
      setResiduals(k, inputAt);
      if (isRegular) takeStep(k);
      else u[k].fill(NaN);
      setRotations(k);
    }
    return true;
  }

  // Closes the loops at instant k near a guess.
  function solveAt(k, near) {
    u[0].set(near);
    const closes = closeLoops((r, order) => inputs[r][order]?.[k] ?? 0);
    return closes && u[0].every((value, v) => Math.abs(value - near[v]) < BRANCH_DISTANCE);
  }

  // The Taylor series of a derivative of variable v, a time h after `base`.
  function extrapolate(order, v, h) {
    let value = base[ORDERS - 1][v];
    for (let k = ORDERS - 2; k >= order; k--) value = base[k][v] + (h / (k - order + 1)) * value;
    return value;
  }

  // Solves the instants on both sides of k, each from the one before, and calls `take(k)`; after the
  // first that does not close, calls `drop(k)`. Returns false if the loops do not close at k. With
  // `every`, only one of so many instants is solved, and the others are extrapolated.
  function solveAll(k, take, drop, every = 1) {
    for (const term of terms) {
      [term.x, term.y] = term.point < 0 ? term.fixed : points[term.point].slice(2, 4);
    }
    const start = values[k].slice();
    if (!solveAt(k, start)) return false;
    for (const direction of [1, -1]) {
      solveAt(k, start);
      let from = k;
      base.forEach((row, order) => row.set(u[order]));
      let at = direction > 0 ? k : k - 1;
      for (; at >= 0 && at < count; at += direction) {
        const h = times[at] - times[from];
        for (let v = 0; v < n; v++) guess[v] = extrapolate(0, v, h);
        if ((at - k) % every) {
          for (let order = 0; order < ORDERS; order++) {
            for (let v = 0; v < n; v++) u[order][v] = extrapolate(order, v, h);
            setRotations(order);
          }
        } else if (!solveAt(at, guess)) break;
        else if (isFinite(u[1][0])) {
          from = at;
          base.forEach((row, order) => row.set(u[order]));
        }
        values[at].set(u[0]);
        take(at);
      }
      for (; at >= 0 && at < count; at += direction) {
        values[at].fill(NaN);
        drop(at);
      }
    }
    return true;
  }

  // The variables at time 0, from the instant with the nearest inputs; null if they do not close.
  function atTimeZero() {
    const { zero } = scene;
    const distance = (k) => zero.reduce((sum, row, r) => sum + Math.abs(inputs[r][0][k] - row[0]), 0);
    const distances = values.map((row, k) => (isFinite(row[0]) ? distance(k) : Infinity));
    u[0].set(values[distances.indexOf(Math.min(...distances))]);
    return closeLoops((r, order) => zero[r][order]) ? u[0].slice() : null;
  }

  // The derivatives of the origin of a body, x and y by order.
  const origin = zeros(2, ORDERS);
  function originOf(body) {
    for (let k = 0; k < ORDERS; k++) [origin[0][k], origin[1][k]] = chainSum(chains.get(body), k);
    return origin;
  }

  return { solveAll, atTimeZero, values, u, cos, sin, originOf };
}

const zeros = (rows, columns) => Array.from({ length: rows }, () => new Float64Array(columns));

// Returns the chain from the ground to each body, the loops that the other joints close, and all
// terms. Struts and belts are in a chain only if no other joint places the body.
function makeChains(joints, ground) {
  const sides = joints.map(({ one, a, other, b, terms }) => [
    [{ point: a, slide: -1, turn: one }, ...terms.map((term) => ({ ...term }))],
    [{ point: b, slide: -1, turn: other }],
  ]);
  const chains = new Map([[ground, []]]);
  const unused = new Set(joints.keys());
  const addBody = (withLoose) => [...unused].some((k) => {
    const { one, other, loose } = joints[k];
    if (chains.has(one) === chains.has(other) || (loose && !withLoose)) return false;
    const [from, to] = chains.has(one) ? [one, other] : [other, one];
    const [plus, minus] = from === one ? sides[k] : [...sides[k]].reverse();
    chains.set(to, combine(chains.get(from), plus, minus));
    return unused.delete(k);
  });
  while (addBody(false) || addBody(true));
  // A belt on a carrier closes no loop.
  const loops = [...unused].filter((k) => !joints[k].held).map((k) => combine(
    combine(chains.get(joints[k].one), ...sides[k]), [], [], chains.get(joints[k].other)));
  return [chains, loops, sides.flat(2)];
}

// Adds terms to a chain and subtracts others, and another chain; terms that cancel are left out.
function combine(chain, plus, minus, subtracted = []) {
  const total = new Map(chain.map(({ term, sign }) => [term, sign]));
  const add = (term, sign) => total.set(term, (total.get(term) ?? 0) + sign);
  for (const term of plus) add(term, 1);
  for (const term of minus) add(term, -1);
  for (const { term, sign } of subtracted) add(term, -sign);
  return [...total].filter(([, sign]) => sign).map(([term, sign]) => ({ term, sign }));
}

// Factors a matrix by Householder reflections, in place; `rows.diagonal` is the diagonal of R.
// Returns the ratio of its smallest to its largest element.
function factorQR(rows, m, n) {
  for (let k = 0; k < n; k++) {
    let square = 0;
    for (let r = k; r < m; r++) square += rows[r][k] ** 2;
    const size = rows[k][k] > 0 ? -Math.sqrt(square) : Math.sqrt(square);
    rows.diagonal[k] = size;
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
  const sizes = rows.diagonal.map(Math.abs);
  return Math.min(...sizes) / Math.max(...sizes);
}

// Sets `solution` to the least squares solution for a factored matrix.
function solveLeastSquares(rows, right, solution, m, n) {
  for (let k = 0; k < n; k++) {
    if (!rows.diagonal[k]) continue;
    let dot = 0;
    for (let r = k; r < m; r++) dot += rows[r][k] * right[r];
    dot /= rows[k][k];
    for (let r = k; r < m; r++) right[r] -= dot * rows[r][k];
  }
  for (let k = n - 1; k >= 0; k--) {
    let value = right[k];
    for (let c = k + 1; c < n; c++) value -= rows[k][c] * solution[c];
    solution[k] = rows.diagonal[k] ? value / rows.diagonal[k] : 0;
  }
}
