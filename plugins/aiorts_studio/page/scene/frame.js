/** Draws what stands around boxes: a host, a kernel, a context, a process, a composite. */
import { cut, widthOf } from "./fitting.js";
import { font } from "./fonts.js";
import { make } from "./svg.js";

/** @import {Frame} from "../types.js" */
/** @typedef {{node: SVGElement, title: SVGElement, said: Text, text: string, sizes: import("./fonts.js").Sizes}} Drawn */

/** Whether a frame can be folded into one box. @param {Frame} frame */
export const folds = (frame) => frame.kind === "composite" || frame.kind === "context" || frame.kind === "kernel";

/**
 * @param {Frame} frame @param {string} said what stands behind its name @param {string} kind more classes
 * @param {import("./fonts.js").Sizes} sizes @returns {Drawn}
 */
export function makeFrame(frame, said, kind, sizes) {
  const node = make("rect", { class: `frame ${frame.kind} ${kind}`, x: frame.x, y: frame.y, width: frame.w, height: frame.h, rx: 14 });
  const text = document.createTextNode("");
  const left = folds(frame) ? 36 : 16, word = frame.name || "in no context";
  const name = cut(word, frame.w - left - 16, font(sizes.title, true));
  const title = make("g", {
    class: `title ${frame.kind} ${kind}`, transform: `translate(${frame.x} ${frame.y})`, "data-frame": frame.id, role: "group",
    "aria-roledescription": frame.kind, "aria-label": [word, said].filter(Boolean).join(", "), tabindex: -1,
  },
  make("rect", { class: "hit", x: left - 6, y: 4, width: Math.min(frame.w - left, widthOf(name, font(sizes.title, true)) + 12), height: 30 }),
  ...(folds(frame) ? [foldButton(frame)] : []),
  make("text", { class: "frame-name", x: left, y: 27, "aria-hidden": "true", "data-cut": name === word ? null : "" }, name,
    make("tspan", { class: "frame-said", dx: 12 }, text)));
  const drawn = { node, title, said: text, text: "", sizes };
  sayFrame(drawn, frame, said);
  return drawn;
}

/** @param {Drawn} drawn @param {Frame} frame @param {string} said */
export function sayFrame(drawn, frame, said) {
  if (drawn.text === said) return;
  drawn.text = said;
  const left = folds(frame) ? 36 : 16;
  drawn.said.data = cut(said, Math.max(0, frame.w - left - 28 - widthOf(frame.name || "in no context", font(drawn.sizes.title, true))), font(drawn.sizes.text));
  if (drawn.said.data === "…") drawn.said.data = "";
}

/** @param {Frame} frame */
function foldButton(frame) {
  return make("g", { class: "fold", role: "button", tabindex: -1, "aria-label": `${frame.folded ? "Unfold" : "Fold"} ${frame.name}`,
    "aria-expanded": String(!frame.folded), "data-fold": frame.id },
    make("rect", { class: "fold-body", x: 8, y: 10, width: 24, height: 24, rx: 6 }),
    make("path", { class: "fold-sign", d: frame.folded ? "M17.5 17l5 5l-5 5" : "M15 19.5l5 5l5 -5" }));
}
