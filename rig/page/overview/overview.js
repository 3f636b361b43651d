// The page of several benches: how each is, when it was last heard of, and a STOP for each.

import { ask, newPress } from "./shared/api.js";
import { $, icon, make, say, sayOrHide } from "./shared/dom.js";
import { degrees, duration, ohms, when } from "./shared/format.js";
import { BY_HAND, insist } from "./shared/stop.js";
import { Stream } from "./shared/stream.js";
import { setUpToken } from "./shared/token.js";

const WORDS = { idle: "Idle", running: "Running", stopped: "Stopped", tripped: "Tripped", offline: "Offline",
  lost: "No answer" };
const SILENT_S = 2.9; // the overview tells about every bench once a second, and of one that is silent after 2.5 s
const FRESH_S = 5; // the bench's own page calls a reading stale from here on
const cards = new Map();
let linked = false;
let told = null;
let toldAt = 0; // performance.now()

/** Seconds since a bench was last heard of; null where it never was. */
function silence(bench) {
  return bench.silent_s === null ? null : bench.silent_s + (performance.now() - toldAt) / 1000;
}

function stateOf(bench) {
  const silent_s = silence(bench);
  if (!linked || bench.trouble || silent_s === null || silent_s > SILENT_S) return "lost";
  return WORDS[bench.state?.state] ? bench.state.state : "offline";
}

function card(name) {
  const parts = {
    link: make("a", { rel: "noreferrer" }), sign: make("span"), word: make("span"), output: make("p", { class: "output" }),
    stop: make("button", { type: "button", class: "stop", "aria-label": `STOP ${name}` }, "STOP"),
    said: make("p", { class: "said", role: "alert", hidden: true }), temperature: make("dd"), resistance: make("dd"),
    about: make("p", { class: "about" }), heard: make("p", { class: "heard" }),
  };
  const state = make("p", { class: "state" }, parts.sign, parts.word);
  parts.root = make("li", { class: "bench", "data-bench": name },
    make("div", { class: "top" }, make("div", { class: "told" }, make("h2", {}, parts.link), state, parts.output), parts.stop),
    parts.said,
    make("dl", { class: "values" }, make("div", {}, make("dt", {}, "Temperature"), parts.temperature),
      make("div", {}, make("dt", {}, "Resistance"), parts.resistance)),
    parts.about, parts.heard);
  let latest = 0;
  parts.stop.addEventListener("click", async () => {
    latest += 1;
    const mine = latest;
    const wanted = () => mine === latest;
    const press = newPress();
    const send = (timeout_s) => ask("POST", "/api/stop", { bench: name, press }, { timeout_s, urgent: true });
    parts.stop.dataset.busy = "";
    await insist(send, (text) => wanted() && sayOrHide(parts.said, text), wanted);
    if (wanted()) delete parts.stop.dataset.busy;
  });
  return parts;
}

function outputOf(bench, state) {
  if (state === "lost") return ["output not known", false];
  const { output, output_confirmed: sure } = bench.state;
  if (output === "on") return ["output on", true];
  if (output === "off") return sure ? ["output off, confirmed", true] : ["output off, NOT confirmed", false];
  return ["output NOT KNOWN", false];
}

function value(node, number, unit) {
  if (node.childElementCount === 0) node.replaceChildren(make("span"), " ", make("small"));
  say(node.firstChild, number);
  say(node.lastChild, unit);
}

function heardOf(bench, state) {
  if (!linked) return "this page has no connection to the overview";
  const silent_s = silence(bench);
  const ago = silent_s === null ? null : silent_s < 10 ? `${Math.floor(silent_s)} s` : duration(silent_s);
  const heard = ago === null ? "never heard of" : ago === "0 s" ? "last heard just now" : `last heard ${ago} ago`;
  if (state === "lost") return bench.trouble ? `${heard}: ${bench.trouble}` : heard;
  const old_s = bench.state.time_s - bench.state.reading?.time_s; // NaN before the first reading
  return old_s > FRESH_S ? `${heard}, its reading ${duration(old_s)} old` : heard;
}

