/**
 * The system by keyboard. One box is in the tab order; from it the arrows go along edges, into its ports, and out to the
 * frames around it. A live region says what the
 * ear needs and the focus alone does not tell.
 */
import { commandsOf, copy } from "./commands.js";
import { nudge } from "./scene/drag.js";
import { folds } from "./scene/frame.js";
import { flipTheme, turnTab } from "./shell.js";
import { boxes, choose, chooseNothing, edges, frames, infrastructure, keysOpen, portId, portOf, say, selected, sought, tell } from "./store.js";
import { endsOf } from "./words.js";

/** @import {Box, Edge, Frame, Selection} from "./types.js" */
/** @import {Scene} from "./scene/scene.js" */

/** All keys, in the order in which they are listed. */
export const KEYS = [
  { keys: "→ ←", does: "along an edge: to the reader, to the writer" },
  { keys: "↑ ↓", does: "to the next box or edge of the same side" },
  { keys: "Shift + → ←", does: "to the edge itself; → and ← then go to its ends" },
  { keys: "Shift + ↓ ↑", does: "inwards: to the ports of a box, or into a frame; and outwards" },
  { keys: "Home End", does: "to the first and the last box" },
  { keys: "Enter", does: "select; fold or unfold what folds" },
  { keys: "Alt + arrows", does: "move the box" },
  { keys: "/", does: "search" },
  { keys: "c", does: "copy the command that shows the selected thing" },
  { keys: "+ − 0", does: "zoom in, zoom out, fit" },
  { keys: "t", does: "tidy: lay out everything anew" },
  { keys: "l e p", does: "open or close log, events, plots" },
  { keys: "d", does: "dark or light" },
  { keys: "h", does: "hide or show infrastructure" },
  { keys: "?", does: "show these keys" },
  { keys: "Esc", does: "close, clear the search, or select nothing" },
];

const STEP = 16;
const MOVES = /** @type {Record<string, [number, number]>} */ ({ ArrowRight: [STEP, 0], ArrowLeft: [-STEP, 0], ArrowUp: [0, -STEP], ArrowDown: [0, STEP] });

