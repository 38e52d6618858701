// ---- Velocity and acceleration polygons at the cursor ----

const POLYGONS = [['velocities', 'm/s'], ['accelerations', 'm/s²']];

// Points of a body with images: named ones of a scene, or markers and pins.
function imagePoints(data, body, k) {
  if (body.points) return body.points;
  return drawnPoints(data, body, outlineAt(body, k)).map(([u, v]) => ['', u, v]);
}

// Velocities (order 1) or accelerations of the points of a body, as [name, x, y], where determined.
function imagesOf(data, body, k, order) {
  const [w, alpha] = RATES.map((name) => body[name]?.value[k]);
  return imagePoints(data, body, k).map(([name, ...point]) => {
    if (order === 1) return [name, ...velocityAt(body, k, point)];
    // From the acceleration pole.
    const [x, y] = pointAt(body, k, point);
    const [dx, dy] = [x - body.iap?.x[k], y - body.iap?.y[k]];
    return [name, -w * w * dx - alpha * dy, alpha * dx - w * w * dy];
  }).filter(([, x, y]) => isFinite(x) && isFinite(y));
}

function makePolygons(element, page, data) {
  const plots = POLYGONS.map(([name, unit], n) => {
    const figure = tag('figure', undefined, { 'data-name': name });
    const plot = tag('div');
    const canvas = tag('canvas', undefined, { role: 'img', 'aria-label': `polygon of ${name}` });
    plot.append(canvas);
    figure.append(tag('figcaption', name), plot);
    element.append(figure);
    return { canvas, unit, order: n + 1 };
  });

  function drawPolygon({ canvas, unit, order }) {
    const { context, width, height } = emptyCanvas(canvas, page.printing);
    const shown = data.bodies.filter((body) => !page.hidden.has(body.name))
      .map((body) => [body, imagesOf(data, body, page.k, order)]);
    const lengths = shown.flatMap(([, images]) => images.map(([, x, y]) => Math.hypot(x, y)));
    const largest = Math.max(0, ...lengths);
    if (!(largest > 0)) return;
    // The scale changes in steps, so that changes of the polygon are visible.
    const range = 2 ** Math.ceil(Math.log2(largest));
    const scale = (0.5 * Math.min(width, height) - 20) / range;
    const at = (x, y) => [width / 2 + x * scale, height / 2 - y * scale];
    const pole = at(0, 0);
    const named = [];
    for (const [body, images] of shown) {
      context.strokeStyle = context.fillStyle = body.color;
      // The image of the body is similar to the body.
      context.beginPath();
      addLines(context, hull(images.map(([, x, y]) => at(x, y))));
      context.closePath();
      context.globalAlpha = 0.14;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 2;
      context.stroke();
      context.lineWidth = 1.1;
      for (const [name, x, y] of images) {
        drawArrow(context, pole, [x * scale, -y * scale]);
        if (name) named.push([name, ...at(x, y)]);
      }
    }
    context.fillStyle = INK;
    context.beginPath();
    context.arc(...pole, 3, 0, 2 * Math.PI);
    context.fill();
    drawImageNames(context, named, pole);
    const { step } = ticks(0, range, 3);
    context.strokeStyle = GRAY;
    context.lineWidth = 1.3;
    strokeLines(context, [[8, height - 9], [8 + step * scale, height - 9]]);
    drawText(context, `${tickText(step, step)} ${unit}`, 14 + step * scale, height - 5, GRAY, 11);
  }

  // Points with one image share a label; those of the ground are at the pole.
  function drawImageNames(context, named, pole) {
    const groups = [{ x: pole[0], y: pole[1], names: new Set() }];
    for (const [name, x, y] of named) {
      const near = groups.find((group) => Math.hypot(group.x - x, group.y - y) < 9);
      if (near) near.names.add(name);
      else groups.push({ x, y, names: new Set([name]) });
    }
    const drawLabel = makeLabels(context);
    for (const { x, y, names } of groups) {
      const isLeft = x < pole[0] - 1;
      context.textAlign = isLeft ? 'right' : 'left';
      const [left, top] = [x + (isLeft ? -5 : 5), y + (y > pole[1] ? 12 : -5)];
      drawLabel([...names].join(', '), left, top, INK, 11.5);
    }
    context.textAlign = 'left';
  }

  return { draw: () => plots.forEach(drawPolygon) };
}
