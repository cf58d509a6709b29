/** Asks for the code of the server, where the address had none. */
import { h } from "./vendor/preact.js";
import { useSignal } from "./vendor/preact-signals.js";
import htm from "./vendor/htm.js";
import { signIn } from "./connection.js";
import { connection } from "./store.js";

const html = htm.bind(h);

/** @param {{first: string}} props first: why the code of the address was not taken */
export function SignIn({ first }) {
  const problem = useSignal(first), busy = useSignal(false);
  if (connection.value !== "closed") return null;
  const submit = async (/** @type {SubmitEvent} */ event) => {
    event.preventDefault();
    const field = /** @type {HTMLInputElement} */ (/** @type {HTMLFormElement} */ (event.target).elements.namedItem("code"));
    busy.value = true;
    problem.value = field.value.trim() ? await signIn(field.value) : "Put the address, or the code, here first.";
    busy.value = false;
    if (problem.value) field.select();
  };
  return html`<div class="veil"><form class="sign-in" onSubmit=${submit} aria-labelledby="sign-in">
    <h2 id="sign-in">Sign in</h2>
    <p>Open the address that <code>aiorts studio</code>, or <code>aiorts run FILE --studio</code>, prints; or put it here. It is good once, for a minute, and each start has another.</p>
    <label for="code">Address, or the code behind its #</label>
    <input id="code" name="code" autocomplete="off" autocapitalize="off" spellcheck=${false} autofocus aria-describedby="code-problem" aria-invalid=${Boolean(problem.value)} />
    <p id="code-problem" class="problem" role="alert">${problem.value}</p>
    <button class="main" disabled=${busy.value}>${busy.value ? "Asking…" : "Sign in"}</button>
    <p class="hint"><code>aiorts studio --url</code> prints a new address.</p>
  </form></div>`;
}