/** @param {Scene} scene @param {import("./scene/view.js").Moves} view @param {(text: string) => void} hear says a text to a screen reader */
export function walk(scene, view, hear) {
  /** The things among which ↑ and ↓ choose, as the last step found them. @type {{kind: Selection["kind"], ids: Selection["id"][]}} */
  let side = { kind: "box", ids: [] };

  /** @param {Selection["kind"]} kind @param {Selection["id"][]} ids @param {number} at @param {string} words */
  function enter(kind, ids, at, words) {
    side = { kind, ids };
    choose(kind, ids[at], { focus: true });
    hear(ids.length > 1 ? `${at + 1} of ${ids.length} ${words}` : "");
  }

  /** @param {Box} box @param {boolean} forwards @param {boolean} toEdge */
  function step(box, forwards, toEdge) {
    const [here, there] = forwards ? /** @type {const} */ (["from", "to"]) : /** @type {const} */ (["to", "from"]);
    const found = scene.world.edgesOf(box.id).filter((one) => one[here][0] === box.id).sort((a, b) => a.label[1] - b.label[1]);
    if (!found.length) return hear(`${box.name} ${forwards ? "writes to no component" : "reads from no component"}`);
    const words = `that ${box.name} ${forwards ? "writes to" : "reads from"}`;
    if (toEdge) return enter("edge", found.map((one) => one.id), 0, `edges of ${box.name}`);
    return enter("box", [...new Set(found.map((one) => one[there][0]))], 0, words);
  }

  /** @param {Selection["kind"]} kind @param {Selection["id"]} id @param {number} by @param {() => Selection["id"][]} beside those among which it is, where no step has led there */
  function turn(kind, id, by, beside) {
    if (side.kind !== kind || side.ids.length < 2 || !side.ids.includes(id)) side = { kind, ids: beside() };
    const { ids } = side, at = (ids.indexOf(id) + by + ids.length) % ids.length;
    enter(kind, ids, at, "");
  }

  /** @param {Box} box */
  const intoPorts = (box) => {
    const ids = portsOf(box);
    if (ids.length) enter("port", ids, 0, `ports of ${box.name}`);
    else hear(`${box.name} has no ports`);
  };

  /** Along an edge of a port, or to the other side of its box. @param {Box} box @param {Box["ports"][number]} port @param {boolean} forwards */
  function stepFromPort(box, port, forwards) {
    const outward = forwards === (port.side === "out"), [here, there] = forwards ? /** @type {const} */ (["from", "to"]) : /** @type {const} */ (["to", "from"]);
    if (!outward) {
      const ids = portsOf(box, forwards ? "out" : "in");
      return ids.length ? enter("port", ids, 0, `ports of ${box.name}`) : hear(`${box.name} has no ports at that side`);
    }
    const ends = scene.world.edgesOf(box.id).filter((one) => portId(...one[here]) === portId(box.id, port.name)).sort((a, b) => a.label[1] - b.label[1]).map((one) => one[there]);
    if (!ends.length) return hear(`${port.name} is not connected`);
    if (boxes.value.get(ends[0][0])?.kind === "folded") return enter("box", [ends[0][0]], 0, "");
    return enter("port", ends.map((one) => portId(...one)), 0, `ports connected to ${port.name}`);
  }

  /** @param {Frame} frame */
  const intoFrame = (frame) => {
    const inner = framesIn(frame.id);
    if (inner.length) return enter("frame", inner, 0, "frames in it");
    const ids = inOrder([...boxes.value.values()].filter((one) => one.around === frame.id));
    return ids.length ? enter("box", ids, 0, "components in it") : undefined;
  };

  /** @param {number | null} id of a frame */
  const outTo = (id) => (id === null || !frames.value.has(id) ? hear("nothing is around it") : choose("frame", id, { focus: true }));

  /** @param {Edge} edge @param {"from" | "to"} end */
  const toEnd = (edge, end) => choose("box", edge[end][0], { focus: true });

  /** @param {number} at 0 or -1 */
  function toFirst(at) {
    const ids = inOrder([...boxes.value.values()]);
    if (ids.length) choose("box", /** @type {number} */ (ids.at(at)), { focus: true });
  }

  /** @param {KeyboardEvent} event @param {Element} target @returns {Record<string, () => void>} */
  function does(event, target) {
    const box = boxes.value.get(Number(target.closest(".box")?.getAttribute("data-box") ?? NaN));
    const edge = edges.value.get(Number(target.closest(".edge-of")?.getAttribute("data-edge") ?? NaN));
    const fold = target.closest("[data-fold]");
    if (fold) return { Enter: () => toggleFold(Number(fold.getAttribute("data-fold"))), " ": () => toggleFold(Number(fold.getAttribute("data-fold"))) };
    if (box && event.altKey) return Object.fromEntries(Object.entries(MOVES).map(([key, by]) => [key, () => nudge(box.id, ...by)]));
    if (event.altKey) return {};
    const port = box && portOf(portId(box.id, target.getAttribute("data-port") ?? ""), boxes.value)?.port;
    if (box && port) {
      const id = portId(box.id, port.name), beside = () => portsOf(box);
      return {
        ArrowRight: () => stepFromPort(box, port, true), ArrowLeft: () => stepFromPort(box, port, false),
        ArrowDown: () => !event.shiftKey && turn("port", id, 1, beside), Enter: () => choose("port", id, { focus: true }),
        ArrowUp: () => (event.shiftKey ? choose("box", box.id, { focus: true }) : turn("port", id, -1, beside)),
      };
    }
    if (box && event.shiftKey && box.kind !== "folded" && event.key === "ArrowDown") return { ArrowDown: () => intoPorts(box) };
    if (box && event.shiftKey && event.key === "ArrowUp") return { ArrowUp: () => outTo(box.around) };
    if (box) {
      const beside = () => neighbours(box.id);
      return {
        ArrowRight: () => step(box, true, event.shiftKey), ArrowLeft: () => step(box, false, event.shiftKey),
        ArrowDown: () => turn("box", box.id, 1, beside), ArrowUp: () => turn("box", box.id, -1, beside), Home: () => toFirst(0), End: () => toFirst(-1),
        Enter: () => (box.kind === "folded" ? unfold(box) : choose("box", box.id, { focus: true })),
        " ": () => choose("box", box.id, { focus: true }),
      };
    }
    const frame = frames.value.get(Number(target.closest(".title")?.getAttribute("data-frame") ?? NaN));
    if (frame) {
      const beside = () => framesIn(frame.parent), enters = () => (folds(frame) ? toggleFold(frame.id) : choose("frame", frame.id, { focus: true }));
      return {
        ArrowDown: () => (event.shiftKey ? intoFrame(frame) : turn("frame", frame.id, 1, beside)),
        ArrowUp: () => (event.shiftKey ? outTo(frame.parent) : turn("frame", frame.id, -1, beside)), Enter: enters, " ": enters,
      };
    }
    if (!edge) return {};
    const beside = () => edgesBeside(edge.id);
    return {
      ArrowRight: () => toEnd(edge, "to"), ArrowLeft: () => toEnd(edge, "from"), ArrowDown: () => turn("edge", edge.id, 1, beside),
      ArrowUp: () => turn("edge", edge.id, -1, beside), Enter: () => choose("edge", edge.id, { focus: true }),
    };
  }

  scene.host.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || !(event.target instanceof Element)) return;
    obey(event, does(event, event.target));
  });
  document.addEventListener("keydown", (event) => {
    const { target } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || !(target instanceof HTMLElement || target instanceof SVGElement)) return;
    if (target.matches("input, textarea, select, [contenteditable]")) {
      if (event.key === "Escape" && target instanceof HTMLElement) target.blur();
      return;
    }
    obey(event, {
      "/": () => document.getElementById("search")?.focus(), "?": () => { keysOpen.value = !keysOpen.peek(); },
      "+": () => view.by(1.25), "=": () => view.by(1.25), "-": () => view.by(0.8), 0: () => view.fit(), t: () => tidy(), c: () => copySelected(),
      l: () => turnTab("Log"), e: () => turnTab("Events"), p: () => turnTab("Plots"), d: () => flipTheme(), h: () => hideInfrastructure(),
      Escape: () => { if (keysOpen.peek()) keysOpen.value = false; else if (sought.peek()) sought.value = ""; else chooseNothing(); },
    });
  });
}

