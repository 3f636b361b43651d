// STOP: one press, no question asked, said again until the bench has answered or ten seconds have passed.

import { askStop, inWords, Refused } from "./api.js";
import { $, sayOrHide } from "./dom.js";
import { duration } from "./format.js";

const INSIST_S = 10;
const ANSWER_S = 16; // the bench itself waits 15 s for its instruments
const SLOW_MS = 1000;
export const BY_HAND = "Switch the controller off by hand.";
let latest = 0; // every press is sent at once, also while an earlier one waits for its answer; the latest one tells

/** Send STOP until it is answered or ten seconds have passed. send(timeout_s) sends it once, tell(text) shows how it
 * stands (null: nothing to say), wanted() is false when a later press has taken over. The answer with `sure` and `took`,
 * or null where none came. */
export async function insist(send, tell, wanted) {
  const begin = performance.now();
  const slow = setTimeout(() => tell("STOP was sent. The bench has not answered yet."), SLOW_MS);
  let wait_ms = 100;
  try {
    for (let count = 1; wanted(); count += 1) {
      try {
        const answer = await send(ANSWER_S);
        if (!wanted()) return null;
        const took_ms = performance.now() - begin;
        const took = took_ms < 1000 ? `${Math.round(took_ms)} ms` : duration(took_ms / 1000);
        const sure = answer?.off === true && answer?.confirmed === true;
        tell(sure ? null : `STOP was sent, but the output is NOT CONFIRMED off. ${BY_HAND}`);
        return { sure, took };
      } catch (fault) {
        clearTimeout(slow);
        const over = performance.now() - begin > INSIST_S * 1000;
        const certain = fault instanceof Refused && fault.status < 500; // asking again would change nothing
        const next = over || certain ? `${BY_HAND} Or press STOP again.` : `Trying again (${count}) …`;
        tell(`STOP did not reach the bench: ${inWords(fault)}. ${next}`);
        if (over || certain) return null;
        await new Promise((resolve) => setTimeout(resolve, wait_ms));
        wait_ms = Math.min(1000, wait_ms * 2);
      }
    }
    return null;
  } finally {
    clearTimeout(slow);
  }
}

/** Press STOP. `answered` is told when the bench has answered, so that the state is read anew. */
async function press(answered) {
  latest += 1;
  const mine = latest;
  const wanted = () => mine === latest;
  const button = $("stop");
  button.dataset.busy = "";
  const answer = await insist(askStop, (text) => wanted() && sayOrHide($("stop-said"), text), wanted);
  if (answer !== null) document.dispatchEvent(new CustomEvent("stopped", { detail: answer }));
  if (!wanted()) return;
  delete button.dataset.busy;
  answered();
}

const inField = (node) => node instanceof Element && node.matches("input:not([type=checkbox]), textarea, select");

/** The button, and the keys Escape and Shift+S. */
export function setUpStop(answered) {
  $("stop").addEventListener("click", () => press(answered));
  document.addEventListener("keydown", (event) => {
    if (event.isComposing || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key === "Escape") {
      event.preventDefault();
      if (inField(event.target)) event.target.blur();
      else press(answered);
    } else if (event.key === "S" && event.shiftKey && !inField(event.target)) {
      event.preventDefault();
      press(answered);
    }
  });
}
