/** How long a component's hook takes in each cycle, and how often it can run therefore. */
import { count, number } from "../words.js";
import { useAnswer } from "./asked.js";
import { html } from "./parts.js";

/** @import {Box} from "../types.js" */

const EVERY_MS = 1500, HOOK = "on_execute";
/** Hooks that take less hold nothing up that is worth a word, in ms. */
const LONG = 1;

/** @param {{box: Box, contexts: string[]}} props contexts: those that run it */
export function Timing({ box, contexts }) {
  const { value } = useAnswer(box.kernel, contexts.length ? "part" : "names", contexts.length ? { contexts } : {}, contexts.length ? EVERY_MS : 0);
  const rows = contexts.flatMap((context) => {
    const statistics = value?.contexts?.[context]?.statistics, own = statistics?.hooks[`${box.name}.${HOOK}`];
    return statistics ? [{ context, own, timed: Object.keys(statistics.hooks).length > 0 }] : [];
  });
  if (!rows.length) return null;
  return html`<section aria-label="How long it takes"><h3 class="over">How long it takes</h3>${rows.map(({ context, own, timed }) => html`
    <p key=${context}>${own?.count ? taken(own) : html`<span class="quiet">${timed ? `${HOOK} has not run yet` : html`not measured in this context; <code>timing = true</code> in <code>[contexts.${context}]</code> has it measured`}</span>`}
      ${rows.length > 1 && html` <span class="quiet">in ${context}</span>`}</p>`)}</section>`;
}

/** @param {{count: number, total_ns: number, max_ns: number}} own */
function taken({ count: runs, total_ns: total, max_ns: longest }) {
  const mean = total / runs / 1e6, most = mean >= LONG ? `: at most ${number(1000 / mean)} a second` : "";
  return html`<b>${HOOK} ${number(mean)} ms</b>${most} <span class="quiet">the longest of ${count(runs)} ${number(longest / 1e6)} ms</span>`;
}
