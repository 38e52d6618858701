// ---- Velocity and acceleration polygons at the instant of the cursor ----

const POLYGONS = [['velocities', 'm/s'], ['accelerations', 'm/s²']];

// Points of a body that have images: named ones of a scene, or its markers and pins.
function imagePoints(data, body, k) {
  if (body.points) return body.points;
  return anchors(data, body, outlineAt(body, k) ?? undefined).map(([u, v]) => ['', u, v]);
}

// Velocities of a body's points, or accelerations, as [name, x, y]; none where they are not known.
function imagesOf(data, body, k, order) {
  const [w, alpha] = RATES.map((name) => body[name]?.value[k]);
  const [c, s] = [Math.cos(body.angle[k]), Math.sin(body.angle[k])];
  const [px, py] = [body.iap?.x[k], body.iap?.y[k]];
  return imagePoints(data, body, k).map(([name, u, v]) => {
    const [x, y] = [c * u - s * v, s * u + c * v];
    if (order === 1) return [name, body.vx[k] - w * y, body.vy[k] + w * x];
    // From the acceleration pole.
    const [dx, dy] = [body.x[k] + x - px, body.y[k] + y - py];
    return [name, -w * w * dx - alpha * dy, alpha * dx - w * w * dy];
  }).filter((image) => isFinite(image[1]) && isFinite(image[2]));
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

  function draw() {
    for (const plot of plots) drawOne(plot);
  }

  function drawOne({ canvas, unit, order }) {
    const { context, width, height } = fitted(canvas, page.printing);
    const shown = data.bodies.filter((body) => !page.hidden.has(body.name))
      .map((body) => [body, imagesOf(data, body, page.k, order)]);
    const sizes = shown.flatMap(([, images]) => images.map(([, x, y]) => Math.hypot(x, y)));
    const largest = Math.max(0, ...sizes);
    if (!(largest > 0)) return;
    // The scale changes by steps, so that one sees the polygon change.
    const most = 2 ** Math.ceil(Math.log2(largest));
    const scale = (0.5 * Math.min(width, height) - 20) / most;
    const at = (x, y) => [width / 2 + x * scale, height / 2 - y * scale];
    const pole = at(0, 0);
    const named = [];
    for (const [body, images] of shown) {
      context.strokeStyle = context.fillStyle = body.color;
      // The image of the body, similar to it.
      const shape = hull(images.map(([, x, y]) => at(x, y)));
      context.beginPath();
      shape.forEach(([x, y], n) => context[n ? 'lineTo' : 'moveTo'](x, y));
      context.closePath();
      context.globalAlpha = 0.14;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = 2;
      context.stroke();
      context.lineWidth = 1.1;
      for (const [name, x, y] of images) {
        arrow(context, pole, [x * scale, -y * scale]);
        if (name) named.push([name, ...at(x, y)]);
      }
    }
    context.fillStyle = '#1c2127';
    context.beginPath();
    context.arc(...pole, 3, 0, 2 * Math.PI);
    context.fill();
    nameImages(context, named, pole);
    const { step } = ticks(0, most, 3);
    context.strokeStyle = '#5b6570';
    context.lineWidth = 1.3;
    context.beginPath();
    context.moveTo(8, height - 9);
    context.lineTo(8 + step * scale, height - 9);
    context.stroke();
    say(context, `${tickWords(step, step)} ${unit}`, 14 + step * scale, height - 5, '#5b6570', 11);
  }

  // One name for points of one image, each once; those of the ground are at the pole.
  function nameImages(context, named, pole) {
    const groups = [{ x: pole[0], y: pole[1], names: new Set() }];
    for (const [name, x, y] of named) {
      const near = groups.find((group) => Math.hypot(group.x - x, group.y - y) < 9);
      if (near) near.names.add(name);
      else groups.push({ x, y, names: new Set([name]) });
    }
    for (const { x, y, names } of groups) {
      const text = [...names].join(', ');
      const left = x < pole[0] - 1;
      context.textAlign = left ? 'right' : 'left';
      say(context, text, x + (left ? -5 : 5), y + (y > pole[1] ? 12 : -5), '#1c2127', 11.5);
    }
    context.textAlign = 'left';
  }

  return { draw };
}
