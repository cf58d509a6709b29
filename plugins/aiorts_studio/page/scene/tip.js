/** Says in full what is cut or not shown: a box, a port, an edge, a frame under the pointer or with the focus. */
import * as store from "../store.js";
import { edgeLines, endsOf, portSpoken } from "../words.js";
import { html } from "./svg.js";

/** @import {Scene} from "./scene.js" */
/** @typedef {{title: string, lines: string[], node: Element | null}} Said */

const DELAY = 250;

/** @param {Scene} scene @param {(x: number, y: number) => Element | {box: number} | null} thingAt what the canvas shows at a point */
export function tips(scene, thingAt) {
  const tip = scene.host.appendChild(html("div", { class: "tip", role: "tooltip", id: "tip", hidden: "" }));
  let timer = 0, shownFor = "";

  const hide = () => {
    window.clearTimeout(timer);
    tip.hidden = true;
    shownFor = "";
  };

  /** @param {Said} said @param {number} x @param {number} y */
  const show = ({ title, lines }, x, y) => {
    tip.replaceChildren(html("b", {}, title), ...lines.map((line) => html("span", {}, line)));
    tip.hidden = false;
    const around = scene.host.getBoundingClientRect();
    const left = Math.min(x - around.left + 14, around.width - tip.offsetWidth - 8);
    const top = y - around.top + 18;
    tip.style.left = `${Math.max(8, left)}px`;   // by the CSSOM: allowed by the policy
    tip.style.top = `${top + tip.offsetHeight > around.height - 8 ? Math.max(8, y - around.top - tip.offsetHeight - 12) : top}px`;
  };

  scene.host.addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch" || event.buttons) return hide();
    const found = saidOf(event.target) ?? far(thingAt(event.clientX, event.clientY));
    const key = found ? found.title + found.lines.join() : "";
    if (!found) return tip.contains(/** @type {Node} */ (event.target)) ? undefined : hide();
    if (shownFor === key && !tip.hidden) return undefined;
    window.clearTimeout(timer);
    shownFor = key;
    const box = found.node?.matches(".box") ? found.node.getBoundingClientRect() : null;   // below it, not upon it
    timer = window.setTimeout(() => show(found, event.clientX, box ? box.bottom - 8 : event.clientY), tip.hidden ? DELAY : 60);
    return undefined;
  });
  scene.host.addEventListener("pointerleave", hide);
  scene.host.addEventListener("pointerdown", hide);
  scene.host.addEventListener("focusin", ({ target }) => {
    const found = saidOf(target), node = found?.node;
    if (!found || !node?.matches(":focus-visible")) return hide();
    const place = node.querySelector(".line") ? null : node.getBoundingClientRect();
    const label = scene.host.querySelector(`text[data-edge="${node.getAttribute("data-edge")}"]`)?.getBoundingClientRect();
    const at = place ?? label;
    if (at && (scene.far || !place || node.querySelector("[data-cut]"))) show(found, at.left, at.bottom - 8);
    else hide();
    return undefined;
  });
  scene.host.addEventListener("focusout", hide);
  window.addEventListener("keydown", ({ key }) => key === "Escape" && hide());
  return hide;
}

/** @param {Element | {box: number} | null} thing @returns {Said | null} */
function far(thing) {
  if (!thing) return null;
  return "box" in thing ? boxSaid(thing.box, null) : saidOf(thing);
}

/** @param {EventTarget | null} target @returns {Said | null} */
function saidOf(target) {
  if (!(target instanceof Element)) return null;
  const port = target.closest("[data-port]"), box = target.closest("[data-box]"), edge = target.closest("[data-edge]"), frame = target.closest("[data-frame]");
  if (port && box) {
    const found = store.boxes.peek().get(Number(box.getAttribute("data-box")));
    const one = found?.ports.find((each) => each.name === port.getAttribute("data-port"));
    if (found && one) return { title: `${found.name}.${one.name}`, lines: portSpoken(one).split(", ").slice(1), node: port };
  }
  if (box) return boxSaid(Number(box.getAttribute("data-box")), box);
  if (edge) {
    const found = store.edges.peek().get(Number(edge.getAttribute("data-edge")));
    if (found) return { title: endsOf(found, store.boxes.peek()).join(" → "), lines: edgeLines(found, store.figures.peek().get(found.id)), node: edge };
  }
  const found = frame && store.frames.peek().get(Number(frame.getAttribute("data-frame")));
  return found ? { title: found.name || "in no context", lines: [found.kind, frame.getAttribute("aria-label")?.split(", ").slice(1).join(", ") ?? ""].filter(Boolean), node: frame } : null;
}

/** @param {number} id @param {Element | null} node @returns {Said | null} */
function boxSaid(id, node) {
  const box = store.boxes.peek().get(id);
  if (!box) return null;
  const { state, said } = store.boxFigures.peek().get(id) ?? box, { error } = box;
  const where = error?.file ? `${error.file}${error.line ? `:${error.line}` : ""}` : "";
  return { title: box.name, lines: [box.type, state, said, error?.message ?? "", where].filter(Boolean), node };
}
