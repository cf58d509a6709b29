/** What is said of things: on the scene, to a screen reader, in tips. Pure. */

/** @import {Box, Edge, EdgeFigures, Frame, FrameFigures, Kernel} from "./types.js" */

/** Three digits that do not flicker in width: 64.0, not 64 between 63.9 and 64.1. @param {number} value */
export function number(value) {
  if (Math.abs(value) >= 10000) return `${(value / 1000).toFixed(1)} k`;
  return value && Math.abs(value) < 100 ? value.toPrecision(3) : String(Math.round(value));
}

/** @param {number} value */
export const count = (value) => Math.round(value).toLocaleString("en");

/** Seconds, as short as a person says them. @param {number} value */
export function seconds(value) {
  if (value < 60) return `${Math.floor(value)} s`;
  return value < 3600 ? `${Math.floor(value / 60)} min` : `${Math.floor(value / 3600)} h`;
}

/** The letter of each state on its badge; the colour says the same. */
const LETTERS = /** @type {Record<string, string>} */ ({ created: "C", inactive: "I", active: "A", error: "E", ended: "X" });

/** @param {string} state */
export const letterOf = (state) => LETTERS[state] ?? (state[0] ?? "?").toUpperCase();

/** @param {Edge} edge @param {Map<number, Box>} boxes @returns {[string, string]} its ports, "component.port" */
export function endsOf(edge, boxes) {
  const end = (/** @type {[number, string]} */ [id, port]) => (port ? `${boxes.get(id)?.name ?? "?"}.${port}` : boxes.get(id)?.name ?? "?");
  return [end(edge.from), end(edge.to)];
}

/** @typedef {"" | "busy" | "idle" | "full" | "lossy" | "down" | "waiting"} Tone */

/** A buffer of fewer samples is full in most cycles, and nothing is wrong. */
const LARGE = 4;

/** How an edge fares, from its worst to its best. @param {Edge} edge @param {EdgeFigures | undefined} row @returns {Tone} */
export function toneOf(edge, row) {
  if (edge.state !== "up") return edge.state;
  if (row?.lossy) return "lossy";
  if (!row || row.rate === null) return "";
  const room = capacityOf(edge);
  if (room >= LARGE && row.backlog >= 0.8 * room) return "full";
  return row.rate ? "busy" : "idle";
}

/** How many samples an edge holds; Infinity: not known. @param {Edge} edge */
export const capacityOf = (edge) => Number(/(\d+) long/.exec(edge.policy)?.[1] ?? Infinity);

/** The reasons of drops that options ask for: what is left out is not lost. The server has the same. */
const LEFT_OUT = new Set(["skipped", "superseded"]);

/** How many samples were lost, and how many left out, by the reason. @param {Record<string, number> | null} dropped @returns {{lost: [string, number][], leftOut: [string, number][]}} */
export function reasonsOf(dropped) {
  const all = Object.entries(dropped ?? {}).filter(([, times]) => times > 0);
  return { lost: all.filter(([reason]) => !LEFT_OUT.has(reason)), leftOut: all.filter(([reason]) => LEFT_OUT.has(reason)) };
}

/**
 * The two parts of an edge's label: what passes, and what does not; in as many words as have room.
 * @param {Edge} edge @param {EdgeFigures | undefined} row @param {boolean} crowded both stand on one line
 * @param {(text: string) => boolean} fits
 * @returns {[string, string]}
 */
export function labelOf(edge, row, crowded, fits) {
  if (edge.state !== "up") return [edge.state, ""];
  if (!row) return ["", ""];
  const rate = row.rate === null ? "" : `${number(row.rate)} Hz`, trip = row.trip === null ? "" : `⇄ ${number(row.trip)} ms`;
  const firsts = [[rate, trip].filter(Boolean).join(" · "), rate, ""];
  const seconds = row.dropped ? [`${count(row.dropped)} lost`, `${short(row.dropped)} lost`, `-${short(row.dropped)}`]
    : row.backlog ? [`${count(row.backlog)} waiting`, `${short(row.backlog)} waiting`, ""] : [""];
  if (!crowded) return [firsts.find(fits) ?? "", seconds.find(fits) ?? ""];
  const pairs = seconds.flatMap((second) => firsts.map((first) => /** @type {[string, string]} */ ([first, second])));
  return pairs.find((pair) => fits(pair.filter(Boolean).join("  "))) ?? ["", ""];
}

/** A count in few digits. @param {number} value @returns {string} */
const short = (value) => (value < 1000 ? String(value) : value < 1e6 ? `${few(value / 1e3)}k` : `${few(value / 1e6)}M`);
/** @param {number} value */
const few = (value) => (value < 9.95 ? value.toFixed(1) : String(Math.round(value)));

