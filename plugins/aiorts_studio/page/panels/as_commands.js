/** The commands that show or change what is selected, each with a button that copies it. */
import { copy } from "../commands.js";
import { html } from "./parts.js";

/** @param {{commands: import("../commands.js").Command[]}} props */
export function Commands({ commands }) {
  return html`<section aria-label="As commands"><h3 class="over">As commands</h3><ul class="commands">${commands.map(({ says, command }) => html`
    <li key=${command}><button onClick=${() => void copy(command)} aria-label=${`Copy the command that ${says}: ${command}`} title="Copy"><code>${command}</code><span>${says}</span></button></li>`)}</ul></section>`;
}
