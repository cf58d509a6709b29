/**
 * Why samples are lost, and what helps, with the names of those that it is about. What helps a slow reader, and in which
 * order, the server says: it is what aiorts says in a terminal.
 */
import { named } from "./commands.js";
import { boxFigures, boxes, bursts, cures, figures, frames, kernels } from "./store.js";
import { capacityOf } from "./words.js";

/** @import {Edge} from "./types.js" */
/** @typedef {{says: string, line?: string}} Cure line: to be copied */
/** @typedef {{why: string, helps: string, cures: Cure[], note: string}} Advice */

/** Why samples are lost, by the reason, and what helps; a slow reader and one that is not active have their own. */
const REASONS = /** @type {Record<string, [string, string]>} */ ({
  overwritten: ["The buffer was full when a sample came, and the oldest one made room.", ""],
  rejected: ["The buffer was full when a sample came, and the new one was refused.", ""],
  timeout: ["The writer waited for room in the buffer, and gave up.", "Find out why the reader stands still; timeout says how long a writer waits."],
  inactive: ["The reader's component was not active.", ""],
  expired: ["The sample was older than its lifespan when it was to be read.", "The reader is late: let it run more often, or lengthen lifespan."],
  unconverted: ["The converter of the connector could not make the reader's type of it.", "The log of the reader says which value; see the option convert."],
  undecodable: ["The reader's process could not decode it.", "The types of the two ends are not the same: compare the versions that run."],
  unknown_fate: ["They were on their way when the other process ended, or the link was cut: whether they arrived is not known.", "See what ended the other process: Events, and the log of its component."],
  disconnected: ["The link was cut while the sample was on its way.", "See the state of the link; on_link_lost says what becomes of samples then."],
});
const SLOW = new Set(["overwritten", "rejected"]);
const CHANGED = "Options stand in the file of the system, at the connection; aiorts apply FILE changes them while it runs: repeat there what the command line of the run had set, or that is undone.";

/** @param {Edge} edge @param {string} reason @returns {Advice} */
export function adviceOf(edge, reason) {
  const [why, helps] = REASONS[reason] ?? ["", ""], plain = { why, helps, cures: [], note: "" };
  const reader = boxes.value.get(edge.to[0]);
  if (!reader || kernels.value.get(reader.kernel)?.state !== "live") return plain;
  if (SLOW.has(reason) && / block$/.test(edge.policy)) return { ...plain, helps: "Since then its options were changed: the writer waits now, and nothing is lost." };
  if (SLOW.has(reason) && !figures.value.get(edge.id)?.loss) {
    const room = capacityOf(edge), longer = Number.isFinite(room) ? `length = ${4 * room}` : "";
    return { ...plain, helps: `Nothing is lost at this moment. Against bursts, and a ${reader.name} that stands still for a while:`,
      cures: [{ says: "a longer buffer", line: longer }, { says: "let the writer wait", line: 'full = "block"' }], note: CHANGED };
  }
  if (SLOW.has(reason)) {
    const context = frames.value.get(reader.around ?? 0)?.name;
    return { ...plain, helps: `${reader.name}${context ? `, in the context ${context},` : ""} takes fewer than come. What helps, the best first:`,
      cures: cures.value.map(([says, line]) => ({ says: says || "let the writer wait", line })), note: `${bursts.value}. Where only the newest counts, nothing is wrong. ${CHANGED}` };
  }
  return reason === "inactive" ? { ...plain, ...inactive(reader) } : plain;
}

/** What a reader that was not active needs, as it is now. @param {import("./types.js").Box} reader @returns {{helps: string, cures: Cure[]}} */
function inactive(reader) {
  const { state } = boxFigures.value.get(reader.id) ?? reader, name = named(reader.kernel, reader.name);
  if (state === "error") {
    return { helps: `${reader.name} is in error${reader.error ? `: ${reader.error.message}` : ""}. Reset it:`, cures: [{ says: "", line: `aiorts reset ${name}` }] };
  }
  if (state === "active") return { helps: `${reader.name} is active now: these came while it was not.`, cures: [] };
  return { helps: `${reader.name} is ${state || "not active"}. Activate it:`, cures: [{ says: "", line: `aiorts activate ${name}` }] };
}
