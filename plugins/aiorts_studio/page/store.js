/**
 * All that the page knows, as signals. Messages of the server come in by `take` alone; panels read the signals, the
 * scene takes messages by `on` after the store has taken them. What the page says to the server goes out by `say`.
 */
import { batch, computed, signal } from "./vendor/preact-signals.js";

/** @import {Box, Change, Edge, EdgeFigures, Figures, Frame, FrameFigures, Kernel, Message, Picture, Selection, Total, Answer} from "./types.js" */
/** @template T @typedef {import("./vendor/preact-signals.js").Signal<T>} Signal */

/** The kernels by address. */
export const kernels = signal(/** @type {Map<string, Kernel>} */ (new Map()));
/** Things of the scene by id. */
export const frames = signal(/** @type {Map<number, Frame>} */ (new Map()));
export const boxes = signal(/** @type {Map<number, Box>} */ (new Map()));
export const edges = signal(/** @type {Map<number, Edge>} */ (new Map()));
/** Figures of edges by id; those out of the view keep their last ones. */
export const figures = signal(/** @type {Map<number, EdgeFigures>} */ (new Map()));
/** State and what is said of it, of boxes by id, where it differs from the box's own. */
export const boxFigures = signal(/** @type {Map<number, {state: string, said: string}>} */ (new Map()));
export const frameFigures = signal(/** @type {Map<number, FrameFigures>} */ (new Map()));
/** Kernels as a whole, by the id of their frame. */
export const totals = signal(/** @type {Map<number, Total>} */ (new Map()));
/** The times to which the figures belong, in ns, by the kernel's address. */
export const at = signal(/** @type {Record<string, number>} */ ({}));

export const selected = signal(/** @type {Selection | null} */ (null));
/** "view" or "operate"; "" before the server has said it. */
export const right = signal("");
/** Whether the server was given a folder to write recordings to. */
export const files = signal(false);
/** What helps a reader that is too slow, the best first, in words and as it is written; and what a longer buffer helps. */
export const cures = signal(/** @type {[string, string][]} */ ([]));
export const bursts = signal("");
/** Messages that this page was too slow for, since it was opened. */
export const missed = signal(0);
/** "closed" before sign-in, "opening", "live", "lost" (it tries again), "ended". */
export const connection = signal("closed");
export const theme = signal("light");
/** Whether components of the infrastructure are shown. */
export const infrastructure = signal(true);
/** What the search of the tree seeks. */
export const sought = signal("");
/** Whether the list of keys is open. */
export const keysOpen = signal(false);
/** The last thing that was said to the user; it is shown for some seconds, and read aloud. */
export const notice = signal("");

/** Whether the selected thing's id is there still. */
export const selection = computed(() => {
  const one = selected.value;
  if (!one) return null;
  if (one.kind === "port") {
    const port = portOf(one.id, boxes.value);
    return port && { kind: one.kind, thing: port };
  }
  const found = places[one.kind].value.get(/** @type {never} */ (one.id));
  return found ? { kind: one.kind, thing: found } : null;
});

/** The id of a port. @param {number} box @param {string} name */
export const portId = (box, name) => `${box}.${name}`;

/** The box that has a port, and the port; null: it is not there. @param {number | string} id of the port @param {Map<number, Box>} all */
export function portOf(id, all) {
  const [, number, name] = /^(\d+)\.(.*)$/s.exec(String(id)) ?? [], box = all.get(Number(number)), port = box?.ports.find((one) => one.name === name);
  return box && port ? { box, port } : null;
}

const places = { box: boxes, edge: edges, frame: frames, kernel: kernels };

// -- out ---------------------------------------------------------------------------------------------------------------

/** @type {(message: object) => boolean} */
let sending = () => false;

/** The way out is the socket of `connection.js`. @param {(message: object) => boolean} way */
export function sendBy(way) {
  sending = way;
}

/** Say something to the server; false: there is no connection. @param {object} message */
export function say(message) {
  return sending(message);
}

const ASK_SECONDS = 30;
let asked = 0;
/** @type {Map<number, {done: (value: any) => void, failed: (error: Error) => void, timer: number}>} */
const waiting = new Map();

/** A call that the server or the kernel has refused. */
export class Refused extends Error {
  /** @param {string} code @param {string} text */
  constructor(code, text) {
    super(text);
    this.code = code;
  }
}

/**
 * Call an operation of a kernel. Rejects with `Refused`.
 * @param {string} kernel its address @param {string} operation @param {object} [args]
 * @returns {Promise<any>}
 */
export function ask(kernel, operation, args = {}) {
  const id = ++asked;
  return new Promise((done, failed) => {
    const timer = window.setTimeout(() => {
      waiting.delete(id);
      failed(new Refused("E-NO-ANSWER", `no answer within ${ASK_SECONDS} s`));
    }, ASK_SECONDS * 1000);
    waiting.set(id, { done, failed, timer });
    if (!say({ t: "ask", id, kernel, operation, arguments: args })) settle(id, { code: "E-CLOSED", text: "the server is not there" });
  });
}

/** @param {number} id @param {{code: string, text: string} | undefined} problem @param {any} [value] */
function settle(id, problem, value) {
  const call = waiting.get(id);
  if (!call) return;
  waiting.delete(id);
  window.clearTimeout(call.timer);
  if (problem) call.failed(new Refused(problem.code, problem.text));
  else call.done(value);
}

