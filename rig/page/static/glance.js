// What is seen at a glance: the state, the output, the run, the latest reading and how old it is.

import { $, icon, make, say, sayOrHide } from "./dom.js";
import { amperes, degrees, duration, ohms, ohmsShort, share, when } from "./format.js";
import { BY_HAND } from "./stop.js";

const STALE_S = 5;
const WORDS = { idle: "Idle", running: "Running", stopped: "Stopped", tripped: "Tripped", offline: "Offline" };
const ICONS = { idle: "quiet", running: "running", stopped: "stopped", tripped: "tripped" };
const OFFLINE = "the instruments do not answer";

let state = null;
let linked = false;
let seen = null; // performance.now() of the latest reading
let reading = null;
let patience_s = STALE_S; // longer where the bench, idle, reads seldom
let stateSeen = 0;
let took = null; // from STOP on this page to the bench's answer

export const latestState = () => state;

/** Whether the bench drives a heater, which takes a share of full drive in the place of a current. */
export const heater = () => Boolean(state?.drive_unit) && state.drive_unit !== "A";

const whole = (seconds) => (seconds < 10 ? `${Math.round(seconds)} s` : duration(seconds));
const waitsForToken = () => !$("token-panel").hidden;

/** Seconds since the latest reading; null before the first. */
const age = () => (seen === null ? null : (performance.now() - seen) / 1000);

export function showState(next) {
  const known = reading?.time_s;
  state = next;
  if (next.state !== "stopped" && next.state !== "running") took = null;
  stateSeen = performance.now();
  if (next.reading && next.reading.time_s !== known) {
    const old_s = Math.max(0, (next.time_s ?? 0) - (next.reading.time_s ?? 0));
    showReading({ ...next.reading }, Number.isFinite(old_s) ? old_s : 0);
  }
  render();
}

export function showLink(link) {
  if (linked === (link === "live")) return;
  linked = link === "live";
  render();
}

export function showReading(row, old_s = 0) {
  const gap_s = row.time_s - (reading?.time_s ?? row.time_s);
  patience_s = Math.max(STALE_S, 2.5 * Math.min(60, gap_s || 0));
  reading = row;
  seen = performance.now() - old_s * 1000;
  tile("temperature", degrees(row.temperature_degC), "°C");
  tile("current", ...(heater() ? [share(row.current_A), "of full"] : [amperes(row.current_A), "A"]));
  tile("resistance", ...ohms(row.resistance_ohm));
  const limits = state?.limits ?? {};
  const [low, high] = limits.temperature_degC ?? [null, null];
  gauge("temperature", row.temperature_degC, low, high);
  gauge("current", row.current_A, heater() ? 0 : -limits.current_A, limits.current_A);
  const setpoint = row.setpoint_degC ?? null;
  note("temperature", [setpoint === null ? null : `setpoint ${degrees(setpoint)}`,
    low === null ? null : `limits ${low} to ${high}`]);
  note("current", [limits.current_A ? `limit ${heater() ? "" : "±"}${limits.current_A}` : null]);
  const target = row.target_ohm ?? null;
  const miss = target > 0 && row.resistance_ohm > 0 ? Math.log10(row.resistance_ohm / target) : null;
  note("resistance", [target === null ? "no target" : `target ${ohmsShort(target)}`,
    miss === null ? null : `off by ${miss < 0 ? "−" : "+"}${Math.abs(miss).toFixed(3)} decades`]);
  freshness();
}

function tile(name, number, unit) {
  const root = $(`tile-${name}`);
  say(root.querySelector(".number"), number);
  say(root.querySelector(".unit"), unit);
}

/** What stands under a value; each part a line of its own on a phone. */
function note(name, parts) {
  const line = $(`tile-${name}`).querySelector(".note");
  const texts = parts.filter(Boolean);
  if (line.children.length !== texts.length) line.replaceChildren(...texts.map(() => make("span")));
  texts.forEach((text, k) => say(line.children[k], text));
}

function gauge(name, value, low, high) {
  const bar = $(`tile-${name}`).querySelector(".gauge");
  bar.hidden = !(Number.isFinite(value) && Number.isFinite(low) && high > low);
  if (!bar.hidden) bar.firstElementChild.style.left = `${100 * Math.min(1, Math.max(0, (value - low) / (high - low)))}%`;
}

/** 'stale' on every tile where no reading came for some seconds; the quality where it is not good. */
function freshness() {
  const old = age();
  const stale = old !== null && old > patience_s;
  const quality = reading?.quality && reading.quality !== "good" ? reading.quality : null;
  $("tiles").toggleAttribute("data-stale", stale);
  for (const chip of document.querySelectorAll("#tiles .chip")) {
    const word = stale ? `stale, ${whole(old)}` : quality;
    chip.hidden = !word;
    if (word && chip.lastChild?.textContent !== word) chip.replaceChildren(icon("stale"), document.createTextNode(word));
  }
  const link = $("link");
  const [kind, word] = waitsForToken() ? ["lost", "waits for the token"]
    : !linked ? ["lost", `no connection${state ? `, last heard ${whole((performance.now() - stateSeen) / 1000)} ago` : ""}`]
    : stale ? ["stale", `connected, but the reading is ${whole(old)} old`] : ["live", "live"];
  link.dataset.link = kind;
  say($("link-word"), word);
}

function output() {
  if (!state) return ["output not known", true];
  if (!linked) return ["no connection: output not known", false];
  if (state.output === "on") return ["output on", true];
  if (state.output === "off" && state.output_confirmed) return ["output off, confirmed", true];
  if (state.output === "off") return ["output off, NOT confirmed", false];
  return ["output NOT KNOWN", false];
}

