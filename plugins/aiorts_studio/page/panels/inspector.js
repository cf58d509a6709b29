/** What is selected, in full; and where nothing is, what needs a look. */
import { boxes, boxFigures, choose, edges, figures, kernels, selected, selection } from "../store.js";
import { count, endsOf, kernelTrouble, reasonsOf } from "../words.js";
import { ComponentPart } from "./component.js";
import { ConnectorPart } from "./connector.js";
import { Cut, html } from "./parts.js";
import { PortPart } from "./port.js";
import { FramePart, KernelPart } from "./surroundings.js";

/** @import {Box, Edge, Frame, Kernel, Selection} from "../types.js" */

const MOST = 30;

export function Inspector() {
  const one = selection.value;
  if (!one) return html`<${Overview} />`;
  if (one.kind === "box") return html`<${ComponentPart} key=${`b${/** @type {Box} */ (one.thing).id}`} box=${one.thing} />`;
  if (one.kind === "edge") return html`<${ConnectorPart} key=${`e${/** @type {Edge} */ (one.thing).id}`} edge=${one.thing} />`;
  if (one.kind === "frame") return html`<${FramePart} key=${`f${/** @type {Frame} */ (one.thing).id}`} frame=${one.thing} />`;
  if (one.kind === "port") return html`<${PortPart} key=${`p${selected.value?.id}`} ...${one.thing} />`;
  return html`<${KernelPart} key=${`k${/** @type {Kernel} */ (one.thing).address}`} kernel=${one.thing} />`;
}

/** What is wrong, the worst first; each leads there. */
function Overview() {
  const found = troubles();
  return html`<h2>${found.length ? "Needs a look" : "All well"}</h2>
    <p class="quiet">${found.length ? "Select one to see why." : boxes.value.size ? "No component has failed, and no connector drops samples. Select anything to see it in full." : "No component runs here. `aiorts run FILE` starts a system; it appears by itself."}</p>
    <ul class="troubles">${found.slice(0, MOST).map(({ key, name, words, thing }) => html`
      <li key=${key}><button onClick=${() => choose(thing.kind, thing.id, { focus: thing.kind !== "kernel" })}><${Cut} text=${name} class="name" /><${Cut} text=${words} class="bad" /></button></li>`)}</ul>
    ${found.length > MOST && html`<p class="quiet">and ${found.length - MOST} more</p>`}`;
}

/** @returns {{key: string, name: string, words: string, thing: Selection}[]} */
function troubles() {
  const silent = [...kernels.value.values()].filter((one) => one.state !== "live").map((one) => ({
    key: `k${one.address}`, name: one.name, words: kernelTrouble(one, one.since_s), thing: /** @type {Selection} */ ({ kind: "kernel", id: one.address }) }));
  const failed = [...boxes.value.values()].flatMap((box) => {
    const { state, said } = boxFigures.value.get(box.id) ?? box;
    if (state !== "error" && !said && !box.error) return [];
    return [{ key: `b${box.id}`, name: box.name, words: said || box.error?.message || state, thing: /** @type {Selection} */ ({ kind: "box", id: box.id }) }];
  });
  const lossy = [...edges.value.values()].map((edge) => ({ edge, row: figures.value.get(edge.id) }))
    .filter(({ edge, row }) => row?.lossy || edge.state === "down").sort((a, b) => (b.row?.dropped ?? 0) - (a.row?.dropped ?? 0))
    .map(({ edge, row }) => ({ key: `e${edge.id}`, name: endsOf(edge, boxes.value).join(" → "), thing: /** @type {Selection} */ ({ kind: "edge", id: edge.id }),
      words: edge.state === "down" ? "the connection is down" : row?.dropped ? `${count(row.dropped)} dropped${reasonsOf(row).length ? `: ${reasonsOf(row).map(([why]) => why).join(", ")}` : ""}` : "drops samples" }));
  return [...silent, ...failed, ...lossy];
}
