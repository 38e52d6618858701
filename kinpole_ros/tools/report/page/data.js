// ---- The data of the page as typed arrays, functions that read it, and numbers as text ----

const RATES = ['angular_velocity', 'angular_acceleration', 'angular_jerk', 'angular_snap'];
const POLES = ['icr', 'iap', 'ijp', 'isp'];
// Title, unit and symbol of each quantity of a body.
const QUANTITIES = {
  angular_velocity: ['angular velocity', 'rad/s', 'ω'],
  angular_acceleration: ['angular acceleration', 'rad/s²', 'α'],
  angular_jerk: ['angular jerk', 'rad/s³', 'jerk'],
  angular_snap: ['angular snap', 'rad/s⁴', 'snap'],
  icr: ['ICR, velocity pole', 'mm', 'ICR'],
  iap: ['IAP, acceleration pole', 'mm', 'IAP'],
  ijp: ['IJP, jerk pole', 'mm', 'IJP'],
  isp: ['ISP, snap pole', 'mm', 'ISP'],
  icr_velocity: ['speed of the ICR', 'm/s', '|u|'],
  centrode_curvature: ['curvature of the fixed centrode', '1/m', 'κ'],
  inflection_diameter: ['diameter of the inflection circle', 'm', 'circle'],
  ball_point: ["Ball's point", 'mm', 'Ball'],
};
// Quantities that may be undetermined while the pose is known.
const WITHHELD = [...POLES, 'centrode_curvature', 'inflection_diameter'];
// Of the inflection circle there is one reason.
const REASON_NAMES = { inflection_diameter: 'inflection_circle', ball_point: 'inflection_circle' };
// The colors of Okabe and Ito, which the color-blind can distinguish; darker ones first.
const COLORS = ['#0072b2', '#d55e00', '#007a5a', '#a8558a', '#8a6d00', '#56a0d0', '#444444', '#c2273d'];
const MOST_PAIRS = 6;
// Swings of a quantity that are legible in the width of a chart.
const READABLE_SWINGS = 12;

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return JSON.parse(await new Response(stream).text());
}

const numbers = (list) => Float64Array.from(list, (value) => (value === null ? NaN : value));

function typed(columns) {
  return Object.fromEntries(Object.entries(columns).map(([name, list]) => [name, numbers(list)]));
}

// The data as one object: times, bodies, pairs and joints, with columns as Float64Arrays.
function prepare(raw) {
  const data = { ...raw, t: numbers(raw.t), n: raw.t.length };
  data.bodies = raw.bodies.map((rawBody, b) => {
    const color = COLORS[b % COLORS.length];
    const body = { ...rawBody, color, theory: typed(rawBody.theory), lost: raw.lost ?? [] };
    for (const name of ['x', 'y', 'angle', 'vx', 'vy']) body[name] = numbers(rawBody[name]);
    for (const name in QUANTITIES) if (rawBody[name]) body[name] = typed(rawBody[name]);
    if (body.icr_velocity) {
      const { x, y } = body.icr_velocity;
      body.icr_velocity.value = x.map((u, k) => Math.hypot(u, y[k]));
    }
    return body;
  });
  data.byName = Object.fromEntries(data.bodies.map((body) => [body.name, body]));
  data.pairs = raw.pairs.map((pair, k) => {
    const [j, i] = pair.bodies.map((name) => data.byName[name]);
    // Colors that no body has, as long as there are any.
    const color = COLORS[(data.bodies.length + k) % COLORS.length];
    return { j, i, icr: typed(pair.icr), rate: relativeRate(j, i), color };
  });
  // Of many pairs, show those with a joint, or else the first ones.
  const hasJoint = ({ j, i }) => raw.joints.some(({ bodies }) =>
    bodies.includes(j.name) && bodies.includes(i.name));
  const chosen = data.pairs.length > MOST_PAIRS ? data.pairs.filter(hasJoint) : data.pairs;
  data.shownPairs = chosen.length ? chosen : data.pairs.slice(0, MOST_PAIRS);
  data.period = medianInterval(data.t);
  [data.begin, data.end] = data.n ? [data.t[0], data.t[data.n - 1]] : [0, 0];
  return data;
}

function medianInterval(t) {
  const steps = Array.from(t.subarray(1), (later, k) => later - t[k]).sort((a, b) => a - b);
  return steps.length ? steps[steps.length >> 1] : 1;
}