/** What the controller drives with, where it stands beside numbers. */
function drive() {
  const [what, unit] = heater() ? ["Drive", "of full"] : ["Current", "A"];
  const title = $("tile-current").querySelector("h2").firstChild;
  if (title.data !== `${what} `) title.data = `${what} `;
  say($("plot-current").querySelector("figcaption"), `${what}, ${unit}`);
}

function render() {
  const name = !state ? "connecting" : linked ? (WORDS[state.state] ? state.state : "offline") : "lost";
  document.body.dataset.state = name;
  const word = WORDS[name] ?? (waitsForToken() ? "Token needed" : name === "lost" ? "No connection" : "Connecting");
  say($("state-word"), word);
  say($("bench-name"), state?.name ?? "");
  const sign = name === "connecting" || name === "lost" ? "unknown" : name;
  $("state-icon").firstElementChild.setAttribute("href", `icons/set.svg#${sign}`);
  const [text, sure] = output();
  say($("output"), text);
  $("output").dataset.sure = sure ? "yes" : "no";
  document.title = `${name === "tripped" ? "! " : ""}${word} · ${state?.name ?? "bench"}`;
  const favicon = `icons/${ICONS[name] ?? "quiet"}.svg`;
  if ($("favicon").getAttribute("href") !== favicon) $("favicon").setAttribute("href", favicon);
  job(name);
  drive();
  latch(name);
  facts();
  freshness();
}

function job(name) {
  const line = $("job-line");
  const running = state?.job;
  $("job-progress").hidden = !(running && running.total_s > 0);
  if (!running) {
    const known = state ? `last known: ${(WORDS[state.state] ?? "").toLowerCase()}` : "";
    const words = { offline: OFFLINE, lost: known, idle: "nothing runs" };
    return say(line, words[name] ?? "");
  }
  const of = running.total_s > 0 ? ` of ${duration(running.total_s)}` : "";
  const rest = running.to_go_s > running.total_s - running.done_s ? `, ${duration(running.to_go_s)} to go in all` : "";
  const phase = running.phase ? ` · ${running.phase}` : "";
  line.replaceChildren(make("b", {}, String(running.name)), `${phase} · ${duration(running.done_s)}${of}${rest}`);
  $("job-progress").value = running.total_s > 0 ? Math.min(1, running.done_s / running.total_s) : 0;
}

function latch(name) {
  const shown = state && (state.state === "tripped" || state.state === "stopped");
  $("latch").hidden = !shown;
  if (!shown) return;
  const trip = state.state === "tripped" ? state.trip : null;
  const why = trip ?? state.stop;
  $("latch-icon").setAttribute("href", `icons/set.svg#${state.state}`);
  say($("latch-title"), trip ? `Tripped: ${String(trip.cause).replaceAll("_", " ")}` : WORDS[state.state]);
  const byHand = trip?.cause === "not_confirmed_off" ? `${BY_HAND} ` : "";
  say($("latch-text"), byHand + (why?.text ?? "The output was switched off and the run was ended."));
  say($("latch-facts"), [why?.at_s ? `at ${when(why.at_s)}` : null,
    trip?.rows ? `${trip.rows} rows around it are kept` : null,
    trip || !took ? null : `answered after ${took}`, "nothing starts until the reset"].filter(Boolean).join(" · "));
  if (name === "lost") say($("latch-facts"), "no connection: this is the last that is known");
}

function gapsInWords(gaps) {
  if (!gaps) return null;
  if (!gaps.count) return "none";
  return `${gaps.count}, the longest ${duration(gaps.longest_s)}, ${duration(gaps.total_s)} in all`;
}

function facts() {
  if (!state) return;
  const limits = state.limits ?? {};
  const ticks = state.ticks ?? {};
  const rows = [
    ["controller", state.instruments?.controller], ["meter", state.instruments?.meter],
    ["limits", [limits.temperature_degC?.length ? `${limits.temperature_degC.join(" to ")} °C` : null,
      limits.current_A ? (heater() ? `${limits.current_A} of full drive` : `±${limits.current_A} A`) : null].filter(Boolean).join(", ")],
    ["dead man", state.dead_man_s ? `${state.dead_man_s} s` : "none"],
    ["film's memory", state.memory_known ? "known" : "not known"],
    ["cycles", ticks.done === undefined ? null : `${ticks.done.toLocaleString("en")}, late ${ticks.missed}`],
    ["gaps", gapsInWords(state.gaps)],
    ["longest time unread with a current on", ticks.unwatched_s > 0 ? `${ticks.unwatched_s.toFixed(2)} s` : null],
    ["up", duration(state.uptime_s)], ["viewers", state.viewers], ["version", state.version],
  ].filter(([, value]) => value !== null && value !== undefined && value !== "");
  const list = $("facts");
  if (list.children.length !== rows.length) {
    list.replaceChildren(...rows.map(() => make("div", {}, make("dt"), make("dd"))));
  }
  rows.forEach(([key, value], k) => {
    say(list.children[k].firstChild, key);
    say(list.children[k].lastChild, String(value));
  });
  const warnings = (state.warnings ?? []).map(String);
  const shown = [...$("warnings").children].map((node) => node.textContent);
  if (JSON.stringify(shown) !== JSON.stringify(warnings)) {
    $("warnings").replaceChildren(...warnings.map((text) => make("li", {}, text)));
  }
}

/** The form that clears a trip or a stop; a reason is asked. */
export function setUpGlance(reset) {
  $("reset-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const reason = $("reason").value.trim();
    const fault = reason ? await reset(reason) : "a reset needs a reason";
    sayOrHide($("reset-said"), fault);
    if (fault === null) $("reason").value = "";
    else $("reason").focus();
  });
  document.addEventListener("stopped", ({ detail }) => {
    took = detail.took;
  });
  document.addEventListener("token-needed", render);
  setInterval(freshness, 500);
}
