/** Pan and zoom: d3-zoom knows wheels, pinches and double taps; what it says goes to the scene as it is. */
import { select, zoom, zoomIdentity } from "../vendor/d3-zoom.js";
import * as store from "../store.js";

/** @import {Scene} from "./scene.js" */
/** @typedef {{fit: () => void, by: (factor: number) => void, reveal: (x: number, y: number, w: number, h: number) => void}} Moves */

const LEAST = 0.02, MOST = 3;
/** What is around a picture that was fitted. */
const MARGIN = { side: 24, top: 20, bottom: 20 };
/** The largest scale of a picture that was fitted: by the width there is, as a large screen is looked at from further away. */
const mostFitted = (/** @type {number} */ width) => (width > 2200 ? 1.7 : 1.2);
const OWN_TOUCH = ".box.chosen, .tip, .fold, .splitter", OWN_POINTER = ".box, .tip, .fold, .splitter";

/** @param {HTMLElement} host @param {Scene} scene @returns {Moves} */
export function moving(host, scene) {
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const behaviour = /** @type {import("../vendor/d3-zoom.js").ZoomBehavior<HTMLElement, unknown>} */ (zoom()).scaleExtent([LEAST, MOST])
    .filter((/** @type {any} */ event) => event.type === "wheel" || (event.touches?.length ?? 0) > 1
      || (!event.target.closest(event.touches ? OWN_TOUCH : OWN_POINTER) && !event.button))
    .on("zoom", (/** @type {any} */ { transform }) => scene.setView({ x: transform.x, y: transform.y, k: transform.k }));
  const area = /** @type {import("d3-selection").Selection<HTMLElement, unknown, any, any>} */ (select(host)).call(behaviour).on("dblclick.zoom", null);
  /** Motion shows where one has gone; who asked for none is there at once. @param {number} ms */
  const target = (ms) => (still.matches || !area.transition ? area : area.transition().duration(ms));

  return {
    fit() {
      const bounds = boundsOf();
      if (!bounds || !scene.width) return;
      const [width, height] = [scene.width - 2 * MARGIN.side, scene.height - MARGIN.top - MARGIN.bottom];
      const k = Math.max(LEAST, Math.min(mostFitted(width), width / (bounds.x1 - bounds.x0), height / (bounds.y1 - bounds.y0)));
      const x = MARGIN.side + (width - (bounds.x1 - bounds.x0) * k) / 2 - bounds.x0 * k;
      const y = MARGIN.top + Math.max(0, (height - (bounds.y1 - bounds.y0) * k) / 2) - bounds.y0 * k;
      area.call(behaviour.transform, zoomIdentity.translate(x, y).scale(k));
    },
    by(factor) { target(120).call(behaviour.scaleBy, factor); },
    reveal(x, y, w, h) {
      const { x: left, y: top, k } = scene.view, [x0, y0, x1, y1] = [x * k + left, y * k + top, (x + w) * k + left, (y + h) * k + top];
      const dx = shift(x0, x1, scene.width), dy = shift(y0, y1, scene.height - MARGIN.bottom);
      if (dx || dy) area.call(behaviour.translateBy, dx / k, dy / k);   // at once: focus goes only to what is in view
    },
  };
}

/** How far to move so that a stretch is within 0 to most; 0: it is. @param {number} low @param {number} high @param {number} most */
function shift(low, high, most) {
  if (low >= 8 && high <= most - 8) return 0;
  if (high - low > most - 48) return 24 - low;
  return low < 8 ? 24 - low : most - 24 - high;
}

/** The rectangle around all there is. @returns {import("./grid.js").Rect | null} */
function boundsOf() {
  const rects = [...store.frames.peek().values(), ...store.boxes.peek().values()];
  const points = [...store.edges.peek().values()].flatMap((one) => one.points);
  if (!rects.length) return null;
  const bounds = { x0: Infinity, y0: Infinity, x1: -Infinity, y1: -Infinity };
  const widen = (/** @type {number} */ x, /** @type {number} */ y) => {
    [bounds.x0, bounds.y0] = [Math.min(bounds.x0, x), Math.min(bounds.y0, y)];
    [bounds.x1, bounds.y1] = [Math.max(bounds.x1, x), Math.max(bounds.y1, y)];
  };
  for (const { x, y, w, h } of rects) {
    widen(x, y);
    widen(x + w, y + h);
  }
  for (const [x, y] of points) widen(x, y);
  return bounds;
}
