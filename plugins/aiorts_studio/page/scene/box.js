/** Draws one component: state by colour and letter, ports by their kinds. */
import { letterOf, portSpoken } from "../words.js";
import { cut, widthOf } from "./fitting.js";
import { font } from "./fonts.js";
import { make } from "./svg.js";

/** @import {Box, Port} from "../types.js" */
/** @typedef {{state: string, said: string, silent: boolean, spoken: string, chosen: boolean, port: string | null, first: boolean,
 *   sizes: import("./fonts.js").Sizes}} Look port: the name of the one that is chosen */

const STRIPE = 22, BADGE = 44;

/** @param {Box} box @param {Look} look */
export function makeBox(box, look) {
  const room = box.w - STRIPE - (look.state ? BADGE - 4 : 12);
  return make("g", {
    class: `box ${box.kind} ${box.infrastructure ? "infrastructure" : ""} ${classOf(look)}`, transform: `translate(${box.x} ${box.y})`,
    "data-box": box.id, role: "group", "aria-roledescription": "component", "aria-label": look.spoken,
    tabindex: look.first ? 0 : -1,
  },
  ...(box.kind === "folded" ? [make("rect", { class: "body under", x: 5, y: 5, width: box.w, height: box.h, rx: 10 })] : []),
  make("rect", { class: "body", width: box.w, height: box.h, rx: 10 }),
  make("rect", { class: "stripe", width: 4, height: 31, x: 10, y: 11, rx: 2 }),
  text("name", STRIPE, look.sizes.type ? 24 : 34, box.name, room, font(look.sizes.name, true)),
  ...(look.sizes.type ? [text(`type ${look.said ? "trouble" : ""}`, STRIPE, 43, look.said || box.type, room, font(look.sizes.text))] : []),
  ...(look.state ? [badge(box, look.state)] : []),
  ...box.ports.map((port) => makePort(box, port, look)));
}

/** Bring a box up to date with what changes while it runs. @param {SVGElement} node @param {Box} box @param {Look} look */
export function updateBox(node, box, look) {
  node.setAttribute("class", `box ${box.kind} ${box.infrastructure ? "infrastructure" : ""} ${classOf(look)}`);
  node.setAttribute("aria-label", look.spoken);
  node.setAttribute("tabindex", look.first ? "0" : "-1");
  for (const one of node.querySelectorAll("[data-port]")) one.classList.toggle("chosen", one.getAttribute("data-port") === look.port);
}

/** The classes of a box that change while it runs. @param {Look} look */
const classOf = (look) => `is-${look.state || "unknown"} ${look.silent ? "silent" : ""} ${look.chosen ? "chosen" : ""}`;

/** @param {Box} box @param {string} state */
function badge(box, state) {
  const shape = state === "error" ? make("rect", { x: -9, y: -9, width: 18, height: 18, rx: 4 }) : make("circle", { r: 9.5 });
  return make("g", { class: "state", transform: `translate(${box.w - 21} 26)`, "aria-hidden": "true" },
    shape, make("text", {}, letterOf(state)));
}

/** @param {string} kind @param {number} x @param {number} y @param {string} said @param {number} room @param {string} font @param {string} [more] */
function text(kind, x, y, said, room, font, more = "") {
  const shown = cut(said, room, font);
  return make("text", { class: `${kind} ${more}`, x, y, "aria-hidden": "true", "data-cut": shown === said ? null : "" }, shown);
}

/** @param {Box} box @param {Port} port @param {Look} look */
function makePort(box, port, { port: chosen, sizes: { text: size } }) {
  const left = port.side === "in", x = left ? 0 : box.w;
  const beside = box.ports.filter((one) => one.side !== port.side && Math.abs(one.y - port.y) < 20);
  const taken = Math.max(0, ...beside.map((one) => Math.min(widthOf(one.name, font(size)), box.w / 2 - 16) + 8));
  return make("g", {
    class: `port-of ${port.name === chosen ? "chosen" : ""}`, "data-port": port.name, role: "img", "aria-roledescription": "port",
    "aria-label": portSpoken(port), tabindex: -1,
  },
    make("rect", { class: "hit", x: left ? -12 : box.w - 26, y: port.y - 12, width: 38, height: 24 }),
    shapeOf(port, x),
    text("port-name", left ? 13 : box.w - 13, port.y + 4.7, port.name, box.w - 26 - taken, font(size), left ? "" : "end"));
}

/** Circle in, triangle out; a service is a square: full where it is provided, hollow where it is needed. @param {Port} port @param {number} x */
export function shapeOf({ side, kind, y }, x) {
  if (kind === "service") {
    return make("rect", { class: `port service ${side === "in" ? "needed" : ""}`, x: x - 5, y: y - 5, width: 10, height: 10, rx: 2 });
  }
  return side === "in" ? make("circle", { class: "port in", cx: x, cy: y, r: 5.5 })
    : make("path", { class: "port out", d: `M${x - 5} ${y - 6.5}L${x + 7} ${y}L${x - 5} ${y + 6.5}Z` });
}
