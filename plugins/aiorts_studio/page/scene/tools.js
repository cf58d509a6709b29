/** The buttons and the legend upon the scene. */
import { h } from "../vendor/preact.js";
import { useSignal } from "../vendor/preact-signals.js";
import htm from "../vendor/htm.js";
import { boxes, connection, infrastructure, kernels, say } from "../store.js";
import { copySelected, tidy } from "../walk.js";

const html = htm.bind(h);

const SIGNS = [
  ["in-port", html`<circle class="port in" cx="9" cy="8" r="5.5" />`],
  ["out-port", html`<path class="port out" d="M4 1.5L16 8L4 14.5Z" />`],
  ["service", html`<rect class="port service" x="4" y="3" width="10" height="10" rx="2" />`],
  ["link", html`<g class="edge-of link"><path class="line" d="M0 8H20" /><path class="core" d="M0 8H20" /></g>`],
  ["drops samples", html`<g class="edge-of lossy"><path class="line" d="M0 8H20" /></g>`],
  ["down", html`<g class="edge-of down"><path class="line" d="M0 8H20" /></g>`],
];

/** @param {{first: boolean}} props first: whether it is open at first, as there is room for it */
export function Legend({ first }) {
  const open = useSignal(first);
  return html`<div class="legend"><button aria-expanded=${open.value} onClick=${() => { open.value = !open.value; }}>Legend</button>
    ${open.value && html`<ul aria-label="Legend">${SIGNS.map(([word, sign]) => html`
      <li key=${word}><svg viewBox="0 0 20 16" aria-hidden="true">${sign}</svg>${word}</li>`)}</ul>`}</div>`;
}

/** What is said where there is nothing to see. */
export function Empty() {
  if (connection.value !== "live" || boxes.value.size || kernels.value.size) return null;
  return html`<div class="empty" role="status"><b>Nothing runs yet</b>
    <span>It appears here as soon as it does. For example:</span><code>aiorts run examples/roomba/system.toml</code></div>`;
}

/** @param {{view: import("./view.js").Moves}} props */
export function Tools({ view }) {
  const hide = () => {
    infrastructure.value = !infrastructure.value;
    say({ t: "infrastructure", on: infrastructure.value });
  };
  return html`<div class="tools" role="toolbar" aria-label="View">
    <button aria-pressed=${!infrastructure.value} onClick=${hide} title="Hide what only carries, records or shows">Hide infrastructure</button>
    <button onClick=${copySelected} title="Copy the command that shows what is selected (c)">Copy command</button>
    <button onClick=${tidy} title="Lay out everything anew (t)">Tidy</button>
    <button onClick=${view.fit} title="Show everything (0)">Fit</button>
    <span class="pair"><button aria-label="Zoom out" title="Zoom out (−)" onClick=${() => view.by(0.8)}>−</button>
    <button aria-label="Zoom in" title="Zoom in (+)" onClick=${() => view.by(1.25)}>+</button></span></div>`;
}
