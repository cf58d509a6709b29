/**
 * Draws one connector. Where two edges cross, a piece in the colour of the ground lies below the upper one: it is seen to
 * pass over the other. Where they join, there is a dot.
 */
import { edgeSpoken, labelOf, toneOf } from "../words.js";
import { widthOf } from "./fitting.js";
import { font } from "./fonts.js";
import { crossOn, rounded } from "./paths.js";
import { make } from "./svg.js";

/** @import {Box, Edge, EdgeFigures, Point} from "../types.js" */
/** @typedef {{node: SVGElement, label: SVGElement, first: Text, second: Text, tone: string}} Drawn */
/** @typedef {{chosen: boolean, own: boolean, silent: boolean, crowded: boolean, muted: boolean, size: number, room: number}} Look
 * crowded: another label is right below; muted: another label stands where this one would, and matters more; size: of text; room: for a line of it */

/**
 * @param {Edge} edge @param {EdgeFigures | undefined} row @param {Look} look @param {Map<number, Box>} boxes
 * @param {Point[]} joints @param {string} over its pieces above others
 * @returns {Drawn}
 */
export function makeEdge(edge, row, look, boxes, joints, over) {
  const d = rounded(edge.points), tone = toneOf(edge, row), [x, y] = edge.label;
  const node = make("g", {
    class: edgeClass(edge, tone, look), "data-edge": edge.id, role: "img", "aria-roledescription": "connector",
    "aria-label": edgeSpoken(edge, boxes, tone), tabindex: -1,
  },
  make("path", { class: "glow", d }), ...(over ? [make("path", { class: "ground", d: over })] : []), make("path", { class: "line", d }),
  ...(edge.link ? [make("path", { class: "core", d })] : []),
  make("path", { class: "hit", d }),
  ...(edge.state === "down" ? [make("path", { class: "cross", d: crossOn(edge.points, 8).map(([from, to]) => `M${from}L${to}`).join("") })] : []),
  ...joints.map(([cx, cy]) => make("circle", { class: "joint", cx, cy, r: 3.5 })));
  const [first, second] = [document.createTextNode(""), document.createTextNode("")];
  const below = look.crowded ? make("tspan", { class: "more", dx: 6 }, second) : make("tspan", { class: "more", x, y: y + 17 }, second);
  const label = make("text", { class: edgeClass(edge, tone, look).replace("edge-of", "label"), x, y: y - 7, "aria-hidden": "true", "data-edge": edge.id }, first, below);
  const drawn = { node, label, first, second, tone: "" };
  updateEdge(drawn, edge, row, look, boxes);
  return drawn;
}

/** Say of an edge how it fares now; the document is touched only where something is different. @param {Drawn} drawn @param {Edge} edge @param {EdgeFigures | undefined} row @param {Look} look @param {Map<number, Box>} boxes */
export function updateEdge(drawn, edge, row, look, boxes) {
  const tone = toneOf(edge, row), strong = tone === "lossy" || tone === "down" || tone === "full";
  const [first, second] = look.muted ? ["", ""] : labelOf(edge, row, look.crowded, (text) => widthOf(text, font(look.size, strong)) <= look.room);
  if (drawn.first.data !== first) drawn.first.data = first;
  if (drawn.second.data !== second) drawn.second.data = second;
  const kind = edgeClass(edge, tone, look);
  if (drawn.node.getAttribute("class") !== kind) {
    drawn.node.setAttribute("class", kind);
    drawn.label.setAttribute("class", kind.replace("edge-of", "label"));
  }
  if (drawn.tone !== tone) drawn.node.setAttribute("aria-label", edgeSpoken(edge, boxes, tone));
  drawn.tone = tone;
}

/** @param {Edge} edge @param {string} tone @param {Look} look */
const edgeClass = (edge, tone, look) => ["edge-of", tone, edge.link && "link", edge.bundle > 1 && "bundle", look.chosen && "chosen",
  look.own && "own", look.silent && "silent"].filter(Boolean).join(" ");