function relativeRate({ angular_velocity: one }, { angular_velocity: other }) {
  return {
    value: one.value.map((w, k) => w - other.value[k]),
    sigma: one.sigma.map((s, k) => Math.hypot(s, other.sigma[k])),
  };
}

// The index of the instant nearest to a time.
function instantAt(data, time) {
  let [low, high] = [0, data.n - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (data.t[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low > 0 && time - data.t[low - 1] < data.t[low] - time ? low - 1 : low;
}

// All columns with one value per instant.
function* columnsIn(data) {
  yield data.t;
  for (const owner of [...data.bodies, ...data.pairs.flatMap(({ icr, rate }) => [icr, rate])]) {
    for (const value of Object.values(owner)) {
      const columns = value?.constructor === Object ? Object.values(value) : [value];
      yield* columns.filter((column) => column instanceof Float64Array);
    }
  }
}

// Whether lines stop before instant k. In a report, instants without values are where frames are lost.
const isGap = (data, k) => data.live && data.t[k] - data.t[k - 1] > 2.5 * data.period;

// [start, end, reason] of the instants at which a quantity of a body is withheld.
const withheldIntervals = (body, name) =>
  [...body.missing, ...(body.withheld[REASON_NAMES[name] ?? name] ?? [])];

// Why a quantity is not determined at instant k; without an ICR its velocity is not either.
function reasonAt(body, name, k) {
  const reason = (one) =>
    [...body.lost, ...withheldIntervals(body, one)].find(([start, end]) => start <= k && k < end)?.[2];
  return reason(name) ?? reason('icr') ?? 'not determined';
}

// The last outline that starts before instant k, or the first one.
function outlineAt(body, k) {
  return body.outlines.filter(([start]) => start <= k).pop() ?? body.outlines[0] ?? null;
}

// A point [u, v] of a body at instant k: from the body's origin, in the axes of the plane.
function arm(body, k, [u, v]) {
  const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
  return [c * u - s * v, s * u + c * v];
}

// A point [x, y] of the plane in the frame of a body at instant k.
function inBody(body, k, [x, y]) {
  const [u, v] = [x - body.x[k], y - body.y[k]];
  const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
  return [c * u + s * v, c * v - s * u];
}

// The position and the velocity of a point of a body at instant k.
function pointAt(body, k, point) {
  const [x, y] = arm(body, k, point);
  return [body.x[k] + x, body.y[k] + y];
}

function velocityAt(body, k, point) {
  const [[x, y], w] = [arm(body, k, point), body.angular_velocity.value[k]];
  return [body.vx[k] - w * y, body.vy[k] + w * x];
}

// The time in which the body that swings most often makes a readable number of swings, at most all.
function readableTime(data) {
  const time = data.end - data.begin;
  const most = Math.max(0, ...data.bodies.map(({ angular_velocity: rate }) => swingsIn(rate.value)));
  return most > READABLE_SWINGS ? (time * READABLE_SWINGS) / most : time;
}

// How often values go from their upper quarter to their lower one, which ignores noise.
function swingsIn(values) {
  const sorted = values.filter(isFinite).sort();
  if (!sorted.length) return 0;
  const [low, high] = [0.25, 0.75].map((share) => quantile(sorted, share));
  let [swings, isUp] = [0, false];
  for (const value of values) {
    if (value >= high && high > low) isUp = true;
    else if (isUp && value <= low) [swings, isUp] = [swings + 1, false];
  }
  return swings;
}

function quantile(sorted, share) {
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

// ---- Numbers as text ----

const withMinus = (text) => text.replace('-', '−');

// A value rounded to the second digit of `scale`.
function roundedTo(value, scale) {
  const decimals = 1 - Math.floor(Math.log10(scale || 1));
  if (decimals > 0) return withMinus(value.toFixed(Math.min(12, decimals)));
  const power = 10 ** -decimals;
  return withMinus(String(Math.round(value / power) * power));
}

// A value and two standard deviations, both to the second digit of these.
function valueText(value, sigma) {
  if (!(sigma > 0)) return [roundedTo(value, Math.abs(value) * 1e-2 || 1), ''];
  return [roundedTo(value, 2 * sigma), `± ${roundedTo(2 * sigma, 2 * sigma)}`];
}
