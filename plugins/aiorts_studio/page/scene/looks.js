/** How each thing is to be drawn now: its state, whether it is chosen, whether its kernel answers. */
import * as store from "../store.js";
import { boxSpoken, frameSaid, kernelSaid, kernelTrouble } from "../words.js";
import { sizesAt } from "./fonts.js";

/** @import {Box, Edge, Frame} from "../types.js" */

/** The height of a line of text, in parts of its size. */
const LINE = 1.2;

export class Looks {
  /** @param {import("./world.js").World} world */
  constructor(world) {
    this.world = world;
    this.sizes = sizesAt(1);
    /** The box that is in the tab order; it stays in the document wherever the view goes. @type {number | null} */
    this.focused = null;
  }

  /** @param {Box} box @returns {import("./box.js").Look} */
  box(box) {
    const { state, said } = this.world.figuresOf(box);
    return {
      state, said: said || (state === "error" ? box.error?.message ?? "" : ""), silent: this.world.silent(box.kernel), spoken: boxSpoken(box, state, said, store.kernels.peek().get(box.kernel)),
      chosen: this.world.chosen("box", box.id), port: box.ports.find(({ name }) => this.world.chosen("port", store.portId(box.id, name)))?.name ?? null, first: box.id === this.focused, sizes: this.sizes,
    };
  }

  /** @param {Edge} edge @returns {import("./edge.js").Look} */
  edge(edge) {
    const chosen = this.world.chosen("edge", edge.id);
    return {
      chosen, own: !chosen && this.world.own(edge), silent: this.world.silent(edge.kernel), crowded: this.world.crowded(edge),
      muted: this.world.muted(edge, this.sizes.text * LINE), size: this.sizes.text, room: this.world.roomOf(edge),
    };
  }

  /** What stands behind the name of a frame. @param {Frame} frame */
  said(frame) {
    const kernel = store.kernels.peek().get(frame.kernel);
    if (kernel && frame.kind === "kernel") return kernelTrouble(kernel, this.world.since(kernel)) || kernelSaid(kernel);
    return frameSaid(frame, store.frameFigures.peek().get(frame.id));
  }

  /** Its classes. @param {Frame} frame */
  frame(frame) {
    const chosen = store.selected.peek();
    return [this.world.silent(frame.kernel) && "silent", store.frameFigures.peek().get(frame.id)?.overruns && "late",
      chosen?.kind === "frame" && chosen.id === frame.id && "chosen"].filter(Boolean).join(" ");
  }
}
