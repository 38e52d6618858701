"""What a page in a browser shows: its text, and the colors of its canvases."""

from typing import Any

BLUE, RED, GREEN = '#0072b2', '#d55e00', '#007a5a'


def drawn(page: Any) -> None:
    """Wait until all is drawn that was asked for."""
    page.evaluate('new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))')


COUNT_PIXELS = """([selector, color]) => [...document.querySelectorAll(selector)].reduce(
    (sum, canvas) => {
      const copy = new OffscreenCanvas(canvas.width, canvas.height);
      const context = copy.getContext('2d', { willReadFrequently: true });
      context.drawImage(canvas, 0, 0);
      const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
      const wanted = [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
      for (let k = 0; k < data.length; k += 4) {
        if (data[k + 3] > 250 && wanted.every((w, c) => Math.abs(w - data[k + c]) < 8)) sum++;
      }
      return sum;
    }, 0)"""


def colored(page: Any, selector: str, color: str) -> int:
    """Count the pixels near the color in all canvases of the selected elements."""
    count: int = page.evaluate(COUNT_PIXELS, [selector, color])
    return count


def await_color(page: Any, selector: str, color: str, above: int) -> None:
    """Wait until more than `above` pixels are near the color: a live page redraws all the time."""
    page.wait_for_function(f'(a) => ({COUNT_PIXELS})(a) > {above}', arg=[selector, color])


def cell(page: Any, name: str, column: int) -> str:
    text: str = page.locator(f'#values tr[data-name={name}] td').nth(column).inner_text()
    return text.replace('−', '-')
