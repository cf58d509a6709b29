/** What is selected, in full; and where nothing is, what needs a look. */
import { boxes, choose, connection, frames, selected, selection } from "../store.js";
import { ComponentPart } from "./component.js";
import { ConnectorPart } from "./connector.js";
import { Cut, html } from "./parts.js";
import { PortPart } from "./port.js";
import { FramePart, KernelPart } from "./surroundings.js";
import { late, troubles } from "./troubles.js";

/** @import {Box, Edge, Frame, Kernel} from "../types.js" */

const MOST = 30;

export function Inspector() {
  const one = selection.value;
  if (!one) return html`<${Overview} />`;
  const folded = one.kind === "box" ? foldedIn(/** @type {Box} */ (one.thing)) : undefined;
  if (folded) return html`<${FramePart} key=${`f${folded.id}`} frame=${folded} />`;
  if (one.kind === "box") return html`<${ComponentPart} key=${`b${/** @type {Box} */ (one.thing).id}`} box=${one.thing} />`;
  if (one.kind === "edge") return html`<${ConnectorPart} key=${`e${/** @type {Edge} */ (one.thing).id}`} edge=${one.thing} />`;
  if (one.kind === "frame") return html`<${FramePart} key=${`f${/** @type {Frame} */ (one.thing).id}`} frame=${one.thing} />`;
  if (one.kind === "port") return html`<${PortPart} key=${`p${selected.value?.id}`} ...${one.thing} />`;
  return html`<${KernelPart} key=${`k${/** @type {Kernel} */ (one.thing).address}`} kernel=${one.thing} />`;
}

/** The frame for which a box stands, where it is no component itself. @param {Box} box */
const foldedIn = (box) => (box.kind === "folded" && box.frame !== null && frames.value.get(box.frame)?.kind !== "composite" ? frames.value.get(box.frame) : undefined);

/** What is wrong, the worst first; each leads there. */
function Overview() {
  const found = troubles(), slow = late();
  if (connection.value === "closed" && !boxes.value.size) return null;   // nobody has signed in
  return html`<h2>${found.length ? "Needs a look" : "All well"}</h2>
    <p class="quiet">${found.length ? "Select one to see why." : slow ? `No component has failed, and no connector loses samples; but ${slow}.` : boxes.value.size ? "No component has failed, and no connector loses samples. Select anything to see it in full." : "No component runs here. `aiorts run FILE` starts a system; it appears by itself."}</p>
    <ul class="troubles">${found.slice(0, MOST).map(({ key, name, words, thing }) => html`
      <li key=${key}><button onClick=${() => choose(thing.kind, thing.id, { focus: thing.kind !== "kernel" })}><${Cut} text=${name} class="name" /><${Cut} text=${words} class="bad" /></button></li>`)}</ul>
    ${found.length > MOST && html`<p class="quiet">and ${found.length - MOST} more</p>`}`;
}
