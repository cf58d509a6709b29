/** All frames of the scene, below the edges, and their titles above them. */
import * as store from "../store.js";
import { makeFrame, sayFrame } from "./frame.js";

export class Frames {
  /** @param {Element} below @param {Element} titles @param {import("./looks.js").Looks} looks */
  constructor(below, titles, looks) {
    this.below = below;
    this.titles = titles;
    this.looks = looks;
    /** @type {Map<number, import("./frame.js").Drawn>} */
    this.drawn = new Map();
  }

  draw() {
    const inside = document.activeElement?.closest("[data-frame]")?.getAttribute("data-frame");
    const all = [...store.frames.peek().values()].sort((a, b) => b.w * b.h - a.w * a.h);   // the outer ones below
    this.drawn = new Map(all.map((frame) => [frame.id, makeFrame(frame, this.looks.said(frame), this.looks.frame(frame), this.looks.sizes)]));
    const drawn = [...this.drawn.values()];
    this.below.replaceChildren(...drawn.map((one) => one.node));
    this.titles.replaceChildren(...drawn.map((one) => one.title));
    if (inside) /** @type {HTMLElement | null} */ (this.titles.querySelector(`[data-frame="${inside}"]`))?.focus();
  }

  /** @param {number} id */
  freshen(id) {
    const drawn = this.drawn.get(id), frame = store.frames.peek().get(id);
    if (!drawn || !frame) return;
    const said = this.looks.said(frame), kind = this.looks.frame(frame);
    sayFrame(drawn, frame, said);
    drawn.node.setAttribute("class", `frame ${frame.kind} ${kind}`);
    drawn.title.setAttribute("class", `title ${frame.kind} ${kind}`);
    drawn.title.setAttribute("aria-label", [frame.name, said].filter(Boolean).join(", "));
  }

  freshenAll() {
    for (const id of this.drawn.keys()) this.freshen(id);
  }

  /** Say for how long kernels have not answered. */
  sayKernels() {
    for (const [id, frame] of store.frames.peek()) if (frame.kind === "kernel" && this.looks.world.silent(frame.kernel)) this.freshen(id);
  }
}