/** What is wrong with a bench's instruments, also of one that is tripped; nothing where they answer. */
const offlineOf = (known) => (known?.warnings ?? []).find((line) => line.startsWith("offline: "));

/** What latched, else what is wrong with the instruments, else what runs: [text, whether it is a reason to look]. */
function aboutOf(known) {
  const why = known?.trip ?? known?.stop;
  if (why) {
    const cause = known.trip ? `${String(why.cause).replaceAll("_", " ")}: ` : "";
    const byHand = why.cause === "not_confirmed_off" ? `${BY_HAND} ` : "";
    return [`${byHand}${cause}${why.text}, ${when(why.at_s)}`, true];
  }
  const offline = offlineOf(known);
  if (offline) return [offline.slice(9), true];
  const job = known?.job;
  if (!job) return [known?.queue ? `${known.queue} waiting` : "", false];
  return [`${job.name} · ${job.phase} · ${duration(job.done_s)}${job.total_s > 0 ? ` of ${duration(job.total_s)}` : ""}`, false];
}

/** A line that may be cut on its card, and whole where the pointer rests on it. */
function sayWhole(node, text) {
  say(node, text);
  if (node.title !== text) node.title = text;
}

function show(bench) {
  const state = stateOf(bench);
  const parts = cards.get(bench.name);
  const { state: known } = bench;
  if (parts.root.dataset.state !== state) {
    parts.root.dataset.state = state;
    parts.sign.replaceChildren(icon(state === "lost" ? "unknown" : state));
  }
  const old = state === "lost" || state === "offline" || Boolean(offlineOf(known));
  parts.root.toggleAttribute("data-old", old);
  if (parts.link.getAttribute("href") !== bench.address) parts.link.href = bench.address;
  say(parts.link, bench.name);
  say(parts.word, WORDS[state]);
  const [output, sure] = outputOf(bench, state);
  say(parts.output, output);
  parts.output.dataset.sure = sure ? "yes" : "no";
  value(parts.temperature, degrees(known?.reading?.temperature_degC), "°C");
  value(parts.resistance, ...ohms(known?.reading?.resistance_ohm));
  const [about, look] = aboutOf(known);
  sayWhole(parts.about, about);
  parts.about.toggleAttribute("data-look", look);
  sayWhole(parts.heard, heardOf(bench, state));
  return state;
}

function summary(states) {
  const count = (state) => states.filter((one) => one === state).length;
  const bad = ["tripped", "lost", "offline"].filter((state) => count(state));
  const good = ["running", "idle", "stopped"].filter((state) => count(state));
  const texts = [...bad, ...good].map((state) => `${count(state)} ${WORDS[state].toLowerCase()}`);
  const text = texts.join(", ");
  if ($("summary").textContent !== text) {
    $("summary").replaceChildren(...texts.flatMap((one, k) => [k ? ", " : "", k < bad.length ? make("b", {}, one) : one]));
  }
  document.title = `${bad.length ? "! " : ""}${text} · benches`;
  const sign = bad.length ? "tripped" : count("running") ? "running" : "quiet";
  if ($("favicon").getAttribute("href") !== `icons/${sign}.svg`) $("favicon").setAttribute("href", `icons/${sign}.svg`);
}

function render() {
  $("link").dataset.link = linked ? "live" : "lost";
  say($("link-word"), linked ? "live" : $("token-panel").hidden ? "no connection" : "waits for the token");
  if (told === null) return;
  const names = told.benches.map((bench) => bench.name);
  if (names.join("\n") !== [...cards.keys()].join("\n")) {
    cards.clear();
    for (const name of names) cards.set(name, card(name));
    $("benches").replaceChildren(...[...cards.values()].map((parts) => parts.root));
  }
  summary(told.benches.map(show));
}

function take(kind, content) {
  if (kind !== "state") return;
  told = content;
  toldAt = performance.now();
  document.body.dataset.state = "idle";
  render();
}

setUpToken();
document.addEventListener("token-needed", render);
new Stream(take, (word) => {
  linked = word === "live";
  render();
}).open();
setInterval(render, 500);
