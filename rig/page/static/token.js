// The token of a bench that has one: asked once, when the bench answers 401.

import { hasToken, inWords, makeSession, Refused, setToken } from "./api.js";
import { $, sayOrHide } from "./dom.js";

let trying = false;

/** Give the bench a token; the bench answers with a session cookie for what can set no header. */
async function offer(value, keep) {
  trying = true;
  setToken(value, keep);
  try {
    await makeSession();
    $("token-panel").hidden = true;
    sayOrHide($("token-said"), null);
    $("token").value = "";
    $("forget").hidden = false;
    document.dispatchEvent(new CustomEvent("token-given"));
  } catch (fault) {
    const wrong = fault instanceof Refused && (fault.status === 401 || fault.status === 403);
    if (wrong) setToken(null);
    $("token-panel").hidden = false;
    sayOrHide($("token-said"), wrong ? "The bench did not take this token." : `Not sent: ${inWords(fault)}.`);
  } finally {
    trying = false;
  }
}

export function setUpToken() {
  $("forget").hidden = !hasToken();
  document.addEventListener("token-needed", () => {
    if (!trying) $("token-panel").hidden = false;
  });
  $("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    offer($("token").value.trim(), $("token-keep").checked);
  });
  $("forget").addEventListener("click", () => {
    setToken(null);
    $("forget").hidden = true;
  });
}
