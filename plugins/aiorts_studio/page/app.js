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
/** The width from which on the legend has room beside the buttons, in px. */
const WIDE = 1000;

followTheme();
render(html`<${Header} />`, room("header", ""));
render(html`<${Tree} />`, room("nav", "What runs"));
const main = room("main", "The system");
const scene = new Scene(main), view = moving(main, scene);
render(html`<${Inspector} />`, room("aside", "What is selected"));
const below = room("section", "Log, events and plots", "below");
render(html`<${Below} tabs=${{ Log, Events, Plots }} />`, below.appendChild(document.createElement("div")));
splitters(main, below);
const upon = main.appendChild(document.createElement("div"));
upon.className = "upon";
render(html`<${Legend} first=${main.clientWidth > WIDE} /><${Tools} view=${view} />`, upon);
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

// -- the first picture is fitted; and as long as no hand has moved the view, so is a layout that comes later -----------

let touched = false, fitted = false;
for (const kind of ["wheel", "pointerdown", "keydown"]) main.addEventListener(kind, () => { touched = true; }, { capture: true, passive: true });
store.on("picture", () => {
  looked = "";
  sayView();
  if (!touched || !fitted) view.fit();
  fitted ||= store.boxes.peek().size > 0;
});
store.on("change", ({ boxes = [], frames = [] }) => {
  if (!touched && boxes.length + frames.length) view.fit();
});
store.on("choose", () => { touched = true; });
// The panel of what is selected may have opened upon it.
new ResizeObserver(() => { if (touched) reveal(); else view.fit(); }).observe(main);

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
