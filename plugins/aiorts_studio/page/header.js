/** What the whole system does, in one line; and the theme. */
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";
import { worstLoss } from "./panels/troubles.js";
import { flipTheme } from "./shell.js";
import { choose, connection, frameFigures, frames, kernels, keysOpen, missed, right, theme, totals } from "./store.js";
import { why } from "./connection.js";
import { count, counted, hasEnded, number } from "./words.js";

/** @import {Kernel, Total} from "./types.js" */

const html = htm.bind(h);

const LIVE = /** @type {Record<string, string>} */ ({ closed: "not signed in", opening: "connecting", lost: "connection lost, trying again", ended: "aiorts studio has ended" });

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
  const [words, kind] = howItIs();
  return html`<span class=${`live ${kind}`} role="status">${words}</span>`;
}

/** @returns {[string, "" | "partly" | "over" | "not"]} in words, and how good that is */
function howItIs() {
  const all = [...kernels.value.values()], silent = all.filter((one) => one.state === "silent"), ended = all.filter((one) => one.state === "ended");
  const names = (/** @type {Kernel[]} */ some) => some.map((one) => one.name).join(", ");
  if (connection.value === "ended") return [why || LIVE.ended, why ? "over" : "not"];
  if (connection.value !== "live") return [LIVE[connection.value], "not"];
  if (silent.length) return [`${names(silent)}: no answer`, "partly"];
  if (!all.length) return ["nothing runs", "over"];
  if (ended.length < all.length) return ["live", ""];
  return [ended.length === 1 ? `${ended[0].name} ${ended[0].why}` : `${names(ended)} have ended`, ended.every(hasEnded) ? "over" : "partly"];
}

/** @returns {[string, string, boolean, (() => void) | null][]} value, words, whether it is bad, what leads there */
function facts() {
  const all = [...totals.value.values()], sum = (/** @type {(one: Total) => number} */ of) => all.reduce((so, one) => so + of(one), 0);
  const known = all.some((one) => one.rate !== null), lost = sum((one) => one.dropped), worst = worstLoss();
  const late = [...frameFigures.value].reduce((most, one) => ((one[1].late ?? -1) > (most?.[1].late ?? -1) ? one : most), /** @type {[number, any] | null} */ (null));
  const shown = [...kernels.value.values()], names = shown.length === 1 ? shown[0].name : counted(shown.length, "kernel");
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
