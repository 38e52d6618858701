// ---- The stage: the plane of the motion. One canvas is static, the other moves with the cursor ----

const LAYERS = {
  film: 'film', outlines: 'bodies', tracks: 'tracks', fixed: 'fixed centrode', moving: 'moving centrode',
  icr: 'ICR', iap: 'IAP', ijp: 'IJP', isp: 'ISP', relative: 'relative centers',
  circle: 'inflection circle', ball: "Ball's point", cubic: 'cubic of stationary curvature',
  path: 'path at the pointer', velocities: 'velocities', names: 'names',
};
const HIDDEN = ['ijp', 'isp', 'circle', 'ball', 'cubic'];
// Thickness of a bar, in sizes of the motion.
const THICKNESS = 0.022;

// The stage: `view` is its center and its pixels per meter; `points` are the points of each body with
// velocity arrows; `fastest` is the speed of the longest arrow.
function makeStage(element, page, data) {
  const [under, over] = element.querySelectorAll('canvas');
  const stage = {
    page, data, view: { x: 0, y: 0, scale: 100 }, sizes: null, points: [], fastest: 0, thickness: 1,
  };
  const { view } = stage;
  let [box, extent, paths] = [null, 1, new Map()];
  stage.isOn = (layer) => !page.off.has(layer);
  stage.shownBodies = () => data.bodies.filter((body) => !page.hidden.has(body.name));
  const drawInstant = makeInstantDrawer(stage);
  const film = data.film && makeFilm(element, stage);
  updateMotion();

  // Updates box, arrows and bars; the view changes where the motion leaves the box.
  function updateMotion() {
    const before = box && Object.values(box).join();
    box = motionBox(data, box);
    extent = Math.hypot(box.width, box.height) || 1;
    stage.thickness = THICKNESS * extent;
    updatePoints();
    stage.fastest = Math.max(stage.fastest, topSpeed(data, stage.points));
    if (stage.sizes && !view.isFixed && before !== Object.values(box).join()) fit();
  }

  function updatePoints() {
    stage.points = data.bodies.map((body) => drawnPoints(data, body));
  }

  // Forgets the motion before, and shows all that is known now.
  function showAll() {
    [box, stage.fastest] = [null, 0];
    updateMotion();
    fit();
  }

  function fit() {
    const sizes = stage.sizes = emptyCanvas(under, page.printing);
    view.isFixed = false;
    view.scale = 0.9 * Math.min(sizes.width / box.width, sizes.height / box.height);
    view.x = box.x + box.width / 2;
    view.y = box.y + box.height / 2;
    draw();
  }

  stage.toScreen = (x, y) => {
    const { width, height } = stage.sizes;
    return [width / 2 + (x - view.x) * view.scale, height / 2 - (y - view.y) * view.scale];
  };

  stage.toPlane = (left, top) => {
    const { width, height } = stage.sizes;
    return [view.x + (left - width / 2) / view.scale, view.y + (height / 2 - top) / view.scale];
  };

  // Lets the context draw in meters, in the frame of a body.
  stage.useMeters = (context, angle = 0, x = 0, y = 0) => {
    const [c, s] = [view.scale * Math.cos(angle), view.scale * Math.sin(angle)];
    stage.usePixels(context);
    context.transform(c, -s, -s, -c, ...stage.toScreen(x, y));
  };

  stage.usePixels = (context) => {
    const { ratio } = stage.sizes;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  };

  // Tracks and centrodes of a body, thinned for this scale.
  stage.pathsOf = (body) => {
    if (!paths.has(body)) {
      const step = (page.dragging ? 4 : 0.7) / view.scale;
      paths.set(body, motionPaths(data, body, step, extent));
    }
    return paths.get(body);
  };

  // Draws what is static: the grid, tracks of markers, fixed centrodes; then the instant.
  function draw() {
    stage.sizes = emptyCanvas(under, page.printing);
    if (data.live || data.edited || paths.scale !== view.scale) {
      paths = Object.assign(new Map(), { scale: view.scale });
    }
    const { context } = stage.sizes;
    drawGrid(context);
    stage.useMeters(context);
    context.lineJoin = 'round';
    for (const body of stage.shownBodies()) {
      context.strokeStyle = body.color;
      if (stage.isOn('tracks')) {
        context.globalAlpha = 0.28;
        context.lineWidth = 0.9 / view.scale;
        for (const path of stage.pathsOf(body).tracks) context.stroke(path);
      }
      if (stage.isOn('fixed')) {
        context.globalAlpha = 0.42;
        context.lineWidth = 4 / view.scale;
        context.stroke(stage.pathsOf(body).fixed);
      }
    }
    context.globalAlpha = 1;
    stage.usePixels(context);
    for (const { bodies, at } of data.joints) {
      if (bodies.length === 1 && !page.hidden.has(bodies[0])) drawGround(context, at[0]);
    }
    drawCursor();
  }

  function drawGrid(context) {
    const { width, height } = stage.sizes;
    const [halfWidth, halfHeight] = [width / view.scale / 2, height / view.scale / 2];
    const { step, at } = ticks(view.x - halfWidth, view.x + halfWidth, width / 90);
    const rows = [];
    for (let n = Math.ceil((view.y - halfHeight) / step); n * step < view.y + halfHeight; n++) {
      rows.push(n * step);
    }
    const left = (x) => stage.toScreen(x, 0)[0];
    const top = (y) => stage.toScreen(0, y)[1];
    context.font = `11${FONT}`;
    context.lineWidth = 1;
    context.strokeStyle = GRID;
    context.fillStyle = '#6a737c';
    const sharp = (pixel) => Math.round(pixel) + 0.5;
    strokeLines(
      context,
      ...at.map((x) => [[sharp(left(x)), 0], [sharp(left(x)), height]]),
      ...rows.map((y) => [[0, sharp(top(y))], [width, sharp(top(y))]]),
    );
    const text = (value) => tickText(1e3 * value, 1e3 * step);
    context.textAlign = 'center';
    for (const x of at) {
      if (left(x) > 30 && left(x) < width - 72) context.fillText(text(x), left(x), height - 6);
    }
    context.textAlign = 'left';
    for (const y of rows) {
      if (top(y) > 34 && top(y) < height - 20) context.fillText(text(y), 5, top(y) - 3);
    }
    context.textAlign = 'right';
    context.fillText(`${data.along.join(', ')} (mm)`, width - 6, height - 6);
  }

  // The symbol of a pin on the ground: a triangle on hatching.
  function drawGround(context, [x, y]) {
    const [left, top] = stage.toScreen(x, y);
    const r = 9;
    const at = (u, v) => [left + u * r, top + v * r];
    context.strokeStyle = '#3c444c';
    context.fillStyle = '#fff';
    context.lineWidth = 1.3;
    context.beginPath();
    addLines(context, [at(0, 0), at(-0.9, 1.6), at(0.9, 1.6)]);
    context.closePath();
    context.fill();
    addLines(context, [at(-1.6, 1.6), at(1.6, 1.6)]);
    for (let k = -1.5; k < 1.6; k += 0.6) addLines(context, [at(k, 1.6), at(k - 0.4, 2.2)]);
    context.stroke();
  }

  function drawCursor() {
    film?.draw();
    const { context } = emptyCanvas(over, page.printing);
    drawInstant(context, page.k);
    page.drawOver?.(context);
  }

  return Object.assign(stage, { fit, showAll, updateMotion, updatePoints, draw, drawCursor });
}
