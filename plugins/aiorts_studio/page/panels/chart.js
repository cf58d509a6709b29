/** The state chart of a component, its states inside one another, with those lit that are active. */
import { useAnswer } from "./asked.js";
import { html } from "./parts.js";

/** @typedef {{name: string, inside: string, kind: string, initial: boolean, ways: [string, string][]}} State ways: what triggers it, and where it leads; "" where it stays */

/** @param {{kernel: string, component: string, machine: {chart: string, states: string[], timers: Record<string, number>, ignored: number}}} props */
export function StateChart({ kernel, component, machine }) {
  const { value } = useAnswer(kernel, "machine", { component }, 0), states = /** @type {State[]} */ (value?.chart ?? []);
  const lit = new Set(machine.states);
  return html`<section><h3 class="over">State chart</h3>
    <p class="pills" role="status">${machine.states.length ? machine.states.map((one) => html`<span key=${one} class="pill lit">${one}</span>`) : html`<span class="quiet">in no state: it is not active</span>`}</p>
    ${states.length > 0 && html`<${Level} states=${states} around="" lit=${lit} />`}
    ${machine.ignored > 0 && html`<p class="quiet">${machine.ignored.toLocaleString("en")} events led to nothing</p>`}</section>`;
}

/** @param {{states: State[], around: string, lit: Set<string>}} props */
function Level({ states, around, lit }) {
  const here = states.filter((one) => one.inside === around);
  if (!here.length) return null;
  return html`<ul class="chart">${here.map((one) => html`<li key=${one.name} class=${`${one.kind} ${lit.has(one.name) ? "lit" : ""}`} aria-current=${lit.has(one.name) ? "true" : null}>
    <b>${one.initial && html`<span class="initial" title="Entered first">●</span> `}${one.name}</b>${one.kind !== "state" && html` <span class="quiet">${one.kind}</span>`}
    ${one.ways.length > 0 && html`<ul class="ways">${one.ways.map(([when, to], index) => html`<li key=${index}>${when || "at once"} ${to ? html`→ <i>${to}</i>` : null}</li>`)}</ul>`}
    <${Level} states=${states} around=${one.name} lit=${lit} /></li>`)}</ul>`;
}
