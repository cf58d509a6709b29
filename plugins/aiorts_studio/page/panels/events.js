/** What has happened in the kernels, the newest last, as in the log; each line leads to its component. */
import { useEffect } from "../vendor/preact-hooks.js";
import { signal } from "../vendor/preact-signals.js";
import { kernels, on, say } from "../store.js";
import { Cut, Lead, LeadToContext, Rows, counted, html, moment, rowLeads } from "./parts.js";

/** @import {Happening, Happenings} from "../types.js" */

const KEPT = 2000;
const EVERY_MS = 150;
const HEIGHT = 24, LOOK_MS = 2000;
const MINUTE_NS = 60_000_000_000n;

/** @typedef {Happening & {times?: number}} Entry times: how often it happened, within a second each */

const drawn = signal(/** @type {Entry[]} */ ([]));
const minute = signal(false), looked = signal(0);
/** The newest last. @type {Entry[]} */
let items = [];
let timer = 0;

/** Of each kernel, until when the history goes: it may have what also comes as an event. @type {Record<string, bigint>} */
let told = {};
let open = false;

/** @param {Happenings} message */
function take(message) {
  const news = message.items.filter(({ kernel, at_ns }) => !(BigInt(at_ns) <= (told[kernel] ?? 0n)));
  items = joined(items, news).slice(-KEPT);
  timer ||= window.setTimeout(() => {
    timer = 0;
    drawn.value = items;
  }, EVERY_MS);
}
on("event", take);
on("history", (/** @type {Happenings} */ message) => {
  take(message);
  for (const { kernel, at_ns } of message.items) told[kernel] = BigInt(at_ns);
});
on("hello", () => {
  items = [];
  told = {};
  if (open) say({ t: "events", on: true });
});

/** Those of the last minute; in simulated time, before the newest one of their kernel. @param {Happening[]} all */
function ofLastMinute(all) {
  /** @type {Record<string, bigint>} */
  const newest = {}, now = BigInt(Date.now()) * 1_000_000n;
  for (const { kernel, at_ns } of all.toReversed()) newest[kernel] ??= kernels.value.get(kernel)?.simulated ? BigInt(at_ns) : now;
  return all.filter(({ kernel, at_ns }) => newest[kernel] - BigInt(at_ns) <= MINUTE_NS);
}

export function Events() {
  // What changed within a minute before, and was not seen here, comes first, as history.
  useEffect(() => {
    open = true;
    say({ t: "events", on: true });
    return () => {
      open = false;
      say({ t: "events", on: false });
    };
  }, []);
  // What is older than a minute goes by itself.
  useEffect(() => {
    if (!minute.value) return undefined;
    const timer = window.setInterval(() => { looked.value++; }, LOOK_MS);
    return () => window.clearInterval(timer);
  }, [minute.value]);
  void looked.value;
  const shown = minute.value ? ofLastMinute(drawn.value) : drawn.value;
  return html`<div class="log">
    <div class="bar">
      <button aria-pressed=${minute.value} onClick=${() => { minute.value = !minute.value; }}>What changed in the last minute</button>
      <button onClick=${() => { drawn.value = items = []; }}>Clear</button>
      <span class="quiet" role="status">${counted(shown.length, "event")}</span>
    </div>
    ${shown.length ? html`<${Rows} count=${shown.length} height=${HEIGHT} role="table" label="Events" follow=${true} row=${(/** @type {number} */ index) => html`<${Line} key=${index} item=${shown[index]} index=${index} />`} />`
      : html`<p class="none">Nothing has changed ${minute.value ? "in the last minute" : "within a minute before this was opened, or since"}.</p>`}
  </div>`;
}

/** The same within this time is one entry. */
const SECOND_NS = 1_000_000_000n, NEAR = 8;
/** What one change of a parameter makes, the one that says it best first. */
const OF_A_CHANGE = ["ParameterChanged", "ParametersChanged", "ConfigurationSetChanged"];

/** Events behind others, with one entry for what is one. @param {Entry[]} before @param {Happening[]} news @returns {Entry[]} */
export function joined(before, news) {
  const all = [...before];
  for (const one of news) {
    const near = (/** @type {Entry} */ other) => other.kernel === one.kernel && subjectOf(other) === subjectOf(one) && BigInt(one.at_ns) - BigInt(other.at_ns) < SECOND_NS;
    const from = Math.max(0, all.length - NEAR), at = all.slice(from).findIndex((other) => near(other) && (other.kind === one.kind
      ? !OF_A_CHANGE.includes(one.kind) && !one.kind.startsWith("State") : OF_A_CHANGE.includes(other.kind) && OF_A_CHANGE.includes(one.kind)));
    if (at < 0) all.push(one);
    else if (all[from + at].kind === one.kind) all.push({ ...one, times: (all.splice(from + at, 1)[0].times ?? 1) + 1 });
    else if (OF_A_CHANGE.indexOf(one.kind) < OF_A_CHANGE.indexOf(all[from + at].kind)) all[from + at] = one;
  }
  return all;
}

/** Of which component or context it is. @param {Happening} item */
const subjectOf = (item) => item.component || item.context;

/** What is bad news. */
const BAD = /fail|error|lost|drop|overrun|late|silen|ended|overdue|gone/i;

/** @param {{item: Entry, index: number}} props */
function Line({ item, index }) {
  return html`<div class=${`line ${BAD.test(item.kind) ? "warning" : ""}`} role="row" aria-rowindex=${index + 1} onClick=${rowLeads(item.kernel, item.component)}>
    <span class="when" role="cell">${moment(item.at_ns)}</span><span class="kind" role="cell"><${Cut} text=${`${item.kind.replace(/(?<=[a-z])(?=[A-Z])/g, " ").toLowerCase()}${item.times ? ` × ${item.times}` : ""}`} /></span>
    <span class="who" role="cell">${item.component ? html`<${Lead} kernel=${item.kernel} component=${item.component} />`
      : html`<${LeadToContext} kernel=${item.kernel} context=${item.context} />`}</span>
    <span class="what" role="cell" tabindex="0"><${Cut} text=${item.text} /></span>
  </div>`;
}
