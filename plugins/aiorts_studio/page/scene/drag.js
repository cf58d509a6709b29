/**
 * Moves boxes within their frames: by drag, and by Alt and the arrows. A finger moves the selected box alone: on others
 * it pans. The server is told; the edges come from it, led anew.
 */
import * as store from "../store.js";

/** @import {Scene} from "./scene.js" */

/** A hand that only clicks trembles less than this, in px. */
const CLICK = 4;
const MOVES_PER_SECOND = 8;
const ANSWER_MS = 600;

/** @param {Scene} scene @param {(target: Element, id: number) => void} click called with what was clicked, not moved, and its box */
export function dragging(scene, click) {
  /** @type {{id: number, pointer: number, x: number, y: number, startX: number, startY: number, moved: boolean, said: number, target: Element} | null} */
  let held = null;

  /** @param {PointerEvent} event */
  const place = (event) => {
    if (!held) return { x: 0, y: 0 };
    return inFrame(held.id, held.x + (event.clientX - held.startX) / scene.view.k, held.y + (event.clientY - held.startY) / scene.view.k);
  };

  scene.svg.addEventListener("pointerdown", (event) => {
    const node = event.target instanceof Element && event.target.closest(".box");
    const box = node && store.boxes.peek().get(Number(node.getAttribute("data-box")));
    if (!box || event.button || held || (event.pointerType === "touch" && !scene.world.chosen("box", box.id))) return;
    event.stopPropagation();
    held = { id: box.id, pointer: event.pointerId, x: box.x, y: box.y, startX: event.clientX, startY: event.clientY, moved: false, said: 0, target: /** @type {Element} */ (event.target) };
  });
  window.addEventListener("pointermove", (event) => {
    if (!held || event.pointerId !== held.pointer) return;
    if (!held.moved && Math.hypot(event.clientX - held.startX, event.clientY - held.startY) < CLICK) return;
    held.moved = true;
    const { x, y } = place(event);
    scene.hold({ id: held.id, x, y });
    if (performance.now() - held.said < 1000 / MOVES_PER_SECOND) return;
    held.said = performance.now();
    store.say({ t: "move", id: held.id, x, y });
  });
  const end = (/** @type {PointerEvent} */ event) => {
    if (!held || event.pointerId !== held.pointer) return;
    const { id, moved, target } = held, to = place(event);
    held = null;
    if (!moved) return click(target, id);
    store.say({ t: "move", id, ...to });
    const last = { id, ...to };
    scene.hold(last);
    window.setTimeout(() => scene.letGo(last), ANSWER_MS);   // where the server found no room there, it goes to where it did
    return undefined;
  };
  window.addEventListener("pointerup", end);
  window.addEventListener("pointercancel", end);
}

/** What a frame keeps free at its head, and around. */
const HEAD = 48, EDGE = 8;

/** The place next to a wish at which a box is inside of its frame. @param {number} id @param {number} x @param {number} y */
function inFrame(id, x, y) {
  const box = store.boxes.peek().get(id), frames = store.frames.peek(), own = frames.get(box?.frame ?? NaN);
  const frame = frames.get((own?.folded ? own.parent : box?.around) ?? NaN);   // a folded frame goes with its box
  if (!box || !frame) return { x: Math.round(x), y: Math.round(y) };
  const within = (/** @type {number} */ at, /** @type {number} */ low, /** @type {number} */ high) => Math.round(Math.max(low, Math.min(at, high)));
  return { x: within(x, frame.x + EDGE, frame.x + frame.w - box.w - EDGE), y: within(y, frame.y + HEAD, frame.y + frame.h - box.h - EDGE) };
}

/** Move a box by the keyboard. @param {number} id @param {number} dx @param {number} dy */
export function nudge(id, dx, dy) {
  const box = store.boxes.peek().get(id);
  if (box) store.say({ t: "move", id, ...inFrame(id, box.x + dx, box.y + dy) });
}
