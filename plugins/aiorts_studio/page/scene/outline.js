/**
 * What is not in the document, for screen readers: as text, without focus, so that the whole system can be read. It is
 * written in the browser's idle time.
 */
import * as store from "../store.js";
import { boxSpoken, edgeSpoken, portSpoken, toneOf } from "../words.js";
import { html } from "./svg.js";

/** @import {Scene} from "./scene.js" @import {Box, Edge} from "../types.js" */

const PAUSE_MS = 700;
const EACH = 60;

/** @param {Scene} scene */
export function outline(scene) {
  const list = scene.host.appendChild(html("div", { class: "heard", role: "group", "aria-label": "Out of view" }));
  /** @type {Map<string, HTMLElement>} */
  const lines = new Map();
  let timer = 0;

  const write = () => {
    const wanted = new Map();
    for (const box of store.boxes.peek().values()) if (!scene.shown.boxes.has(box.id)) wanted.set(`b${box.id}`, box);
    for (const edge of store.edges.peek().values()) if (!scene.shown.edges.has(edge.id)) wanted.set(`e${edge.id}`, edge);
    for (const [key, node] of lines) {
      if (wanted.has(key)) continue;
      node.remove();
      lines.delete(key);
    }
    const absent = [...wanted].filter(([key]) => !lines.has(key));
    const some = (/** @type {number} */ from) => requestIdleCallback(() => {
      for (const [key, thing] of absent.slice(from, from + EACH)) {
        if (lines.has(key)) continue;
        const node = key.startsWith("b") ? boxLine(thing) : edgeLine(thing);
        lines.set(key, node);
        list.append(node);
      }
      if (from + EACH < absent.length) some(from + EACH);
    });
    if (absent.length) some(0);
  };
  const later = () => {
    window.clearTimeout(timer);
    timer = window.setTimeout(write, PAUSE_MS);
  };
  for (const kind of ["picture", "change"]) store.on(kind, later);
  store.on("change", ({ boxes = [], edges = [] }) => {
    for (const key of [...boxes.map((/** @type {Box} */ one) => `b${one.id}`), ...edges.map((/** @type {Edge} */ one) => `e${one.id}`)]) {
      lines.get(key)?.remove();
      lines.delete(key);
    }
  });
  const before = scene.onCulled;
  scene.onCulled = () => {
    before();
    later();
  };
}

/** @param {Box} box */
function boxLine(box) {
  const { state, said } = store.boxFigures.peek().get(box.id) ?? box;
  return html("div", { role: "group", "aria-roledescription": "component", "aria-label": boxSpoken(box, state, said, store.kernels.peek().get(box.kernel)) },
    ...box.ports.map((port) => html("span", { role: "img", "aria-roledescription": "port", "aria-label": portSpoken(port) })));
}

/** @param {Edge} edge */
function edgeLine(edge) {
  const said = edgeSpoken(edge, store.boxes.peek(), toneOf(edge, store.figures.peek().get(edge.id)));
  return html("span", { role: "img", "aria-roledescription": "connector", "aria-label": said });
}
