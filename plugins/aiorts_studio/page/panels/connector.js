/** A connector in full: what passes, what is lost and why, and what helps. */
import { signal } from "../vendor/preact-signals.js";
import { commandsOf } from "../commands.js";
import { boxes, choose, edges, figures, on, say, tell } from "../store.js";
import { capacityOf, count, endsOf, number, reasonsOf, toneOf } from "../words.js";
import { useAnswer } from "./asked.js";
import { Commands } from "./as_commands.js";
import { Cut, counted, html } from "./parts.js";
import { WhyLost } from "./why_lost.js";

/** @import {Edge, EdgeFigures} from "../types.js" */

const EVERY_MS = 600;
/** A sample that would be older was stamped by another clock, or long ago: a day, in ms. */
const LONGEST_MS = 86_400_000;

/** @param {{edge: Edge}} props */
export function ConnectorPart({ edge }) {
  const row = figures.value.get(edge.id), [from, to] = endsOf(edge, boxes.value), both = edge.bundle > 1;
  const { value } = useAnswer(edge.kernel, both ? "names" : "part", both ? {} : { connectors: [edge.name] }, both ? 0 : EVERY_MS);
  // The writer's end of a link knows what was acknowledged, and not what was read.
  const report = value?.connectors?.[edge.name], far = report?.ledger.delivered === null, tone = toneOf(edge, row), room = capacityOf(edge);
  const others = [...edges.value.values()].filter((one) => one.id !== edge.id && ((one.from[0] === edge.from[0] && one.to[0] === edge.to[0]) || (one.from[0] === edge.to[0] && one.to[0] === edge.from[0])));
  // Of the same moment as the ledger below, where there is one.
  const { lost, leftOut } = reasonsOf(report ? report.ledger.dropped : row?.reasons ?? null);
  return html`<h2><${Cut} text=${`${from} → ${to}`} /></h2>
    <p class="quiet">${edge.link ? "link between two processes" : both ? counted(edge.bundle, "connector") : "connector"}${edge.policy && `, ${edge.policy}`}</p>
    <p class="pills"><span class=${`pill tone-${tone || "idle"}`}>${{ "": "connected", busy: "samples pass", idle: "nothing passes", full: "nearly full", lossy: row?.loss ? "loses samples" : "has lost samples", down: "down", waiting: "waits for the other end" }[tone]}</span></p>
    <section aria-label="Ends"><table><tbody>${/** @type {const} */ (["from", "to"]).map((end) => html`<tr key=${end}><td>${end}</td>
      <td class="figure"><button class="lead" onClick=${() => choose("box", edge[end][0])}><${Cut} text=${end === "from" ? from : to} /></button></td></tr>`)}</tbody></table></section>
    <${WhyLost} edge=${edge} reasons=${lost} />
    <section><h3 class="over">Now</h3><table><tbody>
      <${Figure} name="arrive" value=${row?.rate} unit="samples/s" />
      <${Figure} name="lost now" value=${row?.loss} unit="samples/s" bad=${(row?.loss ?? 0) > 0} />
      <${Figure} name="wait for the reader" value=${report ? report.ledger.buffered : row?.backlog} unit=${Number.isFinite(room) ? `of ${room}` : "samples"} whole=${true} bad=${tone === "full"} />
      ${edge.link && html`<${Figure} name="round trip" value=${row?.trip} unit="ms" />`}
      <${Age} edge=${edge} row=${row} measured=${Boolean(report?.options.measure)} />
    </tbody></table></section>
    ${report && html`<section><h3 class="over">Since it was made</h3><table><tbody>
      <${Figure} name="written" value=${report.ledger.written} whole=${true} />
      ${far ? html`<${Figure} name="acknowledged" value=${report.ledger.acknowledged} whole=${true} /><${Figure} name="on the way" value=${report.ledger.in_flight} whole=${true} />`
        : html`<${Figure} name="delivered" value=${report.ledger.delivered} whole=${true} />`}
      <${Figure} name="wait" value=${report.ledger.buffered} whole=${true} />
      <${Figure} name="lost" value=${sumOf(lost)} whole=${true} bad=${lost.length > 0} />
      ${leftOut.length > 0 && html`<${Figure} name="left out, as the options ask" value=${sumOf(leftOut)} whole=${true} />`}
      </tbody></table><p class="quiet">written = ${far ? "acknowledged + on the way" : "delivered"} + wait + lost${leftOut.length > 0 && " + left out"}</p></section>`}
    ${others.length > 0 && html`<section><h3 class="over">Also between these two</h3><ul class="plain">${others.map((one) => html`<li key=${one.id}>
      <button class="lead" onClick=${() => choose("edge", one.id)}><${Cut} text=${endsOf(one, boxes.value).join(" → ")} /></button></li>`)}</ul></section>`}
    <${Commands} commands=${commandsOf({ kind: "edge", id: edge.id })} />`;
}

/** @param {[string, number][]} reasons */
const sumOf = (reasons) => reasons.reduce((sum, [, times]) => sum + times, 0);

/** @param {{name: string, value: number | null | undefined, unit?: string, whole?: boolean, bad?: boolean}} props */
export function Figure({ name, value, unit = "", whole = false, bad = false }) {
  return html`<tr><td>${name}</td><td class=${`figure ${bad ? "bad" : ""}`}>${value === null || value === undefined ? "–" : html`${whole ? count(value) : number(value)} <span class="unit">${unit}</span>`}</td></tr>`;
}

/** The edges whose ages this page has asked for. */
const asked = signal(/** @type {Set<number>} */ (new Set()));
on("hello", () => { asked.value = new Set(); });

/** The age of samples when they are read: known where it is measured. @param {{edge: Edge, row: EdgeFigures | undefined, measured: boolean}} props */
function Age({ edge, row, measured }) {
  const known = typeof row?.age === "number" && row.age < LONGEST_MS, [why, can] = unaged(edge, row, measured || asked.value.has(edge.id));
  const measure = () => {
    if (!say({ t: "measure", edges: [edge.id], on: true })) return;
    asked.value = new Set([...asked.value, edge.id]);
    tell("The age is measured as long as this page is open");
  };
  return html`<tr><td>age when read</td><td class="figure">${known ? html`${number(row?.age ?? 0)} <span class="unit">ms</span>` : "–"}
    ${!known && can && html` <button onClick=${measure}>Measure</button>`}${!known && html`<small>${why}</small>`}</td></tr>`;
}

/** Why the age of what passes is not known, and whether it can be measured. @param {Edge} edge @param {EdgeFigures | undefined} row @param {boolean} measured @returns {[string, boolean]} */
function unaged(edge, row, measured) {
  if (typeof row?.age === "number") return ["its time stamps are of another time, as in a recording", false];
  if (edge.link) return ["samples are read in another kernel: what is measured here ends at the link", false];
  if (edge.policy === "service") return ["calls have no age", false];
  return measured ? ["no sample has been read yet", false] : ["not measured", true];
}
