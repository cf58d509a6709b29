/** The list of keys, as a dialog. */
import { useEffect, useRef } from "../vendor/preact-hooks.js";
import { keysOpen } from "../store.js";
import { KEYS } from "../walk.js";
import { CutTip, html } from "./parts.js";

export function Keys() {
  const dialog = useRef(/** @type {HTMLDialogElement | null} */ (null)), open = keysOpen.value;
  useEffect(() => {
    if (open && !dialog.current?.open) dialog.current?.showModal();
    if (!open) dialog.current?.close();
  }, [open]);
  const close = () => { keysOpen.value = false; };
  return html`<dialog class="keys" ref=${dialog} aria-labelledby="keys-title" onClose=${close}
      onClick=${(/** @type {MouseEvent} */ { target }) => target === dialog.current && close()}>
    <h2 id="keys-title">Keys</h2>
    <dl>${KEYS.map(({ keys, does }) => html`<div key=${keys}><dt>${keys.split(" ").map((one) => html`<kbd>${one}</kbd> `)}</dt><dd>${does}</dd></div>`)}</dl>
    <button onClick=${close}>Close</button>
  </dialog><${CutTip} />`;
}
