/** Geometry of edges, which run along the axes. Plain numbers, no document. */

/** @import {Point} from "../types.js" */

/** A path through points, its corners rounded. @param {Point[]} points @param {number} [radius] */
export function rounded(points, radius = 8) {
  let path = `M${points[0]}`;
  for (let i = 1; i < points.length - 1; i++) {
    const [before, here, after] = [points[i - 1], points[i], points[i + 1]];
    path += `L${towards(here, before, radius)}Q${here} ${towards(here, after, radius)}`;
  }
  return `${path}L${points.at(-1)}`;
}

/** @param {Point} here @param {Point} there @param {number} radius @returns {Point} */
function towards(here, there, radius) {
  const length = Math.hypot(there[0] - here[0], there[1] - here[1]);
  const share = length && Math.min(radius, length / 2) / length;
  return [here[0] + (there[0] - here[0]) * share, here[1] + (there[1] - here[1]) * share];
}

/**
 * Where two paths that begin at one point part; null: at once, or never.
 * @param {Point[]} one @param {Point[]} other @returns {Point | null}
 */
export function parting(one, other) {
  let here = one[0];
  if (!same(here, other[0])) return null;
  for (let i = 1, j = 1; i < one.length && j < other.length;) {
    const [a, b] = [one[i], other[j]];
    if (direction(here, a) !== direction(here, b)) break;
    const nearer = distance(here, a) <= distance(here, b) ? a : b;
    if (same(nearer, a)) i++;
    if (same(nearer, b)) j++;
    here = nearer;
    if (i >= one.length && j >= other.length) return null;
  }
  return same(here, one[0]) ? null : here;
}

/** @param {Point} a @param {Point} b */
const same = (a, b) => a[0] === b[0] && a[1] === b[1];
/** @param {Point} a @param {Point} b */
const distance = (a, b) => Math.abs(a[0] - b[0]) + Math.abs(a[1] - b[1]);
/** @param {Point} a @param {Point} b */
const direction = (a, b) => `${Math.sign(b[0] - a[0])},${Math.sign(b[1] - a[1])}`;

/** How far a point is from a path. @param {Point[]} points @param {Point} point */
export function away(points, [x, y]) {
  let least = Infinity;
  for (let i = 1; i < points.length; i++) {
    const [[ax, ay], [bx, by]] = [points[i - 1], points[i]];
    const [left, right, top, bottom] = [Math.min(ax, bx), Math.max(ax, bx), Math.min(ay, by), Math.max(ay, by)];
    least = Math.min(least, Math.hypot(Math.max(left - x, 0, x - right), Math.max(top - y, 0, y - bottom)));
  }
  return least;
}

const MOST_CROSSINGS = 16;

/** Two strokes across the middle of the longest piece of a path. @param {Point[]} points @param {number} size @returns {[Point, Point][]} */
export function crossOn(points, size) {
  const pieces = points.slice(1).map((end, i) => /** @type {[Point, Point]} */ ([points[i], end]));
  const longest = pieces.reduce((best, one) => (lengthOf(one) > lengthOf(best) ? one : best), pieces[0]);
  const [x, y] = [(longest[0][0] + longest[1][0]) / 2, (longest[0][1] + longest[1][1]) / 2];
  return [[[x - size, y - size], [x + size, y + size]], [[x + size, y - size], [x - size, y + size]]];
}

/** @param {[Point, Point]} piece along an axis */
const lengthOf = ([[ax, ay], [bx, by]]) => Math.abs(ax - bx) + Math.abs(ay - by);

/**
 * Short pieces of a path around the points where it crosses others, to be drawn below it in the colour of the ground.
 * @param {Point[]} points @param {Iterable<Point[]>} others @param {number} [reach]
 * @returns {string} a path; "": there are none, or so many that drawing them costs more frames than they explain
 */
export function crossings(points, others, reach = 6) {
  let path = "", left = MOST_CROSSINGS;
  for (const other of others) {
    for (let i = 1; i < points.length; i++) {
      for (let j = 1; j < other.length; j++) {
        const found = crossing(points[i - 1], points[i], other[j - 1], other[j]);
        if (!found) continue;
        if (left-- === 0) return "";
        const [x, y] = found;
        path += points[i - 1][1] === points[i][1] ? `M${x - reach} ${y}H${x + reach}` : `M${x} ${y - reach}V${y + reach}`;
      }
    }
  }
  return path;
}

/** @param {Point} a @param {Point} b @param {Point} c @param {Point} d @returns {Point | null} where a to b crosses c to d, at a right angle and not at an end */
function crossing(a, b, c, d) {
  if ((a[1] === b[1]) === (c[1] === d[1])) return null;
  const [[x0, y], [x1], [x, y0], [, y1]] = a[1] === b[1] ? [a, b, c, d] : [c, d, a, b];
  const within = (/** @type {number} */ at, /** @type {number} */ one, /** @type {number} */ other) => at > Math.min(one, other) + 1 && at < Math.max(one, other) - 1;
  return within(x, x0, x1) && within(y, y0, y1) ? [x, y] : null;
}
