// ---- The data: what came in the page, as typed arrays, and how to look things up in it ----

const RATES = ['angular_velocity', 'angular_acceleration', 'angular_jerk', 'angular_snap'];
const POLES = ['icr', 'iap', 'ijp', 'isp'];
const WORDS = {
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
};
// Okabe and Ito's colors, told apart by the color-blind; the darker ones first.
const COLORS = ['#0072b2', '#d55e00', '#007a5a', '#a8558a', '#8a6d00', '#56a0d0', '#444444', '#c2273d'];
const MOST_PAIRS = 6;
// Swings of a figure that are told apart in the width of a chart.
const READABLE_SWINGS = 12;

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return JSON.parse(await new Response(stream).text());
}

const numbers = (list) => Float64Array.from(list, (value) => (value === null ? NaN : value));

function typed(part) {
  return Object.fromEntries(Object.entries(part).map(([name, list]) => [name, numbers(list)]));
}

// One object for all that is known: times, bodies, pairs, joints. Columns are Float64Arrays.
function prepare(raw) {
  const data = { ...raw, t: numbers(raw.t), n: raw.t.length };
  data.bodies = raw.bodies.map((body, b) => {
    const found = { ...body, color: COLORS[b % COLORS.length] };
    for (const name of ['x', 'y', 'angle', 'vx', 'vy']) found[name] = numbers(body[name]);
    for (const name of [...RATES, ...POLES, 'icr_velocity', 'centrode_curvature']) {
      if (body[name]) found[name] = typed(body[name]);
    }
    if (found.icr_velocity) {
      const { x, y } = found.icr_velocity;
      found.icr_velocity.value = x.map((u, k) => Math.hypot(u, y[k]));
    }
    found.theory = typed(body.theory);
    return found;
  });
  const byName = Object.fromEntries(data.bodies.map((body) => [body.name, body]));
  data.byName = byName;
  data.pairs = raw.pairs.map((pair) => {
    const [j, i] = pair.bodies.map((name) => byName[name]);
    return { j, i, icr: typed(pair.icr), rate: relativeRate(j, i) };
  });
  // Of many pairs those that are joined, else the first.
  const joined = ({ j, i }) => raw.joints.some(({ bodies }) =>
    bodies.includes(j.name) && bodies.includes(i.name));
  const some = data.pairs.length > MOST_PAIRS ? data.pairs.filter(joined) : data.pairs;
  data.somePairs = some.length ? some : data.pairs.slice(0, MOST_PAIRS);
  // Colors that no body has, as long as there are any.
  data.pairs.forEach((pair, k) => {
    pair.color = COLORS[(data.bodies.length + k) % COLORS.length];
  });
  data.period = periodOf(data.t);
  [data.begin, data.end] = data.n ? [data.t[0], data.t[data.n - 1]] : [0, 0];
  return data;
}

// The median time between instants.
function periodOf(t) {
  const steps = Array.from(t.subarray(1), (later, k) => later - t[k]).sort((a, b) => a - b);
  return steps.length ? steps[steps.length >> 1] : 1;
}

function relativeRate(j, i) {
  const [one, other] = [j.angular_velocity, i.angular_velocity];
  return {
    value: one.value.map((w, k) => w - other.value[k]),
    sigma: one.sigma.map((s, k) => Math.hypot(s, other.sigma[k])),
  };
}

// The instant nearest to a time.
function instantAt(data, time) {
  let [low, high] = [0, data.n - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (data.t[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low > 0 && time - data.t[low - 1] < data.t[low] - time ? low - 1 : low;
}

// All columns of instants.
function* columnsIn(data) {
  yield data.t;
  const parts = [...data.bodies, ...data.pairs.flatMap(({ icr, rate }) => [icr, rate])];
  for (const part of parts) {
    for (const column of Object.values(part)) {
      if (column instanceof Float64Array) yield column;
      else if (column?.constructor === Object) yield* Object.values(column).filter((c) => c instanceof Float64Array);
    }
  }
}

// Why a figure of a body is not there at instant k; what is of the ICR needs the ICR.
function reasonAt(body, name, k) {
  const of = (one) => [...body.missing, ...(body.withheld[one] ?? [])];
  const spell = (one) => of(one).find(([from, to]) => from <= k && k < to)?.[2];
  return spell(name) ?? spell('icr') ?? 'not determined';
}

function outlineAt(body, k) {
  let found = body.outlines.length ? body.outlines[0] : null;
  for (const outline of body.outlines) if (outline[0] <= k) found = outline;
  return found;
}

// ---- Words for figures ----

const minus = (text) => text.replace('-', '−');

// To the decimal, or to the tens and so on, that is the second digit of `scale`.
function roundedTo(value, scale) {
  const places = 1 - Math.floor(Math.log10(scale || 1));
  const power = 10 ** -places;
  return minus(places > 0 ? value.toFixed(Math.min(12, places)) : String(Math.round(value / power) * power));
}

// A figure and two deviations of it, both to the second digit of these.
function worded(value, sigma) {
  if (!(sigma > 0)) return [roundedTo(value, Math.abs(value) * 1e-2 || 1), ''];
  return [roundedTo(value, 2 * sigma), `± ${roundedTo(2 * sigma, 2 * sigma)}`];
}

// The time of this many swings of the body that swings most often, or all of the time: more swings
// side by side are a solid band of ink.
function readableTime(data) {
  const time = data.end - data.begin;
  const most = Math.max(0, ...data.bodies.map(({ angular_velocity: rate }) => swingsIn(rate.value)));
  return most > READABLE_SWINGS ? (time * READABLE_SWINGS) / most : time;
}

// How often values go from their upper quarter to their lower one; noise about a mean does not count.
function swingsIn(values) {
  const sorted = values.filter(isFinite).sort();
  if (!sorted.length) return 0;
  const [low, high] = [0.25, 0.75].map((part) => quantile(sorted, part));
  let [swings, up] = [0, false];
  for (const value of values) {
    if (value >= high && high > low) up = true;
    else if (up && value <= low) [swings, up] = [swings + 1, false];
  }
  return swings;
}

function quantile(sorted, part) {
  return sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))];
}
