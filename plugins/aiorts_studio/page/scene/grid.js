/** Finds what is in a rectangle: things are filed under the cells which they touch. Plain data, no document. */

/** @import {Point} from "../types.js" */
/** @typedef {"boxes" | "edges"} Kind @typedef {{x0: number, y0: number, x1: number, y1: number}} Rect */

/** The side of a cell. */
export const CELL = 480;

export class Grid {
  constructor() {
    /** @type {Map<string, Record<Kind, Set<number>>>} */
    this.cells = new Map();
    /** @type {Record<Kind, Map<number, string[]>>} */
    this.filed = { boxes: new Map(), edges: new Map() };
  }

  /** File a thing under the cells of a path's legs; its place before is forgotten. @param {Kind} kind @param {number} id @param {Point[]} points */
  put(kind, id, points) {
    this.remove(kind, id);
    const keys = new Set();
    for (let i = 1; i < points.length; i++) for (const key of touched(points[i - 1], points[i])) keys.add(key);
    for (const key of keys) {
      const cell = this.cells.get(key) ?? { boxes: new Set(), edges: new Set() };
      cell[kind].add(id);
      this.cells.set(key, cell);
    }
    this.filed[kind].set(id, [...keys]);
  }

  /** @param {Kind} kind @param {number} id */
  remove(kind, id) {
    for (const key of this.filed[kind].get(id) ?? []) {
      const cell = this.cells.get(key);
      cell?.[kind].delete(id);
      if (cell && !cell.boxes.size && !cell.edges.size) this.cells.delete(key);
    }
    this.filed[kind].delete(id);
  }

  /** Other things of a kind in the cells of one. @param {Kind} kind @param {number} id @returns {Set<number>} */
  beside(kind, id) {
    const found = new Set((this.filed[kind].get(id) ?? []).flatMap((key) => [...(this.cells.get(key)?.[kind] ?? [])]));
    found.delete(id);
    return found;
  }

  /** The things in the cells that a rectangle touches. @param {Rect} rect @returns {Record<Kind, Set<number>>} */
  find({ x0, y0, x1, y1 }) {
    const found = { boxes: new Set(), edges: new Set() };
    for (const key of touched([x0, y0], [x1, y1])) {
      const cell = this.cells.get(key);
      for (const id of cell?.boxes ?? []) found.boxes.add(id);
      for (const id of cell?.edges ?? []) found.edges.add(id);
    }
    return found;
  }
}

/** The cells that a rectangle touches, as one word: while it is the same, the same things are found. @param {Rect} rect */
export function cellsOf({ x0, y0, x1, y1 }) {
  return [x0, y0, x1, y1].map((one) => Math.floor(one / CELL)).join();
}

/** @param {Point} one @param {Point} other */
function* touched(one, other) {
  const range = (/** @type {number} */ axis) => [one[axis], other[axis]].map((at) => Math.floor(at / CELL)).sort((a, b) => a - b);
  const [[left, right], [top, bottom]] = [range(0), range(1)];
  for (let column = left; column <= right; column++) for (let row = top; row <= bottom; row++) yield `${column},${row}`;
}
