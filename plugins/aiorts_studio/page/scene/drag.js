/**
 * Moves boxes: by drag, and by Alt and the arrows. A finger moves the selected box alone: on others it pans.
 * The server is told; the edges come from it, led anew.
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
    return { x: Math.round(held.x + (event.clientX - held.startX) / scene.view.k), y: Math.round(held.y + (event.clientY - held.startY) / scene.view.k) };
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
    const { x, y } = place(event), node = scene.boxes.get(held.id);
    node?.setAttribute("transform", `translate(${x} ${y})`);
    node?.classList.add("moving");
    if (performance.now() - held.said < 1000 / MOVES_PER_SECOND) return;
    held.said = performance.now();
    store.say({ t: "move", id: held.id, x, y });
  });
  const end = (/** @type {PointerEvent} */ event) => {
    if (!held || event.pointerId !== held.pointer) return;
    const { id, moved, target } = held, to = place(event);
    held = null;
    scene.boxes.get(id)?.classList.remove("moving");
    if (!moved) return click(target, id);
    store.say({ t: "move", id, ...to });
    window.setTimeout(() => {   // where the server found no room there, it stays where it was
      const box = held?.id === id ? null : store.boxes.peek().get(id);
      if (box) scene.putBox(box);
    }, ANSWER_MS);
    return undefined;
  };
  window.addEventListener("pointerup", end);
  window.addEventListener("pointercancel", end);
}

/** Move a box by the keyboard. @param {number} id @param {number} dx @param {number} dy */
export function nudge(id, dx, dy) {
  const box = store.boxes.peek().get(id);
  if (box) store.say({ t: "move", id, x: box.x + dx, y: box.y + dy });
}
