/** The commands that show or change what is selected, to be copied into a terminal. */
import { boxFigures, boxes, edges, frames, kernels, portOf, tell } from "./store.js";
import { endsOf } from "./words.js";

/** @import {Selection} from "./types.js" */
/** @typedef {{says: string, command: string}} Command */

const PLAIN = /^[\w@%+=:,./-]+$/;

/** A word of a command line, in quotes where a shell would change it. @param {string} word */
export const quoted = (word) => (PLAIN.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`);

/** A name as commands take it: with its kernel's where there are several. @param {string} kernel address @param {string} name */
export function named(kernel, name) {
  const own = kernels.value.get(kernel);
  return quoted(own && kernels.value.size > 1 ? `${own.name}/${name}` : name);
}

/**
 * The commands for a thing; the first one shows it.
 * @param {Selection | null} selection
 * @param {string} [change] of a component, the command that changes a parameter; "" where it has none, undefined: that is not known
 * @returns {Command[]}
 */
export function commandsOf(selection, change) {
  if (!selection) return [];
  const { kind, id } = selection;
  if (kind === "box") {
    const box = boxes.value.get(Number(id));
    if (!box) return [];
    const name = named(box.kernel, box.name);
    const { state } = boxFigures.value.get(box.id) ?? box;
    return [...(state === "error" ? [{ says: "take it out of error", command: `aiorts reset ${name}` }] : []), { says: "show it", command: `aiorts cat ${name}` }, ...(change === "" ? [] : [{ says: "its parameters", command: `aiorts conf ${name}` }]),
      ...(change ? [{ says: "change a parameter", command: change }] : []), { says: "its log", command: `aiorts vlog ${name}` }];
  }
  if (kind === "edge") {
    const edge = edges.value.get(Number(id));
    if (!edge) return [];
    const kernelOf = (/** @type {number} */ box) => boxes.value.get(box)?.kernel ?? edge.kernel;
    const [from, to] = endsOf(edge, boxes.value).map((end, index) => named(kernelOf([edge.from, edge.to][index][0]), end));
    return [{ says: "show it", command: `aiorts cat ${edge.link ? from : named(edge.kernel, edge.name)}` },
      { says: "its ledger, from end to end", command: `aiorts con --both-ends ${from} ${to}` },
      { says: "what passes", command: `aiorts print ${from}` }];
  }
  if (kind === "port") {
    const found = portOf(id, boxes.value);
    return found ? commandsOfPort(found.box.kernel, `${found.box.name}.${found.port.name}`, found.port.side) : [];
  }
  const frame = kind === "frame" ? frames.value.get(Number(id)) : null;
  if (frame && frame.kind !== "kernel" && frame.kind !== "host") return [{ says: "show it", command: `aiorts cat ${named(frame.kernel, frame.name)}` }];
  const kernel = kernels.value.get(frame ? frame.kernel : String(id));
  if (!kernel) return [];
  return [{ says: "show it", command: `aiorts cat ${quoted(`${kernel.name}/`)}` }, { says: "watch it", command: `aiorts top ${quoted(kernel.name)}` },
    { says: "end it", command: `aiorts stop ${quoted(kernel.name)}` }];
}

/** The commands for a port. @param {string} kernel address @param {string} path "component.port" @param {"in" | "out"} side @returns {Command[]} */
export function commandsOfPort(kernel, path, side) {
  const name = named(kernel, path);
  return [{ says: "show it", command: `aiorts cat ${name}` }, ...(side === "out" ? [{ says: "its samples", command: `aiorts print ${name}` }] : [])];
}

/** Put a command on the clipboard, and say so. @param {string} command */
export async function copy(command) {
  try {
    await navigator.clipboard.writeText(command);
    tell(`Copied: ${command}`);
  } catch {
    tell(`The browser does not let the page copy. The command is: ${command}`);
  }
}
