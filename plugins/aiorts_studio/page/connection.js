/**
 * The way to the server: a code is exchanged for a token, which opens the socket. A socket that was lost is opened
 * again; where the token is good no more, the user is asked for a code.
 */
import { connection, dropCalls, kernels, sendBy, take } from "./store.js";

const EXCHANGE = "/api/token", PAGE = "/api/page", ASKED = "/api/kernels";
/** Where the token is kept: for this tab, until it is closed. */
const KEPT = "aiorts-token";
const PAUSES_S = [0.3, 0.7, 1, 2, 3, 5];
/** Seconds without a server after which it is said to have ended; the page goes on trying. */
const ENDED_S = 6;
/** The status of a socket whose server ends, and says why. */
const OVER = 1001;

let token = sessionStorage.getItem(KEPT) ?? "";
/** @type {WebSocket | null} */
let socket = null;
let tries = 0, lostAt = 0, timer = 0, over = false;
/** Why the last connection ended, as the server said it; "" where it was cut. */
export let why = "";

/** A code in the page's address; it is removed from there at once. @returns {string} */
export function codeOfAddress() {
  const found = /^#(?:code=)?([\w-]{20,})$/.exec(location.hash);
  if (found) history.replaceState(null, "", location.pathname);
  return found ? found[1] : "";
}

/** Whether there is a token to try. */
export const hasToken = () => token !== "";

/** Exchange a code for a token, and connect. @param {string} code or the address that ends with it @returns {Promise<string>} why it was not taken; "" if it was */
export async function signIn(code) {
  let answer;
  try {
    answer = await fetch(EXCHANGE, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ code: code.trim().replace(/^.*#/, "") }) });
  } catch {
    return "aiorts studio does not answer. Does it still run?";
  }
  const body = await answer.json().catch(() => ({}));
  if (!answer.ok) return String(body.detail ?? body.title ?? `aiorts studio refused it (${answer.status}).`);
  token = body.token;
  sessionStorage.setItem(KEPT, token);
  connect();
  return "";
}

/** Open the socket. */
export function connect() {
  window.clearTimeout(timer);
  socket?.close();
  connection.value = tries ? connection.value : "opening";
  const own = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${PAGE}`);
  socket = own;
  own.onopen = () => own.send(JSON.stringify({ token }));
  own.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    if (message.t === "hello") {
      [tries, lostAt, why, over] = [0, 0, "", false];
      connection.value = "live";
    }
    take(message);
  };
  own.onclose = ({ code, reason }) => {
    if (socket !== own) return;
    socket = null;
    why = reason || why;
    over ||= code === OVER && reason !== "";
    dropCalls();
    lostAt ||= performance.now();
    void lost();
  };
}

/** Find out why the socket was lost: the token may be good no more, the server may be gone. */
async function lost() {
  let status = 0;
  try {
    status = (await fetch(ASKED, { headers: { authorization: `Bearer ${token}` } })).status;
  } catch { /* the server is gone, or not there yet */ }
  if (status === 401 || status === 403) {
    token = "";
    sessionStorage.removeItem(KEPT);
    tries = 0;
    connection.value = "closed";
    return;
  }
  const gone = over || (status === 0 && (why !== "" || performance.now() - lostAt > ENDED_S * 1000));
  connection.value = gone ? "ended" : "lost";
  timer = window.setTimeout(connect, 1000 * PAUSES_S[Math.min(tries++, PAUSES_S.length - 1)]);
}

sendBy((message) => {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
});

/** The kernels that are live. */
export const liveKernels = () => [...kernels.value.values()].filter((one) => one.state === "live");
