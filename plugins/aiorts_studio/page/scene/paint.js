/** Draws everything on one canvas, for scales at which text in a box would be too small to read. */
import { letterOf, toneOf } from "../words.js";
import { cut } from "./fitting.js";
import { FAR_PORT, FAR_TEXT } from "./fonts.js";
import { crossOn } from "./paths.js";

/** @import {Box, Edge, EdgeFigures, Frame} from "../types.js" */
/** @typedef {{x: number, y: number, k: number}} View */
/** @typedef {{frames: Iterable<Frame>, boxes: Iterable<Box>, edges: Iterable<Edge>, row: (id: number) => EdgeFigures | undefined,
 *   state: (box: Box) => string, silent: (kernel: string) => boolean, chosen: (kind: "box" | "edge", id: number) => boolean, own: (edge: Edge) => boolean}} World */

/** Titles nearer to that of the frame around, in px, are left out. */
const FAR_LINE = 14;
/** The scale from which on rows of ports are high enough for text, and for how many boxes it is drawn. */
const PORTS = 0.46, MOST_WITH_PORTS = 150;
const COLOURS = ["edge", "busy", "lossy", "down", "box", "box-line", "lane", "line", "ink", "quiet", "accent", "on-state",
  "active", "inactive", "error", "created", "ended", "silent", "full", "kernel", "in", "out", "service"];
/** The strokes of edges: those drawn later lie above. Each has one path: 2,000 strokes of their own cost far more. */
const STROKES = /** @type {[string, string, number][]} */ ([["edge", "edge", 1.25], ["waiting", "edge", 1.25], ["link", "edge", 3], ["full", "full", 1.75], ["down", "down", 2], ["cross", "down", 2.25], ["lossy", "lossy", 2.25], ["chosen", "accent", 2.5]]);
/** Dashes of edges that lose samples, dots of those that are down, in px; the cross on the latter is as large each way. */
const DASHES = /** @type {Record<string, number[]>} */ ({ lossy: [6, 3], down: [1.5, 3.5] }), CROSS = 5;