/** Refuse the calls that have no answer: their connection is gone. */
export function dropCalls() {
  for (const id of [...waiting.keys()]) settle(id, { code: "E-CLOSED", text: "the connection to the server was lost" });
}

/** Tell the user something short. @param {string} text */
export function tell(text) {
  notice.value = "";
  notice.value = text;
}

// -- in ----------------------------------------------------------------------------------------------------------------

/** @type {Map<string, Set<(message: any) => void>>} */
const takers = new Map();

/**
 * Be called with each message of a kind, after the store has taken it; "choose" is called with `{focus}`.
 * @param {string} kind @param {(message: any) => void} taker @returns {() => void} ends it
 */
export function on(kind, taker) {
  const all = takers.get(kind) ?? new Set();
  takers.set(kind, all.add(taker));
  return () => all.delete(taker);
}

/** @param {string} kind @param {any} message */
function pass(kind, message) {
  for (const taker of takers.get(kind) ?? []) taker(message);
}

/**
 * Select a thing, and bring it into view.
 * @param {Selection["kind"]} kind @param {number | string} id @param {{focus?: boolean}} [how] focus: give it the focus, too
 */
export function choose(kind, id, how = {}) {
  selected.value = { kind, id };
  pass("choose", how);
}

export function chooseNothing() {
  selected.value = null;
  pass("choose", {});
}

/** Take a message of the server. @param {Message} message */
export function take(message) {
  const kind = message.t;
  batch(() => {
    if (kind === "hello") {
      right.value = message.right;
      files.value = message.files;
      cures.value = message.cures;
      bursts.value = message.bursts;
    } else if (kind === "picture") takePicture(message);
    else if (kind === "change") takeChange(message);
    else if (kind === "figures") takeFigures(message);
    else if (kind === "answer") settle(message.id, message.problem, message.value);
  });
  pass(kind, message);
}

/** @param {Picture} message */
function takePicture(message) {
  missed.value += message.missed ?? 0;
  kernels.value = new Map(message.kernels.map((one) => [one.address, one]));
  frames.value = new Map(message.frames.map((one) => [one.id, one]));
  boxes.value = new Map(message.boxes.map((one) => [one.id, one]));
  edges.value = new Map(message.edges.map((one) => [one.id, one]));
  figures.value = new Map();
  boxFigures.value = new Map();
  frameFigures.value = new Map();
  totals.value = new Map();
}

/** @param {Change} message */
function takeChange({ gone = {}, ...news }) {
  const named = (news.kernels ?? []).map((one) => /** @type {const} */ ([one.address, one]));
  const absent = [...kernels.value.values()].filter((one) => gone.kernels?.some((name) => name === one.name || name === one.address));
  merge(kernels, absent.map((one) => one.address), named);
  merge(frames, gone.frames, (news.frames ?? []).map((one) => [one.id, one]));
  merge(boxes, gone.boxes, (news.boxes ?? []).map((one) => [one.id, one]));
  merge(edges, gone.edges, (news.edges ?? []).map((one) => [one.id, one]));
  merge(figures, gone.edges, []);
  merge(frameFigures, gone.frames, []);
  merge(totals, gone.frames, []);
  merge(boxFigures, [...(gone.boxes ?? []), ...(news.boxes ?? []).map((one) => one.id)], []);
}

/**
 * @template K, V
 * @param {Signal<Map<K, V>>} place @param {K[] | undefined} gone @param {(readonly [K, V])[]} news
 */
function merge(place, gone, news) {
  if (!gone?.length && !news.length) return;
  const merged = new Map(place.value);
  for (const key of gone ?? []) merged.delete(key);
  for (const [key, value] of news) merged.set(key, value);
  place.value = merged;
}

/** @param {Figures} message */
function takeFigures({ at: times = {}, e = {}, b = {}, f = {}, k = {} }) {
  at.value = { ...at.value, ...times };
  merge(figures, [], Object.entries(e).map(([id, row]) => [Number(id), edgeFigures(row, figures.value.get(Number(id)))]));
  merge(boxFigures, [], Object.entries(b).map(([id, [state, said = ""]]) => [Number(id), { state, said }]));
  merge(frameFigures, [], Object.entries(f).map(([id, [late, overruns = 0, who = ""]]) => [Number(id), { late, overruns, who }]));
  merge(totals, [], Object.entries(k).map(([id, [components, connectors, rate, dropped, failed, lossy]]) => [Number(id), { components, connectors, rate, dropped, failed, lossy }]));
}

const NONE = { rate: null, dropped: 0, backlog: 0, loss: 0, reasons: null, age: null, trip: null, lossy: false };

/** @param {any[]} row @param {EdgeFigures | undefined} before @returns {EdgeFigures} */
function edgeFigures(row, before = NONE) {
  if (row.length === 1) return { ...before, lossy: Boolean(row[0]) };
  const [rate, dropped, backlog, loss, reasons, age, trip] = row;
  return { rate, dropped, backlog, loss: loss ?? 0, reasons, age: age ?? null, trip: trip ?? null, lossy: dropped > 0 };
}

/** How often the time is said for which kernels have not answered, in ms: one count for all that say it. */
const COUNT_MS = 1000;
let countedAt = performance.now();

setInterval(() => {
  const now = performance.now(), passed = (now - countedAt) / 1000;
  countedAt = now;
  merge(kernels, [], [...kernels.peek().values()].filter((one) => one.state === "silent").map((one) => [one.address, { ...one, since_s: one.since_s + passed }]));
}, COUNT_MS);
