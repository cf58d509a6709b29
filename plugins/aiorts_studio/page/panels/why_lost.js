/** Why a connector loses samples, and what helps. */
import { adviceOf } from "../advice.js";
import { copy } from "../commands.js";
import { count } from "../words.js";
import { html } from "./parts.js";

/** @import {Edge} from "../types.js" */

/** The reason that cost the most comes first. @param {{edge: Edge, reasons: [string, number][]}} props */
export function WhyLost({ edge, reasons }) {
  if (!reasons.length) return null;
  const most = reasons.toSorted(([, one], [, other]) => other - one);
  return html`<section class="failure" aria-label="Why samples are lost"><h3 class="over">Why samples are lost</h3>
    ${most.map(([reason, times]) => html`<${Reason} key=${reason} edge=${edge} reason=${reason} times=${times} />`)}</section>`;
}

/** @param {{edge: Edge, reason: string, times: number}} props */
function Reason({ edge, reason, times }) {
  const { why, helps, cures, note } = adviceOf(edge, reason);
  return html`<p><b>${count(times)} ${reason.replaceAll("_", " ")}</b><span>${why}</span>${helps && html`<span class="remedy">${helps}</span>`}</p>
    ${cures.length > 0 && html`<ol class="cures">${cures.map(({ says, line }) => html`<li key=${says + line}>${says}${says && line && ": "}
      ${line && html`<button class="lead" onClick=${() => void copy(line)} title="Copy"><code>${line}</code></button>`}</li>`)}</ol>`}
    ${note && html`<p class="quiet">${note}</p>`}`;
}