/** @param {Element} host @returns {Record<string, string>} */
export function coloursOf(host) {
  const style = getComputedStyle(host);
  return Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {World} world @param {Record<string, string>} colours @param {number} ratio */
export function paint(context, { x, y, k }, world, colours, ratio) {
  const { width, height } = context.canvas;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  context.setTransform(k * ratio, 0, 0, k * ratio, x * ratio, y * ratio);
  for (const frame of world.frames) {
    context.beginPath();
    context.roundRect(frame.x, frame.y, frame.w, frame.h, 14);
    context.fillStyle = frame.kind === "kernel" || frame.kind === "host" ? colours.kernel : colours.lane;
    context.fill();
    context.lineWidth = 1 / k;
    context.strokeStyle = colours.line;
    context.stroke();
  }
  paintEdges(context, k, world, colours);
  const [left, top, right, bottom] = [-x / k, -y / k, (width / ratio - x) / k, (height / ratio - y) / k];
  const seen = [...world.boxes].filter((box) => box.x < right && box.y < bottom && box.x + box.w > left && box.y + box.h > top);
  for (const box of seen) paintBox(context, k, box, world, colours);
  // Text has its own size, whatever the scale is.
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = FAR_TEXT;
  context.textBaseline = "middle";
  for (const box of seen) {
    if (box.w * k >= 44 && box.h * k >= 18) paintName(context, { x, y, k }, box, world, colours);
  }
  if (k >= PORTS && seen.length <= MOST_WITH_PORTS) paintPorts(context, { x, y, k }, seen, world, colours);
  context.font = FAR_TEXT;
  context.textAlign = "left";
  const titles = /** @type {Map<number, number>} */ (new Map());
  for (const frame of [...world.frames].sort((a, b) => b.w * b.h - a.w * a.h)) {   // the outer ones first
    const at = y + frame.y * k + Math.max(8, 20 * k), around = titles.get(frame.parent ?? NaN) ?? -Infinity;
    if (frame.w * k < 60 || frame.h * k < 22 || at - around < FAR_LINE) continue;
    titles.set(frame.id, at);
    context.fillStyle = colours.quiet;
    context.fillText(cut(frame.name, frame.w * k - 16, FAR_TEXT), x + frame.x * k + 8, at);
  }
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Box} box @param {World} world @param {Record<string, string>} colours */
function paintName(context, { x, y, k }, box, world, colours) {
  const silent = world.silent(box.kernel), filled = letterOf(world.state(box)) === "E" && !silent;
  context.fillStyle = filled ? colours["on-state"] : silent ? colours.quiet : colours.ink;
  context.fillText(cut(box.name, box.w * k - 16, FAR_TEXT), x + box.x * k + 9, y + box.y * k + Math.max(11, Math.min(box.h * k / 2, 15)));
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Box[]} boxes @param {World} world @param {Record<string, string>} colours */
function paintPorts(context, { x, y, k }, boxes, world, colours) {
  context.font = FAR_PORT;
  for (const box of boxes) {
    const silent = world.silent(box.kernel), filled = letterOf(world.state(box)) === "E" && !silent;
    const left = x + box.x * k, right = left + box.w * k;
    for (const port of box.ports) {
      const at = y + (box.y + port.y) * k, first = port.side === "in";
      context.fillStyle = silent ? colours.silent : colours[port.kind === "service" ? "service" : port.side];
      context.fillRect((first ? left : right) - 2.5, at - 2.5, 5, 5);
      context.fillStyle = filled ? colours["on-state"] : silent ? colours.quiet : colours.ink;
      context.textAlign = first ? "left" : "right";
      const beside = box.ports.some((one) => one.side !== port.side && Math.abs(one.y - port.y) < 20);
      context.fillText(cut(port.name, box.w * k / (beside ? 2 : 1) - (beside ? 10 : 18), FAR_PORT), first ? left + 9 : right - 7, at + 0.5);
    }
  }
  context.textAlign = "left";
}

/** @param {CanvasRenderingContext2D} context @param {number} k @param {World} world @param {Record<string, string>} colours */
function paintEdges(context, k, world, colours) {
  const paths = new Map(STROKES.map(([tone]) => [tone, new Path2D()]));
  for (const edge of world.edges) {
    const tone = toneOf(edge, world.row(edge.id));
    const path = paths.get(world.own(edge) ? "chosen" : tone) ?? paths.get(edge.link ? "link" : "edge");
    path?.moveTo(...edge.points[0]);
    for (const point of edge.points) path?.lineTo(...point);
    if (edge.state !== "down") continue;
    for (const [from, to] of crossOn(edge.points, CROSS / k)) {
      paths.get("cross")?.moveTo(...from);
      paths.get("cross")?.lineTo(...to);
    }
  }
  for (const [tone, colour, width] of STROKES) {
    context.strokeStyle = colours[colour];
    context.lineWidth = width / k;
    context.setLineDash((DASHES[tone] ?? []).map((length) => length / k));
    context.stroke(/** @type {Path2D} */ (paths.get(tone)));
  }
  context.setLineDash([]);
}

/** @param {CanvasRenderingContext2D} context @param {number} k @param {Box} box @param {World} world @param {Record<string, string>} colours */
function paintBox(context, k, box, world, colours) {
  const state = world.state(box), chosen = world.chosen("box", box.id);
  context.beginPath();
  context.roundRect(box.x, box.y, box.w, box.h, 10);
  context.fillStyle = colours.box;
  context.fill();
  context.lineWidth = (chosen ? 2.5 : 1) / k;
  context.strokeStyle = chosen ? colours.accent : colours["box-line"];
  context.stroke();
  context.fillStyle = world.silent(box.kernel) ? colours.silent : colours[state] ?? colours.inactive;
  if (letterOf(state) === "E") context.fillRect(box.x, box.y, box.w, box.h);   // an error is seen from any distance
  else context.fillRect(box.x + 3 / k, box.y + 3 / k, 3 / k, Math.max(1, box.h - 6 / k));
}
