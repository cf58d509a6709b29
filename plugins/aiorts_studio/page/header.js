/** What the whole system does, in one line; and the theme. */
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";
import { worstLoss } from "./panels/troubles.js";
import { flipTheme } from "./shell.js";
import { choose, connection, frameFigures, frames, kernels, keysOpen, missed, right, theme, totals } from "./store.js";
import { count, counted, number } from "./words.js";

/** @import {Total} from "./types.js" */

const html = htm.bind(h);

const LIVE = /** @type {Record<string, string>} */ ({ closed: "not signed in", opening: "connecting", lost: "connection lost, trying again", ended: "the server has ended" });

export function Header() {
  return html`
    <h1><img src="icon.svg" alt="" width="22" height="22" />aiorts <span>studio</span></h1>
    <${Live} />
    <div class="facts">${facts().map(([value, said, bad, to]) => html`
      <${to ? "button" : "div"} key=${said} class=${`fact ${bad ? "bad" : ""}`} onClick=${to} title=${to ? "Show the worst" : null}>
        <b>${value}</b><span>${said}</span></${to ? "button" : "div"}>`)}</div>
    ${missed.value > 0 && html`<span class="missed" role="status">missed ${count(missed.value)} messages: this page was too slow</span>`}
    <span class="right">${right.value === "operate" ? "may change what runs" : right.value && "looks only"}</span>
    <button aria-label="Keys" title="Keys (?)" onClick=${() => { keysOpen.value = true; }}>?</button>
    <button onClick=${flipTheme} title="Dark or light (d)">${theme.value === "dark" ? "Light" : "Dark"}</button>`;
}

function Live() {
  const silent = [...kernels.value.values()].filter((one) => one.state === "silent");
  const words = connection.value !== "live" ? LIVE[connection.value] : silent.length ? `${silent.map((one) => one.name).join(", ")}: no answer` : "live";
  const kind = connection.value === "live" ? (silent.length ? "partly" : "") : "not";
  return html`<span class=${`live ${kind}`} role="status">${words}</span>`;
}

/** @returns {[string, string, boolean, (() => void) | null][]} value, words, whether it is bad, what leads there */
function facts() {
  const all = [...totals.value.values()], sum = (/** @type {(one: Total) => number} */ of) => all.reduce((so, one) => so + of(one), 0);
  const known = all.some((one) => one.rate !== null), lost = sum((one) => one.dropped), worst = worstLoss();
  const late = [...frameFigures.value].reduce((most, one) => ((one[1].late ?? -1) > (most?.[1].late ?? -1) ? one : most), /** @type {[number, any] | null} */ (null));
  const live = [...kernels.value.values()].filter((one) => one.state !== "ended"), names = live.length === 1 ? live[0].name : counted(live.length, "kernel");
  /** @type {[string, string, boolean, (() => void) | null][]} */
  const facts = [
    [names, `${counted(sum((one) => one.components), "component")}, ${counted(sum((one) => one.connectors), "connector")}`, false, null],
    [known ? `${number(sum((one) => one.rate ?? 0))}/s` : "–", "samples", false, null],
    [count(lost), "samples lost", lost > 0, worst ? () => choose(worst.thing.kind, worst.thing.id, { focus: true }) : null],
  ];
  if (late && late[1].late !== null) {
    facts.push([`${number(late[1].late)} ms`, `late (p99) in ${frames.value.get(late[0])?.name ?? "?"}`, false, () => choose("frame", late[0])]);
  }
  return facts;
}

/** Light or dark: as the system has it, until the user has chosen. */
export function followTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)"), kept = localStorage.getItem("aiorts-theme");
  const put = (/** @type {string} */ name) => { theme.value = document.documentElement.dataset.theme = name; };
  put(kept ?? (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", () => localStorage.getItem("aiorts-theme") ?? put(dark.matches ? "dark" : "light"));
}
