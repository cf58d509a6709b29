/** The commands that show or change what is selected, each with a button that copies it. */
import { copy } from "../commands.js";
import { html } from "./parts.js";

/** @param {{commands: import("../commands.js").Command[]}} props */
export function Commands({ commands }) {
  return html`<section aria-label="As commands"><h3 class="over">As commands</h3><ul class="commands">${commands.map(({ says, command }) => html`
    <li key=${command}><button onClick=${() => void copy(command)} title="Copy"><code>${command}</code><span>${says}</span><${CopyIcon} /></button></li>`)}</ul></section>`;
}

/** What says of a button that it copies. */
export const CopyIcon = () => html`<svg class="copies" viewBox="0 0 16 16" aria-hidden="true"><rect x="5.5" y="5.5" width="8" height="9" rx="1.5" /><path d="M10.5 3V2.5a1 1 0 0 0 -1 -1H3.5a1 1 0 0 0 -1 1V10a1 1 0 0 0 1 1H4" /></svg>`;
