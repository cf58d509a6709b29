/** Joins the parts of the page. */
import { h, render } from "./vendor/preact.js";
import { effect } from "./vendor/preact-signals.js";
import htm from "./vendor/htm.js";
import { followAddress } from "./address.js";
import { codeOfAddress, connect, hasToken, signIn } from "./connection.js";
import { Header, followTheme } from "./header.js";
import { Events } from "./panels/events.js";
import { Inspector } from "./panels/inspector.js";
import { Keys } from "./panels/keys.js";
import { Log } from "./panels/log.js";
import { Plots } from "./panels/plots.js";
import { Tree } from "./panels/tree.js";
import { pointing } from "./scene/pointing.js";
import { Scene } from "./scene/scene.js";
import { outline } from "./scene/outline.js";
import { Empty, Legend, Tools } from "./scene/tools.js";
import { moving } from "./scene/view.js";
import { Banner, Below, Toast, room, splitters } from "./shell.js";
import { SignIn } from "./sign_in.js";
import * as store from "./store.js";
import { walk } from "./walk.js";

const html = htm.bind(h);
const LOOKS_PER_SECOND = 10;
const NOTICE_MS = 5000;
/** A pointer that goes further has dragged what it was on, in px. */
const DRAGGED = 4;
/** The width of a window from which on the legend has room beside the buttons, in px. */
const WIDE = 1800;

followTheme();
render(html`<${Header} />`, room("header", ""));
render(html`<${Tree} />`, room("nav", "What runs"));
const main = room("main", "The system");
const scene = new Scene(main), view = kept(moving(main, scene));
const under = room("footer", "View and legend");
render(html`<${Legend} first=${window.innerWidth > WIDE} /><${Tools} view=${view} />`, under);
render(html`<${Inspector} />`, room("aside", "What is selected"));
const below = room("section", "Log, events and plots", "below");
render(html`<${Below} tabs=${{ Log, Events, Plots }} />`, below.appendChild(document.createElement("div")));
splitters(main, below);
render(html`<${Empty} />`, main.appendChild(document.createElement("div")));
const over = document.body.appendChild(document.createElement("div"));
const heard = document.body.appendChild(document.createElement("p"));
heard.className = "heard";
heard.setAttribute("aria-live", "polite");

const reveal = pointing(scene, view);
outline(scene);
walk(scene, view, (text) => { heard.textContent = text; });

// -- what the server is told of the view: not more than ten times a second; a hand that pans changes it all the time --

let look = 0, looked = "";
function sayView() {
  look ||= window.setTimeout(() => {
    look = 0;
    const { x0, y0, x1, y1 } = scene.rect(), rect = [x0, y0, x1, y1].map(Math.round);
    const message = { t: "view", rect, scale: Math.round(scene.scale * 1000) / 1000 }, text = JSON.stringify(message);
    if (text !== looked && store.say(message)) looked = text;
  }, 1000 / LOOKS_PER_SECOND);
}
scene.onView = sayView;

// -- all is kept in view, until a hand pans, zooms or moves a box; a fit takes that back ------------------------------

let held = false, before = "";
const placeOf = () => JSON.stringify(scene.view);
main.addEventListener("wheel", () => { held = true; }, { capture: true, passive: true });
main.addEventListener("pointerdown", ({ clientX, clientY }) => {
  const view = placeOf();
  window.addEventListener("pointerup", (event) => {
    const dragged = event.target instanceof Element && event.target.closest(".box") && Math.hypot(event.clientX - clientX, event.clientY - clientY) > DRAGGED;
    if (dragged || placeOf() !== view) held = true;
  }, { once: true, capture: true });
}, { capture: true });

/** The moves, which say whether a hand holds the view. @param {import("./scene/view.js").Moves} moves @returns {import("./scene/view.js").Moves} */
function kept(moves) {
  return {
    fit() {
      held = false;
      moves.fit();
    },
    by(factor) {
      held = true;
      moves.by(factor);
    },
    reveal: moves.reveal,
  };
}
store.on("picture", () => {
  looked = "";
  sayView();
  if (!held) view.fit();
});
store.on("change", (change) => {
  const size = [...store.frames.peek().values()].map(({ x, y, w, h }) => [x, y, w, h]).join();
  if (!held && size !== before && (change.frames || change.boxes || change.gone)) view.fit();
  before = size;
});
// The panel of what is selected may have opened upon it.
new ResizeObserver(() => { if (held) reveal(); else view.fit(); }).observe(main);

// -- signs of life -----------------------------------------------------------------------------------------------------

let clearing = 0;
effect(() => {
  if (!store.notice.value) return;
  window.clearTimeout(clearing);
  clearing = window.setTimeout(() => { store.notice.value = ""; }, NOTICE_MS);
});
effect(() => { document.body.classList.toggle("bare", !store.selected.value); });
effect(() => {
  document.body.classList.toggle("old", store.connection.value !== "live");
  document.title = [...store.kernels.value.values()].map((one) => one.name).slice(0, 2).concat("aiorts studio").join(" · ");
});
effect(() => {
  void store.theme.value;
  scene.resize();
});

store.on("problem", ({ problem }) => store.tell(problem.detail ?? problem.title ?? problem.text ?? "The server refused it"));

Object.assign(window, { studio: { scene, view, store } });   // for tests, and for the curious

followAddress();
const code = codeOfAddress();
const first = code ? await signIn(code) : "";
if (!code && hasToken()) connect();
render(html`<${Banner} /><${Toast} /><${SignIn} first=${first} /><${Keys} />`, over);
// The address of another run, opened in the same tab, changes what is behind the # alone.
window.addEventListener("hashchange", async () => {
  const another = codeOfAddress(), refused = another ? await signIn(another) : "";
  if (refused) store.tell(refused);
});
