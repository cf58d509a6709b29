/** What a pointer does on the scene, and where the view goes when a thing is selected. */
import * as store from "../store.js";
import { toggleFold, unfold } from "../walk.js";
import { dragging } from "./drag.js";
import { away } from "./paths.js";
import { tips } from "./tip.js";

/** @import {Scene} from "./scene.js" */

/** How near an edge has to be to a click, in px. */
const NEAR_EDGE = 8;

/** @param {Scene} scene @param {import("./view.js").Moves} view @returns {() => void} brings what is selected into view */
export function pointing(scene, view) {
  /** @param {Element} target what was clicked @param {number} id of the box that it is in */
  const tap = (target, id) => {
    const box = store.boxes.peek().get(id), port = target.closest("[data-port]")?.getAttribute("data-port");
    if (port && box && box.kind !== "folded") store.choose("port", store.portId(id, port), { focus: true });
    else if (box?.kind === "folded" && store.selected.peek()?.id === id) unfold(box);
    else store.choose("box", id, { focus: true });
  };
  dragging(scene, tap);
  tips(scene, (x, y) => {
    const found = scene.far ? boxAt(scene, x, y) : null;
    return found === null ? null : { box: found };
  });

  scene.host.addEventListener("click", (event) => {
    const target = /** @type {Element} */ (event.target);
    const fold = target.closest("[data-fold]"), edge = target.closest("[data-edge]"), frame = target.closest(".title[data-frame]");
    if (fold) return toggleFold(Number(fold.getAttribute("data-fold")));
    if (edge) return store.choose("edge", Number(edge.getAttribute("data-edge")), { focus: true });
    if (frame) return store.choose("frame", Number(frame.getAttribute("data-frame")), { focus: true });
    const tapped = target.closest(".box");
    if (tapped && /** @type {PointerEvent} */ (event).pointerType === "touch") return tap(target, Number(tapped.getAttribute("data-box")));
    if (tapped || target.closest(".tip, .splitter")) return undefined;
    const box = scene.far ? boxAt(scene, event.clientX, event.clientY) : null;
    if (box !== null) return store.choose("box", box);
    const near = scene.far ? edgeAt(scene, event.clientX, event.clientY) : null;
    return near === null ? store.chooseNothing() : store.choose("edge", near);
  });

  const reveal = () => {
    const chosen = store.selected.peek();
    if (!chosen || chosen.kind === "kernel") return;
    const id = Number(chosen.id);
    if (chosen.kind === "box" || chosen.kind === "port") {
      const box = chosen.kind === "box" ? store.boxes.peek().get(id) : store.portOf(chosen.id, store.boxes.peek())?.box;
      if (box) view.reveal(box.x, box.y, box.w, box.h);
    } else if (chosen.kind === "frame") {
      const frame = store.frames.peek().get(id);
      if (frame) view.reveal(frame.x, frame.y, Math.min(frame.w, 400), Math.min(frame.h, 200));
    } else {
      const edge = store.edges.peek().get(id);
      if (edge) view.reveal(edge.label[0] - 110, edge.label[1] - 24, 120, 48);
    }
  };
  store.on("choose", ({ focus = false }) => {
    const chosen = store.selected.peek();
    reveal();
    if (!focus || !chosen || chosen.kind === "kernel") return;
    scene.drawNow();   // now: focus goes only to what is in the document
    scene.nodeOf(chosen)?.focus({ preventScroll: true });
  });
  return reveal;
}

/** @param {Scene} scene @param {number} x @param {number} y of the window @returns {[number, number]} of the scene */
function placeOf(scene, x, y) {
  const around = scene.host.getBoundingClientRect();
  return [(x - around.left - scene.view.x) / scene.view.k, (y - around.top - scene.view.y) / scene.view.k];
}

/** @param {Scene} scene @param {number} x @param {number} y @returns {number | null} */
function boxAt(scene, x, y) {
  const [px, py] = placeOf(scene, x, y);
  for (const id of scene.grid.find({ x0: px, y0: py, x1: px, y1: py }).boxes) {
    const box = store.boxes.peek().get(id);
    if (box && px >= box.x && px <= box.x + box.w && py >= box.y && py <= box.y + box.h) return id;
  }
  return null;
}

/** @param {Scene} scene @param {number} x @param {number} y @returns {number | null} */
function edgeAt(scene, x, y) {
  const [px, py] = placeOf(scene, x, y), reach = NEAR_EDGE / scene.view.k;
  let best = null, least = reach;
  for (const id of scene.grid.find({ x0: px - reach, y0: py - reach, x1: px + reach, y1: py + reach }).edges) {
    const distance = away(store.edges.peek().get(id)?.points ?? [], [px, py]);
    if (distance < least) [best, least] = [id, distance];
  }
  return best;
}
