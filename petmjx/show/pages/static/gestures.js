// Mouse, touch and pen on a canvas: turn (drag), move (right or middle button, shift, two fingers), zoom (wheel,
// pinch), click.

import { clamped } from "./vectors.js";

const CLICK_PIXELS = 5; // a press that moves less is a click
const TURN = 0.008; // radians per pixel
const WHEEL = 0.0012; // change of the camera's distance, as a share, per pixel of the wheel

// actions: turn(right, up), pan(right, up) in shares of the height, zoom(factor), click(x, y) in pixels of the page.
// Returns a function that stops listening.
export function listen(canvas, actions) {
  const fingers = new Map();
  let travelled = 0;
  const stop = new AbortController();
  const on = (name, act) => canvas.addEventListener(name, act, { signal: stop.signal, passive: false });

  on("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (fingers.size === 0) travelled = 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size > 1) travelled = Infinity;
  });

  on("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const step = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.hypot(...step);
    if (travelled > CLICK_PIXELS) {
      if (fingers.size === 1) drag(event, step);
      else pinch(event.pointerId, before, now, step);
    }
    fingers.set(event.pointerId, now);
  });

  function drag(event, [right, down]) {
    const moves = event.shiftKey || event.ctrlKey || event.buttons & 6;
    if (moves) actions.pan(right / canvas.clientHeight, -down / canvas.clientHeight);
    else actions.turn(right * TURN, down * TURN);
  }

  // Each of two fingers moves the picture by half of its own motion. If the distance between the fingers changes, the
  // picture is zoomed.
  function pinch(id, before, now, step) {
    const other = [...fingers].find(([key]) => key !== id)[1];
    const span = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
    actions.zoom(span(before) / span(now));
    actions.pan(step[0] / 2 / canvas.clientHeight, -step[1] / 2 / canvas.clientHeight);
  }

  on("pointerup", (event) => {
    const known = fingers.delete(event.pointerId);
    if (known && travelled <= CLICK_PIXELS && event.button === 0) actions.click(event.clientX, event.clientY);
  });
  on("pointercancel", (event) => fingers.delete(event.pointerId));
  on("contextmenu", (event) => event.preventDefault());
  on("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaMode === 1 ? event.deltaY * 16 : event.deltaY;
    actions.zoom(Math.exp(clamped(pixels, -300, 300) * WHEEL));
  });
  return () => stop.abort();
}