/** @param {KeyboardEvent} event @param {Record<string, () => void>} does */
function obey(event, does) {
  if (!Object.hasOwn(does, event.key)) return;
  event.preventDefault();
  event.stopPropagation();
  does[event.key]();
}

/** Lay out everything anew. */
export function tidy() {
  if (say({ t: "tidy" })) tell("Tidied");
}

/** Hide what only records or shows, or show it again. */
export function hideInfrastructure() {
  infrastructure.value = !infrastructure.peek();
  say({ t: "infrastructure", on: infrastructure.peek() });
}

/** @param {number} id of a frame */
export function toggleFold(id) {
  const frame = frames.peek().get(id);
  say({ t: "fold", id, on: !frame?.folded });
}

/** @param {Box} box */
export function unfold(box) {
  if (box.frame !== null) say({ t: "fold", id: box.frame, on: false });
}

/** Copy the command that shows the selected thing. */
export function copySelected() {
  const [first] = commandsOf(selected.peek());
  if (first) void copy(first.command);
  else tell("Nothing is selected");
}

/** @param {Box[]} some @returns {number[]} */
const inOrder = (some) => some.sort((a, b) => a.x - b.x || a.y - b.y).map((one) => one.id);

/** The boxes of the same frame. @param {number} id @returns {number[]} */
function neighbours(id) {
  const around = boxes.value.get(id)?.around;
  return inOrder([...boxes.value.values()].filter((one) => one.around === around));
}

/** Its ports, those at the left first. @param {Box} box @param {"in" | "out"} [side] @returns {string[]} their ids */
function portsOf(box, side) {
  const order = (/** @type {Box["ports"][number]} */ one) => (one.side === "in" ? 0 : 1);
  return box.ports.filter((one) => !side || one.side === side).sort((a, b) => order(a) - order(b) || a.y - b.y).map((one) => portId(box.id, one.name));
}

/** The frames right inside one, or those that are in none. @param {number | null} id */
const framesIn = (id) => [...frames.value.values()].filter((one) => one.parent === id).sort((a, b) => a.y - b.y || a.x - b.x).map((one) => one.id);

/** The edges of the box from which an edge comes. @param {number} id @returns {number[]} */
function edgesBeside(id) {
  const from = edges.value.get(id)?.from[0];
  return [...edges.value.values()].filter((one) => one.from[0] === from).sort((a, b) => endsOf(a, boxes.value)[0].localeCompare(endsOf(b, boxes.value)[0])).map((one) => one.id);
}
