/**
 * The page's address leads to what is selected: `#/box/KERNEL/NAME`. Names, not ids: those are the server's, and end
 * with it.
 */
import { effect } from "./vendor/preact-signals.js";
import { boxes, choose, edges, frames, kernels, on, portId, portOf, selected } from "./store.js";

/** @import {Selection} from "./types.js" */

/** Of a selection; "" of none, and of what is not there. @param {Selection | null} selection */
export function addressOf(selection) {
  if (!selection) return "";
  const { kind, id } = selection;
  const kernelOf = (/** @type {string} */ address) => kernels.peek().get(address)?.name ?? address;
  /** @param {(string | number)[]} parts */
  const joined = (...parts) => `#/${parts.map(encodeURIComponent).join("/")}`;
  if (kind === "kernel") return joined("kernel", kernelOf(String(id)));
  if (kind === "frame") {
    const frame = frames.peek().get(Number(id));
    return frame ? joined(frame.kind === "kernel" ? "frame" : frame.kind, kernelOf(frame.kernel), frame.name) : "";
  }
  if (kind === "port") {
    const found = portOf(id, boxes.peek());
    return found ? joined(kind, kernelOf(found.box.kernel), `${found.box.name}.${found.port.name}`) : "";
  }
  const thing = (kind === "box" ? boxes : edges).peek().get(Number(id));
  return thing ? joined(kind, kernelOf(thing.kernel), thing.name) : "";
}

/** What an address leads to; null: nothing that is there now. @param {string} address @returns {Selection | null} */
export function selectionOf(address) {
  for (const [id] of boxes.peek()) if (addressOf({ kind: "box", id }) === address) return { kind: "box", id };
  for (const box of boxes.peek().values()) for (const { name } of address.startsWith("#/port/") ? box.ports : []) {
    const id = portId(box.id, name);
    if (addressOf({ kind: "port", id }) === address) return { kind: "port", id };
  }
  for (const [id] of edges.peek()) if (addressOf({ kind: "edge", id }) === address) return { kind: "edge", id };
  for (const [id] of frames.peek()) if (addressOf({ kind: "frame", id }) === address) return { kind: "frame", id };
  for (const [id] of kernels.peek()) if (addressOf({ kind: "kernel", id }) === address) return { kind: "kernel", id };
  return null;
}

/** Keep the address and the selection the same. A thing that is not there yet is selected when it comes. */
export function followAddress() {
  let wanted = location.hash, selecting = false;
  const seek = () => {
    const found = wanted.startsWith("#/") && wanted !== addressOf(selected.peek()) ? selectionOf(wanted) : null;
    if (found) choose(found.kind, found.id);
  };
  on("picture", seek);
  on("change", () => wanted !== addressOf(selected.peek()) && seek());
  window.addEventListener("hashchange", () => {
    wanted = location.hash;
    seek();
  });
  effect(() => {
    const address = addressOf(selected.value);
    const before = selecting;
    selecting = address !== "";
    if (address === location.hash || !(address || before)) return;   // what the address wants may still come
    wanted = address;
    history.replaceState(null, "", address || location.pathname);
  });
}
