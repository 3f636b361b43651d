// Requests to the bench: the header it asks for, the token where it wants one, faults as objects.

const KEY = "peltier-token";
let token = stored();

function stored() {
  try {
    return sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY);
  } catch {
    return null; // a browser that keeps nothing
  }
}

export const hasToken = () => token !== null;

/** Use this token from now on; keep it on the device where the user said so. Null forgets it. */
export function setToken(value, keep = false) {
  token = value;
  try {
    sessionStorage.removeItem(KEY);
    localStorage.removeItem(KEY);
    if (value !== null) (keep ? localStorage : sessionStorage).setItem(KEY, value);
  } catch {
    // kept in this page only
  }
}

/** The bench answered, with something else than success. */
export class Refused extends Error {
  constructor(status, body) {
    super(typeof body?.error === "string" ? body.error : `the bench answered ${status}`);
    this.status = status;
    this.body = body;
  }
}

/** One request; the answer's JSON. Raises Refused, or TypeError and AbortError where no answer came. */
export async function ask(method, path, body = undefined, { timeout_s = 10, signal = null, urgent = false } = {}) {
  const headers = { Accept: "application/json" };
  if (method !== "GET") Object.assign(headers, { "Content-Type": "application/json", "X-Peltier": "1" });
  if (token !== null) headers.Authorization = `Bearer ${token}`;
  const abort = new AbortController();
  const timer = setTimeout(() => abort.abort(), timeout_s * 1000);
  signal?.addEventListener("abort", () => abort.abort(), { once: true });
  try {
    const answer = await fetch(path, {
      method, headers, signal: abort.signal, cache: "no-store", credentials: "same-origin",
      body: method === "GET" ? undefined : JSON.stringify(body ?? {}),
      priority: urgent ? "high" : "auto", keepalive: urgent,
    });
    const text = await answer.text();
    let content = null;
    try {
      content = text ? JSON.parse(text) : null;
    } catch {
      content = { error: text.slice(0, 300) };
    }
    if (answer.ok) return content;
    if (answer.status === 401) document.dispatchEvent(new CustomEvent("token-needed"));
    throw new Refused(answer.status, content);
  } finally {
    clearTimeout(timer);
  }
}

let stopPort = null;

/** The port of STOP's own listener on this host; null where there is none. */
export const setStopPort = (port) => {
  stopPort = Number.isInteger(port) ? port : null;
};

/** A name for one press of STOP. */
export const newPress = () =>
  Array.from(crypto.getRandomValues(new Uint32Array(3)), (part) => part.toString(36)).join("");

/** STOP, to its own listener and to the page's address at once; the first answer counts. Both say which press they are
 * of, so that the later one does not stop what a reset has let go on. Raises what the bench said, if it said something. */
export async function askStop(timeout_s) {
  const press = newPress();
  const ways = ["/api/stop"];
  // behind a proxy with TLS a browser sends nothing without; there the page's own address has to do
  if (stopPort !== null && location.protocol === "http:") ways.push(`//${location.hostname}:${stopPort}/api/stop`);
  try {
    return await Promise.any(ways.map((way) => ask("POST", way, { press }, { timeout_s, urgent: true })));
  } catch (all) {
    throw all.errors.find((one) => one instanceof Refused) ?? all.errors[0];
  }
}

/** A cookie for what can set no header (the live stream, reports); nothing to do where no token is asked. */
export async function makeSession() {
  if (token !== null) await ask("POST", "/api/session", { token });
}

/** What went wrong, in words. */
export function inWords(fault) {
  if (fault instanceof Refused) {
    if (fault.status === 401) return "the bench asks for its token";
    const faults = fault.body?.faults;
    return Array.isArray(faults) && faults.length ? faults.join("; ") : fault.message;
  }
  return "the bench does not answer";
}
