/** Answers of kernels that panels show: asked for again while they are shown, the last one kept while one is awaited. */
import { useEffect } from "../vendor/preact-hooks.js";
import { useSignal } from "../vendor/preact-signals.js";
import { ask, connection } from "../store.js";

/** @typedef {{value: any, problem: string}} Answer */

/**
 * @param {string} kernel its address @param {string} operation @param {object} args
 * @param {number} every ms; 0: once. A page that is not in sight asks five times less often
 * @returns {Answer} value: undefined before the first answer
 */
export function useAnswer(kernel, operation, args, every) {
  const answer = useSignal(/** @type {Answer} */ ({ value: undefined, problem: "" })), live = connection.value === "live";
  useEffect(() => { answer.value = { value: undefined, problem: "" }; }, [kernel, operation, JSON.stringify(args)]);
  useEffect(() => {
    let over = !live, timer = 0;
    const again = async () => {
      try {
        const value = await ask(kernel, operation, args);
        if (!over) answer.value = { value, problem: "" };
      } catch (error) {
        if (!over) answer.value = { value: answer.peek().value, problem: error instanceof Error ? error.message : String(error) };
      }
      if (!over && every) timer = window.setTimeout(again, document.hidden ? 5 * every : every);
    };
    if (!over) void again();
    return () => {
      over = true;
      window.clearTimeout(timer);
    };
  }, [kernel, operation, JSON.stringify(args), every, live]);
  return answer.value;
}
