/** What the whole system does, in one line; and the theme. */
import { h } from "./vendor/preact.js";
import htm from "./vendor/htm.js";
import { boxes, choose, connection, edges, figures, frameFigures, frames, kernels, keysOpen, missed, right, theme } from "./store.js";
import { count, counted, number } from "./words.js";

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
    <button onClick=${flip}>${theme.value === "dark" ? "Light" : "Dark"}</button>`;
}

function Live() {
  const silent = [...kernels.value.values()].filter((one) => one.state === "silent");
  const words = connection.value !== "live" ? LIVE[connection.value] : silent.length ? `${silent.map((one) => one.name).join(", ")}: no answer` : "live";
  const kind = connection.value === "live" ? (silent.length ? "partly" : "") : "not";
  return html`<span class=${`live ${kind}`} role="status">${words}</span>`;
}

/** @returns {[string, string, boolean, (() => void) | null][]} value, words, whether it is bad, what leads there */
function facts() {
  const rows = [...figures.value];
  const known = rows.filter(([, row]) => row.rate !== null), passing = known.reduce((sum, [, row]) => sum + (row.rate ?? 0), 0);
  const lost = rows.reduce((sum, [, row]) => sum + row.dropped, 0), unknown = rows.filter(([, row]) => row.lossy && !row.dropped);
  const worst = rows.reduce((most, one) => (one[1].dropped > (most?.[1].dropped ?? 0) ? one : most), /** @type {typeof rows[0] | null} */ (null));
  const late = [...frameFigures.value].reduce((most, one) => ((one[1].late ?? -1) > (most?.[1].late ?? -1) ? one : most), /** @type {[number, any] | null} */ (null));
  const live = [...kernels.value.values()].filter((one) => one.state !== "ended"), names = live.length === 1 ? live[0].name : counted(live.length, "kernel");
  /** @type {[string, string, boolean, (() => void) | null][]} */
  const all = [
    [names, `${counted(boxes.value.size, "component")}, ${counted(edges.value.size, "connector")}`, false, null],
    [known.length ? `${number(passing)}/s` : "–", "samples in view", false, null],
    lost || !unknown.length ? [count(lost), "samples dropped", lost > 0, worst ? () => choose("edge", worst[0], { focus: true }) : null]
      : [counted(unknown.length, "connector"), unknown.length === 1 ? "drops samples" : "drop samples", true, () => choose("edge", unknown[0][0], { focus: true })],
  ];
  if (late && late[1].late !== null) {
    all.push([`${number(late[1].late)} ms`, `late (p99) in ${frames.value.get(late[0])?.name ?? "?"}`, false, () => choose("frame", late[0])]);
  }
  return all;
}

/** Light or dark: as the system has it, until the user has chosen. */
export function followTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)"), kept = localStorage.getItem("aiorts-theme");
  const put = (/** @type {string} */ name) => { theme.value = document.documentElement.dataset.theme = name; };
  put(kept ?? (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", () => localStorage.getItem("aiorts-theme") ?? put(dark.matches ? "dark" : "light"));
}

function flip() {
  theme.value = document.documentElement.dataset.theme = theme.value === "dark" ? "light" : "dark";
  localStorage.setItem("aiorts-theme", theme.value);
}
