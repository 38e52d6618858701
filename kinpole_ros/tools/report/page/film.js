// ---- The film behind the stage: pictures that are straightened to the plane of the motion ----

// Pictures that are kept decoded, and those ahead that are decoded before they are needed.
const [KEPT_PICTURES, PICTURES_AHEAD] = [60, 6];

function makeFilm(element, stage) {
  const { page, data: { film } } = stage;
  const canvas = tag('canvas');
  element.prepend(canvas);
  const decoded = new Map();
  let shown = null;

  // The picture of a number, which draws when it is decoded.
  function pictureAt(number) {
    if (!decoded.has(number)) {
      const image = new Image();
      image.onload = () => { if (number === film.at[page.k]) draw(); };
      image.src = `data:image/jpeg;base64,${film.pictures[number]}`;
      decoded.set(number, image);
      if (decoded.size > KEPT_PICTURES) decoded.delete(decoded.keys().next().value);
    }
    return decoded.get(number);
  }

  // Draws the picture of the cursor; until it is decoded, the one before stays.
  function draw() {
    const { context } = emptyCanvas(canvas, page.printing);
    canvas.dataset.shown = '';
    if (!stage.isOn('film')) return;
    const number = film.at[page.k];
    for (let k = 1; k <= PICTURES_AHEAD; k++) {
      if (number + k < film.pictures.length) pictureAt(number + k);
    }
    const picture = pictureAt(number);
    if (picture.complete && picture.naturalWidth) [shown, canvas.dataset.shown] = [picture, number];
    if (!shown) return;
    const [left, top] = stage.toScreen(film.x, film.y + film.height);
    const { x, y, scale } = stage.view;
    canvas.dataset.view = [x, y, scale];
    context.drawImage(shown, left, top, film.width * scale, film.height * scale);
  }

  return { draw };
}
