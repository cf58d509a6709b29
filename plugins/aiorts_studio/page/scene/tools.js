/** The buttons and the legend upon the scene. */
import { h } from "../vendor/preact.js";
import { useSignal } from "../vendor/preact-signals.js";
import htm from "../vendor/htm.js";
import { boxes, connection, infrastructure, kernels } from "../store.js";
import { copySelected, hideInfrastructure, tidy } from "../walk.js";
import { counted, letterOf } from "../words.js";
import { onlyLooks } from "./world.js";

const html = htm.bind(h);

const SIGNS = [
  ["in-port", html`<circle class="port in" cx="9" cy="8" r="5.5" />`],
  ["out-port", html`<path class="port out" d="M4 1.5L16 8L4 14.5Z" />`],
  ["service", html`<rect class="port service" x="4" y="3" width="10" height="10" rx="2" />`],
  ["link", html`<g class="edge-of link"><path class="line" d="M0 8H20" /><path class="core" d="M0 8H20" /></g>`],
  ["connector", html`<g class="edge-of busy"><path class="line" d="M0 8H20" /></g>`],
  ["loses samples", html`<g class="edge-of lossy"><path class="line" d="M0 8H20" /></g>`],
  ["nearly full", html`<g class="edge-of full"><path class="line" d="M0 8H20" /></g>`],
  ["down", html`<g class="edge-of down"><path class="line" d="M0 8H20" /><path class="cross" d="M5.5 3.5L14.5 12.5M14.5 3.5L5.5 12.5" /></g>`],
];

/** @param {{first: boolean}} props first: whether it is open at first, as there is room for it */
export function Legend({ first }) {
  const kept = localStorage.getItem("aiorts-legend"), open = useSignal(kept === null ? first : kept === "open");
  const turn = () => {
    open.value = !open.value;
    localStorage.setItem("aiorts-legend", open.value ? "open" : "closed");
  };
  return html`<div class="legend"><button aria-expanded=${open.value} onClick=${turn}>Legend</button>
    ${open.value && html`<ul aria-label="Legend">${SIGNS.map(([word, sign]) => html`
      <li key=${word}><svg viewBox="0 0 20 16" aria-hidden="true">${sign}</svg>${word}</li>`)}${["active", "inactive", "error", "silent", "ended"].map((state) => html`
      <li key=${state}><span class=${`badge is-${state}`} aria-hidden="true">${letterOf(state)}</span>${state}</li>`)}</ul>`}</div>`;
}

/** What is said where there is nothing to see. */
export function Empty() {
  if (connection.value !== "live" || boxes.value.size || kernels.value.size) return null;
  return html`<div class="empty" role="status"><b>Nothing runs yet</b>
    <span>It appears here as soon as it does. For example:</span><code>aiorts run examples/roomba/system.toml</code></div>`;
}

/** @param {{view: import("./view.js").Moves}} props */
export function Tools({ view }) {
  const some = [...boxes.value.values()].filter(onlyLooks).length;
  return html`<div class="tools" role="toolbar" aria-label="View">
    <button disabled=${!some && infrastructure.value} onClick=${hideInfrastructure}
      title=${some ? `Hide what only records or shows: ${counted(some, "component")}` : "Nothing to hide: no component here only records or shows"}>${infrastructure.value ? "Hide" : "Show"} infrastructure${some > 0 && ` (${some})`}</button>
    <button onClick=${copySelected} title="Copy the command that shows what is selected (c)">Copy command</button>
    <button onClick=${tidy} title="Lay out everything anew (t)">Tidy</button>
    <button onClick=${view.fit} title="Show everything (0)">Fit</button>
    <span class="pair"><button aria-label="Zoom out" title="Zoom out (−)" onClick=${() => view.by(0.8)}>−</button>
    <button aria-label="Zoom in" title="Zoom in (+)" onClick=${() => view.by(1.25)}>+</button></span></div>`;
}
