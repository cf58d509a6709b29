/** What needs a look, the worst first. It comes from the kernels as a whole: what is folded counts as what is drawn. */
import { boxes, edges, frameFigures, frames, kernels, totals } from "../store.js";
import { count, counted, endsOf, hasEnded, kernelTrouble } from "../words.js";

/** @import {EdgeFigures, Selection} from "../types.js" */
/** @typedef {{key: string, name: string, words: string, thing: Selection}} Trouble */

/** @returns {Trouble[]} */
export function troubles() {
  const silent = [...kernels.value.values()].filter((one) => one.state !== "live" && !hasEnded(one)).map((one) => ({
    key: `k${one.address}`, name: one.name, words: kernelTrouble(one, one.since_s), thing: leadTo(one.address, null) }));
  const all = [...totals.value].flatMap(([id, total]) => {
    const kernel = frames.value.get(id)?.kernel;
    return kernel === undefined ? [] : [{ kernel, total }];
  });
  const failed = all.flatMap(({ kernel, total }) => total.failed.map(([name, words, box]) => ({ key: `b${kernel} ${name}`, name, words, thing: leadTo(kernel, box) })));
  const down = [...edges.value.values()].filter((edge) => edge.state === "down").map((edge) => ({
    key: `e${edge.id}`, name: endsOf(edge, boxes.value).join(" → "), words: "the connection is down", thing: leadTo(edge.kernel, edge.id, "edge") }));
  const lossy = all.flatMap(({ kernel, total }) => total.lossy.map((one) => ({ kernel, one }))).sort((a, b) => b.one[2] - a.one[2])
    .map(({ kernel, one: [from, to, lost, reasons, kind, id] }) => ({ key: `l${kernel} ${from} ${to}`, name: `${from} → ${to}`, thing: leadTo(kernel, id, kind),
      words: `${count(lost)} lost${reasons.length ? `: ${reasons.map((why) => why.replaceAll("_", " ")).join(", ")}` : ""}` }));
  return [...silent, ...failed, ...down, ...lossy];
}

/** The worst connector that loses samples; its reader, where that has failed: it is the cause. @returns {Trouble | undefined} */
export function worstLoss() {
  const found = troubles(), loss = found.find(({ key }) => key.startsWith("l"));
  if (!loss) return undefined;
  const [kernel, , to] = loss.key.slice(1).split(" "), reader = `b${kernel} ${to.split(".")[0]}`;
  return found.find(({ key }) => key === reader) ?? loss;
}

/** The selection of what stands for a thing; of its kernel, where nothing does. @param {string} kernel @param {number | null} id @param {"box" | "edge"} [kind] @returns {Selection} */
const leadTo = (kernel, id, kind = "box") => (id === null ? { kind: "kernel", id: kernel } : { kind, id });

/** How many samples an edge has lost; null: that is not known. In the far view only the worst are. @param {number} edge @param {EdgeFigures | undefined} row */
export function lostOn(edge, row) {
  if (row && (row.rate !== null || row.dropped)) return row.dropped;
  const named = [...totals.value.values()].flatMap((one) => one.lossy).find((one) => one[4] === "edge" && one[5] === edge);
  return named ? named[2] : row && !row.lossy ? 0 : null;
}

/** Contexts that were late, in words; "" is none. */
export function late() {
  const found = [...frameFigures.value].filter(([, row]) => row.overruns);
  const sum = found.reduce((so, [, row]) => so + row.overruns, 0), [only] = found;
  return !only ? "" : `${counted(sum, "overrun")} in ${found.length > 1 ? counted(found.length, "context") : frames.value.get(only[0])?.name ?? "a context"}`;
}
