/** What the scene has to know of things beyond what is drawn of each: neighbours of edges, silent kernels. */
import * as store from "../store.js";
import { weightOf } from "../words.js";
import { parting } from "./paths.js";

/** @import {Box, Edge, Kernel, Point} from "../types.js" */

/** The height of a row of ports: labels of two edges this near share a line. */
const ROW = 26;
/** What a label takes at most, where no box is before it. */
const LABEL = 220;
/** The height of both lines of a label, above and below its edge. */
const LINES = 24;

/** Whether a box only records or shows. One that carries does more: without it two boxes would look as if nothing joined them. @param {Box} box */
export const onlyLooks = (box) => box.infrastructure && box.type !== "FlexiFilter";

export class World {
  /** @param {import("./grid.js").Grid} grid where boxes are found */
  constructor(grid) {
    this.grid = grid;
    /** Edges by the port from which they come, or to which they go. @type {Map<string, Edge[]>} */
    this.byPort = new Map();
    /** @type {Map<number, Edge[]>} */
    this.byBox = new Map();
    /** @type {Set<string>} */
    this.quiet = new Set();
    /** When each kernel's state was heard of. @type {WeakMap<Kernel, number>} */
    this.heard = new WeakMap();
  }

  // -- for the canvas --------------------------------------------------------------------------------------------------

  get frames() { return store.frames.peek().values(); }
  get boxes() { return this.shown(store.boxes.peek().values(), (one) => this.hidden(one)); }
  get edges() { return this.shown(store.edges.peek().values(), (one) => this.hiddenEdge(one)); }
  row = (/** @type {number} */ id) => store.figures.peek().get(id);
  state = (/** @type {Box} */ box) => this.figuresOf(box).state;
  silent = (/** @type {string} */ kernel) => this.quiet.has(kernel);
  chosen = (/** @type {import("../types.js").Selection["kind"]} */ kind, /** @type {number | string} */ id) => {
    const one = store.selected.peek();
    return one?.kind === kind && one.id === id;
  };

  own = (/** @type {Edge} */ edge) => {
    const one = store.selected.peek();
    if (one?.kind === "port") return [edge.from, edge.to].some((end) => store.portId(...end) === one.id);
    return one?.kind === "edge" ? one.id === edge.id : one?.kind === "box" && (edge.from[0] === one.id || edge.to[0] === one.id);
  };

  /** All things, or those that the user has not hidden. @template T @param {Iterable<T>} things @param {(thing: T) => boolean} hidden @returns {Iterable<T>} */
  shown(things, hidden) {
    return store.infrastructure.peek() ? things : [...things].filter((one) => !hidden(one));
  }

  /** Whether a box is hidden. @param {Box | undefined} box */
  hidden = (box) => Boolean(box && onlyLooks(box)) && !store.infrastructure.peek() && store.portOf(store.selected.peek()?.id ?? "", store.boxes.peek())?.box !== box && !this.chosen("box", box?.id ?? 0);
  hiddenEdge = (/** @type {Edge} */ edge) => [edge.from, edge.to].some(([id]) => this.hidden(store.boxes.peek().get(id)));

  /** @param {Box} box */
  figuresOf(box) {
    return store.boxFigures.peek().get(box.id) ?? { state: box.state, said: box.said };
  }

  // -- kernels ---------------------------------------------------------------------------------------------------------

  /** @param {Map<string, Kernel>} kernels */
  takeKernels(kernels) {
    this.quiet = new Set([...kernels.values()].filter((one) => one.state !== "live").map((one) => one.address));
    for (const one of kernels.values()) if (!this.heard.has(one)) this.heard.set(one, performance.now());
  }

  /** For how many seconds a kernel has been as it is. @param {Kernel} kernel */
  since(kernel) {
    return kernel.since_s + (performance.now() - (this.heard.get(kernel) ?? performance.now())) / 1000;
  }

  // -- edges -----------------------------------------------------------------------------------------------------------

  /** Take all edges; the ids of those at whose ends something is different. @param {Map<number, Edge>} edges @returns {Set<number>} */
  takeEdges(edges) {
    const before = this.byPort;
    this.byPort = new Map();
    this.byBox = new Map();
    for (const edge of edges.values()) {
      for (const key of [keyOf("from", edge), keyOf("to", edge)]) this.byPort.set(key, [...(this.byPort.get(key) ?? []), edge]);
      for (const id of new Set([edge.from[0], edge.to[0]])) this.byBox.set(id, [...(this.byBox.get(id) ?? []), edge]);
    }
    const touched = new Set();
    for (const [key, group] of this.byPort) {
      const old = before.get(key) ?? [];
      if (old.length !== group.length || group.some((one, i) => one !== old[i])) for (const one of group) touched.add(one.id);
    }
    return touched;
  }

  /** Where an edge parts from another of its port, or joins one: the points at which it has a dot. @param {Edge} edge @returns {Point[]} */
  jointsOf(edge) {
    const found = new Map();
    for (const side of /** @type {const} */ (["from", "to"])) {
      const path = side === "from" ? edge.points : edge.points.toReversed();
      for (const other of (this.byPort.get(keyOf(side, edge)) ?? []).slice(0, 40)) {
        const point = other === edge ? null : parting(path, side === "from" ? other.points : other.points.toReversed());
        if (point) found.set(String(point), point);
      }
    }
    return [...found.values()];
  }

  /** Whether another label stands right below that of an edge. @param {Edge} edge */
  crowded(edge) {
    return this.labelled(edge).some((one) => one.label[1] > edge.label[1] && this.near(one, edge, ROW));
  }

  /**
   * Whether the label of an edge gives way to one beside it that matters more.
   * @param {Edge} edge @param {number} line the height that a label on one line takes
   */
  muted(edge, line) {
    const into = this.labelled(edge).filter((one) => this.near(one, edge, 6 * line));
    if (into.length < 2) return false;
    const weight = (/** @type {Edge} */ one) => (this.own(one) ? Infinity : weightOf(one, this.row(one.id)));
    const order = into.sort((a, b) => weight(b) - weight(a) || a.label[1] - b.label[1] || a.id - b.id), kept = /** @type {Edge[]} */ ([]);
    for (const one of order) if (!kept.some((other) => this.near(one, other, line))) kept.push(one);
    return !kept.includes(edge);
  }

  /** The room for a label: to the next box before it. @param {Edge} edge */
  roomOf({ label: [x, y] }) {
    let room = LABEL;
    for (const id of this.grid.find({ x0: x - LABEL, y0: y - LINES, x1: x, y1: y + LINES }).boxes) {
      const box = store.boxes.peek().get(id);
      if (box && box.y < y + LINES && box.y + box.h > y - LINES && box.x < x) room = Math.min(room, x - box.x - box.w - 6);
    }
    return room;
  }

  /** The edges whose labels stand at the box where that of an edge stands. @param {Edge} edge */
  labelled(edge) {
    return (this.byBox.get(edge.to[0]) ?? []).filter((one) => one.to[0] === edge.to[0] && !this.hiddenEdge(one));
  }

  /** @param {Edge} one @param {Edge} other @param {number} height */
  near = (one, other, height) => Math.abs(one.label[0] - other.label[0]) < LABEL / 2 && Math.abs(one.label[1] - other.label[1]) < height;

  /** The edges of a box. @param {number} id */
  edgesOf(id) {
    return this.byBox.get(id) ?? [];
  }
}

/** @param {"from" | "to"} side @param {Edge} edge */
const keyOf = (side, edge) => `${side} ${edge[side].join(".")}`;