const TONES = ["", "idle", "busy", "full", "waiting", "lossy", "down"];

/** How much the label of an edge matters, where there is no room for all: first how it fares, then how much passes. @param {Edge} edge @param {EdgeFigures | undefined} row */
export const weightOf = (edge, row) => TONES.indexOf(toneOf(edge, row)) * 1e12 + Math.min(1e12, (row?.dropped ?? 0) * 1e3 + (row?.rate ?? 0));

/** A number of things. @param {number} value @param {string} one @param {string} [many] */
export const counted = (value, one, many = `${one}s`) => `${count(value)} ${value === 1 ? one : many}`;

/** All that is known of an edge, line by line. @param {Edge} edge @param {EdgeFigures | undefined} row @returns {string[]} */
export function edgeLines(edge, row) {
  const lines = [edge.policy, edge.link ? "link between two processes" : "", edge.bundle > 1 ? `${edge.bundle} connectors` : ""];
  if (edge.state !== "up") lines.push(edge.why || (edge.state === "down" ? "the connection is down" : "waits for the other end"));
  if (row && row.rate !== null) lines.push(`${number(row.rate)} samples/s arrive`);
  if (row?.dropped) lines.push(`${count(row.dropped)} lost${row.loss ? `, ${number(row.loss)}/s now` : ""}`);
  for (const [why, times] of reasonsOf(row?.reasons ?? null).lost) lines.push(`  ${count(times)} ${why.replaceAll("_", " ")}`);
  if (row?.backlog) {
    const room = capacityOf(edge);
    lines.push(`${count(row.backlog)}${Number.isFinite(room) ? ` of ${room}` : ""} wait for the reader`);
  }
  if (row && row.age !== null) lines.push(`${number(row.age)} ms old when read`);
  if (row && row.trip !== null) lines.push(`${number(row.trip)} ms round trip, of which up to 50 ms an acknowledgement may be kept back`);
  return lines.filter(Boolean);
}

/** What a screen reader says of an edge; without figures that change at each moment. @param {Edge} edge @param {Map<number, Box>} boxes @param {Tone} tone */
export function edgeSpoken(edge, boxes, tone) {
  const trouble = { lossy: "loses samples", full: "nearly full", down: "down", waiting: "waits for the other end" };
  return [endsOf(edge, boxes).join(" to "), edge.link ? "link" : "", edge.policy, trouble[/** @type {"lossy"} */ (tone)] ?? ""].filter(Boolean).join(", ");
}

/** @param {Box["ports"][number]} port */
export const portKind = (port) => (port.kind === "service" ? (port.side === "in" ? "required service" : "provided service") : `${port.side}-port`);

/** @param {Box["ports"][number]} port */
export function portSpoken(port) {
  return [port.name, portKind(port), port.type, port.unit].filter(Boolean).join(", ");
}

/** What a screen reader says of a box. @param {Box} box @param {string} state @param {string} said @param {Kernel | undefined} kernel */
export function boxSpoken(box, state, said, kernel) {
  const silent = !kernel || kernel.state === "live" ? "" : kernel.state === "silent" ? "its kernel does not answer" : `its kernel ${kernel.why}`;
  return [box.name, box.type, state, said, box.error?.message ?? "", silent].filter(Boolean).join(", ");
}

/**
 * What stands behind the name of a frame.
 * @param {Frame} frame @param {FrameFigures | undefined} row @returns {string}
 */
export function frameSaid(frame, row) {
  const late = !row?.late ? "" : `p99 ${number(row.late)} ms late`;
  const overruns = row?.overruns ? `${counted(row.overruns, "overrun")}${row.who ? `, most by ${row.who.split(":")[0]}` : ""}` : "";
  return [frame.said, late, overruns].filter(Boolean).join("  ·  ");
}

/** What is said of a kernel that is not live; "" of one that is. @param {Kernel} kernel @param {number} since seconds */
export function kernelTrouble(kernel, since) {
  if (kernel.state === "live") return "";
  return kernel.state === "silent" ? `no answer for ${seconds(since)}` : kernel.why;
}

/** Whether a kernel has ended as a run ends, and nothing is wrong. @param {Kernel} kernel */
export const hasEnded = (kernel) => kernel.state === "ended" && /^has ended( with status 0)?$/.test(kernel.why);

/** Where a kernel runs. @param {Kernel} kernel */
export function kernelSaid(kernel) {
  const trip = kernel.round_trip_ms === null ? "" : `${number(kernel.round_trip_ms)} ms round trip`;
  return [`process ${kernel.pid} on ${kernel.host}`, kernel.simulated ? "simulated time" : "", trip].filter(Boolean).join("  ·  ");
}
